//! The row of a cycle: its columns, and the way from a cycle to its row and back.

use super::{ReportedCutRow, count, float, id, number, word};
use crate::codec::digest;
use crate::error::{StoreError, StoreResult};
use crate::record::{ContentHash, CycleMeta, NewCycle, StoredCycle};
use feedwright_core::cycle::{Cycle, CycleDraft, Flag, Flags, Outcome, ProfileVersion, Reported, Samples};
use feedwright_core::summary::{CycleSummary, DepthDigest, Energy, EnergyBasis, IdlePower, Peak};
use feedwright_core::units::{Process, Strategy, Timestamp};
use std::collections::{BTreeMap, BTreeSet};

/// Hands every column of `cycles`, with its type, its placeholder and the range that its numbers are in, to a macro: the list
/// stands once.
macro_rules! cycle_columns {
    ($callback:ident) => {
        $callback! {
                machine_id: String = "$1",
                cycle_id: String = "$2",
                tool_id: String = "$3",
                operation_id: String = "$4",
                started_at_us: i64 = "$5",
                received_at_us: i64 = "$6",
                seq: Option<i64> = "$7",
                content_hash: Vec<u8> = "$8",
                process: Option<String> = "$9",
                strategy: Option<String> = "$10",
                law_version: Option<String> = "$11",
                profile_id: Option<String> = "$12",
                profile_version: Option<i64> = "$13" in 1..=4_294_967_295,
                recommendation_id: Option<String> = "$14",
                outcome: String = "$15",
                summary_version: i64 = "$16" in 1..=4_294_967_295,
                sample_count: i64 = "$17" in 0..=4_294_967_295,
                coverage: f64 = "$18" in 0.0..=1.0,
                flags: i64 = "$19" in 0..=4_294_967_295,
                quantities: i64 = "$20",
                spindle_speed_rpm: Option<f64> = "$21" in 0.0..=1_000_000.0,
                duration_ms: Option<f64> = "$22" in 0.0..=1e9,
                dynamometer_joules: Option<f64> = "$23" in -1e18..=1e18,
                dynamometer_spindle_joules: Option<f64> = "$24" in -1e18..=1e18,
                dynamometer_feed_drive_joules: Option<f64> = "$25" in -1e18..=1e18,
                calibrated_joules: Option<f64> = "$26" in -1e18..=1e18,
                calibrated_spindle_joules: Option<f64> = "$27" in -1e18..=1e18,
                calibrated_feed_drive_joules: Option<f64> = "$28" in -1e18..=1e18,
                measured_power_joules: Option<f64> = "$29" in -1e18..=1e18,
                measured_power_spindle_joules: Option<f64> = "$30" in -1e18..=1e18,
                measured_power_feed_drive_joules: Option<f64> = "$31" in -1e18..=1e18,
                measured_power_idle_watts: Option<f64> = "$32" in -10_000_000.0..=10_000_000.0,
                rated_power_joules: Option<f64> = "$33" in -1e18..=1e18,
                rated_power_spindle_joules: Option<f64> = "$34" in -1e18..=1e18,
                rated_power_feed_drive_joules: Option<f64> = "$35" in -1e18..=1e18,
                max_depth_mm: Option<f64> = "$36" in -100_000.0..=100_000.0,
                max_spindle_load_percent: Option<f64> = "$37" in -10_000.0..=10_000.0,
                max_spindle_load_depth_mm: Option<f64> = "$38" in -100_000.0..=100_000.0,
                max_spindle_load_time_ms: Option<f64> = "$39" in 0.0..=1e9,
                max_feed_drive_load_percent: Option<f64> = "$40" in -10_000.0..=10_000.0,
                max_feed_drive_load_depth_mm: Option<f64> = "$41" in -100_000.0..=100_000.0,
                max_feed_drive_load_time_ms: Option<f64> = "$42" in 0.0..=1e9,
                max_spindle_power_watts: Option<f64> = "$43" in -10_000_000.0..=10_000_000.0,
                max_spindle_power_depth_mm: Option<f64> = "$44" in -100_000.0..=100_000.0,
                max_spindle_power_time_ms: Option<f64> = "$45" in 0.0..=1e9,
                max_thrust_newtons: Option<f64> = "$46" in -10_000_000.0..=10_000_000.0,
                max_thrust_depth_mm: Option<f64> = "$47" in -100_000.0..=100_000.0,
                max_thrust_time_ms: Option<f64> = "$48" in 0.0..=1e9,
                max_torque_newton_metres: Option<f64> = "$49" in -1_000_000.0..=1_000_000.0,
                max_torque_depth_mm: Option<f64> = "$50" in -100_000.0..=100_000.0,
                max_torque_time_ms: Option<f64> = "$51" in 0.0..=1e9,
                mean_spindle_load_percent: Option<f64> = "$52" in -10_000.0..=10_000.0,
                mean_feed_drive_load_percent: Option<f64> = "$53" in -10_000.0..=10_000.0,
                mean_override_percent: Option<f64> = "$54" in 0.0..=1000.0,
                operator_override_percent: Option<f64> = "$55" in 0.0..=1000.0,
                median_spindle_speed_rpm: Option<f64> = "$56" in -1_000_000.0..=1_000_000.0,
                spindle_load_fall_depth_mm: Option<f64> = "$57" in -100_000.0..=100_000.0,
                reported_energy_joules: Option<f64> = "$58" in -1e12..=1e12,
                reported_duration_ms: Option<f64> = "$59" in 0.0..=86_400_000.0,
                reported_max_depth_mm: Option<f64> = "$60" in -100_000.0..=100_000.0,
                reported_max_spindle_load_percent: Option<f64> = "$61" in -10_000.0..=10_000.0,
                reported_max_feed_drive_load_percent: Option<f64> = "$62" in -10_000.0..=10_000.0,
                reported_mean_spindle_load_percent: Option<f64> = "$63" in -10_000.0..=10_000.0,
                reported_mean_feed_drive_load_percent: Option<f64> = "$64" in -10_000.0..=10_000.0,
                reported_operator_override_percent: Option<f64> = "$65" in 0.0..=1000.0,
                energy_scale: i64 = "$66",
                depth_digest: Option<Vec<u8>> = "$67",
        }
    };
}
pub(crate) use cycle_columns;

macro_rules! define_row {
    ($($column:ident: $type:ty = $placeholder:literal $(in $least:literal..=$most:literal)?,)*) => {
        /// A row of `cycles`.
        #[derive(Debug, Clone, PartialEq, sqlx::FromRow)]
        #[cfg_attr(test, derive(Default))]
        pub(crate) struct CycleRow {
            $(pub(crate) $column: $type,)*
        }
    };
}
cycle_columns!(define_row);

/// What a column is to the count of quantities: only nullable floats are counted.
trait Column {
    fn quantity(&mut self) -> Option<&mut f64> {
        None
    }
}

impl Column for String {}
impl Column for i64 {}
impl Column for f64 {}
impl Column for Vec<u8> {}
impl Column for Option<Vec<u8>> {}
impl Column for Option<String> {}
impl Column for Option<i64> {}
impl Column for Option<f64> {
    fn quantity(&mut self) -> Option<&mut f64> {
        self.as_mut()
    }
}

/// Whether what stands in a column, if anything does, is in its range.
trait Ranged<T> {
    fn is_within(&self, least: T, most: T) -> bool;
}

impl<T: PartialOrd> Ranged<T> for T {
    fn is_within(&self, least: T, most: T) -> bool {
        (least..=most).contains(self)
    }
}

impl<T: PartialOrd> Ranged<T> for Option<T> {
    fn is_within(&self, least: T, most: T) -> bool {
        self.as_ref().is_none_or(|value| value.is_within(least, most))
    }
}

macro_rules! define_ranges {
    ($($column:ident: $type:ty = $placeholder:literal $(in $least:literal..=$most:literal)?,)*) => {
        impl CycleRow {
            /// The first column whose number is out of its range. The tables are checked against the same: where rows are
            /// written many in a second, asking SQLite for it takes longer than writing them.
            fn out_of_range(&self) -> Option<&'static str> {
                $($(
                    if !self.$column.is_within($least, $most) {
                        return Some(stringify!($column));
                    }
                )?)*
                None
            }
        }
    };
}
cycle_columns!(define_ranges);

macro_rules! define_quantities {
    ($($column:ident: $type:ty = $placeholder:literal $(in $least:literal..=$most:literal)?,)*) => {
        impl CycleRow {
            /// The nullable floats that are there, by name.
            fn quantities_mut(&mut self) -> impl Iterator<Item = (&'static str, &mut f64)> {
                [$((stringify!($column), Column::quantity(&mut self.$column)),)*]
                    .into_iter()
                    .filter_map(|(name, quantity)| Some((name, quantity?)))
            }
        }
    };
}
cycle_columns!(define_quantities);

/// The flags that the cycle alone decides.
const OF_CYCLE: [Flag; 11] = [
    Flag::FeedHold,
    Flag::OverrideZero,
    Flag::NegativeLoad,
    Flag::NegativePower,
    Flag::DepthReversal,
    Flag::LoadOver400,
    Flag::Gaps,
    Flag::Aborted,
    Flag::ClockSuspect,
    Flag::ReferenceCycle,
    Flag::NoReferenceCycle,
];

/// The last version of summaries before which cycles that were cut short were flagged incomplete alone.
const LAST_INCOMPLETE_ALONE: i64 = 4;

/// A column of a summary that is not what the cycle amounts to.
#[derive(Debug)]
pub(crate) struct Difference {
    pub(crate) column: &'static str,
    pub(crate) stored: String,
    pub(crate) again: String,
}

/// Whether two sums of the same numbers are the same but for the order in which they were added. By the smaller of both: infinity
/// is within a part of itself.
fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * a.abs().min(b.abs())
}

/// Whether a quantity is a value of its own, in which the order of adding plays no part.
fn is_no_sum(name: &str) -> bool {
    name.starts_with("max_") || name.starts_with("reported_") || name == "spindle_speed_rpm"
}

/// A row of `cycles` with whether samples are kept for it.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct CycleWithSamples {
    #[sqlx(flatten)]
    pub(crate) cycle: CycleRow,
    pub(crate) has_samples: bool,
}

fn peak_columns(peak: Option<Peak>) -> [Option<f64>; 3] {
    [peak.map(|peak| peak.value), peak.and_then(|peak| peak.depth_mm), peak.and_then(|peak| peak.time_ms)]
}

fn peak(value: Option<f64>, depth_mm: Option<f64>, time_ms: Option<f64>) -> Option<Peak> {
    value.map(|value| Peak { value, depth_mm, time_ms })
}

impl CycleRow {
    /// The row of a cycle. Refuses what is not finite: SQLite would keep a NaN as NULL.
    pub(crate) fn of(new: &NewCycle, summary: &CycleSummary) -> StoreResult<Self> {
        let cycle = &new.cycle;
        let reported = &cycle.reported;
        let energy = |basis| summary.energy.iter().find(|energy| energy.basis == basis);
        let parts = |basis| {
            let energy: Option<&Energy> = energy(basis);
            [
                energy.map(|energy| energy.total_joules),
                energy.and_then(|energy| energy.spindle_joules),
                energy.and_then(|energy| energy.feed_drive_joules),
            ]
        };
        let [dynamometer, dynamometer_spindle, dynamometer_feed] = parts(EnergyBasis::Dynamometer);
        let [calibrated, calibrated_spindle, calibrated_feed] = parts(EnergyBasis::Calibrated);
        let [measured, measured_spindle, measured_feed] = parts(EnergyBasis::MeasuredPower);
        let [rated, rated_spindle, rated_feed] = parts(EnergyBasis::RatedPower);
        let idle = match energy(EnergyBasis::MeasuredPower).map(|energy| energy.idle) {
            Some(IdlePower::Subtracted { watts }) => Some(watts),
            _ => None,
        };
        let [spindle_load, spindle_load_depth, spindle_load_time] =
            peak_columns(summary.max_spindle_load_percent);
        let [feed_load, feed_load_depth, feed_load_time] = peak_columns(summary.max_feed_drive_load_percent);
        let [power, power_depth, power_time] = peak_columns(summary.max_spindle_power_watts);
        let [thrust, thrust_depth, thrust_time] = peak_columns(summary.max_thrust_newtons);
        let [torque, torque_depth, torque_time] = peak_columns(summary.max_torque_newton_metres);
        let mut row = Self {
            machine_id: cycle.machine.as_str().to_owned(),
            cycle_id: cycle.id.as_str().to_owned(),
            tool_id: cycle.tool.as_str().to_owned(),
            operation_id: cycle.operation.as_str().to_owned(),
            started_at_us: cycle.started_at.micros(),
            received_at_us: new.received_at.micros(),
            seq: cycle.seq.map(|seq| count("seq", seq)).transpose()?,
            content_hash: new.encoded.hash.to_vec(),
            process: cycle.process.map(|process| process.as_str().to_owned()),
            strategy: cycle.strategy.map(|strategy| strategy.as_str().to_owned()),
            law_version: cycle.law_version.clone(),
            profile_id: cycle.profile.as_ref().map(|profile| profile.profile.as_str().to_owned()),
            profile_version: cycle.profile.as_ref().map(|profile| i64::from(profile.version)),
            recommendation_id: cycle.recommendation.as_ref().map(|id| id.as_str().to_owned()),
            outcome: cycle.outcome.as_str().to_owned(),
            summary_version: i64::from(summary.version),
            sample_count: i64::from(summary.sample_count),
            coverage: float("coverage", summary.coverage)?,
            flags: i64::from(summary.flags.bits()),
            quantities: 0,
            spindle_speed_rpm: cycle.spindle_speed_rpm,
            duration_ms: summary.duration_ms,
            dynamometer_joules: dynamometer,
            dynamometer_spindle_joules: dynamometer_spindle,
            dynamometer_feed_drive_joules: dynamometer_feed,
            calibrated_joules: calibrated,
            calibrated_spindle_joules: calibrated_spindle,
            calibrated_feed_drive_joules: calibrated_feed,
            measured_power_joules: measured,
            measured_power_spindle_joules: measured_spindle,
            measured_power_feed_drive_joules: measured_feed,
            measured_power_idle_watts: idle,
            rated_power_joules: rated,
            rated_power_spindle_joules: rated_spindle,
            rated_power_feed_drive_joules: rated_feed,
            max_depth_mm: summary.max_depth_mm,
            max_spindle_load_percent: spindle_load,
            max_spindle_load_depth_mm: spindle_load_depth,
            max_spindle_load_time_ms: spindle_load_time,
            max_feed_drive_load_percent: feed_load,
            max_feed_drive_load_depth_mm: feed_load_depth,
            max_feed_drive_load_time_ms: feed_load_time,
            max_spindle_power_watts: power,
            max_spindle_power_depth_mm: power_depth,
            max_spindle_power_time_ms: power_time,
            max_thrust_newtons: thrust,
            max_thrust_depth_mm: thrust_depth,
            max_thrust_time_ms: thrust_time,
            max_torque_newton_metres: torque,
            max_torque_depth_mm: torque_depth,
            max_torque_time_ms: torque_time,
            mean_spindle_load_percent: summary.mean_spindle_load_percent,
            mean_feed_drive_load_percent: summary.mean_feed_drive_load_percent,
            mean_override_percent: summary.mean_override_percent,
            operator_override_percent: summary.operator_override_percent,
            median_spindle_speed_rpm: summary.median_spindle_speed_rpm,
            spindle_load_fall_depth_mm: summary.spindle_load_fall_depth_mm,
            reported_energy_joules: reported.energy_joules,
            reported_duration_ms: reported.duration_ms,
            reported_max_depth_mm: reported.max_depth_mm,
            reported_max_spindle_load_percent: reported.max_spindle_load_percent,
            reported_max_feed_drive_load_percent: reported.max_feed_drive_load_percent,
            reported_mean_spindle_load_percent: reported.mean_spindle_load_percent,
            reported_mean_feed_drive_load_percent: reported.mean_feed_drive_load_percent,
            reported_operator_override_percent: reported.operator_override_percent,
            energy_scale: summary.energy_scale,
            depth_digest: summary.digest.as_ref().map(digest::pack),
        };
        row.settle_quantities()?;
        if row.energy() != summary.energy {
            // Bases twice, out of order, or treated otherwise than the columns can say.
            return Err(StoreError::Refused { constraint: "cycles_energy_shape".to_owned() });
        }
        Ok(row)
    }

    /// A part of an energy, by the name of its column.
    pub(crate) fn energy_part(&self, column: &str) -> Option<f64> {
        match column {
            "dynamometer_spindle_joules" => self.dynamometer_spindle_joules,
            "dynamometer_feed_drive_joules" => self.dynamometer_feed_drive_joules,
            "calibrated_spindle_joules" => self.calibrated_spindle_joules,
            "calibrated_feed_drive_joules" => self.calibrated_feed_drive_joules,
            "measured_power_spindle_joules" => self.measured_power_spindle_joules,
            "measured_power_feed_drive_joules" => self.measured_power_feed_drive_joules,
            "rated_power_spindle_joules" => self.rated_power_spindle_joules,
            "rated_power_feed_drive_joules" => self.rated_power_feed_drive_joules,
            _ => None,
        }
    }

    /// The same, to be stored: refuses numbers out of their ranges.
    pub(crate) fn in_range(self) -> StoreResult<Self> {
        match self.out_of_range() {
            Some(column) => Err(StoreError::Refused { constraint: format!("cycles_{column}_range") }),
            None => Ok(self),
        }
    }

    /// Normalises −0.0, refuses what is not finite, and counts what is there.
    fn settle_quantities(&mut self) -> StoreResult<()> {
        let mut present = 0;
        for (name, value) in self.quantities_mut() {
            *value = float(name, *value)?;
            present += 1;
        }
        self.quantities = present;
        Ok(())
    }

    fn energy(&self) -> Vec<Energy> {
        let parts = |basis, total: Option<f64>, spindle_joules, feed_drive_joules, idle| {
            total.map(|total_joules| Energy { basis, total_joules, spindle_joules, feed_drive_joules, idle })
        };
        let idle = match self.measured_power_idle_watts {
            Some(watts) => IdlePower::Subtracted { watts },
            None => IdlePower::Included,
        };
        [
            parts(
                EnergyBasis::Dynamometer,
                self.dynamometer_joules,
                self.dynamometer_spindle_joules,
                self.dynamometer_feed_drive_joules,
                IdlePower::NotApplicable,
            ),
            parts(
                EnergyBasis::Calibrated,
                self.calibrated_joules,
                self.calibrated_spindle_joules,
                self.calibrated_feed_drive_joules,
                IdlePower::NotApplicable,
            ),
            parts(
                EnergyBasis::MeasuredPower,
                self.measured_power_joules,
                self.measured_power_spindle_joules,
                self.measured_power_feed_drive_joules,
                idle,
            ),
            parts(
                EnergyBasis::RatedPower,
                self.rated_power_joules,
                self.rated_power_spindle_joules,
                self.rated_power_feed_drive_joules,
                IdlePower::Included,
            ),
            parts(EnergyBasis::Reported, self.reported_energy_joules, None, None, IdlePower::Included),
        ]
        .into_iter()
        .flatten()
        .collect()
    }

    fn summary(&self, digest: Option<DepthDigest>) -> StoreResult<CycleSummary> {
        Ok(CycleSummary {
            version: number("summary_version", self.summary_version)?,
            sample_count: number("sample_count", self.sample_count)?,
            duration_ms: self.duration_ms,
            energy: self.energy(),
            energy_scale: self.energy_scale,
            max_depth_mm: self.max_depth_mm,
            max_spindle_load_percent: peak(
                self.max_spindle_load_percent,
                self.max_spindle_load_depth_mm,
                self.max_spindle_load_time_ms,
            ),
            max_feed_drive_load_percent: peak(
                self.max_feed_drive_load_percent,
                self.max_feed_drive_load_depth_mm,
                self.max_feed_drive_load_time_ms,
            ),
            max_spindle_power_watts: peak(
                self.max_spindle_power_watts,
                self.max_spindle_power_depth_mm,
                self.max_spindle_power_time_ms,
            ),
            max_thrust_newtons: peak(
                self.max_thrust_newtons,
                self.max_thrust_depth_mm,
                self.max_thrust_time_ms,
            ),
            max_torque_newton_metres: peak(
                self.max_torque_newton_metres,
                self.max_torque_depth_mm,
                self.max_torque_time_ms,
            ),
            mean_spindle_load_percent: self.mean_spindle_load_percent,
            mean_feed_drive_load_percent: self.mean_feed_drive_load_percent,
            mean_override_percent: self.mean_override_percent,
            operator_override_percent: self.operator_override_percent,
            median_spindle_speed_rpm: self.median_spindle_speed_rpm,
            spindle_load_fall_depth_mm: self.spindle_load_fall_depth_mm,
            digest,
            coverage: self.coverage,
            flags: Flags::from_bits(number("flags", self.flags)?),
        })
    }

    /// Whether everything of it can be read.
    pub(crate) fn readable(&self) -> StoreResult<()> {
        self.summary(self.depth_digest.as_deref().map(super::facts::digest).transpose()?).map(|_| ())
    }

    fn meta(&self) -> StoreResult<CycleMeta> {
        let profile = match (&self.profile_id, self.profile_version) {
            (Some(profile), Some(version)) => Some(ProfileVersion {
                profile: id("profile_id", profile)?,
                version: number("profile_version", version)?,
            }),
            _ => None,
        };
        Ok(CycleMeta {
            machine: id("machine_id", &self.machine_id)?,
            id: id("cycle_id", &self.cycle_id)?,
            tool: id("tool_id", &self.tool_id)?,
            operation: id("operation_id", &self.operation_id)?,
            started_at: Timestamp::from_micros(self.started_at_us),
            seq: self.seq.map(|seq| number("seq", seq)).transpose()?,
            process: self.process.as_deref().map(|text| word("process", text, Process::parse)).transpose()?,
            strategy: self
                .strategy
                .as_deref()
                .map(|text| word("strategy", text, Strategy::parse))
                .transpose()?,
            law_version: self.law_version.clone(),
            profile,
            recommendation: self
                .recommendation_id
                .as_deref()
                .map(|text| id("recommendation_id", text))
                .transpose()?,
            reference: self.reference()?,
            spindle_speed_rpm: self.spindle_speed_rpm,
            outcome: word("outcome", &self.outcome, Outcome::parse)?,
            reported_duration_ms: self.reported_duration_ms,
        })
    }

    /// What the machine says of a reference cycle; it is kept among the flags.
    fn reference(&self) -> StoreResult<Option<bool>> {
        let flags = Flags::from_bits(number("flags", self.flags)?);
        Ok(match (flags.contains(Flag::ReferenceCycle), flags.contains(Flag::NoReferenceCycle)) {
            (true, _) => Some(true),
            (false, true) => Some(false),
            (false, false) => None,
        })
    }

    /// The cycle as it was taken in, with its samples and what was reported of its cut.
    pub(crate) fn cycle(&self, samples: Option<Samples>, cut: Option<ReportedCutRow>) -> StoreResult<Cycle> {
        Cycle::new(self.draft(samples, cut)?).map_err(|wrong| {
            let first = wrong.first().map(ToString::to_string).unwrap_or_default();
            StoreError::Damaged { what: format!("what is stored of it is no cycle: {first}") }
        })
    }

    /// As [`CycleRow::cycle`], unchecked: one whose samples are gone may have nothing left.
    pub(crate) fn draft(
        &self,
        samples: Option<Samples>,
        cut: Option<ReportedCutRow>,
    ) -> StoreResult<CycleDraft> {
        let meta = self.meta()?;
        Ok(CycleDraft {
            machine: meta.machine,
            id: meta.id,
            tool: meta.tool,
            operation: meta.operation,
            started_at: meta.started_at,
            seq: meta.seq,
            process: meta.process,
            strategy: meta.strategy,
            law_version: meta.law_version,
            profile: meta.profile,
            recommendation: meta.recommendation,
            reference: meta.reference,
            spindle_speed_rpm: meta.spindle_speed_rpm,
            outcome: meta.outcome,
            samples,
            reported: Reported {
                energy_joules: self.reported_energy_joules,
                duration_ms: self.reported_duration_ms,
                max_depth_mm: self.reported_max_depth_mm,
                max_spindle_load_percent: self.reported_max_spindle_load_percent,
                max_feed_drive_load_percent: self.reported_max_feed_drive_load_percent,
                mean_spindle_load_percent: self.reported_mean_spindle_load_percent,
                mean_feed_drive_load_percent: self.reported_mean_feed_drive_load_percent,
                operator_override_percent: self.reported_operator_override_percent,
                cut: cut.map(Into::into).unwrap_or_default(),
            },
        })
    }

    /// Whether that flag of it is set.
    pub(crate) const fn is_flagged(&self, flag: Flag) -> bool {
        self.flags & flag as i64 != 0
    }

    /// Whether it may be a part that an earlier version flagged incomplete alone.
    pub(crate) const fn may_be_cut_unsaid(&self) -> bool {
        self.summary_version <= LAST_INCOMPLETE_ALONE
            && self.is_flagged(Flag::Incomplete)
            && !self.is_flagged(Flag::CutShort)
    }

    /// Whether wear leaves it out for a flag that nothing else says anything of: neither hash nor samples tell what was cut off.
    /// Of what was aborted, which the hash holds, it makes no difference.
    pub(crate) const fn rests_on_cut_short(&self) -> bool {
        self.is_flagged(Flag::CutShort) && !self.is_flagged(Flag::Aborted)
    }

    /// Holds the summary against one made again of the same cycle: what differs, with its column. Unless `same_context`,
    /// only what rests on the samples alone is held. Sums of an earlier build may differ in their last bits.
    pub(crate) fn differing(&mut self, again: &mut Self, same_context: bool) -> Vec<Difference> {
        let rests_on_context = |name: &str| {
            let energy = name.ends_with("_joules") && !name.starts_with("reported_");
            energy || name == "measured_power_idle_watts"
        };
        let text = |value: Option<f64>| value.map_or_else(|| "nothing".to_owned(), |value| value.to_string());
        let mut found = Vec::new();
        let mut differ =
            |column, stored: String, again: String| found.push(Difference { column, stored, again });
        if !same(self.coverage, again.coverage) {
            differ("coverage", self.coverage.to_string(), again.coverage.to_string());
        }
        let stored: BTreeMap<_, _> = self.quantities_mut().map(|(name, value)| (name, *value)).collect();
        let anew: BTreeMap<_, _> = again.quantities_mut().map(|(name, value)| (name, *value)).collect();
        let names: BTreeSet<_> = stored.keys().chain(anew.keys()).copied().collect();
        for name in names.into_iter().filter(|name| same_context || !rests_on_context(name)) {
            let (stored, anew) = (stored.get(name).copied(), anew.get(name).copied());
            let holds = match (stored, anew) {
                // What was chosen among samples or reported is it to the last bit; a zero has no sign.
                (Some(stored), Some(anew)) if is_no_sum(name) => {
                    (stored + 0.0).to_bits() == (anew + 0.0).to_bits()
                }
                (Some(stored), Some(anew)) => same(stored, anew),
                _ => false,
            };
            if !holds {
                differ(name, text(stored), text(anew));
            }
        }
        // What was cut off and a tool that was not registered are not seen in the samples.
        let mut unseen = Flag::ToolUnregistered as i64 | Flag::CutShort as i64;
        if self.is_flagged(Flag::CutShort) || self.may_be_cut_unsaid() {
            unseen |= self.flags & Flag::Incomplete as i64;
        }
        let held =
            if same_context { !unseen } else { OF_CYCLE.iter().fold(0, |bits, flag| bits | *flag as i64) };
        if (self.flags ^ again.flags) & held != 0 {
            differ("flags", self.flags.to_string(), again.flags.to_string());
        }
        if same_context {
            if self.energy_scale != again.energy_scale {
                differ("energy_scale", self.energy_scale.to_string(), again.energy_scale.to_string());
            }
            if self.depth_digest != again.depth_digest {
                differ("depth_digest", "another course".to_owned(), "this".to_owned());
            }
        }
        found
    }

    pub(crate) fn hash(&self) -> StoreResult<ContentHash> {
        self.content_hash
            .as_slice()
            .try_into()
            .map_err(|_| StoreError::Damaged { what: "content_hash has not 32 bytes".to_owned() })
    }
}

impl CycleWithSamples {
    /// The cycle; without its course over depth where that cannot be read.
    pub(crate) fn stored(&self) -> StoreResult<StoredCycle> {
        let cycle = &self.cycle;
        let digest = cycle
            .depth_digest
            .as_deref()
            .and_then(|bytes| super::facts::legible_digest(bytes, &cycle.machine_id, &cycle.cycle_id));
        Ok(StoredCycle {
            cycle: self.cycle.meta()?,
            summary: self.cycle.summary(digest)?,
            received_at: Timestamp::from_micros(self.cycle.received_at_us),
            hash: self.cycle.hash()?,
            has_samples: self.has_samples,
        })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::record::EncodedCycle;
    use feedwright_core::cycle::{Channel, DURATION_RANGE, TimeBase};
    use feedwright_core::invalid::Range;
    use feedwright_core::machine::{FeedDriveRating, FeedLimits, LoadReference, Machine, SpindleRating};
    use feedwright_core::summary::{Context, MOST_JOULES, summarise};
    use proptest::prelude::{prop_assert, prop_oneof, proptest};
    use std::sync::Arc;

    macro_rules! list_ranges {
        ($($column:ident: $type:ty = $placeholder:literal $(in $least:literal..=$most:literal)?,)*) => {
            /// Columns with the numbers that their ranges are written with.
            pub(crate) const RANGES: &[(&str, &str, &str)] =
                &[$($((stringify!($column), stringify!($least), stringify!($most)),)?)*];
        };
    }
    cycle_columns!(list_ranges);

    #[test]
    fn every_energy_that_is_told_can_be_stored() {
        let told: Vec<_> = RANGES
            .iter()
            .filter(|(column, _, _)| column.ends_with("_joules") && !column.starts_with("reported_"))
            .collect();
        assert_eq!(told.len(), 12);
        for (column, least, most) in told {
            let ends = [least, most].map(|end| end.replace(' ', "").parse::<f64>().unwrap().to_bits());
            assert_eq!(ends, [-MOST_JOULES, MOST_JOULES].map(f64::to_bits), "{column}");
        }
    }

    /// The next number above and below.
    trait Beside: Sized {
        fn above(self) -> Self;
        fn below(self) -> Self;
    }

    impl Beside for i64 {
        fn above(self) -> Self {
            self + 1
        }
        fn below(self) -> Self {
            self - 1
        }
    }

    impl Beside for f64 {
        fn above(self) -> Self {
            self.next_up()
        }
        fn below(self) -> Self {
            self.next_down()
        }
    }

    #[test]
    fn sums_are_the_same_within_what_adding_rounds() {
        assert!(same(0.0, 0.0) && same(-3.5, -3.5) && same(866.81, 866.81 * (1.0 + 1e-10)));
        let others = [866.82, 0.0, -866.81, f64::INFINITY, f64::NEG_INFINITY, f64::NAN];
        assert!(others.iter().all(|other| !same(866.81, *other) && !same(*other, 866.81)));
    }

    /// Values as a channel may have at the most, and between.
    fn extreme(range: Range) -> impl proptest::strategy::Strategy<Value = f64> {
        let Range { min, max, .. } = range;
        let ends =
            vec![min, max, max.next_down(), 0.0, 1e-300_f64.max(min), max / 3.0, f64::midpoint(min, max)];
        prop_oneof![proptest::sample::select(ends), min..=max]
    }

    proptest! {
        #[test]
        fn what_a_valid_cycle_amounts_to_is_in_range(
            len in 1..40_usize,
            constant in proptest::bool::ANY,
            columns in Channel::ALL.iter().map(|channel| {
                (proptest::bool::ANY, proptest::collection::vec(extreme(channel.range()), 40))
            }).collect::<Vec<_>>(),
            mut stamps in proptest::collection::vec(
                prop_oneof![0.0..1e4_f64, extreme(DURATION_RANGE), proptest::sample::select(vec![0.0, 1e-6, 10.0])],
                40,
            ),
            period_ms in proptest::option::of(0.01..1e4_f64),
            rated in proptest::option::of(proptest::sample::select(vec![1.0, 7000.0, 1e7])),
            reference in proptest::sample::select(LoadReference::ALL.to_vec()),
        ) {
            stamps.truncate(len);
            stamps.sort_by(f64::total_cmp);
            let time = period_ms.map_or(TimeBase::Stamps { time_ms: stamps }, |period_ms| TimeBase::Period { period_ms });
            let columns: Vec<_> = Channel::ALL
                .iter()
                .zip(columns)
                .filter(|(channel, (is_sampled, _))| *is_sampled || **channel == Channel::OverridePercent)
                .map(|(channel, (_, values))| {
                    (*channel, if constant { vec![values[0]; len] } else { values[..len].to_vec() })
                })
                .collect();
            let cycle = Cycle::new(CycleDraft {
                machine: "M1".try_into().unwrap(),
                id: "c1".try_into().unwrap(),
                tool: "T1".try_into().unwrap(),
                operation: "O1".try_into().unwrap(),
                started_at: Timestamp::from_micros(0),
                seq: None,
                process: None,
                strategy: None,
                law_version: None,
                profile: None,
                recommendation: None,
                reference: None,
                spindle_speed_rpm: Some(1e6),
                outcome: Outcome::Completed,
                samples: Some(Samples::new(time, columns, 40).unwrap()),
                reported: Reported::default(),
            })
            .unwrap();
            let machine = Machine {
                id: "M1".try_into().unwrap(),
                name: "M1".to_owned(),
                control: "linuxcnc".to_owned(),
                ipo_period_ms: 10.0,
                spindle: SpindleRating { reference, rated_power_watts: rated, base_speed_rpm: rated },
                feed_drive: FeedDriveRating { reference, rated_thrust_newtons: rated },
                limits: FeedLimits::new(1.0, 1000.0, 5.0, 200.0).unwrap(),
            };
            let summary = summarise(&cycle, Context { machine: &machine, calibration: None, operation: None });
            let new = NewCycle {
                cycle: Arc::new(cycle),
                received_at: Timestamp::from_micros(0),
                encoded: EncodedCycle { hash: [0; 32], samples: None },
                summary,
                generation: None,
                cut_short: false,
            };
            let row = CycleRow::of(&new, &new.summary).unwrap().in_range();
            prop_assert!(row.is_ok(), "{:?}", row.err());
        }
    }

    #[test]
    fn a_number_out_of_its_range_is_refused() {
        let valid = CycleRow { summary_version: 1, ..CycleRow::default() };
        valid.clone().in_range().unwrap();
        macro_rules! go_beyond {
            ($($column:ident: $type:ty = $placeholder:literal $(in $least:literal..=$most:literal)?,)*) => {$($(
                for (number, is_refused) in
                    [($least, false), ($most, false), (($least).below(), true), (($most).above(), true)]
                {
                    let mut row = valid.clone();
                    row.$column = number.into();
                    match row.in_range() {
                        Ok(_) => assert!(!is_refused, "{} {number}", stringify!($column)),
                        Err(StoreError::Refused { constraint }) if is_refused => {
                            assert_eq!(constraint, concat!("cycles_", stringify!($column), "_range"));
                        }
                        Err(other) => panic!("{} {number}: {other:?}", stringify!($column)),
                    }
                }
            )?)*};
        }
        cycle_columns!(go_beyond);
    }
}

//! What the fold reads: facts of cycles with the settings of their operation, and events with their place.

use super::{CycleRow, damaged, id, number, word};
use crate::error::StoreResult;
use crate::record::StoredToolEvent;
use crate::stored_text::StoredText;
use feedwright_core::cycle::{Flags, ProfileVersion};
use feedwright_core::ids::{CycleId, MachineId, RecommendationId};
use feedwright_core::operation::{Ask, DatedOperation, WearSettings};
use feedwright_core::summary::{CycleSummary, DepthDigest, EnergyBasis};
use feedwright_core::tool::{ToolEvent, ToolEventKind};
use feedwright_core::units::{Process, Strategy, Timestamp};
use feedwright_core::wear::{CycleFacts, FoldSettings, OrderKey};
use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

/// Cycles whose course is told to be damaged; `feedwright check` names them all.
const MOST_TOLD: usize = 1_000;

/// The stored digest.
pub(super) fn digest(bytes: &[u8]) -> StoreResult<DepthDigest> {
    crate::codec::digest::unpack(bytes).ok_or_else(|| damaged("depth_digest"))
}

/// The stored digest of a cycle, where there is one and it can be read. One that cannot costs its cycle its course, and
/// nobody else anything: the log says so once.
pub(super) fn legible_digest(bytes: &[u8], machine: &str, cycle: &str) -> Option<DepthDigest> {
    static TOLD: Mutex<BTreeSet<(String, String)>> = Mutex::new(BTreeSet::new());
    let error = match digest(bytes) {
        Ok(digest) => return Some(digest),
        Err(error) => error,
    };
    let mut told = TOLD.lock().unwrap_or_else(PoisonError::into_inner);
    if told.len() < MOST_TOLD && told.insert((machine.to_owned(), cycle.to_owned())) {
        tracing::error!(machine, cycle, %error, "the course of a cycle over depth cannot be read and is left out");
    }
    None
}

/// What wear needs of one cycle.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct FactsRow {
    pub(crate) machine_id: String,
    pub(crate) cycle_id: String,
    pub(crate) operation_id: String,
    pub(crate) started_at_us: i64,
    pub(crate) received_at_us: i64,
    pub(crate) seq: Option<i64>,
    pub(crate) strategy: Option<String>,
    pub(crate) law_version: Option<String>,
    pub(crate) profile_id: Option<String>,
    pub(crate) profile_version: Option<i64>,
    pub(crate) spindle_speed_rpm: Option<f64>,
    pub(crate) median_spindle_speed_rpm: Option<f64>,
    pub(crate) dynamometer_joules: Option<f64>,
    pub(crate) calibrated_joules: Option<f64>,
    pub(crate) measured_power_joules: Option<f64>,
    pub(crate) measured_power_idle_watts: Option<f64>,
    pub(crate) rated_power_joules: Option<f64>,
    pub(crate) reported_energy_joules: Option<f64>,
    pub(crate) energy_scale: i64,
    pub(crate) duration_ms: Option<f64>,
    pub(crate) max_depth_mm: Option<f64>,
    pub(crate) spindle_load_fall_depth_mm: Option<f64>,
    pub(crate) operator_override_percent: Option<f64>,
    pub(crate) depth_digest: Option<Vec<u8>>,
    pub(crate) recommendation_id: Option<String>,
    pub(crate) coverage: f64,
    pub(crate) flags: i64,
    pub(crate) baseline_cycles: Option<i64>,
    pub(crate) window_cycles: Option<i64>,
    pub(crate) reference_every_cycles: Option<i64>,
    pub(crate) reference_feed_mm_min: Option<f64>,
    pub(crate) operation_process: Option<String>,
    pub(crate) operation_feed_mm_min: Option<f64>,
    pub(crate) operation_depth_mm: Option<f64>,
    pub(crate) operation_speed_rpm: Option<f64>,
    /// What the stored digest was made of, where this process has just made it.
    #[sqlx(skip)]
    pub(crate) digest: Option<DepthDigest>,
    /// What the operation asked for when the cycle began, where it is registered.
    #[sqlx(skip)]
    pub(crate) asked: Option<Ask>,
}

impl FactsRow {
    /// The facts of a row that is being written: the same columns that a refold reads, but for the digest, which is the
    /// one that the row's was packed from.
    pub(crate) fn of(row: &CycleRow, summary: &CycleSummary, operation: Option<&DatedOperation>) -> Self {
        Self {
            machine_id: row.machine_id.clone(),
            cycle_id: row.cycle_id.clone(),
            operation_id: row.operation_id.clone(),
            started_at_us: row.started_at_us,
            received_at_us: row.received_at_us,
            seq: row.seq,
            strategy: row.strategy.clone(),
            law_version: row.law_version.clone(),
            profile_id: row.profile_id.clone(),
            profile_version: row.profile_version,
            spindle_speed_rpm: row.spindle_speed_rpm,
            median_spindle_speed_rpm: row.median_spindle_speed_rpm,
            dynamometer_joules: row.dynamometer_joules,
            calibrated_joules: row.calibrated_joules,
            measured_power_joules: row.measured_power_joules,
            measured_power_idle_watts: row.measured_power_idle_watts,
            rated_power_joules: row.rated_power_joules,
            reported_energy_joules: row.reported_energy_joules,
            energy_scale: row.energy_scale,
            duration_ms: row.duration_ms,
            max_depth_mm: row.max_depth_mm,
            spindle_load_fall_depth_mm: row.spindle_load_fall_depth_mm,
            operator_override_percent: row.operator_override_percent,
            depth_digest: None,
            recommendation_id: row.recommendation_id.clone(),
            coverage: row.coverage,
            flags: row.flags,
            baseline_cycles: operation.map(|operation| i64::from(operation.wear.baseline_cycles)),
            window_cycles: operation.map(|operation| i64::from(operation.wear.window_cycles)),
            reference_every_cycles: operation
                .and_then(|operation| operation.wear.reference_every_cycles)
                .map(i64::from),
            reference_feed_mm_min: operation.and_then(|operation| operation.wear.reference_feed_mm_min),
            operation_process: operation.map(|operation| operation.process.as_str().to_owned()),
            operation_feed_mm_min: operation.and_then(|operation| operation.programmed_feed_mm_min),
            operation_depth_mm: operation.and_then(|operation| operation.depth_mm),
            operation_speed_rpm: operation.and_then(|operation| operation.spindle_speed_rpm),
            digest: summary.digest.clone(),
            asked: operation
                .and_then(|operation| operation.asked_at(Timestamp::from_micros(row.started_at_us))),
        }
    }

    /// Place of the cycle in its tool's history.
    pub(crate) fn order(&self) -> StoreResult<OrderKey> {
        Ok(OrderKey {
            started_at: Timestamp::from_micros(self.started_at_us),
            machine: id("machine_id", &self.machine_id)?,
            seq: self.seq.map(|seq| number("seq", seq)).transpose()?,
            cycle: id("cycle_id", &self.cycle_id)?,
        })
    }

    /// Basis, whether idle power is out of it, and joules: as [`CycleFacts::of`] takes them, best basis first.
    fn best_energy(&self) -> Option<(EnergyBasis, bool, f64)> {
        let net = self.measured_power_idle_watts.is_some();
        [
            (EnergyBasis::Dynamometer, false, self.dynamometer_joules),
            (EnergyBasis::Calibrated, false, self.calibrated_joules),
            (EnergyBasis::MeasuredPower, net, self.measured_power_joules),
            (EnergyBasis::RatedPower, false, self.rated_power_joules),
            (EnergyBasis::Reported, false, self.reported_energy_joules),
        ]
        .into_iter()
        .find_map(|(basis, net, joules)| Some((basis, net, joules?)))
    }

    /// Whether everything of it can be read.
    pub(crate) fn readable(&self) -> StoreResult<()> {
        self.depth_digest.as_deref().map(digest).transpose().map(|_| ())
    }

    /// What the fold takes: the facts, and the operation's settings where it is registered.
    ///
    /// Of a cycle whose digest cannot be read it is not known what would be compared: it has no energy, and is left out as
    /// one that was not measured.
    pub(crate) fn facts(&self) -> StoreResult<(CycleFacts, Option<FoldSettings>)> {
        let stored = self.depth_digest.as_deref();
        let digest = match stored {
            Some(bytes) => legible_digest(bytes, &self.machine_id, &self.cycle_id),
            None => self.digest.clone(),
        };
        let is_measured = stored.is_none() || digest.is_some();
        let profile = match (&self.profile_id, self.profile_version) {
            (Some(profile), Some(version)) => Some(ProfileVersion {
                profile: id("profile_id", profile)?,
                version: number("profile_version", version)?,
            }),
            _ => None,
        };
        let facts = CycleFacts {
            order: self.order()?,
            operation: id("operation_id", &self.operation_id)?,
            received_at: Timestamp::from_micros(self.received_at_us),
            spindle_speed_rpm: self.spindle_speed_rpm,
            sampled_speed_rpm: self.median_spindle_speed_rpm,
            strategy: self
                .strategy
                .as_deref()
                .map(|text| word("strategy", text, Strategy::parse))
                .transpose()?,
            law_version: self.law_version.clone(),
            profile,
            energy: self.best_energy().filter(|_| is_measured),
            energy_scale: self.energy_scale,
            duration_ms: self.duration_ms,
            max_depth_mm: self.max_depth_mm,
            fall_depth_mm: self.spindle_load_fall_depth_mm,
            operator_override_percent: self.operator_override_percent,
            digest,
            asked_as_reference: self
                .recommendation_id
                .as_deref()
                .map(|text| id::<RecommendationId>("recommendation_id", text))
                .transpose()?
                .is_some_and(|recommendation| recommendation.asks_for_reference()),
            coverage: self.coverage,
            flags: Flags::from_bits(number("flags", self.flags)?),
        };
        Ok((facts, self.settings()?))
    }

    /// What the operation says, where it is registered; as [`FoldSettings::of`] takes it, and asked for when the cycle began.
    fn settings(&self) -> StoreResult<Option<FoldSettings>> {
        let (Some(baseline), Some(window), Some(process)) =
            (self.baseline_cycles, self.window_cycles, &self.operation_process)
        else {
            return Ok(None);
        };
        // Of a process that a disk has made no word is known what to go by as little as of an operation that is not registered.
        let Some(process) = Process::parse(process) else { return Ok(None) };
        let wear = WearSettings {
            baseline_cycles: number("baseline_cycles", baseline)?,
            window_cycles: number("window_cycles", window)?,
            reference_every_cycles: self
                .reference_every_cycles
                .map(|every| number("reference_every_cycles", every))
                .transpose()?,
            reference_feed_mm_min: self.reference_feed_mm_min,
        };
        let now = FoldSettings {
            wear,
            depth_mm: self.operation_depth_mm,
            spindle_speed_rpm: self.operation_speed_rpm,
            is_friction: process == Process::Friction,
            reference_feed_mm_min: wear.reference_feed_of(process, self.operation_feed_mm_min),
        };
        Ok(Some(self.asked.map_or(now, |then| now.asked(then))))
    }
}

/// A place in a tool's history. An event at a time stands before every cycle that began at that time; an event that
/// names a cycle has that cycle's place and goes before it.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Place {
    pub(crate) at: Timestamp,
    pub(crate) cycle: Option<(MachineId, Option<u64>, CycleId)>,
}

impl Place {
    pub(crate) fn of(order: &OrderKey) -> Self {
        Self { at: order.started_at, cycle: Some((order.machine.clone(), order.seq, order.cycle.clone())) }
    }

    pub(crate) const fn at(at: Timestamp) -> Self {
        Self { at, cycle: None }
    }
}

/// An event where it takes effect. Ordered by place; events of one place by their own time, then by arrival.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct PlacedEvent {
    pub(crate) place: Place,
    pub(crate) at: Timestamp,
    pub(crate) id: i64,
    pub(crate) kind: ToolEventKind,
}

impl Ord for PlacedEvent {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (&self.place, self.at, self.id).cmp(&(&other.place, other.at, other.id))
    }
}

impl PartialOrd for PlacedEvent {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// A row of `tool_events`.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct EventRow {
    pub(crate) event_id: i64,
    pub(crate) kind: String,
    pub(crate) at_us: i64,
    pub(crate) first_machine_id: Option<String>,
    pub(crate) first_cycle_id: Option<String>,
    pub(crate) reason: Option<StoredText>,
    /// Who told it is shown, and nothing else: the tool is judged all the same where that is damaged.
    pub(crate) actor: StoredText,
    pub(crate) recorded_at_us: i64,
    pub(crate) revoked_at_us: Option<i64>,
    pub(crate) revoked_by: Option<StoredText>,
}

impl EventRow {
    fn first_cycle(&self) -> StoreResult<Option<(MachineId, CycleId)>> {
        match (&self.first_machine_id, &self.first_cycle_id) {
            (Some(machine), Some(cycle)) => {
                Ok(Some((id("first_machine_id", machine)?, id("first_cycle_id", cycle)?)))
            }
            _ => Ok(None),
        }
    }

    /// Whether it names a cycle.
    pub(crate) const fn names_a_cycle(&self) -> bool {
        self.first_cycle_id.is_some()
    }

    /// Where it takes effect: at the cycle it names, of which `first` is the time and the number, where that one is stored
    /// for the same tool.
    pub(crate) fn placed(&self, first: Option<(i64, Option<i64>)>) -> StoreResult<PlacedEvent> {
        let at = Timestamp::from_micros(self.at_us);
        let place = match (self.first_cycle()?, first) {
            (Some((machine, cycle)), Some((started, seq))) => Place {
                at: Timestamp::from_micros(started),
                cycle: Some((machine, seq.map(|seq| number("first_seq", seq)).transpose()?, cycle)),
            },
            _ => Place::at(at),
        };
        let kind = word("kind", &self.kind, ToolEventKind::parse)?;
        Ok(PlacedEvent { place, at, id: self.event_id, kind })
    }

    pub(crate) fn stored(&self) -> StoreResult<StoredToolEvent> {
        Ok(StoredToolEvent {
            id: self.event_id,
            event: ToolEvent {
                kind: word("kind", &self.kind, ToolEventKind::parse)?,
                at: Timestamp::from_micros(self.at_us),
                first_cycle: self.first_cycle()?,
                reason: self.reason.as_ref().map(StoredText::shown),
            },
            actor: self.actor.shown(),
            recorded_at: Timestamp::from_micros(self.recorded_at_us),
            revoked: self
                .revoked_by
                .as_ref()
                .map(StoredText::shown)
                .zip(self.revoked_at_us.map(Timestamp::from_micros)),
        })
    }
}

//! What one cycle amounts to: energy by basis, maxima, means, coverage and quality flags.
//!
//! A pure function of the cycle and of what its machine and operation declare, with bounded cost per sample.

mod course;
mod digest;
mod energy;
mod loads;
mod scan;

pub use course::energy_course;
pub use digest::{DIGEST_DEPTH_MM, DepthDigest, MOST_DIGEST_BINS, MOST_DIGEST_BYTES, way_in_contact};
pub(crate) use digest::{SURFACE_MM, relation_config};
pub use energy::{Energy, EnergyBasis, IdlePower, MOST_JOULES};
pub(crate) use loads::median_in_place;
pub use loads::{Peak, PeakShift, median};

use crate::cycle::{Channel, Cycle, Flag, Flags, Outcome, Samples, TimeBase};
use crate::machine::{Calibration, Machine};
use crate::operation::Operation;
use crate::units::Timestamp;

/// Version of the summary's rules; stored with every summary, so that a change of rules shows.
pub const SUMMARY_VERSION: u32 = 7;
/// The version before: its median speed was that of all samples, standstill and all.
const STANDSTILL_AS_SPEED_VERSION: u32 = 6;
/// The version before that: a recording that began at the surface had the period before it in its contact, and stamps that are all the
/// same were no time and no energy.
const SURFACE_AS_WORK_VERSION: u32 = 5;
/// The version before that: it left out what a control reports of channels that it does not sample, where it samples any.
const WITHOUT_REPORTED_VERSION: u32 = 4;

/// Share of a cycle's time that samples must cover for its energy to be compared.
pub const COVERAGE_FLOOR: f64 = 0.95;

/// A cycle that stays short of this share of the operation's depth is incomplete.
pub const DEPTH_FLOOR: f64 = 0.9;

/// A spindle turns at this share of its fastest sample or above, and of what it is commanded. Below it are an encoder's noise at rest and
/// the begin of spinning up; nothing is cut at a tenth of the speed.
pub const LEAST_TURNING: f64 = 0.1;

/// Device times before this are a clock that was never set: 2000-01-01T00:00:00Z.
pub const EARLIEST_CLOCK: Timestamp = Timestamp::from_micros(946_684_800_000_000);

/// What the summary needs to know besides the cycle; `None` where it is not registered.
#[derive(Debug, Clone, Copy)]
pub struct Context<'a> {
    /// The machine with its ratings.
    pub machine: &'a Machine,
    /// The machine's fitted lines, where there are any.
    pub calibration: Option<&'a Calibration>,
    /// The operation, where it is registered.
    pub operation: Option<&'a Operation>,
}

impl Context<'_> {
    /// The speed of a cycle that names one, else that of its operation, rpm.
    pub fn commanded_rpm(&self, of_cycle: Option<f64>) -> Option<f64> {
        of_cycle.or_else(|| self.operation.and_then(|operation| operation.spindle_speed_rpm))
    }
}

/// The summary of one cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleSummary {
    /// Version of the rules that made it.
    pub version: u32,
    /// Number of samples; 0 where the control only reported.
    pub sample_count: u32,
    /// Cycle time, ms.
    pub duration_ms: Option<f64>,
    /// Energy by basis, best basis first; empty where no joules can be told.
    pub energy: Vec<Energy>,
    /// Fingerprint of what the best energy rests on: ratings, fitted lines, which parts are in it. Energies of another
    /// scale are not compared. 0 where there is no energy.
    pub energy_scale: i64,
    /// Largest depth, mm.
    pub max_depth_mm: Option<f64>,
    /// Largest spindle load, %, with where and when.
    pub max_spindle_load_percent: Option<Peak>,
    /// Largest feed-drive load, %, with where and when.
    pub max_feed_drive_load_percent: Option<Peak>,
    /// Largest spindle power, W, with where and when.
    pub max_spindle_power_watts: Option<Peak>,
    /// Largest thrust, N, with where and when.
    pub max_thrust_newtons: Option<Peak>,
    /// Largest torque, N·m, with where and when.
    pub max_torque_newton_metres: Option<Peak>,
    /// Mean spindle load over time, %.
    pub mean_spindle_load_percent: Option<f64>,
    /// Mean feed-drive load over time, %.
    pub mean_feed_drive_load_percent: Option<f64>,
    /// Mean override over time, %.
    pub mean_override_percent: Option<f64>,
    /// Mean operator's override over time, %.
    pub operator_override_percent: Option<f64>,
    /// Median of the sampled spindle speed while it turns, in the work where depth was sampled and says so, rpm; `None` where it never does.
    pub median_spindle_speed_rpm: Option<f64>,
    /// Depth at which the spindle load has fallen to half of its maximum, mm: the steadier second indicator.
    pub spindle_load_fall_depth_mm: Option<f64>,
    /// Share of the cycle's time that samples cover, 0 to 1.
    pub coverage: f64,
    /// What a friction cycle did over depth; `None` for other processes and where it was not sampled.
    pub digest: Option<DepthDigest>,
    /// What is unusual about it.
    pub flags: Flags,
}

impl CycleSummary {
    /// The energy of the best basis that is known.
    pub fn best_energy(&self) -> Option<&Energy> {
        self.energy.first()
    }
}

/// How long a cycle took, ms, by its samples and by what was reported of it. Samples may be of a part of it, and a report of less than was
/// sampled: the longer one.
pub fn longest_ms(sampled: Option<f64>, reported: Option<f64>) -> Option<f64> {
    match (sampled, reported) {
        (Some(sampled), Some(reported)) => Some(sampled.max(reported)),
        (sampled, reported) => sampled.or(reported),
    }
}

/// Whether a summary of that version of the rules is what [`summarise`] makes of the cycle.
pub fn is_summarised_alike(version: u32, cycle: &Cycle) -> bool {
    let is_mixed = || {
        let reported = cycle.reported.fields();
        cycle.samples.is_some() && reported.iter().any(|(_, _, value)| value.is_some())
    };
    let began_otherwise = || {
        cycle.samples.as_ref().is_some_and(|samples| {
            samples.column(Channel::DepthMm).is_some_and(digest::begins_at_the_surface)
                || SampleClock::of(samples).duration_ms <= 0.0
        })
    };
    let stood = || {
        let speed = cycle.samples.as_ref().and_then(|samples| samples.column(Channel::SpindleSpeedRpm));
        speed.is_some_and(|speed| {
            let turning = cycle.samples.as_ref().and_then(loads::turning_speed);
            turning.map(f64::to_bits) != Some(median(speed).to_bits())
        })
    };
    match version {
        SUMMARY_VERSION => true,
        STANDSTILL_AS_SPEED_VERSION => !stood(),
        SURFACE_AS_WORK_VERSION => !began_otherwise() && !stood(),
        WITHOUT_REPORTED_VERSION => !is_mixed() && !began_otherwise() && !stood(),
        _ => false,
    }
}

/// Summarises `cycle`.
pub fn summarise(cycle: &Cycle, context: Context<'_>) -> CycleSummary {
    let mut summary = match &cycle.samples {
        Some(samples) => of_samples(samples, cycle, context),
        None => of_reported(cycle),
    };
    if let Some(joules) = cycle.reported.energy_joules {
        summary.energy.push(Energy::reported(joules));
    }
    summary.energy_scale = summary.best_energy().map_or(0, |best| energy::scale(best, context));
    let contradictory = contradicts(cycle, &summary)
        || contradicts_reference(cycle, &summary)
        || contradicts_operation(cycle, context);
    let asked = context.operation.and_then(|operation| operation.depth_mm);
    let short = asked.zip(summary.max_depth_mm).is_some_and(|(asked, reached)| reached < DEPTH_FLOOR * asked);
    let no_energy = summary.energy.is_empty();
    let flags = &mut summary.flags;
    flags.insert_if(cycle.outcome == Outcome::Aborted, Flag::Aborted);
    flags.insert_if(cycle.started_at < EARLIEST_CLOCK, Flag::ClockSuspect);
    flags.insert_if(context.operation.is_none(), Flag::OperationUnregistered);
    flags.insert_if(no_energy, Flag::NoEnergy);
    flags.insert_if(short, Flag::Incomplete);
    flags.insert_if(contradictory, Flag::Contradictory);
    flags.insert_if(cycle.reference == Some(true), Flag::ReferenceCycle);
    flags.insert_if(cycle.reference == Some(false), Flag::NoReferenceCycle);
    summary
}

fn of_reported(cycle: &Cycle) -> CycleSummary {
    let reported = &cycle.reported;
    let mut flags = Flags::NONE;
    flag_load(reported.max_spindle_load_percent, &mut flags);
    flag_load(reported.max_feed_drive_load_percent, &mut flags);
    CycleSummary {
        version: SUMMARY_VERSION,
        sample_count: 0,
        duration_ms: reported.duration_ms,
        energy: Vec::new(),
        energy_scale: 0,
        max_depth_mm: reported.max_depth_mm,
        max_spindle_load_percent: told_peak(reported.max_spindle_load_percent),
        max_feed_drive_load_percent: told_peak(reported.max_feed_drive_load_percent),
        max_spindle_power_watts: None,
        max_thrust_newtons: None,
        max_torque_newton_metres: None,
        mean_spindle_load_percent: reported.mean_spindle_load_percent,
        mean_feed_drive_load_percent: reported.mean_feed_drive_load_percent,
        mean_override_percent: None,
        operator_override_percent: reported.operator_override_percent,
        median_spindle_speed_rpm: None,
        spindle_load_fall_depth_mm: None,
        coverage: 1.0,
        digest: None,
        flags,
    }
}

/// A largest load that the control reports.
fn told_peak(value: Option<f64>) -> Option<Peak> {
    value.map(|value| Peak { value, depth_mm: None, time_ms: None })
}

fn flag_load(load_percent: Option<f64>, flags: &mut Flags) {
    flags.insert_if(load_percent.is_some_and(|load| load > 400.0), Flag::LoadOver400);
    flags.insert_if(load_percent.is_some_and(|load| load < 0.0), Flag::NegativeLoad);
}

fn of_samples(samples: &Samples, cycle: &Cycle, context: Context<'_>) -> CycleSummary {
    let clock = SampleClock::of(samples);
    let column = |channel| samples.column(channel);
    let depth = column(Channel::DepthMm);
    let peak = |channel| column(channel).map(|values| loads::peak(values, depth, samples));
    let [mean_spindle_load_percent, mean_feed_drive_load_percent, mean_override_percent, operator_override] =
        clock.means([
            column(Channel::SpindleLoadPercent),
            column(Channel::FeedDriveLoadPercent),
            column(Channel::OverridePercent),
            column(Channel::OperatorOverridePercent),
        ]);
    let commanded = context.commanded_rpm(cycle.spindle_speed_rpm);
    let mut told = energy::by_basis(samples, &clock, commanded, context);
    // Stamps that are all the same say nothing of time, and no energy is 0 because of it.
    let is_timed = clock.duration_ms > 0.0;
    if !is_timed {
        told.energies.clear();
        told.best_by_sample = None;
    }
    let mut flags = loads::flags(samples);
    flags.insert_if(told.is_beyond_calibration, Flag::BeyondCalibration);
    flags.insert_if(told.is_implausible, Flag::ImplausibleEnergy);
    flags.insert_if(clock.has_gaps(), Flag::Gaps);
    // Of a channel that is not sampled, what the control reports is all there is.
    let reported = &cycle.reported;
    let unsampled = |channel, value: Option<f64>| value.filter(|_| column(channel).is_none());
    let told_spindle = unsampled(Channel::SpindleLoadPercent, reported.max_spindle_load_percent);
    let told_feed_drive = unsampled(Channel::FeedDriveLoadPercent, reported.max_feed_drive_load_percent);
    flag_load(told_spindle, &mut flags);
    flag_load(told_feed_drive, &mut flags);
    let digest =
        told.best_by_sample.and_then(|joules| digest::of(samples, &clock, cycle, context, (&joules, flags)));
    CycleSummary {
        version: SUMMARY_VERSION,
        sample_count: u32::try_from(samples.len()).unwrap_or(u32::MAX),
        duration_ms: is_timed.then_some(clock.duration_ms).or(reported.duration_ms),
        energy: told.energies,
        energy_scale: 0,
        max_depth_mm: depth.map(scan::largest).or(reported.max_depth_mm),
        max_spindle_load_percent: peak(Channel::SpindleLoadPercent).or(told_peak(told_spindle)),
        max_feed_drive_load_percent: peak(Channel::FeedDriveLoadPercent).or(told_peak(told_feed_drive)),
        max_spindle_power_watts: peak(Channel::SpindlePowerWatts),
        max_thrust_newtons: peak(Channel::ThrustNewtons),
        max_torque_newton_metres: peak(Channel::TorqueNewtonMetres),
        mean_spindle_load_percent: mean_spindle_load_percent
            .or(unsampled(Channel::SpindleLoadPercent, reported.mean_spindle_load_percent)),
        mean_feed_drive_load_percent: mean_feed_drive_load_percent
            .or(unsampled(Channel::FeedDriveLoadPercent, reported.mean_feed_drive_load_percent)),
        mean_override_percent,
        operator_override_percent: operator_override.or(reported.operator_override_percent),
        median_spindle_speed_rpm: loads::turning_speed(samples),
        spindle_load_fall_depth_mm: loads::fall_depth(samples),
        coverage: clock.coverage,
        digest,
        flags,
    }
}

/// Whether what the control reports disagrees with what was sampled by more than a tenth.
fn contradicts(cycle: &Cycle, summary: &CycleSummary) -> bool {
    if cycle.samples.is_none() {
        return false;
    }
    let apart = |told: Option<f64>, seen: Option<f64>| match (told, seen) {
        (Some(told), Some(seen)) => (told - seen).abs() > 0.1 * told.abs().max(seen.abs()),
        _ => false,
    };
    // Recordings often stop short of the reported cycle time; only samples longer than the cycle contradict.
    let longer = match (cycle.reported.duration_ms, summary.duration_ms) {
        (Some(told), Some(seen)) => seen > 1.1 * told,
        _ => false,
    };
    longer || apart(cycle.reported.max_depth_mm, summary.max_depth_mm)
}

/// Whether a cycle that is called a reference cycle was run at feeds that differ.
fn contradicts_reference(cycle: &Cycle, summary: &CycleSummary) -> bool {
    cycle.reference == Some(true) && summary.digest.as_ref().is_some_and(|digest| !digest.is_constant_feed())
}

/// Whether a cycle names another process than its operation has.
fn contradicts_operation(cycle: &Cycle, context: Context<'_>) -> bool {
    cycle.process.zip(context.operation).is_some_and(|(process, operation)| process != operation.process)
}

/// How much time each sample stands for.
pub(crate) struct SampleClock {
    /// Time that sample `k` covers, ms; a gap covers only one usual period.
    widths_ms: Widths,
    /// From the start of the first sample's period to the last sample, ms.
    pub(crate) duration_ms: f64,
    /// Covered share of the duration, 0 to 1.
    pub(crate) coverage: f64,
}

enum Widths {
    Even(f64),
    Each(Vec<f64>),
}

/// An interval this many times the usual one is a gap.
const GAP_FACTOR: f64 = 3.0;

impl SampleClock {
    #[expect(clippy::cast_precision_loss, reason = "sample counts are far below 2^53")]
    pub(crate) fn of(samples: &Samples) -> Self {
        match samples.time() {
            TimeBase::Period { period_ms } => Self {
                widths_ms: Widths::Even(*period_ms),
                duration_ms: period_ms * samples.len() as f64,
                coverage: 1.0,
            },
            TimeBase::Stamps { time_ms } => {
                let steps: Vec<f64> = time_ms.windows(2).map(|pair| pair[1] - pair[0]).collect();
                let positive: Vec<f64> = steps.iter().copied().filter(|step| *step > 0.0).collect();
                if positive.is_empty() {
                    return Self {
                        widths_ms: Widths::Each(vec![0.0; time_ms.len()]),
                        duration_ms: 0.0,
                        coverage: 1.0,
                    };
                }
                let usual = loads::median(&positive);
                // The first sample stands for the usual period before it, as every other does for its own.
                let mut widths = Vec::with_capacity(time_ms.len());
                widths.push(usual);
                widths.extend(steps.iter().map(|&step| if step > GAP_FACTOR * usual { usual } else { step }));
                let duration_ms = time_ms[time_ms.len() - 1] - time_ms[0] + usual;
                let covered: f64 = widths.iter().sum();
                Self {
                    widths_ms: Widths::Each(widths),
                    duration_ms,
                    coverage: (covered / duration_ms).min(1.0),
                }
            }
        }
    }

    /// Whether an interval was too long to be one sample's.
    pub(crate) fn has_gaps(&self) -> bool {
        self.coverage < 1.0 - 1e-9
    }

    /// Time that sample `index` stands for, s.
    pub(crate) fn width_s(&self, index: usize) -> f64 {
        match &self.widths_ms {
            Widths::Even(width) => width * 1e-3,
            Widths::Each(widths) => widths[index] * 1e-3,
        }
    }

    /// Multiplies what is told of each sample by the time that it stands for, s.
    pub(crate) fn weigh(&self, values: &mut [f64]) {
        match &self.widths_ms {
            Widths::Even(width) => values.iter_mut().for_each(|value| *value *= width * 1e-3),
            Widths::Each(widths) => {
                values.iter_mut().zip(widths).for_each(|(value, width)| *value *= width * 1e-3);
            }
        }
    }

    /// Means of columns weighted by time; `None` for one that was not sampled, and where no time passes.
    ///
    /// Each is held between the smallest and the largest value of its column, out of which only rounding takes it: the mean of a
    /// constant 200 % is 200 %, and what is valid by each sample is valid by its mean. Of `n` samples it is taken beyond one of
    /// the two by some `n`·2⁻⁵³ of that value: summaries of before, whose means were not held, are the same within what they are
    /// verified to, and their version stays.
    #[expect(clippy::cast_precision_loss, reason = "sample counts are far below 2^53")]
    fn means<const N: usize>(&self, columns: [Option<&[f64]>; N]) -> [Option<f64>; N] {
        let Some(&sampled) = columns.iter().flatten().next() else { return [None; N] };
        // A missing column is summed as another, which costs nothing beside the others, and not told.
        let values = columns.map(|column| column.unwrap_or(sampled));
        let (sums, total) = match &self.widths_ms {
            Widths::Even(_) => (scan::sums(values), sampled.len() as f64),
            Widths::Each(widths) => {
                let weighed = values.map(|values| {
                    values.iter().zip(widths).map(|(value, width)| value * width).collect::<Vec<f64>>()
                });
                (scan::sums(weighed.each_ref().map(Vec::as_slice)), widths.iter().sum())
            }
        };
        let mean = |which: usize, column: &[f64]| {
            let (least, most) = scan::span(column);
            (total > 0.0).then(|| (sums[which] / total).max(least).min(most))
        };
        std::array::from_fn(|which| columns[which].and_then(|column| mean(which, column)))
    }
}

#[cfg(test)]
mod tests;

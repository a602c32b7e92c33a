//! The course of one stored cycle: filtered loads, energy so far, stages and overloads, from the core's functions.

use feedwright_core::cycle::{Channel, Samples};
use feedwright_core::friction::filter::{FilterWeights, LoadFilter};
use feedwright_core::friction::stages::{Mark, StageConfig, Stages, find_stages};
use feedwright_core::summary::{Context, EnergyBasis, energy_course};
use feedwright_core::units::Process;
use feedwright_store::{StoredCycle, Surroundings};

/// Most overloads told of one cycle; a load that trembles around its limit makes many.
pub const MOST_OVERLOADS: usize = 200;
/// How far the course's end may be from the summary's energy, relative: beyond it rests on other ratings or lines.
const SAME_ENERGY: f64 = 1e-6;

/// A place in a cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Number of the sample, from 0.
    pub index: usize,
    /// Time since the start of the cycle, ms.
    pub time_ms: f64,
    /// Depth, mm.
    pub depth_mm: Option<f64>,
}

/// A stage of the hole, as the loads tell it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StageSpan {
    /// `A` to `D`.
    pub stage: &'static str,
    /// Where it begins.
    pub from: Place,
    /// Where it ends.
    pub to: Place,
    /// Its energy, J.
    pub energy_joules: Option<f64>,
}

/// A stretch with the filtered load over the operation's set load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Overload {
    /// `feed_drive` or `spindle`.
    pub drive: &'static str,
    /// Where it begins.
    pub from: Place,
    /// Where it ends.
    pub to: Place,
    /// The highest filtered load, %.
    pub highest_percent: f64,
}

/// The course of a cycle.
#[derive(Debug, Clone, Default)]
pub struct Course {
    /// Feed-drive load as the control filters it, %.
    pub filtered_feed_drive: Option<Vec<f64>>,
    /// Spindle load likewise.
    pub filtered_spindle: Option<Vec<f64>>,
    /// Energy so far on the summary's best basis, J.
    pub energy: Option<(EnergyBasis, Vec<f64>)>,
    /// First contact.
    pub contact: Option<Place>,
    /// The stages that were found, in their order.
    pub stages: Vec<StageSpan>,
    /// Set loads of the operation: feed drive, spindle, %.
    pub set_percent: (Option<f64>, Option<f64>),
    /// Overloads after first contact, feed drive before spindle, each in its order.
    pub overloads: Vec<Overload>,
    /// Whether there were more.
    pub overloads_cut: bool,
}

/// Tells the course of a cycle from its samples.
pub fn course(stored: &StoredCycle, samples: &Samples, around: &Surroundings) -> Course {
    let (feed, spindle) =
        (samples.column(Channel::FeedDriveLoadPercent), samples.column(Channel::SpindleLoadPercent));
    let operation = around.operation.as_ref();
    let process = stored.cycle.process.or_else(|| operation.map(|operation| operation.process));
    let stages = match (process, samples.column(Channel::DepthMm), feed, spindle) {
        (Some(Process::Friction), Some(depth), Some(feed), Some(spindle)) => {
            find_stages(&StageConfig::default(), depth, feed, spindle).ok()
        }
        _ => None,
    };
    let energy = energy(stored, samples, around);
    let set_percent = (
        operation.and_then(|operation| operation.feed_drive_load_set_percent),
        operation.and_then(|operation| operation.spindle_load_set_percent),
    );
    let at = |index: usize| place(samples, index);
    let contact = stages.and_then(|stages| stages.contact).map(|mark| at(mark.index));
    let mut course = Course {
        filtered_feed_drive: feed.map(filtered),
        filtered_spindle: spindle.map(filtered),
        contact,
        set_percent,
        ..Course::default()
    };
    let begin = contact.map_or(0, |contact| contact.index);
    for (drive, column, set) in [
        ("feed_drive", &course.filtered_feed_drive, set_percent.0),
        ("spindle", &course.filtered_spindle, set_percent.1),
    ] {
        if let (Some(column), Some(set)) = (column, set) {
            course.overloads.extend(overloads(drive, column, set, begin, &at));
        }
    }
    course.overloads_cut = course.overloads.len() > MOST_OVERLOADS;
    course.overloads.truncate(MOST_OVERLOADS);
    let joules = energy.as_ref().map(|(_, joules)| joules.as_slice());
    course.stages = stages.map(|stages| spans(&stages, samples, joules)).unwrap_or_default();
    course.energy = energy;
    course
}

fn filtered(column: &[f64]) -> Vec<f64> {
    let (weights, mut filter) = (FilterWeights::default(), LoadFilter::new());
    column.iter().map(|&load| filter.step(&weights, load)).collect()
}

fn energy(stored: &StoredCycle, samples: &Samples, around: &Surroundings) -> Option<(EnergyBasis, Vec<f64>)> {
    let best = stored.summary.best_energy()?;
    let context = Context {
        machine: &around.machine,
        calibration: around.calibration.as_ref(),
        operation: around.operation.as_ref(),
    };
    let commanded = context.commanded_rpm(stored.cycle.spindle_speed_rpm);
    let joules = energy_course(samples, commanded, context, best.basis)?;
    let whole = *joules.last()?;
    // The machine may have been rated or fitted anew since: then this is not the course of that energy.
    let same = (whole - best.total_joules).abs() <= SAME_ENERGY * best.total_joules.abs().max(1.0);
    same.then_some((best.basis, joules))
}

fn place(samples: &Samples, index: usize) -> Place {
    let depth_mm = samples.column(Channel::DepthMm).map(|depth| depth[index]);
    Place { index, time_ms: samples.time_ms(index), depth_mm }
}

fn overloads(
    drive: &'static str,
    column: &[f64],
    set: f64,
    begin: usize,
    at: &impl Fn(usize) -> Place,
) -> Vec<Overload> {
    let mut found = Vec::new();
    let mut open: Option<(usize, f64)> = None;
    for (index, &load) in column.iter().enumerate().skip(begin) {
        open = match (open, load > set) {
            (None, true) => Some((index, load)),
            (Some((from, highest)), true) => Some((from, highest.max(load))),
            (Some((from, highest)), false) => {
                found.push(Overload { drive, from: at(from), to: at(index), highest_percent: highest });
                None
            }
            (None, false) => None,
        };
    }
    if let Some((from, highest)) = open {
        let last = column.len() - 1;
        found.push(Overload { drive, from: at(from), to: at(last), highest_percent: highest });
    }
    found
}

fn spans(stages: &Stages, samples: &Samples, joules: Option<&[f64]>) -> Vec<StageSpan> {
    let deepest = samples.column(Channel::DepthMm).and_then(|depth| {
        let deeper = |(_, a): &(usize, &f64), (_, b): &(usize, &f64)| a.total_cmp(b);
        depth.iter().enumerate().max_by(deeper).map(|(index, _)| index)
    });
    let index = |mark: Option<Mark>| mark.map(|mark| mark.index);
    // A stage whose end was not found runs to the deepest point, and none follows it.
    let bounds = [
        index(stages.contact),
        index(stages.thrust_maximum),
        index(stages.torque_maximum),
        index(stages.flange),
    ];
    let mut found = Vec::new();
    for (number, stage) in ["A", "B", "C", "D"].into_iter().enumerate() {
        let Some(from) = bounds[number] else { break };
        let Some(to) = bounds.get(number + 1).copied().flatten().or(deepest).filter(|to| *to > from) else {
            break;
        };
        let energy_joules = joules.map(|joules| joules[to] - joules[from]);
        found.push(StageSpan { stage, from: place(samples, from), to: place(samples, to), energy_joules });
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_overload_lasts_from_the_first_sample_over_to_the_first_one_under() {
        let at = |index: usize| Place { index, time_ms: 0.0, depth_mm: None };
        let found = overloads("spindle", &[50.0, 1.0, 41.0, 43.0, 40.0, 39.0, 44.0], 40.0, 1, &at);
        let told: Vec<_> =
            found.iter().map(|one| (one.from.index, one.to.index, one.highest_percent)).collect();
        // The peak before contact is none; what lies on the limit is not over it; the last one is still open.
        assert_eq!(told, [(2, 4, 43.0), (6, 6, 44.0)]);
    }
}

//! Readings of a drive that is dead: a stopped sensor, a cut wire, a bus that repeats its last value.
//!
//! Taken for an air cut, a dead reading would raise the feed, and unknown never does. What gives it away is that a
//! live reading changes: with depth, heat and unevenness, or at least by one step of its resolution. So a drive is dead
//! where its reading does not change at all over a stretch that is long beside the way in contact, while the depth goes on
//! and the other drive shows work, and where it reads exactly 0 although it never did so in the air.
//!
//! How long is long is set so that noisy recordings of the study's process models, as they are and in steps of 0.1 and
//! of 1 %, are not taken for dead: with steps of 1 % a feed drive that idles behind its thrust maximum, while the torque
//! still falls, stands still for long. Such shorter stretches stay in the recording and tell nothing.

use super::course::Sample;
use super::recording::SkipReason;

/// Change of a reading that is none, points.
const NO_CHANGE: f64 = 1e-6;

/// Fewest samples of a still stretch: fewer equal ones in a row are chance where readings come in steps.
const FEWEST_STILL: usize = 8;

/// Share of the way in contact from which a still stretch is looked at.
const LEAST_WAY: f64 = 0.1;

/// Share of the way from which a drive that stands is dead, whatever it reads, while the other one works.
const DEAD_WAY: f64 = 0.6;

/// The same for one that stands above idle while the other one's load changes by [`DEAD_CHANGE`] of its peak.
const DEAD_WAY_ABOVE_IDLE: f64 = 0.3;
const DEAD_CHANGE: f64 = 0.5;

/// Change of the other drive, of its peak, from which a stretch above idle tells nothing.
const UNTOLD_CHANGE: f64 = 0.3;

/// Load of the other drive, of its peak, at which it works somewhere in a stretch, and at which it works at one sample.
const WORKS: f64 = 0.5;
const WORKS_HERE: f64 = 0.1;

/// Load over idle, points, up to which a drive stands at idle: a step of 1 % either way, and what it is read with.
const AT_IDLE: f64 = 1.5;

/// Least reading in the air, points, beside which 0 in contact is no reading: a drive that moves draws something.
const LEAST_AIR: f64 = 1.0;

/// Fewest samples in the air that tell what a drive reads there.
const FEWEST_AIR: usize = 5;

/// What is known of the loads beside the samples in contact.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beside {
    /// Idle loads, percent.
    pub(super) idle: [f64; 2],
    /// Load over idle from which a drive surely works, points.
    pub(super) told: [f64; 2],
    /// Lowest reading in the air, percent; `None` where too few samples tell it.
    pub(super) air: [Option<f64>; 2],
}

/// Lowest reading of each drive before contact.
pub(super) fn lowest_in_air(samples: &[Sample]) -> [Option<f64>; 2] {
    let air: Vec<&Sample> = samples.iter().filter(|sample| sample.depth_mm < -0.05).collect();
    [0, 1].map(|drive| {
        let lowest = air.iter().map(|sample| sample.load[drive]).fold(f64::INFINITY, f64::min);
        (air.len() >= FEWEST_AIR).then_some(lowest)
    })
}

/// Whether each sample in contact tells the loads, in the order of time.
///
/// # Errors
/// The drive that is dead, so that the recording is to be left out.
pub(super) fn told(samples: &[Sample], beside: Beside) -> Result<Vec<bool>, SkipReason> {
    let mut told = vec![true; samples.len()];
    let way_mm = samples.iter().map(|sample| sample.depth_mm).fold(0.0, f64::max);
    for (drive, dead) in [SkipReason::DeadFeedDriveLoad, SkipReason::DeadSpindleLoad].into_iter().enumerate()
    {
        let never_zero = beside.air[drive].is_some_and(|lowest| lowest >= LEAST_AIR);
        let mut zero_way = 0.0;
        let mut from = 0;
        while from < samples.len() {
            let value = samples[from].load[drive];
            let still = |sample: &Sample| (sample.load[drive] - value).abs() <= NO_CHANGE;
            let count = samples[from..].iter().take_while(|sample| still(sample)).count();
            let (stretch, mask) = (&samples[from..from + count], &mut told[from..from + count]);
            from += count;
            let deepest = stretch.iter().map(|sample| sample.depth_mm).fold(0.0, f64::max);
            let way = (deepest - stretch[0].depth_mm) / way_mm;
            if never_zero && value.abs() <= NO_CHANGE {
                zero_way += way;
                mask.fill(false);
            }
            if zero_way >= LEAST_WAY {
                return Err(dead);
            }
            if way >= LEAST_WAY && count >= FEWEST_STILL && stands(samples, stretch, mask, drive, way, beside)
            {
                return Err(dead);
            }
        }
    }
    Ok(told)
}

/// Whether a drive that stands over a stretch is dead; where it may be, the samples that tell nothing are marked.
fn stands(
    samples: &[Sample],
    stretch: &[Sample],
    mask: &mut [bool],
    drive: usize,
    way: f64,
    beside: Beside,
) -> bool {
    let other = 1 - drive;
    let over = |sample: &Sample| sample.load[other] - beside.idle[other];
    let peak = samples.iter().map(over).fold(0.0, f64::max);
    let low = stretch.iter().map(over).fold(f64::INFINITY, f64::min);
    let high = stretch.iter().map(over).fold(f64::NEG_INFINITY, f64::max);
    let changes = |share: f64| high - low >= (share * peak).max(beside.told[other]);
    let above = stretch[0].load[drive] - beside.idle[drive] > AT_IDLE;
    let works = high >= (WORKS * peak).max(beside.told[other]);
    if way >= DEAD_WAY && (works || above) || above && way >= DEAD_WAY_ABOVE_IDLE && changes(DEAD_CHANGE) {
        return true;
    }
    if above && changes(UNTOLD_CHANGE) {
        mask.fill(false);
    }
    if !above {
        for (told, sample) in mask.iter_mut().zip(stretch) {
            *told &= over(sample) < (WORKS_HERE * peak).max(beside.told[other]);
        }
    }
    false
}

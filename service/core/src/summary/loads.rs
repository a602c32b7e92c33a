//! Maxima with their place, medians, the falling edge of the spindle load, and flags seen in the samples.

use super::{LEAST_TURNING, SURFACE_MM, scan};
use crate::cycle::{Channel, Flag, Flags, Samples};
use crate::invalid::Range;

/// A largest value with where and when it was reached first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// The value in the unit of its channel.
    pub value: f64,
    /// Depth at which it was reached, mm, where depth was sampled.
    pub depth_mm: Option<f64>,
    /// Time since the start of the cycle, ms, where samples exist.
    pub time_ms: Option<f64>,
}

/// How far a feature of the spindle load moved in depth against the baseline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeakShift {
    /// Median over the baseline's cycles, mm.
    pub baseline_mm: f64,
    /// Median over the last counted cycles, mm.
    pub now_mm: f64,
}

impl PeakShift {
    /// The shift, mm; positive is deeper.
    pub fn shift_mm(&self) -> f64 {
        self.now_mm - self.baseline_mm
    }
}

/// Loads that a control may report are sane up to here, %.
const SANE_LOAD_PERCENT: f64 = 400.0;

/// A reversal smaller than this is the quantisation or the noise of the encoder, mm.
const REVERSAL_MM: f64 = 0.05;

/// The spindle load counts as fallen at this share of its maximum.
const FALLEN: f64 = 0.5;

pub(super) fn peak(values: &[f64], depth: Option<&[f64]>, samples: &Samples) -> Peak {
    let at = first_largest(values).unwrap_or(0);
    Peak { value: values[at], depth_mm: depth.map(|depth| depth[at]), time_ms: Some(samples.time_ms(at)) }
}

/// Median of the spindle speed over samples in the work at which it turns, rpm: how long a recording stands or spins up before it says
/// nothing of the speed that cut. Where depth was not sampled, or says nothing of work, over all at which it turns; `None` where none is.
pub(super) fn turning_speed(samples: &Samples) -> Option<f64> {
    let speed = samples.column(Channel::SpindleSpeedRpm)?;
    let fastest = speed.iter().fold(0.0, |fastest: f64, rpm| fastest.max(rpm.abs()));
    let turns = |rpm: f64| rpm != 0.0 && rpm.abs() >= LEAST_TURNING * fastest;
    let depth = samples.column(Channel::DepthMm);
    let of = |in_work: &dyn Fn(usize) -> bool| {
        let chosen = speed.iter().enumerate().filter(|(at, rpm)| turns(**rpm) && in_work(*at));
        chosen.map(|(_, rpm)| *rpm).collect::<Vec<f64>>()
    };
    let mut chosen = depth.map(|depth| of(&|at| depth[at] > SURFACE_MM)).unwrap_or_default();
    if chosen.is_empty() {
        chosen = of(&|_| true);
    }
    (!chosen.is_empty()).then(|| median_in_place(&mut chosen))
}

/// Place of the largest value, of the first where several are.
#[expect(clippy::float_cmp, reason = "it is one of them")]
fn first_largest(values: &[f64]) -> Option<usize> {
    let largest = scan::largest(values);
    scan::first(values, |value| value == largest)
}

/// Values that are sorted without asking for memory: as many as a window of wear holds.
const FEW: usize = 64;

/// Median; the mean of the two middle values where their number is even.
///
/// # Panics
/// Where `values` is empty.
pub fn median(values: &[f64]) -> f64 {
    if values.len() > FEW {
        return median_in_place(&mut values.to_vec());
    }
    let mut few = [0.0; FEW];
    let few = &mut few[..values.len()];
    few.copy_from_slice(values);
    median_in_place(few)
}

/// As [`median`], of values that may be put in another order.
pub(crate) fn median_in_place(values: &mut [f64]) -> f64 {
    let (length, middle) = (values.len(), values.len() / 2);
    let (below, upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let upper = *upper;
    if length % 2 == 1 {
        upper
    } else {
        let lower = below.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        f64::midpoint(lower, upper)
    }
}

/// Where the spindle load, after its maximum in the cut, has fallen to half of it, mm.
///
/// Only samples at depth 0 or more count: the peak of spinning up comes before contact and is no stage.
pub(super) fn fall_depth(samples: &Samples) -> Option<f64> {
    let depth = samples.column(Channel::DepthMm)?;
    let load = samples.column(Channel::SpindleLoadPercent)?;
    let in_the_cut = |(&load, &depth): (&f64, &f64)| if depth >= 0.0 { load } else { f64::NEG_INFINITY };
    let cut: Vec<f64> = load.iter().zip(depth).map(in_the_cut).collect();
    let top = first_largest(&cut)?;
    // Also where nothing is in the cut.
    if cut[top] <= 0.0 {
        return None;
    }
    let level = FALLEN * load[top];
    let before = top + scan::first(&load[top + 1..], |load| load <= level)?;
    let after = before + 1;
    // Between two samples the depth of the crossing is interpolated, else the feed would quantise it.
    let share = (load[before] - level) / (load[before] - load[after]);
    // Rounding takes it beyond both depths by some last bits, and beyond what a depth may be where one of them is at that end.
    // Held to that end alone: near depth 0 those bits are many parts of it, and summaries of before were not held at all.
    let Range { min, max, .. } = Channel::DepthMm.range();
    Some((depth[before] + share * (depth[after] - depth[before])).clamp(min, max))
}

pub(super) fn flags(samples: &Samples) -> Flags {
    let mut flags = Flags::NONE;
    let is_zero = |value: f64| value == 0.0;
    flags.insert_if(any(samples, Channel::FeedActualMmMin, is_zero), Flag::FeedHold);
    flags.insert_if(any(samples, Channel::OverridePercent, is_zero), Flag::OverrideZero);
    for channel in [Channel::SpindleLoadPercent, Channel::FeedDriveLoadPercent] {
        flags.insert_if(any(samples, channel, |value| value < 0.0), Flag::NegativeLoad);
        flags.insert_if(any(samples, channel, |value| value > SANE_LOAD_PERCENT), Flag::LoadOver400);
    }
    for channel in [Channel::SpindlePowerWatts, Channel::FeedDrivePowerWatts] {
        flags.insert_if(any(samples, channel, |value| value < 0.0), Flag::NegativePower);
    }
    flags.insert_if(samples.column(Channel::DepthMm).is_some_and(reverses), Flag::DepthReversal);
    flags
}

/// Whether any value of a channel passes; most cycles have none that does.
fn any(samples: &Samples, channel: Channel, test: impl Fn(f64) -> bool) -> bool {
    samples.column(channel).is_some_and(|values| scan::any(values, test))
}

/// Whether the depth comes back and then goes deeper again, as in pecking; the final retract is none.
fn reverses(depth: &[f64]) -> bool {
    let mut deepest = f64::NEG_INFINITY;
    let mut lowest_since = f64::INFINITY;
    for &z in depth {
        if z > lowest_since + REVERSAL_MM && lowest_since < deepest - REVERSAL_MM {
            return true;
        }
        if z > deepest {
            deepest = z;
            lowest_since = z;
        } else if z < lowest_since {
            lowest_since = z;
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cycle::TimeBase;
    use proptest::prelude::{prop_assert_eq, proptest};

    proptest! {
        #[test]
        fn a_median_is_the_middle_of_the_sorted_values(
            values in proptest::collection::vec(-1e6..1e6_f64, 1..3 * FEW),
        ) {
            let mut sorted = values.clone();
            sorted.sort_by(f64::total_cmp);
            let middle = sorted.len() / 2;
            let expected = match sorted.len() % 2 {
                1 => sorted[middle],
                _ => f64::midpoint(sorted[middle - 1], sorted[middle]),
            };
            prop_assert_eq!(median(&values).to_bits(), expected.to_bits());
        }

        #[test]
        fn peaks_and_the_fall_are_where_a_plain_loop_finds_them(
            // Few different values, so that the largest comes again.
            rows in proptest::collection::vec((-3..4_i8, -2..6_i8), 1..90),
        ) {
            let depth: Vec<f64> = rows.iter().map(|row| f64::from(row.0)).collect();
            let load: Vec<f64> = rows.iter().map(|row| f64::from(row.1)).collect();
            let columns = vec![(Channel::DepthMm, depth.clone()), (Channel::SpindleLoadPercent, load.clone())];
            let samples = Samples::new(TimeBase::Period { period_ms: 10.0 }, columns, 100).unwrap();
            let highest = |from_mm: f64| {
                let mut top: Option<usize> = None;
                for index in 0..load.len() {
                    if depth[index] >= from_mm && top.is_none_or(|top| load[index] > load[top]) {
                        top = Some(index);
                    }
                }
                top
            };
            let at = highest(f64::NEG_INFINITY).unwrap();
            let expected = Peak { value: load[at], depth_mm: Some(depth[at]), time_ms: Some(samples.time_ms(at)) };
            prop_assert_eq!(peak(&load, Some(&depth), &samples), expected);
            let fall = highest(0.0).filter(|top| load[*top] > 0.0).and_then(|top| {
                let after = (top + 1..load.len()).find(|index| load[*index] <= FALLEN * load[top])?;
                let share = (load[after - 1] - FALLEN * load[top]) / (load[after - 1] - load[after]);
                Some(depth[after - 1] + share * (depth[after] - depth[after - 1]))
            });
            prop_assert_eq!(fall_depth(&samples), fall);
        }
    }
}

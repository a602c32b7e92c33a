//! Prediction against actual, and what it says about the next prediction.

use super::predict::{BAND, Band, Prediction};
use super::recording::{LoadSignal, RecordedCycle, SkipReason};
use super::settings::Settings;
use crate::cycle::Extent;
use crate::friction::filter::{FilterWeights, LoadFilter};

/// Weight of "the spread is as told" in comparisons.
const PRIOR_WEIGHT: f64 = 6.0;

/// Bounds of the factor on the spread.
const SCALES: std::ops::RangeInclusive<f64> = 0.7..=4.0;

/// What a cycle did, measured as predictions tell it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Actual {
    /// From contact to the end of the path, s, where the tip first is at the deepest; dwelling and the way out are no part of it.
    pub time_s: f64,
    /// Largest filtered feed-drive load in contact, percent.
    pub peak_feed_drive_percent: f64,
    /// Largest filtered spindle load in contact, percent.
    pub peak_spindle_percent: f64,
    /// Spindle load over idle times time, percent-seconds.
    pub spindle_percent_s: f64,
    /// Time that a filtered load was above (1 + tolerance)·L_set, s.
    pub overload_s: f64,
}

impl Actual {
    /// Measures a cycle; loads pass Stryczek & Błaszczak 2020, Eq. 1, unless they were recorded filtered.
    ///
    /// # Errors
    /// When it is not a whole cycle, its columns differ in length or fewer than two samples are in contact.
    pub fn of(
        cycle: &RecordedCycle,
        settings: &Settings,
        idle_spindle_percent: f64,
    ) -> Result<Self, SkipReason> {
        match cycle.extent {
            Extent::Whole => {}
            Extent::Aborted => return Err(SkipReason::Aborted),
            Extent::CutShort => return Err(SkipReason::CutShort),
        }
        cycle.check(&cycle.operation)?;
        let filtered = matches!(cycle.signal, LoadSignal::Filtered(_));
        let weights = FilterWeights::default();
        let mut filters = [LoadFilter::new(), LoadFilter::new()];
        let mut actual = Self {
            time_s: 0.0,
            peak_feed_drive_percent: 0.0,
            peak_spindle_percent: 0.0,
            spindle_percent_s: 0.0,
            overload_s: 0.0,
        };
        let mut before: Option<f64> = None;
        let set = settings.set_percent();
        for at in 0..cycle.time_s.len().min(cycle.end_of_way() + 1) {
            let (time, depth) = (cycle.time_s[at], cycle.depth_mm[at]);
            let raw = [cycle.feed_drive_percent[at], cycle.spindle_percent[at]];
            if !(time.is_finite() && depth.is_finite() && raw.iter().all(|load| load.is_finite()))
                || depth < 0.0
            {
                continue;
            }
            let dt = before.map_or(0.0, |before| (time - before).max(0.0));
            before = Some(time);
            let load = [0, 1]
                .map(|drive| if filtered { raw[drive] } else { filters[drive].step(&weights, raw[drive]) });
            actual.time_s += dt;
            actual.peak_feed_drive_percent = actual.peak_feed_drive_percent.max(load[0]);
            actual.peak_spindle_percent = actual.peak_spindle_percent.max(load[1]);
            actual.spindle_percent_s += (raw[1] - idle_spindle_percent) * dt;
            if (0..2).any(|drive| load[drive] > set[drive] * (1.0 + settings.tolerance_ratio)) {
                actual.overload_s += dt;
            }
        }
        if actual.time_s <= 0.0 {
            return Err(SkipReason::TooShort);
        }
        Ok(actual)
    }
}

/// One figure, predicted and actual.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation {
    /// What was predicted.
    pub predicted: Band,
    /// What happened.
    pub actual: f64,
    /// Actual over expected, minus 1.
    pub relative: f64,
    /// Whether it lies in the band.
    pub within: bool,
    /// Standard deviations (of ln) above what was expected; `None` where either is not above 0.
    pub deviations: Option<f64>,
}

/// Filtered loads of every usable sample in contact on the way in, after the depth there.
pub(super) fn filtered(cycle: &RecordedCycle, mut each: impl FnMut(f64, [f64; 2])) {
    let is_filtered = matches!(cycle.signal, LoadSignal::Filtered(_));
    let weights = FilterWeights::default();
    let mut filters = [LoadFilter::new(), LoadFilter::new()];
    let lengths = [cycle.depth_mm.len(), cycle.spindle_percent.len(), cycle.feed_drive_percent.len()];
    let rows = lengths.into_iter().fold(cycle.end_of_way() + 1, usize::min);
    for at in 0..rows {
        let depth = cycle.depth_mm[at];
        let raw = [cycle.feed_drive_percent[at], cycle.spindle_percent[at]];
        if !(depth.is_finite() && raw.iter().all(|load| load.is_finite())) || depth < 0.0 {
            continue;
        }
        each(
            depth,
            [0, 1].map(
                |drive| if is_filtered { raw[drive] } else { filters[drive].step(&weights, raw[drive]) },
            ),
        );
    }
}

impl Deviation {
    fn of(predicted: Band, actual: f64) -> Self {
        let relative = if predicted.expected > 0.0 { actual / predicted.expected - 1.0 } else { 0.0 };
        Self {
            predicted,
            actual,
            relative,
            within: predicted.holds(actual),
            deviations: predicted.deviation(actual),
        }
    }
}

/// A prediction beside what happened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Comparison {
    /// Time, s.
    pub time_s: Deviation,
    /// Largest feed-drive load, percent.
    pub peak_feed_drive_percent: Deviation,
    /// Largest spindle load, percent.
    pub peak_spindle_percent: Deviation,
    /// Spindle work over idle, percent-seconds.
    pub spindle_percent_s: Deviation,
    /// Time above the tolerance, s.
    pub overload_s: f64,
    /// Whether that is longer than tolerated.
    pub overloaded: bool,
}

/// Puts a prediction beside what happened.
#[must_use]
pub fn compare(prediction: &Prediction, actual: &Actual, settings: &Settings) -> Comparison {
    Comparison {
        time_s: Deviation::of(prediction.time_s, actual.time_s),
        peak_feed_drive_percent: Deviation::of(
            prediction.peak_feed_drive_percent,
            actual.peak_feed_drive_percent,
        ),
        peak_spindle_percent: Deviation::of(prediction.peak_spindle_percent, actual.peak_spindle_percent),
        spindle_percent_s: Deviation::of(prediction.spindle_percent_s, actual.spindle_percent_s),
        overload_s: actual.overload_s,
        overloaded: actual.overload_s > settings.tolerated_overload_s,
    }
}

/// Factor on the next predictions' standard deviations ([`super::SettingsParams::spread_scale`]) from how earlier ones
/// turned out: the root mean square of the loads' deviations, drawn towards 1, within 0.7 to 4.
///
/// `scale` is the factor that those predictions were made with.
#[must_use]
pub fn calibrate(comparisons: &[Comparison], scale: f64) -> f64 {
    let mut squares = PRIOR_WEIGHT;
    let mut count = PRIOR_WEIGHT;
    for comparison in comparisons {
        let loads = [
            comparison.peak_feed_drive_percent,
            comparison.peak_spindle_percent,
            comparison.spindle_percent_s,
        ];
        for deviation in loads.iter().filter_map(|load| load.deviations) {
            // One wild cycle is no calibration.
            squares += deviation.clamp(-6.0, 6.0).powi(2) / loads.len() as f64;
            count += 1.0 / loads.len() as f64;
        }
    }
    (scale * (squares / count).sqrt()).clamp(*SCALES.start(), *SCALES.end())
}

/// Share of figures that lay in their bands, and the share that should; `None` of no comparison.
#[must_use]
pub fn coverage(comparisons: &[Comparison]) -> Option<(f64, f64)> {
    let figures: Vec<bool> = comparisons
        .iter()
        .flat_map(|one| {
            [
                one.peak_feed_drive_percent.within,
                one.peak_spindle_percent.within,
                one.spindle_percent_s.within,
            ]
        })
        .collect();
    let within = figures.iter().filter(|within| **within).count();
    (!figures.is_empty()).then(|| (within as f64 / figures.len() as f64, BAND))
}

//! What would have happened: one stored cycle under another law, other limits or another feed program.
//!
//! The cycle's own loads are the anchor. Where the new run is faster or slower at a depth, the load over idle is
//! scaled by the feed ratio to the slope that the new tool's cycles showed there. The answer stands beside what
//! happened and beside the model's error on the very cycle: its loads predicted without the anchor, and the
//! cycle's own control run again.
//!
//! A sample stands for the way and the time behind it. The first one, at contact, has none: it counts for the peaks of what
//! happened, and for no time and no energy, as the prediction begins there too.

use super::energy::torque_energy_j;
use super::error::{Invalid, InvalidCode, all_finite, between, positive, same_length};
use super::law::{LawConfig, LawSample, LawState};
use super::program::FeedProgram;
use super::relation::{DepthProfile, FeedSource, Per, Relation, RelationConfig};
use super::twin::{AxisLimits, AxisState};

/// Most samples of a predicted cycle: ten minutes at 10 ms.
const MOST_SAMPLES: usize = 60_000;

/// Samples on either side over which the anchor's loads are averaged.
const ANCHOR_HALF_WINDOW: usize = 2;

/// Slopes of a load over the feed that are believed. A load over idle does not fall where the tool is driven faster: where
/// few cycles show it, other things differed. Steeper than the square is no drilling either (the feed optimiser's bound).
const SLOPES: std::ops::RangeInclusive<f64> = 0.0..=2.0;

/// Feed over the recorded one to which a load is scaled; beyond it the load stays, as it does where the axis stands. With
/// [`SLOPES`] a load is then at most 10 000 times the recorded one, and a number.
const RATIOS: std::ops::RangeInclusive<f64> = 0.01..=100.0;

/// A stored cycle as columns of equal length, one entry per IPO cycle, from first contact on.
#[derive(Debug, Clone, Copy)]
pub struct StoredCycle<'a> {
    /// Sample period in s.
    pub period_s: f64,
    /// Tip depth in mm.
    pub depth_mm: &'a [f64],
    /// Feed-drive load in percent.
    pub feed_drive_percent: &'a [f64],
    /// Spindle load in percent.
    pub spindle_percent: &'a [f64],
    /// Feed-drive load of the idling axis in percent.
    pub feed_drive_idle_percent: f64,
    /// Spindle load of the idling spindle in percent.
    pub spindle_idle_percent: f64,
    /// Spindle speed in rpm.
    pub spindle_rpm: f64,
    /// Torque that 100 % spindle load stands for, N·m; without it there are no joules.
    pub spindle_rated_torque_nm: Option<f64>,
}

impl StoredCycle<'_> {
    fn check(&self) -> Result<(), Invalid> {
        positive("period_s", self.period_s, 1.0)?;
        between("feed_drive_idle_percent", self.feed_drive_idle_percent, -100.0, 100.0)?;
        between("spindle_idle_percent", self.spindle_idle_percent, -100.0, 100.0)?;
        between("spindle_rpm", self.spindle_rpm, 0.0, 1e6)?;
        if let Some(torque) = self.spindle_rated_torque_nm {
            positive("spindle_rated_torque_nm", torque, 1e6)?;
        }
        if self.depth_mm.len() < 2 {
            return Err(Invalid::new("depth_mm", InvalidCode::Empty, "needs at least two samples"));
        }
        let columns = [
            ("depth_mm", self.depth_mm),
            ("feed_drive_percent", self.feed_drive_percent),
            ("spindle_percent", self.spindle_percent),
        ];
        same_length(&columns)?;
        all_finite(&columns)
    }

    fn joules(&self, spindle_percent: f64) -> Option<f64> {
        let rated = self.spindle_rated_torque_nm?;
        let torque = (spindle_percent - self.spindle_idle_percent) / 100.0 * rated;
        Some(torque_energy_j(torque, self.spindle_rpm, self.period_s))
    }

    fn profile(&self, config: &RelationConfig, load: &[f64], idle: f64) -> Result<DepthProfile, Invalid> {
        let totals: Vec<f64> = load.iter().map(|value| (value - idle) * self.period_s).collect();
        DepthProfile::from_columns(config, self.depth_mm, &totals, self.period_s)
    }
}

/// How both loads depend on depth and feed, learned from cycles of the tool.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadRelations {
    feed_drive: Relation,
    spindle: Relation,
}

impl LoadRelations {
    /// Relations that have seen nothing.
    #[must_use]
    pub fn new(config: RelationConfig) -> Self {
        Self { feed_drive: Relation::new(config), spindle: Relation::new(config) }
    }

    /// Learns from one cycle.
    ///
    /// # Errors
    /// When the cycle's columns do not fit together or hold something that is no number.
    pub fn observe(&mut self, cycle: &StoredCycle<'_>, source: FeedSource) -> Result<(), Invalid> {
        cycle.check()?;
        let config = *self.feed_drive.config();
        let feed = cycle.profile(&config, cycle.feed_drive_percent, cycle.feed_drive_idle_percent)?;
        let spindle = cycle.profile(&config, cycle.spindle_percent, cycle.spindle_idle_percent)?;
        self.feed_drive.observe(&feed, Per::Time, source);
        self.spindle.observe(&spindle, Per::Time, source);
        Ok(())
    }

    /// The relation of the feed-drive load over idle.
    #[must_use]
    pub const fn feed_drive(&self) -> &Relation {
        &self.feed_drive
    }

    /// The relation of the spindle load over idle.
    #[must_use]
    pub const fn spindle(&self) -> &Relation {
        &self.spindle
    }
}

/// How a cycle is controlled.
#[derive(Debug, Clone, PartialEq)]
pub struct Control {
    /// Programmed feed over depth.
    pub program: FeedProgram,
    /// The law on top, if any.
    pub law: Option<LawConfig>,
    /// The feeds that the law may make of the programmed one, mm/min: its override is kept within them, as in a stream.
    pub feeds_mm_min: (f64, f64),
}

impl Control {
    /// A program as it is.
    #[must_use]
    pub const fn of(program: FeedProgram) -> Self {
        Self { program, law: None, feeds_mm_min: ANY_FEED }
    }
}

/// No limit of the feed.
pub const ANY_FEED: (f64, f64) = (0.0, f64::INFINITY);

/// What counts as an overload, for what happened and what is predicted alike; percent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadLimits {
    /// Feed-drive load.
    pub feed_drive_percent: Option<f64>,
    /// Spindle load.
    pub spindle_percent: Option<f64>,
}

/// Figures of a cycle, happened or predicted.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RunFigures {
    /// From contact to the end of the path, s.
    pub duration_s: f64,
    /// Largest feed-drive load, percent.
    pub peak_feed_drive_percent: f64,
    /// Largest spindle load, percent.
    pub peak_spindle_percent: f64,
    /// Energy of the spindle over idle, J; `None` without a rating.
    pub energy_j: Option<f64>,
    /// Time with a load over its limit, s.
    pub overload_s: f64,
}

impl RunFigures {
    fn peak(&mut self, feed_drive: f64, spindle: f64) {
        self.peak_feed_drive_percent = self.peak_feed_drive_percent.max(feed_drive);
        self.peak_spindle_percent = self.peak_spindle_percent.max(spindle);
    }

    /// Takes the period that ends with a sample of these loads.
    fn take(&mut self, cycle: &StoredCycle<'_>, limits: &LoadLimits, feed_drive: f64, spindle: f64) {
        self.duration_s += cycle.period_s;
        self.peak(feed_drive, spindle);
        if let Some(joules) = cycle.joules(spindle) {
            *self.energy_j.get_or_insert(0.0) += joules;
        }
        if limits.are_exceeded(feed_drive, spindle) {
            self.overload_s += cycle.period_s;
        }
    }
}

/// How wrong the model is on the cycle itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SelfError {
    /// Root mean square of the feed-drive load predicted by the relation alone, points.
    pub feed_drive_rms_points: f64,
    /// The same for the spindle load, points.
    pub spindle_rms_points: f64,
    /// The cycle's own control run again: duration over the one that happened, minus 1.
    pub duration_relative: f64,
    /// The same for the energy; `None` without a rating.
    pub energy_relative: Option<f64>,
    /// The same for the peak loads, points (feed drive, spindle).
    pub peak_points: (f64, f64),
}

/// The answer: happened, predicted, and how far the prediction can be trusted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WhatIf {
    /// What happened.
    pub happened: RunFigures,
    /// What is predicted under the other control.
    pub predicted: RunFigures,
    /// The model's error on the cycle itself.
    pub error: SelfError,
    /// Share of the predicted way at depths that the relation has never seen, or at feeds far from what happened there (more
    /// than twice or less than half the recorded one).
    pub extrapolated: f64,
}

impl WhatIf {
    /// Whether every figure is a number.
    fn is_finite(&self) -> bool {
        let run = |figures: &RunFigures| {
            let RunFigures {
                duration_s,
                peak_feed_drive_percent,
                peak_spindle_percent,
                energy_j,
                overload_s,
            } = *figures;
            [duration_s, peak_feed_drive_percent, peak_spindle_percent, energy_j.unwrap_or(0.0), overload_s]
        };
        let SelfError {
            feed_drive_rms_points,
            spindle_rms_points,
            duration_relative,
            energy_relative,
            peak_points,
        } = self.error;
        let error = [
            feed_drive_rms_points,
            spindle_rms_points,
            duration_relative,
            energy_relative.unwrap_or(0.0),
            peak_points.0,
            peak_points.1,
            self.extrapolated,
        ];
        run(&self.happened).into_iter().chain(run(&self.predicted)).chain(error).all(f64::is_finite)
    }
}

/// Runs a stored cycle under `other` control and, to know the error, again under its `own`.
///
/// # Errors
/// When columns or parameters are out of range, when the relations know nothing at the cycle's depths, when
/// the other control would not finish the hole within 60 000 samples, or when a figure would be no number.
pub fn what_if(
    cycle: &StoredCycle<'_>,
    relations: &LoadRelations,
    axis: &AxisLimits,
    limits: &LoadLimits,
    own: &Control,
    other: &Control,
) -> Result<WhatIf, Invalid> {
    cycle.check()?;
    axis.check().map_err(|error| error.within("axis"))?;
    let anchor = Anchor::new(cycle, relations)?;
    let mut happened = RunFigures::default();
    let mut loads = cycle.feed_drive_percent.iter().zip(cycle.spindle_percent);
    if let Some((&feed_drive, &spindle)) = loads.next() {
        happened.peak(feed_drive, spindle);
    }
    for (&feed_drive, &spindle) in loads {
        happened.take(cycle, limits, feed_drive, spindle);
    }
    let (again, _) = anchor.run(axis, limits, own, |_| {})?;
    let (predicted, extrapolated) = anchor.run(axis, limits, other, |_| {})?;
    let (feed_drive_rms_points, spindle_rms_points) = anchor.unanchored_error()?;
    let relative = |now: f64, then: f64| if then > 0.0 { now / then - 1.0 } else { 0.0 };
    let error = SelfError {
        feed_drive_rms_points,
        spindle_rms_points,
        duration_relative: relative(again.duration_s, happened.duration_s),
        energy_relative: again.energy_j.zip(happened.energy_j).map(|(now, then)| relative(now, then)),
        peak_points: (
            again.peak_feed_drive_percent - happened.peak_feed_drive_percent,
            again.peak_spindle_percent - happened.peak_spindle_percent,
        ),
    };
    let answer = WhatIf { happened, predicted, error, extrapolated };
    if answer.is_finite() { Ok(answer) } else { Err(no_number()) }
}

fn no_number() -> Invalid {
    let text =
        "its depths or loads, or those that the relations have seen, are so large that a figure is no number";
    Invalid::new("cycle", InvalidCode::NotFinite, text)
}

/// One sample of a predicted cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PredictedSample {
    /// Tip depth, mm.
    pub depth_mm: f64,
    /// Actual feed, mm/min.
    pub feed_mm_min: f64,
    /// Override in force, percent.
    pub override_percent: f64,
    /// Feed-drive load, percent.
    pub feed_drive_percent: f64,
    /// Spindle load, percent.
    pub spindle_percent: f64,
}

/// The course of what [`what_if`] predicts under `other` control: a sample per period, from contact on.
///
/// # Errors
/// As [`what_if`].
pub fn predicted_course(
    cycle: &StoredCycle<'_>,
    relations: &LoadRelations,
    axis: &AxisLimits,
    other: &Control,
) -> Result<Vec<PredictedSample>, Invalid> {
    cycle.check()?;
    axis.check().map_err(|error| error.within("axis"))?;
    let mut course = Vec::new();
    let unlimited = LoadLimits { feed_drive_percent: None, spindle_percent: None };
    Anchor::new(cycle, relations)?.run(axis, &unlimited, other, |sample| course.push(*sample))?;
    Ok(course)
}

/// One depth of the recorded cycle.
#[derive(Debug, Clone, Copy)]
struct AnchorRow {
    depth_mm: f64,
    feed_mm_min: f64,
    feed_drive: f64,
    spindle: f64,
}

struct Anchor<'a> {
    cycle: &'a StoredCycle<'a>,
    relations: &'a LoadRelations,
    rows: Vec<AnchorRow>,
    slopes: Vec<(f64, f64)>,
    /// Whether both relations have seen a cycle in the bin.
    seen: Vec<bool>,
}

impl<'a> Anchor<'a> {
    fn new(cycle: &'a StoredCycle<'a>, relations: &'a LoadRelations) -> Result<Self, Invalid> {
        let count = cycle.depth_mm.len();
        let mean = |column: &[f64], at: usize| {
            let window =
                &column[at.saturating_sub(ANCHOR_HALF_WINDOW)..(at + ANCHOR_HALF_WINDOW + 1).min(count)];
            #[expect(clippy::cast_precision_loss, reason = "at most five samples")]
            let length = window.len() as f64;
            window.iter().sum::<f64>() / length
        };
        let mut rows: Vec<AnchorRow> = Vec::with_capacity(count);
        for at in 0..count {
            let (from, to) =
                (at.saturating_sub(ANCHOR_HALF_WINDOW), (at + ANCHOR_HALF_WINDOW).min(count - 1));
            #[expect(clippy::cast_precision_loss, reason = "at most five samples")]
            let time_s = (to - from) as f64 * cycle.period_s;
            let feed_mm_min = (cycle.depth_mm[to] - cycle.depth_mm[from]) / time_s * 60.0;
            let depth_mm = cycle.depth_mm[at];
            // Only the way forward anchors: a hold or a peck has no feed to scale from.
            if feed_mm_min <= 0.0 || rows.last().is_some_and(|row| depth_mm <= row.depth_mm) {
                continue;
            }
            rows.push(AnchorRow {
                depth_mm,
                feed_mm_min,
                feed_drive: mean(cycle.feed_drive_percent, at) - cycle.feed_drive_idle_percent,
                spindle: mean(cycle.spindle_percent, at) - cycle.spindle_idle_percent,
            });
        }
        if rows.len() < 2 || relations.spindle.cycles() == 0 {
            let text = "the cycle never goes deeper, or the relations have seen no cycle";
            return Err(Invalid::new("cycle", InvalidCode::NotIdentifiable, text));
        }
        let bins = relations.spindle.config().bins();
        let slope = |relation: &Relation, bin| {
            relation.slope(bin).map_or(0.0, |slope| slope.value.clamp(*SLOPES.start(), *SLOPES.end()))
        };
        let slopes = (0..bins)
            .map(|bin| (slope(&relations.feed_drive, bin), slope(&relations.spindle, bin)))
            .collect();
        let seen = (0..bins)
            .map(|bin| {
                relations.feed_drive.feed_mm_min(bin).is_some()
                    && relations.spindle.feed_mm_min(bin).is_some()
            })
            .collect();
        Ok(Self { cycle, relations, rows, slopes, seen })
    }

    fn row_at(&self, depth_mm: f64) -> AnchorRow {
        let after = self.rows.partition_point(|row| row.depth_mm <= depth_mm);
        self.rows[after.saturating_sub(1)]
    }

    /// Loads in percent at a depth and feed, and whether nobody has seen it: the depth is none of the relations', or the
    /// feed far from the recorded one.
    ///
    /// # Errors
    /// When a load would be no number.
    fn loads(&self, depth_mm: f64, feed_mm_min: f64) -> Result<(f64, f64, bool), Invalid> {
        let row = self.row_at(depth_mm);
        let config = self.relations.spindle.config();
        let bin = config.nearest_bin(depth_mm);
        let (feed_slope, spindle_slope) = self.slopes[bin];
        let ratio = feed_mm_min.max(0.0) / row.feed_mm_min;
        let scale = ratio.clamp(*RATIOS.start(), *RATIOS.end());
        let feed_drive = self.cycle.feed_drive_idle_percent + row.feed_drive * scale.powf(feed_slope);
        let spindle = self.cycle.spindle_idle_percent + row.spindle * scale.powf(spindle_slope);
        if !(feed_drive.is_finite() && spindle.is_finite()) {
            return Err(no_number());
        }
        let seen = self.seen[bin] && depth_mm <= config.params().depth_mm;
        Ok((feed_drive, spindle, !seen || !(0.5..=2.0).contains(&ratio)))
    }

    /// Runs a control over the recorded depths; returns its figures and the share of the way that extrapolates.
    fn run(
        &self,
        axis: &AxisLimits,
        limits: &LoadLimits,
        control: &Control,
        mut watch: impl FnMut(&PredictedSample),
    ) -> Result<(RunFigures, f64), Invalid> {
        let (first, last) = (self.cycle.depth_mm[0], self.rows[self.rows.len() - 1].depth_mm);
        let dt = self.cycle.period_s;
        let mut state = AxisState::moving(first, self.rows[0].feed_mm_min);
        let mut law = LawState::new();
        let mut figures = RunFigures::default();
        let mut outside = 0.0;
        for k in 0..MOST_SAMPLES {
            let before = state.depth_mm();
            let programmed = control.program.feed_at(before);
            let done = state.step(axis, programmed, law.ovr().percent(), last, dt);
            let (feed_drive, spindle, far) = self.loads(state.depth_mm(), state.feed_mm_min())?;
            if far {
                outside += state.depth_mm() - before;
            }
            figures.take(self.cycle, limits, feed_drive, spindle);
            watch(&PredictedSample {
                depth_mm: state.depth_mm(),
                feed_mm_min: state.feed_mm_min(),
                override_percent: law.ovr().percent(),
                feed_drive_percent: feed_drive,
                spindle_percent: spindle,
            });
            if done {
                let way = (last - first).max(f64::MIN_POSITIVE);
                return Ok((figures, outside / way));
            }
            if let Some(config) = &control.law {
                #[expect(clippy::cast_precision_loss, reason = "at most 60 000 samples")]
                let time_ms = (k + 1) as f64 * dt * 1e3;
                let sample = LawSample {
                    time_ms,
                    contact_ms: Some(time_ms),
                    depth_mm: Some(state.depth_mm()),
                    feed_drive_percent: Some(feed_drive),
                    spindle_percent: Some(spindle),
                };
                let ovr = law.ovr();
                let mut step = law.step(config, &sample);
                if step.correction.is_some() {
                    let programmed = control.program.feed_at(state.depth_mm());
                    let (least, most) = control.feeds_mm_min;
                    let permitted = (100.0 * least / programmed, 100.0 * most / programmed);
                    law.keep_within_feed(config, permitted, ovr, &mut step);
                }
            }
        }
        let text = "the hole would not be finished within 60 000 samples";
        Err(Invalid::new("other", InvalidCode::OutOfRange, text))
    }

    /// Root mean square of measured minus predicted loads, where the relation alone predicts.
    fn unanchored_error(&self) -> Result<(f64, f64), Invalid> {
        let (mut feed, mut spindle, mut count) = (0.0, 0.0, 0.0);
        for row in &self.rows {
            let at = |relation: &Relation| relation.at_depth(row.depth_mm, row.feed_mm_min);
            let (Some(f), Some(s)) = (at(&self.relations.feed_drive), at(&self.relations.spindle)) else {
                continue;
            };
            feed += (row.feed_drive - f.value).powi(2);
            spindle += (row.spindle - s.value).powi(2);
            count += 1.0;
        }
        if count < 1.0 {
            let text = "the relations know nothing at the depths of this cycle";
            return Err(Invalid::new("relations", InvalidCode::NotIdentifiable, text));
        }
        Ok(((feed / count).sqrt(), (spindle / count).sqrt()))
    }
}

#[cfg(test)]
mod tests;

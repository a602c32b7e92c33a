//! The stage detector: state and step.

use super::average::Average;
use super::config::{StageConfig, StageParams};

/// Weight of a new sample in the running idle load; about 50 samples of memory.
const IDLE_WEIGHT: f64 = 0.02;

/// A rise that may be contact stops the idle load from learning: this many of its deviations, and this part of
/// the rise that means contact. Else a slow first rise would teach the detector that it is idling.
const SUSPICIOUS: (f64, f64) = (2.5, 0.5);

/// A speed below this part of the one at the maximum is the end of the path, not a stage.
const STOPPING: f64 = 0.2;

/// Way back that ends a hole, mm.
const RETRACT_MM: f64 = 0.2;

/// Loads are put on a common speed by no shorter way of a sample, mm.
const LEAST_WAY_MM: f64 = 1e-6;

/// One sample of a hole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StageSample {
    /// Tip depth in mm; its zero may be anywhere.
    pub depth_mm: f64,
    /// Feed-drive load in percent.
    pub feed_drive_percent: f64,
    /// Spindle load in percent.
    pub spindle_percent: f64,
}

/// Where the tool is, as far as the loads have told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Before contact.
    Air,
    /// Contact to the largest thrust.
    A,
    /// To the largest torque.
    B,
    /// Idle travel.
    C,
    /// Forming of the flange.
    D,
    /// Drawn back.
    Done,
}

/// A place in the stream.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    /// Number of the sample, from 0.
    pub index: usize,
    /// Tip depth there in mm.
    pub depth_mm: f64,
}

/// What was found so far; what the hole did not show is `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stages {
    /// First contact: start of A.
    pub contact: Option<Mark>,
    /// Largest thrust: end of A.
    pub thrust_maximum: Option<Mark>,
    /// Where the thrust has fallen off: the sheet is open.
    pub breakthrough: Option<Mark>,
    /// Largest torque: end of B.
    pub torque_maximum: Option<Mark>,
    /// Where the torque has fallen to half: steadier than the maximum, and it moves with wear.
    pub falling_edge: Option<Mark>,
    /// Start of the flange: end of C, start of D.
    pub flange: Option<Mark>,
}

#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Extreme {
    value: f64,
    mark: Option<Mark>,
    way_mm: f64,
}

impl Extreme {
    /// Takes a value if it is higher, and says so.
    fn raise(&mut self, value: f64, way_mm: f64, here: Mark) -> bool {
        let is_higher = value > self.value;
        if is_higher {
            *self = Self { value, mark: Some(here), way_mm };
        }
        is_higher
    }
}

/// Loads over idle: put on a common speed, and as they are.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Loads {
    thrust: f64,
    torque: f64,
    raw_thrust: f64,
    raw_torque: f64,
}

impl Loads {
    fn zip(self, other: Self, pick: fn(f64, f64) -> f64) -> Self {
        Self {
            thrust: pick(self.thrust, other.thrust),
            torque: pick(self.torque, other.torque),
            raw_thrust: pick(self.raw_thrust, other.raw_thrust),
            raw_torque: pick(self.raw_torque, other.raw_torque),
        }
    }
}

/// `base` to that power; the usual powers of 1 and ½ need little computing.
fn power(base: f64, exponent: f64) -> f64 {
    if exponent.to_bits() == 1.0_f64.to_bits() {
        base
    } else if exponent.to_bits() == 0.5_f64.to_bits() {
        base.sqrt()
    } else {
        base.powf(exponent)
    }
}

/// A load as it would be at a common speed, of a sample that made so much way.
fn on_common_speed(load: f64, way_mm: f64, exponent: f64) -> f64 {
    load / power(way_mm.max(LEAST_WAY_MM), exponent)
}

/// Memory of the detector within one hole.
#[derive(Debug, Clone, PartialEq)]
pub struct StageDetector {
    stage: Stage,
    found: Stages,
    average: Average<3>,
    index: usize,
    idle_seen: u32,
    idle_mean: f64,
    idle_deviation: f64,
    above: u32,
    first_above: Option<Mark>,
    spindle_idle: Option<f64>,
    deepest_mm: Option<f64>,
    thrust: Extreme,
    torque: Extreme,
    high: Loads,
    low: Loads,
    low_mark: Option<Mark>,
    pending: Option<Mark>,
}

impl Default for StageDetector {
    fn default() -> Self {
        Self::new()
    }
}

impl StageDetector {
    /// A detector that has seen nothing.
    #[must_use]
    pub fn new() -> Self {
        Self {
            stage: Stage::Air,
            found: Stages::default(),
            average: Average::new(),
            index: 0,
            idle_seen: 0,
            idle_mean: 0.0,
            idle_deviation: 0.0,
            above: 0,
            first_above: None,
            spindle_idle: None,
            deepest_mm: None,
            thrust: Extreme::default(),
            torque: Extreme::default(),
            high: Loads::default(),
            low: Loads::default(),
            low_mark: None,
            pending: None,
        }
    }

    /// The stage as known now.
    #[must_use]
    pub const fn stage(&self) -> Stage {
        self.stage
    }

    /// What was found so far.
    #[must_use]
    pub const fn stages(&self) -> Stages {
        self.found
    }

    /// Takes one sample and returns the stage as known now; a sample that is not finite is skipped.
    pub fn step(&mut self, config: &StageConfig, sample: &StageSample) -> Stage {
        let index = self.index;
        self.index += 1;
        let values = [sample.depth_mm, sample.feed_drive_percent, sample.spindle_percent];
        if self.stage == Stage::Done || !values.iter().all(|value| value.is_finite()) {
            return self.stage;
        }
        let deepest = *self.deepest_mm.get_or_insert(sample.depth_mm);
        let way_mm = sample.depth_mm - deepest;
        if self.stage != Stage::Air && way_mm < -RETRACT_MM {
            self.stage = Stage::Done;
            return self.stage;
        }
        let here = Mark { index, depth_mm: sample.depth_mm };
        let row = [way_mm, sample.feed_drive_percent, sample.spindle_percent];
        let smoothing = config.params().smoothing_samples;
        if self.stage == Stage::Air {
            self.deepest_mm = Some(sample.depth_mm);
            self.seek_contact(config.params(), sample.feed_drive_percent, here);
            self.average.push(smoothing, here, row);
            return self.stage;
        }
        // A tool that stands still or pecks says nothing new about the wall.
        if way_mm <= 0.0 {
            return self.stage;
        }
        self.deepest_mm = Some(sample.depth_mm);
        self.average.push(smoothing, here, row);
        if let Some((middle, mean)) = self.average.mean(smoothing) {
            self.advance(config.params(), middle, mean);
        }
        self.stage
    }

    /// What a detector that takes the samples of a hole one by one has found when the sheet opens, or at their end. What the spindle's
    /// load tells is left out, which is most of what is to be computed.
    pub(crate) fn opening(config: &StageConfig, depth_mm: &[f64], feed_drive_percent: &[f64]) -> Stages {
        let params = config.params();
        let smoothing = params.smoothing_samples;
        let (mut detector, mut average, mut deepest) = (Self::new(), Average::new(), None);
        for (index, (&depth_mm, &feed_drive)) in depth_mm.iter().zip(feed_drive_percent).enumerate() {
            if !(depth_mm.is_finite() && feed_drive.is_finite()) {
                continue;
            }
            let way_mm = depth_mm - *deepest.get_or_insert(depth_mm);
            let here = Mark { index, depth_mm };
            if detector.stage == Stage::Air {
                deepest = Some(depth_mm);
                detector.seek_contact(params, feed_drive, here);
                average.push(smoothing, here, [way_mm, feed_drive]);
                continue;
            }
            if way_mm < -RETRACT_MM {
                break;
            }
            if way_mm <= 0.0 {
                continue;
            }
            deepest = Some(depth_mm);
            average.push(smoothing, here, [way_mm, feed_drive]);
            if let Some((middle, [way_mm, feed_drive])) = average.mean(smoothing) {
                let thrust =
                    on_common_speed(detector.over_idle(feed_drive), way_mm, params.thrust_feed_exponent);
                if detector.end_a(params, thrust, way_mm, middle) {
                    break;
                }
            }
        }
        detector.found
    }

    fn seek_contact(&mut self, params: &StageParams, feed_drive: f64, here: Mark) {
        if self.idle_seen == 0 {
            self.idle_mean = feed_drive;
        }
        let rise = feed_drive - self.idle_mean;
        let needed = params.contact_rise_points.max(params.contact_rise_deviations * self.idle_deviation);
        if self.idle_seen >= params.idle_samples && rise >= needed {
            self.first_above.get_or_insert(here);
            self.above += 1;
            if self.above >= params.contact_samples {
                self.stage = Stage::A;
                self.found.contact = self.first_above;
            }
            return;
        }
        self.above = 0;
        self.first_above = None;
        self.idle_seen = self.idle_seen.saturating_add(1);
        let suspicious = (SUSPICIOUS.0 * self.idle_deviation).max(SUSPICIOUS.1 * params.contact_rise_points);
        if self.idle_seen > params.idle_samples && rise > suspicious {
            return;
        }
        let weight = IDLE_WEIGHT.max(1.0 / f64::from(self.idle_seen));
        self.idle_mean += weight * rise;
        self.idle_deviation += weight * (rise.abs() - self.idle_deviation);
    }

    /// The feed drive's load over its idle load.
    fn over_idle(&self, feed_drive: f64) -> f64 {
        (feed_drive - self.idle_mean).max(0.0)
    }

    // Called from one place, where the mean is in registers: written to memory singly and read in pairs it is waited for.
    #[inline(always)]
    fn advance(&mut self, params: &StageParams, here: Mark, [way_mm, feed_drive, spindle]: [f64; 3]) {
        // The tool leaves no torque behind it: the lowest load since contact is the idling spindle's.
        let spindle_idle = self.spindle_idle.map_or(spindle, |idle| idle.min(spindle));
        self.spindle_idle = Some(spindle_idle);
        let (raw_thrust, raw_torque) = (self.over_idle(feed_drive), (spindle - spindle_idle).max(0.0));
        let thrust = on_common_speed(raw_thrust, way_mm, params.thrust_feed_exponent);
        let torque = on_common_speed(raw_torque, way_mm, params.torque_feed_exponent);
        let loads = Loads { thrust, torque, raw_thrust, raw_torque };
        self.high = self.high.zip(loads, f64::max);
        match self.stage {
            Stage::A => self.in_a(params, &loads, way_mm, here),
            Stage::B => self.in_b(params, &loads, way_mm, here),
            Stage::C => self.in_c(params, &loads, here),
            Stage::Air | Stage::D | Stage::Done => {}
        }
    }

    fn in_c(&mut self, params: &StageParams, loads: &Loads, here: Mark) {
        if self.has_risen(params, loads, here) {
            self.found.flange = self.low_mark;
            self.stage = Stage::D;
        }
    }

    fn in_a(&mut self, params: &StageParams, loads: &Loads, way_mm: f64, here: Mark) {
        self.torque.raise(loads.torque, way_mm, here);
        if self.end_a(params, loads.thrust, way_mm, here) {
            self.low = *loads;
        }
    }

    /// Ends stage A where the thrust has fallen off for good, and says so.
    fn end_a(&mut self, params: &StageParams, thrust: f64, way_mm: f64, here: Mark) -> bool {
        if self.thrust.raise(thrust, way_mm, here) {
            self.pending = None;
        }
        let fallen = thrust <= (1.0 - params.breakthrough_fall) * self.thrust.value;
        let is_open = self.is_confirmed(params, fallen && way_mm > STOPPING * self.thrust.way_mm, here);
        if is_open {
            self.found.thrust_maximum = self.thrust.mark;
            self.found.breakthrough = self.pending.take();
            self.stage = Stage::B;
        }
        is_open
    }

    fn in_b(&mut self, params: &StageParams, loads: &Loads, way_mm: f64, here: Mark) {
        if self.torque.raise(loads.torque, way_mm, here) {
            self.pending = None;
            self.low = *loads;
            self.low_mark = Some(here);
        }
        let fallen = loads.torque <= (1.0 - params.idle_travel_fall) * self.torque.value;
        let risen = self.has_risen(params, loads, here);
        if self.is_confirmed(params, fallen && way_mm > STOPPING * self.torque.way_mm, here) {
            self.found.torque_maximum = self.torque.mark;
            self.found.falling_edge = self.pending.take();
            self.stage = Stage::C;
        } else if risen {
            // A short tool: its collar arrives before the idle travel, and both loads rise again from B.
            self.found.torque_maximum = self.torque.mark;
            self.found.flange = self.low_mark;
            self.stage = Stage::D;
        }
    }

    /// Whether thrust and torque have both risen from their lowest. The loads as they are have to rise as well as
    /// those on a common speed: a change of feed moves one kind or the other, the collar both.
    fn has_risen(&mut self, params: &StageParams, loads: &Loads, here: Mark) -> bool {
        if loads.torque < self.low.torque {
            self.low_mark = Some(here);
        }
        self.low = self.low.zip(*loads, f64::min);
        let needed = |low: f64, high: f64| low + params.flange_rise * high;
        loads.thrust >= needed(self.low.thrust, self.high.thrust)
            && loads.torque >= needed(self.low.torque, self.high.torque)
            && loads.raw_thrust >= needed(self.low.raw_thrust, self.high.raw_thrust)
            && loads.raw_torque >= needed(self.low.raw_torque, self.high.raw_torque)
    }

    /// Whether `shown` has lasted over the way that confirms it; `pending` is where it began.
    fn is_confirmed(&mut self, params: &StageParams, shown: bool, here: Mark) -> bool {
        if !shown {
            self.pending = None;
            return false;
        }
        let start = *self.pending.get_or_insert(here);
        here.depth_mm - start.depth_mm >= params.confirm_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_power_is_that_of_the_general_function_to_its_last_bit_but_one(base in 1e-6..100.0_f64) {
            for exponent in [0.5, 1.0] {
                let (own, general) = (power(base, exponent), base.powf(exponent));
                prop_assert!((own - general).abs() <= f64::EPSILON * general, "{own} and {general}");
            }
        }
    }
}

//! What drills in a study: a process model on a machine, seen only through its samples.

use crate::friction::error::Invalid;
use crate::friction::filter::{FilterWeights, LoadFilter};
use crate::friction::noise::Noise;
use crate::friction::program::{Between, FeedProgram, Knot, Strategy};
use crate::friction::twin::{CycleSetup, Twin};

/// How long a spindle idles at speed before contact, s.
const IDLING_S: f64 = 0.4;

/// Samples of one drilled hole, from the approach to the end of the path.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Run {
    /// Time, s.
    pub time_s: Vec<f64>,
    /// Tip depth, mm.
    pub depth_mm: Vec<f64>,
    /// Actual feed, mm/min; empty where the control does not tell it.
    pub feed_mm_min: Vec<f64>,
    /// Loads as the machine reports them (feed drive, spindle), percent.
    pub load_percent: [Vec<f64>; 2],
    /// From contact to the end of the path, s.
    pub duration_s: f64,
    /// Distance of two samples, s.
    pub period_s: f64,
}

impl Run {
    /// Loads filtered by Stryczek & Błaszczak 2020, Eq. 1, at each sample in contact, after the depth there.
    pub fn filtered(&self, mut each: impl FnMut(f64, [f64; 2])) {
        let weights = FilterWeights::default();
        let mut filters = [LoadFilter::new(), LoadFilter::new()];
        for at in 0..self.depth_mm.len() {
            if self.depth_mm[at] < 0.0 {
                continue;
            }
            let load = [0, 1].map(|drive| filters[drive].step(&weights, self.load_percent[drive][at]));
            each(self.depth_mm[at], load);
        }
    }

    /// Largest filtered load over its set load.
    #[must_use]
    pub fn worst_ratio(&self, set_percent: [f64; 2]) -> f64 {
        let mut worst = 0.0_f64;
        self.filtered(|_, load| worst = worst.max(load[0] / set_percent[0]).max(load[1] / set_percent[1]));
        worst
    }

    /// Time in s with a filtered load above `factor` times its set load.
    #[must_use]
    pub fn overload_s(&self, set_percent: [f64; 2], factor: f64) -> f64 {
        let mut time = 0.0;
        self.filtered(|_, load| {
            if load[0] > factor * set_percent[0] || load[1] > factor * set_percent[1] {
                time += self.period_s;
            }
        });
        time
    }
}

/// A process on a machine. Only the reference search may ask it without noise.
pub trait Plant {
    /// Drills a hole with a feed that is linear in depth between knots; without noise where `noise` is `None`.
    ///
    /// # Errors
    /// When the hole cannot be finished.
    fn drill(&self, knots: &[Knot], noise: Option<&mut Noise>) -> Result<Run, Invalid>;
}

/// The friction core's process model.
#[derive(Debug, Clone)]
pub struct TwinPlant {
    /// The model.
    pub twin: Twin,
    /// Speed, wear, approach and sampling.
    pub setup: CycleSetup,
    /// End of the path, mm.
    pub end_mm: f64,
}

impl TwinPlant {
    /// Drills under any strategy, law included.
    ///
    /// # Errors
    /// When the hole cannot be finished.
    pub fn run(&self, strategy: &Strategy, noise: Option<&mut Noise>) -> Result<Run, Invalid> {
        let mut run = Run { period_s: self.setup.period_s, ..Run::default() };
        let figures = self.twin.drill(strategy, &self.setup, noise, |sample| {
            run.time_s.push(sample.time_s);
            run.depth_mm.push(sample.depth_mm);
            run.feed_mm_min.push(sample.feed_mm_min);
            run.load_percent[0].push(sample.process.feed_drive_percent);
            run.load_percent[1].push(sample.process.spindle_percent);
        })?;
        run.duration_s = figures.duration_s;
        Ok(run)
    }
}

impl Plant for TwinPlant {
    fn drill(&self, knots: &[Knot], noise: Option<&mut Noise>) -> Result<Run, Invalid> {
        let program = FeedProgram::new(Between::Linear, knots.to_vec())?;
        let machine = &self.twin.params().machine;
        // As much air as the spindle needs to spin up, and a little to idle in.
        let air_s = self.setup.spindle_rpm / machine.spindle_acceleration_rpm_s + IDLING_S;
        let approach_mm = program.feed_at(0.0) / 60.0 * air_s;
        let plant = Self { setup: CycleSetup { approach_mm, ..self.setup }, ..self.clone() };
        plant.run(&Strategy::new("trial", program, self.end_mm, None)?, noise)
    }
}

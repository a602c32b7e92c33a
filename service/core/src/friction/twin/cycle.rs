//! Whole cycles of the process model: a strategy on a machine, sampled once per IPO.

use super::axis::AxisState;
use super::model::{Twin, TwinInput, TwinOutput, TwinState};
use crate::friction::error::{Invalid, InvalidCode, between, positive};
use crate::friction::law::{LawSample, LawState};
use crate::friction::noise::Noise;
use crate::friction::program::Strategy;

/// IPO cycles after which a simulated hole counts as stuck: ten minutes at 10 ms.
const MOST_SAMPLES: usize = 60_000;

/// What is drilled in one simulated cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CycleSetup {
    /// Commanded spindle speed in rpm.
    pub spindle_rpm: f64,
    /// Wear of the tool in units of the wear law.
    pub wear: f64,
    /// Way in the air before first contact in mm; the spindle spins up there. With none it turns from the beginning.
    pub approach_mm: f64,
    /// IPO period in s.
    pub period_s: f64,
}

impl CycleSetup {
    /// A cycle at a speed with a tool of a wear: 1.5 mm of approach, 10 ms IPO.
    #[must_use]
    pub const fn new(spindle_rpm: f64, wear: f64) -> Self {
        Self { spindle_rpm, wear, approach_mm: 1.5, period_s: 0.01 }
    }

    /// Spindle speed at the beginning, rpm: without an approach in which it could spin up it turns already.
    pub(super) const fn first_rpm(&self) -> f64 {
        if self.approach_mm > 0.0 { 0.0 } else { self.spindle_rpm }
    }
}

/// One sample of a simulated cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CycleSample {
    /// Time since the start of the approach in s.
    pub time_s: f64,
    /// Tip depth in mm.
    pub depth_mm: f64,
    /// Actual feed in mm/min.
    pub feed_mm_min: f64,
    /// Spindle speed in rpm.
    pub spindle_rpm: f64,
    /// Override in force in percent.
    pub override_percent: f64,
    /// Thrust, torque, loads, power and energy.
    pub process: TwinOutput,
}

/// A maximum and where it was.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Peak {
    /// The value, in the unit of its quantity.
    pub value: f64,
    /// Tip depth in mm.
    pub depth_mm: f64,
}

impl Peak {
    fn take(&mut self, value: f64, depth_mm: f64) {
        if value > self.value {
            *self = Self { value, depth_mm };
        }
    }
}

/// What remains of a cycle when its samples are gone; everything counted from first contact.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CycleFigures {
    /// Time from first contact to the end of the path in s.
    pub duration_s: f64,
    /// Energy on the dynamometer basis (Eq. 7) in J.
    pub energy_j: f64,
    /// Part of that energy that is thrust (Eq. 5) in J.
    pub thrust_energy_j: f64,
    /// Largest thrust in N.
    pub thrust_n: Peak,
    /// Largest torque in N·m.
    pub torque_nm: Peak,
    /// Largest mechanical power in W.
    pub power_w: Peak,
    /// Largest feed-drive load in percent.
    pub feed_drive_percent: Peak,
    /// Largest spindle load in percent.
    pub spindle_percent: Peak,
}

impl Twin {
    /// Drills one hole and hands every sample to `each`, in order; returns the cycle's figures.
    ///
    /// The law, if the strategy has one, sees the loads as the machine reports them (noise, idle load and
    /// acceleration included) from first contact on.
    ///
    /// # Errors
    /// When the setup is out of range, or the hole is not finished within ten minutes of IPO cycles.
    pub fn drill(
        &self,
        strategy: &Strategy,
        setup: &CycleSetup,
        mut noise: Option<&mut Noise>,
        mut each: impl FnMut(&CycleSample),
    ) -> Result<CycleFigures, Invalid> {
        between("spindle_rpm", setup.spindle_rpm, 1.0, 1e5)?;
        between("approach_mm", setup.approach_mm, 0.0, 100.0)?;
        positive("period_s", setup.period_s, 1.0)?;
        let mut state = TwinState::new(setup.wear)?.with_spindle_rpm(setup.first_rpm());
        if let Some(noise) = noise.as_deref_mut()
            && self.params().noise.cycle > 0.0
        {
            state = state.with_strength(1.0 + self.params().noise.cycle * noise.normal());
        }
        let machine = &self.params().machine;
        let dt = setup.period_s;
        let end = strategy.end_depth_mm();
        let mut axis = AxisState::at_rest(-setup.approach_mm);
        let mut law_state = LawState::new();
        let mut figures = CycleFigures::default();
        let mut rpm = setup.first_rpm();
        let mut contact_s = None;
        for k in 0..MOST_SAMPLES {
            #[expect(clippy::cast_precision_loss, reason = "at most 60 000 samples")]
            let time_s = (k + 1) as f64 * dt;
            rpm = (rpm + machine.spindle_acceleration_rpm_s * dt).min(setup.spindle_rpm);
            let programmed = strategy.program.feed_at(axis.depth_mm());
            let done = axis.step(&machine.axis, programmed, law_state.ovr().percent(), end, dt);
            let (depth, feed) = (axis.depth_mm(), axis.feed_mm_min());
            let input = TwinInput { depth_mm: depth, feed_mm_min: feed, spindle_rpm: rpm, dt_s: dt };
            let process = self.advance(&mut state, &input, noise.as_deref_mut());
            let override_percent = law_state.ovr().percent();
            if depth >= 0.0 {
                let start = *contact_s.get_or_insert(time_s - dt);
                if let Some(law) = &strategy.law {
                    let sample = LawSample {
                        time_ms: (time_s - start) * 1e3,
                        contact_ms: Some((time_s - start) * 1e3),
                        depth_mm: Some(depth),
                        feed_drive_percent: Some(process.feed_drive_percent),
                        spindle_percent: Some(process.spindle_percent),
                    };
                    law_state.step(law, &sample);
                }
                figures.duration_s = time_s - start;
                figures.energy_j += process.energy_j;
                figures.thrust_energy_j += process.thrust_n * feed / 60e3 * dt;
                figures.thrust_n.take(process.thrust_n, depth);
                figures.torque_nm.take(process.torque_nm, depth);
                figures.power_w.take(process.power_w, depth);
                figures.feed_drive_percent.take(process.feed_drive_percent, depth);
                figures.spindle_percent.take(process.spindle_percent, depth);
            }
            each(&CycleSample {
                time_s,
                depth_mm: depth,
                feed_mm_min: feed,
                spindle_rpm: rpm,
                override_percent,
                process,
            });
            if done {
                return Ok(figures);
            }
        }
        let text = "the hole is not finished within 60 000 samples";
        Err(Invalid::new("strategy", InvalidCode::OutOfRange, text))
    }

    /// Drills one hole and keeps every sample.
    ///
    /// # Errors
    /// As [`Twin::drill`].
    pub fn record(
        &self,
        strategy: &Strategy,
        setup: &CycleSetup,
        noise: Option<&mut Noise>,
    ) -> Result<(Vec<CycleSample>, CycleFigures), Invalid> {
        let mut samples = Vec::with_capacity(1024);
        let figures = self.drill(strategy, setup, noise, |sample| samples.push(*sample))?;
        Ok((samples, figures))
    }
}

//! The dimensional drilling process that closes the peak-to-peak controller's loop (Ivanov et al. 2024).
//!
//! m·x'' + c·x' + k·x = Fc(h) + Fa with the regenerative chip thickness of Gouskov et al. 2015 (Eq. 3 and 4), here
//! in N, mm and s. The actuator feeds the velocity back continuously with the gain that the controller last set.

use std::f64::consts::TAU;

use crate::field_error::{FieldError, Problem, count, within};

use super::peak_to_peak::{Controller, ControllerSettings, VibrationSample};

/// Integration steps per controller sample; halving them moves amplitudes by less than 0.1 %.
const STEPS_PER_SAMPLE: u32 = 10;

/// Most integration steps of a run: some twenty seconds of computing.
const MAX_STEPS: f64 = 2e8;

/// Cutting force Fc = contact·(offset + slope·h) of the main edges, and what the chisel edge adds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CuttingForce {
    /// Force at vanishing chip thickness, N.
    pub offset_n: f64,
    /// Force per chip thickness, N/mm.
    pub slope_n_mm: f64,
    /// Chisel edge; none when a pilot hole keeps it out of the cut.
    pub chisel: Option<ChiselEdge>,
}

/// Chisel edge: contact·max(0, Kch·h − cch·x').
///
/// A fit in a very narrow window of the experiments, not a law: it reproduces that a full hole is damped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChiselEdge {
    /// Kch, N/mm.
    pub slope_n_mm: f64,
    /// cch, N·s/m.
    pub damping_n_s_m: f64,
}

impl CuttingForce {
    /// Pilot hole: a line through Table 3 of Ivanov et al. 2024, which it meets to 0.14 %.
    pub const PILOT_HOLE: Self = Self { offset_n: 15.21, slope_n_mm: 879.0, chisel: None };
    /// Full hole; see the caution at [`ChiselEdge`].
    pub const FULL_HOLE: Self =
        Self { chisel: Some(ChiselEdge { slope_n_mm: 3910.0, damping_n_s_m: 6170.0 }), ..Self::PILOT_HOLE };
}

/// Unchecked run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopInput {
    /// Stiffness of the elastic element, N/mm.
    pub stiffness_n_mm: f64,
    /// Eigenfrequency f0, Hz.
    pub eigenfrequency_hz: f64,
    /// ζ, share of critical damping.
    pub damping: f64,
    /// Cutting edges z.
    pub edges: u32,
    /// Spindle speed, 1/min.
    pub spindle_rpm: f64,
    /// Feed per edge, mm.
    pub feed_mm_edge: f64,
    /// Cutting force.
    pub force: CuttingForce,
    /// Feedback at gain 1 (G), N·s/m.
    pub actuator_gain_n_s_m: f64,
    /// Largest actuator force, N.
    pub actuator_limit_n: f64,
    /// Simulated time, s.
    pub duration_s: f64,
    /// Time at the end that the steady values are taken from, s.
    pub steady_s: f64,
}

impl LoopInput {
    /// The experimental setup of Ivanov et al. 2024 (Table 1) at a spindle speed; 4 s, steady values of the last 1 s.
    #[must_use]
    pub const fn ivanov_2024(spindle_rpm: f64, force: CuttingForce) -> Self {
        Self {
            stiffness_n_mm: 2050.0,
            eigenfrequency_hz: 70.86,
            damping: 0.01,
            edges: 2,
            spindle_rpm,
            feed_mm_edge: 0.02,
            force,
            actuator_gain_n_s_m: 4000.0,
            actuator_limit_n: 100.0,
            duration_s: 4.0,
            steady_s: 1.0,
        }
    }
}

/// Checked run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopRun(LoopInput);

impl LoopRun {
    /// Checks a run.
    ///
    /// # Errors
    /// The first field that is not finite or out of range.
    pub fn new(input: LoopInput) -> Result<Self, FieldError> {
        within("stiffness_n_mm", input.stiffness_n_mm, 1e-3, 1e9)?;
        within("eigenfrequency_hz", input.eigenfrequency_hz, 0.1, 1e5)?;
        within("damping", input.damping, 0.0, 1.0)?;
        within("edges", f64::from(input.edges), 1.0, 100.0)?;
        within("spindle_rpm", input.spindle_rpm, 1.0, 1e6)?;
        within("feed_mm_edge", input.feed_mm_edge, 1e-6, 10.0)?;
        within("force.offset_n", input.force.offset_n, 0.0, 1e6)?;
        within("force.slope_n_mm", input.force.slope_n_mm, 0.0, 1e9)?;
        if let Some(chisel) = input.force.chisel {
            within("force.chisel.slope_n_mm", chisel.slope_n_mm, 0.0, 1e9)?;
            within("force.chisel.damping_n_s_m", chisel.damping_n_s_m, 0.0, 1e9)?;
        }
        within("actuator_gain_n_s_m", input.actuator_gain_n_s_m, 0.0, 1e9)?;
        within("actuator_limit_n", input.actuator_limit_n, 0.0, 1e9)?;
        within("duration_s", input.duration_s, 1e-3, 1e4)?;
        within("steady_s", input.steady_s, 1e-3, input.duration_s)?;
        Ok(Self(input))
    }

    /// The data of the run.
    #[must_use]
    pub const fn data(&self) -> &LoopInput {
        &self.0
    }
}

/// Steady values of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopSteady {
    /// Peak-to-peak displacement over the whole steady time, mm.
    pub displacement_mm: f64,
    /// Mean of the single vibrations' peak-to-peak displacement, mm; below the above where the vibration beats.
    pub mean_displacement_mm: f64,
    /// Largest actuator force, N.
    pub actuator_n: f64,
    /// Share of samples at which the actuator was at its limit, 0..1.
    pub saturated: f64,
    /// Largest cutting force, N.
    pub cutting_n: f64,
    /// ψ, share of time in cut, 0..1.
    pub continuity: f64,
    /// Mean vibration frequency from upward crossings of the velocity, Hz; none at rest.
    pub frequency_hz: Option<f64>,
    /// Local maxima of the displacement, mm: a column of a Poincaré map.
    pub peaks_mm: Vec<f64>,
    /// Local maxima of the actuator force, N: a column of the paper's Fig. 15.
    pub actuator_peaks_n: Vec<f64>,
}

/// Least peak-to-peak displacement in feeds per edge below which the drill counts as at rest, without peaks.
const REST: f64 = 1e-4;

/// Most peaks kept of a run.
const MAX_PEAKS: usize = 10_000;

/// Time between integration steps, s.
fn step_s(run: &LoopRun, control: Option<&ControllerSettings>) -> f64 {
    let sample_s = control
        .map_or_else(|| (0.02 / run.0.eigenfrequency_hz).min(300e-6), |settings| settings.data().period_s);
    sample_s / f64::from(STEPS_PER_SAMPLE)
}

/// Integration steps of a run: what it costs.
#[must_use]
pub fn loop_steps(run: &LoopRun, control: Option<&ControllerSettings>) -> u64 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "float casts saturate")]
    let steps = (run.0.duration_s / step_s(run, control)).ceil() as u64;
    steps
}

/// Runs the process, with the controller or free.
///
/// # Errors
/// The steps of the run would be more than 2·10⁸, or the edges pass more often than the integration steps.
pub fn run_loop(run: &LoopRun, control: Option<&ControllerSettings>) -> Result<LoopSteady, FieldError> {
    let p = &run.0;
    let dt = step_s(run, control);
    let steps = (p.duration_s / dt).ceil();
    if steps > MAX_STEPS {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "float casts saturate")]
        let found = steps as usize;
        return Err(FieldError::new("duration_s", Problem::TooMany { count: found, max: 200_000_000 }));
    }
    let delay = 60.0 / (f64::from(p.edges) * p.spindle_rpm) / dt;
    if delay < 8.0 {
        let why = "is so high that an edge passes within eight integration steps";
        return Err(FieldError::new("spindle_rpm", Problem::Inconsistent(why)));
    }
    Ok(Integration::new(p, dt, delay).run(p, control, steps))
}

/// Weights of a cubic through four neighbours at the fraction `at` between the middle two.
fn cubic(at: f64) -> [f64; 4] {
    let (a, b, c) = (at + 1.0, at - 1.0, at - 2.0);
    [-at * b * c / 6.0, a * b * c / 2.0, -a * at * c / 2.0, a * at * b / 6.0]
}

struct Integration {
    dt: f64,
    mass: f64,
    damping: f64,
    /// Whole steps and weights of the surface one edge earlier, at the start, middle and end of a step.
    delayed: [(usize, [f64; 4]); 3],
    /// Surface left by the edges, one value per step, newest at `newest`; a ring.
    surface: Vec<f64>,
    newest: usize,
}

impl Integration {
    fn new(p: &LoopInput, dt: f64, delay: f64) -> Self {
        let omega = TAU * p.eigenfrequency_hz;
        let mass = p.stiffness_n_mm / (omega * omega);
        let delayed = [0.0, 0.5, 1.0].map(|ahead| {
            let back = delay - ahead;
            let whole = back.ceil();
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "8 ≤ delay < MAX_STEPS"
            )]
            let steps = whole as usize;
            (steps, cubic(whole - back))
        });
        let length = delayed[0].0 + 3;
        // At the start the surface climbs to the tool within one passing: s(t) = a·t/T on [−T, 0].
        let mut surface = vec![0.0; length];
        for (back, value) in (0..u32::MAX).zip(surface.iter_mut().rev()) {
            *value = -p.feed_mm_edge * f64::from(back) / delay;
        }
        Self { dt, mass, damping: 2.0 * p.damping * mass * omega, delayed, newest: length - 1, surface }
    }

    /// Height of the chip at displacement 0 (surface one edge earlier plus the feed), mm.
    fn gap(&self, which: usize, feed: f64) -> f64 {
        let (back, weights) = &self.delayed[which];
        let length = self.surface.len();
        let first = self.newest + 2 * length - back - 1;
        let at = |i: usize| self.surface[(first + i) % length];
        weights[0] * at(0) + weights[1] * at(1) + weights[2] * at(2) + weights[3] * at(3) + feed
    }

    fn cutting(force: &CuttingForce, h: f64, v: f64) -> f64 {
        if h <= 0.0 {
            return 0.0;
        }
        // N·s/m over 1000 is N·s/mm.
        let chisel = force.chisel.map_or(0.0, |c| (c.slope_n_mm * h - c.damping_n_s_m / 1000.0 * v).max(0.0));
        force.offset_n + force.slope_n_mm * h + chisel
    }

    fn run(mut self, p: &LoopInput, control: Option<&ControllerSettings>, steps: f64) -> LoopSteady {
        let mut controller = control.map(|settings| Controller::new(*settings));
        let gain = p.actuator_gain_n_s_m / 1000.0;
        let (dt, feed, limit) = (self.dt, p.feed_mm_edge, p.actuator_limit_n);
        let (mut x, mut v, mut b) = (0.0_f64, 0.0_f64, 0.0_f64);
        let mut seen = Observed::new(feed);
        let steady_from = steps - (p.steady_s / dt).floor();
        let (mut step, mut until_sample) = (0.0, 0_u32);
        while step < steps {
            let gaps = [self.gap(0, feed), self.gap(1, feed), self.gap(2, feed)];
            let act = |v: f64, b: f64| (gain * b * v).clamp(-limit, limit);
            let accelerate = |gap: f64, x: f64, v: f64, b: f64| {
                let forces = Self::cutting(&p.force, gap - x, v) + act(v, b);
                (forces - self.damping * v - p.stiffness_n_mm * x) / self.mass
            };
            if until_sample == 0 {
                until_sample = STEPS_PER_SAMPLE;
                if let Some(controller) = &mut controller {
                    let acceleration_mm_s2 = accelerate(gaps[0], x, v, b);
                    let sample = VibrationSample { velocity_mm_s: v, acceleration_mm_s2 };
                    // A checked run makes no bad samples; the actuator would be switched off for one.
                    b = controller.step(sample).map_or(0.0, |step| step.gain);
                }
            }
            until_sample -= 1;
            let a1 = accelerate(gaps[0], x, v, b);
            let (x2, v2) = (x + 0.5 * dt * v, v + 0.5 * dt * a1);
            let a2 = accelerate(gaps[1], x2, v2, b);
            let (x3, v3) = (x + 0.5 * dt * v2, v + 0.5 * dt * a2);
            let a3 = accelerate(gaps[1], x3, v3, b);
            let (x4, v4) = (x + dt * v3, v + dt * a3);
            let a4 = accelerate(gaps[2], x4, v4, b);
            x += dt / 6.0 * (v + 2.0 * (v2 + v3) + v4);
            v += dt / 6.0 * (a1 + 2.0 * (a2 + a3) + a4);
            let h = (gaps[2] - x).max(0.0);
            self.newest = (self.newest + 1) % self.surface.len();
            self.surface[self.newest] = gaps[2] - h;
            step += 1.0;
            if step > steady_from {
                seen.take(x, act(v, b), Self::cutting(&p.force, h, v), h > 0.0, limit);
            }
        }
        seen.finish(dt)
    }
}

struct Observed {
    feed: f64,
    low: f64,
    high: f64,
    actuator: f64,
    saturated: f64,
    cutting: f64,
    in_cut: f64,
    count: f64,
    /// The last two values of displacement and of actuator force, for their local maxima.
    last: [(f64, f64); 2],
    peaks: Vec<f64>,
    actuator_peaks: Vec<f64>,
    trough: f64,
    swings: f64,
    swing_sum: f64,
    first_peak: f64,
    last_peak: f64,
}

impl Observed {
    fn new(feed: f64) -> Self {
        Self {
            feed,
            low: f64::INFINITY,
            high: f64::NEG_INFINITY,
            actuator: 0.0,
            saturated: 0.0,
            cutting: 0.0,
            in_cut: 0.0,
            count: 0.0,
            last: [(0.0, 0.0); 2],
            peaks: Vec::new(),
            actuator_peaks: Vec::new(),
            trough: f64::INFINITY,
            swings: 0.0,
            swing_sum: 0.0,
            first_peak: 0.0,
            last_peak: 0.0,
        }
    }

    fn take(&mut self, x: f64, actuator: f64, cutting: f64, in_cut: bool, limit: f64) {
        let [before, last] = self.last;
        if self.count >= 2.0 {
            if last.0 > before.0 && last.0 >= x && self.peaks.len() < MAX_PEAKS {
                if self.peaks.is_empty() {
                    self.first_peak = self.count;
                }
                if self.trough.is_finite() {
                    self.swings += 1.0;
                    self.swing_sum += last.0 - self.trough;
                }
                self.trough = f64::INFINITY;
                self.last_peak = self.count;
                self.peaks.push(last.0);
            }
            if last.1 > before.1 && last.1 >= actuator && self.actuator_peaks.len() < MAX_PEAKS {
                self.actuator_peaks.push(last.1);
            }
        }
        if !self.peaks.is_empty() {
            self.trough = self.trough.min(x);
        }
        self.last = [last, (x, actuator)];
        self.low = self.low.min(x);
        self.high = self.high.max(x);
        self.actuator = self.actuator.max(actuator.abs());
        self.saturated += f64::from(u8::from(limit > 0.0 && actuator.abs() >= limit));
        self.cutting = self.cutting.max(cutting);
        self.in_cut += f64::from(u8::from(in_cut));
        self.count += 1.0;
    }

    fn finish(mut self, dt: f64) -> LoopSteady {
        let displacement_mm = self.high - self.low;
        if displacement_mm < REST * self.feed {
            self.peaks.clear();
        }
        #[expect(clippy::cast_precision_loss, reason = "at most MAX_PEAKS")]
        let periods = self.peaks.len().saturating_sub(1) as f64;
        let span_s = (self.last_peak - self.first_peak) * dt;
        LoopSteady {
            displacement_mm,
            mean_displacement_mm: if self.swings > 0.0 {
                self.swing_sum / self.swings
            } else {
                displacement_mm
            },
            actuator_n: self.actuator,
            saturated: self.saturated / self.count,
            cutting_n: self.cutting,
            continuity: self.in_cut / self.count,
            frequency_hz: (periods >= 1.0 && span_s > 0.0).then(|| periods / span_s),
            peaks_mm: self.peaks,
            actuator_peaks_n: self.actuator_peaks,
        }
    }
}

/// One spindle speed of a Poincaré map.
#[derive(Debug, Clone, PartialEq)]
pub struct PoincareColumn {
    /// Spindle speed, 1/min.
    pub spindle_rpm: f64,
    /// Without control.
    pub free: LoopSteady,
    /// With control.
    pub controlled: LoopSteady,
}

/// Most spindle speeds of a Poincaré map.
pub const MAX_SPEEDS: usize = 1_000;

/// Poincaré maps of displacement and actuator force over spindle speed (Ivanov et al. 2024, Fig. 11, 14 and 15).
///
/// Peaks are relative to the unloaded position of the spring, as the cutting force deflects it.
///
/// # Errors
/// No speeds, more than [`MAX_SPEEDS`], or a speed that is out of range.
pub fn poincare_map(
    run: &LoopRun,
    speeds_rpm: &[f64],
    control: &ControllerSettings,
) -> Result<Vec<PoincareColumn>, FieldError> {
    count("speeds_rpm", speeds_rpm.len(), 1, MAX_SPEEDS)?;
    let column = |spindle_rpm: f64| {
        let at_speed = LoopRun::new(LoopInput { spindle_rpm, ..run.0 })?;
        let (free, controlled) = (run_loop(&at_speed, None)?, run_loop(&at_speed, Some(control))?);
        Ok(PoincareColumn { spindle_rpm, free, controlled })
    };
    let of_the_list = |index: usize, error: FieldError| match error.field() {
        "spindle_rpm" => FieldError::new("speeds_rpm", error.problem()).at(index),
        _ => error,
    };
    speeds_rpm
        .iter()
        .enumerate()
        .map(|(index, rpm)| column(*rpm).map_err(|error| of_the_list(index, error)))
        .collect()
}

#[cfg(test)]
mod tests;

//! Adaptation: measured power, force and wear of the running edge correct the coefficients of its library entry.
//!
//! Alaskari & Oraby 2017 propose measurement to support the empirical prediction without giving a law; this is an
//! extended Kalman filter over (AW, ln wear factor, ln power factor, ln force factor). Power and force depend on
//! wear too, so the filter shares an unexpected load between "worn more than thought" and "the law is off" by their
//! uncertainties. Factors are bounded, and a reading far outside what is plausible moves them only so far.

use crate::field_error::{FieldError, Problem, within};

use super::{Cut, EdgeState, Job};

/// Least wear the filter works with, mm: the laws have no logarithm at zero.
const LEAST_WEAR_MM: f64 = 1e-6;

/// Half width of a 95 % interval in standard deviations.
const SIGMAS_95: f64 = 1.959_964;

/// Unchecked settings of the adaptation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdaptationInput {
    /// Standard deviation of the logarithm of each factor before anything is measured.
    pub prior_log_sd: f64,
    /// Drift of each factor's logarithm per square root of a minute of cutting.
    pub drift_log_sd: f64,
    /// Relative standard deviation of a power reading.
    pub power_log_sd: f64,
    /// Relative standard deviation of a force reading.
    pub force_log_sd: f64,
    /// Standard deviation of a wear reading, mm.
    pub wear_sd_mm: f64,
    /// No factor leaves 1/max_factor..max_factor.
    pub max_factor: f64,
    /// A reading further off than this many standard deviations counts as exactly this far off.
    pub gate_sigmas: f64,
}

impl Default for AdaptationInput {
    fn default() -> Self {
        Self {
            prior_log_sd: 0.25,
            drift_log_sd: 0.01,
            power_log_sd: 0.03,
            force_log_sd: 0.05,
            wear_sd_mm: 0.01,
            max_factor: 2.0,
            gate_sigmas: 3.0,
        }
    }
}

/// Checked settings of the adaptation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdaptationSettings(AdaptationInput);

impl AdaptationSettings {
    /// Checks settings.
    ///
    /// # Errors
    /// The first field that is not finite or out of range.
    pub fn new(input: AdaptationInput) -> Result<Self, FieldError> {
        within("prior_log_sd", input.prior_log_sd, 1e-6, 3.0)?;
        within("drift_log_sd", input.drift_log_sd, 0.0, 1.0)?;
        within("power_log_sd", input.power_log_sd, 1e-6, 3.0)?;
        within("force_log_sd", input.force_log_sd, 1e-6, 3.0)?;
        within("wear_sd_mm", input.wear_sd_mm, 1e-6, 10.0)?;
        within("max_factor", input.max_factor, 1.0, 100.0)?;
        within("gate_sigmas", input.gate_sigmas, 0.5, 100.0)?;
        Ok(Self(input))
    }
}

/// Readings at the end of an interval; absent ones are not measured.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Measured {
    /// Power, kW.
    pub power_kw: Option<f64>,
    /// Thrust force, N.
    pub force_n: Option<f64>,
    /// Average edge wear, mm.
    pub wear_mm: Option<f64>,
}

/// An estimate with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    /// Estimate.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// What has been learnt of an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corrections {
    /// Present wear, mm.
    pub wear_mm: Correction,
    /// Factor on the wear law's coefficient.
    pub wear_factor: Correction,
    /// Factor on the power law's coefficient.
    pub power_factor: Correction,
    /// Factor on the force law's coefficient.
    pub force_factor: Correction,
    /// Whether a reading of the last interval was cut to the gate: a broken sensor, or a sudden change.
    pub gated: bool,
    /// Whether a factor sits at its bound, so that the entry does not describe this edge.
    pub at_bound: bool,
}

impl Corrections {
    /// Whether what was read cannot be believed as it stands: a reading of the last interval was cut to the gate, or a
    /// factor sits at its bound. A unit slip and a dead sensor look like this; no pair may be raised by it.
    #[must_use]
    pub const fn implausible(&self) -> bool {
        self.gated || self.at_bound
    }

    fn are_finite(&self) -> bool {
        let all = [self.wear_mm, self.wear_factor, self.power_factor, self.force_factor];
        all.iter().all(|one| one.value.is_finite() && one.low.is_finite() && one.high.is_finite())
    }
}

fn too_extreme() -> FieldError {
    FieldError::new("cut", Problem::Inconsistent("is so extreme that nothing can be learnt"))
}

/// What becomes of a reading further off than the gate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum BeyondGate {
    /// It counts as exactly as far off as the gate.
    Cut,
    /// It is not read at all.
    LeftOut,
}

/// Running estimate for one edge; `job` in its methods is always the one with the library's own coefficients.
#[derive(Debug, Clone, PartialEq)]
pub struct Adaptation {
    settings: AdaptationSettings,
    elapsed_min: f64,
    mean: [f64; 4],
    covariance: [[f64; 4]; 4],
    beyond_gate: BeyondGate,
    gated: bool,
}

const WEAR: usize = 0;
const WEAR_FACTOR: usize = 1;
const POWER_FACTOR: usize = 2;
const FORCE_FACTOR: usize = 3;

impl Adaptation {
    /// Starts from the library entry, on an edge in the given state.
    #[must_use]
    pub fn new(settings: AdaptationSettings, start: EdgeState) -> Self {
        let prior = settings.0.prior_log_sd.powi(2);
        let mut covariance = [[0.0; 4]; 4];
        for (i, row) in covariance.iter_mut().enumerate().skip(1) {
            row[i] = prior;
        }
        let mean = [start.wear_mm(), 0.0, 0.0, 0.0];
        let beyond_gate = BeyondGate::Cut;
        Self { settings, elapsed_min: start.elapsed_min(), mean, covariance, beyond_gate, gated: false }
    }

    /// The same with another way to take readings beyond the gate.
    pub(super) const fn with(mut self, beyond_gate: BeyondGate) -> Self {
        self.beyond_gate = beyond_gate;
        self
    }

    /// Takes one interval of `minutes` cut with `cut`, and what was read at its end.
    ///
    /// # Errors
    /// A reading or duration that is not finite, not positive or absurd, and an interval so extreme that no estimate of it
    /// is finite; the estimate then stays as it was.
    pub fn observe(
        &mut self,
        job: &Job,
        cut: Cut,
        minutes: f64,
        read: Measured,
    ) -> Result<Corrections, FieldError> {
        within("minutes", minutes, 1e-6, 1440.0)?;
        read.power_kw.map_or(Ok(0.0), |value| within("power_kw", value, 1e-9, 1e6))?;
        read.force_n.map_or(Ok(0.0), |value| within("force_n", value, 1e-9, 1e9))?;
        read.wear_mm.map_or(Ok(0.0), |value| within("wear_mm", value, 0.0, 100.0))?;
        let mut next = self.clone();
        next.gated = false;
        next.advance(job, cut, minutes)?;
        let settings = self.settings.0;
        let data = job.model().data();
        if let Some(value) = read.wear_mm {
            next.correct(value - next.mean[WEAR], [1.0, 0.0, 0.0, 0.0], settings.wear_sd_mm.powi(2))?;
        }
        if let Some(value) = read.power_kw {
            let wear = next.mean[WEAR];
            let off = value.ln() - job.power_kw(cut, wear).ln() - next.mean[POWER_FACTOR];
            let noise = settings.power_log_sd.powi(2) + data.scatter.power_log_sd.powi(2);
            next.correct(off, [data.power.wear_exponent / wear, 0.0, 1.0, 0.0], noise)?;
        }
        if let Some(value) = read.force_n {
            let wear = next.mean[WEAR];
            let off = value.ln() - job.force_n(cut, wear).ln() - next.mean[FORCE_FACTOR];
            let noise = settings.force_log_sd.powi(2) + data.scatter.force_log_sd.powi(2);
            next.correct(off, [data.force.wear_exponent / wear, 0.0, 0.0, 1.0], noise)?;
        }
        let learnt = next.corrections();
        if !learnt.are_finite() {
            return Err(too_extreme());
        }
        *self = next;
        Ok(learnt)
    }

    fn advance(&mut self, job: &Job, cut: Cut, minutes: f64) -> Result<(), FieldError> {
        let power = job.measure_power();
        let before = self.mean[WEAR];
        let gained = job.wear_gain_over(self.elapsed_min, minutes)
            * job.severity(cut)
            * (power * self.mean[WEAR_FACTOR]).exp();
        let after = job.wear_of(job.measure(before) + gained).max(LEAST_WEAR_MM);
        let grown = after - before;
        // Slopes of AW = (AW₀^q + G·e^(q·x))^(1/q) in AW₀ and x; 1 and G where q = 1.
        // A new edge is known to be new: its wear covaries with nothing, so nothing of it is kept, although the slope itself
        // has no bound there where q < 1.
        let kept = if before > 0.0 { (before / after).powf(power - 1.0) } else { 0.0 };
        let learnt = after.powf(1.0 - power) * gained;
        self.elapsed_min += minutes;
        self.mean[WEAR] = after;
        let p = &mut self.covariance;
        let factor_row = p[WEAR_FACTOR];
        for (value, factor) in p[WEAR].iter_mut().zip(factor_row) {
            *value = kept * *value + learnt * factor;
        }
        for row in p.iter_mut() {
            row[WEAR] = kept * row[WEAR] + learnt * row[WEAR_FACTOR];
        }
        p[WEAR][WEAR] += (job.model().data().scatter.wear_log_sd * grown).powi(2);
        let drift = self.settings.0.drift_log_sd.powi(2) * minutes;
        for factor in [WEAR_FACTOR, POWER_FACTOR, FORCE_FACTOR] {
            p[factor][factor] += drift;
        }
        // Rounding must not leave the wear with negative uncertainty.
        p[WEAR][WEAR] = p[WEAR][WEAR].max(0.0);
        self.hold_finite()
    }

    /// Refuses an estimate that is no number: laws of an extreme entry overflow in an interval that is valid by itself.
    fn hold_finite(&self) -> Result<(), FieldError> {
        let is_finite =
            self.mean.iter().chain(self.covariance.iter().flatten()).all(|value| value.is_finite());
        if is_finite { Ok(()) } else { Err(too_extreme()) }
    }

    fn correct(&mut self, off: f64, slope: [f64; 4], noise: f64) -> Result<(), FieldError> {
        let cross: [f64; 4] =
            std::array::from_fn(|i| (0..4).map(|j| self.covariance[i][j] * slope[j]).sum::<f64>());
        let variance = noise + (0..4).map(|i| slope[i] * cross[i]).sum::<f64>();
        // The gate is made of it: of no number, or of a negative one by rounding, there is none to hold a reading to.
        if off.is_nan() || !variance.is_finite() || variance <= 0.0 {
            return Err(too_extreme());
        }
        let gate = self.settings.0.gate_sigmas * variance.sqrt();
        if off.abs() > gate {
            self.gated = true;
            if self.beyond_gate == BeyondGate::LeftOut {
                return Ok(());
            }
        }
        let off = off.clamp(-gate, gate);
        for (i, (mean, row)) in self.mean.iter_mut().zip(&mut self.covariance).enumerate() {
            *mean += cross[i] / variance * off;
            for (value, other) in row.iter_mut().zip(cross) {
                *value -= cross[i] * other / variance;
            }
            // Rounding must not leave a factor with negative uncertainty.
            row[i] = row[i].max(1e-14);
        }
        let bound = self.settings.0.max_factor.ln();
        for factor in [WEAR_FACTOR, POWER_FACTOR, FORCE_FACTOR] {
            self.mean[factor] = self.mean[factor].clamp(-bound, bound);
        }
        self.mean[WEAR] = self.mean[WEAR].max(LEAST_WEAR_MM);
        self.hold_finite()
    }

    /// State of the edge as estimated.
    #[must_use]
    pub const fn state(&self) -> EdgeState {
        EdgeState::unchecked(self.elapsed_min, self.mean[WEAR])
    }

    /// What has been learnt so far.
    #[must_use]
    pub fn corrections(&self) -> Corrections {
        let factor = |i: usize| {
            let half = SIGMAS_95 * self.covariance[i][i].sqrt();
            let mean = self.mean[i];
            Correction { value: mean.exp(), low: (mean - half).exp(), high: (mean + half).exp() }
        };
        let half = SIGMAS_95 * self.covariance[WEAR][WEAR].sqrt();
        let wear = self.mean[WEAR];
        let bound = self.settings.0.max_factor.ln() * (1.0 - 1e-9);
        Corrections {
            wear_mm: Correction { value: wear, low: (wear - half).max(0.0), high: wear + half },
            wear_factor: factor(WEAR_FACTOR),
            power_factor: factor(POWER_FACTOR),
            force_factor: factor(FORCE_FACTOR),
            gated: self.gated,
            at_bound: self.mean[1..].iter().any(|value| value.abs() >= bound),
        }
    }

    /// The job with corrected coefficients, for planning the next interval.
    ///
    /// `caution_sigmas` raises every coefficient by so many standard deviations: 0 plans on the estimate, 2 keeps the
    /// limits in about 97 of 100 cases.
    ///
    /// # Errors
    /// `caution_sigmas` not finite or outside 0..=5, or so many of an estimate so unsure that no coefficient is finite.
    pub fn corrected(&self, job: &Job, caution_sigmas: f64) -> Result<Job, FieldError> {
        within("caution_sigmas", caution_sigmas, 0.0, 5.0)?;
        let factors = self.factors(caution_sigmas);
        if factors.iter().any(|factor| !factor.is_finite()) {
            return Err(too_extreme());
        }
        let [wear, power, force] = factors;
        Ok(job.with_model(job.model().scaled(wear, power, force)))
    }

    /// Factors on the coefficients of wear, power and force, so many standard deviations up.
    pub(super) fn factors(&self, caution_sigmas: f64) -> [f64; 3] {
        [WEAR_FACTOR, POWER_FACTOR, FORCE_FACTOR]
            .map(|i| (self.mean[i] + caution_sigmas * self.covariance[i][i].sqrt()).exp())
    }
}

//! Controller of the peak-to-peak vibration displacement (Ivanov et al. 2024, Eq. 1–7), one call per sample.
//!
//! Measured velocity and acceleration give the chatter frequency at each rising zero crossing of the velocity
//! (Eq. 6), from it the peak-to-peak displacement (Eq. 5), and from that the gain that the velocity is fed back with:
//! positive to stir vibrations up, negative to damp them. No allocation and no `std`: this is the code for the board.

use crate::field_error::{FieldError, within};

/// Unchecked settings of the controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControllerInput {
    /// Eigenfrequency f0 of the head, Hz: the chatter frequency until one is measured.
    pub eigenfrequency_hz: f64,
    /// Time between samples Δt, s.
    pub period_s: f64,
    /// Target A0 of the peak-to-peak displacement, mm.
    pub target_mm: f64,
    /// c1 of Eq. 1: how fast a deviation moves the gain.
    pub deviation_gain: f64,
    /// c2 of Eq. 1: how strongly a change of the displacement is opposed.
    pub rate_gain: f64,
    /// Tb of Eq. 1, s.
    pub time_constant_s: f64,
    /// g1 of Eq. 3: below (1 − g1)·A0 the gain is 1.
    pub low_share: f64,
    /// g2 of Eq. 3: above (1 + g2)·A0 the gain is −1.
    pub high_share: f64,
    /// Low-pass filter of the displacement, Hz; none leaves it unfiltered.
    ///
    /// The paper leaves it open. At 20 Hz and below the loop can end in a limit cycle.
    pub displacement_filter_hz: Option<f64>,
    /// Share by which each crossing moves the frequency estimate, 0..1; 1 leaves it unfiltered.
    pub frequency_share: f64,
}

impl ControllerInput {
    /// Settings of the paper (Tables 1 and 2), with a 50 Hz displacement filter and 0.3 per crossing.
    pub const IVANOV_2024: Self = Self {
        eigenfrequency_hz: 70.86,
        period_s: 300e-6,
        target_mm: 0.06,
        deviation_gain: 1.0,
        rate_gain: 1.0,
        time_constant_s: 0.07,
        low_share: 0.2,
        high_share: 0.2,
        displacement_filter_hz: Some(50.0),
        frequency_share: 0.3,
    };
}

/// Checked settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControllerSettings {
    input: ControllerInput,
    start_rad_s: f64,
    displacement_share: f64,
}

impl ControllerSettings {
    /// Checks settings.
    ///
    /// # Errors
    /// The first field that is not finite or out of range.
    pub fn new(input: ControllerInput) -> Result<Self, FieldError> {
        within("eigenfrequency_hz", input.eigenfrequency_hz, 0.1, 1e5)?;
        // Fewer than about eight samples per period leave no crossing to time.
        within("period_s", input.period_s, 1e-7, 0.125 / input.eigenfrequency_hz)?;
        within("target_mm", input.target_mm, 1e-6, 100.0)?;
        within("deviation_gain", input.deviation_gain, 0.0, 1e3)?;
        within("rate_gain", input.rate_gain, 0.0, 1e3)?;
        within("time_constant_s", input.time_constant_s, 1e-6, 1e3)?;
        within("low_share", input.low_share, 0.0, 1.0)?;
        within("high_share", input.high_share, 0.0, 1.0)?;
        within("frequency_share", input.frequency_share, 1e-6, 1.0)?;
        let displacement_share = match input.displacement_filter_hz {
            None => 1.0,
            Some(hz) => {
                within("displacement_filter_hz", hz, 1e-3, 1e6)?;
                1.0 - libm::exp(-core::f64::consts::TAU * hz * input.period_s)
            }
        };
        Ok(Self { input, start_rad_s: core::f64::consts::TAU * input.eigenfrequency_hz, displacement_share })
    }

    /// The data the settings were made of.
    #[must_use]
    pub const fn data(&self) -> &ControllerInput {
        &self.input
    }
}

/// One sample of the moving part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VibrationSample {
    /// Velocity, mm/s.
    pub velocity_mm_s: f64,
    /// Acceleration, mm/s².
    pub acceleration_mm_s2: f64,
}

/// What the controller answers to a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlStep {
    /// Gain b to feed the velocity back with, −1..1 (Eq. 3).
    pub gain: f64,
    /// Adapted gain bc, −1..1 (Eq. 7 and 2).
    pub adapted_gain: f64,
    /// Peak-to-peak displacement A, filtered, mm (Eq. 5).
    pub displacement_mm: f64,
    /// Displacement before the filter, mm.
    pub raw_displacement_mm: f64,
    /// Chatter frequency ω, filtered, rad/s (Eq. 6).
    pub frequency_rad_s: f64,
}

/// A sample that cannot be worked with; the state is as if it had not come, except that time went on.
///
/// Switch the actuator off for it: a gain computed from garbage may feed energy in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BadSample;

impl core::fmt::Display for BadSample {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("velocity or acceleration is not a usable number")
    }
}

impl core::error::Error for BadSample {}

/// State of the controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Controller {
    settings: ControllerSettings,
    frequency_rad_s: f64,
    displacement_mm: f64,
    adapted_gain: f64,
    /// Whether the last velocity that was not zero was negative.
    was_negative: bool,
    /// Samples since the last rising crossing; none before the first.
    since_crossing: Option<u32>,
}

impl Controller {
    /// Starts at rest: ω = 2π·f0, A = 0, bc = 0.
    #[must_use]
    pub const fn new(settings: ControllerSettings) -> Self {
        Self {
            settings,
            frequency_rad_s: settings.start_rad_s,
            displacement_mm: 0.0,
            adapted_gain: 0.0,
            was_negative: false,
            since_crossing: None,
        }
    }

    /// Peak-to-peak displacement A after the last sample that could be used, filtered, mm (Eq. 5).
    #[must_use]
    pub const fn displacement_mm(&self) -> f64 {
        self.displacement_mm
    }

    /// Chatter frequency ω after the last sample that could be used, filtered, rad/s (Eq. 6).
    #[must_use]
    pub const fn frequency_rad_s(&self) -> f64 {
        self.frequency_rad_s
    }

    /// Takes the next sample, exactly one period after the last.
    ///
    /// # Errors
    /// [`BadSample`] for a value that is not finite or so large that its square is not.
    pub fn step(&mut self, sample: VibrationSample) -> Result<ControlStep, BadSample> {
        // Elapsed time is counted in samples: an accumulated sum of periods would drift.
        self.since_crossing = self.since_crossing.map(|samples| samples.saturating_add(1));
        let VibrationSample { velocity_mm_s: v, acceleration_mm_s2: acc } = sample;
        let usable = |value: f64| value.is_finite() && value.abs() < 1e100;
        if !usable(v) || !usable(acc) {
            return Err(BadSample);
        }
        let set = &self.settings.input;
        // The sign is remembered across samples of exactly zero, which would otherwise hide a crossing.
        if v > 0.0 && self.was_negative {
            if let Some(samples) = self.since_crossing {
                let measured = core::f64::consts::TAU / (f64::from(samples) * set.period_s);
                self.frequency_rad_s += set.frequency_share * (measured - self.frequency_rad_s);
            }
            self.since_crossing = Some(0);
        }
        // A zero keeps the sign seen last.
        self.was_negative = v < 0.0 || (self.was_negative && v <= 0.0);
        let omega = self.frequency_rad_s;
        let (by_velocity, by_acceleration) = (v / omega, acc / (omega * omega));
        let raw_displacement_mm =
            2.0 * libm::sqrt(by_velocity * by_velocity + by_acceleration * by_acceleration);
        let before = self.displacement_mm;
        self.displacement_mm += self.settings.displacement_share * (raw_displacement_mm - before);
        let displacement = self.displacement_mm;
        let target = set.target_mm;
        let change = set.deviation_gain * (displacement / target - 1.0) * set.period_s / set.time_constant_s
            + set.rate_gain * (displacement - before) / target;
        self.adapted_gain = (self.adapted_gain - change).clamp(-1.0, 1.0);
        let gain = if displacement < (1.0 - set.low_share) * target {
            1.0
        } else if displacement > (1.0 + set.high_share) * target {
            -1.0
        } else {
            self.adapted_gain
        };
        Ok(ControlStep {
            gain,
            adapted_gain: self.adapted_gain,
            displacement_mm: displacement,
            raw_displacement_mm,
            frequency_rad_s: omega,
        })
    }
}

#[cfg(test)]
mod tests;

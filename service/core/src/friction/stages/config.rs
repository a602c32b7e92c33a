//! Thresholds of the stage detector, checked once.

use crate::friction::error::{Invalid, InvalidCode, between};

/// Longest moving average, in samples.
pub const LONGEST_SMOOTHING: usize = 31;

/// Thresholds as plain values; [`StageConfig::new`] checks them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StageParams {
    /// Samples of the centred moving average through which loads are judged; odd, 1 is no smoothing.
    pub smoothing_samples: usize,
    /// Rise of the feed-drive load over its idle load that means contact, points.
    pub contact_rise_points: f64,
    /// The same in multiples of the idle load's own mean deviation; the larger of both counts.
    pub contact_rise_deviations: f64,
    /// Samples in a row that have to show it.
    pub contact_samples: u32,
    /// Samples in the air before contact may be found.
    pub idle_samples: u32,
    /// Fall of the thrust from its maximum that means breakthrough, relative.
    pub breakthrough_fall: f64,
    /// Fall of the torque from its maximum that means stage C, relative.
    pub idle_travel_fall: f64,
    /// Rise of both loads from their minimum that means stage D, relative to their maxima.
    pub flange_rise: f64,
    /// Way over which a fall or rise has to last, mm.
    pub confirm_mm: f64,
    /// Exponent with which the thrust is put on a common speed before it is compared, 0 to 1: a change of feed
    /// is no stage.
    pub thrust_feed_exponent: f64,
    /// The same for the torque; 1 compares the energy per depth.
    pub torque_feed_exponent: f64,
}

impl Default for StageParams {
    fn default() -> Self {
        Self {
            smoothing_samples: 7,
            contact_rise_points: 1.5,
            contact_rise_deviations: 6.0,
            contact_samples: 3,
            idle_samples: 10,
            breakthrough_fall: 0.2,
            idle_travel_fall: 0.5,
            flange_rise: 0.06,
            confirm_mm: 0.2,
            thrust_feed_exponent: 0.5,
            torque_feed_exponent: 1.0,
        }
    }
}

/// Thresholds in range.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StageConfig {
    params: StageParams,
}

impl StageConfig {
    /// Checks the thresholds.
    ///
    /// # Errors
    /// With the field that is out of range.
    pub fn new(params: StageParams) -> Result<Self, Invalid> {
        if params.smoothing_samples.is_multiple_of(2) || params.smoothing_samples > LONGEST_SMOOTHING {
            let text = format!("must be odd and at most {LONGEST_SMOOTHING}");
            return Err(Invalid::new("smoothing_samples", InvalidCode::OutOfRange, text));
        }
        between("contact_rise_points", params.contact_rise_points, 0.01, 100.0)?;
        between("contact_rise_deviations", params.contact_rise_deviations, 0.0, 100.0)?;
        between("contact_samples", f64::from(params.contact_samples), 1.0, 1000.0)?;
        between("idle_samples", f64::from(params.idle_samples), 1.0, 10_000.0)?;
        between("breakthrough_fall", params.breakthrough_fall, 0.01, 0.99)?;
        between("idle_travel_fall", params.idle_travel_fall, 0.01, 0.99)?;
        between("flange_rise", params.flange_rise, 0.01, 0.99)?;
        between("confirm_mm", params.confirm_mm, 0.0, 10.0)?;
        between("thrust_feed_exponent", params.thrust_feed_exponent, 0.0, 1.0)?;
        between("torque_feed_exponent", params.torque_feed_exponent, 0.0, 1.0)?;
        Ok(Self { params })
    }

    /// The checked thresholds.
    #[must_use]
    pub const fn params(&self) -> &StageParams {
        &self.params
    }
}

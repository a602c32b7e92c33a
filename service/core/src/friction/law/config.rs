//! Parameters of the override law, checked once.

use crate::friction::error::{Invalid, InvalidCode, between, positive};
use crate::friction::feed_override::{OverrideBounds, OverrideRange};
use crate::friction::filter::FilterWeights;

/// Loads beyond this are no loads but a broken reading, in percent of the rating.
pub const IMPLAUSIBLE_LOAD_PERCENT: f64 = 1000.0;

/// How long the law stays off while the material heats up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Heating {
    /// The law acts from the first sample.
    None,
    /// Until this time after the start of the cycle, ms.
    Time {
        /// Duration in ms.
        ms: f64,
    },
    /// Until the tip is this deep, mm; a depth that is not known keeps the law off.
    Depth {
        /// Tip depth below first contact in mm.
        mm: f64,
    },
}

/// What an overload does to the rest of the cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum OverloadHold {
    /// The law alone answers to loads, however high.
    Off,
    /// Neutral until somebody acknowledges or the next cycle starts.
    UntilAcknowledged {
        /// Relative load L_R at which it counts as an overload, above 1.
        relative_load: f64,
    },
    /// Neutral until the next cycle starts; an acknowledgement does not release it.
    UntilNextCycle {
        /// Relative load L_R at which it counts as an overload, above 1.
        relative_load: f64,
    },
}

/// Everything the law can be told, as plain values; [`LawConfig::new`] checks them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LawParams {
    /// Weights of the load filter, Eq. 1.
    pub weights: FilterWeights,
    /// Preferred feed-drive load L_set in percent; `None` when the rating behind the percent is not known.
    pub set_feed_drive_percent: Option<f64>,
    /// Preferred spindle load L_set in percent; `None` when the rating behind the percent is not known.
    pub set_spindle_percent: Option<f64>,
    /// Intensity b of Eq. 3, without unit. The paper gives no value.
    pub intensity: f64,
    /// Limits of the machine and of the profile; the profile's are \[OVR_min, OVR_max\] of Eq. 4.
    pub bounds: OverrideBounds,
    /// Largest rise of the override per sample in points; `None` switches the limit off. Reductions are never
    /// limited.
    pub rise_limit_points: Option<f64>,
    /// While the material heats up the law is off.
    pub heating: Heating,
    /// Time between two samples (one IPO cycle) in ms.
    pub period_ms: f64,
    /// A step in time longer than this is a gap, in ms.
    pub longest_gap_ms: f64,
    /// Good samples in a row, after a bad one, before the law may raise again.
    pub settling_samples: u32,
    /// What an overload does to the rest of the cycle.
    pub overload: OverloadHold,
}

impl LawParams {
    /// The paper's law for these preferred loads (percent): 10 ms IPO, 2 s of heating, override 5 to 200 %,
    /// with b = 2, five points of rise per IPO and no overload hold.
    ///
    /// # Errors
    /// Never with these constants; the ranges are checked like any other.
    pub fn paper(set_feed_drive_percent: f64, set_spindle_percent: f64) -> Result<Self, Invalid> {
        let range = OverrideRange::new(5.0, 200.0)?;
        Ok(Self {
            weights: FilterWeights::default(),
            set_feed_drive_percent: Some(set_feed_drive_percent),
            set_spindle_percent: Some(set_spindle_percent),
            intensity: 2.0,
            bounds: OverrideBounds::new(range, range),
            rise_limit_points: Some(5.0),
            heating: Heating::Time { ms: 2000.0 },
            period_ms: 10.0,
            longest_gap_ms: 25.0,
            settling_samples: 4,
            overload: OverloadHold::Off,
        })
    }
}

/// A law that can be run: every parameter is in range and fits the others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LawConfig {
    params: LawParams,
}

impl LawConfig {
    /// Checks the parameters.
    ///
    /// # Errors
    /// With the field's name when a value is out of range, when neither preferred load is given, or when a gap
    /// would be shorter than a period.
    pub fn new(params: LawParams) -> Result<Self, Invalid> {
        if params.set_feed_drive_percent.is_none() && params.set_spindle_percent.is_none() {
            let text = "at least one drive needs a preferred load";
            return Err(Invalid::new("set_feed_drive_percent", InvalidCode::Inconsistent, text));
        }
        if let Some(load) = params.set_feed_drive_percent {
            between("set_feed_drive_percent", load, 0.1, 400.0)?;
        }
        if let Some(load) = params.set_spindle_percent {
            between("set_spindle_percent", load, 0.1, 400.0)?;
        }
        between("intensity", params.intensity, 0.01, 100.0)?;
        if let Some(points) = params.rise_limit_points {
            positive("rise_limit_points", points, 255.0)?;
        }
        match params.heating {
            Heating::None => {}
            Heating::Time { ms } => {
                between("heating.ms", ms, 0.0, 600_000.0)?;
            }
            Heating::Depth { mm } => {
                between("heating.mm", mm, 0.0, 1000.0)?;
            }
        }
        positive("period_ms", params.period_ms, 1000.0)?;
        positive("longest_gap_ms", params.longest_gap_ms, 10_000.0)?;
        if params.longest_gap_ms < params.period_ms {
            let text = "must not be shorter than period_ms";
            return Err(Invalid::new("longest_gap_ms", InvalidCode::Inconsistent, text));
        }
        match params.overload {
            OverloadHold::Off => {}
            OverloadHold::UntilAcknowledged { relative_load }
            | OverloadHold::UntilNextCycle { relative_load } => {
                if relative_load <= 1.0 {
                    let text = "must be above 1: at 1 the load is the preferred one";
                    return Err(Invalid::new("overload.relative_load", InvalidCode::OutOfRange, text));
                }
                between("overload.relative_load", relative_load, 1.0, 100.0)?;
            }
        }
        Ok(Self { params })
    }

    /// The checked parameters.
    #[must_use]
    pub const fn params(&self) -> &LawParams {
        &self.params
    }
}

//! What an operation says about its turning: the library entry it uses, depth, limits and pairs to choose from.

use crate::field_error::{FieldError, within};
use crate::ids::ModelId;

use super::{Accumulation, Cut, DomainInput, Economics, Job, JobInput, Limits, TurningModel};

/// How an operation is turned. Everything but the coefficients, which stand in the library.
#[derive(Debug, Clone, PartialEq)]
pub struct TurningSetup {
    /// Library entry.
    pub model: ModelId,
    /// Depth of cut, mm.
    pub depth_mm: f64,
    /// Diameter that is turned, mm: turns cutting speeds into spindle speeds; none leaves them in m/min.
    pub diameter_mm: Option<f64>,
    /// Length of the interval that the next pair is chosen for, min.
    pub interval_min: f64,
    /// Limits.
    pub limits: Limits,
    /// Pairs to choose from.
    pub domain: DomainInput,
    /// How wear adds up.
    pub accumulation: Accumulation,
    /// Standard deviations that every coefficient is raised by before choosing; 2 keeps the limits in about 97 of
    /// 100 cases.
    pub caution_sigmas: f64,
}

impl TurningSetup {
    /// Checks everything that does not depend on the coefficients.
    ///
    /// # Errors
    /// The first bad field.
    pub fn check(&self) -> Result<(), FieldError> {
        if let Some(diameter) = self.diameter_mm {
            within("diameter_mm", diameter, 0.1, 1e5)?;
        }
        within("caution_sigmas", self.caution_sigmas, 0.0, 5.0)?;
        // No check of a job looks at the coefficients, so any entry stands for the one that is named.
        self.job(TurningModel::alaskari_oraby_2017()).map(|_| ())
    }

    /// The job with the coefficients of its entry.
    ///
    /// # Errors
    /// As [`TurningSetup::check`].
    pub fn job(&self, model: TurningModel) -> Result<Job, FieldError> {
        Job::new(JobInput {
            model,
            depth_mm: self.depth_mm,
            interval_min: self.interval_min,
            limits: self.limits,
            domain: self.domain,
            accumulation: self.accumulation,
            economics: Economics { tool_change_min: 0.0, edge_cost: 0.0, machine_cost_per_min: 0.0 },
        })
    }

    /// Spindle speed of a pair, 1/min; none where the diameter is not known.
    #[must_use]
    pub fn spindle_rpm(&self, cut: Cut) -> Option<f64> {
        self.diameter_mm.map(|diameter| cut.speed_m_min() * 1000.0 / (std::f64::consts::PI * diameter))
    }

    /// Cutting speed at a spindle speed, m/min; none where the diameter is not known.
    #[must_use]
    pub fn speed_m_min(&self, spindle_rpm: f64) -> Option<f64> {
        self.diameter_mm.map(|diameter| std::f64::consts::PI * diameter * spindle_rpm / 1000.0)
    }
}

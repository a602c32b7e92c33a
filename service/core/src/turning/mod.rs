//! Rough turning by model-based adaptive control (Alaskari & Oraby 2017).
//!
//! Every interval of the cut gets the speed and feed that remove most metal within the limits of power, force and
//! wear; wear is carried on until no pair is left. Beyond the paper: any depth and interval, a continuous optimum,
//! a plan over the whole life, and coefficients that follow what the machine measures.
//!
//! Parse a [`ModelInput`] (a library entry) and a [`JobInput`], then [`greedy_plan`], [`whole_life_plan`],
//! [`fixed_run`] or, interval by interval, [`Selector`] with [`Adaptation`]. Storage of entries does not belong here.
//!
//! ```
//! use feedwright_core::turning::{EdgeState, Job, JobInput, best_fixed_run, compare, greedy_plan};
//!
//! let job = Job::new(JobInput::alaskari_oraby_2017())?;
//! let plan = greedy_plan(&job, EdgeState::FRESH);
//! assert_eq!(plan.intervals.len(), 14);
//! assert_eq!((plan.intervals[0].cut.speed_m_min(), plan.intervals[0].cut.feed_mm_rev()), (150.0, 0.58));
//! if let Some(fixed) = best_fixed_run(&job, EdgeState::FRESH) {
//!     println!("removes {:?} × a life at a fixed pair", compare(&plan, &fixed).removed);
//! }
//! # Ok::<(), feedwright_core::field_error::FieldError>(())
//! ```

mod adapt;
mod continuous;
mod domain;
mod grid;
mod job;
mod life;
mod model;
mod next;
mod plan;
mod select;
mod setup;

pub use adapt::{Adaptation, AdaptationInput, AdaptationSettings, Correction, Corrections, Measured};
pub use domain::{Axis, Domain, DomainInput, MAX_GRID_PAIRS, Range};
pub use job::{Accumulation, Economics, EdgeState, Job, JobInput, Limits, Outcome, Outside};
pub use life::{Objective, WholeLife, whole_life_plan};
pub use model::{LoadLaw, ModelInput, ModelRanges, ScatterInput, ToolWorkMachine, TurningModel, WearLaw};
pub use next::{EdgeInterval, MAX_EDGE_INTERVALS, NextCut, Readings, TURNING_LAW_VERSION, next_cut};
pub use plan::{
    Comparison, EndOfLife, MAX_INTERVALS, Plan, Totals, best_fixed_run, compare, fixed_run, greedy_plan,
};
pub use select::{Binding, Chosen, Limit, Selector, Utilisation};
pub use setup::TurningSetup;

use crate::field_error::{FieldError, within};

/// Speed and feed of one interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cut {
    speed_m_min: f64,
    feed_mm_rev: f64,
}

impl Cut {
    /// A pair to be cut with.
    ///
    /// # Errors
    /// A value that is not finite, not positive or absurdly large.
    pub fn new(speed_m_min: f64, feed_mm_rev: f64) -> Result<Self, FieldError> {
        Ok(Self {
            speed_m_min: within("speed_m_min", speed_m_min, 1e-3, 1e5)?,
            feed_mm_rev: within("feed_mm_rev", feed_mm_rev, 1e-6, 100.0)?,
        })
    }

    /// Cutting speed, m/min.
    #[must_use]
    pub const fn speed_m_min(self) -> f64 {
        self.speed_m_min
    }

    /// Feed, mm/rev.
    #[must_use]
    pub const fn feed_mm_rev(self) -> f64 {
        self.feed_mm_rev
    }
}

#[cfg(test)]
mod tests;

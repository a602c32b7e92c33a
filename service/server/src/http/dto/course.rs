//! The course of a cycle in JSON.

use crate::course::{Course, Overload, Place, StageSpan};
use feedwright_core::summary::EnergyBasis;
use serde::Serialize;
use utoipa::ToSchema;

/// The course of a cycle; columns have one entry for each sample.
#[derive(Debug, Serialize, ToSchema)]
pub struct CourseBody {
    /// Feed-drive load as the control filters it (Stryczek & Błaszczak 2020, Eq. 1), %.
    pub filtered_feed_drive_load_percent: Option<Vec<f64>>,
    /// Spindle load likewise, %.
    pub filtered_spindle_load_percent: Option<Vec<f64>>,
    /// Energy so far, J; null where no basis tells it, or where the machine was rated or fitted anew since.
    pub energy_joules: Option<Vec<f64>>,
    /// Its basis.
    pub energy_basis: Option<&'static str>,
    /// First contact; null where none was found, and for other processes than friction drilling.
    pub contact: Option<PlaceBody>,
    /// The stages that were found, in their order.
    pub stages: Vec<StageBody>,
    /// Set load of the feed drive, %; null where the operation has none.
    pub feed_drive_load_set_percent: Option<f64>,
    /// Set load of the spindle, %.
    pub spindle_load_set_percent: Option<f64>,
    /// Where a filtered load was over its set load, after first contact; at most 200.
    pub overloads: Vec<OverloadBody>,
    /// Whether there were more.
    pub overloads_cut: bool,
}

/// A place in a cycle.
#[derive(Debug, Serialize, ToSchema)]
pub struct PlaceBody {
    /// Number of the sample, from 0.
    pub index: usize,
    /// Time since the start of the cycle, ms.
    pub time_ms: f64,
    /// Depth, mm.
    pub depth_mm: Option<f64>,
}

/// A stage of the hole.
#[derive(Debug, Serialize, ToSchema)]
pub struct StageBody {
    /// `A` (to the largest thrust), `B` (to the largest torque), `C` (idle travel) or `D` (flange).
    pub stage: &'static str,
    /// Where it begins.
    pub from: PlaceBody,
    /// Where it ends.
    pub to: PlaceBody,
    /// Its energy, J.
    pub energy_joules: Option<f64>,
}

/// A stretch over a set load.
#[derive(Debug, Serialize, ToSchema)]
pub struct OverloadBody {
    /// `feed_drive` or `spindle`.
    pub drive: &'static str,
    /// Where it begins.
    pub from: PlaceBody,
    /// Where it ends.
    pub to: PlaceBody,
    /// The highest filtered load, %.
    pub highest_percent: f64,
}

impl From<Place> for PlaceBody {
    fn from(place: Place) -> Self {
        Self { index: place.index, time_ms: place.time_ms, depth_mm: place.depth_mm }
    }
}

impl From<StageSpan> for StageBody {
    fn from(span: StageSpan) -> Self {
        let StageSpan { stage, from, to, energy_joules } = span;
        Self { stage, from: from.into(), to: to.into(), energy_joules }
    }
}

impl From<Overload> for OverloadBody {
    fn from(overload: Overload) -> Self {
        let Overload { drive, from, to, highest_percent } = overload;
        Self { drive, from: from.into(), to: to.into(), highest_percent }
    }
}

impl From<Course> for CourseBody {
    fn from(course: Course) -> Self {
        let (basis, joules) = course.energy.unzip();
        Self {
            filtered_feed_drive_load_percent: course.filtered_feed_drive,
            filtered_spindle_load_percent: course.filtered_spindle,
            energy_joules: joules,
            energy_basis: basis.map(EnergyBasis::as_str),
            contact: course.contact.map(Into::into),
            stages: course.stages.into_iter().map(Into::into).collect(),
            feed_drive_load_set_percent: course.set_percent.0,
            spindle_load_set_percent: course.set_percent.1,
            overloads: course.overloads.into_iter().map(Into::into).collect(),
            overloads_cut: course.overloads_cut,
        }
    }
}

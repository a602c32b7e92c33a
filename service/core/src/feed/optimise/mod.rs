//! The fastest feed over depth that keeps both drives at or below their set loads, learned from recorded cycles.
//!
//! What Stryczek & Błaszczak 2020 do by hand in section 4.2 – look at the curves, move a knot, try again – done from the
//! recordings. [`optimise`] takes cycles, [`Settings`] and the last tried profile, and returns a [`Proposal`]: knots, why
//! each section is as it is, what is expected with bands, and the wear up to which it holds. Try it, record, ask again;
//! [`compare`] tells how the prediction turned out and [`calibrate`] how far to trust the next one.
//!
//! | file | what |
//! |---|---|
//! | `settings` | limits, confidence, objective |
//! | `recording`, `course` | recorded cycles, cleaned and read over depth |
//! | `dead` | readings of a drive that is dead, told from an air cut |
//! | `relation` | how the loads depend on depth, feed, heat and wear, with uncertainty |
//! | `plan` | the envelope: the fastest feed at every depth, and what binds |
//! | `simplify` | few knots under it |
//! | `explain` | sections in words |
//! | `outcome` | prediction against actual |
//! | `bands` | profiles per wear band |
//!
//! Nothing here knows a process model. Feeds are mm/min, depths mm, loads percent of the declared rating, times s.
//! The same cycles in any order give the same bits. Storage and HTTP do not belong here.

mod bands;
mod course;
mod dead;
mod explain;
mod grid;
mod outcome;
mod plan;
mod predict;
mod profile;
mod propose;
mod recording;
mod relation;
mod ridge;
mod settings;
mod simplify;
#[cfg(test)]
mod tests;

pub use bands::{MOST_BANDS, WearBand, check_edges, wear_bands};
pub use explain::Section;
pub use outcome::{Actual, Comparison, Deviation, calibrate, compare, coverage};
pub use plan::Binding;
pub use predict::{Band, Prediction};
pub use profile::{Knots, acceleration_mm_s2};
pub use propose::{Advice, Identified, Proposal, Warning, optimise};
pub use recording::{LoadSignal, MOST_CYCLES, MOST_SAMPLES, RecordedCycle, SkipReason, Skipped};
pub use settings::{
    Bushing, Heating, MOST_PROFILE_KNOTS, Objective, Settings, SettingsParams, USUAL_PROFILE_KNOTS,
};

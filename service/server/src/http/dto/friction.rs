//! Friction drilling in JSON: the process model's values, feed programs and laws, and what a simulation answers.
//!
//! Every value may be left out; the paper's then holds (Stryczek & Błaszczak 2020, and what was fitted to it). The
//! names are those of the core, so that a refused field is found by its path.

pub mod control;
pub mod model;
pub mod simulation;

use feedwright_core::friction::error::Invalid;
use feedwright_core::invalid::Violation;

/// A refusal of the core as a violation, with its path in the body.
pub fn refused(error: &Invalid, path: impl FnOnce(&str) -> String) -> Violation {
    Violation::new(path(error.field()), error.code().as_str(), error.message())
}

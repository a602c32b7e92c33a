//! Stored friction cycles under another control: read, made fit for the core, and compared with what happened.
//!
//! The core's `friction::whatif` predicts; here is what it is told: which part of a cycle was in contact, what the
//! idle loads were, what ran, and which of the tool's first cycles the load–feed relation is learned from. Reads are
//! bounded by named constants. JSON and roles do not belong here.

mod control;
mod cycle;
mod relation;

pub use control::{Asked, AskedLaw, AskedProfile, Prediction, predict};
pub use cycle::{ContactCycle, IdleLoads, IdleSource, TorqueSource, Unusable};
pub use relation::{Learned, Library, MOST_LEARNED, MOST_SCANNED};

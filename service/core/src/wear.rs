//! How worn a tool is: a fold over its unique cycles in the order they were run.
//!
//! The level is relative: energy per cycle against the same tool when new, like compared with like
//! (Stryczek & Błaszczak 2020: the worn tool needs 9.3 % more). Nothing here depends on the order of arrival:
//! [`ToolFold`] takes cycles and events in [`OrderKey`] order, and the store refolds when a late one comes.

mod basis;
mod bytes;
mod facts;
mod fold;
mod judge;
mod key;
mod trend;
mod verdict;

#[cfg(test)]
mod feed_tests;

#[cfg(test)]
mod recorded_tests;

#[cfg(test)]
mod tests;

pub use facts::{CycleFacts, OrderKey};
pub use fold::{FOLD_VERSION, FoldSettings, ToolFold};
pub use verdict::{
    BaselineEvidence, BaselineKey, Earlier, Exclusion, ExclusionCounts, FeedEvidence, Level, LevelBasis,
    MOST_LEVEL, Masked, ReferenceCycles, Remaining, SecondIndicators, ToolState, Trend, Verdict,
};

/// The level at which a tool is worn, latched until it is changed, reground or reset.
pub const WORN_LEVEL: f64 = 1.10;
/// The level at which a tool is warned of.
pub const WARNING_LEVEL: f64 = 1.07;
/// A warning is cleared below this level.
pub const WARNING_CLEARED_LEVEL: f64 = 1.05;

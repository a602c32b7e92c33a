//! Adaptive feed law: drive loads in, feed override out, one step per interpolator (IPO) cycle.
//!
//! Stryczek & Błaszczak 2020, Eq. 1–4, inside the safety envelope: the law may lower at once, raises only on
//! good data and slowly, and every step says what it did and which limit acted. What does not belong here:
//! finding contact (the caller says when a cycle starts) and answering a repeated sample (the stream does).

mod config;
pub mod equations;
mod reason;
mod step;
#[cfg(test)]
mod tests;

pub use config::{Heating, IMPLAUSIBLE_LOAD_PERCENT, LawConfig, LawParams, OverloadHold};
pub use reason::{Reason, Reasons};
pub use step::{Drive, LawSample, LawState, LawStep};

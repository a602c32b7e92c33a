//! Adaptive feed law: drive loads in, feed override out, one step per interpolator (IPO) cycle.
//!
//! Stryczek & Błaszczak 2020, Eq. 1–4, inside the safety envelope: the law may lower at once, raises only on
//! good data and slowly, and every step says what it did and which limit acted. What does not belong here:
//! finding contact (the caller says when a cycle starts) and answering a repeated sample (the stream does).
//!
//! ```
//! use feedwright_core::friction::law::{LawConfig, LawParams, LawSample, LawState, Reason};
//!
//! # fn main() -> Result<(), feedwright_core::friction::error::Invalid> {
//! let config = LawConfig::new(LawParams::paper(30.0, 40.0)?)?;
//! let mut state = LawState::new();
//! let sample = LawSample {
//!     time_ms: 2010.0,
//!     contact_ms: Some(2010.0),
//!     depth_mm: Some(4.2),
//!     feed_drive_percent: Some(18.0),
//!     spindle_percent: Some(22.0),
//! };
//! let step = state.step(&config, &sample);
//! assert!(step.ovr.percent() > 100.0 && step.reasons.contains(Reason::LoadBelowSet));
//! # Ok(())
//! # }
//! ```

mod config;
pub mod equations;
mod reason;
mod step;
#[cfg(test)]
mod tests;

pub use config::{Heating, IMPLAUSIBLE_LOAD_PERCENT, LawConfig, LawParams, OverloadHold};
pub use reason::{Reason, Reasons};
pub(crate) use step::time_is_bad;
pub use step::{Drive, LawSample, LawState, LawStep};

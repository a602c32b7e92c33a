//! Replays recorded cycles over HTTP, as a machine would.
//!
//! A mapping file says what a recording's columns are ([`mapping::Mapping`]); [`Plan::read`] makes of both the same
//! registrations, ids, times and contents every time; `run` posts them and asks again until each is answered.
//! Nothing is remembered of what was posted: the service knows a cycle by its id and content, so a replay that was
//! interrupted is started again from the beginning and neither loses nor doubles anything.
//!
//! To add a recording, add a folder with its files, licence and mapping; no code belongs to one recording.

pub mod client;
pub mod cut;
pub mod fleet;
pub mod mapping;
pub mod plan;
pub mod progress;
pub mod quantity;
pub mod recordings;
pub mod refusals;
pub mod registration;
pub mod report;
pub mod run;
pub mod shift;
pub mod table;
pub mod template;
mod timing;

pub use plan::{Plan, RecordedCycle};
pub use shift::Start;

/// What stops a replay.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The mapping file says something that cannot be.
    #[error("mapping: {0}")]
    Mapping(String),
    /// A file of the recording cannot be read as the mapping says.
    #[error("{file}: {message}")]
    Recording {
        /// Which file.
        file: String,
        /// What is wrong.
        message: String,
    },
    /// The file that keeps the chosen shift cannot be used.
    #[error("state file {path}: {message}")]
    State {
        /// Which file.
        path: String,
        /// What is wrong.
        message: String,
    },
    /// Cycles were refused or put into quarantine.
    #[error("{refused} of {posted} cycles were refused, {alike} of them as this one: {first}")]
    NotTaken {
        /// How many were not taken.
        refused: u64,
        /// How many were posted.
        posted: u64,
        /// How many of the refused had the commonest reason.
        alike: u64,
        /// What was said of the first of those.
        first: String,
    },
    /// The service refuses in a way that every further cycle would meet too.
    #[error("{method} {path}: {status} {detail}")]
    Refused {
        /// The method.
        method: &'static str,
        /// The path.
        path: String,
        /// The status.
        status: u16,
        /// The problem it answered.
        detail: String,
    },
    /// The service was not reached for so long that it was given up.
    #[error("{url}: given up after {seconds} s: {detail}")]
    GivenUp {
        /// The service.
        url: String,
        /// How long it was tried.
        seconds: u64,
        /// The last thing that went wrong.
        detail: String,
    },
    /// It was told to stop.
    #[error("it was told to stop; started again it goes on")]
    Stopped,
    /// The service's answer cannot be read.
    #[error("{path}: unreadable answer: {detail}")]
    Answer {
        /// The path.
        path: String,
        /// What is wrong.
        detail: String,
    },
}

//! The closed loop of one running cycle: numbered samples in, bounded overrides out.
//!
//! A pure state machine: the time is an argument, what comes in is a value, and every sample is answered, with reasons.
//! It holds the samples too, since which of them are new, repeated or missing decides about the answer and about what
//! is stored at the end. Connections, encodings and storage do not belong here.
//!
//! | module | what |
//! |---|---|
//! | [`cycle`] | the running cycle: the sequence rules, ages and expiry around a process |
//! | [`control`] | one enum over the processes: what answers a sample that may be judged |
//! | [`profile`] | a cycle that names a feed profile: whether it may be run, and what it asks of the loop |
//! | [`record`] | the samples by their numbers, with what each was answered |
//! | [`reason`] | why an answer is what it is |
//! | [`plunge`] | approach, work and retract feeds of a plunge (Lengerov) |
//! | [`monitor`] | blocks of vibration, for set-up (Ivanov et al. 2024) |
//!
//! The safety envelope: an override leaves only as a [`FeedOverride`](crate::friction::feed_override::FeedOverride),
//! whose bounds are the machine's and the profile's; on anything but good data it is the lower of 100 % and the override
//! in force; it rises by no more than the permitted points per sample, and falls at once.
//!
//! A new process is a variant of [`control::Control`] with its step, its line here and its tests beside the others'.

pub mod control;
pub mod cycle;
pub mod monitor;
pub mod plunge;
pub mod profile;
pub mod reason;
pub mod record;
#[cfg(test)]
mod tests;

pub use control::{Control, Standing};
pub use cycle::{Answer, Begun, LoopSettings, Mode, RunningCycle, SampleAdvice};
pub use reason::{LoopReason, LoopReasons};
pub use record::{Batch, Record};

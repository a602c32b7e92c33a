//! From the bytes a machine sends to a cycle that is committed.
//!
//! HTTP and its status codes do not belong here, nor does what a cycle means.

pub mod body;
pub mod content;
pub mod intake;
mod number;
mod pulse;
pub mod room;
pub(crate) mod scan;
pub mod writer;

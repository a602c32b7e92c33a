//! Feed over depth: profiles, and the optimiser that learns the fastest one from recorded cycles.
//!
//! Storage, HTTP and the recording itself do not belong here.

pub mod optimise;

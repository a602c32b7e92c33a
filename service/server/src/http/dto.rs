//! Bodies of the API: what JSON looks like, and how it becomes values of the core.
//!
//! A body that is read denies unknown fields and turns into a core value with every violation named by its path.
//! Names carry their unit. Nothing here decides anything.

pub mod cycle;
pub mod recommendation;
pub mod text;
pub mod time;
pub mod wear;
pub mod word;

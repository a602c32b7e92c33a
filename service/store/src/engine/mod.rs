//! SQL that both engines understand, written once and compiled for each.
//!
//! Every engine includes this folder as a module of its own, with its `Db`, its `Engine` and its `dialect`. Functions
//! take the connection of a transaction that the caller began; none begins, commits or locks anything by itself but
//! through `dialect`. What only one engine says belongs into that engine's folder.

mod alarms;
mod audit;
mod check;
mod commit;
pub(super) mod cycles;
mod energies;
mod feed_profiles;
mod fleet;
mod implement;
mod life;
mod machines;
mod memory;
mod models;
mod operations;
mod quarantine;
mod recommendations;
mod registry;
mod retention;
mod series;
mod sessions;
mod streams;
mod sums;
mod tokens;
mod tools;
mod transaction;
mod verify;
mod watch;
pub(super) mod wear;

pub(super) use memory::Memory;
pub(super) use wear::Heads;

use super::{Conn, Db, Engine, Writer, dialect};

/// What stands for later than this from now was noted by a clock that was ahead, µs: those of several servers are apart by
/// less.
const CLOCK_AHEAD_US: i64 = 600_000_000;
/// The same of a single server, whose clock is only ever set by so little while it runs.
const ONE_CLOCK_US: i64 = 1_000_000;

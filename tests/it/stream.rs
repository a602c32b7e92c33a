//! Machines' streams over real sockets, with a client of the tests' own.

mod breaks;
pub(crate) mod client;
mod cycles;
mod doors;
mod killed;
mod processes;
mod profiles;
mod servers;

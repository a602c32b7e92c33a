//! The closed loop over a WebSocket: samples in, overrides out, the cycle stored at its end.
//!
//! What a message means is decided without a socket: [`message`] and [`binary`] read, [`answer`] writes, [`cycle`] is a
//! running cycle with what it will be stored as, and the law and its envelope are the core's. [`connection`] is one
//! socket; [`slots`] holds each machine's running cycle, so that it survives its connection, and who may use it; [`standing`]
//! ends its law where machine, tool or feed profile are changed while it runs.
//!
//! A new message is a variant of [`message::Incoming`], a step in [`connection`], a line in [`asyncapi`] and one in
//! docs/stream.md. Laws do not belong here.

pub mod answer;
pub mod asyncapi;
pub mod binary;
pub mod connection;
pub mod cycle;
pub mod finish;
pub mod leases;
pub mod message;
pub mod opening;
pub mod overload;
pub mod slots;
pub mod standing;

pub use slots::Streams;

use crate::state::AppState;

/// Begins to prolong leases, and to read again what running cycles were begun with.
pub fn start(state: &AppState) {
    leases::start(state);
    standing::start(state);
}

/// The subprotocol: another version is another name.
pub const SUBPROTOCOL: &str = "feedwright.v1";

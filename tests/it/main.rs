//! One binary with every story; a module per subject.

#![expect(clippy::unwrap_used, reason = "helpers of stories are part of the stories")]

mod described;
mod documents;
mod engines;
mod friction;
mod fuzz;
mod hang_ups;
mod http;
mod live;
mod processes;
mod recordings;
mod shop;
mod store;
mod stream;

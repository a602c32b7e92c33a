//! One binary with every story; a module per subject.

#![expect(clippy::unwrap_used, reason = "a story that cannot go on has failed")]

mod recordings;
mod shop;
mod store;

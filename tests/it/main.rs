//! One binary with every story; a module per subject.

mod recordings;
mod shop;
mod store;

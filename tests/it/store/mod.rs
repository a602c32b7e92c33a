//! Stories of the store, each told to both engines.

mod fleet;
pub(crate) mod given;

mod alarms;
mod alike;
mod cycles;
mod models;
mod registry;
mod replicas;
mod service;
mod watch;
mod wear;

//! Stories of the store, each told to both engines.

mod fleet;
pub(crate) mod given;

pub(crate) use given::{Given, shop};

mod alarms;
mod alike;
mod cycles;
mod models;
mod registry;
mod replicas;
mod service;
mod watch;
mod wear;

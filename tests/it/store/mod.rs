//! Stories of the store, each told to both engines.

pub(crate) mod given;

mod alarms;
mod alike;
mod cycles;
mod models;
mod registry;
mod replicas;
mod service;
mod streams;
mod watch;
mod wear;

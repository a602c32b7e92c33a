//! Stories of the store, each told to both engines.

mod fleet;
mod given;

mod alarms;
mod alike;
mod cycles;
mod models;
mod registry;
mod replicas;
mod service;
mod wear;

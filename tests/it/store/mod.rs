//! Stories of the store, each told to both engines.

mod given;

mod alarms;
mod alike;
mod cycles;
mod models;
mod operations;
mod registry;
mod replicas;
mod retention;
mod service;
mod transfer;
mod wear;

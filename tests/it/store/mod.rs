//! Stories of the store, each told to both engines.

mod given;

mod alarms;
mod cycles;
mod registry;
mod service;
mod wear;

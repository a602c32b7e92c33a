//! Stories of the store, each told to both engines.

mod fleet;
pub(crate) mod given;

pub(crate) use given::{Given, shop};

mod alarms;
mod alike;
mod assumed;
mod changed_operation;
mod check;
mod citus;
mod cycles;
mod feed_profiles;
mod journal;
mod life;
mod log;
mod models;
pub(crate) mod operations;
mod plans;
mod postponed;
mod recent;
mod registry;
mod replicas;
mod retention;
mod row_sums;
mod service;
mod streams;
mod transfer;
mod upgrades;
mod vanished;
mod watch;
mod wear;

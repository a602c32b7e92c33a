//! The server from the outside: the real router, and real sockets where sockets matter.

mod app;
mod caller;
pub(crate) mod commands;
mod database_full;
mod demoted;
mod feed_profiles;
mod full_disk;
mod killed;
mod listening;
mod lists;
mod matrix;
mod openapi;
mod outage;
mod problems;
mod quarantine;
mod reading;
mod registry;
mod replicas;
mod retention;
mod service;
mod sessions;
mod sockets;
mod tls;
mod tokens;
mod traces;
mod transfers;
mod whole_history;

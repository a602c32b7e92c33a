//! The service: HTTP, configuration and the command line around the store and the science.
//!
//! [`server::Server::start`] is the service as a value; the command line is one of its callers. What a new part
//! has to do stands in the doc of its module: a route in [`http`], a setting in [`config`], a metric in [`metrics`],
//! a command in [`cli`]. SQL belongs to the store, and whatever decides about tools and feeds to the core.

pub mod auth;
pub mod cli;
pub mod clock;
pub mod config;
pub mod course;
pub mod data_dir;
pub mod database;
pub mod http;
pub mod ingest;
pub mod jobs;
pub mod json;
pub mod lifecycle;
pub mod live;
pub mod metrics;
mod readiness;
mod refold;
pub mod replay;
pub mod retention;
pub mod series;
pub mod server;
pub mod state;
pub mod stream;
mod sums;
pub mod table;
pub mod telemetry;
pub mod tls;
pub mod ui;
pub mod watch;
pub mod what_if;

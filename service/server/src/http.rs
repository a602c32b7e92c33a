//! The API: a handler per route, bound together by one table.
//!
//! A new route is a handler with its `#[utoipa::path]` in the file of its noun, its bodies in `dto/`, and a line with
//! its roles in [`routes::table`]; nothing else mounts it, describes it or lets anybody use it.
//! Handlers are thin: decide by one pure call, save, reply. SQL and science do not belong here.

pub mod body;
mod columns;
pub mod compute;
pub mod cursor;
pub mod cycles;
pub mod dto;
pub mod edge;
pub mod export;
pub mod extract;
pub mod negotiate;
pub(crate) mod once;
pub mod openapi;
pub mod precondition;
pub mod prefer;
pub mod problem;
pub mod recommendations;
pub mod routes;
pub mod wear;

mod alarms;
mod audit;
mod calibrations;
mod changes;
mod continuity;
mod course;
mod decimal;
mod feed_profiles;
mod fleet;
mod friction;
mod health;
mod jobs;
mod known;
mod library;
mod life;
mod live;
mod machines;
mod operations;
mod peak_to_peak;
mod plunge;
mod profile_evidence;
mod profile_files;
mod profile_optimise;
mod quarantine;
mod retention;
mod samples;
mod series;
mod session;
mod stream;
mod summaries;
mod tokens;
mod tool_events;
mod tools;
mod turning;
pub(crate) mod unsigned;
mod value_series;
mod viewer;
mod what_if;

pub use routes::{metrics_router, router};

//! The service: HTTP, configuration and the command line around the store and the science.

pub mod cli;
pub mod ingest;
pub mod replay;

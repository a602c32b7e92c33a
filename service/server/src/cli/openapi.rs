//! `feedwright openapi`.

use crate::http::openapi;

/// Prints the description of the API.
pub fn run() -> anyhow::Result<()> {
    super::print(&openapi::json().map_err(anyhow::Error::msg)?)
}

/// Prints the description of the machines' streams as it is checked in.
pub fn run_asyncapi() -> anyhow::Result<()> {
    super::print(&crate::stream::asyncapi::json())
}

//! `feedwright openapi`.

use crate::http::openapi;

/// Prints the description of the API.
pub fn run() -> anyhow::Result<()> {
    super::print(&openapi::json().map_err(anyhow::Error::msg)?)
}

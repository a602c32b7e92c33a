//! `feedwright config`.

use super::{Settings, print};

/// Prints the settings in force.
pub fn run(settings: &Settings) -> anyhow::Result<()> {
    print(&settings.load(Vec::new())?.print())
}

//! `feedwright backup` and `feedwright restore`.

use super::{Settings, log, print};
use crate::clock::Clock;
use crate::config::Engine;
use crate::data_dir::DataDirLock;
use crate::database::server_url;
use anyhow::Context;
use clap::Args;
use feedwright_store::transfer::{
    TableSum, back_up_postgres, back_up_sqlite, restore_to_postgres, restore_to_sqlite,
};
use std::path::PathBuf;

/// Arguments of `backup`.
#[derive(Debug, Args)]
pub struct BackupArguments {
    /// The file to make; it must not be there yet.
    file: PathBuf,
}

/// Arguments of `restore`.
#[derive(Debug, Args)]
pub struct RestoreArguments {
    /// The backup.
    file: PathBuf,
}

/// Backs the configured database up, whether or not a server uses it.
pub async fn back_up(settings: &Settings, arguments: BackupArguments) -> anyhow::Result<()> {
    let config = settings.load(Vec::new())?;
    log(&config.log)?;
    let now = Clock::system().now();
    let report = match config.engine() {
        Engine::Sqlite(path) => back_up_sqlite(&path, &arguments.file, now).await?,
        Engine::Postgres(_) => back_up_postgres(&server_url(&config), &arguments.file, now).await?,
    };
    print(&listed(&report.tables))?;
    print(&format!("{}: {} bytes\n", arguments.file.display(), report.bytes))
}

/// Restores a backup into the configured database, which must be fresh.
pub async fn restore(settings: &Settings, arguments: RestoreArguments) -> anyhow::Result<()> {
    let config = settings.load(Vec::new())?;
    log(&config.log)?;
    let sums = match config.engine() {
        Engine::Sqlite(path) => {
            let _lock = DataDirLock::acquire(&config.data_dir).context("stop the server first")?;
            restore_to_sqlite(&arguments.file, &path).await?
        }
        Engine::Postgres(_) => {
            restore_to_postgres(&arguments.file, &server_url(&config), &std::env::temp_dir()).await?
        }
    };
    print(&listed(&sums))?;
    print("restored, and every sum is that of the backup\n")
}

/// A line per table.
pub(super) fn listed(sums: &[(String, TableSum)]) -> String {
    sums.iter().map(|(table, sum)| format!("{table}: {sum}\n")).collect()
}

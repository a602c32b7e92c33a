//! `feedwright backup` and `feedwright restore`.

use super::{Settings, log, print, scratch, stop};
use crate::clock::Clock;
use crate::config::{Config, Engine};
use crate::data_dir::DataDirLock;
use crate::database::server_url;
use anyhow::Context;
use clap::Args;
use feedwright_core::units::Timestamp;
use feedwright_store::transfer::{
    TableSum, TransferError, back_up_postgres, back_up_sqlite, note_postgres, note_sqlite,
    restore_to_postgres, restore_to_sqlite,
};
use std::path::PathBuf;

/// Arguments of `backup`.
#[derive(Debug, Args)]
pub struct BackupArguments {
    /// The file to make; it must not be there yet.
    #[arg(required_unless_present = "made_elsewhere")]
    file: Option<PathBuf>,
    /// Make no backup: note that another tool (a snapshot, pg_basebackup) has just made one, so that no alert says there
    /// is none.
    #[arg(long, conflicts_with = "file")]
    made_elsewhere: bool,
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
    stop::or_dropped(made(&config, arguments.file)).await
}

async fn made(config: &Config, file: Option<PathBuf>) -> anyhow::Result<()> {
    let now = Clock::system().now();
    let Some(file) = file else {
        note(config, now).await.context("the backup that was made elsewhere is not noted")?;
        return print("noted\n");
    };
    let report = match config.engine() {
        Engine::Sqlite(path) => back_up_sqlite(&path, &file, now).await?,
        Engine::Postgres(_) => back_up_postgres(&server_url(config), &file, now).await?,
    };
    // Before it is told: the backup is made, whoever hears of it. It is whole whatever comes of this: a role that may only read backs
    // up too.
    if let Err(error) = note(config, now).await {
        let error = format!("{:#}", anyhow::Error::from(error));
        tracing::warn!(
            error,
            "the database does not remember this backup, and its alert will say there is none"
        );
    }
    print(&listed(&report.tables))?;
    print(&format!("{}: {} bytes\n", file.display(), report.bytes))
}

/// Tells the database that its state of `made_at` is backed up.
async fn note(config: &Config, made_at: Timestamp) -> Result<(), TransferError> {
    match config.engine() {
        Engine::Sqlite(path) => note_sqlite(&path, made_at).await,
        Engine::Postgres(_) => note_postgres(&server_url(config), made_at).await,
    }
}

/// Restores a backup into the configured database, which must be fresh.
pub async fn restore(settings: &Settings, arguments: RestoreArguments) -> anyhow::Result<()> {
    let config = settings.load(Vec::new())?;
    log(&config.log)?;
    let sums = match config.engine() {
        Engine::Sqlite(path) => {
            let _lock = DataDirLock::acquire(&config.data_dir).context("stop the server first")?;
            stop::or_dropped(async { Ok(restore_to_sqlite(&arguments.file, &path).await?) }).await?
        }
        Engine::Postgres(_) => {
            let (backup, to) = (arguments.file, server_url(&config));
            scratch::within(async |folder| Ok(restore_to_postgres(&backup, &to, &folder).await?)).await?
        }
    };
    print(&listed(&sums))?;
    print("restored, and every sum is that of the backup\n")
}

/// A line per table.
pub(super) fn listed(sums: &[(String, TableSum)]) -> String {
    sums.iter().map(|(table, sum)| format!("{table}: {sum}\n")).collect()
}

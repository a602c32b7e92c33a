//! `feedwright check`: every block, every hash, every summary against its samples, wear against its fold.

use super::{Settings, log, print, scratch};
use crate::config::Engine;
use crate::database::{self, Database};
use anyhow::{Context, bail};
use clap::Args;
use feedwright_store::transfer::restore_to_sqlite;
use feedwright_store::{Repair, SqliteOptions, SqliteStore, Store};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

/// Cycles that are checked in one read.
const PAGE: u32 = 200;

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folds wear again where the cache differs from it, but not over cycles that say something else than was taken in, nor in a
    /// file in whose pages, indexes, cycles, operations, tools or events SQLite finds faults.
    /// Nothing else can be repaired: what is damaged is named.
    #[arg(long)]
    repair: bool,
    /// Checks this backup instead of the configured database, in a copy of it.
    #[arg(long, value_name = "FILE", conflicts_with = "repair")]
    backup: Option<PathBuf>,
}

/// Runs the command: it fails where a fault is left.
pub async fn run(settings: &Settings, arguments: Arguments) -> anyhow::Result<()> {
    let config = settings.load(Vec::new())?;
    log(&config.log)?;
    if let Some(backup) = &arguments.backup {
        return scratch::within(async |folder| of_backup(backup, &folder.join("check.sqlite3")).await).await;
    }
    // Opening makes what is not there: nothing would be found wrong with the wrong folder.
    if let Engine::Sqlite(path) = config.engine()
        && !path.exists()
    {
        bail!("there is no database {}", path.display());
    }
    let Database { store, lock } = database::open(&config).await.with_context(|| match config.engine() {
        Engine::Sqlite(_) => "a server's own SQLite file is checked while it is stopped, or as a backup",
        Engine::Postgres(_) => "the database cannot be checked",
    })?;
    let outcome = check(&store, arguments.repair).await;
    store.close().await;
    drop(lock);
    outcome
}

async fn of_backup(backup: &std::path::Path, at: &std::path::Path) -> anyhow::Result<()> {
    restore_to_sqlite(backup, at).await?;
    let store: Arc<dyn Store> = Arc::new(SqliteStore::open(at, SqliteOptions::default()).await?);
    let outcome = check(&store, false).await;
    store.close().await;
    outcome
}

async fn check(store: &Arc<dyn Store>, repair: bool) -> anyhow::Result<()> {
    let mut faults = 0_u64;
    let mut foldable = true;
    for fault in store.check_tables().await? {
        faults += 1;
        foldable &= !fault.may_mislead_wear();
        print(&format!("fault: {} {}: {}\n", fault.kind, fault.key, fault.detail))?;
    }
    let (mut checked, mut dropped, mut unverified, mut after) = (0, 0, 0, None);
    let mut doubtful = BTreeSet::new();
    loop {
        let page = store.check_cycles(after.as_ref(), PAGE).await?;
        checked += page.checked;
        dropped += page.dropped;
        unverified += page.unverified;
        doubtful.extend(page.doubtful);
        for fault in page.faults {
            faults += 1;
            print(&format!("fault: {} {}: {}\n", fault.kind, fault.key, fault.detail))?;
        }
        match page.next {
            Some(next) => after = Some(next),
            None => break,
        }
    }
    print(&format!("{checked} cycles checked, of {dropped} the samples were dropped by retention\n"))?;
    if unverified > 0 {
        print(&format!(
            "of {unverified} cycles machine, operation, fitted lines or rules have changed, or may have: their energies \
             were not computed again\n"
        ))?;
    }
    let repair = if repair && foldable { Repair::AllBut(&doubtful) } else { Repair::No };
    let wear = store.check_wear(repair).await?;
    for (machine, tool) in &wear.different {
        let done = if repair.folds(tool) {
            "folded again"
        } else if !foldable {
            "the cache is not the fold over what is found, and is not folded again, since the tables are at fault"
        } else if doubtful.contains(tool) {
            "the cache is not the fold over the cycles, and is not folded again, since some of them are at fault"
        } else {
            "the cache is not the fold over the cycles; --repair folds it again"
        };
        faults += u64::from(!repair.folds(tool));
        print(&format!("fault: wear {machine}/{tool}: {done}\n"))?;
    }
    for (tool, what) in &wear.unreadable {
        faults += 1;
        print(&format!("fault: wear {tool}: it cannot be folded: {what}\n"))?;
    }
    print(&format!("{} folds of wear checked, {} differed\n", wear.rows, wear.different.len()))?;
    if faults > 0 {
        bail!("{faults} faults are left");
    }
    Ok(())
}

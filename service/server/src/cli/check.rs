//! `feedwright check`: every block, every hash, every summary against its samples, wear against its fold.

use super::{Settings, log, print, scratch};
use crate::config::Engine;
use crate::database::{self, Database, OpenError};
use anyhow::{Context, bail};
use clap::Args;
use feedwright_store::transfer::restore_to_sqlite;
use feedwright_store::{
    DifferingWear, Doubt, Left, Repair, SqliteOptions, SqliteStore, Store, StoreFault, faults_of_file,
};
use std::path::PathBuf;
use std::sync::Arc;

/// Cycles that are checked in one read.
const PAGE: u32 = 200;

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folds wear again where the cache differs from it, but not over cycles that say something else than was taken in, nor where
    /// cycles that were counted are missing or nothing says whether they are what was taken in, nor in a file in whose pages,
    /// indexes, cycles, operations, tools or events SQLite finds faults that may mislead it.
    /// Nothing else can be repaired: what is damaged is named.
    #[arg(long)]
    repair: bool,
    /// With `--repair`: folds wear also over cycles of which nothing says whether they are what was taken in, by what is stored of
    /// them: their samples were dropped or are damaged, machine, operation or rules were changed since, or nothing but a flag
    /// says whether they were cut short.
    #[arg(long, requires = "repair")]
    unproven: bool,
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
        && !path.try_exists().with_context(|| format!("cannot look for the database {}", path.display()))?
    {
        bail!("there is no database {}", path.display());
    }
    let opened = database::open(&config).await;
    if matches!(opened, Err(OpenError::File { .. })) {
        tell_of_file(&config.engine()).await?;
    }
    let Database { store, lock } = opened.with_context(|| match config.engine() {
        Engine::Sqlite(_) => "a server's own SQLite file is checked while it is stopped, or as a backup",
        Engine::Postgres(_) => "the database cannot be checked",
    })?;
    let asked = Asked { repair: arguments.repair, unproven: arguments.unproven };
    let outcome = check(&store, &config.engine(), asked).await;
    store.close().await;
    drop(lock);
    outcome
}

/// What keeps a file from being gone through, such as a page that cannot be read, SQLite may name.
async fn tell_of_file(engine: &Engine) -> anyhow::Result<()> {
    let Engine::Sqlite(path) = engine else { return Ok(()) };
    for fault in faults_of_file(path).await.unwrap_or_default() {
        tell(&fault)?;
    }
    Ok(())
}

async fn of_backup(backup: &std::path::Path, at: &std::path::Path) -> anyhow::Result<()> {
    restore_to_sqlite(backup, at).await?;
    let store: Arc<dyn Store> = Arc::new(SqliteStore::open(at, SqliteOptions::default()).await?);
    let asked = Asked { repair: false, unproven: false };
    let outcome = check(&store, &Engine::Sqlite(at.to_owned()), asked).await;
    store.close().await;
    outcome
}

fn tell(fault: &StoreFault) -> anyhow::Result<()> {
    print(&format!("fault: {} {}: {}\n", fault.kind, fault.key, fault.detail))
}

/// What of wear is to be folded again.
#[derive(Clone, Copy)]
struct Asked {
    repair: bool,
    unproven: bool,
}

async fn check(store: &Arc<dyn Store>, engine: &Engine, asked: Asked) -> anyhow::Result<()> {
    let mut faults = 0_u64;
    let mut foldable = true;
    let tables = store.check_tables().await;
    if tables.is_err() {
        tell_of_file(engine).await?;
    }
    for fault in tables? {
        faults += 1;
        foldable &= !fault.may_mislead_wear();
        tell(&fault)?;
    }
    let (mut checked, mut dropped, mut unverified, mut after) = (0, 0, 0, None);
    let mut doubt = Doubt::default();
    loop {
        let page = store.check_cycles(after.as_ref(), PAGE).await?;
        checked += page.checked;
        dropped += page.dropped;
        unverified += page.unverified;
        doubt.tools.extend(page.doubt.tools);
        if !asked.unproven {
            doubt.unproven.extend(page.doubt.unproven);
            doubt.cut_short |= page.doubt.cut_short;
        }
        for fault in page.faults {
            faults += 1;
            tell(&fault)?;
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
    let repair = if asked.repair && foldable { Repair::AllBut(&doubt) } else { Repair::No };
    let wear = store.check_wear(repair).await?;
    for DifferingWear { machine, tool, missing, left } in &wear.different {
        if *missing > 0 {
            faults += 1;
            print(&format!("fault: cycles {machine}/{tool}: {missing} that were counted are not there\n"))?;
        }
        faults += u64::from(left.is_some());
        let why = match left {
            None => "folded again",
            Some(Left::Unasked) if asked.repair => {
                "the cache is not the fold over what is found, and is not folded again, since the tables are at fault"
            }
            Some(Left::Unasked) if *missing > 0 => "the cache is not the fold over the cycles that are left",
            Some(Left::Unasked) => "the cache is not the fold over the cycles; --repair folds it again",
            Some(Left::Doubtful) => {
                "the cache is not the fold over the cycles, and is not folded again, since some of them are at fault"
            }
            Some(Left::Missing) => {
                "the cache is not the fold over the cycles that are left, and is not folded again, since it alone \
                 knows of the others"
            }
            Some(Left::Unproven) => {
                "the cache is not the fold over the cycles, and is not folded again, since nothing says of some of them \
                 whether they are what was taken in; --repair --unproven folds it by what is stored of them"
            }
            Some(Left::Another) => {
                "the cache is not the fold over the cycles, and is not folded again, since that of another machine \
                 is not"
            }
        };
        print(&format!("fault: wear {machine}/{tool}: {why}\n"))?;
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

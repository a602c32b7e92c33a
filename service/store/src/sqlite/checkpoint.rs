//! Moves the write-ahead log into the database file, beside the writer and never in its way.

use super::Conn;
use super::open::is_full;
use super::writing::Writing;
use crate::error::StoreError;
use sqlx::Connection;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;
use tokio::sync::{Mutex, Notify};
use tokio::task::JoinHandle;

/// A log this long (128 MiB of the 4 KiB pages of new files, twice as much of the 8 KiB pages of older ones) means that a reader holds an old snapshot, or that the disk is too slow.
const LONG_WAL_PAGES: u64 = 32_768;

/// A log this long (8 MiB, or 16) is begun anew: written over, not made longer, it needs no space of the file system in each
/// commit.
const REUSED_WAL_PAGES: u64 = 2_048;

#[derive(Debug)]
pub(super) struct Checkpoints {
    wal_pages: Arc<AtomicU64>,
    stop: Arc<Notify>,
    task: Mutex<Option<JoinHandle<()>>>,
}

impl Checkpoints {
    pub(super) fn start(conn: Conn, every: Duration, writing: Weak<Writing>) -> Self {
        let wal_pages = Arc::new(AtomicU64::new(0));
        let stop = Arc::new(Notify::new());
        let task = tokio::spawn(run(conn, every, writing, Arc::clone(&wal_pages), Arc::clone(&stop)));
        Self { wal_pages, stop, task: Mutex::new(Some(task)) }
    }

    pub(super) fn wal_pages(&self) -> u64 {
        self.wal_pages.load(Ordering::Relaxed)
    }

    pub(super) async fn stop(&self) {
        self.stop.notify_one();
        if let Some(task) = self.task.lock().await.take()
            && let Err(error) = task.await
        {
            tracing::error!(%error, "the checkpoint task failed");
        }
    }
}

impl Drop for Checkpoints {
    fn drop(&mut self) {
        self.stop.notify_one();
    }
}

async fn run(
    mut conn: Conn,
    every: Duration,
    writing: Weak<Writing>,
    wal_pages: Arc<AtomicU64>,
    stop: Arc<Notify>,
) {
    let mut ticks = tokio::time::interval(every);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut long = false;
    loop {
        // Only the waiting is cancelled here, never a statement.
        tokio::select! {
            () = stop.notified() => break,
            _ = ticks.tick() => {}
        }
        if writing.upgrade().is_some_and(|writing| writing.is_refused().is_err()) {
            break;
        }
        match checkpoint(&mut conn, &writing).await {
            Ok((pages, moved)) => {
                wal_pages.store(pages, Ordering::Relaxed);
                if pages > LONG_WAL_PAGES && !long {
                    tracing::warn!(pages, moved, "the write-ahead log is long");
                }
                long = pages > LONG_WAL_PAGES;
            }
            Err(error) => failed(error, &writing),
        }
    }
    if let Err(error) = conn.close().await {
        tracing::warn!(%error, "checkpoint connection did not close cleanly");
    }
}

/// A checkpoint is not tried again whose disk has failed: SQLite counts pages as moved before they are synced where a commit came
/// meanwhile, the system tells of one that it could not write by the next sync alone, and the one after that would have the log begun
/// anew, which holds that page alone. A full disk has refused a write, which nothing counts on.
fn failed(error: sqlx::Error, writing: &Weak<Writing>) {
    let is_full = is_full(&error);
    let error = StoreError::from(error);
    tracing::warn!(%error, "checkpoint failed");
    if let Some(writing) = writing.upgrade().filter(|_| !is_full) {
        writing.heed(&Err::<(), _>(error));
    }
}

/// Moves what can be moved without anybody waiting. Where that was much, the writer is held up for the few pages that
/// came meanwhile, so that it can begin the log anew. Returns the pages in the log, and how many of them were moved.
async fn checkpoint(conn: &mut Conn, writing: &Weak<Writing>) -> Result<(u64, i64), sqlx::Error> {
    let moved = run_checkpoint(conn, "PRAGMA wal_checkpoint(PASSIVE)").await?;
    let Some(writing) = writing.upgrade().filter(|_| moved.0 >= REUSED_WAL_PAGES) else {
        return Ok(moved);
    };
    // A transaction that groups leave open would be waited for in vain.
    match writing.hold().await {
        Ok(_held) => run_checkpoint(conn, "PRAGMA wal_checkpoint(RESTART)").await,
        Err(_) => Ok(moved),
    }
}

async fn run_checkpoint(conn: &mut Conn, statement: &'static str) -> Result<(u64, i64), sqlx::Error> {
    let (_, pages, moved) = sqlx::query_as::<_, (i64, i64, i64)>(statement).fetch_one(conn).await?;
    Ok((u64::try_from(pages).unwrap_or(0), moved))
}

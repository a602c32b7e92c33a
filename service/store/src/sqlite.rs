//! SQLite: one writer, many readers, a checkpoint of its own. For a cell, with nothing to install.
//!
//! WAL with `synchronous=FULL`, and before it a journal of groups ([`journal`]): an acknowledged cycle survives a power
//! cut. One change is made at a time, with `BEGIN
//! IMMEDIATE`, so that none fails for want of a lock that it could have waited for.

mod block_reader;
mod checkpoint;
mod dialect;
#[path = "engine/mod.rs"]
#[expect(clippy::duplicate_mod, reason = "SQL that both engines understand is compiled for each of them")]
mod engine;
mod files;
mod group_blocks;
mod group_folds;
mod group_thread;
mod group_writer;
mod journal;
mod kept;
#[cfg(test)]
mod lane_tests;
mod open;
#[cfg(test)]
pub(crate) mod plans;
mod readers;
pub(crate) mod recommendation_id;
mod writing;

pub(crate) use dialect::insert_blocks;
pub(crate) use files::{beside, by_name, log_left};
pub(crate) use journal::is_left;
pub(crate) use kept::{Cell, Form, is_kept_for_another};
pub use open::SqliteOptions;
pub(crate) use open::{APPLIED, HAS_MIGRATIONS, IS_UNFINISHED, MIGRATIONS};

use crate::error::{StoreError, StoreResult};
use crate::gate::{Gate, panicked};
use crate::lanes::{Ended, Lane, Lanes};
use crate::locks::Locks;
use crate::recent::Recent;
use crate::record::{DatabaseUsage, StoreFault};
use crate::registry::Registry;
use crate::rows::number;
use crate::slot::Slot;
use crate::work::{Work, Written};
use block_reader::BlockReader;
use checkpoint::Checkpoints;
use feedwright_core::ids::{CycleId, MachineId};
use feedwright_core::units::Timestamp;
use readers::{Lent, Readers};
use sqlx::Connection;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;
use tokio::sync::{Notify, oneshot};
use writing::{Writer, Writing};

type Db = sqlx::Sqlite;
type Conn = sqlx::SqliteConnection;
type Engine = SqliteStore;

/// Commits what a process has left acknowledged beside a database, or waits for whoever is at work.
pub(crate) async fn take_up(path: &Path) -> StoreResult<()> {
    let path = path.to_owned();
    let task = tokio::task::spawn_blocking(move || journal::take_up_closed(&path));
    task.await.map_err(panicked)?
}

/// What SQLite finds wrong with a file that does not open as a store.
pub async fn faults_of_file(path: &Path) -> StoreResult<Vec<StoreFault>> {
    dialect::of_file(path).await
}

/// Free pages (8 MiB, of older files' pages 16) that are left to be used again.
const PAGES_KEPT_FREE: i64 = 2048;

/// The store in one SQLite file. Clones share it.
#[derive(Debug, Clone)]
pub struct SqliteStore {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    writing: Arc<Writing>,
    readers: Arc<Readers>,
    lanes: Lanes,
    block_reader: BlockReader,
    gate: Gate,
    checkpoints: Checkpoints,
    registry: Arc<Registry>,
    memory: Slot<engine::Memory>,
    /// Of which machine samples were dropped last, where a run is at it.
    dropping: Slot<String>,
    /// Told when a fold is left to the background.
    postponed: Arc<Notify>,
    changes_of_alarms: AtomicU64,
    recent: Arc<Recent>,
    alone: bool,
}

impl SqliteStore {
    /// Pages of the write-ahead log at the last checkpoint: what a watchdog looks at.
    pub fn wal_pages(&self) -> u64 {
        self.inner.checkpoints.wal_pages()
    }

    fn registry(&self) -> &Arc<Registry> {
        &self.inner.registry
    }

    fn memory(&self) -> &Slot<engine::Memory> {
        &self.inner.memory
    }

    fn dropping(&self) -> &Slot<String> {
        &self.inner.dropping
    }

    fn postponed(&self) -> &Arc<Notify> {
        &self.inner.postponed
    }

    fn changes_of_alarms(&self) -> &AtomicU64 {
        &self.inner.changes_of_alarms
    }

    /// What is kept of tools that were asked for: one snapshot tells what is counted and what is stored.
    fn recent(&self) -> Option<&Arc<Recent>> {
        Some(&self.inner.recent)
    }

    fn is_alone(&self) -> bool {
        self.inner.alone
    }

    /// The time that whoever writes to the database agrees on: that of the only server.
    #[expect(clippy::unused_async, reason = "the other engine asks its server")]
    async fn common_time(&self, _conn: &mut Conn, now: Timestamp) -> StoreResult<Timestamp> {
        Ok(now)
    }

    /// A file is there, however slow it is.
    #[expect(clippy::unused_async, reason = "the other engine asks its server")]
    async fn is_away(&self, _error: &StoreError) -> bool {
        false
    }

    /// As [`Self::is_away`].
    #[expect(clippy::unused_self, reason = "the other engine waits for its server")]
    const fn is_too_slow(&self, _took: Duration) -> bool {
        false
    }

    /// As [`Self::has_room`].
    #[expect(clippy::unused_self, reason = "the other engine waits for its server")]
    const fn heed_group(&self, _outcome: Result<(), &StoreError>) {}

    /// A full disk ends the store.
    #[expect(clippy::unused_self, reason = "the other engine waits for its server")]
    const fn has_room(&self) -> StoreResult<()> {
        Ok(())
    }

    /// A file is at everything that it is asked for.
    async fn in_time<T>(&self, asked: impl Future<Output = StoreResult<T>>) -> StoreResult<T> {
        asked.await
    }

    /// As [`Self::is_away`].
    #[expect(clippy::unused_async, reason = "the other engine asks its server")]
    async fn word(&self) -> StoreResult<()> {
        Ok(())
    }

    async fn measure(&self) -> StoreResult<DatabaseUsage> {
        let mut reader = self.reader(Lane::Short).await?;
        let pages: i64 = sqlx::query_scalar("PRAGMA page_count").fetch_one(&mut *reader).await?;
        let page_bytes: i64 = sqlx::query_scalar("PRAGMA page_size").fetch_one(&mut *reader).await?;
        reader.settle();
        let page_bytes: u64 = number("page_size", page_bytes)?;
        let (open, idle, most) = self.inner.readers.counts();
        Ok(DatabaseUsage {
            bytes: number::<u64>("page_count", pages)?.saturating_mul(page_bytes),
            wal_bytes: Some(self.wal_pages().saturating_mul(page_bytes)),
            connections_in_use: open.saturating_sub(idle),
            connections_idle: idle,
            connections_max: most,
        })
    }

    /// Nobody else serves this file.
    #[expect(clippy::unused_async, reason = "the other engine's waits for its server")]
    async fn tell(&self, _text: &str) -> StoreResult<()> {
        Ok(())
    }

    fn ears(&self) -> Option<Arc<dyn crate::notice::Notices>> {
        None
    }

    /// The block of a cycle's samples, where this thread may read it.
    fn block_at_once(&self, machine: &MachineId, id: &CycleId) -> Option<StoreResult<Option<Vec<u8>>>> {
        if self.inner.writing.is_ahead() {
            return None;
        }
        self.inner.block_reader.read(machine, id)
    }

    /// A connection that reads what groups do not write: tokens and sessions.
    async fn reader_of_others(&self, lane: Lane) -> StoreResult<Lent> {
        let turn = self.inner.lanes.turn(lane).await?;
        self.inner.readers.lend(turn).await
    }

    /// A connection that reads all that was acknowledged before.
    async fn reader(&self, lane: Lane) -> StoreResult<Lent> {
        let turn = self.inner.lanes.turn(lane).await?;
        self.inner.writing.catch_up().await?;
        self.inner.readers.lend(turn).await
    }

    /// The same: a row that is not wanted any more costs nothing here, so that what comes in an index's order is read in it.
    async fn reader_in_order(&self, lane: Lane) -> StoreResult<Lent> {
        self.reader(lane).await
    }

    /// Gives pages that deletions freed back to the file system, a few at a time and between commits; some stay for
    /// what comes next. Says whether there are more.
    async fn give_back(&self) -> StoreResult<bool> {
        let pass = self.inner.gate.enter().await?;
        let writing = Arc::clone(&self.inner.writing);
        let task = tokio::spawn(async move {
            let outcome = writing.give_back(PAGES_KEPT_FREE).await;
            drop(pass);
            outcome
        });
        task.await.map_err(panicked)?
    }

    /// Runs one change in one transaction, in a task that nobody can cancel.
    async fn write<T, F>(&self, work: F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Conn) -> Work<'c, T> + Send + 'static,
    {
        let pass = self.inner.gate.enter().await?;
        let writing = Arc::clone(&self.inner.writing);
        let task = tokio::spawn(async move {
            let outcome = writing.transaction(work).await;
            drop(pass);
            outcome
        });
        task.await.map_err(panicked)?
    }

    /// Runs a group of cycles, which begins its transaction by its own statements, on the thread of the groups in a task
    /// that nobody can cancel. The one writer holds the database: there is nobody to be locked out.
    async fn write_group<T, F>(&self, _locks: impl FnOnce() -> Locks, work: F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Writer) -> Work<'c, (T, Written)> + Send + 'static,
    {
        let pass = self.inner.gate.enter().await?;
        self.inner.writing.write_group(pass, work).await
    }

    /// Runs reads in one snapshot, in a task of its own that ends its transaction: also where nobody waits for the answer any more, or
    /// the store is closed, which it finds out between two statements or rows.
    async fn snapshot<T, F>(&self, lane: Lane, work: F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Conn) -> Work<'c, T> + Send + 'static,
    {
        let mut conn = self.reader(lane).await?;
        let (waits, gone) = oneshot::channel::<()>();
        let ended = self.inner.lanes.ended();
        let task = tokio::spawn(async move {
            let mut transaction = conn.begin().await?;
            let outcome = tokio::select! {
                biased;
                outcome = work(&mut transaction) => outcome,
                _ = gone => Err(Ended.into()),
                () = ended => Err(Ended.into()),
            };
            let ended = transaction.rollback().await;
            match &ended {
                Ok(()) => conn.settle(),
                Err(_) => conn.discard(),
            }
            // After an error of the disk SQLite has ended it by itself; that error is the one to tell.
            let value = outcome?;
            ended?;
            Ok(value)
        });
        let outcome = task.await.map_err(panicked)?;
        drop(waits);
        outcome
    }

    /// Runs reads on the connection that writes: one that only reads leaves a table's constraints out of its schema, and finds
    /// nothing that breaks them.
    async fn held_to_constraints<T, F>(&self, work: F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Conn) -> Work<'c, T> + Send + 'static,
    {
        self.write(work).await
    }

    async fn shut(&self) {
        self.inner.gate.shut().await;
        self.inner.checkpoints.stop().await;
        self.inner.block_reader.close();
        self.inner.lanes.end();
        self.inner.readers.close().await;
        self.inner.writing.close().await;
    }
}

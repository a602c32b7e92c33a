//! SQLite: one writer, many readers, a checkpoint of its own. For a cell, with nothing to install.
//!
//! WAL with `synchronous=FULL`: an acknowledged cycle survives a power cut. One change is made at a time, with `BEGIN
//! IMMEDIATE`, so that none fails for want of a lock that it could have waited for.

mod block_reader;
mod checkpoint;
mod dialect;
#[path = "engine/mod.rs"]
#[expect(clippy::duplicate_mod, reason = "SQL that both engines understand is compiled for each of them")]
mod engine;
mod files;
mod group_thread;
mod group_writer;
mod open;
mod readers;

pub(crate) use open::MIGRATIONS;
pub use open::SqliteOptions;

use crate::error::{StoreError, StoreResult};
use crate::gate::{Gate, panicked};
use crate::recent::Recent;
use crate::record::DatabaseUsage;
use crate::registry::Registry;
use crate::rows::number;
use crate::slot::Slot;
use crate::work::{Work, Written};
use block_reader::BlockReader;
use checkpoint::Checkpoints;
use feedwright_core::ids::{CycleId, MachineId};
use files::Files;
use group_thread::GroupThread;
use group_writer::GroupWriter;
use readers::{Lent, Readers};
use sqlx::Connection;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use tokio::sync::{Mutex, MutexGuard};

type Db = sqlx::Sqlite;
type Conn = sqlx::SqliteConnection;
type Engine = SqliteStore;

/// What writes: one at a time, so that neither of the two connections waits for a lock that the other holds at work.
#[derive(Debug)]
struct Writer {
    /// Writes whole groups, which is most of what is written.
    groups: GroupWriter,
    /// Asks what groups rest on, and writes everything else.
    asked: Conn,
}

/// Free pages (8 MiB) that are left to be used again.
const PAGES_KEPT_FREE: i64 = 1024;

/// The store in one SQLite file. Clones share it.
#[derive(Debug, Clone)]
pub struct SqliteStore {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    /// `None` once closed.
    writer: Mutex<Option<Writer>>,
    files: Files,
    group_thread: GroupThread,
    /// A group's statements begin and end its transaction: set while one may be open.
    in_group: AtomicBool,
    readers: Arc<Readers>,
    block_reader: BlockReader,
    gate: Gate,
    /// Why the disk refused a write, once it did: an fsync is never retried, whatever comes later.
    refused: OnceLock<String>,
    checkpoints: Checkpoints,
    max_samples: usize,
    registry: Arc<Registry>,
    memory: Slot<engine::Memory>,
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

    /// What is kept of tools that were asked for: one snapshot tells what is counted and what is stored.
    fn recent(&self) -> Option<&Arc<Recent>> {
        Some(&self.inner.recent)
    }

    fn is_alone(&self) -> bool {
        self.inner.alone
    }

    /// A file is there, however slow it is.
    #[expect(clippy::unused_async, reason = "the other engine asks its server")]
    async fn is_away(&self, _error: &StoreError) -> bool {
        false
    }

    /// As [`Self::is_away`].
    #[expect(clippy::unused_async, reason = "the other engine asks its server")]
    async fn word(&self) -> StoreResult<()> {
        Ok(())
    }

    async fn measure(&self) -> StoreResult<DatabaseUsage> {
        let mut reader = self.reader().await?;
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

    fn max_samples(&self) -> usize {
        self.inner.max_samples
    }

    /// What a statement finds, a block, for a cycle's machine and id, where this thread may read it.
    fn block_at_once(
        &self,
        statement: &str,
        machine: &MachineId,
        id: &CycleId,
    ) -> Option<StoreResult<Option<Vec<u8>>>> {
        self.inner.block_reader.read(statement, machine, id)
    }

    async fn reader(&self) -> StoreResult<Lent> {
        Ok(self.inner.readers.lend().await?)
    }

    /// Gives pages that deletions freed back to the file system, a few at a time and between commits; some stay for
    /// what comes next. Says whether there are more.
    async fn give_back(&self) -> StoreResult<bool> {
        let pass = self.inner.gate.enter().await?;
        let inner = Arc::clone(&self.inner);
        let task = tokio::spawn(async move {
            let mut writer = inner.writer().await?;
            let conn = &mut inner.settled(writer.as_mut()).await?.asked;
            let free: i64 = sqlx::query_scalar("PRAGMA freelist_count").fetch_one(&mut *conn).await?;
            if free <= PAGES_KEPT_FREE {
                return Ok(false);
            }
            sqlx::query("PRAGMA incremental_vacuum(64)").fetch_all(&mut *conn).await?;
            let left: i64 = sqlx::query_scalar("PRAGMA freelist_count").fetch_one(&mut *conn).await?;
            drop(writer);
            drop(pass);
            // A file that was made without incremental vacuum keeps its pages: they are used again.
            Ok(left < free && left > PAGES_KEPT_FREE)
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
        let inner = Arc::clone(&self.inner);
        let task = tokio::spawn(async move {
            let outcome = inner.transaction(work).await;
            drop(pass);
            outcome
        });
        task.await.map_err(panicked)?
    }

    /// Runs a group of cycles, which begins and ends its transaction by its own statements, on the thread of the groups in
    /// a task that nobody can cancel.
    async fn write_group<T, F>(&self, work: F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Writer) -> Work<'c, (T, Written)> + Send + 'static,
    {
        let pass = self.inner.gate.enter().await?;
        let inner = Arc::clone(&self.inner);
        let task = self.inner.group_thread.spawn(async move {
            let outcome = inner.group(work).await;
            drop(pass);
            outcome
        });
        match task.await {
            Ok(outcome) => outcome,
            Err(error) => {
                let mut writer = self.inner.writer().await?;
                self.inner.settled(writer.as_mut()).await?;
                Err(panicked(error))
            }
        }
    }

    /// Runs reads in one snapshot, in a task that nobody can cancel half-way through its transaction.
    async fn snapshot<T, F>(&self, work: F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Conn) -> Work<'c, T> + Send + 'static,
    {
        let mut conn = self.reader().await?;
        let task = tokio::spawn(async move {
            let mut transaction = conn.begin().await?;
            let outcome = work(&mut transaction).await;
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
        task.await.map_err(panicked)?
    }

    async fn shut(&self) {
        self.inner.gate.shut().await;
        self.inner.checkpoints.stop().await;
        self.inner.block_reader.close();
        self.inner.readers.close().await;
        // Closing the last connection folds the log into the file.
        if let Some(writer) = self.inner.writer.lock().await.take()
            && let Err(error) = writer.close().await
        {
            tracing::warn!(%error, "sqlite did not close cleanly");
        }
    }
}

impl Writer {
    async fn close(self) -> StoreResult<()> {
        // The last one folds the log into the file, whatever became of the first.
        let closed = self.groups.close();
        self.asked.close().await?;
        closed
    }
}

impl Inner {
    async fn transaction<T, F>(&self, work: F) -> StoreResult<T>
    where
        F: for<'c> FnOnce(&'c mut Conn) -> Work<'c, T> + Send + 'static,
    {
        let mut writer = self.writer().await?;
        let conn = &mut self.settled(writer.as_mut()).await?.asked;
        let outcome =
            Self::attempt(conn, work).await.and_then(|value| self.files.are_there().map(|()| value));
        self.heed(&outcome);
        outcome
    }

    async fn attempt<T, F>(conn: &mut Conn, work: F) -> StoreResult<T>
    where
        F: for<'c> FnOnce(&'c mut Conn) -> Work<'c, T> + Send + 'static,
    {
        let mut transaction = conn.begin_with("BEGIN IMMEDIATE").await?;
        match work(&mut transaction).await {
            Ok(value) => {
                transaction.commit().await?;
                Ok(value)
            }
            Err(error) => {
                // After an error of the disk SQLite has rolled it back by itself; that error is the one to tell.
                if let Err(rollback) = transaction.rollback().await {
                    tracing::debug!(error = %rollback, "nothing to roll back");
                }
                Err(error)
            }
        }
    }

    /// A group that is not written as a whole begins its transaction with its first statement and ends it with its last:
    /// each statement is a hop to the connection's thread.
    async fn group<T, F>(&self, work: F) -> StoreResult<T>
    where
        F: for<'c> FnOnce(&'c mut Writer) -> Work<'c, (T, Written)> + Send + 'static,
    {
        let mut guard = self.writer().await?;
        let writer = self.settled(guard.as_mut()).await?;
        self.in_group.store(true, Ordering::Relaxed);
        let outcome = match work(writer).await {
            Ok((value, Written { .. })) => {
                self.in_group.store(false, Ordering::Relaxed);
                self.files.are_there().map(|()| value)
            }
            Err(error) => {
                self.settled(Some(writer)).await?;
                Err(error)
            }
        };
        self.heed(&outcome);
        outcome
    }

    async fn writer(&self) -> StoreResult<MutexGuard<'_, Option<Writer>>> {
        let writer = self.writer.lock().await;
        if let Some(why) = self.refused.get() {
            return Err(StoreError::NotWritable(why.clone().into()));
        }
        Ok(writer)
    }

    /// The writer with no transaction open: what a group that failed, or panicked, has left is rolled back.
    async fn settled<'c>(&self, writer: Option<&'c mut Writer>) -> StoreResult<&'c mut Writer> {
        let writer = writer.ok_or_else(|| StoreError::Unavailable("the store is closed".into()))?;
        if self.in_group.load(Ordering::Relaxed) {
            // Where it never began, or SQLite has rolled it back by itself, there is nothing to roll back.
            if let Err(error) = sqlx::query("ROLLBACK").execute(&mut writer.asked).await {
                tracing::debug!(%error, "nothing to roll back");
            }
            self.in_group.store(false, Ordering::Relaxed);
        }
        Ok(writer)
    }

    fn heed<T>(&self, outcome: &StoreResult<T>) {
        if let Err(StoreError::NotWritable(error)) = outcome {
            tracing::error!(%error, "sqlite refuses writes, nothing is acknowledged any more");
            // The first reason stays.
            let _ = self.refused.set(error.to_string());
        }
    }
}

//! What writes: one change at a time, and the transaction that groups leave open for each other.
//!
//! A group is acknowledged when it is in the journal; the transaction that it was run in is committed some groups later
//! ([`super::journal`]). Whoever reads, or changes anything else, has it committed first, so that everybody sees what was
//! acknowledged before.

use super::Conn;
use super::files::Files;
use super::group_thread::GroupThread;
use super::group_writer::GroupWriter;
use crate::error::{StoreError, StoreResult};
use crate::gate::{Pass, panicked};
use crate::work::{Work, Written};
use sqlx::Connection;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::sync::{Mutex, Notify, OwnedMutexGuard};

/// A commit that failed is tried again so much later, unless somebody asks for it before.
const COMMIT_AGAIN: Duration = Duration::from_secs(1);

/// Two connections, of which neither waits for a lock that the other holds at work.
#[derive(Debug)]
pub(super) struct Writer {
    /// Writes whole groups, which is most of what is written.
    pub(super) groups: GroupWriter,
    /// Asks what groups rest on, and writes everything else.
    asked: Conn,
}

/// The writer, with what its changes rest on.
#[derive(Debug)]
pub(super) struct Writing {
    /// `None` once closed.
    writer: Arc<Mutex<Option<Writer>>>,
    files: Files,
    group_thread: GroupThread,
    /// A group's statements begin and end its transaction on the connection that is asked: set while one may be open.
    in_group: AtomicBool,
    /// Whether groups are acknowledged that are not committed.
    ahead: Arc<AtomicBool>,
    /// Whether a task waits to commit them, and how long after the first of them it does.
    awaited: AtomicBool,
    commit_after: Duration,
    /// Wakes that task before its time.
    full: Arc<Notify>,
    /// Wakes who waits for a commit that somebody else has made.
    caught_up: Notify,
    /// Why the disk refused a write, once it did: an fsync is never retried, whatever comes later.
    refused: OnceLock<String>,
}

/// The writer of a store, held by who writes.
pub(super) type Held = OwnedMutexGuard<Option<Writer>>;

/// The writer, unless the store is closed.
pub(super) fn open(held: &mut Held) -> StoreResult<&mut Writer> {
    held.as_mut().ok_or_else(|| StoreError::Unavailable("the store is closed".into()))
}

impl Writer {
    pub(super) const fn of(groups: GroupWriter, asked: Conn) -> Self {
        Self { groups, asked }
    }

    /// The connection that a group asks with. What groups before it have left open is committed: this one may not be
    /// written on the thread of the groups alone.
    pub(super) fn asked_for_group(&mut self) -> StoreResult<&mut Conn> {
        self.groups.commit()?;
        Ok(&mut self.asked)
    }

    /// The connection that everything else is written with, where nothing is left open.
    pub(super) const fn asked(&mut self) -> &mut Conn {
        &mut self.asked
    }

    async fn close(self, may_commit: bool) -> StoreResult<()> {
        // The last one folds the log into the file, whatever became of the first.
        let closed = if may_commit { self.groups.close() } else { self.groups.abandon() };
        self.asked.close().await?;
        closed
    }
}

impl Writing {
    pub(super) fn of(writer: Writer, files: Files, commit_after: Duration) -> StoreResult<Arc<Self>> {
        let ahead = writer.groups.ahead();
        Ok(Arc::new(Self {
            writer: Arc::new(Mutex::new(Some(writer))),
            files,
            group_thread: GroupThread::start()?,
            in_group: AtomicBool::new(false),
            ahead,
            awaited: AtomicBool::new(false),
            commit_after,
            full: Arc::default(),
            caught_up: Notify::new(),
            refused: OnceLock::new(),
        }))
    }

    /// Whether groups are acknowledged that who reads the database does not see.
    pub(super) fn is_ahead(&self) -> bool {
        self.ahead.load(Ordering::Acquire)
    }

    /// Commits what is acknowledged, so that it is seen.
    pub(super) async fn catch_up(self: &Arc<Self>) -> StoreResult<()> {
        if !self.is_ahead() {
            return Ok(());
        }
        let writing = Arc::clone(self);
        let task = self.group_thread.spawn(async move {
            // Whoever changes something else, which may take long, commits before that.
            let caught_up = writing.caught_up.notified();
            if !writing.is_ahead() {
                return Ok(());
            }
            tokio::select! {
                outcome = writing.catch_up_here() => outcome,
                () = caught_up => Ok(()),
            }
        });
        task.await.map_err(panicked)?
    }

    /// The writer, with nothing left open, by whichever connection.
    pub(super) async fn hold(self: &Arc<Self>) -> StoreResult<Held> {
        let mut held = self.lock().await?;
        if !open(&mut held)?.groups.is_open() {
            return Ok(held);
        }
        // The thread that waits for the disk.
        let writing = Arc::clone(self);
        let task = self
            .group_thread
            .spawn(async move { open(&mut held).and_then(|writer| writing.commit(writer)).map(|()| held) });
        task.await.map_err(panicked)?
    }

    /// Runs one change in one transaction. Called in a task that nobody cancels.
    pub(super) async fn transaction<T, F>(self: &Arc<Self>, work: F) -> StoreResult<T>
    where
        F: for<'c> FnOnce(&'c mut Conn) -> Work<'c, T> + Send + 'static,
    {
        let mut held = self.hold().await?;
        let conn = open(&mut held)?.asked();
        let outcome = attempt(conn, work).await.and_then(|value| self.files.are_there().map(|()| value));
        self.heed(&outcome);
        outcome
    }

    /// Gives some of the pages that nothing stands in back to the file system, where there are more than so many; says whether
    /// there are more yet. A file that was made without incremental vacuum keeps them: they are used again.
    pub(super) async fn give_back(self: &Arc<Self>, kept: i64) -> StoreResult<bool> {
        const FREE: &str = "PRAGMA freelist_count";
        let mut held = self.hold().await?;
        let conn = open(&mut held)?.asked();
        let vacuumed = async {
            let free: i64 = sqlx::query_scalar(FREE).fetch_one(&mut *conn).await?;
            if free <= kept {
                return Ok(false);
            }
            sqlx::query("PRAGMA incremental_vacuum(64)").fetch_all(&mut *conn).await?;
            let left: i64 = sqlx::query_scalar(FREE).fetch_one(&mut *conn).await?;
            Ok(left < free && left > kept)
        };
        let outcome = vacuumed.await.and_then(|more| self.files.are_there().map(|()| more));
        // What the disk refuses here it has refused.
        self.heed(&outcome);
        outcome
    }

    /// Runs a group on the thread of the groups, in a task that nobody can cancel.
    pub(super) async fn write_group<T, F>(self: &Arc<Self>, pass: Pass, work: F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Writer) -> Work<'c, (T, Written)> + Send + 'static,
    {
        let writing = Arc::clone(self);
        let task = self.group_thread.spawn(async move {
            let outcome = writing.group(work).await;
            drop(pass);
            outcome
        });
        match task.await {
            Ok(outcome) => outcome,
            Err(error) => {
                // What it has left open is rolled back.
                drop(self.hold().await?);
                Err(panicked(error))
            }
        }
    }

    /// A group that is not written as a whole begins its transaction with its first statement and ends it with its last:
    /// each statement is a hop to the connection's thread.
    async fn group<T, F>(self: &Arc<Self>, work: F) -> StoreResult<T>
    where
        F: for<'c> FnOnce(&'c mut Writer) -> Work<'c, (T, Written)> + Send + 'static,
    {
        let mut held = self.lock().await?;
        let writer = open(&mut held)?;
        self.in_group.store(true, Ordering::Relaxed);
        let outcome = match work(writer).await {
            Ok((value, Written { .. })) => {
                self.in_group.store(false, Ordering::Relaxed);
                self.files.are_there().map(|()| value)
            }
            Err(error) => {
                self.roll_back(writer).await;
                Err(error)
            }
        };
        if writer.groups.is_ahead() {
            self.commit_later();
        } else {
            self.caught_up.notify_waiters();
        }
        if writer.groups.is_full() {
            self.full.notify_one();
        }
        self.heed(&outcome);
        outcome
    }

    /// Commits what is acknowledged by then, a while later or when the transaction is full.
    fn commit_later(self: &Arc<Self>) {
        if self.awaited.swap(true, Ordering::Relaxed) {
            return;
        }
        // A store that is gone by then leaves it to the journal.
        let (writing, full) = (Arc::downgrade(self), Arc::clone(&self.full));
        let mut pause = self.commit_after;
        self.group_thread.spawn(async move {
            loop {
                // Whichever comes first.
                let _ = tokio::time::timeout(pause, full.notified()).await;
                let Some(writing) = writing.upgrade() else { return };
                // A group that comes from here on has a task of its own.
                writing.awaited.store(false, Ordering::Relaxed);
                let Err(error) = writing.catch_up_here().await else { return };
                tracing::error!(%error, "acknowledged cycles are in the groups' journal and cannot be committed");
                if writing.awaited.swap(true, Ordering::Relaxed) {
                    return;
                }
                pause = COMMIT_AGAIN;
            }
        });
    }

    /// As [`Writing::catch_up`], on the thread of the groups.
    async fn catch_up_here(&self) -> StoreResult<()> {
        let mut held = Arc::clone(&self.writer).lock_owned().await;
        held.as_mut().map_or(Ok(()), |writer| self.commit(writer))
    }

    /// As long as nothing was refused: what is in the journal is for whoever opens the database next then.
    fn commit(&self, writer: &mut Writer) -> StoreResult<()> {
        self.is_refused()?;
        // A log that somebody removed is written for nobody.
        let outcome = self.files.are_there().and_then(|()| writer.groups.commit());
        let outcome = outcome.and_then(|()| self.files.are_there());
        if !writer.groups.is_ahead() {
            self.caught_up.notify_waiters();
        }
        self.heed(&outcome);
        outcome
    }

    /// Fails where the disk has refused a write.
    pub(super) fn is_refused(&self) -> StoreResult<()> {
        self.refused.get().map_or(Ok(()), |why| Err(StoreError::NotWritable(why.clone().into())))
    }

    /// The writer with nothing left open by the connection that is asked.
    async fn lock(&self) -> StoreResult<Held> {
        let mut held = Arc::clone(&self.writer).lock_owned().await;
        self.is_refused()?;
        self.roll_back(open(&mut held)?).await;
        Ok(held)
    }

    /// Rolls back what a group that failed, or panicked, has left.
    async fn roll_back(&self, writer: &mut Writer) {
        if self.in_group.load(Ordering::Relaxed) {
            // Where it never began, or SQLite has rolled it back by itself, there is nothing to roll back.
            if let Err(error) = sqlx::query("ROLLBACK").execute(&mut writer.asked).await {
                tracing::debug!(%error, "nothing to roll back");
            }
            self.in_group.store(false, Ordering::Relaxed);
        }
    }

    pub(super) fn heed<T>(&self, outcome: &StoreResult<T>) {
        if let Err(error) = outcome
            && let Some(cause) = error.of_the_disk()
        {
            tracing::error!(error = %cause, "{error}, nothing is acknowledged any more");
            // The first reason stays.
            let _ = self.refused.set(cause.to_string());
        }
    }

    /// Commits and closes. Closing the last connection folds the log into the file, but for where a write was refused: what is missing of
    /// the file may be in the log alone then, and whoever opens it next, where nobody else has it open, moves all of that again.
    pub(super) async fn close(&self) {
        let Some(writer) = self.writer.lock().await.take() else { return };
        if self.is_refused().is_err() {
            // As long as it is open no other connection is the last one. The process ends.
            Box::leak(Box::new(writer));
            return;
        }
        let may_commit = self.files.are_there().is_ok();
        if let Err(error) = writer.close(may_commit).await {
            tracing::warn!(%error, "sqlite did not close cleanly");
        }
    }
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

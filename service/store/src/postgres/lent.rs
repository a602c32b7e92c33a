//! A connection of the pool that is lent.

use super::{Conn, Db, open};
use crate::lanes::Turn;
use sqlx::pool::PoolConnection;
use sqlx::{AssertSqlSafe, Executor, PgPool, Row};
use std::ops::{Deref, DerefMut};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::time::timeout;

/// A connection of the pool. sqlx 0.9.0 asks the server before it takes one back, however long that says nothing: here it is
/// given up then, so that a host that vanishes takes none of the pool's places with it.
#[derive(Debug)]
pub(super) struct Lent {
    /// There until it is given back or lost.
    conn: Option<PoolConnection<Db>>,
    /// The server's process that had its last change.
    process: Option<i32>,
    /// Whether a transaction was begun on it and is not committed: it is rolled back when it is given back.
    begun: bool,
    /// How long the server may take for taking it back.
    patience: Duration,
    /// How many are lent.
    _lending: Lending,
    /// Its turn, where it is lent to a read.
    turn: Turn,
}

/// Counts what is lent, until it is dropped.
#[derive(Debug)]
struct Lending(Arc<AtomicUsize>);

impl Lending {
    fn begin(count: &Arc<AtomicUsize>) -> Self {
        count.fetch_add(1, Ordering::Relaxed);
        Self(Arc::clone(count))
    }
}

impl Drop for Lending {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Lent {
    pub(super) async fn of(
        pool: &PgPool,
        patience: Duration,
        count: &Arc<AtomicUsize>,
    ) -> Result<Self, sqlx::Error> {
        let conn = Some(pool.acquire().await?);
        Ok(Self {
            conn,
            process: None,
            begun: false,
            patience,
            _lending: Lending::begin(count),
            turn: Turn::default(),
        })
    }

    /// Says that it is lent to a read, whose turn ends when it is given back.
    pub(super) fn has_turn(&mut self, turn: Turn) {
        self.turn = turn;
    }

    /// Begins what is rolled back when it is given back.
    pub(super) async fn begin_reading(&mut self, statement: &'static str) -> Result<(), sqlx::Error> {
        self.begun = true;
        self.execute(sqlx::raw_sql(statement)).await?;
        Ok(())
    }

    /// Begins a change by one message, as each of several is waited for, whose last statement is [`open::GOOD`]; `false` where the
    /// server is not good for changes.
    ///
    /// sqlx 0.9.0 has a transaction of its own for that, which drops what the message answers, and is content with a commit that
    /// the server makes a rollback, as of a transaction in which a statement has failed.
    pub(super) async fn begin_change(&mut self, message: String) -> Result<bool, sqlx::Error> {
        self.begun = true;
        // Text of this crate's, and numbers.
        let answers = sqlx::raw_sql(AssertSqlSafe(message)).fetch_all(&mut **self).await?;
        let last = answers.last().ok_or(sqlx::Error::RowNotFound)?;
        self.process = last.try_get("process")?;
        open::is_good(last)
    }

    /// The server's process that had its last change; the one that has it, where no pooler chooses.
    pub(super) const fn process(&self) -> Option<i32> {
        self.process
    }

    /// Commits what was begun by [`Lent::begin_change`]. In a transaction that failed the first statement of the message fails
    /// too, where the server would answer the second one by rolling back, and call that done.
    pub(super) async fn commit(&mut self) -> Result<(), sqlx::Error> {
        self.execute(sqlx::raw_sql("SELECT; COMMIT")).await?;
        self.begun = false;
        Ok(())
    }

    /// Takes back what was begun.
    pub(super) async fn roll_back(&mut self) -> Result<(), sqlx::Error> {
        self.execute(sqlx::raw_sql("ROLLBACK")).await?;
        self.begun = false;
        Ok(())
    }

    /// Gives it back: this engine's pool asks its server all the same, which may be gone.
    pub(super) fn settle(self) {
        drop(self);
    }

    /// Closes it without a word to its server: what is under way on it goes on there, or is nowhere.
    pub(super) fn lose(mut self) {
        drop(self.conn.take().map(PoolConnection::detach));
    }
}

impl Drop for Lent {
    fn drop(&mut self) {
        let Some(mut conn) = self.conn.take() else { return };
        let (begun, patience, turn) = (self.begun, self.patience, std::mem::take(&mut self.turn));
        // One that a store kept, which ends behind everything else.
        let Ok(runtime) = Handle::try_current() else {
            drop(conn.detach());
            return;
        };
        runtime.spawn(async move {
            let _until_it_is_back = turn;
            if begun && !matches!(timeout(patience, conn.execute("ROLLBACK")).await, Ok(Ok(_))) {
                drop(conn.detach());
                return;
            }
            // What is dropped before it has ended closes the connection and leaves its place.
            if timeout(patience, conn.return_to_pool()).await.is_err() {
                tracing::warn!("a connection is closed: its server did not answer when it was given back");
            }
        });
    }
}

/// Said where a connection is used that was given back, which [`Lent`] does only at its end.
const GONE: &str = "a connection is there until it is given back";

impl Deref for Lent {
    type Target = Conn;
    fn deref(&self) -> &Conn {
        self.conn.as_ref().expect(GONE)
    }
}

impl DerefMut for Lent {
    fn deref_mut(&mut self) -> &mut Conn {
        self.conn.as_mut().expect(GONE)
    }
}

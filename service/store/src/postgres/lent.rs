//! A connection of the pool that is lent.

use super::{Conn, Db};
use sqlx::pool::PoolConnection;
use sqlx::{Executor, PgPool};
use std::ops::{Deref, DerefMut};
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::time::timeout;

/// A connection of the pool. sqlx 0.9.0 asks the server before it takes one back, however long that says nothing: here it is
/// given up then, so that a host that vanishes takes none of the pool's places with it.
#[derive(Debug)]
pub(super) struct Lent {
    /// There until it is given back or lost.
    conn: Option<PoolConnection<Db>>,
    /// Whether a transaction that only reads was begun on it, which ends with it.
    reads: bool,
    /// How long the server may take for taking it back.
    patience: Duration,
}

impl Lent {
    pub(super) async fn of(pool: &PgPool, patience: Duration) -> Result<Self, sqlx::Error> {
        Ok(Self { conn: Some(pool.acquire().await?), reads: false, patience })
    }

    /// Begins what is rolled back when it is given back.
    pub(super) async fn begin_reading(&mut self, statement: &'static str) -> Result<(), sqlx::Error> {
        self.reads = true;
        self.execute(sqlx::raw_sql(statement)).await?;
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
        let (reads, patience) = (self.reads, self.patience);
        // One that a store kept, which ends behind everything else.
        let Ok(runtime) = Handle::try_current() else {
            drop(conn.detach());
            return;
        };
        runtime.spawn(async move {
            if reads && !matches!(timeout(patience, conn.execute("ROLLBACK")).await, Ok(Ok(_))) {
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

//! Connections that read, each lent to one reader at a time.
//!
//! The library's pool asks each connection that comes back whether it is still there and done, a hop to its thread and
//! back, which costs as much as a short read. After a read that ended well nothing is at work any more: its connection is
//! kept here, and the pool has back only what a cancelled or failed read leaves, and what somebody waits for.

use super::{Conn, Db};
use crate::error::{StoreError, StoreResult};
use crate::lanes::{OthersRead, Turn};
use sqlx::SqlitePool;
use sqlx::pool::PoolConnection;
use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::runtime::Handle;

/// The connections of one store.
#[derive(Debug)]
pub(super) struct Readers {
    pool: SqlitePool,
    /// Connections whose last read ended well.
    ready: Mutex<Vec<PoolConnection<Db>>>,
    /// Readers that wait for the pool.
    waiting: AtomicUsize,
}

/// A connection that is lent. Dropped, it is asked whether it can be used again; [`Lent::settle`] vouches for it.
pub(super) struct Lent {
    /// There until it is given back.
    conn: Option<PoolConnection<Db>>,
    readers: Arc<Readers>,
    /// Its turn to read, which ends when nothing is at work on it any more.
    turn: Turn,
}

/// Said where a connection is used that was given back, which [`Lent`] does only at its end.
const GONE: &str = "a connection is there until it is given back";

impl Drop for Lent {
    fn drop(&mut self) {
        let Some(mut conn) = self.conn.take() else { return };
        let turn = std::mem::take(&mut self.turn);
        let Ok(runtime) = Handle::try_current() else {
            drop(conn.detach());
            return;
        };
        // A statement that was cancelled goes on until its next row.
        let back = conn.return_to_pool();
        runtime.spawn(async move {
            back.await;
            drop(turn);
        });
    }
}

/// Somebody waits, until this is dropped.
struct Waits<'r>(&'r AtomicUsize);

impl Drop for Waits<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

impl Readers {
    pub(super) fn of(pool: SqlitePool) -> Arc<Self> {
        Arc::new(Self { pool, ready: Mutex::default(), waiting: AtomicUsize::new(0) })
    }

    /// Lends a connection, or waits for one as long as the pool's patience lasts.
    pub(super) async fn lend(self: &Arc<Self>, turn: Turn) -> StoreResult<Lent> {
        let conn = match self.take() {
            Some(conn) => conn,
            None => self.wait().await.map_err(|error| match error {
                // A file is there, and its connections are lent.
                sqlx::Error::PoolTimedOut => OthersRead.into(),
                error => StoreError::from(error),
            })?,
        };
        Ok(Lent { conn: Some(conn), readers: Arc::clone(self), turn })
    }

    async fn wait(&self) -> sqlx::Result<PoolConnection<Db>> {
        self.waiting.fetch_add(1, Ordering::SeqCst);
        let _waits = Waits(&self.waiting);
        // Whoever settled before this one was seen to wait has left its connection here.
        match self.take() {
            Some(conn) => Ok(conn),
            None => self.pool.acquire().await,
        }
    }

    /// Connections that are open, idle among them, and most that may be.
    pub(super) fn counts(&self) -> (u32, u32, u32) {
        let idle = self.pool.num_idle().saturating_add(self.ready().len());
        let idle = u32::try_from(idle).unwrap_or(u32::MAX);
        (self.pool.size(), idle, self.pool.options().get_max_connections())
    }

    /// Closes all of them when their readers are done.
    pub(super) async fn close(&self) {
        // Marked as closed from here on, so that nothing is left to be ready.
        let closing = self.pool.close();
        self.ready().clear();
        closing.await;
    }

    fn take(&self) -> Option<PoolConnection<Db>> {
        if self.pool.is_closed() { None } else { self.ready().pop() }
    }

    fn ready(&self) -> MutexGuard<'_, Vec<PoolConnection<Db>>> {
        self.ready.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Readers {
    fn drop(&mut self) {
        // Where there is no runtime any more nobody could ask them: they just end.
        for conn in self.ready().drain(..) {
            drop(conn.detach());
        }
    }
}

impl Lent {
    /// Ends a connection whose transaction could not be ended: it would show the same old moment for ever.
    pub(super) fn discard(mut self) {
        drop(self.conn.take().map(PoolConnection::detach));
    }

    /// Gives it back after a read that ended well.
    pub(super) fn settle(mut self) {
        let readers = Arc::clone(&self.readers);
        readers.ready().extend(self.conn.take());
        // Looked at after it was put there: who waits has looked there after it was counted.
        if readers.waiting.load(Ordering::SeqCst) > 0 {
            let back = readers.ready().pop();
            drop(back);
        }
        if readers.pool.is_closed() {
            readers.ready().clear();
        }
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;
    use sqlx::sqlite::SqlitePoolOptions;
    use std::time::Duration;

    async fn readers(most: u32) -> Arc<Readers> {
        let options = SqlitePoolOptions::new().max_connections(most).acquire_timeout(Duration::from_secs(30));
        Readers::of(options.connect("sqlite::memory:").await.unwrap())
    }

    async fn answers(lent: &mut Lent) {
        let one: i64 = sqlx::query_scalar("SELECT 1").fetch_one(&mut **lent).await.unwrap();
        assert_eq!(one, 1);
    }

    #[tokio::test]
    async fn a_settled_connection_is_lent_again_and_counts_as_idle() {
        let readers = readers(2).await;
        let mut lent = readers.lend(Turn::default()).await.unwrap();
        answers(&mut lent).await;
        assert_eq!(readers.counts(), (1, 0, 2));
        lent.settle();
        assert_eq!(readers.counts(), (1, 1, 2));
        assert_eq!(readers.ready().len(), 1);
        let mut again = readers.lend(Turn::default()).await.unwrap();
        answers(&mut again).await;
        assert_eq!(readers.counts(), (1, 0, 2), "no other was opened");
    }

    #[tokio::test]
    async fn who_waits_has_what_is_settled_or_dropped() {
        let readers = readers(1).await;
        for settled in [true, false] {
            let lent = readers.lend(Turn::default()).await.unwrap();
            let waiting = tokio::spawn({
                let readers = Arc::clone(&readers);
                async move { readers.lend(Turn::default()).await.map(Lent::settle) }
            });
            while readers.waiting.load(Ordering::SeqCst) == 0 {
                tokio::task::yield_now().await;
            }
            if settled {
                lent.settle();
            } else {
                drop(lent);
            }
            waiting.await.unwrap().unwrap();
            assert_eq!(readers.waiting.load(Ordering::SeqCst), 0);
        }
    }

    const COUNT: &str = "WITH RECURSIVE k(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM k WHERE n < 20000) SELECT max(n) FROM k";

    #[tokio::test]
    async fn one_that_is_discarded_makes_room_for_another() {
        let readers = readers(1).await;
        let mut lent = readers.lend(Turn::default()).await.unwrap();
        sqlx::query("BEGIN").execute(&mut *lent).await.unwrap();
        lent.discard();
        assert_eq!(readers.counts(), (0, 0, 1));
        let mut other = readers.lend(Turn::default()).await.unwrap();
        sqlx::query("BEGIN").execute(&mut *other).await.expect("it is in no transaction");
    }

    #[test]
    fn they_may_end_after_their_runtime() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let readers = runtime.block_on(async {
            let readers = readers(1).await;
            readers.lend(Turn::default()).await.unwrap().settle();
            readers
        });
        assert_eq!(readers.ready().len(), 1);
        drop(runtime);
        drop(readers);
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 4)]
    async fn many_readers_share_few_connections() {
        let readers = readers(2).await;
        let all = (0..64).map(|task| {
            let readers = Arc::clone(&readers);
            tokio::spawn(async move {
                for turn in 0..50 {
                    let mut lent = readers.lend(Turn::default()).await.unwrap();
                    // Some are cancelled at work, some go without a word, most end well.
                    match (task + turn) % 7 {
                        0 => drop(lent),
                        1 => {
                            // Long at work when it is cancelled.
                            let asking = sqlx::query_scalar::<_, i64>(COUNT).fetch_one(&mut *lent);
                            tokio::select! {
                                biased;
                                found = asking => assert!(found.is_ok()),
                                () = std::future::ready(()) => {}
                            }
                        }
                        _ => {
                            answers(&mut lent).await;
                            lent.settle();
                        }
                    }
                }
            })
        });
        for task in all.collect::<Vec<_>>() {
            task.await.unwrap();
        }
        assert!(readers.counts().0 <= 2);
    }

    #[tokio::test]
    async fn closing_waits_for_who_reads_and_lends_nothing_more() {
        let readers = readers(2).await;
        let (lent, other) =
            (readers.lend(Turn::default()).await.unwrap(), readers.lend(Turn::default()).await.unwrap());
        other.settle();
        let closing = tokio::spawn({
            let readers = Arc::clone(&readers);
            async move { readers.close().await }
        });
        while !readers.pool.is_closed() {
            tokio::task::yield_now().await;
        }
        assert!(!closing.is_finished());
        assert!(readers.lend(Turn::default()).await.is_err());
        lent.settle();
        closing.await.unwrap();
        assert_eq!(readers.counts().0, 0);
    }
}

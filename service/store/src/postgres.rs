//! PostgreSQL: for a plant, with several servers on one database.
//!
//! Time limits live in the database, set within each transaction so that a pooler in transaction mode bears them, and
//! behind one every read is a transaction: only inside of one do all messages of a statement reach the same server.
//! Session locks and migrations use a direct connection. A connection that comes back inside an open transaction is
//! thrown away before anyone else's work can disappear in it.

mod address;
mod dialect;
#[path = "engine/mod.rs"]
#[expect(clippy::duplicate_mod, reason = "SQL that both engines understand is compiled for each of them")]
mod engine;
mod lent;
mod notice;
mod open;

pub use address::unknown_parameter;
pub(crate) use dialect::{is_ours, keep_partitions};
pub(crate) use notice::{LIVE, plant};
pub use open::{CommonClock, PostgresOptions};
pub(crate) use open::{IS_UNFINISHED, MIGRATIONS};

use crate::error::{StoreError, StoreResult};
use crate::gate::{Gate, panicked};
use crate::lanes::{Ended, Lane, Lanes};
use crate::locks::Locks;
use crate::recent::Recent;
use crate::record::DatabaseUsage;
use crate::registry::Registry;
use crate::rows::number;
use crate::slot::Slot;
use crate::work::{Work, Written};
use feedwright_core::ids::{CycleId, MachineId};
use feedwright_core::units::Timestamp;
use lent::Lent;
use sqlx::postgres::PgConnectOptions;
use sqlx::{ConnectOptions, Connection, PgPool};
use std::pin::pin;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{Mutex, Notify, Semaphore, oneshot};
use tokio::task::JoinHandle;
use tokio::time::timeout;

type Db = sqlx::Postgres;
type Conn = sqlx::PgConnection;
/// Time for a new connection and an answer to a question that waits for nothing.
const WORD: Duration = Duration::from_secs(2);
/// Whether the server still is at what a connection asked it for is looked up this often within the time after which one is
/// taken to be lost.
const LOOKS: u32 = 6;
/// As many times as long as takes a connection to be lost is waited for one of which is not seen what the server is at.
const UNSEEN: u32 = 10;
/// As many changes may be under way that are no longer waited for; those that come then are refused at once, and do not wait for
/// a turn that would end as theirs.
const GIVEN_UP: usize = 2;

/// A group that the server's disk had no room for says so much longer that it is full, unless another one is written: where it has
/// room again and nobody is let to it, nobody would find out.
const FULL_FOR: Duration = Duration::from_secs(30);

/// What writes a group.
type Writer = Conn;
type Engine = PostgresStore;

/// One statement of a change takes no longer; a change that forgets its transaction is ended. Its level is named, as a role or a
/// database may have another one by default: what a change waits for by its first statement, a lock, it has to see by the next.
/// The last setting is for Citus, and nothing to a server without it: by one connection to each worker a change reads what it
/// wrote before, by several it may be refused (Citus issue 3426), and what reads sees one moment of each worker, as each
/// connection has a snapshot of its own.
const BEGIN: &str = "BEGIN ISOLATION LEVEL READ COMMITTED; SET LOCAL statement_timeout = '30s'; SET LOCAL lock_timeout = '15s'; \
                     SET LOCAL idle_in_transaction_session_timeout = '30s'; SET LOCAL row_security = off; \
                     SET LOCAL citus.max_adaptive_executor_pool_size = 1";
const BEGIN_SNAPSHOT: &str = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY; \
                              SET LOCAL statement_timeout = '30s'; \
                              SET LOCAL idle_in_transaction_session_timeout = '30s'; SET LOCAL row_security = off; \
                              SET LOCAL citus.max_adaptive_executor_pool_size = 1";
/// How the read of a page of a list begins: of as many rows as there may be it takes some, in the order of an index, of which ties alone
/// have to be sorted. The planner does not know how many they are of a statement that it has planned once for all values, nor of a
/// table or a machine that is new to its statistics: where it takes them to be few, it reads them all to the end of history and
/// sorts them. Without that choice it goes by the index, whatever it takes them to be. What is left to sort, as what Citus has
/// from its workers, seems to cost more than anything then, and would be compiled.
const BEGIN_IN_ORDER: &str = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY; \
                              SET LOCAL statement_timeout = '30s'; \
                              SET LOCAL idle_in_transaction_session_timeout = '30s'; SET LOCAL row_security = off; \
                              SET LOCAL citus.max_adaptive_executor_pool_size = 1; \
                              SET LOCAL enable_sort = off; SET LOCAL jit = off";
/// The same behind a pooler. sqlx 0.9.0 names its statements even where it remembers none of them, and the connection
/// that the pooler chose may have others of the same names: they go first.
const BEGIN_POOLED: &str = "BEGIN ISOLATION LEVEL READ COMMITTED; DEALLOCATE ALL; \
                            SET LOCAL statement_timeout = '30s'; \
                            SET LOCAL lock_timeout = '15s'; \
                            SET LOCAL idle_in_transaction_session_timeout = '30s'; SET LOCAL row_security = off; \
                            SET LOCAL citus.max_adaptive_executor_pool_size = 1";
const BEGIN_SNAPSHOT_POOLED: &str = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY; DEALLOCATE ALL; \
                                     SET LOCAL statement_timeout = '30s'; \
                                     SET LOCAL idle_in_transaction_session_timeout = '30s'; SET LOCAL row_security = off; \
                                     SET LOCAL citus.max_adaptive_executor_pool_size = 1";
const BEGIN_IN_ORDER_POOLED: &str = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY; DEALLOCATE ALL; \
                                     SET LOCAL statement_timeout = '30s'; \
                                     SET LOCAL idle_in_transaction_session_timeout = '30s'; SET LOCAL row_security = off; \
                                     SET LOCAL citus.max_adaptive_executor_pool_size = 1; \
                                     SET LOCAL enable_sort = off; SET LOCAL jit = off";

/// The store in a PostgreSQL database. Clones share it; other servers may too.
#[derive(Debug, Clone)]
pub struct PostgresStore {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    pool: PgPool,
    /// The server itself, past any pooler.
    direct: PgConnectOptions,
    /// How many of the pool's connections are lent.
    lent: Arc<AtomicUsize>,
    gate: Gate,
    lost_after: Duration,
    /// One at a time asks what the server is at.
    asking: Mutex<()>,
    lanes: Lanes,
    /// Who makes changes: they leave reads some of the pool, however long their commits take.
    changing: Semaphore,
    /// The connection of the change before, where the pool has enough without it: a server's process that has just written cycles
    /// has all at hand that it takes, which another one has to look up.
    warm: std::sync::Mutex<Option<Warm>>,
    /// Changes that are under way and no longer waited for.
    given_up: AtomicUsize,
    /// When the last group came that the server's disk had no room for, if none was written since.
    full_since: std::sync::Mutex<Option<Instant>>,
    pooled: bool,
    clock: CommonClock,
    registry: Arc<Registry>,
    memory: Slot<engine::Memory>,
    /// Of which machine samples were dropped last, where a run is at it.
    dropping: Slot<String>,
    /// Told when a fold is left to the background.
    postponed: Arc<Notify>,
    changes_of_alarms: AtomicU64,
}

/// What a server says that is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Word {
    /// It is good for changes.
    Usable,
    /// It has no place for another connection.
    Full,
}

/// A connection between two changes.
#[derive(Debug)]
struct Warm {
    lent: Lent,
    /// When the pool lent it.
    since: Instant,
}

/// A connection goes back to the pool after so long, which knows how old one may become.
const WARM_FOR: Duration = Duration::from_secs(600);
/// A pool that has a connection lends it in far less.
const AT_ONCE: Duration = Duration::from_millis(20);
/// Pools of fewer connections lend each of them anew.
const ENOUGH_CONNECTIONS: u32 = 4;

impl PostgresStore {
    /// Creates the partitions of samples for the month of `now` and those after it, `months` in all; returns how many
    /// were new. Without them samples go to the default partition, which retention cannot drop at once.
    pub async fn make_partitions(&self, now: Timestamp, months: i32) -> StoreResult<i32> {
        self.write(move |conn| {
            Box::pin(async move {
                dialect::lock(conn, &Locks::subject("partitions", "")).await?;
                Ok(sqlx::query_scalar("SELECT cycle_samples_make_partitions($1, $2)")
                    .bind(now.micros())
                    .bind(months)
                    .fetch_one(&mut *conn)
                    .await?)
            })
        })
        .await
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

    /// Nothing is kept of tools that were asked for: with Citus, what is counted on one worker and what is stored on
    /// another need not be of one moment.
    #[expect(clippy::unused_self, reason = "the other engine keeps some")]
    fn recent(&self) -> Option<&Arc<Recent>> {
        None
    }

    /// Other servers may write to the database.
    #[expect(clippy::unused_self, reason = "the other engine's store knows")]
    const fn is_alone(&self) -> bool {
        false
    }

    /// The time that all servers on the database agree on: that of the database, whatever their own clocks tell. Asked for by itself:
    /// in a statement on a table that is distributed Citus may refuse a function which answers otherwise each time.
    async fn common_time(&self, conn: &mut Conn, now: Timestamp) -> StoreResult<Timestamp> {
        match self.inner.clock {
            CommonClock::Database => dialect::clock(conn).await,
            CommonClock::Callers => Ok(now),
        }
    }

    /// Whether nobody connected in time, and not for want of a connection that others have here: a server that is full takes none
    /// either, and the next wait may be as long.
    async fn is_away(&self, error: &StoreError) -> bool {
        let StoreError::Unavailable(source) = error else { return false };
        if !matches!(source.downcast_ref(), Some(sqlx::Error::PoolTimedOut)) {
            return false;
        }
        match self.says().await {
            Ok(Word::Usable) => false,
            // The pool counts those that it tries to open, too.
            Ok(Word::Full) => self.inner.lent.load(Ordering::Relaxed) == 0,
            Err(_) => true,
        }
    }

    /// Notes what became of a group: whether the server had room for it.
    fn heed_group(&self, outcome: Result<(), &StoreError>) {
        let mut full = self.inner.full_since.lock().unwrap_or_else(PoisonError::into_inner);
        match outcome {
            Ok(()) => *full = None,
            Err(error) if error.is_of_a_full_disk() => *full = Some(Instant::now()),
            Err(_) => {}
        }
    }

    /// Whether the last group, of late, was one that there was no room for. A row that is written over keeps its place on a full disk,
    /// so that the probe says nothing of that.
    fn has_room(&self) -> StoreResult<()> {
        let full = *self.inner.full_since.lock().unwrap_or_else(PoisonError::into_inner);
        match full.filter(|since| since.elapsed() < FULL_FOR) {
            Some(_) => Err(StoreError::Unavailable("the database's disk is full".into())),
            None => Ok(()),
        }
    }

    /// Asks the server itself over a connection of its own: those of the pool, and a pooler's, may all be lent, or lead nowhere.
    async fn word(&self) -> StoreResult<()> {
        self.says().await.map(|_usable_or_full| ())
    }

    async fn says(&self) -> StoreResult<Word> {
        let asked = async {
            let mut conn = self.inner.direct.connect().await?;
            let usable = open::usable(&mut conn).await?;
            conn.close().await?;
            Ok(usable)
        };
        match timeout(WORD, asked).await {
            Ok(Ok(true)) => Ok(Word::Usable),
            Ok(Ok(false)) => Err(StoreError::Unavailable(open::NOT_USABLE.into())),
            // Which is a word.
            Ok(Err(error)) if has_no_place(&error) => Ok(Word::Full),
            Ok(Err(error)) => Err(error.into()),
            Err(_) => Err(StoreError::Unavailable("the database says nothing".into())),
        }
    }

    async fn measure(&self) -> StoreResult<DatabaseUsage> {
        let mut lent = self.reader(Lane::Short).await?;
        let asked = sqlx::query_scalar("SELECT pg_database_size(current_database())");
        let bytes: i64 = self.in_time(async { Ok(asked.fetch_one(&mut *lent).await?) }).await?;
        let pool = &self.inner.pool;
        let warm = self.inner.warm.lock().unwrap_or_else(PoisonError::into_inner).is_some();
        let idle = u32::try_from(pool.num_idle()).unwrap_or(u32::MAX).saturating_add(warm.into());
        Ok(DatabaseUsage {
            bytes: number("bytes", bytes)?,
            wal_bytes: None,
            connections_in_use: pool.size().saturating_sub(idle),
            connections_idle: idle,
            connections_max: pool.options().get_max_connections(),
        })
    }

    fn ears(&self) -> Option<Arc<dyn crate::notice::Notices>> {
        let beat = self.inner.lost_after / LOOKS;
        Some(Arc::new(notice::Direct { connect: self.inner.direct.clone(), beat }))
    }

    /// As any other.
    async fn reader_of_others(&self, lane: Lane) -> StoreResult<Lent> {
        self.reader(lane).await
    }

    /// A connection to read by, outside of a transaction; behind a pooler inside one, which ends when it is given back.
    async fn reader(&self, lane: Lane) -> StoreResult<Lent> {
        let turn = self.inner.lanes.turn(lane).await?;
        let mut lent = self.inner.lent().await?;
        lent.has_turn(turn);
        if self.inner.pooled {
            self.in_time(async { Ok(lent.begin_reading(BEGIN_SNAPSHOT_POOLED).await?) }).await?;
        }
        Ok(lent)
    }

    /// A connection to read pages of lists by, which come in the order of an index: inside a transaction, as long as which the planner is
    /// kept from another order.
    async fn reader_in_order(&self, lane: Lane) -> StoreResult<Lent> {
        let turn = self.inner.lanes.turn(lane).await?;
        let mut lent = self.inner.lent().await?;
        lent.has_turn(turn);
        let begin = if self.inner.pooled { BEGIN_IN_ORDER_POOLED } else { BEGIN_IN_ORDER };
        self.in_time(async { Ok(lent.begin_reading(begin).await?) }).await?;
        Ok(lent)
    }

    /// Waits for a read as long as its server is at it.
    async fn in_time<T>(&self, asked: impl Future<Output = StoreResult<T>>) -> StoreResult<T> {
        match self.inner.answered(asked).await {
            Some(outcome) => outcome,
            None => Err(StoreError::Unavailable(LOST.into())),
        }
    }

    /// The server's own vacuum gives space back.
    #[expect(clippy::unused_async, reason = "the other engine asks its file")]
    async fn give_back(&self) -> StoreResult<bool> {
        Ok(false)
    }

    /// Every question goes to the server.
    const fn block_at_once(
        &self,
        _machine: &MachineId,
        _id: &CycleId,
    ) -> Option<StoreResult<Option<Vec<u8>>>> {
        None
    }

    /// Runs one change in one transaction, in a task that nobody can cancel. Its statements have limits of their own; its commit,
    /// which has none where a standby does not confirm it, is waited for as long as a connection may be silent.
    async fn write<T, F>(&self, work: F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Conn) -> Work<'c, T> + Send + 'static,
    {
        let UnderWay { mut task, committing } = self.under_way(Locks::default(), work).await?;
        let late = async {
            match committing.await {
                Ok(()) => tokio::time::sleep(self.inner.lost_after).await,
                Err(_never_committed) => std::future::pending().await,
            }
        };
        tokio::select! {
            biased;
            ended = &mut task => ended.map_err(panicked)?,
            () = late => Err(self.give_up(task)),
        }
    }

    async fn under_way<T, F>(&self, locks: Locks, work: F) -> StoreResult<UnderWay<T>>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Conn) -> Work<'c, T> + Send + 'static,
    {
        if self.inner.given_up.load(Ordering::Relaxed) >= GIVEN_UP {
            return Err(StoreError::Unavailable("changes before this one are not committed".into()));
        }
        let pass = self.inner.gate.enter().await?;
        let inner = Arc::clone(&self.inner);
        let (commits, committing) = oneshot::channel();
        let task = tokio::spawn(async move {
            let outcome = inner.transaction(&locks, work, commits).await;
            drop(pass);
            outcome
        });
        Ok(UnderWay { task, committing })
    }

    /// Runs a group of cycles in one transaction that begins with its locks, in a task that nobody can cancel. All groups wait for
    /// one another, so that none is waited for longer than for a connection that is lost. What goes on is committed as if another
    /// server had.
    async fn write_group<T, F>(&self, locks: impl FnOnce() -> Locks, work: F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Conn) -> Work<'c, (T, Written)> + Send + 'static,
    {
        let mut task = self.under_way(locks(), work).await?.task;
        match timeout(self.inner.lost_after, &mut task).await {
            Ok(ended) => ended.map_err(panicked)?.map(|(value, _)| value),
            Err(_) => Err(self.give_up(task)),
        }
    }

    /// Waits no longer for a transaction, which goes on and keeps its connection.
    fn give_up<T: Send + 'static>(&self, task: JoinHandle<StoreResult<T>>) -> StoreError {
        let why = format!("a transaction is not committed after {} s", self.inner.lost_after.as_secs());
        tracing::warn!("{why}, and is no longer waited for");
        let inner = Arc::clone(&self.inner);
        inner.given_up.fetch_add(1, Ordering::Relaxed);
        tokio::spawn(async move {
            // Whatever came of it: whoever waited was told that it is not known.
            let _ = task.await;
            inner.given_up.fetch_sub(1, Ordering::Relaxed);
        });
        StoreError::OutcomeUnknown(why.into())
    }

    /// Whether a group took as long as one is waited for: the same again would wait for the same, such as a lock, or a standby that
    /// does not confirm.
    fn is_too_slow(&self, took: Duration) -> bool {
        took >= self.inner.lost_after
    }

    /// Runs reads; the server holds every row to its table's constraints.
    async fn held_to_constraints<T, F>(&self, work: F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Conn) -> Work<'c, T> + Send + 'static,
    {
        self.snapshot(Lane::Long, work).await
    }

    /// Runs reads in one snapshot, in a task of its own that ends its transaction: also where nobody waits for the answer any more, or
    /// the store is closed, which it finds out between two statements.
    async fn snapshot<T, F>(&self, lane: Lane, work: F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Conn) -> Work<'c, T> + Send + 'static,
    {
        let turn = self.inner.lanes.turn(lane).await?;
        let inner = Arc::clone(&self.inner);
        let (waits, gone) = oneshot::channel::<()>();
        let task = tokio::spawn(async move {
            let mut lent = inner.lent().await?;
            lent.has_turn(turn);
            let asked = async {
                let mut transaction = lent.begin_with(inner.begin_snapshot()).await?;
                let outcome = tokio::select! {
                    biased;
                    outcome = work(&mut transaction) => outcome,
                    _ = gone => Err(Ended.into()),
                    () = inner.lanes.ended() => Err(Ended.into()),
                };
                transaction.rollback().await?;
                outcome
            };
            let answer = inner.answered(asked).await;
            answer.unwrap_or_else(|| {
                lent.lose();
                Err(StoreError::Unavailable(LOST.into()))
            })
        });
        let outcome = task.await.map_err(panicked)?;
        drop(waits);
        outcome
    }

    /// What is no longer waited for keeps its connection, and nobody from going.
    async fn shut(&self) {
        let ended = async {
            self.inner.gate.shut().await;
            self.inner.lanes.end();
            drop(self.inner.warm.lock().unwrap_or_else(PoisonError::into_inner).take());
            self.inner.pool.close().await;
        };
        if timeout(self.inner.lost_after, ended).await.is_err() {
            tracing::warn!("a change is not committed yet, and is left to the database");
        }
    }
}

/// Said of a connection whose server is not at what it was asked for, or did not answer in time.
const LOST: &str = "a connection to the database is lost: its server is not at what it was asked for";

/// What is seen of work that an answer is late of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Seen {
    /// The server is at something as old.
    AtWork,
    /// It does not show what it is at.
    Hidden,
    /// It is at nothing as old.
    Idle,
    /// It does not answer.
    Nothing,
}

/// Whether a lock was not to be had: in time, or as somebody who has it waits for this one (SQLSTATE 55P03, 57014 and 40P01).
fn is_of_a_lock(error: &sqlx::Error) -> bool {
    let code = error.as_database_error().and_then(sqlx::error::DatabaseError::code);
    matches!(code.as_deref(), Some("55P03" | "57014" | "40P01"))
}

/// Whether a server has no connection left, and says so (SQLSTATE class 53).
fn has_no_place(error: &sqlx::Error) -> bool {
    let code = error.as_database_error().and_then(sqlx::error::DatabaseError::code);
    code.is_some_and(|code| code.starts_with("53"))
}

impl Inner {
    /// A connection of the pool; where none is to be had at once, the one that is kept for the next change.
    async fn lent(&self) -> StoreResult<Lent> {
        let mut asked = pin!(Lent::of(&self.pool, self.lost_after / LOOKS, &self.lent));
        loop {
            if let Ok(lent) = timeout(AT_ONCE, &mut asked).await {
                return Ok(lent?);
            }
            if let Some(warm) = self.warm().await {
                return Ok(warm.lent);
            }
        }
    }

    const fn begin(&self) -> &'static str {
        if self.pooled { BEGIN_POOLED } else { BEGIN }
    }

    const fn begin_snapshot(&self) -> &'static str {
        if self.pooled { BEGIN_SNAPSHOT_POOLED } else { BEGIN_SNAPSHOT }
    }

    /// Waits for what a server was asked for as long as that is at it, however long that takes. `None` where it is not, as behind an
    /// address that another server has taken over, or where nothing was heard of it for as long as takes a connection to be
    /// lost: that leads nowhere then, as nobody closes it.
    async fn answered<T>(&self, asked: impl Future<Output = T>) -> Option<T> {
        let mut asked = pin!(asked);
        let begun = Instant::now();
        let (mut heard, mut denied) = (begun, false);
        loop {
            if let Ok(answer) = timeout(self.lost_after / LOOKS, &mut asked).await {
                return Some(answer);
            }
            let since = begun.elapsed();
            let seen = tokio::select! {
                biased;
                answer = &mut asked => return Some(answer),
                seen = self.sees(since) => seen,
            };
            let is_lost = match seen {
                Seen::AtWork => {
                    (heard, denied) = (Instant::now(), false);
                    self.pooled && since >= self.lost_after * UNSEEN
                }
                Seen::Hidden => {
                    heard = Instant::now();
                    since >= self.lost_after * UNSEEN
                }
                // What has just ended, or begun, is not seen either, and its answer may be under way: twice it is not.
                Seen::Idle => std::mem::replace(&mut denied, true),
                Seen::Nothing => heard.elapsed() >= self.lost_after,
            };
            if is_lost {
                tracing::warn!(seconds = since.as_secs(), ?seen, "{LOST}");
                return None;
            }
        }
    }

    /// What the server is at of what began about so long ago: one by one they are not known from here.
    async fn sees(&self, since: Duration) -> Seen {
        // Not a backup, which is at work for hours. Of other roles' connections neither is shown, nor where activities are not tracked. A pooler may name them otherwise.
        const ASK: &str = "SELECT
                COALESCE(bool_or(backend_type = 'client backend'
                    AND clock_timestamp() - xact_start >= make_interval(secs => $2)), false) AS at_work,
                COALESCE(bool_or(state IS NULL OR state = 'disabled'), false) AS hidden
            FROM pg_stat_activity
            WHERE datname = current_database() AND pid <> pg_backend_pid()
                AND ($1 OR application_name = 'feedwright')";
        let _one = self.asking.lock().await;
        let asked = async {
            let mut conn = self.direct.connect().await?;
            // Half of it: the transaction began later than whoever waits for it.
            let seen = sqlx::query_as(ASK).bind(self.pooled).bind(since.as_secs_f64() / 2.0);
            let seen: (bool, bool) = seen.fetch_one(&mut conn).await?;
            conn.close().await?;
            Ok::<_, sqlx::Error>(seen)
        };
        match timeout(WORD, asked).await {
            Ok(Ok((true, _))) => Seen::AtWork,
            Ok(Ok((false, true))) => Seen::Hidden,
            Ok(Ok((false, false))) => Seen::Idle,
            Ok(Err(error)) if has_no_place(&error) => Seen::Hidden,
            Ok(Err(_)) | Err(_) => Seen::Nothing,
        }
    }

    /// Whether one of the server's processes is in a transaction; also where it does not say.
    async fn is_in_change(&self, process: i32) -> bool {
        let asked = async {
            let mut conn = self.direct.connect().await?;
            let found = sqlx::query_scalar(
                "SELECT EXISTS (SELECT 1 FROM pg_stat_activity
                     WHERE pid = $1 AND (xact_start IS NOT NULL OR state IS NULL OR state = 'disabled'))",
            );
            let found: bool = found.bind(process).fetch_one(&mut conn).await?;
            conn.close().await?;
            Ok::<_, sqlx::Error>(found)
        };
        match timeout(WORD, asked).await {
            Ok(Ok(found)) => found,
            Ok(Err(error)) => has_no_place(&error),
            Err(_) => false,
        }
    }

    async fn transaction<T, F>(&self, locks: &Locks, work: F, commits: oneshot::Sender<()>) -> StoreResult<T>
    where
        F: for<'c> FnOnce(&'c mut Conn) -> Work<'c, T> + Send + 'static,
    {
        let patience = self.pool.options().get_acquire_timeout();
        let Ok(Ok(_turn)) = timeout(patience, self.changing.acquire()).await else {
            return Err(StoreError::Unavailable("other changes are under way".into()));
        };
        let Warm { mut lent, since } = self.begun(locks).await?;
        match self.answered(changed(&mut lent, work, commits)).await {
            Some(outcome) => {
                if outcome.is_ok() {
                    self.keep_warm(Warm { lent, since });
                }
                outcome
            }
            None => {
                lent.lose();
                Err(StoreError::OutcomeUnknown(LOST.into()))
            }
        }
    }

    /// A connection with a change begun on it, and its locks taken: that of the change before, where it still is good for one.
    async fn begun(&self, locks: &Locks) -> StoreResult<Warm> {
        let message = format!("{}{}; {}", self.begin(), dialect::locking(locks), open::GOOD);
        // A pooler hands a change to any of the server's processes, so that nobody could ask for its.
        let kept = if self.pooled { self.warm().await } else { self.kept() };
        if let Some(Warm { lent, since }) = kept {
            match self.begins(lent, &message, true).await {
                Ok(lent) => return Ok(Warm { lent, since }),
                Err(Unbegun::Locked(error)) => return Err(error.into()),
                // The pool may have a better one.
                Err(Unbegun::Lost(_)) => {}
            }
        }
        match self.begins(self.lent().await?, &message, false).await {
            Ok(lent) => Ok(Warm { lent, since: Instant::now() }),
            Err(Unbegun::Locked(error)) => Err(error.into()),
            Err(Unbegun::Lost(error)) => Err(error),
        }
    }

    /// Begins a change on a connection, which goes where it cannot; one that was kept may lead nowhere since, which those of the pool
    /// have just been asked.
    async fn begins(&self, mut lent: Lent, message: &str, was_kept: bool) -> Result<Lent, Unbegun> {
        let process = lent.process().filter(|_| was_kept && !self.pooled);
        let answer = {
            let mut beginning = pin!(lent.begin_change(message.to_owned()));
            let at_once = self.pool.options().get_acquire_timeout() / 2;
            match (timeout(at_once, &mut beginning).await, process) {
                (Ok(answer), _) => Some(answer),
                // It waits for a lock, or leads nowhere.
                (Err(_), Some(process)) if !self.is_in_change(process).await => None,
                (Err(_), _) => self.answered(beginning).await,
            }
        };
        let lost = match answer {
            Some(Ok(true)) => return Ok(lent),
            Some(Ok(false)) => StoreError::Unavailable(open::NOT_USABLE.into()),
            Some(Err(error)) if is_of_a_lock(&error) => return Err(Unbegun::Locked(error)),
            Some(Err(error)) => error.into(),
            None => StoreError::Unavailable(LOST.into()),
        };
        lent.lose();
        Err(Unbegun::Lost(lost))
    }

    /// The connection of the change before, where the pool may not have it back yet.
    fn kept(&self) -> Option<Warm> {
        let warm = self.warm.lock().unwrap_or_else(PoisonError::into_inner).take()?;
        (warm.since.elapsed() <= WARM_FOR).then_some(warm)
    }

    /// The connection of the change before, where it still may be asked; as the pool asks of one that it lends.
    async fn warm(&self) -> Option<Warm> {
        let mut warm = self.kept()?;
        let patience = self.pool.options().get_acquire_timeout() / 2;
        match timeout(patience, open::usable(&mut warm.lent)).await {
            Ok(Ok(true)) => Some(warm),
            _ => {
                warm.lent.lose();
                None
            }
        }
    }

    fn keep_warm(&self, warm: Warm) {
        if self.pool.options().get_max_connections() < ENOUGH_CONNECTIONS || self.pool.is_closed() {
            return;
        }
        self.warm.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(warm);
    }
}

/// Why a change could not begin: nothing of it is done.
enum Unbegun {
    /// For a lock, which another connection would not have either.
    Locked(sqlx::Error),
    /// For the connection, or its server.
    Lost(StoreError),
}

/// A change in a task of its own.
struct UnderWay<T> {
    task: JoinHandle<StoreResult<T>>,
    /// Told when its commit begins; never, where it does not come to that.
    committing: oneshot::Receiver<()>,
}

/// The rest of a change, whose transaction has begun; `commits` is told when all but its commit is done.
async fn changed<T, F>(lent: &mut Lent, work: F, commits: oneshot::Sender<()>) -> StoreResult<T>
where
    F: for<'c> FnOnce(&'c mut Conn) -> Work<'c, T> + Send + 'static,
{
    match work(lent).await {
        Ok(value) => {
            // Nobody waits for it where it was begun for a group.
            let _ = commits.send(());
            match lent.commit().await.map_err(StoreError::from) {
                Ok(()) => Ok(value),
                // The commit was sent: it may have been kept although no answer came.
                Err(StoreError::Unavailable(error)) => Err(StoreError::OutcomeUnknown(error)),
                Err(error) => Err(error),
            }
        }
        Err(error) => {
            if let Err(rollback) = lent.roll_back().await {
                tracing::debug!(error = %rollback, "rollback failed, the connection goes");
            }
            Err(error)
        }
    }
}

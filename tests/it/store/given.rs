//! What the stories start from: a fresh store of either engine, a fixed clock, and cycles with known figures.

use feedwright_core::cycle::{Channel, Cycle, CycleDraft, Outcome, Reported, Samples, TimeBase};
use feedwright_core::machine::{FeedLimits, LoadReference, Machine, SpindleRating};
use feedwright_core::operation::{Operation, WearSettings};
use feedwright_core::recommend::RecommendSettings;
use feedwright_core::summary::{Context, summarise};
use feedwright_core::tool::{Tool, ToolEvent, ToolEventKind};
use feedwright_core::units::{Process, Timestamp};
use feedwright_store::{
    Actor, Committed, CommonClock, CycleAnswer, NewCycle, PostgresOptions, PostgresStore, Precondition,
    QuarantineBounds, Role, SqliteOptions, SqliteStore, Store, StoreResult, WatchSettings, WearCheck, codec,
};
use sqlx::{ConnectOptions, Connection, PgConnection, SqliteConnection};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// Tells a story to each engine: `stories!(name, name, …)` makes a test per engine of each function.
macro_rules! stories {
    ($($story:ident),* $(,)?) => {
        $crate::store::given::stories!(@told given => { given.store() }, $($story),*);
    };
    // Stories that also look at the tables themselves.
    (with tables: $($story:ident),* $(,)?) => {
        $crate::store::given::stories!(@told given => { &given }, $($story),*);
    };
    (@told $given:ident => $argument:block, $($story:ident),*) => {
        mod sqlite {
            $(
                #[tokio::test]
                async fn $story() {
                    let $given = $crate::store::given::Given::sqlite().await;
                    super::$story($argument).await;
                    $given.done().await;
                }
            )*
        }

        mod postgres {
            $(
                #[tokio::test]
                async fn $story() {
                    let Some($given) = $crate::store::given::Given::postgres().await else {
                        return;
                    };
                    super::$story($argument).await;
                    $given.done().await;
                }
            )*
        }
    };
}
pub(crate) use stories;

/// A store of its own, removed at the end.
pub(crate) struct Given {
    store: Arc<dyn Store>,
    place: Place,
}

enum Place {
    File(tempfile::TempDir),
    Database { server: String, name: String },
}

impl Given {
    /// As a server has it: nobody else commits cycles.
    pub(crate) async fn sqlite() -> Self {
        Self::sqlite_with(SqliteOptions { alone: true, ..SqliteOptions::default() }).await
    }

    pub(crate) async fn sqlite_with(options: SqliteOptions) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("cell.sqlite3");
        let store = SqliteStore::open(file, options).await.expect("a fresh store opens");
        Self { store: Arc::new(store), place: Place::File(folder) }
    }

    /// Address of the server that `tests/postgres` started. Without one the story fails, so that nobody believes it was
    /// told; `None` only where a person asked to leave it out.
    pub(crate) fn server() -> Option<String> {
        let server = std::env::var("FEEDWRIGHT_TEST_POSTGRES").ok();
        let set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
        assert!(
            server.is_some() || set("FEEDWRIGHT_TEST_SKIP_POSTGRES") && !set("CI"),
            "no PostgreSQL: run `tests/run`, or this command behind `tests/postgres`, or set \
             FEEDWRIGHT_TEST_SKIP_POSTGRES=1 to leave its stories out"
        );
        server
    }

    /// A database of its own on that server.
    pub(crate) async fn postgres() -> Option<Self> {
        Self::postgres_made("").await
    }

    /// The same in a database that is made otherwise than usual.
    pub(crate) async fn postgres_made(otherwise: &str) -> Option<Self> {
        let server = Self::server()?;
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let name = format!("story_{}_{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        let mut admin = PgConnection::connect(&server).await.expect("the server of tests/postgres answers");
        let mut create = sqlx::QueryBuilder::<sqlx::Postgres>::new("CREATE DATABASE ");
        create.push(&name).push(" ").push(otherwise);
        create.build().persistent(false).execute(&mut admin).await.expect("a fresh database");
        let (base, _) = server.rsplit_once('/').expect("an address ends in a database");
        // The stories bring the time, as they do to the other engine.
        let options = PostgresOptions { clock: CommonClock::Callers, ..PostgresOptions::default() };
        let store =
            PostgresStore::open(&format!("{base}/{name}"), options).await.expect("a fresh store opens");
        Some(Self { store: Arc::new(store), place: Place::Database { server, name } })
    }

    /// The store of another server on the same database, PostgreSQL's, which goes by the database's clock as servers do.
    pub(crate) async fn server_of_its_own(&self) -> PostgresStore {
        PostgresStore::open(&self.address(), PostgresOptions::default()).await.expect("a second store opens")
    }

    pub(crate) fn store(&self) -> Arc<dyn Store> {
        Arc::clone(&self.store)
    }

    /// Where a number of `cycles` is written: SQLite reads some out of columns that keep them shorter.
    pub(crate) fn kept_in(&self, column: &str) -> String {
        let is_shorter = [
            "dynamometer_joules",
            "calibrated_joules",
            "measured_power_joules",
            "rated_power_joules",
            "reported_energy_joules",
            "max_depth_mm",
            "max_spindle_load_depth_mm",
            "spindle_load_fall_depth_mm",
        ]
        .contains(&column);
        let ending = if is_shorter && !self.is_postgres() { "_stored" } else { "" };
        format!("{column}{ending}")
    }

    /// A change of a row of `cycles`, `column = expression`, as it is written.
    pub(crate) fn change(&self, change: &str) -> String {
        let (column, expression) = change.split_once(" = ").expect("an assignment");
        format!("UPDATE cycles SET {} = {expression}", self.kept_in(column))
    }

    /// Runs a statement on the tables themselves, as any other client of the database might.
    pub(crate) async fn raw(&self, sql: impl sqlx::SqlSafeStr) -> Result<u64, sqlx::Error> {
        match &self.place {
            Place::File(_) => {
                Ok(sqlx::query(sql).execute(&mut self.sqlite_tables().await).await?.rows_affected())
            }
            Place::Database { .. } => {
                let mut conn = PgConnection::connect(&self.address()).await?;
                Ok(sqlx::query(sql).execute(&mut conn).await?.rows_affected())
            }
        }
    }

    /// One column of numbers from the tables themselves.
    pub(crate) async fn numbers(&self, sql: &'static str) -> Vec<i64> {
        match &self.place {
            Place::File(_) => {
                sqlx::query_scalar(sql).fetch_all(&mut self.sqlite_tables().await).await.unwrap()
            }
            Place::Database { .. } => {
                let mut conn = PgConnection::connect(&self.address()).await.unwrap();
                sqlx::query_scalar(sql).fetch_all(&mut conn).await.unwrap()
            }
        }
    }

    /// The cached folds as they are stored: machine, tool, cycles folded, state.
    pub(crate) async fn wear_states(&self) -> Vec<(String, String, i64, Vec<u8>)> {
        const SQL: &str =
            "SELECT machine_id, tool_id, folded, state FROM tool_wear ORDER BY machine_id, tool_id";
        match &self.place {
            Place::File(_) => sqlx::query_as(SQL).fetch_all(&mut self.sqlite_tables().await).await.unwrap(),
            Place::Database { .. } => {
                let mut conn = PgConnection::connect(&self.address()).await.unwrap();
                sqlx::query_as(SQL).fetch_all(&mut conn).await.unwrap()
            }
        }
    }

    /// The file, where it is SQLite's.
    pub(crate) fn file(&self) -> std::path::PathBuf {
        match &self.place {
            Place::File(folder) => folder.path().join("cell.sqlite3"),
            Place::Database { .. } => unreachable!("only a file has a path"),
        }
    }

    /// Sessions of PostgreSQL that are inside a transaction and do nothing; 0 where there is no server.
    pub(crate) async fn open_transactions(&self) -> i64 {
        if !self.is_postgres() {
            return 0;
        }
        let mut conn = PgConnection::connect(&self.address()).await.unwrap();
        sqlx::query_scalar(
            "SELECT count(*) FROM pg_stat_activity
             WHERE datname = current_database() AND state LIKE 'idle in transaction%'",
        )
        .fetch_one(&mut conn)
        .await
        .unwrap()
    }

    /// Rows and entries of indexes that servers on PostgreSQL have read of a table, by name. Closes the store.
    pub(crate) async fn read_of(&self, table: &str) -> i64 {
        let read = sqlx::query_scalar(
            "SELECT CAST(seq_tup_read + (SELECT COALESCE(SUM(idx_tup_read), 0) FROM pg_stat_user_indexes i
                                         WHERE i.relid = t.relid) AS BIGINT)
             FROM pg_stat_user_tables t WHERE relname = $1",
        );
        read.bind(table).fetch_one(&mut self.told_by_all().await).await.unwrap()
    }

    /// Blocks of a table and of its indexes that servers on PostgreSQL have looked into, by name: those too of which entries were only
    /// passed over. Closes the store.
    pub(crate) async fn blocks_of(&self, table: &str) -> i64 {
        let blocks = sqlx::query_scalar(
            "SELECT heap_blks_read + heap_blks_hit + idx_blks_read + idx_blks_hit FROM pg_statio_user_tables WHERE relname = $1",
        );
        blocks.bind(table).fetch_one(&mut self.told_by_all().await).await.unwrap()
    }

    /// A connection to PostgreSQL when all others have ended: whoever ends tells what it did.
    async fn told_by_all(&self) -> PgConnection {
        self.store.close().await;
        let mut conn = PgConnection::connect(&self.address()).await.unwrap();
        let others = "SELECT count(*) FROM pg_stat_activity
                      WHERE datname = current_database() AND pid <> pg_backend_pid() AND backend_type = 'client backend'";
        while sqlx::query_scalar::<_, i64>(others).fetch_one(&mut conn).await.unwrap() > 0 {
            tokio::task::yield_now().await;
        }
        conn
    }

    async fn sqlite_tables(&self) -> SqliteConnection {
        let Place::File(folder) = &self.place else { unreachable!("only a file has these") };
        // Who reads by the store has what was acknowledged committed; who reads beside it does not. A store that is closed
        // has nothing left to commit.
        drop(self.store.usage().await);
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(folder.path().join("cell.sqlite3"));
        options.connect().await.expect("the file opens beside the store")
    }

    pub(crate) const fn is_postgres(&self) -> bool {
        matches!(self.place, Place::Database { .. })
    }

    /// Address of the database, where it is PostgreSQL's.
    pub(crate) fn address(&self) -> String {
        match &self.place {
            Place::File(_) => unreachable!("only a server has an address"),
            Place::Database { server, name } => {
                let (base, _) = server.rsplit_once('/').expect("an address ends in a database");
                format!("{base}/{name}")
            }
        }
    }

    /// Removes a database whose servers may not have let go of it yet.
    pub(crate) async fn removed(self) {
        self.store.close().await;
        let Place::Database { server, name } = self.place else { unreachable!("only a database is removed") };
        let mut admin = PgConnection::connect(&server).await.expect("the server answers");
        let mut drop = sqlx::QueryBuilder::<sqlx::Postgres>::new("DROP DATABASE ");
        drop.push(&name).push(" WITH (FORCE)");
        drop.build().persistent(false).execute(&mut admin).await.expect("removed");
    }

    pub(crate) async fn done(self) {
        self.store.close().await;
        match self.place {
            Place::File(folder) => folder.close().expect("the temporary folder is removed"),
            Place::Database { server, name } => {
                let mut admin = PgConnection::connect(&server).await.expect("the server answers");
                let mut drop = sqlx::QueryBuilder::<sqlx::Postgres>::new("DROP DATABASE ");
                drop.push(&name);
                drop.build()
                    .persistent(false)
                    .execute(&mut admin)
                    .await
                    .expect("nobody is connected any more");
            }
        }
    }
}

/// The clock of the stories: 2026-01-05T08:00:00Z and so many seconds.
/// Claims an entry of the quarantine and settles it; `false` where either cannot be.
pub(crate) async fn settle(store: &dyn Store, id: &str, how: &str, now: Timestamp) -> bool {
    let lease = Duration::from_secs(60);
    store.claim_quarantine(id, "a server", lease, now).await.unwrap()
        && store.settle_quarantine(id, "a server", how, &engineer(), now).await.unwrap()
}

pub(crate) const fn at(seconds: i64) -> Timestamp {
    Timestamp::from_micros((1_767_600_000 + seconds) * 1_000_000)
}

/// What the watch goes by where a story is of something else.
pub(crate) fn watched() -> WatchSettings {
    WatchSettings {
        silent_after_ms: None,
        silent_after_ms_by_machine: std::collections::BTreeMap::new(),
        quarantine: QuarantineBounds { entries: 10, bytes: 1000 },
        quarantine_warning_ratio: 0.8,
    }
}

pub(crate) fn engineer() -> Actor {
    Actor { token: "tok-eve".to_owned(), role: Role::Engineer }
}

pub(crate) fn machine(id: &str) -> Machine {
    Machine {
        id: id.try_into().unwrap(),
        name: format!("machine {id}"),
        control: "sinumerik-840d".to_owned(),
        ipo_period_ms: 10.0,
        spindle: SpindleRating {
            reference: LoadReference::RatedPower,
            rated_power_watts: Some(10_000.0),
            base_speed_rpm: Some(1500.0),
        },
        feed_drive: feedwright_core::machine::FeedDriveRating::default(),
        limits: FeedLimits::new(1.0, 2000.0, 5.0, 200.0).unwrap(),
    }
}

pub(crate) fn tool(id: &str) -> Tool {
    Tool {
        id: id.try_into().unwrap(),
        name: format!("tool {id}"),
        serial: None,
        tool_type: "friction-6".to_owned(),
        diameter_mm: Some(6.0),
    }
}

pub(crate) fn operation(id: &str) -> Operation {
    Operation {
        id: id.try_into().unwrap(),
        name: format!("operation {id}"),
        process: Process::Friction,
        program: Some("O1000".to_owned()),
        feature: None,
        work_material: Some("S235".to_owned()),
        thickness_mm: Some(2.0),
        depth_mm: None,
        spindle_speed_rpm: Some(2400.0),
        programmed_feed_mm_min: Some(120.0),
        spindle_load_set_percent: Some(35.5),
        feed_drive_load_set_percent: None,
        wear: WearSettings::default(),
        turning: None,
        plunge: None,
    }
}

/// Machine M1, tool T1 and operation O1, registered.
pub(crate) async fn shop(store: &dyn Store) {
    let who = engineer();
    store.put_machine(machine("M1"), Precondition::Unstated, &who, at(0)).await.unwrap();
    store.put_operation(operation("O1"), Precondition::Unstated, &who, at(0)).await.unwrap();
    store.put_tool(tool("T1"), Precondition::Unstated, &who, at(0)).await.unwrap();
    mounted(store, "T1", -10).await;
}

/// Whose caches of wear differ from their folds: machine and tool.
pub(crate) fn differing(check: &WearCheck) -> Vec<(&str, &str)> {
    check.different.iter().map(|wear| (wear.machine.as_str(), wear.tool.as_str())).collect()
}

/// Tells that a new tool was mounted.
pub(crate) async fn mounted(store: &dyn Store, tool: &str, seconds: i64) {
    let event = event(ToolEventKind::MountedNew, at(seconds));
    store.add_tool_event(&tool.try_into().unwrap(), event, &engineer(), at(seconds)).await.unwrap().unwrap();
}

pub(crate) fn event(kind: ToolEventKind, at: Timestamp) -> ToolEvent {
    ToolEvent { kind, at, first_cycle: None, reason: Some("as the story goes".to_owned()) }
}

/// A fold's state without what is only packing, which each engine does by itself: with its runs of zeros (`codec/state.rs`,
/// `codec/zeros.rs`).
pub(crate) fn unpacked(state: &[u8]) -> Vec<u8> {
    let squeezed;
    let mut rest = match state {
        [0xfe, a, b, c, d, frame @ ..] => {
            let length = u32::from_le_bytes([*a, *b, *c, *d]);
            squeezed = zstd::bulk::decompress(frame, length.try_into().unwrap()).expect("a frame");
            squeezed.strip_prefix(&[0xff]).expect("runs of zeros")
        }
        [0xff, rest @ ..] => rest,
        plain => return plain.to_vec(),
    };
    let mut plain = Vec::new();
    while let [byte, later @ ..] = rest {
        rest = later;
        if *byte == 0 {
            let (&run, later) = rest.split_first().expect("the length of a run");
            plain.resize(plain.len() + usize::from(run), 0);
            rest = later;
        } else {
            plain.push(*byte);
        }
    }
    plain
}

/// Makes what stands in an index another thing than the index says: no table has changed, and rows are not found by it.
pub(crate) const WRONG_INDEX: &str = "PRAGMA writable_schema = ON;
    UPDATE sqlite_schema SET sql = replace(sql, '(tool_id,', '(operation_id,') WHERE name = 'cycles_by_tool';
    PRAGMA writable_schema = RESET";

/// Puts that right.
pub(crate) const RIGHT_INDEX: &str = "PRAGMA writable_schema = ON;
    UPDATE sqlite_schema SET sql = replace(sql, '(operation_id,', '(tool_id,') WHERE name = 'cycles_by_tool';
    PRAGMA writable_schema = RESET";

/// How a story's cycle differs from the usual one.
#[derive(Clone)]
pub(crate) struct Run {
    pub(crate) machine: &'static str,
    pub(crate) id: String,
    pub(crate) tool: String,
    pub(crate) operation: &'static str,
    pub(crate) seconds: i64,
    pub(crate) seq: Option<u64>,
    /// Mean spindle load, %: energy is in proportion.
    pub(crate) load: f64,
    pub(crate) sampled: bool,
}

impl Run {
    /// The `n`th cycle of tool T1 on machine M1, a minute after the one before.
    pub(crate) fn nth(n: u32) -> Self {
        Self {
            machine: "M1",
            id: format!("c{n:05}"),
            tool: "T1".to_owned(),
            operation: "O1",
            seconds: i64::from(n) * 60,
            seq: Some(u64::from(n)),
            load: 30.0,
            sampled: true,
        }
    }

    pub(crate) fn draft(&self) -> CycleDraft {
        let samples = self.sampled.then(|| {
            let depth = (0..20).map(|k| f64::from(k) * 0.25).collect();
            let load = (0..20).map(|k| self.load + f64::from(k % 3) - 1.0).collect();
            let columns = vec![(Channel::DepthMm, depth), (Channel::SpindleLoadPercent, load)];
            Samples::new(TimeBase::Period { period_ms: 100.0 }, columns, 100).unwrap()
        });
        CycleDraft {
            machine: self.machine.try_into().unwrap(),
            id: self.id.as_str().try_into().unwrap(),
            tool: self.tool.as_str().try_into().unwrap(),
            operation: self.operation.try_into().unwrap(),
            started_at: at(self.seconds),
            seq: self.seq,
            process: None,
            strategy: Some(feedwright_core::units::Strategy::FLin),
            law_version: None,
            profile: None,
            reference: None,
            recommendation: None,
            spindle_speed_rpm: Some(2400.0),
            outcome: Outcome::Completed,
            reported: Reported {
                energy_joules: (!self.sampled).then_some(self.load * 200.0),
                duration_ms: (!self.sampled).then_some(2000.0),
                ..Reported::default()
            },
            samples,
        }
    }

    pub(crate) fn new_cycle(&self) -> NewCycle {
        new_cycle(Cycle::new(self.draft()).unwrap())
    }
}

/// A cycle as the server hands it over: summarised and encoded, received a second after it ended.
pub(crate) fn new_cycle(cycle: Cycle) -> NewCycle {
    let (machine, operation) = (machine(cycle.machine.as_str()), operation(cycle.operation.as_str()));
    let context = Context { machine: &machine, calibration: None, operation: Some(&operation) };
    let summary = summarise(&cycle, context);
    let encoded = codec::encode(&cycle);
    NewCycle {
        received_at: cycle.started_at.plus_millis(3000),
        cycle: Arc::new(cycle),
        encoded,
        summary,
        generation: None,
        cut_short: false,
    }
}

/// Commits a group at the usual settings.
pub(crate) async fn commit(store: &dyn Store, runs: &[Run]) -> Vec<StoreResult<Committed>> {
    let group = runs.iter().map(Run::new_cycle).collect();
    store.commit_cycles(group, at(100_000), RecommendSettings::default()).await
}

/// Commits one cycle that must be new.
pub(crate) async fn stored(store: &dyn Store, run: &Run) -> CycleAnswer {
    match commit(store, std::slice::from_ref(run)).await.pop() {
        Some(Ok(Committed::Stored(answer))) => *answer,
        other => panic!("{} should be stored: {other:?}", run.id),
    }
}

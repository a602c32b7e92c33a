//! Where a server of ours keeps what it is sent: a folder of its own, or a database of its own on the PostgreSQL server of
//! `tests/postgres`.

use super::bytes::Taken;
use super::process::Running;
use super::{data, rest};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, Executor, PgConnection};
use tempfile::TempDir;

/// What our server keeps its cycles in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Engine {
    Sqlite,
    Postgres,
}

/// A server of ours, with nothing in it at first.
pub(crate) struct Ours {
    pub(crate) server: Running,
    dir: TempDir,
    database: Option<Database>,
}

/// The name of the database; there is one at a time.
const NAME: &str = "feedwright_bench";

/// Bytes of tables, what they keep beside themselves, and indexes; partitions as what they are of, the catalogue as one.
const TAKEN: &str = "
    WITH there AS (
        SELECT c.oid, c.relkind, coalesce(owner.oid, c.oid) AS of
        FROM pg_class c LEFT JOIN pg_class owner ON owner.reltoastrelid = c.oid
        WHERE (c.relkind IN ('r', 'i') AND c.relnamespace = 'public'::regnamespace)
           OR (c.relkind = 't' AND owner.relnamespace = 'public'::regnamespace)),
    sized AS (
        SELECT coalesce(i.inhparent, there.of)::regclass::TEXT || CASE relkind WHEN 't' THEN ' (long values)' ELSE '' END AS name,
               CASE relkind WHEN 't' THEN pg_total_relation_size(oid) ELSE pg_table_size(oid) - coalesce(
                   (SELECT pg_total_relation_size(nullif(reltoastrelid, 0)) FROM pg_class WHERE oid = there.oid), 0) END AS bytes
        FROM there LEFT JOIN pg_inherits i ON i.inhrelid = there.of),
    named AS (SELECT name, SUM(bytes)::BIGINT AS bytes FROM sized GROUP BY name)
    SELECT name, bytes FROM named
    UNION ALL SELECT 'the catalogue', pg_database_size(current_database()) - SUM(bytes)::BIGINT FROM named
    ORDER BY 2 DESC";

struct Database {
    address: String,
    server: PgConnection,
    /// The process whose children are the sessions.
    postmaster: u32,
}

impl Ours {
    pub(crate) async fn start(engine: Engine) -> Self {
        let dir = tempfile::tempdir().expect("a directory");
        let (database, url) = match engine {
            Engine::Sqlite => (None, None),
            Engine::Postgres => {
                let (database, url) = Database::make().await;
                (Some(database), Some(url))
            }
        };
        let server = Running::feedwright(dir.path(), url.as_deref()).await;
        Self { server, dir, database }
    }

    /// Processor time so far, s: of the server and, where there is one, of the database's.
    pub(crate) fn cpu_seconds(&self) -> f64 {
        self.server.cpu_seconds() + self.database_seconds()
    }

    /// Processor time so far of the database's server, s.
    pub(crate) fn database_seconds(&self) -> f64 {
        self.database.as_ref().map_or(0.0, |database| seconds_below(database.postmaster))
    }

    /// Waits until both are at rest, and nothing is put off any more. Processor time up to then, s, of both.
    pub(crate) async fn rest(&mut self) -> f64 {
        let look = || (self.cpu_seconds(), data::size_of(self.dir.path()));
        let spent = rest::rest(&self.server.address, look).await;
        let Some(database) = &mut self.database else { return spent };
        // Pages that it would write minutes later.
        let before = seconds_below(database.postmaster);
        database.server.execute("CHECKPOINT").await.expect("a checkpoint");
        spent + seconds_below(database.postmaster) - before
    }

    /// Bytes of the blocks and of every table and index, largest first, after the server has ended.
    pub(crate) async fn taken(self) -> (i64, Vec<Taken>) {
        self.server.stop().await;
        match self.database {
            None => {
                let file = self.dir.path().join("feedwright.sqlite3");
                let file = SqliteConnectOptions::new().filename(file).read_only(true);
                let mut conn = file.connect().await.expect("the file");
                let taken: Vec<(String, i64, i64)> = sqlx::query_as(
                    "SELECT name, SUM(pgsize), SUM(unused) FROM dbstat GROUP BY name ORDER BY SUM(pgsize) DESC",
                )
                .fetch_all(&mut conn)
                .await
                .expect("pages by table");
                let blocks = sqlx::query_scalar("SELECT SUM(bytes) FROM cycle_samples");
                let blocks = blocks.fetch_one(&mut conn).await.expect("blocks");
                let taken = taken.into_iter().map(|(name, bytes, empty)| Taken { name, bytes, empty });
                (blocks, taken.collect())
            }
            Some(database) => database.taken().await,
        }
    }

    /// Bytes that are kept after the server has ended. Of a database without its log, which is reused.
    pub(crate) async fn end(self) -> u64 {
        self.server.stop().await;
        match self.database {
            None => data::size_of(self.dir.path()),
            Some(database) => database.remove().await,
        }
    }
}

impl Database {
    /// An empty one, and its address.
    async fn make() -> (Self, String) {
        let address = std::env::var("FEEDWRIGHT_TEST_POSTGRES").expect("behind tests/postgres");
        let mut server = PgConnection::connect(&address).await.expect("the server of tests/postgres");
        for statement in [format!("DROP DATABASE IF EXISTS {NAME}"), format!("CREATE DATABASE {NAME}")] {
            server.execute(AssertSqlSafe(statement)).await.expect("a fresh database");
        }
        let postmaster = postmaster_of(&mut server).await;
        let (before, _) = address.rsplit_once('/').expect("a database");
        let address = format!("{before}/{NAME}");
        (Self { address: address.clone(), server, postmaster }, address)
    }

    /// What each table and index takes, and how much less it takes when it is written anew.
    async fn taken(self) -> (i64, Vec<Taken>) {
        let mut conn = PgConnection::connect(&self.address).await.expect("the database");
        let as_it_is: Vec<(String, i64)> = sqlx::query_as(TAKEN).fetch_all(&mut conn).await.expect("sizes");
        let blocks = sqlx::query_scalar("SELECT SUM(length(block))::BIGINT FROM cycle_samples");
        let blocks = blocks.fetch_one(&mut conn).await.expect("blocks");
        conn.execute("VACUUM FULL").await.expect("written anew");
        let anew: Vec<(String, i64)> = sqlx::query_as(TAKEN).fetch_all(&mut conn).await.expect("sizes");
        conn.close().await.expect("an end");
        self.remove().await;
        let left = |name: &str| anew.iter().find(|(other, _)| other == name).map_or(0, |(_, bytes)| *bytes);
        let taken =
            as_it_is.into_iter().map(|(name, bytes)| Taken { empty: bytes - left(&name), name, bytes });
        (blocks, taken.collect())
    }

    /// Removes it; says how many bytes it had.
    async fn remove(mut self) -> u64 {
        let bytes: i64 = sqlx::query_scalar("SELECT pg_database_size($1)")
            .bind(NAME)
            .fetch_one(&mut self.server)
            .await
            .expect("a size");
        let statement = AssertSqlSafe(format!("DROP DATABASE {NAME}"));
        self.server.execute(statement).await.expect("nobody uses it");
        u64::try_from(bytes).expect("a size")
    }
}

/// The process whose children are the sessions of a PostgreSQL server on this machine.
pub(crate) async fn postmaster_of(server: &mut PgConnection) -> u32 {
    let session: i32 =
        sqlx::query_scalar("SELECT pg_backend_pid()").fetch_one(server).await.expect("a session");
    let session = u32::try_from(session).expect("a process");
    stat_of(session).expect("a process of this machine").parent
}

/// What the system says of a process.
struct Stat {
    parent: u32,
    /// Ticks of the process itself, and of its children that have ended.
    own: f64,
    ended: f64,
}

fn stat_of(process: u32) -> Option<Stat> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    let fields: Vec<&str> = stat.rsplit_once(") ")?.1.split(' ').collect();
    let ticks = |at: usize| fields.get(at)?.parse::<f64>().ok();
    Some(Stat {
        parent: fields.get(1)?.parse().ok()?,
        own: ticks(11)? + ticks(12)?,
        ended: ticks(13)? + ticks(14)?,
    })
}

/// Processor time of a process and its children, those that have ended included, s.
pub(crate) fn seconds_below(process: u32) -> f64 {
    let root = stat_of(process).expect("it runs");
    let all = std::fs::read_dir("/proc").expect("processes").flatten();
    let children = all.filter_map(|entry| stat_of(entry.file_name().to_str()?.parse().ok()?));
    let theirs: f64 = children.filter(|stat| stat.parent == process).map(|stat| stat.own).sum();
    (root.own + root.ended + theirs) / super::process::TICKS
}

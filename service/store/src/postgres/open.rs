//! Opening: limits, settings that durability rests on, migrations.

use super::address::unreadable_file;
use super::{Conn, Inner, PostgresStore, dialect, plant};
use crate::error::{StoreError, StoreResult};
use crate::gate::Gate;
use crate::lanes::Lanes;
use crate::locks::Locks;
use crate::slot::Slot;
use crate::transfer::unfinished;
use sqlx::migrate::{Migration, Migrator};
use sqlx::postgres::{PgConnectOptions, PgConnection, PgPoolOptions, PgRow};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, Row, SqlSafeStr};
use std::io::ErrorKind;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize};
use std::time::Duration;
use tokio::sync::{Mutex, Semaphore};
use tokio::time::timeout;

/// Asks whether a table is in the schema of these tables: another plant may have one of that name in another schema.
macro_rules! is_here {
    ($($table:tt)*) => {
        concat!(
            "SELECT EXISTS (SELECT FROM pg_class
             WHERE relname = '",
            $($table)*,
            "' AND relnamespace = quote_ident(current_schema())::REGNAMESPACE)"
        )
    };
}

/// Whether a transfer into the database has not come to its end.
pub(crate) const IS_UNFINISHED: &str = is_here!(unfinished!());
const HAS_TABLES: &str = is_here!("registry_generation");

pub(crate) static MIGRATIONS: Migrator = sqlx::migrate!("../../migrations/postgres");

/// Whose clock tells what all servers on a database have to agree on: when a lease ends, how long a machine is silent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CommonClock {
    /// The database's.
    #[default]
    Database,
    /// Whoever asks brings the time: stories, which set it.
    Callers,
}

/// How a PostgreSQL store is run.
#[derive(Debug, Clone)]
pub struct PostgresOptions {
    /// Connections, for writing and reading.
    pub connections: u32,
    /// How long one waits for a connection.
    pub patience: Duration,
    /// How long a group of cycles waits for its transaction, which goes on then. A connection whose server says nothing for so
    /// long leads nowhere, as where a host vanished without closing it. Longer than the server lets a statement take.
    pub lost_after: Duration,
    /// Whether the address is a pooler's: then nothing is set for a whole session.
    pub pooled: bool,
    /// Address of the server itself, for migrations, where the other one is a pooler's.
    pub direct: Option<String>,
    /// Whose clock all servers go by.
    pub clock: CommonClock,
    /// Whether it is opened for a copy into it, which has not begun. Anybody else refuses a database that a copy or a restore writes into:
    /// cycles would be counted on what is moved under them.
    pub for_a_copy: bool,
}

impl Default for PostgresOptions {
    fn default() -> Self {
        Self {
            connections: 8,
            patience: Duration::from_secs(5),
            lost_after: Duration::from_secs(60),
            pooled: false,
            direct: None,
            clock: CommonClock::Database,
            for_a_copy: false,
        }
    }
}

/// Connections that changes leave to reads, where there are so many.
const KEPT_FOR_READS: u32 = 2;

/// Connections that usual and long reads leave to changes, and to what is asked before them: tokens, and what is registered. Where there
/// are few, half of them; and of all of them long reads have a quarter at the most.
const KEPT_FROM_READS: u32 = 3;

/// A database that is distributed has had the migrations up to this one: of one distributed before, a copy is made (`deploy/citus/README.md`).
const DISTRIBUTED_SINCE: i64 = 20;

/// Whether Citus has distributed a table by now.
async fn is_distributed(conn: &mut PgConnection) -> StoreResult<bool> {
    let has_list: bool = sqlx::query_scalar("SELECT to_regclass('pg_dist_partition') IS NOT NULL")
        .fetch_one(&mut *conn)
        .await?;
    if !has_list {
        return Ok(false);
    }
    Ok(sqlx::query_scalar("SELECT EXISTS (SELECT FROM pg_dist_partition)").fetch_one(&mut *conn).await?)
}

/// The same migrations as Citus takes them of distributed tables. It sends a change of a table on to its workers with the whole text that
/// it came in, and refuses one of several statements ("cannot execute multiple utility events"); within a block each statement is
/// a text of its own. What is known of a migration is known by its file, as ever.
fn statement_by_statement(migrations: &Migrator) -> Migrator {
    let as_block = |migration: &Migration| {
        let mut migration = migration.clone();
        // One that changes nothing asks for something, which a block has no place for.
        let changes = ["ALTER ", "CREATE ", "DROP "].iter().any(|word| migration.sql.as_str().contains(word));
        if migration.version > DISTRIBUTED_SINCE && changes {
            let block = format!("DO $migration$ BEGIN\n{}\nEND $migration$", migration.sql.as_str());
            migration.sql = AssertSqlSafe(block).into_sql_str();
        }
        migration
    };
    Migrator::with_migrations(migrations.iter().map(as_block).collect())
}

pub(super) const NOT_USABLE: &str = "the server is in recovery, read-only, or does not commit durably";

impl PostgresStore {
    /// Connects to the database at `url`, refuses one that cannot be written durably, and migrates it under a lock.
    pub async fn open(url: &str, options: PostgresOptions) -> StoreResult<Self> {
        let direct: PgConnectOptions = options.direct.as_deref().unwrap_or(url).parse()?;
        let first = async {
            let mut first = direct.clone().application_name("feedwright migrations").connect().await?;
            assert_durable(&mut first).await?;
            assert_encoding(&mut first).await?;
            assert_one_schema(&mut first).await?;
            Ok::<_, StoreError>(first)
        };
        // Whoever starts servers finds out that an address leads nowhere, as behind a firewall.
        let mut migrating = match timeout(options.lost_after, first).await {
            Ok(first) => first.map_err(|error| of_a_file(options.direct.as_deref().unwrap_or(url), error))?,
            Err(_) => return Err(StoreError::Unavailable("the database says nothing".into())),
        };
        // Limits that a role has for questions are none for writing tables anew, and for waiting until another server has done so.
        sqlx::raw_sql("SET statement_timeout = 0; SET lock_timeout = 0").execute(&mut migrating).await?;
        // Takes an advisory lock of its session: servers that start together migrate once.
        // Tables that a copy writes are that copy's: brought up to this version they would be none of its.
        if !options.for_a_copy && sqlx::query_scalar(HAS_TABLES).fetch_one(&mut migrating).await? {
            assert_whole(&mut migrating).await?;
        }
        let migrated = if is_distributed(&mut migrating).await? {
            statement_by_statement(&MIGRATIONS).run(&mut migrating).await
        } else {
            MIGRATIONS.run(&mut migrating).await
        };
        migrated.map_err(StoreError::of_migration)?;
        if !options.for_a_copy {
            assert_whole(&mut migrating).await?;
        }
        let direct_database = database_of(&mut migrating).await?;
        migrating.close().await?;

        let mut connect: PgConnectOptions = url.parse()?;
        connect = connect.application_name("feedwright");
        if options.pooled {
            // A statement that is remembered would be looked for on a server that never saw it.
            connect = connect.statement_cache_capacity(0);
        } else {
            connect = connect.statement_cache_capacity(200);
            // Reads outside a transaction. A pooler would refuse these or pass them on to other clients.
            connect = connect.options([
                ("statement_timeout", "30s"),
                ("idle_in_transaction_session_timeout", "30s"),
                ("row_security", "off"),
            ]);
        }
        let pooled = options.pooled;
        // One that leads nowhere leaves time for another.
        let asked_for = options.patience / 2;
        let pool = PgPoolOptions::new()
            .max_connections(options.connections.max(1))
            .acquire_timeout(options.patience)
            // The check below is a ping as well.
            .test_before_acquire(false)
            .before_acquire(move |conn, _| {
                Box::pin(async move { timeout(asked_for, usable(conn)).await.unwrap_or(Ok(false)) })
            })
            // A server that was demoted, is not promoted yet, or does not keep what is committed, is asked again until patience ends.
            .after_connect(|conn, _| {
                Box::pin(async move {
                    if usable(conn).await? {
                        return Ok(());
                    }
                    Err(sqlx::Error::Protocol(NOT_USABLE.to_owned()))
                })
            })
            .connect_with(connect)
            .await
            .map_err(|error| if pooled { of_a_file(url, error.into()) } else { of_a_pooler(error) })?;
        // In a transaction, as a pooler bears it.
        let inner = Inner {
            pool,
            direct,
            lent: Arc::default(),
            gate: Gate::default(),
            lost_after: options.lost_after,
            asking: Mutex::default(),
            lanes: Lanes::of(
                options.connections.saturating_sub(KEPT_FROM_READS).max(options.connections / 2),
                options.connections / 4,
                options.patience,
            ),
            changing: Semaphore::new(options.connections.saturating_sub(KEPT_FOR_READS).max(1) as usize),
            warm: std::sync::Mutex::default(),
            given_up: AtomicUsize::new(0),
            full_since: std::sync::Mutex::default(),
            pooled,
            clock: options.clock,
            registry: Arc::default(),
            memory: Slot::default(),
            dropping: Slot::default(),
            postponed: Arc::default(),
            changes_of_alarms: AtomicU64::new(0),
        };
        let mut lent = inner.lent().await?;
        let mut transaction = lent.begin_with(inner.begin()).await?;
        assert_durable(&mut transaction).await?;
        assert_owner(&mut transaction).await?;
        assert_all_rows(&mut transaction).await?;
        if database_of(&mut transaction).await? != direct_database {
            return Err(StoreError::NotWritable(
                "database.direct_url leads to another database, or other tables of it, than database.url: nothing was stored".into(),
            ));
        }
        transaction.rollback().await?;
        lent.settle();
        Ok(Self { inner: Arc::new(inner) })
    }
}

/// Refuses a database that a copy or a restore is writing into: it holds its lock until everything is there.
async fn assert_whole(conn: &mut PgConnection) -> StoreResult<()> {
    let subject = Locks::subject("transfer", &plant(&mut *conn).await?);
    // Let go of when this connection is closed.
    let is_whole: bool = sqlx::query_scalar("SELECT pg_try_advisory_lock_shared($1)")
        .bind(subject.exclusive.first())
        .fetch_one(&mut *conn)
        .await?;
    if !is_whole {
        return Err(StoreError::NotWritable(
            "a copy or a restore writes into the database: start when it has ended".into(),
        ));
    }
    if sqlx::query_scalar(IS_UNFINISHED).fetch_one(&mut *conn).await? {
        return Err(StoreError::of_unfinished_transfer());
    }
    Ok(())
}

/// What changes rest on. Decisions are read from the primary alone, so a demoted server answers nothing.
macro_rules! good {
    () => {
        "NOT pg_is_in_recovery() AND current_setting('transaction_read_only') = 'off' AS writable,
         current_setting('synchronous_commit') IN ('on', 'remote_apply') AND current_setting('fsync') = 'on' AS durable"
    };
}

/// Asks for [`is_good`], and which of the server's processes answers.
pub(super) const GOOD: &str = concat!("SELECT pg_backend_pid() AS process, ", good!());

/// Whether the server that has answered takes writes and keeps them; where not, why is logged.
pub(super) fn is_good(row: &PgRow) -> Result<bool, sqlx::Error> {
    let (writable, durable): (bool, bool) = (row.try_get("writable")?, row.try_get("durable")?);
    if !writable {
        tracing::warn!("a connection to a server that is in recovery or read-only is closed");
    }
    if !durable {
        tracing::error!("a connection is closed: synchronous_commit or fsync was turned off on the server");
    }
    Ok(writable && durable)
}

/// Whether a connection is good for work: outside of any transaction, on a server that takes writes and keeps them.
///
/// sqlx 0.9.0 may return a connection inside a transaction, whose begin was dropped half-way (sqlx issues 4385 and
/// 4393). Inside a transaction `now()` is the time of its begin; inside a failed one the question itself fails, and
/// the connection goes as well.
pub(super) async fn usable(conn: &mut Conn) -> Result<bool, sqlx::Error> {
    const ASK: &str = concat!("SELECT now() = statement_timestamp() AS outside, ", good!());
    // One message: with several of them the time of the statement is that of the last and always later than `now()`,
    // and outside of a transaction a pooler hands each of them round to another server.
    let row = sqlx::raw_sql(ASK).fetch_one(&mut *conn).await?;
    let outside: bool = row.try_get("outside")?;
    if !outside {
        tracing::error!("a connection came back inside an open transaction and is closed");
    }
    Ok(is_good(&row)? && outside)
}

/// What an address is told that nobody connects by, as a file that it names cannot be read. Whether it is read, address and server decide.
fn of_a_file(url: &str, error: StoreError) -> StoreError {
    let StoreError::Unavailable(source) = &error else { return error };
    let Some(sqlx::Error::Io(cause)) = source.downcast_ref() else { return error };
    let is_of_a_file = matches!(cause.kind(), ErrorKind::NotFound | ErrorKind::PermissionDenied);
    match unreadable_file(url).filter(|_| is_of_a_file) {
        Some(why) => StoreError::Unavailable(why.into()),
        None => error,
    }
}

/// What an address is told that may be a pooler's, which takes no settings of a session and hands statements round to servers that did not
/// prepare them (SQLSTATE 08P01, 42P05 and 26000).
fn of_a_pooler(error: sqlx::Error) -> StoreError {
    let code = error.as_database_error().and_then(sqlx::error::DatabaseError::code);
    if !matches!(code.as_deref(), Some("08P01" | "42P05" | "26000")) {
        return error.into();
    }
    let hint = "where database.url is a pooler's, set database.pooled = true and database.direct_url to the server itself";
    StoreError::NotWritable(format!("{error}; {hint}").into())
}

/// Partitions are made and dropped by who owns their table: a role that may only write would have none after a year.
async fn assert_owner(conn: &mut Conn) -> StoreResult<()> {
    const ASK: &str =
        "SELECT pg_has_role(relowner, 'USAGE'), current_user::TEXT, relowner::REGROLE::TEXT FROM pg_class
                       WHERE oid = 'cycle_samples'::REGCLASS";
    let (owns, role, owner): (bool, String, String) = sqlx::query_as(ASK).fetch_one(&mut *conn).await?;
    if owns {
        return Ok(());
    }
    let detail = format!(
        "the role {role} has to own the tables, which are those of {owner}: REASSIGN OWNED BY {owner} TO {role}"
    );
    Err(StoreError::NotWritable(detail.into()))
}

/// Rows that are hidden from the service's role would be cycles that it neither counts nor saves.
async fn assert_all_rows(conn: &mut Conn) -> StoreResult<()> {
    const ASK: &str = "SELECT relname::TEXT FROM pg_class
                       WHERE relrowsecurity AND row_security_active(oid)
                           AND relnamespace = (SELECT relnamespace FROM pg_class WHERE oid = 'cycle_samples'::REGCLASS)
                       ORDER BY relname";
    let mut hidden: Vec<String> = sqlx::query_scalar(ASK).fetch_all(&mut *conn).await?;
    hidden.retain(|table| dialect::is_ours(table));
    if hidden.is_empty() {
        return Ok(());
    }
    let detail = format!(
        "row security hides rows of {} from the role: ALTER TABLE … NO FORCE ROW LEVEL SECURITY, or a role that bypasses it",
        hidden.join(", ")
    );
    Err(StoreError::NotWritable(detail.into()))
}

/// Names and reasons are in any language. SQL_ASCII keeps what it is given.
async fn assert_encoding(conn: &mut Conn) -> StoreResult<()> {
    let found: String = sqlx::query_scalar("SHOW server_encoding").fetch_one(&mut *conn).await?;
    if matches!(found.as_str(), "UTF8" | "SQL_ASCII") {
        return Ok(());
    }
    let detail = format!("needs a database in UTF8, this one is in {found}; nothing was changed");
    Err(StoreError::NotWritable(detail.into()))
}

/// Which database of which server is asked, and which tables of it: those of which schema the search path finds. Each start of a server
/// is another one.
async fn database_of(conn: &mut Conn) -> StoreResult<(i64, i64, i64)> {
    let sql = concat!(
        "SELECT oid::BIGINT, ",
        dialect::server!(),
        ", COALESCE(to_regclass('registry_generation')::OID::BIGINT, 0) FROM pg_database WHERE datname = current_database()"
    );
    Ok(sqlx::query_as(sql).fetch_one(&mut *conn).await?)
}

/// Tables made in another schema than those that are there would be an empty database beside a full one: as where a schema of the
/// role's own name was made, which comes first in a search path that nobody set.
async fn assert_one_schema(conn: &mut Conn) -> StoreResult<()> {
    let found: Option<(String, String)> = sqlx::query_as(
        "SELECT n.nspname::TEXT, current_schema()::TEXT
         FROM pg_class c JOIN pg_namespace n ON n.oid = c.relnamespace
         WHERE c.relname = '_sqlx_migrations' AND n.nspname = ANY(current_schemas(FALSE))
             AND EXISTS (SELECT 1 FROM pg_class ours WHERE ours.relnamespace = n.oid AND ours.relname = 'cycle_samples')
             AND NOT EXISTS (SELECT 1 FROM pg_class o JOIN pg_namespace first ON first.oid = o.relnamespace
                             WHERE o.relname = '_sqlx_migrations' AND first.nspname = current_schema())
         LIMIT 1",
    )
    .fetch_optional(&mut *conn)
    .await?;
    let Some((there, first)) = found else { return Ok(()) };
    let detail = format!(
        "the tables are in the schema {there}, and {first} comes before it in the search path: set `search_path`, or remove \
         {first}; nothing was changed"
    );
    Err(StoreError::NotWritable(detail.into()))
}

/// Acknowledging rests on these. A demoted server is refused here; one that is demoted later refuses each write.
async fn assert_durable(conn: &mut Conn) -> StoreResult<()> {
    let (recovering, read_only, synchronous, fsync): (bool, String, String, String) = sqlx::query_as(
        "SELECT pg_is_in_recovery(), current_setting('transaction_read_only'),
                current_setting('synchronous_commit'), current_setting('fsync')",
    )
    .fetch_one(&mut *conn)
    .await?;
    if recovering || read_only != "off" {
        return Err(StoreError::NotWritable("the server is in recovery or read-only".into()));
    }
    if !matches!(synchronous.as_str(), "on" | "remote_apply") || fsync != "on" {
        let found = format!("needs synchronous_commit on and fsync on, has {synchronous} and {fsync}");
        return Err(StoreError::NotWritable(found.into()));
    }
    Ok(())
}

//! Opening: limits, settings that durability rests on, migrations.

use super::{Conn, Inner, PostgresStore};
use crate::error::{StoreError, StoreResult};
use crate::gate::Gate;
use crate::slot::Slot;
use feedwright_core::cycle::DEFAULT_MAX_SAMPLES;
use sqlx::postgres::{PgConnectOptions, PgPoolOptions};
use sqlx::{ConnectOptions, Connection};
use std::sync::Arc;
use std::time::Duration;

static MIGRATIONS: sqlx::migrate::Migrator = sqlx::migrate!("../../migrations/postgres");

/// How a PostgreSQL store is run.
#[derive(Debug, Clone)]
pub struct PostgresOptions {
    /// Connections, for writing and reading.
    pub connections: u32,
    /// How long one waits for a connection.
    pub patience: Duration,
    /// Samples that one cycle may hold when it is read.
    pub max_samples: usize,
    /// Whether the address is a pooler's: then nothing is set for a whole session.
    pub pooled: bool,
    /// Address of the server itself, for migrations, where the other one is a pooler's.
    pub direct: Option<String>,
}

impl Default for PostgresOptions {
    fn default() -> Self {
        Self {
            connections: 8,
            patience: Duration::from_secs(5),
            max_samples: DEFAULT_MAX_SAMPLES,
            pooled: false,
            direct: None,
        }
    }
}

impl PostgresStore {
    /// Connects to the database at `url`, refuses one that cannot be written durably, and migrates it under a lock.
    pub async fn open(url: &str, options: PostgresOptions) -> StoreResult<Self> {
        let direct: PgConnectOptions = options.direct.as_deref().unwrap_or(url).parse()?;
        let mut migrating = direct.clone().application_name("feedwright migrations").connect().await?;
        assert_durable(&mut migrating).await?;
        // Takes an advisory lock of its session: servers that start together migrate once.
        MIGRATIONS.run(&mut migrating).await.map_err(|error| StoreError::Database(Box::new(error)))?;
        migrating.close().await?;

        let mut connect: PgConnectOptions = url.parse()?;
        connect = connect.application_name("feedwright").statement_cache_capacity(200);
        if !options.pooled {
            // Reads outside a transaction. A pooler would refuse these or pass them on to other clients.
            connect = connect
                .options([("statement_timeout", "30s"), ("idle_in_transaction_session_timeout", "30s")]);
        }
        let pool = PgPoolOptions::new()
            .max_connections(options.connections.max(1))
            .acquire_timeout(options.patience)
            // The check below is a ping as well.
            .test_before_acquire(false)
            .before_acquire(|conn, _| Box::pin(outside_transaction(conn)))
            .connect_with(connect)
            .await?;
        let mut conn = pool.acquire().await?;
        assert_durable(&mut conn).await?;
        drop(conn);
        let inner = Inner {
            pool,
            direct,
            gate: Gate::default(),
            max_samples: options.max_samples,
            registry: Arc::default(),
            memory: Slot::default(),
        };
        Ok(Self { inner: Arc::new(inner) })
    }
}

/// Whether a connection from the pool is outside of any transaction. sqlx 0.9.0 may return one inside: whose begin was
/// dropped half-way (sqlx issues 4385 and 4393). Inside a transaction `now()` is the time of its begin; inside a
/// failed one the question itself fails, and the connection goes as well.
async fn outside_transaction(conn: &mut Conn) -> Result<bool, sqlx::Error> {
    let outside: bool =
        sqlx::query_scalar("SELECT now() = statement_timestamp()").fetch_one(&mut *conn).await?;
    if !outside {
        tracing::error!("a connection came back inside an open transaction and is closed");
    }
    Ok(outside)
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

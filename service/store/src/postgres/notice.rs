//! LISTEN and NOTIFY.

use super::PostgresStore;
use crate::error::{StoreError, StoreResult};
use crate::notice::{Listener, Notices};
use async_trait::async_trait;
use sqlx::postgres::{PgConnectOptions, PgConnection, PgListener, PgPoolOptions};
use sqlx::{Connection, Executor};
use std::time::Duration;
use tokio::time::error::Elapsed;
use tokio::time::timeout;

/// Behind the name of what belongs to one plant's tables: several may share a database, each in a schema, and channels are the database's.
/// Empty for those in `public`.
macro_rules! plant {
    () => {
        "SELECT CASE n.nspname WHEN 'public' THEN '' ELSE '_' || n.oid END
         FROM pg_class t JOIN pg_namespace n ON n.oid = t.relnamespace WHERE t.oid = to_regclass('registry_generation')"
    };
}

const CHANNEL: &str = "feedwright_live";

/// What sessions are called in which servers listen, with [`plant`] behind it: each has one as long as it runs.
pub(crate) const LIVE: &str = "feedwright live";

/// What tells the tables that a connection finds from those of another schema of the database.
pub(crate) async fn plant(conn: &mut PgConnection) -> Result<String, sqlx::Error> {
    Ok(sqlx::query_scalar(plant!()).fetch_optional(conn).await?.unwrap_or_default())
}

impl PostgresStore {
    /// Tells every listener; outside of any transaction that changes something.
    pub(super) async fn tell(&self, text: &str) -> StoreResult<()> {
        let mut lent = self.inner.lent().await?;
        let asked = async {
            const TELL: &str = concat!("SELECT pg_notify($1 || COALESCE((", plant!(), "), ''), $2)");
            let notify = sqlx::query(TELL).bind(CHANNEL).bind(text);
            if !self.inner.pooled {
                notify.execute(&mut *lent).await?;
                return Ok(());
            }
            // Behind a pooler only a transaction keeps the messages of a statement together.
            let mut transaction = lent.begin_with(self.inner.begin()).await?;
            notify.execute(&mut *transaction).await?;
            transaction.commit().await?;
            Ok(())
        };
        self.in_time(asked).await
    }
}

/// Where to listen.
pub(super) struct Direct {
    pub(super) connect: PgConnectOptions,
    /// Where nothing was heard for this long, the server is asked whether it is there, and has as long for its answer.
    pub(super) beat: Duration,
}

struct Listening {
    listener: PgListener,
    beat: Duration,
}

const CLOSED: &str = "the database has closed the connection of who listens";

fn silent(_: Elapsed) -> StoreError {
    StoreError::Unavailable("the database says nothing to who listens".into())
}

#[async_trait]
impl Notices for Direct {
    async fn listen(&self) -> StoreResult<Box<dyn Listener>> {
        let connect = self.connect.clone().application_name(LIVE);
        let listening = async {
            let pool = PgPoolOptions::new().max_connections(1).connect_with(connect).await?;
            let plant = plant(&mut *pool.acquire().await?).await?;
            let mut listener = PgListener::connect_with(&pool).await?;
            // A limit that a role has for people who do nothing would be shorter than the beat.
            listener.execute("SET idle_session_timeout = 0").await?;
            if !plant.is_empty() {
                let named = format!("SET application_name = '{LIVE}{plant}'");
                listener.execute(sqlx::AssertSqlSafe(named)).await?;
            }
            // Who listens again is told that something was missed: not by chance, within a call that may be dropped.
            listener.eager_reconnect(false);
            listener.listen(&format!("{CHANNEL}{plant}")).await?;
            Ok::<_, StoreError>(listener)
        };
        let listener = timeout(self.beat, listening).await.map_err(silent)??;
        Ok(Box::new(Listening { listener, beat: self.beat }))
    }
}

#[async_trait]
impl Listener for Listening {
    async fn next(&mut self) -> StoreResult<String> {
        loop {
            match timeout(self.beat, self.listener.try_recv()).await {
                Ok(heard) => {
                    let heard = heard?.map(|text| text.payload().to_owned());
                    return heard.ok_or_else(|| StoreError::Unavailable(CLOSED.into()));
                }
                // A host that vanished never says so. What is told meanwhile waits for the next turn.
                Err(_) => {
                    let asked = timeout(self.beat, self.listener.execute("SELECT 1")).await;
                    asked.map_err(silent)??;
                }
            }
        }
    }
}

//! LISTEN and NOTIFY.

use super::PostgresStore;
use crate::error::{StoreError, StoreResult};
use crate::notice::{Listener, Notices};
use async_trait::async_trait;
use sqlx::postgres::{PgConnectOptions, PgListener, PgPoolOptions};
use sqlx::{Connection, Executor};
use std::time::Duration;
use tokio::time::error::Elapsed;
use tokio::time::timeout;

const CHANNEL: &str = "feedwright_live";

/// What sessions are called in which servers listen: each has one as long as it runs.
pub(crate) const LIVE: &str = "feedwright live";

impl PostgresStore {
    /// Tells every listener; outside of any transaction that changes something.
    pub(super) async fn tell(&self, text: &str) -> StoreResult<()> {
        let mut lent = self.inner.lent().await?;
        let asked = async {
            let notify = sqlx::query("SELECT pg_notify($1, $2)").bind(CHANNEL).bind(text);
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
            let mut listener = PgListener::connect_with(&pool).await?;
            // Who listens again is told that something was missed: not by chance, within a call that may be dropped.
            listener.eager_reconnect(false);
            listener.listen(CHANNEL).await?;
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

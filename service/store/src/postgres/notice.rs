//! LISTEN and NOTIFY.

use super::PostgresStore;
use crate::error::StoreResult;
use crate::notice::{Listener, Notice, Notices};
use async_trait::async_trait;
use sqlx::postgres::{PgConnectOptions, PgListener, PgPoolOptions};

const CHANNEL: &str = "feedwright_live";

impl PostgresStore {
    /// Tells every listener; outside of any transaction that changes something.
    pub(super) async fn tell(&self, text: &str) -> StoreResult<()> {
        let notify = sqlx::query("SELECT pg_notify($1, $2)").bind(CHANNEL).bind(text);
        if !self.inner.pooled {
            notify.execute(&self.inner.pool).await?;
            return Ok(());
        }
        // Behind a pooler only a transaction keeps the messages of a statement together.
        let mut transaction = self.inner.begin().await?;
        notify.execute(&mut *transaction).await?;
        transaction.commit().await?;
        Ok(())
    }
}

/// Where to listen.
pub(super) struct Direct(pub(super) PgConnectOptions);

struct Listening(PgListener);

#[async_trait]
impl Notices for Direct {
    async fn listen(&self) -> StoreResult<Box<dyn Listener>> {
        let connect = self.0.clone().application_name("feedwright live");
        let pool = PgPoolOptions::new().max_connections(1).connect_with(connect).await?;
        let mut listener = PgListener::connect_with(&pool).await?;
        listener.listen(CHANNEL).await?;
        Ok(Box::new(Listening(listener)))
    }
}

#[async_trait]
impl Listener for Listening {
    async fn next(&mut self) -> StoreResult<Notice> {
        // `None` tells that the connection was lost; the next call makes it anew.
        Ok(match self.0.try_recv().await? {
            Some(notification) => Notice::Text(notification.payload().to_owned()),
            None => Notice::Missed,
        })
    }
}

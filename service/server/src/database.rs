//! Opening the database that the configuration names.

use crate::clock::Clock;
use crate::config::{Config, Engine};
use crate::data_dir::{DataDirError, DataDirLock};
use feedwright_store::{PostgresOptions, PostgresStore, SqliteOptions, SqliteStore, Store, StoreError};
use secrecy::ExposeSecret;
use std::path::PathBuf;
use std::sync::Arc;

/// A store that is open, with what has to be held as long as it is.
pub struct Database {
    /// The store.
    pub store: Arc<dyn Store>,
    /// The lock on the data directory; PostgreSQL needs none, since several servers may share it.
    pub lock: Option<DataDirLock>,
}

/// Why the database is not opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The data directory cannot be used.
    #[error(transparent)]
    DataDir(#[from] DataDirError),
    /// SQLite's file does not open.
    #[error("cannot open the database {}", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// Why.
        #[source]
        why: StoreError,
    },
    /// PostgreSQL's database does not open.
    #[error("cannot open the database")]
    Store(#[from] StoreError),
}

/// Address of the PostgreSQL server itself: a session of its own passes by a pooler.
pub fn server_url(config: &Config) -> String {
    let direct = config.database.direct_url.expose_secret();
    if direct.is_empty() { config.database.url.expose_secret().to_owned() } else { direct.to_owned() }
}

/// Opens the database, making and migrating it where that is needed.
pub async fn open(config: &Config) -> Result<Database, OpenError> {
    match config.engine() {
        Engine::Sqlite(path) => {
            let lock = DataDirLock::acquire(&config.data_dir)?;
            let options = SqliteOptions {
                // The file lies in the directory that is locked.
                alone: true,
                ..SqliteOptions::default()
            };
            let opened = SqliteStore::open(&path, options).await;
            let store = Arc::new(opened.map_err(|why| OpenError::File { file: path, why })?);
            Ok(Database { store, lock: Some(lock) })
        }
        Engine::Postgres(url) => {
            let direct = config.database.direct_url.expose_secret();
            let options = PostgresOptions {
                connections: config.database.connections,
                pooled: config.database.pooled,
                direct: (!direct.is_empty()).then(|| direct.to_owned()),
                ..PostgresOptions::default()
            };
            let store = Arc::new(PostgresStore::open(url.expose_secret(), options).await?);
            match store.make_room(Clock::system().now()).await {
                // Somebody reads, or no standby confirms; retention makes them.
                Err(StoreError::Unavailable(why) | StoreError::OutcomeUnknown(why)) => {
                    tracing::warn!(%why, "partitions for the months ahead are made later");
                }
                outcome => outcome?,
            }
            Ok(Database { store, lock: None })
        }
    }
}

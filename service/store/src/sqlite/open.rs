//! Opening: permission, settings that durability rests on, migrations.

use super::block_reader::BlockReader;
use super::checkpoint::Checkpoints;
use super::files::{Files, Identity, by_name, log_left};
use super::group_writer::GroupWriter;
use super::readers::Readers;
use super::writing::{Writer, Writing};
use super::{Conn, Inner, SqliteStore};
use crate::durable::sync_name;
use crate::error::{StoreError, StoreResult};
use crate::gate::Gate;
use crate::lanes::Lanes;
use crate::slot::Slot;
use crate::transfer::unfinished;
use sqlx::sqlite::{
    SqliteAutoVacuum, SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous,
};
use sqlx::{ConnectOptions, Connection};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;

/// Whether a file has a list of its migrations, and the list.
pub(crate) const HAS_MIGRATIONS: &str =
    "SELECT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = '_sqlx_migrations')";
pub(crate) const APPLIED: &str = "SELECT version FROM _sqlx_migrations ORDER BY version";
/// Whether a transfer into the file has not come to its end.
pub(crate) const IS_UNFINISHED: &str =
    concat!("SELECT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = '", unfinished!(), "')");

pub(crate) static MIGRATIONS: sqlx::migrate::Migrator = sqlx::migrate!("../../migrations/sqlite");

/// A checkpoint that restarts the log holds up the writer while it waits for readers: no longer than this.
const CHECKPOINT_PATIENCE: Duration = Duration::from_millis(20);

/// A page of new files, bytes. A commit writes whole pages, and most of those that a cycle changes are its machine's own; and what
/// has next to nothing in it has a page. Packs of blocks are cut so that they fill such pages.
const PAGE_BYTES: u32 = 4096;

/// What stays, in bytes, of a log that a long reader or a migration made longer: usually it is begun anew long before,
/// and a small disk has its space back.
const KEPT_WAL_BYTES: &str = "67108864";

/// What every connection is opened with. The checkpoint has a connection of its own: inside the writer it is what the
/// slowest commits wait for.
pub(super) const SETTINGS: [(&str, &str); 6] = [
    ("wal_autocheckpoint", "0"),
    ("journal_size_limit", KEPT_WAL_BYTES),
    ("temp_store", "MEMORY"),
    ("foreign_keys", "ON"),
    ("trusted_schema", "OFF"),
    ("cell_size_check", "ON"),
];

/// What the connection keeps of the file, in KiB below zero, that writes all but whole groups.
const WRITER_CACHE: &str = "-512";

/// What the checkpoint's connection keeps of the file, in KiB below zero: it copies pages, and looks at none.
const CHECKPOINT_CACHE: &str = "-64";

/// What a connection that reads keeps of the file, in KiB below zero. The system keeps the rest, once for all of them.
const READER_CACHE: &str = "-256";

/// How a SQLite store is run.
#[derive(Debug, Clone)]
pub struct SqliteOptions {
    /// Connections that read. One of them is for what posts and streams need before anything else, and half of them are for long
    /// reads at the most.
    pub readers: u32,
    /// How long a connection waits for a lock, and a reader for a connection.
    pub patience: Duration,
    /// Time between two checkpoints.
    pub checkpoint_every: Duration,
    /// Whether somebody answers for it that no other store of this file commits cycles as long as this one is open, as
    /// who holds the lock on the data directory does. Groups then have a journal.
    pub alone: bool,
    /// Groups that come no later than this after one another share a transaction, which is committed so long after the
    /// first of them. As many as have room in the journal come in this time where machines post as fast as they can, and
    /// whoever else writes the file waits no longer.
    pub commit_after: Duration,
    /// Whether it is opened for a copy into it. Anybody else refuses a file into which one broke off.
    pub for_a_copy: bool,
}

impl Default for SqliteOptions {
    fn default() -> Self {
        Self {
            readers: 4,
            patience: Duration::from_secs(5),
            checkpoint_every: Duration::from_millis(250),
            alone: false,
            commit_after: Duration::from_millis(50),
            for_a_copy: false,
        }
    }
}

impl SqliteStore {
    /// Opens the file at `path`, creating it for its owner only, and migrates it.
    pub async fn open(path: impl AsRef<Path>, options: SqliteOptions) -> StoreResult<Self> {
        let path = &*by_name(path.as_ref());
        // Before a migration, its statements being of the tables as they were; and before the file is made, as a journal
        // that is left of one says that it is missing.
        super::take_up(path).await?;
        if let Some(log) = log_left(path) {
            let what = format!(
                "{} is left of a database that is not there any more, and may hold acknowledged cycles: put it back, or move the log \
                 away",
                log.display()
            );
            return Err(StoreError::NotWritable(what.into()));
        }
        // Its name is durable before SQLite makes its log: one that is left without the file is that of a database that is gone.
        create_private(path)
            .and_then(|()| sync_name(path))
            .map_err(|error| StoreError::NotWritable(Box::new(error)))?;
        let found = Identity::of(path)?;
        let connect = settings(path, options.patience);
        // Of a file that is there already it changes nothing, and readers may not ask for it.
        let mut writer = connect.clone().auto_vacuum(SqliteAutoVacuum::Incremental).connect().await?;
        assert_durable(&mut writer).await?;
        if !options.for_a_copy && sqlx::query_scalar(IS_UNFINISHED).fetch_one(&mut writer).await? {
            return Err(StoreError::of_unfinished_transfer());
        }
        MIGRATIONS.run(&mut writer).await.map_err(StoreError::of_migration)?;
        // What a server that was killed between writing a commit and syncing it has left is seen from now on, and may be answered as
        // known: a checkpoint syncs the log first.
        let synced = sqlx::query("PRAGMA wal_checkpoint(PASSIVE)").execute(&mut writer).await;
        match synced {
            Ok(_) => {}
            // The log is synced by then; what is in it finds room in the file later.
            Err(error) if is_full(&error) => {
                tracing::warn!(%error, "the log is not folded into the database's file yet");
            }
            Err(error) => return Err(error.into()),
        }
        let mut groups = GroupWriter::open(path, options.patience)?;
        if options.alone {
            groups.plan_journal(path, options.commit_after);
        }
        let readers = SqlitePoolOptions::new()
            .max_connections(options.readers.max(1))
            .acquire_timeout(options.patience)
            // A file does not hang up: asking each connection whether it is still there costs a hop to its thread.
            .test_before_acquire(false)
            .connect_with(
                connect.clone().read_only(true).create_if_missing(false).pragma("cache_size", READER_CACHE),
            )
            .await?;
        let checkpointer = connect
            .busy_timeout(CHECKPOINT_PATIENCE)
            .pragma("cache_size", CHECKPOINT_CACHE)
            .connect()
            .await?;
        let block_reader = BlockReader::open(path)?;
        // All that write are open: whichever file each of them found is the one that stands there before and after.
        let files = Files::of(path, found)?;
        let writing = Writing::of(Writer::of(groups, writer), files, options.commit_after)?;
        let checkpoints =
            Checkpoints::start(checkpointer, options.checkpoint_every, Arc::downgrade(&writing));
        Ok(Self {
            inner: Arc::new(Inner {
                writing,
                readers: Readers::of(readers),
                lanes: Lanes::of(options.readers.saturating_sub(1), options.readers / 2, options.patience),
                block_reader,
                gate: Gate::default(),
                checkpoints,
                registry: Arc::default(),
                memory: Slot::default(),
                dropping: Slot::default(),
                postponed: Arc::default(),
                changes_of_alarms: AtomicU64::new(0),
                recent: Arc::default(),
                alone: options.alone,
            }),
        })
    }
}

/// Whether a write found no room on the disk (`SQLITE_FULL`).
pub(super) fn is_full(error: &sqlx::Error) -> bool {
    const FULL: i32 = 13;
    let code = error.as_database_error().and_then(sqlx::error::DatabaseError::code);
    code.and_then(|code| code.parse::<i32>().ok()).is_some_and(|code| code & 0xff == FULL)
}

/// Creates the file before SQLite does: its log and shared memory take over its permission.
fn create_private(path: &Path) -> std::io::Result<()> {
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    match options.open(path) {
        Ok(_) => Ok(()),
        // A link is there, and what it leads to may not be yet.
        Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
            options.create_new(false).create(true).open(path).map(|_| ())
        }
        Err(error) => Err(error),
    }
}

fn settings(path: &Path, patience: Duration) -> SqliteConnectOptions {
    let options = SqliteConnectOptions::new()
        .filename(path)
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .busy_timeout(patience)
        .page_size(PAGE_BYTES)
        .statement_cache_capacity(200)
        .pragma("cache_size", WRITER_CACHE);
    SETTINGS.into_iter().fold(options, |options, (name, value)| options.pragma(name, value))
}

/// Acknowledging rests on these two: WAL with `synchronous=NORMAL` loses acknowledged rows in a power cut.
pub(super) fn is_durable(journal: &str, synchronous: i64) -> StoreResult<()> {
    if journal == "wal" && synchronous == 2 {
        return Ok(());
    }
    Err(StoreError::NotWritable(
        format!("needs journal_mode wal and synchronous 2 (full), has {journal} and {synchronous}").into(),
    ))
}

async fn assert_durable(conn: &mut Conn) -> StoreResult<()> {
    let journal: String = sqlx::query_scalar("PRAGMA journal_mode").fetch_one(&mut *conn).await?;
    let synchronous: i64 = sqlx::query_scalar("PRAGMA synchronous").fetch_one(&mut *conn).await?;
    conn.ping().await?;
    is_durable(&journal, synchronous)
}

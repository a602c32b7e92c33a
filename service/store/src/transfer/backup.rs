//! Backups: one SQLite file with a sum of every table in it, of either engine, under load.
//!
//! SQLite makes its own consistent copy (`VACUUM INTO`) beside the writer; of PostgreSQL one snapshot is copied into
//! the same form, so that a backup of either is checked by the same sums and restored into either. What fails is told of the
//! file that it failed with, and leaves nothing half made behind.

use super::copy::{Address, copy_sound, transfer};
use super::digest::of_table;
use super::failure::{file, io, of_backup, of_source, of_target};
use super::postgres::PostgresSide;
use super::sqlite::SqliteSide;
use super::{Side, TableSum, TransferError};
use crate::sqlite::{beside, log_left};
use crate::store::Store;
use crate::{SqliteOptions, SqliteStore};
use feedwright_core::units::Timestamp;
use std::fs::TryLockError;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// What a backup holds.
#[derive(Debug, Clone)]
pub struct BackupReport {
    /// Each table with its sum.
    pub tables: Vec<(String, TableSum)>,
    /// Size of the file, bytes.
    pub bytes: u64,
}

/// The name under which a file is made until it is whole.
fn partial(path: &Path) -> PathBuf {
    beside(path, ".partial")
}

/// An empty file for its owner only.
fn create(path: &Path) -> Result<std::fs::File, TransferError> {
    let made = for_owner().truncate(true).open(path);
    made.map_err(|error| io(path, "cannot be made", &error))
}

fn for_owner() -> std::fs::OpenOptions {
    let mut options = std::fs::OpenOptions::new();
    options.read(true).write(true).create(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options
}

/// How every file of SQLite begins.
const SQLITE: &[u8] = b"SQLite format 3\0";

/// The file that is being made, empty, and nobody else's as long as it is open: two that made the same would take it from
/// under each other. What an interrupted one has left is made anew; what is somebody else's is left alone.
fn claim(making: &Path, to: &Path) -> Result<std::fs::File, TransferError> {
    let unusable = |error| io(making, "cannot be made", &error);
    let busy = || file(to, "is being made by another process; nothing was written");
    let mut claimed = for_owner().truncate(false).open(making).map_err(unusable)?;
    // Not every file system has locks; where there are none, two are not told from each other.
    if let Err(TryLockError::WouldBlock) = claimed.try_lock() {
        return Err(busy());
    }
    // Between opening and locking, the other one may have finished, and given the file its name.
    if !making.exists() || to.exists() {
        return Err(busy());
    }
    let mut head = Vec::new();
    (&mut claimed).take(SQLITE.len() as u64).read_to_end(&mut head).map_err(unusable)?;
    // SQLite writes the first page last: what it has begun is zeros there.
    let is_ours = head.len() < SQLITE.len() || head == SQLITE || head.iter().all(|byte| *byte == 0);
    if !is_ours {
        return Err(file(making, "is in the way, and is nothing that was being made: move it away"));
    }
    discard_beside(making);
    claimed.set_len(0).map_err(unusable)?;
    Ok(claimed)
}

/// Makes a whole file durable under its name.
fn settle(from: &Path, to: &Path) -> Result<u64, TransferError> {
    let synced = std::fs::File::open(from).and_then(|made| {
        made.sync_all()?;
        made.metadata()
    });
    let bytes = synced.map_err(|error| io(to, "cannot be written", &error))?.len();
    // It took its time: a server may have made a database there meanwhile.
    absent(to)?;
    std::fs::rename(from, to).map_err(|error| io(to, "cannot be made", &error))?;
    let folder = to.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let synced = std::fs::File::open(folder).and_then(|folder| folder.sync_all());
    // A folder that may be written and not listed cannot be opened: with all of its file system the name is durable too.
    #[cfg(target_os = "linux")]
    let synced = synced.or_else(|error| match error.kind() {
        std::io::ErrorKind::PermissionDenied => Ok(rustix::fs::syncfs(std::fs::File::open(to)?)?),
        _ => Err(error),
    });
    synced.map_err(|error| io(folder, "cannot be written", &error))?;
    Ok(bytes)
}

/// Neither the file, nor what SQLite would take for the new file's own: the log of one that was there before would be
/// written over it when it is opened next.
fn absent(path: &Path) -> Result<(), TransferError> {
    if path.exists() {
        return Err(file(path, "is there already; nothing was written"));
    }
    if let Some(left) = log_left(path) {
        let what = "is left of the database that was there, and may hold acknowledged cycles: move it away";
        return Err(file(&left, what));
    }
    Ok(())
}

/// Removes a file that was being made, and what SQLite keeps beside it.
fn discard(making: &Path) {
    discard_all(making, &["", "-journal", "-wal", "-shm"]);
}

/// Removes what SQLite keeps beside a file.
fn discard_beside(making: &Path) {
    discard_all(making, &["-journal", "-wal", "-shm"]);
}

fn discard_all(making: &Path, ends: &[&str]) {
    for end in ends {
        let file = beside(making, end);
        match std::fs::remove_file(&file) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                tracing::warn!(%error, file = %file.display(), "what was half made stays behind");
            }
            _ => {}
        }
    }
}

/// Makes a file under another name, and gives it its own when it is whole; removes it where that fails.
async fn whole<T>(
    to: &Path,
    make: impl AsyncFnOnce(&Path) -> Result<T, TransferError>,
) -> Result<(T, u64), TransferError> {
    absent(to)?;
    let making = partial(to);
    let _claimed = claim(&making, to)?;
    let made = match make(&making).await {
        Ok(made) => settle(&making, to).map(|bytes| (made, bytes)),
        Err(error) => Err(error),
    };
    if made.is_err() {
        discard(&making);
    }
    made
}

/// Backs a SQLite database up while a server may be writing it.
pub async fn back_up_sqlite(from: &Path, to: &Path, now: Timestamp) -> Result<BackupReport, TransferError> {
    let (tables, bytes) = whole(to, async |making| {
        create(making)?;
        let target = making.to_str().ok_or_else(|| file(to, "must be UTF-8"))?;
        let mut source = SqliteSide::read(from).await.map_err(|error| of_source(from, error))?;
        let copied = sqlx::query("VACUUM INTO $1").bind(target).execute(source.conn()).await;
        Box::new(source).close().await;
        copied.map_err(|error| of_target(to, of_source(from, error)))?;
        seal(making, now, None).await.map_err(|error| of_target(to, error))
    })
    .await?;
    Ok(BackupReport { tables, bytes })
}

/// Backs a PostgreSQL database up: one snapshot, while servers write. `from` is the server itself, not a pooler.
pub async fn back_up_postgres(from: &str, to: &Path, now: Timestamp) -> Result<BackupReport, TransferError> {
    let (tables, bytes) = whole(to, async |making| {
        create(making)?;
        let store = SqliteStore::open(making, SqliteOptions::default());
        store.await.map_err(|error| of_target(to, error))?.close().await;
        let mut source = PostgresSide::read(from).await?;
        let mut target = SqliteSide::write(making).await.map_err(|error| of_target(to, error))?;
        let sums = transfer(&mut source, &mut target, &mut |_, _, _| {}).await;
        Box::new(source).close().await;
        Box::new(target).close().await;
        // Only the target is SQLite's.
        let sums = sums.map_err(|error| of_target(to, error))?;
        seal(making, now, Some(sums)).await.map_err(|error| of_target(to, error))
    })
    .await?;
    Ok(BackupReport { tables, bytes })
}

/// What remembers the last backup; a second one replaces the first.
const NOTE: &str = "INSERT INTO last_backup (only_row, made_at_us) VALUES (1, $1)
    ON CONFLICT (only_row) DO UPDATE SET made_at_us = excluded.made_at_us";

/// Notes in a SQLite database, beside the server that may be writing it, that its state at `made_at` is backed up.
pub async fn note_sqlite(database: &Path, made_at: Timestamp) -> Result<(), TransferError> {
    let mut side = SqliteSide::write(database).await?;
    let noted = sqlx::query(NOTE).bind(made_at.micros()).execute(side.conn()).await;
    Box::new(side).close().await;
    noted?;
    Ok(())
}

/// Notes in a PostgreSQL database that its state at `made_at` is backed up.
pub async fn note_postgres(database: &str, made_at: Timestamp) -> Result<(), TransferError> {
    let mut side = PostgresSide::connect(database).await?;
    let noted = sqlx::query(NOTE).bind(made_at.micros()).execute(side.conn()).await;
    Box::new(side).close().await;
    noted?;
    Ok(())
}

/// Writes the sums into the backup: those of the source where they are known, else those of the copy.
async fn seal(
    path: &Path,
    now: Timestamp,
    known: Option<Vec<(String, TableSum)>>,
) -> Result<Vec<(String, TableSum)>, TransferError> {
    let mut side = SqliteSide::write(path).await?;
    // A single file: whoever copies a backup copies one thing.
    sqlx::query("PRAGMA journal_mode = DELETE").fetch_all(side.conn()).await?;
    forget_journal(&mut side).await?;
    if let Some(damage) = damage_of(&mut side).await? {
        return Err(file(path, format!("SQLite finds the copy damaged: {damage}")));
    }
    let sums = match known {
        Some(sums) => sums,
        None => sums_of(&mut side).await?,
    };
    for statement in [
        "CREATE TABLE backup_made (made_at_us INTEGER NOT NULL, program TEXT NOT NULL) STRICT",
        "CREATE TABLE backup_sums (table_name TEXT PRIMARY KEY NOT NULL, row_count INTEGER NOT NULL,
             digest BLOB NOT NULL) STRICT",
    ] {
        sqlx::query(statement).execute(side.conn()).await?;
    }
    sqlx::query("INSERT INTO backup_made (made_at_us, program) VALUES ($1, $2)")
        .bind(now.micros())
        .bind(env!("CARGO_PKG_VERSION"))
        .execute(side.conn())
        .await?;
    for (table, sum) in &sums {
        sqlx::query("INSERT INTO backup_sums (table_name, row_count, digest) VALUES ($1, $2, $3)")
            .bind(table)
            .bind(i64::try_from(sum.rows).unwrap_or(i64::MAX))
            .bind(sum.digest.as_slice())
            .execute(side.conn())
            .await?;
    }
    Box::new(side).close().await;
    Ok(sums)
}

/// What SQLite finds wrong with pages, indexes and rows of a file. An index that says something else than its table leaves rows
/// out of answers, and is in no table's sum.
pub(super) async fn damage_of(side: &mut SqliteSide) -> Result<Option<String>, TransferError> {
    let found: Vec<String> = sqlx::query_scalar("PRAGMA integrity_check(10)").fetch_all(side.conn()).await?;
    Ok((found != ["ok"]).then(|| found.join("; ")))
}

/// The groups' journal is the source's: whoever is restored from the copy makes one of its own.
async fn forget_journal(side: &mut SqliteSide) -> Result<(), TransferError> {
    let there = "SELECT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = 'groups_journal')";
    // A source that no server of this version has opened has none.
    if sqlx::query_scalar(there).fetch_one(side.conn()).await? {
        sqlx::query("DELETE FROM groups_journal").execute(side.conn()).await?;
    }
    Ok(())
}

async fn sums_of(side: &mut SqliteSide) -> Result<Vec<(String, TableSum)>, TransferError> {
    let mut sums = Vec::new();
    for table in side.tables().await? {
        let sum = of_table(side, &table).await?;
        sums.push((table.name, sum));
    }
    Ok(sums)
}

/// Bytes that are copied at a time.
const CHUNK: usize = 1 << 20;

/// Copies a backup to a place of its own. It is told which of the two files fails.
fn unpack(backup: &Path, at: &Path) -> Result<(), TransferError> {
    if !backup.is_file() {
        return Err(file(backup, if backup.exists() { "is no file" } else { "is not there" }));
    }
    let unreadable = |error| io(backup, "cannot be read", &error);
    let mut from = std::fs::File::open(backup).map_err(unreadable)?;
    let mut to = create(at)?;
    let mut chunk = vec![0; CHUNK];
    loop {
        match from.read(&mut chunk) {
            Ok(0) => return Ok(()),
            Ok(read) => {
                to.write_all(&chunk[..read]).map_err(|error| io(at, "cannot be written", &error))?;
            }
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(unreadable(error)),
        }
    }
}

/// The sums of a backup, checked against its tables, in a copy of it that may be written.
async fn checked(backup: &Path, side: &mut SqliteSide) -> Result<Vec<(String, TableSum)>, TransferError> {
    let written: Vec<(String, i64, Vec<u8>)> =
        sqlx::query_as("SELECT table_name, row_count, digest FROM backup_sums ORDER BY table_name")
            .fetch_all(side.conn())
            .await
            .map_err(|error| match of_backup(backup, error) {
                // The table is not there.
                TransferError::Store(_) => file(backup, "is no backup of this program"),
                told => told,
            })?;
    let damaged = |error| match of_backup(backup, error) {
        TransferError::Store(error) => file(backup, format!("is damaged: {error}")),
        other => other,
    };
    let sums = sums_of(side).await.map_err(damaged)?;
    for (name, rows, digest) in &written {
        let right = sums.iter().any(|(table, sum)| {
            table == name && i64::try_from(sum.rows).ok() == Some(*rows) && sum.digest.as_slice() == digest
        });
        if !right {
            return Err(file(backup, format!("is damaged: {name} is not what was backed up")));
        }
    }
    if written.len() != sums.len() {
        return Err(file(backup, "is damaged: a table is there that was not backed up"));
    }
    if let Some(damage) = damage_of(side).await.map_err(damaged)? {
        return Err(file(backup, format!("is damaged: {damage}")));
    }
    Ok(sums)
}

/// Copies a backup to a place of its own, checks the copy by its sums, and makes a database of it.
async fn stage(backup: &Path, at: &Path) -> Result<Vec<(String, TableSum)>, TransferError> {
    unpack(backup, at)?;
    let mut side = SqliteSide::write(at).await.map_err(|error| of_backup(backup, error))?;
    let sums = checked(backup, &mut side).await;
    let sums = match sums {
        Ok(sums) => sums,
        Err(error) => {
            Box::new(side).close().await;
            return Err(error);
        }
    };
    let made: Result<(), TransferError> = async {
        for statement in ["DROP TABLE backup_sums", "DROP TABLE backup_made"] {
            sqlx::query(statement).execute(side.conn()).await?;
        }
        Box::new(side).close().await;
        // Brings a backup of an older version up to this one's.
        let store = SqliteStore::open(at, SqliteOptions::default()).await?;
        store.close().await;
        // The copy that it was before had backups; the database that it becomes has none yet.
        let mut side = SqliteSide::write(at).await?;
        sqlx::query("DELETE FROM last_backup").execute(side.conn()).await?;
        Box::new(side).close().await;
        Ok(())
    }
    .await;
    made.map_err(|error| of_target(at, error))?;
    Ok(sums)
}

/// Restores a backup into a SQLite file that is not there yet.
pub async fn restore_to_sqlite(backup: &Path, to: &Path) -> Result<Vec<(String, TableSum)>, TransferError> {
    if let Some(journal) = crate::sqlite::is_left(to).map_err(|error| of_target(to, error))? {
        return Err(file(&journal, "holds acknowledged cycles of the database that was there: move it away"));
    }
    let (sums, _) = whole(to, async |making| stage(backup, making).await).await?;
    Ok(sums)
}

/// Restores a backup into a PostgreSQL database that is fresh, or holds a part of the same backup. `folder` is where
/// the backup is unpacked meanwhile.
pub async fn restore_to_postgres(
    backup: &Path,
    to: &str,
    folder: &Path,
) -> Result<Vec<(String, TableSum)>, TransferError> {
    let staged = folder.join(format!("feedwright-restore-{}.sqlite3", uuid::Uuid::now_v7()));
    let outcome = async {
        stage(backup, &staged).await?;
        let (from, to) = (Address::Sqlite(staged.clone()), Address::Postgres(to.to_owned()));
        copy_sound(&from, &to, &mut |_, _, _| {}).await
    }
    .await;
    discard(&staged);
    outcome
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_being_made_is_nobody_else_s() {
        let dir = tempfile::tempdir().unwrap();
        let to = dir.path().join("night.backup");
        let making = partial(&to);
        let first = claim(&making, &to).unwrap();
        let why = claim(&making, &to).unwrap_err().to_string();
        assert!(why.contains("is being made by another process"), "{why}");
        drop(first);
        // What an interrupted one has left is made anew.
        for left in [[SQLITE, b"half"].concat(), vec![0; 8192], Vec::new()] {
            std::fs::write(&making, left).unwrap();
            assert_eq!(claim(&making, &to).unwrap().metadata().unwrap().len(), 0);
        }
        std::fs::write(&making, "something precious").unwrap();
        let why = claim(&making, &to).unwrap_err().to_string();
        assert!(why.contains("is in the way"), "{why}");
        assert_eq!(std::fs::read_to_string(&making).unwrap(), "something precious");
    }
}

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
use super::{Side, TableSum, TransferError, assert_finished};
use crate::durable::sync_name;
use crate::gate::panicked;
use crate::sqlite::{beside, by_name, log_left};
use crate::store::Store;
use crate::{SqliteOptions, SqliteStore};
use feedwright_core::units::Timestamp;
use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
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

/// An empty file for its owner only: it holds hashes of tokens. Where something stands under its name already, a link too, none is
/// made.
fn create(path: &Path) -> std::io::Result<File> {
    let mut options = File::options();
    options.read(true).write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(path)
}

/// Opens the file that stands under a name, and not what a link there leads to.
fn open_itself(path: &Path) -> std::io::Result<File> {
    let mut options = File::options();
    options.read(true).write(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(
        &mut options,
        rustix::fs::OFlags::NOFOLLOW.bits().cast_signed(),
    );
    options.open(path)
}

/// Whether an open file stands under that name, itself.
#[cfg(unix)]
fn stands_under(open: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let identity = |found: std::fs::Metadata| (found.dev(), found.ino());
    let there = path.symlink_metadata().map(identity);
    open.metadata().map(identity).is_ok_and(|open| there.is_ok_and(|there| there == open))
}

/// Elsewhere a file that is open is neither removed nor replaced.
#[cfg(not(unix))]
fn stands_under(_open: &File, path: &Path) -> bool {
    path.exists()
}

#[cfg(unix)]
fn is_of_this_user(found: &std::fs::Metadata) -> bool {
    std::os::unix::fs::MetadataExt::uid(found) == rustix::process::geteuid().as_raw()
}

#[cfg(not(unix))]
const fn is_of_this_user(_found: &std::fs::Metadata) -> bool {
    true
}

/// How every file of SQLite begins.
const SQLITE: &[u8] = b"SQLite format 3\0";

/// The first bytes of a file, as many as SQLite's begin with, where it has so many.
fn head_of(mut open: &File) -> std::io::Result<Vec<u8>> {
    let mut head = Vec::new();
    open.seek(SeekFrom::Start(0))?;
    open.take(SQLITE.len() as u64).read_to_end(&mut head)?;
    Ok(head)
}

fn busy(to: &Path) -> TransferError {
    file(to, "is being made by another process; nothing was written")
}

/// Takes a file for itself; `false` where another process has it. Not every file system has locks; where there are none, two
/// are not told from each other.
fn lock(open: &File) -> bool {
    !matches!(open.try_lock(), Err(TryLockError::WouldBlock))
}

/// Removes what an interrupted one has left under the name: another one's mode and links to it are not taken over. What another
/// process is making, what is another user's, and what is nothing that was being made is left alone.
fn clear(making: &Path, to: &Path) -> Result<(), TransferError> {
    let unusable = |error| io(making, "cannot be made", &error);
    let in_the_way = |what| file(making, format!("is in the way, and is {what}: move it away"));
    let found = match making.symlink_metadata() {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        found => found.map_err(unusable)?,
    };
    if !found.is_file() {
        return Err(in_the_way("no file"));
    }
    if !is_of_this_user(&found) {
        return Err(in_the_way("another user's"));
    }
    let left = match open_itself(making) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        left => left.map_err(unusable)?,
    };
    // Between opening and locking, the other one may have finished, and given the file its name.
    if !lock(&left) || !stands_under(&left, making) {
        return Err(busy(to));
    }
    let head = head_of(&left).map_err(unusable)?;
    // SQLite writes the first page last: what it has begun is zeros there.
    let is_ours = head.len() < SQLITE.len() || head == SQLITE || head.iter().all(|byte| *byte == 0);
    if !is_ours {
        return Err(in_the_way("nothing that was being made"));
    }
    std::fs::remove_file(making).map_err(unusable)
}

/// A file that is being made under another name, until it is whole. It is nobody else's as long as this is kept: two that made
/// the same would take it from under each other. Dropped before it is whole, it is removed.
struct Making {
    path: PathBuf,
    file: File,
    is_whole: bool,
}

impl Making {
    /// Begins with an empty file for its owner only.
    fn begin(path: PathBuf, to: &Path) -> Result<Self, TransferError> {
        clear(&path, to)?;
        let file = create(&path).map_err(|error| match error.kind() {
            // Another process has begun meanwhile.
            ErrorKind::AlreadyExists => busy(to),
            _ => io(&path, "cannot be made", &error),
        })?;
        // Before it is locked it may be taken for one that was left.
        if !lock(&file) || !stands_under(&file, &path) {
            return Err(busy(to));
        }
        let making = Self { path, file, is_whole: false };
        // Another process may have finished meanwhile.
        if to.exists() {
            return Err(busy(to));
        }
        discard_beside(&making.path);
        Ok(making)
    }

    /// Makes it durable under its name; returns its size.
    async fn settle(mut self, to: &Path) -> Result<u64, TransferError> {
        let made = self.file.try_clone().map_err(|error| io(to, "cannot be written", &error))?;
        let (from, name) = (self.path.clone(), to.to_owned());
        // On another thread: who is told to stop does not wait for the disk.
        let settling = tokio::task::spawn_blocking(move || settle(&made, &from, &name, sync_name));
        let bytes = settling.await.map_err(panicked)??;
        self.is_whole = true;
        Ok(bytes)
    }
}

impl Drop for Making {
    fn drop(&mut self) {
        if !self.is_whole {
            discard(&self.path);
        }
    }
}

/// Makes a whole file durable under its name.
fn settle(
    made: &File,
    from: &Path,
    to: &Path,
    sync_name: fn(&Path) -> std::io::Result<()>,
) -> Result<u64, TransferError> {
    let unwritten = |error| io(to, "cannot be written", &error);
    // SQLite was told a name, and may have written elsewhere.
    if !stands_under(made, from) || head_of(made).map_err(unwritten)? != SQLITE {
        return Err(file(to, "is not made: what was written is not there"));
    }
    for log in ["-wal", "-journal"] {
        // What stands in a log is not in the file.
        if std::fs::metadata(beside(from, log)).is_ok_and(|log| log.len() > 0) {
            return Err(file(to, "is not made: a part of it is in a log beside it"));
        }
    }
    made.sync_all().map_err(unwritten)?;
    let bytes = made.metadata().map_err(unwritten)?.len();
    // It took its time: a server may have made a database there meanwhile.
    absent(to)?;
    std::fs::rename(from, to).map_err(|error| io(to, "cannot be made", &error))?;
    if let Err(error) = sync_name(to) {
        // A name that a loss of power may take away again is not left for one that stays.
        if stands_under(made, to)
            && let Err(error) = std::fs::remove_file(to)
        {
            tracing::warn!(%error, file = %to.display(), "it stays under a name that is not durable");
        }
        return Err(io(to, "cannot be made durable under its name", &error));
    }
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
            Err(error) if error.kind() != ErrorKind::NotFound => {
                tracing::warn!(%error, file = %file.display(), "what was half made stays behind");
            }
            _ => {}
        }
    }
}

/// Makes a file under another name, and gives it its own when it is whole; removes it where that fails, and where this is
/// dropped before.
async fn whole<T>(
    to: &Path,
    make: impl AsyncFnOnce(&Path) -> Result<T, TransferError>,
) -> Result<(T, u64), TransferError> {
    absent(to)?;
    let making = Making::begin(partial(to), to)?;
    let made = make(&making.path).await?;
    let bytes = making.settle(to).await?;
    Ok((made, bytes))
}

/// Backs a SQLite database up while a server may be writing it. Dropped before it is done, it leaves nothing.
pub async fn back_up_sqlite(from: &Path, to: &Path, now: Timestamp) -> Result<BackupReport, TransferError> {
    let (tables, bytes) = whole(to, async |making| {
        let target = by_name(making);
        let target = target.to_str().ok_or_else(|| file(to, "must be UTF-8"))?;
        let mut source = SqliteSide::read(from).await.map_err(|error| of_source(from, error))?;
        let copied = sqlx::query("VACUUM INTO $1").bind(target).execute(source.conn()).await;
        Box::new(source).close().await;
        copied.map_err(|error| of_target(to, of_source(from, error)))?;
        seal(making, now, None).await.map_err(|error| of_target(to, error))
    })
    .await?;
    Ok(BackupReport { tables, bytes })
}

/// Backs a PostgreSQL database up: one snapshot, while servers write. `from` is the server itself, not a pooler. Dropped before
/// it is done, it leaves nothing.
pub async fn back_up_postgres(from: &str, to: &Path, now: Timestamp) -> Result<BackupReport, TransferError> {
    let (tables, bytes) = whole(to, async |making| {
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
    let noted = async {
        assert_finished(&mut side).await?;
        sqlx::query(NOTE).bind(made_at.micros()).execute(side.conn()).await?;
        Ok(())
    }
    .await;
    Box::new(side).close().await;
    noted
}

/// Notes in a PostgreSQL database that its state at `made_at` is backed up.
pub async fn note_postgres(database: &str, made_at: Timestamp) -> Result<(), TransferError> {
    let mut side = PostgresSide::connect(database).await?;
    let noted = async {
        assert_finished(&mut side).await?;
        sqlx::query(NOTE).bind(made_at.micros()).execute(side.conn()).await?;
        Ok(())
    }
    .await;
    Box::new(side).close().await;
    noted
}

/// Writes the sums into the backup: those of the source where they are known, else those of the copy.
async fn seal(
    path: &Path,
    now: Timestamp,
    known: Option<Vec<(String, TableSum)>>,
) -> Result<Vec<(String, TableSum)>, TransferError> {
    let mut side = SqliteSide::write(path).await?;
    // A copy may have begun since the database was opened.
    assert_finished(&mut side).await?;
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

/// Copies a backup into an empty file, on another thread: who is told to stop does not wait for the disk.
async fn unpack(backup: &Path, at: &Path) -> Result<(), TransferError> {
    let (backup, at) = (backup.to_owned(), at.to_owned());
    tokio::task::spawn_blocking(move || unpack_at_once(&backup, &at)).await.map_err(panicked)?
}

/// The same on this one. It is told which of the two files fails.
fn unpack_at_once(backup: &Path, at: &Path) -> Result<(), TransferError> {
    if !backup.is_file() {
        return Err(file(backup, if backup.exists() { "is no file" } else { "is not there" }));
    }
    let unreadable = |error| io(backup, "cannot be read", &error);
    let mut from = File::open(backup).map_err(unreadable)?;
    let mut to = open_itself(at).map_err(|error| io(at, "cannot be written", &error))?;
    let mut chunk = vec![0; CHUNK];
    loop {
        match from.read(&mut chunk) {
            Ok(0) => return Ok(()),
            Ok(read) => {
                to.write_all(&chunk[..read]).map_err(|error| io(at, "cannot be written", &error))?;
            }
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
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

/// Copies a backup into an empty file, checks the copy by its sums, and makes a database of it.
async fn stage(backup: &Path, at: &Path) -> Result<Vec<(String, TableSum)>, TransferError> {
    unpack(backup, at).await?;
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
        // The copy that it was before had backups, and a clock; the database that it becomes has none yet.
        let mut side = SqliteSide::write(at).await?;
        for statement in ["DELETE FROM last_backup", "DELETE FROM retention_clock"] {
            sqlx::query(statement).execute(side.conn()).await?;
        }
        // Closing says nothing of a log that could not be folded into the file, which alone is moved to its name.
        let mode: String = sqlx::query_scalar("PRAGMA journal_mode = DELETE").fetch_one(side.conn()).await?;
        Box::new(side).close().await;
        if mode != "delete" {
            return Err(file(at, "is not made: its log cannot be folded into it"));
        }
        Ok(())
    }
    .await;
    made.map_err(|error| of_target(at, error))?;
    Ok(sums)
}

/// Restores a backup into a SQLite file that is not there yet. Dropped before it is done, it leaves nothing.
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
        create(&staged).map_err(|error| io(&staged, "cannot be made", &error))?;
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
        let begin = || Making::begin(making.clone(), &to);
        let refused = || begin().map(|_| ()).unwrap_err().to_string();
        let first = begin().unwrap();
        let why = refused();
        assert!(why.contains("is being made by another process"), "{why}");
        drop(first);
        assert!(!making.exists(), "what is not whole goes");
        // What an interrupted one has left is made anew.
        for left in [[SQLITE, b"half"].concat(), vec![0; 8192], Vec::new()] {
            std::fs::write(&making, left).unwrap();
            assert_eq!(begin().unwrap().file.metadata().unwrap().len(), 0);
        }
        std::fs::write(&making, "something precious").unwrap();
        let why = refused();
        assert!(why.contains("is in the way"), "{why}");
        assert_eq!(std::fs::read_to_string(&making).unwrap(), "something precious");
    }

    #[test]
    fn a_file_whose_name_is_not_durable_is_in_nobody_s_way() {
        let dir = tempfile::tempdir().unwrap();
        let to = dir.path().join("night.backup");
        let make = |sync_name: fn(&Path) -> std::io::Result<()>| {
            let mut making = Making::begin(partial(&to), &to).unwrap();
            std::io::Write::write_all(&mut making.file, &[SQLITE, b"whole"].concat()).unwrap();
            settle(&making.file, &making.path, &to, sync_name)
        };
        let why = make(|_| Err(std::io::Error::other("worn out"))).unwrap_err().to_string();
        assert!(why.contains("night.backup") && why.contains("worn out"), "{why}");
        assert!(!to.exists());
        assert_eq!(make(sync_name).unwrap(), std::fs::metadata(&to).unwrap().len());
    }

    #[test]
    fn a_file_of_which_a_part_is_in_a_log_is_not_whole() {
        let dir = tempfile::tempdir().unwrap();
        let to = dir.path().join("cell.sqlite3");
        for (log, bytes, is_whole) in [("-wal", 1, false), ("-journal", 1, false), ("-wal", 0, true)] {
            let mut making = Making::begin(partial(&to), &to).unwrap();
            std::io::Write::write_all(&mut making.file, &[SQLITE, b"a part"].concat()).unwrap();
            std::fs::write(beside(&making.path, log), vec![1; bytes]).unwrap();
            let made = settle(&making.file, &making.path, &to, sync_name);
            assert_eq!((made.is_ok(), to.exists()), (is_whole, is_whole), "{log}: {made:?}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_file_that_is_being_made_is_its_owner_s_whatever_stands_there() {
        use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
        let dir = tempfile::tempdir().unwrap();
        let to = dir.path().join("night.backup");
        let making = partial(&to);
        let begin = || Making::begin(making.clone(), &to);
        // One that everybody may read, and another name of the same file.
        std::fs::write(&making, [SQLITE, b"half"].concat()).unwrap();
        std::fs::set_permissions(&making, std::fs::Permissions::from_mode(0o644)).unwrap();
        let elsewhere = dir.path().join("elsewhere");
        std::fs::hard_link(&making, &elsewhere).unwrap();
        let made = begin().unwrap();
        let found = made.path.symlink_metadata().unwrap();
        assert_eq!((found.mode() & 0o777, found.nlink()), (0o600, 1));
        drop(made);
        assert_eq!(std::fs::read(&elsewhere).unwrap(), [SQLITE, b"half"].concat());
        // A link leads anywhere, and a folder is no file.
        for target in [&elsewhere, &dir.path().join("nothing")] {
            symlink(target, &making).unwrap();
            let why = begin().map(|_| ()).unwrap_err().to_string();
            assert!(why.contains("is in the way, and is no file"), "{why}");
            assert_eq!(std::fs::read_link(&making).unwrap(), *target);
            std::fs::remove_file(&making).unwrap();
        }
        assert_eq!(std::fs::read(&elsewhere).unwrap(), [SQLITE, b"half"].concat());
        std::fs::create_dir(&making).unwrap();
        assert!(begin().is_err() && making.is_dir());
    }

    #[tokio::test]
    async fn what_is_not_made_is_not_told_as_made_and_goes() {
        let dir = tempfile::tempdir().unwrap();
        let to = dir.path().join("night.backup");
        let left = || dir.path().read_dir().unwrap().count();
        let elsewhere = whole(&to, async |_| Ok(())).await.unwrap_err().to_string();
        assert!(elsewhere.contains("night.backup: is not made"), "{elsewhere}");
        assert_eq!(left(), 0);
        // Whoever is told to stop drops what is under way.
        let mut interrupted = Box::pin(whole(&to, async |making| {
            std::fs::write(making, "half").unwrap();
            std::fs::write(beside(making, "-journal"), "more").unwrap();
            std::future::pending::<Result<(), TransferError>>().await
        }));
        assert!(tokio::time::timeout(std::time::Duration::ZERO, &mut interrupted).await.is_err());
        assert_eq!(left(), 2);
        drop(interrupted);
        assert_eq!(left(), 0);
    }
}

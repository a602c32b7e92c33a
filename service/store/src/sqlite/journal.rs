//! The groups' journal: what was acknowledged and is not committed to the database yet.
//!
//! A commit writes every page that it changed, and a group of a few cycles changes nearly as many pages as one of
//! hundreds. So a transaction stays open for several groups. What each of them runs is appended here, one record a group,
//! and is on the disk before the group is acknowledged; when the transaction is committed, the next epoch begins at the
//! front of the file. What a process leaves behind is run again by whoever opens the database next: the same statements,
//! with the same values, on the same state, as nobody else writes while the transaction is open.
//!
//! | bytes | what |
//! |---|---|
//! | 16 | `feedwright groups` without its blank, that is `feedwrightgroups` |
//! | 4 | version of the format, 2 |
//! | 16 | id of the journal, as the database has it |
//! | 4 | crc32 over the above |
//!
//! Records stand behind it, each from the next multiple of 4096 bytes on, with zeros before. Integers are little-endian: crc32 over the rest of the record, u32 length of the body, u64 epoch, u32
//! number within the epoch from 0 on, body. A body is a list of: `1`, u8 number of a statement, u32 length, its text; `2`, u8
//! number of a statement, u8 number of values, u32 rows that it changed, values; `3`, i64, the newest row of `cycles` before
//! the epoch; `4`, as `2`, a statement that stands for what the process would have run before its commit: only who takes the
//! epoch up runs it. A value is `0` (null), `1` and an i64, `2` and the bits of an f64, `3`, u32 length and text, or `4`, u32 length
//! and bytes. An epoch ends where its next record is not whole: that one was never acknowledged. Where another
//! record of the epoch stands behind it, it was, and the file is damaged.
//!
//! Version 1 had no `4`, and its records stood one behind the other from byte 40 on; what was left of it is taken up.
//!
//! A database may have been put back to an earlier state beside a journal that is of a later one. The epoch alone would not
//! tell, as it stands still where groups are far apart; the newest row, and how many rows each statement changes, do.

mod blocks;
mod records;
#[cfg(test)]
mod tests;

use self::blocks::{BLOCK, Blocks, up};
use self::records::{Records, latest_epoch};
use super::files::{Identity, beside, by_name};
use super::open::{APPLIED, HAS_MIGRATIONS, MIGRATIONS, SETTINGS};
use crate::durable::sync_name;
use crate::error::{StoreError, StoreResult};
use rusqlite::types::{ToSqlOutput, ValueRef};
use rusqlite::{Connection, OpenFlags, OptionalExtension, ToSql, TransactionBehavior};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

const MAGIC: &[u8; 16] = b"feedwrightgroups";
const VERSION: u32 = 2;
/// Versions that are taken up, and of what number of bytes the places of their records are multiples.
const READABLE: [(u32, usize); 2] = [(1, 1), (VERSION, BLOCK)];
/// Bytes of the head.
const HEAD: usize = 40;
/// Where the first record stands.
const FIRST: u64 = BLOCK as u64;
/// Bytes of a record before its body.
const RECORD_HEAD: usize = 20;
/// Bytes of the file: some eight groups of forty machines. They are written once at first, so that what comes later writes over them and
/// need not change what the file system notes of the file.
const CAPACITY: u64 = 2 << 20;
/// A record of usual length is built in the memory of the one before.
const KEPT_RECORD: usize = 320 << 10;

const DEFINES: u8 = 1;
const RUNS: u8 = 2;
const FOLLOWS: u8 = 3;
const STANDS_FOR: u8 = 4;

const NULL: u8 = 0;
const INTEGER: u8 = 1;
const REAL: u8 = 2;
const TEXT: u8 = 3;
const BYTES: u8 = 4;

/// The journal of a database that is open for writing.
#[derive(Debug)]
pub(super) struct Journal {
    file: File,
    /// The same, where the system writes blocks without copying them first.
    direct: Option<File>,
    path: PathBuf,
    identity: Identity,
    /// Of the transaction that is open, or begins next.
    epoch: u64,
    /// Where the next record goes, and its number in the epoch.
    at: u64,
    number: u32,
    /// The record that is being made, with room for its head.
    record: Blocks,
    /// Statements by their numbers; so many of them are defined in the epoch.
    statements: Vec<&'static str>,
    defined: usize,
    /// As many as were before the record.
    defined_before: usize,
    /// Where the values of the last statement are counted.
    counted_at: usize,
    /// Something may have been written in the epoch, and it could not be.
    touched: bool,
    failed: bool,
}

/// Beside the database that the path leads to, or is to lead to.
pub(super) fn path_of(database: &Path) -> io::Result<PathBuf> {
    let found = match database.canonicalize() {
        Err(error) if error.kind() == io::ErrorKind::NotFound => database.to_owned(),
        found => found?,
    };
    Ok(beside(&found, "-groups"))
}

impl Journal {
    /// Opens the journal of a database, making it where there is none. What it held has been [taken up](take_up).
    ///
    /// # Errors
    ///
    /// Where another process has it, or where it cannot be made: a disk that has no room for it may have room for cycles.
    pub(super) fn open(database: &Path, conn: &Connection) -> StoreResult<Self> {
        let path = path_of(database).map_err(not_writable)?;
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false);
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let file = options.open(&path).map_err(not_writable)?;
        let begun = Instant::now();
        while !lock(&file)? {
            // Who makes a copy has it for a moment.
            if begun.elapsed() > PATIENCE_TO_OPEN {
                return Err(StoreError::Unavailable(format!("{} is in use", path.display()).into()));
            }
            std::thread::sleep(LOOK_AGAIN);
        }
        let (id, epoch) = match noted(conn)? {
            Some(noted) => noted,
            None => (note(conn)?, 0),
        };
        if let Err(error) = prepare(&file, id).and_then(|()| settle(&path, database)) {
            // Nothing is left half made: it would not be opened next time either.
            drop(std::fs::remove_file(&path));
            return Err(not_writable(error));
        }
        let identity = Identity::of(&path)?;
        let direct = blocks::opened(&path, &file, &head(VERSION, id));
        Ok(Self {
            file,
            direct,
            path,
            identity,
            epoch: epoch + 1,
            at: FIRST,
            number: 0,
            record: Blocks::of(RECORD_HEAD, KEPT_RECORD),
            statements: Vec::new(),
            defined: 0,
            defined_before: 0,
            counted_at: 0,
            touched: false,
            failed: false,
        })
    }

    /// Begins a record, before its group has changed anything.
    pub(super) fn begin(&mut self, conn: &Connection) -> StoreResult<()> {
        self.record.truncate(RECORD_HEAD);
        self.record.shrink_to(KEPT_RECORD);
        self.defined_before = self.defined;
        if self.number == 0 {
            self.record.push(FOLLOWS);
            self.record.extend_from_slice(&newest(conn)?.to_le_bytes());
        }
        Ok(())
    }

    /// A statement that is run, before its values.
    pub(super) fn run(&mut self, statement: &'static str) -> rusqlite::Result<()> {
        self.statement(RUNS, statement)
    }

    /// A statement that is not run, and changes one row, before its values: it stands for others that are run before the
    /// commit.
    pub(super) fn stands_for(&mut self, statement: &'static str) -> rusqlite::Result<()> {
        self.statement(STANDS_FOR, statement)?;
        self.ran(1);
        Ok(())
    }

    fn statement(&mut self, kind: u8, statement: &'static str) -> rusqlite::Result<()> {
        let number = match self.statements.iter().position(|known| std::ptr::eq(*known, statement)) {
            Some(number) => number,
            None => {
                self.statements.push(statement);
                self.statements.len() - 1
            }
        };
        // They are few, and written out in this program.
        while self.defined <= number {
            self.record.extend_from_slice(&[DEFINES, byte(self.defined)?]);
            self.bytes(self.statements[self.defined].as_bytes())?;
            self.defined += 1;
        }
        self.record.extend_from_slice(&[kind, byte(number)?, 0, 0, 0, 0, 0]);
        self.counted_at = self.record.len() - 5;
        Ok(())
    }

    /// The statement has changed so many rows.
    pub(super) fn ran(&mut self, rows: usize) {
        let rows = u32::try_from(rows).unwrap_or(u32::MAX);
        let at = self.counted_at;
        self.record.as_mut_slice()[at + 1..at + 5].copy_from_slice(&rows.to_le_bytes());
    }

    /// The next value of the statement.
    pub(super) fn value(&mut self, value: &(impl ToSql + ?Sized)) -> rusqlite::Result<()> {
        match value.to_sql()? {
            ToSqlOutput::Borrowed(value) => self.write(value)?,
            ToSqlOutput::Owned(value) => self.write((&value).into())?,
            _ => return Err(too_long()),
        }
        let count = &mut self.record.as_mut_slice()[self.counted_at];
        *count = count.checked_add(1).ok_or_else(too_long)?;
        Ok(())
    }

    fn write(&mut self, value: ValueRef<'_>) -> rusqlite::Result<()> {
        match value {
            ValueRef::Null => self.record.push(NULL),
            ValueRef::Integer(value) => {
                self.record.push(INTEGER);
                self.record.extend_from_slice(&value.to_le_bytes());
            }
            ValueRef::Real(value) => {
                self.record.push(REAL);
                self.record.extend_from_slice(&value.to_bits().to_le_bytes());
            }
            ValueRef::Text(text) => {
                self.record.push(TEXT);
                self.bytes(text)?;
            }
            ValueRef::Blob(bytes) => {
                self.record.push(BYTES);
                self.bytes(bytes)?;
            }
        }
        Ok(())
    }

    fn bytes(&mut self, bytes: &[u8]) -> rusqlite::Result<()> {
        let length = u32::try_from(bytes.len()).map_err(|_| too_long())?;
        self.record.extend_from_slice(&length.to_le_bytes());
        self.record.extend_from_slice(bytes);
        Ok(())
    }

    /// What was begun is not kept.
    pub(super) fn forget(&mut self) {
        self.record.truncate(RECORD_HEAD);
        self.defined = self.defined_before;
    }

    /// Whether the record that was begun has room behind the others of its epoch.
    pub(super) fn has_room(&self) -> bool {
        !self.failed && self.at + up(self.record.len() as u64) <= CAPACITY
    }

    /// Whether the next record probably has none.
    pub(super) fn is_nearly_full(&self) -> bool {
        self.at + 2 * up(self.record.len() as u64) > CAPACITY
    }

    /// Appends the record that was begun; it is on the disk when this returns. After one that could not be, none has room.
    ///
    /// # Errors
    ///
    /// As the disk, and where somebody has removed or replaced the file: nobody would find what is written then.
    pub(super) fn append(&mut self) -> StoreResult<()> {
        self.touched = true;
        let written =
            self.identity.is_that_of(&self.path).and_then(|()| self.write_record().map_err(not_writable));
        self.failed |= written.is_err();
        written
    }

    fn write_record(&mut self) -> io::Result<()> {
        let length = self.record.len() - RECORD_HEAD;
        let length = u32::try_from(length).map_err(|_| io::ErrorKind::FileTooLarge)?;
        let record = self.record.as_mut_slice();
        record[4..8].copy_from_slice(&length.to_le_bytes());
        record[8..16].copy_from_slice(&self.epoch.to_le_bytes());
        record[16..20].copy_from_slice(&self.number.to_le_bytes());
        let sum = crc32fast::hash(&record[4..]);
        record[..4].copy_from_slice(&sum.to_le_bytes());
        let file = self.direct.as_ref().unwrap_or(&self.file);
        write_at(file, self.record.whole_blocks(), self.at)?;
        file.sync_data()?;
        self.at += up(self.record.len() as u64);
        self.number += 1;
        self.defined_before = self.defined;
        Ok(())
    }

    /// From here on nothing can be written, as to a file that is open for reading.
    #[cfg(test)]
    pub(super) fn refuse(&mut self, file: File) {
        (self.file, self.direct) = (file, None);
    }

    /// Whether a record of the epoch may be on the disk.
    pub(super) const fn is_touched(&self) -> bool {
        self.touched
    }

    /// Whether a record could not be written.
    pub(super) const fn has_failed(&self) -> bool {
        self.failed
    }

    /// What the transaction that ends the epoch says last.
    pub(super) fn note_end(&self, conn: &Connection) -> StoreResult<()> {
        note_epoch(conn, self.epoch)
    }

    /// The epoch's transaction is committed: its records are not needed any more.
    pub(super) const fn turn(&mut self) {
        self.epoch += 1;
        self.at = FIRST;
        self.number = 0;
        self.defined = 0;
        self.defined_before = 0;
        self.touched = false;
    }

    /// Runs again what the epoch has acknowledged, in a transaction that has just begun.
    pub(super) fn run_again(&self, conn: &Connection) -> StoreResult<()> {
        let mut bytes = vec![0; usize::try_from(self.at - FIRST).unwrap_or(usize::MAX)];
        read_at(&self.file, &mut bytes, FIRST).map_err(not_writable)?;
        let records = Records::of(&bytes, BLOCK, self.epoch);
        match run_all(conn, records, By::WhoWroteThem) {
            Ok(groups) if groups == self.number => Ok(()),
            // The database is another one than these groups were run in: nobody may go on with it.
            Ok(_) | Err(StoreError::Refused { .. } | StoreError::Damaged { .. }) => {
                Err(StoreError::NotWritable(of_another(&self.path).into()))
            }
            Err(error) => Err(error),
        }
    }

    /// Removes the file of a journal whose transactions are all committed.
    pub(super) fn remove(self) -> io::Result<()> {
        std::fs::remove_file(&self.path)
    }
}

/// Takes up what a process has left in the journal of a database: runs again what is not in the database, and commits it.
/// Before anything else is read or changed. Where another process is at work it commits by itself, which is waited for.
///
/// # Errors
///
/// Where the journal is of another state of the database than the one that is there, or of another database: what it
/// holds was acknowledged, and whoever put the database there decides what becomes of it.
pub(super) fn take_up(database: &Path, conn: &mut Connection) -> StoreResult<()> {
    let path = path_of(database).map_err(not_writable)?;
    let Some(mut file) = opened(&path)? else { return Ok(()) };
    let begun = Instant::now();
    let mut first = u64::MAX;
    loop {
        let is_mine = lock(&file)?;
        let Some(Found { id, epoch, records, multiple }) = held(&mut file, &path)? else { return Ok(()) };
        // Later ones came while this waited.
        first = first.min(epoch);
        match noted(conn)? {
            Some((known, committed))
                if known == id && (epoch <= committed || !is_mine && first <= committed) =>
            {
                return Ok(());
            }
            _ if !is_mine && begun.elapsed() < PATIENCE => std::thread::sleep(LOOK_AGAIN),
            _ if !is_mine => return Err(StoreError::Unavailable(in_use(&path).into())),
            Some((known, committed)) if known == id && epoch == committed + 1 => {
                let records = Records::of(&records, multiple, epoch);
                if records.are_damaged() {
                    return Err(StoreError::NotWritable(damaged_file(&path).into()));
                }
                return match take_up_records(conn, records, epoch) {
                    // Somebody has written the database since, who did not take it up.
                    Err(StoreError::Refused { .. } | StoreError::Damaged { .. }) => {
                        Err(StoreError::NotWritable(of_another(&path).into()))
                    }
                    outcome => outcome,
                };
            }
            _ => return Err(StoreError::NotWritable(of_another(&path).into())),
        }
    }
}

/// As [`take_up`], of a database that this process has not opened.
pub(super) fn take_up_closed(database: &Path) -> StoreResult<()> {
    // Most have no journal beside them, and may not be written by who reads them.
    if !path_of(database).and_then(std::fs::exists).map_err(not_writable)? {
        return Ok(());
    }
    if !database.exists() {
        return match is_left(database)? {
            None => Ok(()),
            Some(path) => Err(StoreError::NotWritable(of_another(&path).into())),
        };
    }
    let mut conn = Connection::open_with_flags(by_name(database), OpenFlags::SQLITE_OPEN_READ_WRITE)?;
    for (name, value) in SETTINGS.into_iter().chain([("synchronous", "FULL")]) {
        conn.pragma_update(None, name, value)?;
    }
    conn.busy_timeout(PATIENCE)?;
    is_known(&conn)?;
    take_up(database, &mut conn)
}

/// Refuses a database of a later version, whose statements may mean something else here.
fn is_known(conn: &Connection) -> StoreResult<()> {
    if !conn.query_row(HAS_MIGRATIONS, (), |row| row.get(0))? {
        return Ok(());
    }
    let mut applied = conn.prepare(APPLIED)?;
    let applied = applied.query_map((), |row| row.get(0))?.collect::<Result<Vec<i64>, _>>()?;
    StoreError::unless_known(&applied, &MIGRATIONS)
}

/// How long a process that has the journal is given to commit what is in it, how long to give it back, and the time
/// between two looks.
const PATIENCE: Duration = Duration::from_secs(10);
const PATIENCE_TO_OPEN: Duration = Duration::from_millis(500);
const LOOK_AGAIN: Duration = Duration::from_millis(5);

fn in_use(path: &Path) -> String {
    format!("{} is in use, and what it holds is not committed", path.display())
}

fn of_another(path: &Path) -> String {
    format!(
        "{} holds acknowledged cycles of another state of this database: put that state back, or move the journal \
         away to go on without them",
        path.display()
    )
}

fn damaged_file(path: &Path) -> String {
    format!(
        "{} is damaged: acknowledged cycles stand in it behind what cannot be read. Put back a copy of it, or move it away to \
         go on without all that it holds",
        path.display()
    )
}

/// The journal that stands there, if one does.
fn opened(path: &Path) -> StoreResult<Option<File>> {
    let found = match File::options().read(true).write(true).open(path) {
        // Who may only read the database has nothing to take up where its server is at work.
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => File::open(path),
        found => found,
    };
    match found {
        Ok(file) => Ok(Some(file)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(not_writable(error)),
    }
}

/// What a journal holds.
struct Found {
    id: [u8; 16],
    epoch: u64,
    records: Vec<u8>,
    multiple: usize,
}

/// What a journal holds; `None` where it holds none: one that is all zeros was being made, and
/// where no record is whole none was acknowledged. It has its whole length on the disk before its head is written: one with
/// a head and another length was cut, and one without it that is not all zeros was written over.
fn held(file: &mut File, path: &Path) -> StoreResult<Option<Found>> {
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(0)).and_then(|_| file.read_to_end(&mut bytes)).map_err(not_writable)?;
    if bytes.iter().all(|byte| *byte == 0) {
        return Ok(None);
    }
    let is_whole = |multiple| multiple != BLOCK || bytes.len() as u64 == CAPACITY;
    let known = bytes.get(..HEAD).and_then(id_of).filter(|(_, multiple)| is_whole(*multiple));
    let Some((id, multiple)) = known else {
        let what =
            format!("{} is damaged, or of a later version: it may hold acknowledged cycles", path.display());
        return Err(StoreError::NotWritable(what.into()));
    };
    bytes.drain(..HEAD.next_multiple_of(multiple).min(bytes.len()));
    Ok(latest_epoch(&bytes, multiple).map(|epoch| Found { id, epoch, records: bytes, multiple }))
}

/// Whether a journal stands beside a database that is not there, or is about to be put there, and holds something.
pub(crate) fn is_left(database: &Path) -> StoreResult<Option<PathBuf>> {
    let path = path_of(database).map_err(not_writable)?;
    let Some(mut file) = opened(&path)? else { return Ok(None) };
    Ok(held(&mut file, &path)?.map(|_| path))
}

fn take_up_records(conn: &mut Connection, records: Records<'_>, epoch: u64) -> StoreResult<()> {
    let transaction = conn.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let groups = run_all(&transaction, records, By::WhoTakesThemUp)?;
    note_epoch(&transaction, epoch)?;
    transaction.commit()?;
    tracing::warn!(groups, "groups that were acknowledged and not committed are taken up from their journal");
    Ok(())
}

/// Who runs the statements of records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum By {
    /// It has in memory what others only stand for, and runs that before its commit.
    WhoWroteThem,
    WhoTakesThemUp,
}

/// Runs the statements of records; returns how many records they were.
fn run_all(conn: &Connection, records: Records<'_>, by: By) -> StoreResult<u32> {
    let mut statements = Vec::new();
    let mut count = 0;
    for body in records {
        run(conn, &mut statements, body, by)?;
        count += 1;
    }
    Ok(count)
}

fn run<'b>(conn: &Connection, statements: &mut Vec<&'b str>, body: &'b [u8], by: By) -> StoreResult<()> {
    let mut body = Body(body);
    while let Some(kind) = body.next_kind() {
        match kind {
            DEFINES => {
                if usize::from(body.byte()?) != statements.len() {
                    return Err(damaged("a statement is out of its order"));
                }
                statements.push(body.text()?);
            }
            RUNS | STANDS_FOR => {
                let number = usize::from(body.byte()?);
                let text = statements.get(number).ok_or_else(|| damaged("a statement is not defined"))?;
                let mut statement = conn.prepare_cached(text)?;
                let values = usize::from(body.byte()?);
                let rows = u32::from_le_bytes(body.array()?);
                for place in 1..=values {
                    statement.raw_bind_parameter(place, body.value()?)?;
                }
                if kind == STANDS_FOR && by == By::WhoWroteThem {
                    continue;
                }
                if u32::try_from(statement.raw_execute()?) != Ok(rows) {
                    return Err(damaged("a statement changes something else than it did"));
                }
            }
            FOLLOWS => {
                if newest(conn)? != i64::from_le_bytes(body.array()?) {
                    return Err(damaged("it follows another cycle than the newest"));
                }
            }
            _ => return Err(damaged("an entry is of no kind")),
        }
    }
    Ok(())
}

/// What is left to read of a record's body.
struct Body<'b>(&'b [u8]);

impl<'b> Body<'b> {
    fn next_kind(&mut self) -> Option<u8> {
        let (kind, rest) = self.0.split_first()?;
        self.0 = rest;
        Some(*kind)
    }

    fn byte(&mut self) -> StoreResult<u8> {
        self.next_kind().ok_or_else(short)
    }

    fn array<const N: usize>(&mut self) -> StoreResult<[u8; N]> {
        let (array, rest) = self.0.split_first_chunk::<N>().ok_or_else(short)?;
        self.0 = rest;
        Ok(*array)
    }

    fn bytes(&mut self) -> StoreResult<&'b [u8]> {
        let length = usize::try_from(u32::from_le_bytes(self.array()?)).map_err(|_| short())?;
        let (bytes, rest) = self.0.split_at_checked(length).ok_or_else(short)?;
        self.0 = rest;
        Ok(bytes)
    }

    fn text(&mut self) -> StoreResult<&'b str> {
        std::str::from_utf8(self.bytes()?).map_err(|_| damaged("a text is not UTF-8"))
    }

    fn value(&mut self) -> StoreResult<ToSqlOutput<'b>> {
        Ok(ToSqlOutput::Borrowed(match self.byte()? {
            NULL => ValueRef::Null,
            INTEGER => ValueRef::Integer(i64::from_le_bytes(self.array()?)),
            REAL => ValueRef::Real(f64::from_bits(u64::from_le_bytes(self.array()?))),
            TEXT => ValueRef::Text(self.text()?.as_bytes()),
            BYTES => ValueRef::Blob(self.bytes()?),
            _ => return Err(damaged("a value is of no kind")),
        }))
    }
}

/// Whether this process has the file now; not where another one, or another journal of this one, has it.
fn lock(file: &File) -> StoreResult<bool> {
    match file.try_lock() {
        Ok(()) => Ok(true),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(error)) => Err(not_writable(error)),
    }
}

/// Makes the file as long as it is to be, with a head, where it has not been yet.
fn prepare(file: &File, id: [u8; 16]) -> io::Result<()> {
    let head = head(VERSION, id);
    let mut found = [0; HEAD];
    if file.metadata()?.len() == CAPACITY && read_at(file, &mut found, 0).is_ok() && found == head {
        return Ok(());
    }
    file.set_len(0)?;
    // A head over bytes of before would be a damaged journal.
    file.sync_all()?;
    let zeros = vec![0; 256 << 10];
    for at in (0..CAPACITY).step_by(zeros.len()) {
        write_at(file, &zeros, at)?;
    }
    file.sync_all()?;
    write_at(file, &head, 0)?;
    file.sync_all()
}

/// Makes the name as durable as the file, and lets it belong to whom the database belongs, as SQLite does with its own.
fn settle(path: &Path, database: &Path) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, chown};
        let of = std::fs::metadata(database)?;
        std::fs::set_permissions(path, of.permissions())?;
        if let Err(error) = chown(path, Some(of.uid()), Some(of.gid())) {
            // Only root gives files away, and whoever else made it may open it.
            tracing::debug!(%error, "the groups' journal belongs to who made it");
        }
        sync_name(path)?;
    }
    #[cfg(not(unix))]
    let _ = (path, database);
    Ok(())
}

#[cfg(unix)]
fn write_at(file: &File, bytes: &[u8], at: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, at)
}

#[cfg(not(unix))]
fn write_at(mut file: &File, bytes: &[u8], at: u64) -> io::Result<()> {
    file.seek(SeekFrom::Start(at)).and_then(|_| io::Write::write_all(&mut file, bytes))
}

fn read_at(mut file: &File, bytes: &mut [u8], at: u64) -> io::Result<()> {
    file.seek(SeekFrom::Start(at))?;
    file.read_exact(bytes)
}

fn head(version: u32, id: [u8; 16]) -> [u8; HEAD] {
    let mut head = [0; HEAD];
    head[..16].copy_from_slice(MAGIC);
    head[16..20].copy_from_slice(&version.to_le_bytes());
    head[20..36].copy_from_slice(&id);
    let sum = crc32fast::hash(&head[..36]);
    head[36..].copy_from_slice(&sum.to_le_bytes());
    head
}

/// The id of a journal, and of what its records' places are multiples.
fn id_of(bytes: &[u8]) -> Option<([u8; 16], usize)> {
    let id = bytes.get(20..36)?.try_into().ok()?;
    let (_, multiple) = READABLE.into_iter().find(|(version, _)| *bytes == head(*version, id))?;
    Some((id, multiple))
}

/// The journal's id and the last epoch that was committed, as the database has them.
fn noted(conn: &Connection) -> StoreResult<Option<([u8; 16], u64)>> {
    let there = "SELECT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = 'groups_journal')";
    if !conn.query_row(there, (), |row| row.get::<_, bool>(0))? {
        return Ok(None);
    }
    let row = |row: &rusqlite::Row<'_>| Ok((row.get(0)?, row.get::<_, i64>(1)?));
    let found = conn.query_row("SELECT journal_id, epoch FROM groups_journal", (), row).optional()?;
    Ok(found.map(|(id, epoch)| (id, epoch.unsigned_abs())))
}

/// The newest row of `cycles`, which stand as they came; 0 where there is none.
fn newest(conn: &Connection) -> StoreResult<i64> {
    let mut newest = conn.prepare_cached("SELECT COALESCE(MAX(rowid), 0) FROM cycles")?;
    Ok(newest.query_row((), |row| row.get(0))?)
}

fn note(conn: &Connection) -> StoreResult<[u8; 16]> {
    let id = *uuid::Uuid::now_v7().as_bytes();
    conn.execute(
        "INSERT INTO groups_journal (only_row, journal_id, epoch) VALUES (1, ?, 0)",
        (id.as_slice(),),
    )?;
    Ok(id)
}

fn note_epoch(conn: &Connection, epoch: u64) -> StoreResult<()> {
    let epoch = i64::try_from(epoch).map_err(|_| damaged("its epoch is none"))?;
    let noted = conn.prepare_cached("UPDATE groups_journal SET epoch = ?")?.execute((epoch,))?;
    if noted == 1 { Ok(()) } else { Err(damaged("the database does not know it any more")) }
}

fn byte(number: usize) -> rusqlite::Result<u8> {
    u8::try_from(number).map_err(|_| too_long())
}

fn too_long() -> rusqlite::Error {
    rusqlite::Error::ToSqlConversionFailure("longer than a journal takes".into())
}

fn short() -> StoreError {
    damaged("a record ends too early")
}

fn damaged(what: &str) -> StoreError {
    StoreError::Damaged { what: format!("the groups' journal: {what}") }
}

fn not_writable(error: io::Error) -> StoreError {
    StoreError::NotWritable(Box::new(error))
}

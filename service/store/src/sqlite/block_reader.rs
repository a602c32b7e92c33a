//! Blocks of samples, read on the thread that asks.
//!
//! A cycle's samples are one row: finding it takes some microseconds where its pages are in the system's cache, less than
//! waking another connection's thread and being woken by it. Where they are not, the thread waits for the disk, and whoever
//! it would have served waits with it. So only one reads like this at a time, and nobody for a while after a read that had to
//! wait: then the disk is slow, or what is asked for is old.

use super::dialect::{BLOCK, block_of};
use super::open::SETTINGS;
use crate::error::{StoreError, StoreResult};
use feedwright_core::ids::{CycleId, MachineId};
use rusqlite::{Connection, OpenFlags, OptionalExtension};
use std::path::Path;
use std::sync::{Mutex, PoisonError, TryLockError};
use std::time::{Duration, Instant};

/// What the connection keeps of the file, in KiB below zero: the upper pages of two indexes. The system keeps the rest.
const CACHE: &str = "-256";

/// A read that takes longer than this has waited for the disk.
const WAITED: Duration = Duration::from_millis(5);
/// How long nothing is read on the thread that asks after one that has waited.
const WARY: Duration = Duration::from_secs(10);

/// A connection that reads blocks.
#[derive(Debug)]
pub(super) struct BlockReader {
    /// `None` once closed.
    reader: Mutex<Option<Reader>>,
}

#[derive(Debug)]
struct Reader {
    conn: Connection,
    wary_until: Option<Instant>,
}

impl BlockReader {
    /// Opens a file that is there.
    pub(super) fn open(path: &Path) -> StoreResult<Self> {
        // No lock around every call: who holds it is the only one to use it.
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let conn = Connection::open_with_flags(path, flags)?;
        for (name, value) in SETTINGS.into_iter().chain([("cache_size", CACHE)]) {
            conn.pragma_update(None, name, value)?;
        }
        // Where the file is locked, others are asked, which may wait.
        conn.busy_timeout(Duration::ZERO)?;
        Ok(Self { reader: Mutex::new(Some(Reader { conn, wary_until: None })) })
    }

    /// The block of a cycle's samples; `None` where this thread is not to wait for it, as
    /// where somebody else is reading, and after the end.
    pub(super) fn read(&self, machine: &MachineId, id: &CycleId) -> Option<StoreResult<Option<Vec<u8>>>> {
        let mut reader = match self.reader.try_lock() {
            Ok(reader) => reader,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return None,
        };
        let Reader { conn, wary_until } = reader.as_mut()?;
        let begun = Instant::now();
        if wary_until.is_some_and(|until| begun < until) {
            return None;
        }
        let read = || {
            let mut statement = conn.prepare_cached(BLOCK)?;
            let block = statement.query_row([machine.as_str(), id.as_str()], |row| {
                Ok(block_of(row.get_ref(0)?.as_blob_or_null()?, row.get(1)?))
            });
            block.optional()?.transpose()
        };
        let block = read();
        *wary_until = (begun.elapsed() > WAITED).then(|| Instant::now() + WARY);
        match block {
            Err(StoreError::Unavailable(_)) => None,
            told => Some(told),
        }
    }

    /// Closes it, when it has been read from.
    pub(super) fn close(&self) {
        *self.reader.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

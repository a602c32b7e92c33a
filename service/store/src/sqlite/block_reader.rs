//! Blocks of samples, read on the thread that asks.
//!
//! A cycle's samples are one row: finding it takes some microseconds where its pages are in the system's cache, less than
//! waking another connection's thread and being woken by it. Where they are not, the thread waits for the disk. So only
//! one reads like this at a time, and only where the runtime has another thread for everything else.

use super::open::SETTINGS;
use crate::error::StoreResult;
use feedwright_core::ids::{CycleId, MachineId};
use rusqlite::{Connection, OpenFlags, OptionalExtension};
use std::path::Path;
use std::sync::{Mutex, PoisonError, TryLockError};
use std::time::Duration;
use tokio::runtime::Handle;

/// What the connection keeps of the file, in KiB below zero: the upper pages of two indexes. The system keeps the rest.
const CACHE: &str = "-256";

/// A connection that reads blocks.
#[derive(Debug)]
pub(super) struct BlockReader {
    /// `None` once closed.
    conn: Mutex<Option<Connection>>,
}

impl BlockReader {
    /// Opens a file that is there.
    pub(super) fn open(path: &Path, patience: Duration) -> StoreResult<Self> {
        // No lock around every call: who holds it is the only one to use it.
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let conn = Connection::open_with_flags(path, flags)?;
        conn.busy_timeout(patience)?;
        for (name, value) in SETTINGS.into_iter().chain([("cache_size", CACHE)]) {
            conn.pragma_update(None, name, value)?;
        }
        Ok(Self { conn: Mutex::new(Some(conn)) })
    }

    /// What `statement` finds, a block, for a cycle's machine and id; `None` where this thread is not to wait for it, as
    /// where somebody else is reading, and after the end.
    pub(super) fn read(
        &self,
        statement: &str,
        machine: &MachineId,
        id: &CycleId,
    ) -> Option<StoreResult<Option<Vec<u8>>>> {
        if Handle::try_current().is_ok_and(|runtime| runtime.metrics().num_workers() < 2) {
            return None;
        }
        let conn = match self.conn.try_lock() {
            Ok(conn) => conn,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return None,
        };
        let conn = conn.as_ref()?;
        let read = || {
            let mut statement = conn.prepare_cached(statement)?;
            statement.query_row([machine.as_str(), id.as_str()], |row| row.get(0)).optional()
        };
        Some(read().map_err(Into::into))
    }

    /// Closes it, when it has been read from.
    pub(super) fn close(&self) {
        *self.conn.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

//! What fails with a file, told of that file and by its cause. "The database does not take writes" is said of the database
//! that a server works on, and of no backup.

use super::TransferError;
use crate::fault::REFUSED_READS;
use std::error::Error;
use std::fmt::Display;
use std::io;
use std::path::Path;

/// SQLite's result codes, without what more they say.
const IOERR: i32 = 10;
const CORRUPT: i32 = 11;
const FULL: i32 = 13;
const CANTOPEN: i32 = 14;
const NOTADB: i32 = 26;

const NO_SPACE: &str = "no space is left for it";

pub(super) fn file(path: &Path, why: impl Display) -> TransferError {
    TransferError::File { path: path.display().to_string(), why: why.to_string() }
}

/// What the system says of a file.
pub(super) fn io(path: &Path, what: &str, error: &io::Error) -> TransferError {
    use io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
    match error.kind() {
        StorageFull | QuotaExceeded | FileTooLarge => file(path, format!("{NO_SPACE} ({error})")),
        _ => file(path, format!("{what} ({error})")),
    }
}

/// A failure while `target` was made: it is that file's, where it is SQLite that cannot write.
pub(super) fn of_target(target: &Path, error: impl Into<TransferError>) -> TransferError {
    let error = error.into();
    match failure(&error) {
        Some((code, _)) if is_read(code) => error,
        Some((code, what)) => match code & 0xff {
            FULL => file(target, NO_SPACE),
            IOERR => file(target, format!("cannot be written; is there space left for it? ({what})")),
            CANTOPEN => file(target, format!("cannot be written ({what})")),
            _ => error,
        },
        None => error,
    }
}

/// A failure while the database in the file `source` was read.
pub(super) fn of_source(source: &Path, error: impl Into<TransferError>) -> TransferError {
    let error = error.into();
    match failure(&error) {
        Some((code, what)) if is_read(code) => file(source, format!("cannot be read ({what})")),
        Some((code, what)) => match code & 0xff {
            CORRUPT | NOTADB => file(source, format!("is damaged ({what})")),
            CANTOPEN => file(source, format!("cannot be opened ({what})")),
            _ => error,
        },
        None => error,
    }
}

/// A failure while a copy of `backup` was read.
pub(super) fn of_backup(backup: &Path, error: impl Into<TransferError>) -> TransferError {
    let error = error.into();
    match failure(&error) {
        Some((code, what)) if is_read(code) => file(backup, format!("is damaged ({what})")),
        Some((code, what)) => match code & 0xff {
            CORRUPT => file(backup, format!("is damaged ({what})")),
            NOTADB => file(backup, "is no backup of this program, or damaged"),
            _ => error,
        },
        None => error,
    }
}

/// Whether reading failed, or found less than there has to be.
fn is_read(code: i32) -> bool {
    REFUSED_READS.contains(&code.cast_unsigned())
}

/// What SQLite says, with its extended code; `None` where it is not SQLite that fails.
fn failure(error: &TransferError) -> Option<(i32, String)> {
    let mut next: Option<&(dyn Error + 'static)> = Some(error);
    while let Some(error) = next {
        if let Some(sqlx::Error::Database(database)) = error.downcast_ref()
            && let Some(found) = database.try_downcast_ref::<sqlx::sqlite::SqliteError>()
        {
            let code = sqlx::error::DatabaseError::code(found)?.parse().ok()?;
            return Some((code, sqlx::error::DatabaseError::message(found).to_owned()));
        }
        if let Some(rusqlite::Error::SqliteFailure(found, message)) = error.downcast_ref() {
            return Some((found.extended_code, message.clone().unwrap_or_else(|| found.to_string())));
        }
        next = error.source();
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use sqlx::ConnectOptions;

    /// A disk that is full cannot be had in every test; a file that may have no more pages is.
    #[tokio::test]
    async fn a_full_disk_is_told_as_one() {
        let mut conn = sqlx::sqlite::SqliteConnectOptions::new().in_memory(true).connect().await.unwrap();
        for statement in ["PRAGMA max_page_count = 3", "CREATE TABLE t (b BLOB)"] {
            sqlx::query(statement).fetch_all(&mut conn).await.unwrap();
        }
        let full =
            sqlx::query("INSERT INTO t VALUES (zeroblob(100000))").execute(&mut conn).await.unwrap_err();
        let store = crate::StoreError::from(full);
        assert_eq!(store.to_string(), "the database does not take writes");
        assert_eq!(of_target(Path::new("/b/k"), store).to_string(), "/b/k: no space is left for it");
        let system = io(Path::new("/b/k"), "cannot be written", &io::Error::from(io::ErrorKind::StorageFull));
        assert!(system.to_string().starts_with("/b/k: no space is left for it ("), "{system}");
        // What is no file's stays what it is.
        let missing = sqlx::query("SELECT * FROM none").fetch_all(&mut conn).await.unwrap_err();
        assert!(matches!(of_target(Path::new("/b/k"), missing), TransferError::Store(_)));
    }
}

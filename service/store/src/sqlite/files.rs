//! Whether the files that are written are those that stand under the database's name.
//!
//! SQLite goes on with a file that somebody removes or replaces under it, and all it commits is gone with the process.

use crate::error::{StoreError, StoreResult};
use std::borrow::Cow;
use std::io;
use std::path::{Path, PathBuf};

/// A file by what the file system calls it, which no other one is called as long as it is open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Identity {
    device: u64,
    inode: u64,
}

impl Identity {
    /// Of the file that stands under a name.
    pub(super) fn of(path: &Path) -> StoreResult<Self> {
        identity(path).map_err(|error| missing(path, &error))
    }

    /// # Errors
    ///
    /// `NotWritable` where no file stands under a name any more, or another one does.
    pub(super) fn is_that_of(self, path: &Path) -> StoreResult<()> {
        if Self::of(path)? == self {
            return Ok(());
        }
        let what = format!("{} was replaced while it was open", path.display());
        Err(StoreError::NotWritable(what.into()))
    }
}

/// How the name of SQLite's log ends.
const LOG: &str = "-wal";
/// How that of the index to the log ends, by which its processes keep out of each other's way: where it is removed, another process makes
/// one of its own, and both write.
const INDEX: &str = "-shm";

/// The file whose name is another one's with something behind it.
pub(crate) fn beside(file: &Path, end: &str) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(end);
    name.into()
}

/// A file by a name that SQLite takes for one: what begins with `file:` is an address to it, and leads to another file, or to
/// none.
pub(crate) fn by_name(file: &Path) -> Cow<'_, Path> {
    if file.as_os_str().as_encoded_bytes().starts_with(b"file:") {
        return Path::new(".").join(file).into();
    }
    file.into()
}

/// The database's file, its log and the index to that, as they were when they were opened.
#[derive(Debug)]
pub(super) struct Files([(PathBuf, Identity); 3]);

impl Files {
    /// Of a database that is open, and has its log; `found` is the file before the first of its connections was.
    pub(super) fn of(path: &Path, found: Identity) -> StoreResult<Self> {
        // SQLite follows a link, and keeps its log beside what the link leads to.
        let leads_to = path.canonicalize().map_err(|error| missing(path, &error))?;
        let opened = |end| {
            let beside = beside(&leads_to, end);
            Identity::of(&beside).map(|identity| (beside, identity))
        };
        let files = Self([(path.to_owned(), found), opened(LOG)?, opened(INDEX)?]);
        files.are_there()?;
        Ok(files)
    }

    /// Nothing that was committed may be acknowledged where this fails.
    ///
    /// # Errors
    ///
    /// `NotWritable` where one of them is no longer there, or is another one.
    pub(super) fn are_there(&self) -> StoreResult<()> {
        self.0.iter().try_for_each(|(path, opened)| opened.is_that_of(path))
    }
}

/// What SQLite has left of a database that stood under a name, and is not there: its log or journal, where something is in
/// it. SQLite would write it over the file that comes there next, or empty it, and with it what was acknowledged.
pub(crate) fn log_left(database: &Path) -> Option<PathBuf> {
    let holds_something = |left: &PathBuf| left.metadata().is_ok_and(|found| found.len() > 0);
    let left = [LOG, "-journal"].map(|end| beside(database, end)).into_iter().find(holds_something);
    left.filter(|_| !database.exists())
}

fn missing(path: &Path, error: &io::Error) -> StoreError {
    let what = match error.kind() {
        io::ErrorKind::NotFound => format!("{} was removed while it was open", path.display()),
        _ => format!("{} cannot be found: {error}", path.display()),
    };
    StoreError::NotWritable(what.into())
}

#[cfg(unix)]
fn identity(path: &Path) -> io::Result<Identity> {
    use std::os::unix::fs::MetadataExt;
    let found = std::fs::metadata(path)?;
    Ok(Identity { device: found.dev(), inode: found.ino() })
}

/// Elsewhere a file that is open is neither removed nor replaced.
#[cfg(not(unix))]
fn identity(path: &Path) -> io::Result<Identity> {
    std::fs::metadata(path).map(|_| Identity { device: 0, inode: 0 })
}

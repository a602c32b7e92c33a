//! The data directory: made for its owner only, and locked, so that two servers never open one SQLite database.

use feedwright_store::durable::sync_name;
use std::fs::{DirBuilder, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// The file that is locked; while a server runs it holds the address that it listens on.
const LOCK: &str = "feedwright.lock";

/// Why the data directory cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DataDirError {
    /// The system refuses.
    #[error("cannot use the data directory {path}")]
    Io {
        /// Which directory.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Another process has it.
    #[error("the data directory {path} is in use by a server{}", at(.address))]
    InUse {
        /// Which directory.
        path: PathBuf,
        /// Where the server that uses it listens, where it says so.
        address: Option<String>,
    },
}

fn at(address: &Option<String>) -> String {
    address.as_ref().map(|address| format!(" that listens on {address}")).unwrap_or_default()
}

/// Makes a directory, and those that it stands in where they are not there, under names that are durable: what is acknowledged stands in it.
fn make(path: &Path) -> io::Result<()> {
    let made: Vec<&Path> =
        path.ancestors().take_while(|made| !made.as_os_str().is_empty() && !made.is_dir()).collect();
    DirBuilder::new().recursive(true).mode(0o700).create(path)?;
    made.into_iter().rev().try_for_each(sync_name)
}

/// The lock on a data directory; dropped, it is free.
#[derive(Debug)]
pub struct DataDirLock {
    file: File,
}

impl DataDirLock {
    /// Makes the directory where it is not there, and locks it.
    pub fn acquire(path: &Path) -> Result<Self, DataDirError> {
        let failed = |source| DataDirError::Io { path: path.to_owned(), source };
        if !path.is_dir() {
            make(path).map_err(failed)?;
        }
        // The directory may have been made by hand: warn, since its owner may want it so.
        let mode = path.metadata().map_err(failed)?.permissions().mode();
        if mode & 0o077 != 0 {
            tracing::warn!(path = %path.display(), mode = format!("{:o}", mode & 0o777), "data directory is open to others");
        }
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false).mode(0o600);
        let mut file = options.open(path.join(LOCK)).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => {
                file.set_len(0).map_err(failed)?;
                Ok(Self { file })
            }
            Err(TryLockError::WouldBlock) => {
                let mut address = String::new();
                file.read_to_string(&mut address).map_err(failed)?;
                let address = Some(address.trim().to_owned()).filter(|address| !address.is_empty());
                Err(DataDirError::InUse { path: path.to_owned(), address })
            }
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }

    /// Tells other processes of this machine where the server listens.
    pub fn publish(&mut self, address: &str) -> io::Result<()> {
        self.file.rewind()?;
        self.file.set_len(0)?;
        writeln!(self.file, "{address}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_has_the_directory_and_the_other_learns_where_it_listens() {
        let path = std::env::temp_dir().join(format!("feedwright-lock-{}", uuid::Uuid::now_v7()));
        let mut lock = DataDirLock::acquire(&path).unwrap();
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o777, 0o700);
        lock.publish("127.0.0.1:7878").unwrap();
        match DataDirLock::acquire(&path) {
            Err(DataDirError::InUse { address, .. }) => {
                assert_eq!(address.as_deref(), Some("127.0.0.1:7878"));
            }
            other => panic!("{other:?}"),
        }
        drop(lock);
        assert!(DataDirLock::acquire(&path).is_ok());
        std::fs::remove_dir_all(&path).unwrap();
    }
}

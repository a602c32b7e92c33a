//! A folder for the copy of a backup, which is as large as that: it goes when its command ends, also by a signal, and where
//! that was killed, when the next one begins.

use anyhow::{Context, bail};
use std::fs::{DirBuilder, File};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use tokio::signal::unix::{SignalKind, signal};

const PREFIX: &str = "feedwright-scratch-";
/// The file that its owner holds locked.
const LOCK: &str = "lock";

/// Runs something in a folder of its own, in the system's folder for such (`TMPDIR`).
pub(super) async fn within<T>(work: impl AsyncFnOnce(PathBuf) -> anyhow::Result<T>) -> anyhow::Result<T> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let scratch = Scratch::make(&std::env::temp_dir())?;
    tokio::select! {
        outcome = work(scratch.folder.clone()) => outcome,
        _ = terminate.recv() => bail!("it was told to stop"),
        _ = interrupt.recv() => bail!("it was interrupted"),
    }
}

/// A folder that nobody else has, for as long as this is kept.
struct Scratch {
    folder: PathBuf,
    _lock: File,
}

impl Scratch {
    fn make(within: &Path) -> anyhow::Result<Self> {
        let folder = within.join(format!("{PREFIX}{}", uuid::Uuid::now_v7()));
        let made = || -> io::Result<File> {
            DirBuilder::new().mode(0o700).create(&folder)?;
            let lock = File::create_new(folder.join(LOCK))?;
            lock.lock()?;
            remove_left(within, folder.metadata()?.uid())?;
            Ok(lock)
        };
        let lock = made().with_context(|| format!("cannot make {}", folder.display()))?;
        Ok(Self { folder, _lock: lock })
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(&self.folder) {
            tracing::warn!(%error, folder = %self.folder.display(), "a copy is left behind");
        }
    }
}

/// Removes the folders that killed commands of the same user have left.
fn remove_left(within: &Path, user: u32) -> io::Result<()> {
    for entry in within.read_dir()?.filter_map(Result::ok) {
        let is_one = entry.file_name().to_str().is_some_and(|name| name.starts_with(PREFIX));
        // Of the entry itself: what another user put there may lead anywhere.
        let is_own = entry.metadata().is_ok_and(|found| found.is_dir() && found.uid() == user);
        if is_one && is_own && is_left(&entry.path().join(LOCK)) {
            let folder = entry.path();
            match std::fs::remove_dir_all(&folder) {
                Ok(()) => {
                    tracing::info!(folder = %folder.display(), "a copy that a killed command left is removed");
                }
                Err(error) => tracing::warn!(%error, folder = %folder.display(), "a copy is left behind"),
            }
        }
    }
    Ok(())
}

/// Whether nobody holds the lock. A folder without one is being made, or holds nothing yet.
fn is_left(lock: &Path) -> bool {
    File::open(lock).is_ok_and(|lock| lock.try_lock().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_goes_with_its_command_or_with_the_next_one() {
        let within = tempfile::tempdir().unwrap();
        let names =
            || within.path().read_dir().unwrap().map(|entry| entry.unwrap().path()).collect::<Vec<_>>();
        let one = Scratch::make(within.path()).unwrap();
        std::fs::write(one.folder.join("copy"), "much").unwrap();
        let another = Scratch::make(within.path()).unwrap();
        assert_eq!(names().len(), 2, "neither takes the other's away");
        drop(another);
        assert_eq!(names(), std::slice::from_ref(&one.folder));
        // A killed command lets go of its lock, and of nothing else.
        let left = within.path().join(format!("{PREFIX}0"));
        std::fs::create_dir(&left).unwrap();
        std::fs::write(left.join(LOCK), "").unwrap();
        std::fs::write(left.join("copy"), "much").unwrap();
        let foreign = within.path().join("others");
        std::fs::create_dir(&foreign).unwrap();
        let third = Scratch::make(within.path()).unwrap();
        assert!(!left.exists() && foreign.exists() && one.folder.join("copy").exists());
        drop((one, third));
        assert_eq!(names(), [foreign]);
    }
}

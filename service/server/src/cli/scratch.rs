//! A folder for the copy of a backup, which is as large as that: it goes when its command ends, also by a signal, and where
//! that was killed, when the next one begins.
//!
//! Its owner holds the folder itself locked. Who removes one that was left holds it too meanwhile, and a folder that was taken
//! away between making and locking it is made again under another name.

use super::stop::{self, Stop};
use anyhow::Context;
use std::fs::{DirBuilder, File, TryLockError};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

const PREFIX: &str = "feedwright-scratch-";
/// Whoever finds a new folder in the moment before it is locked takes it for one that was left: not twice in a row.
const TRIES: usize = 8;

/// Runs something in a folder of its own, in the system's folder for such (`TMPDIR`). A signal ends the process, whatever is
/// under way there.
pub(super) async fn within<T>(work: impl AsyncFnOnce(PathBuf) -> anyhow::Result<T>) -> anyhow::Result<T> {
    let mut stop = Stop::listen();
    let scratch = Scratch::make(&std::env::temp_dir())?;
    let folder = scratch.folder.clone();
    let kept = Arc::new(Mutex::new(Some(scratch)));
    let of_signal = Arc::clone(&kept);
    // A task of its own: copying a file and asking for its being on the disk do not wait for it.
    let stopping = tokio::spawn(async move {
        stop.told().await;
        let scratch = of_signal.lock().unwrap_or_else(PoisonError::into_inner).take();
        if scratch.is_some() {
            drop(scratch);
            stop::end();
        }
    });
    let outcome = work(folder).await;
    drop(kept.lock().unwrap_or_else(PoisonError::into_inner).take());
    stopping.abort();
    outcome
}

/// A folder that nobody else has, for as long as this is kept.
struct Scratch {
    folder: PathBuf,
    _lock: File,
}

impl Scratch {
    fn make(within: &Path) -> anyhow::Result<Self> {
        for _ in 0..TRIES {
            let folder = within.join(format!("{PREFIX}{}", uuid::Uuid::now_v7()));
            let made = Self::at(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
            if let Some(scratch) = made {
                remove_left(within, &scratch);
                return Ok(scratch);
            }
        }
        anyhow::bail!("whatever is made in {} is taken away", within.display())
    }

    /// `None` where another command has taken the folder for one that was left.
    fn at(folder: &Path) -> io::Result<Option<Self>> {
        DirBuilder::new().mode(0o700).create(folder)?;
        let lock = match File::open(folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            opened => opened?,
        };
        match lock.try_lock() {
            Err(TryLockError::WouldBlock) => return Ok(None),
            // Where the file system has no locks nobody can hold one of this either, and nobody removes it.
            Ok(()) | Err(TryLockError::Error(_)) => {}
        }
        // Locked when it was gone already.
        Ok(folder.exists().then(|| Self { folder: folder.to_owned(), _lock: lock }))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        remove(&self.folder);
    }
}

/// Removes the folders that killed commands of the same user have left. One that cannot be looked at stays.
fn remove_left(within: &Path, own: &Scratch) {
    let (Ok(entries), Ok(user)) = (within.read_dir(), own.folder.metadata().map(|own| own.uid())) else {
        return;
    };
    for entry in entries.filter_map(Result::ok) {
        let folder = entry.path();
        let is_one = entry.file_name().to_str().is_some_and(|name| name.starts_with(PREFIX));
        // Of the entry itself: what another user put there may lead anywhere.
        let is_own = is_one && entry.metadata().is_ok_and(|found| found.is_dir() && found.uid() == user);
        if is_own
            && let Ok(lock) = File::open(&folder)
            && lock.try_lock().is_ok()
            && folder.exists()
        {
            tracing::info!(folder = %folder.display(), "a copy that a killed command left is removed");
            remove(&folder);
        }
    }
}

fn remove(folder: &Path) {
    match std::fs::remove_dir_all(folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            tracing::warn!(%error, folder = %folder.display(), "a copy is left behind");
        }
        _ => {}
    }
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
        // A killed command lets go of its lock, and of nothing else; what was in the middle of being removed may hold anything.
        for (name, holds) in [("0", &["copy"][..]), ("1", &[])] {
            let left = within.path().join(format!("{PREFIX}{name}"));
            std::fs::create_dir(&left).unwrap();
            holds.iter().for_each(|file| std::fs::write(left.join(file), "much").unwrap());
        }
        let foreign = within.path().join("others");
        std::fs::create_dir(&foreign).unwrap();
        std::os::unix::fs::symlink(&foreign, within.path().join(format!("{PREFIX}2"))).unwrap();
        let third = Scratch::make(within.path()).unwrap();
        assert!(foreign.exists() && one.folder.join("copy").exists());
        assert_eq!(
            names().len(),
            4,
            "its own, the other one's, what is not of this program, and the way to it"
        );
        drop((one, third));
        assert_eq!(names().len(), 2);
    }

    #[test]
    fn commands_that_begin_together_keep_their_folders() {
        let within = tempfile::tempdir().unwrap();
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..50 {
                        let scratch = Scratch::make(within.path()).unwrap();
                        std::fs::write(scratch.folder.join("copy"), "much").unwrap();
                        assert!(scratch.folder.join("copy").exists());
                    }
                });
            }
        });
        assert_eq!(within.path().read_dir().unwrap().count(), 0);
    }
}

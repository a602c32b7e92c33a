//! SQLite's file and its write-ahead log, beside the store.

use super::given::{Given, Run, commit, shop, stored};
use feedwright_core::units::Timestamp;
use feedwright_store::{SqliteOptions, SqliteStore, Store, StoreError};
use std::time::Duration;

/// What stays of a log that was made longer, bytes.
const KEPT: u64 = 64 << 20;

/// Looks that are taken, and the time between them: what is waited for comes with a checkpoint.
const LOOKS: u32 = 300;
const BETWEEN: Duration = Duration::from_millis(50);

#[tokio::test]
async fn a_log_that_was_made_long_is_cut_once_it_is_in_the_file() {
    let given = Given::sqlite().await;
    let store = given.store();
    shop(&*store).await;
    let log = given.file().with_extension("sqlite3-wal");
    let length = || std::fs::metadata(&log).unwrap().len();
    given.raw("CREATE TABLE much AS SELECT zeroblob(100 << 20) AS bytes").await.unwrap();
    assert!(length() > KEPT, "the log is long");
    let mut looks = 0;
    while length() > KEPT {
        looks += 1;
        assert!(looks < LOOKS, "the log stays long: {} bytes", length());
        stored(&*store, &Run::nth(looks)).await;
        tokio::time::sleep(BETWEEN).await;
    }
    given.done().await;
}

/// SQLite itself would go on, and everything that it commits would be gone with the process.
#[tokio::test]
async fn nothing_is_acknowledged_of_files_that_are_no_longer_there() {
    for (ending, replaced) in
        [("sqlite3", false), ("sqlite3-wal", false), ("sqlite3-shm", false), ("sqlite3", true)]
    {
        let given = Given::sqlite().await;
        let store = given.store();
        shop(&*store).await;
        stored(&*store, &Run::nth(1)).await;
        let file = given.file().with_extension(ending);
        if replaced {
            let copy = file.with_extension("copy");
            std::fs::copy(&file, &copy).unwrap();
            std::fs::rename(&copy, &file).unwrap();
        } else {
            std::fs::remove_file(&file).unwrap();
        }
        let Some(Err(StoreError::NotWritable(why))) = commit(&*store, &[Run::nth(2)]).await.pop() else {
            panic!("{ending} is missed");
        };
        let said = if replaced { "was replaced while it was open" } else { "was removed while it was open" };
        assert_eq!(why.to_string(), format!("{} {said}", file.display()));
        let other = store.probe_write(Timestamp::from_micros(1)).await;
        assert!(matches!(other, Err(StoreError::NotWritable(_))), "{other:?}");
    }
}

#[tokio::test]
async fn a_link_leads_to_the_file_and_its_log() {
    let folder = tempfile::tempdir().unwrap();
    let (file, link) = (folder.path().join("disk.sqlite3"), folder.path().join("linked.sqlite3"));
    std::os::unix::fs::symlink(&file, &link).unwrap();
    let new = SqliteStore::open(&link, SqliteOptions::default()).await.unwrap();
    shop(&new).await;
    new.close().await;
    let store = SqliteStore::open(&link, SqliteOptions::default()).await.unwrap();
    stored(&store, &Run::nth(1)).await;
    std::fs::remove_file(&link).unwrap();
    let lost = commit(&store, &[Run::nth(2)]).await.pop().unwrap();
    assert!(matches!(lost, Err(StoreError::NotWritable(_))), "{lost:?}");
}

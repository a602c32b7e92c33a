//! SQLite's file and its write-ahead log, beside the store.

use super::given::{Given, Run, at, commit, engineer, shop, stored, tool};
use feedwright_core::units::Timestamp;
use feedwright_store::{Page, Precondition, SqliteOptions, SqliteStore, Store, StoreError};
use sqlx::{ConnectOptions, Connection};
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

/// What a disk gives in place of a page, or instead of EIO, is told as what it is: nobody wanted to write.
#[tokio::test]
async fn a_page_that_cannot_be_read_is_no_refused_write() {
    let given = Given::sqlite().await;
    shop(&*given.store()).await;
    given.store().close().await;
    let mut conn = sqlx::sqlite::SqliteConnectOptions::new().filename(given.file()).connect().await.unwrap();
    let place: (i64, i64) = sqlx::query_as(
        "SELECT rootpage, page_size FROM sqlite_schema, pragma_page_size WHERE name = 'audit' AND type = 'table'",
    )
    .fetch_one(&mut conn)
    .await
    .unwrap();
    conn.close().await.unwrap();
    let page = usize::try_from(place.1).unwrap();
    let begin = usize::try_from(place.0 - 1).unwrap() * page;
    let mut bytes = std::fs::read(given.file()).unwrap();
    bytes[begin..begin + page].fill(0xff);
    std::fs::write(given.file(), bytes).unwrap();

    let store = SqliteStore::open(given.file(), SqliteOptions::default()).await.unwrap();
    let read = store.audit(Page { after: None, limit: 9 }).await;
    assert!(matches!(read, Err(StoreError::NotReadable(_))), "{read:?}");
    assert_eq!(store.machines(Page { after: None, limit: 9 }).await.unwrap().len(), 1, "the rest is read");
    // For a change it is as any failure of the disk: nothing is acknowledged any more.
    let written = store.put_tool(tool("T9"), Precondition::Absent, &engineer(), at(1)).await;
    assert!(matches!(written, Err(StoreError::NotReadable(_))), "{written:?}");
    let other = store.probe_write(at(2)).await;
    assert!(matches!(other, Err(StoreError::NotWritable(_))), "{other:?}");
    store.close().await;
    given.done().await;
}

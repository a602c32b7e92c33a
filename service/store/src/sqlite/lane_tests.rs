//! Reads that never end, and what has to be answered beside them.

use super::*;
use crate::store::Store;
use feedwright_core::ids::ToolId;
use std::sync::atomic::{AtomicUsize, Ordering};

async fn opened(folder: &Path, patience: Duration) -> SqliteStore {
    let options = SqliteOptions { alone: true, patience, ..SqliteOptions::default() };
    SqliteStore::open(folder.join("cell.sqlite3"), options).await.unwrap()
}

/// Reads that have begun and never end, as many as there is room for.
async fn endless(
    store: &SqliteStore,
    lane: Lane,
    most: usize,
) -> Vec<tokio::task::JoinHandle<StoreResult<()>>> {
    let begun = Arc::new(AtomicUsize::new(0));
    let reads = (0..most).map(|_| {
        let (store, begun) = (store.clone(), Arc::clone(&begun));
        tokio::spawn(async move {
            let read = store.snapshot(lane, move |conn| {
                Box::pin(async move {
                    sqlx::query("SELECT COUNT(*) FROM cycles").execute(&mut *conn).await?;
                    begun.fetch_add(1, Ordering::SeqCst);
                    std::future::pending().await
                })
            });
            read.await
        })
    });
    let reads: Vec<tokio::task::JoinHandle<StoreResult<()>>> = reads.collect();
    while begun.load(Ordering::SeqCst) < most {
        assert!(reads.iter().all(|read| !read.is_finished()), "all of them have room");
        tokio::task::yield_now().await;
    }
    reads
}

async fn idle(store: &SqliteStore, wanted: u32) {
    while store.inner.readers.counts().1 < wanted {
        tokio::task::yield_now().await;
    }
}

#[tokio::test]
async fn what_posts_wait_for_is_read_however_many_read_long() {
    let folder = tempfile::tempdir().unwrap();
    let store = opened(folder.path(), Duration::from_secs(1)).await;
    let _long = endless(&store, Lane::Long, 2).await;
    let (tool, machine) = (ToolId::try_from("T1").unwrap(), MachineId::try_from("M1").unwrap());
    let refused = store.check_cycles(None, 1).await.unwrap_err();
    assert!(refused.is_of_other_reads(), "{refused:?}");
    let page = || crate::record::Page { after: None, limit: 10 };
    assert_eq!(store.tools(page()).await.unwrap(), vec![], "lists have room beside long reads");
    let _usual = endless(&store, Lane::Usual, 1).await;
    let refused = store.tools(page()).await.unwrap_err();
    assert!(refused.is_of_other_reads(), "{refused:?}");

    assert_eq!(store.token_by_hash(&[0; 32]).await.unwrap(), None);
    assert_eq!(store.session_by_hash(&[0; 32]).await.unwrap(), None);
    let operation = "O1".try_into().unwrap();
    let now = Timestamp::from_micros(1_777_874_400_000_000);
    assert_eq!(store.recent_surroundings(&machine, &operation, &tool, now).await.unwrap(), None);
    assert_eq!(store.machine(&machine).await.unwrap(), None);
    assert_eq!(store.verdict(&tool).await.unwrap().state, feedwright_core::wear::ToolState::Unknown);
    store.probe_write(now).await.unwrap();
    store.usage().await.unwrap();
}

#[tokio::test]
async fn a_read_that_nobody_waits_for_ends_and_its_connection_is_lent_again() {
    let folder = tempfile::tempdir().unwrap();
    let store = opened(folder.path(), Duration::from_secs(30)).await;
    for read in endless(&store, Lane::Long, 2).await {
        read.abort();
        assert!(read.await.unwrap_err().is_cancelled());
    }
    idle(&store, store.inner.readers.counts().0).await;
    // Neither is left in its transaction.
    for read in endless(&store, Lane::Long, 2).await {
        read.abort();
    }
}

#[tokio::test]
async fn closing_ends_what_reads_long() {
    let folder = tempfile::tempdir().unwrap();
    let store = opened(folder.path(), Duration::from_secs(30)).await;
    let reads = endless(&store, Lane::Long, 2).await;
    store.close().await;
    for read in reads {
        assert!(matches!(read.await.unwrap(), Err(StoreError::Unavailable(_))));
    }
}

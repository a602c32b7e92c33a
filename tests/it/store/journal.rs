//! SQLite's journal of groups: what was acknowledged by it is seen at once, and survives whatever ends the process.

use super::given::{Given, Run, at, commit, engineer, event, shop, stored};
use feedwright_core::tool::ToolEventKind;
use feedwright_store::transfer::{back_up_sqlite, restore_to_sqlite};
use feedwright_store::{Committed, CycleFilter, Page, Repair, SqliteOptions, SqliteStore, Store, StoreError};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A transaction that nobody asks about stays open as long as a story is told.
fn patient() -> SqliteOptions {
    SqliteOptions { alone: true, commit_after: Duration::from_secs(3600), ..SqliteOptions::default() }
}

async fn opened(file: &Path) -> SqliteStore {
    SqliteStore::open(file, patient()).await.unwrap()
}

fn journal_of(file: &Path) -> PathBuf {
    file.with_extension("sqlite3-groups")
}

/// Cycles that are committed to the database itself.
async fn committed(file: &Path) -> u32 {
    use sqlx::ConnectOptions;
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(file).read_only(true);
    let mut conn = options.connect().await.unwrap();
    sqlx::query_scalar("SELECT COUNT(*) FROM cycles").fetch_one(&mut conn).await.unwrap()
}

/// What the store tells of its cycles and of the tool, but for ids of chance.
async fn told(store: &dyn Store) -> Vec<String> {
    let page = Page { after: None, limit: 5000 };
    let mut lines = Vec::new();
    for cycle in store.cycles(&CycleFilter::default(), page).await.unwrap() {
        let samples = store.cycle_samples(&cycle.cycle.machine, &cycle.cycle.id).await.unwrap();
        lines.push(format!("{cycle:?} {samples:?}"));
    }
    lines.push(format!("{:?}", store.verdict(&"T1".try_into().unwrap()).await.unwrap()));
    lines
}

/// Groups that are committed at once: the first one asks what it rests on, and the second follows none that was written as a
/// whole.
const FIRST: u32 = 2;

/// A shop of which the first groups are committed, and so many more are acknowledged by the journal alone.
async fn ahead(file: &Path, groups: u32) -> SqliteStore {
    let store = opened(file).await;
    shop(&store).await;
    run(&store, 1..=FIRST + groups).await;
    assert_eq!(committed(file).await, FIRST, "the others are in the journal");
    store
}

async fn run(store: &dyn Store, cycles: std::ops::RangeInclusive<u32>) {
    for n in cycles {
        stored(store, &Run { sampled: n % 2 == 0, ..Run::nth(n) }).await;
    }
}

fn file_in(folder: &tempfile::TempDir) -> PathBuf {
    folder.path().join("cell.sqlite3")
}

/// The same cycles in a store that commits each group.
async fn plain(cycles: u32) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    let store = SqliteStore::open(file_in(&folder), SqliteOptions::default()).await.unwrap();
    shop(&store).await;
    run(&store, 1..=cycles).await;
    told(&store).await
}

#[tokio::test]
async fn what_a_process_leaves_in_it_is_taken_up() {
    let folder = tempfile::tempdir().unwrap();
    let file = file_in(&folder);
    // Without a word, as one that is killed.
    drop(ahead(&file, 11).await);
    assert_eq!(committed(&file).await, FIRST);
    let store = opened(&file).await;
    assert_eq!(committed(&file).await, 13);
    assert_eq!(told(&store).await, plain(13).await);
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    // It goes on from there, and once more.
    run(&store, 14..=20).await;
    assert!(committed(&file).await < 20);
    drop(store);
    let store = opened(&file).await;
    assert_eq!(told(&store).await, plain(20).await);
    store.close().await;
    assert!(!journal_of(&file).exists(), "nothing is left to take up");
    assert_eq!(committed(&file).await, 20);
}

#[tokio::test]
async fn who_asks_sees_what_was_acknowledged() {
    let folder = tempfile::tempdir().unwrap();
    let file = file_in(&folder);
    let store = ahead(&file, 2).await;
    let samples = store.cycle_samples(&"M1".try_into().unwrap(), &"c00004".try_into().unwrap()).await;
    assert!(samples.unwrap().is_some());
    assert_eq!(committed(&file).await, 4);
    stored(&store, &Run::nth(5)).await;
    assert_eq!(committed(&file).await, 4);
    assert_eq!(told(&store).await.len(), 6);
    assert_eq!(committed(&file).await, 5);
}

#[tokio::test]
async fn other_changes_come_behind_it() {
    let folder = tempfile::tempdir().unwrap();
    let file = file_in(&folder);
    let store = ahead(&file, 2).await;
    let changed = event(ToolEventKind::Changed, at(2_000));
    store.add_tool_event(&"T1".try_into().unwrap(), changed, &engineer(), at(0)).await.unwrap();
    assert_eq!(committed(&file).await, 4);
    stored(&store, &Run::nth(5)).await;
    drop(store);
    let store = opened(&file).await;
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    assert_eq!(committed(&file).await, 5);
}

/// A cycle that is known fails the group that took it for new: what was acknowledged before is in the transaction still.
#[tokio::test]
async fn a_group_that_fails_takes_nothing_along() {
    let folder = tempfile::tempdir().unwrap();
    let file = file_in(&folder);
    let store = ahead(&file, 5).await;
    let outcomes = commit(&store, &[Run { sampled: false, ..Run::nth(3) }, Run::nth(8)]).await;
    assert!(matches!(&outcomes[..], [Ok(Committed::Known(_)), Ok(Committed::Stored(_))]), "{outcomes:?}");
    // Groups ask first for a while.
    run(&store, 9..=20).await;
    assert!(committed(&file).await < 20, "the last are in the journal");
    drop(store);
    let store = opened(&file).await;
    assert_eq!(told(&store).await, plain(20).await);
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
}

/// Where each record of a journal ends, the head being the first.
fn ends(journal: &[u8]) -> Vec<usize> {
    let mut ends = vec![40];
    loop {
        let at = ends[ends.len() - 1];
        let length = u32::from_le_bytes(journal[at + 4..at + 8].try_into().unwrap());
        if length == 0 {
            return ends;
        }
        ends.push(at + 20 + usize::try_from(length).unwrap());
    }
}

/// A record that is not whole was not acknowledged, and neither was what would stand behind it.
#[tokio::test]
async fn it_ends_with_the_last_whole_record() {
    const GROUPS: usize = 4;
    let folder = tempfile::tempdir().unwrap();
    let file = file_in(&folder);
    drop(ahead(&file, 4).await);
    let whole = std::fs::read(journal_of(&file)).unwrap();
    let ends = ends(&whole);
    assert_eq!(ends.len(), GROUPS + 1);
    let mut places: Vec<usize> = ends.iter().flat_map(|end| [end - 1, *end, end + 1, end + 9]).collect();
    places.extend((40..ends[GROUPS]).step_by(997));
    for place in places {
        let acknowledged = ends[1..].iter().filter(|end| **end <= place).count();
        let cut = whole[..place].to_vec();
        let mut torn = whole.clone();
        torn[place] ^= 0x40;
        // Behind the last record a byte says nothing.
        let of_torn = if place < 40 { 0 } else { acknowledged };
        for (what, journal, groups) in [("cut", cut, acknowledged), ("torn", torn, of_torn)] {
            let copy = folder.path().join("copy.sqlite3");
            for ending in ["sqlite3", "sqlite3-wal"] {
                let from = file.with_extension(ending);
                if from.exists() {
                    std::fs::copy(&from, copy.with_extension(ending)).unwrap();
                }
            }
            std::fs::write(journal_of(&copy), journal).unwrap();
            let store = opened(&copy).await;
            let there = FIRST + u32::try_from(groups).unwrap();
            assert_eq!(committed(&copy).await, there, "{what} at {place}");
            assert_eq!(store.check_wear(Repair::No).await.unwrap().different, [], "{what} at {place}");
            store.close().await;
            std::fs::remove_file(&copy).unwrap();
        }
    }
}

#[tokio::test]
async fn what_is_committed_is_not_run_again() {
    let folder = tempfile::tempdir().unwrap();
    let file = file_in(&folder);
    let store = ahead(&file, 3).await;
    let journal = std::fs::read(journal_of(&file)).unwrap();
    store.close().await;
    // As if the process had ended between the commit and what it does behind it.
    std::fs::write(journal_of(&file), journal).unwrap();
    let store = opened(&file).await;
    assert_eq!(told(&store).await, plain(5).await);
    stored(&store, &Run::nth(6)).await;
    stored(&store, &Run::nth(7)).await;
    drop(store);
    drop(opened(&file).await);
    assert_eq!(committed(&file).await, 7);
}

/// It was acknowledged: nobody but a person throws it away.
#[tokio::test]
async fn that_of_another_state_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = file_in(&folder);
    let store = opened(&file).await;
    shop(&store).await;
    store.close().await;
    let old = std::fs::read(&file).unwrap();
    let store = opened(&file).await;
    run(&store, 1..=4).await;
    assert_eq!(told(&store).await.len(), 5);
    run(&store, 5..=5).await;
    let journal = std::fs::read(journal_of(&file)).unwrap();
    for there in [Some(&old), None] {
        let folder = tempfile::tempdir().unwrap();
        let file = file_in(&folder);
        if let Some(there) = there {
            std::fs::write(&file, there).unwrap();
        }
        std::fs::write(journal_of(&file), &journal).unwrap();
        let Err(StoreError::NotWritable(why)) = SqliteStore::open(&file, patient()).await else {
            panic!("the journal is missed");
        };
        let journal = journal_of(&file.canonicalize().unwrap());
        let said = format!("{} holds acknowledged cycles of another state", journal.display());
        assert!(why.to_string().starts_with(&said), "{why}");
        std::fs::rename(&journal, folder.path().join("away")).unwrap();
        opened(&file).await.close().await;
    }
}

/// More than a journal has room for, and cycles that it has no room for one by one.
#[tokio::test]
async fn what_it_has_no_room_for_is_committed() {
    let folder = tempfile::tempdir().unwrap();
    let file = file_in(&folder);
    let store = opened(&file).await;
    shop(&store).await;
    for n in 1..=40 {
        let runs: Vec<Run> = (0..40).map(|k| Run { sampled: true, ..Run::nth(n * 40 + k) }).collect();
        for outcome in commit(&store, &runs).await {
            assert!(matches!(outcome, Ok(Committed::Stored(_))), "{outcome:?}");
        }
    }
    let before = committed(&file).await;
    assert!(before > 40, "it was full in between: {before}");
    drop(store);
    let store = opened(&file).await;
    assert_eq!(committed(&file).await, 1600);
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
}

/// A copy of the file that others make holds all that was acknowledged before, whether its server runs or was killed.
#[tokio::test]
async fn a_backup_has_what_was_acknowledged_before() {
    for killed in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let file = file_in(&folder);
        let backup = folder.path().join("backup.sqlite3");
        let running = if killed {
            drop(ahead(&file, 4).await);
            None
        } else {
            let options = SqliteOptions { alone: true, ..SqliteOptions::default() };
            let store = SqliteStore::open(&file, options).await.unwrap();
            shop(&store).await;
            run(&store, 1..=6).await;
            Some(store)
        };
        back_up_sqlite(&file, &backup, at(1)).await.unwrap();
        assert_eq!(committed(&backup).await, 6, "killed: {killed}");
        // What is restored has a journal of its own.
        let restored = folder.path().join("restored.sqlite3");
        restore_to_sqlite(&backup, &restored).await.unwrap();
        let store = opened(&restored).await;
        stored(&store, &Run::nth(7)).await;
        stored(&store, &Run::nth(8)).await;
        drop(store);
        drop(opened(&restored).await);
        assert_eq!(committed(&restored).await, 8);
        drop(running);
    }
}

/// Groups that come far apart are committed one by one: a journal would be one more write.
#[tokio::test]
async fn groups_that_nobody_follows_are_committed() {
    let given = Given::sqlite_with(SqliteOptions {
        alone: true,
        commit_after: Duration::ZERO,
        ..SqliteOptions::default()
    })
    .await;
    let store = given.store();
    shop(&*store).await;
    for n in 1..=3 {
        stored(&*store, &Run::nth(n)).await;
        assert_eq!(committed(&given.file()).await, n);
    }
    given.done().await;
}

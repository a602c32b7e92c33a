//! SQLite's journal of groups: what was acknowledged by it is seen at once, and survives whatever ends the process.

use super::given::{Given, Run, at, commit, engineer, event, shop, stored};
use feedwright_core::tool::{Tool, ToolEventKind};
use feedwright_store::transfer::{back_up_sqlite, restore_to_sqlite};
use feedwright_store::{
    Committed, CycleFilter, Page, Precondition, ProfileMove, Renewed, Repair, SqliteOptions, SqliteStore,
    Store, StoreError,
};
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

/// The tool's folds, as they are committed.
async fn folds(file: &Path) -> Vec<(String, i64, i64, Vec<u8>, i64, i64)> {
    let columns = "SELECT machine_id, folded, fold_version, state, version, updated_at_us FROM tool_wear";
    sqlx::query_as(columns).fetch_all(&mut reading(file).await).await.unwrap()
}

/// Which operations the cycles of its one fold ran, as it is noted.
async fn ran(file: &Path) -> Option<Vec<u8>> {
    sqlx::query_scalar("SELECT ran FROM tool_wear").fetch_one(&mut reading(file).await).await.unwrap()
}

async fn reading(file: &Path) -> sqlx::SqliteConnection {
    use sqlx::ConnectOptions;
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(file).read_only(true);
    options.connect().await.unwrap()
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

#[tokio::test]
async fn a_feed_profile_in_force_is_remembered_and_every_move_of_it_is_heeded_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let file = file_in(&folder);
    let store = opened(&file).await;
    shop(&store).await;
    let id = super::feed_profiles::id("P1");
    let handed_out = async |n: u32| {
        let run = Run { seconds: 90_000 + i64::from(n) * 60, ..Run::nth(n) };
        let advice = stored(&store, &run).await.recommendation.recommendation;
        advice.profile.map(|profile| profile.version.version)
    };
    let first = super::feed_profiles::activated(&store, 300.0).await;
    for n in 1..=FIRST + 3 {
        assert_eq!(handed_out(n).await, Some(first));
    }
    assert_eq!(committed(&file).await, FIRST, "nothing that is asked for ends the transaction of the others");
    let second = super::feed_profiles::activated(&store, 310.0).await;
    assert_eq!(handed_out(11).await, Some(second));
    assert_eq!(handed_out(12).await, Some(second));
    for (n, left) in [(21, Some(first)), (31, None)] {
        let line = store.feed_profile(&id).await.unwrap().unwrap();
        let expects = Precondition::Version(line.revision);
        store.move_profile(&id, ProfileMove::Rollback, expects, &engineer(), at(5)).await.unwrap();
        assert_eq!((handed_out(n).await, handed_out(n + 1).await), (left, left));
    }
    let other = Tool { tool_type: "drill".to_owned(), ..super::given::tool("T1") };
    let third = super::feed_profiles::activated(&store, 320.0).await;
    assert_eq!((handed_out(41).await, handed_out(42).await), (Some(third), Some(third)));
    store.put_tool(other, Precondition::Version(1), &engineer(), at(6)).await.unwrap();
    assert_eq!(handed_out(43).await, None, "the tool is of another kind");
    store.close().await;
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
    run(&store, 21..=24).await;
    assert!(committed(&file).await < 24);
    store.close().await;
    assert!(!journal_of(&file).exists(), "nothing is left to take up");
    assert_eq!(committed(&file).await, 24);
}

/// The groups of a transaction write it once. Who takes their journal up has their cycles, and makes the fold again.
#[tokio::test]
async fn a_fold_is_written_with_the_commit() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("plain.sqlite3");
    let store = SqliteStore::open(&file, SqliteOptions::default()).await.unwrap();
    shop(&store).await;
    run(&store, 1..=13).await;
    let each = folds(&file).await;
    store.close().await;

    let file = file_in(&folder);
    let store = ahead(&file, 6).await;
    assert_eq!(folds(&file).await[0].1, i64::from(FIRST));
    assert_eq!(told(&store).await.len(), 9, "whoever asks has it committed");
    assert_eq!(folds(&file).await[0].1, 8);
    run(&store, 9..=13).await;
    store.close().await;
    assert_eq!(folds(&file).await, each, "as if each group had written it");

    let store = opened(&file).await;
    run(&store, 14..=20).await;
    let before = folds(&file).await;
    drop(store);
    let store = opened(&file).await;
    let behind = folds(&file).await;
    let ((_, folded, rules, _, version, _), tool) = (&behind[0], "T1".try_into().unwrap());
    assert_eq!((*folded, *rules), (20, 0), "of no rules, so that nobody believes it");
    assert!(*version > before[0].4, "nor takes it for the one of before");
    let noted = ran(&file).await;
    assert!(noted.is_some(), "which operations its cycles ran is known");
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    assert_eq!(told(&store).await, plain(20).await);
    assert_eq!(store.next_outdated_fold(None).await.unwrap().as_ref(), Some(&tool));
    assert_eq!(store.renew_fold(&tool, at(200_000)).await.unwrap(), Renewed::Whole);
    assert_eq!(store.next_outdated_fold(None).await.unwrap(), None);
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    store.close().await;
    assert_ne!(folds(&file).await[0].2, 0);
    assert_eq!(ran(&file).await, noted);
}

/// A transaction that cannot be committed is committed later, and nothing is acknowledged until then. SQLite may have
/// rolled it back by itself, or left it open.
#[tokio::test]
async fn a_commit_that_fails_is_made_up_for() {
    for outcome in ["ROLLBACK", "ABORT"] {
        let folder = tempfile::tempdir().unwrap();
        let file = file_in(&folder);
        let store = opened(&file).await;
        shop(&store).await;
        run(&store, 1..=FIRST).await;
        let refusing = async |what: &str| {
            use sqlx::ConnectOptions;
            let options = sqlx::sqlite::SqliteConnectOptions::new().filename(&file);
            let mut conn = options.connect().await.unwrap();
            sqlx::raw_sql(sqlx::AssertSqlSafe(what.to_owned())).execute(&mut conn).await.unwrap();
        };
        // Nobody else may write while the transaction is open: it fails until a moment that is set before.
        refusing(&format!(
            "CREATE TABLE refusal (until REAL NOT NULL);
             INSERT INTO refusal (until) VALUES (julianday('now', '+2 seconds'));
             CREATE TRIGGER refuse BEFORE UPDATE ON groups_journal
             WHEN julianday('now') < (SELECT until FROM refusal)
             BEGIN SELECT RAISE({outcome}, 'not yet'); END"
        ))
        .await;
        // The first that follows another one is the first of the transaction.
        run(&store, FIRST + 1..=FIRST + 4).await;
        assert_eq!(committed(&file).await, FIRST, "{outcome}");
        let everything = Page { after: None, limit: 100 };
        let refused = store.cycles(&CycleFilter::default(), everything.clone()).await;
        assert!(refused.is_err(), "{outcome}: it would not show what was acknowledged");
        let sent = Run { sampled: false, ..Run::nth(FIRST + 5) };
        assert!(commit(&store, std::slice::from_ref(&sent)).await.iter().all(Result::is_err), "{outcome}");
        assert_eq!(committed(&file).await, FIRST, "{outcome}");
        // Not to wait for it, but to look whether its time has come.
        while store.cycles(&CycleFilter::default(), everything.clone()).await.is_err() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        assert_eq!(committed(&file).await, FIRST + 4, "{outcome}");
        stored(&store, &sent).await;
        assert_eq!(told(&store).await, plain(FIRST + 5).await, "{outcome}");
        assert_eq!(store.check_wear(Repair::No).await.unwrap().different, [], "{outcome}");
        refusing("DROP TRIGGER refuse; DROP TABLE refusal").await;
        run(&store, FIRST + 6..=FIRST + 9).await;
        drop(store);
        let store = opened(&file).await;
        assert_eq!(told(&store).await, plain(FIRST + 9).await, "{outcome}");
    }
}

/// What it acknowledged is in the open transaction as well.
#[tokio::test]
async fn one_that_somebody_removes_or_replaces_is_done_without() {
    for replaced in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let file = file_in(&folder);
        let store = ahead(&file, 3).await;
        let journal = journal_of(&file);
        if replaced {
            std::fs::copy(&journal, folder.path().join("copy")).unwrap();
            std::fs::rename(folder.path().join("copy"), &journal).unwrap();
        } else {
            std::fs::remove_file(&journal).unwrap();
        }
        run(&store, 6..=7).await;
        assert_eq!(committed(&file).await, 7, "each is committed by itself from here on");
        drop(store);
        let store = opened(&file).await;
        assert_eq!(told(&store).await, plain(7).await);
        store.close().await;
    }
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

/// Where the records of a journal begin and end.
fn records(journal: &[u8]) -> Vec<std::ops::Range<usize>> {
    let (mut records, mut at) = (Vec::new(), 4096);
    loop {
        let length = u32::from_le_bytes(journal[at + 4..at + 8].try_into().unwrap());
        if length == 0 {
            return records;
        }
        records.push(at..at + 20 + usize::try_from(length).unwrap());
        at = records[records.len() - 1].end.next_multiple_of(4096);
    }
}

/// The last record that is not whole was not acknowledged. One with others behind it was: nothing is opened then.
#[tokio::test]
async fn it_ends_with_the_last_whole_record() {
    const GROUPS: usize = 4;
    let folder = tempfile::tempdir().unwrap();
    let file = file_in(&folder);
    drop(ahead(&file, 4).await);
    let whole = std::fs::read(journal_of(&file)).unwrap();
    let records = records(&whole);
    assert_eq!(records.len(), GROUPS);
    let ends = std::iter::once(40).chain(records.iter().flat_map(|record| [record.start, record.end]));
    let mut places: Vec<usize> = ends.flat_map(|end| [end - 1, end, end + 1, end + 9]).collect();
    places.extend((40..records[GROUPS - 1].end).step_by(997));
    for place in places {
        let cut_groups = records.iter().filter(|record| record.end <= place).count();
        // Between two records there is nothing that could be torn.
        let torn_groups = records.iter().position(|record| record.contains(&place)).unwrap_or(GROUPS);
        // The file has its whole length from its beginning on: what was not written yet is zeros.
        let without = |from: usize, mut journal: Vec<u8>| {
            journal[from..].fill(0);
            journal
        };
        let cut = without(place, whole.clone());
        let short = whole[..place].to_vec();
        let mut damaged = whole.clone();
        damaged[place] ^= 0x40;
        let mut torn = damaged.clone();
        if let Some(record) = records.get(torn_groups) {
            torn = without(record.end, torn);
        }
        let journals = [
            ("cut", cut, cut_groups),
            ("short", short, 0),
            ("torn", torn, torn_groups),
            ("damaged", damaged, torn_groups),
        ];
        for (what, journal, groups) in journals {
            let copy = folder.path().join("copy.sqlite3");
            for ending in ["sqlite3", "sqlite3-wal"] {
                let from = file.with_extension(ending);
                if from.exists() {
                    std::fs::copy(&from, copy.with_extension(ending)).unwrap();
                }
            }
            // The head says whose it is: it is written before anything is acknowledged, and never again.
            let is_headless = journal.get(..40) != whole.get(..40);
            std::fs::write(journal_of(&copy), journal).unwrap();
            let refused = is_headless || what == "short" || what == "damaged" && groups + 1 < GROUPS;
            if refused {
                assert!(matches!(SqliteStore::open(&copy, patient()).await, Err(StoreError::NotWritable(_))));
                std::fs::remove_file(journal_of(&copy)).unwrap();
                continue;
            }
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

/// It was acknowledged: nobody but a person throws it away. The epoch may fit, as it stands still where groups are far
/// apart, or not.
#[tokio::test]
async fn that_of_another_state_is_refused() {
    for asked in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let file = file_in(&folder);
        let store = opened(&file).await;
        shop(&store).await;
        run(&store, 1..=1).await;
        store.close().await;
        let old = std::fs::read(&file).unwrap();
        let store = opened(&file).await;
        run(&store, 2..=5).await;
        if asked {
            assert_eq!(told(&store).await.len(), 6);
        }
        run(&store, 6..=6).await;
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
            let journal = journal_of(&file);
            let said = format!("{} holds acknowledged cycles of another state", journal.display());
            assert!(why.to_string().starts_with(&said), "{why}");
            assert_eq!(file.exists(), there.is_some(), "nothing is made beside it");
            std::fs::rename(&journal, folder.path().join("away")).unwrap();
            opened(&file).await.close().await;
        }
    }
}

/// More groups than a journal has room for, and one that it has no room for by itself.
#[tokio::test]
async fn what_it_has_no_room_for_is_committed() {
    let folder = tempfile::tempdir().unwrap();
    let file = file_in(&folder);
    let store = opened(&file).await;
    shop(&store).await;
    let group = async |cycles: std::ops::Range<u32>| {
        let runs: Vec<Run> = cycles.map(|n| Run { sampled: true, ..Run::nth(n) }).collect();
        for outcome in commit(&store, &runs).await {
            assert!(matches!(outcome, Ok(Committed::Stored(_))), "{outcome:?}");
        }
    };
    group(0..40).await;
    group(40..80).await;
    assert_eq!(committed(&file).await, 80);
    group(80..120).await;
    assert_eq!(committed(&file).await, 80, "it is in the journal");
    group(120..3_000).await;
    assert_eq!(committed(&file).await, 3_000);
    for begins in (3_000..4_000).step_by(40) {
        group(begins..begins + 40).await;
    }
    let before = committed(&file).await;
    assert!(before > 3_000, "it was full in between");
    drop(store);
    let store = opened(&file).await;
    assert_eq!(committed(&file).await, 4_000);
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
}

/// What is restored has a journal of its own.
async fn restores(backup: &Path, folder: &tempfile::TempDir) {
    let restored = folder.path().join("restored.sqlite3");
    // It is of whatever stood there before.
    std::fs::copy(journal_of(&file_in(folder)), journal_of(&restored)).unwrap();
    let refused = restore_to_sqlite(backup, &restored).await.unwrap_err();
    assert!(refused.to_string().contains("restored.sqlite3-groups"), "{refused}");
    std::fs::remove_file(journal_of(&restored)).unwrap();
    restore_to_sqlite(backup, &restored).await.unwrap();
    let store = opened(&restored).await;
    let before = committed(&restored).await;
    run(&store, before + 1..=before + 4).await;
    assert_eq!(committed(&restored).await, before + FIRST);
    drop(store);
    drop(opened(&restored).await);
    assert_eq!(committed(&restored).await, before + 4);
}

/// Whoever makes a copy of the file has all that was acknowledged before.
#[tokio::test]
async fn a_backup_of_a_killed_server_has_what_was_acknowledged() {
    let folder = tempfile::tempdir().unwrap();
    let (file, backup) = (file_in(&folder), folder.path().join("backup.sqlite3"));
    drop(ahead(&file, 4).await);
    back_up_sqlite(&file, &backup, at(1)).await.unwrap();
    assert_eq!(committed(&backup).await, 6);
    restores(&backup, &folder).await;
}

#[tokio::test]
async fn a_backup_waits_for_what_a_server_has_acknowledged() {
    let folder = tempfile::tempdir().unwrap();
    let (file, backup) = (file_in(&folder), folder.path().join("backup.sqlite3"));
    let store = ahead(&file, 4).await;
    let (from, to) = (file.clone(), backup.clone());
    let mut copying = tokio::spawn(async move { back_up_sqlite(&from, &to, at(1)).await });
    // It cannot end before: nothing commits by itself here.
    tokio::time::timeout(Duration::from_millis(100), &mut copying).await.expect_err("it did not wait");
    assert_eq!(told(&store).await.len(), 7);
    copying.await.unwrap().unwrap();
    assert_eq!(committed(&backup).await, 6);
    restores(&backup, &folder).await;
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

//! Whole databases: backed up under load, restored, copied from a cell to the plant and back.

use super::feed_profiles::{self, activated};
use super::given::{
    Given, Run, WRONG_INDEX, at, commit, engineer, event, machine, new_cycle, settle, shop, stored, watched,
};
use feedwright_core::cycle::{Cycle, CycleDraft};
use feedwright_core::recommend::RecommendSettings;
use feedwright_core::tool::ToolEventKind;
use feedwright_core::units::Timestamp;
use feedwright_store::transfer::{
    Address, TableSum, TransferError, back_up_postgres, back_up_sqlite, copy, note_postgres, note_sqlite,
    restore_to_postgres, restore_to_sqlite,
};
use feedwright_store::{
    Actor, Committed, CycleFilter, CycleOverrides, NewProfileVersion, Page, PostgresOptions, PostgresStore,
    Precondition, QuarantineBounds, QuarantineEntry, Repair, Role, SampleRetention, Sent, SessionRecord,
    SqliteOptions, SqliteStore, Store, StoreError, StoreResult, TokenRecord,
};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection, PgConnection};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::Notify;

/// Something in every table that a shop fills: cycles with and without samples, quarantine, alarms, tokens, events.
async fn fill(store: &dyn Store) {
    shop(store).await;
    let who = engineer();
    store.put_machine(machine("M2"), Precondition::Absent, &who, at(1)).await.unwrap();
    for n in 1..=80 {
        let run = Run {
            machine: if n % 7 == 0 { "M2" } else { "M1" },
            tool: if n % 9 == 0 { "T2".to_owned() } else { "T1".to_owned() },
            sampled: n % 5 != 0,
            load: if n > 60 { 60.0 } else { 30.0 } + f64::from(n) * 0.07,
            ..Run::nth(n)
        };
        stored(store, &run).await;
    }
    let tool = "T1".try_into().unwrap();
    let changed = event(ToolEventKind::Changed, at(80 * 60));
    store.add_tool_event(&tool, changed, &who, at(9000)).await.unwrap();
    let entry = QuarantineEntry {
        id: "q1".to_owned(),
        machine: "M1".try_into().unwrap(),
        cycle: None,
        received_at: at(5),
        code: "out_of_range".to_owned(),
        problem: "{}".to_owned(),
        content_type: "application/json".to_owned(),
        settled: None,
        size: 3,
    };
    let bounds = QuarantineBounds { entries: 10, bytes: 1000 };
    store.quarantine(entry, b"{-}".to_vec(), bounds).await.unwrap();
    let token = TokenRecord {
        id: "tok-1".to_owned(),
        name: "MES".to_owned(),
        hash: [7; 32],
        role: Role::Viewer,
        machine: None,
        created_at: at(3),
        revoked_at: None,
    };
    store.create_token(token, &Actor { token: "cli".to_owned(), role: Role::Admin }).await.unwrap();
}

/// Everything that the trait shows, as text.
async fn shown(store: &dyn Store) -> Vec<String> {
    let mut lines = Vec::new();
    for cycle in store.cycles(&CycleFilter::default(), Page { after: None, limit: 1000 }).await.unwrap() {
        let samples = store.cycle_samples(&cycle.cycle.machine, &cycle.cycle.id).await.unwrap();
        lines.push(format!("{cycle:?} {samples:?}"));
    }
    for tool in ["T1", "T2"] {
        let tool = tool.try_into().unwrap();
        lines.push(format!("{:?}", store.verdict(&tool).await.unwrap()));
        lines.push(format!("{:?}", store.tool_events(&tool, Page { after: None, limit: 9 }).await.unwrap()));
    }
    lines.push(format!(
        "{:?}",
        store.alarms(&Default::default(), Page { after: None, limit: 99 }).await.unwrap()
    ));
    lines.push(format!("{:?}", store.audit(Page { after: None, limit: 99 }).await.unwrap()));
    lines.push(format!("{:?}", store.token_by_hash(&[7; 32]).await.unwrap()));
    lines.push(format!("{:?}", store.quarantine_entry("q1").await.unwrap()));
    lines
}

async fn sound(store: &dyn Store) {
    assert_eq!(store.check_tables().await.unwrap(), []);
    let page = store.check_cycles(None, 1000).await.unwrap();
    assert_eq!((page.checked > 0, page.faults.as_slice()), (true, [].as_slice()));
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
}

async fn copied(from: &Address, to: &Address) -> Result<(Vec<(String, TableSum)>, u64), TransferError> {
    let mut rows = 0;
    let sums = copy(from, to, &mut |_, _, written| rows += written).await?;
    Ok((sums, rows))
}

async fn sqlite(path: &Path) -> SqliteStore {
    SqliteStore::open(path, SqliteOptions::default()).await.unwrap()
}

#[tokio::test]
async fn a_cell_is_copied_to_the_plant_and_back_to_the_bit() {
    let Some(plant) = Given::postgres().await else {
        return;
    };
    let cell = Given::sqlite().await;
    fill(&*cell.store()).await;
    let (from, to) = (Address::Sqlite(cell.file()), Address::Postgres(plant.address()));
    let (sums, rows) = copied(&from, &to).await.unwrap();
    assert_eq!(sums.iter().map(|(_, sum)| sum.rows).sum::<u64>(), rows);
    assert!(sums.iter().any(|(table, sum)| table == "cycles" && sum.rows == 80), "{sums:?}");
    let store = PostgresStore::open(&plant.address(), PostgresOptions::default()).await.unwrap();
    assert_eq!(shown(&store).await, shown(&*cell.store()).await);
    sound(&store).await;
    // January's cycles are in a partition that retention can drop.
    let moved = plant.raw("UPDATE cycle_samples_202601 SET block = block").await.unwrap();
    assert_eq!(moved, 64);

    // A second time: nothing is left to write.
    assert_eq!(copied(&from, &to).await.unwrap().1, 0);
    // A copy that broke off goes on.
    for statement in
        ["DELETE FROM cycle_samples WHERE cycle_id > 'c00040'", "DELETE FROM tool_wear", "DELETE FROM alarms"]
    {
        plant.raw(statement).await.unwrap();
    }
    let (again, rows) = copied(&from, &to).await.unwrap();
    assert!(rows > 30 && rows < 80, "{rows}");
    assert_eq!(again, sums);

    // Numbers go on after those that came.
    let changed = event(ToolEventKind::Changed, at(90 * 60));
    let who = engineer();
    let added =
        store.add_tool_event(&"T1".try_into().unwrap(), changed, &who, at(9100)).await.unwrap().unwrap();
    let events =
        cell.store().tool_events(&"T1".try_into().unwrap(), Page { after: None, limit: 9 }).await.unwrap();
    assert!(added.id > events.last().unwrap().id);
    // What the plant has by itself now is not overwritten, nor lost by a copy from the cell.
    let refused = copied(&from, &to).await.unwrap_err();
    assert!(matches!(&refused, TransferError::OtherData { .. }), "{refused}");

    let folder = tempfile::tempdir().unwrap();
    let back = Address::Sqlite(folder.path().join("back.sqlite3"));
    copied(&to, &back).await.unwrap();
    let returned = sqlite(&folder.path().join("back.sqlite3")).await;
    assert_eq!(shown(&returned).await, shown(&store).await);
    sound(&returned).await;
    returned.close().await;
    store.close().await;
    cell.done().await;
    plant.done().await;
}

/// A copy that ends when it has told of its first table, as one that is killed does.
async fn broken_off(from: &Address, to: &Address) {
    let first = Notify::new();
    let mut told = |_: &str, _: TableSum, _: u64| first.notify_one();
    tokio::select! {
        biased;
        () = first.notified() => {}
        done = copy(from, to, &mut told) => panic!("it came to its end: {done:?}"),
    }
}

/// Why a database is not opened.
fn refusal<T>(opened: StoreResult<T>) -> String {
    let error = opened.err().expect("it is refused");
    std::error::Error::source(&error).map_or_else(|| error.to_string(), ToString::to_string)
}

#[tokio::test]
async fn where_a_copy_broke_off_nobody_counts_on_what_is_there_until_one_has_ended() {
    let Some(plant) = Given::postgres().await else {
        return;
    };
    let cell = Given::sqlite().await;
    fill(&*cell.store()).await;
    let (from, to) = (Address::Sqlite(cell.file()), Address::Postgres(plant.address()));
    broken_off(&from, &to).await;
    // The session of the copy ends when the server has seen that its client is gone.
    let opened = async || PostgresStore::open(&plant.address(), PostgresOptions::default()).await;
    let ended = async {
        loop {
            let why = refusal(opened().await);
            if !why.contains("start when it has ended") {
                break why;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    let why = tokio::time::timeout(Duration::from_secs(30), ended).await.expect("its session ends");
    assert!(why.contains("broke off"), "{why}");
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    // Nor is it handed on.
    let other = Address::Sqlite(path("other.sqlite3"));
    let refused = copied(&to, &other).await.unwrap_err();
    assert!(matches!(&refused, TransferError::Store(StoreError::NotWritable(_))), "{refused:?}");
    back_up_postgres(&plant.address(), &path("plant.backup"), at(0)).await.unwrap_err();
    note_postgres(&plant.address(), at(0)).await.unwrap_err();
    assert!(!path("plant.backup").exists());
    copied(&from, &to).await.unwrap();
    let store = opened().await.unwrap();
    assert_eq!(shown(&store).await, shown(&*cell.store()).await);
    sound(&store).await;
    store.close().await;

    let back = Address::Sqlite(path("back.sqlite3"));
    broken_off(&to, &back).await;
    let open = async || SqliteStore::open(path("back.sqlite3"), SqliteOptions::default()).await;
    let why = refusal(open().await);
    assert!(why.contains("broke off"), "{why}");
    back_up_sqlite(&path("back.sqlite3"), &path("back.backup"), at(0)).await.unwrap_err();
    note_sqlite(&path("back.sqlite3"), at(0)).await.unwrap_err();
    assert!(!path("back.backup").exists());
    copied(&to, &back).await.unwrap();
    let returned = open().await.unwrap();
    assert_eq!(shown(&returned).await, shown(&*cell.store()).await);
    returned.close().await;
    back_up_sqlite(&path("back.sqlite3"), &path("back.backup"), at(0)).await.unwrap();

    // What is refused untouched is no copy that broke off.
    let store = opened().await.unwrap();
    let changed = event(ToolEventKind::Changed, at(90 * 60));
    store.add_tool_event(&"T1".try_into().unwrap(), changed, &engineer(), at(9100)).await.unwrap().unwrap();
    store.close().await;
    let refused = copied(&from, &to).await.unwrap_err();
    assert!(matches!(&refused, TransferError::OtherData { .. }), "{refused}");
    opened().await.unwrap().close().await;
    cell.done().await;
    plant.done().await;
}

/// Partitions of samples: their names, oldest first, without that of what no other covers.
async fn partitions(plant: &Given) -> Vec<String> {
    let mut server = PgConnection::connect(&plant.address()).await.unwrap();
    let names = sqlx::query_scalar("SELECT name FROM cycle_samples_partitions()");
    names.fetch_all(&mut server).await.unwrap()
}

/// Whoever reads samples locks each partition: a single cycle of a clock that was far ahead is no reason for hundreds of them.
#[tokio::test]
async fn months_in_which_nothing_was_received_have_no_partitions() {
    const DAY: i64 = 86_400;
    let (Some(plant), Some(other)) = (Given::postgres().await, Given::postgres().await) else {
        return;
    };
    let cell = Given::sqlite().await;
    let store = cell.store();
    fill(&*store).await;
    // From 2051-10-21 on; of the day before 1970 began, and that day.
    for (n, seconds) in
        [(90, 9_420 * DAY), (91, 9_421 * DAY), (92, 59 * DAY), (93, -1_767_600_060), (94, -1_767_599_900)]
    {
        stored(&*store, &Run { seconds, ..Run::nth(n) }).await;
    }
    let (from, to) = (Address::Sqlite(cell.file()), Address::Postgres(plant.address()));
    let (sums, _) = copied(&from, &to).await.unwrap();
    let expected =
        ["196912", "197001", "202601", "202603", "205110"].map(|month| format!("cycle_samples_{month}"));
    assert_eq!(partitions(&plant).await, expected);
    let copy = PostgresStore::open(&plant.address(), PostgresOptions::default()).await.unwrap();
    assert_eq!(shown(&copy).await, shown(&*store).await);
    sound(&copy).await;

    // A server has made room for a year ahead: what it receives beyond stands in the partition of all else, and is copied as well.
    let plant_of_before = other.store();
    plant_of_before.make_room(at(0)).await.unwrap();
    fill(&*plant_of_before).await;
    stored(&*plant_of_before, &Run { seconds: 9_420 * DAY, ..Run::nth(90) }).await;
    sound(&*plant_of_before).await;
    assert_eq!(other.raw("UPDATE cycle_samples_default SET block = block").await.unwrap(), 1);
    let folder = tempfile::tempdir().unwrap();
    let back = folder.path().join("back.sqlite3");
    copied(&Address::Postgres(other.address()), &Address::Sqlite(back.clone())).await.unwrap();
    let returned = sqlite(&back).await;
    assert_eq!(shown(&returned).await, shown(&*plant_of_before).await);
    sound(&returned).await;
    returned.close().await;

    // Again: nothing is left to write, and no partition is made.
    copy.close().await;
    let (again, rows) = copied(&from, &to).await.unwrap();
    assert_eq!((again, rows), (sums, 0));
    assert_eq!(partitions(&plant).await, expected);
    cell.done().await;
    plant.done().await;
    other.done().await;
}

/// Pages end at their bytes, on both sides and of both engines: nothing is left out there, and nothing comes twice.
#[tokio::test]
async fn large_samples_behind_small_ones_arrive() {
    let (Some(plant), Some(other)) = (Given::postgres().await, Given::postgres().await) else {
        return;
    };
    fill(&*plant.store()).await;
    // Bytes are copied as they are, whatever they say.
    let large = "INSERT INTO cycle_samples SELECT 'M3', n, 'large' || n, decode(repeat('5a', 1048576), 'hex')
                 FROM generate_series(1, 12) AS numbers (n)";
    assert_eq!(plant.raw(large).await.unwrap(), 12);
    let folder = tempfile::tempdir().unwrap();
    let cell = folder.path().join("cell.sqlite3");
    let (plant_at, cell_at) = (Address::Postgres(plant.address()), Address::Sqlite(cell.clone()));
    let other_at = Address::Postgres(other.address());
    let (sums, _) = copied(&plant_at, &cell_at).await.unwrap();
    assert!(sums.iter().any(|(table, sum)| table == "cycle_samples" && sum.rows == 64 + 12), "{sums:?}");
    assert_eq!(copied(&cell_at, &other_at).await.unwrap().0, sums);
    assert_eq!(copied(&plant_at, &other_at).await.unwrap(), (sums.clone(), 0));
    // A copy that broke off within the large ones, and behind them.
    let lost = "DELETE FROM cycle_samples WHERE cycle_id IN ('large2', 'large7', 'large9', 'c00001')";
    assert_eq!(other.raw(lost).await.unwrap(), 4);
    assert_eq!(copied(&cell_at, &other_at).await.unwrap(), (sums, 4));
    plant.done().await;
    other.done().await;
}

#[tokio::test]
async fn a_target_with_other_data_is_refused_untouched() {
    let (cell, other) = (Given::sqlite().await, Given::sqlite().await);
    fill(&*cell.store()).await;
    shop(&*other.store()).await;
    stored(&*other.store(), &Run { load: 77.0, ..Run::nth(1) }).await;
    let folder = tempfile::tempdir().unwrap();
    let sums = |name| {
        let (from, to) = (other.file(), folder.path().join(name));
        async move { back_up_sqlite(&from, &to, at(1)).await.unwrap().tables }
    };
    let before = sums("before").await;
    let (from, to) = (Address::Sqlite(cell.file()), Address::Sqlite(other.file()));
    let refused = copied(&from, &to).await.unwrap_err();
    assert!(refused.to_string().contains("the target is not empty"), "{refused}");
    assert_eq!(sums("after").await, before, "nothing of it has changed");
    cell.done().await;
    other.done().await;
}

/// Its tables may be the same, and its blocks not.
#[tokio::test]
async fn what_a_later_version_wrote_is_neither_copied_nor_backed_up() {
    let Some(plant) = Given::postgres().await else {
        return;
    };
    let cell = Given::sqlite().await;
    for given in [&plant, &cell] {
        shop(&*given.store()).await;
        stored(&*given.store(), &Run::nth(1)).await;
        let later = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time)
                     SELECT 9999, 'of a later version', success, checksum, 0 FROM _sqlx_migrations WHERE version = 1";
        assert_eq!(given.raw(later).await.unwrap(), 1);
    }
    let folder = tempfile::tempdir().unwrap();
    let (to, backup) = (folder.path().join("copy.sqlite3"), folder.path().join("plant.backup"));
    // With its cause, as the command tells it.
    let of = |error: TransferError| format!("{error:?}");
    for from in [Address::Postgres(plant.address()), Address::Sqlite(cell.file())] {
        let why = of(copied(&from, &Address::Sqlite(to.clone())).await.unwrap_err());
        assert!(why.contains("later version") && why.contains("9999"), "{why}");
    }
    let why = of(back_up_postgres(&plant.address(), &backup, at(1)).await.unwrap_err());
    assert!(why.contains("later version") && !backup.exists(), "{why}");
    let why = of(back_up_sqlite(&cell.file(), &backup, at(1)).await.unwrap_err());
    assert!(why.contains("later version") && !backup.exists(), "{why}");
    cell.done().await;
    plant.done().await;
}

#[tokio::test]
async fn nothing_is_copied_under_a_server_that_runs_and_what_is_an_admins_stays_apart() {
    let Some(plant) = Given::postgres().await else {
        return;
    };
    let cell = Given::sqlite().await;
    fill(&*cell.store()).await;
    let (from, to) = (Address::Sqlite(cell.file()), Address::Postgres(plant.address()));
    let store = plant.store();
    let mut listener = store.notices().unwrap().listen().await.unwrap();
    let refused = copied(&from, &to).await.unwrap_err();
    assert!(matches!(refused, TransferError::Served), "{refused}");
    assert!(store.machines(Page { after: None, limit: 9 }).await.unwrap().is_empty(), "nothing was written");
    assert!(tokio::time::timeout(Duration::from_millis(1), listener.next()).await.is_err());
    drop(listener);
    for step in
        ["ALTER TABLE cycle_samples DETACH PARTITION cycle_samples_default", "CREATE TABLE notes (at POINT)"]
    {
        plant.raw(step).await.unwrap();
    }
    // Until its session is gone.
    let outcome = async {
        loop {
            match copied(&from, &to).await {
                Err(TransferError::Served) => tokio::task::yield_now().await,
                outcome => return outcome,
            }
        }
    };
    tokio::time::timeout(Duration::from_secs(60), outcome).await.expect("it goes").unwrap();
    cell.done().await;
    plant.done().await;
}

#[tokio::test]
async fn two_copies_do_not_write_into_one_plant_nor_does_a_server_start_there() {
    let Some(plant) = Given::postgres().await else {
        return;
    };
    let cell = Given::sqlite().await;
    fill(&*cell.store()).await;
    let (from, to) = (Address::Sqlite(cell.file()), Address::Postgres(plant.address()));
    // The first one waits for a table.
    let mut conn = PgConnection::connect(&plant.address()).await.unwrap();
    let mut looking = PgConnection::connect(&plant.address()).await.unwrap();
    let mut holding = conn.begin().await.unwrap();
    sqlx::query("LOCK TABLE audit").execute(&mut *holding).await.unwrap();
    let waits = "SELECT EXISTS (SELECT 1 FROM pg_stat_activity WHERE datname = current_database()
                     AND application_name = 'feedwright transfer' AND wait_event_type = 'Lock')";
    let second = async {
        // What it sees of others stands still within a transaction.
        while !sqlx::query_scalar::<_, bool>(waits).fetch_one(&mut looking).await.unwrap() {}
        let refused = copied(&from, &to).await.unwrap_err();
        assert!(matches!(refused, TransferError::InUse), "{refused}");
        let server = PostgresStore::open(&plant.address(), PostgresOptions::default()).await.unwrap_err();
        let StoreError::NotWritable(why) = server else { panic!("{server:?}") };
        assert!(why.to_string().contains("a copy or a restore writes into the database"), "{why}");
        holding.commit().await.unwrap();
    };
    let both = async { tokio::join!(copied(&from, &to), second) };
    let (first, ()) = tokio::time::timeout(Duration::from_secs(60), both).await.expect("the first one waits");
    first.unwrap();
    assert_eq!(copied(&from, &to).await.unwrap().1, 0);
    let server = PostgresStore::open(&plant.address(), PostgresOptions::default()).await.unwrap();
    server.close().await;
    conn.close().await.unwrap();
    looking.close().await.unwrap();
    cell.done().await;
    plant.done().await;
}

async fn session(store: &dyn Store, n: u8) {
    let session = SessionRecord {
        hash: [n; 32],
        token: "tok-1".to_owned(),
        created_at: at(i64::from(n) * 100),
        expires_at: at(i64::from(n) * 100 + 50),
    };
    store.begin_session(session, 5, &engineer()).await.unwrap();
}

/// What a shop does in a week: something of every kind that changes rows, or removes them.
async fn week(store: &dyn Store) {
    let who = engineer();
    for n in 81..=140 {
        let load = if n > 100 { 90.0 } else { 36.0 };
        stored(store, &Run { machine: if n % 5 == 0 { "M2" } else { "M1" }, load, ..Run::nth(n) }).await;
    }
    let renamed = feedwright_core::machine::Machine { name: "another name".to_owned(), ..machine("M1") };
    store.put_machine(renamed, Precondition::Version(1), &who, at(9500)).await.unwrap();
    let changed = event(ToolEventKind::Changed, at(120 * 60));
    let tool = "T1".try_into().unwrap();
    store.add_tool_event(&tool, changed, &who, at(9501)).await.unwrap();
    // The change that was there before.
    let events = store.tool_events(&tool, Page { after: None, limit: 9 }).await.unwrap();
    let before = events.iter().find(|told| told.event.at == at(80 * 60)).unwrap();
    assert_eq!(before.revoked, None);
    store.revoke_tool_event(&tool, before.id, &who, at(9501)).await.unwrap().unwrap();
    assert!(settle(store, "q1", "discarded", at(9502)).await);
    for alarm in store.alarms(&Default::default(), Page { after: None, limit: 99 }).await.unwrap() {
        store.acknowledge_alarm(alarm.id, &who, at(9503)).await.unwrap();
    }
    // The one before is superseded: never two of a line are active, not even while they are copied.
    activated(store, 310.0).await;
    // The first one is over, and forgotten.
    session(store, 2).await;
    store.revoke_token("tok-1", &who, at(9504)).await.unwrap().unwrap();
    drop_old_samples(store, 90_002).await;
}

/// Up to half of the samples, in bytes, of each machine that has the most.
async fn drop_old_samples(store: &dyn Store, seconds: i64) {
    for power in (0..24).rev() {
        let kept = SampleRetention { days: None, bytes: Some(1 << power) };
        if !store.decide_drops(kept, at(seconds)).await.unwrap().is_empty() {
            break;
        }
    }
    let mut dropped = 0;
    loop {
        let step = store.drop_some(10).await.unwrap();
        dropped += step.cycles;
        if !step.more {
            break;
        }
    }
    assert!(dropped > 0);
}

/// Copies from a source whose server runs, and again a week later.
async fn copied_while_it_goes_on(given: &Given, from: &Address, to: &Address) -> Vec<(String, TableSum)> {
    let store = given.store();
    fill(&*store).await;
    activated(&*store, 300.0).await;
    session(&*store, 1).await;
    drop_old_samples(&*store, 90_001).await;
    let (first, _) = copied(from, to).await.unwrap();
    week(&*store).await;
    let (second, rows) = copied(from, to).await.unwrap();
    assert!(rows > 60, "{rows}");
    for table in [
        "alarms",
        "cycle_samples",
        "feed_profile_versions",
        "machines",
        "quarantine",
        "sample_drops",
        "tokens",
    ] {
        let of = |sums: &[(String, TableSum)]| sums.iter().find(|(name, _)| name == table).unwrap().1;
        assert_ne!(of(&first), of(&second), "{table} moved on");
    }
    assert_eq!(copied(from, to).await.unwrap(), (second.clone(), 0), "nothing is left");
    second
}

#[tokio::test]
async fn a_cell_that_goes_on_is_copied_to_the_plant_again() {
    let Some(plant) = Given::postgres().await else {
        return;
    };
    let cell = Given::sqlite().await;
    let (from, to) = (Address::Sqlite(cell.file()), Address::Postgres(plant.address()));
    copied_while_it_goes_on(&cell, &from, &to).await;
    let store = PostgresStore::open(&plant.address(), PostgresOptions::default()).await.unwrap();
    assert_eq!(shown(&store).await, shown(&*cell.store()).await);
    sound(&store).await;
    store.close().await;
    cell.done().await;
    plant.done().await;
}

#[tokio::test]
async fn a_plant_that_goes_on_is_copied_to_a_cell_again() {
    let Some(plant) = Given::postgres().await else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cell.sqlite3");
    let (from, to) = (Address::Postgres(plant.address()), Address::Sqlite(file.clone()));
    let sums = copied_while_it_goes_on(&plant, &from, &to).await;
    let store = sqlite(&file).await;
    assert_eq!(shown(&store).await, shown(&*plant.store()).await);
    sound(&store).await;
    store.close().await;
    // What the backup finds is what the copy said.
    let backup = back_up_sqlite(&file, &folder.path().join("backup"), at(1)).await.unwrap();
    assert_eq!(backup.tables, sums);
    plant.done().await;
}

/// The first copy was made before a clock that was ahead dropped what it had received, the second one after; and when the
/// machine was last heard of has gone back since.
async fn copied_around_a_clock_that_was_ahead(given: &Given, from: &Address, to: &Address) {
    const DAY: i64 = 86_400;
    let store = given.store();
    shop(&*store).await;
    for n in 0..6 {
        stored(&*store, &Run { seconds: 40 * DAY + i64::from(n) * 60, ..Run::nth(n) }).await;
    }
    let settings = watched();
    let heard = async |seconds, heard| {
        store.watch(heard, &settings, at(seconds)).await.unwrap().machines[0].last_cycle_at
    };
    let contact = vec![("M1".try_into().unwrap(), Duration::ZERO)];
    assert_eq!(heard(40 * DAY, contact).await, Some(at(40 * DAY)));
    copied(from, to).await.unwrap();
    let none = SampleRetention { days: None, bytes: Some(1) };
    assert_eq!(store.decide_drops(none, at(41 * DAY)).await.unwrap().len(), 1);
    while store.drop_some(10).await.unwrap().more {}
    assert_eq!(store.decide_drops(none, at(DAY)).await.unwrap(), [], "taken back");
    assert_eq!(heard(DAY, vec![]).await, Some(at(DAY)), "brought back");
    let (second, _) = copied(from, to).await.unwrap();
    let rows = |table| second.iter().find(|(name, _)| name == table).unwrap().1.rows;
    assert_eq!((rows("cycle_samples"), rows("cycle_sample_drops")), (0, 6));
}

#[tokio::test]
async fn what_a_clock_that_was_ahead_left_goes_from_an_earlier_copy_of_a_plant_too() {
    let Some(plant) = Given::postgres().await else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cell.sqlite3");
    let (from, to) = (Address::Postgres(plant.address()), Address::Sqlite(file.clone()));
    copied_around_a_clock_that_was_ahead(&plant, &from, &to).await;
    let copy = sqlite(&file).await;
    sound(&copy).await;
    assert_eq!(copy.check_cycles(None, 100).await.unwrap().dropped, 6);
    copy.close().await;
    plant.done().await;
}

#[tokio::test]
async fn what_a_clock_that_was_ahead_left_goes_from_an_earlier_copy_too() {
    let Some(plant) = Given::postgres().await else {
        return;
    };
    let cell = Given::sqlite().await;
    let (from, to) = (Address::Sqlite(cell.file()), Address::Postgres(plant.address()));
    copied_around_a_clock_that_was_ahead(&cell, &from, &to).await;
    let copy = PostgresStore::open(&plant.address(), PostgresOptions::default()).await.unwrap();
    sound(&copy).await;
    assert_eq!(copy.check_cycles(None, 100).await.unwrap().dropped, 6);
    copy.close().await;
    // A backup takes them along.
    let folder = tempfile::tempdir().unwrap();
    let (backup, restored) = (folder.path().join("backup"), folder.path().join("restored.sqlite3"));
    back_up_postgres(&plant.address(), &backup, at(1)).await.unwrap();
    restore_to_sqlite(&backup, &restored).await.unwrap();
    let restored = sqlite(&restored).await;
    sound(&restored).await;
    restored.close().await;
    cell.done().await;
    plant.done().await;
}

#[tokio::test]
async fn a_target_that_somebody_else_wrote_is_refused_by_table_and_key() {
    let source = Given::sqlite().await;
    fill(&*source.store()).await;
    let folder = tempfile::tempdir().unwrap();
    let early = folder.path().join("early.sqlite3");
    let from = Address::Sqlite(source.file());
    copied(&from, &Address::Sqlite(early.clone())).await.unwrap();
    week(&*source.store()).await;
    let refused = async |name: &str| {
        let file = folder.path().join(name);
        let sums =
            async |to: &str| back_up_sqlite(&file, &folder.path().join(to), at(1)).await.unwrap().tables;
        let before = sums(&format!("{name}.before")).await;
        let error = copied(&from, &Address::Sqlite(file.clone())).await.unwrap_err();
        assert_eq!(sums(&format!("{name}.after")).await, before, "{name}: nothing was written");
        match error {
            TransferError::OtherData { table, key, what } => format!("{table} {key} {what}"),
            other => panic!("{name}: {other}"),
        }
    };
    let target = async |name: &str| {
        std::fs::copy(&early, folder.path().join(name)).unwrap();
        sqlite(&folder.path().join(name)).await
    };

    let store = target("cycle").await;
    stored(&store, &Run { machine: "M2", ..Run::nth(9000) }).await;
    store.close().await;
    assert_eq!(refused("cycle").await, "cycles M2/c09000 is not in the source");

    // The same name, but another content.
    let store = target("content").await;
    stored(&store, &Run { machine: "M1", load: 55.0, ..Run::nth(81) }).await;
    store.close().await;
    assert_eq!(refused("content").await, "cycles M1/c00081 is there with other content");

    // Changed as people change it: the line in the audit tells.
    let store = target("registry").await;
    let renamed = feedwright_core::machine::Machine { name: "here".to_owned(), ..machine("M1") };
    store.put_machine(renamed, Precondition::Version(1), &engineer(), at(9500)).await.unwrap();
    store.close().await;
    let told = refused("registry").await;
    assert!(told.starts_with("audit ") && told.ends_with(" is there with other content"), "{told}");

    // Changed behind the program's back, where the source did not change it, and where it did.
    for (name, sql, told) in [
        (
            "tool",
            "UPDATE tools SET name = 'x', row_sum = NULL, summed_version = NULL WHERE tool_id = 'T1'",
            "tools T1 is there with other content",
        ),
        (
            "machine",
            "UPDATE machines SET version = 9, row_sum = NULL, summed_version = NULL WHERE machine_id = 'M1'",
            "machines M1 is newer than in the source",
        ),
        (
            "surplus",
            "UPDATE operations SET operation_id = 'O9', row_sum = NULL, summed_version = NULL",
            "operations O9 is not in the source",
        ),
        (
            "samples",
            "UPDATE cycle_samples SET cycle_id = 'c99999' WHERE cycle_id = 'c00079'",
            "cycle_samples M1/1767604743000000/c99999 is not in the source",
        ),
    ] {
        target(name).await.close().await;
        let options = SqliteConnectOptions::new().filename(folder.path().join(name));
        let mut conn = options.connect().await.unwrap();
        assert_eq!(sqlx::query(sql).execute(&mut conn).await.unwrap().rows_affected(), 1, "{name}");
        conn.close().await.unwrap();
        assert_eq!(refused(name).await, told, "{name}");
    }
    source.done().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_backup_under_load_is_one_state_and_restores() {
    let given = Given::sqlite().await;
    fill(&*given.store()).await;
    let (store, stop) = (given.store(), Arc::new(AtomicBool::new(false)));
    let stopped = stop.clone();
    let posting = tokio::spawn(async move {
        let mut n = 1000;
        while !stopped.load(Ordering::Relaxed) {
            for outcome in commit(&*store, &[Run::nth(n), Run::nth(n + 1)]).await {
                outcome.unwrap();
            }
            n += 2;
        }
        n - 1000
    });
    let folder = tempfile::tempdir().unwrap();
    let backup = folder.path().join("backup.sqlite3");
    let report = back_up_sqlite(&given.file(), &backup, at(1)).await.unwrap();
    stop.store(true, Ordering::Relaxed);
    let posted = posting.await.unwrap();
    assert!(posted > 0);
    let cycles = report.tables.iter().find(|(table, _)| table == "cycles").unwrap().1.rows;
    assert!((80..=80 + u64::from(posted)).contains(&cycles), "{cycles}");
    let again = back_up_sqlite(&given.file(), &backup, at(1)).await.unwrap_err();
    assert!(again.to_string().contains("is there already"), "{again}");

    let restored = folder.path().join("restored.sqlite3");
    let sums = restore_to_sqlite(&backup, &restored).await.unwrap();
    assert_eq!(sums, report.tables);
    let store = sqlite(&restored).await;
    // One state: every cycle has its samples, its advice and its place in the fold.
    sound(&store).await;
    assert!(stored(&store, &Run::nth(5000)).await.registered, "it takes cycles again");
    store.close().await;

    // A backup with one bit turned is refused.
    let mut bytes = std::fs::read(&backup).unwrap();
    let hash = cell_of(&bytes, b"machine M1");
    bytes[hash] ^= 1;
    let turned = folder.path().join("turned.sqlite3");
    std::fs::write(&turned, bytes).unwrap();
    let refused = restore_to_sqlite(&turned, &folder.path().join("none.sqlite3")).await.unwrap_err();
    assert!(refused.to_string().contains("is not what was backed up"), "{refused}");
    assert!(!folder.path().join("none.sqlite3").exists());
    // So is one whose tables are as they were, and an index is not.
    let unindexed = folder.path().join("unindexed.sqlite3");
    std::fs::copy(&backup, &unindexed).unwrap();
    let mut conn = SqliteConnectOptions::new().filename(&unindexed).connect().await.unwrap();
    sqlx::query(WRONG_INDEX).execute(&mut conn).await.unwrap();
    conn.close().await.unwrap();
    let refused = restore_to_sqlite(&unindexed, &folder.path().join("none.sqlite3")).await.unwrap_err();
    assert!(refused.to_string().contains("missing from index cycles_by_tool"), "{refused}");
    assert!(!folder.path().join("none.sqlite3").exists());
    // Rows are copied as an index orders them: what it leaves out would be in neither side's sum.
    let (from, to) = (Address::Sqlite(unindexed), Address::Sqlite(folder.path().join("copied.sqlite3")));
    let refused = copy(&from, &to, &mut |_, _, _| {}).await.unwrap_err();
    assert!(refused.to_string().contains("missing from index cycles_by_tool"), "{refused}");
    assert!(!folder.path().join("copied.sqlite3").exists(), "{refused}");
    // The log of a database that was there before would be written over the new one.
    let log = folder.path().join("none.sqlite3-wal");
    std::fs::write(&log, [1; 100]).unwrap();
    let refused = restore_to_sqlite(&backup, &folder.path().join("none.sqlite3")).await.unwrap_err();
    assert!(refused.to_string().contains("none.sqlite3-wal"), "{refused}");
    let opened = SqliteStore::open(folder.path().join("none.sqlite3"), SqliteOptions::default()).await;
    let Err(feedwright_store::StoreError::NotWritable(why)) = opened else {
        panic!("a database was made beside its log")
    };
    assert!(why.to_string().contains("none.sqlite3-wal"), "{why}");
    assert_eq!(std::fs::read(&log).unwrap(), [1; 100]);
    std::fs::remove_file(&log).unwrap();
    let refused = restore_to_sqlite(&restored, &folder.path().join("none.sqlite3")).await.unwrap_err();
    assert!(refused.to_string().contains("is no backup"), "{refused}");
    given.done().await;
}

fn cell_of(bytes: &[u8], text: &[u8]) -> usize {
    bytes.windows(text.len()).rposition(|window| window == text).expect("the name is in the file")
}

#[tokio::test]
async fn a_backup_of_the_plant_restores_into_either_engine() {
    let (Some(plant), Some(other)) = (Given::postgres().await, Given::postgres().await) else {
        return;
    };
    fill(&*plant.store()).await;
    let folder = tempfile::tempdir().unwrap();
    let backup = folder.path().join("plant.sqlite3");
    let report = back_up_postgres(&plant.address(), &backup, at(1)).await.unwrap();
    assert!(report.bytes > 10_000);
    let sums = restore_to_postgres(&backup, &other.address(), folder.path()).await.unwrap();
    assert_eq!(sums, report.tables);
    let store = PostgresStore::open(&other.address(), PostgresOptions::default()).await.unwrap();
    assert_eq!(shown(&store).await, shown(&*plant.store()).await);
    sound(&store).await;
    let cell = folder.path().join("cell.sqlite3");
    assert_eq!(restore_to_sqlite(&backup, &cell).await.unwrap(), report.tables);
    let cell = sqlite(&cell).await;
    assert_eq!(shown(&cell).await, shown(&store).await);
    cell.close().await;
    store.close().await;
    plant.done().await;
    other.done().await;
}

async fn last_backup(store: &dyn Store) -> Option<Timestamp> {
    store.watch(vec![], &watched(), at(9)).await.unwrap().last_backup_at
}

#[tokio::test]
async fn a_database_remembers_its_last_backup_and_what_is_restored_from_it_has_none() {
    let folder = tempfile::tempdir().unwrap();
    let cell = Given::sqlite().await;
    fill(&*cell.store()).await;
    assert_eq!(last_backup(&*cell.store()).await, None);
    for made_at in [at(5), at(7)] {
        note_sqlite(&cell.file(), made_at).await.unwrap();
        assert_eq!(last_backup(&*cell.store()).await, Some(made_at), "beside the store that writes");
    }
    let (backup, restored) = (folder.path().join("cell.backup"), folder.path().join("restored.sqlite3"));
    let sums = back_up_sqlite(&cell.file(), &backup, at(8)).await.unwrap().tables;
    assert!(sums.iter().all(|(table, _)| table != "last_backup"), "{sums:?}");
    restore_to_sqlite(&backup, &restored).await.unwrap();
    let store = sqlite(&restored).await;
    assert_eq!(last_backup(&store).await, None, "nobody has backed this one up");
    store.close().await;
    cell.done().await;

    let (Some(plant), Some(other)) = (Given::postgres().await, Given::postgres().await) else {
        return;
    };
    assert_eq!(last_backup(&*plant.store()).await, None);
    for made_at in [at(5), at(7)] {
        note_postgres(&plant.address(), made_at).await.unwrap();
        assert_eq!(last_backup(&*plant.store()).await, Some(made_at));
    }
    restore_to_postgres(&backup, &other.address(), folder.path()).await.unwrap();
    assert_eq!(last_backup(&*other.store()).await, None);
    plant.done().await;
    other.done().await;
}

/// Texts of as many characters as the API takes, which stand for several bytes each.
async fn wordy(store: &dyn Store) {
    let (law, longest) = ("刃".repeat(Cycle::MAX_LAW_VERSION), "𝄞".repeat(63));
    for (n, law) in [(1, &law), (2, &longest)] {
        let cycle = Cycle::new(CycleDraft { law_version: Some(law.clone()), ..Run::nth(n).draft() }).unwrap();
        let group = vec![new_cycle(cycle)];
        let answers = store.commit_cycles(group, at(100), RecommendSettings::default()).await;
        assert!(matches!(answers.as_slice(), [Ok(Committed::Stored(_))]), "{answers:?}");
        let overrides = CycleOverrides {
            machine: "M1".try_into().unwrap(),
            cycle: Run::nth(n).id.as_str().try_into().unwrap(),
            mode: "shadow".to_owned(),
            law_version: law.clone(),
            program_hash: None,
            stored_at: at(1),
            block: feedwright_store::codec::encode_overrides(&[(100.0, 1)]).unwrap(),
        };
        store.put_overrides(&overrides, Sent::AsItRan).await.unwrap();
    }
    let reasoned = NewProfileVersion { reason: "€".repeat(1000), ..feed_profiles::new(300.0) };
    store.draft_profile(&"P1".try_into().unwrap(), reasoned, &engineer(), at(1)).await.unwrap();
}

/// A database in SQL_ASCII counts bytes where others count characters.
#[tokio::test]
async fn a_database_that_counts_bytes_takes_what_others_take() {
    const BYTES: &str = "ENCODING SQL_ASCII LOCALE 'C' TEMPLATE template0";
    let (Some(posted), Some(moved)) = (Given::postgres_made(BYTES).await, Given::postgres_made(BYTES).await)
    else {
        return;
    };
    let cell = Given::sqlite().await;
    for store in [posted.store(), cell.store()] {
        shop(&*store).await;
        wordy(&*store).await;
    }
    copied(&Address::Sqlite(cell.file()), &Address::Postgres(moved.address())).await.unwrap();
    assert_eq!(shown(&*moved.store()).await, shown(&*cell.store()).await);
    for given in [posted, moved, cell] {
        sound(&*given.store()).await;
        given.done().await;
    }
}

/// A transaction that has locked a table, and waits for others' locks no longer than a moment.
async fn locking<'c>(server: &'c mut PgConnection, table: &str) -> sqlx::Transaction<'c, sqlx::Postgres> {
    let mut locking = server.begin().await.unwrap();
    let mut lock = sqlx::QueryBuilder::<sqlx::Postgres>::new("LOCK TABLE ");
    lock.push(table).build().persistent(false).execute(&mut *locking).await.unwrap();
    sqlx::query("SET LOCAL lock_timeout = '300ms'").execute(&mut *locking).await.unwrap();
    locking
}

/// Waits until somebody waits for that table, and drops a partition of which nothing is to be kept then, as retention of another server does: how
/// that is refused.
async fn dropping_beside(mut deciding: sqlx::Transaction<'_, sqlx::Postgres>, table: &str) -> Option<String> {
    let waits = "SELECT EXISTS (SELECT 1 FROM pg_locks WHERE relation = $1::regclass AND NOT granted)";
    let somebody_waits = async {
        let asked = || sqlx::query_scalar::<_, bool>(waits).bind(table);
        while !asked().fetch_one(&mut *deciding).await.unwrap() {}
    };
    tokio::time::timeout(Duration::from_secs(60), somebody_waits).await.expect("somebody waits for it");
    sqlx::raw_sql(
        "INSERT INTO sample_drops (machine_id, before_us, dropped_at_us, reason, cycles, bytes)
         SELECT machine_id, 9000000000000000, 9000000000000000, 'age', 0, 0 FROM machines",
    )
    .execute(&mut *deciding)
    .await
    .unwrap();
    let dropped = sqlx::query("SELECT * FROM cycle_samples_drop_partition(9000000000000000)")
        .fetch_all(&mut *deciding)
        .await;
    deciding.rollback().await.unwrap();
    dropped.err()?.as_database_error()?.code().map(std::borrow::Cow::into_owned)
}

/// A partition is dropped whatever snapshots others have: a backup would be without what it held, and without the decision, and a check
/// would find cycles that lost their samples.
#[tokio::test]
async fn no_partition_goes_between_a_snapshot_and_its_samples() {
    let Some(plant) = Given::postgres().await else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let store = plant.store();
    store.make_room(at(0)).await.unwrap();
    fill(&*store).await;
    let mut server = PgConnection::connect(&plant.address()).await.unwrap();
    let (address, backup) = (plant.address(), folder.path().join("plant.backup"));

    // The backup has its snapshot when it comes to ask for decisions.
    let decisions = locking(&mut server, "sample_drops").await;
    let making = back_up_postgres(&address, &backup, at(9));
    let (made, refused) = tokio::join!(making, dropping_beside(decisions, "sample_drops"));
    assert_eq!(refused.as_deref(), Some("55P03"), "the backup keeps it");
    let sums = made.unwrap().tables;
    assert!(sums.iter().any(|(table, sum)| table == "cycle_samples" && sum.rows == 64), "{sums:?}");

    // And the check before it asks for cycles.
    let cycles = locking(&mut server, "cycles").await;
    let (page, refused) = tokio::join!(store.check_cycles(None, 1000), dropping_beside(cycles, "cycles"));
    assert_eq!(refused.as_deref(), Some("55P03"), "the check keeps it");
    assert_eq!(page.unwrap().faults, []);
    server.close().await.unwrap();
    plant.done().await;
}

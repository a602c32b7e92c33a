//! Rows of what people registered that a disk has changed: nothing is decided by them, cycles are taken all the same, and they are named.

use super::given::{Given, Run, at, commit, engineer, machine, operation, shop, stories, tool};
use super::models::turned;
use feedwright_core::machine::{Calibration, FittedLine, Machine};
use feedwright_core::recommend::{Knowledge, NEUTRAL_OVERRIDE_PERCENT, RecommendSettings, Recommendation};
use feedwright_store::transfer::{
    Address, TableSum, TransferError, back_up_postgres, back_up_sqlite, copy, restore_to_sqlite,
};
use feedwright_store::{
    Committed, CycleAnswer, ModelKind, NewCycle, Page, PostgresOptions, PostgresStore, Precondition,
    PutOutcome, Repair, SqliteOptions, SqliteStore, Store, StoreError, SumPage,
};
use std::path::Path;

stories!(with tables:
    a_limit_that_the_disk_has_changed_is_neither_advised_by_nor_backed_up,
    whatever_is_damaged_is_named_and_nothing_is_decided_by_it,
    a_row_that_does_not_decode_costs_no_cycle_and_is_put_anew,
    rows_of_before_the_sums_are_summed_as_they_are,
    what_a_server_of_before_writes_is_no_damage_where_one_may_run,
    a_feed_profile_that_is_for_somebody_else_is_not_run,
    folds_follow_when_a_damaged_operation_is_put_anew,
);

/// Changes rows behind the program's back; servers read anew what they remember.
async fn damage(given: &Given, sql: &'static str) {
    assert_eq!(given.raw(sql).await.unwrap(), 1, "{sql}");
    given.raw("UPDATE registry_generation SET changes = changes + 1 WHERE registry_id = 3").await.unwrap();
}

/// Stores the `n`th cycle, summarised by what is in force.
async fn posted(store: &dyn Store, n: u32) -> CycleAnswer {
    let new = NewCycle { generation: Some(-1), ..Run::nth(n).new_cycle() };
    let now = at(i64::from(n) * 60 + 5);
    match store.commit_cycles(vec![new], now, RecommendSettings::default()).await.pop() {
        Some(Ok(Committed::Stored(answer))) => *answer,
        other => panic!("{n} should be stored: {other:?}"),
    }
}

/// What is told to be damaged.
fn damaged(advice: &Recommendation) -> Vec<&str> {
    let told = advice.reasons.iter().filter(|(code, _)| code == "registered_data_damaged");
    told.map(|(_, why)| {
        why.strip_prefix("what is stored of the ").unwrap().split(" is damaged").next().unwrap()
    })
    .collect()
}

/// That nobody is told to run anything but the program.
fn is_neutral(advice: &Recommendation) {
    assert_eq!((advice.feed_mm_min, advice.override_percent), (None, NEUTRAL_OVERRIDE_PERCENT));
    assert!(advice.profile.is_none() && advice.process_advice.is_none() && advice.reference_cycle.is_none());
    assert_eq!((advice.spindle_load_set_percent, advice.feed_drive_load_set_percent), (None, None));
}

async fn faults(store: &dyn Store) -> Vec<String> {
    let faults = store.check_tables().await.unwrap();
    faults.into_iter().map(|fault| format!("{} {}", fault.kind, fault.key)).collect()
}

/// Goes through all rows, and sums those that have no sum.
pub(super) async fn held(store: &dyn Store) -> SumPage {
    let (mut all, mut after) = (SumPage::default(), None);
    loop {
        let page = store.hold_sums(after.as_ref()).await.unwrap();
        if page.unsummed > 0 {
            assert_eq!(store.sum_rows(after.as_ref()).await.unwrap(), page.unsummed);
        }
        all.unsummed += page.unsummed;
        all.damaged.extend(page.damaged);
        let Some(next) = page.next else { return all };
        after = Some(next);
    }
}

async fn backed_up(given: &Given, file: &Path) -> Result<(), TransferError> {
    if given.is_postgres() {
        back_up_postgres(&given.address(), file, at(1)).await.map(|_| ())
    } else {
        back_up_sqlite(&given.file(), file, at(1)).await.map(|_| ())
    }
}

async fn copied(from: &Address, to: &Address) -> Result<Vec<(String, TableSum)>, TransferError> {
    copy(from, to, &mut |_, _, _| {}).await
}

async fn a_limit_that_the_disk_has_changed_is_neither_advised_by_nor_backed_up(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    super::feed_profiles::activated(&*store, 300.0).await;
    let before = posted(&*store, 1).await;
    let advice = &before.recommendation.recommendation;
    assert_eq!(damaged(advice), Vec::<&str>::new());
    assert!(advice.profile.is_some() && !before.summary.energy.is_empty(), "{:?}", advice.reasons);
    assert_eq!(faults(&*store).await, Vec::<String>::new());

    // A bit of the exponent.
    damage(given, "UPDATE machines SET feed_max_mm_min = feed_max_mm_min * 2").await;
    let answer = posted(&*store, 2).await;
    let advice = &answer.recommendation.recommendation;
    assert_eq!(damaged(advice), ["machine"], "{:?}", advice.reasons);
    is_neutral(advice);
    assert_eq!((advice.limits.override_min_percent(), advice.limits.override_max_percent()), (100.0, 100.0));
    assert!(answer.summary.energy.is_empty(), "what its loads refer to is not known");
    assert!(answer.registered);
    let shown = store.machine(&machine("M1").id).await.unwrap().unwrap();
    assert!(shown.is_damaged);
    assert!(matches!(shown.sound(), Err(StoreError::Damaged { .. })));
    // What a person asks for, and what a stream begins with.
    let ids = (&machine("M1").id, &operation("O1").id, &tool("T1").id);
    let around = store.surroundings(ids.0, ids.1, ids.2).await.unwrap().unwrap();
    assert_eq!(around.machine, Machine::unknown(machine("M1").id));
    assert_eq!(around.damaged, [feedwright_core::recommend::Damaged::Machine]);
    let (recent, _) = store.recent_surroundings(ids.0, ids.1, ids.2, at(200)).await.unwrap().unwrap();
    assert_eq!(recent, around);

    assert_eq!(faults(&*store).await, ["row machines M1"]);
    assert_eq!(
        held(&*store).await,
        SumPage { unsummed: 1, damaged: vec!["machines M1".to_owned()], next: None }
    );
    let cycles = store.check_cycles(None, 100).await.unwrap();
    assert_eq!((cycles.checked, cycles.unverified, cycles.faults), (2, 2, vec![]));
    let folder = tempfile::tempdir().unwrap();
    let refused = backed_up(given, &folder.path().join("damaged")).await.unwrap_err().to_string();
    assert!(refused.contains("machines M1: it is not what was written"), "{refused}");
    let from =
        if given.is_postgres() { Address::Postgres(given.address()) } else { Address::Sqlite(given.file()) };
    let refused = copied(&from, &Address::Sqlite(folder.path().join("copied"))).await.unwrap_err();
    assert!(refused.to_string().contains("machines M1: it is not what was written"), "{refused}");

    // Even what was there before is another content than what is damaged.
    let put = async |expects| store.put_machine(machine("M1"), expects, &engineer(), at(200)).await;
    let unnamed = put(Precondition::Unstated).await;
    assert!(matches!(unnamed, Err(StoreError::VersionRequired { current: 1 })), "{unnamed:?}");
    assert_eq!(put(Precondition::Version(1)).await.unwrap(), PutOutcome::Changed(2));
    let answer = posted(&*store, 3).await;
    let advice = &answer.recommendation.recommendation;
    assert!(advice.profile.is_some() && damaged(advice).is_empty(), "{:?}", advice.reasons);
    assert!(!answer.summary.energy.is_empty());
    assert_eq!((faults(&*store).await, held(&*store).await), (vec![], SumPage::default()));
    assert_eq!(store.check_cycles(None, 100).await.unwrap().faults, []);
    backed_up(given, &folder.path().join("sound")).await.unwrap();
}

async fn whatever_is_damaged_is_named_and_nothing_is_decided_by_it(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    super::feed_profiles::activated(&*store, 300.0).await;
    let line = FittedLine {
        slope: 20.0,
        intercept: -50.0,
        min_percent: 5.0,
        max_percent: 45.0,
        r_squared: 0.99,
        residual_spread: 5.0,
    };
    let fitted = || Calibration { version: 0, thrust: Some(line), torque: None };
    store.add_calibration(&machine("M1").id, fitted(), &engineer(), at(1)).await.unwrap().unwrap();
    assert_eq!(held(&*store).await, SumPage { unsummed: 1, ..SumPage::default() }, "the paper's model");
    assert!(posted(&*store, 1).await.recommendation.recommendation.profile.is_some());
    let mut n = 1;
    for (sql, told, row) in [
        ("UPDATE machines SET override_max_percent = 202", "machine", "machines M1"),
        ("UPDATE calibrations SET thrust_slope = 20.5", "machine's calibration", "calibrations M1/1"),
        ("UPDATE tools SET tool_type = 'friction-7'", "tool", "tools T1"),
        ("UPDATE operations SET programmed_feed_mm_min = 248", "operation", "operations O1"),
    ] {
        damage(given, sql).await;
        n += 1;
        let answer = posted(&*store, n).await;
        let advice = &answer.recommendation.recommendation;
        assert_eq!(damaged(advice), [told], "{:?}", advice.reasons);
        is_neutral(advice);
        assert_eq!(faults(&*store).await, [format!("row {row}")]);
        assert_eq!(held(&*store).await.damaged, [row]);
        assert_eq!(store.check_cycles(None, 100).await.unwrap().faults, [], "{row}");
        let version = Precondition::Version(1);
        match told {
            "machine" => store.put_machine(machine("M1"), version, &engineer(), at(2)).await.map(|_| ()),
            "tool" => store.put_tool(tool("T1"), version, &engineer(), at(2)).await.map(|_| ()),
            "operation" => {
                store.put_operation(operation("O1"), version, &engineer(), at(2)).await.map(|_| ())
            }
            _ => store.add_calibration(&machine("M1").id, fitted(), &engineer(), at(2)).await.map(|_| ()),
        }
        .unwrap();
        n += 1;
        let answer = posted(&*store, n).await;
        let advice = &answer.recommendation.recommendation;
        assert!(advice.profile.is_some() && damaged(advice).is_empty(), "{sql}: {:?}", advice.reasons);
        if told == "machine's calibration" {
            // Later lines take its place. Whoever looked at it says by SQL that it is right.
            assert_eq!(faults(&*store).await, [format!("row {row}")]);
            damage(given, "UPDATE calibrations SET thrust_slope = 20, row_sum = NULL, summed_version = NULL WHERE version = 1")
                .await;
            assert_eq!(held(&*store).await, SumPage { unsummed: 1, ..SumPage::default() });
        }
        assert_eq!((faults(&*store).await, held(&*store).await), (vec![], SumPage::default()));
    }
    // The library, for an operation that asks for it.
    store.put_operation(turned(), Precondition::Version(2), &engineer(), at(3)).await.unwrap();
    let known = async || store.knowledge(&turned(), &tool("T1").id).await.unwrap();
    assert!(matches!(known().await, Knowledge::Turning { model: Some(_), .. }));
    damage(given, "UPDATE models SET body = replace(body, '1', '2')").await;
    assert_eq!(known().await, Knowledge::Damaged);
    let answer = posted(&*store, 20).await;
    assert_eq!(damaged(&answer.recommendation.recommendation), ["operation's library entry"]);
    is_neutral(&answer.recommendation.recommendation);
    assert_eq!(faults(&*store).await, ["row models turning/alaskari-oraby-2017"]);
    let models = store.models(ModelKind::Turning, Page { after: None, limit: 9 }).await.unwrap();
    assert!(models[0].is_damaged);
}

async fn a_row_that_does_not_decode_costs_no_cycle_and_is_put_anew(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    // Below the slowest feed, which no statement would be let do.
    if given.is_postgres() {
        given.raw("ALTER TABLE machines DROP CONSTRAINT machines_feed_range").await.unwrap();
        damage(given, "UPDATE machines SET feed_max_mm_min = 0.5").await;
    } else {
        damage(given, "PRAGMA ignore_check_constraints = ON; UPDATE machines SET feed_max_mm_min = 0.5")
            .await;
    }
    damage(given, "UPDATE operations SET setup = '{\"turning\": 7}'").await;
    let answer = posted(&*store, 1).await;
    let advice = &answer.recommendation.recommendation;
    assert_eq!(damaged(advice), ["machine", "operation"], "{:?}", advice.reasons);
    is_neutral(advice);
    // In their order and late: a fold that is made of what is stored goes by the same columns.
    for n in [3, 2] {
        posted(&*store, n).await;
        assert_eq!(store.check_wear(Repair::No).await.unwrap().different, [], "{n}");
    }
    if given.is_postgres() {
        given.raw("ALTER TABLE operations DROP CONSTRAINT operations_process_word").await.unwrap();
        damage(given, "UPDATE operations SET process = 'frictioo'").await;
    } else {
        damage(given, "PRAGMA ignore_check_constraints = ON; UPDATE operations SET process = 'frictioo'")
            .await;
    }
    for n in [6, 5] {
        is_neutral(&posted(&*store, n).await.recommendation.recommendation);
    }
    assert_eq!(held(&*store).await.damaged, ["machines M1", "operations O1"]);
    let named = faults(&*store).await;
    for row in ["row machines M1", "row operations O1"] {
        assert!(named.iter().any(|fault| fault == row), "{named:?}");
    }
    let version = || Precondition::Version(1);
    let put = store.put_machine(machine("M1"), version(), &engineer(), at(2)).await;
    assert_eq!(put.unwrap(), PutOutcome::Changed(2));
    let put = store.put_operation(operation("O1"), version(), &engineer(), at(2)).await;
    assert_eq!(put.unwrap(), PutOutcome::Changed(2));
    assert!(!faults(&*store).await.iter().any(|fault| fault.starts_with("row ")));
    let answer = posted(&*store, 7).await;
    assert_eq!(answer.recommendation.recommendation.feed_mm_min, Some(120.0));
    assert_eq!(answer.verdict.cycles, 6, "what came meanwhile counts");
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
}

/// As the migration leaves them, and as somebody leaves one who changes it by SQL and means it.
async fn rows_of_before_the_sums_are_summed_as_they_are(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    for n in 0..450 {
        let id = format!("T{n:03}-{}", "x".repeat(n % 7));
        store.put_tool(tool(&id), Precondition::Absent, &engineer(), at(1)).await.unwrap();
    }
    held(&*store).await;
    const SUMS: &str = "SELECT row_sum FROM machines UNION ALL SELECT row_sum FROM tools UNION ALL
        SELECT row_sum FROM operations UNION ALL SELECT row_sum FROM models ORDER BY 1";
    let sums = given.numbers(SUMS).await;
    for sql in [
        "UPDATE machines SET row_sum = NULL, summed_version = NULL",
        "UPDATE tools SET row_sum = NULL, summed_version = NULL",
        "UPDATE operations SET row_sum = NULL, summed_version = NULL",
        "UPDATE models SET row_sum = NULL, summed_version = NULL",
    ] {
        given.raw(sql).await.unwrap();
    }
    given.raw("UPDATE registry_generation SET changes = changes + 1 WHERE registry_id = 3").await.unwrap();
    // None says nothing.
    let advice = posted(&*store, 1).await.recommendation.recommendation;
    assert_eq!((advice.feed_mm_min, damaged(&advice)), (Some(120.0), vec![]));
    assert_eq!(faults(&*store).await, Vec::<String>::new());
    assert_eq!(held(&*store).await, SumPage { unsummed: 454, ..SumPage::default() });
    assert_eq!(held(&*store).await, SumPage::default(), "once");
    assert_eq!(given.numbers(SUMS).await, sums, "of what is read, and of what is written");
    damage(given, "UPDATE machines SET feed_max_mm_min = feed_max_mm_min / 2").await;
    assert_eq!(faults(&*store).await, ["row machines M1"]);
}

/// It counts the version up and leaves the sum as it was.
async fn what_a_server_of_before_writes_is_no_damage_where_one_may_run(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    held(&*store).await;
    damage(
        given,
        "UPDATE machines SET feed_max_mm_min = 100, version = 2, updated_at_us = updated_at_us + 7",
    )
    .await;
    let advice = posted(&*store, 1).await.recommendation.recommendation;
    if !given.is_postgres() {
        // No program of before opens such a file.
        assert_eq!(damaged(&advice), ["machine"]);
        assert_eq!(faults(&*store).await, ["row machines M1"]);
        return;
    }
    assert_eq!((advice.feed_mm_min, damaged(&advice)), (Some(100.0), vec![]), "{:?}", advice.reasons);
    assert_eq!(faults(&*store).await, Vec::<String>::new());
    // The sum of before goes nowhere: where no server of before runs it would be another one's.
    let folder = tempfile::tempdir().unwrap();
    let (file, cell) = (folder.path().join("backup"), folder.path().join("cell.sqlite3"));
    backed_up(given, &file).await.unwrap();
    restore_to_sqlite(&file, &cell).await.unwrap();
    let restored = SqliteStore::open(&cell, SqliteOptions::default()).await.unwrap();
    let shown = restored.machine(&machine("M1").id).await.unwrap().unwrap();
    assert_eq!((shown.value.limits.max_mm_min(), shown.is_damaged), (100.0, false));
    assert_eq!(held(&restored).await, SumPage { unsummed: 1, ..SumPage::default() });
    restored.close().await;
    // What is summed here meanwhile follows with the next copy, as it is the same row.
    let (from, to) = (Address::Postgres(given.address()), Address::Sqlite(folder.path().join("copied")));
    copied(&from, &to).await.unwrap();
    assert_eq!(held(&*store).await, SumPage { unsummed: 1, ..SumPage::default() });
    copied(&from, &to).await.unwrap();
    damage(given, "UPDATE machines SET feed_max_mm_min = 200").await;
    assert_eq!(damaged(&posted(&*store, 2).await.recommendation.recommendation), ["machine"]);
    // Counted back by nobody.
    damage(given, "UPDATE machines SET feed_max_mm_min = 100, version = 1").await;
    assert_eq!(damaged(&posted(&*store, 3).await.recommendation.recommendation), ["machine"]);
}

async fn a_feed_profile_that_is_for_somebody_else_is_not_run(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    super::feed_profiles::activated(&*store, 300.0).await;
    for (n, sql) in [
        (1, "UPDATE feed_profiles SET wear_from = 1001"),
        (2, "UPDATE feed_profile_versions SET content = replace(content, '300', '301')"),
    ] {
        damage(given, sql).await;
        let advice = posted(&*store, n).await.recommendation.recommendation;
        assert_eq!(damaged(&advice), ["feed profile"], "{:?}", advice.reasons);
        is_neutral(&advice);
        let active = store.active_profiles(&operation("O1").id, &tool("T1").id).await.unwrap();
        assert!(active.are_damaged && active.profiles.is_empty());
        given.raw("UPDATE feed_profiles SET wear_from = 1000").await.unwrap();
    }
}

/// A fold goes on by what stands there, as one that is made anew does, and follows what is put.
async fn folds_follow_when_a_damaged_operation_is_put_anew(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    let runs: Vec<Run> = (1..=40).map(Run::nth).collect();
    for outcome in commit(&*store, &runs[..20]).await {
        outcome.unwrap();
    }
    damage(given, "UPDATE operations SET baseline_cycles = baseline_cycles + 1").await;
    for outcome in commit(&*store, &runs[20..]).await {
        outcome.unwrap();
    }
    let put = store.put_operation(operation("O1"), Precondition::Version(1), &engineer(), at(9000)).await;
    assert_eq!(put.unwrap(), PutOutcome::Changed(2));
    let verdict = store.verdict(&tool("T1").id).await.unwrap();
    assert_eq!((verdict.cycles, verdict.counted), (40, 40), "{verdict:?}");
    assert_eq!(faults(&*store).await, Vec::<String>::new());
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
}

/// Both engines have the same sums: a plant believes what a cell has summed.
#[tokio::test]
async fn sums_go_along_from_one_engine_to_the_other() {
    let Some(plant) = Given::postgres().await else {
        return;
    };
    let cell = Given::sqlite().await;
    let store = cell.store();
    shop(&*store).await;
    let (from, to) = (Address::Sqlite(cell.file()), Address::Postgres(plant.address()));
    // Before its server has come to the paper's model, and after.
    copied(&from, &to).await.unwrap();
    assert_eq!(held(&*store).await.unsummed, 1);
    copied(&from, &to).await.unwrap();
    let there = PostgresStore::open(&plant.address(), PostgresOptions::default()).await.unwrap();
    assert_eq!(held(&there).await, SumPage::default(), "all are summed, and sound");
    plant.raw("UPDATE tools SET diameter_mm = 6.5").await.unwrap();
    assert_eq!(faults(&there).await, ["row tools T1"]);
    let refused = copied(&from, &to).await.unwrap_err().to_string();
    assert!(refused.contains("tools T1: it is not what was written"), "{refused}");
    there.close().await;
    cell.done().await;
    plant.done().await;
}

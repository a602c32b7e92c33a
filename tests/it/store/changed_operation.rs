//! A change of an operation is written at once, however long the history is: folds that are behind it go along when they are loaded.

use super::given::{
    Given, Run, at, commit, differing, engineer, machine, mounted, operation, shop, stored, stories, tool,
};
use feedwright_core::ids::ToolId;
use feedwright_core::operation::{Operation, WearSettings};
use feedwright_core::wear::Verdict;
use feedwright_store::{Alarm, AlarmFilter, Doubt, LevelPoint, Page, Precondition, Renewed, Repair, Store};
use std::collections::BTreeSet;

stories!(with tables:
    whoever_reads_judges_by_what_is_in_force,
    the_next_cycle_takes_its_fold_along,
    folds_follow_one_by_one_with_their_alarms,
    what_no_cycle_ran_changes_no_fold,
    a_check_believes_no_fold_that_is_behind,
    what_never_ran_it_is_known_without_its_cycles,
    one_of_many_folds_is_found_behind_those_that_need_not_follow,
    what_a_server_of_before_has_counted_is_found_out_once,
);

/// What is cached, as it was before the operation changed: as if no fold had followed it yet.
const CACHES: [&str; 3] = ["tool_wear", "tool_wear_checkpoints", "tool_checkpoints"];

const AS_IT_WAS: [&str; 5] = [
    "UPDATE tool_wear SET
         state = (SELECT state FROM kept_tool_wear AS kept
                  WHERE kept.machine_id = tool_wear.machine_id AND kept.tool_id = tool_wear.tool_id),
         ran = (SELECT ran FROM kept_tool_wear AS kept
                WHERE kept.machine_id = tool_wear.machine_id AND kept.tool_id = tool_wear.tool_id),
         judging_change = (SELECT judging_change FROM kept_tool_wear AS kept
                           WHERE kept.machine_id = tool_wear.machine_id AND kept.tool_id = tool_wear.tool_id)",
    "DELETE FROM tool_wear_checkpoints",
    "INSERT INTO tool_wear_checkpoints SELECT * FROM kept_tool_wear_checkpoints",
    "DELETE FROM tool_checkpoints",
    "INSERT INTO tool_checkpoints SELECT * FROM kept_tool_checkpoints",
];

/// T1 on two machines and T2 on one, both by O1 after O2; T3 by O2 alone. Hundreds of cycles, with states on the way.
async fn history(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    store.put_operation(operation("O2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    for id in ["T2", "T3"] {
        store.put_tool(tool(id), Precondition::Absent, &engineer(), at(0)).await.unwrap();
        mounted(&*store, id, -10).await;
    }
    let run = |n: u32| Run {
        machine: if n.is_multiple_of(4) { "M2" } else { "M1" },
        tool: ["T1", "T1", "T2", "T3"][n as usize / 4 % 4].to_owned(),
        operation: if n < 700 || n / 4 % 4 == 3 { "O2" } else { "O1" },
        sampled: false,
        load: 30.0 + f64::from(n % 11) * 0.1 + f64::from(n) * 0.002,
        ..Run::nth(n)
    };
    let runs: Vec<Run> = (1..=2000).map(run).map(|run| Run { machine: of(&run), ..run }).collect();
    for group in runs.chunks(100) {
        commit(&*store, group).await;
    }
}

/// Only T1 moves.
fn of(run: &Run) -> &'static str {
    if run.tool == "T1" { run.machine } else { "M1" }
}

/// What is told of the tools.
async fn told(store: &dyn Store) -> Vec<(Verdict, Vec<LevelPoint>)> {
    let mut told = Vec::new();
    for tool in ["T1", "T2", "T3"].map(|tool| ToolId::try_from(tool).unwrap()) {
        let levels = store.levels(&tool, at(80_000), at(1_000_000), 5000).await.unwrap();
        told.push((store.verdict(&tool).await.unwrap(), levels));
    }
    told
}

/// Open alarms; one of a tool that moved stands on each machine that ran it.
async fn alarms(store: &dyn Store) -> BTreeSet<(&'static str, Option<ToolId>)> {
    let page = Page { after: None, limit: 100 };
    let alarms: Vec<Alarm> =
        store.alarms(&AlarmFilter { open: Some(true), ..AlarmFilter::default() }, page).await.unwrap();
    alarms.into_iter().map(|alarm| (alarm.kind.as_str(), alarm.tool)).collect()
}

/// Makes all folds anew that are behind; the tools whose folds these were.
async fn follow(store: &dyn Store) -> Vec<ToolId> {
    let mut followed = Vec::new();
    while let Some(tool) = store.next_outdated_fold(followed.last()).await.unwrap() {
        assert_eq!(store.renew_fold(&tool, at(300_000)).await.unwrap(), Renewed::Whole);
        assert_eq!(store.renew_fold(&tool, at(300_000)).await.unwrap(), Renewed::Nothing, "once");
        followed.push(tool);
    }
    followed
}

/// Changes O1; what is told of the tools before, and by what is in force after it. Then the caches are again as they were.
async fn changed(given: &Given) -> [Vec<(Verdict, Vec<LevelPoint>)>; 2] {
    let store = given.store();
    for table in CACHES {
        let keep = sqlx::AssertSqlSafe(format!("CREATE TABLE kept_{table} AS SELECT * FROM {table}"));
        given.raw(keep).await.unwrap();
    }
    let before = told(&*store).await;
    let wear = WearSettings { baseline_cycles: 3, window_cycles: 4, ..Default::default() };
    let changed = Operation { wear, ..operation("O1") };
    store.put_operation(changed, Precondition::Version(1), &engineer(), at(200_000)).await.unwrap();
    // Those of a small shop follow at once, where the machine is fast enough.
    follow(&*store).await;
    let after = told(&*store).await;
    assert!(before[0] != after[0] && before[1] != after[1], "T1 and T2 ran it");
    assert_eq!(before[2], after[2], "T3 did not");
    for sql in AS_IT_WAS {
        given.raw(sql).await.unwrap();
    }
    [before, after]
}

async fn whoever_reads_judges_by_what_is_in_force(given: &Given) {
    history(given).await;
    let [_, after] = changed(given).await;
    assert_eq!(told(&*given.store()).await, after);
    let behind = given.numbers("SELECT judging_change FROM tool_wear ORDER BY tool_id, machine_id").await;
    assert_eq!(behind, [0, 0, 0, 0], "reading writes nothing");
}

async fn the_next_cycle_takes_its_fold_along(given: &Given) {
    let store = given.store();
    history(given).await;
    let [before, after] = changed(given).await;
    let next = |n: u32, tool: &str, operation| Run {
        tool: tool.to_owned(),
        operation,
        sampled: false,
        ..Run::nth(n)
    };
    // By the operation that changed, by another one, and late.
    let one = stored(&*store, &next(3000, "T2", "O1")).await.verdict;
    let other = stored(&*store, &next(3001, "T1", "O2")).await.verdict;
    let late = stored(&*store, &Run { id: "late".to_owned(), ..next(1000, "T3", "O2") }).await.verdict;
    let cycles = |verdict: &Verdict| verdict.cycles + 1;
    assert_eq!([one.cycles, other.cycles, late.cycles], [1, 0, 2].map(|at: usize| cycles(&after[at].0)));
    assert_ne!(other.baselines, before[0].0.baselines);
    let followed = given.numbers("SELECT judging_change FROM tool_wear ORDER BY tool_id, machine_id").await;
    assert_eq!(followed, [1, 1, 1, 1], "T1 on both machines");
    let check = store.check_wear(Repair::No).await.unwrap();
    assert_eq!(check.different, vec![]);
    assert_eq!(told(&*store).await[0].0, *other);
}

async fn folds_follow_one_by_one_with_their_alarms(given: &Given) {
    let store = given.store();
    history(given).await;
    let [_, after] = changed(given).await;
    let wanted = alarms(&*store).await;
    assert!(!wanted.is_empty());
    given.raw("DELETE FROM alarms WHERE tool_id <> 'T3'").await.unwrap();
    let followed = follow(&*store).await;
    assert_eq!(followed, ["T1", "T2"].map(|tool| ToolId::try_from(tool).unwrap()), "T3 did not run it");
    let numbers = "SELECT judging_change FROM tool_wear ORDER BY tool_id, machine_id";
    assert_eq!(given.numbers(numbers).await, [1, 1, 1, 0]);
    let states = given.wear_states().await;
    let last = store.note_unchanged_folds(None).await.unwrap().expect("T3");
    assert_eq!((last.0.as_str(), store.note_unchanged_folds(Some(&last)).await.unwrap()), ("T3", None));
    assert_eq!((given.numbers(numbers).await, given.wear_states().await), (vec![1, 1, 1, 1], states));
    assert_eq!(told(&*store).await, after);
    assert_eq!(alarms(&*store).await, wanted);
    let check = store.check_wear(Repair::No).await.unwrap();
    assert_eq!(check.different, vec![]);
}

async fn what_no_cycle_ran_changes_no_fold(given: &Given) {
    let store = given.store();
    history(given).await;
    store.put_operation(operation("O3"), Precondition::Absent, &engineer(), at(200_000)).await.unwrap();
    let wear = WearSettings { baseline_cycles: 3, ..Default::default() };
    let changed = Operation { wear, ..operation("O3") };
    store.put_operation(changed, Precondition::Version(1), &engineer(), at(200_000)).await.unwrap();
    let named = Operation { name: "another name".to_owned(), ..operation("O1") };
    store.put_operation(named, Precondition::Version(1), &engineer(), at(200_000)).await.unwrap();
    assert_eq!(given.numbers("SELECT MAX(judging_change) FROM operations").await, [0]);
    // One that was run before it was registered does.
    let early = Run { operation: "O4", sampled: false, ..Run::nth(3000) };
    stored(&*store, &early).await;
    store.put_operation(operation("O4"), Precondition::Absent, &engineer(), at(200_001)).await.unwrap();
    assert_eq!(given.numbers("SELECT MAX(judging_change) FROM operations").await, [1]);
    let verdict = store.verdict(&"T1".try_into().unwrap()).await.unwrap();
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, vec![]);
    assert_eq!(
        stored(&*store, &Run { operation: "O4", ..Run::nth(3001) }).await.verdict.cycles,
        verdict.cycles + 1
    );
}

async fn a_check_believes_no_fold_that_is_behind(given: &Given) {
    let store = given.store();
    history(given).await;
    let [_, after] = changed(given).await;
    let check = store.check_wear(Repair::No).await.unwrap();
    assert_eq!(check.different, vec![], "it goes along when it is loaded");
    given.raw("UPDATE tool_wear SET folded = folded - 1 WHERE tool_id = 'T2'").await.unwrap();
    assert_eq!(differing(&store.check_wear(Repair::No).await.unwrap()), [("M1", "T2")]);
    let repaired = store.check_wear(Repair::AllBut(&Doubt::default())).await.unwrap();
    assert!(repaired.different.iter().all(|wear| wear.left.is_none()), "{repaired:?}");
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, vec![]);
    assert_eq!(told(&*store).await, after);
}

/// Who looked through the cycles of T3 would find there that it ran O1: what it ran is told by its fold, however long its history is.
async fn what_never_ran_it_is_known_without_its_cycles(given: &Given) {
    let store = given.store();
    history(given).await;
    let [_, after] = changed(given).await;
    let moved = given.raw("UPDATE cycles SET operation_id = 'O1' WHERE tool_id = 'T3'").await.unwrap();
    assert_eq!(moved, 500);
    let followed = follow(&*store).await;
    assert_eq!(followed, ["T1", "T2"].map(|tool| ToolId::try_from(tool).unwrap()));
    let next = Run { tool: "T3".to_owned(), operation: "O2", sampled: false, ..Run::nth(3000) };
    let verdict = stored(&*store, &next).await.verdict;
    assert_eq!((verdict.cycles, &verdict.baselines), (after[2].0.cycles + 1, &after[2].0.baselines));
    // A check reads all of them, and tells what the fold does not.
    let told = store.check_wear(Repair::No).await.unwrap();
    assert_eq!(differing(&told), [("M1", "T3")]);
    given.raw("UPDATE cycles SET operation_id = 'O2' WHERE tool_id = 'T3'").await.unwrap();
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, vec![]);
}

/// More folds than are looked at at once, those of one tool among them.
async fn one_of_many_folds_is_found_behind_those_that_need_not_follow(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    store.put_operation(operation("O2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    for id in ["T2", "T3"] {
        store.put_tool(tool(id), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    }
    let machines: Vec<&'static str> = (0..230).map(|n| &*format!("N{n:03}").leak()).collect();
    for id in &machines {
        store.put_machine(machine(id), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    }
    let last = machines.len() - 1;
    let by = |at: usize| if at == last { "O1" } else { "O2" };
    let run = |(n, (at, machine)): (u32, (usize, &&'static str))| Run {
        machine,
        tool: "T2".to_owned(),
        operation: by(at),
        sampled: false,
        ..Run::nth(n)
    };
    let runs: Vec<Run> = (1..).zip(machines.iter().enumerate()).map(run).collect();
    commit(&*store, &runs).await;
    stored(&*store, &Run { tool: "T3".to_owned(), sampled: false, ..Run::nth(500) }).await;
    let numbers = "SELECT judging_change FROM tool_wear WHERE judging_change = 0";
    assert_eq!(given.numbers(numbers).await.len(), 231);

    // Numbered as a server does that is stopped then.
    let wear = WearSettings { baseline_cycles: 3, window_cycles: 4, ..Default::default() };
    let change = Operation { wear, ..operation("O1") };
    store.put_operation(change, Precondition::Version(1), &engineer(), at(200_000)).await.unwrap();
    given.raw("UPDATE tool_wear SET judging_change = 0").await.unwrap();
    let tools = ["T2", "T3"].map(|tool| ToolId::try_from(tool).unwrap());
    assert_eq!(store.next_outdated_fold(None).await.unwrap(), Some(tools[0].clone()), "by its last machine");
    assert_eq!(store.next_outdated_fold(Some(&tools[0])).await.unwrap(), Some(tools[1].clone()));
    assert_eq!(follow(&*store).await, tools);
    assert_eq!(given.numbers(numbers).await, [] as [i64; 0], "with one all of a tool go along");

    // Those of tools that ran it on no machine say so page by page.
    given.raw("UPDATE tool_wear SET judging_change = 0 WHERE machine_id < 'N229'").await.unwrap();
    let (mut pages, mut after) = (0, None);
    while let Some(last) = store.note_unchanged_folds(after.as_ref()).await.unwrap() {
        (pages, after) = (pages + 1, Some(last));
    }
    assert_eq!(pages, 3);
    assert_eq!(given.numbers(numbers).await.len(), 1, "T3 ran it and is left to be made anew");
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, vec![]);
}

/// Its folds say of fewer cycles which operations they ran, or nothing: nobody believes that, and who makes folds anew notes it.
async fn what_a_server_of_before_has_counted_is_found_out_once(given: &Given) {
    let store = given.store();
    history(given).await;
    let [_, after] = changed(given).await;
    let noted = "SELECT folded FROM tool_wear WHERE ran IS NOT NULL";
    let of_one_cycle = if given.is_postgres() {
        "UPDATE tool_wear SET ran = '\\x01'::BYTEA"
    } else {
        "UPDATE tool_wear SET ran = x'01'"
    };
    for of_before in ["UPDATE tool_wear SET ran = NULL", of_one_cycle] {
        assert_eq!(given.raw(of_before).await.unwrap(), 4);
        assert_eq!(told(&*store).await, after, "whoever reads reads the cycles");
        let followed = follow(&*store).await;
        assert_eq!(followed, ["T1", "T2", "T3"].map(|tool| ToolId::try_from(tool).unwrap()));
        assert_eq!(given.numbers(noted).await.len(), 4);
        assert_eq!(store.next_outdated_fold(None).await.unwrap(), None);
        assert_eq!(store.check_wear(Repair::No).await.unwrap().different, vec![]);
        assert_eq!(told(&*store).await, after);
        for sql in AS_IT_WAS {
            given.raw(sql).await.unwrap();
        }
    }
}

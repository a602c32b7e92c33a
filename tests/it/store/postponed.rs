//! Folds of many cycles that have to be made again: nobody waits for them, and what they come to is the same.

use super::given::{
    Given, Run, at, commit, engineer, event, machine, mounted, operation, shop, stored, stories,
};
use feedwright_core::ids::ToolId;
use feedwright_core::operation::{Operation, WearSettings};
use feedwright_core::tool::ToolEventKind;
use feedwright_core::wear::{ToolState, Verdict};
use feedwright_store::{AlarmFilter, AlarmKind, Committed, Page, Precondition, Renewed, Repair, Store};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::timeout;

stories!(
    before_a_long_history_a_cycle_is_counted_in_the_background,
    where_a_clock_was_never_set_that_is_told_while_it_is_counted,
    whatever_comes_meanwhile_it_ends_in_the_same_state,
    alarms_stay_until_it_is_known_what_to_raise,
    a_long_history_is_counted_in_the_background_once_its_tool_is_registered,
);

mod tables {
    super::stories!(with tables:
        the_first_cycle_on_a_second_machine_is_no_reason_to_fold_a_long_history_again,
        where_the_cache_of_one_machine_is_lost_another_ones_is_not_that_of_the_tool,
        what_was_run_is_known_while_it_is_left_to_the_background,
        states_before_what_changed_are_gone_on_from,
    );
    use super::{
        states_before_what_changed_are_gone_on_from,
        the_first_cycle_on_a_second_machine_is_no_reason_to_fold_a_long_history_again,
        what_was_run_is_known_while_it_is_left_to_the_background,
        where_the_cache_of_one_machine_is_lost_another_ones_is_not_that_of_the_tool,
    };
}

/// More than are folded while others wait.
const MANY: u32 = 10_300;

fn nth(n: u32) -> Run {
    Run { sampled: false, load: 30.0 + f64::from(n % 7) * 0.05, ..Run::nth(n) }
}

fn t1() -> ToolId {
    "T1".try_into().unwrap()
}

async fn run(store: &dyn Store, runs: &[Run]) {
    for group in runs.chunks(500) {
        for outcome in commit(store, group).await {
            assert!(matches!(outcome, Ok(Committed::Stored(_))), "{outcome:?}");
        }
    }
}

async fn long_history(store: &dyn Store) {
    history(store, MANY).await;
}

async fn history(store: &dyn Store, cycles: u32) {
    shop(store).await;
    run(store, &(1..=cycles).map(nth).collect::<Vec<_>>()).await;
}

async fn assert_clean(store: &dyn Store) {
    let check = store.check_wear(Repair::No).await.unwrap();
    assert_eq!((check.different, check.unreadable), (vec![], vec![]));
}

async fn verdict(store: &dyn Store) -> Verdict {
    store.verdict(&t1()).await.unwrap()
}

/// Goes on in the background to the end; in how many parts before the last one.
async fn renewed(store: &dyn Store) -> u32 {
    assert_eq!(store.next_outdated_fold(None).await.unwrap(), Some(t1()));
    for parts in 0..100 {
        match store.renew_fold(&t1(), at(700_000)).await.unwrap() {
            Renewed::Part => assert!(verdict(store).await.is_being_counted()),
            Renewed::Whole => {
                assert_eq!(store.next_outdated_fold(None).await.unwrap(), None);
                assert_eq!(store.renew_fold(&t1(), at(700_000)).await.unwrap(), Renewed::Nothing);
                return parts;
            }
            Renewed::Nothing => panic!("after {parts} parts nothing was left, and nobody said so"),
        }
    }
    panic!("there is no end of it");
}

async fn before_a_long_history_a_cycle_is_counted_in_the_background(store: Arc<dyn Store>) {
    long_history(&*store).await;
    let before = verdict(&*store).await;
    assert_eq!((before.state, before.cycles), (ToolState::Good, u64::from(MANY)));
    let told = store.folds_postponed();
    assert!(timeout(Duration::ZERO, told.notified()).await.is_err(), "nothing is left to anybody");

    let late = stored(&*store, &Run { seconds: 1, seq: None, id: "late".to_owned(), ..nth(0) }).await;
    assert!(late.verdict.is_being_counted());
    assert_eq!((late.verdict.state, late.verdict.level), (ToolState::Unknown, None));
    let advised = late.recommendation.recommendation.override_percent;
    assert_eq!(advised.to_bits(), 100.0_f64.to_bits(), "what is unknown raises no feed");
    timeout(Duration::ZERO, told.notified()).await.expect("who folds in the background is told");
    assert_eq!(verdict(&*store).await, *late.verdict, "who reads is told what the machine was told");
    assert_clean(&*store).await;

    // Neither the next cycle nor the same once more has it folded.
    assert!(stored(&*store, &nth(MANY + 1)).await.verdict.is_being_counted());
    let again = commit(&*store, &[nth(MANY + 1)]).await.pop().unwrap().unwrap();
    assert!(matches!(again, Committed::Known(answer) if answer.verdict.is_being_counted()));
    // Of other tools everything is known.
    let other = stored(&*store, &Run { tool: "T2".to_owned(), id: "other".to_owned(), ..nth(3) }).await;
    assert!(!other.verdict.is_being_counted());
    // How far a life goes back is read all the same.
    let life = store.life(&t1(), 3).await.unwrap();
    assert_eq!((life.cycles.len(), life.before), (3, u64::from(MANY) - 1));

    assert!(renewed(&*store).await >= 2, "posts have the writer in between");
    let after = verdict(&*store).await;
    assert_eq!((after.state, after.cycles), (ToolState::Good, u64::from(MANY) + 2));
    assert_eq!(after, life.verdict);
    assert_clean(&*store).await;
    let next = stored(&*store, &nth(MANY + 2)).await;
    assert_eq!((next.verdict.state, next.verdict.cycles), (ToolState::Good, u64::from(MANY) + 3));
    assert_clean(&*store).await;
}

async fn where_a_clock_was_never_set_that_is_told_while_it_is_counted(store: Arc<dyn Store>) {
    long_history(&*store).await;
    let codes = |verdict: &Verdict| verdict.reasons.iter().map(|(code, _)| *code).collect::<Vec<_>>();
    // An hour after 1970 began.
    let seconds = 3_600 - at(0).micros() / 1_000_000;
    let late = Run { seconds, seq: None, id: "1970".to_owned(), ..nth(0) };
    let verdict_then = stored(&*store, &late).await.verdict;
    assert_eq!(codes(&verdict_then), ["being_counted", "clock_never_set"]);
    assert_eq!(verdict(&*store).await, *verdict_then, "who reads is told what the machine was told");
    renewed(&*store).await;
    let after = verdict(&*store).await;
    assert_eq!((after.state, codes(&after)), (ToolState::Good, vec!["good"]), "one such cycle tells nothing");

    let before = stored(&*store, &Run { seconds: 1, seq: None, id: "late".to_owned(), ..nth(0) }).await;
    assert_eq!(codes(&before.verdict), ["being_counted", "clock_never_set"], "it is still there");
}

async fn whatever_comes_meanwhile_it_ends_in_the_same_state(store: Arc<dyn Store>) {
    // So many that none of what comes has the rest of them folded at once.
    let cycles = 16_000;
    history(&*store, cycles).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    let late = async |machine: &'static str, seconds: i64| {
        let run = Run { machine, seconds, seq: None, id: format!("late-{machine}-{seconds}"), ..nth(5) };
        assert!(stored(&*store, &run).await.verdict.is_being_counted(), "{machine} {seconds}");
    };
    let part = async || assert_eq!(store.renew_fold(&t1(), at(0)).await.unwrap(), Renewed::Part);
    late("M1", 90).await;
    part().await;
    // Before what was folded by now, after it, and on another machine.
    late("M1", 200_030).await;
    late("M1", 700_030).await;
    late("M2", 95).await;
    assert!(stored(&*store, &nth(cycles + 1)).await.verdict.is_being_counted());
    part().await;
    assert_clean(&*store).await;
    let wear = WearSettings { baseline_cycles: 6, ..WearSettings::default() };
    let changed = Operation { wear, ..operation("O1") };
    store.put_operation(changed, Precondition::Version(1), &engineer(), at(0)).await.unwrap();
    part().await;
    late("M2", 300_030).await;
    store
        .add_tool_event(&t1(), event(ToolEventKind::Changed, at(400_000)), &engineer(), at(0))
        .await
        .unwrap();
    part().await;
    assert_clean(&*store).await;
    let parts = renewed(&*store).await;
    assert!(parts > 3, "of the machines, and then over both: {parts}");
    assert_clean(&*store).await;
    let whole = verdict(&*store).await;
    assert_eq!(whole, store.life(&t1(), 1).await.unwrap().verdict);
    // One each minute from 400,000 s on, and one that came late.
    assert_eq!((whole.life, whole.cycles), (2, u64::from(cycles) + 1 - 6_666 + 1));
    let next = stored(&*store, &nth(cycles + 2)).await.verdict;
    assert_eq!((next.state, next.cycles), (ToolState::Good, whole.cycles + 1));
}

async fn alarms_stay_until_it_is_known_what_to_raise(store: Arc<dyn Store>) {
    long_history(&*store).await;
    let open = async || -> Vec<AlarmKind> {
        let filter = AlarmFilter { open: Some(true), ..AlarmFilter::default() };
        let alarms = store.alarms(&filter, Page { after: None, limit: 10 }).await.unwrap();
        alarms.into_iter().map(|alarm| alarm.kind).collect()
    };
    let risen = |n: u32| Run { load: 30.0 + 0.1 * f64::from((n - MANY).min(36)), ..nth(n) };
    run(&*store, &(MANY + 1..MANY + 60).map(risen).collect::<Vec<_>>()).await;
    assert_eq!((verdict(&*store).await.state, open().await), (ToolState::Worn, vec![AlarmKind::Worn]));
    mounted(&*store, "T1", -10).await;
    assert!(verdict(&*store).await.is_being_counted());
    stored(&*store, &risen(MANY + 60)).await;
    assert_eq!(open().await, [AlarmKind::Worn], "nobody knows better yet");
    renewed(&*store).await;
    assert_eq!((verdict(&*store).await.state, open().await), (ToolState::Worn, vec![AlarmKind::Worn]));
    // The other way round: what is told while it is counted acts when it is.
    stored(&*store, &Run { seconds: 1, seq: None, id: "late".to_owned(), ..nth(0) }).await;
    let now = at(i64::from(MANY + 61) * 60);
    store.add_tool_event(&t1(), event(ToolEventKind::Changed, now), &engineer(), now).await.unwrap();
    assert_eq!(open().await, [AlarmKind::Worn]);
    renewed(&*store).await;
    assert_eq!((verdict(&*store).await.cycles, open().await), (0, vec![]));
    assert_clean(&*store).await;
}

async fn a_long_history_is_counted_in_the_background_once_its_tool_is_registered(store: Arc<dyn Store>) {
    shop(&*store).await;
    let of = |n: u32| Run { tool: "T9".to_owned(), ..nth(n) };
    run(&*store, &(1..=MANY).map(of).collect::<Vec<_>>()).await;
    let t9: ToolId = "T9".try_into().unwrap();
    let mut tool = super::given::tool("T9");
    tool.name = "a late one".to_owned();
    store.put_tool(tool, Precondition::Absent, &engineer(), at(0)).await.unwrap();
    assert!(store.verdict(&t9).await.unwrap().is_being_counted());
    assert_eq!(store.next_outdated_fold(None).await.unwrap().as_ref(), Some(&t9));
    while store.renew_fold(&t9, at(700_000)).await.unwrap() == Renewed::Part {}
    let whole = store.verdict(&t9).await.unwrap();
    assert_eq!((whole.state, whole.cycles), (ToolState::Good, u64::from(MANY)));
    assert_clean(&*store).await;
}

async fn the_first_cycle_on_a_second_machine_is_no_reason_to_fold_a_long_history_again(given: &Given) {
    let store = given.store();
    long_history(&*store).await;
    for id in ["M2", "M3"] {
        store.put_machine(machine(id), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    }
    let on = |machine: &'static str, seconds: i64| Run {
        machine,
        seconds,
        id: format!("on-{machine}-{seconds}"),
        ..nth(9)
    };
    // In the middle of what the first one ran: what comes after it is folded again, and no more.
    let middle = i64::from(MANY) * 30;
    let moved = stored(&*store, &on("M2", middle)).await;
    assert_eq!((moved.verdict.state, moved.verdict.cycles), (ToolState::Good, u64::from(MANY) + 1));
    let kept = "SELECT CAST(COUNT(*) AS BIGINT) FROM tool_checkpoints";
    assert_eq!(given.numbers(kept).await, [i64::from((MANY + 1) / 256)], "all of them, from the first on");
    assert_eq!(verdict(&*store).await, *moved.verdict);
    assert_clean(&*store).await;
    // And as the newest of all.
    let newest = stored(&*store, &on("M3", i64::from(MANY + 1) * 60)).await;
    assert_eq!((newest.verdict.state, newest.verdict.cycles), (ToolState::Learning, u64::from(MANY) + 2));
    assert_eq!(verdict(&*store).await, *newest.verdict);
    assert_clean(&*store).await;
}

async fn where_the_cache_of_one_machine_is_lost_another_ones_is_not_that_of_the_tool(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    for id in ["M2", "M3"] {
        store.put_machine(machine(id), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    }
    let on = |machine: &'static str, n: u32| Run {
        machine,
        seconds: i64::from(n) * 60 + 1,
        id: format!("{machine}-{n}"),
        ..nth(n)
    };
    for n in 1..=300 {
        run(&*store, &[nth(n), on("M2", n)]).await;
    }
    assert_eq!(given.raw("DELETE FROM tool_wear WHERE machine_id = 'M2'").await.unwrap(), 1);
    let third = stored(&*store, &on("M3", 301)).await;
    assert_eq!(third.verdict.cycles, 601, "of all three");
}

/// Changes how an operation's cycles are judged.
async fn judged_otherwise(store: &dyn Store, id: &str) {
    let wear = WearSettings { baseline_cycles: 7, ..WearSettings::default() };
    let changed = Operation { wear, ..operation(id) };
    store.put_operation(changed, Precondition::Version(1), &engineer(), at(0)).await.unwrap();
}

async fn what_was_run_is_known_while_it_is_left_to_the_background(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    store.put_operation(operation("O2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    // On the second machine a few cycles of another operation, all of them before the first state of that machine, but not of both.
    for n in 1..=200 {
        let other = Run {
            machine: "M2",
            operation: "O2",
            seconds: i64::from(n) * 60 + 1,
            id: format!("other-{n}"),
            ..nth(n)
        };
        run(&*store, &[nth(n), other]).await;
    }
    let later = |n: u32| Run { machine: "M2", ..nth(n) };
    run(&*store, &(301..=300 + MANY).map(later).collect::<Vec<_>>()).await;
    let before = "SELECT CAST(COUNT(*) AS BIGINT) FROM tool_checkpoints WHERE folded = 256";
    let confirmed = event(ToolEventKind::ConditionsConfirmed, at(250 * 60));
    store.add_tool_event(&t1(), confirmed, &engineer(), at(0)).await.unwrap();
    assert!(verdict(&*store).await.is_being_counted());
    assert_eq!(given.numbers(before).await, [1], "what is before the event holds");
    judged_otherwise(&*store, "O2").await;
    renewed(&*store).await;
    assert_clean(&*store).await;
}

async fn states_before_what_changed_are_gone_on_from(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    store.put_operation(operation("O2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    let of = |n: u32| Run { operation: if n > 600 { "O2" } else { "O1" }, ..nth(n) };
    run(&*store, &(1..=MANY + 600).map(of).collect::<Vec<_>>()).await;
    judged_otherwise(&*store, "O2").await;
    assert_eq!(store.renew_fold(&t1(), at(0)).await.unwrap(), Renewed::Part);
    let states = given.numbers("SELECT folded FROM tool_wear_checkpoints ORDER BY folded").await;
    let whole: Vec<i64> = (1..=10).map(|state| state * 256).collect();
    assert_eq!(states, whole, "two that hold, and eight more");
    renewed(&*store).await;
    assert_clean(&*store).await;
}

//! Wear is the fold over the unique cycles in their order, however and whenever they arrive.

use super::given::{
    Given, Run, at, commit, differing, engineer, event, machine, mounted, new_cycle, operation, shop, stored,
    stories, tool,
};
use feedwright_core::cycle::{Cycle, Flag, Reported};
use feedwright_core::operation::WearSettings;
use feedwright_core::recommend::RecommendSettings;
use feedwright_core::tool::{ToolEvent, ToolEventKind};
use feedwright_core::units::Timestamp;
use feedwright_core::wear::{CycleFacts, Exclusion, FoldSettings, ToolFold, ToolState, Verdict};
use feedwright_store::{Actor, Committed, Doubt, NewCycle, Precondition, Repair, Store, StoredToolEvent};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use std::sync::Arc;

stories!(
    cycles_of_an_unregistered_tool_count_once_it_is_registered,
    any_order_of_arrival_ends_in_the_same_state,
    a_long_history_is_refolded_from_checkpoints,
    a_tool_that_moves_is_folded_over_all_machines,
    an_event_takes_effect_with_the_cycle_it_names,
    an_event_after_the_last_cycle_acts_at_once,
    changed_settings_are_judged_again,
    what_was_run_is_judged_by_what_its_operation_asked_for_then,
    what_is_told_of_an_operation_later_holds_for_what_came_before,
    a_beginning_that_is_told_late_is_the_beginning,
    an_event_that_a_clock_which_was_ahead_told_is_revoked_and_told_again,
    wherever_an_event_stands_it_is_as_if_it_had_not_been_told_once_it_is_revoked,
    cycles_that_were_cut_short_do_not_count_however_they_arrive,
    cycles_without_a_clock_make_the_life_unknown_in_which_they_came_in,
    a_cycle_of_before_new_conditions_is_told_over_the_baseline_of_then,
);

mod tables {
    super::stories!(with tables:
        a_damaged_cache_is_found_and_repaired,
        a_cache_that_is_lost_is_folded_again_with_the_next_cycle,
        a_late_cycle_is_counted_whatever_the_key_of_a_checkpoint_says,
        a_late_cycle_of_a_tool_that_moves_is_counted_whatever_a_key_says,
        a_long_history_on_several_machines_is_refolded_from_checkpoints,
    );
    use super::{
        a_cache_that_is_lost_is_folded_again_with_the_next_cycle, a_damaged_cache_is_found_and_repaired,
        a_late_cycle_is_counted_whatever_the_key_of_a_checkpoint_says,
        a_late_cycle_of_a_tool_that_moves_is_counted_whatever_a_key_says,
        a_long_history_on_several_machines_is_refolded_from_checkpoints,
    };
}

/// The fold as the book has it: every cycle once, in order, nothing cached.
fn naive(runs: &[Run], mounted_first: bool, settings: WearSettings) -> Verdict {
    let settings = FoldSettings { wear: settings, ..FoldSettings::of(&operation("O1")) };
    let mut facts: Vec<CycleFacts> = runs
        .iter()
        .map(|run| {
            let new = run.new_cycle();
            CycleFacts::of(&new.cycle, &new.summary, new.received_at)
        })
        .collect();
    facts.sort_by(|a, b| a.order.cmp(&b.order));
    facts.dedup_by(|a, b| a.order == b.order);
    let mut fold = ToolFold::default();
    if mounted_first {
        fold = ToolFold::awaiting_mount();
        fold.event(ToolEventKind::MountedNew, at(0));
    }
    for facts in &facts {
        fold.cycle(facts, Some(&settings));
    }
    fold.verdict()
}

async fn assert_clean(store: &dyn Store) {
    let check = store.check_wear(Repair::No).await.unwrap();
    assert_eq!(check.different, vec![], "of {} rows", check.rows);
    assert!(check.rows > 0);
}

async fn cycles_of_an_unregistered_tool_count_once_it_is_registered(store: Arc<dyn Store>) {
    let who = engineer();
    store.put_machine(machine("M1"), Precondition::Absent, &who, at(0)).await.unwrap();
    store.put_operation(operation("O1"), Precondition::Absent, &who, at(0)).await.unwrap();
    let runs: Vec<Run> = (1..=8).map(Run::nth).collect();
    for run in &runs {
        let answer = stored(&*store, run).await;
        assert!(!answer.registered);
        assert!(answer.summary.flags.contains(Flag::ToolUnregistered));
        assert_eq!(answer.verdict.state, ToolState::Unknown);
        let advised = answer.recommendation.recommendation.override_percent;
        assert_eq!(advised.to_bits(), 100.0_f64.to_bits(), "neutral is exactly 100 %");
    }
    let id = "T1".try_into().unwrap();
    assert_eq!(store.verdict(&id).await.unwrap().state, ToolState::Unknown);
    assert!(
        store.add_tool_event(&id, event(ToolEventKind::Changed, at(0)), &who, at(0)).await.unwrap().is_none()
    );
    store.put_tool(tool("T1"), Precondition::Absent, &who, at(1000)).await.unwrap();
    let verdict = store.verdict(&id).await.unwrap();
    assert_eq!(verdict, naive(&runs, false, WearSettings::default()));
    assert_eq!((verdict.state, verdict.cycles), (ToolState::Good, 8));
    assert!(stored(&*store, &Run::nth(9)).await.registered);
    assert_clean(&*store).await;
}

async fn any_order_of_arrival_ends_in_the_same_state(store: Arc<dyn Store>) {
    shop(&*store).await;
    let mut runner = TestRunner::deterministic();
    for case in 0..10 {
        let id = format!("T-case-{case}");
        store.put_tool(tool(&id), Precondition::Absent, &engineer(), at(0)).await.unwrap();
        mounted(&*store, &id, -10).await;
        let loads = prop::collection::vec(0_u32..60, 45).new_tree(&mut runner).unwrap().current();
        let runs: Vec<Run> = loads
            .iter()
            .zip(0_u32..)
            .map(|(&noise, n)| {
                // Slow wear with noise; now and then hardly any load. Some share their second, some have no count.
                let load = if noise == 7 { 0.5 } else { 28.0 + f64::from(n) * 0.1 + f64::from(noise) * 0.02 };
                Run {
                    tool: id.clone(),
                    id: format!("{id}-{n}"),
                    seconds: i64::from(n / 3 * 60),
                    seq: (n % 4 != 0).then_some(u64::from(n)),
                    load,
                    ..Run::nth(n)
                }
            })
            .collect();
        let arrival = Just((0..runs.len()).collect::<Vec<_>>()).prop_shuffle().new_tree(&mut runner).unwrap();
        let size = (1_usize..12).new_tree(&mut runner).unwrap().current();
        for group in arrival.current().chunks(size) {
            // Each group repeats its first cycle: an edge buffer replays what it is not sure of.
            let group: Vec<Run> =
                group.iter().chain(group.first()).map(|&index| runs[index].clone()).collect();
            for outcome in commit(&*store, &group).await {
                assert!(matches!(outcome, Ok(Committed::Stored(_) | Committed::Known(_))), "{outcome:?}");
            }
        }
        let verdict = store.verdict(&id.as_str().try_into().unwrap()).await.unwrap();
        assert_eq!(verdict, naive(&runs, true, WearSettings::default()), "{id} in groups of {size}");
    }
    assert_clean(&*store).await;
}

async fn a_long_history_is_refolded_from_checkpoints(store: Arc<dyn Store>) {
    shop(&*store).await;
    let runs: Vec<Run> = (1..=700)
        .map(|n| Run { sampled: false, load: 30.0 + f64::from(n % 11) * 0.1, ..Run::nth(n) })
        .collect();
    let late = [3_usize, 255, 256, 257, 511, 600];
    let live: Vec<Run> =
        runs.iter().enumerate().filter(|(at, _)| !late.contains(at)).map(|(_, run)| run.clone()).collect();
    for group in live.chunks(64) {
        for outcome in commit(&*store, group).await {
            assert!(matches!(outcome, Ok(Committed::Stored(_))), "{outcome:?}");
        }
    }
    assert_clean(&*store).await;
    // Newest first, so that each one comes before what is folded and not every one goes back to the beginning.
    for index in late.into_iter().rev() {
        stored(&*store, &runs[index]).await;
        assert_clean(&*store).await;
    }
    let verdict = store.verdict(&"T1".try_into().unwrap()).await.unwrap();
    assert_eq!(verdict, naive(&runs, true, WearSettings::default()));
}

async fn a_tool_that_moves_is_folded_over_all_machines(store: Arc<dyn Store>) {
    shop(&*store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    let runs: Vec<Run> =
        (1..=24).map(|n| Run { machine: if n / 6 % 2 == 0 { "M1" } else { "M2" }, ..Run::nth(n) }).collect();
    let backwards: Vec<Run> = runs.iter().rev().cloned().collect();
    for group in backwards.chunks(5) {
        commit(&*store, group).await;
    }
    let verdict = store.verdict(&"T1".try_into().unwrap()).await.unwrap();
    assert_eq!(verdict, naive(&runs, true, WearSettings::default()));
    assert_eq!(verdict.cycles, 24);
    let check = store.check_wear(Repair::No).await.unwrap();
    assert_eq!((check.rows, check.different), (2, vec![]));
}

/// Shared by three machines in turn, some of whose cycles come late, each of which is held against all there are by then.
async fn a_long_history_on_several_machines_is_refolded_from_checkpoints(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    for id in ["M2", "M3"] {
        store.put_machine(machine(id), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    }
    let all: Vec<Run> = (1..=900)
        .map(|n| Run {
            machine: ["M1", "M2", "M3"][n as usize / 5 % 3],
            sampled: false,
            load: 30.0 + f64::from(n % 11) * 0.1 + f64::from(n) * 0.002,
            ..Run::nth(n)
        })
        .collect();
    let late = [2_usize, 254, 255, 256, 300, 511, 700, 701, 850];
    let live: Vec<Run> =
        all.iter().enumerate().filter(|(at, _)| !late.contains(at)).map(|(_, run)| run.clone()).collect();
    let tool = "T1".try_into().unwrap();
    let mut came = Vec::new();
    let as_it_is = async |came: &[Run]| {
        let mut in_order = came.to_vec();
        in_order.sort_by_key(|run| run.seconds);
        assert_eq!(store.verdict(&tool).await.unwrap(), naive(&in_order, true, WearSettings::default()));
    };
    for group in live.chunks(61) {
        for outcome in commit(&*store, group).await {
            assert!(matches!(outcome, Ok(Committed::Stored(_))), "{outcome:?}");
        }
        came.extend_from_slice(group);
        as_it_is(&came).await;
    }
    let kept = "UPDATE tool_checkpoints SET folded = folded";
    assert_eq!(given.raw(kept).await.unwrap(), 3, "states on the way over all machines");
    // Backwards and forwards, alone and behind newer ones of another machine.
    for index in [8, 0, 7, 1, 6, 2, 5, 3, 4] {
        stored(&*store, &all[late[index]]).await;
        came.push(all[late[index]].clone());
        as_it_is(&came).await;
        assert_clean(&*store).await;
    }
    let levels = store.levels(&tool, at(0), at(1_000_000), 2000).await.unwrap();
    let from = levels[600].key.0;
    let some = store.levels(&tool, from, at(1_000_000), 2000).await.unwrap();
    assert_eq!(some, levels[600..], "levels go on from a state on the way");

    for damage in [
        "UPDATE tool_checkpoints SET last_started_at_us = last_started_at_us - 8000000000 WHERE folded = 512",
        "UPDATE tool_checkpoints SET last_machine_id = 'M9' WHERE folded = 512",
        "UPDATE tool_checkpoints SET folded = 900 WHERE folded = 768",
        "UPDATE tool_checkpoints SET state = (SELECT state FROM tool_checkpoints WHERE folded = 256) WHERE folded = 768",
    ] {
        assert_eq!(given.raw(damage).await.unwrap(), 1, "{damage}");
        assert_eq!(differing(&store.check_wear(Repair::No).await.unwrap()), [("M1", "T1")], "{damage}");
        let repaired = store.check_wear(Repair::AllBut(&Doubt::default())).await.unwrap();
        assert_eq!(repaired.different[0].left, None, "{damage}");
        assert_clean(&*store).await;
        as_it_is(&came).await;
    }
    assert_eq!(given.raw(kept).await.unwrap(), 3);
}

/// A late cycle is counted also where the key of a state over all machines says that it has been.
async fn a_late_cycle_of_a_tool_that_moves_is_counted_whatever_a_key_says(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    let runs: Vec<Run> = (1..=300)
        .map(|n| Run {
            machine: if n % 2 == 0 { "M1" } else { "M2" },
            sampled: false,
            load: 30.0 + f64::from(n % 11) * 0.1,
            ..Run::nth(n)
        })
        .collect();
    let late = &runs[199];
    let live: Vec<Run> = runs.iter().filter(|run| run.id != late.id).cloned().collect();
    commit(&*store, &live).await;
    let earlier = "UPDATE tool_checkpoints SET last_started_at_us = last_started_at_us - 6000000000";
    assert_eq!(given.raw(earlier).await.unwrap(), 1);
    stored(&*store, late).await;
    let verdict = store.verdict(&"T1".try_into().unwrap()).await.unwrap();
    assert_eq!(verdict, naive(&runs, true, WearSettings::default()));
    assert_clean(&*store).await;
}

async fn an_event_takes_effect_with_the_cycle_it_names(store: Arc<dyn Store>) {
    shop(&*store).await;
    let id = "T1".try_into().unwrap();
    for n in (1..=5).chain(7..=10) {
        stored(&*store, &Run::nth(n)).await;
    }
    // Told before the named cycle arrived, with a time far off: until then the time is all there is.
    let mut changed = event(ToolEventKind::Changed, at(9 * 60));
    changed.first_cycle = Some(("M1".try_into().unwrap(), "c00006".try_into().unwrap()));
    let told = store.add_tool_event(&id, changed.clone(), &engineer(), at(700)).await.unwrap().unwrap();
    let verdict = store.verdict(&id).await.unwrap();
    assert_eq!((verdict.life, verdict.cycles), (2, 2), "cycles 9 and 10");
    assert_clean(&*store).await;

    let answer = stored(&*store, &Run::nth(6)).await;
    assert_eq!((answer.verdict.life, answer.verdict.cycles), (2, 5), "cycles 6 to 10");
    assert_eq!(store.verdict(&id).await.unwrap(), *answer.verdict);
    assert_clean(&*store).await;

    let page = feedwright_store::Page { after: None, limit: 10 };
    let events = store.tool_events(&id, page).await.unwrap();
    assert_eq!(events.len(), 2);
    assert_eq!(events[1], told);
    assert_eq!(events[1].event, changed);
    let page = feedwright_store::Page { after: Some(events[0].id), limit: 10 };
    assert_eq!(store.tool_events(&id, page).await.unwrap(), events[1..]);
}

async fn an_event_after_the_last_cycle_acts_at_once(store: Arc<dyn Store>) {
    shop(&*store).await;
    let id = "T1".try_into().unwrap();
    for n in 1..=9 {
        stored(&*store, &Run::nth(n)).await;
    }
    assert_eq!(store.verdict(&id).await.unwrap().state, ToolState::Good);
    store.add_tool_event(&id, event(ToolEventKind::Changed, at(600)), &engineer(), at(600)).await.unwrap();
    let verdict = store.verdict(&id).await.unwrap();
    assert_eq!((verdict.life, verdict.cycles), (2, 0));
    assert_ne!(verdict.state, ToolState::Good, "the old tool says nothing of the new one");
    // A cycle that began before the change and comes only now still belongs to the old tool.
    let late = stored(&*store, &Run { seconds: 570, id: "late".to_owned(), ..Run::nth(10) }).await;
    assert_eq!((late.verdict.life, late.verdict.cycles), (2, 0));
    let next = stored(&*store, &Run::nth(11)).await;
    assert_eq!((next.verdict.life, next.verdict.cycles), (2, 1));
    assert_clean(&*store).await;
}

async fn a_beginning_that_is_told_late_is_the_beginning(store: Arc<dyn Store>) {
    let who = engineer();
    store.put_machine(machine("M1"), Precondition::Absent, &who, at(0)).await.unwrap();
    store.put_operation(operation("O1"), Precondition::Absent, &who, at(0)).await.unwrap();
    store.put_tool(tool("T1"), Precondition::Absent, &who, at(0)).await.unwrap();
    let id = "T1".try_into().unwrap();
    let runs: Vec<Run> =
        (1..=260).filter(|n| *n != 3).map(|n| Run { sampled: false, ..Run::nth(n) }).collect();
    commit(&*store, &runs).await;
    let tell = async |kind, first: Option<&str>, when| {
        let mut told = event(kind, when);
        told.first_cycle = first.map(|cycle| ("M1".try_into().unwrap(), cycle.try_into().unwrap()));
        store.add_tool_event(&id, told, &who, when).await.unwrap().unwrap();
        assert_clean(&*store).await;
    };
    // Each of these moves what the first life begins with: last the cycle that the mounting names comes in.
    tell(ToolEventKind::Changed, None, at(200 * 60)).await;
    tell(ToolEventKind::MountedNew, None, at(100 * 60)).await;
    tell(ToolEventKind::Reground, None, at(50 * 60)).await;
    tell(ToolEventKind::MountedUsed, Some("c00003"), at(150 * 60)).await;
    let answer = stored(&*store, &Run { sampled: false, ..Run::nth(3) }).await;
    assert_eq!((answer.verdict.life, answer.verdict.cycles), (4, 61), "cycles 200 to 260");
    assert_clean(&*store).await;
}

/// What the newest audit lines say, oldest first.
async fn revocations(store: &dyn Store) -> Vec<(String, String, String)> {
    let audit = store.audit(feedwright_store::Page { after: None, limit: 100 }).await.unwrap();
    let lines = audit.into_iter().filter(|line| line.action == "tool.event_revoke");
    lines.map(|line| (line.actor, line.subject, line.detail)).collect()
}

async fn an_event_that_a_clock_which_was_ahead_told_is_revoked_and_told_again(store: Arc<dyn Store>) {
    shop(&*store).await;
    let (id, who) = ("T1".try_into().unwrap(), engineer());
    let runs: Vec<Run> = (1..=12).map(Run::nth).collect();
    commit(&*store, &runs[..9]).await;
    let ahead = event(ToolEventKind::Changed, at(40 * 86_400));
    let told = store.add_tool_event(&id, ahead, &who, at(40 * 86_400)).await.unwrap().unwrap();
    // Whatever is run until then belongs to the old tool, and nothing is known of the new one.
    for run in &runs[9..] {
        assert_eq!(stored(&*store, run).await.verdict.cycles, 0);
    }
    let revoked = store.revoke_tool_event(&id, told.id, &who, at(1000)).await.unwrap().unwrap();
    assert_eq!(revoked, StoredToolEvent { revoked: Some((who.token.clone(), at(1000))), ..told.clone() });
    assert_eq!(store.verdict(&id).await.unwrap(), naive(&runs, true, WearSettings::default()));
    assert_clean(&*store).await;
    // Told again by the right clock, it holds from then on, for what is in memory too.
    let changed = event(ToolEventKind::Changed, at(10 * 60 + 30));
    store.add_tool_event(&id, changed, &who, at(1100)).await.unwrap().unwrap();
    let verdict = store.verdict(&id).await.unwrap();
    assert_eq!((verdict.life, verdict.cycles), (2, 2), "cycles 11 and 12");
    assert_eq!(stored(&*store, &Run::nth(13)).await.verdict.cycles, 3);
    assert_clean(&*store).await;
    // Once more, by another: it stays as it was revoked.
    let another = Actor { token: "another".to_owned(), ..who };
    let again = store.revoke_tool_event(&id, told.id, &another, at(2000)).await.unwrap();
    assert_eq!(again, Some(revoked.clone()));
    assert_eq!(store.verdict(&id).await.unwrap().cycles, 3);
    let page = feedwright_store::Page { after: None, limit: 10 };
    let events = store.tool_events(&id, page).await.unwrap();
    assert_eq!((events.len(), &events[1]), (3, &revoked), "it is seen where it was told");
    let other = "T2".try_into().unwrap();
    assert_eq!(store.revoke_tool_event(&other, told.id, &another, at(2000)).await.unwrap(), None);
    assert_eq!(store.revoke_tool_event(&id, 9_999, &another, at(2000)).await.unwrap(), None);
    let lines = revocations(&*store).await;
    assert_eq!(lines.len(), 1, "{lines:?}");
    assert_eq!((lines[0].0.as_str(), lines[0].1.as_str()), (engineer().token.as_str(), "tool/T1"));
    assert!(lines[0].2.contains(&format!("\"event\":{}", told.id)), "{lines:?}");
}

/// Whenever the cycles come in, together or one by one, before what has a place or after it.
async fn cycles_without_a_clock_make_the_life_unknown_in_which_they_came_in(store: Arc<dyn Store>) {
    shop(&*store).await;
    let who = engineer();
    let unset = |tool: &str, n: u32, received: i64| {
        let mut draft = Run { tool: tool.to_owned(), id: format!("u{tool}{n}"), ..Run::nth(n) }.draft();
        draft.started_at = Timestamp::from_micros(915_148_800_000_000 + i64::from(n) * 1_000_000);
        let new = new_cycle(Cycle::new(draft).unwrap());
        NewCycle { received_at: at(received), ..new }
    };
    let set = |tool: &str, n: u32| {
        Run { tool: tool.to_owned(), id: format!("s{tool}{n}"), ..Run::nth(n) }.new_cycle()
    };
    let commit_all = async |cycles: Vec<NewCycle>| {
        for stored in store.commit_cycles(cycles, at(100_000), RecommendSettings::default()).await {
            assert!(matches!(stored, Ok(Committed::Stored(_))), "{stored:?}");
        }
    };
    for (tool, together) in [("T2", false), ("T3", true), ("T4", false)] {
        let id = tool.try_into().unwrap();
        store.put_tool(super::given::tool(tool), Precondition::Absent, &who, at(0)).await.unwrap();
        mounted(&*store, tool, 0).await;
        let mut cycles: Vec<NewCycle> = (1..=300).map(|n| set(tool, n)).collect();
        cycles.extend((1..=6).map(|n| unset(tool, n, 10_000 + i64::from(n))));
        if tool == "T4" {
            cycles.rotate_right(6);
        }
        if together {
            commit_all(cycles).await;
        } else {
            for some in cycles.chunks(150) {
                commit_all(some.to_vec()).await;
            }
        }
        let verdict = store.verdict(&id).await.unwrap();
        assert_eq!((verdict.state, verdict.cycles), (ToolState::Unknown, 300), "{tool}: {verdict:?}");
        assert!(verdict.reasons.iter().any(|(code, _)| *code == "clock_suspect"), "{verdict:?}");
        assert_clean(&*store).await;
        // A life that begins after them, and as if it had not been told once that is revoked.
        let changed = event(ToolEventKind::Changed, at(20_000));
        let told = store.add_tool_event(&id, changed, &who, at(20_000)).await.unwrap().unwrap().id;
        commit_all((400..410).map(|n| set(tool, n)).collect()).await;
        assert_eq!(store.verdict(&id).await.unwrap().state, ToolState::Good, "{tool}");
        assert_clean(&*store).await;
        store.revoke_tool_event(&id, told, &who, at(30_000)).await.unwrap().unwrap();
        assert_eq!(store.verdict(&id).await.unwrap().state, ToolState::Unknown);
        assert_clean(&*store).await;
    }
}

async fn a_cycle_of_before_new_conditions_is_told_over_the_baseline_of_then(store: Arc<dyn Store>) {
    shop(&*store).await;
    let (id, who) = ("T1".try_into().unwrap(), engineer());
    let run = |n: u32| Run { sampled: false, load: if n <= 20 { 30.0 } else { 45.0 }, ..Run::nth(n) };
    commit(&*store, &(1..=30).map(run).collect::<Vec<_>>()).await;
    let confirmed = event(ToolEventKind::ConditionsConfirmed, at(30 * 60 + 30));
    store.add_tool_event(&id, confirmed, &who, at(9_000)).await.unwrap().unwrap();
    commit(&*store, &(31..=50).map(run).collect::<Vec<_>>()).await;
    let life = store.life(&id, 100).await.unwrap();
    let of_cycles = life.cycles.iter().map(|cycle| {
        let ratio = life.verdict.ratio_of(&cycle.facts, cycle.settings.as_ref()?);
        ratio.map(|ratio| (ratio * 100.0).round())
    });
    let ratios: Vec<_> = of_cycles.collect();
    let expected = |n: usize| Some(if (20..30).contains(&n) { 150.0 } else { 100.0 });
    assert_eq!(ratios, (0..50).map(expected).collect::<Vec<_>>());
    let row = store.fleet_machine(&"M1".try_into().unwrap(), 60).await.unwrap().unwrap();
    let at_a_glance: Vec<_> = row.energy_ratios.iter().map(|ratio| Some((ratio * 100.0).round())).collect();
    assert_eq!(at_a_glance, ratios);
    assert_clean(&*store).await;
}

/// A checkpoint stands before the place and after it, the named cycle comes late, and the first life begins otherwise.
async fn wherever_an_event_stands_it_is_as_if_it_had_not_been_told_once_it_is_revoked(store: Arc<dyn Store>) {
    shop(&*store).await;
    let (id, who) = ("T1".try_into().unwrap(), engineer());
    store.put_machine(machine("M2"), Precondition::Absent, &who, at(0)).await.unwrap();
    let run = |n: u32| Run {
        machine: if n.is_multiple_of(3) { "M2" } else { "M1" },
        sampled: false,
        load: 30.0 + f64::from(n) * 0.002,
        ..Run::nth(n)
    };
    let runs: Vec<Run> = (1..=600).map(run).collect();
    commit(&*store, &runs[..100]).await;
    commit(&*store, &runs[101..]).await;
    let naming = |kind, n: u32, when| {
        let first_cycle = Some(("M1".try_into().unwrap(), format!("c{n:05}").as_str().try_into().unwrap()));
        ToolEvent { first_cycle, ..event(kind, at(when)) }
    };
    let mut told = Vec::new();
    for one in [
        event(ToolEventKind::Changed, at(400 * 60)),
        naming(ToolEventKind::Reground, 101, 500 * 60),
        event(ToolEventKind::Reset, at(-20)),
        event(ToolEventKind::Changed, at(4_000_000)),
    ] {
        told.push(store.add_tool_event(&id, one, &who, at(5_000_000)).await.unwrap().unwrap().id);
    }
    stored(&*store, &runs[100]).await;
    assert_clean(&*store).await;
    for (event, life) in told.into_iter().zip([4, 3, 2, 1]) {
        store.revoke_tool_event(&id, event, &who, at(6_000_000)).await.unwrap().unwrap();
        assert_eq!(store.verdict(&id).await.unwrap().life, life);
        assert_clean(&*store).await;
    }
    assert_eq!(store.verdict(&id).await.unwrap(), naive(&runs, true, WearSettings::default()));
    // Nothing mounts it any more.
    let page = feedwright_store::Page { after: None, limit: 1 };
    let mounting = store.tool_events(&id, page).await.unwrap()[0].id;
    store.revoke_tool_event(&id, mounting, &who, at(6_000_001)).await.unwrap().unwrap();
    assert_eq!(store.verdict(&id).await.unwrap(), naive(&runs, false, WearSettings::default()));
    assert_clean(&*store).await;
}

async fn changed_settings_are_judged_again(store: Arc<dyn Store>) {
    shop(&*store).await;
    let runs: Vec<Run> = (1..=12).map(|n| Run { load: 29.0 + f64::from(n) * 0.1, ..Run::nth(n) }).collect();
    commit(&*store, &runs).await;
    let id = "T1".try_into().unwrap();
    let before = store.verdict(&id).await.unwrap();
    assert_eq!(before, naive(&runs, true, WearSettings::default()));
    let wear = WearSettings { baseline_cycles: 3, window_cycles: 4, ..Default::default() };
    let changed = feedwright_core::operation::Operation { wear, ..operation("O1") };
    store.put_operation(changed, Precondition::Version(1), &engineer(), at(2000)).await.unwrap();
    let after = store.verdict(&id).await.unwrap();
    assert_eq!(after, naive(&runs, true, wear));
    assert_ne!(after.level, before.level);
    assert_clean(&*store).await;
}

/// Changes what O1 asks for: depth and speed.
async fn ask(store: &dyn Store, (version, seconds): (u64, i64), depth_mm: Option<f64>, speed: Option<f64>) {
    let asked =
        feedwright_core::operation::Operation { depth_mm, spindle_speed_rpm: speed, ..operation("O1") };
    store.put_operation(asked, Precondition::Version(version), &engineer(), at(seconds)).await.unwrap();
}

/// A reported cycle that names no speed: what its operation asked for is all that is known of it.
pub(super) fn reported(tool: &str, number: u32, joules: f64, depth_mm: f64) -> NewCycle {
    let mut draft = Run::nth(number).draft();
    draft.tool = tool.try_into().unwrap();
    draft.id = format!("{tool}-{number}").as_str().try_into().unwrap();
    (draft.samples, draft.spindle_speed_rpm) = (None, None);
    draft.reported =
        Reported { energy_joules: Some(joules), max_depth_mm: Some(depth_mm), ..Reported::default() };
    // Summed up under what was in force before: it is summed up again.
    NewCycle { generation: Some(-1), ..new_cycle(Cycle::new(draft).unwrap()) }
}

pub(super) async fn store_all(store: &dyn Store, cycles: Vec<NewCycle>) {
    for outcome in store.commit_cycles(cycles, at(9000), RecommendSettings::default()).await {
        assert!(matches!(outcome, Ok(Committed::Stored(_))), "{outcome:?}");
    }
}

async fn what_was_run_is_judged_by_what_its_operation_asked_for_then(store: Arc<dyn Store>) {
    shop(&*store).await;
    store.put_tool(tool("T2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    let verdict = async |tool: &str| store.verdict(&tool.try_into().unwrap()).await.unwrap();
    ask(&*store, (1, 10), Some(10.0), Some(2400.0)).await;
    let worn = (1..=40).map(|number| reported("T1", number, 1000.0 + 4.0 * f64::from(number), 10.1));
    let late: Vec<_> = (21..=24).map(|number| reported("T2", number, 2000.0, 10.1)).collect();
    store_all(&*store, worn.chain((1..=20).map(|number| reported("T2", number, 2000.0, 10.1))).collect())
        .await;
    assert_eq!(verdict("T1").await.state, ToolState::Worn);

    // Between the fortieth and the next cycle.
    ask(&*store, (2, 2430), Some(12.0), Some(2640.0)).await;
    let deeper = verdict("T1").await;
    assert_eq!(
        (deeper.state, deeper.counted),
        (ToolState::Worn, 40),
        "a deeper hole makes no worn tool good"
    );
    store_all(&*store, (41..=52).map(|number| reported("T1", number, 1450.0, 12.1)).collect()).await;
    assert_eq!(verdict("T1").await.state, ToolState::Worn);

    let learnt = verdict("T2").await;
    assert_eq!(learnt.baselines[0].key.spindle_speed_rpm, Some(2400.0), "{learnt:?}");
    store_all(&*store, (41..=52).map(|number| reported("T2", number, 2200.0, 12.1)).collect()).await;
    // What began before the change, whenever it comes.
    store_all(&*store, late).await;
    let faster = verdict("T2").await;
    let speeds: Vec<_> = faster.baselines.iter().map(|baseline| baseline.key.spindle_speed_rpm).collect();
    assert_eq!(speeds, [Some(2640.0), Some(2400.0)], "{faster:?}");
    assert_eq!(
        (faster.state, faster.cycles),
        (ToolState::Changed, 36),
        "no wear, but another speed: {faster:?}"
    );
    let life = store.life(&"T2".try_into().unwrap(), 100).await.unwrap();
    let ratios =
        life.cycles.iter().map(|cycle| faster.ratio_of(&cycle.facts, cycle.settings.as_ref().unwrap()));
    assert!(ratios.flatten().count() == 36, "each is told over its own speed's baseline");

    // A depth that was declared wrong is mended by the one of now.
    ask(&*store, (3, 3500), Some(9.0), Some(2640.0)).await;
    assert_eq!(verdict("T1").await.excluded[Exclusion::Incomplete as usize], 0);
    assert_clean(&*store).await;
    assert_eq!(store.check_cycles(None, 1000).await.unwrap().faults, vec![]);
}

async fn what_is_told_of_an_operation_later_holds_for_what_came_before(store: Arc<dyn Store>) {
    shop(&*store).await;
    let verdict = async || store.verdict(&"T1".try_into().unwrap()).await.unwrap();
    ask(&*store, (1, 10), None, None).await;
    let worn = (1..=40).map(|number| reported("T1", number, 1000.0 + 4.0 * f64::from(number), 10.1));
    store_all(&*store, worn.collect()).await;
    assert_eq!(verdict().await.baselines[0].key.spindle_speed_rpm, None);
    // A speed that nobody had told was run all along; a depth that nobody had asked for leaves nothing short of it.
    ask(&*store, (2, 2430), Some(21.0), Some(2400.0)).await;
    let told = verdict().await;
    assert_eq!((told.state, told.counted), (ToolState::Worn, 40), "{told:?}");
    assert_eq!(told.baselines[0].key.spindle_speed_rpm, Some(2400.0));
    ask(&*store, (3, 2440), Some(21.0), Some(2640.0)).await;
    let kept = verdict().await;
    assert_eq!(kept.baselines[0].key.spindle_speed_rpm, Some(2400.0), "{kept:?}");
    store_all(&*store, (41..=52).map(|number| reported("T1", number, 2100.0, 21.0)).collect()).await;
    assert_eq!(verdict().await.state, ToolState::Worn);

    // Registered only when its cycles are there: what it asks for first holds for them.
    let mut early: Vec<_> = (1..=40)
        .map(|number| Run { operation: "O7", tool: "T1".to_owned(), ..Run::nth(number) })
        .map(|run| {
            let mut draft = run.draft();
            draft.tool = "T7".try_into().unwrap();
            draft.id = format!("T7-{}", run.id).as_str().try_into().unwrap();
            draft.samples = None;
            let energy = 1000.0 + 4.0 * draft.seq.map_or(0.0, |seq| f64::from(u32::try_from(seq).unwrap()));
            draft.reported =
                Reported { energy_joules: Some(energy), max_depth_mm: Some(10.1), ..Reported::default() };
            NewCycle { generation: Some(-1), ..new_cycle(Cycle::new(draft).unwrap()) }
        })
        .collect();
    store.put_tool(tool("T7"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    let rest = early.split_off(30);
    store_all(&*store, early).await;
    let registered =
        |depth| feedwright_core::operation::Operation { depth_mm: Some(depth), ..operation("O7") };
    store.put_operation(registered(10.0), Precondition::Absent, &engineer(), at(4000)).await.unwrap();
    store.put_operation(registered(12.0), Precondition::Version(1), &engineer(), at(5000)).await.unwrap();
    store_all(&*store, rest).await;
    let seven = store.verdict(&"T7".try_into().unwrap()).await.unwrap();
    assert_eq!((seven.state, seven.counted), (ToolState::Worn, 40), "{seven:?}");
    assert_clean(&*store).await;
    assert_eq!(store.check_cycles(None, 1000).await.unwrap().faults, vec![]);
}

async fn cycles_that_were_cut_short_do_not_count_however_they_arrive(store: Arc<dyn Store>) {
    shop(&*store).await;
    // A tenth less than a whole one, which a baseline would take for its scatter.
    let is_cut = |n: u32| n % 4 == 1;
    let new = |n: u32, tool: &str| NewCycle {
        cut_short: is_cut(n),
        ..Run {
            tool: tool.to_owned(),
            id: format!("{tool}-{n}"),
            load: if is_cut(n) { 27.0 } else { 30.0 },
            ..Run::nth(n)
        }
        .new_cycle()
    };
    let mut verdicts = Vec::new();
    for (tool_id, order) in [("T1", (1..=20).collect::<Vec<_>>()), ("T2", (1..=20).rev().collect())] {
        store.put_tool(tool(tool_id), Precondition::Unstated, &engineer(), at(0)).await.unwrap();
        mounted(&*store, tool_id, -10).await;
        for numbers in order.chunks(3) {
            // Each comes twice, as from a machine that did not hear the first answer.
            let group = numbers.iter().chain(numbers).map(|n| new(*n, tool_id)).collect();
            for outcome in store.commit_cycles(group, at(100_000), RecommendSettings::default()).await {
                assert!(matches!(outcome, Ok(Committed::Stored(_) | Committed::Known(_))), "{outcome:?}");
            }
        }
        let verdict = store.verdict(&tool_id.try_into().unwrap()).await.unwrap();
        assert_eq!((verdict.state, verdict.cycles, verdict.counted), (ToolState::Good, 20, 15));
        assert_eq!(verdict.excluded[Exclusion::CutShort as usize], 5, "{verdict:?}");
        let level = verdict.level.unwrap();
        assert!((level.lowest, level.highest) == (1.0, 1.0), "{level:?}");
        verdicts.push((verdict.level, verdict.excluded, verdict.counted));
    }
    assert_eq!(verdicts[0], verdicts[1], "late or not");
    assert_clean(&*store).await;
    let checked = store.check_cycles(None, 100).await.unwrap();
    assert_eq!((checked.checked, checked.faults), (40, vec![]));

    // A tool of which nothing else is known: nothing can be told, and the feed stays as it is.
    store.put_tool(tool("T3"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    for n in [1, 5, 9, 13, 17, 21] {
        let cut = new(n, "T3");
        let outcome = store.commit_cycles(vec![cut], at(100_000), RecommendSettings::default()).await.pop();
        let Some(Ok(Committed::Stored(answer))) = outcome else { panic!("{outcome:?}") };
        assert_eq!(answer.verdict.state, ToolState::Unknown);
        let advice = &answer.recommendation.recommendation;
        assert!(advice.reasons.iter().any(|(code, _)| code == "cut_short"), "{:?}", advice.reasons);
        assert_eq!(advice.override_percent.to_bits(), 100.0_f64.to_bits());
    }
    assert_clean(&*store).await;
}

async fn a_damaged_cache_is_found_and_repaired(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    let runs: Vec<Run> = (1..=300).map(|n| Run { sampled: false, ..Run::nth(n) }).collect();
    commit(&*store, &runs).await;
    let good = given.wear_states().await;
    let damages: [&'static str; 6] = [
        "UPDATE tool_wear SET folded = folded - 1",
        "UPDATE tool_wear_checkpoints SET last_started_at_us = last_started_at_us - 8000000000",
        "UPDATE tool_wear_checkpoints SET last_seq = NULL",
        "UPDATE tool_wear_checkpoints SET last_cycle_id = 'c00001'",
        "UPDATE tool_wear_checkpoints SET last_cycle_id = 'c00001', state = (SELECT state FROM tool_wear)",
        "DELETE FROM tool_wear",
    ];
    for damage in damages {
        assert_eq!(given.raw(damage).await.unwrap(), 1, "{damage}");
        let found = store.check_wear(Repair::No).await.unwrap();
        assert_eq!(differing(&found), [("M1", "T1")], "{damage}");
        let repaired = store.check_wear(Repair::AllBut(&Doubt::default())).await.unwrap();
        assert_eq!(differing(&repaired), differing(&found), "{damage}");
        assert_eq!(repaired.different[0].left, None, "{damage}");
        assert_clean(&*store).await;
        assert_eq!(given.wear_states().await, good, "{damage}");
    }
}

async fn a_cache_that_is_lost_is_folded_again_with_the_next_cycle(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    let runs: Vec<Run> = (1..=40).map(|n| Run { sampled: false, ..Run::nth(n) }).collect();
    commit(&*store, &runs[..38]).await;
    assert_eq!(given.raw("DELETE FROM tool_wear").await.unwrap(), 1);
    let answered = commit(&*store, &runs[38..]).await;
    assert!(answered.iter().all(|one| matches!(one, Ok(Committed::Stored(_)))), "{answered:?}");
    let verdict = store.verdict(&"T1".try_into().unwrap()).await.unwrap();
    assert_eq!((verdict.cycles, verdict.counted), (40, 40));
    assert_clean(&*store).await;
}

async fn a_late_cycle_is_counted_whatever_the_key_of_a_checkpoint_says(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    let runs: Vec<Run> = (1..=300)
        .map(|n| Run { sampled: false, load: 30.0 + f64::from(n % 11) * 0.1, ..Run::nth(n) })
        .collect();
    let late = &runs[199];
    let live: Vec<Run> = runs.iter().filter(|run| run.id != late.id).cloned().collect();
    commit(&*store, &live).await;
    // As if it had counted only what is older than the late one.
    let earlier = "UPDATE tool_wear_checkpoints SET last_started_at_us = last_started_at_us - 6000000000";
    assert_eq!(given.raw(earlier).await.unwrap(), 1);
    let found = store.check_wear(Repair::No).await.unwrap();
    assert_eq!(differing(&found), [("M1", "T1")]);
    stored(&*store, late).await;
    let verdict = store.verdict(&"T1".try_into().unwrap()).await.unwrap();
    assert_eq!(verdict, naive(&runs, true, WearSettings::default()));
    assert_clean(&*store).await;
}

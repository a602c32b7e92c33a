//! A tool's life is what a walk through its whole history tells, and of a long one no more is read than is told.

use super::given::{
    Given, Run, at, commit, engineer, event, machine, mounted, operation, shop, stories, tool,
};
use feedwright_core::ids::ToolId;
use feedwright_core::tool::ToolEventKind;
use feedwright_core::wear::{CycleFacts, Exclusion, FoldSettings, Level, OrderKey, ToolFold};
use feedwright_store::{Precondition, StoreError, ToolLife};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use std::collections::HashMap;

stories!(with tables:
    a_life_is_what_the_whole_walk_tells_of_its_newest_cycles,
    of_a_long_life_no_more_is_read_than_is_told,
);

/// What is told of a cycle.
type Told = (OrderKey, Option<Exclusion>, Option<Level>);

/// The life as the book has it: every cycle of the tool in its order, watched from the first one on.
fn walked(runs: &[Run], events: &[(ToolEventKind, i64)]) -> Vec<Told> {
    let settings = FoldSettings::of(&operation("O1"));
    let facts = |run: &Run| {
        let new = run.new_cycle();
        CycleFacts::of(&new.cycle, &new.summary, new.received_at)
    };
    let mut facts: Vec<CycleFacts> = runs.iter().map(facts).collect();
    facts.sort_by(|a, b| a.order.cmp(&b.order));
    let mut events = events.to_vec();
    events.sort_by_key(|(_, when)| *when);
    let first = events.iter().find(|(kind, _)| kind.begins_life());
    let mut fold = match first {
        Some((kind, _)) if kind.mounts() => ToolFold::awaiting_mount(),
        _ => ToolFold::default(),
    };
    let mut events = events.into_iter().peekable();
    let (mut life, mut excluded): (Vec<Told>, HashMap<_, Exclusion>) = (Vec::new(), HashMap::new());
    for facts in &facts {
        while let Some((kind, when)) = events.next_if(|(_, when)| at(*when) <= facts.order.started_at) {
            fold.event(kind, at(when));
            if kind.begins_life() {
                life.clear();
                excluded.clear();
            }
        }
        fold.cycle(facts, Some(&settings));
        for (machine, cycle, why) in fold.last_excluded() {
            excluded.insert((machine.clone(), cycle.clone()), *why);
        }
        life.push((facts.order.clone(), None, fold.judged_level()));
    }
    if events.any(|(kind, _)| kind.begins_life()) {
        life.clear();
    }
    for (order, why, _) in &mut life {
        *why = excluded.get(&(order.machine.clone(), order.cycle.clone())).copied();
    }
    life
}

fn told(life: &ToolLife) -> Vec<Told> {
    let told = |cycle: &feedwright_store::LifeCycle| (cycle.facts.order.clone(), cycle.excluded, cycle.level);
    life.cycles.iter().map(told).collect()
}

async fn a_life_is_what_the_whole_walk_tells_of_its_newest_cycles(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    for id in ["M2", "M3"] {
        store.put_machine(machine(id), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    }
    let mut runner = TestRunner::deterministic();
    let mut draw = |most: u32| (0..most).new_tree(&mut runner).unwrap().current();
    let (mut left_out, mut lives, mut resumed, mut resumed_over_all) = (0, 0, 0, 0);
    for case in 0..6_u32 {
        let name = format!("T-life-{case}");
        let id: ToolId = name.as_str().try_into().unwrap();
        store.put_tool(tool(&name), Precondition::Absent, &engineer(), at(0)).await.unwrap();
        // One machine, or several in turn.
        let machines = if case % 2 == 0 { 1 } else { 3 };
        let mut step = 0.0;
        let mut runs: Vec<Run> = Vec::new();
        for n in 0..620_u32 {
            if draw(150) == 0 {
                // It cuts otherwise from here on.
                step += f64::from(draw(9)) - 4.0;
            }
            let load = match draw(40) {
                0 => 0.5,
                1 => 55.0,
                2 => 12.0,
                noise => 30.0 + step + f64::from(n) * 0.004 + f64::from(noise) * 0.02,
            };
            runs.push(Run {
                machine: ["M1", "M2", "M3"][draw(machines) as usize],
                tool: name.clone(),
                id: format!("{name}-{n}"),
                // Some begin in the same second.
                seconds: i64::from(n / 2 * 60),
                seq: (n % 4 != 0).then_some(u64::from(n)),
                load,
                sampled: false,
                ..Run::nth(n)
            });
        }
        let mut events = Vec::new();
        let mut tell = async |kind: ToolEventKind, when: i64| {
            store.add_tool_event(&id, event(kind, at(when)), &engineer(), at(when)).await.unwrap().unwrap();
            events.push((kind, when));
        };
        if case % 3 != 2 {
            tell(ToolEventKind::MountedNew, -10).await;
        }
        // Late ones among them, and more or less in order.
        let mut arrival: Vec<usize> = (0..runs.len()).collect();
        for _ in 0..12 {
            let (late, from) = (draw(619) as usize, draw(619) as usize);
            arrival.swap(late, from);
        }
        for (part, group) in arrival.chunks(83).enumerate() {
            let group: Vec<Run> = group.iter().map(|&index| runs[index].clone()).collect();
            for outcome in commit(&*store, &group).await {
                outcome.unwrap();
            }
            match (case, part) {
                (1 | 2, 3) => tell(ToolEventKind::Changed, 100 * 60).await,
                (3 | 4, 5) => tell(ToolEventKind::MountedNew, 150 * 60).await,
                (0 | 3, 6) => tell(ToolEventKind::ConditionsConfirmed, 200 * 60).await,
                (5, 7) => tell(ToolEventKind::Changed, 1_000_000).await,
                _ => {}
            }
        }
        let expected = walked(&runs, &events);
        left_out += expected.iter().filter(|(_, why, _)| why.is_some()).count();
        lives += usize::from(expected.len() < runs.len());
        let shown = [1, 2, 7, 100, 255, 256, 257, 400, 5000];
        let mut all = Vec::new();
        for most in shown {
            let life = store.life(&id, most).await.unwrap();
            let newest = expected.len().saturating_sub(most as usize);
            assert_eq!(told(&life), expected[newest..], "{most} of {name}");
            assert_eq!(life.before, newest as u64, "{most} of {name}");
            assert_eq!(life.verdict, store.verdict(&id).await.unwrap());
            all.push(life);
        }
        // From the first cycle, without any state on the way, it is the same to the bit.
        resumed += given.raw("DELETE FROM tool_wear_checkpoints").await.unwrap();
        resumed_over_all += given.raw("DELETE FROM tool_checkpoints").await.unwrap();
        for (most, life) in shown.into_iter().zip(all) {
            assert_eq!(store.life(&id, most).await.unwrap(), life, "{most} of {name}");
        }
    }
    assert!(left_out > 50 && lives > 2, "{left_out} {lives}: all of it is tried");
    assert!(resumed > 5 && resumed_over_all > 5, "{resumed} {resumed_over_all} states on the way");
}

/// Whatever lies further back than the last state on the way before what is shown is not looked at: it cannot be read here.
async fn of_a_long_life_no_more_is_read_than_is_told(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    store.put_tool(tool("T2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    mounted(&*store, "T2", -10).await;
    for (name, machines) in [("T1", ["M1", "M1"]), ("T2", ["M1", "M2"])] {
        let run = |n: u32| Run {
            machine: machines[n as usize % 2],
            tool: name.to_owned(),
            id: format!("{name}-{n:05}"),
            sampled: false,
            ..Run::nth(n)
        };
        let runs: Vec<Run> = (1..=1600).map(run).collect();
        for group in runs.chunks(200) {
            commit(&*store, group).await;
        }
        let id: ToolId = name.try_into().unwrap();
        let before = store.life(&id, 300).await.unwrap();
        let first = |n: i64| at(n * 60).micros();
        let mut damage = sqlx::QueryBuilder::<sqlx::Sqlite>::new(
            "UPDATE cycles SET operation_id = 'no id' WHERE tool_id = '",
        );
        damage.push(name).push("' AND started_at_us <= ").push(first(1024));
        let damaged = given.raw(sqlx::AssertSqlSafe(damage.into_string())).await.unwrap();
        assert_eq!(damaged, 1024, "all up to a state on the way");
        assert_eq!((before.before, before.cycles.len()), (1300, 300));
        assert_eq!(store.life(&id, 300).await.unwrap(), before);
        let last = store.life(&id, 1).await.unwrap();
        assert_eq!(
            (last.before, &last.verdict, &last.cycles[0]),
            (1599, &before.verdict, &before.cycles[299])
        );
        let levels = store.levels(&id, at(1590 * 60), at(1_000_000), 100).await.unwrap();
        assert_eq!(levels.len(), 11);
        assert_eq!(store.verdict(&id).await.unwrap(), before.verdict);
        if machines == ["M1", "M1"] {
            // As a journal leaves a fold that was taken up: on the way there is still a state to go on from.
            let behind = "UPDATE tool_wear SET fold_version = 0, version = version + 1 WHERE tool_id = 'T1'";
            assert_eq!(given.raw(behind).await.unwrap(), 1);
            assert_eq!(store.verdict(&id).await.unwrap(), before.verdict);
        }
        // As it is with all of them.
        let all = store.life(&id, 5000).await;
        assert!(matches!(all, Err(StoreError::Damaged { .. })), "{all:?}");
    }
}

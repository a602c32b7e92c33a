//! Cycles come in once, are found again to the bit, and fail alone.

use super::given::{Given, Run, at, commit, engineer, machine, new_cycle, shop, stored, stories, tool};
use feedwright_core::cycle::{Cycle, Flag, Flags};
use feedwright_core::recommend::RecommendSettings;
use feedwright_store::{
    Committed, CycleFilter, CycleKey, NewCycle, Page, Precondition, Repair, Store, StoreError,
};
use std::sync::Arc;

stories!(
    a_cycle_is_found_again_to_the_bit,
    a_cycle_is_new_then_known_then_a_conflict,
    duplicates_inside_a_group_are_seen,
    groups_of_every_size_are_whole,
    a_cycle_that_was_cut_short_is_flagged_whatever_was_registered_meanwhile,
    a_row_that_fails_fails_alone,
    an_unknown_machine_stores_nothing,
    pages_have_neither_gaps_nor_repeats,
    a_number_that_is_none_is_refused,
    after_closing_nothing_is_taken,
);

mod tables {
    use super::{
        a_group_that_fails_at_its_end_leaves_nothing_open, what_has_a_hash_of_the_first_version_is_known,
    };
    super::stories!(with tables:
        a_group_that_fails_at_its_end_leaves_nothing_open,
        what_has_a_hash_of_the_first_version_is_known,
    );
}

async fn a_cycle_is_found_again_to_the_bit(store: Arc<dyn Store>) {
    shop(&*store).await;
    let new = Run::nth(1).new_cycle();
    let answer = stored(&*store, &Run::nth(1)).await;
    assert_eq!(answer.summary, new.summary);
    assert!(answer.registered);
    let found = store.cycle(&new.cycle.machine, &new.cycle.id).await.unwrap().unwrap();
    assert_eq!(found.summary, new.summary);
    assert_eq!(found.hash, new.encoded.hash);
    assert_eq!(found.received_at, new.received_at);
    assert_eq!(found.cycle.seq, Some(1));
    assert_eq!(found.cycle.started_at, new.cycle.started_at);
    assert!(found.has_samples);
    let samples = store.cycle_samples(&new.cycle.machine, &new.cycle.id).await.unwrap();
    assert_eq!(samples, new.cycle.samples);
    let advice = store.recommendation(&answer.recommendation.id).await.unwrap().unwrap();
    assert_eq!(advice, answer.recommendation);

    let only_reported = Run { sampled: false, ..Run::nth(2) };
    stored(&*store, &only_reported).await;
    let found = store.cycle(&new.cycle.machine, &"c00002".try_into().unwrap()).await.unwrap().unwrap();
    assert_eq!(found.summary, only_reported.new_cycle().summary);
    assert!(!found.has_samples);
    assert_eq!(store.cycle_samples(&new.cycle.machine, &found.cycle.id).await.unwrap(), None);
    assert_eq!(store.cycle(&new.cycle.machine, &"none".try_into().unwrap()).await.unwrap(), None);
}

async fn a_cycle_is_new_then_known_then_a_conflict(store: Arc<dyn Store>) {
    shop(&*store).await;
    let first = stored(&*store, &Run::nth(1)).await;
    let again = commit(&*store, &[Run::nth(1)]).await;
    let [Ok(Committed::Known(known))] = &again[..] else { panic!("{again:?}") };
    assert_eq!(known.summary, first.summary);
    assert_eq!(known.received_at, first.received_at);
    assert_eq!(known.verdict, first.verdict);
    assert_ne!(known.recommendation.id, first.recommendation.id, "each answer has advice of its own");

    let other = commit(&*store, &[Run { load: 31.0, ..Run::nth(1) }]).await;
    let hash = Run::nth(1).new_cycle().encoded.hash;
    assert!(
        matches!(&other[..], [Ok(Committed::Conflict { stored_hash })] if *stored_hash == hash),
        "{other:?}"
    );
    let kept = store.cycle(&"M1".try_into().unwrap(), &"c00001".try_into().unwrap()).await.unwrap().unwrap();
    assert_eq!(kept.summary, first.summary);
}

/// As an earlier version stored it.
async fn what_has_a_hash_of_the_first_version_is_known(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    stored(&*store, &Run::nth(1)).await;
    let first = if given.is_postgres() {
        "UPDATE cycles SET content_hash = decode('450ce43029e1c9ad33eff7b0bed237527799e1002d7802c2104052be0a0cac5b', 'hex')"
    } else {
        "UPDATE cycles SET content_hash = x'450ce43029e1c9ad33eff7b0bed237527799e1002d7802c2104052be0a0cac5b'"
    };
    assert_eq!(given.raw(first).await.unwrap(), 1);
    let again = commit(&*store, &[Run::nth(1)]).await;
    assert!(matches!(&again[..], [Ok(Committed::Known(_))]), "{again:?}");
    let other = commit(&*store, &[Run { load: 31.0, ..Run::nth(1) }]).await;
    assert!(matches!(&other[..], [Ok(Committed::Conflict { .. })]), "{other:?}");
    let checked = store.check_cycles(None, 100).await.unwrap();
    assert_eq!((checked.checked, checked.faults.as_slice()), (1, [].as_slice()));
    // A hash of neither version is of another content.
    let damaged = if given.is_postgres() {
        "UPDATE cycles SET content_hash = decode(repeat('00', 32), 'hex')"
    } else {
        "UPDATE cycles SET content_hash = zeroblob(32)"
    };
    assert_eq!(given.raw(damaged).await.unwrap(), 1);
    let checked = store.check_cycles(None, 100).await.unwrap();
    assert_eq!(checked.faults.iter().map(|fault| fault.kind).collect::<Vec<_>>(), ["hash"]);
}

async fn duplicates_inside_a_group_are_seen(store: Arc<dyn Store>) {
    shop(&*store).await;
    let outcomes =
        commit(&*store, &[Run::nth(2), Run::nth(1), Run::nth(2), Run { load: 9.0, ..Run::nth(1) }]).await;
    assert!(matches!(
        &outcomes[..],
        [
            Ok(Committed::Stored(_)),
            Ok(Committed::Stored(_)),
            Ok(Committed::Known(_)),
            Ok(Committed::Conflict { .. })
        ]
    ));
    let verdict = store.verdict(&"T1".try_into().unwrap()).await.unwrap();
    assert_eq!(verdict.last.unwrap().cycle.as_str(), "c00002");
}

/// A statement holds some numbers of rows and not others: around each, nothing is left out and nothing written twice.
/// Each group has cycles of many tools or of one, some with samples, some known before, one of them twice.
async fn groups_of_every_size_are_whole(store: Arc<dyn Store>) {
    const SIZES: [u32; 14] = [1, 2, 3, 15, 16, 17, 31, 32, 33, 48, 63, 64, 65, 130];
    shop(&*store).await;
    for n in 2..=40 {
        let tool = tool(&format!("T{n}"));
        store.put_tool(tool, Precondition::Absent, &engineer(), at(0)).await.unwrap();
    }
    let (mut next, mut all) = (1, Vec::new());
    for size in SIZES {
        for (many_tools, sampled, known) in [(true, true, 0), (false, true, 3), (true, false, 5)] {
            let runs: Vec<Run> = (next..next + size)
                .map(|n| Run {
                    tool: format!("T{}", if many_tools { n % 40 + 1 } else { 1 }),
                    sampled: sampled || n % 2 == 0,
                    ..Run::nth(n)
                })
                .collect();
            next += size;
            let before: Vec<Run> =
                runs.iter().filter(|run| known > 0 && run.seconds / 60 % known == 0).cloned().collect();
            for run in &before {
                stored(&*store, run).await;
            }
            let group: Vec<Run> = runs.iter().chain(runs.last()).cloned().collect();
            let outcomes = commit(&*store, &group).await;
            for (at, outcome) in outcomes.into_iter().enumerate() {
                let again = at == runs.len() || before.iter().any(|run| run.id == group[at].id);
                let answer = match outcome {
                    Ok(Committed::Stored(answer)) if !again => answer,
                    Ok(Committed::Known(answer)) if again => answer,
                    other => panic!("{} of {size}: {other:?}", group[at].id),
                };
                let advice = store.recommendation(&answer.recommendation.id).await.unwrap();
                assert_eq!(advice, Some(answer.recommendation), "{} of {size}", group[at].id);
            }
            all.extend(runs);
        }
    }
    let list = store.cycles(&CycleFilter::default(), Page { after: None, limit: 10_000 }).await.unwrap();
    assert_eq!(list.len(), all.len());
    for (found, run) in list.iter().zip(&all) {
        assert_eq!((found.cycle.id.as_str(), found.has_samples), (run.id.as_str(), run.sampled));
    }
    let checked = store.check_cycles(None, 10_000).await.unwrap();
    assert_eq!((checked.checked, checked.faults), (all.len() as u64, vec![]));
    let check = store.check_wear(Repair::No).await.unwrap();
    assert_eq!((check.rows, check.different), (40, vec![]));
}

async fn a_cycle_that_was_cut_short_is_flagged_whatever_was_registered_meanwhile(store: Arc<dyn Store>) {
    shop(&*store).await;
    for (n, generation) in [(1, None), (2, Some(-1))] {
        let cut = NewCycle { generation, cut_short: true, ..Run::nth(n).new_cycle() };
        let key = (cut.cycle.machine.clone(), cut.cycle.id.clone());
        let outcome = store.commit_cycles(vec![cut], at(1000), RecommendSettings::default()).await.pop();
        let Some(Ok(Committed::Stored(answer))) = outcome else { panic!("{generation:?}: {outcome:?}") };
        let told = |flags: Flags| flags.contains(Flag::Incomplete) && flags.contains(Flag::CutShort);
        assert!(told(answer.summary.flags), "{generation:?}");
        let kept = store.cycle(&key.0, &key.1).await.unwrap().unwrap();
        assert!(told(kept.summary.flags), "{generation:?}");
    }
    assert_eq!(store.check_cycles(None, 10).await.unwrap().faults, []);
}

async fn a_row_that_fails_fails_alone(store: Arc<dyn Store>) {
    shop(&*store).await;
    let mut group: Vec<_> = (1..=4).map(|n| Run::nth(n).new_cycle()).collect();
    group[2].summary.coverage = 1.5;
    let outcomes = store.commit_cycles(group, at(1000), RecommendSettings::default()).await;
    for (index, outcome) in outcomes.iter().enumerate() {
        match outcome {
            Err(StoreError::Refused { constraint }) if index == 2 => {
                assert_eq!(constraint, "cycles_coverage_range");
            }
            Ok(Committed::Stored(_)) if index != 2 => {}
            other => panic!("{index}: {other:?}"),
        }
    }
    let list = store.cycles(&CycleFilter::default(), Page { after: None, limit: 10 }).await.unwrap();
    let ids: Vec<&str> = list.iter().map(|cycle| cycle.cycle.id.as_str()).collect();
    assert_eq!(ids, ["c00001", "c00002", "c00004"]);
    let check = store.check_wear(Repair::No).await.unwrap();
    assert_eq!((check.rows, check.different), (1, vec![]));
}

async fn a_group_that_fails_at_its_end_leaves_nothing_open(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    let (refuse, allow) = if given.is_postgres() {
        (
            "ALTER TABLE recommendations ADD CONSTRAINT refuse CHECK (false) NOT VALID",
            "ALTER TABLE recommendations DROP CONSTRAINT refuse",
        )
    } else {
        (
            "CREATE TRIGGER refuse BEFORE INSERT ON recommendations BEGIN SELECT RAISE(ABORT, 'refused'); END",
            "DROP TRIGGER refuse",
        )
    };
    given.raw(refuse).await.unwrap();
    let group = [Run::nth(1), Run::nth(2), Run { tool: "T2".to_owned(), ..Run::nth(3) }];
    for name in ["T3", "T4"] {
        // What comes last of a group is refused: each of its cycles is, by itself too.
        let outcomes = commit(&*store, &group).await;
        assert!(outcomes.iter().all(Result::is_err), "{outcomes:?}");
        // Another change begins and ends as ever.
        store.put_tool(tool(name), Precondition::Absent, &engineer(), at(1)).await.unwrap();
        let list = store.cycles(&CycleFilter::default(), Page { after: None, limit: 10 }).await.unwrap();
        assert_eq!(list, [], "nothing of the group is stored");
    }
    given.raw(allow).await.unwrap();
    let outcomes = commit(&*store, &group).await;
    assert!(outcomes.iter().all(|outcome| matches!(outcome, Ok(Committed::Stored(_)))), "{outcomes:?}");
    let check = store.check_wear(Repair::No).await.unwrap();
    assert_eq!(check.different, []);
    assert_eq!(store.check_cycles(None, 10).await.unwrap().checked, 3);
}

async fn an_unknown_machine_stores_nothing(store: Arc<dyn Store>) {
    shop(&*store).await;
    let outcomes = commit(&*store, &[Run { machine: "M9", ..Run::nth(1) }, Run::nth(1)]).await;
    assert!(
        matches!(&outcomes[..], [Ok(Committed::UnknownMachine), Ok(Committed::Stored(_))]),
        "{outcomes:?}"
    );
    assert_eq!(store.cycle(&"M9".try_into().unwrap(), &"c00001".try_into().unwrap()).await.unwrap(), None);
}

async fn pages_have_neither_gaps_nor_repeats(store: Arc<dyn Store>) {
    shop(&*store).await;
    for id in ["M2", "m2"] {
        store.put_machine(machine(id), Precondition::Absent, &super::given::engineer(), at(0)).await.unwrap();
    }
    // Equal times on three machines, so that pages end inside a group of equals; case decides the order of ids.
    let mut runs = Vec::new();
    for n in 0..30_u32 {
        for machine in ["m2", "M2", "M1"] {
            let tool = if n % 2 == 0 { "T1" } else { "T2" };
            let operation = if n % 3 == 0 { "O1" } else { "O2" };
            runs.push(Run {
                machine,
                tool: tool.to_owned(),
                operation,
                seconds: i64::from(n / 5),
                ..Run::nth(n)
            });
        }
    }
    for outcome in commit(&*store, &runs).await {
        assert!(matches!(outcome, Ok(Committed::Stored(_))), "{outcome:?}");
    }
    let key = |run: &Run| -> CycleKey {
        (at(run.seconds), run.machine.try_into().unwrap(), run.id.as_str().try_into().unwrap())
    };
    type Keep = fn(&Run) -> bool;
    let filters: [(CycleFilter, Keep); 6] = [
        (CycleFilter::default(), |_| true),
        (CycleFilter { tool: Some("T1".try_into().unwrap()), ..CycleFilter::default() }, |run| {
            run.tool == "T1"
        }),
        (CycleFilter { machine: Some("m2".try_into().unwrap()), ..CycleFilter::default() }, |run| {
            run.machine == "m2"
        }),
        (CycleFilter { operation: Some("O2".try_into().unwrap()), ..CycleFilter::default() }, |run| {
            run.operation == "O2"
        }),
        (
            CycleFilter {
                tool: Some("T2".try_into().unwrap()),
                machine: Some("M2".try_into().unwrap()),
                operation: Some("O1".try_into().unwrap()),
                ..CycleFilter::default()
            },
            |run| run.tool == "T2" && run.machine == "M2" && run.operation == "O1",
        ),
        (CycleFilter { from: Some(at(2)), to: Some(at(4)), ..CycleFilter::default() }, |run| {
            (2..4).contains(&run.seconds)
        }),
    ];
    for (filter, keep) in filters {
        let mut wanted: Vec<CycleKey> = runs.iter().filter(|run| keep(run)).map(key).collect();
        wanted.sort();
        let mut found = Vec::new();
        loop {
            let page = Page { after: found.last().cloned(), limit: 7 };
            let rows = store.cycles(&filter, page).await.unwrap();
            assert!(rows.len() <= 7);
            if rows.is_empty() {
                break;
            }
            found.extend(rows.into_iter().map(|row| (row.cycle.started_at, row.cycle.machine, row.cycle.id)));
        }
        assert_eq!(found, wanted, "{filter:?}");
        assert!(!found.is_empty());
    }
}

async fn a_number_that_is_none_is_refused(store: Arc<dyn Store>) {
    shop(&*store).await;
    for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for spoil in [0, 1, 2] {
            let mut new = new_cycle(Cycle::new(Run::nth(1).draft()).unwrap());
            match spoil {
                0 => new.summary.coverage = number,
                1 => new.summary.max_depth_mm = Some(number),
                _ => new.summary.energy[0].total_joules = number,
            }
            let outcomes = store.commit_cycles(vec![new], at(1), RecommendSettings::default()).await;
            assert!(matches!(&outcomes[..], [Err(StoreError::Refused { .. })]), "{number}: {outcomes:?}");
        }
    }
    assert!(store.cycles(&CycleFilter::default(), Page { after: None, limit: 1 }).await.unwrap().is_empty());
}

async fn after_closing_nothing_is_taken(store: Arc<dyn Store>) {
    shop(&*store).await;
    let answer = stored(&*store, &Run::nth(1)).await;
    assert!(!answer.summary.flags.contains(Flag::ToolUnregistered));
    store.probe_write(at(1)).await.unwrap();
    store.close().await;
    assert!(matches!(store.probe_write(at(2)).await, Err(StoreError::Unavailable(_))));
    let outcomes = commit(&*store, &[Run::nth(2)]).await;
    assert!(matches!(&outcomes[..], [Err(StoreError::Unavailable(_))]), "{outcomes:?}");
}

/// One is read on the thread that asks, the others by threads of their own: all are told the same, and none after the end.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn samples_are_read_by_more_than_read_at_once() {
    const CYCLES: u32 = 40;
    let given = Given::sqlite().await;
    let store = given.store();
    shop(&*store).await;
    for number in 1..=CYCLES {
        stored(&*store, &Run::nth(number)).await;
    }
    let mut reads = tokio::task::JoinSet::new();
    for read in 0..10 * CYCLES {
        let store = given.store();
        reads.spawn(async move {
            let new = Run::nth(1 + read % CYCLES).new_cycle();
            let samples = store.cycle_samples(&new.cycle.machine, &new.cycle.id).await.unwrap();
            assert_eq!(samples, new.cycle.samples);
            let none = store.cycle_samples(&new.cycle.machine, &"none".try_into().unwrap()).await.unwrap();
            assert_eq!(none, None);
        });
    }
    while let Some(read) = reads.join_next().await {
        read.unwrap();
    }
    store.close().await;
    let first = Run::nth(1).new_cycle();
    let closed = store.cycle_samples(&first.cycle.machine, &first.cycle.id).await;
    assert!(matches!(closed, Err(StoreError::Unavailable(_))), "{closed:?}");
}

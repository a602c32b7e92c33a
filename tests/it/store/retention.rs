//! Samples go when they are to go, and it is seen that they went; summaries stay.

use super::given::{Given, Run, at, commit, engineer, shop, stored, stories, watched};
use feedwright_core::ids::{CycleId, MachineId};
use feedwright_store::{
    CycleFilter, DropReason, Dropped, PAST, Page, Precondition, PutOutcome, SampleRetention, SamplesGone,
    Store, StoreError, StoreResult,
};
use sqlx::{Connection, PgConnection};
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinHandle;

stories!(
    without_a_limit_nothing_goes,
    by_age_the_old_ones_go,
    by_a_clock_that_leaps_ahead_samples_age_as_fast_as_time_may_have_gone_by,
    what_no_server_saw_go_by_is_caught_up_with,
    by_size_the_newest_stay,
    a_machine_has_a_say_of_its_own,
    what_is_said_has_versions,
    what_was_dropped_is_no_fault_and_what_is_missing_is,
    what_a_clock_that_was_ahead_has_decided_is_taken_back,
    what_was_decided_but_not_dropped_yet_stays,
    what_a_clock_that_was_ahead_received_pushes_nothing_out,
    what_comes_after_a_clock_was_set_back_by_minutes_is_not_dropped_before_the_rest,
    what_goes_while_a_decision_is_taken_back_is_told_too,
    what_is_committed_after_a_decision_was_taken_back_is_kept,
    a_clock_that_is_not_set_yet_takes_nothing_back,
    a_step_goes_on_where_the_last_one_was_and_leaves_no_machine_out,
);

const DAY: i64 = 86_400;
/// Whether anybody waits for a lock.
const WAITS: &str = "SELECT EXISTS (SELECT 1 FROM pg_stat_activity
                     WHERE datname = current_database() AND wait_event_type = 'Lock')";
const FOR_EVER: SampleRetention = SampleRetention { days: None, bytes: None };

const fn days(days: u32) -> SampleRetention {
    SampleRetention { days: Some(days), bytes: None }
}

/// Ten cycles, one every thirty days from 2026-01-05 on.
async fn year(store: &dyn Store) {
    shop(store).await;
    for n in 0..10 {
        stored(store, &Run { seconds: i64::from(n) * 30 * DAY, ..Run::nth(n) }).await;
    }
}

/// Drops all that is to go.
async fn run(store: &dyn Store, otherwise: SampleRetention, seconds: i64) -> (usize, Dropped) {
    let decided = store.decide_drops(otherwise, at(seconds)).await.unwrap().len();
    let mut all = Dropped::default();
    let mut partitions = true;
    loop {
        let step = if partitions {
            store.drop_partition(at(seconds)).await.unwrap()
        } else {
            store.drop_some(3).await.unwrap()
        };
        all.cycles += step.cycles;
        all.bytes += step.bytes;
        if !step.more && !partitions {
            return (decided, all);
        }
        partitions &= step.more;
    }
}

async fn kept(store: &dyn Store) -> Vec<bool> {
    let cycles = store.cycles(&CycleFilter::default(), Page { after: None, limit: 100 }).await.unwrap();
    cycles.iter().map(|cycle| cycle.has_samples).collect()
}

async fn without_a_limit_nothing_goes(store: Arc<dyn Store>) {
    year(&*store).await;
    assert_eq!(run(&*store, FOR_EVER, 1000 * DAY).await, (0, Dropped::default()));
    assert_eq!(kept(&*store).await, [true; 10]);
}

async fn by_age_the_old_ones_go(store: Arc<dyn Store>) {
    year(&*store).await;
    // 2026-10-02, kept for 100 days: since 2026-06-24; by months, as PostgreSQL drops them, since the first of June.
    // Cycles began on 5 Jan, 4 Feb, 6 Mar, 5 Apr, 5 May, 4 Jun, 4 Jul, …
    let now = 270 * DAY;
    let (decided, dropped) = run(&*store, days(100), now).await;
    let kept = kept(&*store).await;
    let gone = kept.iter().filter(|kept| !**kept).count();
    assert!(gone == 5 || gone == 6, "{kept:?}");
    assert_eq!((decided, dropped.cycles), (1, gone as u64));
    assert!(kept[..gone].iter().all(|kept| !kept) && kept[gone..].iter().all(|kept| *kept));
    let drops = store.sample_drops(&"M1".try_into().unwrap()).await.unwrap();
    assert_eq!(drops.len(), 1);
    assert_eq!(
        (drops[0].reason, drops[0].cycles, drops[0].dropped_at),
        (DropReason::Age, gone as u64, at(now))
    );
    assert_eq!(drops[0].bytes, dropped.bytes);
    assert!(dropped.bytes > 0);
    // Again: nothing is left to go, and nothing is decided twice.
    assert_eq!(run(&*store, days(100), now + 60).await, (0, Dropped::default()));
    let audit = store.audit(Page { after: None, limit: 100 }).await.unwrap();
    let lines: Vec<_> = audit.iter().filter(|line| line.action == "samples.drop").collect();
    assert_eq!((lines.len(), lines[0].actor.as_str()), (1, "retention"));
    assert_eq!(lines[0].subject, "machine/M1/samples");
    // A tool's wear does not need samples.
    assert_eq!(store.verdict(&"T1".try_into().unwrap()).await.unwrap().cycles, 10);
}

/// Lets samples age; says up to when they have, in seconds.
async fn age(store: &dyn Store, seconds: i64, gone_by: Duration) -> i64 {
    let aged_to = store.age_samples(at(seconds), gone_by).await.unwrap();
    aged_to.millis_since(at(0)) / 1000
}

const HOUR: Duration = Duration::from_secs(3600);

async fn by_a_clock_that_leaps_ahead_samples_age_as_fast_as_time_may_have_gone_by(store: Arc<dyn Store>) {
    year(&*store).await;
    let now = 200 * DAY;
    assert_eq!(age(&*store, now, Duration::ZERO).await, now, "nothing was known before");
    let (_, dropped) = run(&*store, days(100), now).await;
    let before = kept(&*store).await;
    assert!((3..=4).contains(&dropped.cycles), "{before:?}");

    // Thirty years, between two runs.
    let leapt = now + 11_000 * DAY;
    assert_eq!(age(&*store, leapt, HOUR).await, now + 8 * 3600);
    assert_eq!(run(&*store, days(100), leapt).await, (0, Dropped::default()));
    assert_eq!(kept(&*store).await, before);
    // Nor after a start by that clock.
    assert_eq!(age(&*store, leapt, Duration::ZERO).await, now + 8 * 3600);
    assert_eq!(run(&*store, days(100), leapt).await, (0, Dropped::default()));
    // By bytes they go as ever: the newest stay.
    let none = SampleRetention { days: None, bytes: Some(1) };
    let newest = now - DAY;
    assert_eq!(age(&*store, newest, HOUR).await, newest, "never beyond now");
    assert_eq!(
        age(&*store, now + DAY, HOUR).await,
        now + 16 * 3600,
        "nor ever back, by a clock that is not set yet"
    );
    assert_eq!(age(&*store, now + DAY, 24 * HOUR).await, now + DAY);
    let (decided, dropped) = run(&*store, none, 300 * DAY).await;
    let left = before.iter().filter(|kept| **kept).count();
    assert_eq!((decided, dropped.cycles), (1, left as u64));
}

async fn what_no_server_saw_go_by_is_caught_up_with(store: Arc<dyn Store>) {
    year(&*store).await;
    // Before the first run the last machine was heard of then, and the next server started nine weeks later.
    store.watch(vec![("M1".try_into().unwrap(), Duration::ZERO)], &watched(), at(137 * DAY)).await.unwrap();
    let now = 200 * DAY;
    assert_eq!(
        run(&*store, days(137), now).await,
        (0, Dropped::default()),
        "as old as when a machine was last heard of"
    );
    assert_eq!(age(&*store, now, Duration::ZERO).await, 137 * DAY);
    assert_eq!(age(&*store, now + DAY, 24 * HOUR).await, 145 * DAY);
    // A clock that is not set yet is no time to go on from.
    assert!(age(&*store, -4_000 * DAY, HOUR).await < 0);
    assert_eq!(age(&*store, now + DAY, Duration::ZERO).await, 145 * DAY);
    assert_eq!(age(&*store, now + 8 * DAY, 7 * 24 * HOUR).await, 201 * DAY);
    assert_eq!(age(&*store, now + 9 * DAY, 24 * HOUR).await, 209 * DAY);
    let (_, dropped) = run(&*store, days(137), now + 9 * DAY).await;
    assert!((2..=3).contains(&dropped.cycles), "{:?}", kept(&*store).await);
}

async fn by_size_the_newest_stay(store: Arc<dyn Store>) {
    year(&*store).await;
    let none = SampleRetention { days: None, bytes: Some(1) };
    let all = SampleRetention { days: None, bytes: Some(1 << 40) };
    assert_eq!(run(&*store, all, 300 * DAY).await.0, 0);
    let (_, dropped) = run(&*store, none, 300 * DAY).await;
    assert_eq!(dropped.cycles, 10, "not one block fits into a byte");

    // As many bytes as three blocks: three stay, or as many as fit where blocks differ by a byte.
    for n in 20..30 {
        stored(&*store, &Run { seconds: 300 * DAY + i64::from(n) * 60, ..Run::nth(n) }).await;
    }
    let block = dropped.bytes / 10;
    let three = SampleRetention { days: None, bytes: Some(block * 3 + block / 2) };
    let (decided, dropped) = run(&*store, three, 301 * DAY).await;
    assert_eq!((decided, dropped.cycles), (1, 7));
    assert_eq!(kept(&*store).await[10..], [[false; 7].as_slice(), &[true; 3]].concat());
    assert_eq!(store.sample_drops(&"M1".try_into().unwrap()).await.unwrap()[1].reason, DropReason::Size);
}

async fn a_machine_has_a_say_of_its_own(store: Arc<dyn Store>) {
    year(&*store).await;
    let who = engineer();
    store.put_machine(super::given::machine("M2"), Precondition::Absent, &who, at(0)).await.unwrap();
    for n in 0..10 {
        let run = Run { machine: "M2", id: format!("d{n}"), seconds: n * 30 * DAY, ..Run::nth(1) };
        stored(&*store, &run).await;
    }
    let machine: MachineId = "M2".try_into().unwrap();
    store.put_retention(&machine, FOR_EVER, Precondition::Absent, &who, at(0)).await.unwrap().unwrap();
    let (decided, dropped) = run(&*store, days(1), 400 * DAY).await;
    assert_eq!((decided, dropped.cycles), (1, 10), "the server's setting holds for M1 alone");
    let of_m2 = CycleFilter { machine: Some(machine), ..CycleFilter::default() };
    let cycles = store.cycles(&of_m2, Page { after: None, limit: 100 }).await.unwrap();
    assert!(cycles.iter().all(|cycle| cycle.has_samples));
}

async fn what_is_said_has_versions(store: Arc<dyn Store>) {
    shop(&*store).await;
    let (who, machine) = (engineer(), MachineId::try_from("M1").unwrap());
    assert_eq!(store.retention(&machine).await.unwrap(), None);
    let put = |retention, expects| {
        let (store, who, machine) = (store.clone(), who.clone(), machine.clone());
        async move { store.put_retention(&machine, retention, expects, &who, at(5)).await }
    };
    assert_eq!(put(days(30), Precondition::Unstated).await.unwrap(), Some(PutOutcome::Created));
    assert_eq!(put(days(30), Precondition::Unstated).await.unwrap(), Some(PutOutcome::Unchanged(1)));
    let changed = put(days(60), Precondition::Unstated).await;
    assert!(matches!(changed, Err(StoreError::VersionRequired { current: 1 })), "{changed:?}");
    assert_eq!(put(days(60), Precondition::Version(1)).await.unwrap(), Some(PutOutcome::Changed(2)));
    let said = store.retention(&machine).await.unwrap().unwrap();
    assert_eq!((said.value, said.version, said.updated_at), (days(60), 2, at(5)));
    let unknown = MachineId::try_from("M9").unwrap();
    let put = store.put_retention(&unknown, days(1), Precondition::Unstated, &who, at(5)).await.unwrap();
    assert_eq!(put, None);
}

async fn what_was_dropped_is_no_fault_and_what_is_missing_is(store: Arc<dyn Store>) {
    year(&*store).await;
    run(&*store, days(100), 270 * DAY).await;
    let gone = kept(&*store).await.iter().filter(|kept| !**kept).count() as u64;
    let first = store.check_cycles(None, 7).await.unwrap();
    assert_eq!((first.checked, first.dropped, first.faults.as_slice()), (7, gone, [].as_slice()));
    let rest = store.check_cycles(first.next.as_ref(), 7).await.unwrap();
    assert_eq!((rest.checked, rest.next), (3, None));
    assert_eq!(store.check_tables().await.unwrap(), []);
}

async fn what_a_clock_that_was_ahead_has_decided_is_taken_back(store: Arc<dyn Store>) {
    year(&*store).await;
    let machine = MachineId::try_from("M1").unwrap();
    assert_eq!(run(&*store, days(100), 150 * DAY).await.0, 1, "an honest decision");
    let honest = store.sample_drops(&machine).await.unwrap();
    assert_eq!(run(&*store, days(30), 1000 * DAY).await.0, 1);
    assert_eq!(kept(&*store).await, [false; 10], "they are gone");
    // The clock is right again.
    let sampled = |n: u32, day: i64| Run { seconds: day * DAY, ..Run::nth(n) };
    stored(&*store, &sampled(10, 300)).await;
    for day in [300, 310] {
        assert_eq!(run(&*store, days(30), day * DAY + 60).await, (0, Dropped::default()), "day {day}");
        stored(&*store, &sampled(u32::try_from(day).unwrap(), day + 1)).await;
    }
    let whole = kept(&*store).await;
    assert_eq!(whole.iter().filter(|kept| **kept).count(), 3, "{whole:?}");
    let told = store.sample_drops(&machine).await.unwrap();
    assert_eq!(told[0], honest[0]);
    assert_eq!(told.iter().map(|drop| drop.cycles).sum::<u64>(), 10, "{told:?}");
    assert!(told.iter().all(|drop| drop.before <= at(300 * DAY + 60)), "{told:?}");
    let checked = store.check_cycles(None, 100).await.unwrap();
    assert_eq!((checked.dropped, checked.faults.as_slice()), (10, [].as_slice()));
    let audit = store.audit(Page { after: None, limit: 100 }).await.unwrap();
    assert_eq!(audit.iter().filter(|entry| entry.action == "samples.drop_taken_back").count(), 1);
    // And decisions are made as ever.
    assert_eq!(run(&*store, days(30), 400 * DAY).await.1.cycles, 3);
}

async fn what_was_decided_but_not_dropped_yet_stays(store: Arc<dyn Store>) {
    year(&*store).await;
    // A server whose clock is ahead decides, and stops before it drops anything.
    assert_eq!(store.decide_drops(days(30), at(1000 * DAY)).await.unwrap().len(), 1);
    let (first, second) = tokio::join!(
        store.decide_drops(FOR_EVER, at(300 * DAY)),
        store.decide_drops(FOR_EVER, at(300 * DAY))
    );
    assert_eq!((first.unwrap().len(), second.unwrap().len()), (0, 0), "two servers at once");
    assert_eq!(run(&*store, FOR_EVER, 300 * DAY).await, (0, Dropped::default()));
    assert_eq!(kept(&*store).await, [true; 10]);
    assert_eq!(store.sample_drops(&"M1".try_into().unwrap()).await.unwrap(), [], "nothing went");
    let audit = store.audit(Page { after: None, limit: 100 }).await.unwrap();
    assert_eq!(audit.iter().filter(|entry| entry.action == "samples.drop_taken_back").count(), 1);
}

async fn what_a_clock_that_was_ahead_received_pushes_nothing_out(store: Arc<dyn Store>) {
    shop(&*store).await;
    for n in 0..4 {
        stored(&*store, &Run { seconds: 900 * DAY + i64::from(n) * 60, ..Run::nth(n) }).await;
    }
    for n in 4..10 {
        stored(&*store, &Run { seconds: 300 * DAY + i64::from(n) * 60, ..Run::nth(n) }).await;
    }
    // Not one block fits into a byte; those that are to be received yet are no reason to drop what comes until then.
    let none = SampleRetention { days: None, bytes: Some(1) };
    assert_eq!(run(&*store, none, 301 * DAY).await.1.cycles, 6);
    assert_eq!(
        kept(&*store).await,
        [[false; 6].as_slice(), &[true; 4]].concat(),
        "in the order of their beginnings"
    );
    let drops = store.sample_drops(&"M1".try_into().unwrap()).await.unwrap();
    assert!(drops[0].before < at(301 * DAY), "{drops:?}");
    stored(&*store, &Run { seconds: 302 * DAY, ..Run::nth(20) }).await;
    let some = SampleRetention { days: None, bytes: Some(1 << 20) };
    assert_eq!(run(&*store, some, 303 * DAY).await, (0, Dropped::default()));
}

async fn what_comes_after_a_clock_was_set_back_by_minutes_is_not_dropped_before_the_rest(
    store: Arc<dyn Store>,
) {
    shop(&*store).await;
    let received = |n, seconds| Run { seconds, ..Run::nth(n) };
    stored(&*store, &received(0, 0)).await;
    let none = SampleRetention { days: None, bytes: Some(1) };
    let three = bytes_of(3, run(&*store, none, 60).await.1);
    stored(&*store, &received(1, DAY - 3600)).await;
    // Eight minutes ahead; then it is set right, and others come.
    for n in 2..7 {
        stored(&*store, &received(n, DAY + 60 + i64::from(n) * 60)).await;
    }
    for n in 7..10 {
        stored(&*store, &received(n, DAY + i64::from(n))).await;
    }
    assert_eq!(run(&*store, three, DAY + 90).await.1.cycles, 1, "what came an hour ago");
    assert_eq!(kept(&*store).await, [[false; 2].as_slice(), &[true; 8]].concat());
    // None of them lies ahead any more.
    for n in 10..13 {
        stored(&*store, &received(n, DAY + 900 + i64::from(n))).await;
    }
    assert_eq!(run(&*store, three, DAY + 960).await.1.cycles, 8);
    assert_eq!(kept(&*store).await, [[false; 10].as_slice(), &[true; 3]].concat());
}

/// As many bytes as that many blocks of these cycles, and half a block.
fn bytes_of(blocks: u64, dropped: Dropped) -> SampleRetention {
    let block = dropped.bytes / dropped.cycles;
    SampleRetention { days: None, bytes: Some(block * blocks + block / 2) }
}

/// Every cycle that has no samples any more, with when and why they went.
async fn gone(store: &dyn Store) -> Vec<(String, Option<SamplesGone>)> {
    let machine = MachineId::try_from("M1").unwrap();
    let cycles = store.cycles(&CycleFilter::default(), Page { after: None, limit: 100 }).await.unwrap();
    let without: Vec<_> = cycles.iter().filter(|cycle| cycle.samples_are_gone()).collect();
    let asked: Vec<_> = without.iter().map(|cycle| (cycle.cycle.id.clone(), cycle.received_at)).collect();
    let told = store.samples_gone(&machine, &asked).await.unwrap();
    asked.into_iter().map(|(cycle, _)| (cycle.to_string(), told.get(&cycle).copied())).collect()
}

async fn told_drops(store: &dyn Store) -> u64 {
    let drops = store.sample_drops(&"M1".try_into().unwrap()).await.unwrap();
    drops.iter().map(|drop| drop.cycles).sum()
}

/// By bytes: what the clock received last stays, what it received before that went with what had been there.
async fn what_a_clock_that_was_ahead_received_and_dropped_itself_is_named(given: &Given) {
    let store = given.store();
    let store = &*store;
    shop(store).await;
    stored(store, &Run { seconds: 0, ..Run::nth(99) }).await;
    let none = SampleRetention { days: None, bytes: Some(1) };
    let two = bytes_of(2, run(store, none, 60).await.1);
    for n in 0..5 {
        stored(store, &Run { seconds: 3600 + i64::from(n) * 60, ..Run::nth(n) }).await;
    }
    for n in 5..11 {
        stored(store, &Run { seconds: 40 * DAY + i64::from(n) * 60, ..Run::nth(n) }).await;
    }
    assert_eq!(run(store, two, 40 * DAY + 3600).await.1.cycles, 9);
    // The clock is right again: all of them are told, and none that is yet to come.
    for seconds in [DAY, DAY + 3600] {
        assert_eq!(run(store, two, seconds).await, (0, Dropped::default()));
        let told = gone(store).await;
        let since = |at| Some(SamplesGone { dropped_at: at, reason: DropReason::Size });
        let expected = [("c00099".to_owned(), since(at(60)))].into_iter();
        let expected = expected.chain((0..9).map(|n| (format!("c{n:05}"), since(at(DAY)))));
        assert_eq!(told, expected.collect::<Vec<_>>());
        let checked = store.check_cycles(None, 100).await.unwrap();
        assert_eq!((checked.dropped, checked.faults.as_slice()), (10, [].as_slice()));
        assert_eq!(told_drops(store).await, 10, "counts stay with what they count");
    }
    // Their time has come, and what is received between them is kept: where its samples are missing, nobody dropped them.
    for n in 20..22 {
        stored(store, &Run { seconds: 40 * DAY + i64::from(n - 15) * 60 + 1, ..Run::nth(n) }).await;
    }
    let lost = "DELETE FROM cycle_samples WHERE cycle_id = 'c00021'";
    assert_eq!(given.raw(lost).await.unwrap(), 1);
    let checked = store.check_cycles(None, 100).await.unwrap();
    let faults: Vec<_> = checked.faults.iter().map(|fault| fault.key.as_str()).collect();
    assert_eq!((checked.dropped, faults.as_slice()), (10, ["M1/c00021"].as_slice()));
    assert_eq!(gone(store).await.iter().filter(|(_, told)| told.is_none()).count(), 1);
    // A later decision tells of their receipts too; it is not what dropped them.
    let (_, dropped) = run(store, none, 41 * DAY).await;
    assert_eq!(dropped.cycles, 3, "two that the clock had received, and one between them");
    let of_name = gone(store).await.into_iter().find(|(id, _)| id == "c00005").unwrap().1;
    assert_eq!(of_name.unwrap().dropped_at, at(DAY));
}

/// By days: ahead by forty days, and then by eighty.
async fn what_a_clock_ran_further_and_further_ahead_dropped_is_named(given: &Given) {
    let store = given.store();
    let store = &*store;
    shop(store).await;
    for (n, day) in [(1, 0), (2, 40), (3, 40), (4, 80)] {
        stored(store, &Run { seconds: day * DAY + i64::from(n) * 60, ..Run::nth(n) }).await;
    }
    // Up to the fifth of February, or by months up to the first, and then up to the second of April, or the first.
    assert_eq!(run(store, days(30), 61 * DAY).await.1.cycles, 1);
    assert_eq!(run(store, days(30), 117 * DAY).await.1.cycles, 3);
    assert_eq!(run(store, days(30), DAY).await, (0, Dropped::default()));
    let since = Some(SamplesGone { dropped_at: at(DAY), reason: DropReason::Age });
    let expected = (1..5).map(|n| (format!("c{n:05}"), since));
    assert_eq!(gone(store).await, expected.collect::<Vec<_>>());
    let checked = store.check_cycles(None, 100).await.unwrap();
    assert_eq!((checked.dropped, checked.faults.as_slice()), (4, [].as_slice()));
    assert_eq!(told_drops(store).await, 4);
    let drops = store.sample_drops(&"M1".try_into().unwrap()).await.unwrap();
    assert!(drops.iter().all(|drop| drop.before <= at(DAY)), "{drops:?}");
}

/// Another server still drops by the decision: however the two come between each other, every cycle has its samples or is told.
async fn what_goes_while_a_decision_is_taken_back_is_told_too(store: Arc<dyn Store>) {
    shop(&*store).await;
    let runs: Vec<Run> =
        (0..40).map(|n| Run { seconds: 40 * DAY + i64::from(n) * 60, ..Run::nth(n) }).collect();
    super::given::commit(&*store, &runs).await;
    let none = SampleRetention { days: None, bytes: Some(1) };
    assert_eq!(store.decide_drops(none, at(41 * DAY)).await.unwrap().len(), 1);
    assert_eq!(store.drop_some(3).await.unwrap().cycles, 3);
    let dropping = async {
        let mut dropped = 3;
        loop {
            let step = store.drop_some(2).await.unwrap();
            dropped += step.cycles;
            if !step.more {
                return dropped;
            }
        }
    };
    let (decided, dropped) = tokio::join!(store.decide_drops(FOR_EVER, at(DAY)), dropping);
    assert_eq!(decided.unwrap(), []);
    // Where too much went meanwhile, the next run takes it back.
    assert_eq!(run(&*store, FOR_EVER, DAY + 60).await, (0, Dropped::default()));
    let left = kept(&*store).await.iter().filter(|kept| **kept).count() as u64;
    let checked = store.check_cycles(None, 100).await.unwrap();
    assert_eq!((checked.dropped, checked.faults.as_slice()), (dropped, [].as_slice()));
    assert_eq!((dropped + left, told_drops(&*store).await), (40, dropped));
    let drops = store.sample_drops(&"M1".try_into().unwrap()).await.unwrap();
    assert!(drops.iter().all(|drop| drop.before <= at(DAY + 60)), "{drops:?}");
}

/// The clock of another server is behind by minutes, and a post is received before it waits to be committed.
async fn what_is_committed_after_a_decision_was_taken_back_is_kept(store: Arc<dyn Store>) {
    shop(&*store).await;
    let now = 300 * DAY;
    let received = |n: u32, before: i64| Run { seconds: now - before, ..Run::nth(n) };
    for run in [received(1, DAY), received(2, 1000), received(3, 120)] {
        stored(&*store, &run).await;
    }
    assert_eq!(run(&*store, days(30), 1000 * DAY).await.1.cycles, 3);
    assert_eq!(run(&*store, days(30), now).await, (0, Dropped::default()));
    for run in [received(4, 63), received(5, 4)] {
        stored(&*store, &run).await;
    }
    for seconds in [now + 1, now + 3600] {
        assert_eq!(run(&*store, days(30), seconds).await, (0, Dropped::default()));
    }
    assert_eq!(kept(&*store).await, [false, false, false, true, true]);
    let since = Some(SamplesGone { dropped_at: at(now), reason: DropReason::Age });
    let expected = (1..4).map(|n| (format!("c{n:05}"), since));
    assert_eq!(gone(&*store).await, expected.collect::<Vec<_>>());
    let checked = store.check_cycles(None, 100).await.unwrap();
    assert_eq!((checked.dropped, checked.faults.as_slice()), (3, [].as_slice()));
    assert_eq!(told_drops(&*store).await, 3);
}

/// A computer without a clock of its own starts years ago, and the right time comes a minute later.
async fn a_clock_that_is_not_set_yet_takes_nothing_back(store: Arc<dyn Store>) {
    let started = -2200 * DAY;
    assert!(at(started) < PAST && PAST <= at(-10), "stories begin after what is past beyond doubt");
    year(&*store).await;
    run(&*store, days(100), 150 * DAY).await;
    run(&*store, days(100), 270 * DAY).await;
    let machine = MachineId::try_from("M1").unwrap();
    let (drops, told) = (store.sample_drops(&machine).await.unwrap(), gone(&*store).await);
    assert!(drops.len() == 2 && !told.is_empty(), "{drops:?} {told:?}");
    for seconds in [started, 270 * DAY + 60] {
        assert_eq!(run(&*store, days(100), seconds).await, (0, Dropped::default()));
        assert_eq!(store.sample_drops(&machine).await.unwrap(), drops);
        assert_eq!(gone(&*store).await, told);
    }
}

/// What the check must find, told on the tables themselves.
async fn damage_is_named_by_its_key(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    let runs: Vec<Run> = (1..=6).map(|n| Run { sampled: n != 6, ..Run::nth(n) }).collect();
    for outcome in commit(&*store, &runs).await {
        outcome.unwrap();
    }
    let clean = store.check_cycles(None, 100).await.unwrap();
    assert_eq!((clean.checked, clean.faults.as_slice()), (6, [].as_slice()));
    for statement in [
        "DELETE FROM cycle_samples WHERE cycle_id = 'c00002'".to_owned(),
        given.change("reported_energy_joules = reported_energy_joules + 1.0 WHERE cycle_id = 'c00006'"),
        "UPDATE cycles SET sample_count = 21 WHERE cycle_id = 'c00003'".to_owned(),
        "UPDATE cycle_samples SET cycle_id = 'stray' WHERE cycle_id = 'c00004'".to_owned(),
    ] {
        given.raw(sqlx::AssertSqlSafe(statement)).await.unwrap();
    }
    let damage = if given.is_postgres() {
        "UPDATE cycle_samples SET block = decode(repeat('00', length(block)), 'hex') WHERE cycle_id = 'c00005'"
    } else {
        "UPDATE sample_packs SET blocks = CAST(substr(blocks, 1, length(blocks) - 50) || zeroblob(50) AS BLOB)"
    };
    assert_eq!(given.raw(damage).await.unwrap(), 1);
    let found = store.check_cycles(None, 100).await.unwrap();
    let faults: Vec<_> = found.faults.iter().map(|fault| (fault.kind, fault.key.as_str())).collect();
    assert_eq!(
        faults,
        [
            ("samples", "M1/c00002"),
            ("samples", "M1/c00003"),
            ("samples", "M1/c00004"),
            ("samples", "M1/c00005"),
            ("hash", "M1/c00006"),
        ]
    );
    assert!(found.faults[3].detail.contains("checksum differs"), "{:?}", found.faults[3]);
    let unsaid = given.raw("DELETE FROM advices").await.unwrap();
    assert!(unsaid > 0);
    let strays = store.check_tables().await.unwrap();
    let (unsaid, strays): (Vec<_>, Vec<_>) =
        strays.iter().map(|fault| (fault.kind, fault.key.as_str())).partition(|it| it.0 == "recommendation");
    assert_eq!((unsaid.len(), strays.as_slice()), (6, [("samples", "M1/stray")].as_slice()));
    let id = CycleId::try_from("c00005").unwrap();
    let read = store.cycle_samples(&"M1".try_into().unwrap(), &id).await;
    assert!(matches!(read, Err(StoreError::Damaged { .. })), "{read:?}");
}

/// What one machine's decisions tell of is kept of the other, and missed where it is not there.
async fn each_machine_has_its_decisions(given: &Given) {
    let store = given.store();
    year(&*store).await;
    let who = engineer();
    store.put_machine(super::given::machine("M2"), Precondition::Absent, &who, at(0)).await.unwrap();
    for n in 0..10 {
        stored(&*store, &Run { machine: "M2", seconds: i64::from(n) * 30 * DAY, ..Run::nth(n) }).await;
    }
    let longer = days(200);
    store.put_retention(&"M2".try_into().unwrap(), longer, Precondition::Absent, &who, at(0)).await.unwrap();
    // Several decisions of each, on several days; what goes, goes after the last.
    for day in [100, 150, 200, 270] {
        store.decide_drops(days(60), at(day * DAY)).await.unwrap();
    }
    let decided = async |machine: &str| store.sample_drops(&machine.try_into().unwrap()).await.unwrap();
    let (first, second) = (decided("M1").await, decided("M2").await);
    let newest = |drops: &[feedwright_store::SampleDrop]| drops.iter().map(|drop| drop.before).max().unwrap();
    assert!(first.len() > 1 && newest(&first) > newest(&second), "{first:?} {second:?}");
    let cycles = store.cycles(&CycleFilter::default(), Page { after: None, limit: 100 }).await.unwrap();
    let goes = |machine: &str, drops: &[_]| {
        let of = cycles.iter().filter(|cycle| cycle.cycle.machine.as_str() == machine);
        of.filter(|cycle| cycle.received_at < newest(drops)).count() as u64
    };
    let expected = [goes("M1", &first), goes("M2", &second)];
    let mut gone = 0;
    loop {
        let step = store.drop_some(1).await.unwrap();
        gone += step.cycles;
        if !step.more {
            break;
        }
    }
    assert_eq!(gone, expected.iter().sum::<u64>());
    for (machine, expected) in ["M1", "M2"].into_iter().zip(expected) {
        let counted: u64 = decided(machine).await.iter().map(|drop| drop.cycles).sum();
        assert_eq!(counted, expected, "{machine}");
    }
    // One that M1's decisions would name, and M2's do not.
    let missing = "DELETE FROM cycle_samples WHERE machine_id = 'M2' AND cycle_id = 'c00005'";
    assert_eq!(given.raw(missing).await.unwrap(), 1);
    let checked = store.check_cycles(None, 100).await.unwrap();
    let faults: Vec<_> = checked.faults.iter().map(|fault| (fault.kind, fault.key.as_str())).collect();
    assert_eq!((checked.dropped, faults.as_slice()), (gone, [("samples", "M2/c00005")].as_slice()));
}

/// What a step costs is no matter of how many decisions there ever were.
#[tokio::test]
async fn a_step_reads_the_newest_decisions_and_no_others() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = &*given.store();
    year(store).await;
    for n in 2..=40 {
        let registered = super::given::machine(&format!("M{n}"));
        store.put_machine(registered, Precondition::Absent, &engineer(), at(0)).await.unwrap();
    }
    assert_eq!(store.decide_drops(days(1), at(1000 * DAY)).await.unwrap().len(), 1);
    let decided = "INSERT INTO sample_drops (machine_id, before_us, dropped_at_us, reason, cycles, bytes)
                   SELECT 'M' || machine, day, day, 'age', 1, 1
                   FROM generate_series(1, 40) AS machine, generate_series(1, 365) AS day";
    assert_eq!(given.raw(decided).await.unwrap(), 40 * 365);
    given.raw("ANALYZE sample_drops").await.unwrap();
    for step in 0..10 {
        assert_eq!(store.drop_some(1).await.unwrap().cycles, 1, "{step}");
    }
    assert_eq!(store.drop_some(1).await.unwrap(), Dropped::default());
    let read = given.read_of("sample_drops").await;
    // A run looks once for each machine, and some times for each step; it went through 14,600 for each of them.
    assert!(read < 500, "{read}");
    given.done().await;
}

/// Steps remember the machine that they were at; in which order machines are gone through is not changed by that, nor is any left out.
async fn a_step_goes_on_where_the_last_one_was_and_leaves_no_machine_out(store: Arc<dyn Store>) {
    let store = &*store;
    year(store).await;
    for id in ["M0", "M2"] {
        store.put_machine(super::given::machine(id), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    }
    let of = |machine: &'static str, n: u32| Run { machine, seconds: i64::from(n) * 30 * DAY, ..Run::nth(n) };
    for n in 0..3 {
        stored(store, &of("M2", n)).await;
    }
    let now = 400 * DAY;
    let told = async || {
        let mut counts = Vec::new();
        for machine in ["M0", "M1", "M2"] {
            let drops = store.sample_drops(&machine.try_into().unwrap()).await.unwrap();
            counts.push(drops.iter().map(|drop| drop.cycles).sum::<u64>());
        }
        counts
    };
    assert_eq!(store.decide_drops(days(30), at(now)).await.unwrap().len(), 2);
    store.drop_some(8).await.unwrap();
    assert_eq!(told().await, [0, 8, 0]);
    store.drop_some(8).await.unwrap();
    store.drop_some(1).await.unwrap();
    assert_eq!(told().await, [0, 10, 1]);
    // What was received before the decision, and is committed behind the machine's turn, goes in the same run.
    stored(store, &Run { id: "late".to_owned(), ..of("M1", 1) }).await;
    store.drop_some(8).await.unwrap();
    assert_eq!(told().await, [0, 10, 3]);
    store.drop_some(8).await.unwrap();
    assert_eq!(told().await, [0, 11, 3]);
    // What is decided between two steps goes in its order.
    for machine in ["M0", "M1"] {
        stored(store, &Run { id: "later".to_owned(), ..of(machine, 2) }).await;
    }
    stored(store, &Run { id: "more".to_owned(), ..of("M1", 2) }).await;
    store.drop_some(1).await.unwrap();
    assert_eq!(told().await, [0, 12, 3]);
    assert_eq!(store.decide_drops(days(30), at(now + 40 * DAY)).await.unwrap().len(), 2);
    store.drop_some(1).await.unwrap();
    assert_eq!(told().await, [1, 12, 3]);
    assert_eq!(run(store, days(30), now + 40 * DAY).await.1.cycles, 1);
    assert_eq!(told().await, [1, 13, 3]);
}

/// Several servers are apart by minutes; a single one is not apart from itself.
#[tokio::test]
async fn what_a_single_server_decided_minutes_ahead_drops_nothing_that_comes() {
    let given = Given::sqlite().await;
    let store = &*given.store();
    shop(store).await;
    stored(store, &Run { seconds: 0, ..Run::nth(99) }).await;
    let none = SampleRetention { days: None, bytes: Some(1) };
    let two = bytes_of(2, run(store, none, 60).await.1);
    // Nine minutes ahead: the oldest three of five go.
    for n in 0..5 {
        stored(store, &Run { seconds: DAY + 540 + i64::from(n), ..Run::nth(n) }).await;
    }
    assert_eq!(run(store, two, DAY + 560).await.1.cycles, 3);
    // It is set right, and others come: they are newer than all that is there.
    for n in 5..9 {
        stored(store, &Run { seconds: DAY + 30 + i64::from(n), ..Run::nth(n) }).await;
    }
    assert_eq!(run(store, two, DAY + 60).await, (0, Dropped::default()));
    let gone: Vec<_> = gone(store).await.into_iter().map(|(cycle, told)| (cycle, told.is_some())).collect();
    let told = ["c00000", "c00001", "c00002", "c00099"].map(|id| (id.to_owned(), true));
    assert_eq!(gone.into_iter().collect::<std::collections::BTreeSet<_>>(), told.into());
    // When that time has come, room is made as ever.
    for n in 20..22 {
        stored(store, &Run { seconds: DAY + 1200 + i64::from(n), ..Run::nth(n) }).await;
    }
    assert_eq!(run(store, two, DAY + 1300).await.1.cycles, 6);
    let checked = store.check_cycles(None, 100).await.unwrap();
    assert_eq!((checked.dropped, checked.faults.as_slice()), (10, [].as_slice()));
    given.done().await;
}

mod damage {
    use super::damage_is_named_by_its_key;
    crate::store::given::stories!(with tables:
        damage_is_named,
        of_two_machines_each_has_its_decisions,
        what_it_received_and_dropped_itself_is_named,
        what_it_dropped_further_and_further_ahead_is_named,
    );

    async fn what_it_received_and_dropped_itself_is_named(given: &super::Given) {
        super::what_a_clock_that_was_ahead_received_and_dropped_itself_is_named(given).await;
    }

    async fn what_it_dropped_further_and_further_ahead_is_named(given: &super::Given) {
        super::what_a_clock_ran_further_and_further_ahead_dropped_is_named(given).await;
    }

    async fn of_two_machines_each_has_its_decisions(given: &super::Given) {
        super::each_machine_has_its_decisions(given).await;
    }

    async fn damage_is_named(given: &super::Given) {
        damage_is_named_by_its_key(given).await;
    }
}

/// The key of a name that servers lock, as `locks` makes it.
fn key(name: &str) -> i64 {
    let mut first = [0; 8];
    first.copy_from_slice(&blake3::hash(name.as_bytes()).as_bytes()[..8]);
    i64::from_le_bytes(first)
}

/// Another server takes the decision back while this one waits to delete by it.
#[tokio::test]
async fn postgres_deletes_nothing_by_a_decision_that_was_taken_back_meanwhile() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = given.store();
    shop(&*store).await;
    stored(&*store, &Run::nth(1)).await;
    assert_eq!(store.decide_drops(days(30), at(1000 * DAY)).await.unwrap().len(), 1);
    let mut other = PgConnection::connect(&given.address()).await.unwrap();
    let mut taking_back = other.begin().await.unwrap();
    let lock = sqlx::query("SELECT pg_advisory_xact_lock($1)").bind(key("retention/M1"));
    lock.execute(&mut *taking_back).await.unwrap();
    let dropping = async {
        let step = store.drop_some(3).await.unwrap();
        assert_eq!((step.cycles, step.bytes), (0, 0));
    };
    let taken_back = async {
        while !sqlx::query_scalar::<_, bool>(WAITS).fetch_one(&mut *taking_back).await.unwrap() {}
        sqlx::query("DELETE FROM sample_drops").execute(&mut *taking_back).await.unwrap();
        taking_back.commit().await.unwrap();
    };
    let both = async { tokio::join!(dropping, taken_back) };
    tokio::time::timeout(Duration::from_secs(60), both).await.expect("whoever deletes asks for the name");
    assert_eq!(kept(&*store).await, [true]);
    assert_eq!(run(&*store, FOR_EVER, DAY).await, (0, Dropped::default()));
    other.close().await.unwrap();
    given.done().await;
}

/// The clock of a server tells what it likes: the database's counts.
#[tokio::test]
async fn postgres_goes_by_one_clock_whatever_that_of_a_server_tells() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = given.store();
    shop(&*store).await;
    let now = given.numbers("SELECT CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000000 AS BIGINT)").await;
    let now = (now[0] - at(0).micros()) / 1_000_000;
    let server = given.server_of_its_own().await;
    let mut all = Vec::new();
    for (n, clock) in [(0, now - 20 * 366 * DAY), (10, now + 20 * 366 * DAY), (20, now)] {
        // Two months are to go by a limit of one month: PostgreSQL drops by months.
        for (n, age) in [(n, 62 + i64::from(n)), (n + 1, 63 + i64::from(n)), (n + 2, 20), (n + 3, 0)] {
            let seconds = now - age * DAY;
            store.make_room(at(seconds)).await.unwrap();
            stored(&*store, &Run { seconds, ..Run::nth(n) }).await;
        }
        let dropped = run(&server, days(30), clock).await.1;
        all.push(dropped.cycles);
        let told = store.sample_drops(&"M1".try_into().unwrap()).await.unwrap();
        let last = told.last().unwrap();
        assert!(last.before <= at(now - 29 * DAY) && last.dropped_at < at(now + DAY), "{last:?}");
    }
    assert_eq!(all, [2, 2, 2]);
    let whole = kept(&*store).await.into_iter().filter(|kept| *kept).count();
    assert_eq!(whole, 6);
    let audit = store.audit(Page { after: None, limit: 100 }).await.unwrap();
    assert!(audit.iter().all(|entry| entry.action != "samples.drop_taken_back"));
    server.close().await;
    given.done().await;
}

#[tokio::test]
async fn postgres_drops_a_partition_when_nothing_of_it_is_kept() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = given.store();
    store.make_room(at(0)).await.unwrap();
    year(&*store).await;
    let who = engineer();
    store.put_machine(super::given::machine("M2"), Precondition::Absent, &who, at(0)).await.unwrap();
    stored(&*store, &Run { machine: "M2", id: "kept".to_owned(), seconds: 30 * DAY, ..Run::nth(1) }).await;
    let machine: MachineId = "M2".try_into().unwrap();
    store.put_retention(&machine, FOR_EVER, Precondition::Absent, &who, at(0)).await.unwrap();
    // Until the first of April all of M1's are to go: January and March whole, February row by row, since M2 keeps one.
    let (_, dropped) = run(&*store, days(30), 125 * DAY).await;
    assert_eq!(dropped.cycles, 3);
    for (partition, there) in [("202601", false), ("202602", true), ("202603", false), ("202604", true)] {
        let exists = match partition {
            "202601" => given.raw("SELECT 1 FROM cycle_samples_202601").await,
            "202602" => given.raw("SELECT 1 FROM cycle_samples_202602").await,
            "202603" => given.raw("SELECT 1 FROM cycle_samples_202603").await,
            _ => given.raw("SELECT 1 FROM cycle_samples_202604").await,
        };
        assert_eq!(exists.is_ok(), there, "{partition}: {exists:?}");
    }
    let drops = store.sample_drops(&"M1".try_into().unwrap()).await.unwrap();
    assert_eq!(drops[0].cycles, 3, "those of a partition are counted too");
    given.done().await;
}

/// Runs a step of dropping beside a change of another server that it has to wait for, until it did wait for it.
async fn beside(given: &Given, change: &'static str) -> Dropped {
    let store = given.store();
    let mut other = PgConnection::connect(&given.address()).await.unwrap();
    loop {
        let mut changing = other.begin().await.unwrap();
        sqlx::query(change).execute(&mut *changing).await.unwrap();
        let step = dropping(&store);
        while !step.is_finished()
            && !sqlx::query_scalar::<_, bool>(WAITS).fetch_one(&mut *changing).await.unwrap()
        {}
        let waited = !step.is_finished();
        // A server that is very slow may give up waiting: then all is as it was.
        if waited {
            changing.commit().await.unwrap();
        } else {
            changing.rollback().await.unwrap();
        }
        match step.await.unwrap() {
            Ok(dropped) if waited => {
                other.close().await.unwrap();
                return dropped;
            }
            outcome => assert!(matches!(outcome, Err(StoreError::Unavailable(_))) && !waited, "{outcome:?}"),
        }
    }
}

/// A year of which January, February and March are to go, month by month.
async fn decided(given: &Given) -> Arc<dyn Store> {
    let store = given.store();
    store.make_room(at(0)).await.unwrap();
    year(&*store).await;
    store.decide_drops(days(30), at(125 * DAY)).await.unwrap();
    store
}

/// A partition is dropped, by a server of its own.
fn dropping(store: &Arc<dyn Store>) -> JoinHandle<StoreResult<Dropped>> {
    let store = Arc::clone(store);
    tokio::spawn(async move { store.drop_partition(at(125 * DAY)).await })
}

#[tokio::test]
async fn a_partition_that_cannot_be_dropped_keeps_no_other() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = decided(&given).await;
    given.raw("CREATE VIEW somebodys AS SELECT * FROM cycle_samples_202601").await.unwrap();
    for month in ["February", "March"] {
        assert_eq!(store.drop_partition(at(125 * DAY)).await.unwrap().cycles, 1, "{month}");
    }
    let stays = store.drop_partition(at(125 * DAY)).await.unwrap_err();
    assert!(matches!(&stays, StoreError::Unavailable(_)), "{stays:?}");
    assert!(
        format!("{stays:?}").contains("the partition cycle_samples_202601 cannot be dropped"),
        "{stays:?}"
    );
    given.raw("DROP VIEW somebodys").await.unwrap();
    // Nor does one that was put elsewhere; what has its name here is not it.
    for step in [
        "CREATE SCHEMA archive",
        "ALTER TABLE cycle_samples_202601 SET SCHEMA archive",
        "CREATE TABLE cycle_samples_202601 (machine_id TEXT, block BYTEA)",
        "INSERT INTO cycle_samples_202601 VALUES ('M1', '')",
    ] {
        given.raw(step).await.unwrap();
    }
    assert_eq!(store.drop_partition(at(125 * DAY)).await.unwrap().cycles, 1);
    assert_eq!(given.numbers("SELECT COUNT(*) FROM cycle_samples_202601").await, [1]);
    // Whatever a backslash in a text is to the role that asks.
    let mut other = PgConnection::connect(&given.address()).await.unwrap();
    sqlx::query("SET standard_conforming_strings = off").execute(&mut other).await.unwrap();
    let found = "SELECT count(*) FROM cycle_samples_partitions()";
    assert!(sqlx::query_scalar::<_, i64>(found).fetch_one(&mut other).await.unwrap() > 3);
    other.close().await.unwrap();
    given.done().await;
}

async fn counts(store: &dyn Store) -> u64 {
    let drops = store.sample_drops(&"M1".try_into().unwrap()).await.unwrap();
    drops.iter().map(|drop| drop.cycles).sum()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_another_server_deletes_from_a_partition_is_not_counted_with_it() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = decided(&given).await;
    // It has deleted January's cycle, and counted it.
    let dropped = beside(
        &given,
        "WITH gone AS (DELETE FROM cycle_samples WHERE received_at_us < (
             SELECT to_us FROM cycle_samples_partitions() WHERE name = 'cycle_samples_202601') RETURNING 1)
         UPDATE sample_drops SET cycles = cycles + (SELECT count(*) FROM gone)",
    )
    .await;
    assert_eq!(dropped.cycles, 0);
    let (_, rest) = run(&*store, days(30), 125 * DAY).await;
    assert_eq!((rest.cycles, counts(&*store).await), (2, 3), "each is counted once");
    given.done().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_goes_while_its_decision_moves_is_counted() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = decided(&given).await;
    let dropped = beside(&given, "UPDATE sample_drops SET before_us = before_us + 1").await;
    assert_eq!((dropped.cycles, counts(&*store).await), (1, 1));
    given.done().await;
}

/// A backup reads samples for as long as it takes: nobody waits behind a server that wants to make partitions meanwhile.
#[tokio::test]
async fn whoever_reads_samples_is_not_waited_for() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = given.store();
    shop(&*store).await;
    store.make_room(at(0)).await.unwrap();
    let mut other = PgConnection::connect(&given.address()).await.unwrap();
    let mut reading = other.begin().await.unwrap();
    sqlx::query("SELECT count(*) FROM cycle_samples").execute(&mut *reading).await.unwrap();
    store.make_room(at(0)).await.expect("nothing is to be made");
    let refused = store.make_room(at(40 * DAY)).await;
    assert!(matches!(refused, Err(StoreError::Unavailable(_))), "{refused:?}");
    stored(&*store, &Run::nth(1)).await;
    reading.commit().await.unwrap();
    store.make_room(at(40 * DAY)).await.unwrap();
    other.close().await.unwrap();
    given.done().await;
}

/// Whoever reads a partition is in the way of dropping it, and neither of the next one nor of what it held going cycle by cycle.
#[tokio::test]
async fn postgres_deletes_from_a_partition_that_is_read() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = decided(&given).await;
    let mut other = PgConnection::connect(&given.address()).await.unwrap();
    let mut reading = other.begin().await.unwrap();
    sqlx::query("SELECT count(*) FROM cycle_samples_202601").execute(&mut *reading).await.unwrap();
    // February and March, which nobody reads, go all the same.
    for _ in 0..2 {
        assert_eq!(store.drop_partition(at(125 * DAY)).await.unwrap().cycles, 1);
    }
    let refused = store.drop_partition(at(125 * DAY)).await;
    assert!(matches!(refused, Err(StoreError::Unavailable(_))), "{refused:?}");
    assert_eq!((store.drop_some(10).await.unwrap().cycles, counts(&*store).await), (1, 3));
    reading.commit().await.unwrap();
    assert_eq!(run(&*store, days(30), 125 * DAY).await, (0, Dropped::default()), "it is empty");
    let gone = given.raw("SELECT 1 FROM cycle_samples_202601").await;
    assert!(gone.is_err(), "{gone:?}");
    other.close().await.unwrap();
    given.done().await;
}

/// Everybody who reads or writes asks for the table and then for its partitions. Who has the partition and asks for the table would
/// have them end in a deadlock.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_partition_is_asked_for_after_its_table() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = decided(&given).await;
    let mut other = PgConnection::connect(&given.address()).await.unwrap();
    let has_table = "SELECT EXISTS (SELECT 1 FROM pg_locks WHERE relation = 'cycle_samples'::regclass
                                        AND mode = 'AccessExclusiveLock' AND granted)";
    loop {
        let mut reading = other.begin().await.unwrap();
        sqlx::query("SELECT count(*) FROM cycle_samples_202601").execute(&mut *reading).await.unwrap();
        let step = dropping(&store);
        let (mut waits, mut has) = (false, false);
        while !step.is_finished() && !waits {
            waits = sqlx::query_scalar(WAITS).fetch_one(&mut *reading).await.unwrap();
            has = sqlx::query_scalar(has_table).fetch_one(&mut *reading).await.unwrap();
        }
        reading.commit().await.unwrap();
        let outcome = step.await.unwrap();
        // A server that is very slow may give up before it was looked at.
        if waits {
            assert!(has, "it waits for the partition, and has not asked for the table yet");
            assert_eq!(outcome.unwrap().cycles, 1);
            break;
        }
    }
    other.close().await.unwrap();
    given.done().await;
}

mod packs {
    use super::super::given::{Given, Run, at, commit, engineer, machine, shop, stored};
    use super::{FOR_EVER, days, run};
    use feedwright_core::cycle::Samples;
    use feedwright_store::transfer::{back_up_sqlite, restore_to_sqlite};
    use feedwright_store::{Precondition, SampleRetention, SqliteOptions, Store, StoreError};

    const NOW: i64 = 1_000 * super::DAY;

    /// Two machines whose cycles come in the same groups; of one samples are kept for a day, of the other for ever.
    async fn two_machines(store: &dyn Store) {
        shop(store).await;
        store.put_machine(machine("M2"), Precondition::Unstated, &engineer(), at(0)).await.unwrap();
        let day = SampleRetention { days: Some(1), bytes: None };
        store
            .put_retention(&"M1".try_into().unwrap(), day, Precondition::Absent, &engineer(), at(0))
            .await
            .unwrap();
        for n in 0..20 {
            let both = [Run::nth(n), Run { machine: "M2", load: 20.0, ..Run::nth(n) }];
            let pair = Run { machine: "M2", id: format!("d{n:05}"), load: 40.0, ..Run::nth(n) };
            for outcome in commit(store, &[both.as_slice(), &[pair]].concat()).await {
                outcome.unwrap();
            }
        }
    }

    /// Groups that come at once would share their packs.
    async fn each_group_alone() -> Given {
        Given::sqlite_with(SqliteOptions { alone: false, ..SqliteOptions::default() }).await
    }

    async fn samples_of(store: &dyn Store, machine: &str, cycle: &str) -> Option<Samples> {
        let (machine, cycle) = (machine.try_into().unwrap(), cycle.try_into().unwrap());
        store.cycle_samples(&machine, &cycle).await.unwrap()
    }

    async fn packs(given: &Given) -> (i64, i64) {
        let packs = given.numbers("SELECT COUNT(*) FROM sample_packs").await[0];
        let bytes = given.numbers("SELECT COALESCE(SUM(length(blocks)), 0) FROM sample_packs").await[0];
        (packs, bytes)
    }

    #[tokio::test]
    async fn what_is_dropped_goes_out_of_its_packs_and_nothing_else_does() {
        let given = each_group_alone().await;
        let store = given.store();
        let store = &*store;
        two_machines(store).await;
        let (all, before) = packs(&given).await;
        assert_eq!(all, 20, "one for each group");
        let mut kept = Vec::new();
        for n in 0..20 {
            for cycle in [format!("c{n:05}"), format!("d{n:05}")] {
                let samples = samples_of(store, "M2", &cycle).await.unwrap();
                kept.push((cycle, samples));
            }
        }
        let (decided, dropped) = run(store, FOR_EVER, NOW).await;
        assert_eq!((decided, dropped.cycles), (1, 20));
        let (packs_left, after) = packs(&given).await;
        assert_eq!(packs_left, 20);
        assert_eq!(i64::try_from(dropped.bytes).unwrap(), before - after, "what is dropped takes no room");
        assert_eq!(given.numbers("SELECT COUNT(*) FROM sample_pack_drops").await, [0]);
        for (cycle, samples) in &kept {
            assert_eq!(samples_of(store, "M2", cycle).await.as_ref(), Some(samples), "{cycle}");
        }
        assert_eq!(samples_of(store, "M1", "c00003").await, None);
        let checked = store.check_cycles(None, 100).await.unwrap();
        assert_eq!((checked.dropped, checked.faults.as_slice()), (20, [].as_slice()));
        assert_eq!(store.check_tables().await.unwrap(), []);
        // The rest goes, and so do the packs; what comes then has its own.
        let forty = run(store, days(1), NOW).await.1.cycles;
        assert_eq!((forty, packs(&given).await), (40, (0, 0)));
        stored(store, &Run { seconds: NOW, ..Run::nth(50) }).await;
        assert!(samples_of(store, "M1", "c00050").await.is_some());
        assert_eq!(store.check_tables().await.unwrap(), []);
        given.done().await;
    }

    /// A run that breaks off between dropping and tidying leaves it to the next one, and is no fault.
    #[tokio::test]
    async fn what_is_left_in_packs_goes_at_the_next_run() {
        let given = each_group_alone().await;
        let store = given.store();
        let store = &*store;
        two_machines(store).await;
        let (all, before) = packs(&given).await;
        store.decide_drops(FOR_EVER, at(NOW)).await.unwrap();
        while store.drop_some(7).await.unwrap().cycles > 0 {}
        // That step found nothing to drop, and tidied: what is dropped from here on is not yet.
        assert!(packs(&given).await.1 < before);
        assert_eq!(
            given.raw("DELETE FROM cycle_samples WHERE machine_id = 'M2' AND cycle_id < 'd'").await.unwrap(),
            20
        );
        assert_eq!(given.numbers("SELECT COUNT(*) FROM sample_pack_drops").await, [20]);
        assert_eq!(store.check_tables().await.unwrap(), []);
        assert_eq!(run(store, FOR_EVER, NOW).await, (0, super::Dropped::default()));
        assert_eq!(given.numbers("SELECT COUNT(*) FROM sample_pack_drops").await, [0]);
        let (packs_left, after) = packs(&given).await;
        assert!(packs_left == all && after < before / 2, "{after} of {before}");
        for n in 0..20 {
            assert!(samples_of(store, "M2", &format!("d{n:05}")).await.is_some(), "{n}");
        }
        given.done().await;
    }

    #[tokio::test]
    async fn a_pack_that_is_damaged_is_told_of_each_of_its_cycles_and_one_of_none_by_its_number() {
        let given = each_group_alone().await;
        let store = given.store();
        let store = &*store;
        two_machines(store).await;
        // In the lengths of what is in it, and in what says that it is one.
        for (damage, cycle) in [
            ("substr(blocks, 1, 4) || x'01' || substr(blocks, 6)", "d00004"),
            ("x'47' || substr(blocks, 2)", "d00006"),
        ] {
            let damage = format!(
                "UPDATE sample_packs SET blocks = CAST({damage} AS BLOB)
                 WHERE pack = (SELECT pack FROM cycle_samples WHERE cycle_id = '{cycle}')"
            );
            assert_eq!(given.raw(sqlx::AssertSqlSafe(damage)).await.unwrap(), 1);
        }
        let checked = store.check_cycles(None, 100).await.unwrap();
        let keys: Vec<_> = checked.faults.iter().map(|fault| (fault.kind, fault.key.as_str())).collect();
        let of_both = ["M1/c00004", "M1/c00006", "M2/c00004", "M2/c00006", "M2/d00004", "M2/d00006"];
        assert_eq!(keys, of_both.map(|key| ("samples", key)));
        assert!(checked.faults[0].detail.contains("its checksum differs"), "{:?}", checked.faults[0]);
        let (machine, cycle) = ("M2".try_into().unwrap(), "d00004".try_into().unwrap());
        let read = store.cycle_samples(&machine, &cycle).await;
        assert!(matches!(read, Err(StoreError::Damaged { .. })), "{read:?}");
        // What cannot be read is neither written anew nor removed, though some of it is dropped.
        let kept = "SELECT length(blocks) FROM sample_packs
                    WHERE pack IN (SELECT pack FROM cycle_samples WHERE cycle_id IN ('d00004', 'd00006')) ORDER BY pack";
        let before = given.numbers(kept).await;
        run(store, FOR_EVER, NOW).await;
        assert_eq!((packs(&given).await.0, given.numbers(kept).await), (20, before));
        // Nor is it in the way of a backup.
        let folder = tempfile::tempdir().unwrap();
        let (backup, restored) = (folder.path().join("backup"), folder.path().join("restored.sqlite3"));
        back_up_sqlite(&given.file(), &backup, at(1)).await.unwrap();
        restore_to_sqlite(&backup, &restored).await.unwrap();
        assert_eq!(
            given.raw("INSERT INTO sample_packs (pack, blocks) VALUES (99, x'4642')").await.unwrap(),
            1
        );
        let strays = store.check_tables().await.unwrap();
        let strays: Vec<_> = strays.iter().map(|fault| (fault.kind, fault.key.as_str())).collect();
        assert_eq!(strays, [("samples", "pack 99")]);
        // A pack that is gone is a loss, and no retention's.
        let lost = "DELETE FROM sample_packs WHERE pack = (SELECT pack FROM cycle_samples WHERE cycle_id = 'd00009')";
        assert_eq!(given.raw(lost).await.unwrap(), 1);
        let checked = store.check_cycles(None, 100).await.unwrap();
        let lost = checked.faults.iter().filter(|fault| fault.detail.contains("it is not there"));
        assert_eq!(lost.count(), 2);
        given.done().await;
    }

    #[tokio::test]
    async fn groups_of_one_transaction_share_packs() {
        let later = std::time::Duration::from_secs(30);
        let options = SqliteOptions { alone: true, commit_after: later, ..SqliteOptions::default() };
        let given = Given::sqlite_with(options).await;
        let store = given.store();
        let store = &*store;
        two_machines(store).await;
        // Who reads has everything committed.
        assert!(samples_of(store, "M2", "d00019").await.is_some());
        let (all, _) = packs(&given).await;
        assert!(all < 20, "{all} packs of twenty groups");
        assert_eq!(given.numbers("SELECT COUNT(*) FROM cycle_samples").await, [60]);
        let checked = store.check_cycles(None, 100).await.unwrap();
        assert_eq!((checked.checked, checked.faults.as_slice()), (60, [].as_slice()));
        given.done().await;
    }
}

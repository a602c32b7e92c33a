//! The newest energies of a tool: what is kept of them is never other than what is stored.

use super::given::{Given, Run, at, commit, engineer, machine, shop, stored, stories, tool};
use feedwright_core::ids::ToolId;
use feedwright_core::recommend::RecommendSettings;
use feedwright_core::units::Timestamp;
use feedwright_store::{
    Committed, CycleFilter, CyclePoint, PointColumns, PostgresOptions, PostgresStore, Precondition,
    SqliteOptions, SqliteStore, Store,
};
use std::sync::Arc;

stories!(with tables:
    whatever_comes_between_the_answer_is_what_is_stored,
    whatever_comes_between_the_answer_of_one_who_is_alone_is_what_is_stored,
    a_group_of_which_one_fails_is_asked_about_again,
);

/// Another server on the same database.
async fn beside(given: &Given, alone: bool) -> Arc<dyn Store> {
    if given.is_postgres() {
        Arc::new(PostgresStore::open(&given.address(), PostgresOptions::default()).await.unwrap())
    } else {
        let options = SqliteOptions { alone, ..SqliteOptions::default() };
        Arc::new(SqliteStore::open(given.file(), options).await.unwrap())
    }
}

/// Asks as a page does, which may be answered from what is kept.
async fn asked(store: &dyn Store, tool: &ToolId, limit: u32) -> feedwright_store::LastPoints {
    let of_tool = CycleFilter { tool: Some(tool.clone()), ..CycleFilter::default() };
    store.last_points(&of_tool, PointColumns::Energy, limit).await.unwrap()
}

/// Asks in a way that is never answered from what is kept: with a range, of everything.
async fn read(store: &dyn Store, tool: &ToolId, limit: u32) -> Vec<CyclePoint> {
    let of_tool = CycleFilter {
        tool: Some(tool.clone()),
        from: Some(Timestamp::from_micros(i64::MIN)),
        ..CycleFilter::default()
    };
    store.last_points(&of_tool, PointColumns::Energy, limit).await.unwrap().to_vec()
}

/// Numbers that look like chance and are the same in every run.
pub(super) struct Chance(pub(super) u64);

impl Chance {
    pub(super) fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % bound
    }
}

async fn whatever_comes_between_the_answer_is_what_is_stored(given: &Given) {
    // The story's own store is alone on SQLite, and only looks after the tables.
    let (store, other) = (beside(given, false).await, beside(given, false).await);
    whatever_comes_between(given, &store, &other).await;
    store.close().await;
    other.close().await;
}

async fn whatever_comes_between_the_answer_of_one_who_is_alone_is_what_is_stored(given: &Given) {
    // The story's own store only looks after the tables.
    let alone = beside(given, true).await;
    whatever_comes_between(given, &alone, &alone).await;
    alone.close().await;
}

/// Cycles come through either store, and each is asked after each of them.
async fn whatever_comes_between(given: &Given, store: &Arc<dyn Store>, other: &Arc<dyn Store>) {
    const STEPS: u32 = 120;
    const LIMITS: [u32; 5] = [1, 7, 60, 500, 3000];
    shop(&**store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    let tools: [ToolId; 2] = ["T1", "T2"].map(|id| id.try_into().unwrap());
    let (mut chance, mut next, mut newest) = (Chance(7), 0, 1_000_000);
    for step in 0..STEPS {
        if step == STEPS / 2 {
            // What came before is counted at once.
            store.put_tool(tool("T2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
        }
        // Usually a few, now and then more than are read beside what is kept; now and then none at all.
        let many = [1, 1, 1, 2, 5, 0, 12, 160][usize::try_from(chance.below(8)).unwrap()];
        let group: Vec<Run> = (0..many)
            .map(|_| {
                next += 1;
                // Newer than all, at the same moment as another, or late.
                let seconds = match chance.below(8) {
                    0 => newest,
                    1 => newest - 1 - i64::try_from(chance.below(900)).unwrap(),
                    _ => newest + 1,
                };
                newest = newest.max(seconds);
                Run {
                    machine: if chance.below(4) == 0 { "M2" } else { "M1" },
                    tool: if chance.below(3) == 0 { "T2" } else { "T1" }.to_owned(),
                    seconds,
                    seq: (chance.below(2) == 0).then_some(u64::from(next)),
                    sampled: chance.below(2) == 0,
                    load: 20.0 + f64::from(next % 17),
                    ..Run::nth(next)
                }
            })
            .collect();
        let through = if chance.below(4) == 0 { other } else { store };
        for outcome in commit(&**through, &group).await {
            assert!(matches!(outcome, Ok(Committed::Stored(_))), "{outcome:?}");
        }
        if let Some(again) = group.first() {
            // The same once more changes nothing.
            let known = commit(&**store, std::slice::from_ref(again)).await;
            assert!(matches!(&known[..], [Ok(Committed::Known(_))]), "{known:?}");
        }
        for tool in &tools {
            let limit = LIMITS[usize::try_from(chance.below(5)).unwrap()];
            let wanted = read(&**store, tool, limit).await;
            assert_eq!(*asked(&**store, tool, limit).await, *wanted, "step {step}, {limit} of {tool}");
            assert_eq!(
                *asked(&**other, tool, limit).await,
                *wanted,
                "step {step}, beside, {limit} of {tool}"
            );
        }
    }
    // What is asked twice is read once, where one store is all there is to ask.
    for tool in &tools {
        let (first, second) = (asked(&**store, tool, 60).await, asked(&**store, tool, 60).await);
        assert_eq!(first.len(), 60);
        assert_eq!(std::ptr::eq(first.as_ptr(), second.as_ptr()), !given.is_postgres(), "{tool}");
    }
}

/// A group that is refused for one of its rows is committed row by row: the others are in the next answer.
async fn a_group_of_which_one_fails_is_asked_about_again(given: &Given) {
    let store = beside(given, true).await;
    shop(&*store).await;
    let tool: ToolId = "T1".try_into().unwrap();
    stored(&*store, &Run::nth(1)).await;
    for _ in 0..2 {
        assert_eq!(asked(&*store, &tool, 10).await.len(), 1);
    }
    let mut group: Vec<_> = (2..=5).map(|n| Run::nth(n).new_cycle()).collect();
    group[1].summary.coverage = 1.5;
    let outcomes = store.commit_cycles(group, at(1000), RecommendSettings::default()).await;
    assert_eq!(outcomes.iter().filter(|outcome| outcome.is_ok()).count(), 3);
    let points = asked(&*store, &tool, 10).await;
    let ids: Vec<_> = points.iter().map(|point| point.key.2.as_str()).collect();
    assert_eq!(ids, ["c00001", "c00002", "c00004", "c00005"]);
    store.close().await;
}

/// Who was told to be alone with a file believes it: what others store there is not looked for.
#[tokio::test]
async fn who_is_alone_does_not_ask_the_file() {
    let given = Given::sqlite_with(SqliteOptions::default()).await;
    let (alone, other) = (beside(&given, true).await, given.store());
    shop(&*alone).await;
    let tool: ToolId = "T1".try_into().unwrap();
    stored(&*alone, &Run::nth(1)).await;
    assert_eq!(asked(&*alone, &tool, 10).await.len(), 1);
    stored(&*other, &Run::nth(2)).await;
    assert_eq!(asked(&*alone, &tool, 10).await.len(), 1);
    // Its own next cycle has it look.
    stored(&*alone, &Run::nth(3)).await;
    assert_eq!(asked(&*alone, &tool, 10).await.len(), 3);
    alone.close().await;
    given.done().await;
}

/// Where what is counted is fewer than what is stored, nothing is kept by it.
#[tokio::test]
async fn a_damaged_count_keeps_nothing() {
    let given = Given::sqlite().await;
    let store = given.store();
    shop(&*store).await;
    let tool: ToolId = "T1".try_into().unwrap();
    for n in 1..=9 {
        stored(&*store, &Run::nth(n)).await;
    }
    given.raw("UPDATE tool_wear SET folded = 4").await.unwrap();
    assert_eq!(asked(&*store, &tool, 6).await.len(), 6);
    assert_eq!(asked(&*store, &tool, 20).await.len(), 9);
    given.done().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn readers_beside_a_writer_miss_nothing_that_was_acknowledged() {
    const CYCLES: u32 = 150;
    let given = Given::sqlite_with(SqliteOptions::default()).await;
    let store = beside(&given, true).await;
    shop(&*store).await;
    let tool: ToolId = "T1".try_into().unwrap();
    let acknowledged = Arc::new(std::sync::atomic::AtomicU32::new(0));
    let readers: Vec<_> = (0..3)
        .map(|_| {
            let (store, tool, acknowledged) = (Arc::clone(&store), tool.clone(), Arc::clone(&acknowledged));
            tokio::spawn(async move {
                loop {
                    let before = acknowledged.load(std::sync::atomic::Ordering::Acquire);
                    let points = asked(&*store, &tool, CYCLES).await;
                    assert!(points.len() >= before as usize, "{} of {before}", points.len());
                    for (n, point) in (1..).zip(points.iter()) {
                        assert_eq!(point.key.2.as_str(), format!("c{n:05}"), "none twice, none left out");
                    }
                    if before == CYCLES {
                        return;
                    }
                    // What is kept is answered without a pause in which the others had their turn.
                    tokio::task::yield_now().await;
                }
            })
        })
        .collect();
    for n in 1..=CYCLES {
        stored(&*store, &Run::nth(n)).await;
        acknowledged.store(n, std::sync::atomic::Ordering::Release);
    }
    for reader in readers {
        reader.await.unwrap();
    }
    store.close().await;
    given.done().await;
}

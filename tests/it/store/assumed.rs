//! A group that is written without a question before, because what it rests on is remembered: it leaves and is told what a
//! server that remembers nothing would have left and told.

use super::given::{
    Given, Run, at, commit, engineer, event, machine, mounted, operation, shop, stored, tool,
};
use super::recent::Chance;
use feedwright_core::machine::{FeedLimits, Machine};
use feedwright_core::tool::ToolEventKind;
use feedwright_store::{
    AlarmFilter, Committed, CycleAnswer, CycleFilter, Page, Precondition, Renewed, Repair, SqliteOptions,
    SqliteStore, Store, StoreError, StoreResult,
};

async fn opened(given: &Given) -> SqliteStore {
    SqliteStore::open(given.file(), SqliteOptions::default()).await.unwrap()
}

/// What machines are told, but for the ids of what they are advised, which are made of chance.
fn told(outcomes: Vec<StoreResult<Committed>>) -> Vec<String> {
    let text = |outcome: StoreResult<Committed>| match outcome.unwrap() {
        Committed::Stored(answer) => format!("stored {}", text_of(&answer)),
        Committed::Known(answer) => format!("known {}", text_of(&answer)),
        other => format!("{other:?}"),
    };
    outcomes.into_iter().map(text).collect()
}

fn text_of(answer: &CycleAnswer) -> String {
    let CycleAnswer { summary, received_at, registered, verdict, recommendation } = answer;
    let advice = &recommendation.recommendation;
    format!("{summary:?} {received_at:?} {registered} {verdict:?} {advice:?}")
}

/// Everything that cycles leave.
async fn left(given: &Given, store: &dyn Store) -> Vec<String> {
    let mut lines = Vec::new();
    for cycle in store.cycles(&CycleFilter::default(), Page { after: None, limit: 5000 }).await.unwrap() {
        let samples = store.cycle_samples(&cycle.cycle.machine, &cycle.cycle.id).await.unwrap();
        lines.push(format!("{cycle:?} {samples:?}"));
    }
    let alarms = store.alarms(&AlarmFilter::default(), Page { after: None, limit: 100 }).await.unwrap();
    lines.extend(alarms.iter().map(|alarm| format!("{alarm:?}")));
    lines.extend(given.wear_states().await.iter().map(|state| format!("{state:?}")));
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    for (table, column) in [
        ("recommendations", "tool_id"),
        ("advices", "body"),
        ("cycle_samples", "cycle_id"),
        ("tool_wear_checkpoints", "folded"),
    ] {
        let touch = format!("UPDATE {table} SET {column} = {column}");
        lines.push(format!("{table}: {}", given.raw(sqlx::AssertSqlSafe(touch)).await.unwrap()));
    }
    lines
}

/// Changes of what groups rest on, between them.
async fn change(store: &dyn Store, step: u32) {
    let who = engineer();
    match step {
        20 => drop(store.put_tool(tool("T2"), Precondition::Absent, &who, at(0)).await.unwrap()),
        35 => mounted(store, "T2", 500).await,
        50 => {
            let mut slower = operation("O1");
            slower.programmed_feed_mm_min = Some(90.0);
            store.put_operation(slower, Precondition::Version(1), &who, at(0)).await.unwrap();
            // Those that a busy machine did not come to at once: alarms follow when folds do.
            let mut after = None;
            while let Some(tool) = store.next_outdated_fold(after.as_ref()).await.unwrap() {
                assert_eq!(store.renew_fold(&tool, at(0)).await.unwrap(), Renewed::Whole);
                after = Some(tool);
            }
        }
        65 => {
            let changed = event(ToolEventKind::Changed, at(2_000));
            store.add_tool_event(&"T1".try_into().unwrap(), changed, &who, at(0)).await.unwrap();
        }
        80 => drop(store.put_machine(machine("M3"), Precondition::Absent, &who, at(0)).await.unwrap()),
        _ => {}
    }
}

#[tokio::test]
async fn who_remembers_tells_and_leaves_what_one_who_remembers_nothing_does() {
    let (remembering, forgetful) =
        (Given::sqlite().await, Given::sqlite_with(SqliteOptions::default()).await);
    let store = remembering.store();
    for store in [&store, &forgetful.store()] {
        shop(&**store).await;
        store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
        for place in 0..40 {
            store
                .put_tool(tool(&format!("W{place}")), Precondition::Absent, &engineer(), at(0))
                .await
                .unwrap();
        }
    }
    let (mut chance, mut before, mut newest) = (Chance(11), Vec::<Run>::new(), 1_000);
    for step in 0..90 {
        let fresh = opened(&forgetful).await;
        change(&*store, step).await;
        change(&fresh, step).await;
        let many = [1, 1, 2, 3, 5, 16, 17, 40][usize::try_from(chance.below(8)).unwrap()];
        // In some stretches everything is new and known by name, so that groups rest on what is remembered: of few tools,
        // or of one each, as in a shop.
        let calm = step / 15 % 2 == 0;
        let wide = step % 3 == 0;
        let mut group: Vec<Run> = Vec::new();
        for place in 0..many {
            let next = u32::try_from(before.len() + group.len()).unwrap() + 1;
            let again = before.get(usize::try_from(chance.below(64 * 8)).unwrap()).or(group.first());
            let kind = chance.below(12);
            match again.filter(|_| !calm && kind < 2) {
                // As it was sent before, or with another content.
                Some(again) if kind == 0 => group.push(again.clone()),
                Some(again) => group.push(Run { load: again.load + 1.0, ..again.clone() }),
                None => {
                    let late = i64::try_from(chance.below(300)).unwrap();
                    newest += 7;
                    let machines = if calm { ["M1", "M2", "M1", "M1"] } else { ["M1", "M1", "M2", "M3"] };
                    let tools = ["T1", "T1", "T2", "T3"];
                    group.push(Run {
                        machine: machines[usize::try_from(chance.below(4)).unwrap()],
                        tool: if wide {
                            format!("W{place}")
                        } else {
                            tools[usize::try_from(chance.below(4)).unwrap()].to_owned()
                        },
                        operation: if chance.below(5) == 0 { "O2" } else { "O1" },
                        seconds: if kind >= 10 && step % 4 == 1 { newest - late } else { newest },
                        sampled: wide || chance.below(4) != 0,
                        // Worn in time, and now and then far beyond what a load may be.
                        load: if !calm && chance.below(40) == 0 {
                            430.0
                        } else {
                            30.0 + f64::from(step) * 0.1
                        },
                        ..Run::nth(next)
                    });
                }
            }
        }
        let answers = told(commit(&*store, &group).await);
        assert_eq!(answers, told(commit(&fresh, &group).await), "step {step}");
        fresh.close().await;
        before.extend(group);
    }
    let (ours, theirs) = (left(&remembering, &*store).await, left(&forgetful, &*forgetful.store()).await);
    assert_eq!(ours.len(), theirs.len());
    for (ours, theirs) in ours.iter().zip(&theirs) {
        assert_eq!(ours, theirs);
    }
    assert!(before.len() > 500, "{} cycles", before.len());
    assert!(ours.len() > 500, "{} lines", ours.len());
    assert!(ours.iter().any(|line| line.contains("Worn")), "a tool was worn");
    remembering.done().await;
    forgetful.done().await;
}

/// Two servers must not share a file, but nothing is lost or counted twice where they do.
#[tokio::test]
async fn what_another_store_changed_is_noticed() {
    let given = Given::sqlite_with(SqliteOptions::default()).await;
    let (store, other) = (given.store(), opened(&given).await);
    shop(&*store).await;
    for n in 0..60 {
        let run = Run::nth(n);
        // The same through both, in turn first; then each one its own.
        let stores: [&dyn Store; 2] = if n % 2 == 0 { [&*store, &other] } else { [&other, &*store] };
        stored(stores[0], &run).await;
        let again = commit(stores[1], std::slice::from_ref(&run)).await;
        assert!(matches!(&again[..], [Ok(Committed::Known(_))]), "{again:?}");
        let else_ = commit(stores[1], &[Run { load: 50.0, ..run }]).await;
        assert!(matches!(&else_[..], [Ok(Committed::Conflict { .. })]), "{else_:?}");
        stored(stores[1], &Run { id: format!("d{n}"), seconds: i64::from(n) * 60 + 20, ..Run::nth(n) }).await;
    }
    // What is registered is held against the database too: of new limits only their generation tells.
    let mut n = 100;
    for most in [1500.0, 700.0] {
        for _ in 0..12 {
            n += 1;
            stored(&*store, &Run::nth(n)).await;
        }
        let limits = FeedLimits::new(1.0, most, 5.0, 200.0).unwrap();
        let limited = Machine { limits, ..machine("M1") };
        let version = other.machine(&limited.id).await.unwrap().unwrap().version;
        other.put_machine(limited, Precondition::Version(version), &engineer(), at(0)).await.unwrap();
        n += 1;
        let told = stored(&*store, &Run::nth(n)).await.recommendation.recommendation;
        assert_eq!(told.limits, limits);
    }
    // And the folds: of another's cycle of the same tool only their versions tell.
    for _ in 0..2 {
        for _ in 0..12 {
            n += 1;
            stored(&*store, &Run::nth(n)).await;
        }
        for store in [&other as &dyn Store, &*store] {
            n += 1;
            stored(store, &Run::nth(n)).await;
        }
        assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    }
    let folded: Vec<i64> = given.wear_states().await.iter().map(|(_, _, folded, _)| *folded).collect();
    assert_eq!(folded, [174]);
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    other.close().await;
    given.done().await;
}

/// What is written last of a group that rests on what is remembered fails: nothing of it is stored, nothing stays open, and
/// the next one is counted on what is stored.
#[tokio::test]
async fn a_group_that_fails_is_not_stored_and_the_next_one_asks() {
    let given = Given::sqlite().await;
    let store = given.store();
    shop(&*store).await;
    stored(&*store, &Run::nth(1)).await;
    stored(&*store, &Run::nth(2)).await;
    given.raw("ALTER TABLE recommendations RENAME TO recommendations_away").await.unwrap();
    let failed = commit(&*store, &[Run::nth(3)]).await;
    assert!(matches!(&failed[..], [Err(StoreError::Database(_))]), "{failed:?}");
    assert!(store.cycle(&"M1".try_into().unwrap(), &"c00003".try_into().unwrap()).await.unwrap().is_none());
    given.raw("ALTER TABLE recommendations_away RENAME TO recommendations").await.unwrap();
    stored(&*store, &Run::nth(3)).await;
    stored(&*store, &Run::nth(4)).await;
    stored(&*store, &Run::nth(5)).await;
    assert_eq!(given.wear_states().await[0].2, 5);
    given.done().await;
}

/// The writer of groups changes the folds that are remembered; who asks first writes them as if they might be new, which is
/// what this database forbids from some moment on.
#[tokio::test]
async fn a_group_that_is_remembered_is_written_without_asking() {
    let given = Given::sqlite_with(SqliteOptions::default()).await;
    let store = given.store();
    shop(&*store).await;
    stored(&*store, &Run::nth(1)).await;
    stored(&*store, &Run::nth(2)).await;
    let forbid = "CREATE TRIGGER asked BEFORE INSERT ON tool_wear BEGIN SELECT RAISE(ABORT, 'asked'); END";
    given.raw(forbid).await.unwrap();
    stored(&*store, &Run::nth(3)).await;
    let forgetful = opened(&given).await;
    let refused = commit(&forgetful, &[Run::nth(4)]).await;
    assert!(matches!(&refused[..], [Err(StoreError::Refused { .. })]), "{refused:?}");
    forgetful.close().await;
    stored(&*store, &Run::nth(4)).await;
    assert_eq!(given.wear_states().await[0].2, 4);
    given.raw("DROP TRIGGER asked").await.unwrap();
    given.done().await;
}

//! The fleet at a glance, and sessions of browsers.

use super::given::{Given, Run, at, commit, engineer, event, machine, mounted, operation, shop, stories};
use feedwright_core::tool::ToolEventKind;
use feedwright_core::wear::ToolState;
use feedwright_store::{Page, Precondition, Role, SessionRecord, Store, TokenRecord};
use std::sync::Arc;

stories!(
    the_fleet_tells_of_every_machine_its_newest_cycles_and_its_tool,
    a_glance_at_energies_is_of_this_life_and_each_over_what_it_is_compared_with,
    a_session_is_found_with_its_token_and_the_oldest_makes_room,
);

mod tables {
    super::stories!(with tables:
        the_alarms_of_a_machine_are_shown_however_many_others_are_open,
        a_verdict_for_which_much_has_to_be_folded_is_the_same,
    );
    use super::{
        a_verdict_for_which_much_has_to_be_folded_is_the_same,
        the_alarms_of_a_machine_are_shown_however_many_others_are_open,
    };
}

/// Of a tool that moves, without a state on the way: it is read where long reads are.
async fn a_verdict_for_which_much_has_to_be_folded_is_the_same(given: &Given) {
    let store = &*given.store();
    shop(store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(1)).await.unwrap();
    let run = |n: u32| Run { machine: ["M1", "M2"][n as usize % 2], sampled: false, ..Run::nth(n) };
    let runs: Vec<Run> = (1..=1200).map(run).collect();
    for group in runs.chunks(200) {
        commit(store, group).await.into_iter().for_each(|stored| drop(stored.unwrap()));
    }
    let m2 = "M2".try_into().unwrap();
    let told = async || {
        let rows = store.fleet(Page { after: None, limit: 10 }, 5).await.unwrap();
        (rows, store.fleet_machine(&m2, 5).await.unwrap())
    };
    let before = told().await;
    assert_eq!(before.0.len(), 2);
    assert_eq!(before.0[0].verdict.as_ref().unwrap().cycles, 1200);
    assert!(given.raw("DELETE FROM tool_checkpoints").await.unwrap() > 0);
    assert_eq!(format!("{:?}", told().await), format!("{before:?}"));
}

/// Those of a machine that were raised last, behind more than a list of all would hold.
async fn the_alarms_of_a_machine_are_shown_however_many_others_are_open(given: &Given) {
    let store = &*given.store();
    shop(store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(1)).await.unwrap();
    let alarms = async || -> Vec<usize> {
        let rows = store.fleet(Page { after: None, limit: 10 }, 5).await.unwrap();
        rows.iter().map(|row| row.alarms.len()).collect()
    };
    let raised = "INSERT INTO alarms (kind, machine_id, message, raised_at_us) VALUES ('machine_silent', 'M2', 'm', 1)";
    given.raw(raised).await.unwrap();
    assert_eq!(alarms().await, [0, 1]);
    let others = "INSERT INTO alarms (kind, machine_id, message, raised_at_us)
                  WITH RECURSIVE numbers (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM numbers WHERE n < 2500)
                  SELECT 'machine_silent', 'X' || n, 'm', n FROM numbers";
    assert_eq!(given.raw(others).await.unwrap(), 2500);
    given.raw("INSERT INTO alarms (kind, machine_id, message, raised_at_us) VALUES ('quarantine', 'M1', 'm', 1)").await.unwrap();
    assert_eq!(alarms().await, [1, 1]);
    let alone = store.fleet_machine(&"M1".try_into().unwrap(), 5).await.unwrap().unwrap();
    assert_eq!(alone.alarms.len(), 1);
}

async fn the_fleet_tells_of_every_machine_its_newest_cycles_and_its_tool(store: Arc<dyn Store>) {
    shop(&*store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(1)).await.unwrap();
    mounted(&*store, "T1", 0).await;
    let mut runs: Vec<Run> = (1..=12).map(Run::nth).collect();
    runs.swap(2, 11);
    commit(&*store, &runs).await.into_iter().for_each(|stored| drop(stored.unwrap()));

    let rows = store.fleet(Page { after: None, limit: 10 }, 5).await.unwrap();
    let ids: Vec<_> = rows.iter().map(|row| row.machine.value.id.as_str()).collect();
    assert_eq!(ids, ["M1", "M2"]);
    let busy = &rows[0];
    let verdict = store.verdict(&"T1".try_into().unwrap()).await.unwrap();
    assert_eq!(busy.verdict.as_ref(), Some(&verdict));
    assert_eq!(busy.recent.len(), 5);
    assert!(busy.recent.is_sorted_by(|a, b| a.facts.order > b.facts.order), "newest first");
    let newest = &busy.recent[0].facts;
    let last = store.cycle(&newest.order.machine, &newest.order.cycle).await.unwrap().unwrap();
    let best = last.summary.best_energy().map(|energy| (energy.basis, false, energy.total_joules));
    assert_eq!((newest.energy, newest.duration_ms), (best, last.summary.duration_ms));
    assert_eq!(newest.energy_scale, last.summary.energy_scale);
    assert!(busy.names.0.is_some() && busy.names.1.is_some(), "{:?}", busy.names);
    let quiet = &rows[1];
    assert_eq!((quiet.recent.len(), quiet.verdict.is_none(), quiet.alarms.len()), (0, true, 0));

    let second = store.fleet(Page { after: Some("M1".try_into().unwrap()), limit: 10 }, 5).await.unwrap();
    assert_eq!(second, rows[1..]);
    let one = store.fleet_machine(&"M1".try_into().unwrap(), 5).await.unwrap();
    assert_eq!(one.as_ref(), Some(&rows[0]));
    assert_eq!(store.fleet_machine(&"M9".try_into().unwrap(), 5).await.unwrap(), None);

    // An open alarm stands beside its machine until it is cleared.
    let worn: Vec<Run> = (20..=60).map(|n| Run { load: Run::nth(1).load * 1.13, ..Run::nth(n) }).collect();
    commit(&*store, &worn).await.into_iter().for_each(|stored| drop(stored.unwrap()));
    let row = store.fleet(Page { after: None, limit: 1 }, 1).await.unwrap().remove(0);
    let state = row.verdict.as_ref().map(|verdict| verdict.state);
    assert!(matches!(state, Some(ToolState::Worn | ToolState::Changed)), "{state:?}");
    assert_eq!(row.alarms.len(), 1, "{:?}", row.alarms);
    let changed = event(ToolEventKind::Changed, at(61 * 60));
    store.add_tool_event(&"T1".try_into().unwrap(), changed, &engineer(), at(9000)).await.unwrap();
    let row = store.fleet(Page { after: None, limit: 1 }, 1).await.unwrap().remove(0);
    assert_eq!(row.alarms, []);
}

async fn a_session_is_found_with_its_token_and_the_oldest_makes_room(store: Arc<dyn Store>) {
    let token = TokenRecord {
        id: "a".to_owned(),
        name: "tablet".to_owned(),
        hash: [1; 32],
        role: Role::Viewer,
        machine: None,
        created_at: at(1),
        revoked_at: None,
    };
    store.create_token(token.clone(), &engineer()).await.unwrap();
    let session = |n: u8, from: i64, until: i64| SessionRecord {
        hash: [n; 32],
        token: "a".to_owned(),
        created_at: at(from),
        expires_at: at(until),
    };
    let begin = async |session| store.begin_session(session, 2, &engineer()).await.unwrap();
    begin(session(1, 10, 100)).await;
    assert_eq!(store.session_by_hash(&[1; 32]).await.unwrap(), Some((session(1, 10, 100), token.clone())));
    assert_eq!(store.session_by_hash(&[9; 32]).await.unwrap(), None);
    begin(session(2, 20, 1000)).await;
    begin(session(3, 30, 1000)).await;
    assert_eq!(store.session_by_hash(&[1; 32]).await.unwrap(), None, "two are kept, the newest");
    assert!(store.session_by_hash(&[2; 32]).await.unwrap().is_some());
    assert!(
        store.begin_session(session(4, 40, 40), 2, &engineer()).await.is_err(),
        "it would be over at once"
    );
    begin(session(5, 2000, 3000)).await;
    assert_eq!(store.session_by_hash(&[3; 32]).await.unwrap(), None, "what is over is forgotten");

    let revoked = store.revoke_token("a", &engineer(), at(2001)).await.unwrap().unwrap();
    let found = store.session_by_hash(&[5; 32]).await.unwrap();
    assert_eq!(found, Some((session(5, 2000, 3000), revoked)), "who asks sees that the token is revoked");
    assert!(store.end_session(&[5; 32], &engineer(), at(2002)).await.unwrap());
    assert!(!store.end_session(&[5; 32], &engineer(), at(2003)).await.unwrap());
    assert_eq!(store.session_by_hash(&[5; 32]).await.unwrap(), None);
}

async fn a_glance_at_energies_is_of_this_life_and_each_over_what_it_is_compared_with(store: Arc<dyn Store>) {
    shop(&*store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(1)).await.unwrap();
    store.put_operation(operation("O2"), Precondition::Absent, &engineer(), at(1)).await.unwrap();
    mounted(&*store, "T1", 0).await;
    let ratios = async || {
        let row = store.fleet_machine(&"M1".try_into().unwrap(), 60).await.unwrap().unwrap();
        row.energy_ratios.iter().map(|ratio| (ratio * 100.0).round()).collect::<Vec<_>>()
    };
    let run = async |numbers: std::ops::Range<u32>, change: &dyn Fn(&mut Run)| {
        let runs: Vec<_> = numbers
            .map(|n| {
                let mut run = Run { sampled: false, ..Run::nth(n) };
                change(&mut run);
                run
            })
            .collect();
        commit(&*store, &runs).await.into_iter().for_each(|stored| drop(stored.unwrap()));
    };
    run(1..16, &|run| run.load = 45.0).await;
    assert_eq!(ratios().await, [100.0; 15]);
    // Reground, run elsewhere for longer than ever here, and back.
    let reground = event(ToolEventKind::Reground, at(16 * 60 - 1));
    store.add_tool_event(&"T1".try_into().unwrap(), reground, &engineer(), at(9000)).await.unwrap();
    run(16..40, &|run| run.machine = "M2").await;
    run(40..47, &|_| ()).await;
    assert_eq!(ratios().await, [100.0; 7], "cycles of the life before have other baselines");
    // Another operation in turn: each is compared with its own.
    run(47..67, &|run| {
        if run.seconds % 120 == 0 {
            (run.operation, run.load) = ("O2", 60.0);
        }
    })
    .await;
    assert_eq!(ratios().await, [100.0; 27]);
}

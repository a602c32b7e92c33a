//! The same story leaves the same store on both engines, to the bit.

use super::given::{
    Given, Run, at, commit, engineer, event, machine, mounted, operation, shop, tool, unpacked,
};
use feedwright_core::tool::ToolEventKind;
use feedwright_store::{AlarmFilter, Committed, CycleFilter, Page, Precondition, Store};

/// A shop's week in small: two machines, late and unregistered cycles, a worn tool, a change, a conflict.
async fn story(store: &dyn Store) -> Vec<String> {
    shop(store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(1)).await.unwrap();
    let mut told = Vec::new();
    let mut runs: Vec<Run> = (1..=90)
        .map(|n| Run {
            machine: if n % 7 == 0 { "M2" } else { "M1" },
            tool: if n % 9 == 0 { "T2".to_owned() } else { "T1".to_owned() },
            operation: if n % 13 == 0 { "O2" } else { "O1" },
            sampled: n % 5 != 0,
            load: 30.0 / 7.0 * 7.1 + f64::from(n) * 0.07,
            ..Run::nth(n)
        })
        .collect();
    runs.swap(3, 60);
    runs.swap(20, 21);
    runs.push(Run { load: 777.0, ..Run::nth(12) });
    for group in runs.chunks(8) {
        for outcome in commit(store, group).await {
            told.push(match outcome.unwrap() {
                Committed::Stored(answer) | Committed::Known(answer) => {
                    let mut advice = answer.recommendation.recommendation;
                    advice.reasons.sort();
                    format!("{:?} {:?} {:?} {advice:?}", answer.summary, answer.verdict, answer.registered)
                }
                other => format!("{other:?}"),
            });
        }
    }
    store.put_tool(tool("T2"), Precondition::Absent, &engineer(), at(9000)).await.unwrap();
    mounted(store, "T2", 0).await;
    store.put_operation(operation("O2"), Precondition::Absent, &engineer(), at(9001)).await.unwrap();
    let changed = event(ToolEventKind::Changed, at(80 * 60));
    let tool = "T1".try_into().unwrap();
    store.add_tool_event(&tool, changed, &engineer(), at(9002)).await.unwrap();
    let mistaken = event(ToolEventKind::Reground, at(40 * 60));
    let mistaken = store.add_tool_event(&tool, mistaken, &engineer(), at(9003)).await.unwrap().unwrap();
    store.revoke_tool_event(&tool, mistaken.id, &engineer(), at(9004)).await.unwrap().unwrap();
    told
}

async fn dump(given: &Given) -> Vec<String> {
    let store = given.store();
    let mut lines = story(&*store).await;
    let all = CycleFilter::default();
    for cycle in store.cycles(&all, Page { after: None, limit: 1000 }).await.unwrap() {
        let samples = store.cycle_samples(&cycle.cycle.machine, &cycle.cycle.id).await.unwrap();
        lines.push(format!("{cycle:?} {samples:?}"));
    }
    for tool in store.tools(Page { after: None, limit: 10 }).await.unwrap() {
        lines.push(format!("{:?}", store.verdict(&tool.value.id).await.unwrap()));
        let events = store.tool_events(&tool.value.id, Page { after: None, limit: 10 }).await.unwrap();
        lines.push(format!("{tool:?} {events:?}"));
    }
    let alarms = store.alarms(&AlarmFilter::default(), Page { after: None, limit: 100 }).await.unwrap();
    lines.extend(alarms.iter().map(|alarm| format!("{alarm:?}")));
    let audit = store.audit(Page { after: None, limit: 100 }).await.unwrap();
    lines.extend(audit.iter().map(|line| format!("{line:?}")));
    let states = given.wear_states().await.into_iter();
    let states = states.map(|(machine, tool, folded, state)| (machine, tool, folded, unpacked(&state)));
    lines.extend(states.map(|state| format!("{state:?}")));
    lines
}

#[tokio::test]
async fn both_engines_keep_the_same() {
    let Some(postgres) = Given::postgres().await else {
        return;
    };
    let sqlite = Given::sqlite().await;
    let (a, b) = (dump(&sqlite).await, dump(&postgres).await);
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(&b) {
        assert_eq!(a, b);
    }
    assert!(a.len() > 190, "the story is told: {} lines", a.len());
    sqlite.done().await;
    postgres.done().await;
}

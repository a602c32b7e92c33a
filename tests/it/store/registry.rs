//! Machines, tools and operations: versions, preconditions, pages and the audit of each change.

use super::given::{Run, at, engineer, machine, operation, shop, stored, stories, tool};
use feedwright_core::machine::{Calibration, FittedLine};
use feedwright_store::{Page, Precondition, PutOutcome, Store, StoreError, StoreResult};
use std::sync::Arc;
use std::time::Duration;

stories!(
    what_is_put_is_found_again,
    a_change_needs_the_version_it_is_based_on,
    what_changes_nothing_leaves_what_servers_remember,
    pages_go_by_bytes_not_by_language,
    calibrations_are_numbered,
    every_change_leaves_its_line,
    callers_that_hang_up_leave_nothing_half_done,
);

async fn what_is_put_is_found_again(store: Arc<dyn Store>) {
    let who = engineer();
    let (machine, tool, operation) = (machine("M1"), tool("T1"), operation("O1"));
    for expects in [Precondition::Absent, Precondition::Unstated, Precondition::Version(1)] {
        let created = expects == Precondition::Absent;
        let wanted = if created { PutOutcome::Created } else { PutOutcome::Unchanged(1) };
        assert_eq!(store.put_machine(machine.clone(), expects, &who, at(1)).await.unwrap(), wanted);
        assert_eq!(store.put_tool(tool.clone(), expects, &who, at(1)).await.unwrap(), wanted);
        assert_eq!(store.put_operation(operation.clone(), expects, &who, at(1)).await.unwrap(), wanted);
    }
    let found = store.machine(&machine.id).await.unwrap().unwrap();
    assert_eq!((found.value, found.version, found.updated_at), (machine.clone(), 1, at(1)));
    assert_eq!(store.tool(&tool.id).await.unwrap().unwrap().value, tool);
    assert_eq!(store.operation(&operation.id).await.unwrap().unwrap().value, operation);
    assert_eq!(store.machine(&"m1".try_into().unwrap()).await.unwrap(), None, "ids are case-sensitive");

    let around =
        store.surroundings(&machine.id, &operation.id, &"T9".try_into().unwrap()).await.unwrap().unwrap();
    assert_eq!((around.machine, around.operation), (machine.clone(), Some(operation.clone())));
    assert_eq!((around.tool, around.calibration), (None, None));
    assert_eq!(store.surroundings(&"M9".try_into().unwrap(), &operation.id, &tool.id).await.unwrap(), None);
}

async fn what_changes_nothing_leaves_what_servers_remember(store: Arc<dyn Store>) {
    let who = engineer();
    let (machine, tool, operation) = (machine("M1"), tool("T1"), operation("O1"));
    let generation_with = async |tool: &str| {
        let tool = tool.try_into().unwrap();
        let around = store.recent_surroundings(&machine.id, &operation.id, &tool, at(1)).await.unwrap();
        around.expect("it is registered").1
    };
    let generation = async || generation_with("T1").await;
    let put = async || {
        let expects = Precondition::Unstated;
        store.put_machine(machine.clone(), expects, &who, at(1)).await.unwrap();
        store.put_tool(tool.clone(), expects, &who, at(1)).await.unwrap();
        store.put_operation(operation.clone(), expects, &who, at(1)).await.unwrap()
    };
    assert_eq!(put().await, PutOutcome::Created);
    let before = generation().await;
    // As a script does that tells all it knows each morning.
    assert_eq!(put().await, PutOutcome::Unchanged(1));
    assert_eq!(store.revoke_tool_event(&tool.id, 9, &who, at(1)).await.unwrap(), None);
    assert_eq!(generation().await, before);
    // Whoever posts and whoever asks see the same one, what nobody asked for yet included.
    for (n, unknown) in [(1, "T7"), (2, "T8"), (3, "T9")] {
        stored(&*store, &Run::nth(n)).await;
        assert_eq!((generation_with(unknown).await, generation().await), (before, before), "{n}");
    }
    let renamed = feedwright_core::machine::Machine { name: "another".to_owned(), ..machine.clone() };
    store.put_machine(renamed, Precondition::Version(1), &who, at(2)).await.unwrap();
    assert!(generation().await > before);
}

async fn a_change_needs_the_version_it_is_based_on(store: Arc<dyn Store>) {
    let who = engineer();
    let renamed = |name: &str| feedwright_core::machine::Machine { name: name.to_owned(), ..machine("M1") };
    let put = async |name: &str, expects| -> StoreResult<PutOutcome> {
        store.put_machine(renamed(name), expects, &who, at(1)).await
    };
    let missing = put("a", Precondition::Version(1)).await;
    assert!(matches!(missing, Err(StoreError::VersionMismatch { current: 0 })), "{missing:?}");
    assert_eq!(put("a", Precondition::Unstated).await.unwrap(), PutOutcome::Created);
    let unnamed = put("b", Precondition::Unstated).await;
    assert!(matches!(unnamed, Err(StoreError::VersionRequired { current: 1 })), "{unnamed:?}");
    let exists = put("a", Precondition::Absent).await;
    assert!(matches!(exists, Err(StoreError::VersionMismatch { current: 1 })), "{exists:?}");
    assert_eq!(put("b", Precondition::Version(1)).await.unwrap(), PutOutcome::Changed(2));
    let stale = put("c", Precondition::Version(1)).await;
    assert!(matches!(stale, Err(StoreError::VersionMismatch { current: 2 })), "{stale:?}");
    assert_eq!(store.machine(&"M1".try_into().unwrap()).await.unwrap().unwrap().value, renamed("b"));
    let audit = store.audit(Page { after: None, limit: 10 }).await.unwrap();
    assert_eq!(audit.len(), 2, "what was refused changed nothing");
    assert_eq!(audit[1].detail, r#"{"changed":{"name":["a","b"]},"version":2}"#);
}

async fn pages_go_by_bytes_not_by_language(store: Arc<dyn Store>) {
    // A language's collation would put a before B and ignore the dash.
    let order = ["1", "A-b", "A.b", "AB", "B", "a", "a-b", "ab"];
    for id in ["ab", "B", "a", "A-b", "1", "AB", "a-b", "A.b"] {
        store.put_tool(tool(id), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    }
    let mut found: Vec<String> = Vec::new();
    loop {
        let after = found.last().map(|id| id.as_str().try_into().unwrap());
        let page = store.tools(Page { after, limit: 3 }).await.unwrap();
        if page.is_empty() {
            break;
        }
        found.extend(page.into_iter().map(|tool| tool.value.id.to_string()));
    }
    assert_eq!(found, order);
}

async fn calibrations_are_numbered(store: Arc<dyn Store>) {
    shop(&*store).await;
    let id = "M1".try_into().unwrap();
    let line = FittedLine {
        slope: 20.125,
        intercept: -0.1,
        min_percent: 5.0,
        max_percent: 45.0,
        r_squared: 0.99,
        residual_spread: 1.0 / 3.0,
    };
    let first = Calibration { version: 0, thrust: Some(line), torque: None };
    let second = Calibration { version: 0, thrust: None, torque: Some(line) };
    for (number, fitted) in [(1, &first), (2, &second)] {
        let added = store.add_calibration(&id, fitted.clone(), &engineer(), at(3)).await.unwrap().unwrap();
        assert_eq!(added, Calibration { version: number, ..fitted.clone() });
    }
    let all = store.calibrations(&id, Page { after: None, limit: 10 }).await.unwrap();
    assert_eq!(all.len(), 2);
    assert_eq!(all[1].calibration, Calibration { version: 2, ..second.clone() });
    assert_eq!((all[1].fitted_at, all[1].is_damaged), (at(3), false));
    assert_eq!(store.calibrations(&id, Page { after: Some(1), limit: 10 }).await.unwrap(), all[1..]);
    let unknown = store.add_calibration(&"M9".try_into().unwrap(), first, &engineer(), at(3)).await.unwrap();
    assert_eq!(unknown, None);
    let around =
        store.surroundings(&id, &"O1".try_into().unwrap(), &"T1".try_into().unwrap()).await.unwrap().unwrap();
    assert_eq!(around.calibration, Some(all[1].calibration.clone()));
}

async fn every_change_leaves_its_line(store: Arc<dyn Store>) {
    shop(&*store).await;
    let lines = store.audit(Page { after: None, limit: 100 }).await.unwrap();
    let told: Vec<(&str, &str)> =
        lines.iter().map(|line| (line.action.as_str(), line.subject.as_str())).collect();
    assert_eq!(
        told,
        [
            ("machine.put", "machine/M1"),
            ("operation.put", "operation/O1"),
            ("tool.put", "tool/T1"),
            ("tool.event", "tool/T1"),
        ]
    );
    assert!(lines.iter().all(|line| line.actor == "tok-eve"));
    let rest = store.audit(Page { after: Some(lines[1].id), limit: 1 }).await.unwrap();
    assert_eq!(rest, lines[2..3]);
    let back = store.newest_audit(Page { after: None, limit: 3 }).await.unwrap();
    assert_eq!(back, [lines[3].clone(), lines[2].clone(), lines[1].clone()]);
    let first = store.newest_audit(Page { after: Some(lines[1].id), limit: 3 }).await.unwrap();
    assert_eq!(first, lines[..1]);
}

async fn callers_that_hang_up_leave_nothing_half_done(store: Arc<dyn Store>) {
    // Each caller goes away a little later than the one before: before the change begins, in its midst, after it.
    let mut acknowledged = Vec::new();
    for n in 0..400_u64 {
        let id = format!("T{n:03}");
        let who = engineer();
        let put = store.put_tool(tool(&id), Precondition::Absent, &who, at(0));
        if let Ok(outcome) = tokio::time::timeout(Duration::from_micros(n * 20), put).await {
            assert_eq!(outcome.unwrap(), PutOutcome::Created);
            acknowledged.push(id);
        }
    }
    // Whoever comes next on the same connections is not inside someone else's transaction.
    for n in 400..430 {
        let id = format!("T{n}");
        store.put_tool(tool(&id), Precondition::Absent, &engineer(), at(1)).await.unwrap();
        acknowledged.push(id);
    }
    let kept = store.tools(Page { after: None, limit: 1000 }).await.unwrap();
    let audit = store.audit(Page { after: None, limit: 1000 }).await.unwrap();
    let names = |id: &String| kept.iter().any(|tool| tool.value.id.as_str() == id);
    assert!(acknowledged.iter().all(names), "everything acknowledged is there");
    assert!(acknowledged.len() < 430, "some did hang up");
    let lines: Vec<&str> = audit.iter().filter_map(|line| line.subject.strip_prefix("tool/")).collect();
    let late = kept.iter().filter(|tool| !lines.contains(&tool.value.id.as_str())).count();
    assert_eq!(late, 0, "no tool without its line in the audit");
}

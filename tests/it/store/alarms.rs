//! Alarms are raised and cleared with what they tell of.

use super::given::{Given, Run, at, engineer, event, machine, shop, stored, stories};
use feedwright_core::cycle::Flag;
use feedwright_core::ids::MachineId;
use feedwright_core::tool::ToolEventKind;
use feedwright_core::wear::ToolState;
use feedwright_store::{Alarm, AlarmFilter, AlarmKind, OpenSums, Page, Precondition, RowNumber, Store};
use std::sync::Arc;

stories!(
    a_worn_tool_alarms_until_it_is_changed,
    a_worn_tool_alarms_on_each_machine_that_runs_it,
    an_overload_waits_for_a_person,
    open_and_cleared_ones_are_listed_apart_in_the_order_of_their_numbers,
    what_open_ones_come_to_changes_with_each_of_them,
    a_group_says_whether_it_may_have_changed_alarms,
);

mod beside_many {
    use super::an_open_overload_is_found_however_many_others_are_open;
    use crate::store::given::stories;

    stories!(with tables: an_open_overload_is_found_however_many_others_are_open);
}

async fn alarms(store: &dyn Store, open: bool) -> Vec<Alarm> {
    let filter = AlarmFilter { open: Some(open), ..AlarmFilter::default() };
    store.alarms(&filter, Page { after: None, limit: 100 }).await.unwrap()
}

async fn a_worn_tool_alarms_until_it_is_changed(store: Arc<dyn Store>) {
    shop(&*store).await;
    let mut last = None;
    for n in 1..=60 {
        let load = 30.0 + 30.0 * 0.003 * f64::from(n);
        last = Some(stored(&*store, &Run { load, ..Run::nth(n) }).await);
    }
    assert_eq!(last.unwrap().verdict.state, ToolState::Worn);
    let open = alarms(&*store, true).await;
    let [alarm] = &open[..] else { panic!("one alarm for one worn tool: {open:?}") };
    assert_eq!(alarm.kind, AlarmKind::Worn);
    assert_eq!(alarm.tool.as_ref().unwrap().as_str(), "T1");
    assert!(alarm.message.starts_with("tool T1: "), "{}", alarm.message);

    let seen = store.acknowledge_alarm(alarm.id, &engineer(), at(5000)).await.unwrap().unwrap();
    assert_eq!(seen.acknowledged, Some(("tok-eve".to_owned(), at(5000))));
    assert_eq!(seen.cleared_at, None, "seen is not mended");
    let again = store.acknowledge_alarm(alarm.id, &engineer(), at(6000)).await.unwrap().unwrap();
    assert_eq!(again, seen);
    assert_eq!(store.acknowledge_alarm(alarm.id + 1000, &engineer(), at(0)).await.unwrap(), None);

    let changed = event(ToolEventKind::Changed, at(7000));
    store.add_tool_event(&"T1".try_into().unwrap(), changed, &engineer(), at(7000)).await.unwrap();
    assert_eq!(alarms(&*store, true).await, []);
    let cleared = alarms(&*store, false).await;
    assert_eq!(cleared.last().unwrap(), &Alarm { cleared_at: Some(at(7000)), ..seen });
}

async fn a_worn_tool_alarms_on_each_machine_that_runs_it(store: Arc<dyn Store>) {
    shop(&*store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    for n in 1..=60 {
        stored(&*store, &Run { load: 30.0 + 30.0 * 0.003 * f64::from(n), ..Run::nth(n) }).await;
    }
    let machines = async |open| -> Vec<String> {
        let alarms = alarms(&*store, open).await;
        alarms.iter().map(|alarm| alarm.machine.as_ref().unwrap().to_string()).collect()
    };
    assert_eq!(machines(true).await, ["M1"]);
    // It is put into another machine, which runs it in turn with the first: one alarm for each of them, and no more.
    for n in 61..=70 {
        let machine = if n % 3 == 0 { "M1" } else { "M2" };
        let answer = stored(&*store, &Run { machine, load: 36.0, ..Run::nth(n) }).await;
        assert_eq!(answer.verdict.state, ToolState::Worn);
        assert_eq!(machines(true).await, ["M1", "M2"]);
    }
    let changed = event(ToolEventKind::Changed, at(7000));
    store.add_tool_event(&"T1".try_into().unwrap(), changed, &engineer(), at(7000)).await.unwrap();
    assert_eq!(machines(true).await, [""; 0]);
    assert_eq!(machines(false).await, ["M1", "M2"]);
}

async fn an_overload_waits_for_a_person(store: Arc<dyn Store>) {
    shop(&*store).await;
    let answer = stored(&*store, &Run { load: 450.0, ..Run::nth(1) }).await;
    assert!(answer.summary.flags.contains(Flag::LoadOver400));
    stored(&*store, &Run { load: 460.0, ..Run::nth(2) }).await;
    stored(&*store, &Run::nth(3)).await;
    let overloads = |alarms: Vec<Alarm>| -> Vec<Alarm> {
        alarms.into_iter().filter(|alarm| alarm.kind == AlarmKind::Overload).collect()
    };
    let open = overloads(alarms(&*store, true).await);
    assert_eq!(open.len(), 1, "{open:?}");
    store.acknowledge_alarm(open[0].id, &engineer(), at(500)).await.unwrap();
    assert_eq!(overloads(alarms(&*store, true).await), []);
    stored(&*store, &Run { load: 450.0, ..Run::nth(4) }).await;
    assert_eq!(overloads(alarms(&*store, true).await).len(), 1, "a new one is a new alarm");
    let of_tool = AlarmFilter { tool: Some("T1".try_into().unwrap()), ..AlarmFilter::default() };
    let all = store.alarms(&of_tool, Page { after: None, limit: 100 }).await.unwrap();
    let rest = store.alarms(&of_tool, Page { after: Some(all[0].id), limit: 100 }).await.unwrap();
    assert_eq!(rest, all[1..]);
    let elsewhere = AlarmFilter { machine: Some("M2".try_into().unwrap()), ..AlarmFilter::default() };
    assert_eq!(store.alarms(&elsewhere, Page { after: None, limit: 100 }).await.unwrap(), []);
}

/// Alarms of tools that were thrown away long ago stand before it, and as many behind it.
async fn an_open_overload_is_found_however_many_others_are_open(given: &Given) {
    const WORN: &str = "WITH RECURSIVE series (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM series WHERE n < 2100)
        INSERT INTO alarms (kind, machine_id, tool_id, message, raised_at_us) SELECT 'worn', 'M1', 'W' || n, 'worn', n FROM series";
    let store = &*given.store();
    shop(store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    let (first, second): (MachineId, MachineId) = ("M1".try_into().unwrap(), "M2".try_into().unwrap());
    assert_eq!(given.raw(WORN).await.unwrap(), 2100);
    stored(store, &Run { machine: "M2", load: 450.0, ..Run::nth(1) }).await;
    assert_eq!(store.open_overloads(&first).await.unwrap(), [0; 0]);
    for (n, tool) in [(2, "T1"), (3, "T2")] {
        stored(store, &Run { tool: tool.to_owned(), load: 450.0, ..Run::nth(n) }).await;
    }
    given.raw("UPDATE alarms SET tool_id = 'V' || tool_id WHERE kind = 'worn'").await.unwrap();
    let open = store.open_overloads(&first).await.unwrap();
    let listed = store.alarms_numbered(&open).await.unwrap();
    let tools: Vec<&str> = listed.iter().map(|alarm| alarm.tool.as_ref().unwrap().as_str()).collect();
    assert_eq!(tools, ["T1", "T2"]);
    assert!(
        listed.iter().all(|alarm| alarm.kind == AlarmKind::Overload && alarm.machine == Some(first.clone()))
    );
    // The fleet tells so many of the oldest, and overloads beside them.
    let row = store.fleet_machine(&first, 5).await.unwrap().unwrap();
    assert_eq!(row.alarms.len(), 2002);
    assert_eq!(row.alarms[2000..], listed);
    store.acknowledge_alarm(open[0], &engineer(), at(500)).await.unwrap();
    assert_eq!(store.open_overloads(&first).await.unwrap(), open[1..]);
    assert_eq!(store.open_overloads(&second).await.unwrap().len(), 1);
}

/// What is said of them without listing them is held against the list.
async fn what_open_ones_come_to_changes_with_each_of_them(store: Arc<dyn Store>) {
    shop(&*store).await;
    assert_eq!(store.open_alarm_sums().await.unwrap(), (0, OpenSums::default()));
    let mut before = Vec::new();
    let mut check = async |store: &dyn Store| {
        let open = alarms(store, true).await;
        let of_open = |alarm: &Alarm| (alarm.id, alarm.acknowledged.is_some());
        let numbers: Vec<(RowNumber, bool)> = open.iter().map(of_open).collect();
        let (newest, sums) = store.open_alarm_sums().await.unwrap();
        assert_eq!(sums, OpenSums::of(numbers.iter().copied()));
        let all = store.alarms(&AlarmFilter::default(), Page { after: None, limit: 100 }).await.unwrap();
        assert_eq!(newest, all.last().unwrap().id);
        assert!(!before.contains(&sums), "{sums:?}");
        before.push(sums);
        let mut paged = Vec::new();
        while let [number] =
            store.open_alarm_numbers(Page { after: paged.last().map(|(id, _)| *id), limit: 1 }).await.unwrap()
                [..]
        {
            paged.push(number);
        }
        assert_eq!(paged, numbers);
        let ids: Vec<RowNumber> = open.iter().map(|alarm| alarm.id).collect();
        assert_eq!(store.alarms_numbered(&ids).await.unwrap(), open);
        ids
    };
    let mut open = Vec::new();
    for n in 1..=60 {
        let load = 30.0 + 30.0 * 0.003 * f64::from(n);
        stored(&*store, &Run { load, ..Run::nth(n) }).await;
    }
    for n in 61..=64 {
        stored(&*store, &Run { tool: format!("T{n}"), load: 450.0, ..Run::nth(n) }).await;
        open = check(&*store).await;
    }
    assert_eq!(open.len(), 5, "{open:?}");
    // The one of the worn tool stays open, overloads do not.
    for id in open {
        store.acknowledge_alarm(id, &engineer(), at(5000)).await.unwrap();
        check(&*store).await;
    }
    let none = [i64::MAX, -1];
    assert_eq!(store.alarms_numbered(&none).await.unwrap(), []);
    assert_eq!(store.alarms_numbered(&[]).await.unwrap(), []);
}

/// Whoever looks for alarms after each cycle does so in vain but for a few.
async fn a_group_says_whether_it_may_have_changed_alarms(store: Arc<dyn Store>) {
    shop(&*store).await;
    let at_first = store.alarm_changes();
    for n in 1..=40 {
        stored(&*store, &Run::nth(n)).await;
    }
    assert_eq!(store.alarm_changes(), at_first);
    stored(&*store, &Run { load: 450.0, ..Run::nth(41) }).await;
    assert_ne!(store.alarm_changes(), at_first);
}

/// Who asks for a machine's or a tool's alarms, as the fleet does for one machine, goes through no others, open or cleared.
#[tokio::test]
async fn alarms_of_a_machine_or_a_tool_are_read_alone() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = &*given.store();
    shop(store).await;
    let others = "INSERT INTO alarms (kind, machine_id, tool_id, message, raised_at_us, cleared_at_us)
                  SELECT 'overload', 'M' || n % 60, 'T' || n / 60 % 100, 'm', n, CASE WHEN n % 3 < 2 THEN n END
                  FROM generate_series(1, 6000) AS n";
    assert_eq!(given.raw(others).await.unwrap(), 6000);
    given.raw("ANALYZE alarms").await.unwrap();
    stored(store, &Run { load: 450.0, ..Run::nth(1) }).await;
    let (machine, tool): (MachineId, _) = ("M1".try_into().unwrap(), "T1".try_into().unwrap());
    let of_machine = AlarmFilter { open: Some(true), machine: Some(machine.clone()), tool: None };
    let of_tool = AlarmFilter { open: Some(true), machine: None, tool: Some(tool) };
    let of_both = AlarmFilter { machine: Some(machine.clone()), ..of_tool.clone() };
    for (filter, open) in [(of_machine.clone(), 1), (of_tool.clone(), 21), (of_both, 1)] {
        let page = Page { after: None, limit: 100 };
        assert_eq!(store.alarms(&filter, page).await.unwrap().len(), open, "{filter:?}");
    }
    for filter in [of_machine, of_tool].map(|filter| AlarmFilter { open: Some(false), ..filter }) {
        let page = Page { after: None, limit: 9 };
        assert_eq!(store.alarms(&filter, page).await.unwrap().len(), 9, "{filter:?}");
    }
    // A page of those that are open.
    let open = AlarmFilter { open: Some(true), ..AlarmFilter::default() };
    assert_eq!(store.alarms(&open, Page { after: Some(3000), limit: 9 }).await.unwrap()[0].id, 3002);
    assert_eq!(store.open_overloads(&machine).await.unwrap().len(), 1);
    let row = store.fleet_machine(&machine, 5).await.unwrap().unwrap();
    assert_eq!(row.alarms.len(), 1);
    let read = given.read_of("alarms").await;
    // 2,000 are open, and 6,000 were; a machine has 100 of them, a tool 60.
    assert!(read < 300, "{read}");
    given.done().await;
}

/// What each list has is held against that of all.
async fn open_and_cleared_ones_are_listed_apart_in_the_order_of_their_numbers(store: Arc<dyn Store>) {
    shop(&*store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(0)).await.unwrap();
    let pages = async |filter: &AlarmFilter, limit| {
        let (mut found, mut after) = (Vec::<Alarm>::new(), None);
        loop {
            let page = store.alarms(filter, Page { after, limit }).await.unwrap();
            let Some(last) = page.last() else { return found };
            after = Some(last.id);
            found.extend(page);
        }
    };
    for n in 1..=12 {
        let (machine, tool) = (["M1", "M2"][n as usize % 2], format!("T{}", n % 3));
        stored(&*store, &Run { machine, tool, load: 450.0, ..Run::nth(n) }).await;
        if n % 4 == 0 {
            let open = alarms(&*store, true).await;
            store.acknowledge_alarm(open[0].id, &engineer(), at(i64::from(n) * 60)).await.unwrap();
        }
    }
    let all = pages(&AlarmFilter::default(), 1000).await;
    let named =
        |name| AlarmFilter { machine: Some(MachineId::try_from(name).unwrap()), ..AlarmFilter::default() };
    let of_tool = AlarmFilter { tool: all[0].tool.clone(), ..named("M1") };
    for filter in [AlarmFilter::default(), named("M2"), of_tool, named("M3")] {
        for open in [true, false] {
            let is_meant = |alarm: &&Alarm| {
                alarm.cleared_at.is_none() == open
                    && filter.machine.as_ref().is_none_or(|machine| alarm.machine.as_ref() == Some(machine))
                    && filter.tool.as_ref().is_none_or(|tool| alarm.tool.as_ref() == Some(tool))
            };
            let expected: Vec<Alarm> = all.iter().filter(is_meant).cloned().collect();
            let filter = AlarmFilter { open: Some(open), ..filter.clone() };
            assert_eq!(pages(&filter, 1).await, expected, "{filter:?}");
            assert_eq!(pages(&filter, 1000).await, expected, "{filter:?}");
        }
    }
    let open = all.iter().filter(|alarm| alarm.cleared_at.is_none()).count();
    assert!(open > 1 && all.len() - open > 1, "{all:?}");
}

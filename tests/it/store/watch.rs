//! The watch: who is silent, how full the quarantine is, and what Grafana reads.

use super::given::{Given, Run, at, engineer, machine, new_cycle, operation, settle, shop, stored, stories};
use feedwright_core::cycle::{Channel, Cycle, CycleDraft, Samples, TimeBase};
use feedwright_core::ids::MachineId;
use feedwright_core::recommend::RecommendSettings;
use feedwright_core::units::Timestamp;
use feedwright_store::{
    Alarm, AlarmFilter, AlarmKind, Committed, OpenAlarms, Page, Precondition, QuarantineBounds,
    QuarantineEntry, Store, WatchSettings,
};
use sqlx::{Connection, PgConnection};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

stories!(
    a_machine_that_falls_silent_alarms_until_it_posts_again,
    a_machine_that_a_clock_which_was_ahead_heard_of_falls_silent_all_the_same,
    what_was_heard_before_a_clock_is_set_stays,
    a_quarantine_that_fills_up_alarms_before_it_is_full,
    usage_tells_sizes_and_connections
);

mod tables {
    super::stories!(with tables: a_round_goes_through_every_machine);
    use super::a_round_goes_through_every_machine;
}

fn id(text: &str) -> MachineId {
    text.try_into().unwrap()
}

fn settings() -> WatchSettings {
    WatchSettings {
        silent_after_ms: Some(600_000),
        silent_after_ms_by_machine: BTreeMap::from([(id("M2"), Some(60_000)), (id("M3"), None)]),
        quarantine: QuarantineBounds { entries: 10, bytes: 1_000_000 },
        quarantine_warning_ratio: 0.5,
    }
}

async fn open(store: &dyn Store) -> Vec<Alarm> {
    let filter = AlarmFilter { open: Some(true), ..AlarmFilter::default() };
    store.alarms(&filter, Page { after: None, limit: 100 }).await.unwrap()
}

/// Who is silent after a round at `now`, where machines were heard of at these times: how long ago that was is told, and of what
/// is said to be yet to come, that it was now.
async fn silent(store: &dyn Store, heard: &[(&str, Timestamp)], now: Timestamp) -> Vec<String> {
    let ago = |at: Timestamp| Duration::from_micros((now.micros() - at.micros()).try_into().unwrap_or(0));
    let heard = heard.iter().map(|&(machine, at)| (id(machine), ago(at))).collect();
    let round = store.watch(heard, &settings(), now).await.unwrap();
    let ids: Vec<_> = round.machines.iter().map(|contact| contact.machine.as_str()).collect();
    assert_eq!(ids, ["M1", "M2", "M3"], "every registered machine, by id");
    let silent = round.machines.into_iter().filter(|contact| contact.is_silent);
    silent.map(|contact| contact.machine.as_str().to_owned()).collect()
}

async fn a_machine_that_falls_silent_alarms_until_it_posts_again(store: Arc<dyn Store>) {
    shop(&*store).await;
    for name in ["M2", "M3"] {
        store.put_machine(machine(name), Precondition::Unstated, &engineer(), at(0)).await.unwrap();
    }
    let never: [String; 0] = [];
    assert_eq!(silent(&*store, &[], at(1_000_000)).await, never, "who never spoke is not silent");
    let all = [("M1", at(1_000_000)), ("M2", at(1_000_000)), ("M3", at(1_000_000))];
    assert_eq!(silent(&*store, &all, at(1_000_060)).await, never, "at its limit it is not beyond it");
    assert_eq!(silent(&*store, &[], at(1_000_061)).await, ["M2"], "it has a limit of its own");
    assert_eq!(silent(&*store, &[], at(1_000_601)).await, ["M1", "M2"], "M3 is never silent");
    let alarms = open(&*store).await;
    let told: Vec<_> = alarms.iter().map(|alarm| (alarm.kind, alarm.message.as_str())).collect();
    assert_eq!(
        told,
        [
            (AlarmKind::MachineSilent, "machine M2: no cycle for more than 1 min"),
            (AlarmKind::MachineSilent, "machine M1: no cycle for more than 10 min"),
        ]
    );
    assert_eq!((alarms[0].raised_at, alarms[0].machine.clone()), (at(1_000_061), Some(id("M2"))));
    assert_eq!(silent(&*store, &[], at(1_000_700)).await, ["M1", "M2"]);
    assert_eq!(open(&*store).await, alarms, "once, however many rounds are made");

    // What another replica heard earlier does not push the clock back.
    assert_eq!(silent(&*store, &[("M1", at(1_000_700))], at(1_000_710)).await, ["M2"]);
    assert_eq!(silent(&*store, &[("M1", at(1_000_100))], at(1_000_720)).await, ["M2"]);
    let round = store.watch(vec![], &settings(), at(1_000_720)).await.unwrap();
    assert_eq!(round.machines[0].last_cycle_at, Some(at(1_000_700)));
    assert_eq!(
        round.alarms,
        [OpenAlarms { kind: AlarmKind::MachineSilent, machine: Some(id("M2")), open: 1 }]
    );
    let mut off = settings();
    off.silent_after_ms_by_machine.insert(id("M2"), None);
    store.watch(vec![], &off, at(1_000_730)).await.unwrap();
    assert_eq!(open(&*store).await, [], "a machine that is not watched any more is not silent");
    stored(&*store, &Run::nth(1)).await;
}

/// However many machines there are, none is left out: neither is the last of them silent unnoticed, nor is it cleared too late.
async fn a_round_goes_through_every_machine(given: &Given) {
    let store = &*given.store();
    shop(store).await;
    let others = "INSERT INTO machines (machine_id, name, control, ipo_period_ms, spindle_reference, spindle_rated_power_watts,
                      spindle_base_speed_rpm, feed_drive_reference, feed_drive_rated_thrust_newtons, feed_min_mm_min,
                      feed_max_mm_min, override_min_percent, override_max_percent, version, updated_at_us)
                  WITH RECURSIVE numbers (n) AS (SELECT 10001 UNION ALL SELECT n + 1 FROM numbers WHERE n < 20500)
                  SELECT 'X' || n, name, control, ipo_period_ms, spindle_reference, spindle_rated_power_watts,
                      spindle_base_speed_rpm, feed_drive_reference, feed_drive_rated_thrust_newtons, feed_min_mm_min,
                      feed_max_mm_min, override_min_percent, override_max_percent, version, updated_at_us
                  FROM machines, numbers";
    assert_eq!(given.raw(others).await.unwrap(), 10_500);
    let round = async |heard: Vec<_>, seconds| store.watch(heard, &settings(), at(seconds)).await.unwrap();
    let last = id("X20500");
    let found = round(vec![(last.clone(), Duration::ZERO)], 1_000_000).await;
    assert_eq!(found.machines.len(), 10_501);
    assert!(found.machines.is_sorted_by(|a, b| a.machine < b.machine), "each once");
    let found = round(vec![], 1_000_601).await;
    assert_eq!(
        found.machines.last().map(|contact| (&contact.machine, contact.is_silent)),
        Some((&last, true))
    );
    assert_eq!(
        open(store).await.into_iter().map(|alarm| alarm.machine).collect::<Vec<_>>(),
        [Some(last.clone())]
    );
    round(vec![(last, Duration::ZERO)], 1_000_700).await;
    assert_eq!(open(store).await, []);
}

/// Its last contact stood at a time yet to come, up to which nothing was later.
async fn a_machine_that_a_clock_which_was_ahead_heard_of_falls_silent_all_the_same(store: Arc<dyn Store>) {
    shop(&*store).await;
    for name in ["M2", "M3"] {
        store.put_machine(machine(name), Precondition::Unstated, &engineer(), at(0)).await.unwrap();
    }
    let never: [String; 0] = [];
    let last = async |now| -> Vec<Option<Timestamp>> {
        let round = store.watch(vec![], &settings(), now).await.unwrap();
        round.machines.into_iter().map(|contact| contact.last_cycle_at).collect()
    };
    let ahead = 40 * 86_400;
    let heard = [("M1", at(ahead)), ("M2", at(ahead))];
    assert_eq!(silent(&*store, &heard, at(ahead)).await, never);
    // Servers are apart by some minutes: that is not brought back.
    assert_eq!(last(at(ahead - 600)).await, [Some(at(ahead)), Some(at(ahead)), None]);
    // The clock is right again: heard of now at the latest, and silent from then on.
    assert_eq!(last(at(1000)).await, [Some(at(1000)), Some(at(1000)), None]);
    assert_eq!(silent(&*store, &[], at(1060)).await, never);
    assert_eq!(silent(&*store, &[], at(1061)).await, ["M2"]);
    // It posts, and is heard of again; what was heard before the clock was put back is not of the future.
    let heard = [("M2", at(1090)), ("M1", at(ahead))];
    assert_eq!(silent(&*store, &heard, at(1100)).await, never);
    assert_eq!(last(at(1101)).await, [Some(at(1100)), Some(at(1090)), None]);
    assert_eq!(silent(&*store, &[], at(1701)).await, ["M1", "M2"]);
}

/// A computer without a clock of its own starts years ago, and the right time comes a minute later.
async fn what_was_heard_before_a_clock_is_set_stays(store: Arc<dyn Store>) {
    shop(&*store).await;
    for name in ["M2", "M3"] {
        store.put_machine(machine(name), Precondition::Unstated, &engineer(), at(0)).await.unwrap();
    }
    let never: [String; 0] = [];
    let started = at(-2200 * 86_400);
    assert_eq!(silent(&*store, &[("M1", at(0)), ("M2", at(0))], at(0)).await, never);
    assert_eq!(silent(&*store, &[("M2", started)], started).await, never);
    assert_eq!(silent(&*store, &[], at(60)).await, never, "both were heard of a minute ago");
    assert_eq!(open(&*store).await, []);
    assert_eq!(silent(&*store, &[], at(61)).await, ["M2"], "and fall silent as ever");
}

/// The clocks of two servers tell what they like: the database's counts.
#[tokio::test]
async fn servers_whose_clocks_are_apart_agree_on_who_is_silent() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = given.store();
    shop(&*store).await;
    for name in ["M2", "M3"] {
        store.put_machine(machine(name), Precondition::Unstated, &engineer(), at(0)).await.unwrap();
    }
    let (behind, ahead) = (given.server_of_its_own().await, given.server_of_its_own().await);
    let heard = |now| async move { [("M1", at(now))] };
    let never: [String; 0] = [];
    let go_by = async |seconds: u32| {
        let sql =
            format!("UPDATE machine_contacts SET last_cycle_at_us = last_cycle_at_us - {seconds}000000");
        given.raw(sqlx::AssertSqlSafe(sql)).await.unwrap();
    };
    let kept = async || given.numbers("SELECT alarm_id FROM alarms WHERE cleared_at_us IS NULL").await;
    // Who hears of it, with its clock; the limit is ten minutes.
    for (hears, now) in [(&behind, 0), (&ahead, 150), (&ahead, 10 * 366 * 86_400)] {
        assert_eq!(silent(hears, &heard(now).await, at(now)).await, never);
        let all = async || {
            let mut told = Vec::new();
            for (server, now) in [(&behind, 0), (&ahead, 150), (&behind, -7200), (&ahead, now)] {
                told.push((silent(server, &[], at(now)).await, kept().await));
            }
            told
        };
        assert_eq!(all().await, vec![(vec![], vec![]); 4]);
        go_by(540).await;
        assert_eq!(all().await, vec![(vec![], vec![]); 4], "it is heard of nine minutes ago");
        go_by(120).await;
        let told = all().await;
        assert_eq!(told[0].0, ["M1"]);
        assert_eq!(told[0].1.len(), 1, "{told:?}");
        assert_eq!(told, vec![told[0].clone(); 4], "by every clock, and by one alarm");
    }
    // Heard of nine minutes ago, by a server that could not tell it until now.
    let late = vec![(id("M1"), Duration::from_secs(540))];
    assert!(!behind.watch(late, &settings(), at(0)).await.unwrap().machines[0].is_silent);
    assert_eq!(silent(&ahead, &[], at(150)).await, never);
    go_by(120).await;
    assert_eq!(silent(&behind, &[], at(0)).await, ["M1"]);
    for store in [behind, ahead] {
        store.close().await;
    }
    given.done().await;
}

fn entry(n: usize) -> QuarantineEntry {
    QuarantineEntry {
        id: format!("q{n}"),
        machine: id("M1"),
        cycle: None,
        received_at: at(5),
        code: "out_of_range".to_owned(),
        problem: "{}".to_owned(),
        content_type: "application/json".to_owned(),
        settled: None,
        size: 1,
    }
}

async fn a_quarantine_that_fills_up_alarms_before_it_is_full(store: Arc<dyn Store>) {
    shop(&*store).await;
    let of_shop = async |now| -> Vec<String> {
        let round = store.watch(vec![], &settings(), now).await.unwrap();
        assert_eq!(round.quarantine.bounds, settings().quarantine);
        let alarms = open(&*store).await.into_iter().filter(|alarm| alarm.machine.is_none());
        alarms.map(|alarm| format!("{} {}", round.quarantine.entries, alarm.message)).collect()
    };
    let none: [String; 0] = [];
    for n in 0..4 {
        store.quarantine(entry(n), vec![u8::try_from(n).unwrap()], settings().quarantine).await.unwrap();
    }
    assert_eq!(of_shop(at(10)).await, none);
    store.quarantine(entry(4), vec![4], settings().quarantine).await.unwrap();
    let told = of_shop(at(20)).await;
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].starts_with("5 the quarantine is filled to 50 % (5 of 10 entries, "), "{told:?}");
    assert_eq!(of_shop(at(30)).await.len(), 1);
    for n in 0..2 {
        let id = format!("q{n}");
        assert!(settle(&*store, &id, "discarded", at(40)).await);
    }
    let of_machine = open(&*store).await.iter().filter(|alarm| alarm.machine.is_some()).count();
    assert_eq!(of_machine, 1, "the machine's own stays while entries of it wait");
    assert_eq!(of_shop(at(50)).await, none, "3 of 10 is below 0.8 of the half");
}

async fn usage_tells_sizes_and_connections(store: Arc<dyn Store>) {
    let usage = store.usage().await.unwrap();
    assert!(usage.bytes > 0, "{usage:?}");
    assert!(usage.connections_max >= 4, "{usage:?}");
    assert!(usage.connections_in_use + usage.connections_idle <= usage.connections_max, "{usage:?}");
}

/// The views hold what the cycle holds; SQLite has none.
#[tokio::test]
async fn the_views_for_dashboards_tell_what_is_stored() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = given.store();
    shop(&*store).await;
    let answer = stored(&*store, &Run::nth(1)).await;
    let energy = answer.summary.best_energy().unwrap();
    store.watch(vec![(id("M1"), Duration::from_secs(1))], &settings(), at(64)).await.unwrap();
    store.quarantine(entry(1), b"body".to_vec(), settings().quarantine).await.unwrap();
    let mut conn = PgConnection::connect(&given.address()).await.unwrap();
    let cycle: (String, f64, String, f64, f64) = sqlx::query_as(
        "SELECT tool_id, energy_joules, energy_basis, duration_seconds,
                extract(epoch FROM started_at)::DOUBLE PRECISION
         FROM grafana_cycles WHERE machine_id = 'M1'",
    )
    .fetch_one(&mut conn)
    .await
    .unwrap();
    let duration = answer.summary.duration_ms.unwrap() / 1e3;
    #[expect(clippy::cast_precision_loss, reason = "a time of this century")]
    let started = at(60).micros() as f64 / 1e6;
    let basis = energy.basis.as_str().to_owned();
    assert_eq!(cycle, ("T1".to_owned(), energy.total_joules, basis, duration, started));
    let machine: (i64, i64) =
        sqlx::query_as("SELECT last_cycle_at_us, open_alarms FROM grafana_machines WHERE machine_id = 'M1'")
            .fetch_one(&mut conn)
            .await
            .unwrap();
    assert_eq!(machine, (at(63).micros(), 1));
    let tool: (i64, String) =
        sqlx::query_as("SELECT cycles_folded, last_machine_id FROM grafana_tools WHERE tool_id = 'T1'")
            .fetch_one(&mut conn)
            .await
            .unwrap();
    assert_eq!(tool, (1, "M1".to_owned()));
    let waiting: i64 = sqlx::query_scalar("SELECT COUNT(*) FROM grafana_quarantine WHERE NOT is_settled")
        .fetch_one(&mut conn)
        .await
        .unwrap();
    assert_eq!(waiting, 1);
    conn.close().await.unwrap();
    drop(store);
    given.done().await;
}

/// The lines that a panel of a dashboard draws over everything that is stored, with how many values each has.
async fn lines(conn: &mut PgConnection, dashboard: &str, title: &str) -> BTreeMap<String, i64> {
    let path = format!("{}/../deploy/grafana/dashboards/{dashboard}.json", env!("CARGO_MANIFEST_DIR"));
    let dashboard: serde_json::Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    let panels = dashboard["panels"].as_array().unwrap();
    let panel = panels.iter().find(|panel| panel["title"] == title).expect("a panel of that title");
    let [target] = panel["targets"].as_array().unwrap().as_slice() else { panic!("one query: {panel}") };
    let sql = target["rawSql"].as_str().unwrap();
    let sql = sql
        .replace("${tool:sqlstring}", "'T1'")
        .replace("${machine:sqlstring}", "'M1'")
        .replace("$__unixEpochFrom()", &(at(0).micros() / 1_000_000).to_string())
        .replace("$__unixEpochTo()", &(at(100_000).micros() / 1_000_000).to_string());
    let sql = format!("SELECT metric, COUNT(*) FROM ({sql}) AS panel GROUP BY metric");
    let rows: Vec<(String, i64)> = sqlx::query_as(sqlx::AssertSqlSafe(sql)).fetch_all(conn).await.unwrap();
    rows.into_iter().collect()
}

/// A line of a dashboard has energies of one machine, operation, tool and basis, with idle power in them or out of them, as
/// those that `/v1/series` answers.
#[tokio::test]
async fn dashboards_draw_only_like_with_like() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = given.store();
    shop(&*store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(1)).await.unwrap();
    store.put_operation(operation("O2"), Precondition::Absent, &engineer(), at(1)).await.unwrap();
    // As a control that reports joules, one that samples its loads, and one that samples power, from contact on or from before.
    let power = |depth: Option<f64>| {
        let mut columns = vec![(Channel::SpindlePowerWatts, (0..20).map(|k| 900.0 + f64::from(k)).collect())];
        columns.extend(
            depth.map(|first| (Channel::DepthMm, (0..20).map(|k| first + 0.25 * f64::from(k)).collect())),
        );
        Some(Samples::new(TimeBase::Period { period_ms: 100.0 }, columns, 100).unwrap())
    };
    let mut group = Vec::new();
    let mut n = 0;
    for machine in ["M1", "M2"] {
        for operation in ["O1", "O2"] {
            for kind in [0, 1, 2, 3, 0, 1, 2, 3] {
                n += 1;
                let run = Run { machine, operation, sampled: kind != 0, ..Run::nth(n) };
                let draft = match kind {
                    2 => CycleDraft { samples: power(None), ..run.draft() },
                    3 => CycleDraft { samples: power(Some(-3.0)), ..run.draft() },
                    _ => run.draft(),
                };
                group.push(new_cycle(Cycle::new(draft).unwrap()));
            }
        }
    }
    for outcome in store.commit_cycles(group, at(100_000), RecommendSettings::default()).await {
        assert!(matches!(outcome, Ok(Committed::Stored(_))), "{outcome:?}");
    }
    let bases = ["reported", "rated_power", "measured_power", "measured_power without idle power"];
    let mut conn = PgConnection::connect(&given.address()).await.unwrap();
    let of_tool: BTreeMap<String, i64> = ["M1", "M2"]
        .iter()
        .flat_map(|machine| ["O1", "O2"].map(|operation| format!("{machine} · {operation}")))
        .flat_map(|of| bases.map(|basis| (format!("{of} · {basis}"), 2)))
        .collect();
    assert_eq!(lines(&mut conn, "tool-life", "Energy per cycle").await, of_tool);
    let of_machine: BTreeMap<String, i64> = ["O1", "O2"]
        .iter()
        .flat_map(|operation| bases.map(|basis| (format!("{operation} · T1 · {basis}"), 2)))
        .collect();
    assert_eq!(lines(&mut conn, "cycle-history", "Energy").await, of_machine);
    let by_both = ["M1 · O1", "M1 · O2", "M2 · O1", "M2 · O2"].map(|of| (of.to_owned(), 8));
    for title in ["Highest loads", "Duration"] {
        assert_eq!(lines(&mut conn, "tool-life", title).await, BTreeMap::from(by_both.clone()), "{title}");
    }
    conn.close().await.unwrap();
    drop(store);
    given.done().await;
}

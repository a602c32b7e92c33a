//! What is shown, and to whom.

use super::Served;
use super::reader::Reader;
use crate::store::given::Given;
use crate::stream::client::Machine;
use serde_json::{Value, json};
use sqlx::{Connection, PgConnection};
use std::time::{Duration, Instant};

#[tokio::test]
async fn a_cycle_and_its_alarm_are_shown_and_a_reader_comes_back_without_missing_one() {
    let served = Served::start(&[("live.heartbeat_ms", "50")]).await;
    served.with_a_shop().await;
    let mut reader = Reader::open(&served, "", None).await;
    let state = reader.next().await.unwrap();
    assert_eq!((state.name.as_str(), &state.data), ("state", &json!({"machines": [], "heartbeat_ms": 50})));

    let answer = served.post_cycle("c1", 20.0).await;
    let cycle = reader.next_of("cycle").await;
    for field in ["machine", "cycle_id", "received_at"] {
        assert_eq!(cycle.data[field], answer[field], "{field}");
    }
    assert_eq!(cycle.data["tool_state"], answer["wear"]["state"]);

    // A load above 400 % raises an overload, and acknowledging it clears it.
    served.post_cycle("c2", 500.0).await;
    let raised = reader.next_of("alarm").await;
    assert_eq!(
        (&raised.data["change"], &raised.data["alarm"]["kind"]),
        (&json!("raised"), &json!("overload"))
    );
    let (status, _) = served.send("POST", "/v1/machines/M1/acknowledge", None).await;
    assert_eq!(status, 200);
    let acknowledged = reader.next_of("alarm").await;
    let cleared = reader.next_of("alarm").await;
    let (_, listed) = served.send("GET", "/v1/alarms", None).await;
    assert_eq!(acknowledged.data, json!({"change": "acknowledged", "alarm": listed["items"][0]}));
    assert_eq!(cleared.data, json!({"change": "cleared", "alarm": listed["items"][0]}));
    assert!(listed["items"][0]["cleared_at"].is_string(), "{listed}");
    assert_eq!(&listed["items"][0]["id"], &raised.data["alarm"]["id"]);

    // From the first cycle on, everything again in the same order, by either way to ask.
    let last = cycle.id.unwrap();
    for (query, header) in [(String::new(), Some(last.as_str())), (format!("?after={last}"), None)] {
        let mut again = Reader::open(&served, &query, header).await;
        assert_eq!(again.next().await.unwrap().name, "state");
        assert_eq!(again.next_of("cycle").await.data["cycle_id"], "c2");
        assert_eq!(again.next_of("alarm").await, raised);
        assert_eq!(again.next_of("alarm").await, acknowledged);
        assert_eq!(again.next_of("alarm").await, cleared);
    }
    // Who names two events as the last one is told that something may be missing.
    let twice = served.client.get(served.url("/v1/live")).bearer_auth(&served.token);
    let start = format!("{}-0", last.split_once('-').unwrap().0);
    let twice = twice.header("last-event-id", &last).header("last-event-id", &start);
    let gap = Reader::of(twice).await.next_of("gap").await;
    assert_eq!(gap.data["reason"], "other_server");
    // Another machine's reader is told none of it.
    let mut other = Reader::open(&served, &format!("?machine=M2&after={last}"), None).await;
    assert_eq!(other.next().await.unwrap().name, "state");
    served.put("/v1/tools/T2", json!({"name": "FD M8", "tool_type": "friction-drill-7.3"})).await;
    assert_eq!(reader.next_of("changed").await.data, json!({"what": "tools"}));
    // Nothing is told of what was so already.
    served.put("/v1/tools/T2", json!({"name": "FD M8", "tool_type": "friction-drill-7.3"})).await;
    served.put("/v1/operations/O2", json!({"name": "Bushing M6", "process": "friction"})).await;
    assert_eq!(reader.next_of("changed").await.data, json!({"what": "operations"}));
    served.server.shutdown().await.unwrap();
    assert_eq!(other.next_of("changed").await.data["what"], "machines");
    assert_eq!(other.next_of("changed").await.data["what"], "tools");
    assert_eq!(other.next_of("changed").await.data["what"], "operations");
    assert_eq!(other.next().await, None, "a shutdown ends the view, and nothing of M1 was told");
}

#[tokio::test]
async fn what_is_not_kept_any_more_is_a_gap_and_so_is_another_servers_position() {
    let served = Served::start(&[("live.history_events", "2"), ("live.readers", "3")]).await;
    served.with_a_shop().await;
    let mut reader = Reader::open(&served, "", None).await;
    let start = reader.next().await.unwrap().id.unwrap();
    for n in 1..=5 {
        served.post_cycle(&format!("c{n}"), 20.0).await;
    }
    let mut late = Reader::open(&served, "", Some(&start)).await;
    assert_eq!(late.next().await.unwrap().name, "state");
    let gap = late.next().await.unwrap();
    assert_eq!((gap.name.as_str(), &gap.data), ("gap", &json!({"reason": "reader_too_slow", "missed": 3})));
    assert_eq!(late.next_of("cycle").await.data["cycle_id"], "c4");

    let mut stranger = Reader::open(&served, "", Some("0192f0c17e1d7cc398c4dc0c0c07398f-1")).await;
    let gap = stranger.next().await.unwrap();
    assert_eq!((gap.name.as_str(), &gap.data["reason"]), ("gap", &json!("other_server")));
    // A machine is no reader; and the fourth reader finds no place.
    let machine = served.machine_token("M1").await;
    let asked = served.client.get(served.url("/v1/live")).bearer_auth(machine).send().await.unwrap();
    assert_eq!(asked.status(), 403);
    let (status, problem) = served.send("GET", "/v1/live", None).await;
    assert_eq!((status, &problem["code"]), (503, &json!("too_many_readers")));
    drop(stranger);
    served.server.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_one_server_stores_is_shown_by_another_on_the_same_database() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let url = given.address();
    let settings = [("database.url", url.as_str())];
    let dir = tempfile::TempDir::new().unwrap();
    let here = Served::start_in(dir.path(), None, &settings).await;
    here.with_a_shop().await;
    let there = Served::start_in(dir.path(), Some(&here.token), &settings).await;
    let mut reader = Reader::open(&there, "", None).await;
    assert_eq!(reader.next().await.unwrap().name, "state");
    // Until the other one listens, what is told is lost: the first cycle that arrives proves that it does.
    let mut posted = 0;
    let shown = loop {
        posted += 1;
        here.post_cycle(&format!("c{posted}"), 500.0).await;
        let next = tokio::time::timeout(std::time::Duration::from_millis(500), reader.next_of("cycle")).await;
        if let Ok(shown) = next {
            break shown;
        }
        assert!(posted < 40, "nothing arrives");
    };
    assert_eq!(shown.data["machine"], "M1");
    let open = here.get("/v1/alarms?open=true").await;
    assert_eq!(open["items"].as_array().unwrap().len(), 1, "{open}");
    here.send("POST", "/v1/machines/M1/acknowledge", None).await;
    let told = reader.next_of("alarm").await;
    assert_eq!(told.data["alarm"]["kind"], "overload");
    here.put("/v1/tools/T2", json!({"name": "FD M8", "tool_type": "friction-drill-7.3"})).await;
    // What was acknowledged is a change as well, and may be told before its alarm or behind it.
    while reader.next_of("changed").await.data["what"] != "tools" {}
    there.server.shutdown().await.unwrap();
    here.server.shutdown().await.unwrap();
    given.done().await;
}

/// Two transactions raise one each, and the one whose number came first ends last.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_alarm_that_is_committed_behind_a_newer_one_is_told_too() {
    const RAISE: &str =
        "INSERT INTO alarms (kind, machine_id, message, raised_at_us) VALUES ('overload', $1, 'late', 1)";
    let Some(given) = Given::postgres().await else {
        return;
    };
    let url = given.address();
    let served = Served::start(&[("database.url", url.as_str())]).await;
    served.with_a_shop().await;
    let mut reader = Reader::open(&served, "", None).await;
    assert_eq!(reader.next().await.unwrap().name, "state");
    let mut slow = PgConnection::connect(&url).await.unwrap();
    let mut held = slow.begin().await.unwrap();
    sqlx::query(RAISE).bind("slow").execute(&mut *held).await.unwrap();
    let mut quick = PgConnection::connect(&url).await.unwrap();
    sqlx::query(RAISE).bind("quick").execute(&mut quick).await.unwrap();
    let told = reader.next_of("alarm").await.data;
    assert_eq!((&told["change"], &told["alarm"]["machine"]), (&json!("raised"), &json!("quick")), "{told}");
    held.commit().await.unwrap();
    let told = reader.next_of("alarm").await.data;
    assert_eq!((&told["change"], &told["alarm"]["machine"]), (&json!("raised"), &json!("slow")), "{told}");
    slow.close().await.unwrap();
    quick.close().await.unwrap();
    served.server.shutdown().await.unwrap();
    given.done().await;
}

/// Alarms of tools that nobody has: more than a page, and more than were ever followed.
const MANY_OPEN: &str = "INSERT INTO alarms (kind, machine_id, tool_id, message, raised_at_us)
     SELECT 'worn', 'M9', 'W' || n, 'worn', n FROM generate_series(1, 10500) AS n";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_told_as_cleared_is_cleared_however_many_alarms_are_open() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    given.raw(MANY_OPEN).await.unwrap();
    let url = given.address();
    let served = Served::start(&[("database.url", url.as_str())]).await;
    served.with_a_shop().await;
    let mut reader = Reader::open(&served, "", None).await;
    assert_eq!(reader.next().await.unwrap().name, "state");
    let mut told = async || {
        let Value::Object(mut data) = reader.next_of("alarm").await.data else { panic!("an object") };
        let alarm = data.remove("alarm").unwrap();
        (data["change"].as_str().unwrap().to_owned(), alarm)
    };
    served.post_cycle("c1", 500.0).await;
    let (change, overload) = told().await;
    assert_eq!((change.as_str(), &overload["kind"]), ("raised", &json!("overload")));
    // One is cleared of the first page, of the last one, and one comes and goes between two looks.
    for id in [17, 10_400] {
        let cleared =
            sqlx::AssertSqlSafe(format!("UPDATE alarms SET cleared_at_us = 7 WHERE alarm_id = {id}"));
        given.raw(cleared).await.unwrap();
        let (change, alarm) = told().await;
        assert_eq!((change.as_str(), &alarm["id"]), ("cleared", &json!(id)));
        assert!(alarm["cleared_at"].is_string(), "{alarm}");
    }
    let gone = "INSERT INTO alarms (kind, machine_id, message, raised_at_us, cleared_at_us) VALUES ('machine_silent', 'M9', 'gone', 1, 2)";
    given.raw(gone).await.unwrap();
    for expected in ["raised", "cleared"] {
        let (change, alarm) = told().await;
        assert_eq!((change.as_str(), &alarm["message"]), (expected, &json!("gone")));
    }
    let (status, _) = served.send("POST", "/v1/machines/M1/acknowledge", None).await;
    assert_eq!(status, 200);
    for expected in ["acknowledged", "cleared"] {
        let (change, alarm) = told().await;
        assert_eq!((change.as_str(), &alarm["id"]), (expected, &overload["id"]));
        assert!(alarm["cleared_at"].is_string(), "{alarm}");
    }
    served.server.shutdown().await.unwrap();
    given.done().await;
}

/// Cycles that change no alarm are posted for four seconds, in which twenty looks had their time.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn alarms_are_not_read_as_long_as_none_changes() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    given.raw(MANY_OPEN).await.unwrap();
    // No more than were ever followed.
    given.raw("UPDATE alarms SET cleared_at_us = 1 WHERE alarm_id > 9000").await.unwrap();
    let url = given.address();
    let served = Served::start(&[("database.url", url.as_str())]).await;
    served.with_a_shop().await;
    let mut reader = Reader::open(&served, "", None).await;
    served.post_cycle("c0", 500.0).await;
    assert_eq!(reader.next_of("alarm").await.data["change"], "raised");
    let begun = Instant::now();
    let mut posted = 0;
    while begun.elapsed() < Duration::from_secs(4) {
        posted += 1;
        served.post_cycle(&format!("c{posted}"), 20.0).await;
    }
    served.stop().await;
    let read = given.read_of("alarms").await;
    // All of them some times: when it starts, when one is raised, by a round of the watch.
    assert!(posted > 10 && read < 130_000, "{posted} cycles, {read} rows");
    given.done().await;
}

#[tokio::test]
async fn a_running_cycle_is_seen_as_it_runs() {
    let served = Served::start(&[("live.sample_interval_ms", "1"), ("stream.resume_ms", "50")]).await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    let mut reader = Reader::open(&served, "?machine=M1&samples=true", None).await;
    assert_eq!(reader.next().await.unwrap().name, "state");
    let mut machine = Machine::connect(&served, &token).await;
    assert_eq!(reader.next_of("machine").await.data["state"], "connected");
    machine.start("c1", json!({})).await;
    let running = reader.next_of("machine").await;
    assert_eq!((&running.data["state"], &running.data["cycle_id"]), (&json!("running"), &json!("c1")));
    let answer = machine.samples(0, 5).await;
    let sample = reader.next_of("sample").await;
    assert_eq!((sample.id, &sample.data["sample"]), (None, &json!(4)));
    assert_eq!(sample.data["override_percent"], answer["override_percent"]);
    assert_eq!(sample.data["depth_mm"], 0.08);
    // Who comes now learns that it runs.
    let mut late = Reader::open(&served, "", None).await;
    let state = late.next().await.unwrap();
    assert_eq!(state.data["machines"][0]["state"], "running");
    machine.end(5).await;
    assert_eq!(late.next_of("cycle").await.data["cycle_id"], "c1");
    assert_eq!(late.next_of("machine").await.data["state"], "connected");
    machine.start("c2", json!({})).await;
    machine.samples(0, 5).await;
    machine.break_off();
    assert_eq!(late.next_of("machine").await.data["state"], "running");
    assert_eq!(late.next_of("machine").await.data["state"], "interrupted");
    assert_eq!(late.next_of("machine").await.data["state"], "disconnected");
    let left = late.next_of("cycle").await;
    assert!(left.data["cycle_id"].as_str().unwrap().starts_with("c2.incomplete-"), "{left:?}");
    served.server.shutdown().await.unwrap();
}

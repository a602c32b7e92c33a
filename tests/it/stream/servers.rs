//! Several servers on one database, a server that is killed, and the description of all this.

use super::client::{Came, Machine, PATIENCE, codes};
use crate::live::Served;
use crate::store::given::Given;
use feedwright_server::clock::Clock;
use serde_json::json;
use sqlx::{Connection, PgConnection};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, Instant};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_server_at_a_time_serves_a_machine_and_the_next_one_asks_for_everything() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let url = given.address();
    let settings = [("database.url", url.as_str()), ("stream.lease_ms", "600")];
    let dir = tempfile::TempDir::new().unwrap();
    let here = Served::start_in(dir.path(), None, &settings).await;
    here.with_a_shop().await;
    let token = here.machine_token("M1").await;
    let refusing = [&settings[..], &[("stream.second", "refuse")]].concat();
    let there = Served::start_in(dir.path(), Some(&here.token), &settings).await;
    let strict = Served::start_in(dir.path(), Some(&here.token), &refusing).await;

    let mut first = Machine::connect(&here, &token).await;
    first.start("c1", json!({})).await;
    first.samples(0, 10).await;
    let refused = Machine::open(&strict, "M1", &token, "feedwright.v1", &[]).await;
    assert_eq!(refused.err(), Some((409, "stream_held".to_owned())));
    // The lease is prolonged for as long as the stream is open.
    for _ in 0..4 {
        tokio::time::sleep(Duration::from_millis(300)).await;
        assert_eq!(first.ask(json!({"type": "heartbeat"})).await["type"], "heartbeat");
    }
    let refused = Machine::open(&strict, "M1", &token, "feedwright.v1", &[]).await;
    assert_eq!(refused.err(), Some((409, "stream_held".to_owned())));

    let mut second = Machine::connect(&there, &token).await;
    assert_eq!(first.came().await, Came::Closed(Some(4001)), "it finds out when it prolongs its lease");
    let resumed = second.ask(json!({"type": "resume", "cycle_id": "c1"})).await;
    assert_eq!(resumed["restart_from"], 0);
    second.start("c1", json!({"resend": true, "sent_at": "2026-05-04T06:00:05Z"})).await;
    second.samples(0, 20).await;
    assert_eq!(second.end(20).await["status"], 201);
    let cycles = here.get("/v1/cycles?machine=M1").await;
    assert_eq!(cycles["items"].as_array().unwrap().len(), 1, "{cycles}");
    for served in [here, there, strict] {
        served.server.shutdown().await.unwrap();
    }
    given.done().await;
}

/// A clock that is so many seconds off.
fn off(seconds: Arc<AtomicI64>) -> Clock {
    let right = Clock::system();
    Clock::new(move || right.now().plus_millis(seconds.load(Ordering::Relaxed) * 1000))
}

/// Until a question to the tables is answered so.
async fn until(given: &Given, sql: &'static str, so: impl Fn(&[i64]) -> bool) {
    let begun = Instant::now();
    loop {
        let numbers = given.numbers(sql).await;
        if so(&numbers) {
            return;
        }
        assert!(begun.elapsed() < PATIENCE, "{sql}: {numbers:?}");
        tokio::task::yield_now().await;
    }
}

/// Each has its own clock, and five minutes lie between the two.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn servers_whose_clocks_are_apart_leave_a_machine_to_one_of_them() {
    const ENDS: &str = "SELECT expires_at_us FROM stream_leases";
    let Some(given) = Given::postgres().await else {
        return;
    };
    let url = given.address();
    let settings = [("database.url", url.as_str()), ("stream.lease_ms", "3000"), ("stream.second", "refuse")];
    let dir = tempfile::TempDir::new().unwrap();
    let clock = |seconds| off(Arc::new(AtomicI64::new(seconds)));
    let behind = Served::start_by(clock(-150), dir.path(), None, &settings).await;
    behind.with_a_shop().await;
    let token = behind.machine_token("M1").await;
    let ahead = Served::start_by(clock(150), dir.path(), Some(&behind.token), &settings).await;
    for (cycle, here, there) in [("c1", &behind, &ahead), ("c2", &ahead, &behind)] {
        let mut machine = Machine::connect(here, &token).await;
        let started = machine.start(cycle, json!({})).await;
        assert_eq!(started["type"], "started", "{started}");
        // Twice it is prolonged, and never is it the other's.
        for _ in 0..2 {
            let refused = Machine::open(there, "M1", &token, "feedwright.v1", &[]).await;
            assert_eq!(refused.err(), Some((409, "stream_held".to_owned())));
            let ends = given.numbers(ENDS).await[0];
            until(&given, ENDS, |now| now[0] > ends).await;
        }
        let answer = machine.samples(0, 10).await;
        assert!(!codes(&answer["reasons"]).contains(&"lease_unknown"), "{answer}");
        assert_eq!(machine.end(10).await["status"], 201);
        machine.break_off();
        until(&given, ENDS, |now| now == [0]).await;
    }
    // Whoever lost it leaves, and the one that has it keeps everybody out.
    let mut machine = Machine::connect(&ahead, &token).await;
    given
        .raw("UPDATE stream_leases SET holder = 'another', generation = generation + 1, expires_at_us = expires_at_us + 60000000")
        .await
        .unwrap();
    assert_eq!(machine.came().await, Came::Closed(Some(4001)), "it finds out when it prolongs its lease");
    for served in [&behind, &ahead] {
        let refused = Machine::open(served, "M1", &token, "feedwright.v1", &[]).await;
        assert_eq!(refused.err(), Some((409, "stream_held".to_owned())));
    }
    for served in [behind, ahead] {
        served.server.shutdown().await.unwrap();
    }
    given.done().await;
}

/// Its clock is put back by an hour while the database gives nothing: it would believe in its lease for an hour.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_server_whose_clock_is_set_believes_in_a_lease_no_longer_than_the_database() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let url = given.address();
    let dir = tempfile::TempDir::new().unwrap();
    let settings = [("database.url", url.as_str()), ("stream.lease_ms", "3000")];
    let seconds = Arc::new(AtomicI64::new(0));
    let served = Served::start_by(off(seconds.clone()), dir.path(), None, &settings).await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c1", json!({})).await;
    seconds.store(150, Ordering::Relaxed);
    let answer = machine.samples(0, 1).await;
    assert!(!codes(&answer["reasons"]).contains(&"lease_unknown"), "it still has it: {answer}");

    let mut held = PgConnection::connect(&url).await.unwrap();
    let mut nothing = held.begin().await.unwrap();
    sqlx::query("LOCK TABLE stream_leases IN ACCESS EXCLUSIVE MODE").execute(&mut *nothing).await.unwrap();
    seconds.store(-3600, Ordering::Relaxed);
    // A lease after the last one: what waits for the table prolongs a lease of before, which is over then too.
    const OVER: &str =
        "SELECT expires_at_us + 3000000 < EXTRACT(EPOCH FROM clock_timestamp()) * 1000000 FROM stream_leases";
    let (begun, mut first) = (Instant::now(), 1);
    let mut knows = false;
    loop {
        let is_over: bool = sqlx::query_scalar(OVER).fetch_one(&mut *nothing).await.unwrap();
        let answer = machine.samples(first, first + 1).await;
        first += 1;
        let unknown = codes(&answer["reasons"]).contains(&"lease_unknown");
        assert!(unknown || !knows, "once it is over it stays over: {answer}");
        knows = unknown;
        if is_over {
            assert!(knows, "the database's lease is over: {answer}");
            break;
        }
        assert!(begun.elapsed() < PATIENCE, "{answer}");
        // A cycle has so many samples and no more.
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    nothing.rollback().await.unwrap();
    held.close().await.unwrap();
    // Nobody has taken it meanwhile.
    let begun = Instant::now();
    loop {
        let answer = machine.samples(first, first + 1).await;
        first += 1;
        if !codes(&answer["reasons"]).contains(&"lease_unknown") {
            break;
        }
        assert!(begun.elapsed() < PATIENCE, "it is the same server's again: {answer}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    served.server.shutdown().await.unwrap();
    given.done().await;
}

/// Ids of the machine's cycles that are stored.
async fn stored(served: &Served) -> Vec<String> {
    let cycles = served.get("/v1/cycles?machine=M1").await;
    let ids = cycles["items"].as_array().unwrap().iter();
    ids.map(|cycle| cycle["cycle_id"].as_str().unwrap().to_owned()).collect()
}

/// One that goes on there with the cycle that it left here, and one that begins another.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cycle_that_is_left_for_another_server_is_kept_unless_it_comes_there() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let url = given.address();
    let settings =
        [("database.url", url.as_str()), ("stream.resume_ms", "1500"), ("stream.cycle_time_ms", "2000")];
    let dir = tempfile::TempDir::new().unwrap();
    let here = Served::start_in(dir.path(), None, &settings).await;
    here.with_a_shop().await;
    let token = here.machine_token("M1").await;
    let there = Served::start_in(dir.path(), Some(&here.token), &settings).await;
    for (left, next) in [("c1", "c1"), ("c2", "c3")] {
        let mut machine = Machine::connect(&here, &token).await;
        machine.start(left, json!({})).await;
        machine.samples(0, 10).await;
        machine.break_off();
        let mut machine = Machine::connect(&there, &token).await;
        machine.start(next, json!({"resend": left == next})).await;
        machine.samples(0, 20).await;
        assert_eq!(machine.end(20).await["status"], 201);
        machine.break_off();
    }
    let begun = Instant::now();
    let ids = loop {
        let ids = stored(&there).await;
        if ids.len() == 3 {
            break ids;
        }
        assert!(begun.elapsed() < PATIENCE, "{ids:?}");
        tokio::task::yield_now().await;
    };
    let incomplete: Vec<_> = ids.iter().filter(|id| id.contains(".incomplete-")).collect();
    assert!(matches!(incomplete[..], [id] if id.starts_with("c2.")), "{ids:?}");
    here.server.shutdown().await.unwrap();
    assert_eq!(stored(&there).await.len(), 3, "that of the first is none, also at the end");
    there.server.shutdown().await.unwrap();
    given.done().await;
}

/// Its clock is set by an hour in mid-cycle, either way: answers end when they end, and samples are as old as they are.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn answers_and_samples_go_by_the_time_that_passes_and_not_by_the_clock_that_is_set() {
    let dir = tempfile::TempDir::new().unwrap();
    let seconds = Arc::new(AtomicI64::new(0));
    let clock = off(seconds.clone());
    let served = Served::start_by(clock, dir.path(), None, &[("stream.heating_ms", "0")]).await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    for (cycle, set) in [("c1", -3600), ("c2", 3600)] {
        seconds.store(0, Ordering::Relaxed);
        let mut machine = Machine::connect(&served, &token).await;
        machine.start(cycle, json!({})).await;
        machine.samples(0, 10).await;
        seconds.store(set, Ordering::Relaxed);
        let answer = machine.samples(10, 20).await;
        assert_eq!((&answer["valid_for_ms"], &answer["quality"]), (&json!(500), &json!("good")), "{answer}");
        assert!(answer["override_percent"].as_f64().unwrap() > 100.0, "{answer}");
        // It ends while nothing new is sent.
        let begun = Instant::now();
        loop {
            let heartbeat = machine.ask(json!({"type": "heartbeat"})).await;
            let valid_for_ms = heartbeat["valid_for_ms"].as_i64().unwrap();
            assert!((0..=500).contains(&valid_for_ms), "{heartbeat}");
            if valid_for_ms == 0 {
                break;
            }
            assert!(begun.elapsed() < PATIENCE, "{heartbeat}");
        }
        machine.break_off();
    }
    served.server.shutdown().await.unwrap();
}

#[test]
fn the_checked_in_description_of_the_stream_is_fresh_and_whole() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../openapi/asyncapi.json");
    let made = feedwright_server::stream::asyncapi::json();
    assert!(
        std::fs::read_to_string(path).unwrap_or_default() == made,
        "openapi/asyncapi.json is stale: run `cargo run -- asyncapi > openapi/asyncapi.json`"
    );
    let described: serde_json::Value = serde_json::from_str(&made).unwrap();
    let mut references = Vec::new();
    collect(&described, &mut references);
    assert!(references.len() > 30);
    for reference in references {
        let pointer = reference.strip_prefix('#').unwrap();
        assert!(described.pointer(pointer).is_some(), "{reference} leads nowhere");
    }
}

fn collect(value: &serde_json::Value, into: &mut Vec<String>) {
    match value {
        serde_json::Value::Object(map) => {
            if let Some(reference) = map.get("$ref").and_then(|reference| reference.as_str()) {
                into.push(reference.to_owned());
            }
            map.values().for_each(|value| collect(value, into));
        }
        serde_json::Value::Array(items) => items.iter().for_each(|value| collect(value, into)),
        _ => {}
    }
}

//! Several servers on one database, a server that is killed, and the description of all this.

use super::client::{Came, Machine};
use crate::live::Served;
use crate::store::given::Given;
use serde_json::json;

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
        tokio::time::sleep(std::time::Duration::from_millis(300)).await;
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

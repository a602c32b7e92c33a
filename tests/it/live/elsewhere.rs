//! Machines whose streams other servers hold.

use super::Served;
use super::reader::Reader;
use crate::store::given::Given;
use crate::stream::client::Machine;
use serde_json::json;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_server_that_goes_down_tells_the_others_that_its_streams_have_ended() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let url = given.address();
    let settings = [("database.url", url.as_str())];
    let dir = tempfile::TempDir::new().unwrap();
    let here = Served::start_in(dir.path(), None, &settings).await;
    here.with_a_shop().await;
    let token = here.machine_token("M1").await;
    let there = Served::start_in(dir.path(), Some(&here.token), &settings).await;
    let mut reader = Reader::open(&there, "", None).await;
    let mut machine = Machine::connect(&here, &token).await;
    machine.start("c1", json!({})).await;
    while reader.next_of("machine").await.data["state"] != "running" {}
    here.server.shutdown().await.unwrap();
    while reader.next_of("machine").await.data["state"] != "disconnected" {}
    let state = Reader::open(&there, "", None).await.next().await.unwrap();
    assert_eq!(state.data["machines"], json!([]));
    there.server.shutdown().await.unwrap();
    given.done().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_server_told_that_was_killed_is_shown_as_long_as_its_lease_stands() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let url = given.address();
    let settings = [("database.url", url.as_str()), ("stream.lease_ms", "300")];
    let dir = tempfile::TempDir::new().unwrap();
    let served = Served::start_in(dir.path(), None, &settings).await;
    let mut reader = Reader::open(&served, "", None).await;
    // Another server holds the stream of M1, and that of M2 no more: it told so of neither.
    given
        .raw(
            "INSERT INTO stream_leases (machine_id, holder, generation, expires_at_us)
             SELECT 'M1', 'another', 1, CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000000 AS BIGINT) + 60000000",
        )
        .await
        .unwrap();
    let told = "SELECT pg_notify('feedwright_live', '{\"from\": \"another\", \"lost\": 0, \"events\": [
        {\"kind\": \"machine\", \"machine\": \"M1\", \"data\": {\"machine\": \"M1\", \"state\": \"running\"}},
        {\"kind\": \"machine\", \"machine\": \"M2\", \"data\": {\"machine\": \"M2\", \"state\": \"running\"}}]}')";
    // Until it is heard: nobody waits for a server to listen.
    let heard = async {
        loop {
            given.raw(told).await.unwrap();
            tokio::task::yield_now().await;
            let state = Reader::open(&served, "", None).await.next().await.unwrap();
            if state.data["machines"].as_array().unwrap().iter().any(|told| told["machine"] == "M1") {
                return;
            }
        }
    };
    tokio::time::timeout(crate::stream::client::PATIENCE, heard).await.expect("it listens");
    loop {
        let event = reader.next_of("machine").await;
        if event.data["state"] == "disconnected" {
            assert_eq!(event.data["machine"], "M2", "the lease of M1 stands");
            break;
        }
    }
    let state = Reader::open(&served, "", None).await.next().await.unwrap();
    assert_eq!(state.data["machines"], json!([{"machine": "M1", "state": "running"}]));
    given.raw("UPDATE stream_leases SET expires_at_us = 0").await.unwrap();
    loop {
        let event = reader.next_of("machine").await;
        if event.data["state"] == "disconnected" && event.data["machine"] == "M1" {
            break;
        }
    }
    served.server.shutdown().await.unwrap();
    given.done().await;
}

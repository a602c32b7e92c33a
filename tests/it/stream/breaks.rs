//! Connections that break, machines that come back, cycles that are left.

use super::client::{Came, Machine};
use crate::live::Served;
use serde_json::json;
use tokio_tungstenite::tungstenite::Message;

async fn shop(settings: &[(&str, &str)]) -> (Served, String) {
    let served = Served::start(settings).await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    (served, token)
}

#[tokio::test]
async fn a_machine_resumes_its_cycle_where_it_was() {
    let (served, token) = shop(&[]).await;
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c1", json!({})).await;
    machine.samples(0, 10).await;
    machine.samples(12, 14).await;
    machine.break_off();

    let mut machine = Machine::connect(&served, &token).await;
    let running = machine.start("c1", json!({})).await;
    assert_eq!((&running["code"], &running["status"]), (&json!("cycle_running"), &json!(409)));
    let resumed = machine.ask(json!({"type": "resume", "cycle_id": "c1"})).await;
    assert_eq!((&resumed["type"], &resumed["resume_from"]), (&json!("resumed"), &json!(10)), "{resumed}");
    assert_eq!(resumed["standing"]["cycle_id"], "c1");
    machine.samples(10, 20).await;
    let stored = machine.end(20).await;
    assert_eq!((&stored["status"], &stored["answer"]["summary"]["sample_count"]), (&json!(201), &json!(20)));
    // The answer was lost: resuming a cycle that is stored is asking for it again.
    machine.break_off();
    let mut machine = Machine::connect(&served, &token).await;
    let unknown = machine.ask(json!({"type": "resume", "cycle_id": "c1"})).await;
    assert_eq!(unknown["restart_from"], 0, "nothing runs: the slot was given up with the connection");
    machine.start("c1", json!({"resend": true, "sent_at": "2026-05-04T06:00:10Z"})).await;
    machine.samples(0, 20).await;
    let known = machine.end(20).await;
    assert_eq!((&known["status"], &known["answer"]["status"]), (&json!(200), &json!("known")));
    assert_eq!(served.get("/v1/cycles?machine=M1").await["items"].as_array().unwrap().len(), 1);
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn a_cycle_that_nobody_comes_back_to_is_stored_as_incomplete_and_does_not_count() {
    let (served, token) = shop(&[("stream.resume_ms", "100")]).await;
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c1", json!({})).await;
    machine.samples(0, 10).await;
    machine.break_off();
    let begun = std::time::Instant::now();
    let left = loop {
        let cycles = served.get("/v1/cycles?machine=M1").await;
        if let Some(cycle) = cycles["items"].as_array().unwrap().first() {
            break cycle.clone();
        }
        assert!(begun.elapsed().as_secs() < 20, "it is not stored");
        tokio::task::yield_now().await;
    };
    let id = left["cycle_id"].as_str().unwrap();
    assert!(id.starts_with("c1.incomplete-"), "{id}");
    let flags: Vec<_> =
        left["summary"]["flags"].as_array().unwrap().iter().map(|f| f.as_str().unwrap()).collect();
    assert!(flags.contains(&"incomplete") && flags.contains(&"cut_short"), "{flags:?}");
    let wear = served.get("/v1/tools/T1/wear").await;
    assert_eq!((&wear["counted"], &wear["excluded"]), (&json!(0), &json!({"aborted": 1})), "{wear}");
    // The whole cycle comes later, from the machine's buffer, under its own id.
    let (status, answer) =
        served.send("POST", "/v1/machines/M1/cycles", Some(super::client::posted("c1", 20))).await;
    assert_eq!((status, &answer["status"]), (201, &json!("stored")));

    // So is one that its machine leaves by starting another.
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c2", json!({})).await;
    machine.samples(0, 5).await;
    machine.start("c3", json!({})).await;
    machine.samples(0, 5).await;
    assert_eq!(machine.end(5).await["status"], 201);
    let ids = loop {
        let cycles = served.get("/v1/cycles?machine=M1").await;
        let items = cycles["items"].as_array().unwrap().clone();
        if items.len() == 4 {
            break items
                .iter()
                .map(|cycle| cycle["cycle_id"].as_str().unwrap().to_owned())
                .collect::<Vec<_>>();
        }
        assert!(begun.elapsed().as_secs() < 20, "{cycles}");
        tokio::task::yield_now().await;
    };
    assert!(
        ids.iter().any(|id| id.starts_with("c2.incomplete-")) && ids.contains(&"c3".to_owned()),
        "{ids:?}"
    );
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn a_stopping_server_closes_with_1001_and_its_successor_asks_for_everything_again() {
    let dir = tempfile::TempDir::new().unwrap();
    let served = Served::start_in(dir.path(), None, &[]).await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    let admin = served.token.clone();
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c1", json!({})).await;
    machine.samples(0, 10).await;
    let stopping = tokio::spawn(served.stop());
    assert_eq!(machine.came().await, Came::Closed(Some(1001)));
    machine.break_off();
    stopping.await.unwrap();

    let served = Served::start_in(dir.path(), Some(&admin), &[]).await;
    let mut machine = Machine::connect(&served, &token).await;
    let resumed = machine.ask(json!({"type": "resume", "cycle_id": "c1"})).await;
    assert_eq!((&resumed["restart_from"], resumed.get("resume_from")), (&json!(0), None));
    machine.start("c1", json!({"resend": true, "sent_at": "2026-05-04T06:00:05Z"})).await;
    let old = machine.samples(0, 10).await;
    assert_eq!(old["quality"], "stale");
    machine.samples(10, 20).await;
    assert_eq!(machine.end(20).await["status"], 201);
    assert_eq!(served.get("/v1/cycles?machine=M1").await["items"].as_array().unwrap().len(), 1);
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn a_second_stream_takes_over_or_is_refused_as_configured() {
    let (served, token) = shop(&[]).await;
    let mut first = Machine::connect(&served, &token).await;
    first.start("c1", json!({})).await;
    first.samples(0, 3).await;
    let mut second = Machine::connect(&served, &token).await;
    assert_eq!(first.came().await, Came::Closed(Some(4001)));
    let resumed = second.ask(json!({"type": "resume", "cycle_id": "c1"})).await;
    assert_eq!(resumed["resume_from"], 3);
    served.server.shutdown().await.unwrap();

    let (served, token) = shop(&[("stream.second", "refuse")]).await;
    let mut first = Machine::connect(&served, &token).await;
    let refused = Machine::open(&served, "M1", &token, "feedwright.v1", &[]).await;
    assert_eq!(refused.err(), Some((409, "stream_held".to_owned())));
    assert_eq!(first.ask(json!({"type": "heartbeat"})).await["type"], "heartbeat", "the first one goes on");
    first.send(Message::Close(None)).await;
    assert!(matches!(first.came().await, Came::Closed(_)));
    // Free as soon as the server has seen the end.
    let begun = std::time::Instant::now();
    while Machine::open(&served, "M1", &token, "feedwright.v1", &[]).await.is_err() {
        assert!(begun.elapsed().as_secs() < 20, "it stays taken");
    }
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn a_silent_machine_is_closed_and_a_living_one_is_not() {
    let (served, token) = shop(&[("stream.heartbeat_ms", "50"), ("stream.idle_ms", "400")]).await;
    // This one reads, and so its library answers the pings; it is never idle.
    let mut living = Machine::connect(&served, &token).await;
    let waited = tokio::time::timeout(std::time::Duration::from_millis(900), living.came()).await;
    assert!(waited.is_err(), "{waited:?}");
    assert_eq!(living.ask(json!({"type": "heartbeat"})).await["type"], "heartbeat");
    // And this one does not read, so that no ping is answered.
    tokio::time::sleep(std::time::Duration::from_millis(900)).await;
    assert_eq!(living.came().await, Came::Closed(Some(4008)));
    served.server.shutdown().await.unwrap();
}

//! Who gets in, and what is too much.

use super::client::{Came, Machine, frame, posted, samples};
use crate::live::Served;
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::Message;

#[tokio::test]
async fn only_a_machine_with_its_own_token_and_the_right_protocol_gets_in() {
    let served =
        Served::start(&[("stream.max_connections", "1"), ("stream.allowed_origins", "https://hmi.example")])
            .await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    let open =
        |machine: &'static str, protocol: &'static str, headers: &'static [(&'static str, &'static str)]| {
            Machine::open(&served, machine, &token, protocol, headers)
        };
    let refused = |status, code: &str| Some((status, code.to_owned()));
    let v1 = "feedwright.v1";
    assert_eq!(open("M2", v1, &[]).await.err(), refused(403, "other_machine"));
    assert_eq!(open("M1", "feedwright.v2", &[]).await.err(), refused(400, "subprotocol_required"));
    assert_eq!(
        open("M1", v1, &[("origin", "https://evil.example")]).await.err(),
        refused(403, "origin_not_allowed")
    );
    let unknown = Machine::open(&served, "M9", &served.token, v1, &[]).await;
    assert_eq!(unknown.err(), refused(404, "unknown_machine"));
    let nobody = Machine::open(&served, "M1", "fwt_nonsense", v1, &[]).await;
    assert_eq!(nobody.err().map(|refused| refused.0), Some(401));
    let (status, problem) = served.send("GET", "/v1/machines/M1/stream", None).await;
    assert_eq!((status, &problem["code"]), (400, &json!("websocket_required")));

    let inside = open("M1", v1, &[("origin", "https://hmi.example")])
        .await
        .unwrap_or_else(|_| panic!("an allowed page gets in"));
    served.with_a_machine("M2").await;
    let second = Machine::open(&served, "M2", &served.token, v1, &[]).await;
    assert_eq!(second.err(), refused(503, "too_many_streams"));
    drop(inside);
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn a_stream_ends_with_the_token_that_opened_it() {
    let served = Served::start(&[("stream.heartbeat_ms", "50"), ("stream.resume_ms", "60000")]).await;
    served.with_a_shop().await;
    let body = json!({"name": "M1", "role": "machine", "machine": "M1"});
    let (_, made) = served.send("POST", "/v1/tokens", Some(body)).await;
    let token = made["token"].as_str().unwrap();
    let mut machine = Machine::connect(&served, token).await;
    machine.start("c1", json!({})).await;
    machine.samples(0, 5).await;
    let other = served.machine_token("M1").await;
    let path = format!("/v1/tokens/{}", made["id"].as_str().unwrap());
    assert_eq!(served.send("DELETE", &path, None).await.0, 200);
    assert_eq!(machine.came().await, Came::Closed(Some(4401)));
    // With a good token it goes on where it was.
    let mut again = Machine::connect(&served, &other).await;
    let resumed = again.ask(json!({"type": "resume", "cycle_id": "c1"})).await;
    assert_eq!(resumed["resume_from"], 5, "{resumed}");
    again.samples(5, 10).await;
    assert_eq!(again.end(10).await["status"], 201);
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn a_stream_ends_with_the_session_that_opened_it() {
    let served = Served::start(&[("stream.heartbeat_ms", "50")]).await;
    served.with_a_shop().await;
    let session = served.url("/v1/session");
    let asked = served.client.post(&session).header("x-feedwright-page", "1");
    let begun = asked.json(&json!({"token": served.token})).send().await.unwrap();
    assert!(begun.status().is_success(), "{}", begun.status());
    let set = begun.headers()["set-cookie"].to_str().unwrap();
    let cookie = set.split(';').next().unwrap().to_owned();
    let mut machine = Machine::open(&served, "M1", "", "feedwright.v1", &[("cookie", cookie.as_str())])
        .await
        .unwrap_or_else(|refused| panic!("{refused:?}"));
    let ended = served.client.delete(&session).header("cookie", &cookie).header("x-feedwright-page", "1");
    assert_eq!(ended.send().await.unwrap().status(), 204);
    assert_eq!(machine.came().await, Came::Closed(Some(4401)));
    served.server.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_machine_that_never_pauses_is_not_deaf_to_its_end() {
    let served = Served::start(&[("stream.heartbeat_ms", "50")]).await;
    served.with_a_shop().await;
    let (_, made) = served
        .send("POST", "/v1/tokens", Some(json!({"name": "M1", "role": "machine", "machine": "M1"})))
        .await;
    let machine = Machine::connect(&served, made["token"].as_str().unwrap()).await;
    let flooding = tokio::spawn(machine.flood());
    let path = format!("/v1/tokens/{}", made["id"].as_str().unwrap());
    assert_eq!(served.send("DELETE", &path, None).await.0, 200);
    assert_eq!(flooding.await.unwrap(), Some(4401));
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn what_is_too_large_or_no_protocol_at_all_ends_the_stream_with_its_code() {
    let served =
        Served::start(&[("stream.message_bytes", "2000"), ("stream.samples_per_message", "8")]).await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c1", json!({})).await;
    let many = machine.ask(samples(0, 9)).await;
    assert_eq!(many["code"], "too_many_samples");
    machine.send(Message::Text("x".repeat(2001).into())).await;
    assert_eq!(machine.came().await, Came::Closed(Some(1009)));

    let mut babbling = Machine::connect(&served, &token).await;
    for n in 1..=100 {
        let garbage =
            if n % 2 == 0 { Message::Text("garbage".into()) } else { Message::Binary(vec![n; 5].into()) };
        babbling.send(garbage).await;
        let Came::Text(answer) = babbling.came().await else { panic!("each is answered") };
        assert_eq!((&answer["type"], &answer["re"]), (&json!("error"), &json!(null)));
        assert_eq!(answer["standing"]["override_percent"], 100.0, "the cycle it left runs on, neutral");
    }
    assert_eq!(babbling.came().await, Came::Closed(Some(4400)));
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn a_cycle_longer_or_larger_than_permitted_is_neutral_and_ends_incomplete() {
    let served = Served::start(&[("stream.samples_per_cycle", "20"), ("stream.heating_ms", "0")]).await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c1", json!({})).await;
    assert!(machine.samples(0, 20).await["override_percent"].as_f64().unwrap() > 100.0);
    let over = machine.samples(20, 25).await;
    assert_eq!(over["override_percent"], 100.0);
    assert!(super::client::codes(&over["reasons"]).contains(&"too_many_samples"));
    let stored = machine.end(25).await;
    assert_eq!((&stored["status"], &stored["answer"]["summary"]["sample_count"]), (&json!(201), &json!(20)));
    let flags = stored["answer"]["summary"]["flags"].to_string();
    assert!(flags.contains("incomplete") && flags.contains("cut_short"), "{flags}");
    // What was kept of it says nothing of the tool, and that is why nothing is known of it.
    let wear = served.get("/v1/tools/T1/wear").await;
    assert_eq!((&wear["state"], &wear["counted"]), (&json!("unknown"), &json!(0)), "{wear}");
    assert_eq!(wear["excluded"], json!({"cut_short": 1}));
    assert_eq!(wear["reasons"][0]["code"], "cut_short", "{wear}");
    let advice = &stored["answer"]["recommendation"];
    let told = advice["reasons"].as_array().unwrap();
    assert!(told.iter().any(|reason| reason["code"] == "cut_short"), "{advice}");
    assert_eq!(advice["override_percent"], 100.0);
    served.server.shutdown().await.unwrap();
}

/// No body says that it is a part only: taken out of quarantine under another id, it would count as a whole cycle.
#[tokio::test]
async fn a_part_of_a_cycle_is_one_after_its_quarantine_too() {
    let served = Served::start(&[("stream.samples_per_cycle", "20")]).await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c1", json!({})).await;
    machine.samples(0, 20).await;
    machine.samples(20, 25).await;
    // A counter that restarted: the id belongs to another cycle by the time that this one ends.
    let (status, _) = served.send("POST", "/v1/machines/M1/cycles", Some(posted("c1", 10))).await;
    assert_eq!(status, 201);
    let refused = machine.end(25).await;
    assert_eq!(refused["code"], "cycle_conflict", "{refused}");
    let entry = format!("/v1/quarantine/{}", refused["quarantine_id"].as_str().unwrap());
    let kept = served.get(&entry).await;
    assert_eq!(kept["problem"]["cut_short"], true, "{kept}");

    let mut body: Value = serde_json::from_str(kept["body"].as_str().unwrap()).unwrap();
    body["cycle_id"] = json!("boot2-c1");
    let settle = json!({"action": "reingest", "reason": "its counter restarted", "body": body.to_string()});
    let (status, settled) = served.send("POST", &entry, Some(settle)).await;
    assert_eq!(status, 200, "{settled}");
    let flags = settled["answer"]["summary"]["flags"].to_string();
    assert!(flags.contains("incomplete") && flags.contains("cut_short"), "{flags}");
    assert_eq!(served.get("/v1/tools/T1/wear").await["excluded"]["cut_short"], 1);
    served.server.shutdown().await.unwrap();
}

/// What an end is answered is about the cycle that its machine means: an answer to an earlier one would have it forget the later.
#[tokio::test]
async fn an_end_is_never_answered_by_the_cycle_before() {
    let served = Served::start(&[]).await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    let mut machine = Machine::connect(&served, &token).await;
    let code = |answer: &Value| answer["code"].as_str().map(str::to_owned);
    machine.start("c1", json!({})).await;
    machine.samples(0, 5).await;
    assert_eq!(machine.end(5).await["status"], 201);
    assert_eq!(machine.end(5).await["answer"]["cycle_id"], "c1", "its answer may have been lost");
    // Refused at its start.
    for change in [json!({"seq": u64::MAX}), json!({"law_version": "é".repeat(65)}), json!({"nonsense": 1})]
    {
        let refused = machine.start("c2", change).await;
        assert_eq!(refused["type"], "error", "{refused}");
        machine.samples(0, 3).await;
        assert_eq!(code(&machine.end(3).await).as_deref(), Some("no_cycle"));
        assert_eq!(machine.ask(json!({"type": "end", "cycle_id": "c1"})).await["type"], "stored");
    }
    assert_eq!(machine.start("c3", json!({"law_version": "é".repeat(64)})).await["type"], "started");
    machine.samples(0, 3).await;
    // Refused at its end: it is in quarantine, and nothing is stored.
    let refused = machine.ask(json!({"type": "end", "samples": 3, "outcome": "nonsense"})).await;
    assert!(refused["quarantine_id"].is_string(), "{refused}");
    assert_eq!(code(&machine.end(3).await).as_deref(), Some("no_cycle"));
    // Nor is a cycle that runs on the one that is meant, where another one was to begin.
    machine.start("c4", json!({})).await;
    machine.samples(0, 3).await;
    for change in [json!({"seq": u64::MAX}), json!({"nonsense": 1})] {
        assert_eq!(machine.start("c5", change).await["type"], "error");
        assert_eq!(code(&machine.samples(3, 5).await).as_deref(), Some("no_cycle"));
        machine.send(Message::Binary(frame(77, 3, 5).into())).await;
        let Came::Text(refused) = machine.came().await else { panic!("a refusal is text") };
        assert_eq!(code(&refused).as_deref(), Some("no_cycle"));
        assert_eq!(code(&machine.end(5).await).as_deref(), Some("no_cycle"));
        let resumed = machine.ask(json!({"type": "resume", "cycle_id": "c4"})).await;
        assert_eq!(resumed["resume_from"], 3, "{resumed}");
    }
    assert_eq!(machine.samples(3, 5).await["type"], "override");
    let stored = machine.end(5).await;
    assert_eq!(
        (&stored["answer"]["cycle_id"], &stored["answer"]["summary"]["sample_count"]),
        (&json!("c4"), &json!(5))
    );
    // Not known to this server: the machine is to send it again, and forgets that when it does not.
    assert_eq!(machine.ask(json!({"type": "resume", "cycle_id": "c9"})).await["restart_from"], 0);
    assert_eq!(machine.ask(json!({"type": "resume", "cycle_id": "k".repeat(50_000)})).await["type"], "error");
    assert_eq!(code(&machine.end(3).await).as_deref(), Some("no_cycle"));
    served.server.shutdown().await.unwrap();
}

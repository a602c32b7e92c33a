//! A cycle that names the feed profile that it runs.

use super::client::{Machine, codes};
use crate::live::Served;
use serde_json::{Value, json};

const HERE: &str = "/v1/feed-profiles/bush";

fn content(end_mm_min: f64) -> Value {
    json!({
        "operation": "O1", "tool_type": "friction-drill-7.3",
        "knots": [{"depth_mm": 0.0, "feed_mm_min": 100.0}, {"depth_mm": 10.0, "feed_mm_min": end_mm_min}],
        "sections": [{"kind": "heating", "to_mm": 1.0}, {"kind": "forming", "to_mm": 10.0}],
        "limits": {"feed_min_mm_min": 50.0, "feed_max_mm_min": 1000.0, "acceleration_mm_s2": 300.0,
                   "override_min_percent": 50.0, "override_max_percent": 125.0,
                   "spindle_load_set_percent": 40.0, "feed_drive_load_set_percent": 30.0},
        "wear": {"to_level": 1.07}
    })
}

/// Takes a step with the ETag of the moment.
async fn step(served: &Served, token: &str, step: &str, version: u32) {
    let asked = served.client.get(served.url(HERE)).bearer_auth(&served.token).send().await.unwrap();
    let tag = asked.headers()["etag"].clone();
    let answer = served
        .client
        .post(served.url(&format!("{HERE}/{step}")))
        .bearer_auth(token)
        .header("if-match", tag)
        .json(&json!({"version": version}))
        .send()
        .await
        .unwrap();
    assert_eq!(answer.status(), 200, "{step}: {}", answer.text().await.unwrap());
}

async fn bring_into_force(served: &Served, end_mm_min: f64, approver: &str) -> u32 {
    let draft = json!({"profile": "bush", "content": content(end_mm_min), "reason": "faster"});
    let (status, view) = served.send("POST", "/v1/feed-profiles", Some(draft)).await;
    assert_eq!(status, 201, "{view}");
    let version = u32::try_from(view["version"].as_u64().unwrap()).unwrap();
    step(served, &served.token, "shadow", version).await;
    step(served, approver, "approve", version).await;
    step(served, &served.token, "activate", version).await;
    version
}

#[tokio::test]
async fn what_is_changed_while_a_cycle_runs_ends_its_law() {
    let served = Served::start(&[("stream.heating_ms", "0")]).await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("a", json!({})).await;
    let risen = machine.samples(0, 10).await;
    assert!(risen["override_percent"].as_f64().unwrap() > 100.0, "{risen}");
    let changed = json!({"kind": "changed", "at": "2026-05-04T05:59:00Z", "reason": "story"});
    assert_eq!(served.send("POST", "/v1/tools/T1/events", Some(changed)).await.0, 201);
    outdated(&mut machine).await;
    assert_eq!(
        machine.start("b", json!({})).await["reasons"],
        json!([]),
        "the next one begins with what holds now"
    );
    assert!(machine.samples(0, 10).await["override_percent"].as_f64().unwrap() > 100.0);
    let path = served.url("/v1/machines/M1");
    let asked = served.client.get(&path).bearer_auth(&served.token).send().await.unwrap();
    let tag = asked.headers()["etag"].clone();
    let mut stands: Value = asked.json().await.unwrap();
    stands["limits"]["override_max_percent"] = json!(110.0);
    let members = ["name", "control", "ipo_period_ms", "spindle", "feed_drive", "limits"];
    let narrower: Value =
        members.map(|member| (member.to_owned(), stands[member].take())).into_iter().collect();
    let put = served.client.put(&path).bearer_auth(&served.token).header("if-match", tag).json(&narrower);
    let answer = put.send().await.unwrap();
    assert_eq!(answer.status(), 200, "{}", answer.text().await.unwrap());
    outdated(&mut machine).await;
    served.server.shutdown().await.unwrap();
}

/// Sends samples until they are answered that what the cycle was begun with holds no more.
async fn outdated(machine: &mut Machine) {
    for from in 10..410 {
        // Light loads, however long it takes: no overload.
        let light = json!({"type": "samples", "first": from, "depth_mm": [1.0],
                           "spindle_load_percent": [12.0], "feed_drive_load_percent": [6.0]});
        let last = machine.ask(light).await;
        if codes(&last["reasons"]).contains(&"changed_meanwhile") {
            assert!(last["override_percent"].as_f64().unwrap() <= 100.0, "{last}");
            return;
        }
        tokio::time::sleep(std::time::Duration::from_millis(25)).await;
    }
    panic!("nobody saw it");
}

#[tokio::test]
async fn only_the_active_version_is_believed_and_with_its_own_limits() {
    let served = Served::start(&[("stream.heating_ms", "0")]).await;
    served.with_a_shop().await;
    let mounted = json!({"kind": "mounted_new", "at": "2026-05-04T05:00:00Z"});
    assert_eq!(served.send("POST", "/v1/tools/T1/events", Some(mounted)).await.0, 201);
    let token = served.machine_token("M1").await;
    let (status, made) =
        served.send("POST", "/v1/tokens", Some(json!({"name": "second", "role": "approver"}))).await;
    assert_eq!(status, 201);
    let approver = made["token"].as_str().unwrap().to_owned();
    assert_eq!(bring_into_force(&served, 300.0, &approver).await, 1);
    assert_eq!(bring_into_force(&served, 320.0, &approver).await, 2);

    let mut machine = Machine::connect(&served, &token).await;
    let named = |version: u32| json!({"program": null, "profile": {"id": "bush", "version": version}});
    let started = machine.start("a", named(2)).await;
    assert_eq!(started["reasons"], json!([]), "{started}");
    assert_eq!(started["override_range_percent"], json!([50.0, 125.0]), "the profile's limits");
    let hash = served.get(&format!("{HERE}/versions/2")).await["hash"].clone();
    assert_eq!(started["program_hash"], hash);
    let risen = machine.samples(0, 10).await;
    assert!((115.0..=125.0).contains(&risen["override_percent"].as_f64().unwrap()), "{risen}");
    assert_eq!(machine.end(10).await["status"], 201);
    let kept = served.get("/v1/machines/M1/cycles/a/overrides").await;
    assert_eq!(kept["program_hash"], hash);

    // The version that was superseded, a program that is another one, and one that is the profile's own.
    let program = |end: f64| {
        json!({"between": "linear", "knots": [{"depth_mm": 0.0, "feed_mm_min": 100.0},
                                                                    {"depth_mm": 10.0, "feed_mm_min": end}]})
    };
    let beside = |end: f64| json!({"program": program(end), "profile": {"id": "bush", "version": 2}});
    for (id, change, reason) in [
        ("b", named(1), Some("profile_not_active")),
        ("c", beside(900.0), Some("program_mismatch")),
        ("d", beside(320.0), None),
    ] {
        let mut change = change;
        // Of a tool whose cycles are old nobody knows the wear, also while it is learnt.
        for time in ["started_at", "sent_at"] {
            change[time] = risen["valid_until"].clone();
        }
        let started = machine.start(id, change).await;
        let answer = machine.samples(0, 10).await;
        match reason {
            Some(reason) => {
                assert!(codes(&started["reasons"]).contains(&reason), "{started}");
                assert_eq!(answer["override_percent"], 100.0, "{answer}");
            }
            None => assert_eq!(answer["override_percent"], risen["override_percent"], "{answer}"),
        }
        assert_eq!(machine.end(10).await["status"], 201);
    }

    // The hole is to be deeper from now on: the profile was not made for it.
    let asked =
        served.client.get(served.url("/v1/operations/O1")).bearer_auth(&served.token).send().await.unwrap();
    let changed = served
        .client
        .put(served.url("/v1/operations/O1"))
        .bearer_auth(&served.token)
        .header("if-match", asked.headers()["etag"].clone())
        .json(&json!({"name": "Bushing M8", "process": "friction", "programmed_feed_mm_min": 150.0,
                      "depth_mm": 12.0, "feed_drive_load_set_percent": 30.0, "spindle_load_set_percent": 40.0}))
        .send()
        .await
        .unwrap();
    assert_eq!(changed.status(), 200);
    let started = machine.start("e", named(2)).await;
    assert!(codes(&started["reasons"]).contains(&"profile_mismatch"), "{started}");
    assert_eq!(machine.samples(0, 10).await["override_percent"], 100.0);
    served.server.shutdown().await.unwrap();
}

//! The binary form of a cycle over HTTP: the same cycle as JSON, and refused as JSON is.

use super::{Answer, Shop, at};
use feedwright_core::units::Timestamp;
use feedwright_server::ingest::body;
use feedwright_store::wire;
use serde_json::{Value, json};

crate::engines::on_both!(
    a_frame_is_the_same_cycle_as_its_json,
    another_content_under_a_known_id_is_a_conflict_and_kept_as_it_came,
    a_frame_whose_content_cannot_be_is_named_and_kept,
    frames_that_are_too_large_torn_or_foreign_are_refused_and_not_kept,
    in_a_batch_of_frames_a_bad_one_fails_alone,
    what_follows_a_torn_frame_is_no_cycle_either,
);

const CYCLES: &str = "/v1/machines/M1/cycles";

fn cycle(number: i64, load: f64) -> Value {
    json!({
        "cycle_id": format!("c{number}"), "tool": "T1", "operation": "O1", "started_at": at(number), "seq": number,
        "spindle_speed_rpm": 2500.5,
        "samples": {"period_ms": 10, "spindle_load_percent": vec![load; 300]},
    })
}

fn frame(cycle: &Value) -> Vec<u8> {
    let now = Timestamp::from_micros(super::MORNING_US + 1_800_000_000);
    let machine = "M1".try_into().unwrap();
    wire::encode(&body::decode(&machine, cycle.to_string().as_bytes(), 10_000, now).unwrap())
}

/// The frame with the spindle speed replaced, and whole again.
fn with_speed(frame: &[u8], speed: f64) -> Vec<u8> {
    let (old, mut frame) = (2500.5_f64.to_le_bytes(), frame.to_vec());
    let at = frame.windows(8).position(|bytes| bytes == old).expect("the speed is there");
    frame[at..at + 8].copy_from_slice(&speed.to_le_bytes());
    let end = frame.len() - wire::CHECKSUM;
    let sum = crc32fast::hash(&frame[..end]);
    frame[end..].copy_from_slice(&sum.to_le_bytes());
    frame
}

async fn post(shop: &Shop, bytes: Vec<u8>) -> Answer {
    shop.post_raw(CYCLES, wire::MEDIA_TYPE, bytes).await
}

async fn kept(shop: &Shop) -> usize {
    shop.get("/v1/quarantine").await.body["items"].as_array().unwrap().len()
}

async fn a_frame_is_the_same_cycle_as_its_json() {
    let shop = Shop::open().await;
    let first = post(&shop, frame(&cycle(1, 20.0))).await;
    assert_eq!((first.status, &first.body["status"]), (201, &json!("stored")), "{}", first.text);
    let again = shop.cycle("M1", &cycle(1, 20.0)).await;
    assert_eq!((again.status, &again.body["status"]), (200, &json!("known")), "{}", again.text);
    assert_eq!(again.body["summary"], first.body["summary"]);
    assert_eq!(shop.cycle("M1", &cycle(2, 20.0)).await.status, 201);
    let packed = zstd::encode_all(frame(&cycle(2, 20.0)).as_slice(), 1).unwrap();
    let request = shop.client.post(shop.url(CYCLES)).header("content-type", wire::MEDIA_TYPE);
    let known = shop.send(request.header("content-encoding", "zstd").body(packed)).await;
    assert_eq!((known.status, &known.body["wear"]["cycles"]), (200, &json!(2)), "{}", known.text);
    let samples = shop.get(&format!("{CYCLES}/c1/samples")).await;
    assert_eq!(samples.body["spindle_load_percent"].as_array().unwrap().len(), 300);
}

async fn another_content_under_a_known_id_is_a_conflict_and_kept_as_it_came() {
    let shop = Shop::open().await;
    assert_eq!(post(&shop, frame(&cycle(1, 20.0))).await.status, 201);
    let conflict = post(&shop, frame(&cycle(1, 21.0))).await;
    assert_eq!(
        (conflict.status, &conflict.body["code"]),
        (409, &json!("cycle_conflict")),
        "{}",
        conflict.text
    );
    assert_eq!(conflict.body["differs"], json!(["samples.spindle_load_percent[0]"]));
    let id = conflict.body["quarantine_id"].as_str().unwrap();
    let entry = shop.get(&format!("/v1/quarantine/{id}")).await;
    assert_eq!(
        (&entry.body["cycle_id"], &entry.body["content_type"]),
        (&json!("c1"), &json!(wire::MEDIA_TYPE))
    );
    assert_eq!(entry.body["size_bytes"], frame(&cycle(1, 21.0)).len());
    let samples = shop.get(&format!("{CYCLES}/c1/samples")).await;
    assert_eq!(samples.body["spindle_load_percent"][0], 20.0, "what was stored stays");
}

async fn a_frame_whose_content_cannot_be_is_named_and_kept() {
    let shop = Shop::open().await;
    let good = frame(&cycle(1, 20.0));
    let negative = with_speed(
        &frame(&json!({
            "cycle_id": "c2", "tool": "T1", "operation": "O1", "started_at": at(1), "spindle_speed_rpm": 2500.5,
            "samples": {"period_ms": 10, "spindle_load_percent": [1.0]},
        })),
        -1.0,
    );
    for (bytes, code, path) in [
        (with_speed(&good, f64::NAN), "not_finite", "spindle_speed_rpm"),
        (with_speed(&good, f64::INFINITY), "not_finite", "spindle_speed_rpm"),
        (with_speed(&good, 1e9), "out_of_range", "spindle_speed_rpm"),
        (negative, "out_of_range", "spindle_speed_rpm"),
    ] {
        let answer = post(&shop, bytes.clone()).await;
        assert_eq!(answer.status, 422, "{}", answer.text);
        let error = &answer.body["errors"][0];
        assert_eq!((&error["code"], &error["path"]), (&json!(code), &json!(path)), "{}", answer.text);
        let id = answer.body["quarantine_id"].as_str().unwrap_or_else(|| panic!("{}", answer.text));
        let entry = shop.get(&format!("/v1/quarantine/{id}")).await;
        assert_eq!((entry.status, &entry.body["code"]), (200, &json!(code)), "{}", entry.text);
    }
    assert_eq!(kept(&shop).await, 4);
    assert_eq!(shop.get("/v1/cycles").await.body["items"], json!([]));
    assert_eq!(post(&shop, good).await.status, 201, "the whole one is taken");
}

async fn frames_that_are_too_large_torn_or_foreign_are_refused_and_not_kept() {
    let shop = Shop::open().await;
    let good = frame(&cycle(1, 20.0));
    let refused = |answer: &Answer| {
        assert_eq!(answer.headers["content-type"], "application/problem+json", "{}", answer.text);
        assert!(answer.body["quarantine_id"].is_null());
        (answer.status, answer.body["code"].as_str().unwrap().to_owned())
    };
    let mut huge = good.clone();
    huge.resize(100 << 20, 0);
    assert_eq!(refused(&post(&shop, huge.clone()).await), (413, "body_too_large".to_owned()));
    let bomb = zstd::encode_all(huge.as_slice(), 1).unwrap();
    let request = shop.client.post(shop.url(CYCLES)).header("content-type", wire::MEDIA_TYPE);
    let bomb = shop.send(request.header("content-encoding", "zstd").body(bomb)).await;
    assert_eq!(refused(&bomb), (413, "decoded_body_too_large".to_owned()));
    let mut changed = good.clone();
    changed[20] ^= 1;
    let (torn, longer) = (good[..good.len() - 1].to_vec(), [good.as_slice(), &[0]].concat());
    for bytes in [torn, longer, changed, b"FWD\x01".to_vec(), b"FWC\x02".to_vec(), Vec::new()] {
        assert_eq!(refused(&post(&shop, bytes).await), (400, "malformed_cycle".to_owned()));
    }
    let as_json = shop.post_raw(CYCLES, "application/json", good.clone()).await;
    assert_eq!(refused(&as_json), (400, "malformed_json".to_owned()));
    assert_eq!(kept(&shop).await, 0);
    // As a line it would be read by luck: where none of its bytes ends a line.
    let line = cycle(2, 20.0).to_string();
    let lines = [line.as_bytes(), b"\nFWC\x01\n", &good].concat();
    let answer = shop.post_raw(&format!("{CYCLES}/batch"), "application/x-ndjson", lines).await;
    let outcomes: Vec<Value> =
        answer.text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let told = |index: usize| (outcomes[index]["line"].clone(), outcomes[index]["outcome"].clone());
    assert_eq!(
        (told(0), told(1)),
        ((json!(1), json!("stored")), (json!(2), json!("refused"))),
        "{}",
        answer.text
    );
    for refused in outcomes.iter().filter(|outcome| outcome["outcome"] != "stored") {
        assert_eq!(refused["problem"]["code"], "malformed_json", "{refused}");
    }
    assert_eq!(kept(&shop).await, 0);
}

async fn in_a_batch_of_frames_a_bad_one_fails_alone() {
    let shop = Shop::open().await;
    let mut frames: Vec<Vec<u8>> = (1..=10).map(|number| frame(&cycle(number, 20.0))).collect();
    frames[3] = with_speed(&frames[3], f64::NAN);
    let end = frames[5].len() - 1;
    frames[5][end] ^= 1;
    frames[7] = frames[6].clone();
    let answer = shop.post_raw(&format!("{CYCLES}/batch"), wire::MEDIA_TYPE, frames.concat()).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    let outcomes: Vec<Value> = answer.text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let words: Vec<_> = outcomes.iter().map(|outcome| outcome["outcome"].as_str().unwrap()).collect();
    assert_eq!(
        words,
        [
            "stored",
            "stored",
            "stored",
            "quarantined",
            "stored",
            "refused",
            "stored",
            "known",
            "stored",
            "stored"
        ]
    );
    assert_eq!(outcomes[3]["problem"]["errors"][0]["path"], "spindle_speed_rpm");
    assert_eq!((&outcomes[3]["cycle_id"], &outcomes[5]["cycle_id"]), (&json!("c4"), &Value::Null));
    assert_eq!(shop.get("/v1/tools/T1/wear").await.body["cycles"], 7);
}

async fn what_follows_a_torn_frame_is_no_cycle_either() {
    let shop = Shop::open().await;
    let (first, second) = (frame(&cycle(1, 20.0)), frame(&cycle(2, 20.0)));
    let bodies = [first[..first.len() - 3].to_vec(), [first.as_slice(), b"{}"].concat()];
    for (first, outcomes) in bodies.into_iter().zip([["refused", "refused"], ["stored", "refused"]]) {
        let body = [first, second.clone()].concat();
        let answer = shop.post_raw(&format!("{CYCLES}/batch"), wire::MEDIA_TYPE, body).await;
        assert_eq!(answer.status, 200, "{}", answer.text);
        let told: Vec<Value> = answer.text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        let words: Vec<_> = told.iter().map(|outcome| outcome["outcome"].as_str().unwrap()).collect();
        assert_eq!(words, outcomes);
        assert_eq!(told[1]["problem"]["code"], "malformed_cycle", "{}", answer.text);
        assert_eq!((&told[1]["line"], &told[1]["status"]), (&json!(2), &json!(400)));
    }
    assert_eq!(kept(&shop).await, 0);
}

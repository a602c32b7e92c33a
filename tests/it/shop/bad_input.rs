//! Everything a shop may send that is not a cycle: a code, a path, and nothing lost.

use super::{Shop, reported};
use serde_json::{Value, json};

crate::engines::on_both!(
    content_that_cannot_be_is_named_and_kept_in_quarantine,
    what_is_unusual_but_possible_is_stored_with_flags,
    bodies_that_are_torn_too_large_or_foreign_are_refused_and_not_kept,
    only_the_machine_itself_may_post_its_cycles,
    what_was_quarantined_can_be_repaired_and_taken_in,
);

const CYCLES: &str = "/v1/machines/M1/cycles";

async fn content_that_cannot_be_is_named_and_kept_in_quarantine() {
    let shop = Shop::open().await;
    let with = |samples: &str| {
        format!(
            r#"{{"cycle_id":"q1","tool":"T1","operation":"O1","started_at":"2026-05-04T06:00:00Z","samples":{samples}}}"#
        )
    };
    let load = |values: &str| with(&format!(r#"{{"period_ms":10,"spindle_load_percent":{values}}}"#));
    let many = format!("[{}]", vec!["1"; 1_000_000].join(","));
    let cases = [
        (load("[1,NaN]"), "not_finite", "samples.spindle_load_percent[1]"),
        (load("[Infinity]"), "not_finite", "samples.spindle_load_percent[0]"),
        (load("[-Infinity]"), "not_finite", "samples.spindle_load_percent[0]"),
        (load("[1e999]"), "not_finite", "samples.spindle_load_percent[0]"),
        (load("[\"1\"]"), "wrong_type", "samples.spindle_load_percent[0]"),
        (load("[null]"), "null_value", "samples.spindle_load_percent[0]"),
        (load("[]"), "empty", "samples.spindle_load_percent"),
        (load("[9007199254740993]"), "out_of_range", "samples.spindle_load_percent[0]"),
        (load(&many), "too_many_samples", "samples"),
        (
            with(r#"{"period_ms":10,"depth_mm":[1,2],"spindle_load_percent":[1]}"#),
            "length_mismatch",
            "samples.spindle_load_percent",
        ),
        (with(r#"{"time_ms":[0,10,5],"depth_mm":[1,2,3]}"#), "time_backwards", "samples.time_ms[2]"),
        (with(r#"{"period_ms":10,"loads":[1]}"#), "unknown_field", "samples.loads"),
        (load("[1]").replace("06:00:00Z", "06:41:00Z"), "started_in_future", "started_at"),
        (load("[1]").replace("\"T1\"", "\"T 1\""), "invalid_id", "tool"),
        (load("[1]").replace("\"q1\"", r#""q\u00001""#), "invalid_id", "cycle_id"),
        (
            load("[1]").replace("\"q1\"", r#""q1","law_version":"a\u0000""#),
            "control_character",
            "law_version",
        ),
        (load("[1]").replace("06:00:00Z", "06:00:00+25:00"), "invalid_timestamp", "started_at"),
    ];
    for (body, code, path) in &cases {
        let answer = shop.post_raw(CYCLES, "application/json", body.clone()).await;
        let shown: String = body.chars().take(200).collect();
        assert_eq!(answer.status, 422, "{shown}: {}", answer.text);
        assert_eq!(answer.headers["content-type"], "application/problem+json");
        let error = &answer.body["errors"][0];
        assert_eq!((&error["code"], &error["path"]), (&json!(code), &json!(path)), "{shown}");
        let id = answer.body["quarantine_id"].as_str().unwrap_or_else(|| panic!("{shown}: {}", answer.text));
        let kept = shop.get(&format!("/v1/quarantine/{id}")).await;
        assert_eq!(
            (kept.status, &kept.body["code"]),
            (200, &json!(code)),
            "{}",
            &kept.text[..kept.text.len().min(300)]
        );
    }
    let listed = shop.get("/v1/quarantine?limit=100").await;
    assert_eq!(listed.body["items"].as_array().unwrap().len(), cases.len());
    assert_eq!(shop.get("/v1/cycles").await.body["items"], json!([]));
}

async fn what_is_unusual_but_possible_is_stored_with_flags() {
    let shop = Shop::open().await;
    let cycle = json!({
        "cycle_id": "f1", "tool": "T1", "operation": "O1", "started_at": "2026-05-04T06:00:00Z",
        "samples": {"period_ms": 10, "depth_mm": [0, 1, 0.5, 1.5], "feed_actual_mm_min": [100, 0, 100, 100],
            "override_percent": [100, 0, 100, 100], "spindle_load_percent": [-0.5, 10, 401, 10],
            "spindle_power_watts": [-0.0, -5, 700, 0]},
    });
    let answer = shop.cycle("M1", &cycle).await;
    assert_eq!(answer.status, 201, "{}", answer.text);
    let flags = answer.body["summary"]["flags"].to_string();
    for flag in [
        "feed_hold",
        "override_zero",
        "negative_load",
        "negative_power",
        "depth_reversal",
        "load_over_400_percent",
    ] {
        assert!(flags.contains(flag), "{flag} in {flags}");
    }
    let samples = shop.get("/v1/machines/M1/cycles/f1/samples").await;
    assert!(samples.text.contains("\"spindle_power_watts\":[0.0,-5.0,700.0,0.0]"), "{}", samples.text);
    assert!(shop.get("/v1/alarms?open=true").await.text.contains("overload"));
}

async fn bodies_that_are_torn_too_large_or_foreign_are_refused_and_not_kept() {
    let shop = Shop::open().await;
    let refused = |answer: &super::Answer| {
        assert_eq!(answer.headers["content-type"], "application/problem+json", "{}", answer.text);
        assert!(answer.body["quarantine_id"].is_null());
        (answer.status, answer.body["code"].as_str().unwrap().to_owned())
    };
    let code = |text: &str| text.to_owned();
    let torn = shop.post_raw(CYCLES, "application/json", r#"{"cycle_id":"c1","tool"#).await;
    assert_eq!(refused(&torn), (400, code("malformed_json")));
    let foreign = shop.post_raw(CYCLES, "text/plain", reported(1, 1.0).to_string()).await;
    assert_eq!(refused(&foreign), (415, code("unsupported_media_type")));
    let request = shop.client.post(shop.url(CYCLES)).header("content-type", "application/json");
    let brotli = shop.send(request.header("content-encoding", "br").body("x")).await;
    assert_eq!(refused(&brotli), (415, code("unsupported_media_type")));
    let request = shop.client.post(shop.url(CYCLES)).header("content-type", "application/json");
    let twice = request.header("content-encoding", "gzip").header("content-encoding", "zstd");
    assert_eq!(refused(&shop.send(twice.body("x")).await), (415, code("unsupported_media_type")));
    let elsewhere = shop.cycle("M9", &reported(1, 1.0)).await;
    assert_eq!(refused(&elsewhere), (404, code("unknown_machine")));
    let bad_elsewhere = shop.post_raw("/v1/machines/M9/cycles", "application/json", r#"{"x":1}"#).await;
    assert_eq!(refused(&bad_elsewhere), (404, code("unknown_machine")));
    let huge = shop.post_raw(CYCLES, "application/json", vec![b' '; 100 << 20]).await;
    assert_eq!(refused(&huge), (413, code("body_too_large")));
    let bomb = zstd::encode_all(vec![b' '; 100 << 20].as_slice(), 1).unwrap();
    let request = shop.client.post(shop.url(CYCLES)).header("content-type", "application/json");
    let bomb = shop.send(request.header("content-encoding", "zstd").body(bomb)).await;
    assert_eq!(refused(&bomb), (413, code("decoded_body_too_large")));
    assert_eq!(shop.get("/v1/quarantine").await.body["items"], json!([]));
}

async fn only_the_machine_itself_may_post_its_cycles() {
    let shop = Shop::open().await;
    let own = shop.token("machine", Some("M1")).await;
    let post = |machine: &str| {
        shop.client.post(shop.url(&format!("/v1/machines/{machine}/cycles"))).json(&reported(1, 1.0))
    };
    let other = shop.send_as(post("M2"), &own).await;
    assert_eq!((other.status, &other.body["code"]), (403, &json!("other_machine")));
    let viewer = shop.token("viewer", None).await;
    assert_eq!(shop.send_as(post("M1"), &viewer).await.status, 403);
    let nobody = shop.client.post(shop.url(CYCLES)).json(&reported(1, 1.0)).send().await.unwrap();
    assert_eq!(nobody.status().as_u16(), 401);
    assert_eq!(shop.send_as(post("M1"), &own).await.status, 201);
    // A revocation acts on the next request.
    let tokens = shop.get("/v1/tokens").await;
    let id = |row: &Value| row["machine"] == "M1";
    let listed = tokens.body["items"].as_array().unwrap();
    let mine = listed.iter().find(|row| id(row)).unwrap()["id"].as_str().unwrap();
    let revoke = shop.client.delete(shop.url(&format!("/v1/tokens/{mine}")));
    assert!(shop.send(revoke).await.status < 300);
    assert_eq!(shop.send_as(post("M1"), &own).await.status, 401);
}

async fn what_was_quarantined_can_be_repaired_and_taken_in() {
    let shop = Shop::open().await;
    let bad = reported(1, 1000.0).to_string().replace("1000.0", "NaN");
    let answer = shop.post_raw(CYCLES, "application/json", bad).await;
    let id = answer.body["quarantine_id"].as_str().unwrap().to_owned();
    let path = format!("/v1/quarantine/{id}");
    let still = shop.post(&path, &json!({"action": "reingest", "reason": "try"})).await;
    assert_eq!(still.status, 422, "{}", still.text);
    let repaired = json!({"action": "reingest", "reason": "read off the control", "body": reported(1, 1000.0).to_string()});
    let taken = shop.post(&path, &repaired).await;
    assert_eq!(taken.status, 200, "{}", taken.text);
    assert_eq!(shop.get("/v1/machines/M1/cycles/c1").await.status, 200);
    assert_eq!(shop.get("/v1/quarantine").await.body["items"].as_array().unwrap().len(), 0, "settled");
}

/// Whatever is repeated of a body in an answer, and kept beside it, is short: a name of megabytes packs into a few bytes.
#[tokio::test]
async fn what_is_told_of_a_body_is_short_however_long_its_names_are() {
    let shop = Shop::open().await;
    let long = "k".repeat(1 << 20);
    for (body, path) in [
        (json!({ &long: 1 }), "kkk"),
        (json!({"cycle_id": "c1", "seq": &long}), "seq"),
        (json!({"cycle_id": "c1", "samples": {"period_ms": 10, &long: [1]}}), "samples.kkk"),
    ] {
        let answer = shop.cycle("M1", &body).await;
        assert_eq!(answer.status, 422, "{}", &answer.text[..1000]);
        assert!(answer.text.len() < 10_000, "{path}: {} bytes", answer.text.len());
        assert!(answer.body["errors"][0]["path"].as_str().unwrap().starts_with(path), "{}", answer.text);
        let entry = format!("/v1/quarantine/{}", answer.body["quarantine_id"].as_str().unwrap());
        let kept = shop.get(&entry).await;
        assert!(kept.body["problem"].to_string().len() < 10_000, "{path}");
        assert_eq!(
            kept.body["body"].as_str().unwrap().len(),
            body.to_string().len(),
            "it is kept as it came"
        );
    }
    let torn = shop.post_raw(CYCLES, "application/json", format!(r#"{{"{long}":"#)).await;
    assert!(torn.status == 400 && torn.text.len() < 10_000, "{} bytes", torn.text.len());
}

/// The forms of a cycle differ in what they can say of nothing: it is one cycle all the same.
#[tokio::test]
async fn a_time_of_minus_nothing_is_none() {
    let shop = Shop::open().await;
    let at = |first: &str| {
        format!(
            r#"{{"cycle_id":"c1","tool":"T1","operation":"O1","started_at":"2026-05-04T06:00:00Z",
                "samples":{{"time_ms":[{first},10,20],"spindle_load_percent":[1,2,3]}}}}"#
        )
    };
    assert_eq!(shop.post_raw(CYCLES, "application/json", at("-0.0")).await.status, 201);
    let again = shop.post_raw(CYCLES, "application/json", at("0")).await;
    assert_eq!(again.status, 200, "{}", again.text);
}

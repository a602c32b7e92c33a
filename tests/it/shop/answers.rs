//! What a machine and a MES are told about good cycles.

use super::{Shop, at, reported};
use serde_json::{Value, json};

crate::engines::on_both!(
    a_cycle_is_answered_with_its_summary_the_wear_and_what_to_run_next,
    the_same_cycle_again_is_known_and_another_content_a_conflict_that_loses_nothing,
    who_prefers_a_minimal_answer_is_told_what_to_run_next,
    a_batch_answers_every_line_and_a_bad_one_fails_alone,
    gzip_and_zstd_bodies_are_the_same_cycle,
    a_cycle_and_its_samples_can_be_read_back_and_listed,
    a_cycle_that_is_called_as_a_word_of_the_api_is_read_as_any_other,
    a_mean_at_the_end_of_its_range_is_stored_as_it_is,
    a_mes_asks_what_to_run_next,
    prometheus_sees_what_happened,
);

fn sampled(number: i64) -> Value {
    let load: Vec<f64> = (0..400).map(|k| if (100..300).contains(&k) { 20.0 } else { 0.0 }).collect();
    json!({
        "cycle_id": format!("c{number}"), "tool": "T1", "operation": "O1", "started_at": at(number), "seq": number,
        "strategy": "f_lin",
        "samples": {"period_ms": 10, "spindle_load_percent": load},
    })
}

async fn a_cycle_is_answered_with_its_summary_the_wear_and_what_to_run_next() {
    let shop = Shop::open().await;
    let answer = shop.cycle("M1", &sampled(1)).await;
    assert_eq!(answer.status, 201, "{}", answer.text);
    let body = &answer.body;
    assert_eq!(body["status"], "stored");
    assert_eq!(body["registered"], true);
    // 20 % of 7 kW for two seconds.
    let energy = &body["summary"]["energy"][0];
    assert_eq!(energy["basis"], "rated_power");
    assert!((energy["total_joules"].as_f64().unwrap() - 2800.0).abs() < 1e-6, "{energy}");
    assert_eq!(energy["feed_drive_joules"], Value::Null, "no thrust is declared: said so, not invented");
    assert_eq!(body["summary"]["max_spindle_load_percent"]["value"], 20.0);
    assert_eq!(body["wear"]["state"], "learning");
    assert_eq!(body["wear"]["baselines"][0]["learnt_from"], 1);
    let advice = &body["recommendation"];
    assert_eq!(advice["override_percent"], 100.0);
    assert_eq!(advice["process"], "friction");
    assert_eq!(advice["feed"], json!({"source": "programmed", "feed_mm_min": 140.0, "profile": null}));
    assert_eq!(advice["load_limits"]["spindle_load_set_percent"], 40.0);
    assert!(advice["reasons"].as_array().unwrap().iter().any(|reason| reason["code"] == "no_profile"));
    // Handed out is kept: anyone can later say which advice a cycle followed.
    let kept = shop.get(&format!("/v1/recommendations/{}", advice["id"].as_str().unwrap())).await;
    assert_eq!((kept.status, &kept.body), (200, advice));
}

async fn the_same_cycle_again_is_known_and_another_content_a_conflict_that_loses_nothing() {
    let shop = Shop::open().await;
    assert_eq!(shop.cycle("M1", &reported(1, 1000.0)).await.status, 201);
    let again = shop.cycle("M1", &reported(1, 1000.0)).await;
    assert_eq!((again.status, &again.body["status"]), (200, &json!("known")));
    assert_eq!(again.body["wear"]["cycles"], 1, "known is not counted twice");
    // The same content in another order and notation.
    let other = r#"{"reported":{"duration_ms":4.28e3,"energy_joules":1000.0},"started_at":"2026-05-04T08:00:10+02:00",
        "operation":"O1","tool":"T1","cycle_id":"c1"}"#;
    let path = "/v1/machines/M1/cycles";
    assert_eq!(shop.post_raw(path, "application/json", other).await.status, 200);
    let conflict = shop.cycle("M1", &reported(1, 1001.0)).await;
    assert_eq!((conflict.status, &conflict.body["code"]), (409, &json!("cycle_conflict")));
    assert_eq!(conflict.body["differs"], json!(["reported.energy_joules"]));
    let id = conflict.body["quarantine_id"].as_str().unwrap();
    let kept = shop.get(&format!("/v1/quarantine/{id}")).await;
    assert_eq!(kept.status, 200, "{}", kept.text);
    assert!(kept.text.contains("1001"), "{}", kept.text);
    // The same id on another machine is another cycle.
    assert_eq!(shop.cycle("M2", &reported(1, 1001.0)).await.status, 201);
}

async fn who_prefers_a_minimal_answer_is_told_what_to_run_next() {
    let shop = Shop::open().await;
    let post = async |cycle: &Value, preferred: &str| {
        let request = shop.client.post(shop.url("/v1/machines/M1/cycles")).json(cycle);
        shop.send(request.header("prefer", preferred)).await
    };
    let cycle = sampled(1);
    for (status, word) in [(201, "stored"), (200, "known")] {
        let minimal = post(&cycle, "wait=10, return=minimal").await;
        assert_eq!((minimal.status, &minimal.body["status"]), (status, &json!(word)), "{}", minimal.text);
        assert_eq!(minimal.headers["preference-applied"], "return=minimal");
        let told: Vec<&String> = minimal.body.as_object().unwrap().keys().collect();
        assert_eq!(told, ["cycle_id", "machine", "received_at", "recommendation", "registered", "status"]);
        let advice = &minimal.body["recommendation"];
        let kept = shop.get(&format!("/v1/recommendations/{}", advice["id"].as_str().unwrap())).await;
        assert_eq!((kept.status, &kept.body), (200, advice));
    }
    let whole = post(&cycle, "return=representation").await;
    assert!(!whole.headers.contains_key("preference-applied"));
    assert_eq!(whole.body["wear"]["state"], "learning");
    assert_eq!(whole.body["summary"]["sample_count"], 400);
    // What is refused is told as ever.
    let refused = post(&json!({"cycle_id": "c2"}), "return=minimal").await;
    assert_eq!((refused.status, &refused.body["code"]), (422, &json!("missing_field")), "{}", refused.text);
    assert!(!refused.headers.contains_key("preference-applied"));
}

async fn a_batch_answers_every_line_and_a_bad_one_fails_alone() {
    let shop = Shop::open().await;
    let mut lines: Vec<String> = (1..=100).map(|number| reported(number, 1000.0).to_string()).collect();
    lines[10] = lines[10].replace("1000.0", "NaN");
    lines[20] = String::new();
    lines[30] = lines[29].clone();
    lines.push(r#"{"cycle_id":"torn","tool":"T1","oper"#.to_owned());
    let path = "/v1/machines/M1/cycles/batch";
    let answer = shop.post_raw(path, "application/x-ndjson", lines.join("\n")).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    let outcomes: Vec<Value> = answer.text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(outcomes.len(), 100, "the empty line has none");
    let of = |line: u64| outcomes.iter().find(|outcome| outcome["line"] == line).unwrap();
    assert_eq!((&of(1)["outcome"], &of(1)["status"]), (&json!("stored"), &json!(201)));
    assert_eq!((&of(11)["outcome"], &of(11)["status"]), (&json!("quarantined"), &json!(422)));
    assert_eq!(of(11)["problem"]["errors"][0]["path"], "reported.energy_joules");
    assert!(of(11)["quarantine_id"].is_string());
    assert_eq!(of(31)["outcome"], "known");
    assert_eq!((&of(101)["outcome"], &of(101)["status"]), (&json!("refused"), &json!(400)));
    let wear = shop.get("/v1/tools/T1/wear").await;
    assert_eq!((&wear.body["cycles"], &wear.body["state"]), (&json!(97), &json!("good")));
}

async fn gzip_and_zstd_bodies_are_the_same_cycle() {
    let shop = Shop::open().await;
    let json = reported(1, 1000.0).to_string();
    assert_eq!(shop.cycle("M1", &reported(1, 1000.0)).await.status, 201);
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    std::io::Write::write_all(&mut gzip, json.as_bytes()).unwrap();
    let packed = [("gzip", gzip.finish().unwrap()), ("zstd", zstd::encode_all(json.as_bytes(), 1).unwrap())];
    for (encoding, bytes) in packed {
        let request = shop.client.post(shop.url("/v1/machines/M1/cycles"));
        let request = request.header("content-type", "application/json").header("content-encoding", encoding);
        assert_eq!(shop.send(request.body(bytes)).await.status, 200, "{encoding}");
    }
}

async fn a_cycle_and_its_samples_can_be_read_back_and_listed() {
    let shop = Shop::open().await;
    for number in 1..=25 {
        assert_eq!(shop.cycle("M1", &sampled(number)).await.status, 201);
    }
    let cycle = shop.get("/v1/machines/M1/cycles/c7").await;
    assert_eq!(
        (cycle.status, &cycle.body["seq"], &cycle.body["strategy"]),
        (200, &json!(7), &json!("f_lin"))
    );
    assert_eq!(cycle.body["has_samples"], true);
    let samples = shop.get("/v1/machines/M1/cycles/c7/samples").await;
    let posted: Value = serde_json::from_str(&sampled(7)["samples"].to_string()).unwrap();
    assert_eq!(samples.body["spindle_load_percent"], posted["spindle_load_percent"]);
    assert_eq!(samples.body["period_ms"], 10.0);
    assert_eq!(shop.get("/v1/machines/M1/cycles/none").await.status, 404);
    // Pages neither repeat nor skip.
    let mut seen = Vec::new();
    let mut cursor = String::new();
    loop {
        let page = shop.get(&format!("/v1/cycles?tool=T1&limit=10{cursor}")).await;
        assert_eq!(page.status, 200, "{}", page.text);
        seen.extend(page.body["items"].as_array().unwrap().iter().map(|row| row["cycle_id"].clone()));
        match page.body["next_cursor"].as_str() {
            Some(next) => cursor = format!("&cursor={next}"),
            None => break,
        }
    }
    assert_eq!(seen, (1..=25).map(|number| json!(format!("c{number}"))).collect::<Vec<_>>());
    let range = shop.get(&format!("/v1/cycles?machine=M1&from={}&to={}", at(3), at(6))).await;
    assert_eq!(range.body["items"].as_array().unwrap().len(), 3);
    assert_eq!(shop.get("/v1/cycles?cursor=nonsense").await.status, 400);
    let csv = shop.get("/v1/tools/T1/history.csv").await;
    assert_eq!(csv.text.lines().count(), 26);
    assert_eq!(csv.text.matches("\r\n").count(), 26);
    assert!(csv.text.contains("\n2026-05-04T06:00:10.000000Z,"), "{}", csv.text);
    assert!(csv.text.lines().nth(1).unwrap().contains("rated_power,2800"), "{}", csv.text);
}

async fn a_cycle_that_is_called_as_a_word_of_the_api_is_read_as_any_other() {
    let shop = Shop::open().await;
    for id in ["batch", "batch2", "bat", "samples"] {
        let mut cycle = sampled(1);
        cycle["cycle_id"] = json!(id);
        assert_eq!(shop.cycle("M1", &cycle).await.status, 201);
        let path = format!("/v1/machines/M1/cycles/{id}");
        let read = shop.get(&path).await;
        assert_eq!((read.status, &read.body["cycle_id"]), (200, &json!(id)), "{}", read.text);
        for beneath in ["samples", "course", "overrides"] {
            let other = shop.get(&format!("/v1/machines/M1/cycles/c9/{beneath}")).await;
            let read = shop.get(&format!("{path}/{beneath}")).await;
            assert!(read.status == 200 || (read.status == 404 && beneath == "overrides"), "{}", read.text);
            assert_eq!((other.status, &other.body["code"]), (404, &json!("not_found")), "{}", other.text);
        }
        let asked = shop.post(&format!("{path}/what-if"), &json!({"control": {}})).await;
        assert_ne!((asked.status, &asked.body["code"]), (404, &json!("unknown_path")), "{}", asked.text);
        assert_ne!(asked.status, 405, "{}", asked.text);
    }
    // Of another machine there is none, and what else stands at that address stays.
    let none = shop.get("/v1/machines/M2/cycles/batch").await;
    assert_eq!((none.status, &none.body["code"]), (404, &json!("not_found")), "{}", none.text);
    let line = reported(2, 1000.0).to_string();
    let batch = shop.post_raw("/v1/machines/M1/cycles/batch", "application/x-ndjson", line).await;
    assert_eq!((batch.status, batch.text.lines().count()), (200, 1), "{}", batch.text);
    let wrong = shop.put("/v1/machines/M1/cycles/batch", &json!({})).await;
    assert_eq!((wrong.status, &wrong.headers["allow"]), (405, &"POST,GET,HEAD".parse().unwrap()));
}

async fn a_mean_at_the_end_of_its_range_is_stored_as_it_is() {
    let shop = Shop::open().await;
    // Sums of products with such times are rounded up.
    let times = [json!([1e-6, 10]), json!([12.3, 20.3, 32.6, 40.37, 50.37])];
    let ends = [
        ("override_percent", "mean_override_percent", 1000.0),
        ("override_percent", "mean_override_percent", 200.0),
        ("operator_override_percent", "operator_override_percent", 1000.0),
        ("spindle_load_percent", "mean_spindle_load_percent", -10_000.0),
        ("feed_drive_load_percent", "mean_feed_drive_load_percent", 10_000.0),
    ];
    for (number, (times, (channel, mean, value))) in
        (1..).zip(times.iter().flat_map(|times| ends.iter().map(move |end| (times, end))))
    {
        let values = vec![*value; times.as_array().unwrap().len()];
        let cycle = json!({
            "cycle_id": format!("c{number}"), "tool": "T1", "operation": "O1", "started_at": at(number),
            "samples": {"time_ms": times, *channel: values},
        });
        let answer = shop.cycle("M1", &cycle).await;
        assert_eq!(answer.status, 201, "{cycle}: {}", answer.text);
        assert_eq!(answer.body["summary"][*mean], json!(value), "{cycle}");
    }
    let fallen = json!({
        "cycle_id": "fallen", "tool": "T1", "operation": "O1", "started_at": at(20),
        "samples": {"period_ms": 10, "depth_mm": [0, -65_159.297_272_276_29, 100_000], "spindle_load_percent": [10, 6, 5]},
    });
    let answer = shop.cycle("M1", &fallen).await;
    assert_eq!(answer.status, 201, "{}", answer.text);
    assert_eq!(answer.body["summary"]["spindle_load_fall_depth_mm"], 100_000.0);
}

async fn a_mes_asks_what_to_run_next() {
    let shop = Shop::open().await;
    let viewer = shop.token("viewer", None).await;
    let ask = |query: &str| shop.client.get(shop.url(&format!("/v1/recommendations?{query}")));
    let all = "machine=M1&operation=O1&tool=T1";
    let answer = shop.send_as(ask(all), &viewer).await;
    assert_eq!((answer.status, &answer.body["data"]["quality"]), (200, &json!("missing")), "{}", answer.text);
    assert_eq!(answer.body["override_percent"], 100.0);
    for number in 1..=5 {
        shop.cycle("M1", &reported(number, 1000.0)).await;
    }
    let answer = shop.send_as(ask(all), &viewer).await;
    assert_eq!((&answer.body["data"]["quality"], &answer.body["action"]), (&json!("good"), &json!("run")));
    assert_eq!(answer.body["tool_state"]["level"]["as_run"], 1.0);
    assert!(answer.body["valid_until"].as_str().unwrap() > answer.body["issued_at"].as_str().unwrap());
    for number in 6..=10 {
        shop.cycle("M1", &reported(number, 1110.0)).await;
    }
    let answer = shop.send_as(ask(all), &viewer).await;
    assert_eq!(
        (&answer.body["action"], &answer.body["tool_state"]["state"]),
        (&json!("change_tool"), &json!("worn"))
    );
    // What is not registered gets a neutral answer that says why.
    let answer = shop.send_as(ask("machine=M1&operation=O9&tool=T9"), &viewer).await;
    let codes = answer.body["reasons"].to_string();
    assert!(codes.contains("tool_unregistered") && codes.contains("operation_unregistered"), "{codes}");
    assert_eq!(shop.send_as(ask("machine=M9&operation=O1&tool=T1"), &viewer).await.status, 404);
    assert_eq!(shop.send_as(ask("machine=M1&operation=O1"), &viewer).await.status, 400);
    let own = shop.token("machine", Some("M1")).await;
    assert_eq!(shop.send_as(ask(all), &own).await.status, 200);
    assert_eq!(shop.send_as(ask("machine=M2&operation=O1&tool=T1"), &own).await.status, 403);
}

async fn prometheus_sees_what_happened() {
    let shop = Shop::open().await;
    for number in 1..=6 {
        shop.cycle("M1", &reported(number, 1000.0)).await;
    }
    shop.cycle("M1", &reported(1, 1000.0)).await;
    shop.cycle("M1", &reported(1, 7.0)).await;
    shop.post_raw("/v1/machines/M1/cycles", "application/json", "{").await;
    // Whatever is refused before it is read.
    for route in ["cycles", "cycles/batch"] {
        assert_eq!(shop.post_raw(&format!("/v1/machines/M1/{route}"), "text/plain", "{}").await.status, 415);
    }
    let batch = shop.post_raw("/v1/machines/M9/cycles/batch", "application/x-ndjson", "{}").await;
    assert_eq!(batch.status, 404);
    let text = shop.get("/metrics").await.text;
    for line in [
        "feedwright_cycles_total{outcome=\"accepted\"} 6",
        "feedwright_cycles_total{outcome=\"duplicate\"} 1",
        "feedwright_cycles_total{outcome=\"quarantined\"} 1",
        "feedwright_cycles_rejected_total{reason=\"malformed_json\"} 1",
        "feedwright_cycles_rejected_total{reason=\"unsupported_media_type\"} 2",
        "feedwright_cycles_rejected_total{reason=\"unknown_machine\"} 1",
        "feedwright_cycles_quarantined_total{reason=\"cycle_conflict\"} 1",
        "feedwright_machine_cycles_total{machine=\"M1\",outcome=\"accepted\"} 6",
        "feedwright_machine_cycles_total{machine=\"M1\",outcome=\"quarantined\"} 1",
        "feedwright_tool_wear_level_ratio{machine=\"M1\"} 1",
        // Half past six, by the shop's clock: the first recommendation.
        "feedwright_machine_recommendation_neutral_since_timestamp_seconds{machine=\"M1\",reason=\"no_profile\"} \
         1777876200",
        "feedwright_recommendations_total{action=\"run\"} 7",
        "feedwright_cycle_energy_joules_count{process=\"friction\"} 6",
        "route=\"/v1/machines/{machine}/cycles\"",
    ] {
        assert!(text.contains(line), "{line} is missing in:\n{text}");
    }
    assert!(!text.contains("T1"), "no tool serial is a label");
    // A new tool has no level yet: that of the old one goes.
    let changed = json!({"kind": "changed", "at": "2026-05-04T06:10:00Z", "reason": "story"});
    assert_eq!(shop.post("/v1/tools/T1/events", &changed).await.status, 201);
    shop.cycle("M1", &reported(61, 1000.0)).await;
    let text = shop.get("/metrics").await.text;
    assert!(!text.contains("feedwright_tool_wear_level_ratio{"), "{text}");
    // Nor does it come back with a cycle of the old one that comes late.
    assert_eq!(shop.cycle("M1", &reported(8, 1000.0)).await.status, 201);
    let text = shop.get("/metrics").await.text;
    assert!(!text.contains("feedwright_tool_wear_level_ratio{"), "{text}");
    // A first torn frame is an increase of what stood at 0.
    for reason in ["malformed_cycle", "malformed_encoding"] {
        assert!(
            text.contains(&format!("feedwright_cycles_rejected_total{{reason=\"{reason}\"}} 0")),
            "{text}"
        );
    }
}

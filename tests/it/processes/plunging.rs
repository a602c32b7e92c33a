//! Plunge feeds, what they save, and what recorded cycles show.

use super::refuses;
use crate::shop::{Shop, at};
use serde_json::{Value, json};

fn question(drills: &Value) -> Value {
    let law = |coefficient: f64, diameter: f64, feed: f64| json!({"coefficient": coefficient, "diameter_exponent": diameter, "feed_exponent": feed, "correction": 1.0});
    json!({
        "material": {"entry": {"name": "C45", "thrust": law(680.0, 1.0, 0.7), "torque": law(345.0, 2.0, 0.8)}},
        "machine": {"least_feed_mm_min": 10.0, "greatest_feed_mm_min": 5000.0}, "drills": drills,
    })
}

#[tokio::test]
async fn a_tool_table_gets_its_feeds_with_what_binds() {
    let shop = Shop::open().await;
    let drills = json!([{"diameter_mm": 1.0, "length_mm": 60, "spindle_rpm": 3000},
                        {"diameter_mm": 12.0, "length_mm": 100, "spindle_rpm": 800}]);
    let answer = shop.post("/v1/plunge/feed", &question(&drills)).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    let (thin, thick) = (&answer.body["drills"][0], &answer.body["drills"][1]);
    // Eq. 9: 18 073·d⁴/l², Eq. 10: about 29·d³, here with the middle of the printed strengths.
    assert!((thin["critical_thrust_n"].as_f64().unwrap() - 18_073.0 / 3600.0).abs() < 0.01, "{thin}");
    assert!((thick["critical_torque_n_mm"].as_f64().unwrap() / 1728.0 - 30.08).abs() < 0.01, "{thick}");
    assert_eq!((&thin["limit"], &thick["limit"]), (&json!("impossible"), &json!("torsion")));
    assert!(thin["feed_mm_min"].is_null());
    assert_eq!(answer.body["warnings"][0]["code"], "no_loop_latency");
    // A loop through a network bites before it knows.
    let mut slow = question(&drills);
    slow["latency"] =
        json!({"allowed_bite_mm": 0.1, "detector_samples": 4, "sample_period_s": 0.01, "answer_age_s": 0.02});
    let answer = shop.post("/v1/plunge/feed", &slow).await;
    assert_eq!(answer.body["drills"][1]["limit"], "loop_latency");
    assert!((answer.body["drills"][1]["bite_mm"].as_f64().unwrap() - 0.1).abs() < 1e-9);
    let bad = question(&json!([{"diameter_mm": 5, "length_mm": 60, "spindle_rpm": 3000},
                               {"diameter_mm": 0, "length_mm": 60, "spindle_rpm": 3000}]));
    refuses(&shop, "/v1/plunge/feed", &bad.to_string(), "out_of_range", "drills[1].diameter_mm").await;
    refuses(&shop, "/v1/plunge/feed", &question(&json!([])).to_string(), "empty", "drills").await;
}

#[tokio::test]
async fn savings_follow_the_paper_and_recorded_cycles_show_the_real_ones() {
    let shop = Shop::open().await;
    let hole = json!({"holes": 12, "safe_distance_mm": 3.0, "length_mm": 20.0, "exit_without_mm": 5.0,
        "exit_with_mm": 2.0, "rapid_mm": 100.0, "rapid_feed_mm_min": 10000.0, "working_feed_mm_min": 200.0,
        "plunge_feed_mm_min": 1000.0});
    let answer = shop.post("/v1/plunge/saving", &json!({"holes": [hole]})).await;
    let saved = &answer.body["holes"][0];
    // k1·(2 − k2) = 0.15·1.8 = 0.27 of 6 s.
    assert!((saved["relative"].as_f64().unwrap() - 0.27).abs() < 1e-12, "{}", answer.text);
    assert!((answer.body["saved_s"].as_f64().unwrap() - 12.0 * 1.62).abs() < 1e-9);

    let operation = json!({"name": "Hole 5", "process": "plunge"});
    assert_eq!(shop.put("/v1/operations/P1", &operation).await.status, 201);
    for (number, process, duration) in
        [(1, "drilling", 8000.0), (2, "drilling", 8200.0), (3, "plunge", 6400.0), (4, "plunge", 6400.0)]
    {
        let cycle = json!({"cycle_id": format!("p{number}"), "tool": "T1", "operation": "P1", "started_at": at(number),
            "process": process, "reported": {"duration_ms": duration}});
        assert_eq!(shop.cycle("M1", &cycle).await.status, 201);
    }
    let answer = shop.get("/v1/plunge/recorded?operation=P1").await;
    assert!((answer.body["saved_s"].as_f64().unwrap() - 1.7).abs() < 1e-9, "{}", answer.text);
    assert_eq!(answer.body["complete"], true);
    // Of some only, it is the newest that are looked at.
    let newest = shop.get("/v1/plunge/recorded?operation=P1&most_cycles=3").await.body;
    assert_eq!(
        (&newest["complete"], &newest["with_control"]["cycles"]),
        (&json!(false), &json!(2)),
        "{newest}"
    );
    assert!((newest["saved_s"].as_f64().unwrap() - 1.8).abs() < 1e-9, "8.2 s without, 6.4 s with: {newest}");
    let all = shop.get("/v1/plunge/recorded?operation=P1&most_cycles=4").await;
    assert_eq!(all.text, answer.text);
    let none = shop.get("/v1/plunge/recorded?operation=P1&most_cycles=0").await;
    assert_eq!((none.status, &none.body["errors"][0]["path"]), (422, &json!("most_cycles")), "{}", none.text);
    assert_eq!(shop.get("/v1/plunge/recorded?operation=P9").await.status, 404);
    // Samples are often of a part of a cycle; how long it took the control reports.
    for number in [7, 8] {
        let cycle = json!({"cycle_id": format!("p{number}"), "tool": "T1", "operation": "P1", "started_at": at(number),
            "process": "plunge", "reported": {"duration_ms": 6400.0},
            "samples": {"period_ms": 10, "feed_drive_load_percent": vec![10.0; 200]}});
        assert_eq!(shop.cycle("M1", &cycle).await.status, 201);
    }
    let answer = shop.get("/v1/plunge/recorded?operation=P1").await;
    assert!((answer.body["saved_s"].as_f64().unwrap() - 1.7).abs() < 1e-9, "{}", answer.text);
    // Of one that stopped half-way the length says nothing, whoever stopped it.
    for (number, outcome) in [(5, "completed"), (6, "aborted")] {
        let cycle = json!({"cycle_id": format!("p{number}"), "tool": "T1", "operation": "P1", "started_at": at(number),
            "process": "plunge", "outcome": outcome, "reported": {"duration_ms": 100.0}});
        assert_eq!(shop.cycle("M1", &cycle).await.status, 201);
    }
    shop.cut_short("p5").await;
    assert_eq!(shop.get("/v1/plunge/recorded?operation=P1").await.text, answer.text);
}

//! What the processes add to recommendations.

use super::{pair, papers_grid, papers_job};
use crate::shop::{Shop, at};
use serde_json::{Value, json};

fn operation(model: &str) -> Value {
    json!({"name": "Shaft", "process": "turning", "turning": {
        "model": model, "depth_mm": 2.5, "diameter_mm": 80.0, "domain": papers_grid(), "caution_sigmas": 0.0,
        "limits": {"power_kw": 7.0, "force_n": 1500.0, "wear_mm": 0.3}}})
}

async fn opened() -> Shop {
    let shop = Shop::open().await;
    let answer = shop.put("/v1/operations/L1", &operation("alaskari-oraby-2017")).await;
    assert_eq!(answer.status, 201, "{}", answer.text);
    assert_eq!(shop.put("/v1/tools/E1", &json!({"name": "Edge 1", "tool_type": "gc435"})).await.status, 201);
    shop
}

async fn mount(shop: &Shop, kind: &str) {
    let event = json!({"kind": kind, "at": "2026-05-04T06:00:00Z", "reason": "as the story goes"});
    let answer = shop.post("/v1/tools/E1/events", &event).await;
    assert_eq!(answer.status, 201, "{}", answer.text);
}

fn cut(number: i64, interval: &Value) -> Value {
    json!({"cycle_id": format!("t{number}"), "tool": "E1", "operation": "L1", "started_at": at(number),
        "reported": {"duration_ms": 60000, "cutting_speed_m_min": interval["speed_m_min"],
            "feed_mm_rev": interval["feed_mm_rev"], "thrust_newtons": interval["force_n"],
            "spindle_power_watts": interval["power_kw"].as_f64().unwrap() * 1000.0}})
}

async fn asked(shop: &Shop) -> Value {
    shop.get("/v1/recommendations?machine=M1&operation=L1&tool=E1").await.body
}

fn says(advice: &Value, code: &str) -> bool {
    advice["reasons"].as_array().unwrap().iter().any(|reason| reason["code"] == code)
}

async fn intervals(shop: &Shop) -> Vec<Value> {
    let plan = shop.post("/v1/turning/plan", &json!({"job": papers_job()})).await;
    plan.body["plan"]["intervals"].as_array().unwrap().clone()
}

#[tokio::test]
async fn posted_cuts_get_the_next_pair_to_the_end_of_the_edge() {
    let shop = opened().await;
    let before = asked(&shop).await;
    assert!(says(&before, "turning_edge_unknown") && before["process_advice"].is_null(), "{before}");
    mount(&shop, "mounted_new").await;
    let plan = intervals(&shop).await;
    let next = |advice: &Value| pair(&advice["process_advice"]["turning"]["next"]);
    assert_eq!(next(&asked(&shop).await), (150.0, 0.58));
    for (number, interval) in (1..).zip(&plan) {
        let answer = shop.cycle("M1", &cut(number, interval)).await;
        assert_eq!(answer.status, 201, "{}", answer.text);
        let advice = &answer.body["recommendation"];
        match plan.get(usize::try_from(number).unwrap()) {
            Some(following) => assert_eq!(next(advice), pair(following), "after {number}"),
            None => {
                assert_eq!(advice["action"], "change_tool", "{advice}");
                assert_eq!(advice["process_advice"]["turning"]["ended_by"], "wear");
                assert!(says(advice, "turning_edge_spent"));
            }
        }
    }
    let last = asked(&shop).await;
    let turning = &last["process_advice"]["turning"];
    assert_eq!(turning["readings"], json!({"intervals": 14, "power": 14, "force": 14, "wear": 0}));
    // What was handed out is found again, and what stood in it before still does.
    let issued = shop.get(&format!("/v1/recommendations/{}", last["id"].as_str().unwrap())).await.body;
    assert_eq!(issued["process_advice"], last["process_advice"]);
    assert_eq!((&last["override_percent"], &last["process"]), (&json!(100.0), &json!("turning")));
}

#[tokio::test]
async fn the_order_of_arrival_does_not_matter() {
    let shop = opened().await;
    mount(&shop, "mounted_new").await;
    let plan = intervals(&shop).await;
    let cuts: Vec<_> = (1..).zip(&plan[..6]).map(|(number, interval)| cut(number, interval)).collect();
    for cycle in &cuts {
        shop.cycle("M1", cycle).await;
    }
    let in_order = asked(&shop).await["process_advice"].clone();
    let other = opened().await;
    mount(&other, "mounted_new").await;
    for at in [3, 0, 5, 1, 4, 2, 3] {
        other.cycle("M1", &cuts[at]).await;
    }
    assert_eq!(asked(&other).await["process_advice"], in_order);
}

#[tokio::test]
async fn what_is_not_known_advises_nothing_and_says_why() {
    let shop = opened().await;
    mount(&shop, "mounted_used").await;
    assert!(says(&asked(&shop).await, "turning_edge_unknown"));
    const NEUTRAL: &str = "feedwright_machine_recommendation_neutral_since_timestamp_seconds{machine=\"M1\"";
    assert!(shop.get("/metrics").await.text.contains(NEUTRAL));
    mount(&shop, "mounted_new").await;
    assert!(says(&asked(&shop).await, "turning_advised"));
    // Its override is neutral, and it names a pair.
    assert!(!shop.get("/metrics").await.text.contains(NEUTRAL));
    // A cut that does not tell its feed leaves the wear unknown.
    let plan = intervals(&shop).await;
    let mut silent = cut(1, &plan[0]);
    silent["reported"].as_object_mut().unwrap().remove("feed_mm_rev");
    let answer = shop.cycle("M1", &silent).await;
    assert!(says(&answer.body["recommendation"], "turning_history_untold"), "{}", answer.text);
    assert!(answer.body["recommendation"]["process_advice"].is_null());
    // Without a model the recommendation is the neutral one.
    shop.put("/v1/operations/L2", &json!({"name": "Shaft", "process": "turning"})).await;
    let neutral = shop.get("/v1/recommendations?machine=M1&operation=L2&tool=E1").await.body;
    assert!(says(&neutral, "no_turning_model") && neutral["process_advice"].is_null());
    shop.put("/v1/operations/L3", &operation("not-there")).await;
    let missing = shop.get("/v1/recommendations?machine=M1&operation=L3&tool=E1").await.body;
    assert!(says(&missing, "turning_model_missing"));
    let friction = shop.get("/v1/recommendations?machine=M1&operation=O1&tool=T1").await.body;
    assert!(friction["process_advice"].is_null());
}

#[tokio::test]
async fn an_edge_is_worn_by_what_was_run_and_not_by_what_was_sampled() {
    // A minute at a fixed pair that tells nothing but itself; with samples of ten seconds of it, or with the operation changed since.
    let minute = |number: i64| {
        json!({"cycle_id": format!("t{number}"), "tool": "E1", "operation": "L1", "started_at": at(number * 6),
            "spindle_speed_rpm": 600, "reported": {"duration_ms": 60000, "feed_mm_rev": 0.4}})
    };
    let after = async |change: &dyn Fn(&mut Value)| {
        let shop = opened().await;
        mount(&shop, "mounted_new").await;
        for number in 1..=3 {
            let mut cycle = minute(number);
            change(&mut cycle);
            assert_eq!(shop.cycle("M1", &cycle).await.status, 201);
        }
        shop
    };
    let told = asked(&after(&|_| ()).await).await["process_advice"].clone();
    assert_eq!(told["turning"]["elapsed_min"], 3.0, "{told}");
    let sampled = |cycle: &mut Value| {
        cycle["samples"] = json!({"period_ms": 100, "spindle_power_watts": vec![1000.0; 100]});
    };
    let shop = after(&sampled).await;
    assert_eq!(asked(&shop).await["process_advice"], told, "ten seconds of samples say nothing of a minute");
    // Another depth and diameter from now on.
    let mut changed = operation("alaskari-oraby-2017");
    changed["turning"]["depth_mm"] = 1.5.into();
    changed["turning"]["diameter_mm"] = 40.0.into();
    let put = shop.client.put(shop.url("/v1/operations/L1")).header("if-match", "\"1\"").json(&changed);
    assert_eq!(shop.send(put).await.status, 200);
    let turning = asked(&shop).await["process_advice"]["turning"].clone();
    assert_eq!(turning["corrections"]["wear_mm"], told["turning"]["corrections"]["wear_mm"], "{turning}");
    // Of one that was kept in part, or has no time, nobody knows how it wore the edge.
    shop.cut_short("t2").await;
    assert!(says(&asked(&shop).await, "turning_history_untold"));
    let shop = after(&|cycle| {
        if cycle["cycle_id"] == "t2" {
            cycle["started_at"] = "1999-01-01T00:00:00Z".into();
        }
    })
    .await;
    let untold = asked(&shop).await;
    assert!(says(&untold, "turning_history_untold") && untold["process_advice"].is_null(), "{untold}");
}

#[tokio::test]
async fn an_edge_of_long_ago_gets_no_pair_and_one_whose_wear_speeds_up_is_answered() {
    let shop = opened().await;
    let event = json!({"kind": "mounted_new", "at": "2026-05-01T06:00:00Z", "reason": "as the story goes"});
    assert_eq!(shop.post("/v1/tools/E1/events", &event).await.status, 201);
    let plan = intervals(&shop).await;
    let mut long_ago = cut(1, &plan[0]);
    long_ago["started_at"] = "2026-05-01T07:00:00Z".into();
    let answer = shop.cycle("M1", &long_ago).await;
    let advice = &answer.body["recommendation"];
    assert!(says(advice, "data_stale") && !says(advice, "turning_advised"), "{advice}");
    assert!(advice["process_advice"]["turning"]["next"].is_null());
    assert_eq!(advice["override_percent"], 100.0);

    let mut entry = shop.get("/v1/models/turning/alaskari-oraby-2017").await.body;
    for told in ["model", "id", "version", "updated_at"] {
        entry.as_object_mut().unwrap().remove(told);
    }
    entry["wear"]["time_exponent"] = 1.2.into();
    entry["wear"]["coefficient"] = 2e-3.into();
    let put = shop.put("/v1/models/turning/faster", &entry).await;
    assert_eq!(put.status, 201, "{}", put.text);
    let mut faster = operation("faster");
    faster["turning"]["accumulation"] = "state".into();
    assert_eq!(shop.put("/v1/operations/L2", &faster).await.status, 201);
    mount(&shop, "mounted_new").await;
    let mut first =
        cut(2, &json!({"speed_m_min": 120.0, "feed_mm_rev": 0.3, "force_n": 600.0, "power_kw": 2.2389}));
    first["operation"] = "L2".into();
    let answer = shop.cycle("M1", &first).await;
    assert_eq!(answer.status, 201, "{}", answer.text);
    let turning = &answer.body["recommendation"]["process_advice"]["turning"];
    assert!(turning["corrections"]["wear_mm"]["value"].is_number(), "{}", answer.text);
}

#[tokio::test]
async fn a_setup_belongs_to_its_process_and_its_numbers_are_checked() {
    let shop = Shop::open().await;
    let put = async |body: Value| super::refusal(&shop.put("/v1/operations/X", &body).await);
    let mut body = operation("m");
    body["process"] = "milling".into();
    assert_eq!(put(body).await, ("other_process".to_owned(), "turning".to_owned()));
    let mut body = operation("m");
    body["turning"]["depth_mm"] = 0.into();
    assert_eq!(put(body).await, ("out_of_range".to_owned(), "turning.depth_mm".to_owned()));
    let mut body = operation("m");
    body["turning"]["depth"] = 1.into();
    assert_eq!(put(body).await, ("unknown_field".to_owned(), "turning.depth".to_owned()));
    // Read back as it was put.
    shop.put("/v1/operations/X", &operation("m")).await;
    let stored = shop.get("/v1/operations/X").await.body;
    assert_eq!(
        (&stored["turning"]["model"], &stored["turning"]["caution_sigmas"]),
        (&json!("m"), &json!(0.0))
    );
}

#[tokio::test]
async fn a_plunge_carries_its_feed() {
    let shop = Shop::open().await;
    let operation = json!({"name": "Hole 12", "process": "plunge", "plunge": {"material": "c45",
        "drill": {"diameter_mm": 12, "length_mm": 100, "spindle_rpm": 800},
        "latency": {"allowed_bite_mm": 0.1, "detector_samples": 4, "sample_period_s": 0.01, "answer_age_s": 0.02}}});
    assert_eq!(shop.put("/v1/operations/P1", &operation).await.status, 201);
    let ask = async || shop.get("/v1/recommendations?machine=M1&operation=P1&tool=T1").await.body;
    assert!(says(&ask().await, "plunge_material_missing"));
    let material = json!({"name": "C45",
        "thrust": {"coefficient": 680, "diameter_exponent": 1.0, "feed_exponent": 0.7, "correction": 1.0},
        "torque": {"coefficient": 345, "diameter_exponent": 2.0, "feed_exponent": 0.8, "correction": 1.0}});
    assert_eq!(shop.put("/v1/models/plunge/c45", &material).await.status, 201);
    let advice = ask().await["process_advice"]["plunge"].clone();
    assert_eq!(advice["limit"], "loop_latency");
    assert!((advice["feed_mm_min"].as_f64().unwrap() - 100.0).abs() < 1e-9, "{advice}");
}

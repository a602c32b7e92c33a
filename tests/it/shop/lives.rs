//! The life of a tool, told over HTTP.

use super::{Shop, at, reported};
use serde_json::{Value, json};

crate::engines::on_both!(
    a_tool_wears_is_alarmed_and_changed,
    a_broken_tool_is_suspected_at_once_and_an_air_cut_told_from_it_by_the_next_cycle,
    changed_conditions_are_alarmed_and_confirmed_by_an_engineer,
    unregistered_tools_are_kept_and_counted_once_they_are_registered,
    late_and_shuffled_cycles_end_in_the_same_verdict,
    a_tool_that_moves_between_machines_has_one_verdict,
    a_clock_that_was_never_set_spoils_nothing,
    an_event_may_name_a_cycle_that_has_not_come_yet,
    another_rating_is_another_baseline_and_no_wear,
);

async fn state_after(shop: &Shop, cycles: &[(i64, f64)]) -> Value {
    let mut last = Value::Null;
    for (number, joules) in cycles {
        let answer = shop.cycle("M1", &reported(*number, *joules)).await;
        assert_eq!(answer.status, 201, "{}", answer.text);
        last = answer.body["wear"].clone();
    }
    last
}

async fn a_tool_wears_is_alarmed_and_changed() {
    let shop = Shop::open().await;
    let mut cycles: Vec<(i64, f64)> = (1..=5).map(|number| (number, 1000.0)).collect();
    cycles.extend((6..=30).map(|number| (number, 1000.0 + 5.0 * (number - 5) as f64)));
    let wear = state_after(&shop, &cycles).await;
    assert_eq!(wear["state"], "worn", "{wear}");
    let alarms = shop.get("/v1/alarms?open=true").await;
    let open: Vec<&Value> = alarms.body["items"].as_array().unwrap().iter().collect();
    assert_eq!(
        (open.len(), &open[0]["kind"], &open[0]["tool"]),
        (1, &json!("worn"), &json!("T1")),
        "{}",
        alarms.text
    );
    let event = json!({"kind": "changed", "at": at(31), "reason": "worn"});
    assert_eq!(shop.post("/v1/tools/T1/events", &event).await.status, 201);
    let wear = state_after(&shop, &[(31, 1000.0)]).await;
    assert_eq!((&wear["state"], &wear["life"]), (&json!("learning"), &json!(2)));
    assert_eq!(shop.get("/v1/alarms?open=true").await.body["items"], json!([]));
    let audit = shop.get("/v1/audit").await;
    assert!(audit.text.contains("worn") && audit.text.contains("tool/T1"), "{}", audit.text);
}

async fn a_broken_tool_is_suspected_at_once_and_an_air_cut_told_from_it_by_the_next_cycle() {
    let shop = Shop::open().await;
    let good: Vec<(i64, f64)> = (1..=8).map(|number| (number, 1000.0)).collect();
    state_after(&shop, &good).await;
    let answer = shop.cycle("M1", &reported(9, 80.0)).await;
    assert_eq!(answer.body["wear"]["state"], "broken_suspected");
    assert_eq!(answer.body["recommendation"]["action"], "check_tool");
    assert_eq!(answer.body["recommendation"]["override_percent"], 100.0);
    assert!(shop.get("/v1/alarms?open=true").await.text.contains("broken_suspected"));
    let wear = state_after(&shop, &[(10, 1000.0)]).await;
    assert_eq!((&wear["state"], &wear["excluded"]), (&json!("good"), &json!({"air_cut": 1})));
    assert_eq!(wear["last_excluded"], json!([{"machine": "M1", "cycle_id": "c9", "reason": "air_cut"}]));
    assert_eq!(shop.get("/v1/alarms?open=true").await.body["items"], json!([]));
}

async fn changed_conditions_are_alarmed_and_confirmed_by_an_engineer() {
    let shop = Shop::open().await;
    let good: Vec<(i64, f64)> = (1..=8).map(|number| (number, 1000.0)).collect();
    state_after(&shop, &good).await;
    let wear = state_after(&shop, &[(9, 1340.0), (10, 1340.0), (11, 1340.0)]).await;
    assert_eq!(wear["state"], "changed");
    assert!(shop.get("/v1/alarms?open=true").await.text.contains("conditions_changed"));
    let event = json!({"kind": "conditions_confirmed", "at": at(12), "reason": "thicker sheet"});
    assert_eq!(shop.post("/v1/tools/T1/events", &event).await.status, 201);
    let next: Vec<(i64, f64)> = (12..=16).map(|number| (number, 1340.0)).collect();
    let wear = state_after(&shop, &next).await;
    assert_eq!((&wear["state"], &wear["level"]["as_run"]), (&json!("good"), &json!(1.0)), "{wear}");
}

async fn unregistered_tools_are_kept_and_counted_once_they_are_registered() {
    let shop = Shop::open().await;
    for number in 1..=6 {
        let mut cycle = reported(number, 1000.0);
        cycle["tool"] = "N1".into();
        cycle["operation"] = "night".into();
        let answer = shop.cycle("M1", &cycle).await;
        assert_eq!((answer.status, &answer.body["registered"]), (201, &json!(false)));
        assert_eq!(answer.body["recommendation"]["override_percent"], 100.0);
        assert_eq!(answer.body["wear"]["state"], "unknown");
    }
    assert_eq!(shop.get("/v1/tools/N1/wear").await.status, 404);
    assert_eq!(shop.put("/v1/tools/N1", &json!({"name": "night tool", "tool_type": "fd"})).await.status, 201);
    let wear = shop.get("/v1/tools/N1/wear").await;
    assert_eq!(
        (&wear.body["state"], &wear.body["excluded"]["operation_unregistered"]),
        (&json!("unknown"), &json!(6))
    );
    assert_eq!(shop.put("/v1/operations/night", &super::operation()).await.status, 201);
    let wear = shop.get("/v1/tools/N1/wear").await;
    assert_eq!((&wear.body["state"], &wear.body["counted"]), (&json!("good"), &json!(6)), "{}", wear.text);
}

async fn late_and_shuffled_cycles_end_in_the_same_verdict() {
    let energies: Vec<(i64, f64)> = (1..=60)
        .map(|number| (number, if number == 20 { 90.0 } else { 1000.0 + 1.5 * number as f64 }))
        .collect();
    let in_order = Shop::open().await;
    state_after(&in_order, &energies).await;
    let shuffled = Shop::open().await;
    let mut order = energies.clone();
    order.sort_by_key(|(number, _)| (number * 37) % 61);
    state_after(&shuffled, &order).await;
    let verdict = |text: String| text;
    assert_eq!(
        verdict(in_order.get("/v1/tools/T1/wear").await.text),
        verdict(shuffled.get("/v1/tools/T1/wear").await.text)
    );
}

async fn a_tool_that_moves_between_machines_has_one_verdict() {
    let shop = Shop::open().await;
    let good: Vec<(i64, f64)> =
        (1..=10).map(|number| (number, if number > 5 { 1060.0 } else { 1000.0 })).collect();
    state_after(&shop, &good).await;
    for number in 11..=20 {
        let joules = if number > 15 { 1050.0 } else { 1000.0 };
        assert_eq!(shop.cycle("M2", &reported(number, joules)).await.status, 201);
    }
    let wear = shop.get("/v1/tools/T1/wear").await;
    // 1.06 on the first machine is carried over to the second, where it grows by 5 %.
    let level = wear.body["level"]["as_run"].as_f64().unwrap();
    assert!((level - 1.113).abs() < 1e-9, "{}", wear.text);
    assert_eq!(wear.body["state"], "worn");
}

async fn a_clock_that_was_never_set_spoils_nothing() {
    let shop = Shop::open().await;
    let mut early = reported(1, 5000.0);
    early["started_at"] = "1970-01-01T00:00:12Z".into();
    let answer = shop.cycle("M1", &early).await;
    assert_eq!(answer.status, 201, "{}", answer.text);
    assert!(answer.body["summary"]["flags"].to_string().contains("clock_suspect"));
    assert_eq!(answer.body["wear"]["excluded"]["clock_suspect"], 1);
    let event = json!({"kind": "mounted_new", "at": at(5)});
    assert_eq!(shop.post("/v1/tools/T1/events", &event).await.status, 201);
    let wear = state_after(&shop, &[(2, 900.0), (3, 900.0)]).await;
    assert_eq!(wear["counted"], 0, "before the tool was mounted: {wear}");
    let wear = state_after(&shop, &[(5, 1000.0), (6, 1000.0), (7, 1000.0), (8, 1000.0), (9, 1000.0)]).await;
    assert_eq!((&wear["state"], &wear["cycles"]), (&json!("good"), &json!(5)));
}

async fn an_event_may_name_a_cycle_that_has_not_come_yet() {
    for (kind, cycles) in [("changed", 6), ("reground", 6), ("mounted_new", 6), ("conditions_confirmed", 12)]
    {
        let shop = Shop::open().await;
        let first: Vec<(i64, f64)> = (1..=6).map(|number| (number, 1000.0)).collect();
        state_after(&shop, &first).await;
        let event = json!({"kind": kind, "at": at(7), "reason": "worn",
            "first_cycle": {"machine": "M1", "cycle_id": "c7"}});
        assert_eq!(shop.post("/v1/tools/T1/events", &event).await.status, 201);
        let lines: Vec<String> = (7..=12).map(|number| reported(number, 1000.0).to_string()).collect();
        let path = "/v1/machines/M1/cycles/batch";
        let answer = shop.post_raw(path, "application/x-ndjson", lines.join("\n")).await;
        assert_eq!(answer.status, 200, "{}", answer.text);
        let wear = shop.get("/v1/tools/T1/wear").await;
        assert_eq!(
            (&wear.body["cycles"], &wear.body["state"]),
            (&json!(cycles), &json!("good")),
            "{kind}: {}",
            wear.text
        );
    }
}

async fn another_rating_is_another_baseline_and_no_wear() {
    let shop = Shop::open().await;
    let loaded = |number: i64| {
        json!({"cycle_id": format!("c{number}"), "tool": "T1", "operation": "O1", "started_at": at(number),
            "samples": {"period_ms": 10, "spindle_load_percent": vec![30.0; 400]}})
    };
    for number in 1..=10 {
        assert_eq!(shop.cycle("M1", &loaded(number)).await.status, 201);
    }
    let mut machine = super::machine();
    machine["spindle"]["rated_power_watts"] = 7770.into();
    let request = shop.client.put(shop.url("/v1/machines/M1")).header("if-match", "\"1\"").json(&machine);
    assert_eq!(shop.send(request).await.status, 200);
    for number in 11..=20 {
        assert_eq!(shop.cycle("M1", &loaded(number)).await.status, 201);
    }
    let wear = shop.get("/v1/tools/T1/wear").await;
    assert_eq!(
        (&wear.body["state"], &wear.body["level"]["as_run"]),
        (&json!("good"), &json!(1.0)),
        "{}",
        wear.text
    );
    assert_eq!(wear.body["baselines"].as_array().unwrap().len(), 2);
}

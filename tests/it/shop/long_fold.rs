//! A tool with more cycles than are folded while anybody waits: the server goes on with it by itself, and the page of the tool says so.

use super::Shop;
use serde_json::{Value, json};
use std::time::{Duration, Instant};

crate::engines::on_both!(a_cycle_before_a_long_history_is_counted_by_the_server_itself);

/// More than are folded at once.
const CYCLES: i64 = 10_300;
/// Lines of a batch.
const BATCH: usize = 2_500;
/// It takes a second or two here.
const PATIENCE: Duration = Duration::from_secs(60);

/// The cycle of that second of the day before.
fn cycle(second: i64) -> Value {
    let (hours, minutes, seconds) = (second / 3600, second / 60 % 60, second % 60);
    json!({
        "cycle_id": format!("h{second}"), "tool": "T1", "operation": "O1",
        "started_at": format!("2026-05-03T{hours:02}:{minutes:02}:{seconds:02}Z"),
        "strategy": "f_lin", "spindle_speed_rpm": 2500,
        "reported": {"energy_joules": 1000 + second * 7919 % 41, "duration_ms": 4280},
    })
}

fn codes(wear: &Value) -> Vec<&str> {
    wear["reasons"].as_array().unwrap().iter().map(|reason| reason["code"].as_str().unwrap()).collect()
}

async fn a_cycle_before_a_long_history_is_counted_by_the_server_itself() {
    let shop = Shop::open().await;
    let seconds: Vec<i64> = (1..=CYCLES).collect();
    for batch in seconds.chunks(BATCH) {
        let lines = batch.iter().map(|second| format!("{}\n", cycle(*second))).collect::<String>();
        let answer = shop.post_raw("/v1/machines/M1/cycles/batch", "application/x-ndjson", lines).await;
        let stored = answer.text.matches(r#""outcome":"stored""#).count();
        assert_eq!((answer.status, stored), (200, batch.len()), "{}", answer.text);
    }
    let before = shop.get("/v1/tools/T1/wear").await.body;
    assert_eq!((&before["state"], &before["cycles"]), (&json!("good"), &json!(CYCLES)), "{before}");

    let late = shop.cycle("M1", &cycle(0)).await;
    assert_eq!(late.status, 201, "{}", late.text);
    assert_eq!(late.body["wear"]["state"], "unknown", "{}", late.text);
    assert_eq!(late.body["recommendation"]["override_percent"], 100.0, "what is unknown raises no feed");
    let begun = Instant::now();
    loop {
        let wear = shop.get("/v1/tools/T1/wear").await.body;
        if codes(&wear) != ["being_counted"] {
            assert_eq!((&wear["state"], &wear["cycles"]), (&json!("good"), &json!(CYCLES + 1)), "{wear}");
            break;
        }
        assert!(begun.elapsed() < PATIENCE, "nobody goes on with it");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let next = shop.cycle("M1", &cycle(CYCLES + 1)).await;
    assert_eq!((next.status, &next.body["wear"]["state"]), (201, &json!("good")), "{}", next.text);
}

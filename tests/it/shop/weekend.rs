//! A weekend without the line: what machines kept comes late, shuffled and all at once, while others post live. What
//! it comes to is what it would have come to in order.

use super::{Shop, at};
use serde_json::{Value, json};
use std::collections::BTreeSet;

crate::engines::on_both!(a_shuffled_replay_beside_live_posts_comes_to_what_order_comes_to);

/// Cycles of the tool; it moves from one machine to the other and back.
const CYCLES: i64 = 160;
/// Lines of a batch.
const BATCH: usize = 12;

/// Machine and body of a cycle: its energy creeps up, and every seventh is far off.
fn cycle(number: i64) -> (&'static str, Value) {
    let machine = if number / 40 % 2 == 0 { "M1" } else { "M2" };
    #[expect(clippy::cast_precision_loss, reason = "a small number")]
    let joules =
        1000.0 + 1.5 * number as f64 + (number * 7919 % 41) as f64 + if number % 7 == 0 { 90.0 } else { 0.0 };
    let body = json!({
        "cycle_id": format!("w{number}"), "tool": "T1", "operation": "O1", "started_at": at(number), "seq": number,
        "strategy": "f_lin", "spindle_speed_rpm": 2500,
        "reported": {"energy_joules": joules, "duration_ms": 4280},
    });
    (machine, body)
}

/// A live post of another tool.
fn live(number: i64) -> Value {
    json!({
        "cycle_id": format!("l{number}"), "tool": "T2", "operation": "O1", "started_at": at(number),
        "samples": {"period_ms": 10, "spindle_load_percent": vec![20.0; 200]},
    })
}

async fn prepared() -> Shop {
    let shop = Shop::open().await;
    let tool = json!({"name": "FD M8 no. 2", "tool_type": "fd-7.3"});
    assert_eq!(shop.put("/v1/tools/T2", &tool).await.status, 201);
    // Reground on Sunday: which cycles come before it decides what is learnt anew.
    let event = json!({"kind": "reground", "at": at(71), "reason": "worn"});
    assert!(shop.post("/v1/tools/T1/events", &event).await.status < 300);
    shop
}

/// The same numbers in another order, always the same one.
fn shuffled(mut numbers: Vec<i64>) -> Vec<i64> {
    let mut noise = 0x9E37_79B9_7F4A_7C15_u64;
    for last in (1..numbers.len()).rev() {
        noise ^= noise << 13;
        noise ^= noise >> 7;
        noise ^= noise << 17;
        let other = usize::try_from(noise % (last as u64 + 1)).unwrap();
        numbers.swap(last, other);
    }
    numbers
}

/// What is to be the same: the verdict, every cycle, and the levels after each.
async fn outcome(shop: &Shop) -> Vec<Value> {
    let mut outcome = Vec::new();
    for path in [
        "/v1/tools/T1/wear",
        "/v1/tools/T2/wear",
        "/v1/cycles?tool=T1&limit=1000",
        "/v1/series?tool=T1&last=1000&measures=energy_joules,wear_level_ratio",
    ] {
        let answer = shop.get(path).await;
        assert_eq!(answer.status, 200, "{path}: {}", answer.text);
        outcome.push(answer.body);
    }
    let question = "/v1/recommendations?machine=M1&operation=O1&tool=T1";
    let mut advice = shop.get(question).await.body;
    assert_eq!(advice.as_object_mut().unwrap().remove("id").map(|id| id.is_string()), Some(true), "{advice}");
    outcome.push(advice);
    outcome
}

async fn a_shuffled_replay_beside_live_posts_comes_to_what_order_comes_to() {
    let in_order = prepared().await;
    for number in 0..CYCLES {
        let (machine, body) = cycle(number);
        assert_eq!(in_order.cycle(machine, &body).await.status, 201);
    }
    for number in 0..CYCLES {
        assert_eq!(in_order.cycle("M2", &live(number)).await.status, 201);
    }
    let expected = outcome(&in_order).await;
    assert_eq!(expected[0]["cycles"], CYCLES - 71, "what came since it was reground: {}", expected[0]);

    let late = prepared().await;
    let replays = ["M1", "M2"].map(|machine| {
        let numbers = shuffled((0..CYCLES).filter(|number| cycle(*number).0 == machine).collect());
        let late = &late;
        async move {
            let mut stored = BTreeSet::new();
            for batch in numbers.chunks(BATCH) {
                let lines: Vec<String> = batch.iter().map(|number| cycle(*number).1.to_string()).collect();
                // Twice, as an edge buffer does that did not hear the answer.
                for again in [false, true] {
                    let path = format!("/v1/machines/{machine}/cycles/batch");
                    let answer = late.post_raw(&path, "application/x-ndjson", lines.join("\n")).await;
                    assert_eq!(answer.status, 200, "{}", answer.text);
                    let word = if again { "\"known\"" } else { "\"stored\"" };
                    assert_eq!(answer.text.matches(word).count(), lines.len(), "{}", answer.text);
                }
                stored.extend(batch.iter().copied());
            }
            stored.len()
        }
    });
    let [first, second] = replays;
    let live_posts = async {
        for number in shuffled((0..CYCLES).collect()) {
            let answer = late.cycle("M2", &live(number)).await;
            assert_eq!(answer.status, 201, "a live post is taken whatever is replayed: {}", answer.text);
        }
    };
    let (first, second, ()) = tokio::join!(first, second, live_posts);
    assert_eq!(i64::try_from(first + second).unwrap(), CYCLES);
    for (found, expected) in outcome(&late).await.iter().zip(&expected) {
        assert_eq!(found, expected);
    }
}

//! Wear under an adaptive law, over HTTP: masked, measured by reference cycles, the same in whatever order it arrives.

use super::{model_machine, number, worn};
use crate::shop::Shop;
use feedwright_core::friction::twin::PaperStrategies;
use serde_json::{Value, json};

/// Wear at the limit, in units of the model's wear law.
const LIMIT: f64 = 1.1;

/// Changes the operation, whatever its version.
async fn change_operation(shop: &Shop, wear: Option<&Value>) -> crate::shop::Answer {
    let mut operation = crate::shop::operation();
    if let Some(wear) = wear {
        operation["wear"] = wear.clone();
    }
    let version = shop.get("/v1/operations/O1").await.body["version"].clone();
    let request = shop.client.put(shop.url("/v1/operations/O1")).header("if-match", format!("\"{version}\""));
    shop.send(request.json(&operation)).await
}

async fn shop() -> Shop {
    let shop = Shop::open().await;
    model_machine(&shop).await;
    let line = json!({"torque": {"slope": 0.0959, "intercept": -0.4795, "min_percent": -50, "max_percent": 200,
                                 "r_squared": 1, "residual_spread": 0}});
    let answer = shop.post("/v1/machines/F1/calibrations", &line).await;
    assert_eq!(answer.status, 201, "{}", answer.text);
    let wear = json!({"baseline_cycles": 6, "window_cycles": 5, "reference_every_cycles": 4,
                      "reference_feed_mm_min": 110});
    let answer = change_operation(&shop, Some(&wear)).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    shop
}

/// Cuts what was recorded before a depth: where a machine begins to record is nobody's business. Spinning up costs
/// energy too, which no wear changes.
fn recorded_from(body: &mut Value, depth_mm: f64) {
    let depth: Vec<f64> = body["samples"]["depth_mm"].as_array().unwrap().iter().map(number).collect();
    let from = depth.iter().position(|depth| *depth >= depth_mm).unwrap();
    for column in body["samples"].as_object_mut().unwrap().values_mut() {
        if let Some(values) = column.as_array_mut() {
            values.drain(..from);
        }
    }
}

/// A life under the law that does what it is asked to. Reference cycles are told by the advice alone: the machine says
/// nothing of its strategy. Returns the bodies, and the wear over the limit's at which the tool was called.
async fn life(shop: &Shop) -> (Vec<Value>, Option<f64>) {
    let paper = PaperStrategies::new().unwrap();
    let mut advice = Value::Null;
    let mut bodies = Vec::new();
    for cycle in 1..=110_i32 {
        let wear = LIMIT * f64::from(cycle) / 80.0;
        let due = advice["reference_cycle"].is_object();
        let strategy = if due { &paper.constant } else { &paper.adaptive };
        let mut body = worn(i64::from(cycle), strategy, "f_ac", false, wear);
        if due {
            assert_eq!(advice["reference_cycle"]["feed_mm_min"], 110.0, "{advice}");
            body.as_object_mut().unwrap().remove("strategy");
        }
        body["recommendation_id"] = advice["id"].clone();
        recorded_from(&mut body, [-2.0, -0.6, 0.0, -1.2][usize::try_from(cycle).unwrap() % 4]);
        let answer = shop.cycle("F1", &body).await;
        assert_eq!(answer.status, 201, "{}", answer.text);
        bodies.push(body);
        advice = answer.body["recommendation"].clone();
        let told = &answer.body["wear"];
        if cycle == 1 {
            assert_eq!(told["feed"]["masked"], "by_control", "{told}");
            assert_eq!(told["feed"]["references"]["due_in_cycles"], 0, "{told}");
        }
        if told["state"] == "worn" {
            assert_eq!(told["level"]["decides"], "reference_cycles", "{told}");
            assert_eq!(answer.body["recommendation"]["action"], "change_tool");
            assert_eq!(advice["reference_cycle"], Value::Null, "a worn tool is changed, not measured");
            return (bodies, Some(wear / LIMIT));
        }
    }
    (bodies, None)
}

#[tokio::test]
async fn a_tool_under_the_adaptive_law_is_called_in_time_and_alike_in_any_order_of_arrival() {
    let first = shop().await;
    let (bodies, called) = life(&first).await;
    assert!(
        called.is_some_and(|wear| (wear - 1.0).abs() < 0.25),
        "called at {called:?} of the limit's wear: {}",
        first.get("/v1/tools/T1/wear").await.text
    );
    let told = first.get("/v1/tools/T1/wear").await.body;
    let feed = &told["feed"];
    let references = number(&feed["references"]["count"]);
    assert!(references >= 15.0, "{feed}");
    assert!(number(&feed["by_reference_cycles"]["value"]) >= 1.1 - 1e-9, "{feed}");
    assert!(number(&feed["by_reference_cycles"]["sd"]) < 0.03, "{feed}");
    assert!(number(&feed["compensated"]["sd"]) > 0.0 && number(&feed["masked_share"]) < 0.5, "{feed}");
    let level = number(&told["level"]["as_run"]);
    assert!(level < number(&told["level"]["value"]), "the law hides the wear from the energy as run: {told}");

    // Another shop gets the same cycles back to front, in batches, each batch with its first line twice.
    let second = shop().await;
    let reversed: Vec<&Value> = bodies.iter().rev().collect();
    for batch in reversed.chunks(7) {
        let lines: Vec<String> = batch.iter().chain(batch.first()).map(ToString::to_string).collect();
        let path = "/v1/machines/F1/cycles/batch";
        let answer = second.post_raw(path, "application/x-ndjson", lines.join("\n")).await;
        assert_eq!(answer.status, 200, "{}", answer.text);
    }
    assert_eq!(second.get("/v1/tools/T1/wear").await.body, told);
}

#[tokio::test]
async fn reference_cycles_are_asked_for_only_where_the_operation_wants_them() {
    let shop = shop().await;
    let paper = PaperStrategies::new().unwrap();
    let never = json!({"reference_every_cycles": null});
    assert_eq!(change_operation(&shop, Some(&never)).await.status, 200);
    let stored = shop.get("/v1/operations/O1").await.body;
    assert_eq!(stored["wear"]["reference_every_cycles"], Value::Null, "{stored}");
    let answer = shop.cycle("F1", &worn(1, &paper.adaptive, "f_ac", false, 0.0)).await;
    assert_eq!(answer.body["recommendation"]["reference_cycle"], Value::Null, "{}", answer.text);
    assert_eq!(answer.body["wear"]["feed"]["references"], Value::Null);
    assert_eq!(answer.body["wear"]["feed"]["masked"], "by_control");
    // Left out, it is asked for every fifty cycles; a new tool begins with them.
    assert_eq!(change_operation(&shop, None).await.status, 200);
    let answer = shop.cycle("F1", &worn(2, &paper.adaptive, "f_ac", false, 0.0)).await;
    let asked = &answer.body["recommendation"]["reference_cycle"];
    assert_eq!(
        (&asked["every_cycles"], &asked["feed_mm_min"]),
        (&json!(50), &json!(140.0)),
        "{}",
        answer.text
    );
    let again = shop.get("/v1/recommendations?machine=F1&operation=O1&tool=T1").await.body;
    assert_eq!(&again["reference_cycle"], asked, "{again}");
    let id = again["id"].as_str().unwrap();
    assert!(id.ends_with("-reference"), "{id}");
    assert_eq!(shop.get(&format!("/v1/recommendations/{id}")).await.body, again);
    for (wear, path) in [
        (json!({"reference_every_cycles": 1}), "wear.reference_every_cycles"),
        (json!({"reference_every_cycles": 100_001}), "wear.reference_every_cycles"),
        (json!({"reference_feed_mm_min": 0}), "wear.reference_feed_mm_min"),
        (json!({"reference_feed_mm_min": 1e9}), "wear.reference_feed_mm_min"),
    ] {
        let answer = change_operation(&shop, Some(&wear)).await;
        assert_eq!((answer.status, &answer.body["errors"][0]["path"]), (422, &json!(path)), "{wear}");
    }
}

/// A machine that sends no advice's id marks its reference cycles itself; what contradicts itself has a defined answer.
#[tokio::test]
async fn a_machine_may_mark_its_reference_cycles_itself() {
    let shop = shop().await;
    let paper = PaperStrategies::new().unwrap();
    let marked = |number: i64, strategy: &feedwright_core::friction::program::Strategy, is: bool| {
        let mut body = worn(number, strategy, "f_const", false, 0.0);
        body.as_object_mut().unwrap().remove("strategy");
        body["reference_cycle"] = json!(is);
        body
    };
    assert_eq!(shop.cycle("F1", &worn(1, &paper.adaptive, "f_ac", false, 0.0)).await.status, 201);
    for number in 2..=3 {
        let answer = shop.cycle("F1", &marked(number, &paper.constant, true)).await;
        assert_eq!(answer.status, 201, "{}", answer.text);
        assert_eq!(answer.body["wear"]["feed"]["references"]["count"], number - 1, "{}", answer.text);
    }
    let stored = shop.get("/v1/machines/F1/cycles/c2").await.body;
    assert_eq!(stored["reference_cycle"], true, "{stored}");
    let flagged =
        |body: &Value, flag: &str| body["summary"]["flags"].as_array().unwrap().contains(&json!(flag));
    assert!(flagged(&stored, "reference_cycle") && !flagged(&stored, "contradictory"), "{stored}");
    // The same again is the same; without its mark it is another cycle.
    assert_eq!(shop.cycle("F1", &marked(2, &paper.constant, true)).await.status, 200);
    assert_eq!(shop.cycle("F1", &marked(2, &paper.constant, false)).await.status, 409);

    // What ran is believed before what is said of it.
    let varied = shop.cycle("F1", &marked(4, &paper.linear, true)).await;
    assert_eq!(varied.status, 201, "{}", varied.text);
    assert!(flagged(&varied.body, "contradictory"), "{}", varied.text);
    assert_eq!(varied.body["wear"]["feed"]["references"]["count"], 2, "{}", varied.text);
    // Asked for, and said not to have been run.
    let advice = varied.body["recommendation"].clone();
    assert!(advice["reference_cycle"].is_object(), "{advice}");
    let mut refused = marked(5, &paper.constant, false);
    refused["recommendation_id"] = advice["id"].clone();
    let answer = shop.cycle("F1", &refused).await;
    assert_eq!(answer.body["wear"]["feed"]["references"]["count"], 2, "{}", answer.text);
    // Of a cycle without samples nothing contradicts it.
    let mut told = crate::shop::reported(6, 1990.0);
    told["reference_cycle"] = json!(true);
    let answer = shop.cycle("F1", &told).await;
    assert_eq!(answer.status, 201, "{}", answer.text);

    for (field, value) in [
        ("strategy", json!("f_ac")),
        ("strategy", json!("f_lin")),
        ("law_version", json!("v1")),
        ("process", json!("drilling")),
    ] {
        let mut body = marked(9, &paper.constant, true);
        body[field] = value;
        let answer = shop.cycle("F1", &body).await;
        assert_eq!(answer.status, 422, "{field}: {}", answer.text);
        let wrong = &answer.body["errors"][0];
        assert_eq!((&wrong["path"], &wrong["code"]), (&json!("reference_cycle"), &json!("contradictory")));
    }
    // Another process than the operation's is stored, and told.
    let mut body = worn(10, &paper.adaptive, "f_ac", false, 0.0);
    body["process"] = json!("plunge");
    let answer = shop.cycle("F1", &body).await;
    assert_eq!(answer.status, 201, "{}", answer.text);
    assert!(flagged(&answer.body, "contradictory"), "{}", answer.text);

    let mut body = marked(9, &paper.constant, true);
    body["reference_cycle"] = json!("yes");
    assert_eq!(shop.cycle("F1", &body).await.status, 422);
}

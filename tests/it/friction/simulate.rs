//! A hole and strategies beside each other, asked over HTTP.

use super::number;
use crate::shop::Shop;
use serde_json::{Value, json};

const PATH: &str = "/v1/friction/simulate";

fn named<'a>(answer: &'a Value, name: &str) -> &'a Value {
    let rows = answer["comparison"].as_array().unwrap();
    rows.iter().find(|row| row["name"] == name).unwrap_or_else(|| panic!("no {name} in {answer}"))
}

#[tokio::test]
async fn nothing_said_is_the_papers_comparison() {
    let shop = Shop::open().await;
    let answer = shop.post(PATH, &json!({})).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    let body = &answer.body;
    assert_eq!(body["cycle"]["name"], "F_AC");
    assert_eq!(body["samples"], Value::Null, "only where they are asked for");
    let constant = named(body, "F_Const");
    for other in ["F_Sec", "F_Lin", "F_AC"] {
        let other = named(body, other);
        for axis in ["duration", "energy"] {
            assert_eq!(constant["radar"][axis], 1.0, "F_Const is the longest and dearest");
            assert!(number(&other["radar"][axis]) < 1.0, "{other}");
        }
        assert!(number(&constant["torque_nm"]["value"]) < number(&other["torque_nm"]["value"]));
    }
    let shorter = number(&named(body, "F_Lin")["duration_s"]) / number(&named(body, "F_Sec")["duration_s"]);
    assert!((0.65..=0.75).contains(&shorter), "{shorter}");
    assert!((number(&constant["energy_j"]) - 1992.0).abs() < 40.0, "{constant}");
    let power = |name: &str| number(&named(body, name)["power_w"]["value"]);
    assert!(power("F_AC") <= 0.8 * power("F_Sec") && power("F_AC") <= 0.8 * power("F_Lin"));
    let stages = &body["cycle"]["stages"];
    assert!(number(&stages["contact_mm"]) < number(&stages["thrust_maximum_mm"]));
    assert!(number(&stages["torque_maximum_mm"]) < number(&stages["flange_mm"]));
    assert_eq!(body["model"]["operation"]["spindle_rpm"], 2800.0, "every value in force is told");
    let law = json!({"set_feed_drive_percent": 30.0, "set_spindle_percent": 40.0, "intensity": 8.47,
                     "override_min_percent": 5.0, "override_max_percent": 200.0, "rise_limit_points": 5.0, "heating_ms": 2000.0});
    assert_eq!(body["strategy"]["law"], law);
}

#[tokio::test]
async fn samples_wear_and_a_law_are_taken_and_a_seed_repeats() {
    let shop = Shop::open().await;
    let question = json!({
        "model": {"tool": {"cycles": 10000}, "machine": {"axis": {"override_latency_ipo": 3}}},
        "strategy": {"base": "f_lin", "name": "mine", "law": {"set_spindle_percent": 30}},
        "compare": [{"base": "f_const"}], "limits": {"spindle_percent": 20}, "seed": 7, "samples": true,
    });
    let answer = shop.post(PATH, &question).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    let body = &answer.body;
    assert_eq!((&body["cycle"]["name"], number(&body["model"]["tool"]["wear"])), (&json!("mine"), 1.0));
    let depth = body["samples"]["depth_mm"].as_array().unwrap();
    assert_eq!(depth.len(), body["samples"]["thrust_newtons"].as_array().unwrap().len());
    assert!(number(&depth[0]) < 0.0 && number(depth.last().unwrap()) > 20.0);
    assert!(number(&body["cycle"]["overload_s"]) > 0.0);
    assert!((number(&body["comparison"][0]["energy_j"]) / 2178.0 - 1.0).abs() < 0.08, "worn, and with noise");
    let again = shop.post(PATH, &question).await;
    assert_eq!(answer.text, again.text, "the same seed, the same hole");
    let largest = shop.post(PATH, &json!({"seed": 9_007_199_254_740_991_u64})).await;
    assert_eq!(largest.status, 200, "{}", largest.text);
    // What is answered as the model may be asked again as it stands.
    let whole = json!({"model": body["model"], "strategy": body["strategy"], "compare": [{"base": "f_const"}], "seed": 7,
                       "limits": {"spindle_percent": 20}});
    let repeated = shop.post(PATH, &whole).await;
    assert_eq!(repeated.body["cycle"], body["cycle"], "{}", repeated.text);
    // Also of a strategy without a law: nothing puts one on it.
    let plain =
        shop.post(PATH, &json!({"strategy": {"base": "f_lin"}, "compare": [{"base": "f_const"}]})).await.body;
    let again =
        json!({"model": plain["model"], "strategy": plain["strategy"], "compare": [{"base": "f_const"}]});
    assert_eq!(shop.post(PATH, &again).await.body["cycle"], plain["cycle"]);
}

#[tokio::test]
async fn what_makes_no_hole_is_refused_by_path() {
    let shop = Shop::open().await;
    let many: Vec<Value> = vec![json!({}); 9];
    for (question, path, code) in [
        (json!({"modell": {}}), "modell", "unknown_field"),
        (json!([]), "", "wrong_type"),
        (
            json!({"model": {"machine": {"ratings": {"spindle_rated_power_w": 1e-12}}}}),
            "machine.ratings.spindle_rated_power_w",
            "out_of_range",
        ),
        (json!({"model": {"tool": {"wear": -1}}}), "tool.wear", "out_of_range"),
        (json!({"model": {"tool": {"wear": 1, "cycles": 5}}}), "tool.cycles", "contradictory"),
        (json!({"model": {"tool": {"cycles": -5}}}), "tool.cycles", "out_of_range"),
        (
            json!({"model": {"operation": {"sheet": {"thickness_mm": 0}}}}),
            "operation.sheet.thickness_mm",
            "out_of_range",
        ),
        (
            json!({"model": {"machine": {"ratings": {"feed_mass_kg": -1}}}}),
            "machine.ratings.feed_mass_kg",
            "out_of_range",
        ),
        (json!({"model": {"machine": {"period_s": 2}}}), "machine.period_s", "out_of_range"),
        (json!({"model": {"noise": {"process": 9}}}), "noise.process", "out_of_range"),
        (
            json!({"strategy": {"program": {"between": "held", "knots": []}}}),
            "strategy.program.knots",
            "empty",
        ),
        (
            json!({"strategy": {"law": {"override_min_percent": 0}}}),
            "strategy.law.override_min_percent",
            "out_of_range",
        ),
        (json!({"strategy": {"name": ""}}), "strategy.name", "invalid_length"),
        (json!({"seed": 9_007_199_254_740_992_u64}), "seed", "out_of_range"),
        (json!({"seed": u64::MAX}), "seed", "out_of_range"),
        (json!({"seed": 1.0}), "seed", "wrong_type"),
        (json!({"compare": []}), "compare", "empty"),
        (json!({"compare": many}), "compare", "too_many"),
        (json!({"limits": {"spindle_percent": 0}}), "limits.spindle_percent", "out_of_range"),
        (
            json!({"compare": [{"program": {"between": "held", "knots": [{"depth_mm": 0, "feed_mm_min": 0.5}]}}]}),
            "compare[0]",
            "out_of_range",
        ),
    ] {
        let answer = shop.post(PATH, &question).await;
        assert_eq!(answer.status, 422, "{question}: {}", answer.text);
        let error = &answer.body["errors"][0];
        let path = if question["model"].is_null() || path.starts_with("modell") {
            path.to_owned()
        } else {
            format!("model.{path}")
        };
        assert_eq!((&error["path"], &error["code"]), (&json!(path), &json!(code)), "{question}");
    }
    assert_eq!(shop.post_raw(PATH, "application/json", "{\"seed\": ").await.status, 400);
    let nan = shop.post_raw(PATH, "application/json", "{\"model\": {\"tool\": {\"wear\": NaN}}}").await;
    assert_eq!((nan.status, &nan.body["code"]), (422, &json!("not_finite")), "{}", nan.text);
}

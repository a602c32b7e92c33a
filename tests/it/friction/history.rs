//! Stored cycles of the process model under another control.

use super::{drilled, model_machine, number};
use crate::shop::{Shop, at};
use feedwright_core::friction::twin::{PAPER_SPINDLE_RPM, PaperStrategies};
use serde_json::{Value, json};

async fn shop_with_history() -> Shop {
    let shop = Shop::open().await;
    model_machine(&shop).await;
    let paper = PaperStrategies::new().unwrap();
    let mut number = 1;
    for factor in [0.8, 1.0, 1.25, 0.9, 1.1, 1.0] {
        let mut strategy = paper.linear.clone();
        strategy.program = strategy.program.scaled(factor).unwrap();
        let answer = shop.cycle("F1", &drilled(number, &strategy, "f_lin", false)).await;
        assert_eq!(answer.status, 201, "{}", answer.text);
        number += 1;
    }
    for _ in 0..3 {
        let answer = shop.cycle("F1", &drilled(number, &paper.adaptive, "f_ac", false)).await;
        assert_eq!(answer.status, 201, "{}", answer.text);
        number += 1;
    }
    shop
}

const OF_C2: &str = "/v1/machines/F1/cycles/c2/what-if";

fn faster() -> Value {
    let knots = [
        (0.0, 126.0),
        (3.0, 186.0),
        (7.0, 642.0),
        (12.0, 246.0),
        (14.5, 654.0),
        (17.5, 654.0),
        (19.5, 414.0),
    ];
    let knots = knots.map(|(depth, feed)| json!({"depth_mm": depth, "feed_mm_min": feed}));
    json!({"control": {"program": {"between": "linear", "knots": knots}}})
}

#[tokio::test]
async fn the_cycles_own_feed_gives_the_cycle_back_and_a_faster_one_a_shorter_cycle() {
    let shop = shop_with_history().await;
    let same = shop.post(OF_C2, &json!({})).await;
    assert_eq!(same.status, 200, "{}", same.text);
    let error = &same.body["model_error"];
    assert!(number(&error["duration_relative"]).abs() < 0.05, "{error}");
    assert!(number(&error["energy_relative"]).abs() < 0.06, "{error}");
    assert!(number(&error["spindle_rms_points"]) < 5.0, "{error}");
    assert!(number(&error["feed_drive_rms_points"]) < 4.0, "{error}");
    assert_eq!(same.body["assumed"]["idle_source"], "before_contact");
    assert_eq!(same.body["assumed"]["energy_basis"], "rated_power");
    assert_eq!(same.body["relation"]["learned_from"], json!(["c1", "c2", "c3", "c4", "c5", "c6"]));
    assert_eq!(same.body["relation"]["includes_this_cycle"], true);
    assert_eq!(same.body["happened"]["alarm"], false, "no limit, no alarm");

    let answer = shop.post(OF_C2, &faster()).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    let (happened, predicted) = (&answer.body["happened"], &answer.body["predicted"]);
    let shorter = number(&predicted["duration_s"]) / number(&happened["duration_s"]);
    assert!((shorter - 1.0 / 1.2).abs() < 0.05, "a fifth faster: {shorter}");
    assert!(number(&predicted["peak_spindle_percent"]) > number(&happened["peak_spindle_percent"]));

    // The same under the name that it has once it is a reviewed profile.
    let profile = json!({"control": {"profile": faster()["control"]["program"]}});
    let as_profile = shop.post(OF_C2, &profile).await;
    assert_eq!(as_profile.body, answer.body, "{}", as_profile.text);
    let many = shop.post("/v1/what-if", &json!({"filter": {"machine": "F1"}, "question": profile})).await;
    assert_eq!(many.status, 200, "{}", many.text);
    assert!(
        number(&many.body["predicted"]["mean_duration_s"])
            < number(&many.body["happened"]["mean_duration_s"])
    );

    let law = json!({"control": {"law": {"set_feed_drive_percent": 20, "set_spindle_percent": 20}},
                     "limits": {"spindle_percent": 40}});
    let answer = shop.post(OF_C2, &law).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    let (happened, predicted) = (&answer.body["happened"], &answer.body["predicted"]);
    assert!(number(&predicted["duration_s"]) > number(&happened["duration_s"]), "{}", answer.text);
    assert!(number(&predicted["overload_s"]) < number(&happened["overload_s"]), "{}", answer.text);
    // What is left out of a law is what the service runs its streams by; what is asked as it was answered is answered the same.
    let in_force = &answer.body["assumed"]["law"];
    let law = json!({"set_feed_drive_percent": 20.0, "set_spindle_percent": 20.0, "intensity": 2.0, "override_min_percent": 5.0,
                     "override_max_percent": 200.0, "rise_limit_points": 5.0, "heating_ms": 2000.0});
    assert_eq!(*in_force, law, "{}", answer.text);
    let again = json!({"control": {"law": in_force}, "limits": {"spindle_percent": 40}});
    assert_eq!(shop.post(OF_C2, &again).await.body["predicted"], *predicted);
}

#[tokio::test]
async fn over_many_cycles_a_limit_is_tried_before_it_is_rolled_out() {
    let shop = shop_with_history().await;
    let reported = crate::shop::reported(20, 1000.0);
    assert_eq!(shop.cycle("F1", &reported).await.status, 201);
    let ask = |spindle: f64| json!({"filter": {"machine": "F1"}, "cycles": true, "question": {"limits": {"spindle_percent": spindle}}});
    let tight = shop.post("/v1/what-if", &ask(10.0)).await;
    assert_eq!(tight.status, 200, "{}", tight.text);
    assert_eq!((&tight.body["considered"], &tight.body["predicted_cycles"]), (&json!(10), &json!(9)));
    assert_eq!(tight.body["skipped"], json!({"no_samples": 1}));
    assert_eq!(tight.body["happened"]["alarms_per_thousand"], 1000.0);
    assert_eq!(tight.body["cycles"].as_array().unwrap().len(), 9);
    let wide = shop.post("/v1/what-if", &ask(300.0)).await;
    assert_eq!(wide.body["happened"]["alarms_per_thousand"], 0.0);
    assert_eq!(wide.body["predicted"]["alarms_per_thousand"], 0.0);
    assert!(number(&wide.body["model_error"]["duration_median"]) < 0.05, "{}", wide.text);
    // Of nothing there is no mean, no largest and no share.
    let none = shop.post("/v1/what-if", &json!({"filter": {"machine": "F9"}})).await;
    assert_eq!(
        (&none.body["considered"], &none.body["complete"]),
        (&json!(0), &json!(true)),
        "{}",
        none.text
    );
    for run in ["happened", "predicted"] {
        for figure in ["mean_duration_s", "mean_energy_j", "peak_spindle_percent", "alarms_per_thousand"] {
            assert_eq!(none.body[run].get(figure), Some(&json!(null)), "{run} {figure}");
        }
        assert_eq!(none.body[run]["overload_s"].to_string(), "0.0");
    }
    assert_eq!(none.body["model_error"]["duration_median"], json!(null));
    // Bounded, and it says so.
    let some = shop.post("/v1/what-if", &json!({"filter": {"machine": "F1"}, "most_cycles": 4})).await;
    assert_eq!((&some.body["considered"], &some.body["complete"]), (&json!(4), &json!(false)));
    assert!(some.body["continue_from"].is_string(), "{}", some.text);
    assert_eq!(some.body["cycles"], Value::Null);
    let none = shop.post("/v1/what-if", &json!({"filter": {"machine": "nobody"}})).await;
    assert_eq!((none.status, &none.body["considered"]), (200, &json!(0)));
}

#[tokio::test]
async fn a_question_goes_on_behind_the_last_cycle_also_among_those_of_one_time() {
    let shop = shop_with_history().await;
    let paper = PaperStrategies::new().unwrap();
    for number in [10, 11] {
        let mut cycle = drilled(number, &paper.adaptive, "f_ac", false);
        cycle["started_at"] = json!(at(9));
        let answer = shop.cycle("F1", &cycle).await;
        assert_eq!(answer.status, 201, "{}", answer.text);
    }
    let mut ask = json!({"filter": {"machine": "F1"}, "most_cycles": 2, "cycles": true});
    let mut seen = Vec::new();
    for _ in 0..6 {
        let page = shop.post("/v1/what-if", &ask).await;
        assert_eq!(page.status, 200, "{}", page.text);
        let cycles = page.body["cycles"].as_array().unwrap();
        seen.extend(cycles.iter().map(|cycle| cycle["cycle_id"].as_str().unwrap().to_owned()));
        assert_eq!(page.body["complete"], page.body["continue_from"].is_null(), "{}", page.text);
        ask["continue_from"] = page.body["continue_from"].clone();
    }
    assert_eq!(seen, ["c1", "c2", "c3", "c4", "c5", "c6", "c7", "c8", "c10", "c11", "c9"]);
    assert_eq!(ask["continue_from"], Value::Null, "the last page is told as such");
    // It belongs to its filter.
    let first = shop.post("/v1/what-if", &json!({"filter": {"machine": "F1"}, "most_cycles": 2})).await;
    for (filter, from) in
        [(json!({}), first.body["continue_from"].clone()), (json!({"machine": "F1"}), json!(at(5)))]
    {
        let refused = shop.post("/v1/what-if", &json!({"filter": filter, "continue_from": from})).await;
        assert_eq!(
            (refused.status, &refused.body["code"]),
            (422, &json!("invalid_cursor")),
            "{}",
            refused.text
        );
        assert_eq!(refused.body["errors"][0]["path"], "continue_from");
    }
}

#[tokio::test]
async fn a_cycle_is_answered_the_same_alone_and_among_shallower_and_deeper_ones() {
    let shop = Shop::open().await;
    model_machine(&shop).await;
    let paper = PaperStrategies::new().unwrap();
    for (number, factor) in (1..).zip([1.0, 0.8, 1.25, 0.9, 1.1]) {
        let mut strategy = paper.linear.clone();
        strategy.program = strategy.program.scaled(factor).unwrap();
        let mut cycle = drilled(number, &strategy, "f_lin", false);
        if number == 1 {
            // The first hole was given up before the loads rise.
            let depth = cycle["samples"]["depth_mm"].as_array().unwrap();
            let kept = depth.iter().position(|depth| super::number(depth) > 6.0).unwrap();
            for column in cycle["samples"].as_object_mut().unwrap().values_mut() {
                if let Some(column) = column.as_array_mut() {
                    column.truncate(kept);
                }
            }
        }
        let answer = shop.cycle("F1", &cycle).await;
        assert_eq!(answer.status, 201, "{}", answer.text);
    }
    let mut alone = Vec::new();
    for number in 1..=5 {
        let answer = shop.post(&format!("/v1/machines/F1/cycles/c{number}/what-if"), &faster()).await;
        assert_eq!(answer.status, 200, "{}", answer.text);
        alone.push(answer.body);
    }
    assert!(number(&alone[1]["happened"]["duration_s"]) > number(&alone[0]["happened"]["duration_s"]));
    for most in [1, 2, 5] {
        let mut ask =
            json!({"filter": {"machine": "F1"}, "cycles": true, "most_cycles": most, "question": faster()});
        let mut together = Vec::new();
        loop {
            let page = shop.post("/v1/what-if", &ask).await;
            assert_eq!(page.status, 200, "{}", page.text);
            together.extend(page.body["cycles"].as_array().unwrap().clone());
            ask["continue_from"] = page.body["continue_from"].clone();
            if ask["continue_from"].is_null() {
                break;
            }
        }
        assert_eq!(together, alone, "{most} at a time");
    }
}

#[tokio::test]
async fn what_cannot_be_asked_is_refused() {
    let shop = shop_with_history().await;
    for (question, path) in [
        (json!({"controll": {}}), "controll"),
        (json!({"control": {"program": {"between": "held", "knots": []}}}), "control.program.knots"),
        (json!({"control": {"law": {"intensity": -1}}}), "control.law.intensity"),
        (json!({"limits": {"spindle_percent": -1}}), "limits.spindle_percent"),
        (json!({"limits": {"tolerated_overload_s": -1}}), "limits.tolerated_overload_s"),
        (json!({"axis": {"override_latency_ipo": 99}}), "axis.override_latency_ipo"),
        (json!({"idle": {"feed_drive_percent": 1000, "spindle_percent": 1}}), "idle.feed_drive_percent"),
    ] {
        let answer = shop.post(OF_C2, &question).await;
        assert_eq!(answer.status, 422, "{question}: {}", answer.text);
        assert_eq!(answer.body["errors"][0]["path"], path, "{question}");
        let many = shop.post("/v1/what-if", &json!({"question": question})).await;
        assert_eq!(many.status, 422, "{question}: {}", many.text);
        assert_eq!(many.body["errors"][0]["path"], format!("question.{path}"), "{question}");
    }
    assert_eq!(shop.post("/v1/what-if", &json!({"most_cycles": 0})).await.status, 422);
    assert_eq!(shop.post("/v1/machines/F1/cycles/none/what-if", &json!({})).await.status, 404);
    assert_eq!(shop.cycle("F1", &crate::shop::reported(20, 1000.0)).await.status, 201);
    let empty = shop.post("/v1/machines/F1/cycles/c20/what-if", &json!({})).await;
    assert_eq!((empty.status, &empty.body["code"]), (422, &json!("cycle_not_usable")), "{}", empty.text);
    assert_eq!(empty.body["reason"], "no_samples");
}

#[tokio::test]
async fn a_cycle_that_names_no_speed_ran_at_that_of_its_operation() {
    let shop = shop_with_history().await;
    let mut cycle = drilled(20, &PaperStrategies::new().unwrap().linear, "f_lin", false);
    cycle["operation"] = json!("O2");
    cycle.as_object_mut().unwrap().remove("spindle_speed_rpm");
    assert_eq!(shop.cycle("F1", &cycle).await.status, 201);
    let of_it = "/v1/machines/F1/cycles/c20/what-if";
    let unknown = shop.post(of_it, &json!({})).await;
    assert_eq!(
        (unknown.status, &unknown.body["reason"]),
        (422, &json!("no_spindle_speed")),
        "{}",
        unknown.text
    );
    let operation = json!({"name": "Bush", "process": "friction", "programmed_feed_mm_min": 150,
                           "spindle_speed_rpm": PAPER_SPINDLE_RPM});
    assert_eq!(shop.put("/v1/operations/O2", &operation).await.status, 201);
    let known = shop.post(of_it, &json!({})).await;
    assert_eq!(known.status, 200, "{}", known.text);
    let error = number(&known.body["model_error"]["energy_relative"]);
    assert!(error.abs() < 0.06, "{error}");
}

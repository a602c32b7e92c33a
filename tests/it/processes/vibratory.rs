//! Simulation, border, tuning, closed loop and recorded blocks.

use super::refuses;
use crate::shop::Shop;
use serde_json::json;

const CONTROL: &str = r#"{"adaptation":0.002,"target":0.9,"actuator_limit":0.1}"#;

#[tokio::test]
async fn the_points_of_the_paper_come_over_http() {
    let shop = Shop::open().await;
    let control: serde_json::Value = serde_json::from_str(CONTROL).unwrap();
    let free = json!({"frequency_ratio": 1.5, "cutting_coefficient": 0.1, "trace_every": 100});
    let answer = shop.post("/v1/vibratory/simulate", &free).await;
    assert!((answer.body["steady"]["continuity"].as_f64().unwrap() - 0.702).abs() < 0.01, "{}", answer.text);
    assert_eq!(answer.body["trace"].as_array().unwrap().len(), 500);
    let held = json!({"frequency_ratio": 1.5, "cutting_coefficient": 0.1, "control": control});
    let answer = shop.post("/v1/vibratory/simulate", &held).await;
    assert!((answer.body["steady"]["continuity"].as_f64().unwrap() - 0.898).abs() < 0.015, "{}", answer.text);
    let unstable = json!({"frequency_ratio": 1.2, "cutting_coefficient": 0.1, "control": held["control"]});
    assert_eq!(shop.post("/v1/vibratory/simulate", &unstable).await.body["steady"]["bursting"], true);
    let border = shop.post("/v1/vibratory/border", &json!({"frequency_ratios": [1.2, 1.5, 1.7]})).await;
    for (point, expected) in border.body["points"].as_array().unwrap().iter().zip([0.3947, 0.0661, 0.0275]) {
        assert!((point["cutting_coefficient"].as_f64().unwrap() - expected).abs() < 1e-4, "{point}");
    }
}

#[tokio::test]
async fn a_run_that_grows_without_end_is_flagged_and_has_no_numbers() {
    let shop = Shop::open().await;
    let settings = json!({"damping": 0, "exponent": 2});
    let endless =
        json!({"frequency_ratio": 1.5, "cutting_coefficient": 100, "settings": settings, "trace_every": 100});
    let answer = shop.post("/v1/vibratory/simulate", &endless).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    let steady = &answer.body["steady"];
    assert_eq!((&steady["diverged"], &steady["segmented"]), (&json!(true), &json!(false)));
    assert_eq!((&steady["amplitude"], &steady["largest_amplitude"]), (&json!(null), &json!(null)));
    assert!(answer.body["trace"].as_array().unwrap().iter().all(|point| point["displacement"].is_f64()));
    let map = json!({"frequency_ratio": {"min": 1.4, "max": 1.5, "count": 2},
        "cutting_coefficient": {"min": 0.01, "max": 100, "count": 2}, "settings": settings});
    let map = shop.post("/v1/vibratory/map", &map).await;
    assert_eq!(map.body["diverged"], json!([false, false, true, true]), "{}", map.text);
    assert!(map.body["amplitude"][1].is_f64() && map.body["amplitude"][3].is_null());
}

#[tokio::test]
async fn the_controller_holds_its_target_and_is_tuned_as_in_the_paper() {
    let shop = Shop::open().await;
    let answer = shop.post("/v1/vibratory/loop", &json!({"spindle_rpm": 3000})).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    let amplitude = |side: &str| answer.body[side]["displacement_mm"].as_f64().unwrap() * 1e3;
    assert!((amplitude("free") - 249.0).abs() < 8.0 && (amplitude("controlled") - 60.0).abs() < 2.0);
    let full =
        shop.post("/v1/vibratory/loop", &json!({"spindle_rpm": 4000, "process": {"hole": "full"}})).await;
    assert_eq!(full.body["warnings"][0]["code"], "chisel_edge_is_a_fit");
    let machine = json!({"eigenfrequency_hz": 70.86, "edges": 2, "feed_mm_edge": 0.02, "actuator_limit_n": 100,
        "speeds_rpm": [2000, 2500, 3000], "computation_s": 3e-4});
    let tuning = shop.post("/v1/vibratory/tuning", &machine).await;
    assert!((tuning.body["settings"]["target_mm"].as_f64().unwrap() - 0.06).abs() < 1e-12, "{}", tuning.text);
    assert_eq!(tuning.body["warnings"][0]["code"], "speeds_not_covered");
    let columns = shop.post("/v1/vibratory/poincare", &json!({"speeds_rpm": [2000, 3500]})).await;
    assert_eq!(columns.status, 200, "{}", columns.text);
    assert_eq!(columns.body["columns"][0]["free"]["peaks_mm"], json!([]), "2000 1/min is not excited");
    assert!(columns.body["columns"][1]["controlled"]["peaks_mm"].as_array().unwrap().len() > 60);
}

#[tokio::test]
async fn a_recorded_block_gives_its_frequency_back() {
    let shop = Shop::open().await;
    let wave = |i: u32| 0.03 * (std::f64::consts::TAU * 72.0 * f64::from(i) * 3e-4).sin();
    let values: Vec<f64> = (0..20_000).map(wave).collect();
    let force: Vec<f64> = values.iter().map(|x| if *x > 0.0 { 30.0 } else { 0.0 }).collect();
    let block = json!({"signal": "displacement", "values": values, "period_s": 3e-4, "force_n": force, "contact_force_n": 1.0});
    let answer = shop.post("/v1/vibratory/recorded", &block).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    let vibration = &answer.body["vibration"];
    assert!((vibration["frequency_hz"].as_f64().unwrap() - 72.0).abs() < 0.01);
    assert!((vibration["displacement_mm"].as_f64().unwrap() - 0.06).abs() < 1e-3);
    assert!((answer.body["continuity"].as_f64().unwrap() - 0.5).abs() < 0.01);
}

#[tokio::test]
async fn bad_questions_are_named() {
    let shop = Shop::open().await;
    let cases = [
        ("simulate", r#"{"frequency_ratio":NaN,"cutting_coefficient":0.1}"#, "not_finite", "frequency_ratio"),
        (
            "simulate",
            r#"{"frequency_ratio":1.5,"cutting_coefficient":0.1,"settings":{"damping":2}}"#,
            "out_of_range",
            "settings.damping",
        ),
        (
            "simulate",
            r#"{"frequency_ratio":60,"cutting_coefficient":0.1}"#,
            "inconsistent",
            "settings.steps_per_period",
        ),
        (
            "simulate",
            r#"{"frequency_ratio":1.5,"cutting_coefficient":0.1,"settings":{"periods":1000000}}"#,
            "too_many",
            "settings.periods",
        ),
        (
            "simulate",
            r#"{"frequency_ratio":1.5,"cutting_coefficient":0.1,"control":{"adaptation":2,"target":0.9,
            "actuator_limit":0.1}}"#,
            "out_of_range",
            "control.adaptation",
        ),
        (
            "map",
            r#"{"frequency_ratio":{"min":2,"max":1,"count":5},"cutting_coefficient":{"min":0,"max":1,"count":5}}"#,
            "inverted_range",
            "frequency_ratio",
        ),
        (
            "map",
            r#"{"frequency_ratio":{"min":1,"max":2,"count":5000},"cutting_coefficient":{"min":0,"max":1,
            "count":5000}}"#,
            "too_many",
            "frequency_ratio",
        ),
        ("border", r#"{"frequency_ratios":[1.5,-1]}"#, "out_of_range", "frequency_ratios[1]"),
        ("loop", r#"{"spindle_rpm":-5}"#, "out_of_range", "spindle_rpm"),
        ("loop", r#"{"spindle_rpm":3000,"process":{"duration_s":9000}}"#, "too_many", "process.duration_s"),
        ("loop", r#"{"spindle_rpm":3000,"process":{"stiff":1}}"#, "unknown_field", "process.stiff"),
        ("poincare", r#"{"speeds_rpm":[]}"#, "invalid_length", "speeds_rpm"),
        ("poincare", r#"{"speeds_rpm":[3000,-5]}"#, "out_of_range", "speeds_rpm[1]"),
        ("poincare", r#"{"speeds_rpm":[3000,1e6]}"#, "inconsistent", "speeds_rpm[1]"),
        ("poincare", r#"{"speeds_rpm":[3000],"process":{"damping":2}}"#, "out_of_range", "process.damping"),
        (
            "tuning",
            r#"{"eigenfrequency_hz":70.86,"edges":2,"feed_mm_edge":0.02,"speeds_rpm":[2000,0],"actuator_limit_n":100,
            "computation_s":3e-4}"#,
            "out_of_range",
            "speeds_rpm[1]",
        ),
        (
            "advice",
            r#"{"edges":2,"feed_mm_edge":0.05,"cutting_coefficient":700,"mass_kg":10,"stiffnesses_n_mm":[1000,0],
            "speeds_rpm":{"min":1000,"max":3000,"count":9},"most_amplitude_feeds":5,"scatter":0.3}"#,
            "out_of_range",
            "stiffnesses_n_mm[1]",
        ),
        (
            "advice",
            r#"{"edges":2,"feed_mm_edge":0.05,"cutting_coefficient":700,"mass_kg":10,"stiffnesses_n_mm":[1000],
            "speeds_rpm":{"min":1000,"max":3000,"count":9},"most_amplitude_feeds":5,"scatter":0.3,"periods":0}"#,
            "out_of_range",
            "periods",
        ),
        ("recorded", r#"{"signal":"velocity","values":[1,2],"period_s":0.001}"#, "too_few", "values"),
        (
            "recorded",
            r#"{"signal":"velocity","values":[1,Infinity],"period_s":0.001}"#,
            "not_finite",
            "values[1]",
        ),
    ];
    for (path, body, code, field) in cases {
        refuses(&shop, &format!("/v1/vibratory/{path}"), body, code, field).await;
    }
}

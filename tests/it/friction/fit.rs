//! A machine's lines fitted to its dynamometer cycles.

use super::{drilled, model_machine, number};
use crate::shop::{Shop, at};
use feedwright_core::friction::twin::PaperStrategies;
use serde_json::{Value, json};

crate::engines::on_both!(
    cycles_whose_samples_are_gone_are_passed_over_and_damaged_ones_are_named,
    a_line_that_cannot_be_stored_is_none,
);

const PATH: &str = "/v1/machines/F1/calibrations/fit";

#[tokio::test]
async fn lines_are_fitted_dry_first_and_then_stored_as_a_version() {
    let shop = Shop::open().await;
    model_machine(&shop).await;
    let paper = PaperStrategies::new().unwrap();
    for number in 1..=4 {
        let body = drilled(number, &paper.linear, "f_lin", number != 4);
        assert_eq!(shop.cycle("F1", &body).await.status, 201);
    }
    let dry = shop.post(PATH, &json!({"dry_run": true})).await;
    assert_eq!((dry.status, &dry.body["calibration"]), (200, &Value::Null), "{}", dry.text);
    assert_eq!((&dry.body["considered"], &dry.body["skipped"]), (&json!(4), &json!({"no_dynamometer": 1})));
    // 9000 N and 7 kW at 6970 rpm stand behind 100 %.
    let thrust = &dry.body["thrust"]["line"];
    assert!((number(&thrust["slope"]) / 90.0 - 1.0).abs() < 0.05, "{thrust}");
    let torque = &dry.body["torque"]["line"];
    assert!((number(&torque["slope"]) / 0.0959 - 1.0).abs() < 0.05, "{torque}");
    assert!(number(&torque["r_squared"]) > 0.9 && number(&torque["residual_spread"]) > 0.0);
    assert_eq!(shop.get("/v1/machines/F1/calibrations").await.body["items"], json!([]), "nothing is stored");

    let stored = shop.post(PATH, &json!({})).await;
    assert_eq!((stored.status, &stored.body["calibration"]["version"]), (201, &json!(1)), "{}", stored.text);
    assert_eq!(stored.body["thrust"], dry.body["thrust"], "as the dry run said");
    let listed = shop.get("/v1/machines/F1/calibrations").await;
    assert_eq!(listed.body["items"][0]["torque"]["slope"], torque["slope"]);
    assert_eq!(shop.post(PATH, &json!({})).await.body["calibration"]["version"], 2);
    // The next cycle is told in joules by the lines.
    let body = drilled(9, &paper.linear, "f_lin", false);
    let answer = shop.cycle("F1", &body).await;
    assert_eq!(answer.body["summary"]["energy"][0]["basis"], "calibrated", "{}", answer.text);
}

#[tokio::test]
async fn what_makes_no_line_is_refused_and_only_engineers_fit() {
    let shop = Shop::open().await;
    model_machine(&shop).await;
    let none = shop.post(PATH, &json!({})).await;
    assert_eq!(
        (none.status, &none.body["errors"][0]["code"]),
        (422, &json!("not_identifiable")),
        "{}",
        none.text
    );
    for (body, path) in [
        (json!({"most_cycles": 201}), "most_cycles"),
        (json!({"filter": {"machine": "M1"}}), "filter.machine"),
        (json!({"filter": {"from": "yesterday"}}), "filter.from"),
        (json!({"dry": true}), "dry"),
    ] {
        let answer = shop.post(PATH, &body).await;
        assert_eq!(
            (answer.status, &answer.body["errors"][0]["path"]),
            (422, &json!(path)),
            "{}",
            answer.text
        );
    }
    assert_eq!(shop.post("/v1/machines/nobody/calibrations/fit", &json!({})).await.status, 404);
    let viewer = shop.token("viewer", None).await;
    let request = shop.client.post(shop.url(PATH)).json(&json!({"dry_run": true}));
    assert_eq!(shop.send_as(request, &viewer).await.status, 403);
    let request = shop.client.post(shop.url("/v1/friction/simulate")).json(&json!({}));
    assert_eq!(shop.send_as(request, &viewer).await.status, 200, "a viewer may compute");
}

/// Of loads that hardly differ: the dry run says what the database would refuse.
async fn a_line_that_cannot_be_stored_is_none() {
    let shop = Shop::open().await;
    model_machine(&shop).await;
    let column = |value: &dyn Fn(f64) -> f64| (0..40).map(|k| value(f64::from(k))).collect::<Vec<f64>>();
    let body = json!({
        "cycle_id": "steep", "tool": "T1", "operation": "O1", "started_at": at(1), "spindle_speed_rpm": 2000,
        "samples": {
            "period_ms": 10,
            "depth_mm": column(&|k| 0.1 * k),
            "feed_drive_load_percent": column(&|k| 10.0 + k),
            "thrust_newtons": column(&|k| 500.0 + 20.0 * k),
            "spindle_load_percent": column(&|k| 10.0 + 1e-7 * k),
            "torque_newton_metres": column(&|k| 1.0 + k),
        },
    });
    let posted = shop.cycle("F1", &body).await;
    assert_eq!(posted.status, 201, "{}", posted.text);
    for (request, status) in [(json!({"dry_run": true}), 200), (json!({}), 201)] {
        let fitted = shop.post(PATH, &request).await;
        assert_eq!(fitted.status, status, "{}", fitted.text);
        assert_eq!(fitted.body["thrust"]["outcome"], "fitted", "{}", fitted.text);
        let torque = &fitted.body["torque"];
        assert_eq!((&torque["outcome"], &torque["line"]), (&json!("none"), &Value::Null), "{torque}");
        let reason = torque["reason"].as_str().unwrap();
        assert!(
            reason.starts_with("line.slope: must be within -1000000 to 1000000 (N/% or N·m/%)"),
            "{reason}"
        );
    }
}

async fn cycles_whose_samples_are_gone_are_passed_over_and_damaged_ones_are_named() {
    let shop = Shop::open().await;
    model_machine(&shop).await;
    let paper = PaperStrategies::new().unwrap();
    for number in 1..=4 {
        assert_eq!(shop.cycle("F1", &drilled(number, &paper.linear, "f_lin", true)).await.status, 201);
    }
    assert_eq!(shop.get("/v1/cycles?machine=F1").await.body["items"].as_array().unwrap().len(), 4);
    // As retention leaves them: the oldest without samples.
    assert_eq!(shop.tables("DELETE FROM cycle_samples WHERE cycle_id IN ('c1', 'c2')").await, 2);
    let few = json!({"most_cycles": 1, "dry_run": true});
    let fitted = shop.post(PATH, &few).await;
    assert_eq!(
        (fitted.status, &fitted.body["thrust"]["line"]["cycles"]),
        (200, &json!(1)),
        "{}",
        fitted.text
    );
    assert_eq!(
        (&fitted.body["considered"], &fitted.body["skipped"]),
        (&json!(3), &json!({"samples_dropped": 2}))
    );
    let early = json!({"filter": {"to": at(3)}, "dry_run": true});
    let none = shop.post(PATH, &early).await;
    assert_eq!(
        (none.status, &none.body["errors"][0]["code"]),
        (422, &json!("not_identifiable")),
        "{}",
        none.text
    );
    assert_eq!(
        (&none.body["considered"], &none.body["skipped"]),
        (&json!(2), &json!({"samples_dropped": 2})),
        "{}",
        none.text
    );
    let detail = none.body["detail"].as_str().unwrap();
    assert!(detail.contains("2 cycles were looked at, 2 skipped: samples_dropped"), "{detail}");

    shop.damage_samples().await;
    let damaged = shop.post(PATH, &few).await;
    assert_eq!(
        (damaged.status, &damaged.body["code"]),
        (500, &json!("stored_data_damaged")),
        "{}",
        damaged.text
    );
    let detail = damaged.body["detail"].as_str().unwrap();
    assert!(detail.contains("the samples of cycle F1/c3 cannot be read"), "{detail}");
    let asked = json!({"filter": {"machine": "F1"}, "question": {"control": {}}});
    let many = shop.post("/v1/what-if", &asked).await;
    assert_eq!((many.status, &many.body["code"]), (500, &json!("stored_data_damaged")), "{}", many.text);
    let detail = many.body["detail"].as_str().unwrap();
    assert!(detail.contains("the samples of cycle F1/c3 cannot be read"), "{detail}");
}

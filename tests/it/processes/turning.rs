//! Plans and next pairs.

use super::{pair, papers_job, refuses};
use crate::shop::Shop;
use serde_json::{Value, json};

#[tokio::test]
async fn the_papers_choices_come_over_http() {
    let shop = Shop::open().await;
    let question = json!({"job": papers_job(), "whole_life": "overall_removal"});
    let answer = shop.post("/v1/turning/plan", &question).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    let intervals = answer.body["plan"]["intervals"].as_array().unwrap();
    assert_eq!(intervals.len(), 14, "at t = 15 none is left");
    let chosen: Vec<_> = [0, 1, 13].map(|at: usize| pair(&intervals[at])).into();
    assert_eq!(chosen, [(150.0, 0.58), (140.0, 0.58), (200.0, 0.205)]);
    assert_eq!(answer.body["plan"]["ended_by"], "wear");
    assert_eq!(answer.body["warnings"], json!([]));
    let ratio = |name: &str| answer.body["comparison"][name].as_f64().unwrap();
    // Three lives' worth of metal from one edge; per minute, the best fixed pair with a change of one minute is as good.
    assert!(ratio("removed") > 2.9 && (ratio("overall_removal") - 0.994).abs() < 0.001, "{}", answer.text);
    let life = &answer.body["whole_life"];
    // As printed, the plan gains by idling through the first minute; little of that is left from the wear's state.
    assert!(life["gain"].as_f64().unwrap() > 0.1, "{life}");
    assert!(life["gain_by_state"].as_f64().unwrap() < life["gain"].as_f64().unwrap());

    // From the state after 14 minutes nothing can be chosen any more.
    let wear = intervals[13]["wear_mm"].clone();
    let start = json!({"elapsed_min": 14.0, "wear_mm": wear});
    let answer = shop.post("/v1/turning/plan", &json!({"job": papers_job(), "start": start})).await;
    assert_eq!(answer.body["plan"]["intervals"], json!([]));
    assert_eq!(answer.body["plan"]["ended_by"], "wear");
}

#[tokio::test]
async fn a_continuous_choice_is_never_worse_and_outside_the_entry_is_said() {
    let shop = Shop::open().await;
    let removal = |answer: &Value| answer["plan"]["intervals"][0]["removal_mm3_min"].as_f64().unwrap();
    let grid = shop.post("/v1/turning/plan", &json!({"job": papers_job()})).await;
    let mut job = papers_job();
    job.as_object_mut().unwrap().remove("domain");
    let free = shop.post("/v1/turning/plan", &json!({"job": job})).await;
    assert!(removal(&free.body) >= removal(&grid.body));
    let mut deep = papers_job();
    deep["depth_mm"] = 4.0.into();
    let answer = shop.post("/v1/turning/plan", &json!({"job": deep})).await;
    assert_eq!((answer.status, &answer.body["warnings"][0]["code"]), (200, &json!("outside_fitted_ranges")));
}

#[tokio::test]
async fn measured_power_moves_the_next_pair() {
    let shop = Shop::open().await;
    let next = async |factor: f64| {
        let plan = shop.post("/v1/turning/plan", &json!({"job": papers_job()})).await;
        let cut = |interval: &Value| {
            json!({"speed_m_min": interval["speed_m_min"], "feed_mm_rev": interval["feed_mm_rev"], "minutes": 1.0,
                   "measured": {"power_kw": interval["power_kw"].as_f64().unwrap() * factor}})
        };
        let intervals: Vec<_> =
            plan.body["plan"]["intervals"].as_array().unwrap()[..5].iter().map(cut).collect();
        let question = json!({"job": papers_job(), "intervals": intervals, "caution_sigmas": 0.0});
        let answer = shop.post("/v1/turning/next", &question).await;
        assert_eq!(answer.status, 200, "{}", answer.text);
        (plan.body["plan"]["intervals"][5].clone(), answer.body)
    };
    let (paper, as_paper) = next(1.0).await;
    assert_eq!(pair(&as_paper["next"]), pair(&paper));
    assert_eq!(as_paper["readings"], json!({"intervals": 5, "power": 5, "force": 0, "wear": 0}));
    let (_, harder) = next(1.15).await;
    let removal = |answer: &Value| answer["next"]["removal_mm3_min"].as_f64().unwrap();
    assert!(removal(&harder) < removal(&as_paper));
    let factor = &harder["corrections"]["power_factor"];
    assert!(factor["value"].as_f64().unwrap() > 1.05 && factor["low"].as_f64() < factor["high"].as_f64());
}

#[tokio::test]
async fn bad_questions_are_named() {
    let shop = Shop::open().await;
    let plan = "/v1/turning/plan";
    let with = |from: &str, to: &str| {
        let body = json!({"job": papers_job()}).to_string();
        assert!(body.contains(from), "{from} in {body}");
        body.replace(from, to)
    };
    let cases = [
        (with("\"depth_mm\":2.5", "\"depth_mm\":NaN"), "not_finite", "job.depth_mm"),
        (with("\"depth_mm\":2.5", "\"depth_mm\":-1"), "out_of_range", "job.depth_mm"),
        (with("\"depth_mm\":2.5", "\"depth_mm\":\"2\""), "wrong_type", "job.depth_mm"),
        (with("\"power_kw\":7.0", "\"power_kw\":-Infinity"), "not_finite", "job.limits.power_kw"),
        (with("\"step\":10", "\"step\":0"), "out_of_range", "job.domain.grid.speed_m_min.step"),
        (with("\"step\":0.005", "\"step\":0.0000001"), "too_many", "job.domain.grid.feed_mm_rev.step"),
        (with("\"depth_mm\"", "\"depth\""), "unknown_field", "job.depth"),
        (with("alaskari-oraby-2017", "somebody-else"), "unknown_model", "job.model.id"),
        (with("alaskari-oraby-2017", "no id"), "invalid_id", "job.model.id"),
        (
            with("{\"job\"", "{\"start\":{\"elapsed_min\":-1,\"wear_mm\":0},\"job\""),
            "out_of_range",
            "start.elapsed_min",
        ),
    ];
    for (body, code, path) in &cases {
        refuses(&shop, plan, body, code, path).await;
    }
    let body = json!({"job": papers_job(), "intervals": [
        {"speed_m_min": 150, "feed_mm_rev": 0.5, "minutes": 1},
        {"speed_m_min": 150, "feed_mm_rev": 0.5, "minutes": 1, "measured": {"power_kw": -1}}]});
    refuses(&shop, "/v1/turning/next", &body.to_string(), "out_of_range", "intervals[1].measured.power_kw")
        .await;
}

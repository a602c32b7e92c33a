//! Maps as jobs: asked for, watched, shared, cancelled.

use crate::shop::Shop;
use serde_json::{Value, json};
use std::time::Duration;

fn map(count: u32, periods: u32) -> Value {
    let axis = |min: f64, max: f64| json!({"min": min, "max": max, "count": count});
    json!({"frequency_ratio": axis(1.0, 2.0), "cutting_coefficient": axis(0.02, 0.6),
        "settings": {"periods": periods, "steady_periods": periods / 5}})
}

async fn ended(shop: &Shop, path: &str) -> Value {
    for _ in 0..1200 {
        let job = shop.get(path).await;
        assert_eq!(job.status, 200, "{}", job.text);
        if !["waiting", "running"].contains(&job.body["state"].as_str().unwrap()) {
            return job.body;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    panic!("{path} does not end");
}

#[tokio::test]
async fn a_small_map_is_answered_and_a_large_one_becomes_a_job() {
    let shop = Shop::open().await;
    let small = shop.post("/v1/vibratory/map", &map(5, 100)).await;
    assert_eq!(
        (small.status, small.body["continuity"].as_array().unwrap().len()),
        (200, 25),
        "{}",
        small.text
    );
    let large = shop.post("/v1/vibratory/map", &map(21, 250)).await;
    assert_eq!((large.status, &large.body["total"]), (202, &json!(441)), "{}", large.text);
    let place = large.headers["location"].to_str().unwrap().to_owned();
    let done = ended(&shop, &place).await;
    assert_eq!((&done["state"], &done["done"]), (&json!("done"), &json!(441)));
    assert_eq!(done["result"]["amplitude"].as_array().unwrap().len(), 441);
    assert_eq!(done["result"]["frequency_ratios"].as_array().unwrap().len(), 21);
    // The same question gets the same job with its result, at once.
    let again = shop.post("/v1/vibratory/map", &map(21, 250)).await;
    assert_eq!((again.status, &again.body["id"]), (202, &large.body["id"]));
    assert!(again.body["result"].is_object());
    let other = shop.client.delete(shop.url(&place));
    let other = shop.send(other).await;
    assert_eq!((other.status, &other.body["code"]), (409, &json!("job_ended")));
    // Of what a server does not have it says where it may be.
    let unknown =
        [shop.get("/v1/jobs/none").await, shop.send(shop.client.delete(shop.url("/v1/jobs/none"))).await];
    for answer in unknown {
        assert_eq!((answer.status, &answer.body["code"]), (404, &json!("not_found")));
        let detail = answer.body["detail"].as_str().unwrap();
        assert!(detail.contains("another server") && detail.contains("restart"), "{detail}");
    }
}

#[tokio::test]
async fn a_job_is_cancelled_and_the_next_one_runs_and_shutdown_waits_for_neither() {
    let shop = Shop::open().await;
    let viewer = shop.token("viewer", None).await;
    let ask = |count| shop.client.post(shop.url("/v1/vibratory/map")).json(&map(count, 500));
    let first = shop.send_as(ask(301), &viewer).await;
    assert_eq!(first.status, 202, "{}", first.text);
    let second = shop.send_as(ask(302), &viewer).await;
    let path = |answer: &crate::shop::Answer| format!("/v1/jobs/{}", answer.body["id"].as_str().unwrap());
    assert_eq!(shop.get(&path(&second)).await.body["state"], "waiting");
    for job in [&second, &first] {
        let cancelled = shop.send_as(shop.client.delete(shop.url(&path(job))), &viewer).await;
        assert_eq!(cancelled.status, 204);
        assert_eq!(ended(&shop, &path(job)).await["state"], "cancelled");
    }
    // What was cancelled can be asked for again; a shutdown ends it.
    let again = shop.send_as(ask(301), &viewer).await;
    assert_ne!(again.body["id"], first.body["id"]);
    let begun = std::time::Instant::now();
    let shop = shop.restart().await;
    assert!(begun.elapsed() < Duration::from_secs(8), "{:?}", begun.elapsed());
    assert_eq!(shop.get(&path(&again)).await.status, 404);
}

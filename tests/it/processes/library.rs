//! Entries of the model library.

use super::refuses;
use crate::shop::Shop;
use serde_json::{Value, json};

const SEED: &str = "/v1/models/turning/alaskari-oraby-2017";

fn material() -> Value {
    json!({"name": "C45 with HSS",
        "thrust": {"coefficient": 680, "diameter_exponent": 1.0, "feed_exponent": 0.7, "correction": 1.0},
        "torque": {"coefficient": 345, "diameter_exponent": 2.0, "feed_exponent": 0.8, "correction": 1.0}})
}

#[tokio::test]
async fn the_papers_entry_is_there_and_no_invented_material() {
    let shop = Shop::open().await;
    let seed = shop.get(SEED).await;
    assert_eq!((seed.status, &seed.headers["etag"]), (200, &"\"1\"".parse().unwrap()));
    assert_eq!(seed.body["wear"]["speed_exponent"], 0.577);
    assert_eq!(seed.body["ranges"]["depth_mm"], json!({"min": 1.5, "max": 3.0}));
    assert_eq!(shop.get("/v1/models/turning").await.body["items"].as_array().unwrap().len(), 1);
    assert_eq!(shop.get("/v1/models/plunge").await.body["items"], json!([]));
}

#[tokio::test]
async fn entries_change_by_their_etag() {
    let shop = Shop::open().await;
    let path = "/v1/models/plunge/c45";
    let created = shop.put(path, &material()).await;
    assert_eq!(
        (created.status, &created.headers["location"]),
        (201, &path.parse().unwrap()),
        "{}",
        created.text
    );
    assert_eq!(shop.put(path, &material()).await.status, 200, "the same again changes nothing");
    let mut changed = material();
    changed["thrust"]["coefficient"] = 700.into();
    assert_eq!(shop.put(path, &changed).await.status, 428);
    let put = |tag: &str| shop.client.put(shop.url(path)).header("if-match", tag).json(&changed);
    assert_eq!(shop.send(put("\"7\"")).await.status, 412);
    let done = shop.send(put("\"1\"")).await;
    assert_eq!((done.status, &done.body["version"]), (200, &json!(2)));
    let known = shop.send(shop.client.get(shop.url(path)).header("if-none-match", "\"2\"")).await;
    assert_eq!(known.status, 304);
    // Kinds have names of their own.
    assert_eq!(shop.get("/v1/models/turning/c45").await.status, 404);
    let audit = shop.get("/v1/audit?limit=100").await.text;
    assert!(audit.contains("model/plunge/c45") && audit.contains("model.put"));
}

#[tokio::test]
async fn bad_entries_are_named_and_nobody_below_an_engineer_writes() {
    let shop = Shop::open().await;
    let body = material().to_string();
    let put = async |body: String| {
        let request =
            shop.client.put(shop.url("/v1/models/plunge/x")).header("content-type", "application/json");
        shop.send(request.body(body)).await
    };
    let answer = put(body.replace("\"feed_exponent\":0.8", "\"feed_exponent\":0")).await;
    assert_eq!(super::refusal(&answer), ("out_of_range".to_owned(), "torque.feed_exponent".to_owned()));
    let answer = put(body.replace("\"coefficient\":345", "\"coefficient\":NaN")).await;
    assert_eq!(super::refusal(&answer), ("not_finite".to_owned(), "torque.coefficient".to_owned()));
    for (role, machine, reads, writes) in [
        ("viewer", None, 200, 403),
        ("approver", None, 200, 403),
        ("machine", Some("M1"), 403, 403),
        ("engineer", None, 200, 201),
    ] {
        let token = shop.token(role, machine).await;
        assert_eq!(shop.send_as(shop.client.get(shop.url(SEED)), &token).await.status, reads, "{role}");
        let computed =
            shop.client.post(shop.url("/v1/vibratory/border")).json(&json!({"frequency_ratios": [1.5]}));
        assert_eq!(shop.send_as(computed, &token).await.status, reads, "{role}");
        let request = shop.client.put(shop.url(&format!("/v1/models/plunge/{role}"))).json(&material());
        assert_eq!(shop.send_as(request, &token).await.status, writes, "{role}");
    }
    refuses(
        &shop,
        "/v1/plunge/feed",
        r#"{"material":{"id":"nope"},"machine":{"least_feed_mm_min":1,
        "greatest_feed_mm_min":5000},"drills":[]}"#,
        "unknown_model",
        "material.id",
    )
    .await;
}

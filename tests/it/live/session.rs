//! A page's live view ends with its session.

use super::Served;
use super::reader::Reader;
use serde_json::json;
use std::time::Duration;

/// Begins a session with a token made for it; the cookie, and the token's id.
async fn sign_in(served: &Served) -> (String, String) {
    let body = json!({"name": "tablet", "role": "viewer"});
    let (status, made) = served.send("POST", "/v1/tokens", Some(body)).await;
    assert_eq!(status, 201, "{made}");
    let request = served.client.post(served.url("/v1/session")).header("x-feedwright-page", "1");
    let answer = request.json(&json!({"token": made["token"]})).send().await.unwrap();
    assert_eq!(answer.status(), 201);
    let set = answer.headers()["set-cookie"].to_str().unwrap();
    (set.split(';').next().unwrap().to_owned(), made["id"].as_str().unwrap().to_owned())
}

#[tokio::test]
async fn a_live_view_ends_with_its_session_or_its_token_and_others_go_on() {
    let served = Served::start(&[("live.heartbeat_ms", "50")]).await;
    let (left, _) = sign_in(&served).await;
    let (revoked, id) = sign_in(&served).await;
    let mut program = Reader::open(&served, "", None).await;
    let mut signed_out = Reader::with_cookie(&served, &left).await;
    let mut cut_off = Reader::with_cookie(&served, &revoked).await;
    for reader in [&mut program, &mut signed_out, &mut cut_off] {
        assert_eq!(reader.next().await.unwrap().name, "state");
    }
    let request = served.client.delete(served.url("/v1/session")).header("cookie", &left);
    let out = request.header("x-feedwright-page", "1").send().await.unwrap();
    assert_eq!(out.status(), 204);
    assert_eq!(signed_out.next().await, None, "the view goes on after signing out");
    assert_eq!(served.send("DELETE", &format!("/v1/tokens/{id}"), None).await.0, 200);
    assert_eq!(cut_off.next().await, None, "the view goes on without its token");
    // A program that reads with a token of its own ends with that one.
    let (_, made) = served.send("POST", "/v1/tokens", Some(json!({"name": "wall", "role": "viewer"}))).await;
    let mut wall = Reader::with_token(&served, made["token"].as_str().unwrap()).await;
    assert_eq!(wall.next().await.unwrap().name, "state");
    let path = format!("/v1/tokens/{}", made["id"].as_str().unwrap());
    assert_eq!(served.send("DELETE", &path, None).await.0, 200);
    let ended = tokio::time::timeout(Duration::from_secs(20), wall.next()).await;
    assert_eq!(ended.expect("the view goes on without its token"), None);
    served.with_a_shop().await;
    served.post_cycle("c1", 20.0).await;
    program.next_of("cycle").await;
    served.stop().await;
}

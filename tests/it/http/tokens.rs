//! Tokens: made, shown once, revoked at once; and those who guess.

use super::app::{Answer, App};
use axum::body::Body;
use feedwright_core::ids::MachineId;
use feedwright_store::Role;
use http::{Request, StatusCode};
use serde_json::json;

async fn with_token(app: &App, token: &str) -> Answer {
    let request = Request::get("/v1/machines").header("authorization", format!("Bearer {token}"));
    app.send(request.body(Body::empty()).unwrap()).await
}

#[tokio::test]
async fn a_revocation_acts_on_the_next_request() {
    let app = App::new().await;
    let body = json!({"name": "MES", "role": "viewer"});
    let made = app.call(Role::Admin, "POST", "/v1/tokens", &[], Some(body)).await;
    assert_eq!(made.status, StatusCode::CREATED, "{made:?}");
    let (token, id) =
        (made.json()["token"].as_str().unwrap().to_owned(), made.json()["id"].as_str().unwrap().to_owned());
    assert!(token.starts_with(&format!("fwt_{id}_")));
    assert_eq!(with_token(&app, &token).await.status, StatusCode::OK);

    let revoked = app.call(Role::Admin, "DELETE", &format!("/v1/tokens/{id}"), &[], None).await;
    assert_eq!(revoked.json()["revoked_at"], "2026-05-04T06:00:00Z", "{revoked:?}");
    let refused = with_token(&app, &token).await;
    assert_eq!((refused.status, refused.code().as_str()), (StatusCode::UNAUTHORIZED, "token_revoked"));
    assert!(refused.header("www-authenticate").contains("invalid_token"));

    let listed = app.call(Role::Admin, "GET", "/v1/tokens", &[], None).await;
    let text = String::from_utf8(listed.body).unwrap();
    assert!(text.contains(&id) && !text.contains(&token) && !text.contains("hash"), "{text}");
    let audit = String::from_utf8(app.get("/v1/audit?limit=1000").await.body).unwrap();
    assert!(audit.contains(&format!("token/{id}")) && !audit.contains(&token), "{audit}");
    let missing = app.call(Role::Admin, "DELETE", "/v1/tokens/none", &[], None).await;
    assert_eq!(missing.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn a_machines_token_is_bound_to_a_registered_machine() {
    let app = App::registered().await;
    for (body, path, code) in [
        (json!({"name": "a", "role": "machine"}), "machine", "machine_binding"),
        (json!({"name": "a", "role": "viewer", "machine": "M1"}), "machine", "machine_binding"),
        (json!({"name": "a", "role": "machine", "machine": "M 1"}), "machine", "invalid_id"),
        (json!({"name": "a", "role": "machine", "machine": "M9"}), "machine", "unknown_machine"),
        (json!({"name": "", "role": "viewer"}), "name", "invalid_length"),
        (json!({"name": "a", "role": "root"}), "role", "invalid_value"),
    ] {
        let answer = app.call(Role::Admin, "POST", "/v1/tokens", &[], Some(body)).await;
        assert_eq!(answer.errors(), [(path.to_owned(), code.to_owned())]);
    }
    let body = json!({"name": "drill", "role": "machine", "machine": "M1"});
    let made = app.call(Role::Admin, "POST", "/v1/tokens", &[], Some(body)).await;
    assert_eq!((made.status, made.json()["machine"].as_str()), (StatusCode::CREATED, Some("M1")));
}

#[tokio::test]
async fn what_is_no_token_is_told_so() {
    let app = App::new().await;
    let good = app.token(Role::Viewer).to_owned();
    let mut mistyped = good.clone();
    let at = mistyped.len() - 20;
    let digit = if &mistyped[at..=at] == "0" { "1" } else { "0" };
    mistyped.replace_range(at..=at, digit);
    for (header, code) in [
        (format!("Bearer {mistyped}"), "token_malformed"),
        (format!("Basic {good}"), "token_malformed"),
        (good.clone(), "token_malformed"),
        ("Bearer".to_owned(), "token_malformed"),
    ] {
        let request = Request::get("/v1/machines").header("authorization", header);
        let answer = app.send(request.body(Body::empty()).unwrap()).await;
        assert_eq!((answer.status, answer.code().as_str()), (StatusCode::UNAUTHORIZED, code));
    }
    let request = Request::get("/v1/machines").header("authorization", format!("bearer {good}"));
    assert_eq!(app.send(request.body(Body::empty()).unwrap()).await.status, StatusCode::OK);
    // Well-formed, of another installation.
    let stranger = App::new().await.issue(Role::Admin, None).await;
    assert_eq!(with_token(&app, &stranger).await.code(), "token_unknown");
}

#[tokio::test]
async fn who_guesses_is_told_to_wait_and_who_knows_is_not() {
    let app = App::with(&[("server.failed_auth_per_minute", "3")]).await;
    for _ in 0..3 {
        assert_eq!(with_token(&app, "guess").await.status, StatusCode::UNAUTHORIZED);
    }
    let waiting = with_token(&app, "guess").await;
    assert_eq!(waiting.status, StatusCode::TOO_MANY_REQUESTS);
    assert_eq!(waiting.code(), "too_many_failed_authentications");
    assert!((1..=60).contains(&waiting.header("retry-after").parse::<u32>().unwrap()), "{waiting:?}");
    assert_eq!(with_token(&app, app.token(Role::Viewer)).await.status, StatusCode::OK);
}

#[tokio::test]
async fn a_token_of_another_machine_is_refused_before_anything_is_looked_up() {
    let app = App::registered().await;
    let other = app.issue(Role::Machine, Some(MachineId::try_from("M2").unwrap())).await;
    for machine in ["M1", "M9"] {
        let request = Request::get(format!("/v1/machines/{machine}"))
            .header("authorization", format!("Bearer {other}"));
        let answer = app.send(request.body(Body::empty()).unwrap()).await;
        assert_eq!((answer.status, answer.code().as_str()), (StatusCode::FORBIDDEN, "other_machine"));
    }
}

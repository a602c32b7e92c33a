//! Sessions of browsers: begun with a token, carried by a cookie, bounded, ended with their token; and the pages' headers.

use super::app::{Answer, App};
use axum::body::Body;
use feedwright_server::auth::MOST_SESSIONS;
use feedwright_server::http::routes::{Access, table};
use feedwright_server::ui::PAGES;
use feedwright_store::Role;
use http::{Request, StatusCode};
use serde_json::{Value, json};
use std::collections::BTreeSet;

async fn sign_in(app: &App, token: &str, headers: &[(&str, &str)]) -> Answer {
    let mut request = Request::post("/v1/session").header("content-type", "application/json");
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    app.send(request.body(Body::from(json!({"token": token}).to_string())).unwrap()).await
}

const PAGE: (&str, &str) = ("x-feedwright-page", "1");

fn cookie_of(answer: &Answer) -> String {
    assert_eq!(answer.status, StatusCode::CREATED, "{answer:?}");
    answer.header("set-cookie").split(';').next().unwrap().to_owned()
}

async fn with_cookie(
    app: &App,
    cookie: &str,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: Option<Value>,
) -> Answer {
    let mut request = Request::builder().method(method).uri(path).header("cookie", cookie);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    if body.is_some() {
        request = request.header("content-type", "application/json");
    }
    let body = body.map_or_else(Body::empty, |body| Body::from(body.to_string()));
    app.send(request.body(body).unwrap()).await
}

#[tokio::test]
async fn a_session_does_what_its_token_may_and_ends_when_it_is_over() {
    let app = App::registered().await;
    let signed_in = sign_in(&app, app.token(Role::Engineer), &[PAGE]).await;
    let set = signed_in.header("set-cookie").to_owned();
    for flag in ["HttpOnly", "SameSite=Strict", "Path=/", "Max-Age=43200"] {
        assert!(set.contains(flag), "{flag}: {set}");
    }
    assert!(!set.contains("Secure"), "over plain HTTP the browser would drop it: {set}");
    assert!(!String::from_utf8_lossy(&signed_in.body).contains("fwt_"), "the token comes back");
    let cookie = cookie_of(&signed_in);
    assert!(!app.token(Role::Engineer).contains(&cookie[20..40]), "the cookie is no part of the token");

    let who = with_cookie(&app, &cookie, "GET", "/v1/session", &[], None).await.json();
    assert_eq!(
        (who["role"].as_str(), who["expires_at"].as_str()),
        (Some("engineer"), Some("2026-05-04T18:00:00Z"))
    );
    let put = with_cookie(&app, &cookie, "PUT", "/v1/tools/T7", &[PAGE], Some(super::app::tool())).await;
    assert_eq!(put.status, StatusCode::CREATED, "{put:?}");
    let tokens = with_cookie(&app, &cookie, "GET", "/v1/tokens", &[], None).await;
    assert_eq!((tokens.status, tokens.code().as_str()), (StatusCode::FORBIDDEN, "role_not_allowed"));

    let out = with_cookie(&app, &cookie, "DELETE", "/v1/session", &[PAGE], None).await;
    assert_eq!(out.status, StatusCode::NO_CONTENT);
    assert!(out.header("set-cookie").contains("Max-Age=0"), "{out:?}");
    let after = with_cookie(&app, &cookie, "GET", "/v1/session", &[], None).await;
    assert_eq!((after.status, after.code().as_str()), (StatusCode::UNAUTHORIZED, "session_unknown"));
    let audit = String::from_utf8(app.get("/v1/audit?limit=1000").await.body).unwrap();
    assert!(audit.contains("session.begin") && audit.contains("session.end"), "{audit}");
}

#[tokio::test]
async fn what_another_site_may_have_caused_is_refused() {
    let app = App::registered().await;
    let cookie = cookie_of(&sign_in(&app, app.token(Role::Admin), &[PAGE]).await);
    let tool = || Some(super::app::tool());
    for headers in [
        vec![],
        vec![("sec-fetch-site", "same-origin")],
        vec![PAGE, ("sec-fetch-site", "cross-site")],
        vec![PAGE, ("sec-fetch-site", "same-site")],
        vec![PAGE, ("origin", "https://evil.example"), ("host", "shop.example")],
    ] {
        let answer = with_cookie(&app, &cookie, "PUT", "/v1/tools/T9", &headers, tool()).await;
        assert_eq!(
            (answer.status, answer.code().as_str()),
            (StatusCode::FORBIDDEN, "cross_site"),
            "{headers:?}"
        );
    }
    assert_eq!(app.get("/v1/tools/T9").await.status, StatusCode::NOT_FOUND, "nothing of it was done");
    let read =
        with_cookie(&app, &cookie, "GET", "/v1/tools", &[("sec-fetch-site", "cross-site")], None).await;
    assert_eq!(read.code(), "cross_site");
    let foreign = sign_in(&app, app.token(Role::Admin), &[]).await;
    assert_eq!(foreign.code(), "cross_site", "nor does another site sign anybody in");
    // A token in the header is no cookie: programs need none of this.
    assert_eq!(app.put("/v1/tools/T9", super::app::tool()).await.status, StatusCode::CREATED);
}

#[tokio::test]
async fn a_cookie_over_tls_stays_on_tls() {
    let app = App::new().await;
    let headers = [PAGE, ("origin", "https://shop.example"), ("host", "shop.example")];
    let set = sign_in(&app, app.token(Role::Viewer), &headers).await.header("set-cookie").to_owned();
    assert!(set.ends_with("; Secure"), "{set}");
}

#[tokio::test]
async fn where_nothing_but_tls_is_spoken_the_cookie_is_secure_whatever_the_browser_says() {
    let app = App::with(&[("tls.certificate", "/etc/cert.pem"), ("tls.key", "/etc/key.pem")]).await;
    let set = sign_in(&app, app.token(Role::Viewer), &[PAGE]).await;
    assert!(set.header("set-cookie").ends_with("; Secure"), "{set:?}");
    let cookie = cookie_of(&set);
    let out = with_cookie(&app, &cookie, "DELETE", "/v1/session", &[PAGE], None).await;
    assert!(out.header("set-cookie").ends_with("; Secure"), "{out:?}");
}

#[tokio::test]
async fn a_revoked_token_ends_its_sessions_at_once() {
    let app = App::new().await;
    let body = json!({"name": "tablet", "role": "viewer"});
    let made = app.call(Role::Admin, "POST", "/v1/tokens", &[], Some(body)).await.json();
    let cookie = cookie_of(&sign_in(&app, made["token"].as_str().unwrap(), &[PAGE]).await);
    assert_eq!(with_cookie(&app, &cookie, "GET", "/v1/fleet", &[], None).await.status, StatusCode::OK);
    let path = format!("/v1/tokens/{}", made["id"].as_str().unwrap());
    assert_eq!(app.call(Role::Admin, "DELETE", &path, &[], None).await.status, StatusCode::OK);
    let after = with_cookie(&app, &cookie, "GET", "/v1/fleet", &[], None).await;
    assert_eq!((after.status, after.code().as_str()), (StatusCode::UNAUTHORIZED, "token_revoked"));
}

#[tokio::test]
async fn sessions_of_a_token_are_bounded_and_the_oldest_makes_room() {
    let app = App::new().await;
    let mut cookies = Vec::new();
    for _ in 0..MOST_SESSIONS + 3 {
        cookies.push(cookie_of(&sign_in(&app, app.token(Role::Viewer), &[PAGE]).await));
    }
    let mut alive = 0;
    for cookie in &cookies {
        let answer = with_cookie(&app, cookie, "GET", "/v1/session", &[], None).await;
        alive += u32::from(answer.status == StatusCode::OK);
        if answer.status == StatusCode::TOO_MANY_REQUESTS {
            panic!("a session that is over is no attempt worth a wait: {answer:?}");
        }
    }
    assert_eq!(alive, MOST_SESSIONS);
}

#[tokio::test]
async fn who_guesses_at_the_sign_in_waits_and_a_machine_does_not_sign_in() {
    let app = App::with(&[("server.failed_auth_per_minute", "2")]).await;
    let machine = sign_in(&app, app.token(Role::Machine), &[PAGE]).await;
    assert_eq!((machine.status, machine.code().as_str()), (StatusCode::FORBIDDEN, "role_not_allowed"));
    assert_eq!(sign_in(&app, "fwt_no", &[PAGE]).await.code(), "token_malformed");
    let stranger = App::new().await.issue(Role::Admin, None).await;
    assert_eq!(sign_in(&app, &stranger, &[PAGE]).await.code(), "token_unknown");
    assert_eq!(sign_in(&app, &stranger, &[PAGE]).await.status, StatusCode::TOO_MANY_REQUESTS);
    assert_eq!(sign_in(&app, app.token(Role::Viewer), &[PAGE]).await.status, StatusCode::CREATED);
}

#[tokio::test]
async fn what_a_role_is_told_it_may_do_is_what_the_table_lets_it_do() {
    let app = App::new().await;
    for role in Role::ALL {
        let told = app.call(role, "GET", "/v1/session", &[], None).await.json();
        let told: BTreeSet<_> =
            told["may"].as_array().unwrap().iter().map(|name| name.as_str().unwrap().to_owned()).collect();
        for route in table().iter().filter(|route| route.path().starts_with("/v1/")) {
            let name = format!("{} {}", route.method(), route.path());
            let may = match route.access() {
                Access::Open => true,
                Access::Roles(roles) => roles.contains(&role),
            };
            assert_eq!(told.contains(&name), may, "{name} as {role:?}");
        }
    }
}

#[tokio::test]
async fn every_page_and_every_file_of_it_comes_with_its_policy() {
    let app = App::new().await;
    let ask = async |path: &str, headers: &[(&str, &str)]| {
        let mut request = Request::get(path);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        app.send(request.body(Body::empty()).unwrap()).await
    };
    for (path, name) in PAGES {
        let page = ask(path, &[]).await;
        assert_eq!(page.status, StatusCode::OK, "{path}");
        let policy = page.header("content-security-policy");
        assert!(
            policy.starts_with("default-src 'none'; script-src 'self'; style-src 'self'"),
            "{path}: {policy}"
        );
        assert!(!policy.contains("unsafe") && policy.contains("frame-ancestors 'none'"), "{path}: {policy}");
        assert_eq!(page.header("cache-control"), "no-cache");
        assert_eq!(page.header("x-content-type-options"), "nosniff");
        let text = String::from_utf8(page.body.clone()).unwrap();
        assert!(text.contains(&format!("data-page=\"{name}\"")) && !text.contains("{{"), "{text}");
        assert!(!text.contains("style=") && !text.contains("<script>"), "{text}");
        for file in text.split('"').filter(|part| part.starts_with("/ui/")) {
            let found = ask(file, &[]).await;
            assert_eq!(found.status, StatusCode::OK, "{path}: {file}");
            assert_eq!(found.header("content-security-policy"), policy);
            let again = ask(file, &[("if-none-match", found.header("etag"))]).await;
            assert_eq!((again.status, again.body.len()), (StatusCode::NOT_MODIFIED, 0), "{file}");
        }
        let again = ask(path, &[("if-none-match", page.header("etag"))]).await;
        assert_eq!(again.status, StatusCode::NOT_MODIFIED);
    }
    let browser = [("accept", "text/html,application/xml;q=0.9,*/*;q=0.8"), ("if-none-match", "*")];
    let unknown = ask("/no-such-page", &browser).await;
    assert_eq!(unknown.status, StatusCode::NOT_FOUND);
    let text = String::from_utf8(unknown.body.clone()).unwrap();
    assert!(text.contains("data-page=\"unknown\"") && !text.contains("{{"), "{text}");
    // Whoever asks for data is told in data, also where a browser is what asks.
    for (path, headers) in [("/no-such-page", &[][..]), ("/v1/no-such-route", &browser)] {
        let unknown = ask(path, headers).await;
        assert_eq!(unknown.status, StatusCode::NOT_FOUND);
        assert_eq!(unknown.json()["code"], "unknown_path", "{path}");
    }
    for missing in ["/ui/dev/js/no.js", "/ui/other/icon.svg", "/ui/dev/page.html", "/ui/dev/../../lib.rs"] {
        assert_eq!(ask(missing, &[]).await.status, StatusCode::NOT_FOUND, "{missing}");
    }
    let zipped = ask("/ui/dev/css/base.css", &[("accept-encoding", "gzip, br")]).await;
    assert_eq!((zipped.header("content-encoding"), &zipped.body[..2]), ("gzip", &[0x1f, 0x8b][..]));
}

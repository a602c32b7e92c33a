//! Every route against every role, driven by the table that drives the router.

use super::app::App;
use axum::body::Body;
use feedwright_server::http::routes::{Access, table};
use feedwright_store::Role;
use http::{Request, StatusCode};
use std::collections::BTreeSet;

/// A path of the table with its parameters filled in, for machine `machine`.
fn fill(path: &str, machine: &str) -> String {
    let filled = path
        .replace("{machine}", machine)
        .replace("/ui/{version}/{*file}", "/ui/dev/icon.svg")
        .replace("{*file}", "index.html");
    let mut out = String::new();
    let mut rest = filled.as_str();
    while let Some((before, after)) = rest.split_once('{') {
        let (_, after) = after.split_once('}').unwrap();
        out.push_str(before);
        out.push('1');
        rest = after;
    }
    out + rest
}

async fn ask(app: &App, method: &http::Method, path: &str, token: Option<&str>) -> super::app::Answer {
    let mut request = Request::builder().method(method).uri(path);
    if let Some(token) = token {
        request = request.header("authorization", format!("Bearer {token}"));
    }
    app.send(request.body(Body::empty()).unwrap()).await
}

#[tokio::test]
async fn every_route_lets_in_its_roles_and_nobody_else() {
    let app = App::new().await;
    for route in table() {
        let (method, path) = (route.method(), fill(route.path(), "M1"));
        let name = format!("{method} {}", route.path());
        let nobody = ask(&app, method, &path, None).await;
        let Access::Roles(roles) = route.access() else {
            if *method != http::Method::GET {
                // Sign-in: a token in the body, which this request does not have.
                assert_eq!(nobody.status, StatusCode::UNSUPPORTED_MEDIA_TYPE, "{name}: {nobody:?}");
                continue;
            }
            assert!(nobody.status.is_success() || nobody.status.is_redirection(), "{name}: {nobody:?}");
            continue;
        };
        assert_eq!(
            (nobody.status, nobody.code().as_str()),
            (StatusCode::UNAUTHORIZED, "token_missing"),
            "{name}"
        );
        assert!(nobody.header("www-authenticate").starts_with("Bearer"), "{name}");
        for role in Role::ALL {
            let answer = ask(&app, method, &path, Some(app.token(role))).await;
            if roles.contains(&role) {
                // Past the guard: what it finds there is another story.
                let refused = matches!(answer.status, StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN);
                assert!(!refused, "{name} as {role:?}: {answer:?}");
            } else {
                assert_eq!(answer.status, StatusCode::FORBIDDEN, "{name} as {role:?}");
                assert_eq!(answer.code(), "role_not_allowed", "{name} as {role:?}");
            }
        }
        if roles.contains(&Role::Machine) && route.path().contains("{machine}") {
            let other = ask(&app, method, &fill(route.path(), "M2"), Some(app.token(Role::Machine))).await;
            assert_eq!(
                (other.status, other.code().as_str()),
                (StatusCode::FORBIDDEN, "other_machine"),
                "{name}"
            );
        }
    }
}

#[test]
fn only_these_routes_are_open() {
    let open: BTreeSet<_> = table()
        .iter()
        .filter(|route| route.access() == Access::Open)
        .map(|route| format!("{} {}", route.method(), route.path()))
        .collect();
    let expected = [
        "GET /docs",
        "GET /docs/",
        "GET /docs/{*file}",
        "GET /healthz",
        "GET /openapi.json",
        "GET /readyz",
        "GET /ui/{version}/{*file}",
        "POST /v1/session",
    ];
    let mut expected: BTreeSet<_> = expected.map(str::to_owned).into();
    // The pages hold no data: what they show they ask for with the session's cookie.
    expected.extend(feedwright_server::ui::PAGES.map(|(path, _)| format!("GET {path}")));
    assert_eq!(open, expected);
}

#[test]
fn only_admins_reach_identities() {
    for route in table().iter().filter(|route| route.path().starts_with("/v1/tokens")) {
        assert_eq!(route.access(), Access::Roles(&[Role::Admin]), "{} {}", route.method(), route.path());
    }
}

#[test]
fn no_route_stands_twice_in_the_table() {
    let table = table();
    let names: BTreeSet<_> =
        table.iter().map(|route| format!("{} {}", route.method(), route.path())).collect();
    assert_eq!(names.len(), table.len());
}

//! Every error is a problem document with a stable code.

use super::app::{App, machine};
use axum::body::Body;
use feedwright_store::Role;
use http::{Request, StatusCode};
use serde_json::json;
use std::convert::Infallible;

crate::engines::on_both!(
    unknown_paths_and_methods_are_told_as_problems,
    a_body_that_is_told_not_to_be_compressed_is_read,
    what_is_said_once_is_believed_only_where_it_is_said_once,
    a_query_that_is_no_text_is_refused,
    a_body_is_refused_for_its_type_its_size_or_its_form,
    a_body_that_does_not_tell_its_length_has_the_same_bounds,
    each_bad_field_is_named_by_its_path,
    every_violation_is_listed_not_only_the_first,
    a_sane_request_id_is_taken_over_and_another_is_not,
);

async fn put_raw(app: &App, content_type: Option<&str>, body: &str) -> super::app::Answer {
    let mut request = Request::put("/v1/machines/M1")
        .header("authorization", format!("Bearer {}", app.token(Role::Engineer)));
    if let Some(content_type) = content_type {
        request = request.header("content-type", content_type);
    }
    app.send(request.body(Body::from(body.to_owned())).unwrap()).await
}

async fn unknown_paths_and_methods_are_told_as_problems() {
    let app = App::new().await;
    let answer = app.get("/v2/machines").await;
    assert_eq!((answer.status, answer.code().as_str()), (StatusCode::NOT_FOUND, "unknown_path"));
    let answer = app.call(Role::Admin, "PATCH", "/v1/machines/M1", &[], None).await;
    assert_eq!(
        (answer.status, answer.code().as_str()),
        (StatusCode::METHOD_NOT_ALLOWED, "method_not_allowed")
    );
    assert!(answer.header("allow").contains("PUT") && answer.header("allow").contains("GET"), "{answer:?}");
    let answer = app.get("/v1/machines/M1").await;
    assert_eq!((answer.status, answer.code().as_str()), (StatusCode::NOT_FOUND, "not_found"));
    let answer = app.get("/v1/machines/%20").await;
    assert_eq!((answer.status, answer.code().as_str()), (StatusCode::BAD_REQUEST, "invalid_path"));
    assert_eq!(answer.errors(), [("machine".to_owned(), "invalid_id".to_owned())]);
    for path in ["/v1/machines/%ff", "/v1/machines/M1/cycles/%e2%82", "/%80"] {
        let answer = app.get(path).await;
        assert_eq!((answer.status, answer.code().as_str()), (StatusCode::BAD_REQUEST, "invalid_path"));
        assert!(answer.json()["detail"].as_str().unwrap().contains("UTF-8"), "{answer:?}");
    }
    let answer = app.get("/v1/alarms?opened=true").await;
    assert_eq!((answer.status, answer.code().as_str()), (StatusCode::BAD_REQUEST, "invalid_query"));
    assert_eq!(answer.errors(), [("opened".to_owned(), "unknown_field".to_owned())]);
    for (query, name, code) in [
        ("fleet?recent=99999999", "recent", "out_of_range"),
        ("fleet?recent=1.0", "recent", "invalid_value"),
        ("machines?limit=x", "limit", "invalid_value"),
        ("machines?limit=1&limit=2", "limit", "duplicate_field"),
    ] {
        let answer = app.get(&format!("/v1/{query}")).await;
        assert_eq!(answer.code(), "invalid_query", "{query}");
        assert_eq!(answer.errors(), [(name.to_owned(), code.to_owned())], "{query}");
        let text = String::from_utf8_lossy(&answer.body);
        assert!(!text.contains("digit") && !text.contains("literal"), "{text}");
    }
}

async fn a_body_that_is_told_not_to_be_compressed_is_read() {
    let app = App::new().await;
    for (codings, status) in [
        (["identity"].as_slice(), StatusCode::CREATED),
        (&["Identity"], StatusCode::OK),
        (&[""], StatusCode::OK),
        (&["identity", "identity"], StatusCode::UNSUPPORTED_MEDIA_TYPE),
        (&["gzip"], StatusCode::UNSUPPORTED_MEDIA_TYPE),
    ] {
        let mut request = Request::put("/v1/machines/M1")
            .header("authorization", format!("Bearer {}", app.token(Role::Admin)))
            .header("content-type", "application/json");
        for coding in codings {
            request = request.header("content-encoding", *coding);
        }
        let answer = app.send(request.body(Body::from(machine().to_string())).unwrap()).await;
        assert_eq!(answer.status, status, "{codings:?}: {answer:?}");
    }
}

/// A proxy in front may go by the last line where a server goes by the first.
async fn what_is_said_once_is_believed_only_where_it_is_said_once() {
    let app = App::registered().await;
    let (admin, viewer) = (app.token(Role::Admin).to_owned(), app.token(Role::Viewer).to_owned());
    let ask = async |method: &str, path: &str, lines: &[(&str, &str)], body: &str| {
        let mut request = Request::builder().method(method).uri(path);
        for (name, value) in lines {
            request = request.header(*name, *value);
        }
        app.send(request.body(Body::from(body.to_owned())).unwrap()).await
    };
    let (admin, viewer) = (format!("Bearer {admin}"), format!("Bearer {viewer}"));
    for second in [&viewer, &admin, "Basic eDp5", ""] {
        for lines in [[admin.as_str(), second], [second, &admin]] {
            let answer = ask("GET", "/v1/machines", &lines.map(|line| ("authorization", line)), "").await;
            let told = (answer.status, answer.code());
            assert_eq!(told, (StatusCode::BAD_REQUEST, "token_malformed".to_owned()), "{lines:?}");
            assert!(answer.header("www-authenticate").contains("invalid_request"), "{answer:?}");
        }
    }
    let metrics = String::from_utf8(app.get("/metrics").await.body).unwrap();
    assert!(metrics.contains("{reason=\"token_malformed\"} 8\n"), "{metrics}");

    let mut changed = machine();
    changed["name"] = json!("changed");
    let changed = changed.to_string();
    let put = [("authorization", admin.as_str()), ("content-type", "application/json")];
    for (first, second) in [
        (("if-match", "\"1\""), ("if-match", "\"2\"")),
        (("if-match", "\"1\""), ("if-match", "\"1\"")),
        (("if-none-match", "*"), ("if-none-match", "\"1\"")),
    ] {
        let answer =
            ask("PUT", "/v1/machines/M1", &[put.as_slice(), &[first, second]].concat(), &changed).await;
        let told = (answer.status, answer.code());
        assert_eq!(told, (StatusCode::BAD_REQUEST, "invalid_precondition".to_owned()), "{second:?}");
    }
    let cycle = r#"{"cycle_id":"c1","tool":"T1","operation":"O1","started_at":"2026-05-04T06:00:00Z","reported":{"energy_joules":1}}"#;
    for (method, path, body) in [
        ("PUT", "/v1/machines/M2", changed.as_str()),
        ("POST", "/v1/machines/M1/cycles", cycle),
        ("POST", "/v1/machines/M1/cycles/batch", cycle),
    ] {
        let own = if path.ends_with("batch") { "application/x-ndjson" } else { "application/json" };
        for kinds in [[own, "text/plain"], ["text/plain", own], [own, own]] {
            let kinds = kinds.map(|kind| ("content-type", kind));
            let answer = ask(method, path, &[&put[..1], kinds.as_slice()].concat(), body).await;
            let told = (answer.status, answer.code());
            let refused = (StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported_media_type".to_owned());
            assert_eq!(told, refused, "{path} {kinds:?}");
        }
    }
    assert_eq!(app.get("/v1/machines/M1").await.header("etag"), "\"1\"", "nothing was changed");
    assert_eq!(app.get("/v1/machines/M1/cycles/c1").await.status, StatusCode::NOT_FOUND);

    // What is a list may come in several lines (RFC 9110, section 5.3).
    let viewed = [("authorization", viewer.as_str())];
    let tags = [("if-none-match", "\"7\""), ("if-none-match", "\"1\"")];
    let known = ask("GET", "/v1/machines/M1", &[viewed.as_slice(), &tags].concat(), "").await;
    assert_eq!(known.status, StatusCode::NOT_MODIFIED);
    let preferred = [("prefer", "wait=10"), ("prefer", "return=minimal")];
    let posted = ask("POST", "/v1/machines/M1/cycles", &[put.as_slice(), &preferred].concat(), cycle).await;
    assert_eq!((posted.status, posted.header("preference-applied")), (StatusCode::CREATED, "return=minimal"));
}

async fn a_query_that_is_no_text_is_refused() {
    let app = App::registered().await;
    let told = async |query: &str| {
        let answer = app.get(&format!("/v1/{query}")).await;
        let code = if answer.status == StatusCode::OK { String::new() } else { answer.code() };
        (answer.status.as_u16(), code, answer)
    };
    for query in [
        "feed-profiles?tool_type=%ff",
        "feed-profiles?limit=5&tool_type=a%C3",
        "feed-profiles?tool_type=%c3+%a9",
        "feed-profiles?tool_type=%c3&limit=%a9",
        "feed-profiles?tool_type=%ed%a0%80",
    ] {
        let (status, code, answer) = told(query).await;
        assert_eq!((status, code.as_str()), (400, "invalid_query"), "{query}");
        assert_eq!(answer.errors(), [("tool_type".to_owned(), "invalid_value".to_owned())], "{query}");
        assert!(answer.json()["detail"].as_str().unwrap().contains("UTF-8"), "{answer:?}");
    }
    for query in ["feed-profiles?%ff=a", "feed-profiles?%ff"] {
        let (status, code, answer) = told(query).await;
        assert_eq!((status, code.as_str()), (400, "invalid_query"), "{query}");
        assert!(answer.json()["detail"].as_str().unwrap().contains("UTF-8"), "{answer:?}");
    }
    // Whoever asks for that very character gets it, and what is no escape is no escape.
    for query in
        ["feed-profiles?tool_type=%ef%bf%bd", "feed-profiles?tool_type=%C3%A9", "feed-profiles?tool_type=%zz"]
    {
        assert_eq!(told(query).await.0, 200, "{query}");
    }
}

async fn a_body_is_refused_for_its_type_its_size_or_its_form() {
    let app = App::with(&[("limits.registration_bytes", "1000")]).await;
    for kind in [None, Some("text/plain"), Some("application/x-www-form-urlencoded")] {
        let answer = put_raw(&app, kind, "{}").await;
        assert_eq!(answer.status, StatusCode::UNSUPPORTED_MEDIA_TYPE);
        assert_eq!(answer.code(), "unsupported_media_type");
    }
    let answer = put_raw(&app, Some("application/json"), &" ".repeat(1001)).await;
    assert_eq!((answer.status, answer.code().as_str()), (StatusCode::PAYLOAD_TOO_LARGE, "body_too_large"));
    for text in ["", "{", "nonsense", "{\"name\": \"x\",}", "{} {}"] {
        let answer = put_raw(&app, Some("application/json; charset=utf-8"), text).await;
        assert!(matches!(answer.status.as_u16(), 400 | 422), "{text}: {answer:?}");
        assert!(matches!(answer.code().as_str(), "malformed_json" | "missing_field"), "{text}");
    }
}

async fn a_body_that_does_not_tell_its_length_has_the_same_bounds() {
    let limits = ["limits.body_bytes", "limits.decoded_bytes", "limits.large_bodies_bytes"];
    let app = App::with(&limits.map(|limit| (limit, "1000000"))).await;
    let registered = put_raw(&app, Some("application/json"), &machine().to_string()).await;
    assert_eq!(registered.status, StatusCode::CREATED, "{registered:?}");
    let cycle = r#"{"cycle_id":"c1","tool":"T1","operation":"O1","started_at":"2026-05-04T06:00:00Z","reported":{"energy_joules":1}}"#;
    for (length, status) in
        [(10_000, 201), (262_144, 200), (262_145, 200), (1_000_000, 200), (1_000_001, 413)]
    {
        let text = cycle.to_owned() + &" ".repeat(length - cycle.len());
        let pieces: Vec<Result<Vec<u8>, Infallible>> =
            text.as_bytes().chunks(10_007).map(|piece| Ok(piece.to_vec())).collect();
        let request = Request::post("/v1/machines/M1/cycles")
            .header("authorization", format!("Bearer {}", app.token(Role::Machine)))
            .header("content-type", "application/json");
        let body = Body::from_stream(futures_util::stream::iter(pieces));
        let answer = app.send(request.body(body).unwrap()).await;
        assert_eq!(answer.status.as_u16(), status, "{length}: {answer:?}");
        if status == 413 {
            assert_eq!(answer.code(), "body_too_large");
        }
    }
}

async fn each_bad_field_is_named_by_its_path() {
    let app = App::new().await;
    let good = machine().to_string();
    for (from, to, path, code) in [
        ("\"name\"", "\"nmae\"", "nmae", "unknown_field"),
        ("\"base_speed_rpm\"", "\"base_speed\"", "spindle.base_speed", "unknown_field"),
        ("\"control\":\"sinumerik-840d\",", "", "control", "missing_field"),
        (
            "\"override_min_percent\":20.0",
            "\"override_max_percent\":20.0",
            "limits.override_max_percent",
            "duplicate_field",
        ),
        ("\"ipo_period_ms\":8.0", "\"ipo_period_ms\":\"8\"", "ipo_period_ms", "wrong_type"),
        ("\"ipo_period_ms\":8.0", "\"ipo_period_ms\":null", "ipo_period_ms", "wrong_type"),
        (
            "\"rated_power_watts\":11000.0",
            "\"rated_power_watts\":1e999",
            "spindle.rated_power_watts",
            "number_out_of_range",
        ),
        (
            "\"rated_power_watts\":11000.0",
            "\"rated_power_watts\":-1",
            "spindle.rated_power_watts",
            "out_of_range",
        ),
        ("\"rated_power\"", "\"rated_powr\"", "spindle.reference", "invalid_value"),
        (
            "\"override_max_percent\":150.0",
            "\"override_max_percent\":99.0",
            "limits.override_max_percent",
            "override_range",
        ),
        ("\"Friction drill 1\"", "\"\"", "name", "invalid_length"),
        ("\"Friction drill 1\"", "\"a\\u0000b\"", "name", "control_character"),
    ] {
        let body = good.replacen(from, to, 1);
        assert_ne!(body, good, "{from}");
        let answer = put_raw(&app, Some("application/json"), &body).await;
        assert_eq!(answer.status, StatusCode::UNPROCESSABLE_ENTITY, "{to}: {answer:?}");
        let alone = answer.errors().len() == 1;
        assert_eq!(answer.code(), if alone { code } else { "invalid_content" }, "{to}: {answer:?}");
        assert!(answer.errors().contains(&(path.to_owned(), code.to_owned())), "{to}: {:?}", answer.errors());
    }
    assert_eq!(app.get("/v1/machines/M1").await.status, StatusCode::NOT_FOUND, "nothing was kept");
}

async fn every_violation_is_listed_not_only_the_first() {
    let app = App::new().await;
    let mut body = machine();
    body["name"] = json!("");
    body["ipo_period_ms"] = json!(0.0);
    body["limits"]["override_min_percent"] = json!(0.0);
    body["limits"]["feed_max_mm_min"] = json!(5.0);
    let errors = app.put("/v1/machines/M1", body).await.errors();
    let paths: Vec<_> = errors.iter().map(|(path, _)| path.as_str()).collect();
    for path in ["name", "ipo_period_ms", "limits.override_min_percent", "limits.feed_max_mm_min"] {
        assert!(paths.contains(&path), "{paths:?}");
    }
}

async fn a_sane_request_id_is_taken_over_and_another_is_not() {
    let app = App::new().await;
    let answer = app.call(Role::Viewer, "GET", "/v1/tools/X", &[("x-request-id", "edge-7.A_1")], None).await;
    assert_eq!(answer.header("x-request-id"), "edge-7.A_1");
    answer.code();
    let long = "a".repeat(65);
    for id in ["", "a b", "\"quoted\"", "<script>", long.as_str()] {
        let answer = app.call(Role::Viewer, "GET", "/v1/tools/X", &[("x-request-id", id)], None).await;
        assert_eq!(answer.header("x-request-id").len(), 36, "{id}");
    }
    let several = [("x-request-id", "edge-7"), ("x-request-id", "edge-8")];
    let answer = app.call(Role::Viewer, "GET", "/v1/tools/X", &several, None).await;
    assert_eq!(answer.header("x-request-id").len(), 36, "neither of two");
}

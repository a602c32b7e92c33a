//! Health, readiness, metrics and the embedded viewer.

use super::app::App;
use crate::live::Served;
use axum::body::Body;
use feedwright_server::clock::Clock;
use feedwright_store::Role;
use http::{Request, StatusCode};
use serde_json::json;
use std::io::Read;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;
use tempfile::TempDir;

async fn open(app: &App, path: &str) -> super::app::Answer {
    app.send(Request::get(path).body(Body::empty()).unwrap()).await
}

#[tokio::test]
async fn it_is_ready_while_the_database_takes_writes_and_alive_even_when_not() {
    let app = App::new().await;
    assert_eq!(open(&app, "/healthz").await.status, StatusCode::OK);
    assert_eq!(open(&app, "/readyz").await.status, StatusCode::OK);
    app.state.lifecycle.fail("the database does not take writes: test");
    let answer = open(&app, "/readyz").await;
    assert_eq!((answer.status, answer.code().as_str()), (StatusCode::SERVICE_UNAVAILABLE, "not_ready"));
    assert!(!answer.header("retry-after").is_empty());
    assert!(!answer.json().to_string().contains("database"), "the reason is for the log");
    assert_eq!(open(&app, "/healthz").await.status, StatusCode::OK);
}

#[tokio::test]
async fn what_is_read_is_squeezed_for_who_asks_for_it_where_that_is_worth_the_work() {
    let app = App::registered().await;
    let tool = super::app::tool();
    for number in 0..60 {
        assert_eq!(app.put(&format!("/v1/tools/S{number}"), tool.clone()).await.status, StatusCode::CREATED);
    }
    let ask = |method, path, encoding| {
        let body = (method == "PUT").then(|| tool.clone());
        let headers = [("accept-encoding", encoding), ("if-match", "*")];
        let app = &app;
        async move { app.call(Role::Admin, method, path, &headers, body).await }
    };
    let plain = app.get("/v1/tools").await;
    assert!(plain.body.len() > 8000 && plain.header("content-encoding").is_empty());
    let squeezed = ask("GET", "/v1/tools", "br, gzip;q=0.8").await;
    assert_eq!(squeezed.header("content-encoding"), "gzip");
    assert!(squeezed.body.len() * 4 < plain.body.len(), "{}", squeezed.body.len());
    let mut again = Vec::new();
    flate2::read::GzDecoder::new(&*squeezed.body).read_to_end(&mut again).unwrap();
    assert_eq!(again, plain.body);
    assert!(ask("GET", "/v1/tools", "identity").await.header("content-encoding").is_empty());
    // A short answer, and what changes something.
    let one = ask("GET", "/v1/tools/S1", "gzip").await;
    assert!(one.header("content-encoding").is_empty() && !one.header("etag").is_empty());
    assert!(ask("PUT", "/v1/tools/S1", "gzip").await.header("content-encoding").is_empty());
}

/// A strong ETag names bytes (RFC 9110, section 8.8.3.3), and a change has to name it: what has one comes in one form.
#[tokio::test]
async fn what_has_a_strong_etag_is_squeezed_for_nobody() {
    let app = App::new().await;
    // Names as long as they may be make one thing as large as that.
    let long = "x".repeat(128);
    let range = |min: f64, max: f64| json!({"min": min, "max": max});
    let mut operation = json!({"process": "turning", "turning": {
        "model": long, "depth_mm": 2.5, "limits": {"power_kw": 7.0, "force_n": 1500.0, "wear_mm": 0.3},
        "domain": {"continuous": {"speed_m_min": range(50.0, 200.0), "feed_mm_rev": range(0.06, 0.6)}}}});
    for field in ["name", "program", "feature", "work_material"] {
        operation[field] = json!("\u{1f529}".repeat(200));
    }
    let path = format!("/v1/operations/{long}");
    let put = app.put(&path, operation).await;
    assert_eq!(put.status, StatusCode::CREATED, "{put:?}");
    let ask = async |headers: &[(&str, &str)]| app.call(Role::Viewer, "GET", &path, headers, None).await;
    let plain = ask(&[]).await;
    assert!(plain.body.len() > 4096, "{}", plain.body.len());
    let asked = ask(&[("accept-encoding", "gzip")]).await;
    assert_eq!((asked.header("etag"), asked.header("content-encoding")), (plain.header("etag"), ""));
    assert_eq!(asked.body, plain.body);
    let tag = plain.header("etag").to_owned();
    let known = ask(&[("accept-encoding", "gzip"), ("if-none-match", &tag)]).await;
    assert_eq!(known.status, StatusCode::NOT_MODIFIED);
    for header in ["vary", "etag", "cache-control"] {
        assert_eq!(known.header(header), asked.header(header), "{header}");
    }
    // What has none is squeezed, and says that it varies.
    let listed = app.call(Role::Viewer, "GET", "/v1/operations", &[("accept-encoding", "gzip")], None).await;
    assert_eq!((listed.header("content-encoding"), listed.header("vary")), ("gzip", "accept-encoding"));
}

#[tokio::test]
async fn a_closed_store_is_not_ready() {
    let app = App::new().await;
    app.state.store.close().await;
    assert_eq!(open(&app, "/readyz").await.status, StatusCode::SERVICE_UNAVAILABLE);
}

#[tokio::test]
async fn metrics_name_routes_and_never_what_was_asked_for() {
    let app = App::registered().await;
    app.get("/v1/tools/SECRET-SERIAL").await;
    app.get("/no/such/SECRET-PATH").await;
    app.call(Role::Viewer, "BREW", "/v1/tools", &[], None).await;
    let answer = app.get("/metrics").await;
    assert_eq!(answer.status, StatusCode::OK);
    assert!(answer.header("content-type").starts_with("text/plain"));
    let text = String::from_utf8(answer.body).unwrap();
    assert!(!text.contains("SECRET") && !text.contains("BREW"), "{text}");
    for line in [
        "feedwright_http_requests_total{method=\"GET\",route=\"/v1/tools/{tool}\",status=\"4xx\"} 1",
        "feedwright_http_requests_total{method=\"GET\",route=\"unmatched\",status=\"4xx\"} 1",
        "feedwright_http_requests_total{method=\"PUT\",route=\"/v1/machines/{machine}\",status=\"2xx\"} 1",
        "feedwright_cycles_total{outcome=\"accepted\"} 0",
        "feedwright_cycles_total{outcome=\"duplicate\"} 0",
        "feedwright_cycles_total{outcome=\"quarantined\"} 0",
        "feedwright_alarms_open{kind=\"overload\"} 0",
        "feedwright_cycles_rejected_total{reason=\"malformed_json\"} 0",
        "feedwright_cycles_rejected_total{reason=\"too_many_lines\"} 0",
        "feedwright_authentication_failures_total{reason=\"token_revoked\"} 0",
        "process_start_time_seconds ",
        "feedwright_ingest_queue_depth 0",
        "# TYPE feedwright_commit_seconds histogram",
        "# TYPE feedwright_commit_group_size histogram",
        "# TYPE feedwright_http_request_duration_seconds histogram",
        "feedwright_build_info{version=",
    ] {
        assert!(text.contains(line), "{line} is not in\n{text}");
    }
}

#[tokio::test]
async fn a_round_of_the_watch_fills_what_no_request_asks_about() {
    let app = App::with(&[
        ("watch.machine_silent_after_ms_by_machine", "M1=900000"),
        ("watch.machine_silent_after_ms", "0"),
        ("limits.metric_machines", "2"),
    ])
    .await;
    for machine in ["M1", "M2", "M3"] {
        assert_eq!(app.put(&format!("/v1/machines/{machine}"), super::app::machine()).await.status, 201);
    }
    feedwright_server::watch::round(&app.state).await.unwrap();
    let text = String::from_utf8(app.get("/metrics").await.body).unwrap();
    for line in [
        "feedwright_ready 1",
        "feedwright_machines 3",
        "feedwright_machine_silence_limit_seconds{machine=\"M1\"} 900\n",
        "feedwright_machine_silent{machine=\"M1\"} 0",
        "feedwright_machine_alarms_open{kind=\"worn\",machine=\"M2\"} 0",
        "feedwright_machine_cycles_total{machine=\"M2\",outcome=\"accepted\"} 0",
        "feedwright_quarantine_entries 0",
        "feedwright_quarantine_max_entries 10000",
        "feedwright_quarantine_max_size_bytes 1073741824",
        "feedwright_database_size_bytes ",
        "feedwright_database_wal_size_bytes{engine=\"sqlite\"} ",
        "feedwright_database_connections{state=\"in_use\"} ",
        "feedwright_disk_available_bytes{directory=\"data\"} ",
        "feedwright_watch_last_round_timestamp_seconds 1777874400\n",
    ] {
        assert!(text.contains(line), "{line} is not in\n{text}");
    }
    // Never heard of, never silent; and no more machines than are allowed a label.
    assert!(!text.contains("feedwright_machine_last_cycle_timestamp_seconds{"), "{text}");
    assert!(!text.contains("silence_limit_seconds{machine=\"M2\"}"), "{text}");
    let labelled = ["M1", "M2", "M3"].map(|machine| text.contains(&format!("machine=\"{machine}\"")));
    assert_eq!(labelled, [true, true, false]);
}

#[tokio::test]
async fn machines_without_series_of_their_own_are_told_together() {
    let app = App::with(&[("watch.machine_silent_after_ms", "60000"), ("limits.metric_machines", "1")]).await;
    for machine in ["M1", "M2"] {
        assert_eq!(app.put(&format!("/v1/machines/{machine}"), super::app::machine()).await.status, 201);
        let token = app.issue(Role::Machine, Some(machine.try_into().unwrap())).await;
        let overloaded = json!({
            "cycle_id": "c1", "tool": machine, "operation": "O1", "started_at": "2026-05-04T05:00:00Z",
            "samples": {"period_ms": 10, "spindle_load_percent": vec![500.0; 50]},
        });
        let posted = Request::post(format!("/v1/machines/{machine}/cycles"))
            .header("authorization", format!("Bearer {token}"))
            .header("content-type", "application/json")
            .body(Body::from(overloaded.to_string()))
            .unwrap();
        assert_eq!(app.send(posted).await.status, StatusCode::CREATED);
    }
    feedwright_server::watch::round(&app.state).await.unwrap();
    let text = String::from_utf8(app.get("/metrics").await.body).unwrap();
    for line in [
        "feedwright_alarms_open{kind=\"overload\"} 2\n",
        "feedwright_machine_alarms_open{kind=\"overload\",machine=\"M1\"} 1\n",
        "feedwright_other_machines_alarms_open{kind=\"overload\"} 1\n",
        "feedwright_other_machines_alarms_open{kind=\"worn\"} 0\n",
        "feedwright_other_machines_silent 0\n",
    ] {
        assert!(text.contains(line), "{line} is not in\n{text}");
    }
    assert!(!text.contains("machine=\"M2\""), "{text}");
}

#[tokio::test]
async fn a_round_of_the_watch_shows_what_no_cycle_tells_of_a_tool() {
    let app = App::registered().await;
    assert_eq!(app.put("/v1/operations/O1", super::app::operation()).await.status, 201);
    for number in 1..=6 {
        let cycle = json!({
            "cycle_id": format!("c{number}"), "tool": "T1", "operation": "O1",
            "started_at": format!("2026-05-04T05:00:0{number}Z"), "reported": {"energy_joules": 1000.0},
        });
        let posted = app.call(Role::Machine, "POST", "/v1/machines/M1/cycles", &[], Some(cycle)).await;
        assert_eq!(posted.status, 201);
    }
    let metrics = async || String::from_utf8(app.get("/metrics").await.body).unwrap();
    let level = "feedwright_tool_wear_level_ratio{machine=\"M1\"} 1\n";
    assert!(metrics().await.contains(level));
    let changed = json!({"kind": "changed", "at": "2026-05-04T05:30:00Z", "reason": "story"});
    assert_eq!(app.post("/v1/tools/T1/events", changed).await.status, 201);
    feedwright_server::watch::round(&app.state).await.unwrap();
    let text = metrics().await;
    assert!(!text.contains("feedwright_tool_wear_level_ratio{"), "a new tool has no level: {text}");
}

#[tokio::test]
async fn the_viewer_comes_out_of_the_binary() {
    let app = App::new().await;
    let answer = open(&app, "/docs").await;
    assert_eq!((answer.status, answer.header("location")), (StatusCode::PERMANENT_REDIRECT, "/docs/"));
    let page = open(&app, "/docs/").await;
    assert_eq!(page.status, StatusCode::OK);
    let html = String::from_utf8(page.body).unwrap();
    assert!(
        !html.contains("http://") && !html.contains("https://"),
        "it loads nothing from elsewhere: {html}"
    );
    for file in ["swagger-ui.css", "swagger-ui-bundle.js", "swagger-ui-standalone-preset.js", "index.css"] {
        assert_eq!(open(&app, &format!("/docs/{file}")).await.status, StatusCode::OK, "{file}");
    }
    let script = String::from_utf8(open(&app, "/docs/swagger-initializer.js").await.body).unwrap();
    assert!(script.contains("/openapi.json"), "{script}");
    let answer = open(&app, "/docs/none.js").await;
    assert_eq!((answer.status, answer.code().as_str()), (StatusCode::NOT_FOUND, "not_found"));
}

#[tokio::test]
async fn that_recommendations_are_neutral_is_shown_as_long_as_the_last_one_is_valid() {
    let seconds = Arc::new(AtomicI64::new(0));
    let (right, ahead) = (Clock::system(), seconds.clone());
    let clock = Clock::new(move || right.now().plus_millis(ahead.load(Ordering::Relaxed) * 1000));
    let dir = TempDir::new().unwrap();
    let settings = [
        ("watch.interval_ms", "100"),
        ("recommendation.validity_ms", "900000"),
        ("metrics.listen", "127.0.0.1:0"),
    ];
    let served = Served::start_by(clock, dir.path(), None, &settings).await;
    served.with_a_shop().await;
    let metrics = format!("http://{}/metrics", served.server.metrics_addr.unwrap());
    let shown = async || {
        let text = served.client.get(&metrics).send().await.unwrap().text().await.unwrap();
        let begins = "feedwright_machine_recommendation_neutral_since_timestamp_seconds{machine=\"M1\"";
        text.lines().find(|line| line.starts_with(begins)).map(str::to_owned)
    };
    served.post_cycle("c1", 20.0).await;
    let first = shown().await.expect("nobody has approved a feed profile");
    seconds.store(901, Ordering::Relaxed);
    let gone = async { while shown().await.is_some() {} };
    tokio::time::timeout(Duration::from_secs(20), gone).await.expect("it is not valid any more");
    // It was neutral all the time.
    served.post_cycle("c2", 20.0).await;
    assert_eq!(shown().await, Some(first));
    served.server.shutdown().await.unwrap();
}

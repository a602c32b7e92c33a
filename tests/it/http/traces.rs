//! Traces and log lines of the binary itself: in the caller's trace, under one request id, and without any secret.

use super::app::machine;
use super::commands::binary;
use axum::Router;
use axum::body::Bytes;
use axum::extract::State;
use axum::routing::post;
use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceRequest;
use opentelemetry_proto::tonic::common::v1::any_value::Value as Held;
use opentelemetry_proto::tonic::trace::v1::Span;
use prost::Message;
use serde_json::{Value, json};
use std::process::Stdio;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tempfile::TempDir;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, BufReader};
use tokio::process::Command;

const TRACE: &str = "4bf92f3577b34da6a3ce929d0e0e4736";
const CALLER: &str = "00f067aa0ba902b7";
const PATIENCE: Duration = Duration::from_secs(60);

/// What a collector received: spans, and the headers it was sent.
#[derive(Clone, Default)]
struct Collected {
    spans: Arc<Mutex<Vec<Span>>>,
    authorizations: Arc<Mutex<Vec<String>>>,
}

async fn take(State(collected): State<Collected>, headers: http::HeaderMap, body: Bytes) {
    let request = ExportTraceServiceRequest::decode(body).unwrap();
    let spans = request.resource_spans.into_iter().flat_map(|of| of.scope_spans).flat_map(|of| of.spans);
    collected.spans.lock().unwrap().extend(spans);
    let authorization = headers.get("authorization").map_or("", |value| value.to_str().unwrap());
    collected.authorizations.lock().unwrap().push(authorization.to_owned());
}

fn attribute(span: &Span, key: &str) -> String {
    let found = span.attributes.iter().find(|attribute| attribute.key == key);
    match found.and_then(|attribute| attribute.value.as_ref()).and_then(|value| value.value.as_ref()) {
        Some(Held::StringValue(text)) => text.clone(),
        Some(Held::IntValue(number)) => number.to_string(),
        other => format!("{other:?}"),
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[tokio::test]
async fn a_request_is_a_span_of_its_callers_trace_and_a_line_of_the_log_and_neither_holds_a_secret() {
    let collected = Collected::default();
    let collector = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let endpoint = format!("http://{}", collector.local_addr().unwrap());
    let app = Router::new().route("/v1/traces", post(take)).with_state(collected.clone());
    tokio::spawn(async move { axum::serve(collector, app).await.unwrap() });

    let dir = TempDir::new().unwrap();
    let file = dir.path().join("first-token");
    let mut child = Command::new(binary())
        .args(["serve", "--listen", "127.0.0.1:0", "--data-dir", dir.path().join("data").to_str().unwrap()])
        .args(["--first-token-file", file.to_str().unwrap()])
        .env("FEEDWRIGHT__TRACES__ENDPOINT", &endpoint)
        .env("FEEDWRIGHT__TRACES__HEADERS", "authorization=Bearer hunter2")
        .env("FEEDWRIGHT__LOG__FORMAT", "json")
        // Everything that anything in the process says, libraries too.
        .env("FEEDWRIGHT__LOG__LEVEL", "trace")
        .stderr(Stdio::piped())
        .kill_on_drop(true)
        .spawn()
        .unwrap();
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    let mut log = String::new();
    let address = loop {
        let mut line = String::new();
        assert!(stderr.read_line(&mut line).await.unwrap() > 0, "it ended: {log}");
        log.push_str(&line);
        let said: Value = serde_json::from_str(&line).unwrap();
        if said["message"] == "listening" {
            break said["address"].as_str().unwrap().to_owned();
        }
    };
    // The pipe is read all the time: a full one would stop the service.
    let rest = tokio::spawn(async move {
        let mut rest = String::new();
        stderr.read_to_string(&mut rest).await.unwrap();
        rest
    });

    let until = tokio::time::Instant::now() + PATIENCE;
    let admin = loop {
        let text = std::fs::read_to_string(&file).unwrap_or_default();
        if text.ends_with('\n') {
            break text.trim().to_owned();
        }
        assert!(tokio::time::Instant::now() < until, "no token is left");
        tokio::time::sleep(Duration::from_millis(10)).await;
    };
    feedwright_server::tls::use_ring();
    let client = reqwest::Client::new();
    let put = client.put(format!("http://{address}/v1/machines/M1")).bearer_auth(&admin).json(&machine());
    let put = put.header("x-request-id", "cell-7").header("traceparent", format!("00-{TRACE}-{CALLER}-01"));
    let answer = put.send().await.unwrap();
    assert_eq!(
        (answer.status().as_u16(), &answer.headers()["x-request-id"]),
        (201, &"cell-7".parse().unwrap())
    );
    let cycle = json!({"cycle_id": "c1", "tool": "T1", "operation": "O1", "started_at": "2026-05-04T06:00:00Z",
                       "reported": {"energy_joules": 2000}});
    let posted =
        client.post(format!("http://{address}/v1/machines/M1/cycles")).bearer_auth(&admin).json(&cycle);
    // Of two parents it is the child of neither.
    let parents = [CALLER, "00f067aa0ba902b8"].map(|caller| format!("00-{TRACE}-{caller}-01"));
    let posted = parents.iter().fold(posted, |posted, parent| posted.header("traceparent", parent));
    assert_eq!(posted.send().await.unwrap().status().as_u16(), 201);
    let made = client.post(format!("http://{address}/v1/tokens")).bearer_auth(&admin);
    let made: Value =
        made.json(&json!({"name": "MES", "role": "viewer"})).send().await.unwrap().json().await.unwrap();
    let made = made["token"].as_str().unwrap().to_owned();
    let refused = format!("fwt_{}_{}_01234567", "0".repeat(24), "7a".repeat(32));
    let denied =
        client.get(format!("http://{address}/v1/machines")).bearer_auth(&refused).send().await.unwrap();
    assert_eq!(denied.status().as_u16(), 401);

    let pid = child.id().unwrap().to_string();
    assert!(Command::new("kill").args(["-TERM", &pid]).status().await.unwrap().success());
    let ended = tokio::time::timeout(PATIENCE, child.wait()).await.expect("it ends").unwrap();
    log.push_str(&rest.await.unwrap());
    assert!(ended.success(), "{log}");

    // The last spans left before the process did.
    let spans = collected.spans.lock().unwrap();
    let names: Vec<_> = spans.iter().map(|span| span.name.as_str()).collect();
    let one = |name: &str| {
        spans.iter().find(|span| span.name == name).unwrap_or_else(|| panic!("no {name} in {names:?}"))
    };
    let put = one("PUT /v1/machines/{machine}");
    assert_eq!((hex(&put.trace_id), hex(&put.parent_span_id)), (TRACE.to_owned(), CALLER.to_owned()));
    assert_eq!(attribute(put, "http.response.status_code"), "201");
    assert_eq!(attribute(put, "id"), "cell-7");
    assert_eq!(put.kind, 2, "a server's");
    let commit = one("commit");
    assert_eq!(attribute(commit, "cycles"), "1");
    assert_ne!(hex(&one("POST /v1/machines/{machine}/cycles").trace_id), TRACE, "a trace of its own");
    let authorizations = collected.authorizations.lock().unwrap();
    assert!(authorizations.iter().all(|header| header == "Bearer hunter2"), "{authorizations:?}");

    let lines: Vec<Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let line = lines.iter().find(|line| line["message"] == "answered" && line["span"]["id"] == "cell-7");
    let span = &line.expect("a line of the request")["span"];
    assert_eq!((&span["trace_id"], &span["route"]), (&json!(TRACE), &json!("/v1/machines/{machine}")));
    assert_eq!(span["token"], admin.split('_').nth(1).unwrap(), "who, by its public id");
    let told = format!("{log}{spans:?}");
    let secrets = [("the admin's token", admin), ("a token that was made", made), ("one refused", refused)];
    for (what, secret) in secrets {
        // The id is public; what follows it is not.
        let secret = secret.split('_').nth(2).unwrap();
        assert!(secret.len() == 64 && !told.contains(secret), "{what} is in the log");
    }
    assert!(!told.contains("hunter2"), "the collector's secret is in the log");
}

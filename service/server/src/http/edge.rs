//! The outermost layer: request id, log line, metrics, panics, and the rendering of problems.

use super::extract::path_not_utf8;
use super::once::once;
use super::problem::Problem;
use crate::auth::Peer;
use crate::state::AppState;
use crate::telemetry;
use axum::extract::{MatchedPath, Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures_util::FutureExt;
use http::{HeaderName, HeaderValue, StatusCode, Version, header};
use std::panic::AssertUnwindSafe;
use std::time::Instant;
use tracing::Instrument;

static REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
/// Longest request id that is taken over from a client; the log is not its notebook.
const MAX_REQUEST_ID: usize = 64;

/// The name of a request in the log and in problem documents.
#[derive(Debug, Clone)]
pub struct RequestId(pub String);

/// Answers one request.
pub(crate) async fn answer(State(state): State<AppState>, mut request: Request, next: Next) -> Response {
    let begun = Instant::now();
    let id = request_id(&request);
    request.extensions_mut().insert(RequestId(id.clone()));
    let method = request.method().clone();
    let route = request.extensions().get::<MatchedPath>().cloned();
    let route = route.as_ref().map_or("unmatched", MatchedPath::as_str);
    let peer = request.extensions().get::<Peer>().map(|peer| tracing::field::display(peer.0));
    let empty = tracing::field::Empty;
    let span = tracing::info_span!(
        "request",
        id,
        %method,
        route,
        peer,
        token = empty,
        trace_id = empty,
        otel.name = empty,
        otel.kind = empty,
        http.response.status_code = empty
    );
    if state.config.traces.is_on() {
        telemetry::adopt(&span, method.as_str(), route, request.headers());
    }

    let response = match without_one_host(&request).or_else(|| with_path_not_utf8(&request)) {
        Some(problem) => problem.into_response(),
        None => {
            let ran = AssertUnwindSafe(next.run(request)).catch_unwind().instrument(span.clone()).await;
            ran.unwrap_or_else(|_| Problem::internal("a handler panicked").into_response())
        }
    };
    let mut response = finish(response, &id, &span);

    let status = response.status();
    let elapsed = begun.elapsed();
    if state.config.traces.is_on() {
        span.record("http.response.status_code", status.as_u16());
    }
    state.metrics.http(route, &method, status, elapsed);
    span.in_scope(|| {
        let elapsed_ms = elapsed.as_secs_f64() * 1000.0;
        tracing::info!(status = status.as_u16(), elapsed_ms, "answered");
    });
    let headers = response.headers_mut();
    if let Ok(id) = HeaderValue::try_from(id) {
        headers.insert(REQUEST_ID.clone(), id);
    }
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    response
}

/// Refuses what RFC 9112, section 3.2, has refused, so that nobody in between takes it for a request to another host. HTTP/1.0,
/// which health checks speak, needs no host; nor does what came over no connection.
fn without_one_host(request: &Request) -> Option<Problem> {
    request.extensions().get::<Peer>()?;
    let detail = match request.headers().get_all(header::HOST).iter().count() {
        0 if request.version() == Version::HTTP_11 => "HTTP/1.1 needs the header Host",
        0 | 1 => return None,
        _ => "there is more than one header Host",
    };
    Some(Problem::bad_request("invalid_host", detail))
}

/// Refuses such a path before the router does, which has no words for it.
fn with_path_not_utf8(request: &Request) -> Option<Problem> {
    let is_utf8 = percent_encoding::percent_decode_str(request.uri().path()).decode_utf8().is_ok();
    (!is_utf8).then(path_not_utf8)
}

fn request_id(request: &Request) -> String {
    let given = once(request.headers(), &REQUEST_ID).ok().flatten().and_then(|id| id.to_str().ok());
    let sane = |id: &&str| {
        let plain = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'-' | b'_' | b'.');
        (1..=MAX_REQUEST_ID).contains(&id.len()) && id.bytes().all(plain)
    };
    given.filter(sane).map_or_else(|| uuid::Uuid::now_v7().to_string(), str::to_owned)
}

/// Renders a problem with the request's id, and logs its private part, once.
fn finish(mut response: Response, id: &str, span: &tracing::Span) -> Response {
    let problem = response.extensions_mut().remove::<Problem>().or_else(|| stray(&response));
    let Some(problem) = problem else {
        return response;
    };
    if let Some(private) = &problem.private {
        let code = problem.code;
        span.in_scope(|| match problem.status.is_server_error() {
            true => tracing::error!(code, private, "request failed"),
            // Nobody has to look at a connection that a machine lost.
            false => tracing::info!(code, private, "request refused"),
        });
    }
    let mut rendered = problem.render(Some(id));
    // Such as `Allow`, which the router adds to a 405.
    for (name, value) in response.headers() {
        if *name != header::CONTENT_LENGTH && !rendered.headers().contains_key(name) {
            rendered.headers_mut().append(name, value.clone());
        }
    }
    rendered
}

/// The problem for an error answer that no code of this crate made, such as a library's rejection.
fn stray(response: &Response) -> Option<Problem> {
    let status = response.status();
    // Nothing but our own pages answers in HTML.
    let is_page = response
        .headers()
        .get(header::CONTENT_TYPE)
        .is_some_and(|kind| kind.as_bytes().starts_with(b"text/html"));
    let is_error = !is_page && (status.is_client_error() || status.is_server_error());
    let code = match status {
        StatusCode::METHOD_NOT_ALLOWED => "method_not_allowed",
        StatusCode::NOT_FOUND => "not_found",
        _ if status.is_client_error() => "bad_request",
        _ => "internal_error",
    };
    is_error.then(|| Problem::new(status, code, status.canonical_reason().unwrap_or("error")))
}

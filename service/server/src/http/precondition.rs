//! ETags and the preconditions on them (RFC 9110, sections 8.8.3 and 13).

use super::problem::Problem;
use axum::response::{IntoResponse, Response};
use feedwright_store::{Precondition, PutOutcome};
use http::{HeaderMap, HeaderValue, StatusCode, header};
use serde::Serialize;

/// The ETag of a version.
pub fn etag(version: u64) -> HeaderValue {
    HeaderValue::try_from(format!("\"{version}\"")).unwrap_or(HeaderValue::from_static("\"\""))
}

/// What a change expects to find: `If-Match: "3"`, `If-None-Match: *`, or nothing.
pub fn expected(headers: &HeaderMap) -> Result<Precondition, Problem> {
    let text = |name| headers.get(name).map(|value| value.to_str().unwrap_or_default().trim());
    match (text(header::IF_MATCH), text(header::IF_NONE_MATCH)) {
        (None, None) => Ok(Precondition::Unstated),
        (None, Some("*")) => Ok(Precondition::Absent),
        (Some(tag), None) => match version(tag) {
            Some(version) => Ok(Precondition::Version(version)),
            None => Err(Problem::bad_request(
                "invalid_precondition",
                "If-Match takes the one ETag that the last answer carried, as in \"3\"",
            )),
        },
        _ => Err(Problem::bad_request(
            "invalid_precondition",
            "a change takes If-Match with an ETag, or `If-None-Match: *`, and not both",
        )),
    }
}

/// The version of a strong ETag of this service.
fn version(tag: &str) -> Option<u64> {
    tag.strip_prefix('"')?.strip_suffix('"')?.parse().ok().filter(|&version| version > 0)
}

/// Answers a read: 304 where the client has this version.
pub fn answer_read<T: Serialize>(headers: &HeaderMap, at: u64, view: &T) -> Response {
    let known = headers.get(header::IF_NONE_MATCH).and_then(|value| value.to_str().ok());
    let has = |tags: &str| {
        tags.split(',').map(|tag| tag.trim().trim_start_matches("W/")).any(|tag| version(tag) == Some(at))
    };
    let tag = [(header::ETAG, etag(at))];
    if known.is_some_and(has) {
        return (StatusCode::NOT_MODIFIED, tag).into_response();
    }
    (tag, axum::Json(view)).into_response()
}

/// Answers a change: 201 with its place where it is new, else 200.
pub fn answer_put<T: Serialize>(outcome: PutOutcome, place: &str, view: &T) -> Response {
    let tag = (header::ETAG, etag(outcome.version()));
    match (outcome, HeaderValue::try_from(place)) {
        (PutOutcome::Created, Ok(place)) => {
            (StatusCode::CREATED, [tag, (header::LOCATION, place)], axum::Json(view)).into_response()
        }
        _ => ([tag], axum::Json(view)).into_response(),
    }
}

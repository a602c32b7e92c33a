//! Reading bodies within their bounds, and JSON out of them with the path of what is wrong.

use super::problem::Problem;
use crate::ingest::scan::first_non_finite;
use crate::server::BodyTooSlow;
use axum::extract::rejection::{BytesRejection, FailedToBufferBody};
use axum::extract::{FromRequest, Request};
use bytes::Bytes;
use feedwright_core::invalid::Violation;
use http::{HeaderMap, StatusCode, header};
use serde::de::DeserializeOwned;
use std::error::Error;

/// A JSON body that was read completely and names nothing unknown. The type denies unknown fields.
#[derive(Debug)]
pub struct Json<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Json<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        let kind = media_type(request.headers());
        if kind.as_deref() != Some("application/json") {
            return Err(unsupported("send the body as application/json"));
        }
        if request.headers().contains_key(header::CONTENT_ENCODING) {
            return Err(unsupported("this body must not be compressed"));
        }
        let bytes = read(request, state).await?;
        // Serde would take a list for the fields in their order, and an empty one for every default.
        if bytes.iter().find(|byte| !byte.is_ascii_whitespace()) == Some(&b'[') {
            return Err(Violation::new("", "wrong_type", "must be an object, is a list").into());
        }
        parse(&bytes).map(Self)
    }
}

/// The media type of a body without its parameters, in lower case.
pub fn media_type(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(header::CONTENT_TYPE)?.to_str().ok()?;
    Some(value.split(';').next()?.trim().to_ascii_lowercase())
}

/// 415 with a sentence.
pub fn unsupported(detail: &'static str) -> Problem {
    Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported_media_type", detail)
}

/// Reads a body as it came, within the route's limit: 413 over it, 408 too slow, 400 where it breaks off.
pub async fn read<S: Send + Sync>(request: Request, state: &S) -> Result<Bytes, Problem> {
    Bytes::from_request(request, state).await.map_err(|rejection| match rejection {
        BytesRejection::FailedToBufferBody(FailedToBufferBody::LengthLimitError(_)) => Problem::new(
            StatusCode::PAYLOAD_TOO_LARGE,
            "body_too_large",
            "the body is larger than this takes",
        ),
        other if is_too_slow(&other) => {
            Problem::new(StatusCode::REQUEST_TIMEOUT, "body_too_slow", "the body did not arrive in time")
        }
        other => Problem::bad_request("body_incomplete", "the body broke off").private(other.to_string()),
    })
}

fn is_too_slow(error: &(dyn Error + 'static)) -> bool {
    let mut at = Some(error);
    while let Some(error) = at {
        if error.is::<BodyTooSlow>() {
            return true;
        }
        at = error.source();
    }
    false
}

/// Parses JSON: 400 where it is none, 422 with the path where it is not what was expected.
pub fn parse<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    let mut json = serde_json::Deserializer::from_slice(bytes);
    let parsed = serde_path_to_error::deserialize(&mut json).map_err(|error| {
        // Meant as JSON but for a word like NaN: named like every other bad field. Numbers too large are told below.
        if error.inner().is_syntax()
            && !error.inner().to_string().starts_with("number out of range")
            && let Some((path, literal)) = first_non_finite(bytes)
        {
            return Violation::new(path, "not_finite", format!("must be a finite number, is {literal}"))
                .into();
        }
        let path = error.path().to_string();
        explain(&path, error.inner())
    })?;
    json.end().map_err(|error| explain("", &error))?;
    Ok(parsed)
}

/// Tells what is wrong with JSON, with a stable code and the path.
fn explain(path: &str, error: &serde_json::Error) -> Problem {
    let message = error.to_string();
    let named = |prefix: &str| message.strip_prefix(prefix).and_then(|rest| rest.split('`').next());
    let join = |name: &str| match path {
        "" | "." => name.to_owned(),
        path if path == name || path.ends_with(&format!(".{name}")) => path.to_owned(),
        path => format!("{path}.{name}"),
    };
    let sentence = message.rsplit_once(" at line ").map_or(message.as_str(), |(sentence, _)| sentence);
    let violation = |path: String, code| Problem::from(Violation::new(path, code, sentence));
    if let Some(name) = named("unknown field `") {
        return violation(join(name), "unknown_field");
    }
    if let Some(name) = named("missing field `") {
        return violation(join(name), "missing_field");
    }
    if let Some(name) = named("duplicate field `") {
        return violation(join(name), "duplicate_field");
    }
    let here = if path == "." { String::new() } else { path.to_owned() };
    if message.starts_with("number out of range") {
        return violation(here, "number_out_of_range");
    }
    if error.is_data() {
        let code = if message.starts_with("invalid type") { "wrong_type" } else { "invalid_value" };
        return violation(here, code);
    }
    Problem::bad_request("malformed_json", format!("the body is no JSON: {message}"))
}

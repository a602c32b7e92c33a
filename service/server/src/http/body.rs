//! Reading bodies within their bounds, and JSON out of them with the path of what is wrong.

use super::problem::Problem;
use crate::json::{self, Wrong};
use crate::server::BodyTooSlow;
use axum::extract::rejection::{BytesRejection, FailedToBufferBody};
use axum::extract::{FromRequest, Request};
use bytes::Bytes;
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
    json::read(bytes).map_err(|wrong| match wrong {
        Wrong::Malformed(why) => {
            Problem::bad_request("malformed_json", format!("the body is no JSON: {why}"))
        }
        Wrong::Field(violation) => violation.into(),
    })
}

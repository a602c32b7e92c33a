//! Reading bodies within their bounds, and JSON out of them with the path of what is wrong.

use super::once::{Repeated, once};
use super::problem::Problem;
use crate::ingest::content::{Encoding, Room, Unpacked};
use crate::json::{self, Wrong};
use crate::server::BodyTooSlow;
use axum::body::BodyDataStream;
use axum::extract::rejection::{BytesRejection, FailedToBufferBody};
use axum::extract::{FromRequest, Request};
use bytes::Bytes;
use futures_util::StreamExt;
use http::{HeaderMap, StatusCode, header};
use hyper::body::Body as _;
use serde::de::DeserializeOwned;
use std::error::Error;
use std::fmt::Display;

/// A JSON body that was read completely and names nothing unknown. The type denies unknown fields.
#[derive(Debug)]
pub struct Json<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Json<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        let kind = media_type(request.headers())?;
        if kind.as_deref() != Some("application/json") {
            return Err(unsupported("send the body as application/json"));
        }
        if encoding_of(request.headers()) != Some(Encoding::Identity) {
            return Err(unsupported("this body must not be compressed"));
        }
        let bytes = read(request, state).await?;
        parse(&bytes).map(Self)
    }
}

/// How a body is compressed; `None` where that is not known. Several lines are one list, and none of several encodings is taken.
pub fn encoding_of(headers: &HeaderMap) -> Option<Encoding> {
    let given = once(headers, header::CONTENT_ENCODING).ok()?;
    Encoding::parse(given.map(|one| one.to_str().unwrap_or("?")))
}

/// The media type of a body without its parameters, in lower case; 415 where there are several.
pub fn media_type(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let given = once(headers, header::CONTENT_TYPE)
        .map_err(|Repeated| unsupported("there is more than one header Content-Type"))?;
    let given = given.and_then(|value| value.to_str().ok()?.split(';').next());
    Ok(given.map(|kind| kind.trim().to_ascii_lowercase()))
}

/// 415 with a sentence.
pub fn unsupported(detail: &'static str) -> Problem {
    Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported_media_type", detail)
}

/// Reads a body as it came, within the route's limit: 413 over it, 408 too slow, 400 where it breaks off.
pub async fn read<S: Send + Sync>(request: Request, state: &S) -> Result<Bytes, Problem> {
    Bytes::from_request(request, state).await.map_err(|rejection| match rejection {
        BytesRejection::FailedToBufferBody(FailedToBufferBody::LengthLimitError(_)) => too_large(),
        other if found::<BodyTooSlow>(&other) => too_slow(),
        other => broken_off(&other),
    })
}

/// As [`read`], of a body that is read within a room where it is large, and is at most `most` bytes by its route.
pub async fn read_within<S: Send + Sync>(
    request: Request,
    state: &S,
    room: &Room,
    most: usize,
) -> Result<Unpacked, Problem> {
    let told = request.body().size_hint();
    // Known before anything of it is there, as mostly.
    if let Some(length) = told.exact().map(|length| usize::try_from(length).unwrap_or(usize::MAX)) {
        // Whoever asks before sending it need not send it.
        if length > most && request.headers().contains_key(header::EXPECT) {
            return Err(too_large());
        }
        // What is too large for the route is refused without a place.
        let Ok(place) = room.place(if length <= most { length } else { 0 }).await else {
            return Err(passed_by(request.into_body().into_data_stream()).await);
        };
        return Ok(Unpacked { bytes: read(request, state).await?, place });
    }
    let mut body = request.into_body().into_data_stream();
    let (mut bytes, mut place) = (Vec::new(), room.growing());
    while let Some(data) = body.next().await {
        let data = data.map_err(|error| match found::<BodyTooSlow>(&error) {
            true => too_slow(),
            false => broken_off(&error),
        })?;
        let length = bytes.len() + data.len();
        if length > most {
            return Err(too_large());
        }
        if place.grow_to(length).await.is_err() {
            drop((bytes, place));
            return Err(passed_by(body).await);
        }
        // Memory as large as its place and no larger; what is small, and has none, grows as it likes.
        if bytes.capacity() < place.bytes() {
            bytes.reserve_exact(place.bytes() - bytes.len());
        }
        bytes.extend_from_slice(&data);
    }
    let place = place.ended(bytes.len());
    Ok(Unpacked { bytes: bytes.into_boxed_slice().into(), place })
}

/// Lets the rest of a body go by unread, so that whoever sends it gets to know why: 503.
async fn passed_by(mut body: BodyDataStream) -> Problem {
    while let Some(Ok(_)) = body.next().await {}
    no_room()
}

/// 503: the room for large bodies is taken.
pub fn no_room() -> Problem {
    Problem::unavailable("too_many_large_bodies", "other large bodies are being taken in", 2)
}

fn too_large() -> Problem {
    let detail = "the body is larger than this takes";
    Problem::new(StatusCode::PAYLOAD_TOO_LARGE, "body_too_large", detail)
}

fn too_slow() -> Problem {
    Problem::new(StatusCode::REQUEST_TIMEOUT, "body_too_slow", "the body did not arrive in time")
}

fn broken_off(why: &dyn Display) -> Problem {
    Problem::bad_request("body_incomplete", "the body broke off").private(why.to_string())
}

/// Whether an error or one beneath it is of a kind.
fn found<E: Error + 'static>(error: &(dyn Error + 'static)) -> bool {
    let mut at = Some(error);
    while let Some(error) = at {
        if error.is::<E>() {
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

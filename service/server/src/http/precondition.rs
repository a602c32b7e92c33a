//! ETags and the preconditions on them (RFC 9110, sections 8.8.3 and 13).

use super::once::{Repeated, once};
use super::problem::Problem;
use axum::response::{IntoResponse, Response};
use feedwright_store::{Precondition, PutOutcome};
use http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use serde::Serialize;

/// Stands in an ETag between the version and what the view shows.
const OF_VIEW: char = '-';
/// Digits that tell what a view shows.
const DIGEST: usize = 16;

/// The ETag of a version.
pub fn etag(version: u64) -> HeaderValue {
    HeaderValue::try_from(format!("\"{version}\"")).unwrap_or(HeaderValue::from_static("\"\""))
}

/// The ETag of a view that changes within one version: it names the version, which is all that a change based on it needs, and what the view
/// shows.
pub fn etag_of<T: Serialize>(version: u64, view: &T) -> HeaderValue {
    let shown = serde_json::to_vec(view).unwrap_or_default();
    let digest = blake3::hash(&shown).to_hex();
    HeaderValue::try_from(format!("\"{version}{OF_VIEW}{}\"", &digest[..DIGEST]))
        .unwrap_or(HeaderValue::from_static("\"\""))
}

/// What a change expects to find: `If-Match: "3"`, `If-None-Match: *`, or nothing.
pub fn expected(headers: &HeaderMap) -> Result<Precondition, Problem> {
    let text = |name: HeaderName| match once(headers, &name) {
        Ok(value) => Ok(value.map(|value| value.to_str().unwrap_or_default().trim())),
        Err(Repeated) => Err(Problem::bad_request(
            "invalid_precondition",
            format!("there is more than one header {name}: a change takes one with one ETag, or `*`"),
        )),
    };
    match (text(header::IF_MATCH)?, text(header::IF_NONE_MATCH)?) {
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

/// The version of a strong ETag of this service, whatever the view showed besides.
fn version(tag: &str) -> Option<u64> {
    let tag = tag.strip_prefix('"')?.strip_suffix('"')?;
    let version = match tag.split_once(OF_VIEW) {
        Some((version, digest))
            if digest.len() == DIGEST && digest.bytes().all(|b| b.is_ascii_hexdigit()) =>
        {
            version
        }
        Some(_) => return None,
        None => tag,
    };
    version.parse().ok().filter(|&version| version > 0)
}

/// Whether the client has what this ETag names: `If-None-Match`, where weak ones count, and `*` names anything that is there.
pub fn is_known(headers: &HeaderMap, etag: &str) -> bool {
    let lists = headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    let mut tags = lists.flat_map(|list| list.split(',')).map(str::trim);
    tags.any(|tag| tag == "*" || tag.strip_prefix("W/").unwrap_or(tag) == etag)
}

/// Answers a read: 304 where the client has this version.
pub fn answer_read<T: Serialize>(headers: &HeaderMap, at: u64, view: &T) -> Response {
    answer_tagged(headers, etag(at), view)
}

/// The same by an ETag.
pub fn answer_tagged<T: Serialize>(headers: &HeaderMap, tag: HeaderValue, view: &T) -> Response {
    let has = tag.to_str().is_ok_and(|tag| is_known(headers, tag));
    let tag = [(header::ETAG, tag)];
    if has {
        return (StatusCode::NOT_MODIFIED, tag).into_response();
    }
    (tag, axum::Json(view)).into_response()
}

/// Answers a change: 201 with its place where it is new, else 200.
pub fn answer_put<T: Serialize>(outcome: PutOutcome, place: &str, view: &T) -> Response {
    let mut response = put_response(outcome, place, view);
    if let PutOutcome::Unchanged(_) = outcome {
        response.extensions_mut().insert(NothingChanged);
    }
    response
}

/// On an answer to a change that found everything as it should be.
#[derive(Debug, Clone, Copy)]
pub struct NothingChanged;

fn put_response<T: Serialize>(outcome: PutOutcome, place: &str, view: &T) -> Response {
    let tag = (header::ETAG, etag(outcome.version()));
    match (outcome, HeaderValue::try_from(place)) {
        (PutOutcome::Created, Ok(place)) => {
            (StatusCode::CREATED, [tag, (header::LOCATION, place)], axum::Json(view)).into_response()
        }
        _ => ([tag], axum::Json(view)).into_response(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_expects_one_thing() {
        let expected = |lines: &[(HeaderName, &'static str)]| {
            let mut headers = HeaderMap::new();
            for (name, value) in lines {
                headers.append(name, HeaderValue::from_static(value));
            }
            expected(&headers).map_err(|problem| problem.code)
        };
        let (is, is_none) = (header::IF_MATCH, header::IF_NONE_MATCH);
        let of_view = etag_of(3, &"shown");
        assert_eq!(version(of_view.to_str().unwrap()), Some(3), "{of_view:?}");
        assert_ne!(of_view, etag_of(3, &"shown later"));
        for tag in ["\"3-\"", "\"3-0\"", "\"-0123456789abcdef\"", "\"3-0123456789abcdeg\"", "\"-3\""] {
            assert_eq!(version(tag), None, "{tag}");
        }
        assert!(matches!(expected(&[]), Ok(Precondition::Unstated)));
        assert!(matches!(expected(&[(is.clone(), "\"3\"")]), Ok(Precondition::Version(3))));
        assert!(matches!(expected(&[(is_none.clone(), "*")]), Ok(Precondition::Absent)));
        for lines in [
            [(is.clone(), "\"3\""), (is.clone(), "\"4\"")],
            [(is.clone(), "\"3\""), (is.clone(), "\"3\"")],
            [(is.clone(), "\"3\""), (is_none.clone(), "*")],
            [(is_none.clone(), "*"), (is_none.clone(), "\"3\"")],
            [(is_none.clone(), "*"), (is_none, "*")],
        ] {
            assert_eq!(expected(&lines).err(), Some("invalid_precondition"), "{lines:?}");
        }
    }

    #[test]
    fn a_tag_is_known_from_a_list_weak_or_not_and_by_a_star() {
        for (lines, known) in [
            (&["\"3\""][..], true),
            (&["W/\"3\""], true),
            (&["\"1\", W/\"3\""], true),
            (&["\"1\"", "\"3\""], true),
            (&["*"], true),
            (&["\"33\""], false),
            (&["3"], false),
            (&[""], false),
            (&[], false),
        ] {
            let mut headers = HeaderMap::new();
            for line in lines {
                headers.append(header::IF_NONE_MATCH, line.parse().unwrap());
            }
            assert_eq!(is_known(&headers, "\"3\""), known, "{lines:?}");
        }
    }
}

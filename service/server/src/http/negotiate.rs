//! Which form of a table the client likes best: `Accept` with its weights (RFC 9110, section 12.5.1).

use super::problem::Problem;
use crate::table::Format;
use axum::extract::FromRequestParts;
use http::request::Parts;
use http::{HeaderMap, StatusCode, header};

/// The form to answer in; 406 where none of ours is accepted.
#[derive(Debug, Clone, Copy)]
pub struct Accepts(pub Format);

impl<S: Send + Sync> FromRequestParts<S> for Accepts {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        best(&parts.headers).map(Self).ok_or_else(|| {
            let ours: Vec<_> = Format::ALL.iter().map(|format| format.media_type()).collect();
            let detail =
                format!("none of the accepted media types is offered; offered are {}", ours.join(", "));
            Problem::new(StatusCode::NOT_ACCEPTABLE, "not_acceptable", detail)
        })
    }
}

fn best(headers: &HeaderMap) -> Option<Format> {
    let accepted: Vec<_> = headers
        .get_all(header::ACCEPT)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .filter_map(range)
        .collect();
    // A client that says nothing takes anything.
    if accepted.is_empty() {
        return headers.get_all(header::ACCEPT).iter().all(|value| value.is_empty()).then_some(Format::Json);
    }
    // The most specific range that names a form gives its weight, whatever the order.
    let weight = |format: &Format| {
        let matching =
            accepted.iter().filter_map(|(range, weight)| Some((specific(range, *format)?, *weight)));
        matching.max_by_key(|(specific, _)| *specific).map_or(0, |(_, weight)| weight)
    };
    let weighed = Format::ALL.into_iter().map(|format| (weight(&format), format));
    // Of equal weights the first of ours.
    weighed
        .rev()
        .max_by_key(|(weight, _)| *weight)
        .filter(|(weight, _)| *weight > 0)
        .map(|(_, format)| format)
}

/// Whether gzip is as welcome as what is not compressed: `Accept-Encoding` with its weights (RFC 9110, section 12.5.3).
pub fn accepts_gzip(headers: &HeaderMap) -> bool {
    let values = headers.get_all(header::ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
    let codings: Vec<_> = values.flat_map(|value| value.split(',')).filter_map(weighted).collect();
    let of = |names: &[&str]| {
        codings.iter().find(|(name, _)| names.contains(&name.as_str())).map(|(_, weight)| *weight)
    };
    let gzip = of(&["gzip", "x-gzip"]).or_else(|| of(&["*"])).unwrap_or(0);
    gzip > 0 && gzip >= of(&["identity"]).unwrap_or(0)
}

/// Whether a page is asked for by name, as browsers do of what somebody opens, and nothing else is liked better.
pub fn prefers_pages(headers: &HeaderMap) -> bool {
    let values = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok());
    let ranges: Vec<_> = values.flat_map(|value| value.split(',')).filter_map(range).collect();
    let most = ranges.iter().map(|(_, weight)| *weight).max().unwrap_or(0);
    most > 0 && ranges.iter().any(|(range, weight)| range == "text/html" && *weight == most)
}

/// A media range in lower case, with its weight in thousandths; none where it cannot be read. Anything is `*` too, as Java's
/// own client has always said.
fn range(text: &str) -> Option<(String, u16)> {
    let (mut range, weight) = weighted(text)?;
    if range == "*" {
        "*/*".clone_into(&mut range);
    }
    range.split_once('/').filter(|(kind, of)| !kind.is_empty() && !of.is_empty())?;
    Some((range, weight))
}

/// A part of a list in lower case, without its parameters, with its weight in thousandths; none where that cannot be read.
fn weighted(text: &str) -> Option<(String, u16)> {
    let mut parts = text.split(';');
    let range = parts.next()?.trim().to_ascii_lowercase();
    let mut weight = 1000;
    for parameter in parts {
        if let Some((name, value)) = parameter.split_once('=')
            && name.trim().eq_ignore_ascii_case("q")
        {
            weight = thousandths(value.trim())?;
        }
    }
    Some((range, weight))
}

fn thousandths(text: &str) -> Option<u16> {
    let (whole, digits) = text.split_once('.').unwrap_or((text, ""));
    if digits.len() > 3 || !digits.bytes().all(|digit| digit.is_ascii_digit()) {
        return None;
    }
    let part: u16 = format!("{digits:0<3}").parse().ok()?;
    match whole {
        "0" => Some(part),
        // No weight by the rules, and plain all the same.
        "" if !digits.is_empty() => Some(part),
        "1" if part == 0 => Some(1000),
        _ => None,
    }
}

/// How specifically a range names a form: the whole type, its kind, or anything.
fn specific(range: &str, format: Format) -> Option<u8> {
    let media_type = format.media_type();
    let (kind, _) = media_type.split_once('/')?;
    if range == media_type {
        Some(2)
    } else if range.strip_suffix("/*") == Some(kind) {
        Some(1)
    } else {
        (range == "*/*").then_some(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(lines: &[&str]) -> Option<Format> {
        let mut headers = HeaderMap::new();
        for line in lines {
            headers.append(header::ACCEPT, line.parse().unwrap());
        }
        best(&headers)
    }

    #[test]
    fn a_page_is_for_who_asks_for_pages() {
        for (accepted, page) in [
            (&["text/html,application/xhtml+xml,application/xml;q=0.9,image/avif,*/*;q=0.8"][..], true),
            (&["application/json", "TEXT/HTML"], true),
            (&["application/json, text/html;q=0.5"], false),
            (&["text/html;q=0"], false),
            (&["*/*"], false),
            (&["text/*"], false),
            (&[""], false),
            (&[], false),
        ] {
            let mut headers = HeaderMap::new();
            for line in accepted {
                headers.append(header::ACCEPT, line.parse().unwrap());
            }
            assert_eq!(prefers_pages(&headers), page, "{accepted:?}");
        }
    }

    #[test]
    fn gzip_is_taken_where_it_is_welcome() {
        for (accepted, welcome) in [
            (&["gzip"][..], true),
            (&["deflate, GZIP;q=0.5"], true),
            (&["br", "x-gzip"], true),
            (&["*"], true),
            (&["gzip;q=0"], false),
            (&["gzip;q=0, *"], false),
            (&["*;q=0"], false),
            (&["x-gzipped"], false),
            (&["identity, gzip;q=0.5"], false),
            (&["identity;q=0.5, gzip;q=1.0"], true),
            (&["gzip;q=2"], false),
            (&[""], false),
            (&[], false),
        ] {
            let mut headers = HeaderMap::new();
            for line in accepted {
                headers.append(header::ACCEPT_ENCODING, line.parse().unwrap());
            }
            assert_eq!(accepts_gzip(&headers), welcome, "{accepted:?}");
        }
    }

    #[test]
    fn the_best_weight_wins_and_specific_ranges_count_first() {
        use Format::{Arrow, Csv, Json, Parquet};
        for (accept, format) in [
            ("", Some(Json)),
            ("*/*", Some(Json)),
            ("text/csv", Some(Csv)),
            ("Text/CSV; header=present", Some(Csv)),
            ("text/*", Some(Csv)),
            ("application/vnd.apache.arrow.stream", Some(Arrow)),
            ("application/vnd.apache.parquet, application/json;q=0.5", Some(Parquet)),
            ("application/json;q=0.5, text/csv;q=0.501", Some(Csv)),
            ("text/csv;q=0.5, */*;q=0.1", Some(Csv)),
            // The wildcard likes everything, but JSON was named as unwanted.
            ("application/json;q=0, */*", Some(Csv)),
            ("application/*;q=0.8, application/json;q=0.2", Some(Arrow)),
            ("text/html, application/xhtml+xml, */*;q=0.8", Some(Json)),
            ("text/html", None),
            ("text/csv;q=0", None),
            ("application/json;q=0.0000", None),
            ("application/json;q=2", None),
            ("nonsense", None),
            ("*", Some(Json)),
            ("text/html, image/gif, image/jpeg, *; q=.2, */*; q=.2", Some(Json)),
            ("application/json;q=.25, text/csv;q=.3", Some(Csv)),
            ("application/json;q=.", None),
            ("application/json;q=abc, text/csv;q=0.3", Some(Csv)),
        ] {
            assert_eq!(asked(&[accept]), format, "{accept}");
        }
        assert_eq!(asked(&["text/html", "text/csv"]), Some(Csv), "two lines are one list");
        assert_eq!(best(&HeaderMap::new()), Some(Json));
    }
}

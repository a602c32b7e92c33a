//! How much of an answer a client wants: `Prefer` (RFC 7240).

use axum::extract::FromRequestParts;
use http::request::Parts;
use http::{HeaderMap, HeaderName, HeaderValue};
use std::convert::Infallible;

const PREFER: HeaderName = HeaderName::from_static("prefer");
const PREFERENCE_APPLIED: HeaderName = HeaderName::from_static("preference-applied");

/// The preference `return` (section 4.2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Return {
    /// `representation`, or nothing that is known: all of it.
    Representation,
    /// `minimal`: what its client acts on.
    Minimal,
}

impl Return {
    /// What is preferred; of several the first counts (section 2), as the others are not looked at.
    fn of(headers: &HeaderMap) -> Self {
        let preferences = headers.get_all(PREFER).iter().filter_map(|value| value.to_str().ok());
        let mut values = preferences.flat_map(|value| value.split(',')).filter_map(|preference| {
            // Parameters behind a semicolon say nothing that is known of it.
            let (name, value) = preference.split(';').next()?.split_once('=')?;
            name.trim().eq_ignore_ascii_case("return").then(|| value.trim().trim_matches('"'))
        });
        match values.next() {
            Some(value) if value.eq_ignore_ascii_case("minimal") => Self::Minimal,
            _ => Self::Representation,
        }
    }

    /// The header that tells that a preference was followed (section 3).
    pub fn applied(self) -> Option<[(HeaderName, HeaderValue); 1]> {
        let told = [(PREFERENCE_APPLIED, HeaderValue::from_static("return=minimal"))];
        (self == Self::Minimal).then_some(told)
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Return {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Infallible> {
        Ok(Self::of(&parts.headers))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(values: &[&'static str]) -> Return {
        let mut headers = HeaderMap::new();
        for value in values {
            headers.append(PREFER, HeaderValue::from_static(value));
        }
        Return::of(&headers)
    }

    #[test]
    fn a_minimal_answer_is_given_to_who_prefers_one() {
        for minimal in [
            &["return=minimal"] as &[_],
            &["RETURN = \"Minimal\""],
            &["respond-async, return=minimal; why=\"a, b\", wait=10"],
            &["handling=lenient", "return=minimal"],
            &["return=minimal, return=representation"],
        ] {
            assert_eq!(of(minimal), Return::Minimal, "{minimal:?}");
        }
        for whole in [
            &[] as &[_],
            &[""],
            &["return"],
            &["return=representation, return=minimal"],
            &["return=least"],
            &["minimal"],
            &["no-return=minimal"],
            &["wait=10; return=minimal"],
        ] {
            assert_eq!(of(whole), Return::Representation, "{whole:?}");
        }
    }

    #[test]
    fn only_what_was_followed_is_told() {
        assert_eq!(Return::Representation.applied(), None);
        let [(name, value)] = Return::Minimal.applied().unwrap();
        assert_eq!((name.as_str(), value.to_str().unwrap()), ("preference-applied", "return=minimal"));
    }
}

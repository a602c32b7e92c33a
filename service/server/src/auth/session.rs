//! Sessions of browsers: begun with a token, carried by a cookie that no script can read.
//!
//! A request that comes with a cookie was perhaps made by another site. The cookie is `SameSite=Strict`; beside that,
//! whatever changes something has to carry [`PAGE_HEADER`], which a foreign page cannot send without a preflight that
//! is never granted, and whatever the browser itself says of a request's origin has to be this one.

use super::caller::{Caller, challenge};
use crate::clock::Clock;
use crate::http::once::{Repeated, once};
use crate::http::problem::Problem;
use crate::state::AppState;
use feedwright_core::units::Timestamp;
use feedwright_store::{SessionRecord, TokenRecord};
use http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use std::borrow::Cow;
use subtle::ConstantTimeEq;

/// Name of the cookie, where the page's address names no port.
const COOKIE: &str = "feedwright_session";
/// What every change by cookie has to carry, with any value.
pub static PAGE_HEADER: HeaderName = HeaderName::from_static("x-feedwright-page");
static FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");
/// Random bytes of a session's secret.
const SECRET_BYTES: usize = 32;
/// Sessions of one token that are kept at a time; the oldest makes room.
pub const MOST_SESSIONS: u32 = 50;
/// A session ends after a long shift, ms,
const SHIFT_MS: i64 = 12 * 3_600_000;
/// and that of a screen on the wall after a quarter of a year, ms.
const SCREEN_MS: i64 = 90 * 24 * 3_600_000;

/// The session that a caller came with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Session {
    /// Hash of its secret.
    pub hash: [u8; 32],
    /// When it ends.
    pub expires_at: Timestamp,
}

/// A session that was just begun: what is stored, and what its cookie holds.
pub struct BegunSession {
    /// What is stored.
    pub record: SessionRecord,
    /// `Set-Cookie`.
    pub cookie: HeaderValue,
}

impl BegunSession {
    /// Begins a session with a token; `lasting` for a screen that nobody signs in at. `secure` where the page was
    /// reached over TLS. `headers` are those of the request.
    pub fn new(
        token: &TokenRecord,
        lasting: bool,
        (secure, headers): (bool, &HeaderMap),
        clock: &Clock,
    ) -> Result<Self, Problem> {
        let mut random = [0_u8; SECRET_BYTES];
        getrandom::fill(&mut random).map_err(|error| Problem::internal(error.to_string()))?;
        let secret = blake3::Hash::from_bytes(random).to_hex();
        let now = clock.now();
        let lifetime_ms = if lasting { SCREEN_MS } else { SHIFT_MS };
        let cookie = cookie(&secret, lifetime_ms / 1000, (secure, headers))?;
        let record = SessionRecord {
            hash: *blake3::hash(secret.as_bytes()).as_bytes(),
            token: token.id.clone(),
            created_at: now,
            expires_at: now.plus_millis(lifetime_ms),
        };
        Ok(Self { record, cookie })
    }
}

/// The `Set-Cookie` that makes a browser forget its session.
pub fn forgotten(secure: bool, headers: &HeaderMap) -> Result<HeaderValue, Problem> {
    cookie("", 0, (secure, headers))
}

fn cookie(
    value: &str,
    max_age_s: i64,
    (secure, headers): (bool, &HeaderMap),
) -> Result<HeaderValue, Problem> {
    let (name, secure) = (name(headers), if secure { "; Secure" } else { "" });
    let text = format!("{name}={value}; Path=/; HttpOnly; SameSite=Strict; Max-Age={max_age_s}{secure}");
    HeaderValue::try_from(text).map_err(|error| Problem::internal(error.to_string()))
}

/// Whether the page that asks was reached over TLS: the browser says so itself, whatever stands in between.
pub fn over_tls(headers: &HeaderMap) -> bool {
    let text = |name: &HeaderName| headers.get(name).and_then(|value| value.to_str().ok());
    text(&header::ORIGIN).is_some_and(|origin| origin.starts_with("https://"))
}

/// The cookie's name for the address that the page was asked for. A browser sends cookies to each port of a host: of two services
/// on one computer each has its own, or signing in at the one would sign out of the other.
fn name(headers: &HeaderMap) -> Cow<'static, str> {
    let host = headers.get(header::HOST).and_then(|host| host.to_str().ok());
    let port = host.and_then(|host| host.rsplit_once(':')).and_then(|(_, port)| port.parse::<u16>().ok());
    port.map_or(COOKIE.into(), |port| format!("{COOKIE}_{port}").into())
}

/// The secret in the request's cookie.
fn secret(headers: &HeaderMap) -> Option<&str> {
    let own = name(headers);
    let lines = headers.get_all(header::COOKIE).into_iter().filter_map(|value| value.to_str().ok());
    let mut pairs = lines.flat_map(|line| line.split(';')).filter_map(|pair| pair.trim().split_once('='));
    pairs.find(|(name, secret)| *name == own && !secret.is_empty()).map(|(_, secret)| secret)
}

/// Refuses what another site may have caused.
pub fn from_own_page(method: &Method, headers: &HeaderMap) -> Result<(), Problem> {
    let refuse = |detail: &'static str| Err(Problem::new(StatusCode::FORBIDDEN, "cross_site", detail));
    // What is not read, or said twice, is no origin of this service.
    let text = |name: &HeaderName| match once(headers, name) {
        Ok(value) => value.map(|value| value.to_str().unwrap_or("?")),
        Err(Repeated) => Some("?"),
    };
    match (text(&FETCH_SITE), text(&header::ORIGIN)) {
        (Some("same-origin" | "none"), _) | (None, None) => {}
        (Some(_), _) => return refuse("the request comes from another site"),
        (None, Some(origin)) => {
            let own = text(&header::HOST).unwrap_or_default();
            if origin.split_once("://").map(|(_, host)| host) != Some(own) {
                return refuse("the request comes from another site");
            }
        }
    }
    let reads = matches!(*method, Method::GET | Method::HEAD);
    if !reads && !headers.contains_key(&PAGE_HEADER) {
        return refuse(
            "a sign-in and a change by cookie need the header x-feedwright-page, which a page of this service sends",
        );
    }
    Ok(())
}

/// The caller of a request that carries a cookie; `None` where there is none.
pub(super) async fn caller(
    state: &AppState,
    method: &Method,
    headers: &HeaderMap,
) -> Result<Option<Caller>, Problem> {
    let Some(secret) = secret(headers) else {
        return Ok(None);
    };
    from_own_page(method, headers)?;
    let hash = *blake3::hash(secret.as_bytes()).as_bytes();
    let known = state.store.session_by_hash(&hash).await?;
    let known = known.filter(|(session, _)| bool::from(session.hash.ct_eq(&hash)));
    let Some((session, token)) = known else {
        // No guess at a token: a browser that was signed out has to be told so, whoever else fails at its address.
        return Err(challenge("session_unknown", "the session is over: sign in again", true));
    };
    if session.expires_at <= state.clock.now() {
        return Err(challenge("session_expired", "the session is over: sign in again", true));
    }
    if token.revoked_at.is_some() {
        return Err(challenge("token_revoked", "the token of this session was revoked", true));
    }
    let session = Session { hash, expires_at: session.expires_at };
    Ok(Some(Caller::new(token, Some(session))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(pairs: &[(&str, &str)]) -> HeaderMap {
        pairs
            .iter()
            .map(|(name, value)| (name.parse::<HeaderName>().unwrap(), HeaderValue::from_str(value).unwrap()))
            .collect()
    }

    #[test]
    fn only_its_own_pages_act_by_cookie() {
        let page = ("x-feedwright-page", "1");
        for (method, sent, passes) in [
            (Method::GET, vec![], true),
            (Method::GET, vec![("sec-fetch-site", "none")], true),
            (Method::GET, vec![("sec-fetch-site", "cross-site")], false),
            (Method::GET, vec![("sec-fetch-site", "same-site")], false),
            (Method::GET, vec![("origin", "http://evil"), ("host", "shop:1")], false),
            (Method::POST, vec![("sec-fetch-site", "same-origin")], false),
            (Method::POST, vec![("sec-fetch-site", "same-origin"), page], true),
            (Method::POST, vec![("sec-fetch-site", "cross-site"), page], false),
            (Method::POST, vec![("origin", "http://shop:1"), ("host", "shop:1"), page], true),
            (Method::POST, vec![("origin", "http://shop:1"), ("host", "shop:2"), page], false),
            (Method::POST, vec![("origin", "null"), ("host", "shop:1"), page], false),
            (
                Method::POST,
                vec![("origin", "http://shop:1"), ("origin", "http://evil"), ("host", "shop:1"), page],
                false,
            ),
            (
                Method::POST,
                vec![("sec-fetch-site", "same-origin"), ("sec-fetch-site", "cross-site"), page],
                false,
            ),
            (Method::DELETE, vec![page], true),
            (Method::DELETE, vec![], false),
        ] {
            assert_eq!(from_own_page(&method, &headers(&sent)).is_ok(), passes, "{method} {sent:?}");
        }
    }

    #[test]
    fn the_cookie_is_found_among_others() {
        let found = |line: &str| secret(&headers(&[("cookie", line)])).map(str::to_owned);
        assert_eq!(found("a=1; feedwright_session=abc; b=2").as_deref(), Some("abc"));
        assert_eq!(found("feedwright_session=abc").as_deref(), Some("abc"));
        assert_eq!(found("feedwright_sessions=abc; xfeedwright_session=d"), None);
        assert_eq!(found("feedwright_session="), None);
        assert_eq!(found("feedwright_session_7878=abc"), None);
    }

    #[test]
    fn two_services_on_one_computer_do_not_share_a_cookie() {
        let at =
            |host: &str, line: &str| secret(&headers(&[("host", host), ("cookie", line)])).map(str::to_owned);
        let both = "feedwright_session_7878=one; feedwright_session_7879=two; feedwright_session=proxied";
        for (host, own) in [
            ("cell:7878", "one"),
            ("192.168.0.7:7879", "two"),
            ("[::1]:7879", "two"),
            ("[::1]", "proxied"),
            ("feedwright.example", "proxied"),
        ] {
            assert_eq!(at(host, both).as_deref(), Some(own), "{host}");
        }
        // Another one's, though it be of this service at another address: who signed out here is signed out.
        assert_eq!(at("cell:7880", both), None);
        let set = |host: &str| cookie("abc", 60, (false, &headers(&[("host", host)]))).unwrap();
        assert!(set("cell:7878").to_str().unwrap().starts_with("feedwright_session_7878=abc; "));
        assert!(set("cell").to_str().unwrap().starts_with("feedwright_session=abc; "));
    }
}

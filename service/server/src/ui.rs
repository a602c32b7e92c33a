//! The pages for people: plain HTML, style sheets and modules out of the binary, never from a CDN.
//!
//! Every page is the same document with another module; what it shows comes from the API with the session's cookie.
//! Nothing here reads the store, and no page may do what its role's routes do not let it do. In a debug build the files
//! are read from `web/` at every request, so that a page is changed without building.

mod files;

use crate::http::negotiate::accepts_gzip;
use crate::http::precondition::is_known;
use crate::http::problem::Problem;
use axum::extract::Path;
use axum::response::{IntoResponse, Response};
use files::{File, find};
use http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};

/// Lets a page have nothing but its own files and its own API: no inline script, no inline style, no frame.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; font-src 'self'; \
                      img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";

/// Path and name of every page; the name is that of its module in `web/js/pages/`.
pub const PAGES: [(&str, &str); 8] = [
    ("/", "fleet"),
    ("/sign-in", "sign-in"),
    ("/cycle", "cycle"),
    ("/tool", "tool"),
    ("/profile", "profile"),
    ("/next", "next"),
    ("/studies", "studies"),
    ("/settings", "settings"),
];

/// The document of a page.
pub(crate) async fn page(name: &'static str, headers: HeaderMap) -> Response {
    let Some(document) = find("page.html") else {
        return Problem::internal("the pages are not in this binary").into_response();
    };
    let text = String::from_utf8_lossy(&document.bytes);
    let modules = files::modules(&format!("js/pages/{name}.js"));
    let preload: String = modules
        .iter()
        .map(|name| format!("<link rel=\"modulepreload\" href=\"{{{{base}}}}/{name}\">"))
        .collect();
    let text = text.replace("{{modules}}", &preload).replace("{{page}}", name);
    let text = text.replace("{{base}}", &format!("/ui/{}", files::version()));
    let document = File::of("page.html", text.into_bytes());
    // It names the version of all other files, so it is asked for again every time.
    answer(&document, &headers, "no-cache")
}

/// The page of an address where there is none.
pub(crate) async fn unknown(headers: &HeaderMap) -> Response {
    // It is no version of anything, so nobody's copy is as good.
    let mut asked = headers.clone();
    asked.remove(header::IF_NONE_MATCH);
    let mut response = page("unknown", asked).await;
    if response.status() == StatusCode::OK {
        *response.status_mut() = StatusCode::NOT_FOUND;
    }
    response
}

/// A file of the pages, at an address that names the version of them all.
pub(crate) async fn file(Path((version, name)): Path<(String, String)>, headers: HeaderMap) -> Response {
    let current = version == files::version();
    match find(&name).filter(|_| current && name != "page.html") {
        Some(found) if files::FROM_DISK => answer(&found, &headers, "no-cache"),
        Some(found) => answer(&found, &headers, "public, max-age=31536000, immutable"),
        None => Problem::not_found("file of the pages", &name).into_response(),
    }
}

fn answer(file: &File, asked: &HeaderMap, cache: &'static str) -> Response {
    let zipped = file.gzip.as_ref().filter(|_| accepts_gzip(asked));
    // The bytes are others, and so is their tag.
    let etag = match zipped {
        Some(_) => format!("{}-gzip\"", file.etag.trim_end_matches('"')),
        None => file.etag.clone(),
    };
    let mut response = match is_known(asked, &etag) {
        true => StatusCode::NOT_MODIFIED.into_response(),
        false => zipped.unwrap_or(&file.bytes).clone().into_response(),
    };
    let headers = response.headers_mut();
    headers.remove(header::CONTENT_TYPE);
    let fixed: [(HeaderName, &str); 8] = [
        (header::CONTENT_TYPE, file.kind),
        (header::CACHE_CONTROL, cache),
        (header::ETAG, &etag),
        (header::VARY, "accept-encoding"),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ];
    for (name, value) in fixed {
        if let Ok(value) = HeaderValue::from_str(value) {
            headers.insert(name, value);
        }
    }
    if zipped.is_some() {
        headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
    }
    response
}

//! The embedded viewer of the API's description: its files come out of the binary, never from a CDN.

use super::problem::Problem;
use axum::extract::Path;
use axum::response::{IntoResponse, Redirect, Response};
use http::header;
use std::sync::Arc;
use utoipa_swagger_ui::Config;

/// Forbids the viewer everything that it does not need; its style sheet is inline.
const POLICY: &str = "default-src 'self'; img-src 'self' data:; style-src 'self' 'unsafe-inline'; \
                      frame-ancestors 'none'";

pub(super) async fn index() -> Redirect {
    Redirect::permanent("/docs/")
}

pub(super) async fn root() -> Response {
    serve("index.html")
}

pub(super) async fn file(Path(file): Path<String>) -> Response {
    serve(&file)
}

fn serve(file: &str) -> Response {
    match utoipa_swagger_ui::serve(file, Arc::new(Config::from("/openapi.json"))) {
        Ok(Some(found)) => {
            let headers = [
                (header::CONTENT_TYPE, found.content_type.as_str()),
                (header::CONTENT_SECURITY_POLICY, POLICY),
            ];
            (headers, found.bytes.into_owned()).into_response()
        }
        Ok(None) => Problem::not_found("page", file).into_response(),
        Err(error) => Problem::internal(error.to_string()).into_response(),
    }
}

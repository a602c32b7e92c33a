//! Whether the service lives, whether it is ready, and its metrics.

use super::problem::Problem;
use crate::state::AppState;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use http::header;
use serde::Serialize;
use utoipa::ToSchema;

/// The state of the service in a word.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Health {
    /// `ok`.
    status: &'static str,
}

/// Says that the process lives. It says nothing about the database: see `/readyz`.
#[utoipa::path(get, path = "/healthz", tag = "service", responses((status = 200, body = Health)))]
pub(super) async fn healthz() -> axum::Json<Health> {
    axum::Json(Health { status: "ok" })
}

/// Says whether the database takes writes, proven by one of the last two seconds.
#[utoipa::path(get, path = "/readyz", tag = "service", responses((status = 200, body = Health)))]
pub(super) async fn readyz(State(state): State<AppState>) -> Result<axum::Json<Health>, Problem> {
    match state.ready().await {
        Ok(()) => Ok(axum::Json(Health { status: "ok" })),
        // The reason stays in the log: the route is open.
        Err(why) => {
            Err(Problem::unavailable("not_ready", "the service does not take cycles", 2).private(why))
        }
    }
}

// They are wanted most when the database is in trouble: whether it takes writes is asked as `/readyz` asks, for seconds at
// the most; what only the database knows is as old as the watch's last round.
/// Metrics in the text format of Prometheus.
#[utoipa::path(get, path = "/metrics", tag = "service",
    responses((status = 200, body = String, content_type = "text/plain")))]
pub(super) async fn metrics(State(state): State<AppState>) -> Response {
    state.intake.measure();
    state.metrics.ready(state.ready().await.is_ok());
    match state.metrics.text() {
        Ok(text) => ([(header::CONTENT_TYPE, prometheus::TEXT_FORMAT)], text).into_response(),
        Err(error) => Problem::internal(error.to_string()).into_response(),
    }
}

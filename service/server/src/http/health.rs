//! Whether the service lives, whether it is ready, and its metrics.

use super::problem::Problem;
use crate::state::AppState;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use feedwright_store::{AlarmFilter, AlarmKind, Page, StoreResult};
use http::header;
use serde::Serialize;
use utoipa::ToSchema;

/// Alarms read at a time when they are counted.
const ALARMS_PAGE: u32 = 1000;
/// Pages read at most: a shop with more open alarms knows that there are many.
const MOST_ALARM_PAGES: u32 = 10;

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

/// Metrics in the text format of Prometheus.
#[utoipa::path(get, path = "/metrics", tag = "service",
    responses((status = 200, body = String, content_type = "text/plain")))]
pub(super) async fn metrics(State(state): State<AppState>) -> Response {
    if let Err(error) = count_open_alarms(&state).await {
        // The other metrics are wanted most when the database is in trouble.
        tracing::warn!(%error, "open alarms cannot be counted");
    }
    match state.metrics.text() {
        Ok(text) => ([(header::CONTENT_TYPE, prometheus::TEXT_FORMAT)], text).into_response(),
        Err(error) => Problem::internal(error.to_string()).into_response(),
    }
}

/// Counts the open alarms by kind, as they stand: alarms are raised and cleared in the store's own transactions.
async fn count_open_alarms(state: &AppState) -> StoreResult<()> {
    let filter = AlarmFilter { open: Some(true), ..AlarmFilter::default() };
    let mut counts = AlarmKind::ALL.map(|kind| (kind, 0));
    let mut after = None;
    for _ in 0..MOST_ALARM_PAGES {
        let page = state.store.alarms(&filter, Page { after, limit: ALARMS_PAGE }).await?;
        for (kind, count) in &mut counts {
            *count += page.iter().map(|alarm| i64::from(alarm.kind == *kind)).sum::<i64>();
        }
        after = page.last().map(|alarm| alarm.id);
        if after.is_none() {
            break;
        }
    }
    for (kind, count) in counts {
        state.metrics.alarms_open(kind, count);
    }
    Ok(())
}

//! How long a machine's samples are kept, and what was dropped.

use super::body::Json;
use super::dto::retention::{RetentionBody, RetentionView};
use super::extract::PathId;
use super::precondition::{answer_put, answer_tagged, etag_of, expected};
use super::problem::Problem;
use crate::auth::Caller;
use crate::state::AppState;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use feedwright_core::ids::MachineId;
use feedwright_store::Store;
use http::{HeaderMap, HeaderValue, header};
use std::sync::Arc;

/// Says how long a machine's samples are kept. Without either limit they are kept for ever; summaries always are.
///
/// Changing needs `If-Match` with the ETag of the last answer, whatever was dropped since. Samples go at the next run of retention.
#[utoipa::path(put, path = "/v1/machines/{machine}/retention", tag = "machines",
    params(("machine" = String, Path), ("If-Match" = Option<String>, Header), ("If-None-Match" = Option<String>, Header)),
    request_body = RetentionBody,
    responses((status = 200, description = "Changed, or already so", body = RetentionView),
        (status = 201, description = "Said for the first time", body = RetentionView)))]
pub(super) async fn put(
    State(state): State<AppState>,
    caller: Caller,
    PathId(id): PathId<MachineId>,
    headers: HeaderMap,
    Json(body): Json<RetentionBody>,
) -> Result<Response, Problem> {
    let (expects, retention) = (expected(&headers)?, body.into_retention()?);
    let (actor, now, machine) = (caller.actor(), state.clock.now(), id.clone());
    let put = |store: Arc<dyn Store>| async move {
        store.put_retention(&machine, retention, expects, &actor, now).await
    };
    let outcome = state.commit(put).await?;
    let outcome = outcome.ok_or_else(|| Problem::not_found("machine", id.as_str()))?;
    let view = view(&state, &id).await?;
    let mut answer = answer_put(outcome, &format!("/v1/machines/{id}/retention"), &view);
    if let Some(tag) = tag(&view) {
        answer.headers_mut().insert(header::ETAG, tag);
    }
    Ok(answer)
}

/// Tells how long a machine's samples are kept, and what was dropped of them.
#[utoipa::path(get, path = "/v1/machines/{machine}/retention", tag = "machines",
    params(("machine" = String, Path)),
    responses((status = 200, body = RetentionView), (status = 304, description = "As the ETag says")))]
pub(super) async fn get(
    State(state): State<AppState>,
    PathId(id): PathId<MachineId>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    if state.store.machine(&id).await?.is_none() {
        return Err(Problem::not_found("machine", id.as_str()));
    }
    let view = view(&state, &id).await?;
    Ok(match tag(&view) {
        Some(tag) => answer_tagged(&headers, tag, &view),
        None => axum::Json(view).into_response(),
    })
}

/// Where something was said for the machine: another one as soon as more was dropped, too.
fn tag(view: &RetentionView) -> Option<HeaderValue> {
    view.version.map(|version| etag_of(version, view))
}

async fn view(state: &AppState, id: &MachineId) -> Result<RetentionView, Problem> {
    let said = state.store.retention(id).await?;
    let drops = state.store.sample_drops(id).await?;
    Ok(RetentionView::of(said.as_ref(), state.config.retention.samples(), &drops))
}

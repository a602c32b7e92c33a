//! Operations: registered, changed, listed.

use super::body::Json;
use super::cursor::{List, Paging};
use super::dto::operation::OperationBody;
use super::dto::{PageQuery, Registered};
use super::extract::{PathId, Query};
use super::precondition::{answer_put, answer_read, expected};
use super::problem::Problem;
use crate::auth::Caller;
use crate::state::AppState;
use axum::extract::State;
use axum::response::Response;
use feedwright_core::ids::OperationId;
use feedwright_store::{PutOutcome, Store, StoreError};
use http::HeaderMap;
use std::sync::Arc;

/// Registers an operation, or changes it.
///
/// Repeating the same content changes nothing. Changing needs `If-Match` with the ETag of the last answer;
/// `If-None-Match: *` only registers.
#[utoipa::path(put, path = "/v1/operations/{operation}", tag = "operations",
    params(("operation" = String, Path), ("If-Match" = Option<String>, Header), ("If-None-Match" = Option<String>, Header)),
    request_body = OperationBody,
    responses((status = 200, description = "Changed, or already so", body = Registered<OperationBody>),
        (status = 201, description = "Registered", body = Registered<OperationBody>)))]
pub(super) async fn put(
    State(state): State<AppState>,
    caller: Caller,
    PathId(id): PathId<OperationId>,
    headers: HeaderMap,
    Json(body): Json<OperationBody>,
) -> Result<Response, Problem> {
    let expects = expected(&headers)?;
    let operation = body.into_operation(id.clone())?;
    let (actor, now) = (caller.actor(), state.clock.now());
    let told = state.clone();
    let put = |store: Arc<dyn Store>| async move {
        let outcome = store.put_operation(operation, expects, &actor, now).await;
        // Whoever asked may be gone by now, and what is not known may have come about.
        if matches!(
            outcome,
            Ok(PutOutcome::Created | PutOutcome::Changed(_)) | Err(StoreError::OutcomeUnknown(_))
        ) {
            told.folds_are_behind.notify_one();
        }
        outcome
    };
    let outcome = state.commit(put).await?;
    let stored = state.store.operation(&id).await?.ok_or_else(|| Problem::internal("it was just put"))?;
    let view = Registered::<OperationBody>::from(stored);
    Ok(answer_put(outcome, &format!("/v1/operations/{id}"), &view))
}

/// Tells one operation.
#[utoipa::path(get, path = "/v1/operations/{operation}", tag = "operations",
    params(("operation" = String, Path), ("If-None-Match" = Option<String>, Header)),
    responses((status = 200, body = Registered<OperationBody>), (status = 304, description = "As the ETag says")))]
pub(super) async fn get(
    State(state): State<AppState>,
    PathId(id): PathId<OperationId>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let stored = state.store.operation(&id).await?;
    let stored = stored.ok_or_else(|| Problem::not_found("operation", id.as_str()))?;
    Ok(answer_read(&headers, stored.version, &Registered::<OperationBody>::from(stored)))
}

/// Lists operations by id.
#[utoipa::path(get, path = "/v1/operations", tag = "operations", params(PageQuery),
    responses((status = 200, body = List<Registered<OperationBody>>)))]
pub(super) async fn list(
    State(state): State<AppState>,
    Query(query): Query<PageQuery>,
) -> Result<axum::Json<List<Registered<OperationBody>>>, Problem> {
    let paging = Paging::new(&state, "operations", query.limit, query.cursor.as_deref())?;
    let rows = state.store.operations(paging.page()).await?;
    Ok(axum::Json(paging.list(rows, |row| row.value.id.clone(), Registered::from)))
}

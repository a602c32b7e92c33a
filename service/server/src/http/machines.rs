//! Machines: registered, changed, listed.

use super::body::Json;
use super::cursor::{List, Paging};
use super::dto::machine::MachineBody;
use super::dto::{PageQuery, Registered};
use super::extract::{PathId, Query};
use super::precondition::{answer_put, answer_read, expected};
use super::problem::Problem;
use crate::auth::Caller;
use crate::state::AppState;
use axum::extract::State;
use axum::response::Response;
use feedwright_core::ids::MachineId;
use feedwright_store::Store;
use http::HeaderMap;
use std::sync::Arc;

/// Registers a machine, or changes it.
///
/// Repeating the same content changes nothing. Changing needs `If-Match` with the ETag of the last answer;
/// `If-None-Match: *` only registers.
#[utoipa::path(put, path = "/v1/machines/{machine}", tag = "machines",
    params(("machine" = String, Path), ("If-Match" = Option<String>, Header), ("If-None-Match" = Option<String>, Header)),
    request_body = MachineBody,
    responses((status = 200, description = "Changed, or already so", body = Registered<MachineBody>),
        (status = 201, description = "Registered", body = Registered<MachineBody>)))]
pub(super) async fn put(
    State(state): State<AppState>,
    caller: Caller,
    PathId(id): PathId<MachineId>,
    headers: HeaderMap,
    Json(body): Json<MachineBody>,
) -> Result<Response, Problem> {
    let expects = expected(&headers)?;
    let machine = body.into_machine(id.clone())?;
    let (actor, now) = (caller.actor(), state.clock.now());
    let put = |store: Arc<dyn Store>| async move { store.put_machine(machine, expects, &actor, now).await };
    let outcome = state.commit(put).await?;
    let stored = state.store.machine(&id).await?.ok_or_else(|| Problem::internal("it was just put"))?;
    let view = Registered::<MachineBody>::from(stored);
    Ok(answer_put(outcome, &format!("/v1/machines/{id}"), &view))
}

/// Tells one machine.
#[utoipa::path(get, path = "/v1/machines/{machine}", tag = "machines",
    params(("machine" = String, Path), ("If-None-Match" = Option<String>, Header)),
    responses((status = 200, body = Registered<MachineBody>), (status = 304, description = "As the ETag says")))]
pub(super) async fn get(
    State(state): State<AppState>,
    PathId(id): PathId<MachineId>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let stored = state.store.machine(&id).await?;
    let stored = stored.ok_or_else(|| Problem::not_found("machine", id.as_str()))?;
    Ok(answer_read(&headers, stored.version, &Registered::<MachineBody>::from(stored)))
}

/// Lists machines by id.
#[utoipa::path(get, path = "/v1/machines", tag = "machines", params(PageQuery),
    responses((status = 200, body = List<Registered<MachineBody>>)))]
pub(super) async fn list(
    State(state): State<AppState>,
    Query(query): Query<PageQuery>,
) -> Result<axum::Json<List<Registered<MachineBody>>>, Problem> {
    let paging = Paging::new(&state, "machines", query.limit, query.cursor.as_deref())?;
    let rows = state.store.machines(paging.page()).await?;
    Ok(axum::Json(paging.list(rows, |row| row.value.id.clone(), Registered::from)))
}

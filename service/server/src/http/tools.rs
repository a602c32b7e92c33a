//! Tools: registered, changed, listed.

use super::body::Json;
use super::cursor::{List, Paging};
use super::dto::tool::ToolBody;
use super::dto::{PageQuery, Registered};
use super::extract::{PathId, Query};
use super::precondition::{answer_put, answer_read, expected};
use super::problem::Problem;
use crate::auth::Caller;
use crate::state::AppState;
use axum::extract::State;
use axum::response::Response;
use feedwright_core::ids::ToolId;
use feedwright_store::Store;
use http::HeaderMap;
use std::sync::Arc;

/// Registers a tool, or changes it.
///
/// Repeating the same content changes nothing. Changing needs `If-Match` with the ETag of the last answer;
/// `If-None-Match: *` only registers.
#[utoipa::path(put, path = "/v1/tools/{tool}", tag = "tools",
    params(("tool" = String, Path), ("If-Match" = Option<String>, Header), ("If-None-Match" = Option<String>, Header)),
    request_body = ToolBody,
    responses((status = 200, description = "Changed, or already so", body = Registered<ToolBody>),
        (status = 201, description = "Registered", body = Registered<ToolBody>)))]
pub(super) async fn put(
    State(state): State<AppState>,
    caller: Caller,
    PathId(id): PathId<ToolId>,
    headers: HeaderMap,
    Json(body): Json<ToolBody>,
) -> Result<Response, Problem> {
    let expects = expected(&headers)?;
    let tool = body.into_tool(id.clone())?;
    let (actor, now) = (caller.actor(), state.clock.now());
    let put = |store: Arc<dyn Store>| async move { store.put_tool(tool, expects, &actor, now).await };
    let outcome = state.commit(put).await?;
    let stored = state.store.tool(&id).await?.ok_or_else(|| Problem::internal("it was just put"))?;
    let view = Registered::<ToolBody>::from(stored);
    Ok(answer_put(outcome, &format!("/v1/tools/{id}"), &view))
}

/// Tells one tool.
#[utoipa::path(get, path = "/v1/tools/{tool}", tag = "tools",
    params(("tool" = String, Path), ("If-None-Match" = Option<String>, Header)),
    responses((status = 200, body = Registered<ToolBody>), (status = 304, description = "As the ETag says")))]
pub(super) async fn get(
    State(state): State<AppState>,
    PathId(id): PathId<ToolId>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let stored = state.store.tool(&id).await?;
    let stored = stored.ok_or_else(|| Problem::not_found("tool", id.as_str()))?;
    Ok(answer_read(&headers, stored.version, &Registered::<ToolBody>::from(stored)))
}

/// Lists tools by id.
#[utoipa::path(get, path = "/v1/tools", tag = "tools", params(PageQuery),
    responses((status = 200, body = List<Registered<ToolBody>>)))]
pub(super) async fn list(
    State(state): State<AppState>,
    Query(query): Query<PageQuery>,
) -> Result<axum::Json<List<Registered<ToolBody>>>, Problem> {
    let paging = Paging::new(&state, "tools", query.limit, query.cursor.as_deref())?;
    let rows = state.store.tools(paging.page()).await?;
    Ok(axum::Json(paging.list(rows, |row| row.value.id.clone(), Registered::from)))
}

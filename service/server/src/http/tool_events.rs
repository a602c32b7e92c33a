//! What happened to a tool: mounted, changed, reground, reset.

use super::body::Json;
use super::cursor::{List, Paging};
use super::dto::PageQuery;
use super::dto::tool::{ToolEventBody, ToolEventView};
use super::extract::{PathId, Query};
use super::problem::{Problem, ProblemDocument};
use crate::auth::Caller;
use crate::state::AppState;
use axum::extract::State;
use feedwright_core::ids::ToolId;
use feedwright_core::invalid::Violation;
use feedwright_store::{RowNumber, Store};
use http::StatusCode;
use std::sync::Arc;

/// Tells what happened to a tool. Its wear is judged anew from its cycles before this is answered.
#[utoipa::path(post, path = "/v1/tools/{tool}/events", tag = "tools", params(("tool" = String, Path)),
    request_body = ToolEventBody, responses((status = 201, body = ToolEventView)))]
pub(super) async fn add(
    State(state): State<AppState>,
    caller: Caller,
    PathId(tool): PathId<ToolId>,
    Json(body): Json<ToolEventBody>,
) -> Result<(StatusCode, axum::Json<ToolEventView>), Problem> {
    let (actor, now) = (caller.actor(), state.clock.now());
    let event = body.into_event(now)?;
    // The cycle itself may come after the event.
    if let Some((machine, _)) = &event.first_cycle
        && state.store.machine(machine).await?.is_none()
    {
        let why = format!("there is no machine `{machine}`");
        return Err(Violation::new("first_cycle.machine", "unknown_machine", why).into());
    }
    let id = tool.clone();
    let stored =
        state.commit(|store| async move { store.add_tool_event(&id, event, &actor, now).await }).await?;
    let stored = stored.ok_or_else(|| Problem::not_found("tool", tool.as_str()))?;
    Ok((StatusCode::CREATED, axum::Json(stored.into())))
}

/// Revokes an event that was told by mistake, or by a clock that was ahead. It stays in the list, with who revoked it and when;
/// the tool's wear is judged from its cycles as if it had not been told before this is answered.
#[utoipa::path(post, path = "/v1/tools/{tool}/events/{id}/revoke", tag = "tools",
    params(("tool" = String, Path), ("id" = i64, Path, description = "The event's number")),
    responses((status = 200, description = "Revoked, or already so", body = ToolEventView),
        (status = 404, description = "The tool has no such event", body = ProblemDocument<'static>)))]
pub(super) async fn revoke(
    State(state): State<AppState>,
    caller: Caller,
    PathId(tool): PathId<ToolId>,
    PathId(event): PathId<RowNumber>,
) -> Result<axum::Json<ToolEventView>, Problem> {
    let (actor, now, id) = (caller.actor(), state.clock.now(), tool.clone());
    let revoke =
        |store: Arc<dyn Store>| async move { store.revoke_tool_event(&id, event, &actor, now).await };
    let revoked = state.commit(revoke).await?;
    state.live.alarms_may_have_changed();
    let revoked = revoked.ok_or_else(|| Problem::not_found("event of this tool", &event.to_string()))?;
    Ok(axum::Json(revoked.into()))
}

/// Lists what happened to a tool, in the order it was told, revoked events too.
#[utoipa::path(get, path = "/v1/tools/{tool}/events", tag = "tools", params(("tool" = String, Path), PageQuery),
    responses((status = 200, body = List<ToolEventView>)))]
pub(super) async fn list(
    State(state): State<AppState>,
    PathId(tool): PathId<ToolId>,
    Query(query): Query<PageQuery>,
) -> Result<axum::Json<List<ToolEventView>>, Problem> {
    let scope = format!("tool events of {tool}");
    let paging = Paging::new(&state, scope, query.limit, query.cursor.as_deref())?;
    if state.store.tool(&tool).await?.is_none() {
        return Err(Problem::not_found("tool", tool.as_str()));
    }
    let rows = state.store.tool_events(&tool, paging.page()).await?;
    Ok(axum::Json(paging.list(rows, |row| row.id, ToolEventView::from)))
}

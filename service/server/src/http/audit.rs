//! The audit: who changed what.

use super::cursor::{List, Paging};
use super::dto::audit::{AuditOrder, AuditQuery, AuditView};
use super::extract::Query;
use super::problem::Problem;
use crate::state::AppState;
use axum::Json;
use axum::extract::State;

/// Lists the audit, oldest line first, or newest first where that is asked for.
///
/// Oldest first it ends before a line that is not committed yet: whoever goes on by its cursors is shown every line.
#[utoipa::path(get, path = "/v1/audit", tag = "audit", params(AuditQuery),
    responses((status = 200, body = List<AuditView>)))]
pub(super) async fn list(
    State(state): State<AppState>,
    Query(query): Query<AuditQuery>,
) -> Result<Json<List<AuditView>>, Problem> {
    let newest = query.order == AuditOrder::Newest;
    // A cursor leads one way only.
    let scope = if newest { "audit newest" } else { "audit" };
    let paging = Paging::new(&state, scope, query.limit, query.cursor.as_deref())?;
    let page = paging.page();
    let rows = if newest { state.store.newest_audit(page).await? } else { state.store.audit(page).await? };
    Ok(Json(paging.list(rows, |row| row.id, AuditView::from)))
}

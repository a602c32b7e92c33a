//! The audit: who changed what.

use super::cursor::{List, Paging};
use super::dto::PageQuery;
use super::dto::audit::AuditView;
use super::extract::Query;
use super::problem::Problem;
use crate::state::AppState;
use axum::Json;
use axum::extract::State;

/// Lists the audit, oldest line first.
#[utoipa::path(get, path = "/v1/audit", tag = "audit", params(PageQuery),
    responses((status = 200, body = List<AuditView>)))]
pub(super) async fn list(
    State(state): State<AppState>,
    Query(query): Query<PageQuery>,
) -> Result<Json<List<AuditView>>, Problem> {
    let paging = Paging::new(&state, "audit", query.limit, query.cursor.as_deref())?;
    let rows = state.store.audit(paging.page()).await?;
    Ok(Json(paging.list(rows, |row| row.id, AuditView::from)))
}

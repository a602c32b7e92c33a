//! A machine's fitted lines, version by version.

use super::body::Json;
use super::cursor::{List, Paging};
use super::dto::PageQuery;
use super::dto::calibration::{CalibrationBody, CalibrationView};
use super::extract::{PathId, Query};
use super::problem::Problem;
use crate::auth::Caller;
use crate::state::AppState;
use axum::extract::State;
use feedwright_core::ids::MachineId;
use feedwright_core::machine::Calibration;
use http::StatusCode;

/// Adds a version of a machine's fitted lines; the newest is in force.
#[utoipa::path(post, path = "/v1/machines/{machine}/calibrations", tag = "machines",
    params(("machine" = String, Path)), request_body = CalibrationBody,
    responses((status = 201, body = CalibrationView)))]
pub(super) async fn add(
    State(state): State<AppState>,
    caller: Caller,
    PathId(machine): PathId<MachineId>,
    Json(body): Json<CalibrationBody>,
) -> Result<(StatusCode, axum::Json<CalibrationView>), Problem> {
    let (actor, now) = (caller.actor(), state.clock.now());
    let calibration = Calibration::try_from(body)?;
    let id = machine.clone();
    let add = |store: std::sync::Arc<dyn feedwright_store::Store>| async move {
        store.add_calibration(&id, calibration, &actor, now).await
    };
    let stored = state.commit(add).await?.ok_or_else(|| Problem::not_found("machine", machine.as_str()))?;
    Ok((StatusCode::CREATED, axum::Json((stored, now).into())))
}

/// Lists a machine's fitted lines, oldest version first.
#[utoipa::path(get, path = "/v1/machines/{machine}/calibrations", tag = "machines",
    params(("machine" = String, Path), PageQuery), responses((status = 200, body = List<CalibrationView>)))]
pub(super) async fn list(
    State(state): State<AppState>,
    PathId(machine): PathId<MachineId>,
    Query(query): Query<PageQuery>,
) -> Result<axum::Json<List<CalibrationView>>, Problem> {
    let scope = format!("calibrations of {machine}");
    let paging = Paging::new(&state, scope, query.limit, query.cursor.as_deref())?;
    if state.store.machine(&machine).await?.is_none() {
        return Err(Problem::not_found("machine", machine.as_str()));
    }
    let rows = state.store.calibrations(&machine, paging.page()).await?;
    Ok(axum::Json(paging.list(rows, |(row, _)| row.version, CalibrationView::from)))
}

//! A machine's fitted lines, version by version.

mod fit;

use super::body::Json;
use super::compute::compute;
use super::cursor::{List, Paging};
use super::dto::PageQuery;
use super::dto::calibration::{CalibrationBody, CalibrationView};
use super::dto::fit::{FitAnswer, FitRequest};
use super::extract::{PathId, Query};
use super::problem::{Problem, ProblemDocument};
use crate::auth::Caller;
use crate::state::AppState;
use axum::extract::State;
use feedwright_core::ids::MachineId;
use feedwright_core::machine::Calibration;
use fit::{Fitted, Measured, newest};
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
    Ok(axum::Json(paging.list(rows, |row| row.calibration.version, CalibrationView::from)))
}

/// Fits a machine's lines to its stored dynamometer cycles and adds them as a version, unless `dry_run`.
///
/// Robust lines (Theil–Sen) over the samples in contact, with R², spread and the range of loads seen. A line for which
/// the cycles say too little is carried over from the version before, and the answer says so.
#[utoipa::path(post, path = "/v1/machines/{machine}/calibrations/fit", tag = "machines",
    params(("machine" = String, Path)), request_body = FitRequest,
    responses(
        (status = 200, description = "What would be stored: a dry run", body = FitAnswer),
        (status = 201, description = "Stored as a version", body = FitAnswer),
        (status = 404, description = "The machine is not registered", body = ProblemDocument<'static>),
        (status = 422, description = "A filter that is none, or cycles that make no line (`considered` and `skipped` say as in \
            the answer which were looked at)", body = ProblemDocument<'static>),
        (status = 503, description = "Other computations are under way", body = ProblemDocument<'static>),
    ))]
pub(super) async fn fit(
    State(state): State<AppState>,
    caller: Caller,
    PathId(machine): PathId<MachineId>,
    Json(request): Json<FitRequest>,
) -> Result<(StatusCode, axum::Json<FitAnswer>), Problem> {
    let (filter, most) = request.checked(&machine)?;
    let unknown = || Problem::not_found("machine", machine.as_str());
    state.store.machine(&machine).await?.ok_or_else(unknown)?;
    let before = newest(&*state.store, &machine).await?;
    let measured = Measured::read(&*state.store, &filter, most).await?;
    let Fitted { calibration, mut answer } = compute(move || measured.fit(before.as_ref())).await?;
    if request.dry_run {
        return Ok((StatusCode::OK, axum::Json(answer)));
    }
    let (actor, now, id) = (caller.actor(), state.clock.now(), machine.clone());
    let add = |store: std::sync::Arc<dyn feedwright_store::Store>| async move {
        store.add_calibration(&id, calibration, &actor, now).await
    };
    let stored = state.commit(add).await?.ok_or_else(unknown)?;
    answer.dry_run = false;
    answer.calibration = Some((stored, now).into());
    Ok((StatusCode::CREATED, axum::Json(answer)))
}

//! The course of a stored cycle: what its samples amount to on the way, for whoever looks at its curves.

use super::compute::compute;
use super::dto::course::CourseBody;
use super::extract::PathId;
use super::problem::{Problem, ProblemDocument};
use super::samples::no_samples;
use crate::course::course;
use crate::state::AppState;
use axum::Json;
use axum::extract::State;
use feedwright_core::ids::{CycleId, MachineId};

/// The course of a cycle: its loads filtered as the control filters them, its energy so far, its stages, and where a
/// load was over the operation's set load.
///
/// Columns have one entry for each sample of `…/samples`. Stages are told for friction drilling only.
#[utoipa::path(
    get, path = "/v1/machines/{machine}/cycles/{cycle_id}/course", tag = "cycles",
    params(("machine" = String, Path, description = "Its machine"), ("cycle_id" = String, Path, description = "Its id")),
    responses(
        (status = 200, description = "The course", body = CourseBody),
        (status = 404, description = "There is no such cycle, or no samples of it", body = ProblemDocument<'static>),
        (status = 410, description = "Its samples were dropped by retention (`dropped_at` says when), or are missing (`samples_lost`)",
            body = ProblemDocument<'static>),
        (status = 503, description = "Other computations are under way", body = ProblemDocument<'static>),
    )
)]
pub(super) async fn get(
    State(state): State<AppState>,
    PathId(machine): PathId<MachineId>,
    PathId(id): PathId<CycleId>,
) -> Result<Json<CourseBody>, Problem> {
    let stored = state.store.cycle(&machine, &id).await?;
    let stored = stored.ok_or_else(|| Problem::not_found("cycle", id.as_str()))?;
    let samples = state.store.cycle_samples(&machine, &id).await?;
    let Some(samples) = samples else { return Err(no_samples(&state, &machine, &id).await?) };
    let around = state.store.surroundings(&machine, &stored.cycle.operation, &stored.cycle.tool).await?;
    let around = around.ok_or_else(|| Problem::not_found("machine", machine.as_str()))?;
    compute(move || Ok(Json(CourseBody::from(course(&stored, &samples, &around))))).await
}

//! A tool's life, cycle by cycle: what its page draws.

use super::dto::life::{LifeBody, LifeQuery};
use super::extract::{PathId, Query};
use super::problem::{Problem, ProblemDocument};
use crate::state::AppState;
use axum::Json;
use axum::extract::State;
use feedwright_core::ids::ToolId;
use feedwright_core::invalid::Violation;

/// Most cycles of one answer.
const MOST_CYCLES: u32 = 20_000;
/// Cycles where no number is asked for.
const USUAL_CYCLES: u32 = 5000;

/// The newest cycles of a tool's current life: energy against the baseline it is compared with, and for those that do
/// not count the reason.
///
/// In columns of equal length, in the order in which they were run.
#[utoipa::path(
    get, path = "/v1/tools/{tool}/life", tag = "wear",
    params(("tool" = String, Path, description = "The tool"), LifeQuery),
    responses(
        (status = 200, description = "The life", body = LifeBody),
        (status = 404, description = "The tool is not registered", body = ProblemDocument<'static>),
    )
)]
pub(super) async fn get(
    State(state): State<AppState>,
    PathId(tool): PathId<ToolId>,
    Query(query): Query<LifeQuery>,
) -> Result<Json<LifeBody>, Problem> {
    let last = query.last.unwrap_or(USUAL_CYCLES);
    if !(1..=MOST_CYCLES).contains(&last) {
        let message = format!("must be within 1 to {MOST_CYCLES}, is {last}");
        return Err(Problem::invalid_query(Violation::new("last", "out_of_range", message)));
    }
    if state.store.tool(&tool).await?.is_none() {
        return Err(Problem::not_found("tool", tool.as_str()));
    }
    Ok(Json((&state.store.life(&tool, last).await?).into()))
}

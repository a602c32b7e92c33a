//! What to run next: asked for by a MES or a machine, and looked up later by its id.

use super::dto::recommendation::RecommendationBody;
use super::extract::{PathId, Query};
use super::problem::{Problem, ProblemDocument};
use crate::auth::Caller;
use crate::state::AppState;
use axum::Json;
use axum::extract::State;
use feedwright_core::ids::{MachineId, OperationId, RecommendationId, ToolId};
use feedwright_core::recommend::{Damaged, Knowledge, Question, recommend};
use feedwright_store::IssuedRecommendation;
use http::StatusCode;
use serde::Deserialize;
use utoipa::IntoParams;

/// What a recommendation is asked for.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct RecommendationQuery {
    /// The machine that will run the cycle.
    machine: String,
    /// What will be machined.
    operation: String,
    /// The tool that is in the spindle.
    tool: String,
}

/// What to run next on a machine, for an operation, with a tool.
#[utoipa::path(
    get, path = "/v1/recommendations", tag = "recommendations", params(RecommendationQuery),
    responses(
        (status = 200, description = "The recommendation; it is stored under its id", body = RecommendationBody<'static>),
        (status = 404, description = "The machine is not registered", body = ProblemDocument<'static>),
        (status = 422, description = "An id that is none", body = ProblemDocument<'static>),
    )
)]
pub async fn get_recommendation(
    State(state): State<AppState>,
    caller: Caller,
    Query(query): Query<RecommendationQuery>,
) -> Result<Json<RecommendationBody<'static>>, Problem> {
    caller.must_be_for(&query.machine)?;
    let machine = MachineId::parse("machine", &query.machine)?;
    let operation = OperationId::parse("operation", &query.operation)?;
    let tool = ToolId::parse("tool", &query.tool)?;
    let around = state.store.surroundings(&machine, &operation, &tool).await?.ok_or_else(|| {
        Problem::new(StatusCode::NOT_FOUND, "unknown_machine", format!("there is no machine `{machine}`"))
    })?;
    let verdict = state.store.verdict(&tool).await?;
    let knowledge = match &around.operation {
        Some(operation) => state.store.knowledge(operation, &tool).await?,
        None => Knowledge::None,
    };
    let active = state.store.active_profiles(&operation, &tool).await?;
    let mut damaged = around.damaged.clone();
    if active.are_damaged {
        damaged.push(Damaged::FeedProfile);
    }
    let advice = recommend(&Question {
        now: state.clock.now(),
        machine: &around.machine,
        operation_id: &operation,
        operation: around.operation.as_ref(),
        tool_id: &tool,
        tool_registered: around.has_tool(),
        verdict: &verdict,
        knowledge: &knowledge,
        profiles: &active.profiles,
        ran: None,
        damaged: &damaged,
        settings: state.config.recommendation.settings(),
    });
    let id = RecommendationId::parse("id", &format!("{}{}", uuid::Uuid::now_v7(), advice.id_ending()))?;
    let issued = IssuedRecommendation { id, recommendation: advice };
    let body = RecommendationBody::from(&issued).owned();
    state.metrics.recommendation(&issued.recommendation);
    state.commit(|store| async move { store.issue_recommendation(&issued).await }).await?;
    Ok(Json(body))
}

/// A recommendation that was handed out.
#[utoipa::path(
    get, path = "/v1/recommendations/{recommendation_id}", tag = "recommendations",
    params(("recommendation_id" = String, Path, description = "Its id")),
    responses(
        (status = 200, description = "The recommendation as it was handed out", body = RecommendationBody<'static>),
        (status = 404, description = "There is none", body = ProblemDocument<'static>),
    )
)]
pub async fn get_issued(
    State(state): State<AppState>,
    caller: Caller,
    PathId(id): PathId<RecommendationId>,
) -> Result<Json<RecommendationBody<'static>>, Problem> {
    let issued = state.store.recommendation(&id).await?;
    let issued = issued.ok_or_else(|| Problem::not_found("recommendation", id.as_str()))?;
    caller.must_be_for(issued.recommendation.machine.as_str())?;
    Ok(Json(RecommendationBody::from(&issued).owned()))
}

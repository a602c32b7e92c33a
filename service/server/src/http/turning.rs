//! Rough turning: plans, and the next pair of a running edge.

use super::body::Json;
use super::dto::mirror::To;
use super::dto::turning::{
    TurningIntervalBody, TurningNextAnswer, TurningNextQuestion, TurningPlanAnswer, TurningPlanQuestion,
    WholeLifeBody, outside_warning,
};
use super::library::turning_model;
use super::problem::Problem;
use crate::state::AppState;
use axum::extract::State;
use feedwright_core::invalid::Violation;
use feedwright_core::turning::{
    AdaptationInput, Cut, EdgeState, Job, NextCut, Objective, best_fixed_run, compare, fixed_run,
    greedy_plan, next_cut, whole_life_plan,
};

/// Plans the sequence of speed and feed to the end of an edge's life (Alaskari & Oraby 2017).
///
/// Each interval takes the pair of largest removal rate within the limits of power, force and wear; wear is carried
/// on. Beside it stand a run at fixed parameters and, where asked for, a plan over the whole life.
#[utoipa::path(post, path = "/v1/turning/plan", tag = "turning", request_body = TurningPlanQuestion,
    responses((status = 200, body = TurningPlanAnswer)))]
pub(super) async fn plan(
    State(state): State<AppState>,
    Json(question): Json<TurningPlanQuestion>,
) -> Result<axum::Json<TurningPlanAnswer>, Problem> {
    let TurningPlanQuestion { job, start, fixed, whole_life } = question;
    let model = turning_model(&state, "job.model", job.model.clone()).await?;
    let (job, start) = (job.job(model)?, start.state()?);
    let fixed = fixed.map(|fixed| fixed.cut("fixed")).transpose()?;
    let objective = whole_life.map(Objective::from);
    let work = move || planned(&job, start, fixed, objective);
    Ok(axum::Json(state.jobs.inline(&state.lifecycle, work).await?))
}

fn planned(
    job: &Job,
    start: EdgeState,
    fixed: Option<Cut>,
    objective: Option<Objective>,
) -> TurningPlanAnswer {
    let plan = greedy_plan(job, start);
    let fixed = match fixed {
        Some(cut) => Some(fixed_run(job, start, cut)),
        None => best_fixed_run(job, start),
    };
    let comparison = fixed.as_ref().map(|fixed| compare(&plan, fixed).to());
    let whole_life = objective.map(|objective| whole_life_plan(job, start, objective));
    let warnings = outside_warning(plan.outside).into_iter().collect();
    TurningPlanAnswer {
        plan: plan.into(),
        fixed: fixed.map(Into::into),
        comparison,
        whole_life: whole_life.map(|life| WholeLifeBody {
            plan: life.plan.into(),
            gain: life.gain,
            gain_by_state: life.gain_by_state,
        }),
        warnings,
    }
}

/// Chooses the next speed and feed of a running edge from what it has cut and what was measured on it.
///
/// Measured power, force and wear correct the coefficients, bounded and with their uncertainty. Cycles that are
/// posted get the same as part of their recommendation, where their operation names a turning model.
#[utoipa::path(post, path = "/v1/turning/next", tag = "turning", request_body = TurningNextQuestion,
    responses((status = 200, body = TurningNextAnswer)))]
pub(super) async fn next(
    State(state): State<AppState>,
    Json(question): Json<TurningNextQuestion>,
) -> Result<axum::Json<TurningNextAnswer>, Problem> {
    let TurningNextQuestion { job, start, intervals, caution_sigmas } = question;
    let model = turning_model(&state, "job.model", job.model.clone()).await?;
    let (job, start) = (job.job(model)?, start.state()?);
    let depth = job.depth_mm();
    let interval =
        |(index, interval): (usize, super::dto::turning::CutIntervalBody)| interval.interval(index, depth);
    let intervals = intervals.into_iter().enumerate().map(interval).collect::<Result<Vec<_>, _>>()?;
    let work = move || next_cut(&job, AdaptationInput::default(), caution_sigmas, start, &intervals);
    let found = state.jobs.inline(&state.lifecycle, work).await?.map_err(|(index, error)| {
        let measured = ["power_kw", "force_n", "wear_mm"].contains(&error.field());
        let path = match index {
            Some(index) if measured => format!("intervals[{index}].measured.{}", error.field()),
            Some(index) => format!("intervals[{index}].{}", error.field()),
            None => error.field().to_owned(),
        };
        Violation::new(path, error.code(), error.problem().to_string())
    })?;
    Ok(axum::Json(answer(found)))
}

fn answer(NextCut { state, corrections, readings, choice }: NextCut) -> TurningNextAnswer {
    let warnings = choice.ok().and_then(|chosen| outside_warning(chosen.outside)).into_iter().collect();
    TurningNextAnswer {
        elapsed_min: state.elapsed_min(),
        corrections: corrections.to(),
        readings: readings.to(),
        next: choice.ok().map(TurningIntervalBody::from),
        ended_by: choice.err().to(),
        warnings,
    }
}

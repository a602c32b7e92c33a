//! Vibratory drilling by cutting continuity: simulation, maps, border, advice (Gouskov et al. 2015).

use super::body::Json;
use super::dto::continuity::{
    AdviceAnswer, AdviceQuestionBody, BorderAnswer, BorderQuestion, MapBody, MapQuestionBody, SimulateAnswer,
    SimulateQuestion,
};
use super::dto::job::JobBody;
use super::dto::mirror::{To, violation};
use super::jobs::{computed, json};
use super::problem::Problem;
use crate::jobs::{INLINE_STEPS, Question, workers};
use crate::state::AppState;
use axum::extract::State;
use axum::response::Response;
use feedwright_core::invalid::Violation;
use feedwright_core::vibratory::continuity::{
    advise_head, best_of, border_at, border_minimum, run_map, simulate as run, trace,
};

/// Most points of a trace in one answer: some 10 MB of JSON.
const MAX_TRACE: u64 = 100_000;
/// Most points of the border in one answer: finer than any screen.
const MAX_BORDER: usize = 10_000;

/// Simulates one process with chip segmentation, free or with the continuity control (Eq. 6–13).
#[utoipa::path(post, path = "/v1/vibratory/simulate", tag = "vibratory", request_body = SimulateQuestion,
    responses((status = 200, body = SimulateAnswer)))]
pub(super) async fn simulate(
    State(state): State<AppState>,
    Json(question): Json<SimulateQuestion>,
) -> Result<axum::Json<SimulateAnswer>, Problem> {
    let process = question.process()?;
    let steps = u64::from(question.settings.periods) * u64::from(question.settings.steps_per_period);
    let too_many = |path: &str, max: u64| {
        Violation::new(path, "too_many", format!("makes {steps} steps, at most {max}"))
    };
    if steps > INLINE_STEPS {
        return Err(too_many("settings.periods", INLINE_STEPS).into());
    }
    let every = question.trace_every;
    if every.is_some_and(|every| steps / u64::from(every.max(1)) > MAX_TRACE) {
        return Err(too_many("trace_every", MAX_TRACE).into());
    }
    let work = move || match every {
        None => Ok((run(&process), None)),
        Some(every) => trace(&process, every).map(|(steady, points)| (steady, Some(points.to()))),
    };
    let done = state.jobs.inline(&state.lifecycle, work).await?;
    let (steady, trace) =
        done.map_err(|error| Violation::new("trace_every", error.code(), error.problem().to_string()))?;
    Ok(axum::Json(SimulateAnswer { steady: steady.into(), trace }))
}

/// Computes a map of ψ, A and Pmax over (p, kc), with or without control.
///
/// A small map is answered at once. A large one becomes a job: 202 with its id, to be asked for at `/v1/jobs/{id}` of the same server;
/// the same question gets the same job there, and its result for as long as it is kept.
#[utoipa::path(post, path = "/v1/vibratory/map", tag = "vibratory", request_body = MapQuestionBody,
    responses((status = 200, body = MapBody), (status = 202, description = "It became a job", body = JobBody)))]
pub(super) async fn map(
    State(state): State<AppState>,
    Json(question): Json<MapQuestionBody>,
) -> Result<Response, Problem> {
    let parameters = format!("{question:?}");
    let (question, steps) = question.question()?;
    let about = Question { kind: "vibratory_map", parameters, total: question.points(), steps };
    computed(&state, about, move |progress| {
        let done = |done: usize, _: usize| progress.at(done);
        let map = run_map(&question, workers(), &done, progress.cancel()).ok()?;
        json(&MapBody::from(map))
    })
    .await
}

/// Tells the border of linear stability.
#[utoipa::path(post, path = "/v1/vibratory/border", tag = "vibratory", request_body = BorderQuestion,
    responses((status = 200, body = BorderAnswer)))]
pub(super) async fn border(
    Json(question): Json<BorderQuestion>,
) -> Result<axum::Json<BorderAnswer>, Problem> {
    let BorderQuestion { frequency_ratios, damping, exponent } = question;
    if frequency_ratios.is_empty() || frequency_ratios.len() > MAX_BORDER {
        let detail = format!("must have 1 to {MAX_BORDER} elements, has {}", frequency_ratios.len());
        return Err(Violation::new("frequency_ratios", "invalid_length", detail).into());
    }
    let minimum = border_minimum(damping, exponent).map_err(|error| violation("", error))?;
    let point = |(index, ratio): (usize, &f64)| {
        border_at(*ratio, damping, exponent).map(To::to).map_err(|error| {
            Violation::new(format!("frequency_ratios[{index}]"), error.code(), error.problem().to_string())
        })
    };
    let points = frequency_ratios.iter().enumerate().map(point).collect::<Result<_, _>>()?;
    Ok(axum::Json(BorderAnswer { points, minimum }))
}

/// Advises spindle-speed windows and the stiffness of the head for which chips segment with least amplitude, and
/// tells how much scatter of the cutting coefficient they bear.
///
/// For setting a machine up. Many speeds or heads become a job, as a map does.
#[utoipa::path(post, path = "/v1/vibratory/advice", tag = "vibratory", request_body = AdviceQuestionBody,
    responses((status = 200, body = AdviceAnswer), (status = 202, description = "It became a job", body = JobBody)))]
pub(super) async fn advice(
    State(state): State<AppState>,
    Json(question): Json<AdviceQuestionBody>,
) -> Result<Response, Problem> {
    let parameters = format!("{question:?}");
    let (question, heads, steps) = question.question()?;
    let about = Question { kind: "vibratory_advice", parameters, total: heads, steps };
    computed(&state, about, move |progress| {
        let heads = progress.all(heads, |head| advise_head(&question, head))?;
        json(&AdviceAnswer::from(best_of(heads.into_iter().flatten().collect())))
    })
    .await
}

//! Long computations: asked for, cancelled.

use super::dto::job::JobBody;
use super::extract::PathId;
use super::problem::{Problem, ProblemDocument};
use crate::jobs::{INLINE_STEPS, MAX_STEPS, Progress, Question, Snapshot, Stage};
use crate::state::AppState;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use feedwright_core::invalid::Violation;
use http::{HeaderValue, StatusCode, header};
use serde::Serialize;

/// A result as the JSON that is answered; none would mean a float that is no number, which no checked input makes.
pub(super) fn json(value: &impl Serialize) -> Option<Bytes> {
    serde_json::to_vec(value).ok().map(Bytes::from)
}

/// Answers what is short at once, and makes a job of what is long.
pub(super) async fn computed(
    state: &AppState,
    question: Question,
    work: impl FnOnce(&Progress) -> Option<Bytes> + Send + 'static,
) -> Result<Response, Problem> {
    if question.steps > MAX_STEPS {
        let message = format!("makes {} integration steps, at most {MAX_STEPS} are accepted", question.steps);
        return Err(Violation::new("", "too_many", message).into());
    }
    if question.steps <= INLINE_STEPS {
        let result = state.jobs.inline(&state.lifecycle, move || work(&Progress::default())).await?;
        let result = result.ok_or_else(|| Problem::internal("a short computation gave no result"))?;
        return Ok(raw(result));
    }
    submitted(state, &question, work)
}

/// Makes a job of a question and answers where it is.
pub(super) fn submitted(
    state: &AppState,
    question: &Question,
    work: impl FnOnce(&Progress) -> Option<Bytes> + Send + 'static,
) -> Result<Response, Problem> {
    let job = state.jobs.submit(question, &state.lifecycle, state.clock.now(), work)?;
    let place = HeaderValue::try_from(format!("/v1/jobs/{}", job.id));
    let mut response = (StatusCode::ACCEPTED, shown(&job)?).into_response();
    if let Ok(place) = place {
        response.headers_mut().insert(header::LOCATION, place);
    }
    Ok(response)
}

fn raw(json: Bytes) -> Response {
    ([(header::CONTENT_TYPE, "application/json")], json).into_response()
}

/// A job with its result, which is JSON already and not read again.
fn shown(job: &Snapshot) -> Result<Response, Problem> {
    let body =
        serde_json::to_string(&JobBody::from(job)).map_err(|error| Problem::internal(error.to_string()))?;
    let Stage::Done(result) = &job.stage else {
        return Ok(raw(body.into()));
    };
    let open = body.strip_suffix('}').unwrap_or(&body);
    let mut json = Vec::with_capacity(open.len() + result.len() + 12);
    json.extend_from_slice(open.as_bytes());
    json.extend_from_slice(b",\"result\":");
    json.extend_from_slice(result);
    json.push(b'}');
    Ok(raw(json.into()))
}

/// 404, with what may have become of it.
fn unknown(id: &str) -> Problem {
    let detail = format!(
        "this server has no job `{id}`: it may have been asked for at another server or before a restart, or is forgotten; ask \
         again what it was to compute"
    );
    Problem::new(StatusCode::NOT_FOUND, "not_found", detail)
}

/// Tells how far a computation is, and its result once it is done.
///
/// Ended ones are kept up to 64 of them and 64 MiB of results, and forgotten at a restart. A job is the server's that was asked for it: where
/// several share a database the others answer 404, so that a proxy in front of them sends what one client asks to one server. Whoever
/// is told 404 asks the question again.
#[utoipa::path(get, path = "/v1/jobs/{id}", tag = "jobs", params(("id" = String, Path)),
    responses((status = 200, body = JobBody)))]
pub(super) async fn get(
    State(state): State<AppState>,
    PathId(id): PathId<String>,
) -> Result<Response, Problem> {
    let job = state.jobs.get(&id).ok_or_else(|| unknown(&id))?;
    shown(&job)
}

/// Cancels a computation that waits or runs. It is shared by everyone who asked the same of this server; the others answer 404.
#[utoipa::path(delete, path = "/v1/jobs/{id}", tag = "jobs", params(("id" = String, Path)),
    responses((status = 204, description = "It is being cancelled"), (status = 409, description = "It has ended",
        body = ProblemDocument<'static>)))]
pub(super) async fn cancel(
    State(state): State<AppState>,
    PathId(id): PathId<String>,
) -> Result<StatusCode, Problem> {
    state.jobs.cancel(&id).ok_or_else(|| unknown(&id))??;
    Ok(StatusCode::NO_CONTENT)
}

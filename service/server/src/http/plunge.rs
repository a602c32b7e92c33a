//! Plunging: feeds of a tool table, what they save, and what recorded cycles show.

use super::body::Json;
use super::dto::mirror::{To, WarningBody};
use super::dto::plunge::{
    PartSavingBody, PlungeFeedAnswer, PlungeFeedQuestion, PlungeSavingQuestion, Plunges, RecordedQuery,
    RecordedSavingBody, RecordedTimesBody,
};
use super::extract::Query;
use super::library::material;
use super::problem::{Problem, ProblemDocument};
use crate::state::AppState;
use axum::extract::State;
use feedwright_core::cycle::Extent;
use feedwright_core::field_error::FieldError;
use feedwright_core::ids::OperationId;
use feedwright_core::invalid::Violation;
use feedwright_core::plunge::{part_saving, plunge_feeds};
use feedwright_core::summary::longest_ms;
use feedwright_core::units::Process;
use feedwright_store::{CycleFilter, StoredCycle};

fn whole(error: FieldError) -> Problem {
    super::dto::mirror::violation("", error).into()
}

/// Plunge feeds of a tool table with the limit that binds each (Lengerov, Eq. 9 and 10).
#[utoipa::path(post, path = "/v1/plunge/feed", tag = "plunge", request_body = PlungeFeedQuestion,
    responses((status = 200, body = PlungeFeedAnswer)))]
pub(super) async fn feed(
    State(state): State<AppState>,
    Json(question): Json<PlungeFeedQuestion>,
) -> Result<axum::Json<PlungeFeedAnswer>, Problem> {
    let material = material(&state, "material", question.material).await?;
    let Plunges { machine, latency, drills } =
        Plunges::of(question.machine, question.latency, question.drills)?;
    let feeds = plunge_feeds(&drills, &material, &machine, latency.as_ref()).map_err(whole)?;
    let message =
        "no delay of the loop is given: the feeds hold only where contact is sensed in the control itself";
    let warnings =
        latency.is_none().then(|| WarningBody::new("no_loop_latency", message)).into_iter().collect();
    Ok(axum::Json(PlungeFeedAnswer { drills: feeds.to(), warnings }))
}

/// What adaptive plunging saves per hole and per part, and whether it pays (Lengerov, Eq. 3–8).
#[utoipa::path(post, path = "/v1/plunge/saving", tag = "plunge", request_body = PlungeSavingQuestion,
    responses((status = 200, body = PartSavingBody)))]
pub(super) async fn saving(
    Json(question): Json<PlungeSavingQuestion>,
) -> Result<axum::Json<PartSavingBody>, Problem> {
    Ok(axum::Json(part_saving(&question.holes()?).map_err(whole)?.to()))
}

/// The real saving: lengths of an operation's completed cycles tagged `plunge` against those tagged `drilling`.
///
/// Looks at the newest cycles of the operation, 10 000 at the most; `complete` tells whether that is all of them. A cycle
/// without a tag counts as what its operation is. A cycle is as long as its samples, or as the control reports where that is longer.
#[utoipa::path(get, path = "/v1/plunge/recorded", tag = "plunge", params(RecordedQuery),
    responses((status = 200, body = RecordedSavingBody),
        (status = 404, description = "There is no such operation", body = ProblemDocument<'static>),
        (status = 422, description = "A parameter that is not accepted", body = ProblemDocument<'static>)))]
pub(super) async fn recorded(
    State(state): State<AppState>,
    Query(query): Query<RecordedQuery>,
) -> Result<axum::Json<RecordedSavingBody>, Problem> {
    let most = query.most()?;
    let id =
        OperationId::parse("operation", &query.operation).map_err(|bad: Violation| Problem::from(bad))?;
    let operation = state.store.operation(&id).await?;
    let operation = operation.ok_or_else(|| Problem::not_found("operation", id.as_str()))?.sound()?.value;
    let filter = CycleFilter { operation: Some(id), ..CycleFilter::default() };
    let rows = state.store.last_cycles(&filter, most + 1).await?;
    // The one too many is the oldest.
    let older = rows.len().saturating_sub(most as usize);
    let (with, without) = lengths(&rows[older..], operation.process);
    let (with_control, without_control) = (RecordedTimesBody::of(&with), RecordedTimesBody::of(&without));
    let saved_s = without_control.median_s.zip(with_control.median_s).map(|(without, with)| without - with);
    let complete = older == 0;
    Ok(axum::Json(RecordedSavingBody {
        operation: query.operation,
        complete,
        with_control,
        without_control,
        saved_s,
    }))
}

/// Lengths of whole cycles with control and without, ms.
fn lengths(rows: &[StoredCycle], usual: Process) -> (Vec<f64>, Vec<f64>) {
    let (mut with, mut without) = (Vec::new(), Vec::new());
    for row in rows.iter().filter(|row| Extent::of(row.cycle.outcome, row.summary.flags) == Extent::Whole) {
        let lengths = match row.cycle.process.unwrap_or(usual) {
            Process::Plunge => &mut with,
            Process::Drilling => &mut without,
            _ => continue,
        };
        lengths.extend(longest_ms(row.summary.duration_ms, row.cycle.reported_duration_ms));
    }
    (with, without)
}

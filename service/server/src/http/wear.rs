//! How worn a tool is, and its history.

use super::dto::wear::WearBody;
use super::extract::PathId;
use super::problem::{Problem, ProblemDocument};
use crate::http::dto::time;
use crate::state::AppState;
use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use feedwright_core::ids::ToolId;
use feedwright_store::{CycleFilter, CycleKey, Page, StoreError, StoredCycle};
use futures_util::stream;
use http::header;

/// Rows of a history that are read at a time: bounds the memory of an export.
const HISTORY_PAGE: u32 = 500;

/// The verdict on a tool over all its machines, with its evidence.
#[utoipa::path(
    get, path = "/v1/tools/{tool}/wear", tag = "wear",
    params(("tool" = String, Path, description = "The tool")),
    responses(
        (status = 200, description = "The verdict", body = WearBody<'static>),
        (status = 404, description = "The tool is not registered", body = ProblemDocument<'static>),
    )
)]
pub async fn get_wear(
    State(state): State<AppState>,
    PathId(id): PathId<ToolId>,
) -> Result<Json<WearBody<'static>>, Problem> {
    registered(&state, &id).await?;
    let verdict = state.store.verdict(&id).await?;
    Ok(Json(WearBody::from(&verdict).owned()))
}

/// A tool's whole history, a line per cycle in the order in which they were run, as CSV.
#[utoipa::path(
    get, path = "/v1/tools/{tool}/history.csv", tag = "wear",
    params(("tool" = String, Path, description = "The tool")),
    responses(
        (status = 200, description = "The history", body = String, content_type = "text/csv"),
        (status = 404, description = "The tool is not registered", body = ProblemDocument<'static>),
    )
)]
pub async fn get_history(
    State(state): State<AppState>,
    PathId(id): PathId<ToolId>,
) -> Result<Response, Problem> {
    registered(&state, &id).await?;
    let filter = CycleFilter { tool: Some(id.clone()), ..CycleFilter::default() };
    let pages = stream::try_unfold((Some(None), true), move |(after, first)| {
        let (state, filter) = (state.clone(), filter.clone());
        async move {
            let Some(after) = after else { return Ok(None) };
            let rows = state.store.cycles(&filter, Page { after, limit: HISTORY_PAGE }).await?;
            let next = (rows.len() == HISTORY_PAGE as usize).then(|| rows.last().map(key)).flatten();
            let text = csv_of(&rows, first)?;
            Ok::<_, StoreError>(Some((text, (next.map(Some), false))))
        }
    });
    let headers = [
        (header::CONTENT_TYPE, "text/csv; charset=utf-8".to_owned()),
        (header::CONTENT_DISPOSITION, format!("attachment; filename=\"{id}-history.csv\"")),
    ];
    Ok((headers, Body::from_stream(pages)).into_response())
}

async fn registered(state: &AppState, tool: &ToolId) -> Result<(), Problem> {
    match state.store.tool(tool).await? {
        Some(_) => Ok(()),
        None => Err(Problem::not_found("tool", tool.as_str())),
    }
}

fn key(row: &StoredCycle) -> CycleKey {
    (row.cycle.started_at, row.cycle.machine.clone(), row.cycle.id.clone())
}

const HEADER: [&str; 20] = [
    "started_at",
    "received_at",
    "machine",
    "cycle_id",
    "seq",
    "operation",
    "process",
    "strategy",
    "outcome",
    "spindle_speed_rpm",
    "duration_ms",
    "energy_basis",
    "energy_joules",
    "idle_power",
    "max_depth_mm",
    "max_spindle_load_percent",
    "max_feed_drive_load_percent",
    "mean_override_percent",
    "coverage_ratio",
    "flags",
];

fn csv_of(rows: &[StoredCycle], with_header: bool) -> Result<Bytes, StoreError> {
    // RFC 4180, as the other tables.
    let mut writer = csv::WriterBuilder::new().terminator(csv::Terminator::CRLF).from_writer(Vec::new());
    let failed = |error: csv::Error| StoreError::Damaged { what: error.to_string() };
    if with_header {
        writer.write_record(HEADER).map_err(failed)?;
    }
    for row in rows {
        writer.write_record(record(row)).map_err(failed)?;
    }
    let bytes = writer.into_inner().map_err(|error| StoreError::Damaged { what: error.to_string() })?;
    Ok(bytes.into())
}

fn record(row: &StoredCycle) -> [String; HEADER.len()] {
    let (cycle, summary) = (&row.cycle, &row.summary);
    let number = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
    let energy = summary.best_energy();
    let idle = energy.map_or("", |energy| match energy.idle {
        feedwright_core::summary::IdlePower::NotApplicable => "not_applicable",
        feedwright_core::summary::IdlePower::Included => "included",
        feedwright_core::summary::IdlePower::Subtracted { .. } => "subtracted",
    });
    let flags: Vec<&str> = summary.flags.iter().map(feedwright_core::cycle::Flag::as_str).collect();
    [
        time::show_even(cycle.started_at),
        time::show_even(row.received_at),
        cycle.machine.to_string(),
        cycle.id.to_string(),
        cycle.seq.map(|seq| seq.to_string()).unwrap_or_default(),
        cycle.operation.to_string(),
        cycle.process.map(|process| process.as_str().to_owned()).unwrap_or_default(),
        cycle.strategy.map(|strategy| strategy.as_str().to_owned()).unwrap_or_default(),
        cycle.outcome.as_str().to_owned(),
        number(cycle.spindle_speed_rpm),
        number(summary.duration_ms),
        energy.map(|energy| energy.basis.as_str().to_owned()).unwrap_or_default(),
        number(energy.map(|energy| energy.total_joules)),
        idle.to_owned(),
        number(summary.max_depth_mm),
        number(summary.max_spindle_load_percent.map(|peak| peak.value)),
        number(summary.max_feed_drive_load_percent.map(|peak| peak.value)),
        number(summary.mean_override_percent),
        summary.coverage.to_string(),
        flags.join(" "),
    ]
}

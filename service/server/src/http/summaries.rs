//! Summaries of cycles as a table: a line per cycle with all that it amounted to.

use super::dto::time;
use super::export::{self, File, Size};
use super::extract::Query;
use super::known::known;
use super::negotiate::Accepts;
use super::problem::{Problem, ProblemDocument};
use crate::state::AppState;
use crate::table::{Cell, Field, Kind, Row, TableError};
use axum::extract::State;
use axum::response::Response;
use feedwright_core::ids::{MachineId, OperationId, ToolId};
use feedwright_core::invalid::Violation;
use feedwright_core::summary::{Energy, EnergyBasis, IdlePower};
use feedwright_store::{CycleFilter, CycleKey, Page, StoredCycle};
use futures_util::stream;
use futures_util::{StreamExt, TryStreamExt};
use serde::Deserialize;
use std::borrow::Cow;
use utoipa::IntoParams;

/// Rows that are read, and written, at a time.
const PAGE: u32 = 500;
/// Most of the newest cycles that are asked for at once.
const MAX_LAST: u32 = 10_000;

/// Which summaries.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct SummariesQuery {
    /// Of this machine.
    machine: Option<String>,
    /// Of this tool.
    tool: Option<String>,
    /// Of this operation.
    operation: Option<String>,
    /// Begun at or after, RFC 3339.
    from: Option<String>,
    /// Begun before, RFC 3339; later than `from`.
    to: Option<String>,
    /// Only so many of the newest, 1 to 10 000, oldest of them first; all where it is left out.
    #[param(minimum = 1, maximum = 10_000)]
    last: Option<u32>,
}

/// Summaries of cycles, a row each, in the order in which they were run. JSON, CSV, Apache Arrow (IPC stream) or
/// Parquet, as `Accept` says; streamed, however many there are.
#[utoipa::path(
    get, path = "/v1/summaries", tag = "series", params(SummariesQuery),
    responses(
        (status = 200, description = "The summaries", content(
            (Object = "application/json"), (String = "text/csv"),
            (File = "application/vnd.apache.arrow.stream"), (File = "application/vnd.apache.parquet"))),
        (status = 404, description = "Of that machine, tool or operation nothing is known",
            body = ProblemDocument<'static>),
        (status = 406, description = "No accepted media type is offered", body = ProblemDocument<'static>),
        (status = 422, description = "A parameter that is not accepted, or a range that ends where it begins or \
            before (`empty_range`)", body = ProblemDocument<'static>),
    )
)]
pub(super) async fn get_summaries(
    State(state): State<AppState>,
    Query(query): Query<SummariesQuery>,
    Accepts(format): Accepts,
) -> Result<Response, Problem> {
    let text = Option::as_deref;
    let filter = CycleFilter {
        machine: text(&query.machine).map(|id| MachineId::parse("machine", id)).transpose()?,
        tool: text(&query.tool).map(|id| ToolId::parse("tool", id)).transpose()?,
        operation: text(&query.operation).map(|id| OperationId::parse("operation", id)).transpose()?,
        from: text(&query.from).map(|at| time::read_bound("from", at)).transpose()?,
        to: text(&query.to).map(|at| time::read_bound("to", at)).transpose()?,
    };
    time::check_range("to", (filter.from, filter.to))?;
    if let Some(machine) = &filter.machine
        && state.store.machine(machine).await?.is_none()
    {
        return Err(Problem::not_found("machine", machine.as_str()));
    }
    if let Some(last) = query.last.filter(|last| !(1..=MAX_LAST).contains(last)) {
        let message = format!("must be within 1 to {MAX_LAST}, is {last}");
        return Err(Violation::new("last", "out_of_range", message).into());
    }
    // Page by page: only what is asked for by number is there at once.
    let values = query.last.unwrap_or(PAGE) as usize * fields().len();
    let turn = state.exports.turn(Size::of(values)).await?;
    let rows = |cycles: Vec<StoredCycle>| cycles.iter().map(row).collect::<Vec<Row>>();
    let pieces = match query.last {
        Some(last) => {
            let cycles = state.store.last_cycles(&filter, last).await?;
            if cycles.is_empty() {
                known(&*state.store, &filter).await?;
            }
            let pieces: Vec<_> =
                cycles.chunks(PAGE as usize).map(|cycles| Ok(rows(cycles.to_vec()))).collect();
            stream::iter(pieces).boxed()
        }
        None => {
            let store = state.store.clone();
            // Read before anything is answered, so that an error can be told by its status.
            let first = store.cycles(&filter, Page { after: None, limit: PAGE }).await?;
            if first.is_empty() {
                known(&*store, &filter).await?;
            }
            stream::try_unfold(Some(Piece::Read(first)), move |piece| {
                let (store, filter) = (store.clone(), filter.clone());
                async move {
                    let cycles = match piece {
                        None => return Ok(None),
                        Some(Piece::Read(cycles)) => cycles,
                        Some(Piece::After(key)) => {
                            store.cycles(&filter, Page { after: Some(key), limit: PAGE }).await?
                        }
                    };
                    let last = cycles.last().filter(|_| cycles.len() == PAGE as usize);
                    let next = last.map(|StoredCycle { cycle, .. }| {
                        Piece::After((cycle.started_at, cycle.machine.clone(), cycle.id.clone()))
                    });
                    Ok::<_, TableError>((!cycles.is_empty()).then_some((cycles, next)))
                }
            })
            .map_ok(rows)
            .boxed()
        }
    };
    export::table(turn, format, "summaries", fields(), pieces).await
}

/// Cycles that are written next.
enum Piece {
    /// These.
    Read(Vec<StoredCycle>),
    /// Those behind this one.
    After(CycleKey),
}

const PEAKS: [(&str, &str); 5] = [
    ("max_spindle_load_percent", "%"),
    ("max_feed_drive_load_percent", "%"),
    ("max_spindle_power_watts", "W"),
    ("max_thrust_newtons", "N"),
    ("max_torque_newton_metres", "N·m"),
];

fn fields() -> Vec<Field> {
    let mut fields = vec![Field::new("started_at", Kind::Time), Field::new("received_at", Kind::Time)];
    fields.extend(["machine", "cycle_id", "tool", "operation"].map(|name| Field::new(name, Kind::Text)));
    fields.push(Field::new("seq", Kind::Whole));
    fields.extend(
        ["process", "strategy", "law_version", "profile_id"].map(|name| Field::new(name, Kind::Text)),
    );
    fields.push(Field::new("profile_version", Kind::Whole));
    fields.extend(["recommendation_id", "outcome"].map(|name| Field::new(name, Kind::Text)));
    fields.extend([Field::float("spindle_speed_rpm", "rpm"), Field::float("duration_ms", "ms")]);
    // A column per basis: energies of different bases are not comparable, so they share none.
    for basis in EnergyBasis::ALL {
        let name = Cow::Owned(format!("energy_{}_joules", basis.as_str()));
        fields.push(Field { name, kind: Kind::Float, unit: Some("J") });
    }
    fields.push(Field::new("energy_best_basis", Kind::Text));
    fields.push(Field::float("energy_measured_power_idle_watts", "W"));
    fields.push(Field::float("max_depth_mm", "mm"));
    fields.extend(PEAKS.map(|(name, unit)| Field::float(name, unit)));
    fields.extend([
        Field::float("mean_spindle_load_percent", "%"),
        Field::float("mean_feed_drive_load_percent", "%"),
        Field::float("mean_override_percent", "%"),
        Field::float("operator_override_percent", "%"),
        Field::float("median_spindle_speed_rpm", "rpm"),
        Field::float("coverage_ratio", "1"),
        Field::new("sample_count", Kind::Whole),
        Field::new("has_samples", Kind::Truth),
        Field::new("flags", Kind::Text),
    ]);
    fields
}

fn row(stored: &StoredCycle) -> Row {
    let (cycle, summary) = (&stored.cycle, &stored.summary);
    let text = |text: Option<String>| text.map_or(Cell::Missing, Cell::from);
    let energy = |basis| summary.energy.iter().find(|energy: &&Energy| energy.basis == basis);
    let idle = energy(EnergyBasis::MeasuredPower).and_then(|energy| match energy.idle {
        IdlePower::Subtracted { watts } => Some(watts),
        _ => None,
    });
    let flags: Vec<&str> = summary.flags.iter().map(feedwright_core::cycle::Flag::as_str).collect();
    let mut row = vec![
        Cell::Time(cycle.started_at.micros()),
        Cell::Time(stored.received_at.micros()),
        Cell::from(cycle.machine.to_string()),
        Cell::from(cycle.id.to_string()),
        Cell::from(cycle.tool.to_string()),
        Cell::from(cycle.operation.to_string()),
        cycle.seq.and_then(|seq| i64::try_from(seq).ok()).map_or(Cell::Missing, Cell::Whole),
        Cell::from(cycle.process.map(|process| process.as_str())),
        Cell::from(cycle.strategy.map(|strategy| strategy.as_str())),
        text(cycle.law_version.clone()),
        text(cycle.profile.as_ref().map(|profile| profile.profile.to_string())),
        cycle.profile.as_ref().map_or(Cell::Missing, |profile| Cell::Whole(i64::from(profile.version))),
        text(cycle.recommendation.as_ref().map(ToString::to_string)),
        Cell::from(Some(cycle.outcome.as_str())),
        Cell::from(cycle.spindle_speed_rpm),
        Cell::from(summary.duration_ms),
    ];
    row.extend(EnergyBasis::ALL.map(|basis| Cell::from(energy(basis).map(|energy| energy.total_joules))));
    row.extend([
        Cell::from(summary.best_energy().map(|energy| energy.basis.as_str())),
        Cell::from(idle),
        Cell::from(summary.max_depth_mm),
    ]);
    let peaks = [
        summary.max_spindle_load_percent,
        summary.max_feed_drive_load_percent,
        summary.max_spindle_power_watts,
        summary.max_thrust_newtons,
        summary.max_torque_newton_metres,
    ];
    row.extend(peaks.map(|peak| Cell::from(peak.map(|peak| peak.value))));
    row.extend([
        Cell::from(summary.mean_spindle_load_percent),
        Cell::from(summary.mean_feed_drive_load_percent),
        Cell::from(summary.mean_override_percent),
        Cell::from(summary.operator_override_percent),
        Cell::from(summary.median_spindle_speed_rpm),
        Cell::Float(summary.coverage),
        Cell::Whole(i64::from(summary.sample_count)),
        Cell::Truth(stored.has_samples),
        // As other columns of text: what is empty is missing.
        if flags.is_empty() { Cell::Missing } else { Cell::from(flags.join(" ")) },
    ]);
    row
}

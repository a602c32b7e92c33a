//! Series of what cycles amounted to: in buckets over time, or the last ones by themselves.

use super::decimal;
use super::dto::series::{BucketBody, BucketSeriesBody, OneSeriesBody, SeriesAnswer, SeriesBody};
use super::dto::time;
use super::export::{self, File, PIECE, Size};
use super::extract::Query;
use super::known::known;
use super::negotiate::Accepts;
use super::problem::{Problem, ProblemDocument};
use super::value_series;
use crate::series::{self, Bucketed, GroupBy, LastCycles, MAX_LAST, Measure, Series, SeriesKey, Value};
use crate::state::AppState;
use crate::table::{Cell, Field, Format, Kind, Row};
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use feedwright_core::ids::{MachineId, OperationId, ToolId};
use feedwright_core::invalid::Violation;
use feedwright_core::series::Buckets;
use feedwright_store::CycleFilter;
use futures_util::stream;
use http::{HeaderValue, header};
use serde::Deserialize;
use utoipa::IntoParams;

/// What a bucket takes in JSON, in numbers.
const VALUES_OF_BUCKET: usize = 16;
/// Cells of a row of a value and what it is of.
const CELLS_OF_ROW: usize = 9;

/// Which series.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct SeriesQuery {
    /// Measures, separated by commas: `energy_joules` (where it is left out), `duration_ms`, `wear_level_ratio`,
    /// `max_spindle_load_percent`, `max_feed_drive_load_percent`, `max_spindle_power_watts`, `max_thrust_newtons`,
    /// `max_torque_newton_metres`, `max_depth_mm`.
    measures: Option<String>,
    /// `fleet`, `machine`, `tool` or `operation`; where it is left out, whichever of these the question names, else
    /// the fleet.
    by: Option<String>,
    /// Of this machine.
    machine: Option<String>,
    /// Of this tool.
    tool: Option<String>,
    /// Of this operation.
    operation: Option<String>,
    /// Begun at or after, RFC 3339; needed with `bucket`.
    from: Option<String>,
    /// Begun before, RFC 3339, and later than `from`; now where it is left out.
    to: Option<String>,
    /// Width of the buckets, as in `15m`, `1h` or `1d`; they are aligned to UTC, weeks to Mondays.
    bucket: Option<String>,
    /// Instead of buckets: so many of the newest cycles, one by one, 1 to 10 000.
    #[param(minimum = 1, maximum = 10_000)]
    last: Option<u32>,
    /// For JSON: `series` (where it is left out) or `rows` (an object per row, for Grafana).
    layout: Option<String>,
}

/// What cycles amounted to over time. JSON, CSV, Apache Arrow (IPC stream) or Parquet, as `Accept` says.
///
/// Every bucket of the range is answered: one without cycles has count 0 and nulls. Energies of different bases, and
/// with idle power in or out of them, are different series; where the range has none, one without a basis stands for
/// them. Percentiles are exact, by linear interpolation.
#[utoipa::path(
    get, path = "/v1/series", tag = "series", params(SeriesQuery),
    responses(
        (status = 200, description = "The series", content(
            (SeriesAnswer = "application/json"), (String = "text/csv"),
            (File = "application/vnd.apache.arrow.stream"), (File = "application/vnd.apache.parquet"))),
        (status = 404, description = "Of that machine, tool or operation nothing is known",
            body = ProblemDocument<'static>),
        (status = 406, description = "No accepted media type is offered", body = ProblemDocument<'static>),
        (status = 422, description = "A parameter that is not accepted, a range that ends where it begins or before \
            (`empty_range`), or too large a question",
            body = ProblemDocument<'static>),
    )
)]
pub(super) async fn get_series(
    State(state): State<AppState>,
    Query(query): Query<SeriesQuery>,
    Accepts(format): Accepts,
) -> Result<Response, Problem> {
    let asked = Asked::of(&state, &query)?;
    if let Some(machine) = &asked.filter.machine
        && state.store.machine(machine).await?.is_none()
    {
        return Err(Problem::not_found("machine", machine.as_str()));
    }
    let turn = state.exports.turn(asked.size()).await?;
    let (store, filter) = (&*state.store, &asked.filter);
    let cycles;
    let (answer, seen) = match asked.extent {
        Extent::Buckets(width_us) => {
            let (buckets, series, seen) =
                series::bucketed(store, filter, &asked.measures, asked.by, width_us).await?;
            (Answer::Buckets(buckets, series), seen)
        }
        Extent::Last(count) => {
            cycles = LastCycles::of(store, filter, &asked.measures, count).await?;
            (Answer::Values(cycles.series(&asked.measures, asked.by)), cycles.count())
        }
    };
    if seen == 0 {
        known(store, filter).await?;
    }
    if format == Format::Json && !asked.in_rows {
        let vary = [(header::VARY, HeaderValue::from_static("accept"))];
        let json = answer.json(asked.by).map_err(|error| Problem::internal(error.to_string()))?;
        return Ok(export::held((vary, decimal::body(json)).into_response(), turn));
    }
    let (fields, rows) = answer.table(asked.by);
    let mut rows = rows.into_iter();
    let pieces = std::iter::from_fn(move || {
        let piece: Vec<Row> = rows.by_ref().take(PIECE).collect();
        (!piece.is_empty()).then_some(Ok(piece))
    });
    export::table(turn, format, "series", fields, stream::iter(pieces)).await
}

#[derive(Debug, Clone, Copy)]
enum Extent {
    /// Buckets of that width, µs.
    Buckets(i64),
    /// So many of the newest cycles.
    Last(u32),
}

/// The question, read and checked.
#[derive(Debug)]
struct Asked {
    measures: Vec<Measure>,
    by: GroupBy,
    filter: CycleFilter,
    extent: Extent,
    in_rows: bool,
}

impl Asked {
    /// What the answer takes: of the whole fleet over time it may be all cycles there are.
    fn size(&self) -> Size {
        match self.extent {
            Extent::Last(count) => Size::of(count as usize * self.measures.len() * CELLS_OF_ROW),
            // A tool's life is thousands of cycles; all others may be as many as are read at all.
            Extent::Buckets(width_us) => {
                let filter = &self.filter;
                let is_one = filter.tool.is_some() && matches!(self.by, GroupBy::Tool | GroupBy::Fleet);
                let range = filter.from.zip(filter.to);
                let buckets = range.and_then(|(from, to)| Buckets::new(from, to, width_us));
                let buckets = buckets.map_or(0, |buckets| buckets.count());
                let values = buckets.saturating_mul(self.measures.len() * VALUES_OF_BUCKET);
                if is_one { Size::of(values) } else { Size::Large }
            }
        }
    }

    fn of(state: &AppState, query: &SeriesQuery) -> Result<Self, Problem> {
        let text = Option::as_deref;
        let mut filter = CycleFilter {
            machine: text(&query.machine).map(|id| MachineId::parse("machine", id)).transpose()?,
            tool: text(&query.tool).map(|id| ToolId::parse("tool", id)).transpose()?,
            operation: text(&query.operation).map(|id| OperationId::parse("operation", id)).transpose()?,
            from: text(&query.from).map(|at| time::read_bound("from", at)).transpose()?,
            to: text(&query.to).map(|at| time::read_bound("to", at)).transpose()?,
        };
        let by = match text(&query.by) {
            Some(word) => GroupBy::parse(word).ok_or_else(|| {
                let message = format!("must be fleet, machine, tool or operation, is `{word}`");
                Violation::new("by", "unknown_word", message)
            })?,
            None if filter.tool.is_some() => GroupBy::Tool,
            None if filter.machine.is_some() => GroupBy::Machine,
            None if filter.operation.is_some() => GroupBy::Operation,
            None => GroupBy::Fleet,
        };
        let measures = Measure::list("measures", text(&query.measures).unwrap_or("energy_joules"))?;
        let extent = match (text(&query.bucket), query.last) {
            (Some(bucket), None) => {
                if filter.from.is_none() {
                    return Err(Violation::new("from", "missing", "is needed with bucket").into());
                }
                filter.to.get_or_insert(state.clock.now());
                Extent::Buckets(series::width_us("bucket", bucket)?)
            }
            (None, Some(last)) if (1..=MAX_LAST).contains(&last) => Extent::Last(last),
            (None, Some(last)) => {
                let message = format!("must be within 1 to {MAX_LAST}, is {last}");
                return Err(Violation::new("last", "out_of_range", message).into());
            }
            _ => {
                let message = "say either bucket, the width of the buckets, or last, a number of cycles";
                return Err(Violation::new("bucket", "one_of", message).into());
            }
        };
        time::check_range("to", (filter.from, filter.to))?;
        let in_rows = match text(&query.layout) {
            None | Some("series") => false,
            Some("rows") => true,
            Some(other) => {
                let message = format!("must be series or rows, is `{other}`");
                return Err(Violation::new("layout", "unknown_word", message).into());
            }
        };
        Ok(Self { measures, by, filter, extent, in_rows })
    }
}

enum Answer<'a> {
    Buckets(Buckets, Series<Bucketed>),
    Values(Series<Vec<Value<'a>>>),
}

impl Answer<'_> {
    fn json(&self, by: GroupBy) -> std::io::Result<Vec<u8>> {
        match self {
            Self::Values(series) => value_series::json(by, series),
            Self::Buckets(buckets, series) => {
                let all = series.iter().map(|(key, values)| {
                    let points = (0..buckets.count()).zip(&values.buckets);
                    OneSeriesBody::Buckets(BucketSeriesBody {
                        key: key.into(),
                        group: group(key),
                        points: points
                            .map(|(at, spread)| BucketBody::of(buckets.begin(at), *spread))
                            .collect(),
                    })
                });
                let body = SeriesBody { by: by.as_str(), series: all.collect() };
                decimal::json(&body, series.len() * buckets.count() * VALUES_OF_BUCKET)
            }
        }
    }

    fn table(&self, by: GroupBy) -> (Vec<Field>, Vec<Row>) {
        let mut fields = vec![Field::new("time", Kind::Time)];
        if matches!(self, Self::Values(_)) {
            fields.extend([Field::new("cycle_machine", Kind::Text), Field::new("cycle_id", Kind::Text)]);
        }
        if by != GroupBy::Fleet {
            fields.push(Field::new(by.as_str(), Kind::Text));
        }
        fields.extend(["measure", "unit", "basis", "idle_power"].map(|name| Field::new(name, Kind::Text)));
        let describe = |key: &SeriesKey| {
            let mut cells = Vec::with_capacity(5);
            if by != GroupBy::Fleet {
                cells.push(Cell::from(key.group.clone()));
            }
            cells.extend([
                Cell::from(Some(key.measure.as_str())),
                Cell::from(Some(key.measure.unit())),
                Cell::from(key.basis.map(|(basis, _)| basis)),
                Cell::from(key.basis.map(|(_, idle)| idle)),
            ]);
            cells
        };
        let mut rows = Vec::new();
        match self {
            Self::Buckets(buckets, series) => {
                fields.push(Field::new("count", Kind::Whole));
                fields.extend(["mean", "min", "max", "p50", "p95"].map(|name| Field::new(name, Kind::Float)));
                for (key, values) in series {
                    for (at, spread) in values.buckets.iter().enumerate() {
                        let mut row = vec![Cell::Time(time::as_shown(buckets.begin(at)).micros())];
                        row.extend(describe(key));
                        let count = spread.map_or(0, |spread| spread.count);
                        row.push(Cell::Whole(i64::try_from(count).unwrap_or(i64::MAX)));
                        let figures = spread.map(|s| [s.mean, s.min, s.max, s.p50, s.p95]);
                        row.extend((0..5).map(|at| Cell::from(figures.map(|figures| figures[at]))));
                        rows.push(row);
                    }
                }
            }
            Self::Values(series) => {
                fields.push(Field::new("value", Kind::Float));
                for (key, values) in series {
                    for value in values {
                        let mut row = vec![
                            Cell::Time(value.point.key.0.micros()),
                            Cell::from(value.point.key.1.as_str().to_owned()),
                            Cell::from(value.point.key.2.as_str().to_owned()),
                        ];
                        row.extend(describe(key));
                        row.push(Cell::Float(value.value));
                        rows.push(row);
                    }
                }
            }
        }
        (fields, rows)
    }
}

/// The machine, tool or operation whose series it is; `None` for the fleet.
pub(super) fn group(key: &SeriesKey) -> Option<&str> {
    (!key.group.is_empty()).then_some(&key.group)
}

//! The samples of one cycle: chosen channels, a range, few enough rows for a screen, in the form that is accepted.

use super::columns;
use super::decimal;
use super::dto::cycle::{SamplesAnswer, SamplesBody};
use super::dto::time;
use super::export::{self, File, PIECE, Size, Turn};
use super::extract::{PathId, Query};
use super::negotiate::Accepts;
use super::problem::{Problem, ProblemDocument};
use crate::state::AppState;
use crate::table::{Cell, Field, Format, Kind, Row, TableError};
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use feedwright_core::cycle::{Channel, Downsampling, Samples, TimeBase};
use feedwright_core::ids::{CycleId, MachineId};
use feedwright_core::invalid::Violation;
use feedwright_core::units::Timestamp;
use futures_util::stream;
use http::{HeaderName, HeaderValue, StatusCode, header};
use serde::Deserialize;
use utoipa::IntoParams;

/// The same address answers in several forms.
const VARIES: [(HeaderName, HeaderValue); 1] = [(header::VARY, HeaderValue::from_static("accept"))];

/// Times that differ by no more than this share are the same number: a sample's time is its number times the period, rounded.
const ROUNDING: f64 = 1e-12;

/// Which samples of a cycle.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct SamplesQuery {
    /// Channels, separated by commas, as in `depth_mm,spindle_load_percent`; all where it is left out.
    channels: Option<String>,
    /// Not before this time since the start of the cycle, ms; a bound of time takes a sample whose time is the same number
    /// but for rounding.
    from_ms: Option<f64>,
    /// Not after this time, ms.
    to_ms: Option<f64>,
    /// Not above this depth, mm.
    from_depth_mm: Option<f64>,
    /// Not below this depth, mm.
    to_depth_mm: Option<f64>,
    /// Most rows; the method says which are left. All where it is left out. Of c channels it is 2c + 2 at the least for
    /// `min_max` and 3c for `lttb`.
    #[param(minimum = 3)]
    points: Option<usize>,
    /// `min_max` (every peak of every channel survives; where it is left out) or `lttb` (the shape of the line).
    method: Option<String>,
    /// For JSON: `columns` (as they were posted; where it is left out) or `rows` (an object per row, for Grafana).
    layout: Option<String>,
}

/// The samples of one cycle. JSON, CSV, Apache Arrow (IPC stream) or Parquet, as `Accept` says.
///
/// Without a range or `points`, JSON columns are those that were posted. Rows of every other form carry `time` (UTC)
/// and `time_ms` (since the start of the cycle).
#[utoipa::path(
    get, path = "/v1/machines/{machine}/cycles/{cycle_id}/samples", tag = "cycles",
    params(("machine" = String, Path, description = "Its machine"), ("cycle_id" = String, Path, description = "Its id"),
        SamplesQuery),
    responses(
        (status = 200, description = "The samples", content(
            (SamplesAnswer = "application/json"), (String = "text/csv"),
            (File = "application/vnd.apache.arrow.stream"), (File = "application/vnd.apache.parquet"))),
        (status = 404, description = "There is no such cycle, or it came without samples", body = ProblemDocument<'static>),
        (status = 406, description = "No accepted media type is offered", body = ProblemDocument<'static>),
        (status = 410, description = "They were dropped by retention (`dropped_at` says when), or are missing (`samples_lost`)",
            body = ProblemDocument<'static>),
        (status = 422, description = "A parameter that is not accepted", body = ProblemDocument<'static>),
    )
)]
pub(super) async fn get_samples(
    State(state): State<AppState>,
    PathId(machine): PathId<MachineId>,
    PathId(id): PathId<CycleId>,
    Query(query): Query<SamplesQuery>,
    Accepts(format): Accepts,
) -> Result<Response, Problem> {
    let wanted = Wanted::of(query)?;
    if wanted.is_all() && format == Format::Json && !wanted.in_rows {
        let turn = turn(&state, &machine, &id).await?;
        let Some(columns) = state.store.cycle_columns(&machine, &id).await? else {
            return Err(no_samples(&state, &machine, &id).await?);
        };
        let values = columns.len * columns.channels.len();
        let writing = move || columns::json(columns).map_err(|error| Problem::internal(error.to_string()));
        let size = Size::of(values);
        let turn = state.exports.suited(turn, size);
        let json = if size == Size::Small {
            writing()?
        } else {
            // Streams would wait for as long as it takes.
            let written = tokio::task::spawn_blocking(writing).await;
            written.map_err(|error| Problem::internal(error.to_string()))??
        };
        return Ok(export::held((VARIES, decimal::body(json)).into_response(), turn));
    }
    let turn = turn(&state, &machine, &id).await?;
    let Some(samples) = state.store.cycle_samples(&machine, &id).await? else {
        return Err(no_samples(&state, &machine, &id).await?);
    };
    let cycle = state.store.cycle(&machine, &id).await?;
    let cycle = cycle.ok_or_else(|| Problem::not_found("cycle", id.as_str()))?;
    let selecting = move || wanted.select(&samples).map(|selected| (samples, selected, wanted));
    let selected = tokio::task::spawn_blocking(selecting).await;
    let (samples, selected, wanted) = selected.map_err(|error| Problem::internal(error.to_string()))??;
    if format == Format::Json && !wanted.in_rows {
        let writing = move || {
            let body = selected.body(&samples);
            decimal::json(&body, body.values())
        };
        let written = tokio::task::spawn_blocking(writing).await;
        let json = written.map_err(|error| Problem::internal(error.to_string()))?;
        let json = json.map_err(|error| Problem::internal(error.to_string()))?;
        return Ok(export::held((VARIES, decimal::body(json)).into_response(), turn));
    }
    let name = format!("{machine}-{id}");
    let fields = selected.fields();
    export::table(turn, format, &name, fields, selected.pieces(samples, cycle.cycle.started_at)).await
}

/// The right to hold a cycle's samples. How large they are is looked up only where so many are held that it matters.
async fn turn(state: &AppState, machine: &MachineId, id: &CycleId) -> Result<Turn, Problem> {
    if let Some(turn) = state.exports.at_once() {
        return Ok(turn);
    }
    let cycle = state.store.cycle(machine, id).await?;
    let samples = cycle.map_or(0, |cycle| cycle.summary.sample_count as usize);
    state.exports.turn(Size::of(samples.saturating_mul(1 + Channel::ALL.len()))).await
}

/// Why a cycle has no samples to show.
pub(super) async fn no_samples(
    state: &AppState,
    machine: &MachineId,
    id: &CycleId,
) -> Result<Problem, Problem> {
    let Some(cycle) = state.store.cycle(machine, id).await? else {
        return Ok(Problem::not_found("cycle", id.as_str()));
    };
    if !cycle.samples_are_gone() {
        return Ok(Problem::not_found("cycle with samples", id.as_str()));
    }
    let gone = state.store.samples_gone(machine, &[(id.clone(), cycle.received_at)]).await?;
    let Some(gone) = gone.get(id) else {
        let detail = "the samples of this cycle are missing, and no retention dropped them: `feedwright check` tells what else is";
        return Ok(Problem::new(StatusCode::GONE, "samples_lost", detail));
    };
    let detail = "the samples of this cycle were dropped by retention; its summary is kept";
    let mut problem = Problem::new(StatusCode::GONE, "samples_dropped", detail);
    problem.members.insert("dropped_at".to_owned(), time::show(gone.dropped_at).into());
    problem.members.insert("reason".to_owned(), gone.reason.as_str().into());
    Ok(problem)
}

/// What was asked for, read and checked.
#[derive(Debug)]
struct Wanted {
    channels: Option<Vec<Channel>>,
    time_ms: (Option<f64>, Option<f64>),
    depth_mm: (Option<f64>, Option<f64>),
    points: Option<usize>,
    method: Downsampling,
    in_rows: bool,
}

impl Wanted {
    fn of(query: SamplesQuery) -> Result<Self, Problem> {
        let mut wrong = Vec::new();
        let mut channels = None;
        if let Some(text) = &query.channels {
            let mut named = Vec::new();
            for name in text.split(',').map(str::trim) {
                match Channel::parse(name) {
                    Some(channel) if !named.contains(&channel) => named.push(channel),
                    Some(_) => {}
                    None => {
                        let all: Vec<_> = Channel::ALL.iter().map(|channel| channel.as_str()).collect();
                        let message =
                            format!("there is no channel `{name}`, must be among {}", all.join(", "));
                        wrong.push(Violation::new("channels", "unknown_channel", message));
                    }
                }
            }
            named.sort_unstable();
            channels = Some(named);
        }
        for (path, value) in [
            ("from_ms", query.from_ms),
            ("to_ms", query.to_ms),
            ("from_depth_mm", query.from_depth_mm),
            ("to_depth_mm", query.to_depth_mm),
        ] {
            if value.is_some_and(|value| !value.is_finite()) {
                wrong.push(Violation::new(path, "not_finite", "must be a finite number"));
            }
        }
        for (path, from, to) in
            [("to_ms", query.from_ms, query.to_ms), ("to_depth_mm", query.from_depth_mm, query.to_depth_mm)]
        {
            if let (Some(from), Some(to)) = (from, to)
                && from > to
            {
                let message = format!("must not be below the beginning of the range ({from}), is {to}");
                wrong.push(Violation::new(path, "empty_range", message));
            }
        }
        let mut word = |path: &'static str, text: Option<String>, words: [&'static str; 2]| {
            let Some(text) = text else { return words[0] };
            words.into_iter().find(|word| *word == text).unwrap_or_else(|| {
                let message = format!("must be {} or {}, is `{text}`", words[0], words[1]);
                wrong.push(Violation::new(path, "unknown_word", message));
                words[0]
            })
        };
        let method = word("method", query.method, Downsampling::ALL.map(Downsampling::as_str));
        let layout = word("layout", query.layout, ["columns", "rows"]);
        if !wrong.is_empty() {
            return Err(Problem::invalid(wrong));
        }
        Ok(Self {
            channels,
            time_ms: (query.from_ms, query.to_ms),
            depth_mm: (query.from_depth_mm, query.to_depth_mm),
            points: query.points,
            method: Downsampling::parse(method).unwrap_or(Downsampling::MinMax),
            in_rows: layout == "rows",
        })
    }

    /// Whether nothing is left out.
    const fn is_all(&self) -> bool {
        self.channels.is_none() && self.is_whole()
    }

    /// Whether no row is left out.
    const fn is_whole(&self) -> bool {
        matches!(self, Self { time_ms: (None, None), depth_mm: (None, None), points: None, .. })
    }

    fn select(&self, samples: &Samples) -> Result<Selected, Problem> {
        let sampled: Vec<Channel> = samples.columns().map(|(channel, _)| channel).collect();
        let channels = self.channels.clone().unwrap_or_else(|| sampled.clone());
        if let Some(lacking) = channels.iter().find(|channel| !sampled.contains(channel)) {
            let names: Vec<_> = sampled.iter().map(|channel| channel.as_str()).collect();
            let message = format!(
                "{} was not sampled in this cycle; sampled were {}",
                lacking.as_str(),
                names.join(", ")
            );
            return Err(Violation::new("channels", "channel_not_sampled", message).into());
        }
        let depth = samples.column(Channel::DepthMm);
        if self.depth_mm != (None, None) && depth.is_none() {
            let message = "the depth was not sampled in this cycle: choose a range of time";
            let path = if self.depth_mm.0.is_some() { "from_depth_mm" } else { "to_depth_mm" };
            return Err(Violation::new(path, "channel_not_sampled", message).into());
        }
        let mut rows: Vec<usize> = (0..samples.len())
            .filter(|&at| {
                within(self.time_ms, ROUNDING, samples.time_ms(at))
                    && depth.is_none_or(|depth| within(self.depth_mm, 0.0, depth[at]))
            })
            .collect();
        if let Some(points) = self.points {
            let least = self.method.least_points(channels.len());
            if points < least {
                let message = format!(
                    "must be at least {least} for {} channels by {}, is {points}",
                    channels.len(),
                    self.method.as_str()
                );
                return Err(Violation::new("points", "too_few_points", message).into());
            }
            let times: Vec<f64> = rows.iter().map(|&at| samples.time_ms(at)).collect();
            let columns: Vec<Vec<f64>> = channels
                .iter()
                .filter_map(|&channel| samples.column(channel))
                .map(|values| rows.iter().map(|&at| values[at]).collect())
                .collect();
            let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
            rows = self.method.rows(&times, &columns, points).into_iter().map(|at| rows[at]).collect();
        }
        Ok(Selected { channels, rows, whole: self.is_whole() })
    }
}

/// Whether a value lies in a range, ends included; a bound reaches as far as a share of itself beyond it.
fn within((from, to): (Option<f64>, Option<f64>), share: f64, value: f64) -> bool {
    from.is_none_or(|from| value >= from - share * from.abs())
        && to.is_none_or(|to| value <= to + share * to.abs())
}

/// What is answered: places in the samples.
#[derive(Debug)]
struct Selected {
    channels: Vec<Channel>,
    rows: Vec<usize>,
    /// Whether no row is left out.
    whole: bool,
}

impl Selected {
    fn body<'a>(&self, samples: &'a Samples) -> SamplesBody<'a> {
        let (period_ms, time_ms) = match samples.time() {
            TimeBase::Period { period_ms } if self.whole => (Some(*period_ms), None),
            _ => (None, Some(self.rows.iter().map(|&at| samples.time_ms(at)).collect())),
        };
        let column = |channel: &Channel| {
            let values = samples.column(*channel)?;
            Some((channel.as_str(), self.rows.iter().map(|&at| values[at]).collect()))
        };
        SamplesBody { period_ms, time_ms, columns: self.channels.iter().filter_map(column).collect() }
    }

    fn fields(&self) -> Vec<Field> {
        let channel = |channel: &Channel| Field::float(channel.as_str(), channel.range().unit);
        let mut fields = vec![Field::new("time", Kind::Time), Field::float("time_ms", "ms")];
        fields.extend(self.channels.iter().map(channel));
        fields
    }

    fn pieces(
        self,
        samples: Samples,
        started_at: Timestamp,
    ) -> impl stream::Stream<Item = Result<Vec<Row>, TableError>> + Send + 'static {
        stream::unfold((self, samples, 0), move |(selected, samples, begin)| async move {
            let rows = selected.rows.get(begin..).filter(|rows| !rows.is_empty())?;
            let columns: Vec<&[f64]> =
                selected.channels.iter().filter_map(|&channel| samples.column(channel)).collect();
            let row = |&at: &usize| {
                let time_ms = samples.time_ms(at);
                let mut row = Vec::with_capacity(columns.len() + 2);
                row.extend([Cell::Time(time::after_ms(started_at, time_ms).micros()), Cell::Float(time_ms)]);
                row.extend(columns.iter().map(|column| Cell::Float(column[at])));
                row
            };
            let piece: Vec<Row> = rows.iter().take(PIECE).map(row).collect();
            let next = begin + piece.len();
            Some((Ok(piece), (selected, samples, next)))
        })
    }
}

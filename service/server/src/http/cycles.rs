//! Cycles: posted one by one or in batches, read, listed.

use super::body::{encoding_of, media_type, no_room, read_within, unsupported};
use super::cursor::{List, Paging};
use super::dto::cycle::{BatchOutcome, CycleAnswerBody, CycleBody, CyclePost};
use super::extract::{PathId, Query};
use super::prefer::Return;
use super::problem::{Problem, ProblemDocument};
use crate::http::dto::time;
use crate::ingest::body::{cycle_id_of, is_frame};
use crate::ingest::content::{ContentError, Encoding, Room, Unpacked};
use crate::ingest::intake::{Accepted, Refused};
use crate::state::AppState;
use axum::Json;
use axum::extract::{Request, State};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use feedwright_core::ids::{CycleId, MachineId, OperationId, ToolId};
use feedwright_store::{CycleFilter, wire};
use http::{HeaderMap, StatusCode, header};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::sync::Arc;
use utoipa::IntoParams;

/// Lines of a batch that are under way at once: about one commit's worth, so that live posts find room in between.
const BATCH_WINDOW: usize = 64;

/// Most answers to a post are shorter: they are written without asking for more room on the way.
const USUAL_ANSWER_BYTES: usize = 6 * 1024;

/// Posts one cycle. The answer comes after its durable commit.
#[utoipa::path(
    post, path = "/v1/machines/{machine}/cycles", tag = "cycles",
    params(("machine" = String, Path, description = "The machine that ran it"),
        ("Prefer" = Option<String>, Header, example = "return=minimal",
            description = "`return=minimal` (RFC 7240) leaves `summary` and `wear` out of the answer, and is told by `Preference-Applied`")),
    request_body(content((CyclePost = "application/json"), (String = "application/vnd.feedwright.cycle")),
        description = "One cycle, as JSON or in the binary form; `Content-Encoding: gzip` and `zstd` are accepted"),
    responses(
        (status = 201, description = "New, and durably stored", body = CycleAnswerBody<'static>),
        (status = 200, description = "The same content was stored before", body = CycleAnswerBody<'static>),
        (status = 400, description = "Malformed; nothing is kept", body = ProblemDocument<'static>),
        (status = 404, description = "The machine is not registered", body = ProblemDocument<'static>),
        (status = 409, description = "Another content is stored under this id: `differs` has the paths of what is other than what is stored; kept in quarantine, see `quarantine_id`",
            body = ProblemDocument<'static>),
        (status = 413, description = "Too large, or a decompression bomb", body = ProblemDocument<'static>),
        (status = 415, description = "Neither JSON nor a known encoding", body = ProblemDocument<'static>),
        (status = 422, description = "Not a cycle that could have been run; kept in quarantine, see `quarantine_id`",
            body = ProblemDocument<'static>),
        (status = 503, description = "Not stored; try again after `Retry-After`", body = ProblemDocument<'static>),
    )
)]
pub async fn post_cycle(
    State(state): State<AppState>,
    PathId(machine): PathId<MachineId>,
    preferred: Return,
    request: Request,
) -> Result<Response, Problem> {
    let body = decoded_body(&state, request, "application/json").await.and_then(|(form, body)| {
        // A batch may be of none, a cycle is none without a frame.
        if form == Form::Binary && body.bytes.is_empty() { Err(no_frame()) } else { Ok(body) }
    });
    let Unpacked { bytes: json, place } = counted(&state, body)?;
    // The client may hang up; what was taken in goes on to its commit all the same.
    let intake = state.intake.clone();
    let accepting = async move {
        let accepted = intake.accept(&machine, json, Refused::ToQuarantine).await;
        drop(place);
        accepted
    };
    let accepted =
        state.lifecycle.spawn(accepting).await.map_err(|error| Problem::internal(error.to_string()))??;
    let status = if accepted.new { StatusCode::CREATED } else { StatusCode::OK };
    let mut json = Vec::with_capacity(USUAL_ANSWER_BYTES);
    let answer = match preferred {
        Return::Representation => CycleAnswerBody::of(&accepted),
        Return::Minimal => CycleAnswerBody::minimal(&accepted),
    };
    serde_json::to_writer(&mut json, &answer).map_err(|error| Problem::internal(error.to_string()))?;
    Ok((status, [(header::CONTENT_TYPE, "application/json")], preferred.applied(), json).into_response())
}

/// Posts many cycles, a JSON document per line or a binary frame after the other; an outcome per line is answered.
///
/// Outcomes come in the order of the lines or frames.
/// A line that fails fails alone. A machine may forget its copy of every line whose outcome is `stored`, `known` or
/// `quarantined`.
#[utoipa::path(
    post, path = "/v1/machines/{machine}/cycles/batch", tag = "cycles",
    params(("machine" = String, Path, description = "The machine that ran them")),
    request_body(content((String = "application/x-ndjson"), (String = "application/vnd.feedwright.cycle")),
        description = "One cycle per line or frame, as for a single post; gzip and zstd are accepted"),
    responses(
        (status = 200, description = "An outcome per line, NDJSON", body = BatchOutcome,
            content_type = "application/x-ndjson"),
        (status = 404, description = "The machine is not registered", body = ProblemDocument<'static>),
        (status = 413, description = "Too large, or too many lines", body = ProblemDocument<'static>),
        (status = 415, description = "Neither NDJSON nor a known encoding", body = ProblemDocument<'static>),
    )
)]
pub async fn post_batch(
    State(state): State<AppState>,
    PathId(machine): PathId<MachineId>,
    request: Request,
) -> Result<Response, Problem> {
    let body = decoded_body(&state, request, LINES).await;
    let (form, Unpacked { bytes: body, place }) = counted(&state, body)?;
    // Kept with what is left of the body, also where the client hangs up.
    let place = Arc::new(place);
    if !state.intake.knows(&machine).await? {
        let detail = format!("there is no machine `{machine}`");
        return counted(&state, Err(Problem::new(StatusCode::NOT_FOUND, "unknown_machine", detail)));
    }
    let most = state.config.limits.batch_lines;
    let lines = match form {
        Form::Json => lines_of(&body, most),
        Form::Binary => frames_of(&body, most),
    };
    let mut lines = counted(&state, lines)?;
    // What follows a torn frame may be anything, but no JSON.
    let stray = lines.pop_if(|(_, bytes)| form == Form::Binary && !is_frame(bytes));
    let mut answer = Vec::with_capacity(128 * lines.len());
    let mut away: Option<Problem> = None;
    for window in lines.chunks(BATCH_WINDOW) {
        // Each window waits in vain as long as a post does; what comes behind one is answered as it was.
        if let Some(problem) = &away {
            for line in window {
                state.metrics.cycle_rejected(problem.code);
                put_outcome(&mut answer, line, Err(problem.clone()))?;
            }
            continue;
        }
        // Read as the frame that it looks like it would be torn by the first of its bytes that ends a line.
        let is_no_line = |line: &Bytes| form == Form::Json && is_frame(line);
        let bodies = window.iter().map(|(_, line)| line).filter(|line| !is_no_line(line)).cloned().collect();
        let (intake, machine, place) = (state.intake.clone(), machine.clone(), Arc::clone(&place));
        // The client may hang up; the window that was taken in goes on to its commits all the same.
        let accepting = async move {
            let results = intake.accept_all(&machine, bodies).await;
            drop(place);
            results
        };
        let results =
            state.lifecycle.spawn(accepting).await.map_err(|error| Problem::internal(error.to_string()))?;
        away = none_of(&results);
        let mut results = results.into_iter();
        for line in window {
            let result = if is_no_line(&line.1) {
                counted(&state, Err(no_json()))
            } else {
                results.next().unwrap_or_else(|| Err(Problem::internal("nothing came of a line")))
            };
            put_outcome(&mut answer, line, result)?;
        }
    }
    if let Some(line) = stray {
        let problem = no_frame();
        state.metrics.cycle_rejected(problem.code);
        put_outcome(&mut answer, &line, Err(problem))?;
    }
    Ok(([(header::CONTENT_TYPE, "application/x-ndjson")], answer).into_response())
}

/// Why none of them was committed, where the database was away for all that reached it. Those that come later are not sent
/// to it, so that of them nothing is unknown.
fn none_of(results: &[Result<Accepted, Problem>]) -> Option<Problem> {
    let mut problems = results.iter().map(|result| result.as_ref().err());
    let is_in_vain = |problem: &Problem| {
        // What is no cycle is told without the database.
        problem.is_of_outage() || matches!(problem.code, "malformed_json" | "malformed_cycle")
    };
    let all = problems.all(|problem| problem.is_some_and(is_in_vain));
    let any = results.iter().any(|result| result.as_ref().is_err_and(Problem::is_of_outage));
    (all && any).then(Problem::database_unavailable)
}

/// One stored cycle with its summary.
///
/// One whose id is `batch` is read at the address to which batches are posted.
#[utoipa::path(
    get, path = "/v1/machines/{machine}/cycles/{cycle_id}", tag = "cycles",
    params(("machine" = String, Path, description = "Its machine"), ("cycle_id" = String, Path, description = "Its id")),
    responses(
        (status = 200, description = "The cycle", body = CycleBody),
        (status = 404, description = "There is none", body = ProblemDocument<'static>),
    )
)]
pub async fn get_cycle(
    State(state): State<AppState>,
    PathId(machine): PathId<MachineId>,
    PathId(id): PathId<CycleId>,
) -> Result<Json<CycleBody>, Problem> {
    let stored = state.store.cycle(&machine, &id).await?;
    let stored = stored.ok_or_else(|| Problem::not_found("cycle", id.as_str()))?;
    let body = CycleBody::from(&stored);
    if !stored.samples_are_gone() {
        return Ok(Json(body));
    }
    let gone = state.store.samples_gone(&machine, &[(id.clone(), stored.received_at)]).await?;
    Ok(Json(body.tell_drop(gone.get(&id))))
}

/// Filters of a list of cycles.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct CyclesQuery {
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
    /// Most rows wanted, up to `limits.max_page_size` of the configuration, which is 1000 unless set otherwise; 100
    /// (`limits.default_page_size`) where it is left out.
    #[param(minimum = 1, maximum = 10_000)]
    limit: Option<u32>,
    /// Where to go on: `next_cursor` of the page before, with the same filters.
    cursor: Option<String>,
}

/// Cycles in the order in which they were run.
#[utoipa::path(
    get, path = "/v1/cycles", tag = "cycles", params(CyclesQuery),
    responses(
        (status = 200, description = "A page of cycles", body = List<CycleBody>),
        (status = 400, description = "A cursor or a limit that is not accepted", body = ProblemDocument<'static>),
        (status = 422, description = "A filter that is not accepted, or a range that ends where it begins or before \
            (`empty_range`)", body = ProblemDocument<'static>),
    )
)]
pub async fn list_cycles(
    State(state): State<AppState>,
    Query(query): Query<CyclesQuery>,
) -> Result<Json<List<CycleBody>>, Problem> {
    let filter = query.filter()?;
    let scope = format!(
        "cycles {:?} {:?} {:?} {:?} {:?}",
        query.machine, query.tool, query.operation, query.from, query.to
    );
    let paging = Paging::new(&state, scope, query.limit, query.cursor.as_deref())?;
    let rows = state.store.cycles(&filter, paging.page()).await?;
    // One question per machine, and only where something is gone.
    let mut without = BTreeMap::<_, Vec<_>>::new();
    for row in rows.iter().filter(|row| row.samples_are_gone()) {
        without.entry(&row.cycle.machine).or_default().push((row.cycle.id.clone(), row.received_at));
    }
    let mut gone = BTreeMap::new();
    for (machine, cycles) in without {
        gone.insert(machine.clone(), state.store.samples_gone(machine, &cycles).await?);
    }
    let view = |row: feedwright_store::StoredCycle| {
        let of_machine = gone.get(&row.cycle.machine);
        CycleBody::from(&row).tell_drop(of_machine.and_then(|gone| gone.get(&row.cycle.id)))
    };
    let key = |row: &feedwright_store::StoredCycle| {
        (row.cycle.started_at, row.cycle.machine.clone(), row.cycle.id.clone())
    };
    Ok(Json(paging.list(rows, key, view)))
}

impl CyclesQuery {
    fn filter(&self) -> Result<CycleFilter, Problem> {
        let text = Option::as_deref;
        let filter = CycleFilter {
            machine: text(&self.machine).map(|id| MachineId::parse("machine", id)).transpose()?,
            tool: text(&self.tool).map(|id| ToolId::parse("tool", id)).transpose()?,
            operation: text(&self.operation).map(|id| OperationId::parse("operation", id)).transpose()?,
            from: text(&self.from).map(|at| time::read_bound("from", at)).transpose()?,
            to: text(&self.to).map(|at| time::read_bound("to", at)).transpose()?,
        };
        time::check_range("to", (filter.from, filter.to))?;
        Ok(filter)
    }
}

/// Form of a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    Json,
    Binary,
}

/// Media type of a batch of JSON.
const LINES: &str = "application/x-ndjson";

/// Reads a body of that media type or the binary one, decompressed within its bounds.
async fn decoded_body(
    state: &AppState,
    request: Request,
    kind: &'static str,
) -> Result<(Form, Unpacked), Problem> {
    let (form, encoding) = form_of(request.headers(), kind)?;
    let room = state.intake.room(kind == LINES);
    let read = read_within(request, state, room, state.config.limits.body_bytes).await?;
    let body = match encoding {
        Encoding::Identity => read,
        _ => unpacked(state, encoding, read, room).await?,
    };
    // The body itself says which form it has; a header that says otherwise is a mistake to be told.
    match (form, is_frame(&body.bytes)) {
        (Form::Binary, false) if !body.bytes.is_empty() => Err(no_frame()),
        (Form::Json, true) => Err(no_json()),
        _ => Ok((form, body)),
    }
}

/// What is refused before a cycle of it is known counts as one: its sender has the only copy.
fn counted<T>(state: &AppState, outcome: Result<T, Problem>) -> Result<T, Problem> {
    outcome.inspect_err(|problem| state.metrics.cycle_rejected(problem.code))
}

fn no_frame() -> Problem {
    Problem::bad_request("malformed_cycle", "the body is no cycle: it does not begin with FWC")
}

fn no_json() -> Problem {
    let detail = format!("the body is no JSON but binary: send it as {}", wire::MEDIA_TYPE);
    Problem::bad_request("malformed_json", detail)
}

/// Decompresses a body, which keeps its place until that is done.
async fn unpacked(
    state: &AppState,
    encoding: Encoding,
    packed: Unpacked,
    room: &Room,
) -> Result<Unpacked, Problem> {
    let bound = state.config.limits.decoded_bytes;
    let unpacked = room.unpack(encoding, packed.bytes, bound).await;
    drop(packed.place);
    unpacked.map_err(|error| match error {
        ContentError::TooLarge => Problem::new(
            StatusCode::PAYLOAD_TOO_LARGE,
            "decoded_body_too_large",
            format!("the body grows beyond {bound} bytes when it is decompressed"),
        ),
        ContentError::Malformed(why) => {
            Problem::bad_request("malformed_encoding", format!("the body cannot be decompressed: {why}"))
        }
        ContentError::Busy => no_room(),
    })
}

fn form_of(headers: &HeaderMap, kind: &'static str) -> Result<(Form, Encoding), Problem> {
    let form = match (media_type(headers)?.as_deref(), kind) {
        (Some(wire::MEDIA_TYPE), _) => Form::Binary,
        (Some(given), wanted) if given == wanted => Form::Json,
        (Some("application/jsonl" | "application/jsonlines" | "application/ndjson"), LINES) => Form::Json,
        (_, "application/json") => {
            return Err(unsupported("send a cycle as application/json or application/vnd.feedwright.cycle"));
        }
        _ => {
            return Err(unsupported(
                "send a batch as application/x-ndjson or application/vnd.feedwright.cycle",
            ));
        }
    };
    let encoding = encoding_of(headers)
        .ok_or_else(|| unsupported("the content encoding must be gzip or zstd, or none"))?;
    Ok((form, encoding))
}

/// The frames of a binary batch with their numbers. What follows a frame that is torn is part of it: it is refused with
/// it, and its sender keeps it.
fn frames_of(body: &Bytes, most: usize) -> Result<Vec<(usize, Bytes)>, Problem> {
    let frames = wire::frames(body, most).ok_or_else(|| too_many(most))?;
    Ok(frames.into_iter().enumerate().map(|(index, frame)| (index + 1, body.slice_ref(frame))).collect())
}

fn too_many(most: usize) -> Problem {
    Problem::new(
        StatusCode::PAYLOAD_TOO_LARGE,
        "too_many_lines",
        format!("a batch may hold at most {most} cycles; nothing of it was taken"),
    )
}

/// The lines with their numbers, empty ones left out.
fn lines_of(text: &Bytes, most: usize) -> Result<Vec<(usize, Bytes)>, Problem> {
    let mut lines = Vec::new();
    for (index, line) in text.split(|byte| *byte == b'\n').enumerate() {
        if line.iter().all(u8::is_ascii_whitespace) {
            continue;
        }
        if lines.len() == most {
            return Err(too_many(most));
        }
        lines.push((index + 1, text.slice_ref(line)));
    }
    Ok(lines)
}

/// Appends what became of a line or frame, by its number and bytes.
fn put_outcome(
    answer: &mut Vec<u8>,
    (line, bytes): &(usize, Bytes),
    result: Result<Accepted, Problem>,
) -> Result<(), Problem> {
    serde_json::to_writer(&mut *answer, &outcome(*line, bytes, result))
        .map_err(|error| Problem::internal(error.to_string()))?;
    answer.push(b'\n');
    Ok(())
}

fn outcome(line: usize, bytes: &[u8], result: Result<Accepted, Problem>) -> BatchOutcome {
    match result {
        Ok(accepted) => BatchOutcome {
            line,
            status: if accepted.new { 201 } else { 200 },
            outcome: if accepted.new { "stored" } else { "known" },
            cycle_id: Some(accepted.cycle.id.to_string()),
            tool_state: Some(accepted.answer.verdict.state.as_str()),
            quarantine_id: None,
            problem: None,
        },
        Err(problem) => {
            let quarantine_id =
                problem.members.get("quarantine_id").and_then(|id| id.as_str()).map(str::to_owned);
            BatchOutcome {
                line,
                status: problem.status.as_u16(),
                outcome: if quarantine_id.is_some() { "quarantined" } else { "refused" },
                cycle_id: cycle_id_of(bytes),
                tool_state: None,
                quarantine_id,
                problem: serde_json::from_str(&problem.document(None)).ok(),
            }
        }
    }
}

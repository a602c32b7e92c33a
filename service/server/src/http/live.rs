//! What happens now, as Server-Sent Events.

use super::extract::{Query, query_id};
use super::once::{Repeated, once};
use super::problem::{Problem, ProblemDocument};
use crate::auth::Caller;
use crate::live::{Position, Reader};
use crate::state::AppState;
use axum::extract::State;
use axum::response::sse::{self, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use feedwright_core::ids::MachineId;
use futures_util::StreamExt;
use http::HeaderMap;
use serde::Deserialize;
use utoipa::IntoParams;

/// What a reader wants to see.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct LiveQuery {
    /// Only what concerns this machine, and what concerns none.
    machine: Option<String>,
    /// Samples of running cycles too, thinned.
    #[serde(default)]
    samples: bool,
    /// Id of the last event that was seen, where the header `Last-Event-ID` cannot be sent.
    after: Option<String>,
}

/// What happens now: machines, cycles and alarms, until the reader goes or its session is over.
///
/// Begins with `state`; then come `machine`, `cycle`, `alarm`, `changed`, `sample` and `gap`, each with JSON as its data, and
/// `heartbeat` where nothing else did for `heartbeat_ms`. Ids are a sequence to resume from with `Last-Event-ID`; what is not kept any more is a `gap`.
#[utoipa::path(get, path = "/v1/live", tag = "live",
    params(LiveQuery, ("Last-Event-ID" = Option<String>, Header, description = "Id of the last event that was seen")),
    responses(
        (status = 200, description = "Events", body = String, content_type = "text/event-stream"),
        (status = 503, description = "Too many readers", body = ProblemDocument<'static>),
    ))]
pub(super) async fn events(
    State(state): State<AppState>,
    caller: Caller,
    Query(query): Query<LiveQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let machine: Option<MachineId> = query_id(query.machine.as_deref())?;
    // Of several it is not known which was seen last: as an id that is none of this service.
    let header = match once(&headers, "last-event-id") {
        Ok(id) => id.map(|id| id.to_str().unwrap_or_default()),
        Err(Repeated) => Some(""),
    };
    let after = header.or(query.after.as_deref()).map(Position::parse);
    let machine = machine.map(|machine| machine.to_string());
    let reader = Reader::new(&state.live, &state.lifecycle, machine, query.samples, after)
        .ok_or_else(|| Problem::unavailable("too_many_readers", "too many readers watch already", 10))?;
    let events = futures_util::stream::unfold(reader, |mut reader| async move {
        let event = reader.next().await?;
        Some((event, reader))
    });
    // An event and no comment: scripts see no comments, and tell by it that the connection is not dead.
    let beat = sse::Event::default().event("heartbeat").data("{}");
    let beats = KeepAlive::new().interval(state.live.config().heartbeat()).event(beat);
    let every = state.live.config().heartbeat();
    let over = async move { caller.over(&state, every).await };
    let events = events.take_until(over);
    Ok(Sse::new(events).keep_alive(beats).into_response())
}

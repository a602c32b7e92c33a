//! A machine's stream, and the overrides that it was answered with.

use super::extract::PathId;
use super::problem::{Problem, ProblemDocument};
use crate::auth::Caller;
use crate::state::AppState;
use crate::stream::opening;
use axum::Json;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::{FromRequestParts, Request, State};
use axum::response::{IntoResponse, Response};
use feedwright_core::closed_loop::LoopReasons;
use feedwright_core::ids::{CycleId, MachineId};
use feedwright_store::codec;
use serde::Serialize;
use utoipa::ToSchema;

/// Opens a machine's stream: samples in, overrides out.
///
/// A WebSocket with the subprotocol `feedwright.v1`. Its messages stand in docs/stream.md and openapi/asyncapi.json.
#[utoipa::path(
    get, path = "/v1/machines/{machine}/stream", tag = "stream",
    params(("machine" = String, Path, description = "The machine whose stream it is")),
    responses(
        (status = 101, description = "The stream is open"),
        (status = 400, description = "No WebSocket, or another subprotocol", body = ProblemDocument<'static>),
        (status = 403, description = "A page of another site, or another machine's token",
            body = ProblemDocument<'static>),
        (status = 404, description = "The machine is not registered", body = ProblemDocument<'static>),
        (status = 409, description = "Another stream of the machine is open, and is not taken over",
            body = ProblemDocument<'static>),
        (status = 426, description = "Not asked for by HTTP/1.1, which a WebSocket needs", body = ProblemDocument<'static>),
        (status = 503, description = "Too many streams, or the database does not answer", body = ProblemDocument<'static>),
    )
)]
pub(super) async fn open(
    State(state): State<AppState>,
    caller: Caller,
    PathId(machine): PathId<MachineId>,
    request: Request,
) -> Result<Response, Problem> {
    let (mut parts, _) = request.into_parts();
    let upgrade = WebSocketUpgrade::from_request_parts(&mut parts, &state).await;
    let upgrade = upgrade.map_err(|rejection| rejection.into_response().status());
    opening::open(&state, caller, machine, &parts.headers, upgrade).await
}

/// What the samples of a streamed cycle were answered.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct OverridesBody {
    /// `advise` (told) or `shadow` (only computed).
    mode: String,
    /// Version of the law.
    law_version: String,
    /// Hash of the program that the machine told, or of the feed profile that it named.
    program_hash: Option<String>,
    /// When it was stored.
    stored_at: String,
    /// The override after each sample, percent.
    override_percent: Vec<f64>,
    /// Reasons, where they change.
    reasons: Vec<ReasonsFrom>,
}

/// Reasons that hold from a sample on.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct ReasonsFrom {
    /// Number of the sample.
    from: usize,
    /// The codes.
    codes: Vec<&'static str>,
}

/// Reads what each sample of a streamed cycle was answered, told or in shadow.
#[utoipa::path(
    get, path = "/v1/machines/{machine}/cycles/{cycle_id}/overrides", tag = "stream",
    params(("machine" = String, Path), ("cycle_id" = String, Path)),
    responses(
        (status = 200, body = OverridesBody),
        (status = 404, description = "The cycle was not streamed", body = ProblemDocument<'static>),
    )
)]
pub(super) async fn overrides(
    State(state): State<AppState>,
    PathId(machine): PathId<MachineId>,
    PathId(cycle): PathId<CycleId>,
) -> Result<Json<OverridesBody>, Problem> {
    let kept = state.store.overrides(&machine, &cycle).await?;
    let kept = kept.ok_or_else(|| Problem::not_found("override of a cycle", cycle.as_str()))?;
    let samples = codec::decode_overrides(&kept.block)?;
    let mut reasons: Vec<ReasonsFrom> = Vec::new();
    let mut last = None;
    for (from, (_, bits)) in samples.iter().enumerate() {
        if last != Some(*bits) {
            last = Some(*bits);
            reasons.push(ReasonsFrom { from, codes: LoopReasons::from_bits(*bits).codes().collect() });
        }
    }
    Ok(Json(OverridesBody {
        mode: kept.mode,
        law_version: kept.law_version,
        program_hash: kept.program_hash,
        stored_at: super::dto::time::show(kept.stored_at),
        override_percent: samples.iter().map(|(percent, _)| *percent).collect(),
        reasons,
    }))
}

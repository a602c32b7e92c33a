//! The quarantine: listed, looked into, and settled by discarding or by taking in again.

use super::body::Json;
use super::cursor::{List, Paging};
use super::dto::quarantine::{
    QuarantineAction, QuarantineDetail, QuarantineQuery, QuarantineView, SettleBody, Settled,
};
use super::export::{self, Size};
use super::extract::{PathId, Query, query_id};
use super::problem::Problem;
use crate::auth::Caller;
use crate::ingest::intake::entry_damaged;
use crate::state::AppState;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use feedwright_core::ids::MachineId;
use feedwright_store::{Actor, QuarantineEntry};
use http::{StatusCode, header};
use std::time::Duration;

/// Lists what could not be accepted, oldest first; what is settled only where it is asked for.
#[utoipa::path(get, path = "/v1/quarantine", tag = "quarantine", params(QuarantineQuery),
    responses((status = 200, body = List<QuarantineView>)))]
pub(super) async fn list(
    State(state): State<AppState>,
    Query(query): Query<QuarantineQuery>,
) -> Result<axum::Json<List<QuarantineView>>, Problem> {
    let machine: Option<MachineId> = query_id(query.machine.as_deref())?;
    let open = query.open.unwrap_or(true);
    let scope = format!("quarantine {machine:?} {open}");
    let paging = Paging::new(&state, scope, query.limit, query.cursor.as_deref())?;
    let rows = state.store.quarantined(machine.as_ref(), open, paging.page()).await?;
    Ok(axum::Json(paging.list(rows, |row| row.id.clone(), QuarantineView::from)))
}

/// Bytes of a body that is told of at once, beside others.
const MOST_SMALL_BYTES: u64 = 1 << 20;

/// Tells one entry, with its body as it came.
#[utoipa::path(get, path = "/v1/quarantine/{id}", tag = "quarantine", params(("id" = String, Path)),
    responses((status = 200, body = QuarantineDetail)))]
pub(super) async fn get(
    State(state): State<AppState>,
    PathId(id): PathId<String>,
) -> Result<Response, Problem> {
    // A body may be the largest there is, and whoever reads it may be slow. How large it is is looked up only where so many are held
    // that it matters.
    let turn = match state.exports.at_once() {
        Some(turn) => turn,
        None => {
            let size = entry(&state, &id).await?.0.size;
            state.exports.turn(if size > MOST_SMALL_BYTES { Size::Large } else { Size::Small }).await?
        }
    };
    let found = entry(&state, &id).await?;
    if found.0.size <= MOST_SMALL_BYTES {
        let turn = state.exports.suited(turn, Size::Small);
        return Ok(export::held(axum::Json(QuarantineDetail::from(found)).into_response(), turn));
    }
    // Off the threads that serve connections: it takes as long as hundreds of posts.
    let written = tokio::task::spawn_blocking(move || serde_json::to_vec(&QuarantineDetail::from(found)));
    let written = written.await.map_err(|error| Problem::internal(error.to_string()))?;
    let json = written.map_err(|error| Problem::internal(error.to_string()))?;
    Ok(export::held(([(header::CONTENT_TYPE, "application/json")], json).into_response(), turn))
}

async fn entry(state: &AppState, id: &str) -> Result<(QuarantineEntry, Option<Vec<u8>>), Problem> {
    let found = state.store.quarantine_entry(id).await?;
    found.ok_or_else(|| Problem::not_found("quarantine entry", id))
}

/// Settles an entry: discards it, or takes its body (repaired, where one is sent) in again.
///
/// An entry whose body is refused again stays, and the answer is the problem that its machine would get.
#[utoipa::path(post, path = "/v1/quarantine/{id}", tag = "quarantine", params(("id" = String, Path)),
    request_body = SettleBody, responses((status = 200, body = Settled)))]
pub(super) async fn settle(
    State(state): State<AppState>,
    caller: Caller,
    PathId(id): PathId<String>,
    Json(body): Json<SettleBody>,
) -> Result<axum::Json<Settled>, Problem> {
    body.check()?;
    let actor = caller.actor();
    let own = state.clone();
    // In a task of its own: a client that hangs up must not stop a commit half-way.
    let task = async move { settle_alone(&own, id, body, actor).await };
    state.lifecycle.spawn(task).await.map_err(|error| Problem::internal(error.to_string()))?.map(axum::Json)
}

/// So long an entry is that request's which settles it: longer than its cycle is prepared, and two commits are waited for.
const CLAIM: Duration = Duration::from_secs(180);

async fn settle_alone(
    state: &AppState,
    id: String,
    body: SettleBody,
    actor: Actor,
) -> Result<Settled, Problem> {
    // One at a time, at this server and at those that share its database: of two repairs of an entry that come together, both would be
    // stored, and one told that it was not.
    let _settling = state.intake.settling().await?;
    let found = entry(state, &id).await?;
    if found.0.settled.is_some() {
        return Err(already_settled());
    }
    // What is settled since then is claimed by nobody.
    let holder = uuid::Uuid::now_v7().to_string();
    let (own, claimed, now) = (holder.clone(), id.clone(), state.clock.now());
    let is_ours =
        state.commit(|store| async move { store.claim_quarantine(&claimed, &own, CLAIM, now).await }).await?;
    if !is_ours {
        return Err(settled_elsewhere());
    }
    let settled = settle_claimed(state, (&id, &holder), found, body, actor).await;
    // What is not known to have come to nothing may be committed yet: its claim ends by itself.
    if settled.as_ref().is_err_and(|problem| problem.status.is_client_error()) {
        let released =
            state.commit(|store| async move { store.release_quarantine(&id, &holder).await }).await;
        if let Err(error) = released {
            tracing::debug!(%error, "the claim on an entry could not be given up; it ends by itself");
        }
    }
    settled
}

async fn settle_claimed(
    state: &AppState,
    (id, holder): (&str, &str),
    (entry, kept): (QuarantineEntry, Option<Vec<u8>>),
    body: SettleBody,
    actor: Actor,
) -> Result<Settled, Problem> {
    let (how, answer) = match body.action {
        QuarantineAction::Discard => (format!("discarded: {}", body.reason), None),
        QuarantineAction::Reingest => {
            let repaired = if body.body.is_some() { "repaired and re-ingested" } else { "re-ingested" };
            let taken =
                body.body.map(Bytes::from).or_else(|| kept.map(Bytes::from)).ok_or_else(entry_damaged)?;
            let taken_in = state.intake.reingest(&entry, taken).await;
            // What is told of a body is of the cycle's, and not of this request's.
            let (cycle, answer) = taken_in.map_err(|problem| match problem.code {
                "malformed_json" | "malformed_cycle" => {
                    Problem { detail: format!("the cycle: {}", problem.detail).into(), ..problem }
                }
                _ => problem,
            })?;
            // A repair may be another cycle than the one that came: whoever reads the audit has to find it.
            let how = format!("{repaired} as cycle {} of tool {}: {}", cycle.id, cycle.tool, body.reason);
            (how, Some(answer))
        }
    };
    // A crash before this line leaves an entry open whose cycle is stored: settling it again finds it known.
    let (now, own) = (state.clock.now(), holder.to_owned());
    let (settled, told) = (id.to_owned(), how.clone());
    let settle = state
        .commit(|store| async move { store.settle_quarantine(&settled, &own, &told, &actor, now).await })
        .await?;
    // Where it took longer than its claim another may have settled the entry, or be at it.
    if settle { Ok(Settled { id: id.to_owned(), how, answer }) } else { Err(settled_elsewhere()) }
}

fn settled_elsewhere() -> Problem {
    let detail =
        "somebody else settles the entry, or has begun to and ended; ask again, and look at its cycle";
    Problem::unavailable("settling", detail, 5)
}

fn already_settled() -> Problem {
    Problem::new(StatusCode::CONFLICT, "already_settled", "the entry is settled")
}

//! The model library: entries registered, changed, listed.

use super::body::Json;
use super::cursor::{List, Paging};
use super::dto::library::{PlungeMaterialBody, TurningModelBody, plunge_entry, turning_entry};
use super::dto::plunge::PlungeMaterialChoice;
use super::dto::turning::TurningModelChoice;
use super::dto::{PageQuery, Registered};
use super::extract::{PathId, Query};
use super::precondition::{answer_put, answer_read, expected};
use super::problem::Problem;
use crate::auth::Caller;
use crate::state::AppState;
use axum::extract::State;
use axum::response::Response;
use feedwright_core::ids::ModelId;
use feedwright_core::invalid::Violation;
use feedwright_core::plunge::Material;
use feedwright_core::turning::TurningModel;
use feedwright_store::{Model, ModelContent, ModelKind, PutOutcome, Store, Versioned};
use http::HeaderMap;
use std::sync::Arc;

async fn put(
    state: &AppState,
    caller: &Caller,
    headers: &HeaderMap,
    model: Model,
) -> Result<(PutOutcome, Versioned<Model>), Problem> {
    let expects = expected(headers)?;
    let (kind, id) = (model.content.kind(), model.id.clone());
    let (actor, now) = (caller.actor(), state.clock.now());
    let put = |store: Arc<dyn Store>| async move { store.put_model(model, expects, &actor, now).await };
    let outcome = state.commit(put).await?;
    let stored = state.store.model(kind, &id).await?;
    Ok((outcome, stored.ok_or_else(|| Problem::internal("it was just put"))?))
}

async fn one(state: &AppState, kind: ModelKind, id: &ModelId) -> Result<Versioned<Model>, Problem> {
    let stored = state.store.model(kind, id).await?;
    stored.ok_or_else(|| Problem::not_found("entry", id.as_str()))
}

fn other_kind<T>(view: Option<T>) -> Result<T, Problem> {
    view.ok_or_else(|| Problem::internal("an entry is not of the kind it is kept under"))
}

/// 422: the entry that a body names does not exist.
fn unknown(path: &str, id: &str) -> Problem {
    Violation::new(path, "unknown_model", format!("the library holds no entry `{id}` of this kind")).into()
}

/// The coefficients that a body names; `path` is where it does.
pub(super) async fn turning_model(
    state: &AppState,
    path: &str,
    choice: TurningModelChoice,
) -> Result<TurningModel, Problem> {
    let id = match choice {
        TurningModelChoice::Entry(entry) => return Ok(entry.model(&format!("{path}.entry"))?),
        TurningModelChoice::Id(id) => ModelId::parse(&format!("{path}.id"), &id)?,
    };
    let stored = state.store.model(ModelKind::Turning, &id).await?.map(Versioned::sound).transpose()?;
    match stored.map(|stored| stored.value.content) {
        Some(ModelContent::Turning(model)) => Ok(model),
        _ => Err(unknown(&format!("{path}.id"), id.as_str())),
    }
}

/// The constants that a body names; `path` is where it does.
pub(super) async fn material(
    state: &AppState,
    path: &str,
    choice: PlungeMaterialChoice,
) -> Result<Material, Problem> {
    let id = match choice {
        PlungeMaterialChoice::Entry(entry) => return Ok(entry.material(&format!("{path}.entry"))?),
        PlungeMaterialChoice::Id(id) => ModelId::parse(&format!("{path}.id"), &id)?,
    };
    let stored = state.store.model(ModelKind::Plunge, &id).await?.map(Versioned::sound).transpose()?;
    match stored.map(|stored| stored.value.content) {
        Some(ModelContent::Plunge(material)) => Ok(material),
        _ => Err(unknown(&format!("{path}.id"), id.as_str())),
    }
}

/// Registers the coefficients of a tool–work–machine set, or changes them.
///
/// Repeating the same content changes nothing. Changing needs `If-Match` with the ETag of the last answer;
/// `If-None-Match: *` only registers.
#[utoipa::path(put, path = "/v1/models/turning/{model}", tag = "models",
    params(("model" = String, Path), ("If-Match" = Option<String>, Header), ("If-None-Match" = Option<String>, Header)),
    request_body = TurningModelBody,
    responses((status = 200, description = "Changed, or already so", body = Registered<TurningModelBody>),
        (status = 201, description = "Registered", body = Registered<TurningModelBody>)))]
pub(super) async fn put_turning(
    State(state): State<AppState>,
    caller: Caller,
    PathId(id): PathId<ModelId>,
    headers: HeaderMap,
    Json(body): Json<TurningModelBody>,
) -> Result<Response, Problem> {
    let (outcome, stored) = put(&state, &caller, &headers, body.into_model(id.clone())?).await?;
    Ok(answer_put(outcome, &format!("/v1/models/turning/{id}"), &other_kind(turning_entry(&stored))?))
}

/// Tells the coefficients of one set, with the ranges they hold in.
#[utoipa::path(get, path = "/v1/models/turning/{model}", tag = "models",
    params(("model" = String, Path), ("If-None-Match" = Option<String>, Header)),
    responses((status = 200, body = Registered<TurningModelBody>), (status = 304, description = "As the ETag says")))]
pub(super) async fn get_turning(
    State(state): State<AppState>,
    PathId(id): PathId<ModelId>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let stored = one(&state, ModelKind::Turning, &id).await?;
    Ok(answer_read(&headers, stored.version, &other_kind(turning_entry(&stored))?))
}

/// Lists turning models by id.
#[utoipa::path(get, path = "/v1/models/turning", tag = "models", params(PageQuery),
    responses((status = 200, body = List<Registered<TurningModelBody>>)))]
pub(super) async fn list_turning(
    State(state): State<AppState>,
    Query(query): Query<PageQuery>,
) -> Result<axum::Json<List<Registered<TurningModelBody>>>, Problem> {
    let paging = Paging::new(&state, "models/turning", query.limit, query.cursor.as_deref())?;
    let rows = state.store.models(ModelKind::Turning, paging.page()).await?;
    let List { items, next_cursor } =
        paging.list(rows, |row| row.value.id.clone(), |row| turning_entry(&row));
    Ok(axum::Json(List { items: items.into_iter().flatten().collect(), next_cursor }))
}

/// Registers the constants of a work material for plunging, or changes them.
///
/// Repeating the same content changes nothing. Changing needs `If-Match` with the ETag of the last answer;
/// `If-None-Match: *` only registers.
#[utoipa::path(put, path = "/v1/models/plunge/{model}", tag = "models",
    params(("model" = String, Path), ("If-Match" = Option<String>, Header), ("If-None-Match" = Option<String>, Header)),
    request_body = PlungeMaterialBody,
    responses((status = 200, description = "Changed, or already so", body = Registered<PlungeMaterialBody>),
        (status = 201, description = "Registered", body = Registered<PlungeMaterialBody>)))]
pub(super) async fn put_plunge(
    State(state): State<AppState>,
    caller: Caller,
    PathId(id): PathId<ModelId>,
    headers: HeaderMap,
    Json(body): Json<PlungeMaterialBody>,
) -> Result<Response, Problem> {
    let (outcome, stored) = put(&state, &caller, &headers, body.into_model(id.clone())?).await?;
    Ok(answer_put(outcome, &format!("/v1/models/plunge/{id}"), &other_kind(plunge_entry(&stored))?))
}

/// Tells the constants of one work material.
#[utoipa::path(get, path = "/v1/models/plunge/{model}", tag = "models",
    params(("model" = String, Path), ("If-None-Match" = Option<String>, Header)),
    responses((status = 200, body = Registered<PlungeMaterialBody>), (status = 304, description = "As the ETag says")))]
pub(super) async fn get_plunge(
    State(state): State<AppState>,
    PathId(id): PathId<ModelId>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let stored = one(&state, ModelKind::Plunge, &id).await?;
    Ok(answer_read(&headers, stored.version, &other_kind(plunge_entry(&stored))?))
}

/// Lists plunge materials by id.
#[utoipa::path(get, path = "/v1/models/plunge", tag = "models", params(PageQuery),
    responses((status = 200, body = List<Registered<PlungeMaterialBody>>)))]
pub(super) async fn list_plunge(
    State(state): State<AppState>,
    Query(query): Query<PageQuery>,
) -> Result<axum::Json<List<Registered<PlungeMaterialBody>>>, Problem> {
    let paging = Paging::new(&state, "models/plunge", query.limit, query.cursor.as_deref())?;
    let rows = state.store.models(ModelKind::Plunge, paging.page()).await?;
    let List { items, next_cursor } = paging.list(rows, |row| row.value.id.clone(), |row| plunge_entry(&row));
    Ok(axum::Json(List { items: items.into_iter().flatten().collect(), next_cursor }))
}

//! Tokens: made, listed, revoked.

use super::body::Json;
use super::cursor::{List, Paging};
use super::dto::PageQuery;
use super::dto::token::{NewToken, TokenBody, TokenRequest, TokenView};
use super::extract::{PathId, Query};
use super::problem::Problem;
use crate::auth::{Caller, Issued};
use crate::state::AppState;
use axum::extract::State;
use feedwright_core::invalid::Violation;
use http::StatusCode;
use secrecy::ExposeSecret;

/// Makes a token. The answer is the only place where it ever stands.
#[utoipa::path(post, path = "/v1/tokens", tag = "tokens", request_body = TokenBody,
    responses((status = 201, body = NewToken)))]
pub(super) async fn create(
    State(state): State<AppState>,
    caller: Caller,
    Json(body): Json<TokenBody>,
) -> Result<(StatusCode, axum::Json<NewToken>), Problem> {
    let TokenRequest { name, role, machine } = body.try_into()?;
    if let Some(machine) = &machine
        && state.store.machine(machine).await?.is_none()
    {
        return Err(Violation::new("machine", "unknown_machine", "register the machine first").into());
    }
    let issued = Issued::new(&name, role, machine, &state.clock);
    let Issued { record, text } = issued.map_err(|error| Problem::internal(error.to_string()))?;
    let (actor, kept) = (caller.actor(), TokenView::from(record.clone()));
    state.commit(|store| async move { store.create_token(record, &actor).await }).await?;
    Ok((StatusCode::CREATED, axum::Json(NewToken { token: text.expose_secret().to_owned(), kept })))
}

/// Lists tokens by id, revoked ones too; never their secrets.
#[utoipa::path(get, path = "/v1/tokens", tag = "tokens", params(PageQuery),
    responses((status = 200, body = List<TokenView>)))]
pub(super) async fn list(
    State(state): State<AppState>,
    Query(query): Query<PageQuery>,
) -> Result<axum::Json<List<TokenView>>, Problem> {
    let paging = Paging::new(&state, "tokens", query.limit, query.cursor.as_deref())?;
    let rows = state.store.tokens(paging.page()).await?;
    Ok(axum::Json(paging.list(rows, |row| row.id.clone(), TokenView::from)))
}

/// Revokes a token: its next request is refused.
#[utoipa::path(delete, path = "/v1/tokens/{id}", tag = "tokens", params(("id" = String, Path)),
    responses((status = 200, body = TokenView)))]
pub(super) async fn revoke(
    State(state): State<AppState>,
    caller: Caller,
    PathId(id): PathId<String>,
) -> Result<axum::Json<TokenView>, Problem> {
    let (actor, now) = (caller.actor(), state.clock.now());
    let (wanted, here) = (id.clone(), state.clone());
    let revoked = state.commit(|store| async move {
        let revoked = store.revoke_token(&wanted, &actor, now).await;
        // Here, as whoever asked may have hung up; and whatever the outcome: where it is not known, the token may be revoked.
        here.known_tokens.revoked(&wanted);
        here.live.look_at_sessions();
        revoked
    });
    let revoked = revoked.await?;
    revoked.map(|token| axum::Json(token.into())).ok_or_else(|| Problem::not_found("token", &id))
}

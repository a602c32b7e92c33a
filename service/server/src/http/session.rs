//! Sessions: begun by a browser with a token, asked for what they may do, ended.

use super::body::Json;
use super::dto::session::{SessionBody, SessionView};
use super::problem::{Problem, ProblemDocument};
use super::routes::allowed;
use crate::auth::{
    BegunSession, Caller, MOST_SESSIONS, Peer, authenticate_token, forgotten, from_own_page, over_tls,
};
use crate::state::AppState;
use axum::Extension;
use axum::extract::State;
use axum::response::{AppendHeaders, IntoResponse, Response};
use feedwright_store::{Actor, Role};
use http::{HeaderMap, Method, StatusCode, header};

/// Begins a session for a browser: the answer sets a cookie that scripts cannot read.
///
/// Only for pages of this service; programs send their token with every request instead.
#[utoipa::path(post, path = "/v1/session", tag = "session", request_body = SessionBody,
    params(("x-feedwright-page" = String, Header,
        description = "Any value: a page of another site cannot send it without a preflight, which is never granted")),
    responses(
        (status = 201, description = "Who this is and what it may do", body = SessionView),
        (status = 401, description = "The token is not known, or was revoked", body = ProblemDocument<'static>),
        (status = 403, description = "A machine's token, or a request from another site",
            body = ProblemDocument<'static>),
        (status = 429, description = "Too many tokens from this address were refused",
            body = ProblemDocument<'static>),
    ))]
pub(super) async fn begin(
    State(state): State<AppState>,
    peer: Option<Extension<Peer>>,
    headers: HeaderMap,
    Json(body): Json<SessionBody>,
) -> Result<Response, Problem> {
    from_own_page(&Method::POST, &headers)?;
    let peer = peer.map(|Extension(peer)| peer.0.ip());
    let token = authenticate_token(&state, body.token.trim(), peer).await?;
    if token.role == Role::Machine {
        let detail =
            "this is a machine's token: it posts cycles; sign in with a token made for a person or a screen";
        return Err(Problem::new(StatusCode::FORBIDDEN, "role_not_allowed", detail));
    }
    let BegunSession { record, cookie } =
        BegunSession::new(&token, body.lasting, (is_secure(&state, &headers), &headers), &state.clock)?;
    let actor = Actor { token: token.id.clone(), role: token.role };
    let expires_at = record.expires_at;
    state.commit(|store| async move { store.begin_session(record, MOST_SESSIONS, &actor).await }).await?;
    let view = SessionView::new(&token.id, &token.name, token.role, Some(expires_at), allowed(token.role));
    Ok((StatusCode::CREATED, AppendHeaders([(header::SET_COOKIE, cookie)]), axum::Json(view)).into_response())
}

/// Says who asks and which routes it may use, with a cookie or with a token.
#[utoipa::path(get, path = "/v1/session", tag = "session", responses((status = 200, body = SessionView)))]
pub(super) async fn get(caller: Caller) -> axum::Json<SessionView> {
    let expires_at = caller.session().map(|session| session.expires_at);
    let actor = caller.actor();
    axum::Json(SessionView::new(
        &actor.token,
        caller.name(),
        caller.role(),
        expires_at,
        allowed(caller.role()),
    ))
}

/// Ends the session of the cookie.
#[utoipa::path(delete, path = "/v1/session", tag = "session",
    responses(
        (status = 204, description = "It is over; the browser forgets its cookie"),
        (status = 400, description = "The request came with a token, not with a session",
            body = ProblemDocument<'static>),
    ))]
pub(super) async fn end(
    State(state): State<AppState>,
    caller: Caller,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let Some(session) = caller.session() else {
        return Err(Problem::bad_request("no_session", "the request came with a token, not with a session"));
    };
    let (actor, now) = (caller.actor(), state.clock.now());
    let ended =
        state.commit(|store| async move { store.end_session(&session.hash, &actor, now).await }).await;
    // Whatever the outcome: where it is not known, the session may be over.
    state.live.look_at_sessions();
    ended?;
    let cookie = forgotten(is_secure(&state, &headers), &headers)?;
    Ok((StatusCode::NO_CONTENT, AppendHeaders([(header::SET_COOKIE, cookie)])).into_response())
}

/// Whether the page was reached over TLS: this server speaks nothing else, or the browser says so where a proxy does.
fn is_secure(state: &AppState, headers: &HeaderMap) -> bool {
    state.config.tls.is_on() || over_tls(headers)
}

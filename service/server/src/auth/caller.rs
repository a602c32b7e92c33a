//! The caller of a route: found by token, held against the route's roles.

use super::session::{self, Session};
use super::token::Token;
use crate::http::once::{Repeated, once};
use crate::http::problem::Problem;
use crate::http::routes::Access;
use crate::state::AppState;
use axum::extract::{FromRequestParts, RawPathParams, Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use feedwright_core::ids::MachineId;
use feedwright_store::{Actor, Role, StoreError, StoreResult, TokenRecord};
use http::request::Parts;
use http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use std::net::{IpAddr, SocketAddr};
use std::time::{Duration, Instant};
use subtle::ConstantTimeEq;

/// How long `/metrics` waits for the look-up of a token that was good lately: Prometheus gives up after ten seconds.
const OUTAGE_PATIENCE: Duration = Duration::from_secs(1);
/// How long the database has for saying whose a token is.
const PATIENCE: Duration = Duration::from_secs(5);

/// Whom a route believes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Trust {
    /// Tokens that the database knows now.
    Known,
    /// While the database cannot be asked, also those that it knew lately: who watches the service is told that it fails.
    Lately,
}

/// Who calls. Only [`authorise`] makes one, so a handler that can name the caller has been authorised.
#[derive(Debug, Clone)]
pub struct Caller {
    token: String,
    name: String,
    role: Role,
    machine: Option<MachineId>,
    hash: [u8; 32],
    session: Option<Session>,
}

impl Caller {
    pub(super) fn new(token: TokenRecord, session: Option<Session>) -> Self {
        let TokenRecord { id, name, role, machine, hash, .. } = token;
        Self { token: id, name, role, machine, hash, session }
    }

    /// Returns once its token is revoked: what is open for long looks again every so often.
    ///
    /// A database that does not answer revokes nothing.
    async fn revoked(&self, state: &AppState, every: Duration) {
        loop {
            tokio::time::sleep(every).await;
            match known_token(state, &self.hash).await {
                Ok(Some(TokenRecord { revoked_at: None, .. })) => {}
                Ok(_) => return,
                Err(error) => tracing::debug!(%error, "whether a token is still good is not known"),
            }
        }
    }

    /// Returns once it may do nothing any more: its token is revoked, or its session is over by time, by sign-out or with its
    /// token.
    pub(crate) async fn over(&self, state: &AppState, every: Duration) {
        let Some(session) = self.session else {
            return self.revoked(state, every).await;
        };
        loop {
            let moved = state.live.sessions_moved();
            match state.store.session_by_hash(&session.hash).await {
                Ok(Some((_, token))) if token.revoked_at.is_none() => {}
                Ok(_) => return,
                // A store that does not answer has ended nothing: looked at again.
                Err(error) => tracing::debug!(%error, "cannot look at a session"),
            }
            let left_ms = session.expires_at.millis_since(state.clock.now());
            if left_ms <= 0 {
                return;
            }
            // A session that another server ended is noticed within that time.
            let wait = Duration::from_millis(left_ms.unsigned_abs()).min(every);
            tokio::select! {
                () = tokio::time::sleep(wait) => {}
                () = moved => {}
            }
        }
    }

    /// What people call its token.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The session it came with, where that is a browser's.
    pub const fn session(&self) -> Option<Session> {
        self.session
    }

    /// Who is written into the audit.
    pub fn actor(&self) -> Actor {
        Actor { token: self.token.clone(), role: self.role }
    }

    /// The role it acts in.
    pub const fn role(&self) -> Role {
        self.role
    }

    /// The one machine it is bound to.
    pub const fn machine(&self) -> Option<&MachineId> {
        self.machine.as_ref()
    }

    /// Refuses a machine's token that is not `machine`'s own. [`authorise`] has done so already for a `{machine}` in
    /// the path; a handler does it for a machine that is named in the query or the body.
    pub fn must_be_for(&self, machine: &str) -> Result<(), Problem> {
        let own = match (self.role, &self.machine) {
            (Role::Machine, Some(own)) => own.as_str() == machine,
            (Role::Machine, None) => false,
            _ => true,
        };
        if own {
            return Ok(());
        }
        Err(Problem::new(StatusCode::FORBIDDEN, "other_machine", "the token is bound to another machine"))
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Caller {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        let caller = parts.extensions.get::<Self>().cloned();
        caller.ok_or_else(|| Problem::internal("a handler asks for the caller of an open route"))
    }
}

/// Runs before every handler: lets pass who may use the route, and nobody else.
pub(crate) async fn authorise(
    State((state, access, trust)): State<(AppState, Access, Trust)>,
    params: RawPathParams,
    mut request: Request,
    next: Next,
) -> Response {
    let Access::Roles(roles) = access else {
        return next.run(request).await;
    };
    let peer = request.extensions().get::<Peer>().map(|peer| peer.0.ip());
    let caller = match authenticate((&state, trust), request.method(), request.headers(), peer).await {
        Ok(caller) => caller,
        Err(problem) => {
            const TOLD: [StatusCode; 3] =
                [StatusCode::BAD_REQUEST, StatusCode::UNAUTHORIZED, StatusCode::TOO_MANY_REQUESTS];
            if TOLD.contains(&problem.status) {
                state.metrics.refused_token(problem.code);
            }
            return problem.into_response();
        }
    };
    if !roles.contains(&caller.role) {
        let detail = format!("the role {} may not do this", caller.role.as_str());
        return Problem::new(StatusCode::FORBIDDEN, "role_not_allowed", detail).into_response();
    }
    if let Some((_, machine)) = params.iter().find(|(name, _)| *name == "machine")
        && let Err(problem) = caller.must_be_for(machine)
    {
        return problem.into_response();
    }
    tracing::Span::current().record("token", caller.token.as_str());
    request.extensions_mut().insert(caller);
    next.run(request).await
}

/// The address at the other end of the connection.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Peer(pub(crate) SocketAddr);

async fn authenticate(
    (state, trust): (&AppState, Trust),
    method: &Method,
    headers: &HeaderMap,
    peer: Option<IpAddr>,
) -> Result<Caller, Problem> {
    let Some(presented) = once(headers, header::AUTHORIZATION).map_err(|Repeated| several_tokens())? else {
        if let Some(caller) = session::caller(state, method, headers).await? {
            return Ok(caller);
        }
        // Not an attempt to guess: not counted.
        return Err(challenge("token_missing", "send `Authorization: Bearer <token>`", false));
    };
    let text = presented.to_str().ok().and_then(|text| text.split_once(' '));
    let token =
        text.filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer")).map(|(_, token)| token.trim());
    let record = authenticate_trusting((state, trust), token.unwrap_or_default(), peer).await?;
    Ok(Caller::new(record, None))
}

/// The record of a token that is known and not revoked; failures are counted by address.
pub(crate) async fn authenticate_token(
    state: &AppState,
    text: &str,
    peer: Option<IpAddr>,
) -> Result<TokenRecord, Problem> {
    authenticate_trusting((state, Trust::Known), text, peer).await
}

async fn authenticate_trusting(
    (state, trust): (&AppState, Trust),
    text: &str,
    peer: Option<IpAddr>,
) -> Result<TokenRecord, Problem> {
    let Some(token) = Token::parse(text) else {
        return Err(failed(state, peer, "token_malformed", "this is no token of this service"));
    };
    let hash = token.hash();
    let record = match trust {
        Trust::Known => asked_token(state, &hash, PATIENCE).await?,
        Trust::Lately => lately_known_token(state, &hash).await?,
    };
    let record = record.filter(|known| known.id == token.id());
    match record {
        None => Err(failed(state, peer, "token_unknown", "the token is not known")),
        Some(TokenRecord { revoked_at: Some(_), .. }) => {
            Err(failed(state, peer, "token_revoked", "the token was revoked"))
        }
        Some(record) => Ok(record),
    }
}

/// The record of the token with that hash, revoked or not, as it was a moment ago.
async fn known_token(state: &AppState, hash: &[u8; 32]) -> StoreResult<Option<TokenRecord>> {
    let began = match state.known_tokens.get(hash, Instant::now()) {
        Ok(record) => return Ok(Some(record)),
        Err(began) => began,
    };
    // From before it is read: its life counts from what was true then.
    let looked_up = Instant::now();
    let record = state.store.token_by_hash(hash).await?.filter(|known| bool::from(known.hash.ct_eq(hash)));
    match &record {
        Some(record) if record.revoked_at.is_none() => state.known_tokens.keep(record, began, looked_up),
        _ => state.known_tokens.refuse(hash),
    }
    Ok(record)
}

/// The same, within so long where the database has to be asked.
async fn asked_token(
    state: &AppState,
    hash: &[u8; 32],
    patience: Duration,
) -> StoreResult<Option<TokenRecord>> {
    if let Ok(record) = state.known_tokens.get(hash, Instant::now()) {
        return Ok(Some(record));
    }
    // A task of its own: what asks the database is never cut off.
    let (asking, asked) = (state.clone(), *hash);
    let asked = tokio::spawn(async move { known_token(&asking, &asked).await });
    match tokio::time::timeout(patience, asked).await {
        Ok(Ok(answer)) => answer,
        Ok(Err(lost)) => Err(StoreError::Unavailable(Box::new(lost))),
        Err(late) => Err(StoreError::Unavailable(Box::new(late))),
    }
}

/// The same; where the database cannot be asked, a token that was good lately.
async fn lately_known_token(state: &AppState, hash: &[u8; 32]) -> StoreResult<Option<TokenRecord>> {
    if state.known_tokens.lately(hash, Instant::now()).is_none() {
        return asked_token(state, hash, PATIENCE).await;
    }
    let error = match asked_token(state, hash, OUTAGE_PATIENCE).await {
        Err(error @ StoreError::Unavailable(_)) => error,
        Err(error) if error.of_the_disk().is_some() => error,
        answer => return answer,
    };
    // Once more: it may have been revoked meanwhile.
    match state.known_tokens.lately(hash, Instant::now()) {
        Some(record) => Ok(Some(record)),
        None => Err(error),
    }
}

/// Counts a failure: 401, or 429 where the address had too many.
fn failed(state: &AppState, peer: Option<IpAddr>, code: &'static str, detail: &'static str) -> Problem {
    match state.failed_authentications.count(peer) {
        None => challenge(code, detail, true),
        Some(wait) => Problem::new(
            StatusCode::TOO_MANY_REQUESTS,
            "too_many_failed_authentications",
            "too many tokens from this address were refused",
        )
        .retry_after(wait),
    }
}

/// 400: not counted as an attempt, as no token of it was looked at.
fn several_tokens() -> Problem {
    // RFC 6750, section 3.1.
    let value = HeaderValue::from_static("Bearer realm=\"feedwright\", error=\"invalid_request\"");
    Problem::bad_request("token_malformed", "there is more than one header Authorization")
        .header(header::WWW_AUTHENTICATE, value)
}

pub(super) fn challenge(code: &'static str, detail: &'static str, presented: bool) -> Problem {
    let value = match presented {
        false => HeaderValue::from_static("Bearer realm=\"feedwright\""),
        true => HeaderValue::from_static("Bearer realm=\"feedwright\", error=\"invalid_token\""),
    };
    Problem::new(StatusCode::UNAUTHORIZED, code, detail).header(header::WWW_AUTHENTICATE, value)
}

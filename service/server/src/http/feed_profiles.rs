//! Feed profiles: drafted, compared, moved along their way, handed out.

use super::body::Json;
use super::cursor::{List, Paging};
use super::dto::PageQuery;
use super::dto::feed_profile::{
    DiffBody, DiffQuery, DraftBody, DraftedBody, FeedProfileBody, FeedProfilesQuery, ProfileBody,
    ProfileVersionBody, StepBody, profile_id, reason,
};
use super::extract::{PathId, Query, query_id, query_name};
use super::precondition::{answer_read, etag, expected};
use super::problem::{Problem, ProblemDocument};
use super::profile_optimise::proposed;
use crate::auth::Caller;
use crate::state::AppState;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use feedwright_core::feed::choose::{self, SAME_DEPTH_MM};
use feedwright_core::feed::life_cycle::Step;
use feedwright_core::feed::profile::{Profile, diff};
use feedwright_core::ids::ProfileId;
use feedwright_core::invalid::Violation;
use feedwright_core::units::Process;
use feedwright_store::{
    FeedProfile, FeedProfileFilter, NewProfileVersion, ProfileMove, ProfileSource, StoredProfileVersion,
};
use http::{HeaderMap, StatusCode, header};

/// Drafts a version: the first of a new feed profile, or the next of one for the same operation, tool type and wear
/// band. Nothing uses a draft. The same content is kept once and answered with 200.
#[utoipa::path(post, path = "/v1/feed-profiles", tag = "feed profiles", request_body = DraftBody,
    responses((status = 201, description = "Drafted", body = DraftedBody),
        (status = 200, description = "This content is a version already", body = DraftedBody),
        (status = 409, description = "The name or the subject belongs to another feed profile", body = ProblemDocument<'static>),
        (status = 422, description = "A content that is no profile", body = ProblemDocument<'static>)))]
pub(super) async fn draft(
    State(state): State<AppState>,
    caller: Caller,
    Json(body): Json<DraftBody>,
) -> Result<Response, Problem> {
    if body.band.is_some() && body.job.is_none() {
        return Err(Violation::new("band", "one_of", "names a band of a job: give the job too").into());
    }
    let (content, source, report) = match (&body.content, &body.job) {
        (Some(content), None) => (checked(&state, "content", content).await?, ProfileSource::Drawn, None),
        (None, Some(job)) => {
            let (content, report) = proposed(&state, job, body.band)?;
            (checked(&state, "content", &content).await?, ProfileSource::Optimised, Some(report))
        }
        _ => return Err(Violation::new("content", "one_of", "give either content or job").into()),
    };
    let draft = Draft { profile: &body.profile, reason: &body.reason, based_on: body.based_on };
    keep(&state, &caller, draft, content, (source, report)).await
}

/// What every way of drafting says of it.
pub(super) struct Draft<'a> {
    pub(super) profile: &'a str,
    pub(super) reason: &'a str,
    pub(super) based_on: Option<u32>,
}

/// Keeps a draft and answers it.
pub(super) async fn keep(
    state: &AppState,
    caller: &Caller,
    draft: Draft<'_>,
    content: Profile,
    (source, report): (ProfileSource, Option<String>),
) -> Result<Response, Problem> {
    let mut wrong = Vec::new();
    let reason = reason(draft.reason, &mut wrong);
    let id = match profile_id("profile", draft.profile) {
        Ok(id) if wrong.is_empty() => id,
        Ok(_) => return Err(wrong.into()),
        Err(bad) => {
            wrong.push(bad);
            return Err(wrong.into());
        }
    };
    let new = NewProfileVersion { content, source, based_on: draft.based_on, reason, report };
    let (actor, now, line) = (caller.actor(), state.clock.now(), id.clone());
    let drafted =
        state.commit(|store| async move { store.draft_profile(&line, new, &actor, now).await }).await?;
    let (line, stored) = (line_of(state, &id).await?, version_of(state, &id, drafted.version).await?);
    let revision = line.revision;
    let view = DraftedBody { revision, version: stored.into() };
    let status = if drafted.is_new { StatusCode::CREATED } else { StatusCode::OK };
    let place = format!("/v1/feed-profiles/{id}/versions/{}", drafted.version);
    let place = http::HeaderValue::try_from(place).map_err(|error| Problem::internal(error.to_string()))?;
    Ok((status, [(header::ETAG, etag(revision)), (header::LOCATION, place)], axum::Json(view))
        .into_response())
}

/// The checked content: for an operation that is registered, drilled in depth, and as deep as it says.
pub(super) async fn checked(state: &AppState, at: &str, content: &ProfileBody) -> Result<Profile, Problem> {
    let id = content.operation(at)?;
    let operation = state.store.operation(&id).await?.ok_or_else(|| {
        let why = format!("the operation `{id}` is not registered: register it first");
        Violation::new(format!("{at}.operation"), "operation_unregistered", why)
    })?;
    let operation = operation.sound()?.value;
    if matches!(operation.process, Process::Turning | Process::Milling) {
        let why = "only operations that go into depth have a feed over depth";
        return Err(Violation::new(format!("{at}.operation"), "other_process", why).into());
    }
    let profile = content.profile(at, &operation)?;
    if let Some(depth) = operation.depth_mm
        && (depth - profile.end_depth_mm()).abs() > SAME_DEPTH_MM
    {
        let path = format!("{at}.knots[{}].depth_mm", content.knots.len().saturating_sub(1));
        let why = format!("the operation is {depth} mm deep: the last knot must be there");
        return Err(Violation::new(path, "not_covered", why).into());
    }
    Ok(profile)
}

pub(super) async fn line_of(state: &AppState, id: &ProfileId) -> Result<FeedProfile, Problem> {
    let found = state.store.feed_profile(id).await?;
    found.ok_or_else(|| Problem::not_found("feed profile", id.as_str()))
}

pub(super) async fn version_of(
    state: &AppState,
    id: &ProfileId,
    version: u32,
) -> Result<StoredProfileVersion, Problem> {
    state.store.profile_version(id, version).await?.ok_or_else(|| no_version(version))
}

fn no_version(version: u32) -> Problem {
    Problem::not_found("version of the feed profile", &version.to_string())
}

/// Refuses a version that was made for another operation than the one that is registered now.
pub(super) async fn must_fit(state: &AppState, stored: &StoredProfileVersion) -> Result<(), Problem> {
    let Some(operation) = state.store.operation(stored.content.operation()).await? else { return Ok(()) };
    choose::fits(&stored.version, &stored.content, &operation.sound()?.value)
        .map_err(|(code, why)| Problem::new(StatusCode::CONFLICT, code, why))
}

/// Lists feed profiles by id.
#[utoipa::path(get, path = "/v1/feed-profiles", tag = "feed profiles", params(FeedProfilesQuery),
    responses((status = 200, body = List<FeedProfileBody>)))]
pub(super) async fn list(
    State(state): State<AppState>,
    Query(query): Query<FeedProfilesQuery>,
) -> Result<axum::Json<List<FeedProfileBody>>, Problem> {
    let filter = FeedProfileFilter {
        operation: query_id(query.operation.as_deref())?,
        tool_type: query_name("tool_type", query.tool_type)?,
    };
    let scope = format!("feed-profiles {filter:?}");
    let paging = Paging::new(&state, &scope, query.limit, query.cursor.as_deref())?;
    let rows = state.store.feed_profiles(&filter, paging.page()).await?;
    Ok(axum::Json(paging.list(rows, |row| row.id.clone(), FeedProfileBody::from)))
}

/// Tells one feed profile; its ETag is what every step names.
#[utoipa::path(get, path = "/v1/feed-profiles/{profile}", tag = "feed profiles",
    params(("profile" = String, Path), ("If-None-Match" = Option<String>, Header)),
    responses((status = 200, body = FeedProfileBody), (status = 304, description = "As the ETag says")))]
pub(super) async fn get(
    State(state): State<AppState>,
    PathId(id): PathId<ProfileId>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let line = line_of(&state, &id).await?;
    Ok(answer_read(&headers, line.revision, &FeedProfileBody::from(line)))
}

/// Lists the versions of a feed profile, oldest first.
#[utoipa::path(get, path = "/v1/feed-profiles/{profile}/versions", tag = "feed profiles",
    params(("profile" = String, Path), PageQuery), responses((status = 200, body = List<ProfileVersionBody>)))]
pub(super) async fn versions(
    State(state): State<AppState>,
    PathId(id): PathId<ProfileId>,
    Query(query): Query<PageQuery>,
) -> Result<axum::Json<List<ProfileVersionBody>>, Problem> {
    line_of(&state, &id).await?;
    let scope = format!("feed-profile-versions {id}");
    let paging = Paging::new(&state, &scope, query.limit, query.cursor.as_deref())?;
    let rows = state.store.profile_versions(&id, paging.page()).await?;
    Ok(axum::Json(paging.list(rows, |row| row.version.version, ProfileVersionBody::from)))
}

/// Tells one version with its content.
#[utoipa::path(get, path = "/v1/feed-profiles/{profile}/versions/{version}", tag = "feed profiles",
    params(("profile" = String, Path), ("version" = u32, Path, minimum = 1)),
    responses((status = 200, body = ProfileVersionBody)))]
pub(super) async fn version(
    State(state): State<AppState>,
    PathId(id): PathId<ProfileId>,
    PathId(version): PathId<u32>,
) -> Result<axum::Json<ProfileVersionBody>, Problem> {
    Ok(axum::Json(version_of(&state, &id, version).await?.into()))
}

/// Tells what differs between two versions: settings, knots, and the time of each section.
#[utoipa::path(get, path = "/v1/feed-profiles/{profile}/diff", tag = "feed profiles",
    params(("profile" = String, Path), DiffQuery), responses((status = 200, body = DiffBody)))]
pub(super) async fn compare(
    State(state): State<AppState>,
    PathId(id): PathId<ProfileId>,
    Query(query): Query<DiffQuery>,
) -> Result<axum::Json<DiffBody>, Problem> {
    let line = line_of(&state, &id).await?;
    let to = query.to.unwrap_or(line.newest);
    let from = query.from.or(line.active).ok_or_else(|| {
        Problem::invalid_query(Violation::new(
            "from",
            "missing_field",
            "no version is active: name the earlier one",
        ))
    })?;
    let (before, after) = (version_of(&state, &id, from).await?, version_of(&state, &id, to).await?);
    Ok(axum::Json(DiffBody::new(from, to, diff(&before.content, &after.content))))
}

async fn advance(
    state: &AppState,
    caller: &Caller,
    id: ProfileId,
    headers: &HeaderMap,
    what: ProfileMove,
) -> Result<Response, Problem> {
    let expects = expected(headers)?;
    let (actor, now, line) = (caller.actor(), state.clock.now(), id.clone());
    let moved = state
        .commit(|store| async move { store.move_profile(&line, what, expects, &actor, now).await })
        .await?;
    let line = match (moved, what) {
        (Some(line), _) => line,
        (None, ProfileMove::Step(_, version)) => {
            line_of(state, &id).await?;
            return Err(no_version(version));
        }
        (None, ProfileMove::Rollback) => return Err(Problem::not_found("feed profile", id.as_str())),
    };
    Ok(([(header::ETAG, etag(line.revision))], axum::Json(FeedProfileBody::from(line))).into_response())
}

macro_rules! steps {
    ($($(#[$doc:meta])* $name:ident, $step:expr, $path:literal;)*) => {$(
        $(#[$doc])*
        #[utoipa::path(post, path = $path, tag = "feed profiles",
            params(("profile" = String, Path), ("If-Match" = String, Header, description = "The feed profile's ETag")),
            request_body = StepBody,
            responses((status = 200, description = "It stands there now", body = FeedProfileBody),
                (status = 409, description = "Not from where it stands (`wrong_state`), one's own draft (`own_draft`), or \
                    made for another operation than it is now (`profile_other_depth` and the like)",
                    body = ProblemDocument<'static>),
                (status = 412, description = "Somebody changed the feed profile in between", body = ProblemDocument<'static>),
                (status = 428, description = "No If-Match", body = ProblemDocument<'static>)))]
        pub(super) async fn $name(
            State(state): State<AppState>,
            caller: Caller,
            PathId(id): PathId<ProfileId>,
            headers: HeaderMap,
            Json(body): Json<StepBody>,
        ) -> Result<Response, Problem> {
            if $step == Step::Activate {
                expected(&headers)?;
                let stored = version_of(&state, &id, body.version).await?;
                if stored.state.is_released() {
                    must_fit(&state, &stored).await?;
                }
            }
            advance(&state, &caller, id, &headers, ProfileMove::Step($step, body.version)).await
        }
    )*};
}

steps! {
    /// Puts a draft into shadow: computed against real cycles, never handed out.
    shadow, Step::Shadow, "/v1/feed-profiles/{profile}/shadow";
    /// Approves a version in shadow; whoever drafted it may not.
    approve, Step::Approve, "/v1/feed-profiles/{profile}/approve";
    /// Hands an approved version out from now on, in place of the one that was.
    activate, Step::Activate, "/v1/feed-profiles/{profile}/activate";
}

/// Back to the version that was active before, in one call; to none where there was nothing before.
#[utoipa::path(post, path = "/v1/feed-profiles/{profile}/rollback", tag = "feed profiles",
    params(("profile" = String, Path), ("If-Match" = String, Header, description = "The feed profile's ETag")),
    responses((status = 200, description = "Rolled back", body = FeedProfileBody),
        (status = 409, description = "Nothing is active", body = ProblemDocument<'static>),
        (status = 412, description = "Somebody changed the feed profile in between", body = ProblemDocument<'static>),
        (status = 428, description = "No If-Match", body = ProblemDocument<'static>)))]
pub(super) async fn rollback(
    State(state): State<AppState>,
    caller: Caller,
    PathId(id): PathId<ProfileId>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    advance(&state, &caller, id, &headers, ProfileMove::Rollback).await
}

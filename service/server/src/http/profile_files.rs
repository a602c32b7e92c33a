//! Feed profiles as files: written for a control, read back, and read from what a shop has now.

use super::body::Json;
use super::dto::feed_profile::{DraftedBody, KnotBody, ProfileBody};
use super::dto::profile_file::{ExportQuery, ImportBody, ImportReport, ReadAnswer, ReadBody};
use super::dto::profile_json;
use super::extract::{PathId, Query, query_id};
use super::feed_profiles::{Draft, checked, keep, line_of, must_fit, version_of};
use super::problem::{Problem, ProblemDocument};
use crate::auth::Caller;
use crate::state::AppState;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use feedwright_core::feed::nc::{self, ExportOptions, Stamp};
use feedwright_core::ids::{MachineId, ProfileId};
use feedwright_store::{ProfileSource, profile_hash};
use http::{HeaderValue, StatusCode, header};

/// Writes a released version as a file for a control.
///
/// Each file begins with a comment: profile, version, hash, limits, units, warning. A draft or shadow is not written.
#[utoipa::path(get, path = "/v1/feed-profiles/{profile}/export", tag = "feed profiles",
    params(("profile" = String, Path), ExportQuery),
    responses((status = 200, description = "The file", content((String = "text/plain"), (Object = "application/json"))),
        (status = 403, description = "A machine's token asks for another machine", body = ProblemDocument<'static>),
        (status = 409, description = "The version is not approved (`not_released`), or nothing is active (`nothing_active`), or \
            the operation is another one than it was made for (`profile_other_depth` and the like)",
            body = ProblemDocument<'static>),
        (status = 422, description = "An option out of range, a feed outside the machine's limits (`outside_machine`), one \
            that blocks cannot follow (`too_steep`) or F has too few decimals for (`feed_decimals`), or a law that would have \
            nothing to act on (`heating_only`)", body = ProblemDocument<'static>)))]
pub(super) async fn export(
    State(state): State<AppState>,
    caller: Caller,
    PathId(id): PathId<ProfileId>,
    Query(query): Query<ExportQuery>,
) -> Result<Response, Problem> {
    let dialect = query.dialect()?;
    let line = line_of(&state, &id).await?;
    let number = query.version.or(line.active).ok_or_else(|| {
        Problem::new(StatusCode::CONFLICT, "nothing_active", "no version is active: name one with `version`")
    })?;
    let stored = version_of(&state, &id, number).await?;
    if !stored.state.is_released() {
        let why = format!(
            "version {number} is {}: only what was approved is written for a control",
            stored.state.as_str()
        );
        return Err(Problem::new(StatusCode::CONFLICT, "not_released", why));
    }
    // What it says is told as it is; what a control runs has to be for what is drilled now.
    if dialect.is_some() {
        must_fit(&state, &stored).await?;
    }
    let mut limits = None;
    if let Some(machine) = query_id::<MachineId>(query.machine.as_deref())? {
        caller.must_be_for(machine.as_str())?;
        let found = state.store.machine(&machine).await?;
        let found = found.ok_or_else(|| Problem::not_found("machine", machine.as_str()))?.sound()?;
        // A file of its content alone is for a machine too.
        nc::within(&stored.content, &found.value.limits)
            .map_err(|wrong| Problem::new(StatusCode::UNPROCESSABLE_ENTITY, wrong.code, wrong.message))?;
        limits = Some(found.value.limits);
    }
    let name = format!("{id}.v{number}").replace(':', "_");
    let (name, kind, text) = match dialect {
        None => {
            let stamp = Stamp { version: stored.version, hash: stored.hash };
            let text = profile_json::write(&stored.content, &stamp)
                .map_err(|error| Problem::internal(error.to_string()))?;
            (format!("{name}.json"), "application/json", text)
        }
        Some(dialect) => {
            let options = ExportOptions { machine: limits, ..query.options()? };
            let stamp = Stamp { version: stored.version, hash: stored.hash };
            let text = nc::write(dialect, &stored.content, &stamp, &options).map_err(ExportQuery::refused)?;
            (format!("{name}.{}", dialect.extension()), "text/plain; charset=us-ascii", text)
        }
    };
    // Ids hold nothing that would end the quotes.
    let place = HeaderValue::try_from(format!("attachment; filename=\"{name}\""))
        .map_err(|error| Problem::internal(error.to_string()))?;
    let kind = HeaderValue::from_static(kind);
    Ok(([(header::CONTENT_TYPE, kind), (header::CONTENT_DISPOSITION, place)], text).into_response())
}

/// Drafts a version from what a shop has now: a stepped or linear feed list as CSV, or one hole of a simple program.
///
/// Where a stepped feed changes, a ramp lies on the slower side, as short as the acceleration allows. What is not
/// understood is refused with its line; nothing is drafted then.
#[utoipa::path(post, path = "/v1/feed-profiles/import", tag = "feed profiles", request_body = ImportBody,
    responses((status = 201, description = "Drafted", body = DraftedBody),
        (status = 200, description = "This content is a version already", body = DraftedBody),
        (status = 422, description = "A text that is not understood, with its line", body = ProblemDocument<'static>)))]
pub(super) async fn import(
    State(state): State<AppState>,
    caller: Caller,
    Json(body): Json<ImportBody>,
) -> Result<Response, Problem> {
    let (knots, hole) = body.knots()?;
    let end_mm = knots.last().map_or(0.0, |knot| knot.depth_mm);
    let report = ImportReport {
        format: body.format,
        text_hash: blake3::hash(body.text.as_bytes()).to_hex().to_string(),
        passed_over: hole.passed_over,
        without_point: hole.without_point,
        knots: knots.len(),
    };
    let report = serde_json::to_string(&report).map_err(|error| Problem::internal(error.to_string()))?;
    let content = ProfileBody {
        operation: body.operation.clone(),
        tool_type: body.tool_type.clone(),
        knots: knots
            .into_iter()
            .map(|knot| KnotBody { depth_mm: knot.depth_mm, feed_mm_min: knot.feed_mm_min })
            .collect(),
        sections: body.sections(end_mm),
        limits: body.limits,
        wear: body.wear,
        conditions: body.conditions.clone(),
    };
    let content = checked(&state, "content", &content).await?;
    let draft = Draft { profile: &body.profile, reason: &body.reason, based_on: body.based_on };
    keep(&state, &caller, draft, content, (ProfileSource::Imported, Some(report))).await
}

/// Reads an exported file back: which version it says it is, and that nobody changed its content.
///
/// `known` says whether that version is stored here with this content; a file whose name was changed is not.
#[utoipa::path(post, path = "/v1/feed-profiles/read", tag = "feed profiles", request_body = ReadBody,
    responses((status = 200, body = ReadAnswer),
        (status = 422, description = "The file was changed, or is none of ours", body = ProblemDocument<'static>)))]
pub(super) async fn read(
    State(state): State<AppState>,
    Json(body): Json<ReadBody>,
) -> Result<axum::Json<ReadAnswer>, Problem> {
    let (dialect, stamp, profile) = if profile_json::is_json(&body.text) {
        let (stamp, profile) = profile_json::read(&body.text, profile_hash)?;
        ("json", stamp, profile)
    } else {
        let found = nc::read(&body.text, profile_hash)?;
        (found.dialect.as_str(), found.stamp, found.profile)
    };
    let version = &stamp.version;
    let known = state.store.profile_version(&version.profile, version.version).await?;
    let known = known.filter(|known| known.hash == stamp.hash);
    Ok(axum::Json(ReadAnswer {
        dialect,
        profile: version.profile.to_string(),
        version: version.version,
        hash: stamp.hash.to_string(),
        known: known.is_some(),
        state: known.map(|known| known.state.as_str()),
        content: (&profile).into(),
    }))
}

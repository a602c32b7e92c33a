//! Optimising a feed profile from stored cycles, and its prediction against what came of it.

use super::body::Json;
use super::dto::feed_profile::ProfileBody;
use super::dto::optimise::{
    BandResultBody, CycleOutcomeBody, Known, OptimiseBody, OptimisedBody, OutcomeAnswer, OutcomeQuery,
    PredictionBody, ProposalReport, SkippedBody, USUAL_CYCLES, WORN_LEVEL, refused, settings,
};
use super::extract::{PathId, Query};
use super::feed_profiles::{line_of, version_of};
use super::jobs::{json, submitted};
use super::problem::{Problem, ProblemDocument};
use crate::jobs::{INLINE_STEPS, Question, Stage};
use crate::state::AppState;
use axum::extract::State;
use axum::response::Response;
use feedwright_core::cycle::{Channel, Extent, Samples};
use feedwright_core::feed::optimise::{
    Actual, Knots, LoadSignal, Prediction, Proposal, RecordedCycle, Settings, WearBand, calibrate, compare,
    coverage, optimise, wear_bands,
};
use feedwright_core::feed::profile::{
    Conditions, KnotInput, LimitsInput, Profile, ProfileInput, SectionInput, WearBandInput,
};
use feedwright_core::friction::program::Knot;
use feedwright_core::friction::relation::FeedSource;
use feedwright_core::ids::{OperationId, ProfileId, ToolId};
use feedwright_core::invalid::Violation;
use feedwright_core::operation::Operation;
use feedwright_core::units::Strategy;
use feedwright_core::wear::Verdict;
use feedwright_store::{StoredCycle, StoredProfileVersion, Versioned};
use http::StatusCode;
use serde::Deserialize;
use std::collections::HashMap;

/// Kind of these jobs.
const KIND: &str = "feed_profile_optimize";
/// Why a cycle is skipped whose samples are not kept any more.
const SAMPLES_DROPPED: &str = "samples_dropped";
/// Overrides that differ by more were chosen by a law or an operator, points.
const VARIED_OVERRIDE: f64 = 1.0;

/// Finds the fastest (or cheapest) feed over depth that keeps both loads, from the operation's last cycles.
///
/// A job: its result holds the content and its report. Nothing is drafted by it: `POST /v1/feed-profiles` with the job's
/// id does that, under the name of whoever asks, at the same server where there are several (`/v1/jobs/{id}`).
#[utoipa::path(post, path = "/v1/feed-profiles/optimize", tag = "feed profiles", request_body = OptimiseBody,
    responses((status = 202, description = "The job that computes it", body = super::dto::job::JobBody),
        (status = 422, description = "A setting out of range, an operation without a depth", body = ProblemDocument<'static>),
        (status = 503, description = "Too many jobs wait or run", body = ProblemDocument<'static>)))]
pub(super) async fn start(
    State(state): State<AppState>,
    Json(body): Json<OptimiseBody>,
) -> Result<Response, Problem> {
    let id = OperationId::parse("operation", &body.operation)?;
    let operation = state.store.operation(&id).await?.ok_or_else(|| {
        Violation::new(
            "operation",
            "operation_unregistered",
            format!("the operation `{id}` is not registered"),
        )
    })?;
    let operation = operation.sound()?.value;
    let depth_mm = operation.depth_mm.ok_or_else(|| {
        Violation::new(
            "operation",
            "no_depth",
            "the operation declares no depth: a profile has to end somewhere",
        )
    })?;
    let most = body.cycles.unwrap_or(USUAL_CYCLES);
    if !(1..=USUAL_CYCLES).contains(&most) {
        let why = format!("must be within 1 to {USUAL_CYCLES}, is {most}");
        return Err(Violation::new("cycles", "out_of_range", why).into());
    }
    let tried = last_tried(&state, &body, &operation).await?;
    let rows = state.store.recent_cycles(&id, &body.tool_type, most).await?;
    let known = Known {
        depth_mm,
        watts_per_percent: watts_per_percent(&state, &operation, rows.last()).await?,
        spread_scale: tried.as_ref().map_or(1.0, |tried| tried.spread_scale),
    };
    let settings = body.settings(&known)?;
    let last = tried.map(|tried| tried.knots);
    let Recorded { cycles, skipped } = recorded(&state, rows).await?;
    let ids: Vec<(&str, Option<f64>)> =
        cycles.iter().map(|cycle| (cycle.id.as_str(), cycle.wear_ratio)).collect();
    // What was skipped too: a refusal says why, and samples go while cycles stay.
    let parameters = format!("{body:?} {operation:?} {last:?} {known:?} {ids:?} {skipped:?}");
    let question = Question { kind: KIND, parameters, total: 1, steps: INLINE_STEPS + 1 };
    submitted(&state, &question, move |_| {
        json(&optimised(&body, &operation, &cycles, &settings, last.as_ref(), skipped))
    })
}

/// What an optimisation of this id proposes, for a wear band where it was asked for bands, as content and report; for
/// drafting it.
pub(super) fn proposed(
    state: &AppState,
    job: &str,
    band: Option<usize>,
) -> Result<(ProfileBody, String), Problem> {
    #[derive(Deserialize)]
    struct One {
        content: Option<ProfileBody>,
        report: Option<serde_json::Value>,
    }
    #[derive(Deserialize)]
    struct Done {
        content: Option<ProfileBody>,
        report: Option<serde_json::Value>,
        bands: Vec<One>,
    }
    let unknown = || {
        let why = "this server has no finished optimisation of this id: it may have been asked for at another server or before a \
                   restart, or is forgotten";
        Violation::new("job", "unknown_job", why)
    };
    let found = state.jobs.get(job).filter(|found| found.kind == KIND).ok_or_else(unknown)?;
    let Stage::Done(result) = found.stage else {
        return Err(unknown().into());
    };
    let mut done: Done =
        serde_json::from_slice(&result).map_err(|error| Problem::internal(error.to_string()))?;
    let (content, report) = match band {
        None if !done.bands.is_empty() => {
            let why = format!("the optimisation made {} wear bands: name one", done.bands.len());
            return Err(Violation::new("band", "missing_field", why).into());
        }
        None => (done.content, done.report),
        Some(at) if at < done.bands.len() => {
            let one = done.bands.swap_remove(at);
            (one.content, one.report)
        }
        Some(_) => {
            let why = format!("the optimisation made {} wear bands, counted from 0", done.bands.len());
            return Err(Violation::new("band", "out_of_range", why).into());
        }
    };
    match (content, report) {
        (Some(content), Some(report)) => Ok((content, report.to_string())),
        _ => {
            Err(Violation::new("job", "no_proposal", "the optimisation found none: its result says why")
                .into())
        }
    }
}

/// What one percent of spindle load stands for on the machine of the latest cycle.
async fn watts_per_percent(
    state: &AppState,
    operation: &Operation,
    latest: Option<&StoredCycle>,
) -> Result<Option<f64>, Problem> {
    let Some(latest) = latest else { return Ok(None) };
    let machine = state.store.machine(&latest.cycle.machine).await?.map(Versioned::sound).transpose()?;
    Ok(machine.and_then(|machine| machine.value.spindle.watts_per_percent(operation.spindle_speed_rpm)))
}

/// What was tried last.
struct Tried {
    knots: Knots,
    /// What its own prediction asks of the next one.
    spread_scale: f64,
}

/// The profile that was tried last, where the question names one.
async fn last_tried(
    state: &AppState,
    body: &OptimiseBody,
    operation: &Operation,
) -> Result<Option<Tried>, Problem> {
    let Some(name) = &body.profile else {
        return match body.last_version {
            None => Ok(None),
            Some(_) => Err(Violation::new("profile", "missing_field", "is needed with last_version").into()),
        };
    };
    let id = ProfileId::parse("profile", name)?;
    let line = line_of(state, &id).await?;
    if line.operation != operation.id || line.tool_type != body.tool_type {
        let why = "is for another operation or tool type";
        return Err(Violation::new("profile", "other_subject", why).into());
    }
    let number = body.last_version.or(line.active).unwrap_or(line.newest);
    let stored = version_of(state, &id, number).await?;
    let knots =
        stored.content.knots().map(|knot| Knot { depth_mm: knot.depth_mm, feed_mm_min: knot.feed_mm_min });
    let knots = Knots::new(knots.collect()).map_err(|error| refused(&error))?;
    let spread_scale = match predicted(&stored)? {
        Some(predicted) => predicted.against(state, &stored, USUAL_CYCLES).await?.spread_scale,
        None => 1.0,
    };
    Ok(Some(Tried { knots, spread_scale }))
}

struct Recorded {
    cycles: Vec<RecordedCycle>,
    skipped: Vec<SkippedBody>,
}

/// Stored cycles as the optimiser takes them.
async fn recorded(state: &AppState, rows: Vec<StoredCycle>) -> Result<Recorded, Problem> {
    let mut verdicts: HashMap<ToolId, Verdict> = HashMap::new();
    let mut found = Recorded { cycles: Vec::new(), skipped: Vec::new() };
    // The newest first: the level of a tool is that of its last cycles.
    let mut judged: HashMap<ToolId, u32> = HashMap::new();
    for row in rows.iter().rev() {
        let tool = &row.cycle.tool;
        if !verdicts.contains_key(tool) {
            verdicts.insert(tool.clone(), state.store.verdict(tool).await?);
        }
        let count = judged.entry(tool.clone()).or_insert(0);
        *count += 1;
        let level = verdicts.get(tool).and_then(|verdict| verdict.level);
        let wear = level.filter(|level| *count <= level.window).map(|level| level.as_run);
        match recording(state, row, wear).await? {
            Some(cycle) => found.cycles.push(cycle),
            None => found.skipped.push(SkippedBody { cycle: name(row), reason: without_recording(row) }),
        }
    }
    found.cycles.reverse();
    Ok(found)
}

/// Why a cycle is left out of which there is no recording: its depth or loads were not sampled, or its samples were dropped.
const fn without_recording(row: &StoredCycle) -> &'static str {
    if row.samples_are_gone() { SAMPLES_DROPPED } else { "no_samples" }
}

/// Why nothing can be learned where no cycle is left whose samples are there; `None` where it is nothing that was dropped.
fn dropped(cycles: &[RecordedCycle], skipped: &[SkippedBody]) -> Option<Violation> {
    let gone = skipped.iter().filter(|one| one.reason == SAMPLES_DROPPED).count();
    if gone == 0 || !cycles.is_empty() {
        return None;
    }
    let mut why = format!(
        "of the last {} cycles none can be learned from: the samples of {gone} were dropped by retention, or are missing",
        skipped.len()
    );
    if gone < skipped.len() {
        why.push_str(
            ", and the others were not sampled with depth, feed-drive load and spindle load (depth_mm, \
             feed_drive_load_percent, spindle_load_percent): all three are needed",
        );
    }
    Some(Violation::new("cycles", "not_identifiable", why))
}

fn name(row: &StoredCycle) -> String {
    format!("{}/{}", row.cycle.machine, row.cycle.id)
}

/// One stored cycle with its samples; none where depth or a load was not sampled.
async fn recording(
    state: &AppState,
    row: &StoredCycle,
    wear_ratio: Option<f64>,
) -> Result<Option<RecordedCycle>, Problem> {
    let meta = &row.cycle;
    if !row.has_samples {
        return Ok(None);
    }
    let samples = state.store.cycle_samples(&meta.machine, &meta.id).await;
    let samples: Option<Samples> =
        samples.map_err(|error| Problem::of_samples(error, &meta.machine, &meta.id))?;
    let Some(samples) = samples else { return Ok(None) };
    let column = |channel| samples.column(channel).map(<[f64]>::to_vec);
    let (Some(depth_mm), Some(feed_drive_percent), Some(spindle_percent)) = (
        column(Channel::DepthMm),
        column(Channel::FeedDriveLoadPercent),
        column(Channel::SpindleLoadPercent),
    ) else {
        return Ok(None);
    };
    let varied = samples.column(Channel::OverridePercent).is_some_and(|column| {
        let low = column.iter().copied().fold(f64::INFINITY, f64::min);
        let high = column.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        high - low > VARIED_OVERRIDE
    });
    let controlled = varied || meta.strategy == Some(Strategy::FAc);
    Ok(Some(RecordedCycle {
        id: name(row),
        operation: meta.operation.to_string(),
        order: meta.started_at.micros(),
        extent: Extent::of(meta.outcome, row.summary.flags),
        source: if controlled { FeedSource::Controlled } else { FeedSource::Programmed },
        wear_ratio,
        signal: LoadSignal::Raw,
        time_s: (0..depth_mm.len()).map(|index| samples.time_ms(index) / 1000.0).collect(),
        depth_mm,
        feed_mm_min: None,
        feed_drive_percent,
        spindle_percent,
    }))
}

fn optimised(
    body: &OptimiseBody,
    operation: &Operation,
    cycles: &[RecordedCycle],
    settings: &Settings,
    last: Option<&Knots>,
    skipped: Vec<SkippedBody>,
) -> OptimisedBody {
    let none = |wrong: Vec<Violation>, skipped: Vec<SkippedBody>| OptimisedBody {
        content: None,
        report: None,
        bands: Vec::new(),
        refused: wrong.into_iter().map(Into::into).collect(),
        skipped,
    };
    if let Some(why) = dropped(cycles, &skipped) {
        return none(vec![why], skipped);
    }
    if let Some(edges) = &body.wear_edges {
        let bands = match wear_bands(cycles, settings, last, edges) {
            Ok(bands) => bands,
            Err(error) => return none(vec![refused(&error)], skipped),
        };
        let mut found = none(Vec::new(), Vec::new());
        for WearBand { from, to, proposal } in bands {
            let level = Planned { from: Some(from), at: to };
            let (content, wrong) = match content(body, operation, &proposal, level) {
                Ok(profile) => (Some((&profile).into()), Vec::new()),
                Err(wrong) => (None, wrong),
            };
            found.refused.extend(wrong.into_iter().map(Into::into));
            let report = content.is_some().then(|| ProposalReport::new(&proposal, settings, skipped.clone()));
            found.bands.push(BandResultBody { from_level: from, to_level: to, content, report });
        }
        return found;
    }
    let proposal = match optimise(cycles, settings, last) {
        Ok(proposal) => proposal,
        Err(error) => return none(vec![refused(&error)], skipped),
    };
    // Where the wear of the cycles is not known they count as a new tool's, which is the careful side.
    let at = body.wear_level.or(body.wear_from_level).unwrap_or(1.0);
    match content(body, operation, &proposal, Planned { from: body.wear_from_level, at }) {
        Ok(profile) => OptimisedBody {
            content: Some((&profile).into()),
            report: Some(ProposalReport::new(&proposal, settings, skipped)),
            bands: Vec::new(),
            refused: Vec::new(),
            skipped: Vec::new(),
        },
        Err(wrong) => none(wrong, skipped),
    }
}

/// Levels of wear of a plan.
#[derive(Clone, Copy)]
struct Planned {
    /// From which it is meant.
    from: Option<f64>,
    /// For which it is planned.
    at: f64,
}

/// A proposal as a profile, checked like any other.
fn content(
    body: &OptimiseBody,
    operation: &Operation,
    proposal: &Proposal,
    planned: Planned,
) -> Result<Profile, Vec<Violation>> {
    let mut sections: Vec<SectionInput> = Vec::new();
    for section in &proposal.sections {
        // Sections only go forward: what looks like forming behind idle travel is the beginning of the flange.
        match sections.last_mut() {
            Some(before) if section.kind <= before.kind => before.to_mm = section.to_mm,
            _ => sections.push(SectionInput { kind: section.kind, to_mm: section.to_mm }),
        }
    }
    if let (Some(last), Some(depth_mm)) = (sections.last_mut(), operation.depth_mm) {
        last.to_mm = depth_mm;
    }
    let from_level = planned.from;
    let holds = proposal.holds_up_to_wear.unwrap_or(planned.at + proposal.holds_for_more_wear);
    Profile::new(ProfileInput {
        operation: operation.id.clone(),
        tool_type: body.tool_type.clone(),
        knots: proposal
            .knots
            .as_slice()
            .iter()
            .map(|knot| KnotInput { depth_mm: knot.depth_mm, feed_mm_min: knot.feed_mm_min })
            .collect(),
        sections,
        limits: body.limits.to_input(),
        wear: WearBandInput { from_level, to_level: holds.clamp(1.0, WORN_LEVEL) },
        conditions: Conditions {
            program: operation.program.clone(),
            work_material: operation.work_material.clone(),
            spindle_speed_rpm: operation.spindle_speed_rpm,
        },
    })
}

/// Holds an optimised version's prediction against the cycles that ran it: time, peak loads, work, each cycle's own.
#[utoipa::path(get, path = "/v1/feed-profiles/{profile}/outcome", tag = "feed profiles",
    params(("profile" = String, Path), OutcomeQuery),
    responses((status = 200, body = OutcomeAnswer),
        (status = 409, description = "The version was not optimised: it predicts nothing (`no_prediction`)",
            body = ProblemDocument<'static>)))]
pub(super) async fn outcome(
    State(state): State<AppState>,
    PathId(id): PathId<ProfileId>,
    Query(query): Query<OutcomeQuery>,
) -> Result<axum::Json<OutcomeAnswer>, Problem> {
    let line = line_of(&state, &id).await?;
    let number = query.version.or(line.active).unwrap_or(line.newest);
    let most = query.cycles.unwrap_or(USUAL_CYCLES);
    if !(1..=USUAL_CYCLES).contains(&most) {
        let why = format!("must be within 1 to {USUAL_CYCLES}, is {most}");
        return Err(Violation::new("cycles", "out_of_range", why).into());
    }
    let stored = version_of(&state, &id, number).await?;
    let Some(predicted) = predicted(&stored)? else {
        let why = "the version was not optimised: it predicts nothing but its own time";
        return Err(Problem::new(StatusCode::CONFLICT, "no_prediction", why));
    };
    Ok(axum::Json(predicted.against(&state, &stored, most).await?))
}

/// What an optimised version predicts.
struct Predicted {
    report: StoredReport,
    settings: Settings,
}

/// The part of a stored report that predictions are compared by.
#[derive(Deserialize)]
struct StoredReport {
    prediction: PredictionBody,
    idle_percent: [f64; 2],
    #[serde(default = "as_learned")]
    spread_scale: f64,
}

const fn as_learned() -> f64 {
    1.0
}

/// The version's prediction; `None` where it was not optimised.
fn predicted(stored: &StoredProfileVersion) -> Result<Option<Predicted>, Problem> {
    let report = stored.report.as_deref().and_then(|text| serde_json::from_str::<StoredReport>(text).ok());
    let Some(report) = report else { return Ok(None) };
    let limits: LimitsInput = stored.content.limits();
    let params = settings(stored.content.operation().as_str(), stored.content.end_depth_mm(), &limits)?;
    let settings = Settings::new(params).map_err(|error| refused(&error))?;
    Ok(Some(Predicted { report, settings }))
}

impl Predicted {
    /// Holds the prediction against the last cycles that ran the version.
    async fn against(
        &self,
        state: &AppState,
        stored: &StoredProfileVersion,
        most: u32,
    ) -> Result<OutcomeAnswer, Problem> {
        let prediction: Prediction = self.report.prediction.into();
        let mut compared = Vec::new();
        let mut answer = OutcomeAnswer {
            profile: stored.version.profile.to_string(),
            version: stored.version.version,
            prediction: self.report.prediction,
            cycles: Vec::new(),
            within_share: None,
            spread_scale: self.report.spread_scale,
            overloaded: 0,
            skipped: 0,
            skipped_cycles: Vec::new(),
        };
        for row in state.store.cycles_of_profile(&stored.version, most).await? {
            let cycle = recording(state, &row, None).await?.ok_or(without_recording(&row));
            let idle = self.report.idle_percent[1];
            let actual = cycle
                .and_then(|cycle| Actual::of(&cycle, &self.settings, idle).map_err(|reason| reason.as_str()));
            let actual = match actual {
                Ok(actual) => actual,
                Err(reason) => {
                    answer.skipped += 1;
                    answer.skipped_cycles.push(SkippedBody { cycle: name(&row), reason });
                    continue;
                }
            };
            let one = compare(&prediction, &actual, &self.settings);
            answer.overloaded += usize::from(one.overloaded);
            let (machine, cycle) = (row.cycle.machine.to_string(), row.cycle.id.to_string());
            answer.cycles.push(CycleOutcomeBody::new(machine, cycle, &one));
            compared.push(one);
        }
        answer.within_share = coverage(&compared).map(|(share, _)| share);
        answer.spread_scale = calibrate(&compared, self.report.spread_scale);
        Ok(answer)
    }
}

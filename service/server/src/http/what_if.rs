//! Stored cycles under another law, other limits or another feed program.

use super::body::Json;
use super::compute::{Room, compute, on_thread, room};
use super::cursor::{decode, encode};
use super::dto::what_if::{
    ControlBody, ManyAnswer, ManyQuestion, ProfileChoice, SumBody, SumErrorBody, WhatIfAnswer, WhatIfQuestion,
};
use super::extract::PathId;
use super::problem::{Problem, ProblemDocument};
use super::samples::no_samples;
use crate::state::AppState;
use crate::what_if::{Asked, AskedProfile, IdleLoads, Library, Prediction, Unusable, predict};
use axum::extract::State;
use feedwright_core::friction::whatif::RunFigures;
use feedwright_core::ids::{CycleId, MachineId};
use feedwright_core::invalid::Violation;
use feedwright_core::summary::median;
use feedwright_store::{CycleFilter, CycleKey, Page, StoredCycle};
use http::StatusCode;
use std::collections::BTreeMap;

/// Cycles that are read before they are run: bounds what is held in memory at a time.
const CHUNK: usize = 16;

/// Runs one stored cycle under another control, beside what happened.
///
/// The load–feed relation is learned from the first cycles of the tool's life on this machine, operation, speed,
/// strategy and law. The answer says how wrong the model is on the cycle itself.
#[utoipa::path(post, path = "/v1/machines/{machine}/cycles/{cycle_id}/what-if", tag = "friction",
    params(("machine" = String, Path), ("cycle_id" = String, Path)), request_body = WhatIfQuestion,
    responses(
        (status = 200, body = WhatIfAnswer),
        (status = 404, description = "There is no such cycle", body = ProblemDocument<'static>),
        (status = 410, description = "Its samples were dropped by retention, or are missing (`samples_lost`)", body = ProblemDocument<'static>),
        (status = 422, description = "A control that is none, or a cycle that says too little (`cycle_not_usable`)",
            body = ProblemDocument<'static>),
        (status = 503, description = "Other computations are under way", body = ProblemDocument<'static>),
    ))]
pub(super) async fn of_cycle(
    State(state): State<AppState>,
    PathId(machine): PathId<MachineId>,
    PathId(id): PathId<CycleId>,
    Json(question): Json<WhatIfQuestion>,
) -> Result<axum::Json<WhatIfAnswer>, Problem> {
    let (asked, idle) = question.to_asked(state.config.stream.law())?;
    let asked = with_profile(&state, &question.control, asked, "control").await?;
    let stored = state.store.cycle(&machine, &id).await?;
    let stored = stored.ok_or_else(|| Problem::not_found("cycle", id.as_str()))?;
    if stored.samples_are_gone() {
        return Err(no_samples(&state, &machine, &id).await?);
    }
    let mut library = Library::new(state.store.clone(), idle);
    let ready = prepare(&mut library, stored).await?;
    let ready = ready.map_err(|why| not_usable(why, "the cycle's samples do not say enough"))?;
    compute(move || {
        let tolerated_s = asked.tolerated_overload_s;
        let predicted = ready.predict(&asked);
        let predicted = predicted.map_err(|(why, error)| not_usable(why, error.to_string()))?;
        Ok(axum::Json(WhatIfAnswer::new(&predicted, tolerated_s)))
    })
    .await
}

/// Runs many stored cycles under another control and sums up: time, energy, loads and alarms per thousand, before a
/// limit is rolled out.
#[utoipa::path(post, path = "/v1/what-if", tag = "friction", request_body = ManyQuestion,
    responses(
        (status = 200, body = ManyAnswer),
        (status = 422, description = "A control or a filter that is none, as a range that ends where it begins or before \
            (`empty_range`)", body = ProblemDocument<'static>),
        (status = 503, description = "Other computations are under way", body = ProblemDocument<'static>),
    ))]
pub(super) async fn of_many(
    State(state): State<AppState>,
    Json(question): Json<ManyQuestion>,
) -> Result<axum::Json<ManyAnswer>, Problem> {
    let inside = |wrong: Violation| Violation { path: format!("question.{}", wrong.path), ..wrong };
    let (asked, idle) = question.question.to_asked(state.config.stream.law()).map_err(inside)?;
    let asked = with_profile(&state, &question.question.control, asked, "question.control").await?;
    if asked.samples {
        let text = "samples are told of one cycle at a time";
        return Err(Violation::new("question.samples", "not_of_many", text).into());
    }
    let filter = question.filter.to_filter("filter")?;
    if let (Some(operation), Some(profile)) = (&filter.operation, &asked.profile)
        && profile.content.operation() != operation
    {
        let text = format!("the profile is for operation {}", profile.content.operation());
        return Err(Violation::new("question.control.profile.id", "other_operation", text).into());
    }
    let room = room()?;
    let (rows, next) = page(&state, &filter, &question).await?;
    let sum = run_all(&state, &room, rows, &asked, idle, question.cycles).await?;
    Ok(axum::Json(sum.answer(next)))
}

/// The cycles that are looked at, and the cursor that goes on after them where there are more.
async fn page(
    state: &AppState,
    filter: &CycleFilter,
    question: &ManyQuestion,
) -> Result<(Vec<StoredCycle>, Option<String>), Problem> {
    let most = question.most()?;
    let scope = format!("what-if {filter:?}");
    let foreign = || {
        let text = "is not one that was answered to a question with this filter";
        Violation::new("continue_from", "invalid_cursor", text)
    };
    let after = question.continue_from.as_deref();
    let after = after.map(|cursor| decode::<CycleKey>(&scope, cursor).ok_or_else(foreign)).transpose()?;
    let mut rows = state.store.cycles(filter, Page { after, limit: most + 1 }).await?;
    let more = rows.len() > most as usize;
    rows.truncate(most as usize);
    let key = |row: &StoredCycle| (row.cycle.started_at, row.cycle.machine.clone(), row.cycle.id.clone());
    let next = rows.last().filter(|_| more).map(|row| encode(&scope, &key(row)));
    Ok((rows, next))
}

/// Looks up the stored profile that is asked about, where one is; `at` is the control's own path.
async fn with_profile(
    state: &AppState,
    control: &ControlBody,
    asked: Asked,
    at: &str,
) -> Result<Asked, Problem> {
    let Some(ProfileChoice::Stored(id, version)) = control.choice()? else { return Ok(asked) };
    let wrong = |field: &str, code, text: String| {
        Problem::from(Violation::new(format!("{at}.profile.{field}"), code, text))
    };
    let line = state.store.feed_profile(&id).await?;
    let line =
        line.ok_or_else(|| wrong("id", "unknown_profile", format!("there is no feed profile {id}")))?;
    let version = version.or(line.active).ok_or_else(|| {
        wrong("version", "no_active_version", format!("no version of {id} is active: name the version"))
    })?;
    let stored = state.store.profile_version(&id, version).await?.ok_or_else(|| {
        let text = format!("{id} has versions 1 to {}, not {version}", line.newest);
        wrong("version", "unknown_version", text)
    })?;
    let program = stored.content.program().map_err(|error| Problem::internal(error.to_string()))?;
    let profile = AskedProfile { version: stored.version, content: stored.content };
    Ok(Asked { program: Some(program), profile: Some(std::sync::Arc::new(profile)), ..asked })
}

/// Runs stored cycles under another control, some at a time, for a request that has room.
pub(super) async fn run_all(
    state: &AppState,
    room: &Room,
    rows: Vec<StoredCycle>,
    asked: &Asked,
    idle: Option<IdleLoads>,
    each: bool,
) -> Result<Sum, Problem> {
    let mut sum = Sum::new(asked, each);
    let mut library = Library::new(state.store.clone(), idle);
    let mut rows = rows.into_iter().peekable();
    while rows.peek().is_some() {
        let mut chunk = Vec::with_capacity(CHUNK);
        for stored in rows.by_ref().take(CHUNK) {
            chunk.push(prepare(&mut library, stored).await?);
        }
        let asked = asked.clone();
        let run = move |ready: Result<Ready, Unusable>| ready?.predict(&asked).map_err(|(why, _)| why);
        let answers: Vec<_> = on_thread(room, move || Ok(chunk.into_iter().map(run).collect())).await?;
        answers.into_iter().for_each(|answer| sum.take(answer));
    }
    Ok(sum)
}

/// A cycle with all that its prediction needs.
struct Ready {
    around: std::sync::Arc<feedwright_store::Surroundings>,
    stored: StoredCycle,
    cycle: crate::what_if::ContactCycle,
    learned: std::sync::Arc<crate::what_if::Learned>,
}

impl Ready {
    fn predict(
        self,
        asked: &Asked,
    ) -> Result<Prediction, (Unusable, feedwright_core::friction::error::Invalid)> {
        predict(asked, &self.around, self.stored, self.cycle, self.learned)
    }
}

async fn prepare(library: &mut Library, stored: StoredCycle) -> Result<Result<Ready, Unusable>, Problem> {
    let cycle = match library.contact(&stored).await? {
        Ok(cycle) => cycle,
        Err(why) => return Ok(Err(why)),
    };
    let Some(around) = library.around(&stored.cycle).await? else { return Ok(Err(Unusable::Refused)) };
    let Some(learned) = library.learned(&stored, &cycle).await? else {
        return Ok(Err(Unusable::NoRelation));
    };
    Ok(Ok(Ready { around, stored, cycle, learned }))
}

fn not_usable(why: Unusable, detail: impl Into<String>) -> Problem {
    let problem = Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "cycle_not_usable", detail.into());
    problem.member("reason", why.as_str())
}

/// Answers as they come, summed up.
pub(super) struct Sum {
    tolerated_s: f64,
    considered: u32,
    skipped: BTreeMap<&'static str, u32>,
    happened: Vec<RunFigures>,
    predicted: Vec<RunFigures>,
    duration_errors: Vec<f64>,
    spindle_errors: Vec<f64>,
    cycles: Option<Vec<WhatIfAnswer>>,
}

impl Sum {
    fn new(asked: &Asked, each: bool) -> Self {
        Self {
            tolerated_s: asked.tolerated_overload_s,
            considered: 0,
            skipped: BTreeMap::new(),
            happened: Vec::new(),
            predicted: Vec::new(),
            duration_errors: Vec::new(),
            spindle_errors: Vec::new(),
            cycles: each.then(Vec::new),
        }
    }

    fn take(&mut self, answer: Result<Prediction, Unusable>) {
        self.considered += 1;
        let prediction = match answer {
            Ok(prediction) => prediction,
            Err(why) => return *self.skipped.entry(why.as_str()).or_insert(0) += 1,
        };
        let answer = &prediction.answer;
        self.happened.push(answer.happened);
        self.predicted.push(answer.predicted);
        self.duration_errors.push(answer.error.duration_relative.abs());
        self.spindle_errors.push(answer.error.peak_points.1.abs());
        if let Some(cycles) = &mut self.cycles {
            cycles.push(WhatIfAnswer::new(&prediction, self.tolerated_s));
        }
    }

    pub(super) fn answer(self, next: Option<String>) -> ManyAnswer {
        let (duration_median, duration_largest) = spread(&self.duration_errors);
        let (peak_spindle_median_points, peak_spindle_largest_points) = spread(&self.spindle_errors);
        ManyAnswer {
            considered: self.considered,
            predicted_cycles: u32::try_from(self.predicted.len()).unwrap_or(u32::MAX),
            skipped: self.skipped,
            happened: total(&self.happened, self.tolerated_s),
            predicted: total(&self.predicted, self.tolerated_s),
            model_error: SumErrorBody {
                duration_median,
                duration_largest,
                peak_spindle_median_points,
                peak_spindle_largest_points,
            },
            complete: next.is_none(),
            continue_from: next,
            cycles: self.cycles,
        }
    }
}

/// Median and largest, where there are any.
fn spread(values: &[f64]) -> (Option<f64>, Option<f64>) {
    let middle = (!values.is_empty()).then(|| median(values));
    (middle, values.iter().copied().reduce(f64::max))
}

fn total(runs: &[RunFigures], tolerated_s: f64) -> SumBody {
    #[expect(clippy::cast_precision_loss, reason = "at most a thousand cycles")]
    let share = |sum: f64, count: usize| (count > 0).then(|| sum / count as f64);
    let mean = |values: &[f64]| share(values.iter().sum(), values.len());
    let all = |of: fn(&RunFigures) -> f64| runs.iter().map(of).collect::<Vec<f64>>();
    let largest = |of| all(of).into_iter().reduce(f64::max);
    let energies: Vec<f64> = runs.iter().filter_map(|run| run.energy_j).collect();
    let alarms = runs.iter().filter(|run| run.overload_s > tolerated_s).count();
    let alarms = u32::try_from(alarms).unwrap_or(u32::MAX);
    SumBody {
        mean_duration_s: mean(&all(|run| run.duration_s)),
        mean_energy_j: mean(&energies),
        peak_feed_drive_percent: largest(|run| run.peak_feed_drive_percent),
        peak_spindle_percent: largest(|run| run.peak_spindle_percent),
        // Adding zero: a sum over nothing is −0.0.
        overload_s: runs.iter().map(|run| run.overload_s).sum::<f64>() + 0.0,
        alarms,
        alarms_per_thousand: share(f64::from(alarms) * 1000.0, runs.len()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_of_an_even_number_of_errors_lies_between_the_two_in_the_middle() {
        assert_eq!(spread(&[]), (None, None));
        assert_eq!(spread(&[0.5]), (Some(0.5), Some(0.5)));
        assert_eq!(spread(&[4.0, 1.0, 2.0]), (Some(2.0), Some(4.0)));
        assert_eq!(spread(&[8.0, 1.0, 3.0, 2.0]), (Some(2.5), Some(8.0)));
    }
}

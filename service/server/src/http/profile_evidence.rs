//! What real cycles say of a version: a shadow against what ran, and two versions against each other.

use super::compute::{compute, room};
use super::dto::profile_evidence::{
    ComparedBody, ComparisonAnswer, ComparisonQuery, MOST_SHADOW_CYCLES, PredictedBody, ShadowAnswer,
    ShadowQuery, USUAL_SHADOW_CYCLES,
};
use super::extract::{PathId, Query};
use super::feed_profiles::{line_of, version_of};
use super::problem::{Problem, ProblemDocument};
use super::what_if::run_all;
use crate::state::AppState;
use crate::what_if::Asked;
use axum::extract::State;
use feedwright_core::cycle::Extent;
use feedwright_core::feed::comparison::{AtWear, MOST_CYCLES, compare, compare_at_same_wear, wear_rate};
use feedwright_core::friction::twin::AxisLimits;
use feedwright_core::friction::whatif::LoadLimits;
use feedwright_core::ids::{MachineId, ProfileId, ToolId};
use feedwright_core::invalid::Violation;
use feedwright_core::summary::EnergyBasis;
use feedwright_core::units::Timestamp;
use feedwright_store::{CycleKey, StoredCycle, StoredProfileVersion};
use std::collections::{BTreeMap, HashMap};

/// Time with a load over its set load that counts as an alarm, s: what the optimiser allows too.
const TOLERATED_OVERLOAD_S: f64 = 0.05;
/// Override latency of the axis in the model; at 100 % it has no effect.
const LATENCY_IPO: u32 = 2;

/// Computes a version against the operation's last cycles: what happened, what it would have done, how wrong the model is.
///
/// Nothing of it is handed out. It also shows an active version, to compare with what still runs otherwise.
#[utoipa::path(get, path = "/v1/feed-profiles/{profile}/shadow", tag = "feed profiles",
    params(("profile" = String, Path), ShadowQuery),
    responses((status = 200, body = ShadowAnswer),
        (status = 409, description = "A draft: put it into shadow first (`not_in_shadow`)", body = ProblemDocument<'static>),
        (status = 503, description = "Other computations are under way", body = ProblemDocument<'static>)))]
pub(super) async fn shadow_report(
    State(state): State<AppState>,
    PathId(id): PathId<ProfileId>,
    Query(query): Query<ShadowQuery>,
) -> Result<axum::Json<ShadowAnswer>, Problem> {
    let most = query.cycles.unwrap_or(USUAL_SHADOW_CYCLES);
    if !(1..=MOST_SHADOW_CYCLES).contains(&most) {
        let why = format!("must be within 1 to {MOST_SHADOW_CYCLES}, is {most}");
        return Err(Violation::new("cycles", "out_of_range", why).into());
    }
    let line = line_of(&state, &id).await?;
    let stored = version_of(&state, &id, query.version.unwrap_or(line.newest)).await?;
    if stored.shadowed.is_none() {
        let why = "the version is a draft: put it into shadow, then it is computed against cycles";
        return Err(Problem::new(http::StatusCode::CONFLICT, "not_in_shadow", why));
    }
    let limits = stored.content.limits();
    let program = stored.content.program().map_err(|error| Problem::internal(error.to_string()))?;
    let asked = Asked {
        program: Some(program),
        profile: None,
        law: None,
        axis: AxisLimits { acceleration_mm_s2: limits.acceleration_mm_s2, override_latency_ipo: LATENCY_IPO },
        limits: LoadLimits {
            feed_drive_percent: limits.feed_drive_load_set_percent,
            spindle_percent: limits.spindle_load_set_percent,
        },
        tolerated_overload_s: TOLERATED_OVERLOAD_S,
        samples: false,
    };
    let room = room()?;
    let rows = state.store.recent_cycles(&line.operation, &line.tool_type, most).await?;
    let sum = run_all(&state, &room, rows, &asked, None, false).await?;
    Ok(axum::Json(ShadowAnswer {
        profile: id.to_string(),
        version: stored.version.version,
        state: stored.state.as_str(),
        time_s: stored.content.time_s(),
        cycles: sum.answer(None),
    }))
}

/// Compares two versions over the cycles that ran them: time, energy, peak loads and wear rate, with intervals; and each
/// version's own time with what its cycles took.
#[utoipa::path(get, path = "/v1/feed-profiles/{profile}/comparison", tag = "feed profiles",
    params(("profile" = String, Path), ComparisonQuery),
    responses((status = 200, body = ComparisonAnswer),
        (status = 503, description = "Other computations are under way", body = ProblemDocument<'static>)))]
pub(super) async fn comparison(
    State(state): State<AppState>,
    PathId(id): PathId<ProfileId>,
    Query(query): Query<ComparisonQuery>,
) -> Result<axum::Json<ComparisonAnswer>, Problem> {
    let line = line_of(&state, &id).await?;
    let after = query.after.or(line.active).ok_or_else(|| {
        Problem::invalid_query(Violation::new(
            "after",
            "missing_field",
            "no version is active: name the later one",
        ))
    })?;
    let sides = [side(&state, &id, query.before).await?, side(&state, &id, after).await?];
    compute(move || Ok(axum::Json(answer(&id, &sides)))).await
}

/// A version with the cycles that ran it.
struct Ran {
    stored: StoredProfileVersion,
    cycles: Vec<StoredCycle>,
    aborted: usize,
    cut_short: usize,
    /// Level of wear of each cycle's tool then, where it is known.
    levels: Vec<Option<f64>>,
}

/// Most tools whose wear is looked up.
const MOST_TOOLS: usize = 100;
/// Most cycles of one tool's life that are folded for it.
const MOST_FOLDED: u32 = 20_000;

/// Level of wear of each cycle's tool then; none of more tools than are looked up.
async fn levels(state: &AppState, cycles: &[StoredCycle]) -> Result<Vec<Option<f64>>, Problem> {
    let mut spans: BTreeMap<&ToolId, (Timestamp, Timestamp)> = BTreeMap::new();
    for row in cycles {
        let at = row.cycle.started_at;
        let span = spans.entry(&row.cycle.tool).or_insert((at, at));
        *span = (span.0.min(at), span.1.max(at));
    }
    let mut known: HashMap<CycleKey, f64> = HashMap::new();
    if spans.len() <= MOST_TOOLS {
        for (tool, (from, to)) in spans {
            // The end of a range is left out of it.
            let to = Timestamp::from_micros(to.micros().saturating_add(1));
            let points = state.store.levels(tool, from, to, MOST_FOLDED).await?;
            known.extend(points.into_iter().filter_map(|point| Some((point.key, point.level?))));
        }
    }
    let of = |row: &StoredCycle| {
        let key = (row.cycle.started_at, row.cycle.machine.clone(), row.cycle.id.clone());
        known.get(&key).copied()
    };
    Ok(cycles.iter().map(of).collect())
}

async fn side(state: &AppState, id: &ProfileId, version: u32) -> Result<Ran, Problem> {
    let stored = version_of(state, id, version).await?;
    let most = u32::try_from(MOST_CYCLES).unwrap_or(u32::MAX);
    let mut cycles = state.store.cycles_of_profile(&stored.version, most).await?;
    let extent = |row: &StoredCycle| Extent::of(row.cycle.outcome, row.summary.flags);
    let count = |wanted: Extent| cycles.iter().filter(|row| extent(row) == wanted).count();
    let (aborted, cut_short) = (count(Extent::Aborted), count(Extent::CutShort));
    cycles.retain(|row| extent(row) == Extent::Whole);
    let levels = levels(state, &cycles).await?;
    Ok(Ran { stored, aborted, cut_short, cycles, levels })
}

fn answer(id: &ProfileId, sides: &[Ran; 2]) -> ComparisonAnswer {
    let [before, after] = sides;
    let of = |quantity: &dyn Fn(&StoredCycle) -> Option<f64>| {
        let column = |ran: &Ran| ran.cycles.iter().filter_map(quantity).collect::<Vec<_>>();
        let worn = |ran: &Ran| {
            let both = |(row, level): (&StoredCycle, &Option<f64>)| {
                Some(AtWear { level: (*level)?, value: quantity(row)? })
            };
            ran.cycles.iter().zip(&ran.levels).filter_map(both).collect::<Vec<_>>()
        };
        let compared = compare(&column(before), &column(after));
        ComparedBody::new(compared, compare_at_same_wear(&worn(before), &worn(after)))
    };
    let scale = common_scale(sides);
    let joules = |row: &StoredCycle| joules(row, scale);
    let seconds = |row: &StoredCycle| row.summary.duration_ms.map(|ms| ms / 1000.0);
    let durations = |ran: &Ran| ran.cycles.iter().filter_map(seconds).collect::<Vec<_>>();
    let took = compare(&durations(before), &durations(after));
    let known = |ran: &Ran| ran.levels.iter().copied().flatten().collect::<Vec<_>>();
    let version = |ran: &Ran, actual: Option<feedwright_core::feed::comparison::Interval>| PredictedBody {
        version: ran.stored.version.version,
        time_s: ran.stored.content.time_s(),
        actual_s: actual.map(Into::into),
        wear_rate_per_thousand: wear_rate(&by_tool(ran, &joules)).map(Into::into),
    };
    ComparisonAnswer {
        profile: id.to_string(),
        versions: [version(before, took.before.median), version(after, took.after.median)],
        wear_level: ComparedBody::new(compare(&known(before), &known(after)), None),
        duration_s: of(&seconds),
        energy_joules: of(&joules),
        energy_basis: scale.map(|(basis, _)| basis.as_str()),
        peak_spindle_load_percent: of(&|row| row.summary.max_spindle_load_percent.map(|peak| peak.value)),
        peak_feed_drive_load_percent: of(&|row| {
            row.summary.max_feed_drive_load_percent.map(|peak| peak.value)
        }),
        aborted: [before.aborted, after.aborted],
        cut_short: [before.cut_short, after.cut_short],
    }
}

/// Energies of one basis and scale only: the one that both versions have most of.
type Scale = (EnergyBasis, i64);

fn scale_of(row: &StoredCycle) -> Option<Scale> {
    row.summary.best_energy().map(|energy| (energy.basis, row.summary.energy_scale))
}

fn common_scale([before, after]: &[Ran; 2]) -> Option<Scale> {
    let mut counts: BTreeMap<(&str, i64), (Scale, [usize; 2])> = BTreeMap::new();
    for (side, ran) in [before, after].into_iter().enumerate() {
        for scale in ran.cycles.iter().filter_map(scale_of) {
            counts.entry((scale.0.as_str(), scale.1)).or_insert((scale, [0; 2])).1[side] += 1;
        }
    }
    let (scale, [left, right]) = counts.into_values().max_by_key(|(_, [left, right])| *left.min(right))?;
    (left.min(right) > 0).then_some(scale)
}

fn joules(row: &StoredCycle, scale: Option<Scale>) -> Option<f64> {
    let is = scale_of(row)?;
    (scale == Some(is)).then(|| row.summary.best_energy().map(|energy| energy.total_joules))?
}

/// Each tool's energies on each machine, in the order of its cycles.
fn by_tool(ran: &Ran, joules: &impl Fn(&StoredCycle) -> Option<f64>) -> Vec<Vec<f64>> {
    let mut tools: BTreeMap<(&ToolId, &MachineId), Vec<f64>> = BTreeMap::new();
    for row in &ran.cycles {
        if let Some(energy) = joules(row) {
            tools.entry((&row.cycle.tool, &row.cycle.machine)).or_default().push(energy);
        }
    }
    tools.into_values().collect()
}

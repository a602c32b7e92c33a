//! How good the optimiser is: random cases on process models whose equations, parameters, noise and wear it does not
//! know, against a planner that knows everything.
//!
//! A case starts from a recorded cycle of a profile that a shop might run, and then tries what the optimiser proposes,
//! cycle after cycle. Everything follows from the seed.

mod coarse;
mod draw;
mod other;
mod paper;
mod plant;
mod reference;
#[cfg(test)]
mod tests;

pub use coarse::CoarseModel;
pub use draw::{AnyPlant, Case, Model, Start, draw};
pub use other::{Bump, OtherModel};
pub use paper::{PaperRow, paper_rows};
pub use plant::{Plant, Run, TwinPlant};
pub use reference::{Limits, Reference, reference};

use crate::cycle::Extent;
use crate::feed::optimise::{
    Actual, Bushing, Comparison, Heating, Knots, LoadSignal, RecordedCycle, Settings, SettingsParams,
    compare, optimise,
};
use crate::friction::error::Invalid;
use crate::friction::noise::Noise;
use crate::friction::program::Knot;
use crate::friction::relation::FeedSource;

/// Cycles that are tried after the recorded one.
pub const TRIALS: usize = 5;

/// Share of L_set that the planner with full knowledge may use.
pub const REFERENCE_MARGIN: f64 = 0.97;

/// Overload of a cycle: a filtered load above this many times L_set …
pub const OVERLOAD_FACTOR: f64 = 1.05;

/// … for longer than this, s.
pub const OVERLOAD_S: f64 = 0.05;

/// Variations that the planner with full knowledge tries.
pub const REFERENCE_TRIALS: usize = 1500;

/// A number that is not negative, as a count.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "not negative, saturating")]
fn steps(value: f64) -> usize {
    value.max(0.0).round() as usize
}

/// One tried cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Time without noise, s.
    pub duration_s: f64,
    /// Time with a filtered load above the tolerance, s, in the cycle as it ran.
    pub overload_s: f64,
    /// Largest filtered load over L_set without noise.
    pub worst_ratio: f64,
    /// Knots of the profile.
    pub knots: usize,
    /// Prediction beside what happened.
    pub comparison: Comparison,
}

/// What became of a case.
#[derive(Debug, Clone, PartialEq)]
pub struct CaseOutcome {
    /// The case's seed.
    pub seed: u64,
    /// Kind of start.
    pub start: Start,
    /// Time of the profile to start from, s.
    pub first_s: f64,
    /// Time of the planner with full knowledge, s.
    pub reference_s: f64,
    /// The tried cycles in order.
    pub trials: Vec<Trial>,
    /// Noise over what a shop typically sees.
    pub noise_factor: f64,
    /// Wear of the tool at the recorded cycle.
    pub wear: f64,
    /// Sampling, s.
    pub period_s: f64,
}

impl CaseOutcome {
    /// Time of a trial over the reference, minus 1.
    #[must_use]
    pub fn gap(&self, trial: usize) -> f64 {
        self.trials[trial].duration_s / self.reference_s - 1.0
    }
}

/// The settings of a case, as its shop would state them.
///
/// # Errors
/// Never with drawn limits; they are checked like any other.
pub fn settings(limits: &Limits) -> Result<Settings, Invalid> {
    Settings::new(SettingsParams {
        feed_min_mm_min: limits.feed_mm_min.0,
        feed_max_mm_min: limits.feed_mm_min.1,
        acceleration_mm_s2: limits.acceleration_mm_s2,
        heating: limits.heating.map(|(feed_mm_min, until_mm)| Heating {
            feed_mm_min,
            until_mm,
            may_shorten: false,
        }),
        bushing: limits.bushing.map(|(feed_mm_min, from_mm, to_mm)| Bushing { from_mm, to_mm, feed_mm_min }),
        ..SettingsParams::new("study", limits.end_mm, limits.set_percent[0], limits.set_percent[1])
    })
}

/// A run as a recorded cycle: what a machine posts, and nothing else.
#[must_use]
pub fn recorded(run: &Run, order: i64) -> RecordedCycle {
    RecordedCycle {
        id: format!("cycle-{order}"),
        operation: "study".to_owned(),
        order,
        extent: Extent::Whole,
        source: FeedSource::Programmed,
        wear_ratio: None,
        signal: LoadSignal::Raw,
        time_s: run.time_s.clone(),
        depth_mm: run.depth_mm.clone(),
        feed_mm_min: (!run.feed_mm_min.is_empty()).then(|| run.feed_mm_min.clone()),
        feed_drive_percent: run.load_percent[0].clone(),
        spindle_percent: run.load_percent[1].clone(),
    }
}

/// Runs a case against the planner with full knowledge, which varies its feed `reference_trials` times.
///
/// # Errors
/// When no feed keeps the loads, a hole cannot be finished, or the optimiser refuses.
pub fn run_case(case: &Case, reference_trials: usize) -> Result<CaseOutcome, Invalid> {
    let best = reference(&case.last_plant(), &case.limits, REFERENCE_MARGIN, reference_trials, case.seed)?;
    try_case(case, best.duration_s)
}

/// The recorded cycle, then [`TRIALS`] proposals, each tried once.
///
/// # Errors
/// When a hole cannot be finished, or the optimiser refuses.
pub fn try_case(case: &Case, reference_s: f64) -> Result<CaseOutcome, Invalid> {
    let limits = &case.limits;
    let settings = settings(limits)?;
    let case = &case.quickened(reference_s)?;
    let mut noise = Noise::seeded(case.seed ^ 0x5eed);
    let first_s = case.plant.drill(&case.first, None)?.duration_s;
    let mut cycles = vec![recorded(&case.plant.drill(&case.first, Some(&mut noise))?, 0)];
    let mut last = Knots::new(case.first.clone())?;
    let mut trials = Vec::with_capacity(TRIALS);
    for order in (1..).take(TRIALS) {
        let proposal = optimise(&cycles, &settings, Some(&last))?;
        let knots = proposal.knots.as_slice();
        let plant = case.plant_at(cycles.len());
        let quiet = plant.drill(knots, None)?;
        let run = plant.drill(knots, Some(&mut noise))?;
        let cycle = recorded(&run, order);
        let actual = Actual::of(&cycle, &settings, proposal.idle_percent[1])?;
        trials.push(Trial {
            duration_s: quiet.duration_s,
            overload_s: run.overload_s(limits.set_percent, OVERLOAD_FACTOR),
            worst_ratio: quiet.worst_ratio(limits.set_percent),
            knots: knots.len(),
            comparison: compare(&proposal.prediction, &actual, &settings),
        });
        cycles.push(cycle);
        last = proposal.knots;
    }
    Ok(CaseOutcome {
        seed: case.seed,
        start: case.start,
        first_s,
        reference_s,
        trials,
        noise_factor: case.noise_factor,
        wear: case.wear,
        period_s: case.period_s,
    })
}

/// The study's figures over many cases.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Cases.
    pub cases: usize,
    /// Median and 95th percentile of the last trial's gap to the reference, relative.
    pub gap_median_p95: (f64, f64),
    /// Medians of the gap after each trial.
    pub gap_by_trial: Vec<f64>,
    /// 95th percentiles of the gap after each trial.
    pub p95_by_trial: Vec<f64>,
    /// Tried cycles with an overload.
    pub overloaded: usize,
    /// Tried cycles.
    pub tried: usize,
    /// Most knots of a tried profile.
    pub most_knots: usize,
    /// Share of loads' figures that lay in their predicted 90 % bands.
    pub coverage: f64,
}

/// Sums up outcomes.
#[must_use]
pub fn summarise(outcomes: &[CaseOutcome]) -> Summary {
    let quantile = |trial: usize, share: f64| {
        let mut gaps: Vec<f64> = outcomes.iter().map(|one| one.gap(trial)).collect();
        gaps.sort_by(f64::total_cmp);
        gaps.get(steps((gaps.len().saturating_sub(1)) as f64 * share)).copied().unwrap_or(0.0)
    };
    let trials = || outcomes.iter().flat_map(|one| &one.trials);
    let comparisons: Vec<Comparison> = trials().map(|trial| trial.comparison).collect();
    Summary {
        cases: outcomes.len(),
        gap_median_p95: (quantile(TRIALS - 1, 0.5), quantile(TRIALS - 1, 0.95)),
        gap_by_trial: (0..TRIALS).map(|trial| quantile(trial, 0.5)).collect(),
        p95_by_trial: (0..TRIALS).map(|trial| quantile(trial, 0.95)).collect(),
        overloaded: trials().filter(|trial| trial.overload_s > OVERLOAD_S + 1e-9).count(),
        tried: trials().count(),
        most_knots: trials().map(|trial| trial.knots).max().unwrap_or(0),
        coverage: crate::feed::optimise::coverage(&comparisons).map_or(0.0, |(share, _)| share),
    }
}

/// Knots of a profile as a table for a person.
#[must_use]
pub fn table(knots: &[Knot]) -> String {
    knots
        .iter()
        .map(|knot| format!("{:.2}:{:.0}", knot.depth_mm, knot.feed_mm_min))
        .collect::<Vec<_>>()
        .join(" ")
}

//! A plan over the whole life of an edge: gentler early intervals where they pay later.
//!
//! The most metal for a given price of time is a dynamic programme over (interval, wear); the largest ratio of metal
//! to time comes from repeating it with the ratio just reached as the price (Dinkelbach 1967). Values are kept on
//! evenly spaced wear nodes, but the plan itself is rolled out with exact wear, so it always keeps the limits; and
//! it is only returned where it beats the greedy plan.

use super::domain::Domain;
use super::grid::PairTable;
use super::job::Accumulation;
use super::plan::{EndOfLife, MAX_INTERVALS, Plan, SAMPLES, greedy_with, replay};
use super::select::{Binding, Chosen, Selector};
use super::{EdgeState, Job};

/// Wear steps between the start and the wear limit; twice as many give the same plans for the paper's job.
const WEAR_STEPS: u16 = 128;

/// Rounds of repricing; the ratio converges superlinearly, in 2 to 4.
const REPRICING_ROUNDS: usize = 8;

/// Most speeds and feeds looked at; a finer grid is thinned, since time grows with the pairs.
const MOST_SPEEDS: usize = 40;
const MOST_FEEDS: usize = 120;

/// What a whole-life plan is best at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Objective {
    /// Most metal in the cutting time of the greedy plan.
    RemovalInGreedyTime,
    /// Most metal per minute, tool change counted.
    OverallRemoval,
    /// Least cost per volume, from machine time, tool change and edge.
    Cost,
}

/// A whole-life plan beside the greedy one.
#[derive(Debug, Clone, PartialEq)]
pub struct WholeLife {
    /// The plan; the greedy one itself where nothing better was found.
    pub plan: Plan,
    /// The paper's plan for the same job.
    pub greedy: Plan,
    /// Relative gain in the objective, ≥ 0; 0.05 means 5 % more metal, more metal per minute, or metal per cost.
    pub gain: f64,
    /// The same for the same two sequences of pairs when wear goes on from its state ([`Accumulation::State`]).
    ///
    /// Eq. 4 ties the fast wear of a new edge to the clock, so a plan gains there by idling through the first
    /// minutes. What remains here does not depend on that reading; zero or less means: do not count on the gain.
    pub gain_by_state: f64,
}

/// One pair with what the programme asks of it.
#[derive(Clone, Copy)]
struct Action {
    pair: usize,
    /// Removed in an interval, mm³.
    volume: f64,
    severity: f64,
    capacity: f64,
}

struct Actions {
    table: PairTable,
    /// Most removal first.
    ranked: Vec<Action>,
    least_severity: f64,
}

impl Actions {
    fn new(job: &Job) -> Self {
        let table = match job.domain() {
            Domain::Grid { speeds_m_min, feeds_mm_rev } => {
                PairTable::new(job, &thinned(speeds_m_min, MOST_SPEEDS), &thinned(feeds_mm_rev, MOST_FEEDS))
            }
            Domain::Continuous { speed_m_min, feed_mm_rev } => {
                PairTable::sampled(job, *speed_m_min, *feed_mm_rev, SAMPLES)
            }
        };
        let mut ranked: Vec<Action> = (0..table.len())
            .map(|pair| Action {
                pair,
                volume: job.removal_mm3_min(table.cut(pair)) * job.interval_min(),
                severity: table.severity(pair),
                capacity: table.capacity(pair),
            })
            .collect();
        ranked.sort_by(|a, b| b.volume.total_cmp(&a.volume).then(a.severity.total_cmp(&b.severity)));
        // A pair that removes no more, wears no less and bears no more than another one is never the best choice.
        let mut kept: Vec<Action> = Vec::new();
        for action in ranked {
            let beaten =
                |other: &Action| other.severity <= action.severity && other.capacity >= action.capacity;
            if !kept.iter().any(beaten) {
                kept.push(action);
            }
        }
        let ranked = kept;
        let least_severity = ranked.iter().map(|a| a.severity).fold(f64::INFINITY, f64::min);
        Self { table, ranked, least_severity }
    }

    /// Best pair and its value from `wear_mm` on, each interval costing `price`; none when stopping is better.
    fn best(&self, worn: f64, gain: f64, price: f64, next: &Values<'_>) -> Option<(usize, f64)> {
        let mut best = None;
        let mut most = 0.0;
        let ahead = next.at(worn + gain * self.least_severity);
        for &Action { pair, volume, severity, capacity } in &self.ranked {
            // More wear never pays later, so the gentlest pair's future bounds every pair's.
            if volume - price + ahead <= most {
                break;
            }
            let after = worn + gain * severity;
            if after > capacity {
                continue;
            }
            let value = volume - price + next.at(after);
            if value > most {
                most = value;
                best = Some((pair, value));
            }
        }
        best
    }
}

fn thinned(axis: &[f64], most: usize) -> Vec<f64> {
    let stride = axis.len().div_ceil(most);
    // Counted from the top: the largest values must stay.
    let mut kept: Vec<f64> = axis.iter().rev().step_by(stride).copied().collect();
    kept.reverse();
    kept
}

/// Values of one interval over the wear nodes.
struct Values<'a> {
    nodes: &'a [f64],
    first: f64,
    per_unit: f64,
}

impl Values<'_> {
    fn at(&self, worn: f64) -> f64 {
        let position = ((worn - self.first) * self.per_unit).clamp(0.0, f64::from(WEAR_STEPS));
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to 0..=WEAR_STEPS"
        )]
        let low = (position as usize).min(usize::from(WEAR_STEPS) - 1);
        #[expect(clippy::cast_precision_loss, reason = "low ≤ WEAR_STEPS")]
        let share = position - low as f64;
        self.nodes[low] + share * (self.nodes[low + 1] - self.nodes[low])
    }
}

/// Plans the whole life of an edge for one objective.
///
/// Looks at most two greedy lives and eight intervals ahead. The result is never worse than the greedy plan.
#[must_use]
pub fn whole_life_plan(job: &Job, start: EdgeState, objective: Objective) -> WholeLife {
    let selector = Selector::new(job);
    let greedy = greedy_with(job, &selector, start);
    if greedy.intervals.is_empty() {
        return WholeLife { plan: greedy.clone(), greedy, gain: 0.0, gain_by_state: 0.0 };
    }
    let horizon = match objective {
        Objective::RemovalInGreedyTime => greedy.intervals.len(),
        Objective::OverallRemoval | Objective::Cost => (2 * greedy.intervals.len() + 8).min(MAX_INTERVALS),
    };
    let actions = Actions::new(job);
    let overhead_min = overhead_min(job, objective);
    let worth = |plan: &Plan| match overhead_min {
        Some(overhead) => plan.totals.removed_mm3 / (plan.totals.cutting_min + overhead),
        None => plan.totals.removed_mm3,
    };
    let mut best = greedy.clone();
    for _ in 0..REPRICING_ROUNDS {
        let price = overhead_min.map_or(0.0, |_| worth(&best) * job.interval_min());
        let plan = solve(job, &selector, &actions, start, horizon, price);
        if plan.intervals.is_empty() || worth(&plan) <= worth(&best) * (1.0 + 1e-9) {
            break;
        }
        best = plan;
        if overhead_min.is_none() {
            break;
        }
    }
    let gain = worth(&best) / worth(&greedy) - 1.0;
    let by_state = job.with_accumulation(Accumulation::State);
    let replayed = |plan: &Plan| worth(&replay(&by_state, start, plan.intervals.iter().map(|i| i.cut)));
    let gain_by_state = match (replayed(&best), replayed(&greedy)) {
        (plan, greedy) if greedy > 0.0 => plan / greedy - 1.0,
        _ => 0.0,
    };
    WholeLife { plan: best, greedy, gain, gain_by_state }
}

/// Time that the objective charges to each edge besides cutting, min; none where time is not priced.
fn overhead_min(job: &Job, objective: Objective) -> Option<f64> {
    let economics = job.economics();
    match objective {
        Objective::RemovalInGreedyTime => None,
        Objective::OverallRemoval => Some(economics.tool_change_min),
        // Cost per volume is machine cost × (time + edge cost / machine cost) / volume.
        Objective::Cost if economics.machine_cost_per_min > 0.0 => {
            Some(economics.tool_change_min + economics.edge_cost / economics.machine_cost_per_min)
        }
        Objective::Cost => None,
    }
}

fn solve(
    job: &Job,
    selector: &Selector<'_>,
    actions: &Actions,
    start: EdgeState,
    horizon: usize,
    price: f64,
) -> Plan {
    let nodes = usize::from(WEAR_STEPS) + 1;
    let first = job.measure(start.wear_mm());
    let span = (job.measure(job.limits().wear_mm) - first).max(f64::MIN_POSITIVE);
    let per_unit = f64::from(WEAR_STEPS) / span;
    let gains: Vec<f64> = (0..horizon)
        .scan(start.elapsed_min(), |elapsed, _| {
            let gain = job.wear_gain(*elapsed);
            *elapsed += job.interval_min();
            Some(gain)
        })
        .collect();
    // No plan is less worn by then than the gentlest one: nodes below need no value.
    let gentlest: Vec<f64> = gains
        .iter()
        .scan(first, |worn, gain| {
            let now = *worn;
            *worn += gain * actions.least_severity;
            Some(now)
        })
        .collect();
    let mut values = vec![0.0; (horizon + 1) * nodes];
    for (interval, &gain) in gains.iter().enumerate().rev() {
        let (now, later) = values.split_at_mut((interval + 1) * nodes);
        let next = Values { nodes: &later[..nodes], first, per_unit };
        for (step, value) in (0..=WEAR_STEPS).zip(&mut now[interval * nodes..]) {
            let worn = first + f64::from(step) / per_unit;
            if worn + 1.0 / per_unit < gentlest[interval] {
                continue;
            }
            *value = actions.best(worn, gain, price, &next).map_or(0.0, |(_, value)| value);
        }
    }
    let mut state = start;
    let mut intervals = Vec::new();
    for (interval, &gain) in gains.iter().enumerate() {
        let next = Values { nodes: &values[(interval + 1) * nodes..(interval + 2) * nodes], first, per_unit };
        let Some((pair, _)) = actions.best(job.measure(state.wear_mm()), gain, price, &next) else { break };
        let chosen = explained(job, selector, &actions.table, state, pair);
        state = chosen.after();
        intervals.push(chosen);
    }
    let end = match selector.choose(state) {
        Ok(_) => EndOfLife::Exchange,
        Err(limit) => EndOfLife::Limit(limit),
    };
    Plan::new(job, start, intervals, end)
}

fn explained(job: &Job, selector: &Selector<'_>, table: &PairTable, state: EdgeState, pair: usize) -> Chosen {
    let mut chosen = selector.with_broken_limit(table, state, pair);
    let fastest = selector.choose(state).map_or(0.0, |fastest| job.removal_mm3_min(fastest.cut));
    if fastest > chosen.outcome.removal_mm3_min * (1.0 + 1e-9) {
        chosen.binding = Binding::Life;
    }
    chosen
}

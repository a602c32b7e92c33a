//! A plan to the end of the edge's life, and the run at fixed parameters it is measured against.

use super::domain::Domain;
use super::grid::PairTable;
use super::job::Accumulation;
use super::select::{Binding, Chosen, Limit, Selector};
use super::{Cut, EdgeState, Job, Outside};

/// Most intervals of a plan: an edge that outlives it is limited by something the models do not know.
pub const MAX_INTERVALS: usize = 2_000;

/// Sampling of a continuous domain where pairs have to be enumerated.
pub(super) const SAMPLES: (u32, u32) = (32, 56);

/// Why a run ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EndOfLife {
    /// Every further interval would break this limit.
    Limit(Limit),
    /// A new edge pays more than going on with this one.
    Exchange,
    /// [`MAX_INTERVALS`] was reached.
    Horizon,
}

/// Sums over a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Totals {
    /// Cutting time, min.
    pub cutting_min: f64,
    /// Metal removed, mm³.
    pub removed_mm3: f64,
    /// Metal removed per minute of cutting, mm³/min; none for an empty run.
    pub mean_removal_mm3_min: Option<f64>,
    /// Metal removed per minute with the tool change counted, mm³/min; none when no time passes.
    pub overall_removal_mm3_min: Option<f64>,
    /// Machine time with the tool change, and the edge, in the job's currency.
    pub cost: f64,
    /// Cost per cm³ removed; none for an empty run.
    pub cost_per_cm3: Option<f64>,
    /// Wear at the end, mm.
    pub wear_mm: f64,
    /// Highest power, kW.
    pub peak_power_kw: f64,
    /// Highest force, N.
    pub peak_force_n: f64,
}

/// Intervals from a state of the edge to its end.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// In order of time.
    pub intervals: Vec<Chosen>,
    /// Sums over them.
    pub totals: Totals,
    /// Why it ends.
    pub end: EndOfLife,
    /// Whether any interval extrapolates the library entry.
    pub outside: Outside,
}

impl Plan {
    pub(super) fn new(job: &Job, start: EdgeState, intervals: Vec<Chosen>, end: EndOfLife) -> Self {
        let minutes = job.interval_min();
        let mut totals = Totals {
            cutting_min: 0.0,
            removed_mm3: 0.0,
            mean_removal_mm3_min: None,
            overall_removal_mm3_min: None,
            cost: 0.0,
            cost_per_cm3: None,
            wear_mm: start.wear_mm(),
            peak_power_kw: 0.0,
            peak_force_n: 0.0,
        };
        let mut outside = Outside::default();
        for interval in &intervals {
            totals.cutting_min += minutes;
            totals.removed_mm3 += interval.outcome.removal_mm3_min * minutes;
            totals.wear_mm = interval.outcome.wear_mm;
            totals.peak_power_kw = totals.peak_power_kw.max(interval.outcome.power_kw);
            totals.peak_force_n = totals.peak_force_n.max(interval.outcome.force_n);
            outside = outside.or(interval.outside);
        }
        let economics = job.economics();
        let machine_min = totals.cutting_min + economics.tool_change_min;
        totals.cost = machine_min * economics.machine_cost_per_min + economics.edge_cost;
        if !intervals.is_empty() {
            totals.mean_removal_mm3_min = Some(totals.removed_mm3 / totals.cutting_min);
            totals.overall_removal_mm3_min = Some(totals.removed_mm3 / machine_min);
            totals.cost_per_cm3 = Some(totals.cost / (totals.removed_mm3 / 1000.0));
        }
        Self { intervals, totals, end, outside }
    }
}

/// The paper's strategy: each interval takes the pair of largest removal rate, until none is left.
#[must_use]
pub fn greedy_plan(job: &Job, start: EdgeState) -> Plan {
    let selector = Selector::new(job);
    greedy_with(job, &selector, start)
}

pub(super) fn greedy_with(job: &Job, selector: &Selector<'_>, start: EdgeState) -> Plan {
    let mut intervals = Vec::new();
    let mut state = start;
    let end = loop {
        if intervals.len() == MAX_INTERVALS {
            break EndOfLife::Horizon;
        }
        match selector.choose(state) {
            Ok(chosen) => {
                state = chosen.after();
                intervals.push(chosen);
            }
            Err(limit) => break EndOfLife::Limit(limit),
        }
    };
    Plan::new(job, start, intervals, end)
}

/// Given pairs, one per interval, ended before the first interval that would break a limit.
pub(super) fn replay(job: &Job, start: EdgeState, cuts: impl Iterator<Item = Cut>) -> Plan {
    let mut intervals = Vec::new();
    let mut state = start;
    let mut end = EndOfLife::Exchange;
    for cut in cuts.take(MAX_INTERVALS) {
        let next = Chosen::new(job, state, cut, Binding::Given);
        if let Some(limit) = next.utilisation.exceeded() {
            end = EndOfLife::Limit(limit);
            break;
        }
        state = next.after();
        intervals.push(next);
    }
    if intervals.len() == MAX_INTERVALS {
        end = EndOfLife::Horizon;
    }
    Plan::new(job, start, intervals, end)
}

/// One pair for the whole life, ended before the first interval that would break a limit.
#[must_use]
pub fn fixed_run(job: &Job, start: EdgeState, cut: Cut) -> Plan {
    replay(job, start, std::iter::repeat(cut))
}

/// The fixed pair with the largest removal per minute, tool change counted: the hardest run to beat.
///
/// A continuous domain is sampled at 32 × 56 pairs. None when no pair survives one interval.
#[must_use]
pub fn best_fixed_run(job: &Job, start: EdgeState) -> Option<Plan> {
    let selector = Selector::new(job);
    let sampled;
    let table = match (selector.table(), job.domain()) {
        (Some(table), _) => table,
        (None, Domain::Continuous { speed_m_min, feed_mm_rev }) => {
            sampled = PairTable::sampled(job, *speed_m_min, *feed_mm_rev, SAMPLES);
            &sampled
        }
        (None, Domain::Grid { .. }) => return None,
    };
    let best = (0..table.len())
        .filter_map(|pair| {
            let rate = fixed_rate(job, table, start, pair);
            (rate > 0.0).then_some((pair, rate))
        })
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(fixed_run(job, start, table.cut(best.0)))
}

fn fixed_rate(job: &Job, table: &PairTable, start: EdgeState, pair: usize) -> f64 {
    let minutes = job.interval_min();
    let room = table.capacity(pair) - job.measure(start.wear_mm());
    if room < 0.0 {
        return 0.0;
    }
    let first = job.wear_gain(start.elapsed_min()) * table.severity(pair);
    let fitting = match job.accumulation() {
        Accumulation::State => room / first,
        // Increments of Eq. 5 telescope at a fixed pair, so the last minute follows without a loop.
        Accumulation::ElapsedTime => {
            let exponent = job.model().data().wear.time_exponent;
            let begun = start.elapsed_min().powf(exponent);
            let scale = first / ((start.elapsed_min() + minutes).powf(exponent) - begun);
            ((room / scale + begun).powf(1.0 / exponent) - start.elapsed_min()) / minutes
        }
    };
    #[expect(clippy::cast_precision_loss, reason = "the bound is far below 2^53")]
    let intervals = (fitting + 1e-9).floor().clamp(0.0, MAX_INTERVALS as f64);
    let cutting_min = intervals * minutes;
    if cutting_min <= 0.0 {
        return 0.0;
    }
    job.removal_mm3_min(table.cut(pair)) * cutting_min / (cutting_min + job.economics().tool_change_min)
}

/// A plan measured against another run, as ratios plan to other; none where the other is empty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Comparison {
    /// Metal removed in one life.
    pub removed: Option<f64>,
    /// Metal removed per minute of cutting.
    pub mean_removal: Option<f64>,
    /// Metal removed per minute, tool change counted.
    pub overall_removal: Option<f64>,
    /// Cutting time of one life.
    pub cutting_time: Option<f64>,
    /// Cost per cm³.
    pub cost_per_cm3: Option<f64>,
}

/// Compares a plan with another run of the same job.
#[must_use]
pub fn compare(plan: &Plan, other: &Plan) -> Comparison {
    let ratio = |a: f64, b: f64| (b > 0.0).then(|| a / b);
    let both = |a: Option<f64>, b: Option<f64>| a.zip(b).and_then(|(a, b)| ratio(a, b));
    Comparison {
        removed: ratio(plan.totals.removed_mm3, other.totals.removed_mm3),
        mean_removal: both(plan.totals.mean_removal_mm3_min, other.totals.mean_removal_mm3_min),
        overall_removal: both(plan.totals.overall_removal_mm3_min, other.totals.overall_removal_mm3_min),
        cutting_time: ratio(plan.totals.cutting_min, other.totals.cutting_min),
        cost_per_cm3: both(plan.totals.cost_per_cm3, other.totals.cost_per_cm3),
    }
}

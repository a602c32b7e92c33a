//! What a profile is expected to do, with bands.

use super::plan::{FILTER_LAG_SAMPLES, LagFilter, Planner, normal_quantile};
use super::relation::MEMORY_S;
use crate::friction::program::Knot;

/// Share of cycles that a band holds.
pub(super) const BAND: f64 = 0.9;

/// Relative standard deviation of the time: the axis rounds corners, the control's clock its samples.
const TIME_SD: f64 = 0.01;

/// A value with the range that nine cycles in ten are expected in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    /// Lower end.
    pub low: f64,
    /// Expected value.
    pub expected: f64,
    /// Upper end.
    pub high: f64,
}

impl Band {
    /// A band of relative standard deviation `sd` around `expected`, log-normal.
    pub(super) fn around(expected: f64, sd: f64) -> Self {
        let z = normal_quantile(0.5 + BAND / 2.0);
        Self { low: expected * (-z * sd).exp(), expected, high: expected * (z * sd).exp() }
    }

    /// Whether a value lies in it.
    #[must_use]
    pub fn holds(&self, value: f64) -> bool {
        value >= self.low && value <= self.high
    }

    /// Standard deviations (of ln) that a value lies above the expected one.
    pub(super) fn deviation(&self, value: f64) -> Option<f64> {
        let z = normal_quantile(0.5 + BAND / 2.0);
        let sd = (self.high / self.low).ln() / (2.0 * z);
        (value > 0.0 && self.expected > 0.0 && sd > 0.0).then(|| (value / self.expected).ln() / sd)
    }
}

/// What one cycle of a profile is expected to show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// From contact to the end of the path, s.
    pub time_s: Band,
    /// Largest filtered feed-drive load, percent.
    pub peak_feed_drive_percent: Band,
    /// Largest filtered spindle load, percent.
    pub peak_spindle_percent: Band,
    /// Spindle load over idle times time, percent-seconds.
    pub spindle_percent_s: Band,
    /// The same as energy, J, where the settings say what a percent stands for.
    pub energy_j: Option<Band>,
}

/// What is expected at one node.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Expected {
    pub(super) feed: f64,
    pub(super) time_s: f64,
    /// Spindle load over idle before the filter, percent.
    pub(super) spindle: f64,
    /// Filtered loads with the idle load, percent; `None` where nothing is known.
    pub(super) load: Option<[f64; 2]>,
    /// Standard deviation of ln load over idle: of what is expected, per drive.
    pub(super) known_sd: [f64; 2],
    pub(super) cycle_sd: [f64; 2],
}

/// Follows a feed over depth node by node.
pub(super) fn follow(planner: &Planner<'_>, knots: &[Knot], more_wear: f64) -> Vec<Expected> {
    let relation = planner.relation;
    let grid = &relation.grid;
    let mut all: Vec<Expected> = Vec::with_capacity(grid.count());
    let mut heat = 0.0;
    let mut filters = [LagFilter::default(); 2];
    let lag = FILTER_LAG_SAMPLES / 2.0 * relation.period_s;
    for node in 0..grid.count() {
        let programmed = super::profile::feed_at(knots, grid.depth_mm(node));
        let feed = planner.acting_feed(programmed, all.last().map(|before| before.feed));
        let time_s = all.last().map_or(0.0, |before| grid.step_mm() * 120.0 / (feed + before.feed));
        let mut expected = Expected { feed, time_s, ..Expected::default() };
        heat *= (-time_s / MEMORY_S).exp();
        if let Some(known) = &relation.nodes[node] {
            let loads =
                [0, 1].map(|drive| relation.load(known, drive, feed.ln(), relation.phi(heat), more_wear));
            let means = loads.map(|load| load.mean.exp());
            expected.spindle = means[1];
            heat += super::relation::heat_rate(means[1]) * time_s;
            expected.load = Some(
                [0, 1].map(|drive| filters[drive].step(means[drive], time_s, lag) + relation.idle[drive]),
            );
            expected.known_sd = loads.map(|load| load.known_sd);
            expected.cycle_sd = loads.map(|load| load.cycle_sd);
        }
        all.push(expected);
    }
    all
}

/// The prediction for knots whose feeds are acting ones.
pub(super) fn predict(planner: &Planner<'_>, knots: &[Knot]) -> Prediction {
    let nodes = follow(planner, knots, 0.0);
    let idle = planner.relation.idle;
    let time: f64 = nodes.iter().map(|node| node.time_s).sum();
    let mut work = 0.0;
    let mut work_sd = 0.0;
    for node in &nodes {
        let step = node.spindle * node.time_s;
        work += step;
        work_sd += step * node.known_sd[1];
    }
    let common = planner.relation.noise[1].common;
    let work_sd = if work > 0.0 { (work_sd / work).hypot(common) } else { common };
    let spindle_percent_s = Band::around(work, work_sd);
    let energy_j = planner.settings.watts_per_percent.map(|watts| Band {
        low: spindle_percent_s.low * watts,
        expected: spindle_percent_s.expected * watts,
        high: spindle_percent_s.high * watts,
    });
    Prediction {
        time_s: Band::around(time, TIME_SD),
        peak_feed_drive_percent: peak(&nodes, 0, idle[0]),
        peak_spindle_percent: peak(&nodes, 1, idle[1]),
        spindle_percent_s,
        energy_j,
    }
}

/// The largest of many uneven loads: each node is uneven for itself over the unevenness's length, so the largest lies
/// above the largest expected one. Found from the probability that no node exceeds a load.
fn peak(nodes: &[Expected], drive: usize, idle: f64) -> Band {
    let known: Vec<(f64, f64, f64)> = nodes
        .iter()
        .filter_map(|node| {
            let over = node.load?[drive] - idle;
            Some((over.max(1e-6).ln(), node.cycle_sd[drive].max(1e-3), node.time_s))
        })
        .collect();
    let top = known.iter().map(|one| one.0 + 3.5 * one.1).fold(f64::NEG_INFINITY, f64::max);
    let floor = known.iter().map(|one| one.0 - 3.5 * one.1).fold(f64::NEG_INFINITY, f64::max);
    if !top.is_finite() {
        return Band { low: idle, expected: idle, high: idle };
    }
    let below = |ln_load: f64| -> f64 {
        known
            .iter()
            .map(|&(mean, sd, time)| {
                let p = super::plan::normal_probability((ln_load - mean) / sd).max(1e-12);
                p.ln() * (time / super::plan::UNEVEN_S).min(1.0)
            })
            .sum::<f64>()
            .exp()
    };
    let at = |p: f64| {
        let (mut low, mut high) = (floor - 0.5, top + 0.5);
        for _ in 0..40 {
            let middle = f64::midpoint(low, high);
            if below(middle) < p { low = middle } else { high = middle }
        }
        idle + f64::midpoint(low, high).exp()
    };
    Band { low: at(0.5 - BAND / 2.0), expected: at(0.5), high: at(0.5 + BAND / 2.0) }
}

//! Search of one interval over a grid of speeds and feeds.
//!
//! For one pair, power and force rise with wear, so each pair has a greatest wear it may end an interval with. In
//! power laws that capacity factors into a power of V times a power of f: the table costs a few hundred powers to
//! build, and an interval after that a multiplication and a comparison per pair.

use super::domain::Range;
use super::{Cut, EdgeState, Job, LoadLaw};

/// Rounding that the factored capacity may differ by from the power laws it stands for.
const CAPACITY_SLACK: f64 = 1e-12;

/// Relative difference under which two removal rates count as equal.
const TIE: f64 = 1e-12;

/// Pairs of a grid with what does not depend on the state of the edge.
#[derive(Debug, Clone)]
pub(super) struct PairTable {
    speeds: Vec<f64>,
    feeds: Vec<f64>,
    severity: Vec<f64>,
    capacity: Vec<f64>,
}

impl PairTable {
    pub(super) fn new(job: &Job, speeds: &[f64], feeds: &[f64]) -> Self {
        let data = job.model().data();
        let powers =
            |axis: &[f64], exponent: f64| -> Vec<f64> { axis.iter().map(|x| x.powf(exponent)).collect() };
        // Severity and capacity are kept in the measure that intervals add to.
        let power = job.measure_power();
        let wear = (
            powers(speeds, data.wear.speed_exponent * power),
            powers(feeds, data.wear.feed_exponent * power),
        );
        let capacity = |law: &LoadLaw, limit: f64| {
            let e = law.wear_exponent / power;
            let scale = limit / (law.coefficient * job.depth_ratio().powf(law.depth_exponent));
            let v: Vec<f64> = powers(speeds, -law.speed_exponent / e);
            let f: Vec<f64> = powers(feeds, -law.feed_exponent / e);
            (scale.powf(1.0 / e) * (1.0 - CAPACITY_SLACK), v, f)
        };
        let (drive, drive_v, drive_f) = capacity(&data.power, job.limits().power_kw);
        let (force, force_v, force_f) = capacity(&data.force, job.limits().force_n);
        let by_wear =
            job.measure(job.limits().wear_mm) * if power > 1.0 { 1.0 - CAPACITY_SLACK } else { 1.0 };
        let mut severity = Vec::with_capacity(speeds.len() * feeds.len());
        let mut capacities = Vec::with_capacity(severity.capacity());
        for i in 0..speeds.len() {
            for j in 0..feeds.len() {
                severity.push(wear.0[i] * wear.1[j]);
                let by_power = drive * drive_v[i] * drive_f[j];
                let by_force = force * force_v[i] * force_f[j];
                // Powers of an extreme entry can overflow against each other: such a pair is never feasible.
                let usable = !by_power.is_nan() && !by_force.is_nan();
                capacities.push(if usable { by_wear.min(by_power).min(by_force) } else { 0.0 });
            }
        }
        Self { speeds: speeds.to_vec(), feeds: feeds.to_vec(), severity, capacity: capacities }
    }

    /// Table over a continuous domain, spaced evenly in the logarithm.
    pub(super) fn sampled(job: &Job, speed: Range, feed: Range, counts: (u32, u32)) -> Self {
        let spread = |range: Range, count: u32| -> Vec<f64> {
            let ratio = (range.max / range.min).ln() / f64::from(count - 1);
            let mut values: Vec<f64> = (0..count).map(|i| range.min * (ratio * f64::from(i)).exp()).collect();
            // The ends must be reachable exactly: an optimum often sits there.
            values[count as usize - 1] = range.max;
            values
        };
        Self::new(job, &spread(speed, counts.0), &spread(feed, counts.1))
    }

    pub(super) const fn len(&self) -> usize {
        self.severity.len()
    }

    pub(super) fn speeds(&self) -> &[f64] {
        &self.speeds
    }

    pub(super) fn severity(&self, pair: usize) -> f64 {
        self.severity[pair]
    }

    pub(super) fn capacity(&self, pair: usize) -> f64 {
        self.capacity[pair]
    }

    pub(super) fn cut(&self, pair: usize) -> Cut {
        let columns = self.feeds.len();
        Cut { speed_m_min: self.speeds[pair / columns], feed_mm_rev: self.feeds[pair % columns] }
    }

    /// The pair one feed step up and the pair one speed step up, where the grid has them.
    pub(super) fn steps_up(&self, pair: usize) -> [Option<Cut>; 2] {
        let columns = self.feeds.len();
        let feed = (pair % columns + 1 < columns).then(|| self.cut(pair + 1));
        let speed = (pair / columns + 1 < self.speeds.len()).then(|| self.cut(pair + columns));
        [feed, speed]
    }

    /// Greatest feasible feed at one speed; wear, power and force all rise with the feed.
    pub(super) fn best_at_speed(&self, job: &Job, state: EdgeState, speed: usize) -> Option<usize> {
        let gain = job.wear_gain(state.elapsed_min());
        let worn = job.measure(state.wear_mm());
        self.row(speed).rev().find(|&pair| self.feasible(pair, worn, gain))
    }

    /// Feasible pair of the largest removal rate; of equal ones the one that wears least.
    pub(super) fn best(&self, job: &Job, state: EdgeState) -> Option<usize> {
        let gain = job.wear_gain(state.elapsed_min());
        let worn = job.measure(state.wear_mm());
        let mut best: Option<(usize, f64)> = None;
        for speed in 0..self.speeds.len() {
            for pair in self.row(speed).rev() {
                let area = self.speeds[speed] * self.feeds[pair % self.feeds.len()];
                let least = best.map_or(0.0, |(_, most)| most);
                if area < least * (1.0 - TIE) {
                    break;
                }
                if self.feasible(pair, worn, gain) {
                    let wins = area > least * (1.0 + TIE)
                        || best.is_none_or(|(other, _)| self.severity[pair] < self.severity[other]);
                    if wins {
                        best = Some((pair, area));
                    }
                    break;
                }
            }
        }
        best.map(|(pair, _)| pair)
    }

    pub(super) fn feasible(&self, pair: usize, worn: f64, gain: f64) -> bool {
        worn + gain * self.severity[pair] <= self.capacity[pair]
    }

    fn row(&self, speed: usize) -> std::ops::Range<usize> {
        speed * self.feeds.len()..(speed + 1) * self.feeds.len()
    }
}

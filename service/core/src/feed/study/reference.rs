//! The planner that knows everything: the fastest feed over depth with the model itself in the loop.
//!
//! A dense feed (a node every 0.15 mm) is brought to where every depth has a limit that binds, by drilling it without
//! noise again and again; then it is varied in thousands of random places and widths, alone and in pairs that trade heat
//! against time, keeping what is faster and keeps the loads. Filtered loads stay at or below `margin`·L_set.

use super::plant::{Plant, Run};
use crate::friction::error::{Invalid, InvalidCode};
use crate::friction::noise::Noise;
use crate::friction::program::Knot;

/// Distance of the nodes, mm.
const NODE_MM: f64 = 0.15;

/// Rounds in which every node is brought to its limit.
const ROUNDS: usize = 90;

/// Limits of a study's case that are no loads: the same for everyone.
#[derive(Debug, Clone, PartialEq)]
pub struct Limits {
    /// End of the path, mm.
    pub end_mm: f64,
    /// Set loads, percent.
    pub set_percent: [f64; 2],
    /// Smallest and largest feed, mm/min.
    pub feed_mm_min: (f64, f64),
    /// Largest acceleration, mm/s².
    pub acceleration_mm_s2: f64,
    /// Largest feed down to a depth: (mm/min, mm).
    pub heating: Option<(f64, f64)>,
    /// Largest feed between two depths: (mm/min, mm, mm).
    pub bushing: Option<(f64, f64, f64)>,
}

impl Limits {
    /// Largest feed at a depth, mm/min.
    #[must_use]
    pub fn cap(&self, depth_mm: f64) -> f64 {
        let mut cap = self.feed_mm_min.1;
        if let Some((feed, until)) = self.heating
            && depth_mm <= until
        {
            cap = cap.min(feed);
        }
        if let Some((feed, from, to)) = self.bushing
            && depth_mm >= from
            && depth_mm <= to
        {
            cap = cap.min(feed);
        }
        cap
    }

    /// Nodes at every `NODE_MM` and at the corners of the caps.
    fn depths(&self) -> Vec<f64> {
        let count = super::steps(self.end_mm / NODE_MM).max(4);
        let mut depths: Vec<f64> = (0..=count).map(|at| self.end_mm * at as f64 / count as f64).collect();
        let corners =
            [self.heating.map(|one| one.1), self.bushing.map(|one| one.1), self.bushing.map(|one| one.2)];
        for corner in corners.into_iter().flatten() {
            for depth in [corner - 0.01, corner, corner + 0.01] {
                if depth > 0.0 && depth < self.end_mm {
                    depths.push(depth);
                }
            }
        }
        depths.sort_by(f64::total_cmp);
        depths.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
        depths
    }

    /// Lowers feeds to the caps and to what the axis reaches.
    fn project(&self, depths: &[f64], feed: &mut [f64]) {
        for (one, depth) in feed.iter_mut().zip(depths) {
            *one = one.clamp(self.feed_mm_min.0, self.cap(*depth));
        }
        let reach = |from: f64, to: f64, way: f64| {
            // v·dv/dz at the faster end: w·(w − v) ≤ a·way.
            let v = from / 60.0;
            to.min(60.0 * (v + (v * v + 4.0 * self.acceleration_mm_s2 * way).sqrt()) / 2.0)
        };
        for at in 1..feed.len() {
            feed[at] = reach(feed[at - 1], feed[at], depths[at] - depths[at - 1]);
        }
        for at in (1..feed.len()).rev() {
            feed[at - 1] = reach(feed[at], feed[at - 1], depths[at] - depths[at - 1]);
        }
    }
}

/// What the search found.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    /// The profile.
    pub knots: Vec<Knot>,
    /// From contact to the end of the path, s.
    pub duration_s: f64,
}

struct Search<'a, P: Plant> {
    plant: &'a P,
    limits: &'a Limits,
    depths: Vec<f64>,
    most: [f64; 2],
}

impl<P: Plant> Search<'_, P> {
    fn knots(&self, feed: &[f64]) -> Vec<Knot> {
        self.depths.iter().zip(feed).map(|(&depth_mm, &feed_mm_min)| Knot { depth_mm, feed_mm_min }).collect()
    }

    fn drill(&self, feed: &[f64]) -> Result<Run, Invalid> {
        self.plant.drill(&self.knots(feed), None)
    }

    /// Largest filtered load over what is allowed around each node, from the feed a filter's lag before.
    fn ratios(&self, run: &Run) -> Vec<f64> {
        let mut ratios = vec![0.0_f64; self.depths.len()];
        let first = run.depth_mm.iter().position(|depth| *depth >= 0.0).unwrap_or(0);
        let lag = super::steps(0.04 / run.period_s).clamp(2, 5);
        let mut at = first;
        run.filtered(|_, load| {
            let cause = run.depth_mm[at.saturating_sub(lag).max(first)];
            let node = self.depths.partition_point(|depth| *depth < cause).min(ratios.len() - 1);
            let ratio = (load[0] / self.most[0]).max(load[1] / self.most[1]);
            for near in &mut ratios[node.saturating_sub(1)..=node] {
                *near = near.max(ratio);
            }
            at += 1;
        });
        // A node that a fast axis stepped over learns from its neighbours.
        for node in 1..ratios.len() {
            if ratios[node] <= 0.0 {
                ratios[node] = ratios[node - 1];
            }
        }
        ratios
    }

    fn feasible(&self, run: &Run) -> bool {
        run.worst_ratio(self.most) <= 1.0
    }

    /// Brings every node to a limit; keeps the fastest feed that keeps the loads.
    fn approach(&self, start: Vec<f64>) -> Result<Option<(Vec<f64>, f64)>, Invalid> {
        let mut feed = start;
        self.limits.project(&self.depths, &mut feed);
        let mut best: Option<(Vec<f64>, f64)> = None;
        for round in 0..ROUNDS {
            let run = self.drill(&feed)?;
            if self.feasible(&run) && best.as_ref().is_none_or(|(_, time)| run.duration_s < *time) {
                best = Some((feed.clone(), run.duration_s));
            }
            let gain = 0.6 * (1.0 - round as f64 / ROUNDS as f64) + 0.15;
            let ratios = self.ratios(&run);
            for (one, ratio) in feed.iter_mut().zip(ratios) {
                let ratio = ratio.max(0.02) * 1.0005;
                *one *= ratio.powf(-gain).clamp(0.6, 1.5);
            }
            self.limits.project(&self.depths, &mut feed);
        }
        // The last of it may ring about the limit: lower it until it keeps.
        for _ in 0..40 {
            let run = self.drill(&feed)?;
            if self.feasible(&run) {
                if best.as_ref().is_none_or(|(_, time)| run.duration_s < *time) {
                    best = Some((feed.clone(), run.duration_s));
                }
                break;
            }
            for (one, ratio) in feed.iter_mut().zip(self.ratios(&run)) {
                if ratio > 0.995 {
                    *one *= (0.995 / ratio).min(0.995);
                }
            }
            self.limits.project(&self.depths, &mut feed);
        }
        Ok(best)
    }

    fn vary(&self, best: &mut (Vec<f64>, f64), trials: usize, noise: &mut Noise) -> Result<(), Invalid> {
        let end = self.limits.end_mm;
        let mut size = 0.15;
        for trial in 0..trials {
            let mut feed = best.0.clone();
            let bump = |feed: &mut [f64], middle: f64, width: f64, by: f64| {
                for (one, depth) in feed.iter_mut().zip(&self.depths) {
                    let off = (depth - middle) / width;
                    *one *= (by * (-off * off).exp()).exp();
                }
            };
            let middle = end * noise.uniform();
            let width = 0.1 * (40.0_f64).powf(noise.uniform());
            let by = size * noise.normal();
            bump(&mut feed, middle, width, by);
            if noise.uniform() < 0.5 {
                let other = middle + 3.0 * width * noise.normal();
                bump(&mut feed, other, 0.1 * (40.0_f64).powf(noise.uniform()), -by * noise.uniform());
            }
            self.limits.project(&self.depths, &mut feed);
            let run = self.drill(&feed)?;
            if run.duration_s < best.1 - 1e-9 && self.feasible(&run) {
                *best = (feed, run.duration_s);
            }
            if trial % 200 == 199 {
                size = (size * 0.82).max(0.004);
            }
        }
        Ok(())
    }
}

/// The fastest profile that a search with full knowledge finds at `margin`·L_set.
///
/// # Errors
/// When no feed keeps the loads, or a hole cannot be finished.
pub fn reference<P: Plant>(
    plant: &P,
    limits: &Limits,
    margin: f64,
    trials: usize,
    seed: u64,
) -> Result<Reference, Invalid> {
    let search =
        Search { plant, limits, depths: limits.depths(), most: limits.set_percent.map(|set| set * margin) };
    let nodes = search.depths.len();
    let (low, high) = limits.feed_mm_min;
    let mut best: Option<(Vec<f64>, f64)> = None;
    for start in [(low * high).sqrt(), high] {
        if let Some(found) = search.approach(vec![start; nodes])?
            && best.as_ref().is_none_or(|(_, time)| found.1 < *time)
        {
            best = Some(found);
        }
    }
    let Some(mut best) = best else {
        let text = "no feed within the limits keeps the loads";
        return Err(Invalid::new("limits", InvalidCode::NotIdentifiable, text));
    };
    let mut noise = Noise::seeded(seed);
    search.vary(&mut best, trials, &mut noise)?;
    if let Some(again) = search.approach(best.0.clone())?
        && again.1 < best.1
    {
        best = again;
    }
    Ok(Reference { knots: search.knots(&best.0), duration_s: best.1 })
}

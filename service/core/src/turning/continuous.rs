//! Search of one interval without a grid.
//!
//! In u = ln V and w = ln f the objective u + w is linear. Power and force are a linear term plus a positive
//! multiple of ln(m₀ + k·e^(a·u+b·w)), m the wear measure that intervals add to, hence convex: the feasible set is convex, the greatest feasible w is a
//! concave function of u, and a one-dimensional search finds the optimum.

use super::domain::Range;
use super::{Cut, EdgeState, Job, LoadLaw};

/// Rounds of the one-dimensional search: (2/3)^100 of the range is below the resolution of a double.
const ROUNDS: u32 = 100;

/// Newton steps for the border of one law; from the infeasible side they converge monotonically, in 3 to 6 steps.
const NEWTON_STEPS: u32 = 60;

/// Share of a limit kept free, so that rounding cannot carry the prediction over it.
const MARGIN: f64 = 1e-12;

struct Load {
    constant: f64,
    speed: f64,
    feed: f64,
    wear: f64,
}

impl Load {
    fn new(job: &Job, law: &LoadLaw, limit: f64) -> Self {
        let constant =
            law.coefficient * job.depth_ratio().powf(law.depth_exponent) / (limit * (1.0 - MARGIN));
        Self {
            constant: constant.ln(),
            speed: law.speed_exponent,
            feed: law.feed_exponent,
            wear: law.wear_exponent / job.measure_power(),
        }
    }
}

struct Search {
    worn: f64,
    room: f64,
    gain: f64,
    wear_speed: f64,
    wear_feed: f64,
    loads: Vec<Load>,
    w_max: f64,
}

impl Search {
    /// Greatest ln f that no law forbids at ln V = `u`.
    fn most_feed(&self, u: f64) -> f64 {
        let by_wear = ((self.room / self.gain).ln() - self.wear_speed * u) / self.wear_feed;
        let mut w = self.w_max.min(by_wear);
        for load in &self.loads {
            for _ in 0..NEWTON_STEPS {
                let grown = self.gain * (self.wear_speed * u + self.wear_feed * w).exp();
                let wear = self.worn + grown;
                let excess = load.constant + load.speed * u + load.feed * w + load.wear * wear.ln();
                if excess <= 0.0 {
                    break;
                }
                let step = excess / (load.feed + load.wear * self.wear_feed * grown / wear);
                w -= step;
                if step <= f64::EPSILON * w.abs() {
                    break;
                }
            }
        }
        w
    }
}

/// The pair of largest removal within the ranges that keeps every limit, or none.
///
/// `power` and `force` say whether those limits count; wear always does.
pub(super) fn best(
    job: &Job,
    state: EdgeState,
    speed: Range,
    feed: Range,
    power: bool,
    force: bool,
) -> Option<Cut> {
    let data = job.model().data();
    let limits = job.limits();
    let worn = job.measure(state.wear_mm());
    let room = job.measure(limits.wear_mm * (1.0 - MARGIN)) - worn;
    if room <= 0.0 {
        return None;
    }
    let mut loads = Vec::with_capacity(2);
    if power {
        loads.push(Load::new(job, &data.power, limits.power_kw));
    }
    if force {
        loads.push(Load::new(job, &data.force, limits.force_n));
    }
    let search = Search {
        worn,
        room,
        gain: job.wear_gain(state.elapsed_min()),
        wear_speed: data.wear.speed_exponent * job.measure_power(),
        wear_feed: data.wear.feed_exponent * job.measure_power(),
        loads,
        w_max: feed.max.ln(),
    };
    let w_min = feed.min.ln();
    let (u_min, u_max) = (speed.min.ln(), speed.max.ln());
    let (mut low, mut high) = (u_min, u_max);
    for _ in 0..ROUNDS {
        let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        let (wa, wb) = (search.most_feed(a), search.most_feed(b));
        // Outside the feasible interval the greater w shows the way to it.
        let right = match (wa >= w_min, wb >= w_min) {
            (true, true) => a + wa < b + wb,
            (false, false) => wa < wb,
            (feasible_left, _) => !feasible_left,
        };
        if right {
            low = a;
        } else {
            high = b;
        }
    }
    let candidates = [(u_min, speed.min), (low.midpoint(high), low.midpoint(high).exp()), (u_max, speed.max)];
    candidates
        .into_iter()
        .filter_map(|(u, speed_m_min)| {
            let w = search.most_feed(u);
            // The bound itself, not exp(ln(bound)), so that a corner of the domain is met exactly.
            let feed_mm_rev = if w >= search.w_max { feed.max } else { w.exp() };
            (w >= w_min).then(|| Cut { speed_m_min: speed_m_min.clamp(speed.min, speed.max), feed_mm_rev })
        })
        .map(|cut| Cut { feed_mm_rev: cut.feed_mm_rev.max(feed.min), ..cut })
        .max_by(|a, b| job.removal_mm3_min(*a).total_cmp(&job.removal_mm3_min(*b)))
}

//! The envelope: at every depth the fastest feed that keeps every limit, and which limit that is.

use super::grid::Grid;
use super::predict::Expected;
use super::profile::Knots;
use super::relation::{LnLoad, Node, Relation};
use super::settings::Settings;
use crate::friction::program::Knot;
use libm::erf;

/// Share of the axis' acceleration that is planned with; the rest is for following the path.
const PLANNED_ACCELERATION: f64 = 0.95;

/// Halvings in which a feed is found: better than a thousandth.
const HALVINGS: usize = 18;

/// Rounds of planning, because what is slowed down changes the heat behind it.
const ROUNDS: usize = 3;

/// Probability that a cycle is overloaded, as it is planned with. Depths are counted as if each were uncertain for itself,
/// which overstates it: of the study's cycles less than half as many are (docs/feed-optimiser.md).
const OVERLOAD_RISK: f64 = 0.03;

/// Halvings in which the margin is found that the risk asks, and the largest margin in standard deviations.
const MARGIN_HALVINGS: usize = 10;
const WIDEST_MARGIN: f64 = 5.0;

/// Places on a standard normal distribution, with their weights: what a cycle has in common with itself.
const COMMON_PLACES: [(f64, f64); 9] = [
    (-1.5, 0.1303),
    (-0.75, 0.2235),
    (0.0, 0.2923),
    (0.75, 0.1952),
    (1.25, 0.0918),
    (1.75, 0.0441),
    (2.25, 0.0165),
    (2.75, 0.0053),
    (3.5, 0.0009),
];

/// How long the unevenness of a cycle stays the same, s: a cycle that is near its limit for longer tries its luck anew.
pub(super) const UNEVEN_S: f64 = 0.15;

/// What a feed above a limit that is no load counts against a load above its bound, in ln.
const CAP_WEIGHT: f64 = 30.0;

/// Largest fall of the feed-drive load behind its maximum that is still noise, relative.
const CLEAR_FALL: f64 = 0.15;

/// What keeps the feed from being faster.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Binding {
    /// The tool maker's feed while heating.
    Heating,
    /// The moderate feed in the last part of the bushing.
    Bushing,
    /// The largest feed.
    LargestFeed,
    /// The smallest feed: the load would ask for less.
    SmallestFeed,
    /// The feed drive's set load.
    FeedDriveLoad,
    /// The spindle's set load.
    SpindleLoad,
    /// Acceleration of the axis.
    Acceleration,
    /// A load above its set load that was seen here in the last tried cycle.
    SeenOverload,
    /// The step from the last tried profile.
    Step,
    /// Nothing is known at this depth: the last tried feed stays.
    Unknown,
    /// The objective itself: faster would cost more energy than the time is worth.
    Objective,
    /// Few knots: the feed between them stays under the envelope.
    Knots,
}

impl Binding {
    /// The stable word.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Heating => "heating",
            Self::Bushing => "bushing",
            Self::LargestFeed => "largest_feed",
            Self::SmallestFeed => "smallest_feed",
            Self::FeedDriveLoad => "feed_drive_load",
            Self::SpindleLoad => "spindle_load",
            Self::Acceleration => "acceleration",
            Self::SeenOverload => "seen_overload",
            Self::Step => "step",
            Self::Unknown => "unknown",
            Self::Objective => "objective",
            Self::Knots => "knots",
        }
    }
}

/// Lag of the load filter of Stryczek & Błaszczak 2020, Eq. 1, in samples.
pub(super) const FILTER_LAG_SAMPLES: f64 = 4.0;

/// The load filter for uneven steps of time: two first-order lags in a row, as its two poles are.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LagFilter {
    first: f64,
    second: f64,
}

impl LagFilter {
    pub(super) fn step(&mut self, load: f64, time_s: f64, lag_s: f64) -> f64 {
        // A load that lasts for ever before the first step: it starts settled.
        let share = if time_s > 0.0 { 1.0 - (-time_s / lag_s).exp() } else { 1.0 };
        self.first += share * (load - self.first);
        self.second += share * (self.first - self.second);
        self.second
    }
}

/// ln of a filtered load over its set load beyond which it is corrected where it was seen; how far before that depth the
/// feed is lowered, because a filtered load is late; and the smallest slope that a correction counts on.
const SEEN_OVERLOAD: f64 = 0.02;
/// Standard deviations of a cycle's own unevenness that a load which was seen may lie above by chance: the next cycle is
/// uneven elsewhere.
const SEEN_BY_CHANCE: f64 = 1.5;
const OVERLOAD_REACH_MM: f64 = 0.5;
const LEAST_CORRECTING_SLOPE: f64 = 0.4;

/// Everything that planning asks, prepared once.
pub(super) struct Planner<'a> {
    pub(super) relation: &'a Relation,
    pub(super) settings: &'a Settings,
    /// Largest feed at each node from every limit that is no load, with its name.
    pub(super) caps: Vec<(f64, Binding)>,
    /// Smallest feed at each node to which a load may lower it.
    floors: Vec<f64>,
    /// Where the last tried profile's feed was, mm/min.
    pub(super) last: Vec<f64>,
    set_ln: [f64; 2],
    tolerated_ln: [f64; 2],
    known_z: f64,
    cycle_z: f64,
    pub(super) heating_until_mm: f64,
    /// Costs of a second and of a percent-second of spindle load over idle.
    pub(super) weights: (f64, f64),
    /// How far the axis lags behind the programmed feed, s.
    pub(super) servo_s: f64,
}

/// A feed at every node, and what bounds it.
#[derive(Debug, Clone)]
pub(super) struct Envelope {
    pub(super) feed: Vec<f64>,
    pub(super) binding: Vec<Binding>,
    pub(super) heat: Vec<f64>,
}

/// What a feed over depth is expected to do.
#[derive(Debug, Clone, Default)]
pub(super) struct Outlook {
    pub(super) time_s: f64,
    /// Spindle load over idle, percent-seconds.
    pub(super) percent_s: f64,
    pub(super) cost: f64,
    /// Sum over the nodes of how far the bounds of the loads are crossed, in ln load.
    pub(super) crossed: f64,
    /// The largest of them.
    pub(super) most_crossed: f64,
}

impl<'a> Planner<'a> {
    /// `last` is the feed of the last tried profile at the nodes, `least` its smallest between the neighbours of each.
    pub(super) fn new(relation: &'a Relation, settings: &'a Settings, last: Vec<f64>, least: &[f64]) -> Self {
        let grid = &relation.grid;
        let set = settings.set_percent();
        let over_idle = |drive: usize, percent: f64| (percent - relation.idle[drive]).max(0.1).ln();
        let set_ln = [0, 1].map(|drive| over_idle(drive, set[drive]));
        let tolerated_ln =
            [0, 1].map(|drive| over_idle(drive, set[drive] * (1.0 + settings.tolerance_ratio)));
        let heating_until_mm = heating_end(relation, settings);
        let factor = settings.override_factor();
        let step = grid.step_mm();
        let caps = (0..grid.count())
            .map(|node| {
                let depth = grid.depth_mm(node);
                let mut cap = (settings.feed_max_mm_min * factor, Binding::LargestFeed);
                let mut lower = |feed: f64, binding: Binding| {
                    if feed < cap.0 {
                        cap = (feed, binding);
                    }
                };
                if let Some(heating) = &settings.heating
                    && depth - step < heating_until_mm - 1e-6
                {
                    lower(heating.feed_mm_min, Binding::Heating);
                }
                if let Some(bushing) = &settings.bushing
                    && depth + step > bushing.from_mm + 1e-6
                    && depth - step < bushing.to_mm - 1e-6
                {
                    lower(bushing.feed_mm_min, Binding::Bushing);
                }
                lower(least[node] * settings.raise_ratio, Binding::Step);
                if relation.nodes[node].is_none() {
                    lower(least[node], Binding::Unknown);
                }
                (cap.0.max(settings.feed_min_mm_min * factor), cap.1)
            })
            .collect::<Vec<_>>();
        let floors = (0..grid.count())
            .map(|node| {
                let floor = (last[node] * settings.lower_ratio).max(settings.feed_min_mm_min * factor);
                floor.min(caps[node].0)
            })
            .collect();
        Self {
            relation,
            settings,
            caps,
            floors,
            last,
            set_ln,
            tolerated_ln,
            known_z: normal_quantile(settings.confidence),
            cycle_z: WIDEST_MARGIN,
            heating_until_mm,
            weights: settings.objective.weights(relation.idle[1]),
            servo_s: 0.0,
        }
    }

    /// The same plan on an axis that lags.
    pub(super) fn with_servo(self, servo_s: f64) -> Self {
        Self { servo_s, ..self }
    }

    /// Lowers the limits where the cycle that ran the last profile had a filtered load above its set load: what was seen
    /// outweighs what the relation says. `seen` is ln of the filtered load over the set load at each node.
    pub(super) fn after_overload(mut self, seen: &[Option<f64>]) -> Self {
        let reach = super::grid::whole(OVERLOAD_REACH_MM / self.relation.grid.step_mm()).max(1);
        for (node, seen) in seen.iter().enumerate() {
            let uneven = self.relation.nodes[node]
                .as_ref()
                .map_or(0.0, |known| known.drives[0].uneven.max(known.drives[1].uneven));
            let beyond_chance = seen.map(|over| over - SEEN_BY_CHANCE * uneven);
            let Some(over) = beyond_chance.filter(|over| *over > SEEN_OVERLOAD) else { continue };
            for near in node.saturating_sub(reach)..=node {
                let slope = self.relation.nodes[near]
                    .as_ref()
                    .map_or(1.0, |known| known.drives[0].slope.min(known.drives[1].slope))
                    .clamp(LEAST_CORRECTING_SLOPE, 1.0);
                let most = self.last[near] * (-over / slope).exp();
                if most < self.caps[near].0 {
                    self.caps[near] = (most.max(self.floors[near]), Binding::SeenOverload);
                }
            }
        }
        self
    }

    /// Actual feed at a node, mm/min, from the programmed one there and the actual one a node before.
    pub(super) fn acting_feed(&self, programmed: f64, before: Option<f64>) -> f64 {
        acting_feed(programmed, before, self.relation.grid.step_mm(), self.servo_s)
    }

    /// How far a drive's load crosses its bounds at a node, in ln load; below 0 it keeps them.
    pub(super) fn excess(&self, node: &Node, drive: usize, x: f64, phi: f64) -> f64 {
        let load = self.relation.load(node, drive, x, phi, 0.0);
        let expected = load.mean + self.known_z * load.known_sd - self.set_ln[drive];
        let one = load.mean + self.cycle_z * load.cycle_sd - self.tolerated_ln[drive];
        expected.max(one)
    }

    /// How far loads that passed the load filter cross their bounds, in ln load: uncertain as the loads of the node.
    fn filtered_excess(&self, loads: &[LnLoad; 2], filtered: &[f64; 2]) -> f64 {
        let one = |drive: usize| {
            let mean = filtered[drive].max(1e-6).ln();
            let expected = mean + self.known_z * loads[drive].known_sd - self.set_ln[drive];
            expected.max(mean + self.cycle_z * loads[drive].cycle_sd - self.tolerated_ln[drive])
        };
        one(0).max(one(1))
    }

    fn worst(&self, node: &Node, x: f64, phi: f64) -> (f64, usize) {
        let (feed, spindle) = (self.excess(node, 0, x, phi), self.excess(node, 1, x, phi));
        if feed >= spindle { (feed, 0) } else { (spindle, 1) }
    }

    /// Largest ln feed in `[low, high]` that keeps both loads, and the drive that binds; `low` where none does.
    fn fastest(&self, node: &Node, phi: f64, low: f64, high: f64) -> (f64, Option<usize>) {
        let (at_high, drive) = self.worst(node, high, phi);
        if at_high <= 0.0 {
            return (high, None);
        }
        let (mut below, mut above, mut binding) = (low, high, drive);
        if self.worst(node, low, phi).0 > 0.0 {
            return (low, Some(drive));
        }
        for _ in 0..HALVINGS {
            let middle = f64::midpoint(below, above);
            let (excess, drive) = self.worst(node, middle, phi);
            if excess > 0.0 {
                (above, binding) = (middle, drive);
            } else {
                below = middle;
            }
        }
        (below, Some(binding))
    }

    /// Probability that one cycle of these feeds is overloaded.
    ///
    /// What a cycle has in common moves every load of it at once, what is uneven within it tries anew every `UNEVEN_S`.
    fn risk(&self, envelope: &Envelope) -> f64 {
        let grid = &self.relation.grid;
        let mut near: Vec<(f64, f64, f64, f64)> = Vec::new();
        for (node, &feed) in envelope.feed.iter().enumerate() {
            let Some(known) = &self.relation.nodes[node] else { continue };
            // A limit that even the floor crosses is no fault of the plan.
            if feed <= self.floors[node] * 1.001 {
                continue;
            }
            let chances = grid.step_mm() / feed * 60.0 / UNEVEN_S;
            let phi = self.relation.phi(envelope.heat[node]);
            for drive in 0..2 {
                let load = self.relation.load(known, drive, feed.ln(), phi, 0.0);
                let room = self.tolerated_ln[drive] - load.mean;
                let common = self.relation.noise[drive].common * self.relation.spread_scale;
                let own = (load.cycle_sd * load.cycle_sd - common * common).max(1e-8).sqrt();
                if room < 5.0 * load.cycle_sd {
                    near.push((room, common, own, chances));
                }
            }
        }
        COMMON_PLACES
            .iter()
            .map(|&(place, weight)| {
                let kept: f64 = near
                    .iter()
                    .map(|&(room, common, own, chances)| {
                        let below = normal_probability((room - place * common) / own).max(1e-12);
                        chances * below.ln()
                    })
                    .sum();
                weight * (1.0 - kept.exp())
            })
            .sum()
    }

    /// The same with as many standard deviations of one cycle below the tolerance as the risk of a whole cycle asks: where
    /// few depths are near their limit, fewer than where all are.
    pub(super) fn with_even_risk(mut self) -> Self {
        let (mut low, mut high) = (0.0, WIDEST_MARGIN);
        for _ in 0..MARGIN_HALVINGS {
            self.cycle_z = f64::midpoint(low, high);
            if self.risk(&self.envelope()) > OVERLOAD_RISK {
                low = self.cycle_z;
            } else {
                high = self.cycle_z;
            }
        }
        self.cycle_z = high;
        self
    }

    /// The fastest feed at every node, forward over depth with the heat that it puts in.
    pub(super) fn envelope(&self) -> Envelope {
        let grid = &self.relation.grid;
        let mut caps = self.caps.clone();
        let mut envelope = self.forward(&caps);
        for _ in 0..ROUNDS {
            let reachable = self.reachable(&envelope.feed);
            let slowed = (0..grid.count()).any(|node| reachable[node] < envelope.feed[node] * (1.0 - 1e-9));
            if !slowed {
                break;
            }
            for node in 0..grid.count() {
                if reachable[node] < envelope.feed[node] * (1.0 - 1e-9) {
                    caps[node] = (reachable[node], Binding::Acceleration);
                } else if caps[node].1 == Binding::Acceleration {
                    caps[node] = self.caps[node];
                }
            }
            envelope = self.forward(&caps);
        }
        let reachable = self.reachable(&envelope.feed);
        for (node, reached) in reachable.into_iter().enumerate() {
            if reached < envelope.feed[node] * (1.0 - 1e-9) {
                envelope.feed[node] = reached;
                envelope.binding[node] = Binding::Acceleration;
            }
        }
        envelope
    }

    fn forward(&self, caps: &[(f64, Binding)]) -> Envelope {
        let grid = &self.relation.grid;
        let count = grid.count();
        let mut envelope = Envelope {
            feed: vec![0.0; count],
            binding: vec![Binding::Unknown; count],
            heat: vec![0.0; count],
        };
        let weights = self.weights;
        let mut heat = 0.0;
        for (node, &(cap, mut binding)) in caps.iter().enumerate() {
            envelope.heat[node] = heat;
            let mut feed = cap;
            if let Some(known) = &self.relation.nodes[node] {
                let phi = self.relation.phi(heat);
                let low = self.floors[node].min(cap).ln();
                let (x, drive) = self.fastest(known, phi, low, cap.ln());
                if let Some(drive) = drive {
                    feed = x.exp();
                    binding = [Binding::FeedDriveLoad, Binding::SpindleLoad][drive];
                    if x <= low + 1e-12 {
                        let at_minimum = feed <= self.settings.feed_min_mm_min * 1.001;
                        binding = if at_minimum { Binding::SmallestFeed } else { Binding::Step };
                    }
                }
                if weights.1 > 0.0 {
                    let best = self.cheapest(known, phi, low, feed.ln(), weights);
                    if best < feed.ln() - 1e-6 {
                        (feed, binding) = (best.exp(), Binding::Objective);
                    }
                }
            }
            envelope.feed[node] = feed;
            envelope.binding[node] = binding;
            heat = self.heat_after(node, heat, feed);
        }
        envelope
    }

    /// ln feed with the least cost per mm in a range: a scan, because the cost need not have one minimum only.
    fn cheapest(&self, node: &Node, phi: f64, low: f64, high: f64, weights: (f64, f64)) -> f64 {
        const STEPS: usize = 40;
        let cost = |x: f64| {
            let load = self.relation.load(node, 1, x, phi, 0.0).mean.exp();
            (weights.0 + weights.1 * load) / x.exp()
        };
        let at = |step: usize| high - (high - low) * step as f64 / STEPS as f64;
        (0..=STEPS).map(at).fold(high, |best, x| if cost(x) < cost(best) * (1.0 - 1e-9) { x } else { best })
    }

    /// Heat at the next node.
    fn heat_after(&self, node: usize, heat: f64, feed: f64) -> f64 {
        let time = self.relation.grid.step_mm() / feed * 60.0;
        let keep = (-time / super::relation::MEMORY_S).exp();
        let load = self.relation.nodes[node].as_ref().map_or(0.0, |known| {
            self.relation.load(known, 1, feed.ln(), self.relation.phi(heat), 0.0).mean.exp()
        });
        heat * keep + super::relation::heat_rate(load) * time
    }

    /// The feeds lowered to what the axis reaches between the nodes: v·dv/dz ≤ a, both ways.
    fn reachable(&self, feed: &[f64]) -> Vec<f64> {
        let most =
            self.settings.acceleration_mm_s2 * PLANNED_ACCELERATION * 2.0 * self.relation.grid.step_mm();
        let mut reachable = feed.to_vec();
        let limit = |from: f64, to: f64| to.min(((from / 60.0).powi(2) + most).sqrt() * 60.0);
        for node in 1..reachable.len() {
            reachable[node] = limit(reachable[node - 1], reachable[node]);
        }
        for node in (1..reachable.len()).rev() {
            reachable[node - 1] = limit(reachable[node], reachable[node - 1]);
        }
        reachable
    }

    /// What knots are expected to do; allocates nothing, because a search asks it thousands of times.
    pub(super) fn outlook(&self, knots: &[Knot]) -> Outlook {
        let grid = &self.relation.grid;
        let weights = self.weights;
        let mut out = Outlook::default();
        let (mut heat, mut at) = (0.0, 0);
        let mut before = 0.0;
        let mut filters: [LagFilter; 2] = [LagFilter::default(); 2];
        for node in 0..grid.count() {
            let depth = grid.depth_mm(node);
            while at + 1 < knots.len() && knots[at + 1].depth_mm <= depth {
                at += 1;
            }
            let feed = match knots.get(at + 1) {
                Some(right) if depth > knots[at].depth_mm => {
                    let part = (depth - knots[at].depth_mm) / (right.depth_mm - knots[at].depth_mm);
                    knots[at].feed_mm_min + part * (right.feed_mm_min - knots[at].feed_mm_min)
                }
                _ => knots[at].feed_mm_min,
            };
            let programmed = feed;
            let feed = self.acting_feed(programmed, (node > 0).then_some(before));
            let time = if node == 0 { 0.0 } else { grid.step_mm() * 120.0 / (feed + before) };
            before = feed;
            let mut spindle = 0.0;
            heat *= (-time / super::relation::MEMORY_S).exp();
            if let Some(known) = &self.relation.nodes[node] {
                let (x, phi) = (feed.ln(), self.relation.phi(heat));
                let loads = [0, 1].map(|drive| self.relation.load(known, drive, x, phi, 0.0));
                let means = loads.map(|load| load.mean.exp());
                spindle = means[1];
                let lag = FILTER_LAG_SAMPLES / 2.0 * self.relation.period_s;
                let filtered = [0, 1].map(|drive| filters[drive].step(means[drive], time, lag));
                // Where even the floor crosses, the floor is no fault of the knots.
                if feed > self.floors[node] * 1.001 {
                    let crossed = self.filtered_excess(&loads, &filtered).max(0.0);
                    out.crossed += crossed;
                    out.most_crossed = out.most_crossed.max(crossed);
                }
            }
            out.crossed += (programmed / self.caps[node].0).ln().max(0.0) * CAP_WEIGHT;
            heat += super::relation::heat_rate(spindle) * time;
            out.time_s += time;
            out.percent_s += spindle * time;
        }
        out.cost = weights.0 * out.time_s + weights.1 * out.percent_s;
        out
    }

    /// Cost of a step at a node for a feed, with the heat of the envelope; for comparing feeds, not for telling them.
    pub(super) fn local_cost(&self, node: usize, heat: f64, feed: f64) -> f64 {
        let weights = self.weights;
        let load = match &self.relation.nodes[node] {
            Some(known) if weights.1 > 0.0 => {
                self.relation.load(known, 1, feed.ln(), self.relation.phi(heat), 0.0).mean.exp()
            }
            _ => 0.0,
        };
        (weights.0 + weights.1 * load) / feed
    }

    /// Probability that both expected loads are at or below their set loads; 1 where nothing is known.
    pub(super) fn confidence(&self, node: &Expected) -> f64 {
        let Some(load) = node.load else { return 1.0 };
        let one = |drive: usize| {
            let mean = (load[drive] - self.relation.idle[drive]).max(1e-6).ln();
            normal_probability((self.set_ln[drive] - mean) / node.known_sd[drive].max(1e-6))
        };
        one(0).min(one(1))
    }

    /// Whether both loads stay within the tolerance at the asked confidence.
    pub(super) fn tolerates(&self, node: &Expected) -> bool {
        let Some(load) = node.load else { return true };
        (0..2).all(|drive| {
            let mean = (load[drive] - self.relation.idle[drive]).max(1e-6).ln();
            mean + self.known_z * node.known_sd[drive] <= self.tolerated_ln[drive]
        })
    }

    /// Whether an expected load is above its set load somewhere.
    pub(super) fn stays_above(&self, nodes: &[Expected]) -> bool {
        let set = self.settings.set_percent();
        nodes.iter().filter_map(|node| node.load).any(|load| load[0] > set[0] || load[1] > set[1])
    }

    /// Whether acting knots keep the limits that the settings name; the step and what is unknown are none of them.
    pub(super) fn keeps_limits(&self, knots: &[Knot]) -> bool {
        let settings = self.settings;
        let grid = &self.relation.grid;
        (0..grid.count()).all(|node| {
            let depth = grid.depth_mm(node);
            let feed = super::profile::feed_at(knots, depth);
            let heats = depth <= self.heating_until_mm;
            let heating = settings.heating.is_none_or(|one| !heats || feed <= one.feed_mm_min * (1.0 + 1e-6));
            let bushing = settings.bushing.is_none_or(|one| {
                depth < one.from_mm || depth > one.to_mm || feed <= one.feed_mm_min * (1.0 + 1e-6)
            });
            heating && bushing
        })
    }

    /// Depths at which limits begin and end, mm.
    pub(super) fn corners_mm(&self) -> Vec<f64> {
        let mut corners = Vec::new();
        if self.settings.heating.is_some() {
            corners.push(self.heating_until_mm);
        }
        if let Some(bushing) = &self.settings.bushing {
            corners.extend([bushing.from_mm, bushing.to_mm]);
        }
        corners
    }

    /// Largest feed at a depth from every limit that is no load: that of the nodes on both sides.
    pub(super) fn cap_at(&self, depth_mm: f64) -> f64 {
        let place = (depth_mm / self.relation.grid.step_mm()).max(0.0);
        let below = super::grid::whole(place + 1e-9).min(self.caps.len() - 1);
        let above = super::grid::whole((place - 1e-9).ceil()).min(self.caps.len() - 1);
        self.caps[below].0.min(self.caps[above].0)
    }

    /// Acceleration that is planned with, mm/s².
    pub(super) fn acceleration(&self) -> f64 {
        self.settings.acceleration_mm_s2 * PLANNED_ACCELERATION
    }
}

/// Actual feed, mm/min, of an axis that follows with a first-order lag, from the actual one `step_mm` before.
pub(super) fn acting_feed(programmed: f64, before: Option<f64>, step_mm: f64, servo_s: f64) -> f64 {
    let Some(before) = before.filter(|_| servo_s > 1e-4) else { return programmed };
    let time = step_mm * 120.0 / (programmed + before);
    before + (1.0 - (-time / servo_s).exp()) * (programmed - before)
}

/// Where heating ends: as set, or where the feed-drive load has clearly fallen behind its maximum within it.
fn heating_end(relation: &Relation, settings: &Settings) -> f64 {
    let Some(heating) = settings.heating else { return 0.0 };
    if !heating.may_shorten {
        return heating.until_mm;
    }
    let mut largest = f64::NEG_INFINITY;
    for (at, node) in relation.nodes.iter().enumerate() {
        let depth = relation.grid.depth_mm(at);
        if depth > heating.until_mm {
            break;
        }
        let Some(node) = node else { return heating.until_mm };
        let load = relation.load(node, 0, node.x, node.phi, 0.0);
        largest = largest.max(load.mean);
        if load.mean + 2.0 * load.known_sd < largest + (1.0 - CLEAR_FALL).ln() {
            return depth;
        }
    }
    heating.until_mm
}

/// Probability of a standard normal number below `z`.
pub(super) fn normal_probability(z: f64) -> f64 {
    0.5 * (1.0 + erf(z / std::f64::consts::SQRT_2))
}

/// The number below which a standard normal one is with probability `p`.
pub(super) fn normal_quantile(p: f64) -> f64 {
    let (mut low, mut high) = (-8.0, 8.0);
    for _ in 0..60 {
        let middle = f64::midpoint(low, high);
        if normal_probability(middle) < p {
            low = middle;
        } else {
            high = middle;
        }
    }
    f64::midpoint(low, high)
}

/// Feeds of knots at the nodes times the override, and the smallest between the neighbours of each node.
pub(super) fn acting(knots: &Knots, grid: &Grid, factor: f64) -> (Vec<f64>, Vec<f64>) {
    let feed: Vec<f64> = knots.on(grid).into_iter().map(|feed| feed * factor).collect();
    let least = (0..grid.count())
        .map(|node| {
            let (from, to) =
                (grid.depth_mm(node.saturating_sub(1)), grid.depth_mm((node + 1).min(grid.count() - 1)));
            let inner = knots.as_slice().iter().filter(|knot| knot.depth_mm > from && knot.depth_mm < to);
            let ends = feed[node.saturating_sub(1)].min(feed[(node + 1).min(grid.count() - 1)]);
            inner.map(|knot| knot.feed_mm_min * factor).fold(ends.min(feed[node]), f64::min)
        })
        .collect();
    (feed, least)
}

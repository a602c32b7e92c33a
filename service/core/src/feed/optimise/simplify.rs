//! Few knots under the envelope.
//!
//! First exactly: over knots at chosen depths and at shares of the envelope's feed there, the cheapest path with at
//! most n knots whose straight lines stay under the envelope and within the axis' acceleration (dynamic programming).
//! Then freely: knots move in depth and feed as long as the loads, predicted with the heat that the knots themselves put
//! in, keep their bounds.

use super::grid::Grid;
use super::plan::{Envelope, Planner};
use super::profile::acceleration_mm_s2;
use crate::friction::program::Knot;

/// Most depths at which a knot may stand in the first, exact step.
const MOST_PLACES: usize = 84;

/// Feeds of a knot in the first step, as shares of the envelope's.
const SHARES: [f64; 9] = [1.0, 0.975, 0.94, 0.9, 0.85, 0.78, 0.7, 0.6, 0.45];

/// Crossing of the envelope that is rounding, relative.
const ROUNDING: f64 = 1e-6;

/// Moves of the second step: relative changes of a feed, and parts of the way to a neighbour in depth.
const FEED_MOVES: [f64; 6] = [0.12, 0.05, 0.02, 0.008, 0.003, 0.001];
const DEPTH_MOVES_MM: [f64; 6] = [0.4, 0.2, 0.1, 0.05, 0.03, 0.02];

/// Sweeps over all knots at each size of move.
const SWEEPS: usize = 3;

/// Least distance of two knots, mm.
const LEAST_DISTANCE_MM: f64 = 0.1;

/// What crossing costs relative to everything else, for each size of move: gently first, so that a knot is not thrown away
/// for a hair's breadth at one depth.
const CROSSING_WEIGHTS: [f64; 6] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0];

/// The envelope as knots: cheapest path of at most `most` knots under it.
pub(super) fn simplify(planner: &Planner<'_>, envelope: &Envelope, most: usize) -> Vec<Knot> {
    let knots = path(planner, envelope, most);
    polish(planner, knots)
}

struct Edge {
    from: u32,
    to: u32,
    cost: f64,
}

fn places(planner: &Planner<'_>) -> Vec<usize> {
    let grid = &planner.relation.grid;
    let last = grid.count() - 1;
    let stride = grid.count().div_ceil(MOST_PLACES).max(1);
    let mut places: Vec<usize> = (0..=last).step_by(stride).collect();
    places.push(last);
    for depth in planner.corners_mm() {
        let node = grid.nearest(depth);
        places.extend([node, (node + 1).min(last)]);
    }
    places.sort_unstable();
    places.dedup();
    places
}

fn path(planner: &Planner<'_>, envelope: &Envelope, most: usize) -> Vec<Knot> {
    let grid = &planner.relation.grid;
    let places = places(planner);
    let states = places.len() * SHARES.len();
    let feed = |state: usize| envelope.feed[places[state / SHARES.len()]] * SHARES[state % SHARES.len()];
    let node = |state: usize| places[state / SHARES.len()];
    let edges = edges(planner, envelope, &places);
    // best[k][state]: least cost of reaching a state with k + 1 knots.
    let mut best = vec![vec![f64::INFINITY; states]; most];
    let mut came = vec![vec![u32::MAX; states]; most];
    best[0][..SHARES.len()].fill(0.0);
    for used in 1..most {
        let (before, after) = best.split_at_mut(used);
        let (before, after) = (&before[used - 1], &mut after[0]);
        for edge in &edges {
            let cost = before[edge.from as usize] + edge.cost;
            if cost < after[edge.to as usize] {
                after[edge.to as usize] = cost;
                came[used][edge.to as usize] = edge.from;
            }
        }
    }
    let ends = states - SHARES.len()..states;
    let mut end = (f64::INFINITY, 0, 0);
    for (used, costs) in best.iter().enumerate() {
        for state in ends.clone() {
            // A knot more has to be worth it.
            if costs[state] < end.0 * (1.0 - 1e-4) {
                end = (costs[state], used, state);
            }
        }
    }
    if !end.0.is_finite() {
        return level(grid, envelope);
    }
    let (mut used, mut state) = (end.1, end.2);
    let mut knots = vec![Knot { depth_mm: grid.depth_mm(node(state)), feed_mm_min: feed(state) }];
    while used > 0 {
        state = came[used][state] as usize;
        used -= 1;
        knots.push(Knot { depth_mm: grid.depth_mm(node(state)), feed_mm_min: feed(state) });
    }
    knots.reverse();
    knots
}

/// One feed under the whole envelope: always within it, whatever else is not.
fn level(grid: &Grid, envelope: &Envelope) -> Vec<Knot> {
    let feed = envelope.feed.iter().copied().fold(f64::INFINITY, f64::min);
    [0.0, grid.end_mm()].map(|depth_mm| Knot { depth_mm, feed_mm_min: feed }).to_vec()
}

fn edges(planner: &Planner<'_>, envelope: &Envelope, places: &[usize]) -> Vec<Edge> {
    let grid = &planner.relation.grid;
    let time_only = planner.weights.1 <= 0.0;
    let weight = planner.weights.0;
    let mut edges = Vec::new();
    let state = |place: usize, share: usize| u32::try_from(place * SHARES.len() + share).unwrap_or(u32::MAX);
    for (a, &from) in places.iter().enumerate() {
        let mut hopeless = [false; SHARES.len()];
        for (b, &to) in places.iter().enumerate().skip(a + 1) {
            if hopeless.iter().all(|hopeless| *hopeless) {
                break;
            }
            let way = grid.depth_mm(to) - grid.depth_mm(from);
            for (i, share) in SHARES.iter().enumerate() {
                if hopeless[i] {
                    continue;
                }
                let v = envelope.feed[from] * share;
                let mut any = false;
                for (j, other) in SHARES.iter().enumerate() {
                    let w = envelope.feed[to] * other;
                    let knots = [
                        Knot { depth_mm: grid.depth_mm(from), feed_mm_min: v },
                        Knot { depth_mm: grid.depth_mm(to), feed_mm_min: w },
                    ];
                    let slope = (w - v) / (to - from) as f64;
                    let under = (from + 1..to).all(|node| {
                        v + slope * (node - from) as f64 <= envelope.feed[node] * (1.0 + ROUNDING)
                    });
                    if !under {
                        continue;
                    }
                    any = true;
                    if acceleration_mm_s2(knots[0], knots[1]) > planner.acceleration() {
                        continue;
                    }
                    let cost = if time_only {
                        let mean = if (w - v).abs() > 1e-9 * v { (w / v).ln() / (w - v) } else { 1.0 / v };
                        weight * way * mean
                    } else {
                        (from..to)
                            .map(|node| {
                                let at = v + slope * ((node - from) as f64 + 0.5);
                                planner.local_cost(node, envelope.heat[node], at) * grid.step_mm()
                            })
                            .sum()
                    };
                    edges.push(Edge { from: state(a, i), to: state(b, j), cost });
                }
                // No line from here gets under the envelope this far out, at any feed: none does further out.
                hopeless[i] = !any;
            }
        }
    }
    edges
}

/// Moves knots one by one while it helps; never to where bounds are crossed more than before.
pub(super) fn polish(planner: &Planner<'_>, mut knots: Vec<Knot>) -> Vec<Knot> {
    for ((feed_move, depth_move), weight) in FEED_MOVES.into_iter().zip(DEPTH_MOVES_MM).zip(CROSSING_WEIGHTS)
    {
        let value = |knots: &[Knot]| {
            let out = planner.outlook(knots);
            out.cost * (1.0 + weight * out.crossed)
        };
        let mut best = value(&knots);
        for _ in 0..SWEEPS {
            let before = best;
            for at in 0..knots.len() {
                for (feed, depth) in moves(feed_move, depth_move) {
                    let mut moved = knots.clone();
                    moved[at].feed_mm_min *= feed;
                    if at > 0 && at + 1 < knots.len() {
                        moved[at].depth_mm += depth;
                    } else if depth.abs() > 0.0 {
                        continue;
                    }
                    if !possible(planner, &moved, at) {
                        continue;
                    }
                    let now = value(&moved);
                    if now < best {
                        (best, knots) = (now, moved);
                    }
                }
            }
            // Two neighbours at once: along an edge of the envelope neither can move alone.
            for at in 0..knots.len().saturating_sub(1) {
                for (one, other) in [(1.0, -0.5), (-0.5, 1.0), (1.0, 1.0)] {
                    let mut moved = knots.clone();
                    moved[at].feed_mm_min *= 1.0 + feed_move * one;
                    moved[at + 1].feed_mm_min *= 1.0 + feed_move * other;
                    if !(possible(planner, &moved, at) && possible(planner, &moved, at + 1)) {
                        continue;
                    }
                    let now = value(&moved);
                    if now < best {
                        (best, knots) = (now, moved);
                    }
                }
            }
            if best > before * (1.0 - 1e-5) {
                break;
            }
        }
    }
    knots
}

fn moves(feed: f64, depth: f64) -> [(f64, f64); 8] {
    let (up, down) = (1.0 + feed, 1.0 / (1.0 + feed));
    [
        (up, 0.0),
        (1.0, depth),
        (1.0, -depth),
        (up, depth),
        (up, -depth),
        (down, 0.0),
        (down, depth),
        (down, -depth),
    ]
}

/// Whether a moved knot keeps order, feed limits and acceleration.
fn possible(planner: &Planner<'_>, knots: &[Knot], at: usize) -> bool {
    let factor = planner.settings.override_factor();
    let feed = knots[at].feed_mm_min;
    let cap = planner.cap_at(knots[at].depth_mm) * (1.0 + ROUNDING);
    if feed > cap || feed < planner.settings.feed_min_mm_min * factor {
        return false;
    }
    let pair = |left: Knot, right: Knot| {
        right.depth_mm - left.depth_mm >= LEAST_DISTANCE_MM
            && acceleration_mm_s2(left, right) <= planner.acceleration()
    };
    (at == 0 || pair(knots[at - 1], knots[at])) && (at + 1 == knots.len() || pair(knots[at], knots[at + 1]))
}

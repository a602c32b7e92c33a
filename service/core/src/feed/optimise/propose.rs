//! From cycles to a proposal.

use super::course::Course;
use super::explain::{Section, sections};
use super::grid::Grid;
use super::plan::{Envelope, Planner, acting};
use super::predict::{Band, Prediction, follow, predict};
use super::profile::{Knots, acceleration_mm_s2};
use super::recording::{MOST_CYCLES, RecordedCycle, SkipReason, Skipped, nothing_usable};
use super::relation::{MEMORY_S, Relation};
use super::settings::Settings;
use super::simplify::{polish, simplify};
use crate::friction::error::Invalid;
use crate::friction::program::Knot;
use std::cmp::Ordering;

/// Resolution of proposed knots: depths in mm and feeds in mm/min.
const DEPTH_RESOLUTION_MM: f64 = 0.001;
const FEED_RESOLUTION_MM_MIN: f64 = 0.1;

/// Gain below which the last tried profile stays: less than cycles differ by.
const LEAST_GAIN: f64 = 0.003;

/// Crossing of a load's bound that is none, in ln load.
const HAIR: f64 = 0.01;

/// Offset of a cycle from the others beyond which it is another process, in ln load.
const OUTLIER: f64 = 0.25;

/// Delays of the loads that are tried, s, and how much better than none one has to fit.
const DELAYS_S: [f64; 5] = [0.01, 0.02, 0.03, 0.04, 0.06];
const CLEARLY_BETTER: f64 = 0.85;

/// Median difference in ln feed up to which a cycle ran the profile tried last, and the longest lag of an axis.
const SAME_FEED: f64 = 0.04;
const MOST_SERVO_LAG_S: f64 = 0.1;

/// Lags that are tried, the largest difference in ln feed that counts in fitting one, and the last of the way, in which
/// the axis stops and says nothing of its lag, mm.
const SERVO_STEPS: u32 = 50;
const MOST_OFF: f64 = 0.2;
const STOPPING_MM: f64 = 0.5;

/// Steps in which the wear is tried up to which a profile holds, and where the trying ends.
const WEAR_STEP: f64 = 0.0025;
const MOST_MORE_WEAR: f64 = 0.2;

/// Share of the way at which nothing is known, beyond which the proposal says so.
const TOLD_UNKNOWN: f64 = 0.02;

/// What to do with a proposal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Advice {
    /// Run it for a cycle, record, and ask again.
    Try,
    /// The last tried profile stays: nothing better is expected within the limits.
    Keep,
    /// The last tried profile is expected to cross a limit; run this one instead of it.
    Replace,
}

/// What the user should know beside the numbers. The word is stable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Warning {
    /// At some depths no cycle says anything; the feed there is not raised.
    DepthUnknown,
    /// At some depths a load stays above its set load even at the smallest feed that this step allows.
    LoadAboveSet,
    /// All feeds so far were alike (or chosen by a law): how loads grow with the feed is an assumption.
    SlopeAssumed,
    /// Wear is not known, or all cycles ran at the same: how loads grow with wear is an assumption.
    WearAssumed,
    /// Cycles that were not used are named in `skipped`.
    CyclesSkipped,
    /// No proposal within all limits was found; the last tried profile is returned.
    NothingBetter,
    /// The profile tried last breaks a limit of the settings.
    LastBreaksLimits,
    /// Cycles at the same feed differ by more than can be explained; margins are wide.
    CyclesDisagree,
}

impl Warning {
    /// The stable word.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::DepthUnknown => "depth_unknown",
            Self::LoadAboveSet => "load_above_set",
            Self::SlopeAssumed => "slope_assumed",
            Self::WearAssumed => "wear_assumed",
            Self::CyclesSkipped => "cycles_skipped",
            Self::NothingBetter => "nothing_better",
            Self::LastBreaksLimits => "last_breaks_limits",
            Self::CyclesDisagree => "cycles_disagree",
        }
    }
}

/// What was learned of one drive, over all depths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Identified {
    /// Relative rise of the load over idle with the feed: 0.7 means 7 % for 10 % more feed.
    pub slope: f64,
    /// Its standard deviation.
    pub slope_sd: f64,
    /// Relative fall of the load with heat put in before, in units of ln(1 + heat / scale).
    pub memory: f64,
    /// Its standard deviation.
    pub memory_sd: f64,
    /// Unevenness of the load within a cycle, relative.
    pub uneven: f64,
    /// Unevenness from cycle to cycle, relative.
    pub common: f64,
}

/// A proposed profile with everything that a reviewer asks.
#[derive(Debug, Clone, PartialEq)]
pub struct Proposal {
    /// Programmed feed over depth.
    pub knots: Knots,
    /// What to do with it.
    pub advice: Advice,
    /// Section by section: what binds, what was gained, how sure.
    pub sections: Vec<Section>,
    /// What one cycle of it is expected to show.
    pub prediction: Prediction,
    /// What the last tried profile is expected to show.
    pub last_prediction: Prediction,
    /// Largest wear, as energy over that of the new tool, up to which both loads are expected to stay within the
    /// tolerance at the asked confidence. `None` where the wear of the cycles is not known.
    pub holds_up_to_wear: Option<f64>,
    /// The same as an increase from the wear that it was planned at; known without any wear.
    pub holds_for_more_wear: f64,
    /// Smallest probability over the depth that an expected load is at or below L_set.
    pub confidence: f64,
    /// What was learned of feed drive and spindle.
    pub identified: [Identified; 2],
    /// Idle loads (feed drive, spindle) that loads are counted over, percent.
    pub idle_percent: [f64; 2],
    /// Cycles that were learned from.
    pub learned_from: usize,
    /// Cycles that were not, and why.
    pub skipped: Vec<Skipped>,
    /// What else to know, in a fixed order.
    pub warnings: Vec<Warning>,
}

/// Proposes the next profile to try.
///
/// `last` is the profile that was tried last and bounds the step; without it the latest cycle's own feed does. Cycles may
/// come in any order.
///
/// # Errors
/// `cycles` when none is usable, with the reason of the first; `last` when it does not fit the settings' depth.
pub fn optimise(
    cycles: &[RecordedCycle],
    settings: &Settings,
    last: Option<&Knots>,
) -> Result<Proposal, Invalid> {
    let mut corners = Vec::new();
    corners.extend(settings.heating.map(|heating| heating.until_mm));
    corners.extend(settings.bushing.map(|bushing| bushing.to_mm));
    let grid = Grid::new(settings.depth_mm, &corners);
    let (mut courses, mut skipped) = read(cycles, settings, &grid, 0.0);
    if courses.is_empty() {
        return Err(nothing_usable(&skipped));
    }
    let factor = settings.override_factor();
    let (feed, least) = match last {
        Some(knots) => acting(knots, &grid, factor),
        None => run_feed(&courses, &grid, settings),
    };
    let about: Vec<f64> = feed.iter().map(|feed| feed.ln()).collect();
    let idle = settings.idle_percent.unwrap_or_else(|| common_idle(&courses, settings));
    let learn = |courses: &[Course]| {
        Relation::learn(grid, courses, &about, idle, settings.wear_ratio, settings.spread_scale)
    };
    let mut relation = learn(&courses);
    if courses.len() >= 2 {
        // Loads that arrive late fit no depth once the feeds differ; the delay that fits best is taken, if clearly.
        let mut least = relation.missed * CLEARLY_BETTER;
        for later_s in DELAYS_S {
            let (late, _) = read(cycles, settings, &grid, later_s);
            if late.len() != courses.len() {
                continue;
            }
            let other = learn(&late);
            if other.missed < least {
                (least, relation, courses) = (other.missed, other, late);
            }
        }
    }
    if courses.len() >= 3 {
        let strange: Vec<bool> = relation.offsets.iter().map(|offset| offset.abs() > OUTLIER).collect();
        let kept = strange.iter().filter(|strange| !**strange).count();
        if kept < courses.len() && kept >= 2 {
            let mut at = 0;
            courses.retain(|course| {
                let keep = !strange[at];
                at += 1;
                if !keep {
                    skipped.push(Skipped { id: course.id.clone(), reason: SkipReason::Outlier });
                }
                keep
            });
            relation = learn(&courses);
        }
    }
    skipped.sort_by(|a, b| a.id.cmp(&b.id).then(a.reason.as_str().cmp(b.reason.as_str())));
    let lag_s = last.and_then(|_| followed_with_lag_s(&courses, &feed, &grid));
    let planner = Planner::new(&relation, settings, feed, &least).with_servo(lag_s.unwrap_or(0.0));
    let planner = match lag_s {
        Some(_) => planner.after_overload(&seen_loads(cycles, &courses, settings, &grid)),
        None => planner,
    };
    let planner = planner.with_even_risk();
    let envelope = planner.envelope();
    let last_knots =
        last.map_or_else(|| on_grid(&planner.last, &grid), |knots| scaled(knots.as_slice(), factor));
    Ok(assemble(&planner, &envelope, last, &last_knots, &courses, skipped))
}

fn assemble(
    planner: &Planner<'_>,
    envelope: &Envelope,
    last: Option<&Knots>,
    last_knots: &[Knot],
    courses: &[Course],
    skipped: Vec<Skipped>,
) -> Proposal {
    let settings = planner.settings;
    let factor = settings.override_factor();
    let mut warnings = Vec::new();
    let last_valid =
        last.is_some_and(|knots| settings.check(knots).is_ok() && planner.keeps_limits(last_knots));
    if last.is_some() && !last_valid {
        warnings.push(Warning::LastBreaksLimits);
    }
    let last_outlook = planner.outlook(last_knots);
    let last_keeps = last_valid && last_outlook.most_crossed <= HAIR;
    let gains = |knots: &Knots| {
        planner.outlook(&scaled(knots.as_slice(), factor)).cost <= last_outlook.cost * (1.0 - LEAST_GAIN)
    };
    let mut found = settle(planner, &simplify(planner, envelope, settings.most_knots));
    if last_keeps && !found.as_ref().is_some_and(gains) {
        // Few knots on fixed depths may miss a way under a steep envelope that the last profile shows.
        found = settle(planner, &polish(planner, last_knots.to_vec())).or(found);
    }
    let (knots, advice) = match (found, last) {
        (Some(found), Some(last)) => {
            if last_keeps && !gains(&found) {
                (last.clone(), Advice::Keep)
            } else {
                (found, if last_keeps { Advice::Try } else { Advice::Replace })
            }
        }
        (Some(found), None) => (found, Advice::Try),
        (None, _) => {
            warnings.push(Warning::NothingBetter);
            (fallback(planner, last), Advice::Keep)
        }
    };
    let acting_knots = scaled(knots.as_slice(), factor);
    let nodes = follow(planner, &acting_knots, 0.0);
    let confidence = nodes.iter().map(|node| planner.confidence(node)).fold(1.0, f64::min);
    let unknown = planner.relation.nodes.iter().filter(|node| node.is_none()).count();
    if unknown as f64 > TOLD_UNKNOWN * planner.relation.grid.count() as f64 {
        warnings.push(Warning::DepthUnknown);
    }
    if planner.outlook(&acting_knots).most_crossed > HAIR || planner.stays_above(&nodes) {
        warnings.push(Warning::LoadAboveSet);
    }
    if planner.relation.slope.iter().any(|(_, sd)| *sd > 0.2) {
        warnings.push(Warning::SlopeAssumed);
    }
    if !planner.relation.wear_known {
        warnings.push(Warning::WearAssumed);
    }
    if !skipped.is_empty() {
        warnings.push(Warning::CyclesSkipped);
    }
    if planner.relation.noise.iter().any(|noise| noise.common > 0.08) {
        warnings.push(Warning::CyclesDisagree);
    }
    warnings.sort_unstable();
    let more = holds_for_more_wear(planner, &acting_knots);
    Proposal {
        sections: sections(planner, envelope, &nodes, last_knots),
        prediction: predict(planner, &acting_knots),
        last_prediction: predict(planner, last_knots),
        holds_up_to_wear: planner.relation.wear_ratio.map(|wear| wear + more),
        holds_for_more_wear: more,
        confidence,
        identified: [0, 1].map(|drive| Identified {
            slope: planner.relation.slope[drive].0,
            slope_sd: planner.relation.slope[drive].1,
            memory: planner.relation.memory[drive],
            memory_sd: planner.relation.memory_var[drive].sqrt(),
            uneven: planner.relation.noise[drive].uneven,
            common: planner.relation.noise[drive].common,
        }),
        idle_percent: planner.relation.idle,
        learned_from: courses.len(),
        skipped,
        warnings,
        knots,
        advice,
    }
}

/// Reads the cycles in the order of time, latest last.
fn read(
    cycles: &[RecordedCycle],
    settings: &Settings,
    grid: &Grid,
    later_s: f64,
) -> (Vec<Course>, Vec<Skipped>) {
    let mut sorted: Vec<&RecordedCycle> = cycles.iter().collect();
    sorted.sort_by(|a, b| compare_cycles(a, b));
    let mut skipped = Vec::new();
    let mut courses: Vec<Course> = Vec::new();
    for (at, cycle) in sorted.iter().enumerate() {
        let repeated = at > 0 && sorted[at - 1].id == cycle.id && sorted[at - 1].order == cycle.order;
        let result = if repeated {
            Err(SkipReason::Duplicate)
        } else {
            cycle
                .check(&settings.operation)
                .and_then(|()| Course::read(cycle, grid, settings.idle_percent, MEMORY_S, later_s))
        };
        match result {
            Ok(course) => courses.push(course),
            Err(reason) => skipped.push(Skipped { id: cycle.id.clone(), reason }),
        }
    }
    let old = courses.len().saturating_sub(MOST_CYCLES);
    for course in courses.drain(..old) {
        skipped.push(Skipped { id: course.id, reason: SkipReason::TooOld });
    }
    (courses, skipped)
}

/// A total order, so that no order of arrival shows in the sums.
fn compare_cycles(a: &RecordedCycle, b: &RecordedCycle) -> Ordering {
    let columns = |cycle: &RecordedCycle| {
        let feed = cycle.feed_mm_min.clone().unwrap_or_default();
        [&cycle.time_s, &cycle.depth_mm, &cycle.feed_drive_percent, &cycle.spindle_percent, &feed]
            .into_iter()
            .flatten()
            .map(|value| value.to_bits())
            .collect::<Vec<u64>>()
    };
    a.order
        .cmp(&b.order)
        .then_with(|| a.id.cmp(&b.id))
        .then_with(|| a.operation.cmp(&b.operation))
        .then_with(|| columns(a).cmp(&columns(b)))
}

/// Idle loads: the smallest of the cycles, and always below the set loads.
fn common_idle(courses: &[Course], settings: &Settings) -> [f64; 2] {
    [0, 1].map(|drive| {
        let least = courses.iter().map(|course| course.idle[drive]).fold(f64::INFINITY, f64::min);
        least.min(settings.set_percent()[drive] * 0.9)
    })
}

/// The feed that the latest cycle ran, with the feed of the nearest known depth where it says nothing.
fn run_feed(courses: &[Course], grid: &Grid, settings: &Settings) -> (Vec<f64>, Vec<f64>) {
    let smallest = settings.feed_min_mm_min;
    let Some(latest) = courses.last() else {
        return (vec![smallest; grid.count()], vec![smallest; grid.count()]);
    };
    let known: Vec<(usize, f64)> =
        latest.ran.iter().enumerate().filter_map(|(node, x)| Some((node, (*x)?.exp()))).collect();
    let feed: Vec<f64> = (0..grid.count())
        .map(|node| {
            let nearest = known.iter().min_by_key(|(other, _)| other.abs_diff(node));
            nearest.map_or(smallest, |(_, feed)| feed.max(smallest))
        })
        .collect();
    let least = (0..grid.count())
        .map(|node| {
            feed[node.saturating_sub(1)..(node + 2).min(grid.count())]
                .iter()
                .copied()
                .fold(f64::INFINITY, f64::min)
        })
        .collect();
    (feed, least)
}

/// How far the axis lagged behind the programmed feed in the latest cycle, s; `None` if that cycle did not run the profile.
///
/// An axis that lags runs faster than programmed wherever the profile slows down, so whether it ran the profile is judged
/// with the lag that fits best: judged without, the worst axes would count as having run something else.
fn followed_with_lag_s(courses: &[Course], programmed: &[f64], grid: &Grid) -> Option<f64> {
    let latest = courses.last()?;
    let off = |servo_s: f64| {
        let mut before = None;
        let mut off = Vec::with_capacity(grid.count());
        for (node, (reading, feed)) in latest.readings.iter().zip(programmed).enumerate() {
            let acting = super::plan::acting_feed(*feed, before, grid.step_mm(), servo_s);
            before = Some(acting);
            // Not where the axis stops at the end of the path.
            if let Some(reading) = reading
                && grid.end_mm() - grid.depth_mm(node) > STOPPING_MM
            {
                off.push((reading.x - acting.ln()).abs());
            }
        }
        off
    };
    let misfit = |servo_s: f64| off(servo_s).iter().map(|off| off.min(MOST_OFF).powi(2)).sum::<f64>();
    let (mut best_s, mut least) = (0.0, misfit(0.0));
    for step in 1..=SERVO_STEPS {
        let servo_s = MOST_SERVO_LAG_S * f64::from(step) / f64::from(SERVO_STEPS);
        let misfit = misfit(servo_s);
        if misfit < least {
            (best_s, least) = (servo_s, misfit);
        }
    }
    let mut off = off(best_s);
    (!off.is_empty() && super::course::quantile(&mut off, 0.5) <= SAME_FEED).then_some(best_s)
}

/// ln of the larger filtered load over its set load at each node, from the latest cycle.
fn seen_loads(
    cycles: &[RecordedCycle],
    courses: &[Course],
    settings: &Settings,
    grid: &Grid,
) -> Vec<Option<f64>> {
    let mut seen: Vec<Option<f64>> = vec![None; grid.count()];
    let Some(latest) = courses.last() else { return seen };
    let matching =
        cycles.iter().filter(|cycle| cycle.id == latest.id && cycle.operation == settings.operation);
    let Some(cycle) = matching.min_by(|a, b| compare_cycles(a, b)) else { return seen };
    let set = settings.set_percent();
    super::outcome::filtered(cycle, |depth, load| {
        let node = grid.nearest(depth);
        let over = (load[0] / set[0]).max(load[1] / set[1]).max(1e-3).ln();
        seen[node] = Some(seen[node].map_or(over, |before| before.max(over)));
    });
    seen
}

fn on_grid(feed: &[f64], grid: &Grid) -> Vec<Knot> {
    (0..grid.count()).map(|node| Knot { depth_mm: grid.depth_mm(node), feed_mm_min: feed[node] }).collect()
}

fn scaled(knots: &[Knot], factor: f64) -> Vec<Knot> {
    knots.iter().map(|knot| Knot { feed_mm_min: knot.feed_mm_min * factor, ..*knot }).collect()
}

/// Whether acting knots stay under every limit that is no load, at nodes and knots.
fn within_caps(planner: &Planner<'_>, knots: &[Knot]) -> bool {
    crossing(planner, knots).is_none()
}

/// The depth at which acting knots cross a limit that is no load the most, and by which factor.
fn crossing(planner: &Planner<'_>, knots: &[Knot]) -> Option<(f64, f64)> {
    let grid = &planner.relation.grid;
    let nodes = (0..grid.count()).map(|node| grid.depth_mm(node));
    nodes
        .chain(knots.iter().map(|knot| knot.depth_mm))
        .map(|depth| (depth, super::profile::feed_at(knots, depth) / planner.cap_at(depth)))
        .filter(|(_, ratio)| *ratio > 1.0 + 1e-9)
        .max_by(|a, b| a.1.total_cmp(&b.1))
}

/// Acting feeds as programmed knots on the resolution of a control, checked against every limit that is no load.
fn settle(planner: &Planner<'_>, knots: &[Knot]) -> Option<Knots> {
    let settings = planner.settings;
    let factor = settings.override_factor();
    let end = settings.depth_mm;
    let count = knots.len();
    let mut rounded: Vec<Knot> = Vec::with_capacity(count);
    for (at, knot) in knots.iter().enumerate() {
        let place = knot.depth_mm / DEPTH_RESOLUTION_MM;
        let depth_mm = match at {
            0 => 0.0,
            _ if at + 1 == count => end,
            // The end of a slow stretch is rounded into the fast one.
            _ if knots[at + 1].feed_mm_min > knot.feed_mm_min => place.ceil() * DEPTH_RESOLUTION_MM,
            _ if knots[at - 1].feed_mm_min > knot.feed_mm_min => place.floor() * DEPTH_RESOLUTION_MM,
            _ => place.round() * DEPTH_RESOLUTION_MM,
        };
        let feed = floor_feed(knot.feed_mm_min / factor, settings);
        if rounded.last().is_some_and(|last| depth_mm <= last.depth_mm + 1e-9) {
            continue;
        }
        rounded.push(Knot { depth_mm, feed_mm_min: feed });
    }
    for _ in 0..16 * count {
        // Rounding may have made a step too steep or a knot too fast: the faster side gives way.
        let mut steep = false;
        for at in 1..rounded.len() {
            if acceleration_mm_s2(rounded[at - 1], rounded[at]) > settings.acceleration_mm_s2 {
                let faster = if rounded[at].feed_mm_min > rounded[at - 1].feed_mm_min { at } else { at - 1 };
                let slower = rounded[at].feed_mm_min.min(rounded[at - 1].feed_mm_min);
                let feed = slower + (rounded[faster].feed_mm_min - slower) * 0.98;
                rounded[faster].feed_mm_min = floor_feed(feed, settings);
                steep = true;
            }
        }
        let Some((depth, ratio)) = crossing(planner, &scaled(&rounded, factor)) else {
            if steep {
                continue;
            }
            break;
        };
        let after = rounded.partition_point(|knot| knot.depth_mm < depth - 1e-9).min(rounded.len() - 1);
        let before = after.saturating_sub(1);
        let cap = super::profile::feed_at(&rounded, depth) / ratio;
        let faster = if rounded[after].feed_mm_min >= rounded[before].feed_mm_min { after } else { before };
        let slower = if faster == after { before } else { after };
        let way = rounded[after].depth_mm - rounded[before].depth_mm;
        let part = if way > 0.0 { (depth - rounded[slower].depth_mm).abs() / way } else { 1.0 };
        let low = rounded[slower].feed_mm_min;
        // The faster knot comes down until the line passes under the limit; where the slower one is above it, both do.
        let feed = if low >= cap || part < 1e-6 { cap } else { low + (cap - low) / part };
        rounded[faster].feed_mm_min = floor_feed(feed.min(rounded[faster].feed_mm_min), settings);
        if low > cap {
            rounded[slower].feed_mm_min = floor_feed(cap, settings);
        }
    }
    let knots = Knots::new(rounded).ok()?;
    (settings.check(&knots).is_ok() && within_caps(planner, &scaled(knots.as_slice(), factor)))
        .then_some(knots)
}

fn floor_feed(feed: f64, settings: &Settings) -> f64 {
    let rounded = (feed / FEED_RESOLUTION_MM_MIN + 1e-6).floor() * FEED_RESOLUTION_MM_MIN;
    rounded.clamp(settings.feed_min_mm_min, settings.feed_max_mm_min)
}

/// What is returned when no path was found: the last tried profile, else one feed under every limit.
fn fallback(planner: &Planner<'_>, last: Option<&Knots>) -> Knots {
    if let Some(last) = last {
        return last.clone();
    }
    let settings = planner.settings;
    let least = planner.caps.iter().map(|cap| cap.0).fold(f64::INFINITY, f64::min);
    let feed = floor_feed(least / settings.override_factor(), settings);
    let knots = [0.0, settings.depth_mm].map(|depth_mm| Knot { depth_mm, feed_mm_min: feed });
    Knots::of_two(knots)
}

/// The wear beyond the plan's up to which both loads stay within the tolerance at the asked confidence.
fn holds_for_more_wear(planner: &Planner<'_>, knots: &[Knot]) -> f64 {
    let mut holds = 0.0;
    let mut more = 0.0;
    while more < MOST_MORE_WEAR - 1e-9 {
        more += WEAR_STEP;
        let nodes = follow(planner, knots, more);
        if !nodes.iter().all(|node| planner.tolerates(node)) {
            break;
        }
        holds = more;
    }
    holds
}

impl Proposal {
    /// Expected time gained over the last tried profile, s.
    #[must_use]
    pub fn gain_s(&self) -> f64 {
        self.last_prediction.time_s.expected - self.prediction.time_s.expected
    }

    /// Band of the expected peak of the drive that comes closest to its set load, relative to it.
    #[must_use]
    pub fn closest_peak(&self, settings: &Settings) -> Band {
        let feed = self.prediction.peak_feed_drive_percent;
        let spindle = self.prediction.peak_spindle_percent;
        let over = |band: Band, set: f64| Band {
            low: band.low / set,
            expected: band.expected / set,
            high: band.high / set,
        };
        let (feed, spindle) =
            (over(feed, settings.set_feed_drive_percent), over(spindle, settings.set_spindle_percent));
        if feed.expected >= spindle.expected { feed } else { spindle }
    }
}

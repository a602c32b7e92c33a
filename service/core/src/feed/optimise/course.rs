//! One recorded cycle read over depth: at every node the feed, both loads over idle and the heat put in before.

use super::dead::{Beside, lowest_in_air, told};
use super::grid::Grid;
use super::recording::{LoadSignal, RecordedCycle, SkipReason, WEAR_RATIOS};
use crate::friction::relation::FeedSource;

/// Fewest usable samples in contact.
const FEWEST_SAMPLES: usize = 8;

/// Samples that one reading at a node needs to span.
const SAMPLES_PER_READING: f64 = 2.5;

/// Widest half window of one reading, mm: beyond it a node without samples stays unknown.
const WIDEST_HALF_WINDOW_MM: f64 = 0.9;

/// Narrowest half window of one reading, mm.
const NARROWEST_HALF_WINDOW_MM: f64 = 0.2;

/// Feed below which the tool stands, mm/min: its load says nothing about drilling.
const STANDSTILL_MM_MIN: f64 = 1.0;

/// Smallest load over idle that is told from none, points.
const SMALLEST_LOAD: f64 = 0.3;

/// Relative uncertainty of a load that is not told from none.
const UNTOLD: f64 = 0.5;

/// Longest time between two samples that tell what the tool did meanwhile, s.
const LONGEST_STEP_S: f64 = 0.25;

/// Largest disagreement between feed column and depth over time.
const FEED_AGREES: std::ops::RangeInclusive<f64> = 0.7..=1.4;

/// Peak over idle below which nothing was drilled, points (with the noise counted in).
const LEAST_PEAK: f64 = 1.0;

/// What a cycle says at one node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reading {
    /// ln of the actual feed in mm/min.
    pub(super) x: f64,
    /// ln of the loads over idle in percent (feed drive, spindle).
    pub(super) y: [f64; 2],
    /// Variance of `y` from the noise of reading alone.
    pub(super) var: [f64; 2],
    /// Heat put in before, √percent·s of the spindle load over idle.
    pub(super) heat: f64,
}

/// A cycle over the nodes of a grid.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Course {
    pub(super) id: String,
    pub(super) source: FeedSource,
    pub(super) wear_ratio: Option<f64>,
    pub(super) readings: Vec<Option<Reading>>,
    /// ln of the actual feed at every node, also where the loads tell nothing.
    pub(super) ran: Vec<Option<f64>>,
    pub(super) idle: [f64; 2],
    /// Standard deviation of reading each load, points.
    pub(super) reading_sd: [f64; 2],
    /// Period of the samples, s.
    pub(super) period_s: f64,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    time_s: f64,
    pub(super) depth_mm: f64,
    feed: f64,
    pub(super) load: [f64; 2],
}

impl Course {
    /// Reads a cycle. `idle` overrides what its samples before contact say; `memory_s` is how long heat lasts,
    /// `later_s` how much later than told its loads are.
    pub(super) fn read(
        cycle: &RecordedCycle,
        grid: &Grid,
        idle: Option<[f64; 2]>,
        memory_s: f64,
        later_s: f64,
    ) -> Result<Self, SkipReason> {
        if cycle.wear_ratio.is_some_and(|wear| !WEAR_RATIOS.contains(&wear)) {
            return Err(SkipReason::WearOutOfRange);
        }
        let mut samples = usable(cycle);
        let period_s = median(samples.windows(2).map(|pair| pair[1].time_s - pair[0].time_s).collect());
        if period_s > LONGEST_STEP_S {
            return Err(SkipReason::SampledTooRarely);
        }
        if samples.len() < FEWEST_SAMPLES {
            return Err(SkipReason::TooShort);
        }
        let idle = idle.unwrap_or_else(|| idle_loads(&samples));
        let reading_sd = [0, 1].map(|drive| reading_sd(&samples, drive));
        let air = lowest_in_air(&samples);
        let delay_s = match cycle.signal {
            LoadSignal::Raw => 0.0,
            LoadSignal::Filtered(weights) => weights.ramp_lag_samples() * period_s,
            LoadSignal::Delayed(seconds) => seconds,
        };
        let delay_s = delay_s + later_s;
        if delay_s > 0.0 {
            samples = shifted(&samples, delay_s);
        }
        samples.retain(|sample| sample.depth_mm >= 0.0);
        if samples.len() < FEWEST_SAMPLES {
            return Err(SkipReason::TooShort);
        }
        check_feed(&samples)?;
        let peak = |drive: usize| samples.iter().map(|s| s.load[drive] - idle[drive]).fold(0.0, f64::max);
        let least = reading_sd.map(|sd| LEAST_PEAK + 4.0 * sd);
        if (0..2).all(|drive| peak(drive) < least[drive]) {
            return Err(SkipReason::NoLoad);
        }
        let told = told(&samples, Beside { idle, told: least, air })?;
        let mut front = front(&samples, &told, idle[1], memory_s);
        let mut readings = read_nodes(&front, grid, idle, reading_sd);
        let ran = readings.iter().map(|reading| reading.map(|reading| reading.x)).collect();
        if front.iter().any(|one| !one.told) {
            front.retain(|one| one.told);
            readings = read_nodes(&front, grid, idle, reading_sd);
        }
        if readings.iter().flatten().count() < grid.count() / 10 {
            return Err(SkipReason::TooShort);
        }
        let (id, source, wear_ratio) = (cycle.id.clone(), cycle.source, cycle.wear_ratio);
        Ok(Self { id, source, wear_ratio, readings, ran, idle, reading_sd, period_s })
    }
}

/// Samples of the way in, in which every number is one, in strictly increasing time.
///
/// Loads that arrive late are not read beyond its end either: until the delay is known, what comes there may as well be the
/// way out.
fn usable(cycle: &RecordedCycle) -> Vec<Sample> {
    let mut samples: Vec<Sample> = Vec::with_capacity(cycle.time_s.len());
    for at in 0..cycle.time_s.len().min(cycle.end_of_way() + 1) {
        let sample = Sample {
            time_s: cycle.time_s[at],
            depth_mm: cycle.depth_mm[at],
            feed: cycle.feed_mm_min.as_ref().map_or(0.0, |feed| feed[at]),
            load: [cycle.feed_drive_percent[at], cycle.spindle_percent[at]],
        };
        let numbers = [sample.time_s, sample.depth_mm, sample.feed, sample.load[0], sample.load[1]];
        let later = samples.last().is_none_or(|last| sample.time_s > last.time_s);
        if numbers.iter().all(|value| value.is_finite() && value.abs() < 1e6) && later {
            samples.push(sample);
        }
    }
    if cycle.feed_mm_min.is_none() {
        let count = samples.len();
        let feeds: Vec<f64> = (0..count)
            .map(|at| {
                let (from, to) = (samples[at.saturating_sub(2)], samples[(at + 2).min(count - 1)]);
                let time = to.time_s - from.time_s;
                if time > 0.0 { (to.depth_mm - from.depth_mm) / time * 60.0 } else { 0.0 }
            })
            .collect();
        for (sample, feed) in samples.iter_mut().zip(feeds) {
            sample.feed = feed;
        }
    }
    samples
}

/// Loads moved back to where they arose: each with the depth and feed of `delay_s` before.
fn shifted(samples: &[Sample], delay_s: f64) -> Vec<Sample> {
    let mut moved = Vec::with_capacity(samples.len());
    let mut at = 0;
    for sample in samples {
        let time_s = sample.time_s - delay_s;
        while at + 1 < samples.len() && samples[at + 1].time_s <= time_s {
            at += 1;
        }
        let (Some(left), Some(right)) = (samples.get(at), samples.get(at + 1)) else { continue };
        if time_s < left.time_s {
            continue;
        }
        let part = (time_s - left.time_s) / (right.time_s - left.time_s);
        let mix = |a: f64, b: f64| a + part * (b - a);
        moved.push(Sample {
            time_s,
            depth_mm: mix(left.depth_mm, right.depth_mm),
            feed: mix(left.feed, right.feed),
            load: sample.load,
        });
    }
    moved
}

fn median(mut values: Vec<f64>) -> f64 {
    quantile(&mut values, 0.5)
}

/// A quantile of values that are all numbers; 0 of none.
pub(super) fn quantile(values: &mut [f64], share: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    values.sort_by(f64::total_cmp);
    values[super::grid::whole((values.len() - 1) as f64 * share + 0.5)]
}

/// Idle loads: low in the air, where the spindle may still spin up, and never above the lowest of the whole cycle.
fn idle_loads(samples: &[Sample]) -> [f64; 2] {
    [0, 1].map(|drive| {
        let mut air: Vec<f64> =
            samples.iter().filter(|s| s.depth_mm < -0.05).map(|s| s.load[drive]).collect();
        let mut all: Vec<f64> = samples.iter().map(|s| s.load[drive]).collect();
        let low = quantile(&mut all, 0.02);
        if air.len() >= 5 { quantile(&mut air, 0.35).max(0.0).min(low.max(0.0) + 3.0) } else { low.max(0.0) }
    })
}

/// Noise of reading from second differences, which neither level nor trend moves.
fn reading_sd(samples: &[Sample], drive: usize) -> f64 {
    let bends: Vec<f64> = samples
        .windows(3)
        .map(|w| (w[0].load[drive] - 2.0 * w[1].load[drive] + w[2].load[drive]).abs())
        .collect();
    // The median of |x| of a normal x is 0.6745 σ; a second difference has 6 times the variance.
    median(bends) / (0.6745 * 6.0_f64.sqrt())
}

fn check_feed(samples: &[Sample]) -> Result<(), SkipReason> {
    let (mut by_feed, mut by_depth) = (0.0, 0.0);
    let mut rarely = true;
    for pair in samples.windows(2) {
        let step_s = pair[1].time_s - pair[0].time_s;
        by_feed += (pair[0].feed + pair[1].feed) / 2.0 / 60.0 * step_s.min(LONGEST_STEP_S);
        if step_s <= LONGEST_STEP_S {
            by_depth += pair[1].depth_mm - pair[0].depth_mm;
            rarely = false;
        }
    }
    if rarely {
        return Err(SkipReason::SampledTooRarely);
    }
    if by_depth <= 0.0 {
        return Err(SkipReason::TooShort);
    }
    if FEED_AGREES.contains(&(by_feed / by_depth)) { Ok(()) } else { Err(SkipReason::FeedContradictsDepth) }
}

struct Front {
    depth_mm: f64,
    x: f64,
    load: [f64; 2],
    heat: f64,
    /// Whether the loads are a reading: a drive that may be dead tells nothing.
    told: bool,
}

/// The samples that go deeper than any before, each with the heat put in until then; what stands still or runs back
/// adds heat and time and no reading.
fn front(samples: &[Sample], told: &[bool], idle_spindle: f64, memory_s: f64) -> Vec<Front> {
    let mut front: Vec<Front> = Vec::with_capacity(samples.len());
    let (mut heat, mut deepest, mut before) = (0.0, -1e-9, samples[0].time_s);
    for (sample, told) in samples.iter().zip(told) {
        let dt = sample.time_s - before;
        before = sample.time_s;
        heat *= (-dt / memory_s).exp();
        if sample.depth_mm > deepest && sample.feed >= STANDSTILL_MM_MIN {
            deepest = sample.depth_mm;
            front.push(Front {
                depth_mm: sample.depth_mm,
                x: sample.feed.ln(),
                load: sample.load,
                heat,
                told: *told,
            });
        }
        heat += super::relation::heat_rate(sample.load[1] - idle_spindle) * dt;
    }
    front
}

/// A local line over depth at every node, triangular weights.
fn read_nodes(front: &[Front], grid: &Grid, idle: [f64; 2], reading_sd: [f64; 2]) -> Vec<Option<Reading>> {
    let mut readings = vec![None; grid.count()];
    let Some(deepest) = front.last().map(|last| last.depth_mm) else { return readings };
    for (node, reading) in readings.iter_mut().enumerate() {
        let depth = grid.depth_mm(node);
        if depth > deepest + grid.step_mm() {
            break;
        }
        let here = front.partition_point(|one| one.depth_mm < depth).min(front.len() - 1);
        let (before, after) = (front[here.saturating_sub(1)].depth_mm, front[here].depth_mm);
        let spacing = (after - before).max(0.0);
        let half = NARROWEST_HALF_WINDOW_MM.max(SAMPLES_PER_READING / 2.0 * spacing).max(grid.step_mm());
        if half > WIDEST_HALF_WINDOW_MM {
            continue;
        }
        let from = front.partition_point(|one| one.depth_mm < depth - half);
        let to = front.partition_point(|one| one.depth_mm <= depth + half);
        *reading = local_line(&front[from..to], depth, half, idle, reading_sd);
    }
    readings
}

fn local_line(
    window: &[Front],
    depth: f64,
    half: f64,
    idle: [f64; 2],
    reading_sd: [f64; 2],
) -> Option<Reading> {
    let (mut sum, mut sum_u, mut sum_uu, mut squares) = (0.0, 0.0, 0.0, 0.0);
    let mut values = [[0.0; 2]; 4];
    for one in window {
        let u = one.depth_mm - depth;
        let weight = 1.0 - (u.abs() / half) + 0.05;
        sum += weight;
        sum_u += weight * u;
        sum_uu += weight * u * u;
        squares += weight * weight;
        for (value, y) in values.iter_mut().zip([one.x, one.load[0], one.load[1], one.heat]) {
            value[0] += weight * y;
            value[1] += weight * u * y;
        }
    }
    if window.len() < 2 || sum <= 0.0 {
        return None;
    }
    let effective = sum * sum / squares;
    let determinant = sum * sum_uu - sum_u * sum_u;
    // A line needs a spread of depths and samples on both sides; else the mean.
    let both = window.first()?.depth_mm < depth && window.last()?.depth_mm > depth;
    let line = both && determinant > 1e-6 * sum * sum * half * half;
    let at = |value: [f64; 2]| {
        if line { (value[0] * sum_uu - value[1] * sum_u) / determinant } else { value[0] / sum }
    };
    let mut y = [0.0; 2];
    let mut var = [0.0; 2];
    for drive in 0..2 {
        let load = at(values[1 + drive]) - idle[drive];
        let noise = reading_sd[drive] / effective.sqrt();
        let smallest = SMALLEST_LOAD.max(noise);
        if load > smallest {
            y[drive] = load.ln();
            var[drive] = (noise / load).powi(2);
        } else {
            y[drive] = smallest.ln();
            var[drive] = UNTOLD * UNTOLD;
        }
    }
    Some(Reading { x: at(values[0]), y, var, heat: at(values[3]).max(0.0) })
}

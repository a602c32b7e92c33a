//! Trend of the ratios over a tool's life, from a bounded number of points.

use super::WORN_LEVEL;
use super::verdict::{Remaining, Trend};
use crate::summary::median;
use std::sync::OnceLock;

/// Points kept; when there are more, neighbours are merged and each stands for twice as many cycles.
const MAX_POINTS: usize = 48;
/// The trend is told from the last so many points, so that it follows the tool's present phase of life.
const TREND_POINTS: usize = 24;
/// Points needed before a trend is evidence.
const MIN_POINTS: usize = 10;
/// Standard normal quantile of a two-sided 90 % interval.
const Z_90: f64 = 1.645;
/// More remaining cycles than this are not told apart from "no end in sight".
const MOST_REMAINING: f64 = 10_000_000.0;

/// Ratios over the count of counted cycles, thinned to a bounded number of points.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TrendPoints {
    /// Counted cycles that one point stands for.
    pub(super) per_point: u64,
    /// Mean count and mean ratio of each point, oldest first.
    pub(super) points: Vec<(f64, f64)>,
    /// Sum of counts, sum of ratios and number of cycles of the point being filled.
    pub(super) filling: (f64, f64, u64),
    /// Ratios so far.
    pub(super) count: u64,
    pub(super) told: Told,
}

/// The trend of these points, once it was asked for. Each cycle asks, and in a long life one in hundreds completes a point.
#[derive(Debug, Clone, Default)]
pub(super) struct Told(OnceLock<Option<Trend>>);

impl PartialEq for Told {
    /// It follows from the points.
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Default for TrendPoints {
    fn default() -> Self {
        Self { per_point: 1, points: Vec::new(), filling: (0.0, 0.0, 0), count: 0, told: Told::default() }
    }
}

impl TrendPoints {
    pub(super) fn push(&mut self, ratio: f64) {
        self.push_at(self.count.saturating_add(1), ratio);
    }

    /// Adds a ratio at a place of its own, for those that are not there at every cycle.
    #[expect(clippy::cast_precision_loss, reason = "counts of cycles are far below 2^53")]
    pub(super) fn push_at(&mut self, place: u64, ratio: f64) {
        self.count = self.count.saturating_add(1);
        let (counts, ratios, n) = &mut self.filling;
        *counts += place as f64;
        *ratios += ratio;
        *n = n.saturating_add(1);
        if *n < self.per_point {
            return;
        }
        self.told = Told::default();
        self.points.push((*counts / *n as f64, *ratios / *n as f64));
        self.filling = (0.0, 0.0, 0);
        if self.points.len() == MAX_POINTS {
            let merge = |pair: &[(f64, f64)]| {
                (f64::midpoint(pair[0].0, pair[1].0), f64::midpoint(pair[0].1, pair[1].1))
            };
            self.points = self.points.chunks_exact(2).map(merge).collect();
            // A state that was damaged on its way may hold any number.
            self.per_point = self.per_point.saturating_mul(2);
        }
    }

    /// Theil–Sen slope with the distribution-free interval of Sen (1968); `None` before there is evidence.
    pub(super) fn trend(&self) -> Option<Trend> {
        *self.told.0.get_or_init(|| self.of_points())
    }

    fn of_points(&self) -> Option<Trend> {
        let points = &self.points[self.points.len().saturating_sub(TREND_POINTS)..];
        if points.len() < MIN_POINTS {
            return None;
        }
        let mut slopes = Vec::with_capacity(points.len() * (points.len() - 1) / 2);
        for (index, late) in points.iter().enumerate() {
            slopes.extend(points[..index].iter().map(|early| (late.1 - early.1) / (late.0 - early.0)));
        }
        #[expect(clippy::cast_precision_loss, reason = "at most 276 slopes")]
        let (n, pairs) = (points.len() as f64, slopes.len() as f64);
        let spread = Z_90 * (n * (n - 1.0) * (2.0 * n + 5.0) / 18.0).sqrt();
        let at = |place: f64| clamp_index(place, slopes.len());
        let (low, high) = (at((pairs - spread) / 2.0 - 1.0), at((pairs + spread) / 2.0));
        let middle = slopes.len() / 2;
        let below = middle - usize::from(slopes.len().is_multiple_of(2));
        let [slope_low, below, middle, slope_high] = of_ranks(&mut slopes, [low, below, middle, high]);
        Some(Trend {
            slope_per_cycle: f64::midpoint(below, middle),
            slope_low,
            slope_high,
            cycles: self.per_point.saturating_mul(points.len() as u64),
        })
    }

    /// Robust standard deviation of single ratios around the trend line. A point is the mean of several, which scatters less by
    /// the root of their number. What neighbours share, as lots do and a life that bends, is taken for more scatter than there is.
    #[expect(clippy::cast_precision_loss, reason = "counts of cycles are far below 2^53")]
    fn scatter(&self, slope: f64) -> f64 {
        let points = &self.points[self.points.len().saturating_sub(TREND_POINTS)..];
        let heights: Vec<f64> = points.iter().map(|(count, ratio)| ratio - slope * count).collect();
        let centre = median(&heights);
        let deviations: Vec<f64> = heights.iter().map(|height| (height - centre).abs()).collect();
        1.4826 * median(&deviations) * (self.per_point as f64).sqrt()
    }
}

/// The values that stand at ascending ranks once `values` are in order; the others are not put in order for it.
fn of_ranks<const N: usize>(values: &mut [f64], ranks: [usize; N]) -> [f64; N] {
    let mut begin = 0;
    ranks.map(|rank| {
        let (_, value, _) = values[begin..].select_nth_unstable_by(rank - begin, f64::total_cmp);
        let value = *value;
        begin = rank;
        value
    })
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the slice first")]
fn clamp_index(place: f64, len: usize) -> usize {
    (place.max(0.0) as usize).min(len - 1)
}

/// Cycles until the level reaches 1.10; `None` where the trend does not surely rise.
pub(super) fn remaining(points: &TrendPoints, trend: &Trend, (level, n): (f64, usize)) -> Option<Remaining> {
    if trend.slope_low <= 0.0 {
        return None;
    }
    #[expect(clippy::cast_precision_loss, reason = "at most 500 ratios")]
    let n_sqrt = (n.max(1) as f64).sqrt();
    // The level is a median of few ratios: its own error widens the interval of what is left to climb.
    let error = Z_90 * 1.2533 * points.scatter(trend.slope_per_cycle) / n_sqrt;
    let cycles = |climb: f64, slope: f64| {
        let cycles = (climb.max(0.0) / slope).min(MOST_REMAINING);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to ten million")]
        let whole = cycles as u64;
        whole
    };
    let climb = WORN_LEVEL - level;
    if climb / trend.slope_per_cycle > MOST_REMAINING {
        return None;
    }
    Some(Remaining {
        cycles: cycles(climb, trend.slope_per_cycle),
        low: cycles(climb - error, trend.slope_high),
        high: cycles(climb + error, trend.slope_low),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn filled(ratios: impl Iterator<Item = f64>) -> TrendPoints {
        let mut points = TrendPoints::default();
        ratios.for_each(|ratio| points.push(ratio));
        points
    }

    #[test]
    fn a_line_is_found_however_long_it_is() {
        for cycles in [12_u32, 60, 1000, 50_000] {
            let slope = 0.1 / f64::from(cycles);
            let points = filled((0..cycles).map(|k| 1.0 + slope * f64::from(k)));
            assert!(points.points.len() < MAX_POINTS);
            let trend = points.trend().unwrap();
            assert!((trend.slope_per_cycle / slope - 1.0).abs() < 1e-6, "{cycles}: {trend:?}");
        }
    }

    #[test]
    fn what_was_told_is_told_until_a_point_is_complete() {
        let mut points = TrendPoints::default();
        for cycle in 0..1000 {
            points.push(1.0 + 0.0001 * f64::from(cycle) + 0.01 * f64::from(cycle % 7));
            let anew = TrendPoints { told: Told::default(), ..points.clone() };
            assert_eq!(points.trend(), anew.trend(), "after {cycle}");
            assert_eq!(points, anew);
        }
    }

    #[test]
    fn no_trend_before_evidence_and_no_end_without_a_rise() {
        assert_eq!(filled((0..9).map(|k| 1.0 + 0.01 * f64::from(k))).trend(), None);
        let flat = filled((0..200).map(|k| if k % 2 == 0 { 1.01 } else { 0.99 }));
        let trend = flat.trend().unwrap();
        assert_eq!(remaining(&flat, &trend, (1.0, 5)), None);
    }

    #[test]
    fn remaining_cycles_come_with_their_interval() {
        // A saw-tooth of ±0.5 % on a rise of 0.02 % per cycle, at 1.04 after 200 cycles: 300 remain.
        let noisy =
            filled((0..200).map(|k| 1.0 + 0.0002 * f64::from(k) + 0.005 * (f64::from(k % 5) - 2.0) / 2.0));
        let remaining = remaining(&noisy, &noisy.trend().unwrap(), (1.04, 5)).unwrap();
        assert!(remaining.low <= remaining.cycles && remaining.cycles <= remaining.high, "{remaining:?}");
        assert!(remaining.low > 200 && remaining.high < 420, "{remaining:?}");
        assert!((290..=310).contains(&remaining.cycles), "{remaining:?}");
    }

    /// Of a life that wears by `slope` a cycle with normal noise, asked when the line is at `asked`: whether the line is worn
    /// within the interval that was told. `None` where none was told.
    fn is_covered(seed: u64, (slope, noise): (f64, f64), asked: f64) -> Option<bool> {
        let mut state = seed;
        let mut uniform = || {
            // SplitMix64 (Steele, Lea and Flood, 2014).
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut mixed = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            f64::from(((mixed ^ (mixed >> 31)) >> 32) as u32) / f64::from(u32::MAX)
        };
        let mut points = TrendPoints::default();
        let mut last = std::collections::VecDeque::new();
        for cycle in 0_u32.. {
            let normal: f64 = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
            let ratio = (1.0 + slope * f64::from(cycle)) * (1.0 + noise * normal);
            points.push(ratio);
            last.push_back(ratio);
            if last.len() > 5 {
                last.pop_front();
            }
            let level = median(last.make_contiguous());
            if 1.0 + slope * f64::from(cycle) >= asked {
                let told = remaining(&points, &points.trend()?, (level, last.len()))?;
                let line = (WORN_LEVEL - 1.0) / slope - f64::from(cycle);
                return Some((told.low as f64..=told.high as f64 + 1.0).contains(&line.max(0.0)));
            }
        }
        None
    }

    #[test]
    fn the_interval_holds_nine_of_ten_lives_however_long_they_are() {
        for life in [(0.0004, 0.01), (0.0002, 0.005), (0.0001, 0.005)] {
            let told: Vec<bool> = (0..400).filter_map(|seed| is_covered(seed, life, 1.08)).collect();
            let covered = told.iter().filter(|is| **is).count();
            assert!(told.len() > 300, "{life:?}: told of {}", told.len());
            // Told as for single cycles it was 54, 38 and 33 of a hundred.
            assert!(covered * 100 > told.len() * 83, "{life:?}: {covered} of {}", told.len());
            assert!(covered * 100 < told.len() * 97, "{life:?}: {covered} of {}", told.len());
        }
    }

    proptest! {
        #[test]
        fn values_of_ranks_are_those_of_the_whole_in_order(
            values in prop::collection::vec(prop_oneof![any::<f64>(), (-3_i32..3).prop_map(f64::from)], 1..300),
            places in prop::array::uniform4(any::<prop::sample::Index>()),
        ) {
            let mut ranks = places.map(|place| place.index(values.len()));
            ranks.sort_unstable();
            let mut sorted = values.clone();
            sorted.sort_by(f64::total_cmp);
            let found = of_ranks(&mut values.clone(), ranks).map(f64::to_bits);
            prop_assert_eq!(found, ranks.map(|rank| sorted[rank].to_bits()));
        }
    }
}

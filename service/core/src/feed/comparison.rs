//! Two versions by the cycles that ran them: medians with intervals, and whether a difference is one.
//!
//! Cycles scatter and some are odd, so what is compared are medians, and how sure they are is told by the bootstrap
//! (Efron 1979): the cycles are drawn again with replacement and the median taken again. Draws are seeded, so that the
//! same cycles give the same answer to the bit.

use crate::friction::noise::Noise;

/// Fewest cycles of a version that are compared.
pub const FEWEST_CYCLES: usize = 5;
/// Most cycles of a version that are looked at, the newest.
pub const MOST_CYCLES: usize = 1000;
/// Draws of the bootstrap: the ends of a 90 % interval rest on 50 of them.
const DRAWS: usize = 1000;
/// Draws where every draw is a fit of pairs.
const SLOPE_DRAWS: usize = 200;
/// Most cycles of one tool that a wear rate is fitted on: pairs grow with the square.
const MOST_OF_TOOL: usize = 200;
/// Fewest cycles of one tool that tell a wear rate.
const FEWEST_OF_TOOL: usize = 8;
/// Percent of draws below and above the interval.
const TAIL_PERCENT: usize = 5;
/// Levels of wear that differ by no more are the same for a comparison.
const SAME_LEVEL: f64 = 0.005;
/// Least spread of the wear within the versions, as a part of how far they are apart, from which its effect is told.
const LEAST_SPREAD: f64 = 0.25;
/// Usual deviations from the median beyond which a value counts as lying there.
const FAR: f64 = 5.0;
const SEED: u64 = 0x6665_6564_0001;

/// A value with its 90 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// The median.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// One side of a comparison.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Side {
    /// Cycles that told the quantity.
    pub cycles: usize,
    /// Its median; `None` for fewer than [`FEWEST_CYCLES`].
    pub median: Option<Interval>,
}

/// One quantity of two versions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Compared {
    /// The earlier version.
    pub before: Side,
    /// The later version.
    pub after: Side,
    /// Median after over median before, minus 1; `None` where either is missing or the earlier one is 0.
    pub change: Option<Interval>,
    /// Whether the interval of the change leaves out 0.
    pub is_clear: bool,
}

/// Compares one quantity; values that are no number are left out.
#[must_use]
pub fn compare(before: &[f64], after: &[f64]) -> Compared {
    let (before, after) = (finite(before), finite(after));
    let mut noise = Noise::seeded(SEED);
    let (drawn_before, drawn_after) = (draws(&before, &mut noise), draws(&after, &mut noise));
    let change = match (&drawn_before, &drawn_after) {
        (Some((base, left)), Some((value, right))) if *base > 0.0 && left.iter().all(|draw| *draw > 0.0) => {
            let ratios = left.iter().zip(right).map(|(left, right)| right / left - 1.0).collect();
            Some(interval(value / base - 1.0, ratios))
        }
        _ => None,
    };
    let side = |cycles: usize, drawn: Option<(f64, Vec<f64>)>| Side {
        cycles,
        median: drawn.map(|(value, draws)| interval(value, draws)),
    };
    Compared {
        before: side(before.len(), drawn_before),
        after: side(after.len(), drawn_after),
        change,
        is_clear: change.is_some_and(|change| change.low > 0.0 || change.high < 0.0),
    }
}

/// A quantity of one cycle with the level of wear of its tool then.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AtWear {
    /// Level of wear, 1 is the new tool.
    pub level: f64,
    /// The quantity.
    pub value: f64,
}

/// How the medians differ once both versions are told at the same wear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Balanced {
    /// After over before, minus 1.
    pub change: Interval,
    /// Whether the interval leaves out 0.
    pub is_clear: bool,
}

/// Compares one quantity as if both versions had run on tools of the same wear.
///
/// How ln value moves with the level is told within the versions, never between them, by a common line; every value is
/// moved along it to the same level. `None` for fewer than [`FEWEST_CYCLES`], and where the versions' wear differs by more
/// than their own cycles' wear spreads: then version and wear cannot be told apart.
#[must_use]
pub fn compare_at_same_wear(before: &[AtWear], after: &[AtWear]) -> Option<Balanced> {
    let sides = [logs(before), logs(after)];
    if sides.iter().any(|side| side.len() < FEWEST_CYCLES) {
        return None;
    }
    let apart = (mean(&sides[1], |one| one.level) - mean(&sides[0], |one| one.level)).abs();
    if apart > SAME_LEVEL && spread(&sides) < LEAST_SPREAD * apart {
        return None;
    }
    let value = balanced(&sides);
    let mut noise = Noise::seeded(SEED);
    let draws = (0..SLOPE_DRAWS)
        .map(|_| {
            let drawn = sides
                .each_ref()
                .map(|side| (0..side.len()).map(|_| side[pick(&mut noise, side.len())]).collect::<Vec<_>>());
            balanced(&drawn)
        })
        .collect();
    let change = interval(value, draws);
    Some(Balanced { change, is_clear: change.low > 0.0 || change.high < 0.0 })
}

/// ln of the values; far ones are brought to where the others end, so that no odd cycle turns the line.
fn logs(values: &[AtWear]) -> Vec<AtWear> {
    let newest = &values[values.len().saturating_sub(MOST_CYCLES)..];
    let mut logs: Vec<AtWear> = newest
        .iter()
        .filter(|one| one.level.is_finite() && one.value.is_finite() && one.value > 0.0)
        .map(|one| AtWear { value: one.value.ln(), ..*one })
        .collect();
    if logs.is_empty() {
        return logs;
    }
    let middle = median(&mut logs.iter().map(|one| one.value).collect::<Vec<_>>());
    let usual = median(&mut logs.iter().map(|one| (one.value - middle).abs()).collect::<Vec<_>>());
    for one in &mut logs {
        one.value = one.value.clamp(middle - FAR * usual, middle + FAR * usual);
    }
    logs
}

fn mean(side: &[AtWear], of: impl Fn(&AtWear) -> f64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "at most 1000 cycles")]
    let count = side.len().max(1) as f64;
    side.iter().map(of).sum::<f64>() / count
}

/// Sums about the mean of each side: of the level with itself and with the value.
fn within(sides: &[Vec<AtWear>; 2]) -> (f64, f64) {
    let (mut square, mut product) = (0.0, 0.0);
    for side in sides {
        let (level, value) = (mean(side, |one| one.level), mean(side, |one| one.value));
        for one in side {
            square += (one.level - level).powi(2);
            product += (one.level - level) * (one.value - value);
        }
    }
    (square, product)
}

/// Standard deviation of the level within the versions.
fn spread(sides: &[Vec<AtWear>; 2]) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "at most 2000 cycles")]
    let count = (sides[0].len() + sides[1].len()) as f64;
    (within(sides).0 / count).sqrt()
}

fn balanced(sides: &[Vec<AtWear>; 2]) -> f64 {
    let (square, product) = within(sides);
    // Levels that hardly spread tell no line; they are moved nowhere.
    let slope = if square > 1e-9 { product / square } else { 0.0 };
    let moved = |side: &[AtWear]| {
        median(&mut side.iter().map(|one| one.value - slope * (one.level - 1.0)).collect::<Vec<_>>())
    };
    (moved(&sides[1]) - moved(&sides[0])).exp() - 1.0
}

/// How a tool's energy rises with its cycles of one version: per thousand cycles, relative.
///
/// `tools` holds each tool's energies in the order of its cycles. The slope is the median over all pairs of cycles of one
/// tool (Theil 1950, Sen 1968) of the difference of the logarithms over their distance; `None` where no tool has 8.
#[must_use]
pub fn wear_rate(tools: &[Vec<f64>]) -> Option<Interval> {
    let tools: Vec<Vec<f64>> = tools
        .iter()
        .map(|energies| {
            let kept: Vec<f64> =
                energies.iter().copied().filter(|one| one.is_finite() && *one > 0.0).collect();
            kept[kept.len().saturating_sub(MOST_OF_TOOL)..].iter().map(|one| one.ln()).collect()
        })
        .filter(|logs: &Vec<f64>| logs.len() >= FEWEST_OF_TOOL)
        .collect();
    if tools.is_empty() {
        return None;
    }
    let all: Vec<Vec<usize>> = tools.iter().map(|logs| (0..logs.len()).collect()).collect();
    let value = slope(&tools, &all)?;
    let mut noise = Noise::seeded(SEED);
    let draws = (0..SLOPE_DRAWS)
        .filter_map(|_| {
            let chosen: Vec<Vec<usize>> = tools
                .iter()
                .map(|logs| (0..logs.len()).map(|_| pick(&mut noise, logs.len())).collect())
                .collect();
            slope(&tools, &chosen)
        })
        .collect();
    Some(interval(value, draws))
}

fn slope(tools: &[Vec<f64>], chosen: &[Vec<usize>]) -> Option<f64> {
    let mut slopes = Vec::new();
    for (logs, chosen) in tools.iter().zip(chosen) {
        for (at, &one) in chosen.iter().enumerate() {
            for &other in &chosen[at + 1..] {
                if one != other {
                    #[expect(clippy::cast_precision_loss, reason = "at most 200 cycles")]
                    let apart = other as f64 - one as f64;
                    slopes.push((logs[other] - logs[one]) / apart * 1000.0);
                }
            }
        }
    }
    (!slopes.is_empty()).then(|| median(&mut slopes))
}

fn finite(values: &[f64]) -> Vec<f64> {
    let newest = &values[values.len().saturating_sub(MOST_CYCLES)..];
    newest.iter().copied().filter(|value| value.is_finite()).collect()
}

fn pick(noise: &mut Noise, count: usize) -> usize {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "an index below the count"
    )]
    let at = (noise.uniform() * count as f64) as usize;
    at.min(count - 1)
}

/// The median, and the medians of values drawn again.
fn draws(values: &[f64], noise: &mut Noise) -> Option<(f64, Vec<f64>)> {
    if values.len() < FEWEST_CYCLES {
        return None;
    }
    let mut drawn = vec![0.0; values.len()];
    let medians = (0..DRAWS)
        .map(|_| {
            drawn.iter_mut().for_each(|slot| *slot = values[pick(noise, values.len())]);
            median(&mut drawn)
        })
        .collect();
    Some((median(&mut values.to_vec()), medians))
}

fn interval(value: f64, mut draws: Vec<f64>) -> Interval {
    draws.sort_by(f64::total_cmp);
    let Some(last) = draws.len().checked_sub(1) else {
        return Interval { value, low: value, high: value };
    };
    let at = |percent: usize| draws[last * percent / 100];
    // The value itself always lies in its interval.
    Interval { value, low: at(TAIL_PERCENT).min(value), high: at(100 - TAIL_PERCENT).max(value) }
}

fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    let (below, upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let upper = *upper;
    if below.len() == middle && values.len().is_multiple_of(2) {
        let lower = values[..middle].iter().copied().fold(f64::NEG_INFINITY, f64::max);
        return f64::midpoint(lower, upper);
    }
    upper
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noisy(count: usize, mean: f64, sd: f64, seed: u64) -> Vec<f64> {
        let mut noise = Noise::seeded(seed);
        (0..count).map(|_| mean + sd * noise.normal()).collect()
    }

    #[test]
    fn a_real_difference_is_clear_and_chance_is_not() {
        let found = compare(&noisy(80, 4.0, 0.1, 1), &noisy(80, 3.6, 0.1, 2));
        let change = found.change.unwrap();
        assert!(
            found.is_clear && (change.value + 0.1).abs() < 0.02 && change.low < -0.1 && change.high > -0.12,
            "{found:?}"
        );
        let mut clear = 0;
        for seed in 0..100 {
            clear +=
                u32::from(compare(&noisy(40, 4.0, 0.1, seed), &noisy(40, 4.0, 0.1, seed + 1000)).is_clear);
        }
        assert!(clear <= 20, "{clear} of 100 where there is none, at a 90 % interval");
    }

    #[test]
    fn odd_cycles_and_nonsense_do_not_move_it_and_the_same_cycles_give_the_same_bits() {
        let mut before = noisy(50, 4.0, 0.1, 1);
        let after = noisy(50, 4.0, 0.1, 3);
        let clean = compare(&before, &after);
        before.extend([400.0, 0.01, f64::NAN, f64::INFINITY]);
        let dirty = compare(&before, &after);
        assert!((clean.before.median.unwrap().value - dirty.before.median.unwrap().value).abs() < 0.02);
        assert_eq!(dirty.before.cycles, 52);
        assert_eq!(dirty, compare(&before, &after));
    }

    /// Cycles whose value is `base`, times 1 + `rise` per unit of wear, on levels from `from` to `to`.
    fn wearing(base: f64, rise: f64, (from, to): (f64, f64), count: u32, seed: u64) -> Vec<AtWear> {
        let mut noise = Noise::seeded(seed);
        (0..count)
            .map(|at| {
                let level = from + (to - from) * f64::from(at) / f64::from(count);
                AtWear { level, value: base * (1.0 + rise * (level - 1.0) + 0.01 * noise.normal()) }
            })
            .collect()
    }

    #[test]
    fn what_wear_did_is_not_laid_to_the_version() {
        // The later version ran on the worn half of the tool and is 3 % better at the same wear.
        let before = wearing(100.0, 1.0, (1.0, 1.05), 60, 1);
        let after = wearing(97.0, 1.0, (1.04, 1.1), 60, 2);
        let values = |side: &[AtWear]| side.iter().map(|one| one.value).collect::<Vec<_>>();
        let raw = compare(&values(&before), &values(&after)).change.unwrap();
        assert!(raw.value > 0.0, "wear hides it: {raw:?}");
        let found = compare_at_same_wear(&before, &after).unwrap();
        assert!(found.is_clear && (found.change.value + 0.03).abs() < 0.01, "{found:?}");
        assert!(found.change.low < -0.025 && found.change.high > -0.035, "{found:?}");
        let mut odd = after.clone();
        odd.extend([AtWear { level: 1.09, value: 1e6 }, AtWear { level: f64::NAN, value: 1.0 }]);
        let with_odd = compare_at_same_wear(&before, &odd).unwrap();
        assert!((with_odd.change.value - found.change.value).abs() < 0.01, "{with_odd:?}");
    }

    #[test]
    fn wear_and_version_that_cannot_be_told_apart_are_not_told_apart() {
        let new = wearing(100.0, 2.0, (1.0, 1.002), 40, 1);
        let worn = wearing(95.0, 2.0, (1.08, 1.082), 40, 2);
        assert_eq!(compare_at_same_wear(&new, &worn), None);
        assert_eq!(compare_at_same_wear(&new[..4], &worn), None);
        let same = wearing(90.0, 2.0, (1.0, 1.002), 40, 3);
        let found = compare_at_same_wear(&new, &same).unwrap();
        assert!((found.change.value + 0.1).abs() < 0.02, "{found:?}");
    }

    #[test]
    fn too_few_cycles_say_nothing() {
        let found = compare(&[1.0; 4], &[1.0; 40]);
        assert_eq!((found.before.median, found.change, found.is_clear), (None, None, false));
        assert_eq!(compare(&[0.0; 9], &[1.0; 9]).change, None);
        assert_eq!(compare(&[], &[]).after.cycles, 0);
        assert_eq!(wear_rate(&[vec![1.0; 7]]), None);
    }

    #[test]
    fn a_wear_rate_is_found_among_noise_and_tools() {
        let mut noise = Noise::seeded(9);
        let tools: Vec<Vec<f64>> = [1900.0, 2100.0]
            .iter()
            .map(|new| {
                (0..150)
                    .map(|k| new * (1.0 + 0.1 * f64::from(k) / 1000.0) * (1.0 + 0.005 * noise.normal()))
                    .collect()
            })
            .collect();
        let rate = wear_rate(&tools).unwrap();
        assert!(rate.low < 0.1 && rate.high > 0.09 && (rate.value - 0.1).abs() < 0.03, "{rate:?}");
    }

    #[test]
    fn the_median_of_even_and_odd_counts() {
        assert!((median(&mut [3.0, 1.0, 2.0]) - 2.0).abs() < 1e-12);
        assert!((median(&mut [4.0, 1.0, 3.0, 2.0]) - 2.5).abs() < 1e-12);
    }
}

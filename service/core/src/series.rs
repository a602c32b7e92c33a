//! What many cycles amount to over time: buckets of equal width, and how the values of one are spread.

use crate::units::Timestamp;

/// 1970-01-05T00:00:00Z, a Monday: buckets of weeks begin on Mondays, those of days and less at midnight UTC.
const MONDAY_US: i64 = 4 * 86_400_000_000;

/// Buckets of equal width over a range of time, aligned to UTC so that two questions have the same buckets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Buckets {
    first_us: i64,
    width_us: i64,
    count: usize,
}

impl Buckets {
    /// The buckets that cover `from` (inclusive) to `to` (exclusive); `None` where the range is empty or reversed, the
    /// width is none, or they cannot be counted.
    pub fn new(from: Timestamp, to: Timestamp, width_us: i64) -> Option<Self> {
        if width_us <= 0 || from >= to {
            return None;
        }
        let offset = from.micros().checked_sub(MONDAY_US)?;
        let first_us = offset.div_euclid(width_us).checked_mul(width_us)?.checked_add(MONDAY_US)?;
        let span = i128::from(to.micros()) - i128::from(first_us);
        let count = (span + i128::from(width_us) - 1) / i128::from(width_us);
        Some(Self { first_us, width_us, count: usize::try_from(count).ok()? })
    }

    /// How many there are, at least 1.
    pub const fn count(&self) -> usize {
        self.count
    }

    /// When a bucket begins.
    #[expect(clippy::cast_possible_wrap, reason = "below `count`, whose product with the width fits")]
    pub const fn begin(&self, index: usize) -> Timestamp {
        Timestamp::from_micros(self.first_us.saturating_add(self.width_us.saturating_mul(index as i64)))
    }

    /// The bucket that a time falls into.
    pub fn of(&self, at: Timestamp) -> Option<usize> {
        let since = at.micros().checked_sub(self.first_us)?;
        let index = usize::try_from(since.div_euclid(self.width_us)).ok()?;
        (index < self.count).then_some(index)
    }
}

/// How values are spread.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// How many there are, at least 1.
    pub count: usize,
    /// Arithmetic mean.
    pub mean: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
}

impl Spread {
    /// The spread of finite values in the order in which they were measured; sorts them. `None` of none.
    #[expect(clippy::cast_precision_loss, reason = "numbers of cycles are far below 2^53")]
    pub fn of(values: &mut [f64]) -> Option<Self> {
        let count = values.len();
        // Added up before sorting: the same cycles give the same bits whatever their values.
        let mean = values.iter().sum::<f64>() / count as f64;
        values.sort_unstable_by(f64::total_cmp);
        let (min, max) = (*values.first()?, *values.last()?);
        Some(Self { count, mean, min, max, p50: quantile(values, 0.5), p95: quantile(values, 0.95) })
    }
}

/// Quantile of sorted values by linear interpolation (Hyndman & Fan 1996, definition 7), as numpy and pandas have it.
#[expect(clippy::cast_precision_loss, reason = "numbers of cycles are far below 2^53")]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the slice, not negative")]
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = share * (sorted.len() - 1) as f64;
    let (below, part) = (place.floor() as usize, place.fract());
    let above = (below + 1).min(sorted.len() - 1);
    let (below, above) = (sorted[below], sorted[above]);
    let between = above - below;
    // From the nearer of both, as numpy has it to the bit.
    if part < 0.5 { below + between * part } else { above - between * (1.0 - part) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HOUR: i64 = 3_600_000_000;

    #[test]
    fn the_figures_are_those_of_numpy() {
        // numpy.percentile([3, 1, 4, 1, 5, 9, 2, 6], [50, 95]) = [3.5, 7.95]
        let spread = Spread::of(&mut [3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 6.0]).unwrap();
        assert_eq!((spread.count, spread.mean, spread.min, spread.max), (8, 3.875, 1.0, 9.0));
        assert!((spread.p50 - 3.5).abs() < 1e-12 && (spread.p95 - 7.95).abs() < 1e-12, "{spread:?}");
        // From the lower value it would be 1928.7199999999998.
        let spread = Spread::of(&mut [1090.3, 1950.6, 1150.0, 1739.4, 1841.2]).unwrap();
        assert_eq!([spread.p50, spread.p95].map(f64::to_bits), [1739.4, 1928.72].map(f64::to_bits));
        assert_eq!(Spread::of(&mut []), None);
        let one = Spread::of(&mut [7.0]).unwrap();
        assert_eq!((one.min, one.max, one.p50, one.p95), (7.0, 7.0, 7.0, 7.0));
    }

    #[test]
    fn buckets_are_aligned_to_utc_and_weeks_to_mondays() {
        let at = |us| Timestamp::from_micros(us);
        // 2026-05-04 is a Monday.
        let monday = 1_777_852_800_000_000;
        let day = Buckets::new(at(monday + HOUR), at(monday + 25 * HOUR), 24 * HOUR).unwrap();
        assert_eq!((day.count(), day.begin(0), day.begin(1)), (2, at(monday), at(monday + 24 * HOUR)));
        let week = Buckets::new(at(monday + 30 * HOUR), at(monday + 31 * HOUR), 7 * 24 * HOUR).unwrap();
        assert_eq!((week.count(), week.begin(0)), (1, at(monday)));
        assert_eq!(day.of(at(monday - 1)), None);
        assert_eq!(day.of(at(monday + 48 * HOUR)), None);
        assert_eq!(Buckets::new(at(5), at(5), HOUR), None);
        assert_eq!(Buckets::new(at(5), at(6), 0), None);
        assert_eq!(Buckets::new(at(i64::MIN), at(i64::MAX), 1), None);
    }

    proptest! {
        #[test]
        fn every_time_of_the_range_has_the_bucket_that_holds_it(
            from in -4_000_000_000_000_000_i64..4_000_000_000_000_000,
            span in 1_i64..1_000_000_000_000,
            width in 1_000_000_000_i64..1_000_000_000_000,
            permille in 0_i64..1000,
        ) {
            let buckets = Buckets::new(Timestamp::from_micros(from), Timestamp::from_micros(from + span), width).unwrap();
            let at = Timestamp::from_micros(from + span * permille / 1000);
            let index = buckets.of(at).unwrap();
            prop_assert!(buckets.begin(index) <= at && at.micros() < buckets.begin(index).micros() + width);
        }
    }
}

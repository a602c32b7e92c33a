//! The canonical form of a column.

use super::frame::damaged;
use crate::error::StoreResult;
use feedwright_core::cycle::{Channel, Samples, TimeBase};

/// Largest scale: 10^9 and every integer below 2^53 are exact as `f64`.
pub(super) const MAX_SCALE: u8 = 9;

const POWERS: [f64; 10] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9];
const EXACT_LIMIT: f64 = 9_007_199_254_740_992.0;

/// A column in its canonical form.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Column {
    /// Integers `m` of `m / 10^scale`.
    Decimal {
        /// The scale, 0..=9.
        scale: u8,
        /// The integers.
        values: Vec<i64>,
    },
    /// Bits of the values.
    Exact(Vec<u64>),
}

impl Column {
    /// The canonical form of values, of which some may be known.
    pub(super) fn of(values: &[f64], places: Option<u8>) -> Self {
        let known = places.and_then(|places| Self::of_decimals(values, places));
        debug_assert!(
            known.as_ref().is_none_or(|known| *known == Self::found(values)),
            "{places:?}: {values:?}"
        );
        known.unwrap_or_else(|| Self::found(values))
    }

    /// That of values which each are the nearest there is to a decimal of so many places, and none −0: nothing has to be looked
    /// for or held against it. `None` where they are larger than that, or fewer places may do.
    ///
    /// Integers below 2^49 have 15 digits at the most, and decimals of so many digits are as many values: one that needs all
    /// places does not fit a smaller scale.
    fn of_decimals(values: &[f64], places: u8) -> Option<Self> {
        let power = *POWERS.get(usize::from(places))?;
        let mut beyond = 0;
        let integers: Vec<i64> = values
            .iter()
            .map(|&value| {
                let integer = (value * power + ROUNDER).to_bits().wrapping_sub(ROUNDER.to_bits());
                beyond |= beyond_limit(integer);
                integer.cast_signed()
            })
            .collect();
        let is_smallest = places == 0 || integers.iter().any(|integer| integer % 10 != 0);
        (beyond == 0 && is_smallest).then_some(Self::Decimal { scale: places, values: integers })
    }

    /// The canonical form of values of which nothing is known.
    fn found(values: &[f64]) -> Self {
        let mut integers = Vec::with_capacity(values.len());
        let mut scale = values.first().map_or(0, |&first| next_scale(first, 0));
        // Each scale passed over was refused by a value, so the one found is the smallest.
        'scale: while scale <= MAX_SCALE {
            integers.clear();
            for values in values.chunks(AT_ONCE) {
                if extend_at_once(&mut integers, values, scale) {
                    continue;
                }
                for &value in values {
                    match integer(value, scale) {
                        Some(integer) => integers.push(integer),
                        None => {
                            scale = next_scale(value, scale + 1);
                            continue 'scale;
                        }
                    }
                }
            }
            return Self::Decimal { scale, values: integers };
        }
        Self::Exact(values.iter().map(|value| value.to_bits()).collect())
    }

    /// The integers, with their scale, where it is a column of decimals.
    pub(super) fn decimals(&self) -> Option<(&[i64], u8)> {
        match self {
            Self::Decimal { scale, values } => Some((values, *scale)),
            Self::Exact(_) => None,
        }
    }

    /// The values.
    pub fn into_values(self) -> Vec<f64> {
        match self {
            Self::Decimal { scale, values } => {
                let mut decimals = Vec::with_capacity(values.len());
                extend_decimals(&mut decimals, &values, scale);
                decimals
            }
            Self::Exact(bits) => bits.into_iter().map(f64::from_bits).collect(),
        }
    }
}

/// Values that are tried together.
const AT_ONCE: usize = 64;
/// 1.5 × 2^52: what is added to it is rounded to an integer, which then stands in its low bits.
const ROUNDER: f64 = 6_755_399_441_055_744.0;
/// 2^49. Below, the product of a decimal with its power of ten is within 1/8 of its integer, so that ties,
/// which [`ROUNDER`] rounds otherwise than [`integer`], belong to no decimal.
const ROUNDED_LIMIT: u64 = 1 << 49;

/// Not 0 where an integer is not below [`ROUNDED_LIMIT`], above or below zero.
#[inline(always)]
const fn beyond_limit(integer: u64) -> u64 {
    integer.wrapping_add(ROUNDED_LIMIT) & !(2 * ROUNDED_LIMIT - 1)
}

/// Appends the integers of `values`, where all of them are decimals of that scale and below [`ROUNDED_LIMIT`]; else
/// nothing. The same integers as those of [`integer`], without a branch per value.
fn extend_at_once(integers: &mut Vec<i64>, values: &[f64], scale: u8) -> bool {
    // Integers need no division, which takes the most time of it.
    if scale == 0 {
        extend_where_same(integers, values, |value| value, |integer| integer)
    } else {
        let power = POWERS[usize::from(scale)];
        extend_where_same(integers, values, |value| value * power, |integer| integer / power)
    }
}

/// As [`extend_at_once`], with what makes integers of values, but for their fraction, and values of integers.
fn extend_where_same(
    integers: &mut Vec<i64>,
    values: &[f64],
    scaled: impl Fn(f64) -> f64,
    value_of: impl Fn(f64) -> f64,
) -> bool {
    let begin = integers.len();
    // Bits in which any value is another one, or beyond the limit: two ors, where a comparison each would not be made for
    // two values at once.
    let (mut different, mut beyond) = (0, 0);
    integers.extend(values.iter().map(|&value| {
        let shifted = scaled(value) + ROUNDER;
        let integer = shifted.to_bits().wrapping_sub(ROUNDER.to_bits());
        different |= value_of(shifted - ROUNDER).to_bits() ^ value.to_bits();
        beyond |= beyond_limit(integer);
        integer.cast_signed()
    }));
    let all = different | beyond == 0;
    if !all {
        integers.truncate(begin);
    }
    all
}

/// The first scale from `scale` on that `value` fits; beyond [`MAX_SCALE`] where none does.
fn next_scale(value: f64, scale: u8) -> u8 {
    (scale..=MAX_SCALE).find(|&scale| integer(value, scale).is_some()).unwrap_or(MAX_SCALE + 1)
}

#[expect(clippy::cast_precision_loss, reason = "integers of the canonical form are below 2^53")]
pub(super) fn decimal(integer: i64, scale: u8) -> f64 {
    integer as f64 / POWERS[usize::from(scale)]
}

/// Appends the decimals of that scale that integers stand for: the same as [`decimal`] of each, several at once.
pub(crate) fn extend_decimals(decimals: &mut Vec<f64>, integers: &[i64], scale: u8) {
    // Small enough to be added to the bits of ROUNDER: a conversion by itself is made for one at a time.
    const SMALL: i64 = 1 << 51;
    let small =
        |integer: i64| f64::from_bits(ROUNDER.to_bits().wrapping_add(integer.cast_unsigned())) - ROUNDER;
    for integers in integers.chunks(AT_ONCE) {
        let beyond = |integer: &i64| integer.wrapping_add(SMALL) & !(2 * SMALL - 1);
        if integers.iter().fold(0, |all, integer| all | beyond(integer)) != 0 {
            decimals.extend(integers.iter().map(|integer| decimal(*integer, scale)));
        } else if scale == 0 {
            decimals.extend(integers.iter().map(|integer| small(*integer)));
        } else {
            let power = POWERS[usize::from(scale)];
            decimals.extend(integers.iter().map(|integer| small(*integer) / power));
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "integral and below 2^53")]
fn integer(value: f64, scale: u8) -> Option<i64> {
    let rounded = (value * POWERS[usize::from(scale)]).round();
    if rounded.abs() >= EXACT_LIMIT || rounded.is_nan() {
        return None;
    }
    let integer = rounded as i64;
    (decimal(integer, scale).to_bits() == value.to_bits()).then_some(integer)
}

/// How many places the decimals of a cycle's columns were written with, as far as that is known: so much need not be found out
/// of their values.
///
/// Whoever notes places says that each value of the column is the nearest there is to a decimal of so many places. If it were
/// not, another value would be stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Places {
    times: Option<u8>,
    /// By the channels' codes, from 1 on.
    channels: [Option<u8>; Channel::ALL.len()],
}

impl Places {
    /// Notes those of a channel, or of the times.
    pub fn note(&mut self, of: Option<Channel>, places: u8) {
        match of {
            None => self.times = Some(places),
            Some(channel) => {
                if let Some(known) = self.channels.get_mut(place_of(channel)) {
                    *known = Some(places);
                }
            }
        }
    }

    fn of(&self, channel: Channel) -> Option<u8> {
        self.channels.get(place_of(channel)).copied().flatten()
    }
}

const fn place_of(channel: Channel) -> usize {
    channel as usize - 1
}

/// All columns of a cycle: made once for hash and blocks, and what a block is read to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Columns {
    /// Samples in each column, at least 1.
    pub len: usize,
    /// The time base.
    pub time: Time,
    /// The channels in ascending code.
    pub channels: Vec<(Channel, Column)>,
}

/// The time base in canonical form.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Time {
    /// Bits of the period in ms.
    Period(u64),
    /// Times in ms.
    Stamps(Column),
}

impl Columns {
    /// The same as samples.
    ///
    /// # Errors
    ///
    /// Where a value is none that its channel can have.
    pub fn into_samples(self) -> StoreResult<Samples> {
        let time = match self.time {
            Time::Period(bits) => TimeBase::Period { period_ms: f64::from_bits(bits) },
            Time::Stamps(times) => TimeBase::Stamps { time_ms: times.into_values() },
        };
        let columns =
            self.channels.into_iter().map(|(channel, column)| (channel, column.into_values())).collect();
        Samples::new(time, columns, self.len).map_err(|_| damaged("values out of range"))
    }

    /// The canonical form of samples.
    pub fn of(samples: &Samples) -> Self {
        Self::with(samples, Places::default())
    }

    /// The same, where it is known how their decimals were written.
    pub(super) fn with(samples: &Samples, places: Places) -> Self {
        let time = match samples.time() {
            TimeBase::Period { period_ms } => Time::Period(period_ms.to_bits()),
            TimeBase::Stamps { time_ms } => Time::Stamps(Column::of(time_ms, places.times)),
        };
        let column = |(channel, values)| (channel, Column::of(values, places.of(channel)));
        let channels = samples.columns().map(column).collect();
        Self { len: samples.len(), time, channels }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_smallest_scale_is_taken() {
        let scale = |values: &[f64]| match Column::found(values) {
            Column::Decimal { scale, .. } => Some(scale),
            Column::Exact(_) => None,
        };
        assert_eq!(scale(&[0.0, 1.0, -7.0]), Some(0));
        assert_eq!(scale(&[0.0, 0.1, 12.25]), Some(2));
        assert_eq!(scale(&[1e-9]), Some(9));
        assert_eq!(scale(&[1e-10]), None);
        assert_eq!(scale(&[1.0 / 3.0]), None);
        assert_eq!(scale(&[-0.0]), None, "the sign of zero is content");
        assert_eq!(scale(&[9_007_199_254_740_992.0]), None);
        assert_eq!(scale(&[9_007_199_254_740_991.0]), Some(0));
        // Large and fine at once: no common scale holds both.
        assert_eq!(scale(&[9_007_199_254_740_991.0, 0.001]), None);
    }

    proptest! {
        #[test]
        fn many_decimals_are_those_one_by_one(
            integers in prop::collection::vec(
                prop_oneof![4 => -1000_i64..1000, 4 => -(1_i64 << 51)..1 << 51, 1 => any::<i64>(), 1 => Just(-(1 << 51))],
                0..200,
            ),
            scale in 0..=MAX_SCALE,
        ) {
            let mut decimals = vec![7.0];
            extend_decimals(&mut decimals, &integers, scale);
            let one_by_one = integers.iter().map(|integer| decimal(*integer, scale).to_bits());
            prop_assert!(decimals[1..].iter().map(|value| value.to_bits()).eq(one_by_one));
        }

        #[test]
        fn many_at_once_are_the_same_as_one_by_one(
            values in prop::collection::vec(
                prop_oneof![
                    any::<f64>(),
                    (-(1_i64 << 53)..(1_i64 << 53), 0_u8..=9).prop_map(|(m, scale)| decimal(m, scale)),
                    (-(1_i64 << 40)..(1_i64 << 40), 0_u8..=9).prop_map(|(m, scale)| decimal(m, scale)),
                    (-1_000_i64..1_000).prop_map(|m| decimal(m, 0) + 0.5),
                    Just(-0.0),
                ],
                1..4,
            ),
            scale in 0_u8..=9,
        ) {
            let mut integers = Vec::new();
            if extend_at_once(&mut integers, &values, scale) {
                let one_by_one: Option<Vec<i64>> = values.iter().map(|&value| integer(value, scale)).collect();
                prop_assert_eq!(Some(integers), one_by_one);
            } else {
                prop_assert!(integers.is_empty());
                let fits = |value: &f64| integer(*value, scale).is_some_and(|_| {
                    (value * POWERS[usize::from(scale)]).abs() < ROUNDED_LIMIT as f64
                });
                prop_assert!(!values.iter().all(fits));
            }
        }

        #[test]
        fn what_is_known_of_a_column_changes_nothing(
            integers in prop_oneof![
                prop::collection::vec(-1_000_i64..1_000, 0..100),
                prop::collection::vec((-1_000_i64..1_000).prop_map(|m| m * 100), 0..20),
                prop::collection::vec(-(1_i64 << 53) + 1..1 << 53, 1..20),
                prop::collection::vec(-(1_i64 << 49)..=1 << 49, 1..20),
            ],
            places in 0_u8..=12,
        ) {
            let power = 10_f64.powi(places.into());
            #[expect(clippy::cast_precision_loss, reason = "below 2^53")]
            let values: Vec<f64> = integers.iter().map(|&m| m as f64 / power).collect();
            prop_assert_eq!(Column::of(&values, Some(places)), Column::found(&values));
        }

        #[test]
        fn every_column_comes_back_to_the_bit(values in prop::collection::vec(any::<f64>(), 1..50)) {
            let back = Column::found(&values).into_values();
            prop_assert!(values.iter().zip(&back).all(|(a, b)| a.to_bits() == b.to_bits()));
        }

        #[test]
        fn decimals_are_found(integers in prop::collection::vec(-10_000_000_i64..10_000_000, 1..50), scale in 0_u8..=9) {
            let values: Vec<f64> = integers.iter().map(|&integer| decimal(integer, scale)).collect();
            match Column::found(&values) {
                Column::Decimal { scale: found, .. } => prop_assert!(found <= scale),
                Column::Exact(_) => prop_assert!(false, "decimals must be found"),
            }
        }
    }
}

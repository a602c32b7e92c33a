//! What the next integer of a column is taken to be: what is stored is how far it is off.

use std::ops::Range;

/// Values that a predictor is chosen by, or a few more.
const TRIED: usize = 64;
/// So many of them follow each other: what a fit is made of is summed up once for all of them.
const TOGETHER: usize = 8;
/// Values that the longest fit is made of.
const LONGEST: usize = Predictor::Fit16.reach();

/// Ways to predict, by the code that a block names them with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Predictor {
    /// The value before.
    Last = 0,
    /// The line through the two values before: a feed that is integrated, a ramp.
    Line = 1,
    /// The mean of the two values before: noise around a slow signal.
    Mean = 2,
    /// The line through the means of the last two and the two before them: noise around a ramp.
    MeanLine = 3,
    /// The line of least squares through the last eight: noise around what bends.
    Fit8 = 4,
    /// The line of least squares through the last sixteen: noise around what hardly bends.
    Fit16 = 5,
}

/// The line of least squares through the `N` values before, `SUM / OVER` and `WEIGHTED / OVER` being what it makes of
/// their sums: of the `j`th newest value it takes (4N + 2 − 6j) / (N(N − 1)).
#[derive(Debug, Clone, Copy)]
struct Fit<const N: usize, const SUM: i64, const WEIGHTED: i64, const OVER: i64> {
    sum: i64,
    /// 2n + 1 for the n that [`Fit::next`] divides by `OVER`. Followed itself, so that a value waits for as little as can
    /// be of what the one before makes.
    doubled: i64,
}

type Fit8 = Fit<8, 17, 3, 28>;
type Fit16 = Fit<16, 11, 1, 40>;

/// Sum of values and sum of each times its place, the newest, which is the last, being the first.
fn sums(values: &[i64]) -> (i64, i64) {
    // Each value is in as many of the sums so far as its place says.
    values.iter().fold((0, 0), |(sum, weighted): (i64, i64), value| {
        let sum = sum.wrapping_add(*value);
        (sum, weighted.wrapping_add(sum))
    })
}

// Sums of so few values below 2^53 do not overflow; those of a damaged block may wrap.
impl<const N: usize, const SUM: i64, const WEIGHTED: i64, const OVER: i64> Fit<N, SUM, WEIGHTED, OVER> {
    /// Bits of the fraction that [`Self::INVERSE`] is.
    const FRACTION: u32 = 68;
    /// 1 / (2 OVER), rounded.
    #[expect(clippy::cast_possible_truncation, reason = "below 2^63, OVER being more than 16")]
    const INVERSE: i64 = (((1 << Self::FRACTION) + OVER as i128) / (2 * OVER as i128)) as i64;
    #[expect(clippy::cast_possible_wrap, reason = "N is 8 or 16")]
    const BEYOND: i64 = N as i64 + 1;

    /// Through values of which these are the [`sums`].
    const fn of((sum, weighted): (i64, i64)) -> Self {
        let over = sum.wrapping_mul(SUM).wrapping_sub(weighted.wrapping_mul(WEIGHTED));
        Self { sum, doubled: over.wrapping_mul(2).wrapping_add(OVER + 1) }
    }

    /// What comes next, to the nearest integer: n / OVER rounded down, with n = sum · SUM − weighted · WEIGHTED + OVER / 2.
    ///
    /// (2n + 1) / (2 OVER) lies between the same integers, and at least 1 / (2 OVER) off either, which is more than the
    /// inverse is off: at most 2^62 / 2^69. So this needs no division, and no case for what is below 0.
    const fn next(self) -> i64 {
        ((self.doubled as i128 * Self::INVERSE as i128) >> Self::FRACTION) as i64
    }

    /// With one more value, without the oldest.
    const fn follow(&mut self, newest: i64, oldest: i64) {
        // weighted becomes weighted + sum + newest − (N + 1) · oldest, and sum becomes sum + newest − oldest.
        let known =
            oldest.wrapping_mul(WEIGHTED * Self::BEYOND - SUM).wrapping_sub(self.sum.wrapping_mul(WEIGHTED));
        let more = newest.wrapping_mul(2 * (SUM - WEIGHTED));
        self.doubled = self.doubled.wrapping_add(known.wrapping_mul(2)).wrapping_add(more);
        self.sum = self.sum.wrapping_sub(oldest).wrapping_add(newest);
    }

    fn residuals(values: &[i64], out: &mut Vec<i64>) {
        let Some(first) = values.get(..N) else { return };
        let mut fit = Self::of(sums(first));
        out.extend(values[N..].iter().zip(values).map(|(&value, &oldest)| {
            let residual = value - fit.next();
            fit.follow(value, oldest);
            residual
        }));
    }

    fn restore(values: &mut [i64]) {
        let Some(first) = values.get(..N) else { return };
        let mut fit = Self::of(sums(first));
        for at in N..values.len() {
            let value = fit.next().wrapping_add(values[at]);
            fit.follow(value, values[at - N]);
            values[at] = value;
        }
    }
}

/// Reads residuals.
pub(super) trait Residuals {
    /// The next residual; `None` where there is none.
    fn next(&mut self) -> Option<i64>;

    /// The next residuals; `None` where there are fewer.
    fn read(&mut self, residuals: &mut [i64]) -> Option<()> {
        for residual in residuals {
            *residual = self.next()?;
        }
        Some(())
    }
}

impl Predictor {
    const ALL: [Self; 6] = [Self::Last, Self::Line, Self::Mean, Self::MeanLine, Self::Fit8, Self::Fit16];
    /// Those that block format v2 knows, and that are told from a few values before.
    const SHORT: usize = 4;

    pub(super) fn from_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code)).copied()
    }

    pub(super) const fn is_fit(self) -> bool {
        matches!(self, Self::Fit8 | Self::Fit16)
    }

    /// Values that have to come before; until then it is the last one.
    const fn reach(self) -> usize {
        match self {
            Self::Last => 1,
            Self::Line | Self::Mean => 2,
            Self::MeanLine => 4,
            Self::Fit8 => 8,
            Self::Fit16 => 16,
        }
    }

    /// From the values before, the newest first; fits look further back and begin as the last one. Values of a decimal
    /// column are below 2^53, so nothing overflows; those of a damaged block may wrap.
    const fn next(self, [a, b, c, d]: [i64; 4]) -> i64 {
        match self {
            Self::Last | Self::Fit8 | Self::Fit16 => a,
            Self::Line => a.wrapping_mul(2).wrapping_sub(b),
            Self::Mean => a.wrapping_add(b) >> 1,
            Self::MeanLine => a.wrapping_add(b).wrapping_mul(3).wrapping_sub(c.wrapping_add(d)) >> 2,
        }
    }

    /// How far each value after the first is off.
    pub(super) fn residuals(self, values: &[i64], out: &mut Vec<i64>) {
        out.clear();
        out.reserve(values.len());
        let reach = self.reach().min(values.len());
        for pair in values[..reach].windows(2) {
            out.push(pair[1] - pair[0]);
        }
        match self {
            Self::Last => {
                out.extend(values.windows(2).map(|w| w[1] - w[0]));
            }
            Self::Line | Self::Mean => {
                out.extend(values.windows(3).map(|w| w[2] - self.next([w[1], w[0], 0, 0])));
            }
            Self::MeanLine => {
                out.extend(values.windows(5).map(|w| w[4] - self.next([w[3], w[2], w[1], w[0]])));
            }
            Self::Fit8 => Fit8::residuals(values, out),
            Self::Fit16 => Fit16::residuals(values, out),
        }
    }

    /// Puts values back together behind the first; `None` where a residual is missing.
    ///
    /// All residuals are read before, into their places: what reading goes by and what predicting goes by have the registers in
    /// turn.
    pub(super) fn restore<R: Residuals>(self, values: &mut [i64], mut reader: R) -> Option<R> {
        let Some((_, residuals)) = values.split_first_mut() else { return Some(reader) };
        reader.read(residuals)?;
        let reach = self.reach().min(values.len());
        add(&mut values[..reach], 1, |before| Self::Last.next(before));
        // A loop for each, so that none asks at every value which it is.
        match self {
            Self::Last => add(values, reach, |before| Self::Last.next(before)),
            Self::Line => add(values, reach, |before| Self::Line.next(before)),
            Self::Mean => add(values, reach, |before| Self::Mean.next(before)),
            Self::MeanLine => add(values, reach, |before| Self::MeanLine.next(before)),
            Self::Fit8 => Fit8::restore(values),
            Self::Fit16 => Fit16::restore(values),
        }
        Some(reader)
    }

    /// The predictor whose residuals are the smallest at [`tried`] places, with the sum of their sizes; of several the first.
    pub(super) fn best(values: &[i64], tried: impl Iterator<Item = Range<usize>>) -> (Self, u64) {
        let mut costs = [0_u64; Self::ALL.len()];
        for places in tried {
            let before =
                |reach| places.start.checked_sub(reach).and_then(|from| values.get(from..places.end));
            if let Some(stretch) = before(LONGEST).and_then(<[_]>::first_chunk) {
                Self::judge_stretch(stretch, &mut costs);
            } else if let Some(w) = before(4).and_then(<[_]>::first_chunk::<5>) {
                Self::judge([w[3], w[2], w[1], w[0]], w[4], &mut costs);
                costs[Self::SHORT..].fill(u64::MAX);
            }
        }
        let cheapest = (0..costs.len()).min_by_key(|&at| costs[at]).unwrap_or(0);
        (Self::ALL[cheapest], costs[cheapest])
    }

    /// Adds how far each is off the last values of a stretch.
    fn judge_stretch(w: &[i64; LONGEST + TOGETHER], costs: &mut [u64; Self::ALL.len()]) {
        let (older, newer) = (sums(&w[..8]), sums(&w[8..LONGEST]));
        // What is newer stands before what is older.
        let all = (older.0 + newer.0, older.1 + 8 * older.0 + newer.1);
        let (mut fit8, mut fit16) = (Fit8::of(newer), Fit16::of(all));
        for at in LONGEST..LONGEST + TOGETHER {
            let value = w[at];
            Self::judge([w[at - 1], w[at - 2], w[at - 3], w[at - 4]], value, costs);
            costs[Self::Fit8 as usize] += value.wrapping_sub(fit8.next()).unsigned_abs();
            costs[Self::Fit16 as usize] += value.wrapping_sub(fit16.next()).unsigned_abs();
            fit8.follow(value, w[at - 8]);
            fit16.follow(value, w[at - LONGEST]);
        }
    }

    /// Adds how far each of the short ones is off.
    fn judge(before: [i64; 4], value: i64, costs: &mut [u64; Self::ALL.len()]) {
        for (cost, predictor) in costs.iter_mut().zip(&Self::ALL[..Self::SHORT]) {
            // Sums of so few values below 2^56 do not overflow.
            *cost += value.wrapping_sub(predictor.next(before)).unsigned_abs();
        }
    }
}

/// Places of values that a predictor is chosen by, from one end of the column to the other. All are judged by the same ones, so
/// that their costs compare; a choice needs no more of them than this. In a short column none looks further back than four.
pub(super) fn tried(len: usize) -> impl Iterator<Item = Range<usize>> {
    let (begins, together) = if len > 2 * LONGEST { (LONGEST, TOGETHER) } else { (4, 1) };
    let step = (len * together / TRIED).max(together);
    (begins..)
        .step_by(step)
        .map(move |from| from..from + together)
        .take_while(move |places| places.end <= len)
}

/// Adds what is predicted to residuals, the values before `from` being there.
fn add(values: &mut [i64], from: usize, predict: impl Fn([i64; 4]) -> i64) {
    let Some((there, rest)) = values.split_at_mut_checked(from) else { return };
    let mut newest = there.iter().rev().copied();
    let mut before = [(); 4].map(|()| newest.next().unwrap_or(0));
    for value in rest {
        *value = predict(before).wrapping_add(*value);
        let [a, b, c, _] = before;
        before = [*value, a, b, c];
    }
}

/// Small integers of either sign as small ones without.
pub(super) const fn zigzag(value: i64) -> u64 {
    ((value << 1) ^ (value >> 63)).cast_unsigned()
}

/// What [`zigzag`] was given.
pub(crate) const fn unzigzag(value: u64) -> i64 {
    (value >> 1).cast_signed() ^ -(value & 1).cast_signed()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The line of least squares through values at 1, 2, …, taken one further, by its normal equations, exactly; to the
    /// nearest integer, halves up.
    fn line_through(values: &[i64]) -> i64 {
        let n = i128::try_from(values.len()).unwrap();
        let (mut sum, mut moment) = (0, 0);
        for (at, value) in (1..).zip(values) {
            sum += i128::from(*value);
            moment += at * i128::from(*value);
        }
        let (ones, squares) = (n * (n + 1) / 2, n * (n + 1) * (2 * n + 1) / 6);
        // value(n + 1) = (sum · squares − ones · moment + (n + 1)(n · moment − ones · sum)) / (n · squares − ones²)
        let over = n * squares - ones * ones;
        let of = sum * squares - ones * moment + (n + 1) * (n * moment - ones * sum);
        i64::try_from((2 * of + over).div_euclid(2 * over)).unwrap()
    }

    fn decimals() -> impl Strategy<Value = i64> {
        const MOST: i64 = (1 << 53) - 1;
        prop_oneof![-50_i64..50, -1_000_000_i64..1_000_000, -MOST..=MOST, Just(MOST), Just(-MOST)]
    }

    /// Residuals that are there already.
    pub(in super::super) struct Listed<'a>(pub(in super::super) &'a [i64]);

    impl Residuals for Listed<'_> {
        fn next(&mut self) -> Option<i64> {
            let (residual, rest) = self.0.split_first()?;
            self.0 = rest;
            Some(*residual)
        }
    }

    proptest! {
        #[test]
        fn fits_are_lines_of_least_squares(values in prop::collection::vec(decimals(), 17..60)) {
            let (mut fit8, mut fit16) = (Fit8::of(sums(&values[8..16])), Fit16::of(sums(&values[..16])));
            for at in 16..values.len() {
                prop_assert_eq!(fit8.next(), line_through(&values[at - 8..at]));
                prop_assert_eq!(fit16.next(), line_through(&values[at - 16..at]));
                fit8.follow(values[at], values[at - 8]);
                fit16.follow(values[at], values[at - 16]);
            }
        }

        #[test]
        fn whatever_the_predictor_values_come_back(
            values in prop::collection::vec(decimals(), 1..60),
            predictor in prop::sample::select(Predictor::ALL.as_slice()),
        ) {
            let mut residuals = Vec::new();
            predictor.residuals(&values, &mut residuals);
            prop_assert_eq!(residuals.len(), values.len() - 1);
            let mut back = vec![0; values.len()];
            back[0] = values[0];
            prop_assert!(predictor.restore(&mut back, Listed(&residuals)).is_some_and(|rest| rest.0.is_empty()));
            prop_assert_eq!(&back, &values);
            let short = &residuals[..residuals.len().saturating_sub(1)];
            prop_assert_eq!(predictor.restore(&mut back, Listed(short)).is_none(), values.len() > 1);
        }
    }

    #[test]
    fn the_predictor_that_is_off_the_least_is_taken() {
        let mut noise = 7_u64;
        let mut noisy = |at: i64| {
            noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            at + i64::try_from(noise >> 58).unwrap()
        };
        let best = |values: Vec<i64>| Predictor::best(&values, tried(values.len())).0;
        assert_eq!(best((0..200).map(|k| 7 * k).collect()), Predictor::Line);
        assert_eq!(best((0..200).map(|k| noisy(9 * k)).collect()), Predictor::Fit16);
        assert_eq!(best((0..200).map(|k| noisy(k * k / 3)).collect()), Predictor::Fit8);
        // Too few to tell how fits do.
        assert!(!best((0..32).map(|k| noisy(9 * k)).collect()).is_fit());
    }

    #[test]
    fn what_is_tried_is_spread_over_the_column() {
        for len in 0..2_000 {
            let places: Vec<_> = tried(len).collect();
            assert!(places.iter().all(|places| places.start >= 4 && places.end <= len), "{len}");
            assert!(places.is_sorted_by(|a, b| a.end <= b.start), "{len}");
            let values: usize = places.iter().map(Range::len).sum();
            assert!(values <= 2 * TRIED && (values >= TRIED / 2 || len < 2 * TRIED), "{len}: {values}");
            assert_eq!(places.is_empty(), len < 5, "{len}");
        }
    }
}

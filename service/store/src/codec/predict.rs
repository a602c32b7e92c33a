//! What the next integer of a column is taken to be: what is stored is how far it is off.

/// Values that a predictor is chosen by.
const TRIED: usize = 64;

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
    /// Each value times its place, the newest being the first.
    weighted: i64,
}

type Fit8 = Fit<8, 17, 3, 28>;
type Fit16 = Fit<16, 11, 1, 40>;

// Sums of so few values below 2^53 do not overflow; those of a damaged block may wrap.
impl<const N: usize, const SUM: i64, const WEIGHTED: i64, const OVER: i64> Fit<N, SUM, WEIGHTED, OVER> {
    /// Through the last values of these, of which there are `N` at least.
    fn through(values: &[i64]) -> Self {
        let newest_first = (1..).zip(values.iter().rev().take(N));
        let none = Self { sum: 0, weighted: 0 };
        newest_first.fold(none, |fit, (place, value): (i64, _)| Self {
            sum: fit.sum.wrapping_add(*value),
            weighted: fit.weighted.wrapping_add(value.wrapping_mul(place)),
        })
    }

    /// What comes next, to the nearest integer.
    const fn next(self) -> i64 {
        let over = self.sum.wrapping_mul(SUM).wrapping_sub(self.weighted.wrapping_mul(WEIGHTED));
        over.wrapping_add(OVER / 2).div_euclid(OVER)
    }

    /// With one more value, without the oldest.
    #[expect(clippy::cast_possible_wrap, reason = "N is 8 or 16")]
    const fn follow(&mut self, newest: i64, oldest: i64) {
        let left = oldest.wrapping_mul(N as i64 + 1);
        self.weighted = self.weighted.wrapping_add(self.sum).wrapping_add(newest).wrapping_sub(left);
        self.sum = self.sum.wrapping_add(newest).wrapping_sub(oldest);
    }

    fn residuals(values: &[i64], out: &mut Vec<u64>) {
        let Some(first) = values.get(..N) else { return };
        let mut fit = Self::through(first);
        out.extend(values[N..].iter().zip(values).map(|(&value, &oldest)| {
            let residual = zigzag(value - fit.next());
            fit.follow(value, oldest);
            residual
        }));
    }

    fn restore(values: &mut Vec<i64>, len: usize, next: &mut impl FnMut() -> Option<u64>) -> Option<()> {
        if values.len() < N {
            return Some(());
        }
        let mut fit = Self::through(values);
        while values.len() < len {
            let value = fit.next().wrapping_add(unzigzag(next()?));
            fit.follow(value, values[values.len() - N]);
            values.push(value);
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

    /// How far each value after the first is off, zig-zag.
    pub(super) fn residuals(self, values: &[i64], out: &mut Vec<u64>) {
        out.clear();
        out.reserve(values.len());
        let reach = self.reach().min(values.len());
        for pair in values[..reach].windows(2) {
            out.push(zigzag(pair[1] - pair[0]));
        }
        match self {
            Self::Last => {
                out.extend(values.windows(2).map(|w| zigzag(w[1] - w[0])));
            }
            Self::Line | Self::Mean => {
                out.extend(values.windows(3).map(|w| zigzag(w[2] - self.next([w[1], w[0], 0, 0]))));
            }
            Self::MeanLine => {
                out.extend(values.windows(5).map(|w| zigzag(w[4] - self.next([w[3], w[2], w[1], w[0]]))));
            }
            Self::Fit8 => Fit8::residuals(values, out),
            Self::Fit16 => Fit16::residuals(values, out),
        }
    }

    /// The predictor whose residuals are the smallest in all; of several the first.
    pub(super) fn best(values: &[i64]) -> Self {
        // All over the same values, so that the costs compare; a choice needs no more of them than this.
        const LONGEST: usize = Predictor::Fit16.reach();
        let step = (values.len() / TRIED).max(1);
        let mut costs = [0_u64; Self::ALL.len()];
        if values.len() <= 2 * LONGEST {
            for w in values.windows(5).step_by(step) {
                Self::judge([w[3], w[2], w[1], w[0]], w[4], &mut costs);
            }
            costs[Self::SHORT..].fill(u64::MAX);
        } else {
            for w in values.windows(LONGEST + 1).step_by(step) {
                let (&value, before) = w.split_last().unwrap_or((&0, w));
                Self::judge([before[15], before[14], before[13], before[12]], value, &mut costs);
                costs[Self::Fit8 as usize] += value.wrapping_sub(Fit8::through(before).next()).unsigned_abs();
                costs[Self::Fit16 as usize] +=
                    value.wrapping_sub(Fit16::through(before).next()).unsigned_abs();
            }
        }
        let cheapest = (0..costs.len()).min_by_key(|&at| costs[at]).unwrap_or(0);
        Self::ALL[cheapest]
    }

    /// Adds how far each of the short ones is off.
    fn judge(before: [i64; 4], value: i64, costs: &mut [u64; Self::ALL.len()]) {
        for (cost, predictor) in costs.iter_mut().zip(&Self::ALL[..Self::SHORT]) {
            // Sums of so few values below 2^56 do not overflow.
            *cost += value.wrapping_sub(predictor.next(before)).unsigned_abs();
        }
    }
}

/// Puts values back together behind the first, until there are `len`; `None` where a residual is missing.
pub(super) fn restore(
    predictor: Predictor,
    values: &mut Vec<i64>,
    len: usize,
    mut next: impl FnMut() -> Option<u64>,
) -> Option<()> {
    fill(values, predictor.reach().min(len), &mut next, |before| Predictor::Last.next(before))?;
    // A loop for each, so that none asks at every value which it is.
    match predictor {
        Predictor::Last => fill(values, len, &mut next, |before| Predictor::Last.next(before)),
        Predictor::Line => fill(values, len, &mut next, |before| Predictor::Line.next(before)),
        Predictor::Mean => fill(values, len, &mut next, |before| Predictor::Mean.next(before)),
        Predictor::MeanLine => fill(values, len, &mut next, |before| Predictor::MeanLine.next(before)),
        Predictor::Fit8 => Fit8::restore(values, len, &mut next),
        Predictor::Fit16 => Fit16::restore(values, len, &mut next),
    }
}

fn fill(
    values: &mut Vec<i64>,
    len: usize,
    next: &mut impl FnMut() -> Option<u64>,
    predict: impl Fn([i64; 4]) -> i64,
) -> Option<()> {
    let mut newest = values.iter().rev().copied();
    let mut before = [(); 4].map(|()| newest.next().unwrap_or(0));
    while values.len() < len {
        let value = predict(before).wrapping_add(unzigzag(next()?));
        let [a, b, c, _] = before;
        before = [value, a, b, c];
        values.push(value);
    }
    Some(())
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
mod tests {
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

    proptest! {
        #[test]
        fn fits_are_lines_of_least_squares(values in prop::collection::vec(decimals(), 17..60)) {
            let (mut fit8, mut fit16) = (Fit8::through(&values[..16]), Fit16::through(&values[..16]));
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
            let mut back = vec![values[0]];
            let mut rest = residuals.iter().copied();
            prop_assert_eq!(restore(predictor, &mut back, values.len(), || rest.next()), Some(()));
            prop_assert_eq!(&back, &values);
            let mut short = residuals.iter().copied().take(residuals.len().saturating_sub(1));
            let ended = restore(predictor, &mut vec![values[0]], values.len(), || short.next());
            prop_assert_eq!(ended.is_none(), values.len() > 1);
        }
    }

    #[test]
    fn the_predictor_that_is_off_the_least_is_taken() {
        let mut noise = 7_u64;
        let mut noisy = |at: i64| {
            noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            at + i64::try_from(noise >> 58).unwrap()
        };
        assert_eq!(Predictor::best(&(0..200).map(|k| 7 * k).collect::<Vec<_>>()), Predictor::Line);
        assert_eq!(Predictor::best(&(0..200).map(|k| noisy(9 * k)).collect::<Vec<_>>()), Predictor::Fit16);
        assert_eq!(Predictor::best(&(0..200).map(|k| noisy(k * k / 3)).collect::<Vec<_>>()), Predictor::Fit8);
        // Too few to tell how fits do.
        let few: Vec<_> = (0..32).map(|k| noisy(9 * k)).collect();
        assert!(!Predictor::best(&few).is_fit());
    }
}

//! What the next integer of a column is taken to be: what is stored is how far it is off.

/// Values that a predictor is chosen by.
const TRIED: usize = 128;

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
}

impl Predictor {
    const ALL: [Self; 4] = [Self::Last, Self::Line, Self::Mean, Self::MeanLine];

    pub(super) fn from_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code)).copied()
    }

    /// Values that have to come before; until then it is the last one.
    const fn reach(self) -> usize {
        match self {
            Self::Last => 1,
            Self::Line | Self::Mean => 2,
            Self::MeanLine => 4,
        }
    }

    /// From the values before, the newest first. Values of a decimal column are below 2^53, so nothing overflows;
    /// those of a damaged block may wrap.
    const fn next(self, [a, b, c, d]: [i64; 4]) -> i64 {
        match self {
            Self::Last => a,
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
        }
    }

    /// The predictor whose residuals are the smallest in all; of several the first.
    pub(super) fn best(values: &[i64]) -> Self {
        // All over the same values, so that the costs compare; a choice needs no more of them than this.
        let step = (values.len() / TRIED).max(1);
        let mut costs = [0_u64; Self::ALL.len()];
        for w in values.windows(5).step_by(step) {
            let before = [w[3], w[2], w[1], w[0]];
            for (cost, predictor) in costs.iter_mut().zip(Self::ALL) {
                // Sums of so few values below 2^56 do not overflow.
                *cost += w[4].wrapping_sub(predictor.next(before)).unsigned_abs();
            }
        }
        let cheapest = (0..costs.len()).min_by_key(|&at| costs[at]).unwrap_or(0);
        Self::ALL[cheapest]
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

pub(super) const fn zigzag(value: i64) -> u64 {
    ((value << 1) ^ (value >> 63)).cast_unsigned()
}

pub(super) const fn unzigzag(value: u64) -> i64 {
    (value >> 1).cast_signed() ^ -(value & 1).cast_signed()
}

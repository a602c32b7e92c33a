//! The samples of a running cycle by their numbers, with what each was answered.

use super::cycle::SampleAdvice;
use crate::cycle::{Channel, DURATION_RANGE, TimeBase};

/// The time base of some samples, and each channel's values.
pub type Columns = (TimeBase, Vec<(Channel, Vec<f64>)>);

/// Some samples in a row, column after column: value `i` of channel `c` stands at `c · count + i`.
///
/// A value that was not measured, or not sent, is not finite.
#[derive(Debug, Clone, Copy)]
pub struct Batch<'a> {
    /// Number of the first sample within the cycle, counted from 0.
    pub first: u64,
    /// Samples.
    pub count: usize,
    /// Values, `count` for each of the cycle's channels, in their order.
    pub values: &'a [f64],
    /// Times since the start of the cycle, ms, `count` of them; empty where the cycle has a period.
    pub times_ms: &'a [f64],
}

/// How the samples of a cycle are timed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Timing {
    /// Evenly, the first at the end of the first period.
    Period {
        /// Distance of two samples, ms.
        period_ms: f64,
    },
    /// Each says its time; the usual distance is only what a gap is measured by.
    Stamps {
        /// Usual distance of two samples, ms.
        usual_ms: f64,
    },
}

impl Timing {
    /// The distance of two samples that is expected, ms.
    #[must_use]
    pub const fn period_ms(&self) -> f64 {
        match self {
            Self::Period { period_ms } => *period_ms,
            Self::Stamps { usual_ms } => *usual_ms,
        }
    }
}

/// What is known of one number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Held {
    /// Nothing came yet.
    Nothing,
    /// A sample came, but not every value of it can be kept.
    Unusable,
    /// A whole sample.
    Whole,
}

/// The samples so far.
#[derive(Debug, Clone)]
pub struct Record {
    channels: Vec<Channel>,
    timing: Timing,
    columns: Vec<Vec<f64>>,
    times_ms: Vec<f64>,
    held: Vec<Held>,
    advice: Vec<SampleAdvice>,
    most: usize,
}

impl Record {
    /// Nothing yet; at most `most` samples will be kept.
    #[must_use]
    pub fn new(channels: Vec<Channel>, timing: Timing, most: usize) -> Self {
        let columns = channels.iter().map(|_| Vec::new()).collect();
        Self { channels, timing, columns, times_ms: Vec::new(), held: Vec::new(), advice: Vec::new(), most }
    }

    /// The channels, in the order of a batch's columns.
    #[must_use]
    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }

    /// How samples are timed.
    #[must_use]
    pub const fn timing(&self) -> Timing {
        self.timing
    }

    /// The number that comes next.
    #[must_use]
    pub fn next(&self) -> u64 {
        self.held.len() as u64
    }

    /// The first number that is missing: from there a machine that resumes sends again.
    #[must_use]
    pub fn first_missing(&self) -> u64 {
        self.held.iter().position(|held| *held == Held::Nothing).unwrap_or(self.held.len()) as u64
    }

    /// Whether number `n` can be kept.
    #[must_use]
    pub const fn has_room_for(&self, n: u64) -> bool {
        n < self.most as u64
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let per_sample = 8 * (self.columns.len() + 1) + size_of::<SampleAdvice>() + 1;
        self.held.capacity() * per_sample
    }

    fn index(n: u64) -> usize {
        usize::try_from(n).unwrap_or(usize::MAX)
    }

    /// Time of sample `i` of a batch since the start of the cycle, ms; not finite where it was not sent.
    #[must_use]
    pub fn time_ms(&self, batch: &Batch<'_>, i: usize) -> f64 {
        match self.timing {
            #[expect(clippy::cast_precision_loss, reason = "bounded by the most samples of a cycle")]
            Timing::Period { period_ms } => (batch.first.saturating_add(i as u64 + 1)) as f64 * period_ms,
            Timing::Stamps { .. } => batch.times_ms.get(i).copied().unwrap_or(f64::NAN),
        }
    }

    /// Whether anything of number `n` is held.
    #[must_use]
    pub fn has(&self, n: u64) -> bool {
        self.held.get(Self::index(n)).is_some_and(|held| *held != Held::Nothing)
    }

    /// Whether sample `i` of a batch is the one that is held under its number, bit for bit but that −0.0 is 0.0.
    #[must_use]
    pub fn is_same(&self, batch: &Batch<'_>, i: usize) -> bool {
        let at = Self::index(batch.first + i as u64);
        let same = |a: f64, b: f64| (a + 0.0).to_bits() == (b + 0.0).to_bits() || (a.is_nan() && b.is_nan());
        let times = match self.timing {
            Timing::Period { .. } => true,
            Timing::Stamps { .. } => {
                self.times_ms.get(at).is_some_and(|held| same(*held, self.time_ms(batch, i)))
            }
        };
        let mut columns = self.columns.iter().enumerate();
        times
            && columns.all(|(c, held)| {
                held.get(at).is_some_and(|held| same(*held, batch.values[c * batch.count + i]))
            })
    }

    /// What number `n` was answered.
    #[must_use]
    pub fn advice(&self, n: u64) -> Option<SampleAdvice> {
        self.advice.get(Self::index(n)).copied()
    }

    /// What each number was answered, in their order; missing ones as what came after them.
    #[must_use]
    pub fn all_advice(&self) -> &[SampleAdvice] {
        &self.advice
    }

    /// Keeps sample `i` of a batch under its number, leaving those between as missing.
    pub fn keep(&mut self, batch: &Batch<'_>, i: usize, advice: SampleAdvice) {
        let n = batch.first + i as u64;
        if !self.has_room_for(n) {
            return;
        }
        let at = Self::index(n);
        let time_ms = self.time_ms(batch, i);
        let mut whole = (DURATION_RANGE.min..=DURATION_RANGE.max).contains(&time_ms);
        for (c, (channel, column)) in self.channels.iter().zip(&mut self.columns).enumerate() {
            if column.len() <= at {
                column.resize(at + 1, f64::NAN);
            }
            // −0.0 is 0.0, as in a posted cycle.
            let value = batch.values[c * batch.count + i] + 0.0;
            let range = channel.range();
            whole &= value >= range.min && value <= range.max;
            column[at] = value;
        }
        if matches!(self.timing, Timing::Stamps { .. }) {
            if self.times_ms.len() <= at {
                self.times_ms.resize(at + 1, f64::NAN);
            }
            self.times_ms[at] = time_ms;
        }
        if self.held.len() <= at {
            self.held.resize(at + 1, Held::Nothing);
            self.advice.resize(at + 1, advice);
        }
        self.held[at] = if whole { Held::Whole } else { Held::Unusable };
        self.advice[at] = advice;
    }

    /// Samples that came and those of them that are whole.
    #[must_use]
    pub fn counts(&self) -> (usize, usize) {
        let came = self.held.iter().filter(|held| **held != Held::Nothing).count();
        (came, self.held.iter().filter(|held| **held == Held::Whole).count())
    }

    /// Which samples are stored: the whole ones whose time does not run backwards.
    fn wanted(&self) -> Vec<bool> {
        let mut latest = 0.0;
        let mut wanted = |at: usize, held: &Held| {
            let time_ms = self.times_ms.get(at).copied().unwrap_or(latest);
            let wanted = *held == Held::Whole && time_ms >= latest;
            latest = if wanted { time_ms } else { latest };
            wanted
        };
        self.held.iter().enumerate().map(|(at, held)| wanted(at, held)).collect()
    }

    /// The whole samples as columns with their time base: evenly spaced where none is missing. `None` without any.
    #[must_use]
    pub fn columns(&self) -> Option<Columns> {
        let wanted = self.wanted();
        let whole = wanted.iter().filter(|wanted| **wanted).count();
        if whole == 0 {
            return None;
        }
        let kept = |column: &[f64]| -> Vec<f64> {
            column.iter().zip(&wanted).filter(|(_, wanted)| **wanted).map(|(value, _)| *value).collect()
        };
        let columns =
            self.channels.iter().zip(&self.columns).map(|(channel, column)| (*channel, kept(column)));
        let time = match self.timing {
            Timing::Period { period_ms } if whole == self.held.len() => TimeBase::Period { period_ms },
            #[expect(clippy::cast_precision_loss, reason = "bounded by the most samples of a cycle")]
            Timing::Period { period_ms } => {
                let times: Vec<f64> = (0..self.held.len()).map(|n| (n + 1) as f64 * period_ms).collect();
                TimeBase::Stamps { time_ms: kept(&times) }
            }
            Timing::Stamps { .. } => TimeBase::Stamps { time_ms: kept(&self.times_ms) },
        };
        Some((time, columns.collect()))
    }
}

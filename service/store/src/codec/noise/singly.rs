//! Residuals of block formats v4 and v5: each goes by a table of its own.

use super::{Law, MEANS, MOST_LEVEL, Tables, counted, first_mean, taken};
use crate::codec::ans;
use crate::codec::predict::Residuals;

/// A mean's sum is 2^4 as much.
const MEMORY: u32 = 4;

/// How large residuals were of late.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scale {
    sum: u64,
    /// The mean for the next residual, before that of the residual before it.
    pub(super) mean: u64,
}

impl Scale {
    /// From the level of the mean, at most [`MOST_LEVEL`].
    pub(super) const fn new(level: u8) -> Self {
        let mean = first_mean(level);
        Self { sum: mean << MEMORY, mean }
    }

    /// By what a residual counts.
    #[inline(always)]
    pub(super) const fn follow(&mut self, counted: u64) {
        self.mean = self.sum >> MEMORY;
        self.sum = self.sum - self.mean + (counted << super::FRACTION);
    }
}

/// Reads the residuals of one column.
pub(in super::super) struct NoiseReader<'a> {
    /// Where the next column is read on.
    pub(in super::super) coder: ans::Reader<'a>,
    tables: &'static Tables,
    scale: Scale,
}

impl<'a> NoiseReader<'a> {
    /// `None` where no column begins with such a mean.
    pub(in super::super) fn new(coder: ans::Reader<'a>, law: Law, first_level: u8) -> Option<Self> {
        let scale = Scale::new(first_level.min(MOST_LEVEL));
        (first_level <= MOST_LEVEL).then(|| Self { coder, tables: law.tables(), scale })
    }

    /// Reads residuals as long as they are one symbol each. Says how many they were. A function of its own, so that all it goes by
    /// is in registers.
    #[inline(never)]
    fn read_usual(&mut self, residuals: &mut [i64]) -> usize {
        let (tables, mut coder, mut scale) = (self.tables, self.coder, self.scale);
        let mut read = 0;
        for residual in residuals {
            let mean = usize::try_from(scale.mean).unwrap_or(usize::MAX);
            let Some(number) = tables.number_of_mean.get(mean) else { break };
            let places = tables.places(*number);
            let (symbol, start, share) = places.at(coder.place());
            if symbol == places.escape || coder.take(start, share).is_none() {
                break;
            }
            *residual = i64::from(symbol) - i64::from(places.middle);
            scale.follow(residual.unsigned_abs());
            read += 1;
        }
        (self.coder, self.scale) = (coder, scale);
        read
    }
}

impl Residuals for NoiseReader<'_> {
    #[inline(never)]
    fn next(&mut self) -> Option<i64> {
        let (number, plain) = self.tables.by_mean(self.scale.mean);
        let residual = taken(&mut self.coder, self.tables.places(number), plain)?;
        self.scale.follow(counted(residual));
        Some(residual)
    }

    fn read(&mut self, mut residuals: &mut [i64]) -> Option<()> {
        loop {
            let usual = self.read_usual(residuals);
            residuals = &mut residuals[usual..];
            // What stopped it, and all that have plain bits besides.
            loop {
                let Some((residual, rest)) = residuals.split_first_mut() else { return Some(()) };
                *residual = self.next()?;
                residuals = rest;
                if self.scale.mean < MEANS {
                    break;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::note;
    use super::super::tests::Reads;
    use super::*;

    impl<'a> Reads<'a> for NoiseReader<'a> {
        /// As it was written once.
        fn write(coder: &mut ans::Writer, residuals: &[i64], law: Law, first_level: u8) {
            let (tables, mut scale, mut symbols) = (law.tables(), Scale::new(first_level), Vec::new());
            for residual in residuals {
                let (number, plain) = tables.by_mean(scale.mean);
                note(&mut symbols, tables.symbols(number), *residual, plain);
                scale.follow(counted(*residual));
            }
            coder.put_before(&symbols);
        }

        fn of(coder: ans::Reader<'a>, law: Law, first_level: u8) -> Option<Self> {
            Self::new(coder, law, first_level)
        }

        fn coder(&self) -> ans::Reader<'a> {
            self.coder
        }
    }
}

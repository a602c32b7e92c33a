//! Residuals of block format v6: those of a stretch go by one table, for what those of the stretches before tell.

use super::{FRACTION, Law, MOST_COUNTED, MOST_LEVEL, Tables, first_mean, note, place, taken};
use crate::codec::ans::{self, Symbol};
use crate::codec::predict::Residuals;

/// Residuals that go by one table: the format's.
pub(super) const STRETCH: usize = 8;
const _: () = assert!(STRETCH == ans::TOGETHER, "a stretch is written at once");
/// Stretches that are written in one go.
const PIECE: usize = 64;
/// What a stretch counts at the most: as much as of residuals that each count as much as one does at the most.
const MOST_SUM: u64 = MOST_COUNTED * STRETCH as u64;

/// How large residuals are, in 1/2^8, as far as those before tell.
#[derive(Debug, Clone, Copy)]
pub(super) struct Mean(u64);

impl Mean {
    /// From the level of the mean, at most [`MOST_LEVEL`].
    pub(super) const fn of_level(level: u8) -> Self {
        Self(first_mean(level))
    }

    pub(super) const fn get(self) -> u64 {
        self.0
    }

    /// With one more stretch.
    #[inline(always)]
    pub(super) fn follow(&mut self, stretch: &[i64]) {
        let sum = stretch.iter().fold(0_u64, |sum, residual| sum.wrapping_add(residual.unsigned_abs()));
        self.follow_sum(sum);
    }

    /// By the sum of its sizes, which counts as much as all that came before.
    #[inline(always)]
    fn follow_sum(&mut self, sum: u64) {
        self.0 = (self.0 + (sum.min(MOST_SUM) << FRACTION) / STRETCH as u64) / 2;
    }
}

/// Writes residuals.
#[derive(Debug, Default)]
pub(in super::super) struct StretchWriter {
    /// The table of each stretch, and plain bits.
    tables: Vec<(u8, u8)>,
    symbols: Vec<Symbol>,
}

impl StretchWriter {
    /// Writes the residuals of a column before what was written.
    #[expect(clippy::cast_possible_truncation, reason = "at most 64 bits")]
    pub(in super::super) fn put_before(
        &mut self,
        coder: &mut ans::Writer,
        residuals: &[i64],
        law: Law,
        first_level: u8,
    ) {
        let tables = law.tables();
        let mut mean = Mean::of_level(first_level);
        self.tables.clear();
        let (stretches, rest) = residuals.as_chunks::<STRETCH>();
        self.tables.extend(stretches.iter().map(|stretch| {
            let (number, plain) = tables.by_mean(mean.get());
            mean.follow(stretch);
            (number, plain as u8)
        }));
        if !rest.is_empty() {
            let (number, plain) = tables.by_mean(mean.get());
            self.tables.push((number, plain as u8));
        }
        let mut left = self.tables.len();
        while left > 0 {
            // So many at the most: each time room is made for all that may be written.
            let piece = left.saturating_sub(PIECE)..left;
            left -= put_usual(
                coder,
                tables,
                &self.tables[piece.clone()],
                stretches.get(piece).unwrap_or_default(),
            );
            // What stopped it: what escapes or has plain bits, which more of the same often stands before, and the end of the column.
            while let Some(stretch) = left.checked_sub(1)
                && let Some(&(number, plain)) = self.tables.get(stretch)
                && (plain > 0 || stretch >= stretches.len() || !is_usual(tables, number, &stretches[stretch]))
            {
                self.symbols.clear();
                for residual in residuals.chunks(STRETCH).nth(stretch).unwrap_or_default() {
                    note(&mut self.symbols, tables.symbols(number), *residual, plain.into());
                }
                coder.put_before(&self.symbols);
                left = stretch;
            }
        }
    }
}

/// Whether each residual is one symbol of a table.
fn is_usual(tables: &Tables, number: u8, stretch: &[i64; STRETCH]) -> bool {
    let (_, reach) = tables.symbols(number);
    stretch.iter().all(|residual| residual.unsigned_abs() <= reach.unsigned_abs())
}

/// Writes stretches, from the last one on, as long as each residual of them is one symbol; says how many. A function of its own,
/// so that all it goes by is in registers.
#[inline(never)]
fn put_usual(
    coder: &mut ans::Writer,
    tables: &Tables,
    of: &[(u8, u8)],
    stretches: &[[i64; STRETCH]],
) -> usize {
    // The end of a column is no whole stretch.
    if stretches.len() < of.len() {
        return 0;
    }
    coder.put_eights_before(of.iter().zip(stretches).rev().map(|((number, plain), stretch)| {
        if *plain > 0 {
            return None;
        }
        let (symbols, reach) = tables.symbols(*number);
        let (escape, symbols) = symbols.split_last()?;
        let mut found = [escape; STRETCH];
        for (found, residual) in found.iter_mut().zip(stretch) {
            *found = symbols.get(place(*residual, reach))?;
        }
        Some(found)
    }))
}

/// Reads the residuals of one column.
pub(in super::super) struct StretchReader<'a> {
    /// Where the next column is read on.
    pub(in super::super) coder: ans::Reader<'a>,
    tables: &'static Tables,
    mean: Mean,
    /// Those of the stretch that were read, and the sum of their sizes.
    read: usize,
    sum: u64,
}

impl<'a> StretchReader<'a> {
    /// `None` where no column begins with such a mean.
    pub(in super::super) fn new(coder: ans::Reader<'a>, law: Law, first_level: u8) -> Option<Self> {
        let mean = Mean::of_level(first_level.min(MOST_LEVEL));
        (first_level <= MOST_LEVEL).then(|| Self { coder, tables: law.tables(), mean, read: 0, sum: 0 })
    }

    /// Reads stretches as long as each residual of them is one symbol. Says how many they were. A function of its own, so that all
    /// it goes by is in registers.
    #[inline(never)]
    fn read_usual(&mut self, stretches: &mut [[i64; STRETCH]]) -> usize {
        let (tables, mut coder, mut mean) = (self.tables, self.coder, self.mean);
        let mut read = 0;
        for stretch in stretches {
            let (number, plain) = tables.by_mean(mean.get());
            if plain > 0 {
                break;
            }
            let places = tables.places(number);
            let (before, mut sum) = (coder, 0);
            let mut next = |residual: &mut i64| {
                let (symbol, start, share) = places.at(coder.place());
                *residual = i64::from(symbol) - i64::from(places.middle);
                sum += residual.unsigned_abs();
                coder.take(start, share).filter(|()| symbol != places.escape)
            };
            // Two at a time: then the states stand where they stood.
            let (pairs, _) = stretch.as_chunks_mut();
            if !pairs.iter_mut().all(|[one, other]| next(one).and_then(|()| next(other)).is_some()) {
                // All of it is read again, one by one.
                coder = before;
                break;
            }
            mean.follow_sum(sum);
            read += 1;
        }
        (self.coder, self.mean) = (coder, mean);
        read
    }
}

impl Residuals for StretchReader<'_> {
    #[inline(never)]
    fn next(&mut self) -> Option<i64> {
        let (number, plain) = self.tables.by_mean(self.mean.get());
        let residual = taken(&mut self.coder, self.tables.places(number), plain)?;
        self.sum = self.sum.wrapping_add(residual.unsigned_abs());
        self.read += 1;
        if self.read == STRETCH {
            self.mean.follow_sum(self.sum);
            (self.read, self.sum) = (0, 0);
        }
        Some(residual)
    }

    fn read(&mut self, mut residuals: &mut [i64]) -> Option<()> {
        loop {
            if self.read == 0 {
                let (stretches, _) = residuals.as_chunks_mut();
                let usual = self.read_usual(stretches);
                residuals = &mut residuals[usual * STRETCH..];
            }
            // What stopped it.
            let (stretch, rest) = residuals.split_at_mut(residuals.len().min(STRETCH - self.read));
            if stretch.is_empty() {
                return Some(());
            }
            for residual in stretch {
                *residual = self.next()?;
            }
            residuals = rest;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::Reads;
    use super::*;

    impl<'a> Reads<'a> for StretchReader<'a> {
        fn write(coder: &mut ans::Writer, residuals: &[i64], law: Law, first_level: u8) {
            StretchWriter::default().put_before(coder, residuals, law, first_level);
        }

        fn of(coder: ans::Reader<'a>, law: Law, first_level: u8) -> Option<Self> {
            Self::new(coder, law, first_level)
        }

        fn coder(&self) -> ans::Reader<'a> {
            self.coder
        }
    }

    /// By the definition, one symbol behind the other.
    #[test]
    fn usual_stretches_are_written_as_all_others() {
        let residuals: Vec<i64> = (0..203).map(|at| (at * at) % 7 - 3 + (at / 100) * (at % 5)).collect();
        let (mut quickly, mut plainly) = (ans::Writer::new(0), ans::Writer::new(0));
        let tables = Law::Normal.tables();
        StretchReader::write(&mut quickly, &residuals, Law::Normal, 30);
        let (mut symbols, mut mean) = (Vec::new(), Mean::of_level(30));
        for stretch in residuals.chunks(STRETCH) {
            let (number, plain) = tables.by_mean(mean.get());
            stretch.iter().for_each(|residual| note(&mut symbols, tables.symbols(number), *residual, plain));
            mean.follow(stretch);
        }
        plainly.put_before(&symbols);
        let [quickly, plainly] = [quickly, plainly].map(|writer| {
            let mut out = Vec::new();
            writer.finish(&mut out);
            out
        });
        assert_eq!(quickly, plainly);
    }
}

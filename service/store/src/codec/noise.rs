//! What residuals of noise cost by how large those before were: by a normal or a Laplace distribution over the integers
//! whose mean size follows the column, as codes of lossless images do (LOCO-I, Weinberger et al., 2000). A Rice code, which
//! suits a Laplace distribution of certain means, takes a twentieth more.
//!
//! The mean size m is kept in 1/2^8, quotients rounded down. The *level* of an integer v > 0 is
//! `4 n + q`, with 2^n its highest bit and q the two bits below. Of a mean, with its lowest bit set, it says by which table a residual
//! goes. A column begins with a mean of its first level, 2^n (4 + q) / 4: that of its first 32 residuals, each counted as 2^48 at the most.
//!
//! * Block format v6: eight residuals go by the same mean, the last ones of a column too where they are fewer; behind them m
//!   becomes `(m + 2^8 s / 8) / 2`, s being the sum of their sizes modulo 2^64, and 2^51 at the most.
//! * Block formats v4 and v5: `sum`, which begins as 16 m, becomes `sum − sum / 16 + 2^8 |residual|` with each, which counts as 2^48 at the most; m is `sum / 16`, as
//!   `sum` was before the residual before it.
//!
//! There are forty tables of each distribution, for the levels 4 to 43, which are means of 2^−7 to 8; less takes the first. Where the level is
//! 40 + 4k to 43 + 4k, the lowest k bits of a residual are written plainly (see `ans.rs`), behind the rest of it (divided by 2^k and rounded down), which goes
//! by the table for 4k less. No column begins with a level above 227.
//!
//! A table is for the mean in the middle of its level, m = 2^(n − 8) (9 + 2q) / 8. Its symbols are −r to r, r being
//! ⌊5 m⌋ + 4 (normal) or ⌊8 m⌋ + 4, and behind them the escape. With w(x) = p^(x²) (normal) or p^|x| (Laplace), where p, found
//! by halving 0 to 1 sixty times, gives |x| the mean m over −r to r, the shares of 2^12 are 2 for the escape, the larger of 1 and
//! w(x) / Σ w · 4094 + 1/2, rounded down, for each x but 0, and for 0 what is left. Behind an escape, which what is beyond
//! r takes of the rest too, stands how many bits the whole residual has, zig-zag, in seven plain bits, and what is below the highest of them, plainly; no k bits
//! behind that.

mod singly;
mod stretches;

use super::ans::{self, BITS, Symbol};
use super::predict::{unzigzag, zigzag};
pub(super) use singly::NoiseReader;
use std::sync::LazyLock;
use stretches::{Mean, STRETCH};
pub(super) use stretches::{StretchReader, StretchWriter};

/// Levels that have a table, those below [`FIRST_LEVEL`] that of this one.
const LEVELS: usize = 44;
const FIRST_LEVEL: usize = 4;
/// Means of less are of a level that has one.
const MEANS: u64 = 1 << (LEVELS / 4);
/// A mean is in 1/2^8.
const FRACTION: u32 = 8;
/// What a residual counts at the most.
const MOST_COUNTED: u64 = 1 << 48;
/// No mean is of a higher level.
const MOST_LEVEL: u8 = 4 * 56 + 3;

const WHOLE: u32 = 1 << BITS;
const ESCAPE: u32 = 2;
/// Bits of the number of bits of what escapes.
const COUNT: u32 = 7;
/// A symbol is looked up by this part of 2^12, from the first one of it on.
const PART: u32 = 4;
const PARTS: usize = (WHOLE >> PART) as usize;
/// No table has more symbols.
const MOST_SYMBOLS: usize = 256;

/// Residuals that the first mean is of.
const FIRST: usize = 32;
/// Residuals that a distribution is chosen by.
const TRIED: usize = 64;

/// How residuals are distributed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Law {
    /// Noise of many sources, as that of a load.
    Normal = 1,
    /// Mostly small, now and then large.
    Laplace = 2,
}

impl Law {
    const ALL: [Self; 2] = [Self::Normal, Self::Laplace];

    pub(super) fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|law| *law as u8 == code)
    }

    fn tables(self) -> &'static Tables {
        static NORMAL: LazyLock<Tables> = LazyLock::new(|| Tables::of(Law::Normal));
        static LAPLACE: LazyLock<Tables> = LazyLock::new(|| Tables::of(Law::Laplace));
        match self {
            Self::Normal => &NORMAL,
            Self::Laplace => &LAPLACE,
        }
    }

    /// A residual that is more times the mean than this goes behind an escape, if it is above 4: not one in thousands.
    const fn reach(self) -> f64 {
        match self {
            Self::Normal => 5.0,
            Self::Laplace => 8.0,
        }
    }

    /// p^(x²) or p^x for x from 0 on.
    fn weights(self, p: f64, reach: usize) -> impl Iterator<Item = f64> {
        let (mut weight, mut factor) = (1.0, p);
        (0..=reach).map(move |_| {
            let now = weight;
            weight *= factor;
            if self == Self::Normal {
                factor *= p * p;
            }
            now
        })
    }
}

/// The tables of a law.
#[derive(Debug)]
struct Tables {
    tables: [Table; TABLES],
    /// The symbols of all tables.
    symbols: Box<[Symbol]>,
    /// What each table is read by.
    places: Box<[Places; TABLES]>,
    /// The number of the table for a mean: it saves looking for its level.
    number_of_mean: Box<[u8]>,
}

/// How many they are, rounded up to what no number of six bits is beyond.
const TABLES: usize = 64;

/// Where a table's symbols are, the escape behind those of residuals.
#[derive(Debug, Clone, Copy)]
struct Table {
    first: u32,
    /// The largest residual that has one.
    reach: u32,
}

/// Where the shares of a table's symbols lie. Numbers of symbols are bytes, and there is an entry for every byte.
#[derive(Debug)]
struct Places {
    /// Where each begins, and behind the last one 2^12.
    starts: [u16; MOST_SYMBOLS + 1],
    /// For each part of 2^12, the symbol whose share it begins in.
    first_of_part: [u8; PARTS],
    /// The number of the symbol of the residual 0, and of the escape.
    middle: u8,
    escape: u8,
}

impl Places {
    const NONE: Self =
        Self { starts: [1 << BITS; MOST_SYMBOLS + 1], first_of_part: [0; PARTS], middle: 0, escape: 0 };

    /// Of shares that are 2^12 together, the last of them the escape's.
    #[expect(clippy::cast_possible_truncation, reason = "fewer than 256 symbols, parts of 2^12")]
    fn of(shares: &[u32]) -> Self {
        let mut starts = Self::NONE.starts;
        let mut start = 0;
        for (begins, share) in starts.iter_mut().zip(shares) {
            *begins = start as u16;
            start += share;
        }
        let first = |part: usize| starts.partition_point(|start| usize::from(*start) <= part << PART) - 1;
        let escape = (shares.len() - 1) as u8;
        Self {
            first_of_part: std::array::from_fn(|part| first(part) as u8),
            starts,
            middle: escape / 2,
            escape,
        }
    }

    /// The symbol whose share a place below 2^12 lies in, with where that begins and how large it is.
    #[inline(always)]
    fn at(&self, place: u32) -> (u8, u32, u32) {
        let mut symbol = self.first_of_part[(place >> PART) as usize % PARTS];
        let end = |symbol: u8| u32::from(self.starts[usize::from(symbol) + 1]);
        // Shares of a part are the fewer the larger they are.
        while place >= end(symbol) {
            symbol = symbol.wrapping_add(1);
        }
        let start = u32::from(self.starts[usize::from(symbol)]);
        (symbol, start, end(symbol) - start)
    }
}

/// The shares of −r to r, and of the escape.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "below 2^12"
)]
fn shares(law: Law, level: usize) -> Vec<u32> {
    let mean = ((9 + 2 * (level % 4)) << (level / 4)) as f64 / f64::from(8 << FRACTION);
    let reach = (law.reach() * mean) as usize + 4;
    let sums = |p| {
        let (mut all, mut sizes) = (0.0, 0.0);
        for (size, weight) in law.weights(p, reach).enumerate() {
            let both = if size == 0 { weight } else { 2.0 * weight };
            all += both;
            sizes += both * size as f64;
        }
        (all, sizes)
    };
    let (mut least, mut most) = (0.0, 1.0);
    for _ in 0..60 {
        let p = (least + most) / 2.0;
        let (all, sizes) = sums(p);
        if sizes < mean * all { least = p } else { most = p }
    }
    let (all, _) = sums(least);
    let share = |weight: f64| ((weight / all * f64::from(WHOLE - ESCAPE) + 0.5) as u32).max(1);
    let side: Vec<u32> = law.weights(least, reach).skip(1).map(share).collect();
    let middle = WHOLE - ESCAPE - 2 * side.iter().sum::<u32>();
    side.iter().rev().copied().chain([middle]).chain(side.iter().copied()).chain([ESCAPE]).collect()
}

impl Tables {
    #[expect(clippy::cast_possible_truncation, reason = "fewer than 2^12 symbols, fewer than 64 tables")]
    fn of(law: Law) -> Self {
        let mut symbols = Vec::new();
        let mut places = Box::new([const { Places::NONE }; TABLES]);
        let mut tables = [Table { first: 0, reach: 0 }; TABLES];
        for ((level, places), table) in (FIRST_LEVEL..LEVELS).zip(&mut *places).zip(&mut tables) {
            let shares = shares(law, level);
            *table = Table { first: symbols.len() as u32, reach: (shares.len() / 2 - 1) as u32 };
            let starts = shares.iter().scan(0, |start, share| Some(std::mem::replace(start, *start + share)));
            symbols.extend(starts.zip(&shares).map(|(start, share)| Symbol::new(start, *share)));
            *places = Places::of(&shares);
        }
        let number = |mean: u64| (level(mean | 1) as usize).saturating_sub(FIRST_LEVEL) as u8;
        Self { tables, symbols: symbols.into(), places, number_of_mean: (0..MEANS).map(number).collect() }
    }

    /// The number of the table for a mean, and how many of a residual's lowest bits are plain.
    #[inline(always)]
    fn by_mean(&self, mean: u64) -> (u8, u32) {
        let number = usize::try_from(mean).ok().and_then(|mean| self.number_of_mean.get(mean));
        number.map_or_else(|| large(mean), |number| (*number, 0))
    }

    /// A table's symbols: those of the residuals from the smallest to the largest, and the escape.
    #[inline(always)]
    fn symbols(&self, number: u8) -> (&[Symbol], i64) {
        let Table { first, reach } = self.tables[usize::from(number) % TABLES];
        let of_table = self.symbols.get(first as usize..).and_then(|from| from.get(..2 * reach as usize + 2));
        (of_table.unwrap_or_default(), i64::from(reach))
    }

    /// Where a table's shares lie.
    #[inline(always)]
    fn places(&self, number: u8) -> &Places {
        &self.places[usize::from(number) % TABLES]
    }
}

/// As [`Tables::by_mean`], of a mean of more than the tables'.
#[cold]
#[expect(clippy::cast_possible_truncation, reason = "at most 256")]
fn large(mean: u64) -> (u8, u32) {
    let above = level(mean | 1) as usize - LEVELS;
    ((LEVELS - 4 + above % 4 - FIRST_LEVEL) as u8, above as u32 / 4 + 1)
}

/// What a residual counts, of the mean size.
#[inline(always)]
fn counted(residual: i64) -> u64 {
    residual.unsigned_abs().min(MOST_COUNTED)
}

/// The mean that a column begins with, of a level of at most [`MOST_LEVEL`], in 1/2^8.
const fn first_mean(level: u8) -> u64 {
    (4 + level as u64 % 4) << (level / 4) >> 2
}

/// The level of what is more than 0.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "three bits")]
const fn level(value: u64) -> u32 {
    let highest = value.ilog2();
    // Its highest bit is a 4 there.
    4 * highest + (value << 2 >> highest) as u32 - 4
}

/// The level of the mean of the first residuals, which a column begins with.
pub(super) fn first_level(residuals: &[i64]) -> u8 {
    let few = &residuals[..residuals.len().min(FIRST)];
    let sum: u64 = few.iter().map(|residual| counted(*residual) << FRACTION).sum();
    u8::try_from(level((sum / few.len().max(1) as u64).max(1))).unwrap_or(MOST_LEVEL).min(MOST_LEVEL)
}

/// The law by which the first residuals take fewer bits; of the same the first.
pub(super) fn fitting_law(residuals: &[i64], first_level: u8) -> Law {
    let (normal, laplace) = (Law::Normal.tables(), Law::Laplace.tables());
    let mut mean = Mean::of_level(first_level);
    let mut less = 0;
    for stretch in residuals[..residuals.len().min(TRIED)].chunks(STRETCH) {
        let (number, plain) = normal.by_mean(mean.get());
        for residual in stretch {
            let share = |tables: &Tables| {
                let (symbols, reach) = tables.symbols(number);
                let found = symbols[..symbols.len() - 1].get(place(residual >> plain, reach));
                found.unwrap_or(&symbols[symbols.len() - 1]).share()
            };
            // In quarters of a bit.
            less += i64::from(level(share(laplace).into())) - i64::from(level(share(normal).into()));
        }
        mean.follow(stretch);
    }
    if less > 0 { Law::Laplace } else { Law::Normal }
}

/// The place of a residual's symbol in its table, or one that is beyond.
#[inline(always)]
#[expect(clippy::cast_sign_loss, clippy::cast_possible_truncation, reason = "what is beyond stays beyond")]
const fn place(residual: i64, reach: i64) -> usize {
    residual.wrapping_add(reach) as usize
}

/// Notes what stands for a residual, its lowest `plain` bits behind the rest.
fn note(symbols: &mut Vec<Symbol>, of_table: (&[Symbol], i64), residual: i64, plain: u32) {
    let (of_table, reach) = of_table;
    let Some((escape, of_residuals)) = of_table.split_last() else { return };
    match of_residuals.get(place(residual >> plain, reach)) {
        Some(symbol) => {
            symbols.push(*symbol);
            ans::note_plain(symbols, residual.cast_unsigned(), plain);
        }
        None => {
            symbols.push(*escape);
            let residual = zigzag(residual);
            let bits = u64::BITS - residual.leading_zeros();
            ans::note_plain(symbols, u64::from(bits), COUNT);
            ans::note_plain(symbols, residual, bits.saturating_sub(1));
        }
    }
}

/// The next residual, by that table; `None` where it is damaged.
fn taken(coder: &mut ans::Reader<'_>, places: &Places, plain: u32) -> Option<i64> {
    let (symbol, start, share) = places.at(coder.place());
    coder.take(start, share)?;
    if symbol == places.escape {
        return escaped(coder);
    }
    let rest = i64::from(symbol) - i64::from(places.middle);
    Some(rest << plain | coder.take_plain(plain)?.cast_signed())
}

/// What stands behind an escape.
fn escaped(coder: &mut ans::Reader<'_>) -> Option<i64> {
    #[expect(clippy::cast_possible_truncation, reason = "seven bits")]
    let bits = coder.take_plain(COUNT)? as u32;
    let below = bits.saturating_sub(1);
    let highest = if bits == 0 { 0 } else { 1_u64.checked_shl(below)? };
    Some(unzigzag(highest | coder.take_plain(below)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::predict::Residuals;
    use proptest::prelude::*;

    /// A column's reader, with what writes for it, and where the next column is read on.
    pub(super) trait Reads<'a>: Residuals + Sized {
        fn write(coder: &mut ans::Writer, residuals: &[i64], law: Law, first_level: u8);
        fn of(coder: ans::Reader<'a>, law: Law, first_level: u8) -> Option<Self>;
        fn coder(&self) -> ans::Reader<'a>;
    }

    fn residual() -> impl Strategy<Value = i64> {
        prop_oneof![6 => -3_i64..=3, 3 => -500_i64..500, 1 => any::<i64>(), 1 => Just(i64::MIN), 1 => Just(i64::MAX)]
    }

    fn column() -> impl Strategy<Value = (Vec<i64>, Law)> {
        // Runs take the mean to where it stays.
        let run = (residual(), prop_oneof![1_usize..4, 1_usize..150]);
        let residuals = prop::collection::vec(run, 0..12)
            .prop_map(|runs| runs.into_iter().flat_map(|(residual, count)| vec![residual; count]).collect());
        (residuals, prop::sample::select(Law::ALL.as_slice()))
    }

    /// Columns come back one behind the other, read together and one by one.
    fn comes_back<'a, R: Reads<'a>>(
        columns: &[(Vec<i64>, Law)],
        bytes: &'a mut Vec<u8>,
    ) -> Result<(), TestCaseError> {
        let mut writer = ans::Writer::new(0);
        for (residuals, law) in columns.iter().rev() {
            R::write(&mut writer, residuals, *law, first_level(residuals));
        }
        writer.finish(bytes);
        let mut coder = ans::Reader::new(bytes).unwrap();
        for (residuals, law) in columns {
            let reader = || R::of(coder, *law, first_level(residuals)).unwrap();
            let (mut at_once, mut one_by_one, mut in_parts) = (reader(), reader(), reader());
            let mut together = vec![0; residuals.len()];
            prop_assert_eq!(at_once.read(&mut together), Some(()));
            prop_assert_eq!(&together, residuals);
            prop_assert!(residuals.iter().all(|residual| one_by_one.next() == Some(*residual)));
            let mut parts = vec![0; residuals.len()];
            prop_assert!(parts.chunks_mut(13).all(|part| in_parts.read(part).is_some()));
            prop_assert_eq!(&parts, residuals);
            coder = at_once.coder();
            for other in [one_by_one.coder(), in_parts.coder()] {
                prop_assert_eq!(format!("{coder:?}"), format!("{other:?}"));
            }
        }
        prop_assert!(coder.is_at_end());
        Ok(())
    }

    /// Whatever stands there is read or refused.
    fn is_read_or_refused<'a, R: Reads<'a>>(
        (bytes, law, level): (&'a [u8], Law, u8),
        again: &'a mut Vec<u8>,
    ) -> Result<(), TestCaseError> {
        let Some(coder) = ans::Reader::new(bytes) else { return Ok(()) };
        let reader = R::of(coder, law, level);
        prop_assert_eq!(reader.is_some(), level <= MOST_LEVEL);
        let Some(mut reader) = reader else { return Ok(()) };
        // States alone go on for long where all is the likeliest symbol.
        let found: Vec<i64> = std::iter::from_fn(|| reader.next()).take(1_000).collect();
        // Whatever it was, it is a residual that can be written.
        let mut writer = ans::Writer::new(0);
        R::write(&mut writer, &found, law, level);
        writer.finish(again);
        let mut reader = R::of(ans::Reader::new(again).unwrap(), law, level).unwrap();
        prop_assert!(found.iter().all(|residual| reader.next() == Some(*residual)));
        prop_assert!(reader.coder().is_at_end());
        Ok(())
    }

    proptest! {
        #[test]
        fn what_is_written_comes_back(columns in prop::collection::vec(column(), 1..4)) {
            comes_back::<StretchReader>(&columns, &mut Vec::new())?;
            comes_back::<NoiseReader>(&columns, &mut Vec::new())?;
        }

        #[test]
        fn whatever_stands_there_is_read_or_refused(
            bytes in prop::collection::vec(any::<u8>(), 0..200),
            law in prop::sample::select(Law::ALL.as_slice()),
            level in any::<u8>(),
        ) {
            is_read_or_refused::<StretchReader>((&bytes, law, level), &mut Vec::new())?;
            is_read_or_refused::<NoiseReader>((&bytes, law, level), &mut Vec::new())?;
        }
    }

    #[test]
    fn shares_are_of_the_law_and_fixed_for_ever() {
        let mut all = blake3::Hasher::new();
        for law in Law::ALL {
            for level in FIRST_LEVEL..LEVELS {
                let shares = shares(law, level);
                assert_eq!(shares.iter().sum::<u32>(), WHOLE);
                assert!(shares.iter().all(|share| *share >= 1), "{law:?} {level}");
                let (escape, inner) = shares.split_last().unwrap();
                assert_eq!((*escape, inner.len() % 2), (ESCAPE, 1));
                let reach = i32::try_from(inner.len() / 2).unwrap();
                let sized = (-reach..).zip(inner).map(|(at, share)| f64::from(at.abs()) * f64::from(*share));
                let mean = sized.sum::<f64>() / f64::from(WHOLE);
                let levels = f64::from(u8::try_from(level).unwrap());
                let octave = (levels / 4.0).floor();
                let wanted = (octave - 8.0).exp2() * (9.0 + 2.0 * (levels - 4.0 * octave)) / 8.0;
                // Shares of at least one make tails heavier.
                assert!((mean - wanted).abs() < 0.06 * wanted + 0.01, "{law:?} {level}: {mean} {wanted}");
                for share in shares {
                    all.update(&share.to_le_bytes());
                }
            }
        }
        assert_eq!(
            all.finalize().to_hex().as_str(),
            "736c59ed76ef35d3d60c00800bfbdb088db76263dbfd6ff13ae3515d082d4747"
        );
    }

    #[test]
    fn a_law_is_told_from_its_noise() {
        let mut state = 7_u64;
        let mut even = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            i64::try_from(state >> 56).unwrap() - 128
        };
        let sums: Vec<i64> = (0..200).map(|_| (even() + even() + even() + even()) / 50).collect();
        let rare: Vec<i64> = (0..200).map(|at| if at % 7 == 3 { even() / 2 } else { even() / 60 }).collect();
        assert_eq!(fitting_law(&sums, first_level(&sums)), Law::Normal);
        assert_eq!(fitting_law(&rare, first_level(&rare)), Law::Laplace);
    }
}

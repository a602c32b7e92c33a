//! What residuals of noise cost by how large those before were: by a normal or a Laplace distribution over the integers
//! whose mean size follows the column, as codes of lossless images do (LOCO-I, Weinberger et al., 2000). A Rice code, which
//! suits a Laplace distribution of certain means, takes a twentieth more.
//!
//! The mean size is kept in 1/2^8: `sum`, its 16-fold, becomes `sum − sum / 16 + 2^8 |residual|`, quotients rounded down and
//! sizes counted as 2^48 at the most. The *level* of an integer v > 0 is `4 n + q`, with 2^n its highest bit and q the two
//! bits below. A residual goes by the table for the level of `sum / 16`, rounded down, its lowest bit set, as `sum` was before
//! the residual before it: so a reader need not wait for the one to look for the other. There are forty tables of each distribution, for the levels 4 to 43, which are means of 2^−7 to 8; less takes the first. Where the level is
//! 40 + 4k to 43 + 4k, the lowest k bits of a residual are written plainly, behind the rest of it, which goes by the table for 4k
//! less.
//!
//! A table is for the mean in the middle of its level, m = 2^(n − 8) (9 + 2q) / 8. Its symbols are −r to r, r being
//! ⌊5 m⌋ + 4 (normal) or ⌊8 m⌋ + 4, and behind them the escape. With w(x) = p^(x²) (normal) or p^|x| (Laplace), where p, found
//! by halving 0 to 1 sixty times, gives |x| the mean m over −r to r, the shares of 2^12 are 2 for the escape, the larger of 1 and
//! w(x) / Σ w · 4094 + 1/2, rounded down, for each x but 0, and for 0 what is left. Behind an escape stands how many bits the
//! residual has, zig-zag, in seven bits, and what is below the highest of them.

use super::ans::{self, BITS, Symbol};
use super::predict::{Residuals, unzigzag, zigzag};
use std::sync::LazyLock;

/// Levels that have a table, those below [`FIRST_LEVEL`] that of this one.
const LEVELS: usize = 44;
const FIRST_LEVEL: usize = 4;
/// Means of less are of a level that has one.
const MEANS: u64 = 1 << (LEVELS / 4);
/// The mean is in 1/2^8, and its sum is 2^4 as much.
const FRACTION: u32 = 8;
const MEMORY: u32 = 4;
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

/// Residuals that a distribution is chosen by, and that the first mean is of.
const TRIED: usize = 32;

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
    of_level: [Table; LEVELS],
    /// The same by the mean itself, which saves looking for its level.
    of_mean: Box<[Table]>,
    /// The symbols of all tables.
    symbols: Box<[Symbol]>,
    /// What each table is read by.
    places: Box<[Places; TABLES]>,
    /// The number of the table for a mean.
    number_of_mean: Box<[u8]>,
}

/// How many they are, rounded up to what no number of six bits is beyond.
const TABLES: usize = 64;

/// Where a table's symbols are.
#[derive(Debug, Clone, Copy)]
struct Table {
    /// That of the residual 0.
    middle: u32,
    reach: u32,
    /// Its number.
    number: u8,
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
    #[expect(
        clippy::cast_possible_truncation,
        reason = "shares of 2^12, and fewer than 256 symbols of a table"
    )]
    fn of(law: Law) -> Self {
        let mut symbols = Vec::new();
        let mut places = Box::new([const { Places::NONE }; TABLES]);
        let tables: Vec<Table> = (FIRST_LEVEL..LEVELS)
            .map(|level| {
                let shares = shares(law, level);
                let number = level - FIRST_LEVEL;
                let reach = (shares.len() / 2 - 1) as u32;
                let table = Table { middle: symbols.len() as u32 + reach, reach, number: number as u8 };
                let starts =
                    shares.iter().scan(0, |start, share| Some(std::mem::replace(start, *start + share)));
                symbols.extend(starts.zip(&shares).map(|(start, share)| Symbol::new(start, *share)));
                places[number] = Places::of(&shares);
                table
            })
            .collect();
        let of_level: [Table; LEVELS] =
            std::array::from_fn(|level| tables[level.saturating_sub(FIRST_LEVEL)]);
        let of_mean: Box<[Table]> = (0..MEANS).map(|mean| of_level[level(mean | 1) as usize]).collect();
        Self {
            of_level,
            number_of_mean: of_mean.iter().map(|table| table.number).collect(),
            of_mean,
            symbols: symbols.into(),
            places,
        }
    }

    /// The table for a mean, where none of the lowest bits are plain.
    #[inline(always)]
    fn of_mean(&self, mean: u64) -> Option<Table> {
        self.of_mean.get(usize::try_from(mean).ok()?).copied()
    }

    /// A table's symbol for a residual; `None` where that escapes.
    #[inline(always)]
    fn symbol(&self, table: Table, residual: i64) -> Option<Symbol> {
        if residual.unsigned_abs() > u64::from(table.reach) {
            return None;
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "one of the table's")]
        self.symbols.get((i64::from(table.middle) + residual) as usize).copied()
    }

    /// That for what escapes.
    fn escape(&self, table: Table) -> Symbol {
        self.symbols[(table.middle + table.reach + 1) as usize]
    }

    /// Where a table's shares lie.
    #[inline(always)]
    fn places(&self, number: u8) -> &Places {
        &self.places[usize::from(number) % TABLES]
    }
}

/// The level of what is more than 0.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "three bits")]
const fn level(value: u64) -> u32 {
    let highest = value.ilog2();
    // Its highest bit is a 4 there.
    4 * highest + (value << 2 >> highest) as u32 - 4
}

/// How large residuals were of late.
#[derive(Debug, Clone, Copy)]
struct Scale {
    sum: u64,
    /// The mean for the next residual, before that of the residual before it.
    mean: u64,
}

impl Scale {
    /// From the level of the mean, at most [`MOST_LEVEL`].
    const fn new(level: u8) -> Self {
        let mean = (4 + level as u64 % 4) << (level / 4) >> 2;
        Self { sum: mean << MEMORY, mean }
    }

    /// The table for the next residual, and how many of its lowest bits are plain.
    #[inline(always)]
    fn next(self, tables: &Tables) -> (Table, u32) {
        match tables.of_mean(self.mean) {
            Some(table) => (table, 0),
            None => self.next_large(tables),
        }
    }

    #[inline(never)]
    fn next_large(self, tables: &Tables) -> (Table, u32) {
        let above = level(self.mean | 1) as usize - LEVELS;
        #[expect(clippy::cast_possible_truncation, reason = "at most 256")]
        (tables.of_level[LEVELS - 4 + above % 4], above as u32 / 4 + 1)
    }

    #[inline(always)]
    fn follow(&mut self, residual: i64) {
        self.follow_small(residual.unsigned_abs().min(MOST_COUNTED));
    }

    /// By the size of a residual that is at most [`MOST_COUNTED`].
    #[inline(always)]
    const fn follow_small(&mut self, size: u64) {
        self.mean = self.sum >> MEMORY;
        self.sum = self.sum - self.mean + (size << FRACTION);
    }
}

/// The level of the mean of the first residuals, which a column begins with.
pub(super) fn first_level(residuals: &[i64]) -> u8 {
    let few = &residuals[..residuals.len().min(TRIED)];
    let sum: u64 = few.iter().map(|residual| residual.unsigned_abs().min(MOST_COUNTED) << FRACTION).sum();
    u8::try_from(level((sum / few.len().max(1) as u64).max(1))).unwrap_or(MOST_LEVEL).min(MOST_LEVEL)
}

/// The law by which the first residuals take fewer bits; of the same the first.
pub(super) fn fitting_law(residuals: &[i64], first_level: u8) -> Law {
    let few = &residuals[..residuals.len().min(TRIED)];
    let (normal, laplace) = (Law::Normal.tables(), Law::Laplace.tables());
    let mut scale = Scale::new(first_level);
    let mut less = 0;
    for &residual in few {
        let share = |tables: &Tables| {
            let (table, plain) = scale.next(tables);
            tables.symbol(table, residual >> plain).unwrap_or_else(|| tables.escape(table)).share()
        };
        // In quarters of a bit.
        less += i64::from(level(share(laplace).into())) - i64::from(level(share(normal).into()));
        scale.follow(residual);
    }
    if less > 0 { Law::Laplace } else { Law::Normal }
}

/// Notes residuals by a law, to be written, in place of what stood there.
pub(super) fn note(symbols: &mut Vec<Symbol>, residuals: &[i64], law: Law, first_level: u8) {
    let tables = law.tables();
    symbols.resize(residuals.len(), Symbol::NONE);
    let (noted, scale) = note_usual(symbols, residuals, tables, Scale::new(first_level));
    symbols.truncate(noted);
    note_rest(symbols, &residuals[noted..], tables, scale);
}

/// Notes residuals as long as they are one symbol each, which those of most columns are to their ends. Says how many they
/// were, and how large of late. A function of its own, so that all it goes by is in registers.
#[inline(never)]
fn note_usual(
    symbols: &mut [Symbol],
    residuals: &[i64],
    tables: &Tables,
    mut scale: Scale,
) -> (usize, Scale) {
    let mut noted = 0;
    for (symbol, &residual) in symbols.iter_mut().zip(residuals) {
        let Some(table) = tables.of_mean(scale.mean) else { break };
        let Some(found) = tables.symbol(table, residual) else { break };
        *symbol = found;
        scale.follow_small(residual.unsigned_abs());
        noted += 1;
    }
    (noted, scale)
}

#[inline(never)]
fn note_rest(symbols: &mut Vec<Symbol>, residuals: &[i64], tables: &Tables, mut scale: Scale) {
    symbols.reserve(residuals.len());
    for &residual in residuals {
        let (table, plain) = scale.next(tables);
        match tables.symbol(table, residual >> plain) {
            Some(symbol) => {
                symbols.push(symbol);
                ans::note_plain(symbols, residual.cast_unsigned(), plain);
            }
            None => note_escape(symbols, tables.escape(table), residual),
        }
        scale.follow(residual);
    }
}

fn note_escape(symbols: &mut Vec<Symbol>, escape: Symbol, residual: i64) {
    symbols.push(escape);
    let residual = zigzag(residual);
    let bits = u64::BITS - residual.leading_zeros();
    ans::note_plain(symbols, u64::from(bits), COUNT);
    ans::note_plain(symbols, residual, bits.saturating_sub(1));
}

/// Reads the residuals of one column.
pub(super) struct NoiseReader<'a> {
    /// Where the next column is read on.
    pub(super) coder: ans::Reader<'a>,
    tables: &'static Tables,
    scale: Scale,
}

impl<'a> NoiseReader<'a> {
    /// `None` where no column begins with such a mean.
    pub(super) fn new(coder: ans::Reader<'a>, law: Law, first_level: u8) -> Option<Self> {
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
            scale.follow_small(residual.unsigned_abs());
            read += 1;
        }
        (self.coder, self.scale) = (coder, scale);
        read
    }
}

impl Residuals for NoiseReader<'_> {
    #[inline(never)]
    fn next(&mut self) -> Option<i64> {
        let (table, plain) = self.scale.next(self.tables);
        let places = self.tables.places(table.number);
        let (symbol, start, share) = places.at(self.coder.place());
        self.coder.take(start, share)?;
        let residual = if symbol == places.escape {
            escaped(&mut self.coder)?
        } else {
            let rest = i64::from(symbol) - i64::from(places.middle);
            rest << plain | self.coder.take_plain(plain)?.cast_signed()
        };
        self.scale.follow(residual);
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
    use proptest::prelude::*;

    fn written(columns: &[(Vec<i64>, Law)]) -> (Vec<u8>, Vec<u8>) {
        let mut writer = ans::Writer::new(0);
        let level = |residuals: &[i64]| first_level(residuals);
        for (residuals, law) in columns.iter().rev() {
            let mut symbols = Vec::new();
            note(&mut symbols, residuals, *law, level(residuals));
            writer.put_before(&symbols);
        }
        let mut out = Vec::new();
        writer.finish(&mut out);
        (out, columns.iter().map(|(residuals, _)| level(residuals)).collect())
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

    proptest! {
        #[test]
        fn what_is_noted_comes_back(columns in prop::collection::vec(column(), 1..4)) {
            let (bytes, levels) = written(&columns);
            let mut coder = ans::Reader::new(&bytes).unwrap();
            for ((residuals, law), level) in columns.iter().zip(levels) {
                let mut reader = NoiseReader::new(coder, *law, level).unwrap();
                let mut together = vec![0; residuals.len()];
                prop_assert_eq!(reader.read(&mut together), Some(()));
                prop_assert_eq!(&together, residuals);
                let mut one_by_one = NoiseReader::new(coder, *law, level).unwrap();
                prop_assert!(residuals.iter().all(|residual| one_by_one.next() == Some(*residual)));
                coder = reader.coder;
                prop_assert_eq!(format!("{coder:?}"), format!("{:?}", one_by_one.coder));
            }
            prop_assert!(coder.is_at_end());
        }

        #[test]
        fn whatever_stands_there_is_read_or_refused(
            bytes in prop::collection::vec(any::<u8>(), 0..200),
            law in prop::sample::select(Law::ALL.as_slice()),
            level in any::<u8>(),
        ) {
            let Some(coder) = ans::Reader::new(&bytes) else { return Ok(()) };
            let reader = NoiseReader::new(coder, law, level);
            prop_assert_eq!(reader.is_some(), level <= MOST_LEVEL);
            let Some(mut reader) = reader else { return Ok(()) };
            // States alone go on for long where all is the likeliest symbol.
            let found: Vec<i64> = std::iter::from_fn(|| reader.next()).take(1_000).collect();
            // Whatever it was, it is a residual that can be written.
            let (mut symbols, mut writer, mut out) = (Vec::new(), ans::Writer::new(0), Vec::new());
            note(&mut symbols, &found, law, level);
            writer.put_before(&symbols);
            writer.finish(&mut out);
            let mut reader = NoiseReader::new(ans::Reader::new(&out).unwrap(), law, level).unwrap();
            prop_assert!(found.iter().all(|residual| reader.next() == Some(*residual)));
            prop_assert!(reader.coder.is_at_end());
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

//! Block format: writing version 6, and reading all versions, which trusts nothing.

use super::column::{Column, Columns, MAX_SCALE, Time};
use super::guide::{self, Following, Guide, Guided, MOST_MEMORY};
use super::habit::{Habit, Predicted, Usual};
use super::input::{Input, MAX_VARINT, put_varint};
use super::noise::{self, Law, NoiseReader, StretchReader, StretchWriter};
use super::predict::{Predictor, Residuals, tried, unzigzag, zigzag};
use super::range::{RangeReader, Zeros};
use super::rice::RiceReader;
use super::squeeze::{compress, decompress};
use super::{ans, checksum};
use crate::error::{StoreError, StoreResult};
use feedwright_core::cycle::{Channel, Samples};

const MAGIC: [u8; 2] = *b"FB";
const FIRST: u8 = 1;
const THIRD: u8 = 3;
const FOURTH: u8 = 4;
const FIFTH: u8 = 5;
const SIXTH: u8 = 6;
/// In the byte that names a column's law: it follows a guide, so that the bits below are a memory and not a predictor.
const GUIDED: u8 = 0x08;
const EXACT: u8 = 15;
const COMPRESSED: u8 = 0x80;
pub(super) const TIMES: u8 = 0;
const CHECKSUM: usize = 8;
/// Channels and times.
const MAX_BLOCKS: usize = 17;
const LEVEL: i32 = 1;

/// How versions 2 and 3 wrote residuals: the high half of a column's first byte, its predictor being the low one.
const RICE: u8 = 0;
const RANGE: u8 = 0x10;

/// Writes samples in block format v6.
pub fn encode_samples(samples: &Samples) -> Vec<u8> {
    encode_columns(&Columns::of(samples))
}

pub(super) fn encode_columns(columns: &Columns) -> Vec<u8> {
    encode_by(columns, &mut Habit::default())
}

/// By how the columns of such blocks were predicted before, where that is known.
pub(super) fn encode_by(columns: &Columns, habit: &mut Habit) -> Vec<u8> {
    let times = match &columns.time {
        Time::Period(_) => None,
        Time::Stamps(column) => Some((TIMES, column)),
    };
    let scale = |column: &Column| column.decimals().map(|(_, scale)| scale);
    let channels = columns.channels.iter().map(|(channel, column)| (*channel as u8, scale(column)));
    let by_habit = habit.suits(times.iter().map(|(code, column)| (*code, scale(column))).chain(channels));
    let usual = |code| if by_habit { habit.usual(code) } else { None };
    let guided = guide::choose(columns, |channel| usual(channel as u8));
    let channels = columns.channels.iter().zip(&guided);
    let all: Vec<(u8, &Column, Option<&Guided>)> = times
        .into_iter()
        .map(|(code, column)| (code, column, None))
        .chain(channels.map(|((channel, column), guided)| (*channel as u8, column, guided.as_ref())))
        .collect();
    // What is read last is written first.
    let mut residuals = ResidualsWriter::new(columns.len * all.len());
    let mut coded: Vec<(Option<Coded>, usize)> = vec![(None, 0); all.len()];
    let guide_of = |at: &usize| all[*at].2.map(|guided| guided.following.guide);
    for at in read_in_order(all.len(), guide_of).into_iter().rev() {
        let (code, column, guided) = all[at];
        let before = residuals.coder.len();
        coded[at].0 = residuals.code(column, guided, usual(code));
        coded[at].1 = residuals.coder.len() - before;
    }
    #[expect(clippy::cast_precision_loss, reason = "bits of a value, about")]
    let bits_a_value = |bytes: usize| 8.0 * bytes as f32 / columns.len as f32;
    let found = all.iter().zip(&coded).map(|((code, column, _), (coded, bytes))| Predicted {
        code: *code,
        scale: scale(column),
        way: coded.map(|coded| (coded.way, coded.law.map(|(law, _)| law))),
        bits_a_value: bits_a_value(*bytes),
    });
    if by_habit {
        habit.hold(found);
    } else {
        habit.follow(found);
    }
    let has_law = coded.iter().any(|(coded, _)| coded.is_some_and(|coded| coded.law.is_some()));
    let mut out = Vec::with_capacity(HEAD + COLUMN_HEAD * all.len() + residuals.coder.len() + CHECKSUM);
    out.extend_from_slice(&MAGIC);
    out.push(SIXTH);
    put_varint(&mut out, columns.len as u64);
    out.push(u8::try_from(all.len()).unwrap_or(u8::MAX));
    match &columns.time {
        Time::Period(bits) => {
            out.push(0);
            out.extend_from_slice(&bits.to_le_bytes());
        }
        Time::Stamps(_) => out.push(1),
    }
    for ((code, column, _), (coded, _)) in all.iter().zip(coded) {
        out.push(*code);
        match (column, coded) {
            (Column::Exact(bits), _) => put_exact(&mut out, &planes(bits)),
            (Column::Decimal { scale, .. }, coded) => {
                out.push(*scale);
                coded.into_iter().for_each(|coded| coded.put_head(&mut out));
            }
        }
    }
    if has_law {
        residuals.coder.finish(&mut out);
    }
    let checksum = checksum::<CHECKSUM>(&out);
    out.extend_from_slice(&checksum);
    out
}

/// The places of columns in the order in which their residuals are read: what a column follows is there before it.
fn read_in_order(columns: usize, guide_of: impl Fn(&usize) -> Option<Guide>) -> Vec<usize> {
    let mut order: Vec<usize> = (0..columns).collect();
    order.sort_by_key(|at| Guide::order(guide_of(at)));
    order
}

/// Most bytes before the first column, and of a decimal column's head.
const HEAD: usize = 24;
const COLUMN_HEAD: usize = 6 + 2 * MAX_VARINT;

/// Residuals of a block, written from the last column to the first.
struct ResidualsWriter {
    coder: ans::Writer,
    of_column: Vec<i64>,
    writer: StretchWriter,
}

/// How a decimal column is written, and its first value; no law where nothing is off its prediction.
#[derive(Debug, Clone, Copy)]
struct Coded {
    way: Way,
    first: i64,
    law: Option<(Law, u8)>,
}

/// How a column is predicted.
#[derive(Debug, Clone, Copy)]
pub(super) enum Way {
    Alone(Predictor),
    Guided(Following),
}

impl Way {
    /// Puts values back together behind the first, with what a guide has said of them, if there is one; `None` where a residual
    /// is missing.
    fn restore<R: Residuals>(self, said: &[i64], values: &mut [i64], reader: R) -> Option<R> {
        match self {
            Self::Alone(predictor) => predictor.restore(values, reader),
            Self::Guided(following) => following.restore(said, values, reader),
        }
    }
}

impl ResidualsWriter {
    fn new(values: usize) -> Self {
        // Most take a few bits.
        Self { coder: ans::Writer::new(values / 4), of_column: Vec::new(), writer: StretchWriter::default() }
    }

    /// Writes the residuals of a column of decimals; by the usual law where that is known, and the usual predictor where it has no
    /// guide.
    fn code(&mut self, column: &Column, guided: Option<&Guided>, usual: Option<Usual>) -> Option<Coded> {
        let Column::Decimal { values, .. } = column else { return None };
        let &first = values.first()?;
        let Self { coder, of_column, writer } = self;
        let (way, residuals) = match guided {
            Some(guided) => (Way::Guided(guided.following), &guided.residuals),
            None => {
                let predictor = match usual {
                    Some(Usual { way: Way::Alone(predictor), is_settled: true, .. }) => predictor,
                    _ => Predictor::best(values, tried(values.len())).0,
                };
                predictor.residuals(values, of_column);
                (Way::Alone(predictor), &*of_column)
            }
        };
        if residuals.iter().fold(0, |any, residual| any | residual) == 0 {
            return Some(Coded { way, first, law: None });
        }
        let level = noise::first_level(residuals);
        let law = usual.and_then(|usual| usual.law).unwrap_or_else(|| noise::fitting_law(residuals, level));
        writer.put_before(coder, residuals, law, level);
        Some(Coded { way, first, law: Some((law, level)) })
    }
}

impl Coded {
    fn put_head(self, out: &mut Vec<u8>) {
        let law = self.law.map_or(0, |(law, _)| law as u8) << 4;
        match self.way {
            Way::Alone(predictor) => out.push(predictor as u8 | law),
            Way::Guided(Following { guide, memory }) => {
                out.push(memory | GUIDED | law);
                let (code, factor) = guide.code();
                out.push(code);
                factor.into_iter().for_each(|factor| put_varint(out, zigzag(factor)));
            }
        }
        put_varint(out, zigzag(self.first));
        out.extend(self.law.map(|(_, level)| level));
    }
}

fn put_exact(out: &mut Vec<u8>, plain: &[u8]) {
    match compress(plain, LEVEL).filter(|packed| packed.len() < plain.len()) {
        Some(packed) => {
            out.push(EXACT | COMPRESSED);
            put_varint(out, plain.len() as u64);
            put_varint(out, packed.len() as u64);
            out.extend_from_slice(&packed);
        }
        None => {
            out.push(EXACT);
            put_varint(out, plain.len() as u64);
            out.extend_from_slice(plain);
        }
    }
}

fn planes(bits: &[u64]) -> Vec<u8> {
    let mut out = Vec::with_capacity(bits.len() * 8);
    for plane in 0..8 {
        out.extend(bits.iter().map(|bits| bits.to_le_bytes()[plane]));
    }
    out
}

/// Reads block formats v1 to v6. Refuses what is damaged, of another version, or above `max_samples`; allocates no more
/// than that many values per channel whatever the bytes claim.
pub fn decode_samples(bytes: &[u8], max_samples: usize) -> StoreResult<Samples> {
    decode_columns(bytes, max_samples)?.into_samples()
}

/// As [`decode_samples`], to the columns as they are stored. Their values are not held against what their channels can
/// measure: they were before they were stored, and the checksum holds.
pub fn decode_columns(bytes: &[u8], max_samples: usize) -> StoreResult<Columns> {
    read(bytes, max_samples).map_err(damaged)
}

pub(super) fn damaged(what: &str) -> StoreError {
    StoreError::Damaged { what: format!("sample block: {what}") }
}

fn read(bytes: &[u8], max_samples: usize) -> Result<Columns, &'static str> {
    let end = bytes.len().checked_sub(CHECKSUM).ok_or("too short")?;
    let (body, sum) = bytes.split_at(end);
    if checksum::<CHECKSUM>(body) != sum {
        return Err("checksum differs");
    }
    read_body(body, max_samples)
}

fn read_body(body: &[u8], max_samples: usize) -> Result<Columns, &'static str> {
    let mut input = Input(body);
    if input.take(MAGIC.len())? != MAGIC {
        return Err("not a sample block");
    }
    let version = input.byte()?;
    if !(FIRST..=SIXTH).contains(&version) {
        return Err("not block format v1 to v6");
    }
    let len = input.length()?;
    if len == 0 || len > max_samples {
        return Err("number of samples out of bounds");
    }
    let blocks = usize::from(input.byte()?);
    if blocks == 0 || blocks > MAX_BLOCKS {
        return Err("number of blocks out of bounds");
    }
    let (time, count) = match input.byte()? {
        0 => {
            let bits = input.take(8)?.try_into().map_err(|_| "too short")?;
            (PendingTime::Period(u64::from_le_bytes(bits)), blocks)
        }
        1 => {
            if input.byte()? != TIMES {
                return Err("times are missing");
            }
            (PendingTime::Stamps(input.column((version, None), len)?), blocks - 1)
        }
        _ => return Err("unknown time base"),
    };
    let mut channels = Vec::with_capacity(count);
    for _ in 0..count {
        let channel = Channel::from_code(input.byte()?).ok_or("unknown channel")?;
        if channels.last().is_some_and(|(before, _)| *before >= channel) {
            return Err("channels out of order");
        }
        channels.push((channel, input.column((version, Some(channel)), len)?));
    }
    let mut coder = None;
    let time = match time {
        PendingTime::Period(bits) => Time::Period(bits),
        PendingTime::Stamps(column) => Time::Stamps(column.read(version, &mut coder, &mut input, |_| None)?),
    };
    let order = read_in_order(channels.len(), |at| channels[*at].1.guide());
    let (names, mut pending): (Vec<Channel>, Vec<_>) =
        channels.into_iter().map(|(channel, column)| (channel, Some(column))).unzip();
    let mut read: Vec<Option<Column>> = names.iter().map(|_| None).collect();
    for at in order {
        let there = |wanted| read[names.iter().position(|name| *name == wanted)?].as_ref();
        let column = pending[at]
            .take()
            .map(|column| column.read(version, &mut coder, &mut input, there))
            .transpose()?;
        read[at] = column;
    }
    let channels =
        names.into_iter().zip(read).filter_map(|(channel, column)| Some((channel, column?))).collect();
    if !input.0.is_empty() || coder.is_some_and(|coder| !coder.is_at_end()) {
        return Err("trailing bytes");
    }
    Ok(Columns { len, time, channels })
}

/// As [`Time`], with a column whose residuals are to be read.
enum PendingTime {
    Period(u64),
    Stamps(Pending),
}

/// A column that is read, or of version 4 to 6 its head: its residuals stand behind all heads.
enum Pending {
    Whole(Column),
    Headed { scale: u8, coded: Coded, len: usize },
}

impl Pending {
    const fn guide(&self) -> Option<Guide> {
        match self {
            Self::Headed { coded: Coded { way: Way::Guided(following), .. }, .. } => Some(following.guide),
            Self::Headed { .. } | Self::Whole(_) => None,
        }
    }

    /// The column; `there` are those that it may follow.
    fn read<'a, 'c>(
        self,
        version: u8,
        coder: &mut Option<ans::Reader<'a>>,
        input: &mut Input<'a>,
        there: impl Fn(Channel) -> Option<&'c Column>,
    ) -> Result<Column, &'static str> {
        let (scale, coded, len) = match self {
            Self::Whole(column) => return Ok(column),
            Self::Headed { scale, coded, len } => (scale, coded, len),
        };
        // `len` is within the reader's limit.
        let mut values = vec![0; len];
        *values.first_mut().ok_or("no values")? = coded.first;
        let said = match coded.way {
            Way::Alone(_) => Vec::new(),
            Way::Guided(following) => {
                following.guide.says(there, scale).ok_or("what a column follows is not there")?
            }
        };
        match coded.law {
            None => {
                coded.way.restore(&said, &mut values, Zeros).ok_or("a column ends early")?;
            }
            Some((law, level)) => {
                let begun = match *coder {
                    Some(coder) => coder,
                    None => ans::Reader::new(std::mem::take(&mut input.0)).ok_or("residuals are missing")?,
                };
                let read = if version >= SIXTH {
                    let reader = StretchReader::new(begun, law, level).ok_or("unknown mean")?;
                    coded.way.restore(&said, &mut values, reader).map(|reader| reader.coder)
                } else {
                    let reader = NoiseReader::new(begun, law, level).ok_or("unknown mean")?;
                    coded.way.restore(&said, &mut values, reader).map(|reader| reader.coder)
                };
                *coder = Some(read.ok_or("a column ends early")?);
            }
        }
        Ok(Column::Decimal { scale, values })
    }
}

impl Input<'_> {
    /// A column of a channel, or of times.
    fn column(
        &mut self,
        (version, channel): (u8, Option<Channel>),
        len: usize,
    ) -> Result<Pending, &'static str> {
        let form = self.byte()?;
        if version >= FOURTH && form <= MAX_SCALE {
            let may_follow = channel.filter(|_| version >= FIFTH);
            return Ok(Pending::Headed { scale: form, coded: self.coded(may_follow)?, len });
        }
        self.whole_column((version, form), len).map(Pending::Whole)
    }

    /// How a decimal column of version 4 to 6 is written.
    fn coded(&mut self, may_follow: Option<Channel>) -> Result<Coded, &'static str> {
        let coding = self.byte()?;
        let way = match may_follow.filter(|_| coding & GUIDED != 0) {
            Some(channel) => {
                Way::Guided(Following { guide: self.guide(channel)?, memory: coding & MOST_MEMORY })
            }
            None => Way::Alone(Predictor::from_code(coding & 0x0f).ok_or("unknown predictor")?),
        };
        let first = unzigzag(self.varint()?);
        let law = match coding >> 4 {
            0 => None,
            law => Some((Law::from_code(law).ok_or("unknown coding")?, self.byte()?)),
        };
        Ok(Coded { way, first, law })
    }

    fn guide(&mut self, channel: Channel) -> Result<Guide, &'static str> {
        let code = self.byte()?;
        Guide::of_code(channel, code, || self.varint().ok().map(unzigzag)).ok_or("unknown guide")
    }

    fn whole_column(&mut self, (version, form): (u8, u8), len: usize) -> Result<Column, &'static str> {
        if version != FIRST && form <= MAX_SCALE {
            let stored = self.length()?;
            return restored(self.take(stored)?, len, (version, form));
        }
        let (compressed, form) = (form & COMPRESSED != 0, form & !COMPRESSED);
        let plain_length = self.length()?;
        // `len` is within the reader's limit, and so is every allocation below.
        let fits = match form {
            0..=MAX_SCALE if version == FIRST => (len..=len * MAX_VARINT).contains(&plain_length),
            EXACT => plain_length == len * 8,
            _ => return Err("unknown form"),
        };
        if !fits {
            return Err("length of a block out of bounds");
        }
        let unpacked;
        let plain = if compressed {
            let stored = self.length()?;
            unpacked = decompress(self.take(stored)?, plain_length)?;
            unpacked.as_slice()
        } else {
            self.take(plain_length)?
        };
        if form == EXACT { Ok(Column::Exact(unplanes(plain, len))) } else { undeltas(plain, len, form) }
    }
}

/// A decimal column of version 2 or 3. `len` is within the reader's limit.
fn restored(packed: &[u8], len: usize, (version, scale): (u8, u8)) -> Result<Column, &'static str> {
    let mut input = Input(packed);
    let coding = input.byte()?;
    let predictor = Predictor::from_code(coding & 0x0f)
        .filter(|predictor| version >= THIRD || !predictor.is_fit())
        .ok_or("unknown predictor")?;
    // Blocks were written in which a column of nothing but zeros had lost the zero that it begins with.
    let all_zero = coding & 0xf0 == RANGE && input.0.is_empty();
    let first = if all_zero { 0 } else { unzigzag(input.varint()?) };
    let mut values = vec![0; len];
    *values.first_mut().ok_or("no values")? = first;
    let ended = match coding & 0xf0 {
        RICE => {
            let reader = RiceReader::of(input.byte()?, input.0).ok_or("unknown parameter")?;
            predictor.restore(&mut values, reader).ok_or("a column ends early")?.is_at_end()
        }
        RANGE if input.0.is_empty() => predictor.restore(&mut values, Zeros).is_some(),
        RANGE => {
            let reader = RangeReader::new(input.0);
            predictor.restore(&mut values, reader).ok_or("a column ends early")?.is_at_end()
        }
        _ => return Err("unknown coding"),
    };
    if ended { Ok(Column::Decimal { scale, values }) } else { Err("trailing bytes in a column") }
}

/// A decimal column of version 1.
fn undeltas(plain: &[u8], len: usize, scale: u8) -> Result<Column, &'static str> {
    let mut input = Input(plain);
    let mut values = Vec::with_capacity(len);
    let mut value = 0_i64;
    for _ in 0..len {
        let zigzag = input.varint()?;
        value = value.wrapping_add(unzigzag(zigzag));
        values.push(value);
    }
    if input.0.is_empty() { Ok(Column::Decimal { scale, values }) } else { Err("trailing bytes in a block") }
}

fn unplanes(plain: &[u8], len: usize) -> Vec<u64> {
    (0..len)
        .map(|index| {
            let mut bytes = [0; 8];
            for (plane, byte) in bytes.iter_mut().enumerate() {
                *byte = plain[plane * len + index];
            }
            u64::from_le_bytes(bytes)
        })
        .collect()
}

#[cfg(test)]
pub(crate) mod tests;

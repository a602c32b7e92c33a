//! Block format: writing version 3, and reading all versions, which trusts nothing.

use super::column::{Column, Columns, MAX_SCALE, Time};
use super::input::{Input, MAX_VARINT, put_varint};
use super::predict::{Predictor, unzigzag, zigzag};
use super::range::{self, RangeReader, Zeros};
use super::rice::{self, RiceReader};
use crate::error::{StoreError, StoreResult};
use feedwright_core::cycle::{Channel, Samples};
use std::cell::RefCell;
use std::mem;

const MAGIC: [u8; 2] = *b"FB";
const FIRST: u8 = 1;
const THIRD: u8 = 3;
const EXACT: u8 = 15;
const COMPRESSED: u8 = 0x80;
const TIMES: u8 = 0;
const CHECKSUM: usize = 8;
/// Channels and times.
const MAX_BLOCKS: usize = 17;
const LEVEL: i32 = 1;

thread_local! {
    // A context allocates some hundred kilobytes: making one per block costs more than compressing it.
    static COMPRESSOR: RefCell<Option<zstd::bulk::Compressor<'static>>> = const { RefCell::new(None) };
    static DECOMPRESSOR: RefCell<Option<zstd::bulk::Decompressor<'static>>> = const { RefCell::new(None) };
}

/// How residuals are written: the high half of a column's first byte, its predictor being the low one.
const RICE: u8 = 0;
const RANGE: u8 = 0x10;

/// Writes samples in block format v3.
pub fn encode_samples(samples: &Samples) -> Vec<u8> {
    encode_columns(&Columns::of(samples))
}

pub(super) fn encode_columns(columns: &Columns) -> Vec<u8> {
    let mut out = Vec::with_capacity(64 + columns.len * columns.channels.len());
    out.extend_from_slice(&MAGIC);
    out.push(THIRD);
    put_varint(&mut out, columns.len as u64);
    let stamps = usize::from(matches!(columns.time, Time::Stamps(_)));
    out.push(u8::try_from(columns.channels.len() + stamps).unwrap_or(u8::MAX));
    match &columns.time {
        Time::Period(bits) => {
            out.push(0);
            out.extend_from_slice(&bits.to_le_bytes());
        }
        Time::Stamps(column) => {
            out.push(1);
            put_block(&mut out, TIMES, column);
        }
    }
    for (channel, column) in &columns.channels {
        put_block(&mut out, *channel as u8, column);
    }
    let checksum = checksum(&out);
    out.extend_from_slice(&checksum);
    out
}

fn checksum(bytes: &[u8]) -> [u8; CHECKSUM] {
    let hash = blake3::hash(bytes);
    let mut first = [0; CHECKSUM];
    first.copy_from_slice(&hash.as_bytes()[..CHECKSUM]);
    first
}

fn put_block(out: &mut Vec<u8>, code: u8, column: &Column) {
    out.push(code);
    match column {
        Column::Decimal { scale, values } => {
            out.push(*scale);
            put_behind_length(out, |out| put_residuals(out, values));
        }
        Column::Exact(bits) => put_exact(out, &planes(bits)),
    }
}

/// What `put` appends, behind its length.
fn put_behind_length(out: &mut Vec<u8>, put: impl FnOnce(&mut Vec<u8>)) {
    let begins = out.len();
    put(out);
    let ends = out.len();
    put_varint(out, (ends - begins) as u64);
    // To where it belongs: that is less than to write the rest elsewhere and copy it.
    let length = out.len() - ends;
    out[begins..].rotate_right(length);
}

fn put_exact(out: &mut Vec<u8>, plain: &[u8]) {
    match compress(plain).filter(|packed| packed.len() < plain.len()) {
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

/// The payload of a decimal column: how it is coded, its first value, and how far each other one is off.
fn put_residuals(out: &mut Vec<u8>, values: &[i64]) {
    let (Some(&first), predictor) = (values.first(), Predictor::best(values)) else { return };
    let mut residuals = Vec::new();
    predictor.residuals(values, &mut residuals);
    let sure = are_sure(&residuals);
    out.push(predictor as u8 | if sure { RANGE } else { RICE });
    put_varint(out, zigzag(first));
    *out = if sure {
        range::write(mem::take(out), &residuals)
    } else {
        let bits = rice::usual_bits(&residuals);
        out.push(bits);
        rice::write(mem::take(out), &residuals, rice::Parameter::new(bits))
    };
}

/// Whether the mean of residuals, zig-zag, is no more than 5/4: these go to the range coder, as a Rice code spends a bit on
/// each, however sure it is. Above it noise of a feed rate takes a fourteenth more by a Rice code, and far less time.
fn are_sure(residuals: &[u64]) -> bool {
    let most = (residuals.len() + residuals.len() / 4) as u64;
    let mut sum = 0_u64;
    // Noise is told from its first values. Eight residuals of decimals do not overflow.
    residuals.chunks(8).all(|residuals| {
        sum = sum.saturating_add(residuals.iter().sum());
        sum <= most
    })
}

/// `None` where zstd fails, which it does for want of memory only: the block is then stored as it is.
fn compress(plain: &[u8]) -> Option<Vec<u8>> {
    COMPRESSOR.with_borrow_mut(|slot| {
        if slot.is_none() {
            *slot = zstd::bulk::Compressor::new(LEVEL).ok();
        }
        slot.as_mut()?.compress(plain).ok()
    })
}

fn planes(bits: &[u64]) -> Vec<u8> {
    let mut out = Vec::with_capacity(bits.len() * 8);
    for plane in 0..8 {
        out.extend(bits.iter().map(|bits| bits.to_le_bytes()[plane]));
    }
    out
}

/// Reads block formats v1 to v3. Refuses what is damaged, of another version, or above `max_samples`; allocates no more
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
    if checksum(body) != sum {
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
    if !(FIRST..=THIRD).contains(&version) {
        return Err("not block format v1, v2 or v3");
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
            (Time::Period(u64::from_le_bytes(bits)), blocks)
        }
        1 => {
            if input.byte()? != TIMES {
                return Err("times are missing");
            }
            (Time::Stamps(input.column(version, len)?), blocks - 1)
        }
        _ => return Err("unknown time base"),
    };
    let mut channels = Vec::with_capacity(count);
    for _ in 0..count {
        let channel = Channel::from_code(input.byte()?).ok_or("unknown channel")?;
        if channels.last().is_some_and(|(before, _)| *before >= channel) {
            return Err("channels out of order");
        }
        channels.push((channel, input.column(version, len)?));
    }
    if !input.0.is_empty() {
        return Err("trailing bytes");
    }
    Ok(Columns { len, time, channels })
}

impl Input<'_> {
    fn column(&mut self, version: u8, len: usize) -> Result<Column, &'static str> {
        let form = self.byte()?;
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

fn decompress(packed: &[u8], plain_length: usize) -> Result<Vec<u8>, &'static str> {
    DECOMPRESSOR.with_borrow_mut(|slot| {
        if slot.is_none() {
            *slot = zstd::bulk::Decompressor::new().ok();
        }
        let decompressor = slot.as_mut().ok_or("no memory to decompress")?;
        let mut plain = Vec::with_capacity(plain_length);
        // Writes into the capacity and no further: a bomb fails.
        decompressor.decompress_to_buffer(packed, &mut plain).map_err(|_| "not decompressible")?;
        if plain.len() == plain_length { Ok(plain) } else { Err("length differs after decompression") }
    })
}

/// A decimal column since version 2. `len` is within the reader's limit.
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

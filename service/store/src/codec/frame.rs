//! Block format v1: writing, and reading that trusts nothing.

use super::column::{Column, Columns, MAX_SCALE, Time};
use crate::error::{StoreError, StoreResult};
use feedwright_core::cycle::{Channel, Samples, TimeBase};
use std::cell::RefCell;

const MAGIC: [u8; 3] = *b"FB\x01";
const EXACT: u8 = 15;
const COMPRESSED: u8 = 0x80;
const TIMES: u8 = 0;
const CHECKSUM: usize = 8;
/// Channels and times.
const MAX_BLOCKS: usize = 17;
/// Longest varint of a 64-bit integer.
const MAX_VARINT: usize = 10;
const LEVEL: i32 = 1;

thread_local! {
    // A context allocates some hundred kilobytes: making one per block costs more than compressing it.
    static COMPRESSOR: RefCell<Option<zstd::bulk::Compressor<'static>>> = const { RefCell::new(None) };
    static DECOMPRESSOR: RefCell<Option<zstd::bulk::Decompressor<'static>>> = const { RefCell::new(None) };
}

/// Writes samples in block format v1.
pub fn encode_samples(samples: &Samples) -> Vec<u8> {
    encode_columns(&Columns::of(samples))
}

pub(super) fn encode_columns(columns: &Columns) -> Vec<u8> {
    let mut out = Vec::with_capacity(64 + columns.len * columns.channels.len());
    out.extend_from_slice(&MAGIC);
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
    let (form, plain) = match column {
        Column::Decimal { scale, values } => (*scale, deltas(values)),
        Column::Exact(bits) => (EXACT, planes(bits)),
    };
    out.push(code);
    match compress(&plain).filter(|packed| packed.len() < plain.len()) {
        Some(packed) => {
            out.push(form | COMPRESSED);
            put_varint(out, plain.len() as u64);
            put_varint(out, packed.len() as u64);
            out.extend_from_slice(&packed);
        }
        None => {
            out.push(form);
            put_varint(out, plain.len() as u64);
            out.extend_from_slice(&plain);
        }
    }
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

fn deltas(values: &[i64]) -> Vec<u8> {
    let mut out = Vec::with_capacity(values.len() * 2);
    let mut before = 0_i64;
    for &value in values {
        // Both are below 2^53: the difference cannot overflow.
        let delta = value - before;
        put_varint(&mut out, ((delta << 1) ^ (delta >> 63)).cast_unsigned());
        before = value;
    }
    out
}

fn planes(bits: &[u64]) -> Vec<u8> {
    let mut out = Vec::with_capacity(bits.len() * 8);
    for plane in 0..8 {
        out.extend(bits.iter().map(|bits| bits.to_le_bytes()[plane]));
    }
    out
}

#[expect(clippy::cast_possible_truncation, reason = "seven bits at a time")]
fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Reads block format v1. Refuses what is damaged, of another version, or above `max_samples`; allocates no more
/// than that many values per channel whatever the bytes claim.
pub fn decode_samples(bytes: &[u8], max_samples: usize) -> StoreResult<Samples> {
    read(bytes, max_samples).map_err(|what| StoreError::Damaged { what: format!("sample block: {what}") })
}

fn read(bytes: &[u8], max_samples: usize) -> Result<Samples, &'static str> {
    let end = bytes.len().checked_sub(CHECKSUM).ok_or("too short")?;
    let (body, sum) = bytes.split_at(end);
    if checksum(body) != sum {
        return Err("checksum differs");
    }
    read_body(body, max_samples)
}

fn read_body(body: &[u8], max_samples: usize) -> Result<Samples, &'static str> {
    let mut input = Input(body);
    if input.take(MAGIC.len())? != MAGIC {
        return Err("not block format v1");
    }
    let len = input.length()?;
    if len == 0 || len > max_samples {
        return Err("number of samples out of bounds");
    }
    let blocks = usize::from(input.byte()?);
    if blocks == 0 || blocks > MAX_BLOCKS {
        return Err("number of blocks out of bounds");
    }
    let (time, channels) = match input.byte()? {
        0 => {
            let bits = input.take(8)?.try_into().map_err(|_| "too short")?;
            (TimeBase::Period { period_ms: f64::from_le_bytes(bits) }, blocks)
        }
        1 => {
            if input.byte()? != TIMES {
                return Err("times are missing");
            }
            (TimeBase::Stamps { time_ms: input.column(len)?.into_values() }, blocks - 1)
        }
        _ => return Err("unknown time base"),
    };
    let mut columns = Vec::with_capacity(channels);
    for _ in 0..channels {
        let channel = Channel::from_code(input.byte()?).ok_or("unknown channel")?;
        columns.push((channel, input.column(len)?.into_values()));
    }
    if !input.0.is_empty() {
        return Err("trailing bytes");
    }
    Samples::new(time, columns, max_samples).map_err(|_| "values out of range")
}

struct Input<'a>(&'a [u8]);

impl<'a> Input<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], &'static str> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or("too short")?;
        self.0 = rest;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, &'static str> {
        Ok(self.take(1)?[0])
    }

    fn varint(&mut self) -> Result<u64, &'static str> {
        let mut value = 0_u64;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            let bits = u64::from(byte & 0x7f);
            if shift == 63 && bits > 1 {
                return Err("varint overflows");
            }
            value |= bits << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err("varint overflows")
    }

    fn length(&mut self) -> Result<usize, &'static str> {
        usize::try_from(self.varint()?).map_err(|_| "length overflows")
    }

    fn column(&mut self, len: usize) -> Result<Column, &'static str> {
        let form = self.byte()?;
        let (compressed, form) = (form & COMPRESSED != 0, form & !COMPRESSED);
        let plain_length = self.length()?;
        // `len` is within the reader's limit, and so is every allocation below.
        let fits = match form {
            0..=MAX_SCALE => (len..=len * MAX_VARINT).contains(&plain_length),
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

fn undeltas(plain: &[u8], len: usize, scale: u8) -> Result<Column, &'static str> {
    let mut input = Input(plain);
    let mut values = Vec::with_capacity(len);
    let mut value = 0_i64;
    for _ in 0..len {
        let zigzag = input.varint()?;
        let delta = (zigzag >> 1).cast_signed() ^ -(zigzag & 1).cast_signed();
        value = value.wrapping_add(delta);
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
pub(super) mod tests;

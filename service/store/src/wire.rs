//! The binary body of a cycle, `application/vnd.feedwright.cycle`: an encoder to copy from, and the decoder.
//!
//! `docs/cycle-format.md` lays it out byte by byte; `deploy/python/feedwright_cycle.py` writes the same bytes. Here is
//! only the form: what the fields may hold is checked where JSON's are. Integers are little-endian.

mod read;

pub use read::{Post, PostedSamples, WireError, cycle_id_of, frames, read};

use crate::codec::canonical_column;
use feedwright_core::cycle::{Cycle, Outcome, TimeBase};

/// The media type.
pub const MEDIA_TYPE: &str = "application/vnd.feedwright.cycle";
/// What every frame begins with: three letters and the version.
pub const MAGIC: [u8; 4] = *b"FWC\x01";
/// Bytes before the payload: [`MAGIC`] and the payload's length.
pub const HEAD: usize = 8;
/// Bytes after the payload: CRC-32 (IEEE 802.3, as zlib's) over everything before.
pub const CHECKSUM: usize = 4;
/// Form of a column of plain 64-bit floats; 0 to 9 are decimals of so many places.
const FLOATS: u8 = 15;

/// Bits of the fields that may be left out, in the order in which they follow.
#[derive(Debug, Clone, Copy)]
#[repr(u8)]
enum Field {
    Seq = 0,
    Process = 1,
    Strategy = 2,
    LawVersion = 3,
    Profile = 4,
    Recommendation = 5,
    SpindleSpeed = 6,
    Outcome = 7,
    Samples = 8,
    Reported = 9,
    ReferenceCycle = 10,
    NoReferenceCycle = 11,
}

/// Bits that a payload may have set.
const KNOWN_FIELDS: u32 = (1 << 12) - 1;
/// Values that a control may report.
const REPORTED: usize = 13;

/// Writes a cycle as one frame; its machine is named by the address it is posted to. A batch is frame after frame.
pub fn encode(cycle: &Cycle) -> Vec<u8> {
    let mut out = Vec::with_capacity(256 + cycle.samples.as_ref().map_or(0, |samples| samples.len() * 20));
    out.extend_from_slice(&MAGIC);
    out.extend_from_slice(&[0; 4]);
    put_payload(&mut out, cycle);
    let length = u32::try_from(out.len() - HEAD).unwrap_or(u32::MAX);
    out[4..HEAD].copy_from_slice(&length.to_le_bytes());
    let sum = crc32fast::hash(&out);
    out.extend_from_slice(&sum.to_le_bytes());
    out
}

fn put_payload(out: &mut Vec<u8>, cycle: &Cycle) {
    let reported: Vec<Option<f64>> = {
        let (fields, cut) = (cycle.reported.fields(), cycle.reported.cut.fields());
        fields.into_iter().chain(cut).map(|(_, _, value)| value).collect()
    };
    let fields = [
        (Field::Seq, cycle.seq.is_some()),
        (Field::Process, cycle.process.is_some()),
        (Field::Strategy, cycle.strategy.is_some()),
        (Field::LawVersion, cycle.law_version.is_some()),
        (Field::Profile, cycle.profile.is_some()),
        (Field::Recommendation, cycle.recommendation.is_some()),
        (Field::SpindleSpeed, cycle.spindle_speed_rpm.is_some()),
        (Field::Outcome, cycle.outcome != Outcome::Completed),
        (Field::Samples, cycle.samples.is_some()),
        (Field::Reported, reported.iter().any(Option::is_some)),
        (Field::ReferenceCycle, cycle.reference == Some(true)),
        (Field::NoReferenceCycle, cycle.reference == Some(false)),
    ];
    let set = fields.iter().fold(0_u32, |set, (field, there)| set | u32::from(*there) << (*field as u8));
    out.extend_from_slice(&set.to_le_bytes());
    put_text(out, cycle.id.as_str());
    put_text(out, cycle.tool.as_str());
    put_text(out, cycle.operation.as_str());
    out.extend_from_slice(&cycle.started_at.micros().to_le_bytes());
    if let Some(seq) = cycle.seq {
        out.extend_from_slice(&seq.to_le_bytes());
    }
    if let Some(process) = cycle.process {
        put_text(out, process.as_str());
    }
    if let Some(strategy) = cycle.strategy {
        put_text(out, strategy.as_str());
    }
    if let Some(law_version) = &cycle.law_version {
        put_text(out, law_version);
    }
    if let Some(profile) = &cycle.profile {
        put_text(out, profile.profile.as_str());
        out.extend_from_slice(&profile.version.to_le_bytes());
    }
    if let Some(recommendation) = &cycle.recommendation {
        put_text(out, recommendation.as_str());
    }
    if let Some(speed) = cycle.spindle_speed_rpm {
        out.extend_from_slice(&speed.to_le_bytes());
    }
    if cycle.outcome != Outcome::Completed {
        put_text(out, cycle.outcome.as_str());
    }
    if let Some(samples) = &cycle.samples {
        match samples.time() {
            TimeBase::Period { period_ms } => {
                out.push(0);
                out.extend_from_slice(&period_ms.to_le_bytes());
            }
            TimeBase::Stamps { .. } => out.push(1),
        }
        out.extend_from_slice(&u32::try_from(samples.len()).unwrap_or(u32::MAX).to_le_bytes());
        if let TimeBase::Stamps { time_ms } = samples.time() {
            put_column(out, time_ms);
        }
        out.push(u8::try_from(samples.columns().count()).unwrap_or(u8::MAX));
        for (channel, values) in samples.columns() {
            out.push(channel as u8);
            put_column(out, values);
        }
    }
    if reported.iter().any(Option::is_some) {
        let there = |(bit, value): (usize, &Option<f64>)| u16::from(value.is_some()) << bit;
        let set = reported.iter().enumerate().map(there).fold(0_u16, |set, bit| set | bit);
        out.extend_from_slice(&set.to_le_bytes());
        for value in reported.iter().flatten() {
            out.extend_from_slice(&value.to_le_bytes());
        }
    }
}

/// A length in one byte and the text. Ids have at most 128 bytes; a law version that is longer than 255 is not taken in.
fn put_text(out: &mut Vec<u8>, text: &str) {
    out.push(u8::try_from(text.len()).unwrap_or(u8::MAX));
    out.extend_from_slice(text.as_bytes());
}

/// The smallest number of places that all values have, and each one's difference to the one before as a zig-zag
/// varint; where they are no decimals of up to 9 places, the floats themselves.
fn put_column(out: &mut Vec<u8>, values: &[f64]) {
    match canonical_column(values) {
        Some((places, integers)) => {
            out.push(places);
            let mut before = 0;
            for integer in integers {
                let difference: i64 = integer - before;
                put_varint(out, ((difference << 1) ^ (difference >> 63)).cast_unsigned());
                before = integer;
            }
        }
        None => {
            out.push(FLOATS);
            values.iter().for_each(|value| out.extend_from_slice(&value.to_le_bytes()));
        }
    }
}

/// LEB128: seven bits a byte, the lowest first, the highest bit set where more follow. As the codec's, but who copies the
/// encoder finds it here.
#[expect(clippy::cast_possible_truncation, reason = "seven bits at a time")]
fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

#[cfg(test)]
mod tests;

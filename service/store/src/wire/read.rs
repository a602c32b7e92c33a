//! Reading frames: nothing that they say is believed before it is there, and nothing is allocated on their word.

use super::{CHECKSUM, FLOATS, Field, HEAD, KNOWN_FIELDS, MAGIC, REPORTED};
use crate::codec::input::varint;
use crate::codec::{Places, extend_decimals, unzigzag};
use feedwright_core::cycle::Channel;
use feedwright_core::units::Timestamp;

/// A cycle as it was posted: the form holds, of what it says nothing is checked.
#[derive(Debug, Clone, PartialEq)]
pub struct Post {
    /// Its id.
    pub cycle_id: String,
    /// Its tool.
    pub tool: String,
    /// Its operation.
    pub operation: String,
    /// When it began.
    pub started_at: Timestamp,
    /// The machine's own count.
    pub seq: Option<u64>,
    /// Word of its process.
    pub process: Option<String>,
    /// Word of its strategy.
    pub strategy: Option<String>,
    /// Version of the law that ran.
    pub law_version: Option<String>,
    /// Id and version of the profile that ran.
    pub profile: Option<(String, u32)>,
    /// The recommendation that it followed.
    pub recommendation_id: Option<String>,
    /// Whether it is called a reference cycle.
    pub reference_cycle: Option<bool>,
    /// Commanded spindle speed, rpm.
    pub spindle_speed_rpm: Option<f64>,
    /// Word of its outcome.
    pub outcome: Option<String>,
    /// What was sampled.
    pub samples: Option<PostedSamples>,
    /// What the control reports, in the order of the fields of a cycle.
    pub reported: [Option<f64>; REPORTED],
}

/// Columns as they were posted; one of the two time bases.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PostedSamples {
    /// Distance of two samples, ms.
    pub period_ms: Option<f64>,
    /// Times, ms.
    pub time_ms: Option<Vec<f64>>,
    /// The channels.
    pub columns: Vec<(Channel, Vec<f64>)>,
    /// The places that those which were written as decimals have.
    pub places: Places,
}

/// Why bytes are not read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WireError {
    /// They are no frame of this format.
    Malformed(&'static str),
    /// A channel of that code is not known.
    UnknownChannel(u8),
    /// A channel is given twice.
    ChannelTwice(Channel),
    /// A column of that channel, or of the times, holds an integer that is not below 2^53.
    LargeInteger(Option<Channel>),
    /// So many samples are more than a cycle may hold.
    TooManySamples(usize),
}

type Read<T> = Result<T, WireError>;

const fn malformed<T>(why: &'static str) -> Read<T> {
    Err(WireError::Malformed(why))
}

/// Splits a body into its frames, at most `most` of them; the last one is what is left where that is no frame.
pub fn frames(body: &[u8], most: usize) -> Option<Vec<&[u8]>> {
    let (mut rest, mut frames) = (body, Vec::new());
    while !rest.is_empty() {
        if frames.len() == most {
            return None;
        }
        let whole = length_of(rest).and_then(|length| rest.split_at_checked(length));
        let (frame, after) = whole.unwrap_or((rest, &[]));
        frames.push(frame);
        rest = after;
    }
    Some(frames)
}

/// Length of the frame that begins here, as its head says.
fn length_of(bytes: &[u8]) -> Option<usize> {
    let (head, _) = bytes.split_first_chunk::<HEAD>()?;
    let (magic, length) = head.split_first_chunk::<4>()?;
    let length = u32::from_le_bytes(length.try_into().ok()?);
    (*magic == MAGIC).then_some(())?;
    usize::try_from(length).ok()?.checked_add(HEAD + CHECKSUM)
}

/// Reads one frame. More than `max_samples` samples are refused before room is made for them.
pub fn read(frame: &[u8], max_samples: usize) -> Read<Post> {
    let mut input = Input(whole(frame)?);
    let post = input.post(max_samples)?;
    if input.0.is_empty() { Ok(post) } else { malformed("there is more after its last field") }
}

/// The cycle id of a whole frame, whatever else is in it: no room is made for its samples.
pub fn cycle_id_of(frame: &[u8]) -> Option<String> {
    let body = whole(frame).ok()?;
    // After the fields that are set.
    Input(body.get(size_of::<u32>()..)?).text().ok()
}

/// What stands between the head of a frame and its checksum.
fn whole(frame: &[u8]) -> Read<&[u8]> {
    if !frame.starts_with(&MAGIC[..3]) {
        return malformed("it does not begin with FWC");
    }
    if !frame.starts_with(&MAGIC) {
        return malformed("its version is not 1");
    }
    match length_of(frame) {
        None => return malformed("it ends before its length"),
        Some(length) if length > frame.len() => return malformed("it ends early"),
        Some(length) if length < frame.len() => return malformed("there is more after its end"),
        Some(_) => {}
    }
    let (body, sum) = frame.split_at(frame.len() - CHECKSUM);
    if crc32fast::hash(body).to_le_bytes() != sum {
        return malformed("its checksum differs");
    }
    Ok(&body[HEAD..])
}

/// Integers that are made decimals at once.
const AT_ONCE: usize = 64;
/// Integers are below this, and above it below zero.
const MOST_INTEGER: u64 = 1 << 53;

/// The differences that eight bytes stand for, where each byte is one.
fn short_differences(bytes: [u8; 8]) -> Option<[i8; 8]> {
    const EACH: u64 = 0x0101_0101_0101_0101;
    let bytes = u64::from_le_bytes(bytes);
    if bytes & (0x80 * EACH) != 0 {
        return None;
    }
    // Zig-zag of all eight: half of each, with all bits turned over where it was odd.
    let differences = ((bytes >> 1) & (0x3f * EACH)) ^ ((bytes & EACH) * 0xff);
    Some(differences.to_le_bytes().map(u8::cast_signed))
}

struct Input<'a>(&'a [u8]);

impl<'a> Input<'a> {
    fn bytes<const N: usize>(&mut self) -> Read<[u8; N]> {
        let Some((taken, rest)) = self.0.split_first_chunk::<N>() else {
            return malformed("a field ends early");
        };
        self.0 = rest;
        Ok(*taken)
    }

    fn byte(&mut self) -> Read<u8> {
        self.bytes().map(|[byte]| byte)
    }

    fn float(&mut self) -> Read<f64> {
        self.bytes().map(f64::from_le_bytes)
    }

    fn text(&mut self) -> Read<String> {
        let length = usize::from(self.byte()?);
        let Some((text, rest)) = self.0.split_at_checked(length) else {
            return malformed("a text ends early");
        };
        self.0 = rest;
        std::str::from_utf8(text).map(str::to_owned).or(malformed("a text is not UTF-8"))
    }

    fn post(&mut self, max_samples: usize) -> Read<Post> {
        let set = u32::from_le_bytes(self.bytes()?);
        if set & !KNOWN_FIELDS != 0 {
            return malformed("it has fields that version 1 does not have");
        }
        let has = |field: Field| set >> (field as u8) & 1 == 1;
        let reference_cycle = match (has(Field::ReferenceCycle), has(Field::NoReferenceCycle)) {
            (true, true) => return malformed("it is called a reference cycle and none"),
            (true, false) => Some(true),
            (false, true) => Some(false),
            (false, false) => None,
        };
        // In the order of the bytes: fields of a struct are evaluated as they are written.
        Ok(Post {
            cycle_id: self.text()?,
            tool: self.text()?,
            operation: self.text()?,
            started_at: Timestamp::from_micros(i64::from_le_bytes(self.bytes()?)),
            seq: has(Field::Seq).then(|| self.bytes().map(u64::from_le_bytes)).transpose()?,
            process: has(Field::Process).then(|| self.text()).transpose()?,
            strategy: has(Field::Strategy).then(|| self.text()).transpose()?,
            law_version: has(Field::LawVersion).then(|| self.text()).transpose()?,
            profile: has(Field::Profile)
                .then(|| Ok((self.text()?, u32::from_le_bytes(self.bytes()?))))
                .transpose()?,
            recommendation_id: has(Field::Recommendation).then(|| self.text()).transpose()?,
            reference_cycle,
            spindle_speed_rpm: has(Field::SpindleSpeed).then(|| self.float()).transpose()?,
            outcome: has(Field::Outcome).then(|| self.text()).transpose()?,
            samples: has(Field::Samples).then(|| self.samples(max_samples)).transpose()?,
            reported: if has(Field::Reported) { self.reported()? } else { [None; REPORTED] },
        })
    }

    fn samples(&mut self, max_samples: usize) -> Read<PostedSamples> {
        let mut samples = PostedSamples::default();
        let stamped = match self.byte()? {
            0 => {
                samples.period_ms = Some(self.float()?);
                false
            }
            1 => true,
            _ => return malformed("its time base is neither 0 nor 1"),
        };
        let length = u32::from_le_bytes(self.bytes()?);
        let length = usize::try_from(length).or(malformed("it has too many samples"))?;
        if length > max_samples {
            return Err(WireError::TooManySamples(length));
        }
        if stamped {
            let (times, places) = self.column(length)?;
            samples.time_ms = Some(times);
            places.into_iter().for_each(|places| samples.places.note(None, places));
        }
        let channels = self.byte()?;
        for _ in 0..channels {
            let code = self.byte()?;
            let channel = Channel::from_code(code).ok_or(WireError::UnknownChannel(code))?;
            if samples.columns.iter().any(|(known, _)| *known == channel) {
                return Err(WireError::ChannelTwice(channel));
            }
            let (column, places) = self.column(length).map_err(|error| match error {
                WireError::LargeInteger(None) => WireError::LargeInteger(Some(channel)),
                other => other,
            })?;
            samples.columns.push((channel, column));
            places.into_iter().for_each(|places| samples.places.note(Some(channel), places));
        }
        Ok(samples)
    }

    /// A column, with the places of its decimals where it is of such.
    fn column(&mut self, length: usize) -> Read<(Vec<f64>, Option<u8>)> {
        // Each value takes a byte at the least.
        if length > self.0.len() {
            return malformed("it has more samples than bytes of columns");
        }
        match self.byte()? {
            places @ 0..=9 => Ok((self.decimals(length, places)?, Some(places))),
            FLOATS => Ok(((0..length).map(|_| self.float()).collect::<Read<_>>()?, None)),
            _ => malformed("a column's form is neither 0 to 9 nor 15"),
        }
    }

    fn decimals(&mut self, length: usize, places: u8) -> Read<Vec<f64>> {
        let mut values = Vec::with_capacity(length.min(self.0.len()));
        let (mut integers, mut integer) = ([0; AT_ONCE], 0);
        while values.len() < length {
            let integers = &mut integers[..AT_ONCE.min(length - values.len())];
            integer = self.integers(integers, integer)?;
            extend_decimals(&mut values, integers, places);
        }
        Ok(values)
    }

    /// Integers by how far each is from the one before, the first from `integer`; returns the last.
    fn integers(&mut self, integers: &mut [i64], mut integer: i64) -> Read<i64> {
        let mut rest = &mut *integers;
        loop {
            // Most differences fit one byte.
            while let Some((eight, behind)) = self.0.split_first_chunk()
                && let Some(differences) = short_differences(*eight)
                && integer.unsigned_abs() < MOST_INTEGER - 8 * 64
                && rest.len() >= 8
                && let Some((sums, after)) = std::mem::take(&mut rest).split_first_chunk_mut::<8>()
            {
                for (sum, difference) in sums.iter_mut().zip(differences) {
                    integer += i64::from(difference);
                    *sum = integer;
                }
                (self.0, rest) = (behind, after);
            }
            let Some((sum, after)) = rest.split_first_mut() else { return Ok(integer) };
            integer = integer.wrapping_add(unzigzag(self.varint()?));
            if integer.unsigned_abs() >= MOST_INTEGER {
                return Err(WireError::LargeInteger(None));
            }
            *sum = integer;
            rest = after;
        }
    }

    fn varint(&mut self) -> Read<u64> {
        varint(|| self.byte(), WireError::Malformed("a varint overflows"))
    }

    fn reported(&mut self) -> Read<[Option<f64>; REPORTED]> {
        let set = u16::from_le_bytes(self.bytes()?);
        if set >> REPORTED != 0 {
            return malformed("it reports what version 1 does not have");
        }
        let mut reported = [None; REPORTED];
        for (bit, value) in reported.iter_mut().enumerate() {
            if set >> bit & 1 == 1 {
                *value = Some(self.float()?);
            }
        }
        Ok(reported)
    }
}

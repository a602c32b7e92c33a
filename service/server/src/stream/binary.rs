//! The compact encoding of samples and overrides: fixed fields, little endian, as docs/stream.md has them byte by byte.
//!
//! Values are whole numbers of a channel's last decimal, so that a number means the same in either encoding: dividing
//! by a power of ten is rounded as reading the decimal text is.

use super::cycle::Ordered;
use bytes::{BufMut, BytesMut};
use feedwright_core::closed_loop::monitor::BlockAdvice;
use feedwright_core::closed_loop::plunge::PlungePhase;
use feedwright_core::closed_loop::reason::Quality;
use feedwright_core::closed_loop::{Answer, Mode, SampleAdvice};
use feedwright_core::vibratory::peak_to_peak::VibrationSample;

/// First byte of samples.
pub const SAMPLES: u8 = 0x01;
/// First byte of a block of vibration.
pub const VIBRATION: u8 = 0x02;
/// First byte of overrides.
pub const OVERRIDES: u8 = 0x81;
/// First byte of the answer to a block of vibration.
pub const GAIN: u8 = 0x82;
/// The value that stands for one that was not measured.
pub const MISSING: i32 = i32::MIN;
/// Flag of samples that carry times.
const WITH_TIMES: u8 = 1;
/// Bytes before the values.
const HEAD: usize = 12;
/// Most decimals of a channel: with more, a value of the range of an i32 says nothing.
pub const MOST_DECIMALS: u8 = 9;

/// A binary message of a machine.
#[derive(Debug, Clone, PartialEq)]
pub enum Frame {
    /// Samples, which stand in what was given to be filled.
    Samples {
        /// Number of the message.
        n: u32,
    },
    /// A block of vibration.
    Vibration {
        /// Number of the message.
        n: u32,
        /// Number of the first sample.
        first: u64,
        /// Samples.
        block: Vec<VibrationSample>,
    },
}

/// Why a frame is none; with the number of its message, where the head is whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BadFrame {
    /// Number of the message.
    pub n: Option<u32>,
    /// What is wrong.
    pub why: &'static str,
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

fn i32_at(bytes: &[u8], at: usize) -> Option<i32> {
    Some(i32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

/// 10 to the power of a channel's decimals.
const UNITS: [f64; MOST_DECIMALS as usize + 1] = [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9];

/// Reads a frame; `decimals` are those of the cycle's channels in their order. Samples fill `ordered`.
pub fn read(bytes: &[u8], decimals: &[u8], ordered: &mut Ordered) -> Result<Frame, BadFrame> {
    let (Some(n), Some(first)) = (u32_at(bytes, 4), u32_at(bytes, 8)) else {
        return Err(BadFrame { n: None, why: "a frame has at least 12 bytes" });
    };
    let bad = |why| BadFrame { n: Some(n), why };
    let count = usize::from(u16::from_le_bytes([bytes[2], bytes[3]]));
    if count == 0 {
        return Err(bad("a frame has at least one sample"));
    }
    let body = &bytes[HEAD..];
    match (bytes[0], bytes[1]) {
        (SAMPLES, flags @ (0 | WITH_TIMES)) => {
            let columns = decimals.len() + usize::from(flags == WITH_TIMES);
            if body.len() != 4 * count * columns {
                return Err(bad("the length is not that of its samples of the cycle's channels"));
            }
            let column = |c: usize, decimals: u8| {
                let unit = UNITS.get(usize::from(decimals)).copied().unwrap_or(f64::NAN);
                (0..count).map(move |i| match i32_at(body, 4 * (c * count + i)) {
                    None | Some(MISSING) => f64::NAN,
                    Some(value) => f64::from(value) / unit,
                })
            };
            let Ordered { first: number, count: samples, values, times_ms } = ordered;
            (*number, *samples) = (first.into(), count);
            values.clear();
            for (c, decimals) in decimals.iter().enumerate() {
                values.extend(column(c, *decimals));
            }
            times_ms.clear();
            if flags == WITH_TIMES {
                times_ms.extend(column(decimals.len(), 3));
            }
            Ok(Frame::Samples { n })
        }
        (VIBRATION, 0) => {
            if body.len() != 8 * count {
                return Err(bad("the length is not that of its velocities and accelerations"));
            }
            let value = |i: usize| {
                let raw = body
                    .get(4 * i..4 * i + 4)
                    .and_then(|bytes| bytes.try_into().ok())
                    .map(f32::from_le_bytes);
                f64::from(raw.unwrap_or(f32::NAN))
            };
            let sample =
                |i| VibrationSample { velocity_mm_s: value(i), acceleration_mm_s2: value(count + i) };
            Ok(Frame::Vibration { n, first: first.into(), block: (0..count).map(sample).collect() })
        }
        _ => Err(bad("the first two bytes are no kind of frame that is known")),
    }
}

/// Numbers and mode of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Told {
    /// Number of the answer.
    pub n: u32,
    /// Number of the message that it answers.
    pub re: u32,
    /// Whether overrides are told.
    pub mode: Mode,
}

const fn quality(quality: Quality) -> u8 {
    match quality {
        Quality::Good => 0,
        Quality::Limited => 1,
        Quality::Stale => 2,
        Quality::Missing => 3,
    }
}

/// Bytes of the answer to so many samples.
pub const fn length(samples: usize) -> usize {
    48 + 16 * samples
}

/// Writes the answer to samples.
pub fn overrides(out: &mut BytesMut, told: Told, answer: &Answer, each: &[SampleAdvice]) {
    let advise = told.mode == Mode::Advise;
    let shown = |percent: f64| if advise { percent } else { f64::NAN };
    let flags = u8::from(advise)
        | u8::from(answer.overloaded) << 1
        | u8::from(answer.plunge.is_some()) << 2
        | quality(answer.quality) << 4;
    out.put_u8(OVERRIDES);
    out.put_u8(flags);
    out.put_u16_le(u16::try_from(each.len()).unwrap_or(u16::MAX));
    out.put_u32_le(told.n);
    out.put_u32_le(told.re);
    out.put_u32_le(u32::try_from(answer.next).unwrap_or(u32::MAX));
    out.put_u32_le(u32::try_from(answer.valid_for_ms).unwrap_or(0));
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "casts saturate; no age is below 0"
    )]
    let age_us = answer.age_ms.map_or(u32::MAX, |age_ms| (age_ms * 1000.0) as u32);
    out.put_u32_le(age_us);
    out.put_i64_le(answer.valid_until.micros());
    out.put_u64_le(answer.reasons.bits());
    out.put_f64_le(shown(answer.ovr.percent()));
    for advice in each {
        out.put_f64_le(shown(advice.ovr.percent()));
        out.put_u64_le(advice.reasons.bits());
    }
    if let Some(step) = &answer.plunge {
        let phase = match step.phase {
            PlungePhase::Approach => 0,
            PlungePhase::Work => 1,
            PlungePhase::Retract => 2,
        };
        out.put_slice(&[phase, 0, 0, 0, 0, 0, 0, 0]);
        let found = |mm: Option<f64>| mm.unwrap_or(f64::NAN);
        let feed = if advise { step.feed.mm_min() } else { f64::NAN };
        for value in [feed, step.bite_mm, found(step.contact_offset_mm), found(step.breakthrough_depth_mm)] {
            out.put_f64_le(value);
        }
    }
}

/// Writes the answer to a block of vibration.
pub fn gain(out: &mut BytesMut, n: u32, re: u32, advice: &BlockAdvice) {
    out.put_u8(GAIN);
    out.put_u8(0);
    out.put_u16_le(u16::try_from(advice.unusable).unwrap_or(u16::MAX));
    out.put_u32_le(n);
    out.put_u32_le(re);
    out.put_u32_le(u32::try_from(advice.next).unwrap_or(u32::MAX));
    out.put_u64_le(advice.reasons.bits());
    let values =
        [advice.gain, advice.gain_range.0, advice.gain_range.1, advice.amplitude_mm, advice.frequency_hz];
    for value in values {
        out.put_f64_le(value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use feedwright_core::closed_loop::{LoopReason, LoopReasons};
    use feedwright_core::friction::feed_override::FeedOverride;
    use feedwright_core::units::Timestamp;

    fn hex(bytes: &[u8]) -> String {
        bytes.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    #[test]
    fn a_documented_frame_of_samples_is_read_to_the_documented_numbers() {
        // Two samples of depth (3 decimals) and load (1): 0.125, 0.25 mm; 21.5 % and one that was not measured.
        let bytes = [
            0x01, 0x00, 0x02, 0x00, 0x07, 0x00, 0x00, 0x00, 0x28, 0x00, 0x00, 0x00, //
            0x7d, 0x00, 0x00, 0x00, 0xfa, 0x00, 0x00, 0x00, //
            0xd7, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x80,
        ];
        let mut ordered = Ordered { first: 9, count: 9, values: vec![9.0; 9], times_ms: vec![9.0; 9] };
        assert_eq!(read(&bytes, &[3, 1], &mut ordered), Ok(Frame::Samples { n: 7 }));
        let Ordered { first, count, values, times_ms } = &ordered;
        assert_eq!((*first, *count, values.len(), times_ms.len()), (40, 2, 4, 0));
        assert_eq!(values[..3], [0.125, 0.25, 21.5]);
        assert!(values[3].is_nan());
        let mut timed = bytes.to_vec();
        timed[1] = 1;
        timed.extend([0x10, 0x27, 0x00, 0x00, 0x20, 0x4e, 0x00, 0x00]);
        assert_eq!(read(&timed, &[3, 1], &mut ordered), Ok(Frame::Samples { n: 7 }));
        assert_eq!(ordered.times_ms, [10.0, 20.0]);
    }

    #[test]
    fn every_decimal_means_what_its_text_means() {
        for value in [-1, 1, 3, 7, 1_235, 99_999, 2_147_483_647, -2_147_483_647] {
            for decimals in 0..=MOST_DECIMALS {
                let mut bytes = vec![SAMPLES, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
                bytes.extend(i32::to_le_bytes(value));
                let mut ordered = Ordered::default();
                read(&bytes, &[decimals], &mut ordered).expect("a frame");
                let text = format!("{value}e-{decimals}");
                assert_eq!(ordered.values[0].to_bits(), text.parse::<f64>().unwrap().to_bits(), "{text}");
            }
        }
    }

    #[test]
    fn what_is_no_frame_is_refused_with_its_number() {
        let number = |bytes: &[u8]| read(bytes, &[3], &mut Ordered::default()).unwrap_err().n;
        assert_eq!(number(&[]), None);
        assert_eq!(number(&[1, 0, 1, 0, 9, 0, 0, 0, 0, 0, 0]), None);
        let head = [1, 0, 1, 0, 9, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(number(&head), Some(9));
        assert_eq!(number(&[&head[..], &[0; 5]].concat()), Some(9));
        let mut other = head;
        other[0] = 0x7f;
        assert_eq!(number(&other), Some(9));
        let mut none = head;
        none[2] = 0;
        assert_eq!(number(&none), Some(9));
    }

    #[test]
    fn an_answer_has_the_documented_bytes() {
        let mut reasons = LoopReasons::of(LoopReason::MissingSamples);
        reasons.add(LoopReason::TooOld);
        let answer = Answer {
            ovr: FeedOverride::NEUTRAL,
            reasons,
            next: 42,
            valid_until: Timestamp::from_micros(1_777_874_400_250_000),
            valid_for_ms: 250,
            age_ms: Some(12.5),
            quality: reasons.quality(),
            plunge: None,
            overloaded: false,
        };
        let each = [SampleAdvice { ovr: FeedOverride::NEUTRAL, reasons }];
        let mut out = BytesMut::new();
        overrides(&mut out, Told { n: 3, re: 7, mode: Mode::Advise }, &answer, &each);
        let expected = concat!(
            "81",
            "21",
            "0100",
            "03000000",
            "07000000",
            "2a000000",
            "fa000000",
            "d4300000",
            "900815a4f7500600",
            "0000000011000000",
            "0000000000005940",
            "0000000000005940",
            "0000000011000000"
        );
        assert_eq!((hex(&out), out.len()), (expected.to_owned(), length(1)));
        let mut shadow = BytesMut::new();
        overrides(&mut shadow, Told { n: 3, re: 7, mode: Mode::Shadow }, &answer, &each);
        assert_eq!((shadow[1], hex(&shadow[40..48])), (0x20, "000000000000f87f".to_owned()));
    }
}

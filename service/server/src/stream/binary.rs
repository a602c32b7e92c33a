//! The compact encoding of samples and overrides: fixed fields, little endian, as docs/stream.md has them byte by byte.
//!
//! Values are whole numbers of a channel's last decimal, so that a number means the same in either encoding: dividing
//! by a power of ten is rounded as reading the decimal text is.

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
    /// Samples, column after column.
    Samples {
        /// Number of the message.
        n: u32,
        /// Number of the first sample.
        first: u64,
        /// Samples.
        count: usize,
        /// Values.
        values: Vec<f64>,
        /// Times, ms.
        times_ms: Vec<f64>,
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

/// Reads a frame; `decimals` are those of the cycle's channels in their order.
pub fn read(bytes: &[u8], decimals: &[u8]) -> Result<Frame, BadFrame> {
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
                let unit = 10_f64.powi(i32::from(decimals));
                (0..count).map(move |i| match i32_at(body, 4 * (c * count + i)) {
                    None | Some(MISSING) => f64::NAN,
                    Some(value) => f64::from(value) / unit,
                })
            };
            let mut values = Vec::with_capacity(count * decimals.len());
            for (c, decimals) in decimals.iter().enumerate() {
                values.extend(column(c, *decimals));
            }
            let times_ms = if flags == WITH_TIMES { column(decimals.len(), 3).collect() } else { Vec::new() };
            Ok(Frame::Samples { n, first: first.into(), count, values, times_ms })
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
pub fn overrides(out: &mut Vec<u8>, told: Told, answer: &Answer, each: &[SampleAdvice]) {
    let advise = told.mode == Mode::Advise;
    let shown = |percent: f64| if advise { percent } else { f64::NAN };
    let flags = u8::from(advise)
        | u8::from(answer.overloaded) << 1
        | u8::from(answer.plunge.is_some()) << 2
        | quality(answer.quality) << 4;
    out.push(OVERRIDES);
    out.push(flags);
    out.extend(u16::try_from(each.len()).unwrap_or(u16::MAX).to_le_bytes());
    out.extend(told.n.to_le_bytes());
    out.extend(told.re.to_le_bytes());
    out.extend(u32::try_from(answer.next).unwrap_or(u32::MAX).to_le_bytes());
    out.extend(u32::try_from(answer.valid_for_ms).unwrap_or(0).to_le_bytes());
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "casts saturate; no age is below 0"
    )]
    let age_us = answer.age_ms.map_or(u32::MAX, |age_ms| (age_ms * 1000.0) as u32);
    out.extend(age_us.to_le_bytes());
    out.extend(answer.valid_until.micros().to_le_bytes());
    out.extend(answer.reasons.bits().to_le_bytes());
    out.extend(shown(answer.ovr.percent()).to_le_bytes());
    for advice in each {
        out.extend(shown(advice.ovr.percent()).to_le_bytes());
        out.extend(advice.reasons.bits().to_le_bytes());
    }
    if let Some(step) = &answer.plunge {
        let phase = match step.phase {
            PlungePhase::Approach => 0,
            PlungePhase::Work => 1,
            PlungePhase::Retract => 2,
        };
        out.extend([phase, 0, 0, 0, 0, 0, 0, 0]);
        let found = |mm: Option<f64>| mm.unwrap_or(f64::NAN);
        let feed = if advise { step.feed.mm_min() } else { f64::NAN };
        for value in [feed, step.bite_mm, found(step.contact_offset_mm), found(step.breakthrough_depth_mm)] {
            out.extend(value.to_le_bytes());
        }
    }
}

/// Writes the answer to a block of vibration.
pub fn gain(out: &mut Vec<u8>, n: u32, re: u32, advice: &BlockAdvice) {
    out.push(GAIN);
    out.push(0);
    out.extend(u16::try_from(advice.unusable).unwrap_or(u16::MAX).to_le_bytes());
    out.extend(n.to_le_bytes());
    out.extend(re.to_le_bytes());
    out.extend(u32::try_from(advice.next).unwrap_or(u32::MAX).to_le_bytes());
    out.extend(advice.reasons.bits().to_le_bytes());
    let values =
        [advice.gain, advice.gain_range.0, advice.gain_range.1, advice.amplitude_mm, advice.frequency_hz];
    for value in values {
        out.extend(value.to_le_bytes());
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
        let Ok(Frame::Samples { n, first, count, values, times_ms }) = read(&bytes, &[3, 1]) else {
            panic!("it is a frame");
        };
        assert_eq!((n, first, count, times_ms.len()), (7, 40, 2, 0));
        assert_eq!(values[..3], [0.125, 0.25, 21.5]);
        assert!(values[3].is_nan());
        let mut timed = bytes.to_vec();
        timed[1] = 1;
        timed.extend([0x10, 0x27, 0x00, 0x00, 0x20, 0x4e, 0x00, 0x00]);
        let Ok(Frame::Samples { times_ms, .. }) = read(&timed, &[3, 1]) else { panic!("it has times") };
        assert_eq!(times_ms, [10.0, 20.0]);
    }

    #[test]
    fn every_decimal_means_what_its_text_means() {
        for value in [-1, 1, 3, 7, 1_235, 99_999, 2_147_483_647, -2_147_483_647] {
            for decimals in 0..=MOST_DECIMALS {
                let mut bytes = vec![SAMPLES, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
                bytes.extend(i32::to_le_bytes(value));
                let Ok(Frame::Samples { values, .. }) = read(&bytes, &[decimals]) else { panic!() };
                let text = format!("{value}e-{decimals}");
                assert_eq!(values[0].to_bits(), text.parse::<f64>().unwrap().to_bits(), "{text}");
            }
        }
    }

    #[test]
    fn what_is_no_frame_is_refused_with_its_number() {
        let number = |bytes: &[u8]| read(bytes, &[3]).unwrap_err().n;
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
        let mut out = Vec::new();
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
        let mut shadow = Vec::new();
        overrides(&mut shadow, Told { n: 3, re: 7, mode: Mode::Shadow }, &answer, &each);
        assert_eq!((shadow[1], hex(&shadow[40..48])), (0x20, "000000000000f87f".to_owned()));
    }
}

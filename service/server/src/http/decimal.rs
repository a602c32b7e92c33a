//! JSON of measured values: they are decimals of few places, and are written as such.
//!
//! A shortest form of a double is searched for digit by digit; that of a decimal of few digits is the decimal itself.
//! The text is that of `serde_json` to the byte.

use axum::response::{IntoResponse, Response};
use http::{HeaderValue, header};
use serde::{Serialize, Serializer as _};
use serde_json::ser::{CompactFormatter, Formatter, Serializer};
use std::io::{Result, Write};

/// Powers of ten by places. Few need more.
const POWERS: [f64; 5] = [1.0, 10.0, 100.0, 1_000.0, 10_000.0];
/// 1.5 × 2^52: what is added to it is rounded to an integer, which then stands in its low bits.
const ROUNDER: f64 = 6_755_399_441_055_744.0;
/// 2^49. Decimals of fewer digits than fifteen are told apart by their doubles, so that none is shorter.
const LIMIT: f64 = 562_949_953_421_312.0;
/// Fifteen digits, a point and a sign, with some to spare.
const WIDEST: usize = 24;
/// Bytes of a value and its comma, in the mean.
const USUAL_BYTES: usize = 7;

/// A body with so many measured values.
pub(super) fn json(body: &impl Serialize, values: usize) -> Result<Vec<u8>> {
    let mut out = Vec::with_capacity(512 + values * USUAL_BYTES);
    body.serialize(&mut Serializer::with_formatter(&mut out, Decimals::default()))?;
    Ok(out)
}

/// Appends an array of measured values.
pub(super) fn write(out: &mut Vec<u8>, values: impl Iterator<Item = f64>) -> Result<()> {
    Ok(Serializer::with_formatter(out, Decimals::default()).collect_seq(values)?)
}

/// The answer with that JSON.
pub(super) fn body(json: Vec<u8>) -> Response {
    ([(header::CONTENT_TYPE, HeaderValue::from_static("application/json"))], json).into_response()
}

/// Writes decimals; everything else as `serde_json` does.
#[derive(Default)]
struct Decimals {
    /// Places that the values of this array needed so far: a column has one resolution.
    places: usize,
}

impl Decimals {
    /// The integer that is `value` with so many places or a few more, and how many those are.
    fn integer(&self, value: f64) -> Option<(u64, usize)> {
        (self.places..POWERS.len()).find_map(|places| {
            let scaled = value * POWERS[places];
            let shifted = scaled + ROUNDER;
            // To the bit: the sign of zero is content too.
            let same = ((shifted - ROUNDER) / POWERS[places]).to_bits() == value.to_bits();
            let integer = shifted.to_bits().wrapping_sub(ROUNDER.to_bits()).cast_signed();
            (same && scaled.abs() < LIMIT).then(|| (integer.unsigned_abs(), places))
        })
    }
}

/// The last digit of a number.
fn digit(number: u64) -> u8 {
    b'0' + u8::try_from(number % 10).unwrap_or(0)
}

impl Formatter for Decimals {
    fn begin_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> Result<()> {
        self.places = 0;
        CompactFormatter.begin_array(writer)
    }

    fn write_f64<W: ?Sized + Write>(&mut self, writer: &mut W, value: f64) -> Result<()> {
        let Some((mut rest, mut places)) = self.integer(value) else {
            return CompactFormatter.write_f64(writer, value);
        };
        self.places = places;
        while places > 1 && rest % 10 == 0 {
            rest /= 10;
            places -= 1;
        }
        // Divided by constants: dividing by a number that is looked up takes several times as long.
        let (mut whole, mut part) = match places {
            0 => (rest, 0),
            1 => (rest / 10, rest % 10),
            2 => (rest / 100, rest % 100),
            3 => (rest / 1_000, rest % 1_000),
            _ => (rest / 10_000, rest % 10_000),
        };
        let mut text = [b'0'; WIDEST];
        let mut at = WIDEST;
        // One place is always shown: 140.0.
        for _ in 0..places.max(1) {
            at -= 1;
            text[at] = digit(part);
            part /= 10;
        }
        at -= 1;
        text[at] = b'.';
        loop {
            at -= 1;
            text[at] = digit(whole);
            whole /= 10;
            if whole == 0 {
                break;
            }
        }
        if value.is_sign_negative() {
            at -= 1;
            text[at] = b'-';
        }
        writer.write_all(&text[at..])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn decimals_are_written_as_people_write_them() {
        let text = |values: &[f64]| String::from_utf8(json(&values, values.len()).unwrap()).unwrap();
        assert_eq!(
            text(&[0.0, -0.0, 140.0, 0.5, -12.034, 99.99, 1e-4]),
            "[0.0,-0.0,140.0,0.5,-12.034,99.99,0.0001]"
        );
        assert_eq!(text(&[1e-5, 1.0 / 3.0, 1e300, 7.0]), "[0.00001,0.3333333333333333,1e+300,7.0]");
        assert_eq!(text(&[f64::NAN, f64::INFINITY]), "[null,null]");
        assert_eq!(text(&[]), "[]");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2_000))]
        #[test]
        fn the_text_is_that_of_serde_json(
            values in prop::collection::vec(
                prop_oneof![
                    any::<f64>(),
                    (-(1_i64 << 53)..(1_i64 << 53), 0_i32..8).prop_map(|(m, places)| m as f64 / 10_f64.powi(places)),
                    (-100_000_i64..100_000, 0_i32..6).prop_map(|(m, places)| m as f64 / 10_f64.powi(places)),
                    (-1_000_i64..1_000).prop_map(|m| m as f64 + 0.5),
                    (490_i32..500, -3_i64..4).prop_map(|(e, m)| 2_f64.powi(e - 450) + m as f64 / 8.0),
                ],
                0..20,
            ),
        ) {
            prop_assert_eq!(json(&values, values.len()).unwrap(), serde_json::to_vec(&values).unwrap());
        }
    }
}

//! JSON of a cycle's samples out of the columns that are stored.
//!
//! A decimal is stored as an integer and its places, which is nearly its text: no double is made of it that would have to
//! be taken apart again. The text is that of [`SamplesBody`](super::dto::cycle::SamplesBody) to the byte.

use super::decimal;
use feedwright_store::codec::{Column, Columns, Time};
use std::io::Result;

/// Most places that are written here: a decimal with more may be written with an exponent.
const MOST_PLACES: u8 = 4;
/// Integers below have five digits at the most: with sign, point and comma they fill a word.
const FIVE_DIGITS: u64 = 100_000;
/// Bytes of a word.
const WORD: usize = 8;

/// The columns as `SamplesBody` would write them.
pub(super) fn json(columns: Columns) -> Result<Vec<u8>> {
    let values = columns.len * (columns.channels.len() + 1);
    let mut out = Vec::with_capacity(512 + values * 7);
    match columns.time {
        Time::Period(bits) => {
            out.extend_from_slice(b"{\"period_ms\":");
            serde_json::to_writer(&mut out, &f64::from_bits(bits))?;
        }
        Time::Stamps(times) => {
            out.extend_from_slice(b"{\"time_ms\":");
            column(&mut out, times)?;
        }
    }
    let mut named: Vec<_> =
        columns.channels.into_iter().map(|(channel, values)| (channel.as_str(), values)).collect();
    named.sort_unstable_by_key(|(name, _)| *name);
    for (name, values) in named {
        out.extend_from_slice(b",\"");
        out.extend_from_slice(name.as_bytes());
        out.extend_from_slice(b"\":");
        column(&mut out, values)?;
    }
    out.push(b'}');
    Ok(out)
}

fn column(out: &mut Vec<u8>, column: Column) -> Result<()> {
    if let Column::Decimal { scale, values } = &column
        && *scale <= MOST_PLACES
    {
        // One place is always shown: 140.0.
        let (places, factor) = if *scale == 0 { (1, 10) } else { (u32::from(*scale), 1) };
        let most = FIVE_DIGITS / factor;
        // All of them are looked at: a loop without an end in the middle looks at several at once.
        if values.iter().fold(true, |all, value| all & (value.unsigned_abs() < most)) {
            decimals(out, values, (places, factor));
            return Ok(());
        }
    }
    let values = column.into_values();
    out.extend_from_slice(&decimal::json(&values, values.len())?);
    Ok(())
}

/// An array of the values, each times `factor` below [`FIVE_DIGITS`], with `places`, of which there are 1 to 4.
///
/// Each is put together in a word, its first byte lowest, without asking how long it is.
fn decimals(out: &mut Vec<u8>, values: &[i64], (places, factor): (u32, u64)) {
    out.push(b'[');
    let mut at = out.len();
    out.resize(at + values.len() * WORD, 0);
    let before = 5 - places;
    let (whole, point) = ((1_u64 << (8 * before)) - 1, u64::from(b'.') << (8 * before));
    for value in values {
        let digits = digits(value.unsigned_abs() * factor);
        // Bits of zeros that are not shown: but for one digit before the point and one behind it.
        let leading = (digits.trailing_zeros() & !7).min(8 * (before - 1));
        let trailing = ((digits.leading_zeros() - 24) & !7).min(8 * (places - 1));
        let shown = digits | 0x30_3030_3030;
        let text = ((shown & whole) | point | ((shown & !whole) << 8)) >> leading;
        let bits = 48 - leading - trailing;
        let end = 1_u64 << bits;
        let text = (text & (end - 1)) | (end * u64::from(b','));
        let negative = u64::from(*value < 0);
        let text = (text << (8 * negative)) | (u64::from(b'-') * negative);
        out[at..at + WORD].copy_from_slice(&text.to_le_bytes());
        at += (bits / 8 + 1) as usize + usize::from(*value < 0);
    }
    // The last comma; a column holds one value at the least.
    out.truncate(at - 1);
    out.push(b']');
}

/// The digits of a number below [`FIVE_DIGITS`], the highest in the lowest byte.
const fn digits(number: u64) -> u64 {
    // Products with the inverses, rounded up, are exact for numbers so small; pairs are divided side by side.
    let first = (number * 429_497) >> 32;
    let rest = number - first * 10_000;
    let hundreds = (rest * 5_243) >> 19;
    let pairs = hundreds | ((rest - hundreds * 100) << 16);
    let tens = ((pairs * 103) >> 10) & 0x000f_000f;
    first | ((tens | ((pairs - tens * 10) << 8)) << 8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::dto::cycle::SamplesBody;
    use feedwright_core::cycle::{Channel, Samples, TimeBase};
    use proptest::prelude::*;

    #[test]
    fn digits_stand_in_their_order() {
        for number in 0..FIVE_DIGITS {
            let bytes = digits(number).to_le_bytes();
            let text: String = bytes[..5].iter().map(|digit| char::from(b'0' + digit)).collect();
            assert_eq!(text, format!("{number:05}"));
            assert_eq!(bytes[5..], [0; 3]);
        }
    }

    /// The body that the API describes.
    fn described(samples: &Samples) -> SamplesBody<'_> {
        let (period_ms, time_ms) = match samples.time() {
            TimeBase::Period { period_ms } => (Some(*period_ms), None),
            TimeBase::Stamps { time_ms } => (None, Some(time_ms.into())),
        };
        let columns = samples.columns().map(|(channel, values)| (channel.as_str(), values.into())).collect();
        SamplesBody { period_ms, time_ms, columns }
    }

    fn values() -> impl Strategy<Value = Vec<f64>> {
        let decimals = |most: i64, places: i32| {
            (-most..most).prop_map(move |m| m as f64 / 10_f64.powi(places) + 0.0).boxed()
        };
        let value = prop_oneof![
            (0_i32..=9).prop_map(move |places| decimals(99_999, places)),
            (0_i32..=5).prop_map(move |places| decimals(100_000, places)),
            (0_i32..=4).prop_map(move |places| decimals(10_001, places)),
            (0_i32..=1).prop_map(move |places| decimals(1_000_000_000, places)),
            Just((-100_000.0..100_000.0).boxed()),
            Just(prop_oneof![Just(-0.0), Just(0.0), Just(10.0), Just(-0.5), Just(1e-5)].boxed()),
        ];
        value.prop_flat_map(|value| prop::collection::vec(value, 5))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2_000))]
        #[test]
        fn the_text_is_that_of_the_body(
            thrust in values(),
            torque in values(),
            times in prop::option::of(prop::collection::vec(0_i64..10_000, 5)),
        ) {
            let time = match times {
                None => TimeBase::Period { period_ms: 10.0 },
                Some(mut times) => {
                    times.sort_unstable();
                    TimeBase::Stamps { time_ms: times.iter().map(|ms| *ms as f64 / 10.0).collect() }
                }
            };
            let within = |values: Vec<f64>, most: f64| values.iter().map(|value| value.clamp(-most, most)).collect();
            let columns = vec![
                (Channel::ThrustNewtons, within(thrust, 1e7)),
                (Channel::TorqueNewtonMetres, within(torque, 1e6)),
            ];
            let samples = Samples::new(time, columns, 10).unwrap();
            let text = json(Columns::of(&samples)).unwrap();
            prop_assert_eq!(text, serde_json::to_vec(&described(&samples)).unwrap());
        }
    }
}

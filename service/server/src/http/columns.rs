//! JSON of a cycle's samples out of the columns that are stored.
//!
//! A decimal is stored as an integer and its places, which is nearly its text: no double is made of it that would have to
//! be taken apart again. The text is that of [`SamplesBody`](super::dto::cycle::SamplesBody) to the byte.

use super::decimal;
use feedwright_store::codec::{Column, Columns, Time};
use std::io::Result;
use std::sync::LazyLock;

/// Most places that are written here: a decimal with more may be written with an exponent.
const MOST_PLACES: u8 = 4;
/// Integers below have five digits at the most: with point and comma they are within a word.
const FIVE_DIGITS: u64 = 100_000;
/// Bytes of a word.
const WORD: usize = 8;
/// Values that are put together before they are copied, and bytes that each of them takes at the most: a sign besides.
const TOGETHER: usize = 32;
const MOST_BYTES: usize = WORD + 1;

/// Digits of whole numbers, the first in the lowest byte: as many as stand before the point where one place is behind it.
static WHOLE: LazyLock<Box<[u32]>> =
    LazyLock::new(|| (0..10_000).map(|number| text(&number.to_string())).collect());
/// By how many places there are, the point, the digits behind it but for zeros at the end, and a comma.
static BEHIND: [LazyLock<Box<[u64]>>; MOST_PLACES as usize] = [
    LazyLock::new(|| behind(1, 10)),
    LazyLock::new(|| behind(2, 100)),
    LazyLock::new(|| behind(3, 1_000)),
    LazyLock::new(|| behind(4, 10_000)),
];

fn behind(places: usize, numbers: u32) -> Box<[u64]> {
    let text_of = |number: u32| {
        let digits = format!("{number:0places$}");
        // One place is always shown: 140.0.
        let (first, others) = digits.split_at(1);
        text(&format!(".{first}{},", others.trim_end_matches('0')))
    };
    (0..numbers).map(text_of).collect()
}

/// The bytes of a short text as an integer, the first one lowest.
fn text<T: From<u8> + std::ops::Shl<u32, Output = T> + std::ops::BitOr<Output = T>>(text: &str) -> T {
    text.bytes().rev().fold(T::from(0), |word, byte| word << 8 | T::from(byte))
}

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
/// What stands before the point and behind it is looked up, and put together in a word without asking how long either is.
#[expect(clippy::cast_possible_truncation, reason = "numbers of five digits")]
fn decimals(out: &mut Vec<u8>, values: &[i64], (places, factor): (u32, u64)) {
    let (whole, behind) = (&*WHOLE, &*BEHIND[places as usize - 1]);
    let scale = 10_u64.pow(places);
    // Rounded up, it is exact for numbers so small.
    let inverse = (1_u64 << 32).div_ceil(scale);
    out.push(b'[');
    for values in values.chunks(TOGETHER) {
        let mut texts = [0; TOGETHER * MOST_BYTES];
        let mut at = 0;
        for value in values {
            let number = value.unsigned_abs() * factor;
            let before = (number * inverse) >> 32;
            let whole = whole[before as usize];
            let behind = behind[(number - before * scale) as usize];
            // Digits and commas have two bits of zeros on top.
            let text = u64::from(whole) | behind << (34 - whole.leading_zeros());
            texts[at] = b'-';
            at += usize::from(*value < 0);
            texts[at..at + WORD].copy_from_slice(&text.to_le_bytes());
            at += (66 - text.leading_zeros()) as usize / 8;
        }
        out.extend_from_slice(&texts[..at]);
    }
    // The last comma; a column holds one value at the least.
    out.pop();
    out.push(b']');
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::dto::cycle::SamplesBody;
    use feedwright_core::cycle::{Channel, Samples, TimeBase};
    use proptest::prelude::*;

    #[test]
    fn every_decimal_of_five_digits_is_written() {
        for places in 1..=u32::from(MOST_PLACES) {
            let all: Vec<i64> = (1 - FIVE_DIGITS as i64..FIVE_DIGITS as i64).collect();
            let mut out = Vec::new();
            decimals(&mut out, &all, (places, 1));
            let values: Vec<f64> =
                all.iter().map(|value| *value as f64 / 10_f64.powi(places as i32)).collect();
            assert!(out == serde_json::to_vec(&values).unwrap(), "{places} places");
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

//! Looking over whole columns, several values at once.
//!
//! A loop that ends in its middle, or whose every step waits for the one before it, takes a column value by value. These
//! give the same results, to the last bit, and keep the processor busy.

/// Largest values that are kept side by side.
const LANES: usize = 8;

/// Values that are looked at before a search asks whether it is done.
const BLOCK: usize = 16;

/// The largest value; −∞ where there is none.
pub(super) fn largest(values: &[f64]) -> f64 {
    let (rows, rest) = values.as_chunks::<LANES>();
    let mut most = [f64::NEG_INFINITY; LANES];
    for row in rows {
        for (most, &value) in most.iter_mut().zip(row) {
            *most = larger(*most, value);
        }
    }
    most.iter().chain(rest).copied().fold(f64::NEG_INFINITY, larger)
}

/// A single instruction, where `f64::max` would look for NaN as well.
fn larger(most: f64, value: f64) -> f64 {
    if value > most { value } else { most }
}

/// As [`larger`].
fn smaller(least: f64, value: f64) -> f64 {
    if value < least { value } else { least }
}

/// The smallest and the largest value; ∞ and −∞ where there is none.
pub(super) fn span(values: &[f64]) -> (f64, f64) {
    let (rows, rest) = values.as_chunks::<LANES>();
    let (mut least, mut most) = ([f64::INFINITY; LANES], [f64::NEG_INFINITY; LANES]);
    for row in rows {
        for ((least, most), &value) in least.iter_mut().zip(&mut most).zip(row) {
            *least = smaller(*least, value);
            *most = larger(*most, value);
        }
    }
    (
        least.iter().chain(rest).copied().fold(f64::INFINITY, smaller),
        most.iter().chain(rest).copied().fold(f64::NEG_INFINITY, larger),
    )
}

/// Whether any value passes. It looks at all of them.
pub(super) fn any(values: &[f64], test: impl Fn(f64) -> bool) -> bool {
    values.iter().fold(false, |any, value| any | test(*value))
}

/// Place of the first value that passes.
pub(super) fn first(values: &[f64], test: impl Fn(f64) -> bool) -> Option<usize> {
    let block = BLOCK * values.chunks(BLOCK).position(|block| any(block, &test))?;
    values[block..].iter().position(|value| test(*value)).map(|place| block + place)
}

/// Place of the last value that passes.
pub(super) fn last(values: &[f64], test: impl Fn(f64) -> bool) -> Option<usize> {
    let after = BLOCK * values.rchunks(BLOCK).position(|block| any(block, &test))?;
    values[..values.len() - after].iter().rposition(|value| test(*value))
}

/// The sums of columns of one length, each in the order of its values and from −0, as [`Iterator::sum`] has it.
///
/// An addition waits for the one before it in its sum: several sums side by side take the time of one.
pub(super) fn sums<const N: usize>(columns: [&[f64]; N]) -> [f64; N] {
    let len = columns.iter().map(|column| column.len()).min().unwrap_or(0);
    let columns = columns.map(|column| &column[..len]);
    let mut sums = [-0.0; N];
    for place in 0..len {
        for (sum, column) in sums.iter_mut().zip(columns) {
            *sum += column[place];
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::{any, first, largest, last, span, sums};
    use proptest::prelude::{Just, Strategy, prop_assert_eq, prop_oneof, proptest};

    fn values() -> impl Strategy<Value = Vec<f64>> {
        // Few different ones, so that the same come again, and those of both signs.
        let value = prop_oneof![(-3..3_i8).prop_map(f64::from), -1e4..1e4_f64, Just(-0.0)];
        proptest::collection::vec(value, 0..100)
    }

    proptest! {
        #[test]
        fn what_is_found_is_what_a_plain_loop_finds(values in values(), level in -3..3_i8) {
            let passes = |value: f64| value <= f64::from(level);
            // Adding zero: either zero may be the larger one.
            let bits = |value: f64| (value + 0.0).to_bits();
            let plain = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            prop_assert_eq!(bits(largest(&values)), bits(plain));
            let least = values.iter().copied().fold(f64::INFINITY, f64::min);
            let (smallest, most) = span(&values);
            prop_assert_eq!((bits(smallest), bits(most)), (bits(least), bits(plain)));
            prop_assert_eq!(any(&values, passes), values.iter().any(|value| passes(*value)));
            prop_assert_eq!(first(&values, passes), values.iter().position(|value| passes(*value)));
            prop_assert_eq!(last(&values, passes), values.iter().rposition(|value| passes(*value)));
        }

        #[test]
        fn sums_are_those_of_the_columns_to_the_last_bit(values in values(), others in values()) {
            let len = values.len().min(others.len());
            let columns = [&values[..len], &others[..len]];
            let found = sums(columns);
            let plain = columns.map(|column| column.iter().sum::<f64>());
            prop_assert_eq!(found.map(f64::to_bits), plain.map(f64::to_bits));
        }
    }
}

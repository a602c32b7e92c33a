//! Numbers in messages for people.

use core::fmt;

/// A number for a message: by a power of ten where its digits alone would fill the line.
pub(crate) struct Shown(pub(crate) f64);

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(value) = *self;
        let is_usual = value == 0.0 || !value.is_finite() || (1e-9..1e16).contains(&value.abs());
        if is_usual { write!(f, "{value}") } else { write!(f, "{value:e}") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_hundreds_of_digits_are_told_by_their_power_of_ten() {
        let told = |value: f64| Shown(value).to_string();
        assert_eq!([1e308, -1.5e-300, -1e16].map(told), ["1e308", "-1.5e-300", "-1e16"]);
        assert_eq!(
            [0.0, -100_000.25, 1e15, 1e-9].map(told),
            ["0", "-100000.25", "1000000000000000", "0.000000001"]
        );
        assert_eq!([f64::NAN, f64::NEG_INFINITY].map(told), ["NaN", "-inf"]);
    }
}

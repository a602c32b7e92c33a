//! What is wrong with an input, and where.

use std::fmt;

/// One thing wrong with an input: the path of the field, a stable code and a sentence for a person.
///
/// Codes are part of the API: they may be added, never renamed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation {
    /// Path from the root of the input, as in `samples.spindle_load_percent[17]`.
    pub path: String,
    /// Stable, machine-readable code, as in `not_finite`.
    pub code: &'static str,
    /// What was expected and what was found.
    pub message: String,
}

impl Violation {
    /// Names a violation at `path`.
    pub fn new(path: impl Into<String>, code: &'static str, message: impl Into<String>) -> Self {
        Self { path: path.into(), code, message: message.into() }
    }
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {} ({})", self.path, self.message, self.code)
    }
}

impl std::error::Error for Violation {}

/// A number for a message: by a power of ten where its digits alone would fill the line.
fn shown(value: f64) -> String {
    let is_usual = value == 0.0 || (1e-9..1e16).contains(&value.abs());
    if is_usual { value.to_string() } else { format!("{value:e}") }
}

/// A closed range that a quantity has to lie in, with its unit for the message.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// Smallest accepted value.
    pub min: f64,
    /// Largest accepted value.
    pub max: f64,
    /// Unit as it is printed.
    pub unit: &'static str,
}

impl Range {
    /// Builds a range; used for constants.
    pub const fn new(min: f64, max: f64, unit: &'static str) -> Self {
        Self { min, max, unit }
    }

    /// Returns `value` with a negative zero normalised, or says why it is refused.
    pub fn check(&self, path: &str, value: f64) -> Result<f64, Violation> {
        if !value.is_finite() {
            return Err(Violation::new(path, "not_finite", "must be a finite number"));
        }
        if value < self.min || value > self.max {
            return Err(Violation::new(
                path,
                "out_of_range",
                format!("must be within {} to {} {}, is {}", self.min, self.max, self.unit, shown(value)),
            ));
        }
        // Adding zero turns −0.0 into 0.0, so that equal content has equal bits on both databases.
        Ok(value + 0.0)
    }

    /// As [`Range::check`], pushing the violation and returning `None` where it is refused.
    pub fn collect(&self, path: &str, value: f64, into: &mut Vec<Violation>) -> Option<f64> {
        match self.check(path, value) {
            Ok(value) => Some(value),
            Err(violation) => {
                into.push(violation);
                None
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_hundreds_of_digits_are_told_by_their_power_of_ten() {
        let told = |value: f64| Range::new(1.0, 2.0, "mm").check("depth_mm", value).unwrap_err().message;
        assert_eq!(told(1e308), "must be within 1 to 2 mm, is 1e308");
        assert_eq!(told(-1.5e-300), "must be within 1 to 2 mm, is -1.5e-300");
        assert_eq!(told(0.0), "must be within 1 to 2 mm, is 0");
        assert_eq!(told(-100_000.25), "must be within 1 to 2 mm, is -100000.25");
        assert_eq!(told(1e15), "must be within 1 to 2 mm, is 1000000000000000");
    }
}

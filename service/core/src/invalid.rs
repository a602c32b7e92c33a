//! What is wrong with an input, and where.

use crate::shown::Shown;
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
    /// Names a violation at `path`. Both texts may repeat what came in, which may be as long as a body: they are [`bounded`].
    pub fn new(path: impl Into<String>, code: &'static str, message: impl Into<String>) -> Self {
        Self { path: bounded(path.into(), MOST_PATH), code, message: bounded(message.into(), MOST_MESSAGE) }
    }
}

/// Longest path that is told, bytes: some deeply nested fields with long names.
const MOST_PATH: usize = 400;
/// Longest message that is told, bytes: more than the names of all fields of anything that is taken in.
const MOST_MESSAGE: usize = 1000;

/// A text of at most so many bytes: of a longer one the beginning and the end, with `…` between.
#[must_use]
pub fn bounded(text: String, most: usize) -> String {
    const CUT: &str = "…";
    if text.len() <= most {
        return text;
    }
    let half = most.saturating_sub(CUT.len()) / 2;
    let is_boundary = |at: &usize| text.is_char_boundary(*at);
    let head = (0..=half).rev().find(is_boundary).unwrap_or_default();
    let tail = (text.len() - half..=text.len()).find(is_boundary).unwrap_or(text.len());
    let mut short = String::with_capacity(head + CUT.len() + text.len() - tail);
    short.push_str(&text[..head]);
    short.push_str(CUT);
    short.push_str(&text[tail..]);
    short
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Of the whole of what was sent there is no path.
        let colon = if self.path.is_empty() { "" } else { ": " };
        write!(f, "{}{colon}{} ({})", self.path, self.message, self.code)
    }
}

impl std::error::Error for Violation {}

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
                format!("must be within {} to {} {}, is {}", self.min, self.max, self.unit, Shown(value)),
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
    fn of_a_long_text_both_ends_are_told() {
        assert_eq!(bounded("a short one".to_owned(), 11), "a short one");
        assert_eq!(bounded("0123456789ab".to_owned(), 11), "0123…89ab");
        // Never within a character, and never longer than permitted.
        for most in 3..40 {
            let short = bounded("Vorschubübersteuerung µm ".repeat(3), most);
            assert!(short.len() <= most && short.contains('…'), "{most}: {short}");
        }
        let violation = Violation::new("k".repeat(1 << 20), "unknown_field", "k".repeat(1 << 20));
        assert!(violation.path.len() <= MOST_PATH && violation.message.len() <= MOST_MESSAGE);
    }
}

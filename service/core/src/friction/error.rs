//! The one error of every constructor here: which field, a stable code, and a sentence for a person.

use crate::shown::Shown;
use std::borrow::Cow;
use std::fmt;

/// Why a value was refused; the code is stable and may be matched on, the text may change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InvalidCode {
    /// NaN or infinite.
    NotFinite,
    /// Outside the range named in the text.
    OutOfRange,
    /// A list is empty that needs at least one entry.
    Empty,
    /// A list is longer than its bound.
    TooMany,
    /// Entries that have to increase strictly do not.
    NotIncreasing,
    /// Columns that belong together differ in length.
    LengthMismatch,
    /// Two values that are each possible contradict each other.
    Inconsistent,
    /// The filter's recursion has a pole on or outside the unit circle.
    Unstable,
    /// Too little usable data, or data without the variation that the fit needs.
    NotIdentifiable,
    /// A question outside the range for which an answer was fitted.
    Extrapolation,
}

impl InvalidCode {
    /// The code as it appears in an answer to a machine.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::NotFinite => "not_finite",
            Self::OutOfRange => "out_of_range",
            Self::Empty => "empty",
            Self::TooMany => "too_many",
            Self::NotIncreasing => "not_increasing",
            Self::LengthMismatch => "length_mismatch",
            Self::Inconsistent => "inconsistent",
            Self::Unstable => "unstable",
            Self::NotIdentifiable => "not_identifiable",
            Self::Extrapolation => "extrapolation",
        }
    }
}

/// A refused value: field, code and text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Invalid {
    field: Cow<'static, str>,
    code: InvalidCode,
    message: String,
}

impl Invalid {
    /// An error for `field` (a path such as `knots[2].feed_mm_min`) with a sentence for a person.
    #[must_use]
    pub fn new(field: impl Into<Cow<'static, str>>, code: InvalidCode, message: impl Into<String>) -> Self {
        Self { field: field.into(), code, message: message.into() }
    }

    /// The path of the refused field.
    #[must_use]
    pub fn field(&self) -> &str {
        &self.field
    }

    /// The stable code.
    #[must_use]
    pub const fn code(&self) -> InvalidCode {
        self.code
    }

    /// The sentence for a person, without the field's name.
    #[must_use]
    pub fn message(&self) -> &str {
        &self.message
    }

    /// The same error seen from outside: `prefix.field`.
    #[must_use]
    pub fn within(self, prefix: &str) -> Self {
        Self { field: Cow::Owned(format!("{prefix}.{}", self.field)), ..self }
    }
}

impl fmt::Display for Invalid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {} ({})", self.field, self.message, self.code.as_str())
    }
}

impl std::error::Error for Invalid {}

/// Passes a finite number.
pub(crate) fn finite(field: &'static str, value: f64) -> Result<f64, Invalid> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(Invalid::new(field, InvalidCode::NotFinite, "must be a finite number"))
    }
}

/// Passes a finite number in the closed range `[low, high]`.
pub(crate) fn between(field: &'static str, value: f64, low: f64, high: f64) -> Result<f64, Invalid> {
    finite(field, value)?;
    if (low..=high).contains(&value) {
        Ok(value)
    } else {
        let text = format!("must be between {low} and {high}, not {}", Shown(value));
        Err(Invalid::new(field, InvalidCode::OutOfRange, text))
    }
}

/// Passes a finite number in `(0, high]`.
pub(crate) fn positive(field: &'static str, value: f64, high: f64) -> Result<f64, Invalid> {
    finite(field, value)?;
    if value > 0.0 && value <= high {
        Ok(value)
    } else {
        let text = format!("must be above 0 and at most {high}, not {}", Shown(value));
        Err(Invalid::new(field, InvalidCode::OutOfRange, text))
    }
}

/// Passes columns that all have as many entries as the first.
pub(crate) fn same_length(columns: &[(&'static str, &[f64])]) -> Result<(), Invalid> {
    let Some((first, rest)) = columns.split_first() else { return Ok(()) };
    match rest.iter().find(|(_, column)| column.len() != first.1.len()) {
        None => Ok(()),
        Some((field, column)) => {
            let text = format!("has {} entries, {} has {}", column.len(), first.0, first.1.len());
            Err(Invalid::new(*field, InvalidCode::LengthMismatch, text))
        }
    }
}

/// Passes columns in which every entry is a finite number.
pub(crate) fn all_finite(columns: &[(&'static str, &[f64])]) -> Result<(), Invalid> {
    for (field, column) in columns {
        if let Some(at) = column.iter().position(|value| !value.is_finite()) {
            let path = format!("{field}[{at}]");
            return Err(Invalid::new(path, InvalidCode::NotFinite, "must be a finite number"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_names_the_field_from_outside_and_keeps_its_code() {
        let inner = positive("feed_mm_min", f64::NAN, 10.0).unwrap_err().within("knots[2]");
        assert_eq!(inner.field(), "knots[2].feed_mm_min");
        assert_eq!(inner.code().as_str(), "not_finite");
        assert_eq!(inner.to_string(), "knots[2].feed_mm_min: must be a finite number (not_finite)");
    }

    #[test]
    fn ranges_are_closed_where_they_say_so() {
        assert!(between("x", 1.0, 1.0, 2.0).is_ok());
        assert!(positive("x", 0.0, 2.0).is_err());
        assert_eq!(between("x", 2.1, 1.0, 2.0).unwrap_err().code(), InvalidCode::OutOfRange);
    }
}

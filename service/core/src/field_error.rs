//! Why an input was refused: the field, a stable code and a sentence for people.
//!
//! Constructors of the process modules return it; the HTTP layer prefixes the path of the object that held the
//! field. Nothing here allocates unless `std` is on, so that a controller board can report a bad setting too.

use crate::shown::Shown;
use core::fmt;

/// A refused field and what is wrong with it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldError {
    field: &'static str,
    index: Option<usize>,
    problem: Problem,
}

/// What is wrong with a field.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Problem {
    /// NaN or infinite.
    NotFinite,
    /// Finite, but outside what is physically or computationally meant.
    OutOfRange {
        /// The value given.
        value: f64,
        /// Least value accepted.
        min: f64,
        /// Greatest value accepted.
        max: f64,
    },
    /// The lower end of a range lies above its upper end.
    Inverted,
    /// A list or a text without content.
    Empty,
    /// More elements than are worked on in one call.
    TooMany {
        /// How many were given or would arise.
        count: usize,
        /// The most that is accepted.
        max: usize,
    },
    /// Fewer elements than the computation needs.
    TooFew {
        /// How many were given.
        count: usize,
        /// The least that is accepted.
        min: usize,
    },
    /// Two lists that belong together differ in length.
    LengthMismatch {
        /// Length expected.
        expected: usize,
        /// Length found.
        found: usize,
    },
    /// Valid alone, impossible together with the other fields; the sentence says why.
    Inconsistent(&'static str),
}

impl Problem {
    /// Stable, machine-readable name of the problem.
    #[must_use]
    pub const fn code(self) -> &'static str {
        match self {
            Self::NotFinite => "not_finite",
            Self::OutOfRange { .. } => "out_of_range",
            Self::Inverted => "inverted_range",
            Self::Empty => "empty",
            Self::TooMany { .. } => "too_many",
            Self::TooFew { .. } => "too_few",
            Self::LengthMismatch { .. } => "length_mismatch",
            Self::Inconsistent(_) => "inconsistent",
        }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => f.write_str("must be a finite number"),
            Self::OutOfRange { value, min, max } => {
                write!(f, "is {}, must lie within {min} and {max}", Shown(*value))
            }
            Self::Inverted => f.write_str("starts above its end"),
            Self::Empty => f.write_str("must not be empty"),
            Self::TooMany { count, max } => write!(f, "makes {count} elements, at most {max} are accepted"),
            Self::TooFew { count, min } => write!(f, "has {count} elements, at least {min} are needed"),
            Self::LengthMismatch { expected, found } => {
                write!(f, "has {found} elements where {expected} are expected")
            }
            Self::Inconsistent(why) => f.write_str(why),
        }
    }
}

impl FieldError {
    /// A refusal of `field`.
    #[must_use]
    pub const fn new(field: &'static str, problem: Problem) -> Self {
        Self { field, index: None, problem }
    }

    /// The same of one element of the field, which is a list.
    #[must_use]
    pub const fn at(self, index: usize) -> Self {
        Self { index: Some(index), ..self }
    }

    /// Name of the refused field, as it is called in the input structure.
    #[must_use]
    pub const fn field(&self) -> &'static str {
        self.field
    }

    /// Place of the refused element where the field is a list; none where it is the whole of it.
    #[must_use]
    pub const fn index(&self) -> Option<usize> {
        self.index
    }

    /// What is wrong with it.
    #[must_use]
    pub const fn problem(&self) -> Problem {
        self.problem
    }

    /// Stable, machine-readable name of the problem.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        self.problem.code()
    }

    /// Path of the field inside `parent`, such as `drills[3].diameter_mm` or `speeds_rpm[1]`.
    #[cfg(feature = "std")]
    #[must_use]
    pub fn path_in(&self, parent: &str) -> String {
        let mut path =
            if parent.is_empty() { self.field.to_owned() } else { format!("{parent}.{}", self.field) };
        if let Some(index) = self.index {
            path += &format!("[{index}]");
        }
        path
    }
}

impl fmt::Display for FieldError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.field)?;
        if let Some(index) = self.index {
            write!(f, "[{index}]")?;
        }
        write!(f, " {}", self.problem)
    }
}

impl core::error::Error for FieldError {}

/// Passes `value` through when it is finite and within `min..=max`.
pub(crate) fn within(field: &'static str, value: f64, min: f64, max: f64) -> Result<f64, FieldError> {
    if !value.is_finite() {
        return Err(FieldError::new(field, Problem::NotFinite));
    }
    if value < min || value > max {
        return Err(FieldError::new(field, Problem::OutOfRange { value, min, max }));
    }
    Ok(value)
}

/// Passes a list of which every value is finite and within `min..=max`.
#[cfg(feature = "std")]
pub(crate) fn each_within(field: &'static str, values: &[f64], min: f64, max: f64) -> Result<(), FieldError> {
    let check = |(index, value): (usize, &f64)| {
        within(field, *value, min, max).map(|_| ()).map_err(|error| error.at(index))
    };
    values.iter().enumerate().try_for_each(check)
}

/// Passes a count through when it lies within `min..=max`.
#[cfg(feature = "std")]
pub(crate) fn count(field: &'static str, count: usize, min: usize, max: usize) -> Result<usize, FieldError> {
    if count < min {
        let problem = if count == 0 { Problem::Empty } else { Problem::TooFew { count, min } };
        return Err(FieldError::new(field, problem));
    }
    if count > max {
        return Err(FieldError::new(field, Problem::TooMany { count, max }));
    }
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_names_the_field_the_code_and_the_reason() {
        let refused = within("diameter_mm", f64::NAN, 0.1, 100.0).unwrap_err();
        assert_eq!((refused.field(), refused.code()), ("diameter_mm", "not_finite"));
        let refused = within("diameter_mm", 200.0, 0.1, 100.0).unwrap_err();
        assert_eq!(refused.to_string(), "diameter_mm is 200, must lie within 0.1 and 100");
    }

    #[cfg(feature = "std")]
    #[test]
    fn a_refusal_inside_a_list_is_found_again() {
        let refused = within("diameter_mm", -1.0, 0.1, 100.0).unwrap_err();
        assert_eq!(refused.path_in("drills[3]"), "drills[3].diameter_mm");
        let refused = each_within("speeds_rpm", &[3000.0, 1e7], 1.0, 1e6).unwrap_err();
        assert_eq!(
            (refused.path_in(""), refused.path_in("job")),
            ("speeds_rpm[1]".into(), "job.speeds_rpm[1]".into())
        );
        assert_eq!(refused.to_string(), "speeds_rpm[1] is 10000000, must lie within 1 and 1000000");
        assert_eq!(count("drills", 0, 1, 9).unwrap_err().code(), "empty");
        assert_eq!(count("drills", 10, 1, 9).unwrap_err().code(), "too_many");
    }
}

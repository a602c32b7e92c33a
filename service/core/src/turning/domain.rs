//! The speeds and feeds to choose from.

use crate::field_error::{FieldError, Problem, within};

/// Most speed–feed pairs of a grid: a plan over it still takes well under a second.
pub const MAX_GRID_PAIRS: usize = 100_000;

/// Paths of an interval or axis and of its fields.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Paths {
    whole: &'static str,
    min: &'static str,
    max: &'static str,
    step: &'static str,
}

/// [`Paths`] of the field of that name.
macro_rules! paths {
    ($at:literal) => {
        $crate::turning::domain::Paths::new(
            $at,
            concat!($at, ".min"),
            concat!($at, ".max"),
            concat!($at, ".step"),
        )
    };
}
pub(crate) use paths;

impl Paths {
    pub(crate) const fn new(
        whole: &'static str,
        min: &'static str,
        max: &'static str,
        step: &'static str,
    ) -> Self {
        Self { whole, min, max, step }
    }
}

/// Closed interval of a quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// Lower end.
    pub min: f64,
    /// Upper end.
    pub max: f64,
}

impl Range {
    pub(crate) fn check(self, paths: Paths, min: f64, max: f64) -> Result<Self, FieldError> {
        within(paths.min, self.min, min, max)?;
        within(paths.max, self.max, min, max)?;
        if self.min > self.max {
            return Err(FieldError::new(paths.whole, Problem::Inverted));
        }
        Ok(self)
    }

    /// Whether `value` lies inside, ends included, with a relative slack for decimal steps.
    #[must_use]
    pub fn contains(self, value: f64) -> bool {
        let slack = 1e-9 * value.abs();
        value >= self.min - slack && value <= self.max + slack
    }
}

/// Evenly spaced values from `min` to `max`, both included when `step` divides the range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    /// First value.
    pub min: f64,
    /// Last value.
    pub max: f64,
    /// Distance between neighbours.
    pub step: f64,
}

impl Axis {
    fn values(self, paths: Paths, min: f64, max: f64) -> Result<Vec<f64>, FieldError> {
        Range { min: self.min, max: self.max }.check(paths, min, max)?;
        within(paths.step, self.step, 1e-9, max)?;
        // The slack admits 0.60 as the 108th step of 0.005 from 0.06 in binary arithmetic.
        let steps = ((self.max - self.min) / self.step + 1e-6).floor();
        #[expect(clippy::cast_precision_loss, reason = "the bound is far below 2^53")]
        let most = MAX_GRID_PAIRS as f64;
        if steps >= most {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "float casts saturate"
            )]
            let count = steps as usize;
            return Err(FieldError::new(paths.step, Problem::TooMany { count, max: MAX_GRID_PAIRS }));
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "0 ≤ steps < MAX_GRID_PAIRS"
        )]
        let count = steps as u32 + 1;
        Ok((0..count).map(|i| decimal(self.min + f64::from(i) * self.step)).collect())
    }
}

/// Strips the binary tail of a decimal step: 0.58, not 0.5800000000000001.
fn decimal(value: f64) -> f64 {
    (value * 1e9).round() / 1e9
}

/// Unchecked pairs to choose from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DomainInput {
    /// All combinations of two axes, as in the paper.
    Grid {
        /// Cutting speed, m/min.
        speed_m_min: Axis,
        /// Feed, mm/rev.
        feed_mm_rev: Axis,
    },
    /// Any speed and feed within two ranges.
    Continuous {
        /// Cutting speed, m/min.
        speed_m_min: Range,
        /// Feed, mm/rev.
        feed_mm_rev: Range,
    },
}

/// Checked pairs to choose from.
#[derive(Debug, Clone, PartialEq)]
pub enum Domain {
    /// Speeds × feeds, both ascending.
    Grid {
        /// Speeds, m/min.
        speeds_m_min: Vec<f64>,
        /// Feeds, mm/rev.
        feeds_mm_rev: Vec<f64>,
    },
    /// Two ranges.
    Continuous {
        /// Speeds, m/min.
        speed_m_min: Range,
        /// Feeds, mm/rev.
        feed_mm_rev: Range,
    },
}

impl Domain {
    pub(super) fn new(input: DomainInput) -> Result<Self, FieldError> {
        match input {
            DomainInput::Grid { speed_m_min, feed_mm_rev } => {
                let speeds_m_min = speed_m_min.values(paths!("domain.grid.speed_m_min"), 1e-3, 1e5)?;
                let feeds_mm_rev = feed_mm_rev.values(paths!("domain.grid.feed_mm_rev"), 1e-6, 100.0)?;
                let count = speeds_m_min.len() * feeds_mm_rev.len();
                if count > MAX_GRID_PAIRS {
                    return Err(FieldError::new(
                        "domain.grid",
                        Problem::TooMany { count, max: MAX_GRID_PAIRS },
                    ));
                }
                Ok(Self::Grid { speeds_m_min, feeds_mm_rev })
            }
            DomainInput::Continuous { speed_m_min, feed_mm_rev } => Ok(Self::Continuous {
                speed_m_min: speed_m_min.check(paths!("domain.continuous.speed_m_min"), 1e-3, 1e5)?,
                feed_mm_rev: feed_mm_rev.check(paths!("domain.continuous.feed_mm_rev"), 1e-6, 100.0)?,
            }),
        }
    }
}

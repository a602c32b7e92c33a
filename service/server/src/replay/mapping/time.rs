//! When rows were taken.

use crate::replay::quantity::{Dimension, Unit, quantity};
use serde::Deserialize;

/// Longest distance of two rows, ms: a day. More is a slip of a unit.
const LONGEST_PERIOD_MS: f64 = 86_400_000.0;
/// Longest time between files or cycles, ms: ten years.
const LONGEST_GAP_MS: f64 = 3653.0 * 86_400_000.0;

/// When rows were taken: either one per period, or a column says.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimeRule {
    /// Distance of two rows, as in `"100 ms"`.
    pub period: Option<String>,
    /// The column that says when.
    pub column: Option<String>,
    /// What that column counts in: a unit of time from an arbitrary start, `unix_s`, `unix_ms` or `rfc3339`.
    pub unit: Option<String>,
    /// When the first row of the first file was taken, where rows do not say it; RFC 3339.
    pub start: Option<String>,
    /// Time between the end of a file and the start of the next, where rows do not say it.
    pub between_files: Option<String>,
    /// Time added between two cycles, where rows do not say it.
    pub between_cycles: Option<String>,
}

/// How rows are placed in time, once a [`TimeRule`] was checked.
#[derive(Debug, Clone, PartialEq)]
pub enum Clock {
    /// One row per period, ms.
    Period(f64),
    /// A column counts from an arbitrary start, in this unit.
    Counter(Unit),
    /// A column holds seconds since 1970, times this factor into µs.
    Unix(f64),
    /// A column holds RFC 3339.
    Rfc3339,
}

impl Clock {
    /// Whether rows themselves say the time of day.
    pub fn is_absolute(&self) -> bool {
        matches!(self, Self::Unix(_) | Self::Rfc3339)
    }
}

impl TimeRule {
    /// Which clock the rows follow.
    pub fn clock(&self) -> Result<Clock, String> {
        match (&self.period, &self.column, self.unit.as_deref()) {
            (Some(period), None, None) => {
                let period_ms = quantity(period, Dimension::Time)?;
                if period_ms > 0.0 && period_ms <= LONGEST_PERIOD_MS {
                    Ok(Clock::Period(period_ms))
                } else {
                    Err("time.period: must be above 0 and a day at most".to_owned())
                }
            }
            (None, Some(_), Some("rfc3339")) => Ok(Clock::Rfc3339),
            (None, Some(_), Some("unix_s")) => Ok(Clock::Unix(1e6)),
            (None, Some(_), Some("unix_ms")) => Ok(Clock::Unix(1e3)),
            (None, Some(_), Some(unit)) => match Unit::parse(unit)? {
                unit if unit.dimension == Dimension::Time => Ok(Clock::Counter(unit)),
                _ => Err(format!("time.unit: {unit:?} is no unit of time")),
            },
            _ => Err("time: needs either period, or column with unit".to_owned()),
        }
    }

    /// When the first row was taken, µs since 1970; `None` where rows say it.
    pub fn start_us(&self) -> Result<Option<i64>, String> {
        self.start
            .as_ref()
            .map(|text| {
                let time: jiff::Timestamp = text.parse().map_err(|error| format!("time.start: {error}"))?;
                Ok(time.as_microsecond())
            })
            .transpose()
    }

    /// Time between files and between cycles, ms.
    pub fn gaps_ms(&self) -> Result<(f64, f64), String> {
        let gap = |path: &str, text: &Option<String>| match text {
            None => Ok(0.0),
            Some(text) => match quantity(text, Dimension::Time)? {
                gap if (0.0..=LONGEST_GAP_MS).contains(&gap) => Ok(gap),
                _ => Err(format!("{path}: must not be negative, and ten years at most")),
            },
        };
        Ok((
            gap("time.between_files", &self.between_files)?,
            gap("time.between_cycles", &self.between_cycles)?,
        ))
    }

    pub(super) fn check(&self) -> Result<(), String> {
        let absolute = self.clock()?.is_absolute();
        let gaps = self.between_files.is_some() || self.between_cycles.is_some();
        match (absolute, self.start_us()?.is_some()) {
            (false, false) => Err("time.start: needed, because rows do not say the time of day".to_owned()),
            (true, true) => Err("time.start: rows themselves say the time of day".to_owned()),
            (true, false) if gaps => Err("time.between_…: rows themselves say the time of day".to_owned()),
            _ => self.gaps_ms().map(drop),
        }
    }
}

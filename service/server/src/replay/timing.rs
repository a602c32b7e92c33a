//! When a row was taken: from a period, a counter or a time of day.

use super::ReplayError;
use super::mapping::{Clock, TimeRule};
use super::plan::SampleTime;
use super::table::Table;
use std::ops::Range;

/// Farthest from 1970 that a time or a distance of times may be, µs: the calendar ends there (the year 9999). Some of them
/// added are far from what 64 bits hold.
const FARTHEST_US: i64 = 253_402_207_200_999_999;

/// Where a cycle lies in time.
pub(super) struct Placed {
    pub(super) started_us: i64,
    pub(super) duration_us: i64,
    pub(super) time: SampleTime,
}

/// Places the cycles of one file after another.
pub(super) struct Timeline {
    clock: Clock,
    column: String,
    between_files_us: i64,
    between_cycles_us: i64,
    /// Start of the current file, moved by every gap between its cycles.
    origin_us: i64,
    /// The first cell of a counter in this file; its rows count from there.
    first_counter_ms: Option<f64>,
    /// End of the last cycle placed.
    end_us: i64,
}

impl Timeline {
    pub(super) fn new(rule: &TimeRule) -> Result<Self, String> {
        let (files_ms, cycles_ms) = rule.gaps_ms()?;
        let start = rule.start_us()?.unwrap_or_default();
        Ok(Self {
            clock: rule.clock()?,
            column: rule.column.clone().unwrap_or_default(),
            between_files_us: micros(files_ms).ok_or(OFF_CALENDAR)?,
            between_cycles_us: micros(cycles_ms).ok_or(OFF_CALENDAR)?,
            origin_us: start,
            first_counter_ms: None,
            end_us: start,
        })
    }

    pub(super) fn place(&mut self, table: &Table, rows: &Range<usize>) -> Result<Placed, ReplayError> {
        let column = self.column.clone();
        let off_calendar = || off_calendar(table, rows.start, &column);
        let placed = match self.clock {
            Clock::Period(period_ms) => {
                let begins_us = micros(period_ms * count(rows.start)).ok_or_else(off_calendar)?;
                Placed {
                    started_us: on_calendar(self.origin_us + begins_us).ok_or_else(off_calendar)?,
                    duration_us: micros(period_ms * count(rows.len())).ok_or_else(off_calendar)?,
                    time: SampleTime::Period(period_ms),
                }
            }
            Clock::Counter(unit) => {
                let at = |row| Ok::<f64, ReplayError>(unit.convert(table.number(&self.column, row)?));
                let zero = match self.first_counter_ms {
                    Some(zero) => zero,
                    None => at(0)?,
                };
                self.first_counter_ms = Some(zero);
                let times = rows.clone().map(at).collect::<Result<Vec<f64>, _>>()?;
                let begins_us = micros(times[0] - zero).ok_or_else(off_calendar)?;
                let started_us = on_calendar(self.origin_us + begins_us).ok_or_else(off_calendar)?;
                stamped(started_us, &times).ok_or_else(off_calendar)?
            }
            Clock::Unix(factor) => {
                let us = |row| Ok::<f64, ReplayError>(table.number(&self.column, row)? * factor);
                let times = rows.clone().map(us).collect::<Result<Vec<f64>, _>>()?;
                let millis: Vec<f64> = times.iter().map(|us| (us - times[0]) / 1000.0).collect();
                let started_us = whole(times[0]).ok_or_else(off_calendar)?;
                stamped(started_us, &millis).ok_or_else(off_calendar)?
            }
            Clock::Rfc3339 => {
                let mut times = Vec::with_capacity(rows.len());
                for row in rows.clone() {
                    let cell = table.cell(&self.column, row)?;
                    let time: jiff::Timestamp = cell.parse().map_err(|_| {
                        table.refuse(row, &self.column, &format!("{cell:?} is no RFC 3339 time"))
                    })?;
                    times.push(time.as_microsecond());
                }
                let millis: Vec<f64> = times.iter().map(|us| exact(us - times[0]) / 1000.0).collect();
                stamped(times[0], &millis).ok_or_else(off_calendar)?
            }
        };
        let end_us = on_calendar(placed.started_us + placed.duration_us).ok_or_else(off_calendar)?;
        let origin_us = on_calendar(self.origin_us + self.between_cycles_us).ok_or_else(off_calendar)?;
        self.end_us = self.end_us.max(end_us);
        self.origin_us = origin_us;
        Ok(placed)
    }

    pub(super) fn end_file(&mut self, table: &Table) -> Result<(), ReplayError> {
        let column = self.column.clone();
        let off_calendar = || off_calendar(table, table.rows().saturating_sub(1), &column);
        let end_us = match self.clock {
            Clock::Period(period_ms) => {
                self.origin_us + micros(period_ms * count(table.rows())).ok_or_else(off_calendar)?
            }
            _ => self.end_us,
        };
        self.origin_us = on_calendar(end_us + self.between_files_us).ok_or_else(off_calendar)?;
        self.first_counter_ms = None;
        Ok(())
    }
}

/// What is said of times that are none.
const OFF_CALENDAR: &str = "a time leaves the calendar, which ends with the year 9999";

/// Refuses a row whose time is none: by its cell where a column says it, else by the mapping that has rows follow each other.
fn off_calendar(table: &Table, row: usize, column: &str) -> ReplayError {
    if column.is_empty() {
        return ReplayError::Mapping(format!("time: {OFF_CALENDAR}"));
    }
    table.refuse(row, column, OFF_CALENDAR)
}

fn stamped(started_us: i64, times_ms: &[f64]) -> Option<Placed> {
    let times: Vec<f64> = times_ms.iter().map(|time| time - times_ms[0]).collect();
    let duration_us = micros(times.last().copied().unwrap_or_default())?;
    Some(Placed { started_us, duration_us, time: SampleTime::Stamps(times) })
}

fn micros(millis: f64) -> Option<i64> {
    whole(millis * 1000.0)
}

#[expect(clippy::cast_possible_truncation, reason = "saturates, and what lies off the calendar is none")]
fn whole(number: f64) -> Option<i64> {
    if number.is_finite() { on_calendar(number.round() as i64) } else { None }
}

/// A time or a distance of times, µs, where the calendar has it.
fn on_calendar(us: i64) -> Option<i64> {
    (-FARTHEST_US..=FARTHEST_US).contains(&us).then_some(us)
}

#[expect(clippy::cast_precision_loss, reason = "differences of times within one file")]
fn exact(micros: i64) -> f64 {
    micros as f64
}

#[expect(clippy::cast_precision_loss, reason = "bounded by the rows of a file")]
fn count(rows: usize) -> f64 {
    rows as f64
}

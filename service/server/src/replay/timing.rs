//! When a row was taken: from a period, a counter or a time of day.

use super::ReplayError;
use super::mapping::{Clock, TimeRule};
use super::plan::SampleTime;
use super::table::Table;
use std::ops::Range;

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
            between_files_us: micros(files_ms),
            between_cycles_us: micros(cycles_ms),
            origin_us: start,
            first_counter_ms: None,
            end_us: start,
        })
    }

    pub(super) fn place(&mut self, table: &Table, rows: &Range<usize>) -> Result<Placed, ReplayError> {
        let placed = match self.clock {
            Clock::Period(period_ms) => Placed {
                started_us: self.origin_us + micros(period_ms * count(rows.start)),
                duration_us: micros(period_ms * count(rows.len())),
                time: SampleTime::Period(period_ms),
            },
            Clock::Counter(unit) => {
                let at = |row| Ok::<f64, ReplayError>(unit.convert(table.number(&self.column, row)?));
                let zero = match self.first_counter_ms {
                    Some(zero) => zero,
                    None => at(0)?,
                };
                self.first_counter_ms = Some(zero);
                let times = rows.clone().map(at).collect::<Result<Vec<f64>, _>>()?;
                stamped(self.origin_us + micros(times[0] - zero), &times)
            }
            Clock::Unix(factor) => {
                let us = |row| Ok::<f64, ReplayError>(table.number(&self.column, row)? * factor);
                let times = rows.clone().map(us).collect::<Result<Vec<f64>, _>>()?;
                let millis: Vec<f64> = times.iter().map(|us| (us - times[0]) / 1000.0).collect();
                stamped(whole(times[0]), &millis)
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
                stamped(times[0], &millis)
            }
        };
        self.origin_us += self.between_cycles_us;
        self.end_us = self.end_us.max(placed.started_us + placed.duration_us);
        Ok(placed)
    }

    pub(super) fn end_file(&mut self, rows: usize) {
        let end_us = match self.clock {
            Clock::Period(period_ms) => self.origin_us + micros(period_ms * count(rows)),
            _ => self.end_us,
        };
        self.origin_us = end_us + self.between_files_us;
        self.first_counter_ms = None;
    }
}

fn stamped(started_us: i64, times_ms: &[f64]) -> Placed {
    let times: Vec<f64> = times_ms.iter().map(|time| time - times_ms[0]).collect();
    let duration_us = micros(times.last().copied().unwrap_or_default());
    Placed { started_us, duration_us, time: SampleTime::Stamps(times) }
}

fn micros(millis: f64) -> i64 {
    whole(millis * 1000.0)
}

#[expect(clippy::cast_possible_truncation, reason = "saturates, and a time off the calendar is refused")]
fn whole(number: f64) -> i64 {
    number.round() as i64
}

#[expect(clippy::cast_precision_loss, reason = "differences of times within one file")]
fn exact(micros: i64) -> f64 {
    micros as f64
}

#[expect(clippy::cast_precision_loss, reason = "bounded by the rows of a file")]
fn count(rows: usize) -> f64 {
    rows as f64
}

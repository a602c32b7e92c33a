//! An operation with what it asked for over time, so that a cycle is judged by what was asked for when it began.

use super::Operation;
use crate::units::Timestamp;
use std::borrow::Cow;
use std::ops::Deref;

/// What an operation asks for from a time on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ask {
    /// From when on; the first one holds for what came before it as well.
    pub from: Timestamp,
    /// Depth that a complete cycle reaches, mm.
    pub depth_mm: Option<f64>,
    /// Commanded spindle speed, rpm.
    pub spindle_speed_rpm: Option<f64>,
}

/// What was asked for at a time, of what was asked for one after the other: the one that was in force, and before all of them the
/// first. A speed that nobody had told yet is the one that was told next: it says what was run all along. A depth that nobody had
/// asked for stays none: nothing was short of it.
pub fn asked_at(asks: &[Ask], at: Timestamp) -> Option<Ask> {
    let place = asks.iter().rposition(|ask| ask.from <= at).unwrap_or(0);
    let mut asked = *asks.get(place)?;
    asked.spindle_speed_rpm = asks[place..].iter().find_map(|ask| ask.spindle_speed_rpm);
    Some(asked)
}

/// An operation with what it has asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct DatedOperation {
    operation: Operation,
    asks: Vec<Ask>,
}

impl DatedOperation {
    /// Of an operation as it is, and what it asked for in the order of time.
    pub fn new(operation: Operation, asks: Vec<Ask>) -> Self {
        Self { operation, asks }
    }

    /// What it asked for at a time; `None` where that is not known.
    pub fn asked_at(&self, at: Timestamp) -> Option<Ask> {
        asked_at(&self.asks, at)
    }

    /// The operation as it is, but for what it asked for at a time.
    pub fn at(&self, at: Timestamp) -> Cow<'_, Operation> {
        let operation = &self.operation;
        let differs = |ask: &Ask| {
            (ask.depth_mm, ask.spindle_speed_rpm) != (operation.depth_mm, operation.spindle_speed_rpm)
        };
        match self.asked_at(at).filter(differs) {
            None => Cow::Borrowed(operation),
            Some(Ask { depth_mm, spindle_speed_rpm, .. }) => {
                Cow::Owned(Operation { depth_mm, spindle_speed_rpm, ..operation.clone() })
            }
        }
    }
}

impl Deref for DatedOperation {
    type Target = Operation;

    fn deref(&self) -> &Operation {
        &self.operation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(from: i64, depth_mm: Option<f64>, spindle_speed_rpm: Option<f64>) -> Ask {
        Ask { from: Timestamp::from_micros(from), depth_mm, spindle_speed_rpm }
    }

    #[test]
    fn what_was_in_force_is_what_was_asked_for() {
        let asks =
            [ask(0, Some(10.0), None), ask(100, Some(12.0), Some(2400.0)), ask(200, None, Some(2640.0))];
        let at = |at| {
            let asked = asked_at(&asks, Timestamp::from_micros(at)).unwrap();
            (asked.depth_mm, asked.spindle_speed_rpm)
        };
        assert_eq!(at(-5), (Some(10.0), Some(2400.0)), "before the first, and a speed that was told later");
        assert_eq!(at(99), (Some(10.0), Some(2400.0)));
        assert_eq!(at(100), (Some(12.0), Some(2400.0)));
        assert_eq!(at(1000), (None, Some(2640.0)));
        assert_eq!(asked_at(&[], Timestamp::from_micros(0)), None);
    }
}

//! Rows as the engines read and write them, and the way from there to records. No SQL and no engine's type here.

mod advice;
mod cut;
mod cycle;
mod facts;
mod feed_profile;
mod fleet;
mod library;
mod registry;
mod saved;
mod service;

pub(crate) use advice::{ProcessAdviceBody, ProfileAdviceBody};
pub(crate) use cut::{CutRow, EdgeCycleRow, ReportedCutRow, TurnedAs};
#[cfg(test)]
pub(crate) use cycle::tests::RANGES as CYCLE_RANGES;
pub(crate) use cycle::{CycleRow, CycleWithSamples, cycle_columns};
pub(crate) use facts::{EventRow, FactsRow, Place, PlacedEvent};
pub(crate) use feed_profile::{
    ActiveProfileRow, FeedProfileRow, ProfileVersionRow, is_content_of, wear_from_column,
};
pub(crate) use fleet::FleetCycleRow;
pub(crate) use library::{ModelRow, content_json, setup_json, setup_of};
pub(crate) use registry::{
    CalibrationRow, MachineRow, OperationRow, ToolRow, calibration_json, machine_json, operation_json,
    tool_json,
};
#[cfg(test)]
pub(crate) use saved::MOST_BLOCK_BYTES;
pub(crate) use saved::{
    ADVICE_HASH_BYTES, Advice, AlarmChange, BlockRow, IssuedRow, Rest, SavedState, SavedWear, advice_hash,
};
pub(crate) use service::{AdviceBody, AlarmRow, AuditRow, QuarantineRow, RecommendationRow, TokenRow};

use crate::error::{StoreError, StoreResult};
use crate::row_sum::Summed;
use feedwright_core::invalid::Violation;

/// The tables whose rows have a sum.
pub(crate) const SUMMED: [Summed; 5] =
    [MachineRow::SUMMED, CalibrationRow::SUMMED, ToolRow::SUMMED, OperationRow::SUMMED, ModelRow::SUMMED];

fn damaged(column: &str) -> StoreError {
    StoreError::Damaged { what: format!("column {column} holds what it must not") }
}

/// An identifier out of its column.
pub(crate) fn id<'a, T: TryFrom<&'a str, Error = Violation>>(column: &str, text: &'a str) -> StoreResult<T> {
    T::try_from(text).map_err(|_| damaged(column))
}

/// A word out of its column.
pub(crate) fn word<T>(column: &str, text: &str, parse: impl FnOnce(&str) -> Option<T>) -> StoreResult<T> {
    parse(text).ok_or_else(|| damaged(column))
}

/// A whole number out of its column.
pub(crate) fn number<T: TryFrom<i64>>(column: &str, value: i64) -> StoreResult<T> {
    T::try_from(value).map_err(|_| damaged(column))
}

/// A whole number on its way into a column.
pub(crate) fn count(column: &str, value: u64) -> StoreResult<i64> {
    i64::try_from(value).map_err(|_| StoreError::Refused { constraint: format!("{column} is too large") })
}

/// A float on its way into a column: finite, and never −0.0, which the engines do not keep alike.
pub(crate) fn float(column: &str, value: f64) -> StoreResult<f64> {
    if value.is_finite() {
        Ok(value + 0.0)
    } else {
        Err(StoreError::Refused { constraint: format!("{column} is not finite") })
    }
}

/// As [`float`], where there may be none.
pub(crate) fn optional_float(column: &str, value: Option<f64>) -> StoreResult<Option<f64>> {
    value.map(|value| float(column, value)).transpose()
}

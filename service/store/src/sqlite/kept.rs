//! How SQLite keeps the columns of a cycle that it has otherwise than they are read: decimals as whole thousandths, sums of what stands
//! beside them as that, an outcome as whether it is the seldom one. The tables' generated columns read them back.

use rusqlite::ToSql;
use rusqlite::types::{ToSqlOutput, ValueRef};

/// Numbers that are decimals of three places as a control tells them.
const DECIMALS: [&str; 16] = [
    "max_depth_mm",
    "max_spindle_load_percent",
    "max_spindle_load_depth_mm",
    "max_feed_drive_load_percent",
    "max_feed_drive_load_depth_mm",
    "max_spindle_power_depth_mm",
    "max_thrust_depth_mm",
    "max_torque_newton_metres",
    "max_torque_depth_mm",
    "spindle_load_fall_depth_mm",
    "reported_energy_joules",
    "reported_max_depth_mm",
    "reported_max_spindle_load_percent",
    "reported_max_feed_drive_load_percent",
    "reported_mean_spindle_load_percent",
    "reported_mean_feed_drive_load_percent",
];

/// Energies, each with its parts.
const SUMS: [[&str; 3]; 4] = [
    ["dynamometer_joules", "dynamometer_spindle_joules", "dynamometer_feed_drive_joules"],
    ["calibrated_joules", "calibrated_spindle_joules", "calibrated_feed_drive_joules"],
    ["measured_power_joules", "measured_power_spindle_joules", "measured_power_feed_drive_joules"],
    ["rated_power_joules", "rated_power_spindle_joules", "rated_power_feed_drive_joules"],
];

/// What ends the names of columns that are kept otherwise than they are read; but for [`OUTCOME`].
const ENDING: &str = "_stored";
const OUTCOME: [&str; 2] = ["outcome", "is_aborted"];

/// How a column of `cycles` is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Form {
    /// As it is.
    Plain,
    Decimal,
    /// With the names of its parts.
    Sum([&'static str; 2]),
    Outcome,
}

impl Form {
    pub(crate) const fn of(column: &str) -> Self {
        let mut at = 0;
        while at < DECIMALS.len() {
            if is_same(DECIMALS[at], column) {
                return Self::Decimal;
            }
            at += 1;
        }
        at = 0;
        while at < SUMS.len() {
            let [sum, spindle, feed_drive] = SUMS[at];
            if is_same(sum, column) {
                return Self::Sum([spindle, feed_drive]);
            }
            at += 1;
        }
        if is_same(OUTCOME[0], column) { Self::Outcome } else { Self::Plain }
    }

    /// The column that a column is kept in.
    pub(crate) fn kept_in(self, column: &str) -> String {
        match self {
            Self::Plain => column.to_owned(),
            Self::Decimal | Self::Sum(_) => format!("{column}{ENDING}"),
            Self::Outcome => OUTCOME[1].to_owned(),
        }
    }
}

/// Whether a column keeps what another one tells.
pub(crate) fn is_kept_for_another(column: &str) -> bool {
    column.ends_with(ENDING) || column == OUTCOME[1]
}

const fn is_same(a: &str, b: &str) -> bool {
    let (a, b) = (a.as_bytes(), b.as_bytes());
    if a.len() != b.len() {
        return false;
    }
    let mut at = 0;
    while at < a.len() {
        if a[at] != b[at] {
            return false;
        }
        at += 1;
    }
    true
}

/// A value on its way into a column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Cell<'a> {
    Null,
    Whole(i64),
    Float(f64),
    Text(&'a str),
    Bytes(&'a [u8]),
}

impl ToSql for Cell<'_> {
    fn to_sql(&self) -> rusqlite::Result<ToSqlOutput<'_>> {
        Ok(ToSqlOutput::Borrowed(match *self {
            Self::Null => ValueRef::Null,
            Self::Whole(value) => ValueRef::Integer(value),
            Self::Float(value) => ValueRef::Real(value),
            Self::Text(text) => ValueRef::Text(text.as_bytes()),
            Self::Bytes(bytes) => ValueRef::Blob(bytes),
        }))
    }
}

macro_rules! cells {
    ($($type:ty: |$value:ident| $cell:expr;)*) => {$(
        impl<'a> From<&'a $type> for Cell<'a> {
            fn from($value: &'a $type) -> Self {
                $cell
            }
        }
        impl<'a> From<&'a Option<$type>> for Cell<'a> {
            fn from(value: &'a Option<$type>) -> Self {
                value.as_ref().map_or(Self::Null, Into::into)
            }
        }
    )*};
}

cells! {
    i64: |value| Self::Whole(*value);
    f64: |value| Self::Float(*value);
    String: |text| Self::Text(text);
    Vec<u8>: |bytes| Self::Bytes(bytes);
}

impl<'a> Cell<'a> {
    /// The same as its column keeps it; an energy's parts are asked for by their names.
    pub(crate) fn kept(self, form: Form, part: impl Fn(&'static str) -> Option<f64>) -> Self {
        match (form, self) {
            (Form::Decimal, Self::Float(value)) => thousandths(value).map_or(self, Self::Whole),
            (Form::Sum([spindle, feed_drive]), Self::Float(value)) => {
                let sum = part(spindle).map(|spindle| spindle + part(feed_drive).unwrap_or(0.0));
                if sum.is_some_and(|sum| sum.to_bits() == value.to_bits()) { Self::Whole(1) } else { self }
            }
            (Form::Outcome, Self::Text(outcome)) => Self::Whole(i64::from(outcome == "aborted")),
            _ => self,
        }
    }
}

/// The thousandths that a number is exactly, as SQLite divides them.
#[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "held against the number")]
fn thousandths(value: f64) -> Option<i64> {
    // Beyond it not every whole number is a double.
    const MOST: f64 = 9e15;
    let scaled = (value * 1000.0).round();
    let whole = scaled as i64;
    (scaled.abs() < MOST && (whole as f64 / 1000.0).to_bits() == value.to_bits()).then_some(whole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rusqlite::types::Value;

    /// Out of a table like that of cycles, sorted by another column: what SQLite sorts it reads otherwise.
    fn read_back(cell: Cell<'_>) -> Value {
        let conn = rusqlite::Connection::open_in_memory().unwrap();
        conn.execute_batch(
            "CREATE TABLE t (x ANY GENERATED ALWAYS AS
                 (CASE typeof(x_stored) WHEN 'integer' THEN x_stored / 1000.0 ELSE x_stored END) VIRTUAL,
                 x_stored ANY, k INTEGER) STRICT",
        )
        .unwrap();
        conn.execute("INSERT INTO t (x_stored, k) VALUES (?, 2)", [cell]).unwrap();
        conn.execute("INSERT INTO t (x_stored, k) VALUES (?, 1)", [cell]).unwrap();
        conn.query_row("SELECT x FROM t ORDER BY k LIMIT 1", (), |row| row.get(0)).unwrap()
    }

    #[test]
    fn decimals_are_thousandths_and_others_are_as_they_are() {
        let kept = |value| Cell::Float(value).kept(Form::Decimal, |_| None);
        assert_eq!(kept(19.348), Cell::Whole(19_348));
        assert_eq!(kept(-0.001), Cell::Whole(-1));
        assert_eq!(kept(36.0), Cell::Whole(36_000));
        for other in [1.0 / 3.0, 0.1 + 0.2, -0.0, 1e18, 9.007e15, f64::MIN_POSITIVE, 0.0005] {
            assert_eq!(kept(other), Cell::Float(other), "{other}");
        }
        assert_eq!(Cell::Null.kept(Form::Decimal, |_| None), Cell::Null);
    }

    #[test]
    fn an_energy_that_is_its_parts_is_not_kept_beside_them() {
        let Form::Sum(parts) = Form::of("rated_power_joules") else { panic!("it is a sum") };
        let of = |spindle, feed_drive| move |part| if part == parts[0] { spindle } else { feed_drive };
        let kept = |value, part| Cell::Float(value).kept(Form::Sum(parts), part);
        assert_eq!(kept(0.1 + 0.2, of(Some(0.1), Some(0.2))), Cell::Whole(1));
        assert_eq!(kept(0.3, of(Some(0.1), Some(0.2))), Cell::Float(0.3));
        assert_eq!(kept(0.1, of(Some(0.1), None)), Cell::Whole(1));
        assert_eq!(kept(0.1, of(None, Some(0.1))), Cell::Float(0.1));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn what_is_kept_is_read_back_to_the_bit(value in prop_oneof![
            (-100_000_000_i64..100_000_000).prop_map(|m| m as f64 / 1000.0),
            (-100_000_000_i64..100_000_000).prop_map(|m| m as f64 / 10_000.0),
            -1e18..1e18,
            -1.0..1.0,
        ]) {
            let value: f64 = value + 0.0;
            let kept = Cell::Float(value).kept(Form::Decimal, |_| None);
            let Value::Real(read) = read_back(kept) else { panic!("no double") };
            prop_assert_eq!(read.to_bits(), value.to_bits());
        }
    }
}

//! Sums over the rows of what people register: a number that a disk has changed is not to be advised by as if it were right.
//!
//! A sum is made over what is written, before it is, and stands in the row (`row_sum`) beside the version that it is of (`summed_version`).
//! It is of values by their columns' names, so that both engines have the same one and copies take it along; a column that is added later
//! has to be null where it says nothing, as a null is in no sum. A row is what it was where its sum is; without one nothing is known.

use crate::record::Through;
use crate::stored_text::StoredText;
use crate::transfer::Value;

/// Where the sum stands.
pub(crate) const ROW_SUM: &str = "row_sum";
/// Where the version stands that it is of.
pub(crate) const SUMMED_VERSION: &str = "summed_version";
/// Where the row's own version stands.
pub(crate) const VERSION: &str = "version";

/// The columns of a table that are in the sum of its rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Summed {
    pub(crate) table: &'static str,
    pub(crate) columns: &'static [&'static str],
}

/// Who may write rows besides servers that sum them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Writers {
    /// Nobody: a version that differs is as wrong as any other value.
    Alone,
    /// Servers of before, while all are upgraded one by one. They count the version up, and leave the sum as it was.
    BesideOlder,
}

/// What the sum of a row says of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Standing {
    /// It is what was written.
    Sound,
    /// There is no sum of this version: nothing is known.
    Unsummed,
    /// It is not what was written.
    Damaged,
}

impl Summed {
    /// The sum over the values of these columns, in their order.
    pub(crate) fn over<'v>(&self, values: impl IntoIterator<Item = &'v Value>) -> i64 {
        let mut hasher = blake3::Hasher::new();
        hasher.update(b"feedwright row v1\n").update(self.table.as_bytes()).update(b"\n");
        for (column, value) in self.columns.iter().zip(values) {
            let mut add = |kind: u8, bytes: &[u8]| {
                hasher.update(column.as_bytes()).update(&[b'\n', kind]);
                hasher.update(&(bytes.len() as u64).to_le_bytes()).update(bytes);
            };
            match value {
                Value::Null => {}
                Value::Whole(value) => add(1, &value.to_le_bytes()),
                Value::Float(value) => add(2, &value.to_bits().to_le_bytes()),
                Value::Text(text) => add(3, text.as_bytes()),
                Value::Bytes(bytes) => add(4, bytes),
            }
        }
        let hash = hasher.finalize();
        let (first, _) = hash.as_bytes().split_first_chunk().unwrap_or((&[0; 8], &[]));
        i64::from_le_bytes(*first)
    }
}

impl Standing {
    /// Of a row of that version, whose sum is kept with the version that it is of.
    pub(crate) fn of(
        (row_sum, summed_version): (Option<i64>, Option<i64>),
        version: i64,
        writers: Writers,
        again: impl FnOnce() -> i64,
    ) -> Self {
        let (row_sum, summed_version) = match (row_sum, summed_version) {
            (None, None) => return Self::Unsummed,
            (Some(row_sum), Some(summed_version)) => (row_sum, summed_version),
            // They are written together.
            _ => return Self::Damaged,
        };
        if writers == Writers::BesideOlder && summed_version < version {
            return Self::Unsummed;
        }
        if summed_version == version && row_sum == again() { Self::Sound } else { Self::Damaged }
    }
}

/// A column's value, as both engines have it.
pub(crate) trait Part {
    fn part(&self) -> Value;
}

impl Part for StoredText {
    fn part(&self) -> Value {
        match self.as_str() {
            Some(text) => Value::Text(text.to_owned()),
            // No text that was ever written.
            None => Value::Bytes(self.shown().into_bytes()),
        }
    }
}

impl Part for String {
    fn part(&self) -> Value {
        Value::Text(self.clone())
    }
}

impl Part for i64 {
    fn part(&self) -> Value {
        Value::Whole(*self)
    }
}

impl Part for f64 {
    fn part(&self) -> Value {
        Value::Float(*self)
    }
}

impl<T: Part> Part for Option<T> {
    fn part(&self) -> Value {
        self.as_ref().map_or(Value::Null, Part::part)
    }
}

/// Where the sums of rows were looked at last: after that key of that table.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SummedTo {
    pub(crate) table: usize,
    pub(crate) after: Through<(StoredText, StoredText, i64)>,
}

/// What was found of the sums of a page of rows.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SumPage {
    /// Rows that have no sum of their version.
    pub unsummed: u64,
    /// Rows that are not what was written, each with its table.
    pub damaged: Vec<String>,
    /// Where to go on; `None` at the end.
    pub next: Option<SummedTo>,
}

/// Has a row summed over fields that are named as their columns are.
macro_rules! summed {
    ($row:ident of $table:literal: $($column:ident),* $(,)?) => {
        impl $row {
            /// What is in its sum.
            pub(crate) const SUMMED: $crate::row_sum::Summed =
                $crate::row_sum::Summed { table: $table, columns: &[$(stringify!($column)),*] };

            /// Its sum as it is.
            pub(crate) fn sum(&self) -> i64 {
                Self::SUMMED.over(&[$($crate::row_sum::Part::part(&self.$column)),*])
            }

            /// With its sum: as it is to be written.
            pub(crate) fn with_sum(mut self) -> Self {
                self.row_sum = Some(self.sum());
                self.summed_version = Some(self.version);
                self
            }

            /// What its sum says of it.
            pub(crate) fn standing(&self, writers: $crate::row_sum::Writers) -> $crate::row_sum::Standing {
                let kept = (self.row_sum, self.summed_version);
                $crate::row_sum::Standing::of(kept, self.version, writers, || self.sum())
            }

            pub(crate) fn is_damaged(&self, writers: $crate::row_sum::Writers) -> bool {
                self.standing(writers) == $crate::row_sum::Standing::Damaged
            }
        }
    };
}
pub(crate) use summed;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::{MachineRow, SUMMED};
    use Writers::{Alone, BesideOlder};
    use proptest::prelude::*;

    #[test]
    fn a_sum_of_an_earlier_version_says_nothing_where_servers_of_before_may_write() {
        let of = |kept, version, writers| Standing::of(kept, version, writers, || 7);
        for writers in [Alone, BesideOlder] {
            assert_eq!(of((None, None), 3, writers), Standing::Unsummed);
            assert_eq!(of((Some(7), Some(3)), 3, writers), Standing::Sound);
            assert_eq!(of((Some(8), Some(3)), 3, writers), Standing::Damaged);
            assert_eq!(of((Some(7), Some(4)), 3, writers), Standing::Damaged, "no server counts back");
            assert_eq!(of((Some(7), None), 3, writers), Standing::Damaged);
            assert_eq!(of((None, Some(3)), 3, writers), Standing::Damaged);
        }
        assert_eq!(of((Some(7), Some(2)), 3, BesideOlder), Standing::Unsummed);
        assert_eq!(of((Some(7), Some(2)), 3, Alone), Standing::Damaged);
    }

    /// Whatever stands in databases was summed so.
    #[test]
    fn a_sum_is_the_same_for_ever() {
        let summed = Summed { table: "machines", columns: &["a", "b", "c", "d"] };
        let row = [Value::Text("M1".to_owned()), Value::Float(3000.0), Value::Null, Value::Whole(-1)];
        assert_eq!(summed.over(&row), SUM_OF_BEFORE);
        let later = Summed { columns: &["a", "b", "later", "d"], ..summed };
        assert_eq!(later.over(&row), SUM_OF_BEFORE, "a null is in no sum");
    }

    const SUM_OF_BEFORE: i64 = 2_771_236_531_098_704_607;

    fn value() -> impl Strategy<Value = Value> {
        prop_oneof![
            Just(Value::Null),
            any::<i64>().prop_map(Value::Whole),
            any::<f64>().prop_map(Value::Float),
            "[a-z\\n]{0,4}".prop_map(Value::Text),
            proptest::collection::vec(any::<u8>(), 0..4).prop_map(Value::Bytes),
        ]
    }

    /// By bits: what is no number is another one than itself.
    fn is_same(one: &Value, other: &Value) -> bool {
        match (one, other) {
            (Value::Float(one), Value::Float(other)) => one.to_bits() == other.to_bits(),
            _ => one == other,
        }
    }

    proptest! {
        #[test]
        fn any_column_that_is_another_makes_another_sum(
            (table, at, row, other) in (0..SUMMED.len()).prop_flat_map(|table| {
                let columns = SUMMED[table].columns.len();
                (Just(table), 0..columns, proptest::collection::vec(value(), columns), value())
            }),
        ) {
            let sum = SUMMED[table].over(&row);
            let mut changed = row.clone();
            let same = is_same(&changed[at], &other);
            changed[at] = other;
            prop_assert_eq!(SUMMED[table].over(&changed) == sum, same);
            // What stands in one column is not taken for what stands in the next.
            let next = (at + 1) % row.len();
            let mut swapped = row.clone();
            swapped.swap(at, next);
            prop_assert_eq!(SUMMED[table].over(&swapped) == sum, is_same(&row[at], &row[next]));
        }

        #[test]
        fn a_bit_of_a_limit_makes_another_sum(bit in 0..64_u32, of in 0..4_usize) {
            let limits = feedwright_core::machine::FeedLimits::new(1.0, 3000.0, 5.0, 200.0).unwrap();
            let machine = feedwright_core::machine::Machine {
                limits,
                ..feedwright_core::machine::Machine::unknown("M1".try_into().unwrap())
            };
            let now = feedwright_core::units::Timestamp::from_micros(7);
            let sound = MachineRow::of(&machine, 3, now).unwrap();
            prop_assert_eq!(sound.standing(Alone), Standing::Sound);
            let mut row = sound.clone();
            let limit = [
                &mut row.feed_min_mm_min,
                &mut row.feed_max_mm_min,
                &mut row.override_min_percent,
                &mut row.override_max_percent,
            ];
            for limit in limit.into_iter().skip(of).take(1) {
                *limit = f64::from_bits(limit.to_bits() ^ (1 << bit));
            }
            prop_assert_eq!(row.standing(Alone), Standing::Damaged);
            prop_assert_eq!(row.standing(BesideOlder), Standing::Damaged);
            // Nor is a bit of the sum anything else.
            let row_sum = sound.row_sum.map(|sum| sum ^ (1 << bit));
            prop_assert_eq!(MachineRow { row_sum, ..sound }.standing(Alone), Standing::Damaged);
        }
    }
}

//! The operations that the cycles of a fold ran: a change of another one is no change of the fold, which is told without looking at a cycle.
//!
//! ```text
//! varint cycles      that were counted when this was noted
//! per operation      in the order of their bytes
//!   u8 length        0: there are too many, and none follows
//!   its id
//!   i64              when the first of its cycles began, µs
//! ```

use super::input::{Input, put_varint};
use std::collections::BTreeMap;

/// Most operations that are noted of one fold, as its row is written with each group: some 5 kB. Of more it is told that there are too many.
const MOST: usize = 256;

/// What the cycles of a fold ran.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Ran {
    /// These operations, each with when the first of its cycles began, µs.
    These(BTreeMap<String, i64>),
    /// More than are noted.
    TooMany,
}

impl Ran {
    /// Before any cycle.
    pub(crate) const fn nothing() -> Self {
        Self::These(BTreeMap::new())
    }

    /// Notes that a cycle which began then ran an operation.
    pub(crate) fn note(&mut self, operation: &str, started_at_us: i64) {
        let Self::These(these) = self else { return };
        if let Some(first) = these.get_mut(operation) {
            *first = started_at_us.min(*first);
        } else if these.len() < MOST {
            these.insert(operation.to_owned(), started_at_us);
        } else {
            *self = Self::TooMany;
        }
    }

    /// With what others noted.
    pub(crate) fn and(mut self, other: &Self) -> Self {
        match other {
            Self::These(these) => these.iter().for_each(|(operation, first)| self.note(operation, *first)),
            Self::TooMany => self = Self::TooMany,
        }
        self
    }

    /// As it is stored, with how many cycles were counted.
    pub(crate) fn to_bytes(&self, folded: u64) -> Vec<u8> {
        let mut out = Vec::new();
        put_varint(&mut out, folded);
        match self {
            Self::These(these) => {
                for (operation, first) in these {
                    // An id is shorter; what is not is not read again.
                    out.push(u8::try_from(operation.len()).unwrap_or(u8::MAX));
                    out.extend_from_slice(operation.as_bytes());
                    out.extend_from_slice(&first.to_le_bytes());
                }
            }
            Self::TooMany => out.push(0),
        }
        out
    }

    /// What was stored with as many cycles; `None` where it was with others, or is damaged.
    pub(crate) fn from_bytes(bytes: &[u8], folded: u64) -> Option<Self> {
        let mut input = Input(bytes);
        if input.varint().ok()? != folded {
            return None;
        }
        if input.0 == [0] {
            return Some(Self::TooMany);
        }
        let mut these: BTreeMap<String, i64> = BTreeMap::new();
        while !input.0.is_empty() {
            let length = input.byte().ok().filter(|length| *length > 0)?;
            let operation = std::str::from_utf8(input.take(usize::from(length)).ok()?).ok()?;
            let first = i64::from_le_bytes(*input.take(size_of::<i64>()).ok()?.first_chunk()?);
            let is_next = these.last_key_value().is_none_or(|(last, _)| last.as_str() < operation);
            if !is_next || these.len() == MOST {
                return None;
            }
            these.insert(operation.to_owned(), first);
        }
        Some(Self::These(these))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_noted_is_read_again_by_a_fold_of_as_many_cycles() {
        let mut ran = Ran::nothing();
        assert_eq!(Ran::from_bytes(&ran.to_bytes(0), 0), Some(ran.clone()));
        for (operation, at) in [("O2", 7), ("O1", i64::MAX), ("O2", -5), ("O1", 3), ("O2", 9)] {
            ran.note(operation, at);
        }
        assert_eq!(ran, Ran::These(BTreeMap::from([("O1".to_owned(), 3), ("O2".to_owned(), -5)])));
        let stored = ran.to_bytes(500);
        assert_eq!((Ran::from_bytes(&stored, 500), Ran::from_bytes(&stored, 501)), (Some(ran), None));
        for cut in 0..stored.len() {
            let whole = [2, 2 + 11].contains(&cut);
            assert_eq!(Ran::from_bytes(&stored[..cut], 500).is_some(), whole, "{cut}");
        }
    }

    #[test]
    fn what_others_noted_is_noted_too() {
        let noted = |of: &[(&str, i64)]| {
            let mut ran = Ran::nothing();
            of.iter().for_each(|(operation, at)| ran.note(operation, *at));
            ran
        };
        let both = noted(&[("O1", 3), ("O2", 5)]).and(&noted(&[("O2", 4), ("O3", 9)]));
        assert_eq!(both, noted(&[("O1", 3), ("O2", 4), ("O3", 9)]));
        assert_eq!(noted(&[("O1", 3)]).and(&Ran::TooMany), Ran::TooMany);
        assert_eq!(Ran::TooMany.and(&noted(&[("O1", 3)])), Ran::TooMany);
    }

    #[test]
    fn of_too_many_it_is_told_that_there_are() {
        let mut ran = Ran::nothing();
        for number in 0..MOST {
            ran.note(&format!("O{number}"), 1);
        }
        assert!(matches!(&ran, Ran::These(these) if these.len() == MOST));
        assert_eq!(Ran::from_bytes(&ran.to_bytes(9), 9), Some(ran.clone()));
        ran.note("another", 1);
        ran.note("O1", 1);
        assert_eq!(ran, Ran::TooMany);
        assert_eq!(
            (Ran::from_bytes(&ran.to_bytes(9), 9), Ran::from_bytes(&ran.to_bytes(9), 8)),
            (Some(ran), None)
        );
    }

    #[test]
    fn what_is_damaged_is_not_believed() {
        for damaged in [
            &b"\x01\x02O2\0\0\0\0\0\0\0\0\x02O1\0\0\0\0\0\0\0\0"[..],
            b"\x01\x01\xff\0\0\0\0\0\0\0\0",
            b"\x01\0\0",
            b"",
        ] {
            assert_eq!(Ran::from_bytes(damaged, 1), None, "{damaged:?}");
        }
    }
}

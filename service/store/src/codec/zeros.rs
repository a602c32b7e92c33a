//! Bytes with long runs of zeros (small counts in wide integers, whole numbers as doubles) without them.
//!
//! A zero is followed by how many there are, 1 to 255; every other byte stands for itself. What is not packed is known
//! by its first byte.

use std::borrow::Cow;

/// Begins packed bytes. A fold's state begins with the low byte of its version, which is far from it.
const PACKED: u8 = 0xff;
/// Longest run in one pair.
const LONGEST: usize = 255;

/// Packs bytes that do not begin with [`PACKED`].
pub(crate) fn pack(plain: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(1 + plain.len());
    out.push(PACKED);
    let mut rest = plain;
    while let Some(&first) = rest.first() {
        let run = rest.iter().take(LONGEST).take_while(|&&byte| (byte == 0) == (first == 0)).count();
        let (run, later) = rest.split_at(run);
        rest = later;
        if first == 0 {
            out.extend([0, u8::try_from(run.len()).unwrap_or(u8::MAX)]);
        } else {
            out.extend_from_slice(run);
        }
    }
    out
}

/// The bytes as they were, at most `most` of them; `None` where they are damaged or more. What was never packed comes
/// back as it is.
pub(crate) fn unpack(bytes: &[u8], most: usize) -> Option<Cow<'_, [u8]>> {
    let Some((&PACKED, mut rest)) = bytes.split_first() else {
        return Some(Cow::Borrowed(bytes));
    };
    let mut out = Vec::with_capacity(bytes.len().saturating_mul(2).min(most));
    while let Some((&byte, later)) = rest.split_first() {
        rest = later;
        if byte == 0 {
            let (&run, later) = rest.split_first().filter(|(run, _)| **run > 0)?;
            rest = later;
            out.resize(out.len() + usize::from(run), 0);
        } else {
            out.push(byte);
        }
        if out.len() > most {
            return None;
        }
    }
    Some(Cow::Owned(out))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn runs_become_pairs_and_damage_is_refused() {
        assert_eq!(pack(&[3, 0, 0, 0, 7, 0]), [0xff, 3, 0, 3, 7, 0, 1]);
        assert_eq!(pack(&[]), [0xff]);
        let long = [vec![1], vec![0; 300]].concat();
        assert_eq!(pack(&long), [0xff, 1, 0, 255, 0, 45]);
        assert_eq!(unpack(&pack(&long), 301).as_deref(), Some(long.as_slice()));
        assert_eq!(unpack(&pack(&long), 300), None, "longer than its reader allows");
        assert_eq!(unpack(&[0xff, 1, 0], 9), None, "a run without its length");
        assert_eq!(unpack(&[0xff, 1, 0, 0], 9), None, "a run of none");
        assert_eq!(unpack(&[3, 0, 0], 9).as_deref(), Some([3, 0, 0].as_slice()), "never packed");
    }

    proptest! {
        #[test]
        fn everything_comes_back(
            plain in prop::collection::vec(prop_oneof![3 => Just(0_u8), 2 => any::<u8>()], 0..2000),
        ) {
            prop_assume!(plain.first() != Some(&PACKED));
            let packed = pack(&plain);
            let unpacked = unpack(&packed, plain.len());
            prop_assert_eq!(unpacked.as_deref(), Some(plain.as_slice()));
        }

        #[test]
        fn damage_never_takes_more_than_is_allowed(bytes in prop::collection::vec(any::<u8>(), 0..500)) {
            if let Some(Cow::Owned(plain)) = unpack(&[&[PACKED], bytes.as_slice()].concat(), 100) {
                prop_assert!(plain.len() <= 100);
            }
        }
    }
}

//! Bytes with long runs of zeros (small counts in wide integers, whole numbers as doubles) without them.
//!
//! A zero is followed by how many there are, 1 to 255; every other byte stands for itself. What is not packed is known
//! by its first byte.

use std::borrow::Cow;

/// Begins packed bytes. A fold's state begins with the low byte of its version, which is far from it.
const PACKED: u8 = 0xff;

/// Packs bytes that do not begin with [`PACKED`].
pub(crate) fn pack(plain: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(1 + plain.len() + plain.len() / 2);
    out.push(PACKED);
    // Zeros at the end of the bytes before, which those that follow may go on with.
    let mut zeros = 0;
    for bytes in plain.chunks(MAPPED) {
        let mut map = zeros_of(bytes);
        let mut rest = bytes;
        while !rest.is_empty() {
            // Where the map says more than there is left, nothing follows.
            let ones = map.trailing_ones();
            let run = (ones as usize).min(rest.len());
            zeros += run;
            rest = &rest[run..];
            if rest.is_empty() {
                break;
            }
            put_zeros(&mut out, zeros);
            zeros = 0;
            map = map.unbounded_shr(ones);
            let others = map.trailing_zeros();
            map = map.unbounded_shr(others);
            let (others, later) = rest.split_at((others as usize).min(rest.len()));
            out.extend_from_slice(others);
            rest = later;
        }
    }
    put_zeros(&mut out, zeros);
    // Mostly zeros were there: far more was asked for than is kept, and a group keeps the state of each of its tools.
    out.shrink_to_fit();
    out
}

/// Bytes that are looked at together.
const MAPPED: usize = 64;

/// A bit for each of at most [`MAPPED`] bytes, the first one lowest, set where it is zero.
fn zeros_of(bytes: &[u8]) -> u64 {
    let (words, rest) = bytes.as_chunks::<8>();
    let map = words.iter().enumerate().fold(0, |map, (at, word)| map | zeros_of_word(*word) << (8 * at));
    let after = 8 * words.len();
    rest.iter().enumerate().fold(map, |map, (at, &byte)| map | u64::from(byte == 0) << (after + at))
}

/// The same of eight bytes at once.
const fn zeros_of_word(bytes: [u8; 8]) -> u64 {
    const LOW: u64 = 0x7f7f_7f7f_7f7f_7f7f;
    let word = u64::from_le_bytes(bytes);
    // The highest bit of a byte, where the byte is zero: nothing is carried from one to the next.
    let zeros = !(((word & LOW) + LOW) | word | LOW);
    // Those eight bits next to each other, at the top.
    (zeros >> 7).wrapping_mul(0x0102_0408_1020_4080) >> 56
}

fn put_zeros(out: &mut Vec<u8>, mut count: usize) {
    while count > 0 {
        let run = u8::try_from(count).unwrap_or(u8::MAX);
        out.extend([0, run]);
        count -= usize::from(run);
    }
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
        fn many_at_once_are_packed_as_one_by_one(
            plain in prop::collection::vec(prop_oneof![4 => Just(0_u8), 1 => any::<u8>()], 0..2000),
            run in 0..600_usize,
        ) {
            let plain = [plain.as_slice(), &vec![0; run], &plain].concat();
            let mut one_by_one = vec![PACKED];
            for bytes in plain.chunk_by(|a, b| (*a == 0) == (*b == 0)) {
                if bytes[0] == 0 {
                    bytes.chunks(255).for_each(|zeros| one_by_one.extend([0, u8::try_from(zeros.len()).unwrap()]));
                } else {
                    one_by_one.extend_from_slice(bytes);
                }
            }
            prop_assert_eq!(pack(&plain), one_by_one);
        }

        #[test]
        fn damage_never_takes_more_than_is_allowed(bytes in prop::collection::vec(any::<u8>(), 0..500)) {
            if let Some(Cow::Owned(plain)) = unpack(&[&[PACKED], bytes.as_slice()].concat(), 100) {
                prop_assert!(plain.len() <= 100);
            }
        }
    }
}

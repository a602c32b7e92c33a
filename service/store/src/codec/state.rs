//! A fold's state as it is stored: its runs of zeros packed (`zeros.rs`), and that once more by zstd where it is shorter by it.
//!
//! ```text
//! 0xfe   u32 length   a zstd frame of as many bytes, which are as below
//! 0xff   with runs of zeros, see `zeros.rs`
//! other  the state itself
//! ```

use super::{squeeze, zeros};
use std::borrow::Cow;

/// Begins what zstd has made of a packed state.
const SQUEEZED: u8 = 0xfe;
const HEAD: usize = 5;

/// Fast: what is won is that a state of some 4 KB fits a page of SQLite's, and level 1, for more than twice the time, wins no second page.
const LEVEL: i32 = -3;

/// The stored form of a state, which begins with neither of the two bytes.
pub(crate) fn pack(plain: &[u8]) -> Vec<u8> {
    let packed = zeros::pack(plain);
    let squeezed = squeeze::compress(&packed, LEVEL).filter(|squeezed| HEAD + squeezed.len() < packed.len());
    let (Some(squeezed), Ok(length)) = (squeezed, u32::try_from(packed.len())) else { return packed };
    let mut out = Vec::with_capacity(HEAD + squeezed.len());
    out.push(SQUEEZED);
    out.extend_from_slice(&length.to_le_bytes());
    out.extend_from_slice(&squeezed);
    out
}

/// The state of a stored form, at most `most` bytes; `None` where it is damaged or longer.
pub(crate) fn unpack(stored: &[u8], most: usize) -> Option<Cow<'_, [u8]>> {
    let Some((&SQUEEZED, rest)) = stored.split_first() else {
        return zeros::unpack(stored, most);
    };
    let (length, squeezed) = rest.split_first_chunk()?;
    let length = usize::try_from(u32::from_le_bytes(*length)).ok()?;
    // Packing makes a state longer by no more than a run's length for each single zero.
    let packed = (length <= most.saturating_mul(2)).then(|| squeeze::decompress(squeezed, length).ok())??;
    zeros::unpack(&packed, most).map(|plain| Cow::Owned(plain.into_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn all_forms_are_read() {
        let plain = [b"a state of before".as_slice(), &[0; 40], b" that says a state of before"].concat();
        let squeezed = pack(&[plain.as_slice(); 20].concat());
        assert_eq!(squeezed[0], SQUEEZED);
        assert!(squeezed.len() < 200, "{}", squeezed.len());
        assert_eq!(
            unpack(&squeezed, 20 * plain.len()).as_deref(),
            Some([plain.as_slice(); 20].concat().as_slice())
        );
        assert_eq!(unpack(&squeezed, 20 * plain.len() - 1), None, "longer than its reader allows");
        assert_eq!(unpack(&zeros::pack(&plain), 1000).as_deref(), Some(plain.as_slice()));
        assert_eq!(unpack(&plain, 1000).as_deref(), Some(plain.as_slice()));
        for cut in 1..squeezed.len() {
            assert_eq!(unpack(&squeezed[..cut], 10_000), None, "{cut}");
        }
        let bomb = [&[SQUEEZED], u32::MAX.to_le_bytes().as_slice(), &squeezed[HEAD..]].concat();
        assert_eq!(unpack(&bomb, 10_000), None);
    }

    proptest! {
        #[test]
        fn everything_comes_back(
            plain in prop::collection::vec(prop_oneof![3 => Just(0_u8), 2 => 0_u8..9, 1 => any::<u8>()], 0..3000),
        ) {
            prop_assume!(!matches!(plain.first(), Some(&(SQUEEZED | 0xff))));
            let stored = pack(&plain);
            prop_assert!(stored.len() <= zeros::pack(&plain).len());
            let unpacked = unpack(&stored, plain.len());
            prop_assert_eq!(unpacked.as_deref(), Some(plain.as_slice()));
        }

        #[test]
        fn damage_never_takes_more_than_is_allowed(bytes in prop::collection::vec(any::<u8>(), 0..500)) {
            if let Some(Cow::Owned(plain)) = unpack(&[&[SQUEEZED], bytes.as_slice()].concat(), 100) {
                prop_assert!(plain.len() <= 100);
            }
        }
    }
}

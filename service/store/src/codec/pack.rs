//! Blocks that are written together, in one row of SQLite's: a pack.
//!
//! ```text
//! "FP"  u8 version = 1
//! u8 number of places        1 ..= 64
//! per place varint length    0: what stood there is dropped
//! u32 first four bytes of blake3 over everything before
//! the blocks, one after the other
//! ```
//!
//! A block alone is a pack as it is, of one place, as long as it does not begin like one of several. Each block has a checksum of
//! its own; that of the pack is over where they are.

use super::input::{Input, put_varint};
use crate::error::{StoreError, StoreResult};
use std::borrow::Cow;
use std::ops::Range;

const MAGIC: [u8; 2] = *b"FP";
const VERSION: u8 = 1;
const CHECKSUM: usize = 4;

/// Most places of a pack. The table is checked against the same.
pub(crate) const MOST_PLACES: usize = 64;

/// A pack is not made longer than this, but by one block alone: whoever reads a block reads its pack.
const USUAL_BYTES: usize = 32 << 10;

/// Cuts blocks, each of such a length, into packs: how many of the next ones make one.
pub(crate) fn together(lengths: impl Iterator<Item = usize>) -> usize {
    let mut sum = 0_usize;
    lengths
        .take(MOST_PLACES)
        .enumerate()
        .take_while(|(at, length)| {
            sum = sum.saturating_add(*length);
            *at == 0 || sum <= USUAL_BYTES
        })
        .count()
}

/// The pack of some blocks, at most as many as [`together`] says.
pub(crate) fn pack<'a>(blocks: &[&'a [u8]]) -> Cow<'a, [u8]> {
    match blocks {
        [block] if !block.starts_with(&MAGIC) => Cow::Borrowed(block),
        blocks => Cow::Owned(several(blocks)),
    }
}

fn several(blocks: &[&[u8]]) -> Vec<u8> {
    let length = blocks.iter().map(|block| block.len()).sum::<usize>();
    let mut out = Vec::with_capacity(16 + 3 * blocks.len() + length);
    out.extend_from_slice(&MAGIC);
    out.push(VERSION);
    out.push(u8::try_from(blocks.len()).unwrap_or(u8::MAX));
    blocks.iter().for_each(|block| put_varint(&mut out, block.len() as u64));
    let checksum = checksum(&out);
    out.extend_from_slice(&checksum);
    blocks.iter().for_each(|block| out.extend_from_slice(block));
    out
}

fn checksum(directory: &[u8]) -> [u8; CHECKSUM] {
    let mut first = [0; CHECKSUM];
    first.copy_from_slice(&blake3::hash(directory).as_bytes()[..CHECKSUM]);
    first
}

/// The block at a place of a pack.
///
/// # Errors
///
/// [`StoreError::Damaged`] where there is none, and where the pack cannot be read.
pub(crate) fn block(pack: &[u8], place: usize) -> StoreResult<&[u8]> {
    let damaged = |what: &str| StoreError::Damaged { what: format!("a pack of samples: {what}") };
    let places = places(pack).map_err(damaged)?;
    let range = places.get(place).filter(|range| !range.is_empty());
    range.and_then(|range| pack.get(range.clone())).ok_or_else(|| damaged("there is nothing at that place"))
}

/// The pack without what stands at these places, all others being where they were; `None` where nothing is left.
pub(crate) fn without(pack: &[u8], dropped: &[usize]) -> Result<Option<Vec<u8>>, &'static str> {
    let kept: Vec<&[u8]> = places(pack)?
        .into_iter()
        .enumerate()
        .map(|(place, range)| if dropped.contains(&place) { &[] } else { &pack[range] })
        .collect();
    Ok(kept.iter().any(|block| !block.is_empty()).then(|| several(&kept)))
}

/// Where the blocks of a pack are; every range lies within it.
fn places(pack: &[u8]) -> Result<Vec<Range<usize>>, &'static str> {
    if !pack.starts_with(&MAGIC) {
        return Ok(std::iter::once(0..pack.len()).collect());
    }
    let mut input = Input(&pack[MAGIC.len()..]);
    if input.byte()? != VERSION {
        return Err("its version is not known");
    }
    let count = usize::from(input.byte()?);
    if !(1..=MOST_PLACES).contains(&count) {
        return Err("its number of places is out of range");
    }
    let mut lengths = [0; MOST_PLACES];
    for length in &mut lengths[..count] {
        *length = input.length()?;
    }
    let directory = &pack[..pack.len() - input.0.len()];
    if input.take(CHECKSUM)? != checksum(directory) {
        return Err("its checksum differs");
    }
    let mut places = Vec::with_capacity(count);
    let mut at = pack.len() - input.0.len();
    for length in &lengths[..count] {
        let end = at.checked_add(*length).filter(|end| *end <= pack.len()).ok_or("it is too short")?;
        places.push(at..end);
        at = end;
    }
    if at == pack.len() { Ok(places) } else { Err("it is too long") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Which places of a pack have a block.
    fn filled(pack: &[u8]) -> Result<Vec<usize>, &'static str> {
        let places = places(pack)?.into_iter().enumerate();
        Ok(places.filter(|(_, range)| !range.is_empty()).map(|(place, _)| place).collect())
    }

    #[test]
    fn the_bytes_are_fixed_for_ever() {
        assert_eq!(&*pack(&[b"FB one"]), b"FB one");
        let both = pack(&[b"FB one", b"two"]);
        assert_eq!(&*both, b"FP\x01\x02\x06\x03\xc1\xe4\xef\x52FB onetwo");
        let left = without(&both, &[0]).unwrap().unwrap();
        assert_eq!(left, b"FP\x01\x02\x00\x03\x08\xe6\x4f\xb1two");
        assert_eq!(without(&left, &[1]).unwrap(), None);
        // One that looks like a pack is in one.
        assert_eq!(&*pack(&[b"FP"]), b"FP\x01\x01\x02\x25\x78\x9c\xcfFP");
    }

    #[test]
    fn packs_are_as_long_as_they_usually_are_or_of_one_block() {
        let of = |lengths: &[usize]| together(lengths.iter().copied());
        assert_eq!(of(&[]), 0);
        assert_eq!(of(&[1 << 20, 1]), 1);
        assert_eq!(of(&[1, 1 << 20]), 1);
        assert_eq!(of(&[USUAL_BYTES - 1, 1, 1]), 2);
        assert_eq!(of(&[1; 100]), MOST_PLACES);
        assert_eq!(of(&[usize::MAX, usize::MAX]), 1);
    }

    fn blocks() -> impl Strategy<Value = Vec<Vec<u8>>> {
        let block = prop_oneof![
            prop::collection::vec(any::<u8>(), 1..300),
            prop::collection::vec(any::<u8>(), 1..9).prop_map(|rest| [&MAGIC[..], &rest].concat()),
        ];
        prop::collection::vec(block, 1..=MOST_PLACES)
    }

    proptest! {
        #[test]
        fn what_is_packed_comes_back_and_what_is_dropped_does_not(
            blocks in blocks(),
            dropped in prop::collection::vec(0_usize..70, 0..70),
        ) {
            let slices: Vec<&[u8]> = blocks.iter().map(Vec::as_slice).collect();
            let whole = pack(&slices);
            let all: Vec<usize> = (0..blocks.len()).collect();
            prop_assert_eq!(filled(&whole).unwrap(), all);
            for (place, kept) in slices.iter().enumerate() {
                prop_assert_eq!(block(&whole, place).unwrap(), *kept);
            }
            prop_assert!(block(&whole, blocks.len()).is_err());
            let left = without(&whole, &dropped).unwrap();
            let kept: Vec<usize> = (0..blocks.len()).filter(|place| !dropped.contains(place)).collect();
            prop_assert_eq!(left.is_none(), kept.is_empty());
            let Some(left) = left else { return Ok(()) };
            prop_assert_eq!(filled(&left).unwrap(), kept.clone());
            for (place, slice) in slices.iter().enumerate() {
                match block(&left, place) {
                    Ok(found) => prop_assert!(kept.contains(&place) && found == *slice),
                    Err(_) => prop_assert!(!kept.contains(&place)),
                }
            }
        }

        #[test]
        fn one_that_is_damaged_where_it_says_what_is_where_is_none(
            blocks in prop::collection::vec(prop::collection::vec(any::<u8>(), 1..300), 2..20),
            at in any::<prop::sample::Index>(),
            bit in 0_u8..8,
        ) {
            let slices: Vec<&[u8]> = blocks.iter().map(Vec::as_slice).collect();
            let whole = pack(&slices).into_owned();
            let head = whole.len() - blocks.iter().map(Vec::len).sum::<usize>();
            let mut other = whole.clone();
            // What does not begin like a pack is a block, which has a checksum of its own.
            other[MAGIC.len() + at.index(head - MAGIC.len())] ^= 1 << bit;
            prop_assert!(filled(&other).is_err() && block(&other, 0).is_err());
            prop_assert!(filled(&whole[..whole.len() - 1]).is_err());
            prop_assert!(filled(&[&whole[..], &[0]].concat()).is_err());
        }

        #[test]
        fn any_bytes_are_a_pack_or_none(bytes in prop::collection::vec(any::<u8>(), 0..300), place in 0_usize..80) {
            for bytes in [bytes.clone(), [&b"FP\x01"[..], &bytes].concat()] {
                let _ = (filled(&bytes), block(&bytes, place), without(&bytes, &[place]));
            }
        }
    }
}

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
//! A block alone is a pack as it is, of one place, where it begins like one. Each block has a checksum of its own; that of the pack is
//! over where they are. What begins otherwise is damaged: nothing is taken out of it.

use super::checksum;
use super::input::{Input, put_varint};
use crate::error::{StoreError, StoreResult};
use std::borrow::Cow;
use std::ops::Range;

const MAGIC: [u8; 2] = *b"FP";
/// Every version of a block begins so.
const OF_BLOCK: [u8; 2] = *b"FB";
const VERSION: u8 = 1;
const CHECKSUM: usize = 4;

/// Most places of a pack. The table is checked against the same.
pub(crate) const MOST_PLACES: usize = 64;

/// A pack is not made longer than this, but by one block alone: whoever reads a block reads its pack.
const USUAL_BYTES: usize = 18 << 10;

/// Cuts blocks, each of such a length, into packs: how many of the next ones make that which leaves least empty for what it holds.
pub(crate) fn together(lengths: impl Iterator<Item = usize>) -> usize {
    let (mut sum, mut best) = (0_usize, (0, 1, 0));
    for (before, length) in lengths.take(MOST_PLACES).enumerate() {
        sum = sum.saturating_add(length);
        let directory = if before == 0 { 0 } else { 10 + 2 * before };
        let bytes = sum.saturating_add(directory);
        if before > 0 && bytes > USUAL_BYTES {
            break;
        }
        let (empty, bytes) = (row::empty(bytes) as u128, bytes as u128);
        if before == 0 || empty * best.1 <= best.0 * bytes {
            best = (empty, bytes, before + 1);
        }
    }
    best.2
}

/// What a row of SQLite's leaves empty, in a file of pages of 4 KiB (<https://sqlite.org/fileformat2.html>, 1.6).
mod row {
    const PAGE: usize = 4096;
    /// What an overflow page holds, the most that a row keeps beside others, and what it keeps at least where it has overflow pages.
    const OVERFLOW: usize = PAGE - 4;
    const MOST_BESIDE: usize = PAGE - 35;
    const LEAST_BESIDE: usize = (PAGE - 12) * 32 / 255 - 23;
    /// Its length, its number and where it stands.
    const HEAD: usize = 8;

    /// Bytes that a row of so many takes and does not fill, on average: its last overflow page, and of the page that it shares with rows
    /// like it what is too short for another one.
    pub(super) const fn empty(bytes: usize) -> usize {
        let (beside, last) = if bytes <= MOST_BESIDE {
            (bytes, 0)
        } else {
            let rest = (bytes - LEAST_BESIDE) % OVERFLOW;
            if LEAST_BESIDE + rest <= MOST_BESIDE {
                (LEAST_BESIDE + rest, 0)
            } else {
                (LEAST_BESIDE, OVERFLOW - rest)
            }
        };
        beside * beside / (2 * PAGE) + last + HEAD
    }
}

/// The pack of some blocks, at most as many as [`together`] says.
pub(crate) fn pack<'a>(blocks: &[&'a [u8]]) -> Cow<'a, [u8]> {
    match blocks {
        [block] if block.starts_with(&OF_BLOCK) => Cow::Borrowed(block),
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
    let checksum = checksum::<CHECKSUM>(&out);
    out.extend_from_slice(&checksum);
    blocks.iter().for_each(|block| out.extend_from_slice(block));
    out
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
    let places = places(pack)?;
    if dropped.iter().any(|place| *place >= places.len()) {
        return Err("it has no such place");
    }
    let kept: Vec<&[u8]> = places
        .into_iter()
        .enumerate()
        .map(|(place, range)| if dropped.contains(&place) { &[] } else { &pack[range] })
        .collect();
    Ok(kept.iter().any(|block| !block.is_empty()).then(|| several(&kept)))
}

/// Where the blocks of a pack are; every range lies within it.
fn places(pack: &[u8]) -> Result<Vec<Range<usize>>, &'static str> {
    if pack.starts_with(&OF_BLOCK) {
        return Ok(std::iter::once(0..pack.len()).collect());
    }
    if !pack.starts_with(&MAGIC) {
        return Err("it begins like none");
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
    if input.take(CHECKSUM)? != checksum::<CHECKSUM>(directory) {
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
        // What does not look like a block is in one of its own.
        assert_eq!(&*pack(&[b"FP"]), b"FP\x01\x01\x02\x25\x78\x9c\xcfFP");
    }

    #[test]
    fn packs_fill_their_pages_or_are_of_one_block() {
        let of = |lengths: &[usize]| together(lengths.iter().copied());
        assert_eq!(of(&[]), 0);
        assert_eq!(of(&[1 << 20, 1]), 1);
        assert_eq!(of(&[1, 1 << 20]), 1);
        assert_eq!(of(&[usize::MAX, usize::MAX]), 1);
        assert_eq!(of(&[1; 100]), MOST_PLACES);
        // Four overflow pages, and hardly more than the least beside.
        assert_eq!(of(&[900; 100]), 19);
        // Rather alone than half of a page.
        assert_eq!(of(&[900; 4]), 1);
    }

    #[test]
    fn what_a_row_leaves_empty() {
        assert_eq!(row::empty(900), 900 * 900 / 8192 + 8);
        // All but what it keeps beside at least is in one overflow page; more is beside.
        assert_eq!(row::empty(489 + 4092), 489 * 489 / 8192 + 8);
        assert_eq!(row::empty(489 + 4092 + 500), 989 * 989 / 8192 + 8);
        // As much as may be beside, and a byte more, which takes a page.
        assert_eq!(row::empty(4061), 4061 * 4061 / 8192 + 8);
        assert_eq!(row::empty(4062), 489 * 489 / 8192 + (4092 - 3573) + 8);
    }

    fn blocks() -> impl Strategy<Value = Vec<Vec<u8>>> {
        let block = prop_oneof![
            prop::collection::vec(any::<u8>(), 1..300),
            prop::collection::vec(any::<u8>(), 1..9).prop_map(|rest| [&MAGIC[..], &rest].concat()),
            prop::collection::vec(any::<u8>(), 1..300).prop_map(|rest| [&OF_BLOCK[..], &rest].concat()),
        ];
        prop::collection::vec(block, 1..=MOST_PLACES)
    }

    proptest! {
        /// A transaction's blocks, of cycles of one to five seconds.
        #[test]
        fn many_blocks_leave_little_empty(lengths in prop::collection::vec(550_usize..1500, 256)) {
            let (mut left, mut empty) = (lengths.as_slice(), 0);
            while !left.is_empty() {
                let (pack, later) = left.split_at(together(left.iter().copied()));
                empty += row::empty(pack.iter().sum::<usize>() + 10 + 2 * pack.len());
                left = later;
            }
            prop_assert!(empty * 50 < lengths.iter().sum::<usize>(), "{empty}");
        }

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
            prop_assert!(without(&whole, &[blocks.len()]).is_err(), "there is no such place");
            let dropped: Vec<usize> = dropped.into_iter().filter(|place| *place < blocks.len()).collect();
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
            other[at.index(head)] ^= 1 << bit;
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

//! Asymmetric numeral systems (Duda, 2013), range variant: symbols are written from the last to the first, each into one of
//! two states that take turns, and read from the first to the last. Where a symbol has a share f of 2^12 that begins at
//! b, state x becomes (x div f) · 2^12 + b + x mod f; before it would leave 31 bits its lower 16 are written as a word.
//!
//! Who reads a state x finds the symbol whose share x mod 2^12 lies in, and x becomes f · (x div 2^12) + x mod 2^12 − b; where that is
//! below 2^15 the next word is put behind it.
//!
//! Bits that are written plainly stand as symbols of twelve of them at the most, the lowest first: n bits of the value v are the
//! symbol of the share 2^(12 − n) that begins at v · 2^(12 − n).
//!
//! ```text
//! u32 state that is read first    u32 the other one
//! words of 16 bits, in the order in which they are read
//! ```
//!
//! Integers are little-endian. Both states begin, and end for who reads, as 2^15.

use std::hint::select_unpredictable;

/// Shares are in 1/2^12.
pub(super) const BITS: u32 = 12;
const WHOLE: u32 = 1 << BITS;
/// States are from here to 2^31, which a word widens them by.
const LOWEST: u32 = 1 << 15;
const WORD: u32 = 16;
/// Bytes of the states.
const HEAD: usize = 8;
/// Symbols that are written together, and read together.
pub(super) const TOGETHER: usize = 8;
/// Most bits that are one symbol: the format's.
const AT_ONCE: u32 = 12;

/// A symbol's share, with what dividing by it takes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Symbol {
    /// 2^64 by the share, rounded up.
    inverse: u64,
    /// A state from here on would leave 31 bits.
    limit: u32,
    /// What a state grows by, besides its quotient times what the share leaves of 2^12.
    added: u16,
    complement: u16,
}

impl Symbol {
    /// A share of 1 to 2^12 that begins at `start`, both within 2^12.
    #[expect(clippy::cast_possible_truncation, reason = "13 bits")]
    pub(super) const fn new(start: u32, share: u32) -> Self {
        // Rounded up, it is exact for all that is below 2^31. By the largest one x div 1 = x comes out one too small, which
        // what is added makes good.
        let (inverse, added) =
            if share == 1 { (u64::MAX, start + WHOLE - 1) } else { (u64::MAX / share as u64 + 1, start) };
        Self { inverse, limit: share << (31 - BITS), added: added as u16, complement: (WHOLE - share) as u16 }
    }

    /// The lowest `count` bits of `value`, 1 to 12, each as likely 0 as 1.
    #[expect(clippy::cast_possible_truncation, reason = "at most twelve bits")]
    const fn plain(value: u64, count: u32) -> Self {
        let share = WHOLE >> count;
        Self::new((value & ((1 << count) - 1)) as u32 * share, share)
    }

    /// Its share of 2^12.
    pub(super) const fn share(self) -> u32 {
        WHOLE - self.complement as u32
    }
}

/// Notes the lowest `count` bits of `value`, at most 64, to be written.
pub(super) fn note_plain(symbols: &mut Vec<Symbol>, mut value: u64, mut count: u32) {
    while count > 0 {
        let now = count.min(AT_ONCE);
        symbols.push(Symbol::plain(value, now));
        value >>= now;
        count -= now;
    }
}

/// Writes what will be read in the opposite order.
pub(super) struct Writer {
    /// The one that is written next, and the other.
    states: [u32; 2],
    /// The last one is read first.
    words: Vec<u16>,
}

impl Writer {
    /// With room for so many words.
    pub(super) fn new(words: usize) -> Self {
        Self { states: [LOWEST; 2], words: Vec::with_capacity(words) }
    }

    /// Writes symbols before those that were written.
    pub(super) fn put_before(&mut self, symbols: &[Symbol]) {
        for symbol in symbols.iter().rev() {
            let [state, other] = self.states;
            let mut word = 0;
            let (state, is_word) = put(state, symbol, &mut word);
            self.states = [other, state];
            if is_word {
                self.words.push(word);
            }
        }
    }

    /// Writes eights of symbols, the last one first, before those that were written, as long as there are some; says how many they
    /// were. To be called where nothing else is done, so that all it goes by is in registers.
    #[inline(always)]
    pub(super) fn put_eights_before<'s>(
        &mut self,
        mut eights: impl ExactSizeIterator<Item = Option<[&'s Symbol; TOGETHER]>>,
    ) -> usize {
        let begins = self.words.len();
        // Each symbol writes a word at the most; what is written over does not count.
        self.words.resize(begins + TOGETHER * eights.len(), 0);
        let (words, mut at, mut count) = (&mut self.words[begins..], 0, 0);
        let [mut a, mut b] = self.states;
        while let Some(Some(eight)) = eights.next() {
            let Some(room) = words[at..].first_chunk_mut::<TOGETHER>() else { break };
            let (pairs, _) = eight.as_chunks();
            // The remainder is the place itself, of which the compiler then knows that it is within the room.
            let mut written = 0;
            for [earlier, later] in pairs.iter().rev() {
                let (is_word, is_another);
                (a, is_word) = put(a, later, &mut room[written % TOGETHER]);
                written += usize::from(is_word);
                (b, is_another) = put(b, earlier, &mut room[written % TOGETHER]);
                written += usize::from(is_another);
            }
            at += written;
            count += 1;
        }
        self.states = [a, b];
        self.words.truncate(begins + at);
        count
    }

    /// Bytes that [`Writer::finish`] appends.
    pub(super) fn len(&self) -> usize {
        HEAD + 2 * self.words.len()
    }

    pub(super) fn finish(self, out: &mut Vec<u8>) {
        let [next, last] = self.states;
        out.extend(last.to_le_bytes());
        out.extend(next.to_le_bytes());
        out.extend(self.words.iter().rev().flat_map(|word| word.to_le_bytes()));
    }
}

/// The state after a symbol, and whether a word was written. It is each time, and once more where it was not needed: whether it
/// is could not be foretold.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "the lower half of a state, and quotients of 32 bits")]
fn put(state: u32, symbol: &Symbol, word: &mut u16) -> (u32, bool) {
    let is_full = state >= symbol.limit;
    *word = state as u16;
    let state = select_unpredictable(is_full, state >> WORD, state);
    let quotient = ((u128::from(state) * u128::from(symbol.inverse)) >> 64) as u32;
    (state + u32::from(symbol.added) + quotient * u32::from(symbol.complement), is_full)
}

/// Reads what a [`Writer`] wrote.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reader<'a> {
    /// The one that is read next, and the other.
    states: [u32; 2],
    words: &'a [u8],
}

impl<'a> Reader<'a> {
    /// `None` where the states are none.
    pub(super) fn new(bytes: &'a [u8]) -> Option<Self> {
        let (head, words) = bytes.split_first_chunk::<HEAD>()?;
        let (states, _) = head.as_chunks();
        let states = [u32::from_le_bytes(states[0]), u32::from_le_bytes(states[1])];
        states.iter().all(|state| (LOWEST..1 << 31).contains(state)).then_some(Self { states, words })
    }

    /// The place, of 2^12, that lies in the next symbol's share.
    #[inline(always)]
    pub(super) const fn place(&self) -> u32 {
        self.states[0] & (WHOLE - 1)
    }

    /// Takes the symbol whose share this is, which [`Reader::place`] lies in; `None` where a word is missing.
    #[inline(always)]
    pub(super) fn take(&mut self, start: u32, share: u32) -> Option<()> {
        let [state, other] = self.states;
        let mut state = share * (state >> BITS) + (state & (WHOLE - 1)) - start;
        if state < LOWEST {
            let (word, rest) = self.words.split_first_chunk()?;
            state = state << WORD | u32::from(u16::from_le_bytes(*word));
            self.words = rest;
        }
        self.states = [other, state];
        Some(())
    }

    /// The next `count` bits, at most 64, as [`note_plain`] noted them.
    pub(super) fn take_plain(&mut self, count: u32) -> Option<u64> {
        let (mut value, mut there) = (0, 0);
        while there < count {
            let now = (count - there).min(AT_ONCE);
            let share = WHOLE >> now;
            let bits = self.place() / share;
            self.take(bits * share, share)?;
            value |= u64::from(bits) << there;
            there += now;
        }
        Some(value)
    }

    /// Whether all was read, and was what a [`Writer`] begins with.
    pub(super) fn is_at_end(&self) -> bool {
        self.words.is_empty() && self.states == [LOWEST; 2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Shares that fill 2^12, with where they begin.
    fn shares() -> impl Strategy<Value = Vec<(u32, u32)>> {
        prop::collection::btree_set(1..WHOLE, 0..40).prop_map(|cuts| {
            let ends: Vec<u32> = cuts.into_iter().chain([WHOLE]).collect();
            let starts = [0].into_iter().chain(ends.clone());
            starts.zip(&ends).map(|(start, end)| (start, end - start)).collect()
        })
    }

    /// By the definition, with a division.
    fn plainly(mut state: u32, (start, share): (u32, u32), words: &mut Vec<u16>) -> u32 {
        if u64::from(state) >= u64::from(share) << (31 - BITS) {
            words.push(u16::try_from(state & 0xffff).unwrap());
            state >>= WORD;
        }
        (state / share) * WHOLE + start + state % share
    }

    proptest! {
        #[test]
        fn a_symbol_is_written_as_by_division(
            state in prop_oneof![LOWEST..1 << 31, Just(LOWEST), Just((1 << 31) - 1)],
            share in prop_oneof![1..=WHOLE, 1..=4_u32, Just(WHOLE)],
            part in 0.0..1.0,
        ) {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below 2^12")]
            let start = (f64::from(WHOLE - share) * part) as u32;
            let (mut plain, mut word) = (Vec::new(), 0);
            let expected = plainly(state, (start, share), &mut plain);
            let is_word = !plain.is_empty();
            prop_assert_eq!(put(state, &Symbol::new(start, share), &mut word), (expected, is_word));
            prop_assert!(plain.iter().all(|plain| *plain == word));
            prop_assert!((LOWEST..1 << 31).contains(&expected));
        }

        #[test]
        fn what_is_written_comes_back(
            shares in shares(),
            columns in prop::collection::vec(prop::collection::vec(any::<prop::sample::Index>(), 0..60), 0..4),
            plain in any::<u64>(),
            count in 0_u32..=64,
            cut in any::<prop::sample::Index>(),
        ) {
            let value = if count == 0 { 0 } else { plain >> (64 - count) };
            let mut writer = Writer::new(0);
            for column in columns.iter().rev() {
                let symbol = |index: &prop::sample::Index| {
                    let (start, share) = *index.get(&shares);
                    Symbol::new(start, share)
                };
                let mut symbols: Vec<Symbol> = column.iter().map(symbol).collect();
                note_plain(&mut symbols, value, count);
                writer.put_before(&symbols);
            }
            let (len, mut out) = (writer.len(), Vec::new());
            writer.finish(&mut out);
            prop_assert_eq!(out.len(), len);
            let read = |bytes: &[u8]| {
                let mut reader = Reader::new(bytes)?;
                for column in &columns {
                    for index in column {
                        let (start, share) = *index.get(&shares);
                        if !(start..start + share).contains(&reader.place()) {
                            return None;
                        }
                        reader.take(start, share)?;
                    }
                    if reader.take_plain(count)? != value {
                        return None;
                    }
                }
                reader.is_at_end().then_some(())
            };
            prop_assert!(read(&out).is_some());
            let cut = cut.index(out.len());
            prop_assert!(read(&out[..cut]).is_none(), "cut at {}", cut);
            prop_assert!(read(&[out.as_slice(), &[0]].concat()).is_none());
        }
    }

    #[test]
    fn states_that_no_writer_leaves_are_refused() {
        for states in [[LOWEST - 1, LOWEST], [LOWEST, 1 << 31], [u32::MAX; 2]] {
            let bytes: Vec<u8> = states.iter().flat_map(|state| state.to_le_bytes()).collect();
            assert!(Reader::new(&bytes).is_none(), "{states:?}");
        }
    }
}

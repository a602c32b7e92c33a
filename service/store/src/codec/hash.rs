//! The content hash, as the module above lays it out.
//!
//! The first version hashed each value of a column as eight bytes, most of them zeros; the second did not fill its text up.
//! Cycles that were stored under them keep them: [`is_hash_of`] knows all.

use super::column::{Column, Columns, Time};
use crate::record::ContentHash;
use feedwright_core::cycle::Cycle;
use std::cell::RefCell;
use std::ops::RangeInclusive;
use zerocopy::{Immutable, IntoBytes};

/// How content is hashed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Version {
    /// Values as eight bytes each.
    First,
    /// Decimals by as many bytes each as the column needs.
    Second,
    /// The same, filled up to a length that is hashed in fewer steps.
    Third,
}

impl Version {
    const fn domain(self) -> &'static [u8] {
        match self {
            Self::First => b"feedwright cycle content v1\n",
            Self::Second => b"feedwright cycle content v2\n",
            Self::Third => b"feedwright cycle content v3\n",
        }
    }
}

/// Hash over the canonical content of a cycle.
pub fn content_hash(cycle: &Cycle) -> ContentHash {
    of_parts(cycle, cycle.samples.as_ref().map(Columns::of).as_ref())
}

/// Whether a hash, of whichever version, is that of a cycle's content.
pub fn is_hash_of(hash: &ContentHash, cycle: &Cycle) -> bool {
    let samples = cycle.samples.as_ref().map(Columns::of);
    [Version::Third, Version::Second, Version::First]
        .into_iter()
        .any(|version| of_version(version, cycle, samples.as_ref()) == *hash)
}

pub(super) fn of_parts(cycle: &Cycle, samples: Option<&Columns>) -> ContentHash {
    of_version(Version::Third, cycle, samples)
}

thread_local! {
    /// Where each thread puts the bytes that wait, at most [`WAITING`] and what fills them up.
    static BUFFER: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

fn of_version(version: Version, cycle: &Cycle, samples: Option<&Columns>) -> ContentHash {
    let mut hash = Hash::new(version, BUFFER.take());
    hash.bytes(version.domain());
    hash.text(cycle.machine.as_str());
    hash.text(cycle.id.as_str());
    hash.text(cycle.tool.as_str());
    hash.text(cycle.operation.as_str());
    hash.bytes(&cycle.started_at.micros().to_le_bytes());
    hash.option(cycle.seq, |hash, seq| hash.bytes(&seq.to_le_bytes()));
    hash.option(cycle.process, |hash, process| hash.text(process.as_str()));
    hash.option(cycle.strategy, |hash, strategy| hash.text(strategy.as_str()));
    hash.option(cycle.law_version.as_deref(), Hash::text);
    hash.option(cycle.profile.as_ref(), |hash, profile| {
        hash.text(profile.profile.as_str());
        hash.bytes(&profile.version.to_le_bytes());
    });
    hash.option(cycle.recommendation.as_ref(), |hash, id| hash.text(id.as_str()));
    hash.option(cycle.spindle_speed_rpm, Hash::float);
    hash.text(cycle.outcome.as_str());
    for (_, _, value) in cycle.reported.fields() {
        hash.option(value, Hash::float);
    }
    hash.option(samples, Hash::samples);
    // Only where something of it is there: cycles without it keep the hash they have always had.
    if !cycle.reported.cut.is_empty() {
        hash.text("cut");
        for (_, _, value) in cycle.reported.cut.fields() {
            hash.option(value, Hash::float);
        }
    }
    if let Some(reference) = cycle.reference {
        hash.text("reference");
        hash.bytes(&[u8::from(reference)]);
    }
    let (hash, buffer) = hash.finish();
    BUFFER.replace(buffer);
    hash
}

/// Bytes that are hashed together: blake3 is several times faster on long input.
const WAITING: usize = 64 * 1024;
/// Texts of so many bytes are filled up. blake3 takes pieces of 1,024 bytes several at once, a power of two of them: seven
/// take three steps, and eight one. Of more pieces it depends on the processor.
const FILLED: RangeInclusive<usize> = 1025..=8192;

/// What a text of so many bytes is filled up to.
fn filled(len: usize) -> usize {
    if FILLED.contains(&len) { len.next_power_of_two() } else { len }
}

struct Hash {
    version: Version,
    hasher: blake3::Hasher,
    waiting: Vec<u8>,
}

impl Hash {
    /// With a buffer for what waits.
    fn new(version: Version, mut waiting: Vec<u8>) -> Self {
        waiting.clear();
        Self { version, hasher: blake3::Hasher::new(), waiting }
    }

    /// The hash, and the buffer.
    fn finish(mut self) -> (ContentHash, Vec<u8>) {
        if self.version == Version::Third {
            // Where a text ends is told by the texts themselves: zeros behind it are no other content.
            let hashed = usize::try_from(self.hasher.count()).unwrap_or(usize::MAX - WAITING);
            let len = hashed + self.waiting.len();
            self.waiting.resize(self.waiting.len() + filled(len) - len, 0);
        }
        self.hasher.update(&self.waiting);
        (*self.hasher.finalize().as_bytes(), self.waiting)
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.make_room(bytes.len());
        self.waiting.extend_from_slice(bytes);
    }

    /// For so many bytes, where there are no more than [`WAITING`].
    fn make_room(&mut self, bytes: usize) {
        if self.waiting.len() + bytes > WAITING {
            self.hasher.update(&self.waiting);
            self.waiting.clear();
        }
    }

    /// A decimal column by `N` bytes a value.
    fn narrow<const N: usize>(&mut self, scale: u8, values: &[i64], bytes_of: impl Fn(i64) -> [u8; N]) {
        self.bytes(&[scale, u8::try_from(N).unwrap_or(u8::MAX)]);
        for values in values.chunks(WAITING / N) {
            let more = values.len() * N;
            self.make_room(more);
            let begins = self.waiting.len();
            self.waiting.resize(begins + more, 0);
            let (slots, _) = self.waiting[begins..].as_chunks_mut::<N>();
            for (slot, value) in slots.iter_mut().zip(values) {
                *slot = bytes_of(*value);
            }
        }
    }

    /// Words as little-endian bytes.
    fn words<T: IntoBytes + Immutable + Copy>(&mut self, words: &[T], to_le: impl Fn(T) -> T) {
        if cfg!(target_endian = "little") {
            words.as_bytes().chunks(WAITING).for_each(|bytes| self.bytes(bytes));
        } else {
            words.iter().for_each(|word| self.bytes(to_le(*word).as_bytes()));
        }
    }

    fn text(&mut self, text: &str) {
        let length = u32::try_from(text.len()).unwrap_or(u32::MAX);
        self.bytes(&length.to_le_bytes());
        self.bytes(text.as_bytes());
    }

    fn float(&mut self, value: f64) {
        // −0.0 and 0.0 are the same content; samples are normalised by their type, these may not be.
        self.bytes(&(value + 0.0).to_bits().to_le_bytes());
    }

    fn option<T>(&mut self, value: Option<T>, write: impl FnOnce(&mut Self, T)) {
        match value {
            None => self.bytes(&[0]),
            Some(value) => {
                self.bytes(&[1]);
                write(self, value);
            }
        }
    }

    fn samples(&mut self, samples: &Columns) {
        match &samples.time {
            Time::Period(bits) => {
                self.bytes(&[0]);
                self.bytes(&bits.to_le_bytes());
            }
            Time::Stamps(column) => {
                self.bytes(&[1]);
                self.column(column);
            }
        }
        let length = u32::try_from(samples.len).unwrap_or(u32::MAX);
        self.bytes(&length.to_le_bytes());
        let channels = u16::try_from(samples.channels.len()).unwrap_or(u16::MAX);
        self.bytes(&channels.to_le_bytes());
        for (channel, column) in &samples.channels {
            self.bytes(&[*channel as u8]);
            self.column(column);
        }
    }

    fn column(&mut self, column: &Column) {
        match column {
            Column::Decimal { scale, values } if self.version == Version::First => {
                self.bytes(&[*scale]);
                self.words(values, i64::to_le);
            }
            #[expect(clippy::cast_possible_truncation, reason = "as many bytes as each of them needs")]
            Column::Decimal { scale, values } => match width(values) {
                2 => self.narrow(*scale, values, |value| (value as i16).to_le_bytes()),
                4 => self.narrow(*scale, values, |value| (value as i32).to_le_bytes()),
                _ => self.narrow(*scale, values, i64::to_le_bytes),
            },
            Column::Exact(bits) => {
                self.bytes(&[255]);
                self.words(bits, u64::to_le);
            }
        }
    }
}

/// The fewest bytes of 2, 4 and 8 that hold each of the values.
fn width(values: &[i64]) -> usize {
    // What reaches beyond, of all values together: one comparison each would not be made for several at once.
    let beyond = |bits: u32| {
        let reach = 1_i64 << (bits - 1);
        values.iter().fold(0, |all, value| all | value.wrapping_add(reach).cast_unsigned()) >> bits
    };
    match () {
        () if beyond(16) == 0 => 2,
        () if beyond(32) == 0 => 4,
        () => 8,
    }
}

#[cfg(test)]
mod tests {
    use super::super::frame::tests::cycle;
    use super::super::guide::tests::drilled;
    use super::*;
    use feedwright_core::cycle::{Channel, Samples, TimeBase};
    use feedwright_core::units::Process;

    fn hex(hash: &ContentHash) -> String {
        hash.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    #[test]
    fn hashes_are_fixed_for_ever() {
        let first = "ecbe8c11a8700ff4d815cb9e00debebce332c7f461033abbcf0b938c18bb7ddd";
        let second = "26520291cead1adda260f676ef212c4a2c515c047a709d2ede3cc60447e2ea99";
        let third = "60ff9a05145ab7d2a4a5a704eb6bf463e895197db89b5cb7d95c1d0fdfad6e50";
        let columns = cycle().samples.as_ref().map(Columns::of);
        assert_eq!(hex(&of_version(Version::First, &cycle(), columns.as_ref())), first);
        assert_eq!(hex(&of_version(Version::Second, &cycle(), columns.as_ref())), second);
        assert_eq!(hex(&content_hash(&cycle())), third);
        // Of a text that is filled up.
        let columns = drilled(300, 7);
        let [first, second, third] = [
            "b6237c4809b419def9316705c63d0f93bb496ddf5f13fc157d24809654e93aba",
            "e43d7ec8f0c2ece10f53cdc1b92684e9615221eb538e62dbf81d530d33c5fa69",
            "d4b8b9409eed292048fecfbb1c424e0f60432cd1431dd15885d95ad8bda30892",
        ];
        for (version, fixed) in [(Version::First, first), (Version::Second, second), (Version::Third, third)]
        {
            assert_eq!(hex(&of_version(version, &cycle(), Some(&columns))), fixed, "{version:?}");
        }
    }

    #[test]
    fn a_hash_of_any_version_is_known_and_no_other() {
        let cycle = cycle();
        let columns = cycle.samples.as_ref().map(Columns::of);
        for version in [Version::First, Version::Second, Version::Third] {
            let mut hash = of_version(version, &cycle, columns.as_ref());
            assert!(is_hash_of(&hash, &cycle), "{version:?}");
            hash[31] ^= 1;
            assert!(!is_hash_of(&hash, &cycle), "{version:?}");
        }
    }

    #[test]
    fn values_are_hashed_by_as_many_bytes_as_the_widest_needs() {
        for (edge, width_within, width_beyond) in [(1_i64 << 15, 2, 4), (1 << 31, 4, 8)] {
            for within in [-edge, edge - 1] {
                assert_eq!(width(&[0, within, 1]), width_within, "{within}");
            }
            for beyond in [-edge - 1, edge] {
                assert_eq!(width(&[0, beyond, 1]), width_beyond, "{beyond}");
            }
        }
        let bytes = |values: &[i64]| {
            let mut hash = Hash::new(Version::Second, Vec::new());
            hash.column(&Column::Decimal { scale: 3, values: values.to_vec() });
            hash.waiting
        };
        assert_eq!(bytes(&[1, -2]), [3, 2, 1, 0, 254, 255]);
        assert_eq!(bytes(&[65_536, -2]), [3, 4, 0, 0, 1, 0, 254, 255, 255, 255]);
        assert_eq!(bytes(&[1 << 40]), [3, 8, 0, 0, 0, 0, 0, 1, 0, 0]);
    }

    #[test]
    fn what_waits_is_hashed_when_it_is_too_much() {
        for count in [WAITING / 2 - 1, WAITING / 2, WAITING / 2 + 1, 3 * WAITING] {
            let values: Vec<i64> = (0..count).map(|at| i64::try_from(at % 1000).unwrap() - 500).collect();
            let mut hash = Hash::new(Version::Second, Vec::new());
            hash.column(&Column::Decimal { scale: 0, values: values.clone() });
            let narrow = |value: &i64| i16::try_from(*value).unwrap().to_le_bytes();
            let plain: Vec<u8> = [0, 2].into_iter().chain(values.iter().flat_map(narrow)).collect();
            assert_eq!(hash.finish().0, *blake3::hash(&plain).as_bytes(), "{count}");
        }
    }

    #[test]
    fn a_text_is_filled_up_with_zeros() {
        for (len, full) in [
            (0, 0),
            (1024, 1024),
            (1025, 2048),
            (2048, 2048),
            (5000, 8192),
            (8192, 8192),
            (8193, 8193),
            (WAITING + 1, WAITING + 1),
        ] {
            let mut hash = Hash::new(Version::Third, vec![9; 3]);
            let mut text = vec![7; len];
            text.chunks(1000).for_each(|bytes| hash.bytes(bytes));
            text.resize(full, 0);
            assert_eq!(hash.finish().0, *blake3::hash(&text).as_bytes(), "{len}");
        }
    }

    #[test]
    fn words_are_hashed_as_their_bytes_wherever_the_waiting_ones_end() {
        for before in [0, 1, 7, WAITING - 8, WAITING - 7, WAITING] {
            for count in [0, 1, 2, WAITING / 8 - 1, WAITING / 8, WAITING / 8 + 1, 20_000] {
                let (bytes, words) = (vec![7; before], (0..count as u64).collect::<Vec<_>>());
                let words: Vec<u64> =
                    words.iter().map(|word| word.wrapping_mul(0x9E37_79B9_7F4A_7C15)).collect();
                let mut hash = Hash::new(Version::First, Vec::new());
                hash.bytes(&bytes);
                hash.words(&words, u64::to_le);
                let plain: Vec<u8> =
                    bytes.into_iter().chain(words.iter().flat_map(|word| word.to_le_bytes())).collect();
                let hash = hash.finish().0;
                assert_eq!(hash, *blake3::hash(&plain).as_bytes(), "{count} words after {before} bytes");
            }
        }
    }

    #[test]
    fn every_field_is_content() {
        let original = content_hash(&cycle());
        let changes: [fn(&mut feedwright_core::cycle::CycleDraft); 9] = [
            |draft| draft.machine = "M2".try_into().unwrap(),
            |draft| draft.id = "c2".try_into().unwrap(),
            |draft| draft.seq = None,
            |draft| draft.process = Some(Process::Turning),
            |draft| draft.law_version = Some("law-2".to_owned()),
            |draft| draft.profile = None,
            |draft| draft.reported.energy_joules = Some(1.0),
            |draft| draft.outcome = feedwright_core::cycle::Outcome::Aborted,
            |draft| draft.samples = None,
        ];
        for (index, change) in changes.into_iter().enumerate() {
            let mut draft = cycle().into_draft();
            change(&mut draft);
            draft.reported.duration_ms.get_or_insert(1000.0);
            assert_ne!(content_hash(&Cycle::new(draft).unwrap()), original, "change {index}");
        }
    }

    #[test]
    fn order_of_channels_is_not_content() {
        let mut draft = cycle().into_draft();
        let columns = |swapped: bool| {
            let mut columns =
                vec![(Channel::DepthMm, vec![0.0, 0.5]), (Channel::SpindleLoadPercent, vec![1.5, 2.5])];
            if swapped {
                columns.reverse();
            }
            Samples::new(TimeBase::Period { period_ms: 10.0 }, columns, 10).unwrap()
        };
        draft.samples = Some(columns(false));
        let one = content_hash(&Cycle::new(draft.clone()).unwrap());
        draft.samples = Some(columns(true));
        assert_eq!(one, content_hash(&Cycle::new(draft).unwrap()));
    }
}

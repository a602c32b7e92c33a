//! The content hash, as the module above lays it out.

use super::column::{Column, Columns, Time};
use crate::record::ContentHash;
use feedwright_core::cycle::Cycle;
use zerocopy::{Immutable, IntoBytes};

const DOMAIN: &[u8] = b"feedwright cycle content v1\n";

/// Hash over the canonical content of a cycle.
pub fn content_hash(cycle: &Cycle) -> ContentHash {
    of_parts(cycle, cycle.samples.as_ref().map(Columns::of).as_ref())
}

pub(super) fn of_parts(cycle: &Cycle, samples: Option<&Columns>) -> ContentHash {
    let mut hash = Hash { hasher: blake3::Hasher::new(), waiting: Vec::with_capacity(WAITING) };
    hash.bytes(DOMAIN);
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
    hash.hasher.update(&hash.waiting);
    *hash.hasher.finalize().as_bytes()
}

/// Bytes that are hashed together: blake3 is several times faster on long input.
const WAITING: usize = 64 * 1024;

struct Hash {
    hasher: blake3::Hasher,
    waiting: Vec<u8>,
}

impl Hash {
    fn bytes(&mut self, bytes: &[u8]) {
        if self.waiting.len() + bytes.len() > WAITING {
            self.hasher.update(&self.waiting);
            self.waiting.clear();
        }
        self.waiting.extend_from_slice(bytes);
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
            Column::Decimal { scale, values } => {
                self.bytes(&[*scale]);
                self.words(values, i64::to_le);
            }
            Column::Exact(bits) => {
                self.bytes(&[255]);
                self.words(bits, u64::to_le);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::frame::tests::cycle;
    use super::*;
    use feedwright_core::cycle::{Channel, Samples, TimeBase};
    use feedwright_core::units::Process;

    fn hex(hash: &ContentHash) -> String {
        hash.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    #[test]
    fn the_hash_is_fixed_for_ever() {
        assert_eq!(
            hex(&content_hash(&cycle())),
            "ecbe8c11a8700ff4d815cb9e00debebce332c7f461033abbcf0b938c18bb7ddd"
        );
    }

    #[test]
    fn words_are_hashed_as_their_bytes_wherever_the_waiting_ones_end() {
        for before in [0, 1, 7, WAITING - 8, WAITING - 7, WAITING] {
            for count in [0, 1, 2, WAITING / 8 - 1, WAITING / 8, WAITING / 8 + 1, 20_000] {
                let (bytes, words) = (vec![7; before], (0..count as u64).collect::<Vec<_>>());
                let words: Vec<u64> =
                    words.iter().map(|word| word.wrapping_mul(0x9E37_79B9_7F4A_7C15)).collect();
                let mut hash = Hash { hasher: blake3::Hasher::new(), waiting: Vec::new() };
                hash.bytes(&bytes);
                hash.words(&words, u64::to_le);
                hash.hasher.update(&hash.waiting);
                let plain: Vec<u8> =
                    bytes.into_iter().chain(words.iter().flat_map(|word| word.to_le_bytes())).collect();
                assert_eq!(
                    hash.hasher.finalize(),
                    blake3::hash(&plain),
                    "{count} words after {before} bytes"
                );
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

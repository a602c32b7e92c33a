use super::*;
use crate::codec::cycle_of_every_field;
use feedwright_core::cycle::{Channel, Samples};
use proptest::prelude::*;

const GOLDEN: &[u8] = include_bytes!("../../../../tests/golden/cycle.bin");

fn golden_cycle() -> Cycle {
    let mut draft = cycle_of_every_field().into_draft();
    let columns = vec![
        (Channel::DepthMm, vec![-0.5, 0.0, 0.125, 1.75, 3.0]),
        (Channel::OverridePercent, vec![100.0, 100.0, 95.0, 90.0, 90.0]),
        (Channel::SpindleLoadPercent, vec![2.1, 2.1, 34.5, 33.9, 4.0]),
        (Channel::SpindlePowerWatts, vec![0.1 + 0.2, 1.0 / 3.0, 1e-12, 812.25, 0.0]),
    ];
    draft.samples = Some(Samples::new(TimeBase::Period { period_ms: 10.0 }, columns, 100).unwrap());
    draft.started_at = feedwright_core::units::Timestamp::from_micros(1_777_874_400_250_001);
    draft.strategy = Some(feedwright_core::units::Strategy::FLin);
    draft.outcome = Outcome::Aborted;
    draft.reported.energy_joules = Some(1234.5);
    draft.reported.cut.edge_wear_mm = Some(0.1);
    Cycle::new(draft).unwrap()
}

#[test]
fn the_bytes_are_those_that_other_encoders_write() {
    assert_eq!(encode(&golden_cycle()), GOLDEN);
}

#[test]
fn what_is_written_is_read() {
    let (cycle, post) = (golden_cycle(), read(GOLDEN, 5).unwrap());
    assert_eq!(post.cycle_id, cycle.id.as_str());
    assert_eq!((post.tool.as_str(), post.operation.as_str()), ("T-4711", "flange.hole-3"));
    assert_eq!((post.started_at, post.seq), (cycle.started_at, Some(123)));
    assert_eq!((post.process.as_deref(), post.strategy.as_deref()), (Some("friction"), Some("f_lin")));
    assert_eq!(post.profile, Some(("P1".to_owned(), 3)));
    assert_eq!((post.spindle_speed_rpm, post.outcome.as_deref()), (Some(2400.0), Some("aborted")));
    let (samples, expected) = (post.samples.unwrap(), cycle.samples.as_ref().unwrap());
    assert_eq!(samples.period_ms, Some(10.0));
    for ((channel, values), (wanted, expected)) in samples.columns.iter().zip(expected.columns()) {
        let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        assert_eq!((*channel, bits(values)), (wanted, bits(expected)));
    }
    let reported: Vec<usize> = (0..REPORTED).filter(|&bit| post.reported[bit].is_some()).collect();
    assert_eq!((reported, post.reported[12]), (vec![0, 1, 12], Some(0.1)));
}

/// Gives changed bytes a length and a checksum that hold, so that the parser behind them is reached.
fn sealed(mut frame: Vec<u8>) -> Vec<u8> {
    frame.truncate(frame.len().saturating_sub(CHECKSUM));
    frame.resize(frame.len().max(HEAD), 0);
    frame[..4].copy_from_slice(&MAGIC);
    let length = u32::try_from(frame.len() - HEAD).unwrap();
    frame[4..HEAD].copy_from_slice(&length.to_le_bytes());
    let sum = crc32fast::hash(&frame);
    frame.extend_from_slice(&sum.to_le_bytes());
    frame
}

#[test]
fn every_kind_of_damage_has_its_reason() {
    let why = |frame: &[u8]| match read(frame, 5) {
        Err(WireError::Malformed(why)) => why,
        other => panic!("{other:?}"),
    };
    for at in 4..GOLDEN.len() {
        let mut damaged = GOLDEN.to_vec();
        damaged[at] ^= 0x10;
        let why = why(&damaged);
        assert!(at < HEAD || why == "its checksum differs", "byte {at}: {why}");
    }
    for length in 0..GOLDEN.len() {
        why(&GOLDEN[..length]);
    }
    assert_eq!(why(b""), "it does not begin with FWC");
    assert_eq!(why(b"FWC\x02"), "its version is not 1");
    assert_eq!(why(&[GOLDEN, &[0]].concat()), "there is more after its end");
    assert_eq!(read(GOLDEN, 4), Err(WireError::TooManySamples(5)));
    let mut channel = GOLDEN.to_vec();
    let at = channel.windows(3).position(|window| window == [1, 3, 0xe7]).unwrap();
    channel[at] = 17;
    assert_eq!(read(&sealed(channel), 5), Err(WireError::UnknownChannel(17)));
    let mut extra = GOLDEN.to_vec();
    extra[HEAD + 1] |= 0x10;
    assert_eq!(why(&sealed(extra)), "it has fields that version 1 does not have");
}

#[test]
fn a_few_bytes_do_not_ask_for_much_memory() {
    let mut bomb = GOLDEN.to_vec();
    let at = bomb.windows(4).position(|window| window == [5, 0, 0, 0]).unwrap();
    bomb[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    assert_eq!(
        read(&sealed(bomb), usize::MAX),
        Err(WireError::Malformed("it has more samples than bytes of columns"))
    );
}

#[test]
fn samples_without_channels_are_read_for_who_refuses_them() {
    let texts = b"\x02c1\x02T1\x02O1";
    let samples = [[0].as_slice(), &10.0_f64.to_le_bytes(), &5_u32.to_le_bytes(), &[0]].concat();
    let payload = [(1_u32 << 8).to_le_bytes().as_slice(), texts, &0_i64.to_le_bytes(), &samples].concat();
    let frame = sealed([[0; HEAD].as_slice(), &payload, &[0; CHECKSUM]].concat());
    let samples = read(&frame, 5).unwrap().samples.unwrap();
    assert_eq!((samples.period_ms, samples.columns.len()), (Some(10.0), 0));
}

#[test]
fn a_batch_is_frame_after_frame() {
    let body = [GOLDEN, GOLDEN, &GOLDEN[..20]].concat();
    let split = frames(&body, 3).unwrap();
    assert_eq!(split, [GOLDEN, GOLDEN, &GOLDEN[..20]]);
    assert_eq!(frames(&body, 2), None, "too many");
    assert_eq!(frames(b"{}", 9).unwrap(), [b"{}"]);
}

/// A frame of one column of decimals, by the differences that it is to hold.
fn frame_of(differences: &[i64], places: u8) -> Vec<u8> {
    let mut frame = vec![0; HEAD];
    frame.extend_from_slice(&(1_u32 << (Field::Samples as u8)).to_le_bytes());
    for text in ["c1", "T1", "O1"] {
        frame.push(2);
        frame.extend_from_slice(text.as_bytes());
    }
    frame.extend_from_slice(&0_i64.to_le_bytes());
    frame.push(0);
    frame.extend_from_slice(&10.0_f64.to_le_bytes());
    frame.extend_from_slice(&u32::try_from(differences.len()).unwrap().to_le_bytes());
    frame.extend_from_slice(&[1, Channel::DepthMm as u8, places]);
    for difference in differences {
        put_varint(&mut frame, ((difference << 1) ^ (difference >> 63)).cast_unsigned());
    }
    frame.extend_from_slice(&[0; CHECKSUM]);
    sealed(frame)
}

#[test]
fn an_id_is_found_without_reading_the_rest() {
    let frame = frame_of(&[1, 2, 3], 3);
    assert!(matches!(read(&frame, 2), Err(WireError::TooManySamples(_))), "{:?}", read(&frame, 2));
    assert_eq!(cycle_id_of(&frame).as_deref(), Some("c1"));
    assert_eq!(cycle_id_of(GOLDEN), read(GOLDEN, 10).ok().map(|post| post.cycle_id));
    let mut torn = frame.clone();
    torn[HEAD + 6] ^= 1;
    for not in [&torn, &frame[..frame.len() - 1], b"FWC", b""] {
        assert_eq!(cycle_id_of(not), None);
    }
}

fn differences() -> impl Strategy<Value = Vec<i64>> {
    let short = || prop::collection::vec(-64_i64..64, 0..40);
    let any = prop_oneof![-300_i64..300, -(1_i64 << 53)..=1 << 53, any::<i64>()];
    (short(), prop::collection::vec(any, 0..3), short(), prop::collection::vec(-70_i64..70, 0..150))
        .prop_map(|(a, b, c, d)| [a, b, c, d].concat())
}

proptest! {
    /// Several at once as one by one: the same decimals, and the same refusals.
    #[test]
    fn integers_are_the_sums_of_their_differences(differences in differences(), places in 0_u8..=9) {
        let mut integer = 0_i64;
        let one_by_one: Option<Vec<u64>> = differences
            .iter()
            .map(|difference| {
                integer = integer.wrapping_add(*difference);
                #[expect(clippy::cast_precision_loss, reason = "below 2^53")]
                let value = integer as f64 / 10_f64.powi(places.into());
                (integer.unsigned_abs() < 1 << 53).then(|| value.to_bits())
            })
            .collect();
        let frame = frame_of(&differences, places);
        let read = read(&frame, 1000).map(|post| {
            let samples = post.samples.unwrap();
            samples.columns[0].1.iter().map(|value| value.to_bits()).collect::<Vec<_>>()
        });
        prop_assert_eq!(
            read,
            one_by_one.ok_or(WireError::LargeInteger(Some(Channel::DepthMm)))
        );
    }

    #[test]
    fn random_bytes_do_no_harm(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        prop_assert!(read(&bytes, 1000).is_err());
        let _ = read(&sealed(bytes), 1000);
    }

    #[test]
    fn mutated_frames_are_refused_or_read(
        mutations in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut frame = GOLDEN.to_vec();
        for (at, byte) in &mutations {
            let at = at.index(frame.len());
            frame[at] = *byte;
        }
        if let Some(cut) = cut {
            frame.truncate(cut.index(frame.len()) + 1);
        }
        if let Ok(post) = read(&sealed(frame), 1000) {
            for (_, values) in post.samples.iter().flat_map(|samples| &samples.columns) {
                prop_assert!(values.len() <= 1000);
            }
        }
    }
}

use super::super::guide::tests::drilled;
use super::*;
use feedwright_core::cycle::{Cycle, CycleDraft, Outcome, ProfileVersion, Reported, TimeBase};
use feedwright_core::units::{Process, Strategy as FeedStrategy, Timestamp};
use proptest::prelude::*;

/// A cycle that uses every kind of field.
pub(crate) fn cycle() -> Cycle {
    let columns = vec![
        (Channel::DepthMm, vec![-0.5, 0.0, 0.125, 1.75, 3.0]),
        (Channel::SpindleLoadPercent, vec![2.1, 2.1, 34.5, 33.9, 4.0]),
        (Channel::SpindlePowerWatts, vec![0.1 + 0.2, 1.0 / 3.0, 1e-12, 812.25, 0.0]),
    ];
    Cycle::new(CycleDraft {
        machine: "M1".try_into().unwrap(),
        id: "boot7:000123".try_into().unwrap(),
        tool: "T-4711".try_into().unwrap(),
        operation: "flange.hole-3".try_into().unwrap(),
        started_at: Timestamp::from_micros(1_700_000_000_123_456),
        seq: Some(123),
        process: Some(Process::Friction),
        strategy: Some(FeedStrategy::FAc),
        law_version: Some("law-1".to_owned()),
        profile: Some(ProfileVersion { profile: "P1".try_into().unwrap(), version: 3 }),
        reference: None,
        recommendation: Some("0192f0c1-7e1d-7cc3-98c4-dc0c0c07398f".try_into().unwrap()),
        spindle_speed_rpm: Some(2400.0),
        outcome: Outcome::Completed,
        samples: Some(Samples::new(TimeBase::Period { period_ms: 10.0 }, columns, 100).unwrap()),
        reported: Reported { duration_ms: Some(50.0), ..Reported::default() },
    })
    .unwrap()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn unhex(text: &str) -> Vec<u8> {
    text.as_bytes()
        .chunks(2)
        .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap())
        .collect()
}

/// Gives mutated bytes a checksum that holds, so that the parser behind it is reached.
fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let end = bytes.len().saturating_sub(CHECKSUM);
    bytes.truncate(end);
    let sum = checksum::<CHECKSUM>(&bytes);
    bytes.extend_from_slice(&sum);
    bytes
}

#[test]
fn the_bytes_are_fixed_for_ever() {
    let samples = cycle().samples.clone().unwrap();
    // Version 1, which is in databases.
    let first = unhex(
        "464201050300000000000000244001030ae707e807fa01b219c4130701072a0088050bd5040b0f2834551100003355ea000033552d0000335581000033559900003355976200d3d57189003f3f3d400029d939a0319268f8",
    );
    assert_eq!(decode_samples(&first, 5).unwrap(), samples);
    // Version 2, which is in databases too.
    let second = unhex(
        "464202050300000000000000244001030a01e7070b7d0bb7770bb4070109012a0900688d2792400b0f2834551100003355ea000033552d0000335581000033559900003355976200d3d57189003f3f3d40006621ed4e46f40157",
    );
    assert_eq!(decode_samples(&second, 5).unwrap(), samples);
    // Version 3, too.
    let third = unhex(
        "464203050300000000000000244001030a01e7070b7d0bb7770bb4070109012a0900688d2792400b0f2834551100003355ea000033552d0000335581000033559900003355976200d3d57189003f3f3d40006def92959e37f03b",
    );
    assert_eq!(decode_samples(&third, 5).unwrap(), samples);
    // Version 4, too.
    let fourth = unhex(
        "4642040503000000000000002440010311e707450701112a3f0b0f2834551100003355ea000033552d0000335581000033559900003355976200d3d57189003f3f3d4000f2daab00858e000020c1a01f371100626e31237735551a26eaba",
    );
    assert_eq!(decode_samples(&fourth, 5).unwrap(), samples);
    // Version 5, too.
    let fifth = unhex(
        "4642050503000000000000002440010311e707450701112a3f0b0f2834551100003355ea000033552d0000335581000033559900003355976200d3d57189003f3f3d4000f2daab00858e000020c1a01f371100626e31d61df8c937d638f3",
    );
    assert_eq!(decode_samples(&fifth, 5).unwrap(), samples);
    let bytes = encode_samples(&samples);
    assert_eq!(
        hex(&bytes),
        "4642060503000000000000002440010311e707450701112a3f0b0f2834551100003355ea000033552d0000335581000033559900003355976200d3d57189003f3f3d4000ecea6d00858e000020c1fe9e37110062f071220beaa59635b4e0"
    );
    assert_eq!(decode_samples(&bytes, 5).unwrap(), samples);
}

/// Noise around what bends goes to the fit over eight, around a ramp to that over sixteen; version 2 knew neither.
#[test]
fn the_bytes_of_fits_are_fixed_for_ever() {
    let mut noise = 7_u64;
    let mut noisy = |at: i32| {
        noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        f64::from(at + i32::try_from(noise >> 58).unwrap()) / 10.0
    };
    let bends = (0..64).map(|k: i32| noisy(k * k / 3)).collect();
    let rises = (0..64).map(|k: i32| noisy(9 * k)).collect();
    let columns = vec![(Channel::ThrustNewtons, bends), (Channel::TorqueNewtonMetres, rises)];
    let samples = Samples::new(TimeBase::Period { period_ms: 10.0 }, columns, 64).unwrap();
    let bytes = encode_samples(&samples);
    assert_eq!(
        hex(&bytes),
        "464206400200000000000000244009011434300a01152e3194c30000c7483a088f65d7592c0e657b9d2d94c7b7e7550c2e3eec4d314dcc9d8b5a7643598edb668c45af46d774fd64e076133b795cc13dd400968e14f1c7e53eea32d95ffd81112cf5c56cf73bf69ccc894fac2f479dfe9691ca9b88229253129e59086b51e508dc0d00b86282f98f136e328458c2"
    );
    assert_eq!(decode_samples(&bytes, 64).unwrap(), samples);
    let fifth = unhex(
        "464205400200000000000000244009011434300a01152e3118040900528a5e045666ca29751b4586b79c8ed618f0e5b268f4f6b82d3e1321b490e44f661a63606086b56af51bf38cdf3af36495f17d3dde6096161fd1a686cb0a32d9a5eda8312cf58f5c4c0c20adcc890e9c56179dfed071476b88229253129e59086b51e508dc0d00b86282c40fb69f59c490d1",
    );
    assert_eq!(decode_samples(&fifth, 64).unwrap(), samples);
    let fourth = unhex(
        "464204400200000000000000244009011434300a01152e3118040900528a5e045666ca29751b4586b79c8ed618f0e5b268f4f6b82d3e1321b490e44f661a63606086b56af51bf38cdf3af36495f17d3dde6096161fd1a686cb0a32d9a5eda8312cf58f5c4c0c20adcc890e9c56179dfed071476b88229253129e59086b51e508dc0d00b862820d0d90acdffb3067",
    );
    assert_eq!(decode_samples(&fourth, 64).unwrap(), samples);
    let third = unhex(
        "46420340020000000000000024400901380434066cfd211482c2ca69c0952920c48e1705c4ed4e282f02645a58ee8717b41338e470cd612054232db9550560e90e55ac15274e5b05800a0139052e06c6cfe6522e35d62a4a26e6ad5419b8a7c64db02c3dab46e514069878ab60d1aec9f1ad20a3e15e0ae294efe3806584e65405b852d2aa41b3e1151ffc5aaf",
    );
    assert_eq!(decode_samples(&third, 64).unwrap(), samples);
    let mut older = third;
    older[2] = 2;
    let Err(StoreError::Damaged { what }) = decode_samples(&sealed(older), 64) else {
        panic!("version 2 has none")
    };
    assert_eq!(what, "sample block: unknown predictor");
}

/// Columns that go each of the ways: a ramp, noise, a constant, a jump to the largest integers, one value.
fn ways() -> Vec<Vec<f64>> {
    let mut noise = 7_u64;
    let mut noisy = || {
        noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        f64::from(u32::try_from(noise >> 52).unwrap()) / 100.0
    };
    vec![
        (0..300).map(|k| f64::from(k * k / 40) / 1000.0).collect(),
        (0..300).map(|_| noisy()).collect(),
        vec![100.0; 300],
        (0..300).map(|k| if k % 100 == 50 { 9_007_199_254_740_991.0 } else { f64::from(k % 3) }).collect(),
        (0..300)
            .map(|k| if k % 2 == 0 { -9_007_199_254_740_991.0 } else { 9_007_199_254_740_991.0 })
            .collect(),
        vec![-0.25],
    ]
}

/// The ways that are as long as each other, in one block.
fn all_ways() -> Columns {
    let channels = [
        Channel::DepthMm,
        Channel::ThrustNewtons,
        Channel::OverridePercent,
        Channel::TorqueNewtonMetres,
        Channel::SpindlePowerWatts,
    ];
    let mut channels: Vec<_> = channels
        .into_iter()
        .zip(&ways())
        .map(|(channel, values)| (channel, Column::of(values, None)))
        .collect();
    channels.sort_by_key(|(channel, _)| *channel as u8);
    Columns { len: 300, time: Time::Period(10.0_f64.to_bits()), channels }
}

#[test]
fn columns_of_every_kind_come_back() {
    let whole = all_ways();
    assert!(whole.channels.iter().all(|(_, column)| matches!(column, Column::Decimal { .. })));
    let bytes = encode_columns(&whole);
    assert_eq!(decode_columns(&bytes, 300).unwrap(), whole);
    let body = &bytes[..bytes.len() - CHECKSUM];
    for cut in 0..body.len() {
        assert!(read_body(&body[..cut], 300).is_err(), "cut at {cut}");
    }
    assert!(read_body(&[body, &[0]].concat(), 300).is_err(), "trailing bytes");
    let constant = encode_samples(&constant(100.0, 300));
    assert!(constant.len() < 30, "a constant costs next to nothing: {}", constant.len());
}

#[test]
fn the_bytes_of_what_follows_are_fixed_for_ever() {
    let whole = drilled(100, 7);
    let bytes = encode_columns(&whole);
    assert_eq!(
        hex(&bytes),
        "464206640800000000000000244001031f00f4b403ed4d10020014c8011203001b00c8011e040010c8012006011a09d8fa01001e07011f0a80d102c8021f09001507280a0215d807298c64ec5fcaafd304a2878bbda8ca2aad004be5906a434b090c2a113b26fa3f3ad8e92ecdb959fe89e1d90debcedb932c5b4fccf94222b9fbc0274bda0874a2b39a12aa33212701de4902354b5eebe581a0ec5290ffb149214ea77dcb5201fa513d00625f0f55d03eab530de7ae33ab339411b51892cd9fdf0fa16206daf0773bb2fe68bd68e19c8665b237059674bc9163e9689be278d333f5aed3552ce1d30691aa39a4a0fb21c1b17d17aad11ba30492f264769f0407903e188191e4fa8b334cf940dfa36dd090cc51fc2a31a498fbfc3678f56f35e490483d58901d6b05dd9e916fb189a85187f083b46fea263b3f"
    );
    assert_eq!(decode_columns(&bytes, 100).unwrap(), whole);
    let fifth = unhex(
        "464205640800000000000000244001031f00f4b403ed4d10020014c8011203001b00c8011e040010c8012006011a09d8fa01001e07011f0a80d102c8021f09001507280a0215d80729762ce401b11f4600ae8f367d147db65c982a259bf5bbc61938898689d629246b62da6cccf1705a333209b939e369341acfde665a3ddca37c8116ab7b30193fc3fab9ff924aac872d2a7331cbc399a62948f44870ecfa2561db397b8a0f769d9124d0361f7df7ef12285c0d67ef3d2143fbc73549eb2adf0f2a9b085624f6ddcb0d032e0dbbc1c2e562a36f4582af63a147363a5babb8e16357955666a29045f50ec2ca6478f13690aa449b5ad9abd88d1ec08fb8e6818c7bc97ccc514dac6754ecb59adfa30c8fe164a370cdc34eb0dc42aba5c98d834050d5304bb1abb1906cdd60d0c3b7aaad52afbd26557e1520b0",
    );
    assert_eq!(decode_columns(&fifth, 100).unwrap(), whole);
    // As it was written where memories and slopes were told from fewer values, which is in databases.
    let earlier = unhex(
        "464205640800000000000000244001031f00f4b403ed4d10020014c8011203001f00c8011e040010c8012006011a09d4ef01001e07011f0aa8d602c8021e09001507280a0215d80729a9c30f00b13f01006c3ff0dbd5fcbf9b13eb28dde4ba73733d4aa6eab609c86aa87ac40c9a4a5933e1a8fd595ddad789cc1f23a49542c7b9cba71752f564ba79f989d21b6d00d5322f0b541786f33217ba05bcf652a1154ad004f77a2283dabe5ea77ff35a3e513e56ba324b41df198a5bddffb18763b1d5d7caf39c23e5afdc15334d6dda60b606088190af285abdad920791ab2811a35d90e4661a2b2c25dcaca0cedbd5153af22aa9aa23ee1e60f6b428496bdb1ebf3fb5d9ef716da4a921f3dafaf41298b9190771ca476b44421ded01c8b41c3e59c63a91a3feec3a9b55a1d57e79b9479d7b5d535721bc90510a3324823ba119",
    );
    assert_eq!(decode_columns(&earlier, 100).unwrap(), whole);
    let body = &bytes[..bytes.len() - CHECKSUM];
    for cut in 0..body.len() {
        assert!(read_body(&body[..cut], 100).is_err(), "cut at {cut}");
    }
    assert!(read_body(&[body, &[0]].concat(), 100).is_err(), "trailing bytes");
    // Version 4 had no guides.
    let mut older = body.to_vec();
    older[2] = FOURTH;
    assert_eq!(read_body(&older, 100).unwrap_err(), "unknown predictor");
}

/// Nobody follows what is not there, what is exact, or what it cannot be told by.
#[test]
fn guides_that_cannot_be_followed_are_refused() {
    let bytes = |channels: &[(Channel, Vec<u8>)]| {
        let mut body = MAGIC.to_vec();
        body.extend([FIFTH, 1, u8::try_from(channels.len()).unwrap(), 0]);
        body.extend(10.0_f64.to_le_bytes());
        for (channel, column) in channels {
            body.push(*channel as u8);
            body.extend(column);
        }
        body
    };
    let plain = vec![0, 0, 24];
    let exact = [&[EXACT, 8][..], &12.0_f64.to_le_bytes()].concat();
    // Memory 3, and what is followed by half.
    let led = |by: u8| [&[0, GUIDED | 3, by][..], &[0x80, 0x80, 0x04, 16]].concat();
    let (load, thrust, torque) =
        (Channel::FeedDriveLoadPercent, Channel::ThrustNewtons, Channel::TorqueNewtonMetres);
    let read = |channels: &[(Channel, Vec<u8>)]| read_body(&bytes(channels), 1);
    let refused = |channels: &[(Channel, Vec<u8>)]| read(channels).unwrap_err();
    let read_whole = read(&[(load, led(thrust as u8)), (thrust, plain.clone())]).unwrap();
    assert_eq!(read_whole.channels[0].1, Column::Decimal { scale: 0, values: vec![8] });
    assert_eq!(refused(&[(load, led(thrust as u8))]), "what a column follows is not there");
    let with_exact = [(load, led(thrust as u8)), (thrust, exact)];
    assert_eq!(refused(&with_exact), "what a column follows is not there");
    assert_eq!(refused(&[(load, led(torque as u8)), (torque, plain.clone())]), "unknown guide");
    assert_eq!(refused(&[(load, led(load as u8))]), "unknown guide");
    assert_eq!(refused(&[(load, led(0))]), "unknown guide");
    assert_eq!(refused(&[(load, led(200))]), "unknown guide");
    assert_eq!(refused(&[(thrust, led(load as u8))]), "unknown guide");
    // One that follows too, and is read later.
    let both_follow = [(load, led(15)), (thrust, plain), (Channel::FeedDriveTorqueNewtonMetres, led(9))];
    assert_eq!(refused(&both_follow), "what a column follows is not there");
    assert_eq!(
        refused(&[(Channel::FeedActualMmMin, vec![0, GUIDED, 0, 24])]),
        "what a column follows is not there"
    );
}

/// What earlier versions wrote of them: version 3 with both of its coders, version 5 with escapes and bits that stand plainly; and
/// what is written now.
#[test]
fn every_kind_of_column_is_fixed_for_ever() {
    let versions =
        [include_str!("version-3.hex"), include_str!("version-5.hex"), include_str!("version-6.hex")];
    let [third, fifth, sixth] = versions.map(|text| unhex(&text.split_whitespace().collect::<String>()));
    // Version 4 has no guides, nor have they.
    let mut fourth = fifth.clone();
    fourth[2] = FOURTH;
    let fourth = sealed(fourth);
    for bytes in [&third, &fourth, &fifth, &sixth] {
        let version = bytes[2];
        assert_eq!(decode_columns(bytes, 300).unwrap(), all_ways(), "{version}");
        let body = &bytes[..bytes.len() - CHECKSUM];
        for cut in 0..body.len() {
            assert!(read_body(&body[..cut], 300).is_err(), "{version}: cut at {cut}");
        }
        assert!(read_body(&[body, &[0]].concat(), 300).is_err(), "{version}: trailing bytes");
    }
    assert_eq!(hex(&encode_columns(&all_ways())), hex(&sixth));
}

#[test]
fn damage_and_foreign_versions_are_refused() {
    let bytes = encode_samples(&cycle().samples.clone().unwrap());
    let what = |bytes: &[u8]| match decode_samples(bytes, 5) {
        Err(StoreError::Damaged { what }) => what,
        other => panic!("{other:?}"),
    };
    for at in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x10;
        assert_eq!(what(&damaged), "sample block: checksum differs", "byte {at}");
    }
    assert_eq!(what(&[]), "sample block: too short");
    let mut newer = bytes.clone();
    newer[2] = 7;
    assert_eq!(what(&sealed(newer)), "sample block: not block format v1 to v6");
    assert!(decode_samples(&bytes, 4).is_err(), "more samples than the reader takes");
}

#[test]
fn channels_out_of_order_or_twice_are_refused() {
    let whole = Columns::of(cycle().samples.as_ref().unwrap());
    let refused = |columns: &Columns| match decode_columns(&encode_columns(columns), 5) {
        Err(StoreError::Damaged { what }) => what,
        other => panic!("{other:?}"),
    };
    let mut columns = whole.clone();
    columns.channels.reverse();
    assert_eq!(refused(&columns), "sample block: channels out of order");
    columns = whole.clone();
    columns.channels[1] = columns.channels[0].clone();
    assert_eq!(refused(&columns), "sample block: channels out of order");
    assert_eq!(decode_columns(&encode_columns(&whole), 5).unwrap(), whole);
    assert_eq!(whole.into_samples().unwrap(), *cycle().samples.as_ref().unwrap());
}

#[test]
fn values_that_no_channel_has_are_no_samples() {
    let mut columns = Columns::of(cycle().samples.as_ref().unwrap());
    columns.channels[0].1 = Column::Exact(vec![f64::NAN.to_bits(); 5]);
    let block = encode_columns(&columns);
    let Err(StoreError::Damaged { what }) = decode_samples(&block, 5) else { panic!("no samples") };
    assert_eq!(what, "sample block: values out of range");
}

#[test]
fn a_bomb_is_not_unpacked() {
    // Claims 5 samples; its one block unpacks to 64 MiB of zeros.
    let packed = zstd::bulk::compress(&vec![0; 64 << 20], 1).unwrap();
    let mut bytes = MAGIC.to_vec();
    bytes.extend_from_slice(&[FIRST, 5, 1, 0]);
    bytes.extend_from_slice(&10.0_f64.to_le_bytes());
    bytes.extend_from_slice(&[1, COMPRESSED, 5]);
    put_varint(&mut bytes, packed.len() as u64);
    bytes.extend_from_slice(&packed);
    bytes.extend_from_slice(&[0; CHECKSUM]);
    let error = decode_samples(&sealed(bytes), 1000).unwrap_err();
    assert!(
        matches!(&error, StoreError::Damaged { what } if what.ends_with("not decompressible")),
        "{error:?}"
    );
}

fn value() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => (-100_000_i64..100_000, 0_u8..4).prop_map(|(m, s)| super::super::column::decimal(m, s) + 0.0),
        1 => (-100_000.0_f64..100_000.0).prop_map(|v| v + 0.0),
    ]
}

/// A column of one kind: of anything, of decimals around each other, of a slow signal.
fn column(len: usize) -> impl Strategy<Value = Vec<f64>> {
    let decimal = |m: i64| super::super::column::decimal(m, 2);
    prop_oneof![
        prop::collection::vec(value(), len),
        prop::collection::vec((-9_000_i64..9_000).prop_map(decimal), len),
        (prop::collection::vec(-2_i64..3, len), -50_i64..50).prop_map(move |(steps, slope)| {
            let mut at = 0;
            let walk = |step| {
                at += step + slope;
                decimal(at)
            };
            steps.into_iter().map(walk).collect()
        }),
    ]
}

prop_compose! {
    fn any_samples()(len in 1_usize..120)(
        stamps in any::<bool>(),
        steps in prop::collection::vec(0_u32..30_000, len),
        depth in column(len),
        torque in column(len),
        power in column(len),
    ) -> Samples {
        let time = if stamps {
            let mut now = 0.0;
            TimeBase::Stamps { time_ms: steps.iter().map(|&step| { now += f64::from(step) / 1000.0; now }).collect() }
        } else {
            TimeBase::Period { period_ms: 1.0 + f64::from(steps[0]) / 7.0 }
        };
        let columns = vec![
            (Channel::DepthMm, depth),
            (Channel::TorqueNewtonMetres, torque),
            (Channel::SpindlePowerWatts, power),
        ];
        Samples::new(time, columns, 1000).unwrap()
    }
}

proptest! {
    #[test]
    fn samples_come_back_to_the_bit(samples in any_samples()) {
        let back = decode_samples(&encode_samples(&samples), samples.len()).unwrap();
        prop_assert_eq!(back.time(), samples.time());
        for (channel, values) in samples.columns() {
            let same = back.column(channel).unwrap().iter().zip(values).all(|(a, b)| a.to_bits() == b.to_bits());
            prop_assert!(same, "{:?}", channel);
        }
        prop_assert_eq!(back.columns().count(), samples.columns().count());
    }

    #[test]
    fn random_bytes_do_no_harm(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(decode_samples(&bytes, 1000).is_err());
    }

    #[test]
    fn mutated_blocks_are_refused_or_valid(
        samples in any_samples(),
        mutations in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = encode_samples(&samples);
        for (at, byte) in &mutations {
            let at = at.index(bytes.len());
            bytes[at] = *byte;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()) + 1);
        }
        // Whatever comes out went through the checks of `Samples`; what matters is that nothing panics.
        if let Ok(samples) = decode_samples(&sealed(bytes), 1000) {
            prop_assert!(samples.len() <= 1000);
        }
    }
}

fn constant(value: f64, len: usize) -> Samples {
    let columns = vec![(Channel::OverridePercent, vec![value; len])];
    Samples::new(TimeBase::Period { period_ms: 10.0 }, columns, len).unwrap()
}

/// Columns that never change, and those that change steadily, are nothing but zeros to the coder, however long they are.
#[test]
fn columns_that_never_surprise_come_back_whatever_their_length() {
    for len in [1, 2, 8, 500, 3000, 5000, 60_000] {
        for value in [0.0, 100.0, 7.3, 0.001] {
            let samples = constant(value, len);
            assert_eq!(
                decode_samples(&encode_samples(&samples), len).unwrap(),
                samples,
                "{len} times {value}"
            );
        }
        let count = u32::try_from(len).unwrap();
        let steady = (0..count).map(|k| f64::from(k) / 1000.0).collect::<Vec<f64>>();
        let last = (0..count).map(|k| f64::from(u8::from(k + 1 == count))).collect::<Vec<f64>>();
        let columns = vec![(Channel::DepthMm, steady), (Channel::OverridePercent, last)];
        let samples = Samples::new(TimeBase::Period { period_ms: 10.0 }, columns, len).unwrap();
        assert_eq!(decode_samples(&encode_samples(&samples), len).unwrap(), samples, "{len}");
    }
}

/// Blocks that an earlier writer cut one zero too short are read all the same.
#[test]
fn a_column_of_zeros_that_lost_its_first_one_is_read() {
    let samples = constant(0.0, 40);
    // Form, length and coding of a column of version 3: its first value is missing.
    let mut short = b"FB\x03\x28\x01\x00".to_vec();
    short.extend(10.0_f64.to_le_bytes());
    short.extend([Channel::OverridePercent as u8, 0, 1, RANGE]);
    short.extend(super::checksum::<CHECKSUM>(&short));
    assert_eq!(decode_samples(&short, 40).unwrap(), samples);
}

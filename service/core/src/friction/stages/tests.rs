//! Stages found on holes of the process model, quiet and noisy.

use super::*;
use crate::friction::noise::Noise;
use crate::friction::program::Strategy;
use crate::friction::twin::{
    CycleSample, CycleSetup, PAPER_SPINDLE_RPM, PaperStrategies, Twin, TwinParams, paper_params,
    typical_noise,
};
use proptest::prelude::{Just, Strategy as _, prop_assert, prop_assert_eq, prop_oneof, proptest};

fn hole(
    change: impl FnOnce(&mut TwinParams),
    strategy: &Strategy,
    wear: f64,
    seed: Option<u64>,
) -> Vec<CycleSample> {
    let mut params = paper_params();
    change(&mut params);
    if seed.is_some() {
        params.noise = typical_noise();
    }
    let setup = CycleSetup { approach_mm: 2.0, ..CycleSetup::new(PAPER_SPINDLE_RPM, wear) };
    let mut noise = seed.map(Noise::seeded);
    Twin::new(params).unwrap().record(strategy, &setup, noise.as_mut()).unwrap().0
}

fn stages(samples: &[CycleSample]) -> Stages {
    let column = |of: fn(&CycleSample) -> f64| samples.iter().map(of).collect::<Vec<f64>>();
    find_stages(
        &StageConfig::default(),
        &column(|s| s.depth_mm),
        &column(|s| s.process.feed_drive_percent),
        &column(|s| s.process.spindle_percent),
    )
    .unwrap()
}

fn depth(mark: Option<Mark>) -> f64 {
    mark.expect("was found").depth_mm
}

fn until(strategy: &Strategy, end_mm: f64) -> Strategy {
    Strategy::new(&*strategy.name, strategy.program.clone(), end_mm, strategy.law).unwrap()
}

#[test]
fn a_quiet_hole_shows_contact_and_all_four_stages_where_the_model_has_them() {
    let s = PaperStrategies::new().unwrap();
    let params = paper_params();
    for strategy in s.all() {
        let found = stages(&hole(|_| {}, strategy, 0.0, None));
        let name = &strategy.name;
        assert!((0.0..0.6).contains(&depth(found.contact)), "{name}: {found:?}");
        assert!((1.3..2.6).contains(&depth(found.thrust_maximum)), "{name}: {found:?}");
        assert!(depth(found.breakthrough) > depth(found.thrust_maximum), "{name}");
        assert!((7.0..13.5).contains(&depth(found.torque_maximum)), "{name}: {found:?}");
        assert!(depth(found.falling_edge) > depth(found.torque_maximum), "{name}");
        let collar = params.tool.collar_depth_mm() - params.sheet.flash_height_mm;
        assert!((depth(found.flange) - collar).abs() < 1.2, "{name}: {found:?}");
    }
}

#[test]
fn noise_moves_the_boundaries_only_a_little() {
    for strategy in PaperStrategies::new().unwrap().all() {
        let quiet = stages(&hole(|_| {}, strategy, 0.0, None));
        for seed in 0..20 {
            let noisy = stages(&hole(|_| {}, strategy, 0.0, Some(seed)));
            let near = |a: Option<Mark>, b: Option<Mark>, mm: f64| (depth(a) - depth(b)).abs() < mm;
            let name = &strategy.name;
            assert!(near(noisy.contact, quiet.contact, 0.4), "{name}, seed {seed}: {noisy:?}");
            assert!(near(noisy.thrust_maximum, quiet.thrust_maximum, 0.5), "{name}, seed {seed}: {noisy:?}");
            assert!(near(noisy.torque_maximum, quiet.torque_maximum, 2.0), "{name}, seed {seed}: {noisy:?}");
            assert!(near(noisy.falling_edge, quiet.falling_edge, 0.6), "{name}, seed {seed}: {noisy:?}");
            assert!(near(noisy.flange, quiet.flange, 1.5), "{name}, seed {seed}: {noisy:?}");
        }
    }
}

#[test]
fn the_spin_up_peak_is_no_contact_and_no_torque_maximum() {
    let constant = PaperStrategies::new().unwrap().constant;
    let samples = hole(|p| p.machine.spindle_inertia_kg_m2 *= 3.0, &constant, 0.0, Some(1));
    let peak = samples
        .iter()
        .max_by(|a, b| a.process.spindle_percent.total_cmp(&b.process.spindle_percent))
        .unwrap();
    assert!(peak.depth_mm < 0.0, "the spin-up is the largest spindle load of the cycle");
    let found = stages(&samples);
    assert!(depth(found.contact) > -0.05 && depth(found.torque_maximum) > 5.0, "{found:?}");
}

#[test]
fn a_tool_that_never_breaks_through_has_only_contact() {
    let s = PaperStrategies::new().unwrap();
    for seed in 0..10 {
        let found = stages(&hole(|_| {}, &until(&s.constant, 1.5), 0.0, Some(seed)));
        assert!(found.contact.is_some());
        assert_eq!(Stages { contact: None, ..found }, Stages::default(), "seed {seed}");
    }
}

#[test]
fn without_a_flange_the_hole_ends_in_the_idle_travel() {
    let s = PaperStrategies::new().unwrap();
    for seed in 0..10 {
        let found = stages(&hole(|_| {}, &until(&s.constant, 17.0), 0.0, Some(seed)));
        assert!(found.falling_edge.is_some() && found.flange.is_none(), "seed {seed}: {found:?}");
    }
}

#[test]
fn a_short_tool_has_a_short_idle_travel_and_a_very_short_one_none() {
    let s = PaperStrategies::new().unwrap();
    let drilled = |strategy: &Strategy, cylinder_mm: f64, seed| {
        let mut params = paper_params();
        params.tool.cylinder_length_mm = cylinder_mm;
        let collar = params.tool.collar_depth_mm() - params.sheet.flash_height_mm;
        let end = until(strategy, collar + 1.5);
        (collar, stages(&hole(|p| p.tool.cylinder_length_mm = cylinder_mm, &end, 0.0, seed)))
    };
    for strategy in [&s.constant, &s.stepped, &s.linear] {
        for seed in [None, Some(1), Some(2), Some(3)] {
            let (collar, short) = drilled(strategy, 5.5, seed);
            let name = &strategy.name;
            assert!(depth(short.falling_edge) < collar, "{name}: {short:?}");
            assert!((depth(short.flange) - collar).abs() < 1.0, "{name}, collar at {collar}: {short:?}");
        }
    }
    // The collar arrives while the loads still fall: no sharp fall, so no stage C, and a flange follows B.
    let (collar, shorter) = drilled(&s.constant, 4.0, None);
    assert!(shorter.falling_edge.is_none(), "{shorter:?}");
    assert!((depth(shorter.flange) - collar).abs() < 0.5, "collar at {collar}: {shorter:?}");
    // Shorter still, the thrust rises by a thirtieth of its maximum: by load there is no flange.
    let (_, very_short) = drilled(&s.constant, 3.0, None);
    assert!(very_short.breakthrough.is_some() && very_short.falling_edge.is_none(), "{very_short:?}");
    assert!(very_short.flange.is_none(), "{very_short:?}");
}

#[test]
fn wear_moves_the_falling_edge_deeper() {
    let constant = PaperStrategies::new().unwrap().constant;
    for seed in 0..10 {
        let new = stages(&hole(|_| {}, &constant, 0.0, Some(seed)));
        let worn = stages(&hole(|_| {}, &constant, 1.0, Some(seed)));
        assert!(depth(worn.falling_edge) - depth(new.falling_edge) > 0.5, "seed {seed}");
    }
}

#[test]
fn a_hole_in_two_parts_gives_the_stages_of_the_whole_and_bad_samples_are_skipped() {
    let samples = hole(|_| {}, &PaperStrategies::new().unwrap().linear, 0.0, Some(2));
    let config = StageConfig::default();
    let rows: Vec<StageSample> = samples
        .iter()
        .map(|s| StageSample {
            depth_mm: s.depth_mm,
            feed_drive_percent: s.process.feed_drive_percent,
            spindle_percent: s.process.spindle_percent,
        })
        .collect();
    for cut in [1, 50, 150, 300] {
        let mut first = StageDetector::new();
        for row in &rows[..cut] {
            first.step(&config, row);
        }
        let mut carried = first.clone();
        for row in &rows[cut..] {
            carried.step(&config, row);
        }
        assert_eq!(carried.stages(), stages(&samples));
    }
    let mut broken = StageDetector::new();
    for (k, row) in rows.iter().enumerate() {
        let lost = StageSample { spindle_percent: f64::NAN, ..*row };
        broken.step(&config, if k % 17 == 3 { &lost } else { row });
    }
    let whole = stages(&samples);
    assert!((depth(broken.stages().falling_edge) - depth(whole.falling_edge)).abs() < 0.6);
}

/// What the whole detector tells of a hole up to where the sheet opens, and what is told without the spindle's load.
fn openings(config: &StageConfig, depth_mm: &[f64], feed_drive: &[f64], spindle: &[f64]) -> [Stages; 2] {
    let found = find_stages(config, depth_mm, feed_drive, spindle).unwrap();
    let Stages { contact, thrust_maximum, breakthrough, .. } = found;
    let up_to_it = Stages { contact, thrust_maximum, breakthrough, ..Stages::default() };
    [up_to_it, StageDetector::opening(config, depth_mm, feed_drive)]
}

#[test]
fn where_the_sheet_opens_is_told_without_the_spindle_s_load() {
    let mut opened = 0;
    for strategy in PaperStrategies::new().unwrap().all() {
        for seed in 0..20 {
            let samples = hole(|_| {}, strategy, f64::from(u32::try_from(seed).unwrap()) / 20.0, Some(seed));
            let column = |of: fn(&CycleSample) -> f64| samples.iter().map(of).collect::<Vec<f64>>();
            let (mut depth_mm, spindle) = (column(|s| s.depth_mm), column(|s| s.process.spindle_percent));
            let mut feed_drive = column(|s| s.process.feed_drive_percent);
            let [whole, alone] = openings(&StageConfig::default(), &depth_mm, &feed_drive, &spindle);
            assert_eq!(whole, alone, "{}, seed {seed}", strategy.name);
            opened += usize::from(alone.breakthrough.is_some());
            // Standing still, going back a little, and what is no number.
            for at in (20..depth_mm.len()).step_by(31) {
                depth_mm[at] = depth_mm[at - 1] - 0.03 * f64::from(u32::try_from(at % 3).unwrap());
            }
            feed_drive[40] = f64::NAN;
            depth_mm[60] = f64::INFINITY;
            let [whole, alone] = openings(&StageConfig::default(), &depth_mm, &feed_drive, &spindle);
            assert_eq!(whole, alone, "{}, seed {seed}, disturbed", strategy.name);
        }
    }
    assert!(opened > 60, "{opened}");
}

#[test]
fn drawing_back_ends_the_hole() {
    let samples = hole(|_| {}, &PaperStrategies::new().unwrap().constant, 0.0, None);
    let mut detector = StageDetector::new();
    let config = StageConfig::default();
    for s in &samples {
        detector.step(
            &config,
            &StageSample {
                depth_mm: s.depth_mm,
                feed_drive_percent: s.process.feed_drive_percent,
                spindle_percent: s.process.spindle_percent,
            },
        );
    }
    assert_eq!(detector.stage(), Stage::D);
    let back = StageSample { depth_mm: 10.0, feed_drive_percent: 4.0, spindle_percent: 5.0 };
    assert_eq!(detector.step(&config, &back), Stage::Done);
}

#[test]
fn thresholds_out_of_range_and_columns_of_different_length_are_refused() {
    let refused = |params| StageConfig::new(params).unwrap_err().field().to_owned();
    let even = StageParams { smoothing_samples: 8, ..StageParams::default() };
    assert_eq!(refused(even), "smoothing_samples");
    assert_eq!(refused(StageParams { flange_rise: 0.0, ..StageParams::default() }), "flange_rise");
    let error = find_stages(&StageConfig::default(), &[0.0], &[0.0], &[]).unwrap_err();
    assert_eq!(error.field(), "spindle_percent");
}

fn any_sample() -> impl proptest::strategy::Strategy<Value = StageSample> {
    let value = || prop_oneof![9 => -50.0..150.0_f64, 1 => proptest::num::f64::ANY];
    (value(), value(), value()).prop_map(|(depth_mm, feed_drive_percent, spindle_percent)| StageSample {
        depth_mm,
        feed_drive_percent,
        spindle_percent,
    })
}

proptest! {
    /// Idle, a rise and a fall, as of a hole, with noise, ways back and what is no number among them.
    #[test]
    fn whatever_comes_the_sheet_opens_where_the_whole_detector_says(
        (idle, rise, fall) in (0_u32..60, 1_u32..60, 0_u32..60),
        noise in proptest::collection::vec((-1.0..1.0_f64, -0.05..0.3_f64, 0.0..60.0_f64, 0..60_u8), 180),
        (rough, highest) in (0.0..6.0_f64, 2.0..60.0_f64),
        (half, feed_exponent, confirm_mm) in (0_usize..=15, prop_oneof![Just(0.5), Just(1.0), 0.0..1.0_f64], 0.0..0.6_f64),
    ) {
        let params = StageParams {
            smoothing_samples: 2 * half + 1, thrust_feed_exponent: feed_exponent, confirm_mm, ..StageParams::default()
        };
        let config = StageConfig::new(params).unwrap();
        let (mut at, mut columns) = (-3.0, [const { Vec::new() }; 3]);
        for (index, (noise, way, spindle, odd)) in (0..idle + rise + fall).zip(noise) {
            at += way;
            let course = match index {
                index if index < idle => 0.0,
                index if index < idle + rise => f64::from(index - idle) / f64::from(rise),
                index => 1.0 - f64::from(index - idle - rise) / f64::from(fall),
            };
            let thrust = 5.0 + highest * course + rough * noise;
            let (depth_mm, thrust) = match odd {
                0 => (f64::NAN, thrust),
                1 => (at, f64::NEG_INFINITY),
                2 => (at - 0.25, thrust),
                _ => (at, thrust),
            };
            // The whole detector passes over a sample whose spindle load is no number: here it is one.
            for (column, value) in columns.iter_mut().zip([depth_mm, thrust, spindle]) {
                column.push(value);
            }
        }
        let [whole, alone] = openings(&config, &columns[0], &columns[1], &columns[2]);
        prop_assert_eq!(whole, alone);
    }

    #[test]
    fn whatever_comes_stages_only_go_forward_and_nothing_is_before_contact(
        samples in proptest::collection::vec(any_sample(), 1..300),
    ) {
        let order = [Stage::Air, Stage::A, Stage::B, Stage::C, Stage::D, Stage::Done];
        let place = |stage| order.iter().position(|other| *other == stage);
        let mut detector = StageDetector::new();
        let mut last = place(Stage::Air);
        for sample in &samples {
            let now = place(detector.step(&StageConfig::default(), sample));
            prop_assert!(now >= last);
            last = now;
        }
        let found = detector.stages();
        if let Some(contact) = found.contact {
            let later = [found.breakthrough, found.falling_edge, found.flange];
            prop_assert!(later.iter().flatten().all(|mark| mark.index + LONGEST_SMOOTHING > contact.index));
        } else {
            prop_assert_eq!(found, Stages::default());
        }
    }
}

//! A small sample of what the example `life_study` runs at length.

use super::*;
use crate::friction::twin::{NoiseLevels, TwinParams, paper_params, typical_noise};

fn noisy() -> Twin {
    let noise = NoiseLevels { thrust_n: 0.0, torque_nm: 0.0, ..typical_noise() };
    Twin::new(TwinParams { noise, ..paper_params() }).unwrap()
}

fn sets() -> Vec<Vec<(units::Strategy, Strategy)>> {
    let paper = PaperStrategies::new().unwrap();
    let all: Vec<_> = units::Strategy::ALL.into_iter().zip(paper.all().map(Clone::clone)).collect();
    let mut sets: Vec<_> = all.iter().map(|one| vec![one.clone()]).collect();
    sets.push(all);
    sets
}

fn name(strategies: &[(units::Strategy, Strategy)]) -> String {
    strategies.iter().map(|(word, _)| word.as_str()).collect::<Vec<_>>().join("+")
}

#[test]
fn wear_is_called_within_15_percent_of_the_life_at_constant_feed_whatever_the_strategy() {
    for strategies in sets() {
        let name = name(&strategies);
        let study =
            LifeStudy::new(&noisy(), LifeStudyParams::paper(strategies, true, true).unwrap()).unwrap();
        let summary = study.run(1000, 3).unwrap();
        assert_eq!((summary.lives, summary.within_15_percent), (3, 3), "{name}: {summary:?}");
    }
}

#[test]
fn wear_is_never_called_on_a_tool_that_does_not_wear() {
    for strategies in sets() {
        let name = name(&strategies);
        for with_references in [true, false] {
            let params = LifeStudyParams::paper(strategies.clone(), false, with_references).unwrap();
            let params = LifeStudyParams { horizon_cycles: 14_000, thin: 40, ..params };
            let summary = LifeStudy::new(&noisy(), params).unwrap().run(2000, 1).unwrap();
            assert_eq!((summary.lives, summary.called), (1, 0), "{name}: {summary:?}");
        }
    }
}

/// Without reference cycles a level is only called where it is known: what cannot be told says so.
#[test]
fn without_reference_cycles_wear_is_called_in_time_or_said_to_be_masked() {
    for strategies in sets() {
        let name = name(&strategies);
        let params = LifeStudyParams::paper(strategies, true, false).unwrap();
        let outcome = LifeStudy::new(&noisy(), params).unwrap().life(7).unwrap();
        match outcome.ratio() {
            Some(ratio) => assert!((ratio - 1.0).abs() < 0.2, "{name}: {outcome:?}"),
            None => assert!(outcome.masked_cycles > outcome.drilled_cycles / 3, "{name}: {outcome:?}"),
        }
    }
}

/// Another process than the one the constants were chosen on: thicker walls, drag that grows with the feed, wear that
/// slows down, another material and noise half as large again.
#[test]
fn another_process_is_called_in_time_too() {
    let mut other = paper_params();
    other.sheet.thickness_mm = 3.0;
    other.sheet.bushing_length_mm = 10.0;
    other.material.torque_rate_exponent = 0.7;
    other.material.softening_k = 700.0;
    other.wear.rate_exponent = 0.3;
    other.wear.drag_mpa = 25.0;
    other.wear.growth_exponent = 0.8;
    let noise = typical_noise();
    other.noise = NoiseLevels { thrust_n: 0.0, torque_nm: 0.0, cycle: 1.5 * noise.cycle, ..noise };
    let twin = Twin::new(other).unwrap();
    for strategies in sets() {
        let name = name(&strategies);
        let params = LifeStudyParams::paper(strategies, true, true).unwrap();
        let study = LifeStudy::new(&twin, params).unwrap();
        let outcome = study.life(11).unwrap();
        assert!(outcome.ratio().is_some_and(|ratio| (ratio - 1.0).abs() <= 0.2), "{name}: {outcome:?}");
    }
}

#[test]
fn a_prepared_hole_is_the_hole() {
    let twin = Twin::new(paper_params()).unwrap();
    let paper = PaperStrategies::new().unwrap();
    let bins = RelationConfig::new(RelationParams::energy(DIGEST_DEPTH_MM)).unwrap();
    for (wear, strategy) in [(0.0, &paper.constant), (0.7, &paper.stepped), (1.1, &paper.linear)] {
        let setup = CycleSetup::new(PAPER_SPINDLE_RPM, wear);
        let machine = twin.params().machine;
        let (mut before, mut profile) = (0.0, DepthProfile::new(&bins));
        let figures = twin
            .drill(strategy, &setup, None, |sample| {
                if sample.depth_mm > 0.0 {
                    let percent = sample.process.spindle_percent - machine.spindle_idle_percent;
                    let torque = percent / 100.0 * machine.spindle_rated_torque_nm();
                    let energy = torque_energy_j(torque, setup.spindle_rpm, setup.period_s);
                    profile.add(&bins, before, sample.depth_mm, setup.period_s, energy);
                    before = sample.depth_mm;
                }
            })
            .unwrap();
        let hole = twin.prepare(strategy, &setup, &bins).unwrap().unwrap();
        let (prepared, duration_s) = twin.drill_prepared(&hole, wear, None);
        assert!((duration_s - figures.duration_s).abs() < 1e-9);
        for (one, other) in profile.bins().iter().zip(prepared.bins()) {
            assert!((one.total - other.total).abs() < 1e-6 * (1.0 + one.total.abs()), "{one:?} {other:?}");
            assert!((one.time_s - other.time_s).abs() < 1e-9 && (one.way_mm - other.way_mm).abs() < 1e-9);
        }
    }
    assert!(twin.prepare(&paper.adaptive, &CycleSetup::new(2800.0, 0.0), &bins).unwrap().is_none());
}

#[test]
fn a_study_in_parts_is_the_study_in_one() {
    let constant = sets().remove(0);
    let params = LifeStudyParams { thin: 200, ..LifeStudyParams::paper(constant, true, true).unwrap() };
    let study = LifeStudy::new(&noisy(), params).unwrap();
    let parts: Vec<LifeOutcome> = (5..9).map(|seed| study.life(seed).unwrap()).collect();
    assert_eq!(summarise(&parts), study.run(5, 4).unwrap());
    assert!((study.nominal_life_cycles() - 10_000.0).abs() < 1500.0, "{}", study.nominal_life_cycles());
}

#[test]
fn a_study_that_cannot_end_is_refused() {
    let good = LifeStudyParams::paper(sets().remove(0), true, true).unwrap();
    let refused = |params| LifeStudy::new(&noisy(), params).unwrap_err().field().to_owned();
    assert_eq!(refused(LifeStudyParams { strategies: vec![], ..good.clone() }), "strategies");
    assert_eq!(refused(LifeStudyParams { thin: 0, ..good.clone() }), "thin");
    assert_eq!(refused(LifeStudyParams { horizon_cycles: 10_000_000, thin: 1, ..good.clone() }), "thin");
    let tireless = TwinParams {
        wear: crate::friction::twin::WearEffect { drag_mpa: 0.0, ..paper_params().wear },
        ..paper_params()
    };
    let error = LifeStudy::new(&Twin::new(tireless).unwrap(), good).unwrap_err();
    assert_eq!(error.code(), InvalidCode::NotIdentifiable);
}

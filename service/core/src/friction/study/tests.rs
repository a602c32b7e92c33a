//! A small sample of the life study; the thousand lives run from a command of their own.

use super::*;
use crate::friction::twin::{TwinParams, paper_params, typical_noise};

fn noisy() -> Twin {
    Twin::new(TwinParams { noise: typical_noise(), ..paper_params() }).unwrap()
}

fn sets() -> Vec<Vec<Strategy>> {
    let s = PaperStrategies::new().unwrap();
    let all: Vec<Strategy> = s.all().map(Clone::clone).to_vec();
    let mut sets: Vec<Vec<Strategy>> = all.iter().map(|one| vec![one.clone()]).collect();
    sets.push(all);
    sets
}

#[test]
fn wear_is_called_within_15_percent_of_the_life_at_constant_feed_whatever_the_strategy() {
    let twin = noisy();
    for strategies in sets() {
        let name = strategies[0].name.clone();
        let study = LifeStudy::new(&twin, LifeStudyParams::paper(strategies, true).unwrap()).unwrap();
        let summary = study.run(&twin, 1000, 3).unwrap();
        assert_eq!((summary.lives, summary.within_15_percent), (3, 3), "{name}: {summary:?}");
    }
}

#[test]
fn wear_is_never_called_on_a_tool_that_does_not_wear() {
    let twin = noisy();
    for strategies in sets() {
        let name = strategies[0].name.clone();
        let params = LifeStudyParams::paper(strategies, false).unwrap();
        let study = LifeStudy::new(&twin, LifeStudyParams { horizon_cycles: 14_000, ..params }).unwrap();
        let summary = study.run(&twin, 2000, 2).unwrap();
        assert_eq!((summary.lives, summary.called), (2, 0), "{name}: {summary:?}");
    }
}

#[test]
fn without_reference_cycles_adaptive_feed_is_flagged_and_not_called_wrongly() {
    let twin = noisy();
    let adaptive = PaperStrategies::new().unwrap().adaptive;
    let mut params = LifeStudyParams::paper(vec![adaptive], true).unwrap();
    let never = WearParams { reference_every: None, ..*params.wear.params() };
    params.wear = WearConfig::new(never).unwrap();
    params.thin = 100;
    let study = LifeStudy::new(&twin, params).unwrap();
    let outcome = study.life(&twin, 7).unwrap();
    assert_eq!(outcome.reference_cycles, 0);
    assert!(outcome.called_at.is_none_or(|_| (outcome.ratio().unwrap() - 1.0).abs() < 0.15), "{outcome:?}");
    assert!(outcome.masked_cycles > outcome.drilled_cycles / 3, "{outcome:?}");
}

#[test]
fn a_study_in_parts_is_the_study_in_one() {
    let twin = noisy();
    let constant = PaperStrategies::new().unwrap().constant;
    let mut params = LifeStudyParams::paper(vec![constant], true).unwrap();
    params.thin = 200;
    let study = LifeStudy::new(&twin, params).unwrap();
    let parts: Vec<LifeOutcome> = (5..9).map(|seed| study.life(&twin, seed).unwrap()).collect();
    assert_eq!(summarise(&parts), study.run(&twin, 5, 4).unwrap());
    assert!((study.nominal_life_cycles() - 10_000.0).abs() < 1500.0, "{}", study.nominal_life_cycles());
}

#[test]
fn a_study_that_cannot_end_is_refused() {
    let twin = noisy();
    let s = PaperStrategies::new().unwrap();
    let good = LifeStudyParams::paper(vec![s.constant], true).unwrap();
    let refused = |params| LifeStudy::new(&twin, params).unwrap_err().field().to_owned();
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

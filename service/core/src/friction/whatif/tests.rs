//! Predictions beside what the process model really does under the other control.

use super::*;
use crate::friction::law::LawParams;
use crate::friction::noise::Noise;
use crate::friction::program::Strategy;
use crate::friction::relation::RelationParams;
use crate::friction::twin::{
    CycleFigures, CycleSetup, PAPER_END_DEPTH_MM, PAPER_SPINDLE_RPM, PaperStrategies, Twin, TwinParams,
    paper_params, typical_noise,
};

struct Columns {
    depth: Vec<f64>,
    feed_drive: Vec<f64>,
    spindle: Vec<f64>,
}

fn drill(strategy: &Strategy, seed: u64) -> (Columns, CycleFigures) {
    let twin = Twin::new(TwinParams { noise: typical_noise(), ..paper_params() }).unwrap();
    let setup = CycleSetup::new(PAPER_SPINDLE_RPM, 0.0);
    let (samples, figures) = twin.record(strategy, &setup, Some(&mut Noise::seeded(seed))).unwrap();
    let contact = samples.iter().filter(|s| s.depth_mm >= 0.0);
    let columns = Columns {
        depth: contact.clone().map(|s| s.depth_mm).collect(),
        feed_drive: contact.clone().map(|s| s.process.feed_drive_percent).collect(),
        spindle: contact.map(|s| s.process.spindle_percent).collect(),
    };
    (columns, figures)
}

fn stored(columns: &Columns) -> StoredCycle<'_> {
    let machine = paper_params().machine;
    StoredCycle {
        period_s: 0.01,
        depth_mm: &columns.depth,
        feed_drive_percent: &columns.feed_drive,
        spindle_percent: &columns.spindle,
        feed_drive_idle_percent: machine.feed_idle_percent,
        spindle_idle_percent: machine.spindle_idle_percent,
        spindle_rpm: PAPER_SPINDLE_RPM,
        spindle_rated_torque_nm: Some(machine.spindle_rated_torque_nm()),
    }
}

fn relations(strategy: &Strategy) -> LoadRelations {
    let config = RelationConfig::new(RelationParams::load(PAPER_END_DEPTH_MM)).unwrap();
    let mut relations = LoadRelations::new(config);
    for (seed, factor) in [0.7, 1.0, 1.4, 0.8, 1.0, 1.25].into_iter().enumerate() {
        let program = strategy.program.scaled(factor).unwrap();
        let explored = Strategy::new("explored", program, strategy.end_depth_mm(), None).unwrap();
        let (columns, _) = drill(&explored, seed as u64);
        relations.observe(&stored(&columns), FeedSource::Programmed).unwrap();
    }
    relations
}

const LIMITS: LoadLimits = LoadLimits { feed_drive_percent: Some(40.0), spindle_percent: Some(50.0) };

fn ask(cycle: &StoredCycle<'_>, relations: &LoadRelations, own: &Strategy, other: &Strategy) -> WhatIf {
    let control = |s: &Strategy| Control { program: s.program.clone(), law: s.law };
    let axis = paper_params().machine.axis;
    what_if(cycle, relations, &axis, &LIMITS, &control(own), &control(other)).unwrap()
}

#[test]
fn the_cycles_own_control_gives_the_cycle_back() {
    let s = PaperStrategies::new().unwrap();
    for strategy in s.all() {
        let (columns, figures) = drill(strategy, 50);
        let answer = ask(&stored(&columns), &relations(strategy), strategy, strategy);
        let name = &strategy.name;
        assert!((answer.happened.duration_s - figures.duration_s).abs() < 0.02, "{name}: {answer:?}");
        assert!(answer.error.duration_relative.abs() < 0.03, "{name}: {:?}", answer.error);
        assert!(answer.error.energy_relative.unwrap().abs() < 0.04, "{name}: {:?}", answer.error);
        assert!(answer.error.feed_drive_rms_points < 3.0, "{name}: {:?}", answer.error);
        assert!(answer.error.spindle_rms_points < 5.0, "{name}: {:?}", answer.error);
        let again = answer.happened.duration_s * (1.0 + answer.error.duration_relative);
        assert!((again - answer.predicted.duration_s).abs() < 1e-9, "{name}: the same run twice");
    }
}

#[test]
fn another_program_is_predicted_close_to_what_the_machine_then_does() {
    let s = PaperStrategies::new().unwrap();
    let (columns, then) = drill(&s.linear, 60);
    let faster =
        Strategy::new("faster", s.linear.program.scaled(1.2).unwrap(), PAPER_END_DEPTH_MM, None).unwrap();
    let answer = ask(&stored(&columns), &relations(&s.linear), &s.linear, &faster);
    let (_, truth) = drill(&faster, 61);
    assert!(truth.duration_s < then.duration_s);
    assert!((answer.predicted.duration_s / truth.duration_s - 1.0).abs() < 0.03, "{answer:?}");
    assert!(
        (answer.predicted.peak_spindle_percent / truth.spindle_percent.value - 1.0).abs() < 0.12,
        "{answer:?}"
    );
    assert!((answer.predicted.peak_feed_drive_percent / truth.feed_drive_percent.value - 1.0).abs() < 0.12);
    assert!((answer.predicted.energy_j.unwrap() / truth.energy_j - 1.0).abs() < 0.06, "{answer:?}");
    assert!(answer.predicted.overload_s > 0.0 && answer.extrapolated < 0.2, "{answer:?}");
}

#[test]
fn the_law_at_raised_loads_is_predicted_shorter_by_what_it_really_saves() {
    let s = PaperStrategies::new().unwrap();
    let (columns, then) = drill(&s.adaptive, 70);
    let answer = ask(&stored(&columns), &relations(&s.adaptive), &s.adaptive, &s.adaptive_raised);
    let (_, truth) = drill(&s.adaptive_raised, 71);
    let saved = |duration: f64| 1.0 - duration / then.duration_s;
    assert!((saved(answer.predicted.duration_s) - saved(truth.duration_s)).abs() < 0.05, "{answer:?}");
    let gentle = LawParams { intensity: 8.0, ..LawParams::paper(20.0, 25.0).unwrap() };
    let gentle = Strategy::new(
        "gentle",
        s.adaptive.program.clone(),
        PAPER_END_DEPTH_MM,
        Some(LawConfig::new(gentle).unwrap()),
    )
    .unwrap();
    let answer = ask(&stored(&columns), &relations(&s.adaptive), &s.adaptive, &gentle);
    assert!(answer.predicted.duration_s > answer.happened.duration_s);
    assert!(answer.predicted.peak_spindle_percent < answer.happened.peak_spindle_percent);
}

#[test]
fn without_a_rating_there_are_no_joules_and_bad_columns_are_refused_by_path() {
    let s = PaperStrategies::new().unwrap();
    let (columns, _) = drill(&s.linear, 80);
    let known = relations(&s.linear);
    let unrated = StoredCycle { spindle_rated_torque_nm: None, ..stored(&columns) };
    let answer = ask(&unrated, &known, &s.linear, &s.linear);
    assert!(answer.predicted.energy_j.is_none() && answer.error.energy_relative.is_none());

    let control = Control { program: s.linear.program.clone(), law: None };
    let axis = paper_params().machine.axis;
    let refused = |cycle: StoredCycle<'_>, relations: &LoadRelations| {
        let error = what_if(&cycle, relations, &axis, &LIMITS, &control, &control).unwrap_err();
        (error.field().to_owned(), error.code())
    };
    let short = StoredCycle { spindle_percent: &columns.spindle[1..], ..stored(&columns) };
    assert_eq!(refused(short, &known), ("spindle_percent".into(), InvalidCode::LengthMismatch));
    let mut holed = columns.spindle.clone();
    holed[7] = f64::NAN;
    let holed = StoredCycle { spindle_percent: &holed, ..stored(&columns) };
    assert_eq!(refused(holed, &known), ("spindle_percent[7]".into(), InvalidCode::NotFinite));
    let config = RelationConfig::new(RelationParams::load(PAPER_END_DEPTH_MM)).unwrap();
    let empty = LoadRelations::new(config);
    assert_eq!(refused(stored(&columns), &empty).1, InvalidCode::NotIdentifiable);
}

#[test]
fn the_course_is_what_the_figures_sum_up() {
    let s = PaperStrategies::new().unwrap();
    let (columns, _) = drill(&s.linear, 80);
    let (cycle, known) = (stored(&columns), relations(&s.linear));
    let answer = ask(&cycle, &known, &s.linear, &s.adaptive);
    let control = Control { program: s.adaptive.program.clone(), law: s.adaptive.law };
    let course = predicted_course(&cycle, &known, &paper_params().machine.axis, &control).unwrap();
    let highest = |of: fn(&PredictedSample) -> f64| course.iter().map(of).fold(0.0, f64::max);
    let seconds = course.iter().map(|_| cycle.period_s).sum::<f64>();
    assert!((seconds - answer.predicted.duration_s).abs() < 1e-9, "{seconds}");
    assert!((highest(|one| one.spindle_percent) - answer.predicted.peak_spindle_percent).abs() < 1e-12);
    assert!((highest(|one| one.feed_drive_percent) - answer.predicted.peak_feed_drive_percent).abs() < 1e-12);
    assert!(course.windows(2).all(|pair| pair[0].depth_mm <= pair[1].depth_mm));
}

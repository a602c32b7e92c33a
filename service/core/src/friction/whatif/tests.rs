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
    let control = |s: &Strategy| Control { law: s.law, ..Control::of(s.program.clone()) };
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

    let control = Control::of(s.linear.program.clone());
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
    let control = Control { law: s.adaptive.law, ..Control::of(s.adaptive.program.clone()) };
    let course = predicted_course(&cycle, &known, &paper_params().machine.axis, &control).unwrap();
    let highest = |of: fn(&PredictedSample) -> f64| course.iter().map(of).fold(0.0, f64::max);
    let seconds = course.iter().map(|_| cycle.period_s).sum::<f64>();
    assert!((seconds - answer.predicted.duration_s).abs() < 1e-9, "{seconds}");
    assert!((highest(|one| one.spindle_percent) - answer.predicted.peak_spindle_percent).abs() < 1e-12);
    assert!((highest(|one| one.feed_drive_percent) - answer.predicted.peak_feed_drive_percent).abs() < 1e-12);
    assert!(course.windows(2).all(|pair| pair[0].depth_mm <= pair[1].depth_mm));
}

#[test]
fn a_law_makes_no_feed_that_a_stream_would_not_permit() {
    let s = PaperStrategies::new().unwrap();
    let (columns, _) = drill(&s.linear, 80);
    let (cycle, known) = (stored(&columns), relations(&s.linear));
    let raised = Control { law: s.adaptive_raised.law, ..Control::of(FeedProgram::constant(200.0).unwrap()) };
    let fastest = |control: &Control| {
        let course = predicted_course(&cycle, &known, &paper_params().machine.axis, control).unwrap();
        course.iter().map(|one| one.feed_mm_min).fold(0.0, f64::max)
    };
    assert!(fastest(&raised) > 260.0);
    let limited = fastest(&Control { feeds_mm_min: (1.0, 240.0), ..raised.clone() });
    assert!((230.0..=240.000_001).contains(&limited), "{limited}");
    // What is programmed is the machine's, whatever the limit: a law does not slow it for that alone.
    assert!(fastest(&Control { law: None, feeds_mm_min: (1.0, 100.0), ..raised }) > 199.0);
}

/// A cycle at one feed (mm/min) in which both drives have one load over idle, percent.
fn even(feed_mm_min: f64, period_s: f64, count: u32, load: f64) -> Columns {
    let depth = (0..count).map(|k| feed_mm_min / 60.0 * period_s * f64::from(k)).collect();
    let loads = vec![5.0 + load; count as usize];
    Columns { depth, feed_drive: loads.clone(), spindle: loads }
}

fn stored_even(columns: &Columns, period_s: f64) -> StoredCycle<'_> {
    StoredCycle {
        period_s,
        feed_drive_idle_percent: 5.0,
        spindle_idle_percent: 5.0,
        spindle_rated_torque_nm: Some(10.0),
        ..stored(columns)
    }
}

fn even_control(feed_mm_min: f64) -> Control {
    Control::of(FeedProgram::constant(feed_mm_min).unwrap())
}

/// Relations of holes of 4 mm, one at each feed, mm/min, with that load over idle, percent.
fn relations_of(holes: &[(f64, f64)]) -> LoadRelations {
    let mut relations = LoadRelations::new(RelationConfig::new(RelationParams::load(10.0)).unwrap());
    for &(feed, load) in holes {
        let mut columns = even(feed, 0.01, 1000, load);
        let count = columns.depth.partition_point(|depth| *depth <= 4.0);
        for column in [&mut columns.depth, &mut columns.feed_drive, &mut columns.spindle] {
            column.truncate(count);
        }
        relations.observe(&stored_even(&columns, 0.01), FeedSource::Programmed).unwrap();
    }
    relations
}

const UNLIMITED: LoadLimits = LoadLimits { feed_drive_percent: None, spindle_percent: None };
const SLOW_AXIS: AxisLimits = AxisLimits { acceleration_mm_s2: 300.0, override_latency_ipo: 2 };

/// A few cycles that differ in more than their feed can show a load that falls with it; at the end of the way, where the axis
/// comes to stand, such a power of the feed has no bound.
#[test]
fn a_slope_that_falls_is_not_believed_and_every_load_is_a_number() {
    let relations = relations_of(&[(100.0, 40.0), (200.0, 20.0), (400.0, 10.0)].repeat(5));
    assert!(relations.spindle().slope(1).unwrap().value < -0.5);
    for count in 90..120 {
        let columns = even(200.0, 0.01, count, 20.0);
        let cycle = stored_even(&columns, 0.01);
        for feed in [25.0, 50.0, 100.0, 200.0, 600.0, 1000.0] {
            let course = predicted_course(&cycle, &relations, &SLOW_AXIS, &even_control(feed)).unwrap();
            for sample in course {
                assert!((5.0..=25.001).contains(&sample.spindle_percent), "{feed} mm/min: {sample:?}");
            }
        }
    }
    // Steeper than the square is not believed either: 8 times the load at twice the feed.
    let steep = relations_of(&[(100.0, 2.0), (200.0, 16.0), (400.0, 128.0)].repeat(5));
    assert!(steep.spindle().slope(1).unwrap().value > 2.2);
    let columns = even(100.0, 0.01, 201, 2.0);
    let (own, other) = (even_control(100.0), even_control(200.0));
    let answer = what_if(&stored_even(&columns, 0.01), &steep, &SLOW_AXIS, &UNLIMITED, &own, &other).unwrap();
    assert!((answer.predicted.peak_spindle_percent - (5.0 + 2.0 * 4.0)).abs() < 1e-6, "{answer:?}");
}

#[test]
fn figures_that_would_be_no_numbers_are_refused() {
    let relations = relations_of(&[(100.0, 20.0), (200.0, 25.0)]);
    let control = even_control(200.0);
    for load in [1e200, 1e308] {
        let columns = even(200.0, 0.01, 101, load);
        let cycle = stored_even(&columns, 0.01);
        let refused = what_if(&cycle, &relations, &SLOW_AXIS, &UNLIMITED, &control, &control).unwrap_err();
        assert_eq!((refused.field(), refused.code()), ("cycle", InvalidCode::NotFinite), "{load}");
    }
}

#[test]
fn what_happened_and_what_is_predicted_are_summed_over_the_same_samples() {
    let relations = relations_of(&[(120.0, 20.0), (120.0, 20.0)]);
    let columns = even(120.0, 0.1, 21, 20.0);
    let control = even_control(120.0);
    // An axis that does not brake: the prediction is the cycle, sample for sample.
    let axis = AxisLimits { acceleration_mm_s2: 1e5, override_latency_ipo: 0 };
    let limits = LoadLimits { feed_drive_percent: Some(10.0), spindle_percent: None };
    let answer =
        what_if(&stored_even(&columns, 0.1), &relations, &axis, &limits, &control, &control).unwrap();
    let close = |one: f64, other: f64| assert!((one - other).abs() < 1e-4 * other, "{answer:?}");
    close(answer.happened.duration_s, 2.0);
    close(answer.predicted.duration_s, 2.0);
    close(answer.happened.overload_s, answer.predicted.overload_s);
    close(answer.predicted.energy_j.unwrap(), answer.happened.energy_j.unwrap());
    assert!(
        answer.error.duration_relative.abs() < 1e-9 && answer.error.energy_relative.unwrap().abs() < 1e-4
    );
    // 20 % of 10 N·m at the speed for 2 s.
    close(
        answer.happened.energy_j.unwrap(),
        2.0 * PAPER_SPINDLE_RPM * 2.0 * std::f64::consts::PI / 60.0 * 2.0,
    );
}

#[test]
fn a_way_at_depths_that_no_cycle_has_seen_is_extrapolated() {
    let relations = relations_of(&[(120.0, 20.0), (120.0, 20.0)]);
    let control = even_control(120.0);
    // The relations know 4 mm: of 5 mm a fifth is not known, of 4 mm nothing is.
    for (count, share) in [(201, 0.0), (251, 0.2), (601, 8.0 / 12.0)] {
        let columns = even(120.0, 0.01, count, 20.0);
        let cycle = stored_even(&columns, 0.01);
        let answer = what_if(&cycle, &relations, &SLOW_AXIS, &UNLIMITED, &control, &control).unwrap();
        assert!((answer.extrapolated - share).abs() < 0.02, "{count}: {answer:?}");
    }
}

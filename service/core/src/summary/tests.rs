//! Energies against sums done by hand, maxima, gaps and flags.

use super::*;
use crate::cycle::CycleDraft;
use crate::ids::{CycleId, MachineId, OperationId, ToolId};
use crate::machine::{FeedDriveRating, FeedLimits, FittedLine, LoadReference, SpindleRating};
use proptest::prelude::{Strategy, prop_assert, prop_assert_eq, prop_oneof, proptest};

const N: usize = 400;

fn machine(reference: LoadReference) -> Machine {
    Machine {
        id: MachineId::try_from("M1").unwrap(),
        name: "M1".into(),
        control: "sinumerik-840d".into(),
        ipo_period_ms: 10.0,
        spindle: SpindleRating { reference, rated_power_watts: Some(7000.0), base_speed_rpm: Some(3000.0) },
        feed_drive: FeedDriveRating::default(),
        limits: FeedLimits::new(1.0, 10_000.0, 5.0, 200.0).unwrap(),
    }
}

fn cycle(time: TimeBase, columns: Vec<(Channel, Vec<f64>)>) -> Cycle {
    Cycle::new(CycleDraft {
        machine: MachineId::try_from("M1").unwrap(),
        id: CycleId::try_from("c1").unwrap(),
        tool: ToolId::try_from("T1").unwrap(),
        operation: OperationId::try_from("O1").unwrap(),
        started_at: Timestamp::from_micros(1_700_000_000_000_000),
        seq: None,
        process: None,
        strategy: None,
        law_version: None,
        profile: None,
        recommendation: None,
        reference: None,
        spindle_speed_rpm: Some(1500.0),
        outcome: Outcome::Completed,
        samples: Some(Samples::new(time, columns, 10_000).unwrap()),
        reported: crate::cycle::Reported::default(),
    })
    .unwrap()
}

fn every_10_ms(columns: Vec<(Channel, Vec<f64>)>) -> Cycle {
    cycle(TimeBase::Period { period_ms: 10.0 }, columns)
}

fn told(cycle: &Cycle, machine: &Machine, calibration: Option<&Calibration>) -> CycleSummary {
    summarise(cycle, Context { machine, calibration, operation: None })
}

fn close(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 1e-9 * expected.abs().max(1.0), "{found} is not {expected}");
}

#[test]
fn dynamometer_energy_is_the_papers_sum() {
    // 2 N·m at 1500 rpm for 4 s; 1000 N over the 20 mm between the first and the last sample.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let depth: Vec<f64> = (0..N).map(|k| 20.0 * k as f64 / (N - 1) as f64).collect();
    let cycle = every_10_ms(vec![
        (Channel::DepthMm, depth),
        (Channel::ThrustNewtons, vec![1000.0; N]),
        (Channel::TorqueNewtonMetres, vec![2.0; N]),
    ]);
    let summary = told(&cycle, &machine(LoadReference::Unknown), None);
    let energy = summary.best_energy().unwrap();
    assert_eq!((energy.basis, summary.energy.len()), (EnergyBasis::Dynamometer, 1));
    close(energy.spindle_joules.unwrap(), 2.0 * std::f64::consts::TAU * 25.0 * 4.0);
    close(energy.feed_drive_joules.unwrap(), 20.0);
    close(energy.total_joules, energy.spindle_joules.unwrap() + 20.0);
    close(summary.duration_ms.unwrap(), 4000.0);
}

#[test]
fn loads_alone_give_no_joules() {
    let cycle = every_10_ms(vec![
        (Channel::SpindleLoadPercent, vec![40.0; N]),
        (Channel::FeedDriveLoadPercent, vec![30.0; N]),
        (Channel::SpindleCurrentAmperes, vec![12.0; N]),
    ]);
    let summary = told(&cycle, &machine(LoadReference::Unknown), None);
    assert!(summary.energy.is_empty() && summary.flags.contains(Flag::NoEnergy));
    // Torque-like loads need the base speed too.
    let mut nearly = machine(LoadReference::RatedTorque);
    nearly.spindle.base_speed_rpm = None;
    assert!(told(&cycle, &nearly, None).energy.is_empty());
}

#[test]
fn rated_power_falls_with_speed_only_where_the_percent_follows_torque() {
    let cycle = every_10_ms(vec![(Channel::SpindleLoadPercent, vec![50.0; N])]);
    for (reference, joules) in [
        (LoadReference::RatedPower, 0.5 * 7000.0 * 4.0),
        (LoadReference::RatedTorque, 0.5 * 7000.0 * 4.0 * 0.5),
        (LoadReference::MaximumCurrent, 0.5 * 7000.0 * 4.0 * 0.5),
    ] {
        let summary = told(&cycle, &machine(reference), None);
        let energy = summary.best_energy().unwrap();
        assert_eq!(energy.basis, EnergyBasis::RatedPower);
        close(energy.total_joules, joules);
        assert_eq!(energy.feed_drive_joules, None, "no thrust is declared: counted as 0 and said so");
    }
}

#[test]
fn the_rated_feed_drive_is_a_force() {
    let mut rated = machine(LoadReference::RatedPower);
    rated.feed_drive =
        FeedDriveRating { reference: LoadReference::RatedTorque, rated_thrust_newtons: Some(5000.0) };
    let cycle = every_10_ms(vec![
        (Channel::SpindleLoadPercent, vec![50.0; N]),
        (Channel::FeedDriveLoadPercent, vec![20.0; N]),
        (Channel::FeedActualMmMin, vec![300.0; N]),
    ]);
    // 1000 N at 5 mm/s for 4 s.
    close(told(&cycle, &rated, None).best_energy().unwrap().feed_drive_joules.unwrap(), 20.0);
}

#[test]
fn measured_power_is_a_trapezoid_less_the_idle_power_before_contact() {
    let mut depth = vec![-1.0; 100];
    depth.extend(vec![5.0; 300]);
    let mut watts = vec![900.0; 20];
    watts.extend(vec![400.0; 80]);
    watts.extend(vec![1400.0; 300]);
    let power = (Channel::SpindlePowerWatts, watts);
    let summary = told(
        &every_10_ms(vec![(Channel::DepthMm, depth), power.clone()]),
        &machine(LoadReference::Unknown),
        None,
    );
    let energy = summary.best_energy().unwrap();
    assert_eq!(energy.idle, IdlePower::Subtracted { watts: 400.0 });
    // Above idle: 19 intervals and a half step of spinning up, then 299 and a half step of cutting.
    close(energy.total_joules, 500.0 * 0.195 + 1000.0 * 2.995);
    let without_depth = told(&every_10_ms(vec![power]), &machine(LoadReference::Unknown), None);
    assert_eq!(without_depth.best_energy().unwrap().idle, IdlePower::Included);
}

/// A recording from contact to full depth is compared as a whole; what surrounds it is not.
#[test]
fn the_contact_of_a_cycle_is_what_lies_between_the_surface_and_full_depth() {
    let contact = |depth: Vec<f64>, load: Vec<f64>| {
        let cycle = every_10_ms(vec![(Channel::DepthMm, depth), (Channel::SpindleLoadPercent, load)]);
        let summary = told(&cycle, &machine(LoadReference::RatedPower), None);
        let digest = summary.digest.unwrap();
        (digest.joules(), digest.duration_ms(), summary.energy[0].total_joules)
    };
    // 7000 W for 10 ms at 10 % are 7 J.
    let (joules, time, whole) = contact(vec![0.0, 0.1, 0.2], vec![10.0, 20.0, 30.0]);
    close(joules, 35.0);
    close(time, 20.0);
    close(whole, 42.0);
    // Begun in the work, the first sample is of the cut as well.
    let (joules, time, _) = contact(vec![0.1, 0.2, 0.3], vec![10.0, 20.0, 30.0]);
    close(joules, 42.0);
    close(time, 30.0);
    let (joules, time, whole) = contact(
        vec![-0.1, -0.1, 0.0, 0.1, 0.2, 0.2, 0.19, 0.0],
        vec![50.0, 5.0, 10.0, 20.0, 30.0, 9.0, 9.0, 9.0],
    );
    close(joules, 35.0);
    close(time, 20.0);
    close(whole, 99.4);
    // The surface is crossed in the middle of a step.
    let (joules, time, _) = contact(vec![-0.1, 0.1, 0.2], vec![50.0, 20.0, 30.0]);
    close(joules, 28.0);
    close(time, 15.0);
}

#[test]
fn fitted_lines_are_not_asked_beyond_their_range() {
    let line = |slope| {
        Some(FittedLine {
            slope,
            intercept: 0.0,
            min_percent: 0.0,
            max_percent: 50.0,
            r_squared: 0.99,
            residual_spread: 1.0,
        })
    };
    let calibration = Calibration { version: 1, thrust: line(50.0), torque: line(0.1) };
    let cycle = |load: f64| {
        every_10_ms(vec![
            (Channel::SpindleLoadPercent, vec![load; N]),
            (Channel::FeedDriveLoadPercent, vec![20.0; N]),
            (Channel::FeedActualMmMin, vec![300.0; N]),
        ])
    };
    let known = machine(LoadReference::RatedPower);
    let summary = told(&cycle(40.0), &known, Some(&calibration));
    let energy = summary.best_energy().unwrap();
    assert_eq!(energy.basis, EnergyBasis::Calibrated);
    close(energy.total_joules, 4.0 * std::f64::consts::TAU * 25.0 * 4.0 + 20.0);
    assert_eq!(summary.energy[1].basis, EnergyBasis::RatedPower);
    let beyond = told(&cycle(60.0), &known, Some(&calibration));
    assert!(beyond.flags.contains(Flag::BeyondCalibration));
    assert_eq!(beyond.best_energy().unwrap().basis, EnergyBasis::RatedPower);
}

#[test]
fn an_energy_that_no_machine_could_have_spent_is_not_told() {
    // The largest line that can be stored, at the fastest speed, for a day.
    let line = |slope| {
        Some(FittedLine {
            slope,
            intercept: 0.0,
            min_percent: -400.0,
            max_percent: 400.0,
            r_squared: 0.99,
            residual_spread: 1.0,
        })
    };
    let known = machine(LoadReference::RatedPower);
    let a_day = cycle(
        TimeBase::Stamps { time_ms: vec![0.0, 28_800_000.0, 57_600_000.0, 86_400_000.0] },
        vec![
            (Channel::SpindleLoadPercent, vec![399.0; 4]),
            (Channel::FeedDriveLoadPercent, vec![20.0; 4]),
            (Channel::SpindleSpeedRpm, vec![1e6; 4]),
            (Channel::DepthMm, vec![0.0, 1.0, 2.0, 3.0]),
        ],
    );
    let sane = told(&a_day, &known, Some(&Calibration { version: 1, thrust: line(50.0), torque: line(0.1) }));
    assert!(!sane.flags.contains(Flag::ImplausibleEnergy));
    assert_eq!(sane.best_energy().unwrap().basis, EnergyBasis::Calibrated);
    let calibration = Calibration { version: 1, thrust: line(50.0), torque: line(1e6) };
    let summary = told(&a_day, &known, Some(&calibration));
    assert!(summary.flags.contains(Flag::ImplausibleEnergy) && !summary.flags.contains(Flag::NoEnergy));
    let told: Vec<_> = summary.energy.iter().map(|energy| energy.basis).collect();
    assert_eq!(told, [EnergyBasis::RatedPower], "the next best stands in for it");
    assert_eq!(summary.energy, sane.energy[1..]);
    let parts =
        |energy: &Energy| [Some(energy.total_joules), energy.spindle_joules, energy.feed_drive_joules];
    assert!(summary.energy.iter().flat_map(parts).flatten().all(|joules| joules.abs() <= MOST_JOULES));
    let alone = super::summarise(
        &a_day,
        Context {
            machine: &machine(LoadReference::Unknown),
            calibration: Some(&calibration),
            operation: None,
        },
    );
    assert!(alone.energy.is_empty() && alone.flags.contains(Flag::NoEnergy) && alone.digest.is_none());
    assert!(alone.flags.contains(Flag::ImplausibleEnergy));
}

#[test]
fn gaps_carry_no_energy_and_lower_the_coverage() {
    let time = |gap: f64| (0..100).map(|k| 10.0 * k as f64 + if k >= 50 { gap } else { 0.0 }).collect();
    let of = |gap: f64| {
        let base = TimeBase::Stamps { time_ms: time(gap) };
        told(
            &cycle(base, vec![(Channel::SpindlePowerWatts, vec![1000.0; 100])]),
            &machine(LoadReference::Unknown),
            None,
        )
    };
    let whole = of(0.0);
    assert_eq!((whole.coverage, whole.flags.contains(Flag::Gaps)), (1.0, false));
    let torn = of(1000.0);
    assert!(torn.flags.contains(Flag::Gaps) && (torn.coverage - 0.5).abs() < 1e-9, "{}", torn.coverage);
    close(torn.best_energy().unwrap().total_joules, whole.best_energy().unwrap().total_joules);
    let at_once = cycle(
        TimeBase::Stamps { time_ms: vec![5.0; 3] },
        vec![(Channel::SpindlePowerWatts, vec![1000.0; 3])],
    );
    let summary = told(&at_once, &machine(LoadReference::Unknown), None);
    assert_eq!((summary.duration_ms, summary.best_energy()), (None, None), "nothing tells how long it took");
    assert!(summary.flags.contains(Flag::NoEnergy));
}

#[test]
fn maxima_come_with_their_place_and_the_edge_is_interpolated() {
    let depth = vec![-1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
    let load = vec![90.0, 10.0, 40.0, 60.0, 40.0, 20.0, 10.0];
    let summary = told(
        &every_10_ms(vec![(Channel::DepthMm, depth), (Channel::SpindleLoadPercent, load)]),
        &machine(LoadReference::Unknown),
        None,
    );
    let peak = summary.max_spindle_load_percent.unwrap();
    assert_eq!((peak.value, peak.depth_mm, peak.time_ms), (90.0, Some(-1.0), Some(10.0)));
    // The peak of spinning up at −1 mm is no stage: the edge is that of the 60 % at 2 mm, half of it at 3.5 mm.
    close(summary.spindle_load_fall_depth_mm.unwrap(), 3.5);
}

#[test]
fn what_is_unusual_is_flagged() {
    let cycle = every_10_ms(vec![
        (Channel::DepthMm, vec![0.0, 1.0, 0.5, 1.5]),
        (Channel::FeedActualMmMin, vec![100.0, 0.0, 100.0, 100.0]),
        (Channel::OverridePercent, vec![100.0, 0.0, 100.0, 100.0]),
        (Channel::SpindleLoadPercent, vec![-0.5, 10.0, 401.0, 10.0]),
        (Channel::SpindlePowerWatts, vec![-3.0, 1.0, 1.0, 1.0]),
    ]);
    let flags = told(&cycle, &machine(LoadReference::Unknown), None).flags;
    for flag in [
        Flag::FeedHold,
        Flag::OverrideZero,
        Flag::NegativeLoad,
        Flag::NegativePower,
        Flag::DepthReversal,
        Flag::LoadOver400,
        Flag::OperationUnregistered,
    ] {
        assert!(flags.contains(flag), "{flag:?} in {flags:?}");
    }
    let retract = every_10_ms(vec![(Channel::DepthMm, vec![0.0, 2.0, 4.0, 2.0, 0.0])]);
    assert!(!told(&retract, &machine(LoadReference::Unknown), None).flags.contains(Flag::DepthReversal));
}

#[test]
fn of_a_channel_that_is_not_sampled_the_control_s_word_counts() {
    let reported = crate::cycle::Reported {
        max_depth_mm: Some(1.0),
        max_spindle_load_percent: Some(99.0),
        max_feed_drive_load_percent: Some(450.0),
        mean_feed_drive_load_percent: Some(12.5),
        ..crate::cycle::Reported::default()
    };
    let sampled = every_10_ms(vec![(Channel::SpindleLoadPercent, vec![10.0, 20.0, 30.0])]);
    let cycle = Cycle::new(CycleDraft { reported, ..sampled.clone().into_draft() }).unwrap();
    let summary = told(&cycle, &machine(LoadReference::Unknown), None);
    assert_eq!(summary.max_depth_mm, Some(1.0));
    // What was sampled is believed.
    close(summary.max_spindle_load_percent.unwrap().value, 30.0);
    let peak = summary.max_feed_drive_load_percent.unwrap();
    assert_eq!((peak.value, peak.depth_mm, peak.time_ms), (450.0, None, None));
    assert_eq!(summary.mean_feed_drive_load_percent, Some(12.5));
    assert!(summary.flags.contains(Flag::LoadOver400));
    // Summaries of the rules before can be told where nothing of it was reported.
    assert!(is_summarised_alike(4, &sampled) && !is_summarised_alike(4, &cycle));
    assert!(is_summarised_alike(SUMMARY_VERSION, &cycle) && !is_summarised_alike(3, &sampled));
    let bored = |depth: Vec<f64>| every_10_ms(vec![(Channel::DepthMm, depth)]);
    for version in [4, 5] {
        assert!(is_summarised_alike(version, &bored(vec![-0.1, 0.0, 1.0])));
        assert!(is_summarised_alike(version, &bored(vec![0.5, 1.0])));
        assert!(!is_summarised_alike(version, &bored(vec![0.01, 1.0])), "its contact began a sample earlier");
    }
}

#[test]
fn the_speed_is_that_of_the_work_however_long_the_recording_stands_before_it() {
    let speed = |columns: Vec<(Channel, Vec<f64>)>| {
        let cycle = every_10_ms(columns);
        (told(&cycle, &machine(LoadReference::Unknown), None).median_spindle_speed_rpm, cycle)
    };
    let spun = |standing: usize, rest: &[f64]| {
        let mut speeds = vec![0.0; standing];
        speeds.extend(rest);
        speeds
    };
    // At rest and spinning up for longer than it cuts; an encoder at rest may say a little.
    let begun = spun(50, &[3.0, -2.0, 100.0, 2399.0, 2400.0, 2401.0]);
    let (found, cycle) = speed(vec![(Channel::SpindleSpeedRpm, begun.clone())]);
    assert_eq!(found, Some(2400.0));
    assert!(
        !is_summarised_alike(6, &cycle) && !is_summarised_alike(5, &cycle) && !is_summarised_alike(4, &cycle)
    );
    // What turned before the work is not asked where depth says when that was.
    let mut depth = vec![-1.0; begun.len()];
    depth.splice(begun.len() - 2.., [0.5, 1.0]);
    let (found, _) = speed(vec![(Channel::SpindleSpeedRpm, begun.clone()), (Channel::DepthMm, depth)]);
    assert_eq!(found, Some(2400.5));
    // Depth that never says work leaves what turns.
    let air = vec![-1.0; begun.len()];
    assert_eq!(speed(vec![(Channel::SpindleSpeedRpm, begun), (Channel::DepthMm, air)]).0, Some(2400.0));
    // One that turns the other way has a speed, and one that never turns has none.
    assert_eq!(speed(vec![(Channel::SpindleSpeedRpm, spun(9, &[-500.0, -510.0, -505.0]))]).0, Some(-505.0));
    let (found, standing) = speed(vec![(Channel::SpindleSpeedRpm, vec![0.0; 9])]);
    assert!(found.is_none() && !is_summarised_alike(6, &standing));
    let (found, steady) = speed(vec![(Channel::SpindleSpeedRpm, vec![2400.0, 2380.0, 2420.0])]);
    assert!(found == Some(2400.0) && is_summarised_alike(6, &steady) && is_summarised_alike(4, &steady));
}

#[test]
fn the_course_of_an_energy_ends_at_the_whole() {
    let n = 40;
    let wave =
        |from: f64, by: f64| (0..n).map(|k| from + by * (f64::from(k) * 0.7).sin()).collect::<Vec<f64>>();
    let depth: Vec<f64> = (0..n).map(|k| -1.0 + 0.2 * f64::from(k)).collect();
    let cycle = every_10_ms(vec![
        (Channel::DepthMm, depth),
        (Channel::SpindleSpeedRpm, wave(2500.0, 100.0)),
        (Channel::SpindleLoadPercent, wave(20.0, 9.0)),
        (Channel::FeedDriveLoadPercent, wave(15.0, 6.0)),
        (Channel::SpindlePowerWatts, wave(900.0, 300.0)),
        (Channel::TorqueNewtonMetres, wave(4.0, 2.0)),
        (Channel::ThrustNewtons, wave(700.0, 200.0)),
    ]);
    let machine = machine(LoadReference::RatedTorque);
    let context = Context { machine: &machine, calibration: None, operation: None };
    let samples = cycle.samples.as_ref().unwrap();
    let summary = summarise(&cycle, context);
    assert!(summary.energy.len() >= 3, "{:?}", summary.energy);
    for energy in &summary.energy {
        let course = energy_course(samples, cycle.spindle_speed_rpm, context, energy.basis).unwrap();
        assert_eq!(course.len(), samples.len());
        close(*course.last().unwrap(), energy.total_joules);
    }
    assert_eq!(energy_course(samples, None, context, EnergyBasis::Calibrated), None);
    assert_eq!(energy_course(samples, None, context, EnergyBasis::Reported), None);
}

#[test]
fn what_rounding_would_take_out_of_its_range_stays_in_it() {
    let of_override = |time_ms: Vec<f64>, percent: f64| {
        let column = vec![percent; time_ms.len()];
        let cycle = cycle(TimeBase::Stamps { time_ms }, vec![(Channel::OverridePercent, column)]);
        told(&cycle, &machine(LoadReference::Unknown), None).mean_override_percent
    };
    assert_eq!(of_override(vec![1e-6, 10.0], 1000.0), Some(1000.0));
    // Its sums make 200.00000000000003 of it.
    assert_eq!(of_override(vec![12.3, 20.3, 32.6, 40.37, 50.37], 200.0), Some(200.0));
    let fallen = every_10_ms(vec![
        (Channel::DepthMm, vec![0.0, -65_159.297_272_276_29, 100_000.0]),
        (Channel::SpindleLoadPercent, vec![10.0, 6.0, 5.0]),
    ]);
    let fallen = told(&fallen, &machine(LoadReference::Unknown), None).spindle_load_fall_depth_mm;
    assert_eq!(fallen, Some(100_000.0));
}

/// Loads as they are, as they may be at the most, and the same ones again and again.
fn loads() -> impl Strategy<Value = Vec<f64>> {
    let load =
        || prop_oneof![-20.0..150.0_f64, proptest::sample::select(vec![-1e4, 0.0, 1e-300, 0.1, 200.0, 1e4])];
    let same = (load(), 1..200_usize).prop_map(|(load, count)| vec![load; count]);
    prop_oneof![same, proptest::collection::vec(load(), 1..200)]
}

proptest! {
    /// What is stored was not held: it has to be the same within what the store verifies summaries to, 1e-9 of itself.
    #[test]
    fn a_mean_is_the_plain_one_held_within_its_column(
        loads in loads(),
        steps in proptest::collection::vec(prop_oneof![0.0..30.0_f64, proptest::sample::select(vec![0.0, 1e-6, 7.77, 12.3, 4e5])], 200),
        stamped in proptest::bool::ANY,
    ) {
        let mut now = 0.0;
        let time = match stamped {
            true => TimeBase::Stamps { time_ms: steps.iter().take(loads.len()).map(|step| { now += step; now }).collect() },
            false => TimeBase::Period { period_ms: 7.0 },
        };
        let cycle = cycle(time, vec![(Channel::SpindleLoadPercent, loads.clone())]);
        let clock = SampleClock::of(cycle.samples.as_ref().unwrap());
        // As it was summed up before it was held.
        let widths = match &clock.widths_ms {
            Widths::Even(_) => vec![1.0; loads.len()],
            Widths::Each(widths) => widths.clone(),
        };
        let total: f64 = widths.iter().sum();
        let plain = loads.iter().zip(&widths).map(|(load, width)| load * width).sum::<f64>() / total;
        let found = told(&cycle, &machine(LoadReference::Unknown), None).mean_spindle_load_percent;
        prop_assert_eq!(found.is_some(), total > 0.0);
        if let Some(found) = found {
            let least = loads.iter().copied().fold(f64::INFINITY, f64::min);
            let most = loads.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            prop_assert!((least..=most).contains(&found));
            prop_assert!((found - plain).abs() <= 1e-9 * found.abs().min(plain.abs()), "{found} is not {plain}");
            if (least..=most).contains(&plain) {
                prop_assert_eq!(found.to_bits(), (plain + 0.0).to_bits());
            }
        }
    }

    /// Energies are compared over years: how they are summed up must not move a digit of them.
    #[test]
    fn energies_are_those_of_plain_loops_to_the_last_bit(
        rows in proptest::collection::vec(proptest::array::uniform6(-50.0..50.0_f64), 1..80),
        stamped in proptest::bool::ANY,
        standing in proptest::bool::ANY,
    ) {
        let column = |which: usize| rows.iter().map(|row| row[which]).collect::<Vec<f64>>();
        let depth = if standing { vec![0.0; rows.len()] } else { column(0) };
        let [speed, load, push, torque, thrust] = [1, 2, 3, 4, 5].map(column);
        let mut time_ms = 0.0;
        let mut stamp = |row: &[f64; 6]| {
            time_ms += row[0].abs();
            time_ms
        };
        let time = if stamped {
            TimeBase::Stamps { time_ms: rows.iter().map(&mut stamp).collect() }
        } else {
            TimeBase::Period { period_ms: 7.0 }
        };
        let mut rated = machine(LoadReference::RatedTorque);
        rated.feed_drive =
            FeedDriveRating { reference: LoadReference::RatedTorque, rated_thrust_newtons: Some(5000.0) };
        let cycle = cycle(time, vec![
            (Channel::DepthMm, depth.clone()),
            (Channel::SpindleSpeedRpm, speed.clone()),
            (Channel::SpindleLoadPercent, load.clone()),
            (Channel::FeedDriveLoadPercent, push.clone()),
            (Channel::TorqueNewtonMetres, torque.clone()),
            (Channel::ThrustNewtons, thrust.clone()),
        ]);
        let clock = SampleClock::of(cycle.samples.as_ref().unwrap());
        let (mut measured, mut by_rating) = (0.0, 0.0);
        for k in 0..rows.len() {
            let rpm = speed[k].abs();
            measured += torque[k] * std::f64::consts::TAU * rpm / 60.0 * clock.width_s(k);
            by_rating += load[k] / 100.0 * 7000.0 * (rpm / 3000.0).min(1.0) * clock.width_s(k);
        }
        let work = |thrust: &dyn Fn(usize) -> f64| -> f64 {
            (1..rows.len()).map(|k| thrust(k) * (depth[k] - depth[k - 1]) * 1e-3).sum()
        };
        let expected = [
            (measured, work(&|k| thrust[k])),
            (by_rating, work(&|k| push[k] / 100.0 * 5000.0)),
        ];
        let summary = told(&cycle, &rated, None);
        let bits = |(spindle, feed_drive): (f64, f64)| (spindle.to_bits(), feed_drive.to_bits());
        let found: Vec<_> = summary
            .energy
            .iter()
            .map(|energy| bits((energy.spindle_joules.unwrap(), energy.feed_drive_joules.unwrap())))
            .collect();
        let is_timed = clock.duration_ms > 0.0;
        prop_assert_eq!(found, if is_timed { expected.map(bits).to_vec() } else { Vec::new() });
    }
}

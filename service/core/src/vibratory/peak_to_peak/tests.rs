use std::f64::consts::TAU;

use proptest::prelude::*;

use super::*;

fn controller(input: ControllerInput) -> Controller {
    Controller::new(ControllerSettings::new(input).unwrap())
}

fn sample(velocity_mm_s: f64, acceleration_mm_s2: f64) -> VibrationSample {
    VibrationSample { velocity_mm_s, acceleration_mm_s2 }
}

#[track_caller]
fn close(step: &ControlStep, want: &[f64]) {
    let got =
        [step.frequency_rad_s, step.raw_displacement_mm, step.displacement_mm, step.adapted_gain, step.gain];
    for (got, want) in got.iter().zip(want) {
        assert!((got - want).abs() <= 1e-9 * want.abs().max(1.0), "{got} is not {want}: {step:?}");
    }
}

#[test]
fn the_worked_sequence_is_met_to_a_billionth() {
    let input = ControllerInput {
        displacement_filter_hz: None,
        frequency_share: 1.0,
        ..ControllerInput::IVANOV_2024
    };
    let mut controller = controller(input);
    let steps: Vec<(f64, f64, ControlStep)> = (0..2000)
        .map(|j| {
            let t = f64::from(j) * 3e-4;
            let w = TAU * 80.0;
            let a = 0.12 * (t / 0.3_f64).min(1.0);
            let (v, acc) = (a / 2.0 * w * (w * t).cos(), -a / 2.0 * w * w * (w * t).sin());
            (v, acc, controller.step(sample(v, acc)).unwrap())
        })
        .collect();
    let text = include_str!("../../../tests-data/ptp_worked_sequence.csv");
    let rows = text.lines().filter(|line| line.starts_with(|c: char| c.is_ascii_digit()));
    let mut compared = 0;
    for row in rows {
        let mut fields = row.split(',');
        let j: usize = fields.next().unwrap().parse().unwrap();
        let want: Vec<f64> = fields.map(|field| field.parse().unwrap()).collect();
        let (v, acc, step) = &steps[j];
        assert!((v - want[0]).abs() < 1e-9 && (acc - want[1]).abs() < 1e-6);
        close(step, &want[2..]);
        compared += 1;
    }
    assert_eq!(compared, 158);
    // Sums over all 2000 samples, so that the rows left out of the listing are covered too.
    let sums = text.lines().find_map(|line| line.strip_prefix("# Sums over j = 0..1999: ")).unwrap();
    for (name, want) in sums.split(' ').map(|pair| pair.split_once('=').unwrap()) {
        let want: f64 = want.parse().unwrap();
        let got: f64 = steps
            .iter()
            .map(|(v, acc, step)| match name {
                "v" => *v,
                "a" => *acc,
                "omega_c" => step.frequency_rad_s,
                "A_raw" => step.raw_displacement_mm,
                "A" => step.displacement_mm,
                "bc" => step.adapted_gain,
                "b" => step.gain,
                other => panic!("unknown column {other}"),
            })
            .sum();
        assert!((got - want).abs() <= 1e-9 * want.abs().max(1000.0), "{name}: {got} is not {want}");
    }
}

#[test]
fn other_filters_agree_with_the_independent_script() {
    let mut running: Option<Controller> = None;
    let (mut cases, mut compared) = (0, 0);
    for line in include_str!("../../../tests-data/ptp_filtered.csv").lines().filter(|l| !l.starts_with('#')) {
        if let Some(case) = line.strip_prefix("case,") {
            let n: Vec<f64> = case.split(',').skip(1).map(|field| field.parse().unwrap()).collect();
            running = Some(controller(ControllerInput {
                eigenfrequency_hz: n[0],
                period_s: n[1],
                target_mm: n[2],
                deviation_gain: n[3],
                rate_gain: n[4],
                time_constant_s: n[5],
                low_share: n[6],
                high_share: n[7],
                displacement_filter_hz: Some(n[8]),
                frequency_share: n[9],
            }));
            cases += 1;
            continue;
        }
        let row: Vec<f64> = line.split(',').map(|field| field.parse().unwrap()).collect();
        let step = running.as_mut().unwrap().step(sample(row[0], row[1])).unwrap();
        if row.len() > 2 {
            close(&step, &row[2..]);
            compared += 1;
        }
    }
    assert_eq!((cases, compared), (5, 120));
}

#[test]
fn zeros_between_the_halves_do_not_hide_a_crossing() {
    let mut controller =
        controller(ControllerInput { frequency_share: 1.0, period_s: 1e-3, ..ControllerInput::IVANOV_2024 });
    let wave = [0.0, 5.0, 5.0, 0.0, 0.0, -5.0, -5.0, -5.0, 0.0, 0.0];
    let last =
        wave.iter().cycle().take(40).map(|v| controller.step(sample(*v, 0.0)).unwrap()).last().unwrap();
    assert!((last.frequency_rad_s - TAU / 0.01).abs() < 1e-9);
    // Touching zero from above is no crossing.
    let rising = controller.step(sample(5.0, 0.0)).unwrap();
    for v in [0.0, 5.0, -0.0, 5.0] {
        let step = controller.step(sample(v, 0.0)).unwrap();
        assert!((step.frequency_rad_s - rising.frequency_rad_s).abs() < f64::EPSILON);
    }
}

#[test]
fn garbage_leaves_the_estimates_alone() {
    let mut controller = controller(ControllerInput::IVANOV_2024);
    controller.step(sample(3.0, 100.0)).unwrap();
    let before = controller;
    for (v, acc) in [(f64::NAN, 0.0), (0.0, f64::INFINITY), (1e300, 0.0), (0.0, f64::NEG_INFINITY)] {
        assert_eq!(controller.step(sample(v, acc)), Err(BadSample));
        assert_eq!(controller, before);
    }
}

#[test]
fn bad_settings_are_refused_by_name() {
    let refused = |input| ControllerSettings::new(input).unwrap_err();
    let base = ControllerInput::IVANOV_2024;
    assert_eq!(refused(ControllerInput { target_mm: 0.0, ..base }).field(), "target_mm");
    assert_eq!(refused(ControllerInput { eigenfrequency_hz: f64::NAN, ..base }).code(), "not_finite");
    assert_eq!(refused(ControllerInput { period_s: 0.01, ..base }).field(), "period_s");
    assert_eq!(
        refused(ControllerInput { displacement_filter_hz: Some(-1.0), ..base }).field(),
        "displacement_filter_hz"
    );
}

proptest! {
    #[test]
    fn gains_stay_within_their_bounds(samples in prop::collection::vec((-1e6..1e6_f64, -1e9..1e9_f64), 1..300)) {
        let mut controller = controller(ControllerInput::IVANOV_2024);
        for (v, acc) in samples {
            let step = controller.step(sample(v, acc)).unwrap();
            prop_assert!(step.gain.abs() <= 1.0 && step.adapted_gain.abs() <= 1.0);
            prop_assert!(step.displacement_mm >= 0.0 && step.frequency_rad_s > 0.0);
        }
    }
}

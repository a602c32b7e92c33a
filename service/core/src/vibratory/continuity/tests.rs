use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use proptest::prelude::*;

use super::*;

fn process(p: f64, kc: f64, control: bool) -> Process {
    let control = control.then_some(ContinuityControl::GOUSKOV_2015);
    Process::new(ProcessInput::gouskov_2015(p, kc, control)).unwrap()
}

#[track_caller]
fn near(got: f64, want: f64, tolerance: f64) {
    assert!((got - want).abs() <= tolerance, "{got} is not {want} ± {tolerance}");
}

#[test]
fn the_papers_points_without_control() {
    for (p, kc, psi, amplitude, force) in
        [(1.5, 0.1, 0.702, 1.748, 0.2017), (1.5, 0.6, 0.416, 6.391, 1.387), (1.7, 0.1, 0.497, 4.373, 0.2816)]
    {
        let steady = simulate(&process(p, kc, false)).unwrap();
        near(steady.continuity, psi, 0.01);
        near(steady.amplitude, amplitude, 0.01 * amplitude);
        near(steady.peak_force, force, 0.01 * force);
        assert!(steady.segmented());
    }
    for (p, kc, force) in [(1.5, 0.02, 0.02), (1.2, 0.1, 0.10)] {
        let steady = simulate(&process(p, kc, false)).unwrap();
        near(steady.continuity, 1.0, 1e-12);
        near(steady.amplitude, 0.0, 1e-6);
        near(steady.peak_force, force, 0.01 * force);
        assert!(!steady.segmented());
    }
}

#[test]
fn the_papers_points_with_control() {
    for (p, kc, psi, psi_tolerance, amplitude, force, sd) in [
        (1.5, 0.1, 0.898, 0.015, 1.265, 0.181, 0.07),
        (1.5, 0.6, 0.464, 0.015, 4.81, 1.715, 0.04),
        (1.7, 0.1, 0.889, 0.02, 2.03, 0.191, 0.10),
    ] {
        let steady = simulate(&process(p, kc, true)).unwrap();
        near(steady.continuity, psi, psi_tolerance);
        near(steady.amplitude, amplitude, 0.03 * amplitude);
        near(steady.peak_force, force, 0.02 * force);
        near(steady.window_sd, sd, 0.005);
        assert!(!steady.bursting());
    }
    for (p, kc, sd) in [(1.5, 0.02, 0.18), (1.2, 0.1, 0.21)] {
        let steady = simulate(&process(p, kc, true)).unwrap();
        assert!(steady.largest_amplitude > 5.0, "{steady:?}");
        near(steady.window_sd, sd, 0.01);
        assert!(steady.bursting());
    }
}

#[test]
fn the_border_of_stability_has_the_known_values() {
    for (p, kc) in [(1.2, 0.3947), (1.5, 0.0661), (1.7, 0.0275)] {
        near(border_at(p, 0.01, 0.75).unwrap().cutting_coefficient, kc, 5e-5);
    }
    let minimum = border_minimum(0.01, 0.75).unwrap();
    near(minimum, 0.0269, 5e-5);
    let lowest = (0..2000)
        .map(|i| border_at(1.0 + f64::from(i) / 1000.0, 0.01, 0.75).unwrap().cutting_coefficient)
        .fold(f64::INFINITY, f64::min);
    near(lowest, minimum, 1e-5);
    // The border satisfies both of its equations.
    let at = border_at(1.5, 0.01, 0.75).unwrap();
    let (kr, g) = (0.75 * at.cutting_coefficient, at.chatter_ratio);
    let w = std::f64::consts::TAU * 1.5 * g;
    near(1.0 - g * g + kr * (1.0 - w.cos()), 0.0, 1e-9);
    near(2.0 * 0.01 * g + kr * w.sin(), 0.0, 1e-9);
}

/// kc of one lobe by the two equations as they are printed, bisected in W₀.
fn kc_of_lobe(p: f64, damping: f64, exponent: f64, lobe: u32) -> f64 {
    use std::f64::consts::{PI, TAU};
    let ratio_at = |w: f64| {
        let c = 1.0 / (w / 2.0).tan();
        (damping + damping.hypot(c)) / c.abs()
    };
    let (mut low, mut high) = (PI, TAU);
    for _ in 0..200 {
        let w = low.midpoint(high);
        let below = (w + TAU * f64::from(lobe)) / (TAU * ratio_at(w)) < p;
        (low, high) = if below { (w, high) } else { (low, w) };
    }
    let w = low.midpoint(high);
    // Of 2ζG + kr·sin W = 0, which loses no digits where G is near 1.
    -2.0 * damping * ratio_at(w) / w.sin() / exponent
}

fn lowest_of_many_lobes(p: f64, damping: f64, exponent: f64) -> f64 {
    (0..400)
        .filter(|lobe| f64::from(*lobe) + 1.0 > p)
        .fold(f64::INFINITY, |lowest, lobe| lowest.min(kc_of_lobe(p, damping, exponent, lobe)))
}

#[test]
fn the_border_is_looked_for_on_the_lobe_that_holds_it() {
    for (p, damping, exponent, kc) in [
        (95.99, 0.1, 0.75, 0.2936),
        (95.99, 0.2, 0.75, 0.640),
        (95.99, 0.5, 0.75, 2.000),
        (95.99, 0.05, 0.75, 0.1400),
        (4.81, 0.838, 0.776, 3.970),
        (29.99, 0.328, 0.306, 2.845),
    ] {
        let at = border_at(p, damping, exponent).unwrap();
        near(at.cutting_coefficient, kc, 1e-3 * kc);
        near(at.cutting_coefficient, lowest_of_many_lobes(p, damping, exponent), 1e-6 * kc);
    }
    // At the corners of what is accepted, and where p is a whole number.
    for p in [0.01, 0.5, 1.0, 2.0, 99.0, 100.0] {
        for damping in [1e-6, 1e-3, 1.0] {
            let at = border_at(p, damping, 2.0).unwrap();
            let lowest = lowest_of_many_lobes(p, damping, 2.0);
            assert!((at.cutting_coefficient / lowest - 1.0).abs() < 1e-6, "{p} {damping}: {at:?}, {lowest}");
            assert!(at.cutting_coefficient >= border_minimum(damping, 2.0).unwrap() * (1.0 - 1e-12));
        }
    }
}

#[test]
fn segmentation_sets_in_at_the_border_given_time_to_grow() {
    for p in [1.4, 1.5, 1.7] {
        let border = border_at(p, 0.01, 0.75).unwrap().cutting_coefficient;
        let segmented = |factor: f64| {
            let input =
                ProcessInput { periods: 4000, ..ProcessInput::gouskov_2015(p, border * factor, None) };
            simulate(&Process::new(input).unwrap()).unwrap().segmented()
        };
        assert!(!segmented(0.985), "{p}: segments below the border");
        assert!(segmented(1.015), "{p}: does not segment above the border");
    }
}

#[test]
fn many_at_once_give_the_same_bits_as_one_by_one() {
    let processes: Vec<Process> = [1.2, 1.35, 1.5, 1.61, 1.7, 1.9].map(|p| process(p, 0.1, true)).to_vec();
    let together = simulate_many(&processes);
    for (process, steady) in processes.iter().zip(together) {
        assert_eq!(simulate(process), steady);
    }
}

#[test]
fn a_trace_shows_the_run_that_the_steady_values_sum_up() {
    let (steady, points) = trace(&process(1.5, 0.1, true), 10).unwrap();
    assert_eq!(points.len(), 5000);
    assert_eq!(steady, simulate(&process(1.5, 0.1, true)));
    let steady = steady.unwrap();
    let late = points.iter().filter(|point| point.time > 400.0);
    let (low, high) = late.clone().fold((9.0_f64, -9.0_f64), |(low, high), point| {
        (low.min(point.displacement), high.max(point.displacement))
    });
    near(high - low, steady.amplitude, 0.02);
    let peak = late.map(|point| point.force).fold(0.0, f64::max);
    near(peak, steady.peak_force, 0.01);
    assert!(points.iter().all(|point| point.actuator.abs() <= 0.1));
    assert_eq!(trace(&process(1.5, 0.1, true), 0).unwrap_err().code(), "out_of_range");
}

#[test]
fn an_odd_number_of_periods_is_summed_up_to_its_end() {
    for (periods, steady_periods) in [(301, 51), (301, 50), (300, 51), (300, 50)] {
        let input = ProcessInput {
            damping: 0.02,
            exponent: 1.3,
            periods,
            steady_periods,
            ..ProcessInput::gouskov_2015(2.6, 0.1, None)
        };
        let (steady, points) = trace(&Process::new(input).unwrap(), 1).unwrap();
        let (steady, late) = (steady.unwrap(), &points[points.len() - steady_periods as usize * 100..]);
        let in_cut = late.iter().filter(|point| point.force > 0.0).count();
        near(steady.continuity, in_cut as f64 / late.len() as f64, 1e-12);
        let displacement = late.iter().map(|point| point.displacement);
        let (low, high) = (displacement.clone().fold(9.0, f64::min), displacement.fold(-9.0, f64::max));
        near(steady.amplitude, high - low, 1e-12);
        near(steady.peak_force, late.iter().map(|point| point.force).fold(0.0, f64::max), 1e-12);
        if (periods, steady_periods) == (301, 51) {
            let evens = late[..5000].iter().filter(|point| point.force > 0.0).count() as f64 / 5000.0;
            near(steady.continuity, 0.5165, 5e-5);
            near(evens, 0.5160, 5e-5);
        }
        // What was removed is the mean of the chip, by the cutting law backwards.
        let removed =
            late.iter().map(|point| (point.force / 0.1).powf(1.0 / 1.3)).sum::<f64>() / late.len() as f64;
        near(steady.removed, removed, 1e-9);
        assert!(steady.cuts && steady.segmented());
    }
}

#[test]
fn a_run_that_grows_without_end_has_no_steady_values() {
    let input = ProcessInput { damping: 0.0, exponent: 2.0, ..ProcessInput::gouskov_2015(1.5, 100.0, None) };
    let endless = Process::new(input).unwrap();
    assert_eq!(simulate(&endless), Err(Diverged));
    let (steady, points) = trace(&endless, 10).unwrap();
    assert_eq!(steady, Err(Diverged));
    assert!(!points.is_empty() && points.len() < 5000, "its course is told up to there: {}", points.len());
    assert!(points.iter().all(|point| point.displacement.abs() <= 1e6 && point.force.is_finite()));
    // It takes nothing from those beside it.
    let quiet = Process::new(ProcessInput { cutting_coefficient: 0.01, ..input }).unwrap();
    let together = simulate_many(&[quiet, endless, quiet, quiet]);
    assert_eq!(together, [simulate(&quiet), Err(Diverged), simulate(&quiet), simulate(&quiet)]);
    let map = MapInput {
        frequency_ratio: MapAxis { min: 1.4, max: 1.5, count: 2 },
        cutting_coefficient: MapAxis { min: 0.01, max: 100.0, count: 2 },
        process: input,
    };
    let never = AtomicBool::new(false);
    let map = run_map(&MapQuestion::new(map).unwrap(), NonZeroUsize::MIN, &|_, _| {}, &never).unwrap();
    assert!(map.points[..2].iter().all(Result::is_ok));
    assert_eq!(map.points[2..], [Err(Diverged); 2]);
}

#[test]
fn a_drill_that_was_thrown_out_of_the_work_does_not_cut() {
    // Hundreds of feeds deep in its first periods, in the air above that for all the rest.
    let steady = simulate(&process(1.5, 10.0, true)).unwrap();
    assert!(steady.continuity == 0.0 && steady.amplitude < 1e-9 && steady.largest_amplitude > 1e3);
    near(steady.removed, 0.0, 1e-9);
    assert!(!steady.cuts && !steady.segmented());
    // Each of the paper's points removes what it advances by.
    for (p, kc, control) in [(1.5, 0.1, false), (1.5, 0.02, true), (1.2, 0.1, true), (1.7, 0.1, false)] {
        let steady = simulate(&process(p, kc, control)).unwrap();
        assert!(steady.cuts, "{steady:?}");
        near(steady.removed, 1.0, steady.amplitude / 100.0 + 1e-6);
    }
}

#[test]
fn every_point_of_the_papers_map_without_control_removes_what_it_advances_by() {
    let question = |steady_periods| {
        MapQuestion::new(MapInput {
            frequency_ratio: MapAxis { min: 1.0, max: 2.0, count: 11 },
            cutting_coefficient: MapAxis { min: 0.02, max: 0.6, count: 11 },
            process: ProcessInput { steady_periods, ..ProcessInput::gouskov_2015(1.0, 0.1, None) },
        })
        .unwrap()
    };
    for steady in question(100).some(0..121) {
        assert!(steady.unwrap().cuts, "{steady:?}");
    }
    // Of two periods, fewer than the vibration takes to come around, those that the drill spends in the air altogether.
    for steady in question(2).some(0..121) {
        let steady = steady.unwrap();
        assert!(steady.cuts || steady.removed <= 0.01, "{steady:?}");
    }
}

fn small_map() -> MapQuestion {
    MapQuestion::new(MapInput {
        frequency_ratio: MapAxis { min: 1.3, max: 1.9, count: 5 },
        cutting_coefficient: MapAxis { min: 0.02, max: 0.3, count: 3 },
        process: ProcessInput { periods: 200, ..ProcessInput::gouskov_2015(1.0, 0.1, None) },
    })
    .unwrap()
}

#[test]
fn a_map_does_not_depend_on_the_number_of_workers_and_reports_progress() {
    let question = small_map();
    let most = AtomicUsize::new(0);
    let progress = |done: usize, total: usize| {
        assert!(done <= total && total == 15);
        most.fetch_max(done, Ordering::Relaxed);
    };
    let never = AtomicBool::new(false);
    let one = run_map(&question, NonZeroUsize::MIN, &progress, &never).unwrap();
    let three = run_map(&question, NonZeroUsize::new(3).unwrap(), &progress, &never).unwrap();
    assert_eq!(one, three);
    assert_eq!(most.into_inner(), 15);
    let corner = Process::new(ProcessInput {
        periods: 200,
        ..ProcessInput::gouskov_2015(one.ratios[4], one.coefficients[2], None)
    });
    assert_eq!(one.at(2, 4), Some(&simulate(&corner.unwrap())));
    assert_eq!(one.at(0, 5), None);
}

#[test]
fn a_cancelled_map_stops() {
    let cancel = AtomicBool::new(false);
    let progress = |_, _| cancel.store(true, Ordering::Relaxed);
    assert_eq!(run_map(&small_map(), NonZeroUsize::MIN, &progress, &cancel), Err(Cancelled));
}

#[test]
fn the_least_segmenting_amplitude_is_half_a_wave_out_of_step() {
    near(segmentation_amplitude(0.02, 1.5).unwrap().unwrap(), 0.02, 1e-12);
    near(segmentation_amplitude(0.02, 1.25).unwrap().unwrap(), 0.02 * 2.0_f64.sqrt(), 1e-12);
    assert_eq!(segmentation_amplitude(0.02, 2.0).unwrap(), None);
}

#[test]
fn bad_processes_are_refused_by_name() {
    let base = ProcessInput::gouskov_2015(1.5, 0.1, None);
    let refused = |input| {
        let error = Process::new(input).unwrap_err();
        (error.field(), error.code())
    };
    assert_eq!(
        refused(ProcessInput { cutting_coefficient: f64::NAN, ..base }),
        ("cutting_coefficient", "not_finite")
    );
    assert_eq!(refused(ProcessInput { frequency_ratio: -1.0, ..base }), ("frequency_ratio", "out_of_range"));
    assert_eq!(refused(ProcessInput { frequency_ratio: 50.0, ..base }), ("steps_per_period", "inconsistent"));
    let endless = ProcessInput { periods: 1_000_000, steps_per_period: 10_000, ..base };
    assert_eq!(refused(endless), ("periods", "too_many"));
    let wide = MapAxis { min: 1.0, max: 2.0, count: 100_000 };
    let map = MapInput { frequency_ratio: wide, cutting_coefficient: wide, process: base };
    assert_eq!(MapQuestion::new(map).unwrap_err().code(), "too_many");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn no_lobe_lies_below_the_border(p in 0.01..100.0_f64, ln in -13.8..0.0_f64, exponent in 0.1..2.0_f64) {
        let damping = ln.exp();
        let at = border_at(p, damping, exponent).unwrap();
        let lowest = lowest_of_many_lobes(p, damping, exponent);
        prop_assert!((at.cutting_coefficient / lowest - 1.0).abs() < 1e-6, "{at:?}, {lowest}");
        // It lies on its lobe, and the lobe is the one that it names.
        let waves = p * at.chatter_ratio;
        let beyond = waves - f64::from(at.lobe);
        prop_assert!((0.5 - 1e-9..=1.0 + 1e-9).contains(&beyond), "{at:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_process_is_finite_or_says_that_it_is_not(
        p in 0.3..7.9_f64, ln_kc in -5.0..4.6_f64, damping in 0.0..0.2_f64, r in 0.1..2.0_f64,
        control in any::<bool>(), periods in 40..80_u32
    ) {
        let control = control.then_some(ContinuityControl::GOUSKOV_2015);
        let input = ProcessInput {
            damping, exponent: r, periods, steady_periods: 20,
            ..ProcessInput::gouskov_2015(p, ln_kc.exp(), control)
        };
        let Ok(steady) = simulate(&Process::new(input).unwrap()) else { return Ok(()) };
        prop_assert!((0.0..=1.0).contains(&steady.continuity));
        prop_assert!((0.0..=2e6).contains(&steady.amplitude) && steady.amplitude <= steady.largest_amplitude);
        prop_assert!(steady.peak_force.is_finite() && steady.removed.is_finite() && steady.gain.is_finite());
        prop_assert!(steady.window_sd.is_finite() && steady.removed > -1e-6);
        prop_assert!(steady.continuity > 0.0 || !(steady.cuts || steady.segmented()));
    }
}

use super::*;
use crate::feed::study::{Case, Model, Plant, draw, recorded, settings};
use crate::friction::error::InvalidCode;
use crate::friction::noise::Noise;
use crate::friction::program::Knot;
use proptest::prelude::*;

fn case(seed: u64) -> Case {
    draw(Model::Twin, seed).unwrap()
}

/// Cycles of the case's first profile at several scales.
fn cycles(case: &Case, scales: &[f64]) -> Vec<RecordedCycle> {
    let mut noise = Noise::seeded(case.seed);
    (0..)
        .zip(scales)
        .map(|(order, scale)| {
            let knots: Vec<Knot> = case
                .first
                .iter()
                .map(|knot| Knot { feed_mm_min: knot.feed_mm_min * scale, ..*knot })
                .collect();
            recorded(&case.plant.drill(&knots, Some(&mut noise)).unwrap(), order)
        })
        .collect()
}

fn first(case: &Case) -> Knots {
    Knots::new(case.first.clone()).unwrap()
}

#[test]
fn the_order_of_arrival_does_not_show_in_a_single_bit() {
    let case = case(4);
    let settings = settings(&case.limits).unwrap();
    let mut cycles = cycles(&case, &[1.0, 0.9, 1.1, 1.0]);
    let last = first(&case);
    let one = optimise(&cycles, &settings, Some(&last)).unwrap();
    for _ in 0..3 {
        cycles.rotate_left(1);
        assert_eq!(optimise(&cycles, &settings, Some(&last)).unwrap(), one);
    }
    cycles.reverse();
    assert_eq!(optimise(&cycles, &settings, Some(&last)).unwrap(), one);
}

#[test]
fn a_repeated_cycle_counts_once() {
    let case = case(4);
    let settings = settings(&case.limits).unwrap();
    let mut cycles = cycles(&case, &[1.0, 0.9]);
    let one = optimise(&cycles, &settings, Some(&first(&case))).unwrap();
    cycles.push(cycles[0].clone());
    let two = optimise(&cycles, &settings, Some(&first(&case))).unwrap();
    assert_eq!((two.learned_from, &two.knots), (2, &one.knots));
    assert_eq!(two.skipped[0].reason, SkipReason::Duplicate);
    assert!(two.warnings.contains(&Warning::CyclesSkipped));
}

#[test]
fn cycles_that_say_nothing_are_named_with_their_reason_and_none_at_all_is_refused() {
    let case = case(4);
    let settings = settings(&case.limits).unwrap();
    let good = cycles(&case, &[1.0]).remove(0);
    let changed = |id: &str, change: &dyn Fn(&mut RecordedCycle)| {
        let mut cycle = RecordedCycle { id: id.to_owned(), ..good.clone() };
        change(&mut cycle);
        cycle
    };
    let bad = vec![
        changed("other", &|cycle| cycle.operation = "another".to_owned()),
        changed("short column", &|cycle| cycle.depth_mm.truncate(3)),
        changed("nan", &|cycle| cycle.spindle_percent.fill(f64::NAN)),
        changed("per second", &|cycle| {
            cycle.feed_mm_min.iter_mut().flatten().for_each(|feed| *feed /= 60.0);
        }),
        changed("air", &|cycle| {
            cycle.feed_drive_percent.fill(4.0);
            cycle.spindle_percent.fill(5.0);
        }),
        changed("standing", &|cycle| cycle.depth_mm.fill(2.0)),
        changed("many", &|cycle| {
            for column in [
                &mut cycle.time_s,
                &mut cycle.depth_mm,
                &mut cycle.feed_drive_percent,
                &mut cycle.spindle_percent,
            ] {
                column.resize(MOST_SAMPLES + 1, 0.0);
            }
            cycle.feed_mm_min = None;
        }),
    ];
    let refused = optimise(&bad, &settings, Some(&first(&case))).unwrap_err();
    assert_eq!((refused.field(), refused.code()), ("cycles", InvalidCode::NotIdentifiable));
    assert_eq!(optimise(&[], &settings, None).unwrap_err().field(), "cycles");
    let alone = optimise(std::slice::from_ref(&good), &settings, Some(&first(&case))).unwrap();
    let mut all = bad;
    all.push(good);
    let among = optimise(&all, &settings, Some(&first(&case))).unwrap();
    assert_eq!(among.knots, alone.knots);
    let reasons: Vec<(&str, SkipReason)> =
        among.skipped.iter().map(|skipped| (skipped.id.as_str(), skipped.reason)).collect();
    let expected = [
        ("air", SkipReason::NoLoad),
        ("many", SkipReason::TooManySamples),
        ("nan", SkipReason::TooShort),
        ("other", SkipReason::OtherOperation),
        ("per second", SkipReason::FeedContradictsDepth),
        ("short column", SkipReason::LengthMismatch),
        ("standing", SkipReason::TooShort),
    ];
    assert_eq!(reasons, expected);
}

#[test]
fn beyond_the_depth_of_an_aborted_cycle_the_feed_is_not_raised() {
    let case = case(4);
    let settings = settings(&case.limits).unwrap();
    let mut cycle = cycles(&case, &[1.0]).remove(0);
    let half = settings.depth_mm / 2.0;
    let keep = cycle.depth_mm.iter().position(|depth| *depth > half).unwrap();
    for column in
        [&mut cycle.time_s, &mut cycle.depth_mm, &mut cycle.feed_drive_percent, &mut cycle.spindle_percent]
    {
        column.truncate(keep);
    }
    cycle.feed_mm_min.iter_mut().for_each(|feed| feed.truncate(keep));
    cycle.completed = false;
    let last = first(&case);
    let proposal = optimise(&[cycle], &settings, Some(&last)).unwrap();
    assert!(proposal.warnings.contains(&Warning::DepthUnknown));
    let mut depth = half + 0.3;
    while depth < settings.depth_mm {
        assert!(proposal.knots.feed_at(depth) <= last.feed_at(depth) * (1.0 + 1e-9), "at {depth} mm");
        depth += 0.05;
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn a_proposal_keeps_every_limit(seed in 0_u64..4000, other in any::<bool>(), knots in 6_usize..24, raise in 1.0..3.0_f64) {
        let case = draw(if other { Model::Other } else { Model::Twin }, seed).unwrap();
        let base = settings(&case.limits).unwrap();
        let params = SettingsParams { most_knots: knots, raise_ratio: raise, ..SettingsParams::clone(&base) };
        let settings = Settings::new(params).unwrap();
        let last = first(&case);
        let proposal = optimise(&cycles(&case, &[1.0]), &settings, Some(&last)).unwrap();
        if proposal.advice == Advice::Keep {
            prop_assert_eq!(&proposal.knots, &last);
        } else {
            prop_assert!(settings.check(&proposal.knots).is_ok(), "{:?}", settings.check(&proposal.knots));
            let slices = proposal.knots.as_slice();
            prop_assert!(slices.len() <= knots);
            prop_assert!(slices[0].depth_mm.abs() < 1e-12 && (slices[slices.len() - 1].depth_mm - settings.depth_mm).abs() < 1e-12);
            let mut depth = 0.0;
            while depth <= settings.depth_mm {
                let feed = proposal.knots.feed_at(depth);
                let floor = settings.feed_min_mm_min;
                let step = (last.feed_at(depth) * raise).max(floor);
                prop_assert!(feed <= step * (1.0 + 1e-6), "{feed} at {depth} mm, the step allows {step}");
                prop_assert!(feed <= case.limits.cap(depth).max(floor) * (1.0 + 1e-6), "{feed} at {depth} mm");
                depth += 0.013;
            }
        }
    }
}

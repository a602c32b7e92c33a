use super::*;
use crate::cycle::Extent;
use crate::feed::study::{AnyPlant, Case, Model, Plant, draw, recorded, settings};
use crate::friction::error::InvalidCode;
use crate::friction::noise::Noise;
use crate::friction::program::Knot;
use proptest::prelude::*;

fn case(seed: u64) -> Case {
    draw(Model::Twin, seed).unwrap()
}

/// Cycles of the case's first profile at several scales.
fn cycles(case: &Case, scales: &[f64]) -> Vec<RecordedCycle> {
    cycles_with(case, scales, Some(&mut Noise::seeded(case.seed)))
}

fn cycles_with(case: &Case, scales: &[f64], mut noise: Option<&mut Noise>) -> Vec<RecordedCycle> {
    (0..)
        .zip(scales)
        .map(|(order, scale)| {
            let knots: Vec<Knot> = case
                .first
                .iter()
                .map(|knot| Knot { feed_mm_min: knot.feed_mm_min * scale, ..*knot })
                .collect();
            recorded(&case.plant.drill(&knots, noise.as_deref_mut()).unwrap(), order)
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

/// The same cycle with what may follow the way in: dwelling for so long (s) with an encoder's noise (mm), and the way out to a
/// depth (mm) at a feed (mm/min) that loads the feed drive (percent).
fn followed_by(
    cycle: &RecordedCycle,
    (dwell_s, noise_mm): (f64, f64),
    out: Option<(f64, f64, f64)>,
) -> RecordedCycle {
    let mut cycle = cycle.clone();
    let (mut time, end) = (*cycle.time_s.last().unwrap(), *cycle.depth_mm.last().unwrap());
    let mut push = |depth: f64, feed: f64, load: f64| {
        time += 0.01;
        cycle.time_s.push(time);
        cycle.depth_mm.push(depth);
        cycle.feed_mm_min.iter_mut().for_each(|column| column.push(feed));
        cycle.feed_drive_percent.push(load);
        cycle.spindle_percent.push(6.0);
    };
    let mut noise = Noise::seeded(3);
    let mut dwell = dwell_s;
    while dwell > 0.005 {
        push(end - noise_mm * noise.uniform(), 0.0, 4.0);
        dwell -= 0.01;
    }
    if let Some((feed, load, to_mm)) = out {
        let mut depth = end;
        while depth > to_mm {
            depth -= feed / 60.0 * 0.01;
            push(depth, -feed, load);
        }
    }
    cycle
}

#[test]
fn what_was_recorded_after_the_way_in_changes_no_advice() {
    let case = case(4);
    let settings = settings(&case.limits).unwrap();
    let last = first(&case);
    for with_feed in [true, false] {
        let mut bare = cycles(&case, &[1.0, 0.9, 1.1]);
        if !with_feed {
            bare.iter_mut().for_each(|cycle| cycle.feed_mm_min = None);
        }
        let one = optimise(&bare, &settings, Some(&last)).unwrap();
        assert_eq!((one.learned_from, one.skipped.len()), (3, 0));
        let did = Actual::of(&bare[0], &settings, one.idle_percent[1]).unwrap();
        for (dwell, out) in [
            ((0.5, 0.0), None),
            ((0.5, 0.015), None),
            ((0.0, 0.0), Some((3000.0, 20.0, -1.0))),
            ((0.5, 0.015), Some((3000.0, 20.0, -1.0))),
            ((0.0, 0.0), Some((10_000.0, 300.0, -1.0))),
            ((0.0, 0.0), Some((500.0, 15.0, settings.depth_mm / 2.0))),
            ((2.0, 0.0), Some((5000.0, 300.0, settings.depth_mm / 2.0))),
        ] {
            let more: Vec<RecordedCycle> = bare.iter().map(|cycle| followed_by(cycle, dwell, out)).collect();
            assert_eq!(optimise(&more, &settings, Some(&last)).unwrap(), one, "{dwell:?} {out:?}");
            assert_eq!(Actual::of(&more[0], &settings, one.idle_percent[1]), Ok(did), "{dwell:?} {out:?}");
        }
    }
}

#[test]
fn recordings_that_are_too_coarse_or_of_no_wear_say_so() {
    let case = case(4);
    let settings = settings(&case.limits).unwrap();
    let good = cycles(&case, &[1.0]).remove(0);
    let every = |step: usize| {
        let thin = |column: &Vec<f64>| column.iter().copied().step_by(step).collect();
        RecordedCycle {
            time_s: thin(&good.time_s),
            depth_mm: thin(&good.depth_mm),
            feed_mm_min: good.feed_mm_min.as_ref().map(thin),
            feed_drive_percent: thin(&good.feed_drive_percent),
            spindle_percent: thin(&good.spindle_percent),
            ..good.clone()
        }
    };
    let reason = |cycle: RecordedCycle| {
        let text = optimise(&[cycle], &settings, Some(&first(&case))).unwrap_err();
        text.message().rsplit(' ').next().unwrap().to_owned()
    };
    for seconds in [0.3, 1.0] {
        let step = good.time_s.partition_point(|time| *time < good.time_s[0] + seconds);
        assert_eq!(reason(every(step)), "sampled_too_rarely", "{seconds} s");
    }
    for wear in [f64::NAN, f64::INFINITY, -1.0, 0.0, 0.4, 3.1, 1e300] {
        assert_eq!(reason(RecordedCycle { wear_ratio: Some(wear), ..good.clone() }), "wear_out_of_range");
    }
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
    let last = first(&case);
    for (extent, reason) in [(Extent::Aborted, SkipReason::Aborted), (Extent::CutShort, SkipReason::CutShort)]
    {
        cycle.extent = extent;
        // Its time and its work are those of half a hole.
        assert_eq!(Actual::of(&cycle, &settings, 5.0), Err(reason));
    }
    let proposal = optimise(&[cycle], &settings, Some(&last)).unwrap();
    assert_eq!((proposal.learned_from, proposal.skipped.len()), (1, 0), "the way it made is learned from");
    assert!(proposal.warnings.contains(&Warning::DepthUnknown));
    let mut depth = half + 0.3;
    while depth < settings.depth_mm {
        assert!(proposal.knots.feed_at(depth) <= last.feed_at(depth) * (1.0 + 1e-9), "at {depth} mm");
        depth += 0.05;
    }
}

/// Settings of a case, changed.
fn changed(case: &Case, change: impl Fn(&mut SettingsParams)) -> Settings {
    let mut params = SettingsParams::clone(&settings(&case.limits).unwrap());
    change(&mut params);
    Settings::new(params).unwrap()
}

fn feed_of(knots: &Knots, factor: f64) -> Vec<Knot> {
    knots.as_slice().iter().map(|knot| Knot { feed_mm_min: knot.feed_mm_min * factor, ..*knot }).collect()
}

#[test]
fn energy_and_cost_give_up_time_for_work_and_never_the_other_way_round() {
    let mut differed = 0;
    for seed in [4, 7] {
        let mut case = draw(Model::Other, seed).unwrap();
        let AnyPlant::Other(model) = &mut case.plant else { unreachable!("a case of the second model") };
        // A torque that grows faster than the feed: a slower hole is less work.
        model.spindle.iter_mut().for_each(|bump| bump.exponent = 1.5);
        let case = case;
        let cycles = cycles(&case, &[1.0, 0.85, 1.15]);
        let asked = |objective| {
            let settings = changed(&case, |params| params.objective = objective);
            optimise(&cycles, &settings, Some(&first(&case))).unwrap()
        };
        let time = asked(Objective::Time);
        let energy = asked(Objective::Energy);
        let price = 0.5 * time.prediction.time_s.expected / time.prediction.spindle_percent_s.expected;
        let cost = asked(Objective::Cost { per_second: 1.0, per_percent_second: price });
        let seconds = |one: &Proposal| one.prediction.time_s.expected;
        let work = |one: &Proposal| one.prediction.spindle_percent_s.expected;
        let spent = |one: &Proposal| seconds(one) + price * work(one);
        let over_idle = asked(Objective::Cost { per_second: 0.0, per_percent_second: 1.0 });
        let whole = |one: &Proposal| work(one) + one.idle_percent[1] * seconds(one);
        for other in [&time, &over_idle, &cost] {
            assert!(
                whole(&energy) <= whole(other) * 1.003,
                "case {seed}: {} {}",
                whole(&energy),
                whole(other)
            );
        }
        // What the spindle idles with is saved by a faster hole.
        assert!(seconds(&energy) < seconds(&over_idle), "case {seed}");
        assert!(seconds(&energy) >= seconds(&time) * 0.997, "case {seed}");
        for other in [&time, &over_idle, &energy] {
            assert!(spent(&cost) <= spent(other) * 1.003, "case {seed}: {} {}", spent(&cost), spent(other));
        }
        // Here a slower hole is always less work over idle, and that is found far from the shortest time.
        assert!(
            work(&over_idle) < 0.9 * work(&time) && seconds(&over_idle) > 2.0 * seconds(&time),
            "case {seed}"
        );
        let held = energy.sections.iter().flat_map(|section| &section.bindings);
        differed += usize::from(held.into_iter().any(|(binding, _)| *binding == Binding::Objective));
        // Joules are told where the machine says what a percent stands for.
        assert_eq!(time.prediction.energy_j, None);
        let rated = changed(&case, |params| params.watts_per_percent = Some(70.0));
        let joules = optimise(&cycles, &rated, Some(&first(&case))).unwrap().prediction.energy_j.unwrap();
        assert!((joules.expected - 70.0 * work(&time)).abs() < 1e-6 * joules.expected);
    }
    assert!(differed > 0, "energy has a minimum over the feed somewhere");
}

#[test]
fn an_override_above_100_percent_is_what_the_loads_are_kept_at() {
    let case = case(6);
    let at = |percent: f64| {
        let settings = changed(&case, |params| params.override_percent = percent);
        let mut cycles = cycles(&case, &[1.0]);
        let mut last = first(&case);
        let mut noise = Noise::seeded(3);
        for order in 1..4 {
            let proposal = optimise(&cycles, &settings, Some(&last)).unwrap();
            let acting = feed_of(&proposal.knots, percent / 100.0);
            cycles.push(recorded(&case.plant.drill(&acting, Some(&mut noise)).unwrap(), order));
            last = proposal.knots;
        }
        last
    };
    let usual = at(100.0);
    let raised = at(150.0);
    let ratio = |knots: &[Knot]| case.plant.drill(knots, None).unwrap().worst_ratio(case.limits.set_percent);
    assert!(ratio(&feed_of(&raised, 1.5)) < 1.05, "{}", ratio(&feed_of(&raised, 1.5)));
    assert!(ratio(&feed_of(&usual, 1.5)) > 1.05, "what was made for 100 % does not stand 150 %");
    let end = case.limits.end_mm;
    let time = |knots: &Knots| {
        (0..1000).map(|at| end / 1000.0 / knots.feed_at(end * f64::from(at) / 1000.0)).sum::<f64>()
    };
    assert!(time(&raised) > time(&usual) * 1.2, "its programmed feed is lower");
    // An override below 100 % is no reason to go faster: it may be put back.
    let ran = cycles(&case, &[1.0]);
    let asked = |percent: f64| {
        let settings = changed(&case, |params| params.override_percent = percent);
        optimise(&ran, &settings, Some(&first(&case))).unwrap().knots
    };
    assert_eq!(asked(50.0), asked(100.0));
}

#[test]
fn heating_may_end_where_its_load_has_fallen_and_never_runs_faster_before() {
    let case = case(6);
    let until_mm = case.limits.end_mm * 0.4;
    let heated = |may_shorten| {
        let feed_mm_min = 60.0;
        changed(&case, |params| params.heating = Some(Heating { feed_mm_min, until_mm, may_shorten }))
    };
    let cycles = cycles(&case, &[1.0, 0.9, 1.1]);
    let asked = |may| optimise(&cycles, &heated(may), Some(&first(&case))).unwrap();
    let (whole, shorter) = (asked(false), asked(true));
    assert!(shorter.prediction.time_s.expected <= whole.prediction.time_s.expected);
    let mut depth = 0.0;
    while depth < until_mm {
        assert!(whole.knots.feed_at(depth) <= 60.0 + 1e-9, "at {depth} mm");
        depth += 0.05;
    }
    assert!(whole.sections.iter().any(|one| one.bindings.iter().any(|(what, _)| *what == Binding::Heating)));
    let timed = Heating::for_time(60.0, 2.0);
    assert!((timed.until_mm - 2.0).abs() < 1e-12, "60 mm/min for 2 s");
}

#[test]
fn a_hold_in_a_cycle_teaches_nothing_wrong() {
    let case = case(4);
    let settings = settings(&case.limits).unwrap();
    let cycles = cycles(&case, &[1.0, 0.9]);
    let plain = optimise(&cycles, &settings, Some(&first(&case))).unwrap();
    let held: Vec<RecordedCycle> = cycles
        .iter()
        .map(|cycle| {
            let mut cycle = cycle.clone();
            let at = cycle.depth_mm.iter().position(|depth| *depth > settings.depth_mm / 2.0).unwrap();
            let (time, depth) = (cycle.time_s[at], cycle.depth_mm[at]);
            // A feed hold of 0.8 s: the tool stands, the loads fall to idle, and it goes on.
            let hold: Vec<f64> = (1..=80).map(|k| time + 0.01 * f64::from(k)).collect();
            cycle.time_s[at + 1..].iter_mut().for_each(|time| *time += 0.8);
            let fill = |column: &mut Vec<f64>, value: f64| {
                column.splice(at + 1..at + 1, std::iter::repeat_n(value, 80));
            };
            cycle.time_s.splice(at + 1..at + 1, hold);
            fill(&mut cycle.depth_mm, depth);
            fill(&mut cycle.feed_drive_percent, 4.0);
            fill(&mut cycle.spindle_percent, 5.0);
            cycle.feed_mm_min.iter_mut().for_each(|feed| fill(feed, 0.0));
            cycle
        })
        .collect();
    let found = optimise(&held, &settings, Some(&first(&case))).unwrap();
    assert_eq!((found.learned_from, found.skipped.len()), (2, 0));
    let change = found.prediction.time_s.expected / plain.prediction.time_s.expected - 1.0;
    assert!(change.abs() < 0.05, "{change}");
}

#[test]
fn loads_that_were_recorded_filtered_are_read_where_they_arose() {
    let case = case(4);
    let settings = settings(&case.limits).unwrap();
    let weights = crate::friction::filter::FilterWeights::default();
    let late = |raw: &[RecordedCycle]| -> Vec<RecordedCycle> {
        let filtered = |column: &[f64]| {
            let mut filter = crate::friction::filter::LoadFilter::new();
            column.iter().map(|load| filter.step(&weights, *load)).collect::<Vec<_>>()
        };
        raw.iter()
            .map(|cycle| RecordedCycle {
                signal: LoadSignal::Filtered(weights),
                feed_drive_percent: filtered(&cycle.feed_drive_percent),
                spindle_percent: filtered(&cycle.spindle_percent),
                ..cycle.clone()
            })
            .collect()
    };
    let of = |cycles: &[RecordedCycle]| {
        optimise(cycles, &settings, Some(&first(&case))).unwrap().prediction.time_s.expected
    };
    // Without noise only where the loads are read differs.
    let quiet = cycles_with(&case, &[1.0, 0.9], None);
    let change = of(&late(&quiet)) / of(&quiet) - 1.0;
    assert!(change.abs() < 0.04, "{change}");
    // Filtered loads are less uneven, so the plan may be a little bolder.
    let raw = cycles(&case, &[1.0, 0.9]);
    let late = late(&raw);
    let change = of(&late) / of(&raw) - 1.0;
    assert!((-0.07..0.02).contains(&change), "{change}");
    // What ran is measured the same, filtered here or by the control.
    let [one, other] = [&raw[0], &late[0]].map(|cycle| Actual::of(cycle, &settings, 5.0).unwrap());
    assert!((one.peak_spindle_percent - other.peak_spindle_percent).abs() < 1.0, "{one:?} {other:?}");
}

#[test]
fn cycles_that_contradict_each_other_are_left_out_or_make_it_careful() {
    let case = case(4);
    let settings = settings(&case.limits).unwrap();
    let times = |cycle: &RecordedCycle, factor: f64| {
        let mut cycle = RecordedCycle { id: format!("{} times {factor}", cycle.id), ..cycle.clone() };
        for load in cycle.feed_drive_percent.iter_mut().chain(&mut cycle.spindle_percent) {
            *load = 5.0 + (*load - 5.0) * factor;
        }
        cycle
    };
    let agreeing = cycles(&case, &[1.0, 1.0, 1.0, 1.0]);
    let plain = optimise(&agreeing, &settings, Some(&first(&case))).unwrap();
    // One of another process: another sheet, a broken tool.
    let mut strange = agreeing.clone();
    strange[1] = times(&agreeing[1], 1.8);
    let found = optimise(&strange, &settings, Some(&first(&case))).unwrap();
    assert_eq!((found.learned_from, found.skipped[0].reason), (3, SkipReason::Outlier));
    // Half and half: nobody knows which is true, so it is said and the margins are wide.
    let mut split = agreeing.clone();
    for at in [1, 3] {
        split[at] = times(&agreeing[at], 1.3);
    }
    let found = optimise(&split, &settings, Some(&first(&case))).unwrap();
    assert!(found.warnings.contains(&Warning::CyclesDisagree), "{:?}", found.warnings);
    assert!(found.prediction.time_s.expected > plain.prediction.time_s.expected * 1.03);
}

#[test]
fn a_band_for_worn_tools_is_slower_and_bands_that_gain_nothing_are_joined() {
    let case = case(9);
    let settings = settings(&case.limits).unwrap();
    let mut noise = Noise::seeded(1);
    let cycles: Vec<RecordedCycle> = (0..6)
        .map(|order| {
            let wear = 0.3 * order as f64;
            let run = case.plant.worn(wear).drill(&case.first, Some(&mut noise)).unwrap();
            // The energy of the paper's worn tool is 9 % above the new one's.
            RecordedCycle { wear_ratio: Some(1.0 + 0.09 * wear), ..recorded(&run, order) }
        })
        .collect();
    let edges = [1.0, 1.04, 1.08, 1.12];
    let bands = wear_bands(&cycles, &settings, Some(&first(&case)), &edges).unwrap();
    assert!((bands[0].from - 1.0).abs() < 1e-12 && (bands[bands.len() - 1].to - 1.12).abs() < 1e-12);
    for pair in bands.windows(2) {
        assert!((pair[0].to - pair[1].from).abs() < 1e-12, "no gap and no overlap");
        let [new, worn] = [&pair[0], &pair[1]].map(|band| band.proposal.prediction.time_s.expected);
        assert!(new < worn * 0.99 + 1e-9, "{new} {worn}");
    }
    for band in &bands {
        let holds = band.proposal.holds_up_to_wear.unwrap();
        assert!(holds >= band.to - 1e-9, "planned at its end: {holds} {}", band.to);
        assert!(!band.proposal.warnings.contains(&Warning::WearAssumed), "six wears were seen");
    }
    let refused = |edges: &[f64]| {
        let error = wear_bands(&cycles, &settings, None, edges).unwrap_err();
        (error.field().to_owned(), error.code())
    };
    assert_eq!(refused(&[1.0]), ("edges".to_owned(), InvalidCode::OutOfRange));
    assert_eq!(refused(&[1.0, 1.05, 1.05]), ("edges[2]".to_owned(), InvalidCode::NotIncreasing));
    let unknown: Vec<RecordedCycle> =
        cycles.iter().map(|cycle| RecordedCycle { wear_ratio: None, ..cycle.clone() }).collect();
    assert!(wear_bands(&unknown, &settings, None, &edges).is_err(), "no cycle tells its wear");
}

#[test]
fn cycles_of_unknown_wear_are_a_new_tools_for_a_plan_at_a_worn_one() {
    let case = case(6);
    let cycles = cycles(&case, &[1.0, 0.9, 1.1]);
    let planned = |wear_ratio| {
        let settings = changed(&case, |params| params.wear_ratio = wear_ratio);
        optimise(&cycles, &settings, Some(&first(&case))).unwrap()
    };
    let (new, worn) = (planned(Some(1.0)), planned(Some(1.06)));
    assert!(worn.warnings.contains(&Warning::WearAssumed));
    let (fast, slow) = (new.prediction.time_s.expected, worn.prediction.time_s.expected);
    assert!(slow > fast * 1.02, "a worn tool loads more: {slow} {fast}");
    assert!(worn.holds_up_to_wear.unwrap() >= 1.06);
    assert_eq!(planned(None).knots, new.knots, "nothing is made of a wear that nobody named");
}

/// Columns of a recording's loads, feed drive first.
fn loads(cycle: &mut RecordedCycle) -> [&mut Vec<f64>; 2] {
    [&mut cycle.feed_drive_percent, &mut cycle.spindle_percent]
}

/// The recording with one drive's reading replaced from a depth on, given the last live one.
fn dying(cycle: &RecordedCycle, drive: usize, from_mm: f64, reads: impl Fn(f64) -> f64) -> RecordedCycle {
    let mut cycle = cycle.clone();
    let at = cycle.depth_mm.iter().position(|depth| *depth >= from_mm).unwrap();
    let column = &mut loads(&mut cycle)[drive];
    let value = reads(column[at.saturating_sub(1)]);
    column[at..].fill(value);
    cycle
}

/// The recording of a drive that reads 0 while it idles.
fn from_zero(cycle: &RecordedCycle, drive: usize) -> RecordedCycle {
    let mut cycle = cycle.clone();
    let air = cycle.depth_mm.iter().position(|depth| *depth >= 0.0).unwrap();
    let column = &mut loads(&mut cycle)[drive];
    let idle = column[..air].iter().copied().fold(f64::INFINITY, f64::min);
    column.iter_mut().for_each(|load| *load = (*load - idle).max(0.0));
    cycle
}

#[test]
fn a_dead_reading_is_no_air_cut_and_its_recording_is_left_out() {
    for seed in [4, 9] {
        let case = case(seed);
        let settings = settings(&case.limits).unwrap();
        let last = first(&case);
        let good = cycles(&case, &[1.0]).remove(0);
        let alone = optimise(std::slice::from_ref(&good), &settings, Some(&last)).unwrap();
        let zero_in_all = |drive: usize| dying(&good, drive, f64::NEG_INFINITY, |_| 0.0);
        let early = settings.depth_mm / 4.0;
        let feed_drive = SkipReason::DeadFeedDriveLoad;
        let spindle = SkipReason::DeadSpindleLoad;
        let both_held = dying(&dying(&good, 0, early, |held| held), 1, early, |held| held);
        let dead = [
            ("spindle at 0 from 4 mm", dying(&good, 1, 4.0, |_| 0.0), spindle),
            ("feed drive at 0 from 4 mm", dying(&good, 0, 4.0, |_| 0.0), feed_drive),
            ("spindle at 0 in contact", dying(&good, 1, 0.0, |_| 0.0), spindle),
            ("spindle at idle in contact", dying(&good, 1, 0.0, |held| held), spindle),
            ("spindle frozen in contact", dying(&good, 1, 0.0, |_| 23.4), spindle),
            ("spindle frozen in all", dying(&good, 1, f64::NEG_INFINITY, |_| 23.4), spindle),
            ("feed drive frozen in contact", dying(&good, 0, 0.0, |_| 12.5), feed_drive),
            ("spindle at 0 in all", zero_in_all(1), spindle),
            ("feed drive at 0 in all", zero_in_all(0), feed_drive),
            ("both hold their last value", both_held, feed_drive),
        ];
        for (what, cycle, reason) in dead {
            let cycle = RecordedCycle { id: "dead".to_owned(), order: 7, ..cycle };
            let refused = optimise(std::slice::from_ref(&cycle), &settings, Some(&last)).unwrap_err();
            assert_eq!(refused.code(), InvalidCode::NotIdentifiable, "case {seed}, {what}");
            assert!(refused.to_string().contains(reason.as_str()), "case {seed}, {what}: {refused}");
            // Beside a good one it changes nothing and is named.
            let found = optimise(&[good.clone(), cycle], &settings, Some(&last)).unwrap();
            assert_eq!(found.knots, alone.knots, "case {seed}, {what}");
            assert_eq!(found.skipped, [Skipped { id: "dead".to_owned(), reason }], "case {seed}, {what}");
        }
    }
}

#[test]
fn where_a_drive_may_be_dead_the_feed_is_not_raised() {
    for (seed, drive) in [(4, 0), (4, 1), (9, 1)] {
        let case = case(seed);
        let settings = settings(&case.limits).unwrap();
        let last = first(&case);
        let good = from_zero(&cycles(&case, &[1.0]).remove(0), drive);
        let intact = optimise(std::slice::from_ref(&good), &settings, Some(&last)).unwrap();
        // It idles at 0, so a 0 tells nothing by itself; and it may hold what it read last.
        for share in [0.25, 0.5] {
            let from_mm = share * settings.depth_mm;
            for (what, cycle) in [
                ("at 0", dying(&good, drive, from_mm, |_| 0.0)),
                ("held", dying(&good, drive, from_mm, |held| held)),
            ] {
                let Ok(found) = optimise(std::slice::from_ref(&cycle), &settings, Some(&last)) else {
                    continue;
                };
                let (air, other) =
                    (cycle.depth_mm.iter().position(|depth| *depth >= 0.0).unwrap(), 1 - drive);
                let mut cycle = cycle;
                let column = &*loads(&mut cycle)[other];
                let idle = column[..air].iter().copied().fold(f64::INFINITY, f64::min);
                let peak = column[air..].iter().copied().fold(0.0, f64::max) - idle;
                for (depth, load) in cycle.depth_mm.clone().iter().zip(loads(&mut cycle)[other].iter()) {
                    if *depth > from_mm + 1.0 && *load - idle > 0.3 * peak {
                        let most = last.feed_at(*depth).max(intact.knots.feed_at(*depth));
                        let feed = found.knots.feed_at(*depth);
                        assert!(
                            feed <= most * 1.02,
                            "case {seed}, {drive} {what} {share}: {feed} at {depth}, {most}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn a_short_dropout_tells_nothing_of_its_depths_and_the_rest_is_learned_from() {
    let case = case(4);
    let settings = settings(&case.limits).unwrap();
    let last = first(&case);
    let good = cycles(&case, &[1.0]).remove(0);
    let intact = optimise(std::slice::from_ref(&good), &settings, Some(&last)).unwrap();
    let mut cycle = good;
    let from_mm = 0.5 * settings.depth_mm;
    let within = from_mm..from_mm + 0.08 * settings.depth_mm;
    for at in 0..cycle.depth_mm.len() {
        if within.contains(&cycle.depth_mm[at]) {
            cycle.spindle_percent[at] = 0.0;
        }
    }
    let found = optimise(&[cycle], &settings, Some(&last)).unwrap();
    assert_eq!((found.learned_from, found.skipped.len()), (1, 0));
    for share in 0..=20 {
        let depth = within.start + (within.end - within.start) * f64::from(share) / 20.0;
        let most = last.feed_at(depth).max(intact.knots.feed_at(depth));
        assert!(found.knots.feed_at(depth) <= most * 1.05, "{} {most}", found.knots.feed_at(depth));
    }
}

#[test]
fn coarse_steps_and_tiny_loads_are_no_dead_readings() {
    for model in [Model::Twin, Model::Other, Model::Coarse] {
        for seed in [4, 7, 11, 68, 93, 144] {
            let case = draw(model, seed).unwrap();
            let grid = super::grid::Grid::new(case.limits.end_mm, &[]);
            let reads = |cycle: &RecordedCycle, what: &str, tenths: usize| {
                let read = super::course::Course::read(cycle, &grid, None, 6.0, 0.0);
                let read = read.unwrap_or_else(|reason| panic!("{model:?} {seed}, {what}: {reason:?}"));
                let (told, ran) = (read.readings.iter().flatten().count(), read.ran.iter().flatten().count());
                assert!(10 * told >= tenths * ran, "{model:?} {seed}, {what}: {told} of {ran}");
            };
            for good in cycles(&case, &[1.0, 2.0]) {
                for step in [0.1, 0.5, 1.0] {
                    let mut coarse = good.clone();
                    for load in loads(&mut coarse).into_iter().flatten() {
                        *load = (*load / step).round() * step;
                    }
                    reads(&coarse, &format!("in steps of {step} %"), 7);
                }
                // A feed drive of twenty times the rating, in steps of 0.1 %: its load hardly leaves idle, so less is told.
                let mut tiny = good.clone();
                for load in &mut tiny.feed_drive_percent {
                    *load = (*load / 20.0 / 0.1).round() * 0.1;
                }
                reads(&tiny, "twenty times the rating", 4);
            }
        }
    }
}

#[test]
fn without_any_recording_the_refusal_names_what_has_to_be_sampled() {
    let settings = settings(&case(4).limits).unwrap();
    let refused = optimise(&[], &settings, None).unwrap_err();
    for channel in ["depth_mm", "feed_drive_load_percent", "spindle_load_percent"] {
        assert!(refused.to_string().contains(channel), "{refused}");
    }
}

#[test]
fn one_feed_only_is_what_equal_limits_leave() {
    let case = case(4);
    let settings = changed(&case, |params| {
        params.feed_min_mm_min = 40.0;
        params.feed_max_mm_min = 40.0;
        params.heating = None;
        params.bushing = None;
    });
    let proposal = optimise(&cycles(&case, &[1.0]), &settings, Some(&first(&case))).unwrap();
    assert!(proposal.knots.as_slice().iter().all(|knot| (knot.feed_mm_min - 40.0).abs() < 1e-9));
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

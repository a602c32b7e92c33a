use super::coarse::CoarseModel;
use super::*;

/// Loads that the relaxed search keeps, like the reference.
fn most(limits: &Limits) -> [f64; 2] {
    limits.set_percent.map(|set| set * REFERENCE_MARGIN)
}

/// The least time that any feed needs, by dynamic programming over depth and time in contact: every feed out of a fine
/// list at every node, the fastest ones included, without acceleration and without the filter's lag. What can be reached
/// is kept per 2 ms of time; nothing that keeps the loads is faster.
fn least_time_s(model: &CoarseModel, limits: &Limits) -> f64 {
    const NODES: u32 = 240;
    const BIN_S: f64 = 0.002;
    let most = most(limits);
    let step = limits.end_mm / f64::from(NODES);
    let keeps = |depth: f64, feed: f64, time: f64| {
        let load = model.load(depth, feed / model.reference_feed_mm_min, time);
        (0..2).all(|drive| load[drive] + model.idle_percent[drive] <= most[drive])
    };
    // The earliest time in each bin that was reached.
    let mut reached = std::collections::BTreeMap::from([(0_usize, 0.0_f64)]);
    for node in 0..NODES {
        let depth = step * (f64::from(node) + 0.5);
        let (low, high) = (limits.feed_mm_min.0, limits.cap(depth));
        let mut next: std::collections::BTreeMap<usize, f64> = std::collections::BTreeMap::new();
        for &time in reached.values() {
            let (mut below, mut above) = (low, high);
            if keeps(depth, high, time) {
                below = high;
            } else {
                for _ in 0..30 {
                    let middle = f64::midpoint(below, above);
                    if keeps(depth, middle, time) { below = middle } else { above = middle }
                }
            }
            for share in [1.0, 0.97, 0.92, 0.85, 0.7, 0.5] {
                let later = time + step / (below * share).max(low) * 60.0;
                let bin = steps(later / BIN_S);
                let slot = next.entry(bin).or_insert(later);
                *slot = slot.min(later);
            }
        }
        // What is more than a second behind the first one does not catch up.
        let first = next.values().copied().fold(f64::INFINITY, f64::min);
        next.retain(|_, time| *time < first + 1.0);
        reached = next;
    }
    reached.values().copied().fold(f64::INFINITY, f64::min)
}

#[test]
fn the_planner_with_full_knowledge_is_near_the_true_optimum() {
    for seed in [3, 5, 8] {
        let mut case = draw(Model::Coarse, seed).unwrap();
        // The bound knows no acceleration: let the axis have plenty of it.
        case.limits.acceleration_mm_s2 = 20_000.0;
        let AnyPlant::Coarse(model) = &mut case.plant else { unreachable!("a coarse case") };
        model.acceleration_mm_s2 = 20_000.0;
        model.period_s = 0.004;
        let bound = least_time_s(model, &case.limits);
        let found = reference(&case.plant, &case.limits, REFERENCE_MARGIN, 800, seed).unwrap();
        let over = found.duration_s / bound - 1.0;
        println!("case {seed}: {:.3} s, at least {bound:.3} s, {:+.2} %", found.duration_s, 100.0 * over);
        assert!((-0.005..0.03).contains(&over), "case {seed}: {over}");
    }
}

#[test]
fn the_same_seed_gives_the_same_case_and_another_one_another() {
    for model in [Model::Twin, Model::Other, Model::Coarse] {
        let drilled = |seed: u64| {
            let case = draw(model, seed).unwrap();
            case.plant.drill(&case.first, Some(&mut crate::friction::noise::Noise::seeded(1))).unwrap()
        };
        assert_eq!(drilled(1), drilled(1));
        assert_ne!(drilled(1), drilled(2));
    }
}

/// Cases of the study with the time of the planner with full knowledge, s, as `feed_study` finds it.
const SAMPLE: [(Model, u64, f64); 9] = [
    (Model::Twin, 1000, 2.070),
    (Model::Twin, 1001, 3.472),
    (Model::Twin, 1002, 3.900),
    (Model::Other, 1000, 2.854),
    (Model::Other, 1001, 2.992),
    (Model::Other, 1003, 6.798),
    (Model::Coarse, 1000, 2.192),
    (Model::Coarse, 1001, 2.978),
    (Model::Coarse, 1004, 1.624),
];

#[test]
fn a_sample_of_the_study_keeps_its_quality() {
    let outcomes: Vec<CaseOutcome> = std::thread::scope(|scope| {
        let each = SAMPLE.map(|(model, seed, reference_s)| {
            scope.spawn(move || try_case(&draw(model, seed).unwrap(), reference_s).unwrap())
        });
        each.map(|one| one.join().unwrap()).into()
    });
    for one in &outcomes {
        let gaps: Vec<String> = (0..TRIALS).map(|trial| format!("{:+.1}", 100.0 * one.gap(trial))).collect();
        println!("{}: {}", one.seed, gaps.join(" "));
        assert!(one.gap(TRIALS - 1) < 0.10, "case {}: {gaps:?}", one.seed);
        // Faster than the planner with full knowledge at 0.97·L_set is possible, but not by much without overload.
        assert!(one.gap(TRIALS - 1) > -0.04, "case {}: {gaps:?}", one.seed);
    }
    let sum = summarise(&outcomes);
    assert!(sum.gap_median_p95.0 < 0.035, "{sum:?}");
    assert_eq!((sum.overloaded, sum.tried), (0, SAMPLE.len() * TRIALS), "{sum:?}");
    assert!(sum.most_knots <= 20 && sum.coverage > 0.75, "{sum:?}");
}

/// No trial of a case is overloaded, or above 1.05 times L_set at all without noise, and the last is near the planner's.
fn overloads_nothing(model: Model, seed: u64, reference_s: f64) {
    let outcome = try_case(&draw(model, seed).unwrap(), reference_s).unwrap();
    for (at, trial) in outcome.trials.iter().enumerate() {
        let told = (trial.overload_s, trial.worst_ratio);
        assert!(
            trial.overload_s <= OVERLOAD_S + 1e-9 && trial.worst_ratio < 1.05,
            "case {seed}, trial {}: {told:?}",
            at + 1
        );
    }
    assert!(outcome.gap(TRIALS - 1) < 0.10, "case {seed}: {}", outcome.gap(TRIALS - 1));
}

/// A profile that slows down steeply on an axis that follows 26 ms late: the tool is up to half as fast again as programmed
/// where the load rises.
#[test]
fn an_axis_that_lags_behind_a_steep_profile_overloads_nothing() {
    overloads_nothing(Model::Other, 2018, 1.038);
}

/// Loads of which a part knows no feed and that soften with the time in contact: a raise by a third and a shorter way to it
/// both meet more load than straight lines and the work put in tell, at all depths at once.
#[test]
fn a_raise_on_a_load_that_is_convex_in_the_feed_overloads_nothing() {
    overloads_nothing(Model::Coarse, 1122, 3.672);
    overloads_nothing(Model::Coarse, 1137, 2.700);
}

#[test]
fn the_optimiser_is_shorter_than_each_strategy_of_the_paper_at_the_loads_that_it_keeps() {
    let rows = paper_rows(2001).unwrap();
    assert_eq!(rows.len(), 8);
    for row in rows {
        assert!(
            row.learnt_s() < row.strategy_s * 0.85,
            "{}: {} s, {} s",
            row.name,
            row.learnt_s(),
            row.strategy_s
        );
        assert!(
            row.outcome.trials.iter().all(|trial| trial.overload_s <= OVERLOAD_S + 1e-9),
            "{}: {:?}",
            row.name,
            row.outcome
        );
    }
}

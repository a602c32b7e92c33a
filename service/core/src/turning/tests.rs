use proptest::prelude::*;

use super::*;

fn paper() -> Job {
    Job::new(JobInput::alaskari_oraby_2017()).unwrap()
}

/// V, f, AW, P, F, MRR of Alaskari & Oraby 2017, Table 1.
const TABLE_1: [[f64; 6]; 16] = [
    [50.0, 0.6, 0.083884, 2.33315679, 931.248196, 75000.0],
    [60.0, 0.6, 0.093189, 2.80865049, 957.189791, 90000.0],
    [70.0, 0.6, 0.101858, 3.28552627, 979.686084, 105000.0],
    [80.0, 0.6, 0.110016, 3.76358842, 999.60018, 120000.0],
    [90.0, 0.6, 0.117753, 4.24269023, 1017.50139, 135000.0],
    [100.0, 0.6, 0.125133, 4.72271758, 1033.78604, 150000.0],
    [110.0, 0.6, 0.132208, 5.20357911, 1048.74171, 165000.0],
    [120.0, 0.6, 0.139015, 5.68520002, 1062.58402, 180000.0],
    [130.0, 0.6, 0.145586, 6.16751794, 1075.47898, 195000.0],
    [140.0, 0.6, 0.151946, 6.65048004, 1087.55733, 210000.0],
    [150.0, 0.58, 0.157219, 6.97040767, 1083.35819, 217500.0],
    [160.0, 0.53, 0.160731, 6.99801463, 1053.22409, 212000.0],
    [170.0, 0.48, 0.163705, 6.9551237, 1019.48205, 204000.0],
    [180.0, 0.445, 0.167056, 6.99927378, 996.056738, 200250.0],
    [190.0, 0.410, 0.169994, 6.99182881, 970.179811, 194750.0],
    [200.0, 0.380, 0.172879, 6.99304131, 946.940685, 190000.0],
];

/// V, f, past wear, Wo_i, Wo_{i-1}, increase, total, P, F, MRR of Table 2.
const TABLE_2: [[f64; 10]; 16] = [
    [50.0, 0.165, 0.157219, 0.08003, 0.06753, 0.01255, 0.16972, 1.32, 1491.0, 20625.0],
    [60.0, 0.23, 0.157219, 0.09401, 0.07932, 0.01468, 0.17190, 1.90, 1497.0, 34500.0],
    [70.0, 0.3, 0.157219, 0.10744, 0.09066, 0.01678, 0.17400, 2.56, 1499.0, 52500.0],
    [80.0, 0.37, 0.157219, 0.12021, 0.10143, 0.01877, 0.17599, 3.26, 1495.0, 74000.0],
    [90.0, 0.45, 0.157219, 0.13296, 0.11220, 0.02077, 0.17799, 4.08, 1498.0, 101250.0],
    [100.0, 0.53, 0.157219, 0.14524, 0.12255, 0.02268, 0.17990, 4.95, 1497.0, 132500.0],
    [110.0, 0.6, 0.157219, 0.15668, 0.13221, 0.02447, 0.18169, 5.80, 1488.0, 165000.0],
    [120.0, 0.6, 0.157219, 0.16474, 0.13901, 0.02573, 0.18295, 6.24, 1437.0, 180000.0],
    [130.0, 0.6, 0.157219, 0.17253, 0.14559, 0.02695, 0.18417, 6.68, 1393.0, 195000.0],
    [140.0, 0.58, 0.157219, 0.17905, 0.15108, 0.02796, 0.18519, 6.97, 1341.0, 203000.0],
    [150.0, 0.53, 0.157219, 0.18352, 0.15486, 0.02866, 0.18589, 6.98, 1275.0, 198750.0],
    [160.0, 0.485, 0.157219, 0.18766, 0.15835, 0.02931, 0.18653, 6.97, 1215.0, 194000.0],
    [170.0, 0.45, 0.157219, 0.19191, 0.16194, 0.02997, 0.18719, 6.99, 1164.0, 191250.0],
    [180.0, 0.415, 0.157219, 0.19567, 0.16511, 0.03056, 0.18778, 6.97, 1114.0, 186750.0],
    [190.0, 0.385, 0.157219, 0.19934, 0.16821, 0.03113, 0.18835, 6.96, 1070.0, 182875.0],
    [200.0, 0.36, 0.157219, 0.20302, 0.17131, 0.03171, 0.18893, 6.97, 1031.0, 180000.0],
];

#[track_caller]
fn printed(got: f64, want: f64, unit: f64) {
    assert!((got - want).abs() <= 0.501 * unit, "{got} is not {want} to {unit}");
}

#[test]
fn table_1_is_reproduced_to_its_printed_digits() {
    let job = paper();
    let rows = Selector::new(&job).per_speed(EdgeState::FRESH);
    assert_eq!(rows.len(), 16);
    for (row, want) in rows.iter().zip(TABLE_1) {
        let row = row.unwrap();
        printed(row.cut.speed_m_min(), want[0], 1e-9);
        printed(row.cut.feed_mm_rev(), want[1], 1e-9);
        printed(row.outcome.wear_mm, want[2], 1e-6);
        printed(row.outcome.power_kw, want[3], 1e-8);
        printed(row.outcome.force_n, want[4], if want[4] > 1000.0 { 1e-5 } else { 1e-6 });
        printed(row.outcome.removal_mm3_min, want[5], 1e-6);
    }
}

#[test]
fn table_2_is_reproduced_to_its_printed_digits() {
    let job = paper();
    let selector = Selector::new(&job);
    let state = selector.choose(EdgeState::FRESH).unwrap().after();
    // The table was rounded twice in places (0.1858815 stands as 0.18589), so one unit of the last digit is allowed.
    let printed = |got: f64, want: f64, unit: f64| printed(got, want, unit * 2.0);
    for (row, mut want) in selector.per_speed(state).iter().zip(TABLE_2) {
        let row = row.unwrap();
        if want[0] < 55.0 {
            // A misprint: the row's own columns give 0.08003 − 0.06753 = 0.01250 and 0.16972 − 0.157219 = 0.01250.
            want[5] = 0.0125;
        }
        printed(row.cut.speed_m_min(), want[0], 1e-9);
        printed(row.cut.feed_mm_rev(), want[1], 1e-9);
        printed(row.outcome.wear_mm - row.outcome.wear_increase_mm, want[2], 1e-6);
        printed(row.outcome.wear_increase_mm, want[5], 1e-5);
        printed(row.outcome.wear_mm, want[6], 1e-5);
        printed(row.outcome.power_kw, want[7], 1e-2);
        printed(row.outcome.force_n, want[8], 1.0);
        printed(row.outcome.removal_mm3_min, want[9], 1e-6);
        // Wo_i and Wo_{i-1}: what a new edge would have worn by the end and by the start of the interval (Eq. 4).
        let fresh = |minutes: f64| job.wear_gain_over(0.0, minutes) * job.severity(row.cut);
        printed(fresh(2.0), want[3], 1e-5);
        printed(fresh(1.0), want[4], 1e-5);
    }
}

#[test]
fn the_papers_life_ends_after_fourteen_minutes_by_wear() {
    let job = paper();
    let plan = greedy_plan(&job, EdgeState::FRESH);
    let pairs: Vec<_> = plan.intervals.iter().map(|i| (i.cut.speed_m_min(), i.cut.feed_mm_rev())).collect();
    assert_eq!(pairs.len(), 14);
    assert_eq!(pairs[0], (150.0, 0.58));
    assert_eq!(pairs[1], (140.0, 0.58));
    assert_eq!(pairs[13], (200.0, 0.205));
    assert_eq!(plan.end, EndOfLife::Limit(Limit::Wear));
    // Fig. 11: power binds first, force late in the life.
    assert_eq!(plan.intervals[0].binding, Binding::Limit(Limit::Power));
    assert_eq!(plan.intervals[13].binding, Binding::Limit(Limit::Force));
    assert!(!plan.outside.any());
    let mut state = EdgeState::FRESH;
    for interval in &plan.intervals {
        assert_eq!(interval.outcome, job.predict(state, interval.cut));
        state = interval.after();
    }
}

#[test]
fn no_fixed_pair_of_the_grid_beats_the_best_fixed_run() {
    for accumulation in [Accumulation::ElapsedTime, Accumulation::State] {
        let job = paper().with_accumulation(accumulation);
        let best = best_fixed_run(&job, EdgeState::FRESH).unwrap();
        let rate = |plan: &Plan| plan.totals.overall_removal_mm3_min.unwrap_or(0.0);
        for speed in [50.0, 100.0, 150.0, 200.0] {
            for feed in [0.06, 0.2, 0.4, 0.6] {
                let fixed = fixed_run(&job, EdgeState::FRESH, Cut::new(speed, feed).unwrap());
                assert!(rate(&fixed) <= rate(&best) * (1.0 + 1e-9), "{speed} {feed}");
            }
        }
        // The paper compares one life each: the adaptive plan removes far more before its edge is done.
        let compared = compare(&greedy_plan(&job, EdgeState::FRESH), &best);
        assert!(compared.removed.unwrap() > 2.0, "{compared:?}");
    }
}

#[test]
fn both_readings_of_wear_agree_at_a_fixed_pair() {
    let cut = Cut::new(100.0, 0.3).unwrap();
    let wear = |accumulation| {
        let job = paper().with_accumulation(accumulation);
        fixed_run(&job, EdgeState::FRESH, cut).intervals.iter().map(|i| i.outcome.wear_mm).collect::<Vec<_>>()
    };
    let (elapsed, state) = (wear(Accumulation::ElapsedTime), wear(Accumulation::State));
    assert!(elapsed.len() > 5 && elapsed.len() == state.len());
    for (a, b) in elapsed.iter().zip(&state) {
        assert!((a - b).abs() < 1e-12, "{a} {b}");
    }
}

#[test]
fn looking_ahead_pays_and_says_how_far_to_trust_it() {
    let job = paper().with_accumulation(Accumulation::State);
    let same_time = whole_life_plan(&job, EdgeState::FRESH, Objective::RemovalInGreedyTime);
    assert!((0.02..0.06).contains(&same_time.gain), "{}", same_time.gain);
    assert_eq!(same_time.plan.intervals[0].binding, Binding::Life);
    let overall = whole_life_plan(&job, EdgeState::FRESH, Objective::OverallRemoval);
    assert!((0.1..0.2).contains(&overall.gain), "{}", overall.gain);
    assert_eq!(overall.plan.end, EndOfLife::Exchange);
    assert!((overall.gain - overall.gain_by_state).abs() < 1e-9);
    // With Eq. 4 read literally the plan idles through the first minute, and the second figure shows that up.
    let literal = whole_life_plan(&paper(), EdgeState::FRESH, Objective::OverallRemoval);
    assert!(literal.gain > 0.2 && literal.gain_by_state < 0.0, "{} {}", literal.gain, literal.gain_by_state);
    // An expensive edge is used longer than a cheap one.
    let with_price = |edge_cost| {
        let economics = Economics { tool_change_min: 1.0, edge_cost, machine_cost_per_min: 1.0 };
        let input =
            JobInput { accumulation: Accumulation::State, economics, ..JobInput::alaskari_oraby_2017() };
        whole_life_plan(&Job::new(input).unwrap(), EdgeState::FRESH, Objective::Cost).plan.totals
    };
    let (cheap, dear) = (with_price(0.1), with_price(20.0));
    assert!(dear.cutting_min > cheap.cutting_min, "{dear:?} {cheap:?}");
}

#[test]
fn looking_ahead_finds_what_trying_every_sequence_finds() {
    let input = JobInput {
        interval_min: 3.0,
        domain: DomainInput::Grid {
            speed_m_min: Axis { min: 100.0, max: 200.0, step: 50.0 },
            feed_mm_rev: Axis { min: 0.2, max: 0.6, step: 0.2 },
        },
        accumulation: Accumulation::State,
        ..JobInput::alaskari_oraby_2017()
    };
    let job = Job::new(input).unwrap();
    let cuts: Vec<Cut> = [100.0, 150.0, 200.0]
        .into_iter()
        .flat_map(|v| [0.2, 0.4, 0.6].map(|f| Cut::new(v, f).unwrap()))
        .collect();
    fn most(job: &Job, cuts: &[Cut], state: EdgeState, left: usize) -> f64 {
        if left == 0 {
            return 0.0;
        }
        cuts.iter()
            .map(|cut| Chosen::new(job, state, *cut, Binding::Given))
            .filter(|next| next.utilisation.exceeded().is_none())
            .map(|next| next.outcome.removal_mm3_min * 3.0 + most(job, cuts, next.after(), left - 1))
            .fold(0.0, f64::max)
    }
    let life = whole_life_plan(&job, EdgeState::FRESH, Objective::RemovalInGreedyTime);
    let intervals = life.greedy.intervals.len();
    assert!((3..=6).contains(&intervals), "{intervals}");
    let best = most(&job, &cuts, EdgeState::FRESH, intervals);
    let got = life.plan.totals.removed_mm3;
    assert!(got <= best * (1.0 + 1e-9) && got >= 0.995 * best, "{got} of {best}");
}

#[test]
fn adaptation_finds_the_true_factors_and_brings_the_power_back_under_its_limit() {
    let library = paper();
    let truth = library.with_model(library.model().scaled(1.1, 1.12, 0.9));
    let settings = AdaptationSettings::new(AdaptationInput::default()).unwrap();
    let mut adaptation = Adaptation::new(settings, EdgeState::FRESH);
    let mut edge = EdgeState::FRESH;
    let mut over = Vec::new();
    // Readings of a seeded ±2 %: enough to show that noise does not carry the factors away.
    let mut noise = [0.013, -0.017, 0.004, -0.009, 0.019, -0.002, 0.008].into_iter().cycle();
    for minute in 0..8 {
        let planned = adaptation.corrected(&library, 0.0).unwrap();
        let cut = Selector::new(&planned).choose(adaptation.state()).unwrap().cut;
        let real = truth.predict(edge, cut);
        over.push(real.power_kw / 7.0 - 1.0);
        edge = EdgeState::new(f64::from(minute + 1), real.wear_mm).unwrap();
        let read = Measured {
            power_kw: Some(real.power_kw * (1.0 + noise.next().unwrap())),
            force_n: Some(real.force_n * (1.0 + noise.next().unwrap())),
            wear_mm: (minute % 3 == 2).then_some(real.wear_mm + 0.003),
        };
        let learnt = adaptation.observe(&library, cut, 1.0, read).unwrap();
        assert!(!learnt.gated && !learnt.at_bound);
    }
    let learnt = adaptation.corrections();
    for (found, truth) in [(learnt.wear_factor, 1.1), (learnt.power_factor, 1.12), (learnt.force_factor, 0.9)]
    {
        assert!(found.low < truth && truth < found.high, "{found:?} {truth}");
        assert!((found.value / truth - 1.0).abs() < 0.06, "{found:?} {truth}");
    }
    assert!(over[0] > 0.1, "uncorrected, the first interval draws too much power: {over:?}");
    assert!(over[2..].iter().all(|share| *share < 0.03), "{over:?}");
}

#[test]
fn a_broken_sensor_moves_the_factors_only_to_their_bound() {
    let library = paper();
    let input = AdaptationInput { max_factor: 1.5, ..AdaptationInput::default() };
    let mut adaptation = Adaptation::new(AdaptationSettings::new(input).unwrap(), EdgeState::FRESH);
    let cut = Cut::new(150.0, 0.5).unwrap();
    for _ in 0..200 {
        let read = Measured { power_kw: Some(900.0), ..Measured::default() };
        let learnt = adaptation.observe(&library, cut, 1.0, read).unwrap();
        assert!(learnt.power_factor.value <= 1.5 + 1e-9);
    }
    assert!(adaptation.corrections().gated && adaptation.corrections().at_bound);
    let before = adaptation.clone();
    let read = Measured { power_kw: Some(f64::NAN), ..Measured::default() };
    let refused = adaptation.observe(&library, cut, 1.0, read).unwrap_err();
    assert_eq!((refused.field(), refused.code()), ("power_kw", "not_finite"));
    assert_eq!(adaptation, before);
}

#[test]
fn outside_the_fitted_ranges_the_answer_says_so() {
    let input = JobInput { depth_mm: 4.0, ..JobInput::alaskari_oraby_2017() };
    let plan = greedy_plan(&Job::new(input).unwrap(), EdgeState::FRESH);
    assert_eq!(plan.outside, Outside { speed: false, feed: false, depth: true });
}

#[test]
fn a_worn_out_edge_gives_an_empty_plan_with_its_reason() {
    let plan = greedy_plan(&paper(), EdgeState::new(20.0, 0.4).unwrap());
    assert_eq!((plan.intervals.len(), plan.end), (0, EndOfLife::Limit(Limit::Wear)));
    assert_eq!(plan.totals.mean_removal_mm3_min, None);
    let weak = JobInput {
        limits: Limits { power_kw: 0.01, force_n: 1500.0, wear_mm: 0.3 },
        ..JobInput::alaskari_oraby_2017()
    };
    let plan = greedy_plan(&Job::new(weak).unwrap(), EdgeState::FRESH);
    assert_eq!(plan.end, EndOfLife::Limit(Limit::Power));
}

#[test]
fn bad_input_is_refused_by_name() {
    let base = JobInput::alaskari_oraby_2017;
    let refused = |input: JobInput| {
        let error = Job::new(input).unwrap_err();
        (error.field(), error.code())
    };
    assert_eq!(refused(JobInput { depth_mm: f64::NAN, ..base() }), ("depth_mm", "not_finite"));
    assert_eq!(refused(JobInput { interval_min: 0.0, ..base() }), ("interval_min", "out_of_range"));
    let fine = Axis { min: 0.06, max: 0.6, step: 1e-9 };
    let grid = |feed_mm_rev| DomainInput::Grid {
        speed_m_min: Axis { min: 50.0, max: 200.0, step: 10.0 },
        feed_mm_rev,
    };
    assert_eq!(
        refused(JobInput { domain: grid(fine), ..base() }),
        ("domain.grid.feed_mm_rev.step", "too_many")
    );
    let inverted = Axis { min: 0.6, max: 0.06, step: 0.01 };
    assert_eq!(
        refused(JobInput { domain: grid(inverted), ..base() }),
        ("domain.grid.feed_mm_rev", "inverted_range")
    );
    let mut model = TurningModel::alaskari_oraby_2017().data().clone();
    model.set.tool = " ".into();
    assert_eq!(TurningModel::new(model).unwrap_err().code(), "empty");
}

#[test]
fn entries_at_the_edge_of_what_is_accepted_give_finite_plans_within_the_limits() {
    for (speed, feed, last) in [(3.0, 3.0, 5.0_f64), (-3.0, 0.01, 0.05), (3.0, 0.01, 0.05), (-3.0, 3.0, 3.0)]
    {
        for accumulation in [Accumulation::ElapsedTime, Accumulation::State] {
            let mut data = TurningModel::alaskari_oraby_2017().data().clone();
            (data.wear.speed_exponent, data.wear.feed_exponent) = (speed, feed);
            data.wear.time_exponent = last.min(3.0);
            (data.power.speed_exponent, data.power.feed_exponent, data.power.wear_exponent) =
                (speed, feed, last);
            (data.force.speed_exponent, data.force.feed_exponent, data.force.wear_exponent) =
                (speed, feed, last);
            let continuous = DomainInput::Continuous {
                speed_m_min: Range { min: 1e-3, max: 1e5 },
                feed_mm_rev: Range { min: 1e-6, max: 100.0 },
            };
            for domain in [JobInput::alaskari_oraby_2017().domain, continuous] {
                let model = TurningModel::new(data.clone()).unwrap();
                let input = JobInput { model, domain, accumulation, ..JobInput::alaskari_oraby_2017() };
                let job = Job::new(input).unwrap();
                let plan = greedy_plan(&job, EdgeState::FRESH);
                let life =
                    whole_life_plan(&job, EdgeState::new(1.0, 0.1).unwrap(), Objective::OverallRemoval);
                for interval in plan.intervals.iter().chain(&life.plan.intervals) {
                    let u = interval.utilisation;
                    assert!(u.power <= 1.0 && u.force <= 1.0 && u.wear <= 1.0, "{interval:?}");
                    assert!(interval.outcome.removal_mm3_min.is_finite());
                }
                assert!(life.gain >= 0.0 && plan.totals.removed_mm3.is_finite());
            }
        }
    }
}

/// The paper's entry with other exponents and coefficients: nothing may rely on its numbers.
fn any_model() -> impl Strategy<Value = TurningModel> {
    let wear = (0.5..2.0_f64, -0.5..1.5_f64, 0.02..1.0_f64, 0.1..1.2_f64);
    let power = (0.5..2.0_f64, -0.5..1.3_f64, 0.1..1.2_f64, 0.06..1.5_f64);
    let force = (0.2..2.0_f64, -1.0..0.8_f64, 0.1..1.2_f64, 0.06..2.0_f64);
    (wear, power, force).prop_map(|(w, p, f)| {
        let mut data = TurningModel::alaskari_oraby_2017().data().clone();
        data.wear.coefficient *= w.0;
        (data.wear.speed_exponent, data.wear.feed_exponent, data.wear.time_exponent) = (w.1, w.2, w.3);
        data.power.coefficient *= p.0;
        (data.power.speed_exponent, data.power.feed_exponent, data.power.wear_exponent) = (p.1, p.2, p.3);
        data.force.coefficient *= f.0;
        (data.force.speed_exponent, data.force.feed_exponent, data.force.wear_exponent) = (f.1, f.2, f.3);
        TurningModel::new(data).unwrap()
    })
}

fn any_job() -> impl Strategy<Value = (JobInput, f64, f64)> {
    (a_job(), prop::option::of(any_model())).prop_map(|((input, elapsed, worn), model)| match model {
        Some(model) => (JobInput { model, ..input }, elapsed, worn),
        None => (input, elapsed, worn),
    })
}

fn a_job() -> impl Strategy<Value = (JobInput, f64, f64)> {
    let limits = (1.0..20.0_f64, 300.0..4000.0_f64, 0.1..0.6_f64);
    (limits, 0.5..5.0_f64, 0.1..5.0_f64, 0.0..10.0_f64, 0.0..0.3_f64, 1..40_u32, any::<bool>()).prop_map(
        |((power_kw, force_n, wear_mm), depth_mm, interval_min, elapsed, worn, step, by_state)| {
            let input = JobInput {
                depth_mm,
                interval_min,
                limits: Limits { power_kw, force_n, wear_mm },
                domain: DomainInput::Grid {
                    speed_m_min: Axis { min: 50.0, max: 200.0, step: f64::from(step) },
                    feed_mm_rev: Axis { min: 0.06, max: 0.6, step: 0.005 },
                },
                accumulation: if by_state { Accumulation::State } else { Accumulation::ElapsedTime },
                ..JobInput::alaskari_oraby_2017()
            };
            (input, elapsed, worn)
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn the_grid_search_finds_what_trying_every_pair_finds((input, elapsed, worn) in any_job()) {
        let job = Job::new(input).unwrap();
        let state = EdgeState::new(elapsed, worn).unwrap();
        let Domain::Grid { speeds_m_min, feeds_mm_rev } = job.domain() else { unreachable!() };
        let mut most = 0.0_f64;
        for &v in speeds_m_min {
            for &f in feeds_mm_rev {
                let out = job.predict(state, Cut::new(v, f).unwrap());
                let limits = job.limits();
                if out.power_kw <= limits.power_kw && out.force_n <= limits.force_n && out.wear_mm <= limits.wear_mm {
                    most = most.max(out.removal_mm3_min);
                }
            }
        }
        let found = Selector::new(&job).choose(state).map_or(0.0, |c| c.outcome.removal_mm3_min);
        prop_assert!((found - most).abs() <= 1e-9 * most, "{found} {most}");
    }

    #[test]
    fn the_continuous_optimum_is_never_worse_than_the_grid_and_keeps_the_limits((input, elapsed, worn) in any_job()) {
        let continuous = JobInput {
            domain: DomainInput::Continuous {
                speed_m_min: Range { min: 50.0, max: 200.0 },
                feed_mm_rev: Range { min: 0.06, max: 0.6 },
            },
            ..input.clone()
        };
        let state = EdgeState::new(elapsed, worn).unwrap();
        let grid = Job::new(input).unwrap();
        let free = Job::new(continuous).unwrap();
        let on_grid = Selector::new(&grid).choose(state).map_or(0.0, |c| c.outcome.removal_mm3_min);
        let best = Selector::new(&free).choose(state);
        prop_assert!(best.map_or(0.0, |c| c.outcome.removal_mm3_min) >= on_grid * (1.0 - 1e-9));
        if let Ok(best) = best {
            let u = best.utilisation;
            prop_assert!(u.power <= 1.0 && u.force <= 1.0 && u.wear <= 1.0, "{u:?}");
            prop_assert!(best.binding != Binding::Range || best.cut == Cut::new(200.0, 0.6).unwrap());
        }
    }

}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn a_whole_life_plan_keeps_the_limits_and_is_never_worse_than_greedy((input, _, _) in any_job()) {
        let job = Job::new(JobInput { interval_min: input.interval_min.max(1.0), ..input }).unwrap();
        for objective in [Objective::RemovalInGreedyTime, Objective::OverallRemoval] {
            let life = whole_life_plan(&job, EdgeState::FRESH, objective);
            prop_assert!(life.gain >= 0.0);
            for interval in &life.plan.intervals {
                let u = interval.utilisation;
                prop_assert!(u.power <= 1.0 && u.force <= 1.0 && u.wear <= 1.0, "{u:?}");
            }
        }
    }
}

use super::*;
use crate::machine::{FeedDriveRating, LoadReference, SpindleRating};
use crate::operation::WearSettings;
use crate::plunge::{DrillInput, DrillingLaw, LoopLatencyInput, Material, MaterialInput, PlungeSetup};
use crate::turning::{
    Accumulation, Axis, DomainInput, EdgeState, Job, Limits, Outcome, TurningModel, TurningSetup,
};

fn machine(feed_min_mm_min: f64, feed_max_mm_min: f64) -> Machine {
    Machine {
        id: "M1".try_into().unwrap(),
        name: "M1".to_owned(),
        control: "linuxcnc".to_owned(),
        ipo_period_ms: 10.0,
        spindle: SpindleRating { reference: LoadReference::RatedPower, ..SpindleRating::default() },
        feed_drive: FeedDriveRating { reference: LoadReference::RatedTorque, rated_thrust_newtons: None },
        limits: FeedLimits::new(feed_min_mm_min, feed_max_mm_min, 20.0, 150.0).unwrap(),
    }
}

fn operation(process: Process) -> Operation {
    Operation {
        id: "O1".try_into().unwrap(),
        name: "O1".to_owned(),
        process,
        program: None,
        feature: None,
        work_material: None,
        thickness_mm: None,
        depth_mm: None,
        spindle_speed_rpm: None,
        programmed_feed_mm_min: None,
        spindle_load_set_percent: None,
        feed_drive_load_set_percent: None,
        wear: WearSettings::default(),
        turning: None,
        plunge: None,
    }
}

/// Alaskari & Oraby 2017: d = 2.5 mm, 7 kW, 1500 N, 0.3 mm, the grid of the paper.
fn setup(caution_sigmas: f64) -> TurningSetup {
    TurningSetup {
        model: "alaskari-oraby-2017".try_into().unwrap(),
        depth_mm: 2.5,
        diameter_mm: Some(80.0),
        interval_min: 1.0,
        limits: Limits { power_kw: 7.0, force_n: 1500.0, wear_mm: 0.3 },
        domain: DomainInput::Grid {
            speed_m_min: Axis { min: 50.0, max: 200.0, step: 10.0 },
            feed_mm_rev: Axis { min: 0.06, max: 0.6, step: 0.005 },
        },
        accumulation: Accumulation::ElapsedTime,
        caution_sigmas,
    }
}

fn job() -> Job {
    setup(0.0).job(TurningModel::alaskari_oraby_2017()).unwrap()
}

/// So many minutes at (150 m/min, 0.3 mm/rev), each told as `tell` makes it from what the entry expects.
fn edge(minutes: usize, caution_sigmas: f64, tell: impl Fn(&mut EdgeCycle, Outcome)) -> Vec<EdgeCycle> {
    let cut = crate::turning::Cut::new(150.0, 0.3).unwrap();
    let mut state = EdgeState::FRESH;
    (0..minutes)
        .map(|_| {
            let outcome = job().predict(state, cut);
            state = EdgeState::new(state.elapsed_min() + 1.0, outcome.wear_mm).unwrap();
            let mut cycle = EdgeCycle {
                setup: Some(setup(caution_sigmas)),
                duration_ms: Some(60_000.0),
                speed_m_min: Some(150.0),
                feed_mm_rev: Some(0.3),
                ..EdgeCycle::default()
            };
            tell(&mut cycle, outcome);
            cycle
        })
        .collect()
}

/// What is recommended for an edge that has cut `cycles`.
fn turned(
    cycles: Vec<EdgeCycle>,
    caution_sigmas: f64,
    limits: (f64, f64),
    state: ToolState,
) -> Recommendation {
    let operation = Operation { turning: Some(setup(caution_sigmas)), ..operation(Process::Turning) };
    let knowledge = Knowledge::Turning {
        model: Some(Box::new(TurningModel::alaskari_oraby_2017())),
        history: EdgeHistory::Cycles(cycles),
    };
    asked(&operation, &knowledge, limits, state)
}

fn asked(
    operation: &Operation,
    knowledge: &Knowledge,
    limits: (f64, f64),
    state: ToolState,
) -> Recommendation {
    let verdict = Verdict { state, ..Verdict::unknown("no_cycles", "nothing was run") };
    recommend(&Question {
        now: Timestamp::from_micros(0),
        machine: &machine(limits.0, limits.1),
        operation_id: &operation.id,
        operation: Some(operation),
        tool_id: &"T1".try_into().unwrap(),
        tool_registered: true,
        verdict: &verdict,
        knowledge,
        profiles: &[],
        ran: None,
        damaged: &[],
        settings: RecommendSettings::default(),
    })
}

const WIDE: (f64, f64) = (1.0, 5000.0);

fn says(recommendation: &Recommendation, code: &str) -> bool {
    recommendation.reasons.iter().any(|(reason, _)| reason == code)
}

fn turning(recommendation: &Recommendation) -> &TurningAdvice {
    match recommendation.process_advice.as_ref() {
        Some(ProcessAdvice::Turning(advice)) => advice,
        other => panic!("no turning: {other:?}"),
    }
}

/// Samples of so many ms and such a number, of a spindle that draws so many watts all the time.
fn sampled(cycle: &mut EdgeCycle, (duration_ms, count): (f64, u32), watts: f64) {
    cycle.duration_ms = Some(duration_ms);
    (cycle.sample_count, cycle.coverage) = (count, 1.0);
    let between = if count > 1 { f64::from(count - 1) / f64::from(count) } else { 1.0 };
    cycle.spindle_joules = Some(watts * duration_ms * 1e-3 * between);
}

fn plausible(cycle: &mut EdgeCycle, outcome: Outcome) {
    cycle.power_watts = Some(outcome.power_kw * 1000.0);
    cycle.force_newtons = Some(outcome.force_n);
}

#[test]
fn an_edge_that_reads_as_its_model_gets_a_pair() {
    let advice = turned(edge(4, 0.0, plausible), 0.0, WIDE, ToolState::Good);
    assert!(says(&advice, "turning_advised") && !says(&advice, "turning_readings_implausible"));
    let next = turning(&advice).next.unwrap();
    assert!(next.power_kw <= 7.0 && next.force_n <= 1500.0 && next.wear_mm <= 0.3, "{next:?}");
}

#[test]
fn readings_that_cannot_be_true_advise_no_pair_and_are_named() {
    type Tell = fn(&mut EdgeCycle, Outcome);
    let slips: [(&str, Tell); 5] = [
        ("power in kW", |cycle, outcome| cycle.power_watts = Some(outcome.power_kw)),
        ("sensors that stand", |cycle, _| {
            cycle.power_watts = Some(1.0);
            cycle.force_newtons = Some(1.0);
        }),
        ("no wear ever", |cycle, _| cycle.wear_mm = Some(0.0)),
        ("force in kN", |cycle, outcome| cycle.force_newtons = Some(outcome.force_n / 1000.0)),
        ("mean power of a dead channel", |cycle, _| sampled(cycle, (60_000.0, 600), 1.0)),
    ];
    for caution in [0.0, 2.0] {
        for (what, tell) in slips {
            for minutes in 1..=6 {
                let advice = turned(edge(minutes, caution, tell), caution, WIDE, ToolState::Good);
                assert!(says(&advice, "turning_readings_implausible"), "{what}, {minutes}: {advice:?}");
                assert!(!says(&advice, "turning_advised"), "{what}, {minutes}");
                let turning = turning(&advice);
                assert_eq!(turning.next, None, "{what}, {minutes}");
                assert!(turning.corrections.implausible(), "the estimate is told as it is");
            }
        }
    }
}

#[test]
fn what_was_once_implausible_never_predicts_less_than_the_library() {
    // Two minutes of a dead sensor, or of one that reads far too much, then what the entry expects.
    let glitches: [fn(Outcome) -> f64; 2] = [|_| 1.0, |outcome| outcome.power_kw * 1e6];
    for glitch in glitches {
        let mut cycles = edge(8, 0.0, plausible);
        let wrong = edge(2, 0.0, |cycle, outcome| cycle.power_watts = Some(glitch(outcome)));
        cycles.splice(..2, wrong);
        for minutes in 2..=8 {
            let advice = turned(cycles[..minutes].to_vec(), 0.0, WIDE, ToolState::Good);
            let Some(next) = turning(&advice).next else { continue };
            let cut = crate::turning::Cut::new(next.speed_m_min, next.feed_mm_rev).unwrap();
            let mut state = EdgeState::FRESH;
            for _ in 0..minutes {
                let worn = job().predict(state, crate::turning::Cut::new(150.0, 0.3).unwrap()).wear_mm;
                state = EdgeState::new(state.elapsed_min() + 1.0, worn).unwrap();
            }
            let library = job().predict(state, cut);
            assert!(library.power_kw <= 7.0 && library.force_n <= 1500.0 && library.wear_mm <= 0.3);
            assert!(next.power_kw >= library.power_kw * (1.0 - 1e-12), "{next:?} {library:?}");
            assert!(next.force_n >= library.force_n * (1.0 - 1e-12), "{next:?} {library:?}");
            assert!(next.wear_mm >= library.wear_mm * (1.0 - 1e-12), "{next:?} {library:?}");
        }
    }
}

#[test]
fn a_pair_beyond_the_machines_feeds_is_not_advised_and_says_which_end() {
    let at = |limits| turned(edge(2, 0.0, plausible), 0.0, limits, ToolState::Good);
    let feed = turning(&at(WIDE)).next.unwrap().feed_mm_min.unwrap();
    for (limits, code) in [
        ((feed * 2.0, feed * 4.0), "turning_below_feed_min"),
        ((feed / 4.0, feed / 2.0), "turning_above_feed_max"),
    ] {
        let advice = at(limits);
        assert_eq!(turning(&advice).next, None, "{code}");
        assert!(says(&advice, code) && !says(&advice, "turning_advised"), "{:?}", advice.reasons);
    }
    assert!(turning(&at((feed, feed * 2.0))).next.is_some(), "the end itself belongs to the range");
}

#[test]
fn an_edge_is_as_old_as_its_cycles_took_and_not_as_what_was_sampled_of_them() {
    let told = edge(4, 0.0, |_, _| ());
    let as_told = turned(told.clone(), 0.0, WIDE, ToolState::Good);
    // Ten seconds of each minute were sampled; or all of it, and the control reports the time before the last sample.
    for (sampled_ms, reported_ms) in [(10_000.0, 60_000.0), (60_000.0, 10_000.0), (0.0, 60_000.0)] {
        let with = |mut cycle: EdgeCycle| {
            cycle.duration_ms = (sampled_ms > 0.0).then_some(sampled_ms);
            cycle.reported_duration_ms = Some(reported_ms);
            cycle
        };
        let cycles = told.iter().cloned().map(with).collect();
        assert_eq!(turned(cycles, 0.0, WIDE, ToolState::Good), as_told, "{sampled_ms} ms sampled");
    }
    assert!((turning(&as_told).elapsed_min - 4.0).abs() < 1e-12);
}

#[test]
fn mean_power_is_the_same_at_every_rate_of_sampling_and_none_where_much_is_missing() {
    let of = |duration_ms, count, coverage: f64| {
        let tell = |cycle: &mut EdgeCycle, outcome: Outcome| {
            sampled(cycle, (duration_ms, count), outcome.power_kw * 1000.0);
            cycle.reported_duration_ms = Some(60_000.0);
            cycle.coverage = coverage;
            cycle.spindle_joules = cycle.spindle_joules.map(|joules| joules * coverage);
        };
        let advice = turned(edge(3, 0.0, tell), 0.0, WIDE, ToolState::Good);
        let TurningAdvice { corrections, readings, .. } = turning(&advice);
        (readings.power, corrections.power_factor.value)
    };
    let (readings, factor) = of(60_000.0, 60_000, 1.0);
    assert_eq!(readings, 3);
    for count in [1, 2, 6, 60, 600] {
        let (readings, other) = of(60_000.0, count, 1.0);
        assert_eq!(readings, 3);
        assert!((other - factor).abs() < 1e-9, "{count} samples: {other}, {factor}");
    }
    // A gap counts as one usual interval in the energy and in the time.
    let (readings, other) = of(60_000.0, 600, 0.96);
    assert!(readings == 3 && (other - factor).abs() < 1e-9, "{other}, {factor}");
    assert_eq!(of(60_000.0, 600, 0.94).0, 0, "much of it was not sampled");
    assert_eq!(of(10_000.0, 100, 1.0).0, 0, "ten seconds say nothing of a minute");
    assert_eq!(of(60_000.0, 0, 1.0).0, 0, "no samples");
}

#[test]
fn what_nobody_knows_of_an_edge_advises_no_pair() {
    let mut cycles = edge(3, 0.0, plausible);
    cycles[1].cut_short = true;
    let short = turned(cycles, 0.0, WIDE, ToolState::Good);
    let operation = Operation { turning: Some(setup(0.0)), ..operation(Process::Turning) };
    let model = Some(Box::new(TurningModel::alaskari_oraby_2017()));
    let untimed = Knowledge::Turning { model, history: EdgeHistory::Untimed };
    for advice in [short, asked(&operation, &untimed, WIDE, ToolState::Good)] {
        assert!(says(&advice, "turning_history_untold") && advice.process_advice.is_none(), "{advice:?}");
    }
}

#[test]
fn stale_data_advises_no_pair() {
    let operation = Operation { turning: Some(setup(0.0)), ..operation(Process::Turning) };
    let model = Some(Box::new(TurningModel::alaskari_oraby_2017()));
    let history = EdgeHistory::Cycles(edge(3, 0.0, plausible));
    let knowledge = Knowledge::Turning { model, history };
    let settings = RecommendSettings::default();
    let counted = Timestamp::from_micros(0);
    let of_age = |age_ms: i64| {
        let verdict = Verdict {
            state: ToolState::Good,
            last_counted_at: Some(counted),
            ..Verdict::unknown("no_cycles", "nothing was run")
        };
        recommend(&Question {
            now: counted.plus_millis(age_ms),
            machine: &machine(WIDE.0, WIDE.1),
            operation_id: &operation.id,
            operation: Some(&operation),
            tool_id: &"T1".try_into().unwrap(),
            tool_registered: true,
            verdict: &verdict,
            knowledge: &knowledge,
            profiles: &[],
            ran: None,
            damaged: &[],
            settings,
        })
    };
    assert!(turning(&of_age(settings.stale_after_ms)).next.is_some());
    let stale = of_age(settings.stale_after_ms + 1);
    assert!(says(&stale, "data_stale") && !says(&stale, "turning_advised"), "{:?}", stale.reasons);
    assert_eq!((turning(&stale).next, stale.override_percent), (None, 100.0));
}

#[test]
fn a_panic_of_what_a_process_adds_costs_that_alone() {
    let mut said = Vec::new();
    let mut say = |code: &str, _: &str| said.push(code.to_owned());
    let mut action = Action::Run;
    let advice = held(&mut action, &mut say, |action, say| {
        *action = Action::ChangeTool;
        say("turning_edge_spent", "half-way");
        let none: [f64; 0] = [];
        assert!(!none.is_empty(), "as the test wants it");
        None
    });
    assert_eq!((advice, action), (None, Action::Run));
    assert_eq!(said, ["turning_edge_spent", "process_advice_failed"]);
}

#[test]
fn no_plunge_feed_for_a_tool_that_is_to_be_looked_at() {
    let law = |coefficient, diameter_exponent, feed_exponent| DrillingLaw {
        coefficient,
        diameter_exponent,
        feed_exponent,
        correction: 1.0,
    };
    let material = Material::new(MaterialInput {
        name: "steel 45".into(),
        thrust: law(680.0, 1.0, 0.7),
        torque: law(345.0, 2.0, 0.8),
    });
    let setup = PlungeSetup {
        material: "c45".try_into().unwrap(),
        drill: DrillInput {
            diameter_mm: 12.0,
            length_mm: 100.0,
            spindle_rpm: 800.0,
            modulus_n_mm2: None,
            shear_strength_n_mm2: None,
        },
        latency: None::<LoopLatencyInput>,
    };
    let operation = Operation { plunge: Some(setup), ..operation(Process::Plunge) };
    let knowledge = Knowledge::Plunge(Some(Box::new(material.unwrap())));
    let at = |state| asked(&operation, &knowledge, (10.0, 5000.0), state);
    for state in [ToolState::Unknown, ToolState::Learning, ToolState::Good, ToolState::Warning] {
        let advice = at(state);
        assert!(says(&advice, "plunge_advised") && advice.process_advice.is_some(), "{state:?}");
    }
    for state in [ToolState::Changed, ToolState::Worn, ToolState::BrokenSuspected] {
        let advice = at(state);
        assert_eq!(advice.process_advice, None, "{state:?}");
        assert!(says(&advice, "plunge_withheld") && !says(&advice, "plunge_advised"), "{state:?}");
    }
    // An edge that is to be looked at gets no pair either.
    let turned = turned(edge(2, 0.0, plausible), 0.0, WIDE, ToolState::Changed);
    assert!(says(&turned, "turning_withheld") && turning(&turned).next.is_none());
}

#[test]
fn a_profile_is_run_within_its_own_limits_too_and_at_the_lower_of_two_set_loads() {
    use crate::feed::profile::tests::given;
    use crate::feed::profile::{LimitsInput, Profile, ProfileHash, ProfileInput};
    let input = given::input();
    let limits = LimitsInput {
        override_min_percent: 30.0,
        override_max_percent: 120.0,
        spindle_load_set_percent: Some(40.0),
        feed_drive_load_set_percent: Some(30.0),
        ..input.limits
    };
    let operation = Operation {
        program: input.conditions.program.clone(),
        work_material: input.conditions.work_material.clone(),
        spindle_speed_rpm: input.conditions.spindle_speed_rpm,
        depth_mm: Some(20.5),
        programmed_feed_mm_min: Some(110.0),
        spindle_load_set_percent: Some(45.0),
        feed_drive_load_set_percent: Some(25.0),
        ..operation(Process::Friction)
    };
    let profile = Profile::new(ProfileInput { limits, ..input }).unwrap();
    let version = crate::cycle::ProfileVersion { profile: "P1".try_into().unwrap(), version: 1 };
    let active = [ActiveProfile { version, hash: ProfileHash::from_bytes([0; 32]), profile }];
    let machine = machine(10.0, 2000.0);
    let tool = "T1".try_into().unwrap();
    let verdict = Verdict { state: ToolState::Learning, life: 1, cycles: 3, ..Verdict::unknown("x", "x") };
    let question = |profiles| Question {
        now: Timestamp::from_micros(0),
        machine: &machine,
        operation_id: &operation.id,
        operation: Some(&operation),
        tool_id: &tool,
        tool_registered: true,
        verdict: &verdict,
        knowledge: &Knowledge::None,
        profiles,
        ran: None,
        damaged: &[],
        settings: RecommendSettings::default(),
    };
    let with = recommend(&question(&active[..]));
    assert!(with.profile.is_some(), "{:?}", with.reasons);
    assert_eq!((with.spindle_load_set_percent, with.feed_drive_load_set_percent), (Some(40.0), Some(25.0)));
    assert_eq!(with.limits, FeedLimits::new(50.0, 1000.0, 30.0, 120.0).unwrap());
    // A shop that may run one feed only.
    let one = |limits| {
        let flat = |knot: &mut crate::feed::profile::KnotInput| knot.feed_mm_min = 110.0;
        let mut input = ProfileInput { limits, ..given::input() };
        input.knots.iter_mut().for_each(flat);
        Profile::new(input).unwrap()
    };
    let profile = one(LimitsInput { feed_min_mm_min: 110.0, feed_max_mm_min: 110.0, ..limits });
    let active = [ActiveProfile { profile, ..active[0].clone() }];
    let narrow = recommend(&question(&active[..])).limits;
    assert_eq!(Some(narrow), FeedLimits::held((110.0, 110.0), (30.0, 120.0)));
    let without = recommend(&question(&[]));
    assert_eq!(
        (without.spindle_load_set_percent, without.feed_drive_load_set_percent),
        (Some(45.0), Some(25.0))
    );
    assert_eq!(without.limits, machine.limits);
    // By what is damaged nothing is decided, whatever else is known.
    for what in [
        Damaged::Machine,
        Damaged::Calibration,
        Damaged::Operation,
        Damaged::Tool,
        Damaged::Model,
        Damaged::FeedProfile,
    ] {
        let neutral = recommend(&Question { damaged: &[what, what], ..question(&active[..]) });
        assert!(neutral.profile.is_none() && neutral.feed_mm_min.is_none());
        assert_eq!((neutral.spindle_load_set_percent, neutral.feed_drive_load_set_percent), (None, None));
        assert_eq!(neutral.override_percent.to_bits(), NEUTRAL_OVERRIDE_PERCENT.to_bits());
        let told = neutral.reasons.iter().filter(|(code, _)| code == "registered_data_damaged");
        assert_eq!(told.count(), 1, "{:?}", neutral.reasons);
        assert!(neutral.reasons[0].1.contains(what.as_str()), "{:?}", neutral.reasons);
        assert!(!says(&neutral, "no_profile") && !says(&neutral, "profile_active"));
    }
    let knowledge = &Knowledge::Damaged;
    let neutral = recommend(&Question { knowledge, ..question(&active[..]) });
    assert!(says(&neutral, "registered_data_damaged") && neutral.profile.is_none());
}

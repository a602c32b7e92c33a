//! Tools whose feed varies: compensated, measured by reference cycles, or said to be masked.
//!
//! The material is exact: e = 40·(F/200)^−0.6 J/mm, and a worn surface that drags whatever the feed.

use super::*;
use crate::cycle::{Flag, Flags};
use crate::friction::relation::DepthProfile;
use crate::ids::{CycleId, MachineId, OperationId};
use crate::operation::WearSettings;
use crate::summary::{DepthDigest, EnergyBasis, relation_config};
use crate::tool::ToolEventKind;
use crate::units::{Strategy, Timestamp};
use proptest::prelude::*;
use proptest::strategy::Strategy as _;

const REFERENCE_MM_MIN: f64 = 100.0;

/// When events are told that begin no story of time.
const TOLD: Timestamp = Timestamp::from_micros(0);

fn needs(feed: f64) -> f64 {
    40.0 * (feed / 200.0_f64).powf(-0.6)
}

/// Energy over 10 mm; `drag` is the worn surface's share at the reference feed.
fn hole(feed: impl Fn(f64) -> f64, drag: f64) -> DepthProfile {
    let config = relation_config().unwrap();
    let mut profile = DepthProfile::new(&config);
    for step in 0..100 {
        let from = f64::from(step) * 0.1;
        let feed = feed(from + 0.05);
        let dragged = drag * needs(REFERENCE_MM_MIN) * REFERENCE_MM_MIN / feed;
        profile.add(&config, from, from + 0.1, 0.1 / feed * 60.0, 0.1 * (needs(feed) + dragged));
    }
    profile
}

fn facts(number: u32, strategy: Option<Strategy>, profile: &DepthProfile) -> CycleFacts {
    let time_s: f64 = profile.bins().iter().map(|bin| bin.time_s).sum();
    CycleFacts {
        order: OrderKey {
            started_at: Timestamp::from_micros(1_700_000_000_000_000 + i64::from(number) * 10_000_000),
            machine: MachineId::try_from("M1").unwrap(),
            seq: None,
            cycle: CycleId::try_from(format!("c{number}").as_str()).unwrap(),
        },
        operation: OperationId::try_from("O1").unwrap(),
        received_at: Timestamp::from_micros(1_700_000_001_000_000 + i64::from(number) * 10_000_000),
        spindle_speed_rpm: Some(2500.0),
        sampled_speed_rpm: None,
        strategy,
        law_version: None,
        profile: None,
        energy: Some((EnergyBasis::Calibrated, false, profile.total())),
        energy_scale: 0,
        duration_ms: Some(1e3 * time_s),
        max_depth_mm: Some(10.0),
        fall_depth_mm: None,
        operator_override_percent: None,
        digest: DepthDigest::of(profile),
        asked_as_reference: false,
        coverage: 1.0,
        flags: Flags::NONE,
    }
}

fn settings(every: Option<u32>) -> FoldSettings {
    let wear = WearSettings { reference_every_cycles: every, ..WearSettings::default() };
    FoldSettings {
        wear,
        depth_mm: None,
        spindle_speed_rpm: None,
        is_friction: true,
        reference_feed_mm_min: Some(REFERENCE_MM_MIN),
    }
}

struct Life {
    fold: ToolFold,
    settings: FoldSettings,
    number: u32,
}

impl Life {
    fn new(every: Option<u32>) -> Self {
        Self { fold: ToolFold::default(), settings: settings(every), number: 0 }
    }

    fn run(&mut self, strategy: Option<Strategy>, profile: &DepthProfile) -> Verdict {
        self.with(strategy, profile, |_| {})
    }

    fn with(
        &mut self,
        strategy: Option<Strategy>,
        profile: &DepthProfile,
        change: impl FnOnce(&mut CycleFacts),
    ) -> Verdict {
        self.number += 1;
        let mut cycle = facts(self.number, strategy, profile);
        change(&mut cycle);
        self.fold.cycle(&cycle, Some(&self.settings));
        self.fold.verdict()
    }

    fn due(&self) -> bool {
        self.fold.verdict().feed.references.is_some_and(|references| references.due_in == 0)
    }
}

fn says(verdict: &Verdict, code: &str) -> bool {
    verdict.reasons.iter().any(|(said, _)| *said == code)
}

#[test]
fn after_long_unmeasured_work_reference_cycles_of_before_call_no_tool_good() {
    const SCATTER: [f64; 6] = [0.96, 1.03, 1.0, 1.04, 0.97, 1.01];
    let ramp = |depth: f64| REFERENCE_MM_MIN + 15.0 * depth;
    let reference = (Strategy::FConst, hole(|_| REFERENCE_MM_MIN, 0.0));
    let (usual, worn) = ((Strategy::FLin, hole(ramp, 0.0)), (Strategy::FLin, hole(ramp, 0.12)));
    let run = |life: &mut Life, (strategy, profile): &(Strategy, DepthProfile), is_measured: bool| {
        let scatter = SCATTER[life.number as usize % SCATTER.len()];
        life.with(Some(*strategy), profile, |cycle| {
            cycle.energy = cycle
                .energy
                .filter(|_| is_measured)
                .map(|(basis, idle, joules)| (basis, idle, joules * scatter));
        })
    };
    let by_references = |verdict: &Verdict| {
        let decides = verdict.level.as_ref().and_then(|level| level.decides);
        (verdict.state, decides) == (ToolState::Good, Some(LevelBasis::ReferenceCycles))
    };
    for every in [50, 200] {
        let mut life = Life::new(Some(every));
        for n in 0..60 {
            run(&mut life, if n < 9 || n % 10 == 0 { &reference } else { &usual }, true);
        }
        assert!(by_references(&life.fold.verdict()), "{every}");
        for _ in 0..25 {
            run(&mut life, &usual, false);
        }
        let (before, number) = (life.fold.clone(), life.number);
        let states: Vec<_> = (0..16).map(|_| run(&mut life, &worn, true).state).collect();
        assert!(!states.contains(&ToolState::Good), "{every}: {states:?}");
        assert_eq!(states.last(), Some(&ToolState::Worn), "{every}: {states:?}");
        assert_eq!(ToolFold::from_bytes(&life.fold.to_bytes()).unwrap(), life.fold, "as it is stored");
        // Those that are run from then on decide again.
        let mut looked = Life { fold: before, number, ..Life::new(Some(every)) };
        for _ in 0..5 {
            run(&mut looked, &reference, true);
        }
        let verdict = run(&mut looked, &usual, true);
        assert!(by_references(&verdict), "{every}: {verdict:?}");
    }
}

#[test]
fn at_one_feed_the_ratio_as_run_decides_and_the_compensated_one_agrees() {
    let mut life = Life::new(Some(50));
    for k in 0..30 {
        life.run(Some(Strategy::FConst), &hole(|_| REFERENCE_MM_MIN, 0.002 * f64::from(k)));
    }
    let verdict = life.fold.verdict();
    let level = verdict.level.unwrap();
    assert_eq!(level.decides, Some(LevelBasis::AsRun));
    assert!((level.value - level.as_run).abs() < 1e-12);
    let compensated = verdict.feed.at_own_feed.unwrap();
    assert!((compensated.value - level.as_run).abs() < 0.003, "{compensated:?} {level:?}");
    assert_eq!((verdict.feed.masked, verdict.feed.references), (None, None), "nothing else is needed");
}

#[test]
fn a_slower_feed_is_no_wear() {
    // Nobody says how the feed is chosen; it drops by a tenth, and the energy as run rises by 7 %.
    let mut life = Life::new(None);
    for k in 0..5 {
        life.run(None, &hole(|_| 200.0 + 10.0 * f64::from(k % 3), 0.0));
    }
    for _ in 0..10 {
        life.run(None, &hole(|_| 185.0, 0.0));
    }
    let verdict = life.fold.verdict();
    let level = verdict.level.unwrap();
    assert!(level.as_run > 1.07, "{level:?}");
    assert_eq!(
        (level.decides, verdict.state),
        (Some(LevelBasis::FeedCompensated), ToolState::Good),
        "{level:?}"
    );
    assert!((level.value - 1.0).abs() < 2.0 * level.sd.unwrap() + 0.01, "{level:?}");
    assert!(says(&verdict, "decided_by_compensation"));
}

#[test]
fn what_wears_no_tool_carries_no_wear_on() {
    let mut life = Life::new(None);
    for k in 0..40 {
        life.run(None, &hole(|_| 200.0 + 10.0 * f64::from(k % 3), 0.002 * f64::from(k)));
    }
    let level = |life: &Life| life.fold.verdict().level.unwrap();
    let before = level(&life);
    assert!(before.decides == Some(LevelBasis::FeedCompensated) && before.value > 1.05, "{before:?}");
    for _ in 0..12 {
        life.with(None, &hole(|_| 200.0, 0.1), |cycle| cycle.flags.insert(Flag::Aborted));
    }
    assert_eq!(level(&life), before);
    // A cycle that cut and could not be measured does.
    life.with(None, &hole(|_| 200.0, 0.1), |cycle| cycle.energy = None);
    assert!(level(&life).value > before.value);
}

/// A fast program near the reference feed: carried over to it, the wear is called although the energy as run says less.
#[test]
fn a_program_whose_energy_is_known_is_called_at_the_reference_feed() {
    let program = |depth: f64| if depth < 5.0 { 150.0 } else { 110.0 };
    let mut life = Life::new(None);
    life.settings.wear.baseline_cycles = 12;
    for k in 0..12 {
        let factor = [0.85, 1.0, 1.18][k % 3];
        life.run(Some(Strategy::FSec), &hole(|depth| factor * program(depth), 0.0));
    }
    let mut called = None;
    for k in 0..200 {
        let drag = 0.001 * f64::from(k);
        if life.run(Some(Strategy::FSec), &hole(program, drag)).state == ToolState::Worn {
            called = Some(drag);
            break;
        }
    }
    let level = life.fold.verdict().level.unwrap();
    assert!(called.is_some_and(|drag| (drag - 0.1).abs() < 0.015), "{called:?} {level:?}");
    assert_eq!(level.decides, Some(LevelBasis::FeedCompensated));
    assert!(level.as_run < 1.095, "{level:?}");
}

#[test]
fn an_adaptive_law_is_masked_until_reference_cycles_decide() {
    let mut life = Life::new(Some(10));
    // What the machine runs: as it is asked to; the law slows the feed as the tool wears.
    let mut worn_at = None;
    for k in 0..400_u32 {
        let drag = 0.0005 * f64::from(k);
        let due = life.due();
        let verdict = if due {
            life.run(Some(Strategy::FConst), &hole(|_| REFERENCE_MM_MIN, drag))
        } else {
            // From hole to hole the law answers to the material too, so that the feed varies.
            let hard = [0.9, 1.0, 1.12][k as usize % 3];
            life.run(Some(Strategy::FAc), &hole(|_| 350.0 * hard / (1.0 + drag), drag))
        };
        match k {
            0 => {
                assert!(says(&verdict, "masked_by_control"), "{verdict:?}");
                assert!(life.due(), "a tool under a law begins with reference cycles");
            }
            1..=4 => assert!(due),
            20 => {
                let references = verdict.feed.references.unwrap();
                assert!(
                    references.learnt && references.due_in > 0 && references.count == 6,
                    "{references:?}"
                );
            }
            60 => {
                assert_eq!(verdict.state, ToolState::Good, "{:?}", verdict.reasons);
                assert_eq!(verdict.level.unwrap().decides, Some(LevelBasis::ReferenceCycles));
                assert!(says(&verdict, "decided_by_reference_cycles") && verdict.feed.masked.is_none());
            }
            _ => {}
        }
        if verdict.state == ToolState::Worn {
            worn_at = Some(k);
            break;
        }
    }
    assert!(worn_at.is_some_and(|k| (170..=230).contains(&k)), "the limit is reached at 200: {worn_at:?}");
    let verdict = life.fold.verdict();
    assert!(verdict.feed.masked_cycles > 0 && verdict.feed.masked_cycles < 60, "{:?}", verdict.feed);
}

#[test]
fn references_that_nobody_runs_any_more_stop_deciding() {
    let mut life = Life::new(Some(10));
    for _ in 0..60 {
        let due = life.due();
        let (strategy, feed) =
            if due { (Strategy::FConst, REFERENCE_MM_MIN) } else { (Strategy::FAc, 350.0) };
        life.with(Some(strategy), &hole(|_| feed, 0.0), |cycle| cycle.digest = None);
    }
    assert_eq!(life.fold.verdict().state, ToolState::Good);
    // The machine ignores what it is asked for.
    let mut last = life.fold.verdict();
    for _ in 0..20 {
        last = life.with(Some(Strategy::FAc), &hole(|_| 350.0, 0.0), |cycle| cycle.digest = None);
    }
    assert_eq!(last.feed.masked, Some(Masked::ByControl), "{last:?}");
    assert!(says(&last, "masked_by_control") && last.level.unwrap().decides.is_none());
    assert!(life.due());
}

#[test]
fn a_program_far_from_the_reference_feed_is_masked_and_not_called_good_when_it_may_be_worn() {
    let mut life = Life::new(None);
    for _ in 0..6 {
        life.run(Some(Strategy::FLin), &hole(|depth| 250.0 + 30.0 * depth, 0.0));
    }
    for k in 0..80 {
        life.run(Some(Strategy::FLin), &hole(|depth| 250.0 + 30.0 * depth, 0.001 * f64::from(k)));
    }
    let verdict = life.fold.verdict();
    assert_eq!(
        (verdict.state, verdict.feed.masked),
        (ToolState::Unknown, Some(Masked::ByFeed)),
        "{verdict:?}"
    );
    assert_eq!(verdict.level.unwrap().decides, None);
    let carried = verdict.feed.at_reference_feed.unwrap();
    assert!((carried.value - 1.08).abs() < 2.0 * carried.sd, "{carried:?}");
    assert!(verdict.level.unwrap().as_run < 1.06, "what the energy as run would have called good");
}

#[test]
fn a_reference_cycle_is_known_by_its_strategy_or_by_the_advice_that_it_followed() {
    let constant = hole(|_| REFERENCE_MM_MIN, 0.0);
    let fast = hole(|depth| 250.0 + 30.0 * depth, 0.0);
    let cycle =
        |strategy, profile, asked| CycleFacts { asked_as_reference: asked, ..facts(1, strategy, profile) };
    assert!(cycle(Some(Strategy::FConst), &constant, false).is_reference());
    assert!(cycle(None, &constant, true).is_reference());
    assert!(
        cycle(Some(Strategy::FLin), &constant, true).is_reference(),
        "what ran counts, not the program's name"
    );
    assert!(!cycle(None, &constant, false).is_reference(), "nobody asked for it");
    assert!(!cycle(Some(Strategy::FAc), &fast, true).is_reference(), "the advice was named and not followed");
    let reported = CycleFacts { digest: None, ..cycle(Some(Strategy::FAc), &fast, true) };
    assert!(!reported.is_reference(), "nothing shows that it was followed");
}

#[test]
fn a_new_life_begins_with_reference_cycles_where_the_last_one_needed_them() {
    let mut life = Life::new(Some(10));
    life.run(Some(Strategy::FAc), &hole(|_| 350.0, 0.0));
    assert!(life.due());
    life.fold.event(ToolEventKind::Changed, TOLD);
    let references = life.fold.verdict().feed.references.unwrap();
    assert_eq!((references.due_in, references.learnt, references.count), (0, false, 0));
    life.settings.wear.reference_every_cycles = None;
    life.run(Some(Strategy::FAc), &hole(|_| 350.0, 0.0));
    assert_eq!(life.fold.verdict().feed.references, None, "switched off");
}

#[test]
fn other_processes_are_judged_as_they_were_run() {
    let mut life = Life::new(Some(10));
    life.settings.is_friction = false;
    for k in 0..20 {
        life.run(Some(Strategy::FAc), &hole(|_| 350.0, 0.001 * f64::from(k)));
    }
    let verdict = life.fold.verdict();
    assert_eq!(verdict.level.unwrap().decides, Some(LevelBasis::AsRun));
    assert_eq!((verdict.feed.references, verdict.feed.at_own_feed), (None, None));
}

#[test]
fn a_longer_cycle_or_a_moved_edge_under_a_law_is_a_reason_to_measure() {
    for (time, edge, code) in [(1.08, 0.0, "cycle_time_risen"), (1.0, 1.2, "fall_shifted")] {
        let mut life = Life::new(None);
        let told = |life: &mut Life, time: f64, edge: f64| {
            life.with(Some(Strategy::FAc), &hole(|_| 350.0, 0.0), |cycle| {
                cycle.digest = None;
                cycle.duration_ms = cycle.duration_ms.map(|usual| usual * time);
                cycle.fall_depth_mm = Some(12.0 + edge);
            })
        };
        for _ in 0..10 {
            assert_ne!(told(&mut life, 1.0, 0.0).state, ToolState::Unknown);
        }
        let mut last = life.fold.verdict();
        for _ in 0..8 {
            last = told(&mut life, time, edge);
        }
        assert_eq!(last.state, ToolState::Unknown, "{code}: {:?}", last.reasons);
        assert!(says(&last, code) && last.indicators.masked_by_control, "{:?}", last.reasons);
    }
}

/// Any cycle that a shop with several strategies may send.
fn any_cycle() -> impl proptest::strategy::Strategy<Value = CycleFacts> {
    (
        0..6_usize,
        60.0..600.0_f64,
        0.0..0.3_f64,
        prop_oneof![8 => Just(1.0), 1 => -0.2..0.4, 1 => 0.7..1.4],
        any::<bool>(),
        any::<bool>(),
    )
        .prop_map(|(strategy, feed, drag, factor, asked, sampled)| {
            let strategy = Strategy::ALL.get(strategy).copied();
            let profile = hole(|depth| feed * (1.0 + 0.03 * depth), drag);
            let mut cycle = facts(0, strategy, &profile);
            cycle.energy = Some((EnergyBasis::Calibrated, false, factor * profile.total()));
            cycle.asked_as_reference = asked;
            if !sampled {
                cycle.digest = None;
            }
            cycle
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// A state that was stored and read back goes on as if it had never been away, to the bit, and whatever is sent,
    /// every figure of the verdict is finite and every share within its bounds.
    #[test]
    fn stored_states_go_on_to_the_bit_and_every_figure_is_finite(
        cycles in prop::collection::vec(any_cycle(), 1..80),
        every in prop::option::of(2_u32..20),
        event in prop::option::of((0..80_usize, 0..6_usize)),
    ) {
        let settings = settings(every);
        let (mut whole, mut stored) = (ToolFold::default(), ToolFold::default());
        for (k, mut cycle) in cycles.into_iter().enumerate() {
            if let Some((at, kind)) = event && at == k {
                whole.event(ToolEventKind::ALL[kind], TOLD);
                stored.event(ToolEventKind::ALL[kind], TOLD);
            }
            cycle.order.cycle = CycleId::try_from(format!("c{k}").as_str()).unwrap();
            whole.cycle(&cycle, Some(&settings));
            stored.cycle(&cycle, Some(&settings));
            stored = ToolFold::from_bytes(&stored.to_bytes()).unwrap();
            let verdict = whole.verdict();
            prop_assert_eq!(&stored.verdict(), &verdict);
            let estimates = [verdict.feed.at_own_feed, verdict.feed.at_reference_feed, verdict.feed.by_references];
            for estimate in estimates.into_iter().flatten() {
                prop_assert!(estimate.value.is_finite() && estimate.sd >= 0.0 && estimate.sd.is_finite());
            }
            if let Some(level) = verdict.level {
                prop_assert!(level.value.is_finite() && level.sd.is_none_or(f64::is_finite));
            }
            prop_assert!(verdict.feed.masked_cycles <= verdict.cycles);
            if let Some(references) = verdict.feed.references {
                prop_assert!(references.due_in <= u64::from(references.every));
            }
        }
        prop_assert_eq!(&stored, &whole);
    }
}

//! The life of tools as stories.

use super::*;
use crate::cycle::{Flag, Flags};
use crate::ids::{CycleId, MachineId, OperationId};
use crate::operation::WearSettings;
use crate::summary::EnergyBasis;
use crate::tool::ToolEventKind;
use crate::units::{Strategy as FeedStrategy, Timestamp};
use proptest::prelude::*;

const NEW: f64 = 1992.0;

/// When events are told that begin no story of time.
const TOLD: Timestamp = Timestamp::from_micros(0);

fn settings() -> FoldSettings {
    FoldSettings {
        wear: WearSettings::default(),
        depth_mm: None,
        spindle_speed_rpm: None,
        is_friction: true,
        reference_feed_mm_min: None,
    }
}

fn facts(number: u32, joules: f64) -> CycleFacts {
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
        strategy: Some(FeedStrategy::FConst),
        law_version: None,
        profile: None,
        energy: Some((EnergyBasis::Dynamometer, false, joules)),
        energy_scale: 0,
        duration_ms: Some(4280.0),
        max_depth_mm: None,
        fall_depth_mm: None,
        operator_override_percent: None,
        digest: None,
        asked_as_reference: false,
        coverage: 1.0,
        flags: Flags::NONE,
    }
}

/// A tool's history in the making.
struct Life {
    fold: ToolFold,
    number: u32,
}

impl Life {
    fn new() -> Self {
        Self { fold: ToolFold::default(), number: 0 }
    }

    fn with(&mut self, change: impl FnOnce(&mut CycleFacts)) -> Verdict {
        self.number += 1;
        let mut cycle = facts(self.number, NEW);
        change(&mut cycle);
        self.fold.cycle(&cycle, Some(&settings()));
        self.fold.verdict()
    }

    fn ratio(&mut self, ratio: f64) -> Verdict {
        self.with(|cycle| cycle.energy = Some((EnergyBasis::Dynamometer, false, ratio * NEW)))
    }

    fn ratios(&mut self, ratios: &[f64]) -> Verdict {
        ratios.iter().map(|ratio| self.ratio(*ratio)).last().unwrap()
    }

    /// Five cycles of a new tool: learnt.
    fn learnt() -> Self {
        let mut life = Self::new();
        let verdict = life.ratios(&[1.0, 1.01, 0.99, 1.0, 1.0]);
        assert_eq!(verdict.state, ToolState::Good);
        life
    }
}

fn why(verdict: &Verdict) -> Vec<&'static str> {
    verdict.reasons.iter().map(|(code, _)| *code).collect()
}

fn excluded(verdict: &Verdict, why: Exclusion) -> u64 {
    verdict.excluded[why as usize]
}

#[test]
fn a_new_tool_is_learnt_then_good_then_warned_of_then_worn_for_good() {
    let mut life = Life::new();
    for n in 1..5 {
        let verdict = life.ratio(1.0);
        assert_eq!((verdict.state, verdict.level), (ToolState::Learning, None));
        assert_eq!(verdict.baselines[0].learnt_from, n);
    }
    let verdict = life.ratio(1.0);
    assert_eq!(verdict.state, ToolState::Good);
    assert_eq!(verdict.baselines[0].baseline_joules, Some(NEW));
    // The paper's worn tool, +9.3 %, reads "warning" (Stryczek & Błaszczak 2020, 1992 J and 2178 J).
    let verdict = life.ratios(&[2178.0 / 1992.0; 5]);
    assert_eq!(verdict.state, ToolState::Warning);
    assert!((verdict.level.unwrap().as_run - 1.0934).abs() < 1e-4);
    assert_eq!(life.ratios(&[1.06; 3]).state, ToolState::Warning, "held until below 1.05");
    assert_eq!(life.ratios(&[1.049; 3]).state, ToolState::Good);
    assert_eq!(life.ratios(&[1.07; 3]).state, ToolState::Warning, "at the limit is over it");
    assert_eq!(life.ratios(&[1.1; 3]).state, ToolState::Worn, "at the limit is over it");
    assert_eq!(life.ratios(&[1.0; 10]).state, ToolState::Worn, "latched");
    life.fold.event(ToolEventKind::Reground, TOLD);
    let verdict = life.ratios(&[1.05; 5]);
    assert_eq!((verdict.state, verdict.life), (ToolState::Good, 2));
    assert!((verdict.level.unwrap().as_run - 1.0).abs() < 1e-12, "a regrind has a baseline of its own");
}

#[test]
fn one_bad_cycle_is_no_verdict() {
    let mut life = Life::learnt();
    for ratio in [1.3, 1.0, 1.0, 0.99, 1.0, 1.0, 1.0, 1.4] {
        assert_eq!(life.ratio(ratio).state, ToolState::Good);
    }
}

#[test]
fn air_cuts_spoil_no_baseline_even_as_first_and_second_hole() {
    for order in [[0.1, 1.0, 1.0], [1.0, 0.1, 1.0], [0.1, 0.1, 1.0], [0.0, 1.0, -0.01]] {
        let mut life = Life::new();
        life.ratios(&order);
        let verdict = life.ratios(&[1.0, 1.01, 0.99, 1.0]);
        assert_eq!(verdict.state, ToolState::Good, "{order:?}: {verdict:?}");
        let baseline = verdict.baselines[0].baseline_joules.unwrap();
        assert!((baseline / NEW - 1.0).abs() < 0.01, "{order:?}: {baseline}");
        let air = order.iter().filter(|ratio| **ratio < 0.5).count() as u64;
        assert_eq!(excluded(&verdict, Exclusion::AirCut), air, "{order:?}");
        assert_eq!(verdict.counted + air, verdict.cycles, "{order:?}");
    }
}

#[test]
fn aborted_and_incomplete_cycles_are_neither_baselined_nor_counted() {
    let mut life = Life::new();
    life.with(|cycle| {
        cycle.flags.insert(Flag::Aborted);
        cycle.energy = Some((EnergyBasis::Dynamometer, false, 0.3 * NEW));
    });
    life.with(|cycle| {
        cycle.duration_ms = Some(2000.0);
        cycle.energy = Some((EnergyBasis::Dynamometer, false, 0.45 * NEW));
    });
    let verdict = life.ratios(&[1.0; 5]);
    assert_eq!(verdict.state, ToolState::Good);
    assert_eq!(verdict.baselines[0].baseline_joules, Some(NEW));
    assert_eq!((excluded(&verdict, Exclusion::Aborted), excluded(&verdict, Exclusion::Incomplete)), (1, 1));
    // Later a single one in between is left out too, and said so by name.
    life.with(|cycle| {
        cycle.duration_ms = Some(3300.0);
        cycle.energy = Some((EnergyBasis::Dynamometer, false, 0.75 * NEW));
    });
    let verdict = life.ratio(1.0);
    assert_eq!(excluded(&verdict, Exclusion::Incomplete), 2);
    let (_, cycle, reason) = verdict.last_excluded.last().unwrap();
    assert_eq!((cycle.as_str(), *reason), ("c8", Exclusion::Incomplete));
}

#[test]
fn cycles_that_the_server_cut_short_are_neither_baselined_nor_counted() {
    // A little less energy than a whole one, and the time and depth of one: nothing else tells them apart.
    let cut = |cycle: &mut CycleFacts| {
        cycle.flags.insert(Flag::Incomplete);
        cycle.flags.insert(Flag::CutShort);
        cycle.energy = Some((EnergyBasis::Dynamometer, false, 0.9 * NEW));
    };
    let mut life = Life::new();
    (0..2).for_each(|_| drop(life.with(cut)));
    let verdict = life.ratios(&[1.0; 5]);
    assert_eq!((verdict.state, verdict.counted), (ToolState::Good, 5), "{verdict:?}");
    assert_eq!(verdict.baselines[0].baseline_joules, Some(NEW));
    assert_eq!((excluded(&verdict, Exclusion::CutShort), excluded(&verdict, Exclusion::Incomplete)), (2, 0));
    let level = verdict.level;
    let verdict = life.with(cut);
    assert_eq!((verdict.level, verdict.counted, verdict.age_cycles), (level, 5, 1));
    let (_, cycle, reason) = verdict.last_excluded.last().unwrap();
    assert_eq!((cycle.as_str(), *reason), ("c8", Exclusion::CutShort));
    // A tool whose cycles are all cut from now on is no good tool, and why is said.
    for _ in 0..20 {
        life.with(cut);
    }
    let verdict = life.fold.verdict();
    assert_eq!((verdict.state, why(&verdict)), (ToolState::Unknown, vec!["level_outdated"]));
    assert!(verdict.reasons[0].1.contains("cut it short"), "{:?}", verdict.reasons);

    // Flagged incomplete alone: the operation asked for more when it came in, and whether it still does is asked again.
    let mut shallow = Life::learnt();
    let verdict = shallow.with(|cycle| cycle.flags.insert(Flag::Incomplete));
    assert_eq!((verdict.state, verdict.counted), (ToolState::Good, 6));
    // Aborted by its machine is what it is told as, cut or not.
    let verdict = shallow.with(|cycle| {
        cut(cycle);
        cycle.flags.insert(Flag::Aborted);
    });
    assert_eq!((excluded(&verdict, Exclusion::Aborted), excluded(&verdict, Exclusion::CutShort)), (1, 0));
}

#[test]
fn a_tool_whose_cycles_are_all_cut_short_is_unknown_and_not_new_afterwards() {
    let mut life = Life::new();
    for _ in 0..10 {
        let verdict = life.with(|cycle| cycle.flags.insert(Flag::CutShort));
        assert_eq!((verdict.state, why(&verdict)), (ToolState::Unknown, vec!["cut_short"]));
        assert_eq!((verdict.level, verdict.counted), (None, 0));
    }
    let mut fold = ToolFold::default();
    let mut cycle = facts(1, NEW);
    cycle.flags.insert(Flag::CutShort);
    fold.cycle(&cycle, None);
    assert_eq!(why(&fold.verdict()), ["cut_short"], "registering its operation would not make it count");
    // They wore it all the same: the first whole cycles are no new tool's.
    assert!(why(&life.ratios(&[1.0; 6])).contains(&"no_new_tool_baseline"));
}

#[test]
fn an_undercut_after_good_cycles_is_suspected_until_a_normal_one_follows() {
    let mut life = Life::learnt();
    let verdict = life.ratio(0.1);
    assert_eq!(verdict.state, ToolState::BrokenSuspected);
    assert_eq!(excluded(&verdict, Exclusion::BrokenSuspected), 1);
    let verdict = life.ratio(1.0);
    assert_eq!(verdict.state, ToolState::Good);
    assert_eq!(
        (excluded(&verdict, Exclusion::BrokenSuspected), excluded(&verdict, Exclusion::AirCut)),
        (0, 1)
    );
    assert_eq!(verdict.last_excluded.last().unwrap().2, Exclusion::AirCut);
    assert_eq!(
        life.ratios(&[0.1; 100]).state,
        ToolState::BrokenSuspected,
        "and stays so while nothing is cut"
    );
    let verdict = life.ratio(1.0);
    assert_eq!((verdict.state, excluded(&verdict, Exclusion::AirCut)), (ToolState::Good, 101));
    // While learning, two good cycles are enough to suspect.
    let mut young = Life::new();
    young.ratios(&[1.0, 1.0]);
    assert_eq!(young.ratio(0.1).state, ToolState::BrokenSuspected);
    assert_eq!(young.ratio(1.0).state, ToolState::Learning);
}

/// A cycle of that ratio under another baseline key.
fn elsewhere(life: &mut Life, ratio: f64, law: &str) -> Verdict {
    life.with(|cycle| {
        cycle.law_version = Some(law.to_owned());
        cycle.energy = Some((EnergyBasis::Dynamometer, false, ratio * NEW));
    })
}

#[test]
fn what_is_usual_of_a_key_met_since_does_not_clear_a_broken_tool() {
    let mut life = Life::learnt();
    (0..5).for_each(|_| drop(elsewhere(&mut life, 1.0, "known")));
    life.ratio(1.0);
    life.ratios(&[0.02; 3]);
    let states: Vec<ToolState> = (0..12).map(|_| elsewhere(&mut life, 0.02, "new").state).collect();
    assert_eq!(states, [ToolState::BrokenSuspected; 12], "what a broken tool takes is as usual for it");
    // One that was known before tells.
    let verdict = elsewhere(&mut life, 1.0, "known");
    assert_eq!((verdict.state, excluded(&verdict, Exclusion::AirCut)), (ToolState::Good, 3));
    // So does whoever has looked at the tool.
    assert_eq!(life.ratio(0.02).state, ToolState::BrokenSuspected);
    life.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    assert_eq!(life.fold.verdict().state, ToolState::Good);
}

#[test]
fn a_key_that_is_met_or_learnt_anew_after_the_last_usual_cycle_clears_no_broken_tool() {
    // It broke before the first undercut was seen: what was met in between is a broken tool's.
    let mut between = Life::learnt();
    (0..2).for_each(|_| drop(elsewhere(&mut between, 0.05, "new")));
    between.ratios(&[0.05; 2]);
    assert_eq!(elsewhere(&mut between, 0.05, "new").state, ToolState::BrokenSuspected);
    // What a key had learnt is forgotten with its baseline.
    let mut anew = Life::learnt();
    (0..8).for_each(|_| drop(elsewhere(&mut anew, 1.0, "other")));
    anew.ratios(&[1.3; 4]);
    anew.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    assert_eq!(elsewhere(&mut anew, 0.05, "other").state, ToolState::BrokenSuspected);
    assert_eq!(anew.ratios(&[0.05; 8]).state, ToolState::BrokenSuspected);
}

#[test]
fn a_confirmed_step_is_none_to_hardly_anything() {
    let mut life = Life::learnt();
    life.ratios(&[1.3; 4]);
    life.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    assert_eq!(life.ratios(&[0.05; 12]).state, ToolState::BrokenSuspected);
    assert_eq!(life.ratios(&[1.3; 6]).state, ToolState::Good, "it was air");
    // A key that was learnt by a broken tool alone vouches for nothing, also once it is complete.
    let mut broken = Life::learnt();
    (0..7).for_each(|_| drop(elsewhere(&mut broken, 0.05, "new")));
    broken.ratios(&[0.05; 2]);
    assert_eq!(elsewhere(&mut broken, 0.05, "new").state, ToolState::BrokenSuspected);
    // One that had been known before a step was announced does, once its cycles agree again.
    let mut announced = Life::learnt();
    announced.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    announced.ratio(0.05);
    assert_eq!(announced.ratios(&[1.3; 10]).state, ToolState::Good);
}

#[test]
fn wear_between_the_cycles_that_a_key_is_learnt_from_is_carried_over() {
    let mut life = Life::learnt();
    elsewhere(&mut life, 1.0, "seldom");
    for k in 1..=18 {
        life.ratio(1.0 + 0.005 * f64::from(k));
    }
    assert_eq!(life.ratios(&[1.09; 5]).state, ToolState::Warning);
    let states: Vec<ToolState> = (0..8).map(|_| elsewhere(&mut life, 1.09, "seldom").state).collect();
    let verdict = life.fold.verdict();
    assert_eq!(verdict.state, ToolState::Warning, "{states:?} {:?}", verdict.level);
    assert!((verdict.level.unwrap().as_run - 1.09).abs() < 0.01, "{:?}", verdict.level);
}

#[test]
fn confirmed_conditions_carry_the_wear_of_when_they_are_run() {
    let mut life = Life::learnt();
    (0..8).for_each(|_| drop(elsewhere(&mut life, 1.0, "other")));
    life.ratios(&[1.3; 4]);
    life.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    // It wears elsewhere before the confirmed conditions are run again.
    for k in 1..=16 {
        elsewhere(&mut life, 1.0 + 0.005 * f64::from(k), "other");
    }
    assert_eq!(life.fold.verdict().state, ToolState::Warning);
    let verdict = life.ratios(&[1.3 * 1.08; 12]);
    assert_eq!(verdict.state, ToolState::Warning, "{:?}", verdict.level);
    assert!(verdict.level.unwrap().as_run > 1.05, "{:?}", verdict.level);
}

#[test]
fn what_is_confirmed_of_a_suspected_tool_announces_no_step() {
    let mut life = Life::learnt();
    life.ratios(&[0.05; 2]);
    life.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    assert_eq!(life.fold.verdict().state, ToolState::Good);
    assert_eq!(life.ratios(&[1.4; 4]).state, ToolState::Changed);
    // An announcement holds for what the tool ran before, whatever it is learning now.
    let mut told = Life::learnt();
    elsewhere(&mut told, 1.0, "other");
    told.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    assert_ne!(told.ratios(&[1.4; 4]).state, ToolState::Changed);
}

#[test]
fn changed_conditions_are_not_forgotten_among_many_keys() {
    let mut life = Life::learnt();
    life.ratios(&[1.3; 4]);
    for number in 0..300 {
        elsewhere(&mut life, 1.3, &format!("law {number}"));
    }
    assert_eq!(life.fold.verdict().state, ToolState::Changed);
}

#[test]
fn changed_conditions_stay_changed_whatever_the_tool_does_elsewhere() {
    let mut life = Life::learnt();
    assert_eq!(life.ratios(&[1.3; 4]).state, ToolState::Changed);
    let states: Vec<ToolState> = (0..8).map(|_| elsewhere(&mut life, 1.3, "other").state).collect();
    assert_eq!(states, [ToolState::Changed; 8]);
    life.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    assert_eq!(elsewhere(&mut life, 1.3, "other").state, ToolState::Good);
}

#[test]
fn a_step_long_after_it_was_announced_or_confirmed_twice_is_alarmed() {
    let mut twice = Life::learnt();
    twice.ratios(&[1.3; 4]);
    (0..3).for_each(|_| twice.fold.event(ToolEventKind::ConditionsConfirmed, TOLD));
    twice.ratio(1.3);
    twice.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    twice.ratios(&[1.3; 8]);
    assert_eq!(twice.ratios(&[1.7; 4]).state, ToolState::Changed, "it was the first one that was confirmed");
    let mut late = Life::learnt();
    late.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    late.ratios(&[1.0; 20]);
    assert_eq!(late.ratios(&[1.3; 4]).state, ToolState::Changed, "20 cycles after it was announced");
    let mut soon = Life::learnt();
    soon.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    soon.ratios(&[1.0; 15]);
    assert_ne!(soon.ratios(&[1.3; 4]).state, ToolState::Changed);
}

#[test]
fn a_tool_that_breaks_under_another_override_is_suspected() {
    let at = |life: &mut Life, percent: f64, ratio: f64| {
        life.with(|cycle| {
            cycle.operator_override_percent = Some(percent);
            cycle.energy = Some((EnergyBasis::Dynamometer, false, ratio * NEW));
        })
    };
    for (percent, least) in [(90.0, 0.6), (200.0, 0.3)] {
        let mut life = Life::learnt();
        let verdict = at(&mut life, percent, least + 0.01);
        assert_eq!((verdict.state, excluded(&verdict, Exclusion::OperatorOverride)), (ToolState::Good, 1));
        assert_eq!(at(&mut life, percent, least - 0.01).state, ToolState::BrokenSuspected, "{percent}");
        assert_eq!(at(&mut life, percent, 0.59).state, ToolState::BrokenSuspected, "{percent}");
        // Idling takes the longer the slower it is: twice the energy of nothing is nothing.
        assert_eq!(at(&mut life, 50.0, 0.7).state, ToolState::BrokenSuspected, "{percent}");
        // One that cut, at whatever override, clears it, and is not compared.
        let verdict = at(&mut life, percent, 0.9);
        assert_eq!(verdict.state, ToolState::Good, "{percent}");
        assert!(excluded(&verdict, Exclusion::OperatorOverride) >= 2);
    }
}

#[test]
fn only_friction_drilling_has_reference_cycles() {
    // As of a cycle that came before its operation was registered: nobody knew that it was not friction drilling.
    let mut life = Life::new();
    let drilling = FoldSettings { is_friction: false, ..settings() };
    for number in 1..=6 {
        let mut cycle = facts(number, NEW);
        cycle.strategy = None;
        cycle.flags.insert(Flag::ReferenceCycle);
        assert!(cycle.is_reference());
        life.fold.cycle(&cycle, Some(&drilling));
    }
    assert_eq!(life.fold.verdict().baselines[0].key.strategy, None);
}

#[test]
fn a_lasting_step_is_changed_conditions_neither_wear_nor_a_new_tool() {
    for step in [0.77, 1.34, 1.15, 0.85] {
        let mut life = Life::learnt();
        life.ratios(&[1.0, 1.005, 0.995, 1.0, 1.0, 1.005, 0.995]);
        let states: Vec<ToolState> = (0..10).map(|_| life.ratio(step).state).collect();
        assert_eq!(states[..2], [ToolState::Good; 2], "{step}: not yet lasting");
        assert!(states[2..].iter().all(|state| *state == ToolState::Changed), "{step}: {states:?}");
        // Coming back to the old conditions uses the old baseline.
        let verdict = life.ratios(&[1.02; 5]);
        assert_eq!(verdict.state, ToolState::Good, "{step}");
        assert!((verdict.level.unwrap().as_run - 1.02).abs() < 1e-9, "{step}");
    }
}

#[test]
fn a_lasting_step_in_cycle_time_alone_is_changed_conditions() {
    let mut life = Life::learnt();
    for _ in 0..3 {
        life.with(|cycle| cycle.duration_ms = Some(3400.0));
    }
    assert_eq!(life.fold.verdict().state, ToolState::Changed);
}

#[test]
fn confirmed_conditions_carry_the_wear_over() {
    let mut life = Life::learnt();
    life.ratios(&[1.06; 6]);
    life.ratios(&[1.06 * 0.7; 4]);
    assert_eq!(life.fold.verdict().state, ToolState::Changed);
    life.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    assert_eq!(life.ratio(1.06 * 0.7).state, ToolState::Learning);
    let verdict = life.ratios(&[1.06 * 0.7; 4]);
    assert!((verdict.level.unwrap().as_run - 1.06).abs() < 1e-9, "{verdict:?}");
    assert!(why(&verdict).contains(&"level_carried_over"));
    assert_eq!(life.ratios(&[1.11 * 0.7; 5]).state, ToolState::Worn);
}

#[test]
fn conditions_announced_before_the_step_are_not_alarmed() {
    let mut life = Life::learnt();
    life.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    let states: Vec<ToolState> = (0..8).map(|_| life.ratio(1.34).state).collect();
    assert!(!states.contains(&ToolState::Changed) && !states.contains(&ToolState::Worn), "{states:?}");
    assert_eq!(states[7], ToolState::Good);
}

#[test]
fn conditions_that_alternate_are_not_taken_for_wear() {
    let mut life = Life::learnt();
    let states: Vec<ToolState> =
        (0..20).map(|k| life.ratio(if k % 2 == 0 { 1.34 } else { 1.0 }).state).collect();
    assert!(!states.contains(&ToolState::Worn) && !states.contains(&ToolState::Warning), "{states:?}");
    assert_eq!(*states.last().unwrap(), ToolState::Changed);
}

#[test]
fn wear_that_runs_away_is_worn_and_no_step() {
    let mut life = Life::learnt();
    let verdict = life.ratios(&[1.2, 1.5, 1.9, 2.4, 3.0]);
    assert_eq!(verdict.state, ToolState::Worn);
    let mut fast = Life::learnt();
    let states: Vec<ToolState> = (1..=12).map(|k| fast.ratio(1.0 + 0.03 * f64::from(k)).state).collect();
    assert!(!states.contains(&ToolState::Changed), "{states:?}");
    assert_eq!(*states.last().unwrap(), ToolState::Worn);
}

#[test]
fn another_key_met_in_mid_life_carries_the_wear_and_coming_back_uses_the_old_baseline() {
    let mut life = Life::learnt();
    life.ratios(&[1.06; 5]);
    let slow = |life: &mut Life, joules: f64| {
        life.with(|cycle| {
            cycle.spindle_speed_rpm = Some(1800.0);
            cycle.energy = Some((EnergyBasis::Dynamometer, false, joules));
        })
    };
    assert_eq!(slow(&mut life, 1500.0).state, ToolState::Learning);
    for _ in 0..4 {
        slow(&mut life, 1500.0);
    }
    let verdict = life.fold.verdict();
    // A speed changed in mid-life is not called good on a level that was only carried over.
    assert_eq!((verdict.state, why(&verdict).last().copied()), (ToolState::Changed, Some("speed_changed")));
    let mut confirmed = Life { fold: life.fold.clone(), number: life.number };
    confirmed.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    assert_eq!(slow(&mut confirmed, 1500.0).state, ToolState::Good);
    let mut announced = Life::learnt();
    announced.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    let states: Vec<ToolState> = (0..6).map(|_| slow(&mut announced, 1500.0).state).collect();
    assert_eq!(states[5], ToolState::Good, "{states:?}");
    assert!((verdict.level.unwrap().as_run - 1.06).abs() < 1e-9);
    for _ in 0..5 {
        slow(&mut life, 1500.0 * 1.05);
    }
    let verdict = life.fold.verdict();
    assert_eq!(verdict.state, ToolState::Worn, "1.06 carried over times 1.05: {:?}", verdict.level);
    let mut back = Life::learnt();
    for _ in 0..7 {
        slow(&mut back, 1500.0);
    }
    let verdict = back.ratios(&[1.08; 5]);
    assert_eq!((verdict.state, verdict.baselines.len()), (ToolState::Warning, 2));
}

#[test]
fn speeds_within_two_percent_share_a_key() {
    let mut life = Life::new();
    for (k, speed) in [2500.0, 2549.0, 2451.0, 2500.0, 2510.0].into_iter().enumerate() {
        let verdict = life.with(|cycle| cycle.spindle_speed_rpm = Some(speed));
        assert_eq!(verdict.baselines.len(), 1, "{k}");
    }
    assert_eq!(life.with(|cycle| cycle.spindle_speed_rpm = Some(2551.0)).baselines.len(), 2);
}

#[test]
fn bases_are_never_mixed() {
    let mut life = Life::learnt();
    let verdict = life.with(|cycle| cycle.energy = Some((EnergyBasis::RatedPower, false, 9000.0)));
    assert_eq!((verdict.state, verdict.baselines.len()), (ToolState::Learning, 2));
    assert!((verdict.level.unwrap().as_run - 1.0).abs() < 1e-12);
}

#[test]
fn cycles_at_another_operator_override_are_not_compared() {
    let mut life = Life::learnt();
    for _ in 0..6 {
        life.with(|cycle| {
            cycle.operator_override_percent = Some(94.0);
            cycle.energy = Some((EnergyBasis::Dynamometer, false, 1.3 * NEW));
        });
    }
    let verdict = life.fold.verdict();
    assert_eq!((verdict.state, excluded(&verdict, Exclusion::OperatorOverride)), (ToolState::Good, 6));
    assert_eq!(verdict.age_cycles, 6);
    let verdict = life.with(|cycle| cycle.operator_override_percent = Some(95.0));
    assert_eq!(verdict.age_cycles, 0, "5 points apart are compared");
}

#[test]
fn a_tool_that_starts_worn_has_no_new_tool_baseline() {
    let mut life = Life::new();
    life.fold.event(ToolEventKind::MountedUsed, TOLD);
    let verdict = life.ratios(&[1.0; 8]);
    assert_eq!((verdict.state, verdict.level, verdict.remaining), (ToolState::Unknown, None, None));
    assert!(why(&verdict).contains(&"no_new_tool_baseline"));
    // Ten percent above what was already used is worn all the same.
    assert_eq!(life.ratios(&[1.11; 4]).state, ToolState::Worn);
    // So is a tool that worked unmeasured for long.
    let mut late = Life::new();
    for _ in 0..10 {
        late.with(|cycle| cycle.energy = None);
    }
    assert_eq!(late.fold.verdict().state, ToolState::Unknown);
    assert_eq!(why(&late.fold.verdict()), ["no_energy"]);
    assert!(why(&late.ratios(&[1.0; 6])).contains(&"no_new_tool_baseline"));
}

#[test]
fn cycles_before_the_tool_was_mounted_have_a_wrong_clock() {
    let mut fold = ToolFold::awaiting_mount();
    (1..=6).for_each(|k| fold.cycle(&facts(k, NEW), Some(&settings())));
    let verdict = fold.verdict();
    assert_eq!((verdict.state, excluded(&verdict, Exclusion::ClockSuspect)), (ToolState::Unknown, 6));
    fold.event(ToolEventKind::MountedNew, TOLD);
    (7..=11).for_each(|k| fold.cycle(&facts(k, NEW), Some(&settings())));
    let verdict = fold.verdict();
    assert_eq!((verdict.state, verdict.life, verdict.cycles), (ToolState::Good, 1, 5));
}

#[test]
fn a_level_that_no_cycle_confirms_is_outdated() {
    let mut life = Life::learnt();
    for _ in 0..21 {
        life.with(|cycle| cycle.energy = None);
    }
    let verdict = life.fold.verdict();
    assert_eq!((verdict.state, verdict.age_cycles), (ToolState::Unknown, 21));
    assert!(why(&verdict).contains(&"level_outdated"));
}

/// Cycles that cannot be compared, as their loads are missing.
fn unmeasured(life: &mut Life, cycles: u32) -> Verdict {
    (0..cycles).map(|_| life.with(|cycle| cycle.energy = None)).last().unwrap()
}

#[test]
fn a_level_that_nobody_knows_any_more_is_not_carried_over_as_one_that_is_known() {
    let elsewhere = |life: &mut Life, cycles: u32| {
        let run = |life: &mut Life| life.with(|cycle| cycle.operation = OperationId::try_from("O2").unwrap());
        (0..cycles).map(|_| run(life)).last().unwrap()
    };
    let mut life = Life::learnt();
    unmeasured(&mut life, 300);
    let verdict = elsewhere(&mut life, 2);
    assert_eq!((verdict.state, why(&verdict).last().copied()), (ToolState::Unknown, Some("level_outdated")));
    let verdict = elsewhere(&mut life, 6);
    assert_eq!(
        (verdict.state, why(&verdict).last().copied()),
        (ToolState::Changed, Some("level_unconfirmed"))
    );
    let kept = ToolFold::from_bytes(&life.fold.to_bytes()).unwrap();
    assert_eq!(kept.verdict(), verdict, "as it is stored");
    // Nor does anything else that is run then, whatever was learnt in between.
    for operation in 3..12 {
        let operation = OperationId::try_from(format!("O{operation}").as_str()).unwrap();
        for _ in 0..6 {
            let mut run = Life { fold: life.fold.clone(), number: life.number };
            let verdict = run.with(|cycle| cycle.operation = operation.clone());
            life = run;
            assert!(
                matches!(verdict.state, ToolState::Unknown | ToolState::Changed),
                "{operation}: {verdict:?}"
            );
        }
    }
    // What is above even that level is worn for certain.
    let mut worn = Life { fold: life.fold.clone(), number: life.number };
    for _ in 0..5 {
        worn.with(|cycle| {
            cycle.operation = OperationId::try_from("O2").unwrap();
            cycle.energy = Some((EnergyBasis::Dynamometer, false, 1.11 * NEW));
        });
    }
    assert_eq!(worn.fold.verdict().state, ToolState::Worn);
    // Beside them the baseline of before still tells, however seldom it runs.
    let mut seldom = Life { fold: life.fold.clone(), number: life.number };
    let states: Vec<ToolState> = (0..30)
        .map(|n| if n % 3 == 0 { seldom.ratio(1.11).state } else { elsewhere(&mut seldom, 1).state })
        .collect();
    // With three of the window's five from now on.
    assert_eq!(states[6..], [ToolState::Worn; 24], "{states:?}");
    // The baseline of before says how worn the tool is, wherever it comes from.
    assert_eq!(life.ratios(&[1.08; 5]).state, ToolState::Warning);
    assert_eq!(life.ratios(&[1.0; 5]).state, ToolState::Good);
    assert_eq!(
        elsewhere(&mut life, 1).state,
        ToolState::Changed,
        "of this baseline nobody knows all the same"
    );
    life.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    assert_eq!(elsewhere(&mut life, 1).state, ToolState::Good);

    // Others that are learnt meanwhile, one after the other, are no gap.
    let mut many = Life::learnt();
    for round in 0..5 {
        for operation in 2..40 {
            let operation = OperationId::try_from(format!("O{operation}").as_str()).unwrap();
            let verdict = many.with(|cycle| cycle.operation = operation);
            assert!(matches!(verdict.state, ToolState::Learning | ToolState::Good), "{round}: {verdict:?}");
        }
    }
    let mut told = Life::learnt();
    unmeasured(&mut told, 300);
    told.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    assert_eq!(elsewhere(&mut told, 6).state, ToolState::Good, "confirmed beforehand");
}

#[test]
fn after_long_unmeasured_work_the_window_of_before_calls_no_tool_good_that_may_be_worn() {
    let mut life = Life::learnt();
    life.ratios(&[1.02; 5]);
    unmeasured(&mut life, 300);
    for have in 1..=4 {
        let verdict = life.ratio(1.12);
        if have < 3 {
            let last = verdict.reasons.last().unwrap();
            assert_eq!((verdict.state, last.0), (ToolState::Unknown, "level_outdated"), "{have}");
            assert!(last.1.contains(&format!("+12.0 %: {have} of 3 cycles")), "{}", last.1);
        } else {
            assert_eq!(verdict.state, ToolState::Worn, "the window's median is of after: {have}");
        }
        let kept = ToolFold::from_bytes(&life.fold.to_bytes()).unwrap();
        assert_eq!((kept.verdict(), &kept), (verdict, &life.fold), "as it is stored");
    }

    // Where it is as it was, each cycle says so, and one that scatters leaves nothing open.
    let mut same = Life::learnt();
    unmeasured(&mut same, 300);
    let states: Vec<_> = [1.01, 1.08, 1.01, 1.02].into_iter().map(|ratio| same.ratio(ratio).state).collect();
    assert_eq!(states, [ToolState::Good; 4]);

    // A window of any length is of before as long as most of it is.
    for window in [3, 10, 20, 50] {
        for wear in [1.08, 1.12] {
            let mut wide = Life::new();
            let settings = FoldSettings {
                wear: WearSettings { window_cycles: window, ..WearSettings::default() },
                ..settings()
            };
            let run = |life: &mut Life, ratio: Option<f64>| {
                let mut cycle = facts(life.number, ratio.unwrap_or(1.0) * NEW);
                life.number += 1;
                if ratio.is_none() {
                    cycle.energy = None;
                }
                life.fold.cycle(&cycle, Some(&settings));
                life.fold.verdict().state
            };
            for _ in 0..60 {
                run(&mut wide, Some(1.0));
            }
            assert_eq!(wide.fold.verdict().state, ToolState::Good);
            for _ in 0..400 {
                run(&mut wide, None);
            }
            let states: Vec<_> = (0..window + 5).map(|_| run(&mut wide, Some(wear))).collect();
            assert!(!states.contains(&ToolState::Good), "{window}: {states:?}");
            let clear = states.iter().position(|state| *state != ToolState::Unknown).unwrap();
            assert!(clear <= window as usize / 2, "{window}: {states:?}");
        }
    }

    // One cycle in thirty is measured: what each of them says holds until nobody knows any more.
    let mut seldom = Life::learnt();
    for _ in 0..10 {
        assert_eq!(unmeasured(&mut seldom, 29).state, ToolState::Unknown);
        assert_eq!(seldom.ratio(1.0).state, ToolState::Good);
    }
    // What is run in between carries no level over that is not known.
    let mut elsewhere = Life::learnt();
    unmeasured(&mut elsewhere, 300);
    assert_eq!(elsewhere.ratio(1.12).state, ToolState::Unknown);
    let other = |cycle: &mut CycleFacts| cycle.operation = OperationId::try_from("O2").unwrap();
    let verdict = (0..6).map(|_| elsewhere.with(other)).last().unwrap();
    assert_eq!(
        (verdict.state, why(&verdict).last().copied()),
        (ToolState::Changed, Some("level_unconfirmed"))
    );
    // Somebody who looked at the tool says that it is known.
    let mut told = Life::learnt();
    unmeasured(&mut told, 300);
    assert_eq!(told.ratio(1.08).state, ToolState::Unknown);
    told.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    assert_eq!(told.ratio(1.02).state, ToolState::Good);
}

#[test]
fn a_baseline_that_is_learnt_over_long_unmeasured_work_is_no_new_tools() {
    for measured in [1_u32, 2, 4] {
        let mut life = Life::new();
        life.ratios(&[1.0; 4][..measured as usize]);
        assert_eq!(unmeasured(&mut life, 20).state, ToolState::Learning, "{measured}");
        let verdict = unmeasured(&mut life, 280);
        assert_eq!(
            (verdict.state, why(&verdict).last().copied()),
            (ToolState::Unknown, Some("level_outdated"))
        );
        let verdict = life.ratios(&[1.3; 20]);
        assert_eq!((verdict.state, verdict.level.is_some()), (ToolState::Unknown, false), "{measured}");
        assert!(why(&verdict).contains(&"no_new_tool_baseline"), "{measured}: {verdict:?}");
    }
    // A few that could not be measured change nothing.
    let mut life = Life::new();
    life.ratios(&[1.0; 3]);
    unmeasured(&mut life, 10);
    assert_eq!(life.ratios(&[1.0; 3]).state, ToolState::Good);
}

#[test]
fn remaining_cycles_are_told_only_on_evidence() {
    let mut life = Life::learnt();
    assert_eq!(life.fold.verdict().remaining, None);
    let noise = |k: u32| 0.004 * (f64::from(k * 7 % 5) - 2.0) / 2.0;
    for k in 0..60 {
        life.ratio(1.0 + noise(k));
    }
    assert_eq!(life.fold.verdict().remaining, None, "a tool that does not wear has no end in sight");
    for k in 0..60 {
        life.ratio(1.0 + 0.001 * f64::from(k) + noise(k));
    }
    let verdict = life.fold.verdict();
    let remaining = verdict.remaining.unwrap();
    assert!(remaining.low <= 42 && remaining.high >= 38, "40 cycles remain: {remaining:?}");
}

#[test]
fn a_window_of_the_operation_is_obeyed() {
    let wear = WearSettings { baseline_cycles: 100, window_cycles: 100, ..WearSettings::default() };
    let wide = FoldSettings { wear, ..settings() };
    let mut fold = ToolFold::default();
    (1..=99).for_each(|k| fold.cycle(&facts(k, NEW), Some(&wide)));
    assert_eq!(fold.verdict().state, ToolState::Learning);
    fold.cycle(&facts(100, NEW), Some(&wide));
    assert_eq!(fold.verdict().level.unwrap().n, 100);
}

/// Any cycle a shop may send, from usual to absurd.
fn any_cycle() -> impl proptest::strategy::Strategy<Value = CycleFacts> {
    (
        prop_oneof![4 => 0.95..1.15, 1 => -0.1..0.5, 1 => 0.6..1.5, 1 => Just(0.0)],
        prop_oneof![6 => Just(4280.0), 1 => 1000.0..9000.0],
        prop::option::weighted(0.3, 80.0..120.0),
        0..20_u32,
        0..3_u8,
    )
        .prop_map(|(ratio, duration, operator, odd, speed)| {
            let mut cycle = facts(0, ratio * NEW);
            cycle.duration_ms = Some(duration);
            cycle.operator_override_percent = operator;
            cycle.spindle_speed_rpm = Some(2000.0 + 30.0 * f64::from(speed));
            match odd {
                0 => cycle.flags.insert(Flag::Aborted),
                1 => cycle.energy = None,
                2 => cycle.coverage = 0.5,
                3 => cycle.flags.insert(Flag::ClockSuspect),
                4 => cycle.flags.insert(Flag::CutShort),
                _ => {}
            }
            cycle
        })
}

/// Cycles that are neither counted nor left out yet.
fn held(fold: &ToolFold) -> u64 {
    let of_key = |key: &super::key::KeyState| {
        key.learning.len() + key.off.len() + key.change.as_ref().map_or(0, |change| change.back.len())
    };
    fold.keys.iter().map(of_key).sum::<usize>() as u64
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// A state that was stored and read back goes on as if it had never been away, to the bit.
    #[test]
    fn stored_states_go_on_to_the_bit(
        cycles in prop::collection::vec(any_cycle(), 1..80),
        event in prop::option::of((0..80_usize, 0..6_usize)),
    ) {
        let mut whole = ToolFold::default();
        let mut stored = ToolFold::default();
        for (k, mut cycle) in cycles.into_iter().enumerate() {
            if let Some((at, kind)) = event && at == k {
                whole.event(ToolEventKind::ALL[kind], TOLD);
                stored.event(ToolEventKind::ALL[kind], TOLD);
            }
            cycle.order.cycle = CycleId::try_from(format!("c{k}").as_str()).unwrap();
            whole.cycle(&cycle, Some(&settings()));
            stored.cycle(&cycle, Some(&settings()));
            stored = ToolFold::from_bytes(&stored.to_bytes()).unwrap();
        }
        prop_assert_eq!(&stored, &whole);
        prop_assert_eq!(stored.verdict(), whole.verdict());
    }

    /// Every cycle is counted, left out with a reason, or still held: none is lost, none is counted twice.
    #[test]
    fn every_cycle_is_accounted_for(
        cycles in prop::collection::vec((any_cycle(), prop::bool::weighted(0.1)), 1..120),
    ) {
        let mut fold = ToolFold::default();
        for (cycle, is_confirmed) in &cycles {
            if *is_confirmed {
                fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
            }
            fold.cycle(cycle, Some(&settings()));
            let verdict = fold.verdict();
            let left_out: u64 = verdict.excluded.iter().sum();
            prop_assert_eq!(verdict.counted + left_out + held(&fold), verdict.cycles);
            prop_assert!(verdict.level.is_none_or(|level| level.as_run.is_finite()));
            prop_assert!(!verdict.reasons.is_empty());
        }
    }

    /// Damaged states are refused or decoded, never a panic.
    #[test]
    fn damaged_states_do_not_panic(at in 0..2000_usize, bit in 0..8_u8, cut in 0..2000_usize) {
        let mut life = Life::learnt();
        life.ratios(&[1.02; 7]);
        let mut bytes = life.fold.to_bytes();
        let place = at % bytes.len();
        bytes[place] ^= 1 << bit;
        let _ = ToolFold::from_bytes(&bytes).map(|fold| fold.verdict().state);
        prop_assert!(ToolFold::from_bytes(&life.fold.to_bytes()[..cut % (bytes.len() - 1)]).is_none());
    }
}

#[test]
fn the_cycles_of_a_baseline_are_no_verdict_on_the_tool() {
    for first in [2250.0 / 2000.0, 2210.0 / 2000.0, 1.19] {
        let mut life = Life::new();
        let verdict = life.ratios(&[first, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
        assert_eq!(verdict.state, ToolState::Good, "{first}: {verdict:?}");
    }
    let mut noisy = Life::new();
    let verdict = noisy.ratios(&[1.12, 1.12, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
    assert_eq!(verdict.state, ToolState::Good);
}

#[test]
fn a_baseline_does_not_straddle_a_step() {
    for step in [1.32, 1.34, 0.77, 1.2] {
        for after in 1..5_usize {
            let mut life = Life::new();
            life.ratios(&vec![1.0; after]);
            let verdict = life.ratios(&[step; 9]);
            let baseline = verdict.baselines[0].baseline_joules.unwrap();
            assert!((baseline / (step * NEW) - 1.0).abs() < 1e-9, "{step} after {after}: {baseline}");
            let expected = if after > 2 { ToolState::Changed } else { ToolState::Good };
            assert_eq!(verdict.state, expected, "{step} after {after}: {verdict:?}");
        }
    }
    let mut confirmed = Life::new();
    confirmed.ratios(&[1.0, 1.0, 1.0, 1.34, 1.34, 1.34, 1.34, 1.34]);
    assert_eq!(confirmed.fold.verdict().state, ToolState::Changed);
    confirmed.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    assert_eq!(confirmed.ratio(1.34).state, ToolState::Good);
}

#[test]
fn a_tool_that_breaks_on_its_second_cycle_is_not_good() {
    let mut life = Life::new();
    let verdict = life.ratios(&[1.0, 0.075, 0.075, 0.075, 0.075, 0.075, 0.075]);
    assert_eq!(verdict.state, ToolState::Changed, "{verdict:?}");
}

/// A step among noise, in many shops: what is said is "changed", hardly ever wear, and never a new tool.
#[test]
fn steps_are_told_among_noise() {
    let mut seed = 0x1234_5678_9ABC_DEF1_u64;
    let mut noise = move || {
        // Twelve even numbers make a nearly normal one.
        let mut sum = -6.0;
        for _ in 0..12 {
            seed ^= seed << 13;
            seed ^= seed >> 7;
            seed ^= seed << 17;
            sum += (seed >> 11) as f64 / (1_u64 << 53) as f64;
        }
        sum
    };
    for (step, sigma, least) in
        [(0.77, 0.03, 95), (1.34, 0.03, 95), (1.25, 0.03, 90), (1.2, 0.02, 90), (0.8, 0.02, 90)]
    {
        let mut changed = 0;
        for _ in 0..100 {
            let mut life = Life::new();
            for _ in 0..15 {
                life.ratio(1.0 + sigma * noise());
            }
            for _ in 0..12 {
                life.ratio(step * (1.0 + sigma * noise()));
            }
            changed += u32::from(life.fold.verdict().state == ToolState::Changed);
        }
        assert!(changed >= least, "{step} at {sigma}: {changed} of 100");
    }
    // And a tool that wears slowly among the same noise is worn, not changed.
    let mut worn = 0;
    for _ in 0..100 {
        let mut life = Life::new();
        for k in 0..200 {
            life.ratio((1.0 + 0.0008 * f64::from(k)) * (1.0 + 0.02 * noise()));
        }
        worn += u32::from(life.fold.verdict().state == ToolState::Worn);
    }
    assert!(worn >= 97, "{worn} of 100");
}

#[test]
fn a_baseline_that_is_learnt_in_the_cycle_that_tells_a_step_is_no_verdict_either() {
    let mut life = Life::new();
    let settings = FoldSettings {
        wear: WearSettings { baseline_cycles: 3, window_cycles: 5, ..WearSettings::default() },
        ..settings()
    };
    let mut run = |fold: &mut ToolFold, ratios: &[f64]| {
        for ratio in ratios {
            life.number += 1;
            fold.cycle(&facts(life.number, ratio * NEW), Some(&settings));
        }
        fold.verdict()
    };
    let mut fold = ToolFold::default();
    let verdict = run(&mut fold, &[1.0, 1.0, 1.0, 1.02, 1.04, 1.06, 1.09, 1.09, 1.09, 1.12, 1.12]);
    assert_eq!(verdict.state, ToolState::Warning);
    fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    let verdict = run(&mut fold, &[1.36, 1.40, 1.47]);
    assert!(verdict.baselines[0].baseline_joules.is_some(), "learnt anew: {verdict:?}");
    assert_eq!(verdict.state, ToolState::Warning, "{verdict:?}");
}

#[test]
fn what_was_held_when_changed_conditions_are_confirmed_is_left_out_with_a_reason() {
    let mut life = Life::learnt();
    life.ratios(&[1.3, 1.3, 1.3]);
    let verdict = life.ratios(&[1.0, 1.0]);
    assert_eq!((verdict.state, held(&life.fold)), (ToolState::Changed, 2));
    life.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    let verdict = life.fold.verdict();
    assert_eq!((verdict.cycles, verdict.counted, held(&life.fold)), (10, 5, 0));
    assert_eq!(excluded(&verdict, Exclusion::ConditionsChanged), 5, "{verdict:?}");
    let named: Vec<&str> = verdict.last_excluded.iter().map(|(_, cycle, _)| cycle.as_str()).collect();
    assert_eq!(named, ["c6", "c7", "c8", "c9", "c10"]);
}

#[test]
fn what_a_key_held_that_makes_room_is_left_out_with_a_reason() {
    let mut life = Life::new();
    for law in 0..300 {
        let verdict = elsewhere(&mut life, 1.0, &format!("law-{law}"));
        let left_out: u64 = verdict.excluded.iter().sum();
        assert_eq!(verdict.counted + left_out + held(&life.fold), verdict.cycles, "{law}");
    }
}

/// A cycle whose power sensor says nothing, or the opposite.
fn without_power(cycle: &mut CycleFacts, joules: f64) {
    cycle.energy = Some((EnergyBasis::RatedPower, false, joules));
    cycle.max_depth_mm = Some(8.0);
}

#[test]
fn a_sensor_that_measures_nothing_does_not_keep_a_tool_learning() {
    for joules in [0.0, -NEW] {
        let mut life = Life::new();
        for n in 0..20 {
            let verdict = life.with(|cycle| without_power(cycle, joules));
            assert_eq!(verdict.state, ToolState::Learning, "{n}");
        }
        let verdict = life.with(|cycle| without_power(cycle, joules));
        assert_eq!((verdict.state, excluded(&verdict, Exclusion::NoEnergy)), (ToolState::Unknown, 21));
        assert!(why(&verdict).contains(&"level_outdated"), "{verdict:?}");
        // The sensor is mended: these are no new tool's first cycles.
        let mended = |cycle: &mut CycleFacts| without_power(cycle, NEW);
        (0..8).for_each(|_| drop(life.with(mended)));
        let verdict = life.fold.verdict();
        assert!(!verdict.started_unworn && verdict.level.is_none(), "{verdict:?}");
    }
    // A spindle's whole power is nothing only where nothing was measured, whether or not depth was.
    let mut drill = Life::new();
    let stuck = |cycle: &mut CycleFacts| cycle.energy = Some((EnergyBasis::MeasuredPower, false, 0.0));
    (0..21).for_each(|_| drop(drill.with(stuck)));
    assert_eq!(drill.fold.verdict().state, ToolState::Unknown);
}

#[test]
fn what_cut_air_wears_no_tool_however_often() {
    for (net, depth) in [(false, Some(0.0)), (true, None)] {
        let mut life = Life::new();
        for _ in 0..60 {
            let verdict = life.with(|cycle| {
                cycle.energy = Some((EnergyBasis::MeasuredPower, net, -0.5));
                cycle.max_depth_mm = depth;
                if !net {
                    cycle.energy = Some((EnergyBasis::Dynamometer, false, -0.5));
                }
            });
            assert_eq!(verdict.state, ToolState::Learning, "{verdict:?}");
        }
        assert_eq!(excluded(&life.fold.verdict(), Exclusion::AirCut), 60);
        assert_eq!(life.ratios(&[1.0; 5]).state, ToolState::Good);
    }
}

/// The time of a story, s.
const fn second(second: i64) -> Timestamp {
    Timestamp::from_micros(1_700_000_000_000_000 + second * 1_000_000)
}

/// A cycle whose clock was never set, and that came in then.
fn unset(number: u32, received_s: i64) -> CycleFacts {
    let mut cycle = facts(number, NEW);
    cycle.order.started_at = Timestamp::from_micros(915_148_800_000_000 + i64::from(number));
    cycle.order.cycle = CycleId::try_from(format!("u{number}").as_str()).unwrap();
    cycle.received_at = second(received_s);
    cycle.flags.insert(Flag::ClockSuspect);
    cycle
}

#[test]
fn a_life_during_which_cycles_without_a_clock_came_in_is_unknown() {
    let unsets = |received: &[i64]| {
        let mut fold = ToolFold::awaiting_mount();
        for (number, received_s) in (1..).zip(received) {
            fold.cycle(&unset(number, *received_s), Some(&settings()));
            fold = ToolFold::from_bytes(&fold.to_bytes()).unwrap();
        }
        fold
    };
    let six = [600, 610, 620, 630, 640, 650];
    let mut fold = unsets(&six);
    let verdict = fold.verdict();
    assert_eq!((verdict.state, verdict.cycles), (ToolState::Unknown, 6), "nobody mounted it yet");
    fold.event(ToolEventKind::MountedNew, second(500));
    let verdict = fold.verdict();
    assert_eq!((verdict.state, why(&verdict)), (ToolState::Unknown, vec!["clock_suspect"]));
    assert_eq!((verdict.cycles, verdict.started_unworn), (0, false), "it may have worked");

    // In mid-life too, and no matter that its other cycles are well: but what is worn stays worn.
    let mut used = Life { fold, number: 100 };
    let verdict = used.ratios(&[1.0; 8]);
    assert_eq!((verdict.state, verdict.level), (ToolState::Unknown, None), "{verdict:?}");
    used.ratios(&[1.06; 6]);
    let verdict = used.ratios(&[1.11; 8]);
    assert_eq!(verdict.state, ToolState::Worn);
    used.fold.event(ToolEventKind::Changed, second(3_000));
    assert_eq!(used.ratios(&[1.0; 8]).state, ToolState::Good, "the next tool has not run without a clock");

    // Somebody who looked at the tool since has the last word.
    let mut confirmed = unsets(&six);
    confirmed.event(ToolEventKind::MountedNew, second(500));
    let mut confirmed = Life { fold: confirmed, number: 100 };
    confirmed.ratios(&[1.0; 8]);
    confirmed.fold.event(ToolEventKind::ConditionsConfirmed, second(3_000));
    assert_eq!(confirmed.ratio(1.0).state, ToolState::Good);

    // What came in before the life began is not its, in whatever order it was run; and a few are no matter.
    for (received, state) in [
        (&[100, 110, 120, 130, 140, 150, 160, 600][..], ToolState::Good),
        (&[600, 610, 620, 630, 640][..], ToolState::Good),
        (&[650, 100, 640, 110, 630, 600, 120, 610, 620][..], ToolState::Unknown),
    ] {
        let mut fold = unsets(received);
        fold.event(ToolEventKind::MountedNew, second(500));
        let verdict = Life { fold, number: 100 }.ratios(&[1.0; 8]);
        assert_eq!(verdict.state, state, "{received:?}");
    }
}

#[test]
fn a_sampled_standstill_is_no_speed() {
    let asked = FoldSettings { spindle_speed_rpm: Some(2400.0), ..settings() };
    let speed = |named: Option<f64>, sampled: Option<f64>| {
        let mut cycle = facts(1, NEW);
        (cycle.spindle_speed_rpm, cycle.sampled_speed_rpm) = (named, sampled);
        cycle.speed_rpm(asked.spindle_speed_rpm)
    };
    assert_eq!(speed(None, None), Some(2400.0));
    assert_eq!(
        speed(None, Some(2160.0)),
        Some(2160.0),
        "the operator's override tells another speed than the operation"
    );
    assert_eq!(speed(Some(2300.0), Some(2160.0)), Some(2300.0), "what the cycle names is believed first");
    for standing in [0.0, -3.0, 120.0] {
        assert_eq!(speed(None, Some(standing)), Some(2400.0), "{standing}");
    }
    // Recordings with as much standstill as work, as summaries of before told them.
    let mut fold = ToolFold::default();
    for number in 1..=30_u32 {
        let mut cycle = facts(number, NEW);
        cycle.spindle_speed_rpm = None;
        cycle.sampled_speed_rpm = Some(if number % 2 == 0 { 0.0 } else { 2400.0 });
        fold.cycle(&cycle, Some(&asked));
    }
    let verdict = fold.verdict();
    assert_eq!(
        (verdict.state, verdict.counted, verdict.baselines.len()),
        (ToolState::Good, 30, 1),
        "{verdict:?}"
    );
}

#[test]
fn a_cycle_is_told_over_the_baseline_that_it_was_compared_with() {
    let ratio = |verdict: &Verdict, number: u32, ratio: f64| {
        verdict
            .ratio_of(&facts(number, ratio * NEW), &settings())
            .map(|ratio| (1000.0 * ratio).round() / 1000.0)
    };
    let mut life = Life::learnt();
    life.ratios(&[1.0, 1.0, 1.0, 1.5, 1.5, 1.5, 1.5]);
    life.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    let learning = life.ratios(&[1.5, 1.5]);
    assert_eq!(
        (ratio(&learning, 8, 1.0), ratio(&learning, 12, 1.5), ratio(&learning, 14, 1.5)),
        (Some(1.0), Some(1.5), None)
    );
    let learnt = life.ratios(&[1.5; 6]);
    assert_eq!((ratio(&learnt, 8, 1.0), ratio(&learnt, 12, 1.5)), (Some(1.0), Some(1.5)));
    assert_eq!((ratio(&learnt, 13, 1.5), ratio(&learnt, 20, 1.5)), (Some(1.0), Some(1.0)));
    // A step that was announced: the baseline is another one from its first cycle on.
    let mut announced = Life::learnt();
    announced.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
    let verdict = announced.ratios(&[1.0, 1.5, 1.5, 1.5, 1.5, 1.5]);
    assert_eq!((ratio(&verdict, 6, 1.0), ratio(&verdict, 7, 1.5)), (Some(1.0), Some(1.0)), "{verdict:?}");
    // Of many only the newest are kept, and what came before them is told none.
    let mut many = Life::learnt();
    for step in 1..=12 {
        let at = 1.3_f64.powi(step);
        many.ratios(&[at; 3]);
        many.fold.event(ToolEventKind::ConditionsConfirmed, TOLD);
        many.ratios(&[at; 6]);
    }
    let verdict = many.fold.verdict();
    assert_eq!(ratio(&verdict, 5, 1.0), None);
    assert_eq!(ratio(&verdict, many.number, 1.3_f64.powi(12)), Some(1.0));
    assert_eq!(ToolFold::from_bytes(&many.fold.to_bytes()), Some(many.fold));
}

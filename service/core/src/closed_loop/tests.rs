//! The envelope, whatever comes in; and the sequence rules told one by one.

#![expect(clippy::float_cmp, reason = "neutral and the limits are exact values, not results of arithmetic")]

use super::control::{LawSettings, Program, Seen, control, longest_gap_ms};
use super::monitor::Monitor;
use super::plunge::{BoundedFeed, PlungeLimits, PlungeLoop, PlungePhase, PlungeStep};
use super::profile::RunProfile;
use super::reason::Quality;
use super::record::Timing;
use super::{
    Answer, Batch, Begun, LoopReason, LoopReasons, LoopSettings, Mode, RunningCycle, SampleAdvice, Standing,
};
use crate::contact::{ContactInput, ContactSettings};
use crate::cycle::{Channel, TimeBase};
use crate::friction::feed_override::FeedOverride;
use crate::friction::law::{OverloadHold, Reason};
use crate::friction::program::{Between, FeedProgram};
use crate::machine::{FeedDriveRating, FeedLimits, LoadReference, Machine, SpindleRating};
use crate::operation::{Operation, WearSettings};
use crate::units::{Process, Timestamp};
use crate::vibratory::peak_to_peak::{ControllerInput, ControllerSettings, VibrationSample};
use crate::wear::ToolState;
use proptest::prelude::*;

const START: i64 = 1_777_874_400_000_000;
const PERIOD_MS: f64 = 10.0;
const CHANNELS: [Channel; 3] = [Channel::DepthMm, Channel::FeedDriveLoadPercent, Channel::SpindleLoadPercent];

fn machine() -> Machine {
    Machine {
        id: "M1".try_into().unwrap(),
        name: "M1".to_owned(),
        control: "linuxcnc".to_owned(),
        ipo_period_ms: 10.0,
        spindle: SpindleRating { reference: LoadReference::RatedPower, ..SpindleRating::default() },
        feed_drive: FeedDriveRating { reference: LoadReference::RatedTorque, rated_thrust_newtons: None },
        limits: FeedLimits::new(1.0, 3000.0, 20.0, 150.0).unwrap(),
    }
}

pub(super) fn operation(process: Process) -> Operation {
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
        programmed_feed_mm_min: Some(150.0),
        spindle_load_set_percent: Some(40.0),
        feed_drive_load_set_percent: Some(30.0),
        wear: WearSettings::default(),
        turning: None,
        plunge: None,
    }
}

fn law(overload: OverloadHold) -> LawSettings {
    LawSettings {
        intensity: 2.0,
        rise_limit_points: 5.0,
        heating_ms: 0.0,
        settling_samples: 4,
        overload,
        program_range: (5.0, 200.0),
    }
}

fn settings() -> LoopSettings {
    LoopSettings { oldest_sample_ms: 500.0, validity_ms: 250, most_samples: 1000, longest_cycle_ms: 9000.0 }
}

fn program() -> Program {
    let program = FeedProgram::from_pairs(Between::Linear, &[(0.0, 100.0), (10.0, 300.0)]).unwrap();
    Program::Told { program, range: None }
}

fn begun() -> Begun {
    let at = Timestamp::from_micros(START);
    Begun { started_at: at, sent_at: at, received_at: at }
}

/// What is known of a cycle with a good tool, and nothing in its way.
fn standing<'a>(machine: &'a Machine, operation: &'a Operation, program: &'a Program) -> Standing<'a> {
    Standing {
        machine,
        operation: Some(operation),
        tool: Some(ToolState::Good),
        program,
        overload_open: false,
        constant_feed: false,
        process: None,
    }
}

/// A sample of a plunge.
const fn plunging(depth_mm: f64, feed_mm_min: f64, load: f64) -> Seen {
    Seen {
        time_ms: 0.0,
        age_ms: 0.0,
        depth_mm: Some(depth_mm),
        feed_drive_percent: Some(load),
        spindle_percent: None,
        programmed_mm_min: None,
        actual_mm_min: Some(feed_mm_min),
    }
}

/// Feeds of a plunge at 2500 mm/min at most, within those of a machine: in the work, the least, out of the hole.
fn plunge_limits(work: f64, least: f64, retract: f64, allowed_bite_mm: f64) -> PlungeLimits {
    let limits = FeedLimits::new(1.0, 3000.0, 20.0, 150.0).unwrap();
    let feed = |mm_min| BoundedFeed::within(&limits, mm_min).unwrap();
    PlungeLimits {
        plunge: feed(2500.0),
        work: feed(work),
        least: feed(least),
        retract: feed(retract),
        allowed_bite_mm,
        answer_age_ms: 20.0,
        period_ms: 10.0,
        longest_gap_ms: longest_gap_ms(10.0),
    }
}

/// A plunge whose samples are so far apart, ms.
struct Plunging {
    looped: PlungeLoop,
    step_ms: f64,
    time_ms: f64,
}

impl Plunging {
    /// At the pace that its limits tell, as found by the usual detector; none where there is no such plunge.
    fn of(limits: PlungeLimits) -> Option<Self> {
        let detector = ContactSettings::new(ContactInput::DEFAULT).unwrap();
        let looped = PlungeLoop::new(limits, detector, 4)?;
        Some(Self { looped, step_ms: limits.period_ms, time_ms: 0.0 })
    }

    fn step(&mut self, seen: &Seen) -> (PlungeStep, LoopReasons) {
        self.time_ms += self.step_ms;
        self.looped.step(&Seen { time_ms: self.time_ms, ..*seen })
    }

    fn withhold(&mut self, age_ms: f64) -> (PlungeStep, LoopReasons) {
        self.looped.withhold(None, age_ms)
    }
}

fn running_with(
    machine: &Machine,
    operation: &Operation,
    tool: Option<ToolState>,
    told: &Program,
) -> RunningCycle {
    let standing = Standing {
        machine,
        operation: Some(operation),
        tool,
        program: told,
        overload_open: false,
        constant_feed: false,
        process: None,
    };
    let overload = OverloadHold::UntilAcknowledged { relative_load: 2.0 };
    let control = control(&standing, &law(overload), PERIOD_MS, None).unwrap();
    let timing = Timing::Period { period_ms: PERIOD_MS };
    RunningCycle::new(begun(), control, (CHANNELS.to_vec(), timing), (Mode::Advise, settings()))
}

fn running() -> RunningCycle {
    running_with(&machine(), &operation(Process::Friction), Some(ToolState::Good), &program())
}

/// When sample `n` has just been taken.
fn at(n: u64) -> Timestamp {
    Timestamp::from_micros(START + (i64::try_from(n).unwrap() + 1) * 10_000)
}

/// Samples of one load each on both drives.
fn send(cycle: &mut RunningCycle, now: Timestamp, first: u64, loads: &[f64]) -> (Answer, Vec<SampleAdvice>) {
    let values: Vec<f64> =
        loads.iter().map(|_| 1.0).chain(loads.iter().copied()).chain(loads.iter().copied()).collect();
    let mut each = Vec::new();
    let batch = Batch { first, count: loads.len(), values: &values, times_ms: &[] };
    let answer = cycle.take(now, &batch, &mut each);
    (answer, each)
}

#[test]
fn low_loads_raise_by_the_permitted_points_and_high_ones_lower_at_once() {
    let mut cycle = running();
    let mut before = 100.0;
    for n in 0..5 {
        let (answer, _) = send(&mut cycle, at(n), n, &[10.0]);
        assert!(answer.ovr.percent() > before && answer.ovr.percent() <= before + 5.0);
        assert!(answer.reasons.has_law(Reason::LoadBelowSet) && answer.quality.as_str() == "good");
        assert_eq!((answer.valid_for_ms, answer.next), (250, n + 1));
        before = answer.ovr.percent();
    }
    for n in 5..30 {
        send(&mut cycle, at(n), n, &[55.0]);
    }
    let (answer, _) = send(&mut cycle, at(30), 30, &[55.0]);
    assert!(answer.ovr.percent() < 100.0, "{answer:?}");
}

#[test]
fn every_break_of_the_sequence_is_named_and_never_raises() {
    let mut cycle = running();
    let (first, each) = send(&mut cycle, at(2), 0, &[10.0, 10.0, 10.0]);
    assert!(first.ovr.percent() > 110.0);
    // The same again is its earlier answer, and does not live longer for it.
    let later = Timestamp::from_micros(at(2).micros() + 100_000);
    let (again, same) = send(&mut cycle, later, 0, &[10.0, 10.0, 10.0]);
    assert_eq!((again.ovr, again.valid_until, again.valid_for_ms), (first.ovr, first.valid_until, 150));
    for (early, late) in each.iter().zip(&same) {
        assert_eq!(early.ovr, late.ovr);
        assert!(late.reasons.contains(LoopReason::Repeated));
    }
    // A gap is neutral: from above at once.
    let (gap, each) = send(&mut cycle, at(13), 13, &[10.0]);
    assert_eq!(gap.ovr.percent(), 100.0);
    assert!(each[0].reasons.contains(LoopReason::MissingSamples), "{each:?}");
    assert_eq!((gap.next, cycle.record().first_missing()), (14, 3));
    // What was missing fills its place, and raises nothing.
    let (late, each) = send(&mut cycle, at(14), 3, &[10.0]);
    assert!(each[0].reasons.contains(LoopReason::OutOfOrder) && late.ovr.percent() <= 100.0);
    // Another content under a number that was taken.
    let (other, each) = send(&mut cycle, at(14), 1, &[90.0]);
    assert!(each[0].reasons.contains(LoopReason::RepeatDiffers) && other.ovr.percent() <= 100.0);
    // Too old, and from a time that has not been.
    let (old, each) = send(&mut cycle, at(200), 14, &[10.0]);
    assert!(each[0].reasons.contains(LoopReason::TooOld) && old.ovr.percent() <= 100.0);
    let (_, each) = send(&mut cycle, at(16), 500, &[10.0]);
    assert!(each[0].reasons.contains(LoopReason::FromFuture), "{each:?}");
    // It takes no number: what is really taken next goes on.
    let (next, each) = send(&mut cycle, at(15), 15, &[10.0]);
    assert_eq!(next.next, 16, "{each:?}");
    assert!(!each[0].reasons.contains(LoopReason::OutOfOrder), "{each:?}");
    let (_, each) = send(&mut cycle, at(2000), 2000, &[10.0]);
    assert!(each[0].reasons.contains(LoopReason::TooManySamples));
    assert!(each[0].reasons.contains(LoopReason::CycleTooLong) && cycle.was_cut_short());
}

#[test]
fn a_profile_brings_its_own_limits_and_the_lower_of_two_set_loads_counts() {
    let run = |range, set, load: f64, capped| {
        let Program::Told { program, .. } = program() else { panic!("a program is told") };
        let hash = crate::feed::profile::ProfileHash::from_bytes([0; 32]);
        let (set_feed_drive_percent, set_spindle_percent) = (Some(set), None);
        let profile = RunProfile {
            hash,
            program,
            range,
            feeds_mm_min: (1.0, 30_000.0),
            set_feed_drive_percent,
            set_spindle_percent,
            capped,
        };
        let told = Program::Profile(Box::new(profile));
        let mut cycle = running_with(&machine(), &operation(Process::Friction), Some(ToolState::Good), &told);
        let mut last = None;
        for n in 0..40 {
            last = Some(send(&mut cycle, at(n), n, &[load]).0);
        }
        last.unwrap()
    };
    let free = run((5.0, 200.0), 40.0, 10.0, LoopReasons::NONE);
    assert!((149.99..=150.0).contains(&free.ovr.percent()), "the machine's limit: {}", free.ovr.percent());
    let bounded = run((5.0, 120.0), 40.0, 10.0, LoopReasons::NONE).ovr.percent();
    assert!((119.99..=120.0).contains(&bounded), "the profile's limit: {bounded}");
    let lower = run((5.0, 200.0), 15.0, 20.0, LoopReasons::NONE);
    assert!(lower.ovr.percent() < 100.0 && lower.reasons.has_law(Reason::LoadAboveSet), "15 % against 30 %");
    let beyond = run((5.0, 200.0), 40.0, 10.0, LoopReasons::of(LoopReason::ProfileBeyondWear));
    assert_eq!(beyond.ovr.percent(), 100.0);
    assert!(beyond.reasons.contains(LoopReason::ProfileBeyondWear));
    let beyond = run((5.0, 200.0), 15.0, 20.0, LoopReasons::of(LoopReason::ProfileBeyondWear));
    assert!(beyond.ovr.percent() < 100.0, "it may still fall");
}

#[test]
fn what_is_not_known_keeps_neutral_and_says_so() {
    let with = |change: &dyn Fn(&mut Machine, &mut Operation), tool, told: &Program| {
        let (mut machine, mut operation) = (machine(), operation(Process::Friction));
        change(&mut machine, &mut operation);
        let mut cycle = running_with(&machine, &operation, tool, told);
        let mut last = None;
        for n in 0..40 {
            last = Some(send(&mut cycle, at(n), n, &[5.0]).0);
        }
        let last = last.unwrap();
        assert_eq!(last.ovr.percent(), 100.0, "{:?}", last.reasons.codes().collect::<Vec<_>>());
        last.reasons
    };
    let good = Some(ToolState::Good);
    let none = |_: &mut Machine, _: &mut Operation| {};
    assert!(with(&none, None, &program()).contains(LoopReason::ToolUnregistered));
    assert!(with(&none, Some(ToolState::BrokenSuspected), &program()).contains(LoopReason::BrokenSuspected));
    assert!(with(&none, Some(ToolState::Changed), &program()).contains(LoopReason::ConditionsChanged));
    assert!(with(&none, good, &Program::Unknown).contains(LoopReason::NoProgram));
    assert!(
        with(&none, good, &Program::Refused(LoopReason::ProfileNotActive))
            .contains(LoopReason::ProfileNotActive)
    );
    assert!(
        with(&|m, _| m.spindle.reference = LoadReference::Unknown, good, &program())
            .contains(LoopReason::UnknownRating)
    );
    assert!(with(&|_, o| o.process = Process::Milling, good, &program()).contains(LoopReason::NoLaw));
    assert!(with(&|_, o| o.process = Process::Plunge, good, &program()).contains(LoopReason::NoPlungeFeed));
    let refused = Program::Refused(LoopReason::ProfileMismatch);
    assert!(with(&none, good, &refused).contains(LoopReason::ProfileMismatch));
    let no_loads = |_: &mut Machine, o: &mut Operation| {
        o.spindle_load_set_percent = None;
        o.feed_drive_load_set_percent = None;
    };
    assert!(with(&no_loads, good, &program()).contains(LoopReason::NoSetLoad));
    // A worn tool may be slowed down, not sped up.
    assert!(with(&none, Some(ToolState::Worn), &program()).contains(LoopReason::ToolWorn));
    let mut worn = running_with(&machine(), &operation(Process::Friction), Some(ToolState::Worn), &program());
    let mut last = 100.0;
    for n in 0..30 {
        last = send(&mut worn, at(n), n, &[60.0]).0.ovr.percent();
    }
    assert!(last < 90.0);
}

#[test]
fn no_law_acts_on_a_constant_feed_or_on_another_process() {
    let (machine, operation, told) = (machine(), operation(Process::Friction), program());
    let percent = |constant_feed, process| {
        let standing = Standing {
            machine: &machine,
            operation: Some(&operation),
            tool: Some(ToolState::Good),
            program: &told,
            overload_open: false,
            constant_feed,
            process,
        };
        let control = control(&standing, &law(OverloadHold::Off), PERIOD_MS, None).unwrap();
        let timing = Timing::Period { period_ms: PERIOD_MS };
        let mut cycle =
            RunningCycle::new(begun(), control, (CHANNELS.to_vec(), timing), (Mode::Advise, settings()));
        let (answer, _) = send(&mut cycle, at(0), 0, &[10.0]);
        (answer.ovr.percent(), answer.reasons.contains(LoopReason::NoLaw))
    };
    let (law, none) = percent(false, Some(Process::Friction));
    assert!(law > 100.0 && !none);
    assert_eq!(percent(true, None), (100.0, true));
    assert_eq!(percent(false, Some(Process::Turning)), (100.0, true));
}

#[test]
fn another_programs_feed_is_told_from_rounding() {
    let channels = [
        Channel::DepthMm,
        Channel::FeedDriveLoadPercent,
        Channel::SpindleLoadPercent,
        Channel::FeedProgrammedMmMin,
    ];
    let (machine, operation, told) = (machine(), operation(Process::Friction), program());
    let standing = Standing {
        machine: &machine,
        operation: Some(&operation),
        tool: Some(ToolState::Good),
        program: &told,
        overload_open: false,
        constant_feed: false,
        process: None,
    };
    let control = control(&standing, &law(OverloadHold::Off), PERIOD_MS, None).unwrap();
    let timing = Timing::Period { period_ms: PERIOD_MS };
    let mut cycle =
        RunningCycle::new(begun(), control, (channels.to_vec(), timing), (Mode::Advise, settings()));
    let mut ask = |n: u64, depth: f64, feed: f64| {
        let mut each = Vec::new();
        let values = [depth, 10.0, 10.0, feed];
        cycle.take(at(n), &Batch { first: n, count: 1, values: &values, times_ms: &[] }, &mut each);
        each[0].reasons.contains(LoopReason::ProgramMismatch)
    };
    assert!(!ask(0, 5.0, 200.0));
    assert!(!ask(1, 5.0, 210.0), "half a millimetre ahead");
    assert!(!ask(2, -3.0, 1000.0), "the approach above the work");
    assert!(ask(3, 5.0, 260.0));
    assert!(ask(4, 5.0, 120.0));
}

#[test]
fn an_overload_holds_until_it_is_acknowledged_and_a_lost_memory_starts_no_higher_than_it_was() {
    let mut cycle = running();
    for n in 0..30 {
        send(&mut cycle, at(n), n, &[200.0]);
    }
    assert!(cycle.is_overloaded());
    for n in 30..90 {
        send(&mut cycle, at(n), n, &[5.0]);
    }
    let held = send(&mut cycle, at(90), 90, &[5.0]).0;
    assert!(held.overloaded && held.ovr.percent() < 100.0 && held.reasons.has_law(Reason::OverloadHeld));
    cycle.acknowledge();
    let freed = send(&mut cycle, at(91), 91, &[5.0]).0;
    assert!(!freed.overloaded && freed.ovr > held.ovr);

    let mut low = running().restarted(60.0);
    assert_eq!(send(&mut low, at(0), 0, &[5.0]).0.ovr.percent(), 60.0, "it settles first");
    let mut high = running().restarted(140.0);
    assert_eq!(send(&mut high, at(0), 0, &[5.0]).0.ovr.percent(), 100.0);
}

#[test]
fn an_overload_is_one_also_where_its_samples_may_not_be_judged() {
    let crash = [200.0; 10];
    let after = |cycle: &mut RunningCycle, (answer, each): (Answer, Vec<SampleAdvice>), why: LoopReason| {
        assert!(each.iter().any(|advice| advice.reasons.has_law(Reason::Overload)), "{why:?}");
        assert!(each.iter().all(|advice| advice.reasons.contains(why) && advice.ovr.percent() <= 100.0));
        assert!(answer.overloaded, "{why:?}");
        cycle.set_passing(LoopReasons::NONE);
        let n = cycle.record().next();
        for n in n..n + 20 {
            let held = send(cycle, at(n), n, &[5.0]).0;
            assert!(held.overloaded && held.ovr.percent() <= 100.0, "{why:?}");
        }
        cycle.acknowledge();
        assert!(!cycle.is_overloaded());
    };
    let mut late = running();
    let told = send(&mut late, at(200), 0, &crash);
    after(&mut late, told, LoopReason::TooOld);
    // Half a second ahead is forgiven as a start that took long; what lies further ahead is not.
    let mut ahead = running();
    send(&mut ahead, at(0), 0, &[5.0; 51]);
    let told = send(&mut ahead, at(0), 51, &crash);
    after(&mut ahead, told, LoopReason::FromFuture);
    let mut missed = running();
    send(&mut missed, at(0), 0, &[5.0]);
    send(&mut missed, at(11), 11, &[5.0]);
    let told = send(&mut missed, at(11), 1, &crash);
    after(&mut missed, told, LoopReason::OutOfOrder);
    let mut unknown = running();
    unknown.set_passing(LoopReasons::of(LoopReason::LeaseUnknown));
    let told = send(&mut unknown, at(9), 0, &crash);
    after(&mut unknown, told, LoopReason::LeaseUnknown);
}

#[test]
fn what_is_not_judged_is_no_overload_where_its_load_says_nothing() {
    // A single reading is filtered as the law filters it, and what follows a hole or is no load says nothing.
    for loads in [&[5.0, 5.0, 200.0, 5.0][..], &[200.0], &[200.0, f64::NAN], &[2000.0; 5], &[40.0; 10]] {
        let mut late = running();
        let (answer, _) = send(&mut late, at(200), 0, loads);
        assert!(!answer.overloaded, "{loads:?}");
    }
    // A number that was never taken is no sample.
    let mut wrong = running();
    assert!(!send(&mut wrong, at(0), 500, &[200.0; 10]).0.overloaded);
    // Of what it is a percentage nobody knows.
    let mut unrated = machine();
    unrated.spindle.reference = LoadReference::Unknown;
    let operation = operation(Process::Friction);
    let mut cycle = running_with(&unrated, &operation, Some(ToolState::Good), &program());
    assert!(!send(&mut cycle, at(9), 0, &[200.0; 10]).0.overloaded);
}

#[test]
fn what_is_kept_is_what_a_post_would_have_said() {
    let mut cycle = running();
    send(&mut cycle, at(2), 0, &[1.0, 2.0, 3.0]);
    let (time, columns) = cycle.record().columns().unwrap();
    assert_eq!(time, TimeBase::Period { period_ms: 10.0 });
    assert_eq!(columns[1], (Channel::FeedDriveLoadPercent, vec![1.0, 2.0, 3.0]));
    // A hole and a value that is none: their rows are left out, and the times show it.
    send(&mut cycle, at(4), 4, &[5.0]);
    send(&mut cycle, at(5), 5, &[f64::NAN]);
    send(&mut cycle, at(6), 6, &[7.0]);
    let (time, columns) = cycle.record().columns().unwrap();
    assert_eq!(time, TimeBase::Stamps { time_ms: vec![10.0, 20.0, 30.0, 50.0, 70.0] });
    assert_eq!(columns[2].1, [1.0, 2.0, 3.0, 5.0, 7.0]);
    assert_eq!(cycle.record().counts(), (6, 5));
}

#[test]
fn times_that_run_backwards_and_numbers_beyond_all_bounds_do_no_harm() {
    let mut each = Vec::new();
    let control = (super::Control::Neutral, LoopReasons::NONE, LoopReasons::NONE);
    let timing = Timing::Stamps { usual_ms: PERIOD_MS };
    let mut cycle =
        RunningCycle::new(begun(), control, (vec![Channel::DepthMm], timing), (Mode::Advise, settings()));
    let (values, times) = ([1.0, 2.0, 3.0, 4.0, 5.0], [10.0, 20.0, 15.0, -1.0, 30.0]);
    cycle.take(at(5), &Batch { first: 0, count: 5, values: &values, times_ms: &times }, &mut each);
    let (time, columns) = cycle.record().columns().unwrap();
    assert_eq!(time, TimeBase::Stamps { time_ms: vec![10.0, 20.0, 30.0] });
    assert_eq!(columns[0].1, [1.0, 2.0, 5.0]);
    let mut cycle = running();
    let (answer, _) = send(&mut cycle, at(0), u64::MAX, &[10.0, 10.0]);
    assert_eq!((answer.ovr.percent(), answer.next), (100.0, 0));
}

#[test]
fn a_plunge_is_fast_only_in_air_and_within_the_bite() {
    let plunge = plunge_limits(120.0, 0.5, 9999.0, 0.5);
    assert_eq!(plunge.retract.mm_min(), 3000.0);
    let detector = ContactSettings::new(ContactInput::DEFAULT).unwrap();
    let (machine, operation) = (machine(), operation(Process::Plunge));
    let standing = standing(&machine, &operation, &Program::Unknown);
    let looped = PlungeLoop::new(plunge, detector, 4).unwrap();
    let control = control(&standing, &law(OverloadHold::Off), PERIOD_MS, Some(looped)).unwrap();
    let channels = vec![Channel::DepthMm, Channel::FeedActualMmMin, Channel::FeedDriveLoadPercent];
    let timing = Timing::Period { period_ms: PERIOD_MS };
    let mut cycle = RunningCycle::new(begun(), control, (channels, timing), (Mode::Advise, settings()));
    let mut n = 0;
    let mut step = |depth: f64, load: f64| {
        let mut each = Vec::new();
        let values = [depth, 500.0, load];
        let answer =
            cycle.take(at(n), &Batch { first: n, count: 1, values: &values, times_ms: &[] }, &mut each);
        n += 1;
        assert_eq!(answer.ovr.percent(), 100.0);
        (answer.plunge.unwrap(), answer.reasons)
    };
    let (learning, why) = step(-10.0, 3.0);
    assert_eq!((learning.phase, learning.feed.mm_min()), (PlungePhase::Work, 120.0));
    assert!(why.contains(LoopReason::IdleUnknown));
    let mut approach = step(-9.9, 3.0);
    for k in 0..30 {
        approach = step(-9.8 + f64::from(k) * 0.1, 3.0);
    }
    // 0.5 mm within 4 samples of 10 ms and 20 ms of age: 500 mm/min.
    assert_eq!(approach.0.phase, PlungePhase::Approach);
    assert!((approach.0.feed.mm_min() - 500.0).abs() < 1e-9 && (approach.0.bite_mm - 0.5).abs() < 1e-12);
    assert!(approach.1.contains(LoopReason::BiteLimited));
    // One reading that is none: back to the working feed until four are good again.
    let (blind, why) = step(-6.0, f64::NAN);
    assert_eq!(blind.phase, PlungePhase::Work);
    assert!(why.contains(LoopReason::UnusableSample));
    for _ in 0..3 {
        let (settling, why) = step(-5.9, 3.0);
        assert_eq!(settling.phase, PlungePhase::Work);
        assert_eq!(why.codes().collect::<Vec<_>>(), ["settling"]);
    }
    assert_eq!(step(-5.8, 3.0).0.phase, PlungePhase::Approach);
    let mut work = step(0.1, 30.0);
    for _ in 0..5 {
        work = step(0.3, 30.0);
    }
    assert_eq!(work.0.phase, PlungePhase::Work);
    assert!(work.0.contact_offset_mm.is_some_and(|offset| (offset - 0.1).abs() < 1e-12));
    for k in 0..6 {
        work = step(8.0 + f64::from(k) * 0.1, 3.0);
    }
    // Out of the work, and fast once it is drawn back: until then there may be more work.
    assert_eq!((work.0.phase, work.0.feed.mm_min()), (PlungePhase::Retract, 120.0));
    assert!(work.0.breakthrough_depth_mm.is_some_and(|depth| (depth - 8.0).abs() < 1e-12));
    let back = step(8.2, 5.0).0;
    assert_eq!((back.phase, back.feed.mm_min()), (PlungePhase::Retract, 3000.0));
    // On its way in again, though it is above the deepest yet.
    let in_again = step(8.3, 5.0).0;
    assert_eq!((in_again.phase, in_again.feed.mm_min()), (PlungePhase::Retract, 120.0));
    // A bore across the hole was none of its end.
    let deeper = step(9.0, 30.0).0;
    assert_eq!((deeper.phase, deeper.feed.mm_min()), (PlungePhase::Work, 120.0));
    assert_eq!(deeper.breakthrough_depth_mm, None);
}

#[test]
fn a_heartbeat_in_a_plunge_says_why_as_the_sample_before_it_did() {
    let detector = ContactSettings::new(ContactInput::DEFAULT).unwrap();
    let (machine, operation) = (machine(), operation(Process::Plunge));
    let standing = standing(&machine, &operation, &Program::Unknown);
    let looped = PlungeLoop::new(plunge_limits(120.0, 1.0, 3000.0, 0.5), detector, 4).unwrap();
    let control = control(&standing, &law(OverloadHold::Off), PERIOD_MS, Some(looped)).unwrap();
    let channels = vec![Channel::DepthMm, Channel::FeedActualMmMin, Channel::FeedDriveLoadPercent];
    let timing = Timing::Period { period_ms: PERIOD_MS };
    let mut cycle = RunningCycle::new(begun(), control, (channels, timing), (Mode::Advise, settings()));
    for n in 0..40 {
        let load = if n % 17 == 16 { f64::NAN } else { 3.0 };
        #[expect(clippy::cast_precision_loss, reason = "a few dozen")]
        let values = [-10.0 + n as f64 * 0.1, 500.0, load];
        let batch = Batch { first: n, count: 1, values: &values, times_ms: &[] };
        let told = cycle.take(at(n), &batch, &mut Vec::new());
        let heartbeat = cycle.standing(at(n));
        assert_eq!((heartbeat.reasons, heartbeat.plunge), (told.reasons, told.plunge));
        assert!(!told.reasons.is_empty(), "{n}: {told:?}");
    }
}

/// A plunge at 500 mm/min in air, with a working feed of 150 mm/min; samples of depth, actual feed and load every 10 ms.
fn plunged(samples: impl IntoIterator<Item = (f64, f64, f64)>) -> Vec<(f64, PlungeStep, LoopReasons)> {
    let limits = plunge_limits(150.0, 1.0, 3000.0, 0.5);
    let mut plunge = Plunging::of(limits).unwrap();
    let each = samples.into_iter().map(|(depth_mm, feed, load)| {
        let (step, reasons) = plunge.step(&plunging(depth_mm, feed, load));
        (depth_mm, step, reasons)
    });
    each.collect()
}

#[test]
fn below_the_surface_a_plunge_is_never_faster_than_the_work_unless_contact_is_known() {
    let way = |from_mm: f64, load: fn(f64) -> f64| {
        (0..160).map(move |k| (from_mm + f64::from(k) * 0.08, 500.0, load(from_mm + f64::from(k) * 0.08)))
    };
    // A load that is frozen; one that began in the work; an approach too short to learn from.
    let frozen = plunged(way(-4.0, |_| 8.0));
    let in_the_work = plunged(way(1.0, |_| 40.0));
    let short = plunged(way(-1.0, |depth| if depth < 0.0 { 8.0 } else { 40.0 }));
    for (name, steps) in [("frozen", &frozen), ("in the work", &in_the_work), ("short", &short)] {
        for (depth, step, reasons) in steps.iter().filter(|(depth, ..)| *depth > 0.5) {
            assert!(step.feed.mm_min() <= 150.0, "{name} at {depth} mm: {step:?}");
            assert!(reasons.contains(LoopReason::IdleUnknown), "{name} at {depth} mm: {reasons:?}");
        }
    }
    assert!(frozen.iter().any(|(_, step, _)| step.phase == PlungePhase::Approach), "in air it is fast");
}

#[test]
fn a_feed_that_ripples_hides_no_contact_and_one_that_never_settles_is_not_fast() {
    let rippling = |share: f64| {
        (0..160).map(move |k| {
            let depth = -4.0 + f64::from(k) * 0.08;
            let feed = 500.0 * (1.0 + share * [1.0, -1.0][k as usize % 2]);
            (depth, feed, if depth < -0.4 { 8.0 } else { 40.0 })
        })
    };
    let found = plunged(rippling(0.03));
    let (_, last, _) = found.last().unwrap();
    assert!(last.contact_offset_mm.is_some_and(|offset| (-0.4..-0.3).contains(&offset)), "{last:?}");
    // Learnt in peace, then unsteady for longer than an axis takes to reach its feed.
    let unsteady = (0..100).map(|k| {
        let feed = if k < 40 { 500.0 } else { 500.0 + 150.0 * [1.0, -1.0][k as usize % 2] };
        (-10.0 + f64::from(k) * 0.08, feed, 8.0)
    });
    let steps = plunged(unsteady);
    assert_eq!(steps[39].1.phase, PlungePhase::Approach);
    let (_, last, reasons) = steps.last().unwrap();
    assert_eq!(last.phase, PlungePhase::Work);
    assert!(last.feed.mm_min() <= 150.0 && reasons.contains(LoopReason::IdleUnknown));
}

#[test]
fn a_peck_and_a_bore_across_the_hole_are_no_end_of_the_work() {
    let forward = |from: f64, to: f64| {
        (0_u32..).map(move |k| from + f64::from(k) * 0.025).take_while(move |at| *at <= to)
    };
    let air = (0..60).map(|k| (-6.0 + f64::from(k) * 0.08, 500.0, 8.0));
    let drilled = |from: f64, to: f64, load: f64| forward(from, to).map(move |depth| (depth, 150.0, load));
    let back = (0..40).map(|k| (2.0 - f64::from(k) * 0.1, 150.0, 8.0));
    let again = (0..40).map(|k| (-1.9 + f64::from(k) * 0.1, 150.0, 8.0));
    let pecked = air.clone().chain(drilled(-0.4, 2.0, 30.0)).chain(back).chain(again);
    let pecked = plunged(pecked.chain(drilled(2.0, 6.0, 30.0)));
    assert!(pecked.iter().all(|(_, step, _)| step.phase != PlungePhase::Retract), "a peck");
    let across = air.chain(drilled(-0.4, 3.0, 30.0)).chain(drilled(3.025, 6.0, 8.0));
    let across = plunged(across.chain(drilled(6.025, 12.0, 30.0)));
    for (depth, step, _) in across.iter().filter(|(depth, ..)| *depth > 0.0) {
        assert!(step.feed.mm_min() <= 150.0, "{depth} mm: {step:?}");
    }
    assert_eq!(across.last().unwrap().1.phase, PlungePhase::Work);
}

/// Samples with a depth, a programmed feed and one load on both drives each, 10 ms apart.
fn drilled(cycle: &mut RunningCycle, samples: &[(f64, f64)]) -> Vec<(FeedOverride, LoopReasons)> {
    let first = cycle.record().next();
    let each = samples.iter().zip(first..).map(|((depth, load), n)| {
        let values = [*depth, *load, *load];
        let answer =
            cycle.take(at(n), &Batch { first: n, count: 1, values: &values, times_ms: &[] }, &mut Vec::new());
        (answer.ovr, answer.reasons)
    });
    each.collect()
}

#[test]
fn the_override_keeps_the_programmed_feed_within_the_machine_s() {
    let narrow = Machine { limits: FeedLimits::new(90.0, 320.0, 20.0, 150.0).unwrap(), ..machine() };
    let mut cycle = running_with(&narrow, &operation(Process::Friction), Some(ToolState::Good), &program());
    // 100 + 20 z mm/min, light loads: at 9 mm the program runs 280 mm/min.
    let light: Vec<(f64, f64)> = (0..300).map(|k| (f64::from(k) * 0.03, 5.0)).collect();
    for ((depth, _), (ovr, reasons)) in light.iter().zip(drilled(&mut cycle, &light)) {
        let feed = (100.0 + 20.0 * depth) * ovr.percent() / 100.0;
        assert!(feed <= 320.0 + 1e-9, "{feed} mm/min at {depth} mm, {reasons:?}");
        assert_eq!(reasons.has_law(Reason::ClampedFeedMax), (feed - 320.0).abs() < 1e-9, "{depth} {feed}");
    }
    let heavy: Vec<(f64, f64)> = (0..100).map(|_| (9.0, 75.0)).collect();
    let (ovr, reasons) = *drilled(&mut cycle, &heavy).last().unwrap();
    assert!((ovr.percent() * 2.8 - 90.0).abs() < 1e-9 && reasons.has_law(Reason::ClampedFeedMin), "{ovr:?}");
}

#[test]
fn above_the_work_and_at_an_unknown_depth_the_law_is_off() {
    let mut cycle = running();
    let air: Vec<(f64, f64)> = (0..100).map(|k| (-5.0 + f64::from(k) * 0.04, 4.0)).collect();
    for (ovr, reasons) in drilled(&mut cycle, &air) {
        assert_eq!(ovr.percent(), 100.0);
        assert!(reasons.has_law(Reason::Heating));
    }
    let (risen, _) = *drilled(&mut cycle, &[(0.1, 10.0); 10]).last().unwrap();
    assert!(risen.percent() > 100.0, "in the work it acts");
    // Drawn back, above the work or in the hole, it is off again, and begins anew from 100 %.
    drilled(&mut cycle, &[(3.0, 10.0); 2]);
    for (ovr, reasons) in drilled(&mut cycle, &[(-1.0, 3.0), (-0.5, 3.0), (1.0, 3.0), (2.4, 3.0)]) {
        assert_eq!(ovr.percent(), 100.0);
        assert!(reasons.has_law(Reason::Heating));
    }
    assert!(drilled(&mut cycle, &[(3.0, 10.0); 10]).last().unwrap().0.percent() > 100.0);
    for (ovr, reasons) in drilled(&mut cycle, &[(f64::NAN, 10.0); 10]) {
        assert_eq!(ovr.percent(), 100.0);
        assert!(reasons.has_law(Reason::UnknownDepth));
    }
}

#[test]
fn a_load_below_none_hides_no_crash() {
    let after = |first: f64| {
        let mut cycle = running();
        drilled(&mut cycle, &[(1.0, 10.0); 4]);
        drilled(&mut cycle, &[(1.0, first), (1.0, 150.0)]).last().unwrap().0
    };
    assert_eq!(after(-900.0), after(0.0));
}

#[test]
fn samples_that_come_faster_than_declared_do_not_raise_faster() {
    let mut cycle = running();
    let timing = Timing::Stamps { usual_ms: PERIOD_MS };
    let (machine, operation, program) = (machine(), operation(Process::Friction), program());
    let standing = standing(&machine, &operation, &program);
    let control = control(&standing, &law(OverloadHold::Off), PERIOD_MS, None).unwrap();
    let mut fast =
        RunningCycle::new(begun(), control, (CHANNELS.to_vec(), timing), (Mode::Advise, settings()));
    for n in 0..100_u32 {
        let time_ms = f64::from(n + 1) * 0.1;
        let now = Timestamp::from_micros(START + i64::from(n + 1) * 100);
        let batch = Batch { first: n.into(), count: 1, values: &[1.0, 5.0, 5.0], times_ms: &[time_ms] };
        fast.take(now, &batch, &mut Vec::new());
    }
    let (usual, _) = *drilled(&mut cycle, &[(1.0, 5.0); 2]).last().unwrap();
    let reached = fast.standing(at(1)).ovr.percent();
    // The first sample of a cycle has no step in time: it counts as a whole one.
    assert!(reached > 100.0 && reached <= usual.percent() + 1e-9, "{reached} beside {usual:?}");
}

#[test]
fn a_number_that_was_never_taken_does_not_let_a_cycle_end_without_its_samples() {
    let mut cycle = running();
    drilled(&mut cycle, &[(1.0, 10.0); 10]);
    send(&mut cycle, at(10), 2_147_483_648, &[10.0]);
    assert!(!cycle.was_cut_short());
    assert_eq!(cycle.record().next(), 10);
}

#[test]
fn an_overload_that_nobody_has_acknowledged_is_told_with_every_answer() {
    let (machine, operation, program) = (machine(), operation(Process::Friction), program());
    let standing = Standing { overload_open: true, ..standing(&machine, &operation, &program) };
    let overload = OverloadHold::UntilAcknowledged { relative_load: 2.0 };
    let control = control(&standing, &law(overload), PERIOD_MS, None).unwrap();
    let timing = Timing::Period { period_ms: PERIOD_MS };
    let mut cycle =
        RunningCycle::new(begun(), control, (CHANNELS.to_vec(), timing), (Mode::Advise, settings()));
    let low = send(&mut cycle, at(0), 0, &[10.0]).0;
    assert!(low.overloaded && !cycle.is_overloaded());
    assert_eq!(low.ovr.percent(), 100.0);
    // The same load again is answered at once, and what was lowered is not raised.
    let high: Vec<f64> = (1..20).map(|n| send(&mut cycle, at(n), n, &[55.0]).0.ovr.percent()).collect();
    let lowered = *high.last().unwrap();
    assert!(lowered < 100.0 && high.is_sorted_by(|before, after| before >= after), "{high:?}");
    let held = send(&mut cycle, at(20), 20, &[1.0; 20]).0;
    assert!(held.ovr.percent() <= lowered && held.reasons.contains(LoopReason::OverloadUnacknowledged));
    cycle.acknowledge();
    let freed = send(&mut cycle, at(40), 40, &[1.0; 20]).0;
    assert!(!freed.overloaded && freed.ovr.percent() > lowered, "{freed:?}");
}

#[test]
fn what_is_changed_while_a_cycle_runs_ends_its_law() {
    let mut cycle = running();
    drilled(&mut cycle, &[(1.0, 10.0); 10]);
    assert!(cycle.standing(at(10)).ovr.percent() > 100.0);
    cycle.outdate();
    // At once, for who asks without a sample too.
    let standing = cycle.standing(at(10));
    assert_eq!(
        (standing.ovr.percent(), standing.reasons.contains(LoopReason::ChangedMeanwhile)),
        (100.0, true)
    );
    let (answer, _) = send(&mut cycle, at(10), 10, &[10.0]);
    assert_eq!(answer.ovr.percent(), 100.0);
    assert!(answer.reasons.contains(LoopReason::ChangedMeanwhile));
}

#[test]
fn what_stands_only_for_a_time_is_neutral_at_once_and_no_longer() {
    let mut cycle = running();
    drilled(&mut cycle, &[(1.0, 10.0); 10]);
    let before = cycle.standing(at(10)).ovr.percent();
    assert!(before > 100.0);
    cycle.set_passing(LoopReasons::of(LoopReason::LeaseUnknown));
    let standing = cycle.standing(at(10));
    assert_eq!((standing.ovr.percent(), standing.reasons.contains(LoopReason::LeaseUnknown)), (100.0, true));
    cycle.set_passing(LoopReasons::NONE);
    let (mut highest, mut n) = (0.0_f64, 10);
    while n < 30 {
        highest = send(&mut cycle, at(n), n, &[10.0]).0.ovr.percent();
        n += 1;
    }
    assert!(highest > 100.0, "the law acts again");
}

#[test]
fn a_repeat_of_minus_zero_is_the_same() {
    let mut cycle = running();
    let (first, _) = send(&mut cycle, at(0), 0, &[-0.0]);
    let (again, _) = send(&mut cycle, at(1), 0, &[-0.0]);
    assert!(
        !again.reasons.contains(LoopReason::RepeatDiffers) && again.reasons.contains(LoopReason::Repeated)
    );
    assert_eq!(send(&mut cycle, at(1), 0, &[0.0]).0.reasons, again.reasons);
    assert_eq!(again.ovr, first.ovr);
    assert!(send(&mut cycle, at(1), 0, &[1.0]).0.reasons.contains(LoopReason::RepeatDiffers));
}

#[test]
fn a_working_feed_that_bites_too_deep_is_run_in_the_work_only() {
    // 0.1 mm within 60 ms: 100 mm/min.
    let plunge = plunge_limits(120.0, 1.0, 3000.0, 0.1);
    let mut plunge = Plunging::of(plunge).unwrap();
    let seen = |depth_mm: f64, load: f64| plunging(depth_mm, 100.0, load);
    let mut phases = Vec::new();
    let mut check = |(step, reasons): (PlungeStep, LoopReasons)| {
        let known = step.contact_offset_mm.is_some();
        assert!((step.feed.mm_min() - if known { 120.0 } else { 100.0 }).abs() < 1e-9, "{step:?}");
        assert_eq!(reasons.contains(LoopReason::BiteLimited), !known, "{step:?}");
        phases.push(step.phase);
    };
    for k in 0..30 {
        check(plunge.step(&seen(-10.0 + f64::from(k) * 0.1, 3.0)));
    }
    check(plunge.step(&seen(-6.9, f64::NAN)));
    for k in 0..6 {
        check(plunge.step(&seen(-6.8 + f64::from(k) * 0.1, 3.0)));
    }
    for k in 0..8 {
        check(plunge.step(&seen(0.1 * f64::from(k), 30.0)));
    }
    phases.dedup();
    let (approach, work) = (PlungePhase::Approach, PlungePhase::Work);
    assert_eq!(phases, [work, approach, work, approach, work]);
    assert!((plunge.withhold(0.0).0.feed.mm_min() - 120.0).abs() < 1e-9);
}

#[test]
fn where_the_slowest_feed_bites_too_deep_there_is_no_plunge() {
    // 0.5 mm within 4 samples of 10 ms and 20 ms of age are 500 mm/min: the machine runs no slower than that, or faster.
    assert!(Plunging::of(plunge_limits(900.0, 500.0, 3000.0, 0.5)).is_some());
    assert!(Plunging::of(plunge_limits(900.0, 501.0, 3000.0, 0.5)).is_none());
    // Answers that come later than was reckoned with, for as long as they do.
    let mut plunge = Plunging::of(plunge_limits(450.0, 400.0, 3000.0, 0.5)).unwrap();
    let seen = |k: u32, age_ms: f64| Seen { age_ms, ..plunging(-10.0 + f64::from(k) * 0.1, 450.0, 3.0) };
    for k in 0..30 {
        plunge.step(&seen(k, 5.0));
    }
    let (fast, why) = plunge.step(&seen(30, 5.0));
    assert_eq!((fast.phase, why.quality()), (PlungePhase::Approach, Quality::Good));
    assert!((fast.feed.mm_min() - 500.0).abs() < 1e-9 && (fast.bite_mm - 0.5).abs() < 1e-12);
    for k in 31..40 {
        let (late, why) = plunge.step(&seen(k, 60.0));
        assert_eq!((late.phase, late.feed.mm_min()), (PlungePhase::Work, 400.0));
        assert!(late.bite_mm > 0.5 && why.quality() == Quality::Limited);
        assert_eq!(why.codes().collect::<Vec<_>>(), ["no_plunge_feed", "bite_limited"]);
    }
    // What may not be judged is bounded, and told, in the same way.
    let (late, why) = plunge.withhold(60.0);
    assert_eq!(late.feed.mm_min(), 400.0);
    assert_eq!(why.codes().collect::<Vec<_>>(), ["no_plunge_feed", "bite_limited"]);
    let (in_time, why) = plunge.withhold(5.0);
    assert!((in_time.feed.mm_min() - 450.0).abs() < 1e-9 && why.is_empty());
    for k in 40..45 {
        plunge.step(&seen(k, 5.0));
    }
    assert_eq!(plunge.step(&seen(45, 5.0)).0.phase, PlungePhase::Approach, "in time again");
}

#[test]
fn a_plunge_goes_by_the_time_that_its_samples_tell() {
    let seen = |k: u32| plunging(-10.0 + f64::from(k) * 0.05, 400.0, 3.0);
    let fast = || {
        let mut plunge = Plunging::of(plunge_limits(450.0, 1.0, 3000.0, 0.5)).unwrap();
        for k in 0..30 {
            plunge.step(&seen(k));
        }
        assert_eq!(plunge.step(&seen(30)).0.phase, PlungePhase::Approach);
        plunge
    };
    // Twice as far apart as was told, which is no gap yet: four samples take 80 ms, and 0.5 mm in 100 are 300 mm/min.
    let mut plunge = fast();
    plunge.step_ms = 20.0;
    for k in 31..34 {
        plunge.step(&seen(k));
    }
    let (slower, why) = plunge.step(&seen(34));
    assert_eq!((slower.phase, why.quality()), (PlungePhase::Approach, Quality::Good));
    assert!((slower.feed.mm_min() - 300.0).abs() < 1e-9 && (slower.bite_mm - 0.5).abs() < 1e-12);

    // One that is late: it bites no deeper meanwhile, and is fast again once as many have come in time as confirm a contact.
    let mut plunge = fast();
    plunge.step_ms = 450.0;
    let (late, why) = plunge.step(&seen(31));
    assert_eq!(late.phase, PlungePhase::Work);
    assert_eq!(why.codes().collect::<Vec<_>>(), ["bite_limited", "settling", "gap"]);
    assert!(late.bite_mm <= 0.5 + 1e-12 && late.feed.mm_min() < 70.0, "{late:?}");
    plunge.step_ms = 10.0;
    for k in 32..35 {
        let (step, why) = plunge.step(&seen(k));
        assert_eq!(step.phase, PlungePhase::Work);
        assert!(why.codes().any(|code| code == "settling"), "{why:?}");
    }
    assert!((plunge.step(&seen(35)).0.feed.mm_min() - 500.0).abs() < 1e-9);

    // All of them ten times as far apart: never fast, and never deeper than is permitted.
    let mut plunge = Plunging::of(plunge_limits(450.0, 1.0, 3000.0, 0.5)).unwrap();
    plunge.step_ms = 100.0;
    for k in 0..60 {
        let (step, why) = plunge.step(&seen(k));
        assert_eq!(step.phase, PlungePhase::Work);
        assert!(k == 0 || why.codes().any(|code| code == "gap"), "{k}: {why:?}");
        assert!(k == 0 || step.bite_mm <= 0.5 + 1e-12, "{k}: {step:?}");
    }

    // A time that stands still, runs back or was not sent.
    for time_ms in [310.0, 300.0, -1.0, f64::NAN, f64::INFINITY] {
        let mut plunge = fast();
        let (step, why) = plunge.looped.step(&Seen { time_ms, ..seen(31) });
        assert_eq!(step.phase, PlungePhase::Work, "{time_ms}");
        assert!(why.codes().any(|code| code == "gap"), "{time_ms}: {why:?}");
    }
    // What may not be judged takes its time all the same.
    let mut plunge = fast();
    let (withheld, why) = plunge.looped.withhold(Some(760.0), 0.0);
    assert!(withheld.bite_mm <= 0.5 + 1e-12, "{withheld:?}");
    assert_eq!(why.codes().collect::<Vec<_>>(), ["bite_limited"]);
}

proptest! {
    /// Whatever comes, a feed of which it is not known to be in the work bites no deeper than is permitted, or says so.
    #[test]
    fn no_plunge_bites_deeper_than_is_permitted_without_saying_so(
        (work, least, bite_mm) in (1.0..900.0_f64, 1.0..600.0_f64, 0.05..2.0_f64),
        samples in prop::collection::vec((-12.0..1.0_f64, 0.0..200.0_f64, 0..20_u32, 5.0..60.0_f64), 1..120)
    ) {
        let limits = plunge_limits(work.max(least), least, 3000.0, bite_mm);
        let Some(mut plunge) = Plunging::of(limits) else {
            prop_assert!(least * 0.06 / 60.0 > bite_mm);
            return Ok(());
        };
        for (depth_mm, age_ms, kind, step_ms) in samples {
            plunge.step_ms = step_ms;
            let (step, reasons) = if kind == 0 {
                plunge.withhold(age_ms)
            } else {
                let load = if kind == 1 { f64::NAN } else { 3.0 };
                plunge.step(&Seen { age_ms, ..plunging(depth_mm, 500.0, load) })
            };
            prop_assert!(step.feed.mm_min() >= least);
            let too_deep = step.bite_mm > bite_mm * (1.0 + 1e-12);
            if step.contact_offset_mm.is_none() && too_deep {
                prop_assert!(reasons.contains(LoopReason::NoPlungeFeed), "{step:?} {reasons:?}");
                prop_assert!(reasons.quality() != Quality::Good && step.phase == PlungePhase::Work);
                prop_assert!((step.feed.mm_min() - least).abs() < 1e-12);
            }
            // Work that is not known to be work has a reason.
            if step.phase == PlungePhase::Work && step.contact_offset_mm.is_none() && kind > 0 {
                prop_assert!(!reasons.is_empty(), "{step:?}");
            }
        }
    }
}

#[test]
fn what_cannot_be_used_leaves_a_monitor_as_it_was() {
    let settings = ControllerSettings::new(ControllerInput::IVANOV_2024).unwrap();
    let wave = |n: u32| {
        let phase = std::f64::consts::TAU * 74.0 * f64::from(n) * 300e-6;
        VibrationSample {
            velocity_mm_s: 20.0 * phase.cos(),
            acceleration_mm_s2: -20.0 * std::f64::consts::TAU * 74.0 * phase.sin(),
        }
    };
    let mut monitor = Monitor::new(settings);
    let good = monitor.take(0, &(0..1000).map(wave).collect::<Vec<_>>());
    assert!(good.amplitude_mm > 0.05 && (good.frequency_hz - 70.86).abs() > 1.0);
    let state = |advice: super::monitor::BlockAdvice| (advice.amplitude_mm, advice.frequency_hz);
    let nothing = monitor.take(1000, &[]);
    assert_eq!((state(nothing), nothing.gain, nothing.next), (state(good), 0.0, 1000));
    assert!(nothing.reasons.contains(LoopReason::UnusableSample));
    let dead = [VibrationSample { velocity_mm_s: f64::NAN, acceleration_mm_s2: 1e200 }; 3];
    let bad = monitor.take(1000, &dead);
    assert_eq!((state(bad), bad.gain, bad.gain_range, bad.unusable), (state(good), 0.0, (0.0, 0.0), 3));
    assert!(!bad.reasons.contains(LoopReason::RepeatDiffers), "a block of nothing was no block");
    // Time went on: three samples later the wave is met where it is.
    let on = monitor.take(1003, &(1003..2000).map(wave).collect::<Vec<_>>());
    assert!(on.reasons.is_empty() && (on.frequency_hz - 74.0).abs() < 0.5, "{on:?}");
}

#[test]
fn a_monitor_answers_as_the_controller_does_and_restarts_after_a_gap() {
    let settings = ControllerSettings::new(ControllerInput::IVANOV_2024).unwrap();
    let wave = |n: u64| {
        #[expect(clippy::cast_precision_loss, reason = "a few thousand")]
        let phase = std::f64::consts::TAU * 70.0 * n as f64 * 300e-6;
        VibrationSample {
            velocity_mm_s: 20.0 * phase.cos(),
            acceleration_mm_s2: -20.0 * std::f64::consts::TAU * 70.0 * phase.sin(),
        }
    };
    let block = |from: u64| (from..from + 500).map(wave).collect::<Vec<_>>();
    let mut whole = crate::vibratory::peak_to_peak::Controller::new(settings);
    let expected: Vec<_> = (0..1000).map(|n| whole.step(wave(n)).unwrap()).collect();
    let mut monitor = Monitor::new(settings);
    let first = monitor.take(0, &block(0));
    assert_eq!((first.gain, first.amplitude_mm), (expected[499].gain, expected[499].displacement_mm));
    let second = monitor.take(500, &block(500));
    assert_eq!((second.gain, second.next), (expected[999].gain, 1000));
    assert!((second.frequency_hz - 70.0).abs() < 0.5 && second.reasons.is_empty());
    let again = monitor.take(500, &block(500));
    assert!(again.reasons.contains(LoopReason::Repeated) && again.gain == second.gain);
    let gap = monitor.take(2000, &block(0));
    assert!(gap.reasons.contains(LoopReason::MissingSamples));
    assert_eq!(gap.gain, first.gain, "it began anew");
    let bad = monitor.take(2500, &[VibrationSample { velocity_mm_s: f64::NAN, acceleration_mm_s2: 0.0 }]);
    assert_eq!((bad.gain, bad.unusable), (0.0, 1));
}

/// Something that may happen to a running cycle.
#[derive(Debug, Clone)]
enum Deed {
    /// Samples whose number is this far from the next one, after so many ms.
    Samples {
        shift: i64,
        loads: Vec<f64>,
        wait_ms: i64,
    },
    Fault,
    Acknowledge,
    Passing(bool),
}

fn load() -> impl Strategy<Value = f64> {
    prop_oneof![
        6 => 0.0..60.0_f64,
        2 => 60.0..500.0_f64,
        1 => proptest::num::f64::ANY,
        1 => Just(f64::NAN),
        1 => Just(-5.0),
    ]
}

fn deed() -> impl Strategy<Value = Deed> {
    let shift = prop_oneof![8 => Just(0_i64), 1 => -20..40_i64, 1 => Just(5000_i64)];
    let wait = prop_oneof![6 => Just(-1_i64), 1 => 0..50_i64, 1 => Just(2000_i64)];
    prop_oneof![
        12 => (shift, proptest::collection::vec(load(), 1..8), wait)
            .prop_map(|(shift, loads, wait_ms)| Deed::Samples { shift, loads, wait_ms }),
        1 => Just(Deed::Fault),
        1 => Just(Deed::Acknowledge),
        1 => proptest::bool::ANY.prop_map(Deed::Passing),
    ]
}

proptest! {
    #[test]
    fn no_input_makes_the_override_leave_its_bounds_rise_on_bad_data_or_rise_too_fast(
        deeds in proptest::collection::vec(deed(), 1..120),
    ) {
        let mut cycle = running();
        let mut now = START;
        let mut before = 100.0_f64;
        for deed in deeds {
            let (answer, each) = match &deed {
                Deed::Samples { shift, loads, wait_ms } => {
                    // As fast as the samples come, or at some other time.
                    let samples = i64::try_from(loads.len()).unwrap();
                    now += if *wait_ms < 0 { samples * 10_000 } else { wait_ms * 1000 };
                    let next = i64::try_from(cycle.record().next()).unwrap();
                    let first = u64::try_from((next + shift).max(0)).unwrap();
                    send(&mut cycle, Timestamp::from_micros(now), first, loads)
                }
                Deed::Fault => (cycle.fault(Timestamp::from_micros(now), LoopReason::Malformed), vec![]),
                Deed::Acknowledge => {
                    cycle.acknowledge();
                    (cycle.standing(Timestamp::from_micros(now)), vec![])
                }
                Deed::Passing(on) => {
                    cycle.set_passing(if *on { LoopReasons::of(LoopReason::LeaseUnknown) } else { LoopReasons::NONE });
                    (cycle.standing(Timestamp::from_micros(now)), vec![])
                }
            };
            let ovr = answer.ovr.percent();
            prop_assert!((20.0..=150.0).contains(&ovr), "{deed:?} gives {ovr}");
            let mut in_force = before;
            for advice in &each {
                if advice.reasons.contains(LoopReason::Repeated) {
                    continue;
                }
                let next = advice.ovr.percent();
                prop_assert!(next <= in_force + 5.0 + 1e-9, "{deed:?}: {in_force} to {next}");
                let judged = advice.reasons.has_law(Reason::LoadBelowSet)
                    || advice.reasons.has_law(Reason::LoadAtSet)
                    || advice.reasons.has_law(Reason::LoadAboveSet);
                if judged {
                    prop_assert!(advice.reasons.has_law(Reason::LoadBelowSet) || next <= in_force);
                } else {
                    prop_assert!(next <= in_force.min(100.0), "{deed:?}: {:?}", advice.reasons.codes().collect::<Vec<_>>());
                }
                prop_assert!(!advice.reasons.is_empty(), "an answer without a reason");
                in_force = next;
            }
            if !each.is_empty() {
                prop_assert_eq!(in_force.to_bits(), ovr.to_bits());
            }
            if matches!(deed, Deed::Fault) {
                prop_assert!(ovr <= before.min(100.0));
            }
            before = ovr;
        }
    }
}

/// A cycle of this heating time (ms) whose law only knows its loads.
fn running_with_heating(heating_ms: f64) -> RunningCycle {
    let (machine, operation, program) = (machine(), operation(Process::Friction), program());
    let settings_of_law = LawSettings { heating_ms, ..law(OverloadHold::Off) };
    let standing = standing(&machine, &operation, &program);
    let control = control(&standing, &settings_of_law, PERIOD_MS, None).unwrap();
    let timing = Timing::Period { period_ms: PERIOD_MS };
    RunningCycle::new(begun(), control, (CHANNELS.to_vec(), timing), (Mode::Advise, settings()))
}

/// Goes from a depth (mm) to another at the program's feed under the override in force, at one load, and returns each answer
/// with its depth.
fn moved(
    cycle: &mut RunningCycle,
    (from, to): (f64, f64),
    load: f64,
) -> Vec<(f64, FeedOverride, LoopReasons)> {
    let (mut depth, mut ovr) = (from, 100.0);
    let mut answers = Vec::new();
    while depth < to {
        depth = (depth + (100.0 + 20.0 * depth) * ovr / 100.0 / 60.0 * 0.01).min(to);
        let (answered, reasons) = drilled(cycle, &[(depth, load)])[0];
        ovr = answered.percent();
        answers.push((depth, answered, reasons));
    }
    answers
}

fn drawn_back(cycle: &mut RunningCycle, from: f64, to: f64) {
    let steps = std::iter::successors(Some(from - 0.05), |depth| Some(depth - 0.05));
    let steps: Vec<(f64, f64)> = steps.take_while(|depth| *depth >= to).map(|depth| (depth, 3.0)).collect();
    drilled(cycle, &steps);
}

/// In the last half millimetre above the bottom nothing loads the tool yet: a law that took that for the work would meet it at
/// the fastest feed that it permits.
#[test]
fn a_tool_that_comes_back_to_the_bottom_is_not_faster_before_it_meets_the_work() {
    let mut cycle = running_with_heating(0.0);
    moved(&mut cycle, (0.0, 3.0), 29.97);
    drawn_back(&mut cycle, 3.0, 1.0);
    let back = moved(&mut cycle, (1.0, 3.0), 3.0);
    let in_air = back.iter().filter(|(depth, ..)| *depth < 3.0 - 0.02);
    for (depth, ovr, reasons) in in_air {
        assert!(ovr.percent() <= 100.0, "{depth} mm: {ovr:?}");
        let settles = reasons.has_law(Reason::Settling);
        assert_eq!(settles, *depth > 2.5, "{depth} mm: {reasons:?}");
    }
    // At the work the filters begin with what is read there, and the law rises once good samples have come.
    let work = moved(&mut cycle, (3.0, 3.3), 20.0);
    assert!(work[0].1.percent() <= 100.0, "{:?}", work[0]);
    assert!(work.last().unwrap().1.percent() > 120.0, "{:?}", work.last());
}

#[test]
fn what_loads_a_tool_on_its_way_back_to_the_bottom_lowers_at_once() {
    let mut cycle = running_with_heating(0.0);
    moved(&mut cycle, (0.0, 3.0), 29.97);
    drawn_back(&mut cycle, 3.0, 1.0);
    moved(&mut cycle, (1.0, 2.6), 3.0);
    let chips = moved(&mut cycle, (2.6, 2.9), 60.0);
    assert!(chips.last().unwrap().1.percent() < 50.0, "{:?}", chips.last());
}

/// Nobody saw the tool being drawn back; what comes next may be on its way down through its own hole.
#[test]
fn after_samples_that_were_not_judged_the_law_rises_only_from_the_deepest() {
    let mut cycle = running_with_heating(0.0);
    moved(&mut cycle, (0.0, 3.0), 29.97);
    let missing = vec![(2.8, f64::NAN); 20];
    drilled(&mut cycle, &missing);
    let back = moved(&mut cycle, (2.6, 3.0), 3.0);
    assert!(back.iter().filter(|(depth, ..)| *depth < 2.98).all(|(_, ovr, _)| ovr.percent() <= 100.0));
    let work = moved(&mut cycle, (3.0, 3.3), 20.0);
    assert!(work.last().unwrap().1.percent() > 120.0, "{:?}", work.last());
}

#[test]
fn what_the_tool_is_out_of_the_work_does_not_heat_it() {
    let mut cycle = running_with_heating(2000.0);
    let heats = |reasons: &LoopReasons| reasons.has_law(Reason::Heating);
    let before = moved(&mut cycle, (0.0, 2.0), 20.0);
    assert!(before.len() < 120 && before.iter().all(|(.., reasons)| heats(reasons)));
    drawn_back(&mut cycle, 2.0, 0.5);
    // Two seconds out, more than what is left of the heating.
    drilled(&mut cycle, &vec![(0.5, 3.0); 200]);
    let back = moved(&mut cycle, (0.5, 2.0), 3.0);
    assert!(back.iter().all(|(.., reasons)| heats(reasons)));
    let work = moved(&mut cycle, (2.0, 6.0), 20.0);
    let heated = before.len() + work.iter().filter(|(.., reasons)| heats(reasons)).count();
    // Ten samples of the way out were no retreat yet.
    assert!((188..=202).contains(&heated), "2 s at the work, {heated} samples");
}

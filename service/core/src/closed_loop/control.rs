//! What answers a sample that may be judged: one enum over the processes.

use super::plunge::{PlungeLoop, PlungeStep};
use super::profile::RunProfile;
use super::reason::{LoopReason, LoopReasons};
use crate::cycle::Channel;
use crate::feed::choose::lower;
use crate::friction::error::Invalid;
use crate::friction::feed_override::{FeedOverride, HIGHEST_OVERRIDE_PERCENT, OverrideBounds, OverrideRange};
use crate::friction::filter::FilterWeights;
use crate::friction::law::{self, Heating, LawConfig, LawParams, LawSample, LawState, OverloadHold};
use crate::friction::program::FeedProgram;
use crate::machine::{FeedLimits, LoadReference, Machine};
use crate::operation::Operation;
use crate::units::Process;
use crate::wear::ToolState;

/// Version of the law and of the envelope around it, part of every answer.
pub const LOOP_LAW_VERSION: &str = "fac-2";

/// A tip that is so much above the deepest that it has been is drawn back, mm: less is no retreat, but how a position is
/// read and an axis settles.
const DRAWN_BACK_MM: f64 = 0.5;

/// A tip that was drawn back is at the work again where it is less than so much above the deepest that it has been, mm: what
/// an encoder's noise takes off. Above it the tip is in its own hole, in air.
const AT_DEEPEST_MM: f64 = 0.02;

/// How the law is set; from the configuration, checked when a cycle begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LawSettings {
    /// Intensity b of Eq. 3.
    pub intensity: f64,
    /// Largest rise per IPO, points.
    pub rise_limit_points: f64,
    /// The law is off for so long after the cycle's start, ms.
    pub heating_ms: f64,
    /// Good samples in a row, after a bad one, before the law may raise again.
    pub settling_samples: u32,
    /// What an overload does.
    pub overload: OverloadHold,
    /// The overrides that a program without limits of its own permits, percent.
    pub program_range: (f64, f64),
}

impl LawSettings {
    /// The law for a machine that samples every `period_ms` and whose interpolator takes `ipo_period_ms`, without preferred loads.
    pub fn params(&self, bounds: OverrideBounds, period_ms: f64, ipo_period_ms: f64) -> LawParams {
        LawParams {
            weights: FilterWeights::default(),
            set_feed_drive_percent: None,
            set_spindle_percent: None,
            intensity: self.intensity,
            bounds,
            // Sampling faster than the interpolator must not make the override rise faster.
            rise_limit_points: Some(self.rise_limit_points * (period_ms / ipo_period_ms).min(1.0)),
            heating: if self.heating_ms > 0.0 {
                Heating::Time { ms: self.heating_ms }
            } else {
                Heating::None
            },
            period_ms,
            longest_gap_ms: longest_gap_ms(period_ms),
            settling_samples: self.settling_samples,
            overload: self.overload,
        }
    }
}

/// The feed that the cycle runs.
#[derive(Debug, Clone, PartialEq)]
pub enum Program {
    /// None was named.
    Unknown,
    /// A program that the machine told, with the overrides it permits, percent.
    Told {
        /// Programmed feed over depth.
        program: FeedProgram,
        /// Least and greatest override, percent; the settings' where it has none.
        range: Option<(f64, f64)>,
    },
    /// The active version of a feed profile.
    Profile(Box<RunProfile>),
    /// A feed profile that may not be relied on, with the reason.
    Refused(LoopReason),
}

/// What is known when a cycle begins.
#[derive(Debug, Clone, Copy)]
pub struct Standing<'a> {
    /// The machine.
    pub machine: &'a Machine,
    /// The operation, where it is registered.
    pub operation: Option<&'a Operation>,
    /// State of the tool; `None` where it is not registered.
    pub tool: Option<ToolState>,
    /// The feed that the cycle runs.
    pub program: &'a Program,
    /// Whether an overload of the machine waits to be acknowledged.
    pub overload_open: bool,
    /// Whether the cycle says that it runs at a constant feed, as a reference cycle does: an override would falsify what is
    /// learnt from it.
    pub constant_feed: bool,
    /// The process that the cycle names, where it does.
    pub process: Option<Process>,
}

/// Where the law finds its inputs among the channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Inputs {
    depth: Option<usize>,
    feed_drive: Option<usize>,
    spindle: Option<usize>,
    programmed: Option<usize>,
    actual: Option<usize>,
}

impl Inputs {
    /// Finds them.
    #[must_use]
    pub fn among(channels: &[Channel]) -> Self {
        let at = |wanted: Channel| channels.iter().position(|channel| *channel == wanted);
        Self {
            depth: at(Channel::DepthMm),
            feed_drive: at(Channel::FeedDriveLoadPercent),
            spindle: at(Channel::SpindleLoadPercent),
            programmed: at(Channel::FeedProgrammedMmMin),
            actual: at(Channel::FeedActualMmMin),
        }
    }
}

/// One sample as the control sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Time since the start of the cycle, ms.
    pub time_ms: f64,
    /// Its age, ms.
    pub age_ms: f64,
    /// Depth, mm.
    pub depth_mm: Option<f64>,
    /// Feed-drive load, percent.
    pub feed_drive_percent: Option<f64>,
    /// Spindle load, percent.
    pub spindle_percent: Option<f64>,
    /// Programmed feed, mm/min.
    pub programmed_mm_min: Option<f64>,
    /// Actual feed, mm/min.
    pub actual_mm_min: Option<f64>,
}

impl Seen {
    /// Sample `i` of `count`, column after column.
    #[must_use]
    pub fn of(inputs: &Inputs, values: &[f64], count: usize, i: usize, time_ms: f64, age_ms: f64) -> Self {
        let value = |at: Option<usize>| at.map(|c| values[c * count + i]);
        Self {
            time_ms,
            age_ms,
            depth_mm: value(inputs.depth),
            feed_drive_percent: value(inputs.feed_drive),
            spindle_percent: value(inputs.spindle),
            programmed_mm_min: value(inputs.programmed),
            actual_mm_min: value(inputs.actual),
        }
    }

    const fn as_law_sample(&self, contact_ms: Option<f64>) -> LawSample {
        LawSample {
            time_ms: self.time_ms,
            contact_ms,
            depth_mm: self.depth_mm,
            feed_drive_percent: self.feed_drive_percent,
            spindle_percent: self.spindle_percent,
        }
    }
}

/// A sample that comes so many periods after the one before it comes after a gap.
const LONGEST_GAP_PERIODS: f64 = 2.5;

/// The longest time, ms, between two samples of that period that is no gap.
#[must_use]
pub fn longest_gap_ms(period_ms: f64) -> f64 {
    LONGEST_GAP_PERIODS * period_ms
}

/// The adaptive law with the program that it multiplies.
#[derive(Debug, Clone)]
pub struct FrictionLoop {
    config: LawConfig,
    state: LawState,
    program: Option<FeedProgram>,
    /// The slowest and the fastest feed that machine and profile permit, mm/min.
    feeds_mm_min: (f64, f64),
    /// When the tip first was at the work, where its depth is sampled.
    contact_at_ms: Option<f64>,
    /// The deepest that it has been, mm.
    deepest_mm: f64,
    /// Whether it may be in the air of its own hole: it was drawn back, or nobody knows where it was meanwhile, and since then
    /// it has not been at the deepest again.
    returning: bool,
    /// Time between contact and now in which it was not at the work, ms: nothing heats the material then.
    away_ms: f64,
    /// The last sample that was judged: its time, ms, and whether the tip was at the work.
    judged: Option<(f64, bool)>,
}

/// What answers samples.
#[derive(Debug, Clone)]
pub enum Control {
    /// Friction drilling: the adaptive law (Stryczek & Błaszczak 2020).
    Friction(Box<FrictionLoop>),
    /// Plunge: feeds by contact and breakthrough (Lengerov); the override stays neutral.
    Plunge(Box<PlungeLoop>),
    /// Nothing closes a loop: the override stays neutral.
    Neutral,
}

/// The control of a cycle that begins, with the reasons for which it stays neutral and those that only cap it.
///
/// # Errors
/// Settings that the law refuses.
pub fn control(
    standing: &Standing<'_>,
    settings: &LawSettings,
    period_ms: f64,
    plunge: Option<PlungeLoop>,
) -> Result<(Control, LoopReasons, LoopReasons), Invalid> {
    let mut neutral = LoopReasons::NONE;
    let mut capped = LoopReasons::NONE;
    match standing.tool {
        None => neutral.add(LoopReason::ToolUnregistered),
        Some(ToolState::BrokenSuspected) => neutral.add(LoopReason::BrokenSuspected),
        Some(ToolState::Changed) => neutral.add(LoopReason::ConditionsChanged),
        Some(ToolState::Worn) => capped.add(LoopReason::ToolWorn),
        Some(ToolState::Unknown | ToolState::Learning | ToolState::Good | ToolState::Warning) => {}
    }
    if standing.overload_open {
        neutral.add(LoopReason::OverloadUnacknowledged);
    }
    let Some(operation) = standing.operation else {
        neutral.add(LoopReason::OperationUnregistered);
        return Ok((Control::Neutral, neutral, capped));
    };
    if standing.process.is_some_and(|process| process != operation.process) {
        neutral.add(LoopReason::NoLaw);
        return Ok((Control::Neutral, neutral, capped));
    }
    match operation.process {
        Process::Friction if standing.constant_feed => {
            neutral.add(LoopReason::NoLaw);
            return Ok((Control::Neutral, neutral, capped));
        }
        Process::Friction => {}
        Process::Plunge => {
            let Some(plunge) = plunge else {
                neutral.add(LoopReason::NoPlungeFeed);
                return Ok((Control::Neutral, neutral, capped));
            };
            return Ok((Control::Plunge(Box::new(plunge)), neutral, capped));
        }
        Process::Drilling | Process::Turning | Process::Vibratory | Process::Milling => {
            neutral.add(LoopReason::NoLaw);
            return Ok((Control::Neutral, neutral, capped));
        }
    }
    let (mut feed_drive, mut spindle) =
        (operation.feed_drive_load_set_percent, operation.spindle_load_set_percent);
    let limits = &standing.machine.limits;
    let mut feeds_mm_min = (limits.min_mm_min(), limits.max_mm_min());
    let program = match standing.program {
        Program::Told { program, range } => Some((program, range.unwrap_or(settings.program_range))),
        Program::Profile(profile) => {
            capped = capped.and(profile.capped);
            feed_drive = lower(feed_drive, profile.set_feed_drive_percent);
            spindle = lower(spindle, profile.set_spindle_percent);
            let (slowest, fastest) = profile.feeds_mm_min;
            feeds_mm_min = (feeds_mm_min.0.max(slowest), feeds_mm_min.1.min(fastest));
            Some((&profile.program, profile.range))
        }
        Program::Unknown => {
            neutral.add(LoopReason::NoProgram);
            None
        }
        Program::Refused(why) => {
            neutral.add(*why);
            None
        }
    };
    // A preferred load that somebody declared is a limit; without knowing what its percent means it cannot be kept.
    let unrated = |set: Option<f64>, reference| set.is_some() && reference == LoadReference::Unknown;
    if unrated(feed_drive, standing.machine.feed_drive.reference)
        || unrated(spindle, standing.machine.spindle.reference)
    {
        neutral.add(LoopReason::UnknownRating);
    }
    if feed_drive.is_none() && spindle.is_none() {
        neutral.add(LoopReason::NoSetLoad);
        return Ok((Control::Neutral, neutral, capped));
    }
    let (low, high) = program.map_or(settings.program_range, |(_, range)| range);
    let ceiling = if capped.is_empty() { high } else { 100.0 };
    let profile = OverrideRange::new(low, ceiling)?;
    let bounds = OverrideBounds::new(range_of(&standing.machine.limits)?, profile);
    let config = LawConfig::new(LawParams {
        set_feed_drive_percent: feed_drive,
        set_spindle_percent: spindle,
        ..settings.params(bounds, period_ms, standing.machine.ipo_period_ms)
    })?;
    let program = program.map(|(program, _)| program.clone());
    let mut state = LawState::new();
    if standing.overload_open {
        // The tool that nobody has looked at may meet the same load again: the law may lower, and not raise.
        neutral = neutral.without(LoopReason::OverloadUnacknowledged);
        capped.add(LoopReason::OverloadUnacknowledged);
        state = state.held();
    }
    Ok((
        Control::Friction(Box::new(FrictionLoop {
            config,
            state,
            program,
            feeds_mm_min,
            contact_at_ms: None,
            deepest_mm: f64::NEG_INFINITY,
            returning: false,
            away_ms: 0.0,
            judged: None,
        })),
        neutral,
        capped,
    ))
}

/// The overrides that a machine permits.
///
/// # Errors
/// None that contain 100.
pub fn range_of(limits: &FeedLimits) -> Result<OverrideRange, Invalid> {
    OverrideRange::new(
        limits.override_min_percent(),
        limits.override_max_percent().min(HIGHEST_OVERRIDE_PERCENT),
    )
}

impl Control {
    /// The override in force.
    #[must_use]
    pub const fn in_force(&self) -> FeedOverride {
        match self {
            Self::Friction(friction) => friction.state.ovr(),
            Self::Plunge(_) | Self::Neutral => FeedOverride::NEUTRAL,
        }
    }

    /// Judges one sample.
    pub fn step(&mut self, seen: &Seen) -> (FeedOverride, LoopReasons, Option<PlungeStep>) {
        match self {
            Self::Friction(friction) => {
                let (ovr, reasons) = friction.step(seen);
                (ovr, reasons, None)
            }
            Self::Plunge(plunge) => {
                let (step, reasons) = plunge.step(seen);
                (FeedOverride::NEUTRAL, reasons, Some(step))
            }
            Self::Neutral => (FeedOverride::NEUTRAL, LoopReasons::NONE, None),
        }
    }

    /// Looks for an overload in a sample that may not be judged; says so where it is one.
    pub fn watch(&mut self, seen: &Seen) -> LoopReasons {
        match self {
            Self::Friction(friction) => friction.watch(seen),
            Self::Plunge(_) | Self::Neutral => LoopReasons::NONE,
        }
    }

    /// Passes a sample that may not be judged: neutral. The reasons are those of what is done instead.
    pub fn withhold(
        &mut self,
        time_ms: Option<f64>,
        age_ms: f64,
    ) -> (FeedOverride, LoopReasons, Option<PlungeStep>) {
        match self {
            Self::Friction(friction) => (friction.withhold(time_ms), LoopReasons::NONE, None),
            Self::Plunge(plunge) => {
                let (step, reasons) = plunge.withhold(time_ms, age_ms);
                (FeedOverride::NEUTRAL, reasons, Some(step))
            }
            Self::Neutral => (FeedOverride::NEUTRAL, LoopReasons::NONE, None),
        }
    }

    /// Goes on in the midst of a cycle whose memory was lost, at the override that the machine says is in force.
    pub fn resume_at(&mut self, in_force_percent: f64) {
        if let Self::Friction(friction) = self {
            friction.state = friction.state.resuming(&friction.config, in_force_percent);
        }
    }

    /// Somebody has acknowledged the overload.
    pub fn acknowledge(&mut self) {
        if let Self::Friction(friction) = self {
            friction.state.acknowledge(&friction.config);
        }
    }

    /// Whether an overload of this cycle still holds the override.
    #[must_use]
    pub const fn is_overloaded(&self) -> bool {
        match self {
            Self::Friction(friction) => friction.state.is_overloaded(),
            Self::Plunge(_) | Self::Neutral => false,
        }
    }

    /// Least and greatest override that may be answered, percent; `None` where it is always neutral.
    pub fn bounds_percent(&self) -> Option<(f64, f64)> {
        match self {
            Self::Friction(friction) => {
                let range = friction.config.params().bounds.effective();
                Some((range.min_percent(), range.max_percent()))
            }
            Self::Plunge(_) | Self::Neutral => None,
        }
    }
}

impl FrictionLoop {
    fn step(&mut self, seen: &Seen) -> (FeedOverride, LoopReasons) {
        let why = if seen.depth_mm.is_some_and(|depth| !depth.is_finite()) {
            // Where the tip is decides what the program says there, and whether it is in the work at all.
            let mut why = law::Reasons::default();
            why.add(law::Reason::UnknownDepth);
            Some(why.into())
        } else {
            self.strays(seen).then(|| LoopReasons::of(LoopReason::ProgramMismatch))
        };
        if let Some(why) = why {
            let reasons = self.watch(seen).and(why);
            return (self.withhold(Some(seen.time_ms)), reasons);
        }
        self.note_contact(seen);
        if self.returning {
            // In the air of the hole a light load says nothing about the work; a heavy one is met all the same.
            self.state.settle(&self.config);
        }
        let sample = seen.as_law_sample(self.contact_ms(seen));
        let before = self.state.ovr();
        let mut step = self.state.step(&self.config, &sample);
        if step.relative_load.is_none() {
            self.lose_sight();
        }
        // The law acted: a neutral override stays exactly neutral.
        if let (Some(_), Some(permitted)) = (step.correction, self.permitted_percent(seen)) {
            self.state.keep_within_feed(&self.config, permitted, before, &mut step);
        }
        (step.ovr, step.reasons.into())
    }

    /// Takes a sample that may not be judged.
    fn withhold(&mut self, time_ms: Option<f64>) -> FeedOverride {
        self.lose_sight();
        self.state.withhold(&self.config, time_ms)
    }

    /// Where the tip is until the next sample that may be judged, nobody knows: it may be drawn back.
    fn lose_sight(&mut self) {
        self.returning |= self.deepest_mm >= 0.0;
    }

    /// Notes where the tip is and when it first is at the work, by samples that may be judged: a wrong stamp must not end the
    /// heating.
    fn note_contact(&mut self, seen: &Seen) {
        let Some(depth) = seen.depth_mm.filter(|_| seen.time_ms.is_finite()) else { return };
        let was_at_work = self.deepest_mm >= 0.0;
        if self.returning && depth >= self.deepest_mm - AT_DEEPEST_MM {
            self.returning = false;
            // What the drives read on the way through the hole is no memory of the work.
            self.state.begin_anew(&self.config);
        } else if was_at_work && (depth < 0.0 || depth < self.deepest_mm - DRAWN_BACK_MM) {
            self.returning = true;
        }
        self.deepest_mm = self.deepest_mm.max(depth);
        let at_work = depth >= 0.0 && !self.returning;
        if depth >= 0.0 {
            self.contact_at_ms.get_or_insert(seen.time_ms);
        }
        if let Some((before_ms, was_at_work)) = self.judged
            && self.contact_at_ms.is_some_and(|at| before_ms >= at)
            && !(was_at_work && at_work)
        {
            self.away_ms += seen.time_ms - before_ms;
        }
        self.judged = Some((seen.time_ms, at_work));
    }

    /// Time that the tip was at the work, ms: since the start of the cycle where depth is not sampled. `None` while it is above
    /// the work or drawn back in the hole: that nothing loads it there says nothing about the work.
    fn contact_ms(&self, seen: &Seen) -> Option<f64> {
        match seen.depth_mm {
            None => Some(seen.time_ms),
            Some(depth) if depth < 0.0 || depth < self.deepest_mm - DRAWN_BACK_MM => None,
            Some(_) => self.contact_at_ms.map(|at| seen.time_ms - at - self.away_ms),
        }
    }

    /// The overrides, in percent, under which the programmed feed at this depth stays within the permitted feeds; where the
    /// depth is not sampled, anywhere in the program.
    fn permitted_percent(&self, seen: &Seen) -> Option<(f64, f64)> {
        let program = self.program.as_ref()?;
        let (slowest, fastest) = match seen.depth_mm {
            Some(depth) => (program.feed_at(depth), program.feed_at(depth)),
            None => program.knots().iter().fold((f64::INFINITY, 0.0_f64), |(slowest, fastest), knot| {
                (slowest.min(knot.feed_mm_min), fastest.max(knot.feed_mm_min))
            }),
        };
        Some((100.0 * self.feeds_mm_min.0 / slowest, 100.0 * self.feeds_mm_min.1 / fastest))
    }

    fn watch(&mut self, seen: &Seen) -> LoopReasons {
        // Also by what came too late to be judged, as where a cycle goes on at another server: the hole is as deep as it was cut.
        if let Some(depth) = seen.depth_mm.filter(|depth| depth.is_finite()) {
            self.deepest_mm = self.deepest_mm.max(depth);
        }
        let mut reasons = law::Reasons::default();
        let contact_ms = self.contact_ms(seen);
        if self.state.watch(&self.config, &seen.as_law_sample(contact_ms)) {
            reasons.add(law::Reason::Overload);
        }
        reasons.into()
    }

    /// Whether the machine runs another feed than the program's at this depth: then it is another program.
    fn strays(&self, seen: &Seen) -> bool {
        let (Some(program), Some(depth), Some(feed)) = (&self.program, seen.depth_mm, seen.programmed_mm_min)
        else {
            return false;
        };
        if !depth.is_finite() || !feed.is_finite() || depth < 0.0 {
            // Above the work the approach has a feed of its own; what is not a number is the law's to refuse.
            return false;
        }
        program.strays(depth, feed)
    }
}

//! What to run next, and why: a pure function of the tool's verdict and of what is registered.
//!
//! Between cycles neutral is exactly 100 % of the programmed feed. Unknown never raises the feed: without an active feed
//! profile that fits, a recommendation is neutral and says why.

mod process;
#[cfg(test)]
mod tests;

pub use process::{
    EdgeCycle, EdgeHistory, Knowledge, MAX_EDGE_CYCLES, PlungeAdvice, ProcessAdvice, TurningAdvice,
    TurningNext,
};

use crate::cycle::ProfileVersion;
use crate::feed::choose::{ActiveProfile, ProfileAdvice, choose, lower};
use crate::ids::{MachineId, OperationId, REFERENCE_ID_ENDING, ToolId};
use crate::machine::{FeedLimits, Machine};
use crate::operation::Operation;
use crate::units::{Process, Timestamp};
use crate::wear::{Level, Remaining, ToolState, Verdict};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Version of the rules below; part of every recommendation.
pub const LAW_VERSION: &str = "profile-2";

/// The override that leaves the programmed feed as it is, %.
pub const NEUTRAL_OVERRIDE_PERCENT: f64 = 100.0;

/// How long a recommendation and its data stay good.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecommendSettings {
    /// A recommendation is valid for so long, ms.
    pub validity_ms: i64,
    /// Data older than this is stale, ms.
    pub stale_after_ms: i64,
}

impl Default for RecommendSettings {
    fn default() -> Self {
        // A quarter of an hour covers the gap between two cycles; a shift without a cycle is stale.
        Self { validity_ms: 15 * 60 * 1000, stale_after_ms: 12 * 3600 * 1000 }
    }
}

/// What is asked, and what is known about it.
#[derive(Debug, Clone, Copy)]
pub struct Question<'a> {
    /// Now.
    pub now: Timestamp,
    /// The machine that will run the cycle.
    pub machine: &'a Machine,
    /// The operation's id as it was asked for.
    pub operation_id: &'a OperationId,
    /// The operation, where it is registered.
    pub operation: Option<&'a Operation>,
    /// The tool's id as it was asked for.
    pub tool_id: &'a ToolId,
    /// Whether the tool is registered.
    pub tool_registered: bool,
    /// The verdict on the tool.
    pub verdict: &'a Verdict,
    /// What is known for the operation's process beside its energy.
    pub knowledge: &'a Knowledge,
    /// Active feed profiles of the operation and the tool's type.
    pub profiles: &'a [ActiveProfile],
    /// The profile version that the cycle named which is being answered.
    pub ran: Option<&'a ProfileVersion>,
    /// What of all this was found damaged where it is stored. None of it is to be decided by: instead of the machine stands
    /// [`Machine::unknown`], instead of the rest nothing.
    pub damaged: &'a [Damaged],
    /// How long things stay good.
    pub settings: RecommendSettings,
}

/// What people registered and a disk has changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Damaged {
    /// The machine: its limits and what its loads refer to.
    Machine,
    /// The machine's newest fitted lines.
    Calibration,
    /// The operation.
    Operation,
    /// The tool.
    Tool,
    /// The library entry that the operation names.
    Model,
    /// A feed profile for the operation and the tool's type.
    FeedProfile,
}

impl Damaged {
    /// As a sentence names it.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Machine => "machine",
            Self::Calibration => "machine's calibration",
            Self::Operation => "operation",
            Self::Tool => "tool",
            Self::Model => "operation's library entry",
            Self::FeedProfile => "feed profile",
        }
    }
}

/// What the shop should do before or while running the next cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Run on.
    Run,
    /// The tool is worn: change it.
    ChangeTool,
    /// The tool may be broken: look before the next cycle.
    CheckTool,
    /// Conditions changed: an engineer confirms or changes the tool.
    ConfirmConditions,
}

impl Action {
    /// The word used in the API.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Run => "run",
            Self::ChangeTool => "change_tool",
            Self::CheckTool => "check_tool",
            Self::ConfirmConditions => "confirm_conditions",
        }
    }

    /// The action of that word.
    pub fn parse(text: &str) -> Option<Self> {
        [Self::Run, Self::ChangeTool, Self::CheckTool, Self::ConfirmConditions]
            .into_iter()
            .find(|action| action.as_str() == text)
    }
}

/// How good the data behind a recommendation is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DataQuality {
    /// A complete baseline and recent cycles.
    Good,
    /// Too few cycles yet, or conditions that are to be confirmed.
    Limited,
    /// The last cycle that counted, or where none did the last one, is older than data stays good.
    Stale,
    /// No cycle at all: the tool has run none that is known.
    Missing,
}

impl DataQuality {
    /// The word used in the API.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Limited => "limited",
            Self::Stale => "stale",
            Self::Missing => "missing",
        }
    }

    /// The quality of that word.
    pub fn parse(text: &str) -> Option<Self> {
        [Self::Good, Self::Limited, Self::Stale, Self::Missing]
            .into_iter()
            .find(|quality| quality.as_str() == text)
    }
}

/// A reference cycle that is asked for: one constant feed, no override, so that like is measured with like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceRequest {
    /// One is asked for after so many cycles.
    pub every: u32,
    /// The feed to run, mm/min; `None` where the operation declares none: the one that reference cycles ran before.
    pub feed_mm_min: Option<f64>,
}

/// What to run next, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct Recommendation {
    /// When it was made.
    pub issued_at: Timestamp,
    /// It must not be used after this.
    pub valid_until: Timestamp,
    /// For which machine.
    pub machine: MachineId,
    /// For which operation.
    pub operation: OperationId,
    /// For which tool.
    pub tool: ToolId,
    /// Which process; `None` where the operation is not registered.
    pub process: Option<Process>,
    /// What to do.
    pub action: Action,
    /// Programmed feed to run, mm/min, within the machine's limits; `None` where it is not known: run the program.
    pub feed_mm_min: Option<f64>,
    /// Override to run, %; between cycles exactly 100.
    pub override_percent: f64,
    /// The feed profile to run instead of one feed; none where no active one fits, as the reasons say.
    pub profile: Option<ProfileAdvice>,
    /// Limits that hold whatever the control does: the machine's, and the profile's where one is to be run.
    pub limits: FeedLimits,
    /// Set load of the spindle drive, %: the lower of the operation's and the profile's.
    pub spindle_load_set_percent: Option<f64>,
    /// Set load of the feed drive, %, likewise.
    pub feed_drive_load_set_percent: Option<f64>,
    /// The tool's state.
    pub tool_state: ToolState,
    /// The tool's level, where there is one.
    pub level: Option<Level>,
    /// Cycles that remain, where that can be told.
    pub remaining: Option<Remaining>,
    /// How good the data is.
    pub quality: DataQuality,
    /// Age of the tool's last cycle that counted, and only where none did of its last one, ms; `None` where there is no cycle.
    pub data_age_ms: Option<i64>,
    /// What the operation's process adds, where the operation asks for it and enough is known.
    pub process_advice: Option<ProcessAdvice>,
    /// The next cycle should be a reference cycle; `None` where it need not be.
    pub reference_cycle: Option<ReferenceRequest>,
    /// Why: a stable code and a sentence each; never empty.
    pub reasons: Vec<(String, String)>,
    /// Version of the rules that made it.
    pub law_version: String,
}

impl Recommendation {
    /// How its id has to end: a cycle that names it then says by itself whether it was asked for as a reference.
    pub const fn id_ending(&self) -> &'static str {
        if self.reference_cycle.is_some() { REFERENCE_ID_ENDING } else { "" }
    }
}

/// Recommends what to run next.
pub fn recommend(question: &Question<'_>) -> Recommendation {
    let Question { now, machine, operation, verdict, settings, .. } = *question;
    let mut reasons: Vec<(String, String)> = Vec::new();
    let mut say = |code: &str, why: &str| reasons.push((code.to_owned(), why.to_owned()));

    let data_age_ms = verdict.age_ms(now);
    let quality = quality(verdict, data_age_ms, settings);
    let stale = quality == DataQuality::Stale;
    let mut action = action(verdict.state);
    let damaged = damaged(question);
    for what in &damaged {
        let what = what.as_str();
        say(
            "registered_data_damaged",
            &format!(
                "what is stored of the {what} is damaged: run the program as it is until it is put anew"
            ),
        );
    }
    let is_damaged = !damaged.is_empty();
    let profile = if is_damaged { None } else { profile(question, action, stale, &mut say) };
    if !question.tool_registered {
        say("tool_unregistered", "the tool is not registered: its cycles are kept and counted once it is");
    }
    let mut feed = None;
    match operation {
        _ if is_damaged => {}
        None => say("operation_unregistered", "the operation is not registered: run its program as it is"),
        Some(operation) => match operation.programmed_feed_mm_min {
            None => say("no_programmed_feed", "the operation declares no feed: run its program as it is"),
            Some(programmed) => {
                let limits = &machine.limits;
                let held = programmed.clamp(limits.min_mm_min(), limits.max_mm_min());
                if held < programmed {
                    say("clamped_to_feed_max", "the programmed feed is above the machine's limit");
                } else if held > programmed {
                    // Raising a feed that someone programmed is not ours to do: name it and leave it.
                    say(
                        "below_feed_min",
                        "the programmed feed is below the machine's limit: run the program as it is",
                    );
                }
                feed = (held <= programmed).then_some(held);
            }
        },
    }
    for (code, why) in &verdict.reasons {
        say(code, why);
    }
    if stale {
        say("data_stale", "the tool's last cycle that counted is older than data stays good");
    }
    let process_advice = operation.filter(|_| !is_damaged).and_then(|operation| {
        held(&mut action, &mut say, |action, say| process::advise(question, operation, stale, action, say))
    });
    let reference_cycle = if is_damaged { None } else { reference_cycle(question, action, &mut say) };
    // Whoever runs the profile runs it within what was set for it as well.
    let of_profile = profile.map(|one| one.profile.limits());
    let limits = of_profile.map_or(machine.limits, |own| {
        let overrides_percent = (own.override_min_percent, own.override_max_percent);
        machine.limits.within((own.feed_min_mm_min, own.feed_max_mm_min), overrides_percent)
    });
    let set_load = |of_operation: fn(&Operation) -> Option<f64>, of_profile: Option<f64>| {
        lower(operation.filter(|_| !is_damaged).and_then(of_operation), of_profile)
    };
    Recommendation {
        issued_at: now,
        valid_until: now.plus_millis(settings.validity_ms),
        machine: machine.id.clone(),
        operation: question.operation_id.clone(),
        tool: question.tool_id.clone(),
        process: operation.map(|operation| operation.process),
        action,
        // A profile is no single feed: who cannot run it runs the program.
        feed_mm_min: feed.filter(|_| profile.is_none()),
        override_percent: NEUTRAL_OVERRIDE_PERCENT,
        profile: profile.map(ProfileAdvice::of),
        limits,
        spindle_load_set_percent: set_load(
            |operation| operation.spindle_load_set_percent,
            of_profile.and_then(|own| own.spindle_load_set_percent),
        ),
        feed_drive_load_set_percent: set_load(
            |operation| operation.feed_drive_load_set_percent,
            of_profile.and_then(|own| own.feed_drive_load_set_percent),
        ),
        tool_state: verdict.state,
        level: verdict.level,
        remaining: verdict.remaining,
        quality,
        data_age_ms,
        process_advice,
        reference_cycle,
        reasons,
        law_version: LAW_VERSION.to_owned(),
    }
}

/// What must not be decided by, each once.
fn damaged(question: &Question<'_>) -> Vec<Damaged> {
    let mut damaged = question.damaged.to_vec();
    if *question.knowledge == Knowledge::Damaged {
        damaged.push(Damaged::Model);
    }
    damaged.sort_unstable();
    damaged.dedup();
    damaged
}

/// What `advise` adds; nothing, with the reason, where it panics.
///
/// A recommendation is made in the transaction that stores the cycle: a fault in a process's computations must not keep a
/// machine from handing in what it ran, again and again. The panic itself is told by the process's panic hook.
fn held<S: FnMut(&str, &str)>(
    action: &mut Action,
    say: &mut S,
    advise: impl FnOnce(&mut Action, &mut S) -> Option<ProcessAdvice>,
) -> Option<ProcessAdvice> {
    let before = *action;
    // Of what it leaves half-way the action is set back, and what was said holds.
    catch_unwind(AssertUnwindSafe(|| advise(action, say))).unwrap_or_else(|_| {
        *action = before;
        say("process_advice_failed", "what the process adds could not be computed: run the program as it is");
        None
    })
}

/// The reference cycle that is due, unless the tool has to be looked at first.
fn reference_cycle(
    question: &Question<'_>,
    action: Action,
    say: &mut impl FnMut(&str, &str),
) -> Option<ReferenceRequest> {
    let friction = question.operation.is_some_and(|operation| operation.process == Process::Friction);
    let references = question.verdict.feed.references.filter(|references| references.due_in == 0);
    let references = references.filter(|_| friction && action == Action::Run)?;
    // Limits are the machine's: a reference feed beyond them cannot be asked for.
    let limits = &question.machine.limits;
    let feed = question.operation.and_then(Operation::reference_feed_mm_min).or(references.feed_mm_min);
    if feed.is_some_and(|feed| feed > limits.max_mm_min() || feed < limits.min_mm_min()) {
        say(
            "reference_feed_beyond_limits",
            "the reference feed is beyond the machine's limits: no reference cycle",
        );
        return None;
    }
    say(
        "reference_cycle_due",
        "run the next cycle as a reference cycle, one constant feed without override, to tell the wear",
    );
    Some(ReferenceRequest { every: references.every, feed_mm_min: feed })
}

/// The feed profile to run, and why it is that one or none.
fn profile<'a>(
    question: &Question<'a>,
    action: Action,
    stale: bool,
    say: &mut impl FnMut(&str, &str),
) -> Option<&'a ActiveProfile> {
    // Without the operation its program, material and depth are not known; without the tool its type is not.
    let operation = question.operation.filter(|_| question.tool_registered);
    let active = if operation.is_some() { question.profiles } else { &[] };
    let chosen = match operation {
        Some(operation) => {
            let state = (action == Action::Run, stale);
            choose(active, operation, &question.machine.limits, question.verdict, state)
        }
        None => Err(("no_profile", "no feed profile is active: 100 % of the programmed feed".to_owned())),
    };
    let chosen = match chosen {
        Ok(chosen) => {
            let ProfileVersion { profile, version } = &chosen.version;
            say("profile_active", &format!("version {version} of feed profile {profile} is active and fits"));
            Some(chosen)
        }
        Err((code, why)) => {
            say(code, &why);
            None
        }
    };
    if let Some(ran) = question.ran
        && active.iter().all(|one| one.version != *ran)
    {
        let ProfileVersion { profile, version } = ran;
        let why =
            format!("the cycle ran version {version} of feed profile {profile}, which is not active here");
        say("profile_mismatch", &why);
    }
    chosen
}

fn action(state: ToolState) -> Action {
    match state {
        ToolState::Worn => Action::ChangeTool,
        ToolState::BrokenSuspected => Action::CheckTool,
        ToolState::Changed => Action::ConfirmConditions,
        ToolState::Unknown | ToolState::Learning | ToolState::Good | ToolState::Warning => Action::Run,
    }
}

fn quality(verdict: &Verdict, data_age_ms: Option<i64>, settings: RecommendSettings) -> DataQuality {
    match (verdict.level, data_age_ms) {
        (_, None) => DataQuality::Missing,
        (_, Some(age)) if age > settings.stale_after_ms => DataQuality::Stale,
        (None, _) => DataQuality::Limited,
        (Some(_), _) => match verdict.state {
            ToolState::Good | ToolState::Warning | ToolState::Worn => DataQuality::Good,
            _ => DataQuality::Limited,
        },
    }
}

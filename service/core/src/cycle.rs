//! A cycle: one hole or cut on one machine with one tool, as it was recorded.
//!
//! A value of these types is valid; JSON, hashing and storage do not belong here.

mod channel;
mod difference;
mod downsample;
mod flags;
mod samples;

pub use channel::Channel;
pub use difference::differences;
pub use downsample::Downsampling;
pub use flags::{Flag, Flags};
pub use samples::{DEFAULT_MAX_SAMPLES, MOST_SAMPLES, Samples, TimeBase};

use crate::ids::{CycleId, MachineId, OperationId, ProfileId, RecommendationId, ToolId};
use crate::invalid::{Range, Violation};
use crate::machine::SPEED_RANGE;
use crate::units::{Process, Strategy, Timestamp};

/// Energy that a control may report for one cycle.
pub const ENERGY_RANGE: Range = Range::new(-1e12, 1e12, "J");
/// Length of one cycle: at most a day.
pub const DURATION_RANGE: Range = Range::new(0.0, 86_400_000.0, "ms");

/// How a cycle ended, as the machine tells it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Outcome {
    /// It ran to its programmed end.
    #[default]
    Completed,
    /// It was stopped before.
    Aborted,
}

impl Outcome {
    /// The word used in the API and in storage.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Completed => "completed",
            Self::Aborted => "aborted",
        }
    }

    /// The outcome of that word.
    pub fn parse(text: &str) -> Option<Self> {
        [Self::Completed, Self::Aborted].into_iter().find(|outcome| outcome.as_str() == text)
    }
}

/// How much of a cycle was recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extent {
    /// All of it, to its programmed end.
    Whole,
    /// Until its machine stopped it.
    Aborted,
    /// Until the server kept no more of it.
    CutShort,
}

impl Extent {
    /// Of a cycle that ended so and is flagged so; what was aborted is told first, as by wear.
    pub const fn of(outcome: Outcome, flags: Flags) -> Self {
        match outcome {
            Outcome::Aborted => Self::Aborted,
            Outcome::Completed if flags.contains(Flag::CutShort) => Self::CutShort,
            Outcome::Completed => Self::Whole,
        }
    }
}

/// The version of a feed profile that a cycle ran.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ProfileVersion {
    /// Which profile.
    pub profile: ProfileId,
    /// Which of its versions, counted from 1.
    pub version: u32,
}

/// What a control reports of a cycle without samples.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Reported {
    /// Energy of the cycle, J.
    pub energy_joules: Option<f64>,
    /// Length of the cycle, ms.
    pub duration_ms: Option<f64>,
    /// Largest depth, mm.
    pub max_depth_mm: Option<f64>,
    /// Largest spindle load, %.
    pub max_spindle_load_percent: Option<f64>,
    /// Largest feed-drive load, %.
    pub max_feed_drive_load_percent: Option<f64>,
    /// Mean spindle load, %.
    pub mean_spindle_load_percent: Option<f64>,
    /// Mean feed-drive load, %.
    pub mean_feed_drive_load_percent: Option<f64>,
    /// Operator's override, mean, %.
    pub operator_override_percent: Option<f64>,
    /// What was cut and felt, where the process is turning.
    pub cut: ReportedCut,
}

/// What a control, or whoever measures beside it, reports of one interval of turning.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ReportedCut {
    /// Cutting speed, m/min.
    pub cutting_speed_m_min: Option<f64>,
    /// Feed, mm/rev.
    pub feed_mm_rev: Option<f64>,
    /// Spindle power at the end of the interval, W.
    pub spindle_power_watts: Option<f64>,
    /// Thrust force at the end of the interval, N.
    pub thrust_newtons: Option<f64>,
    /// Average wear of the edge, measured after the interval, mm.
    pub edge_wear_mm: Option<f64>,
}

impl ReportedCut {
    /// The fields with their names and the range each has to lie in, in the order of the struct.
    ///
    /// Narrower than elsewhere at the lower end: the laws that these feed have no logarithm at zero.
    pub const fn fields(&self) -> [(&'static str, Range, Option<f64>); 5] {
        [
            ("cutting_speed_m_min", Range::new(0.001, 100_000.0, "m/min"), self.cutting_speed_m_min),
            ("feed_mm_rev", Range::new(1e-6, 100.0, "mm/rev"), self.feed_mm_rev),
            ("spindle_power_watts", Range::new(1e-6, 1e9, "W"), self.spindle_power_watts),
            ("thrust_newtons", Range::new(1e-6, 1e9, "N"), self.thrust_newtons),
            ("edge_wear_mm", Range::new(0.0, 100.0, "mm"), self.edge_wear_mm),
        ]
    }

    /// Whether nothing of it was reported.
    pub fn is_empty(&self) -> bool {
        self.fields().iter().all(|(_, _, value)| value.is_none())
    }
}

impl Reported {
    /// The fields with their names and the range each has to lie in, in the order of the struct.
    pub fn fields(&self) -> [(&'static str, Range, Option<f64>); 8] {
        let load = Channel::SpindleLoadPercent.range();
        let depth = Channel::DepthMm.range();
        let operator = Channel::OperatorOverridePercent.range();
        [
            ("energy_joules", ENERGY_RANGE, self.energy_joules),
            ("duration_ms", DURATION_RANGE, self.duration_ms),
            ("max_depth_mm", depth, self.max_depth_mm),
            ("max_spindle_load_percent", load, self.max_spindle_load_percent),
            ("max_feed_drive_load_percent", load, self.max_feed_drive_load_percent),
            ("mean_spindle_load_percent", load, self.mean_spindle_load_percent),
            ("mean_feed_drive_load_percent", load, self.mean_feed_drive_load_percent),
            ("operator_override_percent", operator, self.operator_override_percent),
        ]
    }

    /// The values of [`Reported::fields`], and behind them those of [`ReportedCut::fields`].
    const fn values_mut(&mut self) -> [&mut Option<f64>; 13] {
        let cut = &mut self.cut;
        [
            &mut self.energy_joules,
            &mut self.duration_ms,
            &mut self.max_depth_mm,
            &mut self.max_spindle_load_percent,
            &mut self.max_feed_drive_load_percent,
            &mut self.mean_spindle_load_percent,
            &mut self.mean_feed_drive_load_percent,
            &mut self.operator_override_percent,
            &mut cut.cutting_speed_m_min,
            &mut cut.feed_mm_rev,
            &mut cut.spindle_power_watts,
            &mut cut.thrust_newtons,
            &mut cut.edge_wear_mm,
        ]
    }
}

/// A cycle before it was checked: the same fields, nothing promised.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleDraft {
    /// The machine that ran it.
    pub machine: MachineId,
    /// Its id within the machine.
    pub id: CycleId,
    /// The tool that was in the spindle.
    pub tool: ToolId,
    /// What was machined.
    pub operation: OperationId,
    /// When it began, by the machine's clock.
    pub started_at: Timestamp,
    /// The machine's own count, where it has one.
    pub seq: Option<u64>,
    /// The process as the machine names it: where it is not the operation's, the cycle is flagged
    /// [`Flag::Contradictory`].
    pub process: Option<Process>,
    /// How the feed was chosen.
    pub strategy: Option<Strategy>,
    /// Which version of the control law ran.
    pub law_version: Option<String>,
    /// Which feed profile ran.
    pub profile: Option<ProfileVersion>,
    /// The recommendation that it followed.
    pub recommendation: Option<RecommendationId>,
    /// Whether the machine says that it is a reference cycle: one feed from end to end, no law and no override;
    /// `None` where it says nothing.
    pub reference: Option<bool>,
    /// Spindle speed that was commanded, rpm.
    pub spindle_speed_rpm: Option<f64>,
    /// How it ended.
    pub outcome: Outcome,
    /// What was sampled.
    pub samples: Option<Samples>,
    /// What the control itself reports.
    pub reported: Reported,
}

/// A cycle that was checked. Its fields are read-only.
#[derive(Debug, Clone, PartialEq)]
pub struct Cycle(CycleDraft);

impl Cycle {
    /// Longest law version text.
    pub const MAX_LAW_VERSION: usize = 64;

    /// Checks what the types of a draft leave open; returns every violation, not only the first.
    pub fn new(mut draft: CycleDraft) -> Result<Self, Vec<Violation>> {
        let mut wrong = Vec::new();
        if let Some(speed) = &mut draft.spindle_speed_rpm
            && let Some(checked) = SPEED_RANGE.collect("spindle_speed_rpm", *speed, &mut wrong)
        {
            *speed = checked;
        }
        check_seq(draft.seq, &mut wrong);
        if draft
            .law_version
            .as_ref()
            .is_some_and(|text| text.is_empty() || text.chars().count() > Self::MAX_LAW_VERSION)
        {
            wrong.push(Violation::new(
                "law_version",
                "invalid_length",
                format!("must have 1 to {} characters", Self::MAX_LAW_VERSION),
            ));
        }
        if draft.profile.as_ref().is_some_and(|profile| profile.version == 0) {
            wrong.push(Violation::new("profile.version", "out_of_range", "must be at least 1"));
        }
        if draft.reference == Some(true)
            && let Some(why) = no_reference(&draft)
        {
            wrong.push(Violation::new("reference_cycle", "contradictory", why));
        }
        let fields = draft.reported.fields().into_iter().chain(draft.reported.cut.fields());
        for ((name, range, value), kept) in fields.zip(draft.reported.values_mut()) {
            if let Some(value) = value
                && let Some(checked) = range.collect(&format!("reported.{name}"), value, &mut wrong)
            {
                *kept = Some(checked);
            }
        }
        let anything_reported = draft.reported.fields().iter().any(|(_, _, value)| value.is_some())
            || !draft.reported.cut.is_empty();
        if draft.samples.is_none() && !anything_reported {
            wrong.push(Violation::new(
                "samples",
                "nothing_recorded",
                "a cycle needs samples or reported values: neither is there",
            ));
        }
        if wrong.is_empty() { Ok(Self(draft)) } else { Err(wrong) }
    }

    /// The same with these samples in place of its own, or with none, for where they are kept apart.
    #[must_use]
    pub fn with_samples(self, samples: Option<Samples>) -> Self {
        Self(CycleDraft { samples, ..self.0 })
    }

    /// Gives the fields back.
    pub fn into_draft(self) -> CycleDraft {
        self.0
    }
}

/// Checks the number that a control counts its cycles by, which databases keep as a signed one.
pub fn check_seq(seq: Option<u64>, wrong: &mut Vec<Violation>) {
    if seq.is_some_and(|seq| i64::try_from(seq).is_err()) {
        wrong.push(Violation::new("seq", "out_of_range", "must be within 0 to 9223372036854775807"));
    }
}

/// Why a cycle cannot be a reference cycle by what it says of itself: its samples are looked at later.
fn no_reference(draft: &CycleDraft) -> Option<&'static str> {
    let process = draft.process.unwrap_or(Process::Friction);
    match draft.strategy {
        _ if process != Process::Friction => Some("only friction drilling has reference cycles"),
        Some(Strategy::FSec | Strategy::FLin | Strategy::FAc) => {
            Some("a reference cycle runs one constant feed: its strategy is f_const, or is left out")
        }
        _ if draft.law_version.is_some() => {
            Some("a reference cycle runs without a law: leave out law_version")
        }
        _ => None,
    }
}

impl std::ops::Deref for Cycle {
    type Target = CycleDraft;
    fn deref(&self) -> &CycleDraft {
        &self.0
    }
}

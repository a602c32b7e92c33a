//! What the fold says of a tool, with its evidence.

use super::facts::OrderKey;
use crate::cycle::ProfileVersion;
use crate::friction::relation::Estimate;
use crate::ids::{CycleId, MachineId, OperationId};
use crate::summary::{EnergyBasis, PeakShift};
use crate::units::{Strategy, Timestamp};

/// The state of a tool.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ToolState {
    /// Nothing can be told, and the verdict says why.
    Unknown,
    /// The baseline is not complete yet.
    Learning,
    /// Level below the warning.
    Good,
    /// Level at or above 1.07, not yet back below 1.05.
    Warning,
    /// Level at or above 1.10, latched until change, regrind or an engineer's reset.
    Worn,
    /// A lasting step in energy or cycle time: conditions changed, to be confirmed.
    Changed,
    /// An undercut after good cycles: the tool may be broken.
    BrokenSuspected,
}

impl ToolState {
    /// Every state, in the order of the enum.
    pub const ALL: [Self; 7] = [
        Self::Unknown,
        Self::Learning,
        Self::Good,
        Self::Warning,
        Self::Worn,
        Self::Changed,
        Self::BrokenSuspected,
    ];

    /// The word used in the API and in storage.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Learning => "learning",
            Self::Good => "good",
            Self::Warning => "warning",
            Self::Worn => "worn",
            Self::Changed => "changed",
            Self::BrokenSuspected => "broken_suspected",
        }
    }

    /// The state of that word.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.as_str() == text)
    }
}

/// Why a cycle is not counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Exclusion {
    /// The machine says it was aborted.
    Aborted = 0,
    /// It stayed short of its depth or of its usual time.
    Incomplete = 1,
    /// Usual length, hardly any energy: nothing was cut.
    AirCut = 2,
    /// An undercut that no normal cycle has followed yet.
    BrokenSuspected = 3,
    /// It began before its tool was mounted, or its clock was never set.
    ClockSuspect = 4,
    /// No joules: neither power nor a rating is known, or what was measured of a cycle in the work is nothing.
    NoEnergy = 5,
    /// Samples cover less than 95 % of it.
    LowCoverage = 6,
    /// Its operation is not registered.
    OperationUnregistered = 7,
    /// The operator's override differs by more than 5 points from the baseline's.
    OperatorOverride = 8,
    /// After a lasting step that nobody has confirmed.
    ConditionsChanged = 9,
    /// Far off the other cycles that a baseline is learnt from.
    BaselineOutlier = 10,
    /// The server kept only a part of it, so that nobody knows what the whole took.
    CutShort = 11,
}

impl Exclusion {
    /// Every reason, in the order of the codes.
    pub const ALL: [Self; 12] = [
        Self::Aborted,
        Self::Incomplete,
        Self::AirCut,
        Self::BrokenSuspected,
        Self::ClockSuspect,
        Self::NoEnergy,
        Self::LowCoverage,
        Self::OperationUnregistered,
        Self::OperatorOverride,
        Self::ConditionsChanged,
        Self::BaselineOutlier,
        Self::CutShort,
    ];

    /// The word used in the API.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Aborted => "aborted",
            Self::Incomplete => "incomplete",
            Self::AirCut => "air_cut",
            Self::BrokenSuspected => "broken_suspected",
            Self::ClockSuspect => "clock_suspect",
            Self::NoEnergy => "no_energy",
            Self::LowCoverage => "low_coverage",
            Self::OperationUnregistered => "operation_unregistered",
            Self::OperatorOverride => "operator_override",
            Self::ConditionsChanged => "conditions_changed",
            Self::BaselineOutlier => "baseline_outlier",
            Self::CutShort => "cut_short",
        }
    }

    /// The reason of that stored code.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code)).copied()
    }
}

/// How many cycles of this life were not counted, by reason, indexed by the reason's code.
pub type ExclusionCounts = [u64; Exclusion::ALL.len()];

/// What has to be alike for two energies to be compared.
#[derive(Debug, Clone, PartialEq)]
pub struct BaselineKey {
    /// The machine.
    pub machine: MachineId,
    /// What was machined.
    pub operation: OperationId,
    /// Commanded spindle speed of the key's first cycle, rpm; others within ±2 % share the key.
    pub spindle_speed_rpm: Option<f64>,
    /// How the energy was told.
    pub basis: EnergyBasis,
    /// Whether idle power was subtracted from it.
    pub idle_subtracted: bool,
    /// Whether it is the energy from contact to full depth alone, and not of all that was recorded.
    pub in_contact: bool,
    /// Fingerprint of the ratings and fitted lines that the energy rests on.
    pub energy_scale: i64,
    /// How the feed was chosen.
    pub strategy: Option<Strategy>,
    /// Which version of the law ran.
    pub law_version: Option<String>,
    /// Which profile ran.
    pub profile: Option<ProfileVersion>,
}

/// One baseline of the current life.
#[derive(Debug, Clone, PartialEq)]
pub struct BaselineEvidence {
    /// What it compares.
    pub key: BaselineKey,
    /// Cycles it was, or is being, learnt from.
    pub learnt_from: u32,
    /// Cycles it needs.
    pub needed: u32,
    /// The baseline B, J; `None` while it is being learnt.
    pub baseline_joules: Option<f64>,
    /// Those of before that it was learnt anew after, oldest first.
    pub earlier: Vec<Earlier>,
    /// The level that the tool had when the key was first met; 1 for a new tool.
    pub level_at_entry: f64,
    /// Median operator's override of the baseline's cycles, %.
    pub operator_override_percent: Option<f64>,
}

/// A baseline that does not hold any more.
#[derive(Debug, Clone, PartialEq)]
pub struct Earlier {
    /// The first cycle that it does not hold for; `None` where that has yet to come.
    pub until: Option<OrderKey>,
    /// It, J; `None` where it is not known any more.
    pub joules: Option<f64>,
}

impl BaselineEvidence {
    /// The baseline that a cycle of that place was compared with, J.
    pub(super) fn joules_at(&self, order: &OrderKey) -> Option<f64> {
        match self.earlier.iter().find(|earlier| earlier.until.as_ref().is_none_or(|until| order < until)) {
            Some(earlier) => earlier.joules,
            None => self.baseline_joules,
        }
    }
}

/// What a level rests on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum LevelBasis {
    /// The median of the last ratios as run.
    AsRun,
    /// The median of the last ratios, compensated for their feeds.
    FeedCompensated,
    /// The median of the last reference cycles.
    ReferenceCycles,
}

impl LevelBasis {
    /// Every basis, in the order of the enum.
    pub const ALL: [Self; 3] = [Self::AsRun, Self::FeedCompensated, Self::ReferenceCycles];

    /// The word used in the API and in storage.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::AsRun => "as_run",
            Self::FeedCompensated => "feed_compensated",
            Self::ReferenceCycles => "reference_cycles",
        }
    }

    /// The basis of that word.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|basis| basis.as_str() == text)
    }
}

/// What keeps wear from being told by energy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Masked {
    /// A law that answers to the load slows the feed as the tool wears.
    ByControl,
    /// A program whose feeds are so far from the reference feed that nobody knows what its energy means there.
    ByFeed,
}

impl Masked {
    /// The word used in the API.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::ByControl => "by_control",
            Self::ByFeed => "by_feed",
        }
    }
}

/// Reference cycles of a tool that needs them: one constant feed, no override.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceCycles {
    /// One is asked for after so many cycles.
    pub every: u32,
    /// Cycles until the next one is due; 0 is now.
    pub due_in: u64,
    /// Whether their baseline is complete; until then every cycle should be one.
    pub learnt: bool,
    /// The feed to run, mm/min; `None` where the operation declares none.
    pub feed_mm_min: Option<f64>,
    /// How many were run in this life.
    pub count: u64,
    /// Cycles since the last one.
    pub age_cycles: Option<u64>,
}

/// What is known of a tool's wear beside the ratios as run.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FeedEvidence {
    /// Median energy over what the new tool would have needed at the feeds run, with its standard deviation.
    pub at_own_feed: Option<Estimate>,
    /// The same extra energy carried over to the reference feed.
    pub at_reference_feed: Option<Estimate>,
    /// Cycles that these are medians of.
    pub compensated_n: u32,
    /// Level by reference cycles, while they are fresh.
    pub by_references: Option<Estimate>,
    /// Reference cycles that it is the median of.
    pub reference_n: u32,
    /// What keeps the wear from being told, where something does.
    pub masked: Option<Masked>,
    /// Cycles of this life after which something did.
    pub masked_cycles: u64,
    /// Reference cycles, where the tool needs them.
    pub references: Option<ReferenceCycles>,
}

/// The largest level that is told, and the least below 0. A machine may report any energy: what is a million times that of the new
/// tool is beyond all wear, and how far beyond says nothing.
pub const MOST_LEVEL: f64 = 1e6;

/// The level of wear. No number of it is beyond [`MOST_LEVEL`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// Median of the last counted ratios, as run: 1 is the new tool.
    pub as_run: f64,
    /// Smallest of those ratios.
    pub lowest: f64,
    /// Largest of those ratios.
    pub highest: f64,
    /// How many ratios it is the median of.
    pub n: u32,
    /// How many it may hold.
    pub window: u32,
    /// What the deciding level rests on; `None` where nothing decides and `value` is only the level as run.
    pub decides: Option<LevelBasis>,
    /// The level that is compared with the limits.
    pub value: f64,
    /// Its standard deviation, where it is known.
    pub sd: Option<f64>,
}

impl Level {
    /// A level that was judged as run.
    pub const fn as_run(as_run: f64, (lowest, highest): (f64, f64), n: u32, window: u32) -> Self {
        let decides = Some(LevelBasis::AsRun);
        Self { as_run, lowest, highest, n, window, decides, value: as_run, sd: None }
    }
}

/// The trend of the level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trend {
    /// Rise of the ratio per counted cycle (Theil–Sen).
    pub slope_per_cycle: f64,
    /// Lower end of its 90 % interval.
    pub slope_low: f64,
    /// Upper end of its 90 % interval.
    pub slope_high: f64,
    /// Counted cycles that it rests on.
    pub cycles: u64,
}

/// Cycles left until the level reaches 1.10, were the trend to go on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Remaining {
    /// Expected.
    pub cycles: u64,
    /// At the steep end of the interval.
    pub low: u64,
    /// At the flat end.
    pub high: u64,
}

/// Indicators beside energy.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SecondIndicators {
    /// Shift of the spindle load's falling edge in depth, for the key that ran last.
    pub fall_depth: Option<PeakShift>,
    /// Cycle time over the baseline's, for the key that ran last; 1 is the new tool.
    pub cycle_time_ratio: Option<f64>,
    /// Whether a law that slows the feed ran and nothing else tells the wear (`F_AC`).
    pub masked_by_control: bool,
}

/// The reason of a verdict on a tool whose cycles are being folded again.
const BEING_COUNTED: &str = "being_counted";

/// The verdict on a tool, with its evidence.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// The state that decides.
    pub state: ToolState,
    /// Why it is that state: a stable code and a sentence each.
    pub reasons: Vec<(&'static str, String)>,
    /// The level, once there is a counted ratio.
    pub level: Option<Level>,
    /// The trend, once there is evidence.
    pub trend: Option<Trend>,
    /// Remaining cycles, once there is a trend that rises.
    pub remaining: Option<Remaining>,
    /// Indicators beside energy.
    pub indicators: SecondIndicators,
    /// Energy compensated for the feed, reference cycles, and what masks the wear.
    pub feed: FeedEvidence,
    /// Which life of the tool this is, counted from 1; 0 where no cycle and no event is known.
    pub life: u32,
    /// Whether the life began with an unworn tool.
    pub started_unworn: bool,
    /// Baselines of this life, the one that ran last first.
    pub baselines: Vec<BaselineEvidence>,
    /// Cycles of this life in all.
    pub cycles: u64,
    /// Cycles of this life that were counted into ratios or a baseline.
    pub counted: u64,
    /// Cycles of this life not counted, by reason.
    pub excluded: ExclusionCounts,
    /// The last cycles that were not counted, oldest first, with their reason (bounded).
    pub last_excluded: Vec<(MachineId, CycleId, Exclusion)>,
    /// Cycles since the last counted one: the age of the level in cycles.
    pub age_cycles: u64,
    /// When the last counted cycle began.
    pub last_counted_at: Option<Timestamp>,
    /// The last cycle of the fold.
    pub last: Option<OrderKey>,
}

impl Verdict {
    /// The verdict on a tool of which nothing is known.
    pub fn unknown(code: &'static str, why: impl Into<String>) -> Self {
        Self {
            state: ToolState::Unknown,
            reasons: vec![(code, why.into())],
            level: None,
            trend: None,
            remaining: None,
            indicators: SecondIndicators::default(),
            feed: FeedEvidence::default(),
            life: 0,
            started_unworn: true,
            baselines: Vec::new(),
            cycles: 0,
            counted: 0,
            excluded: [0; Exclusion::ALL.len()],
            last_excluded: Vec::new(),
            age_cycles: 0,
            last_counted_at: None,
            last: None,
        }
    }

    /// The verdict on a tool whose cycles are being folded again, which takes a while: so long nobody knows how worn it is.
    pub fn being_counted() -> Self {
        let why = "its cycles are counted again, as something far before the newest of them is otherwise now: ask again soon";
        Self::unknown(BEING_COUNTED, why)
    }

    /// The same, where cycles whose clock was never set are among them: each that comes is counted before all others.
    #[must_use]
    pub fn beside_suspects(mut self) -> Self {
        let why = "cycles whose clock was never set are counted before all others, and each of them begins it anew: set the machine's clock";
        self.reasons.push(("clock_never_set", why.into()));
        self
    }

    /// Whether it is the verdict on a tool whose cycles are being folded again: it says nothing of the tool.
    pub fn is_being_counted(&self) -> bool {
        self.reasons.iter().any(|(code, _)| *code == BEING_COUNTED)
    }

    /// Age of what the verdict rests on, ms, never below 0: of the last cycle that counted, and only where none did of the
    /// last one. A cycle that counts for nothing makes old wear no younger. `None` where there is none.
    pub fn age_ms(&self, now: Timestamp) -> Option<i64> {
        let at = self.last_counted_at.or_else(|| self.last.as_ref().map(|last| last.started_at))?;
        Some(now.millis_since(at).max(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::{CycleId, MachineId};

    #[test]
    fn what_does_not_count_makes_no_wear_younger() {
        let at = |ms: i64| Timestamp::from_micros(ms * 1000);
        let last = OrderKey {
            started_at: at(9_000),
            machine: MachineId::parse("machine", "M1").unwrap(),
            seq: None,
            cycle: CycleId::parse("cycle", "aborted").unwrap(),
        };
        let mut verdict = Verdict::unknown("no_cycle", "no cycle yet");
        assert_eq!(verdict.age_ms(at(10_000)), None);
        verdict.last = Some(last);
        assert_eq!(verdict.age_ms(at(10_000)), Some(1_000), "nothing counted: of the last cycle");
        verdict.last_counted_at = Some(at(2_000));
        assert_eq!(verdict.age_ms(at(10_000)), Some(8_000));
        assert_eq!(verdict.age_ms(at(1_000)), Some(0), "never below 0");
    }
}

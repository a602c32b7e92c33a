//! The verdict on a tool as JSON.

use crate::http::dto::time;
use feedwright_core::friction::relation::Estimate;
use feedwright_core::summary::EnergyBasis;
use feedwright_core::wear::{
    BaselineEvidence, Exclusion, FeedEvidence, Level, LevelBasis, Masked, ReferenceCycles, Remaining, Trend,
    Verdict,
};
use serde::Serialize;
use std::borrow::Cow;
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// A text of a body that outlives what it tells. Most bodies are written at once, and borrow theirs.
pub fn owned(text: Cow<'_, str>) -> Cow<'static, str> {
    Cow::Owned(text.into_owned())
}

/// A stable code and a sentence for a person.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ReasonBody<'a> {
    /// Stable code.
    #[schema(example = "good")]
    pub code: Cow<'a, str>,
    /// A sentence for a person.
    pub message: Cow<'a, str>,
}

impl<'a> ReasonBody<'a> {
    /// Of a code and its sentence.
    pub fn of(code: &'a str, message: &'a str) -> Self {
        Self { code: code.into(), message: message.into() }
    }

    /// With texts of its own.
    pub fn owned(self) -> ReasonBody<'static> {
        ReasonBody { code: owned(self.code), message: owned(self.message) }
    }
}

/// How worn a tool is, with the evidence.
///
/// The level is relative: 1.07 is a warning, 1.10 is worn, and means energy per cycle over the same tool when new.
#[derive(Debug, Serialize, ToSchema)]
pub struct WearBody<'a> {
    /// One of `unknown`, `learning`, `good`, `warning`, `worn`, `changed`, `broken_suspected`.
    #[schema(example = "good")]
    pub state: &'static str,
    /// Why it is that state.
    pub reasons: Vec<ReasonBody<'a>>,
    /// The level, once there is a counted cycle and a new-tool baseline.
    pub level: Option<LevelBody>,
    /// The trend, once there is evidence.
    pub trend: Option<TrendBody>,
    /// Cycles that remain until 1.10, once the trend surely rises.
    pub remaining: Option<RemainingBody>,
    /// Indicators beside energy.
    pub indicators: IndicatorsBody,
    /// Energy compensated for the feed, reference cycles, and what masks the wear.
    pub feed: FeedEvidenceBody,
    /// Which life of the tool this is, counted from 1.
    pub life: u32,
    /// Whether the life is known to have begun with an unworn tool.
    pub started_unworn: bool,
    /// Baselines of this life, the one that ran last first.
    pub baselines: Vec<BaselineBody<'a>>,
    /// Cycles of this life.
    pub cycles: u64,
    /// Cycles of this life that were counted.
    pub counted: u64,
    /// Cycles of this life that were not counted, by reason.
    #[schema(example = json!({"air_cut": 2}))]
    pub excluded: BTreeMap<&'static str, u64>,
    /// The last cycles that were not counted, oldest first.
    pub last_excluded: Vec<ExcludedBody<'a>>,
    /// Cycles since the last counted one.
    pub age_cycles: u64,
    /// When the last counted cycle began.
    pub last_counted_at: Option<String>,
    /// When the last cycle began.
    pub last_cycle_at: Option<String>,
}

/// The level of wear.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
pub struct LevelBody {
    /// Median of the last counted ratios, energy as run over the baseline; 1 is the new tool.
    #[schema(example = 1.034)]
    pub as_run: f64,
    /// Smallest of those ratios.
    pub lowest: f64,
    /// Largest of those ratios.
    pub highest: f64,
    /// How many ratios it is the median of.
    pub n: u32,
    /// How many it may hold.
    pub window: u32,
    /// Which level is compared with the limits: `as_run`, `feed_compensated`, `reference_cycles`; null where nothing
    /// decides because the wear is masked.
    #[schema(example = "as_run")]
    pub decides: Option<&'static str>,
    /// That level; as run where nothing decides.
    #[schema(example = 1.034)]
    pub value: f64,
    /// Its standard deviation, where it is known.
    pub sd: Option<f64>,
    /// Level of a warning.
    pub warning_at: f64,
    /// Level of a worn tool.
    pub worn_at: f64,
}

impl From<Level> for LevelBody {
    fn from(level: Level) -> Self {
        Self {
            as_run: level.as_run,
            lowest: level.lowest,
            highest: level.highest,
            n: level.n,
            window: level.window,
            decides: level.decides.map(LevelBasis::as_str),
            value: level.value,
            sd: level.sd,
            warning_at: feedwright_core::wear::WARNING_LEVEL,
            worn_at: feedwright_core::wear::WORN_LEVEL,
        }
    }
}

/// The trend of the level (Theil–Sen, 90 % interval).
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
pub struct TrendBody {
    /// Rise of the ratio per counted cycle.
    pub slope_per_cycle: f64,
    /// Lower end of the interval.
    pub slope_low: f64,
    /// Upper end of the interval.
    pub slope_high: f64,
    /// Counted cycles that it rests on.
    pub cycles: u64,
}

impl From<Trend> for TrendBody {
    fn from(trend: Trend) -> Self {
        Self {
            slope_per_cycle: trend.slope_per_cycle,
            slope_low: trend.slope_low,
            slope_high: trend.slope_high,
            cycles: trend.cycles,
        }
    }
}

/// Cycles that remain until the tool is worn.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
pub struct RemainingBody {
    /// Expected.
    pub cycles: u64,
    /// At the steep end of the interval.
    pub low: u64,
    /// At the flat end of the interval.
    pub high: u64,
}

impl From<Remaining> for RemainingBody {
    fn from(remaining: Remaining) -> Self {
        Self { cycles: remaining.cycles, low: remaining.low, high: remaining.high }
    }
}

/// Indicators beside energy.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
pub struct IndicatorsBody {
    /// Shift in depth of the spindle load's falling edge against the baseline, mm.
    pub spindle_load_fall_shift_mm: Option<f64>,
    /// Cycle time over the baseline's.
    pub cycle_time_ratio: Option<f64>,
    /// Whether a law that slows the feed ran and nothing else tells the wear.
    pub masked_by_control: bool,
}

/// What is known of the wear beside the ratio as run (Stryczek & Błaszczak 2020 for the effect: a law that slows the
/// feed hides wear, and so does a fast program).
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
pub struct FeedEvidenceBody {
    /// Median energy over what the new tool would have needed at the feeds actually run.
    pub compensated: Option<EstimateBody>,
    /// The same extra energy carried over to the constant feed of reference cycles, at which +10 % is the limit.
    pub at_reference_feed: Option<EstimateBody>,
    /// Cycles that these two are medians of.
    pub compensated_cycles: u32,
    /// The level by reference cycles, while they are fresh.
    pub by_reference_cycles: Option<EstimateBody>,
    /// Reference cycles that it is the median of.
    pub reference_cycles: u32,
    /// `by_control` or `by_feed`: what keeps the wear from being told now; null where it is told.
    #[schema(example = "by_control")]
    pub masked: Option<&'static str>,
    /// Share of the life's cycles after which the wear was masked, 0 to 1.
    pub masked_share: f64,
    /// Reference cycles, where the tool needs them and the operation asks for them.
    pub references: Option<ReferencesBody>,
}

/// A value with its standard deviation.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
pub struct EstimateBody {
    /// The value; 1 is the new tool.
    #[schema(example = 1.034)]
    pub value: f64,
    /// Its standard deviation.
    #[schema(example = 0.006)]
    pub sd: f64,
}

impl From<Estimate> for EstimateBody {
    fn from(estimate: Estimate) -> Self {
        Self { value: estimate.value, sd: estimate.sd }
    }
}

/// Reference cycles: one constant feed, no override.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
pub struct ReferencesBody {
    /// One is asked for after so many cycles.
    #[schema(example = 50)]
    pub every_cycles: u32,
    /// Cycles until the next one is due; 0 is now.
    pub due_in_cycles: u64,
    /// Whether their baseline is complete; until then every cycle should be one.
    pub learnt: bool,
    /// The feed to run, mm/min, where the operation declares it.
    pub feed_mm_min: Option<f64>,
    /// How many were run in this life.
    pub count: u64,
    /// Cycles since the last one.
    pub age_cycles: Option<u64>,
}

impl From<ReferenceCycles> for ReferencesBody {
    fn from(references: ReferenceCycles) -> Self {
        Self {
            every_cycles: references.every,
            due_in_cycles: references.due_in,
            learnt: references.learnt,
            feed_mm_min: references.feed_mm_min,
            count: references.count,
            age_cycles: references.age_cycles,
        }
    }
}

impl FeedEvidenceBody {
    fn of(feed: FeedEvidence, cycles: u64) -> Self {
        #[expect(clippy::cast_precision_loss, reason = "counts of cycles are far below 2^53")]
        let masked_share = if cycles == 0 { 0.0 } else { feed.masked_cycles as f64 / cycles as f64 };
        Self {
            compensated: feed.at_own_feed.map(Into::into),
            at_reference_feed: feed.at_reference_feed.map(Into::into),
            compensated_cycles: feed.compensated_n,
            by_reference_cycles: feed.by_references.map(Into::into),
            reference_cycles: feed.reference_n,
            masked: feed.masked.map(Masked::as_str),
            masked_share,
            references: feed.references.map(Into::into),
        }
    }
}

/// One baseline, and what it compares.
#[derive(Debug, Serialize, ToSchema)]
pub struct BaselineBody<'a> {
    /// The machine.
    pub machine: Cow<'a, str>,
    /// The operation.
    pub operation: Cow<'a, str>,
    /// Commanded spindle speed, rpm; others within ±2 % share the baseline.
    pub spindle_speed_rpm: Option<f64>,
    /// How its energies were told.
    pub basis: &'static str,
    /// Whether idle power was subtracted.
    pub idle_subtracted: bool,
    /// Whether its energies are those from contact to full depth alone, without approach, spinning up and retreat.
    pub in_contact: bool,
    /// Names the ratings and fitted lines that its energies rest on; after a change of them it is another baseline.
    pub energy_scale: String,
    /// Strategy of the feed.
    pub strategy: Option<&'static str>,
    /// Version of the law.
    pub law_version: Option<Cow<'a, str>>,
    /// Feed profile and its version.
    pub profile: Option<String>,
    /// Cycles it was, or is being, learnt from.
    pub learnt_from: u32,
    /// Cycles it needs.
    pub needed: u32,
    /// The baseline, J, once it is complete.
    pub baseline_joules: Option<f64>,
    /// The level that the tool had when it was first met.
    pub level_at_entry: f64,
    /// Operator's override of its cycles, median, %.
    pub operator_override_percent: Option<f64>,
}

impl<'a> From<&'a BaselineEvidence> for BaselineBody<'a> {
    fn from(evidence: &'a BaselineEvidence) -> Self {
        let key = &evidence.key;
        Self {
            machine: key.machine.as_str().into(),
            operation: key.operation.as_str().into(),
            spindle_speed_rpm: key.spindle_speed_rpm,
            basis: EnergyBasis::as_str(key.basis),
            idle_subtracted: key.idle_subtracted,
            in_contact: key.in_contact,
            energy_scale: format!("{:x}", key.energy_scale),
            strategy: key.strategy.map(feedwright_core::units::Strategy::as_str),
            law_version: key.law_version.as_deref().map(Into::into),
            profile: key.profile.as_ref().map(|profile| format!("{}@{}", profile.profile, profile.version)),
            learnt_from: evidence.learnt_from,
            needed: evidence.needed,
            baseline_joules: evidence.baseline_joules,
            level_at_entry: evidence.level_at_entry,
            operator_override_percent: evidence.operator_override_percent,
        }
    }
}

/// A cycle that was not counted.
#[derive(Debug, Serialize, ToSchema)]
pub struct ExcludedBody<'a> {
    /// Its machine.
    pub machine: Cow<'a, str>,
    /// Its id.
    pub cycle_id: Cow<'a, str>,
    /// Why.
    #[schema(example = "air_cut")]
    pub reason: &'static str,
}

impl WearBody<'_> {
    /// With texts of its own.
    pub fn owned(self) -> WearBody<'static> {
        let baselines = self.baselines.into_iter().map(|baseline| BaselineBody {
            machine: owned(baseline.machine),
            operation: owned(baseline.operation),
            law_version: baseline.law_version.map(owned),
            ..baseline
        });
        let last_excluded = self.last_excluded.into_iter().map(|excluded| ExcludedBody {
            machine: owned(excluded.machine),
            cycle_id: owned(excluded.cycle_id),
            reason: excluded.reason,
        });
        WearBody {
            reasons: self.reasons.into_iter().map(ReasonBody::owned).collect(),
            baselines: baselines.collect(),
            last_excluded: last_excluded.collect(),
            ..self
        }
    }
}

impl<'a> From<&'a Verdict> for WearBody<'a> {
    fn from(verdict: &'a Verdict) -> Self {
        let excluded = Exclusion::ALL
            .into_iter()
            .map(|why| (why.as_str(), verdict.excluded[why as usize]))
            .filter(|(_, count)| *count > 0)
            .collect();
        let last_excluded = verdict.last_excluded.iter().map(|(machine, cycle, why)| ExcludedBody {
            machine: machine.as_str().into(),
            cycle_id: cycle.as_str().into(),
            reason: why.as_str(),
        });
        Self {
            state: verdict.state.as_str(),
            reasons: verdict.reasons.iter().map(|(code, message)| ReasonBody::of(code, message)).collect(),
            level: verdict.level.map(Into::into),
            trend: verdict.trend.map(Into::into),
            remaining: verdict.remaining.map(Into::into),
            indicators: IndicatorsBody {
                spindle_load_fall_shift_mm: verdict.indicators.fall_depth.map(|shift| shift.shift_mm()),
                cycle_time_ratio: verdict.indicators.cycle_time_ratio,
                masked_by_control: verdict.indicators.masked_by_control,
            },
            feed: FeedEvidenceBody::of(verdict.feed, verdict.cycles),
            life: verdict.life,
            started_unworn: verdict.started_unworn,
            baselines: verdict.baselines.iter().map(Into::into).collect(),
            cycles: verdict.cycles,
            counted: verdict.counted,
            excluded,
            last_excluded: last_excluded.collect(),
            age_cycles: verdict.age_cycles,
            last_counted_at: verdict.last_counted_at.map(time::show),
            last_cycle_at: verdict.last.as_ref().map(|last| time::show(last.started_at)),
        }
    }
}

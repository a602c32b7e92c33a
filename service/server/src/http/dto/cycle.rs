//! Cycles as JSON: what is posted, what is answered, what is listed.

use super::recommendation::RecommendationBody;
use super::wear::WearBody;
use crate::http::dto::time;
use crate::ingest::intake::Accepted;
use feedwright_core::summary::{CycleSummary, Energy, IdlePower, Peak};
use feedwright_store::{SamplesGone, StoredCycle};
use serde::Serialize;
use std::borrow::Cow;
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// A cycle as a machine posts it. This is its schema; the reader is stricter and names the path of what is wrong.
#[derive(ToSchema)]
#[schema(as = CyclePost, example = json!({
    "cycle_id": "0192f0c1-7e1d-7cc3-98c4-dc0c0c07398f", "tool": "FD-0815", "operation": "bush-m8",
    "started_at": "2026-05-04T06:00:00.25Z", "seq": 4711, "strategy": "f_lin", "spindle_speed_rpm": 2500,
    "samples": {"period_ms": 10, "depth_mm": [-0.5, 0.1, 0.6], "spindle_load_percent": [4.1, 12.7, 21.5],
                "feed_drive_load_percent": [2.0, 9.5, 14.2]}
}))]
#[expect(dead_code, reason = "the schema of what is read by hand")]
pub struct CyclePost {
    /// Its id, unique within the machine for ever: a UUIDv7 or boot id + counter.
    cycle_id: String,
    /// The tool that was in the spindle.
    tool: String,
    /// What was machined.
    operation: String,
    /// When it began, RFC 3339, by the machine's clock; at most 10 minutes ahead of the server's.
    started_at: String,
    /// The machine's own count.
    #[schema(maximum = 9223372036854775807u64)]
    seq: Option<u64>,
    /// `friction`, `drilling`, `plunge`, `turning`, `vibratory` or `milling`; the operation's where it is left out; another one flags the cycle `contradictory`.
    process: Option<String>,
    /// `f_const`, `f_sec`, `f_lin` or `f_ac`.
    strategy: Option<String>,
    /// Version of the control law that ran.
    law_version: Option<String>,
    /// Feed profile that ran.
    profile: Option<ProfilePost>,
    /// The recommendation that it followed.
    recommendation_id: Option<String>,
    /// Whether it was run as a reference cycle: one constant feed from end to end, no law, no override. True with another
    /// strategy than `f_const`, or with a `law_version`, is refused; samples that show different feeds are believed
    /// before it, and flag the cycle `contradictory`. False says that a reference cycle was asked for and not run.
    reference_cycle: Option<bool>,
    /// Commanded spindle speed, rpm.
    #[schema(minimum = 0, maximum = 1_000_000)]
    spindle_speed_rpm: Option<f64>,
    /// `completed` (where it is left out) or `aborted`.
    outcome: Option<String>,
    /// Columns of equal length and one time base. Give what the control has; leave out the rest. A cycle needs these or at
    /// least one reported value (422 `nothing_recorded`).
    samples: Option<SamplesPost>,
    /// What the control itself reports, with or without samples.
    reported: Option<ReportedPost>,
}

/// Feed profile that ran.
#[derive(ToSchema)]
#[expect(dead_code, reason = "the schema of what is read by hand")]
pub struct ProfilePost {
    /// Its id.
    id: String,
    /// Its version.
    #[schema(minimum = 1, maximum = 4_294_967_295_u32)]
    version: u32,
}

/// Columns of samples. One of `period_ms` and `time_ms`, and at least one channel; up to `limits.samples_per_cycle` samples.
#[derive(ToSchema)]
#[expect(dead_code, reason = "the schema of what is read by hand")]
pub struct SamplesPost {
    /// Distance of two samples, ms. The first one is that of the end of the first period: it stands at `period_ms`, not at 0.
    /// Times the number of samples it is at most 86 400 000, a day.
    #[schema(nullable = false, minimum = 0.01, maximum = 10_000)]
    period_ms: Option<f64>,
    /// Times since the start of the cycle, ms, not running backwards: none before it, none after a day.
    #[schema(nullable = false, min_items = 1, minimum = 0, maximum = 86_400_000)]
    time_ms: Option<Vec<f64>>,
    /// Tool tip depth: 0 at first contact, positive into the work, mm.
    #[schema(nullable = false, min_items = 1, minimum = -100_000, maximum = 100_000)]
    depth_mm: Option<Vec<f64>>,
    /// Programmed feed, mm/min.
    #[schema(nullable = false, min_items = 1, minimum = 0, maximum = 1_000_000)]
    feed_programmed_mm_min: Option<Vec<f64>>,
    /// Actual feed, mm/min.
    #[schema(nullable = false, min_items = 1, minimum = -1_000_000, maximum = 1_000_000)]
    feed_actual_mm_min: Option<Vec<f64>>,
    /// Feed override applied, %.
    #[schema(nullable = false, min_items = 1, minimum = 0, maximum = 1000)]
    override_percent: Option<Vec<f64>>,
    /// Operator's override, %.
    #[schema(nullable = false, min_items = 1, minimum = 0, maximum = 1000)]
    operator_override_percent: Option<Vec<f64>>,
    /// Feed-drive load, percent of the machine's declared rating.
    #[schema(nullable = false, min_items = 1, minimum = -10_000, maximum = 10_000)]
    feed_drive_load_percent: Option<Vec<f64>>,
    /// Spindle load, percent of the machine's declared rating.
    #[schema(nullable = false, min_items = 1, minimum = -10_000, maximum = 10_000)]
    spindle_load_percent: Option<Vec<f64>>,
    /// Spindle speed, rpm.
    #[schema(nullable = false, min_items = 1, minimum = -1_000_000, maximum = 1_000_000)]
    spindle_speed_rpm: Option<Vec<f64>>,
    /// Thrust from a dynamometer, N.
    #[schema(nullable = false, min_items = 1, minimum = -10_000_000, maximum = 10_000_000)]
    thrust_newtons: Option<Vec<f64>>,
    /// Torque from a dynamometer, N·m.
    #[schema(nullable = false, min_items = 1, minimum = -1_000_000, maximum = 1_000_000)]
    torque_newton_metres: Option<Vec<f64>>,
    /// Spindle power, W.
    #[schema(nullable = false, min_items = 1, minimum = -10_000_000, maximum = 10_000_000)]
    spindle_power_watts: Option<Vec<f64>>,
    /// Feed-drive power, W.
    #[schema(nullable = false, min_items = 1, minimum = -10_000_000, maximum = 10_000_000)]
    feed_drive_power_watts: Option<Vec<f64>>,
    /// Spindle current, A.
    #[schema(nullable = false, min_items = 1, minimum = -100_000, maximum = 100_000)]
    spindle_current_amperes: Option<Vec<f64>>,
    /// Feed-drive current, A.
    #[schema(nullable = false, min_items = 1, minimum = -100_000, maximum = 100_000)]
    feed_drive_current_amperes: Option<Vec<f64>>,
    /// Torque of the feed drive's motor, N·m.
    #[schema(nullable = false, min_items = 1, minimum = -1_000_000, maximum = 1_000_000)]
    feed_drive_torque_newton_metres: Option<Vec<f64>>,
    /// Torque of the spindle's motor, N·m.
    #[schema(nullable = false, min_items = 1, minimum = -1_000_000, maximum = 1_000_000)]
    spindle_torque_newton_metres: Option<Vec<f64>>,
}

/// What the control itself reports of a cycle.
#[derive(ToSchema)]
#[expect(dead_code, reason = "the schema of what is read by hand")]
pub struct ReportedPost {
    /// Energy, J.
    #[schema(minimum = -1_000_000_000_000_i64, maximum = 1_000_000_000_000_i64)]
    energy_joules: Option<f64>,
    /// Length, ms.
    #[schema(minimum = 0, maximum = 86_400_000)]
    duration_ms: Option<f64>,
    /// Largest depth, mm.
    #[schema(minimum = -100_000, maximum = 100_000)]
    max_depth_mm: Option<f64>,
    /// Largest spindle load, %.
    #[schema(minimum = -10_000, maximum = 10_000)]
    max_spindle_load_percent: Option<f64>,
    /// Largest feed-drive load, %.
    #[schema(minimum = -10_000, maximum = 10_000)]
    max_feed_drive_load_percent: Option<f64>,
    /// Mean spindle load, %.
    #[schema(minimum = -10_000, maximum = 10_000)]
    mean_spindle_load_percent: Option<f64>,
    /// Mean feed-drive load, %.
    #[schema(minimum = -10_000, maximum = 10_000)]
    mean_feed_drive_load_percent: Option<f64>,
    /// Operator's override, mean, %.
    #[schema(minimum = 0, maximum = 1000)]
    operator_override_percent: Option<f64>,
    /// Turning: cutting speed, m/min.
    #[schema(minimum = 0.001, maximum = 100_000)]
    cutting_speed_m_min: Option<f64>,
    /// Turning: feed, mm/rev.
    #[schema(minimum = 0.000001, maximum = 100)]
    feed_mm_rev: Option<f64>,
    /// Turning: spindle power at the end of the interval, W.
    #[schema(minimum = 0.000001, maximum = 1_000_000_000)]
    spindle_power_watts: Option<f64>,
    /// Turning: thrust force at the end of the interval, N.
    #[schema(minimum = 0.000001, maximum = 1_000_000_000)]
    thrust_newtons: Option<f64>,
    /// Turning: average wear of the edge, measured after the interval, mm.
    #[schema(minimum = 0, maximum = 100)]
    edge_wear_mm: Option<f64>,
}

/// What a machine is told once its cycle is durably stored.
#[derive(Debug, Serialize, ToSchema)]
pub struct CycleAnswerBody<'a> {
    /// `stored` (new, 201) or `known` (the same content was stored before, 200).
    #[schema(example = "stored")]
    pub status: &'static str,
    /// Its machine.
    pub machine: Cow<'a, str>,
    /// Its id.
    pub cycle_id: Cow<'a, str>,
    /// When the server received it first.
    pub received_at: String,
    /// Whether its tool and operation are registered; if not, it is kept and counted once they are. Energy that rests on the
    /// spindle speed cannot be told of a cycle that names none before its operation, which has one, is registered.
    pub registered: bool,
    /// Its summary; left out where `Prefer: return=minimal` was sent.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub summary: Option<SummaryBody>,
    /// How worn its tool is now; left out where `Prefer: return=minimal` was sent.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub wear: Option<WearBody<'a>>,
    /// What to run next.
    pub recommendation: RecommendationBody<'a>,
}

impl<'a> CycleAnswerBody<'a> {
    /// All of the answer to a cycle that was accepted.
    pub fn of(accepted: &'a Accepted) -> Self {
        let answer = &accepted.answer;
        Self {
            summary: Some((&answer.summary).into()),
            wear: Some((&*answer.verdict).into()),
            ..Self::minimal(accepted)
        }
    }

    /// What its machine acts on: that it is stored, and what to run next.
    pub fn minimal(accepted: &'a Accepted) -> Self {
        let answer = &accepted.answer;
        Self {
            status: if accepted.new { "stored" } else { "known" },
            machine: accepted.cycle.machine.as_str().into(),
            cycle_id: accepted.cycle.id.as_str().into(),
            received_at: time::show(answer.received_at),
            registered: answer.registered,
            summary: None,
            wear: None,
            recommendation: (&answer.recommendation).into(),
        }
    }
}

/// What a cycle amounts to.
#[derive(Debug, Serialize, ToSchema)]
pub struct SummaryBody {
    /// Version of the rules that made it.
    pub version: u32,
    /// Number of samples; 0 where the control only reported.
    pub sample_count: u32,
    /// Cycle time, ms: what the samples stand for, where there are any (docs/reading.md), else what the control reports.
    pub duration_ms: Option<f64>,
    /// Energy by basis, the one that wear compares first; empty where no joules can be told.
    pub energy: Vec<EnergyBody>,
    /// Largest depth, mm.
    pub max_depth_mm: Option<f64>,
    /// Largest spindle load, %.
    pub max_spindle_load_percent: Option<PeakBody>,
    /// Largest feed-drive load, %.
    pub max_feed_drive_load_percent: Option<PeakBody>,
    /// Largest spindle power, W.
    pub max_spindle_power_watts: Option<PeakBody>,
    /// Largest thrust, N.
    pub max_thrust_newtons: Option<PeakBody>,
    /// Largest torque, N·m.
    pub max_torque_newton_metres: Option<PeakBody>,
    /// Mean spindle load, %.
    pub mean_spindle_load_percent: Option<f64>,
    /// Mean feed-drive load, %.
    pub mean_feed_drive_load_percent: Option<f64>,
    /// Mean override, %.
    pub mean_override_percent: Option<f64>,
    /// Mean operator's override, %.
    pub operator_override_percent: Option<f64>,
    /// Median of the sampled spindle speed while it turns, in the work where depth was sampled, rpm.
    pub median_spindle_speed_rpm: Option<f64>,
    /// Depth at which the spindle load has fallen to half of its maximum, mm.
    pub spindle_load_fall_depth_mm: Option<f64>,
    /// Share of `duration_ms` that is no gap, 0 to 1.
    pub coverage_ratio: f64,
    /// Of friction drilling, and of a cycle whose process is not known yet: what lies between contact and full depth.
    /// Null where depth or energy was not sampled.
    pub contact: Option<ContactBody>,
    /// Quality flags, which docs/reading.md lists. With `cut_short` the server kept only a part of the cycle, which does not count for wear; `incomplete` is
    /// also a depth short of what the operation asked for when it began.
    #[schema(example = json!(["negative_power"]))]
    pub flags: Vec<&'static str>,
}

/// The part of a cycle from contact to full depth, which is what wear compares: without approach, spinning up and retreat.
#[derive(Debug, Serialize, ToSchema)]
pub struct ContactBody {
    /// Energy on the best basis, J.
    pub energy_joules: f64,
    /// Time, ms.
    pub duration_ms: f64,
}

/// Energy of a cycle on one basis.
#[derive(Debug, Serialize, ToSchema)]
pub struct EnergyBody {
    /// `dynamometer`, `calibrated`, `measured_power`, `rated_power` or `reported`.
    #[schema(example = "measured_power")]
    pub basis: &'static str,
    /// The whole, J.
    pub total_joules: f64,
    /// The spindle's part, J.
    pub spindle_joules: Option<f64>,
    /// The feed drive's part, J; null where it is not known and counted as 0.
    pub feed_drive_joules: Option<f64>,
    /// `not_applicable`, `included` (not known, still in the figure) or `subtracted`.
    pub idle_power: &'static str,
    /// The idle power that was subtracted, W.
    pub idle_watts: Option<f64>,
}

/// A largest value with where and when it was first reached.
#[derive(Debug, Serialize, ToSchema)]
pub struct PeakBody {
    /// The value.
    pub value: f64,
    /// Depth, mm.
    pub depth_mm: Option<f64>,
    /// Time since the start of the cycle, ms.
    pub time_ms: Option<f64>,
}

impl From<Peak> for PeakBody {
    fn from(peak: Peak) -> Self {
        Self { value: peak.value, depth_mm: peak.depth_mm, time_ms: peak.time_ms }
    }
}

impl From<&Energy> for EnergyBody {
    fn from(energy: &Energy) -> Self {
        let (idle_power, idle_watts) = match energy.idle {
            IdlePower::NotApplicable => ("not_applicable", None),
            IdlePower::Included => ("included", None),
            IdlePower::Subtracted { watts } => ("subtracted", Some(watts)),
        };
        Self {
            basis: energy.basis.as_str(),
            total_joules: energy.total_joules,
            spindle_joules: energy.spindle_joules,
            feed_drive_joules: energy.feed_drive_joules,
            idle_power,
            idle_watts,
        }
    }
}

impl From<&CycleSummary> for SummaryBody {
    fn from(summary: &CycleSummary) -> Self {
        Self {
            version: summary.version,
            sample_count: summary.sample_count,
            duration_ms: summary.duration_ms,
            energy: summary.energy.iter().map(Into::into).collect(),
            max_depth_mm: summary.max_depth_mm,
            max_spindle_load_percent: summary.max_spindle_load_percent.map(Into::into),
            max_feed_drive_load_percent: summary.max_feed_drive_load_percent.map(Into::into),
            max_spindle_power_watts: summary.max_spindle_power_watts.map(Into::into),
            max_thrust_newtons: summary.max_thrust_newtons.map(Into::into),
            max_torque_newton_metres: summary.max_torque_newton_metres.map(Into::into),
            mean_spindle_load_percent: summary.mean_spindle_load_percent,
            mean_feed_drive_load_percent: summary.mean_feed_drive_load_percent,
            mean_override_percent: summary.mean_override_percent,
            operator_override_percent: summary.operator_override_percent,
            median_spindle_speed_rpm: summary.median_spindle_speed_rpm,
            spindle_load_fall_depth_mm: summary.spindle_load_fall_depth_mm,
            coverage_ratio: summary.coverage,
            contact: summary.digest.as_ref().map(|digest| ContactBody {
                energy_joules: digest.joules(),
                duration_ms: digest.duration_ms(),
            }),
            flags: summary.flags.iter().map(feedwright_core::cycle::Flag::as_str).collect(),
        }
    }
}

/// A stored cycle with its summary.
#[derive(Debug, Serialize, ToSchema)]
pub struct CycleBody {
    /// Its machine.
    pub machine: String,
    /// Its id.
    pub cycle_id: String,
    /// Its tool.
    pub tool: String,
    /// Its operation.
    pub operation: String,
    /// When it began, by the machine's clock.
    pub started_at: String,
    /// When the server received it.
    pub received_at: String,
    /// The machine's own count.
    pub seq: Option<u64>,
    /// Its process.
    pub process: Option<&'static str>,
    /// Strategy of the feed.
    pub strategy: Option<&'static str>,
    /// Version of the law.
    pub law_version: Option<String>,
    /// Feed profile.
    pub profile_id: Option<String>,
    /// Version of the feed profile.
    #[schema(maximum = 4_294_967_295_u32)]
    pub profile_version: Option<u32>,
    /// The recommendation that it followed.
    pub recommendation_id: Option<String>,
    /// Whether the machine said that it was a reference cycle.
    pub reference_cycle: Option<bool>,
    /// Commanded spindle speed, rpm.
    pub spindle_speed_rpm: Option<f64>,
    /// How it ended.
    pub outcome: &'static str,
    /// Hash over its canonical content, hexadecimal.
    pub content_hash: String,
    /// Whether its samples are kept.
    pub has_samples: bool,
    /// When retention dropped them, RFC 3339; of the decisions of one day (UTC) for one reason the last.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples_dropped_at: Option<String>,
    /// Its summary.
    pub summary: SummaryBody,
}

impl From<&StoredCycle> for CycleBody {
    fn from(stored: &StoredCycle) -> Self {
        let cycle = &stored.cycle;
        Self {
            machine: cycle.machine.to_string(),
            cycle_id: cycle.id.to_string(),
            tool: cycle.tool.to_string(),
            operation: cycle.operation.to_string(),
            started_at: time::show(cycle.started_at),
            received_at: time::show(stored.received_at),
            seq: cycle.seq,
            process: cycle.process.map(feedwright_core::units::Process::as_str),
            strategy: cycle.strategy.map(feedwright_core::units::Strategy::as_str),
            law_version: cycle.law_version.clone(),
            profile_id: cycle.profile.as_ref().map(|profile| profile.profile.to_string()),
            profile_version: cycle.profile.as_ref().map(|profile| profile.version),
            recommendation_id: cycle.recommendation.as_ref().map(ToString::to_string),
            reference_cycle: cycle.reference,
            spindle_speed_rpm: cycle.spindle_speed_rpm,
            outcome: cycle.outcome.as_str(),
            content_hash: blake3::Hash::from_bytes(stored.hash).to_hex().to_string(),
            has_samples: stored.has_samples,
            samples_dropped_at: None,
            summary: (&stored.summary).into(),
        }
    }
}

impl CycleBody {
    /// Says when the samples of this cycle were dropped, where they were.
    pub fn tell_drop(self, gone: Option<&SamplesGone>) -> Self {
        Self { samples_dropped_at: gone.map(|gone| time::show(gone.dropped_at)), ..self }
    }
}

/// A cycle's samples, in the form in which they are posted.
#[derive(Debug, Serialize, ToSchema)]
pub struct SamplesBody<'a> {
    /// Distance of two samples, ms, where they are evenly spaced: the first one stands at this time, not at 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub period_ms: Option<f64>,
    /// Times since the start of the cycle, ms, where they are not.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Vec<f64>>)]
    pub time_ms: Option<Cow<'a, [f64]>>,
    /// The channels by name.
    #[serde(flatten)]
    #[schema(value_type = BTreeMap<&'static str, Vec<f64>>)]
    pub columns: BTreeMap<&'static str, Cow<'a, [f64]>>,
}

/// A cycle's samples: columns in the form in which they are posted, or rows where those were asked for.
#[derive(Serialize, ToSchema)]
pub struct SamplesAnswer {
    /// Distance of two samples, ms, where they are evenly spaced: the first one stands at this time, not at 0.
    period_ms: Option<f64>,
    /// Times since the start of the cycle, ms, where they are not.
    time_ms: Option<Vec<f64>>,
    /// With `layout=rows`, and nothing else then: an object per sample, with the fields of the other forms' rows.
    #[schema(value_type = Option<Vec<Object>>)]
    items: Option<Vec<serde_json::Value>>,
    /// The channels by name.
    #[serde(flatten)]
    columns: BTreeMap<String, Vec<f64>>,
}

impl SamplesBody<'_> {
    /// How many values it holds.
    pub fn values(&self) -> usize {
        self.time_ms.iter().chain(self.columns.values()).map(|column| column.len()).sum()
    }
}

/// What became of one line of a batch.
#[derive(Debug, Serialize, ToSchema)]
pub struct BatchOutcome {
    /// Number of the line, counted from 1.
    pub line: usize,
    /// The status that the cycle would have been answered alone.
    pub status: u16,
    /// `stored`, `known`, `quarantined` (the machine may forget it) or `refused` (it must keep it).
    pub outcome: &'static str,
    /// The cycle's id, where it could be read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cycle_id: Option<String>,
    /// The tool's state after it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tool_state: Option<&'static str>,
    /// Where it is kept in quarantine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quarantine_id: Option<String>,
    /// The problem that it would have been answered alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Object>)]
    pub problem: Option<serde_json::Value>,
}

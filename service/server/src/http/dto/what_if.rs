//! What-if on stored cycles in JSON.

use super::friction::control::{BetweenWord, LawBody, ProgramBody, ProgramKnotBody};
use super::friction::model::AxisBody;
use super::time;
use crate::what_if::{Asked, AskedLaw, IdleLoads, IdleSource, Prediction, TorqueSource};
use feedwright_core::closed_loop::control::LawSettings;
use feedwright_core::friction::twin::paper_params;
use feedwright_core::friction::whatif::{LoadLimits, PredictedSample, RunFigures};
use feedwright_core::ids::{MachineId, OperationId, ProfileId, ToolId};
use feedwright_core::invalid::{Range, Violation};
use feedwright_store::CycleFilter;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Most cycles of one question: each is read and run twice, a few milliseconds together.
pub const MOST_CYCLES: u32 = 1000;
/// Cycles of a question that names no number.
const USUAL_CYCLES: u32 = 200;
/// Overloads that may be tolerated.
const TOLERATED_RANGE: Range = Range::new(0.0, 600.0, "s");
/// Idle loads.
const IDLE_RANGE: Range = Range::new(-100.0, 100.0, "%");
/// Accelerations of a feed axis.
const ACCELERATION_RANGE: Range = Range::new(0.001, 1e5, "mm/s²");

/// Another control, other limits, or both.
#[derive(Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
#[schema(example = json!({
    "control": {"law": {"set_feed_drive_percent": 40, "set_spindle_percent": 50}},
    "limits": {"feed_drive_percent": 45, "spindle_percent": 60, "tolerated_overload_s": 0.05}
}))]
pub struct WhatIfQuestion {
    /// The other control.
    pub control: ControlBody,
    /// What counts as an overload, in what happened and in what is predicted alike.
    pub limits: WhatIfLimitsBody,
    /// The feed axis; the paper's machine where it is left out.
    pub axis: AxisBody,
    /// Idle loads; medians before contact where they are left out.
    pub idle: Option<IdleBody>,
    /// Whether the predicted samples are answered too; not of many cycles.
    pub samples: bool,
}

/// The other control. Where both are left out the feed that ran is kept, and only the limits differ.
#[derive(Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ControlBody {
    /// Another feed over depth, piecewise held or linear; where it is left out, and a law is asked for, the cycle's
    /// programmed feed.
    pub program: Option<ProgramBody>,
    /// A stored feed profile by its id and version, in place of `program`.
    pub profile: Option<ProfileChoiceBody>,
    /// A law on top, over the operation's set loads and within the machine's override range; none where it is left out.
    pub law: Option<LawBody>,
}

/// A stored feed profile, or a feed over depth as in `program`.
#[derive(Debug, Clone, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
#[schema(example = json!({"id": "bush-m8-new", "version": 3}))]
pub struct ProfileChoiceBody {
    /// Id of a stored profile. A cycle of another operation, or deeper than the profile goes, is not usable.
    pub id: Option<String>,
    /// Its version, whatever its state; the active one where it is left out.
    #[schema(minimum = 1)]
    pub version: Option<u32>,
    /// In place of an id: what the feed does between knots.
    pub between: Option<BetweenWord>,
    /// In place of an id: the knots.
    pub knots: Option<Vec<ProgramKnotBody>>,
}

/// What a [`ControlBody`] names: a program as it is, or a stored profile.
#[derive(Debug, Clone)]
pub enum ProfileChoice {
    /// A feed over depth.
    Inline(ProgramBody),
    /// A stored profile and its version.
    Stored(ProfileId, Option<u32>),
}

impl ControlBody {
    /// The program or profile that is asked about.
    pub fn choice(&self) -> Result<Option<ProfileChoice>, Violation> {
        let wrong = |path: &str, code, text: &str| Err(Violation::new(path, code, text));
        let Some(profile) = &self.profile else {
            return Ok(self.program.clone().map(ProfileChoice::Inline));
        };
        if self.program.is_some() {
            return wrong("control.profile", "contradictory", "give a program or a profile, not both");
        }
        let inline = profile.between.is_some() || profile.knots.is_some();
        match (&profile.id, inline) {
            (Some(_), true) => {
                wrong("control.profile", "contradictory", "give an id, or a feed over depth, not both")
            }
            (Some(id), false) => {
                let id = ProfileId::parse("control.profile.id", id)?;
                if profile.version == Some(0) {
                    return wrong("control.profile.version", "out_of_range", "must be at least 1");
                }
                Ok(Some(ProfileChoice::Stored(id, profile.version)))
            }
            (None, _) if profile.version.is_some() => {
                wrong("control.profile.id", "missing_field", "a version needs the id of its profile")
            }
            (None, _) => match (profile.between, &profile.knots) {
                (Some(between), Some(knots)) => {
                    Ok(Some(ProfileChoice::Inline(ProgramBody { between, knots: knots.clone() })))
                }
                _ => wrong(
                    "control.profile",
                    "missing_field",
                    "needs the id of a stored profile, or `between` and `knots`",
                ),
            },
        }
    }
}

/// What counts as an overload and as an alarm.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WhatIfLimitsBody {
    /// Feed-drive load, %; no limit where it is left out.
    pub feed_drive_percent: Option<f64>,
    /// Spindle load, %; no limit where it is left out.
    pub spindle_percent: Option<f64>,
    /// Time of overload within a cycle that raises no alarm yet, s; 0 where it is left out.
    pub tolerated_overload_s: Option<f64>,
}

/// Loads of the idling drives, %.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct IdleBody {
    /// Feed drive.
    pub feed_drive_percent: f64,
    /// Spindle.
    pub spindle_percent: f64,
}

/// The same of many cycles.
#[derive(Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
#[schema(example = json!({
    "filter": {"machine": "M1", "from": "2026-05-04T06:00:00Z"}, "most_cycles": 500,
    "question": {"limits": {"spindle_percent": 55}}, "cycles": false
}))]
pub struct ManyQuestion {
    /// Which cycles, oldest first; those of one time by machine and id.
    pub filter: FilterBody,
    /// Goes on where an answer to the same filter ended: its `continue_from`; from the first cycle where it is left out.
    pub continue_from: Option<String>,
    /// Most cycles looked at, 1 to 1000; 200 where it is left out.
    #[schema(minimum = 1, maximum = 1000)]
    pub most_cycles: Option<u32>,
    /// What is asked of each.
    pub question: WhatIfQuestion,
    /// Whether each cycle's answer is told beside their sum.
    pub cycles: bool,
}

/// Which cycles; all given conditions hold.
#[derive(Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FilterBody {
    /// Of this machine.
    pub machine: Option<String>,
    /// Of this tool.
    pub tool: Option<String>,
    /// Of this operation.
    pub operation: Option<String>,
    /// Begun at or after, RFC 3339.
    pub from: Option<String>,
    /// Begun before, RFC 3339; later than `from`.
    pub to: Option<String>,
}

impl FilterBody {
    /// The filter; `at` is its own path.
    pub fn to_filter(&self, at: &str) -> Result<CycleFilter, Violation> {
        let path = |name: &str| format!("{at}.{name}");
        let text = Option::as_deref;
        let filter = CycleFilter {
            machine: text(&self.machine).map(|id| MachineId::parse(&path("machine"), id)).transpose()?,
            tool: text(&self.tool).map(|id| ToolId::parse(&path("tool"), id)).transpose()?,
            operation: text(&self.operation)
                .map(|id| OperationId::parse(&path("operation"), id))
                .transpose()?,
            from: text(&self.from).map(|at| time::read_bound(&path("from"), at)).transpose()?,
            to: text(&self.to).map(|at| time::read_bound(&path("to"), at)).transpose()?,
        };
        time::check_range(&path("to"), (filter.from, filter.to))?;
        Ok(filter)
    }
}

impl ManyQuestion {
    /// How many cycles are looked at.
    pub fn most(&self) -> Result<u32, Violation> {
        let most = self.most_cycles.unwrap_or(USUAL_CYCLES);
        if (1..=MOST_CYCLES).contains(&most) {
            return Ok(most);
        }
        let text = format!("must be within 1 to {MOST_CYCLES}, is {most}");
        Err(Violation::new("most_cycles", "out_of_range", text))
    }
}

impl WhatIfQuestion {
    /// What is asked, and the idle loads where they are given; a stored profile is not looked up yet. Of a law what is left out is
    /// the `usual` one.
    pub fn to_asked(&self, usual: LawSettings) -> Result<(Asked, Option<IdleLoads>), Violation> {
        let limits = LoadLimits {
            feed_drive_percent: self.limits.feed_drive_percent,
            spindle_percent: self.limits.spindle_percent,
        };
        limits.check().map_err(|error| super::friction::refused(&error, str::to_owned))?;
        let tolerated = self.limits.tolerated_overload_s.unwrap_or(0.0);
        TOLERATED_RANGE.check("limits.tolerated_overload_s", tolerated)?;
        let mut axis = paper_params().machine.axis;
        self.axis.over(&mut axis);
        ACCELERATION_RANGE.check("axis.acceleration_mm_s2", axis.acceleration_mm_s2)?;
        let longest = feedwright_core::friction::twin::LONGEST_LATENCY_IPO;
        if axis.override_latency_ipo as usize > longest {
            let text = format!("must be at most {longest} IPO cycles");
            return Err(Violation::new("axis.override_latency_ipo", "out_of_range", text));
        }
        let idle = self.idle.map(|idle| {
            IDLE_RANGE.check("idle.feed_drive_percent", idle.feed_drive_percent)?;
            IDLE_RANGE.check("idle.spindle_percent", idle.spindle_percent)?;
            let IdleBody { feed_drive_percent, spindle_percent } = idle;
            Ok::<_, Violation>(IdleLoads { feed_drive_percent, spindle_percent })
        });
        let inline = match self.control.choice()? {
            Some(ProfileChoice::Inline(program)) => Some(program),
            Some(ProfileChoice::Stored(..)) | None => None,
        };
        let at = if self.control.profile.is_some() { "control.profile" } else { "control.program" };
        let asked = Asked::new(
            inline.as_ref().map(|program| (program, at)),
            self.control.law.map(|named| AskedLaw { named, usual }),
            axis,
            limits,
            tolerated,
        )?;
        Ok((Asked { samples: self.samples, ..asked }, idle.transpose()?))
    }
}

/// One cycle under the other control, beside what happened.
#[derive(Debug, Serialize, ToSchema)]
pub struct WhatIfAnswer {
    /// Its machine.
    pub machine: String,
    /// Its id.
    pub cycle_id: String,
    /// What happened, from contact to the deepest point.
    pub happened: RunBody,
    /// What is predicted.
    pub predicted: RunBody,
    /// How wrong the model is on this very cycle: how far to trust it.
    pub model_error: ModelErrorBody,
    /// Share of the predicted way at feeds more than twice or less than half of what ran there, or at depths that the load–feed relation has
    /// never seen.
    pub extrapolated_ratio: f64,
    /// What the load–feed relation was learned from.
    pub relation: RelationBody,
    /// What was assumed about the cycle.
    pub assumed: AssumedBody,
    /// The predicted samples, where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub predicted_samples: Option<PredictedSamplesBody>,
}

/// A predicted cycle from contact to its deepest point, in columns.
#[derive(Debug, Serialize, ToSchema)]
pub struct PredictedSamplesBody {
    /// Distance of two samples, ms.
    pub period_ms: f64,
    /// Tip depth, mm.
    pub depth_mm: Vec<f64>,
    /// Actual feed, mm/min.
    pub feed_actual_mm_min: Vec<f64>,
    /// Override in force, %.
    pub override_percent: Vec<f64>,
    /// Feed-drive load, %.
    pub feed_drive_load_percent: Vec<f64>,
    /// Spindle load, %.
    pub spindle_load_percent: Vec<f64>,
}

impl PredictedSamplesBody {
    fn new(period_ms: f64, course: &[PredictedSample]) -> Self {
        let column = |of: fn(&PredictedSample) -> f64| course.iter().map(of).collect();
        Self {
            period_ms,
            depth_mm: column(|sample| sample.depth_mm),
            feed_actual_mm_min: column(|sample| sample.feed_mm_min),
            override_percent: column(|sample| sample.override_percent),
            feed_drive_load_percent: column(|sample| sample.feed_drive_percent),
            spindle_load_percent: column(|sample| sample.spindle_percent),
        }
    }
}

/// Figures of a run.
#[derive(Debug, Serialize, ToSchema)]
pub struct RunBody {
    /// From contact to the deepest point, s.
    pub duration_s: f64,
    /// Largest feed-drive load, %.
    pub peak_feed_drive_percent: f64,
    /// Largest spindle load, %.
    pub peak_spindle_percent: f64,
    /// Energy of the spindle over idle, J; null without a rating or a calibration.
    pub energy_j: Option<f64>,
    /// Time with a load over its limit, s.
    pub overload_s: f64,
    /// Whether that is more than is tolerated.
    pub alarm: bool,
}

impl RunBody {
    fn new(figures: &RunFigures, tolerated_s: f64) -> Self {
        Self {
            duration_s: figures.duration_s,
            peak_feed_drive_percent: figures.peak_feed_drive_percent,
            peak_spindle_percent: figures.peak_spindle_percent,
            energy_j: figures.energy_j,
            overload_s: figures.overload_s,
            alarm: figures.overload_s > tolerated_s,
        }
    }
}

/// The model's error on the cycle itself.
#[derive(Debug, Serialize, ToSchema)]
pub struct ModelErrorBody {
    /// Feed-drive load predicted by the relation alone, root mean square, points.
    pub feed_drive_rms_points: f64,
    /// Spindle load likewise.
    pub spindle_rms_points: f64,
    /// The feed that ran, run again: duration over the one that happened, minus 1.
    pub duration_relative: f64,
    /// Energy likewise.
    pub energy_relative: Option<f64>,
    /// Largest feed-drive load likewise, points.
    pub peak_feed_drive_points: f64,
    /// Largest spindle load likewise, points.
    pub peak_spindle_points: f64,
}

/// What a relation was learned from.
#[derive(Debug, Serialize, ToSchema)]
pub struct RelationBody {
    /// The cycles, oldest first.
    pub learned_from: Vec<String>,
    /// Whether the cycle itself is among them: the unanchored error is then flattered.
    pub includes_this_cycle: bool,
}

/// What was assumed.
#[derive(Debug, Serialize, ToSchema)]
pub struct AssumedBody {
    /// Idle loads.
    pub idle: IdleBody,
    /// `given`, `before_contact` or `assumed_zero`.
    pub idle_source: &'static str,
    /// The stored profile that was asked about, as `id@version`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub profile: Option<String>,
    /// The law that was asked about, by what a question may name of it: asked again it is the same. What an overload does, and how long bad
    /// data settles, are the service's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub law: Option<LawBody>,
    /// Where the energy comes from: `calibrated`, `rated_power` or `unknown` (no joules).
    pub energy_basis: &'static str,
}

impl WhatIfAnswer {
    /// The answer for one cycle.
    pub fn new(prediction: &Prediction, tolerated_s: f64) -> Self {
        let Prediction { stored, cycle, learned, answer, course, profile, law } = prediction;
        Self {
            machine: stored.cycle.machine.to_string(),
            cycle_id: stored.cycle.id.to_string(),
            happened: RunBody::new(&answer.happened, tolerated_s),
            predicted: RunBody::new(&answer.predicted, tolerated_s),
            model_error: ModelErrorBody {
                feed_drive_rms_points: answer.error.feed_drive_rms_points,
                spindle_rms_points: answer.error.spindle_rms_points,
                duration_relative: answer.error.duration_relative,
                energy_relative: answer.error.energy_relative,
                peak_feed_drive_points: answer.error.peak_points.0,
                peak_spindle_points: answer.error.peak_points.1,
            },
            extrapolated_ratio: answer.extrapolated,
            relation: RelationBody {
                learned_from: learned.from.iter().map(ToString::to_string).collect(),
                includes_this_cycle: learned.from.contains(&stored.cycle.id),
            },
            assumed: AssumedBody {
                idle: IdleBody {
                    feed_drive_percent: cycle.idle.feed_drive_percent,
                    spindle_percent: cycle.idle.spindle_percent,
                },
                idle_source: match cycle.idle_source {
                    IdleSource::Given => "given",
                    IdleSource::BeforeContact => "before_contact",
                    IdleSource::AssumedZero => "assumed_zero",
                },
                profile: profile
                    .as_ref()
                    .map(|asked| format!("{}@{}", asked.version.profile, asked.version.version)),
                law: law.as_ref().map(|law| law.params().into()),
                energy_basis: match cycle.torque_source {
                    TorqueSource::Calibrated => "calibrated",
                    TorqueSource::Rated => "rated_power",
                    TorqueSource::Unknown => "unknown",
                },
            },
            predicted_samples: course
                .as_ref()
                .map(|course| PredictedSamplesBody::new(cycle.period_s * 1e3, course)),
        }
    }
}

/// Many cycles under the other control, summed up.
#[derive(Debug, Serialize, ToSchema)]
pub struct ManyAnswer {
    /// Cycles that were looked at.
    pub considered: u32,
    /// Cycles that could be predicted.
    pub predicted_cycles: u32,
    /// Cycles that could not, by reason.
    #[schema(example = json!({"no_samples": 3}))]
    pub skipped: BTreeMap<&'static str, u32>,
    /// What happened.
    pub happened: SumBody,
    /// What is predicted.
    pub predicted: SumBody,
    /// The model's error on the cycles themselves.
    pub model_error: SumErrorBody,
    /// Whether no cycle of the filter comes after those that were looked at.
    pub complete: bool,
    /// Goes on behind the last cycle that was looked at, as `continue_from` of the next question with the same filter; opaque.
    /// Null where none is left.
    pub continue_from: Option<String>,
    /// Each cycle, where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cycles: Option<Vec<WhatIfAnswer>>,
}

/// Sums over cycles; means and maxima are null where no cycle could be predicted.
#[derive(Debug, Default, Serialize, ToSchema)]
pub struct SumBody {
    /// Mean duration, s.
    pub mean_duration_s: Option<f64>,
    /// Mean energy over the cycles that have one, J.
    pub mean_energy_j: Option<f64>,
    /// Largest feed-drive load of all, %.
    pub peak_feed_drive_percent: Option<f64>,
    /// Largest spindle load of all, %.
    pub peak_spindle_percent: Option<f64>,
    /// Time of overload, s.
    pub overload_s: f64,
    /// Cycles with an alarm.
    pub alarms: u32,
    /// Alarms per thousand cycles.
    pub alarms_per_thousand: Option<f64>,
}

/// Errors over cycles; null where no cycle could be predicted.
#[derive(Debug, Default, Serialize, ToSchema)]
pub struct SumErrorBody {
    /// Median of the durations' absolute relative errors.
    pub duration_median: Option<f64>,
    /// Largest of them.
    pub duration_largest: Option<f64>,
    /// Median of the largest spindle loads' absolute errors, points.
    pub peak_spindle_median_points: Option<f64>,
    /// Largest of them, points.
    pub peak_spindle_largest_points: Option<f64>,
}

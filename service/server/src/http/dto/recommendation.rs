//! A recommendation as JSON.

use super::mirror::{To, shown};
use super::turning::{CorrectionsBody, ReadingsBody};
use super::wear::{LevelBody, ReasonBody, RemainingBody, owned};
use crate::http::dto::time;
use feedwright_core::recommend::{ProcessAdvice, TurningNext};
use feedwright_store::IssuedRecommendation;
use serde::Serialize;
use std::borrow::Cow;
use utoipa::ToSchema;

/// What to run next, and why. It advises; the control's own limits and the emergency stop stay the safety layer.
#[derive(Debug, Serialize, ToSchema)]
pub struct RecommendationBody<'a> {
    /// Its id: a cycle that follows it names it.
    pub id: Cow<'a, str>,
    /// When it was made.
    pub issued_at: String,
    /// It must not be used after this.
    pub valid_until: String,
    /// For which machine.
    pub machine: Cow<'a, str>,
    /// For which operation.
    pub operation: Cow<'a, str>,
    /// For which tool.
    pub tool: Cow<'a, str>,
    /// Tag of what the recommendation is about: `friction`, `drilling`, `plunge`, `turning`, `vibratory`, `milling`,
    /// or `unknown` where the operation is not registered.
    #[schema(example = "friction")]
    pub process: &'static str,
    /// `run`, `change_tool`, `check_tool` or `confirm_conditions`.
    #[schema(example = "run")]
    pub action: &'static str,
    /// The feed to run.
    pub feed: FeedBody,
    /// Override to run, %.
    #[schema(example = 100.0)]
    pub override_percent: f64,
    /// Limits that hold whatever the control does.
    pub limits: AdviceLimitsBody,
    /// Set loads.
    pub load_limits: SetLoadsBody,
    /// The tool it was made for.
    pub tool_state: ToolStateBody,
    /// The data it rests on.
    pub data: DataBody,
    /// What the operation's process adds, where the operation asks for it and enough is known; the reasons say why
    /// not.
    pub process_advice: Option<ProcessAdviceBody>,
    /// The next cycle should be a reference cycle; null where it need not be.
    pub reference_cycle: Option<ReferenceRequestBody>,
    /// Why; never empty.
    pub reasons: Vec<ReasonBody<'a>>,
    /// Version of the rules that made it.
    pub law_version: Cow<'a, str>,
}

/// A reference cycle that is asked for: one constant feed from end to end, no override. Post it with the strategy
/// `f_const`, or with the id of this recommendation.
#[derive(Debug, Serialize, ToSchema)]
pub struct ReferenceRequestBody {
    /// One is asked for after so many cycles.
    #[schema(example = 50)]
    pub every_cycles: u32,
    /// The feed to run, mm/min; null where the operation declares none: the one that reference cycles ran before.
    #[schema(example = 110.0)]
    pub feed_mm_min: Option<f64>,
}

/// What a process adds.
#[derive(Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ProcessAdviceBody {
    /// The next speed and feed of turning.
    Turning(TurningAdviceBody),
    /// The plunge feed.
    Plunge(PlungeAdviceBody),
}

impl From<ProcessAdvice> for ProcessAdviceBody {
    fn from(advice: ProcessAdvice) -> Self {
        match advice {
            ProcessAdvice::Turning(advice) => Self::Turning(TurningAdviceBody {
                law_version: advice.law_version,
                model: advice.model.as_str().to_owned(),
                elapsed_min: advice.elapsed_min,
                corrections: advice.corrections.to(),
                readings: advice.readings.to(),
                next: advice.next.to(),
                ended_by: advice.ended_by.to(),
            }),
            ProcessAdvice::Plunge(advice) => Self::Plunge(PlungeAdviceBody {
                law_version: advice.law_version,
                material: advice.material.as_str().to_owned(),
                feed_mm_min: advice.feed_mm_min,
                limit: advice.limit.as_str(),
                bite_mm: advice.bite_mm,
            }),
        }
    }
}

/// State of a turning edge and its next pair (Alaskari & Oraby 2017, with adaptation).
#[derive(Debug, Serialize, ToSchema)]
pub struct TurningAdviceBody {
    /// Version of the rules that made it.
    pub law_version: String,
    /// Library entry.
    pub model: String,
    /// Cutting time since the edge was new, min.
    pub elapsed_min: f64,
    /// What was learnt.
    pub corrections: CorrectionsBody,
    /// What that rests on.
    pub readings: ReadingsBody,
    /// What to cut next; absent where the edge is spent or nothing is advised, as the reasons say.
    pub next: Option<TurningNextBody>,
    /// `power`, `force` or `wear`: the limit that leaves no pair.
    pub ended_by: Option<&'static str>,
}

shown! {
    /// The next pair.
    TurningNextBody = TurningNext {
        /// Cutting speed, m/min.
        speed_m_min: f64,
        /// Feed, mm/rev.
        feed_mm_rev: f64,
        /// Spindle speed, 1/min, where the diameter is known.
        spindle_rpm: Option<f64>,
        /// Feed rate, mm/min, where the diameter is known.
        feed_mm_min: Option<f64>,
        /// Length of the interval it is meant for, min.
        interval_min: f64,
        /// Wear expected at its end, mm.
        wear_mm: f64,
        /// Power expected at its end, kW.
        power_kw: f64,
        /// Force expected at its end, N.
        force_n: f64,
        /// Removal rate, mm³/min.
        removal_mm3_min: f64,
        /// What keeps it from being faster.
        binding: &'static str,
    }
}

/// Plunge feed of the operation's drill on this machine (Lengerov).
#[derive(Debug, Serialize, ToSchema)]
pub struct PlungeAdviceBody {
    /// Version of the rules that made it.
    pub law_version: String,
    /// Library entry.
    pub material: String,
    /// Most plunge feed, mm/min; absent where the drill cannot plunge on this machine.
    pub feed_mm_min: Option<f64>,
    /// What bounds it.
    pub limit: &'static str,
    /// How far the drill bites before the axis reacts, mm.
    pub bite_mm: Option<f64>,
}

/// The feed to run: the active feed profile where one fits, else the operation's programmed feed.
#[derive(Debug, Serialize, ToSchema)]
pub struct FeedBody {
    /// `profile`: the version named beside; `programmed`: the feed that the operation declares; `program`: whatever the
    /// NC program says.
    pub source: &'static str,
    /// The feed, mm/min, where it is declared and no profile is to be run.
    pub feed_mm_min: Option<f64>,
    /// The version to run.
    pub profile: Option<RecommendedProfileBody>,
}

/// The active version of a feed profile that fits.
#[derive(Debug, Serialize, ToSchema)]
pub struct RecommendedProfileBody {
    /// Name of the feed profile; a cycle that runs it says so in `profile`.
    pub id: String,
    /// Number of the version.
    pub version: u32,
    /// Hash of its content, as the exported file names it.
    pub hash: String,
    /// Time from first contact to the end at an override of 100 %, s.
    pub time_s: f64,
    /// Level of wear up to which it holds.
    pub wear_to_level: f64,
    /// Where its content is read.
    pub content: String,
}

/// Limits of the machine, and of the feed profile where one is to be run.
#[derive(Debug, Serialize, ToSchema)]
pub struct AdviceLimitsBody {
    /// Slowest feed, mm/min.
    pub feed_min_mm_min: f64,
    /// Fastest feed, mm/min.
    pub feed_max_mm_min: f64,
    /// Lowest override, %.
    pub override_min_percent: f64,
    /// Highest override, %.
    pub override_max_percent: f64,
}

/// Set loads, percent of the machine's declared ratings: the operation's, or the feed profile's where one is to be run and its are lower.
#[derive(Debug, Serialize, ToSchema)]
pub struct SetLoadsBody {
    /// Of the spindle drive, %.
    pub spindle_load_set_percent: Option<f64>,
    /// Of the feed drive, %.
    pub feed_drive_load_set_percent: Option<f64>,
}

/// The tool's state when the recommendation was made.
#[derive(Debug, Serialize, ToSchema)]
pub struct ToolStateBody {
    /// The state.
    #[schema(example = "good")]
    pub state: &'static str,
    /// The level.
    pub level: Option<LevelBody>,
    /// Cycles that remain.
    pub remaining: Option<RemainingBody>,
}

/// Quality and age of the data.
#[derive(Debug, Serialize, ToSchema)]
pub struct DataBody {
    /// `good`, `limited`, `stale` or `missing`: no cycle at all.
    #[schema(example = "good")]
    pub quality: &'static str,
    /// Age of the tool's last cycle that counted, and only where none did of its last one, when the recommendation was made, ms;
    /// null where there is no cycle.
    pub age_ms: Option<i64>,
}

impl RecommendationBody<'_> {
    /// With texts of its own.
    pub fn owned(self) -> RecommendationBody<'static> {
        RecommendationBody {
            id: owned(self.id),
            machine: owned(self.machine),
            operation: owned(self.operation),
            tool: owned(self.tool),
            reasons: self.reasons.into_iter().map(ReasonBody::owned).collect(),
            law_version: owned(self.law_version),
            ..self
        }
    }
}

impl<'a> From<&'a IssuedRecommendation> for RecommendationBody<'a> {
    fn from(issued: &'a IssuedRecommendation) -> Self {
        let advice = &issued.recommendation;
        Self {
            id: issued.id.as_str().into(),
            issued_at: time::show(advice.issued_at),
            valid_until: time::show(advice.valid_until),
            machine: advice.machine.as_str().into(),
            operation: advice.operation.as_str().into(),
            tool: advice.tool.as_str().into(),
            process: advice.process.map_or("unknown", feedwright_core::units::Process::as_str),
            action: advice.action.as_str(),
            feed: FeedBody {
                source: match (&advice.profile, advice.feed_mm_min) {
                    (Some(_), _) => "profile",
                    (None, Some(_)) => "programmed",
                    (None, None) => "program",
                },
                feed_mm_min: advice.feed_mm_min,
                profile: advice.profile.as_ref().map(|profile| RecommendedProfileBody {
                    id: profile.version.profile.to_string(),
                    version: profile.version.version,
                    hash: profile.hash.to_string(),
                    time_s: profile.time_s,
                    wear_to_level: profile.wear_to_level,
                    content: format!(
                        "/v1/feed-profiles/{}/versions/{}",
                        profile.version.profile, profile.version.version
                    ),
                }),
            },
            override_percent: advice.override_percent,
            limits: AdviceLimitsBody {
                feed_min_mm_min: advice.limits.min_mm_min(),
                feed_max_mm_min: advice.limits.max_mm_min(),
                override_min_percent: advice.limits.override_min_percent(),
                override_max_percent: advice.limits.override_max_percent(),
            },
            load_limits: SetLoadsBody {
                spindle_load_set_percent: advice.spindle_load_set_percent,
                feed_drive_load_set_percent: advice.feed_drive_load_set_percent,
            },
            tool_state: ToolStateBody {
                state: advice.tool_state.as_str(),
                level: advice.level.map(Into::into),
                remaining: advice.remaining.map(Into::into),
            },
            data: DataBody { quality: advice.quality.as_str(), age_ms: advice.data_age_ms },
            process_advice: advice.process_advice.clone().map(Into::into),
            reference_cycle: advice.reference_cycle.map(|asked| ReferenceRequestBody {
                every_cycles: asked.every,
                feed_mm_min: asked.feed_mm_min,
            }),
            reasons: advice.reasons.iter().map(|(code, message)| ReasonBody::of(code, message)).collect(),
            law_version: advice.law_version.as_str().into(),
        }
    }
}

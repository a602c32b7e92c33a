//! Feed profiles in JSON.

use super::text::{MAX_REASON, required};
use super::time;
use super::word::{ProfileSourceWord, SectionKindWord, VersionStateWord};
use feedwright_core::feed::profile::{
    Change, Conditions, KnotInput, LimitsInput, Profile, ProfileDiff, ProfileInput, SectionInput,
    WearBandInput,
};
use feedwright_core::ids::{OperationId, ProfileId};
use feedwright_core::invalid::Violation;
use feedwright_core::operation::Operation;
use feedwright_store::{FeedProfile, StoredProfileVersion, Taken};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};

/// Ids that are words of paths.
const RESERVED: [&str; 3] = ["import", "optimize", "read"];

/// A knot: the feed runs linearly in depth from one to the next.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct KnotBody {
    /// Tip depth below first contact, mm, positive into the work; kept to 0.001.
    pub depth_mm: f64,
    /// Feed, mm/min; kept to 0.001.
    pub feed_mm_min: f64,
}

/// A section: begins where the one before ends.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SectionBody {
    /// `heating`, `forming`, `idle_travel` or `flange`, in this order.
    pub kind: SectionKindWord,
    /// Depth at which it ends, mm.
    pub to_mm: f64,
}

/// Limits that the profile keeps.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProfileLimitsBody {
    /// Slowest feed, mm/min.
    pub feed_min_mm_min: f64,
    /// Fastest feed, mm/min.
    pub feed_max_mm_min: f64,
    /// Largest acceleration along the path, mm/s².
    pub acceleration_mm_s2: f64,
    /// Lowest override under which it may run, %.
    pub override_min_percent: f64,
    /// Highest override under which it may run, %.
    pub override_max_percent: f64,
    /// Set load of the spindle drive, %.
    #[serde(default)]
    pub spindle_load_set_percent: Option<f64>,
    /// Set load of the feed drive, %.
    #[serde(default)]
    pub feed_drive_load_set_percent: Option<f64>,
}

impl ProfileLimitsBody {
    /// As the core takes them.
    pub fn to_input(self) -> LimitsInput {
        LimitsInput {
            feed_min_mm_min: self.feed_min_mm_min,
            feed_max_mm_min: self.feed_max_mm_min,
            acceleration_mm_s2: self.acceleration_mm_s2,
            override_min_percent: self.override_min_percent,
            override_max_percent: self.override_max_percent,
            spindle_load_set_percent: self.spindle_load_set_percent,
            feed_drive_load_set_percent: self.feed_drive_load_set_percent,
        }
    }
}

/// Tool wear for which it is meant: level of wear, 1 is the new tool.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WearBandBody {
    /// Level from which it is meant; the new tool where it is left out.
    #[serde(default)]
    pub from_level: Option<f64>,
    /// Level up to which it holds: beyond, it is not handed out.
    pub to_level: f64,
}

/// What has to be so for it to hold.
#[derive(Debug, Clone, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ConditionsBody {
    /// NC program of the operation.
    pub program: Option<String>,
    /// Work material of the operation.
    pub work_material: Option<String>,
    /// Commanded spindle speed, rpm.
    pub spindle_speed_rpm: Option<f64>,
}

/// A profile: what a control runs, and when it holds.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "operation": "bushing-m8", "tool_type": "friction-drill-7.3",
    "knots": [{"depth_mm": 0.0, "feed_mm_min": 105.0}, {"depth_mm": 3.0, "feed_mm_min": 155.0},
              {"depth_mm": 7.0, "feed_mm_min": 535.0}, {"depth_mm": 20.5, "feed_mm_min": 345.0}],
    "sections": [{"kind": "heating", "to_mm": 3.0}, {"kind": "forming", "to_mm": 20.5}],
    "limits": {"feed_min_mm_min": 50.0, "feed_max_mm_min": 1000.0, "acceleration_mm_s2": 300.0,
               "override_min_percent": 20.0, "override_max_percent": 150.0,
               "spindle_load_set_percent": 40.0, "feed_drive_load_set_percent": 30.0},
    "wear": {"to_level": 1.07}
}))]
pub struct ProfileBody {
    /// What is machined.
    pub operation: String,
    /// Kind of tool.
    pub tool_type: String,
    /// 2 to 256 knots, from depth 0 to the end.
    pub knots: Vec<KnotBody>,
    /// 1 to 16 sections that cover the depth.
    pub sections: Vec<SectionBody>,
    /// Limits.
    pub limits: ProfileLimitsBody,
    /// Tool wear.
    pub wear: WearBandBody,
    /// Conditions; those that the operation states where they are left out.
    #[serde(default)]
    pub conditions: Option<ConditionsBody>,
}

impl ProfileBody {
    /// The operation that it names.
    pub fn operation(&self, at: &str) -> Result<OperationId, Violation> {
        OperationId::parse(&format!("{at}.operation"), &self.operation)
    }

    /// The checked profile for its operation; `at` is the path of this body.
    pub fn profile(&self, at: &str, operation: &Operation) -> Result<Profile, Vec<Violation>> {
        let conditions = self.conditions.clone().unwrap_or_else(|| ConditionsBody {
            program: operation.program.clone(),
            work_material: operation.work_material.clone(),
            spindle_speed_rpm: operation.spindle_speed_rpm,
        });
        self.checked(at, operation.id.clone(), conditions)
    }

    /// The checked profile as it stands, whatever its operation says today; `at` is the path of this body.
    pub fn as_it_stands(&self, at: &str) -> Result<Profile, Vec<Violation>> {
        let operation = self.operation(at).map_err(|one| vec![one])?;
        self.checked(at, operation, self.conditions.clone().unwrap_or_default())
    }

    fn checked(
        &self,
        at: &str,
        operation: OperationId,
        conditions: ConditionsBody,
    ) -> Result<Profile, Vec<Violation>> {
        let input = ProfileInput {
            operation,
            tool_type: self.tool_type.clone(),
            knots: self
                .knots
                .iter()
                .map(|knot| KnotInput { depth_mm: knot.depth_mm, feed_mm_min: knot.feed_mm_min })
                .collect(),
            sections: self
                .sections
                .iter()
                .map(|section| SectionInput { kind: section.kind.0, to_mm: section.to_mm })
                .collect(),
            limits: self.limits.to_input(),
            wear: WearBandInput { from_level: self.wear.from_level, to_level: self.wear.to_level },
            conditions: Conditions {
                program: conditions.program,
                work_material: conditions.work_material,
                spindle_speed_rpm: conditions.spindle_speed_rpm,
            },
        };
        let inside = |one: Violation| Violation { path: format!("{at}.{}", one.path), ..one };
        Profile::new(input).map_err(|wrong| wrong.into_iter().map(inside).collect())
    }
}

impl From<&Profile> for ProfileBody {
    fn from(profile: &Profile) -> Self {
        let ProfileInput { operation, tool_type, knots, sections, limits, wear, conditions } =
            profile.to_input();
        Self {
            operation: operation.to_string(),
            tool_type,
            knots: knots
                .into_iter()
                .map(|knot| KnotBody { depth_mm: knot.depth_mm, feed_mm_min: knot.feed_mm_min })
                .collect(),
            sections: sections
                .into_iter()
                .map(|section| SectionBody { kind: SectionKindWord(section.kind), to_mm: section.to_mm })
                .collect(),
            limits: ProfileLimitsBody {
                feed_min_mm_min: limits.feed_min_mm_min,
                feed_max_mm_min: limits.feed_max_mm_min,
                acceleration_mm_s2: limits.acceleration_mm_s2,
                override_min_percent: limits.override_min_percent,
                override_max_percent: limits.override_max_percent,
                spindle_load_set_percent: limits.spindle_load_set_percent,
                feed_drive_load_set_percent: limits.feed_drive_load_set_percent,
            },
            wear: WearBandBody { from_level: wear.from_level, to_level: wear.to_level },
            conditions: Some(ConditionsBody {
                program: conditions.program,
                work_material: conditions.work_material,
                spindle_speed_rpm: conditions.spindle_speed_rpm,
            }),
        }
    }
}

/// A version to be drafted.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct DraftBody {
    /// Name of the feed profile: a new one, or one for the same operation, tool type and wear band.
    #[schema(example = "bushing-m8-long")]
    pub profile: String,
    /// Its content; or leave it out and name a job.
    #[serde(default)]
    pub content: Option<ProfileBody>,
    /// A finished optimisation of this server whose result is drafted.
    #[serde(default)]
    pub job: Option<String>,
    /// Which wear band of that optimisation, counted from 0, where it was asked for bands. Each is a feed profile of its own.
    #[serde(default)]
    pub band: Option<usize>,
    /// The version of this feed profile that it was changed from.
    #[serde(default)]
    #[schema(minimum = 1)]
    pub based_on: Option<u32>,
    /// Why it is drafted.
    #[schema(example = "Heating ends earlier: the feed-drive load already falls inside it")]
    pub reason: String,
}

/// The name of a feed profile to be drafted; `at` is the field's path.
pub fn profile_id(at: &str, text: &str) -> Result<ProfileId, Violation> {
    if RESERVED.contains(&text) {
        return Err(Violation::new(at, "reserved", "is a word of this API: choose another name"));
    }
    ProfileId::parse(at, text)
}

/// The reason for a draft.
pub fn reason(text: &str, wrong: &mut Vec<Violation>) -> String {
    required("reason", text, MAX_REASON, wrong)
}

/// The version that a step is taken with.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StepBody {
    /// Its number.
    #[schema(example = 2, minimum = 1)]
    pub version: u32,
}

/// A line of versions.
#[derive(Debug, Serialize, ToSchema)]
pub struct FeedProfileBody {
    /// Its name.
    pub id: String,
    /// What is machined.
    pub operation: String,
    /// Kind of tool.
    pub tool_type: String,
    /// Level of wear from which it is meant; null for the new tool.
    pub wear_from_level: Option<f64>,
    /// Counts every change; the ETag holds it, and every step names it with `If-Match`.
    pub revision: u64,
    /// The version that is handed out; null where none is.
    pub active_version: Option<u32>,
    /// The newest version.
    pub newest_version: u32,
    /// When it was drafted first, RFC 3339.
    pub created_at: String,
    /// When it was changed last, RFC 3339.
    pub updated_at: String,
}

impl From<FeedProfile> for FeedProfileBody {
    fn from(line: FeedProfile) -> Self {
        Self {
            id: line.id.to_string(),
            operation: line.operation.to_string(),
            tool_type: line.tool_type,
            wear_from_level: line.wear_from_level,
            revision: line.revision,
            active_version: line.active,
            newest_version: line.newest,
            created_at: time::show(line.created_at),
            updated_at: time::show(line.updated_at),
        }
    }
}

/// Who took a step, and when.
#[derive(Debug, Serialize, ToSchema)]
pub struct TakenBody {
    /// Id of the token.
    pub by: String,
    /// When, RFC 3339.
    pub at: String,
}

impl From<Taken> for TakenBody {
    fn from(taken: Taken) -> Self {
        Self { by: taken.by, at: time::show(taken.at) }
    }
}

/// A version: its content never changes, only where it stands.
#[derive(Debug, Serialize, ToSchema)]
pub struct ProfileVersionBody {
    /// Name of the feed profile.
    pub profile: String,
    /// Its number, counted from 1.
    pub version: u32,
    /// blake3 over the canonical text of its content, as exported files name it.
    pub hash: String,
    /// `draft`, `shadow`, `approved`, `active` or `superseded`.
    pub state: VersionStateWord,
    /// Its content.
    pub content: ProfileBody,
    /// Time from first contact to the end at an override of 100 %, s.
    pub time_s: f64,
    /// `drawn`, `imported` or `optimised`.
    pub source: ProfileSourceWord,
    /// The version that it was changed from.
    pub based_on: Option<u32>,
    /// Why it was drafted.
    pub reason: String,
    /// What the optimiser or the import says of it.
    #[schema(value_type = Option<Object>)]
    pub report: Option<Value>,
    /// Who drafted it.
    pub drafted: TakenBody,
    /// Who put it into shadow.
    pub shadowed: Option<TakenBody>,
    /// Who approved it.
    pub approved: Option<TakenBody>,
    /// Who activated it last.
    pub activated: Option<TakenBody>,
    /// When it stopped being active, RFC 3339.
    pub superseded_at: Option<String>,
    /// Whether it stopped because it was rolled back.
    pub rolled_back: bool,
}

impl From<StoredProfileVersion> for ProfileVersionBody {
    fn from(stored: StoredProfileVersion) -> Self {
        Self {
            profile: stored.version.profile.to_string(),
            version: stored.version.version,
            hash: stored.hash.to_string(),
            state: VersionStateWord(stored.state),
            content: (&stored.content).into(),
            time_s: stored.content.time_s(),
            source: ProfileSourceWord(stored.source),
            based_on: stored.based_on,
            reason: stored.reason,
            // The store holds what this service wrote; anything else is not shown.
            report: stored.report.and_then(|text| serde_json::from_str(&text).ok()),
            drafted: stored.drafted.into(),
            shadowed: stored.shadowed.map(Into::into),
            approved: stored.approved.map(Into::into),
            activated: stored.activated.map(Into::into),
            superseded_at: stored.superseded_at.map(time::show),
            rolled_back: stored.rolled_back,
        }
    }
}

/// A drafted version, with the line's revision.
#[derive(Debug, Serialize, ToSchema)]
pub struct DraftedBody {
    /// Revision of the feed profile after it: what the next step names with `If-Match`.
    pub revision: u64,
    /// The version.
    #[serde(flatten)]
    pub version: ProfileVersionBody,
}

/// Which feed profiles.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct FeedProfilesQuery {
    /// Of this operation.
    pub operation: Option<String>,
    /// Of this kind of tool.
    pub tool_type: Option<String>,
    /// Most rows wanted, up to `limits.max_page_size` of the configuration, which is 1000 unless set otherwise; 100
    /// (`limits.default_page_size`) where it is left out.
    #[param(minimum = 1, maximum = 10_000)]
    pub limit: Option<u32>,
    /// `next_cursor` of the page before.
    pub cursor: Option<String>,
}

/// Two versions of a feed profile.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct DiffQuery {
    /// The earlier one; the active one where it is left out.
    #[param(minimum = 1)]
    pub from: Option<u32>,
    /// The later one; the newest where it is left out.
    #[param(minimum = 1)]
    pub to: Option<u32>,
}

/// A setting that differs.
#[derive(Debug, Serialize, ToSchema)]
pub struct SettingDiffBody {
    /// Its name.
    pub name: &'static str,
    /// Before.
    pub before: String,
    /// After.
    pub after: String,
}

/// A knot that is not the same in both.
#[derive(Debug, Serialize, ToSchema)]
pub struct KnotDiffBody {
    /// Its depth, mm.
    pub depth_mm: f64,
    /// `added`, `removed` or `changed`.
    pub change: &'static str,
    /// Feed of the earlier version there, mm/min; between its knots where it has none.
    pub before_mm_min: f64,
    /// Feed of the later version there, mm/min.
    pub after_mm_min: f64,
}

/// A section of the later version, with the time of both over its stretch.
#[derive(Debug, Serialize, ToSchema)]
pub struct SectionDiffBody {
    /// What happens in it.
    pub kind: SectionKindWord,
    /// Where it begins, mm.
    pub from_mm: f64,
    /// Where it ends, mm.
    pub to_mm: f64,
    /// Time of the earlier version, s.
    pub before_s: f64,
    /// Time of the later version, s.
    pub after_s: f64,
    /// Later minus earlier, s.
    pub change_s: f64,
    /// Largest rise of the feed within it, mm/min.
    pub largest_rise_mm_min: f64,
    /// Largest fall of the feed within it, mm/min.
    pub largest_fall_mm_min: f64,
}

/// What differs between two versions.
#[derive(Debug, Serialize, ToSchema)]
pub struct DiffBody {
    /// The earlier version.
    pub from: u32,
    /// The later version.
    pub to: u32,
    /// Settings that differ.
    pub settings: Vec<SettingDiffBody>,
    /// Knots that are not the same in both, by depth.
    pub knots: Vec<KnotDiffBody>,
    /// The later version's sections.
    pub sections: Vec<SectionDiffBody>,
    /// Time of the earlier version, s.
    pub before_s: f64,
    /// Time of the later version, s.
    pub after_s: f64,
    /// Later minus earlier, s.
    pub change_s: f64,
}

impl DiffBody {
    /// The answer for two versions.
    pub fn new(from: u32, to: u32, found: ProfileDiff) -> Self {
        let knots = found.knots.into_iter().map(|knot| {
            let (change, before_mm_min, after_mm_min) = match knot.change {
                Change::Added { before_mm_min, after_mm_min } => ("added", before_mm_min, after_mm_min),
                Change::Removed { before_mm_min, after_mm_min } => ("removed", before_mm_min, after_mm_min),
                Change::Changed { before_mm_min, after_mm_min } => ("changed", before_mm_min, after_mm_min),
            };
            KnotDiffBody { depth_mm: knot.depth_mm, change, before_mm_min, after_mm_min }
        });
        let sections = found.sections.into_iter().map(|section| SectionDiffBody {
            kind: SectionKindWord(section.kind),
            from_mm: section.from_mm,
            to_mm: section.to_mm,
            before_s: section.before_s,
            after_s: section.after_s,
            change_s: section.after_s - section.before_s,
            largest_rise_mm_min: section.largest_rise_mm_min,
            largest_fall_mm_min: section.largest_fall_mm_min,
        });
        Self {
            from,
            to,
            settings: found
                .settings
                .into_iter()
                .map(|one| SettingDiffBody { name: one.name, before: one.before, after: one.after })
                .collect(),
            knots: knots.collect(),
            sections: sections.collect(),
            before_s: found.before_s,
            after_s: found.after_s,
            change_s: found.after_s - found.before_s,
        }
    }
}

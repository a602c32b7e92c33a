//! Optimising a feed profile, in JSON.

use super::feed_profile::{ProfileBody, ProfileLimitsBody};
use feedwright_core::feed::optimise::{
    Band, Bushing, Comparison, Deviation, Heating, Identified, Objective, Prediction, Proposal, Section,
    Settings, SettingsParams, check_edges,
};
use feedwright_core::feed::profile::LimitsInput;
use feedwright_core::friction::error::Invalid;
use feedwright_core::invalid::Violation;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// Cycles that are learned from where no number is named: as many as the optimiser takes.
pub const USUAL_CYCLES: u32 = 40;
/// Wear up to which a version holds at most: there the tool is worn.
pub const WORN_LEVEL: f64 = 1.10;

/// The tool maker's feed while the material heats up.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct HeatingBody {
    /// Never faster than this, mm/min.
    pub feed_mm_min: f64,
    /// Depth at which heating ends, mm.
    pub until_mm: f64,
    /// Whether it may end earlier, where the feed-drive load has clearly passed its maximum.
    #[serde(default)]
    pub may_shorten: bool,
}

/// The last part of the bushing, where a fast feed makes petals and cracks.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BushingBody {
    /// Where it begins, mm.
    pub from_mm: f64,
    /// Where it ends, mm.
    pub to_mm: f64,
    /// Never faster than this, mm/min.
    pub feed_mm_min: f64,
}

/// What is made smallest.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ObjectiveBody {
    /// Cycle time.
    #[default]
    Time,
    /// Spindle work over idle.
    Energy,
    /// A weighted cost.
    Cost {
        /// Cost of a second.
        per_second: f64,
        /// Cost of one percent of spindle load over idle for one second.
        per_percent_second: f64,
    },
}

/// What is optimised from which cycles.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "operation": "bushing-m8", "tool_type": "friction-drill-7.3", "profile": "bushing-m8-long",
    "limits": {"feed_min_mm_min": 50.0, "feed_max_mm_min": 1000.0, "acceleration_mm_s2": 300.0,
               "override_min_percent": 20.0, "override_max_percent": 150.0,
               "spindle_load_set_percent": 40.0, "feed_drive_load_set_percent": 30.0},
    "heating": {"feed_mm_min": 155.0, "until_mm": 3.0}
}))]
pub struct OptimiseBody {
    /// What is machined; its depth has to be registered.
    pub operation: String,
    /// Kind of tool.
    pub tool_type: String,
    /// The feed profile whose version was tried last; the feed that ran where it is left out.
    #[serde(default)]
    pub profile: Option<String>,
    /// The version that was tried last; the active one, else the newest, where it is left out.
    #[serde(default)]
    #[schema(minimum = 1)]
    pub last_version: Option<u32>,
    /// Limits; both set loads are needed.
    pub limits: ProfileLimitsBody,
    /// What the tool maker asks for.
    #[serde(default)]
    pub heating: Option<HeatingBody>,
    /// What the bushing asks for.
    #[serde(default)]
    pub bushing: Option<BushingBody>,
    /// What is made smallest; cycle time where it is left out.
    #[serde(default)]
    pub objective: ObjectiveBody,
    /// Probability with which the expected load is at or below its set load; 0.9 where it is left out.
    #[serde(default)]
    #[schema(minimum = 0.5, maximum = 0.999)]
    pub confidence: Option<f64>,
    /// Most knots; 20 where it is left out.
    #[serde(default)]
    #[schema(minimum = 4, maximum = 64)]
    pub most_knots: Option<usize>,
    /// Wear for which it is planned, 1 is the new tool; that of the latest cycle where it is left out.
    #[serde(default)]
    pub wear_level: Option<f64>,
    /// Level of wear from which the version is meant, for a line of its own; the new tool where it is left out.
    #[serde(default)]
    pub wear_from_level: Option<f64>,
    /// A profile per wear band: 2 to 9 levels between which bands lie, increasing, 1 is the new tool. Bands whose own
    /// profile would gain less than 1 % are joined. Needs cycles whose wear is known; in place of `wear_level`.
    #[serde(default)]
    pub wear_edges: Option<Vec<f64>>,
    /// Highest override at which it will run, %: above 100, loads are kept at that feed. 100 where it is left out.
    #[serde(default)]
    pub override_percent: Option<f64>,
    /// How many of the operation's last cycles are looked at, 1 to 40.
    #[serde(default)]
    #[schema(minimum = 1, maximum = 40)]
    pub cycles: Option<u32>,
}

/// What the service itself knows for an optimisation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Known {
    /// Depth of the operation, mm.
    pub depth_mm: f64,
    /// Watts that one percent of spindle load stands for.
    pub watts_per_percent: Option<f64>,
    /// Factor on the spread, from how earlier predictions turned out.
    pub spread_scale: f64,
}

/// Settings for a depth and limits; both set loads are needed.
pub fn settings(operation: &str, depth_mm: f64, limits: &LimitsInput) -> Result<SettingsParams, Violation> {
    let need = |path: &str, value: Option<f64>| {
        value.ok_or_else(|| {
            Violation::new(path, "missing_field", "is needed: it is what the loads are kept at")
        })
    };
    let feed_drive = need("limits.feed_drive_load_set_percent", limits.feed_drive_load_set_percent)?;
    let spindle = need("limits.spindle_load_set_percent", limits.spindle_load_set_percent)?;
    Ok(SettingsParams {
        feed_min_mm_min: limits.feed_min_mm_min,
        feed_max_mm_min: limits.feed_max_mm_min,
        acceleration_mm_s2: limits.acceleration_mm_s2,
        ..SettingsParams::new(operation, depth_mm, feed_drive, spindle)
    })
}

/// A refusal of the core with the path of the body's field.
pub fn refused(error: &Invalid) -> Violation {
    let path = match error.field() {
        "set_feed_drive_percent" => "limits.feed_drive_load_set_percent",
        "set_spindle_percent" => "limits.spindle_load_set_percent",
        "feed_min_mm_min" => "limits.feed_min_mm_min",
        "feed_max_mm_min" => "limits.feed_max_mm_min",
        "acceleration_mm_s2" => "limits.acceleration_mm_s2",
        "wear_ratio" => "wear_level",
        "edges" => "wear_edges",
        other => return Violation::new(edge(other), error.code().as_str(), error.message()),
    };
    Violation::new(path, error.code().as_str(), error.message())
}

/// `edges[2]` as the body names it.
fn edge(field: &str) -> String {
    field.strip_prefix("edges[").map_or_else(|| field.to_owned(), |rest| format!("wear_edges[{rest}"))
}

impl OptimiseBody {
    /// The checked settings.
    pub fn settings(&self, known: &Known) -> Result<Settings, Violation> {
        if self.wear_edges.is_some() && (self.wear_level.is_some() || self.wear_from_level.is_some()) {
            let why = "each band has its own: leave wear_level and wear_from_level out";
            return Err(Violation::new("wear_edges", "one_of", why));
        }
        self.wear_edges.as_deref().map_or(Ok(()), check_edges).map_err(|error| refused(&error))?;
        let base = settings(&self.operation, known.depth_mm, &self.limits.to_input())?;
        let params = SettingsParams {
            heating: self.heating.map(|heating| Heating {
                feed_mm_min: heating.feed_mm_min,
                until_mm: heating.until_mm,
                may_shorten: heating.may_shorten,
            }),
            bushing: self.bushing.map(|bushing| Bushing {
                from_mm: bushing.from_mm,
                to_mm: bushing.to_mm,
                feed_mm_min: bushing.feed_mm_min,
            }),
            objective: match self.objective {
                ObjectiveBody::Time => Objective::Time,
                ObjectiveBody::Energy => Objective::Energy,
                ObjectiveBody::Cost { per_second, per_percent_second } => {
                    Objective::Cost { per_second, per_percent_second }
                }
            },
            confidence: self.confidence.unwrap_or(base.confidence),
            most_knots: self.most_knots.unwrap_or(base.most_knots),
            // A profile that is meant from a level on is planned for it.
            wear_ratio: self.wear_level.or(self.wear_from_level),
            override_percent: self.override_percent.unwrap_or(base.override_percent),
            watts_per_percent: known.watts_per_percent,
            spread_scale: known.spread_scale,
            ..base
        };
        Settings::new(params).map_err(|error| refused(&error))
    }
}

/// A value with the range that nine cycles in ten are expected in.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
pub struct BandBody {
    /// Lower end.
    pub low: f64,
    /// Expected.
    pub expected: f64,
    /// Upper end.
    pub high: f64,
}

impl From<Band> for BandBody {
    fn from(band: Band) -> Self {
        Self { low: band.low, expected: band.expected, high: band.high }
    }
}

impl From<BandBody> for Band {
    fn from(band: BandBody) -> Self {
        Self { low: band.low, expected: band.expected, high: band.high }
    }
}

/// What one cycle of a version is expected to show.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
pub struct PredictionBody {
    /// From contact to the end, s.
    pub time_s: BandBody,
    /// Largest filtered feed-drive load, %.
    pub peak_feed_drive_percent: BandBody,
    /// Largest filtered spindle load, %.
    pub peak_spindle_percent: BandBody,
    /// Spindle load over idle times time, percent-seconds.
    pub spindle_percent_s: BandBody,
    /// The same as energy, J, where it is known what a percent stands for.
    pub energy_joules: Option<BandBody>,
}

impl From<Prediction> for PredictionBody {
    fn from(one: Prediction) -> Self {
        Self {
            time_s: one.time_s.into(),
            peak_feed_drive_percent: one.peak_feed_drive_percent.into(),
            peak_spindle_percent: one.peak_spindle_percent.into(),
            spindle_percent_s: one.spindle_percent_s.into(),
            energy_joules: one.energy_j.map(Into::into),
        }
    }
}

impl From<PredictionBody> for Prediction {
    fn from(one: PredictionBody) -> Self {
        Self {
            time_s: one.time_s.into(),
            peak_feed_drive_percent: one.peak_feed_drive_percent.into(),
            peak_spindle_percent: one.peak_spindle_percent.into(),
            spindle_percent_s: one.spindle_percent_s.into(),
            energy_j: one.energy_joules.map(Into::into),
        }
    }
}

/// A limit that holds the feed back, with its share of the section's time.
#[derive(Debug, Serialize, ToSchema)]
pub struct BindingBody {
    /// Which.
    pub limit: &'static str,
    /// Share of the section's time.
    pub share: f64,
}

/// One section of a proposal, explained.
#[derive(Debug, Serialize, ToSchema)]
pub struct ExplainedSectionBody {
    /// What happens in it.
    pub kind: &'static str,
    /// Where it begins, mm.
    pub from_mm: f64,
    /// Where it ends, mm.
    pub to_mm: f64,
    /// Expected time in it, s.
    pub time_s: f64,
    /// Time gained over what was tried last, s.
    pub gained_s: f64,
    /// What holds the feed back, largest share first.
    pub bindings: Vec<BindingBody>,
    /// Largest expected feed-drive load, %.
    pub peak_feed_drive_percent: Option<f64>,
    /// Largest expected spindle load, %.
    pub peak_spindle_percent: Option<f64>,
    /// Smallest probability in it that an expected load is at or below its set load.
    pub confidence: f64,
    /// The same in a sentence.
    pub text: String,
}

impl From<&Section> for ExplainedSectionBody {
    fn from(section: &Section) -> Self {
        Self {
            kind: section.kind.as_str(),
            from_mm: section.from_mm,
            to_mm: section.to_mm,
            time_s: section.time_s,
            gained_s: section.gained_s,
            bindings: section
                .bindings
                .iter()
                .map(|(binding, share)| BindingBody { limit: binding.as_str(), share: *share })
                .collect(),
            peak_feed_drive_percent: section.peak_feed_drive_percent,
            peak_spindle_percent: section.peak_spindle_percent,
            confidence: section.confidence,
            text: section.text.clone(),
        }
    }
}

/// What was learned of one drive.
#[derive(Debug, Serialize, ToSchema)]
pub struct IdentifiedBody {
    /// Relative rise of the load over idle with the feed.
    pub slope: f64,
    /// Its standard deviation.
    pub slope_sd: f64,
    /// Unevenness within a cycle, relative.
    pub uneven: f64,
    /// Unevenness from cycle to cycle, relative.
    pub common: f64,
}

impl From<&Identified> for IdentifiedBody {
    fn from(one: &Identified) -> Self {
        Self { slope: one.slope, slope_sd: one.slope_sd, uneven: one.uneven, common: one.common }
    }
}

/// A cycle that was left out.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct SkippedBody {
    /// Which, as `machine/cycle`.
    pub cycle: String,
    /// Why.
    pub reason: &'static str,
}

/// Everything that a reviewer asks of a proposal.
#[derive(Debug, Serialize, ToSchema)]
pub struct ProposalReport {
    /// `try`, `keep` or `replace`.
    pub advice: &'static str,
    /// Section by section.
    pub sections: Vec<ExplainedSectionBody>,
    /// What one cycle of it is expected to show.
    pub prediction: PredictionBody,
    /// What was tried last is expected to show.
    pub last_prediction: PredictionBody,
    /// Expected gain over what was tried last, s.
    pub gain_s: f64,
    /// Smallest probability over the depth that an expected load is at or below its set load.
    pub confidence: f64,
    /// Largest wear up to which it holds; null where the wear of the cycles is not known.
    pub holds_up_to_wear: Option<f64>,
    /// What was learned of the feed drive and of the spindle.
    pub identified: [IdentifiedBody; 2],
    /// Idle loads of feed drive and spindle, %.
    pub idle_percent: [f64; 2],
    /// Factor on the spread of the bands, from how the last tried version's prediction turned out: 1 as learned.
    pub spread_scale: f64,
    /// Cycles that were learned from.
    pub learned_from: usize,
    /// Cycles that were not, and why. One that was aborted or cut short is learned from as far as it went.
    pub skipped: Vec<SkippedBody>,
    /// What else to know.
    pub warnings: Vec<&'static str>,
}

impl ProposalReport {
    /// The report on a proposal; `skipped` comes before what the optimiser skipped itself.
    pub fn new(proposal: &Proposal, settings: &Settings, mut skipped: Vec<SkippedBody>) -> Self {
        use feedwright_core::feed::optimise::Advice;
        skipped.extend(
            proposal
                .skipped
                .iter()
                .map(|one| SkippedBody { cycle: one.id.clone(), reason: one.reason.as_str() }),
        );
        let [feed_drive, spindle] = &proposal.identified;
        Self {
            advice: match proposal.advice {
                Advice::Try => "try",
                Advice::Keep => "keep",
                Advice::Replace => "replace",
            },
            sections: proposal.sections.iter().map(Into::into).collect(),
            prediction: proposal.prediction.into(),
            last_prediction: proposal.last_prediction.into(),
            gain_s: proposal.gain_s(),
            confidence: proposal.confidence,
            holds_up_to_wear: proposal.holds_up_to_wear,
            identified: [feed_drive.into(), spindle.into()],
            idle_percent: proposal.idle_percent,
            spread_scale: settings.spread_scale,
            learned_from: proposal.learned_from,
            skipped,
            warnings: proposal.warnings.iter().map(|warning| warning.as_str()).collect(),
        }
    }
}

/// The profile of one wear band.
#[derive(Debug, Serialize, ToSchema)]
pub struct BandResultBody {
    /// Level of wear from which it is meant.
    pub from_level: f64,
    /// Level of wear for which it is planned.
    pub to_level: f64,
    /// The proposed content; null where it is no profile.
    pub content: Option<ProfileBody>,
    /// Everything that a reviewer asks.
    pub report: Option<ProposalReport>,
}

/// The result of an optimisation: a content to be drafted (`POST /v1/feed-profiles` with the job's id, and the band where
/// bands were asked for), or why there is none.
#[derive(Debug, Serialize, ToSchema)]
pub struct OptimisedBody {
    /// The proposed content; null where bands were asked for.
    pub content: Option<ProfileBody>,
    /// Everything that a reviewer asks.
    pub report: Option<ProposalReport>,
    /// A profile per wear band, from the new tool to the worn one; empty where none were asked for.
    pub bands: Vec<BandResultBody>,
    /// Why there is none: path, code and a sentence of each violation.
    pub refused: Vec<RefusedBody>,
    /// Where there is none: cycles without samples that can be learned from, and why (`samples_dropped`, or missing, and
    /// `no_samples`). Empty where a report names them.
    pub skipped: Vec<SkippedBody>,
}

/// Why there is no proposal.
#[derive(Debug, Serialize, ToSchema)]
pub struct RefusedBody {
    /// The field.
    pub path: String,
    /// Stable code.
    pub code: &'static str,
    /// A sentence.
    pub message: String,
}

impl From<Violation> for RefusedBody {
    fn from(one: Violation) -> Self {
        Self { path: one.path, code: one.code, message: one.message }
    }
}

/// Which version's prediction is held against its cycles.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct OutcomeQuery {
    /// The version; the active one where it is left out.
    #[param(minimum = 1)]
    pub version: Option<u32>,
    /// How many of its last cycles, 1 to 40.
    #[param(minimum = 1, maximum = 40)]
    pub cycles: Option<u32>,
}

/// One figure, predicted and actual.
#[derive(Debug, Serialize, ToSchema)]
pub struct DeviationBody {
    /// What happened.
    pub actual: f64,
    /// Over what was expected, minus 1.
    pub relative: f64,
    /// Whether it lies in the band.
    pub within: bool,
}

impl From<Deviation> for DeviationBody {
    fn from(one: Deviation) -> Self {
        Self { actual: one.actual, relative: one.relative, within: one.within }
    }
}

/// One cycle against the prediction.
#[derive(Debug, Serialize, ToSchema)]
pub struct CycleOutcomeBody {
    /// Its machine.
    pub machine: String,
    /// Its id.
    pub cycle_id: String,
    /// From contact to the end, s.
    pub time_s: DeviationBody,
    /// Largest filtered feed-drive load, %.
    pub peak_feed_drive_percent: DeviationBody,
    /// Largest filtered spindle load, %.
    pub peak_spindle_percent: DeviationBody,
    /// Spindle load over idle times time, percent-seconds.
    pub spindle_percent_s: DeviationBody,
    /// Time with a load more than 5 % above its set load, s.
    pub overload_s: f64,
    /// Whether that is longer than 50 ms.
    pub overloaded: bool,
}

impl CycleOutcomeBody {
    /// One cycle's.
    pub fn new(machine: String, cycle_id: String, compared: &Comparison) -> Self {
        Self {
            machine,
            cycle_id,
            time_s: compared.time_s.into(),
            peak_feed_drive_percent: compared.peak_feed_drive_percent.into(),
            peak_spindle_percent: compared.peak_spindle_percent.into(),
            spindle_percent_s: compared.spindle_percent_s.into(),
            overload_s: compared.overload_s,
            overloaded: compared.overloaded,
        }
    }
}

/// A version's prediction against the cycles that ran it.
#[derive(Debug, Serialize, ToSchema)]
pub struct OutcomeAnswer {
    /// Name of the feed profile.
    pub profile: String,
    /// The version.
    pub version: u32,
    /// What was predicted.
    pub prediction: PredictionBody,
    /// Its last cycles, oldest first.
    pub cycles: Vec<CycleOutcomeBody>,
    /// Share of the figures that lie in their bands, which are made for 0.9; null without cycles.
    pub within_share: Option<f64>,
    /// Factor on the spread of the next prediction that these cycles ask for: the next optimisation that names this
    /// version as the last tried one uses it.
    pub spread_scale: f64,
    /// Cycles with more overload than tolerated.
    pub overloaded: usize,
    /// Cycles that ran it and are not compared.
    pub skipped: usize,
    /// Which they are, and why: `aborted`, `cut_short` (the server kept only a part), `no_samples`,
    /// `samples_dropped` (or missing), `too_short`, `too_many_samples`.
    pub skipped_cycles: Vec<SkippedBody>,
}

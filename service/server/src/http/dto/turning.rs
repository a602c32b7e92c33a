//! Rough turning in JSON.

use super::library::{RangeBody, TurningModelBody};
use super::mirror::{To, WarningBody, mirror, shown, violation};
use feedwright_core::ids::ModelId;
use feedwright_core::invalid::Violation;
use feedwright_core::turning::{
    Accumulation, Axis, Chosen, Comparison, Correction, Corrections, Cut, DomainInput, Economics,
    EdgeInterval, EdgeState, EndOfLife, Job, JobInput, Limits, Measured, Objective, Outcome, Outside, Plan,
    Readings, Totals, TurningModel, TurningSetup, Utilisation,
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

mirror! {
    /// Evenly spaced values from `min` to `max`.
    TurningAxisBody = Axis {
        /// First value.
        min: f64,
        /// Last value.
        max: f64,
        /// Distance between neighbours.
        step: f64,
    }

    /// Limits that hold at the end of every interval.
    TurningLimitsBody = Limits {
        /// Spindle power, kW.
        #[schema(example = 7.0)]
        power_kw: f64,
        /// Thrust force, N.
        #[schema(example = 1500.0)]
        force_n: f64,
        /// Average edge wear, mm.
        #[schema(example = 0.3)]
        wear_mm: f64,
    }

    /// What a tool change costs.
    EconomicsBody = Economics {
        /// Time to change the tool, min.
        tool_change_min: f64,
        /// Price of one edge, in any currency.
        #[serde(default)]
        edge_cost: f64,
        /// Price of a minute of machine and operator, same currency.
        #[serde(default)]
        machine_cost_per_min: f64,
    }

    /// Readings at the end of an interval; leave out what was not measured.
    MeasuredBody = Measured {
        /// Power, kW.
        #[serde(default)]
        power_kw: Option<f64>,
        /// Thrust force, N.
        #[serde(default)]
        force_n: Option<f64>,
        /// Average edge wear, mm.
        #[serde(default)]
        wear_mm: Option<f64>,
    }
}

shown! {
    /// Prediction at the end of an interval.
    OutcomeBody = Outcome {
        /// Wear, mm (Eq. 5).
        wear_mm: f64,
        /// Wear added in the interval, mm.
        wear_increase_mm: f64,
        /// Power, kW (Eq. 6).
        power_kw: f64,
        /// Thrust force, N (Eq. 7).
        force_n: f64,
        /// Removal rate, mm³/min (Eq. 8).
        removal_mm3_min: f64,
    }

    /// Predicted value over its limit, 0..1.
    UtilisationBody = Utilisation {
        /// Of the power limit.
        power: f64,
        /// Of the force limit.
        force: f64,
        /// Of the wear limit.
        wear: f64,
    }

    /// Which inputs lie outside the ranges that the entry was fitted in.
    OutsideBody = Outside {
        /// Cutting speed.
        speed: bool,
        /// Feed.
        feed: bool,
        /// Depth of cut.
        depth: bool,
    }

    /// Sums over a run.
    TotalsBody = Totals {
        /// Cutting time, min.
        cutting_min: f64,
        /// Metal removed, mm³.
        removed_mm3: f64,
        /// Metal removed per minute of cutting, mm³/min.
        mean_removal_mm3_min: Option<f64>,
        /// Metal removed per minute with the tool change counted, mm³/min.
        overall_removal_mm3_min: Option<f64>,
        /// Machine time with the tool change, and the edge, in the job's currency.
        cost: f64,
        /// Cost per cm³ removed.
        cost_per_cm3: Option<f64>,
        /// Wear at the end, mm.
        wear_mm: f64,
        /// Highest power, kW.
        peak_power_kw: f64,
        /// Highest force, N.
        peak_force_n: f64,
    }

    /// A plan over another run, as ratios.
    ComparisonBody = Comparison {
        /// Metal removed in one life.
        removed: Option<f64>,
        /// Metal removed per minute of cutting.
        mean_removal: Option<f64>,
        /// Metal removed per minute, tool change counted.
        overall_removal: Option<f64>,
        /// Cutting time of one life.
        cutting_time: Option<f64>,
        /// Cost per cm³.
        cost_per_cm3: Option<f64>,
    }

    /// An estimate with its 95 % interval.
    CorrectionBody = Correction {
        /// Estimate.
        value: f64,
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
    }

    /// What was learnt of an edge.
    CorrectionsBody = Corrections {
        /// Present wear, mm.
        wear_mm: CorrectionBody,
        /// Factor on the wear law's coefficient.
        wear_factor: CorrectionBody,
        /// Factor on the power law's coefficient.
        power_factor: CorrectionBody,
        /// Factor on the force law's coefficient.
        force_factor: CorrectionBody,
        /// Whether a reading of the last interval was cut to the gate.
        gated: bool,
        /// Whether a factor sits at its bound, so that the entry does not describe this edge.
        at_bound: bool,
    }

    /// What an estimate rests on.
    ReadingsBody = Readings {
        /// Intervals.
        intervals: u32,
        /// Readings of power.
        power: u32,
        /// Readings of force.
        force: u32,
        /// Readings of wear.
        wear: u32,
    }
}

/// Pairs to choose from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum DomainBody {
    /// All combinations of two axes, as in the paper.
    Grid(GridBody),
    /// Any speed and feed within two ranges.
    Continuous(ContinuousBody),
}

/// Two axes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct GridBody {
    /// Cutting speed, m/min.
    pub speed_m_min: TurningAxisBody,
    /// Feed, mm/rev.
    pub feed_mm_rev: TurningAxisBody,
}

/// Two ranges.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ContinuousBody {
    /// Cutting speed, m/min.
    pub speed_m_min: RangeBody,
    /// Feed, mm/rev.
    pub feed_mm_rev: RangeBody,
}

impl To<DomainInput> for DomainBody {
    fn to(self) -> DomainInput {
        match self {
            Self::Grid(GridBody { speed_m_min, feed_mm_rev }) => {
                DomainInput::Grid { speed_m_min: speed_m_min.to(), feed_mm_rev: feed_mm_rev.to() }
            }
            Self::Continuous(ContinuousBody { speed_m_min, feed_mm_rev }) => {
                DomainInput::Continuous { speed_m_min: speed_m_min.to(), feed_mm_rev: feed_mm_rev.to() }
            }
        }
    }
}

impl To<DomainBody> for DomainInput {
    fn to(self) -> DomainBody {
        match self {
            Self::Grid { speed_m_min, feed_mm_rev } => {
                DomainBody::Grid(GridBody { speed_m_min: speed_m_min.to(), feed_mm_rev: feed_mm_rev.to() })
            }
            Self::Continuous { speed_m_min, feed_mm_rev } => DomainBody::Continuous(ContinuousBody {
                speed_m_min: speed_m_min.to(),
                feed_mm_rev: feed_mm_rev.to(),
            }),
        }
    }
}

/// How wear of different cuts adds up on one edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum AccumulationWord {
    /// As the paper prints it (Eq. 4): an interval adds what a new edge would have worn between the same minutes.
    #[default]
    ElapsedTime,
    /// An interval goes on from the wear that there is.
    State,
}

impl To<Accumulation> for AccumulationWord {
    fn to(self) -> Accumulation {
        match self {
            Self::ElapsedTime => Accumulation::ElapsedTime,
            Self::State => Accumulation::State,
        }
    }
}

impl To<AccumulationWord> for Accumulation {
    fn to(self) -> AccumulationWord {
        match self {
            Self::ElapsedTime => AccumulationWord::ElapsedTime,
            Self::State => AccumulationWord::State,
        }
    }
}

/// The coefficients to use: a library entry by its id, or an entry in place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TurningModelChoice {
    /// Id of a library entry.
    Id(String),
    /// An entry.
    Entry(Box<TurningModelBody>),
}

/// Speed and feed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CutBody {
    /// Cutting speed, m/min.
    #[schema(example = 150.0)]
    pub speed_m_min: f64,
    /// Feed, mm/rev.
    #[schema(example = 0.58)]
    pub feed_mm_rev: f64,
}

impl CutBody {
    /// The checked pair.
    pub fn cut(self, parent: &str) -> Result<Cut, Violation> {
        Cut::new(self.speed_m_min, self.feed_mm_rev).map_err(|error| violation(parent, error))
    }
}

impl From<Cut> for CutBody {
    fn from(cut: Cut) -> Self {
        Self { speed_m_min: cut.speed_m_min(), feed_mm_rev: cut.feed_mm_rev() }
    }
}

/// State of an edge.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EdgeBody {
    /// Cutting time since it was new, min.
    pub elapsed_min: f64,
    /// Average wear, mm.
    pub wear_mm: f64,
}

impl EdgeBody {
    /// The checked state.
    pub fn state(self) -> Result<EdgeState, Violation> {
        EdgeState::new(self.elapsed_min, self.wear_mm).map_err(|error| violation("start", error))
    }
}

/// One minute, as in the paper.
const fn one() -> f64 {
    1.0
}

/// Two standard deviations: the limits are kept in about 97 of 100 cases.
const fn two() -> f64 {
    2.0
}

/// What is turned, and with which limits.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TurningJobBody {
    /// The coefficients.
    pub model: TurningModelChoice,
    /// Depth of cut, mm.
    pub depth_mm: f64,
    /// Length of an interval, min.
    #[serde(default = "one")]
    pub interval_min: f64,
    /// Limits.
    pub limits: TurningLimitsBody,
    /// Pairs to choose from; left out: any within the ranges that the entry was fitted in.
    #[serde(default)]
    pub domain: Option<DomainBody>,
    /// How wear adds up.
    #[serde(default)]
    pub accumulation: AccumulationWord,
    /// What a tool change costs; left out: nothing.
    #[serde(default)]
    pub economics: Option<EconomicsBody>,
}

impl TurningJobBody {
    /// The checked job with the coefficients that it names.
    pub fn job(self, model: TurningModel) -> Result<Job, Violation> {
        let ranges = model.data().ranges;
        let fitted =
            DomainInput::Continuous { speed_m_min: ranges.speed_m_min, feed_mm_rev: ranges.feed_mm_rev };
        let free = Economics { tool_change_min: 0.0, edge_cost: 0.0, machine_cost_per_min: 0.0 };
        Job::new(JobInput {
            model,
            depth_mm: self.depth_mm,
            interval_min: self.interval_min,
            limits: self.limits.to(),
            domain: self.domain.map_or(fitted, To::to),
            accumulation: self.accumulation.to(),
            economics: self.economics.map_or(free, To::to),
        })
        .map_err(|error| violation("job", error))
    }
}

/// What a whole-life plan is best at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ObjectiveWord {
    /// Most metal in the cutting time of the greedy plan.
    RemovalInGreedyTime,
    /// Most metal per minute, tool change counted.
    OverallRemoval,
    /// Least cost per volume.
    Cost,
}

impl From<ObjectiveWord> for Objective {
    fn from(word: ObjectiveWord) -> Self {
        match word {
            ObjectiveWord::RemovalInGreedyTime => Self::RemovalInGreedyTime,
            ObjectiveWord::OverallRemoval => Self::OverallRemoval,
            ObjectiveWord::Cost => Self::Cost,
        }
    }
}

/// A question for a plan. The example is the paper's job.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "job": {"model": {"id": "alaskari-oraby-2017"}, "depth_mm": 2.5,
            "limits": {"power_kw": 7.0, "force_n": 1500.0, "wear_mm": 0.3},
            "domain": {"grid": {"speed_m_min": {"min": 50, "max": 200, "step": 10},
                                "feed_mm_rev": {"min": 0.06, "max": 0.6, "step": 0.005}}},
            "economics": {"tool_change_min": 1.0, "machine_cost_per_min": 1.0}},
    "whole_life": "overall_removal"
}))]
pub struct TurningPlanQuestion {
    /// What is turned.
    pub job: TurningJobBody,
    /// State of the edge at the start; left out: new.
    #[serde(default)]
    pub start: EdgeBody,
    /// The fixed pair to compare with; left out: the best one there is.
    #[serde(default)]
    pub fixed: Option<CutBody>,
    /// Also plan over the whole life, for this.
    #[serde(default)]
    pub whole_life: Option<ObjectiveWord>,
}

/// An interval of a plan.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct TurningIntervalBody {
    /// Start, min since the edge was new.
    pub start_min: f64,
    /// End, min since the edge was new.
    pub end_min: f64,
    /// Cutting speed, m/min.
    pub speed_m_min: f64,
    /// Feed, mm/rev.
    pub feed_mm_rev: f64,
    /// Prediction at its end.
    #[serde(flatten)]
    pub outcome: OutcomeBody,
    /// `power`, `force`, `wear`, `range`, `life` (a faster pair is left for later) or `given`.
    #[schema(example = "power")]
    pub binding: &'static str,
    /// How far each limit is used.
    pub utilisation: UtilisationBody,
    /// Whether it extrapolates the entry.
    pub outside: OutsideBody,
}

impl From<Chosen> for TurningIntervalBody {
    fn from(chosen: Chosen) -> Self {
        Self {
            start_min: chosen.start_min,
            end_min: chosen.end_min,
            speed_m_min: chosen.cut.speed_m_min(),
            feed_mm_rev: chosen.cut.feed_mm_rev(),
            outcome: chosen.outcome.to(),
            binding: chosen.binding.as_str(),
            utilisation: chosen.utilisation.to(),
            outside: chosen.outside.to(),
        }
    }
}

/// Intervals from a state of the edge to its end.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PlanBody {
    /// In order of time.
    pub intervals: Vec<TurningIntervalBody>,
    /// Sums over them.
    pub totals: TotalsBody,
    /// `power`, `force` or `wear`: that limit leaves no pair; `exchange`: a new edge pays more; `horizon`.
    #[schema(example = "wear")]
    pub ended_by: &'static str,
}

impl From<Plan> for PlanBody {
    fn from(plan: Plan) -> Self {
        Self {
            intervals: plan.intervals.into_iter().map(Into::into).collect(),
            totals: plan.totals.to(),
            ended_by: match plan.end {
                EndOfLife::Limit(limit) => limit.as_str(),
                EndOfLife::Exchange => "exchange",
                EndOfLife::Horizon => "horizon",
            },
        }
    }
}

/// A plan over the whole life.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct WholeLifeBody {
    /// The plan; the greedy one itself where nothing better was found.
    pub plan: PlanBody,
    /// Relative gain in the objective over the greedy plan, with the job's own accumulation of wear.
    pub gain: f64,
    /// The same gain when wear goes on from its state. What is left here can be counted on; zero or less can not.
    pub gain_by_state: f64,
}

/// A plan, and what it is worth.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct TurningPlanAnswer {
    /// The paper's strategy: each interval takes the pair of largest removal rate.
    pub plan: PlanBody,
    /// The run at fixed parameters; absent where no fixed pair survives an interval.
    pub fixed: Option<PlanBody>,
    /// The plan over that run.
    pub comparison: Option<ComparisonBody>,
    /// The plan over the whole life, where asked for.
    pub whole_life: Option<WholeLifeBody>,
    /// What to know before using it.
    pub warnings: Vec<WarningBody>,
}

/// What to know of a plan that leaves the entry's ranges.
pub fn outside_warning(outside: Outside) -> Option<WarningBody> {
    let named = [("speed", outside.speed), ("feed", outside.feed), ("depth of cut", outside.depth)];
    let names: Vec<&str> = named.iter().filter(|(_, out)| *out).map(|(name, _)| *name).collect();
    (!names.is_empty()).then(|| {
        let message =
            format!("{} outside the ranges that the entry was fitted in: extrapolated", names.join(", "));
        WarningBody::new("outside_fitted_ranges", message)
    })
}

/// What was cut so far.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CutIntervalBody {
    /// Cutting speed, m/min.
    pub speed_m_min: f64,
    /// Feed, mm/rev.
    pub feed_mm_rev: f64,
    /// How long, min.
    pub minutes: f64,
    /// Depth of cut, mm; left out: the job's.
    #[serde(default)]
    pub depth_mm: Option<f64>,
    /// Readings at its end.
    #[serde(default)]
    pub measured: Option<MeasuredBody>,
}

impl CutIntervalBody {
    /// The interval at that place of the list.
    pub fn interval(self, index: usize, depth_mm: f64) -> Result<EdgeInterval, Violation> {
        let cut = CutBody { speed_m_min: self.speed_m_min, feed_mm_rev: self.feed_mm_rev };
        Ok(EdgeInterval {
            depth_mm: self.depth_mm.unwrap_or(depth_mm),
            cut: cut.cut(&format!("intervals[{index}]"))?,
            minutes: self.minutes,
            measured: self.measured.map(To::to).unwrap_or_default(),
            mean_power_kw: None,
        })
    }
}

/// A question for the next pair of a running edge.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "job": {"model": {"id": "alaskari-oraby-2017"}, "depth_mm": 2.5,
            "limits": {"power_kw": 7.0, "force_n": 1500.0, "wear_mm": 0.3}},
    "intervals": [{"speed_m_min": 150, "feed_mm_rev": 0.58, "minutes": 1.0, "measured": {"power_kw": 7.2}}],
    "caution_sigmas": 1.0
}))]
pub struct TurningNextQuestion {
    /// What is turned.
    pub job: TurningJobBody,
    /// State of the edge before the first interval; left out: new.
    #[serde(default)]
    pub start: EdgeBody,
    /// What it has cut, in order.
    #[serde(default)]
    pub intervals: Vec<CutIntervalBody>,
    /// Standard deviations that every coefficient is raised by before choosing, 0 to 5.
    #[serde(default = "two")]
    pub caution_sigmas: f64,
}

/// The next pair of a running edge.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct TurningNextAnswer {
    /// Cutting time since the edge was new, min.
    pub elapsed_min: f64,
    /// What was learnt.
    pub corrections: CorrectionsBody,
    /// What that rests on.
    pub readings: ReadingsBody,
    /// The next interval; absent where the edge is spent.
    pub next: Option<TurningIntervalBody>,
    /// The limit that leaves no pair.
    pub ended_by: Option<&'static str>,
    /// What to know before using it.
    pub warnings: Vec<WarningBody>,
}

/// How an operation is turned: what makes its cycles feed the choice of the next speed and feed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "model": "alaskari-oraby-2017", "depth_mm": 2.5, "diameter_mm": 80.0,
    "limits": {"power_kw": 7.0, "force_n": 1500.0, "wear_mm": 0.3},
    "domain": {"grid": {"speed_m_min": {"min": 50, "max": 200, "step": 10},
                        "feed_mm_rev": {"min": 0.06, "max": 0.6, "step": 0.005}}}
}))]
pub struct TurningSetupBody {
    /// Id of the library entry.
    pub model: String,
    /// Depth of cut, mm.
    pub depth_mm: f64,
    /// Diameter that is turned, mm; without it spindle speeds and feed rates are not told.
    #[serde(default)]
    pub diameter_mm: Option<f64>,
    /// Length of the interval that the next pair is chosen for, min.
    #[serde(default = "one")]
    pub interval_min: f64,
    /// Limits.
    pub limits: TurningLimitsBody,
    /// Pairs to choose from.
    pub domain: DomainBody,
    /// How wear adds up.
    #[serde(default)]
    pub accumulation: AccumulationWord,
    /// Standard deviations that every coefficient is raised by before choosing, 0 to 5.
    #[serde(default = "two")]
    pub caution_sigmas: f64,
}

impl TurningSetupBody {
    /// The setup; its numbers are checked with the operation.
    pub fn setup(self) -> Result<TurningSetup, Violation> {
        Ok(TurningSetup {
            model: ModelId::parse("turning.model", &self.model)?,
            depth_mm: self.depth_mm,
            diameter_mm: self.diameter_mm,
            interval_min: self.interval_min,
            limits: self.limits.to(),
            domain: self.domain.to(),
            accumulation: self.accumulation.to(),
            caution_sigmas: self.caution_sigmas,
        })
    }
}

impl From<TurningSetup> for TurningSetupBody {
    fn from(setup: TurningSetup) -> Self {
        Self {
            model: setup.model.as_str().to_owned(),
            depth_mm: setup.depth_mm,
            diameter_mm: setup.diameter_mm,
            interval_min: setup.interval_min,
            limits: setup.limits.to(),
            domain: setup.domain.to(),
            accumulation: setup.accumulation.to(),
            caution_sigmas: setup.caution_sigmas,
        }
    }
}

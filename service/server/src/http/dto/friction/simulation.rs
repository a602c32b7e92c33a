//! A simulation: asked for and answered.

use super::control::{LoadLimitsBody, StrategyBody};
use super::model::ModelBody;
use feedwright_core::friction::compare::{Outcome, Radar, stage_depths};
use feedwright_core::friction::twin::{CycleSample, Peak};
use feedwright_core::invalid::Violation;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What is to be simulated. Everything may be left out: `{}` is the paper's F_AC with a new tool, without noise,
/// beside the paper's four strategies.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
#[schema(example = json!({
    "model": {"tool": {"cycles": 5000}, "operation": {"sheet": {"thickness_mm": 2.0}}},
    "strategy": {"base": "f_ac", "law": {"set_feed_drive_percent": 40, "set_spindle_percent": 50}},
    "limits": {"spindle_percent": 60}, "samples": false
}))]
pub struct SimulationRequest {
    /// Machine, tool, operation and noise over the paper's values.
    pub model: ModelBody,
    /// The strategy whose cycle is answered in full; F_AC where it is left out.
    pub strategy: StrategyBody,
    /// The strategies beside it, at most 8; the paper's four where it is left out.
    pub compare: Option<Vec<StrategyBody>>,
    /// What counts as an overload.
    pub limits: LoadLimitsBody,
    /// Seed of the noise, the same for every strategy; without it there is no noise.
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_u64)]
    pub seed: Option<u64>,
    /// Whether every sample is answered.
    pub samples: bool,
}

/// Largest seed: beyond 2^53 − 1 many clients' JSON knows no integers but every second or fourth, so that two seeds were one.
const MOST_SEED: u64 = 9_007_199_254_740_991;

impl SimulationRequest {
    /// The seed.
    pub fn seed(&self) -> Result<Option<u64>, Violation> {
        match self.seed {
            Some(seed) if seed > MOST_SEED => {
                let message = format!("must be within 0 to {MOST_SEED}, is {seed}");
                Err(Violation::new("seed", "out_of_range", message))
            }
            seed => Ok(seed),
        }
    }
}

/// A simulated cycle beside other strategies.
#[derive(Debug, Serialize, ToSchema)]
pub struct SimulationAnswer {
    /// The cycle that was asked for.
    pub cycle: StrategyOutcome,
    /// Every sample of it, where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples: Option<SimulatedSamples>,
    /// The table and the radar of the paper's Fig. 21: the strategies of `compare`.
    pub comparison: Vec<ComparedStrategy>,
    /// Every value of the model in force, those that were left out included.
    pub model: ModelBody,
    /// The strategy of `cycle`, every value in force.
    pub strategy: StrategyBody,
    /// Where the values come from that were left out.
    pub defaults: &'static str,
}

/// Where values come from.
pub const DEFAULTS: &str = "What was left out is the paper's (Stryczek & Błaszczak 2020) where it is printed there, and \
    else was fitted to its figures or chosen: see docs/friction.md.";

/// A largest value and the depth it was at.
#[derive(Debug, Serialize, ToSchema)]
pub struct DepthPeak {
    /// The value.
    pub value: f64,
    /// Tip depth, mm.
    pub depth_mm: f64,
}

impl From<Peak> for DepthPeak {
    fn from(peak: Peak) -> Self {
        Self { value: peak.value, depth_mm: peak.depth_mm }
    }
}

/// One strategy's figures, from first contact on.
#[derive(Debug, Serialize, ToSchema)]
pub struct StrategyOutcome {
    /// Name of the strategy.
    #[schema(example = "F_AC")]
    pub name: String,
    /// Time from contact to the end of the path, s.
    pub duration_s: f64,
    /// Energy on the basis `dynamometer` (Eq. 5–7), J.
    pub energy_j: f64,
    /// The thrust's part of it, J.
    pub thrust_energy_j: f64,
    /// Basis of the energies.
    #[schema(example = "dynamometer")]
    pub energy_basis: &'static str,
    /// Largest thrust, N.
    pub thrust_n: DepthPeak,
    /// Largest torque, N·m.
    pub torque_nm: DepthPeak,
    /// Largest mechanical power, W.
    pub power_w: DepthPeak,
    /// Largest feed-drive load, %.
    pub feed_drive_percent: DepthPeak,
    /// Largest spindle load, %.
    pub spindle_percent: DepthPeak,
    /// Time with a load over its limit, s.
    pub overload_s: f64,
    /// Where the stages begin and end.
    pub stages: StagesBody,
}

/// Stages found from the drive loads alone, as depths, mm; null where the hole did not show it.
#[derive(Debug, Serialize, ToSchema)]
pub struct StagesBody {
    /// First contact: start of A.
    pub contact_mm: Option<f64>,
    /// Largest thrust: end of A.
    pub thrust_maximum_mm: Option<f64>,
    /// Where the thrust has fallen off.
    pub breakthrough_mm: Option<f64>,
    /// Largest torque: end of B.
    pub torque_maximum_mm: Option<f64>,
    /// Where the torque has fallen to half.
    pub falling_edge_mm: Option<f64>,
    /// Start of the flange: end of C, start of D.
    pub flange_mm: Option<f64>,
}

/// One strategy among others.
#[derive(Debug, Serialize, ToSchema)]
pub struct ComparedStrategy {
    /// Its figures.
    #[serde(flatten)]
    pub outcome: StrategyOutcome,
    /// Each axis of the paper's Fig. 21 as a share of the largest among the strategies compared.
    pub radar: RadarBody,
}

/// Shares of the largest value, 0 to 1; 1 is the worst.
#[derive(Debug, Serialize, ToSchema)]
pub struct RadarBody {
    /// Cycle time.
    pub duration: f64,
    /// Energy.
    pub energy: f64,
    /// Largest thrust.
    pub thrust: f64,
    /// Largest torque.
    pub torque: f64,
    /// Largest power.
    pub power: f64,
}

impl From<&Outcome> for StrategyOutcome {
    fn from(outcome: &Outcome) -> Self {
        let figures = &outcome.figures;
        let [contact_mm, thrust_maximum_mm, breakthrough_mm, torque_maximum_mm, falling_edge_mm, flange_mm] =
            stage_depths(&outcome.stages);
        Self {
            name: outcome.name.clone(),
            duration_s: figures.duration_s,
            energy_j: figures.energy_j,
            thrust_energy_j: figures.thrust_energy_j,
            energy_basis: "dynamometer",
            thrust_n: figures.thrust_n.into(),
            torque_nm: figures.torque_nm.into(),
            power_w: figures.power_w.into(),
            feed_drive_percent: figures.feed_drive_percent.into(),
            spindle_percent: figures.spindle_percent.into(),
            overload_s: outcome.overload_s,
            stages: StagesBody {
                contact_mm,
                thrust_maximum_mm,
                breakthrough_mm,
                torque_maximum_mm,
                falling_edge_mm,
                flange_mm,
            },
        }
    }
}

impl ComparedStrategy {
    /// An outcome with its shares.
    pub fn new(outcome: &Outcome, radar: Radar) -> Self {
        let Radar { duration, energy, thrust, torque, power } = radar;
        Self { outcome: outcome.into(), radar: RadarBody { duration, energy, thrust, torque, power } }
    }
}

/// Samples of a simulated cycle as columns; named as the columns of a posted cycle where there is one.
#[derive(Debug, Default, Serialize, ToSchema)]
pub struct SimulatedSamples {
    /// Distance of two samples, ms.
    pub period_ms: f64,
    /// Tip depth, mm; negative before contact.
    pub depth_mm: Vec<f64>,
    /// Actual feed, mm/min.
    pub feed_actual_mm_min: Vec<f64>,
    /// Override in force, %.
    pub override_percent: Vec<f64>,
    /// Spindle speed, rpm.
    pub spindle_speed_rpm: Vec<f64>,
    /// Feed-drive load, %.
    pub feed_drive_load_percent: Vec<f64>,
    /// Spindle load, %.
    pub spindle_load_percent: Vec<f64>,
    /// Thrust, N.
    pub thrust_newtons: Vec<f64>,
    /// Torque, N·m.
    pub torque_newton_metres: Vec<f64>,
    /// Mechanical power of torque and thrust, W.
    pub power_w: Vec<f64>,
    /// Rise of the heated zone's temperature, K.
    pub temperature_rise_k: Vec<f64>,
}

impl SimulatedSamples {
    /// Adds a sample.
    pub fn push(&mut self, sample: &CycleSample) {
        self.depth_mm.push(sample.depth_mm);
        self.feed_actual_mm_min.push(sample.feed_mm_min);
        self.override_percent.push(sample.override_percent);
        self.spindle_speed_rpm.push(sample.spindle_rpm);
        self.feed_drive_load_percent.push(sample.process.feed_drive_percent);
        self.spindle_load_percent.push(sample.process.spindle_percent);
        self.thrust_newtons.push(sample.process.thrust_n);
        self.torque_newton_metres.push(sample.process.torque_nm);
        self.power_w.push(sample.process.power_w);
        self.temperature_rise_k.push(sample.process.temperature_rise_k);
    }
}

//! Vibratory drilling by peak-to-peak control, in JSON (Ivanov et al. 2024).

use super::mirror::{To, WarningBody, mirror, shown, violation};
use feedwright_core::field_error::FieldError;
use feedwright_core::invalid::Violation;
use feedwright_core::vibratory::loop_model::{
    ChiselEdge, CuttingForce, LoopInput, LoopRun, LoopSteady, PoincareColumn,
};
use feedwright_core::vibratory::peak_to_peak::{ControllerInput, ControllerSettings};
use feedwright_core::vibratory::recorded::{BlockAnalysis, Signal, Vibration};
use feedwright_core::vibratory::tuning::TuningInput;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

mirror! {
    /// Settings of the controller (Eq. 1–7).
    ControllerBody = ControllerInput {
        /// f0 of the head, Hz.
        eigenfrequency_hz: f64,
        /// Δt, s.
        period_s: f64,
        /// A0, peak-to-peak, mm.
        target_mm: f64,
        /// c1.
        deviation_gain: f64,
        /// c2.
        rate_gain: f64,
        /// Tb, s.
        time_constant_s: f64,
        /// g1.
        low_share: f64,
        /// g2.
        high_share: f64,
        /// Low-pass filter of the displacement, Hz; null leaves it unfiltered.
        #[serde(default)]
        displacement_filter_hz: Option<f64>,
        /// Share by which each crossing moves the frequency estimate.
        frequency_share: f64,
    }

    /// A machine to tune for. The example is the paper's.
    #[schema(example = json!({"eigenfrequency_hz": 70.86, "edges": 2, "feed_mm_edge": 0.02,
        "speeds_rpm": [2000, 2500, 3000, 3500, 4000, 4500, 5000], "actuator_limit_n": 100, "computation_s": 3e-4}))]
    TuningQuestion = TuningInput {
        /// f0, Hz.
        eigenfrequency_hz: f64,
        /// Cutting edges z.
        #[schema(minimum = 1, maximum = 100)]
        edges: u32,
        /// Feed per edge, mm.
        feed_mm_edge: f64,
        /// Spindle speeds that will be used, 1/min.
        speeds_rpm: Vec<f64>,
        /// Largest actuator force, N.
        actuator_limit_n: f64,
        /// Time the board needs per step, s.
        computation_s: f64,
    }
}

shown! {
    /// Steady values of a run.
    LoopSteadyBody = LoopSteady {
        /// Peak-to-peak displacement over the steady time, mm.
        displacement_mm: f64,
        /// Mean of the single vibrations' peak-to-peak displacement, mm; less where the vibration beats.
        mean_displacement_mm: f64,
        /// Largest actuator force, N.
        actuator_n: f64,
        /// Share of samples with the actuator at its limit.
        saturated: f64,
        /// Largest cutting force, N.
        cutting_n: f64,
        /// ψ, share of time in cut.
        continuity: f64,
        /// Mean vibration frequency, Hz.
        frequency_hz: Option<f64>,
        /// Local maxima of the displacement, mm: a column of a Poincaré map.
        peaks_mm: Vec<f64>,
        /// Local maxima of the actuator force, N.
        actuator_peaks_n: Vec<f64>,
    }

    /// One spindle speed of a Poincaré map.
    PoincareColumnBody = PoincareColumn {
        /// Spindle speed, 1/min.
        spindle_rpm: f64,
        /// Without control.
        free: LoopSteadyBody,
        /// With control.
        controlled: LoopSteadyBody,
    }

    /// The vibration in a block.
    VibrationBody = Vibration {
        /// Dominant frequency, Hz.
        frequency_hz: f64,
        /// Peak-to-peak displacement of the dominant sine, mm.
        displacement_mm: f64,
        /// Share of the signal's variance that this sine explains, 0..1.
        sine_share: f64,
    }

    /// What a block tells.
    BlockAnswer = BlockAnalysis {
        /// Absent when the signal does not move within the band.
        vibration: Option<VibrationBody>,
        /// Largest minus smallest displacement, mm; only of recorded displacement.
        range_mm: Option<f64>,
        /// ψ, share of samples in cut; only where force is known.
        continuity: Option<f64>,
        /// Largest force, N; only where force is known.
        peak_force_n: Option<f64>,
    }
}

/// Advised settings.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct TuningAnswer {
    /// Controller settings.
    pub settings: ControllerBody,
    /// G, feedback at gain 1, N·s/m.
    pub actuator_gain_n_s_m: f64,
    /// Amplitude that just segments at each speed, mm; null where the vibration would repeat from edge to edge.
    pub needed_mm: Vec<Option<f64>>,
    /// What to know before using it.
    pub warnings: Vec<WarningBody>,
}

/// The drilled hole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum HoleWord {
    /// A pilot hole keeps the chisel edge out of the cut (Table 3).
    #[default]
    Pilot,
    /// A full hole: the chisel edge damps. A fit in a very narrow window of the experiments, not a law.
    Full,
}

/// A cutting force Fc = contact·(offset + slope·h), and what the chisel edge adds.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ForceBody {
    /// Force at vanishing chip thickness, N.
    pub offset_n: f64,
    /// Force per chip thickness, N/mm.
    pub slope_n_mm: f64,
    /// Chisel edge; left out when a pilot hole keeps it out of the cut.
    #[serde(default)]
    pub chisel: Option<ChiselBody>,
}

/// Chisel edge: contact·max(0, slope·h − damping·x').
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ChiselBody {
    /// Kch, N/mm.
    pub slope_n_mm: f64,
    /// cch, N·s/m.
    pub damping_n_s_m: f64,
}

macro_rules! papers {
    ($($name:ident: $type:ty = $value:expr;)*) => { $(const fn $name() -> $type { $value })* };
}

papers! {
    stiffness: f64 = 2050.0;
    eigenfrequency: f64 = 70.86;
    damping: f64 = 0.01;
    edges: u32 = 2;
    feed: f64 = 0.02;
    gain: f64 = 4000.0;
    limit: f64 = 100.0;
    duration: f64 = 4.0;
    steady: f64 = 1.0;
}

/// The process that closes the loop. Left out, a field is as in the paper's setup (Table 1).
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LoopProcessBody {
    /// Stiffness of the elastic element, N/mm.
    #[serde(default = "stiffness")]
    pub stiffness_n_mm: f64,
    /// f0, Hz.
    #[serde(default = "eigenfrequency")]
    pub eigenfrequency_hz: f64,
    /// ζ.
    #[serde(default = "damping")]
    pub damping: f64,
    /// Cutting edges z.
    #[serde(default = "edges")]
    #[schema(minimum = 1, maximum = 100)]
    pub edges: u32,
    /// Feed per edge, mm.
    #[serde(default = "feed")]
    pub feed_mm_edge: f64,
    /// The paper's hole; ignored where `force` is given.
    #[serde(default)]
    pub hole: HoleWord,
    /// Cutting force.
    #[serde(default)]
    pub force: Option<ForceBody>,
    /// G, feedback at gain 1, N·s/m.
    #[serde(default = "gain")]
    pub actuator_gain_n_s_m: f64,
    /// Largest actuator force, N.
    #[serde(default = "limit")]
    pub actuator_limit_n: f64,
    /// Simulated time, s.
    #[serde(default = "duration")]
    pub duration_s: f64,
    /// Time at the end that the steady values are taken from, s.
    #[serde(default = "steady")]
    pub steady_s: f64,
}

impl Default for LoopProcessBody {
    fn default() -> Self {
        Self {
            stiffness_n_mm: stiffness(),
            eigenfrequency_hz: eigenfrequency(),
            damping: damping(),
            edges: edges(),
            feed_mm_edge: feed(),
            hole: HoleWord::Pilot,
            force: None,
            actuator_gain_n_s_m: gain(),
            actuator_limit_n: limit(),
            duration_s: duration(),
            steady_s: steady(),
        }
    }
}

impl LoopProcessBody {
    fn cutting(&self) -> CuttingForce {
        match (self.force, self.hole) {
            (Some(force), _) => CuttingForce {
                offset_n: force.offset_n,
                slope_n_mm: force.slope_n_mm,
                chisel: force.chisel.map(|chisel| ChiselEdge {
                    slope_n_mm: chisel.slope_n_mm,
                    damping_n_s_m: chisel.damping_n_s_m,
                }),
            },
            (None, HoleWord::Pilot) => CuttingForce::PILOT_HOLE,
            (None, HoleWord::Full) => CuttingForce::FULL_HOLE,
        }
    }

    /// What to know of a process with a chisel edge.
    pub fn warnings(&self) -> Vec<WarningBody> {
        let message =
            "the chisel edge is a fit in a very narrow window of the paper's experiments, not a law";
        let chisel = self.cutting().chisel.map(|_| WarningBody::new("chisel_edge_is_a_fit", message));
        chisel.into_iter().collect()
    }

    /// The checked run at a spindle speed.
    pub fn run(&self, spindle_rpm: f64) -> Result<LoopRun, Violation> {
        LoopRun::new(LoopInput {
            stiffness_n_mm: self.stiffness_n_mm,
            eigenfrequency_hz: self.eigenfrequency_hz,
            damping: self.damping,
            edges: self.edges,
            spindle_rpm,
            feed_mm_edge: self.feed_mm_edge,
            force: self.cutting(),
            actuator_gain_n_s_m: self.actuator_gain_n_s_m,
            actuator_limit_n: self.actuator_limit_n,
            duration_s: self.duration_s,
            steady_s: self.steady_s,
        })
        .map_err(of_process)
    }
}

/// A refused field of a run: all but the spindle speed stand in `process`.
pub fn of_process(error: FieldError) -> Violation {
    violation(if error.field() == "spindle_rpm" { "" } else { "process" }, error)
}

/// Checked controller settings; left out: the paper's.
pub fn controller(body: Option<ControllerBody>) -> Result<ControllerSettings, Violation> {
    let input = body.map_or(ControllerInput::IVANOV_2024, To::to);
    ControllerSettings::new(input).map_err(|error| violation("controller", error))
}

/// A closed loop to run over spindle speeds. The example is Table 6 and the columns of Fig. 11.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"speeds_rpm": [2000, 2500, 3000, 3500, 4000, 4500, 5000]}))]
pub struct PoincareQuestion {
    /// Spindle speeds, 1/min, at most 1000.
    pub speeds_rpm: Vec<f64>,
    /// The process.
    #[serde(default)]
    pub process: LoopProcessBody,
    /// The controller; left out: the paper's.
    #[serde(default)]
    pub controller: Option<ControllerBody>,
}

/// Poincaré data by spindle speed.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PoincareAnswer {
    /// A column for every speed, in the order given.
    pub columns: Vec<PoincareColumnBody>,
    /// What to know before using it.
    pub warnings: Vec<WarningBody>,
}

/// A closed loop to run at one spindle speed.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"spindle_rpm": 3000}))]
pub struct LoopQuestion {
    /// Spindle speed, 1/min.
    pub spindle_rpm: f64,
    /// The process.
    #[serde(default)]
    pub process: LoopProcessBody,
    /// The controller; left out: the paper's.
    #[serde(default)]
    pub controller: Option<ControllerBody>,
}

/// The process without and with control.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LoopAnswer {
    /// Without control.
    pub free: LoopSteadyBody,
    /// With control.
    pub controlled: LoopSteadyBody,
    /// What to know before using it.
    pub warnings: Vec<WarningBody>,
}

/// What was recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SignalWord {
    /// Displacement, mm.
    Displacement,
    /// Velocity, mm/s.
    Velocity,
    /// Acceleration, mm/s².
    Acceleration,
}

impl From<SignalWord> for Signal {
    fn from(word: SignalWord) -> Self {
        match word {
            SignalWord::Displacement => Self::Displacement,
            SignalWord::Velocity => Self::Velocity,
            SignalWord::Acceleration => Self::Acceleration,
        }
    }
}

/// A recorded block of vibration.
///
/// The example is 4 periods of 0.06 mm peak to peak at 70.83 Hz, near the head's own 70.86 Hz (Ivanov et al. 2024).
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "signal": "displacement", "period_s": 0.001_764_7,
    "values": [0.0, 0.0212, 0.03, 0.0212, 0.0, -0.0212, -0.03, -0.0212, 0.0, 0.0212, 0.03, 0.0212, 0.0, -0.0212, -0.03,
               -0.0212, 0.0, 0.0212, 0.03, 0.0212, 0.0, -0.0212, -0.03, -0.0212, 0.0, 0.0212, 0.03, 0.0212, 0.0,
               -0.0212, -0.03, -0.0212]
}))]
pub struct BlockQuestion {
    /// What `values` are.
    pub signal: SignalWord,
    /// Samples, evenly spaced; 32 to 1 048 576.
    pub values: Vec<f64>,
    /// Time between samples, s.
    pub period_s: f64,
    /// Axial cutting force at the same samples, N, where it was measured.
    #[serde(default)]
    pub force_n: Option<Vec<f64>>,
    /// Force above which the drill counts as in cut, N.
    #[serde(default)]
    pub contact_force_n: f64,
    /// Lowest and highest frequency to look at, Hz; left out: all that the block resolves.
    #[serde(default)]
    pub band_hz: Option<(f64, f64)>,
}

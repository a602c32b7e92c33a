//! Vibratory drilling by cutting continuity, in JSON. Everything is dimensionless, as in Gouskov et al. 2015, but for
//! the advice, which speaks of a machine.

use super::mirror::{To, mirror, shown, violation};
use feedwright_core::invalid::Violation;
use feedwright_core::vibratory::continuity::{
    Advice, AdviceInput, AdviceQuestion, BorderPoint, ContinuityControl, HeadAdvice, Map, MapAxis, MapInput,
    MapQuestion, Process, ProcessInput, Simulated, SpeedPoint, SpeedWindow, Steady, TracePoint,
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

mirror! {
    /// Settings of the continuity control (Eq. 12 and 13).
    ContinuityControlBody = ContinuityControl {
        /// Adaptation parameter c.
        #[schema(example = 0.002)]
        adaptation: f64,
        /// Target ψ0.
        #[schema(example = 0.9)]
        target: f64,
        /// Greatest actuator displacement, feeds per edge.
        #[schema(example = 0.1)]
        actuator_limit: f64,
    }

    /// Evenly spaced values, both ends included.
    MapAxisBody = MapAxis {
        /// First value.
        min: f64,
        /// Last value.
        max: f64,
        /// How many: of a map up to 250 000 points in all, of advice up to 20 000 simulations.
        #[schema(minimum = 2, maximum = 250_000)]
        count: u32,
    }
}

shown! {
    /// A step of a run.
    TracePointBody = TracePoint {
        /// τ, periods of edge passing.
        time: f64,
        /// q, feeds per edge; positive is retraction.
        displacement: f64,
        /// Pc, spring force per feed.
        force: f64,
        /// q0, feeds per edge.
        actuator: f64,
        /// b.
        gain: f64,
    }

    /// A point of the border of linear stability.
    BorderPointBody = BorderPoint {
        /// kc: below it vibrations die away, above it they grow.
        cutting_coefficient: f64,
        /// Chatter frequency over eigenfrequency.
        chatter_ratio: f64,
        /// Whole vibrations per period of edge passing.
        lobe: u32,
    }

    /// One spindle speed.
    SpeedPointBody = SpeedPoint {
        /// Spindle speed, 1/min.
        spindle_rpm: f64,
        /// p.
        frequency_ratio: f64,
        /// kc, nominal.
        cutting_coefficient: f64,
        /// ψ with the nominal coefficient.
        continuity: f64,
        /// Peak-to-peak displacement, mm.
        amplitude_mm: f64,
        /// Largest cutting force, N.
        peak_force_n: f64,
        /// Share by which the coefficient may be lower than nominal, as far as looked at.
        bears_lower: f64,
        /// Share by which it may be higher.
        bears_higher: f64,
    }

    /// Neighbouring speeds at which chips segment within the accepted amplitude.
    SpeedWindowBody = SpeedWindow {
        /// Lowest speed, 1/min.
        from_rpm: f64,
        /// Highest speed, 1/min.
        to_rpm: f64,
        /// The speed of least amplitude among those that bear the asked scatter, or of all if none does.
        best: SpeedPointBody,
        /// Whether it bears the asked scatter.
        bears_asked: bool,
    }

    /// Windows of one stiffness.
    HeadAdviceBody = HeadAdvice {
        /// Stiffness, N/mm.
        stiffness_n_mm: f64,
        /// Eigenfrequency, Hz.
        eigenfrequency_hz: f64,
        /// Windows in order of speed; empty when no speed segments chips.
        windows: Vec<SpeedWindowBody>,
    }
}

const fn damping() -> f64 {
    0.01
}

const fn exponent() -> f64 {
    0.75
}

const fn steps() -> u32 {
    100
}

const fn periods() -> u32 {
    500
}

const fn steady() -> u32 {
    100
}

/// What every point of a simulation shares. Left out, it is as in the paper: ζ = 0.01, r = 0.75, Δτ = 0.01.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SettingsBody {
    /// ζ.
    #[serde(default = "damping")]
    pub damping: f64,
    /// r, exponent of the cutting law.
    #[serde(default = "exponent")]
    pub exponent: f64,
    /// Steps per period of edge passing, 1/Δτ.
    #[serde(default = "steps")]
    #[schema(minimum = 8, maximum = 10_000)]
    pub steps_per_period: u32,
    /// Periods simulated.
    #[serde(default = "periods")]
    #[schema(minimum = 2, maximum = 1_000_000)]
    pub periods: u32,
    /// Periods at the end that the steady values are taken from, up to all of them.
    #[serde(default = "steady")]
    #[schema(minimum = 2, maximum = 1_000_000)]
    pub steady_periods: u32,
}

impl Default for SettingsBody {
    fn default() -> Self {
        Self {
            damping: damping(),
            exponent: exponent(),
            steps_per_period: steps(),
            periods: periods(),
            steady_periods: steady(),
        }
    }
}

impl SettingsBody {
    fn input(self, p: f64, kc: f64, control: Option<ContinuityControlBody>) -> ProcessInput {
        ProcessInput {
            frequency_ratio: p,
            cutting_coefficient: kc,
            damping: self.damping,
            exponent: self.exponent,
            control: control.to(),
            steps_per_period: self.steps_per_period,
            periods: self.periods,
            steady_periods: self.steady_periods,
        }
    }
}

/// A process to simulate. The example is point A of the paper.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"frequency_ratio": 1.5, "cutting_coefficient": 0.1,
    "control": {"adaptation": 0.002, "target": 0.9, "actuator_limit": 0.1}, "trace_every": 50}))]
pub struct SimulateQuestion {
    /// p, eigenfrequency over edge-passing frequency.
    pub frequency_ratio: f64,
    /// kc.
    pub cutting_coefficient: f64,
    /// Control; left out: the free process.
    #[serde(default)]
    pub control: Option<ContinuityControlBody>,
    /// The rest.
    #[serde(default)]
    pub settings: SettingsBody,
    /// Keep every so many steps of the run; left out: none.
    #[serde(default)]
    #[schema(minimum = 1)]
    pub trace_every: Option<u32>,
}

impl SimulateQuestion {
    /// The checked process.
    pub fn process(&self) -> Result<Process, Violation> {
        let control = self.control.clone();
        Process::new(self.settings.input(self.frequency_ratio, self.cutting_coefficient, control))
            .map_err(named)
    }
}

/// Fields of the settings stand in `settings`, those of the point beside it.
fn named(error: feedwright_core::field_error::FieldError) -> Violation {
    let of_settings = ["damping", "exponent", "steps_per_period", "periods", "steady_periods"];
    violation(if of_settings.contains(&error.field()) { "settings" } else { "" }, error)
}

/// Steady values of a process; the numbers are null where it diverged.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct SteadyBody {
    /// ψ, share of time in cut.
    pub continuity: Option<f64>,
    /// A, peak-to-peak displacement, feeds per edge.
    pub amplitude: Option<f64>,
    /// Pmax, spring force per feed.
    pub peak_force: Option<f64>,
    /// Standard deviation of ψ over windows of two periods.
    pub window_sd: Option<f64>,
    /// Largest peak-to-peak displacement of the whole run, feeds per edge.
    pub largest_amplitude: Option<f64>,
    /// Feedback gain at the end.
    pub gain: Option<f64>,
    /// Mean chip thickness over the steady periods, feeds per edge: 1 where the drill removes what it advances by.
    pub removed: Option<f64>,
    /// Whether the displacement grew beyond 10⁶ feeds per edge, more than the model can mean.
    pub diverged: bool,
    /// Whether the drill removes what it advances by; else the steady values are not those of a cut.
    pub cuts: bool,
    /// Whether chips are segmented: the drill cuts, and its edges leave the work in between.
    pub segmented: bool,
    /// Whether the control makes bursts, so that means mislead.
    pub bursting: bool,
}

impl From<Simulated> for SteadyBody {
    fn from(run: Simulated) -> Self {
        let number = |value: fn(&Steady) -> f64| run.as_ref().ok().map(value);
        let holds = |value: fn(&Steady) -> bool| run.as_ref().is_ok_and(value);
        Self {
            continuity: number(|steady| steady.continuity),
            amplitude: number(|steady| steady.amplitude),
            peak_force: number(|steady| steady.peak_force),
            window_sd: number(|steady| steady.window_sd),
            largest_amplitude: number(|steady| steady.largest_amplitude),
            gain: number(|steady| steady.gain),
            removed: number(|steady| steady.removed),
            diverged: run.is_err(),
            cuts: holds(|steady| steady.cuts),
            segmented: holds(Steady::segmented),
            bursting: holds(Steady::bursting),
        }
    }
}

/// A simulated process.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct SimulateAnswer {
    /// Its steady values.
    pub steady: SteadyBody,
    /// Its course, where asked for; up to where it diverged.
    pub trace: Option<Vec<TracePointBody>>,
}

/// A map to compute. The example is the paper's Fig. 4.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"frequency_ratio": {"min": 1.0, "max": 2.0, "count": 101},
    "cutting_coefficient": {"min": 0.02, "max": 0.6, "count": 101}}))]
pub struct MapQuestionBody {
    /// Frequency ratios p.
    pub frequency_ratio: MapAxisBody,
    /// Cutting coefficients kc.
    pub cutting_coefficient: MapAxisBody,
    /// Control; left out: the free process.
    #[serde(default)]
    pub control: Option<ContinuityControlBody>,
    /// The rest.
    #[serde(default)]
    pub settings: SettingsBody,
}

impl MapQuestionBody {
    /// The checked map and how many steps it takes.
    pub fn question(self) -> Result<(MapQuestion, u64), Violation> {
        let course = u64::from(self.settings.periods) * u64::from(self.settings.steps_per_period);
        let input = MapInput {
            frequency_ratio: self.frequency_ratio.to(),
            cutting_coefficient: self.cutting_coefficient.to(),
            process: self.settings.input(1.0, 0.1, self.control),
        };
        let question = MapQuestion::new(input).map_err(|error| match error.field() {
            "process.periods" => {
                Violation::new("settings.periods", error.code(), error.problem().to_string())
            }
            _ => named(error),
        })?;
        let cost = course.saturating_mul(question.points() as u64);
        Ok((question, cost))
    }
}

/// A map: rows by kc, columns by p. Each list of values runs row by row; a number is null where the run diverged.
#[derive(Debug, Serialize, ToSchema)]
pub struct MapBody {
    /// p, the columns.
    pub frequency_ratios: Vec<f64>,
    /// kc, the rows.
    pub cutting_coefficients: Vec<f64>,
    /// ψ.
    pub continuity: Vec<Option<f64>>,
    /// A, feeds per edge.
    pub amplitude: Vec<Option<f64>>,
    /// Pmax, spring force per feed.
    pub peak_force: Vec<Option<f64>>,
    /// Whether the displacement grew beyond 10⁶ feeds per edge there, more than the model can mean.
    pub diverged: Vec<bool>,
    /// Whether the drill removes what it advances by there; else the values are not those of a cut.
    pub cuts: Vec<bool>,
    /// Whether the control makes bursts there, so that means mislead.
    pub bursting: Vec<bool>,
}

impl From<Map> for MapBody {
    fn from(map: Map) -> Self {
        let number =
            |value: fn(&Steady) -> f64| map.points.iter().map(|run| run.as_ref().ok().map(value)).collect();
        let holds =
            |value: fn(&Steady) -> bool| map.points.iter().map(|run| run.as_ref().is_ok_and(value)).collect();
        Self {
            continuity: number(|steady| steady.continuity),
            amplitude: number(|steady| steady.amplitude),
            peak_force: number(|steady| steady.peak_force),
            diverged: map.points.iter().map(Result::is_err).collect(),
            cuts: holds(|steady| steady.cuts),
            bursting: holds(Steady::bursting),
            frequency_ratios: map.ratios,
            cutting_coefficients: map.coefficients,
        }
    }
}

/// Where to compute the border of linear stability.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"frequency_ratios": [1.2, 1.5, 1.7]}))]
pub struct BorderQuestion {
    /// Frequency ratios p.
    pub frequency_ratios: Vec<f64>,
    /// ζ.
    #[serde(default = "damping")]
    pub damping: f64,
    /// r.
    #[serde(default = "exponent")]
    pub exponent: f64,
}

/// The border of linear stability.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct BorderAnswer {
    /// A point for each frequency ratio.
    pub points: Vec<BorderPointBody>,
    /// Least kc of the border over all frequency ratios, 2ζ(1 + ζ)/r.
    pub minimum: f64,
}

/// Which speeds and stiffness segment chips.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"edges": 2, "feed_mm_edge": 0.05, "cutting_coefficient": 700.0, "mass_kg": 10.0,
    "stiffnesses_n_mm": [1000.0, 2000.0], "speeds_rpm": {"min": 1000.0, "max": 3000.0, "count": 9},
    "control": {"adaptation": 0.002, "target": 0.9, "actuator_limit": 0.1},
    "most_amplitude_feeds": 5.0, "scatter": 0.3}))]
pub struct AdviceQuestionBody {
    /// Cutting edges z.
    #[schema(minimum = 1, maximum = 100)]
    pub edges: u32,
    /// Feed per edge, mm.
    pub feed_mm_edge: f64,
    /// Kc of Fc = Kc·h^r, N/mm^r (Eq. 5).
    pub cutting_coefficient: f64,
    /// r.
    #[serde(default = "exponent")]
    pub exponent: f64,
    /// ζ of the head.
    #[serde(default = "damping")]
    pub damping: f64,
    /// Moving mass of the head, kg.
    pub mass_kg: f64,
    /// Stiffnesses of the elastic element to choose from, N/mm.
    pub stiffnesses_n_mm: Vec<f64>,
    /// Spindle speeds to look at, 1/min.
    pub speeds_rpm: MapAxisBody,
    /// Control; left out: the free process.
    #[serde(default)]
    pub control: Option<ContinuityControlBody>,
    /// Largest peak-to-peak displacement accepted, feeds per edge.
    pub most_amplitude_feeds: f64,
    /// Scatter of the cutting coefficient that a window should bear, 0.3 for ±30 %.
    pub scatter: f64,
    /// Steps of the scatter on either side.
    #[serde(default = "scatter_steps")]
    #[schema(minimum = 1, maximum = 50)]
    pub scatter_steps: u32,
    /// Periods per simulation.
    #[serde(default = "periods")]
    #[schema(minimum = 2, maximum = 1_000_000)]
    pub periods: u32,
}

const fn scatter_steps() -> u32 {
    3
}

impl AdviceQuestionBody {
    /// The checked question, its heads, and how many steps it takes.
    pub fn question(self) -> Result<(AdviceQuestion, usize, u64), Violation> {
        let heads = self.stiffnesses_n_mm.len();
        let each = u64::from(self.speeds_rpm.count) * u64::from(2 * self.scatter_steps.min(1000) + 1);
        let cost = each.saturating_mul(heads as u64).saturating_mul(u64::from(self.periods) * 100);
        let question = AdviceQuestion::new(AdviceInput {
            edges: self.edges,
            feed_mm_edge: self.feed_mm_edge,
            cutting_coefficient: self.cutting_coefficient,
            exponent: self.exponent,
            damping: self.damping,
            mass_kg: self.mass_kg,
            stiffnesses_n_mm: self.stiffnesses_n_mm,
            speeds_rpm: self.speeds_rpm.to(),
            control: self.control.to(),
            most_amplitude_feeds: self.most_amplitude_feeds,
            scatter: self.scatter,
            scatter_steps: self.scatter_steps,
            periods: self.periods,
        });
        Ok((question.map_err(|error| violation("", error))?, heads, cost))
    }
}

/// Windows for every stiffness.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct AdviceAnswer {
    /// A head for every stiffness, in the order given.
    pub heads: Vec<HeadAdviceBody>,
    /// Head and window of least amplitude that bears the asked scatter, counted from 0; absent when none does.
    pub best: Option<BestWindowBody>,
}

/// Names a window.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
pub struct BestWindowBody {
    /// Place of the head.
    pub head: usize,
    /// Place of the window.
    pub window: usize,
}

impl From<Advice> for AdviceAnswer {
    fn from(advice: Advice) -> Self {
        let best = advice.best.map(|(head, window)| BestWindowBody { head, window });
        Self { heads: advice.heads.to(), best }
    }
}

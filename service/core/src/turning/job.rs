//! What is to be turned: depth, interval, limits, the pairs to choose from, and what a tool change costs.

use crate::field_error::{FieldError, within};

use super::domain::{Axis, Domain, DomainInput};
use super::{Cut, TurningModel};

/// Limits that hold at the end of every interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Spindle power, kW.
    pub power_kw: f64,
    /// Thrust force, N.
    pub force_n: f64,
    /// Average edge wear, mm.
    pub wear_mm: f64,
}

/// How wear of different cuts adds up on one edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Accumulation {
    /// Each interval adds what a new edge would have worn between the same minutes (Alaskari & Oraby 2017, Eq. 4).
    ///
    /// The fast wear of a new edge then belongs to the first minutes, whatever is cut in them.
    ElapsedTime,
    /// Each interval goes on from the time at which its own pair would have reached the present wear.
    ///
    /// AW^(1/e) then grows by (C·V^a·f^b)^(1/e) per minute, whatever was cut before; equal to Eq. 4 at a fixed pair.
    State,
}

/// What changing a tool costs; zero where it is not of interest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Economics {
    /// Time to change the tool, min.
    pub tool_change_min: f64,
    /// Price of one edge, in any currency.
    pub edge_cost: f64,
    /// Price of a minute of machine and operator, same currency.
    pub machine_cost_per_min: f64,
}

/// Unchecked job.
#[derive(Debug, Clone, PartialEq)]
pub struct JobInput {
    /// Library entry.
    pub model: TurningModel,
    /// Depth of cut, mm.
    pub depth_mm: f64,
    /// Length of an interval, min.
    pub interval_min: f64,
    /// Limits.
    pub limits: Limits,
    /// Pairs to choose from.
    pub domain: DomainInput,
    /// How wear adds up.
    pub accumulation: Accumulation,
    /// Tool change.
    pub economics: Economics,
}

impl JobInput {
    /// The paper's settings: d = 2.5 mm, 1 min, 7 kW, 1500 N, 0.3 mm, V = 50..200 by 10, f = 0.06..0.60 by 0.005.
    #[must_use]
    pub fn alaskari_oraby_2017() -> Self {
        Self {
            model: TurningModel::alaskari_oraby_2017(),
            depth_mm: 2.5,
            interval_min: 1.0,
            limits: Limits { power_kw: 7.0, force_n: 1500.0, wear_mm: 0.3 },
            domain: DomainInput::Grid {
                speed_m_min: Axis { min: 50.0, max: 200.0, step: 10.0 },
                feed_mm_rev: Axis { min: 0.06, max: 0.6, step: 0.005 },
            },
            accumulation: Accumulation::ElapsedTime,
            economics: Economics { tool_change_min: 1.0, edge_cost: 0.0, machine_cost_per_min: 1.0 },
        }
    }
}

/// Checked job with the constants of its depth.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    model: TurningModel,
    depth_mm: f64,
    interval_min: f64,
    limits: Limits,
    domain: Domain,
    accumulation: Accumulation,
    economics: Economics,
}

/// State of an edge between two intervals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeState {
    elapsed_min: f64,
    wear_mm: f64,
}

impl EdgeState {
    /// A new edge.
    pub const FRESH: Self = Self { elapsed_min: 0.0, wear_mm: 0.0 };

    /// An edge that has cut for `elapsed_min` and is worn by `wear_mm`.
    ///
    /// # Errors
    /// Either value negative, not finite or absurdly large.
    pub fn new(elapsed_min: f64, wear_mm: f64) -> Result<Self, FieldError> {
        Ok(Self {
            elapsed_min: within("elapsed_min", elapsed_min, 0.0, 1e6)?,
            wear_mm: within("wear_mm", wear_mm, 0.0, 100.0)?,
        })
    }

    /// Cutting time since the first cut, min.
    #[must_use]
    pub const fn elapsed_min(self) -> f64 {
        self.elapsed_min
    }

    /// Average wear, mm.
    #[must_use]
    pub const fn wear_mm(self) -> f64 {
        self.wear_mm
    }

    pub(crate) const fn unchecked(elapsed_min: f64, wear_mm: f64) -> Self {
        Self { elapsed_min, wear_mm }
    }
}

/// Prediction at the end of an interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// Wear AW, mm (Eq. 5).
    pub wear_mm: f64,
    /// Wear added in the interval, mm.
    pub wear_increase_mm: f64,
    /// Power P, kW (Eq. 6).
    pub power_kw: f64,
    /// Thrust force, N (Eq. 7).
    pub force_n: f64,
    /// Metal removal rate, mm³/min (Eq. 8).
    pub removal_mm3_min: f64,
}

/// Which inputs lie outside the ranges the entry was fitted in, so that the prediction extrapolates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Outside {
    /// Cutting speed.
    pub speed: bool,
    /// Feed.
    pub feed: bool,
    /// Depth of cut.
    pub depth: bool,
}

impl Outside {
    /// Whether any input lies outside.
    #[must_use]
    pub const fn any(self) -> bool {
        self.speed || self.feed || self.depth
    }

    pub(crate) const fn or(self, other: Self) -> Self {
        Self {
            speed: self.speed || other.speed,
            feed: self.feed || other.feed,
            depth: self.depth || other.depth,
        }
    }
}

impl Job {
    /// Checks a job.
    ///
    /// # Errors
    /// The first bad field; a grid of more than [`MAX_GRID_PAIRS`] pairs is `too_many`.
    pub fn new(input: JobInput) -> Result<Self, FieldError> {
        within("depth_mm", input.depth_mm, 1e-3, 100.0)?;
        within("interval_min", input.interval_min, 1e-3, 1440.0)?;
        within("limits.power_kw", input.limits.power_kw, 1e-6, 1e5)?;
        within("limits.force_n", input.limits.force_n, 1e-6, 1e8)?;
        within("limits.wear_mm", input.limits.wear_mm, 1e-6, 100.0)?;
        within("economics.tool_change_min", input.economics.tool_change_min, 0.0, 1e5)?;
        within("economics.edge_cost", input.economics.edge_cost, 0.0, 1e9)?;
        within("economics.machine_cost_per_min", input.economics.machine_cost_per_min, 0.0, 1e9)?;
        let domain = Domain::new(input.domain)?;
        let JobInput { model, depth_mm, interval_min, limits, accumulation, economics, .. } = input;
        Ok(Self { model, depth_mm, interval_min, limits, domain, accumulation, economics })
    }

    /// Library entry in use.
    #[must_use]
    pub const fn model(&self) -> &TurningModel {
        &self.model
    }

    /// Limits.
    #[must_use]
    pub const fn limits(&self) -> Limits {
        self.limits
    }

    /// Pairs to choose from.
    #[must_use]
    pub const fn domain(&self) -> &Domain {
        &self.domain
    }

    /// Tool change.
    #[must_use]
    pub const fn economics(&self) -> Economics {
        self.economics
    }

    /// Length of an interval, min.
    #[must_use]
    pub const fn interval_min(&self) -> f64 {
        self.interval_min
    }

    /// Depth of cut, mm.
    #[must_use]
    pub const fn depth_mm(&self) -> f64 {
        self.depth_mm
    }

    /// The same job at another depth of cut.
    ///
    /// # Errors
    /// A depth that is not finite or out of range.
    pub fn at_depth(&self, depth_mm: f64) -> Result<Self, FieldError> {
        Ok(Self { depth_mm: within("depth_mm", depth_mm, 1e-3, 100.0)?, ..self.clone() })
    }

    pub(crate) fn with_model(&self, model: TurningModel) -> Self {
        Self { model, ..self.clone() }
    }

    /// Depth relative to the entry's reference depth.
    pub(crate) fn depth_ratio(&self) -> f64 {
        self.depth_mm / self.model.data().reference_depth_mm
    }

    /// How wear adds up.
    #[must_use]
    pub const fn accumulation(&self) -> Accumulation {
        self.accumulation
    }

    pub(crate) fn with_accumulation(&self, accumulation: Accumulation) -> Self {
        Self { accumulation, ..self.clone() }
    }

    /// Power of the wear in which intervals simply add: 1, or 1/e where wear goes on from its state.
    pub(crate) fn measure_power(&self) -> f64 {
        match self.accumulation {
            Accumulation::ElapsedTime => 1.0,
            Accumulation::State => 1.0 / self.model.data().wear.time_exponent,
        }
    }

    /// Wear as the measure that intervals add to.
    pub(crate) fn measure(&self, wear_mm: f64) -> f64 {
        match self.accumulation {
            Accumulation::ElapsedTime => wear_mm,
            Accumulation::State => wear_mm.powf(self.measure_power()),
        }
    }

    /// Wear in mm of a measure.
    pub(crate) fn wear_of(&self, measure: f64) -> f64 {
        match self.accumulation {
            Accumulation::ElapsedTime => measure,
            Accumulation::State => measure.powf(self.model.data().wear.time_exponent),
        }
    }

    /// Growth of the measure per unit of severity in the interval that starts at `elapsed_min` (Eq. 5).
    pub(crate) fn wear_gain(&self, elapsed_min: f64) -> f64 {
        self.wear_gain_over(elapsed_min, self.interval_min)
    }

    pub(crate) fn wear_gain_over(&self, elapsed_min: f64, duration_min: f64) -> f64 {
        let law = &self.model.data().wear;
        let constant = law.coefficient * self.depth_ratio().powf(law.depth_exponent);
        match self.accumulation {
            Accumulation::ElapsedTime => {
                let powered = |minutes: f64| minutes.powf(law.time_exponent);
                constant * (powered(elapsed_min + duration_min) - powered(elapsed_min))
            }
            Accumulation::State => constant.powf(self.measure_power()) * duration_min,
        }
    }

    /// V^a·f^b of the wear law, to the power of the measure: how hard a pair is on the edge.
    pub(crate) fn severity(&self, cut: Cut) -> f64 {
        let law = &self.model.data().wear;
        let power = self.measure_power();
        cut.speed_m_min.powf(law.speed_exponent * power) * cut.feed_mm_rev.powf(law.feed_exponent * power)
    }

    /// Removal rate of a pair, mm³/min (Eq. 8).
    #[must_use]
    pub fn removal_mm3_min(&self, cut: Cut) -> f64 {
        1000.0 * cut.speed_m_min * cut.feed_mm_rev * self.depth_mm
    }

    /// Power in kW of a pair on an edge worn by `wear_mm` (Eq. 6).
    #[must_use]
    pub fn power_kw(&self, cut: Cut, wear_mm: f64) -> f64 {
        self.load(&self.model.data().power, cut, wear_mm)
    }

    /// Thrust force in N of a pair on an edge worn by `wear_mm` (Eq. 7).
    #[must_use]
    pub fn force_n(&self, cut: Cut, wear_mm: f64) -> f64 {
        self.load(&self.model.data().force, cut, wear_mm)
    }

    fn load(&self, law: &super::LoadLaw, cut: Cut, wear_mm: f64) -> f64 {
        law.coefficient
            * self.depth_ratio().powf(law.depth_exponent)
            * cut.speed_m_min.powf(law.speed_exponent)
            * cut.feed_mm_rev.powf(law.feed_exponent)
            * wear_mm.powf(law.wear_exponent)
    }

    /// Prediction for one interval cut with `cut` from `state` (Eq. 5–8).
    #[must_use]
    pub fn predict(&self, state: EdgeState, cut: Cut) -> Outcome {
        let grown = self.wear_gain(state.elapsed_min) * self.severity(cut);
        let wear_mm = self.wear_of(self.measure(state.wear_mm) + grown);
        let wear_increase_mm = wear_mm - state.wear_mm;
        Outcome {
            wear_mm,
            wear_increase_mm,
            power_kw: self.power_kw(cut, wear_mm),
            force_n: self.force_n(cut, wear_mm),
            removal_mm3_min: self.removal_mm3_min(cut),
        }
    }

    /// Which of the inputs lie outside the entry's ranges.
    #[must_use]
    pub fn outside(&self, cut: Cut) -> Outside {
        let ranges = &self.model.data().ranges;
        Outside {
            speed: !ranges.speed_m_min.contains(cut.speed_m_min),
            feed: !ranges.feed_mm_rev.contains(cut.feed_mm_rev),
            depth: !ranges.depth_mm.contains(self.depth_mm),
        }
    }
}

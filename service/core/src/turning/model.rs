//! A library entry: the coefficients of one tool–work–machine set and the ranges they hold in.

use crate::field_error::{FieldError, Problem, within};

use super::domain::{Range, paths};

/// Longest name of a tool, work material or machine in an entry.
const MAX_NAME_CHARS: usize = 128;

/// Wear law AW = C·V^a·f^b·(d/d₀)^c·t^e, mm (Alaskari & Oraby 2017, Eq. 1).
///
/// The exponent of V printed in Eq. 1 is 0.877; Eq. 5 and both tables use 0.577.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WearLaw {
    /// C at the reference depth, mm.
    pub coefficient: f64,
    /// Exponent of the cutting speed in m/min.
    pub speed_exponent: f64,
    /// Exponent of the feed in mm/rev; positive.
    pub feed_exponent: f64,
    /// Exponent of the depth over the reference depth.
    pub depth_exponent: f64,
    /// Exponent of the cutting time in min; positive.
    pub time_exponent: f64,
}

/// Power or force law Y = C·V^a·f^b·(d/d₀)^c·AW^e (Alaskari & Oraby 2017, Eq. 6 and 7).
///
/// Eq. 2 and 3 also print a factor in t that Eq. 6, Eq. 7 and the tables do not use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadLaw {
    /// C at the reference depth, kW or N.
    pub coefficient: f64,
    /// Exponent of the cutting speed in m/min; may be negative.
    pub speed_exponent: f64,
    /// Exponent of the feed in mm/rev; positive.
    pub feed_exponent: f64,
    /// Exponent of the depth over the reference depth.
    pub depth_exponent: f64,
    /// Exponent of the wear in mm; positive.
    pub wear_exponent: f64,
}

/// What an entry was fitted for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ToolWorkMachine {
    /// Insert or tool.
    pub tool: String,
    /// Work material.
    pub work: String,
    /// Machine.
    pub machine: String,
}

/// Where the fit of an entry holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelRanges {
    /// Cutting speed, m/min.
    pub speed_m_min: Range,
    /// Feed, mm/rev.
    pub feed_mm_rev: Range,
    /// Depth of cut, mm.
    pub depth_mm: Range,
}

/// Standard errors of the fits, as natural logarithms of the ratio measured to predicted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScatterInput {
    /// Of the wear law.
    pub wear_log_sd: f64,
    /// Of the power law.
    pub power_log_sd: f64,
    /// Of the force law.
    pub force_log_sd: f64,
}

/// Unchecked library entry.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelInput {
    /// What it was fitted for.
    pub set: ToolWorkMachine,
    /// Depth d₀ at which the coefficients are given, mm.
    pub reference_depth_mm: f64,
    /// Average edge wear.
    pub wear: WearLaw,
    /// Consumed power, kW.
    pub power: LoadLaw,
    /// Thrust force, N.
    pub force: LoadLaw,
    /// Where the fit holds.
    pub ranges: ModelRanges,
    /// How well it fits.
    pub scatter: ScatterInput,
}

/// Checked library entry.
#[derive(Debug, Clone, PartialEq)]
pub struct TurningModel(ModelInput);

impl TurningModel {
    /// Checks an entry.
    ///
    /// # Errors
    /// The first field that is not finite or out of range. Exponents of feed, wear and time must be positive: the
    /// searches rely on more feed meaning more wear, power and force, as every published law has it.
    pub fn new(input: ModelInput) -> Result<Self, FieldError> {
        name("set.tool", &input.set.tool)?;
        name("set.work", &input.set.work)?;
        name("set.machine", &input.set.machine)?;
        within("reference_depth_mm", input.reference_depth_mm, 1e-3, 100.0)?;
        let w = &input.wear;
        within("wear.coefficient", w.coefficient, 1e-12, 1e6)?;
        within("wear.speed_exponent", w.speed_exponent, -3.0, 3.0)?;
        within("wear.feed_exponent", w.feed_exponent, 0.01, 3.0)?;
        within("wear.depth_exponent", w.depth_exponent, -3.0, 3.0)?;
        within("wear.time_exponent", w.time_exponent, 0.05, 3.0)?;
        let p = &input.power;
        within("power.coefficient", p.coefficient, 1e-12, 1e12)?;
        within("power.speed_exponent", p.speed_exponent, -3.0, 3.0)?;
        within("power.feed_exponent", p.feed_exponent, 0.01, 3.0)?;
        within("power.depth_exponent", p.depth_exponent, -3.0, 3.0)?;
        within("power.wear_exponent", p.wear_exponent, 0.05, 5.0)?;
        let f = &input.force;
        within("force.coefficient", f.coefficient, 1e-12, 1e12)?;
        within("force.speed_exponent", f.speed_exponent, -3.0, 3.0)?;
        within("force.feed_exponent", f.feed_exponent, 0.01, 3.0)?;
        within("force.depth_exponent", f.depth_exponent, -3.0, 3.0)?;
        within("force.wear_exponent", f.wear_exponent, 0.05, 5.0)?;
        input.ranges.speed_m_min.check(paths!("ranges.speed_m_min"), 1e-3, 1e5)?;
        input.ranges.feed_mm_rev.check(paths!("ranges.feed_mm_rev"), 1e-6, 100.0)?;
        input.ranges.depth_mm.check(paths!("ranges.depth_mm"), 1e-3, 100.0)?;
        within("scatter.wear_log_sd", input.scatter.wear_log_sd, 1e-6, 2.0)?;
        within("scatter.power_log_sd", input.scatter.power_log_sd, 1e-6, 2.0)?;
        within("scatter.force_log_sd", input.scatter.force_log_sd, 1e-6, 2.0)?;
        Ok(Self(input))
    }

    /// Entry of the paper: Sandvik GC435 inserts, 709M40 (En 19) steel, Colchester Mascot lathe.
    ///
    /// Coefficients and exponents of Eq. 1, 2 and 3 (exponent of V in Eq. 1 repaired, factors in t left out). Tables 1
    /// and 2 were made with these: the constants printed in Eq. 5 to 7 for d = 2.5 mm are rounded, and miss the last
    /// three of the nine digits of Table 1.
    #[must_use]
    pub fn alaskari_oraby_2017() -> Self {
        Self(ModelInput {
            set: ToolWorkMachine {
                tool: "Sandvik GC435".into(),
                work: "709M40 (En 19) steel".into(),
                machine: "Colchester Mascot".into(),
            },
            reference_depth_mm: 1.0,
            wear: WearLaw {
                coefficient: 7.62e-3,
                speed_exponent: 0.577,
                feed_exponent: 0.168,
                depth_exponent: 0.248,
                time_exponent: 0.245,
            },
            power: LoadLaw {
                coefficient: 0.14,
                speed_exponent: 0.82,
                feed_exponent: 0.627,
                depth_exponent: 0.844,
                wear_exponent: 0.342,
            },
            force: LoadLaw {
                coefficient: 55_354.0,
                speed_exponent: -0.484,
                feed_exponent: 0.236,
                depth_exponent: 0.715,
                wear_exponent: 1.1,
            },
            ranges: ModelRanges {
                speed_m_min: Range { min: 50.0, max: 200.0 },
                feed_mm_rev: Range { min: 0.06, max: 0.6 },
                depth_mm: Range { min: 1.5, max: 3.0 },
            },
            scatter: ScatterInput { wear_log_sd: 0.1, power_log_sd: 0.062, force_log_sd: 0.12 },
        })
    }

    /// The entry's data.
    #[must_use]
    pub const fn data(&self) -> &ModelInput {
        &self.0
    }

    /// The same entry with its three coefficients multiplied; used by the adaptation, whose factors are bounded.
    pub(crate) fn scaled(&self, wear: f64, power: f64, force: f64) -> Self {
        let mut data = self.0.clone();
        data.wear.coefficient *= wear;
        data.power.coefficient *= power;
        data.force.coefficient *= force;
        Self(data)
    }
}

fn name(field: &'static str, text: &str) -> Result<(), FieldError> {
    if text.trim().is_empty() {
        return Err(FieldError::new(field, Problem::Empty));
    }
    let count = text.chars().count();
    if count > MAX_NAME_CHARS {
        return Err(FieldError::new(field, Problem::TooMany { count, max: MAX_NAME_CHARS }));
    }
    Ok(())
}

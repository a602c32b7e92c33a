//! The fastest feed a drill may meet the work with.

use crate::field_error::{FieldError, Problem, count, within};

/// Most drills of a table in one call.
pub const MAX_DRILLS: usize = 10_000;

/// Longest name of a material.
const MAX_NAME_CHARS: usize = 128;

/// Feed beyond any machine, mm/rev: keeps answers finite where a law's exponent is tiny.
const MOST_FEED_MM_REV: f64 = 1e9;

/// Young's modulus of tool steel, N/mm², that the paper's P_kp ≈ 18·10³·d⁴/l² was made with.
const TOOL_STEEL_MODULUS: f64 = 2.1e5;

/// Middle of the shear strengths the paper gives for tool steel, 620 to 660 N/mm².
const TOOL_STEEL_SHEAR: f64 = 640.0;

/// Force or torque law Y = C·d^q·S^y·K, d in mm, S in mm/rev.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DrillingLaw {
    /// C, for N (thrust) or N·mm (torque).
    pub coefficient: f64,
    /// q.
    pub diameter_exponent: f64,
    /// y; positive.
    pub feed_exponent: f64,
    /// K, correction for the conditions.
    pub correction: f64,
}

/// Unchecked library entry of a work material with a tool type.
#[derive(Debug, Clone, PartialEq)]
pub struct MaterialInput {
    /// What it stands for.
    pub name: String,
    /// Thrust P0, N.
    pub thrust: DrillingLaw,
    /// Torque M, N·mm.
    pub torque: DrillingLaw,
}

/// Checked library entry.
#[derive(Debug, Clone, PartialEq)]
pub struct Material(MaterialInput);

impl Material {
    /// Checks an entry.
    ///
    /// # Errors
    /// The first field that is empty, not finite or out of range.
    pub fn new(input: MaterialInput) -> Result<Self, FieldError> {
        if input.name.trim().is_empty() {
            return Err(FieldError::new("name", Problem::Empty));
        }
        count("name", input.name.chars().count(), 1, MAX_NAME_CHARS)?;
        within("thrust.coefficient", input.thrust.coefficient, 1e-9, 1e9)?;
        within("thrust.diameter_exponent", input.thrust.diameter_exponent, -5.0, 5.0)?;
        within("thrust.feed_exponent", input.thrust.feed_exponent, 1e-2, 5.0)?;
        within("thrust.correction", input.thrust.correction, 1e-3, 1e3)?;
        within("torque.coefficient", input.torque.coefficient, 1e-9, 1e9)?;
        within("torque.diameter_exponent", input.torque.diameter_exponent, -5.0, 5.0)?;
        within("torque.feed_exponent", input.torque.feed_exponent, 1e-2, 5.0)?;
        within("torque.correction", input.torque.correction, 1e-3, 1e3)?;
        Ok(Self(input))
    }

    /// The entry's data.
    #[must_use]
    pub const fn data(&self) -> &MaterialInput {
        &self.0
    }
}

/// Unchecked drill of a tool table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DrillInput {
    /// Diameter d, mm.
    pub diameter_mm: f64,
    /// Length l out of the holder, mm.
    pub length_mm: f64,
    /// Spindle speed, 1/min.
    pub spindle_rpm: f64,
    /// Young's modulus E, N/mm²; none for tool steel (2.1·10⁵).
    pub modulus_n_mm2: Option<f64>,
    /// Shear strength τ_p, N/mm²; none for tool steel (640).
    pub shear_strength_n_mm2: Option<f64>,
}

/// Checked drill.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drill {
    input: DrillInput,
    modulus: f64,
    shear: f64,
}

impl Drill {
    /// Checks a drill.
    ///
    /// # Errors
    /// The first field that is not finite or out of range.
    pub fn new(input: DrillInput) -> Result<Self, FieldError> {
        within("diameter_mm", input.diameter_mm, 0.01, 1000.0)?;
        within("length_mm", input.length_mm, 0.1, 10_000.0)?;
        within("spindle_rpm", input.spindle_rpm, 0.1, 1e6)?;
        let modulus = input.modulus_n_mm2.unwrap_or(TOOL_STEEL_MODULUS);
        let shear = input.shear_strength_n_mm2.unwrap_or(TOOL_STEEL_SHEAR);
        Ok(Self {
            input,
            modulus: within("modulus_n_mm2", modulus, 1.0, 1e7)?,
            shear: within("shear_strength_n_mm2", shear, 1.0, 1e5)?,
        })
    }

    /// Axial load the drill bears, N: P_kp = 2π²·E·J_min/(l²·(1 + J_min/J_max)) (Eq. 9).
    #[must_use]
    pub fn critical_thrust_n(&self) -> f64 {
        let fourth = self.input.diameter_mm.powi(4);
        let (least, greatest) = (0.0052 * fourth, 0.027 * fourth);
        let bent = self.input.length_mm.powi(2) * (1.0 + least / greatest);
        2.0 * std::f64::consts::PI.powi(2) * self.modulus * least / bent
    }

    /// Torque the drill bears, N·mm: M_kp = W·τ_p, W = 0.047·d³ (Eq. 10).
    #[must_use]
    pub fn critical_torque_n_mm(&self) -> f64 {
        0.047 * self.input.diameter_mm.powi(3) * self.shear
    }
}

/// Unchecked feed range of a machine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MachineInput {
    /// S_min, mm/min.
    pub least_feed_mm_min: f64,
    /// S_max, mm/min.
    pub greatest_feed_mm_min: f64,
}

/// Checked feed range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Machine(MachineInput);

impl Machine {
    /// Checks a feed range.
    ///
    /// # Errors
    /// A feed that is not finite or out of range, or a range that is inverted.
    pub fn new(input: MachineInput) -> Result<Self, FieldError> {
        within("least_feed_mm_min", input.least_feed_mm_min, 0.0, 1e6)?;
        within("greatest_feed_mm_min", input.greatest_feed_mm_min, 1e-6, 1e6)?;
        if input.least_feed_mm_min > input.greatest_feed_mm_min {
            return Err(FieldError::new("least_feed_mm_min", Problem::Inverted));
        }
        Ok(Self(input))
    }
}

/// Unchecked delay between contact and the reaction of the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopLatencyInput {
    /// How far the drill may bite at plunge feed, mm.
    pub allowed_bite_mm: f64,
    /// Samples the detector needs to be sure.
    pub detector_samples: u32,
    /// Time between samples, s.
    pub sample_period_s: f64,
    /// Age of an answer when the axis acts on it, s.
    pub answer_age_s: f64,
}

/// Checked delay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopLatency(LoopLatencyInput);

impl LoopLatency {
    /// Checks a delay.
    ///
    /// # Errors
    /// A field that is not finite or out of range.
    pub fn new(input: LoopLatencyInput) -> Result<Self, FieldError> {
        within("allowed_bite_mm", input.allowed_bite_mm, 1e-6, 100.0)?;
        within("detector_samples", f64::from(input.detector_samples), 1.0, 10_000.0)?;
        within("sample_period_s", input.sample_period_s, 1e-6, 10.0)?;
        within("answer_age_s", input.answer_age_s, 0.0, 60.0)?;
        Ok(Self(input))
    }

    /// Time from contact to reaction, s.
    #[must_use]
    pub fn total_s(&self) -> f64 {
        f64::from(self.0.detector_samples) * self.0.sample_period_s + self.0.answer_age_s
    }

    /// How far a feed bites before the axis reacts, mm.
    #[must_use]
    pub fn bite_mm(&self, feed_mm_min: f64) -> f64 {
        feed_mm_min / 60.0 * self.total_s()
    }

    /// Greatest feed whose bite is allowed, mm/min.
    #[must_use]
    pub fn greatest_feed_mm_min(&self) -> f64 {
        self.0.allowed_bite_mm / self.total_s() * 60.0
    }
}

/// What bounds the plunge feed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlungeLimit {
    /// The drill would buckle.
    Stability,
    /// The drill would twist off.
    Torsion,
    /// The machine has no faster feed.
    MachineMaximum,
    /// The loop would bite deeper than allowed before it knows.
    LoopLatency,
    /// What the drill bears lies below the machine's least feed: the hole cannot be made on it.
    Impossible,
    /// Only the loop's bound lies below the least feed: the hole can be made, but not with this plunge.
    LoopTooSlow,
}

impl PlungeLimit {
    /// The word used in the API and in storage.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Stability => "stability",
            Self::Torsion => "torsion",
            Self::MachineMaximum => "machine_maximum",
            Self::LoopLatency => "loop_latency",
            Self::Impossible => "impossible",
            Self::LoopTooSlow => "loop_too_slow",
        }
    }

    /// The limit of that word.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        [
            Self::Stability,
            Self::Torsion,
            Self::MachineMaximum,
            Self::LoopLatency,
            Self::Impossible,
            Self::LoopTooSlow,
        ]
        .into_iter()
        .find(|limit| limit.as_str() == text)
    }
}

/// Plunge feed of one drill.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlungeFeed {
    /// Advised plunge feed, mm/rev; none when there is none.
    pub feed_mm_rev: Option<f64>,
    /// The same in mm/min.
    pub feed_mm_min: Option<f64>,
    /// What bounds it.
    pub limit: PlungeLimit,
    /// S_bp1: feed at which the drill would buckle, mm/rev.
    pub stability_feed_mm_rev: f64,
    /// S_bp2: feed at which the drill would twist off, mm/rev.
    pub torsion_feed_mm_rev: f64,
    /// P_kp, N (Eq. 9).
    pub critical_thrust_n: f64,
    /// M_kp, N·mm (Eq. 10).
    pub critical_torque_n_mm: f64,
    /// Bite at the advised feed before the axis reacts, mm; none without a loop.
    pub bite_mm: Option<f64>,
}

fn feed_at(law: &DrillingLaw, diameter_mm: f64, bearable: f64) -> f64 {
    let unit = law.coefficient * diameter_mm.powf(law.diameter_exponent) * law.correction;
    (bearable / unit).powf(1.0 / law.feed_exponent).min(MOST_FEED_MM_REV)
}

/// Feed below which there is none, mm/min, as in what a plunge saves: a machine that declares no least feed has one.
const LEAST_FEED_MM_MIN: f64 = 1e-3;

/// Plunge feed of one drill: S_bp = min(S_bp1, S_bp2), within the machine's range and the loop's bound.
#[must_use]
pub fn plunge_feed(
    drill: &Drill,
    material: &Material,
    machine: &Machine,
    latency: Option<&LoopLatency>,
) -> PlungeFeed {
    let critical_thrust_n = drill.critical_thrust_n();
    let critical_torque_n_mm = drill.critical_torque_n_mm();
    let d = drill.input.diameter_mm;
    let stability_feed_mm_rev = feed_at(&material.0.thrust, d, critical_thrust_n);
    let torsion_feed_mm_rev = feed_at(&material.0.torque, d, critical_torque_n_mm);
    let rpm = drill.input.spindle_rpm;
    let (mut feed, mut limit) = if stability_feed_mm_rev <= torsion_feed_mm_rev {
        (stability_feed_mm_rev * rpm, PlungeLimit::Stability)
    } else {
        (torsion_feed_mm_rev * rpm, PlungeLimit::Torsion)
    };
    let least = machine.0.least_feed_mm_min.max(LEAST_FEED_MM_MIN);
    if feed < least {
        limit = PlungeLimit::Impossible;
    } else {
        if feed > machine.0.greatest_feed_mm_min {
            (feed, limit) = (machine.0.greatest_feed_mm_min, PlungeLimit::MachineMaximum);
        }
        if let Some(bound) = latency.map(LoopLatency::greatest_feed_mm_min)
            && bound < feed
        {
            feed = bound;
            limit = if bound < least { PlungeLimit::LoopTooSlow } else { PlungeLimit::LoopLatency };
        }
    }
    let advised = !matches!(limit, PlungeLimit::Impossible | PlungeLimit::LoopTooSlow);
    PlungeFeed {
        feed_mm_rev: advised.then_some(feed / rpm),
        feed_mm_min: advised.then_some(feed),
        limit,
        stability_feed_mm_rev,
        torsion_feed_mm_rev,
        critical_thrust_n,
        critical_torque_n_mm,
        bite_mm: latency.filter(|_| advised).map(|latency| latency.bite_mm(feed)),
    }
}

/// Plunge feeds of a tool table, in its order.
///
/// # Errors
/// An empty table, or more than [`MAX_DRILLS`].
pub fn plunge_feeds(
    drills: &[Drill],
    material: &Material,
    machine: &Machine,
    latency: Option<&LoopLatency>,
) -> Result<Vec<PlungeFeed>, FieldError> {
    count("drills", drills.len(), 1, MAX_DRILLS)?;
    Ok(drills.iter().map(|drill| plunge_feed(drill, material, machine, latency)).collect())
}

#[cfg(test)]
mod tests;

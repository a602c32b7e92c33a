//! The process model's values.

use super::refused;
use feedwright_core::friction::error::Invalid;
use feedwright_core::friction::twin::{
    AxisLimits, CycleSetup, MachineRatings, Material, NoiseLevels, PAPER_END_DEPTH_MM, PAPER_SPINDLE_RPM,
    Sheet, ToolGeometry, Twin, TwinParams, WearEffect, paper_params, typical_noise,
};
use feedwright_core::invalid::{Range, Violation};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Interpolator periods: beyond a second no law could follow a hole.
const PERIOD_RANGE: Range = Range::new(0.0005, 1.0, "s");

macro_rules! mirror {
    ($($(#[$doc:meta])* $body:ident of $of:ty { $($(#[$field_doc:meta])* $field:ident: $type:ty,)* })*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize, ToSchema)]
        #[serde(deny_unknown_fields, default)]
        pub struct $body {
            $($(#[$field_doc])* #[serde(skip_serializing_if = "Option::is_none")] pub $field: Option<$type>,)*
        }

        impl $body {
            /// Puts what is given over `values`.
            pub fn over(&self, values: &mut $of) {
                $(if let Some(value) = self.$field { values.$field = value; })*
            }
        }

        impl From<&$of> for $body {
            fn from(values: &$of) -> Self {
                Self { $($field: Some(values.$field),)* }
            }
        }
    )*};
}

mirror! {
    /// The tool, tip first.
    GeometryBody of ToolGeometry {
        /// Diameter of the cylinder, mm.
        diameter_mm: f64,
        /// Length of the centre, mm.
        centre_length_mm: f64,
        /// Diameter where the centre passes into the cone, mm.
        centre_diameter_mm: f64,
        /// Length of the cone, mm.
        cone_length_mm: f64,
        /// Length of the cylinder, mm.
        cylinder_length_mm: f64,
        /// Diameter of the collar, mm.
        collar_diameter_mm: f64,
        /// Length over which the cone runs out into the cylinder, mm.
        shoulder_mm: f64,
    }
    /// The sheet and what becomes of it.
    SheetBody of Sheet {
        /// Thickness before drilling, mm.
        thickness_mm: f64,
        /// Length over which the bushing's wall thins out, mm.
        bushing_decay_mm: f64,
        /// Length of the bushing, mm.
        bushing_length_mm: f64,
        /// Depth at which the sheet opens, in thicknesses.
        perforation: f64,
        /// Depth over which it opens, in thicknesses.
        perforation_width: f64,
        /// Height of the flash that the collar meets, mm.
        flash_height_mm: f64,
    }
    /// The material and its lumped heat balance.
    MaterialBody of Material {
        /// Shear stress of forming, cold, MPa.
        forming_mpa: f64,
        /// Shear stress of sliding, cold, MPa.
        friction_mpa: f64,
        /// Part of the sliding contact that remains on the cylinder.
        cylinder_contact: f64,
        /// Normal stress under the cone, cold, MPa.
        normal_mpa: f64,
        /// How many times harder the closed sheet is to indent.
        confinement: f64,
        /// Shear stress of the flash, MPa.
        flash_shear_mpa: f64,
        /// Normal stress of the flash, MPa.
        flash_normal_mpa: f64,
        /// Exponent of the feed per revolution in torque.
        torque_rate_exponent: f64,
        /// Exponent of the feed per revolution in thrust.
        thrust_rate_exponent: f64,
        /// Reference feed per revolution, mm.
        reference_feed_mm: f64,
        /// Rise of temperature that halves the strength, K.
        softening_k: f64,
        /// Heat capacity of the heated zone, J/K.
        heat_capacity_j_per_k: f64,
        /// Time constant of cooling, s.
        cooling_s: f64,
    }
    /// What one unit of wear does: 10 000 cycles of the paper's tool.
    WearEffectBody of WearEffect {
        /// Shear stress that the worn surface adds, MPa.
        drag_mpa: f64,
        /// Middle of the worn area from the end of the cone, mm.
        offset_mm: f64,
        /// Half length of the worn area, mm.
        half_length_mm: f64,
        /// Exponent of the feed in that drag.
        rate_exponent: f64,
        /// Relative rise of the thrust.
        thrust_rise: f64,
        /// Cycles per unit of wear.
        cycles_per_unit: f64,
        /// Exponent of wear over cycles.
        growth_exponent: f64,
    }
    /// The feed axis.
    AxisBody of AxisLimits {
        /// Largest acceleration, mm/s².
        acceleration_mm_s2: f64,
        /// IPO cycles between an override and its effect.
        #[schema(maximum = 16)]
        override_latency_ipo: u32,
    }
    /// What varies; standard deviations.
    NoiseBody of NoiseLevels {
        /// Reading of a drive load, points.
        load_points: f64,
        /// Reading of the thrust, N.
        thrust_n: f64,
        /// Reading of the torque, N·m.
        torque_nm: f64,
        /// Fluctuation within a cycle, relative.
        process: f64,
        /// Strength of the material from cycle to cycle, relative.
        cycle: f64,
    }
    /// What the machine's percent loads refer to.
    RatingsBody of MachineRatings {
        /// Rated power of the spindle drive, W.
        spindle_rated_power_w: f64,
        /// Speed at which rated torque gives rated power, rpm.
        spindle_rated_rpm: f64,
        /// Load of the idling spindle, %.
        spindle_idle_percent: f64,
        /// Moment of inertia of the spindle, kg·m².
        spindle_inertia_kg_m2: f64,
        /// Thrust that 100 % feed-drive load stands for, N.
        feed_rated_thrust_n: f64,
        /// Load of the idling feed drive, %.
        feed_idle_percent: f64,
        /// Mass that the feed drive accelerates, kg.
        feed_mass_kg: f64,
        /// Spindle acceleration, rpm/s.
        spindle_acceleration_rpm_s: f64,
    }
}

/// The machine.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SimulatedMachineBody {
    /// What the percent loads refer to.
    pub ratings: RatingsBody,
    /// The feed axis.
    pub axis: AxisBody,
    /// Interpolator (IPO) period, s; 0.01 where it is left out.
    pub period_s: Option<f64>,
}

/// The tool with its wear.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SimulatedToolBody {
    /// Its geometry.
    pub geometry: GeometryBody,
    /// What wear does to it.
    pub wear_effect: WearEffectBody,
    /// Its wear in units of the wear law, 0 to 10; a new tool (0) where neither this nor `cycles` is given.
    pub wear: Option<f64>,
    /// Its wear as cycles drilled, instead of `wear`.
    pub cycles: Option<f64>,
}

/// What is drilled.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SimulatedOperationBody {
    /// The sheet.
    pub sheet: SheetBody,
    /// Its material.
    pub material: MaterialBody,
    /// Commanded spindle speed, rpm; 2800 where it is left out.
    pub spindle_rpm: Option<f64>,
    /// Depth at which the path ends, mm below contact; 20.5 where it is left out.
    pub end_depth_mm: Option<f64>,
    /// Way in the air before contact, mm; 1.5 where it is left out.
    pub approach_mm: Option<f64>,
}

/// Machine, tool, operation and noise, each over the paper's values.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ModelBody {
    /// The machine.
    pub machine: SimulatedMachineBody,
    /// The tool.
    pub tool: SimulatedToolBody,
    /// What is drilled.
    pub operation: SimulatedOperationBody,
    /// Noise over a shop's typical noise; used only with a seed.
    pub noise: NoiseBody,
}

/// A checked model with what is to be drilled on it.
#[derive(Debug, Clone)]
pub struct Model {
    /// The process model.
    pub twin: Twin,
    /// Speed, wear, approach and period.
    pub setup: CycleSetup,
    /// Where the path ends, mm.
    pub end_depth_mm: f64,
}

impl ModelBody {
    /// The model; with noise where `noisy`.
    pub fn into_model(self, noisy: bool) -> Result<Model, Violation> {
        let mut params = TwinParams { noise: typical_noise(), ..paper_params() };
        self.machine.ratings.over(&mut params.machine);
        self.machine.axis.over(&mut params.machine.axis);
        self.tool.geometry.over(&mut params.tool);
        self.tool.wear_effect.over(&mut params.wear);
        self.operation.sheet.over(&mut params.sheet);
        self.operation.material.over(&mut params.material);
        self.noise.over(&mut params.noise);
        if !noisy {
            // Checked all the same: a bad value must not pass because it is not used.
            Twin::new(params).map_err(|error| located(&error))?;
            params.noise = NoiseLevels::default();
        }
        let twin = Twin::new(params).map_err(|error| located(&error))?;
        let wear = match (self.tool.wear, self.tool.cycles) {
            (Some(_), Some(_)) => {
                let text = "wear and cycles are both given: which of them holds is not known";
                return Err(Violation::new("tool.cycles", "contradictory", text));
            }
            (Some(wear), None) => wear,
            (None, Some(cycles)) => cycles_to_wear(&twin, cycles)?,
            (None, None) => 0.0,
        };
        let usual = CycleSetup::new(self.operation.spindle_rpm.unwrap_or(PAPER_SPINDLE_RPM), wear);
        let setup = CycleSetup {
            approach_mm: self.operation.approach_mm.unwrap_or(usual.approach_mm),
            period_s: self.machine.period_s.unwrap_or(usual.period_s),
            ..usual
        };
        PERIOD_RANGE.check("machine.period_s", setup.period_s)?;
        Ok(Model { twin, setup, end_depth_mm: self.operation.end_depth_mm.unwrap_or(PAPER_END_DEPTH_MM) })
    }
}

fn cycles_to_wear(twin: &Twin, cycles: f64) -> Result<f64, Violation> {
    let wear = twin.wear_after(cycles);
    if cycles.is_finite() && cycles >= 0.0 && wear <= 10.0 {
        return Ok(wear);
    }
    let text = "must be 0 or more, and at most ten units of wear";
    Err(Violation::new("tool.cycles", "out_of_range", text))
}

/// A refusal of the model with its path in a [`ModelBody`].
pub fn located(error: &Invalid) -> Violation {
    refused(error, |field| match field.split_once('.') {
        Some(("tool", rest)) => format!("tool.geometry.{rest}"),
        Some(("wear", rest)) => format!("tool.wear_effect.{rest}"),
        Some(("sheet" | "material", _)) => format!("operation.{field}"),
        Some(("machine", rest)) if !rest.starts_with("axis.") => format!("machine.ratings.{rest}"),
        _ => match field {
            "wear" => "tool.wear".to_owned(),
            "spindle_rpm" | "approach_mm" | "end_depth_mm" => format!("operation.{field}"),
            "period_s" => "machine.period_s".to_owned(),
            other => other.to_owned(),
        },
    })
}

impl From<&Model> for ModelBody {
    fn from(model: &Model) -> Self {
        let params = model.twin.params();
        Self {
            machine: SimulatedMachineBody {
                ratings: (&params.machine).into(),
                axis: (&params.machine.axis).into(),
                period_s: Some(model.setup.period_s),
            },
            tool: SimulatedToolBody {
                geometry: (&params.tool).into(),
                wear_effect: (&params.wear).into(),
                wear: Some(model.setup.wear),
                cycles: None,
            },
            operation: SimulatedOperationBody {
                sheet: (&params.sheet).into(),
                material: (&params.material).into(),
                spindle_rpm: Some(model.setup.spindle_rpm),
                end_depth_mm: Some(model.end_depth_mm),
                approach_mm: Some(model.setup.approach_mm),
            },
            noise: (&params.noise).into(),
        }
    }
}

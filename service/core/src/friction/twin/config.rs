//! What the process model is told: tool, sheet, material, wear, machine and noise.

use super::axis::AxisLimits;
use crate::friction::error::{Invalid, InvalidCode, between, positive};

/// The tool, tip first: centre, cone, calibrating cylinder, collar (Stryczek & Błaszczak 2020, Fig. 3). All in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolGeometry {
    /// Diameter of the cylinder.
    pub diameter_mm: f64,
    /// Length of the centre.
    pub centre_length_mm: f64,
    /// Diameter where the centre passes into the cone.
    pub centre_diameter_mm: f64,
    /// Length of the cone.
    pub cone_length_mm: f64,
    /// Length of the cylinder; what tells a long tool from a short one.
    pub cylinder_length_mm: f64,
    /// Diameter of the collar that forms the flange.
    pub collar_diameter_mm: f64,
    /// Length over which the cone runs out into the cylinder.
    pub shoulder_mm: f64,
}

impl ToolGeometry {
    /// Distance from the tip to the end of the cone.
    #[must_use]
    pub fn shoulder_depth_mm(&self) -> f64 {
        self.centre_length_mm + self.cone_length_mm
    }

    /// Distance from the tip to the collar.
    #[must_use]
    pub fn collar_depth_mm(&self) -> f64 {
        self.shoulder_depth_mm() + self.cylinder_length_mm
    }
}

/// The sheet and what becomes of it. Lengths in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sheet {
    /// Thickness before drilling.
    pub thickness_mm: f64,
    /// Length over which the bushing's wall thins out below the sheet.
    pub bushing_decay_mm: f64,
    /// Length of the bushing below the upper face.
    pub bushing_length_mm: f64,
    /// Tip depth at which the sheet opens, in sheet thicknesses.
    pub perforation: f64,
    /// Depth over which it opens, in sheet thicknesses.
    pub perforation_width: f64,
    /// Height of the flash that the collar meets.
    pub flash_height_mm: f64,
}

/// The material and its lumped heat balance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Shear stress of forming at the reference feed, cold, MPa.
    pub forming_mpa: f64,
    /// Shear stress of sliding contact, cold, MPa; it does not depend on the feed.
    pub friction_mpa: f64,
    /// Part of the sliding contact that remains on the cylinder, behind the cone, 0 to 1.
    pub cylinder_contact: f64,
    /// Normal stress under the cone at the reference feed, cold, MPa.
    pub normal_mpa: f64,
    /// How many times harder the closed sheet is to indent than the open one is to widen.
    pub confinement: f64,
    /// Shear stress of the flash under the collar, MPa.
    pub flash_shear_mpa: f64,
    /// Normal stress of the flash under the collar, MPa.
    pub flash_normal_mpa: f64,
    /// Exponent of the feed per revolution in torque.
    pub torque_rate_exponent: f64,
    /// Exponent of the feed per revolution in thrust.
    pub thrust_rate_exponent: f64,
    /// Reference feed per revolution in mm.
    pub reference_feed_mm: f64,
    /// Rise of temperature that halves the strength, K.
    pub softening_k: f64,
    /// Heat capacity of the heated zone, J/K.
    pub heat_capacity_j_per_k: f64,
    /// Time constant with which the zone loses its heat, s.
    pub cooling_s: f64,
}

/// What one unit of wear (10 000 cycles of the paper's tool) does.
///
/// The paper sees wear "in the area located between the conical and cylindrical part": the surface there gets
/// rough and drags while it passes through the wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WearEffect {
    /// Shear stress that the worn surface adds per unit of wear, cold, MPa.
    pub drag_mpa: f64,
    /// Middle of the worn area, from the end of the cone towards the collar, mm.
    pub offset_mm: f64,
    /// Half length of the worn area, mm.
    pub half_length_mm: f64,
    /// Exponent of the feed per revolution in that drag; 0 is dry friction.
    pub rate_exponent: f64,
    /// Relative rise of the thrust per unit of wear.
    pub thrust_rise: f64,
    /// Cycles per unit of wear.
    pub cycles_per_unit: f64,
    /// Exponent of wear over cycles; 1 is steady wear.
    pub growth_exponent: f64,
}

/// What the machine's percent loads refer to, and its drives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MachineRatings {
    /// Rated power of the spindle drive, W: torque is `spindle_rated_power_w` at `spindle_rated_rpm`.
    pub spindle_rated_power_w: f64,
    /// Speed at which rated torque gives rated power, rpm; 100 % spindle load is that torque.
    pub spindle_rated_rpm: f64,
    /// Load of the idling spindle, %.
    pub spindle_idle_percent: f64,
    /// Moment of inertia of the spindle, kg·m²; it makes the load peak of spinning up.
    pub spindle_inertia_kg_m2: f64,
    /// Thrust that 100 % feed-drive load stands for, N.
    pub feed_rated_thrust_n: f64,
    /// Load of the idling feed drive, %.
    pub feed_idle_percent: f64,
    /// Mass that the feed drive accelerates, kg.
    pub feed_mass_kg: f64,
    /// Acceleration and override latency of the feed axis.
    pub axis: AxisLimits,
    /// Spindle acceleration, rpm/s.
    pub spindle_acceleration_rpm_s: f64,
}

/// Standard deviations of what varies; all 0 is the noise-free model.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NoiseLevels {
    /// Reading of either drive load, points.
    pub load_points: f64,
    /// Reading of the thrust, N.
    pub thrust_n: f64,
    /// Reading of the torque, N·m.
    pub torque_nm: f64,
    /// Fluctuation of the process within a cycle, relative, with a correlation time of 0.1 s.
    pub process: f64,
    /// Strength of the material from cycle to cycle, relative.
    pub cycle: f64,
}

/// Everything together, as plain values; [`super::Twin::new`] checks them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwinParams {
    /// The tool.
    pub tool: ToolGeometry,
    /// The sheet.
    pub sheet: Sheet,
    /// The material.
    pub material: Material,
    /// What wear does.
    pub wear: WearEffect,
    /// The machine.
    pub machine: MachineRatings,
    /// What varies.
    pub noise: NoiseLevels,
}

impl MachineRatings {
    /// Spindle torque that 100 % load stands for, N·m.
    #[must_use]
    pub fn spindle_rated_torque_nm(&self) -> f64 {
        self.spindle_rated_power_w / (self.spindle_rated_rpm * 2.0 * std::f64::consts::PI / 60.0)
    }
}

impl TwinParams {
    /// Checks every value.
    ///
    /// # Errors
    /// With the path of the first value that is out of range or contradicts another.
    pub(super) fn check(&self) -> Result<(), Invalid> {
        self.check_tool_and_sheet()?;
        self.check_material_and_wear()?;
        let m = &self.machine;
        // A percent of next to nothing is no load.
        between("machine.spindle_rated_power_w", m.spindle_rated_power_w, 1.0, 1e6)?;
        between("machine.spindle_rated_rpm", m.spindle_rated_rpm, 1.0, 1e5)?;
        between("machine.spindle_idle_percent", m.spindle_idle_percent, 0.0, 100.0)?;
        between("machine.spindle_inertia_kg_m2", m.spindle_inertia_kg_m2, 0.0, 100.0)?;
        between("machine.feed_rated_thrust_n", m.feed_rated_thrust_n, 1.0, 1e6)?;
        between("machine.feed_idle_percent", m.feed_idle_percent, 0.0, 100.0)?;
        between("machine.feed_mass_kg", m.feed_mass_kg, 0.0, 1e5)?;
        m.axis.check().map_err(|error| error.within("machine.axis"))?;
        positive("machine.spindle_acceleration_rpm_s", m.spindle_acceleration_rpm_s, 1e6)?;
        let n = &self.noise;
        between("noise.load_points", n.load_points, 0.0, 20.0)?;
        between("noise.thrust_n", n.thrust_n, 0.0, 1e4)?;
        between("noise.torque_nm", n.torque_nm, 0.0, 1e3)?;
        between("noise.process", n.process, 0.0, 0.5)?;
        between("noise.cycle", n.cycle, 0.0, 0.2)?;
        Ok(())
    }

    fn check_tool_and_sheet(&self) -> Result<(), Invalid> {
        let t = &self.tool;
        positive("tool.diameter_mm", t.diameter_mm, 100.0)?;
        positive("tool.centre_length_mm", t.centre_length_mm, 50.0)?;
        positive("tool.centre_diameter_mm", t.centre_diameter_mm, t.diameter_mm)?;
        positive("tool.cone_length_mm", t.cone_length_mm, 200.0)?;
        positive("tool.cylinder_length_mm", t.cylinder_length_mm, 200.0)?;
        positive("tool.shoulder_mm", t.shoulder_mm, t.cone_length_mm)?;
        positive("tool.collar_diameter_mm", t.collar_diameter_mm, 300.0)?;
        if t.collar_diameter_mm <= t.diameter_mm {
            let text = "the collar must be wider than the cylinder";
            return Err(Invalid::new("tool.collar_diameter_mm", InvalidCode::Inconsistent, text));
        }
        let s = &self.sheet;
        between("sheet.thickness_mm", s.thickness_mm, 0.1, 20.0)?;
        positive("sheet.bushing_decay_mm", s.bushing_decay_mm, 50.0)?;
        between("sheet.bushing_length_mm", s.bushing_length_mm, s.thickness_mm, 100.0)?;
        positive("sheet.perforation", s.perforation, 10.0)?;
        positive("sheet.perforation_width", s.perforation_width, 10.0)?;
        between("sheet.flash_height_mm", s.flash_height_mm, 0.0, t.cylinder_length_mm)?;
        Ok(())
    }

    fn check_material_and_wear(&self) -> Result<(), Invalid> {
        let m = &self.material;
        between("material.forming_mpa", m.forming_mpa, 0.0, 5000.0)?;
        between("material.friction_mpa", m.friction_mpa, 0.0, 5000.0)?;
        between("material.cylinder_contact", m.cylinder_contact, 0.0, 1.0)?;
        between("material.normal_mpa", m.normal_mpa, 0.0, 10_000.0)?;
        between("material.confinement", m.confinement, 0.0, 100.0)?;
        between("material.flash_shear_mpa", m.flash_shear_mpa, 0.0, 5000.0)?;
        between("material.flash_normal_mpa", m.flash_normal_mpa, 0.0, 5000.0)?;
        between("material.torque_rate_exponent", m.torque_rate_exponent, 0.0, 2.0)?;
        between("material.thrust_rate_exponent", m.thrust_rate_exponent, 0.0, 2.0)?;
        between("material.reference_feed_mm", m.reference_feed_mm, 1e-4, 10.0)?;
        positive("material.softening_k", m.softening_k, 1e5)?;
        positive("material.heat_capacity_j_per_k", m.heat_capacity_j_per_k, 1e4)?;
        positive("material.cooling_s", m.cooling_s, 1e4)?;
        let w = &self.wear;
        between("wear.drag_mpa", w.drag_mpa, 0.0, 5000.0)?;
        between("wear.offset_mm", w.offset_mm, -50.0, 50.0)?;
        positive("wear.half_length_mm", w.half_length_mm, 50.0)?;
        between("wear.rate_exponent", w.rate_exponent, 0.0, 2.0)?;
        between("wear.thrust_rise", w.thrust_rise, 0.0, 10.0)?;
        positive("wear.cycles_per_unit", w.cycles_per_unit, 1e9)?;
        between("wear.growth_exponent", w.growth_exponent, 0.1, 5.0)?;
        Ok(())
    }
}

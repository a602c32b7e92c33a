//! The paper's machine, tool and strategies as one frozen set of values.
use super::config::*;
use crate::friction::error::Invalid;
use crate::friction::law::{LawConfig, LawParams};
use crate::friction::program::{Between, FeedProgram, Strategy};

/// Speed.
pub const PAPER_SPINDLE_RPM: f64 = 2800.0;

/// Params.
#[must_use]
pub const fn paper_params() -> TwinParams {
    TwinParams {
        tool: ToolGeometry { diameter_mm: 7.3, centre_length_mm: 1.5, centre_diameter_mm: 2.0, cone_length_mm: 8.0, cylinder_length_mm: 10.0, collar_diameter_mm: 13.0, shoulder_mm: 1.0 },
        sheet: Sheet { thickness_mm: 2.0, bushing_decay_mm: 1.5, bushing_length_mm: 8.0, perforation: 1.6, perforation_width: 0.4, flash_height_mm: 1.5 },
        material: Material { forming_mpa: 8.0, friction_mpa: 5.0, cylinder_contact: 0.1, normal_mpa: 60.0, confinement: 1.0, flash_shear_mpa: 1.0, flash_normal_mpa: 5.0, torque_rate_exponent: 0.8, thrust_rate_exponent: 0.6, reference_feed_mm: 0.1, softening_k: 300.0, heat_capacity_j_per_k: 2.0, cooling_s: 2.0 },
        wear: WearEffect { drag_mpa: 5.0, offset_mm: 1.5, half_length_mm: 1.5, rate_exponent: 0.0, thrust_rise: 0.1, cycles_per_unit: 10_000.0, growth_exponent: 1.0 },
        machine: MachineRatings { spindle_rated_power_w: 7000.0, spindle_rated_rpm: 4500.0, spindle_idle_percent: 5.0, spindle_inertia_kg_m2: 0.005, feed_rated_thrust_n: 4000.0, feed_idle_percent: 4.0, feed_mass_kg: 100.0, feed_acceleration_mm_s2: 300.0, override_latency_ipo: 2, spindle_acceleration_rpm_s: 10_000.0 },
        noise: NoiseLevels { load_points: 0.0, thrust_n: 0.0, torque_nm: 0.0, process: 0.0, cycle: 0.0 },
    }
}

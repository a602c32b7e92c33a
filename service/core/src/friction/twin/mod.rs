//! Process model ("twin") of friction drilling: thrust, torque and drive loads over depth.
//!
//! One lump of temperature, contact integrals over the tool's geometry, rate-dependent forming and
//! rate-independent sliding; see [`Twin::step`] for the equations. The paper gives figures but neither the tool's
//! dimensions nor the feeds, so one set of values was fitted to all of its figures together and frozen in
//! [`paper_params`] and [`PaperStrategies`]; no figure has a case of its own.
//!
//! Three ways in: [`Twin::step`] for a driver that sends a line per sample, [`Twin::drill`] for a whole cycle
//! under a strategy, [`Twin::record`] for its columns. What does not belong here: wear detection and the law.
//!
//! ```
//! use feedwright_core::friction::twin::{Twin, TwinInput, TwinState, paper_params};
//!
//! # fn main() -> Result<(), feedwright_core::friction::error::Invalid> {
//! let twin = Twin::new(paper_params())?;
//! let mut state = TwinState::new(0.0)?;
//! let line = TwinInput { depth_mm: 5.0, feed_mm_min: 120.0, spindle_rpm: 2800.0, dt_s: 0.01 };
//! let loads = twin.step(&mut state, &line, None)?;
//! assert!(loads.thrust_n > 0.0 && loads.torque_nm > 0.0);
//! # Ok(())
//! # }
//! ```

mod axis;
mod config;
mod cycle;
mod geometry;
mod model;
mod paper;
mod prepared;
#[cfg(test)]
mod tests;

pub use axis::{AxisLimits, AxisState, LONGEST_LATENCY_IPO};
pub use config::{MachineRatings, Material, NoiseLevels, Sheet, ToolGeometry, TwinParams, WearEffect};
pub use cycle::{CycleFigures, CycleSample, CycleSetup, Peak};
pub use model::{Twin, TwinInput, TwinOutput, TwinState};
pub use paper::{PAPER_END_DEPTH_MM, PAPER_SPINDLE_RPM, PaperStrategies, paper_params, typical_noise};
pub use prepared::PreparedHole;

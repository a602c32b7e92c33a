//! Process model ("twin") of friction drilling.

mod axis;
mod config;
mod cycle;
mod geometry;
mod model;
mod paper;

pub use axis::{AxisState, LONGEST_LATENCY_IPO};
pub use config::{MachineRatings, Material, NoiseLevels, Sheet, ToolGeometry, TwinParams, WearEffect};
pub use cycle::{CycleFigures, CycleSample, CycleSetup, Peak};
pub use model::{Twin, TwinInput, TwinOutput, TwinState};
pub use paper::{PAPER_SPINDLE_RPM, paper_params};

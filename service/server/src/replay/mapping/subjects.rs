//! What a mapping says of machines, tools and operations; quantities are texts that carry their unit.

use crate::replay::template::Template;
use serde::Deserialize;

/// A machine to register; quantities carry their unit as text.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MachineRule {
    /// Shape of the ids that it registers.
    pub id: Template,
    /// What people call it.
    pub name: Template,
    /// Kind of control.
    pub control: String,
    /// Interpolator cycle.
    pub ipo_period: String,
    /// What the spindle's percent refers to.
    pub spindle_load_refers_to: Option<String>,
    /// Rated power of the spindle.
    pub rated_power: Option<String>,
    /// Base speed of the spindle.
    pub base_speed: Option<String>,
    /// What the feed drive's percent refers to.
    pub feed_load_refers_to: Option<String>,
    /// Rated thrust of the feed drive.
    pub rated_thrust: Option<String>,
    /// Slowest feed.
    pub feed_min: String,
    /// Fastest feed.
    pub feed_max: String,
    /// Lowest override.
    pub override_min: String,
    /// Highest override.
    pub override_max: String,
}

/// A tool to register, and how its life began.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolRule {
    /// Shape of the ids that it registers.
    pub id: Template,
    /// What people call it.
    pub name: Template,
    /// Its type.
    pub tool_type: String,
    /// Its diameter.
    pub diameter: Option<String>,
    /// How it was mounted before its first recorded cycle.
    pub mounted: Mounted,
    /// Why it counts as new or used, as it is told to the service.
    pub reason: Option<String>,
}

/// How a tool's life began.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mounted {
    /// Its first cycles show a tool without wear.
    New,
    /// It had worked before: there is no new-tool baseline.
    Used,
}

/// An operation to register.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OperationRule {
    /// Shape of the ids that it registers.
    pub id: Template,
    /// What people call it.
    pub name: Template,
    /// Its process.
    pub process: String,
    /// NC program.
    pub program: Option<String>,
    /// Feature within the program.
    pub feature: Option<Template>,
    /// Work material.
    pub work_material: Option<String>,
    /// Commanded spindle speed.
    pub spindle_speed: Option<Template>,
    /// Programmed feed; may have holes, as in `"{feed} mm/s"`.
    pub programmed_feed: Option<Template>,
    /// Cycles that a baseline is learnt from.
    pub baseline_cycles: Option<u32>,
    /// Cycles that the level is the median of.
    pub window_cycles: Option<u32>,
}

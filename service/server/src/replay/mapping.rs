//! The mapping file: which columns of a recording are which channels, in which unit, and how cycles are cut out.
//!
//! Documented for its users in `docs/recordings.md`. Unknown keys are refused, and so is a channel without a unit.
//! To add a key, add a field with its doc here, use it in `plan`, and describe it there.

mod subjects;
mod time;

pub use subjects::{MachineRule, Mounted, OperationRule, ToolRule};
pub use time::{Clock, TimeRule};

use super::ReplayError;
use super::quantity::{Dimension, Unit, dimension_of};
use super::template::Template;
use feedwright_core::cycle::Channel;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

/// A whole mapping file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// What the recording is called.
    pub name: String,
    /// Which files of the folder belong to it; its holes are values for ids.
    pub files: Template,
    /// What separates cells; a comma unless said.
    #[serde(default = "comma")]
    pub delimiter: char,
    /// When rows were taken.
    pub time: TimeRule,
    /// How cycles are cut out of the rows.
    pub cut: CutRule,
    /// Values of a cycle that ids are made of.
    #[serde(default)]
    pub values: BTreeMap<String, ValueRule>,
    /// Ids of a cycle and what else it carries.
    pub cycle: CycleRule,
    /// Which column is which channel; the key is the channel's name in the API.
    pub channels: BTreeMap<String, ColumnRule>,
    /// Machines to register.
    #[serde(default)]
    pub machine: Vec<MachineRule>,
    /// Tools to register.
    #[serde(default)]
    pub tool: Vec<ToolRule>,
    /// Operations to register.
    #[serde(default)]
    pub operation: Vec<OperationRule>,
    /// A measured truth beside the recording, for the report only; never sent.
    pub reference: Option<ReferenceRule>,
}

fn comma() -> char {
    ','
}

/// How cycles are cut out: the rows are narrowed by each rule that is given, in this order.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CutRule {
    /// A cycle is a run of rows whose label reads alike.
    pub label: Option<LabelRule>,
    /// A cycle is a run of rows above a threshold.
    pub threshold: Option<ThresholdRule>,
    /// A cycle ends where a column changes.
    #[serde(default)]
    pub change: Vec<ChangeRule>,
    /// A cycle is so many rows.
    pub rows: Option<usize>,
    /// What becomes of rows left over at the end of a run.
    #[serde(default)]
    pub short: Short,
}

/// A run of rows whose label reads alike.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LabelRule {
    /// The column that holds the label.
    pub column: String,
    /// Labels that are cycles. Rows whose holes hold the same make one cycle; other labels are left out.
    pub is: Vec<Template>,
    /// Labels that a finished cycle has in at least one row; one without is posted as aborted.
    #[serde(default)]
    pub finished: Vec<Template>,
}

/// A run of rows above a threshold.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ThresholdRule {
    /// The column that is compared.
    pub column: String,
    /// A row belongs to a cycle above this, in the column's own unit.
    pub above: f64,
    /// Shorter runs are noise and are left out.
    #[serde(default = "one")]
    pub min_rows: usize,
}

fn one() -> usize {
    1
}

/// A cycle ends where this column changes.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChangeRule {
    /// The column.
    pub column: String,
    /// Numbers within so many percent of the run's first are no change; without it, any other text is one.
    pub tolerance_percent: Option<f64>,
}

/// What becomes of rows left over at the end of a run when cycles have a fixed number of rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Short {
    /// They are a shorter cycle.
    #[default]
    Keep,
    /// They are left out, and counted in the summary.
    Drop,
}

/// One value of a cycle, out of a column.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ValueRule {
    /// The column.
    pub column: String,
    /// Which of the cycle's cells counts.
    #[serde(default)]
    pub take: Take,
    /// Cells that do not count.
    #[serde(default)]
    pub ignore: Vec<String>,
}

/// Which of a cycle's cells counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Take {
    /// The first.
    #[default]
    First,
    /// The last.
    Last,
    /// The most frequent; the earliest of equally frequent ones.
    MostFrequent,
}

/// Ids of a cycle; holes are filled from the file's name, the label, `[values]` and `{index}`, the count in its file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CycleRule {
    /// The cycle's id; must differ from cycle to cycle.
    pub id: Template,
    /// The machine's id.
    pub machine: Template,
    /// The tool's id.
    pub tool: Template,
    /// The operation's id.
    pub operation: Template,
    /// Commanded spindle speed: the median over the cycle.
    pub spindle_speed: Option<ColumnRule>,
}

/// A column that holds a quantity: value = (cell × scale + offset) in `unit`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColumnRule {
    /// The column.
    pub column: String,
    /// The unit that the value is in.
    pub unit: Unit,
    /// What cells are multiplied by first.
    #[serde(default = "unity")]
    pub scale: f64,
    /// What is added then.
    #[serde(default)]
    pub offset: f64,
}

fn unity() -> f64 {
    1.0
}

impl ColumnRule {
    /// A cell's number in the unit of the API.
    pub fn value(&self, cell: f64) -> f64 {
        self.unit.convert(cell * self.scale + self.offset)
    }
}

/// A measured truth beside the recording.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReferenceRule {
    /// The column; its last cell in a cycle counts.
    pub column: String,
    /// What it is called in the report.
    pub name: String,
    /// The unit it is printed with.
    pub unit: String,
}

impl Mapping {
    /// Reads a mapping and checks what its types leave open.
    pub fn parse(text: &str) -> Result<Self, ReplayError> {
        let mapping: Self = toml::from_str(text).map_err(|error| ReplayError::Mapping(error.to_string()))?;
        mapping.check().map_err(ReplayError::Mapping)?;
        Ok(mapping)
    }

    fn check(&self) -> Result<(), String> {
        if !self.delimiter.is_ascii() {
            return Err("delimiter: must be one ASCII character".to_owned());
        }
        if self.channels.is_empty() {
            return Err("channels: needs at least one".to_owned());
        }
        for (name, rule) in &self.channels {
            let known = || Channel::ALL.iter().map(|channel| channel.as_str()).collect::<Vec<_>>().join(", ");
            let channel = Channel::parse(name)
                .ok_or_else(|| format!("channels.{name}: no such channel; known are {}", known()))?;
            rule.check(&format!("channels.{name}"), dimension_of(channel))?;
        }
        if let Some(speed) = &self.cycle.spindle_speed {
            speed.check("cycle.spindle_speed", Dimension::Speed)?;
        }
        self.time.check()?;
        self.cut.check()
    }

    /// Every column that has to be read.
    pub fn columns(&self) -> BTreeSet<String> {
        let mut names = BTreeSet::new();
        names.extend(self.time.column.clone());
        names.extend(self.cut.label.iter().map(|rule| rule.column.clone()));
        names.extend(self.cut.threshold.iter().map(|rule| rule.column.clone()));
        names.extend(self.cut.change.iter().map(|rule| rule.column.clone()));
        names.extend(self.values.values().map(|rule| rule.column.clone()));
        names.extend(self.cycle.spindle_speed.iter().map(|rule| rule.column.clone()));
        names.extend(self.channels.values().map(|rule| rule.column.clone()));
        names.extend(self.reference.iter().map(|rule| rule.column.clone()));
        names
    }
}

impl ColumnRule {
    fn check(&self, path: &str, needed: Dimension) -> Result<(), String> {
        if self.unit.dimension != needed {
            return Err(format!("{path}.unit: is a {:?}, needed is a {needed:?}", self.unit.dimension));
        }
        if !self.scale.is_finite() || self.scale == 0.0 || !self.offset.is_finite() {
            return Err(format!("{path}: scale must be finite and not 0, offset finite"));
        }
        Ok(())
    }
}

impl CutRule {
    fn check(&self) -> Result<(), String> {
        if self.label.is_none() && self.threshold.is_none() && self.change.is_empty() && self.rows.is_none() {
            return Err("cut: needs label, threshold, change or rows".to_owned());
        }
        if self.rows == Some(0) {
            return Err("cut.rows: must be at least 1".to_owned());
        }
        if self.short == Short::Drop && self.rows.is_none() {
            return Err("cut.short: means something only beside cut.rows".to_owned());
        }
        let tolerances = self.change.iter().filter_map(|rule| rule.tolerance_percent);
        if tolerances.clone().any(|percent| !(percent.is_finite() && percent > 0.0)) {
            return Err("cut.change: tolerance_percent must be above 0".to_owned());
        }
        if self.threshold.as_ref().is_some_and(|rule| !rule.above.is_finite()) {
            return Err("cut.threshold.above: must be finite".to_owned());
        }
        Ok(())
    }
}

#[cfg(test)]
pub(crate) mod tests;

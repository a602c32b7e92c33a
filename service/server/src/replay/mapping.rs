//! The mapping file: which columns of a recording are which channels, in which unit, and how cycles are cut out.
//!
//! Documented for its users in `docs/recordings.md`. Unknown keys are refused, and so is a channel without a unit.
//! To add a key, add a field with its doc here, use it in `plan`, and describe it there.

use super::ReplayError;
use super::quantity::{Dimension, Unit, dimension_of, quantity};
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

/// When rows were taken: either one per period, or a column says.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimeRule {
    /// Distance of two rows, as in `"100 ms"`.
    pub period: Option<String>,
    /// The column that says when.
    pub column: Option<String>,
    /// What that column counts in: a unit of time from an arbitrary start, `unix_s`, `unix_ms` or `rfc3339`.
    pub unit: Option<String>,
    /// When the first row of the first file was taken, where rows do not say it; RFC 3339.
    pub start: Option<String>,
    /// Time between the end of a file and the start of the next, where rows do not say it.
    pub between_files: Option<String>,
    /// Time added between two cycles, where rows do not say it.
    pub between_cycles: Option<String>,
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
    pub tool_type: Option<String>,
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

/// How rows are placed in time, once a [`TimeRule`] was checked.
#[derive(Debug, Clone, PartialEq)]
pub enum Clock {
    /// One row per period, ms.
    Period(f64),
    /// A column counts from an arbitrary start, in this unit.
    Counter(Unit),
    /// A column holds seconds since 1970, times this factor into µs.
    Unix(f64),
    /// A column holds RFC 3339.
    Rfc3339,
}

impl Clock {
    /// Whether rows themselves say the time of day.
    pub fn is_absolute(&self) -> bool {
        matches!(self, Self::Unix(_) | Self::Rfc3339)
    }
}

impl TimeRule {
    /// Which clock the rows follow.
    pub fn clock(&self) -> Result<Clock, String> {
        match (&self.period, &self.column, self.unit.as_deref()) {
            (Some(period), None, None) => {
                let period_ms = quantity(period, Dimension::Time)?;
                if period_ms > 0.0 {
                    Ok(Clock::Period(period_ms))
                } else {
                    Err("time.period: must be above 0".to_owned())
                }
            }
            (None, Some(_), Some("rfc3339")) => Ok(Clock::Rfc3339),
            (None, Some(_), Some("unix_s")) => Ok(Clock::Unix(1e6)),
            (None, Some(_), Some("unix_ms")) => Ok(Clock::Unix(1e3)),
            (None, Some(_), Some(unit)) => match Unit::parse(unit)? {
                unit if unit.dimension == Dimension::Time => Ok(Clock::Counter(unit)),
                _ => Err(format!("time.unit: {unit:?} is no unit of time")),
            },
            _ => Err("time: needs either period, or column with unit".to_owned()),
        }
    }

    /// When the first row was taken, µs since 1970; `None` where rows say it.
    pub fn start_us(&self) -> Result<Option<i64>, String> {
        self.start
            .as_ref()
            .map(|text| {
                let time: jiff::Timestamp = text.parse().map_err(|error| format!("time.start: {error}"))?;
                Ok(time.as_microsecond())
            })
            .transpose()
    }

    /// Time between files and between cycles, ms.
    pub fn gaps_ms(&self) -> Result<(f64, f64), String> {
        let gap = |path: &str, text: &Option<String>| match text {
            None => Ok(0.0),
            Some(text) => match quantity(text, Dimension::Time)? {
                gap if gap >= 0.0 => Ok(gap),
                _ => Err(format!("{path}: must not be negative")),
            },
        };
        Ok((
            gap("time.between_files", &self.between_files)?,
            gap("time.between_cycles", &self.between_cycles)?,
        ))
    }

    fn check(&self) -> Result<(), String> {
        let absolute = self.clock()?.is_absolute();
        let gaps = self.between_files.is_some() || self.between_cycles.is_some();
        match (absolute, self.start_us()?.is_some()) {
            (false, false) => Err("time.start: needed, because rows do not say the time of day".to_owned()),
            (true, true) => Err("time.start: rows themselves say the time of day".to_owned()),
            (true, false) if gaps => Err("time.between_…: rows themselves say the time of day".to_owned()),
            _ => self.gaps_ms().map(drop),
        }
    }
}

#[cfg(test)]
#[path = "mapping_tests.rs"]
pub(crate) mod tests;

//! Machines, tools and operations that a recording needs, each registered before its first cycle.

use super::mapping::{MachineRule, Mapping, Mounted, OperationRule, ToolRule};
use super::plan::{RecordedCycle, filled_quantity};
use super::quantity::{Dimension, quantity};
use super::template::{Template, Values};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Bodies to put, by id.
#[derive(Debug, Default)]
pub struct Registrations {
    /// Machines.
    pub machines: BTreeMap<String, Value>,
    /// Tools.
    pub tools: BTreeMap<String, Value>,
    /// Operations.
    pub operations: BTreeMap<String, Value>,
    /// How each tool's life begins.
    pub mounts: Vec<Mount>,
}

/// The event that begins a tool's life.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mount {
    /// The tool.
    pub tool: String,
    /// `mounted_new` or `mounted_used`.
    pub kind: &'static str,
    /// When: at the start of its first cycle, µs since 1970, as recorded.
    pub at_us: i64,
    /// Why.
    pub reason: Option<String>,
}

pub(super) struct Registration<'a> {
    mapping: &'a Mapping,
    found: Registrations,
}

impl<'a> Registration<'a> {
    pub(super) fn new(mapping: &'a Mapping) -> Self {
        Self { mapping, found: Registrations::default() }
    }

    /// Registers what a cycle names and the mapping describes; what it does not describe is not ours to register.
    pub(super) fn meet(&mut self, machine: &str, tool: &str, operation: &str) -> Result<(), String> {
        let Registrations { machines, tools, operations, .. } = &mut self.found;
        note(machines, machine, &self.mapping.machine, |rule| &rule.id, machine_body)?;
        note(tools, tool, &self.mapping.tool, |rule| &rule.id, tool_body)?;
        note(operations, operation, &self.mapping.operation, |rule| &rule.id, operation_body)
    }

    /// Adds the tools' first events; `cycles` are in the order of time.
    pub(super) fn finish(mut self, cycles: &[RecordedCycle]) -> Registrations {
        for tool in self.found.tools.keys() {
            let rule = self.mapping.tool.iter().find(|rule| rule.id.read(tool).is_some());
            let first = cycles.iter().find(|cycle| cycle.tool.as_str() == tool.as_str());
            if let (Some(rule), Some(first)) = (rule, first) {
                self.found.mounts.push(Mount {
                    tool: tool.clone(),
                    kind: match rule.mounted {
                        Mounted::New => "mounted_new",
                        Mounted::Used => "mounted_used",
                    },
                    at_us: first.started_us,
                    reason: rule.reason.clone(),
                });
            }
        }
        self.found
    }
}

fn note<R>(
    into: &mut BTreeMap<String, Value>,
    id: &str,
    rules: &[R],
    shape: impl Fn(&R) -> &Template,
    body: impl Fn(&R, &Values) -> Result<Value, String>,
) -> Result<(), String> {
    if into.contains_key(id) {
        return Ok(());
    }
    if let Some((rule, values)) = rules.iter().find_map(|rule| Some((rule, shape(rule).read(id)?))) {
        into.insert(id.to_owned(), body(rule, &values)?);
    }
    Ok(())
}

/// Puts what is known, so that what is not known stays undeclared and not null.
fn put(body: &mut Map<String, Value>, name: &str, value: Option<impl Into<Value>>) {
    if let Some(value) = value {
        body.insert(name.to_owned(), value.into());
    }
}

fn optional(text: Option<&String>, dimension: Dimension) -> Result<Option<f64>, String> {
    text.map(|text| quantity(text, dimension)).transpose()
}

fn machine_body(rule: &MachineRule, values: &Values) -> Result<Value, String> {
    let mut spindle = Map::new();
    put(&mut spindle, "reference", rule.spindle_load_refers_to.clone());
    put(&mut spindle, "rated_power_watts", optional(rule.rated_power.as_ref(), Dimension::Power)?);
    put(&mut spindle, "base_speed_rpm", optional(rule.base_speed.as_ref(), Dimension::Speed)?);
    let mut feed_drive = Map::new();
    put(&mut feed_drive, "reference", rule.feed_load_refers_to.clone());
    put(&mut feed_drive, "rated_thrust_newtons", optional(rule.rated_thrust.as_ref(), Dimension::Force)?);
    Ok(json!({
        "name": rule.name.fill(values)?,
        "control": rule.control,
        "ipo_period_ms": quantity(&rule.ipo_period, Dimension::Time)?,
        "spindle": spindle,
        "feed_drive": feed_drive,
        "limits": {
            "feed_min_mm_min": quantity(&rule.feed_min, Dimension::Feed)?,
            "feed_max_mm_min": quantity(&rule.feed_max, Dimension::Feed)?,
            "override_min_percent": quantity(&rule.override_min, Dimension::Share)?,
            "override_max_percent": quantity(&rule.override_max, Dimension::Share)?,
        },
    }))
}

fn tool_body(rule: &ToolRule, values: &Values) -> Result<Value, String> {
    let mut body = Map::new();
    put(&mut body, "name", Some(rule.name.fill(values)?));
    put(&mut body, "tool_type", Some(rule.tool_type.clone()));
    put(&mut body, "diameter_mm", optional(rule.diameter.as_ref(), Dimension::Length)?);
    Ok(Value::Object(body))
}

fn operation_body(rule: &OperationRule, values: &Values) -> Result<Value, String> {
    let mut body = Map::new();
    put(&mut body, "name", Some(rule.name.fill(values)?));
    put(&mut body, "process", Some(rule.process.clone()));
    put(&mut body, "program", rule.program.clone());
    put(&mut body, "feature", rule.feature.as_ref().map(|feature| feature.fill(values)).transpose()?);
    put(&mut body, "work_material", rule.work_material.clone());
    let speed = filled_quantity(rule.spindle_speed.as_ref(), values, Dimension::Speed)?;
    put(&mut body, "spindle_speed_rpm", speed);
    let feed = filled_quantity(rule.programmed_feed.as_ref(), values, Dimension::Feed)?;
    put(&mut body, "programmed_feed_mm_min", feed);
    let mut wear = Map::new();
    put(&mut wear, "baseline_cycles", rule.baseline_cycles);
    put(&mut wear, "window_cycles", rule.window_cycles);
    if !wear.is_empty() {
        body.insert("wear".to_owned(), Value::Object(wear));
    }
    Ok(Value::Object(body))
}

//! What is shown, as JSON.

use crate::http::dto::alarm::AlarmView;
use crate::http::dto::time;
use crate::ingest::intake::Accepted;
use feedwright_core::ids::MachineId;
use feedwright_core::units::Timestamp;
use feedwright_store::Alarm;
use serde::Serialize;
use serde_json::{Value, json};

/// What an event tells of; its word is the event's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A machine's stream opened or closed, a cycle began or ended.
    Machine,
    /// A cycle was durably stored.
    Cycle,
    /// An alarm was raised, acknowledged or cleared.
    Alarm,
    /// What is registered, told or in force was changed: advice may be another one now.
    Changed,
    /// A sample of a running cycle with its override; thinned, without a number.
    Sample,
    /// Something is missing here.
    Gap,
}

impl Kind {
    const ALL: [Self; 6] = [Self::Machine, Self::Cycle, Self::Alarm, Self::Changed, Self::Sample, Self::Gap];

    /// The event's name.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Machine => "machine",
            Self::Cycle => "cycle",
            Self::Alarm => "alarm",
            Self::Changed => "changed",
            Self::Sample => "sample",
            Self::Gap => "gap",
        }
    }

    /// The kind of that name.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.as_str() == text)
    }
}

/// What a machine's stream does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MachineState {
    /// It is open, no cycle runs.
    Connected,
    /// A cycle runs.
    Running,
    /// The connection broke in a cycle that may still be resumed.
    Interrupted,
    /// It is closed.
    Disconnected,
}

impl MachineState {
    /// The word used in events.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Connected => "connected",
            Self::Running => "running",
            Self::Interrupted => "interrupted",
            Self::Disconnected => "disconnected",
        }
    }
}

/// What an event tells, as JSON: a tree that is looked into here too, or the text that is shown.
#[derive(Debug, Clone, PartialEq)]
pub enum Data {
    /// A tree.
    Tree(Value),
    /// Its text: most events are stored cycles, of which a tree costs more than all the rest of them.
    Text(Box<str>),
}

impl Data {
    /// The text that is shown.
    pub(super) fn into_text(self) -> Box<str> {
        match self {
            Self::Tree(tree) => tree.to_string().into(),
            Self::Text(text) => text,
        }
    }

    /// The tree that is sent to other servers.
    pub(super) fn into_tree(self) -> Value {
        match self {
            Self::Tree(tree) => tree,
            // This server wrote it.
            Self::Text(text) => serde_json::from_str(&text).unwrap_or_default(),
        }
    }
}

impl From<Value> for Data {
    fn from(tree: Value) -> Self {
        Self::Tree(tree)
    }
}

/// A stored cycle, as it is shown.
#[derive(Serialize)]
struct ShownCycle<'a> {
    machine: &'a str,
    cycle_id: &'a str,
    tool: &'a str,
    operation: &'a str,
    process: Option<&'static str>,
    started_at: String,
    received_at: String,
    duration_ms: Option<f64>,
    energy_joules: Option<f64>,
    energy_basis: Option<&'static str>,
    flags: Vec<&'static str>,
    tool_state: &'static str,
    level_as_run: Option<f64>,
    action: &'static str,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// What it tells of.
    pub kind: Kind,
    /// The machine that it concerns.
    pub machine: Option<String>,
    /// What is told.
    pub data: Data,
}

impl Event {
    /// An event.
    pub fn new(kind: Kind, machine: Option<&MachineId>, data: impl Into<Data>) -> Self {
        Self { kind, machine: machine.map(ToString::to_string), data: data.into() }
    }

    /// A machine's stream changed; `cycle` has the id of the cycle, its tool and its operation.
    pub fn machine(
        machine: &MachineId,
        state: MachineState,
        cycle: Option<(&str, &str, &str)>,
        at: Timestamp,
    ) -> Self {
        let mut data = json!({"machine": machine.as_str(), "state": state.as_str(), "at": time::show(at)});
        if let Some((cycle, tool, operation)) = cycle {
            data["cycle_id"] = cycle.into();
            data["tool"] = tool.into();
            data["operation"] = operation.into();
        }
        Self::new(Kind::Machine, Some(machine), data)
    }

    /// A cycle was stored.
    pub fn cycle(accepted: &Accepted) -> Self {
        let Accepted { cycle, answer, .. } = accepted;
        let recommendation = &answer.recommendation.recommendation;
        let energy = answer.summary.best_energy();
        let process = cycle.process.or(recommendation.process);
        let shown = ShownCycle {
            machine: cycle.machine.as_str(),
            cycle_id: cycle.id.as_str(),
            tool: cycle.tool.as_str(),
            operation: cycle.operation.as_str(),
            process: process.map(feedwright_core::units::Process::as_str),
            started_at: time::show(cycle.started_at),
            received_at: time::show(answer.received_at),
            duration_ms: answer.summary.duration_ms,
            energy_joules: energy.map(|energy| energy.total_joules),
            energy_basis: energy.map(|energy| energy.basis.as_str()),
            flags: answer.summary.flags.iter().map(feedwright_core::cycle::Flag::as_str).collect(),
            tool_state: answer.verdict.state.as_str(),
            level_as_run: answer.verdict.level.map(|level| level.as_run),
            action: recommendation.action.as_str(),
        };
        // Strings and numbers always have a text.
        let data = Data::Text(serde_json::to_string(&shown).unwrap_or_default().into());
        Self::new(Kind::Cycle, Some(&cycle.machine), data)
    }

    /// An alarm was `raised`, `acknowledged` or `cleared`.
    pub fn alarm(change: &str, alarm: Alarm) -> Self {
        let machine = alarm.machine.clone();
        let data = json!({"change": change, "alarm": AlarmView::from(alarm)});
        Self::new(Kind::Alarm, machine.as_ref(), data)
    }

    /// An alarm that was shown is open no more.
    pub fn alarm_cleared(alarm: &Alarm) -> Self {
        let data = json!({"change": "cleared", "alarm": AlarmView::from(alarm.clone())});
        Self::new(Kind::Alarm, alarm.machine.as_ref(), data)
    }

    /// What stands under `what` in the API was changed, such as `tools`.
    pub fn changed(what: &str) -> Self {
        Self::new(Kind::Changed, None, json!({"what": what}))
    }

    /// Something is missing; `reason` is a stable code.
    pub fn gap(reason: &str, missed: Option<u64>) -> Self {
        Self::new(Kind::Gap, None, json!({"reason": reason, "missed": missed}))
    }
}

//! Tools and their events in JSON.

use super::text::{MAX_NAME, MAX_REASON, optional, required};
use super::time;
use super::word::ToolEventKindWord;
use super::{Registered, checked};
use crate::ingest::body::CLOCK_AHEAD_MS;
use feedwright_core::ids::{CycleId, MachineId, ToolId};
use feedwright_core::invalid::Violation;
use feedwright_core::tool::{Tool, ToolEvent, ToolEventKind};
use feedwright_core::units::Timestamp;
use feedwright_store::{StoredToolEvent, Versioned};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One physical tool as it is registered.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ToolBody {
    /// What people call it.
    #[schema(example = "FD M8 no. 17")]
    pub name: String,
    /// The maker's serial number, where it differs from the id.
    #[serde(default)]
    pub serial: Option<String>,
    /// Kind of tool: tools of one type may share feed profiles.
    #[schema(example = "friction-drill-7.3")]
    pub tool_type: String,
    /// Diameter, mm.
    #[serde(default)]
    pub diameter_mm: Option<f64>,
}

impl ToolBody {
    /// The tool of that id.
    pub fn into_tool(self, id: ToolId) -> Result<Tool, Vec<Violation>> {
        let mut wrong = Vec::new();
        let tool = Tool {
            id,
            name: required("name", &self.name, MAX_NAME, &mut wrong),
            serial: optional("serial", self.serial.as_deref(), MAX_NAME, &mut wrong),
            tool_type: required("tool_type", &self.tool_type, MAX_NAME, &mut wrong),
            diameter_mm: self.diameter_mm,
        };
        checked(tool, wrong, Tool::validated)
    }
}

impl From<Versioned<Tool>> for Registered<ToolBody> {
    fn from(stored: Versioned<Tool>) -> Self {
        let Tool { id, name, serial, tool_type, diameter_mm } = stored.value;
        let body = ToolBody { name, serial, tool_type, diameter_mm };
        Self::of(id.as_str(), (stored.version, stored.updated_at, stored.is_damaged), body)
    }
}

/// An event of a tool as it is told. It takes effect with the first cycle that it names, or at its time.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ToolEventBody {
    /// What happened. A life of a new tool begins with `mounted_new`, `changed` (another one of its kind under the same id), `reground`
    /// and `reset`; with `mounted_used` one of which no level is told; with `conditions_confirmed` none, what jumped and stayed is how
    /// it is run from now on. A tool of which nothing was told counts as new from its first cycle on.
    pub kind: ToolEventKindWord,
    /// When, RFC 3339, at most 10 minutes ahead of the server's clock; now where it is left out.
    #[serde(default)]
    #[schema(example = "2026-05-04T06:00:00Z")]
    pub at: Option<String>,
    /// The first cycle it covers, where that is known.
    #[serde(default)]
    pub first_cycle: Option<FirstCycle>,
    /// Why; required for a reset.
    #[serde(default)]
    pub reason: Option<String>,
}

/// Names a cycle.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FirstCycle {
    /// The machine that ran it.
    pub machine: String,
    /// Its id within the machine.
    pub cycle_id: String,
}

impl ToolEventBody {
    /// The event; it happened `now` where the body names no time.
    pub fn into_event(self, now: Timestamp) -> Result<ToolEvent, Vec<Violation>> {
        let mut wrong = Vec::new();
        let at = self.at.as_deref().map_or(Ok(now), |at| time::read("at", at)).and_then(|at| {
            // A typing error of the year would part every cycle to come from the tool that runs it.
            if at.millis_since(now) > CLOCK_AHEAD_MS {
                let why = "is more than 10 minutes ahead of the server's clock";
                return Err(Violation::new("at", "in_future", why));
            }
            Ok(at)
        });
        let reason = optional("reason", self.reason.as_deref(), MAX_REASON, &mut wrong);
        if self.kind.0 == ToolEventKind::Reset && reason.is_none() {
            wrong.push(Violation::new("reason", "reason_required", "a reset needs a reason"));
        }
        let first_cycle = self.first_cycle.map(|first| {
            let machine = MachineId::parse("first_cycle.machine", &first.machine)?;
            Ok((machine, CycleId::parse("first_cycle.cycle_id", &first.cycle_id)?))
        });
        match (at, first_cycle.transpose()) {
            (Ok(at), Ok(first_cycle)) if wrong.is_empty() => {
                Ok(ToolEvent { kind: self.kind.0, at, first_cycle, reason })
            }
            (at, first_cycle) => {
                wrong.extend(at.err());
                wrong.extend(first_cycle.err());
                Err(wrong)
            }
        }
    }
}

/// An event of a tool as it is kept.
#[derive(Debug, Serialize, ToSchema)]
pub struct ToolEventView {
    /// Its number, ascending in the order of arrival.
    pub id: i64,
    /// What happened.
    pub kind: ToolEventKindWord,
    /// When, RFC 3339.
    pub at: String,
    /// The first cycle it covers.
    pub first_cycle: Option<FirstCycle>,
    /// Why.
    pub reason: Option<String>,
    /// The token that told it.
    pub actor: String,
    /// When it was told, RFC 3339.
    pub recorded_at: String,
    /// When it was revoked, RFC 3339: it holds no more.
    pub revoked_at: Option<String>,
    /// The token that revoked it.
    pub revoked_by: Option<String>,
}

impl From<StoredToolEvent> for ToolEventView {
    fn from(stored: StoredToolEvent) -> Self {
        let ToolEvent { kind, at, first_cycle, reason } = stored.event;
        let first_cycle = first_cycle.map(|(machine, cycle)| FirstCycle {
            machine: machine.as_str().to_owned(),
            cycle_id: cycle.as_str().to_owned(),
        });
        let (revoked_by, revoked_at) = stored.revoked.unzip();
        Self {
            id: stored.id,
            kind: ToolEventKindWord(kind),
            at: time::show(at),
            first_cycle,
            reason,
            actor: stored.actor,
            recorded_at: time::show(stored.recorded_at),
            revoked_at: revoked_at.map(time::show),
            revoked_by,
        }
    }
}

//! Alarms in JSON.

use super::time;
use super::word::AlarmKindWord;
use feedwright_store::Alarm;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// Which alarms a list asks for.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct AlarmQuery {
    /// Only those that are open (`true`), or only those that are cleared (`false`).
    pub open: Option<bool>,
    /// Of this machine.
    pub machine: Option<String>,
    /// Of this tool.
    pub tool: Option<String>,
    /// Most rows wanted, up to `limits.max_page_size` of the configuration, which is 1000 unless set otherwise; 100
    /// (`limits.default_page_size`) where it is left out.
    #[param(minimum = 1, maximum = 10_000)]
    pub limit: Option<u32>,
    /// `next_cursor` of the page before.
    pub cursor: Option<String>,
}

/// An alarm: at most one of a kind is open for one subject.
#[derive(Debug, Serialize, ToSchema)]
pub struct AlarmView {
    /// Its number, ascending.
    pub id: i64,
    /// What it says.
    pub kind: AlarmKindWord,
    /// The machine it concerns.
    pub machine: Option<String>,
    /// The tool it concerns.
    pub tool: Option<String>,
    /// A sentence for a person.
    pub message: String,
    /// When it was raised, RFC 3339.
    pub raised_at: String,
    /// When it was cleared.
    pub cleared_at: Option<String>,
    /// The token that acknowledged it.
    pub acknowledged_by: Option<String>,
    /// When it was acknowledged.
    pub acknowledged_at: Option<String>,
}

impl From<Alarm> for AlarmView {
    fn from(alarm: Alarm) -> Self {
        let (acknowledged_by, acknowledged_at) = alarm.acknowledged.unzip();
        Self {
            id: alarm.id,
            kind: AlarmKindWord(alarm.kind),
            machine: alarm.machine.map(|machine| machine.as_str().to_owned()),
            tool: alarm.tool.map(|tool| tool.as_str().to_owned()),
            message: alarm.message,
            raised_at: time::show(alarm.raised_at),
            cleared_at: alarm.cleared_at.map(time::show),
            acknowledged_by,
            acknowledged_at: acknowledged_at.map(time::show),
        }
    }
}

/// The alarms that were acknowledged.
#[derive(Debug, Serialize, ToSchema)]
pub struct Acknowledged {
    /// The alarms, in the order of their numbers; empty where none was open.
    pub acknowledged: Vec<AlarmView>,
}

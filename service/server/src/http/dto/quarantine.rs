//! Quarantine entries in JSON.

use super::text::{MAX_REASON, required};
use super::time;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use feedwright_core::invalid::Violation;
use feedwright_store::QuarantineEntry;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// Which quarantine entries a list asks for.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct QuarantineQuery {
    /// Of this machine.
    pub machine: Option<String>,
    /// `true` (where it is left out): only those that are not settled.
    pub open: Option<bool>,
    /// Most rows wanted, up to `limits.max_page_size` of the configuration, which is 1000 unless set otherwise; 100
    /// (`limits.default_page_size`) where it is left out.
    #[param(minimum = 1, maximum = 10_000)]
    pub limit: Option<u32>,
    /// `next_cursor` of the page before.
    pub cursor: Option<String>,
}

/// What could not be accepted.
#[derive(Debug, Serialize, ToSchema)]
pub struct QuarantineView {
    /// Its id.
    pub id: String,
    /// The machine that sent it.
    pub machine: String,
    /// Its cycle id, where that could be read.
    pub cycle_id: Option<String>,
    /// When it came, RFC 3339.
    pub received_at: String,
    /// Stable code of the first problem.
    pub code: String,
    /// The problem document that was answered.
    #[schema(value_type = Object)]
    pub problem: serde_json::Value,
    /// The content type it came with.
    pub content_type: String,
    /// Size of its body, bytes.
    pub size_bytes: u64,
    /// When it was settled, RFC 3339.
    pub settled_at: Option<String>,
    /// How it was settled.
    pub settled_how: Option<String>,
}

impl From<QuarantineEntry> for QuarantineView {
    fn from(entry: QuarantineEntry) -> Self {
        let (settled_at, settled_how) = entry.settled.unzip();
        let problem = serde_json::from_str(&entry.problem);
        Self {
            id: entry.id,
            machine: entry.machine.as_str().to_owned(),
            cycle_id: entry.cycle,
            received_at: time::show(entry.received_at),
            code: entry.code,
            problem: problem.unwrap_or(serde_json::Value::String(entry.problem)),
            content_type: entry.content_type,
            size_bytes: entry.size,
            settled_at: settled_at.map(time::show),
            settled_how,
        }
    }
}

/// What could not be accepted, with its body.
#[derive(Debug, Serialize, ToSchema)]
pub struct QuarantineDetail {
    /// The entry.
    #[serde(flatten)]
    pub entry: QuarantineView,
    /// Its body as it came, where it is text.
    pub body: Option<String>,
    /// Its body in base64, where it is not.
    pub body_base64: Option<String>,
    /// Whether what is kept is not what came, by its hash: then neither is told.
    pub body_damaged: bool,
}

impl From<(QuarantineEntry, Option<Vec<u8>>)> for QuarantineDetail {
    fn from((entry, body): (QuarantineEntry, Option<Vec<u8>>)) -> Self {
        let body_damaged = body.is_none();
        let (body, body_base64) = match body.map(String::from_utf8) {
            Some(Ok(text)) => (Some(text), None),
            Some(Err(error)) => (None, Some(STANDARD.encode(error.as_bytes()))),
            None => (None, None),
        };
        Self { entry: entry.into(), body, body_base64, body_damaged }
    }
}

/// What is done with a quarantine entry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum QuarantineAction {
    /// It is settled without being taken in.
    Discard,
    /// Its body, or the repaired one, is taken in as if its machine had sent it now.
    Reingest,
}

/// How a quarantine entry is settled.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SettleBody {
    /// What is done.
    pub action: QuarantineAction,
    /// Why; goes into the audit.
    pub reason: String,
    /// The text of the repaired body, only with `reingest`: text, so that every digit stays as it was written.
    #[serde(default)]
    pub body: Option<String>,
}

impl SettleBody {
    /// Checks the reason, and that a body comes only where it is used.
    pub fn check(&self) -> Result<(), Vec<Violation>> {
        let mut wrong = Vec::new();
        required("reason", &self.reason, MAX_REASON, &mut wrong);
        if self.action == QuarantineAction::Discard && self.body.is_some() {
            wrong.push(Violation::new("body", "body_not_used", "a body has no meaning when discarding"));
        }
        if wrong.is_empty() { Ok(()) } else { Err(wrong) }
    }
}

/// How a quarantine entry was settled.
#[derive(Debug, Serialize, ToSchema)]
pub struct Settled {
    /// The entry's id.
    pub id: String,
    /// How it was settled.
    pub how: String,
    /// What the machine would have been answered, where the body was taken in.
    #[schema(value_type = Option<Object>)]
    pub answer: Option<serde_json::Value>,
}

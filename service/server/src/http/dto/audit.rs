//! Audit lines in JSON.

use super::time;
use super::word::RoleWord;
use feedwright_store::AuditEntry;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// Which part of the audit, and from which end.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct AuditQuery {
    /// Most rows wanted, up to `limits.max_page_size` of the configuration, which is 1000 unless set otherwise; 100
    /// (`limits.default_page_size`) where it is left out.
    #[param(minimum = 1, maximum = 10_000)]
    pub limit: Option<u32>,
    /// `next_cursor` of the page before, of the same order.
    pub cursor: Option<String>,
    /// `oldest` (where it is left out) or `newest` first.
    #[serde(default)]
    #[param(inline)]
    pub order: AuditOrder,
}

/// Which line comes first.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum AuditOrder {
    /// The oldest.
    #[default]
    Oldest,
    /// The newest.
    Newest,
}

/// One line of the audit: who changed what, and when.
#[derive(Debug, Serialize, ToSchema)]
pub struct AuditView {
    /// Its number, ascending.
    pub id: i64,
    /// When, RFC 3339.
    pub at: String,
    /// The token that was used, or `cli`.
    pub actor: String,
    /// In which role.
    pub role: RoleWord,
    /// What, as in `machine.put`.
    pub action: String,
    /// Of what, as in `machine/M1`.
    pub subject: String,
    /// What changed.
    #[schema(value_type = Object)]
    pub detail: serde_json::Value,
}

impl From<AuditEntry> for AuditView {
    fn from(entry: AuditEntry) -> Self {
        // Every line is written as JSON; one that is not is shown as it stands rather than hidden.
        let detail = serde_json::from_str(&entry.detail);
        Self {
            id: entry.id,
            at: time::show(entry.at),
            actor: entry.actor,
            role: RoleWord(entry.role),
            action: entry.action,
            subject: entry.subject,
            detail: detail.unwrap_or(serde_json::Value::String(entry.detail)),
        }
    }
}

//! Audit lines in JSON.

use super::time;
use super::word::RoleWord;
use feedwright_store::AuditEntry;
use serde::Serialize;
use utoipa::ToSchema;

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

//! The audit: lines are added in the transaction of what they tell of.

use super::{Conn, Db, dialect};
use crate::error::StoreResult;
use crate::record::{Actor, AuditEntry, Page, PutOutcome, RowNumber};
use crate::rows::AuditRow;
use feedwright_core::units::Timestamp;
use serde_json::{Map, Value, json};

/// Adds a line.
pub(super) async fn add(
    conn: &mut Conn,
    actor: &Actor,
    now: Timestamp,
    action: &'static str,
    subject: String,
    detail: &Value,
) -> StoreResult<()> {
    dialect::begin_audit_line(conn).await?;
    sqlx::query::<Db>(
        "INSERT INTO audit (at_us, actor, role, action, subject, detail) VALUES ($1, $2, $3, $4, $5, $6)",
    )
    .bind(now.micros())
    .bind(&actor.token)
    .bind(actor.role.as_str())
    .bind(action)
    .bind(subject)
    .bind(detail.to_string())
    .execute(&mut *conn)
    .await?;
    Ok(())
}

/// What a put changed: the whole where it is new, otherwise each field with its old and new value.
pub(super) fn change(before: Option<&Value>, after: &Value, outcome: PutOutcome) -> Value {
    let version = outcome.version();
    let Some(before) = before else {
        return json!({ "version": version, "created": after });
    };
    let mut changed = Map::new();
    for (field, value) in after.as_object().into_iter().flatten() {
        if before.get(field) != Some(value) {
            changed.insert(field.clone(), json!([before.get(field), value]));
        }
    }
    json!({ "version": version, "changed": changed })
}

/// Oldest line first, up to `last`: those behind it may have lines before them that are not committed yet, which whoever goes on behind
/// them would never be shown.
pub(super) async fn list(
    conn: &mut Conn,
    page: &Page<RowNumber>,
    last: RowNumber,
) -> StoreResult<Vec<AuditEntry>> {
    let rows: Vec<AuditRow> = sqlx::query_as::<Db, _>(
        "SELECT audit_id, at_us, actor, role, action, subject, detail FROM audit
         WHERE audit_id > $1 AND audit_id <= $2 ORDER BY audit_id LIMIT $3",
    )
    .bind(page.after.unwrap_or(i64::MIN))
    .bind(last)
    .bind(i64::from(page.limit))
    .fetch_all(&mut *conn)
    .await?;
    rows.into_iter().map(AuditRow::entry).collect()
}

/// Newest line first: those before `after`.
pub(super) async fn newest(conn: &mut Conn, page: &Page<RowNumber>) -> StoreResult<Vec<AuditEntry>> {
    let rows: Vec<AuditRow> = sqlx::query_as::<Db, _>(
        "SELECT audit_id, at_us, actor, role, action, subject, detail FROM audit
         WHERE audit_id < $1 ORDER BY audit_id DESC LIMIT $2",
    )
    .bind(page.after.unwrap_or(i64::MAX))
    .bind(i64::from(page.limit))
    .fetch_all(&mut *conn)
    .await?;
    rows.into_iter().map(AuditRow::entry).collect()
}

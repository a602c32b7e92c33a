//! Tools and their events.

use super::{Conn, Db, alarms, audit, dialect, registry, wear};
use crate::error::StoreResult;
use crate::locks::Locks;
use crate::precondition;
use crate::record::{Actor, Page, Precondition, PutOutcome, RowNumber, StoredToolEvent, Versioned};
use crate::rows::{EventRow, PlacedEvent, ToolRow, tool_json};
use feedwright_core::ids::{CycleId, MachineId, ToolId};
use feedwright_core::tool::{Tool, ToolEvent};
use feedwright_core::units::Timestamp;
use feedwright_core::wear::Verdict;
use serde_json::json;
use std::collections::BTreeMap;

macro_rules! select {
    ($tail:literal) => {
        concat!(
            "SELECT tool_id, name, serial, tool_type, diameter_mm, version, updated_at_us, row_sum, summed_version
             FROM tools ",
            $tail
        )
    };
}

pub(super) async fn get(conn: &mut Conn, id: &ToolId) -> StoreResult<Option<Versioned<Tool>>> {
    let row: Option<ToolRow> = sqlx::query_as::<Db, _>(select!("WHERE tool_id = $1"))
        .bind(id.as_str())
        .fetch_optional(&mut *conn)
        .await?;
    row.map(|row| row.versioned(dialect::WRITERS)).transpose()
}

pub(super) async fn list(conn: &mut Conn, page: &Page<ToolId>) -> StoreResult<Vec<Versioned<Tool>>> {
    let rows: Vec<ToolRow> = sqlx::query_as::<Db, _>(select!("WHERE tool_id > $1 ORDER BY tool_id LIMIT $2"))
        .bind(page.after.as_ref().map_or("", ToolId::as_str))
        .bind(i64::from(page.limit))
        .fetch_all(&mut *conn)
        .await?;
    rows.iter().map(|row| row.versioned(dialect::WRITERS)).collect()
}

/// A change by which the tool's cycles are judged anew.
pub(super) struct Judged<T> {
    pub(super) outcome: T,
    /// Whether they are so many that this is left to the background.
    pub(super) is_postponed: bool,
}

impl<T> Judged<T> {
    /// One that is done, or that changed nothing.
    const fn at_once(outcome: T) -> Self {
        Self { outcome, is_postponed: false }
    }

    /// One after which the verdict is this.
    fn by(verdict: &Verdict, outcome: T) -> Self {
        Self { outcome, is_postponed: verdict.is_being_counted() }
    }
}

pub(super) async fn put(
    conn: &mut Conn,
    tool: &Tool,
    expects: Precondition,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<Judged<PutOutcome>> {
    dialect::lock(conn, &Locks::tool(&tool.id)).await?;
    let found = get(conn, &tool.id).await;
    let existing = registry::existing(conn, found, ("tools", tool.id.as_str())).await?;
    let outcome = precondition::decide(existing.as_ref().map(|existing| existing.held(tool)), expects)?;
    if let PutOutcome::Unchanged(_) = outcome {
        return Ok(Judged::at_once(outcome));
    }
    let row = ToolRow::of(tool, outcome.version(), now)?;
    sqlx::query::<Db>(
        "INSERT INTO tools (tool_id, name, serial, tool_type, diameter_mm, version, updated_at_us, row_sum,
             summed_version)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)
         ON CONFLICT (tool_id) DO UPDATE SET name = excluded.name, serial = excluded.serial,
             tool_type = excluded.tool_type, diameter_mm = excluded.diameter_mm, version = excluded.version,
             updated_at_us = excluded.updated_at_us, row_sum = excluded.row_sum,
             summed_version = excluded.summed_version",
    )
    .bind(&row.tool_id)
    .bind(&tool.name)
    .bind(&row.serial)
    .bind(&row.tool_type)
    .bind(row.diameter_mm)
    .bind(row.version)
    .bind(row.updated_at_us)
    .bind(row.row_sum)
    .bind(row.summed_version)
    .execute(&mut *conn)
    .await?;
    let before = existing.and_then(|existing| existing.value).map(|before| tool_json(&before));
    let detail = audit::change(before.as_ref(), &tool_json(tool), outcome);
    audit::add(conn, actor, now, "tool.put", format!("tool/{}", tool.id), &detail).await?;
    if outcome == PutOutcome::Created {
        // Cycles that came before count from now on.
        let verdict = wear::count_all(conn, &tool.id, now, wear::Budget::at_once()).await?;
        alarms::follow_verdict(conn, &tool.id, &verdict, now).await?;
        return Ok(Judged::by(&verdict, outcome));
    }
    Ok(Judged::at_once(outcome))
}

macro_rules! select_events {
    ($tail:literal) => {
        concat!(
            "SELECT event_id, kind, at_us, first_machine_id, first_cycle_id, reason, actor, recorded_at_us,
                    revoked_at_us, revoked_by
             FROM tool_events ",
            $tail
        )
    };
}

/// All events of a tool that hold, where they take effect, in that order, and whether one names a cycle that is not stored.
pub(super) async fn placed_events(conn: &mut Conn, tool: &ToolId) -> StoreResult<(Vec<PlacedEvent>, bool)> {
    let rows: Vec<EventRow> =
        sqlx::query_as::<Db, _>(select_events!("WHERE tool_id = $1 AND revoked_at_us IS NULL"))
            .bind(tool.as_str())
            .fetch_all(&mut *conn)
            .await?;
    let naming = rows.iter().filter(|row| row.names_a_cycle()).count();
    let first = if naming > 0 { first_cycles(conn, tool).await? } else { BTreeMap::new() };
    let placed = rows.iter().map(|row| row.placed(first.get(&row.event_id).copied()));
    let mut events = placed.collect::<StoreResult<Vec<_>>>()?;
    events.sort();
    Ok((events, first.len() < naming))
}

/// Time and number of the cycles that events of a tool which hold name, by event. A named cycle counts only where the same tool ran
/// it: under another tool it is not one that the event covers. A statement of its own: events beside the cycles that some
/// of them name would be an outer join, for which a database of several nodes reads all that the tool ever ran.
async fn first_cycles(conn: &mut Conn, tool: &ToolId) -> StoreResult<BTreeMap<i64, (i64, Option<i64>)>> {
    let rows: Vec<(i64, i64, Option<i64>)> = sqlx::query_as::<Db, _>(
        "SELECT e.event_id, c.started_at_us, c.seq FROM tool_events e
         JOIN cycles c ON c.machine_id = e.first_machine_id AND c.cycle_id = e.first_cycle_id
             AND c.tool_id = e.tool_id
         WHERE e.tool_id = $1 AND e.revoked_at_us IS NULL",
    )
    .bind(tool.as_str())
    .fetch_all(&mut *conn)
    .await?;
    Ok(rows.into_iter().map(|(event, started, seq)| (event, (started, seq))).collect())
}

pub(super) async fn events(
    conn: &mut Conn,
    tool: &ToolId,
    page: &Page<RowNumber>,
) -> StoreResult<Vec<StoredToolEvent>> {
    let rows: Vec<EventRow> = sqlx::query_as::<Db, _>(select_events!(
        "WHERE tool_id = $1 AND event_id > $2 ORDER BY event_id LIMIT $3"
    ))
    .bind(tool.as_str())
    .bind(page.after.unwrap_or(i64::MIN))
    .bind(i64::from(page.limit))
    .fetch_all(&mut *conn)
    .await?;
    rows.iter().map(EventRow::stored).collect()
}

pub(super) async fn add_event(
    conn: &mut Conn,
    tool: &ToolId,
    event: ToolEvent,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<Judged<Option<StoredToolEvent>>> {
    dialect::lock(conn, &Locks::tool(tool)).await?;
    if get(conn, tool).await?.is_none() {
        return Ok(Judged::at_once(None));
    }
    let first = event.first_cycle.as_ref();
    let id: i64 = sqlx::query_scalar::<Db, _>(
        "INSERT INTO tool_events (tool_id, kind, at_us, first_machine_id, first_cycle_id, reason, actor,
             recorded_at_us)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8) RETURNING event_id",
    )
    .bind(tool.as_str())
    .bind(event.kind.as_str())
    .bind(event.at.micros())
    .bind(first.map(|(machine, _): &(MachineId, CycleId)| machine.as_str()))
    .bind(first.map(|(_, cycle)| cycle.as_str()))
    .bind(&event.reason)
    .bind(&actor.token)
    .bind(now.micros())
    .fetch_one(&mut *conn)
    .await?;
    let detail = json!({
        "event": id,
        "kind": event.kind.as_str(),
        "at_us": event.at.micros(),
        "first_cycle": first.map(|(machine, cycle)| json!([machine.as_str(), cycle.as_str()])),
        "reason": event.reason,
    });
    audit::add(conn, actor, now, "tool.event", format!("tool/{tool}"), &detail).await?;
    let verdict = wear::count_event(conn, tool, id, now).await?;
    alarms::follow_verdict(conn, tool, &verdict, now).await?;
    let stored = StoredToolEvent { id, event, actor: actor.token.clone(), recorded_at: now, revoked: None };
    Ok(Judged::by(&verdict, Some(stored)))
}

/// Revokes an event of a tool, and judges the tool as if it had not been told; `None` where the tool has no such event. One
/// that is revoked already stays as it is.
pub(super) async fn revoke_event(
    conn: &mut Conn,
    tool: &ToolId,
    event: RowNumber,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<Judged<Option<StoredToolEvent>>> {
    dialect::lock(conn, &Locks::tool(tool)).await?;
    let row: Option<EventRow> =
        sqlx::query_as::<Db, _>(select_events!("WHERE tool_id = $1 AND event_id = $2"))
            .bind(tool.as_str())
            .bind(event)
            .fetch_optional(&mut *conn)
            .await?;
    let Some(told) = row.map(|row| row.stored()).transpose()? else {
        return Ok(Judged::at_once(None));
    };
    if told.revoked.is_some() {
        return Ok(Judged::at_once(Some(told)));
    }
    let (before, _) = placed_events(conn, tool).await?;
    sqlx::query::<Db>("UPDATE tool_events SET revoked_at_us = $2, revoked_by = $3 WHERE event_id = $1")
        .bind(event)
        .bind(now.micros())
        .bind(&actor.token)
        .execute(&mut *conn)
        .await?;
    let detail = json!({"event": event, "kind": told.event.kind.as_str(), "at_us": told.event.at.micros()});
    audit::add(conn, actor, now, "tool.event_revoke", format!("tool/{tool}"), &detail).await?;
    let verdict = wear::count_without_event(conn, tool, (event, &before), now).await?;
    alarms::follow_verdict(conn, tool, &verdict, now).await?;
    let revoked = StoredToolEvent { revoked: Some((actor.token.clone(), now)), ..told };
    Ok(Judged::by(&verdict, Some(revoked)))
}

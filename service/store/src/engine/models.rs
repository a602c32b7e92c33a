//! The model library, and what an edge has cut.

use super::{Conn, Db, audit, dialect, operations, registry, tools};
use crate::error::StoreResult;
use crate::locks::Locks;
use crate::precondition;
use crate::record::{Actor, Model, ModelContent, ModelKind, Page, Precondition, PutOutcome, Versioned};
use crate::registry::Found;
use crate::rows::{CutRow, EdgeCycleRow, ModelRow, Place, content_json, count};
use feedwright_core::ids::{ModelId, ToolId};
use feedwright_core::operation::Operation;
use feedwright_core::recommend::{EdgeHistory, Knowledge, MAX_EDGE_CYCLES};
use feedwright_core::summary::EARLIEST_CLOCK;
use feedwright_core::units::Timestamp;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

macro_rules! select {
    ($tail:literal) => {
        concat!(
            "SELECT kind, model_id, body, version, updated_at_us, row_sum, summed_version FROM models ",
            $tail
        )
    };
}

pub(super) async fn get(
    conn: &mut Conn,
    kind: ModelKind,
    id: &ModelId,
) -> StoreResult<Option<Versioned<Model>>> {
    let row: Option<ModelRow> = sqlx::query_as::<Db, _>(select!("WHERE kind = $1 AND model_id = $2"))
        .bind(kind.as_str())
        .bind(id.as_str())
        .fetch_optional(&mut *conn)
        .await?;
    row.map(|row| row.versioned(dialect::WRITERS)).transpose()
}

pub(super) async fn list(
    conn: &mut Conn,
    kind: ModelKind,
    page: &Page<ModelId>,
) -> StoreResult<Vec<Versioned<Model>>> {
    let rows: Vec<ModelRow> =
        sqlx::query_as::<Db, _>(select!("WHERE kind = $1 AND model_id > $2 ORDER BY model_id LIMIT $3"))
            .bind(kind.as_str())
            .bind(page.after.as_ref().map_or("", ModelId::as_str))
            .bind(i64::from(page.limit))
            .fetch_all(&mut *conn)
            .await?;
    rows.iter().map(|row| row.versioned(dialect::WRITERS)).collect()
}

pub(super) async fn put(
    conn: &mut Conn,
    model: &Model,
    expects: Precondition,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<PutOutcome> {
    let kind = model.content.kind();
    let subject = format!("model/{}/{}", kind.as_str(), model.id);
    dialect::lock(conn, &Locks::subject("model", &subject)).await?;
    let named = match kind {
        ModelKind::Turning => "turning models",
        ModelKind::Plunge => "plunge models",
    };
    let found = get(conn, kind, &model.id).await;
    let existing = registry::existing(conn, found, (named, model.id.as_str())).await?;
    let outcome = precondition::decide(existing.as_ref().map(|existing| existing.held(model)), expects)?;
    if let PutOutcome::Unchanged(_) = outcome {
        return Ok(outcome);
    }
    let body = content_json(&model.content)?;
    let row = ModelRow::of(model, outcome.version(), now)?;
    sqlx::query::<Db>(
        "INSERT INTO models (kind, model_id, body, version, updated_at_us, row_sum, summed_version)
         VALUES ($1, $2, $3, $4, $5, $6, $7)
         ON CONFLICT (kind, model_id) DO UPDATE SET body = excluded.body, version = excluded.version,
             updated_at_us = excluded.updated_at_us, row_sum = excluded.row_sum,
             summed_version = excluded.summed_version",
    )
    .bind(&row.kind)
    .bind(&row.model_id)
    .bind(&row.body)
    .bind(row.version)
    .bind(row.updated_at_us)
    .bind(row.row_sum)
    .bind(row.summed_version)
    .execute(&mut *conn)
    .await?;
    let before = existing.and_then(|existing| existing.value);
    let before = before.map(|before| content_json(&before.content)).transpose()?;
    audit::add(conn, actor, now, "model.put", subject, &audit::change(before.as_ref(), &body, outcome))
        .await?;
    Ok(outcome)
}

/// Keeps what a control reported of a cut.
pub(super) async fn insert_cut(conn: &mut Conn, row: &CutRow) -> StoreResult<()> {
    sqlx::query::<Db>(
        "INSERT INTO cycle_cuts (machine_id, cycle_id, cutting_speed_m_min, feed_mm_rev, spindle_power_watts,
             thrust_newtons, edge_wear_mm)
         VALUES ($1, $2, $3, $4, $5, $6, $7)",
    )
    .bind(&row.machine_id)
    .bind(&row.cycle_id)
    .bind(row.cutting_speed_m_min)
    .bind(row.feed_mm_rev)
    .bind(row.spindle_power_watts)
    .bind(row.thrust_newtons)
    .bind(row.edge_wear_mm)
    .execute(&mut *conn)
    .await?;
    Ok(())
}

/// Whether the process of an operation needs anything of the library.
pub(super) fn are_needed(operation: &Operation) -> bool {
    operation.turning.is_some() || operation.plunge.is_some()
}

/// What the process of an operation needs to know, with this tool.
pub(super) async fn knowledge(
    conn: &mut Conn,
    operation: Option<&Operation>,
    tool: &ToolId,
) -> StoreResult<Knowledge> {
    let Some(operation) = operation else {
        return Ok(Knowledge::None);
    };
    if let Some(setup) = &operation.turning {
        let model = match registry::to_decide_by(get(conn, ModelKind::Turning, &setup.model).await)? {
            Found::Damaged(_) => return Ok(Knowledge::Damaged),
            Found::Absent => None,
            Found::Sound(found) => match found.value.content {
                ModelContent::Turning(model) => Some(Box::new(model)),
                ModelContent::Plunge(_) => None,
            },
        };
        return Ok(Knowledge::Turning { model, history: history(conn, tool).await? });
    }
    if let Some(setup) = &operation.plunge {
        let material = match registry::to_decide_by(get(conn, ModelKind::Plunge, &setup.material).await)? {
            Found::Damaged(_) => return Ok(Knowledge::Damaged),
            Found::Absent => None,
            Found::Sound(found) => match found.value.content {
                ModelContent::Plunge(material) => Some(Box::new(material)),
                ModelContent::Turning(_) => None,
            },
        };
        return Ok(Knowledge::Plunge(material));
    }
    Ok(Knowledge::None)
}

/// Everything a tool has cut since it was last new, in the order of the fold.
async fn history(conn: &mut Conn, tool: &ToolId) -> StoreResult<EdgeHistory> {
    let (events, _) = tools::placed_events(conn, tool).await?;
    let begun = events.iter().rev().find(|event| event.kind.begins_life());
    let Some(begun) = begun.filter(|event| event.kind.starts_unworn()) else {
        return Ok(EdgeHistory::NotNew);
    };
    let Place { at, cycle } = &begun.place;
    let (machine, seq, id) = match cycle {
        None => ("", i64::MIN, ""),
        Some((machine, seq, cycle)) => {
            (machine.as_str(), seq.map_or(Ok(-1), |seq| count("seq", seq))?, cycle.as_str())
        }
    };
    if came_untimed(conn, tool, *at).await? {
        return Ok(EdgeHistory::Untimed);
    }
    let rows: Vec<EdgeCycleRow> = sqlx::query_as::<Db, _>(
        "SELECT c.operation_id, o.setup, o.updated_at_us AS setup_since_us, c.started_at_us, c.duration_ms,
                c.reported_duration_ms, c.sample_count, c.coverage, c.flags, k.cutting_speed_m_min,
                COALESCE(c.median_spindle_speed_rpm, c.spindle_speed_rpm) AS spindle_rpm, k.feed_mm_rev,
                k.spindle_power_watts, c.measured_power_spindle_joules AS spindle_joules,
                COALESCE(k.thrust_newtons, c.max_thrust_newtons) AS force_newtons, k.edge_wear_mm
         FROM cycles c
         LEFT JOIN cycle_cuts k ON k.machine_id = c.machine_id AND k.cycle_id = c.cycle_id
         LEFT JOIN operations o ON o.operation_id = c.operation_id
         WHERE c.tool_id = $1 AND c.started_at_us >= $2
           AND (c.started_at_us, c.machine_id, COALESCE(c.seq, -1), c.cycle_id) >= ($2, $3, $4, $5)
         ORDER BY c.started_at_us, c.machine_id, COALESCE(c.seq, -1), c.cycle_id LIMIT $6",
    )
    .bind(tool.as_str())
    .bind(at.micros())
    .bind(machine)
    .bind(seq)
    .bind(id)
    // One more than is looked at tells that there are more.
    .bind(count("limit", MAX_EDGE_CYCLES as u64 + 1)?)
    .fetch_all(&mut *conn)
    .await?;
    if rows.len() > MAX_EDGE_CYCLES {
        return Ok(EdgeHistory::TooLong);
    }
    let mut stated = BTreeMap::new();
    for row in &rows {
        if let (Entry::Vacant(unknown), Some(since)) = (stated.entry(&row.operation_id), row.setup_since_us) {
            let (setup, since) = (row.setup.as_deref(), Timestamp::from_micros(since));
            unknown.insert(operations::turnings_until_now(conn, &row.operation_id, setup, since).await?);
        }
    }
    let cycle = |row: &EdgeCycleRow| row.cycle(stated.get(&row.operation_id).map_or(&[], Vec::as_slice));
    rows.iter().map(cycle).collect::<StoreResult<_>>().map(EdgeHistory::Cycles)
}

/// Whether cycles of a tool whose clock was never set have come since its edge was new. By their own time they stand before every
/// edge that is told of, so that none would count them.
async fn came_untimed(conn: &mut Conn, tool: &ToolId, new_at: Timestamp) -> StoreResult<bool> {
    let found: Option<i64> = sqlx::query_scalar::<Db, _>(
        "SELECT CAST(1 AS BIGINT) FROM cycles
         WHERE tool_id = $1 AND started_at_us < $2 AND received_at_us >= $3 LIMIT 1",
    )
    .bind(tool.as_str())
    .bind(EARLIEST_CLOCK.micros())
    .bind(new_at.micros())
    .fetch_optional(&mut *conn)
    .await?;
    Ok(found.is_some())
}

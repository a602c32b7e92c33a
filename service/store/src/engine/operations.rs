//! Operations.

use super::{Conn, Db, audit, dialect, registry};
use crate::error::{StoreError, StoreResult};
use crate::locks::Locks;
use crate::precondition;
use crate::record::{Actor, Page, Precondition, PutOutcome, Versioned};
use crate::rows::{OperationRow, TurnedAs, operation_json, optional_float, setup_json, setup_of};
use feedwright_core::ids::OperationId;
use feedwright_core::operation::{Ask, DatedOperation, Operation};
use feedwright_core::units::Timestamp;
use std::collections::BTreeMap;

/// From when on what was asked for first holds: before every cycle. Migration 31 has it too.
const ALWAYS: Timestamp = Timestamp::from_micros(-9_000_000_000_000_000_000);

macro_rules! select {
    ($tail:literal) => {
        concat!(
            "SELECT operation_id, name, process, program, feature, work_material, thickness_mm, depth_mm,
                    spindle_speed_rpm, programmed_feed_mm_min, spindle_load_set_percent,
                    feed_drive_load_set_percent, baseline_cycles, window_cycles, reference_every_cycles,
                    reference_feed_mm_min, setup, version, updated_at_us, row_sum, summed_version
             FROM operations ",
            $tail
        )
    };
}

pub(super) async fn get(conn: &mut Conn, id: &OperationId) -> StoreResult<Option<Versioned<Operation>>> {
    let row: Option<OperationRow> = sqlx::query_as::<Db, _>(select!("WHERE operation_id = $1"))
        .bind(id.as_str())
        .fetch_optional(&mut *conn)
        .await?;
    row.map(|row| row.versioned(dialect::WRITERS)).transpose()
}

/// With what it has asked for over time.
pub(super) async fn dated(
    conn: &mut Conn,
    id: &OperationId,
) -> StoreResult<Option<Versioned<DatedOperation>>> {
    let found = get(conn, id).await?;
    with_asks(conn, found).await
}

/// What folds go by of an operation whose row does not decode, but for that: a cycle is counted by what its fold is made of when it is
/// folded again. `None` where that does not decode.
pub(super) async fn as_folds_read_it(
    conn: &mut Conn,
    id: &OperationId,
) -> StoreResult<Option<DatedOperation>> {
    let row = sqlx::query_as::<Db, OperationRow>(
        "SELECT operation_id, '' AS name, process, CAST(NULL AS TEXT) AS program, CAST(NULL AS TEXT) AS feature,
                CAST(NULL AS TEXT) AS work_material, thickness_mm, depth_mm, spindle_speed_rpm, programmed_feed_mm_min,
                spindle_load_set_percent, feed_drive_load_set_percent, baseline_cycles, window_cycles,
                reference_every_cycles, reference_feed_mm_min, CAST(NULL AS TEXT) AS setup, version, updated_at_us,
                row_sum, summed_version
         FROM operations WHERE operation_id = $1",
    )
    .bind(id.as_str())
    .fetch_optional(&mut *conn)
    .await;
    let row = row.map_err(StoreError::from);
    let found = match row.and_then(|row| row.map(|row| row.versioned(dialect::WRITERS)).transpose()) {
        Ok(found) => with_asks(conn, found).await,
        Err(error) => Err(error),
    };
    match found {
        Err(StoreError::Damaged { .. }) => Ok(None),
        found => Ok(found?.map(|found| found.value)),
    }
}

async fn with_asks(
    conn: &mut Conn,
    found: Option<Versioned<Operation>>,
) -> StoreResult<Option<Versioned<DatedOperation>>> {
    let Some(found) = found else { return Ok(None) };
    let (operation, from) = (&found.value, found.updated_at);
    let now = Ask { from, depth_mm: operation.depth_mm, spindle_speed_rpm: operation.spindle_speed_rpm };
    let asks = up_to(asks(conn, operation.id.as_str()).await?, now);
    Ok(Some(Versioned {
        version: found.version,
        updated_at: found.updated_at,
        is_damaged: found.is_damaged,
        value: DatedOperation::new(found.value, asks),
    }))
}

fn is_same(one: &Ask, other: &Ask) -> bool {
    (one.depth_mm, one.spindle_speed_rpm) == (other.depth_mm, other.spindle_speed_rpm)
}

/// What an operation has asked for, in the order of time, up to what it asks for now; nothing where it is not registered.
pub(super) async fn asks_until_now(conn: &mut Conn, id: &str) -> StoreResult<Vec<Ask>> {
    let asks = asks(conn, id).await?;
    let now: Option<(i64, Option<f64>, Option<f64>)> = sqlx::query_as::<Db, _>(
        "SELECT updated_at_us, depth_mm, spindle_speed_rpm FROM operations WHERE operation_id = $1",
    )
    .bind(id)
    .fetch_optional(&mut *conn)
    .await?;
    Ok(match now {
        Some(now) => up_to(asks, ask(now)),
        None => asks,
    })
}

/// With what is asked for now: a server of before changes an operation without noting it.
fn up_to(mut asks: Vec<Ask>, now: Ask) -> Vec<Ask> {
    if asks.last().is_none_or(|last| !is_same(last, &now)) {
        asks.push(now);
    }
    asks
}

fn ask((from, depth_mm, spindle_speed_rpm): (i64, Option<f64>, Option<f64>)) -> Ask {
    Ask { from: Timestamp::from_micros(from), depth_mm, spindle_speed_rpm }
}

/// What is noted of what an operation has asked for.
async fn asks(conn: &mut Conn, id: &str) -> StoreResult<Vec<Ask>> {
    let rows: Vec<(i64, Option<f64>, Option<f64>)> = sqlx::query_as::<Db, _>(
        "SELECT from_us, depth_mm, spindle_speed_rpm FROM operation_asks WHERE operation_id = $1 ORDER BY from_us",
    )
    .bind(id)
    .fetch_all(&mut *conn)
    .await?;
    Ok(rows.into_iter().map(ask).collect())
}

/// When what is noted now begins to hold: what is noted first holds for what came before as well. Clocks of several servers are apart,
/// and are set back: what is noted later holds later.
fn noted_from(last: Option<Timestamp>, now: Timestamp) -> Timestamp {
    last.map_or(ALWAYS, |last| now.max(Timestamp::from_micros(last.micros() + 1)))
}

/// Notes what an operation asks for from now on; what it asks for first holds for what came before as well.
async fn note_asks(conn: &mut Conn, operation: &Operation, now: Timestamp) -> StoreResult<()> {
    let known = asks(conn, operation.id.as_str()).await?;
    let from = noted_from(known.last().map(|last| last.from), now);
    let ask = Ask { from, depth_mm: operation.depth_mm, spindle_speed_rpm: operation.spindle_speed_rpm };
    if known.last().is_some_and(|last| is_same(last, &ask)) {
        return Ok(());
    }
    sqlx::query::<Db>(
        "INSERT INTO operation_asks (operation_id, from_us, depth_mm, spindle_speed_rpm) VALUES ($1, $2, $3, $4)",
    )
    .bind(operation.id.as_str())
    .bind(ask.from.micros())
    .bind(optional_float("depth_mm", ask.depth_mm)?)
    .bind(optional_float("spindle_speed_rpm", ask.spindle_speed_rpm)?)
    .execute(&mut *conn)
    .await?;
    Ok(())
}

/// Depths and diameters that an operation's turning is noted to have stated, in the order of time.
async fn noted_turnings(conn: &mut Conn, id: &str) -> StoreResult<Vec<TurnedAs>> {
    let rows: Vec<(i64, String)> = sqlx::query_as::<Db, _>(
        "SELECT from_us, setup FROM operation_setups WHERE operation_id = $1 ORDER BY from_us",
    )
    .bind(id)
    .fetch_all(&mut *conn)
    .await?;
    let mut stated = Vec::with_capacity(rows.len());
    for (from, setup) in rows {
        let turning = setup_of(Some(&setup))?.0;
        stated.extend(turning.map(|setup| TurnedAs::of(&setup, Timestamp::from_micros(from))));
    }
    Ok(stated)
}

/// Depths and diameters that an operation's turning has stated, in the order of time, up to what `setup` states since a time: a
/// server of before changes an operation without noting it.
pub(super) async fn turnings_until_now(
    conn: &mut Conn,
    id: &str,
    setup: Option<&str>,
    since: Timestamp,
) -> StoreResult<Vec<TurnedAs>> {
    let mut stated = noted_turnings(conn, id).await?;
    if let Some(now) = setup_of(setup)?.0.map(|setup| TurnedAs::of(&setup, since))
        && stated.last().is_none_or(|last| !last.is_as(&now))
    {
        stated.push(now);
    }
    Ok(stated)
}

/// Notes how an operation is turned from now on, where it is; what it states first holds for what came before as well.
async fn note_turning(conn: &mut Conn, operation: &Operation, now: Timestamp) -> StoreResult<()> {
    let Some(setup) = &operation.turning else { return Ok(()) };
    let known = noted_turnings(conn, operation.id.as_str()).await?;
    let from = noted_from(known.last().map(|last| last.from), now);
    let turned = TurnedAs::of(setup, from);
    if known.last().is_some_and(|last| last.is_as(&turned)) {
        return Ok(());
    }
    let setup = setup_json(operation.turning.as_ref(), None)?;
    // What stands there already is of another process, of which nothing was turned.
    sqlx::query::<Db>(
        "INSERT INTO operation_setups (operation_id, from_us, setup) VALUES ($1, $2, $3)
         ON CONFLICT (operation_id, from_us) DO UPDATE SET setup = excluded.setup",
    )
    .bind(operation.id.as_str())
    .bind(from.micros())
    .bind(setup.map(|setup| setup.to_string()))
    .execute(&mut *conn)
    .await?;
    Ok(())
}

pub(super) async fn list(
    conn: &mut Conn,
    page: &Page<OperationId>,
) -> StoreResult<Vec<Versioned<Operation>>> {
    let rows: Vec<OperationRow> =
        sqlx::query_as::<Db, _>(select!("WHERE operation_id > $1 ORDER BY operation_id LIMIT $2"))
            .bind(page.after.as_ref().map_or("", OperationId::as_str))
            .bind(i64::from(page.limit))
            .fetch_all(&mut *conn)
            .await?;
    rows.iter().map(|row| row.versioned(dialect::WRITERS)).collect()
}

/// Whether the fold judges cycles of the two alike: what a `FoldSettings` takes out of an operation.
fn judged_alike(before: Option<&Operation>, after: &Operation) -> bool {
    before.is_some_and(|before| {
        before.wear == after.wear
            && before.depth_mm == after.depth_mm
            && before.spindle_speed_rpm == after.spindle_speed_rpm
            && before.process == after.process
            && before.reference_feed_mm_min() == after.reference_feed_mm_min()
    })
}

/// Number of the last change of any operation after which cycles are judged otherwise than before; 0 before the first.
pub(super) async fn last_judging_change(conn: &mut Conn) -> StoreResult<i64> {
    Ok(sqlx::query_scalar::<Db, _>(
        "SELECT CAST(COALESCE(MAX(judging_change), 0) AS BIGINT) FROM operations WHERE judging_change > 0",
    )
    .fetch_one(&mut *conn)
    .await?)
}

/// Operations whose last such change comes after one of a number, each with its own; nothing is asked where that is the last one.
pub(super) async fn changed_since(
    conn: &mut Conn,
    since: i64,
    last: i64,
) -> StoreResult<BTreeMap<String, i64>> {
    if since >= last {
        return Ok(BTreeMap::new());
    }
    let rows: Vec<(String, i64)> = sqlx::query_as::<Db, _>(
        "SELECT operation_id, judging_change FROM operations WHERE judging_change > 0 AND judging_change > $1",
    )
    .bind(since)
    .fetch_all(&mut *conn)
    .await?;
    Ok(rows.into_iter().collect())
}

/// Numbers a change after which the operation's cycles are judged otherwise, where it has any: folds that were made before go along
/// with it when they are loaded next. Whether it has any nobody changes meanwhile, as the operation's name is locked.
async fn number_change(conn: &mut Conn, id: &OperationId) -> StoreResult<bool> {
    let ran: Option<i64> =
        sqlx::query_scalar::<Db, _>("SELECT CAST(1 AS BIGINT) FROM cycles WHERE operation_id = $1 LIMIT 1")
            .bind(id.as_str())
            .fetch_optional(&mut *conn)
            .await?;
    if ran.is_none() {
        return Ok(false);
    }
    // One after the other until they are committed: who has seen a number has seen those before it.
    dialect::lock(conn, &Locks::subject("judging_change", "")).await?;
    let last = last_judging_change(conn).await?;
    sqlx::query::<Db>("UPDATE operations SET judging_change = $2 WHERE operation_id = $1")
        .bind(id.as_str())
        .bind(last + 1)
        .execute(&mut *conn)
        .await?;
    Ok(true)
}

/// What putting an operation came to.
pub(super) struct OperationPut {
    pub(super) outcome: PutOutcome,
    /// Whether cycles that it has are judged otherwise from now on.
    pub(super) judged_otherwise: bool,
}

pub(super) async fn put(
    conn: &mut Conn,
    operation: &Operation,
    expects: Precondition,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<OperationPut> {
    dialect::lock(conn, &Locks::operation(&operation.id)).await?;
    let named = ("operations", operation.id.as_str());
    let found = get(conn, &operation.id).await;
    let existing = registry::existing(conn, found, named).await?;
    let outcome = precondition::decide(existing.as_ref().map(|existing| existing.held(operation)), expects)?;
    if let PutOutcome::Unchanged(_) = outcome {
        return Ok(OperationPut { outcome, judged_otherwise: false });
    }
    let setup = setup_json(operation.turning.as_ref(), operation.plunge.as_ref())?;
    let row = OperationRow::of(operation, outcome.version(), now)?;
    sqlx::query::<Db>(
        "INSERT INTO operations (operation_id, name, process, program, feature, work_material, thickness_mm,
             depth_mm, spindle_speed_rpm, programmed_feed_mm_min, spindle_load_set_percent,
             feed_drive_load_set_percent, baseline_cycles, window_cycles, setup, version, updated_at_us,
             reference_every_cycles, reference_feed_mm_min, row_sum, summed_version)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16, $17, $18, $19, $20, $21)
         ON CONFLICT (operation_id) DO UPDATE SET name = excluded.name, process = excluded.process,
             program = excluded.program, feature = excluded.feature, work_material = excluded.work_material,
             thickness_mm = excluded.thickness_mm, depth_mm = excluded.depth_mm,
             spindle_speed_rpm = excluded.spindle_speed_rpm,
             programmed_feed_mm_min = excluded.programmed_feed_mm_min,
             spindle_load_set_percent = excluded.spindle_load_set_percent,
             feed_drive_load_set_percent = excluded.feed_drive_load_set_percent,
             baseline_cycles = excluded.baseline_cycles, window_cycles = excluded.window_cycles,
             reference_every_cycles = excluded.reference_every_cycles,
             reference_feed_mm_min = excluded.reference_feed_mm_min, setup = excluded.setup,
             version = excluded.version, updated_at_us = excluded.updated_at_us,
             row_sum = excluded.row_sum, summed_version = excluded.summed_version",
    )
    .bind(&row.operation_id)
    .bind(&operation.name)
    .bind(&row.process)
    .bind(&row.program)
    .bind(&row.feature)
    .bind(&row.work_material)
    .bind(row.thickness_mm)
    .bind(row.depth_mm)
    .bind(row.spindle_speed_rpm)
    .bind(row.programmed_feed_mm_min)
    .bind(row.spindle_load_set_percent)
    .bind(row.feed_drive_load_set_percent)
    .bind(row.baseline_cycles)
    .bind(row.window_cycles)
    .bind(&row.setup)
    .bind(row.version)
    .bind(row.updated_at_us)
    .bind(row.reference_every_cycles)
    .bind(row.reference_feed_mm_min)
    .bind(row.row_sum)
    .bind(row.summed_version)
    .execute(&mut *conn)
    .await?;
    let before = match existing.as_ref().and_then(|existing| existing.value.as_ref()) {
        None => None,
        Some(known) => {
            let setup = setup_json(known.turning.as_ref(), known.plunge.as_ref())?;
            Some(operation_json(known, setup.as_ref()))
        }
    };
    let detail = audit::change(before.as_ref(), &operation_json(operation, setup.as_ref()), outcome);
    audit::add(conn, actor, now, "operation.put", format!("operation/{}", operation.id), &detail).await?;
    // What stands here so far may be from a server of before, which notes nothing. What is damaged nobody asked for.
    let sound = existing.as_ref().filter(|existing| !existing.is_damaged);
    if let Some((value, updated_at)) =
        sound.and_then(|existing| existing.value.as_ref().zip(existing.updated_at))
    {
        let since = updated_at.min(now);
        note_asks(conn, value, since).await?;
        note_turning(conn, value, since).await?;
    }
    note_asks(conn, operation, now).await?;
    note_turning(conn, operation, now).await?;
    // Folds of meanwhile went by what was damaged.
    let known = sound.and_then(|existing| existing.value.as_ref());
    let judged_otherwise = !judged_alike(known, operation) && number_change(conn, &operation.id).await?;
    Ok(OperationPut { outcome, judged_otherwise })
}

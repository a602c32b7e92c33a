//! How long samples are kept. A decision is a row with an audit line; what it names goes afterwards, in small steps.

pub(super) mod gone;

use super::{CLOCK_AHEAD_US, Conn, Db, audit, dialect, machines};
use crate::error::{StoreError, StoreResult};
use crate::locks::Locks;
use crate::past;
use crate::precondition;
use crate::record::{
    Actor, DropReason, Dropped, Precondition, PutOutcome, Role, SampleDrop, SampleRetention, Versioned,
};
use crate::rows::{count, number, word};
use feedwright_core::ids::MachineId;
use feedwright_core::units::Timestamp;
use serde_json::json;
use std::time::Duration;

const DAY_US: i64 = 86_400_000_000;
/// So many times as fast as time goes by samples age at the most: one that runs for three hours a day keeps up.
const AGES_FASTER: i64 = 8;
/// Rows that are looked at a time when sizes are added up.
const SIZES_PAGE: i64 = 2_000;
/// So often in a row a decision is looked for that another server moves.
const MOST_MOVES: usize = 10;
/// Decisions of one machine that are read: 27 years of one a day.
const MOST_DROPS: i64 = 10_000;

#[derive(sqlx::FromRow)]
struct RetentionRow {
    samples_days: Option<i64>,
    samples_bytes: Option<i64>,
    version: i64,
    updated_at_us: i64,
}

pub(super) async fn get(
    conn: &mut Conn,
    machine: &MachineId,
) -> StoreResult<Option<Versioned<SampleRetention>>> {
    let row: Option<RetentionRow> = sqlx::query_as::<Db, _>(
        "SELECT samples_days, samples_bytes, version, updated_at_us FROM retention WHERE machine_id = $1",
    )
    .bind(machine.as_str())
    .fetch_optional(&mut *conn)
    .await?;
    row.map(|row| {
        Ok(Versioned {
            value: SampleRetention {
                days: row.samples_days.map(|days| number("samples_days", days)).transpose()?,
                bytes: row.samples_bytes.map(|bytes| number("samples_bytes", bytes)).transpose()?,
            },
            version: number("version", row.version)?,
            updated_at: Timestamp::from_micros(row.updated_at_us),
            is_damaged: false,
        })
    })
    .transpose()
}

/// Sets how long a machine's samples are kept; `None` where it is not registered.
pub(super) async fn put(
    conn: &mut Conn,
    machine: &MachineId,
    retention: SampleRetention,
    expects: Precondition,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<Option<PutOutcome>> {
    dialect::lock(conn, &Locks::subject("machine", machine.as_str())).await?;
    if machines::get(conn, machine).await?.is_none() {
        return Ok(None);
    }
    let existing = get(conn, machine).await?;
    let known = existing.as_ref().map(|existing| (existing.version, existing.value == retention));
    let outcome = precondition::decide(known, expects)?;
    if let PutOutcome::Unchanged(_) = outcome {
        return Ok(Some(outcome));
    }
    sqlx::query::<Db>(
        "INSERT INTO retention (machine_id, samples_days, samples_bytes, version, updated_at_us)
         VALUES ($1, $2, $3, $4, $5)
         ON CONFLICT (machine_id) DO UPDATE SET samples_days = excluded.samples_days,
             samples_bytes = excluded.samples_bytes, version = excluded.version,
             updated_at_us = excluded.updated_at_us",
    )
    .bind(machine.as_str())
    .bind(retention.days.map(i64::from))
    .bind(retention.bytes.map(|bytes| count("samples_bytes", bytes)).transpose()?)
    .bind(count("version", outcome.version())?)
    .bind(now.micros())
    .execute(&mut *conn)
    .await?;
    let text = |of: SampleRetention| json!({"samples_days": of.days, "samples_bytes": of.bytes});
    let before = existing.map(|existing| text(existing.value));
    let detail = audit::change(before.as_ref(), &text(retention), outcome);
    audit::add(conn, actor, now, "retention.put", format!("machine/{machine}/retention"), &detail).await?;
    Ok(Some(outcome))
}

#[derive(sqlx::FromRow)]
struct DropRow {
    before_us: i64,
    dropped_at_us: i64,
    reason: String,
    cycles: i64,
    bytes: i64,
}

/// The newest decisions on a machine's samples, oldest of them first.
pub(super) async fn drops(conn: &mut Conn, machine: &MachineId) -> StoreResult<Vec<SampleDrop>> {
    let rows: Vec<DropRow> = sqlx::query_as::<Db, _>(
        "SELECT before_us, dropped_at_us, reason, cycles, bytes FROM sample_drops WHERE machine_id = $1
         ORDER BY before_us DESC LIMIT $2",
    )
    .bind(machine.as_str())
    .bind(MOST_DROPS)
    .fetch_all(&mut *conn)
    .await?;
    let drop = |row: &DropRow| {
        Ok(SampleDrop {
            machine: machine.clone(),
            before: Timestamp::from_micros(row.before_us),
            dropped_at: Timestamp::from_micros(row.dropped_at_us),
            reason: word("reason", &row.reason, DropReason::parse)?,
            cycles: number("cycles", row.cycles)?,
            bytes: number("bytes", row.bytes)?,
        })
    };
    rows.iter().rev().map(drop).collect()
}

/// Everything of a machine that was received before this is dropped already.
async fn dropped_before(conn: &mut Conn, machine: &str) -> StoreResult<i64> {
    let before: Option<i64> =
        sqlx::query_scalar::<Db, _>("SELECT MAX(before_us) FROM sample_drops WHERE machine_id = $1")
            .bind(machine)
            .fetch_one(&mut *conn)
            .await?;
    Ok(before.unwrap_or(i64::MIN))
}

/// Up to when samples have aged, as far as that is kept; else when the last machine was heard of, or now.
pub(super) async fn aged_to(conn: &mut Conn, now: Timestamp) -> StoreResult<Timestamp> {
    let aged_to: Option<i64> = sqlx::query_scalar::<Db, _>(
        "SELECT COALESCE((SELECT aged_to_us FROM retention_clock), (SELECT MAX(last_cycle_at_us) FROM machine_contacts))",
    )
    .fetch_one(&mut *conn)
    .await?;
    Ok(aged_to.map_or(now, Timestamp::from_micros))
}

/// Lets samples age up to now, or as far as they may when so much has `gone_by`; says up to when they have.
///
/// A clock that leaps ahead would drop within the hour what is kept by days. What lies behind a leap is caught up with, as it may also be a time in
/// which no server ran.
pub(super) async fn age(conn: &mut Conn, now: Timestamp, gone_by: Duration) -> StoreResult<Timestamp> {
    dialect::lock(conn, &Locks::subject("retention_clock", "")).await?;
    let before = aged_to(conn, now).await?.micros();
    let by = i64::try_from(gone_by.as_micros()).unwrap_or(i64::MAX).saturating_mul(AGES_FASTER);
    let aged_to = before.saturating_add(by).min(now.micros());
    // A clock that is not set yet, as of a computer that has just started, is nothing to go on from.
    if aged_to >= before && past::may_be_right(now) {
        sqlx::query::<Db>(
            "INSERT INTO retention_clock (only_row, aged_to_us) VALUES (1, $1)
             ON CONFLICT (only_row) DO UPDATE SET aged_to_us = excluded.aged_to_us",
        )
        .bind(aged_to)
        .execute(&mut *conn)
        .await?;
    }
    Ok(Timestamp::from_micros(aged_to))
}

/// Up to where a machine's samples are to go, and why, where anything is to go: by age those that are too old at `aged_to`.
pub(super) async fn horizon(
    conn: &mut Conn,
    machine: &MachineId,
    retention: SampleRetention,
    (now, aged_to): (Timestamp, Timestamp),
) -> StoreResult<Option<(i64, DropReason)>> {
    let mut horizon = None;
    if let Some(days) = retention.days {
        let age = aged_to.micros().saturating_sub(DAY_US.saturating_mul(i64::from(days)));
        horizon = Some((dialect::age_horizon(conn, age).await?, DropReason::Age));
    }
    if let Some(most) = retention.bytes
        && let Some(size) = size_horizon(conn, machine, most, now).await?
        && horizon.is_none_or(|(age, _)| size > age)
    {
        horizon = Some((size, DropReason::Size));
    }
    let Some((before, reason)) = horizon else { return Ok(None) };
    if before <= dropped_before(conn, machine.as_str()).await? {
        return Ok(None);
    }
    let any: Option<i64> = sqlx::query_scalar::<Db, _>(
        "SELECT received_at_us FROM cycle_samples WHERE machine_id = $1 AND received_at_us < $2
         ORDER BY received_at_us LIMIT 1",
    )
    .bind(machine.as_str())
    .bind(before)
    .fetch_optional(&mut *conn)
    .await?;
    Ok(any.map(|_| (before, reason)))
}

/// Adds up sizes from the newest cycle on; what was received before the answer no longer fits. What a clock that was ahead
/// received later than now is left out: it would take the place of all that comes until then, and be the answer. Servers are
/// apart by minutes: what lies ahead by so little counts, and as long as any does, nothing that came in as many minutes goes, as it
/// may be newer than that.
async fn size_horizon(
    conn: &mut Conn,
    machine: &MachineId,
    most: u64,
    now: Timestamp,
) -> StoreResult<Option<i64>> {
    let newest = now.micros().saturating_add(CLOCK_AHEAD_US);
    let (mut at, mut cycle, mut sum) = (newest, String::new(), 0_u64);
    let mut no_later = None;
    loop {
        let page: Vec<(i64, String, i64)> = sqlx::query_as::<Db, _>(concat!(
            "SELECT received_at_us, cycle_id, ",
            dialect::block_bytes!(),
            " FROM cycle_samples
             WHERE machine_id = $1 AND received_at_us <= $2 AND (received_at_us, cycle_id) < ($2, $3)
             ORDER BY received_at_us DESC, cycle_id DESC LIMIT $4",
        ))
        .bind(machine.as_str())
        .bind(at)
        .bind(&cycle)
        .bind(SIZES_PAGE)
        .fetch_all(&mut *conn)
        .await?;
        for (received, _, length) in &page {
            let no_later = *no_later.get_or_insert_with(|| {
                let is_ahead = *received > now.micros();
                if is_ahead { now.micros().saturating_sub(CLOCK_AHEAD_US) } else { i64::MAX }
            });
            sum = sum.saturating_add(number("length", *length)?);
            if sum > most {
                return Ok(Some(received.saturating_add(1).min(no_later)));
            }
        }
        let Some(last) = page.last() else { return Ok(None) };
        (at, cycle) = (last.0, last.1.clone());
    }
}

/// Keeps a decision by the version of what was `said` of the machine, with its audit line. `None` where another server was
/// faster, or something else was said meanwhile: what was answered by then holds, and the next run goes by it.
pub(super) async fn decide(
    conn: &mut Conn,
    machine: &MachineId,
    (before, reason): (i64, DropReason),
    said: Option<u64>,
    now: Timestamp,
) -> StoreResult<Option<SampleDrop>> {
    dialect::lock(conn, &Locks::subject("retention", machine.as_str())).await?;
    // Last: posts of the machine wait for whoever has it.
    dialect::lock(conn, &Locks::subject("machine", machine.as_str())).await?;
    if get(conn, machine).await?.map(|said| said.version) != said {
        return Ok(None);
    }
    if before <= dropped_before(conn, machine.as_str()).await? {
        return Ok(None);
    }
    let today = now.micros().div_euclid(DAY_US) * DAY_US;
    let moved = sqlx::query::<Db>(
        "UPDATE sample_drops SET before_us = $2, dropped_at_us = $3
         WHERE machine_id = $1 AND reason = $4 AND dropped_at_us >= $5
           AND before_us = (SELECT MAX(before_us) FROM sample_drops WHERE machine_id = $1)",
    )
    .bind(machine.as_str())
    .bind(before)
    .bind(now.micros())
    .bind(reason.as_str())
    .bind(today)
    .execute(&mut *conn)
    .await?;
    if moved.rows_affected() == 0 {
        sqlx::query::<Db>(
            "INSERT INTO sample_drops (machine_id, before_us, dropped_at_us, reason, cycles, bytes)
             VALUES ($1, $2, $3, $4, 0, 0)",
        )
        .bind(machine.as_str())
        .bind(before)
        .bind(now.micros())
        .bind(reason.as_str())
        .execute(&mut *conn)
        .await?;
    }
    let actor = Actor { token: "retention".to_owned(), role: Role::Admin };
    let detail = json!({"received_before_us": before, "reason": reason.as_str()});
    audit::add(conn, &actor, now, "samples.drop", format!("machine/{machine}/samples"), &detail).await?;
    Ok(Some(SampleDrop {
        machine: machine.clone(),
        before: Timestamp::from_micros(before),
        dropped_at: now,
        reason,
        cycles: 0,
        bytes: 0,
    }))
}

/// Deletes the next few samples of a machine that its decisions name; says how many. There may be more.
pub(super) async fn delete_some(conn: &mut Conn, machine: &str, most: u32) -> StoreResult<Dropped> {
    // Whoever drops a partition has locked that, and asks for the table; this asks for the table, and then for its partitions.
    dialect::lock(conn, &Locks::subject("partitions", "")).await?;
    dialect::lock(conn, &Locks::subject("retention", machine)).await?;
    // Read under the lock: what stood before it may have been taken back by whoever had it.
    let before = dropped_before(conn, machine).await?;
    let lengths: Vec<i64> = sqlx::query_scalar::<Db, _>(concat!(
        "DELETE FROM cycle_samples WHERE machine_id = $1 AND (machine_id, received_at_us, cycle_id) IN (
             SELECT machine_id, received_at_us, cycle_id FROM cycle_samples
             WHERE machine_id = $1 AND received_at_us < $2 ORDER BY received_at_us, cycle_id LIMIT $3)
         RETURNING ",
        dialect::block_bytes!(),
    ))
    .bind(machine)
    .bind(before)
    .bind(i64::from(most))
    .fetch_all(&mut *conn)
    .await?;
    let bytes = lengths.iter().sum::<i64>();
    counted(conn, machine, i64::try_from(lengths.len()).unwrap_or(i64::MAX), bytes).await?;
    Ok(Dropped { cycles: lengths.len() as u64, bytes: number("bytes", bytes)?, more: true })
}

/// Where no samples are left that decisions name, a little of what they leave in packs goes; says whether there may be more.
pub(super) async fn tidy(conn: &mut Conn) -> StoreResult<Dropped> {
    dialect::lock(conn, &Locks::subject("partitions", "")).await?;
    Ok(Dropped { more: dialect::tidy(conn).await?, ..Dropped::default() })
}

/// Drops the oldest partition of which nothing is kept, where the engine has partitions and one is so. Not in the minutes
/// after its end: a server whose clock is behind receives into it yet.
pub(super) async fn drop_partition(conn: &mut Conn, now: Timestamp) -> StoreResult<Dropped> {
    let ended = Timestamp::from_micros(now.micros().saturating_sub(CLOCK_AHEAD_US));
    let Some(held) = dialect::drop_partition(conn, ended).await? else {
        return Ok(Dropped::default());
    };
    let mut dropped = Dropped { more: true, ..Dropped::default() };
    for (machine, cycles, bytes) in held {
        counted(conn, &machine, cycles, bytes).await?;
        dropped.cycles += number::<u64>("cycles", cycles)?;
        dropped.bytes += number::<u64>("bytes", bytes)?;
    }
    Ok(dropped)
}

/// Adds to the counts of the newest decision. Where another server moves that decision meanwhile, the row that was looked up is there no
/// longer, and the next statement sees where it is: nothing goes uncounted.
async fn counted(conn: &mut Conn, machine: &str, cycles: i64, bytes: i64) -> StoreResult<()> {
    // By a decision that was taken back nothing went, and it is there no longer.
    if cycles == 0 {
        return Ok(());
    }
    for _ in 0..MOST_MOVES {
        let counted = sqlx::query::<Db>(
            "UPDATE sample_drops SET cycles = cycles + $2, bytes = bytes + $3
             WHERE machine_id = $1
               AND before_us = (SELECT MAX(before_us) FROM sample_drops WHERE machine_id = $1)",
        )
        .bind(machine)
        .bind(cycles)
        .bind(bytes)
        .execute(&mut *conn)
        .await?;
        if counted.rows_affected() > 0 {
            return Ok(());
        }
    }
    Err(StoreError::Unavailable(format!("the decision on samples of {machine} moves on and on").into()))
}

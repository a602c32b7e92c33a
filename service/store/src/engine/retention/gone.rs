//! Which samples are gone, and by what: a decision names them by their receipt, or each by its cycle.
//!
//! A clock that is ahead receives cycles, and drops them, at times that are yet to come. When its decision is taken back, no
//! receipt up to now tells of them, and one beyond it would also tell of what is yet to be received. So each is named, and so
//! are those of the last minutes: a server whose clock is behind receives in them yet, and so was what waits to be committed.

use super::super::{CLOCK_AHEAD_US, Conn, Db, audit, dialect};
use super::drops;
use crate::error::StoreResult;
use crate::locks::Locks;
use crate::record::{Actor, DropReason, Role, SampleDrop, SamplesGone};
use crate::rows::{id, word};
use feedwright_core::ids::{CycleId, MachineId};
use feedwright_core::units::Timestamp;
use serde_json::json;
use std::collections::BTreeMap;

/// Cycles that are looked at in one transaction.
const NAMES_PAGE: i64 = 2_000;

#[derive(sqlx::FromRow)]
struct NameRow {
    cycle_id: String,
    dropped_at_us: i64,
    reason: String,
}

/// When and why samples of these cycles were dropped, each told with its receipt. Whoever is not in the answer is missing.
pub(in super::super) async fn of(
    conn: &mut Conn,
    machine: &MachineId,
    cycles: &[(CycleId, Timestamp)],
) -> StoreResult<BTreeMap<CycleId, SamplesGone>> {
    let decisions = drops(conn, machine).await?;
    by(conn, machine, &decisions, cycles).await
}

/// The same by decisions that were read already, oldest of them first.
pub(in super::super) async fn by(
    conn: &mut Conn,
    machine: &MachineId,
    decisions: &[SampleDrop],
    cycles: &[(CycleId, Timestamp)],
) -> StoreResult<BTreeMap<CycleId, SamplesGone>> {
    let by_receipt = cycles.iter().filter_map(|(cycle, received)| {
        let first = decisions.partition_point(|decision| decision.before <= *received);
        let decision = decisions.get(first)?;
        Some((cycle.clone(), SamplesGone { dropped_at: decision.dropped_at, reason: decision.reason }))
    });
    let mut gone: BTreeMap<CycleId, SamplesGone> = by_receipt.collect();
    let names: Vec<NameRow> = sqlx::query_as::<Db, _>(dialect::NAMED_DROPS)
        .bind(machine.as_str())
        .bind(dialect::list(cycles.iter().map(|(cycle, _)| cycle.as_str())))
        .fetch_all(&mut *conn)
        .await?;
    // A later decision tells of their receipts too, when the time has come: it is not what dropped them.
    for name in &names {
        let dropped_at = Timestamp::from_micros(name.dropped_at_us);
        let reason = word("reason", &name.reason, DropReason::parse)?;
        gone.insert(id("cycle_id", &name.cycle_id)?, SamplesGone { dropped_at, reason });
    }
    Ok(gone)
}

/// What a clock that was ahead has decided on a machine's samples, and what has come of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in super::super) struct Ahead {
    /// The receipt that it tells of, µs.
    before_us: i64,
    /// The receipt that can be told of instead: all that came before it is gone, and none that is yet to be committed, µs.
    stands_us: i64,
    reason: String,
    cycles: i64,
    bytes: i64,
}

impl Ahead {
    /// Whether anything went by it.
    pub(in super::super) const fn has_dropped(&self) -> bool {
        self.cycles > 0
    }
}

/// The decisions on a machine's samples that a clock which was ahead has made, as one; `apart_us` is how far clocks may be apart.
pub(in super::super) async fn ahead(
    conn: &mut Conn,
    machine: &MachineId,
    (now, apart_us): (Timestamp, i64),
) -> StoreResult<Option<Ahead>> {
    let latest = now.micros().saturating_add(apart_us);
    let made: Vec<(i64, String, i64, i64)> = sqlx::query_as::<Db, _>(
        "SELECT before_us, reason, cycles, bytes FROM sample_drops WHERE machine_id = $1 AND dropped_at_us > $2
         ORDER BY before_us DESC",
    )
    .bind(machine.as_str())
    .bind(latest)
    .fetch_all(&mut *conn)
    .await?;
    let Some((before_us, reason, ..)) = made.first().cloned() else { return Ok(None) };
    let honest: Option<i64> = sqlx::query_scalar::<Db, _>(
        "SELECT MAX(before_us) FROM sample_drops WHERE machine_id = $1 AND dropped_at_us <= $2",
    )
    .bind(machine.as_str())
    .bind(latest)
    .fetch_one(&mut *conn)
    .await?;
    let oldest_left: Option<i64> =
        sqlx::query_scalar::<Db, _>("SELECT MIN(received_at_us) FROM cycle_samples WHERE machine_id = $1")
            .bind(machine.as_str())
            .fetch_one(&mut *conn)
            .await?;
    let committed_us = now.micros().saturating_sub(CLOCK_AHEAD_US);
    let stands_us = oldest_left.unwrap_or(i64::MAX).min(committed_us).min(before_us);
    Ok(Some(Ahead {
        before_us,
        stands_us: stands_us.max(honest.unwrap_or(i64::MIN)),
        reason,
        cycles: made.iter().map(|(_, _, cycles, _)| cycles).sum(),
        bytes: made.iter().map(|(_, _, _, bytes)| bytes).sum(),
    }))
}

/// Names those of the next cycles after `after` whose samples went by that decision and of which the receipt that stands
/// does not tell. Returns where to go on; `None` at the end. Names may be given twice, and ahead of the taking back.
pub(in super::super) async fn name_page(
    conn: &mut Conn,
    machine: &MachineId,
    ahead: &Ahead,
    after: &str,
    now: Timestamp,
) -> StoreResult<Option<String>> {
    let last: Option<String> = sqlx::query_scalar::<Db, _>(
        "SELECT MAX(cycle_id) FROM (SELECT cycle_id FROM cycles WHERE machine_id = $1 AND cycle_id > $2
                                    ORDER BY cycle_id LIMIT $3) AS page",
    )
    .bind(machine.as_str())
    .bind(after)
    .bind(NAMES_PAGE)
    .fetch_one(&mut *conn)
    .await?;
    let Some(last) = last else { return Ok(None) };
    sqlx::query::<Db>(
        "INSERT INTO cycle_sample_drops (machine_id, cycle_id, dropped_at_us, reason)
         SELECT c.machine_id, c.cycle_id, $4, $5 FROM cycles c
         WHERE c.machine_id = $1 AND c.cycle_id > $2 AND c.cycle_id <= $3 AND c.sample_count > 0
             AND c.received_at_us >= $6 AND c.received_at_us < $7
             AND NOT EXISTS (SELECT 1 FROM cycle_samples s WHERE s.machine_id = c.machine_id
                                 AND s.received_at_us = c.received_at_us AND s.cycle_id = c.cycle_id)
         ON CONFLICT (machine_id, cycle_id) DO NOTHING",
    )
    .bind(machine.as_str())
    .bind(after)
    .bind(&last)
    .bind(now.micros())
    .bind(&ahead.reason)
    .bind(ahead.stands_us)
    .bind(ahead.before_us)
    .execute(&mut *conn)
    .await?;
    Ok(Some(last))
}

/// Takes that decision back: it would drop everything that comes until its time. `false` where more has gone by it since
/// it was read, so that there is more to name first. Under the locks of decisions and of partitions: nothing goes
/// meanwhile, and a second server, or a second run, finds nothing to take back.
pub(in super::super) async fn take_back(
    conn: &mut Conn,
    machine: &MachineId,
    expected: &Ahead,
    (now, apart_us): (Timestamp, i64),
) -> StoreResult<bool> {
    // Not in ascending order: see `locks`.
    dialect::lock(conn, &Locks::subject("partitions", "")).await?;
    dialect::lock(conn, &Locks::subject("retention", machine.as_str())).await?;
    match ahead(conn, machine, (now, apart_us)).await? {
        None => return Ok(true),
        Some(found) if found != *expected => return Ok(false),
        Some(_) => {}
    }
    sqlx::query::<Db>("DELETE FROM sample_drops WHERE machine_id = $1 AND dropped_at_us > $2")
        .bind(machine.as_str())
        .bind(now.micros().saturating_add(apart_us))
        .execute(&mut *conn)
        .await?;
    // Counts are kept with what they count: of none, nothing went.
    if expected.has_dropped() {
        sqlx::query::<Db>(
            "INSERT INTO sample_drops (machine_id, before_us, dropped_at_us, reason, cycles, bytes)
             VALUES ($1, $2, $3, $4, $5, $6)
             ON CONFLICT (machine_id, before_us) DO UPDATE SET
                 cycles = sample_drops.cycles + excluded.cycles, bytes = sample_drops.bytes + excluded.bytes",
        )
        .bind(machine.as_str())
        .bind(expected.stands_us)
        .bind(now.micros())
        .bind(&expected.reason)
        .bind(expected.cycles)
        .bind(expected.bytes)
        .execute(&mut *conn)
        .await?;
    }
    tracing::warn!(%machine, "a clock was ahead when it was decided to drop samples; the decision is taken back");
    let actor = Actor { token: "retention".to_owned(), role: Role::Admin };
    let instead = expected.has_dropped().then_some(expected.stands_us);
    let detail = json!({
        "received_before_us": expected.before_us, "instead_us": instead, "why": "the clock was ahead",
    });
    audit::add(conn, &actor, now, "samples.drop_taken_back", format!("machine/{machine}/samples"), &detail)
        .await?;
    Ok(true)
}

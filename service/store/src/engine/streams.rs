//! Streams: their leases, and the overrides that were computed for a cycle.

use super::{Conn, Db, alarms, dialect};
use crate::codec;
use crate::error::StoreResult;
use crate::record::{AlarmKind, CycleOverrides, LONGEST_LEASE_MS, Sent, StreamLease};
use crate::rows::id;
use feedwright_core::ids::{CycleId, MachineId, ToolId};
use feedwright_core::units::Timestamp;
use std::time::Duration;

const LONGEST_LEASE: Duration = Duration::from_millis(LONGEST_LEASE_MS);

/// Takes a machine's lease where it is free, expired, already the holder's, or may be taken over.
pub(super) async fn take(
    conn: &mut Conn,
    machine: &MachineId,
    holder: &str,
    takeover: bool,
    (now, lease): (Timestamp, Duration),
) -> StoreResult<StreamLease> {
    bring_back(conn, machine, now).await?;
    let until = after(now, lease);
    // One's own keeps its end where that is later: who holds it believes in that.
    let taken: Option<i64> = sqlx::query_scalar::<Db, _>(
        "INSERT INTO stream_leases (machine_id, holder, generation, expires_at_us) VALUES ($1, $2, 1, $3)
         ON CONFLICT (machine_id) DO UPDATE SET holder = excluded.holder,
             generation = stream_leases.generation + 1,
             expires_at_us = CASE WHEN stream_leases.holder = excluded.holder
                 AND stream_leases.expires_at_us > excluded.expires_at_us
                 THEN stream_leases.expires_at_us ELSE excluded.expires_at_us END
         WHERE $4 = 1 OR stream_leases.expires_at_us <= $5 OR stream_leases.holder = $2
         RETURNING generation",
    )
    .bind(machine.as_str())
    .bind(holder)
    .bind(until.micros())
    .bind(i64::from(takeover))
    .bind(now.micros())
    .fetch_optional(&mut *conn)
    .await?;
    if let Some(generation) = taken {
        return Ok(StreamLease::Taken { generation });
    }
    let expires_at: Option<i64> =
        sqlx::query_scalar::<Db, _>("SELECT expires_at_us FROM stream_leases WHERE machine_id = $1")
            .bind(machine.as_str())
            .fetch_optional(&mut *conn)
            .await?;
    let left = expires_at.unwrap_or(until.micros()).saturating_sub(now.micros());
    Ok(StreamLease::Held { wait: Duration::from_micros(u64::try_from(left).unwrap_or(0)) })
}

/// Nobody would have the machine's stream until the time has come that a clock which was ahead has written.
async fn bring_back(conn: &mut Conn, machine: &MachineId, now: Timestamp) -> StoreResult<()> {
    sqlx::query::<Db>(
        "UPDATE stream_leases SET expires_at_us = $2 WHERE machine_id = $1 AND expires_at_us > $2",
    )
    .bind(machine.as_str())
    .bind(after(now, LONGEST_LEASE).micros())
    .execute(&mut *conn)
    .await?;
    Ok(())
}

/// Prolongs a holder's leases on these machines; those that it still holds: nobody has taken them, though they may have ended while the
/// database was away. Any other, as of a stream that was never opened, ends.
pub(super) async fn renew(
    conn: &mut Conn,
    holder: &str,
    machines: &[MachineId],
    (now, lease): (Timestamp, Duration),
) -> StoreResult<Vec<(MachineId, i64)>> {
    let rows: Vec<(String, i64)> = sqlx::query_as::<Db, _>(dialect::RENEW_LEASES)
        .bind(holder)
        .bind(after(now, lease).micros())
        .bind(dialect::list(machines.iter().map(MachineId::as_str)))
        .fetch_all(&mut *conn)
        .await?;
    rows.iter().map(|(machine, generation)| Ok((id("machine_id", machine)?, *generation))).collect()
}

/// Those of these machines whose lease stands. What ends later than any lease was written by a clock that was ahead.
pub(super) async fn leased(
    conn: &mut Conn,
    machines: &[MachineId],
    now: Timestamp,
) -> StoreResult<Vec<MachineId>> {
    let rows: Vec<String> = sqlx::query_scalar::<Db, _>(dialect::LEASED)
        .bind(now.micros())
        .bind(after(now, LONGEST_LEASE).micros())
        .bind(dialect::list(machines.iter().map(MachineId::as_str)))
        .fetch_all(&mut *conn)
        .await?;
    rows.iter().map(|machine| id("machine_id", machine)).collect()
}

/// When a lease that is taken or prolonged now ends.
fn after(now: Timestamp, lease: Duration) -> Timestamp {
    let lease_us = i64::try_from(lease.min(LONGEST_LEASE).as_micros()).unwrap_or(i64::MAX);
    Timestamp::from_micros(now.micros().saturating_add(lease_us))
}

/// Gives a lease back, unless it is somebody else's by now: it is over then, whatever the clock tells.
pub(super) async fn release(
    conn: &mut Conn,
    machine: &MachineId,
    holder: &str,
    generation: i64,
) -> StoreResult<()> {
    sqlx::query::<Db>(
        "UPDATE stream_leases SET expires_at_us = 0 WHERE machine_id = $1 AND holder = $2 AND generation = $3",
    )
    .bind(machine.as_str())
    .bind(holder)
    .bind(generation)
    .execute(&mut *conn)
    .await?;
    Ok(())
}

/// Keeps what a cycle's samples were answered, until the cycle is stored; those of another one that comes under its id before stand in
/// their place. What comes under the id of a stored cycle, be it refused or sent once more, says nothing of what that was answered.
/// Nor does what a cycle is answered that is sent again from its first sample, long after it was cut: what is there for as many
/// samples are the answers that it was cut by.
pub(super) async fn put_overrides(conn: &mut Conn, kept: &CycleOverrides, sent: Sent) -> StoreResult<()> {
    if sent == Sent::Again
        && let Some(first) = overrides(conn, &kept.machine, &kept.cycle).await?
        && let (Ok(first), Ok(again)) =
            (codec::decode_overrides(&first.block), codec::decode_overrides(&kept.block))
        && first.len() == again.len()
    {
        return Ok(());
    }
    let is_stored: Option<i64> = sqlx::query_scalar::<Db, _>(
        "SELECT received_at_us FROM cycles WHERE machine_id = $1 AND cycle_id = $2",
    )
    .bind(kept.machine.as_str())
    .bind(kept.cycle.as_str())
    .fetch_optional(&mut *conn)
    .await?;
    if is_stored.is_some() {
        return Ok(());
    }
    sqlx::query::<Db>(
        "INSERT INTO cycle_overrides (machine_id, cycle_id, mode, law_version, program_hash, stored_at_us, block)
         VALUES ($1, $2, $3, $4, $5, $6, $7)
         ON CONFLICT (machine_id, cycle_id) DO UPDATE SET mode = excluded.mode, law_version = excluded.law_version,
             program_hash = excluded.program_hash, stored_at_us = excluded.stored_at_us, block = excluded.block",
    )
    .bind(kept.machine.as_str())
    .bind(kept.cycle.as_str())
    .bind(&kept.mode)
    .bind(&kept.law_version)
    .bind(kept.program_hash.as_deref())
    .bind(kept.stored_at.micros())
    .bind(kept.block.as_slice())
    .execute(&mut *conn)
    .await?;
    Ok(())
}

pub(super) async fn overrides(
    conn: &mut Conn,
    machine: &MachineId,
    cycle: &CycleId,
) -> StoreResult<Option<CycleOverrides>> {
    type Row = (String, String, Option<String>, i64, Vec<u8>);
    let row: Option<Row> = sqlx::query_as::<Db, _>(
        "SELECT mode, law_version, program_hash, stored_at_us, block FROM cycle_overrides
         WHERE machine_id = $1 AND cycle_id = $2",
    )
    .bind(machine.as_str())
    .bind(cycle.as_str())
    .fetch_optional(&mut *conn)
    .await?;
    Ok(row.map(|(mode, law_version, program_hash, stored_at, block)| CycleOverrides {
        machine: machine.clone(),
        cycle: cycle.clone(),
        mode,
        law_version,
        program_hash,
        stored_at: Timestamp::from_micros(stored_at),
        block,
    }))
}

/// Raises an overload of a machine that a stream has seen, unless one is open.
pub(super) async fn raise_overload(
    conn: &mut Conn,
    machine: &MachineId,
    tool: &ToolId,
    message: &str,
    now: Timestamp,
) -> StoreResult<()> {
    alarms::raise(conn, AlarmKind::Overload, Some(machine), Some(tool), message, now).await
}

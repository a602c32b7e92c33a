//! States on the way of a fold, of a tool on one machine and over all of its machines: what comes late is folded on from there.

use super::{Conn, Db, dialect, readable, state_of};
use crate::error::StoreResult;
use crate::history::Walk;
use crate::rows::{Place, count, number};
use feedwright_core::ids::{MachineId, ToolId};
use feedwright_core::wear::{FOLD_VERSION, ToolFold};

/// States on the way that are taken over where a second machine runs a tool: what comes later by more than so many times the cycles
/// between two of them is folded from the first cycle on.
const MOST_TAKEN_OVER: i64 = 1000;

/// Whose cycles a checkpoint has counted.
#[derive(Debug, Clone, Copy)]
pub(in super::super::super) enum Of<'a> {
    /// Those of a tool on one machine.
    Machine(&'a MachineId),
    /// All of a tool that more than one machine has run.
    All,
}

/// Keeps the state that a walk has come to.
pub(super) async fn save_checkpoint(
    conn: &mut Conn,
    tool: &ToolId,
    of: Of<'_>,
    walk: &Walk<'_>,
) -> StoreResult<()> {
    let Some(last) = walk.fold().last() else {
        return Ok(());
    };
    // Of one machine the last cycle is its own.
    let (sql, machine) = match of {
        Of::Machine(machine) => (
            "INSERT INTO tool_wear_checkpoints (machine_id, tool_id, folded, fold_version, last_started_at_us,
                 last_seq, last_cycle_id, state)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8)
             ON CONFLICT (machine_id, tool_id, folded) DO UPDATE SET fold_version = excluded.fold_version,
                 last_started_at_us = excluded.last_started_at_us, last_seq = excluded.last_seq,
                 last_cycle_id = excluded.last_cycle_id, state = excluded.state",
            machine,
        ),
        Of::All => (
            concat!(
                "INSERT INTO tool_checkpoints (last_machine_id, tool_id, folded, fold_version, last_started_at_us,
                 last_seq, last_cycle_id, state)
             SELECT $1, $2, $3, $4, $5, $6, $7, $8 WHERE ",
                dialect::at_one_moment!(),
                " ON CONFLICT (tool_id, folded) DO UPDATE SET fold_version = excluded.fold_version,
                 last_started_at_us = excluded.last_started_at_us, last_machine_id = excluded.last_machine_id,
                 last_seq = excluded.last_seq, last_cycle_id = excluded.last_cycle_id, state = excluded.state"
            ),
            &last.machine,
        ),
    };
    sqlx::query::<Db>(sql)
        .bind(machine.as_str())
        .bind(tool.as_str())
        .bind(count("folded", walk.folded())?)
        .bind(i64::from(FOLD_VERSION))
        .bind(last.started_at.micros())
        .bind(last.seq.map(|seq| count("last_seq", seq)).transpose()?)
        .bind(last.cycle.as_str())
        .bind(state_of(walk.fold()))
        .execute(&mut *conn)
        .await?;
    Ok(())
}

/// A place as the key of the last cycle stands beside a state.
fn key_of(place: &Place) -> StoreResult<(i64, &str, i64, &str)> {
    let at = place.at.micros();
    Ok(match &place.cycle {
        None => (at, "", i64::MIN, ""),
        Some((machine, seq, cycle)) => {
            (at, machine.as_str(), seq.map_or(Ok(-1), |seq| count("seq", seq))?, cycle.as_str())
        }
    })
}

/// Takes back the states over all machines of a tool that have counted what comes at a place or after it. The tool's name is locked
/// by then.
pub(super) async fn forget_checkpoints(conn: &mut Conn, tool: &ToolId, from: &Place) -> StoreResult<()> {
    let (at, machine, seq, cycle) = key_of(from)?;
    sqlx::query::<Db>(
        "DELETE FROM tool_checkpoints WHERE tool_id = $1
         AND (last_started_at_us, last_machine_id, COALESCE(last_seq, -1), last_cycle_id) >= ($2, $3, $4, $5)",
    )
    .bind(tool.as_str())
    .bind(at)
    .bind(machine)
    .bind(seq)
    .bind(cycle)
    .execute(&mut *conn)
    .await?;
    Ok(())
}

#[derive(sqlx::FromRow)]
struct CheckpointRow {
    folded: i64,
    fold_version: i64,
    last_machine_id: String,
    last_started_at_us: i64,
    last_seq: Option<i64>,
    last_cycle_id: String,
    state: Vec<u8>,
}

impl CheckpointRow {
    /// The fold, where it ends with the cycle that the row says, which late cycles are held against: a key that says otherwise
    /// would leave some out.
    fn fold(&self) -> StoreResult<Option<(ToolFold, u64)>> {
        let Some(fold) = readable(self.fold_version, &self.state) else { return Ok(None) };
        let told = (
            self.last_started_at_us,
            &*self.last_machine_id,
            self.last_seq.unwrap_or(-1),
            &*self.last_cycle_id,
        );
        let last = fold.last().map(Place::of);
        let ends_so = last.as_ref().map(key_of).transpose()?.is_some_and(|key| key == told);
        Ok(ends_so.then_some((fold, number("folded", self.folded)?)))
    }
}

/// The last checkpoint whose cycles all come before `from`.
pub(in super::super) async fn checkpoint_before(
    conn: &mut Conn,
    tool: &ToolId,
    of: Of<'_>,
    from: &Place,
) -> StoreResult<Option<(ToolFold, u64)>> {
    let (at, machine, seq, cycle) = key_of(from)?;
    let sql = match of {
        Of::Machine(_) => {
            "SELECT folded, fold_version, machine_id AS last_machine_id, last_started_at_us, last_seq, last_cycle_id, state
             FROM tool_wear_checkpoints
             WHERE tool_id = $1
               AND (last_started_at_us, machine_id, COALESCE(last_seq, -1), last_cycle_id) < ($2, $3, $4, $5)
               AND machine_id = $6
             ORDER BY folded DESC LIMIT 1"
        }
        Of::All => concat!(
            "SELECT folded, fold_version, last_machine_id, last_started_at_us, last_seq, last_cycle_id, state
             FROM tool_checkpoints
             WHERE ",
            dialect::at_one_moment!(),
            " AND tool_id = $1
               AND (last_started_at_us, last_machine_id, COALESCE(last_seq, -1), last_cycle_id) < ($2, $3, $4, $5)
             ORDER BY folded DESC LIMIT 1"
        ),
    };
    let mut query = sqlx::query_as::<Db, CheckpointRow>(sql)
        .bind(tool.as_str())
        .bind(at)
        .bind(machine)
        .bind(seq)
        .bind(cycle);
    if let Of::Machine(machine) = of {
        query = query.bind(machine.as_str());
    }
    match query.fetch_optional(&mut *conn).await? {
        Some(row) => row.fold(),
        None => Ok(None),
    }
}

/// Takes back the states of a tool on a machine that have counted more cycles than so many.
pub(super) async fn forget_after(
    conn: &mut Conn,
    (machine, tool): (&MachineId, &ToolId),
    folded: u64,
) -> StoreResult<()> {
    sqlx::query::<Db>(
        "DELETE FROM tool_wear_checkpoints WHERE machine_id = $1 AND tool_id = $2 AND folded > $3",
    )
    .bind(machine.as_str())
    .bind(tool.as_str())
    .bind(count("folded", folded)?)
    .execute(&mut *conn)
    .await?;
    Ok(())
}

/// Takes the states of the one machine that ran a tool until now for those over all machines, up to where another one's first cycle
/// comes: before it they are the same. Not where there are some: more machines ran it, and the cache of one is lost.
pub(super) async fn take_over(
    conn: &mut Conn,
    (machine, tool): (&MachineId, &ToolId),
    before: &Place,
) -> StoreResult<bool> {
    let known: Option<i64> =
        sqlx::query_scalar::<Db, _>("SELECT folded FROM tool_checkpoints WHERE tool_id = $1 LIMIT 1")
            .bind(tool.as_str())
            .fetch_optional(&mut *conn)
            .await?;
    if known.is_some() {
        return Ok(false);
    }
    let (at, of, seq, cycle) = key_of(before)?;
    sqlx::query::<Db>(concat!(
        "INSERT INTO tool_checkpoints (last_machine_id, tool_id, folded, fold_version, last_started_at_us,
             last_seq, last_cycle_id, state)
         SELECT machine_id, tool_id, folded, fold_version, last_started_at_us, last_seq, last_cycle_id, state
         FROM tool_wear_checkpoints
         WHERE ",
        dialect::at_one_moment!(),
        " AND tool_id = $1
           AND (last_started_at_us, machine_id, COALESCE(last_seq, -1), last_cycle_id) < ($2, $3, $4, $5)
           AND machine_id = $6
         ORDER BY folded DESC LIMIT $7"
    ))
    .bind(tool.as_str())
    .bind(at)
    .bind(of)
    .bind(seq)
    .bind(cycle)
    .bind(machine.as_str())
    .bind(MOST_TAKEN_OVER)
    .execute(&mut *conn)
    .await?;
    Ok(true)
}

/// Whether states over all machines are kept here at all.
pub(super) async fn are_kept_over_all(conn: &mut Conn) -> StoreResult<bool> {
    let kept: i64 = sqlx::query_scalar::<Db, _>(concat!(
        "SELECT CAST(CASE WHEN ",
        dialect::at_one_moment!(),
        " THEN 1 ELSE 0 END AS BIGINT)"
    ))
    .fetch_one(&mut *conn)
    .await?;
    Ok(kept == 1)
}

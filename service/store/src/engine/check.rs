//! The check of the cached folds against folds from scratch, one tool at a time.

use super::wear::{self, ToolWear};
use super::{Conn, Db, alarms, dialect, registry};
use crate::codec::ran::Ran;
use crate::error::StoreResult;
use crate::history::Walk;
use crate::locks::Locks;
use crate::record::{DifferingWear, Doubt, Left};
use crate::rows::{FactsRow, count, id};
use crate::stored_text::StoredText;
use feedwright_core::ids::{MachineId, ToolId};
use feedwright_core::units::Timestamp;
use feedwright_core::wear::{Exclusion, FOLD_VERSION, OrderKey, ToolFold};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

/// Every registered tool, and each that has a cache; as they are stored, those whose id is damaged too.
pub(super) async fn tools(conn: &mut Conn) -> StoreResult<BTreeSet<StoredText>> {
    dialect::read_as_stored(conn).await?;
    let found: Vec<StoredText> =
        sqlx::query_scalar::<Db, _>("SELECT tool_id FROM tools UNION SELECT tool_id FROM tool_wear")
            .fetch_all(&mut *conn)
            .await?;
    Ok(found.into_iter().collect())
}

#[derive(sqlx::FromRow)]
struct StateRow {
    machine_id: String,
    folded: i64,
    fold_version: i64,
    state: Vec<u8>,
}

/// Version and bytes of a fold's state; none where what is stored cannot be unpacked.
type State = (i64, Option<Vec<u8>>);

/// Held against a fold as it is, however it is packed.
fn state(row: &StateRow) -> State {
    (row.fold_version, wear::plain_state(&row.state).map(Cow::into_owned))
}

#[derive(sqlx::FromRow)]
struct CheckpointRow {
    #[sqlx(flatten)]
    state: StateRow,
    last_started_at_us: i64,
    last_seq: Option<i64>,
    last_cycle_id: String,
}

/// Start, count and id of the last cycle that a checkpoint has counted.
type Last = (i64, Option<i64>, String);

/// What is cached of a tool: the state of each machine and its checkpoints.
async fn cached(
    conn: &mut Conn,
    tool: &ToolId,
) -> StoreResult<(BTreeMap<MachineId, (i64, State)>, BTreeMap<(MachineId, i64), (State, Last)>)> {
    let states: Vec<StateRow> = sqlx::query_as::<Db, _>(
        "SELECT machine_id, folded, fold_version, state FROM tool_wear WHERE tool_id = $1",
    )
    .bind(tool.as_str())
    .fetch_all(&mut *conn)
    .await?;
    let checkpoints: Vec<CheckpointRow> = sqlx::query_as::<Db, _>(
        "SELECT machine_id, folded, fold_version, state, last_started_at_us, last_seq, last_cycle_id
         FROM tool_wear_checkpoints WHERE tool_id = $1",
    )
    .bind(tool.as_str())
    .fetch_all(&mut *conn)
    .await?;
    let mut by_machine = BTreeMap::new();
    for row in states {
        by_machine.insert(id("machine_id", &row.machine_id)?, (row.folded, state(&row)));
    }
    let mut by_count = BTreeMap::new();
    for CheckpointRow { state: row, last_started_at_us, last_seq, last_cycle_id } in checkpoints {
        let last = (last_started_at_us, last_seq, last_cycle_id);
        by_count.insert((id("machine_id", &row.machine_id)?, row.folded), (state(&row), last));
    }
    Ok((by_machine, by_count))
}

/// The states on the way over all machines of a tool, by how many cycles they have counted, with the machine of the last of them.
async fn overall(conn: &mut Conn, tool: &ToolId) -> StoreResult<BTreeMap<i64, (MachineId, (State, Last))>> {
    let rows: Vec<CheckpointRow> = sqlx::query_as::<Db, _>(
        "SELECT last_machine_id AS machine_id, folded, fold_version, state, last_started_at_us, last_seq,
             last_cycle_id
         FROM tool_checkpoints WHERE tool_id = $1",
    )
    .bind(tool.as_str())
    .fetch_all(&mut *conn)
    .await?;
    let mut by_count = BTreeMap::new();
    for CheckpointRow { state: row, last_started_at_us, last_seq, last_cycle_id } in rows {
        let last = (last_started_at_us, last_seq, last_cycle_id);
        by_count.insert(row.folded, (id("machine_id", &row.machine_id)?, (state(&row), last)));
    }
    Ok(by_count)
}

fn last_of(order: &OrderKey) -> StoreResult<Last> {
    let seq = order.seq.map(|seq| count("last_seq", seq)).transpose()?;
    Ok((order.started_at.micros(), seq, order.cycle.as_str().to_owned()))
}

/// Folds a cycle in that can be read. The fold leaves out what cannot: what it amounts to says nothing of what is stored then.
fn step(walk: &mut Walk<'_>, row: &FactsRow) -> StoreResult<()> {
    let folded = row.readable().and_then(|()| walk.step(row));
    folded.map_err(|error| error.of_cycle(&row.machine_id, &row.cycle_id))
}

/// Compares one tool's caches with its fold, checkpoints included. Returns the rows compared and those that differ. Where they
/// are to be folded again, which is told by what is in doubt, also those of another version; all of the tool's or none.
pub(super) async fn tool(
    conn: &mut Conn,
    tool: &ToolId,
    doubt: Option<&Doubt>,
) -> StoreResult<(u64, Vec<DifferingWear>)> {
    dialect::read_as_stored(conn).await?;
    let repair = doubt.is_some();
    if repair {
        dialect::lock(conn, &Locks::tool(tool)).await?;
    }
    let (mut states, mut checkpoints) = cached(conn, tool).await?;
    let mut overall = overall(conn, tool).await?;
    let known = ToolWear::load(conn, tool).await?;
    if known.is_outdated() {
        // Nor those that are behind a change of an operation.
        let of_states = states.values_mut().map(|(_, state)| state);
        let on_the_way = checkpoints.values_mut().map(|(state, _)| state);
        let on_the_way = on_the_way.chain(overall.values_mut().map(|(_, (state, _))| state));
        of_states.chain(on_the_way).for_each(|(version, _)| *version = wear::BEHIND);
    }
    let events = &known.events;
    let mut machines: BTreeSet<MachineId> = states.keys().cloned().collect();
    if wear::is_registered(conn, tool).await? {
        machines.extend(wear::machines_of(conn, tool).await?);
    }
    let version = i64::from(FOLD_VERSION);
    // Nobody believes a state of another version: it is folded again where it is asked for, and is a fault of nobody's.
    let holds = |found: Option<&State>, fold: &ToolFold| match found {
        Some((of, _)) if *of != version => !repair,
        Some((_, state)) => state.as_deref() == Some(&fold.to_bytes()),
        None => false,
    };
    // A late cycle is counted from the last checkpoint whose key is before it.
    let checkpoint_holds = |found: Option<&(State, Last)>, fold: &ToolFold| -> StoreResult<bool> {
        let Some((state, of)) = found else { return Ok(holds(None, fold)) };
        let last = fold.last().map(last_of).transpose()?;
        Ok(holds(Some(state), fold) && (state.0 != version || last.as_ref() == Some(of)))
    };
    let mut overall_same = true;
    let mut walk = Walk::new(events);
    while !overall.is_empty() {
        let page = wear::facts_after(conn, tool, None, walk.fold().last()).await?;
        if page.is_empty() {
            break;
        }
        for row in &page {
            step(&mut walk, row)?;
            let found = walk.at_checkpoint().then(|| count("folded", walk.folded())).transpose()?;
            if let Some((machine, found)) = found.and_then(|folded| overall.remove(&folded)) {
                overall_same &= walk.fold().last().is_some_and(|last| last.machine == machine)
                    && checkpoint_holds(Some(&found), walk.fold())?;
            }
        }
    }
    overall_same &= overall.is_empty();
    let mut different = Vec::new();
    for machine in &machines {
        let mut walk = Walk::new(events);
        // One that is of all of them is told of the first.
        let mut same = std::mem::replace(&mut overall_same, true);
        // It is to be folded again: what it has of states on the way has to hold, and need not be all of them.
        let is_postponed = !repair && known.is_postponed_on(machine);
        let mut ran = Ran::nothing();
        loop {
            let page = wear::facts_after(conn, tool, Some(machine), walk.fold().last()).await?;
            if page.is_empty() {
                break;
            }
            for row in &page {
                step(&mut walk, row)?;
                ran.note(&row.operation_id, row.started_at_us);
                if walk.at_checkpoint() {
                    let found = checkpoints.remove(&(machine.clone(), count("folded", walk.folded())?));
                    same &= found.is_none() && is_postponed || checkpoint_holds(found.as_ref(), walk.fold())?;
                }
            }
        }
        let folded = count("folded", walk.folded())?;
        let state = states.get(machine);
        same &=
            state.is_some_and(|(of, _)| *of == folded) && holds(state.map(|(_, state)| state), walk.fold());
        // Who goes by it would not follow a change of an operation that it lacks.
        same &= is_postponed || known.ran(machine).is_none_or(|noted| *noted == ran);
        // Checkpoints beyond the history are left over from nothing.
        same &= !checkpoints.keys().any(|(of, _)| of == machine);
        if !same {
            // Nobody believes one of another version, or one that cannot be read.
            let believed = state.and_then(|(_, (of, state))| state.as_ref().filter(|_| *of == version));
            let counted = state.map_or(0, |(of, _)| *of);
            // What is the fold to the byte has counted what is there, whatever number stands beside it.
            let is_fold = believed.is_some_and(|state| *state == walk.fold().to_bytes());
            let missing = if is_fold { 0 } else { counted.saturating_sub(folded) };
            let missing = u64::try_from(missing).unwrap_or(0);
            let believed = believed.filter(|_| !is_fold);
            let as_cut = |fold: &ToolFold| fold.verdict().excluded[Exclusion::CutShort as usize];
            let cut_otherwise = believed
                .and_then(|state| ToolFold::from_bytes(state))
                .is_some_and(|cached| as_cut(&cached) != as_cut(walk.fold()));
            let left = left(doubt, (machine, tool), missing, (believed.is_some(), cut_otherwise));
            different.push(DifferingWear { machine: machine.clone(), tool: tool.clone(), missing, left });
        }
    }
    if repair && !different.is_empty() {
        if different.iter().all(|wear| wear.left.is_none()) {
            let machines: Vec<_> = different.iter().map(|wear| wear.machine.clone()).collect();
            mend(conn, tool, &machines).await?;
        } else {
            different.iter_mut().for_each(|wear| wear.left = wear.left.or(Some(Left::Another)));
        }
    }
    Ok((machines.len() as u64, different))
}

/// Why a cache that differs is not folded again. One that has counted more cycles than there are is the last that knows of
/// them: a cycle is never taken away, and never becomes another tool's.
/// What is not `believed` says nothing that could be lost. One that has left out others as cut short than are flagged so may have
/// known it better.
fn left(
    doubt: Option<&Doubt>,
    (machine, tool): (&MachineId, &ToolId),
    missing: u64,
    (believed, cut_otherwise): (bool, bool),
) -> Option<Left> {
    let Some(doubt) = doubt else { return Some(Left::Unasked) };
    match () {
        () if missing > 0 => Some(Left::Missing),
        () if !believed => None,
        () if doubt.tools.contains(tool) => Some(Left::Doubtful),
        () if doubt.unproven.contains(&(machine.clone(), tool.clone())) => Some(Left::Unproven),
        () if doubt.cut_short && cut_otherwise => Some(Left::Unproven),
        () => None,
    }
}

/// Folds the named caches anew. The check is given no clock: the newest receipt of a cycle stands for now.
///
/// Versions of folds count on, and another generation of the registry begins: no server takes what it remembers of the folds
/// before for those that are made here.
async fn mend(conn: &mut Conn, tool: &ToolId, machines: &[MachineId]) -> StoreResult<()> {
    let newest: Option<i64> =
        sqlx::query_scalar::<Db, _>("SELECT MAX(received_at_us) FROM cycles WHERE tool_id = $1")
            .bind(tool.as_str())
            .fetch_one(&mut *conn)
            .await?;
    let now = Timestamp::from_micros(newest.unwrap_or(0));
    let registered = wear::is_registered(conn, tool).await?;
    let folded = if registered { wear::machines_of(conn, tool).await? } else { Vec::new() };
    for machine in machines {
        sqlx::query::<Db>("DELETE FROM tool_wear_checkpoints WHERE machine_id = $1 AND tool_id = $2")
            .bind(machine.as_str())
            .bind(tool.as_str())
            .execute(&mut *conn)
            .await?;
        // What is folded again is written over its row.
        if !folded.contains(machine) {
            sqlx::query::<Db>("DELETE FROM tool_wear WHERE machine_id = $1 AND tool_id = $2")
                .bind(machine.as_str())
                .bind(tool.as_str())
                .execute(&mut *conn)
                .await?;
        }
    }
    if registered {
        let verdict = wear::count_all(conn, tool, now, wear::Budget::whole()).await?;
        alarms::follow_verdict(conn, tool, &verdict, now).await?;
    }
    registry::changed(conn).await
}

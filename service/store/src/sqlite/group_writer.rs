//! Whole groups, row by row, on the thread that calls.
//!
//! Every other connection has a thread of its own, to which each statement is a hop there and back. What is written for
//! every cycle of the shop goes without: a row's statement is made once and runs as often as there are rows, on the
//! thread of the groups ([`super::group_thread`]), which may wait for the disk.

use super::dialect::{BLOCKS, CYCLES, RECOMMENDATIONS};
use super::engine::Heads;
use super::open::{SETTINGS, is_durable};
use crate::error::{StoreError, StoreResult};
use crate::rows::{AlarmChange, BlockRow, CycleRow, IssuedRow, Rest, SavedWear, cycle_columns};
use crate::work::Written;
use feedwright_core::ids::ToolId;
use feedwright_core::units::Timestamp;
use feedwright_core::wear::FOLD_VERSION;
use rusqlite::{CachedStatement, Connection, OpenFlags, Transaction, TransactionBehavior};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// What the writer of groups keeps of the file, in KiB below zero: the pages that some hundred machines' next cycles go
/// to. Others come from the system's cache.
const CACHE: &str = "-2048";

/// A connection that writes groups. Whoever calls it waits for the disk.
#[derive(Debug)]
pub(super) struct GroupWriter {
    conn: Connection,
}

/// What a group rests on that takes these heads for granted: they are held against the database in the transaction that
/// writes it.
#[derive(Clone, Copy)]
pub(super) struct Assumption<'h> {
    pub(super) heads: &'h Heads,
    /// All tools of the group; those without a version in the heads are taken to have no fold.
    pub(super) tools: &'h BTreeSet<&'h ToolId>,
}

impl GroupWriter {
    /// Opens a file that is there, migrated and in WAL mode.
    pub(super) fn open(path: &Path, patience: Duration) -> StoreResult<Self> {
        // No lock around every call: it is one thread's at any time.
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let conn = Connection::open_with_flags(path, flags)?;
        conn.busy_timeout(patience)?;
        for (name, value) in SETTINGS.into_iter().chain([("synchronous", "FULL"), ("cache_size", CACHE)]) {
            conn.pragma_update(None, name, value)?;
        }
        let text = |name| conn.pragma_query_value(None, name, |row| row.get::<_, String>(0));
        let number = |name| conn.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
        is_durable(&text("journal_mode")?, number("synchronous")?)?;
        if number("foreign_keys")? != 1 {
            return Err(StoreError::NotWritable("foreign keys are not enforced".into()));
        }
        Ok(Self { conn })
    }

    /// Writes a whole group and commits it; `None`, with nothing written, where what was assumed does not hold.
    ///
    /// # Errors
    ///
    /// As the database; [`StoreError::Refused`] where a cycle is stored already, and where a row is bad in itself. Nothing
    /// of the group is written then.
    pub(super) fn write(
        &mut self,
        assumption: Assumption<'_>,
        cycles: &[Arc<CycleRow>],
        rest: &Rest<'_>,
        now: Timestamp,
    ) -> StoreResult<Option<Written>> {
        // Dropped before its commit, it rolls back.
        let transaction = self.conn.transaction_with_behavior(TransactionBehavior::Immediate)?;
        if !holds(&transaction, assumption)? {
            return Ok(None);
        }
        insert_cycles(&transaction, cycles)?;
        insert_blocks(&transaction, &rest.blocks)?;
        save_wear(&transaction, &rest.wear, now)?;
        change_alarms(&transaction, &rest.alarms, now)?;
        insert_advices(&transaction, rest.with_new_advice())?;
        insert_recommendations(&transaction, &rest.issued)?;
        transaction.commit()?;
        Ok(Some(Written::whole()))
    }

    /// Closes the connection.
    pub(super) fn close(self) -> StoreResult<()> {
        self.conn.close().map_err(|(_, error)| error.into())
    }
}

/// Whether the heads are those in force.
fn holds(transaction: &Transaction<'_>, Assumption { heads, tools }: Assumption<'_>) -> StoreResult<bool> {
    let mut in_force = transaction.prepare_cached(
        "SELECT (SELECT SUM(changes) FROM registry_generation) IS ?
            AND EXISTS (SELECT 1 FROM feed_profiles WHERE active_version IS NOT NULL) IS ?",
    )?;
    if !in_force.query_row((heads.generation, heads.any_profile), |row| row.get::<_, bool>(0))? {
        return Ok(false);
    }
    let mut versions = transaction
        .prepare_cached("SELECT machine_id, version FROM tool_wear WHERE tool_id = ? ORDER BY machine_id")?;
    for tool in tools {
        // Ids are compared byte by byte there and here.
        let mut assumed = heads.versions.get(*tool).into_iter().flatten();
        let mut rows = versions.query([tool.as_str()])?;
        while let Some(row) = rows.next()? {
            let stored = (row.get_ref(0)?.as_str().map_err(rusqlite::Error::from)?, row.get(1)?);
            if assumed.next().map(|(machine, version)| (machine.as_str(), *version)) != Some(stored) {
                return Ok(false);
            }
        }
        if assumed.next().is_some() {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Runs a statement with a row's values, in the order of its parameters.
macro_rules! run {
    ($statement:ident, $($value:expr),* $(,)?) => {{
        let mut place = 0;
        $(
            place += 1;
            $statement.raw_bind_parameter(place, $value)?;
        )*
        $statement.raw_execute()
    }};
}

fn insert_cycles(transaction: &Transaction<'_>, rows: &[Arc<CycleRow>]) -> rusqlite::Result<()> {
    let mut statement = transaction.prepare_cached(CYCLES.one())?;
    for row in rows {
        macro_rules! insert_row {
            ($($column:ident: $type:ty = $placeholder:literal,)*) => { run!(statement, $(&row.$column,)*) };
        }
        cycle_columns!(insert_row)?;
    }
    Ok(())
}

fn insert_blocks(transaction: &Transaction<'_>, rows: &[BlockRow<'_>]) -> rusqlite::Result<()> {
    let mut statement = transaction.prepare_cached(BLOCKS.one())?;
    for row in rows {
        run!(statement, &row.machine_id, row.received_at_us, &row.cycle_id, row.block)?;
    }
    Ok(())
}

/// Writes folds whose versions are known to be in force.
fn save_wear(transaction: &Transaction<'_>, rows: &[SavedWear], now: Timestamp) -> StoreResult<()> {
    let update = |statement: &mut CachedStatement<'_>, row: &SavedWear| {
        run!(
            statement,
            row.folded,
            FOLD_VERSION,
            &row.state,
            now.micros(),
            row.version + 1,
            &row.machine_id,
            &row.tool_id
        )
    };
    let mut known = transaction.prepare_cached(
        "UPDATE tool_wear SET folded = ?, fold_version = ?, state = ?, updated_at_us = ?, version = ?
         WHERE machine_id = ? AND tool_id = ?",
    )?;
    let mut new = transaction.prepare_cached(
        "INSERT INTO tool_wear (folded, fold_version, state, updated_at_us, version, machine_id, tool_id)
         VALUES (?, ?, ?, ?, ?, ?, ?)",
    )?;
    for row in rows {
        let written = update(if row.version > 0 { &mut known } else { &mut new }, row)?;
        if written != 1 {
            // Its cycles would be stored and not counted.
            return Err(StoreError::Damaged { what: format!("the fold of tool {} is gone", row.tool_id) });
        }
    }
    Ok(())
}

fn change_alarms(
    transaction: &Transaction<'_>,
    changes: &[AlarmChange],
    now: Timestamp,
) -> rusqlite::Result<()> {
    for change in changes {
        match change {
            AlarmChange::ClearVerdicts { tool_id, but } => {
                let mut statement = transaction.prepare_cached(AlarmChange::CLEAR_VERDICTS)?;
                run!(statement, now.micros(), tool_id, but)?;
            }
            AlarmChange::Raise { kind, machine_id, tool_id, message } => {
                let mut statement = transaction.prepare_cached(AlarmChange::RAISE)?;
                run!(statement, kind, machine_id, tool_id, message, now.micros())?;
            }
        }
    }
    Ok(())
}

fn insert_advices<'r>(
    transaction: &Transaction<'_>,
    rows: impl Iterator<Item = &'r IssuedRow>,
) -> rusqlite::Result<()> {
    let mut statement = transaction.prepare_cached(IssuedRow::INSERT_ADVICE)?;
    for row in rows {
        run!(statement, row.advice_hash.as_slice(), &row.advice)?;
    }
    Ok(())
}

fn insert_recommendations(transaction: &Transaction<'_>, rows: &[IssuedRow]) -> rusqlite::Result<()> {
    let mut statement = transaction.prepare_cached(RECOMMENDATIONS.one())?;
    for row in rows {
        run!(
            statement,
            &row.recommendation_id,
            row.advice_hash.as_slice(),
            row.issued_at_us,
            row.valid_until_us,
            row.level_as_run,
            row.level_lowest,
            row.level_highest,
            row.level_n,
            row.level_window,
            row.remaining_cycles,
            row.remaining_low,
            row.remaining_high,
            row.data_age_ms,
            row.level_decides,
            row.level_value,
            row.level_sd,
            &row.machine_id,
            &row.operation_id,
            &row.tool_id,
        )?;
    }
    Ok(())
}

//! Folds that groups of one transaction have counted, and that are written once, before its commit.
//!
//! Machines that post one cycle after another change their tools' folds with every group. Each of them is a row of some
//! hundred bytes, packed out of some thousand; all but the last of a transaction are read by nobody.

use super::group_writer::Assumption;
use crate::error::{StoreError, StoreResult};
use crate::rows::SavedWear;
use feedwright_core::ids::{MachineId, ToolId};
use feedwright_core::units::Timestamp;
use rusqlite::Connection;
use std::collections::BTreeMap;
use std::sync::Arc;

/// What is acknowledged of the folds and not written; empty between two transactions.
#[derive(Debug, Default)]
pub(super) struct Folds {
    /// All machines' folds of each tool that a group of the transaction rested on.
    tools: BTreeMap<ToolId, BTreeMap<MachineId, Fold>>,
}

/// One machine's fold of a tool.
#[derive(Debug)]
struct Fold {
    /// Its version after the last group.
    version: i64,
    /// What the row is to be, where it is not that yet.
    unsaved: Option<Unsaved>,
}

#[derive(Debug)]
struct Unsaved {
    row: Arc<SavedWear>,
    at: Timestamp,
    /// The version of the row that is stored; 0 where there is none.
    stored: i64,
}

impl Folds {
    /// The versions of a tool's folds, where a group of this transaction has rested on them.
    pub(super) fn versions(&self, tool: &ToolId) -> Option<impl Iterator<Item = (&MachineId, i64)>> {
        self.tools.get(tool).map(|machines| machines.iter().map(|(machine, fold)| (machine, fold.version)))
    }

    /// Keeps what a group has counted that was acknowledged.
    pub(super) fn keep(&mut self, assumption: Assumption<'_>, rows: &[Arc<SavedWear>], at: Timestamp) {
        for tool in assumption.tools {
            if !self.tools.contains_key(*tool) {
                let folds = assumption.versions(tool);
                let folds =
                    folds.map(|(machine, version)| (machine.clone(), Fold { version, unsaved: None }));
                self.tools.insert((*tool).clone(), folds.collect());
            }
        }
        for row in rows {
            let fold = self.tools.entry(row.tool_id.clone()).or_default().entry(row.machine_id.clone());
            let fold = fold.or_insert(Fold { version: 0, unsaved: None });
            fold.version = row.version + 1;
            let stored = fold.unsaved.as_ref().map_or(row.version, |unsaved| unsaved.stored);
            fold.unsaved = Some(Unsaved { row: Arc::clone(row), at, stored });
        }
    }

    fn unsaved(&self, row: &SavedWear) -> Option<&Unsaved> {
        self.tools.get(&row.tool_id)?.get(&row.machine_id)?.unsaved.as_ref()
    }

    /// Writes them into the transaction that is open, the last group's in place of what was kept of the same ones. They stay
    /// here until [`Folds::forget`].
    pub(super) fn save(
        &self,
        conn: &Connection,
        last: Option<(&[Arc<SavedWear>], Timestamp)>,
    ) -> StoreResult<()> {
        let (last, at) = last.unwrap_or((&[], Timestamp::from_micros(0)));
        for row in last {
            let stored = self.unsaved(row).map_or(row.version, |unsaved| unsaved.stored);
            write(conn, row, at, stored)?;
        }
        let kept = self.tools.values().flat_map(BTreeMap::values).filter_map(|fold| fold.unsaved.as_ref());
        for Unsaved { row, at, stored } in kept {
            let is_later =
                |last: &Arc<SavedWear>| (&last.tool_id, &last.machine_id) == (&row.tool_id, &row.machine_id);
            if !last.iter().any(is_later) {
                write(conn, row, *at, *stored)?;
            }
        }
        Ok(())
    }

    /// They are committed.
    pub(super) fn forget(&mut self) {
        self.tools.clear();
    }
}

/// Writes a fold over the version that is known to be in force.
fn write(conn: &Connection, row: &SavedWear, at: Timestamp, stored: i64) -> StoreResult<()> {
    let (state, at, version) = (row.state.stored(), at.micros(), row.version + 1);
    let fold_version = row.state.version();
    let (machine, tool) = (row.machine_id.as_str(), row.tool_id.as_str());
    let written = if stored > 0 {
        conn.prepare_cached(
            "UPDATE tool_wear SET folded = ?, fold_version = ?, state = ?, updated_at_us = ?, version = ?,
                 judging_change = ?, ran = ?
             WHERE machine_id = ? AND tool_id = ? AND version = ?",
        )?
        .execute((
            row.folded,
            fold_version,
            state,
            at,
            version,
            row.judging_change,
            &row.ran,
            machine,
            tool,
            stored,
        ))?
    } else {
        conn.prepare_cached(
            "INSERT INTO tool_wear (folded, fold_version, state, updated_at_us, version, judging_change,
                 ran, machine_id, tool_id)
             VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
        )?
        .execute((
            row.folded,
            fold_version,
            state,
            at,
            version,
            row.judging_change,
            &row.ran,
            machine,
            tool,
        ))?
    };
    if written != 1 {
        // Its cycles would be stored and not counted.
        return Err(StoreError::Damaged { what: format!("the fold of tool {} is gone", row.tool_id) });
    }
    Ok(())
}

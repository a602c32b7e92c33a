//! Blocks that groups of one transaction bring, and that are written before its commit: all of them together fill pages, the few of a
//! group do not.

use super::dialect::{PACK, PLACES, packs};
use crate::rows::BlockRow;
use rusqlite::Connection;

/// What is run of blocks and not written; empty between two transactions.
#[derive(Debug, Default)]
pub(super) struct Blocks {
    rows: Vec<BlockRow<'static>>,
    /// So many of them are of groups that are acknowledged.
    acknowledged: usize,
}

impl Blocks {
    /// Adds what a group brings.
    pub(super) fn add(&mut self, rows: &[BlockRow<'_>]) {
        self.rows.extend(rows.iter().map(BlockRow::to_owned));
    }

    /// The group is acknowledged.
    pub(super) const fn keep(&mut self) {
        self.acknowledged = self.rows.len();
    }

    /// The group that was run last is not: what it brought is not written.
    pub(super) fn take_back(&mut self) {
        self.rows.truncate(self.acknowledged);
    }

    /// Writes them into the transaction that is open. They stay here until [`Blocks::forget`].
    pub(super) fn save(&self, conn: &Connection) -> rusqlite::Result<()> {
        if self.rows.is_empty() {
            return Ok(());
        }
        let (mut pack, mut place) = (conn.prepare_cached(PACK)?, conn.prepare_cached(PLACES.one())?);
        for rows in packs(&self.rows) {
            pack.execute([&*BlockRow::pack(rows)])?;
            for (at, row) in (0_i64..).zip(rows) {
                place.execute((&row.machine_id, row.received_at_us, &row.cycle_id, at, row.bytes()))?;
            }
        }
        Ok(())
    }

    /// They are committed.
    pub(super) fn forget(&mut self) {
        self.rows.clear();
        self.acknowledged = 0;
    }
}

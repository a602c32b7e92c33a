//! A group whose heads are remembered is written without a question before: as a whole by the writer of groups, or, where
//! something has to be asked on the way, in a transaction whose first statement fails where the heads are not those in
//! force. The insertion of a cycle that is stored already fails in both.

use super::many::begin_and_insert;
use crate::error::{StoreError, StoreResult};
use crate::rows::{CycleRow, Rest};
use crate::sqlite::engine::Heads;
use crate::sqlite::group_writer::Assumption;
use crate::sqlite::{Conn, Writer};
use crate::work::Written;
use feedwright_core::ids::ToolId;
use feedwright_core::units::Timestamp;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::sync::Arc;

pub(in crate::sqlite) const MAY_ASSUME: bool = true;

/// Begins a transaction, and fails by a constraint where the heads are other ones: it would insert a row that
/// `write_probe_one_row` forbids. Where they hold it writes nothing.
pub(super) const BEGIN: &str = "BEGIN IMMEDIATE;
     INSERT INTO write_probe (probe_id, probed_at_us) SELECT 0, 0
     WHERE (SELECT SUM(changes) FROM registry_generation) IS NOT ?
        OR EXISTS (SELECT 1 FROM feed_profiles WHERE active_version IS NOT NULL) IS NOT ?
        OR (SELECT group_concat(tool_id || ' ' || machine_id || ' ' || version || ';', '')
            FROM (SELECT tool_id, machine_id, version FROM tool_wear
                  WHERE tool_id IN (SELECT value FROM json_each(?)) ORDER BY tool_id, machine_id)) IS NOT ?";

/// What a group rests on that takes these heads for granted.
pub(in crate::sqlite) const fn assume<'h>(
    heads: &'h Heads,
    tools: &'h BTreeSet<&'h ToolId>,
) -> Option<Assumption<'h>> {
    Some(Assumption { heads, tools })
}

/// The heads' versions as [`BEGIN`] makes them of what is stored; `None` where there are none.
pub(super) fn versions_text(heads: &Heads) -> Option<String> {
    let mut versions = String::new();
    for (tool, of_tool) in &heads.versions {
        for (machine, version) in of_tool {
            write!(versions, "{tool} {machine} {version};").ok()?;
        }
    }
    (!versions.is_empty()).then_some(versions)
}

/// Begins the transaction of a group that is not written as a whole, and inserts its cycles; `false` where what was
/// assumed does not hold.
pub(in crate::sqlite) async fn begin_assumed(
    conn: &mut Conn,
    assumption: Assumption<'_>,
    cycles: &[Arc<CycleRow>],
) -> StoreResult<bool> {
    Ok(held(begin_and_insert(conn, assumption, cycles).await)?.is_some())
}

/// Writes a whole group, durably; `None` where what was assumed does not hold.
pub(in crate::sqlite) fn write_assumed(
    writer: &mut Writer,
    assumption: Assumption<'_>,
    cycles: &[Arc<CycleRow>],
    rest: &Rest<'_>,
    now: Timestamp,
) -> StoreResult<Option<Written>> {
    held(writer.groups.write(assumption, cycles, rest, now)).map(Option::flatten)
}

/// A constraint says that an assumption does not hold, or that the row itself is bad: who asks first finds out which.
fn held<T>(outcome: StoreResult<T>) -> StoreResult<Option<T>> {
    match outcome {
        Ok(value) => Ok(Some(value)),
        Err(StoreError::Refused { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Rolls back what a group has begun whose assumptions did not hold.
pub(in crate::sqlite) async fn undo(writer: &mut Writer) {
    // Where it never began there is nothing to roll back; an error of the disk is met again by whoever begins next.
    if let Err(error) = sqlx::query("ROLLBACK").execute(writer.asked()).await {
        tracing::debug!(%error, "nothing to roll back");
    }
}

//! A group whose heads are remembered is written without a question before: its first statement fails where they are not
//! those in force, and so does the insertion of a cycle that is stored already.

use super::list;
use super::many::{begin_and_insert, write_everything, write_rest};
use crate::error::{StoreError, StoreResult};
use crate::rows::{CycleRow, Rest};
use crate::sqlite::Conn;
use crate::sqlite::engine::Heads;
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

/// Heads as [`BEGIN`] asks for them.
#[derive(Debug)]
pub(in crate::sqlite) struct Assumption {
    pub(super) generation: i64,
    pub(super) any_profile: bool,
    /// Tools of the group, as a list in JSON.
    pub(super) tools: String,
    /// The versions of their folds, where there are any.
    pub(super) versions: Option<String>,
}

/// What a group rests on that takes these heads for granted.
pub(in crate::sqlite) fn assume(heads: &Heads, tools: &BTreeSet<&ToolId>) -> Option<Assumption> {
    let mut versions = String::new();
    for (tool, of_tool) in &heads.versions {
        for (machine, version) in of_tool {
            write!(versions, "{tool} {machine} {version};").ok()?;
        }
    }
    Some(Assumption {
        generation: heads.generation,
        any_profile: heads.any_profile,
        tools: list(tools.iter().map(|tool| tool.as_str())),
        versions: (!versions.is_empty()).then_some(versions),
    })
}

/// Begins the transaction of a group and inserts its cycles; `false` where what was assumed does not hold.
pub(in crate::sqlite) async fn begin_assumed(
    conn: &mut Conn,
    assumption: &Assumption,
    cycles: &[Arc<CycleRow>],
) -> StoreResult<bool> {
    Ok(held(begin_and_insert(conn, assumption, cycles).await)?.is_some())
}

/// Writes a whole group and commits it; `None` where what was assumed does not hold.
pub(in crate::sqlite) async fn write_assumed(
    conn: &mut Conn,
    assumption: &Assumption,
    cycles: &[Arc<CycleRow>],
    rest: &Rest<'_>,
    now: Timestamp,
) -> StoreResult<Option<Written>> {
    if let Some(outcome) = write_everything(conn, assumption, cycles, rest, now).await {
        return held(outcome);
    }
    if !begin_assumed(conn, assumption, cycles).await? {
        return Ok(None);
    }
    write_rest(conn, rest, now).await.map(Some)
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
pub(in crate::sqlite) async fn undo(conn: &mut Conn) {
    // Where it never began there is nothing to roll back; an error of the disk is met again by whoever begins next.
    if let Err(error) = sqlx::query("ROLLBACK").execute(&mut *conn).await {
        tracing::debug!(%error, "nothing to roll back");
    }
}

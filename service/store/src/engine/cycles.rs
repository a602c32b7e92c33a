//! Cycles and their samples: rows in and out.

use super::{Conn, Db, dialect};
use crate::codec;
use crate::error::StoreResult;
use crate::record::{CycleFilter, CycleKey, Page, StoredCycle};
use crate::rows::{CycleRow, CycleWithSamples, ReportedCutRow, cycle_columns};
use feedwright_core::cycle::{Cycle, MOST_SAMPLES, differences};
use feedwright_core::ids::{CycleId, MachineId, OperationId, ToolId};
use feedwright_core::units::Timestamp;

macro_rules! select_columns {
    ($($column:ident: $type:ty = $placeholder:literal $(in $least:literal..=$most:literal)?,)*) => {
        concat!("SELECT ", $("c.", stringify!($column), ", ",)*)
    };
}

// `$samples_of`, where it is known, names the machine of the samples once more by its parameter: a database of several
// nodes asks one of them then, as it does not look through the condition inside.
macro_rules! select {
    (samples $samples_of:literal, $($tail:expr),+) => {
        concat!(
            cycle_columns!(select_columns),
            "EXISTS (SELECT 1 FROM cycle_samples s WHERE s.machine_id = c.machine_id
                         AND s.received_at_us = c.received_at_us AND s.cycle_id = c.cycle_id", $samples_of,
            ") AS has_samples
             FROM cycles c ", $($tail),+
        )
    };
    ($($tail:expr),+) => { select!(samples "", $($tail),+) };
}

pub(super) async fn get(
    conn: &mut Conn,
    machine: &MachineId,
    id: &CycleId,
) -> StoreResult<Option<StoredCycle>> {
    row(conn, machine, id).await?.map(|row| row.stored()).transpose()
}

async fn row(conn: &mut Conn, machine: &MachineId, id: &CycleId) -> StoreResult<Option<CycleWithSamples>> {
    let query = sqlx::query_as::<Db, _>(
        select!(samples " AND s.machine_id = $1", "WHERE c.machine_id = $1 AND c.cycle_id = $2"),
    );
    Ok(query.bind(machine.as_str()).bind(id.as_str()).fetch_optional(&mut *conn).await?)
}

/// What was reported of a cycle's cut.
pub(super) async fn cut(
    conn: &mut Conn,
    machine: &MachineId,
    id: &CycleId,
) -> StoreResult<Option<ReportedCutRow>> {
    let query = sqlx::query_as::<Db, _>(
        "SELECT cutting_speed_m_min, feed_mm_rev, spindle_power_watts, thrust_newtons, edge_wear_mm
         FROM cycle_cuts WHERE machine_id = $1 AND cycle_id = $2",
    );
    Ok(query.bind(machine.as_str()).bind(id.as_str()).fetch_optional(&mut *conn).await?)
}

/// What is stored of a cycle's content.
pub(super) struct Content {
    row: CycleRow,
    cut: Option<ReportedCutRow>,
    block: Option<Vec<u8>>,
}

impl Content {
    /// Paths of the fields in which `sent`, which is another content, differs.
    pub(super) fn differences(self, sent: &Cycle) -> StoreResult<Vec<String>> {
        let Self { row, cut, block } = self;
        let are_gone = block.is_none() && row.sample_count > 0;
        let samples = block.map(|block| codec::decode_samples(&block, MOST_SAMPLES)).transpose()?;
        let known = (!are_gone).then_some(samples.as_ref());
        let mut paths = differences(&row.draft(None, cut)?, known, sent);
        // The contents are not the same, so it is what cannot be looked at any more.
        if are_gone && paths.is_empty() {
            paths.push("samples".to_owned());
        }
        Ok(paths)
    }
}

pub(super) async fn content(
    conn: &mut Conn,
    machine: &MachineId,
    id: &CycleId,
) -> StoreResult<Option<Content>> {
    let Some(CycleWithSamples { cycle, .. }) = row(conn, machine, id).await? else {
        return Ok(None);
    };
    let (cut, block) = (cut(conn, machine, id).await?, dialect::block(conn, machine, id).await?);
    Ok(Some(Content { row: cycle, cut, block }))
}

// The first condition drives an index, in whose order the rows come; the others are checked on the way. `started_at_us` stands
// twice, as an engine that cannot use a row comparison for a range begins where the single bound says, and another where the row
// does: both have to say the same, see `behind`.
macro_rules! page {
    (samples $samples_of:literal, $(of $column:literal = $value:literal,)? $driver:literal) => {
        select!(
            samples $samples_of,
            "WHERE ",
            $(dialect::of_one!($column, $value), " AND ",)?
            $driver,
            " AND c.started_at_us >= $4 AND c.started_at_us < $5
              AND (c.started_at_us, c.machine_id, COALESCE(c.seq, -1), c.cycle_id) > ($6, $7, COALESCE(
                  (SELECT k.seq FROM cycles k WHERE k.machine_id = $7 AND k.cycle_id = $8), -1), $8)
              ORDER BY ", $($column, ", ",)?
            "c.started_at_us, c.machine_id, COALESCE(c.seq, -1), c.cycle_id LIMIT $9"
        )
    };
    ($($rest:tt)+) => { page!(samples "", $($rest)+) };
}

pub(in super::super) const OF_TOOL: &str = page!(
    of "c.tool_id" = "$1",
    "(CAST($2 AS TEXT) IS NULL OR c.machine_id = $2) AND (CAST($3 AS TEXT) IS NULL OR c.operation_id = $3)"
);
pub(in super::super) const OF_MACHINE: &str = page!(
    samples " AND s.machine_id = $2",
    of "c.machine_id" = "$2",
    "(CAST($1 AS TEXT) IS NULL OR c.tool_id = $1) AND (CAST($3 AS TEXT) IS NULL OR c.operation_id = $3)"
);
pub(in super::super) const OF_OPERATION: &str = page!(
    of "c.operation_id" = "$3",
    "(CAST($1 AS TEXT) IS NULL OR c.tool_id = $1) AND (CAST($2 AS TEXT) IS NULL OR c.machine_id = $2)"
);
pub(in super::super) const OF_ALL: &str = page!(
    "(CAST($1 AS TEXT) IS NULL OR c.tool_id = $1) AND (CAST($2 AS TEXT) IS NULL OR c.machine_id = $2)
     AND (CAST($3 AS TEXT) IS NULL OR c.operation_id = $3)"
);

/// The time and key behind which a page begins: those of its cursor, or of no cycle at `from`, before which nothing comes. With a row at the
/// beginning of time, which says as much, PostgreSQL would go through its index from there up to `from`.
pub(super) fn behind<'p>(filter: &CycleFilter, page: &'p Page<CycleKey>) -> (i64, &'p str, &'p str) {
    let from = filter.from.map_or(i64::MIN, Timestamp::micros);
    match &page.after {
        Some((at, machine, cycle)) if at.micros() >= from => (at.micros(), machine.as_str(), cycle.as_str()),
        _ => (from, "", ""),
    }
}

pub(super) async fn list(
    conn: &mut Conn,
    filter: &CycleFilter,
    page: &Page<CycleKey>,
) -> StoreResult<Vec<StoredCycle>> {
    let sql = match filter {
        CycleFilter { tool: Some(_), .. } => OF_TOOL,
        CycleFilter { machine: Some(_), .. } => OF_MACHINE,
        CycleFilter { operation: Some(_), .. } => OF_OPERATION,
        _ => OF_ALL,
    };
    let (after_at, after_machine, after_cycle) = behind(filter, page);
    let rows: Vec<CycleWithSamples> = sqlx::query_as::<Db, _>(sql)
        .bind(filter.tool.as_ref().map(ToolId::as_str))
        .bind(filter.machine.as_ref().map(MachineId::as_str))
        .bind(filter.operation.as_ref().map(OperationId::as_str))
        .bind(after_at)
        .bind(filter.to.map_or(i64::MAX, |to| to.micros()))
        .bind(after_at)
        .bind(after_machine)
        .bind(after_cycle)
        .bind(i64::from(page.limit))
        .fetch_all(&mut *conn)
        .await?;
    rows.iter().map(CycleWithSamples::stored).collect()
}

/// The last cycles that ran version `$2` of profile `$1`, newest first.
pub(super) const LAST_OF_PROFILE: &str = select!(
    "WHERE c.profile_id = $1 AND c.profile_version = $2
     ORDER BY c.started_at_us DESC, c.machine_id DESC, COALESCE(c.seq, -1) DESC, c.cycle_id DESC LIMIT $3"
);

/// The last cycles of operation `$1` with tools of type `$2`, newest first.
pub(super) const LAST_WITH_TOOL_TYPE: &str = select!(
    "JOIN tools t ON t.tool_id = c.tool_id WHERE ",
    dialect::of_one!("c.operation_id", "$1"),
    " AND t.tool_type = $2
     ORDER BY c.operation_id DESC, c.started_at_us DESC, c.machine_id DESC, COALESCE(c.seq, -1) DESC, c.cycle_id DESC LIMIT $3"
);

macro_rules! newest {
    (samples $samples_of:literal, $(of $column:literal = $value:literal,)? $driver:literal) => {
        select!(
            samples $samples_of,
            "WHERE ",
            $(dialect::of_one!($column, $value), " AND ",)?
            $driver,
            " AND c.started_at_us >= $4 AND c.started_at_us < $5
              ORDER BY ", $($column, " DESC, ",)?
            "c.started_at_us DESC, c.machine_id DESC, COALESCE(c.seq, -1) DESC, c.cycle_id DESC LIMIT $6"
        )
    };
    ($($rest:tt)+) => { newest!(samples "", $($rest)+) };
}

pub(in super::super) const LAST_OF_TOOL: &str = newest!(
    of "c.tool_id" = "$1",
    "(CAST($2 AS TEXT) IS NULL OR c.machine_id = $2) AND (CAST($3 AS TEXT) IS NULL OR c.operation_id = $3)"
);
pub(in super::super) const LAST_OF_MACHINE: &str = newest!(
    samples " AND s.machine_id = $2",
    of "c.machine_id" = "$2",
    "(CAST($1 AS TEXT) IS NULL OR c.tool_id = $1) AND (CAST($3 AS TEXT) IS NULL OR c.operation_id = $3)"
);
pub(in super::super) const LAST_OF_OPERATION: &str = newest!(
    of "c.operation_id" = "$3",
    "(CAST($1 AS TEXT) IS NULL OR c.tool_id = $1) AND (CAST($2 AS TEXT) IS NULL OR c.machine_id = $2)"
);
pub(in super::super) const LAST_OF_ALL: &str = newest!(
    "(CAST($1 AS TEXT) IS NULL OR c.tool_id = $1) AND (CAST($2 AS TEXT) IS NULL OR c.machine_id = $2)
     AND (CAST($3 AS TEXT) IS NULL OR c.operation_id = $3)"
);

/// The newest cycles, oldest of them first.
pub(super) async fn last(conn: &mut Conn, filter: &CycleFilter, limit: u32) -> StoreResult<Vec<StoredCycle>> {
    let sql = match filter {
        CycleFilter { tool: Some(_), .. } => LAST_OF_TOOL,
        CycleFilter { machine: Some(_), .. } => LAST_OF_MACHINE,
        CycleFilter { operation: Some(_), .. } => LAST_OF_OPERATION,
        _ => LAST_OF_ALL,
    };
    let rows: Vec<CycleWithSamples> = sqlx::query_as::<Db, _>(sql)
        .bind(filter.tool.as_ref().map(ToolId::as_str))
        .bind(filter.machine.as_ref().map(MachineId::as_str))
        .bind(filter.operation.as_ref().map(OperationId::as_str))
        .bind(filter.from.map_or(i64::MIN, |from| from.micros()))
        .bind(filter.to.map_or(i64::MAX, |to| to.micros()))
        .bind(i64::from(limit))
        .fetch_all(&mut *conn)
        .await?;
    rows.iter().rev().map(CycleWithSamples::stored).collect()
}

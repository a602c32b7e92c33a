//! Many rows in one statement: an array per column, so that one prepared statement takes any number of rows.

use crate::codec::state;
use crate::error::{StoreError, StoreResult};
use crate::postgres::Conn;
use crate::rows::{BlockRow, CycleRow, IssuedRow, Rest, SavedWear, cycle_columns};
use crate::work::Written;
use feedwright_core::units::Timestamp;
use feedwright_core::wear::FOLD_VERSION;
use std::collections::HashSet;
use std::sync::Arc;

macro_rules! cycles {
    ($($column:ident: $type:ty = $placeholder:literal $(in $least:literal..=$most:literal)?,)*) => {
        concat!(
            "INSERT INTO cycles (", cycles!(@list $(stringify!($column),)*), ") SELECT * FROM UNNEST(",
            cycles!(@list $($placeholder,)*),
            ") ON CONFLICT (machine_id, cycle_id) DO NOTHING RETURNING machine_id, cycle_id"
        )
    };
    (@list $first:expr, $($rest:expr,)*) => { concat!($first $(, ", ", $rest)*) };
}

const CYCLES: &str = cycle_columns!(cycles);

/// Inserts cycles of different keys, in their order; returns the keys of those that were known before.
pub(in crate::postgres) async fn insert_cycles(
    conn: &mut Conn,
    rows: &[Arc<CycleRow>],
) -> StoreResult<Vec<(String, String)>> {
    if rows.is_empty() {
        return Ok(Vec::new());
    }
    let query = sqlx::query_as(CYCLES);
    macro_rules! bind {
        ($($column:ident: $type:ty = $placeholder:literal $(in $least:literal..=$most:literal)?,)*) => {
            query $(.bind(rows.iter().map(|row| row.$column.clone()).collect::<Vec<$type>>()))*
        };
    }
    let new: HashSet<(String, String)> =
        cycle_columns!(bind).fetch_all(&mut *conn).await?.into_iter().collect();
    if new.len() == rows.len() {
        return Ok(Vec::new());
    }
    let keys = rows.iter().map(|row| (row.machine_id.clone(), row.cycle_id.clone()));
    Ok(keys.filter(|key| !new.contains(key)).collect())
}

/// Inserts the sample blocks of cycles.
async fn insert_blocks(conn: &mut Conn, rows: &[BlockRow<'_>]) -> StoreResult<()> {
    if rows.is_empty() {
        return Ok(());
    }
    sqlx::query(
        "INSERT INTO cycle_samples (machine_id, received_at_us, cycle_id, block)
         SELECT * FROM UNNEST($1, $2, $3, $4)",
    )
    .bind(rows.iter().map(|row| row.machine_id.as_str()).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.received_at_us).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.cycle_id.as_str()).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| &*row.block).collect::<Vec<_>>())
    .execute(&mut *conn)
    .await?;
    Ok(())
}

/// Writes the folds of machines and tools, each over the very version that it was made of. Locks see to that; where a
/// database of several nodes shows a commit later than it was told, a newer fold must not be lost all the same.
pub(in crate::postgres) async fn save_wear(
    conn: &mut Conn,
    rows: &[Arc<SavedWear>],
    now: Timestamp,
) -> StoreResult<()> {
    if rows.is_empty() {
        return Ok(());
    }
    let written: Vec<i64> = sqlx::query_scalar(
        "INSERT INTO tool_wear (machine_id, tool_id, folded, fold_version, state, version, updated_at_us)
         SELECT machine_id, tool_id, folded, $5, state, version + 1, $6
         FROM UNNEST($1, $2, $3, $4, $7) AS saved (machine_id, tool_id, folded, state, version)
         ON CONFLICT (machine_id, tool_id) DO UPDATE SET folded = excluded.folded,
             fold_version = excluded.fold_version, state = excluded.state, version = excluded.version,
             updated_at_us = excluded.updated_at_us
         WHERE tool_wear.version = excluded.version - 1
         RETURNING version",
    )
    .bind(rows.iter().map(|row| row.machine_id.as_str()).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.tool_id.as_str()).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.folded).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| state::pack(&row.state)).collect::<Vec<_>>())
    .bind(i64::from(FOLD_VERSION))
    .bind(now.micros())
    .bind(rows.iter().map(|row| row.version).collect::<Vec<_>>())
    .fetch_all(&mut *conn)
    .await?;
    if written.len() < rows.len() {
        return Err(StoreError::Unavailable("a tool's fold is newer than the one it was counted on".into()));
    }
    Ok(())
}

/// Inserts recommendations whose advice is kept.
pub(in crate::postgres) async fn insert_recommendations(
    conn: &mut Conn,
    rows: &[IssuedRow],
) -> StoreResult<()> {
    if rows.is_empty() {
        return Ok(());
    }
    sqlx::query(
        "INSERT INTO recommendations (recommendation_id, advice_hash, issued_at_us, valid_until_us, level_as_run,
             level_lowest, level_highest, level_n, level_window, remaining_cycles, remaining_low, remaining_high,
             data_age_ms, level_decides, level_value, level_sd, machine_id, operation_id, tool_id)
         SELECT * FROM UNNEST($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16, $17, $18, $19)",
    )
    .bind(rows.iter().map(|row| row.recommendation_id.as_str()).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.advice.hash.as_slice()).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.issued_at_us).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.valid_until_us).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.level_as_run).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.level_lowest).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.level_highest).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.level_n).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.level_window).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.remaining_cycles).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.remaining_low).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.remaining_high).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.data_age_ms).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.level_decides).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.level_value).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.level_sd).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.machine_id.as_str()).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.operation_id.as_str()).collect::<Vec<_>>())
    .bind(rows.iter().map(|row| row.tool_id.as_str()).collect::<Vec<_>>())
    .execute(&mut *conn)
    .await?;
    Ok(())
}

/// Writes the rest of a group.
pub(in crate::postgres) async fn write_rest(
    conn: &mut Conn,
    rest: &Rest<'_>,
    now: Timestamp,
) -> StoreResult<Written> {
    insert_blocks(conn, &rest.blocks).await?;
    save_wear(conn, &rest.wear, now).await?;
    insert_recommendations(conn, &rest.issued).await?;
    Ok(Written::whole())
}

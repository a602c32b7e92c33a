//! Many rows in one statement: an array per column, so that one prepared statement takes any number of rows.

use crate::error::{StoreError, StoreResult};
use crate::postgres::Conn;
use crate::rows::{BlockRow, CycleRow, IssuedRow, Rest, SavedWear, cycle_columns};
use crate::work::Written;
use feedwright_core::units::Timestamp;
use sqlx::AssertSqlSafe;
use sqlx::postgres::{PgArguments, PgRow};
use sqlx::query::Query;
use std::collections::HashSet;
use std::fmt::Write;
use std::sync::{Arc, LazyLock};

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

/// Blocks of samples, see [`bind_blocks`].
const BLOCKS: &str = "INSERT INTO cycle_samples (machine_id, received_at_us, cycle_id, block)
     SELECT * FROM UNNEST($1, $2, $3, $4)";

/// Folds, see [`bind_wear`]: each over the very version that it was made of. Locks see to that; where a database of several nodes
/// shows a commit later than it was told, a newer fold must not be lost all the same.
const WEAR: &str =
    "INSERT INTO tool_wear (machine_id, tool_id, folded, fold_version, state, version, updated_at_us, judging_change, ran)
     SELECT machine_id, tool_id, folded, fold_version, state, version + 1, $7, judging_change, ran
     FROM UNNEST($1, $2, $3, $4, $5, $6, $8, $9)
         AS saved (machine_id, tool_id, folded, state, version, fold_version, judging_change, ran)
     ON CONFLICT (machine_id, tool_id) DO UPDATE SET folded = excluded.folded,
         fold_version = excluded.fold_version, state = excluded.state, version = excluded.version,
         updated_at_us = excluded.updated_at_us, judging_change = excluded.judging_change,
         ran = excluded.ran
     WHERE tool_wear.version = excluded.version - 1
     RETURNING version";

/// Recommendations whose advice is kept, see [`bind_recommendations`].
const RECOMMENDATIONS: &str =
    "INSERT INTO recommendations (recommendation_id, advice_hash, issued_at_us, valid_until_us, level_as_run,
         level_lowest, level_highest, level_n, level_window, remaining_cycles, remaining_low, remaining_high,
         data_age_ms, level_decides, level_value, level_sd, machine_id, operation_id, tool_id)
     SELECT * FROM UNNEST($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16, $17, $18, $19)";

/// All three by one statement, bound in this order: each statement of a group is waited for by everybody in it.
static REST: LazyLock<String> = LazyLock::new(|| {
    format!(
        "WITH blocks AS ({BLOCKS}), given AS ({}) {}",
        numbered_after(RECOMMENDATIONS, 4),
        numbered_after(WEAR, 4 + 19)
    )
});

/// A statement whose first parameter is not `$1` but the one after so many.
fn numbered_after(sql: &str, before: u32) -> String {
    let mut parts = sql.split('$');
    let mut numbered = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let digits = part.bytes().take_while(u8::is_ascii_digit).count();
        let (number, rest) = part.split_at(digits);
        let number: u32 = number.parse().unwrap_or_default();
        // Infallible: into memory.
        let _ = write!(numbered, "${}{rest}", number + before);
    }
    numbered
}

type Bound<'q> = Query<'q, sqlx::Postgres, PgArguments>;

fn bind_blocks<'q>(query: Bound<'q>, rows: &'q [BlockRow<'_>]) -> Bound<'q> {
    query
        .bind(rows.iter().map(|row| row.machine_id.as_str()).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.received_at_us).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.cycle_id.as_str()).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| &*row.block).collect::<Vec<_>>())
}

fn bind_wear<'q>(query: Bound<'q>, rows: &'q [Arc<SavedWear>], now: Timestamp) -> Bound<'q> {
    query
        .bind(rows.iter().map(|row| row.machine_id.as_str()).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.tool_id.as_str()).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.folded).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.state.stored()).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.version).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.state.version()).collect::<Vec<_>>())
        .bind(now.micros())
        .bind(rows.iter().map(|row| row.judging_change).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.ran.as_deref()).collect::<Vec<_>>())
}

fn bind_recommendations<'q>(query: Bound<'q>, rows: &'q [IssuedRow]) -> Bound<'q> {
    query
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
}

/// Refuses folds that were not all written, which each gives back a row for.
fn all_written(folds: &[Arc<SavedWear>], written: &[PgRow]) -> StoreResult<()> {
    if written.len() < folds.len() {
        return Err(StoreError::Unavailable("a tool's fold is newer than the one it was counted on".into()));
    }
    Ok(())
}

/// Writes the folds of machines and tools, each over the very version that it was made of.
pub(in crate::postgres) async fn save_wear(
    conn: &mut Conn,
    rows: &[Arc<SavedWear>],
    now: Timestamp,
) -> StoreResult<()> {
    if rows.is_empty() {
        return Ok(());
    }
    let written = bind_wear(sqlx::query(WEAR), rows, now).fetch_all(&mut *conn).await?;
    all_written(rows, &written)
}

/// Inserts recommendations whose advice is kept.
pub(in crate::postgres) async fn insert_recommendations(
    conn: &mut Conn,
    rows: &[IssuedRow],
) -> StoreResult<()> {
    if !rows.is_empty() {
        bind_recommendations(sqlx::query(RECOMMENDATIONS), rows).execute(&mut *conn).await?;
    }
    Ok(())
}

/// Writes the rest of a group: by one statement, or each table by its own where the database is distributed, as Citus does not divide such a
/// statement among its nodes.
pub(in crate::postgres) async fn write_rest(
    conn: &mut Conn,
    rest: &Rest<'_>,
    now: Timestamp,
    is_distributed: bool,
) -> StoreResult<Written> {
    if is_distributed {
        if !rest.blocks.is_empty() {
            bind_blocks(sqlx::query(BLOCKS), &rest.blocks).execute(&mut *conn).await?;
        }
        save_wear(conn, &rest.wear, now).await?;
        insert_recommendations(conn, &rest.issued).await?;
        return Ok(Written::whole());
    }
    let query = bind_blocks(sqlx::query(AssertSqlSafe(REST.as_str())), &rest.blocks);
    let query = bind_wear(bind_recommendations(query, &rest.issued), &rest.wear, now);
    let written = query.fetch_all(&mut *conn).await?;
    all_written(&rest.wear, &written)?;
    Ok(Written::whole())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_of_one_statement_are_numbered_one_after_the_other() {
        let numbers: Vec<u32> = REST
            .split('$')
            .skip(1)
            .map(|part| part.split(|c: char| !c.is_ascii_digit()).next().unwrap().parse().unwrap())
            .collect();
        let mut sorted = numbers.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (1..=32).collect::<Vec<_>>(), "each once");
        assert_eq!(numbered_after("SELECT $2, $1, '' WHERE $10", 3), "SELECT $5, $4, '' WHERE $13");
    }
}

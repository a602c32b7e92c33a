//! Many rows in one statement: each statement is a hop to the connection's thread, which costs more than a row.
//!
//! Statements exist for 1, 4, 16 and 64 rows. What is left over goes into the next larger one, whose last rows have no
//! values: SQLite takes them as NULL, and rows whose first column is NULL are not inserted.

use crate::error::StoreResult;
use crate::rows::{CycleRow, IssuedRow, SavedWear, cycle_columns};
use crate::sqlite::Conn;
use feedwright_core::units::Timestamp;
use feedwright_core::wear::FOLD_VERSION;

type Query = sqlx::query::Query<'static, sqlx::Sqlite, sqlx::sqlite::SqliteArguments>;

/// Most rows in one statement.
const MOST: usize = 64;

/// Statements for 1, 4, 16 and 64 rows between a head and a tail.
macro_rules! statements {
    ($head:expr, $row:expr, $tail:expr) => {
        [
            concat!($head, $row, $tail),
            concat!($head, statements!(@4 $row), $tail),
            concat!($head, statements!(@16 $row), $tail),
            concat!(
                $head, statements!(@16 $row), ",", statements!(@16 $row), ",", statements!(@16 $row), ",",
                statements!(@16 $row), $tail
            ),
        ]
    };
    (@4 $row:expr) => { concat!($row, ",", $row, ",", $row, ",", $row) };
    (@16 $row:expr) => {
        concat!(statements!(@4 $row), ",", statements!(@4 $row), ",", statements!(@4 $row), ",", statements!(@4 $row))
    };
}

/// Place of the smallest statement that holds so many rows.
const fn size_of(rows: usize) -> usize {
    match rows {
        0 | 1 => 0,
        2..=4 => 1,
        5..=16 => 2,
        _ => 3,
    }
}

fn fitting(statements: &[&'static str; 4], rows: usize) -> Query {
    sqlx::query(statements[size_of(rows)])
}

macro_rules! cycles_head {
    ($($column:ident: $type:ty = $placeholder:literal,)*) => {
        concat!(
            "INSERT INTO cycles (", cycles_head!(@list $(stringify!($column),)*), ") SELECT * FROM (VALUES "
        )
    };
    (@list $first:expr, $($rest:expr,)*) => { concat!($first $(, ", ", $rest)*) };
}

macro_rules! cycles_row {
    ($($column:ident: $type:ty = $placeholder:literal,)*) => {
        concat!("(", cycles_row!(@list $($column,)*), ")")
    };
    (@list $first:ident, $($rest:ident,)*) => { concat!("?" $(, cycles_row!(@one $rest))*) };
    (@one $column:ident) => { ",?" };
}

const CYCLES: [&str; 4] = statements!(
    cycle_columns!(cycles_head),
    cycle_columns!(cycles_row),
    ") WHERE column1 IS NOT NULL ON CONFLICT (machine_id, cycle_id) DO NOTHING RETURNING machine_id, cycle_id"
);

/// Inserts cycles of different keys; returns the keys of those that are new.
pub(in crate::sqlite) async fn insert_cycles(
    conn: &mut Conn,
    rows: &[&CycleRow],
) -> StoreResult<Vec<(String, String)>> {
    let mut new = Vec::with_capacity(rows.len());
    for rows in rows.chunks(MOST) {
        let mut query = sqlx::query_as(CYCLES[size_of(rows.len())]);
        for row in rows {
            macro_rules! bind {
                ($($column:ident: $type:ty = $placeholder:literal,)*) => { query $(.bind(row.$column.clone()))* };
            }
            query = cycle_columns!(bind);
        }
        new.extend(query.fetch_all(&mut *conn).await?);
    }
    Ok(new)
}

const BLOCKS: [&str; 4] = statements!(
    "INSERT INTO cycle_samples (machine_id, received_at_us, cycle_id, block) SELECT * FROM (VALUES ",
    "(?,?,?,?)",
    ") WHERE column1 IS NOT NULL"
);

/// Inserts the sample blocks of cycles.
pub(in crate::sqlite) async fn insert_blocks(
    conn: &mut Conn,
    rows: &[(&CycleRow, &[u8])],
) -> StoreResult<()> {
    for rows in rows.chunks(MOST) {
        let mut query = fitting(&BLOCKS, rows.len());
        for (row, block) in rows {
            query = query
                .bind(row.machine_id.clone())
                .bind(row.received_at_us)
                .bind(row.cycle_id.clone())
                .bind(block.to_vec());
        }
        query.execute(&mut *conn).await?;
    }
    Ok(())
}

const WEAR: [&str; 4] = statements!(
    "INSERT INTO tool_wear (machine_id, tool_id, folded, fold_version, state, version, updated_at_us)
     SELECT * FROM (VALUES ",
    "(?,?,?,?,?,1,?)",
    ") WHERE column1 IS NOT NULL
     ON CONFLICT (machine_id, tool_id) DO UPDATE SET folded = excluded.folded,
         fold_version = excluded.fold_version, state = excluded.state, version = tool_wear.version + 1,
         updated_at_us = excluded.updated_at_us"
);

/// Writes the folds of machines and tools.
pub(in crate::sqlite) async fn save_wear(
    conn: &mut Conn,
    rows: &[SavedWear],
    now: Timestamp,
) -> StoreResult<()> {
    for rows in rows.chunks(MOST) {
        let mut query = fitting(&WEAR, rows.len());
        for row in rows {
            query = query
                .bind(row.machine_id.clone())
                .bind(row.tool_id.clone())
                .bind(row.folded)
                .bind(i64::from(FOLD_VERSION))
                .bind(row.state.clone())
                .bind(now.micros());
        }
        query.execute(&mut *conn).await?;
    }
    Ok(())
}

const RECOMMENDATIONS: [&str; 4] = statements!(
    "INSERT INTO recommendations (recommendation_id, advice_hash, issued_at_us, valid_until_us, level_as_run,
         level_lowest, level_highest, level_n, level_window, remaining_cycles, remaining_low, remaining_high,
         data_age_ms, level_decides, level_value, level_sd)
     SELECT * FROM (VALUES ",
    "(?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?)",
    ") WHERE column1 IS NOT NULL"
);

/// Inserts recommendations whose advice is kept.
pub(in crate::sqlite) async fn insert_recommendations(
    conn: &mut Conn,
    rows: &[IssuedRow],
) -> StoreResult<()> {
    for rows in rows.chunks(MOST) {
        let mut query = fitting(&RECOMMENDATIONS, rows.len());
        for row in rows {
            query = query
                .bind(row.recommendation_id.clone())
                .bind(row.advice_hash.to_vec())
                .bind(row.issued_at_us)
                .bind(row.valid_until_us)
                .bind(row.level_as_run)
                .bind(row.level_lowest)
                .bind(row.level_highest)
                .bind(row.level_n)
                .bind(row.level_window)
                .bind(row.remaining_cycles)
                .bind(row.remaining_low)
                .bind(row.remaining_high)
                .bind(row.data_age_ms)
                .bind(row.level_decides)
                .bind(row.level_value)
                .bind(row.level_sd);
        }
        query.execute(&mut *conn).await?;
    }
    Ok(())
}

//! Many rows in one statement: each statement is a hop to the connection's thread, which costs as much as a row.
//!
//! There is a statement for each number of rows up to 16, and for 32 and 64: rows to fill one up would cost SQLite as
//! much as rows that are there.

use crate::error::StoreResult;
use crate::rows::{CycleRow, IssuedRow, SavedWear, cycle_columns};
use crate::sqlite::Conn;
use feedwright_core::units::Timestamp;
use feedwright_core::wear::FOLD_VERSION;
use std::sync::LazyLock;

/// Numbers of rows beyond which there is not a statement for each.
const EACH: usize = 16;
const LARGER: [usize; 2] = [32, 64];

/// One statement for several numbers of rows, made once in the life of the process.
struct Statements {
    texts: Vec<&'static str>,
}

impl Statements {
    fn new(head: &str, row: &str, tail: &str) -> Self {
        let text = |rows| &*format!("{head}{}{tail}", vec![row; rows].join(",")).leak();
        Self { texts: (1..=EACH).chain(LARGER).map(text).collect() }
    }

    /// The statement for as many of the rows as there is one for, and those rows and the rest.
    fn first<'r, T>(&self, rows: &'r [T]) -> Option<(&'static str, &'r [T], &'r [T])> {
        let (place, count) = match rows.len() {
            0 => return None,
            count @ 1..=EACH => (count - 1, count),
            17..=31 => (EACH - 1, EACH),
            32..=63 => (EACH, LARGER[0]),
            _ => (EACH + 1, LARGER[1]),
        };
        let (now, later) = rows.split_at(count);
        Some((self.texts[place], now, later))
    }
}

macro_rules! cycles_head {
    ($($column:ident: $type:ty = $placeholder:literal,)*) => {
        concat!(
            "INSERT INTO cycles (", cycles_head!(@list $(stringify!($column),)*), ") VALUES "
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

static CYCLES: LazyLock<Statements> = LazyLock::new(|| {
    Statements::new(
        cycle_columns!(cycles_head),
        cycle_columns!(cycles_row),
        " ON CONFLICT (machine_id, cycle_id) DO NOTHING RETURNING machine_id, cycle_id",
    )
});

/// Inserts cycles of different keys; returns the keys of those that are new.
pub(in crate::sqlite) async fn insert_cycles(
    conn: &mut Conn,
    rows: &[&CycleRow],
) -> StoreResult<Vec<(String, String)>> {
    let mut new = Vec::with_capacity(rows.len());
    let mut rest = rows;
    while let Some((text, rows, later)) = CYCLES.first(rest) {
        rest = later;
        let mut query = sqlx::query_as(text);
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

static BLOCKS: LazyLock<Statements> = LazyLock::new(|| {
    let head = "INSERT INTO cycle_samples (machine_id, received_at_us, cycle_id, block) VALUES ";
    Statements::new(head, "(?,?,?,?)", "")
});

/// Inserts the sample blocks of cycles.
pub(in crate::sqlite) async fn insert_blocks(
    conn: &mut Conn,
    rows: &[(&CycleRow, &[u8])],
) -> StoreResult<()> {
    let mut rest = rows;
    while let Some((text, rows, later)) = BLOCKS.first(rest) {
        rest = later;
        let mut query = sqlx::query(text);
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

static WEAR: LazyLock<Statements> = LazyLock::new(|| {
    Statements::new(
        "INSERT INTO tool_wear (machine_id, tool_id, folded, fold_version, state, version, updated_at_us) VALUES ",
        "(?,?,?,?,?,1,?)",
        " ON CONFLICT (machine_id, tool_id) DO UPDATE SET folded = excluded.folded,
             fold_version = excluded.fold_version, state = excluded.state, version = tool_wear.version + 1,
             updated_at_us = excluded.updated_at_us",
    )
});

/// Writes the folds of machines and tools.
pub(in crate::sqlite) async fn save_wear(
    conn: &mut Conn,
    rows: &[SavedWear],
    now: Timestamp,
) -> StoreResult<()> {
    let mut rest = rows;
    while let Some((text, rows, later)) = WEAR.first(rest) {
        rest = later;
        let mut query = sqlx::query(text);
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

static RECOMMENDATIONS: LazyLock<Statements> = LazyLock::new(|| {
    Statements::new(
        "INSERT INTO recommendations (recommendation_id, advice_hash, issued_at_us, valid_until_us, level_as_run,
             level_lowest, level_highest, level_n, level_window, remaining_cycles, remaining_low, remaining_high,
             data_age_ms, level_decides, level_value, level_sd, machine_id)
         VALUES ",
        "(?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?)",
        "",
    )
});

/// Inserts recommendations whose advice is kept.
pub(in crate::sqlite) async fn insert_recommendations(
    conn: &mut Conn,
    rows: &[IssuedRow],
) -> StoreResult<()> {
    let mut rest = rows;
    while let Some((text, rows, later)) = RECOMMENDATIONS.first(rest) {
        rest = later;
        let mut query = sqlx::query(text);
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
                .bind(row.level_sd)
                .bind(row.machine_id.clone());
        }
        query.execute(&mut *conn).await?;
    }
    Ok(())
}

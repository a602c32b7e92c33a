//! Many rows in one statement: each statement is a hop to the connection's thread, which costs as much as a row.
//!
//! There are statements for 1, 2, 4, 8 and 16 rows: one for each number of rows would hold some megabytes of compiled
//! statements, and is not worth it here. Groups of cycles whose surroundings are remembered are written row by row
//! ([`crate::sqlite::group_writer`]). What is written last goes in one hop, statement behind statement, where all of it
//! has as many rows as there is one for.
//!
//! Where a row is refused its whole transaction is rolled back, by whoever began it. `OR FAIL` leaves that to them: else
//! SQLite keeps a copy of each page that a statement changes, so as to take back that statement alone.

use super::assumed::{BEGIN, versions_text};
use super::list;
use super::samples::{PACK, packs};
use crate::error::{StoreError, StoreResult};
use crate::rows::{BlockRow, CycleRow, IssuedRow, Rest, SavedWear, cycle_columns};
use crate::sqlite::Conn;
use crate::sqlite::group_writer::Assumption;
use crate::sqlite::kept::{Cell, Form};
use crate::sqlite::recommendation_id;
use crate::work::Written;
use feedwright_core::units::Timestamp;
use sqlx::FromRow;
use std::sync::{Arc, LazyLock};

type Query = sqlx::query::Query<'static, sqlx::Sqlite, sqlx::sqlite::SqliteArguments>;

/// Numbers of rows that there are statements for, each twice the one before.
const SIZES: [usize; 5] = [1, 2, 4, 8, 16];

/// One statement for several numbers of rows, made once in the life of the process.
pub(in crate::sqlite) struct Statements {
    texts: [&'static str; SIZES.len()],
}

impl Statements {
    fn new(head: &str, row: &str, tail: &str) -> Self {
        let text = |rows| -> &'static str { format!("{head}{}{tail}", vec![row; rows].join(",")).leak() };
        Self { texts: SIZES.map(text) }
    }

    /// The statement for one row.
    pub(in crate::sqlite) const fn one(&self) -> &'static str {
        self.texts[0]
    }

    /// The statement for as many of the rows as there is one for, and those rows and the rest.
    fn first<'r, T>(&self, rows: &'r [T]) -> Option<(&'static str, &'r [T], &'r [T])> {
        let place = SIZES.iter().rposition(|size| *size <= rows.len())?;
        let (now, later) = rows.split_at(SIZES[place]);
        Some((self.texts[place], now, later))
    }
}

macro_rules! cycles_names {
    ($($column:ident: $type:ty = $placeholder:literal $(in $least:literal..=$most:literal)?,)*) => {
        [$(Form::of(stringify!($column)).kept_in(stringify!($column)),)*]
    };
}

/// Inserts cycles that are taken to be new.
pub(in crate::sqlite) static CYCLES: LazyLock<Statements> = LazyLock::new(|| {
    let names = cycle_columns!(cycles_names);
    let head = format!("INSERT OR FAIL INTO cycles ({}) VALUES ", names.join(", "));
    Statements::new(&head, &format!("({})", vec!["?"; names.len()].join(",")), "")
});

/// Asks which of the keys are there, and inserts the others behind it: nobody else writes in between. RETURNING would
/// hand every new key back, each a message from the connection's thread.
static NEW_CYCLES: LazyLock<Statements> = LazyLock::new(|| {
    let keys = Statements::new(
        "SELECT c.machine_id, c.cycle_id FROM (VALUES ",
        "(?,?)",
        // In this order: it looks up each key instead of reading an index from end to end.
        ") AS k CROSS JOIN cycles c ON c.machine_id = k.column1 AND c.cycle_id = k.column2",
    );
    let both = |at: usize| -> &'static str {
        let (keys, insert) = (keys.texts[at], CYCLES.texts[at]);
        format!("{keys}; {insert} ON CONFLICT (machine_id, cycle_id) DO NOTHING").leak()
    };
    Statements { texts: std::array::from_fn(both) }
});

/// A column of a cycle's row as it is kept.
macro_rules! kept_cell {
    ($row:expr, $column:ident) => {{
        const FORM: $crate::sqlite::kept::Form = $crate::sqlite::kept::Form::of(stringify!($column));
        $crate::sqlite::kept::Cell::from(&$row.$column).kept(FORM, |part| $row.energy_part(part))
    }};
}
pub(in crate::sqlite) use kept_cell;

fn bind_cell(query: Query, cell: Cell<'_>) -> Query {
    match cell {
        Cell::Null => query.bind(None::<i64>),
        Cell::Whole(value) => query.bind(value),
        Cell::Float(value) => query.bind(value),
        Cell::Text(text) => query.bind(text.to_owned()),
        Cell::Bytes(bytes) => query.bind(bytes.to_vec()),
    }
}

fn bind_cycles(mut query: Query, rows: &[Arc<CycleRow>]) -> Query {
    for row in rows {
        macro_rules! bind {
            ($($column:ident: $type:ty = $placeholder:literal $(in $least:literal..=$most:literal)?,)*) => {
                $(query = bind_cell(query, kept_cell!(row, $column));)*
            };
        }
        cycle_columns!(bind);
    }
    query
}

/// Inserts cycles of different keys; returns the keys of those that were known before.
pub(in crate::sqlite) async fn insert_cycles(
    conn: &mut Conn,
    rows: &[Arc<CycleRow>],
) -> StoreResult<Vec<(String, String)>> {
    let mut known = Vec::new();
    let mut rest = rows;
    while let Some((text, rows, later)) = NEW_CYCLES.first(rest) {
        rest = later;
        let mut query = sqlx::query(text);
        for row in rows {
            query = query.bind(row.machine_id.clone()).bind(row.cycle_id.clone());
        }
        for row in bind_cycles(query, rows).fetch_all(&mut *conn).await? {
            known.push(FromRow::from_row(&row)?);
        }
    }
    Ok(known)
}

fn bind_assumption(query: Query, Assumption { heads, tools }: Assumption<'_>) -> Query {
    let tools = list(tools.iter().map(|tool| tool.as_str()));
    query.bind(heads.generation).bind(i64::from(heads.any_profile)).bind(tools).bind(versions_text(heads))
}

/// Begins a transaction where what was assumed holds, and inserts cycles that are taken to be new.
pub(super) async fn begin_and_insert(
    conn: &mut Conn,
    assumption: Assumption<'_>,
    cycles: &[Arc<CycleRow>],
) -> StoreResult<()> {
    bind_assumption(sqlx::query(BEGIN), assumption).execute(&mut *conn).await?;
    let mut rest = cycles;
    while let Some((text, rows, later)) = CYCLES.first(rest) {
        rest = later;
        bind_cycles(sqlx::query(text), rows).execute(&mut *conn).await?;
    }
    Ok(())
}

/// Says where blocks are in the pack that was added last: a table without row numbers of its own does not change which that is.
pub(in crate::sqlite) static PLACES: LazyLock<Statements> = LazyLock::new(|| {
    let head = "INSERT OR FAIL INTO cycle_samples (machine_id, received_at_us, cycle_id, pack, place, bytes) VALUES ";
    Statements::new(head, "(?,?,?,last_insert_rowid(),?,?)", "")
});

fn bind_pack(query: Query, rows: &[BlockRow<'_>]) -> Query {
    query.bind(BlockRow::pack(rows).into_owned())
}

/// The first of these rows is at that place.
fn bind_places(mut query: Query, rows: &[BlockRow<'_>], first: i64) -> Query {
    for (place, row) in (first..).zip(rows) {
        query = query
            .bind(row.machine_id.clone())
            .bind(row.received_at_us)
            .bind(row.cycle_id.clone())
            .bind(place)
            .bind(row.bytes());
    }
    query
}

/// Inserts the blocks of cycles. In a transaction: another pack may not come between one and its places.
pub(crate) async fn insert_blocks(conn: &mut Conn, rows: &[BlockRow<'_>]) -> StoreResult<()> {
    for pack in packs(rows) {
        bind_pack(sqlx::query(PACK), pack).execute(&mut *conn).await?;
        let (mut left, mut first) = (pack, 0);
        while let Some((text, rows, later)) = PLACES.first(left) {
            left = later;
            bind_places(sqlx::query(text), rows, first).execute(&mut *conn).await?;
            first = first.saturating_add_unsigned(rows.len() as u64);
        }
    }
    Ok(())
}

static WEAR: LazyLock<Statements> = LazyLock::new(|| {
    Statements::new(
        "INSERT INTO tool_wear (machine_id, tool_id, folded, fold_version, state, version, updated_at_us, judging_change, ran) VALUES ",
        "(?,?,?,?,?,1,?,?,?)",
        " ON CONFLICT (machine_id, tool_id) DO UPDATE SET folded = excluded.folded,
             fold_version = excluded.fold_version, state = excluded.state, version = tool_wear.version + 1,
             updated_at_us = excluded.updated_at_us, judging_change = excluded.judging_change,
             ran = excluded.ran",
    )
});

fn bind_wear(mut query: Query, rows: &[Arc<SavedWear>], now: Timestamp) -> Query {
    for row in rows {
        query = query
            .bind(row.machine_id.as_str().to_owned())
            .bind(row.tool_id.as_str().to_owned())
            .bind(row.folded)
            .bind(row.state.version())
            .bind(row.state.stored())
            .bind(now.micros())
            .bind(row.judging_change)
            .bind(row.ran.clone());
    }
    query
}

/// Writes the folds of machines and tools.
pub(in crate::sqlite) async fn save_wear(
    conn: &mut Conn,
    rows: &[Arc<SavedWear>],
    now: Timestamp,
) -> StoreResult<()> {
    let mut rest = rows;
    while let Some((text, rows, later)) = WEAR.first(rest) {
        rest = later;
        bind_wear(sqlx::query(text), rows, now).execute(&mut *conn).await?;
    }
    Ok(())
}

pub(in crate::sqlite) static RECOMMENDATIONS: LazyLock<Statements> = LazyLock::new(|| {
    Statements::new(
        "INSERT OR FAIL INTO recommendations (recommendation_id, advice_hash, issued_at_us, valid_until_us, level_as_run,
             level_lowest, level_highest, level_n, level_window, remaining_cycles, remaining_low, remaining_high,
             data_age_ms, level_decides, level_value, level_sd, machine_id, operation_id, tool_id)
         VALUES ",
        "(?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?,?)",
        "",
    )
});

fn bind_recommendations(mut query: Query, rows: &[IssuedRow]) -> Query {
    for row in rows {
        query = query
            .bind(recommendation_id::to_column(&row.recommendation_id))
            .bind(row.advice.hash.to_vec())
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
            .bind(row.machine_id.clone())
            .bind(row.operation_id.clone())
            .bind(row.tool_id.clone());
    }
    query
}

/// Inserts recommendations whose advice is kept.
pub(in crate::sqlite) async fn insert_recommendations(
    conn: &mut Conn,
    rows: &[IssuedRow],
) -> StoreResult<()> {
    let mut rest = rows;
    while let Some((text, rows, later)) = RECOMMENDATIONS.first(rest) {
        rest = later;
        bind_recommendations(sqlx::query(text), rows).execute(&mut *conn).await?;
    }
    Ok(())
}

/// Ends a group's transaction, and says so by a row: where the connection's thread ends, so does what it answers, and no
/// row is no error.
const COMMIT: &str = "COMMIT; SELECT 1";

/// No row came: what was sent may have been committed, or not.
fn unconfirmed(error: sqlx::Error) -> StoreError {
    match error {
        sqlx::Error::RowNotFound => {
            StoreError::OutcomeUnknown("the connection ended while it committed".into())
        }
        other => other.into(),
    }
}

/// A pack of blocks, folds and recommendations of as many rows each, and [`COMMIT`]; parameters are numbered on from statement
/// to statement.
static REST: LazyLock<[&'static str; SIZES.len()]> = LazyLock::new(|| {
    let text = |at: usize| -> &'static str {
        let (places, wear, issued) = (PLACES.texts[at], WEAR.texts[at], RECOMMENDATIONS.texts[at]);
        format!("{PACK}; {places}; {wear}; {issued}; {COMMIT}").leak()
    };
    std::array::from_fn(text)
});

/// The statement for all of it, where there is one.
fn as_many_each(rest: &Rest<'_>) -> Option<&'static str> {
    let rows = rest.issued.len();
    let place = SIZES.iter().position(|size| *size == rows)?;
    let is_one_pack = packs(&rest.blocks).next().is_some_and(|pack| pack.len() == rows);
    (rest.blocks.len() == rows && is_one_pack && rest.wear.len() == rows).then(|| REST[place])
}

fn bind_rest(query: Query, rest: &Rest<'_>, now: Timestamp) -> Query {
    let query = bind_places(bind_pack(query, &rest.blocks), &rest.blocks, 0);
    bind_recommendations(bind_wear(query, &rest.wear, now), &rest.issued)
}

/// Writes the rest of a group and commits it.
pub(in crate::sqlite) async fn write_rest(
    conn: &mut Conn,
    rest: &Rest<'_>,
    now: Timestamp,
    _is_distributed: bool,
) -> StoreResult<Written> {
    if let Some(text) = as_many_each(rest) {
        let query = bind_rest(sqlx::query(text), rest, now);
        query.fetch_one(&mut *conn).await.map_err(unconfirmed)?;
        return Ok(Written::whole());
    }
    insert_blocks(conn, &rest.blocks).await?;
    save_wear(conn, &rest.wear, now).await?;
    insert_recommendations(conn, &rest.issued).await?;
    sqlx::query(COMMIT).fetch_one(&mut *conn).await.map_err(unconfirmed)?;
    Ok(Written::whole())
}

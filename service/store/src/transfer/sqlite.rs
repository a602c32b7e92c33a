//! A SQLite file as a side of a transfer.

use super::{
    DamagedRows, Filling, Kind, LEFT_OUT, RECEIPTS, Row, SAMPLES, Side, Table, TransferError, Unread, Value,
    quoted,
};
use crate::codec::pack;
use crate::error::{StoreError, StoreResult};
use crate::record::StoreFault;
use crate::row_sum::Writers;
use crate::rows::BlockRow;
use crate::sqlite::{
    APPLIED, Cell, Form, HAS_MIGRATIONS, IS_UNFINISHED, MIGRATIONS, by_name, insert_blocks,
    is_kept_for_another, recommendation_id,
};
use async_trait::async_trait;
use futures_util::TryStreamExt;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection, SqliteRow, SqliteSynchronous};
use sqlx::{ConnectOptions, Connection, QueryBuilder, Row as _, Sqlite};
use std::path::Path;
use std::time::Duration;

/// A writer that is at work is waited for so long.
const PATIENCE: Duration = Duration::from_secs(30);
/// Who may have written a file of this version.
const WRITERS: Writers = Writers::Alone;
/// Rows that are read ahead of the one that is looked at. Each of samples comes with a whole pack, and no page counts them.
const ROWS_AHEAD: usize = 4;

pub(super) struct SqliteSide {
    conn: SqliteConnection,
    /// Whether samples stand in packs, and ids of recommendations by their bytes: a database of before has a row for each and texts. As
    /// [`Side::tables`] found it.
    is_shorter: bool,
}

/// Statements go unlogged, however long they take: one that inserts has thousands of placeholders.
fn options(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(by_name(path))
        .busy_timeout(PATIENCE)
        .row_buffer_size(ROWS_AHEAD)
        .disable_statement_logging()
}

impl SqliteSide {
    /// Reads a file beside whoever writes it, with all that was acknowledged before.
    pub(super) async fn read(path: &Path) -> StoreResult<Self> {
        crate::sqlite::take_up(path).await?;
        let mut conn = options(path).read_only(true).connect().await?;
        if sqlx::query_scalar(HAS_MIGRATIONS).fetch_one(&mut conn).await? {
            let applied: Vec<i64> = sqlx::query_scalar(APPLIED).fetch_all(&mut conn).await?;
            StoreError::unless_known(&applied, &MIGRATIONS)?;
        }
        if sqlx::query_scalar(IS_UNFINISHED).fetch_one(&mut conn).await? {
            return Err(StoreError::of_unfinished_transfer());
        }
        Ok(Self { conn, is_shorter: true })
    }

    /// Writes a file that nobody else writes, as durably as the store does.
    pub(super) async fn write(path: &Path) -> StoreResult<Self> {
        let options = options(path).create_if_missing(false).synchronous(SqliteSynchronous::Full);
        Ok(Self { conn: options.connect().await?, is_shorter: true })
    }

    /// A database in memory as the migrations leave it.
    pub(super) async fn model() -> Result<Self, TransferError> {
        let mut conn = SqliteConnectOptions::new().in_memory(true).connect().await?;
        MIGRATIONS.run(&mut conn).await.map_err(|error| crate::StoreError::Database(Box::new(error)))?;
        Ok(Self { conn, is_shorter: true })
    }

    pub(super) const fn conn(&mut self) -> &mut SqliteConnection {
        &mut self.conn
    }

    /// Whether rows of a table have their block in a pack.
    fn is_packed(&self, table: &Table) -> bool {
        self.is_shorter && table.name == SAMPLES
    }
}

fn kind(declared: &str) -> Option<Kind> {
    match declared.to_ascii_uppercase().as_str() {
        "INTEGER" | "INT" => Some(Kind::Whole),
        "REAL" => Some(Kind::Float),
        // Of cycles, where it is a number that is kept shorter.
        "ANY" => Some(Kind::Float),
        "TEXT" => Some(Kind::Text),
        "BLOB" => Some(Kind::Bytes),
        _ => None,
    }
}

fn value(row: &SqliteRow, at: usize, kind: Kind) -> Result<Value, sqlx::Error> {
    Ok(match kind {
        Kind::Whole | Kind::Truth => row.try_get::<Option<i64>, _>(at)?.map_or(Value::Null, Value::Whole),
        Kind::Float => row.try_get::<Option<f64>, _>(at)?.map_or(Value::Null, Value::Float),
        Kind::Text => row.try_get::<Option<String>, _>(at)?.map_or(Value::Null, Value::Text),
        Kind::Bytes => row.try_get::<Option<Vec<u8>>, _>(at)?.map_or(Value::Null, Value::Bytes),
    })
}

/// The values of a row, but for the block of samples; `id` is where an id stands by its bytes.
fn values(table: &Table, id: Option<usize>, row: &SqliteRow) -> impl Iterator<Item = Result<Value, Unread>> {
    let columns = table.columns.iter().enumerate();
    columns.map(move |(at, (_, kind))| {
        let read =
            if Some(at) == id { id_of(row, at) } else { value(row, at, *kind).map_err(StoreError::from) };
        read.map_err(|error| Unread { column: at, error })
    })
}

/// Rows that no backup takes: as its sum reads them, something in them does not decode, or they are not what was written. So many of a table at the most.
///
/// In whatever order they come, one by one: they need no index, and no memory.
pub(crate) async fn damaged_rows(
    conn: &mut SqliteConnection,
    most: usize,
) -> Result<Vec<StoreFault>, TransferError> {
    let (tables, _) = tables(conn).await?;
    let mut faults = Vec::new();
    // What is no table of this program's is told as that.
    for table in tables.into_iter().flatten() {
        let table = table.without_bytes()?;
        let (id, mut damaged) = (id_by_bytes(&table), DamagedRows::of(&table, most, &mut faults));
        let mut query = QueryBuilder::<Sqlite>::new(select(&table, false));
        let mut found = query.build().persistent(false).fetch(&mut *conn);
        while !damaged.are_told()
            && let Some(row) = found.try_next().await?
        {
            damaged.look(values(&table, id, &row), || table.key_beside(&row), WRITERS)?;
        }
    }
    Ok(faults)
}

/// The table of samples as the other engine has it, in which each row has its block.
fn samples() -> Result<Table, TransferError> {
    let columns = [
        ("machine_id", Kind::Text),
        ("received_at_us", Kind::Whole),
        ("cycle_id", Kind::Text),
        (BLOCK, Kind::Bytes),
    ];
    let key = ["machine_id", "received_at_us", "cycle_id"].map(str::to_owned);
    Table::checked(SAMPLES.to_owned(), columns.map(|(name, kind)| (name.to_owned(), kind)).into(), &key)
}

const BLOCK: &str = "block";

/// Asks for the columns of a table: in place of the block of a row of samples its pack, and behind the last column its place.
fn select(table: &Table, is_packed: bool) -> String {
    let names = table.columns.iter().map(|(name, _)| name.as_str());
    if !is_packed {
        return format!("SELECT {} FROM \"{}\"", quoted(names, ""), table.name);
    }
    let names = quoted(names.map(|name| if name == BLOCK { "blocks" } else { name }), "");
    format!("SELECT {names}, place FROM \"{SAMPLES}\" LEFT JOIN sample_packs USING (pack)")
}

/// The row with its block instead of its pack; with all of the pack where that is damaged, as a block that is damaged is one too.
fn with_block(table: &Table, mut row: Row, of: &SqliteRow) -> StoreResult<Row> {
    let at = table.place(BLOCK).unwrap_or_default();
    let place = crate::rows::number("place", of.try_get::<i64, _>(table.columns.len())?)?;
    row[at] = match &row[at] {
        Value::Bytes(blocks) => Value::Bytes(pack::block(blocks, place).unwrap_or(blocks).to_vec()),
        // There is none: whoever takes the row refuses it.
        _ => Value::Bytes(Vec::new()),
    };
    Ok(row)
}

const RECOMMENDATIONS: &str = "recommendations";
const RECOMMENDATION_ID: &str = "recommendation_id";

/// Where a table has an id by its bytes that the other engine has by its text.
fn id_by_bytes(table: &Table) -> Option<usize> {
    if table.name == RECOMMENDATIONS { table.place(RECOMMENDATION_ID) } else { None }
}

fn id_of(row: &SqliteRow, at: usize) -> StoreResult<Value> {
    let id = recommendation_id::from_column(&row.try_get::<Vec<u8>, _>(at)?)?;
    Ok(Value::Text(id.as_str().to_owned()))
}

/// A value of that column as it is kept.
fn kept_id(value: &Value) -> Value {
    match value {
        Value::Text(id) => Value::Bytes(recommendation_id::to_column(id)),
        other => other.clone(),
    }
}

const CYCLES: &str = "cycles";

/// A row of cycles as its columns keep it.
fn kept(table: &Table, row: &Row) -> Row {
    let part = |name: &'static str| match table.place(name).and_then(|at| row.get(at)) {
        Some(Value::Float(value)) => Some(*value),
        _ => None,
    };
    let columns = table.columns.iter().zip(row);
    let kept = columns.map(|((name, _), value)| {
        let cell = match value {
            Value::Float(value) => Cell::Float(*value),
            Value::Text(text) => Cell::Text(text),
            other => return other.clone(),
        };
        match cell.kept(Form::of(name), part) {
            Cell::Whole(value) => Value::Whole(value),
            _ => value.clone(),
        }
    });
    kept.collect()
}

/// A row of samples as groups write it.
fn block_row<'r>(table: &Table, row: &'r Row) -> StoreResult<BlockRow<'r>> {
    let value = |name| table.place(name).and_then(|at| row.get(at));
    match [value("machine_id"), value("received_at_us"), value("cycle_id"), value(BLOCK)] {
        [
            Some(Value::Text(machine)),
            Some(Value::Whole(received)),
            Some(Value::Text(cycle)),
            Some(Value::Bytes(block)),
        ] => BlockRow::checked((machine.clone(), *received, cycle.clone()), block),
        _ => Err(StoreError::Damaged {
            what: format!("{SAMPLES} {}: a value is missing", table.show_key(row)),
        }),
    }
}

fn bind(to: &mut sqlx::query_builder::Separated<'_, Sqlite, &'static str>, value: &Value) {
    match value {
        Value::Null => to.push_bind(None::<i64>),
        Value::Whole(value) => to.push_bind(*value),
        Value::Float(value) => to.push_bind(*value),
        Value::Text(text) => to.push_bind(text.clone()),
        Value::Bytes(bytes) => to.push_bind(bytes.clone()),
    };
}

fn tuple(query: &mut QueryBuilder<Sqlite>, values: &Row) {
    query.push("(");
    let mut separated = query.separated(", ");
    for value in values {
        bind(&mut separated, value);
    }
    query.push(")");
}

/// Every table of the data, by name, and whether it keeps some shorter than databases of before did.
async fn tables(conn: &mut SqliteConnection) -> StoreResult<(Vec<Result<Table, TransferError>>, bool)> {
    let names: Vec<String> = sqlx::query_scalar(
        "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite_%' ORDER BY name",
    )
    .fetch_all(&mut *conn)
    .await?;
    let (mut tables, mut is_shorter) = (Vec::new(), true);
    for name in names.into_iter().filter(|name| !LEFT_OUT.contains(&name.as_str())) {
        let columns: Vec<(String, String, i64)> =
            // With those that are made of others, and without those.
            sqlx::query_as("SELECT name, type, pk FROM pragma_table_xinfo($1) ORDER BY pk")
                .bind(&name)
                .fetch_all(&mut *conn)
                .await?;
        if name == SAMPLES {
            is_shorter = !columns.iter().any(|(column, ..)| column == BLOCK);
            if is_shorter {
                tables.push(samples());
                continue;
            }
        }
        let columns: Vec<_> = columns
            .into_iter()
            .filter(|(column, ..)| !(name == CYCLES && is_kept_for_another(column)))
            .collect();
        let key: Vec<String> =
            columns.iter().filter(|(_, _, pk)| *pk > 0).map(|(column, _, _)| column.clone()).collect();
        let typed = columns.into_iter().map(|(column, declared, _)| match kind(&declared) {
            Some(Kind::Bytes) if name == RECOMMENDATIONS && column == RECOMMENDATION_ID => {
                Ok((column, Kind::Text))
            }
            Some(kind) => Ok((column, kind)),
            None => Err(TransferError::Schema(format!("{name}.{column} is of type {declared}"))),
        });
        let typed = typed.collect::<Result<_, _>>();
        tables.push(typed.and_then(|typed| Table::checked(name.clone(), typed, &key)));
    }
    Ok((tables, is_shorter))
}

#[async_trait]
impl Side for SqliteSide {
    async fn tables(&mut self) -> Result<Vec<Table>, TransferError> {
        let (tables, is_shorter) = tables(&mut self.conn).await?;
        self.is_shorter = is_shorter;
        tables.into_iter().collect()
    }

    async fn begin_snapshot(&mut self) -> StoreResult<()> {
        sqlx::query("BEGIN").execute(&mut self.conn).await?;
        // The first read fixes the state.
        sqlx::query("SELECT count(*) FROM sqlite_schema").execute(&mut self.conn).await?;
        Ok(())
    }

    async fn rows(
        &mut self,
        table: &Table,
        after: Option<&Row>,
        until: Option<&Row>,
        limit: usize,
    ) -> StoreResult<Vec<Row>> {
        let key = quoted(table.key.iter().map(|&at| table.columns[at].0.as_str()), "");
        let (is_packed, id_by_bytes) =
            (self.is_packed(table), id_by_bytes(table).filter(|_| self.is_shorter));
        let mut query = QueryBuilder::new(select(table, is_packed));
        for (bound, sign, word) in
            [(after, ">", " WHERE "), (until, "<=", if after.is_some() { " AND " } else { " WHERE " })]
        {
            if let Some(bound) = bound {
                query.push(word).push(format!("({key}) {sign} "));
                let bound = bound.iter().zip(&table.key);
                let bound = bound
                    .map(|(value, at)| if Some(*at) == id_by_bytes { kept_id(value) } else { value.clone() });
                tuple(&mut query, &bound.collect());
            }
        }
        query.push(format!(" ORDER BY {key} LIMIT {limit}"));
        // One by one: what comes of samples is a pack, of which a row takes its block.
        let mut found = query.build().persistent(false).fetch(&mut self.conn);
        let mut page = Filling::default();
        while !page.is_full()
            && let Some(row) = found.try_next().await?
        {
            let values: Result<Row, _> = values(table, id_by_bytes, &row).collect();
            let values = values.map_err(|unread| table.unread(&table.key_beside(&row), unread))?;
            page.add(if is_packed {
                with_block(table, values, &row)?
            } else {
                table.held(values, WRITERS)?
            });
        }
        Ok(page.rows)
    }

    async fn present(&mut self, table: &Table, keys: &[Row]) -> StoreResult<Vec<Row>> {
        let names = quoted(table.key.iter().map(|&at| table.columns[at].0.as_str()), "");
        let text = format!("SELECT {names} FROM \"{}\" WHERE ({names}) IN (VALUES ", table.name);
        let mut query = QueryBuilder::new(text);
        for (at, key) in keys.iter().enumerate() {
            if at > 0 {
                query.push(", ");
            }
            tuple(&mut query, key);
        }
        let rows = query.push(")").build().persistent(false).fetch_all(&mut self.conn).await?;
        let read = |row: &SqliteRow| {
            table
                .key
                .iter()
                .enumerate()
                .map(|(at, &column)| value(row, at, table.columns[column].1))
                .collect()
        };
        Ok(rows.iter().map(read).collect::<Result<_, sqlx::Error>>()?)
    }

    async fn is_unfinished(&mut self) -> StoreResult<bool> {
        Ok(sqlx::query_scalar(IS_UNFINISHED).fetch_one(&mut self.conn).await?)
    }

    async fn execute(&mut self, statement: &'static str) -> StoreResult<()> {
        sqlx::query(statement).execute(&mut self.conn).await?;
        Ok(())
    }

    async fn prepare(&mut self, _received_us: &[i64]) -> StoreResult<()> {
        Ok(())
    }

    async fn insert(&mut self, table: &Table, rows: &[&Row]) -> StoreResult<()> {
        if self.is_packed(table) {
            let blocks = rows.iter().map(|row| block_row(table, row)).collect::<StoreResult<Vec<_>>>()?;
            let mut transaction = self.conn.begin_with("BEGIN IMMEDIATE").await?;
            insert_blocks(&mut transaction, &blocks).await?;
            return Ok(transaction.commit().await?);
        }
        let kept_in = |name: &str| match table.name.as_str() {
            CYCLES => Form::of(name).kept_in(name),
            _ => name.to_owned(),
        };
        let names: Vec<String> = table.columns.iter().map(|(name, _)| kept_in(name)).collect();
        let names = quoted(names.iter().map(String::as_str), "");
        let mut query = QueryBuilder::new(format!("INSERT INTO \"{}\" ({names}) VALUES ", table.name));
        for (at, row) in rows.iter().enumerate() {
            if at > 0 {
                query.push(", ");
            }
            match (table.name.as_str(), id_by_bytes(table)) {
                (CYCLES, _) => tuple(&mut query, &kept(table, row)),
                (_, Some(id)) => {
                    let mut row = Row::clone(row);
                    row[id] = kept_id(&row[id]);
                    tuple(&mut query, &row);
                }
                _ => tuple(&mut query, row),
            }
        }
        query.build().persistent(false).execute(&mut self.conn).await?;
        Ok(())
    }

    async fn remove(&mut self, table: &Table, keys: &[Row]) -> StoreResult<()> {
        let names = quoted(table.key.iter().map(|&at| table.columns[at].0.as_str()), "");
        let mut query =
            QueryBuilder::new(format!("DELETE FROM \"{}\" WHERE ({names}) IN (VALUES ", table.name));
        for (at, key) in keys.iter().enumerate() {
            if at > 0 {
                query.push(", ");
            }
            tuple(&mut query, key);
        }
        query.push(")").build().persistent(false).execute(&mut self.conn).await?;
        Ok(())
    }

    async fn clear(&mut self, table: &Table) -> StoreResult<()> {
        let there: Vec<Row> = self.rows(table, None, None, 1).await?;
        if !there.is_empty() {
            let is_packed = self.is_packed(table);
            let mut transaction = self.conn.begin_with("BEGIN IMMEDIATE").await?;
            let of_packs: &[&str] = if is_packed { &["sample_packs", "sample_pack_drops"] } else { &[] };
            for name in std::iter::once(table.name.as_str()).chain(of_packs.iter().copied()) {
                let mut query = QueryBuilder::<Sqlite>::new(format!("DELETE FROM \"{name}\""));
                query.build().persistent(false).execute(&mut *transaction).await?;
            }
            transaction.commit().await?;
        }
        Ok(())
    }

    async fn receipts(&mut self) -> StoreResult<Vec<i64>> {
        let days: Vec<(i64, i64)> = sqlx::query_as(RECEIPTS).fetch_all(&mut self.conn).await?;
        Ok(days.into_iter().flat_map(<[i64; 2]>::from).collect())
    }

    async fn finish(&mut self, _tables: &[Table]) -> Result<(), TransferError> {
        Ok(())
    }

    async fn close(self: Box<Self>) {
        if let Err(error) = self.conn.close().await {
            tracing::debug!(%error, "a connection did not close cleanly");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_statement_is_logged_with_all_its_placeholders() {
        let options = format!("{:?}", options(Path::new("cell.sqlite3")));
        assert!(options.contains("slow_statements_level: Off"), "{options}");
    }
}

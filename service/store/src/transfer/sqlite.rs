//! A SQLite file as a side of a transfer.

use super::{Kind, LEFT_OUT, Row, Side, Table, TransferError, Value, quoted};
use crate::error::StoreResult;
use crate::sqlite::MIGRATIONS;
use async_trait::async_trait;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection, SqliteRow, SqliteSynchronous};
use sqlx::{ConnectOptions, Connection, QueryBuilder, Row as _, Sqlite};
use std::path::Path;
use std::time::Duration;

/// A writer that is at work is waited for so long.
const PATIENCE: Duration = Duration::from_secs(30);

pub(super) struct SqliteSide {
    conn: SqliteConnection,
}

impl SqliteSide {
    /// Reads a file beside whoever writes it, with all that was acknowledged before.
    pub(super) async fn read(path: &Path) -> StoreResult<Self> {
        crate::sqlite::take_up(path).await?;
        let options = SqliteConnectOptions::new().filename(path).read_only(true).busy_timeout(PATIENCE);
        Ok(Self { conn: options.connect().await? })
    }

    /// Writes a file that nobody else writes, as durably as the store does.
    pub(super) async fn write(path: &Path) -> StoreResult<Self> {
        let options = SqliteConnectOptions::new()
            .filename(path)
            .create_if_missing(false)
            .synchronous(SqliteSynchronous::Full)
            .busy_timeout(PATIENCE);
        Ok(Self { conn: options.connect().await? })
    }

    /// A database in memory as the migrations leave it.
    pub(super) async fn model() -> Result<Self, TransferError> {
        let mut conn = SqliteConnectOptions::new().in_memory(true).connect().await?;
        MIGRATIONS.run(&mut conn).await.map_err(|error| crate::StoreError::Database(Box::new(error)))?;
        Ok(Self { conn })
    }

    pub(super) const fn conn(&mut self) -> &mut SqliteConnection {
        &mut self.conn
    }
}

fn kind(declared: &str) -> Option<Kind> {
    match declared.to_ascii_uppercase().as_str() {
        "INTEGER" | "INT" => Some(Kind::Whole),
        "REAL" => Some(Kind::Float),
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

#[async_trait]
impl Side for SqliteSide {
    async fn tables(&mut self) -> Result<Vec<Table>, TransferError> {
        let names: Vec<String> = sqlx::query_scalar(
            "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite_%' ORDER BY name",
        )
        .fetch_all(&mut self.conn)
        .await?;
        let mut tables = Vec::new();
        for name in names.into_iter().filter(|name| !LEFT_OUT.contains(&name.as_str())) {
            let columns: Vec<(String, String, i64)> =
                sqlx::query_as("SELECT name, type, pk FROM pragma_table_info($1) ORDER BY pk")
                    .bind(&name)
                    .fetch_all(&mut self.conn)
                    .await?;
            let key: Vec<String> =
                columns.iter().filter(|(_, _, pk)| *pk > 0).map(|(column, _, _)| column.clone()).collect();
            let typed = columns.into_iter().map(|(column, declared, _)| match kind(&declared) {
                Some(kind) => Ok((column, kind)),
                None => Err(TransferError::Schema(format!("{name}.{column} is of type {declared}"))),
            });
            let typed = typed.collect::<Result<_, _>>()?;
            tables.push(Table::checked(name, typed, &key)?);
        }
        Ok(tables)
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
        let names = table.columns.iter().map(|(name, _)| name.as_str());
        let key = quoted(table.key.iter().map(|&at| table.columns[at].0.as_str()), "");
        let mut query = QueryBuilder::new(format!("SELECT {} FROM \"{}\"", quoted(names, ""), table.name));
        for (bound, sign, word) in
            [(after, ">", " WHERE "), (until, "<=", if after.is_some() { " AND " } else { " WHERE " })]
        {
            if let Some(bound) = bound {
                query.push(word).push(format!("({key}) {sign} "));
                tuple(&mut query, bound);
            }
        }
        query.push(format!(" ORDER BY {key} LIMIT {limit}"));
        let rows = query.build().persistent(false).fetch_all(&mut self.conn).await?;
        let read = |row: &SqliteRow| {
            table.columns.iter().enumerate().map(|(at, (_, kind))| value(row, at, *kind)).collect()
        };
        Ok(rows.iter().map(read).collect::<Result<_, sqlx::Error>>()?)
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

    async fn prepare(&mut self, _received_us: Option<(i64, i64)>) -> StoreResult<()> {
        Ok(())
    }

    async fn insert(&mut self, table: &Table, rows: &[&Row]) -> StoreResult<()> {
        let names = quoted(table.columns.iter().map(|(name, _)| name.as_str()), "");
        let mut query = QueryBuilder::new(format!("INSERT INTO \"{}\" ({names}) VALUES ", table.name));
        for (at, row) in rows.iter().enumerate() {
            if at > 0 {
                query.push(", ");
            }
            tuple(&mut query, row);
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
            let mut query = QueryBuilder::<Sqlite>::new(format!("DELETE FROM \"{}\"", table.name));
            query.build().persistent(false).execute(&mut self.conn).await?;
        }
        Ok(())
    }

    async fn range(&mut self, table: &str, column: &str) -> StoreResult<Option<(i64, i64)>> {
        let text = format!("SELECT MIN(\"{column}\"), MAX(\"{column}\") FROM \"{table}\"");
        let mut query = QueryBuilder::<Sqlite>::new(text);
        let row = query.build().persistent(false).fetch_one(&mut self.conn).await?;
        Ok(row.try_get::<Option<i64>, _>(0)?.zip(row.try_get::<Option<i64>, _>(1)?))
    }

    async fn finish(&mut self, _tables: &[Table]) -> StoreResult<()> {
        Ok(())
    }

    async fn close(self: Box<Self>) {
        if let Err(error) = self.conn.close().await {
            tracing::debug!(%error, "a connection did not close cleanly");
        }
    }
}

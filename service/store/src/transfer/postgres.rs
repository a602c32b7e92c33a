//! A PostgreSQL database as a side of a transfer.

use super::{
    DamagedRows, Filling, Kind, LEFT_OUT, RECEIPTS, Row, Side, Table, TransferError, Unread, Value, quoted,
};
use crate::error::{StoreError, StoreResult};
use crate::locks::Locks;
use crate::postgres::{IS_UNFINISHED, LIVE, MIGRATIONS, is_ours, keep_partitions, plant};
use crate::record::StoreFault;
use crate::row_sum::Writers;
use async_trait::async_trait;
use futures_util::TryStreamExt;
use sqlx::postgres::{PgConnectOptions, PgConnection, PgRow};
use sqlx::{ConnectOptions, Connection, Postgres, QueryBuilder, Row as _};

/// Servers of before may have registered since the tables are those of this version.
const WRITERS: Writers = Writers::BesideOlder;
/// What is told of a table that is not there (SQLSTATE).
const UNDEFINED_TABLE: &str = "42P01";
/// It idles while the other side is read, and reads whole tables, whatever limits a role has for its questions. The last setting
/// is for Citus, as where the store begins to read.
const BEGIN_SNAPSHOT: &str = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY; SET LOCAL statement_timeout = 0; \
                              SET LOCAL idle_in_transaction_session_timeout = 0; \
                              SET LOCAL citus.max_adaptive_executor_pool_size = 1";

pub(super) struct PostgresSide {
    conn: PgConnection,
    /// Columns that the database numbers itself, `(table, column)`.
    numbered: Vec<(String, String)>,
}

/// Statements go unlogged, however long they take: one that inserts has thousands of placeholders.
fn options(url: &str) -> StoreResult<PgConnectOptions> {
    let options: PgConnectOptions = url.parse()?;
    Ok(options.application_name("feedwright transfer").disable_statement_logging())
}

impl PostgresSide {
    pub(super) async fn connect(url: &str) -> StoreResult<Self> {
        let mut conn = options(url)?.connect().await?;
        // Types of columns are compared by their names, which a role may have quoted. Its limits for questions are none for all that is there,
        // and of what is hidden from it nothing would be moved.
        sqlx::raw_sql(
            "SET quote_all_identifiers = off; SET statement_timeout = 0; SET lock_timeout = 0; SET row_security = off",
        )
        .execute(&mut conn)
        .await?;
        Ok(Self { conn, numbered: Vec::new() })
    }

    /// The same, to read from.
    pub(super) async fn read(url: &str) -> StoreResult<Self> {
        let mut side = Self::connect(url).await?;
        let has_migrations = "SELECT to_regclass('_sqlx_migrations') IS NOT NULL";
        if sqlx::query_scalar(has_migrations).fetch_one(&mut side.conn).await? {
            let applied = "SELECT version FROM _sqlx_migrations ORDER BY version";
            let applied: Vec<i64> = sqlx::query_scalar(applied).fetch_all(&mut side.conn).await?;
            StoreError::unless_known(&applied, &MIGRATIONS)?;
        }
        if sqlx::query_scalar(IS_UNFINISHED).fetch_one(&mut side.conn).await? {
            return Err(StoreError::of_unfinished_transfer());
        }
        Ok(side)
    }

    /// The same, to write into: nobody else who does may have it meanwhile.
    pub(super) async fn connect_alone(url: &str) -> Result<Self, TransferError> {
        let mut side = Self::connect(url).await?;
        // A client that is gone without a word holds nothing up for hours.
        sqlx::raw_sql(
            "SET tcp_keepalives_idle = 60; SET tcp_keepalives_interval = 10; SET tcp_keepalives_count = 6",
        )
        .execute(&mut side.conn)
        .await?;
        // Of the session: it ends with it, however that ends.
        let subject = Locks::subject("transfer", &plant(&mut side.conn).await.map_err(StoreError::from)?);
        let is_alone: bool = sqlx::query_scalar("SELECT pg_try_advisory_lock($1)")
            .bind(subject.exclusive.first())
            .fetch_one(&mut side.conn)
            .await?;
        if !is_alone {
            return Err(TransferError::InUse);
        }
        if side.is_served().await? {
            return Err(TransferError::Served);
        }
        Ok(side)
    }

    /// Whether a server runs on it, which would count cycles on what is moved under it. Each of them listens there, whatever pooler its cycles
    /// go through.
    async fn is_served(&mut self) -> StoreResult<bool> {
        let named = format!("{LIVE}{}", plant(&mut self.conn).await?);
        Ok(sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM pg_stat_activity
             WHERE datname = current_database() AND application_name = $1)",
        )
        .bind(named)
        .fetch_one(&mut self.conn)
        .await?)
    }

    pub(super) const fn conn(&mut self) -> &mut PgConnection {
        &mut self.conn
    }

    /// The largest whole number of a column.
    async fn largest(&mut self, table: &str, column: &str) -> StoreResult<Option<i64>> {
        let mut query = QueryBuilder::<Postgres>::new(format!("SELECT MAX(\"{column}\") FROM \"{table}\""));
        Ok(query.build_query_scalar().persistent(false).fetch_one(&mut self.conn).await?)
    }
}

fn kind(declared: &str) -> Option<Kind> {
    match declared {
        "bigint" | "integer" | "smallint" => Some(Kind::Whole),
        "double precision" | "real" => Some(Kind::Float),
        "text" | "character varying" => Some(Kind::Text),
        "bytea" => Some(Kind::Bytes),
        "boolean" => Some(Kind::Truth),
        _ => None,
    }
}

/// How a column is read, so that every kind is of one type.
fn read_as(name: &str, kind: Kind) -> String {
    match kind {
        Kind::Whole => format!("\"{name}\"::BIGINT"),
        Kind::Truth => format!("\"{name}\"::INT::BIGINT"),
        Kind::Float => format!("\"{name}\"::DOUBLE PRECISION"),
        Kind::Text => format!("\"{name}\"::TEXT"),
        Kind::Bytes => format!("\"{name}\""),
    }
}

fn value(row: &PgRow, at: usize, kind: Kind) -> Result<Value, sqlx::Error> {
    Ok(match kind {
        Kind::Whole | Kind::Truth => row.try_get::<Option<i64>, _>(at)?.map_or(Value::Null, Value::Whole),
        Kind::Float => row.try_get::<Option<f64>, _>(at)?.map_or(Value::Null, Value::Float),
        Kind::Text => row.try_get::<Option<String>, _>(at)?.map_or(Value::Null, Value::Text),
        Kind::Bytes => row.try_get::<Option<Vec<u8>>, _>(at)?.map_or(Value::Null, Value::Bytes),
    })
}

fn tuple(query: &mut QueryBuilder<Postgres>, values: &Row, kinds: impl Iterator<Item = Kind>) {
    query.push("(");
    for (at, (value, kind)) in values.iter().zip(kinds).enumerate() {
        if at > 0 {
            query.push(", ");
        }
        // The type of a null has to be said.
        match (value, kind) {
            (Value::Null, Kind::Float) => query.push_bind(None::<f64>),
            (Value::Null, Kind::Text) => query.push_bind(None::<String>),
            (Value::Null, Kind::Bytes) => query.push_bind(None::<Vec<u8>>),
            (Value::Null, Kind::Whole | Kind::Truth) => query.push_bind(None::<i64>),
            (Value::Whole(value), _) => query.push_bind(*value),
            (Value::Float(value), _) => query.push_bind(*value),
            (Value::Text(text), _) => query.push_bind(text.clone()),
            (Value::Bytes(bytes), _) => query.push_bind(bytes.clone()),
        };
        if kind == Kind::Truth {
            query.push("::INT::BOOLEAN");
        }
    }
    query.push(")");
}

/// Asks for the columns of a table.
fn select(table: &Table) -> String {
    let columns: Vec<_> = table.columns.iter().map(|(name, kind)| read_as(name, *kind)).collect();
    format!("SELECT {} FROM \"{}\"", columns.join(", "), table.name)
}

/// The values of a row.
fn values(table: &Table, row: &PgRow) -> impl Iterator<Item = Result<Value, Unread>> {
    let columns = table.columns.iter().enumerate();
    columns.map(|(at, (_, kind))| {
        value(row, at, *kind).map_err(|error| Unread { column: at, error: error.into() })
    })
}

/// Rows that no backup takes: as its sum reads them, something in them does not decode, or they are not what was written, as of a page that a disk has damaged. So many of
/// a table at the most, one by one.
pub(crate) async fn damaged_rows(
    conn: &mut PgConnection,
    most: usize,
) -> Result<Vec<StoreFault>, TransferError> {
    let (tables, _) = tables(conn).await?;
    let mut faults = Vec::new();
    // What has no key is told as that.
    for table in tables.into_iter().flatten() {
        let table = table.without_bytes()?;
        let mut damaged = DamagedRows::of(&table, most, &mut faults);
        let mut query = QueryBuilder::<Postgres>::new(select(&table));
        let mut found = query.build().persistent(false).fetch(&mut *conn);
        while !damaged.are_told()
            && let Some(row) = found.try_next().await?
        {
            damaged.look(values(&table, &row), || table.key_beside(&row), WRITERS)?;
        }
    }
    Ok(faults)
}

/// A table's name, columns and key.
type Declared = (String, Vec<(String, Kind)>, Vec<String>);

/// Every table of the data, by name, and the columns that the database numbers itself, `(table, column)`.
async fn tables(
    conn: &mut PgConnection,
) -> Result<(Vec<Result<Table, TransferError>>, Vec<(String, String)>), TransferError> {
    // Partitions are part of their table, views are made of tables.
    let columns: Vec<(String, String, String, bool, Option<i32>)> = sqlx::query_as(
        "SELECT c.relname::TEXT, a.attname::TEXT, format_type(a.atttypid, NULL), a.attidentity <> '',
                array_position(k.conkey::INT[], a.attnum::INT)
         FROM pg_class c
         JOIN pg_attribute a ON a.attrelid = c.oid AND a.attnum > 0 AND NOT a.attisdropped
         LEFT JOIN pg_constraint k ON k.conrelid = c.oid AND k.contype = 'p'
         WHERE c.relnamespace = quote_ident(current_schema())::regnamespace AND c.relkind IN ('r', 'p')
           AND NOT c.relispartition
         ORDER BY c.relname COLLATE \"C\", 5, a.attnum",
    )
    .fetch_all(&mut *conn)
    .await?;
    let mut tables: Vec<Declared> = Vec::new();
    let mut numbered = Vec::new();
    for (table, column, declared, is_numbered, in_key) in columns {
        // What an admin keeps beside, such as a month that was detached, is his.
        if LEFT_OUT.contains(&table.as_str()) || !is_ours(&table) {
            continue;
        }
        let kind = kind(&declared)
            .ok_or_else(|| TransferError::Schema(format!("{table}.{column} is of type {declared}")))?;
        if is_numbered {
            numbered.push((table.clone(), column.clone()));
        }
        if tables.last().is_none_or(|(name, _, _)| *name != table) {
            tables.push((table, Vec::new(), Vec::new()));
        }
        if let Some((_, columns, key)) = tables.last_mut() {
            if in_key.is_some() {
                key.push(column.clone());
            }
            columns.push((column, kind));
        }
    }
    let tables = tables.into_iter().map(|(name, columns, key)| Table::checked(name, columns, &key));
    Ok((tables.collect(), numbered))
}

#[async_trait]
impl Side for PostgresSide {
    async fn tables(&mut self) -> Result<Vec<Table>, TransferError> {
        let (tables, numbered) = tables(&mut self.conn).await?;
        self.numbered = numbered;
        tables.into_iter().collect()
    }

    async fn begin_snapshot(&mut self) -> StoreResult<()> {
        sqlx::raw_sql(BEGIN_SNAPSHOT).execute(&mut self.conn).await?;
        // Before the first question, of which the snapshot is.
        match keep_partitions(&mut self.conn).await {
            // No database of this program's, or an empty one: what follows says so.
            Err(sqlx::Error::Database(error)) if error.code().as_deref() == Some(UNDEFINED_TABLE) => {
                sqlx::raw_sql("ROLLBACK").execute(&mut self.conn).await?;
                sqlx::raw_sql(BEGIN_SNAPSHOT).execute(&mut self.conn).await?;
                Ok(())
            }
            kept => Ok(kept?),
        }
    }

    async fn rows(
        &mut self,
        table: &Table,
        after: Option<&Row>,
        until: Option<&Row>,
        limit: usize,
    ) -> StoreResult<Vec<Row>> {
        // By bytes, whatever the collation of the database: the other engine knows no other order.
        let key: Vec<_> = table
            .key
            .iter()
            .map(|&at| {
                let (name, kind) = &table.columns[at];
                format!("\"{name}\"{}", if *kind == Kind::Text { " COLLATE \"C\"" } else { "" })
            })
            .collect();
        let key = key.join(", ");
        let mut query = QueryBuilder::new(select(table));
        let kinds = || table.key.iter().map(|&at| table.columns[at].1);
        for (bound, sign, word) in
            [(after, ">", " WHERE "), (until, "<=", if after.is_some() { " AND " } else { " WHERE " })]
        {
            if let Some(bound) = bound {
                query.push(word).push(format!("({key}) {sign} "));
                tuple(&mut query, bound, kinds());
            }
        }
        query.push(format!(" ORDER BY {key} LIMIT {limit}"));
        let mut found = query.build().persistent(false).fetch(&mut self.conn);
        let mut page = Filling::default();
        while !page.is_full()
            && let Some(row) = found.try_next().await?
        {
            let values: Result<Row, _> = values(table, &row).collect();
            let values = values.map_err(|unread| table.unread(&table.key_beside(&row), unread))?;
            page.add(table.held(values, WRITERS)?);
        }
        Ok(page.rows)
    }

    async fn present(&mut self, table: &Table, keys: &[Row]) -> StoreResult<Vec<Row>> {
        let columns = || table.key.iter().map(|&at| &table.columns[at]);
        let names = quoted(columns().map(|(name, _)| name.as_str()), "");
        let read: Vec<_> = columns().map(|(name, kind)| read_as(name, *kind)).collect();
        let text = format!("SELECT {} FROM \"{}\" WHERE ({names}) IN (VALUES ", read.join(", "), table.name);
        let mut query = QueryBuilder::new(text);
        for (at, key) in keys.iter().enumerate() {
            if at > 0 {
                query.push(", ");
            }
            tuple(&mut query, key, columns().map(|(_, kind)| *kind));
        }
        let rows = query.push(")").build().persistent(false).fetch_all(&mut self.conn).await?;
        let read = |row: &PgRow| columns().enumerate().map(|(at, (_, kind))| value(row, at, *kind)).collect();
        Ok(rows.iter().map(read).collect::<Result<_, sqlx::Error>>()?)
    }

    async fn is_unfinished(&mut self) -> StoreResult<bool> {
        Ok(sqlx::query_scalar(IS_UNFINISHED).fetch_one(&mut self.conn).await?)
    }

    async fn execute(&mut self, statement: &'static str) -> StoreResult<()> {
        sqlx::query(statement).execute(&mut self.conn).await?;
        Ok(())
    }

    async fn prepare(&mut self, received_us: &[i64]) -> StoreResult<()> {
        // Only of months with any: between them and what a clock received that was decades ahead lie hundreds, and whoever reads locks each.
        let months: Vec<i64> = sqlx::query_scalar(
            "SELECT MIN(at) FROM unnest($1::BIGINT[]) AS received (at)
             GROUP BY date_trunc('month', TIMESTAMP 'epoch' + at * INTERVAL '1 microsecond') ORDER BY 1",
        )
        .bind(received_us)
        .fetch_all(&mut self.conn)
        .await?;
        // One by one: where a table stands on several nodes, each of its shards is locked with each partition.
        for month in months {
            sqlx::query("SELECT cycle_samples_make_partitions($1, 1)")
                .bind(month)
                .execute(&mut self.conn)
                .await?;
        }
        Ok(())
    }

    async fn insert(&mut self, table: &Table, rows: &[&Row]) -> StoreResult<()> {
        let names = quoted(table.columns.iter().map(|(name, _)| name.as_str()), "");
        let text = format!("INSERT INTO \"{}\" ({names}) OVERRIDING SYSTEM VALUE VALUES ", table.name);
        let mut query = QueryBuilder::new(text);
        for (at, row) in rows.iter().enumerate() {
            if at > 0 {
                query.push(", ");
            }
            tuple(&mut query, row, table.columns.iter().map(|(_, kind)| *kind));
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
            tuple(&mut query, key, table.key.iter().map(|&at| table.columns[at].1));
        }
        query.push(")").build().persistent(false).execute(&mut self.conn).await?;
        Ok(())
    }

    async fn clear(&mut self, table: &Table) -> StoreResult<()> {
        let there: Vec<Row> = self.rows(table, None, None, 1).await?;
        if !there.is_empty() {
            let mut query = QueryBuilder::<Postgres>::new(format!("DELETE FROM \"{}\"", table.name));
            query.build().persistent(false).execute(&mut self.conn).await?;
        }
        Ok(())
    }

    async fn receipts(&mut self) -> StoreResult<Vec<i64>> {
        let days: Vec<(i64, i64)> = sqlx::query_as(RECEIPTS).fetch_all(&mut self.conn).await?;
        Ok(days.into_iter().flat_map(<[i64; 2]>::from).collect())
    }

    async fn finish(&mut self, tables: &[Table]) -> Result<(), TransferError> {
        if self.is_served().await? {
            return Err(TransferError::ServedMeanwhile);
        }
        for (table, column) in self.numbered.clone() {
            let Some(last) = self.largest(&table, &column).await? else { continue };
            sqlx::query("SELECT setval(pg_get_serial_sequence($1, $2), $3)")
                .bind(format!("\"{table}\""))
                .bind(&column)
                .bind(last)
                .execute(&mut self.conn)
                .await?;
        }
        // What was believed of the sizes of empty tables would mislead the planner.
        for table in tables {
            QueryBuilder::<Postgres>::new(format!("ANALYZE \"{}\"", table.name))
                .build()
                .persistent(false)
                .execute(&mut self.conn)
                .await?;
        }
        Ok(())
    }

    async fn close(mut self: Box<Self>) {
        // A session that is told to end does so a moment later: a server that starts at once would find its lock.
        let unlocked = sqlx::query("SELECT pg_advisory_unlock_all()").execute(&mut self.conn).await;
        if let Err(error) = unlocked {
            tracing::debug!(%error, "locks go with their session");
        }
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
        let options = format!("{:?}", options("postgres://nobody@localhost/plant").unwrap());
        assert!(options.contains("slow_statements_level: Off"), "{options}");
    }
}

//! What SQLite finds wrong with a file, and what it cannot find: that its schema is another one.

use crate::error::StoreResult;
use crate::record::StoreFault;
use crate::sqlite::Conn;
use crate::sqlite::by_name;
use crate::sqlite::open::MIGRATIONS;
use futures_util::TryStreamExt;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};
use std::collections::BTreeMap;
use std::path::Path;

/// What SQLite is asked for.
const MOST_TOLD: usize = 100;

/// What SQLite finds wrong with its own pages and indexes, which tables hold rows that they would refuse (the latter only on
/// a connection that may write, as others leave constraints out of their schema), and what of its schema is another than the
/// migrations make.
pub(in crate::sqlite) async fn integrity(conn: &mut Conn) -> StoreResult<Vec<StoreFault>> {
    let mut faults = pages(conn).await?;
    faults.extend(schema(conn).await?);
    Ok(faults)
}

/// What SQLite finds wrong with a file that does not open as a store.
pub(in crate::sqlite) async fn of_file(path: &Path) -> StoreResult<Vec<StoreFault>> {
    let options = SqliteConnectOptions::new().filename(by_name(path)).read_only(true);
    let mut conn = options.connect().await?;
    let faults = pages(&mut conn).await;
    conn.close().await?;
    faults
}

/// Row by row: where a page cannot be read SQLite tells what it has found up to there, and then fails.
async fn pages(conn: &mut Conn) -> StoreResult<Vec<StoreFault>> {
    let of_file = |detail| StoreFault { kind: "file", key: "sqlite".to_owned(), detail, column: None };
    let mut found = sqlx::query_scalar::<_, String>("PRAGMA integrity_check(100)").fetch(conn);
    let (mut faults, mut told) = (Vec::new(), 0);
    loop {
        match found.try_next().await {
            Ok(Some(line)) if line == "ok" => {}
            Ok(Some(line)) => {
                told += 1;
                faults.push(fault_of(&line));
            }
            Ok(None) if told >= MOST_TOLD => {
                faults.push(of_file("SQLite ends its list here: there may be more".to_owned()));
                return Ok(faults);
            }
            Ok(None) => return Ok(faults),
            Err(error) if error.as_database_error().is_some() => {
                faults.push(of_file(format!("SQLite cannot look further: {error}")));
                return Ok(faults);
            }
            Err(error) => return Err(error.into()),
        }
    }
}

fn fault_of(line: &str) -> StoreFault {
    // One line each, and which of several databases it is nobody asks.
    let line = line.trim_start_matches("*** in database main ***").trim().replace('\n', "; ");
    // As in `NULL value in cycles.flags`, `non-INTEGER value in tools.version`.
    let of_value = || line.split_once(" value in ").filter(|(what, _)| !what.contains(' ')).map(|(_, of)| of);
    match line.strip_prefix("CHECK constraint failed in ").or_else(of_value) {
        Some(of) => {
            let (table, column) =
                of.split_once('.').map_or((of, None), |(table, column)| (table, Some(column)));
            StoreFault {
                kind: "table",
                key: table.to_owned(),
                detail: format!("a row of it is none that it takes: {line}"),
                column: column.map(str::to_owned),
            }
        }
        None => StoreFault { kind: "file", key: "sqlite".to_owned(), detail: line, column: None },
    }
}

/// SQLite keeps its schema as text, of which it has no sum: a bit that flips there makes another constraint of one, and rows are
/// refused or taken by it. Held against what the migrations make in an empty database; what somebody has made besides is theirs.
async fn schema(conn: &mut Conn) -> StoreResult<Vec<StoreFault>> {
    let mut fresh = SqliteConnectOptions::new().in_memory(true).connect().await?;
    for migration in MIGRATIONS.iter() {
        sqlx::raw_sql(migration.sql.clone()).execute(&mut fresh).await?;
    }
    let expected = definitions(&mut fresh).await?;
    fresh.close().await?;
    let found = definitions(conn).await?;
    let differing = expected.iter().filter_map(|(name, definition)| {
        let detail = match found.get(name) {
            None => "it is not there",
            Some(found) if found != definition => "its definition is another than the migrations make",
            Some(_) => return None,
        };
        Some(StoreFault { kind: "schema", key: name.clone(), detail: detail.to_owned(), column: None })
    });
    Ok(differing.collect())
}

/// Definitions of tables, indexes, views and triggers, but for those that SQLite and the list of migrations make for themselves.
async fn definitions(conn: &mut Conn) -> StoreResult<BTreeMap<String, String>> {
    let rows: Vec<(String, String, String, String)> = sqlx::query_as(
        "SELECT name, type, tbl_name, COALESCE(sql, '') FROM sqlite_schema
         WHERE substr(name, 1, 7) <> 'sqlite_' AND substr(name, 1, 5) <> '_sqlx'",
    )
    .fetch_all(&mut *conn)
    .await?;
    let definition = |(name, kind, table, sql)| (name, format!("{kind} {table} {sql}"));
    Ok(rows.into_iter().map(definition).collect())
}

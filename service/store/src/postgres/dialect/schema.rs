//! Whether the tables are as the migrations make them: a database that was restored over errors, or moved without its sequences,
//! takes no cycle, or takes one twice.

use crate::error::StoreResult;
use crate::postgres::Conn;
use crate::record::StoreFault;
use std::collections::BTreeSet;

/// Keys, indexes and constraints of all tables, each behind its table. A test holds the list against a database that was just made.
const MADE: &str = include_str!("made.txt");

/// Rows that changes of the registry are counted in.
const COUNTERS: i64 = 16;

/// What is missing, and what would give numbers that are taken.
pub(in crate::postgres) async fn faults(conn: &mut Conn) -> StoreResult<Vec<StoreFault>> {
    let there = names(conn).await?;
    let tables: BTreeSet<&str> =
        there.iter().filter_map(|made| made.split_once(' ')).map(|(table, _)| table).collect();
    let missing = MADE.lines().filter(|made| there.binary_search_by(|name| name.as_str().cmp(made)).is_err());
    // Without its key a table may have a row twice.
    let kind = |made: &str| if made.ends_with("_pkey") { "schema" } else { "constraint" };
    let mut faults: Vec<StoreFault> =
        missing.map(|made| fault(kind(made), made, "no such key, index or constraint is there")).collect();
    // Nothing can be asked of a table that is not there.
    if ["alarms", "audit", "registry_generation", "tool_events"]
        .into_iter()
        .any(|table| !tables.contains(table))
    {
        return Ok(faults);
    }
    let counters: i64 =
        sqlx::query_scalar("SELECT COUNT(*) FROM registry_generation").fetch_one(&mut *conn).await?;
    if counters != COUNTERS {
        faults.push(fault(
            "schema",
            "registry_generation",
            &format!("it has {counters} rows instead of {COUNTERS}"),
        ));
    }
    let behind: Vec<String> = sqlx::query_scalar(
        "SELECT numbered.name FROM (
             SELECT 'alarms alarm_id' AS name, pg_get_serial_sequence('alarms', 'alarm_id') AS sequence, MAX(alarm_id) AS newest FROM alarms
             UNION ALL SELECT 'audit audit_id', pg_get_serial_sequence('audit', 'audit_id'), MAX(audit_id) FROM audit
             UNION ALL SELECT 'tool_events event_id', pg_get_serial_sequence('tool_events', 'event_id'), MAX(event_id) FROM tool_events
         ) AS numbered
         WHERE numbered.newest > COALESCE(pg_sequence_last_value(to_regclass(numbered.sequence)), 0)",
    )
    .fetch_all(&mut *conn)
    .await?;
    faults.extend(
        behind.iter().map(|name| fault("sequence", name, "the numbers that it gives next are taken already")),
    );
    Ok(faults)
}

/// Whether a table is one that the migrations make.
pub(crate) fn is_ours(table: &str) -> bool {
    MADE.lines().any(|made| made.split_once(' ').is_some_and(|(of, _)| of == table))
}

/// What [`MADE`] lists, as it is there, in the order of its bytes.
async fn names(conn: &mut Conn) -> StoreResult<Vec<String>> {
    let mut names: Vec<String> = sqlx::query_scalar(
        "SELECT c.relname::TEXT || ' ' || k.conname::TEXT
         FROM pg_constraint k JOIN pg_class c ON c.oid = k.conrelid
         WHERE c.relnamespace = quote_ident(current_schema())::REGNAMESPACE AND NOT c.relispartition
             AND k.contype IN ('c', 'p', 'u')
         UNION SELECT c.relname::TEXT || ' ' || i.relname::TEXT
         FROM pg_index x JOIN pg_class i ON i.oid = x.indexrelid JOIN pg_class c ON c.oid = x.indrelid
         WHERE c.relnamespace = quote_ident(current_schema())::REGNAMESPACE AND NOT c.relispartition AND x.indisvalid",
    )
    .fetch_all(&mut *conn)
    .await?;
    names.sort_unstable();
    Ok(names)
}

fn fault(kind: &'static str, key: &str, detail: &str) -> StoreFault {
    StoreFault { kind, key: key.to_owned(), detail: detail.to_owned(), column: None }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_list_is_in_order_and_names_every_table() {
        let made: Vec<&str> = MADE.lines().collect();
        assert!(made.is_sorted());
        assert!(is_ours("cycles") && is_ours("write_probe"));
        assert!(!is_ours("cycle") && !is_ours("cycle_samples_202701") && !is_ours(""));
    }
}

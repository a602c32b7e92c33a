//! What SQLite does for statements that are asked again and again: what it looks into, by which index, and whether it sorts.

use super::open::MIGRATIONS;

/// What a statement looks into and whether it sorts, one behind the other, in a database as the migrations make it.
pub(crate) fn plan(sql: &str) -> Vec<String> {
    let conn = rusqlite::Connection::open_in_memory().unwrap();
    for migration in MIGRATIONS.iter() {
        conn.execute_batch(migration.sql.as_str()).unwrap();
    }
    let mut asked = conn.prepare(&format!("EXPLAIN QUERY PLAN {sql}")).unwrap();
    let steps = asked.raw_query().mapped(|row| row.get::<_, String>("detail")).map(Result::unwrap);
    // Which parts of it stand for themselves, SQLite's versions tell differently.
    let steps = steps.filter(|step| ["SEARCH", "SCAN", "USE TEMP"].iter().any(|word| step.starts_with(word)));
    steps.map(|step| step.replace(" EXISTS", "")).collect()
}

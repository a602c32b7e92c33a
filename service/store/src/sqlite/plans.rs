//! Which indexes SQLite goes through: it keeps no figures of its tables, and takes one of two that seem alike.

use super::SqliteStore;
use super::engine::wear::{
    FACTS_OF_TOOL_ON_MACHINE, FIRST_OF_TOOL_ON_MACHINE, JUDGED_OTHERWISE, LOOK, RAN_OF_TOOL_ON_MACHINE,
};
use super::open::SqliteOptions;
use crate::store::Store;
use rusqlite::Connection;

/// Steps of a statement's plan.
fn plan(conn: &Connection, sql: &str) -> Vec<String> {
    let mut explained = conn.prepare(&format!("EXPLAIN QUERY PLAN {sql}")).unwrap();
    let nothing = rusqlite::params_from_iter(vec![None::<i64>; explained.parameter_count()]);
    explained.query_map(nothing, |row| row.get(3)).unwrap().map(Result::unwrap).collect()
}

fn database(folder: &tempfile::TempDir) -> Connection {
    let path = folder.path().join("cell.sqlite3");
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        SqliteStore::open(&path, SqliteOptions::default()).await.unwrap().close().await;
    });
    Connection::open(path).unwrap()
}

#[test]
fn a_tool_on_a_machine_is_looked_for_among_the_tool_s_cycles() {
    let folder = tempfile::tempdir().unwrap();
    let conn = database(&folder);
    let facts = plan(&conn, FACTS_OF_TOOL_ON_MACHINE);
    assert_eq!(facts[0], "SEARCH c USING INDEX cycles_by_tool (tool_id=? AND started_at_us>?)");
    let first = plan(&conn, FIRST_OF_TOOL_ON_MACHINE);
    assert!(
        first.contains(&"SEARCH cycles USING COVERING INDEX cycles_by_tool (tool_id=?)".to_owned()),
        "{first:?}"
    );
}

#[test]
fn what_folds_ran_is_looked_for_among_their_tool_s_cycles() {
    let folder = tempfile::tempdir().unwrap();
    let conn = database(&folder);
    for sql in [RAN_OF_TOOL_ON_MACHINE, JUDGED_OTHERWISE] {
        let steps = plan(&conn, sql);
        assert_eq!(steps[0], "SEARCH cycles USING INDEX cycles_by_tool (tool_id=?)", "{steps:?}");
    }
}

/// A page of folds by their index, and each one's tool: no cycle is looked at, and nothing sorted.
#[test]
fn a_look_for_folds_that_are_behind_goes_through_folds_alone() {
    let folder = tempfile::tempdir().unwrap();
    let steps = plan(&database(&folder), LOOK);
    let [folds, tools] = steps.as_slice() else { panic!("{steps:?}") };
    assert_eq!(folds, "SEARCH w USING INDEX tool_wear_by_tool ((tool_id,machine_id)>(?,?))");
    assert!(tools.starts_with("SEARCH t USING") && tools.contains("(tool_id=?)"), "{tools}");
}

//! What SQLite does for statements that are asked again and again: what it looks into, by which index, and whether it sorts. It keeps no
//! figures of its tables, and takes one of two indexes that seem alike.

use super::engine::cycles::{
    LAST_OF_ALL, LAST_OF_MACHINE, LAST_OF_OPERATION, LAST_OF_TOOL, OF_ALL, OF_MACHINE, OF_OPERATION, OF_TOOL,
};
use super::engine::wear::outdated::{JUDGED_OTHERWISE, LOOK, RAN_OF_TOOL_ON_MACHINE};
use super::engine::wear::{FACTS_OF_TOOL_ON_MACHINE, FIRST_OF_TOOL_ON_MACHINE};
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

#[test]
fn a_tool_on_a_machine_is_looked_for_among_the_tool_s_cycles() {
    let facts = plan(FACTS_OF_TOOL_ON_MACHINE);
    assert_eq!(facts[0], "SEARCH c USING INDEX cycles_by_tool (tool_id=? AND started_at_us>?)");
    let first = plan(FIRST_OF_TOOL_ON_MACHINE);
    assert!(
        first.contains(&"SEARCH cycles USING COVERING INDEX cycles_by_tool (tool_id=?)".to_owned()),
        "{first:?}"
    );
}

#[test]
fn what_folds_ran_is_looked_for_among_their_tool_s_cycles() {
    for sql in [RAN_OF_TOOL_ON_MACHINE, JUDGED_OTHERWISE] {
        let steps = plan(sql);
        assert_eq!(steps[0], "SEARCH cycles USING INDEX cycles_by_tool (tool_id=?)", "{steps:?}");
    }
}

/// A page of folds by their index, and each one's tool: no cycle is looked at, and nothing sorted.
#[test]
fn a_look_for_folds_that_are_behind_goes_through_folds_alone() {
    let steps = plan(LOOK);
    let [folds, tools] = steps.as_slice() else { panic!("{steps:?}") };
    assert_eq!(folds, "SEARCH w USING INDEX tool_wear_by_tool ((tool_id,machine_id)>(?,?))");
    assert!(tools.starts_with("SEARCH t USING") && tools.contains("(tool_id=?)"), "{tools}");
}

/// The first and the newest cycles of what there may be many of, each by its own index between two times.
#[test]
fn lists_of_cycles_begin_and_end_within_their_index() {
    let lists = [
        ("cycles_by_tool (tool_id=? AND ", OF_TOOL, LAST_OF_TOOL),
        ("cycles_by_machine (machine_id=? AND ", OF_MACHINE, LAST_OF_MACHINE),
        ("cycles_by_operation (operation_id=? AND ", OF_OPERATION, LAST_OF_OPERATION),
        ("cycles_by_time (", OF_ALL, LAST_OF_ALL),
    ];
    for (index, first, newest) in lists {
        for sql in [first, newest] {
            let steps = plan(sql);
            assert_eq!(
                steps[0],
                format!("SEARCH c USING INDEX {index}started_at_us>? AND started_at_us<?)"),
                "{steps:?}"
            );
            // Cycles that began at the same time alone are sorted.
            let sorts = |step: &&String| step.starts_with("USE TEMP") && !step.contains("LAST");
            assert_eq!(steps.iter().find(sorts), None, "{steps:?}");
        }
    }
}

use super::super::open::SqliteOptions;
use super::super::{SqliteStore, take_up};
use super::*;
use crate::record::AlarmKind;
use crate::store::Store;
use std::collections::BTreeMap;
use std::fs::File;

/// Long enough for every group to follow the one before.
const SOON: Duration = Duration::from_secs(3600);

struct Given {
    _folder: tempfile::TempDir,
    path: PathBuf,
    runtime: tokio::runtime::Runtime,
}

impl Given {
    fn database() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cell.sqlite3");
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            SqliteStore::open(&path, SqliteOptions::default()).await.unwrap().close().await;
        });
        Self { _folder: folder, path, runtime }
    }

    fn writer(&self) -> GroupWriter {
        let mut writer = GroupWriter::open(&self.path, Duration::from_secs(5)).unwrap();
        writer.plan_journal(&self.path, SOON);
        writer
    }

    /// What is there for whoever opens the database next.
    fn found(&self) -> Vec<String> {
        self.runtime.block_on(take_up(&self.path)).unwrap();
        messages(&Connection::open(&self.path).unwrap())
    }
}

fn messages(conn: &Connection) -> Vec<String> {
    let mut alarms = conn.prepare("SELECT message FROM alarms ORDER BY alarm_id").unwrap();
    alarms.query_map((), |row| row.get(0)).unwrap().map(Result::unwrap).collect()
}

/// Writes a group that raises an alarm of a tool of its own, whose message is the tool.
fn group(writer: &mut GroupWriter, tool: &str) -> StoreResult<Option<Written>> {
    let generation = "SELECT SUM(changes) FROM registry_generation";
    let heads = Heads {
        is_distributed: false,
        generation: writer.conn.query_row(generation, (), |row| row.get(0)).unwrap(),
        any_profile: false,
        versions: BTreeMap::new(),
    };
    let tool: ToolId = tool.try_into().unwrap();
    let alarm = AlarmChange::raise(AlarmKind::Worn, None, Some(&tool), tool.to_string());
    let rest = Rest::of(Vec::new(), (Vec::new(), vec![alarm]), Vec::new(), |_| false);
    let assumption = Assumption { heads: &heads, tools: &BTreeSet::from([&tool]) };
    writer.write(assumption, &[], &rest, Timestamp::from_micros(1))
}

fn groups(writer: &mut GroupWriter, tools: &[&str]) {
    for tool in tools {
        assert!(group(writer, tool).unwrap().is_some(), "{tool}");
    }
}

/// A group that panics has run some of its statements, and begun a record: neither is anybody's.
#[test]
fn what_a_panic_has_left_is_taken_back() {
    for commits_before in [false, true] {
        let given = Given::database();
        let mut writer = given.writer();
        groups(&mut writer, &["alone", "first", "second"]);
        assert!(writer.is_ahead());
        let journal = writer.journal.as_mut().unwrap();
        journal.begin(&writer.conn).unwrap();
        journal.run(AlarmChange::CLEAR_VERDICTS).unwrap();
        writer.conn.execute_batch("UPDATE alarms SET message = 'spoilt'").unwrap();
        writer.dirty = true;
        if commits_before {
            writer.commit().unwrap();
            assert_eq!(messages(&writer.conn), ["alone", "first", "second"]);
        }
        groups(&mut writer, &["third", "fourth"]);
        assert_eq!(messages(&writer.conn), ["alone", "first", "second", "third", "fourth"]);
        // As one that is killed.
        writer.abandon().unwrap();
        assert_eq!(given.found(), ["alone", "first", "second", "third", "fourth"]);
    }
}

/// The transaction has what was acknowledged: it is committed with the group whose record could not be written.
#[test]
fn groups_whose_record_cannot_be_written_are_committed() {
    let given = Given::database();
    let mut writer = given.writer();
    groups(&mut writer, &["alone", "first"]);
    let journal = writer.journal.as_mut().unwrap();
    journal.refuse(File::open(&given.path).unwrap());
    for tool in ["second", "third"] {
        groups(&mut writer, &[tool]);
        assert!(!writer.is_ahead() && writer.journal.is_none(), "{tool}");
    }
    writer.abandon().unwrap();
    assert_eq!(given.found(), ["alone", "first", "second", "third"]);
}

/// A transaction that SQLite has rolled back by itself is made again from the journal, also where a group fails in it.
#[test]
fn what_sqlite_has_rolled_back_is_run_again() {
    let given = Given::database();
    let mut writer = given.writer();
    groups(&mut writer, &["alone", "first", "second"]);
    writer.conn.execute_batch("ROLLBACK").unwrap();
    writer.commit().unwrap();
    assert_eq!(messages(&writer.conn), ["alone", "first", "second"]);

    groups(&mut writer, &["third"]);
    let refusal = "CREATE TEMP TRIGGER refuse BEFORE INSERT ON alarms WHEN NEW.message = 'bad'
         BEGIN SELECT RAISE(ROLLBACK, 'as a full disk does'); END";
    writer.conn.execute_batch(refusal).unwrap();
    group(&mut writer, "bad").unwrap_err();
    groups(&mut writer, &["fourth"]);
    assert_eq!(messages(&writer.conn), ["alone", "first", "second", "third", "fourth"]);
    writer.abandon().unwrap();
    assert_eq!(given.found(), ["alone", "first", "second", "third", "fourth"]);
}

/// A column with its least and its largest number.
type Range = (String, f64, f64);

fn by_column(a: &Range, b: &Range) -> std::cmp::Ordering {
    a.0.cmp(&b.0)
}

/// What a table is checked against: `CONSTRAINT name CHECK (column BETWEEN least AND most)`, and the names of other checks.
fn checks(conn: &Connection, table: &str) -> (Vec<Range>, Vec<String>) {
    let sql: String = conn
        .query_row("SELECT sql FROM sqlite_schema WHERE type = 'table' AND name = ?", [table], |row| {
            row.get(0)
        })
        .unwrap();
    let (mut ranges, mut others) = (Vec::new(), Vec::new());
    let mut named = sql.split("CONSTRAINT ");
    let unnamed = named.next().unwrap().matches("CHECK").count();
    assert_eq!(unnamed, 0, "a check of {table} has no name");
    for check in named {
        let words: Vec<&str> = check.split_whitespace().collect();
        let number = |text: &str| text.trim_end_matches([')', ',']).parse::<f64>().ok();
        match words.as_slice() {
            [_, "CHECK", column, "BETWEEN", least, "AND", most, ..] if !column.contains("length(") => {
                let column = column.trim_start_matches('(').to_owned();
                ranges.push((column, number(least).unwrap(), number(most).unwrap()));
            }
            [name, "CHECK", ..] => others.push((*name).to_owned()),
            other => panic!("no check: {other:?}"),
        }
    }
    ranges.sort_by(by_column);
    others.sort_unstable();
    (ranges, others)
}

/// SQLite is not asked for checks by this writer. All that a table checks is held when rows are made: another check has to
/// be held too before it is named here.
#[test]
fn what_tables_are_checked_against_is_held_before() {
    let given = Given::database();
    let writer = given.writer();
    let is_ignored: bool =
        writer.conn.query_row("PRAGMA ignore_check_constraints", (), |row| row.get(0)).unwrap();
    assert!(is_ignored);
    let number = |text: &str| text.replace(['_', ' '], "").parse::<f64>().unwrap();
    let (ranges, others) = checks(&writer.conn, "cycles");
    let mut held: Vec<Range> = crate::rows::CYCLE_RANGES
        .iter()
        .map(|(column, least, most)| ((*column).to_owned(), number(least), number(most)))
        .collect();
    held.sort_by(by_column);
    assert_eq!(ranges, held);
    // By the types of a cycle's fields, but for the count of quantities, which its row counts.
    let by_type = [
        "cycles_content_hash_length",
        "cycles_cycle_id_length",
        "cycles_depth_digest_length",
        "cycles_law_version_length",
        "cycles_machine_id_length",
        "cycles_operation_id_length",
        "cycles_outcome_word",
        "cycles_process_word",
        "cycles_profile_id_length",
        "cycles_profile_whole",
        "cycles_quantities",
        "cycles_recommendation_id_length",
        "cycles_seq_range",
        "cycles_strategy_word",
        "cycles_tool_id_length",
    ];
    assert_eq!(others, by_type);

    let (ranges, others) = checks(&writer.conn, "recommendations");
    let level = ["as_run", "highest", "lowest", "value"].map(|part| (format!("level_{part}"), -1e6, 1e6));
    let counts = ["n", "window"].map(|part| (format!("level_{part}"), 0.0, f64::from(u32::MAX)));
    let mut held = [level.to_vec(), counts.to_vec(), vec![("level_sd".to_owned(), 0.0, 1e6)]].concat();
    held.sort_by(by_column);
    assert_eq!(ranges, held);
    let by_type = [
        "recommendations_data_age_ms_range",
        "recommendations_level_decides_word",
        "recommendations_level_whole",
        "recommendations_machine_id_length",
        "recommendations_operation_id_length",
        "recommendations_recommendation_id_length",
        "recommendations_remaining_cycles_range",
        "recommendations_remaining_high_range",
        "recommendations_remaining_low_range",
        "recommendations_remaining_whole",
        "recommendations_tool_id_length",
    ];
    assert_eq!(others, by_type);

    // Packs are of blocks that are no longer together than each may be alone.
    let blocks = format!("CHECK (length(blocks) BETWEEN 1 AND {})", crate::rows::MOST_BLOCK_BYTES);
    let packs = "SELECT sql FROM sqlite_schema WHERE type = 'table' AND name = 'sample_packs'";
    let packs: String = writer.conn.query_row(packs, (), |row| row.get(0)).unwrap();
    assert!(packs.contains(&blocks), "{packs}");
    let (ranges, others) = checks(&writer.conn, "cycle_samples");
    let held =
        [("bytes", 1, crate::rows::MOST_BLOCK_BYTES), ("place", 0, crate::codec::pack::MOST_PLACES - 1)];
    #[expect(clippy::cast_precision_loss, reason = "far less than 2^52")]
    let held = held.map(|(column, least, most)| (column.to_owned(), f64::from(least), most as f64));
    assert_eq!((ranges.as_slice(), others.len()), (held.as_slice(), 0));
    for (table, by_type) in [
        ("sample_packs", vec!["sample_packs_blocks_length"]),
        ("advices", vec!["advices_advice_hash_length"]),
        (
            "alarms",
            vec![
                "alarms_acknowledged_by_length",
                "alarms_acknowledged_whole",
                "alarms_kind_word",
                "alarms_machine_id_length",
                "alarms_message_length",
                "alarms_tool_id_length",
            ],
        ),
        ("tool_wear", vec!["tool_wear_machine_id_length", "tool_wear_tool_id_length"]),
    ] {
        let (ranges, others) = checks(&writer.conn, table);
        assert_eq!(others, by_type, "{table}");
        // Counts that begin at 1 or 0 and go up by one.
        let counts: Vec<&str> = ranges.iter().map(|(column, ..)| column.as_str()).collect();
        let expected: &[&str] =
            if table == "tool_wear" { &["fold_version", "folded", "judging_change", "version"] } else { &[] };
        assert_eq!(counts, expected, "{table}");
    }
}

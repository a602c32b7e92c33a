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

use super::*;
use rusqlite::types::Value;

const INSERT: &str = "INSERT INTO kept (value) VALUES (?)";
const UPDATE: &str = "UPDATE kept SET value = ? WHERE value IS ?";

/// A database in a folder, with a journal, a table for values of any kind and one that counts as the cycles.
fn given(folder: &Path) -> (PathBuf, Connection) {
    let path = folder.join("cell.sqlite3");
    let conn = Connection::open(&path).unwrap();
    conn.execute_batch(
        "CREATE TABLE kept (value); CREATE TABLE cycles (cycle_id TEXT);
         CREATE TABLE groups_journal (only_row INTEGER PRIMARY KEY, journal_id BLOB, epoch INTEGER)",
    )
    .unwrap();
    (path, conn)
}

fn insert(journal: &mut Journal, conn: &Connection, value: &Value) {
    journal.run(INSERT).unwrap();
    journal.value(value).unwrap();
    journal.ran(conn.execute(INSERT, [value]).unwrap());
}

fn all(conn: &Connection) -> Vec<Value> {
    let mut kept = conn.prepare("SELECT value FROM kept ORDER BY rowid").unwrap();
    kept.query_map((), |row| row.get(0)).unwrap().map(Result::unwrap).collect()
}

fn values() -> Vec<Value> {
    let texts = ["", "µ", "with\0nul"].map(|text| Value::Text(text.to_owned()));
    let reals = [0.0, -0.0, 0.1, f64::MAX, f64::MIN_POSITIVE, f64::INFINITY].map(Value::Real);
    let numbers = [0, -1, i64::MIN, i64::MAX].map(Value::Integer);
    let bytes = [vec![], vec![0, 255], vec![7; 70_000]].map(Value::Blob);
    [Value::Null].into_iter().chain(texts).chain(reals).chain(numbers).chain(bytes).collect()
}

#[test]
fn every_kind_of_value_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mut conn) = given(folder.path());
    let mut journal = Journal::open(&path, &conn).unwrap();
    conn.execute_batch("BEGIN").unwrap();
    for value in values() {
        journal.begin(&conn).unwrap();
        insert(&mut journal, &conn, &value);
        journal.append().unwrap();
    }
    conn.execute_batch("ROLLBACK").unwrap();
    assert_eq!(all(&conn), []);
    drop(journal);
    take_up(&path, &mut conn).unwrap();
    assert_eq!(all(&conn), values());
    take_up(&path, &mut conn).unwrap();
    assert_eq!(all(&conn), values(), "once");
}

/// What is forgotten takes no definition along that an acknowledged record has made, nor leaves one behind.
#[test]
fn what_is_forgotten_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mut conn) = given(folder.path());
    let mut journal = Journal::open(&path, &conn).unwrap();
    let kept: Vec<Value> = (1..=4).map(Value::Integer).collect();
    for epoch in 0..3 {
        conn.execute_batch("BEGIN").unwrap();
        for value in &kept {
            // Before its first statement, and in the middle of it.
            journal.forget();
            journal.begin(&conn).unwrap();
            journal.run(UPDATE).unwrap();
            journal.value(value).unwrap();
            journal.forget();
            journal.begin(&conn).unwrap();
            insert(&mut journal, &conn, value);
            journal.append().unwrap();
            journal.forget();
        }
        conn.execute_batch("ROLLBACK; BEGIN").unwrap();
        journal.run_again(&conn).unwrap();
        if epoch < 2 {
            journal.note_end(&conn).unwrap();
            conn.execute_batch("COMMIT").unwrap();
            journal.turn();
        } else {
            conn.execute_batch("ROLLBACK").unwrap();
        }
    }
    drop(journal);
    take_up(&path, &mut conn).unwrap();
    assert_eq!(all(&conn), [&kept[..], &kept, &kept].concat());
}

/// Who wrote it has in memory what it stands for; also of a journal of the version before that is left.
#[test]
fn what_only_stands_for_others_is_run_by_who_takes_it_up() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mut conn) = given(folder.path());
    let mut journal = Journal::open(&path, &conn).unwrap();
    conn.execute_batch("BEGIN").unwrap();
    journal.begin(&conn).unwrap();
    insert(&mut journal, &conn, &Value::Integer(1));
    journal.stands_for(INSERT).unwrap();
    journal.value(&Value::Integer(2)).unwrap();
    insert(&mut journal, &conn, &Value::Integer(3));
    journal.append().unwrap();
    conn.execute_batch("ROLLBACK; BEGIN").unwrap();
    journal.run_again(&conn).unwrap();
    assert_eq!(all(&conn), [1, 3].map(Value::Integer));
    conn.execute_batch("ROLLBACK").unwrap();
    drop(journal);
    take_up(&path, &mut conn).unwrap();
    assert_eq!(all(&conn), [1, 2, 3].map(Value::Integer));
}

#[test]
fn one_of_the_version_before_is_taken_up() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mut conn) = given(folder.path());
    let mut journal = Journal::open(&path, &conn).unwrap();
    journal.begin(&conn).unwrap();
    conn.execute_batch("BEGIN").unwrap();
    insert(&mut journal, &conn, &Value::Integer(1));
    conn.execute_batch("ROLLBACK").unwrap();
    journal.append().unwrap();
    let at = journal.path.clone();
    let mut bytes = std::fs::read(&at).unwrap();
    let (id, _) = id_of(&bytes[..HEAD]).unwrap();
    drop(journal);
    // There the first record stood behind the head.
    bytes.drain(HEAD..BLOCK);
    std::fs::write(&at, bytes).unwrap();
    for (version, taken) in [(3, false), (0, false), (1, true)] {
        write_at(&File::options().write(true).open(&at).unwrap(), &head(version, id), 0).unwrap();
        assert_eq!(take_up(&path, &mut conn).is_ok(), taken, "{version}");
    }
    assert_eq!(all(&conn), [Value::Integer(1)]);
    // It goes on in the version of now.
    drop(Journal::open(&path, &conn).unwrap());
    assert_eq!(std::fs::read(&at).unwrap()[..HEAD], head(VERSION, id));
}

/// The epoch fits, and the state does not.
#[test]
fn one_beside_a_database_of_a_later_version_is_left_to_that() {
    let folder = tempfile::tempdir().unwrap();
    let (path, conn) = given(folder.path());
    let mut journal = Journal::open(&path, &conn).unwrap();
    conn.execute_batch("BEGIN").unwrap();
    journal.begin(&conn).unwrap();
    insert(&mut journal, &conn, &Value::Integer(5));
    journal.append().unwrap();
    conn.execute_batch("ROLLBACK").unwrap();
    drop(journal);
    conn.execute_batch(
        "CREATE TABLE _sqlx_migrations (version); INSERT INTO _sqlx_migrations VALUES (1), (9999)",
    )
    .unwrap();
    let refused = take_up_closed(&path).unwrap_err();
    assert!(std::error::Error::source(&refused).unwrap().to_string().contains("9999"), "{refused:?}");
    assert_eq!(all(&conn), []);
    conn.execute_batch("DELETE FROM _sqlx_migrations WHERE version = 9999").unwrap();
    take_up_closed(&path).unwrap();
    assert_eq!(all(&conn), [Value::Integer(5)]);
}

#[test]
fn another_state_is_not_gone_on_with() {
    let changes = [
        "INSERT INTO cycles (cycle_id) VALUES ('c2')",
        "DELETE FROM cycles",
        "UPDATE kept SET value = 3",
        "UPDATE groups_journal SET epoch = 7",
        "UPDATE groups_journal SET journal_id = zeroblob(16)",
        "DELETE FROM groups_journal",
    ];
    for change in changes {
        let folder = tempfile::tempdir().unwrap();
        let (path, mut conn) = given(folder.path());
        conn.execute_batch(
            "INSERT INTO cycles (cycle_id) VALUES ('c1'); INSERT INTO kept (value) VALUES (1)",
        )
        .unwrap();
        let mut journal = Journal::open(&path, &conn).unwrap();
        conn.execute_batch("BEGIN").unwrap();
        journal.begin(&conn).unwrap();
        journal.run(UPDATE).unwrap();
        let (to, from) = (Value::Integer(2), Value::Integer(1));
        journal.value(&to).unwrap();
        journal.value(&from).unwrap();
        journal.ran(conn.execute(UPDATE, [to, from]).unwrap());
        journal.append().unwrap();
        conn.execute_batch("ROLLBACK").unwrap();
        conn.execute_batch(change).unwrap();
        let before = all(&conn);
        // In the process that wrote it, which does not ask for the epoch, and in another one.
        if !change.contains("groups_journal") {
            conn.execute_batch("BEGIN").unwrap();
            assert!(matches!(journal.run_again(&conn), Err(StoreError::NotWritable(_))), "{change}");
            conn.execute_batch("ROLLBACK").unwrap();
        }
        drop(journal);
        let outcome = take_up(&path, &mut conn);
        if change.ends_with("= 7") {
            assert!(outcome.is_ok(), "committed long ago");
        } else {
            assert!(matches!(outcome, Err(StoreError::NotWritable(_))), "{change}: {outcome:?}");
        }
        assert_eq!(all(&conn), before, "{change}");
    }
}

/// Each record is on the disk before the next one is begun: only the last may be cut short without having been acknowledged.
#[test]
fn what_stands_behind_a_damaged_record_was_acknowledged() {
    for (damaged, taken) in [(0, None), (1, None), (2, Some(2))] {
        let folder = tempfile::tempdir().unwrap();
        let (path, mut conn) = given(folder.path());
        let mut journal = Journal::open(&path, &conn).unwrap();
        let mut begins = Vec::new();
        // Of the earlier epoch more is left than the later one writes over.
        for (epoch, records) in [(1, 5), (2, 3)] {
            conn.execute_batch("BEGIN").unwrap();
            for value in 0..records {
                journal.begin(&conn).unwrap();
                insert(&mut journal, &conn, &Value::Integer(10 * epoch + value));
                if epoch == 2 {
                    begins.push(journal.at);
                }
                journal.append().unwrap();
            }
            if epoch == 1 {
                journal.note_end(&conn).unwrap();
                conn.execute_batch("COMMIT").unwrap();
                journal.turn();
            } else {
                conn.execute_batch("ROLLBACK").unwrap();
            }
        }
        let before = all(&conn);
        let at = journal.path.clone();
        drop(journal);
        let good = std::fs::read(&at).unwrap();
        write_at(&File::options().write(true).open(&at).unwrap(), &[0xff], begins[damaged] + 21).unwrap();
        match (take_up(&path, &mut conn), taken) {
            (Ok(()), Some(taken)) => {
                let taken: Vec<_> = (0..taken).map(|value| Value::Integer(20 + value)).collect();
                assert_eq!(all(&conn), [before, taken].concat());
            }
            (Err(StoreError::NotWritable(why)), None) => {
                assert!(why.to_string().contains("is damaged"), "{why}");
                assert_eq!(all(&conn), before, "nothing of it");
                std::fs::write(&at, good).unwrap();
                take_up(&path, &mut conn).unwrap();
                assert_eq!(all(&conn).len(), before.len() + 3);
            }
            (outcome, _) => panic!("{damaged}: {outcome:?}"),
        }
    }
}

#[test]
fn a_record_that_cannot_be_written_is_the_last() {
    let folder = tempfile::tempdir().unwrap();
    let (path, conn) = given(folder.path());
    let mut journal = Journal::open(&path, &conn).unwrap();
    assert!(journal.has_room() && !journal.is_touched());
    journal.refuse(File::open(&journal.path).unwrap());
    journal.begin(&conn).unwrap();
    insert(&mut journal, &conn, &Value::Null);
    journal.append().unwrap_err();
    assert!(!journal.has_room() && journal.has_failed() && journal.is_touched());
}

#[test]
fn one_that_is_of_no_known_form_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mut conn) = given(folder.path());
    let journal = path_of(&path).unwrap();
    for (bytes, taken) in [(vec![], true), (vec![0; 4096], true), (vec![0; 39], true), (vec![1; 4096], false)]
    {
        std::fs::write(&journal, &bytes).unwrap();
        assert_eq!(take_up(&path, &mut conn).is_ok(), taken, "{} bytes", bytes.len());
        assert_eq!(std::fs::read(&journal).unwrap(), bytes);
    }
}

/// Its whole length is on the disk before its head is: what is shorter was cut, and what has records and no head written over.
#[test]
fn one_that_was_cut_or_lost_its_head_is_damaged() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mut conn) = given(folder.path());
    let mut journal = Journal::open(&path, &conn).unwrap();
    let mut ends = Vec::new();
    conn.execute_batch("BEGIN").unwrap();
    for value in 0..3 {
        journal.begin(&conn).unwrap();
        insert(&mut journal, &conn, &Value::Integer(value));
        journal.append().unwrap();
        ends.push(journal.at);
    }
    conn.execute_batch("ROLLBACK").unwrap();
    let at = journal.path.clone();
    drop(journal);
    let good = std::fs::read(&at).unwrap();
    let cut = |length: u64| good[..usize::try_from(length).unwrap()].to_vec();
    let headless = [vec![0; HEAD], good[HEAD..].to_vec()].concat();
    for (what, bytes) in [
        ("behind the head", cut(FIRST)),
        ("behind the first record", cut(ends[0])),
        ("within the last", cut(ends[2] - 1)),
        ("behind the last", cut(ends[2])),
        ("without its head", headless),
    ] {
        std::fs::write(&at, bytes).unwrap();
        let refused = take_up(&path, &mut conn).expect_err(what);
        let StoreError::NotWritable(why) = refused else { panic!("{what}: {refused}") };
        assert!(why.to_string().contains("is damaged"), "{what}: {why}");
        assert_eq!(all(&conn), [], "{what}");
    }
    std::fs::write(&at, good).unwrap();
    take_up(&path, &mut conn).unwrap();
    assert_eq!(all(&conn).len(), 3);
}

#[test]
fn two_do_not_have_one() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mut conn) = given(folder.path());
    let journal = Journal::open(&path, &conn).unwrap();
    assert!(matches!(Journal::open(&path, &conn), Err(StoreError::Unavailable(_))));
    take_up(&path, &mut conn).expect("it holds nothing that would have to be waited for");
    drop(journal);
    Journal::open(&path, &conn).unwrap();
}

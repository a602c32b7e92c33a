//! The schema is what Citus can distribute by machine. The extension itself is not run here: these are its documented
//! conditions, held against the migrated schema.

use super::given::{Given, Run, shop, stored};
use feedwright_store::{CycleFilter, Page, Repair};
use sqlx::{Connection, Executor, PgConnection};
use std::collections::{BTreeMap, BTreeSet};

const SQL: &str = include_str!("../../../deploy/citus/distribute.sql");

/// What `distribute.sql` does with each table: distributed by a column, or `None` for a reference or a local one.
fn placed() -> BTreeMap<String, Option<String>> {
    let mut placed = BTreeMap::new();
    let mut place = |table: &str, by: Option<&str>| {
        let twice = placed.insert(table.to_owned(), by.map(str::to_owned));
        assert!(twice.is_none(), "{table} is placed twice");
    };
    for line in SQL.lines() {
        if let Some(call) = line.strip_prefix("SELECT create_distributed_table(") {
            let mut arguments = call.split('\'');
            let (table, by) = (arguments.nth(1).unwrap(), arguments.nth(1).unwrap());
            place(table, Some(by));
        } else if let Some(call) = line.strip_prefix("SELECT create_reference_table(") {
            place(call.split('\'').nth(1).unwrap(), None);
        } else if let Some(table) = line.strip_prefix("-- local: ") {
            place(table, None);
        }
    }
    placed
}

#[tokio::test]
async fn every_table_is_placed_and_every_key_of_a_distributed_one_holds_its_column() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let mut conn = PgConnection::connect(&given.address()).await.unwrap();
    let tables: Vec<String> = sqlx::query_scalar(
        "SELECT relname::TEXT FROM pg_class WHERE relnamespace = 'public'::regnamespace AND relkind IN ('r', 'p')
         AND NOT relispartition AND relname <> '_sqlx_migrations'",
    )
    .fetch_all(&mut conn)
    .await
    .unwrap();
    let placed = placed();
    let there: BTreeSet<_> = tables.iter().cloned().collect();
    for table in &there {
        assert!(placed.contains_key(table), "deploy/citus/distribute.sql does not place {table}");
    }
    for table in placed.keys().filter(|table| SQL.contains(&format!("_table('{table}'"))) {
        assert!(there.contains(table), "{table} is placed and not there");
    }

    // Unique indexes, those of primary keys among them, with the plain columns that each is over.
    let keys: Vec<(String, String, Vec<Option<String>>)> = sqlx::query_as(
        "SELECT t.relname::TEXT, i.relname::TEXT,
                array_agg(a.attname::TEXT) FROM pg_index x
         JOIN pg_class t ON t.oid = x.indrelid JOIN pg_class i ON i.oid = x.indexrelid
         CROSS JOIN unnest(x.indkey::INT[]) AS k (attnum)
         LEFT JOIN pg_attribute a ON a.attrelid = t.oid AND a.attnum = k.attnum
         WHERE x.indisunique AND t.relnamespace = 'public'::regnamespace AND NOT t.relispartition
         GROUP BY 1, 2",
    )
    .fetch_all(&mut conn)
    .await
    .unwrap();
    let mut held = 0;
    for (table, index, columns) in &keys {
        if let Some(Some(by)) = placed.get(table) {
            assert!(columns.contains(&Some(by.clone())), "{index} of {table} lacks {by}");
            held += 1;
        }
    }
    for (table, by) in &placed {
        assert!(by.as_ref().is_none_or(|by| by == "machine_id"), "{table} is distributed by {by:?}");
    }
    let distributed = placed.values().flatten().count();
    assert!(held >= distributed, "each of the {distributed} has a primary key, found {held}");

    // No key leads from one table to another: across shards Citus has none, and within them we need none.
    let foreign: Vec<String> =
        sqlx::query_scalar("SELECT conname::TEXT FROM pg_constraint WHERE contype = 'f'")
            .fetch_all(&mut conn)
            .await
            .unwrap();
    assert_eq!(foreign, Vec::<String>::new());
    // Nor does a distributed table have triggers or numbers of its own, which each shard would count apart.
    let odd: Vec<String> = sqlx::query_scalar(
        "SELECT t.relname::TEXT FROM pg_class t WHERE t.relnamespace = 'public'::regnamespace AND (
             EXISTS (SELECT 1 FROM pg_trigger g WHERE g.tgrelid = t.oid AND NOT g.tgisinternal)
             OR EXISTS (SELECT 1 FROM pg_attribute a WHERE a.attrelid = t.oid AND a.attidentity <> ''))",
    )
    .fetch_all(&mut conn)
    .await
    .unwrap();
    for table in &odd {
        assert!(placed[table].is_none(), "{table} cannot be distributed");
    }
    assert!(odd.contains(&"audit".to_owned()), "the question finds what is there: {odd:?}");
    conn.close().await.unwrap();
    given.done().await;
}

/// Statements that write a fold, kept by a trigger; with `marked`, as if the database had Citus' list of what it distributes.
async fn statements_that_write_folds(marked: bool) -> Option<Vec<String>> {
    let given = Given::postgres().await?;
    let mut conn = PgConnection::connect(&given.address()).await.unwrap();
    conn.execute(sqlx::raw_sql(
        "CREATE TABLE written (id BIGINT GENERATED ALWAYS AS IDENTITY, query TEXT);
         CREATE FUNCTION note_query() RETURNS TRIGGER LANGUAGE plpgsql AS
             $$ BEGIN INSERT INTO written (query) VALUES (current_query()); RETURN NULL; END $$;
         CREATE TRIGGER note AFTER INSERT ON tool_wear FOR EACH STATEMENT EXECUTE FUNCTION note_query()",
    ))
    .await
    .unwrap();
    if marked {
        conn.execute("CREATE TABLE pg_dist_partition ()").await.unwrap();
    }
    let store = given.store();
    shop(&*store).await;
    for n in 1..=2 {
        stored(&*store, &Run::nth(n)).await;
    }
    let cycles = store.cycles(&CycleFilter::default(), Page { after: None, limit: 10 }).await.unwrap();
    assert_eq!(cycles.len(), 2);
    for cycle in &cycles {
        assert!(store.cycle_samples(&cycle.cycle.machine, &cycle.cycle.id).await.unwrap().is_some());
    }
    let wear = store.check_wear(Repair::No).await.unwrap();
    assert_eq!((wear.rows, wear.different), (1, vec![]));
    let written =
        sqlx::query_scalar("SELECT query FROM written ORDER BY id").fetch_all(&mut conn).await.unwrap();
    conn.close().await.unwrap();
    given.done().await;
    Some(written)
}

/// Everybody in a group waits for each of its statements; Citus divides one among its nodes that writes a single table.
#[tokio::test]
async fn a_group_ends_with_one_statement_or_with_one_for_each_table() {
    let Some(together) = statements_that_write_folds(false).await else {
        return;
    };
    let others = ["INSERT INTO cycle_samples", "INSERT INTO recommendations"];
    let Some(apart) = statements_that_write_folds(true).await else {
        return;
    };
    assert_eq!((together.len(), apart.len()), (2, 2), "one for each group");
    for query in &together {
        assert!(others.iter().all(|other| query.contains(other)), "{query}");
    }
    for query in &apart {
        assert!(others.iter().all(|other| !query.contains(other)), "{query}");
    }
}

/// What is changed of tables that are distributed already: Citus adds a constraint to one by a statement of its own, or with its column.
/// Migration 20 does not, and is for databases that are not distributed yet.
#[test]
fn later_migrations_change_what_is_distributed() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../migrations/postgres");
    let mut seen = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        let changes: Vec<&str> = text
            .split(';')
            .filter(|one| one.contains("ALTER TABLE") && one.contains("ADD CONSTRAINT"))
            .collect();
        seen += changes.len();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if name[..4].parse::<u32>().unwrap() > 20 {
            for change in changes {
                let steps = ["ADD ", "DROP ", "ALTER COLUMN "].map(|word| change.matches(word).count());
                assert_eq!(steps, [1, 0, 0], "{}: {change}", path.display());
            }
        }
    }
    assert!(seen > 0, "migrations with constraints are found");
}

/// A database that is empty but for Citus' list of what it distributes, with something in it, and that notes the text in which each change of a
/// table comes; its name.
async fn noting_distributed_database(server: &str) -> String {
    let name = format!("distributed_{}", std::process::id());
    let mut admin = PgConnection::connect(server).await.unwrap();
    let mut create = sqlx::QueryBuilder::<sqlx::Postgres>::new("CREATE DATABASE ");
    create.push(&name).build().persistent(false).execute(&mut admin).await.unwrap();
    let (base, _) = server.rsplit_once('/').unwrap();
    let mut conn = PgConnection::connect(&format!("{base}/{name}")).await.unwrap();
    conn.execute(sqlx::raw_sql(
        "CREATE TABLE pg_dist_partition ();
         INSERT INTO pg_dist_partition DEFAULT VALUES;
         CREATE SCHEMA noted;
         CREATE TABLE noted.texts (text TEXT);
         CREATE FUNCTION noted.note() RETURNS EVENT_TRIGGER LANGUAGE plpgsql AS
             $$ BEGIN INSERT INTO noted.texts VALUES (current_query()); END $$;
         CREATE EVENT TRIGGER noted ON ddl_command_start WHEN TAG IN ('ALTER TABLE', 'CREATE INDEX')
             EXECUTE FUNCTION noted.note()",
    ))
    .await
    .unwrap();
    conn.close().await.unwrap();
    admin.close().await.unwrap();
    name
}

/// Checks and indexes, as the database words them.
async fn checks_and_indexes(given: &Given) -> BTreeSet<String> {
    let mut conn = PgConnection::connect(&given.address()).await.unwrap();
    let found: Vec<String> = sqlx::query_scalar(
        "SELECT conrelid::regclass::TEXT || ' ' || conname || ' ' || pg_get_constraintdef(oid) FROM pg_constraint
         WHERE connamespace = 'public'::regnamespace
         UNION ALL SELECT indexdef FROM pg_indexes WHERE schemaname = 'public'",
    )
    .fetch_all(&mut conn)
    .await
    .unwrap();
    conn.close().await.unwrap();
    found.into_iter().collect()
}

/// Citus sends a change of a distributed table on with the whole text that it came in, and takes one statement of it.
#[tokio::test]
async fn a_distributed_database_is_migrated_statement_by_statement_to_the_same_schema() {
    let Some(server) = Given::server() else {
        return;
    };
    let empty = noting_distributed_database(&server).await;
    let distributed = Given::postgres_made(&format!("TEMPLATE {empty}")).await.unwrap();
    let usual = Given::postgres().await.unwrap();
    let (one, other) = (checks_and_indexes(&distributed).await, checks_and_indexes(&usual).await);
    assert!(one.len() > 50, "the question finds what is there: {one:?}");
    assert_eq!(one, other);

    let mut conn = PgConnection::connect(&distributed.address()).await.unwrap();
    let texts: Vec<String> =
        sqlx::query_scalar("SELECT DISTINCT text FROM noted.texts").fetch_all(&mut conn).await.unwrap();
    let applied: Vec<Vec<u8>> = sqlx::query_scalar("SELECT checksum FROM _sqlx_migrations ORDER BY version")
        .fetch_all(&mut conn)
        .await
        .unwrap();
    conn.close().await.unwrap();
    for change in ["operations_judging_change_range", "ADD COLUMN row_sum", "cycles_coverage"] {
        let with = |text: &&String| text.contains(change) && !text.contains("CREATE TABLE cycles (");
        let text = texts.iter().find(with).unwrap_or_else(|| panic!("nothing changed {change}"));
        assert!(text.starts_with("DO "), "{text}");
    }
    let mut conn = PgConnection::connect(&usual.address()).await.unwrap();
    let as_usual: Vec<Vec<u8>> = sqlx::query_scalar("SELECT checksum FROM _sqlx_migrations ORDER BY version")
        .fetch_all(&mut conn)
        .await
        .unwrap();
    conn.close().await.unwrap();
    assert_eq!(applied, as_usual, "a migration is known by its file");

    // Who opens it again finds nothing to do.
    shop(&distributed.server_of_its_own().await).await;
    distributed.done().await;
    usual.done().await;
    let mut admin = PgConnection::connect(&server).await.unwrap();
    let mut drop = sqlx::QueryBuilder::<sqlx::Postgres>::new("DROP DATABASE ");
    drop.push(&empty).build().persistent(false).execute(&mut admin).await.unwrap();
}

/// The statements in a source: its string literals that name a join, in one line each.
fn joins(source: &str) -> Vec<String> {
    let flat = source.split_whitespace().collect::<Vec<_>>().join(" ");
    let literals = flat.split('"').filter(|text| text.contains("JOIN "));
    literals.map(str::to_owned).collect()
}

/// Rows of different machines stand on different nodes: what joins two distributed tables joins them by machine.
#[test]
fn distributed_tables_are_joined_by_machine() {
    let distributed: BTreeSet<String> =
        placed().into_iter().filter(|(_, by)| by.is_some()).map(|(table, _)| table).collect();
    let mut joined = 0;
    let mut held = 0;
    for (path, text) in sources() {
        for statement in joins(&text) {
            for (at, _) in statement.match_indices("JOIN ") {
                joined += 1;
                let rest = &statement[at + "JOIN ".len()..];
                let mut words = rest.split(' ');
                let (table, alias) = (words.next().unwrap_or(""), words.next().unwrap_or(""));
                if !distributed.contains(table) {
                    continue;
                }
                held += 1;
                // All rows of its inner side that could be meant would be read first.
                let beside =
                    statement[..at].rsplit("FROM ").next().unwrap_or("").split(' ').next().unwrap_or("");
                assert!(
                    !statement[..at].ends_with("LEFT ") || distributed.contains(beside),
                    "{path}: {beside}, which is not distributed, is left-joined with {table}: {statement}"
                );
                let condition = rest.split(" ON ").nth(1).unwrap_or("");
                let ends = ["JOIN ", "WHERE ", "ORDER ", "GROUP "];
                let end =
                    ends.iter().filter_map(|word| condition.find(word)).min().unwrap_or(condition.len());
                assert!(
                    condition[..end].contains(&format!("{alias}.machine_id = ")),
                    "{path}: {table} is joined otherwise than by machine: {statement}"
                );
            }
        }
    }
    assert!(joined >= 10 && held >= 2, "statements are found: {joined} joins, {held} of distributed tables");
}

/// Every source of the store, by its path.
fn sources() -> Vec<(String, String)> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../service/store/src");
    let mut paths = vec![std::path::PathBuf::from(folder)];
    let mut read = Vec::new();
    while let Some(path) = paths.pop() {
        if path.is_dir() {
            paths.extend(std::fs::read_dir(path).unwrap().flatten().map(|entry| entry.path()));
        } else {
            read.push((path.display().to_string(), std::fs::read_to_string(&path).unwrap()));
        }
    }
    read
}

/// Citus refuses to lock rows of several shards at once: a tool's folds stand on as many as it has machines.
#[test]
fn no_statement_locks_rows_of_several_shards() {
    let sources = sources();
    for (path, text) in &sources {
        assert!(!text.contains("FOR UPDATE") && !text.contains("FOR SHARE"), "{path}");
    }
    assert!(sources.len() > 30, "the store's sources are read");
}

/// A change that has written a table of which each node has a copy and then read shards by several connections may not
/// join the two (Citus issue 3426), and each connection to a worker has a snapshot of its own (Citus 11.2 and later send the
/// level of a transaction on): every transaction keeps to one connection a worker.
#[test]
fn every_transaction_keeps_to_one_connection_a_worker() {
    let (mut changes, mut reads) = (0, 0);
    for (path, text) in sources().into_iter().filter(|(path, _)| path.ends_with("postgres.rs")) {
        for begin in text.split("const BEGIN").skip(1) {
            let statement = begin.split("\";").next().unwrap_or("");
            assert!(
                statement.contains("SET LOCAL citus.max_adaptive_executor_pool_size = 1"),
                "{path}: {statement}"
            );
            *(if statement.contains("READ ONLY") { &mut reads } else { &mut changes }) += 1;
        }
    }
    assert_eq!((changes, reads), (2, 5), "with and without a pooler, reads of lists too, and what is copied");
}

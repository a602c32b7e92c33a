//! Databases of before: opened by this version, they hold what they held, to the bit.

use super::given::{
    Given, Run, at, commit, engineer, event, machine, operation, shop, stored, tool, unpacked,
};
use super::row_sums::held;
use feedwright_core::cycle::Flag;
use feedwright_core::ids::RecommendationId;
use feedwright_core::recommend::RecommendSettings;
use feedwright_core::tool::ToolEventKind;
use feedwright_core::wear::{Exclusion, FOLD_VERSION, ToolState};
use feedwright_store::transfer::{TableSum, back_up_postgres, back_up_sqlite, restore_to_sqlite};
use feedwright_store::{
    AlarmFilter, Committed, CycleFilter, Doubt, NewCycle, Page, PostgresOptions, PostgresStore, Precondition,
    Renewed, Repair, SqliteOptions, SqliteStore, Store, SumPage,
};
use sqlx::migrate::Migrator;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, Executor, PgConnection, SqliteConnection};
use std::path::{Path, PathBuf};

super::given::stories!(with tables:
    a_database_of_a_later_version_is_told_as_one,
    what_a_database_of_before_holds_is_all_there_and_goes_on,
    folds_of_other_rules_are_folded_again,
    what_a_server_of_before_changed_of_an_operation_is_noted_with_the_next_change,
);

/// The version before recommendations stood by their machine, and SQLite's folds in an ordinary table; advice was kept
/// for each machine and tool by itself.
const BEFORE: i64 = 14;

/// Pages of SQLite files that some version made, bytes.
const PAGE_BEFORE: i64 = 8192;

/// Tables with states of folds.
const STATES: [&str; 2] = ["tool_wear", "tool_wear_checkpoints"];

/// Stores states of folds as that version did.
macro_rules! unpack_states {
    ($conn:ident) => {
        for table in STATES {
            let states: Vec<(String, String, i64, Vec<u8>)> = sqlx::query_as(AssertSqlSafe(format!(
                "SELECT machine_id, tool_id, folded, state FROM {table}"
            )))
            .fetch_all(&mut $conn)
            .await
            .unwrap();
            for (machine, tool, folded, state) in states {
                sqlx::query(AssertSqlSafe(format!(
                    "UPDATE {table} SET state = $4 WHERE machine_id = $1 AND tool_id = $2 AND folded = $3"
                )))
                .bind(machine)
                .bind(tool)
                .bind(folded)
                .bind(unpacked(&state))
                .execute(&mut $conn)
                .await
                .unwrap();
            }
        }
    };
}

async fn migrations(engine: &str) -> Migrator {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../migrations")).join(engine);
    Migrator::new(folder).await.unwrap()
}

/// Makes the database what that version would have made of the same rows.
async fn set_back(given: &Given) {
    if given.is_postgres() {
        set_back_postgres(&given.address()).await;
    } else {
        set_back_sqlite(&given.file()).await;
    }
}

async fn set_back_sqlite(file: &Path) {
    let newer = file.with_extension("newer");
    std::fs::rename(file, &newer).unwrap();
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(file).create_if_missing(true);
    let options = options.page_size(u32::try_from(PAGE_BEFORE).unwrap());
    let options = options.journal_mode(sqlx::sqlite::SqliteJournalMode::Wal);
    let mut conn = options.connect().await.unwrap();
    migrations("sqlite").await.run_to(BEFORE, &mut conn).await.unwrap();
    sqlx::query("ATTACH DATABASE $1 AS newer").bind(newer.to_str()).execute(&mut conn).await.unwrap();
    let tables: Vec<(String, String)> = sqlx::query_as(
        "SELECT s.name, (SELECT group_concat('\"' || c.name || '\"', ', ') FROM pragma_table_info(s.name, 'main') AS c)
         FROM main.sqlite_schema AS s
         WHERE s.type = 'table' AND s.name NOT LIKE 'sqlite_%' AND s.name <> '_sqlx_migrations'",
    )
    .fetch_all(&mut conn)
    .await
    .unwrap();
    // Advice is made of what it says, below, and blocks come out of their packs.
    let below = ["advices", "cycle_samples"];
    for (table, columns) in tables.into_iter().filter(|(table, _)| !below.contains(&table.as_str())) {
        let selected = match table.as_str() {
            "recommendations" => columns.replace("\"recommendation_id\"", ID),
            _ => columns.clone(),
        };
        // The migrations fill some tables themselves.
        for sql in [
            format!("DELETE FROM main.\"{table}\""),
            format!("INSERT INTO main.\"{table}\" ({columns}) SELECT {selected} FROM newer.\"{table}\""),
        ] {
            conn.execute(AssertSqlSafe(sql)).await.unwrap();
        }
    }
    let samples: Vec<(String, i64, String, Vec<u8>, i64)> = sqlx::query_as(
        "SELECT s.machine_id, s.received_at_us, s.cycle_id, p.blocks, s.place
         FROM newer.cycle_samples s JOIN newer.sample_packs p ON p.pack = s.pack",
    )
    .fetch_all(&mut conn)
    .await
    .unwrap();
    for (machine, received, cycle, pack, place) in samples {
        sqlx::query("INSERT INTO main.cycle_samples (machine_id, received_at_us, cycle_id, block) VALUES ($1, $2, $3, $4)")
            .bind(machine)
            .bind(received)
            .bind(cycle)
            .bind(block_of(&pack, usize::try_from(place).unwrap()))
            .execute(&mut conn)
            .await
            .unwrap();
    }
    // A hash of its own for each of the story's two machines and two tools.
    let hash =
        "unhex(substr(hex(r.advice_hash), 1, 30) || CASE r.machine_id WHEN 'M1' THEN '0' ELSE '1' END ||
                    CASE r.tool_id WHEN 'T1' THEN '0' ELSE '1' END)";
    for sql in [
        format!(
            "INSERT INTO main.advices
             SELECT DISTINCT {hash}, json_set(a.body, '$.machine', r.machine_id, '$.operation', r.operation_id,
                                              '$.tool', r.tool_id)
             FROM newer.recommendations r JOIN newer.advices a ON a.advice_hash = r.advice_hash"
        ),
        format!(
            "UPDATE main.recommendations SET advice_hash =
                 (SELECT {hash} FROM newer.recommendations r
                  WHERE {} = main.recommendations.recommendation_id)
             WHERE recommendation_id <> 'alone'",
            ID.replace("recommendation_id", "r.recommendation_id")
        ),
        "DELETE FROM main.advices WHERE body ->> '$.machine' IS NULL".to_owned(),
    ] {
        conn.execute(AssertSqlSafe(sql)).await.unwrap();
    }
    conn.execute("DETACH DATABASE newer").await.unwrap();
    unpack_states!(conn);
    conn.close().await.unwrap();
    std::fs::remove_file(newer).unwrap();
}

/// The block at a place of a pack (`codec/pack.rs`).
fn block_of(pack: &[u8], place: usize) -> Vec<u8> {
    let Some([1, count, rest @ ..]) = pack.strip_prefix(b"FP") else {
        return pack.to_vec();
    };
    let (mut lengths, mut rest) = (Vec::new(), rest);
    for _ in 0..*count {
        let (mut length, mut shift) = (0_usize, 0);
        while let [byte, later @ ..] = rest {
            rest = later;
            length |= usize::from(byte & 0x7f) << shift;
            shift += 7;
            if byte & 0x80 == 0 {
                break;
            }
        }
        lengths.push(length);
    }
    let from = 4 + lengths[..place].iter().sum::<usize>();
    rest[from..from + lengths[place]].to_vec()
}

/// An id of SQLite's as that version had it.
const ID: &str = "CASE WHEN length(recommendation_id) < 16 THEN CAST(recommendation_id AS TEXT) ELSE lower(
    hex(substr(recommendation_id, 1, 4)) || '-' || hex(substr(recommendation_id, 5, 2)) || '-' ||
    hex(substr(recommendation_id, 7, 2)) || '-' || hex(substr(recommendation_id, 9, 2)) || '-' ||
    hex(substr(recommendation_id, 11, 6))) || iif(length(recommendation_id) = 17, '-reference', '') END";

async fn set_back_postgres(address: &str) {
    let mut conn = PgConnection::connect(address).await.unwrap();
    conn.execute("ALTER SCHEMA public RENAME TO newer; CREATE SCHEMA public").await.unwrap();
    migrations("postgres").await.run_to(BEFORE, &mut conn).await.unwrap();
    let tables: Vec<(String, String)> = sqlx::query_as(
        "SELECT c.table_name::TEXT, string_agg(quote_ident(c.column_name), ', ' ORDER BY c.ordinal_position)
         FROM information_schema.columns c
         JOIN pg_class k ON k.oid = to_regclass('public.' || quote_ident(c.table_name))
         WHERE c.table_schema = 'public' AND k.relkind IN ('r', 'p') AND NOT k.relispartition
             AND c.table_name <> '_sqlx_migrations'
         GROUP BY c.table_name",
    )
    .fetch_all(&mut conn)
    .await
    .unwrap();
    assert!(tables.len() > 20, "the tables are found: {tables:?}");
    for (table, columns) in tables {
        let copy = format!(
            "INSERT INTO public.\"{table}\" ({columns}) OVERRIDING SYSTEM VALUE SELECT {columns} FROM newer.\"{table}\""
        );
        // The migrations fill some tables themselves; the audit lets nobody delete, and is not one of them.
        if table != "audit" {
            conn.execute(AssertSqlSafe(format!("DELETE FROM public.\"{table}\""))).await.unwrap();
        }
        conn.execute(AssertSqlSafe(copy)).await.unwrap();
    }
    let hash = "set_byte(r.advice_hash, 15, CASE r.machine_id WHEN 'M1' THEN 0 ELSE 2 END +
                    CASE r.tool_id WHEN 'T1' THEN 0 ELSE 1 END)";
    for sql in [
        format!(
            "INSERT INTO public.advices
             SELECT DISTINCT {hash}, (a.body::JSONB || jsonb_build_object('machine', r.machine_id, 'operation',
                                          r.operation_id, 'tool', r.tool_id))::TEXT
             FROM newer.recommendations r JOIN newer.advices a ON a.advice_hash = r.advice_hash"
        ),
        format!(
            "UPDATE public.recommendations o SET advice_hash = {hash}
             FROM newer.recommendations r
             WHERE r.recommendation_id = o.recommendation_id AND o.recommendation_id <> 'alone'"
        ),
        "DELETE FROM public.advices WHERE body::JSON ->> 'machine' IS NULL".to_owned(),
    ] {
        conn.execute(AssertSqlSafe(sql)).await.unwrap();
    }
    unpack_states!(conn);
    conn.execute("DROP SCHEMA newer CASCADE").await.unwrap();
    for (table, key) in [("audit", "audit_id"), ("alarms", "alarm_id"), ("tool_events", "event_id")] {
        let follow = format!(
            "SELECT setval(pg_get_serial_sequence('{table}', '{key}'), (SELECT COALESCE(MAX({key}), 1) FROM {table}))"
        );
        conn.execute(AssertSqlSafe(follow)).await.unwrap();
    }
    conn.close().await.unwrap();
}

async fn open(given: &Given) -> Box<dyn Store> {
    if given.is_postgres() {
        Box::new(PostgresStore::open(&given.address(), PostgresOptions::default()).await.unwrap())
    } else {
        Box::new(SqliteStore::open(given.file(), SqliteOptions::default()).await.unwrap())
    }
}

/// Number of rows and digest of every table.
async fn sums(given: &Given) -> Vec<(String, TableSum)> {
    let folder = tempfile::tempdir().unwrap();
    let backup = folder.path().join("backup");
    let made = if given.is_postgres() {
        back_up_postgres(&given.address(), &backup, at(1)).await
    } else {
        back_up_sqlite(&given.file(), &backup, at(1)).await
    };
    made.unwrap().tables
}

/// The folds as they are stored, without what is only packing.
async fn folds(given: &Given) -> Vec<(String, String, i64, Vec<u8>)> {
    let states = given.wear_states().await.into_iter();
    states.map(|(machine, tool, folded, state)| (machine, tool, folded, unpacked(&state))).collect()
}

/// Everything that the trait shows of the cycles, the tools and the advice that was handed out.
async fn shown(store: &dyn Store, advice: &[RecommendationId]) -> Vec<String> {
    let mut lines = Vec::new();
    for cycle in store.cycles(&CycleFilter::default(), Page { after: None, limit: 1000 }).await.unwrap() {
        let samples = store.cycle_samples(&cycle.cycle.machine, &cycle.cycle.id).await.unwrap();
        lines.push(format!("{cycle:?} {samples:?}"));
    }
    for tool in ["T1", "T2"] {
        lines.push(format!("{:?}", store.verdict(&tool.try_into().unwrap()).await.unwrap()));
    }
    for id in advice {
        let issued = store.recommendation(id).await.unwrap();
        lines.push(format!("{:?}", issued.unwrap_or_else(|| panic!("{id} was handed out"))));
    }
    lines
}

/// The `n`th of the story: two machines, two tools, some without samples.
fn run(n: u32) -> Run {
    Run {
        machine: if n.is_multiple_of(7) { "M2" } else { "M1" },
        tool: if n.is_multiple_of(9) { "T2".to_owned() } else { "T1".to_owned() },
        sampled: !n.is_multiple_of(5),
        load: 30.0 + f64::from(n) * 0.07,
        ..Run::nth(n)
    }
}

async fn page_bytes(file: PathBuf) -> i64 {
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(file).read_only(true);
    let mut conn: SqliteConnection = options.connect().await.unwrap();
    sqlx::query_scalar("PRAGMA page_size").fetch_one(&mut conn).await.unwrap()
}

async fn what_a_database_of_before_holds_is_all_there_and_goes_on(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(1)).await.unwrap();
    store.put_tool(tool("T2"), Precondition::Absent, &engineer(), at(1)).await.unwrap();
    let mut advice = Vec::new();
    for n in 1..=60 {
        advice.push(stored(&*store, &run(n)).await.recommendation.id);
    }
    let changed = event(ToolEventKind::Changed, at(50 * 60));
    store.add_tool_event(&"T1".try_into().unwrap(), changed, &engineer(), at(9000)).await.unwrap();
    // A row whose advice is gone cannot be shown, and is kept all the same: whose it was, nobody knows.
    let (alone, hash) =
        if given.is_postgres() { ("'alone'", "'\\x00'::BYTEA") } else { ("CAST('alone' AS BLOB)", "x'00'") };
    let orphan = format!(
        "INSERT INTO recommendations (recommendation_id, advice_hash, issued_at_us, valid_until_us, machine_id)
         VALUES ({alone}, {hash}, 1, 2, 'unknown')"
    );
    given.raw(AssertSqlSafe(orphan)).await.unwrap();
    let (before, folded) = (shown(&*store, &advice).await, folds(given).await);
    held(&*store).await;
    store.close().await;
    let summed = sums(given).await;
    assert!(summed.iter().any(|(table, sum)| table == "recommendations" && sum.rows == 61), "{summed:?}");

    set_back(given).await;
    if !given.is_postgres() {
        // A backup of before is checked as it is, and brought up to this version afterwards.
        let folder = tempfile::tempdir().unwrap();
        let (backup, restored) = (folder.path().join("backup"), folder.path().join("restored.sqlite3"));
        back_up_sqlite(&given.file(), &backup, at(2)).await.unwrap();
        restore_to_sqlite(&backup, &restored).await.unwrap();
        let store = SqliteStore::open(&restored, SqliteOptions::default()).await.unwrap();
        assert_eq!(shown(&store, &advice).await, before);
        store.close().await;
    }
    let store = open(given).await;
    // Rows have no sums yet; a server gives them those that they have where they are written.
    assert_eq!(held(&*store).await, SumPage { unsummed: 6, ..SumPage::default() });
    let (upgraded, rows) = (sums(given).await, |sums: &[(String, TableSum)]| {
        sums.iter().find(|(table, _)| table == "recommendations").map(|(_, sum)| sum.rows)
    });
    assert_eq!(rows(&upgraded), rows(&summed), "every recommendation");
    // Whom a recommendation was for stands in its advice, where this version would have it beside it, and folds are not
    // packed.
    let others = |sums: Vec<(String, TableSum)>| -> Vec<_> {
        let otherwise = ["advices", "recommendations", STATES[0], STATES[1]];
        sums.into_iter().filter(|(table, _)| !otherwise.contains(&table.as_str())).collect()
    };
    for (is, was) in others(upgraded).iter().zip(&others(summed)) {
        assert_eq!(is, was, "every row of every other table");
    }
    assert_eq!(shown(&*store, &advice).await, before);
    assert_eq!(folds(given).await, folded);
    let faults = store.check_tables().await.unwrap();
    let keys: Vec<_> = faults.iter().map(|fault| (fault.kind, fault.key.as_str())).collect();
    assert_eq!(keys, [("recommendation", "alone")], "it had no advice before either");
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    if !given.is_postgres() {
        assert_eq!(
            page_bytes(given.file()).await,
            PAGE_BEFORE,
            "a file keeps the pages that it was made with"
        );
        let fresh = Given::sqlite().await;
        assert_eq!(page_bytes(fresh.file()).await, 4096);
        fresh.done().await;
    }

    // What a machine posts again is known, and the folds go on from where they were.
    let counted = store.verdict(&"T1".try_into().unwrap()).await.unwrap().cycles;
    for (n, new) in [(60, 0), (61, 1)] {
        let Some(Ok(Committed::Stored(answer) | Committed::Known(answer))) =
            commit(&*store, &[run(n)]).await.pop()
        else {
            panic!("cycle {n} is answered");
        };
        let rows =
            given.raw("UPDATE recommendations SET machine_id = machine_id WHERE machine_id = 'M1'").await;
        assert!(rows.unwrap() > 50, "they stand by their machine");
        assert_eq!(answer.verdict.cycles, counted + new, "{:?}", answer.verdict);
        assert!(store.recommendation(&answer.recommendation.id).await.unwrap().is_some());
    }
    store.close().await;
}

/// Until the last server of before is gone, it changes operations beside this one, and notes nothing of it.
async fn what_a_server_of_before_changed_of_an_operation_is_noted_with_the_next_change(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    let asks = |depth_mm, speed| feedwright_core::operation::Operation {
        depth_mm: Some(depth_mm),
        spindle_speed_rpm: Some(speed),
        ..operation("O1")
    };
    let put = async |version, seconds, asked| {
        store.put_operation(asked, Precondition::Version(version), &engineer(), at(seconds)).await.unwrap();
    };
    put(1, 10, asks(20.0, 2400.0)).await;
    let changed = format!(
        "UPDATE operations SET depth_mm = 5, spindle_speed_rpm = 1000, version = 3, updated_at_us = {}
         WHERE operation_id = 'O1'",
        at(20).micros()
    );
    assert_eq!(given.raw(AssertSqlSafe(changed)).await.unwrap(), 1);
    if !given.is_postgres() {
        // No server of before opens such a file: there it is somebody's who says that it is meant.
        given.raw("UPDATE operations SET row_sum = NULL, summed_version = NULL").await.unwrap();
    }
    given.raw("UPDATE registry_generation SET changes = changes + 1").await.unwrap();
    let worn = (1..=40).map(|n| super::wear::reported("T1", n, 1000.0 + 4.0 * f64::from(n), 5.1)).collect();
    super::wear::store_all(&*store, worn).await;
    let verdict = async || store.verdict(&"T1".try_into().unwrap()).await.unwrap();
    let told = verdict().await;
    assert_eq!((told.state, told.counted), (ToolState::Worn, 40));
    assert_eq!(told.baselines[0].key.spindle_speed_rpm, Some(1000.0));
    put(3, 2430, asks(20.0, 2400.0)).await;
    assert_eq!(verdict().await, told, "what was run is judged by what was asked for then");
    let noted = given
        .numbers("SELECT CAST(COALESCE(depth_mm, 0) AS BIGINT) FROM operation_asks ORDER BY from_us")
        .await;
    assert_eq!(noted[noted.len() - 3..], [20, 5, 20]);
}

async fn folds_of_other_rules_are_folded_again(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(1)).await.unwrap();
    // Beyond a checkpoint; the other machine ran the tool for a while, and never again.
    let new = |n: u32| {
        let cut_short = n % 9 == 4;
        let machine = if (20..30).contains(&n) { "M2" } else { "M1" };
        let load = if cut_short { 27.0 } else { 30.0 };
        NewCycle { cut_short, ..Run { machine, sampled: false, load, ..Run::nth(n) }.new_cycle() }
    };
    let commit = async |store: &dyn Store, numbers: std::ops::RangeInclusive<u32>| {
        let group = numbers.map(new).collect();
        for outcome in store.commit_cycles(group, at(100_000), RecommendSettings::default()).await {
            assert!(matches!(outcome, Ok(Committed::Stored(_))), "{outcome:?}");
        }
    };
    commit(&*store, 1..=300).await;
    let id = "T1".try_into().unwrap();
    let verdict = store.verdict(&id).await.unwrap();
    assert_eq!((verdict.state, verdict.counted), (ToolState::Good, 267));
    assert_eq!(verdict.excluded[Exclusion::CutShort as usize], 33);
    let good = given.wear_states().await;
    store.close().await;

    // What an earlier version of the rules made of the same cycles says something else, in another form.
    let of_before = async || {
        for (table, rows) in [("tool_wear", 2), ("tool_wear_checkpoints", 1)] {
            let nonsense = if given.is_postgres() { "'\\x0300'::BYTEA" } else { "x'0300'" };
            let sql = format!(
                "UPDATE {table} SET fold_version = {}, state = {nonsense}",
                i32::from(FOLD_VERSION) - 1
            );
            assert_eq!(given.raw(AssertSqlSafe(sql)).await.unwrap(), rows, "{table}");
        }
    };
    of_before().await;
    let store = open(given).await;
    assert_eq!(store.verdict(&id).await.unwrap(), verdict, "asked for before any cycle comes");
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, [], "and no fault");
    let repaired = store.check_wear(Repair::AllBut(&Doubt::default())).await.unwrap();
    assert_eq!(repaired.different.len(), 2, "a repair makes them at once");
    assert_eq!(given.wear_states().await, good);

    // Or one tool after the other, as a server does when it starts. One that a newer server wrote is left to it.
    of_before().await;
    let tool_after = async |after| store.next_outdated_fold(after).await.unwrap();
    assert_eq!((tool_after(None).await.as_ref(), tool_after(Some(&id)).await), (Some(&id), None));
    assert_eq!(store.renew_fold(&id, at(200_000)).await.unwrap(), Renewed::Whole);
    assert_eq!(given.wear_states().await, good);
    assert_eq!(
        (tool_after(None).await, store.renew_fold(&id, at(200_000)).await.unwrap()),
        (None, Renewed::Nothing)
    );
    let newer = format!("UPDATE tool_wear SET fold_version = {}", u32::from(FOLD_VERSION) + 1);
    assert_eq!(given.raw(AssertSqlSafe(newer)).await.unwrap(), 2);
    assert_eq!(
        (tool_after(None).await, store.renew_fold(&id, at(200_000)).await.unwrap()),
        (None, Renewed::Nothing)
    );

    // A replica of the version before writes them by its own rules while both run: the next cycle here folds them by these.
    of_before().await;
    commit(&*store, 302..=302).await;
    let rest =
        format!("UPDATE tool_wear SET fold_version = fold_version WHERE fold_version = {FOLD_VERSION}");
    assert_eq!(
        given.raw(AssertSqlSafe(rest)).await.unwrap(),
        2,
        "also of the machine that does not run it any more"
    );
    assert_eq!(given.wear_states().await[1], good[1]);
    let after = store.verdict(&id).await.unwrap();
    assert_eq!((after.counted, after.excluded), (268, verdict.excluded));
    // A late one begins at the checkpoint, which is of these rules again.
    let late = Run { seconds: 299 * 60 + 30, id: "late".to_owned(), sampled: false, ..Run::nth(303) };
    assert_eq!(stored(&*store, &late).await.verdict.counted, 269);
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);

    // A repeat makes them anew too, and nobody comes to them later: an alarm of before that nothing speaks for any more is over.
    store.close().await;
    let earlier = format!("UPDATE tool_wear SET fold_version = {}", i32::from(FOLD_VERSION) - 1);
    assert_eq!(given.raw(AssertSqlSafe(earlier)).await.unwrap(), 2);
    const WORN: &str = "INSERT INTO alarms (kind, machine_id, tool_id, message, raised_at_us) VALUES ('worn', 'M1', 'T1', 'of before', 1)";
    assert_eq!(given.raw(WORN).await.unwrap(), 1);
    let store = open(given).await;
    let again = store.commit_cycles(vec![new(302)], at(200_000), RecommendSettings::default()).await;
    assert!(matches!(again[..], [Ok(Committed::Known(_))]), "{again:?}");
    assert_eq!(store.next_outdated_fold(None).await.unwrap(), None);
    let open_ones = AlarmFilter { open: Some(true), machine: None, tool: Some("T1".try_into().unwrap()) };
    assert_eq!(store.alarms(&open_ones, Page { after: None, limit: 10 }).await.unwrap(), []);

    // A cycle that was cut short by the version before is flagged incomplete alone, and is no fault of its samples. Of a later
    // version none is.
    assert_eq!(store.check_cycles(None, 400).await.unwrap().faults, []);
    let flags =
        format!("UPDATE cycles SET flags = flags - {} WHERE cycle_id = 'c00004'", Flag::CutShort as u32);
    assert_eq!(given.raw(AssertSqlSafe(flags)).await.unwrap(), 1);
    let found = store.check_cycles(None, 400).await.unwrap().faults;
    assert_eq!(found.into_iter().map(|fault| fault.key).collect::<Vec<_>>(), ["M1/c00004"]);
    let before = "UPDATE cycles SET summary_version = 4 WHERE cycle_id = 'c00004'";
    assert_eq!(given.raw(before).await.unwrap(), 1);
    let found = store.check_cycles(None, 400).await.unwrap();
    assert_eq!(found.faults, []);
    assert!(
        found.doubt.unproven.contains(&("M1".try_into().unwrap(), id)),
        "it may be another flag that is lost"
    );
    store.close().await;
}

async fn a_database_of_a_later_version_is_told_as_one(given: &Given) {
    let later = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time)
                 SELECT 9999, 'of a later version', success, checksum, 0 FROM _sqlx_migrations
                 WHERE version = (SELECT MAX(version) FROM _sqlx_migrations)";
    assert_eq!(given.raw(later).await.unwrap(), 1);
    let refused = if given.is_postgres() {
        PostgresStore::open(&given.address(), PostgresOptions::default()).await.map(drop)
    } else {
        SqliteStore::open(given.file(), SqliteOptions::default()).await.map(drop)
    };
    let error = refused.unwrap_err();
    let told = std::error::Error::source(&error).unwrap().to_string();
    assert!(told.contains("later version") && told.contains("9999"), "{told}");
}

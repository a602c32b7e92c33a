//! Several servers on one PostgreSQL: what one stores, the others know.

use super::given::{
    Given, Run, at, commit, engineer, event, machine, new_cycle, operation, shop, stored, tool,
};
use feedwright_core::cycle::{Cycle, CycleDraft, Flag};
use feedwright_core::recommend::RecommendSettings;
use feedwright_core::tool::ToolEventKind;
use feedwright_store::{
    AlarmFilter, Committed, CycleFilter, NewCycle, Page, PostgresOptions, PostgresStore, Precondition,
    Repair, Store,
};
use sqlx::{Connection, Executor, PgConnection};
use std::sync::Arc;

async fn replica(given: &Given) -> Arc<dyn Store> {
    replica_at(&given.address()).await
}

async fn replica_at(address: &str) -> Arc<dyn Store> {
    Arc::new(PostgresStore::open(address, PostgresOptions::default()).await.expect("a replica opens"))
}

/// A line is numbered before it is committed: one that takes long stands before those that were committed meanwhile.
#[tokio::test]
async fn who_reads_the_audit_is_shown_a_line_that_was_committed_late() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let (slow, quick) = (replica(&given).await, given.store());
    let subjects = async |after| -> (Vec<String>, Option<i64>) {
        let lines = quick.audit(Page { after, limit: 9 }).await.unwrap();
        let last = lines.last().map(|line| line.id).or(after);
        (lines.into_iter().map(|line| line.subject).collect(), last)
    };
    let put = async |store: &dyn Store, id| {
        store.put_machine(machine(id), Precondition::Absent, &engineer(), at(1)).await.unwrap()
    };
    put(&*quick, "M1").await;
    let (told, last) = subjects(None).await;
    assert_eq!(told, ["machine/M1"]);

    // A new tool is judged by its cycles after its line is written, which waits for these.
    let mut held = PgConnection::connect(&given.address()).await.unwrap();
    held.execute("BEGIN; LOCK TABLE tool_wear IN ACCESS EXCLUSIVE MODE").await.unwrap();
    let registered = tokio::spawn(async move {
        slow.put_tool(tool("T1"), Precondition::Absent, &engineer(), at(2)).await.unwrap()
    });
    // Until it waits there it may not have its number.
    const WAITS: &str =
        "SELECT COUNT(*) > 0 FROM pg_locks WHERE relation = 'tool_wear'::REGCLASS AND NOT granted";
    while !sqlx::query_scalar::<_, bool>(WAITS).fetch_one(&mut held).await.unwrap() {
        tokio::task::yield_now().await;
    }
    put(&*quick, "M2").await;
    assert_eq!(subjects(last).await, (vec![], last), "a line before that of M2 is open");
    let newest = quick.newest_audit(Page { after: None, limit: 1 }).await.unwrap();
    assert_eq!(newest[0].subject, "machine/M2", "it is committed");
    held.execute("ROLLBACK").await.unwrap();
    registered.await.unwrap();
    assert_eq!(subjects(last).await.0, ["tool/T1", "machine/M2"]);
    held.close().await.unwrap();
    given.done().await;
}

/// As lines of the audit are: an alarm of a group that takes long has a lower number than those that were raised meanwhile.
#[tokio::test]
async fn who_pages_through_alarms_is_shown_one_that_was_committed_late() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let (slow, quick) = (replica(&given).await, given.store());
    shop(&*quick).await;
    let pages = async |after| -> (Vec<String>, Option<i64>) {
        let page = quick.alarm_history(&AlarmFilter::default(), Page { after, limit: 9 }).await.unwrap();
        let last = page.last().map(|alarm| alarm.id).or(after);
        (page.iter().map(|alarm| alarm.tool.as_ref().unwrap().to_string()).collect(), last)
    };
    let overload = async |store: &dyn Store, tool: &str| {
        let (machine, tool) = ("M1".try_into().unwrap(), tool.try_into().unwrap());
        store.raise_overload(&machine, &tool, "too much", at(1)).await.unwrap();
    };
    overload(&*quick, "T1").await;
    let (told, last) = pages(None).await;
    assert_eq!(told, ["T1"]);

    // What a group advises is written behind its alarms, and waits for the table.
    let mut held = PgConnection::connect(&given.address()).await.unwrap();
    held.execute("BEGIN; LOCK TABLE recommendations IN SHARE MODE").await.unwrap();
    let group =
        [(1, "T2"), (2, "T3")].map(|(n, tool)| Run { tool: tool.to_owned(), load: 450.0, ..Run::nth(n) });
    let stored = tokio::spawn(async move { commit(&*slow, &group).await });
    const WAITS: &str =
        "SELECT COUNT(*) > 0 FROM pg_locks WHERE relation = 'recommendations'::REGCLASS AND NOT granted";
    while !sqlx::query_scalar::<_, bool>(WAITS).fetch_one(&mut held).await.unwrap() {
        tokio::task::yield_now().await;
    }
    const SAY: &str =
        "SELECT COUNT(*) FROM pg_locks WHERE locktype = 'advisory' AND classid = 'alarms'::REGCLASS";
    let say: i64 = sqlx::query_scalar(SAY).fetch_one(&mut held).await.unwrap();
    assert_eq!(say, 1, "a group says once that it raises some");
    overload(&*quick, "T4").await;
    assert_eq!(pages(last).await, (vec![], last), "alarms before that of T4 are open");
    let open = AlarmFilter { open: Some(true), ..AlarmFilter::default() };
    let open = quick.alarms(&open, Page { after: last, limit: 9 }).await.unwrap();
    assert_eq!(open[0].tool.as_ref().unwrap().as_str(), "T4", "what is open is shown at once");
    held.execute("ROLLBACK").await.unwrap();
    let stored = stored.await.unwrap();
    assert!(matches!(&stored[..], [Ok(Committed::Stored(_)), Ok(Committed::Stored(_))]), "{stored:?}");
    assert_eq!(pages(last).await.0, ["T2", "T3", "T4"]);
    held.close().await.unwrap();
    given.done().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn the_same_cycles_to_three_servers_count_once() {
    three_servers_take_the_same_cycles("").await;
}

/// As a role or a database may have it for other programs: what a group has waited for it has to see.
#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn the_same_cycles_count_once_whatever_level_transactions_have_by_default() {
    for level in ["serializable", "repeatable%5C%20read"] {
        let options = format!("?options=-c%20default_transaction_isolation={level}");
        three_servers_take_the_same_cycles(&options).await;
    }
}

async fn three_servers_take_the_same_cycles(options: &str) {
    let Some(given) = Given::postgres().await else {
        return;
    };
    shop(&*given.store()).await;
    let address = format!("{}{options}", given.address());
    let replicas = [replica_at(&address).await, replica_at(&address).await, replica_at(&address).await];
    let runs: Vec<Run> = (1..=60)
        .map(|n| Run { tool: if n % 2 == 0 { "T1".to_owned() } else { "T2".to_owned() }, ..Run::nth(n) })
        .collect();
    let mut tasks = Vec::new();
    for (shift, store) in replicas.iter().cloned().enumerate() {
        // Each in another order and in groups of another size, so that they meet on the same rows.
        let mut runs = runs.clone();
        runs.rotate_left(shift * 17);
        tasks.push(tokio::spawn(async move {
            let mut new = 0;
            for group in runs.chunks(5 + shift) {
                for outcome in commit(&*store, group).await {
                    match outcome.unwrap() {
                        Committed::Stored(_) => new += 1,
                        Committed::Known(_) => {}
                        other => panic!("{other:?}"),
                    }
                }
            }
            new
        }));
    }
    // Meanwhile the night shift's tool is registered, and an operation changes: neither may miss a cycle.
    let other = Arc::clone(&replicas[1]);
    tasks.push(tokio::spawn(async move {
        other.put_tool(tool("T2"), Precondition::Absent, &engineer(), at(1)).await.unwrap();
        let wear = feedwright_core::operation::WearSettings {
            baseline_cycles: 4,
            window_cycles: 4,
            ..Default::default()
        };
        let changed = feedwright_core::operation::Operation { wear, ..operation("O1") };
        other.put_operation(changed, Precondition::Version(1), &engineer(), at(2)).await.unwrap();
        0
    }));
    let mut new = 0;
    for task in tasks {
        new += task.await.unwrap();
    }
    assert_eq!(new, 60);
    for id in ["T1", "T2"] {
        assert_eq!(replicas[2].verdict(&id.try_into().unwrap()).await.unwrap().cycles, 30, "{id}");
    }
    let check = replicas[0].check_wear(Repair::No).await.unwrap();
    assert_eq!((check.rows, check.different), (2, vec![]));
    for replica in &replicas {
        replica.close().await;
    }
    given.done().await;
}

/// Every group of cycles writes folds anew: what stood beside their rows would be left behind each time, and read through an index. Those
/// that do not fit into a page twice stand there all the same, as a row of theirs would be in another page each time.
#[tokio::test]
async fn folds_stand_in_their_rows_as_long_as_a_page_has_room_for_two() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = given.store();
    shop(&*store).await;
    let sizes = "SELECT MAX(length(state))::BIGINT FROM tool_wear
        UNION ALL SELECT pg_relation_size(reltoastrelid) FROM pg_class WHERE oid = 'tool_wear'::regclass
        UNION ALL SELECT pg_relation_size('tool_wear')";
    let (mut in_row, mut beside) = (0, 0);
    // Each law has a baseline of its own, so that the fold becomes longer.
    for n in 1..=240 {
        let run = Run { load: 30.0 + f64::from(n % 7) * 1.37, ..Run::nth(n) };
        let law_version = Some(format!("law-{}", n / 6));
        let cycle = new_cycle(Cycle::new(CycleDraft { law_version, ..run.draft() }).unwrap());
        let answers = store.commit_cycles(vec![cycle], at(100_000), RecommendSettings::default()).await;
        assert!(matches!(answers.as_slice(), [Ok(Committed::Stored(_))]), "{answers:?}");
        let [length, pieces, rows] = given.numbers(sizes).await[..] else { panic!("three sizes") };
        // 240 rows would take that many pages; whoever reads meanwhile keeps some from being written over.
        assert!(rows <= 48 * 8192, "a fold of {length} bytes, and {rows} bytes of rows");
        match length {
            2_100..3_800 => {
                assert_eq!(pieces, 0, "a fold of {length} bytes");
                in_row += 1;
            }
            4_100.. => {
                assert!(pieces > 0, "a fold of {length} bytes");
                beside += 1;
            }
            _ => {}
        }
    }
    assert!(in_row > 10 && beside > 10, "{in_row} and {beside}");
    given.done().await;
}

#[tokio::test]
async fn partitions_are_made_ahead_and_used() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = PostgresStore::open(&given.address(), PostgresOptions::default()).await.unwrap();
    assert_eq!(store.make_partitions(at(0), 3).await.unwrap(), 3);
    assert_eq!(store.make_partitions(at(0), 3).await.unwrap(), 0);
    shop(&store).await;
    stored(&store, &Run::nth(1)).await;
    stored(&store, &Run { seconds: 200 * 86_400, ..Run::nth(2) }).await;
    let moved = given.raw("UPDATE cycle_samples_202601 SET block = block").await.unwrap();
    assert_eq!(moved, 1, "January's cycle is in January's partition");
    assert_eq!(given.raw("UPDATE cycle_samples_default SET block = block").await.unwrap(), 1);
    // What is compressed already is not compressed again: in the table, in its partitions, and in those to come.
    let mut tables = PgConnection::connect(&given.address()).await.unwrap();
    let storage: Vec<(String, i8)> = sqlx::query_as(
        "SELECT c.relname::TEXT, a.attstorage FROM pg_attribute a JOIN pg_class c ON c.oid = a.attrelid
         WHERE a.attname = 'block' AND c.relname LIKE 'cycle_samples%' AND c.relkind IN ('r', 'p')
         ORDER BY c.relname",
    )
    .fetch_all(&mut tables)
    .await
    .unwrap();
    tables.close().await.unwrap();
    let external: Vec<&str> = storage.iter().map(|(name, _)| name.as_str()).collect();
    let expected = [
        "cycle_samples",
        "cycle_samples_202601",
        "cycle_samples_202602",
        "cycle_samples_202603",
        "cycle_samples_default",
    ];
    assert_eq!(external, expected);
    assert!(storage.iter().all(|(_, storage)| *storage == b'e'.cast_signed()), "{storage:?}");
    // Dropping a partition is how retention works: the cycle stays, its samples are gone.
    given.raw("DROP TABLE cycle_samples_202601").await.unwrap();
    let page = Page { after: None, limit: 9 };
    let cycles = store.cycles(&CycleFilter::default(), page).await.unwrap();
    assert_eq!(cycles.iter().map(|cycle| cycle.has_samples).collect::<Vec<_>>(), [false, true]);
    let first = &cycles[0].cycle;
    assert_eq!(store.cycle_samples(&first.machine, &first.id).await.unwrap(), None);
    store.close().await;
    given.done().await;
}

#[tokio::test]
async fn a_read_only_server_is_refused() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let address = format!("{}?options=-c%20default_transaction_read_only=on", given.address());
    let refused = PostgresStore::open(&address, PostgresOptions::default()).await;
    assert!(matches!(refused, Err(feedwright_store::StoreError::NotWritable(_))), "{:?}", refused.err());
    given.done().await;
}

#[tokio::test]
async fn a_database_that_cannot_hold_every_name_is_refused_and_left_as_it_is() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let mut admin = PgConnection::connect(&given.address()).await.unwrap();
    let name = format!("latin_{}", std::process::id());
    let make = format!("CREATE DATABASE {name} ENCODING LATIN1 LOCALE 'C' TEMPLATE template0");
    admin.execute(sqlx::AssertSqlSafe(make)).await.unwrap();
    let address = given.address();
    let (server, _) = address.rsplit_once('/').unwrap();
    let address = format!("{server}/{name}");
    let refused = PostgresStore::open(&address, PostgresOptions::default()).await.err().unwrap();
    assert!(format!("{refused:?}").contains("needs a database in UTF8"), "{refused:?}");
    let mut there = PgConnection::connect(&address).await.unwrap();
    let tables: i64 = sqlx::query_scalar("SELECT count(*) FROM pg_tables WHERE schemaname = 'public'")
        .fetch_one(&mut there)
        .await
        .unwrap();
    assert_eq!(tables, 0);
    there.close().await.unwrap();
    admin.execute(sqlx::AssertSqlSafe(format!("DROP DATABASE {name}"))).await.unwrap();
    admin.close().await.unwrap();
    given.done().await;
}

#[tokio::test]
async fn a_schema_that_comes_first_later_is_no_empty_database() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    given.raw("CREATE SCHEMA AUTHORIZATION CURRENT_USER").await.unwrap();
    let refused = PostgresStore::open(&given.address(), PostgresOptions::default()).await.err().unwrap();
    assert!(format!("{refused:?}").contains("the tables are in the schema public"), "{refused:?}");
    let tables = "SELECT 1 FROM pg_tables WHERE schemaname = CURRENT_USER";
    assert_eq!(given.raw(tables).await.unwrap(), 0, "nothing was made there");
    // Whoever says which one is meant is served.
    let address = format!("{}?options[search_path]=public", given.address());
    PostgresStore::open(&address, PostgresOptions::default()).await.unwrap().close().await;
    given.done().await;
}

/// Two plants in one database, a trial beside production say.
#[tokio::test]
async fn plants_in_schemas_of_their_own_do_not_hear_each_other() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let address = |schema: &str| format!("{}?options[search_path]={schema}", given.address());
    let mut plants = Vec::new();
    for create in ["CREATE SCHEMA trial", "CREATE SCHEMA spare"] {
        given.raw(create).await.unwrap();
        let schema = create.trim_start_matches("CREATE SCHEMA ");
        plants.push(PostgresStore::open(&address(schema), PostgresOptions::default()).await.unwrap());
    }
    let (here, trial, spare) = (given.store(), &plants[0], &plants[1]);
    let mut hears = Vec::new();
    for store in [&*here, trial as &dyn Store, spare] {
        hears.push(store.notices().unwrap().listen().await.unwrap());
    }
    // The last one is told first: what the others are told would come before their own.
    for (store, told) in [(spare as &dyn Store, "spare"), (trial, "trial"), (&*here, "here")] {
        store.notify(told).await.unwrap();
    }
    for (listener, told) in hears.iter_mut().zip(["here", "trial", "spare"]) {
        assert_eq!(listener.next().await.unwrap(), told);
    }
    // Cycles by the tables of one, migrations and backups by those of the other.
    let direct = Some(address("spare"));
    let options = PostgresOptions { direct, ..PostgresOptions::default() };
    let refused = PostgresStore::open(&address("trial"), options).await.err().unwrap();
    assert!(format!("{refused:?}").contains("or other tables of it"), "{refused:?}");
    drop(hears);
    for plant in plants {
        plant.close().await;
    }
    given.removed().await;
}

/// Partitions have the same names in every schema.
#[tokio::test]
async fn a_plant_makes_its_own_partitions_where_another_one_is_in_its_search_path() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    given.raw("CREATE SCHEMA trial").await.unwrap();
    let open = async |path: &str| {
        let address = format!("{}?options[search_path]={path}", given.address());
        PostgresStore::open(&address, PostgresOptions::default()).await.unwrap()
    };
    open("trial").await.close().await;
    let public = open("public").await;
    assert_eq!(public.make_partitions(at(0), 3).await.unwrap(), 3);
    let trial = open("trial,public").await;
    assert_eq!(trial.make_partitions(at(0), 3).await.unwrap(), 3);
    assert_eq!(trial.make_partitions(at(0), 3).await.unwrap(), 0);
    let made = "SELECT COUNT(*) FROM pg_inherits WHERE inhparent = 'trial.cycle_samples'::REGCLASS
        AND inhrelid = 'trial.cycle_samples_202602'::REGCLASS";
    assert_eq!(given.numbers(made).await, [1]);
    // One that was moved elsewhere is still this table's.
    given.raw("CREATE SCHEMA slow").await.unwrap();
    given.raw("ALTER TABLE trial.cycle_samples_202602 SET SCHEMA slow").await.unwrap();
    assert_eq!(trial.make_partitions(at(0), 3).await.unwrap(), 0);
    // Nor is a copy that broke off there one into these tables.
    given.raw("CREATE TABLE unfinished_transfer ()").await.unwrap();
    open("trial,public").await.close().await;
    for plant in [public, trial] {
        plant.close().await;
    }
    given.removed().await;
}

/// No fold changes by an event after the last cycle: what this server remembers of the tool has to be forgotten all the same.
#[tokio::test]
async fn an_event_that_one_server_revokes_holds_no_more_at_another() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let (store, other) = (given.store(), replica(&given).await);
    shop(&*store).await;
    let id = "T1".try_into().unwrap();
    stored(&*store, &Run::nth(1)).await;
    let ahead = event(ToolEventKind::Changed, at(40 * 86_400));
    let told = other.add_tool_event(&id, ahead, &engineer(), at(100)).await.unwrap().unwrap();
    assert_eq!(stored(&*store, &Run::nth(2)).await.verdict.cycles, 0);
    other.revoke_tool_event(&id, told.id, &engineer(), at(200)).await.unwrap().unwrap();
    let answer = stored(&*store, &Run::nth(3)).await;
    assert_eq!((answer.verdict.life, answer.verdict.cycles), (1, 3));
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, vec![]);
    other.close().await;
    given.done().await;
}

#[tokio::test]
async fn a_change_at_one_server_is_in_force_at_the_next_commit_of_another() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let (store, other) = (given.store(), replica(&given).await);
    shop(&*store).await;
    // The first cycles fill this server's memory: machine, operation, tool and fold.
    let before = stored(&*store, &Run::nth(1)).await;
    stored(&*store, &Run::nth(2)).await;
    let weaker = feedwright_core::machine::Machine {
        spindle: feedwright_core::machine::SpindleRating {
            rated_power_watts: Some(5_000.0),
            ..machine("M1").spindle
        },
        ..machine("M1")
    };
    other.put_machine(weaker, Precondition::Version(1), &engineer(), at(300)).await.unwrap();
    other.put_tool(tool("T2"), Precondition::Absent, &engineer(), at(300)).await.unwrap();
    let event = event(ToolEventKind::MountedNew, at(150));
    other.add_tool_event(&"T1".try_into().unwrap(), event, &engineer(), at(300)).await.unwrap().unwrap();

    let (_, generation) = store
        .recent_surroundings(
            &"M1".try_into().unwrap(),
            &"O1".try_into().unwrap(),
            &"T1".try_into().unwrap(),
            at(0),
        )
        .await
        .unwrap()
        .unwrap();
    // As a server hands it over: samples are in its blocks only.
    let late = Run::nth(3).new_cycle();
    let cycle = Arc::new(Cycle::clone(&late.cycle).with_samples(None));
    let late = NewCycle { generation: Some(generation), cycle, ..late };
    let new_tool = Run { tool: "T2".to_owned(), ..Run::nth(4) };
    let unregistered = NewCycle { generation: Some(generation), ..new_tool.new_cycle() };
    let answers = store.commit_cycles(vec![late, unregistered], at(400), RecommendSettings::default()).await;
    let answers: Vec<_> = answers
        .into_iter()
        .map(|answer| match answer.unwrap() {
            Committed::Stored(answer) => answer,
            other => panic!("{other:?}"),
        })
        .collect();
    let joules = |answer: &feedwright_store::CycleAnswer| answer.summary.best_energy().unwrap().total_joules;
    assert!((joules(&answers[0]) * 2.0 - joules(&before)).abs() < 1e-9, "half the rating, half the energy");
    assert_eq!((answers[0].verdict.life, answers[0].verdict.cycles), (2, 1), "mounted before it");
    assert!(
        answers[1].registered && answers[1].summary.flags.iter().all(|flag| flag != Flag::ToolUnregistered)
    );

    // The fold itself: what another server counted is not counted over.
    assert_eq!(stored(&*other, &Run::nth(5)).await.verdict.cycles, 2);
    assert_eq!(stored(&*store, &Run::nth(6)).await.verdict.cycles, 3);
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, vec![]);
    other.close().await;
    given.done().await;
}

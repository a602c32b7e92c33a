//! What a check finds of summaries, and that wear is never folded over what it doubts.

use super::given::{
    Given, Run, at, commit, differing, engineer, event, machine, new_cycle, operation, settle, shop, stories,
};
use feedwright_core::cycle::{Channel, Cycle, CycleDraft, Flag, Samples, TimeBase};
use feedwright_core::machine::{Calibration, FittedLine};
use feedwright_core::operation::Operation;
use feedwright_core::recommend::RecommendSettings;
use feedwright_core::tool::ToolEventKind;
use feedwright_core::units::Process;
use feedwright_core::wear::Exclusion;
use feedwright_store::transfer::{Address, back_up_sqlite, copy};
use feedwright_store::{
    Actor, CheckPage, Committed, CycleFilter, Doubt, Left, NewCycle, Page, Precondition, QuarantineBounds,
    QuarantineEntry, Repair, Role, SessionRecord, Store, StoreError, StoreFault, TokenRecord,
};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, Executor, PgConnection, SqliteConnection};
use std::collections::BTreeSet;

stories!(with tables:
    a_summary_that_is_not_its_cycles_is_named_with_its_columns,
    a_mean_that_rounding_took_out_of_its_samples_is_sound,
    a_number_that_is_not_finite_is_named_like_any_other,
    what_changed_since_is_no_fault_and_what_rests_on_samples_is_held_all_the_same,
    whatever_clock_registered_an_operation_its_cycles_are_sound,
    wear_is_not_folded_over_doubtful_cycles,
    a_cache_is_kept_that_alone_knows_of_a_cycle,
    wear_is_not_folded_over_cycles_that_nothing_vouches_for,
    whatever_wear_reads_of_a_cycle_is_held_against_what_was_taken_in,
    a_flag_that_says_what_was_cut_off_is_not_taken_for_truth,
    a_fold_that_is_made_anew_is_not_taken_for_the_one_remembered,
    a_course_that_cannot_be_read_is_named_and_the_rest_is_checked,
    a_course_that_cannot_be_read_costs_its_cycle_alone,
    what_is_stored_beside_cycles_is_held_too,
);

/// Eight cycles of two tools, one every ten minutes, the last without samples.
async fn eight(store: &dyn Store) {
    shop(store).await;
    store.put_tool(super::given::tool("T2"), Precondition::Unstated, &engineer(), at(0)).await.unwrap();
    let runs: Vec<Run> = (1..=8)
        .map(|n| Run {
            tool: if n % 2 == 0 { "T2" } else { "T1" }.to_owned(),
            seconds: i64::from(n) * 600,
            sampled: n < 8,
            ..Run::nth(n)
        })
        .collect();
    for outcome in commit(store, &runs).await {
        outcome.unwrap();
    }
}

/// What a server would find damaged when it is asked for, and what is left of a cycle that is gone.
async fn what_is_stored_beside_cycles_is_held_too(given: &Given) {
    let store = given.store();
    eight(&*store).await;
    super::feed_profiles::activated(&*store, 300.0).await;
    let overrides = feedwright_store::CycleOverrides {
        machine: "M1".try_into().unwrap(),
        // Before its cycle, which goes to quarantine: no fault.
        cycle: "refused".try_into().unwrap(),
        mode: "advise".to_owned(),
        law_version: "1".to_owned(),
        program_hash: None,
        stored_at: at(0),
        block: feedwright_store::codec::encode_overrides(&[(100.0, 1)]).unwrap(),
    };
    store.put_overrides(&overrides, feedwright_store::Sent::AsItRan).await.unwrap();
    assert_eq!(store.check_tables().await.unwrap(), []);
    let cut = if given.is_postgres() { "'\\x01'" } else { "x'01'" };
    for (damage, kind, misleads) in [
        ("DELETE FROM tools WHERE tool_id = 'T1'".to_owned(), "row", true),
        (format!("UPDATE cycle_overrides SET block = {cut}"), "overrides", false),
        (
            "UPDATE feed_profile_versions SET content = replace(content, '300', '301')".to_owned(),
            "feed profile",
            false,
        ),
        (
            "UPDATE advices SET body = replace(body, '\"override_percent\":100', '\"override_percent\":500')
             WHERE advice_hash = (SELECT advice_hash FROM advices ORDER BY 1 LIMIT 1)"
                .to_owned(),
            "advice",
            false,
        ),
        (
            format!(
                "UPDATE advices SET body = {} WHERE advice_hash = (SELECT advice_hash FROM advices ORDER BY 1 LIMIT 1)",
                // No text at all, where the engine bears it.
                if given.is_postgres() { "substr(body, 1, 20)" } else { "CAST(x'7b80' AS TEXT)" }
            ),
            "advice",
            false,
        ),
        (
            "INSERT INTO cycle_cuts (machine_id, cycle_id, feed_mm_rev) VALUES ('M1', 'gone', 0.1)"
                .to_owned(),
            "cut",
            true,
        ),
    ] {
        assert_eq!(given.raw(AssertSqlSafe(damage.clone())).await.unwrap(), 1, "{damage}");
        let faults = store.check_tables().await.unwrap();
        let of_kind: Vec<_> = faults.iter().filter(|fault| fault.kind == kind).collect();
        assert_eq!(of_kind.len(), 1, "{damage}: {faults:?}");
        assert_eq!(of_kind[0].may_mislead_wear(), misleads, "{damage}");
    }
}

async fn checked(store: &dyn Store) -> CheckPage {
    store.check_cycles(None, 100).await.unwrap()
}

fn told(page: &CheckPage) -> Vec<(&str, &str, &str)> {
    let faults = page.faults.iter();
    faults.map(|fault| (fault.kind, fault.key.as_str(), fault.detail.as_str())).collect()
}

async fn a_summary_that_is_not_its_cycles_is_named_with_its_columns(given: &Given) {
    let store = given.store();
    eight(&*store).await;
    let clean = checked(&*store).await;
    assert_eq!((clean.checked, clean.unverified, told(&clean)), (8, 0, vec![]));
    let good = ["c00001", "c00008"].map(|id| id.try_into().unwrap());
    for id in &good {
        assert!(
            !store.cycle(&"M1".try_into().unwrap(), id).await.unwrap().unwrap().summary.energy.is_empty()
        );
    }
    let changes: &[(&'static str, &[&str])] = &[
        ("rated_power_joules = rated_power_joules * 1.0001", &["rated_power_joules"]),
        ("operator_override_percent = 100, quantities = quantities + 1", &["operator_override_percent"]),
        ("mean_spindle_load_percent = mean_spindle_load_percent + 0.001", &["mean_spindle_load_percent"]),
        ("max_spindle_load_depth_mm = 0.75", &["max_spindle_load_depth_mm"]),
        ("max_depth_mm = max_depth_mm + 1", &["max_depth_mm"]),
        // A value that was chosen, not added up: to the last bit.
        ("max_depth_mm = max_depth_mm * 1.00000000001", &["max_depth_mm"]),
        ("duration_ms = duration_ms + 1", &["duration_ms"]),
        ("coverage = 0.96", &["coverage"]),
        ("flags = flags + 1", &["flags"]),
        ("flags = flags + 8192", &["flags"]),
        ("flags = flags + 16384", &["flags"]),
        ("energy_scale = energy_scale + 1", &["energy_scale"]),
        ("depth_digest = NULL", &["depth_digest"]),
        (
            "depth_digest = (SELECT o.depth_digest FROM cycles o WHERE o.cycle_id = 'other')",
            &["depth_digest"],
        ),
    ];
    // A cycle of another load, for a course that can be read and is another's.
    commit(&*store, &[Run { id: "other".to_owned(), load: 40.0, seconds: 6000, ..Run::nth(20) }]).await;
    for (change, columns) in changes {
        // What is stored is put back by what it was.
        for statement in [
            "CREATE TABLE kept AS SELECT * FROM cycles WHERE cycle_id = 'c00003'".to_owned(),
            given.change(&format!("{change} WHERE cycle_id = 'c00003'")),
        ] {
            given.raw(AssertSqlSafe(statement)).await.unwrap();
        }
        let found = checked(&*store).await;
        let [(kind, key, detail)] = told(&found)[..] else { panic!("{change}: {:?}", found.faults) };
        assert_eq!((kind, key), ("summary", "M1/c00003"), "{change}");
        for column in *columns {
            assert!(detail.contains(column), "{change}: {detail}");
        }
        assert_eq!(found.doubt.tools, BTreeSet::from(["T1".try_into().unwrap()]), "{change}");
        let columns = [
            "rated_power_joules",
            "operator_override_percent",
            "quantities",
            "mean_spindle_load_percent",
            "max_spindle_load_depth_mm",
            "max_depth_mm",
            "duration_ms",
            "coverage",
            "flags",
            "energy_scale",
            "depth_digest",
        ];
        let columns = columns.map(|column| given.kept_in(column)).join(", ");
        for statement in [
            format!("UPDATE cycles SET ({columns}) = (SELECT {columns} FROM kept) WHERE cycle_id = 'c00003'"),
            "DROP TABLE kept".to_owned(),
        ] {
            given.raw(AssertSqlSafe(statement)).await.unwrap();
        }
        assert_eq!(told(&checked(&*store).await), [], "{change}");
    }
    // Without samples there is what the control reported.
    given.raw("UPDATE cycles SET duration_ms = 1 WHERE cycle_id = 'c00008'").await.unwrap();
    let found = checked(&*store).await;
    let [("summary", "M1/c00008", detail)] = told(&found)[..] else { panic!("{:?}", found.faults) };
    assert!(detail.contains("duration_ms is 1 instead of 2000"), "{detail}");
}

/// As an earlier version stored it, which held no mean within its samples.
async fn a_mean_that_rounding_took_out_of_its_samples_is_sound(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    let draft = Run::nth(1).draft();
    let time_ms = vec![12.3, 20.3, 32.6, 40.37, 50.37];
    let columns =
        vec![(Channel::OverridePercent, vec![200.0; 5]), (Channel::SpindleLoadPercent, vec![0.1; 5])];
    let samples = Samples::new(TimeBase::Stamps { time_ms }, columns, 100).unwrap();
    let mut cycle = new_cycle(Cycle::new(CycleDraft { samples: Some(samples), ..draft }).unwrap());
    let means = [&mut cycle.summary.mean_override_percent, &mut cycle.summary.mean_spindle_load_percent];
    for (mean, value) in means.into_iter().zip([200.0_f64, 0.1]) {
        assert_eq!(*mean, Some(value));
        *mean = Some(value.next_up());
    }
    for outcome in store.commit_cycles(vec![cycle], at(100_000), RecommendSettings::default()).await {
        outcome.unwrap();
    }
    let clean = checked(&*store).await;
    assert_eq!((clean.checked, clean.unverified, told(&clean)), (1, 0, vec![]));
}

async fn a_number_that_is_not_finite_is_named_like_any_other(given: &Given) {
    let store = given.store();
    eight(&*store).await;
    // Whoever gets such a number past the tables: their constraints do not let it in.
    let (without, numbers): (&[&'static str], &[&str]) = if given.is_postgres() {
        let dropped = &[
            "ALTER TABLE cycles DROP CONSTRAINT cycles_joules_range",
            "ALTER TABLE cycles DROP CONSTRAINT cycles_percents_range",
            "ALTER TABLE cycles DROP CONSTRAINT cycles_coverage_range",
        ];
        (dropped, &["'Infinity'", "'-Infinity'", "'NaN'"])
    } else {
        (&[], &["9e999", "-9e999"])
    };
    for statement in without {
        given.raw(*statement).await.unwrap();
    }
    for column in ["rated_power_joules", "mean_spindle_load_percent", "coverage"] {
        let kept_in = given.kept_in(column);
        given
            .raw(AssertSqlSafe(format!(
                "CREATE TABLE kept AS SELECT {kept_in} AS was FROM cycles WHERE cycle_id = 'c00003'"
            )))
            .await
            .unwrap();
        for number in numbers {
            let unchecked = if given.is_postgres() { "" } else { "PRAGMA ignore_check_constraints = ON; " };
            let change =
                format!("{unchecked}UPDATE cycles SET {kept_in} = {number} WHERE cycle_id = 'c00003'");
            given.raw(AssertSqlSafe(change)).await.unwrap();
            let found = checked(&*store).await;
            let [("summary", "M1/c00003", detail)] = told(&found)[..] else {
                panic!("{column} {number}: {:?}", found.faults)
            };
            assert!(detail.contains(column), "{number}: {detail}");
            assert_eq!(found.doubt.tools, BTreeSet::from(["T1".try_into().unwrap()]), "{column} {number}");
        }
        let back = format!("UPDATE cycles SET {kept_in} = (SELECT was FROM kept) WHERE cycle_id = 'c00003'");
        given.raw(AssertSqlSafe(back)).await.unwrap();
        given.raw("DROP TABLE kept").await.unwrap();
        assert_eq!(told(&checked(&*store).await), [], "{column}");
    }
}

/// SQLite itself tells them, and tells them only who may write.
#[tokio::test]
async fn rows_that_a_table_would_refuse_are_named() {
    let given = Given::sqlite().await;
    let store = given.store();
    eight(&*store).await;
    assert_eq!(store.check_tables().await.unwrap(), []);
    let changes: [(&'static str, &'static str, &str); 5] = [
        (
            "UPDATE operations SET version = -5 WHERE operation_id = 'O1'",
            "UPDATE operations SET version = 1 WHERE operation_id = 'O1'",
            "operations",
        ),
        (
            "UPDATE tools SET version = -5 WHERE tool_id = 'T1'",
            "UPDATE tools SET version = 1 WHERE tool_id = 'T1'",
            "tools",
        ),
        (
            "UPDATE cycles SET quantities = quantities + 1 WHERE cycle_id = 'c00003'",
            "UPDATE cycles SET quantities = quantities - 1 WHERE cycle_id = 'c00003'",
            "cycles",
        ),
        (
            "UPDATE cycles SET profile_id = 'x' WHERE cycle_id = 'c00003'",
            "UPDATE cycles SET profile_id = NULL WHERE cycle_id = 'c00003'",
            "cycles",
        ),
        ("UPDATE tool_wear SET version = -version", "UPDATE tool_wear SET version = -version", "tool_wear"),
    ];
    for (change, back, table) in changes {
        let unchecked = format!("PRAGMA ignore_check_constraints = ON; {change}");
        given.raw(AssertSqlSafe(unchecked)).await.unwrap();
        let found = store.check_tables().await.unwrap();
        let told: BTreeSet<_> = found.iter().map(|fault| (fault.kind, fault.key.as_str())).collect();
        let mut expected = BTreeSet::from([("table", table)]);
        // These have a sum besides.
        expected.extend(match table {
            "operations" => Some(("row", "operations O1")),
            "tools" => Some(("row", "tools T1")),
            _ => None,
        });
        assert_eq!(told, expected, "{change}");
        let misleads = table != "tool_wear";
        assert!(found.iter().all(|fault| fault.may_mislead_wear() == misleads), "{change}");
        given.raw(back).await.unwrap();
        assert_eq!(store.check_tables().await.unwrap(), [], "{change}");
    }
    given.done().await;
}

/// As a restore that went on over errors leaves it, or a move that brought no sequences along.
#[tokio::test]
async fn what_the_tables_of_a_plant_lack_is_named() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = given.store();
    eight(&*store).await;
    let who = engineer();
    let worn = event(ToolEventKind::MountedNew, at(0));
    store.add_tool_event(&"T1".try_into().unwrap(), worn, &who, at(1)).await.unwrap();
    assert_eq!(store.check_tables().await.unwrap(), []);
    let listed = include_str!("../../../service/store/src/postgres/dialect/made.txt");
    let made = given
        .numbers(
            "SELECT COUNT(*) FROM (
                 SELECT c.relname, k.conname FROM pg_constraint k JOIN pg_class c ON c.oid = k.conrelid
                 WHERE c.relnamespace = current_schema()::REGNAMESPACE AND NOT c.relispartition
                     AND k.contype IN ('c', 'p', 'u') AND c.relname <> '_sqlx_migrations'
                 UNION SELECT c.relname, i.relname FROM pg_index x JOIN pg_class i ON i.oid = x.indexrelid
                     JOIN pg_class c ON c.oid = x.indrelid
                 WHERE c.relnamespace = current_schema()::REGNAMESPACE AND NOT c.relispartition
                     AND c.relname <> '_sqlx_migrations') AS made",
        )
        .await;
    assert_eq!(
        made,
        [i64::try_from(listed.lines().count()).unwrap()],
        "a migration makes more than is listed"
    );
    let lacks: [(&'static str, (&str, &str), bool); 6] = [
        ("ALTER TABLE cycles DROP CONSTRAINT cycles_pkey", ("schema", "cycles cycles_pkey"), true),
        ("DROP INDEX alarms_open", ("constraint", "alarms alarms_open"), false),
        (
            "ALTER TABLE cycles DROP CONSTRAINT cycles_joules_range",
            ("constraint", "cycles cycles_joules_range"),
            false,
        ),
        ("DROP INDEX cycles_by_tool", ("constraint", "cycles cycles_by_tool"), false),
        ("DELETE FROM registry_generation WHERE registry_id = 3", ("schema", "registry_generation"), true),
        (
            "ALTER TABLE tool_events ALTER COLUMN event_id RESTART WITH 1",
            ("sequence", "tool_events event_id"),
            false,
        ),
    ];
    let mut told = Vec::new();
    for (change, fault, misleads) in lacks {
        given.raw(change).await.unwrap();
        told.push(fault);
        told.sort_unstable();
        let found = store.check_tables().await.unwrap();
        let mut named: Vec<_> = found.iter().map(|fault| (fault.kind, fault.key.as_str())).collect();
        named.sort_unstable();
        assert_eq!(named, told, "{change}");
        let last = found.iter().find(|found| (found.kind, found.key.as_str()) == fault).unwrap();
        assert_eq!(last.may_mislead_wear(), misleads, "{change}");
    }
    // Whoever tells an event is not told that it is wrong.
    let again = store
        .add_tool_event(
            &"T1".try_into().unwrap(),
            event(ToolEventKind::ConditionsConfirmed, at(900)),
            &who,
            at(901),
        )
        .await;
    assert!(matches!(again, Err(StoreError::Database(_))), "{again:?}");
    given.done().await;
}

/// What SQLite leaves out of a list that is full may be a fault of the file.
#[tokio::test]
async fn a_list_of_faults_that_is_full_says_so() {
    let given = Given::sqlite().await;
    let store = given.store();
    let runs: Vec<Run> = (1..=120).map(|n| Run { sampled: false, ..Run::nth(n) }).collect();
    shop(&*store).await;
    commit(&*store, &runs).await;
    let refused = "PRAGMA ignore_check_constraints = ON; UPDATE cycles SET profile_id = 'x'";
    given.raw(refused).await.unwrap();
    let found = store.check_tables().await.unwrap();
    let told: BTreeSet<_> = found.iter().map(|fault| (fault.kind, fault.key.as_str())).collect();
    assert_eq!(told, BTreeSet::from([("table", "cycles"), ("file", "sqlite")]));
    let last = found.last().unwrap();
    assert!(last.detail.contains("there may be more") && last.may_mislead_wear(), "{found:?}");
    given.done().await;
}

async fn what_changed_since_is_no_fault_and_what_rests_on_samples_is_held_all_the_same(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    // As a server does: what is stored rests on what is in force.
    let run = async |n: u32, seconds: i64| {
        let cycle = NewCycle { generation: Some(-1), ..Run { seconds, ..Run::nth(n) }.new_cycle() };
        let outcome = store.commit_cycles(vec![cycle], at(seconds), RecommendSettings::default()).await.pop();
        assert!(matches!(outcome, Some(Ok(Committed::Stored(_)))), "{outcome:?}");
    };
    let found = async || {
        let found = checked(&*store).await;
        assert_eq!(told(&found), []);
        found.unverified
    };
    let who = engineer();
    run(1, 600).await;
    assert_eq!(found().await, 0);
    let mut stronger = machine("M1");
    stronger.spindle.rated_power_watts = stronger.spindle.rated_power_watts.map(|watts| 2.0 * watts);
    store.put_machine(stronger, Precondition::Version(1), &who, at(2000)).await.unwrap();
    run(2, 2030).await;
    run(3, 2600).await;
    assert_eq!(found().await, 2, "the first two may rest on the ratings before");
    let other = Operation { process: Process::Plunge, spindle_speed_rpm: Some(900.0), ..operation("O1") };
    store.put_operation(other, Precondition::Version(1), &who, at(4000)).await.unwrap();
    run(4, 4600).await;
    assert_eq!(found().await, 3, "the third knew another operation");
    let line = FittedLine {
        slope: 0.4,
        intercept: 0.0,
        min_percent: 0.0,
        max_percent: 100.0,
        r_squared: 0.99,
        residual_spread: 1.0,
    };
    let fitted = Calibration { version: 0, thrust: None, torque: Some(line) };
    store.add_calibration(&"M1".try_into().unwrap(), fitted, &who, at(6000)).await.unwrap().unwrap();
    run(5, 6030).await;
    run(6, 6600).await;
    assert_eq!(found().await, 4, "at the fifth the lines may have been there or not; the fourth had none");
    // An operation that was registered when its cycles had come; then changed.
    let mut late = Run { operation: "O2", seconds: 7000, ..Run::nth(7) }.new_cycle();
    late.generation = Some(-1);
    store.commit_cycles(vec![late], at(7000), RecommendSettings::default()).await.pop().unwrap().unwrap();
    store.put_operation(operation("O2"), Precondition::Absent, &who, at(8000)).await.unwrap();
    assert_eq!(found().await, 4);
    let slower = Operation { depth_mm: Some(40.0), ..operation("O2") };
    store.put_operation(slower, Precondition::Version(1), &who, at(9000)).await.unwrap();
    assert_eq!(found().await, 4);

    for (change, faults) in [
        ("mean_spindle_load_percent = 31 WHERE cycle_id = 'c00001'", &["M1/c00001"][..]),
        ("flags = flags + 1 WHERE cycle_id = 'c00003'", &["M1/c00001", "M1/c00003"]),
        ("rated_power_joules = 1.0 WHERE cycle_id = 'c00002'", &["M1/c00001", "M1/c00003"]),
        ("rated_power_joules = 1.0 WHERE cycle_id = 'c00006'", &["M1/c00001", "M1/c00003", "M1/c00006"]),
    ] {
        given.raw(AssertSqlSafe(given.change(change))).await.unwrap();
        let found = checked(&*store).await;
        let keys: Vec<_> = told(&found).into_iter().map(|(_, key, _)| key).collect();
        assert_eq!(keys, faults, "{change}");
    }
}

async fn whatever_clock_registered_an_operation_its_cycles_are_sound(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    let run = async |n: u32, operation: &'static str, seconds: i64| {
        let run = Run { operation, seconds, ..Run::nth(n) };
        let cycle = NewCycle { generation: Some(-1), ..run.new_cycle() };
        let outcome = store.commit_cycles(vec![cycle], at(seconds), RecommendSettings::default()).await.pop();
        assert!(matches!(outcome, Some(Ok(Committed::Stored(_)))), "{outcome:?}");
    };
    // By a clock that was a day ahead, and was put right before the cycle came.
    store.put_operation(operation("O2"), Precondition::Absent, &engineer(), at(90_000)).await.unwrap();
    run(1, "O2", 1000).await;
    // By one that was behind, after the cycle had come.
    run(2, "O3", 2000).await;
    store.put_operation(operation("O3"), Precondition::Absent, &engineer(), at(500)).await.unwrap();
    let found = checked(&*store).await;
    assert_eq!((told(&found), found.unverified), (vec![], 0));
    for (cycle, change) in [("c00001", "- 1"), ("c00002", "+ 1")] {
        let change =
            given.change(&format!("max_depth_mm = max_depth_mm {change} WHERE cycle_id = '{cycle}'"));
        given.raw(AssertSqlSafe(change)).await.unwrap();
    }
    let found = checked(&*store).await;
    assert_eq!(
        told(&found).into_iter().map(|(_, key, _)| key).collect::<Vec<_>>(),
        ["M1/c00001", "M1/c00002"]
    );
}

async fn wear_is_not_folded_over_doubtful_cycles(given: &Given) {
    let store = given.store();
    eight(&*store).await;
    let good = given.wear_states().await;
    given.raw("UPDATE cycles SET energy_scale = energy_scale + 1 WHERE cycle_id = 'c00003'").await.unwrap();
    given.raw("UPDATE tool_wear SET folded = folded - 1 WHERE tool_id = 'T2'").await.unwrap();
    let doubt = checked(&*store).await.doubt;
    assert_eq!(doubt.tools, BTreeSet::from(["T1".try_into().unwrap()]));
    let found = store.check_wear(Repair::AllBut(&doubt)).await.unwrap();
    assert_eq!(differing(&found), [("M1", "T1"), ("M1", "T2")]);
    assert_eq!(
        found.different.iter().map(|wear| wear.left).collect::<Vec<_>>(),
        [Some(Left::Doubtful), None]
    );
    let found = store.check_wear(Repair::No).await.unwrap();
    assert_eq!(differing(&found), [("M1", "T1")], "T2 was folded again");
    assert_eq!(given.wear_states().await, good, "T1 was left as it was");
    given.raw("UPDATE cycles SET energy_scale = energy_scale - 1 WHERE cycle_id = 'c00003'").await.unwrap();
    assert_eq!(told(&checked(&*store).await), []);
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
}

async fn a_cache_is_kept_that_alone_knows_of_a_cycle(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    let runs: Vec<Run> = (1..=8).map(|n| Run { sampled: false, ..Run::nth(n) }).collect();
    commit(&*store, &runs).await;
    let good = given.wear_states().await;
    given.raw("CREATE TABLE kept AS SELECT cycle_id, tool_id FROM cycles").await.unwrap();
    let losses: [(&'static str, u64); 2] = [
        ("UPDATE cycles SET tool_id = 'T9' WHERE cycle_id = 'c00003'", 1),
        ("DELETE FROM cycles WHERE cycle_id IN ('c00005', 'c00006')", 3),
    ];
    for (loss, missing) in losses {
        given.raw(loss).await.unwrap();
        let doubt = checked(&*store).await.doubt;
        for repair in [Repair::No, Repair::AllBut(&doubt), Repair::AllBut(&Doubt::default())] {
            let found = store.check_wear(repair).await.unwrap();
            assert_eq!(differing(&found), [("M1", "T1")], "{loss}");
            assert_eq!(found.different[0].missing, missing, "{loss}");
            let left = if repair == Repair::No { Left::Unasked } else { Left::Missing };
            assert_eq!(found.different[0].left, Some(left), "{loss}");
            assert_eq!(given.wear_states().await, good, "{loss}");
        }
    }
}

async fn wear_is_not_folded_over_cycles_that_nothing_vouches_for(given: &Given) {
    let store = given.store();
    eight(&*store).await;
    let states = given.wear_states().await;
    // As retention leaves it.
    given
        .raw(
            "INSERT INTO sample_drops (machine_id, before_us, dropped_at_us, reason, cycles, bytes)
             SELECT machine_id, MAX(received_at_us) + 1, MAX(received_at_us) + 1, 'size', COUNT(*), 1 FROM cycles
             GROUP BY machine_id",
        )
        .await
        .unwrap();
    given.raw("DELETE FROM cycle_samples").await.unwrap();
    if !given.is_postgres() {
        given.raw("DELETE FROM sample_packs").await.unwrap();
    }
    let found = checked(&*store).await;
    assert_eq!((told(&found), found.dropped), (vec![], 7));
    let pair = |tool: &str| ("M1".try_into().unwrap(), tool.try_into().unwrap());
    assert_eq!(found.doubt.unproven, BTreeSet::from([pair("T1"), pair("T2")]));
    assert_eq!(store.check_wear(Repair::AllBut(&found.doubt)).await.unwrap().different, []);

    let change = "UPDATE cycles SET energy_scale = energy_scale + 1 WHERE cycle_id = 'c00003'";
    assert_eq!(given.raw(change).await.unwrap(), 1);
    let doubt = checked(&*store).await.doubt;
    let left = store.check_wear(Repair::AllBut(&doubt)).await.unwrap();
    assert_eq!((differing(&left), left.different[0].left), (vec![("M1", "T1")], Some(Left::Unproven)));
    assert_eq!(given.wear_states().await, states, "nothing says which of them is right");
    let asked_for = Doubt { unproven: BTreeSet::new(), ..doubt };
    let folded = store.check_wear(Repair::AllBut(&asked_for)).await.unwrap();
    assert_eq!((differing(&folded), folded.different[0].left), (vec![("M1", "T1")], None));
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    // A fold of other rules is believed by nobody: there is nothing to lose in it.
    assert_eq!(given.raw("UPDATE tool_wear SET fold_version = 1, state = state").await.unwrap(), 2);
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    let doubt = checked(&*store).await.doubt;
    let folded = store.check_wear(Repair::AllBut(&doubt)).await.unwrap();
    assert_eq!(folded.different.iter().map(|wear| wear.left).collect::<Vec<_>>(), [None, None]);
    // A number beside a fold that holds is no cycle that is missing.
    given.raw("UPDATE tool_wear SET folded = folded + 1048576 WHERE tool_id = 'T1'").await.unwrap();
    let folded = store.check_wear(Repair::AllBut(&Doubt::default())).await.unwrap();
    assert_eq!((folded.different[0].missing, folded.different[0].left), (0, None));
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    // What retention left cannot be read: the rest is checked all the same.
    if !given.is_postgres() {
        let damage = "PRAGMA ignore_check_constraints = ON; UPDATE sample_drops SET reason = 'siz'";
        given.raw(damage).await.unwrap();
        let found = checked(&*store).await;
        assert_eq!((found.faults.len(), found.checked), (7, 8), "{found:?}");
        assert!(found.faults.iter().all(|fault| fault.detail.contains("cannot be read: column reason")));
    }
}

/// Bits of a number the other way round, in the words of either engine.
fn flipped(column: &str, bits: u32) -> String {
    format!("{column} = ({column} | {bits}) - ({column} & {bits})")
}

/// Every column, and every flag, that wear reads of a cycle: one that another hand changed is a fault of its cycle, or of its key, or
/// makes no difference to wear. Never is wear folded over it.
async fn whatever_wear_reads_of_a_cycle_is_held_against_what_was_taken_in(given: &Given) {
    let store = given.store();
    eight(&*store).await;
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(1)).await.unwrap();
    let good = given.wear_states().await;
    let source = include_str!("../../../service/store/src/engine/wear.rs");
    let (_, columns) = source.split_once("macro_rules! facts_columns").unwrap();
    let (columns, _) = columns.split_once("o.baseline_cycles").unwrap();
    let mut columns: BTreeSet<&str> = columns
        .split("c.")
        .skip(1)
        .map(|rest| rest.split(|c: char| c != '_' && !c.is_ascii_alphanumeric()).next().unwrap())
        .collect();
    assert!(
        columns.len() > 25 && columns.contains("flags") && columns.contains("recommendation_id"),
        "{columns:?}"
    );
    // Their receipt, which wear reads of cycles without a clock alone, names the cycles: one with samples, and one without.
    assert!(columns.remove("received_at_us"));
    for (seconds, cycle) in [(1800, "c00003"), (4800, "c00008")] {
        let here = format!("received_at_us = {}", at(seconds).plus_millis(3000).micros());
        let mut changes = Vec::new();
        for column in &columns {
            let kept = given.kept_in(column);
            match *column {
                "machine_id" => changes.push("machine_id = 'M2'".to_owned()),
                "cycle_id" | "operation_id" | "law_version" | "recommendation_id" => {
                    changes.push(format!("{column} = 'another.ref'"));
                }
                "started_at_us" | "energy_scale" => changes.push(flipped(column, 1 << 20)),
                "seq" => changes.extend(["seq = seq + 1".to_owned(), "seq = NULL".to_owned()]),
                "strategy" => {
                    changes.extend(["strategy = 'f_const'".to_owned(), "strategy = NULL".to_owned()]);
                }
                "profile_id" | "profile_version" => {
                    changes.push("profile_id = 'P1', profile_version = 1".to_owned());
                }
                "coverage" => changes.push("coverage = 0.5".to_owned()),
                "depth_digest" => {
                    let other = if cycle == "c00003" { "'c00001'" } else { "'c00007'" };
                    changes.push(format!(
                        "depth_digest = (SELECT o.depth_digest FROM cycles o WHERE o.cycle_id = {other})"
                    ));
                    changes.push("depth_digest = NULL".to_owned());
                }
                "flags" => {
                    changes.extend((0..32).map(|bit| flipped("flags", 1 << bit)));
                    changes.push(flipped("flags", Flag::CutShort as u32 | Flag::Incomplete as u32));
                    changes.push(flipped("flags", Flag::ReferenceCycle as u32 | Flag::NoReferenceCycle as u32));
                }
                _ => changes.extend([
                    format!(
                        "{kept} = CASE WHEN {column} IS NULL THEN 1.0 ELSE {column} * 1.0001 END,
                         quantities = quantities + CASE WHEN {column} IS NULL THEN 1 ELSE 0 END"
                    ),
                    format!(
                        "{kept} = NULL, quantities = quantities - CASE WHEN {column} IS NULL THEN 0 ELSE 1 END"
                    ),
                ]),
            }
        }
        let mut written: BTreeSet<String> = columns.iter().map(|column| given.kept_in(column)).collect();
        written.insert("quantities".to_owned());
        let written = written.into_iter().collect::<Vec<_>>().join(", ");
        given
            .raw(AssertSqlSafe(format!("CREATE TABLE kept AS SELECT {written} FROM cycles WHERE {here}")))
            .await
            .unwrap();
        for change in changes {
            let sql = format!("UPDATE cycles SET {change} WHERE {here}");
            assert_eq!(given.raw(AssertSqlSafe(sql)).await.unwrap(), 1, "{change}");
            let found = checked(&*store).await;
            let wear = store.check_wear(Repair::AllBut(&found.doubt)).await.unwrap();
            assert_eq!(given.wear_states().await, good, "{cycle}, {change}: wear was folded over it");
            let is_left = !wear.different.is_empty() && wear.different.iter().all(|wear| wear.left.is_some());
            let makes_none = wear.different.is_empty() && wear.unreadable.is_empty();
            assert!(!found.faults.is_empty() || is_left || makes_none, "{cycle}, {change}: {wear:?}");
            let back = format!("UPDATE cycles SET ({written}) = (SELECT {written} FROM kept) WHERE {here}");
            given.raw(AssertSqlSafe(back)).await.unwrap();
        }
        given.raw("DROP TABLE kept").await.unwrap();
        assert_eq!(told(&checked(&*store).await), [], "{cycle}");
        assert_eq!(store.check_wear(Repair::No).await.unwrap().different, [], "{cycle}");
    }
}

/// What a stream cut off is in no sample and no hash: the flag alone says so, beside the one that goes with it.
async fn a_flag_that_says_what_was_cut_off_is_not_taken_for_truth(given: &Given) {
    const BOTH: u32 = Flag::CutShort as u32 | Flag::Incomplete as u32;
    let store = given.store();
    shop(&*store).await;
    store.put_tool(super::given::tool("T2"), Precondition::Unstated, &engineer(), at(0)).await.unwrap();
    let cut = |n: u32| NewCycle {
        cut_short: n == 4,
        ..Run { seconds: i64::from(n) * 600, ..Run::nth(n) }.new_cycle()
    };
    let mut group: Vec<NewCycle> = (1..=8).map(cut).collect();
    group.extend(
        (11..=18)
            .map(|n| Run { seconds: i64::from(n) * 600, tool: "T2".to_owned(), ..Run::nth(n) }.new_cycle()),
    );
    for outcome in store.commit_cycles(group, at(100_000), RecommendSettings::default()).await {
        assert!(matches!(outcome, Ok(Committed::Stored(_))), "{outcome:?}");
    }
    let good = given.wear_states().await;
    let flip = async |cycle: &str, bits: u32| {
        let sql = format!("UPDATE cycles SET {} WHERE cycle_id = '{cycle}'", flipped("flags", bits));
        assert_eq!(given.raw(AssertSqlSafe(sql)).await.unwrap(), 1);
    };
    let clean = checked(&*store).await;
    assert_eq!((told(&clean), clean.unverified), (vec![], 0));
    assert_eq!(
        clean.doubt.unproven,
        BTreeSet::from([("M1".try_into().unwrap(), "T1".try_into().unwrap())]),
        "nothing else says that the fourth is a part"
    );
    assert_eq!(store.check_wear(Repair::AllBut(&clean.doubt)).await.unwrap().different, []);

    // One flag without the other is none that was ever set; both, or neither, may have been.
    let stories = [
        ("c00013", Flag::CutShort as u32, "T2", Left::Doubtful),
        ("c00004", Flag::CutShort as u32, "T1", Left::Doubtful),
        ("c00004", Flag::Incomplete as u32, "T1", Left::Unasked),
        ("c00013", Flag::Incomplete as u32, "T2", Left::Unasked),
        ("c00013", BOTH, "T2", Left::Unproven),
        ("c00004", BOTH, "T1", Left::Unproven),
    ];
    for (cycle, bits, tool, left) in stories {
        flip(cycle, bits).await;
        let found = checked(&*store).await;
        let faults = told_keys(&found);
        let key = format!("M1/{cycle}");
        let expected: &[_] = if bits == BOTH { &[] } else { &[("summary", key.as_str())] };
        assert_eq!(faults, expected, "{cycle} {bits}");
        let wear = store.check_wear(Repair::AllBut(&found.doubt)).await.unwrap();
        assert_eq!(given.wear_states().await, good, "{cycle} {bits}");
        if left == Left::Unasked {
            assert_eq!(wear.different, [], "wear does not go by the other flag");
        } else {
            assert_eq!((differing(&wear), wear.different[0].left), (vec![("M1", tool)], Some(left)));
        }
        flip(cycle, bits).await;
    }

    // Whoever asks for it has wear folded by what is stored.
    flip("c00013", BOTH).await;
    let doubt = checked(&*store).await.doubt;
    let asked_for = Doubt { unproven: BTreeSet::new(), cut_short: false, ..doubt };
    let wear = store.check_wear(Repair::AllBut(&asked_for)).await.unwrap();
    assert!(wear.different.iter().any(|wear| wear.tool.as_str() == "T2" && wear.left.is_none()), "{wear:?}");
}

/// Of one tool, in the order of their machines.
async fn versions(given: &Given) -> Vec<i64> {
    given.numbers("SELECT version FROM tool_wear WHERE tool_id = 'T1' ORDER BY machine_id").await
}

async fn generation(given: &Given) -> i64 {
    given.numbers("SELECT CAST(SUM(changes) AS BIGINT) FROM registry_generation").await[0]
}

async fn a_fold_that_is_made_anew_is_not_taken_for_the_one_remembered(given: &Given) {
    let (store, none) = (given.store(), Doubt::default());
    shop(&*store).await;
    store.put_tool(super::given::tool("T2"), Precondition::Unstated, &engineer(), at(1)).await.unwrap();
    let first = Run::nth(1);
    let other = Run { tool: "T2".to_owned(), load: 60.0, ..Run::nth(2) };
    for run in [&first, &other] {
        super::given::stored(&*store, run).await;
    }
    assert_eq!(versions(given).await, [1]);
    // The fold of another tool stands where its own was. Who then meets a cycle of it again remembers that, as version 1.
    given
        .raw("UPDATE tool_wear SET state = (SELECT state FROM tool_wear WHERE tool_id = 'T2') WHERE tool_id = 'T1'")
        .await
        .unwrap();
    store.put_tool(super::given::tool("T3"), Precondition::Absent, &engineer(), at(3)).await.unwrap();
    let again = commit(&*store, std::slice::from_ref(&first)).await.pop().unwrap();
    assert!(matches!(again, Ok(Committed::Known(_))), "{again:?}");

    let repaired = store.check_wear(Repair::AllBut(&none)).await.unwrap();
    assert_eq!(differing(&repaired), [("M1", "T1")]);
    assert_eq!(versions(given).await, [2], "it counts on");
    super::given::stored(&*store, &Run::nth(3)).await;
    assert_eq!(
        store.check_wear(Repair::No).await.unwrap().different,
        [],
        "the next cycle is counted on the good one"
    );
    assert_eq!(store.verdict(&"T1".try_into().unwrap()).await.unwrap().cycles, 2);

    // A repair that finds nothing makes no server forget what it knows.
    let before = (generation(given).await, versions(given).await);
    assert_eq!(store.check_wear(Repair::AllBut(&none)).await.unwrap().different, []);
    assert_eq!((generation(given).await, versions(given).await), before);

    // A fold of a machine that never ran the tool goes.
    store.put_machine(machine("M2"), Precondition::Absent, &engineer(), at(4)).await.unwrap();
    given
        .raw(
            "INSERT INTO tool_wear (machine_id, tool_id, folded, fold_version, state, version, updated_at_us)
             SELECT 'M2', tool_id, folded, fold_version, state, version, updated_at_us FROM tool_wear WHERE tool_id = 'T1'",
        )
        .await
        .unwrap();
    // But not one that says it has counted cycles of it: nothing else would know of them.
    let left = store.check_wear(Repair::AllBut(&none)).await.unwrap();
    assert_eq!(differing(&left), [("M2", "T1")]);
    assert_eq!((left.different[0].missing, left.different[0].left), (2, Some(Left::Missing)));
    assert_eq!(given.raw("UPDATE tool_wear SET folded = 0 WHERE machine_id = 'M2'").await.unwrap(), 1);
    let repaired = store.check_wear(Repair::AllBut(&none)).await.unwrap();
    assert_eq!(differing(&repaired), [("M2", "T1")]);
    assert_eq!(versions(given).await, [4]);
    assert_eq!(generation(given).await, before.0 + 2, "what servers remember is asked for again");
    super::given::stored(&*store, &Run::nth(4)).await;
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
}

async fn a_course_that_cannot_be_read_is_named_and_the_rest_is_checked(given: &Given) {
    let store = given.store();
    eight(&*store).await;
    let bytes = if given.is_postgres() {
        "decode(repeat('00', length(depth_digest)), 'hex')"
    } else {
        "zeroblob(length(depth_digest))"
    };
    let damage = format!("UPDATE cycles SET depth_digest = {bytes} WHERE cycle_id IN ('c00003', 'c00006')");
    assert_eq!(given.raw(AssertSqlSafe(damage)).await.unwrap(), 2);
    given.raw("UPDATE cycles SET duration_ms = 1 WHERE cycle_id = 'c00008'").await.unwrap();
    let found = checked(&*store).await;
    let keys: Vec<_> = told(&found).into_iter().map(|(kind, key, _)| (kind, key)).collect();
    assert_eq!(keys, [("summary", "M1/c00003"), ("summary", "M1/c00006"), ("summary", "M1/c00008")]);
    assert!(found.faults[0].detail.contains("depth_digest"), "{:?}", found.faults[0]);
    for repair in [Repair::No, Repair::AllBut(&found.doubt), Repair::AllBut(&Doubt::default())] {
        let wear = store.check_wear(repair).await.unwrap();
        let named: Vec<_> =
            wear.unreadable.iter().map(|(tool, what)| (tool.as_str(), what.as_str())).collect();
        assert_eq!(
            named,
            [
                ("T1", "cycle M1/c00003: column depth_digest holds what it must not"),
                ("T2", "cycle M1/c00006: column depth_digest holds what it must not")
            ]
        );
    }
}

async fn a_course_that_cannot_be_read_costs_its_cycle_alone(given: &Given) {
    let store = given.store();
    eight(&*store).await;
    let bytes = if given.is_postgres() {
        "decode(repeat('00', length(depth_digest)), 'hex')"
    } else {
        "zeroblob(length(depth_digest))"
    };
    given.raw("CREATE TABLE kept AS SELECT cycle_id, depth_digest FROM cycles").await.unwrap();
    let damage = format!("UPDATE cycles SET depth_digest = {bytes} WHERE cycle_id = 'c00003'");
    assert_eq!(given.raw(AssertSqlSafe(damage)).await.unwrap(), 1);

    let (machine, tool) = ("M1".try_into().unwrap(), "T1".try_into().unwrap());
    let page = || Page { after: None, limit: 100 };
    let courses = |cycles: &[feedwright_store::StoredCycle]| {
        cycles.iter().map(|cycle| cycle.summary.digest.is_some()).collect::<Vec<_>>()
    };
    let all = CycleFilter::default();
    // The eighth has no samples.
    let with = [true, true, false, true, true, true, true, false];
    let listed = store.cycles(&all, page()).await.unwrap();
    assert_eq!(courses(&listed), with);
    assert!(!listed[2].summary.energy.is_empty() && listed[2].has_samples, "what it is otherwise is told");
    assert_eq!(courses(&store.last_cycles(&all, 100).await.unwrap()), with);
    let id = "c00003".try_into().unwrap();
    assert_eq!(store.cycle(&machine, &id).await.unwrap().unwrap(), listed[2]);
    assert!(store.cycle_samples(&machine, &id).await.unwrap().is_some());
    assert_eq!(store.points(&all, page()).await.unwrap().len(), 8);
    let fleet = store.fleet_machine(&machine, 8).await.unwrap().unwrap();
    let contacts: Vec<_> = fleet.recent.iter().map(|cycle| cycle.facts.digest.is_some()).collect();
    assert_eq!(contacts.iter().filter(|known| **known).count(), 6, "{contacts:?}");

    // A late cycle folds the tool's history anew, past the one that is damaged: of that nothing is known.
    let late = Run { seconds: 1500, ..Run::nth(20) };
    let outcome = commit(&*store, std::slice::from_ref(&late)).await.pop().unwrap();
    assert!(matches!(outcome, Ok(Committed::Stored(_))), "{outcome:?}");
    let life = store.life(&tool, 100).await.unwrap();
    let told: Vec<_> =
        life.cycles.iter().map(|cycle| (cycle.facts.order.cycle.as_str(), cycle.excluded)).collect();
    assert_eq!(
        told,
        [
            ("c00001", None),
            ("c00020", None),
            ("c00003", Some(Exclusion::NoEnergy)),
            ("c00005", None),
            ("c00007", None)
        ]
    );
    assert_eq!(store.verdict(&tool).await.unwrap(), life.verdict);
    assert_eq!(life.verdict.cycles, 5);

    // The check still names it, and repairs nothing that it cannot judge.
    let found = checked(&*store).await;
    assert_eq!(told_keys(&found), [("summary", "M1/c00003")]);
    let wear = store.check_wear(Repair::AllBut(&Doubt::default())).await.unwrap();
    assert_eq!(wear.unreadable.len(), 1, "{wear:?}");
    assert_eq!(wear.unreadable[0].0, tool.as_str());

    // Put right by hand: the folds are made again of what there is.
    given
        .raw(
            "UPDATE cycles SET depth_digest = (SELECT k.depth_digest FROM kept k WHERE k.cycle_id = 'c00003')
             WHERE cycle_id = 'c00003'",
        )
        .await
        .unwrap();
    given.raw("DROP TABLE kept").await.unwrap();
    assert_eq!(told_keys(&checked(&*store).await), []);
    assert_eq!(store.check_wear(Repair::AllBut(&Doubt::default())).await.unwrap().different.len(), 1);
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    let life = store.life(&tool, 100).await.unwrap();
    assert!(life.cycles.iter().all(|cycle| cycle.excluded.is_none()), "{life:?}");
}

fn told_keys(page: &CheckPage) -> Vec<(&str, &str)> {
    told(page).into_iter().map(|(kind, key, _)| (kind, key)).collect()
}

/// Of its schema SQLite has no sum: it goes by whatever text stands there.
#[tokio::test]
async fn a_definition_that_is_another_is_named() {
    let given = Given::sqlite().await;
    let store = given.store();
    eight(&*store).await;
    given.raw("CREATE TABLE of_somebody_else (id INTEGER)").await.unwrap();
    given.raw("CREATE INDEX of_somebody ON cycles (outcome)").await.unwrap();
    assert_eq!(store.check_tables().await.unwrap(), [], "what is made besides is no fault");
    for (name, from, to) in
        [("operations", "'turning'", "'tusning'"), ("cycles_by_machine", "CREATE INDEX", "CREATE  INDEX")]
    {
        let change = |from: &str, to: &str| {
            let (from, to) = (from.replace('\'', "''"), to.replace('\'', "''"));
            let sql = format!(
                "PRAGMA writable_schema = ON;
                 UPDATE sqlite_schema SET sql = replace(sql, '{from}', '{to}') WHERE name = '{name}';
                 PRAGMA writable_schema = RESET"
            );
            given.raw(AssertSqlSafe(sql))
        };
        change(from, to).await.unwrap();
        let found = store.check_tables().await.unwrap();
        let told: Vec<_> = found.iter().map(|fault| (fault.kind, fault.key.as_str())).collect();
        assert_eq!(told, [("schema", name)], "{found:?}");
        assert!(found[0].may_mislead_wear());
        change(to, from).await.unwrap();
        assert_eq!(store.check_tables().await.unwrap(), [], "{name}");
    }
    given.done().await;
}

/// Retention adds up what is told, and would make room for bytes that are not there.
#[tokio::test]
async fn samples_that_are_told_to_take_other_bytes_are_named() {
    let given = Given::sqlite().await;
    let store = given.store();
    eight(&*store).await;
    let more = "UPDATE cycle_samples SET bytes = bytes + 134217728 WHERE cycle_id = 'c00003'";
    assert_eq!(given.raw(more).await.unwrap(), 1);
    let found = checked(&*store).await;
    assert_eq!(told_keys(&found), [("samples", "M1/c00003")]);
    assert!(found.faults[0].detail.starts_with("they are told to take 1342"), "{:?}", found.faults);
    assert_eq!(found.doubt.tools, BTreeSet::new(), "they are whole");
    given.done().await;
}

fn admin() -> Actor {
    Actor { token: "cli".to_owned(), role: Role::Admin }
}

fn token(id: &str) -> TokenRecord {
    TokenRecord {
        id: id.to_owned(),
        name: "MES".to_owned(),
        hash: [7; 32],
        role: Role::Machine,
        machine: Some("M1".try_into().unwrap()),
        created_at: at(3),
        revoked_at: None,
    }
}

/// Something in nearly every table that has texts.
async fn all_kinds(store: &dyn Store) {
    eight(store).await;
    super::feed_profiles::activated(store, 300.0).await;
    let (machine, now) = ("M1".try_into().unwrap(), at(9000));
    let entry = |id: &str| QuarantineEntry {
        id: id.to_owned(),
        machine: "M1".try_into().unwrap(),
        cycle: Some("c1".to_owned()),
        received_at: at(5),
        code: "out_of_range".to_owned(),
        problem: "{}".to_owned(),
        content_type: "application/json".to_owned(),
        settled: None,
        size: 3,
    };
    let bounds = QuarantineBounds { entries: 10, bytes: 1000 };
    store.quarantine(entry("q1"), b"{-}".to_vec(), bounds).await.unwrap();
    store.quarantine(entry("q2"), b"{+}".to_vec(), bounds).await.unwrap();
    assert!(settle(store, "q1", "dismissed", now).await);
    store.create_token(token("tok-1"), &admin()).await.unwrap();
    let session =
        SessionRecord { hash: [1; 32], token: "tok-1".to_owned(), created_at: at(100), expires_at: at(150) };
    store.begin_session(session, 5, &engineer()).await.unwrap();
    let overrides = feedwright_store::CycleOverrides {
        machine: "M1".try_into().unwrap(),
        cycle: "streamed".try_into().unwrap(),
        mode: "advise".to_owned(),
        law_version: "1".to_owned(),
        program_hash: Some("0".repeat(64)),
        stored_at: at(0),
        block: feedwright_store::codec::encode_overrides(&[(100.0, 1)]).unwrap(),
    };
    store.put_overrides(&overrides, feedwright_store::Sent::AsItRan).await.unwrap();
    let retention = feedwright_store::SampleRetention { days: Some(90), bytes: None };
    store.put_retention(&machine, retention, Precondition::Absent, &engineer(), now).await.unwrap();
}

/// The file beside its store, as a disk changes it: nothing is asked of keys and constraints.
async fn on_disk(given: &Given) -> SqliteConnection {
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(given.file()).foreign_keys(false);
    let mut conn = options.connect().await.unwrap();
    conn.execute("PRAGMA ignore_check_constraints = ON").await.unwrap();
    conn
}

/// The same where the audit is changed, too.
async fn beside(given: &Given) -> SqliteConnection {
    let mut conn = on_disk(given).await;
    conn.execute("DROP TRIGGER audit_refuses_update").await.unwrap();
    conn
}

/// Every column of texts of every table that holds any, each with one of its texts, in hexadecimals.
async fn texts(conn: &mut SqliteConnection) -> Vec<(String, String, String)> {
    let columns: Vec<(String, String)> = sqlx::query_as(
        "SELECT t.name, c.name FROM sqlite_schema t, pragma_table_xinfo(t.name) c
         WHERE t.type = 'table' AND c.type = 'TEXT' AND c.hidden = 0 AND t.name <> '_sqlx_migrations'
         ORDER BY t.name, c.cid",
    )
    .fetch_all(&mut *conn)
    .await
    .unwrap();
    let mut found = Vec::new();
    for (table, column) in columns {
        let sql = format!("SELECT hex({column}) FROM {table} WHERE {column} <> '' LIMIT 1");
        let text: Option<String> =
            sqlx::query_scalar(AssertSqlSafe(sql)).fetch_optional(&mut *conn).await.unwrap();
        found.extend(text.map(|text| (table, column, text)));
    }
    found
}

/// Whatever text a disk has damaged: what keeps a backup from being made is named by the check, and by the backup too.
#[tokio::test]
async fn a_text_that_does_not_decode_is_named_with_its_row_and_the_rest_is_checked() {
    let given = Given::sqlite().await;
    let store = given.store();
    all_kinds(&*store).await;
    assert_eq!(store.check_tables().await.unwrap(), []);
    let folder = tempfile::tempdir().unwrap();
    let backup = folder.path().join("backup");
    // What is in the journal goes into the file.
    back_up_sqlite(&given.file(), &folder.path().join("sound"), at(1)).await.unwrap();
    let mut conn = beside(&given).await;
    conn.execute("INSERT INTO machine_contacts VALUES ('M1', 1)").await.unwrap();
    let texts = texts(&mut conn).await;
    let mut tables = BTreeSet::new();
    for (table, column, text) in &texts {
        let change = |from: &str, to: &str| {
            let sql = format!(
                "UPDATE {table} SET {column} = CAST(x'{to}' AS TEXT) WHERE {column} = CAST(x'{from}' AS TEXT)"
            );
            AssertSqlSafe(sql)
        };
        // As a turned bit leaves it, and as many bytes as before.
        let damaged = format!("{}FF", &text[..text.len() - 2]);
        let rows = conn.execute(change(text, &damaged)).await.unwrap().rows_affected();
        let faults = store.check_tables().await.unwrap();
        let prefix = format!("{table} ");
        let told = |fault: &&feedwright_store::StoreFault| {
            fault.kind == "row"
                && fault.key.starts_with(&prefix)
                && fault.detail.contains(&format!("its {column} "))
        };
        assert_eq!(faults.iter().filter(told).count() as u64, rows, "{table}.{column}: {faults:?}");
        // Page by page, each of which ends at a row that may be damaged.
        let (mut after, mut checked) = (None, 0);
        loop {
            let limit = if table == "cycles" { 1 } else { 100 };
            let page = store.check_cycles(after.as_ref(), limit).await.unwrap();
            checked += page.checked;
            if table == "cycles" && page.checked > 0 && rows == 8 {
                assert_eq!(page.faults.len(), 1, "{column}: {page:?}");
            }
            match page.next {
                Some(next) => after = Some(next),
                None => break,
            }
        }
        assert_eq!(checked, 8, "{table}.{column}");
        store.check_wear(Repair::No).await.unwrap();
        // Words that a table refuses SQLite finds before.
        let is_refused = faults.iter().any(|fault| fault.kind == "table");
        if !is_refused && tables.insert(table.as_str()) {
            let refused = back_up_sqlite(&given.file(), &backup, at(1)).await.unwrap_err().to_string();
            let named = format!("stored data is damaged: {table} ");
            assert!(
                refused.starts_with(&named) && refused.contains(column.as_str()),
                "{table}.{column}: {refused}"
            );
        }
        assert_eq!(conn.execute(change(&damaged, text)).await.unwrap().rows_affected(), rows);
    }
    for table in [
        "advices",
        "alarms",
        "audit",
        "cycle_overrides",
        "cycle_samples",
        "cycles",
        "feed_profile_versions",
        "feed_profiles",
        "machine_contacts",
        "machines",
        "operation_asks",
        "operations",
        "quarantine",
        "recommendations",
        "retention",
        "sessions",
        "tokens",
        "tool_events",
        "tool_wear",
        "tools",
    ] {
        assert!(tables.contains(table), "{table}: {tables:?}");
    }
    // An id that is kept by its bytes.
    let id = "UPDATE recommendations SET recommendation_id = x'ff' WHERE recommendation_id = \
              (SELECT MIN(recommendation_id) FROM recommendations)";
    assert_eq!(conn.execute(id).await.unwrap().rows_affected(), 1);
    let faults = store.check_tables().await.unwrap();
    let [fault] = &faults.iter().filter(|fault| fault.kind == "row").collect::<Vec<_>>()[..] else {
        panic!("{faults:?}")
    };
    assert!(fault.key.starts_with("recommendations ff/M1"), "{fault:?}");
    let (from, to) = (Address::Sqlite(given.file()), Address::Sqlite(folder.path().join("copy")));
    let refused = copy(&from, &to, &mut |_, _, _| {}).await.unwrap_err().to_string();
    assert!(refused.starts_with("stored data is damaged: recommendations ff/M1"), "{refused}");
    conn.close().await.unwrap();
    given.done().await;
}

/// What people only read takes neither the list away, nor the posts, nor the start.
#[tokio::test]
async fn a_damaged_name_takes_nothing_else_away() {
    let given = Given::sqlite().await;
    let store = given.store();
    all_kinds(&*store).await;
    let mut conn = beside(&given).await;
    for (table, column) in [
        ("machines", "name"),
        ("machines", "control"),
        ("tools", "name"),
        ("operations", "name"),
        ("tool_events", "reason"),
        ("tool_events", "actor"),
        ("alarms", "message"),
        ("audit", "detail"),
        ("tokens", "name"),
        ("quarantine", "settled_how"),
    ] {
        let sql = format!("UPDATE {table} SET {column} = CAST(x'41ff' AS TEXT) WHERE {column} IS NOT NULL");
        assert!(conn.execute(AssertSqlSafe(sql)).await.unwrap().rows_affected() > 0, "{table}");
    }
    conn.execute("UPDATE registry_generation SET changes = changes + 1").await.unwrap();
    conn.close().await.unwrap();
    let shown = "A\u{fffd}";
    let page = || Page { after: None, limit: 100 };
    assert_eq!(store.machines(Page { after: None, limit: 9 }).await.unwrap()[0].value.name, shown);
    assert_eq!(store.tools(Page { after: None, limit: 9 }).await.unwrap().len(), 2);
    assert_eq!(store.operations(Page { after: None, limit: 9 }).await.unwrap()[0].value.name, shown);
    assert_eq!(store.alarms(&Default::default(), page()).await.unwrap()[0].message, shown);
    assert_eq!(store.audit(page()).await.unwrap()[0].detail, shown);
    assert_eq!(store.token_by_hash(&[7; 32]).await.unwrap().unwrap().name, shown);
    assert!(store.quarantine_entry("q1").await.unwrap().is_some());
    assert!(!store.create_first_token(token("tok-2"), &admin()).await.unwrap());
    super::given::stored(&*store, &Run { seconds: 6000, ..Run::nth(30) }).await;
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    given.done().await;
}

/// Without sums of its pages PostgreSQL gives what a disk has made of them. It takes no such text, neither from who damages it for a test nor
/// from who asks what comes behind it; one in SQL_ASCII takes it, and gives it to nobody who asks for UTF-8.
#[tokio::test]
async fn a_key_of_a_plant_that_does_not_decode_is_named_and_the_rest_is_checked() {
    const BYTES: &str = "ENCODING SQL_ASCII LOCALE 'C' TEMPLATE template0";
    for made in ["", BYTES] {
        let Some(given) = Given::postgres_made(made).await else {
            return;
        };
        let store = given.store();
        all_kinds(&*store).await;
        assert_eq!(store.check_tables().await.unwrap(), []);
        let mut disk = PgConnection::connect(&given.address()).await.unwrap();
        // Bytes are taken for a text without a look at them, and nothing is asked of keys.
        disk.execute(
            "SET session_replication_role = replica;
             CREATE FUNCTION as_a_disk_has_it(bytea, int) RETURNS text IMMUTABLE STRICT LANGUAGE internal
                 AS 'bytea_substr_no_len'",
        )
        .await
        .unwrap();
        for (table, column, rows) in [
            ("cycles", "cycle_id", "cycle_id IN ('c00003', 'c00004', 'c00008')"),
            ("cycles", "tool_id", "cycle_id = 'c00002'"),
            ("tools", "tool_id", "tool_id = 'T1'"),
            ("cycle_overrides", "cycle_id", "TRUE"),
            ("feed_profile_versions", "profile_id", "TRUE"),
            ("quarantine", "quarantine_id", "quarantine_id = 'q1'"),
            ("recommendations", "recommendation_id", "TRUE"),
        ] {
            disk.execute("BEGIN").await.unwrap();
            let kept = format!("CREATE TABLE kept AS SELECT * FROM {table}");
            disk.execute(AssertSqlSafe(kept)).await.unwrap();
            let damage = format!(
                "UPDATE {table} SET {column} = as_a_disk_has_it(
                     set_byte({column}::bytea, length({column}) - 2, 255), 1) WHERE {rows}"
            );
            let damaged = disk.execute(AssertSqlSafe(damage)).await.unwrap().rows_affected();
            disk.execute("COMMIT").await.unwrap();
            assert!(damaged > 0, "{table}.{column}");
            let faults = store.check_tables().await.unwrap();
            let told = |fault: &&StoreFault| {
                fault.kind == "row"
                    && fault.key.starts_with(&format!("{table} "))
                    && fault.column.as_deref() == Some(column)
            };
            assert_eq!(faults.iter().filter(told).count() as u64, damaged, "{table}.{column}: {faults:?}");
            let held = super::row_sums::held(&*store).await.damaged;
            let in_sums = if table == "tools" { damaged } else { 0 };
            assert_eq!(held.len() as u64, in_sums, "all are held, whatever comes before: {held:?}");
            for limit in [1, 2, 3, 100] {
                let (mut after, mut checked, mut told) = (None, 0, 0);
                loop {
                    let page = store.check_cycles(after.as_ref(), limit).await.unwrap();
                    checked += page.checked;
                    told += page.faults.len() as u64;
                    match page.next {
                        Some(next) => after = Some(next),
                        None => break,
                    }
                }
                assert_eq!(checked, 8, "{table}.{column}, {limit} at a time");
                assert!(table != "cycles" || told == damaged, "{column}: {told}");
            }
            let wear = store.check_wear(Repair::No).await.unwrap();
            if table == "tools" {
                assert_eq!(wear.unreadable.len(), 1, "{wear:?}");
            }
            let back = format!(
                "DELETE FROM {table}; INSERT INTO {table} OVERRIDING SYSTEM VALUE SELECT * FROM kept; DROP TABLE kept"
            );
            disk.execute(AssertSqlSafe(back)).await.unwrap();
            assert_eq!(store.check_tables().await.unwrap(), [], "{table}.{column}");
        }
        disk.close().await.unwrap();
        given.done().await;
    }
}

/// What wear is folded of is one thing, and what is only shown another: `--repair` folds over the one, and not over the other.
#[tokio::test]
async fn what_is_only_shown_misleads_no_wear() {
    let given = Given::sqlite().await;
    let store = given.store();
    all_kinds(&*store).await;
    let mut conn = on_disk(&given).await;
    let shown = [
        ("cycles", "process"),
        ("machines", "name"),
        ("operations", "name"),
        ("operations", "program"),
        ("tool_events", "actor"),
        ("tool_events", "reason"),
        ("tools", "name"),
    ];
    let mut tried = BTreeSet::new();
    let texts = texts(&mut conn).await;
    let folded = ["cycles", "machines", "operation_asks", "operations", "tool_events", "tools"];
    for (table, column, text) in texts.iter().filter(|(table, ..)| folded.contains(&table.as_str())) {
        let change = |from: &str, to: &str| {
            let sql = format!(
                "UPDATE {table} SET {column} = CAST(x'{to}' AS TEXT) WHERE {column} = CAST(x'{from}' AS TEXT)"
            );
            AssertSqlSafe(sql)
        };
        let damaged = format!("{}FF", &text[..text.len() - 2]);
        assert!(conn.execute(change(text, &damaged)).await.unwrap().rows_affected() > 0);
        let faults = store.check_tables().await.unwrap();
        let is_shown = shown.contains(&(table.as_str(), column.as_str()));
        let of_rows = || faults.iter().filter(|fault| fault.kind == "row");
        let here = of_rows().find(|fault| fault.column.as_ref() == Some(column)).unwrap();
        let key = column.ends_with("_id") || ["kind", "strategy", "law_version"].contains(&column.as_str());
        let misleads = table != "machines" && (key || (table == "operations" && column == "process"));
        assert_eq!(here.may_mislead_wear(), misleads, "{table}.{column}: {faults:?}");
        // Words that a table refuses are told of it as a whole.
        if is_shown && !faults.iter().any(|fault| fault.kind == "table") {
            assert!(!faults.iter().any(StoreFault::may_mislead_wear), "{table}.{column}: {faults:?}");
        }
        tried.extend(is_shown.then_some((table.as_str(), column.as_str())));
        conn.execute(change(&damaged, text)).await.unwrap();
    }
    assert!(tried.len() > 4, "{tried:?}");

    // Whatever else of a row is damaged is told too: what misleads is not behind what does not.
    conn.execute("UPDATE operations SET name = CAST(x'41ff' AS TEXT)").await.unwrap();
    conn.execute("UPDATE tools SET name = CAST(x'41ff' AS TEXT)").await.unwrap();
    let foldable = async || !store.check_tables().await.unwrap().iter().any(StoreFault::may_mislead_wear);
    assert!(foldable().await);
    conn.execute("UPDATE tool_wear SET state = x'00' WHERE tool_id = 'T1'").await.unwrap();
    let folded = store.check_wear(Repair::AllBut(&Doubt::default())).await.unwrap();
    assert!(folded.different.iter().all(|wear| wear.left.is_none()) && !folded.different.is_empty());
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    conn.execute("UPDATE operations SET process = CAST(x'41ff' AS TEXT)").await.unwrap();
    assert!(!foldable().await);
    conn.close().await.unwrap();
    given.done().await;
}

/// Nor does any other text of a token keep a server from starting.
#[tokio::test]
async fn a_damaged_token_is_one_too() {
    let given = Given::sqlite().await;
    let store = given.store();
    assert!(store.create_first_token(token("tok-1"), &admin()).await.unwrap());
    let mut conn = beside(&given).await;
    conn.execute("UPDATE tokens SET machine_id = CAST(x'ff' AS TEXT)").await.unwrap();
    conn.close().await.unwrap();
    assert!(!store.create_first_token(token("tok-2"), &admin()).await.unwrap());
    given.done().await;
}

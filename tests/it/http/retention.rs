//! What retention drops is seen: by whoever reads the cycle, by whoever asks for the decisions, and by Prometheus.

use super::app::{App, operation};
use super::commands::Served;
use crate::store::given::{Run, at, engineer, shop, stored, watched};
use feedwright_core::ids::MachineId;
use feedwright_server::retention;
use feedwright_store::{
    CycleFilter, DropReason, Page, Precondition, Role, SampleRetention, SqliteOptions, SqliteStore, Store,
};
use http::StatusCode;
use serde_json::json;
use sqlx::{ConnectOptions, Connection};
use std::time::Duration;
use tempfile::TempDir;

crate::engines::on_both!(dropped_samples_are_gone_and_say_why_and_the_summary_stays);

const M1: &str = "/v1/machines/M1";

/// A count, which is whole.
async fn metric(app: &App, name: &str) -> u64 {
    let text = String::from_utf8(app.get("/metrics").await.body).unwrap();
    let line = text.lines().find(|line| line.starts_with(&format!("{name} ")));
    line.unwrap_or_else(|| panic!("{name} is not in\n{text}")).rsplit_once(' ').unwrap().1.parse().unwrap()
}

async fn dropped_samples_are_gone_and_say_why_and_the_summary_stays() {
    let app = App::registered().await;
    assert_eq!(app.put("/v1/operations/O1", operation()).await.status, StatusCode::CREATED);
    for number in 1..=3 {
        let cycle = json!({
            "cycle_id": format!("s{number}"), "tool": "T1", "operation": "O1",
            "started_at": format!("2026-05-04T05:0{number}:00Z"),
            "samples": {"period_ms": 10, "spindle_load_percent": vec![20.0; 400]},
        });
        let answer = app.call(Role::Machine, "POST", &format!("{M1}/cycles"), &[], Some(cycle)).await;
        assert_eq!(answer.status, StatusCode::CREATED, "{answer:?}");
    }
    let before = app.get(&format!("{M1}/cycles/s1")).await.json();
    assert_eq!(app.get(&format!("{M1}/cycles/s1/samples")).await.status, StatusCode::OK);
    retention::run(&app.state).await.unwrap();
    assert_eq!(
        metric(&app, "feedwright_sample_drop_cycles_total").await,
        0,
        "nobody said that anything goes"
    );

    let put = app.put(&format!("{M1}/retention"), json!({"samples_bytes": 1})).await;
    assert!(put.status.is_success(), "{put:?}");
    let tag = put.header("etag");
    let place = format!("{M1}/retention");
    let read = async |tag: &str| app.call(Role::Viewer, "GET", &place, &[("if-none-match", tag)], None).await;
    assert_eq!(app.get(&place).await.header("etag"), tag, "the same body");
    assert_eq!(read(tag).await.status, StatusCode::NOT_MODIFIED);
    retention::run(&app.state).await.unwrap();
    let told = read(tag).await;
    assert_eq!(told.status, StatusCode::OK, "more was dropped since: {told:?}");
    assert_ne!(told.header("etag"), tag);
    assert_eq!(read(told.header("etag")).await.status, StatusCode::NOT_MODIFIED);
    // Who changes the limits goes by what was said, which no run changes.
    for tag in [tag, "\"1\""] {
        let same = Some(json!({"samples_bytes": 1}));
        let put = app.call(Role::Engineer, "PUT", &place, &[("if-match", tag)], same).await;
        assert_eq!((put.status, put.header("etag")), (StatusCode::OK, told.header("etag")), "{tag}: {put:?}");
    }
    // PostgreSQL's decisions are made by its own clock.
    let decisions = app.get(&place).await.json();
    let dropped_at = &decisions["dropped"][0]["dropped_at"];
    assert!(dropped_at.is_string(), "{decisions}");
    for number in 1..=3 {
        let gone = app.get(&format!("{M1}/cycles/s{number}/samples")).await;
        assert_eq!((gone.status, gone.code().as_str()), (StatusCode::GONE, "samples_dropped"));
        let course = app.get(&format!("{M1}/cycles/s{number}/course")).await;
        assert_eq!((course.status, course.code().as_str()), (StatusCode::GONE, "samples_dropped"));
        let asked = json!({"control": {}});
        let what_if = app.post(&format!("{M1}/cycles/s{number}/what-if"), asked).await;
        assert_eq!(
            (what_if.status, what_if.code().as_str()),
            (StatusCode::GONE, "samples_dropped"),
            "{what_if:?}"
        );
        let problem = gone.json();
        assert_eq!((&problem["reason"], &problem["dropped_at"]), (&json!("size"), dropped_at));
    }
    let mut after = app.get(&format!("{M1}/cycles/s1")).await.json();
    let seen = after.as_object_mut().unwrap();
    assert_eq!(seen.remove("samples_dropped_at").as_ref(), Some(dropped_at));
    assert_eq!(seen.insert("has_samples".to_owned(), json!(true)), Some(json!(false)));
    assert_eq!(after, before, "the rest of the cycle stays");
    assert_eq!(app.get("/v1/tools/T1/wear").await.json()["cycles"], 3);

    assert_eq!(decisions["samples_bytes"], 1, "{decisions}");
    let drops = decisions["dropped"].as_array().unwrap_or_else(|| panic!("{decisions}"));
    assert_eq!((drops.len(), &drops[0]["reason"], &drops[0]["cycles"]), (1, &json!("size"), &json!(3)));
    let bytes = drops[0]["bytes"].as_u64().unwrap();
    assert!(bytes > 0);
    assert_eq!(metric(&app, "feedwright_sample_drop_cycles_total").await, 3);
    assert_eq!(metric(&app, "feedwright_sample_drop_bytes_total").await, bytes);
    assert_eq!(metric(&app, "feedwright_sample_drop_decisions_total{reason=\"size\"}").await, 1);
    // A cycle that never had samples is another matter.
    let none = json!({"cycle_id": "r1", "tool": "T1", "operation": "O1", "started_at": "2026-05-04T05:10:00Z",
                      "reported": {"energy_joules": 1000.0}});
    let answer = app.call(Role::Machine, "POST", &format!("{M1}/cycles"), &[], Some(none)).await;
    assert_eq!(answer.status, StatusCode::CREATED);
    assert_eq!(app.get(&format!("{M1}/cycles/r1/samples")).await.status, StatusCode::NOT_FOUND);
    // Who computes with samples says of which cycles they are gone.
    let load: Vec<f64> = (0..400).map(|at| f64::from(at) * 0.1).collect();
    let thrust: Vec<f64> = load.iter().map(|load| 50.0 * load).collect();
    let measured = json!({
        "cycle_id": "d1", "tool": "T1", "operation": "O1", "started_at": "2026-05-04T05:20:00Z",
        "samples": {"period_ms": 10, "feed_drive_load_percent": load, "thrust_newtons": thrust},
    });
    let answer = app.call(Role::Machine, "POST", &format!("{M1}/cycles"), &[], Some(measured)).await;
    assert_eq!(answer.status, StatusCode::CREATED, "{answer:?}");
    let skipped = json!({"no_samples": 1, "samples_dropped": 3});
    let fitted = app.post(&format!("{M1}/calibrations/fit"), json!({"dry_run": true})).await.json();
    assert_eq!((&fitted["considered"], &fitted["skipped"]), (&json!(5), &skipped), "{fitted}");
    let asked =
        json!({"filter": {"machine": "M1", "to": "2026-05-04T05:20:00Z"}, "question": {"control": {}}});
    let many = app.post("/v1/what-if", asked).await.json();
    assert_eq!((&many["considered"], &many["skipped"]), (&json!(4), &skipped), "{many}");
}

/// As after months in which no server ran, which looks the same.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_server_that_starts_by_a_clock_far_ahead_drops_nothing_for_its_age() {
    let cell = TempDir::new().unwrap();
    let data = cell.path().join("data");
    std::fs::create_dir(&data).unwrap();
    let file = data.join("feedwright.sqlite3");
    let store = SqliteStore::open(&file, SqliteOptions::default()).await.unwrap();
    shop(&store).await;
    for n in 1..=3 {
        stored(&store, &Run::nth(n)).await;
    }
    let machine: MachineId = "M1".try_into().unwrap();
    // In January.
    store.watch(vec![(machine.clone(), Duration::ZERO)], &watched(), at(3600)).await.unwrap();
    let mut tables =
        sqlx::sqlite::SqliteConnectOptions::new().filename(&file).read_only(true).connect().await.unwrap();
    let bytes: i64 =
        sqlx::query_scalar("SELECT SUM(bytes) FROM cycle_samples").fetch_one(&mut tables).await.unwrap();
    tables.close().await.unwrap();
    // All of them are older than a day.
    let kept = SampleRetention { days: Some(1), bytes: None };
    store.put_retention(&machine, kept, Precondition::Absent, &engineer(), at(3600)).await.unwrap();
    store.close().await;
    assert!(Served::start(&cell, "the clock has leapt ahead").terminate().1);

    // And now the oldest is one too many: that one goes by a whole run.
    let store = SqliteStore::open(&file, SqliteOptions::default()).await.unwrap();
    let kept = SampleRetention { bytes: Some(bytes.unsigned_abs() - 1), ..kept };
    store.put_retention(&machine, kept, Precondition::Version(1), &engineer(), at(3600)).await.unwrap();
    store.close().await;
    let (log, well) = Served::start(&cell, "samples are dropped").terminate();
    assert!(well, "{log}");
    let store = SqliteStore::open(&file, SqliteOptions::default()).await.unwrap();
    // What was decided may not be gone yet.
    let decided = store.sample_drops(&machine).await.unwrap();
    assert_eq!(decided.iter().map(|decision| decision.reason).collect::<Vec<_>>(), [DropReason::Size]);
    let filter = CycleFilter { machine: Some(machine.clone()), ..CycleFilter::default() };
    let cycles = store.cycles(&filter, Page { after: None, limit: 10 }).await.unwrap();
    let gone: Vec<bool> = cycles.iter().map(feedwright_store::StoredCycle::samples_are_gone).collect();
    assert_eq!((gone.len(), &gone[1..]), (3, &[false, false][..]), "{decided:?}");
    store.close().await;
}

/// A supervisor kills what it told to stop half a minute ago.
#[tokio::test]
async fn the_pause_between_two_steps_does_not_hold_the_shutdown_up() {
    let settings = [
        ("retention.interval_ms", "50"),
        ("retention.pause_ms", "60000"),
        ("retention.step_cycles", "1"),
        ("metrics.listen", "127.0.0.1:0"),
    ];
    let served = crate::live::Served::start(&settings).await;
    served.with_a_shop().await;
    for id in ["c1", "c2", "c3"] {
        served.post_cycle(id, 20.0).await;
    }
    served.put(&format!("{M1}/retention"), json!({"samples_bytes": 1})).await;
    let metrics = format!("http://{}/metrics", served.server.metrics_addr.unwrap());
    let begun = async {
        loop {
            let text = served.client.get(&metrics).send().await.unwrap().text().await.unwrap();
            if text.contains("feedwright_sample_drop_cycles_total 1\n") {
                return;
            }
        }
    };
    tokio::time::timeout(Duration::from_secs(20), begun).await.expect("retention begins");
    served.server.shutdown().await.expect("the pause is cut short");
}

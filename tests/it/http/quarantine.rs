//! What could not be accepted: seen, repaired, taken in, discarded.

use super::app::{App, NOW};
use feedwright_core::ids::MachineId;
use feedwright_store::{QuarantineBounds, QuarantineEntry, Role};
use http::StatusCode;
use serde_json::{Value, json};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};
use std::time::Duration;

crate::engines::on_both!(
    an_entry_is_shown_with_its_body_and_discarded_with_a_reason,
    a_repaired_body_is_taken_in_and_one_that_is_still_wrong_stays,
    an_entry_that_another_server_settles_is_left_to_it,
    an_entry_that_may_be_a_part_of_a_cycle_is_not_taken_for_a_whole_one,
);

const BOUNDS: QuarantineBounds = QuarantineBounds { entries: 10, bytes: 1_000_000 };

async fn keep(app: &App, id: &str, body: &[u8]) {
    keep_with(app, id, body, json!({"code": "invalid_content"}).to_string()).await;
}

async fn keep_with(app: &App, id: &str, body: &[u8], problem: String) {
    let entry = QuarantineEntry {
        id: id.to_owned(),
        machine: MachineId::try_from("M1").unwrap(),
        cycle: Some("c-1".to_owned()),
        received_at: NOW,
        code: "not_finite".to_owned(),
        problem,
        content_type: "application/json".to_owned(),
        settled: None,
        size: body.len() as u64,
    };
    app.state.store.quarantine(entry, body.to_vec(), BOUNDS).await.unwrap();
}

async fn settle(app: &App, id: &str, body: Value) -> super::app::Answer {
    app.post(&format!("/v1/quarantine/{id}"), body).await
}

async fn an_entry_is_shown_with_its_body_and_discarded_with_a_reason() {
    let app = App::registered().await;
    keep(&app, "q1", b"{\"cycle_id\": \"c-1\", \"x\": 1e999}").await;
    keep(&app, "q2", &[0xff, 0x00]).await;
    let listed = app.get("/v1/quarantine?machine=M1").await.json();
    assert_eq!(listed["items"].as_array().unwrap().len(), 2, "{listed}");
    assert_eq!(listed["items"][0]["problem"]["code"], "invalid_content");
    let one = app.get("/v1/quarantine/q1").await.json();
    assert_eq!(
        (one["body"].as_str(), one["cycle_id"].as_str()),
        (Some("{\"cycle_id\": \"c-1\", \"x\": 1e999}"), Some("c-1"))
    );
    let two = app.get("/v1/quarantine/q2").await.json();
    assert_eq!((two["body"].clone(), two["body_base64"].as_str()), (Value::Null, Some("/wA=")));

    let errors = settle(&app, "q1", json!({"action": "discard", "reason": " "})).await.errors();
    assert_eq!(errors, [("reason".to_owned(), "invalid_length".to_owned())]);
    let errors = settle(&app, "q1", json!({"action": "discard", "reason": "x", "body": "{}"})).await.errors();
    assert_eq!(errors, [("body".to_owned(), "body_not_used".to_owned())]);
    let settled = settle(&app, "q1", json!({"action": "discard", "reason": "test cut"})).await;
    assert_eq!(settled.json()["how"], "discarded: test cut", "{settled:?}");
    let again = settle(&app, "q1", json!({"action": "discard", "reason": "test cut"})).await;
    assert_eq!((again.status, again.code().as_str()), (StatusCode::CONFLICT, "already_settled"));
    assert_eq!(app.get("/v1/quarantine").await.json()["items"].as_array().unwrap().len(), 1);
    assert_eq!(app.get("/v1/quarantine?open=false").await.json()["items"].as_array().unwrap().len(), 2);
    assert_eq!(app.get("/v1/quarantine/q9").await.status, StatusCode::NOT_FOUND);
    assert_eq!(
        settle(&app, "q9", json!({"action": "discard", "reason": "x"})).await.status,
        StatusCode::NOT_FOUND
    );
    let audit = String::from_utf8(app.get("/v1/audit?limit=1000").await.body).unwrap();
    assert!(audit.contains("test cut"), "{audit}");
}

async fn an_entry_that_another_server_settles_is_left_to_it() {
    let app = App::registered().await;
    keep(&app, "q1", b"{}").await;
    let claim = async |holder: &str| {
        app.state.store.claim_quarantine("q1", holder, Duration::from_secs(60), NOW).await.unwrap()
    };
    assert!(claim("another").await);
    let repair = json!({"cycle_id": "c-1", "tool": "T1", "operation": "O1", "started_at": "2026-05-04T05:59:00Z",
                        "reported": {"energy_joules": 5, "duration_ms": 4000}});
    let repaired = json!({"action": "reingest", "reason": "as it was", "body": repair.to_string()});
    let busy = settle(&app, "q1", repaired.clone()).await;
    assert_eq!((busy.status, busy.code().as_str()), (StatusCode::SERVICE_UNAVAILABLE, "settling"));
    assert_eq!(
        app.get("/v1/machines/M1/cycles/c-1").await.status,
        StatusCode::NOT_FOUND,
        "nothing is stored"
    );
    app.state.store.release_quarantine("q1", "another").await.unwrap();
    // What is refused claims it no longer.
    let refused = settle(&app, "q1", json!({"action": "reingest", "reason": "again"})).await;
    assert_eq!(refused.status, StatusCode::UNPROCESSABLE_ENTITY, "{refused:?}");
    assert!(claim("another").await);
    app.state.store.release_quarantine("q1", "another").await.unwrap();
    assert_eq!(settle(&app, "q1", repaired).await.status, StatusCode::OK);
}

/// Its problem alone says that it is one, and a disk has damaged that.
async fn an_entry_that_may_be_a_part_of_a_cycle_is_not_taken_for_a_whole_one() {
    let app = App::registered().await;
    let cycle = json!({"cycle_id": "c-1", "tool": "T1", "operation": "O1", "started_at": "2026-05-04T05:59:00Z",
                       "reported": {"energy_joules": 5, "duration_ms": 4000}});
    keep_with(&app, "q1", cycle.to_string().as_bytes(), "{\"cut_short\": true".to_owned()).await;
    for body in [None, Some(cycle.to_string())] {
        let taken = json!({"action": "reingest", "reason": "again", "body": body});
        let refused = settle(&app, "q1", taken).await;
        assert_eq!((refused.status, refused.code().as_str()), (StatusCode::CONFLICT, "body_damaged"));
    }
    assert_eq!(app.get("/v1/machines/M1/cycles/c-1").await.status, StatusCode::NOT_FOUND);
    let discarded = settle(&app, "q1", json!({"action": "discard", "reason": "damaged"})).await;
    assert_eq!(discarded.status, StatusCode::OK, "{discarded:?}");
}

async fn a_repaired_body_is_taken_in_and_one_that_is_still_wrong_stays() {
    let app = App::registered().await;
    let cycle = |energy: Value| {
        json!({"cycle_id": "c-1", "tool": "T1", "operation": "O1", "started_at": "2026-05-04T05:59:00Z",
               "reported": {"energy_joules": energy, "duration_ms": 4000}})
        .to_string()
    };
    keep(&app, "q1", cycle(json!("many")).as_bytes()).await;
    let refused = settle(&app, "q1", json!({"action": "reingest", "reason": "again"})).await;
    assert_eq!(refused.status, StatusCode::UNPROCESSABLE_ENTITY, "{refused:?}");
    assert_eq!(refused.errors()[0].0, "reported.energy_joules");
    assert_eq!(
        app.get("/v1/quarantine").await.json()["items"].as_array().unwrap().len(),
        1,
        "it stays, once"
    );
    // What stays in quarantine was not refused and left to its sender.
    let metrics = String::from_utf8(app.get("/metrics").await.body).unwrap();
    let lost = metrics.lines().filter(|line| line.starts_with("feedwright_cycles_rejected_total{"));
    assert!(lost.clone().count() > 5 && lost.clone().all(|line| line.ends_with("} 0")), "{metrics}");

    let repaired = json!({"action": "reingest", "reason": "unit was text", "body": cycle(json!(5000.0))});
    let settled = settle(&app, "q1", repaired).await;
    assert_eq!(settled.status, StatusCode::OK, "{settled:?}");
    assert_eq!(settled.json()["how"], "repaired and re-ingested as cycle c-1 of tool T1: unit was text");
    assert!(settled.json()["answer"].is_object());
    let stored = app.call(Role::Viewer, "GET", "/v1/machines/M1/cycles/c-1", &[], None).await;
    assert_eq!(stored.status, StatusCode::OK, "{stored:?}");
    assert!(app.get("/v1/quarantine").await.json()["items"].as_array().unwrap().is_empty());
}

/// What the server takes, the database takes too; where that is not so, the machine may forget the cycle all the same.
#[tokio::test]
async fn what_the_database_refuses_is_kept_in_quarantine() {
    let app = App::registered().await;
    let file = app.state.config.data_dir.join("feedwright.sqlite3");
    let mut conn = SqliteConnectOptions::new().filename(file).connect().await.unwrap();
    let refuses = "CREATE TRIGGER refuses BEFORE INSERT ON cycles WHEN NEW.cycle_id = 'c-2'
                   BEGIN SELECT RAISE(ABORT, 'not this one'); END";
    sqlx::raw_sql(refuses).execute(&mut conn).await.unwrap();
    conn.close().await.unwrap();
    for (id, status) in [
        ("c-1", StatusCode::CREATED),
        ("c-2", StatusCode::UNPROCESSABLE_ENTITY),
        ("c-3", StatusCode::CREATED),
    ] {
        let cycle = json!({"cycle_id": id, "tool": "T1", "operation": "O1", "started_at": "2026-05-04T05:00:00Z",
                           "reported": {"energy_joules": 1000.0}});
        let answer =
            app.call(Role::Machine, "POST", "/v1/machines/M1/cycles", &[], Some(cycle.clone())).await;
        assert_eq!(answer.status, status, "{id}: {answer:?}");
        if status == StatusCode::UNPROCESSABLE_ENTITY {
            assert_eq!(answer.code(), "refused_by_database");
            let entry = answer.json()["quarantine_id"].as_str().unwrap().to_owned();
            let kept = app.get(&format!("/v1/quarantine/{entry}")).await.json();
            assert_eq!(kept["cycle_id"], "c-2");
            let body: Value = serde_json::from_str(kept["body"].as_str().unwrap()).unwrap();
            assert_eq!(body, cycle);
        }
    }
}

async fn change(app: &App, statement: &'static str) {
    let file = app.state.config.data_dir.join("feedwright.sqlite3");
    let mut conn = SqliteConnectOptions::new().filename(file).connect().await.unwrap();
    assert_eq!(sqlx::raw_sql(statement).execute(&mut conn).await.unwrap().rows_affected(), 1);
    conn.close().await.unwrap();
}

/// A body in which a bit has turned is still a body: taken in, it would be what no machine has measured.
#[tokio::test]
async fn a_body_that_is_not_what_came_is_told_and_never_taken_in() {
    let app = App::registered().await;
    let body = json!({"cycle_id": "c-1", "tool": "T1", "operation": "O1", "started_at": "2026-05-04T05:00:00Z",
                      "reported": {"energy_joules": 1000.0}});
    for id in ["q1", "q2"] {
        keep(&app, id, format!("{body}{id}").as_bytes()).await;
    }
    assert_eq!(app.state.store.check_tables().await.unwrap(), []);
    change(&app, "UPDATE quarantine SET body_hash = zeroblob(32) WHERE quarantine_id = 'q1'").await;
    change(&app, "UPDATE quarantine SET body = x'00' WHERE quarantine_id = 'q2'").await;
    let faults = app.state.store.check_tables().await.unwrap();
    let named: Vec<_> = faults.iter().map(|fault| (fault.kind, fault.key.as_str())).collect();
    assert_eq!(named, [("quarantine", "q1"), ("quarantine", "q2")]);
    change(&app, "UPDATE quarantine SET size = 1 << 39 WHERE quarantine_id = 'q1'").await;
    for id in ["q1", "q2"] {
        let told = app.get(&format!("/v1/quarantine/{id}")).await.json();
        assert_eq!(
            (&told["body_damaged"], &told["body"], &told["body_base64"]),
            (&json!(true), &json!(null), &json!(null))
        );
        let refused = settle(&app, id, json!({"action": "reingest", "reason": "again"})).await;
        assert_eq!((refused.status, refused.code()), (StatusCode::CONFLICT, "body_damaged".to_owned()));
    }
    assert_eq!(app.get("/v1/machines/M1/cycles/c-1").await.status, StatusCode::NOT_FOUND);
    // Sent again it may be forgotten by its machine: it is whole now.
    keep(&app, "q3", format!("{body}q2").as_bytes()).await;
    let told = app.get("/v1/quarantine/q2").await.json();
    assert_eq!((&told["body_damaged"], told["body"].as_str()), (&json!(false), Some(&*format!("{body}q2"))));
    let repaired = json!({"action": "reingest", "reason": "from the control", "body": body.to_string()});
    assert_eq!(settle(&app, "q1", repaired).await.status, StatusCode::OK);
    assert_eq!(
        settle(&app, "q2", json!({"action": "discard", "reason": "lost"})).await.status,
        StatusCode::OK
    );
    assert_eq!(app.get("/v1/machines/M1/cycles/c-1").await.status, StatusCode::OK);
}

#[tokio::test]
async fn of_repairs_that_come_together_one_is_stored() {
    let app = App::registered().await;
    keep(&app, "q1", b"{}").await;
    let repairs = (1..=4).map(|number| {
        let body = json!({"cycle_id": format!("c-{number}"), "tool": "T1", "operation": "O1",
                          "started_at": "2026-05-04T05:00:00Z", "reported": {"energy_joules": 1000.0}});
        settle(&app, "q1", json!({"action": "reingest", "reason": "by hand", "body": body.to_string()}))
    });
    let answers = futures_util::future::join_all(repairs).await;
    let settled = answers.iter().filter(|answer| answer.status == StatusCode::OK).count();
    assert_eq!(settled, 1, "{answers:?}");
    assert!(
        answers.iter().all(|answer| answer.status == StatusCode::OK || answer.code() == "already_settled")
    );
    let stored = app.get("/v1/cycles?machine=M1").await.json();
    assert_eq!(stored["items"].as_array().unwrap().len(), 1, "{stored}");
}

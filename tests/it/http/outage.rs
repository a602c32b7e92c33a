//! A PostgreSQL that is away: who watches the service is told so, and nobody is let in who would not be otherwise.

use super::listening::Listening;
use crate::store::operations::{Cluster, Frozen};
use feedwright_store::{PostgresOptions, PostgresStore, Repair, Store};
use serde_json::{Value, json};
use sqlx::{Connection, Executor, PgConnection};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Prometheus waits no longer for an answer.
const SCRAPE: Duration = Duration::from_secs(10);
/// Scrapes until something has to be seen, and the time between them.
const LOOKS: usize = 100;
const BETWEEN: Duration = Duration::from_millis(100);

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn prometheus_is_told_that_the_database_is_away() {
    let Some(cluster) = Cluster::new() else {
        return;
    };
    let store = PostgresStore::open(&cluster.url(), PostgresOptions::default()).await.unwrap();
    let Listening { server, address, client, admin, dir: _dir } = Listening::before(Arc::new(store)).await;
    let token = async |name: &str, role: &str| {
        let made = client.post(format!("{address}/v1/tokens")).bearer_auth(&admin);
        let body = match role {
            "machine" => json!({"name": name, "role": role, "machine": "M1"}),
            _ => json!({"name": name, "role": role}),
        };
        let made = made.json(&body).send().await.unwrap();
        assert_eq!(made.status().as_u16(), 201);
        let made: Value = made.json().await.unwrap();
        (made["id"].as_str().unwrap().to_owned(), made["token"].as_str().unwrap().to_owned())
    };
    let get = async |path: &str, token: &str| {
        let begun = Instant::now();
        let answer = client.get(format!("{address}{path}")).bearer_auth(token).send().await.unwrap();
        let (status, text) = (answer.status().as_u16(), answer.text().await.unwrap());
        assert!(begun.elapsed() < SCRAPE, "{path} took {:?}", begun.elapsed());
        let ready = text.lines().find_map(|line| line.strip_prefix("feedwright_ready ")).map(str::to_owned);
        (status, ready)
    };
    let until = async |token: &str, wanted: &str| {
        for _ in 0..LOOKS {
            let (status, ready) = get("/metrics", token).await;
            assert_eq!(status, 200, "every scrape is answered");
            if ready.as_deref() == Some(wanted) {
                return;
            }
            tokio::time::sleep(BETWEEN).await;
        }
        panic!("feedwright_ready is never {wanted}");
    };

    let (_, prometheus) = token("prometheus", "viewer").await;
    let (id, revoked) = token("old prometheus", "viewer").await;
    let (_, of_machine) = token("M1", "machine").await;
    let (_, unseen) = token("never used", "viewer").await;
    assert_eq!((get("/metrics", &revoked).await.0, get("/metrics", &prometheus).await.0), (200, 200));
    let gone = client.delete(format!("{address}/v1/tokens/{id}")).bearer_auth(&admin).send().await.unwrap();
    assert!(gone.status().is_success(), "{}", gone.status());
    // Its last scrape was before the revocation of another token.
    assert_eq!(get("/metrics", &of_machine).await.0, 403);

    cluster.control(&["stop"]);
    until(&prometheus, "0").await;
    // No other route believes it, and this one nobody else.
    assert_eq!(get("/v1/machines", &prometheus).await.0, 503);
    for (whose, token) in [("revoked", &revoked), ("never looked up", &unseen)] {
        assert_eq!(get("/metrics", token).await.0, 503, "{whose}");
    }
    assert_eq!(get("/metrics", &of_machine).await.0, 403, "its role may not");
    assert_eq!(get("/metrics", &prometheus).await, (200, Some("0".to_owned())));

    cluster.control(&["start"]);
    until(&prometheus, "1").await;
    assert_eq!((get("/metrics", &unseen).await.0, get("/metrics", &revoked).await.0), (200, 401));
    server.shutdown().await.unwrap();
}

/// How long a control waits for an answer to a post: five seconds, and something for a machine that is busy.
const CONTROL: Duration = Duration::from_secs(8);

fn cycle(number: usize) -> Value {
    json!({
        "cycle_id": format!("c{number}"), "tool": "T1", "operation": "O1",
        "started_at": format!("2026-05-04T05:{:02}:{:02}Z", number / 60, number % 60),
        "samples": {"period_ms": 10, "spindle_load_percent": vec![20.0 + number as f64; 200]},
    })
}

/// Cycles of a batch that is under way, of several windows.
const BATCH: std::ops::Range<usize> = 10..210;
/// Lines of a batch that are under way at once.
const WINDOW: usize = 64;

/// What happens to the server of the database.
enum Away {
    Stopped,
    Frozen,
}

/// Posts are under way when the database goes, and come again when it is back.
async fn posts_are_answered_while_it_is(away: Away) {
    let Some(cluster) = Cluster::new() else {
        return;
    };
    let store = Arc::new(PostgresStore::open(&cluster.url(), PostgresOptions::default()).await.unwrap());
    let Listening { server, address, client, admin, dir: _dir } = Listening::before(store.clone()).await;
    let post = |number: usize| {
        let post = client.post(format!("{address}/v1/machines/M1/cycles")).bearer_auth(&admin);
        let post = post.json(&cycle(number)).send();
        tokio::spawn(async move { post.await.expect("an answer before the control has lost its patience") })
    };
    assert_eq!(post(0).await.unwrap().status().as_u16(), 201);

    // One waits within its transaction, and one for the group after it.
    let mut holder = PgConnection::connect(&cluster.url()).await.unwrap();
    holder.execute("BEGIN; LOCK TABLE cycles IN ACCESS EXCLUSIVE MODE").await.unwrap();
    let first = post(1);
    cluster.one_waits_for_a_lock().await;
    let second = post(2);
    let until = async |wanted: &str| {
        for _ in 0..LOOKS {
            let scrape = client.get(format!("{address}/metrics")).bearer_auth(&admin).send().await.unwrap();
            if scrape.text().await.unwrap().lines().any(|line| line == wanted) {
                return;
            }
            tokio::time::sleep(BETWEEN).await;
        }
        panic!("never {wanted}");
    };
    until("feedwright_ingest_queue_depth 1").await;
    let batch = {
        // One is no cycle, which is told without the database.
        let line = |number| if number == BATCH.start { "{".to_owned() } else { cycle(number).to_string() };
        let lines: Vec<_> = BATCH.map(line).collect();
        let batch = client.post(format!("{address}/v1/machines/M1/cycles/batch")).bearer_auth(&admin);
        let batch = batch.header("content-type", "application/x-ndjson").body(lines.join("\n")).send();
        tokio::spawn(async move { batch.await.expect("an answer before the control has lost its patience") })
    };
    until(&format!("feedwright_ingest_queue_depth {WINDOW}")).await;

    let gone = Instant::now();
    let frozen: Option<Frozen> = match away {
        Away::Stopped => {
            cluster.control(&["stop"]);
            None
        }
        Away::Frozen => Some(cluster.frozen().await),
    };
    for (number, under_way) in [(1, first), (2, second)] {
        let answer = under_way.await.unwrap();
        // Who holds the table may be ended just before who waits for it, which is committed then.
        if !(frozen.is_none() && answer.status().as_u16() == 201) {
            assert_eq!(answer.status().as_u16(), 503, "{number}");
            assert!(answer.headers().contains_key("retry-after"), "{number}");
        }
        assert!(gone.elapsed() < CONTROL, "{number} was answered after {:?}", gone.elapsed());
    }
    let outcomes = batch.await.unwrap().text().await.unwrap();
    assert!(gone.elapsed() < CONTROL, "the batch was answered after {:?}", gone.elapsed());
    let outcomes: Vec<Value> = outcomes.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(outcomes.len(), BATCH.len());
    assert_eq!(outcomes[0]["status"], 400);
    assert!(outcomes[1..].iter().all(|outcome| outcome["status"] == 503), "{outcomes:?}");
    let begun = Instant::now();
    let refused = post(3).await.unwrap();
    assert_eq!(refused.status().as_u16(), 503);
    assert!(refused.headers().contains_key("retry-after"));
    assert!(begun.elapsed() < CONTROL, "{:?}", begun.elapsed());

    match frozen {
        Some(frozen) => drop(frozen),
        None => cluster.control(&["start"]),
    }
    drop(holder);
    // Each is sent until it is acknowledged, as by a machine's buffer; what was committed after all is known.
    for number in (0..=3).chain(BATCH) {
        let mut status = 503;
        for _ in 0..LOOKS {
            status = post(number).await.unwrap().status().as_u16();
            if status != 503 {
                break;
            }
            tokio::time::sleep(BETWEEN).await;
        }
        assert!(matches!((number, status), (0, 200) | (1.., 200 | 201)), "c{number}: {status}");
    }
    let all = client.get(format!("{address}/v1/cycles?machine=M1&limit=1000")).bearer_auth(&admin);
    let all: Value = all.send().await.unwrap().json().await.unwrap();
    assert_eq!(all["items"].as_array().unwrap().len(), 4 + BATCH.len(), "each once");
    // Told once, also of those whose commit came when nobody waited for it any more.
    until(&format!("feedwright_cycles_total{{outcome=\"accepted\"}} {}", 4 + BATCH.len())).await;
    let wear = store.check_wear(Repair::No).await.unwrap();
    assert_eq!((wear.rows, wear.different), (1, vec![]));
    server.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_control_is_answered_in_time_while_the_database_is_stopped() {
    posts_are_answered_while_it_is(Away::Stopped).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_control_is_answered_in_time_while_the_database_stands_still() {
    posts_are_answered_while_it_is(Away::Frozen).await;
}

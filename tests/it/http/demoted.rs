//! A PostgreSQL that is demoted to read-only under a running server, and promoted again.

use super::listening::Listening;
use crate::store::operations::Cluster;
use feedwright_store::{PostgresOptions, PostgresStore};
use serde_json::{Value, json};
use sqlx::{Connection, Executor, PgConnection};
use std::sync::Arc;
use std::time::Duration;

/// Looks that are taken, and the time between them: what is waited for comes with a reload and with the next probe.
const LOOKS: usize = 300;
const BETWEEN: Duration = Duration::from_millis(50);

fn cycle(number: usize) -> Value {
    json!({
        "cycle_id": format!("c{number}"), "tool": "T1", "operation": "O1",
        "started_at": format!("2026-05-04T05:{:02}:{:02}Z", number / 60, number % 60),
        "reported": {"energy_joules": 1000.0},
    })
}

/// Somebody has commits no longer wait for the disk, takes the role's rights away, or does not let it in any more.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_taken_away_under_a_running_server_is_told_and_taken_up_again() {
    let Some(cluster) = Cluster::new() else {
        return;
    };
    let mut admin = PgConnection::connect(&cluster.url()).await.unwrap();
    admin.execute("CREATE ROLE plain LOGIN; GRANT ALL ON SCHEMA public TO plain").await.unwrap();
    let options = PostgresOptions { patience: Duration::from_secs(1), ..PostgresOptions::default() };
    let store = PostgresStore::open(&cluster.url().replace("feedwright@", "plain@"), options).await.unwrap();
    let Listening { server, address, client, admin: token, dir: _dir } =
        Listening::before(Arc::new(store)).await;
    let post = async |number: usize| {
        let post = client.post(format!("{address}/v1/machines/M1/cycles")).bearer_auth(&token);
        let answer = post.json(&cycle(number)).send().await.unwrap();
        (answer.status().as_u16(), answer.headers().contains_key("retry-after"))
    };
    let ready = async || client.get(format!("{address}/readyz")).send().await.unwrap().status().as_u16();
    assert_eq!((post(0).await.0, ready().await), (201, 200));
    let changes = [
        (
            "ALTER SYSTEM SET synchronous_commit = off; SELECT pg_reload_conf()",
            "ALTER SYSTEM RESET synchronous_commit; SELECT pg_reload_conf()",
        ),
        ("REVOKE INSERT ON cycles FROM plain", "GRANT INSERT ON cycles TO plain"),
        (
            "ALTER TABLE tool_wear ENABLE ROW LEVEL SECURITY; ALTER TABLE tool_wear FORCE ROW LEVEL SECURITY",
            "ALTER TABLE tool_wear NO FORCE ROW LEVEL SECURITY; ALTER TABLE tool_wear DISABLE ROW LEVEL SECURITY",
        ),
        (
            "ALTER ROLE plain NOLOGIN;
             SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE usename = 'plain'",
            "ALTER ROLE plain LOGIN",
        ),
    ];
    let mut stored = 1;
    for (away, back) in changes {
        for statement in away.split(';') {
            admin.execute(sqlx::AssertSqlSafe(statement)).await.unwrap();
        }
        let mut looks = 0;
        loop {
            let (status, retry) = post(stored).await;
            match status {
                // Until it has reached every session.
                // 200 where it was stored, and the answer of before was lost.
                200 | 201 => stored += 1,
                _ => assert_eq!((status, retry), (503, true), "{away}"),
            }
            if status == 503 && ready().await == 503 {
                break;
            }
            looks += 1;
            assert!(looks < LOOKS, "it is never told: {away}");
            tokio::time::sleep(BETWEEN).await;
        }
        for statement in back.split(';') {
            admin.execute(sqlx::AssertSqlSafe(statement)).await.unwrap();
        }
        let mut looks = 0;
        while !matches!(post(stored).await.0, 200 | 201) || ready().await != 200 {
            looks += 1;
            assert!(looks < LOOKS, "it never takes writes again: {back}");
            tokio::time::sleep(BETWEEN).await;
        }
        stored += 1;
    }
    let wear = client.get(format!("{address}/v1/tools/T1/wear")).bearer_auth(&token).send().await.unwrap();
    assert_eq!(wear.json::<Value>().await.unwrap()["cycles"], stored, "each is counted once");
    server.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn it_is_refused_clearly_and_taken_up_again() {
    let Some(cluster) = Cluster::new() else {
        return;
    };
    let options = PostgresOptions { patience: Duration::from_secs(1), ..PostgresOptions::default() };
    let store = PostgresStore::open(&cluster.url(), options).await.unwrap();
    let Listening { server, address, client, admin: token, dir: _dir } =
        Listening::before(Arc::new(store)).await;
    let post = async |number: usize| {
        let post = client.post(format!("{address}/v1/machines/M1/cycles")).bearer_auth(&token);
        let answer = post.json(&cycle(number)).send().await.unwrap();
        let retry = answer.headers().get("retry-after").map(|value| value.to_str().unwrap().to_owned());
        (answer.status().as_u16(), retry, answer.json::<Value>().await.unwrap())
    };
    let ready = async || client.get(format!("{address}/readyz")).send().await.unwrap().status().as_u16();
    assert_eq!((post(1).await.0, ready().await), (201, 200));

    cluster.run("ALTER SYSTEM SET default_transaction_read_only = on").await;
    cluster.run("SELECT pg_reload_conf()").await;
    let mut acknowledged = vec![1];
    let mut refused = None;
    for number in 2..LOOKS {
        // Until the reload has reached every session, a cycle may still be stored: then it has to be there.
        let answer = post(number).await;
        if answer.0 == 201 {
            acknowledged.push(number);
            tokio::time::sleep(BETWEEN).await;
            continue;
        }
        refused = Some((number, answer));
        break;
    }
    let (number, (status, retry, problem)) = refused.expect("the reload arrives");
    assert_eq!((status, &problem["status"]), (503, &json!(503)), "{problem}");
    assert!(retry.is_some_and(|seconds| seconds.parse::<u32>().is_ok()), "{problem}");
    assert!(problem["quarantine_id"].is_null(), "its machine has to keep its copy: {problem}");
    assert!(!problem["detail"].as_str().unwrap().is_empty() && !problem.to_string().contains("postgres://"));
    let mut looks = 0;
    while ready().await != 503 {
        looks += 1;
        assert!(looks < LOOKS, "it never says that it is not ready");
        tokio::time::sleep(BETWEEN).await;
    }
    assert_eq!(post(number).await.0, 503, "still");
    let alive = client.get(format!("{address}/healthz")).send().await.unwrap();
    assert_eq!(alive.status().as_u16(), 200, "waiting for its database is no reason to be killed");

    let mut admin = PgConnection::connect(&cluster.url()).await.unwrap();
    admin.execute("SET default_transaction_read_only = off").await.unwrap();
    admin.execute("ALTER SYSTEM RESET default_transaction_read_only").await.unwrap();
    admin.execute("SELECT pg_reload_conf()").await.unwrap();
    let mut looks = 0;
    loop {
        let (status, _, body) = post(number).await;
        if status == 201 {
            break;
        }
        assert_eq!(status, 503, "new, since nothing was stored meanwhile: {body}");
        looks += 1;
        assert!(looks < LOOKS, "it never takes writes again: {body}");
        tokio::time::sleep(BETWEEN).await;
    }
    acknowledged.push(number);
    let mut looks = 0;
    while ready().await != 200 {
        looks += 1;
        assert!(looks < LOOKS, "it never says that it is ready again");
        tokio::time::sleep(BETWEEN).await;
    }
    for number in &acknowledged {
        assert_eq!(post(*number).await.0, 200, "c{number} is known");
    }
    let wear = client.get(format!("{address}/v1/tools/T1/wear")).bearer_auth(&token).send().await.unwrap();
    assert_eq!(wear.json::<Value>().await.unwrap()["cycles"], acknowledged.len(), "each is counted once");
    server.shutdown().await.unwrap();
}

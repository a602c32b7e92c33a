//! However many wait for long reads, a machine's post is answered, also by a token that was not looked at lately; and who reads is
//! told the truth. PostgreSQL's; of SQLite the store's own tests hold it (`service/store/src/sqlite/lane_tests.rs`).

use super::listening::Listening;
use crate::store::Given;
use serde_json::{Value, json};
use sqlx::{Connection, PgConnection};

/// Who asks at once.
const ASKING: usize = 16;
/// As many of them hold a connection, of eight.
const HELD: i64 = 5;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_post_is_answered_however_many_lives_are_read() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let Listening { server, address, client, admin, dir: _dir } = Listening::before(given.store()).await;
    let post = async |token: &str, number: usize| {
        let cycle = json!({
            "cycle_id": format!("c{number}"), "tool": "T1", "operation": "O1",
            "started_at": format!("2026-05-04T05:00:{number:02}Z"),
            "reported": {"energy_joules": 1000.0},
        });
        let post = client.post(format!("{address}/v1/machines/M1/cycles")).bearer_auth(token).json(&cycle);
        post.send().await.unwrap().status().as_u16()
    };
    assert_eq!(post(&admin, 1).await, 201);
    let token = json!({"name": "the adapter", "role": "machine", "machine": "M1"});
    let made = client.post(format!("{address}/v1/tokens")).bearer_auth(&admin).json(&token).send().await;
    let made: Value = made.unwrap().json().await.unwrap();
    let adapter = made["token"].as_str().unwrap().to_owned();

    // Lives are read as far as this table.
    let mut holding = PgConnection::connect(&given.address()).await.unwrap();
    let mut held = holding.begin().await.unwrap();
    sqlx::query("LOCK TABLE tool_wear_checkpoints IN ACCESS EXCLUSIVE MODE")
        .execute(&mut *held)
        .await
        .unwrap();
    let reads: Vec<_> = (0..ASKING)
        .map(|_| {
            let read = client.get(format!("{address}/v1/tools/T1/life?last=1")).bearer_auth(&admin).send();
            tokio::spawn(async move {
                let answer = read.await.unwrap();
                (answer.status().as_u16(), answer.json::<Value>().await.unwrap())
            })
        })
        .collect();
    let waiting =
        "SELECT COUNT(*) FROM pg_locks WHERE NOT granted AND relation = 'tool_wear_checkpoints'::regclass";
    while sqlx::query_scalar::<_, i64>(waiting).fetch_one(&mut *held).await.unwrap() < HELD {
        tokio::task::yield_now().await;
    }
    assert_eq!(post(&adapter, 2).await, 201);
    let got = client.get(format!("{address}/v1/machines/M1")).bearer_auth(&adapter).send().await.unwrap();
    assert_eq!(got.status().as_u16(), 200);
    // The others have no turn as long as these are held.
    let most = usize::try_from(HELD).unwrap();
    while reads.iter().filter(|read| read.is_finished()).count() < ASKING - most {
        tokio::task::yield_now().await;
    }
    assert_eq!(post(&adapter, 3).await, 201);
    held.rollback().await.unwrap();
    let mut refused = 0;
    for read in reads {
        let (status, body) = read.await.unwrap();
        if status == 503 {
            assert_eq!(body["code"], "too_many_reads", "{body}");
            refused += 1;
        } else {
            assert_eq!(status, 200, "{body}");
        }
    }
    assert_eq!(refused, ASKING - most);
    server.shutdown().await.unwrap();
    drop(holding);
    given.removed().await;
}

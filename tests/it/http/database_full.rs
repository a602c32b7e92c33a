//! A PostgreSQL whose disk is full undoes the change and goes on once there is room, and so does the service. Its server
//! says so here as it does then (SQLSTATE 53100, `disk_full`), from a trigger.

use super::listening::Listening;
use crate::store::operations::Cluster;
use feedwright_store::{PostgresOptions, PostgresStore};
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;

/// Looks that are taken, and the time between them: what is waited for comes with the next probe.
const LOOKS: usize = 300;
const BETWEEN: Duration = Duration::from_millis(50);

fn cycle(number: usize) -> Value {
    json!({
        "cycle_id": format!("c{number}"), "tool": "T1", "operation": "O1",
        "started_at": format!("2026-05-04T05:00:{number:02}Z"),
        "reported": {"energy_joules": 1000.0},
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn it_is_told_and_the_service_goes_on_once_there_is_room() {
    let Some(cluster) = Cluster::new() else {
        return;
    };
    let store = PostgresStore::open(&cluster.url(), PostgresOptions::default()).await.unwrap();
    let Listening { server, address, client, admin, dir: _dir } = Listening::before(Arc::new(store)).await;
    let post = async |number: usize| {
        let post = client.post(format!("{address}/v1/machines/M1/cycles")).bearer_auth(&admin);
        post.json(&cycle(number)).send().await.unwrap()
    };
    let ready = async |wanted: u16| {
        for _ in 0..LOOKS {
            if client.get(format!("{address}/readyz")).send().await.unwrap().status().as_u16() == wanted {
                return;
            }
            tokio::time::sleep(BETWEEN).await;
        }
        panic!("/readyz is never {wanted}");
    };
    assert_eq!(post(1).await.status().as_u16(), 201);

    cluster
        .run(
            "CREATE FUNCTION full_disk() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
                 RAISE EXCEPTION 'could not extend file: No space left on device' USING ERRCODE = 'disk_full';
             END $$;
             CREATE TRIGGER full_disk BEFORE INSERT ON cycles EXECUTE FUNCTION full_disk()",
        )
        .await;
    for number in [2, 3] {
        let refused = post(number).await;
        assert_eq!(refused.status().as_u16(), 503);
        assert!(refused.headers().contains_key("retry-after"));
        assert_eq!(refused.json::<Value>().await.unwrap()["code"], "database_unavailable");
    }
    ready(503).await;
    let read = client.get(format!("{address}/v1/machines/M1/cycles/c1")).bearer_auth(&admin);
    assert_eq!(read.send().await.unwrap().status().as_u16(), 200, "what is there is read");

    cluster.run("DROP TRIGGER full_disk ON cycles").await;
    assert_eq!((post(2).await.status().as_u16(), post(1).await.status().as_u16()), (201, 200));
    ready(200).await;
    let all = client.get(format!("{address}/v1/cycles?machine=M1")).bearer_auth(&admin).send().await.unwrap();
    assert_eq!(all.json::<Value>().await.unwrap()["items"].as_array().unwrap().len(), 2);
    server.shutdown().await.unwrap();
}

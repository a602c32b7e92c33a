//! A PostgreSQL that is away: who watches the service is told so, and nobody is let in who would not be otherwise.

use super::app::{NOW, machine};
use crate::store::operations::Cluster;
use feedwright_server::clock::Clock;
use feedwright_server::config::{Config, Sources};
use feedwright_server::server::Server;
use feedwright_store::{PostgresOptions, PostgresStore};
use secrecy::ExposeSecret;
use serde_json::{Value, json};
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
    let dir = tempfile::tempdir().unwrap();
    let flags = [("data_dir", dir.path().to_str().unwrap()), ("server.listen", "127.0.0.1:0")];
    let flags = flags.map(|(name, value)| (name.to_owned(), value.to_owned())).into();
    let config = Config::load(&Sources { flags, ..Sources::default() }).unwrap();
    let store = PostgresStore::open(&cluster.url(), PostgresOptions::default()).await.unwrap();
    let server = Server::start(config, Arc::new(store), Clock::fixed(NOW)).await.unwrap();
    let admin = server.first_admin_token.as_ref().unwrap().expose_secret().to_owned();
    let (client, address) = (reqwest::Client::new(), format!("http://{}", server.local_addr));
    let put = client.put(format!("{address}/v1/machines/M1")).bearer_auth(&admin).json(&machine());
    assert_eq!(put.send().await.unwrap().status().as_u16(), 201);
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

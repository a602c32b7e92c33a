//! Three servers on one PostgreSQL, over real sockets: whoever gets a cycle, it is stored once and counted once.

use super::app::{machine, operation, tool};
use crate::store::given::Given;
use feedwright_server::clock::Clock;
use feedwright_server::config::{Config, Sources};
use feedwright_server::database;
use feedwright_server::server::{RunningServer, Server};
use feedwright_store::{Page, Repair, Store};
use secrecy::ExposeSecret;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;

async fn server(url: &str, dir: &tempfile::TempDir) -> RunningServer {
    let flags = [
        ("data_dir", dir.path().to_str().unwrap()),
        ("server.listen", "127.0.0.1:0"),
        ("database.url", url),
        ("database.connections", "4"),
    ];
    let flags = flags.map(|(name, value)| (name.to_owned(), value.to_owned())).into();
    let config = Config::load(&Sources { flags, ..Sources::default() }).unwrap();
    let store: Arc<dyn Store> = database::open(&config).await.unwrap().store;
    Server::start(config, store, Clock::fixed(super::app::NOW)).await.unwrap()
}

fn cycle(number: usize) -> Value {
    json!({
        "cycle_id": format!("c{number}"), "tool": "T1", "operation": "O1",
        "started_at": format!("2026-05-04T05:{:02}:{:02}Z", number / 60, number % 60),
        "samples": {"period_ms": 10, "spindle_load_percent": vec![20.0 + number as f64 / 10.0; 200]},
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_same_cycles_to_three_servers_are_stored_and_counted_once() {
    const CYCLES: usize = 40;
    let Some(given) = Given::postgres().await else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let mut servers = Vec::new();
    for _ in 0..3 {
        servers.push(server(&given.address(), &dir).await);
    }
    let token = servers[0].first_admin_token.as_ref().unwrap().expose_secret().to_owned();
    assert!(servers[1].first_admin_token.is_none(), "one token is made, by whoever came first");
    let urls: Vec<String> = servers.iter().map(|server| format!("http://{}", server.local_addr)).collect();
    let client = reqwest::Client::new();
    for (path, body) in [("machines/M1", machine()), ("tools/T1", tool()), ("operations/O1", operation())] {
        let put = client.put(format!("{}/v1/{path}", urls[0])).bearer_auth(&token).json(&body);
        assert_eq!(put.send().await.unwrap().status().as_u16(), 201, "{path}");
    }
    let mut posts = Vec::new();
    for (at, url) in urls.iter().cloned().enumerate() {
        let (client, token) = (client.clone(), token.clone());
        posts.push(tokio::spawn(async move {
            let mut answers = Vec::new();
            // Each from another cycle on, so that they meet on the same ones while they commit.
            for number in (0..CYCLES).map(|number| (number + at * 2) % CYCLES) {
                let post = client.post(format!("{url}/v1/machines/M1/cycles")).bearer_auth(&token);
                let answer = post.json(&cycle(number)).send().await.unwrap();
                answers.push((number, answer.status().as_u16()));
            }
            answers
        }));
    }
    let mut stored: BTreeMap<usize, Vec<u16>> = BTreeMap::new();
    for post in posts {
        for (number, status) in post.await.unwrap() {
            stored.entry(number).or_default().push(status);
        }
    }
    for (number, mut answers) in stored {
        answers.sort_unstable();
        assert_eq!(answers, [200, 200, 201], "c{number}: new once, known twice");
    }
    for url in &urls {
        let get = client.get(format!("{url}/v1/tools/T1/wear")).bearer_auth(&token);
        let wear: Value = get.send().await.unwrap().json().await.unwrap();
        assert_eq!(wear["cycles"], CYCLES, "{wear}");
    }
    let store = given.store();
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    assert_eq!(
        store.cycles(&Default::default(), Page { after: None, limit: 99 }).await.unwrap().len(),
        CYCLES
    );
    for server in servers {
        server.shutdown().await.unwrap();
    }
    given.done().await;
}

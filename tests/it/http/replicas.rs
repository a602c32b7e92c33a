//! Three servers on one PostgreSQL, over real sockets: whoever gets a cycle, it is stored once and counted once.

use super::app::{App, NOW, machine, operation, tool};
use crate::store::given::Given;
use feedwright_server::clock::Clock;
use feedwright_server::config::{Config, Sources};
use feedwright_server::database;
use feedwright_server::server::{RunningServer, Server};
use feedwright_store::{Page, Repair, Role, Store};
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
    Server::start(config, store, Clock::fixed(NOW)).await.unwrap()
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

/// Each has its own clock, and five minutes lie between the two.
#[tokio::test]
async fn servers_whose_clocks_are_apart_tell_the_same_of_a_silent_machine() {
    const SILENT_AFTER_S: i64 = 900;
    let Some(given) = Given::postgres().await else {
        return;
    };
    let url = given.address();
    let settings = [("database.url", url.as_str()), ("watch.machine_silent_after_ms", "900000")];
    let app = async |seconds: i64| App::by(Clock::fixed(NOW.plus_millis(seconds * 1000)), &settings).await;
    let (behind, ahead) = (app(-150).await, app(150).await);
    for (path, body) in [("machines/M1", machine()), ("tools/T1", tool()), ("operations/O1", operation())] {
        assert_eq!(behind.put(&format!("/v1/{path}"), body).await.status, 201, "{path}");
    }
    // What each tells after its round, in turn, and the alarms that there ever were, with those that are open.
    let told = async || {
        let mut told = Vec::new();
        for app in [&ahead, &behind, &ahead, &behind] {
            feedwright_server::watch::round(&app.state).await.unwrap();
            let text = String::from_utf8(app.get("/metrics").await.body).unwrap();
            let silent = text.contains("feedwright_machine_silent{machine=\"M1\"} 1\n");
            assert!(silent || text.contains("feedwright_machine_silent{machine=\"M1\"} 0\n"), "{text}");
            let alarms = given
                .numbers(
                    "SELECT COUNT(*) FROM alarms UNION ALL SELECT COUNT(*) FROM alarms WHERE cleared_at_us IS NULL",
                )
                .await;
            told.push((silent, alarms));
        }
        told
    };
    let goes_by = async |seconds: i64| {
        let sql =
            format!("UPDATE machine_contacts SET last_cycle_at_us = last_cycle_at_us - {seconds}000000");
        given.raw(sqlx::AssertSqlSafe(sql)).await.unwrap();
    };
    for (times, hears) in [(0, &behind), (1, &ahead)] {
        let posted = hears.call(Role::Machine, "POST", "/v1/machines/M1/cycles", &[], Some(cycle(times)));
        assert_eq!(posted.await.status, 201);
        // Both hear of it in the end: who has it tells the other by the database.
        feedwright_server::watch::round(&hears.state).await.unwrap();
        let before = i64::try_from(times).unwrap();
        assert_eq!(told().await, vec![(false, vec![before, 0]); 4]);
        goes_by(SILENT_AFTER_S - 120).await;
        assert_eq!(told().await, vec![(false, vec![before, 0]); 4], "of the limit two minutes are left");
        goes_by(240).await;
        assert_eq!(told().await, vec![(true, vec![before + 1, 1]); 4], "two minutes beyond it, told once");
    }
    drop((behind, ahead));
    given.removed().await;
}

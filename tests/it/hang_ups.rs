//! Ten thousand clients that hang up in the midst of their request, at a real server on each engine: nothing that was
//! acknowledged is missing, nothing stays open. axum drops the handler of a client that is gone, and sqlx 0.9.0 may
//! return a connection to its pool inside a transaction whose begin was dropped (sqlx issues 4385 and 4393).

use crate::store::Given;
use feedwright_core::units::Timestamp;
use feedwright_server::clock::Clock;
use feedwright_server::config::{Config, Sources};
use feedwright_server::server::Server;
use feedwright_store::{CycleFilter, Page, Repair};
use secrecy::ExposeSecret;
use std::collections::HashSet;
use std::net::SocketAddr;
use std::sync::Arc;
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// 2026-05-04T06:00:00Z.
const NOW: Timestamp = Timestamp::from_micros(1_777_874_400_000_000);
const CLIENTS: usize = 10_000;
/// Clients at a time.
const AT_ONCE: usize = 50;

fn request(method: &str, path: &str, token: &str, body: &str) -> String {
    format!(
        "{method} {path} HTTP/1.1\r\nhost: x\r\nauthorization: Bearer {token}\r\n\
         content-type: application/json\r\ncontent-length: {}\r\n\r\n{body}",
        body.len()
    )
}

/// Posts cycle `n` and hangs up where its number says; returns whether it was acknowledged before.
async fn client(address: SocketAddr, token: &str, n: usize) -> bool {
    let body = format!(
        r#"{{"cycle_id":"c{n:05}","tool":"T1","operation":"O1","started_at":"2026-05-04T05:{:02}:{:02}Z",
            "reported":{{"energy_joules":{}}}}}"#,
        n / 60 % 60,
        n % 60,
        1000 + n % 7
    );
    // Every eighth one changes a tool instead: a transaction of another shape.
    let text = if n % 8 == 1 {
        let tool = format!(r#"{{"name":"tool {n}","tool_type":"drill"}}"#);
        request("PUT", &format!("/v1/tools/X{n:05}"), token, &tool)
    } else {
        request("POST", "/v1/machines/M1/cycles", token, &body)
    };
    let Ok(mut stream) = TcpStream::connect(address).await else { return false };
    // In the head, in the body, after the last byte, after the answer's first.
    let sent = match n % 10 {
        0 => text.len() * (n / 10 % 10) / 10,
        1 => text.len() - 1,
        _ => text.len(),
    };
    if stream.write_all(&text.as_bytes()[..sent]).await.is_err() || sent < text.len() {
        return false;
    }
    if n.is_multiple_of(2) {
        // Some way into the work: the server has a moment that differs from client to client.
        for _ in 0..n / 10 % 40 {
            tokio::task::yield_now().await;
        }
        return false;
    }
    let mut status = [0; 12];
    stream.read_exact(&mut status).await.is_ok() && status.ends_with(b"201")
}

async fn ten_thousand_hang_up(given: &Given) {
    let dir = TempDir::new().unwrap();
    let flags = vec![
        ("data_dir".to_owned(), dir.path().to_string_lossy().into_owned()),
        ("server.listen".to_owned(), "127.0.0.1:0".to_owned()),
    ];
    let config = Config::load(&Sources { flags, ..Sources::default() }).unwrap();
    let store = given.store();
    let server = Server::start(config, Arc::clone(&store), Clock::fixed(NOW)).await.unwrap();
    let token: Arc<str> = server.first_admin_token.as_ref().unwrap().expose_secret().into();
    crate::store::shop(&*store).await;
    let address = server.local_addr;

    let mut acknowledged = HashSet::new();
    let mut clients = tokio::task::JoinSet::new();
    for n in 0..CLIENTS {
        if clients.len() == AT_ONCE
            && let Some(done) = clients.join_next().await
        {
            let (n, stored): (usize, bool) = done.unwrap();
            acknowledged.extend(stored.then_some(n));
        }
        let token = Arc::clone(&token);
        clients.spawn(async move { (n, client(address, &token, n).await) });
    }
    while let Some(done) = clients.join_next().await {
        let (n, stored) = done.unwrap();
        acknowledged.extend(stored.then_some(n));
    }
    assert!(acknowledged.len() > CLIENTS / 4, "{} acknowledged", acknowledged.len());
    assert!(acknowledged.len() < CLIENTS * 3 / 4, "{} acknowledged: nobody hung up", acknowledged.len());
    // Whoever comes next on the same connections is not inside someone else's transaction.
    for n in 0..40 {
        // One of those that wait for their answer.
        let n = CLIENTS + 3 + 10 * n;
        assert!(client(address, &token, n).await, "client {n}");
        acknowledged.insert(n);
    }
    // After the shutdown everything that was taken in has ended, one way or the other.
    let open = given.open_transactions().await;
    assert_eq!(open, 0, "sessions idle in transaction while the server runs");
    let (mut kept, mut after) = (HashSet::new(), None);
    loop {
        let page = store.cycles(&CycleFilter::default(), Page { after, limit: 1000 }).await.unwrap();
        let Some(last) = page.last() else { break };
        after = Some((last.cycle.started_at, last.cycle.machine.clone(), last.cycle.id.clone()));
        kept.extend(page.iter().map(|stored| stored.cycle.id.as_str()[1..].parse::<usize>().unwrap()));
    }
    let mut tools = store.tools(Page { after: None, limit: 20_000 }).await.unwrap();
    tools.retain(|tool| tool.value.id.as_str().starts_with('X'));
    kept.extend(tools.iter().map(|tool| tool.value.id.as_str()[1..].parse::<usize>().unwrap()));
    let missing: Vec<_> = acknowledged.difference(&kept).collect();
    assert!(missing.is_empty(), "acknowledged and not stored: {missing:?}");
    let check = store.check_wear(Repair::No).await.unwrap();
    assert_eq!(check.different, vec![], "every cycle is counted once");
    server.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn at_sqlite() {
    let given = Given::sqlite().await;
    ten_thousand_hang_up(&given).await;
    given.done().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn at_postgres() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    ten_thousand_hang_up(&given).await;
    given.done().await;
}

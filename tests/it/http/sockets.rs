//! What only real sockets show: silence, halves, stalls, bounds, and the end.

use super::app::{NOW, config, machine};
use super::listening::Listening;
use feedwright_core::units::Timestamp;
use feedwright_server::clock::Clock;
use feedwright_server::database::{self, Database};
use feedwright_server::server::{RunningServer, Server};
use feedwright_store::{SqliteOptions, SqliteStore};
use secrecy::ExposeSecret;
use serde_json::json;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// Long enough that a busy machine does not close a socket before its time, short enough to wait for.
const SHORT_MS: &str = "400";
const SHORT: Duration = Duration::from_millis(400);
/// A socket that is not closed by then is not closed for its silence.
const LONG: Duration = Duration::from_secs(10);

struct Running {
    server: RunningServer,
    address: SocketAddr,
    token: String,
    _database: Database,
    _dir: TempDir,
}

async fn start(settings: &[(&str, &str)]) -> Running {
    let dir = TempDir::new().unwrap();
    let config = config(&dir, settings);
    let database = database::open(&config).await.unwrap();
    let server = Server::start(config, database.store.clone(), Clock::fixed(NOW)).await.unwrap();
    let token = server.first_admin_token.as_ref().unwrap().expose_secret().to_owned();
    Running { address: server.local_addr, server, token, _database: database, _dir: dir }
}

impl Running {
    async fn connect(&self) -> TcpStream {
        TcpStream::connect(self.address).await.unwrap()
    }

    fn put_head(&self, length: usize) -> String {
        format!(
            "PUT /v1/machines/M1 HTTP/1.1\r\nhost: x\r\nauthorization: Bearer {}\r\n\
             content-type: application/json\r\ncontent-length: {length}\r\n\r\n",
            self.token
        )
    }
}

/// Reads until the server closes; how long it took, and what came.
async fn until_closed(stream: &mut TcpStream) -> (Duration, String) {
    let begun = Instant::now();
    let mut answer = Vec::new();
    let read = tokio::time::timeout(LONG, stream.read_to_end(&mut answer)).await;
    // A reset closes just as well.
    let _ = read.expect("the server closes the connection");
    (begun.elapsed(), String::from_utf8_lossy(&answer).into_owned())
}

#[tokio::test]
async fn a_silent_connection_half_a_head_and_an_idle_one_are_closed_in_time() {
    let running = start(&[("server.header_read_timeout_ms", SHORT_MS)]).await;
    let mut silent = running.connect().await;
    let mut half = running.connect().await;
    half.write_all(b"GET /healthz HTTP/1.1\r\nhost: x\r\nx-slow").await.unwrap();
    let mut idle = running.connect().await;
    idle.write_all(b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n").await.unwrap();
    let (silent, half, idle) =
        tokio::join!(until_closed(&mut silent), until_closed(&mut half), until_closed(&mut idle));
    for (elapsed, _) in [&silent, &half, &idle] {
        assert!((SHORT / 2..SHORT * 8).contains(elapsed), "{elapsed:?}");
    }
    assert!(idle.1.starts_with("HTTP/1.1 200"), "{}", idle.1);
    running.server.shutdown().await.unwrap();
}

/// RFC 9112, section 3.2. Health checks by HTTP/1.0 name none.
#[tokio::test]
async fn a_request_names_one_host() {
    let running = start(&[("metrics.listen", "127.0.0.1:0")]).await;
    let body = machine().to_string();
    let put = running.put_head(body.len());
    let head =
        |version: &str, hosts: &str| format!("GET /healthz {version}\r\n{hosts}connection: close\r\n\r\n");
    for (request, status) in [
        (put.replace("host: x\r\n", "connection: close\r\n") + &body, "400"),
        (put.replace("host: x\r\n", "host: x\r\nHost: x\r\nconnection: close\r\n") + &body, "400"),
        (put.replace("host: x\r\n", "host:\r\nconnection: close\r\n") + &body, "201"),
        (head("HTTP/1.1", ""), "400"),
        (head("HTTP/1.1", "").replace("/healthz", "/nowhere"), "400"),
        (head("HTTP/1.1", "").replace("/healthz", "http://x/healthz"), "400"),
        (head("HTTP/1.1", "host: x\r\n"), "200"),
        (head("HTTP/1.0", ""), "200"),
        (head("HTTP/1.0", "host: x\r\n"), "200"),
        (head("HTTP/1.0", "host: x\r\nhost: y\r\n"), "400"),
    ] {
        let mut stream = running.connect().await;
        stream.write_all(request.as_bytes()).await.unwrap();
        let (_, answer) = until_closed(&mut stream).await;
        assert_eq!(answer.split(' ').nth(1), Some(status), "{request}\n{answer}");
        assert_eq!(answer.contains("\"code\":\"invalid_host\""), status == "400", "{answer}");
    }
    let mut metrics = TcpStream::connect(running.server.metrics_addr.unwrap()).await.unwrap();
    metrics.write_all(b"GET /metrics HTTP/1.1\r\nconnection: close\r\n\r\n").await.unwrap();
    assert!(until_closed(&mut metrics).await.1.starts_with("HTTP/1.1 400"));
    running.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn a_body_that_stalls_or_drips_is_answered_and_closed_in_time() {
    let running =
        start(&[("server.body_stall_timeout_ms", SHORT_MS), ("server.body_read_timeout_ms", "900")]).await;
    let mut stalled = running.connect().await;
    stalled.write_all(running.put_head(100).as_bytes()).await.unwrap();
    stalled.write_all(b"{\"name\":").await.unwrap();
    let (elapsed, answer) = until_closed(&mut stalled).await;
    assert!(answer.starts_with("HTTP/1.1 408") && answer.contains("body_too_slow"), "{answer}");
    assert!(elapsed > SHORT / 2, "{elapsed:?}");

    let mut dripping = running.connect().await;
    dripping.write_all(running.put_head(100_000).as_bytes()).await.unwrap();
    let (mut read, mut write) = dripping.split();
    let drip = async {
        let mut drops = tokio::time::interval(SHORT / 8);
        loop {
            drops.tick().await;
            if write.write_all(b" ").await.is_err() {
                return std::future::pending::<()>().await;
            }
        }
    };
    let mut answer = Vec::new();
    tokio::select! {
        _ = read.read_to_end(&mut answer) => {}
        () = drip => {}
        () = tokio::time::sleep(LONG) => panic!("a dripping body is never closed"),
    }
    running.server.shutdown().await.unwrap();
}

/// RFC 9110, section 10.1.1: whoever asks before sending a body is not asked for one that is refused for its length.
#[tokio::test]
async fn who_asks_first_is_not_asked_for_a_body_that_is_too_large() {
    let running = start(&[("server.body_stall_timeout_ms", "60000")]).await;
    for (length, begins) in [(99_999_999_999_u64, "HTTP/1.1 413"), (2, "HTTP/1.1 100")] {
        let mut stream = running.connect().await;
        let head = format!(
            "POST /v1/machines/M1/cycles HTTP/1.1\r\nhost: x\r\nauthorization: Bearer {}\r\n\
             content-type: application/json\r\nexpect: 100-continue\r\ncontent-length: {length}\r\n\r\n",
            running.token
        );
        stream.write_all(head.as_bytes()).await.unwrap();
        let mut answer = [0; 12];
        tokio::time::timeout(LONG, stream.read_exact(&mut answer)).await.expect("it is answered").unwrap();
        assert_eq!(std::str::from_utf8(&answer), Ok(begins));
    }
    running.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn a_client_that_does_not_read_its_answers_is_dropped() {
    let running =
        start(&[("server.body_stall_timeout_ms", SHORT_MS), ("metrics.listen", "127.0.0.1:0")]).await;
    let mut deaf = running.connect().await;
    let ask = b"GET /docs/swagger-ui-bundle.js HTTP/1.1\r\nhost: x\r\n\r\n";
    // More answers than the sockets' buffers hold.
    deaf.write_all(&ask.repeat(20)).await.unwrap();
    let metrics = format!("http://{}/metrics", running.server.metrics_addr.unwrap());
    let begun = Instant::now();
    let mut polls = tokio::time::interval(SHORT / 8);
    loop {
        polls.tick().await;
        let text = reqwest::get(&metrics).await.unwrap().text().await.unwrap();
        let asked = text.contains("route=\"/docs/{*file}\"");
        // The one that is left asks for metrics.
        if asked && text.contains("feedwright_http_connections 1\n") {
            break;
        }
        assert!(begun.elapsed() < LONG, "it is still connected");
    }
    assert!(begun.elapsed() > SHORT / 2, "it was dropped for something else");
    drop(deaf);
    running.server.shutdown().await.unwrap();
}

/// It reads all the time, and less in the time that an answer may stand still than what the system keeps for a connection.
#[tokio::test]
async fn a_client_that_reads_slowly_gets_its_answers_whole() {
    let running = start(&[("server.body_stall_timeout_ms", "2000")]).await;
    let mut slow = running.connect().await;
    let whole = reqwest::get(format!("http://{}/docs/swagger-ui-bundle.js", running.address));
    let whole = whole.await.unwrap().bytes().await.unwrap().len();
    // More than the system keeps for it.
    let answers = 20_000_000_usize.div_ceil(whole);
    let ask = "GET /docs/swagger-ui-bundle.js HTTP/1.1\r\nhost: x\r\n\r\n".repeat(answers);
    slow.write_all(ask.as_bytes()).await.unwrap();
    let (mut read, mut buffer) = (0, vec![0; 32 << 10]);
    let mut ticks = tokio::time::interval(Duration::from_millis(100));
    while read < answers * whole {
        // 320 kB/s for more than two such times, and then what is left.
        if read < 2_000_000 {
            ticks.tick().await;
        }
        let came = tokio::time::timeout(LONG, slow.read(&mut buffer)).await.expect("it goes on").unwrap();
        assert!(came > 0, "cut off after {read} bytes of {answers} answers of {whole}");
        read += came;
    }
    running.server.shutdown().await.unwrap();
}

/// The right to hold a large answer ends when it is read, and not when the connection has taken it over.
#[tokio::test]
async fn large_answers_are_few_until_their_clients_have_read_them() {
    let dir = TempDir::new().unwrap();
    let store = SqliteStore::open(&dir.path().join("shop.sqlite3"), SqliteOptions::default()).await.unwrap();
    let Listening { server, address, client, admin, dir: _dir } = Listening::before(Arc::new(store)).await;
    let load: Vec<f64> = (0..150_000).map(|k| f64::from(k % 1000) / 10.0).collect();
    let cycle = json!({
        "cycle_id": "large", "tool": "T1", "operation": "O1", "started_at": "2026-05-04T05:30:00Z",
        "samples": {"period_ms": 1, "spindle_load_percent": load, "feed_drive_load_percent": load},
    });
    let posted = client.post(format!("{address}/v1/machines/M1/cycles")).bearer_auth(&admin).json(&cycle);
    assert_eq!(posted.send().await.unwrap().status().as_u16(), 201);
    let free = || std::iter::from_fn(|| server.state().exports.at_once()).collect::<Vec<_>>().len();
    let most = free();
    for accept in ["application/json", "text/csv"] {
        let ask = format!(
            "GET /v1/machines/M1/cycles/large/samples HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\
             accept: {accept}\r\nauthorization: Bearer {admin}\r\n\r\n"
        );
        let mut clients = Vec::new();
        for _ in 0..3 {
            let mut client = TcpStream::connect(server.local_addr).await.unwrap();
            client.write_all(ask.as_bytes()).await.unwrap();
            // Its head is there, so the answer is made and under way.
            let mut head = [0; 64];
            client.read_exact(&mut head).await.unwrap();
            assert!(head.starts_with(b"HTTP/1.1 200"), "{}", String::from_utf8_lossy(&head));
            clients.push(client);
        }
        assert_eq!(free(), most - clients.len(), "{accept}");
        for mut client in clients {
            let mut answer = Vec::new();
            client.read_to_end(&mut answer).await.unwrap();
            assert!(answer.len() > 1_000_000, "{accept}: {}", answer.len());
        }
        // The connection ends a moment after its last byte was read.
        let begun = Instant::now();
        while free() < most {
            assert!(begun.elapsed() < LONG, "{accept}: it is kept for ever");
            tokio::time::sleep(SHORT / 40).await;
        }
    }
    server.shutdown().await.unwrap();
}

#[tokio::test]
async fn beyond_the_bound_connections_wait_and_are_served_when_there_is_room() {
    let running = start(&[("server.max_connections", "2")]).await;
    let ask = b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n";
    let mut first = running.connect().await;
    let mut second = running.connect().await;
    let mut buffer = [0; 1024];
    for stream in [&mut first, &mut second] {
        stream.write_all(ask).await.unwrap();
        assert!(stream.read(&mut buffer).await.unwrap() > 0);
    }
    let mut third = running.connect().await;
    third.write_all(ask).await.unwrap();
    let waited = tokio::time::timeout(SHORT, third.read(&mut buffer)).await;
    assert!(waited.is_err(), "a third connection was served: {waited:?}");
    drop(first);
    let served = tokio::time::timeout(LONG, third.read(&mut buffer)).await;
    assert!(served.expect("served after the first left").unwrap() > 0);
    drop((second, third));
    running.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn shutdown_answers_what_is_under_way_and_refuses_what_is_new() {
    let running = start(&[("server.shutdown_timeout_ms", "20000")]).await;
    let body = machine().to_string();
    let mut idle = running.connect().await;
    let mut under_way = running.connect().await;
    under_way.write_all(running.put_head(body.len()).as_bytes()).await.unwrap();
    let (head, tail) = body.split_at(body.len() / 2);
    under_way.write_all(head.as_bytes()).await.unwrap();
    // An answer on another connection shows that the server has got as far as reading.
    let mut probe = running.connect().await;
    probe.write_all(b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n").await.unwrap();
    let mut buffer = [0; 4096];
    assert!(probe.read(&mut buffer).await.unwrap() > 0);

    let (address, store) = (running.address, running.server.state().store.clone());
    let begun = Instant::now();
    let down = tokio::spawn(running.server.shutdown());
    let (_, _) = until_closed(&mut idle).await;
    under_way.write_all(tail.as_bytes()).await.unwrap();
    let (_, answer) = until_closed(&mut under_way).await;
    assert!(answer.starts_with("HTTP/1.1 201"), "{answer}");
    down.await.unwrap().unwrap();
    assert!(begun.elapsed() < Duration::from_secs(20));
    assert!(TcpStream::connect(address).await.is_err(), "nobody listens any more");
    let id = feedwright_core::ids::MachineId::try_from("M1").unwrap();
    assert!(store.machine(&id).await.is_err(), "the store is closed");
}

/// After a restart every machine of a shop comes at once; what the kernel has no room for is dropped without a word.
#[tokio::test]
async fn whoever_comes_while_every_place_is_taken_waits_and_is_served() {
    let running = start(&[("server.max_connections", "1")]).await;
    let mut first = running.connect().await;
    first.write_all(b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n").await.unwrap();
    assert!(first.read(&mut [0; 1024]).await.unwrap() > 0, "it has the only place");
    let all = futures_util::future::join_all((0..500).map(|_| running.connect()));
    let mut waiting = tokio::time::timeout(Duration::from_secs(30), all).await.expect("the kernel has room");
    let mut last = waiting.pop().unwrap();
    drop((first, waiting));
    last.write_all(b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n").await.unwrap();
    assert!(last.read(&mut [0; 1024]).await.unwrap() > 0);
}

#[tokio::test]
async fn shutdown_does_not_wait_for_a_client_that_never_ends() {
    let running = start(&[("server.shutdown_timeout_ms", "2000")]).await;
    let mut stuck = running.connect().await;
    stuck.write_all(running.put_head(100).as_bytes()).await.unwrap();
    let mut probe = running.connect().await;
    probe.write_all(b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n").await.unwrap();
    assert!(probe.read(&mut [0; 1024]).await.unwrap() > 0);
    let begun = Instant::now();
    running.server.shutdown().await.unwrap();
    // Before the client would have been given up for its silence.
    assert!(begun.elapsed() < Duration::from_secs(8), "{:?}", begun.elapsed());
}

#[tokio::test]
async fn only_the_first_start_makes_a_token() {
    let dir = TempDir::new().unwrap();
    let mut tokens = Vec::new();
    for _ in 0..2 {
        let config = config(&dir, &[("metrics.listen", "127.0.0.1:0")]);
        let database = database::open(&config).await.unwrap();
        assert!(database::open(&config).await.is_err(), "the data directory is locked");
        let clock = Clock::fixed(Timestamp::from_micros(1));
        let server = Server::start(config, database.store.clone(), clock).await.unwrap();
        tokens.push(server.first_admin_token.is_some());

        let metrics = format!("http://{}/metrics", server.metrics_addr.unwrap());
        let text = reqwest::get(metrics).await.unwrap().text().await.unwrap();
        assert!(text.contains("feedwright_http_connections"), "{text}");
        let refused = reqwest::get(format!("http://{}/metrics", server.local_addr)).await.unwrap();
        assert_eq!(refused.status().as_u16(), 401);
        let absent =
            reqwest::get(format!("http://{}/v1/machines", server.metrics_addr.unwrap())).await.unwrap();
        assert_eq!(absent.status().as_u16(), 404);
        server.shutdown().await.unwrap();
    }
    assert_eq!(tokens, [true, false]);
}

/// Whoever asks whether it is ready finds the first token where it is to be: nobody is answered before.
#[tokio::test]
async fn who_comes_before_it_serves_waits() {
    let dir = TempDir::new().unwrap();
    let config = config(&dir, &[]);
    let database = database::open(&config).await.unwrap();
    let listening = Server::listen(config, database.store.clone(), Clock::fixed(NOW)).await.unwrap();
    assert!(listening.first_admin_token.is_some());
    let url = format!("http://{}/readyz", listening.local_addr);
    let (answered, mut answer) = tokio::sync::oneshot::channel();
    tokio::spawn(async move { answered.send(reqwest::get(url).await.unwrap().status().as_u16()) });
    // As long as nobody accepts it there is nobody who could answer.
    tokio::task::yield_now().await;
    assert!(answer.try_recv().is_err());
    let server = listening.serve();
    assert_eq!(answer.await.unwrap(), 200);
    server.shutdown().await.unwrap();
}

#[tokio::test]
async fn the_metrics_listener_answers_whatever_the_connections_to_the_api_do() {
    let running = start(&[("server.max_connections", "1"), ("metrics.listen", "127.0.0.1:0")]).await;
    let metrics = format!("http://{}/metrics", running.server.metrics_addr.unwrap());
    let asked = async {
        let held = running.connect().await;
        for _ in 0..3 {
            let text = reqwest::get(&metrics).await.unwrap().text().await.unwrap();
            assert!(text.contains("feedwright_http_connections"), "{text}");
        }
        drop(held);
        // The API's one is free again, and is not held by who waits for metrics.
        for _ in 0..2 {
            let ready = reqwest::get(format!("http://{}/healthz", running.address)).await.unwrap();
            assert_eq!(ready.status(), 200);
        }
    };
    tokio::time::timeout(LONG, asked).await.expect("all are answered");
    running.server.shutdown().await.unwrap();
}

//! A reader that does not read.

use super::Served;
use super::reader::Reader;
use serde_json::{Value, json};
use std::collections::HashSet;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};

const CYCLES: usize = 100;
/// One for each minute of an hour: more than the system holds on its way to a reader, which is 4 MiB at the most
/// (`tcp_wmem`), at some 770 bytes an event.
const BATCHES: usize = 60;

/// Reads on until `until` is there; what came.
async fn read(socket: &mut TcpStream, until: &str) -> String {
    let mut text = String::new();
    let reading = async {
        let mut buffer = vec![0; 65_536];
        while !text.contains(until) {
            let count = socket.read(&mut buffer).await.unwrap();
            assert!(count > 0, "the view goes on: {text}");
            text.push_str(&String::from_utf8_lossy(&buffer[..count]));
        }
    };
    let came = tokio::time::timeout(Duration::from_secs(60), reading).await;
    assert!(came.is_ok(), "{until} did not come: {}", text.len());
    text
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reader_that_stops_reading_is_told_the_gap_and_costs_nobody_else_an_event() {
    let served = Served::start(&[("live.history_events", "200")]).await;
    served.with_a_shop().await;
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(4096).unwrap();
    let mut slow = socket.connect(served.server.local_addr).await.unwrap();
    let asked =
        format!("GET /v1/live HTTP/1.1\r\nhost: cell\r\nauthorization: Bearer {}\r\n\r\n", served.token);
    slow.write_all(asked.as_bytes()).await.unwrap();
    read(&mut slow, "event: state").await;

    let mut quick = Reader::open(&served, "", None).await;
    assert_eq!(quick.next().await.unwrap().name, "state");
    // Events as large as they come.
    let long = "x".repeat(120);
    for batch in 0..BATCHES {
        let line = |n: usize| {
            json!({"cycle_id": format!("{long}{batch}-{n}"), "tool": long, "operation": long,
                   "started_at": format!("2026-05-04T06:{batch:02}:{:02}.{:03}Z", n / 2, 500 * (n % 2)), "reported": {"energy_joules": 2000.0}})
        };
        let body: String = (0..CYCLES).map(|n| format!("{}\n", line(n))).collect();
        let answer = served
            .client
            .post(served.url("/v1/machines/M1/cycles/batch"))
            .bearer_auth(&served.token)
            .header("content-type", "application/x-ndjson")
            .body(body)
            .send()
            .await
            .unwrap();
        assert_eq!(answer.status(), 200);
        for line in answer.text().await.unwrap().lines() {
            let line: Value = serde_json::from_str(line).unwrap();
            assert_eq!(line["outcome"], "stored", "{line}");
        }
        // Whoever reads misses nothing, while the other one stands still.
        let mut seen = HashSet::new();
        for _ in 0..CYCLES {
            let shown = quick.next().await.unwrap();
            assert_eq!(shown.name, "cycle", "{shown:?}");
            assert!(seen.insert(shown.data["cycle_id"].as_str().unwrap().to_owned()), "{shown:?} twice");
        }
    }
    served.post_cycle("last", 20.0).await;
    let text = read(&mut slow, "\"last\"").await;
    assert_eq!(text.matches("event: gap").count(), 1, "it is told how much it missed");
    assert!(text.contains("reader_too_slow"));
    let told = text.matches("event: cycle").count();
    assert!((200..CYCLES * BATCHES).contains(&told), "{told} of the newest are kept for it");
    served.server.shutdown().await.unwrap();
}

//! The client against a socket that answers what a test tells it to.

use super::*;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpListener;

/// Answers one connection after another with the given bytes; an empty answer hangs up.
pub(in crate::replay) async fn service(
    answers: &'static [&'static str],
) -> (String, tokio::task::JoinHandle<usize>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    let task = tokio::spawn(async move {
        for answer in answers {
            let (mut socket, _) = listener.accept().await.unwrap();
            let mut head = [0; 4096];
            let _read = socket.read(&mut head).await.unwrap();
            socket.write_all(answer.as_bytes()).await.unwrap();
            socket.shutdown().await.unwrap();
        }
        answers.len()
    });
    (address, task)
}

const OK: &str = "HTTP/1.1 201 Created\r\nconnection: close\r\ncontent-length: 2\r\n\r\n{}";
const BUSY: &str =
    "HTTP/1.1 503 Service Unavailable\r\nretry-after: 0\r\nconnection: close\r\ncontent-length: 0\r\n\r\n";
const MANY: &str =
    "HTTP/1.1 429 Too Many Requests\r\nretry-after: 0\r\nconnection: close\r\ncontent-length: 0\r\n\r\n";
const BROKEN: &str = "HTTP/1.1 201 Created\r\nconnection: close\r\ncontent-length: 20\r\n\r\n{";

#[tokio::test]
async fn asks_again_when_busy_and_when_the_line_breaks() {
    let (address, task) = service(&[BUSY, MANY, "", BROKEN, OK]).await;
    let client = Client::new(&address, None, Duration::from_secs(30)).unwrap();
    let answer = client.json(Method::POST, "/v1/x", &serde_json::json!({})).await.unwrap();
    assert_eq!(answer.status, StatusCode::CREATED);
    assert_eq!(task.await.unwrap(), 5);
}

#[tokio::test]
async fn gives_up_after_its_patience_and_says_why() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    drop(listener);
    let client = Client::new(&address, None, Duration::from_millis(1)).unwrap();
    let said = client.get("/healthz").await.unwrap_err().to_string();
    assert!(said.contains("given up") && said.contains("/healthz"), "{said}");
}

#[tokio::test]
async fn a_refusal_is_an_answer_and_not_repeated() {
    let (address, task) =
        service(&["HTTP/1.1 409 Conflict\r\nconnection: close\r\ncontent-length: 36\r\n\r\n\
                   {\"code\":\"conflict\",\"detail\":\"other\"} "])
        .await;
    let client = Client::new(&address, None, Duration::from_secs(5)).unwrap();
    let answer = client.get("/").await.unwrap();
    assert_eq!(answer.status, StatusCode::CONFLICT);
    assert_eq!(answer.problem(), "conflict: other");
    assert_eq!(task.await.unwrap(), 1);
}

#[tokio::test]
async fn what_is_no_address_is_not_waited_for() {
    for address in ["ftp://127.0.0.1", "127.0.0.1:7878", ""] {
        let client = Client::new(address, None, Duration::from_secs(600)).unwrap();
        let asked = tokio::time::timeout(Duration::from_secs(30), client.get("/healthz")).await;
        let said = asked.expect("it is told at once").unwrap_err().to_string();
        assert!(said.contains("given up after 0 s"), "{said}");
    }
}

#[tokio::test]
async fn what_is_waited_for_is_told_while_nobody_answers_and_without_a_password() {
    static TOLD: std::sync::Mutex<Vec<String>> = std::sync::Mutex::new(Vec::new());
    static TELLS: tokio::sync::Notify = tokio::sync::Notify::const_new();
    // It takes the connection, and says nothing.
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = format!("http://somebody:secret@{}", listener.local_addr().unwrap());
    let mut client = Client::new(&address, None, Duration::from_secs(600)).unwrap().telling(|line| {
        TOLD.lock().unwrap().push(line.to_owned());
        TELLS.notify_one();
    });
    client.told_after = Duration::from_millis(20);
    tokio::select! {
        answer = client.get("/healthz") => panic!("{answer:?}"),
        () = TELLS.notified() => {}
    }
    let told = TOLD.lock().unwrap().join("\n");
    assert!(told.contains("/healthz: no answer yet") && !told.contains("secret"), "{told}");
}

//! A machine that speaks `feedwright.v1`.

use crate::live::Served;
use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::time::Duration;
use tokio::net::TcpStream;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{self, Message};

/// Longer than anything here takes on a busy machine.
pub(crate) const PATIENCE: Duration = Duration::from_secs(20);
/// 2026-05-04T06:00:00Z: when the cycles of the stories began, by their machine's clock.
pub(crate) const STARTED: &str = "2026-05-04T06:00:00Z";

pub(crate) struct Machine {
    socket: WebSocketStream<TcpStream>,
    n: u32,
}

/// What came: a text answer, a binary one, or the end.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Came {
    Text(Value),
    Binary(Vec<u8>),
    Closed(Option<u16>),
}

/// Status and problem code of a refused upgrade.
pub(crate) type Refused = (u16, String);

impl Machine {
    pub(crate) async fn connect(served: &Served, token: &str) -> Self {
        Self::open(served, "M1", token, "feedwright.v1", &[]).await.expect("the stream opens")
    }

    pub(crate) async fn open(
        served: &Served,
        machine: &str,
        token: &str,
        protocol: &str,
        headers: &[(&'static str, &str)],
    ) -> Result<Self, Refused> {
        Self::open_at(served.server.local_addr, machine, token, protocol, headers).await
    }

    pub(crate) async fn open_at(
        address: SocketAddr,
        machine: &str,
        token: &str,
        protocol: &str,
        headers: &[(&'static str, &str)],
    ) -> Result<Self, Refused> {
        let mut request =
            format!("ws://{address}/v1/machines/{machine}/stream").into_client_request().unwrap();
        let map = request.headers_mut();
        // A browser sends a cookie instead.
        if !token.is_empty() {
            map.insert("authorization", format!("Bearer {token}").parse().unwrap());
        }
        map.insert("sec-websocket-protocol", protocol.parse().unwrap());
        for (name, value) in headers {
            map.insert(*name, value.parse().unwrap());
        }
        let tcp = TcpStream::connect(address).await.unwrap();
        match tokio_tungstenite::client_async(request, tcp).await {
            Ok((socket, response)) => {
                assert_eq!(response.headers()["sec-websocket-protocol"], "feedwright.v1");
                Ok(Self { socket, n: 0 })
            }
            Err(tungstenite::Error::Http(response)) => {
                let body: Value = serde_json::from_slice(response.body().as_deref().unwrap_or_default())
                    .unwrap_or_default();
                Err((response.status().as_u16(), body["code"].as_str().unwrap_or_default().to_owned()))
            }
            Err(error) => panic!("{error}"),
        }
    }

    /// Sends and never waits for an answer, until the stream is closed: with which code.
    pub(crate) async fn flood(self) -> Option<u16> {
        let (mut out, mut back) = self.socket.split();
        let sending = async {
            for n in self.n + 1.. {
                let heartbeat = json!({"type": "heartbeat", "n": n}).to_string();
                if out.send(Message::Text(heartbeat.into())).await.is_err() {
                    break;
                }
            }
            std::future::pending::<()>().await;
        };
        let reading = async {
            loop {
                match back.next().await {
                    Some(Ok(Message::Close(frame))) => return frame.map(|frame| frame.code.into()),
                    Some(Ok(_)) => {}
                    None | Some(Err(_)) => return None,
                }
            }
        };
        let closed = async {
            tokio::select! {
                code = reading => code,
                () = sending => None,
            }
        };
        tokio::time::timeout(PATIENCE, closed).await.expect("it is closed")
    }

    pub(crate) async fn send(&mut self, message: Message) {
        self.socket.send(message).await.unwrap();
    }

    /// What comes next, past pings.
    pub(crate) async fn came(&mut self) -> Came {
        loop {
            let next = tokio::time::timeout(PATIENCE, self.socket.next()).await.expect("an answer comes");
            return match next {
                Some(Ok(Message::Text(text))) => Came::Text(serde_json::from_str(text.as_str()).unwrap()),
                Some(Ok(Message::Binary(bytes))) => Came::Binary(bytes.to_vec()),
                Some(Ok(Message::Close(frame))) => Came::Closed(frame.map(|frame| frame.code.into())),
                Some(Ok(_)) => continue,
                None | Some(Err(_)) => Came::Closed(None),
            };
        }
    }

    /// Sends a message with the next number; the answer, which names it.
    pub(crate) async fn ask(&mut self, mut message: Value) -> Value {
        self.n += 1;
        message["n"] = self.n.into();
        self.send(Message::Text(message.to_string().into())).await;
        match self.came().await {
            Came::Text(answer) => {
                assert_eq!(answer["re"], self.n, "{answer}");
                answer
            }
            other => panic!("{other:?} to {message}"),
        }
    }

    /// Sends text as it is; the answer.
    pub(crate) async fn ask_text(&mut self, text: &str) -> Value {
        self.send(Message::Text(text.into())).await;
        match self.came().await {
            Came::Text(answer) => answer,
            other => panic!("{other:?} to {text}"),
        }
    }

    pub(crate) async fn start(&mut self, id: &str, change: Value) -> Value {
        let mut message = json!({
            "type": "start", "cycle_id": id, "tool": "T1", "operation": "O1",
            "started_at": STARTED, "sent_at": STARTED, "period_ms": 10.0,
            "channels": ["depth_mm", "spindle_load_percent", "feed_drive_load_percent"],
            "program": {"between": "linear", "knots": [{"depth_mm": 0.0, "feed_mm_min": 100.0},
                                                      {"depth_mm": 10.0, "feed_mm_min": 300.0}]},
            "seq": 7, "strategy": "f_ac", "spindle_speed_rpm": 2500.0
        });
        for (name, value) in change.as_object().unwrap() {
            if value.is_null() {
                message.as_object_mut().unwrap().remove(name);
            } else {
                message[name] = value.clone();
            }
        }
        self.ask(message).await
    }

    /// Samples `from..to` of the story's load.
    pub(crate) async fn samples(&mut self, from: u64, to: u64) -> Value {
        let message = samples(from, to);
        self.ask(message).await
    }

    pub(crate) async fn end(&mut self, samples: u64) -> Value {
        self.ask(json!({"type": "end", "samples": samples})).await
    }

    /// The connection breaks: no close frame, no farewell.
    pub(crate) fn break_off(self) {
        drop(self);
    }
}

/// Depth and loads of sample `n`: low enough at first, too high later.
pub(crate) fn sample(n: u64) -> (f64, f64, f64) {
    #[expect(clippy::cast_precision_loss, reason = "a few hundred")]
    let n = n as f64;
    let tenths = |value: f64| (value * 10.0).round() / 10.0;
    ((n * 0.02 * 1000.0).round() / 1000.0, tenths(12.0 + 0.9 * n), tenths(6.0 + 0.2 * n))
}

pub(crate) fn samples(from: u64, to: u64) -> Value {
    let column = |value: fn((f64, f64, f64)) -> f64| (from..to).map(|n| value(sample(n))).collect::<Vec<_>>();
    json!({
        "type": "samples", "first": from, "depth_mm": column(|s| s.0),
        "spindle_load_percent": column(|s| s.1), "feed_drive_load_percent": column(|s| s.2)
    })
}

/// The same as one frame of the binary encoding: 3, 1 and 1 decimals.
pub(crate) fn frame(n: u32, from: u64, to: u64) -> Vec<u8> {
    let mut bytes = vec![0x01, 0];
    bytes.extend(u16::try_from(to - from).unwrap().to_le_bytes());
    bytes.extend(n.to_le_bytes());
    bytes.extend(u32::try_from(from).unwrap().to_le_bytes());
    #[expect(clippy::cast_possible_truncation, reason = "a few thousand")]
    let mut column = |value: fn((f64, f64, f64)) -> f64| {
        for n in from..to {
            bytes.extend((value(sample(n)).round() as i32).to_le_bytes());
        }
    };
    column(|s| s.0 * 1000.0);
    column(|s| s.1 * 10.0);
    column(|s| s.2 * 10.0);
    bytes
}

pub(crate) fn codes(reasons: &Value) -> Vec<&str> {
    reasons.as_array().unwrap().iter().map(|code| code.as_str().unwrap()).collect()
}

/// What a post of the same cycle would be.
pub(crate) fn posted(id: &str, to: u64) -> Value {
    let mut columns = samples(0, to);
    let columns = columns.as_object_mut().unwrap();
    columns.remove("type");
    columns.remove("first");
    columns.insert("period_ms".to_owned(), 10.0.into());
    json!({
        "cycle_id": id, "tool": "T1", "operation": "O1", "started_at": STARTED, "seq": 7, "strategy": "f_ac",
        "spindle_speed_rpm": 2500.0, "samples": columns
    })
}

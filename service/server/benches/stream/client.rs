//! Machines that send at a pace, and measure how long an answer takes. Frames are made by hand: the clients must not
//! cost more than what they measure.

use crate::process::Running;
use serde_json::json;
use std::io::Write;
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;

/// How many connections at which pace for how long.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Load {
    pub(crate) connections: u32,
    pub(crate) per_second: u32,
    pub(crate) seconds: u32,
}

impl Load {
    const fn samples(self) -> u32 {
        self.per_second * self.seconds
    }
}

/// What is spoken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Wire {
    Binary,
    Text,
    EchoBinary,
    EchoText,
}

impl Wire {
    pub(crate) const fn is_echo(self) -> bool {
        matches!(self, Self::EchoBinary | Self::EchoText)
    }
}

/// What came of a round.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Outcome {
    pub(crate) messages: u64,
    pub(crate) asked: u64,
    /// Processor time of the server from the first message to the last answer, s.
    pub(crate) spent: f64,
    pub(crate) p50: Duration,
    pub(crate) p99: Duration,
}

/// Registers machines `B0`, `B1`, …, a tool and an operation with set loads.
pub(crate) async fn register(server: &Running, machines: u32) {
    let client = reqwest::Client::new();
    let put = async |path: String, body: serde_json::Value| {
        let request = client.put(format!("{}{path}", server.address)).bearer_auth(&server.token).json(&body);
        let status = request.send().await.expect("an answer").status();
        assert!(status.is_success(), "{path}: {status}");
    };
    for machine in 0..machines {
        let body = json!({
            "name": "bench", "control": "bench", "ipo_period_ms": 1.0,
            "spindle": {"reference": "rated_power", "rated_power_watts": 7000.0},
            "feed_drive": {"reference": "rated_torque", "rated_thrust_newtons": 9000.0},
            "limits": {"feed_min_mm_min": 1.0, "feed_max_mm_min": 3000.0, "override_min_percent": 20.0,
                       "override_max_percent": 150.0}
        });
        put(format!("/v1/machines/B{machine}"), body).await;
        let tool = json!({"name": "bench", "tool_type": "bench"});
        put(format!("/v1/tools/T{machine}"), tool).await;
    }
    let operation = json!({"name": "O1", "process": "friction", "programmed_feed_mm_min": 150.0,
                           "feed_drive_load_set_percent": 30.0, "spindle_load_set_percent": 40.0});
    put("/v1/operations/O1".to_owned(), operation).await;
}

/// One round: every connection at its pace, spread over the period as machines that know nothing of each other are.
/// Only messages are measured: connections and cycles begin before, and cycles end after.
pub(crate) async fn run(peer: &Running, wire: Wire, load: Load, round: usize) -> Outcome {
    let address = peer.address.trim_start_matches("http://");
    let mut machines = Vec::new();
    // A few at a time: the echo's listener has room for a hundred that wait to be accepted.
    for from in (0..load.connections).step_by(AT_ONCE) {
        let begun = (from..load.connections).take(AT_ONCE).map(|index| {
            tokio::spawn(Machine::begin(address.to_owned(), peer.token.clone(), wire, load, (index, round)))
        });
        for begun in futures_util::future::join_all(begun.collect::<Vec<_>>()).await {
            machines.push(begun.expect("a machine"));
        }
    }
    let senders: Vec<Sender> = machines.iter().map(Machine::sender).collect();
    let before = peer.cpu_seconds();
    let pacing = std::thread::spawn(move || pace(&senders, load));
    let reading = machines.into_iter().map(|mut machine| {
        tokio::spawn(async move {
            let times = machine.read().await;
            (machine, times)
        })
    });
    let read = futures_util::future::join_all(reading.collect::<Vec<_>>()).await;
    let spent = peer.cpu_seconds() - before;
    pacing.join().expect("the pace");
    let (mut times, mut ends) = (Vec::new(), Vec::new());
    for read in read {
        let (machine, measured) = read.expect("a machine reads");
        times.extend(measured);
        ends.push(tokio::spawn(machine.end()));
    }
    for end in ends {
        end.await.expect("a machine ends");
    }
    times.sort_unstable();
    let at = |share: f64| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "an index"
        )]
        let index = (times.len() as f64 * share) as usize;
        times.get(index.min(times.len().saturating_sub(1))).copied().unwrap_or_default()
    };
    Outcome {
        messages: times.len() as u64,
        asked: u64::from(load.connections) * u64::from(load.samples()),
        spent,
        p50: at(0.5),
        p99: at(0.99),
    }
}

/// Connections that are opened at once.
const AT_ONCE: usize = 50;
/// Less than this ahead nobody sleeps: the kernel would wake a thread later than that.
const SHORTEST_SLEEP: Duration = Duration::from_micros(30);

/// Sends every sample of every machine when it is due, from one thread: a timer for each would cost more than the
/// message, and fire them all in the same millisecond.
fn pace(senders: &[Sender], load: Load) {
    let period = Duration::from_secs(1) / load.per_second;
    let begin = Instant::now() + period;
    for sample in 0..load.samples() {
        for (index, sender) in (0..).zip(senders) {
            let due = begin + period * sample + period * index / load.connections;
            let ahead = due.saturating_duration_since(Instant::now());
            if ahead > SHORTEST_SLEEP {
                std::thread::sleep(ahead);
            }
            sender.send(sample).expect("a message is sent");
        }
    }
}

static CYCLE: AtomicU32 = AtomicU32::new(0);

/// The sending end of a connection.
struct Sender {
    stream: std::net::TcpStream,
    wire: Wire,
    asked: Asked,
}

/// When each message was sent, ns since the connection began.
#[derive(Clone)]
struct Asked {
    begun: Instant,
    after_ns: Arc<[AtomicU64]>,
}

impl Sender {
    fn send(&self, sample: u32) -> std::io::Result<()> {
        // The echo's questions are all as long as its first one.
        let (n, number) = if self.wire.is_echo() { (0, 0) } else { (sample + 2, sample) };
        let question = question(self.wire, n, number);
        let after_ns = u64::try_from(self.asked.begun.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.asked.after_ns[sample as usize].store(after_ns, Ordering::Release);
        // A short message fits the kernel's buffer; a server that does not read ends the round.
        (&self.stream).write_all(&question)
    }
}

/// A connection, with a cycle that runs where it is a stream.
struct Machine {
    /// Buffered, so that an answer is one call of the kernel here as it is at the server.
    stream: BufReader<TcpStream>,
    spoken: Spoken,
    asked: Asked,
}

impl Machine {
    async fn begin(
        address: String,
        token: String,
        wire: Wire,
        load: Load,
        (index, round): (u32, usize),
    ) -> Self {
        let stream = TcpStream::connect(&address).await.expect("a connection");
        stream.set_nodelay(true).expect("an option");
        let mut stream = BufReader::with_capacity(1024, stream);
        let mut spoken = Spoken { wire, answer: Vec::new() };
        if wire.is_echo() {
            let lengths = [question(wire, 0, 0).len(), if wire == Wire::EchoBinary { 66 } else { 520 }];
            let head: Vec<u8> = lengths
                .iter()
                .flat_map(|length| u32::try_from(*length).expect("short").to_le_bytes())
                .collect();
            stream.write_all(&head).await.expect("a head");
            spoken.answer.resize(lengths[1], 0);
        } else {
            upgrade(&mut stream, &address, &token, index).await;
            let cycle = CYCLE.fetch_add(1, Ordering::Relaxed);
            let period_ms = 1000.0 / f64::from(load.per_second);
            let cycle = format!("b{index}-{round}-{cycle}");
            start(&mut stream, (index, &cycle), period_ms, &mut spoken).await;
        }
        let after_ns = (0..load.samples()).map(|_| AtomicU64::new(0)).collect();
        Self { stream, spoken, asked: Asked { begun: Instant::now(), after_ns } }
    }

    /// The same connection, to send on.
    fn sender(&self) -> Sender {
        let descriptor = self.stream.get_ref().as_fd().try_clone_to_owned().expect("a descriptor");
        Sender { stream: descriptor.into(), wire: self.spoken.wire, asked: self.asked.clone() }
    }

    /// Reads every answer; how long each took.
    async fn read(&mut self) -> Vec<Duration> {
        let Self { stream, spoken, asked } = self;
        let mut times = Vec::with_capacity(asked.after_ns.len());
        for after_ns in asked.after_ns.iter() {
            spoken.read(stream).await.expect("an answer");
            let after = Duration::from_nanos(after_ns.load(Ordering::Acquire));
            times.push(asked.begun.elapsed().saturating_sub(after));
        }
        times
    }

    /// Ends the cycle and waits until it is stored, so that nothing of it is left for another round.
    async fn end(mut self) {
        if self.spoken.wire.is_echo() {
            return;
        }
        let message = json!({"type": "end", "n": u32::MAX});
        self.stream.write_all(&frame(0x81, message.to_string().as_bytes())).await.expect("an end");
        self.spoken.read(&mut self.stream).await.expect("it ended");
        let text = String::from_utf8_lossy(&self.spoken.answer);
        assert!(text.contains("\"stored\""), "{text}");
    }
}

async fn upgrade(stream: &mut BufReader<TcpStream>, address: &str, token: &str, index: u32) {
    let request = format!(
        "GET /v1/machines/B{index}/stream HTTP/1.1\r\nhost: {address}\r\nupgrade: websocket\r\nconnection: Upgrade\r\n\
         sec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\nsec-websocket-version: 13\r\n\
         sec-websocket-protocol: feedwright.v1\r\nauthorization: Bearer {token}\r\n\r\n"
    );
    stream.write_all(request.as_bytes()).await.expect("an upgrade");
    let mut head = Vec::new();
    while !head.ends_with(b"\r\n\r\n") {
        head.push(stream.read_u8().await.expect("an answer to the upgrade"));
    }
    assert!(head.starts_with(b"HTTP/1.1 101"), "{}", String::from_utf8_lossy(&head));
}

async fn start(
    stream: &mut BufReader<TcpStream>,
    (index, cycle): (u32, &str),
    period_ms: f64,
    spoken: &mut Spoken,
) {
    let now = jiff::Timestamp::now().to_string();
    let message = json!({
        "type": "start", "n": 1, "cycle_id": cycle, "tool": format!("T{index}"), "operation": "O1",
        "started_at": now, "sent_at": now, "period_ms": period_ms, "channels": ["depth_mm", "feed_drive_load_percent", "spindle_load_percent"],
        "program": {"between": "held", "knots": [{"depth_mm": 0.0, "feed_mm_min": 150.0}]}
    });
    stream.write_all(&frame(0x81, message.to_string().as_bytes())).await.expect("a start");
    spoken.read(stream).await.expect("it started");
    let text = String::from_utf8_lossy(&spoken.answer);
    assert!(text.contains("\"started\""), "{text}");
}

/// A frame as a client has to send it; a mask of zeros leaves the payload as it is.
fn frame(first: u8, payload: &[u8]) -> Vec<u8> {
    let mut out = vec![first];
    match u8::try_from(payload.len()) {
        Ok(length) if length < 126 => out.push(0x80 | length),
        _ => {
            out.push(0x80 | 126);
            out.extend(u16::try_from(payload.len()).expect("a short message").to_be_bytes());
        }
    }
    out.extend([0; 4]);
    out.extend(payload);
    out
}

/// One sample of depth and both loads.
fn question(wire: Wire, n: u32, sample: u32) -> Vec<u8> {
    if matches!(wire, Wire::Binary | Wire::EchoBinary) {
        let mut payload = vec![1, 0, 1, 0];
        payload.extend(n.to_le_bytes());
        payload.extend(sample.to_le_bytes());
        for value in [i32::try_from(sample % 20_000).unwrap_or(0), 280, 360] {
            payload.extend(value.to_le_bytes());
        }
        return frame(0x82, &payload);
    }
    let text = format!(
        "{{\"type\":\"samples\",\"n\":{n},\"first\":{sample},\"depth_mm\":12.345,\
         \"feed_drive_load_percent\":28.0,\"spindle_load_percent\":36.0}}"
    );
    frame(0x81, text.as_bytes())
}

struct Spoken {
    wire: Wire,
    answer: Vec<u8>,
}

impl Spoken {
    /// Reads one answer, past pings.
    async fn read(&mut self, stream: &mut BufReader<TcpStream>) -> std::io::Result<()> {
        if self.wire.is_echo() {
            return stream.read_exact(&mut self.answer).await.map(drop);
        }
        loop {
            let mut head = [0; 2];
            stream.read_exact(&mut head).await?;
            let length = match head[1] & 0x7f {
                126 => usize::from(stream.read_u16().await?),
                127 => usize::try_from(stream.read_u64().await?).unwrap_or(usize::MAX),
                short => usize::from(short),
            };
            self.answer.resize(length, 0);
            stream.read_exact(&mut self.answer).await?;
            match head[0] & 0x0f {
                1 | 2 => return Ok(()),
                8 => return Err(std::io::Error::other("closed")),
                _ => stream.write_all(&frame(0x8a, &[])).await?,
            }
        }
    }
}

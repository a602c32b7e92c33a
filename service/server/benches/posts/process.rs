//! A server as a process of its own: what it costs is read from the kernel, not from itself.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Ticks of the kernel's processor times per second on Linux.
pub(crate) const TICKS: f64 = 100.0;
/// Longest time a server may take to start or to stop.
const PATIENCE: Duration = Duration::from_secs(30);

/// A server that runs.
pub(crate) struct Running {
    child: Child,
    pub(crate) address: String,
    pub(crate) token: String,
}

/// Names another server than the one that is built beside the bench: an older one, or one built otherwise.
const SERVER: &str = "FEEDWRIGHT_BENCH_SERVER";

impl Running {
    /// Feedwright in that directory, on a free port, with SQLite or the database at an address. Like its peers here it writes no
    /// line per request.
    pub(crate) async fn feedwright(dir: &Path, database: Option<&str>) -> Self {
        let port = free_port();
        let program = std::env::var_os(SERVER).unwrap_or_else(|| env!("CARGO_BIN_EXE_feedwright").into());
        let mut command = Command::new(program);
        if let Some(address) = database {
            command.args(["--set".to_owned(), format!("database.url={address}")]);
        }
        let mut child = command
            .args(["--data-dir".as_ref(), dir.as_os_str()])
            .args(["--set", "log.level=warn", "serve", "--listen", &format!("127.0.0.1:{port}")])
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the server starts");
        let lines = BufReader::new(child.stderr.take().expect("its messages")).lines();
        let (tell, told) = std::sync::mpsc::channel();
        // Reads to the end, so that the server never waits for somebody to read its messages.
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                if let Some(token) = line.split_whitespace().find(|word| word.starts_with("fwt_")) {
                    let _ = tell.send(token.to_owned());
                }
            }
        });
        let token = told.recv_timeout(PATIENCE).expect("the first start shows a token");
        let running = Self { child, address: format!("http://127.0.0.1:{port}"), token };
        running.answers("/healthz").await;
        running
    }

    /// Another program that listens on `port`.
    pub(crate) async fn program(mut command: Command, port: u16, health: &str) -> Self {
        let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the peer starts");
        let running = Self { child, address: format!("http://127.0.0.1:{port}"), token: String::new() };
        running.answers(health).await;
        running
    }

    /// Waits until it answers.
    async fn answers(&self, path: &str) {
        let begun = Instant::now();
        let client = reqwest::Client::new();
        loop {
            let answer = client.get(format!("{}{path}", self.address)).send().await;
            if answer.is_ok_and(|answer| answer.status().is_success()) {
                return;
            }
            assert!(begun.elapsed() < PATIENCE, "{} does not answer", self.address);
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    /// Its process id.
    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Processor time so far, s.
    pub(crate) fn cpu_seconds(&self) -> f64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.id())).expect("it runs");
        let fields: Vec<&str> = stat.rsplit_once(") ").expect("a name").1.split(' ').collect();
        let ticks = |at: usize| fields[at].parse::<f64>().expect("a number");
        (ticks(11) + ticks(12)) / TICKS
    }

    /// Resident memory, bytes.
    pub(crate) fn resident_bytes(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).expect("it runs");
        let line = status.lines().find(|line| line.starts_with("VmRSS:")).expect("a size");
        let kib: u64 = line.split_whitespace().nth(1).and_then(|text| text.parse().ok()).expect("a number");
        kib * 1024
    }

    /// Asks it to end, and waits.
    pub(crate) async fn stop(mut self) {
        let id = self.child.id().to_string();
        Command::new("kill").args(["-TERM", &id]).status().expect("kill");
        tokio::task::spawn_blocking(move || self.child.wait()).await.expect("a thread").expect("it ends");
    }
}

/// A port that was free a moment ago.
pub(crate) fn free_port() -> u16 {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    listener.local_addr().expect("its address").port()
}

//! The peers, each with the format that it reads fastest and 25 cycles a request, as their users do it.

use super::data::{Cycle, size_of};
use super::process::{Running, free_port};
use super::{ALONE, CYCLES, Round, round};
use std::fmt::Write;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Cycles in one request of a bulk import.
const BULK: usize = 25;

/// VictoriaMetrics over its JSON import. It answers before anything is on disk.
pub(crate) async fn victoria_metrics(cycles: &Arc<Vec<Cycle>>) -> Round {
    let dir = tempfile::tempdir().expect("a directory");
    let port = free_port();
    let mut command = Command::new("victoria-metrics");
    command.arg(format!("-storageDataPath={}", dir.path().display()));
    command.arg(format!("-httpListenAddr=127.0.0.1:{port}")).arg("-retentionPeriod=100y");
    let server = Running::program(command, port, "/health").await;
    let written = import(&server, "/api/v1/import", cycles, json_lines, dir.path()).await;
    server.stop().await;
    Round { bytes_per_value: bytes_per_value(dir.path(), cycles), ..written }
}

/// InfluxDB 1 over its line protocol.
pub(crate) async fn influxdb(cycles: &Arc<Vec<Cycle>>) -> Round {
    let dir = tempfile::tempdir().expect("a directory");
    let (port, rpc) = (free_port(), free_port());
    let config = dir.path().join("influxdb.conf");
    let at = |name: &str| dir.path().join(name).display().to_string();
    let text = format!(
        "reporting-disabled = true\nbind-address = \"127.0.0.1:{rpc}\"\n[meta]\ndir = \"{}\"\n[data]\ndir = \"{}\"\n\
         wal-dir = \"{}\"\n[http]\nbind-address = \"127.0.0.1:{port}\"\nlog-enabled = false\nmax-body-size = 0\n\
         [monitor]\nstore-enabled = false\n",
        at("meta"),
        at("data"),
        at("wal")
    );
    std::fs::write(&config, text).expect("its configuration");
    let mut command = Command::new("influxd");
    command.arg("-config").arg(&config);
    let server = Running::program(command, port, "/ping").await;
    let created = reqwest::Client::new().post(format!("{}/query?q=CREATE+DATABASE+shop", server.address));
    assert!(created.send().await.expect("an answer").status().is_success());
    let written = import(&server, "/write?db=shop&precision=ms", cycles, line_protocol, dir.path()).await;
    server.stop().await;
    Round { bytes_per_value: bytes_per_value(dir.path(), cycles), ..written }
}

#[expect(clippy::cast_precision_loss, reason = "figures for a table")]
fn bytes_per_value(dir: &Path, cycles: &[Cycle]) -> f64 {
    let values: usize = cycles.iter().map(Cycle::values).sum();
    size_of(dir) as f64 / values as f64
}

async fn import(
    server: &Running,
    path: &str,
    cycles: &[Cycle],
    body_of: fn(&[Cycle]) -> String,
    dir: &Path,
) -> Round {
    let client = reqwest::Client::new();
    let url = format!("{}{path}", server.address);
    let send = |body: String| {
        let request = client.post(&url).body(body);
        async move {
            let answer = request.send().await.expect("an answer");
            assert!(answer.status().is_success(), "{:?}", answer.text().await);
        }
    };
    let cpu = server.cpu_seconds();
    let mut values = 0;
    for bulk in cycles[..CYCLES].chunks(BULK) {
        send(body_of(bulk)).await;
        values += bulk.iter().map(Cycle::values).sum::<usize>();
    }
    let spent = server.cpu_seconds() - cpu;
    let mut alone: Vec<Duration> = Vec::with_capacity(ALONE);
    for cycle in cycles[CYCLES..].chunks(1) {
        let body = body_of(cycle);
        let begun = Instant::now();
        send(body).await;
        alone.push(begun.elapsed());
    }
    let stored: usize = cycles.iter().map(Cycle::values).sum();
    round(values, spent, alone, server.resident_bytes(), size_of(dir), stored)
}

fn json_lines(cycles: &[Cycle]) -> String {
    let mut out = String::new();
    for cycle in cycles {
        for (name, values) in &cycle.columns {
            let _ =
                write!(out, r#"{{"metric":{{"__name__":"{name}","machine":"{}"}},"values":["#, cycle.machine);
            for (index, value) in values.iter().enumerate() {
                let _ = write!(out, "{}{value}", if index == 0 { "" } else { "," });
            }
            out.push_str(r#"],"timestamps":["#);
            for index in 0..values.len() {
                let at = cycle.started_ms + 10 * index as u64;
                let _ = write!(out, "{}{at}", if index == 0 { "" } else { "," });
            }
            out.push_str("]}\n");
        }
    }
    out
}

fn line_protocol(cycles: &[Cycle]) -> String {
    let mut out = String::new();
    for cycle in cycles {
        for index in 0..cycle.samples() {
            let _ = write!(out, "samples,machine={} ", cycle.machine);
            for (at, (name, values)) in cycle.columns.iter().enumerate() {
                let _ = write!(out, "{}{name}={}", if at == 0 { "" } else { "," }, values[index]);
            }
            let _ = writeln!(out, " {}", cycle.started_ms + 10 * index as u64);
        }
    }
    out
}

//! The peers, each with the format that it reads fastest and 25 cycles a request, as their users do it.

use super::data::{Cycle, size_of};
use super::lone::Lone;
use super::place::{postmaster_of, seconds_below};
use super::process::{Running, free_port};
use super::rest::rest;
use super::{ALONE, CYCLES, Round, median, round};
use sqlx::{Connection, Executor, PgConnection};
use std::fmt::Write;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Cycles in one request of a bulk import.
const BULK: usize = 25;

/// VictoriaMetrics over its JSON import. It answers before anything is on disk. Its bytes are those after its merge.
pub(crate) async fn victoria_metrics(cycles: &Arc<Vec<Cycle>>) -> Round {
    let dir = tempfile::tempdir().expect("a directory");
    let port = free_port();
    let mut command = Command::new("victoria-metrics");
    command.arg(format!("-storageDataPath={}", dir.path().display()));
    command.arg(format!("-httpListenAddr=127.0.0.1:{port}")).arg("-retentionPeriod=100y");
    let server = Running::program(command, port, "/health").await;
    let written = import(&server, "/api/v1/import", cycles, json_lines, dir.path()).await;
    // What came last is searchable only after a flush.
    let mut lone = Lone::connect(&server.address, "");
    assert_eq!(lone.get("/internal/force_flush").1, 200);
    let mut reads = Vec::with_capacity(ALONE);
    for cycle in &cycles[..ALONE] {
        let end = cycle.started_ms + 10 * (cycle.samples() as u64 - 1);
        let path = format!(
            "/api/v1/export?match[]={{machine=\"{}\"}}&start={:.3}&end={:.3}",
            cycle.machine,
            seconds(cycle.started_ms),
            seconds(end)
        );
        let (time, status, bytes) = lone.get(&path.replace('"', "%22"));
        assert_eq!(status, 200);
        assert!(bytes > cycle.values(), "a whole cycle");
        reads.push(time);
    }
    assert_eq!(lone.get("/internal/force_merge").1, 200);
    at_rest(&server, dir.path()).await;
    // Beside them it leaves caches when it stops, of one size whatever it holds.
    let merged = ["data", "indexdb"].map(|name| bytes_per_value(&dir.path().join(name), cycles));
    server.stop().await;
    Round { read_p50: median(&mut reads), bytes_per_value: merged.iter().sum(), ..written }
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

/// Milliseconds as seconds.
#[expect(clippy::cast_precision_loss, reason = "far below 2^53")]
fn seconds(ms: u64) -> f64 {
    ms as f64 / 1e3
}

/// A time and eight values.
type SampleRow = (i64, f64, f64, f64, f64, f64, f64, f64, f64);

/// A row per sample in PostgreSQL: what filling it by COPY costs, before there is an index, what reading a cycle costs, and what
/// it takes on disk.
pub(crate) async fn postgres_rows(cycles: &Arc<Vec<Cycle>>) -> Round {
    let address = std::env::var("FEEDWRIGHT_TEST_POSTGRES").expect("behind tests/postgres");
    let mut server = PgConnection::connect(&address).await.expect("the server of tests/postgres");
    server.execute("DROP TABLE IF EXISTS samples").await.expect("a fresh table");
    server
        .execute(
            "CREATE TABLE samples (machine TEXT, at BIGINT, a FLOAT8, b FLOAT8, c FLOAT8, d FLOAT8, e FLOAT8,
                 f FLOAT8, g FLOAT8, h FLOAT8)",
        )
        .await
        .expect("a fresh table");
    let postmaster = postmaster_of(&mut server).await;
    let cpu = seconds_below(postmaster);
    for bulk in cycles.chunks(BULK) {
        let mut copy = server.copy_in_raw("COPY samples FROM STDIN").await.expect("a copy");
        let mut text = String::new();
        for cycle in bulk {
            for index in 0..cycle.samples() {
                let _ = write!(text, "{}\t{}", cycle.machine, cycle.started_ms + 10 * index as u64);
                for (_, values) in &cycle.columns {
                    let _ = write!(text, "\t{}", values[index]);
                }
                text.push('\n');
            }
        }
        copy.send(text.as_bytes()).await.expect("rows");
        copy.finish().await.expect("rows");
    }
    server.execute("CHECKPOINT").await.expect("nothing is put off");
    let spent = seconds_below(postmaster) - cpu;
    server.execute("CREATE INDEX samples_by_machine ON samples (machine, at)").await.expect("an index");
    server.execute("VACUUM ANALYZE samples").await.expect("statistics");
    let mut reads = Vec::with_capacity(ALONE);
    for cycle in &cycles[..ALONE] {
        let end = cycle.started_ms + 10 * (cycle.samples() as u64 - 1);
        let begun = Instant::now();
        let rows: Vec<SampleRow> = sqlx::query_as(
            "SELECT at, a, b, c, d, e, f, g, h FROM samples WHERE machine = $1 AND at BETWEEN $2 AND $3 ORDER BY at",
        )
        .bind(&cycle.machine)
        .bind(i64::try_from(cycle.started_ms).expect("a time"))
        .bind(i64::try_from(end).expect("a time"))
        .fetch_all(&mut server)
        .await
        .expect("rows");
        reads.push(begun.elapsed());
        assert_eq!(rows.len(), cycle.samples(), "a whole cycle");
    }
    let bytes: i64 = sqlx::query_scalar("SELECT pg_total_relation_size('samples')")
        .fetch_one(&mut server)
        .await
        .expect("a size");
    server.execute("DROP TABLE samples").await.expect("removed");
    let values: usize = cycles.iter().map(Cycle::values).sum();
    let filled = Round { read_p50: median(&mut reads), ..round(values, spent, (vec![], vec![]), 0, 0, 1) };
    #[expect(clippy::cast_precision_loss, reason = "figures for a table")]
    let bytes_per_value = bytes as f64 / values as f64;
    Round { bytes_per_value, resident: f64::NAN, ..filled }
}

#[expect(clippy::cast_precision_loss, reason = "figures for a table")]
fn bytes_per_value(dir: &Path, cycles: &[Cycle]) -> f64 {
    let values: usize = cycles.iter().map(Cycle::values).sum();
    size_of(dir) as f64 / values as f64
}

/// Processor time of a peer when it is at rest, s.
async fn at_rest(server: &Running, dir: &Path) -> f64 {
    rest(&server.address, || (server.cpu_seconds(), size_of(dir))).await
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
    let spent = at_rest(server, dir).await - cpu;
    let mut alone: Vec<Duration> = Vec::with_capacity(ALONE);
    let mut lone = Lone::connect(&server.address, "");
    for cycle in cycles[CYCLES..].chunks(1) {
        let (time, status, _) = lone.post(path, body_of(cycle).as_bytes());
        assert!((200..300).contains(&status), "{status}");
        alone.push(time);
    }
    let stored: usize = cycles.iter().map(Cycle::values).sum();
    round(values, spent, (alone, Vec::new()), server.resident_bytes(), size_of(dir), stored)
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

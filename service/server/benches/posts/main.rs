//! What one-cycle posts cost, beside the peers on the same data in the same run.
//!
//! `cargo bench -p feedwright-server --bench posts` measures Feedwright alone; with `-- --peers` it starts
//! VictoriaMetrics and InfluxDB too (Debian's packages `victoria-metrics` and `influxdb`) and prints ratios.
//! It never judges: absolute figures of a shared machine are noise, ratios of one run are the result.

mod data;
mod peers;
mod process;

use data::Cycle;
use process::Running;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Cycles of one round, as in a shop of 40 machines.
const CYCLES: usize = 4_000;
/// Clients that post at the same time in the throughput rounds.
const CLIENTS: usize = 8;
/// Cycles of the latency round: one client, one cycle a request.
const ALONE: usize = 500;
/// Rounds whose median is printed.
const ROUNDS: usize = 5;

/// What one system did in one round.
#[derive(Debug, Clone, Copy)]
struct Round {
    /// Values per second of the server's processor time.
    values_per_cpu_second: f64,
    /// Median time of a cycle posted alone, s.
    alone_p50: f64,
    /// 99th percentile of it, s.
    alone_p99: f64,
    /// Resident memory after the round, bytes.
    resident: f64,
    /// Bytes on disk per value after the round.
    bytes_per_value: f64,
}

fn main() {
    feedwright_server::tls::use_ring();
    let with_peers = std::env::args().any(|argument| argument == "--peers");
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("a runtime");
    let cycles = Arc::new(data::cycles(CYCLES + ALONE));
    let values: usize = cycles[..CYCLES].iter().map(Cycle::values).sum();
    println!(
        "{CYCLES} cycles, {values} values, {CLIENTS} clients; {ALONE} cycles alone; {ROUNDS} rounds, median (min–max)"
    );
    let mut rounds: Vec<(&str, Vec<Round>)> = vec![("feedwright", Vec::new())];
    if with_peers {
        rounds.push(("victoria-metrics", Vec::new()));
        rounds.push(("influxdb", Vec::new()));
    }
    // Round by round, not system by system: what drifts on the machine drifts for all of them.
    for _ in 0..ROUNDS {
        for (name, done) in &mut rounds {
            let round = match *name {
                "feedwright" => runtime.block_on(feedwright(&cycles)),
                "victoria-metrics" => runtime.block_on(peers::victoria_metrics(&cycles)),
                _ => runtime.block_on(peers::influxdb(&cycles)),
            };
            done.push(round);
        }
    }
    for (name, done) in &rounds {
        println!("\n{name}");
        show("  million values per server-CPU-second", done, |round| round.values_per_cpu_second / 1e6);
        show("  one cycle alone, p50 ms", done, |round| round.alone_p50 * 1e3);
        show("  one cycle alone, p99 ms", done, |round| round.alone_p99 * 1e3);
        show("  resident MiB", done, |round| round.resident / f64::from(1 << 20));
        show("  bytes per value on disk", done, |round| round.bytes_per_value);
    }
    let ours = rounds[0].1.clone();
    for (name, theirs) in &rounds[1..] {
        println!("\nfeedwright × {name}, pair by pair");
        for (what, of) in [
            ("  values per server-CPU-second", (|round| round.values_per_cpu_second) as fn(&Round) -> f64),
            ("  one cycle alone, p50", |round| round.alone_p50),
            ("  resident memory", |round| round.resident),
            ("  bytes per value on disk", |round| round.bytes_per_value),
        ] {
            let ratios: Vec<f64> = ours.iter().zip(theirs).map(|(our, their)| of(our) / of(their)).collect();
            print_spread(what, ratios);
        }
    }
}

fn show(what: &str, rounds: &[Round], of: impl Fn(&Round) -> f64) {
    print_spread(what, rounds.iter().map(of).collect());
}

fn print_spread(what: &str, mut values: Vec<f64>) {
    values.sort_by(f64::total_cmp);
    println!("{what}: {:.3} ({:.3}–{:.3})", values[values.len() / 2], values[0], values[values.len() - 1]);
}

/// One round of Feedwright: a server of its own on SQLite, everything switched on.
async fn feedwright(cycles: &Arc<Vec<Cycle>>) -> Round {
    let dir = tempfile::tempdir().expect("a directory");
    let server = Running::feedwright(dir.path()).await;
    let client = reqwest::Client::new();
    data::register(&client, &server.address, &server.token).await;
    let (cpu, values) = (server.cpu_seconds(), AtomicUsize::new(0));
    let next = Arc::new(AtomicUsize::new(0));
    let values = Arc::new(values);
    let posters = (0..CLIENTS).map(|_| {
        let (client, cycles, next, values) = (client.clone(), cycles.clone(), next.clone(), values.clone());
        let (address, token) = (server.address.clone(), server.token.clone());
        tokio::spawn(async move {
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                let Some(cycle) = cycles[..CYCLES].get(index) else { return };
                post(&client, &address, &token, cycle).await;
                values.fetch_add(cycle.values(), Ordering::Relaxed);
            }
        })
    });
    for poster in posters.collect::<Vec<_>>() {
        poster.await.expect("every post is acknowledged");
    }
    let spent = server.cpu_seconds() - cpu;
    let mut alone = Vec::with_capacity(ALONE);
    for cycle in &cycles[CYCLES..] {
        let begun = Instant::now();
        post(&client, &server.address, &server.token, cycle).await;
        alone.push(begun.elapsed());
    }
    let resident = server.resident_bytes();
    server.stop().await;
    let stored: usize = cycles.iter().map(Cycle::values).sum();
    round(values.load(Ordering::Relaxed), spent, alone, resident, data::size_of(dir.path()), stored)
}

async fn post(client: &reqwest::Client, address: &str, token: &str, cycle: &Cycle) {
    let url = format!("{address}/v1/machines/{}/cycles", cycle.machine);
    let request = client.post(url).bearer_auth(token).header("content-type", "application/json");
    let answer = request.body(cycle.json()).send().await.expect("an answer");
    assert_eq!(answer.status().as_u16(), 201, "{:?}", answer.text().await);
    answer.bytes().await.expect("a whole answer");
}

#[expect(clippy::cast_precision_loss, reason = "figures for a table")]
fn round(
    values: usize,
    cpu: f64,
    mut alone: Vec<Duration>,
    resident: u64,
    bytes: u64,
    stored: usize,
) -> Round {
    alone.sort();
    Round {
        values_per_cpu_second: values as f64 / cpu,
        alone_p50: alone[alone.len() / 2].as_secs_f64(),
        alone_p99: alone[alone.len() * 99 / 100].as_secs_f64(),
        resident: resident as f64,
        bytes_per_value: bytes as f64 / stored as f64,
    }
}

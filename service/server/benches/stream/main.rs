//! What a message of the closed loop costs, beside a raw TCP echo of the same bytes in the same run.
//!
//! `cargo bench -p feedwright-server --bench stream` runs, in turn and several times: the echo and the stream with the
//! same connections at the same pace, one sample in and one override out, binary and text. It prints the processor
//! time of the server per message, their ratio, and the round trip's percentiles: at the pace of the target, at a
//! fourth of it, and with 500 machines at 100 Hz; with `-- --climb` it raises the pace on one core (`taskset`) until the
//! 99th percentile exceeds one interpolator cycle.
//! It never judges: absolute figures of a shared machine are noise, ratios of one run are the result.

#[path = "../posts/process.rs"]
mod process;

mod client;
mod echo;

use client::{Load, Outcome, Wire};
use process::Running;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Rounds whose median is printed.
const ROUNDS: usize = 5;
/// As many messages a second as the target asks of one core, and some more.
const COMPARED: Load = Load { connections: 100, per_second: 400, seconds: 4 };
/// A server that mostly idles: each message pays for waking up.
const IDLING: Load = Load { connections: 50, per_second: 200, seconds: 4 };
/// The shop of the target.
const SHOP: Load = Load { connections: 500, per_second: 100, seconds: 4 };
/// One interpolator cycle.
const ONE_IPO: Duration = Duration::from_millis(10);

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    feedwright_server::tls::use_ring();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("a runtime");
    if let Some(at) = arguments.iter().position(|argument| argument == "--echo") {
        runtime.block_on(echo::serve(arguments[at + 1].parse().expect("a port")));
        return;
    }
    runtime.block_on(async {
        for load in [COMPARED, IDLING, SHOP] {
            compare(load).await;
        }
        if arguments.iter().any(|argument| argument == "--climb") {
            climb().await;
        }
    });
}

/// The echo as a process of its own, so that the kernel tells its processor time apart.
async fn echo() -> Running {
    let port = process::free_port();
    let mut command = Command::new(std::env::current_exe().expect("this bench"));
    command.args(["--echo", &port.to_string()]).stderr(Stdio::inherit());
    Running::program(command, port, "/healthz").await
}

async fn server(dir: &tempfile::TempDir) -> Running {
    let server = Running::feedwright(dir.path(), None).await;
    client::register(&server, SHOP.connections).await;
    server
}

fn median(mut values: Vec<f64>) -> (f64, f64, f64) {
    values.sort_by(f64::total_cmp);
    (values[values.len() / 2], values[0], values[values.len() - 1])
}

async fn compare(load: Load) {
    let dir = tempfile::tempdir().expect("a folder");
    let server = server(&dir).await;
    let echo = echo().await;
    println!("{load:?}, {ROUNDS} rounds, median (min-max)");
    let mut costs: Vec<(&str, Wire, Vec<f64>, Vec<Outcome>)> = vec![
        ("echo of the binary's bytes", Wire::EchoBinary, vec![], vec![]),
        ("stream, binary", Wire::Binary, vec![], vec![]),
        ("echo of the text's bytes", Wire::EchoText, vec![], vec![]),
        ("stream, text", Wire::Text, vec![], vec![]),
    ];
    // Round by round, not system by system: what drifts on the machine drifts for all of them.
    for round in 0..ROUNDS {
        for (_, wire, cost, outcomes) in &mut costs {
            let peer = if wire.is_echo() { &echo } else { &server };
            let outcome = client::run(peer, *wire, load, round).await;
            assert_eq!(outcome.messages, outcome.asked, "every message is answered");
            #[expect(clippy::cast_precision_loss, reason = "a few million")]
            cost.push(outcome.spent * 1e6 / outcome.messages as f64);
            outcomes.push(outcome);
        }
    }
    for (name, _, cost, outcomes) in &costs {
        let (middle, low, high) = median(cost.clone());
        let p50 = median(outcomes.iter().map(|outcome| outcome.p50.as_secs_f64() * 1e3).collect());
        let p99 = median(outcomes.iter().map(|outcome| outcome.p99.as_secs_f64() * 1e3).collect());
        println!(
            "{name}: {middle:.1} us of CPU a message ({low:.1}-{high:.1}), round trip p50 {:.2} ms, p99 {:.2} ms ({:.2}-{:.2})",
            p50.0, p99.0, p99.1, p99.2
        );
    }
    for (stream, echo) in [(1, 0), (3, 2)] {
        let ratios = costs[stream].2.iter().zip(&costs[echo].2).map(|(stream, echo)| stream / echo).collect();
        let (middle, low, high) = median(ratios);
        println!("{} x {}: {middle:.2} ({low:.2}-{high:.2})", costs[stream].0, costs[echo].0);
    }
    println!("{} MiB resident", server.resident_bytes() >> 20);
    echo.stop().await;
    server.stop().await;
}

/// Raises the pace until an answer in a hundred takes longer than an interpolator cycle.
async fn climb() {
    let dir = tempfile::tempdir().expect("a folder");
    let server = server(&dir).await;
    // All of the server's threads on one core; the clients keep the other.
    let pinned = Command::new("taskset")
        .args(["-a", "-p", "-c", "0", &server.id().to_string()])
        .stdout(Stdio::null())
        .status();
    println!(
        "on one core: {}",
        if pinned.is_ok_and(|status| status.success()) { "pinned" } else { "NOT pinned" }
    );
    let mut best = 0;
    for per_second in [100, 200, 300, 400, 500, 600, 800, 1000, 1200] {
        let load = Load { connections: 100, per_second, seconds: 3 };
        let outcome = client::run(&server, Wire::Binary, load, per_second as usize).await;
        let rate = outcome.messages / u64::from(load.seconds);
        println!(
            "{rate} messages/s: p50 {:.2} ms, p99 {:.2} ms",
            outcome.p50.as_secs_f64() * 1e3,
            outcome.p99.as_secs_f64() * 1e3
        );
        if outcome.p99 > ONE_IPO || outcome.messages < outcome.asked * 95 / 100 {
            break;
        }
        best = rate;
    }
    println!("most with p99 below 10 ms: {best} messages/s");
    server.stop().await;
}

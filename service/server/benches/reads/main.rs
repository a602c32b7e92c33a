//! What it costs to ask for the energy of a tool's last 500 cycles, beside VictoriaMetrics with the same energies as a
//! series of its own.
//!
//! `cargo bench -p feedwright-server --bench reads` needs Debian's package `victoria-metrics`. It never judges: absolute
//! figures of a shared machine are noise, ratios of one run are the result.

#[path = "../posts/lone.rs"]
mod lone;
#[path = "../posts/process.rs"]
mod process;

use lone::Lone;
use process::{Running, free_port};
use serde_json::{Value, json};
use std::fmt::Write;
use std::process::Command;
use std::time::Duration;

/// Tools of the shop, each on a machine of its own.
const TOOLS: usize = 40;
/// Cycles of each tool, a minute apart.
const CYCLES: usize = 1_000;
/// Cycles that are asked for.
const LAST: usize = 500;
/// Questions of a round.
const QUESTIONS: usize = 300;
/// Cycles of a round that are stored each just before its tool is asked for.
const FRESH: usize = 80;
/// Rounds whose median is printed.
const ROUNDS: usize = 7;
/// 2026-05-04T06:00:00Z in milliseconds.
const MORNING_MS: u64 = 1_777_874_400_000;

/// What one system took in one round.
#[derive(Clone, Copy)]
struct Round {
    p50: f64,
    p99: f64,
    cpu: f64,
}

fn main() {
    feedwright_server::tls::use_ring();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("a runtime");
    runtime.block_on(run());
}

/// An energy that wears up, with a control's digits.
fn energy(tool: usize, cycle: usize) -> f64 {
    let noise = (tool * 7919 + cycle * 104_729) % 1000;
    f64::from(u32::try_from(20_000 + cycle + noise).expect("a small number")) / 10.0
}

async fn run() {
    println!(
        "{TOOLS} tools × {CYCLES} cycles; the last {LAST} of one tool, {QUESTIONS} times; {ROUNDS} rounds, median (min–max)"
    );
    let client = reqwest::Client::new();
    let dir = tempfile::tempdir().expect("a directory");
    let ours = Running::feedwright(dir.path(), None).await;
    fill(&client, &ours).await;

    let peer_dir = tempfile::tempdir().expect("a directory");
    let port = free_port();
    let mut command = Command::new("victoria-metrics");
    command.arg(format!("-storageDataPath={}", peer_dir.path().display()));
    command.arg(format!("-httpListenAddr=127.0.0.1:{port}")).arg("-retentionPeriod=100y");
    let peer = Running::program(command, port, "/health").await;
    fill_peer(&client, &peer).await;

    let (mut our_rounds, mut their_rounds) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        our_rounds.push(round(&client, &ours, our_question, our_answer).await);
        their_rounds.push(round(&client, &peer, their_question, their_answer).await);
    }
    let mut fresh = after_each_cycle(&ours);
    fresh.sort();
    check_fresh(&client, &ours).await;
    for (name, rounds, server) in
        [("feedwright", &our_rounds, &ours), ("victoria-metrics", &their_rounds, &peer)]
    {
        println!("\n{name}");
        show("  p50 ms", rounds.iter().map(|round| round.p50 * 1e3).collect());
        show("  p99 ms", rounds.iter().map(|round| round.p99 * 1e3).collect());
        show("  processor time of an answer, ms", rounds.iter().map(|round| round.cpu * 1e3).collect());
        println!("  resident MiB: {}", server.resident_bytes() >> 20);
    }
    println!(
        "\nfeedwright, asked just after a new cycle of the tool: p50 ms {:.3}",
        fresh[FRESH / 2].as_secs_f64() * 1e3
    );
    println!("\nfeedwright × victoria-metrics, pair by pair");
    let pairs = || our_rounds.iter().zip(&their_rounds);
    show("  p50", pairs().map(|(our, their)| our.p50 / their.p50).collect());
    show("  processor time", pairs().map(|(our, their)| our.cpu / their.cpu).collect());
    ours.stop().await;
    peer.stop().await;
}

fn show(what: &str, mut values: Vec<f64>) {
    values.sort_by(f64::total_cmp);
    println!("{what}: {:.3} ({:.3}–{:.3})", values[values.len() / 2], values[0], values[values.len() - 1]);
}

async fn fill(client: &reqwest::Client, server: &Running) {
    let put = |path: String, body: Value| {
        let request = client.put(format!("{}{path}", server.address)).bearer_auth(&server.token).json(&body);
        async move {
            let answer = request.send().await.expect("an answer");
            assert_eq!(answer.status().as_u16(), 201, "{:?}", answer.text().await);
        }
    };
    let operation = json!({"name": "bush", "process": "friction", "programmed_feed_mm_min": 140});
    put("/v1/operations/bush".to_owned(), operation).await;
    for tool in 0..TOOLS {
        let machine = json!({
            "name": format!("machine {tool}"), "control": "sinumerik-840d", "ipo_period_ms": 10,
            "spindle": {"reference": "rated_power", "rated_power_watts": 7000},
            "feed_drive": {"reference": "rated_torque", "rated_thrust_newtons": 5000},
            "limits": {"feed_min_mm_min": 1, "feed_max_mm_min": 5000, "override_min_percent": 5, "override_max_percent": 200}
        });
        put(format!("/v1/machines/M{tool}"), machine).await;
        put(format!("/v1/tools/T{tool}"), json!({"name": "drill", "tool_type": "fd"})).await;
        let mut lines = String::new();
        for cycle in 0..CYCLES {
            let (hour, minute) = (6 + cycle / 60, cycle % 60);
            let _ = writeln!(
                lines,
                r#"{{"cycle_id":"c{cycle:06}","tool":"T{tool}","operation":"bush","started_at":"2026-05-{:02}T{:02}:{minute:02}:00Z","reported":{{"energy_joules":{},"duration_ms":4280}}}}"#,
                4 + hour / 24,
                hour % 24,
                energy(tool, cycle)
            );
        }
        let url = format!("{}/v1/machines/M{tool}/cycles/batch", server.address);
        let post = client.post(url).bearer_auth(&server.token).header("content-type", "application/x-ndjson");
        let answer = post.body(lines).send().await.expect("an answer").text().await.expect("a whole answer");
        assert_eq!(answer.matches("\"stored\"").count(), CYCLES, "{answer}");
    }
}

async fn fill_peer(client: &reqwest::Client, server: &Running) {
    let mut lines = String::new();
    for tool in 0..TOOLS {
        let values: Vec<_> = (0..CYCLES).map(|cycle| energy(tool, cycle)).collect();
        let times: Vec<_> = (0..CYCLES).map(|cycle| MORNING_MS + 60_000 * cycle as u64).collect();
        let line = json!({"metric": {"__name__": "energy_joules", "tool": format!("T{tool}")}, "values": values, "timestamps": times});
        let _ = writeln!(lines, "{line}");
    }
    let answer = client.post(format!("{}/api/v1/import", server.address)).body(lines).send().await;
    assert!(answer.expect("an answer").status().is_success());
    // What was imported is seen once it is flushed.
    let flushed = client.get(format!("{}/internal/force_flush", server.address)).send().await;
    assert!(flushed.expect("an answer").status().is_success());
}

fn our_question(tool: usize) -> String {
    format!("/v1/series?tool=T{tool}&last={LAST}")
}

fn our_answer(tool: usize, body: &str) {
    let answer: Value = serde_json::from_str(body).expect("JSON");
    check(tool, answer["series"][0]["value"].as_array().expect("values"));
}

/// Raw points, as its export gives them; it is told from when on (seconds), which spares it to find the last ones.
fn their_question(tool: usize) -> String {
    let from = MORNING_MS / 1000 + 60 * (CYCLES - LAST) as u64;
    format!(
        "/api/v1/export?match[]=energy_joules%7Btool%3D%22T{tool}%22%7D&start={from}&end={}",
        MORNING_MS / 1000 + 86_400
    )
}

fn their_answer(tool: usize, body: &str) {
    let answer: Value = serde_json::from_str(body).expect("JSON");
    check(tool, answer["values"].as_array().expect("values"));
}

/// Both answer the same energies.
fn check(tool: usize, values: &[Value]) {
    let wanted: Vec<_> = (CYCLES - LAST..CYCLES).map(|cycle| energy(tool, cycle)).collect();
    let found: Vec<_> = values.iter().filter_map(Value::as_f64).collect();
    assert_eq!(found, wanted);
}

#[expect(clippy::cast_precision_loss, reason = "figures for a table")]
async fn round(
    client: &reqwest::Client,
    server: &Running,
    question: fn(usize) -> String,
    check: fn(usize, &str),
) -> Round {
    // One client of one connection, for both: no runtime wakes threads of its own while a server is timed.
    let mut lone = Lone::connect(&server.address, &authorization(server));
    let cpu = server.cpu_seconds();
    let mut times: Vec<Duration> = Vec::with_capacity(QUESTIONS);
    for at in 0..QUESTIONS {
        let (time, status, _) = lone.get(&question(at * 7 % TOOLS));
        assert_eq!(status, 200);
        times.push(time);
    }
    let cpu = server.cpu_seconds() - cpu;
    for tool in 0..TOOLS {
        let mut request = client.get(format!("{}{}", server.address, question(tool)));
        if !server.token.is_empty() {
            request = request.bearer_auth(&server.token);
        }
        let answer = request.send().await.expect("an answer").text().await.expect("a whole answer");
        check(tool, &answer);
    }
    times.sort();
    Round {
        p50: times[times.len() / 2].as_secs_f64(),
        p99: times[times.len() * 99 / 100].as_secs_f64(),
        cpu: cpu / QUESTIONS as f64,
    }
}

fn authorization(server: &Running) -> String {
    if server.token.is_empty() {
        String::new()
    } else {
        format!("authorization: Bearer {}\r\n", server.token)
    }
}

/// Every tool's newest cycle is the last that was stored of it.
async fn check_fresh(client: &reqwest::Client, server: &Running) {
    for tool in 0..TOOLS {
        let newest = (0..FRESH).rev().find(|at| at * 7 % TOOLS == tool).expect("a cycle of each tool");
        let request =
            client.get(format!("{}{}", server.address, our_question(tool))).bearer_auth(&server.token);
        let answer = request.send().await.expect("an answer").text().await.expect("a whole answer");
        let answer: Value = serde_json::from_str(&answer).expect("JSON");
        let ids = answer["series"][0]["cycle_id"].as_array().expect("ids");
        assert_eq!(ids.last(), Some(&json!(format!("fresh{newest:06}"))));
    }
}

/// How long the question takes just after a new cycle of the tool: nothing of the answer before may be given again as
/// it was.
fn after_each_cycle(server: &Running) -> Vec<Duration> {
    let json = format!("{}content-type: application/json\r\n", authorization(server));
    let mut machine = Lone::connect(&server.address, &json);
    let mut reader = Lone::connect(&server.address, &authorization(server));
    let ask = |at: usize| {
        let tool = at * 7 % TOOLS;
        let body = format!(
            r#"{{"cycle_id":"fresh{at:06}","tool":"T{tool}","operation":"bush","started_at":"2026-06-01T06:{:02}:{:02}Z","reported":{{"energy_joules":{},"duration_ms":4280}}}}"#,
            at / 60,
            at % 60,
            energy(tool, CYCLES + at)
        );
        let (_, status, _) = machine.post(&format!("/v1/machines/M{tool}/cycles"), body.as_bytes());
        assert_eq!(status, 201);
        let (time, status, _) = reader.get(&our_question(tool));
        assert_eq!(status, 200);
        time
    };
    (0..FRESH).map(ask).collect()
}

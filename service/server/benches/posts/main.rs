//! What one-cycle posts cost, beside the peers on the same data in the same run.
//!
//! `cargo bench -p feedwright-server --bench posts` measures Feedwright alone, with JSON and with the binary form; with
//! `-- --peers` it starts VictoriaMetrics and InfluxDB too (Debian's packages `victoria-metrics` and `influxdb`) and
//! prints ratios; behind `tests/postgres` it also fills rows of PostgreSQL and reads cycles out of them. With `-- --postgres`,
//! behind `tests/postgres`, Feedwright keeps its cycles in that server: its processor time counts as Feedwright's does.
//! `-- --weekend` replays 96,000 cycles of 200 machines while others post live; `-- --growth 10000000` tells what so
//! many cycles do to the cost of the next one; `-- --stages` tells what each step of a post costs by itself, or those with `-- --stages PART` in their names;
//! `-- --bytes` tells where the bytes of a database go, with `-- --postgres` of that one, and `-- --blocks` what samples of many cycles in one block would save.
//! It never judges: absolute figures of a shared machine are noise, ratios of one run are the result.

mod blocks;
mod bytes;
mod data;
mod growth;
mod lone;
mod peers;
mod place;
mod process;
mod rest;
mod stages;
mod weekend;

use data::Cycle;
use lone::Lone;
use place::{Engine, Ours};
use process::Running;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Cycles of one round, as in a shop of 40 machines.
const CYCLES: usize = 4_000;
/// Clients that post at the same time in the throughput rounds: every machine has its own connection.
const CLIENTS: usize = data::MACHINES;
/// Cycles of the latency round: one client, one cycle a request.
const ALONE: usize = 500;
/// Rounds whose median is printed, unless `--rounds` gives another number.
const ROUNDS: usize = 5;

/// What one system did in one round.
#[derive(Debug, Clone, Copy)]
struct Round {
    /// Values per second of the server's processor time, what it does afterwards before it is at rest included.
    values_per_cpu_second: f64,
    /// What the server of a database has of that time.
    database: f64,
    /// Cycles of a commit, on average, while many post.
    group: f64,
    /// Median time of a cycle posted alone, s.
    alone_p50: f64,
    /// 99th percentile of it, s.
    alone_p99: f64,
    /// Median time of reading one whole cycle, s.
    read_p50: f64,
    /// Resident memory after the round, bytes.
    resident: f64,
    /// Bytes on disk per value after the round.
    bytes_per_value: f64,
}

/// Something that takes cycles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum System {
    Json,
    Binary,
    JsonMinimal,
    BinaryMinimal,
    VictoriaMetrics,
    InfluxDb,
    PostgresRows,
}

impl System {
    /// Ours, JSON and binary form as they come first.
    const OURS: [Self; 4] = [Self::Json, Self::Binary, Self::JsonMinimal, Self::BinaryMinimal];

    const fn name(self) -> &'static str {
        match self {
            Self::Json => "feedwright",
            Self::Binary => "feedwright, binary form",
            Self::JsonMinimal => "feedwright, minimal answers",
            Self::BinaryMinimal => "feedwright, binary form, minimal answers",
            Self::VictoriaMetrics => "victoria-metrics",
            Self::InfluxDb => "influxdb",
            Self::PostgresRows => "postgresql, a row per sample",
        }
    }
}

fn main() {
    feedwright_server::tls::use_ring();
    let arguments: Vec<String> = std::env::args().collect();
    let given = |name: &str| arguments.iter().position(|argument| argument == name);
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("a runtime");
    if given("--blocks").is_some() {
        return blocks::measure();
    }
    if let Some(at) = given("--stages") {
        // Cargo adds an option of its own behind those that it is given.
        let part = arguments.get(at + 1).filter(|argument| !argument.starts_with("--"));
        return stages::measure(part.map_or("", String::as_str));
    }
    let engine = given("--postgres").map_or(Engine::Sqlite, |_| Engine::Postgres);
    if given("--bytes").is_some() {
        return runtime.block_on(bytes::tell(engine));
    }
    if given("--weekend").is_some() {
        return runtime.block_on(weekend::replay(engine));
    }
    if let Some(at) = given("--growth") {
        let cycles = arguments.get(at + 1).and_then(|text| text.parse().ok());
        return runtime.block_on(growth::grow(engine, cycles.expect("--growth CYCLES")));
    }
    let count_of = |at: usize| arguments.get(at + 1).and_then(|text| text.parse().ok());
    let repeated: usize = given("--rounds").map_or(ROUNDS, |at| count_of(at).expect("--rounds NUMBER"));
    assert!(repeated > 0, "--rounds 0 measures nothing");
    let cycles = Arc::new(data::cycles(CYCLES + ALONE));
    let values: usize = cycles[..CYCLES].iter().map(Cycle::values).sum();
    println!(
        "{CYCLES} cycles, {values} values, {CLIENTS} clients; {ALONE} cycles alone; {repeated} rounds, median (min–max)"
    );
    let mut systems = System::OURS.to_vec();
    if given("--peers").is_some() {
        systems.extend([System::VictoriaMetrics, System::InfluxDb]);
        if std::env::var_os("FEEDWRIGHT_TEST_POSTGRES").is_some() {
            systems.push(System::PostgresRows);
        }
    }
    let mut rounds: Vec<(System, Vec<Round>)> =
        systems.into_iter().map(|system| (system, Vec::new())).collect();
    // Round by round, not system by system: what drifts on the machine drifts for all of them.
    for _ in 0..repeated {
        for (system, done) in &mut rounds {
            let round = match system {
                System::Json => runtime.block_on(feedwright(engine, &cycles, &JSON, WHOLE)),
                System::Binary => runtime.block_on(feedwright(engine, &cycles, &BINARY, WHOLE)),
                System::JsonMinimal => runtime.block_on(feedwright(engine, &cycles, &JSON, MINIMAL)),
                System::BinaryMinimal => runtime.block_on(feedwright(engine, &cycles, &BINARY, MINIMAL)),
                System::VictoriaMetrics => runtime.block_on(peers::victoria_metrics(&cycles)),
                System::InfluxDb => runtime.block_on(peers::influxdb(&cycles)),
                // On one thread, as the client of the others while they are read.
                System::PostgresRows => one_thread().block_on(peers::postgres_rows(&cycles)),
            };
            done.push(round);
        }
    }
    for (system, done) in &rounds {
        println!("\n{}", system.name());
        show("  million values per server-CPU-second", done, |round| round.values_per_cpu_second / 1e6);
        show("  of its processor time the database's", done, |round| round.database);
        show("  cycles a commit", done, |round| round.group);
        show("  one cycle alone, p50 ms", done, |round| round.alone_p50 * 1e3);
        show("  one cycle alone, p99 ms", done, |round| round.alone_p99 * 1e3);
        show("  one whole cycle read, p50 ms", done, |round| round.read_p50 * 1e3);
        show("  resident MiB", done, |round| round.resident / f64::from(1 << 20));
        show("  bytes per value on disk", done, |round| round.bytes_per_value);
    }
    for ours in 0..System::OURS.len() {
        for (system, theirs) in &rounds[System::OURS.len()..] {
            println!("\n{} × {}, pair by pair", rounds[ours].0.name(), system.name());
            for (what, of) in [
                (
                    "  values per server-CPU-second",
                    (|round| round.values_per_cpu_second) as fn(&Round) -> f64,
                ),
                ("  one cycle alone, p50", |round| round.alone_p50),
                ("  one whole cycle read, p50", |round| round.read_p50),
                ("  resident memory", |round| round.resident),
                ("  bytes per value on disk", |round| round.bytes_per_value),
            ] {
                let pairs = rounds[ours].1.iter().zip(theirs);
                print_spread(what, pairs.map(|(our, their)| of(our) / of(their)).collect());
            }
        }
    }
}

fn one_thread() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime")
}

fn show(what: &str, rounds: &[Round], of: impl Fn(&Round) -> f64) {
    print_spread(what, rounds.iter().map(of).collect());
}

fn print_spread(what: &str, mut values: Vec<f64>) {
    if values.iter().any(|value| !value.is_finite()) {
        return;
    }
    values.sort_by(f64::total_cmp);
    println!("{what}: {:.3} ({:.3}–{:.3})", values[values.len() / 2], values[0], values[values.len() - 1]);
}

/// A form of body.
struct Form {
    media_type: &'static str,
    body: fn(&Cycle) -> Vec<u8>,
}

const JSON: Form = Form { media_type: "application/json", body: |cycle| cycle.json().into_bytes() };
const BINARY: Form = Form { media_type: feedwright_store::wire::MEDIA_TYPE, body: Cycle::frame };

/// How much of an answer is preferred.
const WHOLE: &str = "return=representation";
const MINIMAL: &str = "return=minimal";

/// One round of Feedwright: a server of its own, everything switched on.
async fn feedwright(engine: Engine, cycles: &Arc<Vec<Cycle>>, form: &Form, prefer: &'static str) -> Round {
    let mut ours = Ours::start(engine).await;
    let server = &ours.server;
    let client = reqwest::Client::new();
    data::register(&client, &server.address, &server.token, data::MACHINES).await;
    let bodies: Arc<Vec<Vec<u8>>> = Arc::new(cycles.iter().map(form.body).collect());
    let (cpu, database) = (ours.cpu_seconds(), ours.database_seconds());
    post_all(&client, server, (cycles, &bodies), (form.media_type, prefer)).await;
    let spent = ours.rest().await - cpu;
    let share = (engine == Engine::Postgres).then(|| (ours.database_seconds() - database) / spent);
    let server = &ours.server;
    let group = mean_group(&client, server).await;
    let headers = format!(
        "authorization: Bearer {}\r\ncontent-type: {}\r\nprefer: {prefer}\r\n",
        server.token, form.media_type
    );
    let mut lone = Lone::connect(&server.address, &headers);
    let mut alone = Vec::with_capacity(ALONE);
    for (cycle, body) in cycles.iter().zip(bodies.iter()).skip(CYCLES) {
        let (time, status, _) = lone.post(&format!("/v1/machines/{}/cycles", cycle.machine), body);
        assert_eq!(status, 201);
        alone.push(time);
    }
    let mut reads = Vec::with_capacity(ALONE);
    for cycle in &cycles[..ALONE] {
        let path = format!("/v1/machines/{}/cycles/{}/samples", cycle.machine, cycle.id);
        let (time, status, bytes) = lone.get(&path);
        assert_eq!(status, 200);
        assert!(bytes > cycle.values(), "a whole cycle");
        reads.push(time);
    }
    let resident = server.resident_bytes();
    let bytes = ours.end().await;
    let stored: usize = cycles.iter().map(Cycle::values).sum();
    let values = cycles[..CYCLES].iter().map(Cycle::values).sum();
    let database = share.unwrap_or(f64::NAN);
    Round { group, database, ..round(values, spent, (alone, reads), resident, bytes, stored) }
}

/// Posts the first [`CYCLES`] of them, by as many clients as there are machines.
async fn post_all(
    client: &reqwest::Client,
    server: &Running,
    (cycles, bodies): (&Arc<Vec<Cycle>>, &Arc<Vec<Vec<u8>>>),
    (media_type, prefer): (&'static str, &'static str),
) {
    let next = Arc::new(AtomicUsize::new(0));
    let posters = (0..CLIENTS).map(|_| {
        let (client, cycles, bodies, next) = (client.clone(), cycles.clone(), bodies.clone(), next.clone());
        let (address, token) = (server.address.clone(), server.token.clone());
        tokio::spawn(async move {
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                let Some(cycle) = cycles[..CYCLES].get(index) else { return };
                post(&client, &address, &token, cycle, (media_type, prefer), bodies[index].clone()).await;
            }
        })
    });
    for poster in posters.collect::<Vec<_>>() {
        poster.await.expect("every post is acknowledged");
    }
}

/// Cycles of a commit so far, on average, as the server itself counts them.
async fn mean_group(client: &reqwest::Client, server: &Running) -> f64 {
    let request = client.get(format!("{}/metrics", server.address)).bearer_auth(&server.token);
    let text = request.send().await.expect("an answer").text().await.expect("its metrics");
    let value = |name: &str| -> f64 {
        let line = text.lines().find_map(|line| line.strip_prefix(name)).expect("the metric");
        line.trim().parse().expect("a number")
    };
    value("feedwright_commit_group_size_sum ") / value("feedwright_commit_group_size_count ")
}

async fn post(
    client: &reqwest::Client,
    address: &str,
    token: &str,
    cycle: &Cycle,
    (media_type, prefer): (&str, &str),
    body: Vec<u8>,
) {
    let url = format!("{address}/v1/machines/{}/cycles", cycle.machine);
    let request = client.post(url).bearer_auth(token).header("content-type", media_type);
    let answer = request.header("prefer", prefer).body(body).send().await.expect("an answer");
    assert_eq!(answer.status().as_u16(), 201, "{:?}", answer.text().await);
    answer.bytes().await.expect("a whole answer");
}

/// The median of times, s.
fn median(times: &mut [Duration]) -> f64 {
    times.sort();
    times.get(times.len() / 2).map_or(f64::NAN, Duration::as_secs_f64)
}

#[expect(clippy::cast_precision_loss, reason = "figures for a table")]
fn round(
    values: usize,
    cpu: f64,
    (mut alone, mut reads): (Vec<Duration>, Vec<Duration>),
    resident: u64,
    bytes: u64,
    stored: usize,
) -> Round {
    let alone_p50 = median(&mut alone);
    Round {
        values_per_cpu_second: values as f64 / cpu,
        database: f64::NAN,
        group: f64::NAN,
        alone_p50,
        alone_p99: alone.get(alone.len() * 99 / 100).map_or(f64::NAN, Duration::as_secs_f64),
        read_p50: median(&mut reads),
        resident: resident as f64,
        bytes_per_value: bytes as f64 / stored as f64,
    }
}

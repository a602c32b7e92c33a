//! A weekend that is replayed late and out of order while other machines post live.

use super::data::{self, Cycle, MORNING_MS};
use super::place::{Engine, Ours};
use super::process::Running;
use super::{WHOLE, median, post};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::Semaphore;

/// Machines that were cut off.
const CUT_OFF: usize = 200;
/// Cycles that each of them kept.
const KEPT: usize = 480;
/// Cycles in one batch.
const BATCH: usize = 120;
/// Machines that replay at the same time: all of them, when the line comes back.
const REPLAYING: usize = CUT_OFF;
/// Machines that post live, each a cycle a second.
const LIVE: usize = 20;

/// Bodies that are written at the same time.
static WRITING: Semaphore = Semaphore::const_new(1);

/// Replays, and tells what live posts waited for.
pub(crate) async fn replay(engine: Engine) {
    let templates = Arc::new(data::cycles(400));
    let ours = Ours::start(engine).await;
    let server = &ours.server;
    let client = reqwest::Client::new();
    data::register(&client, &server.address, &server.token, CUT_OFF + LIVE).await;
    let quiet = live(server, &client, &templates, "quiet", Arc::new(AtomicBool::new(false)), 10).await;
    tell("live posts before", quiet);

    let (done, next) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicUsize::new(0)));
    let (begun, cpu, database) = (Instant::now(), server.cpu_seconds(), ours.database_seconds());
    let replayers = (0..REPLAYING).map(|_| {
        let (client, templates, next) = (client.clone(), templates.clone(), next.clone());
        let (address, token) = (server.address.clone(), server.token.clone());
        tokio::spawn(async move {
            loop {
                let machine = next.fetch_add(1, Ordering::Relaxed);
                if machine >= CUT_OFF {
                    return;
                }
                // The newest batch first: an edge buffer that empties from its end.
                for batch in (0..KEPT / BATCH).rev() {
                    replay_batch(&client, &address, &token, &templates, machine, batch).await;
                }
            }
        })
    });
    let replayers: Vec<_> = replayers.collect();
    let waiting = live(server, &client, &templates, "busy", done.clone(), usize::MAX);
    let all = async {
        for replayer in replayers {
            replayer.await.expect("every cycle is acknowledged");
        }
        done.store(true, Ordering::Release);
        begun.elapsed()
    };
    let (waited, took) = tokio::join!(waiting, all);
    println!(
        "{} cycles of {CUT_OFF} machines replayed in {:.1} s, {:.1} s of server CPU with the live posts, {:.1} s of the database's",
        CUT_OFF * KEPT,
        took.as_secs_f64(),
        server.cpu_seconds() - cpu,
        ours.database_seconds() - database
    );
    tell("live posts meanwhile", waited);
    ours.end().await;
}

fn tell(what: &str, mut times: Vec<Duration>) {
    let p50 = median(&mut times);
    let p99 = times[times.len() * 99 / 100];
    println!(
        "{what}: {} posts, p50 {:.1} ms, p99 {:.1} ms, slowest {:.1} ms",
        times.len(),
        p50 * 1e3,
        p99.as_secs_f64() * 1e3,
        times[times.len() - 1].as_secs_f64() * 1e3
    );
}

async fn replay_batch(
    client: &reqwest::Client,
    address: &str,
    token: &str,
    templates: &Arc<Vec<Cycle>>,
    machine: usize,
    batch: usize,
) {
    let name = format!("M{machine}");
    // A thread at a time, and none that sends: a machine does not stop sending while another one writes its cycles down.
    let writing = WRITING.acquire().await.expect("never closed");
    let (written, machine_name) = (Arc::clone(templates), name.clone());
    let writer = move || {
        let mut body = String::new();
        for at in batch * BATCH..(batch + 1) * BATCH {
            let template = &written[(machine * 7 + at) % written.len()];
            let started = MORNING_MS + at as u64 * 20_000;
            body.push_str(&template.again(&machine_name, format!("weekend-{at:05}"), started).json());
            body.push('\n');
        }
        body
    };
    let body = tokio::task::spawn_blocking(writer).await.expect("a body");
    drop(writing);
    let url = format!("{address}/v1/machines/{name}/cycles/batch");
    let request = client.post(url).bearer_auth(token).header("content-type", "application/x-ndjson");
    let answer = request.body(body).send().await.expect("an answer");
    assert_eq!(answer.status().as_u16(), 200);
    let outcomes = answer.text().await.expect("outcomes");
    assert_eq!(outcomes.lines().filter(|line| line.contains("\"stored\"")).count(), BATCH, "{outcomes}");
}

/// Live posts until `done`, at most `most` of each machine; returns what each took.
async fn live(
    server: &Running,
    client: &reqwest::Client,
    templates: &Arc<Vec<Cycle>>,
    prefix: &'static str,
    done: Arc<AtomicBool>,
    most: usize,
) -> Vec<Duration> {
    let machines = (0..LIVE).map(|index| {
        let (client, templates, done) = (client.clone(), templates.clone(), done.clone());
        let (address, token) = (server.address.clone(), server.token.clone());
        tokio::spawn(async move {
            let machine = format!("M{}", CUT_OFF + index);
            let mut times = Vec::new();
            // They do not post in step.
            tokio::time::sleep(Duration::from_millis(50 * index as u64)).await;
            let mut ticks = tokio::time::interval(Duration::from_secs(1));
            while !done.load(Ordering::Acquire) && times.len() < most {
                ticks.tick().await;
                let at = times.len();
                let started = MORNING_MS + at as u64 * 1000;
                let cycle =
                    templates[at % templates.len()].again(&machine, format!("{prefix}-{at:05}"), started);
                let body = cycle.json().into_bytes();
                let begun = Instant::now();
                post(&client, &address, &token, &cycle, ("application/json", WHOLE), body).await;
                times.push(begun.elapsed());
            }
            times
        })
    });
    let mut times = Vec::new();
    for machine in machines.collect::<Vec<_>>() {
        times.extend(machine.await.expect("every post is acknowledged"));
    }
    times
}

//! What many stored cycles do to the cost of the next one, and of the latest recommendation.

use super::data::{self, MORNING_MS};
use super::median;
use super::place::{Engine, Ours};
use super::process::Running;
use std::fmt::Write;
use std::process::Command;
use std::time::{Duration, Instant};

/// Cycles at which growth is first looked at.
const FIRST: usize = 10_000;
/// Cycles in one batch; all of one machine.
const BATCH: usize = 1000;
/// Cycles whose cost is measured at either end.
const MEASURED: usize = 20_000;
/// Recommendations that are asked for at either end.
const ASKED: usize = 1000;

/// Grows to `most` summary-only cycles and compares the cost there with that at ten thousand.
pub(crate) async fn grow(engine: Engine, most: usize) {
    let ours = Ours::start(engine).await;
    let server = &ours.server;
    let client = reqwest::Client::new();
    data::register(&client, &server.address, &server.token, data::MACHINES).await;
    let mut stored = 0;
    fill(server, &client, &mut stored, FIRST).await;
    let first = measure(&ours, &client, &mut stored).await;
    tell(FIRST, first);
    let begun = Instant::now();
    fill(server, &client, &mut stored, most).await;
    println!("grown to {stored} cycles in {:.0} s", begun.elapsed().as_secs_f64());
    let last = measure(&ours, &client, &mut stored).await;
    tell(most, last);
    println!(
        "at {most} × at {FIRST}: ingest {:.2}, latest recommendation {:.2}",
        last.0 / first.0,
        last.1 / first.1
    );
    let bytes = ours.end().await;
    #[expect(clippy::cast_precision_loss, reason = "a figure for a table")]
    let each = bytes as f64 / stored as f64;
    println!("{each:.0} bytes on disk per cycle");
}

fn tell(at: usize, (cpu, asked): (f64, f64)) {
    println!(
        "at {at} cycles: {:.1} µs of server CPU a cycle, recommendation p50 {:.3} ms",
        cpu * 1e6,
        asked * 1e3
    );
}

/// Server CPU per cycle, s, and the median of a recommendation, s.
async fn measure(ours: &Ours, client: &reqwest::Client, stored: &mut usize) -> (f64, f64) {
    // A recommendation is on disk before it is answered, and would wait behind gigabytes that the system still writes.
    assert!(Command::new("sync").status().expect("sync").success(), "what was filled is on disk");
    let server = &ours.server;
    let (cpu, wanted) = (ours.cpu_seconds(), *stored + MEASURED);
    fill(server, client, stored, wanted).await;
    #[expect(clippy::cast_precision_loss, reason = "a figure for a table")]
    let each = (ours.cpu_seconds() - cpu) / MEASURED as f64;
    let mut times: Vec<Duration> = Vec::with_capacity(ASKED);
    for index in 0..ASKED {
        let machine = index % data::MACHINES;
        let url = format!(
            "{}/v1/recommendations?machine=M{machine}&operation=bush&tool=T-M{machine}",
            server.address
        );
        let begun = Instant::now();
        let answer = client.get(url).bearer_auth(&server.token).send().await.expect("an answer");
        assert_eq!(answer.status().as_u16(), 200);
        answer.bytes().await.expect("a whole answer");
        times.push(begun.elapsed());
    }
    (each, median(&mut times))
}

async fn fill(server: &Running, client: &reqwest::Client, stored: &mut usize, wanted: usize) {
    while *stored < wanted {
        let (machine, mut body) = (*stored / BATCH % data::MACHINES, String::new());
        let round = *stored / BATCH / data::MACHINES;
        for index in 0..BATCH {
            let at = round * BATCH + index;
            // A cycle each four seconds; energies scatter by a few percent and creep up.
            let energy = 1000.0 + f64::from(u32::try_from(at * 7919 % 41).expect("small")) - 20.0;
            let seconds = MORNING_MS / 1000 - 4 * (20_000_000 - at as u64);
            let _ = writeln!(
                body,
                r#"{{"cycle_id":"c{at:08}","tool":"T-M{machine}","operation":"bush","started_at":"{}","strategy":"f_lin","spindle_speed_rpm":2500,"reported":{{"energy_joules":{energy},"duration_ms":3500,"max_depth_mm":12.5}}}}"#,
                rfc3339(seconds)
            );
        }
        let url = format!("{}/v1/machines/M{machine}/cycles/batch", server.address);
        let request =
            client.post(url).bearer_auth(&server.token).header("content-type", "application/x-ndjson");
        let answer = request.body(body).send().await.expect("an answer");
        assert_eq!(answer.status().as_u16(), 200, "{:?}", answer.text().await);
        let outcomes = answer.text().await.expect("outcomes");
        assert_eq!(outcomes.lines().filter(|line| line.contains("\"stored\"")).count(), BATCH, "{outcomes}");
        *stored += BATCH;
    }
}

fn rfc3339(seconds: u64) -> String {
    let at = jiff::Timestamp::from_second(i64::try_from(seconds).expect("a time")).expect("a time");
    at.to_string()
}

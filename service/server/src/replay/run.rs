//! Posts a plan: registrations first, then cycles in the order of time, each until it is answered.

use super::client::{Answer, Client, describe};
use super::fleet::{Fleet, MachineTokens};
use super::plan::rfc3339;
use super::progress::Progress;
use super::refusals::Refusals;
use super::{Plan, RecordedCycle, ReplayError};
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};
use std::pin::pin;
use std::time::{Duration, Instant};

/// Problems that the summary keeps; the rest are only counted.
const KEPT_PROBLEMS: usize = 20;

/// How a plan is posted.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// By how much times are moved, µs.
    pub shift_us: i64,
    /// Times the recorded speed; `None` is as fast as cycles are acknowledged.
    pub speed: Option<f64>,
    /// Cycles per request; 1 posts each alone, as a machine does.
    pub batch: usize,
}

/// What became of a replay.
#[derive(Debug, Default)]
pub struct Outcome {
    /// Cycles that were new.
    pub new: usize,
    /// Cycles that the service had.
    pub known: usize,
    /// Cycles that it put into quarantine.
    pub quarantined: usize,
    /// Cycles that it refused and did not keep.
    pub refused: usize,
    /// The first problems: the cycle and what was said.
    pub problems: Vec<(String, String)>,
    /// Cycles that were put into quarantine or refused, by why.
    pub refusals: Refusals,
    /// How long posting took.
    pub elapsed: Duration,
    /// What was answered to each new cycle that was posted alone, in order.
    pub seen: Vec<Seen>,
}

/// What the service said of a tool right after one of its cycles.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// The tool.
    pub tool: String,
    /// The cycle.
    pub cycle: String,
    /// The tool's state.
    pub state: String,
    /// The level as run, where there is one.
    pub level: Option<f64>,
    /// The reasons that were given.
    pub reasons: String,
    /// The measured reference at the end of the cycle.
    pub reference: Option<f64>,
}

impl Outcome {
    /// Cycles that were answered.
    pub fn posted(&self) -> usize {
        self.new + self.known + self.quarantined + self.refused
    }

    fn problem(&mut self, cycle: &str, said: String) {
        self.refusals.count(&said);
        if self.problems.len() < KEPT_PROBLEMS {
            self.problems.push((cycle.to_owned(), said));
        }
    }
}

/// Registers and posts everything. `office` registers and reads; cycles are posted with the machines' own tokens.
pub async fn run(
    plan: &Plan,
    office: &Client,
    tokens: MachineTokens,
    options: Options,
    progress: &mut Progress,
) -> Result<Outcome, ReplayError> {
    run_until(plan, office, tokens, options, progress, std::future::pending()).await
}

/// The same, which ends where `stop` comes: with [`ReplayError::Stopped`], and without tokens that it had made.
pub async fn run_until(
    plan: &Plan,
    office: &Client,
    tokens: MachineTokens,
    options: Options,
    progress: &mut Progress,
    stop: impl Future<Output = ()>,
) -> Result<Outcome, ReplayError> {
    let mut stop = pin!(stop);
    tokio::select! {
        registered = register(plan, office, options.shift_us) => registered?,
        () = &mut stop => return Err(ReplayError::Stopped),
    }
    let mut fleet = Fleet::gather(plan, office, tokens).await?;
    let posted = post(plan, office, &mut fleet, options, progress, &mut stop).await;
    progress.finish();
    // Whatever happened, no token stays behind that nobody knows.
    let dismissed = fleet.dismiss(office).await;
    let outcome = posted?;
    dismissed?;
    Ok(outcome)
}

async fn post(
    plan: &Plan,
    office: &Client,
    fleet: &mut Fleet,
    options: Options,
    progress: &mut Progress,
    stop: &mut (impl Future<Output = ()> + Unpin),
) -> Result<Outcome, ReplayError> {
    let since = Instant::now();
    let mut outcome = Outcome::default();
    let mut rest = plan.cycles.as_slice();
    let first_us = rest.first().map_or(0, |cycle| cycle.started_us);
    while let Some(head) = rest.first() {
        // A batch goes to one machine's address.
        let alike = rest.iter().take(options.batch.max(1)).take_while(|cycle| cycle.machine == head.machine);
        let (group, tail) = rest.split_at(alike.count());
        if let (Some(speed), Some(last)) = (options.speed, group.last()) {
            tokio::select! {
                () = wait_for(since, last.started_us + last.duration_us - first_us, speed) => {}
                () = &mut *stop => return Err(ReplayError::Stopped),
            }
        }
        loop {
            let client = fleet.client(&head.machine);
            let posting = async {
                if options.batch > 1 {
                    post_batch(group, client, options.shift_us, &mut outcome).await
                } else {
                    post_one(head, client, options.shift_us, &mut outcome).await
                }
            };
            // Never while a token is made: it would be valid, and nobody would know of it.
            let posted = tokio::select! {
                posted = posting => posted,
                () = &mut *stop => return Err(ReplayError::Stopped),
            };
            let is_refused = matches!(posted, Err(ReplayError::Refused { status: 401, .. }));
            if !is_refused || !fleet.replace(plan, office, &head.machine).await? {
                break posted?;
            }
        }
        progress.advance(group.len(), group[group.len() - 1].tool.as_str());
        rest = tail;
    }
    outcome.elapsed = since.elapsed();
    Ok(outcome)
}

/// Waits until a machine at `speed` times the recorded one has finished the cycle.
async fn wait_for(since: Instant, recorded_us: i64, speed: f64) {
    let due = Duration::from_micros(u64::try_from(recorded_us).unwrap_or(0)).div_f64(speed);
    tokio::time::sleep(due.saturating_sub(since.elapsed())).await;
}

async fn register(plan: &Plan, client: &Client, shift_us: i64) -> Result<(), ReplayError> {
    let registrations = &plan.registrations;
    for (collection, bodies) in [
        ("machines", &registrations.machines),
        ("tools", &registrations.tools),
        ("operations", &registrations.operations),
    ] {
        for (id, body) in bodies {
            let path = format!("/v1/{collection}/{id}");
            let answer = client.json(Method::PUT, &path, body).await?;
            // Someone edited it since: theirs stands, a replay is no reason to undo it.
            if !matches!(answer.status, StatusCode::PRECONDITION_FAILED | StatusCode::PRECONDITION_REQUIRED) {
                expect_success("PUT", &path, &answer)?;
            }
        }
    }
    for mount in &registrations.mounts {
        let path = format!("/v1/tools/{}/events", mount.tool);
        let at = rfc3339(mount.at_us.saturating_add(shift_us))?;
        if has_event(client, &path, mount.kind, &at).await? {
            continue;
        }
        let mut body = json!({ "kind": mount.kind, "at": at });
        if let Some(reason) = &mount.reason {
            body["reason"] = json!(reason);
        }
        let answer = client.json(Method::POST, &path, &body).await?;
        expect_success("POST", &path, &answer)?;
    }
    Ok(())
}

/// Whether a tool has an event of this kind at this time, on whichever page of its list.
async fn has_event(client: &Client, path: &str, kind: &str, at: &str) -> Result<bool, ReplayError> {
    let mut page_path = format!("{path}?limit=1000");
    loop {
        let page = client.get(&page_path).await?;
        expect_success("GET", &page_path, &page)?;
        let page = page.json();
        if events(&page).any(|event| event["kind"] == kind && same_time(&event["at"], at)) {
            return Ok(true);
        }
        match page["next_cursor"].as_str() {
            Some(cursor) => page_path = format!("{path}?limit=1000&cursor={cursor}"),
            None => return Ok(false),
        }
    }
}

/// The events of a tool, whether the list is bare or a page.
fn events(answer: &Value) -> impl Iterator<Item = &Value> {
    let list = ["items", "events"].iter().find_map(|key| answer.get(key)).unwrap_or(answer);
    list.as_array().into_iter().flatten()
}

fn same_time(value: &Value, at: &str) -> bool {
    let parse = |text: &str| text.parse::<jiff::Timestamp>().ok();
    value.as_str().and_then(parse).is_some_and(|time| parse(at) == Some(time))
}

pub(super) fn expect_success(method: &'static str, path: &str, answer: &Answer) -> Result<(), ReplayError> {
    if answer.status.is_success() {
        return Ok(());
    }
    let status = answer.status.as_u16();
    Err(ReplayError::Refused { method, path: path.to_owned(), status, detail: answer.problem() })
}

async fn post_one(
    cycle: &RecordedCycle,
    client: &Client,
    shift_us: i64,
    outcome: &mut Outcome,
) -> Result<(), ReplayError> {
    let path = format!("/v1/machines/{}/cycles", cycle.machine);
    let answer = client.json(Method::POST, &path, &cycle.body(shift_us)?).await?;
    let body = answer.json();
    let quarantined = body.get("quarantine_id").is_some_and(Value::is_string);
    match answer.status {
        StatusCode::CREATED => {
            outcome.new += 1;
            outcome.seen.push(seen(cycle, &body));
        }
        StatusCode::OK => outcome.known += 1,
        StatusCode::CONFLICT | StatusCode::UNPROCESSABLE_ENTITY if quarantined => {
            outcome.quarantined += 1;
            outcome.problem(cycle.id.as_str(), answer.problem());
        }
        StatusCode::BAD_REQUEST
        | StatusCode::CONFLICT
        | StatusCode::PAYLOAD_TOO_LARGE
        | StatusCode::UNPROCESSABLE_ENTITY => {
            outcome.refused += 1;
            outcome.problem(cycle.id.as_str(), answer.problem());
        }
        // A missing token, machine or route concerns every cycle that follows.
        _ => expect_success("POST", &path, &answer)?,
    }
    Ok(())
}

fn seen(cycle: &RecordedCycle, body: &Value) -> Seen {
    let wear = &body["wear"];
    Seen {
        tool: cycle.tool.as_str().to_owned(),
        cycle: cycle.id.as_str().to_owned(),
        state: wear["state"].as_str().unwrap_or("unknown").to_owned(),
        level: wear["level"]["as_run"].as_f64(),
        reasons: wear["reasons"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(|reason| reason["message"].as_str())
            .collect::<Vec<_>>()
            .join("; "),
        reference: cycle.reference,
    }
}

async fn post_batch(
    group: &[RecordedCycle],
    client: &Client,
    shift_us: i64,
    outcome: &mut Outcome,
) -> Result<(), ReplayError> {
    let Some(head) = group.first() else { return Ok(()) };
    let path = format!("/v1/machines/{}/cycles/batch", head.machine);
    let mut lines = String::new();
    for cycle in group {
        lines.push_str(&cycle.body(shift_us)?.to_string());
        lines.push('\n');
    }
    let answer = client.lines(&path, lines).await?;
    expect_success("POST", &path, &answer)?;
    let mut answered = 0;
    for line in answer.text.lines().filter(|line| !line.trim().is_empty()) {
        let line: Value = serde_json::from_str(line)
            .map_err(|error| ReplayError::Answer { path: path.clone(), detail: error.to_string() })?;
        answered += 1;
        let counted = match line["outcome"].as_str() {
            Some("stored") => &mut outcome.new,
            Some("known") => &mut outcome.known,
            Some("quarantined") => &mut outcome.quarantined,
            _ => &mut outcome.refused,
        };
        *counted += 1;
        if let Some(said) = line.get("problem").and_then(describe) {
            outcome.problem(line["cycle_id"].as_str().unwrap_or("?"), said);
        }
    }
    if answered == group.len() {
        Ok(())
    } else {
        let detail = format!("{answered} outcomes for {} cycles", group.len());
        Err(ReplayError::Answer { path, detail })
    }
}

#[cfg(test)]
mod tests {
    use super::super::client::tests::service;
    use super::*;

    #[tokio::test]
    async fn an_event_is_looked_for_on_every_page() {
        const FIRST: &str = "HTTP/1.1 200 OK\r\nconnection: close\r\n\r\n\
            {\"items\":[{\"kind\":\"changed\",\"at\":\"2020-01-01T00:00:00Z\"}],\"next_cursor\":\"c\"}";
        const LAST: &str = "HTTP/1.1 200 OK\r\nconnection: close\r\n\r\n\
            {\"items\":[{\"kind\":\"mounted_new\",\"at\":\"2020-01-02T00:00:00Z\"}],\"next_cursor\":null}";
        for (at, found) in [("2020-01-02T00:00:00Z", true), ("2020-01-03T00:00:00Z", false)] {
            let (address, task) = service(&[FIRST, LAST]).await;
            let client = Client::new(&address, None, Duration::from_secs(30)).unwrap();
            let has = has_event(&client, "/v1/tools/t/events", "mounted_new", at).await.unwrap();
            assert_eq!(has, found, "{at}");
            assert_eq!(task.await.unwrap(), 2);
        }
    }

    #[test]
    fn events_are_found_in_a_list_or_a_page() {
        for answer in [json!([{ "kind": "x" }]), json!({ "items": [{ "kind": "x" }] })] {
            assert_eq!(events(&answer).count(), 1);
        }
        assert_eq!(events(&json!({})).count(), 0);
        assert!(same_time(&json!("2020-01-01T00:00:00.000Z"), "2020-01-01T00:00:00Z"));
        assert!(!same_time(&json!(7), "2020-01-01T00:00:00Z"));
    }
}

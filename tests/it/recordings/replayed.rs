//! Recordings replayed over HTTP into a running service.

use super::judged::judge;
use feedwright_core::units::Timestamp;
use feedwright_server::clock::Clock;
use feedwright_server::config::Config;
use feedwright_server::replay::client::Client;
use feedwright_server::replay::fleet::MachineTokens;
use feedwright_server::replay::progress::Progress;
use feedwright_server::replay::recordings::read_embedded;
use feedwright_server::replay::report;
use feedwright_server::replay::run::{Options, Outcome, run, run_until};
use feedwright_server::replay::{Plan, ReplayError};
use feedwright_server::server::{RunningServer, Server};
use feedwright_store::{SqliteOptions, SqliteStore};
use secrecy::SecretString;
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// 2026-05-04T06:00:00Z: after every recording.
const NOW: Timestamp = Timestamp::from_micros(1_777_874_400_000_000);
/// As fast as acknowledged, one by one, at recorded times.
const ALONE: Options = Options { shift_us: 0, speed: None, batch: 1 };

/// A service on a fresh database, and an admin who replays into it.
struct Service {
    server: RunningServer,
    office: Client,
    _folder: tempfile::TempDir,
}

impl Service {
    async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let config = Config::for_tests(folder.path()).unwrap();
        let file = folder.path().join("feedwright.sqlite3");
        let store = SqliteStore::open(file, SqliteOptions::default()).await.unwrap();
        let server = Server::start(config, Arc::new(store), Clock::fixed(NOW)).await.unwrap();
        let office = client(&server, server.first_admin_token.clone());
        Self { server, office, _folder: folder }
    }

    async fn replay(&self, plan: &Plan, options: Options) -> Result<Outcome, ReplayError> {
        run(plan, &self.office, MachineTokens::Make, options, &mut Progress::Silent).await
    }

    async fn get(&self, path: &str) -> Value {
        let answer = self.office.get(path).await.unwrap();
        assert!(answer.status.is_success(), "{path}: {}", answer.text);
        answer.json()
    }

    /// What is kept of every cycle and tool, but for the time at which it came.
    async fn everything(&self, plan: &Plan) -> BTreeMap<String, Value> {
        let mut all = BTreeMap::new();
        for cycle in &plan.cycles {
            let path = format!("/v1/machines/{}/cycles/{}", cycle.machine, cycle.id);
            all.insert(path.clone(), self.get(&path).await);
        }
        for tool in plan.registrations.tools.keys() {
            for path in [format!("/v1/tools/{tool}/wear"), format!("/v1/tools/{tool}/events")] {
                let mut kept = self.get(&path).await;
                // Who told an event, and its number, belong to the run.
                for event in kept["items"].as_array_mut().into_iter().flatten() {
                    for key in ["id", "actor", "recorded_at"] {
                        event[key].take();
                    }
                }
                all.insert(path, kept);
            }
        }
        all
    }

    /// Every token of a machine.
    async fn machines_tokens(&self) -> Vec<Value> {
        let tokens = self.get("/v1/tokens").await;
        let items = tokens["items"].as_array().unwrap().iter();
        items.filter(|token| token["role"] == "machine").cloned().collect()
    }

    /// How many cycles of the recording's tools there are.
    async fn count(&self) -> usize {
        let (mut count, mut rest) = (0, "/v1/cycles?limit=500".to_owned());
        loop {
            let page = self.get(&rest).await;
            count += page["items"].as_array().unwrap().len();
            match page["next_cursor"].as_str() {
                Some(cursor) => rest = format!("/v1/cycles?limit=500&cursor={cursor}"),
                None => return count,
            }
        }
    }
}

fn client(server: &RunningServer, token: Option<SecretString>) -> Client {
    Client::new(&format!("http://{}", server.local_addr), token, Duration::from_secs(30)).unwrap()
}

#[tokio::test]
async fn michigan_claims_no_wear_over_http_and_the_second_replay_is_known() {
    let service = Service::start().await;
    let plan = read_embedded("michigan-smart", None).unwrap();
    let first = service.replay(&plan, ALONE).await.unwrap();
    assert_eq!((first.new, first.posted()), (plan.cycles.len(), plan.cycles.len()), "{:?}", first.problems);
    for seen in &first.seen {
        assert!(matches!(seen.state.as_str(), "learning" | "unknown"), "{}", report::table(&plan, &first));
    }
    let before = service.everything(&plan).await;
    let second = service.replay(&plan, ALONE).await.unwrap();
    assert_eq!((second.known, second.posted()), (plan.cycles.len(), plan.cycles.len()));
    assert_eq!(service.everything(&plan).await, before);
    assert_eq!(service.count().await, plan.cycles.len());

    // Negative power is kept, and said.
    let regenerating = service.get("/v1/machines/michigan-mill/cycles/experiment-04-layer-1").await;
    let flags = regenerating["summary"]["flags"].as_array().unwrap();
    for flag in ["negative_power", "aborted"] {
        assert!(flags.contains(&flag.into()), "{flags:?}");
    }
}

/// Over HTTP the service says exactly what the rules alone say, and both ways of posting end in the same state.
#[tokio::test]
async fn vicomtech_over_http_is_what_the_rules_say_and_batches_end_the_same() {
    let judged = judge("vicomtech-turning");
    let service = Service::start().await;
    let outcome = service.replay(&judged.plan, ALONE).await.unwrap();
    assert_eq!(outcome.new, judged.plan.cycles.len(), "{:?}", outcome.problems);
    let told =
        |seen: &feedwright_server::replay::run::Seen| (seen.cycle.clone(), seen.state.clone(), seen.level);
    let (over_http, by_rules): (Vec<_>, Vec<_>) =
        (outcome.seen.iter().map(told).collect(), judged.seen.iter().map(told).collect());
    assert_eq!(over_http, by_rules);
    let words = report::tools(&judged.plan, &service.office).await.unwrap();
    assert!(words.contains("no new-tool baseline"), "{words}");

    let other = Service::start().await;
    let batched = other.replay(&judged.plan, Options { batch: 100, ..ALONE }).await.unwrap();
    assert_eq!(batched.new, judged.plan.cycles.len(), "{:?}", batched.problems);
    assert_eq!(other.everything(&judged.plan).await, service.everything(&judged.plan).await);
}

/// Killed in the middle of a post and started again from the beginning.
#[tokio::test]
async fn an_interrupted_replay_started_again_loses_and_doubles_nothing() {
    let plan = Arc::new(read_embedded("michigan-smart", None).unwrap());
    let whole = Service::start().await;
    whole.replay(&plan, ALONE).await.unwrap();

    let service = Arc::new(Service::start().await);
    let killed = tokio::spawn({
        let (plan, service) = (plan.clone(), service.clone());
        async move { service.replay(&plan, ALONE).await.map(drop) }
    });
    // Whatever it is doing once some cycles are there, it does no further.
    while service.count().await < 7 {
        tokio::task::yield_now().await;
    }
    killed.abort();
    assert!(killed.await.unwrap_err().is_cancelled());
    let again = service.replay(&plan, ALONE).await.unwrap();
    assert!(again.known >= 7 && again.new > 0, "{} known, {} new", again.known, again.new);
    assert_eq!(again.known + again.new, plan.cycles.len(), "{:?}", again.problems);
    assert_eq!(service.count().await, plan.cycles.len());
    assert_eq!(service.everything(&plan).await, whole.everything(&plan).await);

    // The killed replay could not revoke its machine's token; the next one did.
    let tokens = service.get("/v1/tokens").await;
    let machines = tokens["items"].as_array().unwrap().iter().filter(|token| token["role"] == "machine");
    let revoked: Vec<bool> = machines.map(|token| token["revoked_at"].is_string()).collect();
    assert_eq!(revoked, [true, true]);
}

/// A replay that takes about so many seconds, in a task of its own; begun when its machine's token is there.
async fn slow(
    service: &Arc<Service>,
    plan: &Arc<Plan>,
    seconds: f64,
    stop: impl Future<Output = ()> + Send + 'static,
) -> tokio::task::JoinHandle<Result<Outcome, ReplayError>> {
    #[expect(clippy::cast_precision_loss, reason = "a speed")]
    let speed = (plan.end_us() - plan.cycles[0].started_us) as f64 / 1e6 / seconds;
    let options = Options { speed: Some(speed), ..ALONE };
    let begun = tokio::spawn({
        let (service, plan) = (service.clone(), plan.clone());
        async move {
            let progress = &mut Progress::Silent;
            run_until(&plan, &service.office, MachineTokens::Make, options, progress, stop).await
        }
    });
    while service.machines_tokens().await.is_empty() {
        tokio::task::yield_now().await;
    }
    begun
}

/// The second takes the first one's token for left behind; the first has another made, and both end well.
#[tokio::test]
async fn two_replays_of_one_recording_at_once_both_end_well() {
    let service = Arc::new(Service::start().await);
    let plan = Arc::new(read_embedded("michigan-smart", None).unwrap());
    let first = slow(&service, &plan, 8.0, std::future::pending()).await;
    let second = service.replay(&plan, ALONE).await.unwrap();
    let first = first.await.unwrap().unwrap();
    assert_eq!((first.posted(), second.posted()), (plan.cycles.len(), plan.cycles.len()));
    assert_eq!(first.new + second.new, plan.cycles.len(), "{:?} {:?}", first.problems, second.problems);
    let tokens = service.machines_tokens().await;
    assert_eq!(tokens.len(), 3, "{tokens:?}");
    assert!(tokens.iter().all(|token| token["revoked_at"].is_string()), "{tokens:?}");
}

/// What a person revokes stays revoked.
#[tokio::test]
async fn a_replay_whose_token_somebody_revoked_ends() {
    let service = Arc::new(Service::start().await);
    let plan = Arc::new(read_embedded("michigan-smart", None).unwrap());
    let begun = slow(&service, &plan, 20.0, std::future::pending()).await;
    let id = service.machines_tokens().await[0]["id"].as_str().unwrap().to_owned();
    assert!(service.office.delete(&format!("/v1/tokens/{id}")).await.unwrap().status.is_success());
    let refused = begun.await.unwrap();
    assert!(matches!(refused, Err(ReplayError::Refused { status: 401, .. })), "{refused:?}");
    assert_eq!(service.machines_tokens().await.len(), 1);
}

#[tokio::test]
async fn a_replay_that_is_told_to_stop_leaves_no_token_behind() {
    let service = Arc::new(Service::start().await);
    let plan = Arc::new(read_embedded("michigan-smart", None).unwrap());
    let (tell, told) = tokio::sync::oneshot::channel::<()>();
    let stop = async { told.await.unwrap() };
    let begun = slow(&service, &plan, 86_400.0, stop).await;
    tell.send(()).unwrap();
    let stopped = begun.await.unwrap();
    assert!(matches!(stopped, Err(ReplayError::Stopped)), "{stopped:?}");
    let tokens = service.machines_tokens().await;
    assert!(tokens.iter().all(|token| token["revoked_at"].is_string()), "{tokens:?}");
}

/// A replay that moved its times after all: nothing that is stored changes.
#[tokio::test]
async fn other_content_under_the_same_ids_goes_to_quarantine_and_is_told() {
    let service = Service::start().await;
    let plan = read_embedded("michigan-smart", None).unwrap();
    service.replay(&plan, ALONE).await.unwrap();
    let before = service.everything(&plan).await;
    let moved = service.replay(&plan, Options { shift_us: 1_000_000, batch: 20, ..ALONE }).await.unwrap();
    assert_eq!(moved.quarantined, plan.cycles.len());
    assert!(report::summary(&plan, &moved).contains("cycle_conflict"), "{}", report::summary(&plan, &moved));
    let after = service.everything(&plan).await;
    let cycles = |all: &BTreeMap<String, Value>| -> Vec<Value> {
        all.iter().filter(|(path, _)| path.contains("/cycles/")).map(|(_, kept)| kept.clone()).collect()
    };
    assert_eq!(cycles(&after), cycles(&before));
}

/// No token that was made for a machine outlives the replay.
#[tokio::test]
async fn tokens_of_a_replay_are_revoked() {
    let service = Service::start().await;
    let plan = read_embedded("michigan-smart", None).unwrap();
    service.replay(&plan, ALONE).await.unwrap();
    let tokens = service.get("/v1/tokens").await;
    let made: Vec<&Value> =
        tokens["items"].as_array().unwrap().iter().filter(|token| token["role"] == "machine").collect();
    assert_eq!(made.len(), 1);
    assert!(made[0]["revoked_at"].is_string(), "{made:?}");
    assert_eq!(made[0]["machine"], "michigan-mill");
    let forged = client(&service.server, Some(SecretString::from("fwt_none")));
    let refused = run(&plan, &forged, MachineTokens::Make, ALONE, &mut Progress::Silent).await;
    assert!(matches!(refused, Err(ReplayError::Refused { status: 401, .. })), "{refused:?}");
}

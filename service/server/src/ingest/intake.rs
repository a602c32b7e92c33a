//! The intake: one way for every cycle, whether posted, in a batch or out of quarantine.

use super::body::{self, BodyError};
use super::content::Room;
use super::pulse::{Pulse, Waited};
use super::writer::{self, Answered, Bounds, WriteError, WriterHandle, WriterObserver};
use crate::clock::Clock;
use crate::config::Config;
use crate::http::problem::Problem;
use crate::lifecycle::Lifecycle;
use crate::live::{Event, Live};
use crate::metrics::{CycleOutcome, Metrics};
use crate::watch::Heard;
use bytes::Bytes;
use feedwright_core::cycle::{Cycle, Flag};
use feedwright_core::ids::MachineId;
use feedwright_core::summary::{Context, summarise};
use feedwright_core::units::Timestamp;
use feedwright_store::codec::{Habits, Places};
use feedwright_store::{
    Committed, CycleAnswer, NewCycle, QuarantineBounds, QuarantineEntry, Store, StoreError, wire,
};
use futures_util::future::join_all;
use http::StatusCode;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, RwLock};
use std::time::Duration;
use tokio::sync::{Mutex, MutexGuard, Semaphore};
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// Bodies larger than this are parsed off the threads that serve connections.
const PARSED_ASIDE_BYTES: usize = 256 * 1024;

/// Windows of batches that are read, summed up and encoded at once. When a weekend comes back, every machine of a plant
/// replays at the same moment: live posts must find a processor all the same.
const BATCHES_PREPARED: usize = 2;
/// Contradicting cycles that are compared with what is stored at the same time.
const COMPARED: usize = 2;
/// How long it may take to tell what a contradicting cycle differs in: it is to be kept and answered all the same.
const COMPARING: Duration = Duration::from_secs(1);

/// How long a post waits for what the database says of its machine, tool and operation.
const PATIENCE: Duration = Duration::from_secs(5);

/// A cycle that is durably stored, with what its machine is told.
#[derive(Debug)]
pub struct Accepted {
    /// The cycle.
    pub cycle: Arc<Cycle>,
    /// Whether it was new; else it was known.
    pub new: bool,
    /// What its machine is told.
    pub answer: Box<CycleAnswer>,
}

/// A cycle that is ready for the queue, with the body it came from.
struct Ready {
    cycle: NewCycle,
    json: Bytes,
}

/// A cycle in the queue: what of it is wanted when it is answered.
struct Queued {
    cycle: Arc<Cycle>,
    json: Bytes,
    cut_short: bool,
    answered: Answered,
}

impl Ready {
    /// What is handed to the writer, and what makes it a queued one with the writer's answer.
    fn part(self) -> (NewCycle, impl FnOnce(Answered) -> Queued) {
        let (cycle, json, cut_short) = (Arc::clone(&self.cycle.cycle), self.json, self.cycle.cut_short);
        (self.cycle, move |answered| Queued { cycle, json, cut_short, answered })
    }
}

/// Member of a problem: what was refused is a part of a cycle, not the whole of it.
const CUT_SHORT: &str = "cut_short";
/// Member of a problem: paths of what was sent that is another content than what is stored.
const DIFFERS: &str = "differs";

/// What becomes of a body that is refused for its content.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refused {
    /// It is kept in quarantine, and the problem names it.
    ToQuarantine,
    /// It is there already.
    StaysInQuarantine,
}

/// The intake of cycles.
pub struct CycleIntake {
    store: Arc<dyn Store>,
    clock: Clock,
    metrics: Arc<Metrics>,
    told: Arc<Told>,
    max_samples: usize,
    bounds: QuarantineBounds,
    writer: RwLock<Option<WriterHandle>>,
    writing: Mutex<Option<JoinHandle<()>>>,
    preparing: Semaphore,
    settling: Mutex<()>,
    comparing: Arc<Semaphore>,
    singles: Room,
    batches: Room,
    habits: Habits,
    pulse: Pulse,
}

/// Who is told of what came of a cycle.
struct Told {
    clock: Clock,
    metrics: Arc<Metrics>,
    live: Arc<Live>,
    heard: Heard,
    store: Arc<dyn Store>,
    /// The store's count of changes of alarms of which the view was told.
    alarm_changes: AtomicU64,
}

impl Told {
    fn observe(&self, machine: &MachineId, refused: Refused, result: &Result<Accepted, Problem>) {
        // What an engineer takes out of quarantine says nothing about the machine.
        let heard = refused == Refused::ToQuarantine;
        let accepted = match result {
            Ok(accepted) => accepted,
            Err(problem) if problem.members.contains_key("quarantine_id") => {
                self.live.alarms_may_have_changed();
                self.heard.note(machine, self.clock.moment());
                self.metrics.cycle_quarantined(machine, problem.code);
                return;
            }
            // What is asked to be taken out again and is not is still in quarantine.
            Err(_) if refused == Refused::StaysInQuarantine => return,
            Err(problem) => {
                self.metrics.cycle_rejected(problem.code);
                return;
            }
        };
        let Accepted { cycle, new, answer } = accepted;
        if heard {
            self.heard.note(machine, self.clock.moment());
        }
        self.metrics.recommendation(&answer.recommendation.recommendation);
        if !new {
            self.metrics.cycle(machine, CycleOutcome::Duplicate);
            return;
        }
        self.metrics.cycle(machine, CycleOutcome::Accepted);
        // Most cycles change none. Said before the cycle is told, with which the other servers hear of it.
        let changes = self.store.alarm_changes();
        if self.alarm_changes.swap(changes, Ordering::AcqRel) != changes {
            self.live.alarms_may_have_changed();
        }
        self.live.publish(Event::cycle(accepted));
        if let Some(energy) = answer.summary.best_energy() {
            let process = cycle.process.or(answer.recommendation.recommendation.process);
            self.metrics.cycle_energy(process, energy.total_joules);
        }
        self.metrics.verdict(machine, (&cycle.tool, cycle.started_at), &answer.verdict);
    }
}

/// What the writer tells metrics and the life of the process.
struct Watch {
    metrics: Arc<Metrics>,
    lifecycle: Lifecycle,
}

impl WriterObserver for Watch {
    fn committed(&self, cycles: usize, seconds: f64) {
        self.metrics.commit_seconds.observe(seconds);
        #[expect(clippy::cast_precision_loss, reason = "a group is small")]
        self.metrics.commit_group_size.observe(cycles as f64);
    }

    fn failed(&self, error: &StoreError) {
        self.lifecycle.heed(error);
    }
}

impl CycleIntake {
    /// Starts the writer and opens the intake.
    pub fn start(
        config: &Config,
        store: &Arc<dyn Store>,
        clock: &Clock,
        lifecycle: &Lifecycle,
        metrics: &Arc<Metrics>,
    ) -> Self {
        let watch = Watch { metrics: metrics.clone(), lifecycle: lifecycle.clone() };
        let bounds = Bounds { queue: config.limits.queue_length, group: config.limits.group_size };
        let settings = config.recommendation.settings();
        let (writer, writing) =
            writer::start(store.clone(), bounds, settings, clock.clone(), Arc::new(watch));
        let ended = lifecycle.clone();
        let writing = tokio::spawn(async move {
            // Nobody would write any more, and everybody be told to try again.
            if let Err(panicked) = writing.await {
                ended.fail(&format!("the writer ended: {panicked}"));
            }
        });
        metrics.ingest_queue_capacity.set(i64::try_from(config.limits.queue_length).unwrap_or(i64::MAX));
        Self {
            store: store.clone(),
            clock: clock.clone(),
            metrics: metrics.clone(),
            told: Arc::new(Told {
                clock: clock.clone(),
                metrics: metrics.clone(),
                live: Live::new(&config.live),
                heard: Heard::default(),
                store: store.clone(),
                alarm_changes: AtomicU64::new(0),
            }),
            max_samples: config.limits.samples_per_cycle,
            bounds: config.quarantine.bounds(),
            writer: RwLock::new(Some(writer)),
            writing: Mutex::new(Some(writing)),
            preparing: Semaphore::new(BATCHES_PREPARED),
            settling: Mutex::new(()),
            comparing: Arc::new(Semaphore::new(COMPARED)),
            singles: Room::new(config.limits.room_bytes(), config.limits.body_bytes),
            batches: Room::new(config.limits.room_bytes(), config.limits.body_bytes),
            habits: Habits::default(),
            pulse: Pulse::of(store.clone()),
        }
    }

    /// Where large bodies of single cycles have their room, or of batches: those take long, and nobody else waits for them.
    pub(crate) const fn room(&self, of_batches: bool) -> &Room {
        if of_batches { &self.batches } else { &self.singles }
    }

    /// Machines that were heard of since the watch's last round.
    pub(crate) fn heard(&self) -> &Heard {
        &self.told.heard
    }

    /// Sets the metric of the queue to what waits now.
    pub(crate) fn measure(&self) {
        let depth = self.writer().map_or(0, |writer| writer.depth());
        self.metrics.ingest_queue_depth.set(i64::try_from(depth).unwrap_or(i64::MAX));
    }

    /// The view that is told of every cycle stored here.
    pub(crate) fn live(&self) -> &Arc<Live> {
        &self.told.live
    }

    /// Everything before the queue: reading, summary, blocks and hash.
    async fn prepare(
        &self,
        machine: &MachineId,
        json: Bytes,
        cut_short: bool,
        refused: Refused,
    ) -> Result<Ready, Problem> {
        let now = self.clock.now();
        let (cycle, places) = match self.decode(machine, json.clone(), now).await? {
            Ok(decoded) => decoded,
            Err(BodyError::Malformed(why)) => {
                return Err(Problem::bad_request("malformed_json", format!("the body is no JSON: {why}")));
            }
            Err(BodyError::MalformedFrame(why)) => {
                return Err(Problem::bad_request("malformed_cycle", format!("the body is no cycle: {why}")));
            }
            Err(BodyError::Invalid(violations)) => {
                if !self.knows(machine).await? {
                    return Err(unknown_machine(machine));
                }
                return Err(self
                    .refuse(machine, json, cut_short, Problem::invalid(violations), refused)
                    .await);
            }
        };
        // Where it has to be asked for, it is in a task of its own.
        let around = self.store.recent_surroundings(machine, &cycle.operation, &cycle.tool, cycle.started_at);
        let around =
            timeout(PATIENCE, around).await.map_err(|late| StoreError::Unavailable(late.into()))??;
        let Some((around, generation)) = around else {
            return Err(unknown_machine(machine));
        };
        let context = Context {
            machine: &around.machine,
            calibration: around.calibration.as_ref(),
            operation: around.operation.as_ref(),
        };
        let mut summary = summarise(&cycle, context);
        summary.flags.insert_if(!around.has_tool(), Flag::ToolUnregistered);
        let encoded = self.habits.encode(&cycle, places);
        // A group waits with tens of cycles: the memory of their samples serves the next ones meanwhile.
        let cycle = Arc::new(cycle.with_samples(None));
        let generation = Some(generation);
        Ok(Ready {
            cycle: NewCycle { cycle, received_at: now, encoded, summary, generation, cut_short },
            json,
        })
    }

    /// Whether a machine is registered. Waits for the database no longer than a post does.
    pub(crate) async fn knows(&self, machine: &MachineId) -> Result<bool, StoreError> {
        let (store, machine) = (Arc::clone(&self.store), machine.clone());
        // A task of its own: what asks the database is never cut off.
        let asked = tokio::spawn(async move { store.machine(&machine).await });
        match timeout(PATIENCE, asked).await {
            // It is there, and what is sent of it is kept.
            Ok(Ok(Err(StoreError::Damaged { .. }))) => Ok(true),
            Ok(Ok(found)) => found.map(|found| found.is_some()),
            Ok(Err(lost)) => Err(StoreError::Unavailable(lost.into())),
            Err(late) => Err(StoreError::Unavailable(late.into())),
        }
    }

    /// Everything after the queue: what the commit came to.
    async fn settle(&self, queued: Queued, refused: Refused) -> Result<Accepted, Problem> {
        let Queued { cycle, json, cut_short, mut answered } = queued;
        let outcome = match self.pulse.wait(&mut answered).await {
            Waited::Answered(outcome) => outcome,
            Waited::Closed => return Err(closing()),
            Waited::GivenUp => {
                // Sent again it will be known, and then nobody is told that it is new.
                let told = Arc::clone(&self.told);
                tokio::spawn(async move {
                    if let Ok(Ok(Committed::Stored(answer))) = answered.await {
                        let machine = cycle.machine.clone();
                        told.observe(&machine, refused, &Ok(Accepted { cycle, new: true, answer }));
                    }
                });
                let why = "the database does not answer, or does not commit, and a commit is under way";
                return Err(StoreError::OutcomeUnknown(why.into()).into());
            }
        };
        let committed = match outcome {
            // Nothing that this server takes should come to it; if it does, nothing of it is lost.
            Err(error @ StoreError::Refused { .. }) => {
                return Err(self.refuse(&cycle.machine, json, cut_short, error.into(), refused).await);
            }
            outcome => outcome?,
        };
        match committed {
            Committed::Stored(answer) => Ok(Accepted { cycle, new: true, answer }),
            Committed::Known(answer) => Ok(Accepted { cycle, new: false, answer }),
            Committed::UnknownMachine => Err(unknown_machine(&cycle.machine)),
            Committed::Conflict { .. } => {
                let differs = self.differences(&cycle.machine, &json).await;
                let problem = Problem::new(
                    StatusCode::CONFLICT,
                    "cycle_conflict",
                    format!(
                        "another content is stored under the cycle id `{}` of this machine; a counter that \
                         restarts is the commonest cause: use a UUIDv7 or boot id + counter",
                        cycle.id
                    ),
                )
                .member(DIFFERS, differs);
                Err(self.refuse(&cycle.machine, json, cut_short, problem, refused).await)
            }
        }
    }

    /// Paths of the fields in which a body is another content than what is stored under its id. Empty where that cannot be
    /// told: the conflict stands without it.
    async fn differences(&self, machine: &MachineId, json: &Bytes) -> Vec<String> {
        let compared = async {
            // Two cycles are held in memory for each, of any length.
            let turn = Arc::clone(&self.comparing).acquire_owned().await.ok()?;
            // It was taken once: the clock that refuses what lies ahead has only gone on.
            let sent = self.decode(machine, Bytes::clone(json), self.clock.now()).await.ok()?.ok()?.0;
            let store = Arc::clone(&self.store);
            // A task of its own: what asks the database is never cut off.
            let asked = tokio::spawn(async move {
                let paths = store.differences(sent).await;
                drop(turn);
                paths
            });
            asked.await.ok()
        };
        match timeout(COMPARING, compared).await {
            Ok(Some(Ok(paths))) => paths,
            Ok(Some(Err(error))) => {
                tracing::warn!(%error, %machine, "what a conflicting cycle differs in is not known");
                Vec::new()
            }
            Ok(None) | Err(_) => Vec::new(),
        }
    }

    fn writer(&self) -> Result<WriterHandle, Problem> {
        self.writer.read().map_err(|_| closing())?.clone().ok_or_else(closing)
    }

    async fn decode(
        &self,
        machine: &MachineId,
        json: Bytes,
        now: Timestamp,
    ) -> Result<Result<(Cycle, Places), BodyError>, Problem> {
        let max_samples = self.max_samples;
        if json.len() <= PARSED_ASIDE_BYTES {
            return Ok(body::decode_with_places(machine, &json, max_samples, now));
        }
        let machine = machine.clone();
        tokio::task::spawn_blocking(move || body::decode_with_places(&machine, &json, max_samples, now))
            .await
            .map_err(|error| Problem::internal(format!("parsing a cycle failed: {error}")))
    }

    /// Keeps a refused body in quarantine, so that its machine may forget it, and names it in the problem.
    async fn refuse(
        &self,
        machine: &MachineId,
        json: Bytes,
        cut_short: bool,
        problem: Problem,
        refused: Refused,
    ) -> Problem {
        if refused == Refused::StaysInQuarantine {
            return problem;
        }
        // No body says so, and whoever takes it out again has to know.
        let problem = if cut_short { problem.member(CUT_SHORT, true) } else { problem };
        // A body that is refused may be as long as any: others would wait for it to be looked through.
        let looked = Bytes::clone(&json);
        let looked = tokio::task::spawn_blocking(move || body::cycle_id_of(&looked)).await;
        let cycle = match looked {
            Ok(cycle) => cycle,
            Err(error) => return Problem::internal(format!("reading a cycle's id failed: {error}")),
        };
        let entry = QuarantineEntry {
            id: uuid::Uuid::now_v7().to_string(),
            machine: machine.clone(),
            cycle,
            received_at: self.clock.now(),
            code: problem.errors.first().map_or(problem.code, |error| error.code).to_owned(),
            problem: problem.document(None),
            content_type: if body::is_frame(&json) { wire::MEDIA_TYPE } else { "application/json" }
                .to_owned(),
            settled: None,
            size: json.len() as u64,
        };
        match self.store.quarantine(entry, json.to_vec(), self.bounds).await {
            Ok(id) => problem.member("quarantine_id", id),
            // Without a place to keep it the machine must keep its copy: neither 409 nor 422 may be answered.
            Err(StoreError::Full { .. }) => Problem::unavailable(
                "quarantine_full",
                format!(
                    "the cycle is refused ({}) and the quarantine is full: settle entries first",
                    problem.code
                ),
                60,
            ),
            Err(StoreError::Refused { constraint }) => Problem::unavailable(
                "quarantine_refused",
                format!(
                    "the cycle is refused ({}), and the quarantine does not take it: {constraint}",
                    problem.code
                ),
                60,
            ),
            Err(error) => error.into(),
        }
    }
}

impl CycleIntake {
    /// Takes one cycle's body in, JSON or binary. Returns after its durable commit. A full queue refuses it at once.
    pub async fn accept(
        &self,
        machine: &MachineId,
        json: Bytes,
        refused: Refused,
    ) -> Result<Accepted, Problem> {
        let result = match self.prepare(machine, json, false, refused).await {
            Ok(ready) => {
                let (cycle, queued) = ready.part();
                match self.writer().and_then(|writer| writer.enqueue(cycle).map_err(problem_of)) {
                    Ok(answered) => self.settle(queued(answered), refused).await,
                    Err(problem) => Err(problem),
                }
            }
            Err(problem) => Err(problem),
        };
        self.told.observe(machine, refused, &result);
        result
    }

    /// Takes what there is of a cycle that was cut short, or whose end never came in: as [`CycleIntake::accept`], flagged
    /// `incomplete` and `cut_short`.
    pub async fn accept_incomplete(
        &self,
        machine: &MachineId,
        json: Bytes,
        refused: Refused,
    ) -> Result<Accepted, Problem> {
        let result = match self.prepare(machine, json, true, refused).await {
            Ok(ready) => match self.enqueue_patiently(ready).await {
                Ok(queued) => self.settle(queued, refused).await,
                Err(problem) => Err(problem),
            },
            Err(problem) => Err(problem),
        };
        self.told.observe(machine, refused, &result);
        result
    }

    /// Takes several cycles in, in their order: where two have the same id, the first is the one that is stored.
    /// Waits for room in the queue, so that a batch does not crowd out live posts by filling it.
    pub async fn accept_all(&self, machine: &MachineId, lines: Vec<Bytes>) -> Vec<Result<Accepted, Problem>> {
        let refused = Refused::ToQuarantine;
        let mut waiting = Vec::with_capacity(lines.len());
        let mut prepared = Vec::with_capacity(lines.len());
        let turn = self.preparing.acquire().await;
        let mut away: Option<Problem> = None;
        for json in lines {
            // Each that has to ask waits its own time: one is enough.
            let ready = match &away {
                Some(problem) => Err(problem.clone()),
                None => self.prepare(machine, json, false, refused).await,
            };
            away = away.or_else(|| ready.as_ref().err().filter(|problem| problem.is_of_outage()).cloned());
            prepared.push(ready);
            // Between two cycles whoever posts live may have the thread.
            tokio::task::yield_now().await;
        }
        drop(turn);
        for ready in prepared {
            waiting.push(match ready {
                Ok(ready) => self.enqueue_patiently(ready).await,
                Err(problem) => Err(problem),
            });
        }
        let settled = waiting.into_iter().map(|queued| async move { self.settle(queued?, refused).await });
        let results = join_all(settled).await;
        results.iter().for_each(|result| self.told.observe(machine, refused, result));
        results
    }

    async fn enqueue_patiently(&self, ready: Ready) -> Result<Queued, Problem> {
        let (cycle, queued) = ready.part();
        let writer = self.writer()?;
        let coming = std::pin::pin!(writer.enqueue_patiently(cycle));
        // What never was in the queue is not committed.
        let answered = self.pulse.while_it_beats(coming).await.ok_or_else(Problem::database_unavailable)?;
        answered.map(queued).map_err(problem_of)
    }

    /// The right to settle an entry of the quarantine on this server: one at a time. Refused where those before take as long as
    /// a post may.
    pub(crate) async fn settling(&self) -> Result<MutexGuard<'_, ()>, Problem> {
        let busy = |_| Problem::unavailable("settling", "other entries are being settled", 5);
        timeout(PATIENCE, self.settling.lock()).await.map_err(busy)
    }

    /// Takes in a body from quarantine as if its machine had sent it now, and returns the cycle and what that machine would have
    /// been answered. A refusal is the problem it would have been answered; nothing is put in quarantine again. What was
    /// a part of a cycle when it was refused stays one.
    pub async fn reingest(
        &self,
        entry: &QuarantineEntry,
        body: Bytes,
    ) -> Result<(Arc<Cycle>, serde_json::Value), Problem> {
        let (machine, refused) = (&entry.machine, Refused::StaysInQuarantine);
        let accepted = match was_cut_short(entry).ok_or_else(entry_damaged)? {
            true => self.accept_incomplete(machine, body, refused).await?,
            false => self.accept(machine, body, refused).await?,
        };
        let answer = crate::http::dto::cycle::CycleAnswerBody::of(&accepted);
        let answer = serde_json::to_value(answer).map_err(|error| Problem::internal(error.to_string()))?;
        Ok((accepted.cycle, answer))
    }

    /// Refuses new cycles; ends when every cycle that was taken in is committed and answered, and the writer is gone.
    pub async fn drain(&self) {
        if let Ok(mut writer) = self.writer.write() {
            writer.take();
        }
        if let Some(writing) = self.writing.lock().await.take()
            && let Err(error) = writing.await
        {
            tracing::error!(%error, "the writer ended abnormally");
        }
    }
}

/// Whether it came as a part of a cycle; `None` where what is kept of its problem, which alone says so, cannot be read.
fn was_cut_short(entry: &QuarantineEntry) -> Option<bool> {
    let problem = serde_json::from_str::<serde_json::Value>(&entry.problem).ok()?;
    Some(problem[CUT_SHORT] == true)
}

/// What is kept of an entry is not what came.
pub(crate) fn entry_damaged() -> Problem {
    let detail =
        "what is kept of the entry is not what came: send its body repaired where that is all, or discard it";
    Problem::new(StatusCode::CONFLICT, "body_damaged", detail)
}

fn unknown_machine(machine: &MachineId) -> Problem {
    Problem::new(StatusCode::NOT_FOUND, "unknown_machine", format!("there is no machine `{machine}`"))
}

fn problem_of(error: WriteError) -> Problem {
    match error {
        WriteError::Busy => {
            Problem::unavailable("queue_full", "too many cycles are waiting to be written", 1)
        }
        WriteError::Closing => closing(),
    }
}

fn closing() -> Problem {
    Problem::unavailable("shutting_down", "the service is shutting down", 5)
}

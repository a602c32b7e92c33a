//! The one writer: bounded lanes in front, groups behind, an answer to each after its commit.
//!
//! Live posts and batches have a lane each. A group takes what waits of the live lane first; where a batch waits, it
//! leaves it an eighth of its places, so that a replay goes on under any load and never fills the way of live posts.

use crate::clock::Clock;
use feedwright_core::recommend::RecommendSettings;
use feedwright_store::{Committed, NewCycle, Store, StoreError, StoreResult};
use std::sync::Arc;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;
use tracing::Instrument;

/// Part of a group's places, one in so many, that live posts leave to a batch that waits.
const BATCH_SHARE: usize = 8;

/// Bounds of the writer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bounds {
    /// Cycles that may wait in each lane.
    pub queue: usize,
    /// Cycles in one commit.
    pub group: usize,
}

struct Queued {
    cycle: NewCycle,
    answer: oneshot::Sender<StoreResult<Committed>>,
}

/// Told about what the writer does, for metrics.
pub trait WriterObserver: Send + Sync + 'static {
    /// A group of `cycles` was committed within `seconds`.
    fn committed(&self, cycles: usize, seconds: f64);
    /// The database refuses writes: the service must stop acknowledging and exit.
    fn not_writable(&self, error: &StoreError);
}

/// Where cycles are handed in.
#[derive(Clone)]
pub struct WriterHandle {
    live: mpsc::Sender<Queued>,
    batch: mpsc::Sender<Queued>,
}

/// Why a cycle was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WriteError {
    /// The queue is full: try again in a moment.
    Busy,
    /// The writer is shutting down.
    Closing,
}

/// The answer to a queued cycle, which comes after its commit. Dropping it does not take the cycle back.
pub type Answered = oneshot::Receiver<StoreResult<Committed>>;

impl WriterHandle {
    /// Queues a live cycle, or says at once that the queue is full.
    pub fn enqueue(&self, cycle: NewCycle) -> Result<Answered, WriteError> {
        let (answer, answered) = oneshot::channel();
        self.live.try_send(Queued { cycle, answer }).map_err(|error| match error {
            mpsc::error::TrySendError::Full(_) => WriteError::Busy,
            mpsc::error::TrySendError::Closed(_) => WriteError::Closing,
        })?;
        Ok(answered)
    }

    /// Queues a cycle of a batch behind live ones; waits for room.
    pub async fn enqueue_patiently(&self, cycle: NewCycle) -> Result<Answered, WriteError> {
        let (answer, answered) = oneshot::channel();
        self.batch.send(Queued { cycle, answer }).await.map_err(|_| WriteError::Closing)?;
        Ok(answered)
    }

    /// Cycles waiting now.
    pub fn depth(&self) -> usize {
        let waiting = |lane: &mpsc::Sender<Queued>| lane.max_capacity() - lane.capacity();
        waiting(&self.live) + waiting(&self.batch)
    }
}

/// Starts the writer. It ends, with everything that was queued committed, when all handles are dropped.
pub fn start(
    store: Arc<dyn Store>,
    bounds: Bounds,
    settings: RecommendSettings,
    clock: Clock,
    observer: Arc<dyn WriterObserver>,
) -> (WriterHandle, JoinHandle<()>) {
    let (live, live_waiting) = mpsc::channel(bounds.queue.max(1));
    let (batch, batch_waiting) = mpsc::channel(bounds.queue.max(1));
    let lanes = Lanes { live: live_waiting, batch: batch_waiting };
    let task = tokio::spawn(run(store, lanes, bounds.group.max(1), settings, clock, observer));
    (WriterHandle { live, batch }, task)
}

/// The writer's ends of the lanes.
struct Lanes {
    live: mpsc::Receiver<Queued>,
    batch: mpsc::Receiver<Queued>,
}

impl Lanes {
    /// Waits for cycles and fills the group with at most `most`; `false` when nobody can hand in any more.
    async fn fill(&mut self, group: &mut Vec<Queued>, most: usize) -> bool {
        // An empty lane that is closed is ready with nothing: only both of them are the end.
        let first = tokio::select! {
            biased;
            Some(queued) = self.live.recv() => Some(queued),
            Some(queued) = self.batch.recv() => Some(queued),
            else => None,
        };
        let Some(first) = first else {
            return false;
        };
        group.push(first);
        let kept = if self.batch.is_empty() { 0 } else { (most / BATCH_SHARE).max(1) };
        take(&mut self.live, group, most.saturating_sub(kept));
        take(&mut self.batch, group, most);
        // What the batch did not need.
        take(&mut self.live, group, most);
        true
    }
}

/// Moves what waits into the group, until that holds `most`.
fn take(lane: &mut mpsc::Receiver<Queued>, group: &mut Vec<Queued>, most: usize) {
    while group.len() < most
        && let Ok(queued) = lane.try_recv()
    {
        group.push(queued);
    }
}

async fn run(
    store: Arc<dyn Store>,
    mut lanes: Lanes,
    most: usize,
    settings: RecommendSettings,
    clock: Clock,
    observer: Arc<dyn WriterObserver>,
) {
    let mut group = Vec::with_capacity(most);
    while lanes.fill(&mut group, most).await {
        let (cycles, answers): (Vec<_>, Vec<_>) =
            group.drain(..).map(|queued| (queued.cycle, queued.answer)).unzip();
        let begun = std::time::Instant::now();
        let count = cycles.len();
        let span = tracing::info_span!("commit", cycles = count);
        let outcomes = store.commit_cycles(cycles, clock.now(), settings).instrument(span).await;
        observer.committed(count, begun.elapsed().as_secs_f64());
        for (answer, outcome) in answers.into_iter().zip(outcomes) {
            if let Err(error @ StoreError::NotWritable(_)) = &outcome {
                observer.not_writable(error);
            }
            // A client that hung up does not wait; its cycle is kept all the same.
            let _ = answer.send(outcome);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use feedwright_core::cycle::{Cycle, CycleDraft, Outcome, Reported};
    use feedwright_core::machine::{FeedDriveRating, FeedLimits, LoadReference, Machine, SpindleRating};
    use feedwright_core::summary::{Context, CycleSummary, summarise};
    use feedwright_core::units::Timestamp;
    use feedwright_store::codec;

    fn summary(cycle: &Cycle) -> CycleSummary {
        let machine = Machine {
            id: cycle.machine.clone(),
            name: String::new(),
            control: String::new(),
            ipo_period_ms: 10.0,
            spindle: SpindleRating {
                reference: LoadReference::Unknown,
                rated_power_watts: None,
                base_speed_rpm: None,
            },
            feed_drive: FeedDriveRating::default(),
            limits: FeedLimits::new(1.0, 2000.0, 5.0, 200.0).unwrap(),
        };
        summarise(cycle, Context { machine: &machine, calibration: None, operation: None })
    }

    fn queued(id: &str) -> (Queued, Answered) {
        let cycle = Cycle::new(CycleDraft {
            machine: "M1".try_into().unwrap(),
            id: id.try_into().unwrap(),
            tool: "T1".try_into().unwrap(),
            operation: "O1".try_into().unwrap(),
            started_at: Timestamp::from_micros(0),
            seq: None,
            process: None,
            strategy: None,
            law_version: None,
            profile: None,
            reference: None,
            recommendation: None,
            spindle_speed_rpm: None,
            outcome: Outcome::Completed,
            samples: None,
            reported: Reported { energy_joules: Some(1.0), ..Reported::default() },
        })
        .unwrap();
        let new = NewCycle {
            received_at: Timestamp::from_micros(0),
            encoded: codec::encode(&cycle),
            summary: summary(&cycle),
            cycle: Arc::new(cycle),
            generation: None,
        };
        let (answer, answered) = oneshot::channel();
        (Queued { cycle: new, answer }, answered)
    }

    fn names(group: &[Queued]) -> Vec<String> {
        group.iter().map(|queued| queued.cycle.cycle.id.to_string()).collect()
    }

    #[tokio::test]
    async fn live_posts_go_first_and_a_batch_goes_on() {
        let ((live, live_end), (batch, batch_end)) = (mpsc::channel(100), mpsc::channel(100));
        let mut lanes = Lanes { live: live_end, batch: batch_end };
        for index in 0..20 {
            batch.try_send(queued(&format!("b{index}")).0).unwrap_or_else(|_| panic!("room"));
            live.try_send(queued(&format!("l{index}")).0).unwrap_or_else(|_| panic!("room"));
        }
        let mut group = Vec::new();
        assert!(lanes.fill(&mut group, 16).await);
        let (first, names_of_first) = (group.len(), names(&group));
        assert_eq!(first, 16);
        assert!(names_of_first[..14].iter().all(|name| name.starts_with('l')), "{names_of_first:?}");
        assert_eq!(names_of_first[14..], ["b0", "b1"]);

        group.clear();
        assert!(lanes.fill(&mut group, 16).await);
        assert_eq!(
            names(&group)[..7],
            ["l14", "l15", "l16", "l17", "l18", "l19", "b2"],
            "the rest is the batch's"
        );

        // Both hand in nothing more: what waits is still taken, then it ends.
        drop((live, batch));
        group.clear();
        assert!(lanes.fill(&mut group, 16).await);
        assert_eq!(names(&group).len(), 8);
        group.clear();
        assert!(!lanes.fill(&mut group, 16).await);
    }
}

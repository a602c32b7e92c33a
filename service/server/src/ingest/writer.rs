//! The one writer: bounded lanes in front, groups behind, an answer to each when it is durable.
//!
//! Live posts and batches have a lane each. A group takes what waits of the live lane first; where a batch waits, it
//! leaves it an eighth of its places, so that a replay goes on under any load and never fills the way of live posts.
//!
//! What a commit costs is the group's more than the cycle's. Where many machines post at once, a group waits for those
//! that are about to come back: as long after the commit before it as that took, and no longer. A post alone never waits.

use crate::clock::Clock;
use feedwright_core::recommend::RecommendSettings;
use feedwright_store::{Committed, NewCycle, Store, StoreError, StoreResult};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::{Notify, mpsc, oneshot};
use tokio::task::JoinHandle;
use tokio::time::timeout_at;
use tracing::Instrument;

/// Part of a group's places, one in so many, that live posts leave to a batch that waits.
const BATCH_SHARE: usize = 8;

/// Posts at once from which on a group waits for more of them.
const MANY: usize = 8;
/// No group waits longer after a commit for more, however slow the disk is.
const LONGEST_WAIT: Duration = Duration::from_millis(4);

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
    /// A cycle was not committed: where it is the disk that fails the service must stop acknowledging and exit.
    fn failed(&self, error: &StoreError);
}

/// Where cycles are handed in.
#[derive(Clone)]
pub struct WriterHandle {
    ends: Arc<Ends>,
}

/// The lanes' ends where cycles are put in.
struct Ends {
    live: mpsc::Sender<Queued>,
    batch: mpsc::Sender<Queued>,
    enough: Arc<Enough>,
}

impl Drop for Ends {
    fn drop(&mut self) {
        self.enough.end();
    }
}

/// Wakes a group that waits for more live posts once for all of them: each wake of a thread costs more than a cycle's
/// share of its group.
#[derive(Debug)]
struct Enough {
    /// Live posts in the lane from which on the group is woken; nobody waits for the largest number there is.
    wanted: AtomicUsize,
    /// Whether nobody can hand in any more.
    ended: AtomicBool,
    told: Notify,
}

impl Enough {
    const NOBODY_WAITS: usize = usize::MAX;

    fn new() -> Self {
        Self {
            wanted: AtomicUsize::new(Self::NOBODY_WAITS),
            ended: AtomicBool::new(false),
            told: Notify::new(),
        }
    }

    /// Said by whoever has put something into a lane that holds so many now.
    fn tell(&self, waiting: usize) {
        // Behind the post that was put there: whoever waits looks at the lane after it has said what it wants.
        if self.wanted.load(Ordering::SeqCst) <= waiting {
            self.told.notify_one();
        }
    }

    /// Said when nobody can hand in any more: there is nothing to wait for.
    fn end(&self) {
        self.ended.store(true, Ordering::SeqCst);
        self.told.notify_one();
    }

    /// Waits until the lane holds `wanted`, but not beyond a moment; `false` where it does not.
    async fn wait(&self, lane: &mpsc::Receiver<Queued>, wanted: usize, until: Instant) -> bool {
        self.wanted.store(wanted, Ordering::SeqCst);
        let came = async {
            // What was told before may have been of an earlier wait.
            while lane.len() < wanted && !self.ended.load(Ordering::SeqCst) {
                self.told.notified().await;
            }
        };
        // Too late or not: what there is tells.
        let _ = timeout_at(until.into(), came).await;
        self.wanted.store(Self::NOBODY_WAITS, Ordering::SeqCst);
        lane.len() >= wanted
    }
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
        self.ends.live.try_send(Queued { cycle, answer }).map_err(|error| match error {
            mpsc::error::TrySendError::Full(_) => WriteError::Busy,
            mpsc::error::TrySendError::Closed(_) => WriteError::Closing,
        })?;
        self.ends.enough.tell(waiting_in(&self.ends.live));
        Ok(answered)
    }

    /// Queues a cycle of a batch behind live ones; waits for room.
    pub async fn enqueue_patiently(&self, cycle: NewCycle) -> Result<Answered, WriteError> {
        let (answer, answered) = oneshot::channel();
        self.ends.batch.send(Queued { cycle, answer }).await.map_err(|_| WriteError::Closing)?;
        Ok(answered)
    }

    /// Cycles waiting now.
    pub fn depth(&self) -> usize {
        waiting_in(&self.ends.live) + waiting_in(&self.ends.batch)
    }
}

/// Cycles that wait in a lane.
fn waiting_in(lane: &mpsc::Sender<Queued>) -> usize {
    lane.max_capacity() - lane.capacity()
}

/// Starts the writer. It ends, with everything that was queued committed, when all handles are dropped.
pub fn start(
    store: Arc<dyn Store>,
    bounds: Bounds,
    settings: RecommendSettings,
    clock: Clock,
    observer: Arc<dyn WriterObserver>,
) -> (WriterHandle, JoinHandle<()>) {
    let (handle, lanes) = lanes(bounds.queue.max(1));
    let task = tokio::spawn(run(store, lanes, bounds.group.max(1), settings, clock, observer));
    (handle, task)
}

/// Both ends of lanes that hold so many each.
fn lanes(queue: usize) -> (WriterHandle, Lanes) {
    let ((live, live_waiting), (batch, batch_waiting)) = (mpsc::channel(queue), mpsc::channel(queue));
    let enough = Arc::new(Enough::new());
    let lanes = Lanes { live: live_waiting, batch: batch_waiting, enough: Arc::clone(&enough) };
    (WriterHandle { ends: Arc::new(Ends { live, batch, enough }) }, lanes)
}

/// The writer's ends of the lanes.
struct Lanes {
    live: mpsc::Receiver<Queued>,
    batch: mpsc::Receiver<Queued>,
    enough: Arc<Enough>,
}

/// How many live posts a group waits for, and until when.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Expected {
    posts: usize,
    until: Instant,
}

impl Expected {
    /// What is expected after a group with so many live posts, whose commit took so long and ended just now, when `waiting`
    /// others have come meanwhile: those that are answered may post again. Nothing where few post at once.
    fn after(live: usize, (took, ended): (Duration, Instant), waiting: usize) -> Option<Self> {
        let posts = live + waiting;
        (posts >= MANY).then(|| Self { posts, until: ended + took.min(LONGEST_WAIT) })
    }
}

impl Lanes {
    /// Waits for cycles and fills the group with at most `most`; says how many of them are live posts, or nothing when
    /// nobody can hand in any more.
    async fn fill(
        &mut self,
        group: &mut Vec<Queued>,
        most: usize,
        expected: Option<Expected>,
    ) -> Option<usize> {
        // An empty lane that is closed is ready with nothing: only both of them are the end.
        let (first, mut live) = tokio::select! {
            biased;
            Some(queued) = self.live.recv() => (queued, 1),
            Some(queued) = self.batch.recv() => (queued, 0),
            else => return None,
        };
        group.push(first);
        let kept = if self.batch.is_empty() { 0 } else { (most / BATCH_SHARE).max(1) };
        live += take(&mut self.live, group, most.saturating_sub(kept));
        if let Some(Expected { posts, until }) = expected {
            live += self.gather(group, posts.min(most.saturating_sub(kept)), until).await;
        }
        take(&mut self.batch, group, most);
        // What the batch did not need.
        live += take(&mut self.live, group, most);
        Some(live)
    }

    /// Waits for more live posts, until the group holds so many.
    async fn gather(&mut self, group: &mut Vec<Queued>, posts: usize, until: Instant) -> usize {
        let before = group.len();
        // Emptied before it is full: no post is refused for want of room that its group could have made.
        let most = self.live.max_capacity().div_ceil(2);
        let mut in_time = true;
        while group.len() < posts && in_time {
            in_time = self.enough.wait(&self.live, most.min(posts - group.len()), until).await;
            take(&mut self.live, group, posts);
        }
        group.len() - before
    }
}

/// Moves what waits into the group, until that holds `most`; says how many that were.
fn take(lane: &mut mpsc::Receiver<Queued>, group: &mut Vec<Queued>, most: usize) -> usize {
    let before = group.len();
    while group.len() < most
        && let Ok(queued) = lane.try_recv()
    {
        group.push(queued);
    }
    group.len() - before
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
    let mut expected = None;
    while let Some(live) = lanes.fill(&mut group, most, expected).await {
        let (cycles, answers): (Vec<_>, Vec<_>) =
            group.drain(..).map(|queued| (queued.cycle, queued.answer)).unzip();
        let begun = Instant::now();
        let count = cycles.len();
        let span = tracing::info_span!("commit", cycles = count);
        let outcomes = store.commit_cycles(cycles, clock.now(), settings).instrument(span).await;
        let ended = Instant::now();
        let took = ended.duration_since(begun);
        expected = Expected::after(live, (took, ended), lanes.live.len());
        observer.committed(count, took.as_secs_f64());
        for (answer, outcome) in answers.into_iter().zip(outcomes) {
            if let Err(error) = &outcome {
                observer.failed(error);
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

    fn cycle(id: &str) -> NewCycle {
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
        NewCycle {
            received_at: Timestamp::from_micros(0),
            encoded: codec::encode(&cycle),
            summary: summary(&cycle),
            cycle: Arc::new(cycle),
            generation: None,
            cut_short: false,
        }
    }

    fn queued(id: &str) -> (Queued, Answered) {
        let (answer, answered) = oneshot::channel();
        (Queued { cycle: cycle(id), answer }, answered)
    }

    fn names(group: &[Queued]) -> Vec<String> {
        group.iter().map(|queued| queued.cycle.cycle.id.to_string()).collect()
    }

    #[tokio::test]
    async fn live_posts_go_first_and_a_batch_goes_on() {
        let (handle, mut lanes) = lanes(100);
        for index in 0..20 {
            handle.ends.batch.try_send(queued(&format!("b{index}")).0).unwrap_or_else(|_| panic!("room"));
            handle.enqueue(cycle(&format!("l{index}"))).expect("room");
        }
        let mut group = Vec::new();
        assert_eq!(lanes.fill(&mut group, 16, None).await, Some(14));
        let (first, names_of_first) = (group.len(), names(&group));
        assert_eq!(first, 16);
        assert!(names_of_first[..14].iter().all(|name| name.starts_with('l')), "{names_of_first:?}");
        assert_eq!(names_of_first[14..], ["b0", "b1"]);

        group.clear();
        assert_eq!(lanes.fill(&mut group, 16, None).await, Some(6));
        assert_eq!(
            names(&group)[..7],
            ["l14", "l15", "l16", "l17", "l18", "l19", "b2"],
            "the rest is the batch's"
        );

        // Both hand in nothing more: what waits is still taken, then it ends.
        drop(handle);
        group.clear();
        assert_eq!(lanes.fill(&mut group, 16, None).await, Some(0));
        assert_eq!(names(&group).len(), 8);
        group.clear();
        assert_eq!(lanes.fill(&mut group, 16, None).await, None);
    }

    #[tokio::test]
    async fn a_group_waits_for_posts_that_are_about_to_come_and_no_longer_than_it_may() {
        let (handle, mut lanes) = lanes(100);
        let hand_in = |index: usize| drop(handle.enqueue(cycle(&format!("l{index}"))).expect("room"));
        let later = Instant::now() + Duration::from_secs(600);
        let patient = |posts| Some(Expected { posts, until: later });
        let mut group = Vec::new();
        hand_in(0);
        let others = async {
            for index in 1..12 {
                tokio::task::yield_now().await;
                hand_in(index);
            }
        };
        let (filled, ()) = tokio::join!(lanes.fill(&mut group, 16, patient(10)), others);
        assert_eq!(filled, Some(10), "those that are expected");
        assert_eq!(names(&group), (0..10).map(|index| format!("l{index}")).collect::<Vec<_>>());

        group.clear();
        hand_in(12);
        let soon = Some(Expected { posts: 10, until: Instant::now() + Duration::from_millis(1) });
        assert_eq!(lanes.fill(&mut group, 16, soon).await, Some(3), "no more came until then");

        // Hours after many have posted at once, one posts alone.
        group.clear();
        hand_in(13);
        let long_past = Some(Expected { posts: 10, until: Instant::now() });
        assert_eq!(lanes.fill(&mut group, 16, long_past).await, Some(1));

        group.clear();
        (13..33).for_each(&hand_in);
        assert_eq!(lanes.fill(&mut group, 16, patient(100)).await, Some(16), "never more than a group holds");

        // Nobody can hand in any more: there is nothing to wait for.
        drop(handle);
        group.clear();
        assert_eq!(lanes.fill(&mut group, 16, patient(10)).await, Some(4));
        assert_eq!(lanes.fill(&mut group, 16, patient(10)).await, None);
    }

    #[tokio::test]
    async fn a_group_that_waits_for_more_than_the_lane_holds_makes_room() {
        let (handle, mut lanes) = lanes(4);
        let expected = Some(Expected { posts: 30, until: Instant::now() + Duration::from_secs(600) });
        let mut group = Vec::new();
        let posts = async {
            for index in 0..30 {
                handle.enqueue(cycle(&format!("l{index}"))).expect("room");
                tokio::task::yield_now().await;
            }
        };
        let (filled, ()) = tokio::join!(lanes.fill(&mut group, 64, expected), posts);
        assert_eq!((filled, group.len()), (Some(30), 30));
    }

    #[test]
    fn only_where_many_post_at_once_a_group_waits_for_more() {
        let (took, ended) = (Duration::from_millis(2), Instant::now());
        assert_eq!(Expected::after(1, (took, ended), 0), None, "one alone");
        assert_eq!(Expected::after(MANY - 2, (took, ended), 1), None);
        assert_eq!(Expected::after(5, (took, ended), 7), Some(Expected { posts: 12, until: ended + took }));
        let slow = Expected::after(20, (Duration::from_secs(3), ended), 0).unwrap();
        assert_eq!(slow.until, ended + LONGEST_WAIT, "a slow disk does not hold up posts twice");
    }
}

//! The one writer: a bounded queue in front, groups behind, an answer to each after its commit.

use crate::clock::Clock;
use feedwright_core::recommend::RecommendSettings;
use feedwright_store::{Committed, NewCycle, Store, StoreError, StoreResult};
use std::sync::Arc;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;
use tracing::Instrument;

/// Bounds of the writer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bounds {
    /// Cycles that may wait.
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
    queue: mpsc::Sender<Queued>,
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
    /// Queues a cycle, or says at once that the queue is full.
    pub fn enqueue(&self, cycle: NewCycle) -> Result<Answered, WriteError> {
        let (answer, answered) = oneshot::channel();
        self.queue.try_send(Queued { cycle, answer }).map_err(|error| match error {
            mpsc::error::TrySendError::Full(_) => WriteError::Busy,
            mpsc::error::TrySendError::Closed(_) => WriteError::Closing,
        })?;
        Ok(answered)
    }

    /// As [`WriterHandle::enqueue`], but waits for room.
    pub async fn enqueue_patiently(&self, cycle: NewCycle) -> Result<Answered, WriteError> {
        let (answer, answered) = oneshot::channel();
        self.queue.send(Queued { cycle, answer }).await.map_err(|_| WriteError::Closing)?;
        Ok(answered)
    }

    /// Cycles waiting now.
    pub fn depth(&self) -> usize {
        self.queue.max_capacity() - self.queue.capacity()
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
    let (queue, waiting) = mpsc::channel(bounds.queue.max(1));
    let task = tokio::spawn(run(store, waiting, bounds.group.max(1), settings, clock, observer));
    (WriterHandle { queue }, task)
}

async fn run(
    store: Arc<dyn Store>,
    mut waiting: mpsc::Receiver<Queued>,
    most: usize,
    settings: RecommendSettings,
    clock: Clock,
    observer: Arc<dyn WriterObserver>,
) {
    let mut group = Vec::with_capacity(most);
    while waiting.recv_many(&mut group, most).await > 0 {
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

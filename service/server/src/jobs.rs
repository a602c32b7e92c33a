//! Long computations: bounded in number and size, one at a time on all cores, cancelled at shutdown, kept by what
//! they were asked.
//!
//! A job belongs to its question: whoever asks the same gets the same job, and its result for as long as it is kept.
//! Nothing survives a restart, nor is told to other servers, since everything can be computed again. What is computed does not
//! belong here.

use crate::http::problem::Problem;
use crate::lifecycle::Lifecycle;
use bytes::Bytes;
use feedwright_core::units::Timestamp;
use http::StatusCode;
use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::{Notify, Semaphore};

/// Most jobs that wait or run: at a minute each, the last one begins after less than ten.
pub const MAX_ACTIVE: usize = 8;
/// Most ended jobs that are kept: a morning's work at a map, and a list that is searched in no time.
pub const MAX_ENDED: usize = 64;
/// Most bytes of results that are kept: three of the largest maps, or a hundred of the paper's.
pub const MAX_RESULT_BYTES: usize = 64 << 20;
/// Most steps that are computed while the client waits: about half a second on one core.
pub const INLINE_STEPS: u64 = 10_000_000;
/// Most steps of one job: as many as the largest map that the core accepts.
pub const MAX_STEPS: u64 = 250_000 * 500 * 100;
/// Short computations under way at once: leaves cores to the intake of cycles on a small machine.
const MAX_INLINE: usize = 2;

/// What a computation reports to and is stopped by.
#[derive(Debug, Default)]
pub struct Progress {
    done: AtomicUsize,
    cancel: AtomicBool,
}

impl Progress {
    /// Says how many points are done.
    pub fn at(&self, done: usize) {
        self.done.fetch_max(done, Ordering::Relaxed);
    }

    /// The flag that is raised when nobody wants the result any more.
    pub const fn cancel(&self) -> &AtomicBool {
        &self.cancel
    }

    fn cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// Computes `count` values on all cores, in their order; none where it was cancelled.
    pub fn all<T: Send>(&self, count: usize, value: impl Fn(usize) -> T + Sync) -> Option<Vec<T>> {
        let (next, finished) = (AtomicUsize::new(0), Mutex::new(Vec::with_capacity(count)));
        std::thread::scope(|scope| {
            for _ in 0..workers().get().min(count) {
                scope.spawn(|| {
                    while !self.cancelled() {
                        let index = next.fetch_add(1, Ordering::Relaxed);
                        if index >= count {
                            break;
                        }
                        let made = value(index);
                        let mut finished = locked(&finished);
                        finished.push((index, made));
                        self.at(finished.len());
                    }
                });
            }
        });
        let mut finished = finished.into_inner().unwrap_or_else(PoisonError::into_inner);
        finished.sort_by_key(|(index, _)| *index);
        (finished.len() == count).then(|| finished.into_iter().map(|(_, value)| value).collect())
    }
}

/// Threads that a job computes on.
pub fn workers() -> NonZeroUsize {
    std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN)
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // What is guarded is valid after every statement, so a panic elsewhere does not spoil it.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Where a job is.
#[derive(Debug, Clone)]
pub enum Stage {
    /// Another one runs.
    Waiting,
    /// It runs.
    Running,
    /// Its result as JSON.
    Done(Bytes),
    /// It was cancelled, by a client or by the shutdown.
    Cancelled,
    /// It broke off; the log says why.
    Failed,
}

impl Stage {
    const fn active(&self) -> bool {
        matches!(self, Self::Waiting | Self::Running)
    }
}

/// A job as it stands.
#[derive(Debug, Clone)]
pub struct Snapshot {
    /// Its id.
    pub id: String,
    /// What is computed.
    pub kind: &'static str,
    /// Where it is.
    pub stage: Stage,
    /// Points done.
    pub done: usize,
    /// Points in all.
    pub total: usize,
    /// When it was asked for first.
    pub created_at: Timestamp,
}

/// A question: what is computed, from which parameters, how large it is.
#[derive(Debug, Clone)]
pub struct Question {
    /// What is computed.
    pub kind: &'static str,
    /// The parameters as they were understood; equal text is the same question.
    pub parameters: String,
    /// Points in all.
    pub total: usize,
    /// Integration steps in all.
    pub steps: u64,
}

struct Job {
    kind: &'static str,
    key: blake3::Hash,
    total: usize,
    created_at: Timestamp,
    progress: Progress,
    stage: Mutex<Stage>,
    woken: Notify,
}

impl Job {
    fn snapshot(&self, id: &str) -> Snapshot {
        let stage = locked(&self.stage).clone();
        let done = if matches!(stage, Stage::Done(_)) {
            self.total
        } else {
            self.progress.done.load(Ordering::Relaxed)
        };
        Snapshot {
            id: id.to_owned(),
            kind: self.kind,
            stage,
            done,
            total: self.total,
            created_at: self.created_at,
        }
    }

    fn set(&self, stage: Stage) {
        *locked(&self.stage) = stage;
    }

    fn stop(&self) {
        self.progress.cancel.store(true, Ordering::Relaxed);
        self.woken.notify_one();
    }
}

/// Every job there is; cheap to clone.
#[derive(Clone)]
pub struct Jobs {
    /// By id; ids ascend in time.
    jobs: Arc<Mutex<BTreeMap<String, Arc<Job>>>>,
    turn: Arc<Semaphore>,
    inline: Arc<Semaphore>,
}

impl Default for Jobs {
    fn default() -> Self {
        Self {
            jobs: Arc::default(),
            turn: Arc::new(Semaphore::new(1)),
            inline: Arc::new(Semaphore::new(MAX_INLINE)),
        }
    }
}

impl Jobs {
    /// Computes something short while the client waits, away from the threads that serve.
    pub async fn inline<T: Send + 'static>(
        &self,
        lifecycle: &Lifecycle,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let closed = |error: tokio::sync::AcquireError| Problem::internal(error.to_string());
        let permit = self.inline.clone().acquire_owned().await.map_err(closed)?;
        // The permit goes with the work: a client that hangs up must not make room for more.
        let task = lifecycle.spawn(async move {
            let done = tokio::task::spawn_blocking(work).await;
            drop(permit);
            done
        });
        let done = task.await.map_err(|error| Problem::internal(error.to_string()))?;
        done.map_err(|error| Problem::internal(error.to_string()))
    }

    /// The job of a question: the one that there is, or a new one.
    ///
    /// 503 where [`MAX_ACTIVE`] wait or run already, or the server is going down.
    pub fn submit(
        &self,
        question: &Question,
        lifecycle: &Lifecycle,
        now: Timestamp,
        work: impl FnOnce(&Progress) -> Option<Bytes> + Send + 'static,
    ) -> Result<Snapshot, Problem> {
        let key = blake3::hash(format!("{}\0{}", question.kind, question.parameters).as_bytes());
        let mut jobs = locked(&self.jobs);
        let usable = |job: &Job| {
            let stage = locked(&job.stage);
            matches!(*stage, Stage::Done(_)) || (stage.active() && !job.progress.cancelled())
        };
        if let Some((id, job)) = jobs.iter().find(|(_, job)| job.key == key && usable(job)) {
            return Ok(job.snapshot(id));
        }
        if lifecycle.is_stopping() {
            return Err(Problem::unavailable("stopping", "the server is going down", 10));
        }
        if jobs.values().filter(|job| locked(&job.stage).active()).count() >= MAX_ACTIVE {
            let detail = format!("{MAX_ACTIVE} computations wait or run already");
            return Err(Problem::unavailable("too_many_jobs", detail, 30));
        }
        let id = uuid::Uuid::now_v7().to_string();
        let job = Arc::new(Job {
            kind: question.kind,
            key,
            total: question.total,
            created_at: now,
            progress: Progress::default(),
            stage: Mutex::new(Stage::Waiting),
            woken: Notify::new(),
        });
        jobs.insert(id.clone(), job.clone());
        let snapshot = job.snapshot(&id);
        drop(jobs);
        let all = self.clone();
        let stopping = lifecycle.clone();
        lifecycle.spawn(async move {
            let stage = all.carry_out(&job, &stopping, work).await;
            job.set(stage);
            all.forget_old();
        });
        Ok(snapshot)
    }

    async fn carry_out(
        &self,
        job: &Arc<Job>,
        lifecycle: &Lifecycle,
        work: impl FnOnce(&Progress) -> Option<Bytes> + Send + 'static,
    ) -> Stage {
        let _turn = tokio::select! {
            biased;
            () = job.woken.notified() => return Stage::Cancelled,
            () = lifecycle.stopping() => return Stage::Cancelled,
            turn = self.turn.clone().acquire_owned() => turn,
        };
        job.set(Stage::Running);
        let computing = job.clone();
        let mut worker = tokio::task::spawn_blocking(move || work(&computing.progress));
        let ended = tokio::select! {
            ended = &mut worker => ended,
            () = lifecycle.stopping() => {
                job.stop();
                worker.await
            }
        };
        match ended {
            Ok(Some(result)) => Stage::Done(result),
            Ok(None) => Stage::Cancelled,
            Err(error) => {
                tracing::error!(%error, kind = job.kind, "a computation broke off");
                Stage::Failed
            }
        }
    }

    /// Forgets the oldest ended jobs beyond the bounds.
    fn forget_old(&self) {
        let mut jobs = locked(&self.jobs);
        let (mut ended, mut bytes) = (0, 0);
        let mut kept = BTreeMap::new();
        for (id, job) in std::mem::take(&mut *jobs).into_iter().rev() {
            let size = match &*locked(&job.stage) {
                Stage::Done(result) => Some(result.len()),
                Stage::Cancelled | Stage::Failed => Some(0),
                Stage::Waiting | Stage::Running => None,
            };
            if let Some(size) = size {
                ended += 1;
                bytes += size;
                // The newest stays whatever its size: somebody has just waited for it.
                if ended > 1 && (ended > MAX_ENDED || bytes > MAX_RESULT_BYTES) {
                    continue;
                }
            }
            kept.insert(id, job);
        }
        *jobs = kept;
    }

    /// A job as it stands.
    pub fn get(&self, id: &str) -> Option<Snapshot> {
        locked(&self.jobs).get(id).map(|job| job.snapshot(id))
    }

    /// Cancels a job that waits or runs; `None` where there is none of that id.
    ///
    /// 409 where it has ended already.
    pub fn cancel(&self, id: &str) -> Option<Result<(), Problem>> {
        let job = locked(&self.jobs).get(id).cloned()?;
        let active = locked(&job.stage).active();
        if !active {
            let detail = "the computation has ended: there is nothing to cancel";
            return Some(Err(Problem::new(StatusCode::CONFLICT, "job_ended", detail)));
        }
        job.stop();
        Some(Ok(()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn question(parameters: &str) -> Question {
        Question { kind: "test", parameters: parameters.to_owned(), total: 10, steps: 0 }
    }

    const NOW: Timestamp = Timestamp::from_micros(0);

    fn endless(progress: &Progress) -> Option<Bytes> {
        while !progress.cancelled() {
            std::thread::yield_now();
        }
        None
    }

    async fn ended(jobs: &Jobs, id: &str) -> Stage {
        loop {
            match jobs.get(id).map(|job| job.stage) {
                Some(stage) if !stage.active() => return stage,
                Some(_) => tokio::task::yield_now().await,
                None => panic!("{id} is forgotten"),
            }
        }
    }

    #[tokio::test]
    async fn the_same_question_is_computed_once_and_cancelled_work_again() {
        let (jobs, lifecycle) = (Jobs::default(), Lifecycle::default());
        let submit =
            |text: &str| jobs.submit(&question(text), &lifecycle, NOW, |_| Some("1".into())).unwrap();
        let first = submit("a");
        assert!(matches!(ended(&jobs, &first.id).await, Stage::Done(_)));
        assert_eq!(submit("a").id, first.id);
        assert_ne!(submit("b").id, first.id);
        let slow = jobs.submit(&question("c"), &lifecycle, NOW, endless).unwrap();
        jobs.cancel(&slow.id).unwrap().unwrap();
        assert!(matches!(ended(&jobs, &slow.id).await, Stage::Cancelled));
        assert_ne!(submit("c").id, slow.id);
        assert_eq!(jobs.cancel(&slow.id).unwrap().unwrap_err().code, "job_ended");
        assert!(jobs.cancel("none").is_none());
    }

    #[tokio::test]
    async fn jobs_are_bounded_wait_for_each_other_and_end_at_shutdown() {
        let (jobs, lifecycle) = (Jobs::default(), Lifecycle::default());
        let submit = |n: usize| jobs.submit(&question(&n.to_string()), &lifecycle, NOW, endless);
        let all: Vec<_> = (0..MAX_ACTIVE).map(|n| submit(n).unwrap().id).collect();
        assert_eq!(submit(MAX_ACTIVE).unwrap_err().code, "too_many_jobs");
        // One that waits is cancelled without ever having run.
        jobs.cancel(&all[3]).unwrap().unwrap();
        assert!(matches!(ended(&jobs, &all[3]).await, Stage::Cancelled));
        lifecycle.stop();
        lifecycle.tasks_ended().await;
        for id in &all {
            assert!(matches!(jobs.get(id).unwrap().stage, Stage::Cancelled));
        }
        assert_eq!(submit(99).unwrap_err().code, "stopping");
    }

    #[tokio::test]
    async fn old_results_are_forgotten() {
        let (jobs, lifecycle) = (Jobs::default(), Lifecycle::default());
        let mut ids = Vec::new();
        for n in 0..MAX_ENDED + 3 {
            let job = jobs.submit(&question(&n.to_string()), &lifecycle, NOW, |_| Some("1".into())).unwrap();
            ended(&jobs, &job.id).await;
            ids.push(job.id);
        }
        lifecycle.tasks_ended().await;
        assert!(jobs.get(&ids[0]).is_none() && jobs.get(&ids[MAX_ENDED + 2]).is_some());
    }

    #[test]
    fn values_come_in_their_order_from_all_cores() {
        let progress = Progress::default();
        assert_eq!(progress.all(100, |n| n * 2).unwrap(), (0..100).map(|n| n * 2).collect::<Vec<_>>());
        assert_eq!(progress.done.load(Ordering::Relaxed), 100);
        progress.cancel.store(true, Ordering::Relaxed);
        assert_eq!(progress.all(3, |n| n), None);
    }
}

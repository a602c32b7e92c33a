//! The life of the process: running, going down, or failed; and the tasks that have to end before it does.

use feedwright_store::StoreError;
use std::future::Future;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::task::JoinHandle;
use tokio::time::{Interval, MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tokio_util::task::task_tracker::TaskTrackerToken;

/// So long after a panic what goes on begins anew.
const AGAIN: Duration = if cfg!(test) { Duration::from_millis(1) } else { Duration::from_secs(5) };

/// Shared by everything that runs; cheap to clone.
#[derive(Debug, Clone, Default)]
pub struct Lifecycle {
    tasks: TaskTracker,
    stopping: CancellationToken,
    failed: CancellationToken,
    why: Arc<OnceLock<String>>,
}

impl Lifecycle {
    /// Runs a task that a client cannot cancel and that shutdown waits for.
    pub fn spawn<T: Send + 'static>(&self, task: impl Future<Output = T> + Send + 'static) -> JoinHandle<T> {
        self.tasks.spawn(task)
    }

    /// Runs what goes on until the shutdown begins. A panic does not end it unnoticed: it is told, and after a pause it begins anew, as
    /// whatever else runs here goes on.
    pub fn keep<F, T>(&self, what: &'static str, run: F)
    where
        F: Fn() -> T + Send + 'static,
        T: Future<Output = ()> + Send + 'static,
    {
        self.tasks.spawn(begin_anew(what, run, self.stopping.clone()));
    }

    /// Ticks, the first at once, until the shutdown begins; after a late one the next comes a whole period later.
    pub fn every(&self, period: Duration) -> Ticks {
        let mut ticks = interval(period);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        Ticks { ticks, lifecycle: self.clone() }
    }

    /// Counts as a task until it is dropped: for work that another runs, such as an upgraded connection.
    pub fn track(&self) -> TaskTrackerToken {
        self.tasks.token()
    }

    /// Whether no new work is taken.
    pub fn is_stopping(&self) -> bool {
        self.stopping.is_cancelled() || self.failed.is_cancelled()
    }

    /// Ends when shutdown begins: long-lived answers (streams) end themselves then.
    pub async fn stopping(&self) {
        self.stopping.cancelled().await;
    }

    /// Begins the shutdown.
    pub(crate) fn stop(&self) {
        self.stopping.cancel();
    }

    /// Says that the process cannot do its work any more: it is not ready from now on, and exits.
    pub fn fail(&self, why: &str) {
        if self.why.set(why.to_owned()).is_ok() {
            tracing::error!(why, "giving up");
            self.failed.cancel();
        }
    }

    /// The same where a change ended with a disk that fails.
    pub fn heed(&self, error: &StoreError) {
        if let Some(cause) = error.of_the_disk() {
            self.fail(&format!("{error}: {cause}"));
        }
    }

    /// Ends when the process has failed, with the reason.
    pub async fn failed(&self) -> String {
        self.failed.cancelled().await;
        self.failure().unwrap_or_default().to_owned()
    }

    /// Why the process has failed, where it has.
    pub fn failure(&self) -> Option<&str> {
        self.why.get().map(String::as_str)
    }

    /// Ends when every task has ended.
    pub(crate) async fn tasks_ended(&self) {
        self.tasks.close();
        self.tasks.wait().await;
    }
}

/// Runs what goes on; after a panic it is told and, after a pause, run anew, unless it is over by then.
pub(crate) async fn begin_anew<F, T>(what: &'static str, run: F, over: CancellationToken)
where
    F: Fn() -> T,
    T: Future<Output = ()> + Send + 'static,
{
    while let Err(error) = tokio::spawn(run()).await
        && error.is_panic()
    {
        tracing::error!(%error, what, "it panicked, and begins anew after a pause");
        tokio::select! {
            () = tokio::time::sleep(AGAIN) => {}
            () = over.cancelled() => return,
        }
    }
}

/// What [`Lifecycle::every`] makes.
#[derive(Debug)]
pub struct Ticks {
    ticks: Interval,
    lifecycle: Lifecycle,
}

impl Ticks {
    /// Waits for the next one; `false` where the shutdown begins. Only this waiting is cut short, and nothing that is done between two.
    pub async fn next(&mut self) -> bool {
        tokio::select! {
            _ = self.ticks.tick() => true,
            () = self.lifecycle.stopping() => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering};

    #[tokio::test]
    async fn what_goes_on_begins_anew_after_a_panic_until_it_ends() {
        let lifecycle = Lifecycle::default();
        let begun = Arc::new(AtomicU32::new(0));
        let counted = begun.clone();
        lifecycle.keep("counting", move || {
            let count = counted.fetch_add(1, Ordering::Relaxed);
            async move { assert!(count == 2, "this is the panic of a test") }
        });
        lifecycle.tasks_ended().await;
        assert_eq!(begun.load(Ordering::Relaxed), 3);
    }

    #[tokio::test]
    async fn ticks_end_with_the_shutdown() {
        let lifecycle = Lifecycle::default();
        let mut ticks = lifecycle.every(Duration::from_secs(3600));
        assert!(ticks.next().await, "the first comes at once");
        lifecycle.stop();
        assert!(!ticks.next().await);
    }
}

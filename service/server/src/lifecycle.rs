//! The life of the process: running, going down, or failed; and the tasks that have to end before it does.

use std::future::Future;
use std::sync::{Arc, OnceLock};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tokio_util::task::task_tracker::TaskTrackerToken;

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

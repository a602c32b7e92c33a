//! The thread that groups are counted and written on: it waits for the disk where the runtime's threads must not, and
//! what a group has in hand stays in one processor's cache.

use crate::error::{StoreError, StoreResult};
use std::future::Future;
use tokio::runtime::{Builder, Handle};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

/// A thread that runs what is spawned on it; it ends when this is dropped.
#[derive(Debug)]
pub(super) struct GroupThread {
    tasks: Handle,
    _open: oneshot::Sender<()>,
}

impl GroupThread {
    pub(super) fn start() -> StoreResult<Self> {
        let failed = |error: std::io::Error| StoreError::Unavailable(Box::new(error));
        let runtime = Builder::new_current_thread().enable_time().build().map_err(failed)?;
        let tasks = runtime.handle().clone();
        let (open, closed) = oneshot::channel::<()>();
        let run = move || {
            // Its other end is never told anything, only dropped.
            let _ = runtime.block_on(closed);
        };
        std::thread::Builder::new().name("sqlite-groups".to_owned()).spawn(run).map_err(failed)?;
        Ok(Self { tasks, _open: open })
    }

    /// Runs a task that nobody cancels by no longer waiting for it.
    pub(super) fn spawn<F>(&self, task: F) -> JoinHandle<F::Output>
    where
        F: Future<Output: Send> + Send + 'static,
    {
        self.tasks.spawn(task)
    }
}

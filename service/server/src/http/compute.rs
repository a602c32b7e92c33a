//! Long computations: off the threads that answer requests, and only a few at a time.

use super::problem::Problem;
use tokio::sync::Semaphore;

/// Computations under way at a time: enough for a shop's engineers, and they cannot starve the intake of cycles.
const MOST_COMPUTATIONS: usize = 4;

/// Seconds after which a refused computation may be asked for again: most take well under one.
const TRY_AGAIN_S: u64 = 1;

static ROOM: Semaphore = Semaphore::const_new(MOST_COMPUTATIONS);

/// Runs `work` on a thread of its own; 503 where too many run already.
pub async fn compute<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    let Ok(permit) = ROOM.try_acquire() else {
        let detail = "other computations are under way; nothing was computed";
        return Err(Problem::unavailable("computing", detail, TRY_AGAIN_S));
    };
    // The permit goes with the work: a client that hangs up does not make room for a second one beside it.
    let done = tokio::task::spawn_blocking(move || {
        let result = work();
        drop(permit);
        result
    });
    done.await.map_err(|error| Problem::internal(error.to_string()))?
}

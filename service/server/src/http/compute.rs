//! Long computations: off the threads that answer requests, and only a few at a time.

use super::problem::Problem;
use std::sync::Arc;
use tokio::sync::{Semaphore, SemaphorePermit};

/// Computations under way at a time: enough for a shop's engineers, and they cannot starve the intake of cycles.
const MOST_COMPUTATIONS: usize = 4;

/// Seconds after which a refused computation may be asked for again: most take well under one.
const TRY_AGAIN_S: u64 = 1;

static ROOM: Semaphore = Semaphore::const_new(MOST_COMPUTATIONS);

/// Room for one request's computations, until its last copy is dropped.
#[derive(Clone)]
pub struct Room {
    _permit: Arc<SemaphorePermit<'static>>,
}

/// Room for one request's computations; 503 where too many run already.
pub fn room() -> Result<Room, Problem> {
    let permit = ROOM.try_acquire().map_err(|_| {
        let detail = "other computations are under way; nothing was computed";
        Problem::unavailable("computing", detail, TRY_AGAIN_S)
    })?;
    Ok(Room { _permit: Arc::new(permit) })
}

/// Runs `work` on a thread of its own, for a request that has room. The room goes with the work: a client that hangs up does not
/// make room for a second one beside it.
pub async fn on_thread<T: Send + 'static>(
    room: &Room,
    work: impl FnOnce() -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    let room = room.clone();
    let run = move || {
        let result = work();
        drop(room);
        result
    };
    tokio::task::spawn_blocking(run).await.map_err(|error| Problem::internal(error.to_string()))?
}

/// Finds room and runs `work` on a thread of its own.
pub async fn compute<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    let room = room()?;
    on_thread(&room, work).await
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::future::Future;
    use std::sync::mpsc;
    use std::task::{Context, Waker};

    #[tokio::test]
    async fn whoever_hangs_up_makes_no_room_while_the_work_runs() {
        static PLACES: Semaphore = Semaphore::const_new(1);
        let room = Room { _permit: Arc::new(PLACES.try_acquire().unwrap()) };
        let ((begun, begins), (end, ends)) = (mpsc::channel(), mpsc::channel());
        let work = move || {
            begun.send(()).unwrap();
            ends.recv().unwrap();
            Ok(())
        };
        {
            let mut asked = Box::pin(on_thread(&room, work));
            assert!(asked.as_mut().poll(&mut Context::from_waker(Waker::noop())).is_pending());
        }
        drop(room);
        begins.recv().unwrap();
        assert_eq!(PLACES.available_permits(), 0);
        end.send(()).unwrap();
        // Ready as soon as the work has given it back.
        drop(PLACES.acquire().await.unwrap());
    }
}

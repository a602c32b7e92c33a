//! Who may read at a time: long reads leave connections to the usual ones, and both leave some to those that posts wait for.

use crate::error::{StoreError, StoreResult};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::time::timeout;

/// What a read waits behind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Lane {
    /// What posts, streams and every request need before anything else: tokens, sessions, what is registered. A few rows by
    /// their keys, behind nobody.
    Short,
    /// A page of a list, or as much.
    Usual,
    /// As many rows as somebody asks for: walks through a tool's history, series, checks.
    Long,
}

/// How many reads of each kind hold a connection at a time.
#[derive(Debug)]
pub(crate) struct Lanes {
    /// Usual and long ones together.
    usual: Arc<Semaphore>,
    long: Arc<Semaphore>,
    patience: Duration,
    /// Whether reads of many statements end.
    end: watch::Sender<bool>,
}

/// A turn to read, until it is dropped.
#[derive(Debug, Default)]
pub(crate) struct Turn {
    _long: Option<OwnedSemaphorePermit>,
    _usual: Option<OwnedSemaphorePermit>,
}

/// Said where a read waited in vain for others to end: the database is there, and does what it can.
#[derive(Debug, thiserror::Error)]
#[error("other reads are under way")]
pub(crate) struct OthersRead;

impl From<OthersRead> for StoreError {
    fn from(why: OthersRead) -> Self {
        Self::Unavailable(Box::new(why))
    }
}

/// Said to nobody, as who asked is gone; or where the store is closed.
#[derive(Debug, thiserror::Error)]
#[error("the read was ended before its answer was complete")]
pub(crate) struct Ended;

impl From<Ended> for StoreError {
    fn from(why: Ended) -> Self {
        Self::Unavailable(Box::new(why))
    }
}

impl StoreError {
    /// Whether a read waited for others that took too long, while the database does answer.
    pub fn is_of_other_reads(&self) -> bool {
        matches!(self, Self::Unavailable(source) if source.is::<OthersRead>())
    }
}

impl Lanes {
    /// Lanes of so many usual and long reads together, and of so many long ones; of each one at the least.
    pub(crate) fn of(usual: u32, long: u32, patience: Duration) -> Self {
        let room = |most: u32| Arc::new(Semaphore::new(most.max(1) as usize));
        Self { usual: room(usual), long: room(long), patience, end: watch::Sender::new(false) }
    }

    /// Waits for a turn, in the order of who came, for as long as one waits for a connection.
    pub(crate) async fn turn(&self, lane: Lane) -> StoreResult<Turn> {
        let waiting = async {
            // First the narrower one: who waits for it keeps nobody from a usual read.
            let _long = match lane {
                Lane::Long => Some(Arc::clone(&self.long).acquire_owned().await),
                Lane::Usual | Lane::Short => None,
            };
            let _usual = match lane {
                Lane::Long | Lane::Usual => Some(Arc::clone(&self.usual).acquire_owned().await),
                Lane::Short => None,
            };
            // Nobody closes them.
            Turn { _long: _long.and_then(Result::ok), _usual: _usual.and_then(Result::ok) }
        };
        timeout(self.patience, waiting).await.map_err(|_late| OthersRead.into())
    }

    /// Ends what reads by many statements, as the store is closed.
    pub(crate) fn end(&self) {
        self.end.send_replace(true);
    }

    /// Ready when [`Lanes::end`] was called.
    pub(crate) fn ended(&self) -> impl Future<Output = ()> + use<> {
        let mut end = self.end.subscribe();
        async move {
            // Nobody is left to end them where the sender is gone.
            let _ = end.wait_for(|end| *end).await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::task::{Context, Waker};

    fn is_waiting(asked: impl Future<Output = StoreResult<Turn>>) -> bool {
        let mut asked = std::pin::pin!(asked);
        asked.as_mut().poll(&mut Context::from_waker(Waker::noop())).is_pending()
    }

    #[tokio::test]
    async fn long_reads_leave_room_to_usual_ones_and_both_to_short_ones() {
        let lanes = Lanes::of(3, 2, Duration::from_secs(3600));
        let mut held = vec![lanes.turn(Lane::Long).await.unwrap(), lanes.turn(Lane::Long).await.unwrap()];
        assert!(is_waiting(lanes.turn(Lane::Long)));
        held.push(lanes.turn(Lane::Usual).await.unwrap());
        assert!(is_waiting(lanes.turn(Lane::Usual)));
        for _ in 0..100 {
            held.push(lanes.turn(Lane::Short).await.unwrap());
        }
        // Usual ones alone may have all that is not kept for the short ones.
        held.clear();
        for _ in 0..3 {
            held.push(lanes.turn(Lane::Usual).await.unwrap());
        }
        assert!(is_waiting(lanes.turn(Lane::Usual)));
        assert!(is_waiting(lanes.turn(Lane::Long)));
        held.pop();
        drop(lanes.turn(Lane::Long).await.unwrap());
    }

    #[tokio::test]
    async fn who_waits_in_vain_is_told_why() {
        let lanes = Lanes::of(1, 1, Duration::ZERO);
        let _held = lanes.turn(Lane::Long).await.unwrap();
        let error = lanes.turn(Lane::Usual).await.unwrap_err();
        assert!(error.is_of_other_reads(), "{error:?}");
        lanes.turn(Lane::Short).await.unwrap();
    }
}

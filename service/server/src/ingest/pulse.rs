//! Whether the database still answers, asked where a commit is late: a slow one is waited for for a minute, one that is away is not.
//!
//! What is given up is the wait, never the commit: that goes on, and whoever sends the cycle again is told what came of it.

use super::writer::Answered;
use feedwright_store::{Committed, Store, StoreResult};
use futures_util::future::BoxFuture;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio::time::timeout;

/// After this long a commit is late, and the database is asked whether it is there.
const LATE: Duration = Duration::from_secs(3);
/// A database that says nothing for this long, asked for nothing but a word, is away.
const PATIENCE: Duration = Duration::from_secs(2);

/// Nothing is waited for longer, whatever the database answers: a lock that somebody holds, or a standby that does not confirm,
/// may keep a commit for ever.
const LONGEST: Duration = Duration::from_secs(60);

/// A database that has answered a question of so long ago is there: many posts wait, and each question is a connection.
const FRESH: Duration = Duration::from_secs(1);

/// Asks the database for a word; `false` where it refuses.
type Ask = Box<dyn Fn() -> BoxFuture<'static, bool> + Send + Sync>;

/// What came of waiting.
#[derive(Debug)]
pub(super) enum Waited {
    /// The commit's answer.
    Answered(StoreResult<Committed>),
    /// The database no longer answers, or has not committed for too long; the commit may come yet.
    GivenUp,
    /// The writer has ended.
    Closed,
}

/// Feels for the database on behalf of every post that waits for its commit.
pub(super) struct Pulse {
    ask: Ask,
    late: Duration,
    longest: Duration,
    patience: Duration,
    fresh: Duration,
    /// The question that is being asked, or was last: since when, and `None` until it is answered.
    asked: Mutex<Option<(Instant, watch::Receiver<Option<bool>>)>>,
}

impl Pulse {
    /// Of a store's database.
    pub(super) fn of(store: Arc<dyn Store>) -> Self {
        let ask = move || -> BoxFuture<'static, bool> {
            let store = Arc::clone(&store);
            // A question that is never answered would stand for all that come later.
            Box::pin(async move { matches!(timeout(PATIENCE, store.answers()).await, Ok(Ok(()))) })
        };
        let ask: Ask = Box::new(ask);
        Self { ask, late: LATE, longest: LONGEST, patience: PATIENCE, fresh: FRESH, asked: Mutex::default() }
    }

    /// Waits for the answer to a queued cycle as long as the database is there.
    pub(super) async fn wait(&self, answered: &mut Answered) -> Waited {
        match self.while_it_beats(answered).await {
            Some(answer) => answer.map_or(Waited::Closed, Waited::Answered),
            None => Waited::GivenUp,
        }
    }

    /// Waits for what comes of the database as long as that is there, and no longer than anything is; `None` where it did not come.
    pub(super) async fn while_it_beats<T>(&self, mut coming: impl Future<Output = T> + Unpin) -> Option<T> {
        let begun = Instant::now();
        loop {
            if let Ok(came) = timeout(self.late, &mut coming).await {
                return Some(came);
            }
            tokio::select! {
                biased;
                came = &mut coming => return Some(came),
                beats = self.beats() => if !beats || begun.elapsed() >= self.longest {
                    return None;
                },
            }
        }
    }

    /// Whether the database answers; one question at a time, for all who ask.
    async fn beats(&self) -> bool {
        let mut answer = self.question();
        // The limit is on waiting, not on the task that asks.
        match timeout(self.patience, answer.wait_for(Option::is_some)).await {
            Ok(Ok(answer)) => *answer == Some(true),
            Ok(Err(_)) | Err(_) => false,
        }
    }

    fn question(&self) -> watch::Receiver<Option<bool>> {
        let mut asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((since, last)) = asked.as_ref() {
            let is_running = last.borrow().is_none() && last.has_changed().is_ok();
            let was_there = *last.borrow() == Some(true) && since.elapsed() < self.fresh;
            if is_running || was_there {
                return last.clone();
            }
        }
        let (tell, answer) = watch::channel(None);
        *asked = Some((Instant::now(), answer.clone()));
        let ask = (self.ask)();
        tokio::spawn(async move {
            let beats = ask.await;
            tell.send_replace(Some(beats));
        });
        answer
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering};
    use tokio::sync::oneshot;

    fn pulse(ask: impl Fn() -> BoxFuture<'static, bool> + Send + Sync + 'static) -> Pulse {
        let moment = Duration::from_millis(5);
        Pulse {
            ask: Box::new(ask),
            late: moment,
            longest: LONGEST,
            patience: moment,
            fresh: Duration::ZERO,
            asked: Mutex::default(),
        }
    }

    #[tokio::test]
    async fn a_slow_commit_is_waited_for_as_long_as_the_database_answers() {
        let (tell, mut answered) = oneshot::channel();
        let (tell, asked) = (Mutex::new(Some(tell)), Arc::new(AtomicU32::new(0)));
        let count = Arc::clone(&asked);
        let pulse = pulse(move || {
            // The commit ends while the database is asked for the fourth time.
            if count.fetch_add(1, Ordering::Relaxed) == 3 {
                tell.lock().unwrap().take().unwrap().send(Ok(Committed::UnknownMachine)).unwrap();
            }
            Box::pin(async { true })
        });
        let waited = pulse.wait(&mut answered).await;
        assert!(matches!(waited, Waited::Answered(Ok(Committed::UnknownMachine))), "{waited:?}");
        assert_eq!(asked.load(Ordering::Relaxed), 4);
    }

    #[tokio::test]
    async fn a_database_that_refuses_or_says_nothing_is_not_waited_for() {
        let (_held, mut answered) = oneshot::channel();
        let waited = pulse(|| Box::pin(async { false })).wait(&mut answered).await;
        assert!(matches!(waited, Waited::GivenUp), "{waited:?}");

        // One question stands for all who wait, also for those who come when it is an old one.
        let asked = Arc::new(AtomicU32::new(0));
        let count = Arc::clone(&asked);
        let silent = pulse(move || {
            count.fetch_add(1, Ordering::Relaxed);
            Box::pin(std::future::pending())
        });
        for _ in 0..3 {
            let (_held, mut answered) = oneshot::channel();
            let waited = silent.wait(&mut answered).await;
            assert!(matches!(waited, Waited::GivenUp), "{waited:?}");
        }
        assert_eq!(asked.load(Ordering::Relaxed), 1);
    }

    #[tokio::test]
    async fn a_database_that_answers_and_never_commits_is_not_waited_for_for_ever() {
        let (_held, mut answered) = oneshot::channel();
        let pulse = Pulse { longest: Duration::from_millis(20), ..pulse(|| Box::pin(async { true })) };
        let begun = Instant::now();
        let waited = pulse.wait(&mut answered).await;
        assert!(matches!(waited, Waited::GivenUp), "{waited:?}");
        assert!(begun.elapsed() >= pulse.longest);
    }

    #[tokio::test]
    async fn a_writer_that_ended_answers_nobody() {
        let (tell, mut answered) = oneshot::channel();
        drop(tell);
        let waited = pulse(|| Box::pin(async { true })).wait(&mut answered).await;
        assert!(matches!(waited, Waited::Closed), "{waited:?}");
    }
}

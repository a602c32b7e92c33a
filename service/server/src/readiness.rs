//! Whether the database takes writes, asked rarely enough that nobody can hammer the disk with the question.

use crate::state::AppState;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// An answer is good for so long.
const FRESH: Duration = Duration::from_secs(2);
/// A probe that takes longer than this means "not ready"; the probe itself goes on.
const PATIENCE: Duration = Duration::from_secs(3);

/// The last probe, or the one that runs.
#[derive(Debug, Default)]
pub(crate) struct Readiness(Mutex<Option<Probe>>);

#[derive(Debug, Clone)]
struct Probe {
    begun: Instant,
    answer: watch::Receiver<Option<Result<(), String>>>,
}

impl AppState {
    /// Says why the service is not ready, where it is not.
    pub async fn ready(&self) -> Result<(), String> {
        if self.lifecycle.is_stopping() {
            return Err(self.lifecycle.failure().unwrap_or("shutting down").to_owned());
        }
        let mut answer = self.probe();
        // The time limit is on waiting for the probe's task, not on the database.
        let waited = tokio::time::timeout(PATIENCE, answer.wait_for(Option::is_some)).await;
        match waited {
            Ok(Ok(answer)) => answer.clone().unwrap_or_else(|| Err("no answer".to_owned())),
            Ok(Err(_)) => Err("the probe was lost".to_owned()),
            Err(_) => Err("the database does not answer in time".to_owned()),
        }
    }

    /// The probe to wait for: a fresh or running one, else a new one. At most one runs at a time.
    fn probe(&self) -> watch::Receiver<Option<Result<(), String>>> {
        let mut last = self.readiness.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(probe) = last.as_ref() {
            let running = probe.answer.borrow().is_none() && probe.answer.has_changed().is_ok();
            if running || probe.begun.elapsed() < FRESH {
                return probe.answer.clone();
            }
        }
        let (tell, answer) = watch::channel(None);
        *last = Some(Probe { begun: Instant::now(), answer: answer.clone() });
        let (state, now) = (self.clone(), self.clock.now());
        self.lifecycle.spawn(async move {
            let probed = state.store.probe_write(now).await;
            if let Err(error) = &probed {
                tracing::warn!(%error, "write probe failed");
                state.lifecycle.heed(error);
            }
            // Nobody may be waiting any more; the answer is kept for the next one who asks.
            tell.send_replace(Some(probed.map_err(|error| error.to_string())));
        });
        answer
    }
}

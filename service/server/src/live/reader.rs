//! One reader: a position in the history, and samples where it asks for them.

use super::Live;
use super::event::Kind;
use super::history::Shown;
use crate::lifecycle::Lifecycle;
use axum::response::sse;
use serde_json::json;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::future::pending;
use std::sync::{Arc, PoisonError};
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, broadcast, watch};

/// Events taken out of the history at a time.
const BATCH: usize = 64;
/// A browser that lost its connection comes back after so long.
const RETRY: Duration = Duration::from_secs(2);

/// Where a reader was: the run of a server, and the number of the last event it has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Position {
    boot: String,
    number: u64,
}

impl Position {
    /// Reads an event's id; `None` for what is no id of this service.
    pub fn parse(text: &str) -> Option<Self> {
        let (boot, number) = text.trim().split_once('-')?;
        let plain = !boot.is_empty() && boot.bytes().all(|byte| byte.is_ascii_hexdigit());
        Some(Self { boot: boot.to_owned(), number: number.parse().ok().filter(|_| plain)? })
    }
}

/// Reads the live view until it is dropped or the server stops.
pub struct Reader {
    live: Arc<Live>,
    lifecycle: Lifecycle,
    newest: watch::Receiver<u64>,
    samples: Option<broadcast::Receiver<Arc<Shown>>>,
    machine: Option<String>,
    next: u64,
    ready: VecDeque<sse::Event>,
    _place: OwnedSemaphorePermit,
}

impl Reader {
    /// Begins after `after`, or now. Only events of `machine` and of none, where one is named; samples where `samples`.
    /// `None` where there are too many readers.
    pub fn new(
        live: &Arc<Live>,
        lifecycle: &Lifecycle,
        machine: Option<String>,
        samples: bool,
        after: Option<Option<Position>>,
    ) -> Option<Self> {
        let place = live.place()?;
        let newest = live.history.lock().unwrap_or_else(PoisonError::into_inner).newest();
        let mut reader = Self {
            live: live.clone(),
            lifecycle: lifecycle.clone(),
            newest: live.newest.subscribe(),
            samples: samples.then(|| live.samples.subscribe()),
            machine,
            next: newest + 1,
            ready: VecDeque::new(),
            _place: place,
        };
        let state = json!({"machines": reader.wanted_machines(), "heartbeat_ms": live.config.heartbeat_ms});
        match after {
            Some(Some(position)) if position.boot == live.boot && position.number <= newest => {
                reader.next = position.number + 1;
            }
            // Numbers of another server, or of this one before it was started again, mean nothing here.
            Some(_) => {
                reader.push("gap", None, &json!({"reason": "other_server", "missed": null}).to_string());
            }
            None => {}
        }
        // The state carries the position before what follows, so that a reader who sees nothing more can resume too.
        reader.push("state", Some(reader.next - 1), &state.to_string());
        Some(reader)
    }

    fn wanted_machines(&self) -> Vec<serde_json::Value> {
        let mut machines = self.live.machines();
        if let Some(wanted) = &self.machine {
            machines.retain(|machine| machine["machine"] == wanted.as_str());
        }
        machines
    }

    fn push(&mut self, name: &str, number: Option<u64>, data: &str) {
        let mut event = sse::Event::default().event(name).data(data);
        if let Some(number) = number {
            event = event.id(format!("{}-{number}", self.live.boot));
        }
        if name == "state" {
            event = event.retry(RETRY);
        }
        self.ready.push_back(event);
    }

    fn wants(&self, shown: &Shown) -> bool {
        match (&self.machine, &shown.machine) {
            (Some(wanted), Some(machine)) => wanted == machine,
            _ => true,
        }
    }

    fn take(&mut self) {
        let batch = {
            let history = self.live.history.lock().unwrap_or_else(PoisonError::into_inner);
            history.from(self.next, BATCH)
        };
        if let Some((first, last)) = batch.missed {
            let data = json!({"reason": "reader_too_slow", "missed": last - first + 1});
            self.push(Kind::Gap.as_str(), Some(last), &data.to_string());
            self.next = last + 1;
        }
        for shown in batch.events {
            self.next = shown.number.map_or(self.next, |number| number + 1);
            if self.wants(&shown) {
                self.push(shown.kind.as_str(), shown.number, &shown.data);
            }
        }
    }

    /// The next event; `None` when the server stops.
    pub async fn next(&mut self) -> Option<Result<sse::Event, Infallible>> {
        loop {
            if let Some(event) = self.ready.pop_front() {
                return Some(Ok(event));
            }
            self.newest.borrow_and_update();
            self.take();
            if !self.ready.is_empty() {
                continue;
            }
            let sample = async {
                match &mut self.samples {
                    Some(samples) => samples.recv().await,
                    None => pending().await,
                }
            };
            tokio::select! {
                changed = self.newest.changed() => changed.ok()?,
                sample = sample => match sample {
                    Ok(shown) if self.wants(&shown) => {
                        self.push(shown.kind.as_str(), None, &shown.data);
                    }
                    Ok(_) => {}
                    Err(broadcast::error::RecvError::Lagged(missed)) => {
                        let data = json!({"reason": "samples_too_fast", "missed": missed});
                        self.push(Kind::Gap.as_str(), None, &data.to_string());
                    }
                    Err(broadcast::error::RecvError::Closed) => self.samples = None,
                },
                () = self.lifecycle.stopping() => return None,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_come_back_and_nonsense_does_not() {
        let position = Position::parse("0192f0c17e1d7cc398c4dc0c0c07398f-17").unwrap();
        assert_eq!((position.boot.len(), position.number), (32, 17));
        for text in ["", "17", "-17", "abc-", "abc-x", "x y-1", "abc-99999999999999999999"] {
            assert_eq!(Position::parse(text), None, "{text}");
        }
    }
}

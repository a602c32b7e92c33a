//! The bounded sequence of what was shown.

use super::event::{Event, Kind};
use std::collections::VecDeque;
use std::sync::Arc;

/// An event as it was shown: its data is text, a fifth of what a tree of it takes, and thousands are kept.
#[derive(Debug)]
pub(super) struct Shown {
    /// Its number; samples have none.
    pub(super) number: Option<u64>,
    pub(super) kind: Kind,
    pub(super) machine: Option<String>,
    pub(super) data: Box<str>,
}

impl Shown {
    pub(super) fn new(number: Option<u64>, event: Event) -> Self {
        Self { number, kind: event.kind, machine: event.machine, data: event.data.into_text() }
    }
}

/// The newest events, numbered from 1.
#[derive(Debug)]
pub(super) struct History {
    events: VecDeque<Arc<Shown>>,
    most: usize,
    newest: u64,
}

/// What comes next for a reader.
#[derive(Debug, Default)]
pub(super) struct Batch {
    /// First and last number that are not kept any more.
    pub(super) missed: Option<(u64, u64)>,
    pub(super) events: Vec<Arc<Shown>>,
}

impl History {
    pub(super) fn new(most: usize) -> Self {
        Self { events: VecDeque::new(), most: most.max(1), newest: 0 }
    }

    pub(super) fn add(&mut self, event: Event) -> u64 {
        self.newest += 1;
        if self.events.len() == self.most {
            self.events.pop_front();
        }
        self.events.push_back(Arc::new(Shown::new(Some(self.newest), event)));
        self.newest
    }

    pub(super) const fn newest(&self) -> u64 {
        self.newest
    }

    /// At most `most` events from number `from` on.
    pub(super) fn from(&self, from: u64, most: usize) -> Batch {
        let oldest = self.newest + 1 - self.events.len() as u64;
        let missed = (from < oldest).then(|| (from, oldest - 1));
        let skipped = usize::try_from(from.max(oldest) - oldest).unwrap_or(usize::MAX);
        Batch { missed, events: self.events.iter().skip(skipped).take(most).cloned().collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(batch: &Batch) -> Vec<u64> {
        batch.events.iter().filter_map(|shown| shown.number).collect()
    }

    #[test]
    fn a_reader_resumes_where_it_was_and_is_told_what_it_missed() {
        let mut history = History::new(3);
        assert!(history.from(1, 10).events.is_empty() && history.from(1, 10).missed.is_none());
        for _ in 0..5 {
            history.add(Event::new(Kind::Cycle, None, serde_json::Value::Null));
        }
        assert_eq!(history.newest(), 5);
        assert_eq!(numbers(&history.from(4, 10)), [4, 5]);
        assert_eq!(numbers(&history.from(3, 2)), [3, 4]);
        let late = history.from(1, 10);
        assert_eq!((late.missed, numbers(&late)), (Some((1, 2)), vec![3, 4, 5]));
        assert!(history.from(6, 10).events.is_empty());
    }
}

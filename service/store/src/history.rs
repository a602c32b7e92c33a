//! A walk through a tool's history: cycles in their order, each event before the first cycle that it covers.

use crate::error::StoreResult;
use crate::rows::{FactsRow, Place, PlacedEvent};
use feedwright_core::wear::{ToolFold, Verdict};

/// Cycles between two checkpoints: a late cycle refolds at most so many, and what came after it.
pub(crate) const CHECKPOINT_CYCLES: u64 = 256;

/// The fold before any cycle. It depends on whether some event begins a life: the first of them changes all.
pub(crate) fn beginning(events: &[PlacedEvent]) -> ToolFold {
    match events.iter().find(|event| event.kind.begins_life()) {
        Some(first) if first.kind.mounts() => ToolFold::awaiting_mount(),
        _ => ToolFold::default(),
    }
}

/// A fold on its way through a history.
pub(crate) struct Walk<'a> {
    fold: ToolFold,
    folded: u64,
    events: &'a [PlacedEvent],
    next: usize,
    begun: usize,
}

impl<'a> Walk<'a> {
    /// From the beginning; `events` in the order of their places.
    pub(crate) fn new(events: &'a [PlacedEvent]) -> Self {
        Self::resume(beginning(events), 0, events)
    }

    /// From a state with `folded` cycles: events up to the place of its last cycle are in it.
    pub(crate) fn resume(fold: ToolFold, folded: u64, events: &'a [PlacedEvent]) -> Self {
        let next = fold.last().map(Place::of).map_or(0, |last| events.partition_point(|e| e.place <= last));
        Self { fold, folded, events, next, begun: 0 }
    }

    /// Folds the next cycle in.
    pub(crate) fn step(&mut self, row: &FactsRow) -> StoreResult<()> {
        let (facts, settings) = row.facts()?;
        let place = Place::of(&facts.order);
        while let Some(event) = self.events.get(self.next).filter(|event| event.place <= place) {
            self.fold.event(event.kind, event.at);
            self.next += 1;
            self.begun += usize::from(event.kind.begins_life());
        }
        self.fold.cycle(&facts, settings.as_ref());
        self.folded += 1;
        Ok(())
    }

    /// How many lives have begun by an event on this walk.
    pub(crate) const fn lives(&self) -> usize {
        self.begun
    }

    /// Whether an event after the last cycle begins another life.
    pub(crate) fn is_life_over(&self) -> bool {
        self.events[self.next..].iter().any(|event| event.kind.begins_life())
    }

    /// Whether a checkpoint belongs here.
    pub(crate) const fn at_checkpoint(&self) -> bool {
        self.folded.is_multiple_of(CHECKPOINT_CYCLES)
    }

    /// Cycles folded so far.
    pub(crate) const fn folded(&self) -> u64 {
        self.folded
    }

    /// The state after the last cycle, without events that come after it: they may yet be overtaken by a cycle.
    pub(crate) const fn fold(&self) -> &ToolFold {
        &self.fold
    }

    /// The state after the last cycle.
    pub(crate) fn into_fold(self) -> ToolFold {
        self.fold
    }
}

/// The verdict after the last cycle and every event that followed it; `events` in the order of their places.
pub(crate) fn verdict_after(fold: &ToolFold, events: &[PlacedEvent]) -> Verdict {
    let next = fold.last().map(Place::of).map_or(0, |last| events.partition_point(|e| e.place <= last));
    match &events[next..] {
        [] => fold.verdict(),
        following => {
            let mut fold = fold.clone();
            following.iter().for_each(|event| fold.event(event.kind, event.at));
            fold.verdict()
        }
    }
}

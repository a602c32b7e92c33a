//! How the columns of a machine's blocks were predicted of late.
//!
//! What a column follows, and how it is predicted best, is seldom another from one cycle of an operation to the next, and
//! finding it is a fifth of writing a block (docs/performance-history.md). So it is looked for twice, and where the same is found it is
//! gone by for the next blocks: until one of their columns takes clearly more than it did, or so many have come that it is time
//! to look again. Any way to predict suits any values, so that a block which is written by habit is read as every other; at
//! worst it is longer.

use super::column::{Columns, Places};
use super::frame::{self, Way};
use super::hash;
use super::noise::Law;
use super::predict::Predictor;
use crate::record::EncodedCycle;
use feedwright_core::cycle::Cycle;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Machines' operations of which a habit is kept, 40 bytes for each column.
const PLACES: usize = 512;
/// Blocks that are written by habit before all is looked for again.
const BY_HABIT: u8 = 31;
/// A column of fewer bits a value seldom surprises, and what surprises it is its form, which a program that is run a little longer
/// has otherwise; one of more is noise, of which every block tells the same, a little off.
const SETTLED_BITS: f32 = 1.0;
/// A column that takes an eighth more than it did, or than those bits, and this much of a bit, has changed.
const MORE_BITS: f32 = 1.0 / 8.0;

/// Habits of the machines that cycles came from of late. Of bounded size: of two operations that share a place the newer one has
/// it.
#[derive(Debug)]
pub struct Habits {
    places: Mutex<Box<[Option<Place>]>>,
}

#[derive(Debug)]
struct Place {
    of: u64,
    habit: Habit,
}

impl Default for Habits {
    fn default() -> Self {
        Self { places: Mutex::new((0..PLACES).map(|_| None).collect()) }
    }
}

impl Habits {
    /// Makes the content hash and the sample blocks of a cycle, as [`super::encode`] does, which looks for everything anew; `places`
    /// are those that its decimals were written with.
    pub fn encode(&self, cycle: &Cycle, places: Places) -> EncodedCycle {
        let columns = cycle.samples.as_ref().map(|samples| Columns::with(samples, places));
        let hash = hash::of_parts(cycle, columns.as_ref());
        let samples = columns.map(|columns| {
            let of = key(cycle);
            // Nobody waits while a block is written: who comes meanwhile finds no habit, and looks for everything.
            let mut habit = self.take(of).unwrap_or_default();
            let block = frame::encode_by(&columns, &mut habit);
            self.keep(of, habit);
            block
        });
        EncodedCycle { hash, samples }
    }

    fn places(&self) -> MutexGuard<'_, Box<[Option<Place>]>> {
        // Each place is whole or empty, whoever had it.
        self.places.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self, of: u64) -> Option<Habit> {
        let mut places = self.places();
        place_of(&mut places, of)?.take_if(|place| place.of == of).map(|place| place.habit)
    }

    fn keep(&self, of: u64, habit: Habit) {
        if let Some(place) = place_of(&mut self.places(), of) {
            // Of two blocks that were written at once the second had none: what the first brings back stays.
            let is_kept = |kept: &Place| kept.of == of && kept.habit.stands && !habit.stands;
            if !place.as_ref().is_some_and(is_kept) {
                *place = Some(Place { of, habit });
            }
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "some of its bits")]
fn place_of(places: &mut [Option<Place>], of: u64) -> Option<&mut Option<Place>> {
    places.get_mut(of as usize % PLACES)
}

/// Whose habit it is. Two that came out the same would write longer blocks, and nothing worse.
fn key(cycle: &Cycle) -> u64 {
    let mut hasher = DefaultHasher::new();
    (cycle.machine.as_str(), cycle.operation.as_str()).hash(&mut hasher);
    hasher.finish()
}

/// How the columns of one operation's blocks are predicted.
#[derive(Debug, Default)]
pub(super) struct Habit {
    /// As they were when all was looked for.
    columns: Vec<Predicted>,
    /// Whether the same was found twice, one after the other.
    stands: bool,
    /// Blocks that were written by it since.
    since: u8,
}

/// How a column of a block was predicted.
#[derive(Debug, Clone, Copy)]
pub(super) struct Predicted {
    /// The channel's code.
    pub(super) code: u8,
    /// Its scale; `None` of floats.
    pub(super) scale: Option<u8>,
    /// How, and by which law, where anything was off; `None` of floats.
    pub(super) way: Option<(Way, Option<Law>)>,
    /// What it took.
    pub(super) bits_a_value: f32,
}

/// What is known of a column before it is looked at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Usual {
    /// What it follows, or that it follows none.
    pub(super) way: Way,
    /// By which law, where anything was off.
    pub(super) law: Option<Law>,
    /// Whether the rest holds too: by which predictor, or by what factor of its guide and how long that is remembered.
    pub(super) is_settled: bool,
}

impl Habit {
    /// Whether a block with columns of these codes and scales is to be written by it.
    pub(super) fn suits(&self, columns: impl Iterator<Item = (u8, Option<u8>)>) -> bool {
        self.stands
            && self.since < BY_HABIT
            && columns.eq(self.columns.iter().map(|column| (column.code, column.scale)))
    }

    /// How the column of that code is predicted.
    pub(super) fn usual(&self, code: u8) -> Option<Usual> {
        let column = self.columns.iter().find(|column| column.code == code)?;
        let (way, law) = column.way?;
        Some(Usual { way, law, is_settled: law.is_some() && column.bits_a_value >= SETTLED_BITS })
    }

    /// Follows a block whose columns were all looked at.
    pub(super) fn follow(&mut self, found: impl Iterator<Item = Predicted>) {
        let found: Vec<Predicted> = found.collect();
        self.stands = found.len() == self.columns.len()
            && found.iter().zip(&self.columns).all(|(now, before)| now.is_like(before));
        self.columns = found;
        self.since = 0;
    }

    /// Follows a block that was written by it.
    pub(super) fn hold(&mut self, written: impl Iterator<Item = Predicted>) {
        let has_changed = written.zip(&self.columns).any(|(now, before)| {
            now.bits_a_value > before.bits_a_value.max(SETTLED_BITS) * 9.0 / 8.0 + MORE_BITS
        });
        self.since += 1;
        if has_changed {
            // It is found twice again before it is gone by: programs that take turns have no habit.
            *self = Self::default();
        }
    }
}

impl Predicted {
    /// Whether both go by the same. For how long a guide is remembered, and which of two lines is the better one, changes with the
    /// noise and hardly matters where it does.
    fn is_like(&self, other: &Self) -> bool {
        let line = |predictor: Predictor| if predictor.is_fit() { Predictor::Fit8 } else { predictor };
        let seldom_surprise = self.bits_a_value.max(other.bits_a_value) < SETTLED_BITS;
        self.code == other.code
            && self.scale == other.scale
            && match (self.way.map(|(way, _)| way), other.way.map(|(way, _)| way)) {
                (Some(Way::Alone(one)), Some(Way::Alone(other))) => {
                    seldom_surprise || line(one) == line(other)
                }
                (Some(Way::Guided(one)), Some(Way::Guided(other))) => one.guide.is_like(other.guide),
                (None, None) => true,
                _ => false,
            }
    }
}

#[cfg(test)]
mod tests;

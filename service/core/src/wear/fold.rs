//! The fold itself: which cycles count, the level, and the state that follows.
//!
//! Nothing here looks ahead: a cycle whose meaning only the next ones can tell is held, and counted or left out
//! when they have come. So the state after a cycle depends on the cycles up to it and on nothing else.

use super::basis::{FeedMemory, varies_feed};
use super::facts::{CycleFacts, OrderKey};
use super::key::{Change, HELD_DIGESTS, KeyState, Look, Measured, Usual};
use super::trend::TrendPoints;
use super::verdict::{BaselineKey, Earlier, Exclusion, ExclusionCounts};
use super::{WARNING_CLEARED_LEVEL, WARNING_LEVEL, WORN_LEVEL};
use crate::cycle::Flag;
use crate::ids::{CycleId, MachineId};
use crate::operation::{Ask, Operation, WINDOW_CYCLES, WearSettings};
use crate::summary::{COVERAGE_FLOOR, DEPTH_FLOOR, median};
use crate::tool::ToolEventKind;
use crate::units::{Process, Strategy, Timestamp};

/// Version of the fold's rules and of its stored form; a stored state of another version is refolded.
pub const FOLD_VERSION: u16 = 9;

/// Keys kept in one life; the one not run for longest makes room. A tool that serves more is not compared well.
pub(super) const MAX_KEYS: usize = 256;
/// Keys whose energy over depth and feed is kept.
const MAX_RELATIONS: usize = 16;
/// Cycles left out that are kept by name.
pub(super) const LAST_EXCLUDED: usize = 20;
/// Newest undercuts in a row that are kept apart; beyond them the tool is not less broken.
const MAX_SUSPECTS: usize = 64;
/// Ratios that the level is judged from at the least, where the window is not smaller still.
pub(super) const LEAST_RATIOS: usize = 5;
/// Cycles off the usual that make a lasting step, where the level's window is not smaller still.
const LASTING: usize = 3;
/// So many cycles whose clock was never set may have worn a tool before nobody knows it; as many as a baseline is learnt from unless told.
pub(super) const UNPLACED_CYCLES: usize = 5;
/// Cycles within which a step that was announced has to come, or four windows: one that comes later is another one.
const ANNOUNCED_CYCLES: u64 = 20;
/// After so many cycles of which none says how worn the tool is, or four windows, nobody knows it.
const OUTDATED_CYCLES: u64 = 20;
/// Two single cycles off the usual within so many of one key: conditions alternate.
const FLIP_SPAN: u64 = 6;
/// Levels are compared with the limits with this much room for rounding.
const ROUNDING: f64 = 1e-9;

/// As [`CycleFacts::compared`].
type Compared = (bool, f64, Option<f64>);

/// What the operation of a cycle says about how it is judged; `None` fields where it is silent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FoldSettings {
    /// Cycles of baseline and window.
    pub wear: WearSettings,
    /// Depth that a complete cycle reaches, mm.
    pub depth_mm: Option<f64>,
    /// The operation's commanded spindle speed, rpm.
    pub spindle_speed_rpm: Option<f64>,
    /// Whether it is friction drilling, which alone has strategies, energy over feed, and reference cycles.
    pub is_friction: bool,
    /// Constant feed of its reference cycles, mm/min.
    pub reference_feed_mm_min: Option<f64>,
}

impl FoldSettings {
    /// By what was asked for when a cycle began: its speed, and of both depths the lesser one. A depth that was declared wrong is mended
    /// by the one of now; a deeper hole that is drilled from now on makes none of those before incomplete.
    #[must_use]
    pub fn asked(self, then: Ask) -> Self {
        let depth_mm = then.depth_mm.zip(self.depth_mm).map(|(then, now)| then.min(now));
        Self { depth_mm, spindle_speed_rpm: then.spindle_speed_rpm, ..self }
    }

    /// What `operation` says.
    pub fn of(operation: &Operation) -> Self {
        Self {
            wear: operation.wear,
            depth_mm: operation.depth_mm,
            spindle_speed_rpm: operation.spindle_speed_rpm,
            is_friction: operation.process == Process::Friction,
            reference_feed_mm_min: operation.reference_feed_mm_min(),
        }
    }
}

/// State of the fold over one tool's cycles and events.
///
/// Feed it cycles and events in order: an event goes before the first cycle that it covers.
/// [`ToolFold::to_bytes`] and [`ToolFold::from_bytes`] keep it bit for bit.
#[derive(Debug, Clone, PartialEq)]
pub struct ToolFold {
    pub(super) last: Option<OrderKey>,
    pub(super) life: u32,
    /// Whether the life began with an unworn tool.
    pub(super) unworn: bool,
    /// Whether the tool is known to be mounted only later: cycles before that have a wrong clock.
    pub(super) awaiting_mount: bool,
    /// When the life began by an event, or somebody confirmed the tool since, µs.
    pub(super) known_at_us: Option<i64>,
    /// When the newest cycles whose clock was never set came in, of whichever life they are, oldest first, µs: one more than may be.
    pub(super) unplaced_us: Vec<i64>,
    /// Running number of the last cycle for which an engineer's announcement of changed conditions holds, which came before a step
    /// was seen; 0 without one.
    pub(super) announced_until: u64,
    /// How many cycles there were when an event confirmed what had been seen.
    pub(super) answered_at: Option<u64>,
    pub(super) cycles: u64,
    /// Those of them that may have worn the tool: all but air cuts, and what was given up or cut hardly anything.
    pub(super) worked: u64,
    /// How many of these there were when one was counted last, or somebody confirmed what had been seen.
    pub(super) known_worked: u64,
    /// What was counted of a complete baseline since the level was not known for long, while most of the window is of before: ratios as
    /// run or compensated, the larger ones, oldest first.
    pub(super) since_gap: Option<Vec<f64>>,
    /// How many cycles may have worn the tool when that ended last: reference cycles of before decide nothing any more.
    pub(super) gap_ended: u64,
    pub(super) counted: u64,
    /// Baselines that were completed.
    pub(super) taught: u64,
    pub(super) last_counted: u64,
    pub(super) last_counted_us: Option<i64>,
    /// Cycles that really cut, as far as is known, but could not be measured, since the last counted one.
    pub(super) unmeasured: u64,
    pub(super) excluded: ExclusionCounts,
    pub(super) last_excluded: Vec<(MachineId, CycleId, Exclusion)>,
    pub(super) keys: Vec<KeyState>,
    /// Whether a key had to make room: one that comes back then is not known to be new.
    pub(super) evicted: bool,
    /// Place in `keys` of the one that ran last.
    pub(super) current: Option<usize>,
    /// Last counted ratios, oldest first.
    pub(super) ratios: Vec<f64>,
    pub(super) window: u32,
    pub(super) warned: bool,
    pub(super) worn: bool,
    /// Undercuts that no usual cycle has followed yet: whether each was short of its usual time.
    pub(super) suspects: Vec<bool>,
    /// Running number of the first cycle with which it may have broken.
    pub(super) suspected_since: u64,
    pub(super) trend: TrendPoints,
    pub(super) feeds: FeedMemory,
}

impl Default for ToolFold {
    fn default() -> Self {
        Self {
            last: None,
            life: 0,
            unworn: true,
            awaiting_mount: false,
            known_at_us: None,
            unplaced_us: Vec::new(),
            announced_until: 0,
            answered_at: None,
            cycles: 0,
            worked: 0,
            known_worked: 0,
            since_gap: None,
            gap_ended: 0,
            counted: 0,
            taught: 0,
            last_counted: 0,
            last_counted_us: None,
            unmeasured: 0,
            excluded: [0; Exclusion::ALL.len()],
            last_excluded: Vec::new(),
            keys: Vec::new(),
            evicted: false,
            current: None,
            ratios: Vec::new(),
            window: WearSettings::default().window_cycles,
            warned: false,
            worn: false,
            suspects: Vec::new(),
            suspected_since: 0,
            trend: TrendPoints::default(),
            feeds: FeedMemory::default(),
        }
    }
}

/// Whether the middle of ratios is that of a tool that is not near its limit.
fn are_usual(ratios: &[f64]) -> bool {
    ratios.is_empty() || median(ratios) < WARNING_LEVEL - ROUNDING
}

impl ToolFold {
    /// The fold of a tool whose first life begins with its mounting: what comes before has a wrong clock and is not
    /// counted. A tool that nobody mounted has its life begin with its first cycle ([`ToolFold::default`]).
    pub fn awaiting_mount() -> Self {
        Self { awaiting_mount: true, ..Self::default() }
    }

    /// The last cycle folded in.
    pub fn last(&self) -> Option<&OrderKey> {
        self.last.as_ref()
    }

    /// Applies an event that takes effect before the next cycle, and happened at `at`.
    pub fn event(&mut self, kind: ToolEventKind, at: Timestamp) {
        if kind.begins_life() {
            *self = Self {
                last: self.last.take(),
                life: self.life + 1,
                unworn: kind.starts_unworn(),
                feeds: self.feeds.next_life(),
                known_at_us: Some(at.micros()),
                unplaced_us: std::mem::take(&mut self.unplaced_us),
                ..Self::default()
            };
            return;
        }
        // Of a life that no event began the cycles without a place are in its books.
        self.known_at_us = self.known_at_us.map(|known| known.max(at.micros()));
        let level = self.standing();
        // Cycles that were held since they looked like those of before are no part of what is confirmed.
        let changed = self.keys.iter_mut().filter(|key| key.change.is_some());
        let mut held: Vec<(Measured, Exclusion)> = changed.flat_map(KeyState::take_held).collect();
        self.leave_out_held(&mut held);
        // Told twice, or of what is suspected, it announces nothing; nor where nothing is usual yet that a step could leave.
        let mut announced = self.suspects.is_empty()
            && self.answered_at != Some(self.cycles)
            && self.keys.iter().any(|key| key.baseline.is_some())
            && !self.keys.iter().any(|key| key.baseline.is_none() && key.before.is_some());
        for key in &mut self.keys {
            announced &= key.change.is_none() && !key.unconfirmed && !key.after_gap && !key.stepped;
            key.unconfirmed = false;
            key.after_gap = false;
            key.stepped = false;
            if key.change.is_some() {
                key.relearn(level.unwrap_or(1.0), None);
            }
        }
        let holds = ANNOUNCED_CYCLES.max(4 * u64::from(self.window));
        self.announced_until = if announced { self.cycles + holds } else { 0 };
        self.answered_at = (!announced).then_some(self.cycles);
        self.known_worked = self.worked;
        self.since_gap = None;
        self.gap_ended = 0;
        self.settle_suspects();
    }

    /// Folds one cycle in; `settings` is `None` where its operation is not registered.
    pub fn cycle(&mut self, facts: &CycleFacts, settings: Option<&FoldSettings>) {
        if self.life == 0 && !self.awaiting_mount {
            self.life = 1;
        }
        self.last = Some(facts.order.clone());
        self.cycles += 1;
        self.worked += 1;
        if facts.flags.contains(Flag::ClockSuspect) {
            self.note_unplaced(facts.received_at.micros());
        }
        self.note_feeds(facts, settings);
        let (compared, settings) = match self.countable(facts, settings) {
            Ok(found) => found,
            Err(why) => {
                if !matches!(why, Exclusion::Aborted | Exclusion::Incomplete) {
                    self.unmeasured += 1;
                }
                self.exclude(&facts.order.machine, &facts.order.cycle, why);
                return;
            }
        };
        let (in_contact, joules, duration_ms) = compared;
        let at = self.key_of(facts, in_contact, settings);
        self.keys[at].note_next(&facts.order);
        let mut cycle = Measured::of(facts, (joules, duration_ms), (self.cycles, self.worked));
        if !settings.is_friction {
            cycle.digest = None;
        }
        self.keys[at].reference_feed_mm_min = settings.reference_feed_mm_min;
        self.current = Some(at);
        self.keys[at].used = self.cycles;
        self.keys[at].seen += 1;
        let (counted, taught) = (self.counted, self.taught);
        if self.keys[at].baseline.is_none() {
            self.learn(at, cycle);
        } else if self.keys[at].override_differs(&cycle) {
            self.leave_out_for_override(at, &cycle);
        } else if self.keys[at].change.is_some() {
            self.compare_after_change(at, cycle);
        } else {
            self.compare(at, cycle);
        }
        if self.counted > counted && self.taught == taught {
            self.judge();
        }
        if settings.is_friction && self.masked(self.decision()).is_some() {
            self.feeds.masked += 1;
        }
    }

    /// Notes that a cycle came in of which nobody knows when it was run: a life that had begun by then may be its.
    fn note_unplaced(&mut self, received_us: i64) {
        let place = self.unplaced_us.partition_point(|known| *known <= received_us);
        self.unplaced_us.insert(place, received_us);
        if self.unplaced_us.len() > UNPLACED_CYCLES + 1 {
            self.unplaced_us.remove(0);
        }
    }

    /// Whether so many cycles of which nobody knows when they were run have come in since the life began that nobody knows how worn the
    /// tool is. Of a life that no event began they are the first cycles.
    pub(super) fn is_unplaced(&self) -> bool {
        let since = self.known_at_us.map(|known| self.unplaced_us.iter().filter(|at| **at >= known).count());
        since.is_some_and(|since| since > UNPLACED_CYCLES)
    }

    /// Notes how the tool is used; whether it is worn does not depend on it.
    fn note_feeds(&mut self, facts: &CycleFacts, settings: Option<&FoldSettings>) {
        let friction = settings.filter(|settings| settings.is_friction);
        self.feeds.every = friction.and_then(|settings| settings.wear.reference_every_cycles);
        self.feeds.reference_feed_mm_min = friction.and_then(|settings| settings.reference_feed_mm_min);
        if friction.is_some() && varies_feed(facts.compared_as(true)) {
            self.feeds.varied = true;
            self.feeds.ever_varied = true;
        }
    }

    /// What is compared of a cycle that can be compared at all, and its settings, or why it cannot.
    fn countable<'a>(
        &self,
        facts: &CycleFacts,
        settings: Option<&'a FoldSettings>,
    ) -> Result<(Compared, &'a FoldSettings), Exclusion> {
        if self.awaiting_mount || facts.flags.contains(Flag::ClockSuspect) {
            return Err(Exclusion::ClockSuspect);
        }
        if facts.flags.contains(Flag::Aborted) {
            return Err(Exclusion::Aborted);
        }
        // Told before anything that could be mended: of this cycle nobody will ever know more. Its `Incomplete` says
        // nothing here, as that is also told of a depth that the operation may no longer ask for.
        if facts.flags.contains(Flag::CutShort) {
            return Err(Exclusion::CutShort);
        }
        let settings = settings.ok_or(Exclusion::OperationUnregistered)?;
        let compared = facts.compared(settings.is_friction).ok_or(Exclusion::NoEnergy)?;
        if facts.coverage < COVERAGE_FLOOR {
            return Err(Exclusion::LowCoverage);
        }
        if let (Some(asked), Some(reached)) = (settings.depth_mm, facts.max_depth_mm)
            && reached < DEPTH_FLOOR * asked
        {
            return Err(Exclusion::Incomplete);
        }
        Ok((compared, settings))
    }

    /// The place of the cycle's key, which is made where it is met first.
    fn key_of(&mut self, facts: &CycleFacts, in_contact: bool, settings: &FoldSettings) -> usize {
        let key = BaselineKey::of(facts, in_contact, settings);
        if let Some(at) = key.among(self.keys.iter().map(KeyState::key)) {
            return at;
        }
        // A speed that is changed in mid-life is often changed because of the wear: the level that is carried over
        // then says nothing good until somebody confirms the new conditions.
        let speed_changed =
            self.level().is_some() && self.keys.iter().any(|known| known.differs_in_speed(&key));
        let mut state = KeyState::new(key, settings.wear, self.standing().unwrap_or(1.0));
        if speed_changed || self.evicted {
            state.unconfirmed = !self.take_announcement(self.cycles);
        }
        if self.evicted {
            // It may be one that had to make room.
            state.earlier.push(Earlier { until: Some(facts.order.clone()), joules: None });
        }
        if self.keys.len() < MAX_KEYS {
            self.keys.push(state);
            return self.keys.len() - 1;
        }
        self.evicted = true;
        // What waits to be confirmed is not forgotten.
        let rank = |at: &usize| (self.keys[*at].change.is_some(), self.keys[*at].used);
        let oldest = (0..self.keys.len()).min_by_key(rank).unwrap_or(0);
        state.unconfirmed |= self.keys[oldest].change.is_some();
        let mut held = std::mem::replace(&mut self.keys[oldest], state).take_held();
        self.leave_out_held(&mut held);
        oldest
    }

    fn learn(&mut self, at: usize, cycle: Measured) {
        let (level, is_first) = (self.standing().unwrap_or(1.0), self.level().is_none());
        let key = &mut self.keys[at];
        // Two cycles that agree are what "after good cycles" takes: one alone may itself be the odd one.
        let centre = key.learning_centre(2);
        // Whoever confirms a step confirms none to hardly anything: before it is learnt anew, that is told by what was usual before.
        let usual = [centre, key.before].into_iter().flatten();
        if let Some(usual) = usual.into_iter().find(|usual| key.look(&cycle, usual) == Look::Undercut) {
            let short = KeyState::looks_incomplete(&cycle, &usual);
            self.suspect(at, &cycle, short);
            return;
        }
        if cycle.joules <= 0.0 {
            if key.is_unmeasured(&cycle) {
                self.unmeasured += 1;
                self.leave_out(&cycle, Exclusion::NoEnergy);
            } else {
                self.leave_out(&cycle, Exclusion::AirCut);
            }
            return;
        }
        if key.learning.is_empty() && is_first && self.unmeasured > u64::from(key.needed) {
            // It has worked unmeasured for so long that its first measured cycles are no new tool's.
            self.unworn = false;
        }
        if centre.is_some_and(|centre| key.look(&cycle, &centre) == Look::Usual) {
            key.last_usual = key.last_usual.max(cycle.number);
            self.settle_suspects_by(at);
        }
        self.note_reference(at, cycle.number);
        self.note_gap(at);
        let key = &mut self.keys[at];
        let mut cycle = cycle;
        if key.learning.iter().filter(|held| held.digest.is_some()).count() >= HELD_DIGESTS {
            cycle.digest = None;
        }
        let number = cycle.number;
        cycle.level = level;
        key.learning.push(cycle);
        // Where learning is interrupted the tool may have worn elsewhere meanwhile.
        let levels: Vec<f64> = key.learning.iter().map(|cycle| cycle.level).collect();
        key.level_at_entry = median(&levels);
        if key.knows_since.is_none() && key.learning_centre(2).is_some() {
            key.knows_since = Some(number);
        }
        if let Some(judged) = key.complete() {
            self.taught += u64::from(self.keys[at].baseline.is_some());
            for (cycle, why) in judged {
                match why {
                    None => self.count_taught(at, cycle),
                    Some(why) => self.leave_out(&cycle, why),
                }
            }
            self.bound_relations();
        } else if key.learning.len() > key.learning_bound() {
            let first = key.learning.remove(0);
            self.leave_out(&first, Exclusion::BaselineOutlier);
        }
    }

    /// A cycle is learnt from that comes after so many of which nobody knows how they wore the tool, that what was known before them
    /// says nothing of it.
    fn note_gap(&mut self, at: usize) {
        if self.unknown_for().is_none() {
            return;
        }
        if self.level().is_some() {
            self.keys[at].after_gap = true;
        } else if !self.keys[at].learning.is_empty() {
            self.unworn = false;
        }
    }

    /// Cycles that may have worn the tool since its level was known last, without those that baselines are being learnt from; `None` where
    /// they are so few that it still is.
    pub(super) fn unknown_for(&self) -> Option<u64> {
        let held = self.keys.iter().flat_map(|key| &key.learning);
        let held = held.filter(|cycle| cycle.worked > self.known_worked).count() as u64;
        let unknown = self.worked.saturating_sub(self.known_worked).saturating_sub(held);
        (unknown > outdated_after(self.window)).then_some(unknown)
    }

    fn compare(&mut self, at: usize, cycle: Measured) {
        let key = &mut self.keys[at];
        let Some(usual) = key.usual() else {
            // A complete baseline was counted, so something is usual; without it the cycle only adds to it.
            self.count(at, cycle);
            return;
        };
        match key.look(&cycle, &usual) {
            Look::Undercut => {
                let short = KeyState::looks_incomplete(&cycle, &usual);
                self.suspect(at, &cycle, short);
            }
            _ if cycle.joules <= 0.0 => self.leave_out(&cycle, Exclusion::Incomplete),
            Look::Usual if !key.goes_on(&cycle, &usual) => {
                if !key.off.is_empty() {
                    let seen = key.seen;
                    key.flips.retain(|flip| seen - flip < FLIP_SPAN);
                    key.flips.push(seen);
                    if key.flips.len() >= 2 {
                        let off = std::mem::take(&mut key.off);
                        key.change = Some(Change { before: usual, back: Vec::new() });
                        off.iter().for_each(|cycle| self.leave_out(cycle, Exclusion::ConditionsChanged));
                    } else {
                        self.settle_off(at, &usual);
                    }
                }
                self.count(at, cycle);
            }
            Look::Off if key.off.is_empty() && !key.jumped(&cycle) && !key.another_sheet(&cycle, &usual) => {
                self.count(at, cycle);
            }
            Look::Off | Look::Usual => {
                key.off.push(cycle);
                if key.off.len() >= lasting(key.window) {
                    self.judge_step(at, usual);
                }
            }
        }
    }

    /// Enough cycles in a row are off: a lasting step, or wear that runs away.
    fn judge_step(&mut self, at: usize, usual: Usual) {
        let level = self.standing();
        let key = &mut self.keys[at];
        let level_step = key.off_is_level() || key.off_is_another_sheet(&usual);
        let first = key.off.first().map(|cycle| cycle.order.clone());
        let off = std::mem::take(&mut key.off);
        let begun = off.first().map_or(self.cycles, |cycle| cycle.number);
        if !level_step {
            off.into_iter().for_each(|cycle| self.count(at, cycle));
        } else if self.take_announcement(begun) {
            self.keys[at].relearn(level.unwrap_or(1.0), first);
            off.into_iter().for_each(|cycle| self.learn(at, cycle));
        } else {
            self.keys[at].change = Some(Change { before: usual, back: Vec::new() });
            off.iter().for_each(|cycle| self.leave_out(cycle, Exclusion::ConditionsChanged));
        }
    }

    /// Whether a step that began with cycle `number` was announced; it is one step that was.
    fn take_announcement(&mut self, number: u64) -> bool {
        number <= std::mem::take(&mut self.announced_until)
    }

    /// A cycle under another override of the operator's is not compared; whether it cut at all is told all the same.
    fn leave_out_for_override(&mut self, at: usize, cycle: &Measured) {
        let key = &self.keys[at];
        match key.confirmed_usual().map(|usual| (key.look_despite_override(cycle, &usual), usual)) {
            Some((Look::Undercut, usual)) => {
                let short = KeyState::looks_incomplete(cycle, &usual);
                self.suspect(at, cycle, short);
                return;
            }
            Some((Look::Usual, _)) => self.settle_suspects_by(at),
            Some((Look::Off, _)) | None => {}
        }
        self.leave_out(cycle, Exclusion::OperatorOverride);
    }

    /// After a step that nobody has confirmed: only what comes back to the old usual for good is counted again.
    fn compare_after_change(&mut self, at: usize, cycle: Measured) {
        let key = &mut self.keys[at];
        let needed = lasting(key.window);
        let Some(mut change) = key.change.take() else { return };
        match key.look(&cycle, &change.before) {
            Look::Undercut => {
                let short = KeyState::looks_incomplete(&cycle, &change.before);
                key.change = Some(change);
                self.suspect(at, &cycle, short);
            }
            Look::Usual => {
                change.back.push(cycle);
                if change.back.len() >= needed {
                    key.flips.clear();
                    change.back.into_iter().for_each(|cycle| self.count(at, cycle));
                } else {
                    key.change = Some(change);
                }
            }
            Look::Off => {
                let back = std::mem::take(&mut change.back);
                key.change = Some(change);
                for held in back.iter().chain([&cycle]) {
                    self.leave_out(held, Exclusion::ConditionsChanged);
                }
            }
        }
    }

    /// Single cycles off the usual, followed by a usual one: counted, unless they were not finished or in another sheet.
    fn settle_off(&mut self, at: usize, usual: &Usual) {
        for cycle in std::mem::take(&mut self.keys[at].off) {
            if KeyState::looks_incomplete(&cycle, usual) {
                self.leave_out(&cycle, Exclusion::Incomplete);
            } else if self.keys[at].another_sheet(&cycle, usual) {
                self.leave_out(&cycle, Exclusion::ConditionsChanged);
            } else {
                self.count(at, cycle);
            }
        }
    }

    /// Counts a cycle, with what it says beside its ratio as run.
    fn count(&mut self, at: usize, cycle: Measured) {
        let Some(baseline) = &self.keys[at].baseline else { return };
        let said = ((cycle.number, cycle.worked), cycle.joules / baseline.joules);
        self.note_reference(at, cycle.number);
        if self.keys[at].after_gap {
            self.count_taught(at, cycle);
            self.judge_after_gap(at);
            return;
        }
        let found = self.compensated(at, cycle.digest.as_ref());
        let deciding = self.remember(at, said, found);
        let (known_worked, is_known) = (self.known_worked, self.is_known_by(deciding));
        self.count_taught(at, cycle);
        if !is_known {
            self.known_worked = known_worked;
        }
    }

    /// Whether the level is known with this ratio. After long work that nobody knows most of the window is of before: until it is of
    /// after, ratios that may be of a worn tool leave open which.
    fn is_known_by(&mut self, ratio: f64) -> bool {
        if self.unknown_for().is_some() {
            // Another gap, unless it is the one that is not over.
            let goes_on = self.since_gap.take().filter(|since| !are_usual(since));
            if goes_on.is_none() {
                self.gap_ended = self.worked - 1;
            }
            self.since_gap = Some(goes_on.unwrap_or_default());
        }
        let needed = self.needed_since_gap();
        let Some(since) = &mut self.since_gap else { return true };
        since.push(ratio);
        let is_enough = since.len() >= needed;
        let is_known = is_enough || are_usual(since);
        if is_enough {
            self.since_gap = None;
        }
        is_known
    }

    /// As many cycles have most of the window, whose median is of them then.
    fn needed_since_gap(&self) -> usize {
        self.window as usize / 2 + 1
    }

    /// The middle of the ratios since the level was not known for long, how many there are, and how many are needed; `None` where they
    /// leave nothing open.
    pub(super) fn unclear_since_gap(&self) -> Option<(f64, usize, usize)> {
        let since = self.since_gap.as_ref()?;
        (!are_usual(since)).then(|| (median(since), since.len(), self.needed_since_gap()))
    }

    /// A tool is worn no less than by what this baseline shows, though nobody knows by how much more.
    fn judge_after_gap(&mut self, at: usize) {
        let key = &self.keys[at];
        let Some((baseline, usual)) = key.baseline.as_ref().zip(key.usual()) else { return };
        let least = usual.joules / baseline.joules;
        self.worn |= least >= WORN_LEVEL - ROUNDING;
        self.warned |= least >= WARNING_LEVEL - ROUNDING;
    }

    fn note_reference(&mut self, at: usize, number: u64) {
        if self.keys[at].key.strategy == Some(Strategy::FConst) {
            self.feeds.last_reference = self.feeds.last_reference.max(Some(number));
            self.feeds.reference_count += 1;
        }
    }

    /// Relations are by far the largest part of the state: only the keys that ran last keep theirs.
    fn bound_relations(&mut self) {
        while self.keys.iter().filter(|key| key.relation.is_some()).count() > MAX_RELATIONS {
            let oldest = self.keys.iter_mut().filter(|key| key.relation.is_some()).min_by_key(|key| key.used);
            let Some(oldest) = oldest else { return };
            oldest.relation = None;
        }
    }

    /// Counts a cycle that its baseline was learnt from: it says how cycles scatter, not how the tool wears.
    fn count_taught(&mut self, at: usize, cycle: Measured) {
        let key = &mut self.keys[at];
        let Some(baseline) = &key.baseline else { return };
        let ratio = cycle.joules / baseline.joules;
        self.window = key.window;
        self.counted += 1;
        self.last_counted = self.last_counted.max(cycle.number);
        key.last_usual = key.last_usual.max(cycle.number);
        self.last_counted_us = self.last_counted_us.max(Some(cycle.order.started_at.micros()));
        self.unmeasured = 0;
        let (after_gap, worked) = (key.after_gap, cycle.worked);
        key.keep(cycle);
        if after_gap {
            // Its ratios are those of a level that is only carried over: nobody knows more of the tool by them.
            self.settle_suspects_by(at);
            return;
        }
        self.known_worked = self.known_worked.max(worked);
        if self.ratios.len() == *WINDOW_CYCLES.end() as usize {
            self.ratios.remove(0);
        }
        self.ratios.push(ratio);
        self.trend.push(ratio);
        self.settle_suspects_by(at);
    }

    /// Compares the level with its limits. Not while a baseline's own cycles are counted: their ratios say how they
    /// scatter, not how the tool wears; and not before the window holds enough of them.
    fn judge(&mut self) {
        if self.window().len() < LEAST_RATIOS.min(self.window as usize) {
            return;
        }
        if let Some(decision) = self.decision() {
            let level = decision.level;
            self.worn |= level >= WORN_LEVEL - ROUNDING;
            // Where nothing decides, nothing clears a warning either.
            let held = decision.basis.is_none() || level >= WARNING_CLEARED_LEVEL;
            self.warned = level >= WARNING_LEVEL - ROUNDING || (self.warned && held);
        }
    }

    /// The ratios that the level is the median of.
    pub(super) fn window(&self) -> &[f64] {
        &self.ratios[self.ratios.len().saturating_sub(self.window as usize)..]
    }

    /// The level as run: median of the last counted ratios, 1 for the new tool; `None` before there is any.
    pub fn level(&self) -> Option<f64> {
        let window = self.window();
        (!window.is_empty()).then(|| median(window))
    }

    fn suspect(&mut self, at: usize, cycle: &Measured, short: bool) {
        if self.suspects.len() == MAX_SUSPECTS {
            self.suspects.remove(0);
        }
        if self.suspects.is_empty() {
            // It may have broken at any time since something of this key was usual.
            let key = &self.keys[at];
            self.suspected_since = key.last_usual.max(key.knows_since.unwrap_or(0)) + 1;
        }
        self.suspects.push(short);
        self.leave_out(cycle, Exclusion::BrokenSuspected);
    }

    /// A cycle of a key is as usual. What is usual of a key that has only been met since says nothing of a tool that broke before:
    /// it may be what a broken tool takes.
    fn settle_suspects_by(&mut self, at: usize) {
        if self.keys[at].knows_since.is_some_and(|since| since < self.suspected_since) {
            self.settle_suspects();
        }
    }

    /// A usual cycle has come: what looked like a broken tool was air.
    fn settle_suspects(&mut self) {
        if self.suspects.is_empty() {
            return;
        }
        let shorts = std::mem::take(&mut self.suspects);
        let suspected = std::mem::take(&mut self.excluded[Exclusion::BrokenSuspected as usize]);
        let short = shorts.iter().filter(|short| **short).count() as u64;
        self.excluded[Exclusion::Incomplete as usize] += short;
        self.excluded[Exclusion::AirCut as usize] += suspected - short;
        // Names and undercuts are both in order, and the newest of each are kept.
        let named =
            self.last_excluded.iter_mut().rev().filter(|(_, _, why)| *why == Exclusion::BrokenSuspected);
        for ((_, _, why), short) in named.zip(shorts.iter().rev()) {
            *why = if *short { Exclusion::Incomplete } else { Exclusion::AirCut };
        }
    }

    /// Leaves cycles out that were held, in the order in which they were run.
    fn leave_out_held(&mut self, held: &mut [(Measured, Exclusion)]) {
        held.sort_by_key(|(cycle, _)| cycle.number);
        held.iter().for_each(|(cycle, why)| self.leave_out(cycle, *why));
    }

    fn leave_out(&mut self, cycle: &Measured, why: Exclusion) {
        self.exclude(&cycle.order.machine, &cycle.order.cycle, why);
    }

    fn exclude(&mut self, machine: &MachineId, cycle: &CycleId, why: Exclusion) {
        self.excluded[why as usize] += 1;
        if matches!(
            why,
            Exclusion::Aborted | Exclusion::Incomplete | Exclusion::AirCut | Exclusion::BrokenSuspected
        ) {
            self.worked = self.worked.saturating_sub(1);
        }
        if self.last_excluded.len() == LAST_EXCLUDED {
            self.last_excluded.remove(0);
        }
        self.last_excluded.push((machine.clone(), cycle.clone(), why));
    }
}

/// So many cycles after which a level is outdated.
pub(super) fn outdated_after(window: u32) -> u64 {
    OUTDATED_CYCLES.max(4 * u64::from(window))
}

/// Cycles that make a step lasting: no more than flip the median of the window.
fn lasting(window: u32) -> usize {
    LASTING.min((window as usize).div_ceil(2))
}

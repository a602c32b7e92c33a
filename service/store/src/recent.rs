//! Energies of the newest cycles of those tools that are asked for, kept so that they need not be read again.
//!
//! What is kept of a tool is held against how many of its cycles are stored: cycles are never changed and never
//! removed, so that an equal count means the same cycles. Where nobody else writes to the database it need not be asked
//! as long as no group with a cycle of the tool is being committed, or was.

use crate::point::{CyclePoint, LastPoints};
use crate::record::NewCycle;
use feedwright_core::ids::ToolId;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Points that are kept in all, 200 to 300 bytes each.
const MOST_POINTS: usize = 24_576;
/// Most points asked for of one tool that are kept.
const MOST_OF_TOOL: usize = 2_048;
/// Points beyond those asked for, after which the oldest are let go.
const SLACK: usize = 256;

/// The newest points of one tool, as of so many of its cycles.
#[derive(Debug, Clone)]
pub(crate) struct Kept {
    /// Cycles of the tool that were stored.
    pub(crate) cycles: i64,
    /// The newest of them, oldest first.
    points: Arc<Vec<CyclePoint>>,
    /// Most that were asked for.
    pub(crate) asked: usize,
    /// Whether no group has touched the tool since.
    pub(crate) fresh: bool,
    used: u64,
}

impl Kept {
    /// The newest points of a tool, oldest first, of which so many cycles are stored; `asked` were asked for.
    pub(crate) fn new(cycles: i64, points: Vec<CyclePoint>, asked: usize) -> Self {
        Self { cycles, points: Arc::new(points), asked, fresh: false, used: 0 }
    }

    /// The newest `limit`, where so many are here, or all there are.
    pub(crate) fn answer(&self, limit: usize) -> Option<LastPoints> {
        let here = self.points.len();
        let whole = i64::try_from(here) == Ok(self.cycles);
        (whole || here >= limit).then(|| self.newest(limit))
    }

    /// The newest `limit`, or as many as are here.
    pub(crate) fn newest(&self, limit: usize) -> LastPoints {
        LastPoints::newest(Arc::clone(&self.points), limit)
    }

    /// What is kept once `newest` cycles (newest first) were read of which the first `new` came since; `None` where it
    /// is not certain that these are all that came.
    pub(crate) fn and(&self, new: usize, mut newest: Vec<CyclePoint>) -> Option<Self> {
        // The one before the new ones is the newest that was known: nothing came between or before.
        let known = newest.get(new)?;
        if self.points.last()?.key != known.key {
            return None;
        }
        newest.truncate(new);
        let mut points = Arc::clone(&self.points);
        let all = Arc::make_mut(&mut points);
        all.extend(newest.into_iter().rev());
        if all.len() > self.asked + SLACK {
            all.drain(..all.len() - self.asked);
        }
        Some(Self { cycles: self.cycles + i64::try_from(new).ok()?, points, ..*self })
    }
}

#[derive(Debug, Default)]
struct Shelf {
    questions: u64,
    points: usize,
    /// Groups that ended.
    groups: u64,
    /// Cycles by tool in groups that are being committed: they may be visible already.
    under_way: HashMap<ToolId, usize>,
    tools: HashMap<ToolId, Kept>,
}

/// What is kept, of all tools.
#[derive(Debug, Default)]
pub(crate) struct Recent {
    shelf: Mutex<Shelf>,
}

impl Recent {
    fn shelf(&self) -> MutexGuard<'_, Shelf> {
        self.shelf.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is kept of a tool.
    pub(crate) fn get(&self, tool: &ToolId) -> Option<Kept> {
        let mut shelf = self.shelf();
        shelf.questions += 1;
        let (now, quiet) = (shelf.questions, !shelf.under_way.contains_key(tool));
        let kept = shelf.tools.get_mut(tool)?;
        kept.used = now;
        Some(Kept { fresh: kept.fresh && quiet, ..kept.clone() })
    }

    /// Groups that have ended by now: what is read from here on holds their cycles.
    pub(crate) fn groups(&self) -> u64 {
        self.shelf().groups
    }

    /// What was kept of a tool is what was stored when so many groups had ended.
    pub(crate) fn confirm(&self, tool: &ToolId, cycles: i64, groups: u64) {
        let mut shelf = self.shelf();
        let ended = shelf.groups;
        if let Some(kept) = shelf.tools.get_mut(tool).filter(|kept| kept.cycles == cycles) {
            kept.fresh |= groups == ended;
        }
    }

    /// A group with cycles of these tools is going to be committed.
    fn begun<'a>(&self, tools: impl Iterator<Item = &'a ToolId>) {
        let mut shelf = self.shelf();
        for tool in tools {
            *shelf.under_way.entry(tool.clone()).or_default() += 1;
        }
    }

    /// The same group has ended, whatever came of it.
    fn ended<'a>(&self, tools: impl Iterator<Item = &'a ToolId>) {
        let mut shelf = self.shelf();
        shelf.groups += 1;
        for tool in tools {
            if let Some(cycles) = shelf.under_way.get_mut(tool) {
                *cycles -= 1;
                if *cycles == 0 {
                    shelf.under_way.remove(tool);
                }
            }
            if let Some(kept) = shelf.tools.get_mut(tool) {
                kept.fresh = false;
            }
        }
    }

    /// Keeps that of a tool, where nobody else has kept newer; it was read when so many groups had ended.
    pub(crate) fn keep(&self, tool: &ToolId, mut kept: Kept, groups: u64) {
        let mut shelf = self.shelf();
        kept.fresh = groups == shelf.groups;
        let newer = shelf.tools.get(tool).is_some_and(|before| before.cycles > kept.cycles);
        if newer || kept.asked > MOST_OF_TOOL {
            return;
        }
        kept.used = shelf.questions;
        shelf.forget(tool);
        while shelf.points + kept.points.len() > MOST_POINTS {
            let longest_unused = shelf.tools.iter().min_by_key(|(_, kept)| kept.used);
            let Some((unused, _)) = longest_unused else { return };
            let unused = unused.clone();
            shelf.forget(&unused);
        }
        shelf.points += kept.points.len();
        shelf.tools.insert(tool.clone(), kept);
    }
}

/// A group that is being committed. It is dropped before anybody is told what came of it.
#[derive(Debug)]
pub(crate) struct Group {
    recent: Arc<Recent>,
    cycles: Arc<[NewCycle]>,
}

impl Group {
    pub(crate) fn of(cycles: Arc<[NewCycle]>, recent: Arc<Recent>) -> Self {
        recent.begun(cycles.iter().map(|new| &new.cycle.tool));
        Self { recent, cycles }
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        self.recent.ended(self.cycles.iter().map(|new| &new.cycle.tool));
    }
}

impl Shelf {
    fn forget(&mut self, tool: &ToolId) {
        if let Some(kept) = self.tools.remove(tool) {
            self.points -= kept.points.len();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use feedwright_core::units::Timestamp;

    fn point(second: i64) -> CyclePoint {
        CyclePoint {
            key: (
                Timestamp::from_micros(second * 1_000_000),
                "M1".try_into().unwrap(),
                format!("c{second}").as_str().try_into().unwrap(),
            ),
            tool: "T1".try_into().unwrap(),
            operation: "O1".try_into().unwrap(),
            energy: Vec::new(),
            peaks: None,
        }
    }

    fn points(seconds: impl Iterator<Item = i64>) -> Vec<CyclePoint> {
        seconds.map(point).collect()
    }

    fn tool(n: usize) -> ToolId {
        format!("T{n}").as_str().try_into().unwrap()
    }

    #[test]
    fn newer_cycles_are_added_and_late_ones_are_not() {
        let kept = Kept::new(10, points(1..=10), 10);
        let more = kept.and(2, points((9..=12).rev())).unwrap();
        assert_eq!(more.cycles, 12);
        assert_eq!(*more.answer(20).unwrap(), *points(1..=12));
        assert_eq!(*more.answer(3).unwrap(), *points(10..=12));
        // Of two that came one began before what is known: only one is newer.
        assert!(kept.and(2, points([11, 10, 9, 8].into_iter())).is_none());
        assert!(kept.and(2, points([12, 11].into_iter())).is_none(), "what came before them was not read");
        assert!(Kept::new(0, Vec::new(), 10).and(1, points([1].into_iter())).is_none());
    }

    #[test]
    fn fewer_than_asked_for_are_an_answer_only_where_there_are_no_more() {
        let kept = Kept::new(1000, points(501..=1000), 500);
        assert_eq!(kept.answer(500).unwrap().len(), 500);
        assert!(kept.answer(501).is_none());
        assert_eq!(Kept::new(500, points(1..=500), 500).answer(900).unwrap().len(), 500);
    }

    #[test]
    fn what_is_added_goes_from_the_other_end() {
        let mut kept = Kept::new(50, points(1..=50), 50);
        for second in 51..=2000 {
            kept = kept.and(1, points([second, second - 1].into_iter())).unwrap();
            assert!(kept.points.len() <= 50 + SLACK);
            assert_eq!(*kept.answer(50).unwrap(), *points(second - 49..=second));
        }
    }

    #[test]
    fn what_was_not_asked_for_longest_makes_room() {
        let recent = Recent::default();
        let long = i64::try_from(MOST_OF_TOOL).unwrap();
        let room = MOST_POINTS / MOST_OF_TOOL;
        for n in 0..=room {
            recent.keep(&tool(n), Kept::new(long, points(1..=long), MOST_OF_TOOL), 0);
            // The first is asked for again and again.
            assert!(recent.get(&tool(0)).is_some());
            assert!(recent.shelf().points <= MOST_POINTS);
        }
        assert!(recent.get(&tool(1)).is_none());
        assert!(recent.get(&tool(room)).is_some());
        recent.keep(&tool(0), Kept::new(long + 1, points(1..=long + 1), MOST_OF_TOOL + 1), 0);
        assert_eq!(
            recent.get(&tool(0)).unwrap().cycles,
            long,
            "too long to be kept, and no reason to forget"
        );
        let all: usize = recent.shelf().tools.values().map(|kept| kept.points.len()).sum();
        assert_eq!(recent.shelf().points, all);
    }

    #[test]
    fn an_older_answer_does_not_replace_a_newer() {
        let recent = Recent::default();
        recent.keep(&tool(1), Kept::new(3, points(1..=3), 10), 0);
        recent.keep(&tool(1), Kept::new(2, points(1..=2), 10), 0);
        assert_eq!(recent.get(&tool(1)).unwrap().cycles, 3);
    }

    #[test]
    fn what_was_read_while_a_group_ended_is_asked_about_again() {
        let recent = Recent::default();
        let is_fresh = || recent.get(&tool(1)).unwrap().fresh;
        let before = recent.groups();
        recent.begun([tool(1)].iter());
        recent.ended([tool(1)].iter());
        recent.keep(&tool(1), Kept::new(3, points(1..=3), 10), before);
        assert!(!is_fresh(), "it may have been read before the group's commit");
        recent.confirm(&tool(1), 3, before);
        assert!(!is_fresh());
        recent.confirm(&tool(1), 2, recent.groups());
        assert!(!is_fresh(), "somebody has kept other cycles meanwhile");
        recent.confirm(&tool(1), 3, recent.groups());
        assert!(is_fresh());
        recent.begun([tool(2)].iter());
        assert!(is_fresh(), "another tool's");
        recent.ended([tool(2)].iter());
        assert!(is_fresh());
        let both = [tool(2), tool(1), tool(1)];
        recent.begun(both.iter());
        recent.begun([tool(1)].iter());
        assert!(!is_fresh(), "others may see its cycles already");
        recent.ended(both.iter());
        recent.confirm(&tool(1), 3, recent.groups());
        assert!(!is_fresh(), "one is still under way");
        recent.ended([tool(1)].iter());
        assert!(!is_fresh());
        recent.confirm(&tool(1), 3, recent.groups());
        assert!(is_fresh());
        assert!(recent.shelf().under_way.is_empty());
    }
}

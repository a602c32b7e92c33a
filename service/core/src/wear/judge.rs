//! From the fold's state to a verdict with its reasons.

use super::WARNING_LEVEL;
use super::basis::Decision;
use super::fold::{ToolFold, UNPLACED_CYCLES, outdated_after};
use super::key::KeyState;
use super::trend::remaining;
use super::verdict::{
    BaselineEvidence, Exclusion, Level, LevelBasis, Masked, SecondIndicators, ToolState, Verdict,
};
use crate::ids::{CycleId, MachineId};
use crate::summary::PeakShift;
use crate::units::{Strategy, Timestamp};

/// What a cycle that is cut short wants somebody to know.
const CUT_SHORT: &str = "the server cut it short, as it has more samples or lasts longer than is kept";

/// Of a baseline that carries a level over which nobody knew any more.
const AFTER_GAP: &str = "the tool was used for long without being measured, or under more conditions than are kept, before this \
                         baseline was met: confirm that its wear is still what it was";

/// Shift of the spindle load's falling edge, mm, that may be wear; the paper's worn tool moves the maximum by 2 mm.
const FALL_SHIFT_MM: f64 = 1.0;

impl ToolFold {
    /// The last cycles that were not counted so far, oldest first; a reason may change until a later cycle settles it.
    pub fn last_excluded(&self) -> &[(MachineId, CycleId, Exclusion)] {
        &self.last_excluded
    }

    /// How many cycles the life that runs has had.
    pub const fn cycles(&self) -> u64 {
        self.cycles
    }

    /// The level that is judged now; `None` before there is one, and for a tool that was never known to be new.
    pub fn judged_level(&self) -> Option<Level> {
        self.judged(self.decision())
    }

    fn judged(&self, decision: Option<Decision>) -> Option<Level> {
        if self.is_known_new() { self.level_evidence(decision) } else { None }
    }

    /// Whether the first measured cycles are known to be those of a tool that had not worked before.
    fn is_known_new(&self) -> bool {
        self.unworn && !self.is_unplaced()
    }

    /// What the fold says now.
    pub fn verdict(&self) -> Verdict {
        if self.cycles == 0 && self.life == 0 {
            return Verdict::unknown("no_cycles", "no cycle of this tool is known");
        }
        let mut reasons = Vec::new();
        let decision = self.decision();
        let state = self.state(&mut reasons, decision);
        let points = match decision.and_then(|decision| decision.basis) {
            Some(LevelBasis::ReferenceCycles) => &self.feeds.reference_trend,
            Some(LevelBasis::FeedCompensated) => &self.feeds.compensated_trend,
            Some(LevelBasis::AsRun) | None => &self.trend,
        };
        let level = self.judged(decision);
        let trend = if self.is_known_new() { points.trend() } else { None };
        let sure = matches!(state, ToolState::Good | ToolState::Warning);
        let remaining = match (&trend, &decision) {
            (Some(trend), Some(decision)) if sure && decision.basis.is_some() => {
                remaining(points, trend, (decision.level, decision.n))
            }
            _ => None,
        };
        let current = self.current.map(|at| &self.keys[at]);
        let mut baselines: Vec<&KeyState> = self.keys.iter().collect();
        baselines.sort_by_key(|key| std::cmp::Reverse(key.used));
        Verdict {
            state,
            reasons,
            level,
            trend,
            remaining,
            indicators: SecondIndicators {
                masked_by_control: self.masked(decision) == Some(Masked::ByControl),
                ..current.map(indicators).unwrap_or_default()
            },
            feed: self.feed_evidence(decision),
            life: self.life,
            started_unworn: self.is_known_new(),
            baselines: baselines.into_iter().map(evidence).collect(),
            cycles: self.cycles,
            counted: self.counted,
            excluded: self.excluded,
            last_excluded: self.last_excluded.clone(),
            age_cycles: self.cycles - self.last_counted,
            last_counted_at: self.last_counted_us.map(Timestamp::from_micros),
            last: self.last.clone(),
        }
    }

    fn state(&self, reasons: &mut Vec<(&'static str, String)>, decision: Option<Decision>) -> ToolState {
        let mut say = |code, why: String| reasons.push((code, why));
        let current = self.current.map(|at| &self.keys[at]);
        let (masked, basis) = (self.masked(decision), decision.and_then(|decision| decision.basis));
        match (masked, basis) {
            (Some(Masked::ByControl), _) => say(
                "masked_by_control",
                "the control slows the feed as the tool wears, so energy hides wear".into(),
            ),
            (Some(Masked::ByFeed), _) => say(
                "masked_by_feed",
                "the feeds run are so far from the reference feed that nobody knows what the energy means there"
                    .into(),
            ),
            (None, Some(LevelBasis::FeedCompensated)) => say(
                "decided_by_compensation",
                "energy is compared with what the new tool would have needed at the feeds run".into(),
            ),
            (None, Some(LevelBasis::ReferenceCycles)) => say(
                "decided_by_reference_cycles",
                "the feed varies, so reference cycles at one constant feed are compared".into(),
            ),
            (None, Some(LevelBasis::AsRun) | None) => {}
        }
        if current.is_some_and(|key| (key.level_at_entry - 1.0).abs() > f64::EPSILON) {
            say(
                "level_carried_over",
                "this baseline was met in mid-life: the wear until then is carried over".into(),
            );
        }
        if !self.unworn {
            say(
                "no_new_tool_baseline",
                "the tool was not new at its first measured cycle: no new-tool baseline".into(),
            );
        }
        let percent = decision.map_or(0.0, |decision| 100.0 * (decision.level - 1.0));
        let against = if self.is_known_new() { "the new tool" } else { "its first measured cycles" };
        if !self.suspects.is_empty() {
            let n = self.excluded[Exclusion::BrokenSuspected as usize];
            say(
                "undercut",
                format!("{n} cycle(s) cut hardly anything after good ones: the tool may be broken"),
            );
            return ToolState::BrokenSuspected;
        }
        if self.worn {
            say("worn", format!("energy reached 10 % above {against} (now {percent:+.1} %), latched"));
            return ToolState::Worn;
        }
        // Of whichever key: what the tool does elsewhere meanwhile confirms nothing.
        if let Some(changed) = self.keys.iter().find(|key| key.change.is_some()) {
            let operation = &changed.key.operation;
            let of = if current.is_some_and(|key| key.key.operation == *operation) {
                String::new()
            } else {
                format!(" in operation `{operation}`")
            };
            say(
                "conditions_changed",
                format!(
                    "energy, time, depth or the sheet's thickness jumped and stayed{of}: confirm the conditions"
                ),
            );
            return ToolState::Changed;
        }
        if self.warned && current.is_some() {
            say("warning", format!("energy is {percent:+.1} % against {against}"));
            return ToolState::Warning;
        }
        // What is known to have changed stays so, whatever else is not known.
        let is_changed =
            |key: &KeyState| key.baseline.is_some() && (key.stepped || key.unconfirmed || key.after_gap);
        if self.is_unplaced() && !current.is_some_and(is_changed) {
            say(
                "clock_suspect",
                format!(
                    "more than {UNPLACED_CYCLES} cycles whose clock was never set have come in since this life began: nobody knows which \
                     of them wore the tool"
                ),
            );
            return ToolState::Unknown;
        }
        let Some(key) = current else {
            let (code, why) = self.why_nothing();
            say(code, why);
            return ToolState::Unknown;
        };
        if key.baseline.is_none() {
            let (have, need) = (key.learnt_from(), key.needed);
            say("learning", format!("{have} of {need} cycles that a baseline needs"));
            if let Some(unknown) = self.unknown_for() {
                say("level_outdated", format!("of the last {unknown} cycles none says how worn the tool is"));
                return ToolState::Unknown;
            }
            if key.after_gap {
                say("level_unconfirmed", AFTER_GAP.into());
                return ToolState::Unknown;
            }
            return if self.unworn { ToolState::Learning } else { ToolState::Unknown };
        }
        let age = self.cycles - self.last_counted;
        if age > outdated_after(self.window) {
            let last = self.last_excluded.last().map(|(_, _, why)| *why);
            let cut = if last == Some(Exclusion::CutShort) {
                format!("; the last: {CUT_SHORT}")
            } else {
                String::new()
            };
            say("level_outdated", format!("none of the last {age} cycles could be counted{cut}"));
            return ToolState::Unknown;
        }
        if !key.after_gap
            && let Some((middle, have, need)) = self.unclear_since_gap()
        {
            let percent = 100.0 * (middle - 1.0);
            let why = format!(
                "after long work that nobody measured energy is {percent:+.1} %: {have} of {need} cycles that tell"
            );
            say("level_outdated", why);
            return ToolState::Unknown;
        }
        if !self.unworn {
            return ToolState::Unknown;
        }
        if key.stepped {
            say(
                "conditions_changed",
                "energy jumped while the baseline was learnt: confirm the conditions".into(),
            );
            return ToolState::Changed;
        }
        let longer = indicators(key).cycle_time_ratio.filter(|ratio| *ratio >= WARNING_LEVEL);
        if let (Some(Strategy::FAc), Some(ratio)) = (key.key.strategy, longer) {
            let percent = 100.0 * (ratio - 1.0);
            say(
                "cycle_time_risen",
                format!("the control lengthened the cycle by {percent:.1} %: run a reference cycle"),
            );
            return ToolState::Unknown;
        }
        if let (Some(Strategy::FAc), Some(Masked::ByControl), Some(shift)) =
            (key.key.strategy, masked, indicators(key).fall_depth)
            && shift.shift_mm().abs() >= FALL_SHIFT_MM
        {
            let shift = shift.shift_mm();
            say(
                "fall_shifted",
                format!("the spindle load's falling edge has moved by {shift:+.1} mm: run a reference cycle"),
            );
            return ToolState::Unknown;
        }
        if masked.is_some() && self.may_be_worn() {
            say(
                "maybe_worn",
                "compensated for the feed, the level is too uncertain to call the tool good: run a reference \
                 cycle"
                    .into(),
            );
            return ToolState::Unknown;
        }
        if key.unconfirmed && self.keys.iter().any(|known| known.differs_in_speed(&key.key)) {
            say(
                "speed_changed",
                "the commanded speed was changed in mid-life: confirm the conditions".into(),
            );
            return ToolState::Changed;
        }
        if key.unconfirmed || key.after_gap {
            say("level_unconfirmed", AFTER_GAP.into());
            return ToolState::Changed;
        }
        say("good", format!("energy is {percent:+.1} % against the new tool"));
        ToolState::Good
    }

    /// Why no cycle of this life could be compared.
    fn why_nothing(&self) -> (&'static str, String) {
        let most = Exclusion::ALL
            .into_iter()
            .max_by_key(|why| (self.excluded[*why as usize], std::cmp::Reverse(*why)));
        match most.filter(|why| self.excluded[*why as usize] > 0) {
            Some(Exclusion::CutShort) => (
                Exclusion::CutShort.as_str(),
                format!("no cycle of this life could be compared: {CUT_SHORT}"),
            ),
            Some(why) => (why.as_str(), format!("no cycle of this life could be compared: {}", why.as_str())),
            None => ("no_cycles", "no cycle since the tool was mounted".into()),
        }
    }
}

impl KeyState {
    /// Cycles that agree so far, of those being learnt from; all that were needed once it is complete.
    fn learnt_from(&self) -> u32 {
        match &self.baseline {
            Some(baseline) => baseline.learnt_from,
            None => self.agreeing(),
        }
    }
}

fn evidence(key: &KeyState) -> BaselineEvidence {
    BaselineEvidence {
        key: key.key.clone(),
        learnt_from: key.learnt_from(),
        needed: key.needed,
        baseline_joules: key.baseline.as_ref().map(|baseline| baseline.joules),
        earlier: key.earlier.clone(),
        level_at_entry: key.level_at_entry,
        operator_override_percent: key.baseline.as_ref().and_then(|baseline| baseline.operator_percent),
    }
}

fn indicators(key: &KeyState) -> SecondIndicators {
    let baseline = key.baseline.as_ref();
    let fall = baseline.and_then(|baseline| baseline.fall_depth_mm).zip(key.fall_depth_now());
    let time = baseline.and_then(|baseline| baseline.duration_ms).zip(key.duration_now());
    SecondIndicators {
        fall_depth: fall.map(|(baseline_mm, now_mm)| PeakShift { baseline_mm, now_mm }),
        cycle_time_ratio: time.filter(|(before, _)| *before > 0.0).map(|(before, now)| now / before),
        masked_by_control: false,
    }
}

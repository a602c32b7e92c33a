//! Wear from energy when the feed is not always the same.
//!
//! A law that slows the feed when the tool gets dull hides the wear from the energy. Two ratios are reported:
//! as run, energy over the new tool's energy under the same key; and feed-compensated, energy over what the new
//! tool would have needed at the feeds actually run. For that each key (strategy, law, profile version …) learns
//! its own relation of energy to depth and feed on its first cycles: a slope fitted across strategies would be a
//! chord over feeds where the truth is curved.
//!
//! The limit (+10 %) is defined at one constant feed, and the same wear is worth less where the feed is higher,
//! because a worn surface drags for a shorter time. So the extra energy of each depth bin is also carried over to
//! the reference feed: extra energy per time at a depth is taken to depend on the feed with a small, uncertain
//! exponent (0 is dry friction). That third ratio, or the median of recent reference cycles where there are
//! enough, decides; where neither is known well enough, nothing is decided, and a cycle whose feed a law chose is
//! flagged "wear masked by control".
//!
//! What does not belong here: which cycles count, their order, baselines over tool lives. This is one life.

use super::calibration::median;
use super::error::{Invalid, InvalidCode, between, positive};
use super::program::HIGHEST_FEED_MM_MIN;
use super::relation::{
    DepthBin, DepthProfile, Estimate, FeedSource, Per, Prediction, Relation, RelationConfig, RelationParams,
};
use std::collections::VecDeque;

/// Most keys (strategy, law, profile version …) of one tool's life that are told apart.
pub const MOST_KEYS: usize = 64;

/// Longest window of cycles.
pub const LONGEST_WINDOW: u32 = 1000;

/// Largest factor by which a window's wear is carried on to the present; early in a life it would be noise.
const MOST_ONWARD: f64 = 1.25;

/// Age in cycles up to which reference cycles may decide, where none are asked for regularly.
const OLDEST_REFERENCE: u32 = 500;

/// Fewest reference cycles that may decide.
const FEWEST_REFERENCES: usize = 3;

/// Thresholds and windows as plain values; [`WearConfig::new`] checks them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WearParams {
    /// Bins and prior knowledge of the energy relation.
    pub energy: RelationParams,
    /// Constant feed in mm/min at which the limit is defined and reference cycles are run.
    pub reference_feed_mm_min: f64,
    /// Exponent with which the drag of a worn surface grows with the feed.
    pub drag_feed_exponent: f64,
    /// Standard deviation of that exponent.
    pub drag_feed_exponent_sd: f64,
    /// First cycles of a key, which teach its relation and whose median is its as-run baseline. Those of the
    /// first keys count as new; a key first met later carries the level at its entry.
    pub learning_cycles: u32,
    /// Cycles whose median is the level.
    pub window_cycles: u32,
    /// Reference cycles whose median is the level.
    pub reference_window: u32,
    /// Cycles after which a reference cycle is asked for; `None` never asks.
    pub reference_every: Option<u32>,
    /// Standard deviation of a ratio above which it does not decide.
    pub enough_sd: f64,
    /// Level of a warning, of its clearing, and of a worn tool.
    pub warning: f64,
    /// Level below which a warning is cleared.
    pub cleared: f64,
    /// Level of a worn tool.
    pub worn: f64,
}

impl WearParams {
    /// Warning at 1.07, cleared below 1.05, worn at 1.10; 20 learning cycles, windows of 21, a reference cycle every 50.
    #[must_use]
    pub const fn new(depth_mm: f64, reference_feed_mm_min: f64) -> Self {
        Self {
            energy: RelationParams::energy(depth_mm),
            reference_feed_mm_min,
            drag_feed_exponent: 0.0,
            drag_feed_exponent_sd: 0.3,
            learning_cycles: 20,
            window_cycles: 21,
            reference_window: 21,
            reference_every: Some(50),
            enough_sd: 0.03,
            warning: 1.07,
            cleared: 1.05,
            worn: 1.10,
        }
    }
}

/// Checked thresholds and windows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WearConfig {
    params: WearParams,
    energy: RelationConfig,
}

impl WearConfig {
    /// Checks the parameters.
    ///
    /// # Errors
    /// With the field that is out of range or out of order.
    pub fn new(params: WearParams) -> Result<Self, Invalid> {
        let energy = RelationConfig::new(params.energy).map_err(|error| error.within("energy"))?;
        positive("reference_feed_mm_min", params.reference_feed_mm_min, HIGHEST_FEED_MM_MIN)?;
        between("drag_feed_exponent", params.drag_feed_exponent, -1.0, 2.0)?;
        between("drag_feed_exponent_sd", params.drag_feed_exponent_sd, 0.0, 2.0)?;
        let longest = f64::from(LONGEST_WINDOW);
        between("learning_cycles", f64::from(params.learning_cycles), 1.0, longest)?;
        between("window_cycles", f64::from(params.window_cycles), 1.0, longest)?;
        between("reference_window", f64::from(params.reference_window), 3.0, longest)?;
        if let Some(every) = params.reference_every {
            between("reference_every", f64::from(every), 1.0, 1e6)?;
        }
        positive("enough_sd", params.enough_sd, 1.0)?;
        between("worn", params.worn, 1.0, 10.0)?;
        between("warning", params.warning, 1.0, 10.0)?;
        between("cleared", params.cleared, 1.0, 10.0)?;
        if !(params.cleared <= params.warning && params.warning <= params.worn) {
            let text = "cleared, warning and worn must not fall";
            return Err(Invalid::new("warning", InvalidCode::Inconsistent, text));
        }
        Ok(Self { params, energy })
    }

    /// The checked parameters.
    #[must_use]
    pub const fn params(&self) -> &WearParams {
        &self.params
    }

    /// Bins in which the energy of a cycle has to be cut.
    #[must_use]
    pub const fn bins(&self) -> &RelationConfig {
        &self.energy
    }
}

/// One counted cycle of the life, in order.
#[derive(Debug, Clone, Copy)]
pub struct WearCycle<'a> {
    /// Energy over depth, J.
    pub energy: &'a DepthProfile,
    /// Who chose the feed.
    pub source: FeedSource,
    /// Whether it is a reference cycle: the reference feed from end to end, no override.
    pub is_reference: bool,
    /// What has to be equal for energies to be compared as run: strategy, law, profile version … Reference cycles
    /// are a key of their own, whatever stands here.
    pub key: u32,
}

/// What the level rests on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WearBasis {
    /// The median of recent reference cycles.
    ReferenceCycles,
    /// The median of recent cycles, compensated for their feeds.
    FeedCompensated,
}

/// What the level means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum WearVerdict {
    /// Still learning, or nothing decides.
    #[default]
    Unknown,
    /// Below the warning.
    Good,
    /// Warning.
    Warning,
    /// Worn; stays until the tool's life ends.
    Worn,
}

/// What one cycle says about the tool.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WearReading {
    /// Energy over the baseline of the same key; `None` while the key is learning.
    pub as_run: Option<f64>,
    /// Energy over what the new tool would have needed at the feeds actually run.
    pub compensated: Option<Estimate>,
    /// The same extra energy at the reference feed, as a ratio: what the limit is defined on.
    pub at_reference_feed: Option<Estimate>,
    /// Level and what it rests on; `None` where nothing decides.
    pub level: Option<(f64, WearBasis)>,
    /// What the level means.
    pub verdict: WearVerdict,
    /// A law chose the feed and nothing decides: wear may be hidden by the control.
    pub masked_by_control: bool,
    /// A reference cycle should be run.
    pub reference_due: bool,
}

/// What is known about the tool under one key.
#[derive(Debug, Clone, PartialEq)]
struct KeyState {
    key: Option<u32>,
    relation: Relation,
    energies: Vec<f64>,
    baseline_j: f64,
    level_at_entry: f64,
}

/// Memory of one tool's life.
#[derive(Debug, Clone, PartialEq)]
pub struct WearState {
    keys: Vec<KeyState>,
    recent: VecDeque<(u32, f64)>,
    references: VecDeque<(u32, f64)>,
    cycles: u32,
    last_reference: Option<u32>,
    level: Option<(f64, WearBasis)>,
    verdict: WearVerdict,
}

impl Default for WearState {
    fn default() -> Self {
        Self::new()
    }
}

impl WearState {
    /// A new tool.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            keys: Vec::new(),
            recent: VecDeque::new(),
            references: VecDeque::new(),
            cycles: 0,
            last_reference: None,
            level: None,
            verdict: WearVerdict::Unknown,
        }
    }

    /// The relation learned under a key (`None`: under reference cycles).
    #[must_use]
    pub fn relation(&self, key: Option<u32>) -> Option<&Relation> {
        self.keys.iter().find(|known| known.key == key).map(|known| &known.relation)
    }

    /// Cycles counted.
    #[must_use]
    pub const fn cycles(&self) -> u32 {
        self.cycles
    }

    /// Counts one cycle.
    pub fn step(&mut self, config: &WearConfig, cycle: &WearCycle<'_>) -> WearReading {
        let params = &config.params;
        self.cycles = self.cycles.saturating_add(1);
        if cycle.is_reference {
            self.last_reference = Some(self.cycles);
        }
        let (mut as_run, mut compensated, mut at_reference_feed) = (None, None, None);
        if let Some(place) = self.learned_key(config, cycle) {
            let known = &self.keys[place];
            if known.baseline_j > 0.0 {
                as_run = Some(known.level_at_entry * cycle.energy.total() / known.baseline_j);
            }
            if let Some((own, reference)) = self.compensate(params, cycle, known) {
                compensated = Some(own);
                at_reference_feed = Some(reference);
                if cycle.is_reference {
                    push(&mut self.references, (self.cycles, reference.value), params.reference_window);
                }
                if reference.sd <= params.enough_sd {
                    push(&mut self.recent, (self.cycles, reference.value), params.window_cycles);
                }
            }
        }
        let decided = at_reference_feed.is_some_and(|ratio| ratio.sd <= params.enough_sd);
        self.level = self.decide(params, decided);
        self.verdict = self.judge(params);
        WearReading {
            as_run,
            compensated,
            at_reference_feed,
            level: self.level,
            verdict: self.verdict,
            masked_by_control: cycle.source == FeedSource::Controlled && self.level.is_none(),
            reference_due: self.is_reference_due(params),
        }
    }

    /// The place of the cycle's key once it has learned; a key that still learns takes the cycle in.
    fn learned_key(&mut self, config: &WearConfig, cycle: &WearCycle<'_>) -> Option<usize> {
        let key = (!cycle.is_reference).then_some(cycle.key);
        let place = match self.keys.iter().position(|known| known.key == key) {
            Some(place) => place,
            None if self.keys.len() < MOST_KEYS => {
                self.keys.push(KeyState {
                    key,
                    relation: Relation::new(config.energy),
                    energies: Vec::new(),
                    baseline_j: 0.0,
                    level_at_entry: self.level.map_or(1.0, |(level, _)| level),
                });
                self.keys.len() - 1
            }
            None => return None,
        };
        let known = &mut self.keys[place];
        if known.relation.cycles() >= config.params.learning_cycles {
            return Some(place);
        }
        known.relation.observe(cycle.energy, Per::Depth, cycle.source);
        known.energies.push(cycle.energy.total());
        known.baseline_j = median(&mut known.energies);
        None
    }

    fn is_reference_due(&self, params: &WearParams) -> bool {
        params
            .reference_every
            .is_some_and(|every| self.last_reference.is_none_or(|last| self.cycles - last >= every))
    }

    /// The ratio at the feeds run, and the ratio that the same extra energy means at the reference feed.
    fn compensate(
        &self,
        params: &WearParams,
        cycle: &WearCycle<'_>,
        known: &KeyState,
    ) -> Option<(Estimate, Estimate)> {
        let needed = known.relation.predict(cycle.energy, DepthBin::feed_mm_min);
        // What the new tool needs at the reference feed is measured where reference cycles were run.
        let reference_relation = self.relation(None).filter(|relation| relation.cycles() > 0);
        let reference = reference_relation
            .unwrap_or(&known.relation)
            .predict(cycle.energy, |_| Some(params.reference_feed_mm_min));
        let (mut measured, mut extra, mut by_exponent) = (0.0, 0.0, 0.0);
        let (mut own, mut carried, mut at_reference) =
            (Prediction::default(), Prediction::default(), Prediction::default());
        for ((bin, need), other) in cycle.energy.bins().iter().zip(needed).zip(reference) {
            let (Some(need), Some(other), Some(feed)) = (need, other, bin.feed_mm_min()) else { continue };
            let faster = feed / params.reference_feed_mm_min;
            // Energy is power × time: the same drag lasts `faster` times longer at the reference feed.
            let carry = faster.powf(1.0 - params.drag_feed_exponent);
            let here = carry * (bin.total - need.total);
            measured += bin.total;
            extra += here;
            by_exponent += here * faster.ln();
            own = own.plus(need);
            carried = carried.plus(need.times(carry));
            at_reference = at_reference.plus(other);
        }
        if own.total <= 0.0 || at_reference.total <= 0.0 {
            return None;
        }
        let ratio = known.level_at_entry * measured / own.total;
        let rise = extra / at_reference.total;
        let exponent = params.drag_feed_exponent_sd * by_exponent / at_reference.total;
        let scale = rise * at_reference.sd() / at_reference.total;
        let sd = (carried.sd() / at_reference.total).hypot(exponent).hypot(scale);
        Some((
            Estimate { value: ratio, sd: ratio * own.sd() / own.total },
            Estimate { value: known.level_at_entry + rise, sd },
        ))
    }

    fn decide(&self, params: &WearParams, compensation_decides: bool) -> Option<(f64, WearBasis)> {
        let fresh = match (params.reference_every, self.last_reference) {
            (Some(every), Some(last)) => self.cycles - last <= every.saturating_mul(2),
            (None, Some(last)) => !compensation_decides && self.cycles - last <= OLDEST_REFERENCE,
            (_, None) => false,
        };
        if fresh && self.references.len() >= FEWEST_REFERENCES {
            return Some((self.level_of(&self.references), WearBasis::ReferenceCycles));
        }
        let full = self.recent.len() >= params.window_cycles as usize;
        (full && compensation_decides).then(|| (self.level_of(&self.recent), WearBasis::FeedCompensated))
    }

    /// The median of a window, carried from the window's middle to now.
    ///
    /// A window's median is as old as its middle. The wear so far is taken to go on at its mean rate for that
    /// long, which is exact for steady wear and cautious for wear that slows down.
    fn level_of(&self, window: &VecDeque<(u32, f64)>) -> f64 {
        let mut values: Vec<f64> = window.iter().map(|entry| entry.1).collect();
        let mut cycles: Vec<f64> = window.iter().map(|entry| f64::from(entry.0)).collect();
        let (level, age) = (median(&mut values), median(&mut cycles));
        let onward = (f64::from(self.cycles) / age.max(1.0)).min(MOST_ONWARD);
        1.0 + (level - 1.0) * onward
    }

    fn judge(&self, params: &WearParams) -> WearVerdict {
        let Some((level, _)) = self.level else {
            // What was good once is not known to be good now.
            return if self.verdict == WearVerdict::Good { WearVerdict::Unknown } else { self.verdict };
        };
        match self.verdict {
            WearVerdict::Worn => WearVerdict::Worn,
            _ if level >= params.worn => WearVerdict::Worn,
            _ if level >= params.warning => WearVerdict::Warning,
            WearVerdict::Warning if level >= params.cleared => WearVerdict::Warning,
            _ => WearVerdict::Good,
        }
    }
}

fn push(ring: &mut VecDeque<(u32, f64)>, value: (u32, f64), length: u32) {
    while ring.len() >= length as usize {
        ring.pop_front();
    }
    ring.push_back(value);
}

#[cfg(test)]
mod tests;

//! Wear from energy when the feed is not always the same.
//!
//! A law that slows the feed when the tool gets dull hides the wear from the energy. Two ratios are reported:
//! as run, energy over the new tool's energy under the same key; and feed-compensated, energy over what the new
//! tool would have needed at the feeds actually run, from the relation learned on its first cycles.
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
use super::relation::{DepthProfile, Estimate, FeedSource, Per, Relation, RelationConfig, RelationParams};
use std::collections::VecDeque;

/// Most keys (strategy, law, profile version …) of one tool's life that are told apart.
pub const MOST_KEYS: usize = 64;

/// Longest window of cycles.
pub const LONGEST_WINDOW: u32 = 1000;

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
    /// First cycles of a life, which count as new and teach the relation.
    pub learning_cycles: u32,
    /// Cycles whose median is the as-run baseline of a key.
    pub baseline_cycles: u32,
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
    /// Warning at 1.07, cleared below 1.05, worn at 1.10; 30 learning cycles, windows of 11.
    #[must_use]
    pub const fn new(depth_mm: f64, reference_feed_mm_min: f64) -> Self {
        Self {
            energy: RelationParams::energy(depth_mm),
            reference_feed_mm_min,
            drag_feed_exponent: 0.0,
            drag_feed_exponent_sd: 0.15,
            learning_cycles: 30,
            baseline_cycles: 5,
            window_cycles: 11,
            reference_window: 11,
            reference_every: None,
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
        between("baseline_cycles", f64::from(params.baseline_cycles), 1.0, longest)?;
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
    /// What has to be equal for as-run energies to be compared: strategy, law, profile version …
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
    /// Energy over the baseline of the same key; `None` while that baseline is being formed.
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

#[derive(Debug, Clone, PartialEq)]
struct KeyBaseline {
    key: u32,
    energies: Vec<f64>,
    level_at_entry: f64,
}

/// Memory of one tool's life.
#[derive(Debug, Clone, PartialEq)]
pub struct WearState {
    relation: Relation,
    keys: Vec<KeyBaseline>,
    recent: VecDeque<f64>,
    references: VecDeque<f64>,
    cycles: u32,
    last_reference: Option<u32>,
    level: Option<(f64, WearBasis)>,
    verdict: WearVerdict,
}

impl WearState {
    /// A new tool.
    #[must_use]
    pub fn new(config: &WearConfig) -> Self {
        Self {
            relation: Relation::new(config.energy),
            keys: Vec::new(),
            recent: VecDeque::new(),
            references: VecDeque::new(),
            cycles: 0,
            last_reference: None,
            level: None,
            verdict: WearVerdict::Unknown,
        }
    }

    /// The relation learned on the new tool.
    #[must_use]
    pub const fn relation(&self) -> &Relation {
        &self.relation
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
        let as_run = self.as_run(params, cycle);
        let (mut compensated, mut at_reference_feed) = (None, None);
        if self.cycles <= params.learning_cycles {
            self.relation.observe(cycle.energy, Per::Depth, cycle.source);
        } else if let Some((own, reference)) = self.compensate(params, cycle) {
            compensated = Some(own);
            at_reference_feed = Some(reference);
            if cycle.is_reference {
                push(&mut self.references, reference.value, params.reference_window);
            }
            if reference.sd <= params.enough_sd {
                push(&mut self.recent, reference.value, params.window_cycles);
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

    fn is_reference_due(&self, params: &WearParams) -> bool {
        params
            .reference_every
            .is_some_and(|every| self.last_reference.is_none_or(|last| self.cycles - last >= every))
    }

    /// Energy over the median of the key's first cycles; a key first met on a worn tool carries its wear over.
    fn as_run(&mut self, params: &WearParams, cycle: &WearCycle<'_>) -> Option<f64> {
        let energy = cycle.energy.total();
        let level_at_entry = self.level.map_or(1.0, |(level, _)| level);
        let place = self.keys.iter().position(|known| known.key == cycle.key);
        let known = match place {
            Some(place) => &mut self.keys[place],
            None if self.keys.len() < MOST_KEYS => {
                self.keys.push(KeyBaseline { key: cycle.key, energies: Vec::new(), level_at_entry });
                self.keys.last_mut()?
            }
            None => return None,
        };
        if known.energies.len() < params.baseline_cycles as usize {
            known.energies.push(energy);
            known.energies.sort_by(f64::total_cmp);
            return None;
        }
        let baseline = median(&mut known.energies) / known.level_at_entry;
        (baseline > 0.0).then(|| energy / baseline)
    }

    /// The ratio at the feeds run, and the ratio that the same extra energy means at the reference feed.
    fn compensate(&self, params: &WearParams, cycle: &WearCycle<'_>) -> Option<(Estimate, Estimate)> {
        let feed_run = self.relation.predict(cycle.energy, |_, bin| bin.feed_mm_min());
        let at_reference = self.relation.predict(cycle.energy, |_, _| Some(params.reference_feed_mm_min));
        let (mut measured, mut expected, mut reference) = (0.0, 0.0, 0.0);
        let (mut extra, mut by_exponent) = (0.0, 0.0);
        let (mut own_level, mut own_slope, mut carried_level, mut carried_slope) = (0.0, 0.0, 0.0, 0.0);
        for ((bin, own), other) in cycle.energy.bins().iter().zip(&feed_run).zip(&at_reference) {
            let (Some(own), Some(other), Some(feed)) = (own, other, bin.feed_mm_min()) else { continue };
            let faster = feed / params.reference_feed_mm_min;
            // Energy is power × time: the same drag lasts `faster` times longer at the reference feed.
            let carry = faster.powf(1.0 - params.drag_feed_exponent);
            measured += bin.total;
            expected += own.total;
            reference += other.total;
            extra += carry * (bin.total - own.total);
            by_exponent += carry * (bin.total - own.total) * faster.ln();
            own_level += own.level_sd;
            own_slope += own.slope_sd;
            carried_level += carry * own.level_sd;
            carried_slope += carry * own.slope_sd;
        }
        if expected <= 0.0 || reference <= 0.0 {
            return None;
        }
        let ratio = measured / expected;
        let own = Estimate { value: ratio, sd: ratio * own_level.hypot(own_slope) / expected };
        let exponent = params.drag_feed_exponent_sd * by_exponent;
        let sd = carried_level.hypot(carried_slope).hypot(exponent) / reference;
        Some((own, Estimate { value: 1.0 + extra / reference, sd }))
    }

    fn decide(&self, params: &WearParams, compensation_decides: bool) -> Option<(f64, WearBasis)> {
        let fresh = match (params.reference_every, self.last_reference) {
            (Some(every), Some(last)) => self.cycles - last <= every.saturating_mul(2),
            (None, Some(_)) => !compensation_decides,
            (_, None) => false,
        };
        if fresh && self.references.len() >= FEWEST_REFERENCES {
            return Some((middle(&self.references), WearBasis::ReferenceCycles));
        }
        let full = self.recent.len() >= params.window_cycles as usize;
        (full && compensation_decides).then(|| (middle(&self.recent), WearBasis::FeedCompensated))
    }

    fn judge(&self, params: &WearParams) -> WearVerdict {
        let Some((level, _)) = self.level else {
            return self.verdict;
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

fn push(ring: &mut VecDeque<f64>, value: f64, length: u32) {
    while ring.len() >= length as usize {
        ring.pop_front();
    }
    ring.push_back(value);
}

fn middle(ring: &VecDeque<f64>) -> f64 {
    let mut values: Vec<f64> = ring.iter().copied().collect();
    median(&mut values)
}

//! One baseline key: learning its baseline, and telling usual cycles from unusual ones.

use super::facts::{CycleFacts, OrderKey};
use super::fold::FoldSettings;
use super::verdict::{BaselineKey, Earlier, Exclusion, MOST_LEVEL, Verdict};
use crate::friction::relation::{FeedSource, Per, Relation};
use crate::operation::WearSettings;
use crate::summary::{DepthDigest, EnergyBasis, SURFACE_MM, median, relation_config};
use crate::units::Strategy;

/// Below this share of what is usual, hardly anything was cut.
pub(super) const UNDERCUT: f64 = 0.6;
/// A baseline is learnt from energies within this factor of their median, either way.
const LEARNING_BAND: f64 = 4.0 / 3.0;
/// Speeds within ±2 % share a key.
const SPEED_TOLERANCE: f64 = 0.02;
/// Operator's overrides further apart than this are not compared, points.
const OPERATOR_TOLERANCE: f64 = 5.0;
/// The operator's override where none is reported, %.
const OPERATOR_NEUTRAL: f64 = 100.0;
/// A depth this share off the usual one is another depth.
const DEPTH_TOLERANCE: f64 = 0.1;
/// Shorter than this share of the usual time, a cycle without depth may be incomplete.
const SHORT: f64 = 0.85;
/// Steps below this are never told from noise and wear.
const STEP_MIN: f64 = 0.12;
/// Step taken where the noise is not known yet.
const STEP_UNKNOWN_NOISE: f64 = 0.15;
/// Steps above this are told however noisy the energies are.
const STEP_MAX: f64 = 0.20;
/// A step has to exceed the noise of single cycles so many times.
const STEP_SIGMAS: f64 = 4.0;
/// Depths of breakthrough that differ by less are one sheet's, and those that differ by more are two sheets', however
/// noisy the loads are.
const SHEET_STEP: (f64, f64) = (0.07, 0.10);
/// Standard deviation of that depth, relative, before it is known, and how many differences that is worth.
const SHEET_SIGMA: (f64, f64) = (0.02, 6.0);
/// Cycles after a step that make it lasting while a baseline is being learnt.
const LASTING_LEARNT: usize = 3;
/// So many odd cycles at the start are no conditions of their own.
const BEDDING_IN: usize = 2;
/// Energies of one level scatter by no more than this while a baseline is being learnt.
const LEARNT_SCATTER: f64 = 0.1;
/// Counted cycles that a jump is told from.
const PREDECESSORS: usize = 3;
/// Successive differences that the noise is told from.
const NOISE_LENGTH: usize = 16;
/// Differences needed before the noise counts as known.
const NOISE_KNOWN: usize = 6;
/// Counted cycles that "usual" is the median of.
const USUAL_LENGTH: usize = 5;
/// Counted cycles that the second indicators are the median of.
const INDICATOR_LENGTH: usize = 5;
/// Baselines of before that are kept, to tell what a cycle was compared with; what came before the oldest is told no ratio.
const EARLIER_BASELINES: usize = 8;
/// Digests that are held while a baseline is being learnt: more cycles make the relation hardly better.
pub(super) const HELD_DIGESTS: usize = 64;
/// Cycles that a relation is learnt from at the least.
const LEAST_RELATION: u32 = 3;
/// Normal distribution: median of |a − b| over sigma, √2 · 0.6745.
const DIFFERENCE_MEDIAN: f64 = 0.953_87;

/// What is measured of one cycle, as far as wear compares it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Measured {
    /// Running number of the cycle within its tool's life.
    pub(super) number: u64,
    /// The same of the cycles that may have worn the tool.
    pub(super) worked: u64,
    /// The tool's level when a baseline was learnt from it; 1 for others.
    pub(super) level: f64,
    pub(super) order: OrderKey,
    pub(super) joules: f64,
    pub(super) duration_ms: Option<f64>,
    pub(super) depth_mm: Option<f64>,
    pub(super) fall_depth_mm: Option<f64>,
    /// Depth at which the sheet opened.
    pub(super) breakthrough_mm: Option<f64>,
    pub(super) operator_percent: Option<f64>,
    /// Energy over depth; dropped once the cycle was counted.
    pub(super) digest: Option<DepthDigest>,
}

impl Measured {
    pub(super) fn of(
        facts: &CycleFacts,
        (joules, duration_ms): (f64, Option<f64>),
        (number, worked): (u64, u64),
    ) -> Self {
        Self {
            number,
            worked,
            level: 1.0,
            order: facts.order.clone(),
            joules,
            duration_ms,
            depth_mm: facts.max_depth_mm,
            fall_depth_mm: facts.fall_depth_mm,
            breakthrough_mm: facts.digest.as_ref().and_then(DepthDigest::breakthrough_mm),
            operator_percent: facts.operator_override_percent,
            digest: facts.digest.clone(),
        }
    }

    fn operator(&self) -> f64 {
        self.operator_percent.unwrap_or(OPERATOR_NEUTRAL)
    }
}

/// A complete baseline.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Baseline {
    /// B: median energy of the cycles it was learnt from over the level at entry, J.
    pub(super) joules: f64,
    pub(super) duration_ms: Option<f64>,
    pub(super) depth_mm: Option<f64>,
    pub(super) fall_depth_mm: Option<f64>,
    pub(super) breakthrough_mm: Option<f64>,
    pub(super) operator_percent: Option<f64>,
    pub(super) learnt_from: u32,
}

/// What the last counted cycles of a key amount to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Usual {
    pub(super) joules: f64,
    pub(super) duration_ms: Option<f64>,
    pub(super) depth_mm: Option<f64>,
    pub(super) breakthrough_mm: Option<f64>,
}

/// How a cycle compares with what is usual for its key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Look {
    /// As usual.
    Usual,
    /// Hardly anything was cut, at the usual depth as far as that is known.
    Undercut,
    /// Energy, time or depth is off by more than noise and wear do from one cycle to the next.
    Off,
}

/// A key whose conditions changed: what was usual before, and how often that has come back in a row.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Change {
    pub(super) before: Usual,
    pub(super) back: Vec<Measured>,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct KeyState {
    pub(super) key: BaselineKey,
    pub(super) needed: u32,
    pub(super) window: u32,
    pub(super) level_at_entry: f64,
    /// Whether it began because the commanded speed of an operation changed in mid-life, and nobody confirmed that.
    pub(super) unconfirmed: bool,
    /// Whether it learnt from a cycle before which nobody knew how worn the tool was, and nobody confirmed that.
    pub(super) after_gap: bool,
    /// Whether conditions changed while it was being learnt, and nobody confirmed that.
    pub(super) stepped: bool,
    /// Running number of the cycle with which two that it learnt from agreed: that is what "after good cycles" takes.
    pub(super) knows_since: Option<u64>,
    /// Running number of the last cycle that was as usual.
    pub(super) last_usual: u64,
    /// What was usual before it was to be learnt anew.
    pub(super) before: Option<Usual>,
    /// Baselines of before, oldest first; the last one holds until the next cycle where that has yet to come.
    pub(super) earlier: Vec<Earlier>,
    /// Cycles the baseline is being learnt from, in order; empty once it is complete.
    pub(super) learning: Vec<Measured>,
    pub(super) baseline: Option<Baseline>,
    /// Last counted cycles, oldest first.
    pub(super) recent: Vec<Measured>,
    /// Relative differences of successive counted energies and times.
    pub(super) energy_noise: Vec<f64>,
    pub(super) time_noise: Vec<f64>,
    pub(super) sheet_noise: Vec<f64>,
    /// Cycles off the usual that are not told yet from a lasting step.
    pub(super) off: Vec<Measured>,
    /// Cycles of this key so far, and those at which a single cycle off the usual was followed by a usual one.
    pub(super) seen: u64,
    pub(super) flips: Vec<u64>,
    pub(super) change: Option<Change>,
    /// The new tool's energy over depth and feed, where the baseline's cycles told it.
    pub(super) relation: Option<Relation>,
    /// Constant feed of reference cycles, mm/min, as the operation says.
    pub(super) reference_feed_mm_min: Option<f64>,
    /// Running number of the last cycle, to evict the key that was not run for longest.
    pub(super) used: u64,
}

fn medians(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let known: Vec<f64> = values.flatten().collect();
    (!known.is_empty()).then(|| median(&known))
}

fn push_bounded<T>(ring: &mut Vec<T>, value: T, bound: usize) {
    if ring.len() == bound {
        ring.remove(0);
    }
    ring.push(value);
}

/// Whether `cycle` reached another depth than usual.
fn depth_is_off(cycle: &Measured, usual: &Usual) -> bool {
    ratio(cycle.depth_mm, usual.depth_mm).is_some_and(|r| (r - 1.0).abs() > DEPTH_TOLERANCE)
}

/// Whether two speeds share a key.
fn speeds_match(one: Option<f64>, other: Option<f64>) -> bool {
    match (one, other) {
        (Some(one), Some(other)) => (one - other).abs() <= SPEED_TOLERANCE * one.abs(),
        (None, None) => true,
        _ => false,
    }
}

impl BaselineKey {
    /// What a cycle is compared under.
    pub(super) fn of(facts: &CycleFacts, in_contact: bool, settings: &FoldSettings) -> Self {
        let (basis, idle_subtracted) =
            facts.energy.map_or((EnergyBasis::Reported, false), |(basis, net, _)| (basis, net));
        let strategy = facts.compared_as(settings.is_friction);
        // What else a machine names with a reference cycle it was asked for is what runs between them.
        let as_told = strategy == facts.strategy;
        Self {
            machine: facts.order.machine.clone(),
            operation: facts.operation.clone(),
            spindle_speed_rpm: facts.speed_rpm(settings.spindle_speed_rpm),
            basis,
            idle_subtracted,
            in_contact,
            energy_scale: facts.energy_scale,
            strategy,
            law_version: facts.law_version.clone().filter(|_| as_told),
            profile: facts.profile.clone().filter(|_| as_told),
        }
    }

    /// The place of this key among others: of those whose speeds are alike the one whose speed is nearest.
    pub(super) fn among<'k>(&self, keys: impl Iterator<Item = &'k Self>) -> Option<usize> {
        let off = |key: &Self| match (key.spindle_speed_rpm, self.spindle_speed_rpm) {
            (Some(usual), Some(speed)) => (usual - speed).abs(),
            _ => 0.0,
        };
        let alike = keys.enumerate().filter(|(_, key)| key.matches(self));
        alike.min_by(|(_, one), (_, other)| off(one).total_cmp(&off(other))).map(|(at, _)| at)
    }

    /// Whether `other` is this one, speeds being alike within ±2 %.
    fn matches(&self, other: &Self) -> bool {
        speeds_match(self.spindle_speed_rpm, other.spindle_speed_rpm)
            && self.machine == other.machine
            && self.operation == other.operation
            && self.basis == other.basis
            && self.idle_subtracted == other.idle_subtracted
            && self.in_contact == other.in_contact
            && self.energy_scale == other.energy_scale
            && self.strategy == other.strategy
            && self.law_version == other.law_version
            && self.profile == other.profile
    }
}

impl Verdict {
    /// Energy of a cycle of the tool's current life over that of the new tool that it was compared with, at most
    /// [`MOST_LEVEL`] either way: a baseline that was learnt anew says nothing of the cycles before. `None` where it has none, or the
    /// new tool's is not known.
    pub fn ratio_of(&self, facts: &CycleFacts, settings: &FoldSettings) -> Option<f64> {
        let (in_contact, joules, _) = facts.compared(settings.is_friction)?;
        let key = BaselineKey::of(facts, in_contact, settings);
        let place = key.among(self.baselines.iter().map(|baseline| &baseline.key))?;
        let baseline = self.baselines.get(place)?.joules_at(&facts.order)?;
        (baseline > 0.0).then(|| (joules / baseline).clamp(-MOST_LEVEL, MOST_LEVEL))
    }
}

impl KeyState {
    pub(super) fn new(key: BaselineKey, settings: WearSettings, level_at_entry: f64) -> Self {
        Self {
            key,
            needed: settings.baseline_cycles,
            window: settings.window_cycles,
            level_at_entry,
            unconfirmed: false,
            after_gap: false,
            stepped: false,
            knows_since: None,
            last_usual: 0,
            before: None,
            earlier: Vec::new(),
            learning: Vec::new(),
            baseline: None,
            recent: Vec::new(),
            energy_noise: Vec::new(),
            time_noise: Vec::new(),
            sheet_noise: Vec::new(),
            off: Vec::new(),
            seen: 0,
            flips: Vec::new(),
            change: None,
            relation: None,
            reference_feed_mm_min: None,
            used: 0,
        }
    }

    /// What it compares.
    pub(super) const fn key(&self) -> &BaselineKey {
        &self.key
    }

    /// Whether `key` is this one.
    pub(super) fn matches(&self, key: &BaselineKey) -> bool {
        self.key.matches(key)
    }

    /// Whether `key` differs from this one only in the commanded speed: the same operation, run otherwise.
    pub(super) fn differs_in_speed(&self, key: &BaselineKey) -> bool {
        !self.matches(key) && {
            let same_speed = BaselineKey { spindle_speed_rpm: self.key.spindle_speed_rpm, ..key.clone() };
            self.matches(&same_speed)
        }
    }

    /// Whether it holds reference cycles of the same work as `other`.
    pub(super) fn is_reference_of(&self, other: &Self) -> bool {
        self.key.strategy == Some(Strategy::FConst) && {
            let (strategy, law_version) = (self.key.strategy, self.key.law_version.clone());
            let profile = self.key.profile.clone();
            self.matches(&BaselineKey { strategy, law_version, profile, ..other.key.clone() })
        }
    }

    /// Who chose its feeds.
    fn feed_source(&self) -> FeedSource {
        if self.key.strategy == Some(Strategy::FAc) || self.key.law_version.is_some() {
            FeedSource::Controlled
        } else {
            FeedSource::Programmed
        }
    }

    /// Learns the new tool's energy over depth and feed from the baseline's cycles.
    fn learn_relation(&self, fit: &[&Measured]) -> Option<Relation> {
        let mut relation = Relation::new(relation_config()?);
        for cycle in fit {
            if let Some(profile) = cycle.digest.as_ref().and_then(DepthDigest::profile) {
                relation.observe(&profile, Per::Depth, self.feed_source());
            }
        }
        // One cycle alone says nothing of how cycles scatter.
        (relation.cycles() >= LEAST_RELATION).then_some(relation)
    }

    /// Forgets the baseline and learns a new one that carries `level` over; the old one holds for what came before the cycle at `from`,
    /// or before the key's next one where nobody knows it yet. What is held must have been taken out before.
    pub(super) fn relearn(&mut self, level: f64, from: Option<OrderKey>) {
        let settings = WearSettings {
            baseline_cycles: self.needed,
            window_cycles: self.window,
            ..WearSettings::default()
        };
        let before = self.confirmed_usual();
        let joules = self.baseline.as_ref().map(|baseline| baseline.joules);
        let mut earlier = std::mem::take(&mut self.earlier);
        earlier.push(Earlier { until: from, joules });
        if earlier.len() > EARLIER_BASELINES {
            earlier.remove(0);
            earlier[0].joules = None;
        }
        *self = Self {
            used: self.used,
            knows_since: self.knows_since,
            last_usual: self.last_usual,
            before: before.or(self.before),
            earlier,
            reference_feed_mm_min: self.reference_feed_mm_min,
            ..Self::new(self.key.clone(), settings, level)
        };
    }

    /// Whether a cycle of no energy, or of less, says that nothing was measured, and not that nothing was cut: the tool went into the
    /// work, or a spindle's whole power was nothing, which even idling is not.
    pub(super) fn is_unmeasured(&self, cycle: &Measured) -> bool {
        let whole_power = self.key.basis == EnergyBasis::MeasuredPower && !self.key.idle_subtracted;
        whole_power || cycle.depth_mm.is_some_and(|reached| reached > SURFACE_MM)
    }

    /// A cycle of it has come: what holds until the next one does no more.
    pub(super) fn note_next(&mut self, order: &OrderKey) {
        if let Some(last) = self.earlier.last_mut() {
            last.until.get_or_insert_with(|| order.clone());
        }
    }

    /// Cycles that are neither counted nor left out yet, in order, which are not held any more.
    pub(super) fn take_held(&mut self) -> Vec<(Measured, Exclusion)> {
        let learning = std::mem::take(&mut self.learning).into_iter();
        let off = std::mem::take(&mut self.off).into_iter();
        let back = self.change.as_mut().map(|change| std::mem::take(&mut change.back)).unwrap_or_default();
        let learning = learning.map(|cycle| (cycle, Exclusion::BaselineOutlier));
        let changed = off.chain(back).map(|cycle| (cycle, Exclusion::ConditionsChanged));
        learning.chain(changed).collect()
    }

    /// Whether the operator's override keeps `cycle` from being compared with the baseline.
    pub(super) fn override_differs(&self, cycle: &Measured) -> bool {
        self.baseline.as_ref().is_some_and(|baseline| {
            let expected = baseline.operator_percent.unwrap_or(OPERATOR_NEUTRAL);
            (cycle.operator() - expected).abs() > OPERATOR_TOLERANCE
        })
    }

    /// Whether `cycle`, under another override than the baseline's, cut at all. At a higher feed it takes less time, and down to as much
    /// less energy; at a lower one more time, in which idling alone takes as much more.
    pub(super) fn look_despite_override(&self, cycle: &Measured, usual: &Usual) -> Look {
        let expected = self.baseline.as_ref().and_then(|baseline| baseline.operator_percent);
        let expected = expected.filter(|percent| *percent > 0.0).unwrap_or(OPERATOR_NEUTRAL);
        let times = expected / cycle.operator().max(1.0);
        let depth_off = depth_is_off(cycle, usual);
        let least = UNDERCUT * usual.joules;
        if depth_off {
            Look::Off
        } else if cycle.joules < least * times.min(1.0) {
            Look::Undercut
        } else if (least * times.max(1.0)..=usual.joules * times.max(1.0) / UNDERCUT).contains(&cycle.joules)
        {
            Look::Usual
        } else {
            Look::Off
        }
    }

    /// What is usual, or was before a step that nobody has confirmed.
    pub(super) fn confirmed_usual(&self) -> Option<Usual> {
        self.change.as_ref().map(|change| change.before).or_else(|| self.usual())
    }

    /// What the last counted cycles amount to.
    pub(super) fn usual(&self) -> Option<Usual> {
        let last = &self.recent[self.recent.len().saturating_sub(USUAL_LENGTH)..];
        if last.is_empty() {
            return None;
        }
        let energies: Vec<f64> = last.iter().map(|cycle| cycle.joules).collect();
        Some(Usual {
            joules: median(&energies),
            duration_ms: medians(last.iter().map(|cycle| cycle.duration_ms)),
            depth_mm: medians(last.iter().map(|cycle| cycle.depth_mm)),
            // The sheet of the baseline, not of the last cycles: step by step these could come to any sheet.
            breakthrough_mm: self.baseline.as_ref().and_then(|baseline| baseline.breakthrough_mm),
        })
    }

    /// How `cycle` compares with `usual`.
    pub(super) fn look(&self, cycle: &Measured, usual: &Usual) -> Look {
        let depth_off = depth_is_off(cycle, usual);
        if cycle.joules < UNDERCUT * usual.joules && !depth_off {
            return Look::Undercut;
        }
        let energy_off = (cycle.joules / usual.joules - 1.0).abs() > self.energy_step();
        let time_off =
            ratio(cycle.duration_ms, usual.duration_ms).is_some_and(|r| (r - 1.0).abs() > self.time_step());
        if depth_off || energy_off || time_off || self.another_sheet(cycle, usual) {
            Look::Off
        } else {
            Look::Usual
        }
    }

    /// Whether the sheet opened at another depth than usual: it is thicker or thinner, which no wear does.
    pub(super) fn another_sheet(&self, cycle: &Measured, usual: &Usual) -> bool {
        ratio(cycle.breakthrough_mm, usual.breakthrough_mm)
            .is_some_and(|r| (r - 1.0).abs() > self.sheet_step())
    }

    fn sheet_step(&self) -> f64 {
        let ((least, most), (expected, worth)) = (SHEET_STEP, SHEET_SIGMA);
        #[expect(clippy::cast_precision_loss, reason = "at most 16 differences")]
        let n = if sigma(&self.sheet_noise).is_some() { self.sheet_noise.len() as f64 } else { 0.0 };
        let seen = sigma(&self.sheet_noise).unwrap_or(expected);
        let sigma = ((n * seen * seen + worth * expected * expected) / (n + worth)).sqrt();
        (STEP_SIGMAS * sigma).clamp(least, most)
    }

    /// Whether `cycle` is off not only what is usual but also most of its last predecessors: wear creeps, a step
    /// jumps. Several are asked, since one borderline cycle may already lie beyond the step.
    pub(super) fn jumped(&self, cycle: &Measured) -> bool {
        let last = &self.recent[self.recent.len().saturating_sub(PREDECESSORS)..];
        let far = |now: f64, before: f64, step: f64| (now / before - 1.0).abs() > step / 2.0;
        let jumps = last.iter().filter(|before| {
            far(cycle.joules, before.joules, self.energy_step())
                || ratio(cycle.duration_ms, before.duration_ms).is_some_and(|r| far(r, 1.0, self.time_step()))
                || ratio(cycle.depth_mm, before.depth_mm).is_some_and(|r| far(r, 1.0, DEPTH_TOLERANCE))
        });
        2 * jumps.count() > last.len()
    }

    /// Whether `cycle` lies nearer to the cycles that are off than to what is usual: a step goes on, although noise
    /// brings single cycles back below the limit.
    pub(super) fn goes_on(&self, cycle: &Measured, usual: &Usual) -> bool {
        let nearer = |of: f64, off: f64, usual: f64| (of - off).abs() < (of - usual).abs();
        if self.off_is_another_sheet(usual)
            && let Some(off) = medians(self.off.iter().map(|cycle| cycle.breakthrough_mm))
            && let (Some(depth), Some(usual)) = (cycle.breakthrough_mm, usual.breakthrough_mm)
        {
            return nearer(depth, off, usual);
        }
        let energies: Vec<f64> = self.off.iter().map(|cycle| cycle.joules).collect();
        !energies.is_empty() && nearer(cycle.joules, median(&energies), usual.joules)
    }

    /// The relative step in energy that is more than noise.
    pub(super) fn energy_step(&self) -> f64 {
        step(&self.energy_noise)
    }

    fn time_step(&self) -> f64 {
        step(&self.time_noise)
    }

    /// Whether a cycle that is off looks like one that was not finished.
    pub(super) fn looks_incomplete(cycle: &Measured, usual: &Usual) -> bool {
        match ratio(cycle.depth_mm, usual.depth_mm) {
            Some(depth) => depth < 1.0 - DEPTH_TOLERANCE,
            None => {
                ratio(cycle.duration_ms, usual.duration_ms).is_some_and(|time| time < SHORT)
                    && cycle.joules < 0.9 * usual.joules
            }
        }
    }

    /// Whether most of the cycles that are off are another sheet's.
    pub(super) fn off_is_another_sheet(&self, usual: &Usual) -> bool {
        2 * self.off.iter().filter(|cycle| self.another_sheet(cycle, usual)).count() > self.off.len()
    }

    /// Whether all cycles that are off stayed where the first of them jumped to, instead of running on.
    pub(super) fn off_is_level(&self) -> bool {
        let (Some((first, rest)), Some(usual)) = (self.off.split_first(), self.usual()) else { return false };
        let jump = first.joules / usual.joules - 1.0;
        let allowed = self.energy_step().max(0.5 * jump.abs());
        rest.iter().all(|cycle| {
            let moved = cycle.joules / first.joules - 1.0;
            let runs_on =
                moved * jump > 0.0 && jump.abs() > self.energy_step() && moved.abs() > 0.5 * jump.abs();
            moved.abs() <= allowed && !runs_on
        })
    }

    /// Keeps a counted cycle for what is usual, noise and indicators.
    pub(super) fn keep(&mut self, mut cycle: Measured) {
        cycle.digest = None;
        if let Some(last) = self.recent.last() {
            let apart = |now: f64, before: f64| (now / before).ln().abs();
            push_bounded(&mut self.energy_noise, apart(cycle.joules, last.joules), NOISE_LENGTH);
            if let (Some(now), Some(before)) = (cycle.duration_ms, last.duration_ms)
                && now > 0.0
                && before > 0.0
            {
                push_bounded(&mut self.time_noise, apart(now, before), NOISE_LENGTH);
            }
            if let (Some(now), Some(before)) = (cycle.breakthrough_mm, last.breakthrough_mm) {
                push_bounded(&mut self.sheet_noise, apart(now, before), NOISE_LENGTH);
            }
        }
        push_bounded(&mut self.recent, cycle, USUAL_LENGTH.max(INDICATOR_LENGTH));
    }

    /// How many of the cycles being learnt from agree.
    pub(super) fn agreeing(&self) -> u32 {
        let energies: Vec<f64> = self.learning.iter().map(|cycle| cycle.joules).collect();
        if energies.is_empty() {
            return 0;
        }
        let centre = median(&energies);
        let n = energies.iter().filter(|joules| within(**joules, centre, LEARNING_BAND)).count();
        u32::try_from(n).unwrap_or(u32::MAX).min(self.needed)
    }

    /// Median energy of the cycles that agree, where at least `least` of those being learnt from do.
    pub(super) fn learning_centre(&self, least: usize) -> Option<Usual> {
        let energies: Vec<f64> = self.learning.iter().map(|cycle| cycle.joules).collect();
        if energies.is_empty() {
            return None;
        }
        let centre = median(&energies);
        let agreeing: Vec<&Measured> =
            self.learning.iter().filter(|cycle| within(cycle.joules, centre, LEARNING_BAND)).collect();
        if agreeing.len() < least {
            return None;
        }
        let energies: Vec<f64> = agreeing.iter().map(|cycle| cycle.joules).collect();
        Some(Usual {
            joules: median(&energies),
            duration_ms: medians(agreeing.iter().map(|cycle| cycle.duration_ms)),
            depth_mm: medians(agreeing.iter().map(|cycle| cycle.depth_mm)),
            breakthrough_mm: commonest(
                &agreeing.iter().filter_map(|cycle| cycle.breakthrough_mm).collect::<Vec<f64>>(),
            ),
        })
    }

    /// Completes the baseline where enough cycles agree. Returns every cycle that was held, in order, with the
    /// reason why it is left out, or `None` in its place where it is counted.
    pub(super) fn complete(&mut self) -> Option<Vec<(Measured, Option<Exclusion>)>> {
        let mut left_out = self.settle_learning_step()?;
        let Some(centre) = self.learning_centre(self.needed as usize) else {
            return (!left_out.is_empty()).then_some(left_out);
        };
        let operator =
            medians(self.learning.iter().map(|cycle| cycle.operator_percent)).unwrap_or(OPERATOR_NEUTRAL);
        let judged: Vec<(Measured, Option<Exclusion>)> = self
            .learning
            .iter()
            .map(|cycle| (cycle.clone(), self.unfit_to_learn_from(cycle, &centre, operator)))
            .collect();
        let fit: Vec<&Measured> = judged
            .iter()
            .filter(|(_, why)| why.is_none())
            .map(|(cycle, _)| cycle)
            .take(self.needed as usize)
            .collect();
        if fit.len() < self.needed as usize {
            return (!left_out.is_empty()).then_some(left_out);
        }
        // A cycle that took far more than these says that these may all be air.
        self.stepped |= self.learning.iter().any(|cycle| centre.joules < UNDERCUT * cycle.joules);
        let energies: Vec<f64> = fit.iter().map(|cycle| cycle.joules).collect();
        self.baseline = Some(Baseline {
            joules: median(&energies) / self.level_at_entry,
            duration_ms: medians(fit.iter().map(|cycle| cycle.duration_ms)),
            depth_mm: medians(fit.iter().map(|cycle| cycle.depth_mm)),
            fall_depth_mm: medians(fit.iter().map(|cycle| cycle.fall_depth_mm)),
            breakthrough_mm: medians(fit.iter().map(|cycle| cycle.breakthrough_mm)),
            operator_percent: medians(fit.iter().map(|cycle| cycle.operator_percent)),
            learnt_from: self.needed,
        });
        self.relation = self.learn_relation(&fit);
        self.learning.clear();
        left_out.extend(judged);
        Some(left_out)
    }

    /// Looks for a lasting step among the cycles being learnt from: a baseline must not straddle it. Returns the
    /// cycles before a step, which are left out; `None` while too few cycles have come after one to tell.
    fn settle_learning_step(&mut self) -> Option<Vec<(Measured, Option<Exclusion>)>> {
        let energies: Vec<f64> = self.learning.iter().map(|cycle| cycle.joules).collect();
        if energies.is_empty() {
            return Some(Vec::new());
        }
        let centre = median(&energies);
        let cut: Vec<usize> =
            (0..energies.len()).filter(|&k| within(energies[k], centre, 1.0 / UNDERCUT)).collect();
        let energies: Vec<f64> = cut.iter().map(|&k| energies[k]).collect();
        let Some(step) = first_step(&energies) else { return Some(Vec::new()) };
        if energies.len() - step < LASTING_LEARNT {
            return None;
        }
        // One or two odd cycles at the start are a tool that beds in; more are conditions that changed.
        let changed = step > BEDDING_IN;
        self.stepped |= changed;
        let why = if changed { Exclusion::ConditionsChanged } else { Exclusion::BaselineOutlier };
        let before = self.learning.drain(..cut[step]).map(|cycle| (cycle, Some(why))).collect();
        Some(before)
    }

    /// Why `cycle` is left out of a baseline around `centre`.
    fn unfit_to_learn_from(&self, cycle: &Measured, centre: &Usual, operator: f64) -> Option<Exclusion> {
        if (cycle.operator() - operator).abs() > OPERATOR_TOLERANCE {
            Some(Exclusion::OperatorOverride)
        } else if Self::looks_incomplete(cycle, centre) {
            Some(Exclusion::Incomplete)
        } else if cycle.joules < UNDERCUT * centre.joules {
            Some(Exclusion::AirCut)
        } else if self.another_sheet(cycle, centre) {
            Some(Exclusion::ConditionsChanged)
        } else if within(cycle.joules, centre.joules, LEARNING_BAND) {
            None
        } else {
            Some(Exclusion::BaselineOutlier)
        }
    }

    /// Cycles that may be held while a baseline is being learnt.
    pub(super) fn learning_bound(&self) -> usize {
        2 * self.needed as usize + 16
    }

    /// Median depth of the falling edge over the last counted cycles, mm.
    pub(super) fn fall_depth_now(&self) -> Option<f64> {
        medians(self.recent.iter().map(|cycle| cycle.fall_depth_mm))
    }

    /// Median cycle time over the last counted cycles, ms.
    pub(super) fn duration_now(&self) -> Option<f64> {
        medians(self.recent.iter().map(|cycle| cycle.duration_ms))
    }
}

fn ratio(value: Option<f64>, usual: Option<f64>) -> Option<f64> {
    match (value, usual) {
        (Some(value), Some(usual)) if usual > 0.0 => Some(value / usual),
        _ => None,
    }
}

fn within(value: f64, centre: f64, factor: f64) -> bool {
    value * factor >= centre && value <= centre * factor
}

/// Whether two runs of energies are each of one level, and far apart.
fn is_step(before: &[f64], after: &[f64]) -> bool {
    let (low, high) = (median(before), median(after));
    let steady =
        |run: &[f64], level: f64| run.iter().all(|joules| (joules / level - 1.0).abs() <= LEARNT_SCATTER);
    (high / low - 1.0).abs() > STEP_UNKNOWN_NOISE && steady(before, low) && steady(after, high)
}

/// Where energies first divide into two runs that make a step.
///
/// It is asked with every cycle of a baseline of up to 500: most places are told from what the least and the largest energy on either
/// side allow the medians to be, and medians are found of the few that are left.
fn first_step(energies: &[f64]) -> Option<usize> {
    let after = spans(energies.iter().rev().copied());
    let before = spans(energies.iter().copied());
    (1..energies.len())
        .filter(|&split| may_be_step(before[split - 1], after[energies.len() - split - 1]))
        .find(|&split| is_step(&energies[..split], &energies[split..]))
}

/// The least and the largest of the values so far, at each.
fn spans(values: impl Iterator<Item = f64>) -> Vec<(f64, f64)> {
    let so_far = values.scan((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| {
        (*least, *most) = (least.min(value), most.max(value));
        Some((*least, *most))
    });
    so_far.collect()
}

/// Whether two runs of energies with these least and largest values can make a step. The median of a steady run lies among its values and
/// no further than [`LEARNT_SCATTER`] from either end.
fn may_be_step(before: (f64, f64), after: (f64, f64)) -> bool {
    /// What rounding may do to a comparison of ratios, many times over.
    const SLACK: f64 = 1e-9;
    if before.0 < f64::MIN_POSITIVE || after.0 < f64::MIN_POSITIVE {
        // Where numbers are not rounded by a share of themselves, nothing is told beforehand.
        return true;
    }
    let medians = |(least, most): (f64, f64)| {
        (least.max(most / (1.0 + LEARNT_SCATTER)), most.min(least / (1.0 - LEARNT_SCATTER)))
    };
    let ((low_least, low_most), (high_least, high_most)) = (medians(before), medians(after));
    let steady = low_least <= low_most * (1.0 + SLACK) && high_least <= high_most * (1.0 + SLACK);
    let apart = high_most * (1.0 + SLACK) >= low_least * (1.0 + STEP_UNKNOWN_NOISE)
        || high_least * (1.0 - SLACK) <= low_most * (1.0 - STEP_UNKNOWN_NOISE);
    steady && apart
}

/// Median of the largest group of depths that are one sheet's; the first of several that are as large.
fn commonest(depths: &[f64]) -> Option<f64> {
    let alike = |depth: f64| {
        let near = |other: &&f64| (**other / depth - 1.0).abs() <= SHEET_STEP.1;
        depths.iter().filter(near).copied().collect::<Vec<f64>>()
    };
    let mut largest: Vec<f64> = Vec::new();
    for depth in depths {
        let group = alike(*depth);
        if group.len() > largest.len() {
            largest = group;
        }
    }
    (!largest.is_empty()).then(|| median(&largest))
}

/// Standard deviation of single cycles, relative, from successive differences; `None` while there are too few.
fn sigma(differences: &[f64]) -> Option<f64> {
    (differences.len() >= NOISE_KNOWN).then(|| median(differences) / DIFFERENCE_MEDIAN)
}

fn step(differences: &[f64]) -> f64 {
    sigma(differences).map_or(STEP_UNKNOWN_NOISE, |sigma| (STEP_SIGMAS * sigma).clamp(STEP_MIN, STEP_MAX))
}

#[cfg(test)]
mod tests {
    use super::{first_step, is_step, may_be_step, spans};
    use proptest::prelude::{Just, ProptestConfig, Strategy, prop, prop_assert_eq, prop_oneof, proptest};

    fn first_step_by_all_medians(energies: &[f64]) -> Option<usize> {
        (1..energies.len()).find(|&split| is_step(&energies[..split], &energies[split..]))
    }

    /// Energies of up to two levels that scatter by up to a quarter, of any size, some far off.
    fn energies() -> impl Strategy<Value = Vec<f64>> {
        let scale = prop_oneof![3 => Just(2000.0), 1 => Just(1e18), 1 => Just(1e-310), 1 => Just(5e-324)];
        let step = prop_oneof![2 => 0.7..1.4, 1 => Just(1.15), 1 => Just(0.85), 1 => Just(1.0 / 0.9)];
        (scale, step, 0.0..0.25, 0..40_usize, prop::collection::vec((-1.0..1.0, 0..60_u8), 0..80)).prop_map(
            |(scale, step, scatter, at, noise)| {
                let energy = |(k, (noise, odd)): (usize, (f64, u8))| {
                    let level = if k < at { 1.0 } else { step };
                    let odd = if odd == 0 { 1.5 } else { 1.0 };
                    scale * level * odd * (1.0 + scatter * noise)
                };
                noise.into_iter().enumerate().map(energy).collect()
            },
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4096))]

        /// What is told beforehand leaves out no step.
        #[test]
        fn a_step_is_found_where_all_medians_find_it(energies in energies()) {
            prop_assert_eq!(first_step(&energies), first_step_by_all_medians(&energies));
        }
    }

    /// With every cycle of a baseline of 500 the place of a step is asked for: of noise, hardly any median is.
    #[test]
    fn of_a_long_baseline_few_medians_are_asked_for() {
        let energies: Vec<f64> =
            (0..1000_u32).map(|k| 2000.0 * (1.0 + 0.08 * (f64::from(k) * 2.399).sin())).collect();
        let (before, after) = (spans(energies.iter().copied()), spans(energies.iter().rev().copied()));
        let asked = (1..energies.len())
            .filter(|&split| may_be_step(before[split - 1], after[energies.len() - split - 1]));
        assert!(asked.count() < 20);
    }
}

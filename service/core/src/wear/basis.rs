//! Which ratio decides: as run, compensated for the feed, or that of reference cycles.
//!
//! As run decides where one feed is run, and where nobody says otherwise. A life under programs or laws that vary the
//! feed is judged by its reference cycles while they are fresh; else by the energy compensated for the feed, where the
//! relation is known well enough; else by nothing, and its cycles are flagged as masked.

use super::WORN_LEVEL;
use super::fold::{LEAST_RATIOS, ToolFold};
use super::key::KeyState;
use super::trend::TrendPoints;
use super::verdict::{FeedEvidence, Level, LevelBasis, MOST_LEVEL, Masked, ReferenceCycles};
use crate::friction::relation::Estimate;
use crate::friction::wear::{Compensated, Reference, compensate};
use crate::summary::{DepthDigest, median, median_in_place};
use crate::units::Strategy;

/// Ratios kept beside those as run, of reference cycles and of compensated ones.
pub(super) const KEPT_RATIOS: usize = 63;
/// Standard deviation of a level above which it does not decide: a third of what there is to tell.
const ENOUGH_SD: f64 = 0.03;
/// Standard deviation at the limit up to which no reference cycle is asked for: 15 % of a life.
const PRECISE_SD: f64 = 0.015;
/// Reference cycles after those of the baseline that may decide.
const FEWEST_REFERENCES: usize = 3;
/// Largest factor by which a window's wear is carried on to the present; early in a life it would be noise.
const MOST_ONWARD: f64 = 1.25;
/// Reference cycles that come up to so much later than asked still decide, as a share and in cycles.
const LATE_REFERENCE: (u64, u64) = (5, 5);
/// Age in cycles at which references that nobody asks for are no longer fresh, or four windows.
const OLD_REFERENCE: u64 = 20;
/// Standard error of a median over that of a mean, normal distribution.
const MEDIAN_ERROR: f64 = 1.2533;
/// Median absolute deviation to standard deviation, normal distribution.
const MAD_SIGMA: f64 = 1.4826;

/// One counted cycle, compensated for its feed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CompensatedRatio {
    /// Running number of the cycle among those of its tool's life that may have worn it.
    pub(super) worked: u64,
    /// Over what the new tool would have needed at the feeds run, with its standard deviation.
    pub(super) own: (f64, f64),
    /// The same extra energy at the reference feed.
    pub(super) reference: Option<(f64, f64)>,
    /// Standard deviation to expect of it when the limit is reached.
    pub(super) sd_at_limit: f64,
}

impl CompensatedRatio {
    fn deciding(&self) -> (f64, f64) {
        self.reference.unwrap_or(self.own)
    }
}

/// What the fold remembers beside the ratios as run, where the feed varies.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct FeedMemory {
    /// Whether a program or law that varies the feed ran in this life, and in any life of the tool.
    pub(super) varied: bool,
    pub(super) ever_varied: bool,
    /// Settings of the operation that ran last.
    pub(super) every: Option<u32>,
    pub(super) reference_feed_mm_min: Option<f64>,
    /// Reference cycles that were counted after their baseline: running number among those that may have worn the tool, and
    /// ratio, oldest first.
    pub(super) references: Vec<(u64, f64)>,
    pub(super) reference_trend: TrendPoints,
    /// Running number of the last reference cycle that was counted or taught, and how many there were.
    pub(super) last_reference: Option<u64>,
    pub(super) reference_count: u64,
    pub(super) compensated: Vec<CompensatedRatio>,
    pub(super) compensated_trend: TrendPoints,
    /// Cycles of this life that were flagged as masked.
    pub(super) masked: u64,
}

impl FeedMemory {
    /// What a new life takes over from the one before: how the tool is used, nothing of its wear.
    pub(super) fn next_life(&self) -> Self {
        Self {
            ever_varied: self.ever_varied,
            every: self.every,
            reference_feed_mm_min: self.reference_feed_mm_min,
            ..Self::default()
        }
    }
}

/// The level that decides.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Decision {
    /// What it rests on; `None` where nothing decides.
    pub(super) basis: Option<LevelBasis>,
    /// The level; as run where nothing decides.
    pub(super) level: f64,
    /// Its standard deviation, where it is known.
    pub(super) sd: Option<f64>,
    /// Ratios that it is the median of.
    pub(super) n: usize,
}

/// A program or law that varies the feed.
pub(super) const fn varies_feed(strategy: Option<Strategy>) -> bool {
    matches!(strategy, Some(Strategy::FSec | Strategy::FLin | Strategy::FAc))
}

impl ToolFold {
    pub(super) fn current_key(&self) -> Option<&KeyState> {
        self.current.map(|at| &self.keys[at])
    }

    /// Compensates a cycle of the key at `at`, whose relation was learnt from other cycles.
    pub(super) fn compensated(&self, at: usize, digest: Option<&DepthDigest>) -> Option<Compensated> {
        let key = &self.keys[at];
        let (relation, profile) = (key.relation.as_ref()?, digest?.profile()?);
        let reference = if varies_feed(key.key.strategy) {
            let measured = self.keys.iter().find(|other| other.is_reference_of(key));
            let measured = measured.and_then(|other| {
                let (relation, level_at_entry) = (other.relation.as_ref()?, other.level_at_entry);
                Some(Reference::Measured { relation, level_at_entry })
            });
            measured.or_else(|| key.reference_feed_mm_min.map(Reference::Feed))
        } else {
            None
        };
        let found = compensate(relation, reference, &profile, key.level_at_entry)?;
        let sound = |of: &Estimate| of.value.is_finite() && of.sd.is_finite();
        let all = sound(&found.at_own_feed) && found.at_reference_feed.as_ref().is_none_or(sound);
        all.then_some(found)
    }

    /// Keeps what a counted cycle says beside its ratio as run; returns the larger one of that and the compensated one.
    pub(super) fn remember(
        &mut self,
        at: usize,
        ((number, worked), ratio): ((u64, u64), f64),
        found: Option<Compensated>,
    ) -> f64 {
        let is_reference = self.keys[at].key.strategy == Some(Strategy::FConst);
        let memory = &mut self.feeds;
        if is_reference {
            push(&mut memory.references, (worked, ratio));
            memory.reference_trend.push_at(number, ratio);
        }
        if let Some(found) = found {
            let pair = |of: Estimate| (of.value, of.sd);
            let entry = CompensatedRatio {
                worked,
                own: pair(found.at_own_feed),
                reference: found.at_reference_feed.map(pair),
                sd_at_limit: found.sd_at_limit,
            };
            let deciding = entry.deciding().0;
            memory.compensated_trend.push_at(number, deciding);
            push(&mut memory.compensated, entry);
            return ratio.max(deciding);
        }
        ratio
    }

    /// The level that decides; `None` before anything was counted.
    pub(super) fn decision(&self) -> Option<Decision> {
        let as_run = self.level()?;
        let by_run = |basis| Decision { basis, level: as_run, sd: None, n: self.window().len() };
        let current = self.current_key();
        let strategy = current.and_then(|key| key.key.strategy);
        if !self.feeds.varied && strategy.is_some() {
            return Some(by_run(Some(LevelBasis::AsRun)));
        }
        let known = |found: &Decision| found.sd.is_some_and(|sd| sd <= ENOUGH_SD);
        if !self.feeds.varied {
            let decides = self.by_compensation().filter(known);
            return Some(decides.unwrap_or_else(|| by_run(Some(LevelBasis::AsRun))));
        }
        if let Some(found) = self.by_references().or_else(|| self.by_compensation().filter(known)) {
            return Some(found);
        }
        // Programs whose depth nobody sampled can only be judged as they were run.
        let hidden = strategy == Some(Strategy::FAc)
            || (varies_feed(strategy) && current.is_some_and(|key| key.relation.is_some()));
        Some(by_run((!hidden).then_some(LevelBasis::AsRun)))
    }

    /// The level to carry over to a key that is met now.
    pub(super) fn standing(&self) -> Option<f64> {
        self.decision().map(|decision| decision.level)
    }

    /// What keeps the wear from being told, where something does, with what [`ToolFold::decision`] found.
    pub(super) fn masked(&self, decision: Option<Decision>) -> Option<Masked> {
        let strategy = self.current_key().and_then(|key| key.key.strategy);
        match decision.and_then(|decision| decision.basis) {
            Some(LevelBasis::FeedCompensated | LevelBasis::ReferenceCycles) => None,
            _ if strategy == Some(Strategy::FAc) => Some(Masked::ByControl),
            None if decision.is_some() => Some(Masked::ByFeed),
            Some(LevelBasis::AsRun) | None => None,
        }
    }

    fn by_references(&self) -> Option<Decision> {
        let memory = &self.feeds;
        let age = self.cycles - memory.last_reference?;
        let fresh = match memory.every.map(u64::from) {
            Some(every) => age <= every + every / LATE_REFERENCE.0 + LATE_REFERENCE.1,
            None => age <= OLD_REFERENCE.max(4 * u64::from(self.window)),
        };
        let since = memory.references.partition_point(|(worked, _)| *worked <= self.gap_ended);
        let window = last(&memory.references[since..], self.window);
        if !fresh || window.len() < FEWEST_REFERENCES {
            return None;
        }
        let ratios: Vec<f64> = window.iter().map(|(_, ratio)| *ratio).collect();
        let numbers = window.iter().map(|(worked, _)| *worked);
        Some(Decision {
            basis: Some(LevelBasis::ReferenceCycles),
            level: self.onward(median(&ratios), numbers),
            sd: Some(median_error(&ratios)),
            n: window.len(),
        })
    }

    /// The newest compensated ratios, where they are enough for a level.
    fn compensated_window(&self) -> Option<&[CompensatedRatio]> {
        let window = last(&self.feeds.compensated, self.window);
        (window.len() >= LEAST_RATIOS.min(self.window as usize)).then_some(window)
    }

    /// The compensated level, however uncertain.
    fn by_compensation(&self) -> Option<Decision> {
        let window = self.compensated_window()?;
        let ratios: Vec<f64> = window.iter().map(|entry| entry.deciding().0).collect();
        // What is not known of the relation is common to all of them and does not average out.
        let common: Vec<f64> = window.iter().map(|entry| entry.deciding().1).collect();
        Some(Decision {
            basis: Some(LevelBasis::FeedCompensated),
            level: self.onward(median(&ratios), window.iter().map(|entry| entry.worked)),
            sd: Some(median(&common).hypot(median_error(&ratios))),
            n: window.len(),
        })
    }

    /// A window's median is as old as its middle. The wear so far is taken to go on at its mean rate for that long,
    /// which is exact for steady wear and cautious for wear that slows down. Cycles that did not wear the tool carry nothing on.
    fn onward(&self, level: f64, numbers: impl Iterator<Item = u64>) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "counts of cycles are far below 2^53")]
        let (age, now) =
            (median(&numbers.map(|number| number as f64).collect::<Vec<_>>()), self.worked as f64);
        1.0 + (level - 1.0) * (now / age.max(1.0)).clamp(1.0, MOST_ONWARD)
    }

    /// The level that [`ToolFold::decision`] found, with what it is the median of.
    pub(super) fn level_evidence(&self, decision: Option<Decision>) -> Option<Level> {
        let (decision, window) = (decision?, self.window());
        let told = |level: f64| level.clamp(-MOST_LEVEL, MOST_LEVEL);
        Some(Level {
            as_run: told(self.level()?),
            lowest: told(window.iter().copied().fold(f64::INFINITY, f64::min)),
            highest: told(window.iter().copied().fold(f64::NEG_INFINITY, f64::max)),
            n: u32::try_from(window.len()).unwrap_or(u32::MAX),
            window: self.window,
            decides: decision.basis,
            value: told(decision.level),
            sd: decision.sd.map(told),
        })
    }

    /// What is known beside the ratios as run, with what [`ToolFold::decision`] found.
    pub(super) fn feed_evidence(&self, decision: Option<Decision>) -> FeedEvidence {
        let memory = &self.feeds;
        let window = last(&memory.compensated, self.window);
        let middle = |values: Vec<(f64, f64)>| {
            let (ratios, sds): (Vec<f64>, Vec<f64>) = values.into_iter().unzip();
            (!ratios.is_empty())
                .then(|| Estimate { value: median(&ratios), sd: median(&sds).hypot(median_error(&ratios)) })
        };
        let references = self.by_references();
        FeedEvidence {
            at_own_feed: middle(window.iter().map(|entry| entry.own).collect()),
            at_reference_feed: middle(window.iter().filter_map(|entry| entry.reference).collect()),
            compensated_n: u32::try_from(window.len()).unwrap_or(u32::MAX),
            by_references: references.and_then(|found| Some(Estimate { value: found.level, sd: found.sd? })),
            reference_n: references.map_or(0, |found| u32::try_from(found.n).unwrap_or(u32::MAX)),
            masked: self.masked(decision),
            masked_cycles: memory.masked,
            references: self.reference_cycles(),
        }
    }

    /// Whether the true level may be at the limit although the compensated one is not known to be.
    pub(super) fn may_be_worn(&self) -> bool {
        self.by_compensation().is_some_and(|found| found.level + 2.0 * found.sd.unwrap_or(0.0) >= WORN_LEVEL)
    }

    /// Reference cycles: asked for where the feed varies and compensation would not tell the end of a life precisely.
    fn reference_cycles(&self) -> Option<ReferenceCycles> {
        let memory = &self.feeds;
        let every = memory.every?;
        let newest = self.compensated_window().and_then(<[_]>::last);
        let is_precise = newest.is_some_and(|entry| entry.sd_at_limit <= PRECISE_SD);
        if !memory.ever_varied || is_precise {
            return None;
        }
        let operation = self.current_key().map(|key| &key.key.operation);
        let learnt = self.keys.iter().any(|key| {
            key.key.strategy == Some(Strategy::FConst)
                && key.baseline.is_some()
                && operation.is_none_or(|operation| *operation == key.key.operation)
        });
        let age = memory.last_reference.map(|number| self.cycles - number);
        let due_in = match age {
            Some(age) if learnt => u64::from(every).saturating_sub(age),
            _ => 0,
        };
        Some(ReferenceCycles {
            every,
            due_in,
            learnt,
            feed_mm_min: memory.reference_feed_mm_min,
            count: memory.reference_count,
            age_cycles: age,
        })
    }
}

/// The last so many of a list.
fn last<T>(list: &[T], window: u32) -> &[T] {
    &list[list.len().saturating_sub(window as usize)..]
}

/// Standard error of the median of these.
fn median_error(values: &[f64]) -> f64 {
    let centre = median(values);
    let mut deviations: Vec<f64> = values.iter().map(|value| (value - centre).abs()).collect();
    #[expect(clippy::cast_precision_loss, reason = "at most 63 ratios")]
    let n = values.len() as f64;
    MEDIAN_ERROR * MAD_SIGMA * median_in_place(&mut deviations) / n.sqrt()
}

fn push<T>(ring: &mut Vec<T>, value: T) {
    if ring.len() == KEPT_RATIOS {
        ring.remove(0);
    }
    ring.push(value);
}

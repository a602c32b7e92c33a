//! What a new tool needs over depth and feed: a quantity per depth bin as a power of the feed, with uncertainty.
//!
//! In every bin ln q = a + s·ln(F/F_ref): energy per mm falls with the feed, loads rise with it. The level a is
//! learned from every cycle of the new tool; the slope s only from cycles whose feed was *programmed*. Where a
//! law chose the feed, load and feed are tied by the law itself (a hard piece reads high and is drilled slowly),
//! and a slope through such points would be the law's and not the material's.

mod config;
mod profile;
#[cfg(test)]
mod tests;

pub use config::{MOST_BINS, RelationConfig, RelationParams};
pub use profile::{DepthBin, DepthProfile, Per};

use super::error::finite;

/// Weight of the prior spread, in cycles.
const PRIOR_SPREAD_WEIGHT: f64 = 4.0;

/// Cycles that a bin has to have seen before a new one tells about the spread.
const SPREAD_AFTER: f64 = 2.0;

/// Who chose the feed of a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FeedSource {
    /// A program (or a person): the feed does not depend on the load.
    Programmed,
    /// A law that answers to the load.
    Controlled,
}

/// A value with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard deviation, in the same unit.
    pub sd: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct BinFit {
    count: f64,
    mean_x: f64,
    mean_y: f64,
    programmed: f64,
    programmed_x: f64,
    programmed_y: f64,
    sxx: f64,
    sxy: f64,
}

/// Relative standard deviation of cycles about the relation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// What all bins of a cycle share: a hard piece is hard at every depth.
    pub common: f64,
    /// What each bin has of its own.
    pub own: f64,
}

/// The learned relation. Observing is its only mutation; the same cycles in the same order give the same bits.
#[derive(Debug, Clone, PartialEq)]
pub struct Relation {
    config: RelationConfig,
    bins: Vec<BinFit>,
    cycles: u32,
    common_squares: f64,
    own_squares: f64,
    spread_cycles: f64,
}

impl Relation {
    /// A relation that has seen nothing.
    #[must_use]
    pub fn new(config: RelationConfig) -> Self {
        Self {
            config,
            bins: vec![BinFit::default(); config.bins()],
            cycles: 0,
            common_squares: 0.0,
            own_squares: 0.0,
            spread_cycles: 0.0,
        }
    }

    /// The bins and prior knowledge.
    #[must_use]
    pub const fn config(&self) -> &RelationConfig {
        &self.config
    }

    /// Cycles observed.
    #[must_use]
    pub const fn cycles(&self) -> u32 {
        self.cycles
    }

    /// Learns from one cycle of the new tool; `per` tells what the quantity is per.
    pub fn observe(&mut self, profile: &DepthProfile, per: Per, source: FeedSource) {
        self.learn_spread(profile, per);
        self.cycles = self.cycles.saturating_add(1);
        let reference = self.config.params().reference_feed_mm_min;
        for (fit, bin) in self.bins.iter_mut().zip(&profile.bins) {
            let Some((feed, quantity)) = per.of(bin, self.config.params().bin_mm) else { continue };
            let (x, y) = ((feed / reference).ln(), quantity.ln());
            fit.count += 1.0;
            fit.mean_x += (x - fit.mean_x) / fit.count;
            fit.mean_y += (y - fit.mean_y) / fit.count;
            if source == FeedSource::Programmed {
                fit.programmed += 1.0;
                let (dx, dy) = (x - fit.programmed_x, y - fit.programmed_y);
                fit.programmed_x += dx / fit.programmed;
                fit.programmed_y += dy / fit.programmed;
                fit.sxx += dx * (x - fit.programmed_x);
                fit.sxy += dx * (y - fit.programmed_y);
            }
        }
    }

    /// Compares a cycle with what was known before it: its mean deviation is common to the bins, the rest is the
    /// bins' own.
    fn learn_spread(&mut self, profile: &DepthProfile, per: Per) {
        let spread = self.spread();
        let reference = self.config.params().reference_feed_mm_min;
        let (mut bins, mut mean, mut squares) = (0.0, 0.0, 0.0);
        for (fit, bin) in self.bins.iter().zip(&profile.bins) {
            let Some((feed, quantity)) = per.of(bin, self.config.params().bin_mm) else { continue };
            if fit.count < SPREAD_AFTER {
                continue;
            }
            let slope = self.slope_of(fit, spread).value;
            let known = fit.mean_y + slope * ((feed / reference).ln() - fit.mean_x);
            // A mean of n cycles is itself off by 1/n of the variance.
            let off = (quantity.ln() - known) / (1.0 + 1.0 / fit.count).sqrt();
            bins += 1.0;
            let step = off - mean;
            mean += step / bins;
            squares += step * (off - mean);
        }
        if bins > 2.0 {
            let own = squares / (bins - 1.0);
            self.own_squares += own;
            self.common_squares += (mean * mean - own / bins).max(0.0);
            self.spread_cycles += 1.0;
        }
    }

    /// How far cycles lie off the relation, as learned so far.
    #[must_use]
    pub fn spread(&self) -> Spread {
        let prior = PRIOR_SPREAD_WEIGHT * self.config.params().prior_spread.powi(2) / 2.0;
        let weight = PRIOR_SPREAD_WEIGHT + self.spread_cycles;
        Spread {
            common: ((prior + self.common_squares) / weight).sqrt(),
            own: ((prior + self.own_squares) / weight).sqrt(),
        }
    }

    /// Slope s of a bin.
    #[must_use]
    pub fn slope(&self, bin: usize) -> Option<Estimate> {
        let spread = self.spread();
        self.bins.get(bin).map(|fit| self.slope_of(fit, spread))
    }

    fn slope_of(&self, fit: &BinFit, spread: Spread) -> Estimate {
        let params = self.config.params();
        let prior = 1.0 / (params.prior_slope_sd * params.prior_slope_sd);
        let precision = 1.0 / (spread.common * spread.common + spread.own * spread.own);
        let value = (fit.sxy * precision + params.prior_slope * prior) / (fit.sxx * precision + prior);
        Estimate { value, sd: (1.0 / (fit.sxx * precision + prior)).sqrt() }
    }

    fn predict_bin(&self, bin: usize, feed_mm_min: f64, spread: Spread) -> Option<Prediction> {
        let fit = self.bins.get(bin).filter(|fit| fit.count > 0.0)?;
        let slope = self.slope_of(fit, spread);
        let off = (feed_mm_min / self.config.params().reference_feed_mm_min).ln() - fit.mean_x;
        let total = (fit.mean_y + slope.value * off).exp();
        let root = fit.count.sqrt();
        Some(Prediction {
            total,
            common_sd: total * spread.common / root,
            own_sd: total * spread.own / root,
            slope_sd: total * slope.sd * off.abs(),
        })
    }

    /// The quantity of a new tool in a bin at a feed in mm/min; `None` where no cycle has been.
    #[must_use]
    pub fn at(&self, bin: usize, feed_mm_min: f64) -> Option<Estimate> {
        finite("feed_mm_min", feed_mm_min).ok().filter(|feed| *feed > 0.0)?;
        let known = self.predict_bin(bin, feed_mm_min, self.spread())?;
        Some(Estimate { value: known.total, sd: known.sd() })
    }

    /// The quantity of a new tool at a depth in mm and a feed in mm/min.
    #[must_use]
    pub fn at_depth(&self, depth_mm: f64, feed_mm_min: f64) -> Option<Estimate> {
        self.at(self.config.bin_of(depth_mm)?, feed_mm_min)
    }

    /// Geometric mean of the feeds at which a bin was run, mm/min; `None` where it never was.
    #[must_use]
    pub fn feed_mm_min(&self, bin: usize) -> Option<f64> {
        let fit = self.bins.get(bin).filter(|fit| fit.count > 0.0)?;
        Some(self.config.params().reference_feed_mm_min * fit.mean_x.exp())
    }

    /// What the new tool would need in each bin in which a profile went deeper, at `feed(bin)` mm/min; `None`
    /// where the profile or the relation says nothing.
    pub(crate) fn predict(
        &self,
        profile: &DepthProfile,
        feed: impl Fn(&DepthBin) -> Option<f64>,
    ) -> Vec<Option<Prediction>> {
        self.predict_each(profile, |_, bin| feed(bin))
    }

    /// As [`Relation::predict`], at a feed that may depend on the bin's number.
    pub(crate) fn predict_each(
        &self,
        profile: &DepthProfile,
        feed: impl Fn(usize, &DepthBin) -> Option<f64>,
    ) -> Vec<Option<Prediction>> {
        let spread = self.spread();
        let one = |(index, bin): (usize, &DepthBin)| {
            Per::Depth.of(bin, self.config.params().bin_mm)?;
            Some(self.predict_bin(index, feed(index, bin)?, spread)?.times(bin.way_mm))
        };
        profile.bins.iter().enumerate().map(one).collect()
    }

    /// The state as numbers, for whoever stores it: cycles, the three sums of the spread, and eight numbers for each
    /// bin up to the last that was ever run.
    pub(crate) fn to_parts(&self) -> (u32, [f64; 3], Vec<[f64; 8]>) {
        let used = self.bins.iter().rposition(|bin| bin.count > 0.0).map_or(0, |last| last + 1);
        let bins = self.bins[..used].iter().map(BinFit::parts).collect();
        (self.cycles, [self.common_squares, self.own_squares, self.spread_cycles], bins)
    }

    /// The relation of [`Relation::to_parts`]; `None` where there are more bins than the configuration has.
    pub(crate) fn of_parts(
        config: RelationConfig,
        (cycles, sums, bins): (u32, [f64; 3], Vec<[f64; 8]>),
    ) -> Option<Self> {
        let mut relation = Self::new(config);
        if bins.len() > relation.bins.len() {
            return None;
        }
        for (place, parts) in relation.bins.iter_mut().zip(bins) {
            *place = BinFit::of_parts(parts);
        }
        [relation.common_squares, relation.own_squares, relation.spread_cycles] = sums;
        relation.cycles = cycles;
        Some(relation)
    }
}

impl BinFit {
    const fn parts(&self) -> [f64; 8] {
        [
            self.count,
            self.mean_x,
            self.mean_y,
            self.programmed,
            self.programmed_x,
            self.programmed_y,
            self.sxx,
            self.sxy,
        ]
    }

    const fn of_parts(parts: [f64; 8]) -> Self {
        let [count, mean_x, mean_y, programmed, programmed_x, programmed_y, sxx, sxy] = parts;
        Self { count, mean_x, mean_y, programmed, programmed_x, programmed_y, sxx, sxy }
    }
}

/// What a new tool would need in one bin, and the parts of its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Prediction {
    pub(crate) total: f64,
    pub(crate) common_sd: f64,
    pub(crate) own_sd: f64,
    pub(crate) slope_sd: f64,
}

impl Prediction {
    pub(crate) fn times(self, factor: f64) -> Self {
        Self {
            total: self.total * factor,
            common_sd: self.common_sd * factor,
            own_sd: self.own_sd * factor,
            slope_sd: self.slope_sd * factor,
        }
    }

    /// Adds another bin. What cycles have in common adds up, as do the slopes' errors, which may all lie on one
    /// side; the bins' own errors partly cancel.
    pub(crate) fn plus(self, other: Self) -> Self {
        Self {
            total: self.total + other.total,
            common_sd: self.common_sd + other.common_sd,
            own_sd: self.own_sd.hypot(other.own_sd),
            slope_sd: self.slope_sd + other.slope_sd,
        }
    }

    pub(crate) fn sd(self) -> f64 {
        self.common_sd.hypot(self.own_sd).hypot(self.slope_sd)
    }
}

//! What a new tool needs over depth and feed: a quantity per depth bin as a power of the feed, with uncertainty.
//!
//! In every bin ln q = a + s·ln(F/F_ref): energy per mm falls with the feed, loads rise with it. The level a is
//! learned from every cycle of the new tool; the slope s only from cycles whose feed was *programmed*. Where a
//! law chose the feed, load and feed are tied by the law itself (a hard piece reads high and is drilled slowly),
//! and a slope through such points would be the law's and not the material's.

use super::error::{Invalid, InvalidCode, between, finite, positive};
use super::program::HIGHEST_FEED_MM_MIN;

/// Most depth bins.
pub const MOST_BINS: usize = 512;

/// Weight of the prior spread, in cycles.
const PRIOR_SPREAD_WEIGHT: f64 = 4.0;

/// Cycles that a bin has to have seen before a new one tells about the spread.
const SPREAD_AFTER: f64 = 2.0;

/// Bins and prior knowledge, as plain values; [`RelationConfig::new`] checks them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelationParams {
    /// Width of a depth bin in mm.
    pub bin_mm: f64,
    /// Depth at which the last bin ends, mm.
    pub depth_mm: f64,
    /// Reference feed F_ref in mm/min; only scales the numbers.
    pub reference_feed_mm_min: f64,
    /// Slope that is expected before any cycle was seen.
    pub prior_slope: f64,
    /// Standard deviation of that expectation.
    pub prior_slope_sd: f64,
    /// Relative standard deviation expected of one bin of one cycle.
    pub prior_spread: f64,
}

impl RelationParams {
    /// For energy per depth, which falls with the feed: between E ∝ 1/F (friction alone) and E independent of F.
    #[must_use]
    pub const fn energy(depth_mm: f64) -> Self {
        Self {
            bin_mm: 1.0,
            depth_mm,
            reference_feed_mm_min: 200.0,
            prior_slope: -0.4,
            prior_slope_sd: 0.35,
            prior_spread: 0.03,
        }
    }

    /// For a load over its idle value, which rises with the feed.
    #[must_use]
    pub const fn load(depth_mm: f64) -> Self {
        Self { prior_slope: 0.6, ..Self::energy(depth_mm) }
    }
}

/// Checked bins and prior knowledge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelationConfig {
    params: RelationParams,
    bins: usize,
}

impl RelationConfig {
    /// Checks the parameters.
    ///
    /// # Errors
    /// With the field that is out of range, or when there would be more than 512 bins.
    pub fn new(params: RelationParams) -> Result<Self, Invalid> {
        positive("bin_mm", params.bin_mm, 100.0)?;
        positive("depth_mm", params.depth_mm, 1000.0)?;
        positive("reference_feed_mm_min", params.reference_feed_mm_min, HIGHEST_FEED_MM_MIN)?;
        between("prior_slope", params.prior_slope, -5.0, 5.0)?;
        positive("prior_slope_sd", params.prior_slope_sd, 10.0)?;
        positive("prior_spread", params.prior_spread, 1.0)?;
        let count = (params.depth_mm / params.bin_mm).ceil();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive, saturating")]
        let bins = count as usize;
        if bins == 0 || bins > MOST_BINS {
            let text = format!("{count} bins, at most {MOST_BINS}");
            return Err(Invalid::new("bin_mm", InvalidCode::OutOfRange, text));
        }
        Ok(Self { params, bins })
    }

    /// Number of depth bins.
    #[must_use]
    pub const fn bins(&self) -> usize {
        self.bins
    }

    /// The checked parameters.
    #[must_use]
    pub const fn params(&self) -> &RelationParams {
        &self.params
    }

    /// Depth in the middle of a bin, mm.
    #[must_use]
    pub fn middle_mm(&self, bin: usize) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "at most 512 bins")]
        let bin = bin as f64;
        (bin + 0.5) * self.params.bin_mm
    }

    fn bin_of(&self, depth_mm: f64) -> Option<usize> {
        if depth_mm < 0.0 {
            return None;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "not negative, saturating"
        )]
        let bin = (depth_mm / self.params.bin_mm) as usize;
        (bin < self.bins).then_some(bin)
    }
}

/// What a cycle did in one depth bin.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DepthBin {
    /// Way made in the bin, mm.
    pub way_mm: f64,
    /// Time spent in it, s.
    pub time_s: f64,
    /// The quantity's sum: J for energy, percent·s for a load.
    pub total: f64,
}

impl DepthBin {
    /// Mean feed in mm/min; `None` where the tool never was.
    #[must_use]
    pub fn feed_mm_min(&self) -> Option<f64> {
        (self.time_s > 0.0 && self.way_mm > 0.0).then(|| self.way_mm / self.time_s * 60.0)
    }
}

/// A cycle cut into depth bins.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthProfile {
    bins: Vec<DepthBin>,
}

impl DepthProfile {
    /// An empty profile.
    #[must_use]
    pub fn new(config: &RelationConfig) -> Self {
        Self { bins: vec![DepthBin::default(); config.bins] }
    }

    /// Adds the way from one depth to a deeper one (mm), made in `time_s` with `total` of the quantity.
    ///
    /// A way over several bins is shared between them by length. A step that does not go deeper adds its time
    /// and total to the bin it happens in, without a way.
    pub fn add(&mut self, config: &RelationConfig, from_mm: f64, to_mm: f64, time_s: f64, total: f64) {
        if !(from_mm.is_finite() && to_mm.is_finite() && time_s.is_finite() && total.is_finite()) {
            return;
        }
        let way = to_mm - from_mm;
        if way <= 0.0 {
            if let Some(bin) = config.bin_of(to_mm) {
                self.bins[bin].time_s += time_s;
                self.bins[bin].total += total;
            }
            return;
        }
        let (start, end) = (from_mm.max(0.0), to_mm.min(config.params.depth_mm));
        let mut at = start;
        while let Some(bin) = config.bin_of(at).filter(|_| at < end) {
            #[expect(clippy::cast_precision_loss, reason = "at most 512 bins")]
            let edge = ((bin + 1) as f64 * config.params.bin_mm).min(end);
            // Rounding may leave the edge where we stand.
            let until = if edge > at { edge } else { end };
            let share = (until - at) / way;
            let cell = &mut self.bins[bin];
            cell.way_mm += until - at;
            cell.time_s += share * time_s;
            cell.total += share * total;
            at = until;
        }
    }

    /// A profile from columns: depth in mm, the quantity's sum per sample, and the sample period in s.
    ///
    /// # Errors
    /// When the columns differ in length.
    pub fn from_columns(
        config: &RelationConfig,
        depth_mm: &[f64],
        total_per_sample: &[f64],
        period_s: f64,
    ) -> Result<Self, Invalid> {
        if depth_mm.len() != total_per_sample.len() {
            let text = format!("has {} entries, depth_mm has {}", total_per_sample.len(), depth_mm.len());
            return Err(Invalid::new("total_per_sample", InvalidCode::LengthMismatch, text));
        }
        positive("period_s", period_s, 60.0)?;
        let mut profile = Self::new(config);
        for (pair, total) in depth_mm.windows(2).zip(&total_per_sample[1..]) {
            profile.add(config, pair[0], pair[1], period_s, *total);
        }
        Ok(profile)
    }

    /// The bins, from contact downwards.
    #[must_use]
    pub fn bins(&self) -> &[DepthBin] {
        &self.bins
    }

    /// Sum of the quantity over all bins.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.bins.iter().map(|bin| bin.total).sum()
    }
}

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
            bins: vec![BinFit::default(); config.bins],
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
        let reference = self.config.params.reference_feed_mm_min;
        for (fit, bin) in self.bins.iter_mut().zip(&profile.bins) {
            let Some((feed, quantity)) = per.of(bin, self.config.params.bin_mm) else { continue };
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
        let reference = self.config.params.reference_feed_mm_min;
        let (mut bins, mut mean, mut squares) = (0.0, 0.0, 0.0);
        for (fit, bin) in self.bins.iter().zip(&profile.bins) {
            let Some((feed, quantity)) = per.of(bin, self.config.params.bin_mm) else { continue };
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
        let prior = PRIOR_SPREAD_WEIGHT * self.config.params.prior_spread.powi(2) / 2.0;
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
        let params = &self.config.params;
        let prior = 1.0 / (params.prior_slope_sd * params.prior_slope_sd);
        let precision = 1.0 / (spread.common * spread.common + spread.own * spread.own);
        let value = (fit.sxy * precision + params.prior_slope * prior) / (fit.sxx * precision + prior);
        Estimate { value, sd: (1.0 / (fit.sxx * precision + prior)).sqrt() }
    }

    fn predict_bin(&self, bin: usize, feed_mm_min: f64, spread: Spread) -> Option<Prediction> {
        let fit = self.bins.get(bin).filter(|fit| fit.count > 0.0)?;
        let slope = self.slope_of(fit, spread);
        let off = (feed_mm_min / self.config.params.reference_feed_mm_min).ln() - fit.mean_x;
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

    /// What the new tool would need in each bin in which a profile went deeper, at `feed(bin)` mm/min; `None`
    /// where the profile or the relation says nothing.
    pub(crate) fn predict(
        &self,
        profile: &DepthProfile,
        feed: impl Fn(&DepthBin) -> Option<f64>,
    ) -> Vec<Option<Prediction>> {
        let spread = self.spread();
        let one = |(index, bin): (usize, &DepthBin)| {
            Per::Depth.of(bin, self.config.params.bin_mm)?;
            Some(self.predict_bin(index, feed(bin)?, spread)?.times(bin.way_mm))
        };
        profile.bins.iter().enumerate().map(one).collect()
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

/// What a binned quantity is per.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Per {
    /// Per mm of depth: energy.
    Depth,
    /// Per second, that is a mean: loads.
    Time,
}

impl Per {
    /// Feed in mm/min and the positive quantity of a bin; `None` for one that was only grazed or reads nothing.
    pub(crate) fn of(self, bin: &DepthBin, bin_mm: f64) -> Option<(f64, f64)> {
        let feed = bin.feed_mm_min()?;
        let quantity = match self {
            Self::Depth => bin.total / bin.way_mm,
            Self::Time => bin.total / bin.time_s,
        };
        (bin.way_mm > 0.25 * bin_mm && quantity > 1e-9).then_some((feed, quantity))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::friction::noise::Noise;
    use proptest::prelude::*;

    fn config() -> RelationConfig {
        RelationConfig::new(RelationParams::energy(10.0)).unwrap()
    }

    /// A cycle of a material with q = 50·(F/200)^−0.6 J/mm at every depth, at one feed.
    fn cycle(feed: f64, factor: f64) -> DepthProfile {
        let config = config();
        let mut profile = DepthProfile::new(&config);
        for step in 0..100 {
            let (from, way) = (f64::from(step) * 0.1, 0.1);
            let energy = 50.0 * (feed / 200.0_f64).powf(-0.6) * factor * way;
            profile.add(&config, from, from + way, way / feed * 60.0, energy);
        }
        profile
    }

    #[test]
    fn the_slope_is_learned_from_programmed_feeds_and_its_uncertainty_shrinks() {
        let mut relation = Relation::new(config());
        let mut noise = Noise::seeded(5);
        for _ in 0..4 {
            relation.observe(&cycle(200.0, 1.0 + 0.01 * noise.normal()), Per::Depth, FeedSource::Programmed);
        }
        let before = relation.slope(4).unwrap();
        assert!((before.value + 0.4).abs() < 0.05 && before.sd > 0.3, "one feed says nothing: {before:?}");
        let known = relation.at(4, 200.0).unwrap();
        let guessed = relation.at(4, 600.0).unwrap();
        assert!(known.sd / known.value < 0.03 && guessed.sd / guessed.value > 0.3);
        for feed in [140.0, 300.0, 150.0, 280.0] {
            relation.observe(&cycle(feed, 1.0 + 0.01 * noise.normal()), Per::Depth, FeedSource::Programmed);
        }
        let after = relation.slope(4).unwrap();
        assert!((after.value + 0.6).abs() < 2.0 * after.sd + 0.02 && after.sd < 0.06, "{after:?}");
        let at = relation.at_depth(4.5, 600.0).unwrap();
        assert!((at.value - 50.0 * 3.0_f64.powf(-0.6)).abs() < 2.0 * at.sd);
    }

    #[test]
    fn feeds_that_a_law_chose_teach_the_level_but_not_the_slope() {
        let mut relation = Relation::new(config());
        // Hard pieces drilled slowly at the same load: a fit through them would see a slope of −1.
        for factor in [0.9, 1.0, 1.1] {
            let feed = 200.0 / factor;
            relation.observe(&cycle(feed, factor.powf(0.4)), Per::Depth, FeedSource::Controlled);
        }
        let slope = relation.slope(3).unwrap();
        assert!((slope.value + 0.4).abs() < 1e-9 && (slope.sd - 0.35).abs() < 1e-9);
        assert!(relation.at(3, 200.0).is_some());
    }

    #[test]
    fn what_was_never_seen_is_not_known() {
        let relation = Relation::new(config());
        assert!(relation.at(0, 200.0).is_none() && relation.at_depth(-1.0, 200.0).is_none());
        assert!(relation.slope(99).is_none());
        let refused = RelationParams { bin_mm: 0.001, ..RelationParams::energy(10.0) };
        assert_eq!(RelationConfig::new(refused).unwrap_err().field(), "bin_mm");
    }

    proptest! {
        #[test]
        fn cutting_into_bins_loses_nothing(
            ways in proptest::collection::vec((-0.2..1.5_f64, 0.0..50.0_f64), 1..60),
        ) {
            let config = RelationConfig::new(RelationParams::energy(200.0)).unwrap();
            let mut profile = DepthProfile::new(&config);
            let (mut at, mut total, mut deeper) = (0.0, 0.0, 0.0);
            for (way, energy) in ways {
                let to = f64::max(at + way, 0.0);
                profile.add(&config, at, to, 0.01, energy);
                total += energy;
                deeper += f64::max(to - at, 0.0);
                at = to;
            }
            prop_assert!((profile.total() - total).abs() < 1e-9 * total.max(1.0));
            let way: f64 = profile.bins().iter().map(|bin| bin.way_mm).sum();
            prop_assert!((way - deeper).abs() < 1e-9);
        }
    }
}

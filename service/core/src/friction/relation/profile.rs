//! Cycles cut into depth bins.

use super::config::RelationConfig;
use crate::friction::error::{Invalid, positive, same_length};

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
    pub(super) bins: Vec<DepthBin>,
}

impl DepthProfile {
    /// An empty profile.
    #[must_use]
    pub fn new(config: &RelationConfig) -> Self {
        Self { bins: vec![DepthBin::default(); config.bins()] }
    }

    /// A profile of bins that are known already, from contact downwards; what lies beyond the last bin is dropped.
    #[must_use]
    pub fn of_bins(config: &RelationConfig, bins: impl Iterator<Item = DepthBin>) -> Self {
        let mut profile = Self::new(config);
        for (place, bin) in profile.bins.iter_mut().zip(bins) {
            *place = bin;
        }
        profile
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
        let (start, end) = (from_mm.max(0.0), to_mm.min(config.params().depth_mm));
        let Some(first) = config.bin_of(start) else { return };
        let mut at = start;
        // From bin to bin and not by the depth of the edge: an edge that is no binary fraction may, divided by the width, be
        // rounded into the bin that it ends.
        for (bin, cell) in self.bins.iter_mut().enumerate().skip(first) {
            if at >= end {
                break;
            }
            #[expect(clippy::cast_precision_loss, reason = "at most 512 bins")]
            let until = ((bin + 1) as f64 * config.params().bin_mm).min(end);
            if until > at {
                let share = (until - at) / way;
                cell.way_mm += until - at;
                cell.time_s += share * time_s;
                cell.total += share * total;
                at = until;
            }
        }
    }

    /// Adds every step of a way through `depth_mm`, as [`Self::add`] would; `made` tells the time (s) and the quantity of
    /// the step to a depth.
    pub(crate) fn add_way(
        &mut self,
        config: &RelationConfig,
        depth_mm: &[f64],
        made: impl Fn(usize) -> (f64, f64),
    ) {
        let mut step = 1;
        while step < depth_mm.len() {
            let (time_s, total) = made(step);
            self.add(config, depth_mm[step - 1], depth_mm[step], time_s, total);
            step = self.add_in_one_bin(config, depth_mm, step + 1, &made);
        }
    }

    /// Adds the steps from `first` on that do not leave the bin where it begins, and returns the one after them.
    ///
    /// Most steps are such; they need neither a bin to be found nor a share, which is the whole.
    fn add_in_one_bin(
        &mut self,
        config: &RelationConfig,
        depth_mm: &[f64],
        first: usize,
        made: impl Fn(usize) -> (f64, f64),
    ) -> usize {
        let Some(bin) = config.bin_of(depth_mm[first - 1]) else { return first };
        let end_mm = config.surely_above(bin);
        let mut cell = self.bins[bin];
        let mut from_mm = depth_mm[first - 1];
        let mut step = first;
        for &to_mm in &depth_mm[first..] {
            let (time_s, total) = made(step);
            if !(from_mm <= to_mm && to_mm < end_mm && time_s.is_finite() && total.is_finite()) {
                break;
            }
            cell.way_mm += to_mm - from_mm;
            cell.time_s += time_s;
            cell.total += total;
            from_mm = to_mm;
            step += 1;
        }
        self.bins[bin] = cell;
        step
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
        same_length(&[("depth_mm", depth_mm), ("total_per_sample", total_per_sample)])?;
        positive("period_s", period_s, 60.0)?;
        let mut profile = Self::new(config);
        profile.add_way(config, depth_mm, |step| (period_s, total_per_sample[step]));
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

//! Depth bins and what is expected before any cycle was seen.

use crate::friction::error::{Invalid, InvalidCode, between, positive};
use crate::friction::program::HIGHEST_FEED_MM_MIN;

/// Most depth bins.
pub const MOST_BINS: usize = 512;

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

    /// The bin of a depth; the first above them and the last below them.
    pub(crate) fn nearest_bin(&self, depth_mm: f64) -> usize {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "not negative, saturating"
        )]
        let bin = (depth_mm.max(0.0) / self.params.bin_mm) as usize;
        bin.min(self.bins - 1)
    }

    /// A depth above which everything from the beginning of a bin on lies in that bin, however it is rounded.
    pub(super) fn surely_above(&self, bin: usize) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "at most 512 bins")]
        let edge = (bin + 1) as f64 * self.params.bin_mm;
        edge.min(self.params.depth_mm) * (1.0 - 1e-12)
    }

    pub(super) fn bin_of(&self, depth_mm: f64) -> Option<usize> {
        let inside = depth_mm >= 0.0 && depth_mm <= self.params.depth_mm;
        inside.then(|| self.nearest_bin(depth_mm))
    }
}

//! The curve: feed at a depth, time over a stretch, which section a depth is in.

use super::{Profile, SectionKind, whole};

/// Relative change of feed below which ln(1 + r)/r is taken as 1 − r/2: at 0 it is no number, and what is left out, r²/3,
/// is below 4·10⁻¹³ of the time.
const SERIES_BELOW: f64 = 1e-6;

/// Time in s for `way_mm` while the feed runs linearly in depth from one value to the other (mm/min): ∫dz/F.
#[must_use]
pub fn ramp_time_s(way_mm: f64, from_mm_min: f64, to_mm_min: f64) -> f64 {
    let r = (to_mm_min - from_mm_min) / from_mm_min;
    let factor = if r.abs() < SERIES_BELOW { 1.0 - r / 2.0 } else { libm::log1p(r) / r };
    way_mm / from_mm_min * 60.0 * factor
}

impl Profile {
    /// Where it ends, mm below first contact.
    #[must_use]
    pub fn end_depth_mm(&self) -> f64 {
        whole(self.knots[self.knots.len() - 1].depth)
    }

    /// Feed in mm/min at a depth in mm: before first contact the first knot's, below the end the last one's.
    ///
    /// A depth that is no number gives the slowest feed of the profile: unknown never raises the feed.
    #[must_use]
    pub fn feed_at(&self, depth_mm: f64) -> f64 {
        if depth_mm.is_nan() {
            return self.slowest_mm_min();
        }
        let after = self.knots.partition_point(|knot| whole(knot.depth) <= depth_mm);
        let Some(left) = after.checked_sub(1).map(|at| self.knots[at]) else {
            return whole(self.knots[0].feed);
        };
        let Some(right) = self.knots.get(after) else {
            return whole(left.feed);
        };
        let part = (depth_mm - whole(left.depth)) / whole(right.depth - left.depth);
        whole(left.feed) + part * (whole(right.feed) - whole(left.feed))
    }

    /// Slowest feed, mm/min.
    #[must_use]
    pub fn slowest_mm_min(&self) -> f64 {
        self.knots.iter().map(|knot| knot.feed).min().map_or(0.0, whole)
    }

    /// Fastest feed, mm/min.
    #[must_use]
    pub fn fastest_mm_min(&self) -> f64 {
        self.knots.iter().map(|knot| knot.feed).max().map_or(0.0, whole)
    }

    /// Time from first contact to the end at an override of 100 %, s: ∫dz/F, exact for linear feeds.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        self.time_between_s(0.0, self.end_depth_mm())
    }

    /// Time between two depths in mm, s; what lies outside the profile takes no time, nor does a way back.
    #[must_use]
    pub fn time_between_s(&self, from_mm: f64, to_mm: f64) -> f64 {
        let mut total = 0.0;
        for pair in self.knots.windows(2) {
            let (left, right) = (whole(pair[0].depth), whole(pair[1].depth));
            let (start, end) = (from_mm.max(left), to_mm.min(right));
            if start < end {
                // At a knot its own feed, so that whole pieces are exact.
                let at = |depth: f64, knot: f64, feed| {
                    if depth.to_bits() == knot.to_bits() { whole(feed) } else { self.feed_at(depth) }
                };
                let from = at(start, left, pair[0].feed);
                total += ramp_time_s(end - start, from, at(end, right, pair[1].feed));
            }
        }
        total
    }

    /// The section that a depth in mm is in: a border belongs to the upper one; `None` outside the profile.
    #[must_use]
    pub fn section_at(&self, depth_mm: f64) -> Option<SectionKind> {
        if depth_mm.is_nan() || depth_mm < 0.0 {
            return None;
        }
        self.sections.iter().find(|section| depth_mm <= whole(section.to)).map(|section| section.kind)
    }
}

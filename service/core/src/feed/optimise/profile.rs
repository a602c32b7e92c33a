//! A piecewise-linear feed over depth, as the optimiser sees it.

use super::grid::Grid;
use super::settings::Settings;
use crate::friction::error::{Invalid, InvalidCode, between, positive};
use crate::friction::program::{HIGHEST_FEED_MM_MIN, Knot, MOST_KNOTS};

/// Rounding that is forgiven in comparisons of feeds and accelerations, relative.
const ROUNDING: f64 = 1e-9;

/// Knots of a piecewise-linear feed: depths strictly increasing, feeds above 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Knots(Vec<Knot>);

impl Knots {
    /// Checks order and ranges; 1 to 256 knots.
    ///
    /// # Errors
    /// With the path of the refused knot.
    pub fn new(knots: Vec<Knot>) -> Result<Self, Invalid> {
        if knots.is_empty() {
            return Err(Invalid::new("knots", InvalidCode::Empty, "needs at least one knot"));
        }
        if knots.len() > MOST_KNOTS {
            let text = format!("at most {MOST_KNOTS} knots, not {}", knots.len());
            return Err(Invalid::new("knots", InvalidCode::TooMany, text));
        }
        for (index, knot) in knots.iter().enumerate() {
            let here = |error: Invalid| error.within(&format!("knots[{index}]"));
            between("depth_mm", knot.depth_mm, -1000.0, 1000.0).map_err(here)?;
            positive("feed_mm_min", knot.feed_mm_min, HIGHEST_FEED_MM_MIN).map_err(here)?;
            if index > 0 && knot.depth_mm <= knots[index - 1].depth_mm {
                let text = "must be greater than the depth of the knot before";
                return Err(here(Invalid::new("depth_mm", InvalidCode::NotIncreasing, text)));
            }
        }
        Ok(Self(knots))
    }

    /// Two knots that are known to be in order.
    pub(super) fn of_two(knots: [Knot; 2]) -> Self {
        Self(knots.to_vec())
    }

    /// The knots in order of depth.
    #[must_use]
    pub fn as_slice(&self) -> &[Knot] {
        &self.0
    }

    /// Feed in mm/min at a depth in mm; before the first knot its feed, after the last one that one's.
    #[must_use]
    pub fn feed_at(&self, depth_mm: f64) -> f64 {
        feed_at(&self.0, depth_mm)
    }

    /// Feeds at the nodes, mm/min.
    pub(crate) fn on(&self, grid: &Grid) -> Vec<f64> {
        (0..grid.count()).map(|node| self.feed_at(grid.depth_mm(node))).collect()
    }

    pub(super) fn check(&self, settings: &Settings) -> Result<(), Invalid> {
        let knots = &self.0;
        if knots.len() > settings.most_knots {
            let text = format!("{} knots, at most {}", knots.len(), settings.most_knots);
            return Err(Invalid::new("knots", InvalidCode::TooMany, text));
        }
        let covers = knots[0].depth_mm <= 0.0 && knots[knots.len() - 1].depth_mm >= settings.depth_mm - 1e-6;
        if !covers {
            let text = format!("must cover 0 to {} mm", settings.depth_mm);
            return Err(Invalid::new("knots", InvalidCode::Inconsistent, text));
        }
        for (index, knot) in knots.iter().enumerate() {
            let (low, high) = (settings.feed_min_mm_min, settings.feed_max_mm_min);
            if knot.feed_mm_min < low * (1.0 - ROUNDING) || knot.feed_mm_min > high * (1.0 + ROUNDING) {
                let text = format!("must be between {low} and {high}, not {}", knot.feed_mm_min);
                let field = format!("knots[{index}].feed_mm_min");
                return Err(Invalid::new(field, InvalidCode::OutOfRange, text));
            }
        }
        for (index, pair) in knots.windows(2).enumerate() {
            let needed = acceleration_mm_s2(pair[0], pair[1]);
            if needed > settings.acceleration_mm_s2 * (1.0 + ROUNDING) {
                let text =
                    format!("needs {needed:.1} mm/s², the axis reaches {}", settings.acceleration_mm_s2);
                let field = format!("knots[{}]", index + 1);
                return Err(Invalid::new(field, InvalidCode::OutOfRange, text));
            }
        }
        Ok(())
    }
}

/// Largest acceleration between two knots in mm/s²: v·dv/dz at the faster one.
#[must_use]
pub fn acceleration_mm_s2(from: Knot, to: Knot) -> f64 {
    let (v, w) = (from.feed_mm_min / 60.0, to.feed_mm_min / 60.0);
    v.max(w) * (w - v).abs() / (to.depth_mm - from.depth_mm)
}

pub(super) fn feed_at(knots: &[Knot], depth_mm: f64) -> f64 {
    let after = knots.partition_point(|knot| knot.depth_mm <= depth_mm);
    if after == 0 {
        return knots[0].feed_mm_min;
    }
    let left = knots[after - 1];
    knots.get(after).map_or(left.feed_mm_min, |right| {
        let part = (depth_mm - left.depth_mm) / (right.depth_mm - left.depth_mm);
        left.feed_mm_min + part * (right.feed_mm_min - left.feed_mm_min)
    })
}

//! Machines: what their percent loads refer to, their limits and fitted lines.

use crate::ids::MachineId;
use crate::invalid::{Range, Violation};

/// Feed rates that any machine could have.
pub const FEED_RANGE: Range = Range::new(0.0, 1_000_000.0, "mm/min");
/// Overrides that any control could report; FANUC ends at 254 %.
pub const OVERRIDE_RANGE: Range = Range::new(0.0, 1_000.0, "%");
/// Rated powers.
pub const POWER_RANGE: Range = Range::new(1.0, 10_000_000.0, "W");
/// Rated thrusts.
pub const THRUST_RANGE: Range = Range::new(1.0, 10_000_000.0, "N");
/// Spindle speeds.
pub const SPEED_RANGE: Range = Range::new(0.0, 1_000_000.0, "rpm");
/// Interpolator cycles.
pub const IPO_RANGE: Range = Range::new(0.01, 10_000.0, "ms");

/// Interpolator cycle of a machine of which nothing is known, ms: that of most controls, and nothing is decided by it.
const UNKNOWN_IPO_PERIOD_MS: f64 = 8.0;

/// Slopes of fitted lines, N or N·m per percent.
pub const SLOPE_RANGE: Range = Range::new(-1_000_000.0, 1_000_000.0, "(N/% or N·m/%)");
/// Intercepts of fitted lines, N or N·m.
pub const INTERCEPT_RANGE: Range = Range::new(-10_000_000.0, 10_000_000.0, "(N or N·m)");
/// Spreads of what fitted lines leave, N or N·m; not negative.
pub const SPREAD_RANGE: Range = Range::new(0.0, 10_000_000.0, "(N or N·m)");
/// Shares of the variance that fitted lines explain.
pub const R_SQUARED_RANGE: Range = Range::new(0.0, 1.0, "");

/// What a load in percent refers to. "% of a rating" means nothing without it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LoadReference {
    /// Not declared: no joules can be computed from loads.
    #[default]
    Unknown,
    /// Percent of the rated power.
    RatedPower,
    /// Percent of the continuous (S1) rating, which follows the torque below the base speed.
    ContinuousRating,
    /// Percent of the rated torque.
    RatedTorque,
    /// Percent of the maximum drive current.
    MaximumCurrent,
}

impl LoadReference {
    /// Every reference, in the order of the enum.
    pub const ALL: [Self; 5] =
        [Self::Unknown, Self::RatedPower, Self::ContinuousRating, Self::RatedTorque, Self::MaximumCurrent];

    /// The word used in the API and in storage.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::RatedPower => "rated_power",
            Self::ContinuousRating => "continuous_rating",
            Self::RatedTorque => "rated_torque",
            Self::MaximumCurrent => "maximum_current",
        }
    }

    /// The reference of that word.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|reference| reference.as_str() == text)
    }

    /// Whether the percent follows torque or current, so that power falls with speed below the base speed.
    pub const fn follows_torque(self) -> bool {
        matches!(self, Self::ContinuousRating | Self::RatedTorque | Self::MaximumCurrent)
    }
}

/// What the spindle's load refers to and the rated values.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SpindleRating {
    /// What 100 % is.
    pub reference: LoadReference,
    /// Power at 100 % load at or above the base speed, W.
    pub rated_power_watts: Option<f64>,
    /// Speed below which power falls in proportion to speed at constant torque, rpm.
    pub base_speed_rpm: Option<f64>,
}

impl SpindleRating {
    /// Power that one percent of load stands for at a speed, W; `None` where the ratings or the speed do not tell it.
    #[must_use]
    pub fn watts_per_percent(&self, speed_rpm: Option<f64>) -> Option<f64> {
        let rated = self.rated_power_watts.filter(|_| self.reference != LoadReference::Unknown)?;
        let share =
            if self.reference.follows_torque() { (speed_rpm? / self.base_speed_rpm?).min(1.0) } else { 1.0 };
        Some(rated * share / 100.0)
    }
}

/// What the feed drive's load refers to and the rated values. Its percent is a force.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FeedDriveRating {
    /// What 100 % is.
    pub reference: LoadReference,
    /// Thrust at 100 % load, N.
    pub rated_thrust_newtons: Option<f64>,
}

/// Limits that no recommendation leaves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeedLimits {
    min_mm_min: f64,
    max_mm_min: f64,
    override_min_percent: f64,
    override_max_percent: f64,
}

impl FeedLimits {
    /// The same, held within other limits; its own feeds where the two have none in common. They may have a single one.
    #[must_use]
    pub fn within(&self, feeds_mm_min: (f64, f64), overrides_percent: (f64, f64)) -> Self {
        let (min_mm_min, max_mm_min) =
            (self.min_mm_min.max(feeds_mm_min.0), self.max_mm_min.min(feeds_mm_min.1));
        let feeds = if min_mm_min <= max_mm_min {
            (min_mm_min, max_mm_min)
        } else {
            (self.min_mm_min, self.max_mm_min)
        };
        Self {
            min_mm_min: feeds.0,
            max_mm_min: feeds.1,
            override_min_percent: self.override_min_percent.max(overrides_percent.0),
            override_max_percent: self.override_max_percent.min(overrides_percent.1),
        }
    }

    /// Limits that were [held within](Self::within) others, as they are stored; `None` where they can be none.
    pub fn held(feeds_mm_min: (f64, f64), overrides_percent: (f64, f64)) -> Option<Self> {
        let ((min, max), (low, high)) = (feeds_mm_min, overrides_percent);
        let is_feed = |feed| FEED_RANGE.check("feed", feed).is_ok();
        let feeds = is_feed(min) && is_feed(max) && min <= max;
        let overrides =
            OVERRIDE_RANGE.check("override", high).is_ok() && low > 0.0 && low <= 100.0 && high >= 100.0;
        (feeds && overrides).then_some(Self {
            min_mm_min: min,
            max_mm_min: max,
            override_min_percent: low,
            override_max_percent: high,
        })
    }

    /// Checks that the feed range is not empty and that the override range holds 100 %.
    pub fn new(
        min_mm_min: f64,
        max_mm_min: f64,
        override_min_percent: f64,
        override_max_percent: f64,
    ) -> Result<Self, Vec<Violation>> {
        let mut wrong = Vec::new();
        let feed_min = FEED_RANGE.collect("limits.feed_min_mm_min", min_mm_min, &mut wrong);
        let feed_max = FEED_RANGE.collect("limits.feed_max_mm_min", max_mm_min, &mut wrong);
        let low = OVERRIDE_RANGE.collect("limits.override_min_percent", override_min_percent, &mut wrong);
        let high = OVERRIDE_RANGE.collect("limits.override_max_percent", override_max_percent, &mut wrong);
        if let (Some(min), Some(max)) = (feed_min, feed_max)
            && (min >= max)
        {
            wrong.push(Violation::new(
                "limits.feed_max_mm_min",
                "empty_range",
                format!("must be above feed_min_mm_min ({min}), is {max}"),
            ));
        }
        for (path, holds) in [
            ("limits.override_min_percent", low.is_none_or(|low| low > 0.0 && low <= 100.0)),
            ("limits.override_max_percent", high.is_none_or(|high| high >= 100.0)),
        ] {
            if !holds {
                wrong.push(Violation::new(
                    path,
                    "override_range",
                    "the override range must begin above 0 and contain 100 %",
                ));
            }
        }
        match (feed_min, feed_max, low, high) {
            (Some(min_mm_min), Some(max_mm_min), Some(low), Some(high)) if wrong.is_empty() => {
                Ok(Self { min_mm_min, max_mm_min, override_min_percent: low, override_max_percent: high })
            }
            _ => Err(wrong),
        }
    }

    /// Slowest feed, mm/min.
    pub const fn min_mm_min(&self) -> f64 {
        self.min_mm_min
    }

    /// Fastest feed, mm/min.
    pub const fn max_mm_min(&self) -> f64 {
        self.max_mm_min
    }

    /// Lowest override, %.
    pub const fn override_min_percent(&self) -> f64 {
        self.override_min_percent
    }

    /// Highest override, %.
    pub const fn override_max_percent(&self) -> f64 {
        self.override_max_percent
    }
}

/// A robust line `y = slope·load + intercept` with the range it was fitted in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedLine {
    /// Rise per percent of load, N/% or N·m/%.
    pub slope: f64,
    /// Value at no load, N or N·m.
    pub intercept: f64,
    /// Lowest load seen when fitting, %.
    pub min_percent: f64,
    /// Highest load seen when fitting, %.
    pub max_percent: f64,
    /// Coefficient of determination, 0 to 1.
    pub r_squared: f64,
    /// Robust standard deviation of the residuals, N or N·m.
    pub residual_spread: f64,
}

impl FittedLine {
    /// Holds what makes the line against what can be stored of one; `name` is where it stands in the input.
    pub fn collect(&self, name: &str, wrong: &mut Vec<Violation>) {
        for (field, range, value) in [
            ("slope", SLOPE_RANGE, self.slope),
            ("intercept", INTERCEPT_RANGE, self.intercept),
            ("r_squared", R_SQUARED_RANGE, self.r_squared),
            ("residual_spread", SPREAD_RANGE, self.residual_spread),
        ] {
            range.collect(&format!("{name}.{field}"), value, wrong);
        }
    }

    /// The value at `load_percent`, or `None` more than a tenth of the fitted span beyond its upper end.
    ///
    /// Below the fitted range the line runs on to no load and never below zero: an idling drive neither
    /// pushes nor turns the tool.
    pub fn at(&self, load_percent: f64) -> Option<f64> {
        let span = self.max_percent - self.min_percent;
        (load_percent <= self.max_percent + 0.1 * span)
            .then(|| (self.slope * load_percent + self.intercept).max(0.0))
    }
}

/// Fitted lines of one machine (Stryczek & Błaszczak 2020, Fig. 10 and 11), one version of them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Calibration {
    /// Version, counted from 1.
    pub version: u32,
    /// Thrust over feed-drive load.
    pub thrust: Option<FittedLine>,
    /// Torque over spindle load.
    pub torque: Option<FittedLine>,
}

/// A machine as it is registered.
#[derive(Debug, Clone, PartialEq)]
pub struct Machine {
    /// Its name in every path.
    pub id: MachineId,
    /// What people call it.
    pub name: String,
    /// Kind of control, as in `sinumerik-840d`.
    pub control: String,
    /// Interpolator (IPO) cycle, ms.
    pub ipo_period_ms: f64,
    /// The spindle's rating.
    pub spindle: SpindleRating,
    /// The feed drive's rating.
    pub feed_drive: FeedDriveRating,
    /// Limits that no recommendation leaves.
    pub limits: FeedLimits,
}

impl Machine {
    /// A machine of which nothing is known but its name: no load tells anything, and nobody may leave 100 % of the programmed feed.
    #[must_use]
    pub fn unknown(id: MachineId) -> Self {
        let limits = FeedLimits {
            min_mm_min: FEED_RANGE.min,
            max_mm_min: FEED_RANGE.max,
            override_min_percent: 100.0,
            override_max_percent: 100.0,
        };
        Self {
            name: id.as_str().to_owned(),
            id,
            control: String::new(),
            ipo_period_ms: UNKNOWN_IPO_PERIOD_MS,
            spindle: SpindleRating::default(),
            feed_drive: FeedDriveRating::default(),
            limits,
        }
    }

    /// Checks the ratings and the IPO period; limits are valid by their type.
    pub fn validated(self) -> Result<Self, Vec<Violation>> {
        let mut wrong = Vec::new();
        IPO_RANGE.collect("ipo_period_ms", self.ipo_period_ms, &mut wrong);
        for (path, range, value) in [
            ("spindle.rated_power_watts", POWER_RANGE, self.spindle.rated_power_watts),
            ("spindle.base_speed_rpm", SPEED_RANGE, self.spindle.base_speed_rpm),
            ("feed_drive.rated_thrust_newtons", THRUST_RANGE, self.feed_drive.rated_thrust_newtons),
        ] {
            if let Some(value) = value {
                range.collect(path, value, &mut wrong);
            }
        }
        if self.spindle.base_speed_rpm == Some(0.0) {
            wrong.push(Violation::new("spindle.base_speed_rpm", "out_of_range", "must be above 0 rpm"));
        }
        if wrong.is_empty() { Ok(self) } else { Err(wrong) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_must_hold_the_neutral_override() {
        assert!(FeedLimits::new(1.0, 1000.0, 5.0, 200.0).is_ok());
        for (low, high) in [(0.0, 200.0), (101.0, 200.0), (5.0, 99.0), (f64::NAN, 200.0)] {
            assert!(FeedLimits::new(1.0, 1000.0, low, high).is_err(), "{low} {high}");
        }
        assert_eq!(FeedLimits::new(10.0, 10.0, 5.0, 200.0).unwrap_err()[0].code, "empty_range");
    }

    #[test]
    fn a_line_is_not_extrapolated_upwards() {
        let line = FittedLine {
            slope: 20.0,
            intercept: -50.0,
            min_percent: 5.0,
            max_percent: 45.0,
            r_squared: 0.99,
            residual_spread: 5.0,
        };
        assert_eq!(line.at(10.0), Some(150.0));
        assert_eq!(line.at(0.0), Some(0.0));
        assert_eq!(line.at(49.0), Some(930.0));
        assert_eq!(line.at(49.1), None);
    }
}

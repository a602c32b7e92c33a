//! The feed override, and the only type that can carry one out of the core.
//!
//! What does not belong here: how an override is chosen. Whatever chooses one has to pass through
//! [`OverrideBounds::clamp`], so that no law, however wrong, can leave the machine's or the profile's limits.

use super::error::{Invalid, InvalidCode, finite};
use crate::shown::Shown;

/// No control takes more: FANUC's override ends at 254 %, SINUMERIK's at 200 %.
pub const HIGHEST_OVERRIDE_PERCENT: f64 = 255.0;

/// The neutral override: the programmed feed.
pub const NEUTRAL_PERCENT: f64 = 100.0;

/// A permitted range of overrides, in percent; always contains 100.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OverrideRange {
    min: f64,
    max: f64,
}

impl OverrideRange {
    /// Checks a range `0 < min ≤ 100 ≤ max ≤ 255`, in percent.
    ///
    /// Zero is refused because it is a feed hold on every control, and a negative override runs the path
    /// backwards on some: neither is a feed.
    ///
    /// # Errors
    /// When a limit is not finite or outside that range.
    pub fn new(min_percent: f64, max_percent: f64) -> Result<Self, Invalid> {
        finite("min_percent", min_percent)?;
        finite("max_percent", max_percent)?;
        if !(min_percent > 0.0 && min_percent <= NEUTRAL_PERCENT) {
            let text = format!("must be above 0 and at most 100, not {}", Shown(min_percent));
            return Err(Invalid::new("min_percent", InvalidCode::OutOfRange, text));
        }
        if !(NEUTRAL_PERCENT..=HIGHEST_OVERRIDE_PERCENT).contains(&max_percent) {
            let text =
                format!("must be between 100 and {HIGHEST_OVERRIDE_PERCENT}, not {}", Shown(max_percent));
            return Err(Invalid::new("max_percent", InvalidCode::OutOfRange, text));
        }
        Ok(Self { min: min_percent, max: max_percent })
    }

    /// Lower limit in percent.
    #[must_use]
    pub const fn min_percent(&self) -> f64 {
        self.min
    }

    /// Upper limit in percent.
    #[must_use]
    pub const fn max_percent(&self) -> f64 {
        self.max
    }
}

/// The limits that hold for one operation on one machine: the machine's and the profile's together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OverrideBounds {
    machine: OverrideRange,
    profile: OverrideRange,
}

/// Which limit acted on an override.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clamp {
    /// The profile's lower limit.
    ProfileMin,
    /// The profile's upper limit.
    ProfileMax,
    /// The machine's lower limit, which is the tighter one.
    MachineMin,
    /// The machine's upper limit, which is the tighter one.
    MachineMax,
    /// The wish was not a number; the answer is neutral.
    NotFinite,
}

impl OverrideBounds {
    /// The limits of a machine and of a profile; both contain 100, so they always have a range in common.
    #[must_use]
    pub const fn new(machine: OverrideRange, profile: OverrideRange) -> Self {
        Self { machine, profile }
    }

    /// The profile's range, whose upper limit is OVR_max of the law.
    #[must_use]
    pub const fn profile(&self) -> OverrideRange {
        self.profile
    }

    /// The range in which every override of these bounds lies.
    #[must_use]
    pub fn effective(&self) -> OverrideRange {
        OverrideRange {
            min: self.machine.min.max(self.profile.min),
            max: self.machine.max.min(self.profile.max),
        }
    }

    /// The override nearest to `wish_percent` inside the bounds, and the limit that acted, if one did.
    ///
    /// A wish that is not a number gives the neutral override.
    #[must_use]
    pub fn clamp(&self, wish_percent: f64) -> (FeedOverride, Option<Clamp>) {
        if wish_percent.is_nan() {
            return (FeedOverride::NEUTRAL, Some(Clamp::NotFinite));
        }
        let range = self.effective();
        let acted = if wish_percent > range.max {
            Some(if self.machine.max < self.profile.max { Clamp::MachineMax } else { Clamp::ProfileMax })
        } else if wish_percent < range.min {
            Some(if self.machine.min > self.profile.min { Clamp::MachineMin } else { Clamp::ProfileMin })
        } else {
            None
        };
        (FeedOverride(wish_percent.clamp(range.min, range.max)), acted)
    }
}

/// A feed override in percent that lies within the bounds it was made for.
///
/// There is no other way to make one than [`OverrideBounds::clamp`] and the constant for neutral, which every
/// bounds contain.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct FeedOverride(f64);

impl FeedOverride {
    /// Exactly 100 % of the programmed feed.
    pub const NEUTRAL: Self = Self(NEUTRAL_PERCENT);

    /// The override in percent of the programmed feed.
    #[must_use]
    pub const fn percent(self) -> f64 {
        self.0
    }

    /// Neutral in a running cycle: the lower of 100 % and the override in force, for unknown load never raises
    /// the feed.
    #[must_use]
    pub const fn neutral_from(self) -> Self {
        if self.0 > NEUTRAL_PERCENT { Self::NEUTRAL } else { self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bounds(machine: (f64, f64), profile: (f64, f64)) -> OverrideBounds {
        OverrideBounds::new(
            OverrideRange::new(machine.0, machine.1).unwrap(),
            OverrideRange::new(profile.0, profile.1).unwrap(),
        )
    }

    #[test]
    fn a_range_without_100_or_with_0_is_refused() {
        assert_eq!(OverrideRange::new(0.0, 120.0).unwrap_err().field(), "min_percent");
        assert_eq!(OverrideRange::new(-5.0, 120.0).unwrap_err().code(), InvalidCode::OutOfRange);
        assert_eq!(OverrideRange::new(5.0, 99.0).unwrap_err().field(), "max_percent");
        assert_eq!(OverrideRange::new(101.0, 120.0).unwrap_err().field(), "min_percent");
        assert_eq!(OverrideRange::new(5.0, f64::INFINITY).unwrap_err().code(), InvalidCode::NotFinite);
    }

    #[test]
    fn the_tighter_limit_is_named() {
        let both = bounds((10.0, 120.0), (5.0, 200.0));
        assert_eq!(both.clamp(180.0).1, Some(Clamp::MachineMax));
        assert_eq!(both.clamp(1.0).1, Some(Clamp::MachineMin));
        let profile = bounds((1.0, 254.0), (5.0, 200.0));
        assert_eq!(profile.clamp(f64::INFINITY).1, Some(Clamp::ProfileMax));
        assert_eq!(profile.clamp(f64::NEG_INFINITY).1, Some(Clamp::ProfileMin));
        assert_eq!(profile.clamp(f64::NAN), (FeedOverride::NEUTRAL, Some(Clamp::NotFinite)));
        assert_eq!(profile.clamp(99.0).1, None);
    }

    proptest! {
        #[test]
        fn no_wish_leaves_either_limit(
            wish in proptest::num::f64::ANY,
            low in (0.1..100.0_f64, 0.1..100.0_f64), high in (100.0..255.0_f64, 100.0..255.0_f64),
        ) {
            let bounds = bounds((low.0, high.0), (low.1, high.1));
            let (given, _) = bounds.clamp(wish);
            prop_assert!(given.percent() >= low.0.max(low.1) && given.percent() <= high.0.min(high.1));
        }
    }
}

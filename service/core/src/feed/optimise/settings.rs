//! What a profile has to keep and what it is for.

use super::profile::Knots;
use super::recording::WEAR_RATIOS;
use crate::friction::error::{Invalid, InvalidCode, between, positive};
use crate::friction::program::HIGHEST_FEED_MM_MIN;

/// Most knots that may be asked for.
pub const MOST_PROFILE_KNOTS: usize = 64;

/// Usual number of knots: what fits on a page and into a control's block buffer.
pub const USUAL_PROFILE_KNOTS: usize = 20;

/// Stage A at the tool maker's feed: too fast means not enough heat and grooves in the cone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heating {
    /// The tool maker's feed, mm/min; heating never runs faster.
    pub feed_mm_min: f64,
    /// Depth at which heating ends, mm.
    pub until_mm: f64,
    /// Whether heating may end where the feed-drive load has clearly passed its maximum, if that comes earlier
    /// (Stryczek & Błaszczak 2020, section 4.2).
    pub may_shorten: bool,
}

impl Heating {
    /// Heating for a time at the tool maker's feed, as the paper's 2 s.
    #[must_use]
    pub fn for_time(feed_mm_min: f64, time_s: f64) -> Self {
        Self { feed_mm_min, until_mm: feed_mm_min / 60.0 * time_s, may_shorten: false }
    }
}

/// The last part of the bushing, where a fast feed makes petals and cracks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bushing {
    /// Where it begins, mm.
    pub from_mm: f64,
    /// Where it ends, mm.
    pub to_mm: f64,
    /// Largest feed in it, mm/min.
    pub feed_mm_min: f64,
}

/// What is minimised.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Objective {
    /// Time from contact to the end of the path.
    Time,
    /// The spindle's work, with what it idles with for as long as the hole takes. Idling asks for a faster feed, a load
    /// that grows faster than the feed for a slower one: between them lies the minimum.
    Energy,
    /// `per_second` × time + `per_percent_second` × spindle load over idle × time.
    Cost {
        /// Cost of a second, in any unit.
        per_second: f64,
        /// Cost of one percent of spindle load over idle for one second, in the same unit.
        per_percent_second: f64,
    },
}

impl Objective {
    /// Weights of a second and of a percent-second over the spindle's idle load, percent.
    pub(crate) fn weights(self, idle_percent: f64) -> (f64, f64) {
        match self {
            Self::Time => (1.0, 0.0),
            Self::Energy => (idle_percent.max(0.0), 1.0),
            Self::Cost { per_second, per_percent_second } => (per_second, per_percent_second),
        }
    }
}

/// What a profile has to keep, as plain values; [`Settings::new`] checks them.
#[derive(Debug, Clone, PartialEq)]
pub struct SettingsParams {
    /// The operation; cycles of another one are not used.
    pub operation: String,
    /// Depth at which the path ends, mm below first contact.
    pub depth_mm: f64,
    /// Set load L_set of the feed drive, percent.
    pub set_feed_drive_percent: f64,
    /// Set load L_set of the spindle drive, percent.
    pub set_spindle_percent: f64,
    /// Smallest feed, mm/min.
    pub feed_min_mm_min: f64,
    /// Largest feed, mm/min.
    pub feed_max_mm_min: f64,
    /// Largest acceleration of the feed axis, mm/s².
    pub acceleration_mm_s2: f64,
    /// Stage A; `None` where the tool maker asks for nothing.
    pub heating: Option<Heating>,
    /// The last part of the bushing; `None` where nothing is asked for.
    pub bushing: Option<Bushing>,
    /// Override at which the profile will run at most, percent. Loads are kept at the feed times this.
    pub override_percent: f64,
    /// Probability with which, at each depth, the expected load is at or below L_set; 0.5 to 0.999.
    pub confidence: f64,
    /// How far above L_set a load may be for longer than `tolerated_overload_s` in one cycle of a hundred; 0.05 is 5 %.
    pub tolerance_ratio: f64,
    /// Overload beyond the tolerance that is no overload yet, s.
    pub tolerated_overload_s: f64,
    /// Largest feed over that of the last tried profile at the same depth.
    pub raise_ratio: f64,
    /// Smallest feed over that of the last tried profile to which a limit on the *load* lowers it in one step; other
    /// limits lower it as far as they say.
    pub lower_ratio: f64,
    /// What is minimised.
    pub objective: Objective,
    /// Most knots.
    pub most_knots: usize,
    /// Idle loads of feed drive and spindle, percent; `None` takes them from the cycles.
    pub idle_percent: Option<[f64; 2]>,
    /// Watts that one percent of spindle load stands for; without it energy is told in percent-seconds only.
    pub watts_per_percent: Option<f64>,
    /// Wear at which the profile has to hold, as energy over that of the new tool (1 new, 1.1 worn); `None` is the wear
    /// of the latest cycle.
    pub wear_ratio: Option<f64>,
    /// Factor on every standard deviation, from how earlier predictions turned out ([`super::calibrate`]); 1 without.
    pub spread_scale: f64,
}

impl SettingsParams {
    /// Usual values for an operation of this depth and these set loads: feeds of 5 to 1000 mm/min, 300 mm/s², 90 %
    /// confidence, 5 % for 50 ms tolerated, steps of half to double, 20 knots, time.
    #[must_use]
    pub fn new(
        operation: impl Into<String>,
        depth_mm: f64,
        feed_drive_percent: f64,
        spindle_percent: f64,
    ) -> Self {
        Self {
            operation: operation.into(),
            depth_mm,
            set_feed_drive_percent: feed_drive_percent,
            set_spindle_percent: spindle_percent,
            feed_min_mm_min: 5.0,
            feed_max_mm_min: 1000.0,
            acceleration_mm_s2: 300.0,
            heating: None,
            bushing: None,
            override_percent: 100.0,
            confidence: 0.9,
            tolerance_ratio: 0.05,
            tolerated_overload_s: 0.05,
            raise_ratio: 2.0,
            lower_ratio: 0.35,
            objective: Objective::Time,
            most_knots: USUAL_PROFILE_KNOTS,
            idle_percent: None,
            watts_per_percent: None,
            wear_ratio: None,
            spread_scale: 1.0,
        }
    }
}

/// Checked settings.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings(SettingsParams);

impl std::ops::Deref for Settings {
    type Target = SettingsParams;
    fn deref(&self) -> &SettingsParams {
        &self.0
    }
}

impl Settings {
    /// Checks every value.
    ///
    /// # Errors
    /// With the path of the first value that is out of range or contradicts another.
    pub fn new(params: SettingsParams) -> Result<Self, Invalid> {
        let p = &params;
        positive("depth_mm", p.depth_mm, 1000.0)?;
        between("set_feed_drive_percent", p.set_feed_drive_percent, 0.1, 400.0)?;
        between("set_spindle_percent", p.set_spindle_percent, 0.1, 400.0)?;
        between("feed_min_mm_min", p.feed_min_mm_min, 0.1, HIGHEST_FEED_MM_MIN)?;
        between("feed_max_mm_min", p.feed_max_mm_min, 0.1, HIGHEST_FEED_MM_MIN)?;
        if p.feed_max_mm_min < p.feed_min_mm_min {
            let text = "the largest feed must not be below the smallest";
            return Err(Invalid::new("feed_max_mm_min", InvalidCode::Inconsistent, text));
        }
        between("acceleration_mm_s2", p.acceleration_mm_s2, 0.1, 1e5)?;
        if let Some(heating) = &p.heating {
            between("heating.feed_mm_min", heating.feed_mm_min, p.feed_min_mm_min, HIGHEST_FEED_MM_MIN)?;
            between("heating.until_mm", heating.until_mm, 0.0, p.depth_mm)?;
        }
        if let Some(bushing) = &p.bushing {
            between("bushing.feed_mm_min", bushing.feed_mm_min, p.feed_min_mm_min, HIGHEST_FEED_MM_MIN)?;
            between("bushing.from_mm", bushing.from_mm, 0.0, p.depth_mm)?;
            between("bushing.to_mm", bushing.to_mm, bushing.from_mm, p.depth_mm)?;
        }
        between("override_percent", p.override_percent, 1.0, 1000.0)?;
        between("confidence", p.confidence, 0.5, 0.999)?;
        between("tolerance_ratio", p.tolerance_ratio, 0.0, 1.0)?;
        between("tolerated_overload_s", p.tolerated_overload_s, 0.0, 10.0)?;
        between("raise_ratio", p.raise_ratio, 1.0, 4.0)?;
        between("lower_ratio", p.lower_ratio, 0.05, 1.0)?;
        if let Objective::Cost { per_second, per_percent_second } = p.objective {
            between("objective.cost.per_second", per_second, 0.0, 1e9)?;
            between("objective.cost.per_percent_second", per_percent_second, 0.0, 1e9)?;
            if per_second + per_percent_second <= 0.0 {
                let text = "at least one of the costs must be above 0";
                return Err(Invalid::new("objective.cost", InvalidCode::Inconsistent, text));
            }
        }
        if !(4..=MOST_PROFILE_KNOTS).contains(&p.most_knots) {
            let text = format!("must be between 4 and {MOST_PROFILE_KNOTS}, not {}", p.most_knots);
            return Err(Invalid::new("most_knots", InvalidCode::OutOfRange, text));
        }
        for (index, idle) in p.idle_percent.iter().flatten().enumerate() {
            let set = [p.set_feed_drive_percent, p.set_spindle_percent][index];
            between("idle_percent", *idle, -50.0, 400.0)?;
            if *idle >= set {
                let text = format!("the idle load of {idle} % is not below the set load of {set} %");
                return Err(Invalid::new(format!("idle_percent[{index}]"), InvalidCode::Inconsistent, text));
            }
        }
        if let Some(watts) = p.watts_per_percent {
            positive("watts_per_percent", watts, 1e6)?;
        }
        if let Some(wear) = p.wear_ratio {
            between("wear_ratio", wear, *WEAR_RATIOS.start(), *WEAR_RATIOS.end())?;
        }
        between("spread_scale", p.spread_scale, 0.25, 10.0)?;
        Ok(Self(params))
    }

    /// Set loads of feed drive and spindle, percent.
    pub(crate) fn set_percent(&self) -> [f64; 2] {
        [self.set_feed_drive_percent, self.set_spindle_percent]
    }

    /// What programmed feeds are multiplied with before they act.
    pub(crate) fn override_factor(&self) -> f64 {
        (self.override_percent / 100.0).max(1.0)
    }

    /// Whether knots keep feed limits, acceleration, coverage, order and number. The reason if not.
    ///
    /// # Errors
    /// With the path of the first knot that does not.
    pub fn check(&self, knots: &Knots) -> Result<(), Invalid> {
        knots.check(self)
    }
}

//! Machines in JSON.

use super::text::{MAX_NAME, required};
use super::word::LoadReferenceWord;
use super::{Registered, checked};
use feedwright_core::ids::MachineId;
use feedwright_core::invalid::Violation;
use feedwright_core::machine::{FeedDriveRating, FeedLimits, Machine, SpindleRating};
use feedwright_store::Versioned;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A machine as it is registered.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MachineBody {
    /// What people call it.
    #[schema(example = "Friction drill 1")]
    pub name: String,
    /// Kind of control.
    #[schema(example = "sinumerik-840d")]
    pub control: String,
    /// Interpolator (IPO) cycle, ms.
    #[schema(example = 8.0)]
    pub ipo_period_ms: f64,
    /// What the spindle's percent load refers to; without it, loads give no joules.
    #[serde(default)]
    pub spindle: SpindleBody,
    /// What the feed drive's percent load refers to.
    #[serde(default)]
    pub feed_drive: FeedDriveBody,
    /// Limits that no recommendation leaves.
    pub limits: LimitsBody,
}

/// The spindle's rating.
#[derive(Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SpindleBody {
    /// What 100 % load is. `rated_torque`, `maximum_current` and `continuous_rating` follow torque: below the base speed a
    /// percent is the less power the slower the spindle turns, and without `base_speed_rpm` loads give no joules.
    /// `rated_power` is the same at every speed; a percent of continuous power, too, is told so, with the continuous power
    /// as `rated_power_watts`.
    #[serde(default)]
    pub reference: LoadReferenceWord,
    /// Power at 100 % load at or above the base speed, W.
    #[serde(default)]
    pub rated_power_watts: Option<f64>,
    /// Speed below which power falls in proportion to speed where the load follows torque, rpm.
    #[serde(default)]
    pub base_speed_rpm: Option<f64>,
}

/// The feed drive's rating.
#[derive(Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FeedDriveBody {
    /// What 100 % load is. Its percent is a force, by whichever word; `unknown` gives no joules.
    #[serde(default)]
    pub reference: LoadReferenceWord,
    /// Thrust at 100 % load, N.
    #[serde(default)]
    pub rated_thrust_newtons: Option<f64>,
}

/// Limits of feed and override.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LimitsBody {
    /// Slowest feed, mm/min.
    pub feed_min_mm_min: f64,
    /// Fastest feed, mm/min.
    pub feed_max_mm_min: f64,
    /// Lowest override, %; above 0 and at most 100.
    pub override_min_percent: f64,
    /// Highest override, %; at least 100.
    pub override_max_percent: f64,
}

impl MachineBody {
    /// The machine of that id.
    pub fn into_machine(self, id: MachineId) -> Result<Machine, Vec<Violation>> {
        let mut wrong = Vec::new();
        let name = required("name", &self.name, MAX_NAME, &mut wrong);
        let control = required("control", &self.control, MAX_NAME, &mut wrong);
        let LimitsBody { feed_min_mm_min, feed_max_mm_min, override_min_percent, override_max_percent } =
            self.limits;
        let limits =
            FeedLimits::new(feed_min_mm_min, feed_max_mm_min, override_min_percent, override_max_percent);
        // A machine with limits of another is only made to find what else is wrong; it is never returned.
        let limits = limits.or_else(|more| {
            wrong.extend(more);
            FeedLimits::new(0.0, 1.0, 100.0, 100.0)
        })?;
        let machine = Machine {
            id,
            name,
            control,
            ipo_period_ms: self.ipo_period_ms,
            spindle: SpindleRating {
                reference: self.spindle.reference.0,
                rated_power_watts: self.spindle.rated_power_watts,
                base_speed_rpm: self.spindle.base_speed_rpm,
            },
            feed_drive: FeedDriveRating {
                reference: self.feed_drive.reference.0,
                rated_thrust_newtons: self.feed_drive.rated_thrust_newtons,
            },
            limits,
        };
        checked(machine, wrong, Machine::validated)
    }
}

impl From<Versioned<Machine>> for Registered<MachineBody> {
    fn from(stored: Versioned<Machine>) -> Self {
        let Machine { id, name, control, ipo_period_ms, spindle, feed_drive, limits } = stored.value;
        let body = MachineBody {
            name,
            control,
            ipo_period_ms,
            spindle: SpindleBody {
                reference: LoadReferenceWord(spindle.reference),
                rated_power_watts: spindle.rated_power_watts,
                base_speed_rpm: spindle.base_speed_rpm,
            },
            feed_drive: FeedDriveBody {
                reference: LoadReferenceWord(feed_drive.reference),
                rated_thrust_newtons: feed_drive.rated_thrust_newtons,
            },
            limits: LimitsBody {
                feed_min_mm_min: limits.min_mm_min(),
                feed_max_mm_min: limits.max_mm_min(),
                override_min_percent: limits.override_min_percent(),
                override_max_percent: limits.override_max_percent(),
            },
        };
        Self::of(id.as_str(), (stored.version, stored.updated_at, stored.is_damaged), body)
    }
}

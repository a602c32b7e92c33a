//! What cycles say of feed profiles, in JSON.

use super::what_if::ManyAnswer;
use feedwright_core::feed::comparison::{Balanced, Compared, Interval, Side};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// Most cycles that a shadow is run on.
pub const MOST_SHADOW_CYCLES: u32 = 500;
/// Cycles of a shadow that names no number, as many as a person waits for.
pub const USUAL_SHADOW_CYCLES: u32 = 50;

/// Which version is run on which cycles.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ShadowQuery {
    /// The version; the newest where it is left out.
    #[param(minimum = 1)]
    pub version: Option<u32>,
    /// How many of the operation's last cycles, 1 to 500; 50 where it is left out.
    #[param(minimum = 1, maximum = 500)]
    pub cycles: Option<u32>,
}

/// A version computed against what really ran.
#[derive(Debug, Serialize, ToSchema)]
pub struct ShadowAnswer {
    /// Name of the feed profile.
    pub profile: String,
    /// The version.
    pub version: u32,
    /// Where it stands: it is not handed out before it is active.
    pub state: &'static str,
    /// Its own time from first contact to the end at an override of 100 %, s.
    pub time_s: f64,
    /// What happened and what is predicted, over the last cycles of the operation with tools of the type; overload is what
    /// exceeds the profile's set loads.
    pub cycles: ManyAnswer,
}

/// Which versions are compared.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ComparisonQuery {
    /// The earlier version.
    #[param(minimum = 1)]
    pub before: u32,
    /// The later version; the active one where it is left out.
    #[param(minimum = 1)]
    pub after: Option<u32>,
}

/// A value with its 90 % interval.
#[derive(Debug, Serialize, ToSchema)]
pub struct IntervalBody {
    /// The value.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl From<Interval> for IntervalBody {
    fn from(interval: Interval) -> Self {
        Self { value: interval.value, low: interval.low, high: interval.high }
    }
}

/// One version's side.
#[derive(Debug, Serialize, ToSchema)]
pub struct SideBody {
    /// Cycles that told the quantity.
    pub cycles: usize,
    /// Their median; null for fewer than 5.
    pub median: Option<IntervalBody>,
}

impl From<Side> for SideBody {
    fn from(side: Side) -> Self {
        Self { cycles: side.cycles, median: side.median.map(Into::into) }
    }
}

/// One quantity of two versions.
#[derive(Debug, Serialize, ToSchema)]
pub struct ComparedBody {
    /// The earlier version.
    pub before: SideBody,
    /// The later version.
    pub after: SideBody,
    /// Median after over median before, minus 1.
    pub change: Option<IntervalBody>,
    /// Whether the interval of the change leaves out 0: if not, no difference was shown.
    pub is_clear: bool,
    /// The change as if both versions had run on tools of the same wear; null where the wear of fewer than 5 cycles is
    /// known, or where the versions ran at wears so different that version and wear cannot be told apart.
    pub at_same_wear: Option<BalancedBody>,
}

/// A change at the same wear.
#[derive(Debug, Serialize, ToSchema)]
pub struct BalancedBody {
    /// After over before, minus 1.
    pub change: IntervalBody,
    /// Whether the interval leaves out 0.
    pub is_clear: bool,
}

impl ComparedBody {
    /// A comparison as the cycles ran, and at the same wear where that can be told.
    pub fn new(compared: Compared, at_same_wear: Option<Balanced>) -> Self {
        Self {
            before: compared.before.into(),
            after: compared.after.into(),
            change: compared.change.map(Into::into),
            is_clear: compared.is_clear,
            at_same_wear: at_same_wear
                .map(|found| BalancedBody { change: found.change.into(), is_clear: found.is_clear }),
        }
    }
}

/// What a version's own curve says and what its cycles took.
#[derive(Debug, Serialize, ToSchema)]
pub struct PredictedBody {
    /// The version.
    pub version: u32,
    /// Its time from first contact to the end at an override of 100 %, s.
    pub time_s: f64,
    /// Cycle time of its cycles, s: it also holds the approach and what the override did.
    pub actual_s: Option<IntervalBody>,
    /// Rise of the energy of one tool with its cycles of this version, per thousand of them; null where no tool has 8.
    pub wear_rate_per_thousand: Option<IntervalBody>,
}

/// Two versions by the cycles that ran them; medians with 90 % intervals from a seeded bootstrap.
#[derive(Debug, Serialize, ToSchema)]
pub struct ComparisonAnswer {
    /// Name of the feed profile.
    pub profile: String,
    /// Both versions, the earlier one first.
    pub versions: [PredictedBody; 2],
    /// Level of wear of the tools when the cycles ran, 1 is the new tool. Where it changed, trust `at_same_wear`.
    pub wear_level: ComparedBody,
    /// Cycle time, s.
    pub duration_s: ComparedBody,
    /// Energy of a cycle, J, on the basis named beside.
    pub energy_joules: ComparedBody,
    /// The basis of the energies that are compared; null where the cycles have none in common.
    pub energy_basis: Option<&'static str>,
    /// Largest spindle load of a cycle, %.
    pub peak_spindle_load_percent: ComparedBody,
    /// Largest feed-drive load of a cycle, %.
    pub peak_feed_drive_load_percent: ComparedBody,
    /// Aborted cycles, which are left out everywhere above: of the earlier and of the later version.
    pub aborted: [usize; 2],
    /// Cycles of which the server kept only a part, likewise left out.
    pub cut_short: [usize; 2],
}

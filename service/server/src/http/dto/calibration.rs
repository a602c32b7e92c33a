//! Fitted lines of a machine in JSON.

use super::time;
use feedwright_core::invalid::{Range, Violation};
use feedwright_core::machine::{Calibration, FittedLine};
use feedwright_core::units::Timestamp;
use feedwright_store::StoredCalibration;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Loads that a line may be fitted over.
const LOAD_RANGE: Range = Range::new(-400.0, 400.0, "%");
/// Fitted lines: at least one of them.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CalibrationBody {
    /// Thrust (N) over feed-drive load (%).
    #[serde(default)]
    pub thrust: Option<LineBody>,
    /// Torque (N·m) over spindle load (%).
    #[serde(default)]
    pub torque: Option<LineBody>,
}

/// A robust line `y = slope·load + intercept` with the range it was fitted in.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LineBody {
    /// Rise per percent of load, N/% or N·m/%: above 0, up to 1000000.
    #[schema(exclusive_minimum = 0, maximum = 1_000_000)]
    pub slope: f64,
    /// Value at no load, N or N·m: −10000000 to 10000000.
    #[schema(minimum = -10_000_000, maximum = 10_000_000)]
    pub intercept: f64,
    /// Lowest load seen when fitting, %: −400 to 400 where it is posted.
    pub min_percent: f64,
    /// Highest load seen when fitting, %: −400 to 400 where it is posted, and above the lowest.
    pub max_percent: f64,
    /// Coefficient of determination, 0 to 1.
    #[schema(minimum = 0, maximum = 1)]
    pub r_squared: f64,
    /// Robust standard deviation of the residuals, N or N·m: 0 to 10000000.
    #[schema(minimum = 0, maximum = 10_000_000)]
    pub residual_spread: f64,
}

impl LineBody {
    fn check(self, name: &str, wrong: &mut Vec<Violation>) -> FittedLine {
        let Self { slope, intercept, min_percent, max_percent, r_squared, residual_spread } = self;
        // Adding zero turns −0.0 into 0.0, so that equal content has equal bits on both databases.
        let line = FittedLine {
            slope,
            intercept: intercept + 0.0,
            min_percent: min_percent + 0.0,
            max_percent: max_percent + 0.0,
            r_squared: r_squared + 0.0,
            residual_spread: residual_spread + 0.0,
        };
        line.collect(name, wrong);
        for (field, value) in [("min_percent", min_percent), ("max_percent", max_percent)] {
            LOAD_RANGE.collect(&format!("{name}.{field}"), value, wrong);
        }
        if min_percent >= max_percent {
            let path = format!("{name}.max_percent");
            wrong.push(Violation::new(path, "empty_range", "must be above min_percent"));
        }
        if slope <= 0.0 {
            let path = format!("{name}.slope");
            wrong.push(Violation::new(
                path,
                "not_rising",
                "must be above 0: a drive pushes harder under load",
            ));
        }
        line
    }
}

impl From<FittedLine> for LineBody {
    fn from(line: FittedLine) -> Self {
        let FittedLine { slope, intercept, min_percent, max_percent, r_squared, residual_spread } = line;
        Self { slope, intercept, min_percent, max_percent, r_squared, residual_spread }
    }
}

impl TryFrom<CalibrationBody> for Calibration {
    type Error = Vec<Violation>;

    fn try_from(body: CalibrationBody) -> Result<Self, Vec<Violation>> {
        let mut wrong = Vec::new();
        if body.thrust.is_none() && body.torque.is_none() {
            wrong.push(Violation::new("thrust", "nothing_fitted", "a calibration needs at least one line"));
        }
        let thrust = body.thrust.map(|line| line.check("thrust", &mut wrong));
        let torque = body.torque.map(|line| line.check("torque", &mut wrong));
        // The store assigns the version.
        if wrong.is_empty() { Ok(Self { version: 0, thrust, torque }) } else { Err(wrong) }
    }
}

/// One version of a machine's fitted lines.
#[derive(Debug, Serialize, ToSchema)]
pub struct CalibrationView {
    /// Its version, counted from 1.
    pub version: u32,
    /// When it came into force, RFC 3339.
    pub created_at: String,
    /// Whether the disk has changed it since it was written: nothing is decided by it. Left out where it is not known to be.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub damaged: bool,
    /// Thrust (N) over feed-drive load (%).
    pub thrust: Option<LineBody>,
    /// Torque (N·m) over spindle load (%).
    pub torque: Option<LineBody>,
}

impl From<(Calibration, Timestamp)> for CalibrationView {
    fn from((calibration, fitted_at): (Calibration, Timestamp)) -> Self {
        StoredCalibration { calibration, fitted_at, is_damaged: false }.into()
    }
}

impl From<StoredCalibration> for CalibrationView {
    fn from(StoredCalibration { calibration, fitted_at, is_damaged }: StoredCalibration) -> Self {
        Self {
            version: calibration.version,
            created_at: time::show(fitted_at),
            damaged: is_damaged,
            thrust: calibration.thrust.map(LineBody::from),
            torque: calibration.torque.map(LineBody::from),
        }
    }
}

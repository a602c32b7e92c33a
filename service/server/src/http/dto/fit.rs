//! Fitting a machine's lines to its dynamometer cycles, in JSON.

use super::calibration::CalibrationView;
use super::what_if::FilterBody;
use feedwright_core::friction::calibration::LoadLine;
use feedwright_core::machine::FittedLine;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Most cycles of one fit: a line over two hundred holes is as sharp as it gets.
pub const MOST_FIT_CYCLES: u32 = 200;
/// Cycles of a fit that names no number.
pub const USUAL_FIT_CYCLES: u32 = 50;

/// Which dynamometer cycles are fitted.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
#[schema(example = json!({"filter": {"from": "2026-05-04T06:00:00Z"}, "most_cycles": 50, "dry_run": true}))]
pub struct FitRequest {
    /// Cycles of this machine by tool, operation and time; `machine` must be left out or the path's.
    pub filter: FilterBody,
    /// Most cycles fitted, 1 to 200, oldest first; 50 where it is left out. Those that give nothing are passed over: at
    /// most 20000 cycles are looked at, and the samples of 1000 are read.
    #[schema(minimum = 1, maximum = 200)]
    pub most_cycles: Option<u32>,
    /// Only tells what would be stored.
    pub dry_run: bool,
}

/// The fit.
#[derive(Debug, Serialize, ToSchema)]
pub struct FitAnswer {
    /// Whether nothing was stored.
    pub dry_run: bool,
    /// The version that was stored; null for a dry run.
    pub calibration: Option<CalibrationView>,
    /// Thrust over feed-drive load.
    pub thrust: LineFit,
    /// Torque over spindle load.
    pub torque: LineFit,
    /// Cycles that were looked at.
    pub considered: u32,
    /// Cycles that gave nothing, by reason: `no_samples`, `samples_dropped` (or missing), `no_dynamometer`.
    pub skipped: BTreeMap<&'static str, u32>,
}

/// What became of one line.
#[derive(Debug, Serialize, ToSchema)]
pub struct LineFit {
    /// `fitted`, `carried_over` (from the version before) or `none`.
    pub outcome: &'static str,
    /// The line, where it was fitted.
    pub line: Option<FittedLineBody>,
    /// Why it was not fitted.
    pub reason: Option<String>,
}

/// A fitted line with what is needed to judge it.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
pub struct FittedLineBody {
    /// N or N·m per percent.
    pub slope: f64,
    /// N or N·m at no load reading.
    pub intercept: f64,
    /// Lowest load seen, %: below it nothing is known, and the line runs on, never below zero.
    pub min_percent: f64,
    /// Highest load seen, %: more than a tenth of the span beyond it nothing is told.
    pub max_percent: f64,
    /// Share of the variance that the line explains.
    pub r_squared: f64,
    /// Robust standard deviation of what is left, N or N·m.
    pub residual_spread: f64,
    /// Points that were fitted.
    pub points: u64,
    /// Cycles that they came from.
    pub cycles: u64,
}

impl From<&LoadLine> for FittedLineBody {
    fn from(line: &LoadLine) -> Self {
        Self {
            slope: line.slope,
            intercept: line.intercept,
            min_percent: line.load_min_percent,
            max_percent: line.load_max_percent,
            r_squared: line.r_squared,
            residual_spread: line.residual_spread,
            points: line.points as u64,
            cycles: line.cycles as u64,
        }
    }
}

impl From<&FittedLineBody> for FittedLine {
    fn from(line: &FittedLineBody) -> Self {
        let FittedLineBody { slope, intercept, min_percent, max_percent, r_squared, residual_spread, .. } =
            *line;
        Self { slope, intercept, min_percent, max_percent, r_squared, residual_spread }
    }
}

//! Series in JSON.

use super::time;
use crate::series::SeriesKey;
use feedwright_core::series::Spread;
use feedwright_core::units::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

/// Series of what cycles amounted to.
#[derive(Debug, Serialize, ToSchema)]
#[serde(untagged)]
pub enum SeriesBody {
    /// In buckets over time.
    Buckets {
        /// By what cycles are put together: `fleet`, `machine`, `tool` or `operation`.
        by: &'static str,
        /// A series per measure, basis and group.
        series: Vec<BucketSeriesBody>,
    },
    /// The last cycles by themselves.
    Cycles {
        /// By what cycles are put together.
        by: &'static str,
        /// A series per measure, basis and group.
        series: Vec<ValueSeriesBody>,
    },
}

/// What a series tells.
#[derive(Debug, Serialize, ToSchema)]
pub struct SeriesName {
    /// The quantity with its unit last.
    #[schema(example = "energy_joules")]
    pub measure: &'static str,
    /// The unit in symbols.
    #[schema(example = "J")]
    pub unit: &'static str,
    /// For an energy its basis.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "rated_power")]
    pub basis: Option<&'static str>,
    /// For an energy what was done about idle power: `not_applicable`, `included` or `subtracted`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "included")]
    pub idle_power: Option<&'static str>,
}

impl From<&SeriesKey> for SeriesName {
    fn from(key: &SeriesKey) -> Self {
        Self {
            measure: key.measure.as_str(),
            unit: key.measure.unit(),
            basis: key.basis.map(|(basis, _)| basis),
            idle_power: key.basis.map(|(_, idle)| idle),
        }
    }
}

/// A series in buckets.
#[derive(Debug, Serialize, ToSchema)]
pub struct BucketSeriesBody {
    /// What it tells.
    #[serde(flatten)]
    pub key: SeriesName,
    /// The machine, tool or operation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub group: Option<String>,
    /// Every bucket of the range.
    pub points: Vec<BucketBody>,
}

/// What was measured in one bucket; nulls where nothing was.
#[derive(Debug, Serialize, ToSchema)]
pub struct BucketBody {
    /// When it begins, RFC 3339.
    pub time: String,
    /// Cycles in it that have the measure.
    pub count: usize,
    /// Arithmetic mean.
    pub mean: Option<f64>,
    /// Smallest.
    pub min: Option<f64>,
    /// Largest.
    pub max: Option<f64>,
    /// Median.
    pub p50: Option<f64>,
    /// 95th percentile.
    pub p95: Option<f64>,
}

impl BucketBody {
    /// One bucket.
    pub fn of(begin: Timestamp, spread: Option<Spread>) -> Self {
        Self {
            time: time::show(begin),
            count: spread.map_or(0, |spread| spread.count),
            mean: spread.map(|spread| spread.mean),
            min: spread.map(|spread| spread.min),
            max: spread.map(|spread| spread.max),
            p50: spread.map(|spread| spread.p50),
            p95: spread.map(|spread| spread.p95),
        }
    }
}

/// A series of single cycles, in columns of equal length, oldest first.
#[derive(Debug, Serialize, ToSchema)]
pub struct ValueSeriesBody {
    /// What it tells.
    #[serde(flatten)]
    pub key: SeriesName,
    /// The machine, tool or operation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub group: Option<String>,
    /// When each cycle began, RFC 3339.
    pub time: Vec<String>,
    /// The machine of each.
    pub machine: Vec<String>,
    /// The id of each.
    pub cycle_id: Vec<String>,
    /// The value of each.
    pub value: Vec<f64>,
}

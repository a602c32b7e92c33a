//! Series in JSON.

use super::time;
use crate::series::{SeriesKey, Value};
use feedwright_core::series::Spread;
use feedwright_core::units::Timestamp;
use serde::ser::SerializeSeq;
use serde::{Serialize, Serializer};
use utoipa::ToSchema;

/// Series of what cycles amounted to.
#[derive(Debug, Serialize, ToSchema)]
pub struct SeriesBody<'a> {
    /// By what cycles are put together: `fleet`, `machine`, `tool` or `operation`.
    pub by: &'static str,
    /// A series per measure, basis and group.
    pub series: Vec<OneSeriesBody<'a>>,
}

/// One series.
#[derive(Debug, Serialize, ToSchema)]
#[serde(untagged)]
pub enum OneSeriesBody<'a> {
    /// In buckets over time.
    Buckets(BucketSeriesBody<'a>),
    /// The last cycles by themselves.
    Cycles(ValueSeriesBody<'a>),
}

/// Series as `layout` says: columns, or rows where those were asked for.
#[derive(Serialize, ToSchema)]
#[serde(untagged)]
pub enum SeriesAnswer {
    /// With `layout=series`, or without.
    Columns(SeriesBody<'static>),
    /// With `layout=rows`.
    Rows {
        /// An object per bucket or cycle, with the fields of the other forms' rows.
        #[schema(value_type = Vec<Object>)]
        items: Vec<serde_json::Value>,
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
    /// For an energy its basis; left out where the range has none.
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
pub struct BucketSeriesBody<'a> {
    /// What it tells.
    #[serde(flatten)]
    pub key: SeriesName,
    /// The machine, tool or operation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub group: Option<&'a str>,
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
pub struct ValueSeriesBody<'a> {
    /// What it tells.
    #[serde(flatten)]
    pub key: SeriesName,
    /// The machine, tool or operation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub group: Option<&'a str>,
    /// When each cycle began, RFC 3339.
    #[serde(serialize_with = "times")]
    #[schema(value_type = Vec<String>)]
    pub time: &'a [Value<'a>],
    /// The machine of each.
    #[serde(serialize_with = "machines")]
    #[schema(value_type = Vec<String>)]
    pub machine: &'a [Value<'a>],
    /// The id of each.
    #[serde(serialize_with = "cycles")]
    #[schema(value_type = Vec<String>)]
    pub cycle_id: &'a [Value<'a>],
    /// The value of each.
    #[serde(serialize_with = "values")]
    #[schema(value_type = Vec<f64>)]
    pub value: &'a [Value<'a>],
}

fn times<S: Serializer>(of: &[Value<'_>], serializer: S) -> Result<S::Ok, S::Error> {
    let mut shower = time::Shower::default();
    let mut all = serializer.serialize_seq(Some(of.len()))?;
    for value in of {
        all.serialize_element(shower.show(value.point.key.0))?;
    }
    all.end()
}

fn machines<S: Serializer>(of: &[Value<'_>], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(of.iter().map(|value| value.point.key.1.as_str()))
}

fn cycles<S: Serializer>(of: &[Value<'_>], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(of.iter().map(|value| value.point.key.2.as_str()))
}

fn values<S: Serializer>(of: &[Value<'_>], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(of.iter().map(|value| value.value))
}

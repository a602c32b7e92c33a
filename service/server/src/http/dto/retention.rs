//! Retention in JSON.

use super::time;
use feedwright_core::invalid::Violation;
use feedwright_store::{SampleDrop, SampleRetention, Versioned};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Longest time that can be said, days.
const MOST_DAYS: u32 = 36_500;
/// Most bytes that can be said.
const MOST_BYTES: u64 = 9_007_199_254_740_991;
/// Decisions that are shown.
const SHOWN: usize = 100;

/// How long a machine's samples are kept.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RetentionBody {
    /// Days since they were received; null for any age. On PostgreSQL they go by whole months, so up to a month later.
    #[schema(example = 90, minimum = 1, maximum = 36_500)]
    pub samples_days: Option<u32>,
    /// Bytes as they are stored, the newest first; null for any size.
    #[schema(example = 10_000_000_000_u64, minimum = 1, maximum = 9_007_199_254_740_991_u64)]
    pub samples_bytes: Option<u64>,
}

impl RetentionBody {
    /// As the store takes it.
    pub fn into_retention(self) -> Result<SampleRetention, Vec<Violation>> {
        let mut wrong = Vec::new();
        if self.samples_days.is_some_and(|days| !(1..=MOST_DAYS).contains(&days)) {
            wrong.push(Violation::new(
                "samples_days",
                "out_of_range",
                format!("must be within 1 to {MOST_DAYS}"),
            ));
        }
        if self.samples_bytes.is_some_and(|bytes| !(1..=MOST_BYTES).contains(&bytes)) {
            let message = format!("must be within 1 to {MOST_BYTES}");
            wrong.push(Violation::new("samples_bytes", "out_of_range", message));
        }
        let retention = SampleRetention { days: self.samples_days, bytes: self.samples_bytes };
        if wrong.is_empty() { Ok(retention) } else { Err(wrong) }
    }
}

/// How long a machine's samples are kept, and what was dropped.
#[derive(Debug, Serialize, ToSchema)]
pub struct RetentionView {
    /// The limits.
    #[serde(flatten)]
    pub body: RetentionBody,
    /// Whether they were said for this `machine`, or are the `server`'s settings.
    pub from: &'static str,
    /// Version of what was said; the ETag holds it too, and changes also with what was dropped.
    pub version: Option<u64>,
    /// When that was said, RFC 3339.
    pub updated_at: Option<String>,
    /// The newest decisions to drop samples, oldest of them first.
    pub dropped: Vec<SampleDropBody>,
}

/// A decision to drop samples. Those of one day (UTC) for one reason are told as one, the last of them, with what all of
/// them dropped; the audit has each.
#[derive(Debug, Serialize, ToSchema)]
pub struct SampleDropBody {
    /// Samples that the server had received before this, RFC 3339.
    pub received_before: String,
    /// When it was decided, RFC 3339.
    pub dropped_at: String,
    /// `age` or `size`.
    pub reason: &'static str,
    /// Cycles whose samples have gone so far. Of a decision that a clock which was ahead had made, also those that were
    /// received at times yet to come; each of them says itself when its samples went.
    pub cycles: u64,
    /// Bytes that have gone so far.
    pub bytes: u64,
}

impl RetentionView {
    /// What was said for the machine, else the server's settings.
    pub fn of(
        said: Option<&Versioned<SampleRetention>>,
        server: SampleRetention,
        drops: &[SampleDrop],
    ) -> Self {
        let kept = said.map_or(server, |said| said.value);
        Self {
            body: RetentionBody { samples_days: kept.days, samples_bytes: kept.bytes },
            from: if said.is_some() { "machine" } else { "server" },
            version: said.map(|said| said.version),
            updated_at: said.map(|said| time::show(said.updated_at)),
            dropped: drops.iter().skip(drops.len().saturating_sub(SHOWN)).map(Into::into).collect(),
        }
    }
}

impl From<&SampleDrop> for SampleDropBody {
    fn from(drop: &SampleDrop) -> Self {
        Self {
            received_before: time::show(drop.before),
            dropped_at: time::show(drop.dropped_at),
            reason: drop.reason.as_str(),
            cycles: drop.cycles,
            bytes: drop.bytes,
        }
    }
}

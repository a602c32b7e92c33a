//! Recorded cycles as the optimiser takes them, and why one is not used.

use crate::cycle::Extent;
use crate::friction::error::{Invalid, InvalidCode};
use crate::friction::filter::FilterWeights;
use crate::friction::relation::FeedSource;

/// Most samples of one cycle that are looked at; more are refused, not cut.
pub const MOST_SAMPLES: usize = 200_000;

/// Most cycles that are learned from: the latest ones.
pub const MOST_CYCLES: usize = 40;

/// Wear that a tool may have, as energy over that of the new one: what lies beyond is a mistake in either energy.
pub(super) const WEAR_RATIOS: std::ops::RangeInclusive<f64> = 0.5..=3.0;

/// Largest depth that is one, mm, as in the settings; a reading beyond it is a fault.
const DEEPEST_MM: f64 = 1000.0;

/// Short of the deepest by so much, mm, the tip may already stand: an encoder's noise adds that to a depth.
const STANDING_MM: f64 = 0.02;

/// What the recorded loads went through before they were recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LoadSignal {
    /// As the drive reports them.
    Raw,
    /// Filtered by Stryczek & Błaszczak 2020, Eq. 1: late by w_i/w_a samples.
    Filtered(FilterWeights),
    /// Late by this many seconds against depth and feed.
    Delayed(f64),
}

/// One recorded cycle: columns of equal length, a row per sample. A value that is missing is NaN.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedCycle {
    /// Which cycle, for reports.
    pub id: String,
    /// The operation that it drilled.
    pub operation: String,
    /// Place in the order of time; the cycle with the largest is the latest. Equal ones are ordered by id.
    pub order: i64,
    /// How much of it there is: what is there is learned from, and only a whole one is held against a prediction.
    pub extent: Extent,
    /// Who chose the feed: where a law did, load and feed are tied by the law and the slope is not learned.
    pub source: FeedSource,
    /// Wear when it ran, as energy over that of the new tool; `None` where nobody knows.
    pub wear_ratio: Option<f64>,
    /// What the loads went through.
    pub signal: LoadSignal,
    /// Time, s.
    pub time_s: Vec<f64>,
    /// Tip depth below first contact, mm; negative in the air.
    pub depth_mm: Vec<f64>,
    /// Actual feed, mm/min, override included; `None` takes it from depth and time.
    pub feed_mm_min: Option<Vec<f64>>,
    /// Feed-drive load, percent.
    pub feed_drive_percent: Vec<f64>,
    /// Spindle load, percent.
    pub spindle_percent: Vec<f64>,
}

/// Why a cycle was not learned from, or not held against a prediction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SkipReason {
    /// It drilled another operation.
    OtherOperation,
    /// Its columns differ in length.
    LengthMismatch,
    /// More samples than are looked at.
    TooManySamples,
    /// Too few usable samples in contact.
    TooShort,
    /// Its samples lie too far apart: what happens between two of them is not known.
    SampledTooRarely,
    /// Its wear is none that a tool can have.
    WearOutOfRange,
    /// Feed column and depth over time disagree, as mm/s taken for mm/min would.
    FeedContradictsDepth,
    /// The loads never rise above idle: nothing was drilled.
    NoLoad,
    /// The feed-drive load does not change over most of the way, or reads 0 in contact and never in the air, while the
    /// cycle goes on and shows work: a dead reading is not an air cut.
    DeadFeedDriveLoad,
    /// The same of the spindle load.
    DeadSpindleLoad,
    /// Its loads are far from what the other cycles show at the same feed.
    Outlier,
    /// Older than the cycles that are learned from.
    TooOld,
    /// The same cycle again.
    Duplicate,
    /// It was aborted: its time, peaks and work are not those of a hole.
    Aborted,
    /// The server kept only a part of it, of which the same holds.
    CutShort,
}

impl SkipReason {
    /// The stable code.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::OtherOperation => "other_operation",
            Self::LengthMismatch => "length_mismatch",
            Self::TooManySamples => "too_many_samples",
            Self::TooShort => "too_short",
            Self::SampledTooRarely => "sampled_too_rarely",
            Self::WearOutOfRange => "wear_out_of_range",
            Self::FeedContradictsDepth => "feed_contradicts_depth",
            Self::NoLoad => "no_load",
            Self::DeadFeedDriveLoad => "dead_feed_drive_load",
            Self::DeadSpindleLoad => "dead_spindle_load",
            Self::Outlier => "outlier",
            Self::TooOld => "too_old",
            Self::Duplicate => "duplicate",
            Self::Aborted => "aborted",
            Self::CutShort => "cut_short",
        }
    }
}

/// A cycle that was left out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Skipped {
    /// Which cycle.
    pub id: String,
    /// Why.
    pub reason: SkipReason,
}

impl RecordedCycle {
    pub(super) fn check(&self, operation: &str) -> Result<(), SkipReason> {
        if self.operation != operation {
            return Err(SkipReason::OtherOperation);
        }
        let len = self.time_s.len();
        let fits = self.depth_mm.len() == len
            && self.feed_drive_percent.len() == len
            && self.spindle_percent.len() == len
            && self.feed_mm_min.as_ref().is_none_or(|feed| feed.len() == len);
        if !fits {
            return Err(SkipReason::LengthMismatch);
        }
        if len > MOST_SAMPLES {
            return Err(SkipReason::TooManySamples);
        }
        Ok(())
    }

    /// The row at which the tip first arrives at the deepest; the last one where no depth is a number.
    ///
    /// What comes after it is dwelling and the way out, whose time, way and loads are none of drilling: how much of them was
    /// recorded must change nothing. The end of the way in, where the axis brakes, belongs to it as long as it goes deeper.
    pub(super) fn end_of_way(&self) -> usize {
        let loads = self.feed_drive_percent.iter().zip(&self.spindle_percent);
        let known = self.time_s.iter().zip(&self.depth_mm).zip(loads).enumerate().filter_map(|(at, row)| {
            let ((time, depth), (feed_drive, spindle)) = row;
            let numbers = [time, depth, feed_drive, spindle].into_iter().all(|number| number.is_finite());
            (numbers && *depth <= DEEPEST_MM).then_some((at, *depth))
        });
        let deepest = known.clone().map(|(_, depth)| depth).fold(f64::NEG_INFINITY, f64::max);
        let mut way = known.skip_while(|(_, depth)| *depth < deepest - STANDING_MM);
        let Some((mut end, mut reached)) = way.next() else { return self.depth_mm.len().saturating_sub(1) };
        for (at, depth) in way {
            if depth <= reached {
                break;
            }
            (end, reached) = (at, depth);
        }
        end
    }
}

impl From<SkipReason> for Invalid {
    fn from(reason: SkipReason) -> Self {
        let code = match reason {
            SkipReason::LengthMismatch => InvalidCode::LengthMismatch,
            _ => InvalidCode::NotIdentifiable,
        };
        Self::new("cycle", code, format!("unusable: {}", reason.as_str()))
    }
}

/// The refusal of an optimisation for which there is nothing to learn from.
pub(super) fn nothing_usable(skipped: &[Skipped]) -> Invalid {
    let first = skipped.first().map_or_else(
        // Who stores cycles gives none that lacks a column: what was to be sampled is what helps.
        || {
            "no cycle was given that was sampled with depth, feed-drive load and spindle load (depth_mm, \
             feed_drive_load_percent, spindle_load_percent): all three are needed"
                .to_owned()
        },
        |one| {
            format!(
                "none of {} cycles is usable, the first ({}) because: {}",
                skipped.len(),
                one.id,
                one.reason.as_str()
            )
        },
    );
    Invalid::new("cycles", InvalidCode::NotIdentifiable, first)
}

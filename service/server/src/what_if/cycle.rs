//! A stored cycle, cut to the way from contact to its deepest point.

use feedwright_core::cycle::{Channel, Samples, TimeBase};
use feedwright_core::friction::error::Invalid;
use feedwright_core::friction::program::{Between, FeedProgram, HIGHEST_FEED_MM_MIN, Knot, MOST_KNOTS};
use feedwright_core::friction::relation::FeedSource;
use feedwright_core::friction::whatif::StoredCycle as CoreCycle;
use feedwright_core::machine::Calibration;
use feedwright_core::machine::{LoadReference, Machine};
use feedwright_core::summary::{Context, median, way_in_contact};
use feedwright_core::units::Strategy;
use feedwright_store::CycleMeta;
use std::f64::consts::TAU;

/// Fewest samples in contact: a second or less says nothing about a hole.
const FEWEST_SAMPLES: usize = 20;

/// Most samples in contact, as the core predicts at most so many.
const MOST_SAMPLES: usize = 60_000;

/// Fewest samples in the air that idle loads are taken from, in the later half of the approach.
const FEWEST_IDLE: usize = 5;

/// How far a time step may be from the usual one, as a part of it: the model has one sample period.
const UNEVEN: f64 = 0.5;

/// Overrides that differ by more than this were chosen by a law or an operator, points.
const VARIED_OVERRIDE: f64 = 1.0;

/// Slowest feed that a program of what ran may hold, mm/min: a hold is no feed.
const SLOWEST_FEED_MM_MIN: f64 = 1.0;

/// Why a cycle cannot be asked "what if"; the codes are stable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Unusable {
    /// It came without samples.
    NoSamples,
    /// It came with samples that are not there any more.
    SamplesDropped,
    /// Depth, feed-drive load or spindle load was not sampled.
    MissingChannel,
    /// The samples are not evenly spaced.
    UnevenTime,
    /// Too few or too many samples between contact and the deepest point.
    Length,
    /// No spindle speed is known.
    NoSpeed,
    /// No cycle of the tool's life under this key teaches the relation, or not at these depths.
    NoRelation,
    /// The profile that is asked about is another operation's.
    OtherOperation,
    /// The profile that is asked about ends before the cycle does.
    ProfileTooShort,
    /// The core refuses it, or the other control would never finish the hole.
    Refused,
}

impl Unusable {
    /// The code as it is answered.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::NoSamples => "no_samples",
            Self::SamplesDropped => "samples_dropped",
            Self::MissingChannel => "missing_channel",
            Self::UnevenTime => "uneven_time",
            Self::Length => "too_few_or_many_samples",
            Self::NoSpeed => "no_spindle_speed",
            Self::NoRelation => "no_relation",
            Self::OtherOperation => "other_operation",
            Self::ProfileTooShort => "profile_too_short",
            Self::Refused => "refused",
        }
    }
}

/// Loads of the idling drives, percent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdleLoads {
    /// Feed drive.
    pub feed_drive_percent: f64,
    /// Spindle.
    pub spindle_percent: f64,
}

/// Where the idle loads come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IdleSource {
    /// The request names them.
    Given,
    /// Medians of the cycle's own samples before contact.
    BeforeContact,
    /// The cycle has no samples before contact, so they are taken as 0.
    AssumedZero,
}

/// Where the torque behind the spindle load comes from; with it the energy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TorqueSource {
    /// The machine's fitted line.
    Calibrated,
    /// The machine's rated power.
    Rated,
    /// Nothing: no joules.
    Unknown,
}

/// A cycle from contact to its deepest point.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactCycle {
    /// Sample period, s.
    pub period_s: f64,
    /// Tip depth, mm.
    pub depth_mm: Vec<f64>,
    feed_drive_percent: Vec<f64>,
    spindle_percent: Vec<f64>,
    programmed_mm_min: Option<Vec<f64>>,
    override_percent: Option<Vec<f64>>,
    spindle_rpm: f64,
    rated_torque_nm: Option<f64>,
    /// Where the torque comes from.
    pub torque_source: TorqueSource,
    /// Idle loads.
    pub idle: IdleLoads,
    /// Where they come from.
    pub idle_source: IdleSource,
    /// Whether a law chose the feed.
    pub source: FeedSource,
}

impl ContactCycle {
    /// Cuts a cycle to its contact. Its speed is what the cycle names, else what was measured, else its operation's.
    pub fn new(
        meta: &CycleMeta,
        samples: &Samples,
        context: Context<'_>,
        idle: Option<IdleLoads>,
    ) -> Result<Self, Unusable> {
        let Context { machine, calibration, .. } = context;
        let column = |channel| samples.column(channel).ok_or(Unusable::MissingChannel);
        let depth = column(Channel::DepthMm)?;
        let feed_drive = column(Channel::FeedDriveLoadPercent)?;
        let spindle = column(Channel::SpindleLoadPercent)?;
        let period_s = period_s(samples)?;
        let (surface, end) = way_in_contact(depth).ok_or(Unusable::Length)?;
        // The last sample at the surface belongs to the air where it lies above it.
        let contact = if depth[surface] < 0.0 { surface + 1 } else { surface };
        let range = contact..end + 1;
        if !(FEWEST_SAMPLES..=MOST_SAMPLES).contains(&range.len()) {
            return Err(Unusable::Length);
        }
        let speeds =
            samples.column(Channel::SpindleSpeedRpm).map(|speed| median(&speed[range.clone()]).abs());
        let turning = |rpm: &f64| *rpm > 0.0;
        let of_cycle = meta.spindle_speed_rpm.or(speeds).filter(turning);
        let spindle_rpm = context.commanded_rpm(of_cycle).filter(turning).ok_or(Unusable::NoSpeed)?;
        let (rated_torque_nm, torque_source) = rated_torque_nm(machine, calibration, spindle_rpm);
        let (idle, idle_source) = match (idle, idle_loads(&feed_drive[..contact], &spindle[..contact])) {
            (Some(given), _) => (given, IdleSource::Given),
            (None, Some(seen)) => (seen, IdleSource::BeforeContact),
            (None, None) => {
                (IdleLoads { feed_drive_percent: 0.0, spindle_percent: 0.0 }, IdleSource::AssumedZero)
            }
        };
        let cut = |column: &[f64]| column[range.clone()].to_vec();
        let override_percent = samples.column(Channel::OverridePercent).map(cut);
        let source = source(meta.strategy, override_percent.as_deref());
        Ok(Self {
            period_s,
            depth_mm: cut(depth),
            feed_drive_percent: cut(feed_drive),
            spindle_percent: cut(spindle),
            programmed_mm_min: samples.column(Channel::FeedProgrammedMmMin).map(cut),
            override_percent,
            spindle_rpm,
            rated_torque_nm,
            torque_source,
            idle,
            idle_source,
            source,
        })
    }

    /// The cycle as the core reads it.
    pub fn core(&self) -> CoreCycle<'_> {
        CoreCycle {
            period_s: self.period_s,
            depth_mm: &self.depth_mm,
            feed_drive_percent: &self.feed_drive_percent,
            spindle_percent: &self.spindle_percent,
            feed_drive_idle_percent: self.idle.feed_drive_percent,
            spindle_idle_percent: self.idle.spindle_percent,
            spindle_rpm: self.spindle_rpm,
            spindle_rated_torque_nm: self.rated_torque_nm,
        }
    }

    /// Deepest point, mm.
    pub fn deepest_mm(&self) -> f64 {
        self.depth_mm.last().copied().unwrap_or(0.0)
    }

    /// The feed that ran, over depth, as a program: what the cycle is run again under to know the model's error.
    pub fn feed_that_ran(&self) -> Result<FeedProgram, Invalid> {
        self.program(|from, to| self.way_feed(from, to))
    }

    /// The programmed feed over depth: as it was sampled, else what ran freed of the override.
    pub fn programmed(&self) -> Result<FeedProgram, Invalid> {
        self.program(|from, to| {
            if let Some(programmed) = &self.programmed_mm_min {
                return mean(&programmed[from..to]);
            }
            let applied = self.override_percent.as_ref().map_or(100.0, |column| mean(&column[from..to]));
            if applied > 0.0 { self.way_feed(from, to) * 100.0 / applied } else { self.way_feed(from, to) }
        })
    }

    #[expect(clippy::cast_precision_loss, reason = "at most 60 000 samples")]
    fn way_feed(&self, from: usize, to: usize) -> f64 {
        let (first, last) = (from.saturating_sub(1), to - 1);
        let steps = (last - first).max(1) as f64;
        (self.depth_mm[last] - self.depth_mm[first]) / (steps * self.period_s) * 60.0
    }

    /// A program whose knots lie evenly over the samples, each at the mean depth of its stretch.
    fn program(&self, feed: impl Fn(usize, usize) -> f64) -> Result<FeedProgram, Invalid> {
        let count = self.depth_mm.len();
        // Two samples at least, so that a knot's feed is not one reading's noise.
        let stretch = count.div_ceil(MOST_KNOTS).max(2);
        let mut knots: Vec<Knot> = Vec::new();
        let mut from = 0;
        while from < count {
            let to = (from + stretch).min(count);
            let depth_mm = mean(&self.depth_mm[from..to]);
            let feed_mm_min = feed(from, to).clamp(SLOWEST_FEED_MM_MIN, HIGHEST_FEED_MM_MIN);
            if knots.last().is_none_or(|knot| depth_mm > knot.depth_mm) {
                knots.push(Knot { depth_mm, feed_mm_min });
            }
            from = to;
        }
        FeedProgram::new(Between::Linear, knots)
    }
}

fn source(strategy: Option<Strategy>, overrides: Option<&[f64]>) -> FeedSource {
    let varied = overrides.is_some_and(|column| {
        let low = column.iter().copied().fold(f64::INFINITY, f64::min);
        let high = column.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        high - low > VARIED_OVERRIDE
    });
    match strategy {
        Some(Strategy::FAc) => FeedSource::Controlled,
        _ if varied => FeedSource::Controlled,
        _ => FeedSource::Programmed,
    }
}

fn period_s(samples: &Samples) -> Result<f64, Unusable> {
    match samples.time() {
        TimeBase::Period { period_ms } => Ok(period_ms * 1e-3),
        TimeBase::Stamps { time_ms } => {
            let steps: Vec<f64> = time_ms.windows(2).map(|pair| pair[1] - pair[0]).collect();
            if steps.is_empty() {
                return Err(Unusable::UnevenTime);
            }
            let usual = median(&steps);
            let even = usual > 0.0 && steps.iter().all(|step| (step - usual).abs() <= UNEVEN * usual);
            if even { Ok(usual * 1e-3) } else { Err(Unusable::UnevenTime) }
        }
    }
}

/// Medians over the later half of the approach: in the earlier half the spindle may be spinning up.
fn idle_loads(feed_drive: &[f64], spindle: &[f64]) -> Option<IdleLoads> {
    let half = feed_drive.len() / 2;
    (feed_drive.len() - half >= FEWEST_IDLE).then(|| IdleLoads {
        feed_drive_percent: median(&feed_drive[half..]),
        spindle_percent: median(&spindle[half..]),
    })
}

/// Torque that 100 % spindle load over idle stands for: by the fitted line, else by the rating, else not known.
fn rated_torque_nm(
    machine: &Machine,
    calibration: Option<&Calibration>,
    spindle_rpm: f64,
) -> (Option<f64>, TorqueSource) {
    if let Some(line) = calibration.and_then(|calibration| calibration.torque) {
        return (Some(100.0 * line.slope), TorqueSource::Calibrated);
    }
    let rating = &machine.spindle;
    let speed = match rating.reference {
        LoadReference::Unknown => None,
        // At and above the base speed the rated torque falls with the speed; below it, it is constant.
        reference if reference.follows_torque() => rating.base_speed_rpm.map(|base| base.max(spindle_rpm)),
        _ => Some(spindle_rpm),
    };
    match (rating.rated_power_watts, speed) {
        (Some(watts), Some(speed)) => (Some(watts / (TAU * speed / 60.0)), TorqueSource::Rated),
        _ => (None, TorqueSource::Unknown),
    }
}

#[expect(clippy::cast_precision_loss, reason = "at most 60 000 samples")]
fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

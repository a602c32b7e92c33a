//! Contact with the work and breakthrough, found in the stream of feed-drive load samples.
//!
//! Lengerov's adaptive plunge and friction drilling both need them: contact when the load leaves its idle band,
//! breakthrough when it falls back into it while the tool goes deeper than it has been. Load that comes back deeper still is
//! work again: what was left was a bore across the hole, or a pause. Contact is not looked for while the axis accelerates,
//! since inertia loads the drive too. A missing or unusable sample never makes an event. No allocation and no `std`, so that the same
//! code can run beside the drive. What to do about an event does not belong here.

use crate::field_error::{FieldError, Problem, within};

/// The load of the drive while the tool moves in air.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum IdleBand {
    /// Known beforehand, such as from the last hole.
    Known {
        /// Mean load, percent.
        mean_percent: f64,
        /// The band reaches this far above the mean, percent points.
        half_width_percent: f64,
    },
    /// Learnt from the first steady samples of the approach above the programmed surface, which must therefore be in air.
    /// Where there are too few of them it is never known.
    Learnt {
        /// Samples to learn from.
        samples: u32,
        /// Half width in standard deviations of those samples.
        sigmas: f64,
        /// Least half width, percent points: a quiet approach must not make a hair trigger.
        least_half_width_percent: f64,
    },
}

/// Unchecked settings of the detector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactInput {
    /// Idle band.
    pub idle: IdleBand,
    /// Successive samples outside (for breakthrough: inside) the band that make an event; also the detector's lag.
    pub confirm_samples: u32,
    /// Share of the half width that the load must fall below for breakthrough, 0..1; 1 is the band itself.
    pub release_share: f64,
    /// A feed that changes by more than this between samples, and by more than a tenth of itself, means that the axis
    /// accelerates, mm/min.
    pub steady_feed_change_mm_min: f64,
    /// Samples ignored after the feed has become steady.
    pub settle_samples: u32,
    /// Position of the programmed surface, mm; positions grow into the work.
    pub programmed_surface_mm: f64,
}

impl ContactInput {
    /// Settings for a load stream of about 100 Hz: band of 5 standard deviations learnt from 20 samples, lag 4.
    pub const DEFAULT: Self = Self {
        idle: IdleBand::Learnt { samples: 20, sigmas: 5.0, least_half_width_percent: 1.0 },
        confirm_samples: 4,
        release_share: 1.0,
        steady_feed_change_mm_min: 20.0,
        settle_samples: 2,
        programmed_surface_mm: 0.0,
    };
}

/// A feed that a control holds ripples by some of itself: less than this share is no acceleration that loads a drive.
const STEADY_SHARE: f64 = 0.1;

/// Checked settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactSettings(ContactInput);

impl ContactSettings {
    /// Checks settings.
    ///
    /// # Errors
    /// The first field that is not finite or out of range.
    pub fn new(input: ContactInput) -> Result<Self, FieldError> {
        match input.idle {
            IdleBand::Known { mean_percent, half_width_percent } => {
                within("idle.mean_percent", mean_percent, -1000.0, 1000.0)?;
                within("idle.half_width_percent", half_width_percent, 1e-6, 1000.0)?;
            }
            IdleBand::Learnt { samples, sigmas, least_half_width_percent } => {
                within("idle.samples", f64::from(samples), 2.0, 1e6)?;
                within("idle.sigmas", sigmas, 0.0, 100.0)?;
                within("idle.least_half_width_percent", least_half_width_percent, 1e-6, 1000.0)?;
            }
        }
        within("confirm_samples", f64::from(input.confirm_samples), 1.0, 10_000.0)?;
        within("release_share", input.release_share, 0.0, 1.0)?;
        if input.release_share <= 0.0 {
            let why = "is zero: noise would keep the load from ever falling below its mean for good";
            return Err(FieldError::new("release_share", Problem::Inconsistent(why)));
        }
        within("steady_feed_change_mm_min", input.steady_feed_change_mm_min, 0.0, 1e6)?;
        within("settle_samples", f64::from(input.settle_samples), 0.0, 10_000.0)?;
        within("programmed_surface_mm", input.programmed_surface_mm, -1e5, 1e5)?;
        Ok(Self(input))
    }

    /// The data of the settings.
    #[must_use]
    pub const fn data(&self) -> &ContactInput {
        &self.0
    }
}

/// One sample of the feed axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactSample {
    /// Position along the feed, mm, growing into the work.
    pub position_mm: f64,
    /// Actual feed, mm/min.
    pub feed_mm_min: f64,
    /// Feed-drive load, percent; none when it was not measured.
    pub load_percent: Option<f64>,
}

/// Where the tool is, as far as the load tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// In air, the idle band not known yet.
    Learning,
    /// In air.
    Approach,
    /// In contact with the work.
    InWork,
    /// Through the work.
    Through,
}

/// What a sample has confirmed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ContactEvent {
    /// The load has left the idle band; after a breakthrough: it was none.
    Contact,
    /// The load has fallen back into it.
    Breakthrough,
}

/// Why a sample was not judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ignored {
    /// Load, position or feed missing or not finite.
    Unusable,
    /// The axis accelerates or has not settled since, or this is the first sample.
    Accelerating,
}

/// Answer to a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactStep {
    /// Phase after the sample.
    pub phase: Phase,
    /// Event that this sample has confirmed.
    pub event: Option<ContactEvent>,
    /// Depth below the programmed surface, mm; none for an unusable position.
    pub depth_mm: Option<f64>,
    /// Where contact was found, relative to the programmed surface, mm: the part's error at this hole.
    pub contact_offset_mm: Option<f64>,
    /// Where the load fell back, below the programmed surface, mm.
    pub breakthrough_depth_mm: Option<f64>,
    /// Whether the tool is on its way out: above its deepest, and above where it was before.
    pub is_drawn_back: bool,
    /// Why the sample was not judged.
    pub ignored: Option<Ignored>,
}

/// The detector's state for one hole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactDetector {
    settings: ContactSettings,
    phase: Phase,
    mean_percent: f64,
    half_width_percent: f64,
    learnt: u32,
    /// Sum of squared deviations while learning (Welford 1962).
    squares: f64,
    last_feed_mm_min: Option<f64>,
    settling: u32,
    /// Successive samples for the next event and the position of the first of them.
    run: u32,
    run_from_mm: f64,
    /// The deepest that the tool has been before this sample, and where it was last, mm.
    deepest_mm: f64,
    last_mm: f64,
    contact_mm: Option<f64>,
    breakthrough_mm: Option<f64>,
}

impl ContactDetector {
    /// Starts in air, above the work.
    #[must_use]
    pub const fn new(settings: ContactSettings) -> Self {
        let (phase, mean_percent, half_width_percent) = match settings.0.idle {
            IdleBand::Known { mean_percent, half_width_percent } => {
                (Phase::Approach, mean_percent, half_width_percent)
            }
            IdleBand::Learnt { .. } => (Phase::Learning, 0.0, 0.0),
        };
        Self {
            settings,
            phase,
            mean_percent,
            half_width_percent,
            learnt: 0,
            squares: 0.0,
            last_feed_mm_min: None,
            settling: 0,
            run: 0,
            run_from_mm: 0.0,
            deepest_mm: f64::NEG_INFINITY,
            last_mm: f64::NEG_INFINITY,
            contact_mm: None,
            breakthrough_mm: None,
        }
    }

    /// Idle band in use, (mean, half width) in percent; none while it is being learnt.
    #[must_use]
    pub fn idle_band_percent(&self) -> Option<(f64, f64)> {
        (self.phase != Phase::Learning).then_some((self.mean_percent, self.half_width_percent))
    }

    /// Takes the next sample.
    pub fn step(&mut self, sample: ContactSample) -> ContactStep {
        let mut event = None;
        let ignored = match self.judgeable(&sample) {
            Ok(load) => {
                event = self.judge(sample.position_mm, load);
                None
            }
            Err(why) => {
                // An event needs successive samples that were all looked at.
                self.run = 0;
                Some(why)
            }
        };
        let is_drawn_back = sample.position_mm < self.deepest_mm && sample.position_mm < self.last_mm;
        if sample.position_mm.is_finite() {
            self.deepest_mm = self.deepest_mm.max(sample.position_mm);
            self.last_mm = sample.position_mm;
        }
        let surface = self.settings.0.programmed_surface_mm;
        ContactStep {
            phase: self.phase,
            event,
            depth_mm: sample.position_mm.is_finite().then_some(sample.position_mm - surface),
            contact_offset_mm: self.contact_mm.map(|position| position - surface),
            breakthrough_depth_mm: self.breakthrough_mm.map(|position| position - surface),
            is_drawn_back,
            ignored,
        }
    }

    fn judgeable(&mut self, sample: &ContactSample) -> Result<f64, Ignored> {
        if !sample.feed_mm_min.is_finite() {
            // Whether the axis accelerated meanwhile cannot be known.
            self.last_feed_mm_min = None;
            return Err(Ignored::Unusable);
        }
        let steady = self.last_feed_mm_min.is_some_and(|last| {
            let permitted = self.settings.0.steady_feed_change_mm_min.max(STEADY_SHARE * last.abs());
            (sample.feed_mm_min - last).abs() <= permitted
        });
        self.last_feed_mm_min = Some(sample.feed_mm_min);
        if !steady {
            self.settling = self.settings.0.settle_samples;
            return Err(Ignored::Accelerating);
        }
        if self.settling > 0 {
            self.settling -= 1;
            return Err(Ignored::Accelerating);
        }
        match sample.load_percent {
            Some(load) if load.abs() < 1e6 && sample.position_mm.is_finite() => Ok(load),
            _ => Err(Ignored::Unusable),
        }
    }

    fn judge(&mut self, position_mm: f64, load: f64) -> Option<ContactEvent> {
        let above = load - self.mean_percent;
        let counts = match self.phase {
            Phase::Learning => {
                // At the surface and below it the load may be the work's: learnt as idle, it would hide the contact.
                if position_mm < self.settings.0.programmed_surface_mm {
                    self.learn(load);
                }
                return None;
            }
            Phase::Approach => above > self.half_width_percent,
            Phase::InWork => {
                let is_idle = above <= self.half_width_percent * self.settings.0.release_share;
                if is_idle && position_mm.to_bits() == self.deepest_mm.to_bits() {
                    // It stands at the bottom: that nothing is cut there says nothing about what lies below.
                    return None;
                }
                // Drawn back, as in pecking, it cuts nothing either.
                is_idle && position_mm > self.deepest_mm
            }
            Phase::Through => {
                if above > self.half_width_percent && position_mm > self.deepest_mm {
                    // At once: the next answer must not be the feed of a tool that is out of the work.
                    self.phase = Phase::InWork;
                    self.breakthrough_mm = None;
                    self.run = 0;
                    return Some(ContactEvent::Contact);
                }
                return None;
            }
        };
        if !counts {
            self.run = 0;
            return None;
        }
        if self.run == 0 {
            self.run_from_mm = position_mm;
        }
        self.run += 1;
        if self.run < self.settings.0.confirm_samples {
            return None;
        }
        self.run = 0;
        if self.phase == Phase::Approach {
            self.phase = Phase::InWork;
            self.contact_mm = Some(self.run_from_mm);
            Some(ContactEvent::Contact)
        } else {
            self.phase = Phase::Through;
            self.breakthrough_mm = Some(self.run_from_mm);
            Some(ContactEvent::Breakthrough)
        }
    }

    fn learn(&mut self, load: f64) {
        let IdleBand::Learnt { samples, sigmas, least_half_width_percent } = self.settings.0.idle else {
            return;
        };
        self.learnt += 1;
        let count = f64::from(self.learnt);
        let off = load - self.mean_percent;
        self.mean_percent += off / count;
        self.squares += off * (load - self.mean_percent);
        if self.learnt >= samples {
            let deviation = libm::sqrt(self.squares / (count - 1.0));
            self.half_width_percent = (sigmas * deviation).max(least_half_width_percent);
            self.phase = Phase::Approach;
        }
    }
}

#[cfg(test)]
mod tests;

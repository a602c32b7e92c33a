//! Approach, work and retract feeds of a plunge, switched by contact and breakthrough in the load stream (Lengerov).
//!
//! A loop through a network bites before it knows: the advised approach is at most the permitted bite over the
//! detector's lag and the answer's age. Fast is only what is known to be in air: while the idle band is being learnt,
//! after anything unusable, where nothing could be judged for long, and deeper below the programmed surface than the
//! drill may bite, the advice is at most the working feed. Out of the work fast is only a tool that is drawn back.
//!
//! No axis runs slower than the machine's slowest feed. Where even that bites deeper than is permitted, there is no
//! plunge: from the start by the delay that is reckoned with, as the static answer has it (`loop_too_slow`), or for as
//! long as answers come later than that, which says so with the slowest feed.

use super::control::Seen;
use super::reason::{LoopReason, LoopReasons};
use crate::contact::{ContactDetector, ContactEvent, ContactSample, ContactSettings, Ignored, Phase};
use crate::friction::law::{Reason, time_is_bad};
use crate::machine::FeedLimits;
use std::collections::VecDeque;

/// An axis reaches its feed well within this: where it seems to accelerate for longer, contact is not looked for, ms.
const LONGEST_UNJUDGED_MS: f64 = 200.0;

/// What passes between two samples counts no longer than this, ms: an hour is no time between samples.
const LONGEST_STEP_MS: f64 = 3_600_000.0;

/// A feed in mm/min that lies within the limits it was made for.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct BoundedFeed(f64);

impl BoundedFeed {
    /// The feed nearest to a wish within a machine's limits; `None` for a wish that is not a number above 0.
    #[must_use]
    pub fn within(limits: &FeedLimits, wish_mm_min: f64) -> Option<Self> {
        (wish_mm_min > 0.0).then(|| Self(wish_mm_min.clamp(limits.min_mm_min(), limits.max_mm_min())))
    }

    /// The feed, mm/min.
    #[must_use]
    pub const fn mm_min(self) -> f64 {
        self.0
    }
}

/// The part of a plunge that the machine is to run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlungePhase {
    /// In air, towards the work.
    Approach,
    /// In the work, or where that is not known.
    Work,
    /// Through the work: out again.
    Retract,
}

impl PlungePhase {
    /// The word used in answers.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Approach => "approach",
            Self::Work => "work",
            Self::Retract => "retract",
        }
    }
}

/// What a plunge is to do now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlungeStep {
    /// The part that it is in.
    pub phase: PlungePhase,
    /// The feed to run.
    pub feed: BoundedFeed,
    /// How far the drill would bite at this feed before the axis reacts, mm.
    pub bite_mm: f64,
    /// Where contact was found, relative to the programmed surface, mm.
    pub contact_offset_mm: Option<f64>,
    /// Where the load fell back, below the programmed surface, mm.
    pub breakthrough_depth_mm: Option<f64>,
}

/// Feeds and delays of a plunge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlungeLimits {
    /// The most the drill and the machine bear in air, before the loop's bound, mm/min.
    pub plunge: BoundedFeed,
    /// Working feed, mm/min.
    pub work: BoundedFeed,
    /// The slowest that the machine runs, mm/min.
    pub least: BoundedFeed,
    /// Feed out of the hole, once the tool is drawn back, mm/min.
    pub retract: BoundedFeed,
    /// How far the drill may bite at plunge feed, mm.
    pub allowed_bite_mm: f64,
    /// Time from a sample to the axis acting on its answer that is reckoned with, ms.
    pub answer_age_ms: f64,
    /// Time between samples, ms; where they come further apart, the bite is reckoned with what passes between them.
    pub period_ms: f64,
    /// A sample that comes so long after the one before it, ms, may not be judged.
    pub longest_gap_ms: f64,
}

/// A plunge that runs.
#[derive(Debug, Clone)]
pub struct PlungeLoop {
    limits: PlungeLimits,
    detector: ContactDetector,
    confirm_samples: u32,
    phase: PlungePhase,
    /// Whether contact was found.
    in_work: bool,
    /// Time of the last sample, ms, and between the last ones: as many as confirm a contact.
    last_ms: Option<f64>,
    steps_ms: VecDeque<f64>,
    /// Good samples still needed before it may be fast.
    settling: u32,
    settling_samples: u32,
    /// Successive samples that were not judged.
    unjudged: u32,
    /// Whether the tool is on its way out, by the last sample that was judged.
    drawn_back: bool,
    contact_offset_mm: Option<f64>,
    breakthrough_depth_mm: Option<f64>,
}

impl PlungeLoop {
    /// Starts above the work; none where the machine's slowest feed bites deeper than is permitted before the axis
    /// reacts: the loop is too slow for a plunge.
    #[must_use]
    pub fn new(limits: PlungeLimits, detector: ContactSettings, settling_samples: u32) -> Option<Self> {
        let plunge = Self {
            limits,
            confirm_samples: detector.data().confirm_samples,
            detector: ContactDetector::new(detector),
            phase: PlungePhase::Work,
            in_work: false,
            last_ms: None,
            steps_ms: VecDeque::new(),
            settling: 0,
            settling_samples,
            unjudged: 0,
            drawn_back: false,
            contact_offset_mm: None,
            breakthrough_depth_mm: None,
        };
        (plunge.permitted_mm_min(plunge.delay_s(0.0)) >= limits.least.0).then_some(plunge)
    }

    /// Judges one sample.
    pub fn step(&mut self, seen: &Seen) -> (PlungeStep, LoopReasons) {
        let mut reasons = LoopReasons::NONE;
        let is_gap = time_is_bad(self.last_ms, self.limits.longest_gap_ms, seen.time_ms);
        self.pass_time(seen.time_ms);
        let found = self.detector.step(ContactSample {
            position_mm: seen.depth_mm.unwrap_or(f64::NAN),
            feed_mm_min: seen.actual_mm_min.unwrap_or(f64::NAN),
            load_percent: seen.feed_drive_percent,
        });
        self.contact_offset_mm = found.contact_offset_mm;
        self.breakthrough_depth_mm = found.breakthrough_depth_mm;
        if found.ignored == Some(Ignored::Unusable) {
            reasons.add(LoopReason::UnusableSample);
            self.settling = self.settling_samples;
        } else {
            self.settling = self.settling.saturating_sub(1);
        }
        if is_gap {
            reasons = reasons.and(LoopReasons::of_law(Reason::Gap));
            self.settling = self.settling_samples;
        }
        self.unjudged = if found.ignored.is_some() { self.unjudged.saturating_add(1) } else { 0 };
        let step_ms =
            self.steps_ms.back().map_or(self.limits.period_ms, |step| step.max(self.limits.period_ms));
        let is_judged = f64::from(self.unjudged) * step_ms <= LONGEST_UNJUDGED_MS;
        // Where no work was found as deep as the drill may bite, either there is none or it was missed.
        let is_expected_in_work = found.depth_mm.is_none_or(|depth| depth > self.limits.allowed_bite_mm);
        self.drawn_back = found.is_drawn_back && !is_gap;
        self.in_work = found.event == Some(ContactEvent::Contact) || found.phase == Phase::InWork;
        self.phase = match (found.event, found.phase) {
            (Some(ContactEvent::Contact), _) | (_, Phase::InWork) => PlungePhase::Work,
            (_, Phase::Through) => PlungePhase::Retract,
            (_, Phase::Learning) => {
                reasons.add(LoopReason::IdleUnknown);
                PlungePhase::Work
            }
            (_, Phase::Approach) if self.settling > 0 => {
                reasons = reasons.and(LoopReasons::of_law(Reason::Settling));
                PlungePhase::Work
            }
            (_, Phase::Approach) if !is_judged || is_expected_in_work => {
                reasons.add(LoopReason::IdleUnknown);
                PlungePhase::Work
            }
            (_, Phase::Approach) => PlungePhase::Approach,
        };
        let step = self.advice(seen.age_ms, &mut reasons);
        (step, reasons)
    }

    /// Passes a sample that may not be judged: the working feed, and what bounds it.
    pub fn withhold(&mut self, time_ms: Option<f64>, age_ms: f64) -> (PlungeStep, LoopReasons) {
        if let Some(time_ms) = time_ms {
            self.pass_time(time_ms);
        }
        self.settling = self.settling_samples;
        self.drawn_back = false;
        if self.phase == PlungePhase::Approach {
            self.phase = PlungePhase::Work;
        }
        let mut reasons = LoopReasons::NONE;
        (self.advice(age_ms, &mut reasons), reasons)
    }

    /// Notes how long after the last one a sample was taken.
    fn pass_time(&mut self, time_ms: f64) {
        if !time_ms.is_finite() {
            return;
        }
        if let Some(step_ms) =
            self.last_ms.map(|last| (time_ms - last).min(LONGEST_STEP_MS)).filter(|step| *step > 0.0)
        {
            if self.steps_ms.len() >= self.confirm_samples as usize {
                self.steps_ms.pop_front();
            }
            self.steps_ms.push_back(step_ms);
        }
        self.last_ms = Some(time_ms);
    }

    /// Seconds from contact to the axis acting on it.
    fn delay_s(&self, age_ms: f64) -> f64 {
        let samples = f64::from(self.confirm_samples);
        let passed_ms = if self.steps_ms.len() < self.confirm_samples as usize {
            // The rest may take as long as the longest of them.
            samples * self.steps_ms.iter().copied().fold(0.0, f64::max)
        } else {
            self.steps_ms.iter().sum()
        };
        let lag_ms = passed_ms.max(samples * self.limits.period_ms);
        (lag_ms + age_ms.max(self.limits.answer_age_ms)) / 1000.0
    }

    /// The feed that bites as deep as is permitted, mm/min.
    fn permitted_mm_min(&self, delay_s: f64) -> f64 {
        self.limits.allowed_bite_mm / delay_s * 60.0
    }

    /// A feed that bites no deeper than is permitted. Where the machine runs none so slow it is its slowest, and the
    /// reasons say that it is no plunge feed.
    fn bounded(&self, wish_mm_min: f64, delay_s: f64, reasons: &mut LoopReasons) -> BoundedFeed {
        let permitted = self.permitted_mm_min(delay_s);
        if permitted < wish_mm_min {
            reasons.add(LoopReason::BiteLimited);
        }
        if permitted < self.limits.least.0 {
            reasons.add(LoopReason::NoPlungeFeed);
            return self.limits.least;
        }
        BoundedFeed(wish_mm_min.min(permitted))
    }

    fn advice(&self, age_ms: f64, reasons: &mut LoopReasons) -> PlungeStep {
        let delay_s = self.delay_s(age_ms);
        let feed = match self.phase {
            PlungePhase::Retract if self.drawn_back => self.limits.retract,
            // Unless it is on its way out it may meet work again.
            PlungePhase::Retract => self.limits.work,
            PlungePhase::Work if self.in_work => self.limits.work,
            // What bounds the approach bounds the feed of which it is not known whether it is one, so that nothing unknown
            // raises it: the working feed itself may bite deeper than is allowed.
            PlungePhase::Work => self.bounded(self.limits.work.0.min(self.limits.plunge.0), delay_s, reasons),
            PlungePhase::Approach => self.bounded(self.limits.plunge.0, delay_s, reasons),
        };
        // What bites too deep is no approach, for a control that goes by the phase.
        let phase = match self.phase {
            PlungePhase::Approach if reasons.contains(LoopReason::NoPlungeFeed) => PlungePhase::Work,
            phase => phase,
        };
        PlungeStep {
            phase,
            feed,
            bite_mm: feed.mm_min() / 60.0 * delay_s,
            contact_offset_mm: self.contact_offset_mm,
            breakthrough_depth_mm: self.breakthrough_depth_mm,
        }
    }
}

//! The running cycle: sequence rules, ages and expiry around a process.

use super::control::{Control, Inputs, Seen};
use super::plunge::PlungeStep;
use super::reason::{LoopReason, LoopReasons, Quality};
use super::record::{Batch, Record, Timing};
use crate::cycle::Channel;
use crate::friction::feed_override::FeedOverride;
use crate::units::Timestamp;

/// Whether the override is told or only computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Computed and stored, not told: what the law would have done.
    Shadow,
    /// Told.
    Advise,
}

impl Mode {
    /// The word used in messages and in storage.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Shadow => "shadow",
            Self::Advise => "advise",
        }
    }

    /// The mode of that word.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        [Self::Shadow, Self::Advise].into_iter().find(|mode| mode.as_str() == text)
    }
}

/// Bounds of a running cycle; from the configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopSettings {
    /// A sample older than this is not judged, ms.
    pub oldest_sample_ms: f64,
    /// An answer may be acted on for so long, ms.
    pub validity_ms: i64,
    /// Samples that are kept.
    pub most_samples: usize,
    /// Longest cycle, ms.
    pub longest_cycle_ms: f64,
}

/// The answer to one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampleAdvice {
    /// The override after it.
    pub ovr: FeedOverride,
    /// Why.
    pub reasons: LoopReasons,
}

/// The answer to some samples, beside the advice on each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    /// The override in force: what is to be applied.
    pub ovr: FeedOverride,
    /// The reasons of the last sample, and of whatever acted on the whole.
    pub reasons: LoopReasons,
    /// The number that comes next.
    pub next: u64,
    /// Not to be acted on after this, by the server's clock.
    pub valid_until: Timestamp,
    /// The same, ms from the moment it was made.
    pub valid_for_ms: i64,
    /// Age of the newest sample when it was judged, ms; `None` where there was none.
    pub age_ms: Option<f64>,
    /// How good the data is.
    pub quality: Quality,
    /// What a plunge is to do.
    pub plunge: Option<PlungeStep>,
    /// Whether an overload holds the override, of this cycle or one that nobody has acknowledged: never go up, whatever
    /// expires.
    pub overloaded: bool,
}

/// When a cycle began, by the machine's clock, and what that clock said when the message was sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Begun {
    /// Start of the cycle.
    pub started_at: Timestamp,
    /// When the machine sent the message.
    pub sent_at: Timestamp,
    /// When it came, by the server's clock.
    pub received_at: Timestamp,
}

/// A cycle that runs.
#[derive(Debug, Clone)]
pub struct RunningCycle {
    settings: LoopSettings,
    mode: Mode,
    control: Control,
    inputs: Inputs,
    record: Record,
    /// Start of the cycle by the server's clock, µs; moved back when samples show that the clocks were read too late.
    started_us: i64,
    /// How far `started_us` may still be moved, µs.
    slack_us: i64,
    neutral: LoopReasons,
    capped: LoopReasons,
    /// What stands only for a time: a lost lease, a database that does not answer.
    passing: LoopReasons,
    cut_short: bool,
    /// When the last answer to new samples ends; a repeat does not prolong it.
    valid_until: Timestamp,
    age_ms: Option<f64>,
    plunge: Option<PlungeStep>,
    /// Why the plunge that is told is what it is.
    plunge_reasons: LoopReasons,
}

impl RunningCycle {
    /// A cycle that begins: at 100 %. `reasons` are those for which it stays neutral, and those that only cap it.
    #[must_use]
    pub fn new(
        begun: Begun,
        (control, neutral, capped): (Control, LoopReasons, LoopReasons),
        (channels, timing): (Vec<Channel>, Timing),
        (mode, settings): (Mode, LoopSettings),
    ) -> Self {
        let since_start = begun.sent_at.micros().saturating_sub(begun.started_at.micros());
        Self {
            mode,
            control,
            inputs: Inputs::among(&channels),
            record: Record::new(channels, timing, settings.most_samples),
            started_us: begun.received_at.micros().saturating_sub(since_start),
            #[expect(clippy::cast_possible_truncation, reason = "a limit of ages lies within a day")]
            slack_us: (settings.oldest_sample_ms * 1000.0) as i64,
            neutral,
            capped,
            passing: LoopReasons::NONE,
            cut_short: false,
            valid_until: begun.received_at.plus_millis(settings.validity_ms),
            age_ms: None,
            plunge: None,
            plunge_reasons: LoopReasons::NONE,
            settings,
        }
    }

    /// Goes on in the midst of the cycle after its memory was lost, at the override that the machine says is in force:
    /// the lower of 100 % and that.
    #[must_use]
    pub fn restarted(mut self, in_force_percent: f64) -> Self {
        self.control.resume_at(in_force_percent);
        self
    }

    /// Whether the override is told.
    #[must_use]
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// The samples so far.
    #[must_use]
    pub const fn record(&self) -> &Record {
        &self.record
    }

    /// Whether samples were not kept because there were too many, or the cycle was too long.
    #[must_use]
    pub const fn was_cut_short(&self) -> bool {
        self.cut_short
    }

    /// Least and greatest override that can be answered, percent; `None` where it is always neutral.
    #[must_use]
    pub fn bounds_percent(&self) -> Option<(f64, f64)> {
        self.control.bounds_percent()
    }

    /// Reasons that hold from the start: neutral or capped because of them.
    #[must_use]
    pub const fn standing_reasons(&self) -> LoopReasons {
        self.neutral.and(self.capped)
    }

    /// Sets what makes the answers neutral for a time, from now on.
    pub fn set_passing(&mut self, reasons: LoopReasons) {
        if self.passing.is_empty() && !reasons.is_empty() {
            self.withhold(None, reasons);
        }
        self.passing = reasons;
    }

    /// Somebody has acknowledged the overload.
    pub fn acknowledge(&mut self) {
        self.control.acknowledge();
        self.neutral = self.neutral.without(LoopReason::OverloadUnacknowledged);
        self.capped = self.capped.without(LoopReason::OverloadUnacknowledged);
    }

    /// Whether an overload of this cycle still holds the override.
    #[must_use]
    pub const fn is_overloaded(&self) -> bool {
        self.control.is_overloaded()
    }

    /// What the cycle was begun with holds no more: neutral from now on to its end, and never again more.
    pub fn outdate(&mut self) {
        if !self.neutral.contains(LoopReason::ChangedMeanwhile) {
            self.neutral.add(LoopReason::ChangedMeanwhile);
            self.withhold(None, self.neutral);
        }
    }

    /// Takes some samples; what each is answered is added to `each`, in their order.
    pub fn take(&mut self, now: Timestamp, batch: &Batch<'_>, each: &mut Vec<SampleAdvice>) -> Answer {
        let mut last = LoopReasons::NONE;
        let mut anything_new = false;
        for i in 0..batch.count {
            let n = batch.first.saturating_add(i as u64);
            let advice = if n < self.record.next() {
                self.earlier(now, batch, i, n)
            } else {
                anything_new = true;
                self.fresh(now, batch, i, n)
            };
            last = advice.reasons;
            each.push(advice);
        }
        if anything_new {
            self.valid_until = now.plus_millis(self.settings.validity_ms);
        }
        self.answer(now, last)
    }

    /// Passes a message that could not be read, or that is about nothing: neutral.
    pub fn fault(&mut self, now: Timestamp, reason: LoopReason) -> Answer {
        let advice = self.withhold(None, LoopReasons::of(reason));
        self.valid_until = now.plus_millis(self.settings.validity_ms);
        self.answer(now, advice.reasons)
    }

    /// What is in force, without anything new.
    #[must_use]
    pub fn standing(&self, now: Timestamp) -> Answer {
        self.answer(now, LoopReasons::NONE)
    }

    fn answer(&self, now: Timestamp, last: LoopReasons) -> Answer {
        let reasons = last.and(self.plunge_reasons).and(self.capped).and(self.neutral).and(self.passing);
        Answer {
            ovr: self.control.in_force(),
            reasons,
            next: self.record.next(),
            valid_until: self.valid_until,
            valid_for_ms: self.valid_until.millis_since(now).max(0),
            age_ms: self.age_ms,
            quality: reasons.quality(),
            plunge: self.plunge,
            overloaded: self.control.is_overloaded()
                || self.standing_reasons().contains(LoopReason::OverloadUnacknowledged),
        }
    }

    /// What is done for something that may not be judged, and why not.
    fn withhold(&mut self, time_ms: Option<f64>, why: LoopReasons) -> SampleAdvice {
        let (ovr, reasons, plunge) = self.control.withhold(time_ms, self.age_ms.unwrap_or(0.0));
        (self.plunge, self.plunge_reasons) = (plunge, reasons);
        SampleAdvice { ovr, reasons: why.and(reasons) }
    }

    /// A number that was passed already: its earlier answer where the content is the same; else neutral.
    fn earlier(&mut self, now: Timestamp, batch: &Batch<'_>, i: usize, n: u64) -> SampleAdvice {
        if !self.record.has(n) {
            let time_ms = self.record.time_ms(batch, i);
            self.age_ms = Some(self.age_ms_of(now, time_ms));
            let reasons = self.watch(batch, i, time_ms).and(LoopReasons::of(LoopReason::OutOfOrder));
            let advice = self.withhold(None, reasons);
            self.record.keep(batch, i, advice);
            return advice;
        }
        match self.record.advice(n) {
            Some(advice) if self.record.is_same(batch, i) => {
                SampleAdvice { reasons: advice.reasons.and(LoopReasons::of(LoopReason::Repeated)), ..advice }
            }
            _ => self.withhold(None, LoopReasons::of(LoopReason::RepeatDiffers)),
        }
    }

    /// A number that was not passed yet.
    fn fresh(&mut self, now: Timestamp, batch: &Batch<'_>, i: usize, n: u64) -> SampleAdvice {
        let time_ms = self.record.time_ms(batch, i);
        let mut why = self.neutral.and(self.passing);
        // What holds from the start is no news of this sample; the rest decides whether it is judged.
        if n > self.record.next() {
            why.add(LoopReason::MissingSamples);
        }
        let kept = self.record.has_room_for(n);
        if !kept {
            why.add(LoopReason::TooManySamples);
        }
        let too_long = time_ms > self.settings.longest_cycle_ms;
        if too_long {
            why.add(LoopReason::CycleTooLong);
        }
        let mut never_taken = false;
        if time_ms.is_finite() {
            let age_ms = self.age_ms_of(now, time_ms);
            self.age_ms = Some(age_ms);
            if age_ms > self.settings.oldest_sample_ms {
                why.add(LoopReason::TooOld);
            } else if age_ms < 0.0 {
                why.add(LoopReason::FromFuture);
                // A wrong number, not a clock that runs fast: kept, it would make every true sample after it a late one, and
                // the cycle could not be ended.
                never_taken = n > self.record.next() && -age_ms > self.settings.oldest_sample_ms;
            }
        }
        // What was never taken is no part of the cycle that is missing: the machine still has to send what is.
        self.cut_short |= !never_taken && (!kept || too_long);
        let advice = if why.is_empty() {
            let seen = self.seen(batch, i, time_ms);
            let (ovr, reasons, plunge) = self.control.step(&seen);
            self.plunge_reasons = if plunge.is_some() { reasons } else { LoopReasons::NONE };
            self.plunge = plunge;
            SampleAdvice { ovr, reasons: reasons.and(self.capped) }
        } else {
            if !never_taken {
                why = why.and(self.watch(batch, i, time_ms));
            }
            // A time that was never passes for nobody.
            self.withhold(Some(time_ms).filter(|_| !never_taken), why)
        };
        if kept && !too_long && !never_taken {
            self.record.keep(batch, i, advice);
        }
        advice
    }

    fn seen(&self, batch: &Batch<'_>, i: usize, time_ms: f64) -> Seen {
        let age_ms = self.age_ms.unwrap_or(0.0);
        Seen::of(&self.inputs, batch.values, batch.count, i, time_ms, age_ms)
    }

    /// Looks for an overload in a sample that is not judged: a crash that is told late, or ahead of time, is one.
    fn watch(&mut self, batch: &Batch<'_>, i: usize, time_ms: f64) -> LoopReasons {
        if self.neutral.contains(LoopReason::UnknownRating) {
            // Nobody knows what such a load is a percentage of.
            return LoopReasons::NONE;
        }
        let seen = self.seen(batch, i, time_ms);
        self.control.watch(&seen)
    }

    /// Age of a sample, ms. The message that began the cycle may have taken longer than the ones after it: a sample
    /// that seems to lie ahead moves the start, within bounds; what then still lies ahead was never measured.
    fn age_ms_of(&mut self, now: Timestamp, time_ms: f64) -> f64 {
        #[expect(clippy::cast_possible_truncation, reason = "casts saturate, and such a time is refused")]
        let taken_us = self.started_us.saturating_add((time_ms * 1000.0) as i64);
        let mut age_us = now.micros().saturating_sub(taken_us);
        let ahead_us = age_us.saturating_neg();
        if (1..=self.slack_us).contains(&ahead_us) {
            self.slack_us -= ahead_us;
            self.started_us = self.started_us.saturating_sub(ahead_us);
            age_us = 0;
        }
        #[expect(clippy::cast_precision_loss, reason = "far below 2^53 µs")]
        let age_ms = age_us as f64 / 1000.0;
        age_ms
    }
}

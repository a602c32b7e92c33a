//! State and step of the override law.

use super::config::{Heating, IMPLAUSIBLE_LOAD_PERCENT, LawConfig, LawParams, OverloadHold};
use super::equations::{correction, next_override, relative_load};
use super::reason::{Reason, Reasons};
use crate::friction::feed_override::{FeedOverride, NEUTRAL_PERCENT};
use crate::friction::filter::LoadFilter;

/// What the machine reports in one IPO cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LawSample {
    /// Time since the start of the cycle in ms: samples are told apart and gaps found by it.
    pub time_ms: f64,
    /// Time since first contact in ms; `None` while the tip is not in the work, where the law is off.
    pub contact_ms: Option<f64>,
    /// Tip depth in mm, if known; only needed where the heating ends at a depth.
    pub depth_mm: Option<f64>,
    /// Feed-drive load L_Z in percent of its rating, if there was a reading.
    pub feed_drive_percent: Option<f64>,
    /// Spindle load L_C in percent of its rating, if there was a reading.
    pub spindle_percent: Option<f64>,
}

/// A drive whose load the law watches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drive {
    /// Feed drive, Z.
    Feed,
    /// Spindle drive, C.
    Spindle,
}

/// The answer to one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LawStep {
    /// The override to apply from now on.
    pub ovr: FeedOverride,
    /// Why it is what it is.
    pub reasons: Reasons,
    /// The larger relative load L_R (Eq. 2) and its drive; `None` without good data.
    pub relative_load: Option<(f64, Drive)>,
    /// The correction C_F (Eq. 3); `None` where the law did not act.
    pub correction: Option<f64>,
}

/// Memory of the law within one cycle. A new cycle starts with a new state, at 100 %.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LawState {
    pub(super) ovr: FeedOverride,
    loads: Loads,
    last_time_ms: Option<f64>,
    /// The samples that are only watched have a memory of their own: the law's begins anew after them.
    watched: Loads,
    watched_time_ms: Option<f64>,
    heated: bool,
    settling: u32,
    overloaded: bool,
    /// An overload of before the cycle holds it too.
    held: bool,
}

impl Default for LawState {
    fn default() -> Self {
        Self::new()
    }
}

impl LawState {
    /// The state at the start of a cycle.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            ovr: FeedOverride::NEUTRAL,
            loads: Loads::new(),
            last_time_ms: None,
            watched: Loads::new(),
            watched_time_ms: None,
            heated: false,
            settling: 0,
            overloaded: false,
            held: false,
        }
    }

    /// The same held by an overload of before that nobody has acknowledged: the law may lower, and not raise.
    #[must_use]
    pub const fn held(self) -> Self {
        Self { held: true, ..self }
    }

    /// The state of a cycle that goes on after its memory was lost, at the override that the machine says is in force:
    /// the lower of 100 % and that, and no rise before `settling_samples` good samples.
    #[must_use]
    pub fn resuming(self, config: &LawConfig, in_force_percent: f64) -> Self {
        let mut state = Self { settling: config.params().settling_samples, held: self.held, ..Self::new() };
        state.ovr = config.params().bounds.clamp(in_force_percent).0.neutral_from();
        state
    }

    /// Takes a sample that may not be judged, whatever it says: neutral, as for bad data. The reason is the caller's.
    pub fn withhold(&mut self, config: &LawConfig, time_ms: Option<f64>) -> FeedOverride {
        self.last_time_ms = time_ms.filter(|time| time.is_finite()).or(self.last_time_ms);
        self.neutral(config.params().settling_samples, Reasons::default(), config).ovr
    }

    /// The tool is at the work again: the filters start anew, and the law may not raise before `settling_samples` good
    /// samples have come.
    pub const fn begin_anew(&mut self, config: &LawConfig) {
        self.loads = Loads::new();
        self.settling = config.params().settling_samples;
    }

    /// The next sample raises nothing, whatever it reads: the tool may not be at the work. The law may lower.
    pub const fn settle(&mut self, config: &LawConfig) {
        let samples = config.params().settling_samples;
        self.settling = if samples > 1 { samples } else { 1 };
    }

    /// Looks for an overload in a sample that the law may not judge, because it came late or nobody knows whose the
    /// machine is: the tool met that load all the same. Returns whether it is one; the override is [`Self::withhold`]'s.
    ///
    /// As where the law judges, a sample after a gap only ends the gap.
    pub fn watch(&mut self, config: &LawConfig, sample: &LawSample) -> bool {
        let params = config.params();
        let follows = self.watched_time_ms.is_some()
            && !time_is_bad(self.watched_time_ms, params.longest_gap_ms, sample.time_ms);
        self.watched_time_ms = Some(sample.time_ms).filter(|time| time.is_finite());
        let mut unusable = Reasons::default();
        let loads = Loads::of(params, sample, &mut unusable);
        if !follows || !unusable.is_empty() {
            self.watched = Loads::new();
            return false;
        }
        let overload = self.watched.step(params, loads).is_some_and(|(load, _)| is_overload(params, load));
        self.overloaded |= overload;
        overload
    }

    /// The override in force.
    #[must_use]
    pub const fn ovr(&self) -> FeedOverride {
        self.ovr
    }

    /// Whether an overload of this cycle still holds the override.
    #[must_use]
    pub const fn is_overloaded(&self) -> bool {
        self.overloaded
    }

    /// Somebody has seen the overload: the law may act again, where the configuration lets it.
    pub const fn acknowledge(&mut self, config: &LawConfig) {
        self.held = false;
        if matches!(config.params().overload, OverloadHold::UntilAcknowledged { .. }) {
            self.overloaded = false;
        }
    }

    /// Takes one sample and returns the override for the next IPO, with its reasons.
    ///
    /// The override never rises on a sample that is missing, not finite, implausible or out of time; it then
    /// is the lower of 100 % and the override in force, the filters start anew, and the law may not raise
    /// before `settling_samples` good samples have come.
    pub fn step(&mut self, config: &LawConfig, sample: &LawSample) -> LawStep {
        let params = config.params();
        let mut reasons = Reasons::default();

        if time_is_bad(self.last_time_ms, params.longest_gap_ms, sample.time_ms) {
            reasons.add(Reason::Gap);
        }
        let step_ms = self.last_time_ms.map(|last| sample.time_ms - last);
        self.last_time_ms = Some(sample.time_ms).filter(|time| time.is_finite()).or(self.last_time_ms);
        let loads = Loads::of(params, sample, &mut reasons);
        if !reasons.is_empty() {
            return self.neutral(params.settling_samples, reasons, config);
        }

        let Some((load, drive)) = self.loads.step(params, loads) else {
            // No drive has a preferred load; the constructor refuses that.
            reasons.add(Reason::MissingLoad);
            return self.neutral(params.settling_samples, reasons, config);
        };

        if is_overload(params, load) {
            self.overloaded = true;
            reasons.add(Reason::Overload);
        }
        if self.is_heating(params.heating, sample, &mut reasons) {
            reasons.add(Reason::Heating);
            self.settling = self.settling.saturating_sub(1);
            self.ovr = config.params().bounds.clamp(self.ovr.neutral_from().percent()).0;
            return LawStep { ovr: self.ovr, reasons, relative_load: Some((load, drive)), correction: None };
        }

        let c = correction(load, params.intensity);
        let highest = params.bounds.profile().max_percent();
        let in_force = self.ovr.percent();
        let mut wish = next_override(in_force, load, c, highest);
        // At the highest override nothing is left to rise by.
        let at_the_top = load < 1.0 && in_force >= highest;
        reasons.add(if load > 1.0 {
            Reason::LoadAboveSet
        } else if wish > in_force || at_the_top {
            Reason::LoadBelowSet
        } else {
            Reason::LoadAtSet
        });
        if at_the_top {
            reasons.add(Reason::ClampedProfileMax);
        }
        if self.overloaded || self.held {
            wish = wish.min(self.ovr.neutral_from().percent());
        }
        if self.overloaded {
            reasons.add(Reason::OverloadHeld);
        }
        if wish > in_force {
            if self.settling > 0 {
                wish = in_force;
                reasons.add(Reason::Settling);
            } else if let Some(points) = params.rise_limit_points {
                // Samples that come faster than they were declared must not raise faster.
                let points = points * step_ms.map_or(1.0, |step| (step / params.period_ms).min(1.0));
                if wish > in_force + points {
                    wish = in_force + points;
                    reasons.add(Reason::RiseLimited);
                }
            }
        }
        self.settling = self.settling.saturating_sub(1);
        self.ovr = clamped(config, wish, &mut reasons);
        LawStep { ovr: self.ovr, reasons, relative_load: Some((load, drive)), correction: Some(c) }
    }

    /// Keeps the override within what the feed limits leave of it where the tip is, after a step on good data: at most
    /// `high_percent`, and fallen no further than to `low_percent`. A rise is never made by it.
    pub fn keep_within_feed(
        &mut self,
        config: &LawConfig,
        (low_percent, high_percent): (f64, f64),
        before: FeedOverride,
        step: &mut LawStep,
    ) {
        let wish = self.ovr.percent();
        let least = low_percent.min(before.percent()).min(NEUTRAL_PERCENT);
        let kept = if wish > high_percent {
            step.reasons.add(Reason::ClampedFeedMax);
            high_percent
        } else if wish < least {
            step.reasons.add(Reason::ClampedFeedMin);
            least.min(high_percent)
        } else {
            return;
        };
        self.ovr = clamped(config, kept, &mut step.reasons);
        step.ovr = self.ovr;
    }

    /// Once the heating is over it stays over. Out of the work the law is off all the same: a light load there says nothing
    /// about the work.
    fn is_heating(&mut self, heating: Heating, sample: &LawSample, reasons: &mut Reasons) -> bool {
        let Some(contact_ms) = sample.contact_ms else { return true };
        if self.heated {
            return false;
        }
        self.heated = match heating {
            Heating::None => true,
            Heating::Time { ms } => contact_ms >= ms,
            Heating::Depth { mm } => {
                let depth = sample.depth_mm.filter(|depth| depth.is_finite());
                if depth.is_none() {
                    reasons.add(Reason::UnknownDepth);
                }
                depth.is_some_and(|depth| depth >= mm)
            }
        };
        !self.heated
    }

    fn neutral(&mut self, settling: u32, mut reasons: Reasons, config: &LawConfig) -> LawStep {
        self.loads = Loads::new();
        self.settling = settling;
        self.ovr = clamped(config, self.ovr.neutral_from().percent(), &mut reasons);
        LawStep { ovr: self.ovr, reasons, relative_load: None, correction: None }
    }
}

/// The filtered loads of both drives.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Loads {
    feed: LoadFilter,
    spindle: LoadFilter,
}

/// A drive's load beside its preferred value, both in percent.
type Load = Option<(f64, f64)>;

impl Loads {
    const fn new() -> Self {
        Self { feed: LoadFilter::new(), spindle: LoadFilter::new() }
    }

    /// Feed drive and spindle of a sample, with the reasons why one of them cannot be used.
    fn of(params: &LawParams, sample: &LawSample, reasons: &mut Reasons) -> [Load; 2] {
        let feed = usable(params.set_feed_drive_percent, sample.feed_drive_percent, reasons);
        [feed, usable(params.set_spindle_percent, sample.spindle_percent, reasons)]
    }

    /// Takes the loads of one sample: the larger relative load L_R and its drive.
    fn step(&mut self, params: &LawParams, [feed, spindle]: [Load; 2]) -> Option<(f64, Drive)> {
        let weights = &params.weights;
        let feed = feed.map(|(load, set)| (relative_load(self.feed.step(weights, load), set), Drive::Feed));
        let spindle =
            spindle.map(|(load, set)| (relative_load(self.spindle.step(weights, load), set), Drive::Spindle));
        match (feed, spindle) {
            (Some(f), Some(s)) => Some(if s.0 > f.0 { s } else { f }),
            (one, other) => one.or(other),
        }
    }
}

/// Whether a relative load counts as an overload.
fn is_overload(params: &LawParams, load: f64) -> bool {
    match params.overload {
        OverloadHold::Off => false,
        OverloadHold::UntilAcknowledged { relative_load }
        | OverloadHold::UntilNextCycle { relative_load } => load >= relative_load,
    }
}

/// Time has to advance by no more than the longest gap; the first sample of a cycle has no step.
pub(crate) fn time_is_bad(last_ms: Option<f64>, longest_gap_ms: f64, time_ms: f64) -> bool {
    if !time_ms.is_finite() {
        return true;
    }
    last_ms.is_some_and(|last| {
        let step = time_ms - last;
        step <= 0.0 || step > longest_gap_ms
    })
}

fn clamped(config: &LawConfig, wish: f64, reasons: &mut Reasons) -> FeedOverride {
    let (ovr, clamp) = config.params().bounds.clamp(wish);
    if let Some(clamp) = clamp {
        reasons.add(clamp.into());
    }
    ovr
}

/// The load and its preferred value, or the reason why there is none; a drive without a preferred load is not
/// watched and may be missing.
fn usable(set: Option<f64>, load: Option<f64>, reasons: &mut Reasons) -> Option<(f64, f64)> {
    let set = set?;
    match load {
        None => reasons.add(Reason::MissingLoad),
        Some(load) if !load.is_finite() => reasons.add(Reason::NotFiniteLoad),
        Some(load) if load.abs() > IMPLAUSIBLE_LOAD_PERCENT => reasons.add(Reason::ImplausibleLoad),
        // Below none there is no load: kept in the filter's memory, it would hide a true one for some samples.
        Some(load) => return Some((load.max(0.0), set)),
    }
    None
}

//! What a process adds to a recommendation: the next speed and feed of turning, the plunge feed of a plunge.
//!
//! Only an operation that names its library entry gets any of it. Whatever is missing is said and nothing is advised:
//! the program runs as it is. Vibratory drilling adds nothing here: its loop belongs on the control.

use super::{Action, Question};
use crate::ids::ModelId;
use crate::operation::Operation;
use crate::plunge::{self, MachineInput, Material, PLUNGE_LAW_VERSION, PlungeLimit, PlungeSetup};
use crate::summary::{COVERAGE_FLOOR, longest_ms};
use crate::turning::{
    AdaptationInput, Binding, Chosen, Corrections, Cut, EdgeInterval, EdgeState, Job, Limit,
    MAX_EDGE_INTERVALS, Measured, NextCut, Readings, TURNING_LAW_VERSION, TurningModel, TurningSetup,
    next_cut,
};
use crate::units::Process;

/// Most cycles of one edge that are read for an answer.
pub const MAX_EDGE_CYCLES: usize = MAX_EDGE_INTERVALS;

/// What is known for an operation's process.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Knowledge {
    /// Nothing: the operation asks for nothing.
    #[default]
    None,
    /// Of turning.
    Turning {
        /// The library entry, where it exists.
        model: Option<Box<TurningModel>>,
        /// What the edge has cut.
        history: EdgeHistory,
    },
    /// Of a plunge: the library entry, where it exists.
    Plunge(Option<Box<Material>>),
    /// The library entry was found damaged where it is stored.
    Damaged,
}

/// What an edge has cut since it was new.
#[derive(Debug, Clone, PartialEq)]
pub enum EdgeHistory {
    /// No event says that a new edge was mounted, or the last one says that it was not new.
    NotNew,
    /// More cycles than [`MAX_EDGE_CYCLES`].
    TooLong,
    /// Cycles whose clock was never set have come since a new edge was mounted: nobody knows whether it cut them.
    Untimed,
    /// Every cycle since, in the order in which they were run.
    Cycles(Vec<EdgeCycle>),
}

/// What one cycle of an edge tells; absent where it does not.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EdgeCycle {
    /// How its operation is turned, at the depth and the diameter that held when it was run.
    pub setup: Option<TurningSetup>,
    /// Length of what was sampled, ms; the one reported where no time was sampled.
    pub duration_ms: Option<f64>,
    /// Length as reported, ms.
    pub reported_duration_ms: Option<f64>,
    /// Number of its samples.
    pub sample_count: u32,
    /// Share of the sampled time that is no gap, 0 to 1.
    pub coverage: f64,
    /// Whether the server kept only a part of it.
    pub cut_short: bool,
    /// Cutting speed as reported, m/min.
    pub speed_m_min: Option<f64>,
    /// Spindle speed, 1/min.
    pub spindle_rpm: Option<f64>,
    /// Feed, mm/rev.
    pub feed_mm_rev: Option<f64>,
    /// Power at its end, W.
    pub power_watts: Option<f64>,
    /// The spindle's energy from measured power, between its first and its last sample, J.
    pub spindle_joules: Option<f64>,
    /// Thrust force at its end, N.
    pub force_newtons: Option<f64>,
    /// Wear measured after it, mm.
    pub wear_mm: Option<f64>,
}

impl EdgeCycle {
    /// The interval it stands for; none where speed, feed or length are not told.
    fn interval(&self, setup: &TurningSetup) -> Option<EdgeInterval> {
        let speed = self.speed_m_min.or_else(|| setup.speed_m_min(self.spindle_rpm?))?;
        let minutes = self.length_ms().filter(|length| *length > 0.0)? / 60_000.0;
        Some(EdgeInterval {
            depth_mm: setup.depth_mm,
            cut: Cut::new(speed, self.feed_mm_rev?).ok()?,
            minutes,
            measured: Measured {
                power_kw: self.power_watts.map(|watts| watts / 1000.0),
                force_n: self.force_newtons,
                wear_mm: self.wear_mm,
            },
            mean_power_kw: self.mean_power_kw(),
        })
    }

    /// How long the edge cut, ms: what is longer wears more.
    fn length_ms(&self) -> Option<f64> {
        longest_ms(self.duration_ms, self.reported_duration_ms)
    }

    /// Mean power over it, kW; none where samples cover too little of it to speak for the whole.
    ///
    /// The energy is the sum of trapezoids between samples, one fewer than there are samples, a gap as long as a usual one: over the
    /// time of these it is a mean whatever the rate of sampling. That time is told exactly for samples in a fixed period and for
    /// evenly spaced stamps; one sample alone stands for its own period.
    fn mean_power_kw(&self) -> Option<f64> {
        let joules = self.spindle_joules.filter(|joules| *joules > 0.0)?;
        let covered_ms = self.duration_ms? * self.coverage;
        if self.sample_count == 0 || covered_ms <= 0.0 || covered_ms < COVERAGE_FLOOR * self.length_ms()? {
            return None;
        }
        let count = f64::from(self.sample_count);
        let between = if self.sample_count > 1 { (count - 1.0) / count } else { 1.0 };
        // J/ms is kW.
        Some(joules / (covered_ms * between))
    }
}

/// What a process adds.
#[derive(Debug, Clone, PartialEq)]
pub enum ProcessAdvice {
    /// Turning.
    Turning(TurningAdvice),
    /// Plunge.
    Plunge(PlungeAdvice),
}

/// State of a turning edge and its next pair.
#[derive(Debug, Clone, PartialEq)]
pub struct TurningAdvice {
    /// Version of the rules that made it.
    pub law_version: String,
    /// Library entry.
    pub model: ModelId,
    /// Cutting time since the edge was new, min.
    pub elapsed_min: f64,
    /// What was learnt.
    pub corrections: Corrections,
    /// What that rests on.
    pub readings: Readings,
    /// What to cut next; none where the edge is spent or nothing is advised, as the reasons say.
    pub next: Option<TurningNext>,
    /// The limit that leaves no pair.
    pub ended_by: Option<Limit>,
}

/// The next pair.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TurningNext {
    /// Cutting speed, m/min.
    pub speed_m_min: f64,
    /// Feed, mm/rev.
    pub feed_mm_rev: f64,
    /// Spindle speed, 1/min, where the diameter is known.
    pub spindle_rpm: Option<f64>,
    /// Feed rate, mm/min, where the diameter is known.
    pub feed_mm_min: Option<f64>,
    /// Length of the interval it is meant for, min.
    pub interval_min: f64,
    /// Wear expected at its end, mm.
    pub wear_mm: f64,
    /// Power expected at its end, kW.
    pub power_kw: f64,
    /// Force expected at its end, N.
    pub force_n: f64,
    /// Removal rate, mm³/min.
    pub removal_mm3_min: f64,
    /// What keeps it from being faster.
    pub binding: Binding,
}

/// Plunge feed of an operation's drill on this machine.
#[derive(Debug, Clone, PartialEq)]
pub struct PlungeAdvice {
    /// Version of the rules that made it.
    pub law_version: String,
    /// Library entry.
    pub material: ModelId,
    /// Most plunge feed, mm/min; none where the drill cannot plunge on this machine.
    pub feed_mm_min: Option<f64>,
    /// What bounds it.
    pub limit: PlungeLimit,
    /// How far the drill bites before the axis reacts, mm.
    pub bite_mm: Option<f64>,
}

/// What the operation's process adds, with the reasons for it or against it; `stale` tells whether the tool's data is older than
/// data stays good, which has been said.
pub(super) fn advise(
    question: &Question<'_>,
    operation: &Operation,
    stale: bool,
    action: &mut Action,
    say: &mut impl FnMut(&str, &str),
) -> Option<ProcessAdvice> {
    match (operation.process, &operation.turning, &operation.plunge) {
        (Process::Turning, None, _) => {
            say("no_turning_model", "the operation names no turning model: run its program as it is");
            None
        }
        (Process::Turning, Some(setup), _) => {
            turning(question, setup, stale, action, say).map(ProcessAdvice::Turning)
        }
        (Process::Plunge, _, None) => {
            say("no_plunge_material", "the operation names no material: run its program as it is");
            None
        }
        (Process::Plunge, _, Some(setup)) => plunge(question, setup, *action, say).map(ProcessAdvice::Plunge),
        _ => None,
    }
}

fn turning(
    question: &Question<'_>,
    setup: &TurningSetup,
    stale: bool,
    action: &mut Action,
    say: &mut impl FnMut(&str, &str),
) -> Option<TurningAdvice> {
    let (job, intervals) = match known(question, setup) {
        Ok(known) => known,
        Err((code, why)) => {
            say(code, why);
            return None;
        }
    };
    let found =
        next_cut(&job, AdaptationInput::default(), setup.caution_sigmas, EdgeState::FRESH, &intervals);
    let Ok(NextCut { state, corrections, readings, choice }) = found else {
        say(
            "turning_history_unusable",
            "a cycle of the edge tells what cannot have been cut: no pair is advised",
        );
        return None;
    };
    // Said whatever follows: an edge that is spent by such readings may be none.
    if corrections.implausible() {
        say(
            "turning_readings_implausible",
            "power, force or wear read on this edge is far from what its model can explain: check the sensors and \
             their units; no pair is advised",
        );
    }
    let mut advice = TurningAdvice {
        law_version: TURNING_LAW_VERSION.to_owned(),
        model: setup.model.clone(),
        elapsed_min: state.elapsed_min(),
        corrections,
        readings,
        next: None,
        ended_by: None,
    };
    match choice {
        Err(limit) => {
            advice.ended_by = Some(limit);
            say("turning_edge_spent", "every further interval would break a limit: change the edge");
            if *action == Action::Run {
                *action = Action::ChangeTool;
            }
        }
        // A unit slip and a dead sensor look like an edge that bears more: unknown never raises the feed.
        Ok(_) if corrections.implausible() => {}
        // What the edge has cut since then may just not have come: the reason is `data_stale`.
        Ok(_) if stale => {}
        Ok(chosen) => advice.next = offered(question, setup, &chosen, *action, say),
    }
    Some(advice)
}

/// The job and everything the edge has cut, or why that is not known.
fn known(
    question: &Question<'_>,
    setup: &TurningSetup,
) -> Result<(Job, Vec<EdgeInterval>), (&'static str, &'static str)> {
    let Knowledge::Turning { model: Some(model), history } = question.knowledge else {
        return Err((
            "turning_model_missing",
            "the library holds no such turning model: run the program as it is",
        ));
    };
    let cycles = match history {
        EdgeHistory::NotNew => {
            return Err((
                "turning_edge_unknown",
                "no event says that a new edge was mounted: its wear is not known",
            ));
        }
        EdgeHistory::TooLong => {
            return Err((
                "turning_history_too_long",
                "the edge has more cycles than are looked at: mount a new one",
            ));
        }
        EdgeHistory::Untimed => {
            return Err((
                "turning_history_untold",
                "cycles whose clock was never set have come since the edge was mounted: its wear is not known",
            ));
        }
        EdgeHistory::Cycles(cycles) => cycles,
    };
    let mut intervals = Vec::with_capacity(cycles.len());
    for cycle in cycles {
        let Some(of) = cycle.setup.as_ref().filter(|of| of.model == setup.model) else {
            return Err((
                "turning_other_model",
                "the edge has cut in an operation without this model: its wear is not known",
            ));
        };
        if cycle.cut_short {
            return Err((
                "turning_history_untold",
                "the server kept only a part of a cycle of the edge: its wear is not known",
            ));
        }
        let Some(interval) = cycle.interval(of) else {
            return Err((
                "turning_history_untold",
                "a cycle of the edge does not tell its speed, feed or length: its wear is not known",
            ));
        };
        intervals.push(interval);
    }
    let job = setup.job(model.as_ref().clone());
    let job = job.map_err(|_| {
        ("turning_setup_unusable", "the operation's turning cannot be planned: run the program as it is")
    })?;
    Ok((job, intervals))
}

/// The pair, where nothing speaks against running it.
fn offered(
    question: &Question<'_>,
    setup: &TurningSetup,
    chosen: &Chosen,
    action: Action,
    say: &mut impl FnMut(&str, &str),
) -> Option<TurningNext> {
    if action != Action::Run {
        say("turning_withheld", "the tool is to be looked at first: no pair is advised");
        return None;
    }
    if chosen.outside.any() {
        say(
            "turning_outside_model",
            "the pair lies outside what the model was fitted for: it is not advised",
        );
        return None;
    }
    let spindle_rpm = setup.spindle_rpm(chosen.cut);
    let feed_mm_min = spindle_rpm.map(|rpm| rpm * chosen.cut.feed_mm_rev());
    if feed_mm_min.is_some_and(|feed| feed > question.machine.limits.max_mm_min()) {
        say("turning_above_feed_max", "the pair's feed rate is above the machine's limit: it is not advised");
        return None;
    }
    if feed_mm_min.is_some_and(|feed| feed < question.machine.limits.min_mm_min()) {
        // A faster pair would break what the model holds to, so the machine's least feed is out of reach.
        say("turning_below_feed_min", "the pair's feed rate is below the machine's least: it is not advised");
        return None;
    }
    say(
        "turning_advised",
        "the next speed and feed follow from the model and what was measured on this edge",
    );
    Some(TurningNext {
        speed_m_min: chosen.cut.speed_m_min(),
        feed_mm_rev: chosen.cut.feed_mm_rev(),
        spindle_rpm,
        feed_mm_min,
        interval_min: setup.interval_min,
        wear_mm: chosen.outcome.wear_mm,
        power_kw: chosen.outcome.power_kw,
        force_n: chosen.outcome.force_n,
        removal_mm3_min: chosen.outcome.removal_mm3_min,
        binding: chosen.binding,
    })
}

fn plunge(
    question: &Question<'_>,
    setup: &PlungeSetup,
    action: Action,
    say: &mut impl FnMut(&str, &str),
) -> Option<PlungeAdvice> {
    let Knowledge::Plunge(Some(material)) = question.knowledge else {
        say("plunge_material_missing", "the library holds no such material: run the program as it is");
        return None;
    };
    let limits = &question.machine.limits;
    let range =
        MachineInput { least_feed_mm_min: limits.min_mm_min(), greatest_feed_mm_min: limits.max_mm_min() };
    let feed = plunge::Machine::new(range).and_then(|machine| setup.feed(material, &machine));
    let Ok(feed) = feed else {
        say("plunge_setup_unusable", "the operation's plunge cannot be computed: run the program as it is");
        return None;
    };
    if feed.feed_mm_min.is_some() && action != Action::Run {
        // A plunge meets the work faster than its program: not with a tool that may be another, worn or broken.
        say("plunge_withheld", "the tool is to be looked at first: no plunge feed is advised");
        return None;
    }
    if feed.feed_mm_min.is_some() {
        say("plunge_advised", "the plunge feed is what the drill, the machine and the loop bear");
    } else {
        say("plunge_impossible", "the drill bears no plunge on this machine: run the program as it is");
    }
    Some(PlungeAdvice {
        law_version: PLUNGE_LAW_VERSION.to_owned(),
        material: setup.material.clone(),
        feed_mm_min: feed.feed_mm_min,
        limit: feed.limit,
        bite_mm: feed.bite_mm,
    })
}

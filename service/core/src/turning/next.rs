//! The next pair of a running edge, from every interval it has cut since it was new.
//!
//! A fold over the edge's intervals in their order: the same intervals give the same bits however they arrived. What
//! cannot be told is never guessed: an interval of unknown speed or feed leaves the edge's state unknown, and
//! unknown never raises the feed, so then there is no next pair, and the reason why.
//!
//! Readings that cannot be true raise it no more than that (`doubted`).

use crate::field_error::FieldError;

use super::adapt::BeyondGate;
use super::{
    Adaptation, AdaptationInput, AdaptationSettings, Chosen, Corrections, Cut, EdgeState, Job, Limit,
    Measured, Selector,
};

/// Version of the rules below; part of every advice.
pub const TURNING_LAW_VERSION: &str = "turning-2";

/// Most intervals of an edge that are folded for one answer: some 10 ms of computing, thrice where readings of it
/// are in doubt, and 33 hours of minutes.
pub const MAX_EDGE_INTERVALS: usize = 2_000;

/// One interval that an edge has cut.
#[derive(Debug, Clone, PartialEq)]
pub struct EdgeInterval {
    /// Depth of cut, mm.
    pub depth_mm: f64,
    /// Speed and feed.
    pub cut: Cut,
    /// How long, min.
    pub minutes: f64,
    /// What was read at its end.
    pub measured: Measured,
    /// Mean power over the interval, kW: stands in where none was read at the end.
    pub mean_power_kw: Option<f64>,
}

/// Steps of the mean over an interval; twice as many move it by less than a thousandth.
const MEAN_STEPS: u32 = 16;

/// Power at the end of an interval over its mean, as the law has it.
///
/// Power rises with wear during an interval. Taken for the end's, a mean would teach that the law asks too much, and
/// raise the feed.
fn end_over_mean(job: &Job, state: EdgeState, cut: Cut, minutes: f64) -> f64 {
    let exponent = job.model().data().power.wear_exponent;
    let at = |share: f64| {
        let gained = job.wear_gain_over(state.elapsed_min(), minutes * share) * job.severity(cut);
        job.wear_of(job.measure(state.wear_mm()) + gained).powf(exponent)
    };
    let steps = f64::from(MEAN_STEPS);
    let mean = (0..MEAN_STEPS).map(|k| at((f64::from(k) + 0.5) / steps)).sum::<f64>() / steps;
    at(1.0) / mean
}

/// How many readings an estimate rests on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Readings {
    /// Intervals.
    pub intervals: u32,
    /// Of power.
    pub power: u32,
    /// Of force.
    pub force: u32,
    /// Of wear.
    pub wear: u32,
}

impl Readings {
    const fn take(&mut self, read: &Measured) {
        self.intervals += 1;
        self.power += read.power_kw.is_some() as u32;
        self.force += read.force_n.is_some() as u32;
        self.wear += read.wear_mm.is_some() as u32;
    }
}

/// What an edge should cut next.
#[derive(Debug, Clone, PartialEq)]
pub struct NextCut {
    /// State of the edge that the pair was chosen for: as estimated, and where a reading could not be believed at least
    /// as worn as without it and as the library entry has it.
    pub state: EdgeState,
    /// What was learnt of the coefficients, from every reading.
    pub corrections: Corrections,
    /// What that rests on.
    pub readings: Readings,
    /// The pair with its prediction, or the limit that leaves none: the end of the edge's life.
    pub choice: Result<Chosen, Limit>,
}

/// Which readings a fold takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Taken {
    /// All; those beyond the gate count as exactly as far off.
    All,
    /// Those within the gate.
    Plausible,
    /// None: the library entry by itself.
    None,
}

/// An edge's intervals folded in their order.
struct Folded {
    adaptation: Adaptation,
    readings: Readings,
    /// Whether any interval had a reading beyond the gate or left a factor at its bound.
    doubted: bool,
}

fn fold(
    job: &Job,
    start: Adaptation,
    intervals: &[EdgeInterval],
    taken: Taken,
) -> Result<Folded, (Option<usize>, FieldError)> {
    let beyond_gate = if taken == Taken::All { BeyondGate::Cut } else { BeyondGate::LeftOut };
    let mut adaptation = start.with(beyond_gate);
    let mut readings = Readings::default();
    let mut doubted = false;
    for (index, interval) in intervals.iter().enumerate() {
        let here = |error| (Some(index), error);
        let at_depth = job.at_depth(interval.depth_mm).map_err(here)?;
        let mut read = if taken == Taken::None { Measured::default() } else { interval.measured };
        if let (Taken::All | Taken::Plausible, None, Some(mean)) =
            (taken, read.power_kw, interval.mean_power_kw)
        {
            let ratio = end_over_mean(&at_depth, adaptation.state(), interval.cut, interval.minutes);
            read.power_kw = Some(mean * ratio);
        }
        let learnt = adaptation.observe(&at_depth, interval.cut, interval.minutes, read).map_err(here)?;
        doubted |= learnt.implausible();
        readings.take(&read);
    }
    Ok(Folded { adaptation, readings, doubted })
}

/// The state and the job to choose from where a reading of the edge cannot be believed.
///
/// Power in kW where W are asked for, a sensor that stands at 1 W, wear that is always 0: each looks like an edge that
/// bears far more. So nothing is taken to be milder than the library entry has it, nor than the readings within the gate
/// alone say; what the others say counts only where it is worse.
fn doubted(
    job: &Job,
    start: &Adaptation,
    caution_sigmas: f64,
    all: &Adaptation,
    intervals: &[EdgeInterval],
) -> Result<(EdgeState, Job), (Option<usize>, FieldError)> {
    let mut wear_mm = all.state().wear_mm();
    let mut factors = all.factors(caution_sigmas);
    for taken in [Taken::Plausible, Taken::None] {
        let other = fold(job, start.clone(), intervals, taken)?.adaptation;
        wear_mm = wear_mm.max(other.state().wear_mm());
        // The entry alone is unsure of itself as before anything was measured: as it stands it is the least.
        let caution = if taken == Taken::None { 0.0 } else { caution_sigmas };
        for (factor, least) in factors.iter_mut().zip(other.factors(caution)) {
            *factor = factor.max(least);
        }
    }
    let [wear, power, force] = factors;
    let state = EdgeState::unchecked(all.state().elapsed_min(), wear_mm);
    Ok((state, job.with_model(job.model().scaled(wear, power, force))))
}

/// Folds an edge's intervals, from new, and chooses its next pair with the corrected coefficients.
///
/// `caution_sigmas` as for [`Adaptation::corrected`]. Where a reading was beyond the gate or a factor at its bound, now or
/// before, the pair is never faster than without it nor than by the library entry itself; whether it is to be run at
/// all is for who asks ([`Corrections::implausible`]).
///
/// # Errors
/// The index of the interval, or none for a setting, with what is wrong with it.
pub fn next_cut(
    job: &Job,
    settings: AdaptationInput,
    caution_sigmas: f64,
    start: EdgeState,
    intervals: &[EdgeInterval],
) -> Result<NextCut, (Option<usize>, FieldError)> {
    let setting = |error| (None, error);
    crate::field_error::count("intervals", intervals.len(), 0, MAX_EDGE_INTERVALS).map_err(setting)?;
    let settings = AdaptationSettings::new(settings).map_err(setting)?;
    let new = Adaptation::new(settings, start);
    let Folded { adaptation, readings, doubted: in_doubt } = fold(job, new.clone(), intervals, Taken::All)?;
    let corrected = adaptation.corrected(job, caution_sigmas).map_err(setting)?;
    let (state, corrected) = if in_doubt {
        doubted(job, &new, caution_sigmas, &adaptation, intervals)?
    } else {
        (adaptation.state(), corrected)
    };
    Ok(NextCut {
        state,
        corrections: adaptation.corrections(),
        readings,
        choice: Selector::new(&corrected).choose(state),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::turning::{JobInput, greedy_plan};

    fn told(measured: impl Fn(&Chosen) -> Measured) -> (Job, Vec<EdgeInterval>) {
        let job = Job::new(JobInput::alaskari_oraby_2017()).unwrap();
        let intervals = greedy_plan(&job, EdgeState::FRESH)
            .intervals
            .iter()
            .map(|chosen| EdgeInterval {
                depth_mm: 2.5,
                cut: chosen.cut,
                minutes: 1.0,
                measured: measured(chosen),
                mean_power_kw: None,
            })
            .collect();
        (job, intervals)
    }

    fn next(job: &Job, intervals: &[EdgeInterval], caution: f64) -> NextCut {
        next_cut(job, AdaptationInput::default(), caution, EdgeState::FRESH, intervals).unwrap()
    }

    #[test]
    fn an_edge_that_behaves_as_the_paper_gets_the_papers_choices() {
        let (job, intervals) = told(|chosen| Measured {
            power_kw: Some(chosen.outcome.power_kw),
            force_n: Some(chosen.outcome.force_n),
            wear_mm: None,
        });
        for (done, chosen) in greedy_plan(&job, EdgeState::FRESH).intervals.iter().enumerate() {
            assert_eq!(next(&job, &intervals[..done], 0.0).choice.unwrap().cut, chosen.cut, "{done}");
        }
        assert_eq!(next(&job, &intervals, 0.0).choice, Err(Limit::Wear));
        assert_eq!(next(&job, &intervals, 0.0).readings.power, 14);
    }

    #[test]
    fn an_edge_that_draws_more_is_slowed_and_caution_never_speeds_up() {
        let (job, intervals) =
            told(|chosen| Measured { power_kw: Some(chosen.outcome.power_kw * 1.2), ..Measured::default() });
        let removal = |caution: f64| {
            let choice = next(&job, &intervals[..5], caution).choice;
            choice.map_or(0.0, |chosen| chosen.outcome.removal_mm3_min)
        };
        let (job_removal, paper) = (removal(0.0), greedy_plan(&job, EdgeState::FRESH).intervals[5]);
        assert!(job_removal < paper.outcome.removal_mm3_min);
        assert!(removal(2.0) <= job_removal);
    }

    #[test]
    fn a_mean_is_not_taken_for_the_end() {
        let (job, mut intervals) = told(|_| Measured::default());
        let mut state = EdgeState::FRESH;
        for interval in &mut intervals {
            let end = job.predict(state, interval.cut);
            let mean = end.power_kw / end_over_mean(&job, state, interval.cut, 1.0);
            assert!(mean < end.power_kw);
            interval.mean_power_kw = Some(mean);
            state = EdgeState::new(state.elapsed_min() + 1.0, end.wear_mm).unwrap();
        }
        let learnt = next(&job, &intervals, 0.0).corrections;
        assert!((learnt.power_factor.value - 1.0).abs() < 1e-9, "{learnt:?}");
    }

    #[test]
    fn a_bad_interval_is_named() {
        let (job, mut intervals) = told(|_| Measured::default());
        intervals[3].measured.power_kw = Some(f64::NAN);
        let refused = next_cut(&job, AdaptationInput::default(), 0.0, EdgeState::FRESH, &intervals);
        let (index, error) = refused.unwrap_err();
        assert_eq!((index, error.field(), error.code()), (Some(3), "power_kw", "not_finite"));
    }
}

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
    use crate::turning::{
        Accumulation, DomainInput, JobInput, Limits, LoadLaw, ModelInput, Range, TurningModel, greedy_plan,
    };
    use proptest::prelude::*;

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

    /// Wear that grows faster and faster: a new edge has no slope of it by its own state.
    #[test]
    fn a_new_edge_whose_wear_speeds_up_is_read_like_any_other() {
        let mut data = TurningModel::alaskari_oraby_2017().data().clone();
        (data.wear.time_exponent, data.wear.coefficient) = (1.2, 2e-3);
        let model = TurningModel::new(data).unwrap();
        let accumulation = Accumulation::State;
        let job = Job::new(JobInput { model, accumulation, ..JobInput::alaskari_oraby_2017() }).unwrap();
        let cut = Cut::new(120.0, 0.3).unwrap();
        let expected = job.predict(EdgeState::FRESH, cut);
        let interval = |power_kw| EdgeInterval {
            depth_mm: 2.5,
            cut,
            minutes: 1.0,
            measured: Measured { power_kw: Some(power_kw), ..Measured::default() },
            mean_power_kw: None,
        };
        let read = next(&job, &[interval(2.2389)], 2.0);
        assert!(read.state.wear_mm().is_finite() && read.corrections.power_factor.value.is_finite());
        // What is as expected teaches nothing: the new edge itself is known to be new.
        let learnt = next(&job, &[interval(expected.power_kw)], 0.0).corrections;
        assert!((learnt.power_factor.value - 1.0).abs() < 1e-9, "{learnt:?}");
        assert!((learnt.wear_mm.value - expected.wear_mm).abs() < 1e-9, "{learnt:?}");
        assert!(learnt.wear_mm.low < learnt.wear_mm.value, "the law itself is not known to the last digit");
    }

    /// Any number that an entry may have between two ends, as likely small as large.
    fn wide(low: f64, high: f64) -> impl Strategy<Value = f64> {
        (low.ln()..=high.ln()).prop_map(move |log| log.exp().clamp(low, high))
    }

    fn law() -> impl Strategy<Value = LoadLaw> {
        (wide(1e-12, 1e12), -3.0..=3.0_f64, wide(0.01, 3.0), -3.0..=3.0_f64, wide(0.05, 5.0)).prop_map(
            |(coefficient, speed_exponent, feed_exponent, depth_exponent, wear_exponent)| LoadLaw {
                coefficient,
                speed_exponent,
                feed_exponent,
                depth_exponent,
                wear_exponent,
            },
        )
    }

    /// Every entry that the library takes, near to the paper's or nowhere near.
    fn entry() -> impl Strategy<Value = TurningModel> {
        let wear = (wide(1e-12, 1e6), -3.0..=3.0_f64, wide(0.01, 3.0), wide(0.05, 3.0));
        let scatter = (wide(1e-6, 2.0), wide(1e-6, 2.0), wide(1e-6, 2.0));
        (wear, law(), law(), scatter, wide(1e-3, 100.0), 0..8_u8).prop_map(
            |(wear, power, force, scatter, reference_depth_mm, kept)| {
                let paper = TurningModel::alaskari_oraby_2017().data().clone();
                let mut data = ModelInput { power, force, ..paper.clone() };
                (
                    data.wear.coefficient,
                    data.wear.speed_exponent,
                    data.wear.feed_exponent,
                    data.wear.time_exponent,
                ) = wear;
                let spread = &mut data.scatter;
                (spread.wear_log_sd, spread.power_log_sd, spread.force_log_sd) = scatter;
                data.reference_depth_mm = reference_depth_mm;
                if kept & 1 == 0 {
                    (data.power, data.force) = (paper.power, paper.force);
                }
                if kept & 2 == 0 {
                    data.wear = crate::turning::WearLaw { time_exponent: wear.3, ..paper.wear };
                }
                if kept & 4 == 0 {
                    (data.scatter, data.reference_depth_mm) = (paper.scatter, paper.reference_depth_mm);
                }
                TurningModel::new(data).unwrap()
            },
        )
    }

    fn cut_so() -> impl Strategy<Value = EdgeInterval> {
        let usual = (50.0..200.0_f64, 0.06..0.6_f64, 0.1..5.0_f64);
        let any = (wide(1e-3, 1e5), wide(1e-6, 100.0), wide(1e-6, 1440.0));
        let read = (
            prop::option::of(wide(1e-9, 1e6)),
            prop::option::of(wide(1e-9, 1e9)),
            prop::option::of(0.0..=100.0_f64),
            prop::option::of(wide(1e-9, 1e6)),
        );
        (prop_oneof![usual, any], wide(1e-3, 100.0), read).prop_map(
            |((speed, feed, minutes), depth_mm, (power_kw, force_n, wear_mm, mean_power_kw))| EdgeInterval {
                depth_mm,
                cut: Cut::new(speed, feed).unwrap(),
                minutes,
                measured: Measured { power_kw, force_n, wear_mm },
                mean_power_kw,
            },
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(512))]

        #[test]
        fn no_entry_and_no_history_panics_or_answers_with_what_is_no_number(
            model in entry(),
            intervals in prop::collection::vec(cut_so(), 1..6),
            (by_state, continuous) in any::<(bool, bool)>(),
            (caution, drift, max_factor) in (0.0..=5.0_f64, 0.0..=1.0_f64, 1.0..=100.0_f64),
        ) {
            let domain = if continuous {
                let (speed_m_min, feed_mm_rev) = (Range { min: 1e-3, max: 1e5 }, Range { min: 1e-6, max: 100.0 });
                DomainInput::Continuous { speed_m_min, feed_mm_rev }
            } else {
                JobInput::alaskari_oraby_2017().domain
            };
            let accumulation = if by_state { Accumulation::State } else { Accumulation::ElapsedTime };
            let limits = Limits { power_kw: 7.0, force_n: 1500.0, wear_mm: 0.3 };
            let input = JobInput { model, domain, accumulation, limits, ..JobInput::alaskari_oraby_2017() };
            let job = Job::new(input).unwrap();
            let settings = AdaptationInput { drift_log_sd: drift, max_factor, ..AdaptationInput::default() };
            // An interval too extreme to learn from is refused by name; whatever is answered is a number.
            if let Ok(found) = next_cut(&job, settings, caution, EdgeState::FRESH, &intervals) {
                let Corrections { wear_mm, wear_factor, power_factor, force_factor, .. } = found.corrections;
                for one in [wear_mm, wear_factor, power_factor, force_factor] {
                    prop_assert!(one.value.is_finite() && one.low.is_finite() && one.high.is_finite(), "{one:?}");
                    prop_assert!(one.low <= one.value && one.value <= one.high, "{one:?}");
                }
                prop_assert!(found.state.wear_mm().is_finite() && found.state.elapsed_min().is_finite());
                if let Ok(chosen) = found.choice {
                    let out = chosen.outcome;
                    let told = [out.wear_mm, out.power_kw, out.force_n, out.removal_mm3_min];
                    prop_assert!(told.iter().all(|value| value.is_finite()), "{chosen:?}");
                    prop_assert!(out.power_kw <= limits.power_kw && out.force_n <= limits.force_n, "{chosen:?}");
                    prop_assert!(out.wear_mm <= limits.wear_mm, "{chosen:?}");
                }
            }
        }
    }
}

//! Which spindle speeds and head stiffness segment chips with least amplitude, and how much scatter they bear.
//!
//! Every speed is simulated with the nominal cutting coefficient and with it scaled down and up: the coefficient is
//! the one parameter that is hardly known (Gouskov et al. 2015, section 5).

use std::f64::consts::TAU;

use crate::field_error::{FieldError, Problem, count, each_within, within};

use super::map::MapAxis;
use super::process::{ContinuityControl, Process, ProcessInput, Simulated, Steady, simulate_many};

/// Most simulations of one question: about half a minute on one core.
pub const MAX_SIMULATIONS: usize = 20_000;

/// Share of time in cut above which a gap is too short to count as segmented chips.
const SEGMENTED: f64 = 0.99;

/// Share of the feed by which the mean chip of a run may be off, however large its vibration: half of what is advanced.
const MOST_REMOVED_OFF: f64 = 0.5;

/// Unchecked question.
#[derive(Debug, Clone, PartialEq)]
pub struct AdviceInput {
    /// Cutting edges z.
    pub edges: u32,
    /// Feed per edge a, mm.
    pub feed_mm_edge: f64,
    /// Kc of the cutting law Fc = Kc·h^r, N/mm^r (Gouskov et al. 2015, Eq. 5).
    pub cutting_coefficient: f64,
    /// r of the cutting law.
    pub exponent: f64,
    /// ζ of the head.
    pub damping: f64,
    /// Moving mass of the head, kg.
    pub mass_kg: f64,
    /// Stiffnesses of the elastic element to choose from, N/mm.
    pub stiffnesses_n_mm: Vec<f64>,
    /// Spindle speeds to look at, 1/min.
    pub speeds_rpm: MapAxis,
    /// Control, or none.
    pub control: Option<ContinuityControl>,
    /// Largest peak-to-peak displacement accepted, feeds per edge.
    pub most_amplitude_feeds: f64,
    /// Scatter of the cutting coefficient that a window should bear, 0.3 for ±30 %.
    pub scatter: f64,
    /// Steps of the scatter on either side; it is looked at up to twice the asked one.
    pub scatter_steps: u32,
    /// Periods per simulation.
    pub periods: u32,
}

/// Checked question.
#[derive(Debug, Clone, PartialEq)]
pub struct AdviceQuestion {
    input: AdviceInput,
    speeds: Vec<f64>,
    factors: Vec<f64>,
}

impl AdviceQuestion {
    /// Checks a question.
    ///
    /// # Errors
    /// The first bad field; more than [`MAX_SIMULATIONS`] is `too_many`.
    pub fn new(input: AdviceInput) -> Result<Self, FieldError> {
        within("edges", f64::from(input.edges), 1.0, 100.0)?;
        within("feed_mm_edge", input.feed_mm_edge, 1e-6, 10.0)?;
        within("cutting_coefficient", input.cutting_coefficient, 1e-6, 1e9)?;
        within("exponent", input.exponent, 0.1, 2.0)?;
        within("damping", input.damping, 1e-6, 1.0)?;
        within("mass_kg", input.mass_kg, 1e-6, 1e6)?;
        count("stiffnesses_n_mm", input.stiffnesses_n_mm.len(), 1, 1000)?;
        each_within("stiffnesses_n_mm", &input.stiffnesses_n_mm, 1e-3, 1e9)?;
        within("most_amplitude_feeds", input.most_amplitude_feeds, 0.1, 1e3)?;
        within("scatter", input.scatter, 0.0, 0.45)?;
        within("scatter_steps", f64::from(input.scatter_steps), 1.0, 50.0)?;
        within("periods", f64::from(input.periods), 2.0, 1e6)?;
        let axis = input.speeds_rpm;
        within("speeds_rpm", axis.min, 1.0, 1e6)?;
        within("speeds_rpm", axis.max, axis.min, 1e6)?;
        count("speeds_rpm", axis.count as usize, 2, MAX_SIMULATIONS)?;
        let step = (axis.max - axis.min) / f64::from(axis.count - 1);
        let speeds: Vec<f64> = (0..axis.count).map(|i| axis.min + step * f64::from(i)).collect();
        let side = input.scatter_steps;
        // 1 in the middle, 1 ± 2·scatter at the ends.
        let factors: Vec<f64> = (0..=2 * side)
            .map(|i| 1.0 + 2.0 * input.scatter.max(0.05) * (f64::from(i) / f64::from(side) - 1.0))
            .collect();
        let total = speeds.len() * factors.len() * input.stiffnesses_n_mm.len();
        // A long simulation counts as the several of 500 periods that it takes as long as.
        let longer = (input.periods as usize).div_ceil(500);
        count("speeds_rpm", total.saturating_mul(longer), 1, MAX_SIMULATIONS)?;
        let question = Self { input, speeds, factors };
        for head in 0..question.input.stiffnesses_n_mm.len() {
            for speed in [question.speeds[0], question.speeds[question.speeds.len() - 1]] {
                for factor in [question.factors[0], question.factors[question.factors.len() - 1]] {
                    question.process(head, speed, factor).map_err(|error| match error.field() {
                        "steps_per_period" | "frequency_ratio" => {
                            let why =
                                "reach where the head vibrates too often, or too rarely, per edge passing";
                            FieldError::new("speeds_rpm", Problem::Inconsistent(why))
                        }
                        "cutting_coefficient" => {
                            let why = "is too large for a stiffness and the feed: with the scatter, Kc/(k·a^(1 − r)) may be 100";
                            FieldError::new("cutting_coefficient", Problem::Inconsistent(why))
                        }
                        _ => error,
                    })?;
                }
            }
        }
        Ok(question)
    }

    /// Eigenfrequency of a head, Hz.
    fn eigenfrequency_hz(&self, head: usize) -> f64 {
        // N/mm times 1000 is N/m.
        (self.input.stiffnesses_n_mm[head] * 1000.0 / self.input.mass_kg).sqrt() / TAU
    }

    fn process(&self, head: usize, speed_rpm: f64, factor: f64) -> Result<Process, FieldError> {
        let i = &self.input;
        let ratio = self.eigenfrequency_hz(head) * 60.0 / (f64::from(i.edges) * speed_rpm);
        let unit = i.stiffnesses_n_mm[head] * i.feed_mm_edge.powf(1.0 - i.exponent);
        Process::new(ProcessInput {
            damping: i.damping,
            exponent: i.exponent,
            periods: i.periods,
            steady_periods: i.periods.min(100),
            ..ProcessInput::gouskov_2015(ratio, factor * i.cutting_coefficient / unit, i.control)
        })
    }

    /// Whether a run, of the nominal coefficient or of a scattered one, is one to recommend: it ends in a cut that
    /// segments chips within the accepted amplitude. Without the cut there are no chips: a drill that an earlier
    /// motion has thrown out of the work rests in the air, with ψ = 0 and the least amplitude of all.
    fn good<'a>(&self, run: &'a Simulated) -> Option<&'a Steady> {
        run.as_ref().ok().filter(|steady| {
            steady.segmented()
                && (steady.removed - 1.0).abs() <= MOST_REMOVED_OFF
                && steady.continuity <= SEGMENTED
                && steady.amplitude <= self.input.most_amplitude_feeds
                && !(self.input.control.is_some() && steady.bursting())
        })
    }
}

/// One spindle speed of a head.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedPoint {
    /// Spindle speed, 1/min.
    pub spindle_rpm: f64,
    /// p, eigenfrequency over edge-passing frequency.
    pub frequency_ratio: f64,
    /// kc, nominal dimensionless cutting coefficient.
    pub cutting_coefficient: f64,
    /// ψ with the nominal coefficient.
    pub continuity: f64,
    /// Peak-to-peak displacement, mm.
    pub amplitude_mm: f64,
    /// Largest cutting force, N.
    pub peak_force_n: f64,
    /// Share by which the coefficient may be lower than nominal, as far as looked at.
    pub bears_lower: f64,
    /// Share by which it may be higher.
    pub bears_higher: f64,
}

impl SpeedPoint {
    /// Scatter borne on both sides.
    #[must_use]
    pub fn bears(&self) -> f64 {
        self.bears_lower.min(self.bears_higher)
    }
}

/// Neighbouring speeds at which chips segment within the accepted amplitude.
#[derive(Debug, Clone, PartialEq)]
pub struct SpeedWindow {
    /// Lowest speed, 1/min.
    pub from_rpm: f64,
    /// Highest speed, 1/min.
    pub to_rpm: f64,
    /// The speed of least amplitude among those that bear the asked scatter, or of all if none does.
    pub best: SpeedPoint,
    /// Whether `best` bears the asked scatter.
    pub bears_asked: bool,
}

/// Windows of one stiffness.
#[derive(Debug, Clone, PartialEq)]
pub struct HeadAdvice {
    /// Stiffness, N/mm.
    pub stiffness_n_mm: f64,
    /// Eigenfrequency, Hz.
    pub eigenfrequency_hz: f64,
    /// Windows in order of speed; empty when no speed segments chips.
    pub windows: Vec<SpeedWindow>,
}

/// Advice over all heads.
#[derive(Debug, Clone, PartialEq)]
pub struct Advice {
    /// A head for every stiffness, in the order given.
    pub heads: Vec<HeadAdvice>,
    /// Head and window of least amplitude that bears the asked scatter; none when no window does.
    pub best: Option<(usize, usize)>,
}

/// Windows of the head with the stiffness at this place of the list; none beyond its end.
#[must_use]
pub fn advise_head(question: &AdviceQuestion, head: usize) -> Option<HeadAdvice> {
    let stiffness_n_mm = *question.input.stiffnesses_n_mm.get(head)?;
    // Checked at the corners of speeds and factors, so every process in between is valid.
    let processes: Vec<Process> = question
        .speeds
        .iter()
        .flat_map(|speed| question.factors.iter().map(move |factor| (*speed, *factor)))
        .filter_map(|(speed, factor)| question.process(head, speed, factor).ok())
        .collect();
    let runs = simulate_many(&processes);
    let per_speed = question.factors.len();
    let middle = per_speed / 2;
    let feed = question.input.feed_mm_edge;
    let mut windows: Vec<Vec<SpeedPoint>> = vec![Vec::new()];
    for ((speed, processes), runs) in
        question.speeds.iter().zip(processes.chunks(per_speed)).zip(runs.chunks(per_speed))
    {
        let Some(nominal) = question.good(&runs[middle]) else {
            windows.push(Vec::new());
            continue;
        };
        let is_good = |run: &&Simulated| question.good(run).is_some();
        let below = runs[..middle].iter().rev().take_while(is_good).count();
        let above = runs[middle + 1..].iter().take_while(is_good).count();
        let data = processes[middle].data();
        let point = SpeedPoint {
            spindle_rpm: *speed,
            frequency_ratio: data.frequency_ratio,
            cutting_coefficient: data.cutting_coefficient,
            continuity: nominal.continuity,
            amplitude_mm: nominal.amplitude * feed,
            peak_force_n: nominal.peak_force * stiffness_n_mm * feed,
            bears_lower: 1.0 - question.factors[middle - below],
            bears_higher: question.factors[middle + above] - 1.0,
        };
        if let Some(window) = windows.last_mut() {
            window.push(point);
        }
    }
    let windows = windows.iter().filter_map(|points| window_of(points, question.input.scatter)).collect();
    Some(HeadAdvice { stiffness_n_mm, eigenfrequency_hz: question.eigenfrequency_hz(head), windows })
}

fn window_of(points: &[SpeedPoint], scatter: f64) -> Option<SpeedWindow> {
    let least = |points: &mut dyn Iterator<Item = &SpeedPoint>| {
        points.min_by(|a, b| a.amplitude_mm.total_cmp(&b.amplitude_mm)).copied()
    };
    let bearing = least(&mut points.iter().filter(|point| point.bears() >= scatter - 1e-9));
    let best = bearing.or_else(|| least(&mut points.iter()))?;
    let (from_rpm, to_rpm) = (points.first()?.spindle_rpm, points.last()?.spindle_rpm);
    Some(SpeedWindow { from_rpm, to_rpm, best, bears_asked: bearing.is_some() })
}

/// Windows of every head and the best of them.
#[must_use]
pub fn advise(question: &AdviceQuestion) -> Advice {
    best_of(
        (0..question.input.stiffnesses_n_mm.len()).filter_map(|head| advise_head(question, head)).collect(),
    )
}

/// Heads that were advised one by one, with the best of them.
#[must_use]
pub fn best_of(heads: Vec<HeadAdvice>) -> Advice {
    let best = heads
        .iter()
        .enumerate()
        .flat_map(|(head, advice)| {
            advice.windows.iter().enumerate().map(move |(i, window)| (head, i, window))
        })
        .filter(|(_, _, window)| window.bears_asked)
        .min_by(|a, b| a.2.best.amplitude_mm.total_cmp(&b.2.best.amplitude_mm))
        .map(|(head, window, _)| (head, window));
    Advice { heads, best }
}

#[cfg(test)]
mod tests {
    use super::super::{border_at, simulate};
    use super::*;

    /// A head of 100 Hz at 3000 N/mm whose kc is about 0.1 at the feed of 0.1 mm.
    fn question(control: Option<ContinuityControl>) -> AdviceInput {
        AdviceInput {
            edges: 2,
            feed_mm_edge: 0.1,
            cutting_coefficient: 0.1 * 3000.0 * 0.1_f64.powf(0.25),
            exponent: 0.75,
            damping: 0.01,
            mass_kg: 3000.0 * 1000.0 / (TAU * 100.0_f64).powi(2),
            stiffnesses_n_mm: vec![3000.0, 6000.0],
            speeds_rpm: MapAxis { min: 1550.0, max: 2950.0, count: 29 },
            control,
            most_amplitude_feeds: 3.0,
            scatter: 0.2,
            scatter_steps: 4,
            periods: 500,
        }
    }

    #[test]
    fn windows_lie_where_the_simulation_segments_and_bear_what_they_say() {
        let asked = AdviceQuestion::new(question(None)).unwrap();
        let advice = advise(&asked);
        let (head, window) = advice.best.unwrap();
        let best = &advice.heads[head].windows[window];
        assert!(
            best.bears_asked
                && best.from_rpm <= best.best.spindle_rpm
                && best.best.spindle_rpm <= best.to_rpm
        );
        let control = None;
        for factor in [1.0 - best.best.bears_lower, 1.0, 1.0 + best.best.bears_higher] {
            let kc = best.best.cutting_coefficient * factor;
            let process = ProcessInput::gouskov_2015(best.best.frequency_ratio, kc, control);
            let steady = simulate(&Process::new(process).unwrap()).unwrap();
            assert!(steady.continuity <= SEGMENTED && steady.amplitude <= 3.0, "{factor}: {steady:?}");
        }
        // No window reaches into speeds that are linearly stable: there free vibrations die away.
        for head in &advice.heads {
            for window in &head.windows {
                let p = head.eigenfrequency_hz * 30.0 / window.best.spindle_rpm;
                let border = border_at(p, 0.01, 0.75).unwrap().cutting_coefficient;
                assert!(window.best.cutting_coefficient > 0.98 * border);
            }
        }
    }

    #[test]
    fn no_speed_is_advised_at_which_the_drill_does_not_cut_or_the_run_grows_without_end() {
        let base = AdviceInput {
            mass_kg: 7.6,
            stiffnesses_n_mm: vec![3000.0],
            speeds_rpm: MapAxis { min: 1550.0, max: 1750.0, count: 5 },
            scatter_steps: 2,
            ..question(None)
        };
        // Thrown out of the work at 1600 1/min, with ψ = 0 and no amplitude; beyond all bounds with the square law.
        for (cutting_coefficient, exponent) in [(3374.05, 0.75), (30_000.0, 2.0)] {
            let asked = AdviceInput { cutting_coefficient, exponent, ..base.clone() };
            let asked = AdviceQuestion::new(asked).unwrap();
            let runs: Vec<_> =
                asked.speeds.iter().map(|speed| simulate(&asked.process(0, *speed, 1.0).unwrap())).collect();
            assert!(runs.iter().any(|run| run.is_err_and(|_| true) || run.is_ok_and(|steady| !steady.cuts)));
            let advice = advise(&asked);
            assert_eq!(advice.best, None);
            for window in &advice.heads[0].windows {
                let best = &window.best;
                for factor in [1.0 - best.bears_lower, 1.0, 1.0 + best.bears_higher] {
                    let run = simulate(&asked.process(0, best.spindle_rpm, factor).unwrap()).unwrap();
                    assert!(run.cuts && run.segmented() && run.amplitude <= 3.0, "{run:?}");
                }
            }
        }
    }

    #[test]
    fn control_bears_a_scatter_of_thirty_percent_that_the_free_process_does_not() {
        // The paper's claim (section 5), with chips segmented at no more than two feeds of amplitude.
        let asked = |control| {
            let input = AdviceInput {
                most_amplitude_feeds: 2.0,
                scatter: 0.3,
                scatter_steps: 6,
                ..question(control)
            };
            advise(&AdviceQuestion::new(input).unwrap())
        };
        let (free, held) = (asked(None), asked(Some(ContinuityControl::GOUSKOV_2015)));
        assert_eq!(free.best, None);
        let (head, window) = held.best.unwrap();
        let best = &held.heads[head].windows[window].best;
        assert!(best.bears() >= 0.3 && (best.continuity - 0.9).abs() < 0.02, "{best:?}");
    }

    #[test]
    fn bad_questions_are_refused_by_name() {
        let refused = |input| {
            let error = AdviceQuestion::new(input).unwrap_err();
            (error.field(), error.code())
        };
        let base = || question(None);
        assert_eq!(refused(AdviceInput { mass_kg: f64::NAN, ..base() }), ("mass_kg", "not_finite"));
        assert_eq!(
            refused(AdviceInput { stiffnesses_n_mm: vec![], ..base() }),
            ("stiffnesses_n_mm", "empty")
        );
        let crawling = MapAxis { min: 10.0, max: 100.0, count: 3 };
        assert_eq!(refused(AdviceInput { speeds_rpm: crawling, ..base() }), ("speeds_rpm", "inconsistent"));
        assert_eq!(refused(AdviceInput { periods: 0, ..base() }), ("periods", "out_of_range"));
        let hard = AdviceInput { cutting_coefficient: 1e9, ..base() };
        assert_eq!(refused(hard), ("cutting_coefficient", "inconsistent"));
        let second = AdviceInput { stiffnesses_n_mm: vec![3000.0, -1.0], ..base() };
        assert_eq!(AdviceQuestion::new(second).unwrap_err().path_in(""), "stiffnesses_n_mm[1]");
        let many = MapAxis { count: 15_000, ..base().speeds_rpm };
        assert_eq!(refused(AdviceInput { speeds_rpm: many, ..base() }), ("speeds_rpm", "too_many"));
    }
}

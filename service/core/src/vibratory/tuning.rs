//! Settings of the peak-to-peak controller from the machine's eigenfrequency and feed.
//!
//! Ivanov et al. 2024 give one set of settings and the reasons for some of them; this scales those to other machines.

use std::f64::consts::PI;

use crate::field_error::{FieldError, count, each_within, within};

use super::continuity::segmentation_amplitude;
use super::peak_to_peak::{ControllerInput, ControllerSettings};

/// Target in feeds per edge of the paper's experiments (0.06 mm at 0.02 mm): the most that is advised.
const MOST_TARGET_FEEDS: f64 = 3.0;

/// Least target in feeds per edge: half again what the most favourable ratio needs.
const LEAST_TARGET_FEEDS: f64 = 1.5;

/// Margin over the amplitude that just segments.
const TARGET_MARGIN: f64 = 1.25;

/// Chatter over eigenfrequency: cutting stiffens the system; 1.03 to 1.25 in Table 8 of the paper (pilot hole).
const CHATTER_RATIO: f64 = 1.12;

/// Share of the actuator's force that the full gain asks for at the target; the rest is for bursts.
const FORCE_SHARE: f64 = 0.5;

/// Displacement filter over eigenfrequency: 50 Hz at 70.86 Hz. Below 0.3 the loop can end in a limit cycle.
const FILTER_RATIO: f64 = 0.7;

/// Tb in eigenperiods ("around five periods of free vibrations", Table 2).
const TIME_CONSTANT_PERIODS: f64 = 5.0;

/// Samples per eigenperiod in the paper (300 µs at 70.86 Hz), and the least that still times crossings well.
const SAMPLES_PER_PERIOD: f64 = 47.0;
const LEAST_SAMPLES_PER_PERIOD: f64 = 20.0;

/// Most spindle speeds of a question.
const MAX_SPEEDS: usize = 10_000;

/// Unchecked machine to tune for.
#[derive(Debug, Clone, PartialEq)]
pub struct TuningInput {
    /// Eigenfrequency f0, Hz.
    pub eigenfrequency_hz: f64,
    /// Cutting edges z.
    pub edges: u32,
    /// Feed per edge, mm.
    pub feed_mm_edge: f64,
    /// Spindle speeds that will be used, 1/min.
    pub speeds_rpm: Vec<f64>,
    /// Largest actuator force, N.
    pub actuator_limit_n: f64,
    /// Time the board needs per step, s.
    pub computation_s: f64,
}

/// Advised settings.
#[derive(Debug, Clone, PartialEq)]
pub struct Tuning {
    /// Controller settings.
    pub settings: ControllerSettings,
    /// G, feedback at gain 1, N·s/m.
    pub actuator_gain_n_s_m: f64,
    /// Amplitude that just segments at each speed, mm; none where the vibration would repeat from edge to edge.
    pub needed_mm: Vec<Option<f64>>,
    /// Speeds at which the target is expected not to segment chips, 1/min.
    pub not_covered_rpm: Vec<f64>,
    /// Whether the board leaves fewer than 20 samples per vibration.
    pub board_too_slow: bool,
}

/// Advises settings for a machine.
///
/// A0 covers the amplitude of Eq. 1 of Gouskov et al. 2015 at the speeds given, within 1.5 to 3 feeds; G asks for half
/// the actuator's force at that amplitude; filters and times keep the paper's relation to the eigenfrequency.
///
/// # Errors
/// The first field that is empty, not finite or out of range.
pub fn tune(input: &TuningInput) -> Result<Tuning, FieldError> {
    let f0 = within("eigenfrequency_hz", input.eigenfrequency_hz, 0.1, 1e4)?;
    within("edges", f64::from(input.edges), 1.0, 100.0)?;
    let feed = within("feed_mm_edge", input.feed_mm_edge, 1e-4, 10.0)?;
    within("actuator_limit_n", input.actuator_limit_n, 1e-3, 1e9)?;
    within("computation_s", input.computation_s, 1e-7, 0.125 / f0)?;
    count("speeds_rpm", input.speeds_rpm.len(), 1, MAX_SPEEDS)?;
    each_within("speeds_rpm", &input.speeds_rpm, 1.0, 1e6)?;
    let needed_mm = input
        .speeds_rpm
        .iter()
        .map(|rpm| segmentation_amplitude(feed, CHATTER_RATIO * f0 * 60.0 / (f64::from(input.edges) * rpm)))
        .collect::<Result<Vec<_>, _>>()?;
    let most = needed_mm.iter().map(|needed| needed.unwrap_or(f64::INFINITY)).fold(0.0, f64::max);
    let target_mm = (TARGET_MARGIN * most).clamp(LEAST_TARGET_FEEDS * feed, MOST_TARGET_FEEDS * feed);
    let not_covered_rpm = input
        .speeds_rpm
        .iter()
        .zip(&needed_mm)
        .filter(|(_, needed)| needed.is_none_or(|needed| needed > target_mm))
        .map(|(rpm, _)| *rpm)
        .collect();
    let period_s = input.computation_s.max(1.0 / (SAMPLES_PER_PERIOD * f0));
    // Velocity amplitude at the target, mm/s; N·s/mm times 1000 is N·s/m.
    let velocity = PI * f0 * target_mm;
    let settings = ControllerSettings::new(ControllerInput {
        eigenfrequency_hz: f0,
        period_s,
        target_mm,
        time_constant_s: TIME_CONSTANT_PERIODS / f0,
        displacement_filter_hz: Some(FILTER_RATIO * f0),
        ..ControllerInput::IVANOV_2024
    })?;
    Ok(Tuning {
        settings,
        actuator_gain_n_s_m: FORCE_SHARE * input.actuator_limit_n / velocity * 1000.0,
        needed_mm,
        not_covered_rpm,
        board_too_slow: period_s * f0 * LEAST_SAMPLES_PER_PERIOD > 1.0,
    })
}

#[cfg(test)]
mod tests {
    use super::super::loop_model::{CuttingForce, LoopInput, LoopRun, run_loop};
    use super::*;

    fn paper() -> TuningInput {
        TuningInput {
            eigenfrequency_hz: 70.86,
            edges: 2,
            feed_mm_edge: 0.02,
            speeds_rpm: vec![2000.0, 2500.0, 3000.0, 3500.0, 4000.0, 4500.0, 5000.0],
            actuator_limit_n: 100.0,
            computation_s: 300e-6,
        }
    }

    #[test]
    fn the_papers_machine_gets_about_the_papers_settings() {
        let tuning = tune(&paper()).unwrap();
        let got = tuning.settings.data();
        assert!((got.target_mm - 0.06).abs() < 1e-12);
        assert!((tuning.actuator_gain_n_s_m / 4000.0 - 1.0).abs() < 0.1, "{}", tuning.actuator_gain_n_s_m);
        assert!((got.time_constant_s / 0.07 - 1.0).abs() < 0.02);
        assert!((got.displacement_filter_hz.unwrap() / 50.0 - 1.0).abs() < 0.02);
        assert!((got.period_s / 300e-6 - 1.0).abs() < 0.01);
        // Near one vibration per edge the amplitude of Eq. 1 runs away: 2500 rpm is named.
        assert_eq!(tuning.not_covered_rpm, [2500.0]);
        assert!(!tuning.board_too_slow);
    }

    #[test]
    fn other_machines_are_held_at_their_target_with_the_advice() {
        for (eigenfrequency_hz, stiffness_n_mm, limit) in [(45.0, 1500.0, 60.0), (120.0, 5000.0, 200.0)] {
            let scale = eigenfrequency_hz / 70.86;
            let speeds_rpm = vec![3000.0 * scale, 3500.0 * scale, 4500.0 * scale];
            let input = TuningInput {
                eigenfrequency_hz,
                speeds_rpm,
                actuator_limit_n: limit,
                computation_s: 1e-4,
                ..paper()
            };
            let tuning = tune(&input).unwrap();
            for spindle_rpm in &input.speeds_rpm {
                let run = LoopRun::new(LoopInput {
                    stiffness_n_mm,
                    eigenfrequency_hz,
                    spindle_rpm: *spindle_rpm,
                    actuator_gain_n_s_m: tuning.actuator_gain_n_s_m,
                    actuator_limit_n: limit,
                    ..LoopInput::ivanov_2024(3000.0, CuttingForce::PILOT_HOLE)
                });
                let steady = run_loop(&run.unwrap(), Some(&tuning.settings)).unwrap();
                let off = steady.displacement_mm / tuning.settings.data().target_mm - 1.0;
                assert!(off.abs() < 0.05, "{eigenfrequency_hz} Hz at {spindle_rpm} rpm: {off}");
            }
        }
    }

    #[test]
    fn bad_machines_are_refused_by_name() {
        let refused = |input: TuningInput| tune(&input).unwrap_err().field();
        assert_eq!(refused(TuningInput { feed_mm_edge: 0.0, ..paper() }), "feed_mm_edge");
        assert_eq!(refused(TuningInput { speeds_rpm: vec![], ..paper() }), "speeds_rpm");
        assert_eq!(refused(TuningInput { speeds_rpm: vec![f64::NAN], ..paper() }), "speeds_rpm");
        let second = TuningInput { speeds_rpm: vec![3000.0, 1e7], ..paper() };
        assert_eq!(tune(&second).unwrap_err().path_in(""), "speeds_rpm[1]");
        assert_eq!(refused(TuningInput { computation_s: 1.0, ..paper() }), "computation_s");
    }
}

//! The override law beside what a control makes of its polynomial, in closed loop on the process model.
//!
//! The same profile drills the same hole several times: alone, under our law (Stryczek & Błaszczak 2020, Eq. 1–4), and under
//! the polynomial that an exported file holds, which a synchronised action computes from the load of the moment, without
//! the filter and without memory.

use super::law::{OverridePolynomial, begins_mm};
use crate::feed::profile::Profile;
use crate::friction::error::{Invalid, InvalidCode};
use crate::friction::law::{Heating, LawConfig, LawParams, LawSample, LawState};
use crate::friction::noise::Noise;
use crate::friction::twin::{AxisState, CycleSetup, Twin, TwinInput, TwinState};

/// IPO cycles after which a hole counts as stuck.
const MOST_SAMPLES: u32 = 60_000;

/// What moves the feed of one run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mover {
    /// Nothing: the profile as it is.
    Profile,
    /// Our law.
    Law,
    /// The polynomial in the control, up to the profile's highest override.
    Polynomial,
    /// The polynomial in the control, never above 100 %: it only lowers.
    PolynomialLowering,
}

/// One run's figures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Run {
    /// What moved the feed.
    pub mover: Mover,
    /// From first contact to the end, s.
    pub duration_s: f64,
    /// Largest feed-drive load, %.
    pub peak_feed_drive_percent: f64,
    /// Largest spindle load, %.
    pub peak_spindle_percent: f64,
    /// Time with either load above its set load, s.
    pub above_set_s: f64,
    /// Time with either load more than 5 % above its set load, s.
    pub far_above_set_s: f64,
}

/// Runs a profile with both set loads in every way of [`Mover`]; `seed` draws the same noise for each.
///
/// # Errors
/// Where the profile states no set loads, or a hole is not finished within ten minutes.
pub fn closed_loop(
    twin: &Twin,
    profile: &Profile,
    intensity: f64,
    setup: &CycleSetup,
    seed: Option<u64>,
) -> Result<[Run; 4], Invalid> {
    let movers = [Mover::Profile, Mover::Law, Mover::Polynomial, Mover::PolynomialLowering];
    let mut runs = [None; 4];
    for (slot, mover) in runs.iter_mut().zip(movers) {
        *slot = Some(run(twin, profile, mover, intensity, setup, seed)?);
    }
    match runs {
        [Some(alone), Some(law), Some(polynomial), Some(lowering)] => Ok([alone, law, polynomial, lowering]),
        _ => Err(Invalid::new("profile", InvalidCode::NotIdentifiable, "a run gave no figures")),
    }
}

fn run(
    twin: &Twin,
    profile: &Profile,
    mover: Mover,
    intensity: f64,
    setup: &CycleSetup,
    seed: Option<u64>,
) -> Result<Run, Invalid> {
    let limits = profile.limits();
    let (Some(feed_set), Some(spindle_set)) =
        (limits.feed_drive_load_set_percent, limits.spindle_load_set_percent)
    else {
        let why = "the comparison needs both set loads";
        return Err(Invalid::new("limits", InvalidCode::Inconsistent, why));
    };
    // Both move the feed from the same depth on, as a file does.
    let heated_mm = begins_mm(profile);
    let paper = LawParams::paper(feed_set, spindle_set)?;
    let law = LawConfig::new(LawParams { intensity, heating: Heating::Depth { mm: heated_mm }, ..paper })?;
    let fit = |set: f64| {
        let high = match mover {
            Mover::PolynomialLowering => 100.0,
            _ => limits.override_max_percent.min(200.0),
        };
        let low = limits.override_min_percent;
        OverridePolynomial::fit(set, intensity, low, high)
            .map_err(|_| Invalid::new("intensity", InvalidCode::OutOfRange, "no polynomial fits"))
    };
    let (feed_fit, spindle_fit) = (fit(feed_set)?, fit(spindle_set)?);
    let mut noise = seed.map(Noise::seeded);
    let mut state = TwinState::new(setup.wear)?;
    let mut law_state = LawState::new();
    let machine = &twin.params().machine;
    let mut axis = AxisState::at_rest(-setup.approach_mm);
    let mut rpm = 0.0;
    let mut contact = None;
    let mut override_percent = 100.0;
    let mut figures = Run {
        mover,
        duration_s: 0.0,
        peak_feed_drive_percent: 0.0,
        peak_spindle_percent: 0.0,
        above_set_s: 0.0,
        far_above_set_s: 0.0,
    };
    for k in 1..=MOST_SAMPLES {
        let dt = setup.period_s;
        // The spindle gets to its speed in the air; its own load peak is none of the hole's.
        rpm = (rpm + machine.spindle_acceleration_rpm_s * dt).min(setup.spindle_rpm);
        let programmed = profile.feed_at(axis.depth_mm());
        let done = axis.step(&machine.axis, programmed, override_percent, profile.end_depth_mm(), dt);
        let (depth_mm, feed_mm_min) = (axis.depth_mm(), axis.feed_mm_min());
        let input = TwinInput { depth_mm, feed_mm_min, spindle_rpm: rpm, dt_s: dt };
        let loads = twin.step(&mut state, &input, noise.as_mut())?;
        if depth_mm < 0.0 {
            continue;
        }
        let since = k - *contact.get_or_insert(k - 1);
        let (feed_drive, spindle) = (loads.feed_drive_percent, loads.spindle_percent);
        figures.duration_s += dt;
        figures.peak_feed_drive_percent = figures.peak_feed_drive_percent.max(feed_drive);
        figures.peak_spindle_percent = figures.peak_spindle_percent.max(spindle);
        let relative = (feed_drive / feed_set).max(spindle / spindle_set);
        figures.above_set_s += if relative > 1.0 { dt } else { 0.0 };
        figures.far_above_set_s += if relative > 1.05 { dt } else { 0.0 };
        if done {
            return Ok(figures);
        }
        override_percent = match mover {
            Mover::Profile => 100.0,
            Mover::Law => {
                let time_ms = f64::from(since) * dt * 1e3;
                let sample = LawSample {
                    time_ms,
                    contact_ms: Some(time_ms),
                    depth_mm: Some(depth_mm),
                    feed_drive_percent: Some(feed_drive),
                    spindle_percent: Some(spindle),
                };
                law_state.step(&law, &sample).ovr.percent()
            }
            _ if depth_mm < heated_mm => 100.0,
            // As the file says: whichever drive is nearer to its set load.
            _ if feed_drive * spindle_set >= spindle * feed_set => feed_fit.at(feed_drive),
            _ => spindle_fit.at(spindle),
        };
    }
    Err(Invalid::new("profile", InvalidCode::OutOfRange, "the hole is not finished within 60 000 samples"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feed::profile::tests::given::input;
    use crate::feed::profile::{Profile, ProfileInput};
    use crate::friction::twin::{PaperStrategies, paper_params};

    /// F_AC's program of the paper's set-up.
    fn adaptive() -> Profile {
        let strategy = PaperStrategies::new().unwrap().adaptive;
        let mut knots: Vec<_> =
            strategy.program.knots().iter().map(|knot| (knot.depth_mm, knot.feed_mm_min).into()).collect();
        knots.push((strategy.end_depth_mm(), 395.0).into());
        Profile::new(ProfileInput { knots, ..input() }).unwrap()
    }

    #[test]
    fn a_polynomial_takes_something_off_the_spindles_peak_and_our_law_far_more_off_the_time_above_the_set_loads()
     {
        let twin = Twin::new(paper_params()).unwrap();
        let setup = CycleSetup::new(2800.0, 0.0);
        let [alone, law, polynomial, lowering] = closed_loop(&twin, &adaptive(), 8.47, &setup, None).unwrap();
        // Alone the program exceeds the set loads for a good part of the hole: there is something to do.
        assert!(alone.far_above_set_s > 0.5, "{alone:?}");
        assert!(law.far_above_set_s < 0.7 * alone.far_above_set_s, "{law:?} {alone:?}");
        // Where a load overshoots, a polynomial that rose with it would drive the spindle beyond the bare profile's peak.
        assert!(polynomial.peak_spindle_percent < alone.peak_spindle_percent, "{polynomial:?} {alone:?}");
        assert!(law.far_above_set_s < polynomial.far_above_set_s, "{law:?} {polynomial:?}");
        assert!(lowering.peak_spindle_percent < alone.peak_spindle_percent, "{lowering:?} {alone:?}");
        assert!(lowering.far_above_set_s < alone.far_above_set_s, "{lowering:?} {alone:?}");
        assert!(lowering.duration_s > alone.duration_s);
    }
}

//! Strategies beside each other on one machine, tool and sheet: the table and radar of Stryczek & Błaszczak 2020,
//! Fig. 21.
//!
//! Each strategy drills the same hole on the process model with the same noise. What does not belong here: which
//! strategies are worth comparing, and what a figure is worth to a shop.

use super::error::{Invalid, InvalidCode, between};
use super::noise::Noise;
use super::program::Strategy;
use super::stages::{Mark, StageConfig, StageDetector, StageSample, Stages};
use super::twin::{CycleFigures, CycleSample, CycleSetup, Twin};
use super::whatif::LoadLimits;

/// Most strategies in one comparison; the paper compares four.
pub const MOST_COMPARED: usize = 8;

/// One strategy's hole: figures, stages as the loads tell them, and time over the load limits.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Name of the strategy.
    pub name: String,
    /// Figures from first contact on.
    pub figures: CycleFigures,
    /// Stages found from the drive loads alone.
    pub stages: Stages,
    /// Time in contact with a load over its limit, s.
    pub overload_s: f64,
}

/// The axes of Fig. 21, each as a share of the largest value among the strategies compared: 1 is the worst.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Radar {
    /// Cycle time.
    pub duration: f64,
    /// Energy of the hole.
    pub energy: f64,
    /// Largest thrust.
    pub thrust: f64,
    /// Largest torque.
    pub torque: f64,
    /// Largest mechanical power.
    pub power: f64,
}

/// Drills one hole, hands every sample to `each`, and finds its stages.
///
/// The same `seed` gives every strategy the same noise; `None` is the noise-free model.
///
/// # Errors
/// As [`Twin::drill`], and when a limit is not a load.
pub fn drill(
    twin: &Twin,
    strategy: &Strategy,
    setup: &CycleSetup,
    limits: &LoadLimits,
    seed: Option<u64>,
    mut each: impl FnMut(&CycleSample),
) -> Result<Outcome, Invalid> {
    limits.check()?;
    let config = StageConfig::default();
    let mut detector = StageDetector::new();
    let mut noise = seed.map(Noise::seeded);
    let mut overload_s = 0.0;
    let figures = twin.drill(strategy, setup, noise.as_mut(), |sample| {
        let (feed_drive_percent, spindle_percent) =
            (sample.process.feed_drive_percent, sample.process.spindle_percent);
        detector
            .step(&config, &StageSample { depth_mm: sample.depth_mm, feed_drive_percent, spindle_percent });
        if sample.depth_mm >= 0.0 && limits.are_exceeded(feed_drive_percent, spindle_percent) {
            overload_s += setup.period_s;
        }
        each(sample);
    })?;
    Ok(Outcome { name: strategy.name.clone(), figures, stages: detector.stages(), overload_s })
}

/// Drills the same hole under each strategy.
///
/// # Errors
/// With the place of the strategy in the list, as in `compare[2].…`, and when there are none or more than eight.
pub fn compare(
    twin: &Twin,
    strategies: &[Strategy],
    setup: &CycleSetup,
    limits: &LoadLimits,
    seed: Option<u64>,
) -> Result<Vec<Outcome>, Invalid> {
    if strategies.is_empty() {
        return Err(Invalid::new("compare", InvalidCode::Empty, "at least one strategy is needed"));
    }
    if strategies.len() > MOST_COMPARED {
        let text = format!("at most {MOST_COMPARED} strategies, not {}", strategies.len());
        return Err(Invalid::new("compare", InvalidCode::TooMany, text));
    }
    let one = |(place, strategy): (usize, &Strategy)| {
        drill(twin, strategy, setup, limits, seed, |_| {})
            .map_err(|error| if error.field() == "strategy" { at(place, &error) } else { error })
    };
    strategies.iter().enumerate().map(one).collect()
}

fn at(place: usize, error: &Invalid) -> Invalid {
    Invalid::new(format!("compare[{place}]"), error.code(), error.message())
}

/// Every outcome's share of the largest value on each axis.
#[must_use]
pub fn radar(outcomes: &[Outcome]) -> Vec<Radar> {
    let largest = |of: fn(&CycleFigures) -> f64| {
        outcomes.iter().map(|outcome| of(&outcome.figures)).fold(0.0, f64::max).max(f64::MIN_POSITIVE)
    };
    let duration = largest(|f| f.duration_s);
    let energy = largest(|f| f.energy_j);
    let thrust = largest(|f| f.thrust_n.value);
    let torque = largest(|f| f.torque_nm.value);
    let power = largest(|f| f.power_w.value);
    let one = |outcome: &Outcome| {
        let figures = &outcome.figures;
        Radar {
            duration: figures.duration_s / duration,
            energy: figures.energy_j / energy,
            thrust: figures.thrust_n.value / thrust,
            torque: figures.torque_nm.value / torque,
            power: figures.power_w.value / power,
        }
    };
    outcomes.iter().map(one).collect()
}

/// Depths that bound the stages A to D, mm; what the hole did not show is `None`.
#[must_use]
pub fn stage_depths(stages: &Stages) -> [Option<f64>; 6] {
    let depth = |mark: Option<Mark>| mark.map(|mark| mark.depth_mm);
    [
        depth(stages.contact),
        depth(stages.thrust_maximum),
        depth(stages.breakthrough),
        depth(stages.torque_maximum),
        depth(stages.falling_edge),
        depth(stages.flange),
    ]
}

impl LoadLimits {
    /// Checks that each limit is a load, above 0 and at most 1000 %.
    ///
    /// # Errors
    /// With the limit's name.
    pub fn check(&self) -> Result<(), Invalid> {
        if let Some(load) = self.feed_drive_percent {
            between("limits.feed_drive_percent", load, 0.1, 1000.0)?;
        }
        if let Some(load) = self.spindle_percent {
            between("limits.spindle_percent", load, 0.1, 1000.0)?;
        }
        Ok(())
    }

    /// Whether one of the loads is over its limit.
    #[must_use]
    pub fn are_exceeded(&self, feed_drive_percent: f64, spindle_percent: f64) -> bool {
        let over = |limit: Option<f64>, load: f64| limit.is_some_and(|limit| load > limit);
        over(self.feed_drive_percent, feed_drive_percent) || over(self.spindle_percent, spindle_percent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::friction::twin::{PAPER_SPINDLE_RPM, PaperStrategies, paper_params};

    fn outcomes(limits: &LoadLimits) -> Vec<Outcome> {
        let twin = Twin::new(paper_params()).unwrap();
        let all: Vec<Strategy> = PaperStrategies::new().unwrap().all().map(Clone::clone).to_vec();
        compare(&twin, &all, &CycleSetup::new(PAPER_SPINDLE_RPM, 0.0), limits, None).unwrap()
    }

    const NONE: LoadLimits = LoadLimits { feed_drive_percent: None, spindle_percent: None };

    #[test]
    fn constant_feed_is_worst_in_time_and_energy_and_best_in_torque() {
        let radar = radar(&outcomes(&NONE));
        assert!((radar[0].duration - 1.0).abs() < 1e-12 && (radar[0].energy - 1.0).abs() < 1e-12);
        assert!(radar[1..].iter().all(|other| other.torque > radar[0].torque && other.duration < 1.0));
        assert!(radar.iter().all(|one| one.power > 0.0 && one.power <= 1.0));
    }

    #[test]
    fn stages_come_in_their_order_and_overload_only_under_a_limit() {
        for outcome in outcomes(&NONE) {
            let depths = stage_depths(&outcome.stages);
            let known: Vec<f64> = depths.into_iter().flatten().collect();
            assert!(known.len() == 6 && outcome.overload_s == 0.0, "{outcome:?}");
            assert!(depths[0] < depths[1] && depths[1] < depths[3] && depths[3] < depths[5], "{depths:?}");
        }
        let tight = LoadLimits { spindle_percent: Some(20.0), ..NONE };
        assert!(outcomes(&tight).iter().any(|outcome| outcome.overload_s > 0.0));
    }

    #[test]
    fn what_cannot_be_compared_is_refused_by_path() {
        let twin = Twin::new(paper_params()).unwrap();
        let setup = CycleSetup::new(PAPER_SPINDLE_RPM, 0.0);
        let one = PaperStrategies::new().unwrap().constant;
        let refused = |strategies: &[Strategy], limits: &LoadLimits| {
            let error = compare(&twin, strategies, &setup, limits, None).unwrap_err();
            (error.field().to_owned(), error.code())
        };
        assert_eq!(refused(&[], &NONE), ("compare".into(), InvalidCode::Empty));
        assert_eq!(refused(&vec![one.clone(); 9], &NONE).1, InvalidCode::TooMany);
        let nan = LoadLimits { spindle_percent: Some(f64::NAN), ..NONE };
        assert_eq!(refused(std::slice::from_ref(&one), &nan).0, "limits.spindle_percent");
        let crawl = crate::friction::program::FeedProgram::constant(0.5).unwrap();
        let crawl = Strategy::new("crawl", crawl, 20.0, None).unwrap();
        assert_eq!(refused(&[one, crawl], &NONE).0, "compare[1]");
    }
}

//! The optimiser beside the strategies of Stryczek & Błaszczak 2020 on the paper's set-up.
//!
//! Each strategy is held to its own measure: the lowest set loads that it keeps to the study's tolerance, cycle after
//! cycle. The optimiser is given the same set loads, the same acceleration and the tool maker's feed while heating, and
//! starts from a recorded hole of F_Const.

use super::draw::{AnyPlant, Case, Start};
use super::plant::{Run, TwinPlant};
use super::reference::Limits;
use super::{CaseOutcome, OVERLOAD_FACTOR, OVERLOAD_S, TRIALS, try_case};
use crate::friction::error::Invalid;
use crate::friction::noise::Noise;
use crate::friction::program::{Knot, Strategy};
use crate::friction::twin::{
    CycleSetup, PAPER_END_DEPTH_MM, PAPER_SPINDLE_RPM, PaperStrategies, Twin, TwinParams, paper_params,
    typical_noise,
};

/// Holes from which the loads are told that a strategy keeps.
const HOLES: u64 = 20;

/// The tool maker's feed while heating, mm/min, and where heating ends, mm: F_Sec's first section.
const HEATING: (f64, f64) = (160.0, 2.0);

/// Feeds of the machine, mm/min.
const FEEDS_MM_MIN: (f64, f64) = (5.0, 1000.0);

/// One strategy and what the optimiser makes of its loads.
#[derive(Debug, Clone, PartialEq)]
pub struct PaperRow {
    /// The strategy.
    pub name: String,
    /// Wear of the tool, 1 is the paper's worn one.
    pub wear: f64,
    /// Lowest set loads that it keeps to the tolerance, percent (feed drive, spindle).
    pub set_percent: [f64; 2],
    /// Its median time from contact to the end, s.
    pub strategy_s: f64,
    /// What the optimiser tried at these set loads.
    pub outcome: CaseOutcome,
}

impl PaperRow {
    /// Time of the last trial, s.
    #[must_use]
    pub fn learnt_s(&self) -> f64 {
        self.outcome.trials[TRIALS - 1].duration_s
    }
}

/// Filtered loads of a run that are exceeded for as long as is tolerated and no longer.
fn kept(run: &Run) -> [f64; 2] {
    let mut loads: [Vec<f64>; 2] = [Vec::new(), Vec::new()];
    run.filtered(|_, load| {
        for drive in 0..2 {
            loads[drive].push(load[drive]);
        }
    });
    let samples = super::steps(OVERLOAD_S / run.period_s);
    loads.map(|mut loads| {
        loads.sort_by(|a, b| b.total_cmp(a));
        loads.get(samples).copied().unwrap_or(0.0)
    })
}

fn row(plant: &TwinPlant, strategy: &Strategy, seed: u64) -> Result<PaperRow, Invalid> {
    let (mut set, mut times) = ([0.0_f64; 2], Vec::new());
    for hole in 0..HOLES {
        let run = plant.run(strategy, Some(&mut Noise::seeded(seed ^ (hole << 8))))?;
        let loads = kept(&run);
        for drive in 0..2 {
            set[drive] = set[drive].max(loads[drive] / OVERLOAD_FACTOR);
        }
        times.push(run.duration_s);
    }
    times.sort_by(f64::total_cmp);
    let limits = Limits {
        end_mm: PAPER_END_DEPTH_MM,
        set_percent: set,
        feed_mm_min: FEEDS_MM_MIN,
        acceleration_mm_s2: plant.twin.params().machine.axis.acceleration_mm_s2,
        heating: Some(HEATING),
        bushing: None,
    };
    let constant = PaperStrategies::new()?.constant.program.feed_at(0.0);
    let first = [0.0, PAPER_END_DEPTH_MM].map(|depth_mm| Knot { depth_mm, feed_mm_min: constant });
    let case = Case {
        seed,
        plant: AnyPlant::Twin(Box::new(plant.clone())),
        limits,
        start: Start::Conservative,
        first: first.to_vec(),
        noise_factor: 1.0,
        wear: plant.setup.wear,
        wear_step: 0.0,
        period_s: plant.setup.period_s,
    };
    let strategy_s = times[times.len() / 2];
    let outcome = try_case(&case, strategy_s)?;
    Ok(PaperRow {
        name: strategy.name.clone(),
        wear: plant.setup.wear,
        set_percent: set,
        strategy_s,
        outcome,
    })
}

/// F_Sec, F_Lin, F_AC at 30/40 % and F_AC at 40/50 %, with a new tool and the paper's worn one.
///
/// # Errors
/// Never with the paper's values; they are checked like any other.
pub fn paper_rows(seed: u64) -> Result<Vec<PaperRow>, Invalid> {
    let strategies = PaperStrategies::new()?;
    let mut rows = Vec::new();
    for wear in [0.0, 1.0] {
        let params = TwinParams { noise: typical_noise(), ..paper_params() };
        let plant = TwinPlant {
            twin: Twin::new(params)?,
            setup: CycleSetup::new(PAPER_SPINDLE_RPM, wear),
            end_mm: PAPER_END_DEPTH_MM,
        };
        for strategy in
            [&strategies.stepped, &strategies.linear, &strategies.adaptive, &strategies.adaptive_raised]
        {
            rows.push(row(&plant, strategy, seed)?);
        }
    }
    Ok(rows)
}

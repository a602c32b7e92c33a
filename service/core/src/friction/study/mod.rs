//! Life studies on the process model: is wear called when constant feed would have reached the limit?
//!
//! One life is one tool, drilled until its horizon under one strategy or several in turn, with noise of the
//! readings, of the process and of the material. Its wear rate is drawn too. Only every n-th cycle is drilled
//! ("thinned"): windows and the distance of reference cycles count drilled cycles. Everything follows from the
//! seed, so that a study can be run in parts and on any number of threads.

use super::energy::torque_energy_j;
use super::error::{Invalid, InvalidCode, between};
use super::noise::Noise;
use super::program::Strategy;
use super::relation::{DepthProfile, FeedSource};
use super::twin::{CycleSetup, PAPER_END_DEPTH_MM, PAPER_SPINDLE_RPM, PaperStrategies, Twin};
use super::wear::{WearConfig, WearCycle, WearParams, WearState, WearVerdict};

/// Most cycles that one simulated life drills.
pub const MOST_DRILLED_CYCLES: u32 = 200_000;

/// Bisection steps for the true life; each halves the error.
const BISECTION_STEPS: u32 = 40;

/// Cycles in a row under one strategy, where several take turns.
const BLOCK_CYCLES: u32 = 20;

/// What is studied, as plain values; [`LifeStudy::new`] checks them.
#[derive(Debug, Clone, PartialEq)]
pub struct LifeStudyParams {
    /// Strategies that take turns in blocks of twenty cycles; one or more.
    pub strategies: Vec<Strategy>,
    /// The reference: constant feed at which the limit is defined.
    pub reference: Strategy,
    /// Wear detection.
    pub wear: WearConfig,
    /// Reference cycles at the start of a life, before anything else.
    pub first_references: u32,
    /// Factors on the programmed feed with which each strategy's program is run, without its law, while the tool
    /// is new: what makes the relation identifiable.
    pub exploration: Vec<f64>,
    /// Only every n-th cycle is drilled, once the tool is no longer new.
    pub thin: u32,
    /// Cycles after which a life ends.
    pub horizon_cycles: u32,
    /// Relative standard deviation of the wear rate from tool to tool.
    pub wear_rate_sd: f64,
    /// Whether the tool wears at all.
    pub wears: bool,
    /// Spindle speed in rpm.
    pub spindle_rpm: f64,
}

impl LifeStudyParams {
    /// The study of the paper's tool under these strategies.
    ///
    /// Sixty learning cycles for the reference and for every strategy, fifteen of them at 0.8 to 1.25 times the
    /// programmed feed; then every 20th cycle is drilled, every third of those a reference cycle; windows of 41
    /// cycles and 31 reference cycles; wear rates vary by 15 % from tool to tool.
    ///
    /// # Errors
    /// Never with these values; they are checked like any other.
    pub fn paper(strategies: Vec<Strategy>, wears: bool) -> Result<Self, Invalid> {
        let reference = PaperStrategies::new()?.constant;
        let wear = WearParams {
            learning_cycles: 60,
            window_cycles: 41,
            reference_window: 31,
            reference_every: Some(2),
            ..WearParams::new(PAPER_END_DEPTH_MM, reference.program.feed_at(0.0))
        };
        Ok(Self {
            strategies,
            reference,
            wear: WearConfig::new(wear)?,
            first_references: 60,
            exploration: [0.8, 0.9, 1.0, 1.12, 1.25].repeat(3),
            thin: 20,
            horizon_cycles: 20_000,
            wear_rate_sd: 0.15,
            wears,
            spindle_rpm: PAPER_SPINDLE_RPM,
        })
    }
}

/// A cycle of the learning at the start of a life; no key is a reference cycle.
#[derive(Debug, Clone, PartialEq)]
struct Planned {
    strategy: Strategy,
    key: Option<u32>,
}

/// A checked study.
#[derive(Debug, Clone, PartialEq)]
pub struct LifeStudy {
    params: LifeStudyParams,
    unit_life: f64,
}

/// One life's outcome, in cycles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LifeOutcome {
    /// Cycle at which the noise-free model at the reference feed reaches the limit; `None` for a tool that does
    /// not wear.
    pub true_life: Option<f64>,
    /// Cycle at which wear was called.
    pub called_at: Option<u32>,
    /// Drilled cycles that were flagged "wear masked by control".
    pub masked_cycles: u32,
    /// Reference cycles that were run after the learning.
    pub reference_cycles: u32,
    /// Cycles that were drilled.
    pub drilled_cycles: u32,
}

impl LifeOutcome {
    /// Called life over true life; `None` when either is missing.
    #[must_use]
    pub fn ratio(&self) -> Option<f64> {
        Some(f64::from(self.called_at?) / self.true_life?)
    }
}

/// The outcomes of many lives.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LifeSummary {
    /// Lives studied.
    pub lives: u32,
    /// Lives in which wear was called.
    pub called: u32,
    /// Lives called within ±15 % of the true life.
    pub within_15_percent: u32,
    /// Smallest, median and largest called life over true life, over the lives that were called.
    pub ratio_min_median_max: (f64, f64, f64),
    /// 1st and 99th percentile of the same.
    pub ratio_p01_p99: (f64, f64),
    /// Share of drilled cycles flagged "wear masked by control".
    pub masked_share: f64,
}

impl LifeStudy {
    /// Checks the study and finds the true life of the nominal tool on the noise-free model.
    ///
    /// # Errors
    /// With the field that is out of range, or when constant feed never reaches the limit.
    pub fn new(twin: &Twin, params: LifeStudyParams) -> Result<Self, Invalid> {
        if params.strategies.is_empty() {
            return Err(Invalid::new("strategies", InvalidCode::Empty, "at least one strategy is needed"));
        }
        between("thin", f64::from(params.thin), 1.0, 1e5)?;
        between("horizon_cycles", f64::from(params.horizon_cycles), 1.0, 1e7)?;
        between("wear_rate_sd", params.wear_rate_sd, 0.0, 0.5)?;
        for factor in &params.exploration {
            between("exploration", *factor, 0.1, 5.0)?;
        }
        if params.horizon_cycles / params.thin > MOST_DRILLED_CYCLES {
            let text = format!("a life would drill more than {MOST_DRILLED_CYCLES} cycles; thin more");
            return Err(Invalid::new("thin", InvalidCode::OutOfRange, text));
        }
        let limit = params.wear.params().worn;
        let energy = |wear: f64| -> Result<f64, Invalid> {
            let setup = CycleSetup::new(params.spindle_rpm, wear);
            Ok(twin.drill(&params.reference, &setup, None, |_| {})?.energy_j)
        };
        let new = energy(0.0)?;
        let (mut low, mut high) = (0.0, 5.0);
        if energy(high)? < limit * new {
            let text = "constant feed does not reach the limit within five units of wear";
            return Err(Invalid::new("wear", InvalidCode::NotIdentifiable, text));
        }
        for _ in 0..BISECTION_STEPS {
            let middle = f64::midpoint(low, high);
            if energy(middle)? < limit * new {
                low = middle;
            } else {
                high = middle;
            }
        }
        let law = &twin.params().wear;
        let unit_life = high.powf(1.0 / law.growth_exponent) * law.cycles_per_unit;
        Ok(Self { params, unit_life })
    }

    /// Life of the nominal tool in cycles: where constant feed reaches the limit.
    #[must_use]
    pub const fn nominal_life_cycles(&self) -> f64 {
        self.unit_life
    }

    /// Drills one life; the seed decides everything in it.
    ///
    /// # Errors
    /// When a hole of it cannot be finished.
    pub fn life(&self, twin: &Twin, seed: u64) -> Result<LifeOutcome, Invalid> {
        let params = &self.params;
        let mut noise = Noise::seeded(seed);
        let spread = (params.wear_rate_sd * noise.normal()).exp();
        let rate = if params.wears { spread } else { 0.0 };
        let mut state = WearState::new();
        let mut outcome = LifeOutcome {
            true_life: params.wears.then(|| self.unit_life / rate),
            called_at: None,
            masked_cycles: 0,
            reference_cycles: 0,
            drilled_cycles: 0,
        };
        let learning = self.learning_plan()?;
        let mut reference_due = false;
        let mut cycle = 0_u32;
        while cycle < params.horizon_cycles {
            let drilled = outcome.drilled_cycles;
            let planned = learning.get(drilled as usize);
            let turn = (drilled / BLOCK_CYCLES) as usize % params.strategies.len();
            let (strategy, key) = match planned {
                Some(plan) => (&plan.strategy, plan.key),
                None if reference_due => (&params.reference, None),
                None => (&params.strategies[turn], u32::try_from(turn).ok()),
            };
            let wear = twin.wear_after(f64::from(cycle) * rate);
            let energy = self.measure(twin, strategy, wear, &mut noise)?;
            let source = if strategy.law.is_some() { FeedSource::Controlled } else { FeedSource::Programmed };
            let is_reference = key.is_none();
            let counted = WearCycle { energy: &energy, source, is_reference, key: key.unwrap_or(0) };
            let reading = state.step(&params.wear, &counted);
            outcome.drilled_cycles += 1;
            outcome.masked_cycles += u32::from(reading.masked_by_control);
            outcome.reference_cycles += u32::from(is_reference && planned.is_none());
            reference_due = reading.reference_due;
            if reading.verdict == WearVerdict::Worn {
                outcome.called_at = Some(cycle);
                break;
            }
            let is_new = (outcome.drilled_cycles as usize) < learning.len();
            cycle += if is_new { 1 } else { params.thin };
        }
        Ok(outcome)
    }

    /// The first cycles of a life, until every key has learned: references, and for each strategy its program
    /// alone at every exploration factor, then the strategy as it is.
    fn learning_plan(&self) -> Result<Vec<Planned>, Invalid> {
        let params = &self.params;
        let learning = params.wear.params().learning_cycles as usize;
        let reference = Planned { strategy: params.reference.clone(), key: None };
        let mut plan = vec![reference; params.first_references as usize];
        for (turn, strategy) in params.strategies.iter().enumerate() {
            let key = u32::try_from(turn).ok();
            let start = plan.len();
            for factor in &params.exploration {
                let program = strategy.program.scaled(*factor)?;
                let strategy = Strategy::new(&*strategy.name, program, strategy.end_depth_mm(), None)?;
                plan.push(Planned { strategy, key });
            }
            plan.resize(start + learning, Planned { strategy: strategy.clone(), key });
        }
        Ok(plan)
    }

    /// Drills one hole and cuts its energy, as the spindle load tells it, into depth bins.
    fn measure(
        &self,
        twin: &Twin,
        strategy: &Strategy,
        wear: f64,
        noise: &mut Noise,
    ) -> Result<DepthProfile, Invalid> {
        let bins = self.params.wear.bins();
        let machine = &twin.params().machine;
        let setup = CycleSetup::new(self.params.spindle_rpm, wear);
        let rated_nm = machine.spindle_rated_torque_nm();
        let mut profile = DepthProfile::new(bins);
        let mut before = 0.0;
        twin.drill(strategy, &setup, Some(noise), |sample| {
            if sample.depth_mm > 0.0 {
                let over_idle = sample.process.spindle_percent - machine.spindle_idle_percent;
                let torque_nm = over_idle / 100.0 * rated_nm;
                let energy = torque_energy_j(torque_nm, setup.spindle_rpm, setup.period_s);
                profile.add(bins, before, sample.depth_mm, setup.period_s, energy);
                before = sample.depth_mm;
            }
        })?;
        Ok(profile)
    }

    /// Studies the lives of the seeds `first_seed .. first_seed + lives`.
    ///
    /// # Errors
    /// When a hole cannot be finished.
    pub fn run(&self, twin: &Twin, first_seed: u64, lives: u32) -> Result<LifeSummary, Invalid> {
        let outcomes: Result<Vec<LifeOutcome>, Invalid> =
            (0..lives).map(|life| self.life(twin, first_seed.wrapping_add(u64::from(life)))).collect();
        Ok(summarise(&outcomes?))
    }
}

/// Sums up outcomes, from one run or from several parts of one.
#[must_use]
pub fn summarise(outcomes: &[LifeOutcome]) -> LifeSummary {
    let mut ratios: Vec<f64> = outcomes.iter().filter_map(LifeOutcome::ratio).collect();
    ratios.sort_by(f64::total_cmp);
    let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    let mut summary = LifeSummary {
        lives: count(outcomes.len()),
        called: count(outcomes.iter().filter(|outcome| outcome.called_at.is_some()).count()),
        within_15_percent: count(ratios.iter().filter(|ratio| (**ratio - 1.0).abs() <= 0.15).count()),
        ..LifeSummary::default()
    };
    if let (Some(first), Some(last)) = (ratios.first(), ratios.last()) {
        let at = |percent: usize| ratios[(ratios.len() - 1) * percent / 100];
        summary.ratio_min_median_max = (*first, at(50), *last);
        summary.ratio_p01_p99 = (at(1), at(99));
    }
    let drilled: u32 = outcomes.iter().map(|outcome| outcome.drilled_cycles).sum();
    let masked: u32 = outcomes.iter().map(|outcome| outcome.masked_cycles).sum();
    if drilled > 0 {
        summary.masked_share = f64::from(masked) / f64::from(drilled);
    }
    summary
}

#[cfg(test)]
mod tests;

//! Life studies on the process model: is wear called when constant feed would have reached the limit?
//!
//! One life is one tool, drilled until its horizon under one strategy or several in turn, with noise of the
//! readings, of the process and of the material. Its wear rate is drawn too. What judges it is the fold that judges
//! the tools of a shop ([`crate::wear::ToolFold`]), on the digests that are stored with their cycles. Only every n-th
//! cycle is drilled ("thinned"): windows and the distance of reference cycles count drilled cycles. Everything follows
//! from the seed, so that a study can be run in parts and on any number of threads.

use super::energy::torque_energy_j;
use super::error::{Invalid, InvalidCode, between};
use super::noise::Noise;
use super::program::Strategy;
use super::relation::{DepthProfile, RelationConfig, RelationParams};
use super::twin::{CycleSetup, PAPER_SPINDLE_RPM, PaperStrategies, PreparedHole, Twin};
use crate::cycle::Flags;
use crate::ids::{CycleId, MachineId, OperationId};
use crate::operation::WearSettings;
use crate::summary::{DIGEST_DEPTH_MM, DepthDigest, EnergyBasis};
use crate::units::{self, Timestamp};
use crate::wear::{CycleFacts, FoldSettings, OrderKey, ToolFold, ToolState, WORN_LEVEL};

/// Most cycles that one simulated life drills.
pub const MOST_DRILLED_CYCLES: u32 = 200_000;

/// Bisection steps for the true life; each halves the error.
const BISECTION_STEPS: u32 = 40;

/// Cycles in a row under one strategy, where several take turns.
const BLOCK_CYCLES: u32 = 20;

/// Time from one cycle to the next, µs; nothing depends on it but their order.
const CADENCE_US: i64 = 20_000_000;

/// What is studied, as plain values; [`LifeStudy::new`] checks them.
#[derive(Debug, Clone, PartialEq)]
pub struct LifeStudyParams {
    /// Strategies that take turns in blocks of twenty cycles, each with the word its cycles are told under.
    pub strategies: Vec<(units::Strategy, Strategy)>,
    /// The reference: constant feed at which the limit is defined.
    pub reference: Strategy,
    /// How wear is judged; without `reference_every_cycles` no reference cycle is asked for.
    pub wear: WearSettings,
    /// Factors on the feed of a program without a law, with which its first cycles are run while the tool is new:
    /// what makes its energy over the feed known. Empty for none.
    pub exploration: Vec<f64>,
    /// First cycles of a life, none of which is thinned out: what the tool is learnt from.
    pub new_cycles: u32,
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
    /// Baselines of sixty cycles; then every 20th cycle is drilled, every third of those a reference cycle where one
    /// is asked for; windows of 31 cycles; wear rates vary by 15 % from tool to tool. Without reference cycles the
    /// first fifteen of each program explore its feed by −20 to +25 %.
    ///
    /// # Errors
    /// Never with these values; they are checked like any other.
    pub fn paper(
        strategies: Vec<(units::Strategy, Strategy)>,
        wears: bool,
        with_references: bool,
    ) -> Result<Self, Invalid> {
        let reference = PaperStrategies::new()?.constant;
        let wear = WearSettings {
            baseline_cycles: 60,
            window_cycles: 31,
            reference_every_cycles: with_references.then_some(2),
            reference_feed_mm_min: Some(reference.program.feed_at(0.0)),
        };
        let keys = u32::try_from(strategies.len()).unwrap_or(u32::MAX).saturating_add(1);
        Ok(Self {
            strategies,
            reference,
            wear,
            exploration: if with_references { Vec::new() } else { [0.8, 0.9, 1.0, 1.12, 1.25].repeat(3) },
            new_cycles: keys.saturating_mul(wear.baseline_cycles),
            thin: 20,
            horizon_cycles: 20_000,
            wear_rate_sd: 0.15,
            wears,
            spindle_rpm: PAPER_SPINDLE_RPM,
        })
    }
}

/// A strategy that is drilled over and over.
#[derive(Debug, Clone, PartialEq)]
struct Ready {
    word: units::Strategy,
    strategy: Strategy,
    hole: Option<PreparedHole>,
    /// The same program at each factor of the exploration.
    explored: Vec<Option<PreparedHole>>,
}

/// A checked study on one model.
#[derive(Debug, Clone, PartialEq)]
pub struct LifeStudy {
    params: LifeStudyParams,
    twin: Twin,
    bins: RelationConfig,
    unit_life: f64,
    reference: Ready,
    strategies: Vec<Ready>,
}

/// One life's outcome, in cycles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LifeOutcome {
    /// Cycle at which the noise-free model at the reference feed reaches the limit; `None` for a tool that does
    /// not wear.
    pub true_life: Option<f64>,
    /// Cycle at which wear was called.
    pub called_at: Option<u32>,
    /// Drilled cycles after which the wear was flagged as masked, by the control or by the feed.
    pub masked_cycles: u32,
    /// Reference cycles that were run.
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
    /// Share of drilled cycles flagged as masked.
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
        for factor in &params.exploration {
            between("exploration", *factor, 0.1, 5.0)?;
        }
        between("wear_rate_sd", params.wear_rate_sd, 0.0, 0.5)?;
        if params.horizon_cycles / params.thin > MOST_DRILLED_CYCLES
            || params.new_cycles > MOST_DRILLED_CYCLES
        {
            let text = format!("a life would drill more than {MOST_DRILLED_CYCLES} cycles; thin more");
            return Err(Invalid::new("thin", InvalidCode::OutOfRange, text));
        }
        let energy = |wear: f64| -> Result<f64, Invalid> {
            let setup = CycleSetup::new(params.spindle_rpm, wear);
            Ok(twin.drill(&params.reference, &setup, None, |_| {})?.energy_j)
        };
        let new = energy(0.0)?;
        let (mut low, mut high) = (0.0, 5.0);
        if energy(high)? < WORN_LEVEL * new {
            let text = "constant feed does not reach the limit within five units of wear";
            return Err(Invalid::new("wear", InvalidCode::NotIdentifiable, text));
        }
        for _ in 0..BISECTION_STEPS {
            let middle = f64::midpoint(low, high);
            if energy(middle)? < WORN_LEVEL * new {
                low = middle;
            } else {
                high = middle;
            }
        }
        let law = &twin.params().wear;
        let unit_life = high.powf(1.0 / law.growth_exponent) * law.cycles_per_unit;
        let bins = RelationConfig::new(RelationParams::energy(DIGEST_DEPTH_MM))?;
        let setup = CycleSetup::new(params.spindle_rpm, 0.0);
        let ready = |word, strategy: &Strategy| {
            let hole = twin.prepare(strategy, &setup, &bins)?;
            let mut explored = Vec::new();
            if hole.is_some() && word != units::Strategy::FConst {
                for factor in &params.exploration {
                    let program = strategy.program.scaled(*factor)?;
                    let scaled = Strategy::new(&*strategy.name, program, strategy.end_depth_mm(), None)?;
                    explored.push(twin.prepare(&scaled, &setup, &bins)?);
                }
            }
            Ok::<_, Invalid>(Ready { word, strategy: strategy.clone(), hole, explored })
        };
        let reference = ready(units::Strategy::FConst, &params.reference)?;
        let strategies = params
            .strategies
            .iter()
            .map(|(word, strategy)| ready(*word, strategy))
            .collect::<Result<_, _>>()?;
        Ok(Self { params, twin: twin.clone(), bins, unit_life, reference, strategies })
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
    pub fn life(&self, seed: u64) -> Result<LifeOutcome, Invalid> {
        let params = &self.params;
        let mut noise = Noise::seeded(seed);
        let spread = (params.wear_rate_sd * noise.normal()).exp();
        let rate = if params.wears { spread } else { 0.0 };
        let settings = FoldSettings {
            wear: params.wear,
            depth_mm: None,
            spindle_speed_rpm: Some(params.spindle_rpm),
            is_friction: true,
            reference_feed_mm_min: params.wear.reference_feed_mm_min,
        };
        let mut fold = ToolFold::default();
        let mut outcome = LifeOutcome {
            true_life: params.wears.then(|| self.unit_life / rate),
            called_at: None,
            masked_cycles: 0,
            reference_cycles: 0,
            drilled_cycles: 0,
        };
        let (mut cycle, mut turn, mut reference_due) = (0_u32, 0_u32, false);
        let mut turns = vec![0_usize; self.strategies.len()];
        while cycle < params.horizon_cycles {
            let place = (turn / BLOCK_CYCLES) as usize % self.strategies.len();
            let (ready, explored) = if reference_due {
                (&self.reference, None)
            } else {
                let own = &self.strategies[place];
                turns[place] += 1;
                turn += 1;
                (own, own.explored.get(turns[place] - 1).and_then(Option::as_ref))
            };
            outcome.reference_cycles += u32::from(reference_due);
            let wear = self.twin.wear_after(f64::from(cycle) * rate);
            let (energy, duration_s) = self.measure(ready, explored, wear, &mut noise)?;
            let facts = self.facts(outcome.drilled_cycles, ready.word, &energy, duration_s)?;
            fold.cycle(&facts, Some(&settings));
            outcome.drilled_cycles += 1;
            let verdict = fold.verdict();
            outcome.masked_cycles = u32::try_from(verdict.feed.masked_cycles).unwrap_or(u32::MAX);
            reference_due = verdict.feed.references.is_some_and(|references| references.due_in == 0);
            if verdict.state == ToolState::Worn {
                outcome.called_at = Some(cycle);
                break;
            }
            cycle += if outcome.drilled_cycles < params.new_cycles { 1 } else { params.thin };
        }
        Ok(outcome)
    }

    /// Drills one hole: its energy over depth, as the spindle load over idle tells it, and its time in s.
    fn measure(
        &self,
        ready: &Ready,
        explored: Option<&PreparedHole>,
        wear: f64,
        noise: &mut Noise,
    ) -> Result<(DepthProfile, f64), Invalid> {
        if let Some(hole) = explored.or(ready.hole.as_ref()) {
            return Ok(self.twin.drill_prepared(hole, wear, Some(noise)));
        }
        let machine = &self.twin.params().machine;
        let setup = CycleSetup::new(self.params.spindle_rpm, wear);
        let rated_nm = machine.spindle_rated_torque_nm();
        let mut profile = DepthProfile::new(&self.bins);
        let mut before = 0.0;
        let figures = self.twin.drill(&ready.strategy, &setup, Some(noise), |sample| {
            if sample.depth_mm > 0.0 {
                let over_idle = sample.process.spindle_percent - machine.spindle_idle_percent;
                let torque_nm = over_idle / 100.0 * rated_nm;
                let energy = torque_energy_j(torque_nm, setup.spindle_rpm, setup.period_s);
                profile.add(&self.bins, before, sample.depth_mm, setup.period_s, energy);
                before = sample.depth_mm;
            }
        })?;
        Ok((profile, figures.duration_s))
    }

    /// What is stored of a drilled cycle.
    fn facts(
        &self,
        number: u32,
        word: units::Strategy,
        energy: &DepthProfile,
        duration_s: f64,
    ) -> Result<CycleFacts, Invalid> {
        let named = |error: crate::invalid::Violation| {
            Invalid::new("cycle", InvalidCode::OutOfRange, error.to_string())
        };
        Ok(CycleFacts {
            order: OrderKey {
                started_at: Timestamp::from_micros(i64::from(number) * CADENCE_US),
                machine: MachineId::try_from("model").map_err(named)?,
                seq: Some(u64::from(number)),
                cycle: CycleId::try_from(format!("c{number}").as_str()).map_err(named)?,
            },
            operation: OperationId::try_from("bushing").map_err(named)?,
            received_at: Timestamp::from_micros(i64::from(number) * CADENCE_US),
            spindle_speed_rpm: Some(self.params.spindle_rpm),
            sampled_speed_rpm: None,
            strategy: Some(word),
            law_version: None,
            profile: None,
            energy: Some((EnergyBasis::Calibrated, false, energy.total())),
            energy_scale: 1,
            duration_ms: Some(duration_s * 1e3),
            max_depth_mm: None,
            fall_depth_mm: None,
            operator_override_percent: None,
            digest: DepthDigest::of(energy),
            asked_as_reference: false,
            coverage: 1.0,
            flags: Flags::NONE,
        })
    }

    /// Studies the lives of the seeds `first_seed .. first_seed + lives`.
    ///
    /// # Errors
    /// When a hole cannot be finished.
    pub fn run(&self, first_seed: u64, lives: u32) -> Result<LifeSummary, Invalid> {
        let outcomes: Result<Vec<LifeOutcome>, Invalid> =
            (0..lives).map(|life| self.life(first_seed.wrapping_add(u64::from(life)))).collect();
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

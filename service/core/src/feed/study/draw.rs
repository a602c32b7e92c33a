//! Random cases: a process, a machine, limits and a profile to start from, all from one seed.

use super::coarse::CoarseModel;
use super::other::{Bump, OtherModel};
use super::plant::{Plant, Run, TwinPlant};
use super::reference::Limits;
use crate::friction::error::Invalid;
use crate::friction::noise::Noise;
use crate::friction::program::Knot;
use crate::friction::twin::{CycleSetup, NoiseLevels, Twin, TwinParams, paper_params, typical_noise};

/// Which process model a case is drawn on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Model {
    /// The friction core's.
    Twin,
    /// The second one, of another structure.
    Other,
    /// The third one, on a coarse control.
    Coarse,
}

/// How the profile to start from was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Start {
    /// One slow feed.
    Conservative,
    /// Stepped by section, as tool makers advise.
    Stepped,
    /// Linear, and close to the limit somewhere.
    Near,
    /// Far above the limit somewhere.
    Overloaded,
}

impl Start {
    /// A word for tables.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Conservative => "conservative",
            Self::Stepped => "stepped",
            Self::Near => "near",
            Self::Overloaded => "overloaded",
        }
    }
}

/// One plant of either model.
#[derive(Debug, Clone)]
pub enum AnyPlant {
    /// The friction core's.
    Twin(Box<TwinPlant>),
    /// The second one.
    Other(Box<OtherModel>),
    /// The third one.
    Coarse(Box<CoarseModel>),
}

impl AnyPlant {
    /// The same with a tool that is worn by `more`, in units of the wear law (1 is the paper's 10 000 holes).
    #[must_use]
    pub fn worn(&self, more: f64) -> Self {
        let mut plant = self.clone();
        match &mut plant {
            Self::Twin(plant) => plant.setup.wear += more,
            Self::Other(plant) => plant.wear += more,
            Self::Coarse(plant) => plant.wear += more,
        }
        plant
    }
}

impl Plant for AnyPlant {
    fn drill(&self, knots: &[Knot], noise: Option<&mut Noise>) -> Result<Run, Invalid> {
        match self {
            Self::Twin(plant) => plant.drill(knots, noise),
            Self::Other(plant) => plant.drill(knots, noise),
            Self::Coarse(plant) => plant.drill(knots, noise),
        }
    }
}

/// A drawn case.
#[derive(Debug, Clone)]
pub struct Case {
    /// Its seed.
    pub seed: u64,
    /// Process and machine.
    pub plant: AnyPlant,
    /// Limits.
    pub limits: Limits,
    /// Kind of start.
    pub start: Start,
    /// Profile to start from.
    pub first: Vec<Knot>,
    /// Noise over what a shop typically sees.
    pub noise_factor: f64,
    /// Wear of the tool at the recorded cycle, in units of the wear law (1 is the paper's worn tool).
    pub wear: f64,
    /// Further wear from one trial to the next: a shop changes a profile every hundred holes rather than every hole.
    pub wear_step: f64,
    /// Sampling, s.
    pub period_s: f64,
}

impl Case {
    /// The plant as it is at a trial, 0 being the recorded cycle.
    #[must_use]
    pub fn plant_at(&self, trial: usize) -> AnyPlant {
        self.plant.worn(self.wear_step * trial as f64)
    }

    /// The plant as it is at the last trial, where its loads are largest.
    #[must_use]
    pub fn last_plant(&self) -> AnyPlant {
        self.plant_at(super::TRIALS)
    }

    /// The same case with a start that takes at most [`SLOWEST_START`] times as long as `reference_s`: a shop that drills
    /// more slowly than that does not ask for the last percent.
    ///
    /// # Errors
    /// When the hole cannot be finished.
    pub fn quickened(&self, reference_s: f64) -> Result<Self, Invalid> {
        let mut case = self.clone();
        for _ in 0..20 {
            let slow = case.plant.drill(&case.first, None)?.duration_s / reference_s / SLOWEST_START;
            if slow <= 1.0 {
                break;
            }
            for knot in &mut case.first {
                let cap = self.limits.cap(knot.depth_mm).max(knot.feed_mm_min);
                knot.feed_mm_min = (knot.feed_mm_min * slow.clamp(1.02, 2.0)).min(cap);
            }
            reachable(&mut case.first, self.limits.acceleration_mm_s2);
        }
        Ok(case)
    }
}

/// Longest time of a start over that of the planner with full knowledge.
const SLOWEST_START: f64 = 4.0;

/// Lowers feeds until the axis reaches them.
fn reachable(knots: &mut [Knot], acceleration_mm_s2: f64) {
    for _ in 0..40 {
        for at in 1..knots.len() {
            let (left, right) = (knots[at - 1], knots[at]);
            if crate::feed::optimise::acceleration_mm_s2(left, right) > acceleration_mm_s2 {
                let slower = left.feed_mm_min.min(right.feed_mm_min);
                for knot in &mut knots[at - 1..=at] {
                    knot.feed_mm_min = slower + (knot.feed_mm_min - slower) * 0.8;
                }
            }
        }
    }
}

/// Largest further wear between two trials: 200 of the paper's 10 000 holes.
const MOST_WEAR_STEP: f64 = 0.02;

struct Dice(Noise);

impl Dice {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.uniform()
    }

    /// Evenly in the logarithm.
    fn factor(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.0.uniform())
    }

    fn one_of<T: Copy>(&mut self, of: &[T]) -> T {
        of[super::steps(self.0.uniform() * of.len() as f64).min(of.len() - 1)]
    }
}

/// Draws the case of a seed.
///
/// # Errors
/// Never with the ranges drawn from; they are checked like any other.
pub fn draw(model: Model, seed: u64) -> Result<Case, Invalid> {
    let mut dice = Dice(Noise::seeded(seed.wrapping_mul(0x9e37_79b9).wrapping_add(17)));
    let nominal = dice.factor(120.0, 420.0);
    let period_s = dice.one_of(&[0.004, 0.008, 0.01, 0.01, 0.02]);
    let acceleration = dice.factor(120.0, 800.0);
    let noise_factor = dice.between(0.25, 1.25);
    let set_percent = [dice.between(22.0, 55.0), dice.between(28.0, 65.0)];
    // How far the loads at the nominal feed lie from the set loads.
    let aims = [dice.between(0.7, 1.25), dice.between(0.7, 1.25)];
    let (plant, end_mm, perforation_mm, shoulder_mm, wear) = match model {
        Model::Twin => twin(&mut dice, nominal, period_s, acceleration, noise_factor, set_percent, aims)?,
        Model::Coarse => coarse(&mut dice, nominal, period_s, acceleration, noise_factor, set_percent, aims)?,
        Model::Other => other(&mut dice, nominal, period_s, acceleration, noise_factor, set_percent, aims)?,
    };
    let feed_max = dice.factor(700.0, 1500.0);
    let heating = (dice.0.uniform() < 0.85)
        .then(|| (nominal * dice.between(0.45, 0.9), perforation_mm * dice.between(0.5, 1.1)));
    let bushing = (dice.0.uniform() < 0.5).then(|| {
        let from = shoulder_mm + dice.between(0.0, 1.0);
        (nominal * dice.between(0.8, 2.2), from, (from + dice.between(1.0, 2.5)).min(end_mm - 1.0))
    });
    let limits = Limits {
        end_mm,
        set_percent,
        feed_mm_min: (dice.between(5.0, 15.0), feed_max),
        acceleration_mm_s2: acceleration,
        heating,
        bushing,
    };
    let start = dice.one_of(&[Start::Conservative, Start::Stepped, Start::Near, Start::Overloaded]);
    let first = first(&mut dice, &plant, &limits, start)?;
    let wear_step = dice.between(0.0, MOST_WEAR_STEP);
    Ok(Case { seed, plant, limits, start, first, noise_factor, wear, wear_step, period_s })
}

type Drawn = (AnyPlant, f64, f64, f64, f64);

fn peaks(run: &Run) -> [f64; 2] {
    let mut peaks = [0.0_f64; 2];
    run.filtered(|_, load| {
        for drive in 0..2 {
            peaks[drive] = peaks[drive].max(load[drive]);
        }
    });
    peaks
}

fn twin(
    dice: &mut Dice,
    nominal: f64,
    period_s: f64,
    acceleration: f64,
    noise_factor: f64,
    set: [f64; 2],
    aims: [f64; 2],
) -> Result<Drawn, Invalid> {
    let mut p: TwinParams = paper_params();
    let size = dice.factor(0.7, 1.7);
    let thickness = dice.between(1.0, 4.0);
    p.tool.diameter_mm *= size;
    p.tool.centre_diameter_mm *= size;
    p.tool.centre_length_mm *= size;
    p.tool.cone_length_mm *= size * dice.between(0.8, 1.2);
    p.tool.shoulder_mm *= size * dice.between(0.6, 1.2);
    p.tool.collar_diameter_mm *= size;
    p.tool.cylinder_length_mm = dice.between(5.0, 14.0) * size.sqrt();
    p.sheet.thickness_mm = thickness;
    p.sheet.bushing_length_mm = thickness * dice.between(3.0, 4.0);
    p.sheet.bushing_decay_mm = thickness * dice.between(0.6, 1.0);
    p.sheet.perforation = dice.between(1.0, 1.4);
    p.sheet.perforation_width = dice.between(0.2, 0.4);
    p.sheet.flash_height_mm = thickness * dice.between(0.4, 0.8);
    p.material.forming_mpa *= dice.factor(0.5, 2.0);
    p.material.friction_mpa *= dice.factor(0.4, 4.0);
    p.material.normal_mpa *= dice.factor(0.5, 2.0);
    p.material.cylinder_contact = dice.between(0.2, 0.7);
    p.material.confinement *= dice.between(0.6, 1.4);
    p.material.flash_shear_mpa *= dice.factor(0.5, 3.0);
    p.material.flash_normal_mpa *= dice.factor(0.5, 3.0);
    p.material.torque_rate_exponent = dice.between(0.5, 1.15);
    p.material.thrust_rate_exponent = dice.between(0.3, 0.75);
    p.material.softening_k *= dice.factor(0.6, 1.6);
    p.material.heat_capacity_j_per_k *= size * size * thickness / 2.0 * dice.factor(0.7, 1.4);
    p.material.cooling_s *= dice.factor(0.5, 2.0);
    p.wear.drag_mpa *= dice.factor(0.5, 2.0);
    p.wear.offset_mm *= size;
    p.wear.half_length_mm *= size;
    p.machine.axis.acceleration_mm_s2 = acceleration;
    p.machine.feed_idle_percent = dice.between(2.0, 6.0);
    p.machine.spindle_idle_percent = dice.between(2.0, 8.0);
    let noise = typical_noise();
    p.noise = NoiseLevels {
        load_points: noise.load_points * noise_factor,
        thrust_n: 0.0,
        torque_nm: 0.0,
        process: noise.process * noise_factor,
        cycle: noise.cycle * noise_factor,
    };
    let rpm = 2800.0 / size.sqrt() * dice.between(0.8, 1.2);
    let wear = if dice.0.uniform() < 0.4 { 0.0 } else { dice.between(0.0, 1.2) };
    let end_mm = p.tool.collar_depth_mm() - dice.between(0.05, 0.4);
    let setup = CycleSetup { period_s, ..CycleSetup::new(rpm, wear) };
    // Rate the machine so that the nominal feed loads it as aimed.
    let plant = |p: TwinParams| -> Result<TwinPlant, Invalid> {
        Ok(TwinPlant { twin: Twin::new(p)?, setup, end_mm })
    };
    let knot = [Knot { depth_mm: 0.0, feed_mm_min: nominal }];
    let seen = peaks(&plant(p)?.drill(&knot, None)?);
    let idle = [p.machine.feed_idle_percent, p.machine.spindle_idle_percent];
    let rated_nm = p.machine.spindle_rated_power_w;
    p.machine.feed_rated_thrust_n *= (seen[0] - idle[0]) / (set[0] * aims[0] - idle[0]).max(2.0);
    p.machine.spindle_rated_power_w = rated_nm * (seen[1] - idle[1]) / (set[1] * aims[1] - idle[1]).max(2.0);
    let perforation = p.sheet.perforation * thickness;
    Ok((AnyPlant::Twin(Box::new(plant(p)?)), end_mm, perforation, p.tool.shoulder_depth_mm(), wear))
}

fn other(
    dice: &mut Dice,
    nominal: f64,
    period_s: f64,
    acceleration: f64,
    noise_factor: f64,
    set: [f64; 2],
    aims: [f64; 2],
) -> Result<Drawn, Invalid> {
    let end_mm = dice.between(9.0, 28.0);
    let perforation = end_mm * dice.between(0.1, 0.2);
    let shoulder = end_mm * dice.between(0.42, 0.55);
    let flange_mm = end_mm - dice.between(0.0, 0.2);
    let bump =
        |at_mm, rise_mm, fall_mm, percent, exponent| Bump { at_mm, rise_mm, fall_mm, percent, exponent };
    let feed_drive = vec![
        bump(perforation, perforation * 0.8, end_mm * dice.between(0.05, 0.1), 1.0, dice.between(0.2, 0.9)),
        bump(shoulder * 0.8, end_mm * 0.15, end_mm * 0.07, dice.between(0.3, 0.9), dice.between(0.3, 1.0)),
        bump(flange_mm, dice.between(0.5, 1.2), 5.0, dice.between(0.3, 1.2), dice.between(0.2, 0.8)),
        bump(shoulder * 0.5, end_mm * 0.3, end_mm * 0.15, dice.between(0.02, 0.15), 0.0),
    ];
    let wear = dice.between(0.0, 1.2);
    let drag = bump(shoulder * 1.1, end_mm * 0.07, end_mm * 0.06, dice.between(0.05, 0.2), 0.0);
    let spindle = vec![
        bump(
            shoulder,
            end_mm * dice.between(0.15, 0.28),
            end_mm * dice.between(0.06, 0.11),
            1.0,
            dice.between(0.35, 1.05),
        ),
        bump(perforation * 1.3, perforation, perforation, dice.between(0.1, 0.5), dice.between(0.3, 0.9)),
        bump(flange_mm, dice.between(0.5, 1.2), 5.0, dice.between(0.2, 0.9), dice.between(0.2, 0.8)),
    ];
    let mut model = OtherModel {
        feed_drive,
        spindle,
        drag,
        wear,
        reference_feed_mm_min: nominal,
        end_mm,
        floor: dice.between(0.2, 0.6),
        soften_percent_s: [1.0, 1.0],
        memory_s: [0.5, dice.between(3.0, 12.0)],
        idle_percent: [dice.between(2.0, 6.0), dice.between(2.0, 8.0)],
        viscous_percent: dice.between(0.0, 3.0),
        delay_s: dice.between(0.0, 0.03),
        lag_s: dice.between(0.003, 0.02),
        resolution: dice.one_of(&[0.1, 0.1, 0.4]),
        servo_s: dice.between(0.01, 0.03),
        acceleration_mm_s2: acceleration,
        period_s,
        uneven: 0.03 * noise_factor,
        common: 0.015 * noise_factor,
        reading: 0.5 * noise_factor,
        bursts_per_s: noise_factor * 0.3,
    };
    let knot = [Knot { depth_mm: 0.0, feed_mm_min: nominal }];
    let scale = |bumps: &mut [Bump], by: f64| {
        for bump in bumps {
            bump.percent *= by;
        }
    };
    // Softening follows the loads, so rating the machine needs a few rounds.
    let softening = [dice.between(0.15, 0.5), dice.between(0.5, 2.0)];
    let total_s = end_mm / nominal * 60.0;
    for _ in 0..6 {
        let work = 0.4 * (set[1] * aims[1]) * total_s.min(6.0);
        model.soften_percent_s = [work * softening[0].recip(), work / softening[1]];
        let seen = peaks(&model.drill(&knot, None)?);
        for drive in 0..2 {
            let idle = model.idle_percent[drive];
            let by = (set[drive] * aims[drive] - idle).max(2.0) / (seen[drive] - idle).max(1e-6);
            scale(if drive == 0 { &mut model.feed_drive } else { &mut model.spindle }, by);
            if drive == 1 {
                model.drag.percent *= by;
            }
        }
    }
    Ok((AnyPlant::Other(Box::new(model)), end_mm, perforation, shoulder, wear))
}

fn coarse(
    dice: &mut Dice,
    nominal: f64,
    period_s: f64,
    acceleration: f64,
    noise_factor: f64,
    set: [f64; 2],
    aims: [f64; 2],
) -> Result<Drawn, Invalid> {
    let end_mm = dice.between(8.0, 30.0);
    let perforation = end_mm * dice.between(0.1, 0.2);
    let shoulder = end_mm * dice.between(0.4, 0.6);
    let collar = end_mm - dice.between(0.4, 1.5);
    let corners = vec![
        (0.0, [dice.between(0.1, 0.4), dice.between(0.05, 0.2)]),
        (perforation, [1.0, dice.between(0.4, 0.8)]),
        (perforation * 1.6, [dice.between(0.4, 0.8), dice.between(0.4, 0.9)]),
        (shoulder, [dice.between(0.3, 0.7), 1.0]),
        (shoulder + end_mm * 0.12, [dice.between(0.08, 0.3), dice.between(0.2, 0.5)]),
        (collar, [dice.between(0.08, 0.3), dice.between(0.2, 0.5)]),
        (end_mm, [dice.between(0.4, 1.2), dice.between(0.4, 1.0)]),
    ];
    let mut model = CoarseModel {
        corners,
        fixed: [dice.between(0.1, 0.6), dice.between(0.05, 0.5)],
        reference_feed_mm_min: nominal,
        end_mm,
        softening: (dice.between(0.1, 0.6), dice.between(0.5, 4.0)),
        worn: [dice.between(0.0, 0.3), dice.between(0.0, 0.2)],
        wear: dice.between(0.0, 1.2),
        idle_percent: [dice.between(2.0, 6.0), dice.between(2.0, 8.0)],
        resolution: dice.one_of(&[0.1, 0.5, 1.0]),
        repeats: dice.one_of(&[1, 1, 2]),
        acceleration_mm_s2: acceleration,
        period_s,
        ripple: (0.03 * noise_factor, dice.between(0.02, 0.06)),
        drift: 0.02 * noise_factor,
        common: 0.015 * noise_factor,
        reading: 0.3 * noise_factor,
    };
    let seen = peaks(&model.drill(&[Knot { depth_mm: 0.0, feed_mm_min: nominal }], None)?);
    for (_, loads) in &mut model.corners {
        for drive in 0..2 {
            let idle = model.idle_percent[drive];
            loads[drive] *= (set[drive] * aims[drive] - idle).max(2.0) / (seen[drive] - idle).max(1e-6);
        }
    }
    let wear = model.wear;
    Ok((AnyPlant::Coarse(Box::new(model)), end_mm, perforation, shoulder, wear))
}

/// A profile to start from; found by drilling without noise, as the shop's own trials would have.
fn first(dice: &mut Dice, plant: &AnyPlant, limits: &Limits, start: Start) -> Result<Vec<Knot>, Invalid> {
    let end = limits.end_mm;
    let shape: Vec<(f64, f64)> = match start {
        Start::Conservative => vec![(0.0, 1.0), (1.0, 1.0)],
        Start::Stepped => {
            let cuts = [dice.between(0.12, 0.25), dice.between(0.35, 0.45), dice.between(0.6, 0.75)];
            let feeds = [
                dice.between(0.5, 1.0),
                dice.between(1.0, 2.0),
                dice.between(0.5, 1.0),
                dice.between(0.8, 2.0),
            ];
            let ramp = 0.03;
            vec![
                (0.0, feeds[0]),
                (cuts[0], feeds[0]),
                (cuts[0] + ramp, feeds[1]),
                (cuts[1], feeds[1]),
                (cuts[1] + ramp, feeds[2]),
                (cuts[2], feeds[2]),
                (cuts[2] + ramp, feeds[3]),
                (1.0, feeds[3]),
            ]
        }
        Start::Near | Start::Overloaded => vec![
            (0.0, dice.between(0.6, 1.0)),
            (0.15, dice.between(0.8, 1.4)),
            (0.35, dice.between(1.0, 2.0)),
            (0.55, dice.between(0.6, 1.2)),
            (0.7, dice.between(1.0, 3.0)),
            (0.9, dice.between(1.0, 3.0)),
            (1.0, dice.between(0.6, 1.2)),
        ],
    };
    let aim = match start {
        Start::Conservative => dice.between(0.4, 0.75),
        Start::Stepped => dice.between(0.6, 0.95),
        Start::Near => dice.between(0.9, 1.03),
        Start::Overloaded => dice.between(1.15, 1.5),
    };
    let knots = |scale: f64| -> Vec<Knot> {
        let mut knots: Vec<Knot> = shape
            .iter()
            .map(|(part, feed)| Knot {
                depth_mm: part * end,
                feed_mm_min: (feed * scale).clamp(limits.feed_mm_min.0, limits.feed_mm_min.1),
            })
            .collect();
        // A shop's profile keeps its axis' acceleration.
        reachable(&mut knots, limits.acceleration_mm_s2);
        knots
    };
    let (mut low, mut high) = (limits.feed_mm_min.0, limits.feed_mm_min.1 * 2.0);
    for _ in 0..24 {
        let middle = (low * high).sqrt();
        if plant.drill(&knots(middle), None)?.worst_ratio(limits.set_percent) < aim {
            low = middle;
        } else {
            high = middle;
        }
    }
    Ok(knots(low))
}

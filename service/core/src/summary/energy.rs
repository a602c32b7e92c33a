//! Energy of a cycle by basis (Stryczek & Błaszczak 2020, Eq. 5–7).
//!
//! Five bases, named with every figure and never mixed. No joules where neither power nor a rating is known.

use super::digest::way_in_contact;
use super::{Context, SampleClock, loads};
use crate::cycle::{Channel, Samples};
use crate::machine::{Calibration, FittedLine, LoadReference};
use std::f64::consts::TAU;

/// How an energy was told, best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum EnergyBasis {
    /// Thrust and torque measured.
    Dynamometer,
    /// Thrust and torque from loads by the machine's fitted lines.
    Calibrated,
    /// A channel in watts, integrated.
    MeasuredPower,
    /// Spindle load times rated power, feed-drive load times rated thrust and velocity.
    RatedPower,
    /// Joules that the control itself reports.
    Reported,
}

impl EnergyBasis {
    /// Every basis, best first.
    pub const ALL: [Self; 5] =
        [Self::Dynamometer, Self::Calibrated, Self::MeasuredPower, Self::RatedPower, Self::Reported];

    /// The word used in the API and in storage.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Dynamometer => "dynamometer",
            Self::Calibrated => "calibrated",
            Self::MeasuredPower => "measured_power",
            Self::RatedPower => "rated_power",
            Self::Reported => "reported",
        }
    }

    /// The basis of that word.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|basis| basis.as_str() == text)
    }
}

/// What was done about the power that the spindle draws without cutting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum IdlePower {
    /// The basis has none: it speaks of the tool, not of the drive.
    NotApplicable,
    /// Not known, so it is still in the figure.
    Included,
    /// Subtracted: the median before contact, W.
    Subtracted {
        /// The idle power, W.
        watts: f64,
    },
}

/// One cycle's energy on one basis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Energy {
    /// How it was told.
    pub basis: EnergyBasis,
    /// The whole, J.
    pub total_joules: f64,
    /// The spindle's part, J; `None` where only the whole is known.
    pub spindle_joules: Option<f64>,
    /// The feed drive's part, J; `None` where it is not known and counted as 0.
    pub feed_drive_joules: Option<f64>,
    /// What was done about idle power.
    pub idle: IdlePower,
}

impl Energy {
    pub(super) fn reported(joules: f64) -> Self {
        Self {
            basis: EnergyBasis::Reported,
            total_joules: joules,
            spindle_joules: None,
            feed_drive_joules: None,
            idle: IdlePower::Included,
        }
    }

    fn of_parts(basis: EnergyBasis, spindle: f64, feed_drive: Option<f64>, idle: IdlePower) -> Self {
        Self {
            basis,
            total_joules: spindle + feed_drive.unwrap_or(0.0),
            spindle_joules: Some(spindle),
            feed_drive_joules: feed_drive,
            idle,
        }
    }
}

/// Samples before contact that idle power needs: fewer are still spinning up.
const IDLE_SAMPLES: usize = 5;

/// All energies that can be told, best basis first, and whether fitted lines were asked beyond their range.
pub(super) fn by_basis(
    samples: &Samples,
    clock: &SampleClock,
    commanded_rpm: Option<f64>,
    context: Context<'_>,
) -> (Vec<Energy>, bool) {
    let motion = Motion { samples, clock, commanded_rpm };
    let mut energies = Vec::new();
    if let Some(torque) = samples.column(Channel::TorqueNewtonMetres)
        && let Some(spindle) = motion.spindle_work(torque)
    {
        let feed = samples.column(Channel::ThrustNewtons).and_then(|thrust| motion.feed_work(thrust));
        energies.push(Energy::of_parts(EnergyBasis::Dynamometer, spindle, feed, IdlePower::NotApplicable));
    }
    let mut beyond = false;
    if let Some(calibration) = context.calibration {
        match motion.calibrated(calibration) {
            Calibrated::Energy(energy) => energies.push(energy),
            Calibrated::Beyond => beyond = true,
            Calibrated::NotPossible => {}
        }
    }
    energies.extend(motion.measured_power());
    energies.extend(motion.rated_power(context));
    (energies, beyond)
}

/// Joules of every sample on the basis of `best`; their sum is its total. `None` where joules were only reported.
pub(super) fn by_sample(
    samples: &Samples,
    clock: &SampleClock,
    commanded_rpm: Option<f64>,
    context: Context<'_>,
    best: &Energy,
) -> Option<Vec<f64>> {
    let motion = Motion { samples, clock, commanded_rpm };
    let column = |channel| samples.column(channel);
    let calibration = context.calibration;
    let (torque, thrust): (Option<Vec<f64>>, Option<Vec<f64>>) = match best.basis {
        EnergyBasis::Dynamometer => (
            column(Channel::TorqueNewtonMetres).map(<[f64]>::to_vec),
            column(Channel::ThrustNewtons).map(<[f64]>::to_vec),
        ),
        EnergyBasis::Calibrated => {
            let along = |line: Option<FittedLine>, load: Option<&[f64]>| {
                line.zip(load).and_then(|(line, load)| motion.along(&line, load))
            };
            (
                along(calibration.and_then(|lines| lines.torque), column(Channel::SpindleLoadPercent)),
                along(calibration.and_then(|lines| lines.thrust), column(Channel::FeedDriveLoadPercent)),
            )
        }
        EnergyBasis::MeasuredPower => return motion.measured_by_sample(best.idle),
        EnergyBasis::RatedPower => return motion.rated_by_sample(context),
        EnergyBasis::Reported => return None,
    };
    let torque = torque?;
    let mut joules = Vec::with_capacity(torque.len());
    for (index, torque) in torque.iter().enumerate() {
        joules.push(torque * TAU * motion.speed_rpm(index)? / 60.0 * clock.width_s(index));
    }
    if best.feed_drive_joules.is_some() {
        motion.add_feed_work(&thrust?, &mut joules)?;
    }
    Some(joules)
}

/// Fingerprint of what an energy rests on besides the samples (FNV-1a, 63 bits).
pub(super) fn scale(energy: &Energy, context: Context<'_>) -> i64 {
    let spindle = &context.machine.spindle;
    let bits = |value: Option<f64>| value.map_or(1, f64::to_bits);
    let thrust = bits(context.machine.feed_drive.rated_thrust_newtons);
    let parts = u64::from(energy.feed_drive_joules.is_some());
    let rests_on = match energy.basis {
        EnergyBasis::Dynamometer | EnergyBasis::MeasuredPower | EnergyBasis::Reported => [parts, 0, 0, 0],
        EnergyBasis::Calibrated => {
            [parts, context.calibration.map_or(0, |lines| u64::from(lines.version)), 0, 0]
        }
        EnergyBasis::RatedPower => [
            parts * thrust,
            spindle.reference as u64,
            bits(spindle.rated_power_watts),
            if spindle.reference.follows_torque() { bits(spindle.base_speed_rpm) } else { 0 },
        ],
    };
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for byte in rests_on.iter().flat_map(|word| word.to_le_bytes()) {
        hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    }
    (hash >> 1).cast_signed()
}

pub(super) struct Motion<'a> {
    pub(super) samples: &'a Samples,
    pub(super) clock: &'a SampleClock,
    pub(super) commanded_rpm: Option<f64>,
}

enum Calibrated {
    Energy(Energy),
    Beyond,
    NotPossible,
}

impl Motion<'_> {
    fn speed_rpm(&self, index: usize) -> Option<f64> {
        match self.samples.column(Channel::SpindleSpeedRpm) {
            Some(speed) => Some(speed[index].abs()),
            None => self.commanded_rpm,
        }
    }

    /// E_C = Σ T·2π·S/60·Δt (Eq. 6), N·m and rpm to J.
    fn spindle_work(&self, torque: &[f64]) -> Option<f64> {
        let mut joules = 0.0;
        for (index, torque) in torque.iter().enumerate() {
            joules += torque * TAU * self.speed_rpm(index)? / 60.0 * self.clock.width_s(index);
        }
        Some(joules)
    }

    /// The terms of [`Self::spindle_work`].
    pub(super) fn spindle_steps(&self, torque: &[f64]) -> Option<Vec<f64>> {
        let step = |(index, torque): (usize, &f64)| {
            Some(torque * TAU * self.speed_rpm(index)? / 60.0 * self.clock.width_s(index))
        };
        torque.iter().enumerate().map(step).collect()
    }

    /// The terms of [`Self::feed_work`].
    pub(super) fn feed_steps(&self, thrust: &[f64]) -> Option<Vec<f64>> {
        if let Some(depth) = self.samples.column(Channel::DepthMm) {
            let way = |k: usize| if k == 0 { 0.0 } else { depth[k] - depth[k - 1] };
            return Some((0..thrust.len()).map(|k| thrust[k] * way(k) * 1e-3).collect());
        }
        let feed = self.samples.column(Channel::FeedActualMmMin)?;
        let metres = |k: usize| feed[k] / 60.0 * 1e-3 * self.clock.width_s(k);
        Some((0..thrust.len()).map(|k| thrust[k] * metres(k)).collect())
    }

    /// The terms of [`Self::integrate`].
    pub(super) fn power_steps(&self, watts: &[f64]) -> Vec<f64> {
        if watts.len() == 1 {
            return vec![watts[0] * self.clock.width_s(0)];
        }
        let before = |k: usize| if k == 0 { 0.0 } else { f64::midpoint(watts[k - 1], watts[k]) };
        (0..watts.len()).map(|k| before(k) * self.clock.width_s(k)).collect()
    }

    /// The terms of the spindle's part of [`Self::rated_power`].
    pub(super) fn rated_steps(&self, context: Context<'_>) -> Option<Vec<f64>> {
        let load = self.samples.column(Channel::SpindleLoadPercent)?;
        let rating = &context.machine.spindle;
        let rated = rating.rated_power_watts.filter(|_| rating.reference != LoadReference::Unknown)?;
        let step = |(index, load): (usize, &f64)| {
            let share = if rating.reference.follows_torque() {
                (self.speed_rpm(index)? / rating.base_speed_rpm?).min(1.0)
            } else {
                1.0
            };
            Some(load / 100.0 * rated * share * self.clock.width_s(index))
        };
        load.iter().enumerate().map(step).collect()
    }

    /// E_Z = Σ F·ΔZ (Eq. 5), N and mm to J; from the actual feed where depth was not sampled.
    fn feed_work(&self, thrust: &[f64]) -> Option<f64> {
        if let Some(depth) = self.samples.column(Channel::DepthMm) {
            return Some((1..thrust.len()).map(|k| thrust[k] * (depth[k] - depth[k - 1]) * 1e-3).sum());
        }
        let feed = self.samples.column(Channel::FeedActualMmMin)?;
        let metres = |k: usize| feed[k] / 60.0 * 1e-3 * self.clock.width_s(k);
        Some((0..thrust.len()).map(|k| thrust[k] * metres(k)).sum())
    }

    /// Adds [`Motion::feed_work`] sample by sample.
    fn add_feed_work(&self, thrust: &[f64], joules: &mut [f64]) -> Option<()> {
        if let Some(depth) = self.samples.column(Channel::DepthMm) {
            for k in 1..thrust.len() {
                joules[k] += thrust[k] * (depth[k] - depth[k - 1]) * 1e-3;
            }
            return Some(());
        }
        let feed = self.samples.column(Channel::FeedActualMmMin)?;
        for k in 0..thrust.len() {
            joules[k] += thrust[k] * feed[k] / 60.0 * 1e-3 * self.clock.width_s(k);
        }
        Some(())
    }

    /// The trapezoids of [`Motion::integrate`] over idle, each with the sample that ends it.
    fn measured_by_sample(&self, idle: IdlePower) -> Option<Vec<f64>> {
        let watts = self.samples.column(Channel::SpindlePowerWatts)?;
        let idle = if let IdlePower::Subtracted { watts } = idle { watts } else { 0.0 };
        let feed = self.samples.column(Channel::FeedDrivePowerWatts);
        let power = |k: usize| watts[k] - idle + feed.map_or(0.0, |feed| feed[k]);
        let each = |k: usize| {
            let mean = if k == 0 { 0.0 } else { f64::midpoint(power(k - 1), power(k)) };
            mean * self.clock.width_s(k)
        };
        Some((0..watts.len()).map(each).collect())
    }

    fn rated_by_sample(&self, context: Context<'_>) -> Option<Vec<f64>> {
        let load = self.samples.column(Channel::SpindleLoadPercent)?;
        let rating = &context.machine.spindle;
        let rated = rating.rated_power_watts?;
        let mut joules = Vec::with_capacity(load.len());
        for (index, load) in load.iter().enumerate() {
            let share = self.rated_share(index, context)?;
            joules.push(load / 100.0 * rated * share * self.clock.width_s(index));
        }
        if let Some(thrust) = self.rated_thrust(context) {
            self.add_feed_work(&thrust, &mut joules);
        }
        Some(joules)
    }

    /// What the tool feels at each sample by a fitted line; `None` where a load lies beyond it.
    ///
    /// Nothing before contact, where depth was sampled: what the drives need to spin up and to move is not the tool's,
    /// and the peak of spinning up lies beyond what any hole was fitted to.
    pub(super) fn along(&self, line: &FittedLine, load: &[f64]) -> Option<Vec<f64>> {
        let depth = self.samples.column(Channel::DepthMm);
        let surface = depth.and_then(way_in_contact).map_or(0, |(surface, _)| surface);
        let felt = |(index, &load): (usize, &f64)| {
            if index < surface { Some(0.0) } else { line.at(load) }
        };
        load.iter().enumerate().map(felt).collect()
    }

    fn calibrated(&self, calibration: &Calibration) -> Calibrated {
        let (Some(line), Some(load)) = (calibration.torque, self.samples.column(Channel::SpindleLoadPercent))
        else {
            return Calibrated::NotPossible;
        };
        let Some(torque) = self.along(&line, load) else {
            return Calibrated::Beyond;
        };
        let Some(spindle) = self.spindle_work(&torque) else {
            return Calibrated::NotPossible;
        };
        let mut feed = None;
        if let (Some(line), Some(load)) =
            (calibration.thrust, self.samples.column(Channel::FeedDriveLoadPercent))
        {
            let Some(thrust) = self.along(&line, load) else {
                return Calibrated::Beyond;
            };
            feed = self.feed_work(&thrust);
        }
        Calibrated::Energy(Energy::of_parts(EnergyBasis::Calibrated, spindle, feed, IdlePower::NotApplicable))
    }

    /// Trapezoid over a channel in watts; intervals that are gaps carry nothing.
    fn integrate(&self, watts: &[f64]) -> f64 {
        if watts.len() == 1 {
            return watts[0] * self.clock.width_s(0);
        }
        (1..watts.len()).map(|k| f64::midpoint(watts[k - 1], watts[k]) * self.clock.width_s(k)).sum()
    }

    fn measured_power(&self) -> Option<Energy> {
        let watts = self.samples.column(Channel::SpindlePowerWatts)?;
        let gross = self.integrate(watts);
        let (spindle, idle) = match self.idle_watts(watts) {
            Some(idle) => {
                (gross - self.integrate(&vec![idle; watts.len()]), IdlePower::Subtracted { watts: idle })
            }
            None => (gross, IdlePower::Included),
        };
        let feed = self.samples.column(Channel::FeedDrivePowerWatts).map(|watts| self.integrate(watts));
        Some(Energy::of_parts(EnergyBasis::MeasuredPower, spindle, feed, idle))
    }

    /// Median power in the later half of the samples before contact: the earlier half may be spinning up.
    pub(super) fn idle_watts(&self, watts: &[f64]) -> Option<f64> {
        let depth = self.samples.column(Channel::DepthMm)?;
        let before = depth.iter().take_while(|&&z| z < 0.0).count();
        // A recording without any cut has no "before contact".
        if before == depth.len() {
            return None;
        }
        let steady = &watts[before / 2..before];
        (steady.len() >= IDLE_SAMPLES).then(|| loads::median(steady))
    }

    /// Load × rated power, times min(1, S/S_base) where the percent follows torque.
    fn rated_power(&self, context: Context<'_>) -> Option<Energy> {
        let load = self.samples.column(Channel::SpindleLoadPercent)?;
        let rating = &context.machine.spindle;
        let rated = rating.rated_power_watts?;
        if rating.reference == LoadReference::Unknown {
            return None;
        }
        let mut spindle = 0.0;
        for (index, load) in load.iter().enumerate() {
            let share = self.rated_share(index, context)?;
            spindle += load / 100.0 * rated * share * self.clock.width_s(index);
        }
        let feed = self.rated_feed(context);
        Some(Energy::of_parts(EnergyBasis::RatedPower, spindle, feed, IdlePower::Included))
    }

    /// min(1, S/S_base) where the spindle's percent follows torque, else 1.
    fn rated_share(&self, index: usize, context: Context<'_>) -> Option<f64> {
        let rating = &context.machine.spindle;
        if rating.reference.follows_torque() {
            Some((self.speed_rpm(index)? / rating.base_speed_rpm?).min(1.0))
        } else {
            Some(1.0)
        }
    }

    /// The feed drive's percent is a force: load × rated thrust × way, where the thrust is declared.
    fn rated_feed(&self, context: Context<'_>) -> Option<f64> {
        self.feed_work(&self.rated_thrust(context)?)
    }

    /// The thrust that the feed drive's load stands for, N.
    pub(super) fn rated_thrust(&self, context: Context<'_>) -> Option<Vec<f64>> {
        let rated = context.machine.feed_drive.rated_thrust_newtons?;
        if context.machine.feed_drive.reference == LoadReference::Unknown {
            return None;
        }
        let load = self.samples.column(Channel::FeedDriveLoadPercent)?;
        Some(load.iter().map(|load| load / 100.0 * rated).collect())
    }
}

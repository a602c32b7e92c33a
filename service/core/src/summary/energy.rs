//! Energy of a cycle by basis (Stryczek & Błaszczak 2020, Eq. 5–7).
//!
//! Five bases, named with every figure and never mixed. No joules where neither power nor a rating is known.

use super::digest::way_in_contact;
use super::{Context, SampleClock, loads, scan};
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

    /// Whether the whole and its parts are energies that a machine could have spent.
    fn is_plausible(&self) -> bool {
        let parts = [Some(self.total_joules), self.spindle_joules, self.feed_drive_joules];
        parts.into_iter().flatten().all(|joules| joules.abs() <= MOST_JOULES)
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

/// Largest energy that is told of a cycle, up or down, J: no machine in a hundred years needs as much.
pub const MOST_JOULES: f64 = 1e18;

/// Samples before contact that idle power needs: fewer are still spinning up.
const IDLE_SAMPLES: usize = 5;

/// What a cycle's samples tell of its energy.
#[derive(Debug, Default)]
pub(super) struct Told {
    /// All energies that can be told, best basis first.
    pub(super) energies: Vec<Energy>,
    /// Joules of every sample on the best basis.
    pub(super) best_by_sample: Option<Vec<f64>>,
    /// Whether fitted lines were asked beyond their range.
    pub(super) is_beyond_calibration: bool,
    /// Whether an energy is larger than any that is told, so that its basis was passed over.
    pub(super) is_implausible: bool,
}

impl Told {
    fn add(&mut self, energy: Energy, by_sample: impl FnOnce() -> Option<Vec<f64>>) {
        if !energy.is_plausible() {
            self.is_implausible = true;
            return;
        }
        if self.energies.is_empty() {
            self.best_by_sample = by_sample();
        }
        self.energies.push(energy);
    }

    fn add_terms(&mut self, basis: EnergyBasis, terms: Terms, idle: IdlePower) {
        self.add(terms.energy(basis, idle), || Some(terms.together()));
    }
}

/// What an energy sums up: joules of every sample.
pub(super) struct Terms {
    pub(super) spindle: Vec<f64>,
    pub(super) feed_drive: Option<Vec<f64>>,
}

impl Terms {
    fn energy(&self, basis: EnergyBasis, idle: IdlePower) -> Energy {
        // Without a feed drive's part the spindle's stands in for it: it costs nothing and is not told.
        let feed_drive = self.feed_drive.as_ref();
        let [spindle, other] = scan::sums([&self.spindle, feed_drive.unwrap_or(&self.spindle)]);
        let feed_drive = feed_drive.map(|_| other);
        // Adding zero: no negative zero where nothing was done.
        Energy::of_parts(basis, spindle + 0.0, feed_drive, idle)
    }

    /// Both parts of every sample.
    pub(super) fn together(self) -> Vec<f64> {
        let mut joules = self.spindle;
        if let Some(feed_drive) = self.feed_drive {
            joules.iter_mut().zip(feed_drive).for_each(|(joules, more)| *joules += more);
        }
        joules
    }
}

/// All energies that the samples tell.
pub(super) fn by_basis(
    samples: &Samples,
    clock: &SampleClock,
    commanded_rpm: Option<f64>,
    context: Context<'_>,
) -> Told {
    let motion = Motion { samples, clock, commanded_rpm };
    let mut told = Told::default();
    if let Some(terms) = motion.dynamometer() {
        told.add_terms(EnergyBasis::Dynamometer, terms, IdlePower::NotApplicable);
    }
    if let Some(calibration) = context.calibration {
        match motion.calibrated(calibration) {
            Calibrated::Told(terms) => {
                told.add_terms(EnergyBasis::Calibrated, terms, IdlePower::NotApplicable);
            }
            Calibrated::Beyond => told.is_beyond_calibration = true,
            Calibrated::NotPossible => {}
        }
    }
    if let Some(energy) = motion.measured_power() {
        told.add(energy, || motion.measured_by_sample(energy.idle));
    }
    if let Some(terms) = motion.rated_power(context) {
        told.add_terms(EnergyBasis::RatedPower, terms, IdlePower::Included);
    }
    told
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

pub(super) enum Calibrated {
    Told(Terms),
    Beyond,
    NotPossible,
}

/// Nothing: a term that leaves every sum as it is, to the sign of a zero.
const NO_WORK: f64 = -0.0;

impl Motion<'_> {
    /// Thrust and torque as measured.
    pub(super) fn dynamometer(&self) -> Option<Terms> {
        let spindle = self.spindle_steps(self.samples.column(Channel::TorqueNewtonMetres)?)?;
        let thrust = self.samples.column(Channel::ThrustNewtons);
        Some(Terms { spindle, feed_drive: thrust.and_then(|thrust| self.feed_steps(thrust)) })
    }

    /// The terms of E_C = Σ T·2π·S/60·Δt (Eq. 6), N·m and rpm to J.
    fn spindle_steps(&self, torque: &[f64]) -> Option<Vec<f64>> {
        let mut joules = torque.to_vec();
        self.by_speed(&mut joules, |torque, rpm| torque * TAU * rpm / 60.0)?;
        self.clock.weigh(&mut joules);
        Some(joules)
    }

    /// Makes something else of each value with the spindle's speed at its sample; `None` where no speed is known.
    fn by_speed(&self, values: &mut [f64], made: impl Fn(f64, f64) -> f64) -> Option<()> {
        if let Some(speed) = self.samples.column(Channel::SpindleSpeedRpm) {
            values.iter_mut().zip(speed).for_each(|(value, speed)| *value = made(*value, speed.abs()));
        } else {
            let commanded_rpm = self.commanded_rpm?;
            values.iter_mut().for_each(|value| *value = made(*value, commanded_rpm));
        }
        Some(())
    }

    /// The terms of E_Z = Σ F·ΔZ (Eq. 5), N and mm to J; from the actual feed where depth was not sampled.
    fn feed_steps(&self, thrust: &[f64]) -> Option<Vec<f64>> {
        if let Some(depth) = self.samples.column(Channel::DepthMm) {
            let work = |(thrust, way): (&f64, &[f64])| thrust * (way[1] - way[0]) * 1e-3;
            let mut joules = Vec::with_capacity(thrust.len());
            joules.push(NO_WORK);
            joules.extend(thrust[1..].iter().zip(depth.windows(2)).map(work));
            return Some(joules);
        }
        let feed = self.samples.column(Channel::FeedActualMmMin)?;
        let mut joules: Vec<f64> = feed.iter().map(|feed| feed / 60.0 * 1e-3).collect();
        self.clock.weigh(&mut joules);
        joules.iter_mut().zip(thrust).for_each(|(metres, thrust)| *metres *= thrust);
        Some(joules)
    }

    /// The terms of [`Self::integrate`].
    pub(super) fn power_steps(&self, watts: &[f64]) -> Vec<f64> {
        let mut joules = Vec::with_capacity(watts.len());
        joules.push(if watts.len() == 1 { watts[0] } else { NO_WORK });
        joules.extend(watts.windows(2).map(|pair| f64::midpoint(pair[0], pair[1])));
        self.clock.weigh(&mut joules);
        joules
    }

    /// The trapezoids of [`Motion::integrate`] over idle, each with the sample that ends it.
    fn measured_by_sample(&self, idle: IdlePower) -> Option<Vec<f64>> {
        let watts = self.samples.column(Channel::SpindlePowerWatts)?;
        let idle = if let IdlePower::Subtracted { watts } = idle { watts } else { 0.0 };
        let feed = self.samples.column(Channel::FeedDrivePowerWatts);
        let power = |k: usize| watts[k] - idle + feed.map_or(0.0, |feed| feed[k]);
        let mean = |k: usize| if k == 0 { 0.0 } else { f64::midpoint(power(k - 1), power(k)) };
        let mut joules: Vec<f64> = (0..watts.len()).map(mean).collect();
        self.clock.weigh(&mut joules);
        Some(joules)
    }

    /// What the tool feels at each sample by a fitted line; `None` where a load lies beyond it.
    ///
    /// Nothing before contact, where depth was sampled: what the drives need to spin up and to move is not the tool's,
    /// and the peak of spinning up lies beyond what any hole was fitted to.
    fn along(&self, line: &FittedLine, load: &[f64]) -> Option<Vec<f64>> {
        let depth = self.samples.column(Channel::DepthMm);
        let surface = depth.and_then(way_in_contact).map_or(0, |(surface, _)| surface);
        let felt = |(index, &load): (usize, &f64)| {
            if index < surface { Some(0.0) } else { line.at(load) }
        };
        load.iter().enumerate().map(felt).collect()
    }

    pub(super) fn calibrated(&self, calibration: &Calibration) -> Calibrated {
        let (Some(line), Some(load)) = (calibration.torque, self.samples.column(Channel::SpindleLoadPercent))
        else {
            return Calibrated::NotPossible;
        };
        let Some(torque) = self.along(&line, load) else {
            return Calibrated::Beyond;
        };
        let Some(spindle) = self.spindle_steps(&torque) else {
            return Calibrated::NotPossible;
        };
        let mut feed_drive = None;
        if let (Some(line), Some(load)) =
            (calibration.thrust, self.samples.column(Channel::FeedDriveLoadPercent))
        {
            let Some(thrust) = self.along(&line, load) else {
                return Calibrated::Beyond;
            };
            feed_drive = self.feed_steps(&thrust);
        }
        Calibrated::Told(Terms { spindle, feed_drive })
    }

    /// Trapezoid over a channel in watts; a gap counts as one usual interval.
    fn integrate(&self, watts: &[f64]) -> f64 {
        self.power_steps(watts).iter().sum()
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

    /// Load × rated power, times min(1, S/S_base) where the percent follows torque. The feed drive's percent is a force:
    /// load × rated thrust × way, where the thrust is declared.
    pub(super) fn rated_power(&self, context: Context<'_>) -> Option<Terms> {
        let load = self.samples.column(Channel::SpindleLoadPercent)?;
        let rating = &context.machine.spindle;
        let rated = rating.rated_power_watts.filter(|_| rating.reference != LoadReference::Unknown)?;
        let mut spindle: Vec<f64> = load.iter().map(|load| load / 100.0 * rated).collect();
        if rating.reference.follows_torque() {
            let base_speed_rpm = rating.base_speed_rpm?;
            self.by_speed(&mut spindle, |watts, rpm| watts * (rpm / base_speed_rpm).min(1.0))?;
        }
        self.clock.weigh(&mut spindle);
        let thrust = self.rated_thrust(context);
        Some(Terms { spindle, feed_drive: thrust.and_then(|thrust| self.feed_steps(&thrust)) })
    }

    /// The thrust that the feed drive's load stands for, N.
    fn rated_thrust(&self, context: Context<'_>) -> Option<Vec<f64>> {
        let rated = context.machine.feed_drive.rated_thrust_newtons?;
        if context.machine.feed_drive.reference == LoadReference::Unknown {
            return None;
        }
        let load = self.samples.column(Channel::FeedDriveLoadPercent)?;
        Some(load.iter().map(|load| load / 100.0 * rated).collect())
    }
}

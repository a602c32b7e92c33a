//! The course of a cycle's energy: what the summary sums up, sample by sample.

use super::energy::{Calibrated, EnergyBasis, Motion, Terms};
use super::{Context, SampleClock};
use crate::cycle::{Channel, Samples};

/// Energy since the beginning of a cycle at each of its samples on one basis, J; the last value is the whole.
/// `commanded_rpm` stands in where the speed was not sampled.
///
/// Summed in the order of the samples, so that the last value may differ from the summary's in its last digits.
/// `None` where the samples do not tell that basis, and for reported energy, which has no course.
pub fn energy_course(
    samples: &Samples,
    commanded_rpm: Option<f64>,
    context: Context<'_>,
    basis: EnergyBasis,
) -> Option<Vec<f64>> {
    let clock = SampleClock::of(samples);
    let motion = Motion { samples, clock: &clock, commanded_rpm };
    let terms = match basis {
        EnergyBasis::Reported => return None,
        EnergyBasis::Dynamometer => motion.dynamometer()?,
        EnergyBasis::Calibrated => match motion.calibrated(context.calibration?) {
            Calibrated::Told(terms) => terms,
            Calibrated::Beyond | Calibrated::NotPossible => return None,
        },
        EnergyBasis::MeasuredPower => {
            let watts = samples.column(Channel::SpindlePowerWatts)?;
            let idle = motion.idle_watts(watts).unwrap_or(0.0);
            let above: Vec<f64> = watts.iter().map(|watts| watts - idle).collect();
            let feed = samples.column(Channel::FeedDrivePowerWatts);
            let feed_drive = feed.map(|watts| motion.power_steps(watts));
            Terms { spindle: motion.power_steps(&above), feed_drive }
        }
        EnergyBasis::RatedPower => motion.rated_power(context)?,
    };
    let mut sum = 0.0;
    Some(
        terms
            .together()
            .into_iter()
            .map(|step| {
                sum += step;
                sum
            })
            .collect(),
    )
}

//! The course of a cycle's energy: what the summary sums up, sample by sample.

use super::energy::{EnergyBasis, Motion};
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
    let column = |channel| samples.column(channel);
    let steps = match basis {
        EnergyBasis::Reported => return None,
        EnergyBasis::Dynamometer => {
            let torque = column(Channel::TorqueNewtonMetres)?;
            let feed = column(Channel::ThrustNewtons).and_then(|thrust| motion.feed_steps(thrust));
            plus(motion.spindle_steps(torque)?, feed)
        }
        EnergyBasis::Calibrated => {
            let calibration = context.calibration?;
            let line = calibration.torque.as_ref()?;
            let torque = motion.along(line, column(Channel::SpindleLoadPercent)?);
            let thrust = calibration.thrust.as_ref().zip(column(Channel::FeedDriveLoadPercent));
            let feed = match thrust {
                None => None,
                Some((line, loads)) => motion.feed_steps(&motion.along(line, loads)?),
            };
            plus(motion.spindle_steps(&torque?)?, feed)
        }
        EnergyBasis::MeasuredPower => {
            let watts = column(Channel::SpindlePowerWatts)?;
            let idle = motion.idle_watts(watts).unwrap_or(0.0);
            let above: Vec<f64> = watts.iter().map(|watts| watts - idle).collect();
            let feed = column(Channel::FeedDrivePowerWatts).map(|watts| motion.power_steps(watts));
            plus(motion.power_steps(&above), feed)
        }
        EnergyBasis::RatedPower => {
            let feed = motion.rated_thrust(context).and_then(|thrust| motion.feed_steps(&thrust));
            plus(motion.rated_steps(context)?, feed)
        }
    };
    let mut sum = 0.0;
    Some(
        steps
            .into_iter()
            .map(|step| {
                sum += step;
                sum
            })
            .collect(),
    )
}

fn plus(mut steps: Vec<f64>, more: Option<Vec<f64>>) -> Vec<f64> {
    if let Some(more) = more {
        steps.iter_mut().zip(more).for_each(|(step, more)| *step += more);
    }
    steps
}

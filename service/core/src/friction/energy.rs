//! Energy of a hole from thrust and torque (Stryczek & Błaszczak 2020, Eq. 5–7).
//!
//! Two bases that must never be mixed in one baseline: measured by a dynamometer, or calculated from the drive
//! loads through the machine's fitted lines. What does not belong here: rated or metered power.

use super::calibration::LoadLine;
use super::error::{Invalid, all_finite, between, positive, same_length};
use std::f64::consts::PI;

/// Energy of the thrust over a way, E_Z = F_a·ΔZ (Eq. 5): N and mm in, J out.
#[must_use]
pub fn thrust_energy_j(thrust_n: f64, way_mm: f64) -> f64 {
    thrust_n * way_mm / 1e3
}

/// Energy of the torque over a time, E_C = T_a·2π·S/60·Δt (Eq. 6, where Δt is 0.01 s): N·m, rpm and s in, J out.
#[must_use]
pub fn torque_energy_j(torque_nm: f64, spindle_rpm: f64, dt_s: f64) -> f64 {
    torque_nm * spindle_rpm * 2.0 * PI / 60.0 * dt_s
}

/// Energy of every sample of a hole, and their sum (Eq. 7).
#[derive(Debug, Clone, PartialEq)]
pub struct HoleEnergy {
    /// Energy of each sample in J; of the first one only the torque's, for it has no way.
    pub per_sample_j: Vec<f64>,
    /// Sum in J.
    pub total_j: f64,
    /// Part of the sum that is thrust, J.
    pub thrust_j: f64,
    /// Samples whose load lies outside the loads that the lines were fitted on; 0 on the dynamometer basis.
    pub extrapolated_samples: usize,
}

/// Energy on the dynamometer basis; columns of equal length, depth in mm, thrust in N, torque in N·m.
///
/// # Errors
/// When columns differ in length or hold something that is no number, or speed or period are out of range.
pub fn dynamometer_energy(
    depth_mm: &[f64],
    thrust_n: &[f64],
    torque_nm: &[f64],
    spindle_rpm: f64,
    period_s: f64,
) -> Result<HoleEnergy, Invalid> {
    let columns = [("depth_mm", depth_mm), ("thrust_n", thrust_n), ("torque_nm", torque_nm)];
    check(&columns, spindle_rpm, period_s)?;
    let rows = thrust_n.iter().zip(torque_nm).map(|(&thrust, &torque)| (thrust, torque, false));
    Ok(sum(depth_mm, rows, spindle_rpm, period_s))
}

/// Energy on the calibrated basis: thrust and torque through the machine's lines from loads in percent.
///
/// A load below what the lines know counts as the line says, but never as less than no thrust or torque; such
/// samples are counted.
///
/// # Errors
/// As [`dynamometer_energy`].
pub fn calibrated_energy(
    depth_mm: &[f64],
    feed_drive_percent: (&[f64], &LoadLine),
    spindle_percent: (&[f64], &LoadLine),
    spindle_rpm: f64,
    period_s: f64,
) -> Result<HoleEnergy, Invalid> {
    let columns = [
        ("depth_mm", depth_mm),
        ("feed_drive_percent", feed_drive_percent.0),
        ("spindle_percent", spindle_percent.0),
    ];
    check(&columns, spindle_rpm, period_s)?;
    let rows = feed_drive_percent.0.iter().zip(spindle_percent.0).map(|(&feed, &spindle)| {
        let (thrust, thrust_known) = feed_drive_percent.1.flagged(feed);
        let (torque, torque_known) = spindle_percent.1.flagged(spindle);
        (thrust.max(0.0), torque.max(0.0), !(thrust_known && torque_known))
    });
    Ok(sum(depth_mm, rows, spindle_rpm, period_s))
}

fn check(columns: &[(&'static str, &[f64])], spindle_rpm: f64, period_s: f64) -> Result<(), Invalid> {
    between("spindle_rpm", spindle_rpm, 0.0, 1e6)?;
    positive("period_s", period_s, 60.0)?;
    same_length(columns)?;
    all_finite(columns)
}

fn sum(
    depth_mm: &[f64],
    rows: impl Iterator<Item = (f64, f64, bool)>,
    rpm: f64,
    period_s: f64,
) -> HoleEnergy {
    let mut energy = HoleEnergy {
        per_sample_j: Vec::with_capacity(depth_mm.len()),
        total_j: 0.0,
        thrust_j: 0.0,
        extrapolated_samples: 0,
    };
    let mut before = depth_mm.first().copied().unwrap_or(0.0);
    for (&depth, (thrust, torque, extrapolated)) in depth_mm.iter().zip(rows) {
        let pushed = thrust_energy_j(thrust, depth - before);
        let here = pushed + torque_energy_j(torque, rpm, period_s);
        before = depth;
        energy.per_sample_j.push(here);
        energy.total_j += here;
        energy.thrust_j += pushed;
        energy.extrapolated_samples += usize::from(extrapolated);
    }
    energy
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::friction::calibration::{DynamometerCycle, Quantity};
    use crate::friction::noise::Noise;
    use crate::friction::twin::{
        CycleSample, CycleSetup, PAPER_SPINDLE_RPM, PaperStrategies, Twin, TwinParams, paper_params,
        typical_noise,
    };

    fn in_contact(params: TwinParams, seed: u64) -> (Vec<CycleSample>, f64) {
        let strategy = PaperStrategies::new().unwrap().linear;
        let setup = CycleSetup::new(PAPER_SPINDLE_RPM, 0.0);
        let twin = Twin::new(params).unwrap();
        let (samples, figures) = twin.record(&strategy, &setup, Some(&mut Noise::seeded(seed))).unwrap();
        (samples.into_iter().filter(|s| s.depth_mm >= 0.0).collect(), figures.energy_j)
    }

    fn column(samples: &[CycleSample], of: fn(&CycleSample) -> f64) -> Vec<f64> {
        samples.iter().map(of).collect()
    }

    #[test]
    fn one_newton_over_a_metre_and_one_newton_metre_over_a_turn() {
        assert!((thrust_energy_j(1.0, 1000.0) - 1.0).abs() < 1e-12);
        assert!((torque_energy_j(1.0, 60.0, 1.0) - 2.0 * PI).abs() < 1e-12);
    }

    #[test]
    fn columns_of_a_hole_sum_to_the_energy_that_the_model_counts() {
        let (samples, energy_j) = in_contact(paper_params(), 0);
        let energy = dynamometer_energy(
            &column(&samples, |s| s.depth_mm),
            &column(&samples, |s| s.process.thrust_n),
            &column(&samples, |s| s.process.torque_nm),
            PAPER_SPINDLE_RPM,
            0.01,
        )
        .unwrap();
        assert!((energy.total_j / energy_j - 1.0).abs() < 1e-3, "{} J of {energy_j} J", energy.total_j);
        assert!((energy.per_sample_j.iter().sum::<f64>() - energy.total_j).abs() < 1e-9);
        assert!(energy.thrust_j > 0.0 && energy.thrust_j < 0.04 * energy.total_j);
    }

    #[test]
    fn lines_fitted_on_dynamometer_cycles_give_the_energy_of_another_hole_from_its_loads() {
        let noisy = TwinParams { noise: typical_noise(), ..paper_params() };
        let cycles: Vec<Vec<CycleSample>> = (0..3).map(|seed| in_contact(noisy, seed).0).collect();
        let fit = |quantity, load: fn(&CycleSample) -> f64, measured: fn(&CycleSample) -> f64| {
            let columns: Vec<_> = cycles.iter().map(|c| (column(c, load), column(c, measured))).collect();
            let cycles: Vec<_> = columns
                .iter()
                .map(|(load, measured)| DynamometerCycle { load_percent: load, measured })
                .collect();
            LoadLine::fit(quantity, &cycles).unwrap()
        };
        let thrust = fit(Quantity::ThrustNewton, |s| s.process.feed_drive_percent, |s| s.process.thrust_n);
        let torque = fit(Quantity::TorqueNewtonMetre, |s| s.process.spindle_percent, |s| s.process.torque_nm);
        let machine = paper_params().machine;
        assert!((100.0 * thrust.slope / machine.feed_rated_thrust_n - 1.0).abs() < 0.03, "{thrust:?}");
        assert!((100.0 * torque.slope / machine.spindle_rated_torque_nm() - 1.0).abs() < 0.03, "{torque:?}");
        assert!(thrust.r_squared > 0.98 && torque.r_squared > 0.98 && torque.cycles == 3);

        let (samples, energy_j) = in_contact(noisy, 9);
        let energy = calibrated_energy(
            &column(&samples, |s| s.depth_mm),
            (&column(&samples, |s| s.process.feed_drive_percent), &thrust),
            (&column(&samples, |s| s.process.spindle_percent), &torque),
            PAPER_SPINDLE_RPM,
            0.01,
        )
        .unwrap();
        assert!((energy.total_j / energy_j - 1.0).abs() < 0.02, "{} J of {energy_j} J", energy.total_j);
        assert!(energy.extrapolated_samples < samples.len() / 20);
    }

    #[test]
    fn columns_that_do_not_fit_are_refused_by_path() {
        let refused = |thrust: &[f64], torque: &[f64]| {
            dynamometer_energy(&[0.0, 1.0], thrust, torque, 1000.0, 0.01).unwrap_err().field().to_owned()
        };
        assert_eq!(refused(&[1.0], &[1.0, 1.0]), "thrust_n");
        assert_eq!(refused(&[1.0, 1.0], &[1.0, f64::NAN]), "torque_nm[1]");
    }
}

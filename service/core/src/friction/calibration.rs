//! Lines from drive load to thrust and torque, fitted on dynamometer cycles.
//!
//! Stryczek & Błaszczak 2020, Fig. 10 and 11, show thrust against feed-drive load and torque against spindle
//! load as close to straight. The fit is Theil–Sen (Sen 1968): the median of the slopes of all pairs stands up
//! to 29 % of bad points, such as the spin-up of the spindle. A line answers only inside the loads it has seen.

use super::error::{Invalid, InvalidCode, finite, same_length};

/// Most points that enter the pairwise slopes; beyond it the points are thinned evenly over the load.
pub const MOST_FIT_POINTS: usize = 800;

/// Fewest points that make a line.
pub const FEWEST_FIT_POINTS: usize = 8;

/// Median absolute deviation to standard deviation of a normal distribution.
const MAD_TO_SD: f64 = 1.4826;

/// What a line gives: thrust or torque.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Thrust in N from the feed-drive load in percent.
    ThrustNewton,
    /// Torque in N·m from the spindle load in percent.
    TorqueNewtonMetre,
}

/// One dynamometer cycle: a load column and the measured column, sample by sample.
#[derive(Debug, Clone, Copy)]
pub struct DynamometerCycle<'a> {
    /// Drive load in percent.
    pub load_percent: &'a [f64],
    /// Measured thrust in N or torque in N·m.
    pub measured: &'a [f64],
}

/// A fitted line with all that is needed to judge it; plain values, to be stored as a version.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadLine {
    /// What it gives.
    pub quantity: Quantity,
    /// N or N·m per percent.
    pub slope: f64,
    /// N or N·m at no load reading; negative, because an idling drive shows a load.
    pub intercept: f64,
    /// Share of the variance that the line explains, at most 1; below 0 the mean would be better.
    pub r_squared: f64,
    /// Robust standard deviation of what is left, N or N·m.
    pub residual_spread: f64,
    /// Lowest load that was seen, percent.
    pub load_min_percent: f64,
    /// Highest load that was seen, percent.
    pub load_max_percent: f64,
    /// Points that were fitted, before thinning.
    pub points: usize,
    /// Cycles that they came from.
    pub cycles: usize,
}

impl LoadLine {
    /// Fits a line on one or more cycles.
    ///
    /// Points that are not finite are left out. The caller passes the part of a cycle in contact; some samples
    /// of spin-up do no harm.
    ///
    /// # Errors
    /// When columns differ in length, when fewer than eight points are usable, when the loads do not vary, or
    /// when the quantity does not grow with the load: such a line would be no calibration.
    pub fn fit(quantity: Quantity, cycles: &[DynamometerCycle<'_>]) -> Result<Self, Invalid> {
        let mut points = Vec::new();
        for cycle in cycles {
            same_length(&[("load_percent", cycle.load_percent), ("measured", cycle.measured)])?;
            let pairs = cycle.load_percent.iter().copied().zip(cycle.measured.iter().copied());
            points.extend(pairs.filter(|(load, value)| load.is_finite() && value.is_finite()));
        }
        if points.len() < FEWEST_FIT_POINTS {
            let text = format!("{} usable points, at least {FEWEST_FIT_POINTS} are needed", points.len());
            return Err(Invalid::new("cycles", InvalidCode::NotIdentifiable, text));
        }
        points.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let (low, high) = (points[0].0, points[points.len() - 1].0);
        let chosen = thinned(&points);
        let mut slopes = Vec::with_capacity(chosen.len() * (chosen.len() - 1) / 2);
        // Pairs closer than a hundredth of the range only carry the quantisation of the load.
        let apart = 0.01 * (high - low);
        for (index, a) in chosen.iter().enumerate() {
            let later = chosen[index + 1..].iter();
            slopes.extend(
                later
                    .map(|b| (b.0 - a.0, b.1 - a.1))
                    .filter(|(dx, _)| *dx > apart && *dx > 0.0)
                    .map(|(dx, dy)| dy / dx),
            );
        }
        if slopes.is_empty() {
            let text = "the loads do not vary";
            return Err(Invalid::new("load_percent", InvalidCode::NotIdentifiable, text));
        }
        let slope = median(&mut slopes);
        if slope <= 0.0 {
            let text = "the measured quantity does not grow with the load";
            return Err(Invalid::new("measured", InvalidCode::NotIdentifiable, text));
        }
        let mut offsets: Vec<f64> = points.iter().map(|(load, value)| value - slope * load).collect();
        let intercept = median(&mut offsets);
        let mut line = Self {
            quantity,
            slope,
            intercept,
            r_squared: 0.0,
            residual_spread: 0.0,
            load_min_percent: low,
            load_max_percent: high,
            points: points.len(),
            cycles: cycles.len(),
        };
        line.judge(&points);
        Ok(line)
    }

    fn judge(&mut self, points: &[(f64, f64)]) {
        #[expect(clippy::cast_precision_loss, reason = "a count of samples")]
        let mean = points.iter().map(|point| point.1).sum::<f64>() / points.len() as f64;
        let residual = |point: &(f64, f64)| point.1 - (self.intercept + self.slope * point.0);
        let left: f64 = points.iter().map(|point| residual(point).powi(2)).sum();
        let total: f64 = points.iter().map(|point| (point.1 - mean).powi(2)).sum();
        let mut distances: Vec<f64> = points.iter().map(|point| residual(point).abs()).collect();
        self.r_squared = if total > 0.0 { 1.0 - left / total } else { 0.0 };
        self.residual_spread = MAD_TO_SD * median(&mut distances);
    }

    /// Thrust in N or torque in N·m at a load.
    ///
    /// # Errors
    /// When the load is not finite or outside the loads that were seen in the fit.
    pub fn at(&self, load_percent: f64) -> Result<f64, Invalid> {
        finite("load_percent", load_percent)?;
        if (self.load_min_percent..=self.load_max_percent).contains(&load_percent) {
            return Ok(self.intercept + self.slope * load_percent);
        }
        let text = format!(
            "{load_percent} % is outside the fitted {} to {} %",
            self.load_min_percent, self.load_max_percent
        );
        Err(Invalid::new("load_percent", InvalidCode::Extrapolation, text))
    }

    /// The line's value wherever the load is, and whether that was inside the loads that were seen.
    ///
    /// For whole columns, where one sample outside must not lose the cycle but has to be counted.
    #[must_use]
    pub fn flagged(&self, load_percent: f64) -> (f64, bool) {
        let inside = (self.load_min_percent..=self.load_max_percent).contains(&load_percent);
        (self.intercept + self.slope * load_percent, inside)
    }
}

/// At most [`MOST_FIT_POINTS`] points, evenly over the sorted ones.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if points.len() <= MOST_FIT_POINTS {
        return points.to_vec();
    }
    let last = points.len() - 1;
    (0..MOST_FIT_POINTS).map(|k| points[k * last / (MOST_FIT_POINTS - 1)]).collect()
}

/// The median of finite values, which it sorts; 0 for none.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => 0.0,
        n if n.is_multiple_of(2) => f64::midpoint(values[middle - 1], values[middle]),
        _ => values[middle],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::friction::noise::Noise;
    use proptest::prelude::*;

    fn cycle(slope: f64, intercept: f64, noise: f64, bad: usize) -> (Vec<f64>, Vec<f64>) {
        let mut random = Noise::seeded(3);
        let loads: Vec<f64> = (0..400).map(|k| 4.0 + f64::from(k) * 0.1).collect();
        let values = loads
            .iter()
            .enumerate()
            .map(|(k, load)| {
                let spin_up = if k < bad { 2000.0 } else { 0.0 };
                intercept + slope * load + noise * random.normal() + spin_up
            })
            .collect();
        (loads, values)
    }

    fn fit(loads: &[f64], values: &[f64]) -> Result<LoadLine, Invalid> {
        LoadLine::fit(Quantity::ThrustNewton, &[DynamometerCycle { load_percent: loads, measured: values }])
    }

    #[test]
    fn a_noisy_line_is_found_with_its_spread_and_range() {
        let (loads, values) = cycle(27.0, -110.0, 20.0, 0);
        let line = fit(&loads, &values).unwrap();
        assert!((line.slope - 27.0).abs() < 0.5 && (line.intercept + 110.0).abs() < 12.0, "{line:?}");
        assert!((line.residual_spread - 20.0).abs() < 4.0 && line.r_squared > 0.98);
        assert!((line.load_min_percent - 4.0).abs() < 1e-12 && (line.load_max_percent - 43.9).abs() < 1e-9);
        assert_eq!((line.points, line.cycles), (400, 1));
    }

    #[test]
    fn a_tenth_of_spin_up_samples_hardly_moves_the_line() {
        let (loads, values) = cycle(27.0, -110.0, 20.0, 40);
        let line = fit(&loads, &values).unwrap();
        assert!((line.slope - 27.0).abs() < 2.0, "{line:?}");
    }

    #[test]
    fn outside_its_loads_a_line_refuses_or_says_so() {
        let (loads, values) = cycle(27.0, -110.0, 5.0, 0);
        let line = fit(&loads, &values).unwrap();
        assert!(line.at(20.0).is_ok());
        assert_eq!(line.at(60.0).unwrap_err().code(), InvalidCode::Extrapolation);
        assert_eq!(line.at(f64::NAN).unwrap_err().code(), InvalidCode::NotFinite);
        assert!(!line.flagged(60.0).1 && line.flagged(20.0).1);
    }

    #[test]
    fn data_that_make_no_line_are_refused() {
        assert_eq!(fit(&[1.0; 20], &[2.0; 20]).unwrap_err().field(), "load_percent");
        assert_eq!(fit(&[1.0; 3], &[2.0; 3]).unwrap_err().code(), InvalidCode::NotIdentifiable);
        assert_eq!(fit(&[1.0; 3], &[2.0; 4]).unwrap_err().code(), InvalidCode::LengthMismatch);
        let (loads, values) = cycle(-5.0, 300.0, 1.0, 0);
        assert_eq!(fit(&loads, &values).unwrap_err().field(), "measured");
    }

    proptest! {
        #[test]
        fn an_exact_line_is_found_exactly_in_any_order(
            slope in 0.1..100.0_f64, intercept in -500.0..500.0_f64,
            loads in proptest::collection::vec(0.0..100.0_f64, 10..60),
        ) {
            let lowest = loads.iter().copied().fold(f64::MAX, f64::min);
            let highest = loads.iter().copied().fold(f64::MIN, f64::max);
            prop_assume!(highest - lowest > 1.0);
            let values: Vec<f64> = loads.iter().map(|load| intercept + slope * load).collect();
            let line = fit(&loads, &values).unwrap();
            prop_assert!((line.slope - slope).abs() < 1e-6 * slope.max(1.0));
            prop_assert!((line.intercept - intercept).abs() < 1e-4);
        }
    }
}

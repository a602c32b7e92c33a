//! Load filter of the adaptive feed law: inertia, current reading and forecast (Stryczek & Błaszczak 2020, Eq. 1).

use super::error::{Invalid, InvalidCode, finite};
use crate::shown::Shown;

/// How far the weights' sum may be from 1 before they are refused; only rounding is forgiven.
const SUM_TOLERANCE: f64 = 1e-9;

/// Weights of Eq. 1 whose recursion is known to be stable and of unit gain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilterWeights {
    inertia: f64,
    current: f64,
    forecast: f64,
}

impl Default for FilterWeights {
    /// The weights of the paper: 0.4, 0.1, 0.5.
    fn default() -> Self {
        Self { inertia: 0.4, current: 0.1, forecast: 0.5 }
    }
}

impl FilterWeights {
    /// Checks the weights w_i, w_a and w_p of Eq. 1.
    ///
    /// # Errors
    /// When one is not finite, when they do not sum to 1 (the filter would have a gain), or when the recursion
    /// has a pole on or outside the unit circle (the filtered load would run away or never settle).
    pub fn new(inertia: f64, current: f64, forecast: f64) -> Result<Self, Invalid> {
        finite("inertia", inertia)?;
        finite("current", current)?;
        finite("forecast", forecast)?;
        let sum = inertia + current + forecast;
        if (sum - 1.0).abs() > SUM_TOLERANCE {
            let text = format!("the three weights must sum to 1, not {}", Shown(sum));
            return Err(Invalid::new("weights", InvalidCode::Inconsistent, text));
        }
        let weights = Self { inertia, current, forecast };
        let largest = weights.poles().iter().map(|(re, im)| re.hypot(*im)).fold(0.0, f64::max);
        if largest < 1.0 {
            Ok(weights)
        } else {
            let text = format!("the recursion has a pole of magnitude {largest}; it must stay below 1");
            Err(Invalid::new("weights", InvalidCode::Unstable, text))
        }
    }

    /// The weights w_i, w_a, w_p.
    #[must_use]
    pub const fn as_array(&self) -> [f64; 3] {
        [self.inertia, self.current, self.forecast]
    }

    /// The two poles of the recursion as (real, imaginary): roots of λ² − (w_i + 2·w_p)·λ + w_p.
    #[must_use]
    pub fn poles(&self) -> [(f64, f64); 2] {
        let half_trace = (self.inertia + 2.0 * self.forecast) / 2.0;
        let discriminant = half_trace * half_trace - self.forecast;
        if discriminant < 0.0 {
            let imaginary = (-discriminant).sqrt();
            return [(half_trace, imaginary), (half_trace, -imaginary)];
        }
        // The root of larger magnitude first, the other from the product, so that nothing cancels.
        let larger = half_trace + discriminant.sqrt().copysign(half_trace);
        let smaller = if larger.abs() > 0.0 { self.forecast / larger } else { 0.0 };
        [(larger, 0.0), (smaller, 0.0)]
    }

    /// Lag behind a steady ramp, in samples: w_i/w_a, the recursion's delay at zero frequency.
    #[must_use]
    pub fn ramp_lag_samples(&self) -> f64 {
        self.inertia / self.current
    }
}

/// The filter's memory: the last two filtered loads of one drive, in percent.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LoadFilter {
    last: Option<(f64, f64)>,
}

impl LoadFilter {
    /// A filter that has seen nothing: it starts at its first sample, as if that load had lasted for ever.
    #[must_use]
    pub const fn new() -> Self {
        Self { last: None }
    }

    /// A filter at rest at `load_percent`.
    #[must_use]
    pub const fn settled_at(load_percent: f64) -> Self {
        Self { last: Some((load_percent, load_percent)) }
    }

    /// Takes one finite load (percent) and returns the filtered load (percent).
    ///
    /// Eq. 1 in the reading Lf\[k\] = w_i·Lf\[k−1\] + w_a·L\[k\] + w_p·(2·Lf\[k−1\] − Lf\[k−2\]). In print Lf\[k\]
    /// stands on both sides and the forecast subtracts the raw load L\[k−2\]; with the raw load the recursion has
    /// a pole outside the unit circle.
    pub fn step(&mut self, weights: &FilterWeights, load_percent: f64) -> f64 {
        let (one_ago, two_ago) = self.last.unwrap_or((load_percent, load_percent));
        let forecast = one_ago + (one_ago - two_ago);
        let filtered =
            weights.inertia * one_ago + weights.current * load_percent + weights.forecast * forecast;
        self.last = Some((filtered, one_ago));
        filtered
    }

    /// Forgets everything, after a gap: old loads say nothing about the present.
    pub fn reset(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_papers_weights_have_the_poles_lag_and_step_response_of_the_repaired_equation() {
        let weights = FilterWeights::default();
        for (re, im) in weights.poles() {
            assert!((re - 0.7).abs() < 1e-12 && (im.abs() - 0.1).abs() < 1e-12);
        }
        assert!((weights.ramp_lag_samples() - 4.0).abs() < 1e-12);

        let mut filter = LoadFilter::settled_at(0.0);
        let response: Vec<f64> = (0..6).map(|_| filter.step(&weights, 1.0)).collect();
        // Half after four samples.
        for (value, expected) in response.iter().zip([0.1, 0.24, 0.386, 0.5204]) {
            assert!((value - expected).abs() < 1e-12, "{response:?}");
        }
        let settled = (0..500).fold(0.0, |_, _| filter.step(&weights, 1.0));
        assert!((settled - 1.0).abs() < 1e-12, "unit gain: {settled}");
    }

    /// In print the last term has the load of two samples before and not its filtered value: the recursion then has one
    /// pole, w_i + 2·w_p, outside the unit circle.
    #[test]
    fn with_the_printed_raw_load_of_two_samples_before_the_recursion_grows_by_1_4() {
        let [inertia, current, forecast] = FilterWeights::default().as_array();
        let mut load = [1.0, 0.0, 0.0];
        let mut filtered = current * load[0];
        let mut growth = 0.0;
        for _ in 0..40 {
            load = [0.0, load[0], load[1]];
            let next = inertia * filtered + current * load[0] + forecast * (2.0 * filtered - load[2]);
            (growth, filtered) = (next / filtered, next);
        }
        assert!((growth - 1.4).abs() < 1e-12, "{growth}");
    }

    #[test]
    fn a_ramp_is_followed_four_samples_late() {
        let weights = FilterWeights::default();
        let mut filter = LoadFilter::settled_at(0.0);
        let lag = (1..=200).fold(0.0, |_, k| f64::from(k) - filter.step(&weights, f64::from(k)));
        assert!((lag - 4.0).abs() < 1e-9);
    }

    #[test]
    fn the_printed_reading_would_be_unstable_and_so_are_weights_that_forecast_too_much() {
        assert_eq!(FilterWeights::new(-0.6, 0.5, 1.1).unwrap_err().code(), InvalidCode::Unstable);
        assert_eq!(FilterWeights::new(1.0, 0.0, 0.0).unwrap_err().code(), InvalidCode::Unstable);
        assert_eq!(FilterWeights::new(0.4, 0.2, 0.5).unwrap_err().code(), InvalidCode::Inconsistent);
        assert_eq!(FilterWeights::new(f64::NAN, 0.1, 0.5).unwrap_err().field(), "inertia");
    }

    #[test]
    fn ringing_of_the_default_weights_is_small() {
        let weights = FilterWeights::default();
        let mut filter = LoadFilter::settled_at(0.0);
        let highest = (0..100).map(|_| filter.step(&weights, 1.0)).fold(0.0, f64::max);
        assert!((highest - 1.000_469).abs() < 1e-6, "0.05 %: {highest}");
    }

    proptest! {
        #[test]
        fn weights_are_accepted_exactly_when_the_jury_criterion_holds(
            current in -1.0..3.0_f64, forecast in -1.5..1.5_f64,
        ) {
            let inertia = 1.0 - current - forecast;
            let trace = inertia + 2.0 * forecast;
            let margin = (1.0 - forecast.abs()).min(1.0 + forecast - trace.abs());
            prop_assume!(margin.abs() > 1e-6);
            prop_assert_eq!(FilterWeights::new(inertia, current, forecast).is_ok(), margin > 0.0);
        }

        #[test]
        fn accepted_weights_forget_an_impulse_and_keep_a_constant(
            current in 0.02..1.0_f64, forecast in -0.9..0.9_f64, load in 0.0..400.0_f64,
        ) {
            let Ok(weights) = FilterWeights::new(1.0 - current - forecast, current, forecast) else {
                return Ok(());
            };
            // Close to the unit circle forgetting takes longer than a test.
            prop_assume!(weights.poles().iter().all(|(re, im)| re.hypot(*im) < 0.99));
            let mut filter = LoadFilter::new();
            filter.step(&weights, load);
            prop_assert!((filter.step(&weights, load) - load).abs() < 1e-9);
            filter.step(&weights, load + 50.0);
            let mut last = 0.0;
            for _ in 0..3000 {
                last = filter.step(&weights, load);
            }
            prop_assert!((last - load).abs() < 1e-3);
        }
    }
}

//! Border of linear stability, and the least amplitude that segments chips.

use std::f64::consts::{PI, TAU};

use crate::field_error::{FieldError, within};

/// Bisection steps: the lobe's width shrinks below the resolution of a double.
const BISECTIONS: u32 = 200;

/// A point of the border.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BorderPoint {
    /// kc on the border: below it vibrations die away, above it they grow.
    pub cutting_coefficient: f64,
    /// Chatter frequency over eigenfrequency, G.
    pub chatter_ratio: f64,
    /// Whole vibrations per period of edge passing: the number of the lobe.
    pub lobe: u32,
}

/// kc on the border of linear stability at the frequency ratio p.
///
/// Of the linearised process with kr = r·kc and λ = iW, W = W₀ + 2πn, W₀ in (π, 2π):
/// 1 − G² + kr·(1 − cos W) = 0, 2ζG + kr·sin W = 0, p = W/(2πG). With c = cot(W/2) the two give
/// G = (ζ + √(ζ² + c²))/|c|, so p is a function of W, rising from 0 to n + 1 in lobe n; of all lobes the lowest kc
/// counts.
///
/// # Errors
/// A value that is not finite or out of range.
pub fn border_at(frequency_ratio: f64, damping: f64, exponent: f64) -> Result<BorderPoint, FieldError> {
    within("frequency_ratio", frequency_ratio, 0.01, 100.0)?;
    within("damping", damping, 1e-6, 1.0)?;
    within("exponent", exponent, 0.1, 2.0)?;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 < p ≤ 100")]
    let first = frequency_ratio.floor() as u32;
    // Lobes further right are entered far from their minimum: the second one already lies above the first there.
    let lowest = (first..first + 3)
        .map(|lobe| in_lobe(frequency_ratio, damping, exponent, lobe))
        .min_by(|a, b| a.cutting_coefficient.total_cmp(&b.cutting_coefficient));
    Ok(lowest.unwrap_or_else(|| in_lobe(frequency_ratio, damping, exponent, first)))
}

fn in_lobe(frequency_ratio: f64, damping: f64, exponent: f64, lobe: u32) -> BorderPoint {
    let ratio_at = |w: f64| {
        let c = 1.0 / (w / 2.0).tan();
        (damping + damping.hypot(c)) / c.abs()
    };
    let p_at = |w: f64| (w + TAU * f64::from(lobe)) / (TAU * ratio_at(w));
    let (mut low, mut high) = (PI, TAU);
    for _ in 0..BISECTIONS {
        let middle = low.midpoint(high);
        if p_at(middle) < frequency_ratio {
            low = middle;
        } else {
            high = middle;
        }
    }
    let w = low.midpoint(high);
    let chatter_ratio = ratio_at(w);
    let stiffness = (chatter_ratio * chatter_ratio - 1.0) / (1.0 - w.cos());
    BorderPoint { cutting_coefficient: stiffness / exponent, chatter_ratio, lobe }
}

/// Least kc on the border over all frequency ratios, 2ζ(1 + ζ)/r.
///
/// # Errors
/// A value that is not finite or out of range.
pub fn border_minimum(damping: f64, exponent: f64) -> Result<f64, FieldError> {
    within("damping", damping, 1e-6, 1.0)?;
    within("exponent", exponent, 0.1, 2.0)?;
    Ok(2.0 * damping * (1.0 + damping) / exponent)
}

/// Least peak-to-peak displacement that segments chips, A ≥ a/|sin(π·i)| (Gouskov et al. 2015, Eq. 1).
///
/// `vibrations_per_edge` is the number of vibrations per edge passing; its fraction is i. The unit is the feed's.
/// None when the vibration repeats exactly from edge to edge: then no amplitude segments.
///
/// # Errors
/// A value that is not finite or out of range.
pub fn segmentation_amplitude(
    feed_per_edge: f64,
    vibrations_per_edge: f64,
) -> Result<Option<f64>, FieldError> {
    within("feed_per_edge", feed_per_edge, 1e-9, 1e3)?;
    within("vibrations_per_edge", vibrations_per_edge, 1e-6, 1e6)?;
    let sine = (PI * vibrations_per_edge.fract()).sin().abs();
    Ok((sine > 1e-9).then(|| feed_per_edge / sine))
}

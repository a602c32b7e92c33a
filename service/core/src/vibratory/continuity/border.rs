//! Border of linear stability, and the least amplitude that segments chips.

use std::f64::consts::PI;

use crate::field_error::{FieldError, within};

/// Bisection steps: they narrow [`LN_RANGE`] down to what a double resolves.
const BISECTIONS: u32 = 64;

/// ln t is looked for within ± this: p moves by less than a double resolves beyond.
const LN_RANGE: f64 = 50.0;

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

/// kc on the border of linear stability at the frequency ratio p, the lowest of all lobes.
///
/// Of the linearised process with kr = r·kc and λ = iW, W = W₀ + 2πn, W₀ in (π, 2π):
/// 1 − G² + kr·(1 − cos W) = 0, 2ζG + kr·sin W = 0, p = W/(2πG). With u = |cot(W/2)| the two give
/// G = (ζ + √(ζ² + u²))/u, and with t = √(ζ² + u²) − ζ, so that u² = t·(t + 2ζ):
///
/// G = √(1 + 2ζ/t), kr = ζ·(t + 1/t + 2ζ), p = (n + ½ + arctan(u)/π)/G.
///
/// kr is the same curve of t in every lobe n, falling to its minimum 2ζ(1 + ζ) at t = 1 and rising from there, while p
/// rises with t, from 0 to n + 1, and with n. At a given p, t therefore falls from lobe to lobe, beginning with the
/// first whose n + 1 lies above p, and the lowest kr is that of the first lobe with t ≤ 1 or of the one before it.
/// t ≤ 1 in all lobes with n ≥ p·√(1 + 2ζ) − ½ − arctan(√(1 + 2ζ))/π.
///
/// # Errors
/// A value that is not finite or out of range.
pub fn border_at(frequency_ratio: f64, damping: f64, exponent: f64) -> Result<BorderPoint, FieldError> {
    within("frequency_ratio", frequency_ratio, 0.01, 100.0)?;
    within("damping", damping, 1e-6, 1.0)?;
    within("exponent", exponent, 0.1, 2.0)?;
    let at_least = (1.0 + 2.0 * damping).sqrt();
    let turn = (frequency_ratio * at_least - 0.5 - at_least.atan() / PI).ceil();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 < p ≤ 100, so below 200")]
    let (first, turn) = (frequency_ratio.floor() as u32, turn.max(0.0) as u32);
    let turn = turn.max(first);
    // One more on the far side: the place of the turn is rounded.
    let others = (turn.saturating_sub(1).max(first)..=turn + 1).filter(|lobe| *lobe != turn);
    let point = |lobe| in_lobe(frequency_ratio, damping, exponent, lobe);
    Ok(others.map(point).fold(point(turn), |lowest, other| {
        if other.cutting_coefficient < lowest.cutting_coefficient { other } else { lowest }
    }))
}

fn in_lobe(frequency_ratio: f64, damping: f64, exponent: f64, lobe: u32) -> BorderPoint {
    let ratio_at = |t: f64| (1.0 + 2.0 * damping / t).sqrt();
    let p_at = |t: f64| {
        let waves = f64::from(lobe) + 0.5 + (t * (t + 2.0 * damping)).sqrt().atan() / PI;
        waves / ratio_at(t)
    };
    let (mut low, mut high) = (-LN_RANGE, LN_RANGE);
    for _ in 0..BISECTIONS {
        let middle = low.midpoint(high);
        if p_at(middle.exp()) < frequency_ratio {
            low = middle;
        } else {
            high = middle;
        }
    }
    let t = low.midpoint(high).exp();
    let stiffness = damping * (t + 1.0 / t + 2.0 * damping);
    BorderPoint { cutting_coefficient: stiffness / exponent, chatter_ratio: ratio_at(t), lobe }
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

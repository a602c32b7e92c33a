//! The override law as a polynomial that a control evaluates itself: SINUMERIK `FCTDEF` and `SYNFCT`.
//!
//! Our law moves the override step by step (Stryczek & Błaszczak 2020, Eq. 2–4); a synchronised action can only compute it
//! from the load of the moment. What is fitted is the law's own answer from 100 %: with u = L/L_set − 1 it is
//! 100·(1 − sgn(u)·(1 − e^(−b·u²/2))), odd about (1, 100 %), so a cubic 100 − c₁u − c₃u³ has its shape. The fit is least
//! squares over loads from none to twice the set load, among the curves that fall for every load there is: c₁ ≥ 0 and
//! c₃ ≥ 0. A cubic with c₃ < 0 would turn up again beyond them, and a jammed tool would be driven faster. So the law's
//! answer to a jam holds without a bound on the load: the override falls to the lower limit of `FCTDEF` and stays there.

use super::{ExportOptions, LawInControl, decimal, override_range};
use crate::feed::profile::{Profile, SectionKind};
use crate::invalid::Violation;

/// `$AC_OVR` ends there.
pub(super) const HIGHEST_PERCENT: f64 = 200.0;
/// Points of the fit on either side of the set load.
const POINTS: u32 = 200;
/// One over the last decimal of a coefficient: nine decimals, since a₃ is multiplied by the cube of a load.
const PLACES: f64 = 1e9;

/// Why no polynomial is fitted: a set load or an intensity that is none, or limits that are no range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FitError;

/// Override over load, as `FCTDEF` takes it: a₀ + a₁L + a₂L² + a₃L³ within its limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OverridePolynomial {
    /// Lowest override, %.
    pub lower_percent: f64,
    /// Highest override, %.
    pub upper_percent: f64,
    /// a₀ to a₃ for a load in percent, in the nine decimals in which they are written.
    pub coefficients: [f64; 4],
}

impl OverridePolynomial {
    /// Fits the law's answer from 100 % for a set load (percent) and an intensity b, within limits of the override (percent).
    ///
    /// It never rises with the load, whatever the load, and is 100 % at the set load. A load that is told with a negative
    /// sign counts as a low one: its override is at most the upper limit.
    ///
    /// # Errors
    /// Where set load or intensity is not a positive number, or the lower limit is not at most the upper one.
    pub fn fit(
        set_percent: f64,
        intensity: f64,
        lower_percent: f64,
        upper_percent: f64,
    ) -> Result<Self, FitError> {
        let is_positive = |value: f64| value > 0.0 && value.is_finite();
        let is_range = lower_percent <= upper_percent;
        if !is_positive(set_percent) || !is_positive(intensity) || !is_range {
            return Err(FitError);
        }
        // Normal equations of c₁u + c₃u³ over u in (0, 1]; the other side is its mirror image.
        let (mut s2, mut s4, mut s6, mut y1, mut y3) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for k in 1..=POINTS {
            let u = f64::from(k) / f64::from(POINTS);
            let y = 100.0 * (1.0 - libm::exp(-intensity * u * u / 2.0));
            let cube = u * u * u;
            s2 += u * u;
            s4 += u * cube;
            s6 += cube * cube;
            y1 += y * u;
            y3 += y * cube;
        }
        let both = s2 * s6 - s4 * s4;
        let (c1, c3) = ((y1 * s6 - y3 * s4) / both, (y3 * s2 - y1 * s4) / both);
        let cubic = (c1 >= 0.0 && c3 >= 0.0).then(|| cubic(set_percent, c1, c3)).flatten();
        // With c₃ < 0 the best that still falls everywhere is the straight line: c₃ = 0.
        let [a1, a2, a3] = cubic.unwrap_or_else(|| [rounded_down(-y1 / s2 / set_percent), 0.0, 0.0]);
        let set = set_percent;
        let a0 = rounded_down(100.0 - set * (a1 + set * (a2 + set * a3)));
        Ok(Self { lower_percent, upper_percent, coefficients: [a0, a1, a2, a3] })
    }

    /// As the control computes it, from numbers as they are written.
    #[must_use]
    pub fn at(&self, load_percent: f64) -> f64 {
        let [a0, a1, a2, a3] = self.coefficients;
        (a0 + load_percent * (a1 + load_percent * (a2 + load_percent * a3)))
            .clamp(self.lower_percent, self.upper_percent)
    }

    /// The `FCTDEF` with this number.
    fn definition(&self, number: u32) -> String {
        let [a0, a1, a2, a3] = self.coefficients.map(written);
        let (low, high) = (decimal(self.lower_percent), decimal(self.upper_percent));
        format!("FCTDEF({number},{low},{high},{a0},{a1},{a2},{a3})")
    }
}

/// a₁ to a₃ of 100 − c₁u − c₃u³ in their decimals; `None` where c₃ is too small for them.
///
/// Rounded one by one they could rise again: a₂ > 0 needs its a₃ < 0. So a₃ is rounded first, the others follow from it,
/// and a₁ is low enough that a₁ + 2a₂L + 3a₃L² has no load at which it is above 0: a₁ ≤ a₂²/(3a₃).
fn cubic(set: f64, c1: f64, c3: f64) -> Option<[f64; 3]> {
    let a3 = -(c3 / (set * set * set) * PLACES).round() / PLACES;
    if a3 >= 0.0 {
        return None;
    }
    let a2 = (-3.0 * a3 * set * PLACES).round() / PLACES;
    let a1 = (-c1 / set + 3.0 * a3 * set * set).min(a2 * a2 / (3.0 * a3));
    Some([rounded_down(a1), a2, a3])
}

fn rounded_down(a: f64) -> f64 {
    (a * PLACES).floor() / PLACES
}

fn written(a: f64) -> String {
    format!("{:.9}", a + 0.0)
}

/// Depth at which the law begins, mm: the end of the heating sections that the profile begins with, first contact where
/// it begins with none. The law is off while the material heats up.
pub(super) fn begins_mm(profile: &Profile) -> f64 {
    let heating = profile.sections().take_while(|section| section.kind == SectionKind::Heating);
    heating.last().map_or(0.0, |section| section.to_mm)
}

/// The synchronised actions of a file.
pub(super) struct Actions {
    /// Feed drive and spindle: set load and polynomial.
    drives: [Option<(f64, OverridePolynomial)>; 2],
    /// Depth at which they begin, mm.
    pub(super) begins_mm: f64,
}

impl Actions {
    pub(super) fn new(
        profile: &Profile,
        law: LawInControl,
        options: &ExportOptions,
    ) -> Result<Self, Violation> {
        let limits = profile.limits();
        let (lowest, highest) = override_range(profile, options.machine.as_ref());
        let fit = |set: Option<f64>| {
            let fit = |set: f64| {
                let highest = law.override_max_percent.min(highest);
                let polynomial = OverridePolynomial::fit(set, law.intensity, lowest, highest);
                polynomial
                    .map(|polynomial| (set, polynomial))
                    .map_err(|_| Violation::new("law", "no_set_load", "there is no law for this set load"))
            };
            set.map(fit).transpose()
        };
        Ok(Self {
            drives: [fit(limits.feed_drive_load_set_percent)?, fit(limits.spindle_load_set_percent)?],
            begins_mm: begins_mm(profile),
        })
    }

    pub(super) fn definitions(&self) -> Vec<String> {
        self.drives.iter().flatten().zip(1..).map(|((_, one), number)| one.definition(number)).collect()
    }

    /// One action per drive. With both, the one whose load is nearer to its set load writes, in every interpolation cycle.
    pub(super) fn actions(&self) -> Vec<String> {
        const LOADS: [&str; 2] = ["$AA_LOAD[Z]", "$AA_LOAD[SPI(1)]"];
        match &self.drives {
            [Some((feed, _)), Some((spindle, _))] => {
                let left = format!("{}*{}", LOADS[0], decimal(*spindle));
                let right = format!("{}*{}", LOADS[1], decimal(*feed));
                vec![
                    format!("ID=1 WHENEVER {left} >= {right} DO SYNFCT(1,$AC_OVR,{})", LOADS[0]),
                    format!("ID=2 WHENEVER {left} < {right} DO SYNFCT(2,$AC_OVR,{})", LOADS[1]),
                ]
            }
            [Some(_), None] => vec![format!("ID=1 DO SYNFCT(1,$AC_OVR,{})", LOADS[0])],
            [None, Some(_)] => vec![format!("ID=1 DO SYNFCT(1,$AC_OVR,{})", LOADS[1])],
            [None, None] => Vec::new(),
        }
    }

    pub(super) fn cancel(&self) -> String {
        let numbers: Vec<String> = (1..=self.actions().len()).map(|number| number.to_string()).collect();
        format!("CANCEL({})", numbers.join(","))
    }
}

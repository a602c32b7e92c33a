//! Frequency, amplitude and cutting continuity of a recorded block of vibration.
//!
//! The frequency is the highest peak of the spectrum (Hann window, interpolated); the amplitude is that of the sine of
//! this frequency that fits the block best, converted to displacement. Vibrations under control are close to one sine
//! (Ivanov et al. 2024, section 4.2); how close is part of the answer.

use std::f64::consts::{PI, TAU};

use crate::field_error::{FieldError, Problem, count, each_within, within};

/// Fewest samples that a spectrum makes sense of.
const MIN_SAMPLES: usize = 32;

/// Most samples of a block: 100 s at 10 kHz.
pub const MAX_SAMPLES: usize = 1 << 20;

/// Movement in units of the last place of the largest value, up to which a signal stands still: what a sender's and our
/// own roundings make of a constant.
const STILL_ULPS: f64 = 8.0;

/// How many of the strongest peaks outside of the band are looked at for what they leak into it.
const STRONGEST: usize = 8;

/// How far a peak has to stand above what leaks in, as an amplitude: what leaks from several sides adds up.
const LEAKAGE_MARGIN: f64 = 3.0;

/// What was recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Signal {
    /// Displacement, mm.
    Displacement,
    /// Velocity, mm/s.
    Velocity,
    /// Acceleration, mm/s².
    Acceleration,
}

/// Unchecked block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockInput<'a> {
    /// What `values` are.
    pub signal: Signal,
    /// Samples, evenly spaced.
    pub values: &'a [f64],
    /// Time between samples, s.
    pub period_s: f64,
    /// Axial cutting force at the same samples, N, where it was measured.
    pub force_n: Option<&'a [f64]>,
    /// Force above which the drill counts as in cut, N: above the noise of the sensor.
    pub contact_force_n: f64,
    /// Frequencies to look at, Hz; none for all that the block resolves.
    pub band_hz: Option<(f64, f64)>,
}

/// The vibration in a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vibration {
    /// Dominant frequency, Hz.
    pub frequency_hz: f64,
    /// Peak-to-peak displacement of the dominant sine, mm.
    pub displacement_mm: f64,
    /// Share of the signal's variance that this sine explains, 0..1; near 1 the vibration is one sine.
    pub sine_share: f64,
}

/// What a block tells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockAnalysis {
    /// Vibration; none when the signal does not move within the band.
    pub vibration: Option<Vibration>,
    /// Largest minus smallest displacement, mm; only of recorded displacement.
    pub range_mm: Option<f64>,
    /// ψ, share of samples in cut, 0..1; only where force is known.
    pub continuity: Option<f64>,
    /// Largest force, N; only where force is known.
    pub peak_force_n: Option<f64>,
}

/// Analyses a block.
///
/// # Errors
/// Too few or too many samples, a sample that is not finite, a force of another length, or a bad band.
pub fn analyse(block: &BlockInput<'_>) -> Result<BlockAnalysis, FieldError> {
    count("values", block.values.len(), MIN_SAMPLES, MAX_SAMPLES)?;
    each_within("values", block.values, -1e12, 1e12)?;
    within("period_s", block.period_s, 1e-9, 1e3)?;
    within("contact_force_n", block.contact_force_n, 0.0, 1e9)?;
    if let Some(force) = block.force_n {
        if force.len() != block.values.len() {
            let problem = Problem::LengthMismatch { expected: block.values.len(), found: force.len() };
            return Err(FieldError::new("force_n", problem));
        }
        each_within("force_n", force, -1e12, 1e12)?;
    }
    #[expect(clippy::cast_precision_loss, reason = "at most MAX_SAMPLES")]
    let samples = block.values.len() as f64;
    let (lowest, highest) = (2.0 / (samples * block.period_s), 0.45 / block.period_s);
    let (low_hz, high_hz) = block.band_hz.unwrap_or((lowest, highest));
    within("band_hz", low_hz, 0.0, highest)?;
    within("band_hz", high_hz, low_hz, 0.5 / block.period_s)?;

    let extremes = |values: &[f64]| {
        let widen = |(low, high): (f64, f64), value: &f64| (low.min(*value), high.max(*value));
        values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), widen)
    };
    let (least, greatest) = extremes(block.values);
    let moves = greatest - least > STILL_ULPS * f64::EPSILON * least.abs().max(greatest.abs());
    // From the first value, so that a small movement on a large constant loses no digits to the sum.
    let origin = block.values[0];
    let mean = block.values.iter().map(|value| value - origin).sum::<f64>() / samples;
    let centred: Vec<f64> = block.values.iter().map(|value| value - origin - mean).collect();
    let vibration = moves
        .then(|| dominant_hz(&centred, block.period_s, low_hz.max(lowest), high_hz))
        .flatten()
        .and_then(|frequency_hz| fitted(block, &centred, frequency_hz));
    let range_mm = (block.signal == Signal::Displacement).then_some(greatest - least);
    let continuity = block.force_n.map(|force| {
        let in_cut = force.iter().filter(|value| **value > block.contact_force_n).count();
        #[expect(clippy::cast_precision_loss, reason = "at most MAX_SAMPLES")]
        let share = in_cut as f64 / samples;
        share
    });
    Ok(BlockAnalysis { vibration, range_mm, continuity, peak_force_n: block.force_n.map(|f| extremes(f).1) })
}

/// Frequency of the highest spectral peak within the band, Hz.
///
/// A peak is a bin above both of its neighbours, in the band or not: what rises towards the band's edge belongs to
/// something beyond it. Nor is a peak what leaks in from beyond: of a tone at d bins of the unpadded block the Hann
/// window lets through at most 1/(π·d·(d² − 1)) of its height (Harris 1978, the envelope of its side lobes).
#[expect(clippy::cast_precision_loss, reason = "at most 4·MAX_SAMPLES")]
fn dominant_hz(centred: &[f64], period_s: f64, low_hz: f64, high_hz: f64) -> Option<f64> {
    // Padding to at least twice the length lets the parabola through three bins find the peak well.
    let length = (2 * centred.len()).next_power_of_two();
    let mut re = vec![0.0; length];
    let mut im = vec![0.0; length];
    for (i, (out, value)) in re.iter_mut().zip(centred).enumerate() {
        *out = value * (0.5 - 0.5 * (TAU * (i as f64 + 0.5) / centred.len() as f64).cos());
    }
    transform(&mut re, &mut im);
    let bin_hz = 1.0 / (length as f64 * period_s);
    let power: Vec<f64> = (0..=length / 2).map(|bin| re[bin] * re[bin] + im[bin] * im[bin]).collect();
    let log = |bin: usize| power[bin].max(f64::MIN_POSITIVE).ln();
    let place = |peak: usize| {
        let (left, middle, right) = (log(peak - 1), log(peak), log(peak + 1));
        let bend = left - 2.0 * middle + right;
        let shift = if bend < 0.0 { (0.5 * (left - right) / bend).clamp(-0.5, 0.5) } else { 0.0 };
        (peak as f64 + shift) * bin_hz
    };
    // Half a bin of grace: that closely the parabola finds a tone that lies on the edge itself.
    let is_inside = |hz: f64| (low_hz - 0.5 * bin_hz..=high_hz + 0.5 * bin_hz).contains(&hz);
    let peaks = (1..length / 2).filter(|bin| {
        power[*bin] > f64::MIN_POSITIVE && power[*bin] > power[bin - 1] && power[*bin] >= power[bin + 1]
    });
    let (mut inside, mut outside): (Vec<usize>, Vec<usize>) = peaks.partition(|bin| is_inside(place(*bin)));
    let by_height = |a: &usize, b: &usize| power[*b].total_cmp(&power[*a]);
    inside.sort_unstable_by(by_height);
    // At the ends of the spectrum a tone has its mirror image beside it, and need not be a peak of its own.
    outside.extend([0, length / 2]);
    outside.sort_unstable_by(by_height);
    outside.truncate(STRONGEST);
    let bins_apart = |a: usize, b: usize| a.abs_diff(b) as f64 * centred.len() as f64 / length as f64;
    let leaks = |to: usize, from: usize| {
        let d = bins_apart(to, from);
        // Within the main lobe, two bins to either side, nothing can be told from the tone itself.
        let share = if d <= 2.0 { 1.0 } else { 1.0 / (PI * d * (d * d - 1.0)) };
        power[from].sqrt() * share
    };
    inside
        .into_iter()
        .find(|peak| {
            let leaked = outside.iter().map(|from| leaks(*peak, *from)).fold(0.0, f64::max);
            power[*peak].sqrt() > LEAKAGE_MARGIN * leaked
        })
        .map(place)
}

/// The sine of the frequency that fits best (least squares), as displacement.
fn fitted(block: &BlockInput<'_>, centred: &[f64], frequency_hz: f64) -> Option<Vibration> {
    let omega = TAU * frequency_hz;
    let (mut cc, mut ss, mut cs, mut yc, mut ys, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (i, y) in (0_u32..).zip(centred) {
        let (s, c) = (omega * f64::from(i) * block.period_s).sin_cos();
        cc += c * c;
        ss += s * s;
        cs += c * s;
        yc += y * c;
        ys += y * s;
        yy += y * y;
    }
    let determinant = cc * ss - cs * cs;
    if determinant <= 0.0 || yy <= 0.0 {
        return None;
    }
    let (a, b) = ((yc * ss - ys * cs) / determinant, (ys * cc - yc * cs) / determinant);
    let per_displacement = match block.signal {
        Signal::Displacement => 1.0,
        Signal::Velocity => omega,
        Signal::Acceleration => omega * omega,
    };
    Some(Vibration {
        frequency_hz,
        displacement_mm: 2.0 * a.hypot(b) / per_displacement,
        sine_share: ((a * yc + b * ys) / yy).clamp(0.0, 1.0),
    })
}

/// Fourier transform in place, length a power of two (Cooley & Tukey 1965).
#[expect(clippy::cast_precision_loss, reason = "at most 4·MAX_SAMPLES")]
fn transform(re: &mut [f64], im: &mut [f64]) {
    let length = re.len();
    let bits = length.trailing_zeros();
    for i in 0..length {
        let j = i.reverse_bits() >> (usize::BITS - bits);
        if i < j {
            re.swap(i, j);
            im.swap(i, j);
        }
    }
    let mut half = 1;
    while half < length {
        let angle = -PI / half as f64;
        for k in 0..half {
            let (s, c) = (angle * k as f64).sin_cos();
            for start in (k..length).step_by(2 * half) {
                let other = start + half;
                let (r, i) = (re[other] * c - im[other] * s, re[other] * s + im[other] * c);
                (re[other], im[other]) = (re[start] - r, im[start] - i);
                re[start] += r;
                im[start] += i;
            }
        }
        half *= 2;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::continuity::{Process, ProcessInput, trace};
    use super::*;

    fn block(signal: Signal, values: &[f64]) -> BlockInput<'_> {
        BlockInput { signal, values, period_s: 3e-4, force_n: None, contact_force_n: 0.0, band_hz: None }
    }

    #[test]
    fn displacement_velocity_and_acceleration_tell_the_same() {
        let w = TAU * 72.38;
        let at = |i: u32| f64::from(i) * 3e-4;
        let x: Vec<f64> = (0..4000).map(|i| 5.0 + 0.03 * (w * at(i)).sin()).collect();
        let v: Vec<f64> = (0..4000).map(|i| 0.03 * w * (w * at(i)).cos()).collect();
        let a: Vec<f64> = (0..4000).map(|i| -0.03 * w * w * (w * at(i)).sin()).collect();
        let kinds = [(Signal::Displacement, &x), (Signal::Velocity, &v), (Signal::Acceleration, &a)];
        for (signal, values) in kinds {
            let found = analyse(&block(signal, values)).unwrap();
            let vibration = found.vibration.unwrap();
            assert!((vibration.frequency_hz - 72.38).abs() < 0.01, "{vibration:?}");
            assert!((vibration.displacement_mm - 0.06).abs() < 2e-4, "{vibration:?}");
            assert!(vibration.sine_share > 0.999);
            assert_eq!(found.range_mm.is_some(), signal == Signal::Displacement);
        }
    }

    #[test]
    fn a_simulated_cut_gives_back_its_continuity() {
        let process = Process::new(ProcessInput::gouskov_2015(1.5, 0.1, None)).unwrap();
        let (steady, points) = trace(&process, 1).unwrap();
        let steady = steady.unwrap();
        let late = &points[40_000..];
        let displacement: Vec<f64> = late.iter().map(|point| point.displacement).collect();
        let force: Vec<f64> = late.iter().map(|point| point.force).collect();
        let input = BlockInput {
            period_s: 0.01,
            force_n: Some(&force),
            ..block(Signal::Displacement, &displacement)
        };
        let found = analyse(&input).unwrap();
        assert!((found.continuity.unwrap() - steady.continuity).abs() < 1e-9);
        assert!((found.range_mm.unwrap() - steady.amplitude).abs() < 1e-12);
        assert!((found.peak_force_n.unwrap() - steady.peak_force).abs() < 1e-9);
        // Chatter runs a little faster than the eigenfrequency of 1.5 per period.
        let vibration = found.vibration.unwrap();
        assert!((1.5..1.7).contains(&vibration.frequency_hz), "{vibration:?}");
        assert!(vibration.sine_share > 0.9);
    }

    #[test]
    fn a_still_signal_has_no_vibration() {
        let found = analyse(&block(Signal::Acceleration, &[3.0; 64])).unwrap();
        assert_eq!((found.vibration, found.continuity), (None, None));
    }

    #[test]
    fn a_dead_sensor_has_no_vibration_whatever_its_value_rounds_to() {
        for (value, count) in [(0.1, 64), (3.3, 1000), (1e6 / 3.0, 333), (-1e12 / 7.0, 4097), (5e-324, 40)] {
            let found = analyse(&block(Signal::Velocity, &vec![value; count])).unwrap();
            assert_eq!(found.vibration, None, "{count} times {value}");
        }
        // Nor where the last place of the number flickers.
        let flickers: Vec<f64> =
            (0..500_u64).map(|i| f64::from_bits(3.3_f64.to_bits() + i * i % 3)).collect();
        assert_eq!(analyse(&block(Signal::Velocity, &flickers)).unwrap().vibration, None);
        // A movement of a millionth on top of it is one.
        let moves: Vec<f64> = (0..500_u32).map(|i| 3.3 + 1e-6 * (0.2 * f64::from(i)).sin()).collect();
        let found = analyse(&block(Signal::Displacement, &moves)).unwrap().vibration.unwrap();
        assert!((found.displacement_mm / 2e-6 - 1.0).abs() < 1e-3, "{found:?}");
    }

    fn tone(hz: f64, half: f64, count: u32) -> Vec<f64> {
        (0..count).map(|i| half * (TAU * hz * f64::from(i) * 3e-4 + 0.7).sin()).collect()
    }

    #[test]
    fn what_leaks_into_the_band_from_beyond_is_no_vibration() {
        // Less than a period in the block; between the band's end and the Nyquist frequency; outside of what was asked for.
        for (hz, count, band_hz) in [
            (70.83, 32, None),
            (1600.0, 400, None),
            (1650.0, 3000, None),
            (70.0, 3000, Some((100.0, 300.0))),
            (70.0, 3000, Some((20.0, 60.0))),
            (100.7, 3000, Some((103.0, 300.0))),
        ] {
            let values = tone(hz, 1.0, count);
            let input = BlockInput { band_hz, ..block(Signal::Displacement, &values) };
            assert_eq!(analyse(&input).unwrap().vibration, None, "{hz} Hz in {count} samples, {band_hz:?}");
        }
        // A smaller vibration in the band is found beside it, with a spindle out of true or a strong hum.
        for (beyond, hz) in [(20.0, 72.38), (1600.0, 72.38), (150.0, 72.38)] {
            let loud = tone(beyond, 1.0, 3000);
            let values: Vec<f64> = loud.iter().zip(tone(hz, 0.01, 3000)).map(|(a, b)| a + b).collect();
            let input = BlockInput { band_hz: Some((50.0, 100.0)), ..block(Signal::Displacement, &values) };
            let found = analyse(&input).unwrap().vibration.unwrap();
            assert!((found.frequency_hz - hz).abs() < 0.2, "{beyond}: {found:?}");
        }
        // One on the edge itself is within.
        for band_hz in [(50.0, 70.0), (70.0, 100.0)] {
            let values = tone(70.0, 1.0, 3000);
            let input = BlockInput { band_hz: Some(band_hz), ..block(Signal::Displacement, &values) };
            assert!((analyse(&input).unwrap().vibration.unwrap().frequency_hz - 70.0).abs() < 0.05);
        }
    }

    #[test]
    fn bad_blocks_are_refused_by_name() {
        let good = [0.0; 64];
        let refused = |input: BlockInput<'_>| {
            let error = analyse(&input).unwrap_err();
            (error.field(), error.code())
        };
        assert_eq!(refused(block(Signal::Velocity, &[])), ("values", "empty"));
        assert_eq!(refused(block(Signal::Velocity, &[1.0; 5])), ("values", "too_few"));
        let mut broken = good;
        broken[10] = f64::NAN;
        assert_eq!(refused(block(Signal::Velocity, &broken)), ("values", "not_finite"));
        let error = analyse(&block(Signal::Velocity, &broken)).unwrap_err();
        assert_eq!(error.path_in(""), "values[10]");
        let mut force = good;
        force[63] = 1e13;
        let forced = BlockInput { force_n: Some(&force), ..block(Signal::Velocity, &good) };
        assert_eq!(analyse(&forced).unwrap_err().path_in(""), "force_n[63]");
        let short = BlockInput { force_n: Some(&[1.0; 3]), ..block(Signal::Velocity, &good) };
        assert_eq!(refused(short), ("force_n", "length_mismatch"));
        let band = BlockInput { band_hz: Some((90.0, 80.0)), ..block(Signal::Velocity, &good) };
        assert_eq!(refused(band), ("band_hz", "out_of_range"));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]

        #[test]
        fn a_sine_in_a_short_block_is_found_wherever_it_lies_in_the_band(
            count in 32..300_u32, share in 0.0..1.0_f64, phase in 0.0..6.3_f64, offset in -5.0..5.0_f64
        ) {
            // From two and a half periods in the block to just below the band's end.
            let cycles = 2.5 + share * (0.44 * f64::from(count) - 2.5);
            let values: Vec<f64> =
                (0..count).map(|i| offset + (TAU * cycles * f64::from(i) / f64::from(count) + phase).sin()).collect();
            let found = analyse(&block(Signal::Displacement, &values)).unwrap().vibration;
            let periods = found.map(|found| found.frequency_hz * 3e-4 * f64::from(count));
            prop_assert!(periods.is_some_and(|periods| (periods - cycles).abs() < 0.35), "{cycles}: {periods:?}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn any_sine_is_found(hz in 20.0..600.0_f64, half in 0.001..1.0_f64, phase in 0.0..6.0_f64) {
            let values: Vec<f64> = (0..3000_u32).map(|i| half * (TAU * hz * f64::from(i) * 3e-4 + phase).sin()).collect();
            let found = analyse(&block(Signal::Displacement, &values)).unwrap().vibration.unwrap();
            prop_assert!((found.frequency_hz - hz).abs() < 0.02, "{found:?}");
            prop_assert!((found.displacement_mm / (2.0 * half) - 1.0).abs() < 0.01, "{found:?}");
        }
    }
}

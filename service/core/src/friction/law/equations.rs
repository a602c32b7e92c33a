//! Equations 2 to 4 as plain functions, each beside its number.

/// Relative load L_R = max(0, Lf)/L_set (Eq. 2), both in percent of the same rating.
///
/// The maximum is not in print: a braking drive reports a negative load, and the square of Eq. 3 would read a
/// strongly negative one as an overload.
#[must_use]
pub fn relative_load(filtered_percent: f64, set_percent: f64) -> f64 {
    filtered_percent.max(0.0) / set_percent
}

/// Correction C_F in (−1, 1) for a relative load and the intensity b (Eq. 3).
///
/// √(exp(−b·x²)) is computed as exp(−b·x²/2). In print the first branch has no max(0, …): between 0.999 and 1
/// the correction would rise again.
#[must_use]
pub fn correction(relative_load: f64, intensity: f64) -> f64 {
    if relative_load <= 1.0 {
        let distance = (0.999 - relative_load).max(0.0);
        1.0 - (-0.5 * intensity * distance * distance).exp()
    } else {
        let distance = 1.0 - relative_load;
        (-0.5 * intensity * distance * distance).exp() - 1.0
    }
}

/// Override wished for after one IPO, in percent, before any limit (Eq. 4).
///
/// The print leaves L_R = 1 open; there the override stays. The algebraic sum of the second branch,
/// OVR_max·(OVR/OVR_max + C_F − OVR·C_F/OVR_max), is written as OVR + C_F·(OVR_max − OVR).
#[must_use]
pub fn next_override(
    ovr_percent: f64,
    relative_load: f64,
    correction: f64,
    highest_override_percent: f64,
) -> f64 {
    if relative_load > 1.0 {
        (correction + 1.0) * ovr_percent
    } else if relative_load < 1.0 {
        // An override above OVR_max (the profile was tightened) must not be pulled further up by a negative gap.
        ovr_percent + correction * (highest_override_percent - ovr_percent).max(0.0)
    } else {
        ovr_percent
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ipo_until(start: f64, load: f64, intensity: f64, done: impl Fn(f64) -> bool) -> u32 {
        let mut ovr = start;
        for count in 1..1000 {
            ovr = next_override(ovr, load, correction(load, intensity), 200.0).clamp(5.0, 200.0);
            if done(ovr) {
                return count;
            }
        }
        panic!("never reached");
    }

    #[test]
    fn with_intensity_2_the_override_takes_44_ipo_up_and_18_down() {
        assert_eq!(ipo_until(100.0, 0.7, 2.0, |ovr| ovr >= 198.0), 44);
        assert_eq!(ipo_until(200.0, 1.2, 2.0, |ovr| ovr <= 100.0), 18);
    }

    #[test]
    fn the_preferred_load_leaves_the_override_alone() {
        for load in [0.999, 0.9995, 1.0] {
            let ovr = next_override(137.0, load, correction(load, 4.0), 200.0);
            assert!((ovr - 137.0).abs() < 1e-12);
        }
    }

    #[test]
    fn without_a_clamp_a_tenfold_overload_stops_the_feed_and_the_printed_sum_rounds_above_200() {
        assert!(next_override(100.0, 10.0, correction(10.0, 2.0), 200.0).abs() < f64::MIN_POSITIVE);
        let (ovr, c) = (199.999_999_949_828_83_f64, 0.999_999_999_999_981_7_f64);
        let printed = 200.0 * (ovr / 200.0 + c - ovr * c / 200.0);
        assert!(printed > 200.0 && printed < 200.000_000_000_000_1, "{printed}");
        assert!(next_override(ovr, 0.0, c, 200.0) <= 200.0);
    }

    /// C_F as printed, without the inner max(0, …).
    #[test]
    fn the_printed_correction_rises_again_just_below_the_preferred_load_and_this_one_does_not() {
        let printed = |load: f64, b: f64| 1.0 - (-b * (0.999 - load).powi(2)).exp().sqrt();
        assert!(printed(0.9999, 1e3) > printed(0.9995, 1e3) && printed(0.9995, 1e3) > printed(0.999, 1e3));
        for load in [0.999, 0.9995, 0.9999, 1.0] {
            assert!(correction(load, 1e3).abs() < f64::MIN_POSITIVE);
        }
        for load in [0.0, 0.5, 0.9] {
            assert!((correction(load, 2.0) - printed(load, 2.0)).abs() < 1e-15);
        }
    }

    #[test]
    fn a_braking_drive_reads_as_no_load() {
        assert!(relative_load(-300.0, 30.0).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn the_correction_keeps_its_sign_and_its_range(load in 0.0..40.0_f64, b in 0.01..100.0_f64) {
            let c = correction(load, b);
            prop_assert!((-1.0..=1.0).contains(&c));
            prop_assert!((c >= 0.0) == (load <= 1.0) || c.abs() < 1e-15);
        }

        #[test]
        fn for_a_fixed_override_more_load_never_gives_more_feed(
            ovr in 5.0..200.0_f64, a in 0.0..5.0_f64, b in 0.0..5.0_f64, intensity in 0.01..100.0_f64,
        ) {
            let wish = |load| next_override(ovr, load, correction(load, intensity), 200.0);
            prop_assert!(wish(a.max(b)) <= wish(a.min(b)) + 1e-9);
        }
    }
}

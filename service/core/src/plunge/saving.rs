//! What the adaptive plunge saves, per hole and per part, and when it pays.

use crate::field_error::{FieldError, count, within};

/// Most kinds of holes of a part in one call.
pub const MAX_HOLES: usize = 10_000;

/// Unchecked kind of hole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HoleInput {
    /// How many of them the part has.
    pub holes: u32,
    /// Safe distance l_np before the surface, mm: what the part's size error demands.
    pub safe_distance_mm: f64,
    /// Length l_g of the hole, mm.
    pub length_mm: f64,
    /// Exit l_u1 without control, mm.
    pub exit_without_mm: f64,
    /// Exit l_u2 with control, mm.
    pub exit_with_mm: f64,
    /// Rapid way L_x, mm.
    pub rapid_mm: f64,
    /// Rapid feed S_x, mm/min.
    pub rapid_feed_mm_min: f64,
    /// Working feed S_pn, mm/min.
    pub working_feed_mm_min: f64,
    /// Plunge feed S_bp, mm/min.
    pub plunge_feed_mm_min: f64,
}

/// Checked kind of hole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hole(HoleInput);

impl Hole {
    /// Checks a kind of hole.
    ///
    /// # Errors
    /// The first field that is not finite or out of range.
    pub fn new(input: HoleInput) -> Result<Self, FieldError> {
        within("holes", f64::from(input.holes), 1.0, 1e6)?;
        within("safe_distance_mm", input.safe_distance_mm, 0.0, 1e4)?;
        within("length_mm", input.length_mm, 1e-3, 1e4)?;
        within("exit_without_mm", input.exit_without_mm, 0.0, 1e4)?;
        within("exit_with_mm", input.exit_with_mm, 0.0, 1e4)?;
        within("rapid_mm", input.rapid_mm, 0.0, 1e5)?;
        within("rapid_feed_mm_min", input.rapid_feed_mm_min, 1e-3, 1e6)?;
        within("working_feed_mm_min", input.working_feed_mm_min, 1e-3, 1e6)?;
        within("plunge_feed_mm_min", input.plunge_feed_mm_min, 1e-3, 1e6)?;
        Ok(Self(input))
    }
}

/// Saving of one hole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HoleSaving {
    /// T1, cycle without control, s (Eq. 3).
    pub without_s: f64,
    /// T2, cycle with control, s (Eq. 4).
    pub with_s: f64,
    /// ΔT, s; negative when control costs time (Eq. 5 and 6).
    pub saved_s: f64,
    /// ΔT/T, T the time of cutting l_g; `k1·(2 − k2)` where l_np = l_u1 − l_u2 (Eq. 7 and 8).
    pub relative: f64,
    /// k1 = δz/l_g with δz = l_np.
    pub k1: f64,
    /// k2 = S_pn/S_bp.
    pub k2: f64,
    /// Whether control saves time.
    pub pays: bool,
    /// Plunge feed from which it does, mm/min; none when no feed is fast enough.
    pub pays_from_feed_mm_min: Option<f64>,
}

/// Saving of a part.
#[derive(Debug, Clone, PartialEq)]
pub struct PartSaving {
    /// One hole of each kind, in the order given.
    pub holes: Vec<HoleSaving>,
    /// All holes without control, s.
    pub without_s: f64,
    /// All holes with control, s.
    pub with_s: f64,
    /// Saved on the part when every hole is controlled, s; negative when that costs time.
    pub saved_s: f64,
    /// Saved when only the kinds that pay are controlled, s.
    pub best_saved_s: f64,
}

/// ΔT/T = k1·(2 − k2), the relative saving where l_np = l_u1 − l_u2 = δz (Eq. 8); control pays below k2 = 2.
///
/// # Errors
/// A ratio that is negative, not finite or absurd.
pub fn relative_saving(k1: f64, k2: f64) -> Result<f64, FieldError> {
    Ok(within("k1", k1, 0.0, 1e6)? * (2.0 - within("k2", k2, 0.0, 1e9)?))
}

/// Saving of one hole of a kind.
#[must_use]
pub fn hole_saving(hole: &Hole) -> HoleSaving {
    let h = &hole.0;
    let minute_s = 60.0;
    let rapid_s = h.rapid_mm / h.rapid_feed_mm_min * minute_s;
    let at_work = |way_mm: f64| way_mm / h.working_feed_mm_min * minute_s;
    let without_s = rapid_s + at_work(h.safe_distance_mm + h.length_mm + h.exit_without_mm);
    let plunge_s = h.safe_distance_mm / h.plunge_feed_mm_min * minute_s;
    let with_s = rapid_s + at_work(h.length_mm + h.exit_with_mm) + plunge_s;
    let shorter_mm = h.safe_distance_mm + h.exit_without_mm - h.exit_with_mm;
    let saved_s = at_work(shorter_mm) - plunge_s;
    HoleSaving {
        without_s,
        with_s,
        saved_s,
        relative: saved_s / at_work(h.length_mm),
        k1: h.safe_distance_mm / h.length_mm,
        k2: h.working_feed_mm_min / h.plunge_feed_mm_min,
        pays: saved_s > 0.0,
        pays_from_feed_mm_min: (shorter_mm > 0.0)
            .then(|| h.safe_distance_mm * h.working_feed_mm_min / shorter_mm),
    }
}

/// Saving of a part.
///
/// # Errors
/// No holes, or more than [`MAX_HOLES`] kinds.
pub fn part_saving(kinds: &[Hole]) -> Result<PartSaving, FieldError> {
    count("holes", kinds.len(), 1, MAX_HOLES)?;
    let holes: Vec<HoleSaving> = kinds.iter().map(hole_saving).collect();
    let total = |value: fn(&HoleSaving) -> f64| -> f64 {
        holes.iter().zip(kinds).map(|(hole, kind)| value(hole) * f64::from(kind.0.holes)).sum()
    };
    let without_s = total(|hole| hole.without_s);
    let with_s = total(|hole| hole.with_s);
    let saved_s = total(|hole| hole.saved_s);
    let best_saved_s = total(|hole| hole.saved_s.max(0.0));
    Ok(PartSaving { holes, without_s, with_s, saved_s, best_saved_s })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn input(plunge_feed_mm_min: f64) -> HoleInput {
        HoleInput {
            holes: 12,
            safe_distance_mm: 3.0,
            length_mm: 20.0,
            exit_without_mm: 5.0,
            exit_with_mm: 2.0,
            rapid_mm: 100.0,
            rapid_feed_mm_min: 10_000.0,
            working_feed_mm_min: 200.0,
            plunge_feed_mm_min,
        }
    }

    #[test]
    fn a_hole_saves_what_the_paper_says() {
        let saving = hole_saving(&Hole::new(input(1000.0)).unwrap());
        // l_np = l_u1 − l_u2 = 3 mm: k1 = 0.15, k2 = 0.2, ΔT/T = 0.15·1.8 = 0.27 of 6 s of cutting.
        assert!((saving.k1 - 0.15).abs() < 1e-12 && (saving.k2 - 0.2).abs() < 1e-12);
        assert!((saving.relative - relative_saving(0.15, 0.2).unwrap()).abs() < 1e-12);
        assert!((saving.saved_s - 1.62).abs() < 1e-12);
        assert!((saving.without_s - saving.with_s - saving.saved_s).abs() < 1e-12);
        assert!(saving.pays);
        // It stops paying where the plunge is half the working feed: k2 = 2.
        assert!((saving.pays_from_feed_mm_min.unwrap() - 100.0).abs() < 1e-12);
        assert!(!hole_saving(&Hole::new(input(99.0)).unwrap()).pays);
        assert!(relative_saving(0.15, 2.0).unwrap().abs() < 1e-12);
    }

    #[test]
    fn a_part_sums_its_holes_and_leaves_out_what_does_not_pay() {
        let kinds = [Hole::new(input(1000.0)).unwrap(), Hole::new(input(50.0)).unwrap()];
        let part = part_saving(&kinds).unwrap();
        assert!((part.saved_s - 12.0 * (part.holes[0].saved_s + part.holes[1].saved_s)).abs() < 1e-9);
        assert!((part.best_saved_s - 12.0 * 1.62).abs() < 1e-9);
        assert!((part.without_s - part.with_s - part.saved_s).abs() < 1e-9);
        assert_eq!(part_saving(&[]).unwrap_err().code(), "empty");
        let bad = HoleInput { working_feed_mm_min: f64::INFINITY, ..input(100.0) };
        assert_eq!(Hole::new(bad).unwrap_err().field(), "working_feed_mm_min");
    }

    proptest! {
        #[test]
        fn faster_plunges_save_more(feed in 1.0..5000.0_f64, more in 1.0..5000.0_f64) {
            let slow = hole_saving(&Hole::new(input(feed)).unwrap());
            let fast = hole_saving(&Hole::new(input(feed + more)).unwrap());
            prop_assert!(fast.saved_s > slow.saved_s);
            prop_assert_eq!(slow.pays, slow.k2 < 2.0);
        }
    }
}

//! Wear from energy when the feed is not always the same.
//!
//! A law that slows the feed when the tool gets dull hides the wear from the energy, and a fast program dilutes it. So
//! beside the ratio as run there are two more: *compensated*, the energy over what the new tool would have needed at
//! the feeds actually run; and *at the reference feed*, what the same extra energy means at the constant feed at which
//! the limit (+10 %) is defined. For the first the new tool's energy over depth and feed has to be known
//! ([`Relation`], learned by each key for itself: a slope fitted across strategies would be a chord over feeds where
//! the truth is curved).
//!
//! For the second the extra energy of each depth bin is carried over: extra energy per time at a depth is taken to
//! depend on the feed with a small, uncertain exponent. A worn surface that drags with dry friction knows no feed
//! (exponent 0); a plastic layer under it would know a little. The uncertainty of all of it is part of the answer.
//!
//! What does not belong here: which cycles count, their order, windows and verdicts. That is [`crate::wear`].

use super::relation::{DepthBin, DepthProfile, Estimate, Prediction, Relation};

/// Exponent with which the drag of a worn surface grows with the feed: dry friction knows none.
const DRAG_FEED_EXPONENT: f64 = 0.0;

/// Standard deviation of that exponent. Chosen, not fitted: where the worn surface shears hot steel, its drag grows with
/// the rate to the steel's rate sensitivity, 0.1 to 0.2; a hotter wall at a faster feed lowers it again.
const DRAG_FEED_EXPONENT_SD: f64 = 0.2;

/// Rise of the energy that the limit is.
const LIMIT_RISE: f64 = crate::wear::WORN_LEVEL - 1.0;

/// What stands for the new tool at the reference feed.
#[derive(Debug, Clone, Copy)]
pub enum Reference<'a> {
    /// Reference cycles were run: their own relation, at the feeds at which they ran.
    Measured {
        /// Energy of the reference cycles over depth and feed.
        relation: &'a Relation,
        /// The wear that it was learned at; 1 is the new tool.
        level_at_entry: f64,
    },
    /// Nothing but the reference feed is known, mm/min: the key's own relation is asked there.
    Feed(f64),
}

/// What one cycle says of the tool, apart from its energy as run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Compensated {
    /// Energy over what the new tool would have needed at the feeds actually run.
    pub at_own_feed: Estimate,
    /// The same extra energy at the reference feed, as a ratio: what the limit is defined on.
    pub at_reference_feed: Option<Estimate>,
    /// Standard deviation to expect of it, or of the former where there is none, when the limit is reached: what is
    /// not known of the drag grows with the wear.
    pub sd_at_limit: f64,
}

/// Compensates one cycle's energy over depth; `level_at_entry` is the wear that the relation was learned at.
///
/// `None` where the relation knows no bin of it.
#[must_use]
pub fn compensate(
    relation: &Relation,
    reference: Option<Reference<'_>>,
    energy: &DepthProfile,
    level_at_entry: f64,
) -> Option<Compensated> {
    let needed = relation.predict(energy, DepthBin::feed_mm_min);
    let (mut own, mut measured) = (Prediction::default(), 0.0);
    for (bin, need) in energy.bins().iter().zip(&needed) {
        if let Some(need) = need {
            own = own.plus(*need);
            measured += bin.total;
        }
    }
    if own.total <= 0.0 {
        return None;
    }
    let ratio = level_at_entry * measured / own.total;
    let at_own_feed = Estimate { value: ratio, sd: ratio * own.sd() / own.total };
    let carried =
        reference.and_then(|reference| carried(relation, reference, energy, &needed, level_at_entry));
    Some(Compensated {
        at_own_feed,
        at_reference_feed: carried.map(|(estimate, _)| estimate),
        sd_at_limit: carried.map_or(at_own_feed.sd, |(_, sd_at_limit)| sd_at_limit),
    })
}

/// Carries the extra energy of each bin over to the reference feed; with the standard deviation to expect at the limit.
fn carried(
    relation: &Relation,
    reference: Reference<'_>,
    energy: &DepthProfile,
    needed: &[Option<Prediction>],
    level_at_entry: f64,
) -> Option<(Estimate, f64)> {
    let feed_of = |bin: usize| match reference {
        Reference::Measured { relation, .. } => relation.feed_mm_min(bin),
        Reference::Feed(feed) => Some(feed),
    };
    // A relation that was learned in mid-life predicts the tool of then: its energy is so many times the new tool's.
    let (asked, times_new) = match reference {
        Reference::Measured { relation, level_at_entry } => (relation, level_at_entry),
        Reference::Feed(_) => (relation, level_at_entry),
    };
    let at_reference = asked.predict_each(energy, |bin, _| feed_of(bin));
    let (mut extra, mut by_exponent, mut distance) = (0.0, 0.0, 0.0);
    let (mut carried, mut as_learned) = (Prediction::default(), Prediction::default());
    for (index, (bin, need)) in energy.bins().iter().zip(needed).enumerate() {
        let (Some(need), Some(other)) = (need, at_reference[index]) else { continue };
        let (Some(feed), Some(slow)) = (bin.feed_mm_min(), feed_of(index)) else { continue };
        let faster = feed / slow;
        // Energy is power × time: the same drag lasts `faster` times longer at the reference feed.
        let carry = faster.powf(1.0 - DRAG_FEED_EXPONENT);
        let here = carry * (bin.total - need.total);
        extra += here;
        by_exponent += here * faster.ln();
        distance += other.total * faster.ln().abs();
        carried = carried.plus(need.times(carry));
        as_learned = as_learned.plus(other);
    }
    if as_learned.total <= 0.0 {
        return None;
    }
    // All of it as shares of what the new tool needs there.
    let new_tool = as_learned.total / times_new;
    let rise = extra / new_tool;
    let exponent = DRAG_FEED_EXPONENT_SD * by_exponent / new_tool;
    let scale = rise * as_learned.sd() / as_learned.total;
    let known = carried.sd() / new_tool;
    let sd = known.hypot(exponent).hypot(scale);
    // Where the tool drags is not known before it does: it may be anywhere the new tool needs energy.
    let at_limit = DRAG_FEED_EXPONENT_SD * LIMIT_RISE * distance / as_learned.total;
    let scale_at_limit = LIMIT_RISE * as_learned.sd() / as_learned.total;
    Some((Estimate { value: level_at_entry + rise, sd }, known.hypot(at_limit).hypot(scale_at_limit)))
}

#[cfg(test)]
mod tests {
    //! An exact material: e = 40·(F/200)^−0.6 J/mm, and drag that knows no feed.

    use super::*;
    use crate::friction::relation::{FeedSource, Per, RelationConfig, RelationParams};

    const REFERENCE_MM_MIN: f64 = 100.0;

    fn config() -> RelationConfig {
        RelationConfig::new(RelationParams::energy(10.0)).unwrap()
    }

    /// Energy of a hole at one feed; `drag` is the worn surface's power over its share of the new tool's power at
    /// the reference feed, and grows with the feed to the power `exponent`.
    fn hole(feed: f64, drag: f64, exponent: f64) -> DepthProfile {
        let needs = |feed: f64| 40.0 * (feed / 200.0_f64).powf(-0.6);
        let mut profile = DepthProfile::new(&config());
        for step in 0..100 {
            let from = f64::from(step) * 0.1;
            let slower = REFERENCE_MM_MIN / feed;
            let dragged = drag * needs(REFERENCE_MM_MIN) * slower.powf(1.0 - exponent);
            let energy = 0.1 * (needs(feed) + dragged);
            profile.add(&config(), from, from + 0.1, 0.1 / feed * 60.0, energy);
        }
        profile
    }

    fn learned(feed: f64, source: FeedSource) -> Relation {
        let mut relation = Relation::new(config());
        for k in 0..20 {
            let factor = [0.8, 1.0, 1.25][k % 3];
            relation.observe(&hole(feed * factor, 0.0, 0.0), Per::Depth, source);
        }
        relation
    }

    #[test]
    fn at_the_reference_feed_both_ratios_agree() {
        let relation = learned(REFERENCE_MM_MIN, FeedSource::Programmed);
        let energy = hole(REFERENCE_MM_MIN, 0.08, 0.0);
        let found = compensate(&relation, Some(Reference::Feed(REFERENCE_MM_MIN)), &energy, 1.0).unwrap();
        for ratio in [found.at_own_feed.value, found.at_reference_feed.unwrap().value] {
            assert!((ratio - 1.08).abs() < 0.01, "{found:?}");
        }
    }

    /// A relation that cycles of a tool of that level taught, at the reference feed.
    fn learned_at(level: f64) -> Relation {
        let mut relation = Relation::new(config());
        for _ in 0..20 {
            relation.observe(&hole(REFERENCE_MM_MIN, level - 1.0, 0.0), Per::Depth, FeedSource::Programmed);
        }
        relation
    }

    #[test]
    fn what_a_relation_of_mid_life_says_is_of_the_tool_of_then() {
        // 5 % over the tool of 1.05 are 1.1025 times the new one.
        let (relation, energy) = (learned_at(1.05), hole(REFERENCE_MM_MIN, 1.05 * 1.05 - 1.0, 0.0));
        let found = compensate(&relation, Some(Reference::Feed(REFERENCE_MM_MIN)), &energy, 1.05).unwrap();
        let carried = found.at_reference_feed.unwrap();
        assert!((found.at_own_feed.value - 1.1025).abs() < 1e-6, "{found:?}");
        assert!((carried.value - found.at_own_feed.value).abs() < 1e-9, "{found:?}");
        // Reference cycles that were met later: their rise counts from the wear of then, and the wear so far from the key's own.
        let late = learned_at(1.04);
        for (level_at_entry, reference) in [(1.05, &relation), (1.04, &late)] {
            let known = Reference::Measured { relation: reference, level_at_entry };
            let carried =
                compensate(&relation, Some(known), &energy, 1.05).unwrap().at_reference_feed.unwrap();
            assert!((carried.value - 1.1025).abs() < 1e-6, "{level_at_entry}: {carried:?}");
        }
        // What is not known of it grows alike.
        let new = learned_at(1.0);
        let risen = hole(REFERENCE_MM_MIN, 0.05, 0.0);
        let of_new = compensate(&new, Some(Reference::Feed(REFERENCE_MM_MIN)), &risen, 1.0).unwrap();
        let times = carried.sd / of_new.at_reference_feed.unwrap().sd;
        assert!((times - 1.05).abs() < 1e-6, "{times}");
    }

    #[test]
    fn a_slower_feed_is_no_wear_once_it_is_compensated() {
        let relation = learned(300.0, FeedSource::Programmed);
        let found = compensate(&relation, None, &hole(240.0, 0.0, 0.0), 1.0).unwrap();
        let ratio = found.at_own_feed;
        assert!((ratio.value - 1.0).abs() < 2.0 * ratio.sd + 0.005, "{ratio:?}");
        assert_eq!(found.at_reference_feed, None);
    }

    #[test]
    fn wear_that_a_fast_feed_dilutes_is_carried_over_and_another_drag_lies_within_the_uncertainty() {
        let relation = learned(300.0, FeedSource::Programmed);
        let slow = learned(REFERENCE_MM_MIN, FeedSource::Programmed);
        for exponent in [0.0, 0.2, -0.2] {
            let worn = hole(300.0, 0.10, exponent);
            let known = Reference::Measured { relation: &slow, level_at_entry: 1.0 };
            let found = compensate(&relation, Some(known), &worn, 1.0).unwrap();
            assert!(found.at_own_feed.value < 1.09, "{found:?}");
            let carried = found.at_reference_feed.unwrap();
            assert!((carried.value - 1.10).abs() < 2.0 * carried.sd && carried.sd > 0.015, "{carried:?}");
            let off = (carried.value - 1.10).abs();
            assert!(f64::abs(exponent) > 0.0 || off < 0.01, "{carried:?}");
        }
    }

    #[test]
    fn a_law_whose_slope_nobody_explored_is_not_known() {
        let relation = learned(350.0, FeedSource::Controlled);
        let slowed = hole(250.0, 0.11, 0.0);
        let found = compensate(&relation, Some(Reference::Feed(REFERENCE_MM_MIN)), &slowed, 1.0).unwrap();
        assert!(found.at_reference_feed.unwrap().sd > 0.1, "{found:?}");
    }

    #[test]
    fn what_the_relation_never_saw_is_not_compensated() {
        let relation = Relation::new(config());
        assert_eq!(compensate(&relation, None, &hole(100.0, 0.0, 0.0), 1.0), None);
    }
}

//! The relation on an exact material and on random ways.

use super::*;
use crate::friction::noise::Noise;
use proptest::prelude::*;

fn config() -> RelationConfig {
    RelationConfig::new(RelationParams::energy(10.0)).unwrap()
}

/// A cycle of a material with q = 50·(F/200)^−0.6 J/mm at every depth, at one feed.
fn cycle(feed: f64, factor: f64) -> DepthProfile {
    let config = config();
    let mut profile = DepthProfile::new(&config);
    for step in 0..100 {
        let (from, way) = (f64::from(step) * 0.1, 0.1);
        let energy = 50.0 * (feed / 200.0_f64).powf(-0.6) * factor * way;
        profile.add(&config, from, from + way, way / feed * 60.0, energy);
    }
    profile
}

/// 3 · 0.7 divided by 0.7 is rounded below 3: the depth of that edge, looked up, lies in the bin that it ends.
#[test]
fn an_edge_that_is_no_binary_fraction_ends_its_bin() {
    let config = RelationConfig::new(RelationParams { bin_mm: 0.7, ..RelationParams::energy(10.0) }).unwrap();
    assert_eq!(config.bin_of(3.0 * 0.7), Some(2));
    let mut profile = DepthProfile::new(&config);
    profile.add(&config, 1.5, 3.4, 1.9, 19.0);
    for (bin, way) in [(1, 0.0), (2, 0.6), (3, 0.7), (4, 0.6), (5, 0.0)] {
        let found = profile.bins()[bin];
        let off = (found.way_mm - way).abs() + (found.time_s - way).abs() + (found.total - 10.0 * way).abs();
        assert!(off < 1e-9, "bin {bin}: {found:?}");
    }
}

#[test]
fn the_slope_is_learned_from_programmed_feeds_and_its_uncertainty_shrinks() {
    let mut relation = Relation::new(config());
    let mut noise = Noise::seeded(5);
    for _ in 0..4 {
        relation.observe(&cycle(200.0, 1.0 + 0.01 * noise.normal()), Per::Depth, FeedSource::Programmed);
    }
    let before = relation.slope(4).unwrap();
    assert!((before.value + 0.4).abs() < 0.05 && before.sd > 0.3, "one feed says nothing: {before:?}");
    let known = relation.at(4, 200.0).unwrap();
    let guessed = relation.at(4, 600.0).unwrap();
    assert!(known.sd / known.value < 0.03 && guessed.sd / guessed.value > 0.3);
    for feed in [140.0, 300.0, 150.0, 280.0] {
        relation.observe(&cycle(feed, 1.0 + 0.01 * noise.normal()), Per::Depth, FeedSource::Programmed);
    }
    let after = relation.slope(4).unwrap();
    assert!((after.value + 0.6).abs() < 2.0 * after.sd + 0.02 && after.sd < 0.06, "{after:?}");
    let at = relation.at_depth(4.5, 600.0).unwrap();
    assert!((at.value - 50.0 * 3.0_f64.powf(-0.6)).abs() < 2.0 * at.sd);
}

#[test]
fn feeds_that_a_law_chose_teach_the_level_but_not_the_slope() {
    let mut relation = Relation::new(config());
    // Hard pieces drilled slowly at the same load: a fit through them would see a slope of −1.
    for factor in [0.9, 1.0, 1.1] {
        let feed = 200.0 / factor;
        relation.observe(&cycle(feed, factor.powf(0.4)), Per::Depth, FeedSource::Controlled);
    }
    let slope = relation.slope(3).unwrap();
    assert!((slope.value + 0.4).abs() < 1e-9 && (slope.sd - 0.35).abs() < 1e-9);
    assert!(relation.at(3, 200.0).is_some());
}

#[test]
fn what_was_never_seen_is_not_known() {
    let relation = Relation::new(config());
    assert!(relation.at(0, 200.0).is_none() && relation.at_depth(-1.0, 200.0).is_none());
    assert!(relation.slope(99).is_none());
    let refused = RelationParams { bin_mm: 0.001, ..RelationParams::energy(10.0) };
    assert_eq!(RelationConfig::new(refused).unwrap_err().field(), "bin_mm");
}

proptest! {
    #[test]
    fn cutting_into_bins_loses_nothing(
        ways in proptest::collection::vec((-0.2..1.5_f64, 0.0..50.0_f64), 1..60),
    ) {
        let config = RelationConfig::new(RelationParams::energy(200.0)).unwrap();
        let mut profile = DepthProfile::new(&config);
        let (mut at, mut total, mut deeper) = (0.0, 0.0, 0.0);
        for (way, energy) in ways {
            let to = f64::max(at + way, 0.0);
            profile.add(&config, at, to, 0.01, energy);
            total += energy;
            deeper += f64::max(to - at, 0.0);
            at = to;
        }
        prop_assert!((profile.total() - total).abs() < 1e-9 * total.max(1.0));
        let way: f64 = profile.bins().iter().map(|bin| bin.way_mm).sum();
        prop_assert!((way - deeper).abs() < 1e-9);
    }
    #[test]
    fn a_way_in_one_go_is_that_of_its_steps(
        steps in proptest::collection::vec((-0.2..0.9_f64, 0.0..50.0_f64), 1..80),
        // Tenths meet the edges of bins, and land beside them by rounding.
        tenths in any::<bool>(),
        bin_mm in prop_oneof![Just(1.0), Just(0.3), Just(0.7)],
        lost in 0_usize..200,
    ) {
        let config = RelationConfig::new(RelationParams { bin_mm, ..RelationParams::energy(10.0) }).unwrap();
        let mut depth = vec![-0.5];
        for (way, _) in &steps {
            let to = depth[depth.len() - 1] + way;
            depth.push(if tenths { (to * 10.0).round() / 10.0 } else { to });
        }
        let made = |step: usize| (if step == lost { f64::NAN } else { 0.01 }, steps[step - 1].1);
        let (mut together, mut singly) = (DepthProfile::new(&config), DepthProfile::new(&config));
        together.add_way(&config, &depth, made);
        for step in 1..depth.len() {
            let (time_s, total) = made(step);
            singly.add(&config, depth[step - 1], depth[step], time_s, total);
        }
        prop_assert_eq!(together, singly);
    }
}

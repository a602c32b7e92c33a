//! One tool's life on an exact material: e = 40·(F/200)^−0.6 J/mm, and drag that knows no feed.

use super::*;
use proptest::prelude::*;

const REFERENCE_MM_MIN: f64 = 100.0;

fn config(change: impl FnOnce(&mut WearParams)) -> WearConfig {
    let mut params = WearParams { reference_every: None, ..WearParams::new(10.0, REFERENCE_MM_MIN) };
    change(&mut params);
    WearConfig::new(params).unwrap()
}

/// Energy of a hole at one feed; `drag` is the worn surface's power over its share of the new tool's power at
/// the reference feed.
fn hole(config: &WearConfig, feed: f64, drag: f64) -> DepthProfile {
    let needs = |feed: f64| 40.0 * (feed / 200.0_f64).powf(-0.6);
    let mut profile = DepthProfile::new(config.bins());
    for step in 0..100 {
        let from = f64::from(step) * 0.1;
        let time_s = 0.1 / feed * 60.0;
        let dragged = drag * needs(REFERENCE_MM_MIN) * REFERENCE_MM_MIN / feed;
        profile.add(config.bins(), from, from + 0.1, time_s, 0.1 * (needs(feed) + dragged));
    }
    profile
}

fn cycle(energy: &DepthProfile, source: FeedSource, is_reference: bool) -> WearCycle<'_> {
    WearCycle { energy, source, is_reference, key: 1 }
}

/// A state that has learned on feeds around `feed`.
fn learned(config: &WearConfig, feed: f64, source: FeedSource) -> WearState {
    let mut state = WearState::new();
    for k in 0..config.params().learning_cycles {
        let factor = [0.8, 1.0, 1.25][k as usize % 3];
        let energy = hole(config, feed * factor, 0.0);
        let reading = state.step(config, &cycle(&energy, source, false));
        assert!(reading.as_run.is_none() && reading.verdict == WearVerdict::Unknown);
    }
    state
}

#[test]
fn at_the_reference_feed_the_three_ratios_agree() {
    let config = config(|_| {});
    let mut state = learned(&config, REFERENCE_MM_MIN, FeedSource::Programmed);
    let energy = hole(&config, REFERENCE_MM_MIN, 0.08);
    let reading = state.step(&config, &cycle(&energy, FeedSource::Programmed, false));
    for ratio in [
        reading.as_run.unwrap(),
        reading.compensated.unwrap().value,
        reading.at_reference_feed.unwrap().value,
    ] {
        assert!((ratio - 1.08).abs() < 0.01, "{reading:?}");
    }
}

#[test]
fn a_slower_feed_is_no_wear_once_it_is_compensated() {
    let config = config(|_| {});
    let mut state = learned(&config, 300.0, FeedSource::Programmed);
    let slow = hole(&config, 240.0, 0.0);
    let reading = state.step(&config, &cycle(&slow, FeedSource::Controlled, false));
    assert!(reading.as_run.unwrap() > 1.1, "as run it looks worn: {reading:?}");
    let compensated = reading.compensated.unwrap();
    assert!((compensated.value - 1.0).abs() < 2.0 * compensated.sd + 0.005, "{compensated:?}");
}

#[test]
fn wear_that_a_fast_feed_hides_is_carried_to_the_reference_feed() {
    let config = config(|_| {});
    let mut state = learned(&config, 300.0, FeedSource::Programmed);
    let worn = hole(&config, 300.0, 0.10);
    let reading = state.step(&config, &cycle(&worn, FeedSource::Programmed, false));
    assert!(reading.compensated.unwrap().value < 1.075, "{reading:?}");
    let carried = reading.at_reference_feed.unwrap();
    assert!((carried.value - 1.10).abs() < 0.03 && carried.sd > 0.02, "{carried:?}");
}

#[test]
fn a_law_whose_slope_nobody_explored_is_masked_until_reference_cycles_decide() {
    let config = config(|p| {
        p.reference_every = Some(4);
        p.reference_window = 5;
        p.enough_sd = 0.01;
    });
    let mut state = WearState::new();
    let fresh = hole(&config, REFERENCE_MM_MIN, 0.0);
    for _ in 0..20 {
        state.step(&config, &cycle(&fresh, FeedSource::Programmed, true));
    }
    let new = hole(&config, 350.0, 0.0);
    for _ in 0..20 {
        let reading = state.step(&config, &cycle(&new, FeedSource::Controlled, false));
        assert!(reading.masked_by_control);
    }
    let slowed = hole(&config, 250.0, 0.11);
    let mut verdict = WearVerdict::Unknown;
    for k in 0..60 {
        let reading = state.step(&config, &cycle(&slowed, FeedSource::Controlled, false));
        if k == 0 {
            assert!(reading.masked_by_control && reading.reference_due, "{reading:?}");
        }
        if reading.reference_due {
            let reference = hole(&config, REFERENCE_MM_MIN, 0.11);
            let reading = state.step(&config, &cycle(&reference, FeedSource::Programmed, true));
            verdict = reading.verdict;
        }
        if verdict == WearVerdict::Worn {
            break;
        }
    }
    assert_eq!(verdict, WearVerdict::Worn);
    let reading = state.step(&config, &cycle(&slowed, FeedSource::Controlled, false));
    assert_eq!(reading.level.map(|level| level.1), Some(WearBasis::ReferenceCycles));
}

#[test]
fn a_worn_verdict_stays_and_a_key_met_late_carries_the_wear_over() {
    let config = config(|p| p.window_cycles = 5);
    let mut state = learned(&config, REFERENCE_MM_MIN, FeedSource::Programmed);
    let worn = hole(&config, REFERENCE_MM_MIN, 0.12);
    for _ in 0..6 {
        state.step(&config, &cycle(&worn, FeedSource::Programmed, false));
    }
    let good = hole(&config, REFERENCE_MM_MIN, 0.0);
    for _ in 0..20 {
        let reading = state.step(&config, &cycle(&good, FeedSource::Programmed, false));
        assert_eq!(reading.verdict, WearVerdict::Worn);
    }
    let mut state = learned(&config, REFERENCE_MM_MIN, FeedSource::Programmed);
    for _ in 0..12 {
        state.step(&config, &cycle(&worn, FeedSource::Programmed, false));
    }
    let late = WearCycle { key: 9, ..cycle(&worn, FeedSource::Programmed, false) };
    let mut last = None;
    for _ in 0..=config.params().learning_cycles {
        last = state.step(&config, &late).as_run;
    }
    assert!((last.unwrap() - 1.13).abs() < 0.03, "{last:?}");
}

#[test]
fn parameters_out_of_order_are_refused_by_name() {
    let refused = |change: fn(&mut WearParams)| {
        let mut params = WearParams::new(10.0, 100.0);
        change(&mut params);
        WearConfig::new(params).unwrap_err().field().to_owned()
    };
    assert_eq!(refused(|p| p.cleared = 1.08), "warning");
    assert_eq!(refused(|p| p.reference_feed_mm_min = 0.0), "reference_feed_mm_min");
    assert_eq!(refused(|p| p.learning_cycles = 0), "learning_cycles");
    assert_eq!(refused(|p| p.energy.bin_mm = f64::NAN), "energy.bin_mm");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn the_same_cycles_in_two_parts_end_in_the_same_state(
        feeds in proptest::collection::vec((60.0..500.0_f64, 0.0..0.2_f64, any::<bool>()), 2..60), cut in 1_usize..60,
    ) {
        let config = config(|p| p.learning_cycles = 5);
        let run = |state: &mut WearState, part: &[(f64, f64, bool)]| {
            for &(feed, drag, is_reference) in part {
                state.step(&config, &cycle(&hole(&config, feed, drag), FeedSource::Programmed, is_reference));
            }
        };
        let mut whole = WearState::new();
        run(&mut whole, &feeds);
        let cut = cut.min(feeds.len());
        let mut first = WearState::new();
        run(&mut first, &feeds[..cut]);
        let mut carried = first.clone();
        run(&mut carried, &feeds[cut..]);
        prop_assert_eq!(whole, carried);
    }
}

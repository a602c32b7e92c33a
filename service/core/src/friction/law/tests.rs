//! The law as a machine sees it: whole cycles of samples.

use super::*;
use crate::friction::feed_override::{OverrideBounds, OverrideRange};
use proptest::prelude::*;

fn law(change: impl FnOnce(&mut LawParams)) -> LawConfig {
    let mut params = LawParams::paper(30.0, 40.0).unwrap();
    params.heating = Heating::None;
    change(&mut params);
    LawConfig::new(params).unwrap()
}

fn sample(k: u32, feed: f64, spindle: f64) -> LawSample {
    LawSample {
        time_ms: f64::from(k) * 10.0,
        contact_ms: Some(f64::from(k) * 10.0),
        depth_mm: Some(f64::from(k) * 0.03),
        feed_drive_percent: Some(feed),
        spindle_percent: Some(spindle),
    }
}

#[test]
fn without_a_rise_limit_a_cycle_takes_the_44_and_18_ipo_of_the_bare_equations() {
    let config = law(|p| p.rise_limit_points = None);
    let mut state = LawState::new();
    let up = (1..).find(|k| state.step(&config, &sample(*k, 21.0, 1.0)).ovr.percent() >= 198.0);
    assert_eq!(up, Some(44));

    let mut state = LawState::new();
    for k in 0..400 {
        state.step(&config, &sample(k, 0.0, 0.0));
    }
    assert!((state.ovr().percent() - 200.0).abs() < 1e-3);
    // The filters start at the new load, so that the count is the equations' own.
    let high = state.ovr();
    let mut state = LawState::new();
    state.ovr = high;
    let down = (1..).find(|k| state.step(&config, &sample(*k, 36.0, 1.0)).ovr.percent() <= 100.0);
    assert_eq!(down, Some(18));
}

#[test]
fn at_the_highest_override_a_low_load_is_told_as_one() {
    let config = law(|_| {});
    let mut state = LawState::new();
    for k in 0..400 {
        let before = state.ovr().percent();
        let reasons = state.step(&config, &sample(k, 0.0, 0.0)).reasons;
        assert!(reasons.contains(Reason::LoadBelowSet) && !reasons.contains(Reason::LoadAtSet), "{k}");
        assert_eq!(reasons.contains(Reason::ClampedProfileMax), before >= 200.0, "{k}");
    }
    assert!(state.ovr().percent() >= 200.0);
}

#[test]
fn the_papers_law_has_the_papers_numbers() {
    let params = LawParams::paper(30.0, 40.0).unwrap();
    let weights = params.weights.as_array();
    for (weight, paper) in weights.into_iter().zip([0.4, 0.1, 0.5]) {
        assert!((weight - paper).abs() < 1e-15, "{weights:?}");
    }
    assert_eq!((params.set_feed_drive_percent, params.set_spindle_percent), (Some(30.0), Some(40.0)));
    assert_eq!(params.heating, Heating::Time { ms: 2000.0 });
    let range = OverrideRange::new(5.0, 200.0).unwrap();
    assert_eq!(params.bounds, OverrideBounds::new(range, range));
    assert!((params.period_ms - 10.0).abs() < 1e-15 && (params.intensity - 2.0).abs() < 1e-15);
}

#[test]
fn a_rise_takes_five_points_per_sample_and_a_fall_is_immediate() {
    let config = law(|_| {});
    let mut state = LawState::new();
    let step = state.step(&config, &sample(0, 0.0, 0.0));
    assert!((step.ovr.percent() - 105.0).abs() < 1e-12);
    assert!(step.reasons.contains(Reason::RiseLimited) && step.reasons.contains(Reason::LoadBelowSet));
    let mut state = LawState::new();
    let step = state.step(&config, &sample(0, 300.0, 0.0));
    assert!((step.ovr.percent() - 5.0).abs() < 1e-12);
    assert!(step.reasons.contains(Reason::ClampedProfileMin));
}

#[test]
fn the_law_is_off_while_the_material_heats_up_by_time_or_by_depth() {
    let config = law(|p| p.heating = Heating::Time { ms: 2000.0 });
    let mut state = LawState::new();
    for k in 0..200 {
        let step = state.step(&config, &sample(k, 90.0, 90.0));
        assert!((step.ovr.percent() - 100.0).abs() < 1e-12 && step.reasons.contains(Reason::Heating));
    }
    assert!(state.step(&config, &sample(200, 90.0, 90.0)).ovr.percent() < 100.0);

    let config = law(|p| p.heating = Heating::Depth { mm: 0.3 });
    let mut state = LawState::new();
    let blind = LawSample { depth_mm: None, ..sample(0, 0.0, 0.0) };
    assert!(state.step(&config, &blind).reasons.contains(Reason::UnknownDepth));
    assert!(state.step(&config, &sample(9, 0.0, 0.0)).reasons.contains(Reason::Gap));
    let mut state = LawState::new();
    let first = (0..20).find(|k| state.step(&config, &sample(*k, 0.0, 0.0)).ovr.percent() > 100.0);
    assert_eq!(first, Some(10));
}

#[test]
fn after_bad_data_the_law_waits_before_it_raises_but_not_before_it_lowers() {
    let config = law(|_| {});
    let mut state = LawState::new();
    state.step(&config, &sample(0, 10.0, 10.0));
    let bad = state.step(&config, &sample(1, f64::NAN, 10.0));
    assert!(bad.reasons.contains(Reason::NotFiniteLoad) && bad.relative_load.is_none());
    assert!((bad.ovr.percent() - 100.0).abs() < 1e-12);
    for k in 2..6 {
        let step = state.step(&config, &sample(k, 10.0, 10.0));
        assert!(step.reasons.contains(Reason::Settling) && step.ovr.percent() <= 100.0);
    }
    assert!(state.step(&config, &sample(6, 10.0, 10.0)).ovr.percent() > 100.0);
    state.step(&config, &LawSample { spindle_percent: None, ..sample(7, 10.0, 10.0) });
    assert!(state.step(&config, &sample(8, 60.0, 10.0)).ovr.percent() < 100.0);
}

#[test]
fn an_overload_holds_the_override_at_neutral_until_it_is_acknowledged() {
    let config = law(|p| p.overload = OverloadHold::UntilAcknowledged { relative_load: 1.5 });
    let mut state = LawState::new();
    assert!(state.step(&config, &sample(0, 60.0, 0.0)).reasons.contains(Reason::Overload));
    let low = state.ovr().percent();
    for k in 1..100 {
        assert!(state.step(&config, &sample(k, 5.0, 0.0)).ovr.percent() <= low);
    }
    let held = state.ovr();
    state.acknowledge(&config);
    assert!(state.step(&config, &sample(100, 5.0, 0.0)).ovr > held);

    let strict = law(|p| p.overload = OverloadHold::UntilNextCycle { relative_load: 1.5 });
    let mut state = LawState::new();
    state.step(&strict, &sample(0, 60.0, 0.0));
    state.acknowledge(&strict);
    assert!(state.is_overloaded());
    assert!(!LawState::new().is_overloaded());
}

#[test]
fn a_drive_without_a_preferred_load_may_be_missing_and_the_larger_load_governs() {
    let config = law(|p| p.set_feed_drive_percent = None);
    let one = LawSample { feed_drive_percent: None, ..sample(0, 0.0, 20.0) };
    let step = LawState::new().step(&config, &one);
    assert_eq!(step.relative_load, Some((0.5, Drive::Spindle)));
    let step = LawState::new().step(&law(|_| {}), &sample(0, 24.0, 20.0));
    assert_eq!(step.relative_load, Some((0.8, Drive::Feed)));
}

#[test]
fn parameters_out_of_range_are_refused_by_name() {
    let refused = |change: fn(&mut LawParams)| {
        let mut params = LawParams::paper(30.0, 40.0).unwrap();
        change(&mut params);
        LawConfig::new(params).unwrap_err().field().to_owned()
    };
    assert_eq!(refused(|p| p.intensity = 0.0), "intensity");
    assert_eq!(refused(|p| p.set_spindle_percent = Some(f64::NAN)), "set_spindle_percent");
    assert_eq!(refused(|p| p.rise_limit_points = Some(0.0)), "rise_limit_points");
    assert_eq!(refused(|p| p.heating = Heating::Depth { mm: -1.0 }), "heating.mm");
    assert_eq!(refused(|p| p.longest_gap_ms = 1.0), "longest_gap_ms");
    assert_eq!(
        refused(|p| p.overload = OverloadHold::UntilNextCycle { relative_load: 1.0 }),
        "overload.relative_load"
    );
    assert_eq!(
        refused(|p| (p.set_feed_drive_percent, p.set_spindle_percent) = (None, None)),
        "set_feed_drive_percent"
    );
}

/// A load as machines send them: mostly plausible, sometimes missing, sometimes nonsense.
fn any_load() -> impl Strategy<Value = Option<f64>> {
    prop_oneof![
        6 => (-20.0..120.0_f64).prop_map(Some),
        1 => proptest::num::f64::ANY.prop_map(Some),
        1 => Just(None),
    ]
}

fn any_samples() -> impl Strategy<Value = Vec<LawSample>> {
    let step = prop_oneof![8 => Just(10.0), 1 => -20.0..200.0_f64, 1 => Just(f64::NAN)];
    proptest::collection::vec((step, any_load(), any_load()), 1..200).prop_map(|rows| {
        let mut time_ms = 0.0;
        rows.into_iter()
            .map(|(dt, feed_drive_percent, spindle_percent)| {
                time_ms += if dt.is_nan() { 0.0 } else { dt };
                let shown = if dt.is_nan() { dt } else { time_ms };
                LawSample {
                    time_ms: shown,
                    contact_ms: Some(shown),
                    depth_mm: Some(time_ms * 0.003),
                    feed_drive_percent,
                    spindle_percent,
                }
            })
            .collect()
    })
}

fn any_law() -> impl Strategy<Value = LawConfig> {
    (
        (1.0..100.0_f64, 100.0..255.0_f64),
        (1.0..100.0_f64, 100.0..255.0_f64),
        0.1..20.0_f64,
        proptest::option::of(0.5..50.0_f64),
        prop_oneof![Just(Heating::None), (0.0..500.0_f64).prop_map(|ms| Heating::Time { ms })],
    )
        .prop_map(|(machine, profile, intensity, rise, heating)| {
            law(|p| {
                p.bounds = OverrideBounds::new(
                    OverrideRange::new(machine.0, machine.1).unwrap(),
                    OverrideRange::new(profile.0, profile.1).unwrap(),
                );
                p.intensity = intensity;
                p.rise_limit_points = rise;
                p.heating = heating;
            })
        })
}

proptest! {
    #[test]
    fn whatever_comes_the_override_stays_in_both_ranges_and_bad_data_never_raises_it(
        config in any_law(), samples in any_samples(),
    ) {
        let range = config.params().bounds.effective();
        let mut state = LawState::new();
        for sample in &samples {
            let before = state.ovr();
            let step = state.step(&config, sample);
            let now = step.ovr.percent();
            prop_assert!(now >= range.min_percent() && now <= range.max_percent());
            prop_assert!(!step.reasons.is_empty());
            if step.relative_load.is_none() {
                prop_assert!(step.ovr <= before.neutral_from());
            }
            if let Some(points) = config.params().rise_limit_points {
                prop_assert!(now <= before.percent() + points + 1e-9);
            }
        }
    }

    #[test]
    fn a_stream_in_two_parts_is_the_same_as_in_one(
        config in any_law(), samples in any_samples(), cut in 0.0..1.0_f64,
    ) {
        let mut whole = LawState::new();
        let all: Vec<_> = samples.iter().map(|s| whole.step(&config, s)).collect();
        let at = samples.iter().enumerate().take_while(|(k, _)| (*k as f64) < cut * samples.len() as f64).count();
        let mut first = LawState::new();
        let mut parts: Vec<_> = samples[..at].iter().map(|s| first.step(&config, s)).collect();
        let mut carried = first;
        parts.extend(samples[at..].iter().map(|s| carried.step(&config, s)));
        prop_assert_eq!(all, parts);
    }

    #[test]
    fn at_any_moment_a_higher_load_never_gives_a_higher_override(
        config in any_law(), samples in any_samples(), low in 0.0..200.0_f64, more in 0.0..200.0_f64,
    ) {
        let mut state = LawState::new();
        for sample in &samples {
            state.step(&config, sample);
        }
        let next = |load: f64| {
            let time_ms = state_time(&samples) + 10.0;
            let sample = LawSample {
                time_ms, contact_ms: Some(time_ms), depth_mm: Some(1.0), feed_drive_percent: Some(load), spindle_percent: Some(load),
            };
            let mut copy = state;
            copy.step(&config, &sample).ovr.percent()
        };
        prop_assert!(next(low + more) <= next(low) + 1e-9);
    }
}

fn state_time(samples: &[LawSample]) -> f64 {
    samples.iter().rev().map(|s| s.time_ms).find(|t| t.is_finite()).unwrap_or(0.0)
}

use proptest::prelude::*;

use super::*;

fn detector(input: ContactInput) -> ContactDetector {
    ContactDetector::new(ContactSettings::new(input).unwrap())
}

/// Uniform noise of ±1 from a seed: the same run on every machine.
fn noise(seed: &mut u64) -> f64 {
    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    f64::from(u32::try_from(*seed >> 40).unwrap()) / f64::from(1_u32 << 23) - 1.0
}

struct Hole {
    contact_mm: f64,
    exit_mm: f64,
    noise_percent: f64,
    seed: u64,
}

/// A hole at 100 Hz: accelerates to 600 mm/min within 0.1 s, then cuts from `contact_mm` to `exit_mm`.
fn samples(hole: &Hole) -> Vec<ContactSample> {
    let mut seed = hole.seed;
    let mut position_mm = -10.0;
    (0..400)
        .map(|i| {
            let feed_mm_min = 600.0 * (f64::from(i + 1) / 10.0).min(1.0);
            position_mm += feed_mm_min / 60.0 * 0.01;
            let inertia = if i < 10 { 25.0 } else { 0.0 };
            let cutting =
                if position_mm >= hole.contact_mm && position_mm < hole.exit_mm { 14.0 } else { 0.0 };
            let load = 8.0 + inertia + cutting + hole.noise_percent * noise(&mut seed);
            ContactSample { position_mm, feed_mm_min, load_percent: Some(load) }
        })
        .collect()
}

fn run(input: ContactInput, samples: &[ContactSample]) -> (Vec<(usize, ContactEvent)>, ContactStep) {
    let mut detector = detector(input);
    let mut events = Vec::new();
    let mut last = None;
    for (i, sample) in samples.iter().enumerate() {
        let step = detector.step(*sample);
        events.extend(step.event.map(|event| (i, event)));
        last = Some(step);
    }
    (events, last.unwrap())
}

#[test]
fn contact_and_breakthrough_are_found_with_and_without_noise() {
    for noise_percent in [0.0, 0.5, 2.0] {
        for seed in 1..20 {
            let hole = Hole { contact_mm: 0.35, exit_mm: 8.0, noise_percent, seed };
            let samples = samples(&hole);
            let (events, last) = run(ContactInput::DEFAULT, &samples);
            let kinds: Vec<_> = events.iter().map(|(_, event)| *event).collect();
            assert_eq!(kinds, [ContactEvent::Contact, ContactEvent::Breakthrough], "{noise_percent} {seed}");
            // Found at the first sample in the work (0.1 mm apart), reported three samples later.
            let offset = last.contact_offset_mm.unwrap();
            assert!((0.35..=0.46).contains(&offset), "{offset}");
            let first = samples.iter().position(|s| s.position_mm >= 0.35).unwrap();
            assert_eq!(events[0].0, first + 3);
            let through = last.breakthrough_depth_mm.unwrap();
            assert!((8.0..=8.11).contains(&through), "{through}");
            assert_eq!(last.phase, Phase::Through);
        }
    }
}

#[test]
fn depth_counts_from_the_programmed_surface_with_the_offset_beside_it() {
    let input = ContactInput { programmed_surface_mm: 0.2, ..ContactInput::DEFAULT };
    let hole = Hole { contact_mm: 0.5, exit_mm: 99.0, noise_percent: 0.0, seed: 1 };
    let samples = samples(&hole);
    let (_, last) = run(input, &samples);
    let position = samples[samples.len() - 1].position_mm;
    assert!((last.depth_mm.unwrap() - (position - 0.2)).abs() < 1e-12);
    assert!((last.contact_offset_mm.unwrap() - 0.3).abs() < 0.11);
    assert_eq!(last.phase, Phase::InWork);
}

#[test]
fn contact_is_not_reported_while_the_axis_accelerates() {
    let idle = IdleBand::Known { mean_percent: 8.0, half_width_percent: 2.0 };
    let mut detector = detector(ContactInput { idle, ..ContactInput::DEFAULT });
    for i in 0..11 {
        let feed_mm_min = 60.0 * f64::from(i);
        let step = detector.step(ContactSample { position_mm: 0.0, feed_mm_min, load_percent: Some(60.0) });
        assert_eq!((step.event, step.ignored), (None, Some(Ignored::Accelerating)));
    }
}

#[test]
fn missing_and_unusable_samples_never_make_an_event() {
    let idle = IdleBand::Known { mean_percent: 8.0, half_width_percent: 2.0 };
    let mut detector = detector(ContactInput { idle, ..ContactInput::DEFAULT });
    let bad = [None, Some(f64::NAN), Some(f64::INFINITY), Some(f64::NEG_INFINITY), Some(1e30)];
    for load_percent in bad.into_iter().cycle().take(100) {
        let step = detector.step(ContactSample { position_mm: 1.0, feed_mm_min: 600.0, load_percent });
        assert!(step.event.is_none() && step.ignored.is_some());
    }
    // Three good samples, a gap, three good ones: never four in a row.
    for i in 0..40 {
        let load_percent = (i % 4 != 3).then_some(30.0);
        let step = detector.step(ContactSample { position_mm: 1.0, feed_mm_min: 600.0, load_percent });
        assert_eq!(step.event, None);
    }
    let step =
        detector.step(ContactSample { position_mm: f64::NAN, feed_mm_min: 600.0, load_percent: Some(30.0) });
    assert_eq!((step.event, step.depth_mm), (None, None));
}

#[test]
fn bad_settings_are_refused_by_name() {
    let refused = |input| ContactSettings::new(input).unwrap_err().field();
    assert_eq!(refused(ContactInput { confirm_samples: 0, ..ContactInput::DEFAULT }), "confirm_samples");
    assert_eq!(refused(ContactInput { release_share: 0.0, ..ContactInput::DEFAULT }), "release_share");
    let idle = IdleBand::Known { mean_percent: f64::NAN, half_width_percent: 1.0 };
    assert_eq!(refused(ContactInput { idle, ..ContactInput::DEFAULT }), "idle.mean_percent");
}

proptest! {
    #[test]
    fn contact_and_breakthrough_take_turns(
        loads in prop::collection::vec(prop::option::weighted(0.9, -50.0..100.0_f64), 0..300)
    ) {
        let mut detector = detector(ContactInput::DEFAULT);
        let mut events = Vec::new();
        for (i, load_percent) in (0_u32..).zip(loads) {
            let sample =
                ContactSample { position_mm: f64::from(i) - 100.0, feed_mm_min: 600.0, load_percent };
            events.extend(detector.step(sample).event);
        }
        // Nothing is cut that was not touched, and what is found again was left before.
        for (at, event) in events.iter().enumerate() {
            let expected = if at % 2 == 0 { ContactEvent::Contact } else { ContactEvent::Breakthrough };
            prop_assert_eq!(*event, expected);
        }
    }
}

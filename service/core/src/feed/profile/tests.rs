use super::canonical::{escaped, unescaped};
use super::*;
use proptest::prelude::*;

/// Profiles for tests here and beside.
pub(crate) mod given {
    use super::*;

    pub(crate) fn input() -> ProfileInput {
        ProfileInput {
            operation: OperationId::try_from("bushing-m8").unwrap(),
            tool_type: "flow-drill 7.3 long".to_owned(),
            knots: [
                (0.0, 105.0),
                (3.0, 155.0),
                (7.0, 535.0),
                (12.0, 205.0),
                (14.5, 545.0),
                (17.5, 545.0),
                (20.5, 345.0),
            ]
            .map(KnotInput::from)
            .to_vec(),
            sections: vec![
                SectionInput { kind: SectionKind::Heating, to_mm: 3.0 },
                SectionInput { kind: SectionKind::Forming, to_mm: 13.0 },
                SectionInput { kind: SectionKind::IdleTravel, to_mm: 18.0 },
                SectionInput { kind: SectionKind::Flange, to_mm: 20.5 },
            ],
            limits: LimitsInput {
                feed_min_mm_min: 50.0,
                feed_max_mm_min: 1000.0,
                acceleration_mm_s2: 300.0,
                override_min_percent: 5.0,
                override_max_percent: 200.0,
                spindle_load_set_percent: Some(40.0),
                feed_drive_load_set_percent: Some(30.0),
            },
            wear: WearBandInput { from_level: None, to_level: 1.07 },
            conditions: Conditions {
                program: Some("O1234 (left)".to_owned()),
                work_material: Some("S235JRH, 2 mm".to_owned()),
                spindle_speed_rpm: Some(2800.0),
            },
        }
    }

    pub(crate) fn profile() -> Profile {
        Profile::new(input()).unwrap()
    }

    /// Any valid profile: texts with every character there is, knots at the resolution, feeds within reach.
    pub(crate) fn any_profile() -> impl Strategy<Value = Profile> {
        let knot = (1_u32..8_000, 0.0..1.0_f64);
        let settings = (
            (100_u32..20_000, 1_u32..10_000_000, 1_000_u32..2_000_000),
            (1_000_u32..=100_000, 100_000_u32..=255_000),
            (prop::option::of(100_u32..400_000), prop::option::of(100_u32..400_000)),
            (prop::option::of(1_001_u32..1_500), 1_501_u32..2_000),
            prop::option::of(1_000_u32..60_000_000),
        );
        let text = || prop::option::of(any_text());
        let texts = ("[A-Za-z0-9][A-Za-z0-9._:-]{0,40}", any_text(), text(), text());
        (
            prop::collection::vec(knot, 1..40),
            0.0..1.0_f64,
            settings,
            texts,
            prop::collection::vec(0_u8..4, 1..5),
        )
            .prop_map(
                |(steps, first, settings, (operation, tool_type, program, work_material), mut kinds)| {
                    let ((low, more, acceleration), (override_min, override_max), set, (from, to), speed) =
                        settings;
                    let high = (low + more).min(30_000_000);
                    let feed = |part: f64| whole(low) + (part * whole(high - low) * 1000.0).floor() / 1000.0;
                    let mut knots = vec![KnotInput { depth_mm: 0.0, feed_mm_min: feed(first) }];
                    let mut depth = 0;
                    for (way, part) in steps {
                        depth += way;
                        let last = knots[knots.len() - 1].feed_mm_min;
                        // As far towards the wish as the acceleration allows: F² changes by at most 2·3600·a·Δz.
                        let reach = 1800.0 * whole(acceleration) * whole(way);
                        let wish = feed(part);
                        let most = (0.5 * (last + (last * last + 4.0 * reach).sqrt())).min(wish.max(last));
                        let least = (last - reach / last).max(wish.min(last));
                        let reached = if wish > last { most.min(wish) } else { least.max(wish) };
                        let feed_mm_min =
                            ((reached * 1000.0).floor() / 1000.0).clamp(whole(low), whole(high));
                        knots.push(KnotInput { depth_mm: whole(depth), feed_mm_min });
                    }
                    kinds.sort_unstable();
                    let count = u32::try_from(kinds.len()).unwrap().min(depth);
                    let sections = (1..=count)
                        .map(|at| SectionInput {
                            kind: SectionKind::ALL[usize::from(kinds[at as usize - 1])],
                            to_mm: whole(if at == count { depth } else { at * (depth / count) }),
                        })
                        .collect();
                    let limits = LimitsInput {
                        feed_min_mm_min: whole(low),
                        feed_max_mm_min: whole(high),
                        acceleration_mm_s2: whole(acceleration),
                        override_min_percent: whole(override_min),
                        override_max_percent: whole(override_max),
                        spindle_load_set_percent: set.0.map(whole),
                        feed_drive_load_set_percent: set.1.map(whole),
                    };
                    Profile::new(ProfileInput {
                        operation: OperationId::try_from(operation.as_str()).unwrap(),
                        tool_type,
                        knots,
                        sections,
                        limits,
                        wear: WearBandInput { from_level: from.map(whole), to_level: whole(to) },
                        conditions: Conditions {
                            program,
                            work_material,
                            spindle_speed_rpm: speed.map(whole),
                        },
                    })
                    .unwrap()
                },
            )
    }

    /// Texts as people enter them, and as people who mean harm do.
    fn any_text() -> impl Strategy<Value = String> {
        prop_oneof![
            "[a-zA-Z0-9 ._-]{1,30}",
            "\\PC{1,40}",
            Just("-".to_owned()),
            Just("x)\nG0 Z-100\n(".to_owned()),
            Just("a;b%c\r\n%_N_EVIL_MPF\u{0}".to_owned()),
        ]
        .prop_filter("at most 200 bytes", |text| text.len() <= LONGEST_TEXT)
    }
}

use given::{any_profile, input, profile};

fn refused(change: impl FnOnce(&mut ProfileInput)) -> Vec<(String, &'static str)> {
    let mut given = input();
    change(&mut given);
    Profile::new(given).unwrap_err().into_iter().map(|one| (one.path, one.code)).collect()
}

#[test]
fn whatever_is_wrong_is_named_with_its_path_and_everything_at_once() {
    let path = |text: &str, code| vec![(text.to_owned(), code)];
    assert_eq!(refused(|p| p.knots[0].depth_mm = 0.5), path("knots[0].depth_mm", "not_covered"));
    assert_eq!(refused(|p| p.knots[3].depth_mm = 7.0), path("knots[3].depth_mm", "not_increasing"));
    assert_eq!(refused(|p| p.knots[2].feed_mm_min = 1000.1), path("knots[2].feed_mm_min", "outside_limits"));
    assert_eq!(refused(|p| p.knots[0].feed_mm_min = 49.0), path("knots[0].feed_mm_min", "outside_limits"));
    assert_eq!(refused(|p| p.knots[0].feed_mm_min = f64::NAN), path("knots[0].feed_mm_min", "not_finite"));
    assert_eq!(
        refused(|p| p.limits.feed_max_mm_min = f64::INFINITY),
        path("limits.feed_max_mm_min", "not_finite")
    );
    assert_eq!(
        refused(|p| p.limits.override_min_percent = 0.0),
        path("limits.override_min_percent", "out_of_range")
    );
    assert_eq!(
        refused(|p| p.limits.override_max_percent = 99.0),
        path("limits.override_max_percent", "out_of_range")
    );
    assert_eq!(
        refused(|p| p.limits.acceleration_mm_s2 = 5.0)[0],
        ("knots[2].feed_mm_min".to_owned(), "acceleration")
    );
    assert_eq!(refused(|p| p.sections[3].to_mm = 20.4), path("sections[3].to_mm", "not_covered"));
    assert_eq!(refused(|p| p.sections[1].to_mm = 2.0), path("sections[1].to_mm", "not_increasing"));
    assert_eq!(
        refused(|p| p.sections[1].kind = SectionKind::Flange)[0],
        ("sections[2].kind".to_owned(), "order")
    );
    assert_eq!(refused(|p| p.sections.clear()), path("sections", "empty"));
    assert_eq!(refused(|p| p.knots.truncate(1))[0], ("knots".to_owned(), "too_few"));
    assert_eq!(refused(|p| p.knots = vec![(0.0, 100.0).into(); 257])[0], ("knots".to_owned(), "too_many"));
    assert_eq!(refused(|p| p.wear.to_level = 0.9), path("wear.to_level", "out_of_range"));
    assert_eq!(refused(|p| p.wear.from_level = Some(1.08)), path("wear.to_level", "empty_range"));
    assert_eq!(refused(|p| p.tool_type.clear()), path("tool_type", "empty"));
    assert_eq!(
        refused(|p| p.conditions.program = Some("x".repeat(201))),
        path("conditions.program", "too_long")
    );
    assert_eq!(
        refused(|p| {
            p.tool_type.clear();
            p.wear.to_level = f64::NAN;
            p.knots[1].feed_mm_min = -1.0;
        })
        .len(),
        3
    );
}

#[test]
fn feed_time_and_section_follow_from_the_knots() {
    let profile = profile();
    for (depth, feed) in
        [(-1.0, 105.0), (0.0, 105.0), (1.5, 130.0), (3.0, 155.0), (16.0, 545.0), (99.0, 345.0)]
    {
        assert!((profile.feed_at(depth) - feed).abs() < 1e-9, "{depth}");
    }
    assert!((profile.feed_at(f64::NAN) - 105.0).abs() < 1e-9);
    // 60·Δz·ln(F1/F0)/(F1 − F0), piece by piece.
    let by_hand: f64 = profile
        .knots()
        .zip(profile.knots().skip(1))
        .map(|(a, b)| {
            let (way, rise) = (b.depth_mm - a.depth_mm, b.feed_mm_min - a.feed_mm_min);
            if rise.abs() < 1e-9 {
                60.0 * way / a.feed_mm_min
            } else {
                60.0 * way * (b.feed_mm_min / a.feed_mm_min).ln() / rise
            }
        })
        .sum();
    assert!((profile.time_s() - by_hand).abs() < 1e-9 * by_hand);
    assert_eq!(profile.section_at(3.0), Some(SectionKind::Heating));
    assert_eq!(profile.section_at(3.001), Some(SectionKind::Forming));
    assert_eq!(profile.section_at(20.5), Some(SectionKind::Flange));
    assert_eq!(
        (profile.section_at(20.6), profile.section_at(-0.1), profile.section_at(f64::NAN)),
        (None, None, None)
    );
}

#[test]
fn values_are_kept_in_thousandths_and_limits_hold_for_what_is_kept() {
    let mut given = input();
    given.knots[1].feed_mm_min = 155.000_4;
    given.knots[4].feed_mm_min = 545.000_6;
    let kept: Vec<f64> = Profile::new(given).unwrap().knots().map(|knot| knot.feed_mm_min).collect();
    assert!((kept[1] - 155.0).abs() < 1e-12 && (kept[4] - 545.001).abs() < 1e-12);
    assert!(refused(|p| p.knots[2].feed_mm_min = 1_000.000_6).len() == 1);
}

#[test]
fn the_canonical_text_of_a_profile_stays_what_it_is() {
    // A change here changes the hash of every stored profile and is a new format.
    assert_eq!(
        profile().canonical(),
        "feedwright-feed-profile 1\noperation bushing-m8\ntool_type flow-drill=207.3=20long\n\
         program O1234=20=28left=29\nwork_material S235JRH,=202=20mm\nspindle_speed_rpm 2800.000\n\
         feed_min_mm_min 50.000\nfeed_max_mm_min 1000.000\nacceleration_mm_s2 300.000\n\
         override_min_percent 5.000\noverride_max_percent 200.000\nspindle_load_set_percent 40.000\n\
         feed_drive_load_set_percent 30.000\nwear_from_level -\nwear_to_level 1.070\nsection heating 3.000\n\
         section forming 13.000\nsection idle_travel 18.000\nsection flange 20.500\nknot 0.000 105.000\n\
         knot 3.000 155.000\nknot 7.000 535.000\nknot 12.000 205.000\nknot 14.500 545.000\nknot 17.500 545.000\n\
         knot 20.500 345.000\n"
    );
}

#[test]
fn a_text_that_is_not_canonical_is_refused() {
    let text = profile().canonical();
    for (from, to) in [
        ("profile 1", "profile 2"),
        ("1000.000", "1000.0"),
        ("knot 3.000 155.000\n", "knot 3.000 155.000\nknot 3.000 155.000\n"),
        ("operation bushing-m8\n", ""),
        ("program O1234=20=28left=29", "program O1234 (left)"),
        ("wear_to_level 1.070", "wear_to_level 1.070\nwear_to_level 1.070"),
        ("S235", "S=3235"),
    ] {
        assert!(text.contains(from) && Profile::from_canonical(&text.replace(from, to)).is_err(), "{from}");
    }
    assert!(Profile::from_canonical("").is_err());
}

#[test]
fn a_hash_is_64_lower_case_digits() {
    let hash = ProfileHash::from_bytes(std::array::from_fn(|at| u8::try_from(at * 8).unwrap()));
    assert_eq!(ProfileHash::parse(&hash.to_string()), Some(hash));
    for text in ["", "00", &"g".repeat(64), &"A".repeat(64), &"0".repeat(65)] {
        assert_eq!(ProfileHash::parse(text), None);
    }
}

#[test]
fn a_diff_names_knots_settings_and_the_time_of_each_section() {
    let before = profile();
    let mut given = input();
    given.knots[2] = (6.5, 535.0).into();
    given.knots[6].feed_mm_min = 400.0;
    given.wear.to_level = 1.05;
    let after = Profile::new(given).unwrap();
    let found = diff(&before, &after);
    assert_eq!(
        found.settings,
        [Setting { name: "wear_to_level", before: "1.070".into(), after: "1.050".into() }]
    );
    let depths: Vec<f64> = found.knots.iter().map(|knot| knot.depth_mm).collect();
    assert_eq!(depths, [6.5, 7.0, 20.5]);
    assert!(
        matches!(found.knots[0].change, Change::Added { after_mm_min, .. } if (after_mm_min - 535.0).abs() < 1e-9)
    );
    assert!(
        matches!(found.knots[1].change, Change::Removed { before_mm_min, .. } if (before_mm_min - 535.0).abs() < 1e-9)
    );
    let sum: f64 = found.sections.iter().map(|section| section.after_s - section.before_s).sum();
    assert!((sum - (found.after_s - found.before_s)).abs() < 1e-9);
    assert!(found.sections[0].before_s.to_bits() == found.sections[0].after_s.to_bits());
    assert!((found.sections[3].largest_rise_mm_min - 55.0).abs() < 1e-9);
    assert!(diff(&before, &before).is_empty());
}

proptest! {
    #[test]
    fn a_profile_is_valid_by_construction_and_is_its_own_input(profile in any_profile()) {
        prop_assert_eq!(&Profile::new(profile.to_input()).unwrap(), &profile);
        let limits = profile.limits();
        prop_assert!(profile.slowest_mm_min() >= limits.feed_min_mm_min);
        prop_assert!(profile.fastest_mm_min() <= limits.feed_max_mm_min);
        prop_assert!(profile.program().is_ok());
        let knots: Vec<_> = profile.knots().collect();
        for pair in knots.windows(2) {
            prop_assert!(pair[0].depth_mm < pair[1].depth_mm);
            let square = pair[1].feed_mm_min.max(pair[0].feed_mm_min) * (pair[1].feed_mm_min - pair[0].feed_mm_min).abs();
            prop_assert!(square / (pair[1].depth_mm - pair[0].depth_mm) / 3600.0 <= limits.acceleration_mm_s2 * (1.0 + 1e-12));
        }
    }

    #[test]
    fn the_canonical_text_reads_back_to_the_same_profile_and_nothing_else_does(profile in any_profile()) {
        let text = profile.canonical();
        prop_assert!(text.is_ascii() && text.lines().all(|line| !line.is_empty()));
        prop_assert_eq!(Profile::from_canonical(&text).unwrap(), profile);
    }

    #[test]
    fn time_adds_up_and_lies_between_that_of_the_slowest_and_the_fastest_feed(
        profile in any_profile(), cut in 0.0..1.0_f64,
    ) {
        let end = profile.end_depth_mm();
        let whole = profile.time_s();
        let parts = profile.time_between_s(-1.0, cut * end) + profile.time_between_s(cut * end, end + 1.0);
        prop_assert!((whole - parts).abs() <= 1e-9 * whole);
        let at = |feed: f64| end / feed * 60.0;
        prop_assert!(whole >= at(profile.fastest_mm_min()) * (1.0 - 1e-9));
        prop_assert!(whole <= at(profile.slowest_mm_min()) * (1.0 + 1e-9));
    }

    #[test]
    fn a_diff_is_empty_for_equal_contents_only(before in any_profile(), after in any_profile()) {
        prop_assert!(diff(&before, &before).is_empty());
        prop_assert_eq!(diff(&before, &after).is_empty(), before == after);
    }

    #[test]
    fn an_escaped_text_reads_back_and_holds_nothing_that_a_control_acts_on(text in "\\PC{0,40}|[\\x00-\\x7f]{0,40}") {
        let safe = escaped(&text);
        prop_assert!(safe.bytes().all(|b| b.is_ascii_alphanumeric() || b"._:+-/,=".contains(&b)));
        prop_assert_eq!(unescaped(&safe), Some(text));
    }
}

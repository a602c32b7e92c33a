//! The JSON file of a version: written, and read back to the letter like the files for controls.

use super::feed_profile::ProfileBody;
use feedwright_core::cycle::ProfileVersion;
use feedwright_core::feed::nc::Stamp;
use feedwright_core::feed::profile::{Profile, ProfileHash};
use feedwright_core::ids::ProfileId;
use feedwright_core::invalid::Violation;
use serde::{Deserialize, Serialize};

/// What the file is; another word would be another format.
const FORMAT: &str = "feedwright-export 1";

/// What a person has to know, at the head as in every other dialect.
const COMMENT: [&str; 5] = [
    "warning: try it without a workpiece and with a low override first.",
    "the control's limits and the emergency stop stay the safety layer.",
    "do not edit: a changed file no longer has its hash. change the profile instead.",
    "units: mm, mm/min, mm/s2, rpm, percent of the machine's ratings.",
    "depth d below first contact is z = -d, z0 is first contact. the feed is linear in depth between knots.",
];

/// The file, in the order in which it is written.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct JsonFile {
    comment: Vec<String>,
    format: String,
    profile: String,
    version: u32,
    hash: String,
    content: ProfileBody,
}

/// Whether a text is such a file rather than one for a control.
pub fn is_json(text: &str) -> bool {
    text.trim_start_matches('\u{feff}').trim_start().starts_with('{')
}

/// Writes a version.
///
/// # Errors
/// Never: every value of a profile has a JSON form.
pub fn write(profile: &Profile, stamp: &Stamp) -> Result<String, serde_json::Error> {
    let file = JsonFile {
        comment: COMMENT.map(str::to_owned).to_vec(),
        format: FORMAT.to_owned(),
        profile: stamp.version.profile.to_string(),
        version: stamp.version.version,
        hash: stamp.hash.to_string(),
        content: profile.into(),
    };
    serde_json::to_string_pretty(&file).map(|text| text + "\n")
}

/// Reads a file back: the profile, and proof that the file is what is written for it.
///
/// # Errors
/// With the line that is not what is written there, or what is wrong with the profile.
pub fn read(text: &str, hash: impl Fn(&Profile) -> ProfileHash) -> Result<(Stamp, Profile), Vec<Violation>> {
    let none = |why: String| vec![Violation::new("text", "not_an_export", why)];
    let text = text.replace("\r\n", "\n");
    let file: JsonFile = serde_json::from_str(text.trim_start_matches('\u{feff}'))
        .map_err(|error| none(format!("is no file that was exported here: {error}")))?;
    if file.format != FORMAT {
        return Err(none(format!("is of the format `{}`, not `{FORMAT}`", file.format)));
    }
    let version = ProfileVersion {
        profile: ProfileId::parse("profile", &file.profile).map_err(|one| vec![one])?,
        version: file.version,
    };
    let stated = ProfileHash::parse(&file.hash)
        .ok_or_else(|| vec![Violation::new("hash", "not_an_export", "is no hash")])?;
    let profile = file.content.as_it_stands("content")?;
    if hash(&profile) != stated {
        let why = "the content is not what its hash stands for: the file was changed";
        return Err(vec![Violation::new("hash", "hash_mismatch", why)]);
    }
    let stamp = Stamp { version, hash: stated };
    let again = write(&profile, &stamp).map_err(|error| none(error.to_string()))?;
    let (mut is, mut meant) = (text.lines(), again.lines());
    let mut at = 0;
    loop {
        at += 1;
        match (is.next(), meant.next()) {
            (None, None) => return Ok((stamp, profile)),
            (is, meant) if is == meant => {}
            (_, meant) => {
                let why = meant.map_or_else(
                    || "stands after the end: the file was changed".to_owned(),
                    |meant| {
                        format!("is not `{}`, which is written there: the file was changed", meant.trim())
                    },
                );
                return Err(vec![Violation::new(format!("line {at}"), "changed", why)]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use feedwright_core::feed::profile::{
        Conditions, KnotInput, LimitsInput, ProfileInput, SectionInput, SectionKind, WearBandInput,
    };
    use feedwright_core::ids::OperationId;
    use feedwright_store::profile_hash;
    use proptest::prelude::*;
    use proptest::strategy::ValueTree;

    fn any_profile() -> impl Strategy<Value = Profile> {
        let knots = prop::collection::vec((1_u32..3000, 100_000_u32..400_000), 1..255);
        let texts = prop::option::of("\\PC{1,40}".prop_filter("not blank", |text| !text.trim().is_empty()));
        (knots, 50_000_u32..100_000, texts, prop::option::of(1_001_u32..1_050), 1_051_u32..1_900)
            .prop_filter_map("valid profiles only", |(steps, first, program, from, to)| {
                let mut depth = 0;
                let mut knots = vec![KnotInput { depth_mm: 0.0, feed_mm_min: f64::from(first) / 1000.0 }];
                for (way, feed) in steps {
                    depth += way;
                    knots.push(KnotInput {
                        depth_mm: f64::from(depth) / 1000.0,
                        feed_mm_min: f64::from(feed) / 1000.0,
                    });
                }
                let end = f64::from(depth) / 1000.0;
                Profile::new(ProfileInput {
                    operation: OperationId::parse("operation", "bushing-m8").ok()?,
                    tool_type: program.clone().unwrap_or_else(|| "drill \"7.3\"".to_owned()),
                    knots,
                    sections: vec![SectionInput { kind: SectionKind::Forming, to_mm: end }],
                    limits: LimitsInput {
                        feed_min_mm_min: 10.0,
                        feed_max_mm_min: 1000.0,
                        acceleration_mm_s2: 100_000.0,
                        override_min_percent: 5.0,
                        override_max_percent: 150.0,
                        spindle_load_set_percent: from.map(|_| 40.0),
                        feed_drive_load_set_percent: None,
                    },
                    wear: WearBandInput {
                        from_level: from.map(|from| f64::from(from) / 1000.0),
                        to_level: f64::from(to) / 1000.0,
                    },
                    conditions: Conditions { program, work_material: None, spindle_speed_rpm: Some(2800.0) },
                })
                .ok()
            })
    }

    fn stamp(profile: &Profile) -> Stamp {
        let version = ProfileVersion { profile: ProfileId::parse("id", "bushing:long").unwrap(), version: 3 };
        Stamp { version, hash: profile_hash(profile) }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn a_file_reads_back_to_the_same_profile_and_a_change_is_refused_or_told_by_the_stamp(
            profile in any_profile(), at in 0.0..1.0_f64, letter in "[0-9a-z ]",
        ) {
            let text = write(&profile, &stamp(&profile)).unwrap();
            prop_assert!(text.starts_with("{\n  \"comment\": [\n    \"warning: "), "{}", text);
            prop_assert!(is_json(&text));
            prop_assert_eq!(read(&text, profile_hash), Ok((stamp(&profile), profile.clone())));
            prop_assert!(read(&text.replace('\n', "\r\n"), profile_hash).is_ok());
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
            let place = (at * text.len() as f64) as usize;
            if text.is_char_boundary(place) && text.is_char_boundary(place + 1) && text[place..=place] != letter {
                let mut changed = text.clone();
                changed.replace_range(place..=place, &letter);
                // The hash stands for the content, not for its name: under another name it is another version,
                // which nobody knows, and which the answer names.
                let named = |key: &str, value: &str| {
                    let from = text.find(key).unwrap() + key.len();
                    (from..from + value.len()).contains(&place)
                };
                let stamp = stamp(&profile);
                if named("\n  \"profile\": \"", "bushing:long") || named("\n  \"version\": ", "3") {
                    if let Ok((other, same)) = read(&changed, profile_hash) {
                        prop_assert_ne!(other.version, stamp.version);
                        prop_assert_eq!((other.hash, same), (stamp.hash, profile));
                    }
                } else {
                    prop_assert!(read(&changed, profile_hash).is_err(), "{letter} at {place}");
                }
            }
        }
    }

    #[test]
    fn another_name_is_another_version_of_the_same_content() {
        let mut runner = proptest::test_runner::TestRunner::deterministic();
        let profile = any_profile().new_tree(&mut runner).unwrap().current();
        let text = write(&profile, &stamp(&profile)).unwrap();
        for (named, profile_id, version) in [
            (text.replace("bushing:long", "jushing:long"), "jushing:long", 3),
            (text.replace("\"version\": 3", "\"version\": 4"), "bushing:long", 4),
        ] {
            let (other, same) = read(&named, profile_hash).unwrap();
            assert_eq!((other.version.profile.as_str(), other.version.version), (profile_id, version));
            assert_eq!((other.hash, &same), (stamp(&profile).hash, &profile));
        }
        assert_eq!(read(&text.replace("bushing:long", " "), profile_hash).unwrap_err()[0].path, "profile");
    }

    #[test]
    fn what_is_no_such_file_is_refused_with_the_reason() {
        let refused = |text: &str| {
            let wrong = read(text, profile_hash).unwrap_err();
            (wrong[0].path.clone(), wrong[0].code)
        };
        assert_eq!(refused("{}"), ("text".into(), "not_an_export"));
        assert_eq!(refused("{\"a\": 1"), ("text".into(), "not_an_export"));
        assert!(!is_json("; feedwright-export 1"));
    }
}

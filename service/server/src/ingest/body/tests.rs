//! Every kind of bad body, with its code and path.

use super::*;

const NOW: Timestamp = Timestamp::from_micros(1_777_874_400_000_000);

fn of(json: &str) -> Result<Cycle, BodyError> {
    decode(&MachineId::try_from("M1").unwrap(), json.as_bytes(), 1000, NOW)
}

fn with(fields: &str) -> String {
    format!(
        r#"{{"cycle_id":"c1","tool":"T1","operation":"O1","started_at":"2026-05-04T06:00:00Z",{fields}}}"#
    )
}

fn samples(columns: &str) -> String {
    with(&format!(r#""samples":{{"period_ms":10,{columns}}}"#))
}

fn refusal(json: &str) -> (String, &'static str) {
    match of(json) {
        Err(BodyError::Invalid(wrong)) => {
            assert_eq!(wrong.len(), 1, "{wrong:?}");
            (wrong[0].path.clone(), wrong[0].code)
        }
        other => panic!("{json}: {other:?}"),
    }
}

#[test]
fn a_whole_cycle_is_read() {
    let cycle = of(&with(
        r#""seq":9007199254740993,"process":"friction","strategy":"f_ac","law_version":"ac-1",
        "profile":{"id":"P1","version":3},"recommendation_id":"r1","spindle_speed_rpm":2500,"outcome":"aborted",
        "samples":{"time_ms":[0,10,20.5],"depth_mm":[-0.5,-0.0,1e-1],"spindle_load_percent":[1,2,3]},
        "reported":{"energy_joules":12.5,"operator_override_percent":100}"#,
    ))
    .unwrap();
    assert_eq!(cycle.seq, Some(9_007_199_254_740_993), "2^53 + 1 is kept exactly");
    assert_eq!((cycle.process, cycle.strategy), (Some(Process::Friction), Some(Strategy::FAc)));
    assert_eq!(cycle.outcome, Outcome::Aborted);
    assert_eq!(cycle.started_at, NOW);
    let samples = cycle.samples.as_ref().unwrap();
    assert_eq!(samples.column(Channel::DepthMm), Some([-0.5, 0.0, 0.1].as_slice()));
    assert!(samples.column(Channel::DepthMm).unwrap()[1].is_sign_positive());
    assert_eq!(cycle.reported.energy_joules, Some(12.5));
}

#[test]
fn a_cycle_without_samples_is_read() {
    assert!(of(&with(r#""reported":{"energy_joules":1992}"#)).unwrap().samples.is_none());
}

#[test]
fn numbers_that_are_none_are_named() {
    let load = |value: &str| refusal(&samples(&format!(r#""spindle_load_percent":[1,{value}]"#)));
    let at = |code| ("samples.spindle_load_percent[1]".to_owned(), code);
    for value in ["NaN", "Infinity", "-Infinity", "1e999", "-1e999"] {
        assert_eq!(load(value), at("not_finite"), "{value}");
    }
    assert_eq!(load("\"12.5\""), at("wrong_type"));
    assert_eq!(load("null"), at("null_value"));
    assert_eq!(load("true"), at("wrong_type"));
    assert_eq!(load("9007199254740993"), at("out_of_range"));
    assert_eq!(load("[]"), at("wrong_type"));
    let column = |value: &str| refusal(&samples(&format!(r#""spindle_load_percent":{value}"#)));
    let whole = |code| ("samples.spindle_load_percent".to_owned(), code);
    assert_eq!(column("[]"), whole("empty"));
    assert_eq!(column("null"), whole("null_value"));
    assert_eq!(column("5"), whole("wrong_type"));
    assert_eq!(refusal(r#"{"cycle_id":"c1","tool":null,"operation":"O1"}"#), ("tool".into(), "null_value"));
    assert_eq!(
        refusal(&with(r#""reported":{"energy_joules":NaN}"#)),
        ("reported.energy_joules".into(), "not_finite")
    );
}

#[test]
fn fields_that_are_unknown_missing_or_given_twice_are_named() {
    let at = |path: &str, code| (path.to_owned(), code);
    assert_eq!(refusal(&with(r#""feed":1"#)), at("feed", "unknown_field"));
    assert_eq!(refusal(&samples(r#""load":[1]"#)), at("samples.load", "unknown_field"));
    assert_eq!(refusal(&samples(r#""depth_mm`":[1]"#)), at("samples.depth_mm`", "unknown_field"));
    assert_eq!(refusal(&with(r#""reported":{"a`b":1}"#)), at("reported.a`b", "unknown_field"));
    let Err(BodyError::Invalid(violations)) = of(&samples(r#""load":[1]"#)) else { panic!("refused") };
    for channel in Channel::ALL {
        assert!(
            violations[0].message.contains(channel.as_str()),
            "the channels there are: {}",
            violations[0].message
        );
    }
    assert_eq!(refusal(&with(r#""reported":{"joules":1}"#)), at("reported.joules", "unknown_field"));
    assert_eq!(refusal(&with(r#""tool":"T2""#)), at("tool", "duplicate_field"));
    assert_eq!(
        refusal(&samples(r#""depth_mm":[1],"depth_mm":[2]"#)),
        at("samples.depth_mm", "duplicate_field")
    );
    assert_eq!(refusal(r#"{"cycle_id":"c1"}"#), at("tool", "missing_field"));
    assert_eq!(refusal(&with(r#""samples":{"depth_mm":[1]}"#)), at("samples.period_ms", "missing_field"));
    assert_eq!(refusal(&with(r#""samples":{"period_ms":10}"#)), at("samples", "no_channels"));
    assert_eq!(
        refusal(&with(r#""samples":{"period_ms":10,"time_ms":[1],"depth_mm":[1]}"#)),
        at("samples.time_ms", "contradictory")
    );
    assert_eq!(refusal(&with(r#""outcome":"completed""#)), at("samples", "nothing_recorded"));
}

#[test]
fn lists_are_not_taken_for_their_fields_in_order() {
    let at = |path: &str| (path.to_owned(), "wrong_type");
    let ones = vec!["1"; 13].join(",");
    assert_eq!(refusal(&with(&format!(r#""reported":[{ones}]"#))), at("reported"));
    assert_eq!(refusal(&with(r#""profile":["P1",1],"reported":{"energy_joules":1}"#)), at("profile"));
    let whole =
        r#"["c1","T1","O1","2026-05-04T06:00:00Z",null,null,null,null,null,null,null,null,null,null,null]"#;
    assert_eq!(refusal(whole), at(""));
}

#[test]
fn text_without_control_characters_only() {
    let law = |text: &str| with(&format!(r#""law_version":"{text}","reported":{{"energy_joules":1}}"#));
    for text in [r"a\u0000", r"\u0000", r"ac\r\n1", r"1\u0085"] {
        assert_eq!(refusal(&law(text)), ("law_version".to_owned(), "control_character"), "{text}");
    }
    for blank in ["", " ", r"\r\n"] {
        assert_eq!(refusal(&law(blank)), ("law_version".to_owned(), "invalid_length"), "{blank}");
    }
    assert_eq!(of(&law("ac 1·2")).unwrap().law_version.as_deref(), Some("ac 1·2"));
    // What is listed of a body that is refused is text that every database takes, of bounded length.
    assert_eq!(cycle_id_of(br#"{"cycle_id":"a\u0000b"}"#).as_deref(), Some("a\u{fffd}b"));
    let long = format!(r#"{{"cycle_id":"{}"}}"#, "é".repeat(1000));
    assert_eq!(cycle_id_of(long.as_bytes()), Some("é".repeat(128)));
    let not_finite = br#"{"cycle_id":"c\u0031","samples":{"depth_mm":[NaN,-Infinity]}}"#;
    assert_eq!(cycle_id_of(not_finite).as_deref(), Some("c1"));
}

#[test]
fn values_out_of_their_words_and_ranges_are_named() {
    let at = |path: &str, code| (path.to_owned(), code);
    let reported = r#""reported":{"energy_joules":1}"#;
    assert_eq!(refusal(&with(&format!(r#""process":"welding",{reported}"#))), at("process", "unknown_word"));
    assert_eq!(
        refusal(&with(&format!(r#""spindle_speed_rpm":-1,{reported}"#))),
        at("spindle_speed_rpm", "out_of_range")
    );
    assert_eq!(
        refusal(&with(&format!(r#""seq":9223372036854775808,{reported}"#))),
        at("seq", "out_of_range")
    );
    assert_eq!(refusal(&with(&format!(r#""seq":-1,{reported}"#))), at("seq", "wrong_type"));
    assert_eq!(
        refusal(&with(&format!(r#""profile":{{"id":"P","version":0}},{reported}"#))),
        at("profile.version", "out_of_range")
    );
    let started = |text: &str| {
        refusal(&format!(
            r#"{{"cycle_id":"c1","tool":"T1","operation":"O1","started_at":"{text}",{reported}}}"#
        ))
    };
    assert_eq!(started("2026-05-04 06:00"), at("started_at", "invalid_timestamp"));
    assert_eq!(started("2026-05-04T06:10:01Z"), at("started_at", "started_in_future"));
    let many = vec!["1"; 1001].join(",");
    assert_eq!(refusal(&samples(&format!(r#""depth_mm":[{many}]"#))), at("samples", "too_many_samples"));
}

#[test]
fn more_values_than_any_cycle_has_are_refused_before_they_are_kept() {
    let most = 1001 * (Channel::ALL.len() + 1);
    let values = |count: usize| vec!["1"; count].join(",");
    let of_many = |count| samples(&format!(r#""depth_mm":[{}]"#, values(count)));
    let told = |json: &str| match of(json) {
        Err(BodyError::Invalid(wrong)) => wrong[0].message.contains("of all channels"),
        other => panic!("{other:?}"),
    };
    assert!(!told(&of_many(1001)), "so few are told by how many they are");
    for count in [most + 1, 10 * most] {
        let json = of_many(count);
        assert_eq!(refusal(&json), (String::from("samples"), "too_many_samples"));
        assert!(told(&json));
        let slow = decode_by_serde(&MachineId::try_from("M1").unwrap(), json.as_bytes(), 1000, NOW);
        assert_eq!(slow, of(&json));
        let torn = &json[..json.len() - 1];
        assert!(matches!(of(torn), Err(BodyError::Malformed(_))), "whether it is JSON at all comes first");
        let not_finite = json.replacen("[1", "[NaN", 1);
        assert_eq!(refusal(&not_finite), (String::from("samples.depth_mm[0]"), "not_finite"));
    }
    // Where they are no samples, what is wrong is what they are instead.
    let many = values(most + 2);
    let at = |path: &str, code| (path.to_owned(), code);
    for (json, refused) in [
        (format!(r#"{{"x":[{many}]}}"#), at("x", "unknown_field")),
        (with(&format!(r#""x":[{many}]"#)), at("x", "unknown_field")),
        (samples(&format!(r#""x":[{many}]"#)), at("samples.x", "unknown_field")),
        (with(&format!(r#""seq":[{many}]"#)), at("seq", "wrong_type")),
        (
            with(&format!(r#""reported":{{"energy_joules":[{many}]}}"#)),
            at("reported.energy_joules", "wrong_type"),
        ),
        (with(&format!(r#""samples":[{many}]"#)), at("samples", "wrong_type")),
        (format!("[{many}]"), at("", "wrong_type")),
        (
            samples(&format!(r#""depth_mm":5,"thrust_newtons":[{many}]"#)),
            at("samples.depth_mm", "wrong_type"),
        ),
        (
            samples(&format!(r#""depth_mm":[1],"depth_mm":[{many}]"#)),
            at("samples.depth_mm", "duplicate_field"),
        ),
        (
            with(&format!(r#""samples":null,"samples":{{"depth_mm":[{many}]}}"#)),
            at("samples", "duplicate_field"),
        ),
        (
            samples(&format!(r#""depth_mm":[{many}],"thrust_newtons":[null]"#)),
            at("samples", "too_many_samples"),
        ),
    ] {
        assert_eq!(refusal(&json), refused, "{}", &json[..json.len().min(200)]);
        let slow = decode_by_serde(&MachineId::try_from("M1").unwrap(), json.as_bytes(), 1000, NOW);
        assert_eq!(slow, of(&json));
    }
    let lone = format!(r#"{{"x":"\ud800","samples":{{"depth_mm":[{many}]}}}}"#);
    assert!(matches!(of(&lone), Err(BodyError::Malformed(_))), "whether it is JSON at all comes first");
    // As many as there may be, in as long a body.
    let all = Channel::ALL.iter().map(|channel| format!(r#""{}":[{}]"#, channel.as_str(), values(1000)));
    let columns = all.collect::<Vec<_>>().join(", ");
    let all = samples(&columns) + &" ".repeat(4 * most);
    assert!(of(&all).is_ok(), "{:?}", of(&all));
    // With every field there is, and commas in texts: they part no values.
    let fields = ",".repeat(60);
    let json = format!(
        r#"{{"cycle_id":"c1","tool":"T1","operation":"O1","started_at":"2026-05-04T06:00:00Z","law_version":"{fields}",
            "samples":{{"time_ms":[{}],{columns}}},"reported":{{"energy_joules":1,"max_depth_mm":2}}}}"#,
        (0..1000).map(|stamp| stamp.to_string()).collect::<Vec<_>>().join(",")
    ) + &" ".repeat(4 * most);
    assert!(of(&json).is_ok(), "{:?}", of(&json));
}

#[test]
fn a_zero_that_is_reported_has_no_sign() {
    let json = r#"{"cycle_id":"c1","tool":"T1","operation":"O1","started_at":"2026-05-04T06:00:00Z",
        "reported":{"energy_joules":-0.0,"max_depth_mm":-0.0,"edge_wear_mm":-0.0}}"#;
    let reported = of(json).unwrap().reported;
    for value in [reported.energy_joules, reported.max_depth_mm, reported.cut.edge_wear_mm] {
        assert_eq!(value.map(f64::to_bits), Some(0.0_f64.to_bits()));
    }
}

#[test]
fn every_violation_is_told_at_once() {
    let json = r#"{"cycle_id":"-","tool":"","operation":"O 1","started_at":"now",
        "samples":{"period_ms":10,"depth_mm":[1,2],"spindle_load_percent":[1]}}"#;
    let Err(BodyError::Invalid(wrong)) = of(json) else { panic!() };
    let paths: Vec<&str> = wrong.iter().map(|violation| violation.path.as_str()).collect();
    assert_eq!(paths, ["cycle_id", "tool", "operation", "started_at", "samples.spindle_load_percent"]);
}

#[test]
fn what_is_no_json_is_malformed() {
    for json in
        ["", "{", "not json", r#"{"cycle_id":"c1"}}"#, "{\"cycle_id\":\"c\u{0}\"}", r#"{"cycle_id":"c1","#]
    {
        assert!(matches!(of(json), Err(BodyError::Malformed(_))), "{json:?}: {:?}", of(json));
    }
    for json in ["[]", "null", "5", "\"text\""] {
        assert!(matches!(of(json), Err(BodyError::Invalid(_))), "{json:?}: {:?}", of(json));
    }
    // In any order of the fields.
    let machine = MachineId::try_from("M1").unwrap();
    for json in [
        br#"{"cycle_id":"\ud800","zzz":1}"#.as_slice(),
        br#"{"zzz":1,"cycle_id":"\ud800"}"#,
        b"{\"cycle_id\":\"a\xff\",\"zzz\":1}",
        b"{\"zzz\":1,\"cycle_id\":\"a\xff\"}",
        b"{\"tool\":\"T1\",\"tool\":\"\xff\"}",
        br#"{"cycle_id":"a\q","tool":NaN}"#,
        br#"{"tool":NaN,"cycle_id":"a\q"}"#,
        b"{\"tool\":NaN,\"cycle_id\":\"a\tb\"}",
        b"{\"tool\":NaN,\"cycle_id\":\"a\xff\"}",
    ] {
        for decoded in [decode(&machine, json, 1000, NOW), decode_by_serde(&machine, json, 1000, NOW)] {
            assert!(matches!(decoded, Err(BodyError::Malformed(_))), "{}: {decoded:?}", json.escape_ascii());
        }
    }
}

#[test]
fn a_clock_at_1970_is_read_and_flagged_later() {
    let json = r#"{"cycle_id":"c1","tool":"T1","operation":"O1","started_at":"1970-01-01T00:00:07Z",
        "reported":{"energy_joules":1}}"#;
    assert_eq!(of(json).unwrap().started_at, Timestamp::from_micros(7_000_000));
}

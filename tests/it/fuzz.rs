//! Bodies that nobody would send: seeded, bounded, the same in every run. Both forms of a cycle's body are read without a
//! panic; what the fast JSON reader takes is what serde takes; what is no JSON is told as that, whatever else is wrong with it;
//! what is read twice has the same hash.

use feedwright_core::units::Timestamp;
use feedwright_server::ingest::body::{self, BodyError};
use feedwright_store::codec::{Habits, Places};
use feedwright_store::{codec, wire};

const JSON: &[u8] = include_bytes!("../golden/cycle.json");
const FRAME: &[u8] = include_bytes!("../golden/cycle.bin");
/// 2026-05-04T06:00:00Z.
const NOW: Timestamp = Timestamp::from_micros(1_777_874_400_000_000);
/// Mutated bodies of each seed.
const RUNS: usize = 5_000;
/// Samples that a cycle may hold here.
const MOST: usize = 64;

/// A xorshift generator.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, bound: usize) -> usize {
        usize::try_from(self.next() % bound.max(1) as u64).unwrap()
    }
}

/// Pieces that break readers: what JSON is made of, and numbers at their edges.
const PIECES: [&[u8]; 31] = [
    b"{",
    b"}",
    b"[",
    b"]",
    b",",
    b":",
    b"\"",
    b"\\",
    b"\\u0000",
    b"null",
    b"true",
    b"-",
    b"-0",
    b"0.1",
    b"1e999",
    b"9007199254740993",
    b"123456789012345678901",
    b"0.000000000000001",
    b"NaN",
    b"\xff",
    b" ",
    b"01",
    b"1.",
    b"\"cycle_id\":\"x\",",
    b"\\ud83d",
    b"\\ude00",
    b"\\q",
    b"\t",
    b"\xc2\xa0",
    b"\"zzz\":1,",
    b"\"tool\":NaN,",
];

fn mutated(seed: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..=random.below(4) {
        let at = random.below(bytes.len());
        match random.below(7) {
            0 => bytes.truncate(at),
            1 if at < bytes.len() => bytes[at] ^= 1 << random.below(8),
            2 if at < bytes.len() => drop(bytes.remove(at)),
            3 => {
                let piece = PIECES[random.below(PIECES.len())];
                bytes.splice(at..at, piece.iter().copied());
            }
            4 => {
                let end = (at + random.below(20)).min(bytes.len());
                let copy = bytes[at..end].to_vec();
                let to = random.below(bytes.len());
                bytes.splice(to..to, copy);
            }
            5 => {
                let end = (at + random.below(20)).min(bytes.len());
                bytes.drain(at..end);
            }
            _ if at < bytes.len() => bytes[at] = b"0123456789.-+eE,:{}[]\" "[random.below(23)],
            _ => {}
        }
    }
    bytes
}

fn seeds() -> Vec<Vec<u8>> {
    let compact: Vec<u8> = JSON.iter().copied().filter(|byte| !byte.is_ascii_whitespace()).collect();
    let small = br#"{"cycle_id":"c1","tool":"T1","operation":"O1","started_at":"2026-05-04T05:59:00Z","samples":{"time_ms":[0,1.5,2],"depth_mm":[-0.0,0.10,99999]}}"#;
    // Of short texts, so that most is changed within one.
    let texts = br#"{"zzz":"a\u00e9","cycle_id":"c1","tool":"T\"1","operation":"O1","started_at":"x","process":"\ud83d\ude00"}"#;
    let beside = br#"{"cycle_id":"c1","tool":"T\u0031","operation":NaN,"process":"\ud83d\ude00"}"#;
    vec![JSON.to_vec(), compact, small.to_vec(), texts.to_vec(), beside.to_vec()]
}

/// Whether it is JSON, by a reader that keeps every text of it; `None` where that stops at a number before it knows.
fn is_json(body: &[u8]) -> Option<bool> {
    match serde_json::from_slice::<serde_json::Value>(body) {
        Ok(_) => Some(true),
        Err(error) if error.to_string().starts_with("number out of range") => None,
        Err(_) => Some(false),
    }
}

/// The same with numbers in the place of words that are none: no JSON, where they are not all that is wrong with it.
fn without_nan(body: &[u8]) -> Vec<u8> {
    let (mut rest, mut out) = (body, Vec::new());
    while let Some((first, behind)) = rest.split_first() {
        let nan = rest.strip_prefix(b"NaN");
        out.push(if nan.is_some() { b'0' } else { *first });
        rest = nan.unwrap_or(behind);
    }
    out
}

#[test]
fn json_is_read_alike_by_both_readers_whatever_it_is() {
    let (machine, mut random) = ("M1".try_into().unwrap(), Random(0x5EED));
    let (mut read, mut refused) = (0, 0);
    for seed in seeds() {
        for _ in 0..RUNS {
            let json = mutated(&seed, &mut random);
            let fast = body::decode_with_places(&machine, &json, MOST, NOW);
            if body::is_frame(&json) {
                continue;
            }
            let slow = body::decode_by_serde(&machine, &json, MOST, NOW);
            let places = fast.as_ref().map_or_else(|_| Places::default(), |(_, places)| *places);
            let fast = fast.map(|(cycle, _)| cycle);
            assert_eq!(fast, slow, "{}", String::from_utf8_lossy(&json));
            let malformed = matches!(slow, Err(BodyError::Malformed(_)));
            match is_json(&json) {
                Some(true) => assert!(!malformed, "{slow:?}: {}", json.escape_ascii()),
                Some(false) if is_json(&without_nan(&json)) == Some(false) => {
                    assert!(malformed, "{slow:?}: {}", json.escape_ascii());
                }
                _ => {}
            }
            match (fast, slow) {
                (Ok(fast), Ok(slow)) => {
                    read += 1;
                    assert_eq!(Habits::default().encode(&fast, places), codec::encode(&slow));
                }
                _ => refused += 1,
            }
        }
    }
    assert!(read > 100 && refused > RUNS, "both happen: {read} read, {refused} refused");
}

#[test]
fn frames_are_read_or_refused_with_a_reason() {
    let (machine, mut random) = ("M1".try_into().unwrap(), Random(0xF8A3E));
    let (mut read, mut malformed, mut invalid) = (0, 0, 0);
    for run in 0..3 * RUNS {
        let mut frame = mutated(FRAME, &mut random);
        // Most are given a length and a checksum that hold: what is behind them is what matters.
        if run % 4 != 0 && frame.len() > wire::HEAD + wire::CHECKSUM {
            frame[..4].copy_from_slice(&wire::MAGIC);
            let end = frame.len() - wire::CHECKSUM;
            let length = u32::try_from(end - wire::HEAD).unwrap();
            frame[4..wire::HEAD].copy_from_slice(&length.to_le_bytes());
            let sum = crc32fast::hash(&frame[..end]);
            frame[end..].copy_from_slice(&sum.to_le_bytes());
        }
        assert!(wire::frames(&frame, 1000).is_none_or(|frames| frames.concat() == frame));
        if !body::is_frame(&frame) {
            continue;
        }
        match body::decode_with_places(&machine, &frame, MOST, NOW) {
            Ok((cycle, places)) => {
                read += 1;
                assert_eq!(Habits::default().encode(&cycle, places), codec::encode(&cycle));
                let again = body::decode(&machine, &wire::encode(&cycle), MOST, NOW).unwrap();
                assert_eq!(again, cycle, "what was read is written and read again");
            }
            Err(BodyError::MalformedFrame(_)) => malformed += 1,
            Err(BodyError::Invalid(violations)) => {
                invalid += 1;
                assert!(!violations.is_empty());
            }
            Err(BodyError::Malformed(why)) => panic!("no JSON is expected here: {why}"),
        }
    }
    assert!(read > 50 && malformed > 500 && invalid > 50, "{read} {malformed} {invalid}");
}

/// The encoder that machine builders copy from writes the bytes that the service's own does.
#[test]
fn python_writes_the_same_bytes() {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/python/feedwright_cycle.py");
    let run = |arguments: &[&str], input: &'static [u8]| {
        let mut child = std::process::Command::new("python3")
            .arg(script)
            .args(arguments)
            .stdin(std::process::Stdio::piped())
            .stdout(std::process::Stdio::piped())
            .spawn()
            .expect("python3 runs");
        std::io::Write::write_all(&mut child.stdin.take().unwrap(), input).unwrap();
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success());
        output.stdout
    };
    assert_eq!(run(&[], JSON), FRAME);
    const LINE: &[u8] = br#"{"cycle_id":"c1","tool":"T1","operation":"O1","started_at":"2026-05-04T05:59:00.000001Z","samples":{"time_ms":[0,1.5,2],"depth_mm":[-0.0,0.10,99999]}}"#;
    let machine = "M1".try_into().unwrap();
    let cycle = body::decode(&machine, LINE, MOST, NOW).unwrap();
    assert_eq!(run(&["--batch"], LINE), wire::encode(&cycle));
}

/// Encodes each line with the encoder that machine builders copy from; `None` where it refuses one.
fn encoded_by_python(lines: &[Vec<u8>]) -> Vec<Option<Vec<u8>>> {
    const EACH: &str = "\
import sys
sys.path.insert(0, sys.argv[1])
import feedwright_cycle as form
for line in sys.stdin.buffer:
    try:
        print(form.encode(form._read_json(line)).hex())
    except (KeyError, ValueError):
        print('refused')
";
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/python");
    let mut child = std::process::Command::new("python3")
        .args(["-B", "-c", EACH, folder])
        .stdin(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped())
        .spawn()
        .expect("python3 runs");
    let (mut input, lines) = (child.stdin.take().unwrap(), lines.join(&b'\n'));
    let written = std::thread::spawn(move || std::io::Write::write_all(&mut input, &lines));
    let output = child.wait_with_output().unwrap();
    written.join().unwrap().unwrap();
    assert!(output.status.success(), "it refuses with nothing but KeyError and ValueError");
    let frames = String::from_utf8(output.stdout).unwrap();
    let byte = |hex: &[u8]| u8::from_str_radix(std::str::from_utf8(hex).unwrap(), 16).unwrap();
    let frame = |line: &str| (line != "refused").then(|| line.as_bytes().chunks(2).map(byte).collect());
    frames.lines().map(frame).collect()
}

/// What JSON would be taken for is what its frame is taken for, and what JSON refuses is refused by it or as a frame.
#[test]
fn python_takes_what_json_takes_and_nothing_else() {
    // The end of all times that there are, so that none is refused for a clock ahead.
    const LATE: Timestamp = Timestamp::from_micros(253_402_207_200_000_000);
    let with = |field: &str, value: &str| {
        let mut fields = vec![
            ("cycle_id", r#""c1""#),
            ("tool", r#""T1""#),
            ("operation", r#""O1""#),
            ("started_at", r#""2026-05-04T06:00:00Z""#),
            ("samples", r#"{"period_ms":10,"depth_mm":[1,2]}"#),
        ];
        fields.retain(|(name, _)| *name != field);
        fields.push((field, value));
        let fields = fields.iter().map(|(name, value)| format!("\"{name}\":{value}")).collect::<Vec<_>>();
        format!("{{{}}}", fields.join(",")).into_bytes()
    };
    let mut lines = Vec::new();
    for at in [
        "2026-05-04T06:00:00Z",
        "2026-05-04t06:00:00.5z",
        "2026-05-04 06:00:00-23:59",
        "2026-05-04T06:00:00-00:00",
        "2016-12-31T23:59:60Z",
        "2016-12-31T23:59:60.75Z",
        "2016-12-31T23:59:60z",
        "2016-12-31T23:59:60+00:00",
        "2026-05-04T12:30:60Z",
        "2026-05-04T23:59:61Z",
        "2026-05-04T06:00Z",
        "20260504T060000Z",
        "2026-W19-1T06:00:00Z",
        "2026-05-04T06:00:00+0200",
        "2026-05-04T06:00:00+02",
        "2026-05-04T06:00:00+02:00:30",
        "2026-05-04T06:00:00+02:60",
        "2026-05-04T06:00:00+24:00",
        "2026-05-04T06:00:00,5Z",
        "2026-05-04T06:00:00.Z",
        "2026-05-04T06:00:00ZZ",
        "2026-05-04T06:00:00",
        "2026-05-04T24:00:00Z",
        "2026-05-04T06:00:00Z\\n",
        "２026-05-04T06:00:00Z",
        "2026-02-29T06:00:00Z",
        "2024-02-29T06:00:00Z",
        "2026-05-04T06:00:00.12345678999999999+02:00",
        "1969-12-31T23:59:59.9999999Z",
        "0001-01-01T00:00:00Z",
        "0001-01-01T00:00:00+00:01",
        "0000-12-31T23:00:00-02:00",
        "0000-02-29T00:00:00Z",
        "9999-12-30T22:00:00Z",
        "9999-12-31T21:59:00+23:59",
        "9999-12-30T22:00:00.9999999Z",
        "9999-12-30T22:00:01Z",
        "9999-12-31T23:59:59Z",
        "",
    ] {
        lines.push(with("started_at", &format!("\"{at}\"")));
    }
    for (field, values) in [
        ("started_at", r#"1777874400000000|true|null|["2026-05-04T06:00:00Z"]"#),
        ("cycle_id", r#""c\u0031"|5|null|true|[]|"\ud800"|"é""#),
        ("seq", r#"0|18446744073709551615|18446744073709551616|9223372036854775807|1.0|-1|true|"1"|null"#),
        ("process", r#""friction"|5|null|"welding""#),
        ("law_version", r#"" a"|"\u0000"|1|null"#),
        (
            "profile",
            r#"{"id":"P","version":1}|{"id":"P","version":4294967295}|{"id":"P","version":4294967296}|
            {"id":"P","version":true}|{"id":"P","version":1.0}|{"id":"P","version":null}|{"id":"P"}|
            {"id":"P","version":1,"x":1}|["P",1]|"P"|null|{}"#,
        ),
        ("spindle_speed_rpm", r#"2500|2500.5|-0.0|0|true|"2500"|null|1e999|NaN|[1]"#),
        ("outcome", r#""completed"|"aborted"|""|null|true"#),
        ("reference_cycle", r#"true|false|null|0|1|1.0|"true"|[]"#),
        (
            "reported",
            r#"{}|null|[]|0|false|""|{"energy_joules":1}|{"energy_joules":null}|{"energy_joules":true}|
            {"energy_joules":"1"}|{"energy_joules":Infinity}|{"joules":1}|[["energy_joules",1]]|{"energy_joules":-0.0}"#,
        ),
        (
            "samples",
            r#"null|{}|[]|5|"x"|[["period_ms",10],["depth_mm",[1]]]|{"period_ms":10}|{"depth_mm":[1]}|
            {"period_ms":null,"depth_mm":[1]}|{"period_ms":null,"time_ms":[0],"depth_mm":[1]}|
            {"period_ms":10,"time_ms":null,"depth_mm":[1]}|{"period_ms":10,"time_ms":[0],"depth_mm":[1]}|
            {"period_ms":true,"depth_mm":[1]}|{"period_ms":"10","depth_mm":[1]}|{"time_ms":"0","depth_mm":[1]}|
            {"time_ms":[0,1e0],"depth_mm":[1,2]}|{"time_ms":[0,"1"],"depth_mm":[1,2]}|{"time_ms":{},"depth_mm":[1]}|
            {"period_ms":10,"depth_mm":["1","2"]}|{"period_ms":10,"depth_mm":"12"}|{"period_ms":10,"depth_mm":12}|
            {"period_ms":10,"depth_mm":[true,false]}|{"period_ms":10,"depth_mm":[1,null]}|
            {"period_ms":10,"depth_mm":[NaN]}|{"period_ms":10,"depth_mm":[1e999]}|{"period_ms":10,"depth_mm":[]}|
            {"period_ms":10,"depth_mm":{"0":1}}|{"period_ms":10,"depth_mm":null}|{"period_ms":10,"depth_mm":[[1]]}|
            {"period_ms":10,"depth_mm":[1],"thrust_newtons":[1,2]}|{"period_ms":10,"depth":[1]}|
            {"period_ms":10,"depth_mm":[9007199254740993]}|{"period_ms":10,"depth_mm":[-0.0,0.1,1e-12]}|
            {"period_ms":10,"depth_mm":[1],"depth_mm":[1]}"#,
        ),
        ("zzz", "1|null"),
    ] {
        lines.extend(values.split('|').map(|value| with(field, value.trim())));
    }
    let (mut random, whole) = (Random(0xE0C0DE), seeds());
    for _ in 0..1000 {
        lines.extend(whole.iter().map(|seed| mutated(seed, &mut random)));
        let mut time = mutated(b"2026-05-04T06:00:00.25+02:00", &mut random);
        time.retain(|byte| byte.is_ascii() && *byte != b'"');
        lines.push(with("started_at", &format!("\"{}\"", String::from_utf8(time).unwrap())));
    }
    // One to a line, for Python.
    lines.iter_mut().flatten().filter(|byte| **byte == b'\n').for_each(|byte| *byte = b' ');
    let machine = "M1".try_into().unwrap();
    let decoded = |body: &[u8]| body::decode(&machine, body, MOST, LATE);
    let frames = encoded_by_python(&lines);
    assert_eq!(frames.len(), lines.len());
    let (mut taken, mut refused) = (0, 0);
    for (json, frame) in lines.iter().zip(frames) {
        let by_json = decoded(json);
        let by_python = frame.as_deref().map(decoded);
        match &by_json {
            Ok(cycle) => {
                taken += 1;
                assert_eq!(by_python, Some(Ok(cycle.clone())), "{}", json.escape_ascii());
            }
            Err(_) => {
                refused += 1;
                assert!(!matches!(by_python, Some(Ok(_))), "{by_json:?}: {}", json.escape_ascii());
            }
        }
    }
    assert!(taken > 150 && refused > 1000, "both happen: {taken} taken, {refused} refused");
}

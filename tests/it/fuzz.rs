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

//! What each step of a post costs by itself, in this process: reading the body, summing up, hash and blocks, answer.

use super::data::{self, Cycle};
use feedwright_core::machine::{FeedDriveRating, FeedLimits, LoadReference, Machine, SpindleRating};
use feedwright_core::summary::{Context, summarise};
use feedwright_core::units::Timestamp;
use feedwright_server::ingest::body;
use feedwright_store::{codec, wire};
use std::hint::black_box;
use std::time::Instant;

/// Cycles that every step is measured on.
const CYCLES: usize = 1000;
/// Rounds, the best of which counts: what is slower was disturbed.
const ROUNDS: usize = 7;

/// Measures every step whose name has `part` in it and prints it, in µs a cycle.
pub(crate) fn measure(part: &str) {
    let cycles = data::cycles(CYCLES);
    let values: usize = cycles.iter().map(Cycle::values).sum();
    println!("{CYCLES} cycles of {} values on average, µs a cycle, best of {ROUNDS}", values / CYCLES);
    let now = Timestamp::from_micros(i64::MAX / 2);
    let bodies: Vec<Vec<u8>> = cycles.iter().map(|cycle| cycle.json().into_bytes()).collect();
    let frames: Vec<Vec<u8>> = cycles.iter().map(Cycle::frame).collect();
    let read = |index: usize, body: &[u8]| {
        let machine = cycles[index].machine.as_str().try_into().expect("an id");
        body::decode_with_places(&machine, body, 10_000, now).expect("a cycle")
    };
    let (decoded, places): (Vec<_>, Vec<_>) =
        frames.iter().enumerate().map(|(index, frame)| read(index, frame)).unzip();
    let machine = machine();
    let context = Context { machine: &machine, calibration: None, operation: None };
    let encoded: Vec<_> = decoded.iter().map(codec::encode).collect();
    let tell = |what: &str, step: &dyn Fn(usize)| {
        if what.contains(part) {
            tell(what, step);
        }
    };
    tell("JSON to a cycle", &|index| drop(black_box(read(index, &bodies[index]))));
    tell("JSON to a cycle, by serde", &|index| {
        let machine = cycles[index].machine.as_str().try_into().expect("an id");
        drop(black_box(body::decode_by_serde(&machine, &bodies[index], 10_000, now)));
    });
    tell("frame to a cycle", &|index| drop(black_box(read(index, &frames[index]))));
    tell("summary with its digest", &|index| drop(black_box(summarise(&decoded[index], context))));
    tell("content hash", &|index| {
        black_box(codec::content_hash(&decoded[index]));
    });
    tell("content hash and block", &|index| drop(black_box(codec::encode(&decoded[index]))));
    let habits = codec::Habits::default();
    tell("the same by habit", &|index| drop(black_box(habits.encode(&decoded[index], places[index]))));
    tell("block to samples", &|index| {
        let block = encoded[index].samples.as_deref().expect("samples");
        drop(black_box(codec::decode_samples(block, 10_000)));
    });
    tell("cycle to a frame", &|index| drop(black_box(wire::encode(&decoded[index]))));
}

fn tell(what: &str, step: &dyn Fn(usize)) {
    let mut best = f64::INFINITY;
    for _ in 0..ROUNDS {
        let begun = Instant::now();
        (0..CYCLES).for_each(step);
        best = best.min(begun.elapsed().as_secs_f64());
    }
    #[expect(clippy::cast_precision_loss, reason = "a figure for a table")]
    let each = best * 1e6 / CYCLES as f64;
    println!("  {what}: {each:.1}");
}

/// A machine with its ratings, so that energy is told and digested.
fn machine() -> Machine {
    Machine {
        id: "M0".try_into().expect("an id"),
        name: "machine".to_owned(),
        control: "sinumerik-840d".to_owned(),
        ipo_period_ms: 10.0,
        spindle: SpindleRating {
            reference: LoadReference::RatedPower,
            rated_power_watts: Some(7000.0),
            base_speed_rpm: None,
        },
        feed_drive: FeedDriveRating {
            reference: LoadReference::RatedTorque,
            rated_thrust_newtons: Some(5000.0),
        },
        limits: FeedLimits::new(1.0, 5000.0, 5.0, 200.0).expect("limits"),
    }
}

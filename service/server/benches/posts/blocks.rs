//! What blocks of many cycles would save: the samples of each machine's cycles encoded one by one, and many at a time.

use super::data::{self, Cycle};
use feedwright_core::cycle::{Samples, TimeBase};
use feedwright_core::units::Timestamp;
use feedwright_server::ingest::body;
use feedwright_store::codec;
use std::collections::HashMap;

/// Cycles whose samples are encoded.
const CYCLES: usize = 4_000;
/// Cycles of one machine in a block.
const IN_A_BLOCK: [usize; 4] = [1, 5, 20, 100];

/// Encodes, and prints bytes per value for each size of a block.
#[expect(clippy::cast_precision_loss, reason = "figures for a table")]
pub(crate) fn measure() {
    let cycles = data::cycles(CYCLES);
    let values: usize = cycles.iter().map(Cycle::values).sum();
    let machines: Vec<Vec<&Cycle>> = (0..data::MACHINES)
        .map(|machine| cycles.iter().skip(machine).step_by(data::MACHINES).collect())
        .collect();
    println!("{CYCLES} cycles, {values} values, of {} machines; bytes per value", data::MACHINES);
    for size in IN_A_BLOCK {
        let blocks = machines.iter().flat_map(|cycles| cycles.chunks(size));
        let bytes: usize = blocks.map(|cycles| codec::encode_samples(&joined(cycles)).len()).sum();
        println!("  {size} cycles in a block: {:.4}", bytes as f64 / values as f64);
    }
    let habits = codec::Habits::default();
    let by_habit = cycles
        .iter()
        .map(|cycle| habits.encode(&read(cycle), codec::Places::default()).samples.expect("a block").len());
    println!("  one by one, by habit: {:.4}", by_habit.sum::<usize>() as f64 / values as f64);
    let bits: f64 = machines.iter().map(|cycles| entropy(&joined(cycles))).sum();
    println!(
        "  entropy of what each value is off its prediction, every machine known before: {:.4}",
        bits / 8.0 / values as f64
    );
}

fn read(cycle: &Cycle) -> feedwright_core::cycle::Cycle {
    let machine = cycle.machine.as_str().try_into().expect("an id");
    let now = Timestamp::from_micros(i64::MAX / 2);
    body::decode(&machine, cycle.json().as_bytes(), 10_000, now).expect("a cycle")
}

/// The samples of several cycles as if they were those of one.
fn joined(cycles: &[&Cycle]) -> Samples {
    let mut columns = Vec::new();
    for cycle in cycles {
        let read = read(cycle);
        let samples = read.samples.as_ref().expect("samples");
        if columns.is_empty() {
            columns.extend(samples.columns().map(|(channel, _)| (channel, Vec::new())));
        }
        for ((_, all), (_, values)) in columns.iter_mut().zip(samples.columns()) {
            all.extend_from_slice(values);
        }
    }
    Samples::new(TimeBase::Period { period_ms: 10.0 }, columns, usize::MAX).expect("samples")
}

/// Bits that the residuals of every column hold by Shannon's formula over their frequencies, each column by the best
/// one of three predictions: the value before, the line through the two before, and their mean.
#[expect(clippy::cast_possible_truncation, reason = "small decimals")]
fn entropy(samples: &Samples) -> f64 {
    let of = |residuals: &mut dyn Iterator<Item = i64>| {
        let (mut seen, mut all) = (HashMap::<i64, f64>::new(), 0.0);
        for residual in residuals {
            *seen.entry(residual).or_default() += 1.0;
            all += 1.0;
        }
        seen.values().map(|count| -count * (count / all).log2()).sum::<f64>()
    };
    let columns = samples.columns().map(|(_, values)| {
        let integers: Vec<i64> = values.iter().map(|value| (value * 1000.0).round() as i64).collect();
        let last = of(&mut integers.windows(2).map(|w| w[1] - w[0]));
        let line = of(&mut integers.windows(3).map(|w| w[2] - 2 * w[1] + w[0]));
        let mean = of(&mut integers.windows(3).map(|w| w[2] - (w[1] + w[0]) / 2));
        last.min(line).min(mean)
    });
    columns.sum()
}

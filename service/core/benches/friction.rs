//! Time per step of the friction law and per cycle of the process model; prints, never fails on time.
//!
//! `cargo bench -p feedwright-core --bench friction`. Medians of nine runs on whatever machine this is, in seconds of CPU
//! where the system tells them (Linux), so that what else runs there does not count; else in seconds by the clock.

use feedwright_core::friction::law::{LawConfig, LawParams, LawSample, LawState};
use feedwright_core::friction::noise::Noise;
use feedwright_core::friction::stages::{StageConfig, StageDetector, StageSample};
use feedwright_core::friction::twin::{
    CycleSetup, PAPER_SPINDLE_RPM, PaperStrategies, Twin, TwinInput, TwinParams, TwinState, paper_params,
    typical_noise,
};
use std::hint::black_box;
use std::time::Instant;

const RUNS: usize = 9;

/// Seconds of CPU that this thread has had.
fn cpu_s() -> Option<f64> {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds: f64 = told.split_whitespace().next()?.parse().ok()?;
    Some(nanoseconds * 1e-9)
}

/// Median seconds per item of `RUNS` runs, with the fastest and slowest.
fn measure(items: u32, mut run: impl FnMut()) -> (f64, f64, f64) {
    let mut seconds: Vec<f64> = (0..RUNS)
        .map(|_| {
            let (start, cpu) = (Instant::now(), cpu_s());
            run();
            let spent = cpu.zip(cpu_s()).map(|(before, after)| after - before);
            spent.unwrap_or_else(|| start.elapsed().as_secs_f64()) / f64::from(items)
        })
        .collect();
    seconds.sort_by(f64::total_cmp);
    (seconds[RUNS / 2], seconds[0], seconds[RUNS - 1])
}

fn report(what: &str, (median, fastest, slowest): (f64, f64, f64)) {
    let nanoseconds = |seconds: f64| seconds * 1e9;
    println!(
        "{what:<44} {:>10.1} ns ({:.1} to {:.1}), {:>12.0} per s",
        nanoseconds(median),
        nanoseconds(fastest),
        nanoseconds(slowest),
        1.0 / median
    );
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut noise = Noise::seeded(1);
    let count = 1_000_000_u32;
    let samples: Vec<LawSample> = (0..count)
        .map(|k| LawSample {
            time_ms: f64::from(k) * 10.0,
            contact_ms: Some(f64::from(k) * 10.0),
            depth_mm: Some(f64::from(k) * 0.01),
            feed_drive_percent: Some(28.0 + 4.0 * noise.normal()),
            spindle_percent: Some(36.0 + 4.0 * noise.normal()),
        })
        .collect();
    let config = LawConfig::new(LawParams::paper(30.0, 40.0)?)?;
    let law = measure(count, || {
        let mut state = LawState::new();
        for sample in &samples {
            black_box(state.step(&config, black_box(sample)));
        }
    });
    report("law, one sample", law);

    let stage_config = StageConfig::default();
    let stages = measure(count, || {
        let mut detector = StageDetector::new();
        for (k, sample) in samples.iter().enumerate() {
            let depth_mm = if k % 2000 == 0 { -1.0 } else { (k % 2000) as f64 * 0.01 };
            black_box(detector.step(
                &stage_config,
                &StageSample {
                    depth_mm,
                    feed_drive_percent: sample.feed_drive_percent.unwrap_or(0.0),
                    spindle_percent: sample.spindle_percent.unwrap_or(0.0),
                },
            ));
            if k % 2000 == 1999 {
                detector = StageDetector::new();
            }
        }
    });
    report("stage detector, one sample", stages);

    let quiet = Twin::new(paper_params())?;
    let noisy = Twin::new(TwinParams { noise: typical_noise(), ..paper_params() })?;
    let steps = 200_000_u32;
    let mut failed = false;
    let line = measure(steps, || {
        let Ok(mut state) = TwinState::new(0.0) else { return };
        for k in 0..steps {
            let depth_mm = f64::from(k % 1000) * 0.02;
            let input = TwinInput { depth_mm, feed_mm_min: 120.0, spindle_rpm: 2800.0, dt_s: 0.01 };
            failed |= black_box(quiet.step(&mut state, &input, None)).is_err();
        }
    });
    report("twin, one checked step", line);

    let strategies = PaperStrategies::new()?;
    let setup = CycleSetup::new(PAPER_SPINDLE_RPM, 0.0);
    let cycles = 200_u32;
    for strategy in strategies.all() {
        for (what, twin) in [("quiet", &quiet), ("noisy", &noisy)] {
            let figures = measure(cycles, || {
                for seed in 0..cycles {
                    let mut random = Noise::seeded(u64::from(seed));
                    let noise = (what == "noisy").then_some(&mut random);
                    failed |= black_box(twin.drill(strategy, &setup, noise, |_| {})).is_err();
                }
            });
            report(&format!("twin, one {} cycle, {what}", strategy.name), figures);
        }
    }
    if failed { Err("a step or a cycle was refused".into()) } else { Ok(()) }
}

//! Time of a full map of the continuity process and of the controller's step; gates nothing.

use std::hint::black_box;
use std::num::NonZeroUsize;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use feedwright_core::vibratory::continuity::{
    ContinuityControl, MapAxis, MapInput, MapQuestion, ProcessInput, run_map,
};
use feedwright_core::vibratory::peak_to_peak::{
    Controller, ControllerInput, ControllerSettings, VibrationSample,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut controller = Controller::new(ControllerSettings::new(ControllerInput::IVANOV_2024)?);
    let samples: Vec<VibrationSample> = (0..1_000_000)
        .map(|j| {
            let phase = f64::from(j) * 0.15;
            VibrationSample { velocity_mm_s: 13.0 * phase.cos(), acceleration_mm_s2: -6000.0 * phase.sin() }
        })
        .collect();
    let start = Instant::now();
    for sample in &samples {
        black_box(controller.step(*sample))?;
    }
    println!("peak-to-peak controller: {:?} per million steps", start.elapsed());

    let workers = std::thread::available_parallelism()?.min(NonZeroUsize::new(2).ok_or("two")?);
    for (name, control) in [("free", None), ("controlled", Some(ContinuityControl::GOUSKOV_2015))] {
        let question = MapQuestion::new(MapInput {
            frequency_ratio: MapAxis { min: 1.0, max: 2.0, count: 101 },
            cutting_coefficient: MapAxis { min: 0.02, max: 0.6, count: 101 },
            process: ProcessInput::gouskov_2015(1.0, 0.1, control),
        })?;
        let start = Instant::now();
        let map = run_map(&question, workers, &|_, _| {}, &AtomicBool::new(false))?;
        let elapsed = start.elapsed();
        let segmented =
            map.points.iter().filter(|point| point.is_ok_and(|steady| steady.segmented())).count();
        println!(
            "map 101x101, 500 periods, {name}, {workers} workers: {elapsed:?} ({segmented} points segment)"
        );
    }
    Ok(())
}

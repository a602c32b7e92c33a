//! Time of a tool table's plunge feeds and of the contact detector; gates nothing.

use std::hint::black_box;
use std::time::Instant;

use feedwright_core::contact::{ContactDetector, ContactInput, ContactSample, ContactSettings};
use feedwright_core::plunge::{
    Drill, DrillInput, DrillingLaw, Machine, MachineInput, Material, MaterialInput, plunge_feeds,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let law = DrillingLaw { coefficient: 680.0, diameter_exponent: 1.0, feed_exponent: 0.7, correction: 1.0 };
    let material = Material::new(MaterialInput { name: "steel".into(), thrust: law, torque: law })?;
    let machine = Machine::new(MachineInput { least_feed_mm_min: 1.0, greatest_feed_mm_min: 10_000.0 })?;
    let drills = (1..=1000)
        .map(|i| {
            Drill::new(DrillInput {
                diameter_mm: 0.02 * f64::from(i),
                length_mm: f64::from(i),
                spindle_rpm: 3000.0,
                modulus_n_mm2: None,
                shear_strength_n_mm2: None,
            })
        })
        .collect::<Result<Vec<_>, _>>()?;
    let start = Instant::now();
    black_box(plunge_feeds(&drills, &material, &machine, None)?);
    println!("plunge feeds of 1000 drills: {:?}", start.elapsed());

    let mut detector = ContactDetector::new(ContactSettings::new(ContactInput::DEFAULT)?);
    let start = Instant::now();
    for i in 0..1_000_000_u32 {
        let load_percent = Some(8.0 + f64::from(i % 7) * 0.1);
        let sample = ContactSample { position_mm: f64::from(i) * 1e-3, feed_mm_min: 600.0, load_percent };
        black_box(detector.step(black_box(sample)));
    }
    println!("contact detector: {:?} per million samples", start.elapsed());
    Ok(())
}

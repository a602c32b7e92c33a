//! Contact, breakthrough and the stages A to D of a hole, found from the drive loads alone.
//!
//! Stryczek & Błaszczak 2020, section 2: the stages are bounded by what the tool feels, not by its geometry,
//! because the bounds move as it wears. A ends at the largest thrust (feed-drive load), B at the largest torque
//! (spindle load); in C, the idle travel of a long tool, both fall sharply; in D both rise again while the
//! collar forms the flange. The spindle's load peak while it spins up comes before contact and is no stage:
//! contact is found from the feed drive alone.
//!
//! The detector is a stream: it takes a sample at a time, so that a hole in two parts gives the same stages as
//! in one piece. A boundary can only be known after it has passed; its mark points back to where it was.

mod average;
mod config;
mod detect;
#[cfg(test)]
mod tests;

pub use config::{LONGEST_SMOOTHING, StageConfig, StageParams};
pub use detect::{Mark, Stage, StageDetector, StageSample, Stages};

use super::error::{Invalid, same_length};

/// Finds the stages of a whole recording; the columns have one entry per IPO cycle and equal lengths.
///
/// Depth in mm, loads in percent of their ratings. Samples that are not finite are skipped.
///
/// # Errors
/// When the columns differ in length.
pub fn find_stages(
    config: &StageConfig,
    depth_mm: &[f64],
    feed_drive_percent: &[f64],
    spindle_percent: &[f64],
) -> Result<Stages, Invalid> {
    same_length(&[
        ("depth_mm", depth_mm),
        ("feed_drive_percent", feed_drive_percent),
        ("spindle_percent", spindle_percent),
    ])?;
    let mut detector = StageDetector::new();
    for ((&depth_mm, &feed_drive_percent), &spindle_percent) in
        depth_mm.iter().zip(feed_drive_percent).zip(spindle_percent)
    {
        detector.step(config, &StageSample { depth_mm, feed_drive_percent, spindle_percent });
    }
    Ok(detector.stages())
}

//! Operations: what is machined, with which feed and set loads.

mod dated;

pub use dated::{Ask, DatedOperation, asked_at};

use crate::field_error::FieldError;
use crate::ids::OperationId;
use crate::invalid::{Range, Violation};
use crate::machine::{FEED_RANGE, SPEED_RANGE};
use crate::plunge::PlungeSetup;
use crate::turning::TurningSetup;
use crate::units::Process;

/// Depths and thicknesses.
pub const LENGTH_RANGE: Range = Range::new(0.001, 100_000.0, "mm");
/// Set loads.
pub const SET_LOAD_RANGE: Range = Range::new(0.1, 400.0, "%");
/// Feeds of reference cycles; a tool that does not move drills no reference.
pub const REFERENCE_FEED_RANGE: Range = Range::new(0.1, 100_000.0, "mm/min");
/// Cycles that a baseline may ask for; a tool that lasts 10 000 holes deserves 100.
pub const BASELINE_CYCLES: std::ops::RangeInclusive<u32> = 3..=500;
/// Cycles that the level's window may hold.
pub const WINDOW_CYCLES: std::ops::RangeInclusive<u32> = 3..=500;

/// Cycles from one reference cycle to the next.
pub const REFERENCE_EVERY_CYCLES: std::ops::RangeInclusive<u32> = 2..=100_000;

/// How the wear of tools in an operation is judged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WearSettings {
    /// Counted cycles whose median is a baseline.
    pub baseline_cycles: u32,
    /// Last counted ratios whose median is the level.
    pub window_cycles: u32,
    /// Cycles after which a reference cycle is asked for where wear cannot be told without; `None` never asks. Only
    /// friction drilling has reference cycles.
    pub reference_every_cycles: Option<u32>,
    /// Constant feed of a reference cycle, at which the limit of +10 % is meant, mm/min; the operation's programmed
    /// feed where it is left out.
    pub reference_feed_mm_min: Option<f64>,
}

impl WearSettings {
    /// Constant feed of reference cycles in a process whose operation declares `programmed_feed_mm_min`, mm/min.
    pub fn reference_feed_of(&self, process: Process, programmed_feed_mm_min: Option<f64>) -> Option<f64> {
        let feed = self.reference_feed_mm_min.or(programmed_feed_mm_min);
        feed.filter(|feed| process == Process::Friction && *feed >= REFERENCE_FEED_RANGE.min)
    }
}

impl Default for WearSettings {
    fn default() -> Self {
        Self {
            baseline_cycles: 5,
            window_cycles: 5,
            reference_every_cycles: Some(50),
            reference_feed_mm_min: None,
        }
    }
}

/// An operation as it is registered.
#[derive(Debug, Clone, PartialEq)]
pub struct Operation {
    /// Its name in every path.
    pub id: OperationId,
    /// What people call it.
    pub name: String,
    /// Which process it is: tags cycles and recommendations.
    pub process: Process,
    /// NC program.
    pub program: Option<String>,
    /// Feature within the program.
    pub feature: Option<String>,
    /// Work material.
    pub work_material: Option<String>,
    /// Thickness of the work at the hole, mm.
    pub thickness_mm: Option<f64>,
    /// Depth that a complete cycle reaches, mm; a cycle that stays short of it is incomplete.
    pub depth_mm: Option<f64>,
    /// Commanded spindle speed, rpm.
    pub spindle_speed_rpm: Option<f64>,
    /// Programmed feed rate, mm/min: what is recommended until a feed profile exists.
    pub programmed_feed_mm_min: Option<f64>,
    /// Set load L_set of the spindle drive, %.
    pub spindle_load_set_percent: Option<f64>,
    /// Set load L_set of the feed drive, %.
    pub feed_drive_load_set_percent: Option<f64>,
    /// How wear is judged.
    pub wear: WearSettings,
    /// What a turning operation needs for its next speed and feed; none leaves its program as it is.
    pub turning: Option<TurningSetup>,
    /// What a plunge operation needs for its plunge feed; none leaves its program as it is.
    pub plunge: Option<PlungeSetup>,
}

impl Operation {
    /// Constant feed of its reference cycles, mm/min, where it has any.
    pub fn reference_feed_mm_min(&self) -> Option<f64> {
        self.wear.reference_feed_of(self.process, self.programmed_feed_mm_min)
    }

    /// Checks every quantity.
    pub fn validated(self) -> Result<Self, Vec<Violation>> {
        let mut wrong = Vec::new();
        for (path, range, value) in [
            ("thickness_mm", LENGTH_RANGE, self.thickness_mm),
            ("depth_mm", LENGTH_RANGE, self.depth_mm),
            ("spindle_speed_rpm", SPEED_RANGE, self.spindle_speed_rpm),
            ("programmed_feed_mm_min", FEED_RANGE, self.programmed_feed_mm_min),
            ("wear.reference_feed_mm_min", REFERENCE_FEED_RANGE, self.wear.reference_feed_mm_min),
            ("spindle_load_set_percent", SET_LOAD_RANGE, self.spindle_load_set_percent),
            ("feed_drive_load_set_percent", SET_LOAD_RANGE, self.feed_drive_load_set_percent),
        ] {
            if let Some(value) = value {
                range.collect(path, value, &mut wrong);
            }
        }
        for (path, range, value) in [
            ("wear.baseline_cycles", BASELINE_CYCLES, Some(self.wear.baseline_cycles)),
            ("wear.window_cycles", WINDOW_CYCLES, Some(self.wear.window_cycles)),
            ("wear.reference_every_cycles", REFERENCE_EVERY_CYCLES, self.wear.reference_every_cycles),
        ] {
            if let Some(value) = value
                && !range.contains(&value)
            {
                wrong.push(Violation::new(
                    path,
                    "out_of_range",
                    format!("must be within {} to {}, is {value}", range.start(), range.end()),
                ));
            }
        }
        let mut setup = |process: Process, name: &str, check: Option<Result<(), FieldError>>| {
            let Some(checked) = check else { return };
            if self.process != process {
                let why = format!("belongs to operations of the process {}", process.as_str());
                wrong.push(Violation::new(name, "other_process", why));
            }
            if let Err(error) = checked {
                wrong.push(Violation::new(error.path_in(name), error.code(), error.problem().to_string()));
            }
        };
        setup(Process::Turning, "turning", self.turning.as_ref().map(TurningSetup::check));
        setup(Process::Plunge, "plunge", self.plunge.as_ref().map(PlungeSetup::check));
        if wrong.is_empty() { Ok(self) } else { Err(wrong) }
    }
}

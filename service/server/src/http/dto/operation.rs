//! Operations in JSON.

use super::plunge::PlungeSetupBody;
use super::text::{MAX_NAME, optional, required};
use super::turning::TurningSetupBody;
use super::word::ProcessWord;
use super::{Registered, checked};
use feedwright_core::ids::OperationId;
use feedwright_core::invalid::Violation;
use feedwright_core::operation::{Operation, WearSettings};
use feedwright_store::Versioned;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// An operation as it is registered: what is machined.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct OperationBody {
    /// What people call it.
    #[schema(example = "Bushing M8, front")]
    pub name: String,
    /// Which process it is.
    pub process: ProcessWord,
    /// NC program.
    #[serde(default)]
    pub program: Option<String>,
    /// Feature within the program.
    #[serde(default)]
    pub feature: Option<String>,
    /// Work material.
    #[serde(default)]
    pub work_material: Option<String>,
    /// Thickness of the work at the hole, mm.
    #[serde(default)]
    pub thickness_mm: Option<f64>,
    /// Depth that a complete cycle reaches, mm: with less than nine tenths of it a cycle is flagged `incomplete`. It is held against
    /// the lesser of what is asked for now and what was when it began: a deeper hole makes none of those before incomplete, and a depth that was declared too large is mended.
    #[serde(default)]
    pub depth_mm: Option<f64>,
    /// Commanded spindle speed of cycles that name none, rpm: of those that begin from now on. One that is told for the first time
    /// holds for those before as well where wear compares cycles of one speed; an energy that rests on it is told of cycles that come from then on.
    #[serde(default)]
    pub spindle_speed_rpm: Option<f64>,
    /// Programmed feed rate, mm/min.
    #[serde(default)]
    pub programmed_feed_mm_min: Option<f64>,
    /// Set load of the spindle drive, %.
    #[serde(default)]
    pub spindle_load_set_percent: Option<f64>,
    /// Set load of the feed drive, %.
    #[serde(default)]
    pub feed_drive_load_set_percent: Option<f64>,
    /// How wear is judged.
    #[serde(default)]
    pub wear: WearSettingsBody,
    /// How it is turned; makes its cycles feed the choice of the next speed and feed.
    #[serde(default)]
    pub turning: Option<TurningSetupBody>,
    /// How it plunges; makes its recommendation carry the plunge feed.
    #[serde(default)]
    pub plunge: Option<PlungeSetupBody>,
}

/// How wear is judged.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WearSettingsBody {
    /// Counted cycles whose median is a baseline.
    #[schema(minimum = 3, maximum = 500)]
    pub baseline_cycles: u32,
    /// Last counted ratios whose median is the level.
    #[schema(minimum = 3, maximum = 500)]
    pub window_cycles: u32,
    /// Cycles after which a reference cycle is asked for where wear cannot be told without; null never asks. Only
    /// friction drilling has reference cycles.
    #[schema(example = 50, minimum = 2, maximum = 100_000)]
    pub reference_every_cycles: Option<u32>,
    /// Constant feed of a reference cycle, at which the limit of +10 % is meant, mm/min; the operation's programmed
    /// feed where it is left out.
    pub reference_feed_mm_min: Option<f64>,
}

impl Default for WearSettingsBody {
    fn default() -> Self {
        WearSettings::default().into()
    }
}

impl From<WearSettings> for WearSettingsBody {
    fn from(wear: WearSettings) -> Self {
        Self {
            baseline_cycles: wear.baseline_cycles,
            window_cycles: wear.window_cycles,
            reference_every_cycles: wear.reference_every_cycles,
            reference_feed_mm_min: wear.reference_feed_mm_min,
        }
    }
}

impl From<WearSettingsBody> for WearSettings {
    fn from(wear: WearSettingsBody) -> Self {
        Self {
            baseline_cycles: wear.baseline_cycles,
            window_cycles: wear.window_cycles,
            reference_every_cycles: wear.reference_every_cycles,
            reference_feed_mm_min: wear.reference_feed_mm_min,
        }
    }
}

impl OperationBody {
    /// The operation of that id.
    pub fn into_operation(self, id: OperationId) -> Result<Operation, Vec<Violation>> {
        let mut wrong = Vec::new();
        let turning = self.turning.and_then(|setup| setup.setup().map_err(|bad| wrong.push(bad)).ok());
        let plunge = self.plunge.and_then(|setup| setup.setup().map_err(|bad| wrong.push(bad)).ok());
        let operation = Operation {
            id,
            name: required("name", &self.name, MAX_NAME, &mut wrong),
            process: self.process.0,
            program: optional("program", self.program.as_deref(), MAX_NAME, &mut wrong),
            feature: optional("feature", self.feature.as_deref(), MAX_NAME, &mut wrong),
            work_material: optional("work_material", self.work_material.as_deref(), MAX_NAME, &mut wrong),
            thickness_mm: self.thickness_mm,
            depth_mm: self.depth_mm,
            spindle_speed_rpm: self.spindle_speed_rpm,
            programmed_feed_mm_min: self.programmed_feed_mm_min,
            spindle_load_set_percent: self.spindle_load_set_percent,
            feed_drive_load_set_percent: self.feed_drive_load_set_percent,
            wear: self.wear.into(),
            turning,
            plunge,
        };
        checked(operation, wrong, Operation::validated)
    }
}

impl From<Versioned<Operation>> for Registered<OperationBody> {
    fn from(stored: Versioned<Operation>) -> Self {
        let operation = stored.value;
        let body = OperationBody {
            name: operation.name,
            process: ProcessWord(operation.process),
            program: operation.program,
            feature: operation.feature,
            work_material: operation.work_material,
            thickness_mm: operation.thickness_mm,
            depth_mm: operation.depth_mm,
            spindle_speed_rpm: operation.spindle_speed_rpm,
            programmed_feed_mm_min: operation.programmed_feed_mm_min,
            spindle_load_set_percent: operation.spindle_load_set_percent,
            feed_drive_load_set_percent: operation.feed_drive_load_set_percent,
            wear: operation.wear.into(),
            turning: operation.turning.map(Into::into),
            plunge: operation.plunge.map(Into::into),
        };
        Self::of(operation.id.as_str(), (stored.version, stored.updated_at, stored.is_damaged), body)
    }
}

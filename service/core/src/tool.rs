//! Tools: one physical tool each, with the events that begin and shape its lives.

use crate::ids::{CycleId, MachineId, ToolId};
use crate::invalid::{Range, Violation};
use crate::units::Timestamp;

/// Diameters of drills, taps and inserts.
pub const DIAMETER_RANGE: Range = Range::new(0.01, 10_000.0, "mm");

/// One physical tool.
#[derive(Debug, Clone, PartialEq)]
pub struct Tool {
    /// Its name in every path.
    pub id: ToolId,
    /// What people call it.
    pub name: String,
    /// The maker's serial number, where it differs from the id.
    pub serial: Option<String>,
    /// Kind of tool: tools of one type may share feed profiles.
    pub tool_type: String,
    /// Diameter, mm.
    pub diameter_mm: Option<f64>,
}

impl Tool {
    /// Checks the geometry.
    pub fn validated(self) -> Result<Self, Vec<Violation>> {
        let mut wrong = Vec::new();
        if let Some(diameter) = self.diameter_mm {
            DIAMETER_RANGE.collect("diameter_mm", diameter, &mut wrong);
        }
        if wrong.is_empty() { Ok(self) } else { Err(wrong) }
    }
}

/// What happened to a tool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ToolEventKind {
    /// A new tool was mounted: a life begins, its first cycles are the baseline.
    MountedNew,
    /// A tool that has worked before was mounted: a life begins without a new-tool baseline.
    MountedUsed,
    /// The tool was replaced by a new one of its kind under the same id: a life begins.
    Changed,
    /// The tool was reground: a life begins with a baseline of its own.
    Reground,
    /// An engineer resets the tool's history, with a reason: a life begins.
    Reset,
    /// An engineer confirms that conditions changed (thickness, program): wear so far is carried over.
    ConditionsConfirmed,
}

impl ToolEventKind {
    /// Every kind, in the order of the enum.
    pub const ALL: [Self; 6] = [
        Self::MountedNew,
        Self::MountedUsed,
        Self::Changed,
        Self::Reground,
        Self::Reset,
        Self::ConditionsConfirmed,
    ];

    /// The word used in the API and in storage.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::MountedNew => "mounted_new",
            Self::MountedUsed => "mounted_used",
            Self::Changed => "changed",
            Self::Reground => "reground",
            Self::Reset => "reset",
            Self::ConditionsConfirmed => "conditions_confirmed",
        }
    }

    /// The kind of that word.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.as_str() == text)
    }

    /// Whether a life begins with it.
    pub const fn begins_life(self) -> bool {
        !matches!(self, Self::ConditionsConfirmed)
    }

    /// Whether it puts a tool to work that was not there before; a change, a regrind or a reset follows a life.
    pub const fn mounts(self) -> bool {
        matches!(self, Self::MountedNew | Self::MountedUsed)
    }

    /// Whether the first cycles of the life it begins show a tool without wear.
    pub const fn starts_unworn(self) -> bool {
        !matches!(self, Self::MountedUsed)
    }
}

/// An event of a tool. It takes effect with the first cycle that it names, or at its time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ToolEvent {
    /// What happened.
    pub kind: ToolEventKind,
    /// When, by the shop's clock.
    pub at: Timestamp,
    /// The first cycle it covers, where that is known.
    pub first_cycle: Option<(MachineId, CycleId)>,
    /// Why; required for a reset.
    pub reason: Option<String>,
}

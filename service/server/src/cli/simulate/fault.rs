//! Faults that a simulated machine may have.

/// A fault, injected on request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fault {
    /// No work under the tool: the loads stay idle.
    AirCut,
    /// The tool breaks half-way, and stays broken until it is changed.
    BrokenTool,
    /// Thicker sheets for some cycles.
    Thickness,
    /// A body with NaN in it.
    NanBody,
    /// The same cycle posted twice.
    Duplicate,
    /// A cycle kept back and replayed later in a batch, as an edge buffer does.
    LateReplay,
}

impl Fault {
    /// Every fault.
    pub const ALL: [Self; 6] =
        [Self::AirCut, Self::BrokenTool, Self::Thickness, Self::NanBody, Self::Duplicate, Self::LateReplay];

    /// The word on the command line.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::AirCut => "air_cut",
            Self::BrokenTool => "broken_tool",
            Self::Thickness => "thickness",
            Self::NanBody => "nan_body",
            Self::Duplicate => "duplicate",
            Self::LateReplay => "late_replay",
        }
    }

    /// The fault of that word.
    pub fn parse(text: &str) -> Result<Self, String> {
        let known = Self::ALL.into_iter().find(|fault| fault.as_str() == text);
        known.ok_or_else(|| Self::ALL.map(Self::as_str).join(", "))
    }
}

//! The fold itself: baselines, level, states.

use super::facts::{CycleFacts, OrderKey};
use super::verdict::Verdict;
use crate::operation::WearSettings;
use crate::tool::ToolEventKind;

/// Version of the fold's rules and of its stored form; a stored state of another version is refolded.
pub const FOLD_VERSION: u16 = 1;

/// What the operation of a cycle says about how it is judged; `None` fields where it is silent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FoldSettings {
    /// Cycles of baseline and window.
    pub wear: WearSettings,
    /// Depth that a complete cycle reaches, mm.
    pub depth_mm: Option<f64>,
    /// The operation's commanded spindle speed, rpm.
    pub spindle_speed_rpm: Option<f64>,
}

/// State of the fold over one tool's cycles and events.
///
/// Feed it cycles and events in order: an event goes before the first cycle that it covers.
/// [`ToolFold::to_bytes`] and [`ToolFold::from_bytes`] keep it bit for bit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ToolFold {
    last: Option<OrderKey>,
}

impl ToolFold {
    /// The last cycle folded in.
    pub fn last(&self) -> Option<&OrderKey> {
        self.last.as_ref()
    }

    /// Applies an event that takes effect before the next cycle.
    pub fn event(&mut self, _kind: ToolEventKind) {}

    /// Folds one cycle in; `settings` is `None` where its operation is not registered.
    pub fn cycle(&mut self, facts: &CycleFacts, _settings: Option<&FoldSettings>) {
        self.last = Some(facts.order.clone());
    }

    /// What the fold says now.
    pub fn verdict(&self) -> Verdict {
        Verdict::unknown("no_cycles", "no cycle of this tool is known")
    }

    /// The state as bytes, for the store's cache.
    pub fn to_bytes(&self) -> Vec<u8> {
        Vec::new()
    }

    /// The state of those bytes; `None` where they are of another version or damaged, so that it is refolded.
    pub fn from_bytes(_bytes: &[u8]) -> Option<Self> {
        None
    }
}

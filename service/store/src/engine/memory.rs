//! What a store remembers from one group to the next, so that it need not read back what it has just written.
//!
//! Taken out for a group and put back after its commit; a group that fails loses it. Nothing in it is believed
//! without the versions that the database holds.

use super::wear::{ToolWear, Versions};
use crate::rows::ADVICE_HASH_BYTES;
use feedwright_core::ids::ToolId;
use std::collections::{HashMap, HashSet};

/// Tools whose folds are remembered, some kilobytes each; the half not used for longest makes room.
const MOST_TOOLS: usize = 1024;
/// Advices that are known to be stored.
const MOST_ADVICES: usize = 16_384;

/// What one group leaves to the next.
#[derive(Debug, Default)]
pub(in super::super) struct Memory {
    generation: i64,
    groups: u64,
    tools: HashMap<ToolId, (u64, ToolWear)>,
    advices: HashSet<[u8; ADVICE_HASH_BYTES]>,
}

impl Memory {
    /// Begins a group under that generation of the registry: of another one, no tool is remembered.
    pub(super) fn begin(&mut self, generation: i64) {
        if self.generation != generation {
            self.generation = generation;
            self.tools.clear();
        }
        self.groups += 1;
    }

    /// A tool's folds, where they are those of the versions stored.
    pub(super) fn take(&mut self, tool: &ToolId, versions: Option<&Versions>) -> Option<ToolWear> {
        let (_, wear) = self.tools.remove(tool)?;
        wear.is_of(versions).then_some(wear)
    }

    /// Remembers a tool's folds as they are stored by now.
    pub(super) fn keep(&mut self, tool: ToolId, wear: ToolWear) {
        if !wear.may_be_kept() {
            return;
        }
        if self.tools.len() >= MOST_TOOLS {
            let mut used: Vec<u64> = self.tools.values().map(|(group, _)| *group).collect();
            let middle = used.len() / 2;
            let (_, &mut middle, _) = used.select_nth_unstable(middle);
            self.tools.retain(|_, (group, _)| *group > middle);
        }
        self.tools.insert(tool, (self.groups, wear));
    }

    /// Whether an advice is not known to be stored; from now on it is.
    pub(super) fn is_new_advice(&mut self, hash: [u8; ADVICE_HASH_BYTES]) -> bool {
        if self.advices.len() >= MOST_ADVICES {
            self.advices.clear();
        }
        self.advices.insert(hash)
    }
}

//! What a store remembers from one group to the next, so that it need not read back what it has just written.
//!
//! Taken out for a group and put back after its commit; a group that fails loses it. Nothing in it is believed
//! without the versions that the database holds.

use super::registry::GroupRegistry;
use super::wear::{Heads, ToolWear, Versions};
use crate::record::NewCycle;
use crate::registry::Registry;
use crate::rows::ADVICE_HASH_BYTES;
use feedwright_core::ids::ToolId;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

/// Tools whose folds are remembered, some kilobytes each; the half not used for longest makes room.
const MOST_TOOLS: usize = 1024;
/// Advices that are known to be stored.
const MOST_ADVICES: usize = 16_384;
/// Groups that ask first after one whose assumptions did not hold: who sends again what was lost on the way sends more.
const DOUBTFUL_GROUPS: u32 = 8;

/// What one group leaves to the next.
#[derive(Debug, Default)]
pub(in super::super) struct Memory {
    generation: i64,
    /// Whether any feed profile was active when a group last asked; unknown before.
    any_profile: Option<bool>,
    doubtful: u32,
    groups: u64,
    tools: HashMap<ToolId, (u64, ToolWear)>,
    advices: HashSet<[u8; ADVICE_HASH_BYTES]>,
}

impl Memory {
    /// Begins a group under these heads: under another generation of the registry, no tool is remembered.
    pub(super) fn begin(&mut self, heads: &Heads) {
        if self.generation != heads.generation {
            self.generation = heads.generation;
            self.tools.clear();
        }
        self.any_profile = Some(heads.any_profile);
        self.groups += 1;
    }

    /// What a group rests on, where all of it is remembered: to be held against the database before it is written.
    pub(super) fn assume(
        &mut self,
        registry: &Registry,
        group: &[NewCycle],
    ) -> Option<(Heads, GroupRegistry)> {
        if self.doubtful > 0 {
            self.doubtful -= 1;
            return None;
        }
        let (generation, any_profile) = (self.generation, self.any_profile?);
        if group.iter().any(|new| new.generation.is_some_and(|told| told != generation)) {
            return None;
        }
        let registry = GroupRegistry::remembered(registry, generation, group)?;
        let mut versions = BTreeMap::new();
        for tool in group.iter().map(|new| &new.cycle.tool).collect::<BTreeSet<_>>() {
            // Nothing is counted of a tool that is not registered.
            if registry.tools.contains(tool) {
                let (_, wear) = self.tools.get(tool)?;
                versions.extend(wear.versions().map(|of_tool| (tool.clone(), of_tool)));
            }
        }
        Some((Heads { generation, any_profile, versions }, registry))
    }

    /// Forgets what a group changed here whose assumptions did not hold.
    pub(super) fn doubt(&mut self, group: &[NewCycle]) {
        for new in group {
            self.tools.remove(&new.cycle.tool);
        }
        self.advices.clear();
        self.doubtful = DOUBTFUL_GROUPS;
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

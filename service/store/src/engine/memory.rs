//! What a store remembers from one group to the next, so that it need not read back what it has just written.
//!
//! Taken out for a group and put back after its commit; a group that fails loses it. Nothing in it is believed
//! without the versions that the database holds.

use super::registry::GroupRegistry;
use super::wear::{Heads, ToolWear, Versions};
use crate::error::StoreResult;
use crate::record::{ActiveProfiles, NewCycle};
use crate::registry::Registry;
use crate::rows::{ADVICE_HASH_BYTES, Advice, AdviceBody};
use feedwright_core::ids::{OperationId, ToolId};
use feedwright_core::recommend::Recommendation;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet, VecDeque};
use std::sync::Arc;

/// Tools whose folds are remembered, some kilobytes each; the half not used for longest makes room.
const MOST_TOOLS: usize = 1024;
/// Advices that are known to be stored.
const MOST_ADVICES: usize = 16_384;
/// Advices of late that a recommendation is held against.
const MOST_GIVEN: usize = 8;
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
    /// Active feed profiles for operations with tools, under this generation.
    profiles: HashMap<(OperationId, ToolId), Arc<ActiveProfiles>>,
    advices: HashSet<[u8; ADVICE_HASH_BYTES]>,
    /// Recommendations that gave advices of late, the newest first: most are given again, to whatever tool.
    given: VecDeque<(Recommendation, Advice)>,
}

impl Memory {
    /// Begins a group under these heads: under another generation of the registry, which another server has too, no tool is
    /// remembered, nor what is stored.
    pub(super) fn begin(&mut self, heads: &Heads) {
        if self.generation != heads.generation {
            self.generation = heads.generation;
            self.tools.clear();
            self.profiles.clear();
            self.advices.clear();
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
        Some((Heads { generation, is_distributed: false, any_profile, versions }, registry))
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

    /// The active feed profiles for an operation with a tool, where they are remembered. Whoever changes which are active, or
    /// what a tool is, begins another generation, which the group is held against before it is written.
    pub(super) fn profiles(&self, operation: &OperationId, tool: &ToolId) -> Option<Arc<ActiveProfiles>> {
        if self.profiles.is_empty() {
            return None;
        }
        self.profiles.get(&(operation.clone(), tool.clone())).map(Arc::clone)
    }

    /// Remembers what was asked for under the generation of the group.
    pub(super) fn keep_profiles(
        &mut self,
        operation: &OperationId,
        tool: &ToolId,
        profiles: &Arc<ActiveProfiles>,
    ) {
        if self.profiles.len() >= MOST_TOOLS {
            self.profiles.clear();
        }
        self.profiles.insert((operation.clone(), tool.clone()), Arc::clone(profiles));
    }

    /// The advice that a recommendation gives: one of late where it is the same, which is not written and hashed again.
    pub(super) fn advice_of(&mut self, recommendation: &Recommendation) -> StoreResult<Advice> {
        let body = AdviceBody::of(recommendation);
        if let Some(at) = self.given.iter().position(|(of, _)| AdviceBody::of(of) == body)
            && let Some(given) = self.given.remove(at)
        {
            let advice = given.1.clone();
            self.given.push_front(given);
            return Ok(advice);
        }
        let advice = Advice::of(&body)?;
        self.given.truncate(MOST_GIVEN - 1);
        self.given.push_front((recommendation.clone(), advice.clone()));
        Ok(advice)
    }

    /// Whether an advice is not known to be stored; from now on it is.
    pub(super) fn is_new_advice(&mut self, hash: [u8; ADVICE_HASH_BYTES]) -> bool {
        if self.advices.len() >= MOST_ADVICES {
            self.advices.clear();
        }
        self.advices.insert(hash)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use feedwright_core::machine::FeedLimits;
    use feedwright_core::recommend::{Action, DataQuality};
    use feedwright_core::units::Timestamp;
    use feedwright_core::wear::ToolState;

    /// What differs in the advice is the feed; for whom it is, and when it was made, is no part of it.
    fn recommendation(number: i64, feed: f64) -> Recommendation {
        let id = format!("{number}");
        Recommendation {
            issued_at: Timestamp::from_micros(number),
            valid_until: Timestamp::from_micros(number + 1),
            machine: id.as_str().try_into().unwrap(),
            operation: id.as_str().try_into().unwrap(),
            tool: id.as_str().try_into().unwrap(),
            process: None,
            action: Action::Run,
            feed_mm_min: Some(feed),
            override_percent: 100.0,
            profile: None,
            limits: FeedLimits::new(1.0, 5000.0, 5.0, 200.0).unwrap(),
            spindle_load_set_percent: None,
            feed_drive_load_set_percent: None,
            tool_state: ToolState::Learning,
            level: None,
            remaining: None,
            quality: DataQuality::Good,
            data_age_ms: Some(number),
            process_advice: None,
            reference_cycle: None,
            reasons: vec![("feed".to_owned(), format!("{feed} mm/min"))],
            law_version: "1".to_owned(),
        }
    }

    #[test]
    fn an_advice_of_late_is_the_one_that_is_written_anew() {
        let mut memory = Memory::default();
        // More of them than are kept, some again at once, some when they are forgotten.
        let feeds = [1.0, 1.0, 2.0, 1.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 1.0, 9.0, 10.0, 9.0, 2.0];
        for (number, feed) in (0..).zip(feeds) {
            let recommendation = recommendation(number, feed);
            let advice = memory.advice_of(&recommendation).unwrap();
            let anew = Advice::of(&AdviceBody::of(&recommendation)).unwrap();
            assert_eq!((advice.hash, &advice.body), (anew.hash, &anew.body), "{number}");
            assert!(advice.body.contains(&format!("{feed} mm/min")), "{}", advice.body);
            assert!(memory.given.len() <= MOST_GIVEN);
        }
        let bodies: HashSet<&str> = memory.given.iter().map(|(_, advice)| &*advice.body).collect();
        assert_eq!(bodies.len(), MOST_GIVEN, "each once");
    }
}

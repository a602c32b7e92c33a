//! What is registered, kept in memory: machines with their newest lines, tools and operations, and the generation
//! that they were read under. Nothing here is trusted by itself: a group asks for the generation in force first.

use crate::record::Surroundings;
use feedwright_core::ids::{MachineId, OperationId, ToolId};
use feedwright_core::machine::{Calibration, Machine};
use feedwright_core::operation::{DatedOperation, Operation};
use feedwright_core::recommend::Damaged;
use feedwright_core::tool::Tool;
use feedwright_core::units::Timestamp;
use std::collections::HashMap;
use std::hash::Hash;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Entries of a kind that are kept; beyond them the kind is read anew. A plant has hundreds of machines.
const MOST: usize = 10_000;

/// A machine with its newest fitted lines, to decide by.
#[derive(Debug, Clone)]
pub(crate) struct KnownMachine {
    /// [`Machine::unknown`] where it is damaged.
    pub(crate) machine: Arc<Machine>,
    /// None where they are damaged.
    pub(crate) calibration: Option<Arc<Calibration>>,
    /// Which of the two is.
    pub(crate) damaged: Vec<Damaged>,
}

/// What was found of a name, to decide by.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Found<T> {
    /// It is not registered.
    Absent,
    /// It is what was written, as far as anything says.
    Sound(T),
    /// It is there, and is not what was written; as it stands, where it decodes.
    Damaged(Option<T>),
}

impl<T> Found<T> {
    pub(crate) fn map<U>(self, of: impl FnOnce(T) -> U) -> Found<U> {
        match self {
            Self::Absent => Found::Absent,
            Self::Sound(found) => Found::Sound(of(found)),
            Self::Damaged(found) => Found::Damaged(found.map(of)),
        }
    }

    pub(crate) const fn is_damaged(&self) -> bool {
        matches!(self, Self::Damaged(_))
    }

    /// What is there and sound.
    pub(crate) fn sound(self) -> Option<T> {
        match self {
            Self::Sound(found) => Some(found),
            Self::Absent | Self::Damaged(_) => None,
        }
    }
}

/// What a summary or a recommendation needs.
pub(crate) fn surroundings(
    known: &KnownMachine,
    operation: Found<Operation>,
    tool: Found<Tool>,
) -> Surroundings {
    let mut damaged = known.damaged.clone();
    if operation.is_damaged() {
        damaged.push(Damaged::Operation);
    }
    if tool.is_damaged() {
        damaged.push(Damaged::Tool);
    }
    Surroundings {
        machine: (*known.machine).clone(),
        calibration: known.calibration.as_deref().cloned(),
        operation: operation.sound(),
        tool: tool.sound(),
        damaged,
    }
}

/// What was read under one generation. Of tools and operations it is also known that there are none of a name;
/// machines that are not registered are asked for again.
#[derive(Debug, Default)]
struct Known {
    generation: i64,
    machines: HashMap<MachineId, KnownMachine>,
    operations: HashMap<OperationId, Found<Arc<DatedOperation>>>,
    tools: HashMap<ToolId, Found<Arc<Tool>>>,
}

/// The server that was asked last, and how often it was another one than before.
#[derive(Debug, Default)]
struct Asked {
    server: Option<i64>,
    others: i64,
}

/// The registry in memory, shared by everyone who uses one store.
#[derive(Debug, Default)]
pub(crate) struct Registry {
    known: Mutex<Known>,
    asked: Mutex<Asked>,
}

/// Changes of a registry are far fewer.
const CHANGES_BITS: u32 = 40;

fn keep<K: Hash + Eq, V>(map: &mut HashMap<K, V>, key: K, value: V) {
    if map.len() >= MOST {
        map.clear();
    }
    map.insert(key, value);
}

impl Registry {
    fn at(&self, generation: i64) -> Option<MutexGuard<'_, Known>> {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if known.generation < generation {
            *known = Known { generation, ..Known::default() };
        }
        // A slow reader of an older generation has nothing to add to a newer one.
        (known.generation == generation).then_some(known)
    }

    /// The generation of so many changes that a server tells of, which is the same after no other server was asked meanwhile. One
    /// that has taken over may lack the last commits of the one before, and counts up to the same numbers with other content.
    pub(crate) fn generation(&self, server: i64, changes: i64) -> i64 {
        let mut asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner);
        if asked.server.replace(server).is_some_and(|before| before != server) {
            asked.others += 1;
        }
        (asked.others << CHANGES_BITS) + changes
    }

    /// Everything around a cycle that began at a time, and the generation it belongs to, where all of it is here.
    pub(crate) fn around(
        &self,
        machine: &MachineId,
        operation: &OperationId,
        tool: &ToolId,
        at: Timestamp,
    ) -> Option<(Surroundings, i64)> {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let found = known.machines.get(machine)?.clone();
        let operation = known.operations.get(operation)?.clone();
        let tool = known.tools.get(tool)?.clone();
        let generation = known.generation;
        drop(known);
        let operation = operation.map(|operation| operation.at(at).into_owned());
        let tool = tool.map(|tool| (*tool).clone());
        Some((surroundings(&found, operation, tool), generation))
    }

    pub(crate) fn machine(&self, generation: i64, id: &MachineId) -> Option<KnownMachine> {
        self.at(generation)?.machines.get(id).cloned()
    }

    pub(crate) fn operation(&self, generation: i64, id: &OperationId) -> Option<Found<Arc<DatedOperation>>> {
        self.at(generation)?.operations.get(id).cloned()
    }

    pub(crate) fn tool(&self, generation: i64, id: &ToolId) -> Option<Found<Arc<Tool>>> {
        self.at(generation)?.tools.get(id).cloned()
    }

    pub(crate) fn learn_machine(&self, generation: i64, id: &MachineId, machine: KnownMachine) {
        if let Some(mut known) = self.at(generation) {
            keep(&mut known.machines, id.clone(), machine);
        }
    }

    pub(crate) fn learn_operation(
        &self,
        generation: i64,
        id: &OperationId,
        operation: Found<Arc<DatedOperation>>,
    ) {
        if let Some(mut known) = self.at(generation) {
            keep(&mut known.operations, id.clone(), operation);
        }
    }

    pub(crate) fn learn_tool(&self, generation: i64, id: &ToolId, tool: Found<Arc<Tool>>) {
        if let Some(mut known) = self.at(generation) {
            keep(&mut known.tools, id.clone(), tool);
        }
    }

    /// Forgets everything: this server has just changed the registry.
    pub(crate) fn forget(&self) {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        *known = Known { generation: known.generation, ..Known::default() };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_one_server_was_asked_for_is_not_of_another_ones_generation() {
        let registry = Registry::default();
        let tool: ToolId = "T1".try_into().unwrap();
        let first = registry.generation(1_700_000_000_000_000, 6);
        registry.learn_tool(first, &tool, Found::Absent);
        assert_eq!(registry.generation(1_700_000_000_000_000, 6), first);
        assert!(registry.tool(first, &tool).is_some());
        // Started before the one that it takes over from, and changed as often.
        let second = registry.generation(1_690_000_000_000_000, 6);
        assert!(second > first);
        assert!(registry.tool(second, &tool).is_none(), "asked for anew");
        registry.learn_tool(second, &tool, Found::Absent);
        assert!(registry.tool(first, &tool).is_none(), "a slow reader adds nothing");
        assert!(registry.tool(registry.generation(1_690_000_000_000_000, 7), &tool).is_none());
    }
}

//! What a change has to itself where several servers write to one database.
//!
//! A cycle that is being committed is not visible yet to the change that registers its tool or its operation, and
//! the other way round: a row lock cannot stand for a row that is not there. So both lock the subject's name.
//! Everyone takes shared locks first, then exclusive ones, each in ascending order: no two can wait for each other.
//! There are three exceptions. A changed operation holds its own name while it waits for the number of its change, which nobody holds who asks for
//! a name.
//! Whoever takes back a decision of retention, or deletes by one, asks for the partitions first, and then for that machine's decisions: whoever
//! drops a partition waits for those who read samples, and they may wait for the decisions. Whoever makes such a decision asks for the machine's decisions, and then
//! for the machine, of which what is said of retention must not change meanwhile. Nobody asks the other way round.

use feedwright_core::ids::{MachineId, OperationId, ToolId};
use std::collections::BTreeSet;

/// Names to lock until the end of the transaction.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct Locks {
    /// Held together with others that only read the subject, ascending.
    pub(crate) shared: Vec<i64>,
    /// Held alone, ascending.
    pub(crate) exclusive: Vec<i64>,
}

fn key(kind: &str, id: &str) -> i64 {
    let mut hasher = blake3::Hasher::new();
    hasher.update(kind.as_bytes()).update(b"/").update(id.as_bytes());
    let mut first = [0; 8];
    first.copy_from_slice(&hasher.finalize().as_bytes()[..8]);
    i64::from_le_bytes(first)
}

fn ascending(mut keys: Vec<i64>) -> Vec<i64> {
    keys.sort_unstable();
    keys.dedup();
    keys
}

impl Locks {
    /// One subject alone.
    pub(crate) fn subject(kind: &str, id: &str) -> Self {
        Self { shared: Vec::new(), exclusive: vec![key(kind, id)] }
    }

    /// One tool alone.
    pub(crate) fn tool(id: &ToolId) -> Self {
        Self::subject("tool", id.as_str())
    }

    /// One operation alone.
    pub(crate) fn operation(id: &OperationId) -> Self {
        Self::subject("operation", id.as_str())
    }

    /// What a group of cycles needs: its machines and operations stay as they are, its tools are folded by nobody
    /// else.
    pub(crate) fn group<'a>(
        machines: impl IntoIterator<Item = &'a MachineId>,
        operations: impl IntoIterator<Item = &'a OperationId>,
        tools: impl IntoIterator<Item = &'a ToolId>,
    ) -> Self {
        let machines = machines.into_iter().map(MachineId::as_str).collect::<BTreeSet<_>>();
        let operations = operations.into_iter().map(OperationId::as_str).collect::<BTreeSet<_>>();
        let shared = machines.into_iter().map(|id| key("machine", id));
        let shared = shared.chain(operations.into_iter().map(|id| key("operation", id)));
        Self {
            shared: ascending(shared.collect()),
            exclusive: ascending(tools.into_iter().map(|id| key("tool", id.as_str())).collect()),
        }
    }
}

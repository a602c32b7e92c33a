//! What a running cycle was begun with, and whether it still holds: a machine whose limits are tightened, a tool that is
//! changed or a feed profile that is rolled back ends the law of the cycle that runs.
//!
//! It is asked every so often, and not told: whoever changed it may have done so at another server.

use super::slots::Slot;
use crate::state::AppState;
use feedwright_core::cycle::ProfileVersion;
use feedwright_core::ids::{OperationId, ToolId};
use feedwright_core::machine::Machine;
use feedwright_core::operation::Operation;
use feedwright_core::wear::{ToolState, Verdict};
use feedwright_store::StoreResult;
use std::sync::Arc;
use std::time::Duration;

/// How often what cycles were begun with is read again.
const READ_EVERY: Duration = Duration::from_secs(2);

/// What is read around a cycle when it begins.
#[derive(Debug)]
pub struct BegunWith {
    /// The machine with its limits.
    pub machine: Machine,
    /// Id of the operation, and the operation where it is registered.
    pub operation: (OperationId, Option<Operation>),
    /// Id of the tool, and what was known of it where it is registered.
    pub tool: (ToolId, Option<KnownTool>),
    /// The feed profile that the cycle runs, where it is one that may be run.
    pub profile: Option<ProfileVersion>,
}

/// What the wear of a tool says that matters to a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KnownTool {
    life: u32,
    state: ToolState,
}

impl From<&Verdict> for KnownTool {
    fn from(verdict: &Verdict) -> Self {
        Self { life: verdict.life, state: verdict.state }
    }
}

impl KnownTool {
    /// Whether what is known now lets the law go on that was begun with this. A tool that is learnt meanwhile does, as do
    /// cycles of it that come in late.
    const fn permits(self, now: Self) -> bool {
        let stops = matches!(now.state, ToolState::Worn | ToolState::BrokenSuspected | ToolState::Changed);
        self.life == now.life && (!stops || self.state as u8 == now.state as u8)
    }
}

/// Begins to read again what running cycles were begun with, until the server stops.
pub fn start(state: &AppState) {
    let state = state.clone();
    state.lifecycle.clone().keep("reading what cycles were begun with", move || looks(state.clone()));
}

async fn looks(state: AppState) {
    let mut due = state.lifecycle.every(READ_EVERY);
    while due.next().await {
        for slot in state.streams.all() {
            look(&state, &slot).await;
        }
    }
}

/// Ends the law of a machine's running cycle where what it was begun with holds no more.
async fn look(state: &AppState, slot: &Slot) {
    let Some(begun_with) = slot.lock().cycle.as_ref().map(|cycle| cycle.begun_with.clone()) else { return };
    match holds(state, &begun_with).await {
        Ok(true) => {}
        Ok(false) => {
            // Another cycle may have begun meanwhile, with what holds now.
            if let Some(cycle) = &mut slot.lock().cycle
                && Arc::ptr_eq(&cycle.begun_with, &begun_with)
            {
                cycle.running.outdate();
            }
        }
        // A database that does not answer has answers neutral once the lease has ended.
        Err(error) => {
            tracing::warn!(machine = %slot.machine, %error, "what a cycle was begun with cannot be read");
        }
    }
}

async fn holds(state: &AppState, begun_with: &BegunWith) -> StoreResult<bool> {
    let BegunWith { machine, operation: (operation_id, operation), tool: (tool_id, tool), profile } =
        begun_with;
    let store = &state.store;
    // Not what is remembered here: another server may have changed it, which this one learns with its next commit.
    let Some(around) = store.surroundings(&machine.id, operation_id, tool_id).await? else {
        return Ok(false);
    };
    if !around.damaged.is_empty() {
        return Ok(false);
    }
    // Names are for people.
    let renamed = Machine { name: machine.name.clone(), ..around.machine };
    let name = operation.as_ref().map(|operation| operation.name.clone());
    let operation_now = around.operation.map(|now| match &name {
        Some(name) => Operation { name: name.clone(), ..now },
        None => now,
    });
    if renamed != *machine || operation_now != *operation || around.tool.is_some() != tool.is_some() {
        return Ok(false);
    }
    if let Some(tool) = tool
        && !tool.permits(KnownTool::from(&store.verdict(tool_id).await?))
    {
        return Ok(false);
    }
    match profile {
        Some(version) => {
            let active = store.active_profiles(operation_id, tool_id).await?;
            Ok(active.profiles.iter().any(|one| one.version == *version))
        }
        None => Ok(true),
    }
}

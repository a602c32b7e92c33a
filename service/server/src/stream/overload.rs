//! An overload on its way from a running cycle to the list of alarms.
//!
//! It is raised beside the answers, as a commit must not hold up an override. What follows in the machine waits for
//! it: the end of the cycle is not answered, no other cycle starts and the lease is not given back before it is
//! committed. Otherwise the next cycle would find no alarm and raise the feed of a tool that nobody has looked at.

use crate::state::AppState;
use feedwright_core::ids::{CycleId, MachineId, ToolId};
use feedwright_core::units::Timestamp;
use feedwright_store::StoreResult;
use tokio::sync::OnceCell;

/// An overload that a running cycle has seen.
#[derive(Debug)]
pub struct Overload {
    tool: ToolId,
    message: String,
    at: Timestamp,
    /// Set once it is committed.
    raised: OnceCell<()>,
}

impl Overload {
    /// An overload of a cycle with a tool, seen now.
    pub fn seen(cycle: &CycleId, tool: &ToolId, now: Timestamp) -> Self {
        let message = format!("cycle {cycle}: the load exceeded the limit of an overload");
        Self { tool: tool.clone(), message, at: now, raised: OnceCell::new() }
    }

    /// Raises it; returns once it is committed. Whoever asks while another raises it waits for that one, and tries
    /// again where that one failed. It is raised once, also where it was acknowledged since.
    ///
    /// # Errors
    ///
    /// Where it could not be committed.
    pub async fn raise(&self, state: &AppState, machine: &MachineId) -> StoreResult<()> {
        let raise = || async {
            let (machine, tool) = (machine.clone(), self.tool.clone());
            let (message, at) = (self.message.clone(), self.at);
            state
                .commit(|store| async move { store.raise_overload(&machine, &tool, &message, at).await })
                .await
                .inspect(|()| state.live.alarms_may_have_changed())
        };
        self.raised.get_or_try_init(raise).await.copied()
    }
}

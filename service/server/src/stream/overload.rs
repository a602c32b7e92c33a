//! An overload on its way from a running cycle to the list of alarms, and back once somebody has acknowledged it.
//!
//! It is raised beside the answers, as a commit must not hold up an override, and tried until it is committed, also where the
//! cycle is left or its connection gone. What follows in the machine waits for it: the end of the cycle is not answered, no
//! other cycle starts here and the lease is not given back before it is committed; at another server none starts before that ends. Otherwise the next cycle would find no alarm and raise the feed of a tool that nobody has looked at.
//!
//! Nor is a cycle freed by what is told of an alarm, which may be an earlier one and may come late: the list of alarms
//! is asked whether one is open.

use super::cycle;
use crate::state::AppState;
use feedwright_core::ids::{CycleId, MachineId, ToolId};
use feedwright_core::units::Timestamp;
use feedwright_store::StoreResult;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::OnceCell;

/// How long after the first try to raise an overload the next one is made, and at the most.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
const LONGEST_PAUSE: Duration = Duration::from_secs(15);

/// An overload that holds a running cycle.
#[derive(Debug)]
pub struct Overload {
    tool: ToolId,
    message: String,
    at: Timestamp,
    /// Whether it was open when the cycle started.
    before: bool,
    /// Set once it is committed.
    raised: OnceCell<()>,
}

impl Overload {
    /// An overload of a cycle with a tool, seen now.
    pub fn seen(cycle: &CycleId, tool: &ToolId, now: Timestamp) -> Self {
        let message = format!("cycle {cycle}: the load exceeded the limit of an overload");
        Self { tool: tool.clone(), message, at: now, before: false, raised: OnceCell::new() }
    }

    /// An overload that was open when a cycle started.
    pub fn open_before(cycle: &CycleId, tool: &ToolId, now: Timestamp) -> Self {
        Self { before: true, raised: OnceCell::new_with(Some(())), ..Self::seen(cycle, tool, now) }
    }

    /// Whether the cycle itself was overloaded: else an overload that it shows is another one, perhaps of another tool.
    pub const fn is_the_cycles(&self) -> bool {
        !self.before
    }

    /// Raises it in a task of its own, which tries until it is committed, whatever becomes of the cycle.
    pub fn raise_beside(self: Arc<Self>, state: &AppState, machine: &MachineId) {
        let (raising, machine) = (state.clone(), machine.clone());
        state.streams.raising(&machine, &self);
        state.lifecycle.spawn(async move {
            let mut pause = FIRST_PAUSE;
            loop {
                // The last try is made when the server stops.
                let is_last = raising.lifecycle.is_stopping();
                match self.raise(&raising, &machine).await {
                    Ok(()) => break,
                    Err(error) if is_last => {
                        tracing::error!(%machine, %error, "an overload could not be raised before the shutdown");
                        return;
                    }
                    Err(error) => {
                        tracing::warn!(%machine, %error, "an overload could not be raised; it is tried again");
                    }
                }
                tokio::select! {
                    () = tokio::time::sleep(pause) => {}
                    () = raising.lifecycle.stopping() => {}
                }
                pause = (2 * pause).min(LONGEST_PAUSE);
            }
            raising.streams.raised(&machine, &self);
            // It may have been acknowledged at another server, while nobody here could know that it was this one.
            settle(&raising, &machine).await;
        });
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

/// Frees a machine's running cycle where no overload of the machine is open any more. Where that cannot be read the
/// cycle stays held.
///
/// An overload that is on its way is waited for: it may be committed, and acknowledged, before its task here knows that it
/// is, and whoever has acknowledged it finds the cycle freed.
pub async fn settle(state: &AppState, machine: &MachineId) {
    let Some(slot) = state.streams.slot(machine) else { return };
    let Some(overload) = slot.lock().cycle.as_ref().and_then(|cycle| cycle.overload.clone()) else { return };
    if let Err(error) = overload.raise(state, machine).await {
        tracing::warn!(%machine, %error, "an overload could not be raised: its cycle stays held");
        return;
    }
    match cycle::overload_open(state, machine).await {
        Ok(false) => {}
        Ok(true) => return,
        Err(error) => {
            tracing::warn!(%machine, %error, "whether an overload is open cannot be read: its cycle stays held");
            return;
        }
    }
    // An overload that came meanwhile is not the one that was asked for.
    if let Some(cycle) = &mut slot.lock().cycle
        && cycle.overload.as_ref().is_some_and(|held| Arc::ptr_eq(held, &overload))
    {
        cycle.overload = None;
        cycle.running.acknowledge();
    }
}

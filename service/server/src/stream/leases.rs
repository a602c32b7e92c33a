//! Leases: prolonged together, and those that were lost.
//!
//! The database counts a lease from when it gave it, by its own clock where several servers share it. This server counts it from
//! before it asked, by a clock that nobody sets, so that what it believes in is over sooner, however far clocks are apart.

use super::slots::Slot;
use crate::clock::Moment;
use crate::state::AppState;
use feedwright_core::ids::MachineId;
use std::collections::HashMap;
use std::sync::Arc;

/// A lease is prolonged so many times before it ends.
const RENEWALS: u32 = 3;

/// Begins to prolong leases, until the server stops.
pub fn start(state: &AppState) {
    let state = state.clone();
    state.lifecycle.clone().keep("prolonging leases", move || prolong(state.clone()));
}

async fn prolong(state: AppState) {
    let mut due = state.lifecycle.every(state.config.stream.lease() / RENEWALS);
    while due.next().await {
        renew(&state, &state.streams.all()).await;
    }
}

async fn renew(state: &AppState, slots: &[Arc<Slot>]) {
    let (asked, now) = (state.clock.moment(), state.clock.now());
    let (holder, lease) = (state.streams.holder().to_owned(), state.config.stream.lease());
    // Read before the database is asked: what is connected later is not among the answers, and not lost for it.
    let connected: Vec<(Arc<Slot>, i64)> =
        slots.iter().filter_map(|slot| Some((slot.clone(), slot.connected()?))).collect();
    if connected.is_empty() {
        return;
    }
    let machines: Vec<MachineId> = connected.iter().map(|(slot, _)| slot.machine.clone()).collect();
    let renewed =
        state.commit(|store| async move { store.renew_streams(&holder, &machines, lease, now).await }).await;
    match renewed {
        Ok(renewed) => {
            let renewed: HashMap<MachineId, i64> = renewed.into_iter().collect();
            for (slot, generation) in connected {
                if renewed.get(&slot.machine).is_some_and(|held| *held >= generation) {
                    slot.prolonged(generation, believed_until(state, asked));
                } else if slot.lost(generation) {
                    tracing::info!(machine = %slot.machine, "the stream was taken over by another server");
                }
            }
        }
        // Until the lease ends it is still held; after that every answer is neutral and says so.
        Err(error) => tracing::warn!(%error, "leases on streams could not be prolonged"),
    }
}

/// Until when a lease is believed in that was asked for then: a tenth less than it lasts, as the clock of a database that is being
/// set right may go faster by nearly as much.
pub(super) fn believed_until(state: &AppState, asked: Moment) -> Moment {
    asked.plus(state.config.stream.lease() * 9 / 10)
}

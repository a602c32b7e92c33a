//! Leases: prolonged together, and those that were lost.

use super::slots::Slot;
use crate::state::AppState;
use feedwright_core::ids::MachineId;
use feedwright_core::units::Timestamp;
use std::collections::HashMap;
use std::sync::Arc;
use tokio::time::{MissedTickBehavior, interval};

/// A lease is prolonged so many times before it ends.
const RENEWALS: u32 = 3;

/// Begins to prolong leases, until the server stops.
pub fn start(state: &AppState) {
    let prolonging = prolong(state.clone());
    state.lifecycle.spawn(prolonging);
}

async fn prolong(state: AppState) {
    let mut due = interval(state.config.stream.lease() / RENEWALS);
    due.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            _ = due.tick() => {}
            () = state.lifecycle.stopping() => return,
        }
        let slots = state.streams.all();
        if !slots.is_empty() {
            renew(&state, &slots).await;
        }
    }
}

async fn renew(state: &AppState, slots: &[Arc<Slot>]) {
    let now = state.clock.now();
    let until = until(state, now);
    let holder = state.streams.holder().to_owned();
    // Read before the database is asked: what is connected later is not among the answers, and not lost for it.
    let connected: Vec<(Arc<Slot>, i64)> =
        slots.iter().filter_map(|slot| Some((slot.clone(), slot.connected()?))).collect();
    let renewed = state.commit(|store| async move { store.renew_streams(&holder, now, until).await }).await;
    match renewed {
        Ok(renewed) => {
            let renewed: HashMap<MachineId, i64> = renewed.into_iter().collect();
            for (slot, generation) in connected {
                if renewed.get(&slot.machine).is_some_and(|held| *held >= generation) {
                    slot.leased_until(until);
                } else if slot.connected() == Some(generation) {
                    tracing::info!(machine = %slot.machine, "the stream was taken over by another server");
                    slot.lost();
                }
            }
        }
        // Until the lease ends it is still held; after that every answer is neutral and says so.
        Err(error) => tracing::warn!(%error, "leases on streams could not be prolonged"),
    }
}

/// When a lease that is taken now ends.
pub(super) fn until(state: &AppState, now: Timestamp) -> Timestamp {
    now.plus_millis(i64::try_from(state.config.stream.lease_ms).unwrap_or(i64::MAX))
}

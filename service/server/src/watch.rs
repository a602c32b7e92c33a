//! The watchman: a round every few seconds over what no request asks about. Which machines fell silent, how full
//! quarantine, disk and database are, which alarms stand; into the store's alarms and into the metrics.
//!
//! Several replicas make the same round on one database: each notes the machines that it heard of, and whoever comes
//! first raises an alarm, once. The database tells them what time it is, so that all find the same.

use crate::clock::Moment;
use crate::state::AppState;
use feedwright_core::ids::MachineId;
use feedwright_store::{FleetRow, Page, StoreResult};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Machines that were heard of since the last round, with when.
#[derive(Debug, Default)]
pub struct Heard(Mutex<BTreeMap<MachineId, Moment>>);

impl Heard {
    /// Notes that a cycle of a registered machine arrived, whatever becomes of it.
    pub fn note(&self, machine: &MachineId, at: Moment) {
        let mut heard = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match heard.get_mut(machine) {
            Some(last) => *last = at.max(*last),
            None => drop(heard.insert(machine.clone(), at)),
        }
    }

    fn take(&self) -> Vec<(MachineId, Moment)> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner)).into_iter().collect()
    }

    /// Puts back what a failed round could not note.
    fn restore(&self, taken: &[(MachineId, Moment)]) {
        for (machine, at) in taken {
            self.note(machine, *at);
        }
    }
}

/// Machines whose wear one round reads: those of a large fleet take turns.
const WEAR_A_ROUND: u32 = 100;

/// The machine after which the next round reads on; none: from the first.
#[derive(Debug, Default)]
pub(crate) struct WearTurn(Mutex<Option<MachineId>>);

impl WearTurn {
    fn next(&self) -> Page<MachineId> {
        let after = self.0.lock().unwrap_or_else(PoisonError::into_inner).clone();
        Page { after, limit: WEAR_A_ROUND }
    }

    fn read(&self, rows: &[FleetRow]) {
        let full = usize::try_from(WEAR_A_ROUND).is_ok_and(|most| rows.len() >= most);
        let last = rows.last().filter(|_| full).map(|row| row.machine.value.id.clone());
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = last;
    }
}

/// Makes rounds until the shutdown begins.
pub(crate) fn start(state: &AppState) {
    let state = state.clone();
    state.lifecycle.clone().keep("watch", move || rounds(state.clone()));
}

/// Makes rounds, one after the other. Shutdown waits for the one under way: only the waiting between two is cut short.
async fn rounds(state: AppState) {
    let mut ticks = state.lifecycle.every(state.config.watch.interval());
    while ticks.next().await {
        if let Err(error) = round(&state).await {
            tracing::warn!(%error, "the watch could not make its round");
        }
    }
    // What was heard of last is not lost with the process.
    if let Err(error) = round(&state).await {
        tracing::warn!(%error, "the watch could not make its last round");
    }
}

/// One round.
pub async fn round(state: &AppState) -> StoreResult<()> {
    state.metrics.run_out(state.clock.now());
    state.metrics.ready(state.ready().await.is_ok());
    disk(state).await;
    match state.store.usage().await {
        Ok(usage) => state.metrics.database(&usage),
        Err(error) => tracing::warn!(%error, "the database's size is not known"),
    }
    let taken = state.intake.heard().take();
    let settings = state.config.watch.settings(state.config.quarantine.bounds());
    let (now, moment) = (state.clock.now(), state.clock.moment());
    // How long ago it was is the same by every clock.
    let heard = taken.iter().map(|(machine, at)| (machine.clone(), moment.since(*at))).collect();
    let found = match state.store.watch(heard, &settings, now).await {
        Ok(found) => found,
        Err(error) => {
            state.intake.heard().restore(&taken);
            state.lifecycle.heed(&error);
            return Err(error);
        }
    };
    state.metrics.round(&found, now);
    state.intake.live().alarms_may_have_changed();
    wear(state).await;
    Ok(())
}

/// The wear that the metrics show is that of this process' last cycle of a machine: what other replicas took in, what was
/// there before the start and what people say of tools is read from the database.
async fn wear(state: &AppState) {
    match state.store.fleet(state.wear_turn.next(), 1).await {
        Ok(rows) => {
            state.metrics.fleet(&rows);
            state.wear_turn.read(&rows);
        }
        Err(error) => tracing::warn!(%error, "the wear of tools is not known"),
    }
}

/// How full the file system of the data directory is; a service that keeps its data on a server has none.
async fn disk(state: &AppState) {
    let path = state.config.data_dir.clone();
    let sized = tokio::task::spawn_blocking(move || sizes(&path)).await;
    if let Ok(Some((size, available))) = sized {
        state.metrics.disk(size, available);
    }
}

/// Bytes of the file system that holds `path`, and of them those that this process may still use.
fn sizes(path: &Path) -> Option<(u64, u64)> {
    let found = rustix::fs::statvfs(path).ok()?;
    Some((found.f_blocks.saturating_mul(found.f_frsize), found.f_bavail.saturating_mul(found.f_frsize)))
}

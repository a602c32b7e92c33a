//! The end of a cycle: stored on the same way as a posted one, and answered as that.

use super::cycle::StreamedCycle;
use super::slots::{Held, Ownership, Slot};
use crate::http::dto::cycle::CycleAnswerBody;
use crate::http::problem::Problem;
use crate::ingest::intake::{Accepted, Refused};
use crate::live::{Event, MachineState};
use crate::state::AppState;
use bytes::Bytes;
use feedwright_core::ids::{CycleId, MAX_ID_LENGTH, MachineId};
use feedwright_store::{CycleOverrides, Sent, StoreResult, StreamLease, codec};
use serde_json::Value;
use std::sync::Arc;
use std::time::Duration;

/// What a machine is told of a cycle that is stored.
#[derive(Debug)]
pub struct Stored {
    /// 201 or 200.
    pub status: u16,
    /// The answer of a post.
    pub answer: Value,
}

/// A cycle that could not be stored, with the cycle where its machine may try again.
pub struct NotStored {
    /// Why.
    pub problem: Problem,
    /// The cycle, unless it was refused for good.
    pub cycle: Option<StreamedCycle>,
}

/// Stores a cycle that has ended, and its overrides beside it.
pub async fn store(
    state: &AppState,
    machine: &MachineId,
    cycle: StreamedCycle,
    outcome: Option<String>,
    reported: Option<Value>,
) -> Result<Stored, Box<NotStored>> {
    match try_store(state, machine, &cycle, outcome.as_deref(), reported.as_ref()).await {
        Ok(accepted) => {
            let answer = serde_json::to_value(CycleAnswerBody::of(&accepted)).unwrap_or_default();
            Ok(Stored { status: if accepted.new { 201 } else { 200 }, answer })
        }
        Err(problem) => {
            // A refusal for its content stands, and its body is in quarantine; everything else may pass.
            let again = !problem.members.contains_key("quarantine_id");
            Err(Box::new(NotStored { problem, cycle: again.then_some(cycle) }))
        }
    }
}

async fn try_store(
    state: &AppState,
    machine: &MachineId,
    cycle: &StreamedCycle,
    outcome: Option<&str>,
    reported: Option<&Value>,
) -> Result<Accepted, Problem> {
    if let Some(overload) = &cycle.overload {
        overload.raise(state, machine).await?;
    }
    // Before the cycle: with the cycle stored and these lost, nobody would send them again.
    keep_overrides(state, machine, &cycle.id, cycle).await?;
    let json = Bytes::from(cycle.body(cycle.id.as_str(), outcome, reported).to_string());
    if cycle.running.was_cut_short() {
        state.intake.accept_incomplete(machine, json, Refused::ToQuarantine).await
    } else {
        state.intake.accept(machine, json, Refused::ToQuarantine).await
    }
}

async fn keep_overrides(
    state: &AppState,
    machine: &MachineId,
    id: &CycleId,
    cycle: &StreamedCycle,
) -> Result<(), Problem> {
    let advice = cycle.running.record().all_advice();
    if advice.is_empty() {
        return Ok(());
    }
    let samples: Vec<(f64, u64)> =
        advice.iter().map(|advice| (advice.ovr.percent(), advice.reasons.bits())).collect();
    let sent = if cycle.meta.resend { Sent::Again } else { Sent::AsItRan };
    let kept = CycleOverrides {
        machine: machine.clone(),
        cycle: id.clone(),
        mode: cycle.running.mode().as_str().to_owned(),
        law_version: cycle.law_version.to_owned(),
        program_hash: cycle.program_hash.clone(),
        stored_at: state.clock.now(),
        block: codec::encode_overrides(&samples)?,
    };
    state.commit(|store| async move { store.put_overrides(&kept, sent).await }).await?;
    Ok(())
}

/// Whether the whole of a cycle is stored: under the same id another one may be, by a counter that has restarted.
async fn is_stored(state: &AppState, machine: &MachineId, cycle: &StreamedCycle) -> StoreResult<bool> {
    let stored = state.store.cycle(machine, &cycle.id).await?;
    Ok(stored.is_some_and(|stored| stored.cycle.started_at == cycle.started_at()))
}

/// Stores what there is of a cycle whose end never came, unless the whole of it is stored by now. It has an id of its own, so that the
/// whole cycle, from its machine's buffer, is stored under the right one later; it is flagged `incomplete` and `cut_short`, and does
/// not count.
pub async fn store_incomplete(state: &AppState, machine: &MachineId, cycle: StreamedCycle) {
    if matches!(is_stored(state, machine, &cycle).await, Ok(true)) {
        tracing::info!(%machine, cycle = %cycle.id, "a cycle was left, and is stored as a whole");
        return;
    }
    let (came, whole) = cycle.running.record().counts();
    if whole == 0 {
        tracing::info!(%machine, cycle = %cycle.id, came, "a cycle was left without a usable sample");
        return;
    }
    let Some(id) = incomplete_id(&cycle) else { return };
    let body = Bytes::from(cycle.body(id.as_str(), Some("aborted"), None).to_string());
    let kept = keep_overrides(state, machine, &id, &cycle).await;
    let stored = state.intake.accept_incomplete(machine, body, Refused::ToQuarantine).await;
    match stored {
        Ok(_) if kept.is_ok() => {
            tracing::info!(%machine, cycle = %id, whole, "a cycle was left and stored as incomplete");
        }
        Ok(_) => tracing::warn!(%machine, cycle = %id, "a cycle was left and stored without its overrides"),
        Err(problem) => {
            tracing::warn!(%machine, cycle = %id, code = problem.code, "a left cycle was not stored");
        }
    }
}

/// `<cycle_id>.incomplete-<hash>`: the same remains always get the same id.
fn incomplete_id(cycle: &StreamedCycle) -> Option<CycleId> {
    let content = cycle.body(cycle.id.as_str(), None, None).to_string();
    let hash = blake3::hash(content.as_bytes()).to_hex();
    let tail = format!(".incomplete-{}", &hash[..12]);
    // Identifiers are ASCII: cutting one between bytes is cutting it between characters.
    let head = &cycle.id.as_str()[..cycle.id.as_str().len().min(MAX_ID_LENGTH - tail.len())];
    CycleId::parse("cycle_id", &format!("{head}{tail}")).ok()
}

/// A connection is gone: gives the lease back, and waits for the machine to come back to its cycle.
pub async fn connection_gone(state: &AppState, ownership: &Ownership) {
    let slot = ownership.slot.clone();
    let tell = |held: &Held| {
        let is = if held.cycle.is_some() { MachineState::Interrupted } else { MachineState::Disconnected };
        show(state, &slot.machine, held, is);
    };
    let Some(left) = state.streams.leave(ownership, tell) else { return };
    let of_cycle = slot.lock().cycle.as_ref().and_then(|cycle| cycle.overload.clone());
    let mut raised = Ok(());
    // That of a cycle before may be on its way yet.
    for overload in of_cycle.into_iter().chain(state.streams.unraised(&slot.machine)) {
        raised = raised.and(overload.raise(state, &slot.machine).await);
    }
    match raised {
        Ok(()) => release(state, &slot, left.generation).await,
        // It is tried again beside; at another server the next cycle would find no alarm meanwhile.
        Err(error) => {
            tracing::warn!(machine = %slot.machine, %error, "an overload could not be raised: the lease is kept");
        }
    }
    if !left.cycle {
        return;
    }
    let (waiting, ownership) = (state.clone(), ownership.clone());
    state.lifecycle.spawn(async move {
        tokio::select! {
            () = tokio::time::sleep(waiting.config.stream.resume()) => {}
            () = waiting.lifecycle.stopping() => {}
        }
        let tell = |held: &Held| show(&waiting, &slot.machine, held, MachineState::Disconnected);
        let Some((cycle, charged)) = waiting.streams.take_left(&ownership, tell) else { return };
        if waiting.lifecycle.is_stopping() {
            // The machine sends everything again to whoever serves next.
            return;
        }
        settle_left(&waiting, &slot, cycle).await;
        drop(charged);
    });
}

/// A cycle that its machine did not come back to: stored as incomplete, unless the whole of it is stored.
async fn settle_left(state: &AppState, slot: &Arc<Slot>, cycle: StreamedCycle) {
    if went_elsewhere(state, slot).await && comes_elsewhere(state, &slot.machine, &cycle).await {
        tracing::info!(machine = %slot.machine, cycle = %cycle.id, "the machine went on with another server");
        return;
    }
    store_incomplete(state, &slot.machine, cycle).await;
}

/// Waits whether the whole cycle is stored by the server that its machine went on with, as long as a cycle may last: it may have
/// begun another one there.
async fn comes_elsewhere(state: &AppState, machine: &MachineId, cycle: &StreamedCycle) -> bool {
    let until = state.clock.moment().plus(Duration::from_millis(state.config.stream.cycle_time_ms));
    loop {
        match is_stored(state, machine, cycle).await {
            Ok(true) => return true,
            Ok(false) => {}
            Err(error) => {
                tracing::warn!(%machine, cycle = %cycle.id, %error, "whether a cycle was stored is not known yet");
            }
        }
        if state.clock.moment() >= until {
            return false;
        }
        tokio::select! {
            () = tokio::time::sleep(state.config.stream.resume()) => {}
            // The machine sends everything again to whoever serves it.
            () = state.lifecycle.stopping() => return true,
        }
    }
}

async fn release(state: &AppState, slot: &Arc<Slot>, generation: i64) {
    let (machine, holder) = (slot.machine.clone(), state.streams.holder().to_owned());
    let released =
        state.commit(|store| async move { store.release_stream(&machine, &holder, generation).await }).await;
    if let Err(error) = released {
        // It ends by itself.
        tracing::debug!(%error, "a lease could not be given back");
    }
}

/// Whether the machine has opened a stream at another server since: then it has sent the cycle there again.
async fn went_elsewhere(state: &AppState, slot: &Arc<Slot>) -> bool {
    let newest = slot.newest_taken();
    let (machine, holder) = (slot.machine.clone(), state.streams.holder().to_owned());
    let now = state.clock.now();
    let taken = state
        .commit(|store| async move { store.take_stream(&machine, &holder, false, Duration::ZERO, now).await })
        .await;
    match taken {
        Ok(StreamLease::Taken { generation: next }) => next != newest + 1,
        Ok(StreamLease::Held { .. }) => true,
        Err(_) => false,
    }
}

/// Shows a machine's state to those who watch. Under the lock of its slot: what is shown comes in the order in which it became so.
pub fn show(state: &AppState, machine: &MachineId, held: &Held, now: MachineState) {
    let cycle = held.cycle.as_ref();
    let cycle = cycle.map(|cycle| (cycle.id.as_str(), cycle.tool.as_str(), cycle.meta.operation.as_str()));
    state.live.publish(Event::machine(machine, now, cycle, state.clock.now()));
}

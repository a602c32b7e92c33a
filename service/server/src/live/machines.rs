//! The machines that are connected, by what was last told of each, and by whom.
//!
//! The server that holds a machine's stream tells when it ends. One that was killed tells nothing, and what was told may be lost on
//! its way: what other servers told is held against the leases on streams, which end by themselves. This server knows of its own.

use super::event::{Data, Event, MachineState};
use crate::state::AppState;
use feedwright_core::ids::MachineId;
use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};
use tokio::time::{MissedTickBehavior, interval};

/// Machines whose present state is remembered; a plant has hundreds.
const MOST_MACHINES: usize = 10_000;

/// A machine's last event.
struct Told {
    data: serde_json::Value,
    /// The run of the server that told it.
    by: String,
    number: u64,
    since: Instant,
}

/// What was last told of each machine that is connected.
#[derive(Default)]
pub(super) struct Machines {
    told: BTreeMap<String, Told>,
    /// Numbers what is told, so that what came meanwhile is known.
    newest: u64,
}

/// A machine of another server's, to be held against the leases.
pub(super) struct Doubted {
    machine: String,
    number: u64,
    /// Its connection broke so long ago, where it did: it has no lease then, and may come back.
    interrupted: Option<Duration>,
}

impl Machines {
    /// Takes an event of a machine; `false` where it is to be passed over: what a server tells of the end of a stream says nothing of
    /// the one that the machine has opened at another server since.
    pub(super) fn take(&mut self, event: &Event, by: &str) -> bool {
        let (Some(machine), Data::Tree(data)) = (&event.machine, &event.data) else { return true };
        let is = |state: MachineState| data["state"] == state.as_str();
        let known = self.told.get(machine);
        if known.is_some_and(|known| known.by != by)
            && (is(MachineState::Disconnected) || is(MachineState::Interrupted))
        {
            return false;
        }
        if is(MachineState::Disconnected) {
            self.told.remove(machine);
        } else if known.is_some() || self.told.len() < MOST_MACHINES {
            self.newest += 1;
            let told =
                Told { data: data.clone(), by: by.to_owned(), number: self.newest, since: Instant::now() };
            self.told.insert(machine.clone(), told);
        }
        true
    }

    /// Their last events.
    pub(super) fn all(&self) -> Vec<serde_json::Value> {
        self.told.values().map(|told| told.data.clone()).collect()
    }

    /// Those that others than `own` told of.
    fn of_others(&self, own: &str) -> Vec<Doubted> {
        let others = self.told.iter().filter(|(_, told)| told.by != own);
        let doubted = others.map(|(machine, told)| {
            let is_interrupted = told.data["state"] == MachineState::Interrupted.as_str();
            Doubted {
                machine: machine.clone(),
                number: told.number,
                interrupted: is_interrupted.then(|| told.since.elapsed()),
            }
        });
        doubted.collect()
    }

    /// Forgets a machine, unless something was told of it since; whether it was forgotten.
    fn forget(&mut self, doubted: &Doubted) -> bool {
        let is_so = self.told.get(&doubted.machine).is_some_and(|told| told.number == doubted.number);
        if is_so {
            self.told.remove(&doubted.machine);
        }
        is_so
    }
}

/// Holds what other servers told against the leases, as often as one ends, until the server stops.
pub(super) async fn look(state: &AppState) {
    let mut due = interval(state.config.stream.lease());
    due.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut unleased = BTreeSet::new();
    loop {
        due.tick().await;
        let doubted = state.live.locked_machines().of_others(&state.live.boot);
        if doubted.is_empty() {
            unleased.clear();
            continue;
        }
        let asked: Vec<MachineId> =
            doubted.iter().filter_map(|one| MachineId::try_from(one.machine.as_str()).ok()).collect();
        let (store, now) = (state.store.clone(), state.clock.now());
        // In a task of its own: whoever waits here may be dropped, a query may not.
        let leased = state.lifecycle.spawn(async move { store.leased_streams(&asked, now).await }).await;
        match leased {
            Ok(Ok(leased)) => unleased = end(state, &doubted, &leased.into_iter().collect(), &unleased),
            Ok(Err(error)) => {
                tracing::debug!(%error, "which streams are held is not known until the next look");
            }
            Err(error) => tracing::error!(%error, "looking at the leases failed"),
        }
    }
}

/// Shows the end of streams that nobody held `before`, at the last look, nor holds now; which nobody holds now. At one look alone it may be
/// that who holds it has not come to prolong it since the database was away.
fn end(
    state: &AppState,
    doubted: &[Doubted],
    leased: &BTreeSet<MachineId>,
    before: &BTreeSet<MachineId>,
) -> BTreeSet<MachineId> {
    let resume = state.config.stream.resume();
    let mut unleased = BTreeSet::new();
    for one in doubted {
        let Ok(machine) = MachineId::try_from(one.machine.as_str()) else { continue };
        let may_come_back = one.interrupted.is_some_and(|since| since < resume);
        if leased.contains(&machine) || may_come_back {
            continue;
        }
        if !before.contains(&machine) {
            unleased.insert(machine);
            continue;
        }
        if !state.live.locked_machines().forget(one) {
            continue;
        }
        tracing::info!(%machine, "another server's stream has ended without a word");
        // Every server finds it out by itself.
        let event = Event::machine(&machine, MachineState::Disconnected, None, state.clock.now());
        state.live.show(event);
    }
    unleased
}

#[cfg(test)]
mod tests {
    use super::*;
    use feedwright_core::units::Timestamp;

    fn event(state: MachineState) -> Event {
        let machine = MachineId::try_from("M1").unwrap();
        Event::machine(&machine, state, None, Timestamp::from_micros(0))
    }

    #[test]
    fn the_end_of_a_stream_says_nothing_of_the_next_one_at_another_server() {
        let mut machines = Machines::default();
        assert!(machines.take(&event(MachineState::Running), "here"));
        assert!(machines.take(&event(MachineState::Connected), "there"));
        assert!(!machines.take(&event(MachineState::Interrupted), "here"));
        assert!(!machines.take(&event(MachineState::Disconnected), "here"));
        assert_eq!(machines.all()[0]["state"], "connected");
        assert!(machines.take(&event(MachineState::Disconnected), "there"));
        assert!(machines.all().is_empty());
    }

    #[test]
    fn what_was_told_after_the_leases_were_asked_for_stays() {
        let mut machines = Machines::default();
        machines.take(&event(MachineState::Running), "there");
        assert!(machines.of_others("there").is_empty(), "a server knows of its own");
        let asked = machines.of_others("here");
        machines.take(&event(MachineState::Connected), "there");
        assert!(!machines.forget(&asked[0]));
        let asked = machines.of_others("here");
        assert!(machines.forget(&asked[0]) && machines.all().is_empty());
    }
}

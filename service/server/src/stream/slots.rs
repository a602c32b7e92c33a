//! Each machine's place: the cycle that runs, and the one connection that may use it.
//!
//! A cycle belongs to its machine's slot, not to a connection, so that it outlives one that breaks. Whoever connects
//! last owns the slot; an older connection finds that out at its next step and leaves.

use super::cycle::StreamedCycle;
use super::overload::Overload;
use crate::clock::Moment;
use crate::config::StreamConfig;
use feedwright_core::ids::{CycleId, MachineId};
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;

/// The streams of one server.
pub struct Streams {
    config: StreamConfig,
    /// Names this run of the server in leases.
    holder: String,
    places: Arc<Semaphore>,
    slots: Mutex<HashMap<MachineId, Arc<Slot>>>,
    /// Bytes of samples held by running cycles.
    held_bytes: AtomicUsize,
    /// Who wishes to open a stream of each machine, whose slot they do not own yet.
    opening: Mutex<HashMap<MachineId, Wishes>>,
    /// Overloads of cycles that are not committed yet, the newest of each machine: no other cycle of it starts before.
    overloads: Mutex<HashMap<MachineId, Arc<Overload>>>,
}

/// One machine's place.
pub struct Slot {
    /// The machine.
    pub machine: MachineId,
    held: Mutex<Held>,
}

/// What a slot holds.
#[derive(Default)]
pub struct Held {
    /// Counts connections; the last one owns the slot.
    owner: u64,
    /// Whether its owner is connected.
    connected: bool,
    /// Ends the owner's connection.
    leave: CancellationToken,
    /// Whether the owner was told to leave: `leave` says so too, behind a lock of its own.
    told_to_leave: bool,
    /// Generation of the lease.
    pub generation: i64,
    /// The newest one that was taken for this server, also by who was gone before it was served.
    taken: i64,
    /// The lease is this server's until then; `None` where it is not.
    leased_until: Option<Moment>,
    /// The cycle that runs.
    pub cycle: Option<StreamedCycle>,
    /// The last cycle that was stored, with its answer: asked for again when the answer was lost.
    pub ended: Option<(CycleId, u16, serde_json::Value)>,
    /// What a message that names no cycle is about.
    pub unnamed: Unnamed,
    /// Bytes of samples that the cycle was charged.
    charged: usize,
}

/// What a message that names no cycle is about. A machine that has begun another cycle, which was refused, or was refused
/// anything else since the last one ended, would else take the answer for that of a cycle that was never stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Unnamed {
    /// No cycle that is known here.
    #[default]
    Nothing,
    /// The cycle that runs.
    Running,
    /// The last cycle that was stored.
    Ended,
}

impl Held {
    /// Whether the machine's lease is known to be this server's.
    pub fn is_leased(&self, now: Moment) -> bool {
        self.leased_until.is_some_and(|until| now < until)
    }

    /// The running cycle that is meant by what names none.
    pub fn meant(&self) -> Option<&StreamedCycle> {
        self.cycle.as_ref().filter(|_| self.unnamed == Unnamed::Running)
    }

    /// A machine has begun or taken up something that is not known here: what names no cycle is about that from now on.
    pub fn leave(&mut self, begun: Option<&str>) {
        let runs = self.cycle.as_ref().is_some_and(|running| begun == Some(running.id.as_str()));
        self.unnamed = if runs { Unnamed::Running } else { Unnamed::Nothing };
    }

    /// Something was refused: an end that names no cycle may be about that, and not about the one that was stored.
    pub fn refuse(&mut self) {
        if self.unnamed == Unnamed::Ended {
            self.unnamed = Unnamed::Nothing;
        }
    }
}

/// The generation of no lease.
const NONE: i64 = 0;

/// What a connection leaves in its slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Left {
    /// The generation of the lease to give back.
    pub generation: i64,
    /// Whether a cycle is left, which its machine may come back to.
    pub cycle: bool,
}

/// Wishes to open a machine's stream.
#[derive(Debug, Default)]
struct Wishes {
    count: usize,
    /// The newest lease that was taken meanwhile, whoever it was for.
    taken: i64,
}

/// The wish to open a machine's stream, until its connection owns the slot or it is given up.
pub struct Opening {
    streams: Arc<Streams>,
    machine: MachineId,
    /// Lives as long as whoever wishes it.
    wished: Arc<()>,
}

impl Opening {
    /// Whether somebody wishes it yet.
    pub fn wish(&self) -> Weak<()> {
        Arc::downgrade(&self.wished)
    }
}

impl Drop for Opening {
    fn drop(&mut self) {
        let mut opening = self.streams.opening();
        if let Entry::Occupied(mut wishes) = opening.entry(self.machine.clone()) {
            wishes.get_mut().count -= 1;
            if wishes.get().count == 0 {
                wishes.remove();
            }
        }
    }
}

/// The bytes that a cycle is charged which its slot holds no more, until this is dropped.
pub struct Charged {
    streams: Arc<Streams>,
    bytes: usize,
}

impl Drop for Charged {
    fn drop(&mut self) {
        self.streams.give_back(self.bytes);
    }
}

/// The right to use a slot.
#[derive(Clone)]
pub struct Ownership {
    /// The slot.
    pub slot: Arc<Slot>,
    owner: u64,
    /// Cancelled when another connection owns the slot.
    pub leave: CancellationToken,
}

impl Streams {
    /// No stream yet.
    pub fn new(config: &StreamConfig) -> Arc<Self> {
        Arc::new(Self {
            config: config.clone(),
            holder: uuid::Uuid::now_v7().simple().to_string(),
            places: Arc::new(Semaphore::new(config.max_connections)),
            slots: Mutex::default(),
            held_bytes: AtomicUsize::new(0),
            opening: Mutex::default(),
            overloads: Mutex::default(),
        })
    }

    /// Names this run of the server in leases.
    pub fn holder(&self) -> &str {
        &self.holder
    }

    /// A place for one more stream; `None` where all are taken.
    pub fn place(&self) -> Option<OwnedSemaphorePermit> {
        Arc::clone(&self.places).try_acquire_owned().ok()
    }

    fn slots(&self) -> MutexGuard<'_, HashMap<MachineId, Arc<Slot>>> {
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The machine's slot, where it has one.
    pub fn slot(&self, machine: &MachineId) -> Option<Arc<Slot>> {
        self.slots().get(machine).cloned()
    }

    /// Every slot.
    pub fn all(&self) -> Vec<Arc<Slot>> {
        self.slots().values().cloned().collect()
    }

    /// Whether a stream of the machine is connected here.
    pub fn is_connected(&self, machine: &MachineId) -> bool {
        self.slot(machine).is_some_and(|slot| slot.lock().connected)
    }

    fn opening(&self) -> MutexGuard<'_, HashMap<MachineId, Wishes>> {
        self.opening.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes that somebody wishes to open a stream of the machine. With `alone` it is `None` where another is open here, or is
    /// being opened.
    pub fn open(self: &Arc<Self>, machine: &MachineId, alone: bool) -> Option<Opening> {
        {
            let mut opening = self.opening();
            if alone && opening.contains_key(machine) {
                return None;
            }
            opening.entry(machine.clone()).or_default().count += 1;
        }
        let opening = Opening { streams: self.clone(), machine: machine.clone(), wished: Arc::default() };
        // Whoever is connected was being opened until then.
        (!alone || !self.is_connected(machine)).then_some(opening)
    }

    /// Gives the machine's slot to a new connection, which has the lease of that generation; an older one leaves.
    pub fn own(&self, machine: &MachineId, generation: i64, leased_until: Moment) -> Ownership {
        // Until it is owned: whoever leaves it meanwhile would take it away, and nobody would find its owner.
        let mut slots = self.slots();
        let made = || Arc::new(Slot { machine: machine.clone(), held: Mutex::default() });
        let slot = slots.entry(machine.clone()).or_insert_with(made).clone();
        let (owner, leave) = {
            let mut held = slot.lock();
            held.leave.cancel();
            held.leave = CancellationToken::new();
            held.told_to_leave = false;
            held.owner += 1;
            held.connected = true;
            held.generation = generation;
            // One of a client that has hung up may be newer.
            let meanwhile = self.opening().get(machine).map_or(0, |wishes| wishes.taken);
            held.taken = held.taken.max(generation).max(meanwhile);
            held.leased_until = Some(leased_until);
            (held.owner, held.leave.clone())
        };
        drop(slots);
        Ownership { slot, owner, leave }
    }

    /// Whether a stream of the machine is connected here, or is being opened: whoever opens one later takes a later lease.
    pub fn is_wished(&self, machine: &MachineId) -> bool {
        // Not beside each other: who leaves a slot asks, with the slots locked, who is opening one.
        let is_opening = self.opening().contains_key(machine);
        is_opening || self.is_connected(machine)
    }

    /// Notes that a lease of that generation was taken here, whoever it is for.
    pub fn took(&self, machine: &MachineId, generation: i64) {
        if let Some(wishes) = self.opening().get_mut(machine) {
            wishes.taken = wishes.taken.max(generation);
        }
        if let Some(slot) = self.slot(machine) {
            let mut held = slot.lock();
            held.taken = held.taken.max(generation);
        }
    }

    fn overloads(&self) -> MutexGuard<'_, HashMap<MachineId, Arc<Overload>>> {
        self.overloads.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// An overload of a machine is to be committed.
    pub fn raising(&self, machine: &MachineId, overload: &Arc<Overload>) {
        self.overloads().insert(machine.clone(), Arc::clone(overload));
    }

    /// It is.
    pub fn raised(&self, machine: &MachineId, overload: &Arc<Overload>) {
        let mut overloads = self.overloads();
        if overloads.get(machine).is_some_and(|newest| Arc::ptr_eq(newest, overload)) {
            overloads.remove(machine);
        }
    }

    /// The overload of a machine that is to be committed yet, whatever became of its cycle.
    pub fn unraised(&self, machine: &MachineId) -> Option<Arc<Overload>> {
        self.overloads().get(machine).cloned()
    }

    /// Ends a connection's ownership. Returns what it leaves, where it still owned; `tell` is told before anybody else can own the slot.
    pub fn leave(&self, ownership: &Ownership, tell: impl FnOnce(&Held)) -> Option<Left> {
        let mut slots = self.slots();
        let mut held = ownership.slot.lock();
        if held.owner != ownership.owner {
            return None;
        }
        held.connected = false;
        tell(&held);
        // A later one was taken for somebody who opens a stream yet, who gives it back, or for nobody.
        let generation = match self.opening().get(&ownership.slot.machine) {
            Some(wishes) if wishes.taken > 0 => NONE,
            Some(_) => held.generation,
            None => held.taken,
        };
        let left = Left { generation, cycle: held.cycle.is_some() };
        if !left.cycle {
            self.give_back(std::mem::take(&mut held.charged));
            // Who has left tells nothing more of the machine.
            held.owner += 1;
            remove(&mut slots, &ownership.slot);
        }
        drop(held);
        Some(left)
    }

    /// Takes the cycle that a broken connection has left, unless a connection owns the slot again, with what it is charged. `tell` is told
    /// before anybody else can own the slot.
    pub fn take_left(
        self: &Arc<Self>,
        ownership: &Ownership,
        tell: impl FnOnce(&Held),
    ) -> Option<(StreamedCycle, Charged)> {
        let mut slots = self.slots();
        let mut held = ownership.slot.lock();
        if held.owner != ownership.owner || held.connected {
            return None;
        }
        let cycle = held.cycle.take();
        let charged = self.charged(std::mem::take(&mut held.charged));
        tell(&held);
        held.owner += 1;
        drop(held);
        remove(&mut slots, &ownership.slot);
        Some((cycle?, charged))
    }

    /// Puts a cycle into a slot; gives the one that it had, with what that is charged.
    pub fn replace(
        self: &Arc<Self>,
        held: &mut Held,
        cycle: StreamedCycle,
    ) -> Option<(StreamedCycle, Charged)> {
        let left = held.cycle.replace(cycle);
        let charged = self.charged(std::mem::take(&mut held.charged));
        self.charge(held);
        left.map(|left| (left, charged))
    }

    fn charged(self: &Arc<Self>, bytes: usize) -> Charged {
        Charged { streams: Arc::clone(self), bytes }
    }

    /// Bytes of samples are held no longer.
    fn give_back(&self, charged: usize) {
        self.held_bytes.fetch_sub(charged, Ordering::Relaxed);
    }

    /// Whether there is room for the samples of another cycle.
    pub fn has_room(&self) -> bool {
        self.held_bytes.load(Ordering::Relaxed) < self.config.buffered_bytes
    }

    /// Charges a slot for the samples that its cycle holds now.
    pub fn charge(&self, held: &mut Held) {
        let bytes = held.cycle.as_ref().map_or(0, |cycle| cycle.running.record().bytes());
        if bytes == held.charged {
            // As nearly always: what every stream shares is left alone.
            return;
        }
        if bytes > held.charged {
            self.held_bytes.fetch_add(bytes - held.charged, Ordering::Relaxed);
        } else {
            self.held_bytes.fetch_sub(held.charged - bytes, Ordering::Relaxed);
        }
        held.charged = bytes;
    }
}

/// Takes a slot away from who owned it, unless the machine has another one by now.
fn remove(slots: &mut HashMap<MachineId, Arc<Slot>>, slot: &Arc<Slot>) {
    if slots.get(&slot.machine).is_some_and(|there| Arc::ptr_eq(there, slot)) {
        slots.remove(&slot.machine);
    }
}

impl Slot {
    pub(super) fn lock(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The lease with which a connection was opened, of that generation, was prolonged.
    pub fn prolonged(&self, generation: i64, until: Moment) {
        let mut held = self.lock();
        // A later connection has asked later, and knows better.
        if held.generation == generation && !held.told_to_leave {
            held.leased_until = Some(until);
        }
    }

    /// The lease of that generation is another server's: whoever is connected here with it leaves. `false` where nobody is.
    pub fn lost(&self, generation: i64) -> bool {
        let mut held = self.lock();
        if !held.connected || held.generation != generation {
            return false;
        }
        held.leased_until = None;
        held.told_to_leave = true;
        held.leave.cancel();
        true
    }

    /// The newest generation of its lease that was taken here.
    pub fn newest_taken(&self) -> i64 {
        self.lock().taken
    }

    /// Whether somebody is connected, with the lease of which generation.
    pub fn connected(&self) -> Option<i64> {
        let held = self.lock();
        held.connected.then_some(held.generation)
    }
}

impl Ownership {
    /// What the slot holds, as long as this connection owns it.
    pub fn held(&self) -> Option<MutexGuard<'_, Held>> {
        let held = self.slot.lock();
        (held.owner == self.owner && !held.told_to_leave).then_some(held)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Clock;
    use crate::config::{Config, Sources};
    use feedwright_core::units::Timestamp;
    use std::time::Duration;

    #[test]
    fn a_lease_is_believed_in_until_it_ends_is_prolonged_or_lost() {
        let config = Config::load(&Sources::default()).unwrap();
        let streams = Streams::new(&config.stream);
        let begun = Clock::fixed(Timestamp::from_micros(0)).moment();
        let at = |seconds| begun.plus(Duration::from_secs(seconds));
        let machine = MachineId::try_from("M1").unwrap();
        let owned = streams.own(&machine, 1, at(10));
        let leased = |now| owned.slot.lock().is_leased(at(now));
        assert!(leased(9) && !leased(10));
        owned.slot.prolonged(1, at(20));
        assert!(leased(19) && !leased(20));
        assert!(owned.held().is_some());

        // Another connection has come: what was asked for the one before says nothing of it.
        let later = streams.own(&machine, 2, at(30));
        owned.slot.prolonged(1, at(40));
        assert!(leased(29) && !leased(30));
        assert!(!owned.slot.lost(1));
        assert!(leased(29) && later.held().is_some() && owned.held().is_none());

        assert!(later.slot.lost(2));
        assert!(!leased(0) && later.held().is_none());
        later.slot.prolonged(2, at(50));
        assert!(!leased(0), "whoever was told to leave has none");
    }

    fn streams() -> Arc<Streams> {
        Streams::new(&Config::load(&Sources::default()).unwrap().stream)
    }

    fn moment() -> Moment {
        Clock::fixed(Timestamp::from_micros(0)).moment()
    }

    #[test]
    fn who_has_left_takes_nobody_elses_place_away_and_tells_nothing_of_it() {
        let (streams, machine) = (streams(), MachineId::try_from("M1").unwrap());
        let first = streams.own(&machine, 1, moment());
        let mut told = 0;
        assert!(streams.leave(&first, |_| told += 1).is_some());
        assert_eq!(told, 1);
        let second = streams.own(&machine, 2, moment());
        // Its slot is another one by now.
        assert!(streams.leave(&first, |_| panic!("it has left")).is_none());
        assert!(streams.take_left(&first, |_| {}).is_none());
        assert!(streams.is_connected(&machine) && second.held().is_some());

        let third = streams.own(&machine, 3, moment());
        assert!(streams.leave(&second, |_| panic!("somebody else owns it")).is_none());
        assert!(streams.is_connected(&machine) && third.held().is_some());
    }

    #[test]
    fn one_alone_opens_a_stream_where_no_other_is_open_or_opening() {
        let (streams, machine) = (streams(), MachineId::try_from("M1").unwrap());
        let other = MachineId::try_from("M2").unwrap();
        let first = streams.open(&machine, true).unwrap();
        assert!(streams.open(&machine, true).is_none() && streams.open(&other, true).is_some());
        drop(first);
        let again = streams.open(&machine, true).unwrap();
        let owned = streams.own(&machine, 1, moment());
        drop(again);
        assert!(streams.open(&machine, true).is_none(), "it is connected");
        assert!(streams.open(&machine, false).is_some(), "it is taken over");
        streams.leave(&owned, |_| {});
        assert!(streams.open(&machine, true).is_some());
    }

    #[test]
    fn a_lease_that_was_taken_for_nobody_is_given_back() {
        let (streams, machine) = (streams(), MachineId::try_from("M1").unwrap());
        let left = |is_opening: bool| {
            let owned = streams.own(&machine, 1, moment());
            let opening = streams.open(&machine, false).unwrap();
            streams.took(&machine, 2);
            let opening = is_opening.then_some(opening);
            let left = streams.leave(&owned, |_| {}).unwrap();
            drop(opening);
            left.generation
        };
        // It hung up before anybody was connected, and its lease is newer than that of who came next.
        let opening = streams.open(&machine, false).unwrap();
        streams.took(&machine, 4);
        assert!(streams.is_wished(&machine));
        let owned = streams.own(&machine, 3, moment());
        drop(opening);
        assert_eq!(streams.leave(&owned, |_| {}).unwrap().generation, 4);
        assert_eq!(left(false), 2, "who wished it hung up");
        assert_eq!(left(true), NONE, "who is to be served gives it back");
    }
}

//! Room for large bodies, which all of them together do not exceed.
//!
//! A body that tells its length has all of its place before it comes. One that does not takes its place bit by bit, and holds what it
//! has while it waits for more. Such bodies never wait for each other without an end: beside what all of them hold, there is
//! always enough for the one that holds most to become as large as any may be. It ends, gives back what it held, and the next one is
//! in its place (the banker's algorithm: Dijkstra, Cooperating sequential processes, EWD 123, 6.1, of which this is the case where all
//! may become equally large).

use super::content::ContentError;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::time::{Instant, timeout};

/// Bodies up to this need no room of their own, bytes.
pub(super) const SMALL_BYTES: usize = 256 * 1024;
/// A body that does not tell its length asks for so many bytes more than are there, or for an eighth of them where that is more: it is
/// moved in memory each time.
const AHEAD_BYTES: usize = 64 * 1024;
/// How long a body waits for its room, in all.
const PATIENCE: Duration = Duration::from_secs(10);
/// Room is counted by so many bytes.
pub(super) const UNIT: usize = 1024;

/// What is shared of one kind of room.
#[derive(Debug)]
pub(super) struct Share {
    accounts: Arc<Mutex<Accounts>>,
    patience: Duration,
}

/// What of the room a body takes, given back where this is dropped: with the body itself.
#[derive(Debug)]
pub struct Place {
    accounts: Arc<Mutex<Accounts>>,
    id: u64,
}

/// The place of a body that does not tell its length, which grows with it.
#[derive(Debug)]
pub struct Growing<'a> {
    share: &'a Share,
    place: Option<Place>,
    /// What it holds, units.
    held: usize,
    /// What is left of its patience.
    patience: Duration,
}

impl Share {
    /// For so many bytes; a body that does not tell its length becomes as large as `largest` at the most.
    pub(super) fn new(bytes: usize, largest: usize) -> Self {
        let accounts = Accounts::new(bytes.div_ceil(UNIT).max(1), largest.div_ceil(UNIT));
        Self { accounts: Arc::new(Mutex::new(accounts)), patience: PATIENCE }
    }

    /// A place for so many bytes; whoever is larger than all of it has all of it.
    pub(super) async fn place(&self, bytes: usize) -> Result<Place, ContentError> {
        let place = Place::open(&self.accounts, false);
        let units = bytes.div_ceil(UNIT).min(lock(&self.accounts).units);
        place.take(units, &mut self.patience.clone()).await?;
        Ok(place)
    }

    /// A place for a body that does not tell its length. It holds nothing yet.
    pub(super) const fn growing(&self) -> Growing<'_> {
        Growing { share: self, place: None, held: 0, patience: self.patience }
    }

    #[cfg(test)]
    pub(super) fn with_patience(self, patience: Duration) -> Self {
        Self { patience, ..self }
    }

    /// Units that nobody holds.
    #[cfg(test)]
    pub(super) fn free(&self) -> usize {
        lock(&self.accounts).free
    }
}

impl Growing<'_> {
    /// Makes room for so many bytes in all, and for some more.
    pub async fn grow_to(&mut self, bytes: usize) -> Result<(), ContentError> {
        if bytes <= SMALL_BYTES || bytes <= self.bytes() {
            return Ok(());
        }
        let accounts = &self.share.accounts;
        let ahead = bytes.saturating_add(AHEAD_BYTES.max(bytes / 8));
        let units = ahead.div_ceil(UNIT).min(lock(accounts).largest);
        let place = self.place.get_or_insert_with(|| Place::open(accounts, true));
        place.take(units, &mut self.patience).await?;
        self.held = units;
        Ok(())
    }

    /// What it has room for, bytes; 0 while it is small.
    pub const fn bytes(&self) -> usize {
        self.held * UNIT
    }

    /// The place of a body that has come in.
    pub fn ended(self, bytes: usize) -> Option<Place> {
        if let Some(place) = &self.place {
            lock(&place.accounts).end(place.id, bytes.div_ceil(UNIT));
        }
        self.place
    }
}

impl Place {
    fn open(accounts: &Arc<Mutex<Accounts>>, grows: bool) -> Self {
        let id = lock(accounts).open(grows);
        Self { accounts: Arc::clone(accounts), id }
    }

    /// Waits until it holds so many units, as long as patience lasts, of which it takes what was waited.
    async fn take(&self, units: usize, patience: &mut Duration) -> Result<(), ContentError> {
        let Some(granted) = lock(&self.accounts).ask(self.id, units) else { return Ok(()) };
        let began = Instant::now();
        let in_time = timeout(*patience, granted).await;
        *patience = patience.saturating_sub(began.elapsed());
        // Also what was granted just when patience ended is held.
        if in_time.is_ok() || lock(&self.accounts).withdraw(self.id) {
            return Ok(());
        }
        Err(ContentError::Busy)
    }

    #[cfg(test)]
    pub(super) fn bytes(&self) -> usize {
        lock(&self.accounts).places[&self.id].held * UNIT
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        lock(&self.accounts).close(self.id);
    }
}

fn lock(accounts: &Mutex<Accounts>) -> MutexGuard<'_, Accounts> {
    accounts.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Who holds how much and who waits for more, in units.
#[derive(Debug)]
struct Accounts {
    /// All there are.
    units: usize,
    /// What a growing body becomes at the most.
    largest: usize,
    /// Those that nobody holds.
    free: usize,
    /// By the order in which they came.
    places: BTreeMap<u64, Account>,
    next: u64,
}

#[derive(Debug, Default)]
struct Account {
    held: usize,
    /// What it waits for beside it; 0 where it does not.
    wanted: usize,
    /// Whether it may ask for more while it holds some.
    grows: bool,
    told: Option<oneshot::Sender<()>>,
}

impl Accounts {
    fn new(units: usize, largest: usize) -> Self {
        Self { units, largest: largest.clamp(1, units), free: units, places: BTreeMap::new(), next: 0 }
    }

    fn open(&mut self, grows: bool) -> u64 {
        let id = self.next;
        self.next += 1;
        self.places.insert(id, Account { grows, ..Account::default() });
        id
    }

    /// Asks for so many units in all; `None` where they are held at once.
    fn ask(&mut self, id: u64, units: usize) -> Option<oneshot::Receiver<()>> {
        let account = self.places.get_mut(&id)?;
        let (tell, told) = oneshot::channel();
        account.wanted = units.saturating_sub(account.held);
        account.told = Some(tell);
        self.settle();
        self.places.get(&id).is_some_and(|account| account.wanted > 0).then_some(told)
    }

    /// Asks for nothing any more; whether all that was asked for is held.
    fn withdraw(&mut self, id: u64) -> bool {
        let Some(account) = self.places.get_mut(&id) else { return false };
        account.told = None;
        let was_waiting = std::mem::take(&mut account.wanted) > 0;
        if was_waiting {
            self.settle();
        }
        !was_waiting
    }

    /// It does not grow any more, and needs so many of its units.
    fn end(&mut self, id: u64, units: usize) {
        let Some(account) = self.places.get_mut(&id) else { return };
        let more = account.held.saturating_sub(units);
        (account.grows, account.wanted) = (false, 0);
        account.held -= more;
        self.free += more;
        self.settle();
    }

    fn close(&mut self, id: u64) {
        let Some(account) = self.places.remove(&id) else { return };
        self.free += account.held;
        self.settle();
    }

    /// Grants what can be granted: first to those that hold something, which is given back the sooner, then to those that come, each
    /// in the order of coming. Where units are short nobody behind takes them. Who is kept back for a larger one that grows keeps nobody.
    fn settle(&mut self) {
        let growing = || self.places.values().filter(|account| account.grows).map(|account| account.held);
        let (mut all, mut most) = (growing().sum::<usize>(), growing().max().unwrap_or(0));
        for has_some in [true, false] {
            let waiting = |account: &&mut Account| account.wanted > 0 && (account.held > 0) == has_some;
            for account in self.places.values_mut().filter(waiting) {
                if account.grows {
                    // What the others hold leaves room for the one that then holds most. Those that do not grow
                    // are not counted: they give back what they hold without asking for more.
                    let most_then = most.max(account.held + account.wanted);
                    if all + account.wanted - most_then > self.units - self.largest {
                        continue;
                    }
                }
                if account.wanted > self.free {
                    return;
                }
                if account.grows {
                    all += account.wanted;
                    most = most.max(account.held + account.wanted);
                }
                self.free -= account.wanted;
                account.held += std::mem::take(&mut account.wanted);
                if let Some(told) = account.told.take() {
                    // Where nobody listens any more its place is about to be closed.
                    let _ = told.send(());
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::FutureExt;
    use futures_util::future::join_all;
    use proptest::prelude::{Strategy, prop_assert, prop_oneof, proptest};
    use std::pin::pin;

    const MIB: usize = 1 << 20;

    fn share() -> Share {
        Share::new(64 * MIB, 16 * MIB)
    }

    /// Reads a body of so many bytes as it comes, in turn with all others.
    async fn read(share: &Share, bytes: usize) -> Result<Option<Place>, ContentError> {
        let mut place = share.growing();
        for there in (0..=bytes).step_by(SMALL_BYTES / 4).skip(1) {
            place.grow_to(there).await?;
            tokio::task::yield_now().await;
        }
        Ok(place.ended(bytes))
    }

    #[tokio::test]
    async fn bodies_that_do_not_tell_their_length_are_all_taken_in_though_they_need_more_than_there_is() {
        for (bodies, bytes) in [(16, 8 * MIB), (40, 16 * MIB), (300, MIB)] {
            let share = share();
            // Time passes only where somebody waits in vain.
            let taken_in = join_all((0..bodies).map(async |_| read(&share, bytes).await.map(drop))).await;
            assert!(taken_in.iter().all(Result::is_ok), "{bodies} of {bytes}: {taken_in:?}");
            assert_eq!(share.free(), 64 * 1024);
        }
    }

    #[tokio::test]
    async fn what_is_held_is_near_what_is_there_and_slow_ones_keep_nobody() {
        let share = share().with_patience(Duration::ZERO);
        let mut slow = Vec::new();
        for _ in 0..16 {
            let mut place = share.growing();
            place.grow_to(300 * UNIT).await.unwrap();
            slow.push(place);
        }
        assert_eq!(share.free(), (64 << 10) - 16 * 364);
        share.place(300 * UNIT).await.unwrap();
        let large = share.place(16 * MIB).await.unwrap();
        assert_eq!(large.bytes(), 16 * MIB);
        assert!(read(&share, 16 * MIB).await.is_ok());
        assert!(slow[0].grow_to(16 * MIB).await.is_ok(), "slow ones may become as large as any");
    }

    #[tokio::test]
    async fn a_place_grows_with_a_body_and_is_cut_to_it() {
        let share = Share::new(8 * MIB, 6 * MIB);
        let mut place = share.growing();
        place.grow_to(SMALL_BYTES).await.unwrap();
        assert_eq!((place.bytes(), share.free()), (0, 8 << 10));
        for (bytes, held) in [
            (SMALL_BYTES + 1, 321),
            (321 << 10, 321),
            (4 * MIB, (4 << 10) + 512),
            (6 * MIB - 1, 6 << 10),
            (6 * MIB, 6 << 10),
        ] {
            place.grow_to(bytes).await.unwrap();
            assert_eq!((place.bytes(), share.free()), (held << 10, (8 << 10) - held), "{bytes}");
        }
        let ended = place.ended(5 * MIB).unwrap();
        assert_eq!((ended.bytes(), share.free()), (5 * MIB, 3 << 10));
        drop(ended);
        assert_eq!(share.free(), 8 << 10);
        assert!(share.growing().ended(10).is_none());
    }

    #[tokio::test]
    async fn who_comes_later_does_not_pass_and_who_holds_something_does() {
        let share = share();
        let held = share.place(50 * MIB).await.unwrap();
        let mut growing = share.growing();
        growing.grow_to(8 * MIB).await.unwrap();
        let mut large = pin!(share.place(16 * MIB));
        let mut small = pin!(share.place(MIB));
        assert!(large.as_mut().now_or_never().is_none());
        assert!(small.as_mut().now_or_never().is_none(), "or large ones would never have their turn");
        growing.grow_to(12 * MIB).await.unwrap();
        drop(held);
        assert!(matches!(large.as_mut().now_or_never(), Some(Ok(_))));
        assert!(matches!(small.as_mut().now_or_never(), Some(Ok(_))));
    }

    #[tokio::test]
    async fn who_does_not_grow_is_not_kept_by_who_is_kept_back_for_a_larger_one() {
        let share = share();
        // Four that grow, of which one may become as large as any.
        let mut growing = [share.growing(), share.growing(), share.growing(), share.growing()];
        for place in &mut growing {
            place.grow_to(13 * MIB).await.unwrap();
        }
        let mut other = share.growing();
        let mut kept_back = Box::pin(other.grow_to(5 * MIB));
        assert!(kept_back.as_mut().now_or_never().is_none());
        let free = share.free() * UNIT;
        assert!(free > 4 * MIB);
        drop(share.place(free).await.unwrap());
        for mut place in growing {
            let mut grown = Box::pin(place.grow_to(16 * MIB));
            assert!(grown.as_mut().now_or_never().is_some());
            drop(grown);
            drop(place.ended(16 * MIB));
        }
        assert!(matches!(kept_back.as_mut().now_or_never(), Some(Ok(()))));
    }

    #[tokio::test]
    async fn who_gives_up_leaves_nothing_and_lets_the_next_one_in() {
        let share = share();
        let held = share.place(60 * MIB).await.unwrap();
        let mut large = Box::pin(share.place(5 * MIB));
        let mut next = pin!(share.place(4 * MIB));
        assert!(large.as_mut().now_or_never().is_none() && next.as_mut().now_or_never().is_none());
        drop(large);
        let Some(Ok(next)) = next.as_mut().now_or_never() else { panic!("the first one is gone") };
        // What was granted to somebody who is gone before he looks is given back.
        let mut unseen = Box::pin(share.place(4 * MIB));
        assert!(unseen.as_mut().now_or_never().is_none());
        drop(next);
        assert_eq!(share.free(), 0);
        drop(unseen);
        assert_eq!(share.free(), 4 << 10);
        drop(held);
        assert_eq!(share.free(), 64 << 10);
    }

    #[tokio::test]
    async fn patience_is_of_a_body_and_not_of_each_of_its_steps() {
        let share = Share::new(8 * MIB, 6 * MIB).with_patience(Duration::from_millis(5));
        let mut place = share.growing();
        place.grow_to(MIB).await.unwrap();
        let held = share.place(6 * MIB).await.unwrap();
        assert_eq!(place.grow_to(5 * MIB).await, Err(ContentError::Busy));
        assert_eq!(place.patience, Duration::ZERO);
        assert_eq!((place.bytes(), share.free()), ((1024 + 128) << 10, 1024 - 128), "it keeps what it had");
        assert!(place.grow_to(MIB + 200 * UNIT).await.is_ok(), "who need not wait needs no patience");
        drop(held);
        place.grow_to(6 * MIB).await.unwrap();
    }

    /// What a body does next.
    #[derive(Debug, Clone, Copy)]
    enum Step {
        Told(usize),
        Grows(usize),
        More(usize, usize),
        Ends(usize),
        Leaves(usize),
        GivesUp(usize),
    }

    fn steps() -> impl Strategy<Value = Vec<Step>> {
        let which = || 0..40_usize;
        let step = prop_oneof![
            (1..=64_usize).prop_map(Step::Told),
            (1..=16_usize).prop_map(Step::Grows),
            (which(), 1..=16_usize).prop_map(|(which, to)| Step::More(which, to)),
            (which(), 1..=16_usize).prop_map(|(which, to)| Step::More(which, to)),
            which().prop_map(Step::Ends),
            which().prop_map(Step::Leaves),
            which().prop_map(Step::GivesUp),
        ];
        proptest::collection::vec(step, 0..120)
    }

    proptest! {
        #[test]
        fn whatever_bodies_do_they_keep_within_the_room_and_all_of_them_can_end(
            largest in prop_oneof![16..=64_usize, 16..=20_usize],
            steps in steps(),
        ) {
            let mut room = Accounts::new(64, largest);
            let id = |room: &Accounts, which: usize| {
                room.places.keys().copied().nth(which % room.places.len().max(1))
            };
            for step in steps {
                match step {
                    Step::Told(units) => {
                        let id = room.open(false);
                        drop(room.ask(id, units));
                    }
                    Step::Grows(units) => {
                        let id = room.open(true);
                        drop(room.ask(id, units));
                    }
                    Step::More(which, to) => {
                        if let Some(id) = id(&room, which)
                            && room.places[&id].grows && room.places[&id].wanted == 0
                        {
                            drop(room.ask(id, to));
                        }
                    }
                    // One that waits is not at its end.
                    Step::Ends(which) => {
                        if let Some(id) = id(&room, which) && room.places[&id].wanted == 0 {
                            let needed = room.places[&id].held.div_ceil(2);
                            room.end(id, needed);
                        }
                    }
                    Step::Leaves(which) => {
                        if let Some(id) = id(&room, which) {
                            room.close(id);
                        }
                    }
                    Step::GivesUp(which) => {
                        if let Some(id) = id(&room, which) && !room.withdraw(id) && room.places[&id].held == 0 {
                            room.close(id);
                        }
                    }
                }
                let held: usize = room.places.values().map(|account| account.held).sum();
                prop_assert!(held + room.free == 64);
            }
            // At worst each of them wants all that it may, before any ends.
            let growing: Vec<u64> =
                room.places.iter().filter(|(_, account)| account.grows).map(|(id, _)| *id).collect();
            for id in growing {
                drop(room.ask(id, largest));
            }
            while !room.places.is_empty() {
                let done = room.places.iter().find(|(_, account)| account.wanted == 0).map(|(id, _)| *id);
                prop_assert!(done.is_some(), "they wait for each other: {room:?}");
                room.close(done.unwrap());
            }
            prop_assert!(room.free == 64);
        }
    }
}

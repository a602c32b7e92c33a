//! Alarms as they come and go: the open ones, compared with those that were open before.
//!
//! Alarms are raised and cleared in the store's transactions, by any server and by the command line. So they are not
//! told by who raised them but found by looking, at once when something may have changed and now and then anyway. A look
//! is one row, which tells what all open alarms come to: where it is as it was, nothing else is read. What is told of an
//! alarm is what its own row says.

use super::event::Event;
use crate::state::AppState;
use crate::stream::overload;
use feedwright_store::{Alarm, AlarmFilter, AlarmKind, OpenSums, Page, RowNumber, StoreResult};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Mutex;
use tokio::time::{Instant, sleep_until, timeout};

/// Looks at most so often.
const LEAST_INTERVAL: Duration = Duration::from_millis(200);
/// Looks at least so often: other servers and commands raise alarms too.
const MOST_INTERVAL: Duration = Duration::from_secs(5);
/// Alarms read at a time.
const PAGE: u16 = 1000;
/// Numbers of open alarms read at a time.
const NUMBERS_PAGE: u32 = 10_000;

/// Open alarms by their numbers, each with whether it is acknowledged. All of them, as one that is not followed could not be told when
/// it is cleared: the database has one of a kind for a subject, and one is a few bytes here.
type Open = BTreeMap<RowNumber, bool>;

/// What was shown so far. It follows what is told, alarm by alarm: after a failure the next look goes on from there.
pub(super) struct Shown {
    open: Open,
    /// The newest alarm there was: one that is raised and cleared between two looks is found by its number.
    newest: RowNumber,
}

/// Watches until the server stops.
///
/// What was `shown` outlives a panic: what changed meanwhile is told.
pub(super) async fn watch(state: AppState, shown: Arc<Mutex<Option<Shown>>>) {
    let mut shown = shown.lock().await;
    loop {
        let looked = Instant::now();
        // A failure is the store's to report; the next look finds the same.
        if let Err(error) = look(&state, &mut shown).await {
            tracing::debug!(%error, "alarms cannot be read");
        }
        let due = async {
            // The deadline bounds how long a change waits when nobody says that there is one.
            let _ = timeout(MOST_INTERVAL, state.live.alarms_due.notified()).await;
            sleep_until(looked + LEAST_INTERVAL).await;
        };
        tokio::select! {
            () = due => {}
            () = state.lifecycle.stopping() => return,
        }
    }
}

async fn look(state: &AppState, shown: &mut Option<Shown>) -> StoreResult<()> {
    let (newest, sums) = state.store.open_alarm_sums().await?;
    let Some(shown) = shown else {
        *shown = Some(Shown { open: open(state, newest).await?, newest });
        return Ok(());
    };
    if newest > shown.newest {
        shown.tell_new_ones(state).await?;
    }
    // Whatever else there is has a number that is not new: one is open no more, or acknowledged, or was committed late.
    if OpenSums::of(shown.open.iter().map(|(id, acknowledged)| (*id, *acknowledged))) != sums {
        shown.tell_changed_ones(state).await?;
    }
    Ok(())
}

/// The open alarms up to a number.
async fn open(state: &AppState, newest: RowNumber) -> StoreResult<Open> {
    let mut found = Open::new();
    let mut after = None;
    loop {
        let page = state.store.open_alarm_numbers(Page { after, limit: NUMBERS_PAGE }).await?;
        let Some((last, _)) = page.last() else { return Ok(found) };
        after = Some(*last);
        found.extend(page.into_iter().take_while(|(id, _)| *id <= newest));
        if after >= Some(newest) {
            return Ok(found);
        }
    }
}

impl Shown {
    /// Tells those that came after the newest one, open or not.
    async fn tell_new_ones(&mut self, state: &AppState) -> StoreResult<()> {
        loop {
            let page = Page { after: Some(self.newest), limit: PAGE.into() };
            let alarms = state.store.alarms(&AlarmFilter::default(), page).await?;
            if alarms.is_empty() {
                return Ok(());
            }
            for alarm in alarms {
                self.tell(state, &alarm).await;
                self.newest = alarm.id;
            }
        }
    }

    /// Tells those that are open no more, or acknowledged, or open and not known: numbers are given before a commit, and one that took
    /// longer brings an alarm that is older than the newest.
    async fn tell_changed_ones(&mut self, state: &AppState) -> StoreResult<()> {
        let now = open(state, self.newest).await?;
        let known = |id| self.open.get(id) == now.get(id);
        let changed: Vec<RowNumber> = self.open.keys().filter(|id| !known(id)).copied().collect();
        let late = now.keys().filter(|id| !self.open.contains_key(id)).copied();
        let changed: Vec<RowNumber> = late.chain(changed).collect();
        for numbers in changed.chunks(PAGE.into()) {
            let alarms = state.store.alarms_numbered(numbers).await?;
            for alarm in &alarms {
                self.tell(state, alarm).await;
            }
            // Of what is not in the database any more, as after another one was put in its place, there is nothing to tell.
            for id in numbers {
                if alarms.binary_search_by_key(id, |alarm| alarm.id).is_err() {
                    self.open.remove(id);
                }
            }
        }
        Ok(())
    }

    /// Tells what has become of an alarm since it was shown, by its row. Each server looks by itself: nothing here is told to the others.
    async fn tell(&mut self, state: &AppState, alarm: &Alarm) {
        let was_acknowledged = self.open.get(&alarm.id).copied();
        if was_acknowledged.is_none() {
            state.live.show(Event::alarm("raised", alarm.clone()));
        }
        if alarm.acknowledged.is_some() && was_acknowledged != Some(true) {
            state.live.show(Event::alarm("acknowledged", alarm.clone()));
        }
        if alarm.cleared_at.is_none() {
            self.open.insert(alarm.id, alarm.acknowledged.is_some());
            return;
        }
        // An overload is cleared by whoever acknowledges it, perhaps at another server.
        if let (AlarmKind::Overload, Some(machine)) = (alarm.kind, &alarm.machine) {
            overload::settle(state, machine).await;
        }
        state.live.show(Event::alarm_cleared(alarm));
        self.open.remove(&alarm.id);
    }
}

//! Alarms as they come and go: the open ones, compared with those that were open before.
//!
//! Alarms are raised and cleared in the store's transactions, by any server and by the command line. So they are not
//! told by who raised them but found by looking, at once when something may have changed and now and then anyway.

use super::event::Event;
use crate::state::AppState;
use crate::stream::overload;
use feedwright_store::{Alarm, AlarmFilter, AlarmKind, Page, StoreResult};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Mutex;
use tokio::time::{Instant, sleep_until, timeout};

/// Looks at most so often.
const LEAST_INTERVAL: Duration = Duration::from_millis(200);
/// Looks at least so often: other servers and commands raise alarms too.
const MOST_INTERVAL: Duration = Duration::from_secs(5);
/// Open alarms read at a time.
const PAGE: u32 = 1000;
/// Open alarms that are followed; a shop with more knows that there are many.
const MOST: usize = 10_000;

type Open = BTreeMap<i64, Alarm>;

/// What was shown so far.
pub(super) struct Shown {
    open: Open,
    /// The newest alarm there was: one that is raised and cleared between two looks is found by its number.
    newest: i64,
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
    let mut open = open(state).await?;
    let after = match shown {
        Some(shown) => shown.newest,
        None => open.keys().next_back().copied().unwrap_or(0),
    };
    let fresh = since(state, after).await?;
    let newest = fresh.last().map_or(after, |alarm| alarm.id);
    if let Some(before) = shown {
        // Numbers are given before a commit: one that took longer brings an alarm that is older than the newest. Of more than are
        // looked at it is not known which were there.
        let is_late = |alarm: &&Alarm| alarm.id <= after && !before.open.contains_key(&alarm.id);
        let late = open.values().filter(is_late).take_while(|_| before.open.len() < MOST);
        let raised: Vec<Alarm> = late.chain(&fresh).cloned().collect();
        tell(state, &before.open, &open, &raised).await;
    }
    open.extend(fresh.into_iter().filter(|alarm| alarm.cleared_at.is_none()).map(|alarm| (alarm.id, alarm)));
    *shown = Some(Shown { open, newest });
    Ok(())
}

/// The alarms after a number, open or not.
async fn since(state: &AppState, after: i64) -> StoreResult<Vec<Alarm>> {
    let mut found = Vec::new();
    let mut after = Some(after);
    loop {
        let page = state.store.alarms(&AlarmFilter::default(), Page { after, limit: PAGE }).await?;
        let Some(last) = page.last() else { return Ok(found) };
        after = Some(last.id);
        found.extend(page);
        // At the start a shop's whole past comes by; only its end matters.
        if found.len() > MOST {
            found.drain(..found.len() - 1);
        }
    }
}

async fn open(state: &AppState) -> StoreResult<Open> {
    let filter = AlarmFilter { open: Some(true), ..AlarmFilter::default() };
    let mut found = Open::new();
    let mut after = None;
    while found.len() < MOST {
        let page = state.store.alarms(&filter, Page { after, limit: PAGE }).await?;
        let Some(last) = page.last() else { break };
        after = Some(last.id);
        found.extend(page.into_iter().map(|alarm| (alarm.id, alarm)));
    }
    Ok(found)
}

async fn tell(state: &AppState, before: &Open, now: &Open, fresh: &[Alarm]) {
    // Each server looks by itself: nothing here is told to the others.
    for alarm in fresh {
        state.live.show(Event::alarm("raised", alarm.clone()));
        if alarm.acknowledged.is_some() {
            state.live.show(Event::alarm("acknowledged", alarm.clone()));
        }
        if alarm.cleared_at.is_some() {
            cleared(state, alarm).await;
        }
    }
    for (id, known) in before {
        match now.get(id) {
            None => {
                // As it is listed now, with when it was cleared and by whom it was acknowledged.
                let listed = listed(state, *id).await.unwrap_or_default();
                let alarm = listed.unwrap_or_else(|| known.clone());
                if known.acknowledged.is_none() && alarm.acknowledged.is_some() {
                    state.live.show(Event::alarm("acknowledged", alarm.clone()));
                }
                cleared(state, &alarm).await;
            }
            Some(alarm) if known.acknowledged.is_none() && alarm.acknowledged.is_some() => {
                state.live.show(Event::alarm("acknowledged", alarm.clone()));
            }
            Some(_) => {}
        }
    }
}

/// The alarm of that number.
async fn listed(state: &AppState, id: i64) -> StoreResult<Option<Alarm>> {
    let page = Page { after: Some(id - 1), limit: 1 };
    let found = state.store.alarms(&AlarmFilter::default(), page).await?;
    Ok(found.into_iter().find(|alarm| alarm.id == id))
}

async fn cleared(state: &AppState, alarm: &Alarm) {
    // An overload is cleared by whoever acknowledges it, perhaps at another server.
    if let (AlarmKind::Overload, Some(machine)) = (alarm.kind, &alarm.machine) {
        overload::settle(state, machine).await;
    }
    state.live.show(Event::alarm_cleared(alarm));
}

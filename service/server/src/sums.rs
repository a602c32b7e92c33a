//! What people registered is held against its sums in the background, again and again: a row that a disk has changed is told before somebody
//! wonders why nothing is advised, and rows of before the sums are summed, as a server of before may run beside this one for a while and
//! write more of them.
//!
//! Page by page, through the writer only where something is to be summed, with pauses that leave live posts most of the time.

use crate::state::AppState;
use feedwright_store::{StoreResult, SummedTo};
use std::collections::BTreeSet;
use std::time::{Duration, Instant};

/// Pauses are so many times as long as what was done before them.
const PAUSES: u32 = 4;
/// The shortest pause.
const LEAST_PAUSE: Duration = Duration::from_millis(10);
/// Between two rounds.
const ROUNDS: Duration = Duration::from_secs(600);
/// Damaged rows that are told one by one; `feedwright check` names them all.
const MOST_TOLD: usize = 1_000;

/// Goes through the rows, again and again, until the shutdown begins.
pub(crate) fn start(state: &AppState) {
    let state = state.clone();
    state.lifecycle.clone().keep("holding sums", move || rounds(state.clone()));
}

async fn rounds(state: AppState) {
    let mut told = BTreeSet::new();
    while !state.lifecycle.is_stopping() {
        match round(&state).await {
            Ok(Some(damaged)) => {
                state.metrics.damaged_rows(damaged.len());
                for row in damaged.difference(&told).take(MOST_TOLD) {
                    tracing::error!(
                        row,
                        "it is not what was written, and nothing is decided by it: put it anew"
                    );
                }
                told = damaged;
            }
            Ok(None) => return,
            Err(error) => tracing::warn!(%error, "rows are not held against their sums for now"),
        }
        rest(&state, ROUNDS).await;
    }
}

/// Goes once through all rows; tells which are damaged. `None` where the shutdown began.
async fn round(state: &AppState) -> StoreResult<Option<BTreeSet<String>>> {
    let (mut after, mut summed, mut damaged) = (None::<SummedTo>, 0, BTreeSet::new());
    while !state.lifecycle.is_stopping() {
        let begun = Instant::now();
        let page = state.store.hold_sums(after.as_ref()).await?;
        if page.unsummed > 0 {
            let from = after.clone();
            summed += state.commit(|store| async move { store.sum_rows(from.as_ref()).await }).await?;
        }
        damaged.extend(page.damaged);
        let Some(next) = page.next else {
            if summed > 0 {
                tracing::info!(rows = summed, "rows that had no sum were summed");
            }
            return Ok(Some(damaged));
        };
        after = Some(next);
        rest(state, (begun.elapsed() * PAUSES).max(LEAST_PAUSE)).await;
    }
    Ok(None)
}

/// Only the waiting is cut short, never a statement.
async fn rest(state: &AppState, pause: Duration) {
    tokio::select! {
        () = tokio::time::sleep(pause) => {}
        () = state.lifecycle.stopping() => {}
    }
}

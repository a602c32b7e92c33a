//! The folds that earlier rules of wear made, those that are behind a change of an operation, and those that were postponed, as far too many
//! cycles had to be folded again for anybody to wait, are made anew in the background; again and again, as a server of before may run beside this one for a while and write more of them, and one that changed an operation may have stopped.
//!
//! A tool that runs is folded again by its next cycle, if that is soon done; one that lies idle would be folded over its whole history each time
//! somebody asks for it. Each is made anew by itself, some thousand cycles at a time, through the same writer and under the same lock as its
//! cycles, and the pause after it leaves live posts most of the time. One with a long history lets all the others go first. Where several servers start on one database, the second finds
//! nothing left to do of a tool.

use crate::state::AppState;
use feedwright_core::ids::ToolId;
use feedwright_store::{FoldKey, Renewed, StoreError, StoreResult};
use std::collections::VecDeque;
use std::pin::pin;
use std::time::{Duration, Instant};
use tokio::sync::Notify;

/// Pauses are so many times as long as what was done before them.
const PAUSES: u32 = 4;
/// The shortest pause.
const LEAST_PAUSE: Duration = Duration::from_millis(10);
/// Pause before a tool is tried again where the database was away.
const AWAY: Duration = Duration::from_secs(10);

/// Between two rounds through the tools, of which all but the first find nothing where no server of before is left.
const ROUNDS: Duration = Duration::from_secs(600);

/// Between the beginnings of two rounds at the least.
const LOOKS: Duration = Duration::from_secs(2);

/// Goes through the tools, again and again, until the shutdown begins.
pub(crate) fn start(state: &AppState) {
    let state = state.clone();
    state.lifecycle.clone().keep("folding again", move || rounds(state.clone()));
}

async fn rounds(state: AppState) {
    let postponed = state.store.folds_postponed();
    loop {
        let begun = Instant::now();
        let goes_on = round(&state, &postponed).await;
        // Each looks at all folds, however few are behind.
        rest(&state, LOOKS.saturating_sub(begun.elapsed())).await;
        if goes_on {
            continue;
        }
        tokio::select! {
            () = tokio::time::sleep(ROUNDS) => {}
            () = state.folds_are_behind.notified() => {}
            () = postponed.notified() => {}
            () = state.lifecycle.stopping() => return,
        }
    }
}

/// Goes once through the tools, and then from one to the next of those that are not done, unless the shutdown begins. Whether there are
/// others by now, which wait for none of these: one that is to be folded from the beginning again and again would keep them waiting for ever.
async fn round(state: &AppState, postponed: &Notify) -> bool {
    let (mut after, mut parts, mut made) = (None, VecDeque::new(), 0_u64);
    let (looked, mut others) = (Instant::now(), false);
    while !state.lifecycle.is_stopping() {
        let begun = Instant::now();
        let pause = match one(state, after.as_ref()).await {
            Ok(Some((tool, renewed))) => {
                made += u64::from(renewed == Renewed::Whole);
                if renewed == Renewed::Part {
                    parts.push_back(tool.clone());
                }
                after = Some(tool);
                (begun.elapsed() * PAUSES).max(LEAST_PAUSE)
            }
            Ok(None) => break,
            Err(error) => {
                tracing::warn!(%error, "folds that are outdated are not made anew for now");
                AWAY
            }
        };
        rest(state, pause).await;
    }
    while let Some(tool) = parts.pop_front()
        && !state.lifecycle.is_stopping()
    {
        let begun = Instant::now();
        let pause = match renew(state, &tool).await {
            Ok(renewed) => {
                made += u64::from(renewed == Renewed::Whole);
                if renewed == Renewed::Part {
                    parts.push_back(tool);
                }
                (begun.elapsed() * PAUSES).max(LEAST_PAUSE)
            }
            Err(error) => {
                tracing::warn!(%error, %tool, "the tool's fold is not made anew for now");
                parts.push_back(tool);
                AWAY
            }
        };
        rest(state, pause).await;
        others |= pin!(postponed.notified()).enable();
        if others && looked.elapsed() > LOOKS {
            break;
        }
    }
    if made > 0 {
        tracing::info!(tools = made, "outdated folds were made anew");
    }
    note_unchanged(state).await;
    others
}

/// Only the waiting is cut short, never a statement.
async fn rest(state: &AppState, pause: Duration) {
    tokio::select! {
        () = tokio::time::sleep(pause) => {}
        () = state.lifecycle.stopping() => {}
    }
}

/// Has those that need not follow a change say so: whoever loads them would ask again what changed.
async fn note_unchanged(state: &AppState) {
    let mut after: Option<FoldKey> = None;
    while !state.lifecycle.is_stopping() {
        let (begun, from) = (Instant::now(), after.clone());
        match state.commit(|store| async move { store.note_unchanged_folds(from.as_ref()).await }).await {
            Ok(Some(last)) => after = Some(last),
            Ok(None) => return,
            Err(error) => {
                return tracing::warn!(%error, "the next round looks again at folds that need not follow a change");
            }
        }
        rest(state, (begun.elapsed() * PAUSES).max(LEAST_PAUSE)).await;
    }
}

/// Makes the next tool's folds anew; says which it was, and what became of them. `None` behind the last.
///
/// # Errors
/// Where the database does not answer: the same tool is next again. What is wrong with one tool alone is logged.
async fn one(state: &AppState, after: Option<&ToolId>) -> StoreResult<Option<(ToolId, Renewed)>> {
    let Some(tool) = state.store.next_outdated_fold(after).await? else {
        return Ok(None);
    };
    let renewed = renew(state, &tool).await?;
    Ok(Some((tool, renewed)))
}

/// Makes a tool's folds anew, as far as is done at a time.
///
/// # Errors
/// Where the database does not answer. What is wrong with the tool alone is logged.
async fn renew(state: &AppState, tool: &ToolId) -> StoreResult<Renewed> {
    let (asked, now) = (tool.clone(), state.clock.now());
    match state.commit(|store| async move { store.renew_fold(&asked, now).await }).await {
        Err(error @ (StoreError::Unavailable(_) | StoreError::OutcomeUnknown(_))) => Err(error),
        Err(error) if error.of_the_disk().is_some() => Err(error),
        Err(error) => {
            tracing::error!(%error, %tool, "the tool's fold is outdated and cannot be made anew");
            Ok(Renewed::Nothing)
        }
        renewed => renewed,
    }
}

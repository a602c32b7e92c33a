//! The folds that earlier rules of wear made, and those that are behind a change of an operation, are made anew in the background; again and
//! again, as a server of before may run beside this one for a while and write more of them, and one that changed an operation may have stopped.
//!
//! A tool that runs is folded again by its next cycle; one that lies idle would be folded over its whole history each time
//! somebody asks for it. Each is made anew by itself, through the same writer and under the same lock as its cycles, and
//! the pause after it leaves live posts most of the time. Where several servers start on one database, the second finds
//! nothing left to do of a tool.

use crate::state::AppState;
use feedwright_core::ids::ToolId;
use feedwright_store::{FoldKey, StoreError, StoreResult};
use std::time::{Duration, Instant};

/// Pauses are so many times as long as what was done before them.
const PAUSES: u32 = 4;
/// The shortest pause.
const LEAST_PAUSE: Duration = Duration::from_millis(10);
/// Pause before a tool is tried again where the database was away.
const AWAY: Duration = Duration::from_secs(10);

/// Between two rounds through the tools, of which all but the first find nothing where no server of before is left.
const ROUNDS: Duration = Duration::from_secs(600);

/// Goes through the tools, again and again, until the shutdown begins.
pub(crate) fn start(state: &AppState) {
    let state = state.clone();
    state.lifecycle.clone().keep("folding again", move || rounds(state.clone()));
}

async fn rounds(state: AppState) {
    loop {
        round(&state).await;
        tokio::select! {
            () = tokio::time::sleep(ROUNDS) => {}
            () = state.folds_are_behind.notified() => {}
            () = state.lifecycle.stopping() => return,
        }
    }
}

/// Goes once through the tools, unless the shutdown begins.
async fn round(state: &AppState) {
    let (mut after, mut made) = (None, 0_u64);
    while !state.lifecycle.is_stopping() {
        let begun = Instant::now();
        let pause = match one(state, after.as_ref()).await {
            Ok(Some((tool, anew))) => {
                made += u64::from(anew);
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
    if made > 0 {
        tracing::info!(tools = made, "outdated folds were made anew");
    }
    note_unchanged(state).await;
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

/// Makes the next tool's folds anew; says which it was, and whether there was anything to do. `None` behind the last.
///
/// # Errors
/// Where the database does not answer: the same tool is next again. What is wrong with one tool alone is logged.
async fn one(state: &AppState, after: Option<&ToolId>) -> StoreResult<Option<(ToolId, bool)>> {
    let Some(tool) = state.store.next_outdated_fold(after).await? else {
        return Ok(None);
    };
    let (asked, now) = (tool.clone(), state.clock.now());
    match state.commit(|store| async move { store.renew_fold(&asked, now).await }).await {
        Ok(anew) => Ok(Some((tool, anew))),
        Err(error @ (StoreError::Unavailable(_) | StoreError::OutcomeUnknown(_))) => Err(error),
        Err(error) if error.of_the_disk().is_some() => Err(error),
        Err(error) => {
            tracing::error!(%error, %tool, "the tool's fold is outdated and cannot be made anew");
            Ok(Some((tool, false)))
        }
    }
}

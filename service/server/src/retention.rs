//! Retention: at intervals, samples that are kept no longer are dropped, a few cycles at a time, and partitions for
//! the months ahead are made. Summaries are kept for ever.

use crate::state::AppState;
use feedwright_store::{Dropped, StoreError, StoreResult};
use std::time::{Duration, Instant};

/// One part in so many of the time between two runs is what a run takes where whoever reads is in the way of dropping partitions.
const SHARE_BESIDE_READERS: u32 = 2;

/// So often samples age: a server that runs for a shorter time lets them age not at all.
const AGING: Duration = Duration::from_secs(600);
const DAY_MS: i64 = 86_400_000;

/// Runs until the shutdown begins.
pub(crate) fn start(state: &AppState) {
    let aged = state.clone();
    state.lifecycle.keep("aging of samples", move || aging(aged.clone()));
    let state = state.clone();
    state.lifecycle.clone().keep("retention", move || runs(state.clone()));
}

/// Runs retention until the shutdown begins.
async fn runs(state: AppState) {
    let mut ticks = state.lifecycle.every(state.config.retention.interval());
    while ticks.next().await {
        if let Err(error) = run(&state).await {
            tracing::warn!(%error, "retention broke off and goes on at its next run");
        }
    }
}

/// Lets samples age until the shutdown begins.
async fn aging(state: AppState) {
    let mut ticks = state.lifecycle.every(AGING);
    // How long no server ran is not known.
    let (mut before, mut is_behind) = (state.clock.moment(), false);
    while ticks.next().await {
        let moment = state.clock.moment();
        let now = state.clock.now();
        match state.store.age_samples(now, moment.since(before)).await {
            Ok(aged_to) => {
                before = moment;
                let days = now.millis_since(aged_to) / DAY_MS;
                let was_behind = std::mem::replace(&mut is_behind, days > 0);
                if is_behind && !was_behind {
                    tracing::warn!(
                        days,
                        "no server ran for as long, or the clock has leapt ahead: what samples are kept for days stays longer, until that is caught up with"
                    );
                } else if was_behind && !is_behind {
                    tracing::info!("samples are as old as the clock tells again");
                }
            }
            // What has gone by counts the next time.
            Err(error) => tracing::warn!(%error, "samples do not age until the next try"),
        }
    }
}

/// One run: everything that is to go by now goes, unless the shutdown begins.
pub async fn run(state: &AppState) -> StoreResult<()> {
    let config = state.config.retention;
    // A reader may be in the way of that for as long as it reads; it is no reason to keep what is to go.
    if let Err(error) = state.store.make_room(state.clock.now()).await {
        tracing::warn!(why = %why(&error), "partitions for the months ahead are made at the next run");
    }
    for decision in state.store.decide_drops(config.samples(), state.clock.now()).await? {
        let (machine, reason) = (&decision.machine, decision.reason.as_str());
        tracing::info!(%machine, reason, "samples are dropped");
        state.metrics.samples_dropping(decision.reason);
    }
    // Nor of one of these, whose cycles then go one by one. As long as a backup reads what goes, finding what is next takes longer
    // and longer: so long, and the rest at the next run.
    let until = match drop_partitions(state).await {
        Ok(()) => None,
        Err(error) => {
            tracing::warn!(why = %why(&error), "partitions are dropped whole at the next run");
            Some(Instant::now() + config.interval() / SHARE_BESIDE_READERS)
        }
    };
    while !state.lifecycle.is_stopping()
        && goes_on(state, state.store.drop_some(config.step_cycles).await?).await
    {
        if until.is_some_and(|until| Instant::now() >= until) {
            tracing::warn!("samples that are to go are left until the next run");
            break;
        }
    }
    Ok(())
}

/// What stands in the way, with its cause.
fn why(error: &StoreError) -> String {
    std::error::Error::source(error).map_or_else(|| error.to_string(), |cause| format!("{error}: {cause}"))
}

async fn drop_partitions(state: &AppState) -> StoreResult<()> {
    while !state.lifecycle.is_stopping()
        && goes_on(state, state.store.drop_partition(state.clock.now()).await?).await
    {}
    Ok(())
}

/// After a step; whether more is to go.
async fn goes_on(state: &AppState, dropped: Dropped) -> bool {
    state.metrics.samples_dropped(dropped);
    if dropped.more {
        // Live posts have the writer between two steps.
        tokio::select! {
            () = tokio::time::sleep(state.config.retention.pause()) => {}
            () = state.lifecycle.stopping() => {}
        }
    }
    dropped.more
}

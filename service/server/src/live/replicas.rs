//! Servers on one PostgreSQL tell each other what they show.
//!
//! Notifications go out in groups, on a connection of their own and outside every transaction that stores cycles:
//! they would serialise its commits. What does not fit or is not delivered shows as a gap, never as silence.

use super::event::{Event, Kind};
use super::{Live, machines};
use crate::state::AppState;
use feedwright_store::Notices;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::time::sleep;

/// How long events are gathered before they are told.
const GATHER: Duration = Duration::from_millis(50);
/// PostgreSQL takes notifications below 8000 bytes.
const MOST_BYTES: usize = 7_800;
/// Waits so long after the connection for listening could not be made.
const RETRY: Duration = Duration::from_secs(2);

#[derive(Serialize, Deserialize)]
struct Told {
    from: String,
    lost: u64,
    /// Whether alarms may have changed at the server; one of an earlier version does not say.
    alarms: Option<bool>,
    events: Vec<ToldEvent>,
}

#[derive(Serialize, Deserialize)]
struct ToldEvent {
    kind: String,
    machine: Option<String>,
    data: Value,
}

/// Listens to other servers until this one stops; ends at once where the store is this server's alone.
pub(super) async fn hear_others(state: AppState) {
    let Some(notices) = state.store.notices() else { return };
    tokio::select! {
        () = listen(&state.live, &*notices) => {}
        () = machines::look(&state) => {}
        () = state.lifecycle.stopping() => {}
    }
}

/// Tells other servers what happens until nothing more does.
pub(super) async fn tell_others(state: AppState) {
    let over = &state.live.over;
    let mut outgoing = state.live.outgoing.lock().await;
    if state.live.told.swap(true, Ordering::Relaxed) {
        // It panicked, with something in hand.
        state.live.untold.fetch_add(1, Ordering::Relaxed);
    }
    loop {
        let first = tokio::select! {
            biased;
            first = outgoing.recv() => first,
            () = over.cancelled() => None,
        };
        let Some(first) = first else { return };
        tokio::select! {
            () = sleep(GATHER) => {}
            () = over.cancelled() => {}
        }
        let mut waiting = vec![first];
        while let Ok(event) = outgoing.try_recv() {
            waiting.push(event);
        }
        for (text, events) in packed(&state.live, waiting) {
            let store = state.store.clone();
            let sent = state.lifecycle.spawn(async move { store.notify(&text).await }).await;
            if !matches!(sent, Ok(Ok(()))) {
                tracing::debug!(events, "other servers could not be told");
                state.live.untold.fetch_add(events, Ordering::Relaxed);
                if over.is_cancelled() {
                    // The leases tell them too, later.
                    return;
                }
            }
        }
    }
}

/// Notifications of bounded size, each with the number of its events.
fn packed(live: &Live, events: Vec<Event>) -> Vec<(String, u64)> {
    let mut texts = Vec::new();
    let mut told = Told { from: live.boot.clone(), lost: 0, alarms: None, events: Vec::new() };
    let mut bytes = 0;
    for event in events {
        let Event { kind, machine, data } = event;
        let event = ToldEvent { kind: kind.as_str().to_owned(), machine, data: data.into_tree() };
        let size = serde_json::to_string(&event).map_or(usize::MAX, |text| text.len() + 1);
        // The frame around the events: a name, a count and brackets.
        let frame = 100;
        if size > MOST_BYTES - frame {
            told.lost += 1;
            continue;
        }
        if bytes + size > MOST_BYTES - frame {
            finish(live, &mut told, &mut texts);
            bytes = 0;
        }
        bytes += size;
        told.events.push(event);
    }
    finish(live, &mut told, &mut texts);
    texts
}

fn finish(live: &Live, told: &mut Told, texts: &mut Vec<(String, u64)>) {
    told.lost += live.untold.swap(0, Ordering::Relaxed);
    told.alarms = Some(live.alarms_untold.swap(false, Ordering::Acquire));
    if let Ok(text) = serde_json::to_string(told) {
        texts.push((text, told.events.len() as u64 + told.lost));
    }
    told.events.clear();
    told.lost = 0;
}

async fn listen(live: &Live, notices: &dyn Notices) {
    let mut was_listening = false;
    loop {
        match notices.listen().await {
            Ok(mut listener) => {
                if was_listening {
                    live.show(Event::gap("replicas_unheard", None));
                }
                was_listening = true;
                loop {
                    match listener.next().await {
                        Ok(text) => hear(live, &text),
                        Err(error) => {
                            tracing::warn!(%error, "other servers cannot be heard");
                            break;
                        }
                    }
                }
            }
            Err(error) => tracing::warn!(%error, "other servers cannot be heard"),
        }
        sleep(RETRY).await;
    }
}

fn hear(live: &Live, text: &str) {
    let Ok(told) = serde_json::from_str::<Told>(text) else {
        live.show(Event::gap("replica_not_understood", None));
        return;
    };
    if told.from == live.boot {
        return;
    }
    // What was lost may have said so. The others are told by whoever has changed them.
    if told.alarms != Some(false) || told.lost > 0 {
        live.alarms_due.notify_one();
    }
    if told.lost > 0 {
        live.show(Event::gap("replica_lost_some", Some(told.lost)));
    }
    for ToldEvent { kind, machine, data } in told.events {
        match Kind::parse(&kind) {
            Some(kind) => live.show_of(Event { kind, machine, data: data.into() }, &told.from),
            // A newer server may tell of more than this one knows.
            None => tracing::debug!(kind, "an event of a kind that is not known"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::LiveConfig;
    use futures_util::FutureExt;

    /// Posts that change no alarms are told all the time.
    #[test]
    fn alarms_are_looked_at_where_another_server_says_so_or_may_not_have() {
        let config =
            LiveConfig { readers: 1, history_events: 10, heartbeat_ms: 1000, sample_interval_ms: 100 };
        let live = Live::new(&config);
        let is_due = |text: &str| {
            hear(&live, text);
            live.alarms_due.notified().now_or_never().is_some()
        };
        for (text, due) in [
            (r#"{"from": "another", "lost": 0, "alarms": false, "events": []}"#, false),
            (r#"{"from": "another", "lost": 0, "alarms": true, "events": []}"#, true),
            (r#"{"from": "another", "lost": 1, "alarms": false, "events": []}"#, true),
            (r#"{"from": "a former version", "lost": 0, "events": []}"#, true),
        ] {
            assert_eq!(is_due(text), due, "{text}");
        }
        // It tells of its own changes once, and nothing of those it heard of.
        let told =
            |live: &Live| packed(live, vec![Event::changed("tools")])[0].0.contains(r#""alarms":true"#);
        assert!(!told(&live));
        live.alarms_may_have_changed();
        assert!(told(&live) && !told(&live));
    }
}

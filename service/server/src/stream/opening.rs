//! Before the upgrade: who may open a stream, and whether there is room.

use super::connection::serve;
use super::finish::connection_gone;
use super::slots::Ownership;
use super::{SUBPROTOCOL, leases};
use crate::auth::Caller;
use crate::config::SecondStream;
use crate::http::once::{Repeated, once};
use crate::http::problem::Problem;
use crate::state::AppState;
use axum::extract::ws::WebSocketUpgrade;
use axum::response::Response;
use feedwright_core::ids::MachineId;
use feedwright_store::StreamLease;
use http::{HeaderMap, StatusCode, header};
use std::time::Duration;

/// The default of 128 KiB costs twice the time of a message; a message of samples is a few hundred bytes.
const READ_BUFFER: usize = 4096;
/// The longest answer is that to a stored cycle, tens of kilobytes; beyond this a machine does not read.
const WRITE_BUFFER: usize = 1024 * 1024;

/// Refuses a browser's page of another site: it would come with the rights of whoever looks at it.
pub fn check_origin(headers: &HeaderMap, allowed: &[String]) -> Result<(), Problem> {
    let origin = match once(headers, header::ORIGIN) {
        Ok(None) => return Ok(()),
        Ok(Some(origin)) => origin.to_str().unwrap_or_default(),
        Err(Repeated) => "",
    };
    let host = headers.get(header::HOST).and_then(|host| host.to_str().ok()).unwrap_or_default();
    let own =
        origin.split_once("://").is_some_and(|(_, site)| !host.is_empty() && site.eq_ignore_ascii_case(host));
    if own || allowed.iter().any(|allowed| allowed.eq_ignore_ascii_case(origin)) {
        return Ok(());
    }
    Err(Problem::new(StatusCode::FORBIDDEN, "origin_not_allowed", "streams are not opened from other sites"))
}

/// Answers the wish to open a machine's stream: the upgrade, or why not.
pub async fn open(
    state: &AppState,
    caller: Caller,
    machine: MachineId,
    headers: &HeaderMap,
    upgrade: Result<WebSocketUpgrade, StatusCode>,
) -> Result<Response, Problem> {
    let config = &state.config.stream;
    check_origin(headers, &config.origins())?;
    let upgrade = upgrade.map_err(|status| {
        let status = if status == StatusCode::UPGRADE_REQUIRED { status } else { StatusCode::BAD_REQUEST };
        Problem::new(status, "websocket_required", "open it as a WebSocket, RFC 6455")
            .header(header::UPGRADE, http::HeaderValue::from_static("websocket"))
    })?;
    if !upgrade.requested_protocols().any(|protocol| protocol == SUBPROTOCOL) {
        let detail = "name the subprotocol feedwright.v1 in Sec-WebSocket-Protocol";
        return Err(Problem::bad_request("subprotocol_required", detail));
    }
    if state.lifecycle.is_stopping() {
        return Err(Problem::unavailable("shutting_down", "the service is shutting down", 5));
    }
    // One that is damaged is there: its streams are neutral.
    if !state.intake.knows(&machine).await? {
        let detail = format!("there is no machine `{machine}`");
        return Err(Problem::new(StatusCode::NOT_FOUND, "unknown_machine", detail));
    }
    let place = state
        .streams
        .place()
        .ok_or_else(|| Problem::unavailable("too_many_streams", "too many streams are open already", 5))?;
    let takeover = config.second() == SecondStream::Takeover;
    let opening = state
        .streams
        .open(&machine, !takeover)
        .ok_or_else(|| held(Duration::from_millis(config.lease_ms)))?;
    let (asked, now) = (state.clock.moment(), state.clock.now());
    let (streams, wanted, lease, wish) =
        (state.streams.clone(), machine.clone(), config.lease(), opening.wish());
    let taken = state
        .commit(|store| async move {
            let taken = store.take_stream(&wanted, streams.holder(), takeover, lease, now).await?;
            // Whoever asked may be gone by now, and whoever is connected, or is next, goes on with it.
            if let StreamLease::Taken { generation } = taken {
                streams.took(&wanted, generation);
                if wish.strong_count() == 0 && !streams.is_wished(&wanted) {
                    store.release_stream(&wanted, streams.holder(), generation).await?;
                }
            }
            Ok(taken)
        })
        .await?;
    let generation = match taken {
        StreamLease::Taken { generation } => generation,
        StreamLease::Held { wait } => return Err(held(wait)),
    };
    let believed_until = leases::believed_until(state, asked);
    let ownership: Ownership = state.streams.own(&machine, generation, believed_until);
    drop(opening);
    let failed = (state.clone(), ownership.clone());
    // Counted before the upgrade, so that a shutdown in between waits for it.
    let (tracked, state) = (state.lifecycle.track(), state.clone());
    Ok(upgrade
        .protocols([SUBPROTOCOL])
        .read_buffer_size(READ_BUFFER)
        // Written at once: an answer that waits for more to come is late.
        .write_buffer_size(0)
        .max_write_buffer_size(WRITE_BUFFER)
        .max_message_size(config.message_bytes)
        .max_frame_size(config.message_bytes)
        .on_failed_upgrade(move |error| {
            tracing::debug!(%error, "a stream was not upgraded");
            let (state, ownership) = failed;
            // A cycle that was left there is waited for as after any connection.
            let gone = state.clone();
            state.lifecycle.spawn(async move { connection_gone(&gone, &ownership).await });
        })
        .on_upgrade(move |socket| async move {
            serve(state, caller, ownership, socket).await;
            drop((place, tracked));
        }))
}

fn held(wait: Duration) -> Problem {
    let detail = "another stream of this machine is open; it is free when that one closes or its lease ends";
    Problem::new(StatusCode::CONFLICT, "stream_held", detail).retry_after(wait)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(host: &str, origin: Option<&str>, allowed: &[&str]) -> bool {
        let mut headers = HeaderMap::new();
        headers.insert(header::HOST, host.parse().unwrap());
        if let Some(origin) = origin {
            headers.insert(header::ORIGIN, origin.parse().unwrap());
        }
        let allowed: Vec<String> = allowed.iter().map(|origin| (*origin).to_owned()).collect();
        check_origin(&headers, &allowed).is_ok()
    }

    #[test]
    fn only_the_own_site_and_those_that_are_allowed_open_streams() {
        assert!(checked("cell:7878", None, &[]), "a machine sends none");
        assert!(checked("cell:7878", Some("http://cell:7878"), &[]));
        assert!(checked("cell:7878", Some("https://mes.example"), &["https://mes.example"]));
        for foreign in ["http://evil.example", "http://cell", "http://cell:78780", "null", "cell:7878", ""] {
            assert!(!checked("cell:7878", Some(foreign), &[]), "{foreign}");
        }
        let mut headers = HeaderMap::new();
        headers.insert(header::HOST, "cell:7878".parse().unwrap());
        for origin in ["http://cell:7878", "http://evil.example"] {
            headers.append(header::ORIGIN, origin.parse().unwrap());
        }
        assert!(check_origin(&headers, &[]).is_err(), "said twice");
    }
}

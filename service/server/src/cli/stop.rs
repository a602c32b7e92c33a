//! Commands that are told to stop by a signal, and leave nothing half made.

use crate::replay::progress::tell;
use std::future::Future;
use std::io;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio_util::sync::CancellationToken;

/// What tells a command to stop. From the first of these on a signal ends no process by itself any more.
pub(super) struct Stop([io::Result<Signal>; 3]);

impl Stop {
    /// Hears every signal that comes from here on.
    pub(super) fn listen() -> Self {
        Self([SignalKind::terminate(), SignalKind::interrupt(), SignalKind::hangup()].map(signal))
    }

    /// Waits for one.
    pub(super) async fn told(&mut self) {
        let [terminate, interrupt, hangup] = &mut self.0;
        tokio::select! {
            () = told(terminate) => {}
            () = told(interrupt) => {}
            () = told(hangup) => {}
        }
    }
}

/// Waits for a signal; for ever where it cannot be listened to.
async fn told(signal: &mut io::Result<Signal>) {
    match signal {
        Ok(signal) => drop(signal.recv().await),
        Err(_) => std::future::pending().await,
    }
}

/// What the first signal cancels, for a command that puts in order what it leaves at a server. A second one ends the process
/// at once: whoever waits for a server that is gone need not. A hangup is not listened to: such a command may go on for hours
/// after its terminal was closed, under nohup.
pub(super) fn once_and_twice() -> CancellationToken {
    let told = CancellationToken::new();
    let [mut terminate, mut interrupt] = [SignalKind::terminate(), SignalKind::interrupt()].map(signal);
    tokio::spawn({
        let told = told.clone();
        async move {
            either(&mut terminate, &mut interrupt).await;
            tell("told to stop: its tokens are revoked first; once more ends it at once");
            told.cancel();
            either(&mut terminate, &mut interrupt).await;
            std::process::exit(1)
        }
    });
    told
}

async fn either(first: &mut io::Result<Signal>, second: &mut io::Result<Signal>) {
    tokio::select! {
        () = told(first) => {}
        () = told(second) => {}
    }
}

/// Ends the process that was told to stop.
pub(super) fn end() -> ! {
    tracing::error!("it was told to stop");
    std::process::exit(1)
}

/// Runs something that leaves nothing half made where it is dropped: a signal drops it, and ends the process.
pub(super) async fn or_dropped<T>(work: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    let mut stop = Stop::listen();
    let outcome = tokio::select! {
        outcome = work => Some(outcome),
        () = stop.told() => None,
    };
    // The other of the two is dropped by now.
    outcome.unwrap_or_else(|| end())
}

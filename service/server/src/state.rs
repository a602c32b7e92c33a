//! What every handler reaches: the store, the clock, the configuration, the metrics and the life of the process.

use crate::auth::{FailedAuthentications, KnownTokens};
use crate::clock::Clock;
use crate::config::Config;
use crate::http::export::Exports;
use crate::ingest::intake::CycleIntake;
use crate::jobs::Jobs;
use crate::lifecycle::Lifecycle;
use crate::live::Live;
use crate::metrics::Metrics;
use crate::readiness::Readiness;
use crate::stream::Streams;
use crate::watch::WearTurn;
use feedwright_store::{Store, StoreError, StoreResult};
use std::future::Future;
use std::ops::Deref;
use std::sync::Arc;
use tokio::sync::Notify;

/// What every handler reaches; cheap to clone.
#[derive(Clone)]
pub struct AppState(Arc<Shared>);

/// The parts of an [`AppState`].
pub struct Shared {
    /// The configuration in force.
    pub config: Config,
    /// The store. Changes go through [`AppState::commit`].
    pub store: Arc<dyn Store>,
    /// The clock.
    pub clock: Clock,
    /// The metrics.
    pub metrics: Arc<Metrics>,
    /// Where cycles are taken in.
    pub intake: Arc<CycleIntake>,
    /// Tasks that outlive their request, and the state of the process.
    pub lifecycle: Lifecycle,
    /// What is shown to those who watch.
    pub live: Arc<Live>,
    /// The machines' streams.
    pub streams: Arc<Streams>,
    /// Long computations.
    pub jobs: Jobs,
    /// Large answers under way.
    pub exports: Exports,
    /// Who failed to authenticate, how often.
    pub(crate) failed_authentications: FailedAuthentications,
    /// Tokens that were good a moment ago.
    pub(crate) known_tokens: KnownTokens,
    /// Whether the database takes writes.
    pub(crate) readiness: Readiness,
    /// Whose wear the watch reads next.
    pub(crate) wear_turn: WearTurn,
    /// Told when folds may be behind a change of an operation: they are made anew in the background.
    pub(crate) folds_are_behind: Notify,
}

impl Deref for AppState {
    type Target = Shared;
    fn deref(&self) -> &Shared {
        &self.0
    }
}

impl AppState {
    /// Puts the parts together.
    pub fn new(
        config: Config,
        store: Arc<dyn Store>,
        clock: Clock,
        metrics: Arc<Metrics>,
        intake: Arc<CycleIntake>,
        lifecycle: Lifecycle,
    ) -> Self {
        let failed_authentications = FailedAuthentications::new(config.server.failed_auth_per_minute);
        let readiness = Readiness::default();
        let live = intake.live().clone();
        let streams = Streams::new(&config.stream);
        Self(Arc::new(Shared {
            config,
            store,
            clock,
            metrics,
            intake,
            lifecycle,
            live,
            streams,
            jobs: Jobs::default(),
            exports: Exports::default(),
            failed_authentications,
            known_tokens: KnownTokens::default(),
            readiness,
            wear_turn: WearTurn::default(),
            folds_are_behind: Notify::new(),
        }))
    }

    /// Runs a change of the database in a task of its own and waits for it: a client that hangs up drops its
    /// handler, and a transaction that is dropped half-way leaves its connection in an unknown state.
    pub async fn commit<T, F>(&self, change: impl FnOnce(Arc<dyn Store>) -> F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: Future<Output = StoreResult<T>> + Send + 'static,
    {
        let outcome = self.lifecycle.spawn(change(self.store.clone())).await;
        let result = outcome.unwrap_or_else(|error| Err(StoreError::OutcomeUnknown(Box::new(error))));
        if let Err(error) = &result {
            self.lifecycle.heed(error);
        }
        result
    }
}

//! The server as a value: started, reached at its address, and shut down in a fixed order.
//!
//! Shutdown, in this order and nowhere else: intake (listeners close, no new requests), queue (what was taken in is
//! written), writer (it ends), sockets (answered requests leave, the rest is cut), link (other servers are told of streams that ended
//! with them), pool (the store closes).

mod accept;
mod body;
mod stream;

pub use body::BodyTooSlow;

use crate::auth::Issued;
use crate::clock::Clock;
use crate::config::Config;
use crate::http;
use crate::ingest::intake::CycleIntake;
use crate::lifecycle::Lifecycle;
use crate::live::Link;
use crate::metrics::Metrics;
use crate::state::AppState;
use crate::tls::{self, Certificates, TlsError};
use accept::{Acceptor, OF_METRICS};
use feedwright_store::{Actor, Page, Role, Store, StoreError};
use secrecy::SecretString;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpSocket};
use tokio_rustls::TlsAcceptor;

/// Why a server does not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The address is taken or not ours.
    #[error("cannot listen on {address}")]
    Listen {
        /// Which address.
        address: SocketAddr,
        /// Why.
        source: std::io::Error,
    },
    /// The store fails.
    #[error("the database does not work")]
    Store(#[from] StoreError),
    /// A metric is registered twice.
    #[error("the metrics cannot be registered")]
    Metrics(#[from] prometheus::Error),
    /// Certificate and key cannot be used.
    #[error("the API cannot speak TLS")]
    Tls(#[from] TlsError),
    /// The system has no randomness for the first token.
    #[error("the system has no randomness")]
    Randomness(#[from] getrandom::Error),
}

/// Why a shutdown was not clean.
#[derive(Debug, thiserror::Error)]
pub enum ShutdownError {
    /// It took longer than configured; what was not acknowledged may not be committed.
    #[error("the shutdown took longer than configured")]
    TooLate,
    /// A part of it panicked.
    #[error("the shutdown failed")]
    Failed(#[from] tokio::task::JoinError),
}

/// Starts servers.
#[derive(Debug)]
pub struct Server;

impl Server {
    /// Listens and serves. On a store without any token it makes an admin's, which is found in the result, once.
    pub async fn start(
        config: Config,
        store: Arc<dyn Store>,
        clock: Clock,
    ) -> Result<RunningServer, StartError> {
        Ok(Self::listen(config, store, clock).await?.serve())
    }

    /// Listens: whoever connects waits until it [serves](ListeningServer::serve), so that nobody finds it ready before its first token
    /// is where it is to be found.
    pub async fn listen(
        config: Config,
        store: Arc<dyn Store>,
        clock: Clock,
    ) -> Result<ListeningServer, StartError> {
        tls::use_ring();
        let listener = listen(config.server.listen)?;
        let metrics_listener = match config.metrics.listen {
            Some(address) => Some(listen(address)?),
            None => None,
        };
        let metrics = Arc::new(Metrics::new(config.limits.metric_machines)?);
        let certificates = match config.tls.is_on() {
            true => Some(Certificates::load(&config.tls, metrics.clone())?),
            false => None,
        };
        let acceptor_of_tls = certificates.as_ref().map(Certificates::acceptor).transpose()?;
        let local_addr = address(&listener, config.server.listen)?;
        let metrics_addr = match (&metrics_listener, config.metrics.listen) {
            (Some(listener), Some(asked)) => Some(address(listener, asked)?),
            _ => None,
        };
        // After all that may fail: it is shown once.
        let first_admin_token = first_admin_token(&store, &clock).await?;
        Ok(ListeningServer {
            local_addr,
            metrics_addr,
            first_admin_token,
            listeners: (listener, metrics_listener),
            certificates,
            acceptor_of_tls,
            parts: (config, store, clock, metrics),
        })
    }
}

/// A server that listens and does not serve yet.
pub struct ListeningServer {
    /// Where the API will be reached.
    pub local_addr: SocketAddr,
    /// Where metrics will be reached without a token, where that is configured.
    pub metrics_addr: Option<SocketAddr>,
    /// The admin's token that was made at the first start. It is nowhere else.
    pub first_admin_token: Option<SecretString>,
    listeners: (TcpListener, Option<TcpListener>),
    certificates: Option<Arc<Certificates>>,
    acceptor_of_tls: Option<TlsAcceptor>,
    parts: (Config, Arc<dyn Store>, Clock, Arc<Metrics>),
}

impl ListeningServer {
    /// Serves.
    pub fn serve(self) -> RunningServer {
        let Self { local_addr, metrics_addr, first_admin_token, certificates, acceptor_of_tls, .. } = self;
        let ((listener, metrics_listener), (config, store, clock, metrics)) = (self.listeners, self.parts);
        let lifecycle = Lifecycle::default();
        let intake = Arc::new(CycleIntake::start(&config, &store, &clock, &lifecycle, &metrics));
        let state = AppState::new(config, store, clock, metrics, intake, lifecycle);
        crate::retention::start(&state);
        crate::refold::start(&state);
        crate::sums::start(&state);
        let link = crate::live::start(&state);
        crate::stream::start(&state);
        crate::watch::start(&state);
        if let Some(certificates) = &certificates {
            tls::watch(&state, certificates.clone());
        }
        let acceptor = Acceptor::new(state.clone());
        let most = state.config.server.max_connections;
        acceptor.accept(listener, most, http::router(state.clone()), acceptor_of_tls);
        if let Some(listener) = metrics_listener {
            acceptor.accept(listener, OF_METRICS, http::metrics_router(state.clone()), None);
        }
        RunningServer { local_addr, metrics_addr, first_admin_token, state, acceptor, certificates, link }
    }
}

/// Connections that may wait to be accepted, where the kernel permits as many: after a restart every machine of a shop
/// comes at once, and what does not fit is dropped without a word.
const WAITING: u32 = 4096;

fn listen(address: SocketAddr) -> Result<TcpListener, StartError> {
    let listening = || {
        let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
        // A service that is started again does not wait for connections of the last one to be forgotten.
        socket.set_reuseaddr(true)?;
        socket.bind(address)?;
        socket.listen(WAITING)
    };
    listening().map_err(|source| StartError::Listen { address, source })
}

fn address(listener: &TcpListener, asked: SocketAddr) -> Result<SocketAddr, StartError> {
    listener.local_addr().map_err(|source| StartError::Listen { address: asked, source })
}

/// How long after an unknown outcome it is looked for again.
const LOOK_AGAIN: Duration = Duration::from_secs(1);

/// Makes an admin's token where there is none at all: otherwise nobody could ever make one.
async fn first_admin_token(
    store: &Arc<dyn Store>,
    clock: &Clock,
) -> Result<Option<SecretString>, StartError> {
    if !store.tokens(Page { after: None, limit: 1 }).await?.is_empty() {
        return Ok(None);
    }
    let issued = Issued::new("first start", Role::Admin, None, clock)?;
    let actor = Actor { token: "cli".to_owned(), role: Role::Admin };
    let mut unknown = false;
    loop {
        match store.create_first_token(issued.record.clone(), &actor).await {
            Ok(true) => return Ok(Some(issued.text)),
            Ok(false) if !unknown => return Ok(None),
            // It may have been this one: nobody else would ever be told of it.
            Ok(false) => {
                let stored = store.tokens(Page { after: None, limit: 100 }).await?;
                return Ok(stored.iter().any(|token| token.id == issued.record.id).then_some(issued.text));
            }
            Err(StoreError::OutcomeUnknown(why)) => {
                tracing::warn!(%why, "it is not known whether the first token is stored: looking again");
                unknown = true;
            }
            Err(StoreError::Unavailable(_)) if unknown => {}
            Err(error) => return Err(error.into()),
        }
        tokio::time::sleep(LOOK_AGAIN).await;
    }
}

/// A server that serves.
pub struct RunningServer {
    /// Where the API is reached.
    pub local_addr: SocketAddr,
    /// Where metrics are reached without a token, where that is configured.
    pub metrics_addr: Option<SocketAddr>,
    /// The admin's token that was made at the first start. It is nowhere else.
    pub first_admin_token: Option<SecretString>,
    state: AppState,
    acceptor: Acceptor,
    certificates: Option<Arc<Certificates>>,
    link: Link,
}

impl RunningServer {
    /// What its handlers reach.
    pub const fn state(&self) -> &AppState {
        &self.state
    }

    /// Reads the certificate again, where there is one, and takes it over where it can be used.
    pub async fn reload(&self) {
        match &self.certificates {
            Some(certificates) => tls::look(certificates, true).await,
            None => tracing::info!("nothing to reload: the service speaks plain HTTP"),
        }
    }

    /// Ends when the server cannot do its work any more, with the reason; the caller shuts it down then.
    pub async fn failed(&self) -> String {
        self.state.lifecycle.failed().await
    }

    /// Shuts down in the order that this module's doc gives, within the configured time.
    pub async fn shutdown(self) -> Result<(), ShutdownError> {
        let limit = self.state.config.server.shutdown_timeout();
        // A task of its own: the time limit gives up waiting, it cancels no database future.
        let steps = tokio::spawn(self.shut_down_in_order());
        match tokio::time::timeout(limit, steps).await {
            Ok(ended) => Ok(ended?),
            Err(_) => Err(ShutdownError::TooLate),
        }
    }

    async fn shut_down_in_order(self) {
        let Self { state, acceptor, link, .. } = self;
        tracing::info!("shutting down");
        state.lifecycle.stop();
        acceptor.listeners_closed().await;
        state.intake.drain().await;
        // Half of the time belongs to clients that still read their answers; the other half to the store.
        acceptor.close(state.config.server.shutdown_timeout() / 2).await;
        state.lifecycle.tasks_ended().await;
        link.end(&state.live).await;
        state.store.close().await;
        tracing::info!("shut down");
    }
}

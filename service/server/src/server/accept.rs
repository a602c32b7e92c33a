//! The accept loop: a bound on connections, and on the time a silent one is kept.

use super::body::TimedBody;
use super::stream::TimedStream;
use crate::auth::Peer;
use crate::state::AppState;
use axum::Router;
use axum::body::Body;
use http::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio_rustls::TlsAcceptor;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt;

/// Largest head of a request, and how much of a body is buffered by the connection.
const BUFFER: usize = 64 * 1024;
/// Bytes of answers that wait in the system to be sent, beyond what the client has room for.
#[cfg(any(target_os = "linux", target_os = "android"))]
const UNSENT: u32 = 64 * 1024;
/// Waits so long after a failed accept: out of file descriptors is not cured by asking again at once.
const AFTER_FAILED_ACCEPT: Duration = Duration::from_millis(100);

/// Connections to the metrics' own listener: a Prometheus or two, and somebody who looks. They are beside those to the API: where
/// all of these are taken is what the metrics are to tell.
pub(super) const OF_METRICS: usize = 16;

/// Accepts connections and serves them.
#[derive(Clone)]
pub(super) struct Acceptor {
    state: AppState,
    listeners: TaskTracker,
    connections: TaskTracker,
    cut: CancellationToken,
}

impl Acceptor {
    pub(super) fn new(state: AppState) -> Self {
        Self {
            state,
            listeners: TaskTracker::new(),
            connections: TaskTracker::new(),
            cut: CancellationToken::new(),
        }
    }

    /// Serves what connects to `listener`, at most so many at a time and over TLS where there is an acceptor for it, until the
    /// shutdown begins. The permit of the next one is held while it is waited for: listeners do not share theirs.
    pub(super) fn accept(
        &self,
        listener: TcpListener,
        most: usize,
        router: Router,
        tls: Option<TlsAcceptor>,
    ) {
        let permits = Arc::new(Semaphore::new(most));
        let (this, stopping) = (self.clone(), self.state.clone());
        self.listeners.spawn(async move {
            tokio::select! {
                () = this.accept_forever((&listener, &permits), &router, tls.as_ref()) => {}
                () = stopping.lifecycle.stopping() => {}
            }
        });
    }

    async fn accept_forever(
        &self,
        (listener, permits): (&TcpListener, &Arc<Semaphore>),
        router: &Router,
        tls: Option<&TlsAcceptor>,
    ) {
        loop {
            // The permit comes first: beyond the bound, connections wait in the kernel's backlog, which is bounded.
            let Ok(permit) = permits.clone().acquire_owned().await else { return };
            match listener.accept().await {
                Ok((stream, peer)) => {
                    let (this, router, tls) = (self.clone(), router.clone(), tls.cloned());
                    self.connections.spawn(async move {
                        let open = this.state.metrics.connections();
                        open.inc();
                        tokio::select! {
                            () = this.serve(stream, peer, router, tls) => {}
                            () = this.cut.cancelled() => tracing::warn!(%peer, "connection cut at shutdown"),
                        }
                        open.dec();
                        drop(permit);
                    });
                }
                Err(error) => {
                    tracing::warn!(%error, "cannot accept");
                    tokio::time::sleep(AFTER_FAILED_ACCEPT).await;
                }
            }
        }
    }

    async fn serve(&self, stream: TcpStream, peer: SocketAddr, router: Router, tls: Option<TlsAcceptor>) {
        // Answers are small and wanted at once.
        let _ = stream.set_nodelay(true);
        // The system asks for more as the client reads, and not when a third of some megabytes has gone: who reads slowly would
        // be taken for one who does not read.
        #[cfg(any(target_os = "linux", target_os = "android"))]
        let _ = socket2::SockRef::from(&stream).set_tcp_notsent_lowat(UNSENT);
        // Below TLS, which takes some of an answer before the client has read any of it.
        let stream = TimedStream::new(stream, self.state.config.server.body_stall_timeout());
        let Some(tls) = tls else { return self.serve_http(stream, peer, router).await };
        let patience = self.state.config.tls.handshake_timeout();
        // The handshake has its connection's permit already: silent ones are as bounded as silent requests.
        match tokio::time::timeout(patience, tls.accept(stream)).await {
            Ok(Ok(stream)) => self.serve_http(stream, peer, router).await,
            Ok(Err(error)) => {
                self.state.metrics.handshake_failed();
                tracing::debug!(%peer, %error, "TLS handshake failed");
            }
            Err(_) => {
                self.state.metrics.handshake_failed();
                tracing::debug!(%peer, "TLS handshake took too long");
            }
        }
    }

    async fn serve_http<S>(&self, stream: S, peer: SocketAddr, router: Router)
    where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    {
        let config = &self.state.config.server;
        let (stall, total) = (config.body_stall_timeout(), config.body_read_timeout());
        let service = service_fn(move |request: Request<Incoming>| {
            let mut request = request.map(|body| Body::new(TimedBody::new(body, stall, total)));
            request.extensions_mut().insert(Peer(peer));
            router.clone().oneshot(request)
        });
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(config.header_read_timeout())
            .max_buf_size(BUFFER)
            .serve_connection(TokioIo::new(stream), service)
            .with_upgrades();
        let mut connection = pin!(connection);
        let ended = tokio::select! {
            ended = connection.as_mut() => ended,
            () = self.state.lifecycle.stopping() => {
                connection.as_mut().graceful_shutdown();
                connection.await
            }
        };
        if let Err(error) = ended {
            tracing::debug!(%peer, %error, "connection ended");
        }
    }

    /// Ends when nothing new is accepted.
    pub(super) async fn listeners_closed(&self) {
        self.listeners.close();
        self.listeners.wait().await;
    }

    /// Waits for the connections; cuts those that are left after `patience`.
    pub(super) async fn close(&self, patience: Duration) {
        self.connections.close();
        if tokio::time::timeout(patience, self.connections.wait()).await.is_err() {
            self.cut.cancel();
            self.connections.wait().await;
        }
    }
}

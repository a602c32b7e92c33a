//! TLS on real sockets: served, bounded, and its certificates changed while it is busy.

use super::app::{NOW, config};
use feedwright_server::clock::Clock;
use feedwright_server::database::{self, Database};
use feedwright_server::server::{RunningServer, Server, StartError};
use rcgen::{CertificateParams, KeyPair};
use secrecy::ExposeSecret;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

/// What should happen at once does not take longer than this on a busy machine.
const LONG: Duration = Duration::from_secs(20);

/// A self-signed certificate for localhost with its key.
struct Identity {
    certificate: CertificateDer<'static>,
    certificate_pem: String,
    key_pem: String,
}

impl Identity {
    fn new() -> Self {
        let key = KeyPair::generate().unwrap();
        let certificate =
            CertificateParams::new(vec!["localhost".to_owned()]).unwrap().self_signed(&key).unwrap();
        Self {
            certificate: certificate.der().clone(),
            certificate_pem: certificate.pem(),
            key_pem: key.serialize_pem(),
        }
    }
}

struct Secured {
    server: RunningServer,
    address: SocketAddr,
    token: String,
    certificate: PathBuf,
    key: PathBuf,
    _database: Database,
    _dir: TempDir,
}

impl Secured {
    async fn start(identity: &Identity, settings: &[(&str, &str)]) -> Self {
        let dir = TempDir::new().unwrap();
        let (certificate, key) = (dir.path().join("chain.pem"), dir.path().join("key.pem"));
        std::fs::write(&certificate, &identity.certificate_pem).unwrap();
        std::fs::write(&key, &identity.key_pem).unwrap();
        let (chain, private) = (certificate.to_str().unwrap(), key.to_str().unwrap());
        let mut all = vec![("tls.certificate", chain), ("tls.key", private)];
        all.extend(settings);
        let config = config(&dir, &all);
        let database = database::open(&config).await.unwrap();
        let server = Server::start(config, database.store.clone(), Clock::fixed(NOW)).await.unwrap();
        let token = server.first_admin_token.as_ref().unwrap().expose_secret().to_owned();
        let address = server.local_addr;
        Self { server, address, token, certificate, key, _database: database, _dir: dir }
    }

    fn install(&self, certificate: &Identity, key: &Identity) {
        std::fs::write(&self.certificate, &certificate.certificate_pem).unwrap();
        std::fs::write(&self.key, &key.key_pem).unwrap();
    }

    /// The metrics' line of that name.
    async fn metric(&self, trusted: &[&Identity], name: &str) -> String {
        let head = format!("authorization: Bearer {}\r\n", self.token);
        let answer = ask(self.address, trusted, "/metrics", &head).await.unwrap();
        let line = answer.lines().find(|line| line.starts_with(name));
        line.unwrap_or_else(|| panic!("{name} is not in {answer}")).to_owned()
    }
}

async fn connect(address: SocketAddr, trusted: &[&Identity]) -> std::io::Result<TlsStream<TcpStream>> {
    secure(TcpStream::connect(address).await?, trusted).await
}

async fn secure(stream: TcpStream, trusted: &[&Identity]) -> std::io::Result<TlsStream<TcpStream>> {
    let mut roots = RootCertStore::empty();
    for identity in trusted {
        roots.add(identity.certificate.clone()).unwrap();
    }
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let name = ServerName::try_from("localhost").unwrap();
    TlsConnector::from(Arc::new(config)).connect(name, stream).await
}

/// A whole answer over a connection of its own.
async fn ask(address: SocketAddr, trusted: &[&Identity], path: &str, head: &str) -> std::io::Result<String> {
    let mut stream = connect(address, trusted).await?;
    let request = format!("GET {path} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n{head}\r\n");
    stream.write_all(request.as_bytes()).await?;
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).await?;
    Ok(String::from_utf8_lossy(&answer).into_owned())
}

/// The certificate that is served now.
async fn served(address: SocketAddr, trusted: &[&Identity]) -> CertificateDer<'static> {
    let stream = connect(address, trusted).await.unwrap();
    stream.get_ref().1.peer_certificates().unwrap()[0].clone()
}

#[tokio::test]
async fn it_speaks_tls_and_to_plain_http_nothing() {
    let identity = Identity::new();
    let secured = Secured::start(&identity, &[]).await;
    let answer = ask(secured.address, &[&identity], "/healthz", "").await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    let stranger = Identity::new();
    assert!(connect(secured.address, &[&stranger]).await.is_err(), "another authority is not believed");

    let mut plain = TcpStream::connect(secured.address).await.unwrap();
    plain.write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n").await.unwrap();
    let mut answer = Vec::new();
    // A reset closes just as well.
    let _ = tokio::time::timeout(LONG, plain.read_to_end(&mut answer)).await.unwrap();
    assert!(!answer.starts_with(b"HTTP"), "{}", String::from_utf8_lossy(&answer));

    let end = secured.metric(&[&identity], "feedwright_tls_certificate_not_after_timestamp_seconds").await;
    // rcgen's certificates end in 4096.
    let seconds: f64 = end.rsplit(' ').next().unwrap().parse().unwrap();
    assert!(seconds > 6.0e10, "{end}");
    secured.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn a_silent_handshake_holds_a_connection_no_longer_than_it_may() {
    let identity = Identity::new();
    let settings = [("server.max_connections", "1"), ("tls.handshake_timeout_ms", "400")];
    let secured = Secured::start(&identity, &settings).await;
    let mut silent = TcpStream::connect(secured.address).await.unwrap();
    // It has the one permit: the next one is served only because the silent one is closed.
    let answer = tokio::time::timeout(LONG, ask(secured.address, &[&identity], "/healthz", "")).await;
    assert!(answer.unwrap().unwrap().starts_with("HTTP/1.1 200"));
    let mut left = Vec::new();
    let _ = tokio::time::timeout(LONG, silent.read_to_end(&mut left)).await.expect("it is closed");
    let failures = secured.metric(&[&identity], "feedwright_tls_handshake_failures_total").await;
    assert_eq!(failures, "feedwright_tls_handshake_failures_total 1");
    secured.server.shutdown().await.unwrap();
}

/// It stands still where the rest of its answer is with TLS already.
#[tokio::test]
async fn a_client_that_does_not_read_the_last_of_its_answer_is_dropped() {
    const STALL: Duration = Duration::from_millis(400);
    let identity = Identity::new();
    let settings = [("server.body_stall_timeout_ms", "400"), ("metrics.listen", "127.0.0.1:0")];
    let secured = Secured::start(&identity, &settings).await;
    let metrics = format!("http://{}/metrics", secured.server.metrics_addr.unwrap());
    let connections = async || {
        let text = reqwest::get(&metrics).await.unwrap().text().await.unwrap();
        let line = text.lines().find(|line| line.starts_with("feedwright_http_connections ")).unwrap();
        line.rsplit(' ').next().unwrap().parse::<f64>().unwrap()
    };
    let mut deaf = Vec::new();
    for unread in [60_000, 90_000, 130_000] {
        let socket = TcpSocket::new_v4().unwrap();
        socket.set_recv_buffer_size(4096).unwrap();
        let stream = socket.connect(secured.address).await.unwrap();
        let mut stream = secure(stream, &[&identity]).await.unwrap();
        let ask = b"GET /docs/swagger-ui-bundle.js HTTP/1.1\r\nhost: localhost\r\n\r\n";
        stream.write_all(ask).await.unwrap();
        let mut read = Vec::new();
        let mut length = None;
        while length.is_none_or(|length| read.len() + unread < length) {
            let mut piece = [0; 4096];
            let bytes = tokio::time::timeout(LONG, stream.read(&mut piece)).await.unwrap().unwrap();
            assert!(bytes > 0, "it ended");
            read.extend_from_slice(&piece[..bytes]);
            let head = String::from_utf8_lossy(&read[..read.len().min(4096)]).to_ascii_lowercase();
            let told = head.split("content-length: ").nth(1).and_then(|rest| rest.split('\r').next());
            length = length.or(told.map(|text| text.parse().unwrap()));
        }
        deaf.push(stream);
    }
    let begun = Instant::now();
    let mut polls = tokio::time::interval(STALL / 8);
    // The one that is left asks for metrics.
    while connections().await > 1.0 {
        assert!(begun.elapsed() < LONG, "they are still connected");
        polls.tick().await;
    }
    drop(deaf);
    secured.server.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_certificate_changes_under_load_and_a_wrong_one_changes_nothing() {
    let (first, second) = (Arc::new(Identity::new()), Arc::new(Identity::new()));
    let secured = Secured::start(&first, &[("tls.reload_interval_ms", "3600000")]).await;
    let address = secured.address;
    let (done, answered) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU32::new(0)));
    let load: Vec<_> = (0..4)
        .map(|_| {
            let (done, answered) = (done.clone(), answered.clone());
            let (first, second) = (first.clone(), second.clone());
            tokio::spawn(async move {
                while !done.load(Ordering::Relaxed) {
                    let answer = ask(address, &[&first, &second], "/healthz", "").await.unwrap();
                    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
                    answered.fetch_add(1, Ordering::Relaxed);
                }
            })
        })
        .collect();
    // A connection from before goes on with the certificate that it began with.
    let mut old = connect(address, &[&first]).await.unwrap();
    let busy = async |more: u32| {
        let until = answered.load(Ordering::Relaxed) + more;
        while answered.load(Ordering::Relaxed) < until {
            tokio::task::yield_now().await;
        }
    };
    busy(8).await;
    secured.install(&second, &second);
    secured.server.reload().await;
    assert_eq!(served(address, &[&first, &second]).await, second.certificate);
    busy(8).await;

    // The key of the one with the certificate of the other, then no PEM at all: both are refused, and said so.
    secured.install(&first, &second);
    secured.server.reload().await;
    assert_eq!(served(address, &[&first, &second]).await, second.certificate);
    std::fs::write(&secured.certificate, "not PEM").unwrap();
    secured.server.reload().await;
    assert_eq!(served(address, &[&first, &second]).await, second.certificate);
    busy(8).await;
    done.store(true, Ordering::Relaxed);
    for task in load {
        task.await.unwrap();
    }
    old.write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n").await.unwrap();
    let mut answer = Vec::new();
    old.read_to_end(&mut answer).await.unwrap();
    assert!(answer.starts_with(b"HTTP/1.1 200"));
    for (outcome, count) in [("taken_over", 1), ("failed", 2)] {
        let name = format!("feedwright_tls_reloads_total{{outcome=\"{outcome}\"}}");
        assert_eq!(secured.metric(&[&second], &name).await, format!("{name} {count}"));
    }
    secured.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn files_that_change_are_taken_over_without_being_asked() {
    let (first, second) = (Identity::new(), Identity::new());
    let secured = Secured::start(&first, &[("tls.reload_interval_ms", "50")]).await;
    // The certificate comes before its key, as a renewal writes them: what does not fit yet is tried again once it does.
    secured.install(&second, &first);
    secured.install(&second, &second);
    let both = [&first, &second];
    let taken = async {
        while served(secured.address, &both).await != second.certificate {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(LONG, taken).await.expect("it is taken over");
    secured.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn a_pair_that_does_not_fit_is_no_start() {
    let (first, second) = (Identity::new(), Identity::new());
    let dir = TempDir::new().unwrap();
    let path = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    std::fs::write(path("chain.pem"), &first.certificate_pem).unwrap();
    std::fs::write(path("key.pem"), &second.key_pem).unwrap();
    for (certificate, key, why) in [
        ("chain.pem", "key.pem", "does not belong to the certificate"),
        ("key.pem", "key.pem", "holds no certificate"),
        ("chain.pem", "chain.pem", "holds no private key"),
        ("chain.pem", "none.pem", "cannot read"),
    ] {
        let (certificate, key) = (path(certificate), path(key));
        let config = config(&dir, &[("tls.certificate", &certificate), ("tls.key", &key)]);
        let database = database::open(&config).await.unwrap();
        match Server::start(config, database.store.clone(), Clock::fixed(NOW)).await {
            Err(StartError::Tls(error)) => {
                let said = error.to_string();
                assert!(said.contains(why), "{said}");
                assert!(!said.contains("BEGIN") && !said.contains("MIG"), "the key is quoted: {said}");
            }
            Err(error) => panic!("{error}"),
            Ok(_) => panic!("it starts with {certificate} and {key}"),
        }
        database.store.close().await;
    }
}

#[tokio::test]
async fn a_certificate_that_cannot_be_read_any_more_is_counted_once_and_not_at_every_look() {
    let (first, second) = (Identity::new(), Identity::new());
    let secured = Secured::start(&first, &[("tls.reload_interval_ms", "20")]).await;
    let both = [&first, &second];
    let count = async |outcome: &str| {
        let name = format!("feedwright_tls_reloads_total{{outcome=\"{outcome}\"}}");
        let line = secured.metric(&both, &name).await;
        line.rsplit_once(' ').unwrap().1.parse::<u32>().unwrap()
    };
    let counted = async |outcome: &str| {
        let begun = Instant::now();
        let mut polls = tokio::time::interval(Duration::from_millis(20));
        while count(outcome).await == 0 {
            assert!(begun.elapsed() < LONG, "it is not counted as {outcome}");
            polls.tick().await;
        }
    };
    std::fs::remove_file(&secured.key).unwrap();
    counted("failed").await;
    let mut looks = tokio::time::interval(Duration::from_millis(20));
    for _ in 0..10 {
        looks.tick().await;
    }
    assert_eq!(count("failed").await, 1);
    secured.install(&second, &second);
    counted("taken_over").await;
    assert_eq!(served(secured.address, &both).await, second.certificate);
    secured.server.shutdown().await.unwrap();
}

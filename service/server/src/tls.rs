//! TLS on the API's listener: rustls with ring, which needs a C compiler and nothing else to build.
//!
//! The certificate is read again on request and whenever its files' content changes. What cannot be used is said and
//! counted, and the pair in force stays; connections that are open go on with what they began with.

use crate::config::TlsConfig;
use crate::metrics::Metrics;
use crate::state::AppState;
use std::fmt;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Duration;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::{CryptoProvider, ring};
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::server::{ClientHello, ResolvesServerCert};
use tokio_rustls::rustls::sign::CertifiedKey;
use tokio_rustls::rustls::{self, ServerConfig};
use x509_cert::der::Decode;

/// Largest certificate chain or key that is read, bytes.
const MOST_PEM_BYTES: u64 = 1 << 20;

/// Why a certificate and its key cannot be used. It names files and never what is in them.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// A file cannot be read.
    #[error("cannot read {path}: {why}")]
    Unreadable {
        /// Which file.
        path: PathBuf,
        /// Why.
        why: String,
    },
    /// The certificate holds another public key than the private key's.
    #[error("the key {key} does not belong to the certificate {certificate}")]
    Mismatch {
        /// The certificate's file.
        certificate: PathBuf,
        /// The key's file.
        key: PathBuf,
    },
    /// The library refuses them.
    #[error("the certificate {certificate} cannot be used: {why}")]
    Unusable {
        /// The certificate's file.
        certificate: PathBuf,
        /// Why.
        why: String,
    },
}

/// Makes ring the cryptography of every TLS connection of this process, as server and as client.
pub fn use_ring() {
    // An error says that it was done before.
    let _ = ring::default_provider().install_default();
}

/// Begins a client of `url` that trusts whom the system trusts. Plain HTTP needs no roots, and a container may have none.
pub fn client(url: &str) -> reqwest::ClientBuilder {
    use_ring();
    // Services and collectors stand in the shop: a proxy towards the internet only gets in the way.
    let client = reqwest::Client::builder().no_proxy();
    if url.starts_with("https://") { client } else { client.tls_certs_only([]) }
}

/// What is served now, and what was last seen in the files.
pub(crate) struct Certificates {
    files: (PathBuf, PathBuf),
    provider: Arc<CryptoProvider>,
    current: RwLock<Arc<CertifiedKey>>,
    /// Hash over the content that was tried last, whether it could be used or not.
    tried: Mutex<blake3::Hash>,
    /// Looks in a row, of those that nobody asked for, at which the files could not be read.
    unread: AtomicU32,
    metrics: Arc<Metrics>,
}

impl fmt::Debug for Certificates {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Certificates").field("files", &self.files).finish_non_exhaustive()
    }
}

impl ResolvesServerCert for Certificates {
    fn resolve(&self, _: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        Some(Arc::clone(&self.current.read().unwrap_or_else(PoisonError::into_inner)))
    }
}

/// A pair out of its files.
struct Pair {
    key: Arc<CertifiedKey>,
    not_after: Option<Duration>,
    hash: blake3::Hash,
}

impl Certificates {
    /// Reads certificate and key for the first time: without a pair that fits, the service does not start.
    pub(crate) fn load(config: &TlsConfig, metrics: Arc<Metrics>) -> Result<Arc<Self>, TlsError> {
        let files = (config.certificate.clone(), config.key.clone());
        let provider = Arc::new(ring::default_provider());
        let contents = read(&files)?;
        let pair = pair(&files, &contents, &provider)?;
        metrics.certificate(pair.not_after);
        Ok(Arc::new(Self {
            files,
            provider,
            current: RwLock::new(pair.key),
            tried: Mutex::new(pair.hash),
            unread: AtomicU32::new(0),
            metrics,
        }))
    }

    /// What accepts TLS connections with these certificates.
    pub(crate) fn acceptor(self: &Arc<Self>) -> Result<TlsAcceptor, TlsError> {
        let builder = ServerConfig::builder_with_provider(self.provider.clone())
            .with_safe_default_protocol_versions()
            .map_err(|error| TlsError::Unusable {
                certificate: self.files.0.clone(),
                why: error.to_string(),
            })?;
        let mut config = builder.with_no_client_auth().with_cert_resolver(self.clone());
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok(TlsAcceptor::from(Arc::new(config)))
    }

    /// Takes over what is in the files, where it differs from what was tried last, or in any case where `asked`.
    pub(crate) fn reload(&self, asked: bool) {
        let contents = match read(&self.files) {
            Ok(contents) => contents,
            Err(error) if !asked => return self.not_read(&error),
            Err(error) => return self.failed(&error),
        };
        self.unread.store(0, Ordering::Relaxed);
        let mut tried = self.tried.lock().unwrap_or_else(PoisonError::into_inner);
        if !asked && *tried == contents.hash {
            return;
        }
        *tried = contents.hash;
        match pair(&self.files, &contents, &self.provider) {
            Ok(pair) => {
                *self.current.write().unwrap_or_else(PoisonError::into_inner) = pair.key;
                self.metrics.certificate(pair.not_after);
                self.metrics.certificate_reloaded(true);
                tracing::info!(certificate = %self.files.0.display(), "the certificate was read again");
            }
            Err(error) => self.failed(&error),
        }
    }

    /// A file that is being replaced may be gone for a moment: its change is seen at the next look. One that cannot be read then
    /// either has failed, once and not at every look.
    fn not_read(&self, error: &TlsError) {
        match self.unread.fetch_add(1, Ordering::Relaxed) {
            1 => self.failed(error),
            _ => tracing::warn!(%error, "the certificate cannot be looked at"),
        }
    }

    fn failed(&self, error: &TlsError) {
        self.metrics.certificate_reloaded(false);
        tracing::error!(%error, "the certificate was not taken over; the one in force stays");
    }
}

struct Contents {
    certificate: Vec<u8>,
    key: Vec<u8>,
    hash: blake3::Hash,
}

fn read((certificate, key): &(PathBuf, PathBuf)) -> Result<Contents, TlsError> {
    let read = |path: &PathBuf| {
        let unreadable = |why: String| TlsError::Unreadable { path: path.clone(), why };
        let size = std::fs::metadata(path).map_err(|error| unreadable(error.to_string()))?.len();
        if size > MOST_PEM_BYTES {
            return Err(unreadable(format!("{size} bytes are no certificate and no key")));
        }
        std::fs::read(path).map_err(|error| unreadable(error.to_string()))
    };
    let (certificate, key) = (read(certificate)?, read(key)?);
    let mut hasher = blake3::Hasher::new();
    hasher.update(&(certificate.len() as u64).to_le_bytes()).update(&certificate).update(&key);
    Ok(Contents { hash: hasher.finalize(), certificate, key })
}

fn pair(
    files: &(PathBuf, PathBuf),
    contents: &Contents,
    provider: &CryptoProvider,
) -> Result<Pair, TlsError> {
    // The parser's errors may quote what it read.
    let unreadable =
        |path: &PathBuf, why: &str| TlsError::Unreadable { path: path.clone(), why: why.to_owned() };
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&contents.certificate).collect();
    let chain = chain.map_err(|_| unreadable(&files.0, "it is no PEM"))?;
    let Some(own) = chain.first() else { return Err(unreadable(&files.0, "it holds no certificate")) };
    let not_after = not_after(own);
    let key = PrivateKeyDer::from_pem_slice(&contents.key)
        .map_err(|_| unreadable(&files.1, "it holds no private key in PEM"))?;
    let key = CertifiedKey::from_der(chain, key, provider).map_err(|error| match error {
        rustls::Error::InconsistentKeys(_) => {
            TlsError::Mismatch { certificate: files.0.clone(), key: files.1.clone() }
        }
        error => TlsError::Unusable { certificate: files.0.clone(), why: error.to_string() },
    })?;
    Ok(Pair { key: Arc::new(key), not_after, hash: contents.hash })
}

/// When a certificate ends, since 1970; `None` where that cannot be told.
fn not_after(certificate: &CertificateDer<'_>) -> Option<Duration> {
    let certificate = x509_cert::Certificate::from_der(certificate).ok()?;
    Some(certificate.tbs_certificate().validity().not_after.to_unix_duration())
}

/// Looks at the files until the shutdown begins.
pub(crate) fn watch(state: &AppState, certificates: Arc<Certificates>) {
    let state = state.clone();
    state
        .lifecycle
        .clone()
        .keep("watching the certificate", move || looks(state.clone(), certificates.clone()));
}

async fn looks(state: AppState, certificates: Arc<Certificates>) {
    let mut ticks = state.lifecycle.every(state.config.tls.reload_interval());
    while ticks.next().await {
        look(&certificates, false).await;
    }
}

/// Looks at the files now, off the threads that serve connections.
pub(crate) async fn look(certificates: &Arc<Certificates>, asked: bool) {
    let certificates = certificates.clone();
    let looked = tokio::task::spawn_blocking(move || certificates.reload(asked)).await;
    if let Err(error) = looked {
        tracing::error!(%error, "looking at the certificate failed");
    }
}

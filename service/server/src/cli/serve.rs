//! `feedwright serve`.

use super::Settings;
use crate::clock::Clock;
use crate::config::Config;
use crate::database::{self, Database, OpenError};
use crate::server::{ListeningServer, Server};
use crate::telemetry::Telemetry;
use anyhow::{Context, bail};
use clap::Args;
use feedwright_store::durable::sync_name;
use feedwright_store::{Page, Store};
use secrecy::{ExposeSecret, SecretString};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};

/// So long the database may still take to open after a signal: a step of a migration that is nearly done need not be done again, and
/// one that says nothing is not waited for.
const STILL_OPENING: Duration = Duration::from_secs(5);

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Address and port to listen on.
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<String>,
    /// Serve plain HTTP on an address that other machines reach.
    #[arg(long)]
    allow_plain_http_on_public_address: bool,
    /// Write the admin's token of a first start into this file instead of showing it: under a supervisor, what is shown
    /// ends up in a log. The file must not exist yet.
    #[arg(long, value_name = "FILE")]
    first_token_file: Option<PathBuf>,
}

/// Serves until SIGTERM or SIGINT.
pub async fn run(settings: &Settings, arguments: Arguments) -> anyhow::Result<()> {
    let mut flags = Vec::new();
    flags.extend(arguments.listen.map(|listen| ("server.listen".to_owned(), listen)));
    if arguments.allow_plain_http_on_public_address {
        flags.push(("server.allow_plain_http_on_public_address".to_owned(), "true".to_owned()));
    }
    let config = settings.load(flags)?;
    let telemetry = Telemetry::begin(&config.log, Some(&config.traces))?;
    let served = serve(config, arguments.first_token_file.as_deref()).await;
    telemetry.end().await;
    served
}

async fn serve(config: Config, first_token_file: Option<&Path>) -> anyhow::Result<()> {
    // Before anything is opened: a signal during the start must not be lost, nor kill half a migration.
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut hangup = signal(SignalKind::hangup())?;
    let told = async {
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
    };
    let Some((Database { store, mut lock }, is_told)) = opened(&config, told).await? else {
        tracing::info!("told to stop before the database was open");
        return Ok(());
    };
    let first = match first_token_file {
        Some(file) => FirstTokenFile::made(&*store, file).await?,
        None => None,
    };
    let server = Server::listen(config, store, Clock::system()).await?;
    greet(&server, first);
    if let Some(lock) = &mut lock {
        // Other commands are told less. A disk that is full is told of by who has to write to it.
        if let Err(error) = lock.publish(&server.local_addr.to_string()) {
            tracing::warn!(%error, "the lock file does not tell where the server listens");
        }
    }
    let server = server.serve();
    let failed = loop {
        if is_told {
            break None;
        }
        tokio::select! {
            _ = terminate.recv() => break None,
            _ = interrupt.recv() => break None,
            _ = hangup.recv() => server.reload().await,
            why = server.failed() => break Some(why),
        }
    };
    server.shutdown().await?;
    match failed {
        None => Ok(()),
        Some(why) => bail!("{why}"),
    }
}

/// Opens the database, and says whether it was `told` to stop meanwhile: then it is waited for a little longer, and `None` where it does
/// not open in that time.
async fn opened(
    config: &Config,
    told: impl Future<Output = ()>,
) -> Result<Option<(Database, bool)>, OpenError> {
    let mut opening = pin!(database::open(config));
    tokio::select! {
        opened = &mut opening => return Ok(Some((opened?, false))),
        () = told => {}
    }
    match tokio::time::timeout(STILL_OPENING, opening).await {
        Ok(opened) => Ok(Some((opened?, true))),
        // The process ends with it, and so does its session: what it has begun the database takes back.
        Err(_) => Ok(None),
    }
}

/// Says where it listens; and the first token, to a person or into a file, past the log.
fn greet(server: &ListeningServer, first: Option<FirstTokenFile>) {
    tracing::info!(address = %server.local_addr, "listening");
    if let Some(address) = server.metrics_addr {
        tracing::info!(%address, "metrics");
    }
    let Some(token) = &server.first_admin_token else { return };
    if let Some(first) = first {
        let path = first.path.clone();
        match first.hold(token) {
            Ok(()) => {
                tracing::warn!(file = %path.display(), "this is the first start: the admin's token is in this file");
                return;
            }
            // It is the only one.
            Err(error) => tracing::error!(%error, file = %path.display(), "cannot write the first token"),
        }
    }
    eprintln!(
        "\nThis is the first start. The admin's token, shown now and never again:\n\n    {}\n\n\
         Keep it safe; make others with `feedwright token create`.\n",
        token.expose_secret()
    );
}

/// The file of its owner's that the first token goes into, made before there is one: a token that nobody gets to know would be
/// the only one for ever. It has its name once the token is in it, and goes where none came.
struct FirstTokenFile {
    path: PathBuf,
    making: PathBuf,
    file: File,
}

impl FirstTokenFile {
    /// `None` where the store has tokens already.
    async fn made(store: &dyn Store, path: &Path) -> anyhow::Result<Option<Self>> {
        if !store.tokens(Page { after: None, limit: 1 }).await?.is_empty() {
            return Ok(None);
        }
        if path.symlink_metadata().is_ok() {
            bail!("{} is there already, and is to hold the first token: move it away", path.display());
        }
        // Of nobody else's, whatever stands in that folder.
        let mut making = path.as_os_str().to_owned();
        making.push(format!(".{}.new", uuid::Uuid::now_v7()));
        let making = PathBuf::from(making);
        let file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&making);
        let file = file.with_context(|| format!("cannot make {} for the first token", making.display()))?;
        Ok(Some(Self { path: path.to_owned(), making, file }))
    }

    fn hold(mut self, token: &SecretString) -> std::io::Result<()> {
        writeln!(self.file, "{}", token.expose_secret())?;
        self.file.sync_all()?;
        std::fs::rename(&self.making, &self.path)?;
        sync_name(&self.path)
    }
}

impl Drop for FirstTokenFile {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_file(&self.making)
            && error.kind() != std::io::ErrorKind::NotFound
        {
            tracing::warn!(%error, file = %self.making.display(), "a file is left");
        }
    }
}

//! `feedwright serve`.

use super::{Settings, log};
use crate::clock::Clock;
use crate::database::{self, Database};
use crate::server::{RunningServer, Server};
use anyhow::{Context, bail};
use clap::Args;
use secrecy::ExposeSecret;
use tokio::signal::unix::{SignalKind, signal};

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Address and port to listen on.
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<String>,
    /// Serve plain HTTP on an address that other machines reach.
    #[arg(long)]
    allow_plain_http_on_public_address: bool,
}

/// Serves until SIGTERM or SIGINT.
pub async fn run(settings: &Settings, arguments: Arguments) -> anyhow::Result<()> {
    let mut flags = Vec::new();
    flags.extend(arguments.listen.map(|listen| ("server.listen".to_owned(), listen)));
    if arguments.allow_plain_http_on_public_address {
        flags.push(("server.allow_plain_http_on_public_address".to_owned(), "true".to_owned()));
    }
    let config = settings.load(flags)?;
    log(&config.log)?;
    // Before anything is opened: a signal during the start must not be lost, nor kill half a migration.
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let Database { store, mut lock } = database::open(&config).await?;
    let server = Server::start(config, store, Clock::system()).await?;
    if let Some(lock) = &mut lock {
        lock.publish(&server.local_addr.to_string()).context("cannot write the lock file")?;
    }
    greet(&server);
    let failed = tokio::select! {
        _ = terminate.recv() => None,
        _ = interrupt.recv() => None,
        why = server.failed() => Some(why),
    };
    server.shutdown().await?;
    match failed {
        None => Ok(()),
        Some(why) => bail!("{why}"),
    }
}

/// Says where it listens; and the first token, to a person, past the log.
fn greet(server: &RunningServer) {
    tracing::info!(address = %server.local_addr, "listening");
    if let Some(address) = server.metrics_addr {
        tracing::info!(%address, "metrics");
    }
    if let Some(token) = &server.first_admin_token {
        eprintln!(
            "\nThis is the first start. The admin's token, shown now and never again:\n\n    {}\n\n\
             Keep it safe; make others with `feedwright token create`.\n",
            token.expose_secret()
        );
    }
}

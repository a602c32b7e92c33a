//! `feedwright demo`: a service of its own with real recordings in it.

use super::print;
use crate::auth::Issued;
use crate::clock::Clock;
use crate::config::{Config, Sources};
use crate::database::{self, Database};
use crate::replay::client::Client;
use crate::replay::fleet::MachineTokens;
use crate::replay::progress::Progress;
use crate::replay::recordings::{embedded, read_embedded};
use crate::replay::refusals::Refusals;
use crate::replay::run::{Options, run as post};
use crate::replay::{Start, report, shift};
use crate::server::{RunningServer, Server, StartError};
use crate::telemetry::Telemetry;
use anyhow::{Context, bail};
use clap::Args;
use feedwright_store::{Actor, Page, Role, Store};
use secrecy::{ExposeSecret, SecretString};
use std::io::ErrorKind;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};

/// What the demo's tokens are called; those of an earlier run are revoked.
const TOKEN_NAME: &str = "demo";
/// Tokens looked at for earlier runs.
const TOKENS: u32 = 1000;
/// The service runs in this process: longer than this it does not answer at all.
const PATIENCE: Duration = Duration::from_secs(30);

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Where the demo keeps its data; used again by the next run.
    #[arg(long, default_value = "./feedwright-demo", value_name = "DIRECTORY")]
    dir: PathBuf,
    /// Port on this machine; another free one where it is taken.
    #[arg(long, default_value_t = 7878)]
    port: u16,
    /// Recordings to replay, by name; all that are inside where none is named.
    #[arg(long, value_name = "NAME")]
    recording: Vec<String>,
    /// End once everything is said, instead of staying up.
    #[arg(long)]
    exit: bool,
}

/// Runs the command.
pub async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let config = configuration(&arguments.dir, arguments.port)?;
    let telemetry = Telemetry::begin(&config.log, Some(&config.traces))?;
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let Database { store, mut lock } = database::open(&config).await?;
    let token = fresh_token(&store).await?;
    let server = start(config, &arguments, store).await?;
    if let Some(lock) = &mut lock {
        lock.publish(&server.local_addr.to_string()).context("cannot write the lock file")?;
    }
    let address = format!("http://{}", server.local_addr);
    let told = tokio::select! {
        told = tell(&arguments, &address, token) => told,
        _ = terminate.recv() => Err(anyhow::anyhow!("stopped before everything was replayed; start it again to go on")),
        _ = interrupt.recv() => Err(anyhow::anyhow!("stopped before everything was replayed; start it again to go on")),
    };
    let failed = if told.is_err() || arguments.exit {
        None
    } else {
        tokio::select! {
            _ = terminate.recv() => None,
            _ = interrupt.recv() => None,
            why = server.failed() => Some(why),
        }
    };
    server.shutdown().await?;
    telemetry.end().await;
    match failed {
        None => told,
        Some(why) => bail!("{why}"),
    }
}

fn configuration(dir: &std::path::Path, port: u16) -> anyhow::Result<Config> {
    let flags = vec![
        ("data_dir".to_owned(), dir.to_string_lossy().into_owned()),
        ("server.listen".to_owned(), format!("127.0.0.1:{port}")),
        ("log.level".to_owned(), "warn".to_owned()),
    ];
    Ok(Config::load(&Sources { flags, ..Sources::default() })?)
}

/// Starts on the port that was asked for, else on a free one.
async fn start(
    config: Config,
    arguments: &Arguments,
    store: Arc<dyn Store>,
) -> anyhow::Result<RunningServer> {
    match Server::start(config, store.clone(), Clock::system()).await {
        Err(StartError::Listen { source, .. }) if source.kind() == ErrorKind::AddrInUse => {
            Ok(Server::start(configuration(&arguments.dir, 0)?, store, Clock::system()).await?)
        }
        other => Ok(other?),
    }
}

/// A token that works until the next run: the one of an earlier run was shown, and may have been kept.
async fn fresh_token(store: &Arc<dyn Store>) -> anyhow::Result<SecretString> {
    let (clock, actor) = (Clock::system(), Actor { token: "cli".to_owned(), role: Role::Admin });
    for token in store.tokens(Page { after: None, limit: TOKENS }).await? {
        if token.name == TOKEN_NAME && token.revoked_at.is_none() {
            store.revoke_token(&token.id, &actor, clock.now()).await?;
        }
    }
    let issued = Issued::new(TOKEN_NAME, Role::Admin, None, &clock)?;
    store.create_token(issued.record, &actor).await?;
    Ok(issued.text)
}

/// Replays over HTTP, as from outside, and says what came of it.
async fn tell(arguments: &Arguments, address: &str, token: SecretString) -> anyhow::Result<()> {
    let client = Client::new(address, Some(token.clone()), PATIENCE)?;
    let (mut posted, mut refusals) = (0, Refusals::default());
    let names = if arguments.recording.is_empty() { embedded() } else { arguments.recording.clone() };
    for name in names {
        let plan = read_embedded(&name, None)?;
        let state = arguments.dir.join(format!("replay-{name}.json"));
        let now_us = jiff::Timestamp::now().as_microsecond();
        // The port may differ from run to run; the data, and so the shift, belongs to the folder.
        let shift_us = shift::choose(Start::Now, &plan, "demo", now_us, &state)?;
        let options = Options { shift_us, speed: None, batch: 1 };
        let mut progress = Progress::for_cycles(plan.cycles.len());
        let outcome = post(&plan, &client, MachineTokens::Make, options, &mut progress).await?;
        posted += outcome.posted() as u64;
        refusals = refusals.plus(&outcome.refusals);
        print(&report::summary(&plan, &outcome))?;
        print(&report::tools(&plan, &client).await?)?;
        print("\n")?;
    }
    let token = token.expose_secret();
    print(&format!(
        "Open {address}/docs for the API. This token may do everything here, until the demo is started again:\n\n    \
         {token}\n\n    curl -H 'Authorization: Bearer {token}' {address}/v1/tools/vicomtech-14/wear\n\n"
    ))?;
    if arguments.exit {
        // Nobody stays to read what was said.
        return Ok(refusals.check(posted)?);
    }
    print("The service stays up; Ctrl-C ends it.\n")
}

//! The commands.
//!
//! A new command is a file in `cli/` with its arguments and a `run`, and a line in [`Command`].

pub mod backup;
pub mod check;
pub mod config;
pub mod copy;
pub mod demo;
pub mod healthcheck;
pub mod openapi;
pub mod replay;
mod scratch;
pub mod serve;
pub mod simulate;
mod stop;
pub mod token;
pub mod twin;

use crate::config::{Config, ConfigError, LogConfig, Sources};
use crate::telemetry::Telemetry;
use clap::{Args, Parser, Subcommand};
use std::path::PathBuf;

/// Cycles in; tool wear and recommendations out.
#[derive(Debug, Parser)]
#[command(name = "feedwright", version, about)]
pub struct Cli {
    #[command(flatten)]
    settings: Settings,
    #[command(subcommand)]
    command: Command,
}

/// Settings that every command takes.
#[derive(Debug, Clone, Args)]
pub struct Settings {
    /// A TOML file with settings.
    #[arg(long, global = true, env = "FEEDWRIGHT_CONFIG", value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Where the data is kept.
    #[arg(long, global = true, value_name = "DIRECTORY")]
    pub data_dir: Option<String>,
    /// Any setting, as in `--set limits.batch_lines=500`; may be repeated.
    #[arg(long, global = true, value_name = "NAME=VALUE", value_parser = name_and_value)]
    pub set: Vec<(String, String)>,
}

fn name_and_value(text: &str) -> Result<(String, String), String> {
    let (name, value) = text.split_once('=').ok_or("must be NAME=VALUE")?;
    Ok((name.trim().to_owned(), value.to_owned()))
}

impl Settings {
    /// The configuration in force, with `flags` of the command on top.
    pub fn load(&self, flags: Vec<(String, String)>) -> Result<Config, ConfigError> {
        let mut all = self.set.clone();
        all.extend(self.data_dir.iter().map(|path| ("data_dir".to_owned(), path.clone())));
        all.extend(flags);
        // A variable that is not UTF-8 can only be one of another program.
        let environment = std::env::vars_os()
            .filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)));
        Config::load(&Sources { file: self.config.clone(), environment: environment.collect(), flags: all })
    }
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Runs the service until it is told to stop.
    Serve(serve::Arguments),
    /// Starts a service of its own, replays real recordings into it, says what it makes of them, and stays up.
    Demo(demo::Arguments),
    /// Posts recorded cycles from CSV files to a service, as a machine would.
    Replay(replay::Arguments),
    /// Prints the settings in force, where each came from, and no secret.
    Config,
    /// Makes, lists and revokes tokens: through the server when one runs, else directly in its database.
    Token(token::Arguments),
    /// Prints the description of the API (OpenAPI).
    Openapi,
    /// Backs the database up into one file, under load, with sums.
    Backup(backup::BackupArguments),
    /// Restores a backup into a fresh database, checked by its sums.
    Restore(backup::RestoreArguments),
    /// Checks every block and hash, and wear against its fold; fails where a fault is left.
    Check(check::Arguments),
    /// Copies everything from one database into another, checked by sums.
    Copy(copy::Arguments),
    /// Prints the description of the machines' streams (AsyncAPI).
    Asyncapi,
    /// Asks a running service whether it is ready; for containers.
    Healthcheck(healthcheck::Arguments),
    /// Drives a running server with a shop of simulated friction drills, and prints what became of it.
    Simulate(simulate::Arguments),
    /// Runs the process model of friction drilling in step with another program, line by line.
    Twin(twin::Arguments),
}

/// Runs the command that the arguments name.
pub async fn run(cli: Cli) -> anyhow::Result<()> {
    crate::tls::use_ring();
    match cli.command {
        Command::Serve(arguments) => serve::run(&cli.settings, arguments).await,
        Command::Demo(arguments) => demo::run(arguments).await,
        Command::Replay(arguments) => replay::run(arguments).await,
        Command::Config => config::run(&cli.settings),
        Command::Token(arguments) => token::run(&cli.settings, arguments).await,
        Command::Openapi => openapi::run(),
        Command::Backup(arguments) => backup::back_up(&cli.settings, arguments).await,
        Command::Restore(arguments) => backup::restore(&cli.settings, arguments).await,
        Command::Check(arguments) => check::run(&cli.settings, arguments).await,
        Command::Copy(arguments) => copy::run(&cli.settings, arguments).await,
        Command::Asyncapi => openapi::run_asyncapi(),
        Command::Healthcheck(arguments) => healthcheck::run(&cli.settings, arguments).await,
        Command::Simulate(arguments) => simulate::run(&cli.settings, arguments).await,
        Command::Twin(arguments) => twin::run(arguments).await,
    }
}

/// Begins to log; a command that ends by itself sends no traces.
pub fn log(config: &LogConfig) -> anyhow::Result<()> {
    Telemetry::begin(config, None).map(drop)
}

/// Prints text on standard output. A reader that went away, as `head` does, is no error.
pub fn print(text: &str) -> anyhow::Result<()> {
    use std::io::Write;
    match std::io::stdout().lock().write_all(text.as_bytes()) {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => Ok(other?),
    }
}

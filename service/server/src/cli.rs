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

use crate::config::{Config, ConfigError, LogConfig, Sources, settings_of};
use crate::telemetry::Telemetry;
use clap::error::ErrorKind;
use clap::parser::ValueSource;
use clap::{ArgMatches, Args, CommandFactory, FromArgMatches, Parser, Subcommand};
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

/// Settings of the service, for every command that works with it.
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
        let environment = settings_of(std::env::vars_os())?;
        Config::load(&Sources { file: self.config.clone(), environment, flags: all })
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

/// Commands that read no settings, each with the flags that would be passed over, and what says the like there. A file of settings is
/// no fault where it changes nothing: `feedwright-ctl` names one to every command.
const WITHOUT_SETTINGS: [(&str, &[&str], &str); 3] = [
    (
        "demo",
        &["data_dir", "config", "set"],
        "it keeps its data where --dir says, and has settings of its own",
    ),
    ("replay", &["data_dir", "set"], "it posts to the service that --url names"),
    ("twin", &["data_dir", "set"], "it works with no service; --model names its settings"),
];

impl Cli {
    /// The arguments of this process; where they are not accepted it says so and ends.
    pub fn of_process() -> Self {
        let mut command = Self::command();
        let matches = command.get_matches_mut();
        let read = refuse_unread(&mut command, &matches).and_then(|()| Self::from_arg_matches(&matches));
        read.unwrap_or_else(|error| error.exit())
    }
}

/// Refuses settings that the command would pass over: whoever names them counts on them.
fn refuse_unread(command: &mut clap::Command, matches: &ArgMatches) -> Result<(), clap::Error> {
    let Some((name, of_command)) = matches.subcommand() else { return Ok(()) };
    let Some((_, unread, instead)) = WITHOUT_SETTINGS.iter().find(|(without, ..)| *without == name) else {
        return Ok(());
    };
    let is_given = |flag: &&&str| of_command.value_source(flag) == Some(ValueSource::CommandLine);
    let Some(flag) = unread.iter().find(is_given) else { return Ok(()) };
    let flag = flag.replace('_', "-");
    Err(command
        .error(ErrorKind::ArgumentConflict, format!("`feedwright {name}` takes no --{flag}: {instead}")))
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

#[cfg(test)]
mod tests {
    use super::*;

    fn read(arguments: &[&str]) -> Result<(), String> {
        let mut command = Cli::command();
        let matches = command.try_get_matches_from_mut([&["feedwright"], arguments].concat()).unwrap();
        refuse_unread(&mut command, &matches).map_err(|error| error.to_string())
    }

    #[test]
    fn settings_that_a_command_does_not_read_are_refused() {
        for (arguments, said) in [
            (&["demo", "--data-dir", "x"][..], "`feedwright demo` takes no --data-dir"),
            (&["--data-dir", "x", "demo"], "`feedwright demo` takes no --data-dir"),
            (&["demo", "--config", "x"], "takes no --config"),
            (&["replay", "vicomtech-turning", "--set", "log.level=warn"], "takes no --set"),
            (&["twin", "--stdio", "--data-dir", "x"], "takes no --data-dir"),
        ] {
            let error = read(arguments).unwrap_err();
            assert!(error.contains(said), "{error}");
        }
        for arguments in [
            &["demo", "--dir", "x"][..],
            &["--config", "x", "replay", "vicomtech-turning"],
            &["--config", "x", "twin", "--stdio"],
            &["serve", "--data-dir", "x", "--set", "log.level=warn"],
        ] {
            assert_eq!(read(arguments), Ok(()), "{arguments:?}");
        }
    }
}

//! `feedwright copy`: a cell's database to the plant, or back.

use super::{Settings, log, print};
use crate::data_dir::DataDirLock;
use anyhow::{Context, bail};
use clap::Args;
use feedwright_store::transfer::{Address, copy};
use feedwright_store::unknown_parameter;
use secrecy::{ExposeSecret, SecretString};
use std::path::Path;

/// Arguments of the command. Addresses may hold passwords: the environment hides them from other users.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Where everything is: `sqlite:///path/to/feedwright.sqlite3` or `postgres://user:password@host/database`.
    #[arg(long, env = "FEEDWRIGHT_COPY_FROM", hide_env_values = true)]
    from: SecretString,
    /// Where it is to be: fresh, or what an earlier copy of the same source left there.
    #[arg(long, env = "FEEDWRIGHT_COPY_TO", hide_env_values = true)]
    to: SecretString,
}

/// The address that a flag, or its variable, names. Told by its flag alone: it may hold a password, whatever is wrong with it.
fn address(flag: &str, text: &SecretString) -> anyhow::Result<Address> {
    let text = text.expose_secret();
    let address =
        Address::parse(text).with_context(|| format!("{flag} must begin with sqlite:// or postgres://"))?;
    if let Some(why) = unknown_parameter(text).filter(|_| matches!(address, Address::Postgres(_))) {
        bail!("{flag} {why}");
    }
    Ok(address)
}

/// Runs the command.
pub async fn run(settings: &Settings, arguments: Arguments) -> anyhow::Result<()> {
    let config = settings.load(Vec::new())?;
    log(&config.log)?;
    let (from, to) = (address("--from", &arguments.from)?, address("--to", &arguments.to)?);
    let _lock = match &to {
        Address::Sqlite(path) => {
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
            Some(
                DataDirLock::acquire(folder.unwrap_or(Path::new(".")))
                    .context("stop the target's server first")?,
            )
        }
        Address::Postgres(_) => None,
    };
    let mut told = |table: &str, sum, written: u64| {
        // Lines are for a person who waits; one that went away is no error.
        let _ = print(&format!("{table}: {sum}, {written} of them written\n"));
    };
    copy(&from, &to, &mut told).await?;
    print("copied, and every table has the same sum on both sides\n")
}

//! `feedwright replay`: posts a recording to a service, as a machine would.

use super::{print, stop};
use crate::replay::client::Client;
use crate::replay::fleet::MachineTokens;
use crate::replay::progress::{Progress, tell};
use crate::replay::recordings::{embedded, read_embedded, read_folder};
use crate::replay::run::{Options, run_until as post};
use crate::replay::{Plan, Start, report, shift};
use anyhow::Context;
use clap::Args;
use secrecy::SecretString;
use std::path::PathBuf;
use std::time::Duration;

/// Posts recorded cycles from CSV files to a service, as a machine would.
///
/// Started again after an interruption it posts everything again; the service knows what it has, so that nothing
/// is lost and nothing doubled.
#[derive(Debug, Args)]
pub struct Arguments {
    /// A folder with CSV files and mapping.toml, or the name of a recording inside the binary.
    recording: String,
    /// Another mapping file than the recording's own.
    #[arg(long)]
    mapping: Option<PathBuf>,
    /// Address of the service.
    #[arg(long, env = "FEEDWRIGHT_URL", default_value = "http://127.0.0.1:7878")]
    url: String,
    /// A token that registers machines, tools and operations: an engineer's, or an admin's without --machine-token.
    #[arg(long, env = "FEEDWRIGHT_TOKEN", hide_env_values = true)]
    token: Option<SecretString>,
    /// The machine's own token. Without it the admin's makes one for each machine and revokes it at the end.
    #[arg(long, env = "FEEDWRIGHT_MACHINE_TOKEN", hide_env_values = true)]
    machine_token: Option<SecretString>,
    /// When the recording happens: `recorded`, `now` (the last cycle ends now) or an RFC 3339 time of its first cycle.
    #[arg(long, default_value = "recorded")]
    start: Start,
    /// Where the shift chosen by `--start now` is kept, so that a restart repeats the same content
    /// [default: feedwright-replay-NAME.json].
    #[arg(long)]
    state: Option<PathBuf>,
    /// `max`: as fast as cycles are acknowledged; a number: so many times the recorded speed.
    #[arg(long, default_value = "max", value_parser = parse_speed)]
    speed: Speed,
    /// Cycles per request; above 1 they go as NDJSON batches.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1000))]
    batch: u16,
    /// Gives up when nothing was answered for so many seconds.
    #[arg(long, default_value_t = 600)]
    patience_seconds: u64,
    /// Prints when each tool was said to be worn, beside what was measured on it.
    #[arg(long, conflicts_with = "batch")]
    report: bool,
}

/// A minute of the recording in most of a day: slower is a slip, and waits of ages are more than a clock can hold.
const SLOWEST: f64 = 0.001;
/// Far above what any service acknowledges.
const FASTEST: f64 = 1e9;

#[derive(Debug, Clone, Copy)]
enum Speed {
    Max,
    Times(f64),
}

fn parse_speed(text: &str) -> Result<Speed, String> {
    match text.parse::<f64>() {
        _ if text == "max" => Ok(Speed::Max),
        Ok(times) if (SLOWEST..=FASTEST).contains(&times) => Ok(Speed::Times(times)),
        _ => Err(format!("needs max or a number from {SLOWEST} to {FASTEST}")),
    }
}

/// Runs the command.
pub async fn run(args: Arguments) -> anyhow::Result<()> {
    let plan = read(&args)?;
    let client =
        Client::new(&args.url, args.token, Duration::from_secs(args.patience_seconds))?.telling(tell);
    let state = args.state.unwrap_or_else(|| format!("feedwright-replay-{}.json", plan.name).into());
    let now_us = jiff::Timestamp::now().as_microsecond();
    let shift_us = shift::choose(args.start, &plan, client.base(), now_us, &state)?;
    let speed = match args.speed {
        Speed::Max => None,
        Speed::Times(times) => Some(times),
    };
    let tokens = args.machine_token.map_or(MachineTokens::Make, MachineTokens::Given);
    let mut progress = Progress::for_cycles(plan.cycles.len());
    let options = Options { shift_us, speed, batch: usize::from(args.batch) };
    let stop = stop::once_and_twice();
    let outcome = post(&plan, &client, tokens, options, &mut progress, stop.cancelled()).await?;
    print(&report::summary(&plan, &outcome))?;
    print(&report::tools(&plan, &client).await?)?;
    if args.report {
        print(&format!("\n{}", report::table(&plan, &outcome)))?;
    }
    anyhow::ensure!(outcome.refused == 0, "{} cycles were refused and are not kept", outcome.refused);
    Ok(())
}

fn read(args: &Arguments) -> anyhow::Result<Plan> {
    let folder = PathBuf::from(&args.recording);
    if folder.is_dir() {
        return Ok(read_folder(&folder, args.mapping.as_deref())?);
    }
    anyhow::ensure!(
        embedded().contains(&args.recording),
        "{:?} is neither a folder nor one of the recordings inside: {}",
        args.recording,
        embedded().join(", ")
    );
    let mapping = match &args.mapping {
        None => None,
        Some(path) => {
            Some(std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?)
        }
    };
    Ok(read_embedded(&args.recording, mapping.as_deref())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_speed_is_one_that_a_clock_can_wait_for() {
        assert!(matches!(parse_speed("max"), Ok(Speed::Max)));
        assert!(matches!(parse_speed("0.5"), Ok(Speed::Times(_))));
        for wrong in ["0", "-1", "1e-300", "1e300", "inf", "NaN", "fast"] {
            let said = parse_speed(wrong).unwrap_err();
            assert!(said.contains("0.001"), "{wrong}: {said}");
        }
    }
}

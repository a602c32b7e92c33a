//! `feedwright simulate`: a shop of friction drills that drive a running server over HTTP, as real machines do.
//!
//! Each machine drills on the process model, posts its cycles one by one, reads the answer, runs a reference cycle when
//! it is asked to, and changes its tool when it is told to. Faults are injected on request. Everything follows from the seed but the order in which the
//! machines' requests arrive.

mod fault;
mod machine;
mod report;

pub use fault::Fault;

use super::{Settings, print, stop};
use crate::http::dto::time;
use crate::replay::client::Client;
use anyhow::{Context, ensure};
use clap::Args;
use feedwright_core::friction::twin::PaperStrategies;
use feedwright_core::units::{Strategy, Timestamp};
use futures_util::future::join_all;
use machine::{Clients, Plan, SimulatedMachine};
use report::Report;
use secrecy::SecretString;
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;

/// Most machines: each holds a connection, and a server has 512 unless configured.
const MOST_MACHINES: u32 = 200;
/// Most cycles of one machine.
const MOST_CYCLES: u32 = 100_000;
/// From the beginning of one cycle to that of the next on the machines' clocks, ms.
const CADENCE_MS: i64 = 20_000;

/// Cycles per second: one in a quarter of an hour, and more than any server takes.
const SLOWEST_RATE: f64 = 0.001;
const FASTEST_RATE: f64 = 1e5;

/// Longest wait for a server that does not answer or has no room.
const PATIENCE: Duration = Duration::from_secs(60);

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The server to drive; as configured where it is left out.
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    /// An admin's token: it registers the shop and has a token made for each machine.
    #[arg(long, env = "FEEDWRIGHT_TOKEN", hide_env_values = true, value_parser = secret)]
    token: SecretString,
    /// How many machines.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST_MACHINES)))]
    machines: u32,
    /// How many cycles each machine drills.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST_CYCLES)))]
    cycles: u32,
    /// Cycles per second of all machines together; as fast as the server answers where it is left out.
    #[arg(long)]
    rate: Option<f64>,
    /// What decides everything random.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Cycles after which a tool is worn.
    #[arg(long, default_value_t = 150, value_parser = clap::value_parser!(u32).range(20..=1_000_000))]
    life: u32,
    /// f_const, f_sec, f_lin or f_ac; the machines take turns where it is left out.
    #[arg(long, value_parser = strategy)]
    strategy: Option<Strategy>,
    /// Faults to inject: air_cut, broken_tool, thickness, nan_body, duplicate, late_replay.
    #[arg(long, value_delimiter = ',', value_parser = Fault::parse)]
    faults: Vec<Fault>,
    /// Share of cycles with a fault, 0 to 1.
    #[arg(long, default_value_t = 0.02)]
    fault_share: f64,
    /// Fail unless tools are changed within this share of the limit's wear, by the median, and none is overdue.
    #[arg(long, value_name = "SHARE")]
    tolerance: Option<f64>,
    /// When the last cycle begins, RFC 3339; now where it is left out.
    #[arg(long)]
    until: Option<String>,
}

fn strategy(text: &str) -> Result<Strategy, String> {
    Strategy::parse(text).ok_or_else(|| Strategy::ALL.map(Strategy::as_str).join(", "))
}

// Never fails; an infallible function is no parser for clap's derive.
fn secret(text: &str) -> Result<SecretString, String> {
    Ok(SecretString::from(text))
}

/// Drives the server and prints what became of it all.
pub async fn run(settings: &Settings, arguments: Arguments) -> anyhow::Result<()> {
    ensure!((0.0..=1.0).contains(&arguments.fault_share), "--fault-share must be within 0 and 1");
    let rates = SLOWEST_RATE..=FASTEST_RATE;
    ensure!(
        arguments.rate.is_none_or(|rate| rates.contains(&rate)),
        "--rate must be within {SLOWEST_RATE} and {FASTEST_RATE}"
    );
    ensure!(
        arguments.tolerance.is_none_or(|tolerance| tolerance > 0.0 && tolerance < 1.0),
        "--tolerance must be within 0 and 1"
    );
    let url = match &arguments.server {
        Some(url) => url.clone(),
        None => super::healthcheck::own_url(&settings.load(Vec::new())?),
    };
    let office = Client::new(&url, Some(arguments.token.clone()), PATIENCE)?;
    let until = match &arguments.until {
        Some(text) => time::read("--until", text)?,
        None => crate::clock::Clock::system().now(),
    };
    let begin = until.plus_millis(-CADENCE_MS * i64::from(arguments.cycles - 1));
    let plans = (1..=arguments.machines).map(|number| plan(&arguments, number, begin));
    let plans = plans.collect::<anyhow::Result<Vec<Plan>>>()?;
    let begun = Instant::now();
    let told = stop::once_and_twice();
    let report = drive_all(&office, plans, &told.child_token()).await?;
    ensure!(!told.is_cancelled(), "it was told to stop");
    print(&format!("{}\n", report.json(begun.elapsed().as_secs_f64())?))?;
    report.refusals.check(report.posts())?;
    arguments.tolerance.map_or(Ok(()), |tolerance| report.check(tolerance))
}

fn plan(arguments: &Arguments, number: u32, begin: Timestamp) -> anyhow::Result<Plan> {
    let paper = PaperStrategies::new()?;
    let turn = Strategy::ALL[(number as usize - 1) % Strategy::ALL.len()];
    let word = arguments.strategy.unwrap_or(turn);
    let strategy = match word {
        Strategy::FConst => paper.constant.clone(),
        Strategy::FSec => paper.stepped,
        Strategy::FLin => paper.linear,
        Strategy::FAc => paper.adaptive,
    };
    let pause = arguments.rate.map(|rate| Duration::from_secs_f64(f64::from(arguments.machines) / rate));
    Ok(Plan {
        number,
        cycles: arguments.cycles,
        life: arguments.life,
        seed: arguments.seed,
        begin,
        cadence_ms: CADENCE_MS,
        word,
        reference: paper.constant.clone(),
        strategy,
        faults: arguments.faults.clone(),
        fault_share: arguments.fault_share,
        pause,
    })
}

/// All machines side by side. Where one fails the others stop, and end as they do otherwise: a token that is left behind
/// is one that nobody knows of.
async fn drive_all(office: &Client, plans: Vec<Plan>, stop: &CancellationToken) -> anyhow::Result<Report> {
    let machines = plans.into_iter().map(|plan| async {
        let report = drive(office.clone(), plan, stop).await;
        if report.is_err() {
            stop.cancel();
        }
        report
    });
    let reports = join_all(machines).await.into_iter().collect::<anyhow::Result<Vec<Report>>>()?;
    Ok(reports.into_iter().fold(Report::default(), Report::plus))
}

/// One machine's shift until it ends or is told to stop, with a token of its own that is revoked at its end.
async fn drive(office: Client, plan: Plan, stop: &CancellationToken) -> anyhow::Result<Report> {
    let name = plan.name();
    let machine = SimulatedMachine::new(plan)?;
    machine.register(&office).await.with_context(|| format!("cannot register {name}"))?;
    let shop = Clients::enlist(office, &name).await?;
    let report = tokio::select! {
        report = shift(machine, &shop) => report.with_context(|| format!("{name} stops")),
        () = stop.cancelled() => Ok(Report::default()),
    };
    let dismissed = shop.dismiss().await;
    let report = report?;
    dismissed.map(|()| report)
}

async fn shift(mut machine: SimulatedMachine, shop: &Clients) -> anyhow::Result<Report> {
    let mut report = Report { machines: 1, ..Report::default() };
    let mut ticks = machine.pause().map(tokio::time::interval);
    while machine.has_more() {
        if let Some(ticks) = &mut ticks {
            ticks.tick().await;
        }
        machine.cycle(shop, &mut report).await?;
    }
    machine.replay(shop, &mut report).await?;
    Ok(report)
}

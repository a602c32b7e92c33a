//! `feedwright healthcheck`: for containers, which have no curl.

use super::Settings;
use crate::config::Config;
use crate::tls;
use anyhow::{Context, ensure};
use clap::Args;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::time::Duration;

/// Longer than a readiness probe waits for its database.
const PATIENCE: Duration = Duration::from_secs(5);

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Where the service listens; as configured where it is left out.
    #[arg(long, value_name = "URL")]
    server: Option<String>,
}

/// Fails where the service is not ready.
pub async fn run(settings: &Settings, arguments: Arguments) -> anyhow::Result<()> {
    let (url, is_own) = match arguments.server {
        Some(url) => (url, false),
        None => (own_url(&settings.load(Vec::new())?), true),
    };
    // The service of this very machine has a certificate for the name that others call it by. It is asked whether it is
    // ready, and told nothing.
    let client = tls::client(&url).timeout(PATIENCE).tls_danger_accept_invalid_certs(is_own).build()?;
    let url = format!("{}/readyz", url.trim_end_matches('/'));
    let answer = client.get(&url).send().await.with_context(|| format!("cannot reach {url}"))?;
    ensure!(answer.status().is_success(), "{url} answers {}", answer.status());
    super::print("ready\n")
}

/// Where the service of this machine is reached.
pub(super) fn own_url(config: &Config) -> String {
    format!("{}://{}", config.tls.scheme(), reachable(config.server.listen))
}

/// An address to connect to for an address that is listened on: "any" is no destination.
pub(super) fn reachable(listen: SocketAddr) -> SocketAddr {
    let ip = match listen.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => IpAddr::V4(Ipv4Addr::LOCALHOST),
        IpAddr::V6(ip) if ip.is_unspecified() => IpAddr::V6(Ipv6Addr::LOCALHOST),
        ip => ip,
    };
    SocketAddr::new(ip, listen.port())
}

//! What can be configured: the embedded defaults, a file, the environment and flags, in that order.
//!
//! A new setting is a commented line in `default.toml`, a field here with the same name, and a check in
//! [`Config::check`] where not every value makes sense. The default file is the schema: a key that it lacks is
//! refused. Reading a setting anywhere but from a [`Config`] does not belong in this crate.

mod layers;

pub use layers::{ConfigError, Origin, Sources};

use feedwright_core::ids::MachineId;
use feedwright_core::recommend::RecommendSettings;
use feedwright_store::{QuarantineBounds, SampleRetention, WatchSettings};
use secrecy::{ExposeSecret, SecretString};
use serde::{Deserialize, Deserializer};
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The configuration in force; running never changes it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Where the data is kept.
    pub data_dir: PathBuf,
    /// Listener and its bounds.
    pub server: ServerConfig,
    /// The database.
    pub database: DatabaseConfig,
    /// Bounds of what is taken in and given out.
    pub limits: Limits,
    /// Bounds of the quarantine.
    pub quarantine: QuarantineConfig,
    /// How long samples are kept.
    pub retention: RetentionConfig,
    /// How long recommendations and data stay good.
    pub recommendation: RecommendationConfig,
    /// How often the watch looks around, and when it alarms.
    pub watch: WatchConfig,
    /// The live view.
    pub live: LiveConfig,
    /// The metrics' own listener.
    pub metrics: MetricsConfig,
    /// Logging.
    pub log: LogConfig,
    /// Every leaf as it is printed, with where it came from.
    #[serde(skip)]
    pub(crate) printed: BTreeMap<String, (String, Origin)>,
}

/// Listener and its bounds.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServerConfig {
    /// Address and port of the API.
    pub listen: SocketAddr,
    /// Whether plain HTTP may be served on an address that other machines reach.
    pub allow_plain_http_on_public_address: bool,
    /// Connections served at a time.
    pub max_connections: usize,
    /// Time for a request's head, ms.
    pub header_read_timeout_ms: u64,
    /// Time that a body or an answer may stand still, ms.
    pub body_stall_timeout_ms: u64,
    /// Time for a whole body, ms.
    pub body_read_timeout_ms: u64,
    /// Time for a shutdown, ms.
    pub shutdown_timeout_ms: u64,
    /// Failed authentications of one address in a minute.
    pub failed_auth_per_minute: u32,
}

impl ServerConfig {
    /// Time for a request's head, and for silence between requests.
    pub const fn header_read_timeout(&self) -> Duration {
        Duration::from_millis(self.header_read_timeout_ms)
    }

    /// Time that a body or an answer may stand still.
    pub const fn body_stall_timeout(&self) -> Duration {
        Duration::from_millis(self.body_stall_timeout_ms)
    }

    /// Time for a whole body.
    pub const fn body_read_timeout(&self) -> Duration {
        Duration::from_millis(self.body_read_timeout_ms)
    }

    /// Time for a shutdown.
    pub const fn shutdown_timeout(&self) -> Duration {
        Duration::from_millis(self.shutdown_timeout_ms)
    }
}

/// The database.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatabaseConfig {
    /// Where it is; empty for SQLite in the data directory. Holds a password, so it prints hidden.
    #[serde(deserialize_with = "secret")]
    pub url: SecretString,
    /// Connections to PostgreSQL.
    pub connections: u32,
    /// Whether the address is a pooler's in transaction mode.
    pub pooled: bool,
    /// Address of the server itself, for migrations; empty for the same.
    #[serde(deserialize_with = "secret")]
    pub direct_url: SecretString,
}

/// Which database engine is used.
#[derive(Debug, Clone)]
pub enum Engine {
    /// SQLite in this file.
    Sqlite(PathBuf),
    /// PostgreSQL at this address.
    Postgres(SecretString),
}

/// Bounds of what is taken in and given out.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Largest body as it is sent, bytes.
    pub body_bytes: usize,
    /// Largest body after decompression, bytes.
    pub decoded_bytes: usize,
    /// Largest body of a registration, bytes.
    pub registration_bytes: usize,
    /// Samples in one cycle.
    pub samples_per_cycle: usize,
    /// Lines in one batch.
    pub batch_lines: usize,
    /// Cycles waiting for the writer.
    pub queue_length: usize,
    /// Cycles committed in one transaction.
    pub group_size: usize,
    /// Rows in a page where no number is asked for.
    pub default_page_size: u32,
    /// Most rows in a page.
    pub max_page_size: u32,
    /// Machines that have a metric of their own.
    pub metric_machines: usize,
}

/// Bounds of the quarantine.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuarantineConfig {
    /// Most unsettled entries.
    pub entries: u64,
    /// Most bytes of unsettled bodies.
    pub bytes: u64,
}

impl QuarantineConfig {
    /// The bounds as the store takes them.
    pub const fn bounds(&self) -> QuarantineBounds {
        QuarantineBounds { entries: self.entries, bytes: self.bytes }
    }
}

/// How long samples are kept.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RetentionConfig {
    /// Days since they were received; 0 for any age.
    pub samples_days: u32,
    /// Bytes of a machine as they are stored; 0 for any size.
    pub samples_bytes: u64,
    /// Time between two runs, ms.
    pub interval_ms: u64,
    /// Cycles whose samples go in one transaction.
    pub step_cycles: u32,
    /// Pause between two transactions, ms.
    pub pause_ms: u64,
}

impl RetentionConfig {
    /// What holds for machines that nothing else was said of.
    pub fn samples(&self) -> SampleRetention {
        SampleRetention {
            days: (self.samples_days > 0).then_some(self.samples_days),
            bytes: (self.samples_bytes > 0).then_some(self.samples_bytes),
        }
    }

    /// Time between two runs.
    pub const fn interval(&self) -> Duration {
        Duration::from_millis(self.interval_ms)
    }

    /// Pause between two transactions.
    pub const fn pause(&self) -> Duration {
        Duration::from_millis(self.pause_ms)
    }
}

/// How long recommendations and data stay good.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecommendationConfig {
    /// A recommendation is valid for so long, ms.
    pub validity_ms: i64,
    /// Data older than this is stale, ms.
    pub stale_after_ms: i64,
}

impl RecommendationConfig {
    /// The settings as the rules take them.
    pub const fn settings(&self) -> RecommendSettings {
        RecommendSettings { validity_ms: self.validity_ms, stale_after_ms: self.stale_after_ms }
    }
}

/// How often the watch looks around, and when it alarms.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WatchConfig {
    /// Time between two rounds, ms.
    pub interval_ms: u64,
    /// A machine without a cycle for so long is silent, ms; 0: never.
    pub machine_silent_after_ms: i64,
    /// Machines with a limit of their own, ms.
    #[serde(deserialize_with = "limits_by_machine")]
    pub machine_silent_after_ms_by_machine: BTreeMap<MachineId, i64>,
    /// The quarantine alarms when it is filled to this share, %.
    pub quarantine_warning_percent: u32,
}

impl WatchConfig {
    /// Time between two rounds.
    pub const fn interval(&self) -> Duration {
        Duration::from_millis(self.interval_ms)
    }

    /// The settings as the store takes them.
    pub fn settings(&self, quarantine: QuarantineBounds) -> WatchSettings {
        let limit = |ms: i64| (ms > 0).then_some(ms);
        let own = self.machine_silent_after_ms_by_machine.iter();
        WatchSettings {
            silent_after_ms: limit(self.machine_silent_after_ms),
            silent_after_ms_by_machine: own.map(|(machine, &ms)| (machine.clone(), limit(ms))).collect(),
            quarantine,
            quarantine_warning_ratio: f64::from(self.quarantine_warning_percent) / 100.0,
        }
    }
}

/// The live view.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiveConfig {
    /// Readers at a time.
    pub readers: usize,
    /// Events kept for readers that come back.
    pub history_events: usize,
    /// A comment is sent where nothing else was for so long, ms.
    pub heartbeat_ms: u64,
    /// A running cycle's samples are shown at most so often, ms.
    pub sample_interval_ms: u64,
}

impl LiveConfig {
    /// A comment is sent where nothing else was for so long.
    pub const fn heartbeat(&self) -> Duration {
        Duration::from_millis(self.heartbeat_ms)
    }
}

/// The metrics' own listener.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MetricsConfig {
    /// Address and port where metrics are served without a token.
    #[serde(deserialize_with = "address_or_none")]
    pub listen: Option<SocketAddr>,
}

/// Logging.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogConfig {
    /// How lines look.
    pub format: LogFormat,
    /// Which lines are written.
    pub level: String,
}

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// For people.
    Text,
    /// A JSON object a line.
    Json,
}

fn secret<'de, D: Deserializer<'de>>(from: D) -> Result<SecretString, D::Error> {
    String::deserialize(from).map(SecretString::from)
}

fn address_or_none<'de, D: Deserializer<'de>>(from: D) -> Result<Option<SocketAddr>, D::Error> {
    let text = String::deserialize(from)?;
    if text.is_empty() {
        return Ok(None);
    }
    text.parse().map(Some).map_err(serde::de::Error::custom)
}

/// `M1=900000, M2=0`.
fn limits_by_machine<'de, D: Deserializer<'de>>(from: D) -> Result<BTreeMap<MachineId, i64>, D::Error> {
    let text = String::deserialize(from)?;
    let mut limits = BTreeMap::new();
    for part in text.split(',').map(str::trim).filter(|part| !part.is_empty()) {
        let limit = part.split_once('=').and_then(|(machine, ms)| {
            Some((MachineId::try_from(machine.trim()).ok()?, ms.trim().parse::<i64>().ok()?))
        });
        let Some((machine, ms)) = limit else {
            return Err(serde::de::Error::custom(format!("`{part}` is not MACHINE=MILLISECONDS")));
        };
        if limits.insert(machine, ms).is_some() {
            return Err(serde::de::Error::custom(format!("`{part}` names a machine a second time")));
        }
    }
    Ok(limits)
}

impl Config {
    /// Reads the layers, refuses unknown keys and wrong types, and checks the values.
    pub fn load(sources: &Sources) -> Result<Self, ConfigError> {
        let config = layers::merge(sources)?;
        config.check()?;
        Ok(config)
    }

    /// The defaults, with a data directory and any free port of the loopback: for tests and the demo.
    pub fn for_tests(data_dir: &Path) -> Result<Self, ConfigError> {
        let flags = vec![
            ("data_dir".to_owned(), data_dir.to_string_lossy().into_owned()),
            ("server.listen".to_owned(), "127.0.0.1:0".to_owned()),
        ];
        Self::load(&Sources { flags, ..Sources::default() })
    }

    /// Which database engine is used.
    pub fn engine(&self) -> Engine {
        if self.database.url.expose_secret().is_empty() {
            Engine::Sqlite(self.data_dir.join("feedwright.sqlite3"))
        } else {
            Engine::Postgres(self.database.url.clone())
        }
    }

    /// One line per setting: name, value with secrets hidden, and where it came from.
    pub fn print(&self) -> String {
        let lines =
            self.printed.iter().map(|(name, (value, origin))| format!("{name} = {value}  # {origin}\n"));
        lines.collect()
    }

    fn check(&self) -> Result<(), ConfigError> {
        let mut wrong = Vec::new();
        let mut must = |holds: bool, path: &str, what: &str| {
            if !holds {
                wrong.push(format!("{path}: {what}"));
            }
        };
        let allowed = self.server.allow_plain_http_on_public_address;
        for (path, address) in
            [("server.listen", Some(self.server.listen)), ("metrics.listen", self.metrics.listen)]
        {
            must(
                address.is_none_or(|address| allowed || address.ip().is_loopback()),
                path,
                "other machines reach this address and plain HTTP would show tokens and data to the network; \
                 listen on 127.0.0.1 or ::1, or set server.allow_plain_http_on_public_address where TLS is \
                 ended by something in front",
            );
        }
        for (path, url) in
            [("database.url", &self.database.url), ("database.direct_url", &self.database.direct_url)]
        {
            let url = url.expose_secret();
            let postgres = url.starts_with("postgres://") || url.starts_with("postgresql://");
            must(url.is_empty() || postgres, path, "must be empty or begin with postgres://");
        }
        must((1..=1000).contains(&self.database.connections), "database.connections", "1 to 1000");
        must(!self.data_dir.as_os_str().is_empty(), "data_dir", "must not be empty");
        must((1..=65_536).contains(&self.server.max_connections), "server.max_connections", "1 to 65536");
        for (path, value, most) in [
            ("server.header_read_timeout_ms", self.server.header_read_timeout_ms, 600_000),
            ("server.body_stall_timeout_ms", self.server.body_stall_timeout_ms, 600_000),
            ("server.body_read_timeout_ms", self.server.body_read_timeout_ms, 3_600_000),
            ("server.shutdown_timeout_ms", self.server.shutdown_timeout_ms, 600_000),
            ("retention.interval_ms", self.retention.interval_ms, 366 * 86_400_000),
            ("retention.step_cycles", u64::from(self.retention.step_cycles), 10_000),
            ("live.heartbeat_ms", self.live.heartbeat_ms, 600_000),
            ("live.sample_interval_ms", self.live.sample_interval_ms, 60_000),
            ("quarantine.entries", self.quarantine.entries, 10_000_000),
            ("quarantine.bytes", self.quarantine.bytes, 1 << 40),
            ("recommendation.validity_ms", self.recommendation.validity_ms.max(0).unsigned_abs(), 86_400_000),
            (
                "recommendation.stale_after_ms",
                self.recommendation.stale_after_ms.max(0).unsigned_abs(),
                366 * 86_400_000,
            ),
        ] {
            must((1..=most).contains(&value), path, &format!("1 to {most}"));
        }
        for (path, value, most) in [
            ("limits.body_bytes", self.limits.body_bytes, 1 << 30),
            ("limits.decoded_bytes", self.limits.decoded_bytes, 1 << 31),
            ("limits.registration_bytes", self.limits.registration_bytes, 1 << 24),
            ("limits.samples_per_cycle", self.limits.samples_per_cycle, 10_000_000),
            ("limits.batch_lines", self.limits.batch_lines, 1_000_000),
            ("limits.queue_length", self.limits.queue_length, 1_000_000),
            ("limits.group_size", self.limits.group_size, 10_000),
            ("limits.metric_machines", self.limits.metric_machines, 10_000),
            ("live.readers", self.live.readers, 10_000),
            ("live.history_events", self.live.history_events, 1_000_000),
        ] {
            must((1..=most).contains(&value), path, &format!("1 to {most}"));
        }
        must(self.retention.samples_days <= 36_500, "retention.samples_days", "0 to 36500");
        must(self.retention.pause_ms <= 60_000, "retention.pause_ms", "0 to 60000");
        let (default, most) = (self.limits.default_page_size, self.limits.max_page_size);
        must((1..=10_000).contains(&most), "limits.max_page_size", "1 to 10000");
        must((1..=most).contains(&default), "limits.default_page_size", "1 to limits.max_page_size");
        must(
            (1..=100_000).contains(&self.server.failed_auth_per_minute),
            "server.failed_auth_per_minute",
            "1 to 100000",
        );
        let watch = &self.watch;
        must((100..=3_600_000).contains(&watch.interval_ms), "watch.interval_ms", "100 to 3600000");
        let silences = watch.machine_silent_after_ms_by_machine.values();
        for (path, ms) in [("watch.machine_silent_after_ms", watch.machine_silent_after_ms)]
            .into_iter()
            .chain(silences.map(|&ms| ("watch.machine_silent_after_ms_by_machine", ms)))
        {
            // Shorter, and a replica that was handed the cycle could not have told the others yet.
            let least = i64::try_from(watch.interval_ms).unwrap_or(i64::MAX).saturating_mul(2);
            must(
                ms == 0 || (least..=366 * 86_400_000).contains(&ms),
                path,
                &format!("0, or {least} (twice watch.interval_ms) to {}", 366_i64 * 86_400_000),
            );
        }
        must(
            (1..=100).contains(&watch.quarantine_warning_percent),
            "watch.quarantine_warning_percent",
            "1 to 100",
        );
        let directives = tracing_subscriber::EnvFilter::try_new(&self.log.level);
        must(directives.is_ok(), "log.level", "must be a level or directives");
        if wrong.is_empty() { Ok(()) } else { Err(ConfigError::Invalid(wrong)) }
    }
}

//! What can be configured: the embedded defaults, a file, the environment and flags, in that order.
//!
//! A new setting is a commented line in `default.toml`, a field here with the same name, and a check in
//! [`Config::check`] where not every value makes sense. The default file is the schema: a key that it lacks is
//! refused. Reading a setting anywhere but from a [`Config`] does not belong in this crate.

mod layers;

pub(crate) use layers::settings_of;
pub use layers::{ConfigError, Origin, Sources};

use feedwright_core::closed_loop::LoopSettings;
use feedwright_core::closed_loop::control::LawSettings;
use feedwright_core::cycle::MOST_SAMPLES;
use feedwright_core::friction::law::OverloadHold;
use feedwright_core::ids::MachineId;
use feedwright_core::recommend::RecommendSettings;
use feedwright_store::{LONGEST_LEASE_MS, QuarantineBounds, SampleRetention, WatchSettings};
use http::{HeaderName, HeaderValue, Uri};
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
    /// TLS on the API's listener.
    pub tls: TlsConfig,
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
    /// The machines' streams.
    pub stream: StreamConfig,
    /// How often the watch looks around, and when it alarms.
    pub watch: WatchConfig,
    /// The live view.
    pub live: LiveConfig,
    /// The metrics' own listener.
    pub metrics: MetricsConfig,
    /// Traces.
    pub traces: TracesConfig,
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

/// TLS on the API's listener.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TlsConfig {
    /// Certificate chain, PEM; empty: plain HTTP.
    pub certificate: PathBuf,
    /// Private key, PEM.
    pub key: PathBuf,
    /// Time for a handshake, ms.
    pub handshake_timeout_ms: u64,
    /// Time between two looks at the files, ms.
    pub reload_interval_ms: u64,
}

impl TlsConfig {
    /// Whether the API speaks TLS itself: cookies are `Secure` then, and addresses begin with `https`.
    pub fn is_on(&self) -> bool {
        !self.certificate.as_os_str().is_empty()
    }

    /// What the API's addresses begin with.
    pub fn scheme(&self) -> &'static str {
        if self.is_on() { "https" } else { "http" }
    }

    /// Time for a handshake.
    pub const fn handshake_timeout(&self) -> Duration {
        Duration::from_millis(self.handshake_timeout_ms)
    }

    /// Time between two looks at the files.
    pub const fn reload_interval(&self) -> Duration {
        Duration::from_millis(self.reload_interval_ms)
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
    /// Large bodies of cycles that are held at once, of single ones and of batches each, bytes.
    pub large_bodies_bytes: usize,
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

impl Limits {
    /// Room for large bodies, bytes: for one of them at the least.
    pub fn room_bytes(&self) -> usize {
        self.large_bodies_bytes.max(self.body_bytes).max(self.decoded_bytes)
    }
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

/// The machines' streams, and the law that answers them.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StreamConfig {
    /// Streams open at a time.
    pub max_connections: usize,
    /// What becomes of a second stream of a machine: `takeover` or `refuse`.
    pub second: String,
    /// Whether overrides may be told; else every cycle runs in shadow.
    pub advise: bool,
    /// Origins of browsers' pages that may open streams, separated by commas.
    pub allowed_origins: String,
    /// Largest message, bytes.
    pub message_bytes: usize,
    /// Samples in one message.
    pub samples_per_message: usize,
    /// Samples of one cycle.
    pub samples_per_cycle: usize,
    /// Samples of all running cycles, bytes.
    pub buffered_bytes: usize,
    /// Longest cycle, ms.
    pub cycle_time_ms: u64,
    /// A sample older than this is not judged, ms.
    pub sample_age_limit_ms: u64,
    /// An answer may be acted on for so long, ms.
    pub validity_ms: u64,
    /// A ping is sent so often, ms.
    pub heartbeat_ms: u64,
    /// A stream where nothing is heard for so long is closed, ms.
    pub idle_ms: u64,
    /// A machine may resume a cycle for so long after its connection broke, ms.
    pub resume_ms: u64,
    /// A lease ends so long after it was last prolonged, ms.
    pub lease_ms: u64,
    /// Intensity b of the law.
    pub intensity: f64,
    /// Largest rise of the override per interpolator cycle, points.
    pub rise_limit_points: f64,
    /// The law is off for so long after a cycle's start, ms.
    pub heating_ms: u64,
    /// Good samples after a bad one before the law may raise again.
    pub settling_samples: u32,
    /// What an overload does: `acknowledged`, `next_cycle` or `off`.
    pub after_overload: String,
    /// Load over its preferred value at which it is an overload.
    pub overload_relative_load: f64,
    /// Least override of a program that gives none, percent.
    pub override_min_percent: f64,
    /// Greatest override of a program that gives none, percent.
    pub override_max_percent: f64,
}

/// What becomes of a second stream of a machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SecondStream {
    /// It takes the machine over; the first one is closed.
    Takeover,
    /// It is refused as long as the first one is open.
    Refuse,
}

impl StreamConfig {
    /// What becomes of a second stream of a machine.
    pub fn second(&self) -> SecondStream {
        if self.second == "refuse" { SecondStream::Refuse } else { SecondStream::Takeover }
    }

    /// Origins that may open streams.
    pub fn origins(&self) -> Vec<String> {
        let origins = self.allowed_origins.split(',').map(str::trim).filter(|origin| !origin.is_empty());
        origins.map(str::to_owned).collect()
    }

    /// A ping is sent so often.
    pub const fn heartbeat(&self) -> Duration {
        Duration::from_millis(self.heartbeat_ms)
    }

    /// A stream where nothing is heard for so long is closed.
    pub const fn idle(&self) -> Duration {
        Duration::from_millis(self.idle_ms)
    }

    /// A machine may resume a cycle for so long.
    pub const fn resume(&self) -> Duration {
        Duration::from_millis(self.resume_ms)
    }

    /// A lease ends so long after it was last prolonged.
    pub const fn lease(&self) -> Duration {
        Duration::from_millis(self.lease_ms)
    }

    /// Bounds of a running cycle.
    #[expect(clippy::cast_precision_loss, reason = "the check keeps both below a day")]
    pub fn bounds(&self) -> LoopSettings {
        LoopSettings {
            oldest_sample_ms: self.sample_age_limit_ms as f64,
            validity_ms: i64::try_from(self.validity_ms).unwrap_or(i64::MAX),
            most_samples: self.samples_per_cycle,
            longest_cycle_ms: self.cycle_time_ms as f64,
        }
    }

    /// The law's settings.
    #[expect(clippy::cast_precision_loss, reason = "the check keeps it below ten minutes")]
    pub fn law(&self) -> LawSettings {
        let relative_load = self.overload_relative_load;
        LawSettings {
            intensity: self.intensity,
            rise_limit_points: self.rise_limit_points,
            heating_ms: self.heating_ms as f64,
            settling_samples: self.settling_samples,
            overload: match self.after_overload.as_str() {
                "off" => OverloadHold::Off,
                "next_cycle" => OverloadHold::UntilNextCycle { relative_load },
                _ => OverloadHold::UntilAcknowledged { relative_load },
            },
            program_range: (self.override_min_percent, self.override_max_percent),
        }
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

/// Traces.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TracesConfig {
    /// The collector's address; empty: no traces.
    pub endpoint: String,
    /// Headers that it asks for. They hold secrets, so they print hidden.
    #[serde(deserialize_with = "secret")]
    pub headers: SecretString,
    /// Share of the requests that are traced, %.
    pub sample_percent: u32,
}

impl TracesConfig {
    /// Whether traces are sent.
    pub const fn is_on(&self) -> bool {
        !self.endpoint.is_empty()
    }
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
        let is_own = |address: SocketAddr| allowed || address.ip().is_loopback();
        must(
            self.tls.is_on() || is_own(self.server.listen),
            "server.listen",
            "other machines reach this address and plain HTTP would show tokens and data to the network; \
             set tls.certificate and tls.key, or listen on 127.0.0.1 or ::1, or set \
             server.allow_plain_http_on_public_address where TLS is ended by something in front",
        );
        must(
            self.metrics.listen.is_none_or(is_own),
            "metrics.listen",
            "other machines reach this address, which speaks plain HTTP and asks for no token, with TLS or without; \
             listen on 127.0.0.1 or ::1, or set server.allow_plain_http_on_public_address where the network is trusted",
        );
        must(
            self.tls.is_on() != self.tls.key.as_os_str().is_empty(),
            "tls.key",
            "certificate and key belong together: set both or neither",
        );
        let endpoint = &self.traces.endpoint;
        must(
            endpoint.is_empty() || endpoint.starts_with("http://") || endpoint.starts_with("https://"),
            "traces.endpoint",
            "must be empty or begin with http:// or https://",
        );
        must(self.traces.sample_percent <= 100, "traces.sample_percent", "0 to 100");
        for (path, url) in
            [("database.url", &self.database.url), ("database.direct_url", &self.database.direct_url)]
        {
            let url = url.expose_secret();
            let postgres = url.starts_with("postgres://") || url.starts_with("postgresql://");
            must(url.is_empty() || postgres, path, "must be empty or begin with postgres://");
            let unknown = feedwright_store::unknown_parameter(url).filter(|_| postgres);
            must(unknown.is_none(), path, unknown.as_deref().unwrap_or_default());
        }
        must(
            !self.database.pooled || !self.database.direct_url.expose_secret().is_empty(),
            "database.direct_url",
            "name the server itself where database.pooled is set: what listens, and the lock of migrations, would stay on a \
             connection that the pooler gives to others",
        );
        must((1..=1000).contains(&self.database.connections), "database.connections", "1 to 1000");
        must(!self.data_dir.as_os_str().is_empty(), "data_dir", "must not be empty");
        must((1..=65_536).contains(&self.server.max_connections), "server.max_connections", "1 to 65536");
        for (path, value, most) in [
            ("server.header_read_timeout_ms", self.server.header_read_timeout_ms, 600_000),
            ("server.body_stall_timeout_ms", self.server.body_stall_timeout_ms, 600_000),
            ("server.body_read_timeout_ms", self.server.body_read_timeout_ms, 3_600_000),
            ("tls.handshake_timeout_ms", self.tls.handshake_timeout_ms, 600_000),
            ("tls.reload_interval_ms", self.tls.reload_interval_ms, 86_400_000),
            ("server.shutdown_timeout_ms", self.server.shutdown_timeout_ms, 600_000),
            ("retention.interval_ms", self.retention.interval_ms, 366 * 86_400_000),
            ("retention.step_cycles", u64::from(self.retention.step_cycles), 10_000),
            ("stream.cycle_time_ms", self.stream.cycle_time_ms, 86_400_000),
            ("stream.sample_age_limit_ms", self.stream.sample_age_limit_ms, 60_000),
            ("stream.validity_ms", self.stream.validity_ms, 60_000),
            ("stream.heartbeat_ms", self.stream.heartbeat_ms, 600_000),
            ("stream.idle_ms", self.stream.idle_ms, 3_600_000),
            ("stream.resume_ms", self.stream.resume_ms, 3_600_000),
            ("stream.lease_ms", self.stream.lease_ms, LONGEST_LEASE_MS),
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
            ("limits.large_bodies_bytes", self.limits.large_bodies_bytes, 1 << 34),
            ("limits.registration_bytes", self.limits.registration_bytes, 1 << 24),
            ("limits.samples_per_cycle", self.limits.samples_per_cycle, MOST_SAMPLES),
            ("limits.batch_lines", self.limits.batch_lines, 1_000_000),
            ("limits.queue_length", self.limits.queue_length, 1_000_000),
            ("limits.group_size", self.limits.group_size, 10_000),
            ("limits.metric_machines", self.limits.metric_machines, 10_000),
            ("stream.max_connections", self.stream.max_connections, 65_536),
            ("stream.message_bytes", self.stream.message_bytes, 1 << 24),
            ("stream.samples_per_message", self.stream.samples_per_message, 4096),
            ("stream.samples_per_cycle", self.stream.samples_per_cycle, self.limits.samples_per_cycle),
            ("stream.buffered_bytes", self.stream.buffered_bytes, 1 << 40),
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
        let stream = &self.stream;
        must(matches!(stream.second.as_str(), "takeover" | "refuse"), "stream.second", "takeover or refuse");
        must(
            matches!(stream.after_overload.as_str(), "acknowledged" | "next_cycle" | "off"),
            "stream.after_overload",
            "acknowledged, next_cycle or off",
        );
        for (path, value, least, most) in [
            ("stream.intensity", stream.intensity, 0.01, 100.0),
            ("stream.rise_limit_points", stream.rise_limit_points, 0.01, 255.0),
            ("stream.overload_relative_load", stream.overload_relative_load, 1.01, 100.0),
            ("stream.override_min_percent", stream.override_min_percent, 0.1, 100.0),
            ("stream.override_max_percent", stream.override_max_percent, 100.0, 255.0),
        ] {
            must((least..=most).contains(&value), path, &format!("{least} to {most}"));
        }
        must(stream.heating_ms <= 600_000, "stream.heating_ms", "0 to 600000");
        must((1..=1000).contains(&stream.settling_samples), "stream.settling_samples", "1 to 1000");
        must(
            stream.lease_ms >= 300,
            "stream.lease_ms",
            "at least 300: it is prolonged three times before it ends",
        );
        must(stream.idle_ms > stream.heartbeat_ms, "stream.idle_ms", "more than stream.heartbeat_ms");
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
        must(
            is_filter(&self.log.level),
            "log.level",
            "must be off, error, warn, info, debug or trace, or directives such as info,feedwright_store=debug",
        );
        let headers = self.traces.headers.expose_secret();
        let mut headers = headers.split(',').filter(|header| !header.trim().is_empty());
        must(
            headers.all(is_header),
            "traces.headers",
            "must be name=value, separated by commas, as they may stand in a request",
        );
        let origins = self.stream.origins();
        let strange = origins.iter().find(|origin| !is_origin(origin));
        must(
            strange.is_none(),
            "stream.allowed_origins",
            &format!(
                "`{}` is not SCHEME://HOST or SCHEME://HOST:PORT, as browsers name a page's origin: no path, and no slash \
                 at the end",
                strange.map_or("", String::as_str)
            ),
        );
        if wrong.is_empty() { Ok(()) } else { Err(ConfigError::Invalid(wrong)) }
    }
}

/// Whether a text is a header's name and its value. What is none would be left out without a word.
fn is_header(text: &str) -> bool {
    text.split_once('=').is_some_and(|(name, value)| {
        HeaderName::try_from(name.trim()).is_ok() && HeaderValue::try_from(value.trim()).is_ok()
    })
}

/// Whether a text is an origin as a browser sends it (RFC 6454, section 6.2): anything else is never met. The port that a scheme has
/// anyway is not sent with it.
fn is_origin(text: &str) -> bool {
    let Ok(uri) = Uri::try_from(text) else { return false };
    let (Some(scheme), Some(authority)) = (uri.scheme_str(), uri.authority()) else { return false };
    let is_its_own = matches!((scheme, authority.port_u16()), ("http", Some(80)) | ("https", Some(443)));
    !authority.host().is_empty()
        && !authority.as_str().contains('@')
        && !is_its_own
        && text.len() == scheme.len() + "://".len() + authority.as_str().len()
}

/// Whether a text filters the log as it says. A word that is no level would be taken for the name of a part of the program,
/// and nothing else be written: a mistyped level must not end the log.
fn is_filter(text: &str) -> bool {
    const LEVELS: [&str; 6] = ["off", "error", "warn", "info", "debug", "trace"];
    let is_level = |word: &str| LEVELS.iter().any(|level| level.eq_ignore_ascii_case(word));
    // Spans and their fields have commas and signs of their own.
    let has_spans = text.contains('[');
    let mut directives = text.split(',').map(str::trim).filter(|directive| !directive.is_empty());
    let known = has_spans
        || directives.all(|directive| match directive.rsplit_once('=') {
            Some((target, level)) => !target.trim().is_empty() && is_level(level.trim()),
            None => is_level(directive),
        });
    // Of no directive at all nothing would be written.
    let any = !text.split(',').all(|directive| directive.trim().is_empty());
    any && known && tracing_subscriber::EnvFilter::try_new(text).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_origin_is_what_a_browser_sends() {
        for origin in
            ["https://hmi.example", "HTTP://HMI:8080", "http://10.0.0.7", "https://[::1]:8443", "app://hmi"]
        {
            assert!(is_origin(origin), "{origin}");
        }
        for text in [
            "foo",
            "https://a.example/",
            "https://a.example/x",
            "https://a.example?x",
            "//a.example",
            "a.example:80",
            "https://u@a.example",
            "https://a.example:443",
            "http://a.example:80",
            "https://",
            "null",
            "*",
        ] {
            assert!(!is_origin(text), "{text}");
        }
    }

    #[test]
    fn a_mistyped_level_is_no_filter() {
        for filter in ["info", "WARN", "info,feedwright_store=debug", "off,", "[request{id=7}]=debug"] {
            assert!(is_filter(filter), "{filter}");
        }
        for word in ["", " ", ",", "warning", "banana", "info,verbose", "feedwright_store=loud", "=debug"] {
            assert!(!is_filter(word), "{word}");
        }
    }
}

//! Metrics as Prometheus scrapes them: base units, ratios, and labels that are constants, matched routes or
//! registered machines; never a cycle, a tool or anything a client typed.
//!
//! A new metric is a field of [`Metrics`] and a line in [`Metrics::new`]; one with a machine's label belongs to
//! [`machines`], which bounds how many machines have one. What is shop-wide (alarms, silence, quarantine) is told by
//! every replica alike: rules take the maximum over instances, never the sum.

mod machines;
mod registrar;

use feedwright_core::ids::{MachineId, ToolId};
use feedwright_core::recommend::Recommendation;
use feedwright_core::units::{Process, Timestamp};
use feedwright_core::wear::Verdict;
use feedwright_store::{AlarmKind, DatabaseUsage, DropReason, Dropped, FleetRow, Round};
use http::{Method, StatusCode};
use machines::MachineMetrics;
use prometheus::{
    Gauge, GaugeVec, Histogram, HistogramVec, IntCounter, IntCounterVec, IntGauge, IntGaugeVec, Registry,
    TextEncoder,
};
use registrar::Registrar;
use std::time::Duration;

/// Bounds of commit times: an fsync takes about a millisecond on a good disk, and seconds on a bad day.
const COMMIT_SECONDS: [f64; 12] = [0.0005, 0.001, 0.002, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 5.0];
/// Bounds of group sizes.
const GROUP_SIZES: [f64; 10] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, 512.0];
/// Bounds of cycle energies: from a small drill to a long rough cut.
const ENERGIES: [f64; 12] = [10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4, 3e4, 1e5, 3e5, 1e6, 1e7];
/// Bounds of answer times.
const ANSWER_SECONDS: [f64; 12] = [0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 5.0];
/// Why cycles are refused and not kept, as problem codes; they stand at 0 from the start, since the rate of a series
/// that appears with its first event misses that event. A code that is not here is counted all the same.
const REJECTIONS: [&str; 22] = [
    "malformed_json",
    "malformed_cycle",
    "malformed_encoding",
    "body_too_large",
    "decoded_body_too_large",
    "too_many_large_bodies",
    "body_incomplete",
    "body_too_slow",
    "too_many_lines",
    "unsupported_media_type",
    "unknown_machine",
    "queue_full",
    "quarantine_full",
    "quarantine_refused",
    "shutting_down",
    "database_unavailable",
    "too_many_reads",
    "database_not_writable",
    "database_not_readable",
    "outcome_unknown",
    "stored_data_damaged",
    "internal_error",
];
/// Why a token is refused, as problem codes.
const REFUSALS: [&str; 5] =
    ["token_missing", "token_malformed", "token_unknown", "token_revoked", "too_many_failed_authentications"];

/// What became of a cycle that was taken in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CycleOutcome {
    /// New and committed.
    Accepted,
    /// Known with the same content.
    Duplicate,
    /// Not acceptable, kept in quarantine.
    Quarantined,
}

impl CycleOutcome {
    const ALL: [Self; 3] = [Self::Accepted, Self::Duplicate, Self::Quarantined];

    const fn as_str(self) -> &'static str {
        match self {
            Self::Accepted => "accepted",
            Self::Duplicate => "duplicate",
            Self::Quarantined => "quarantined",
        }
    }
}

/// The metrics, in a registry of their own.
pub struct Metrics {
    registry: Registry,
    machines: MachineMetrics,
    cycles: IntCounterVec,
    cycles_rejected: IntCounterVec,
    cycles_quarantined: IntCounterVec,
    cycle_energy: HistogramVec,
    recommendations: IntCounterVec,
    samples_dropping: IntCounterVec,
    samples_dropped_cycles: IntCounter,
    samples_dropped_bytes: IntCounter,
    http_requests: IntCounterVec,
    http_seconds: HistogramVec,
    refused_tokens: IntCounterVec,
    alarms_open: IntGaugeVec,
    connections: IntGauge,
    streams_open: IntGauge,
    stream_samples: IntCounter,
    stream_refusals: IntCounterVec,
    ready: IntGauge,
    last_round: Gauge,
    last_backup: Gauge,
    damaged_rows: IntGauge,
    registered_machines: IntGauge,
    quarantine_entries: IntGauge,
    quarantine_max_entries: IntGauge,
    quarantine_bytes: IntGauge,
    quarantine_max_bytes: IntGauge,
    database_bytes: IntGauge,
    database_wal_bytes: IntGaugeVec,
    database_connections: IntGaugeVec,
    database_max_connections: IntGauge,
    certificate_not_after: GaugeVec,
    certificate_reloads: IntCounterVec,
    handshakes_failed: IntCounter,
    disk_size: GaugeVec,
    disk_available: GaugeVec,
    /// Cycles that wait for the writer.
    pub ingest_queue_depth: IntGauge,
    /// Most cycles that may wait for the writer.
    pub ingest_queue_capacity: IntGauge,
    /// Time from the begin of a commit to its durable end.
    pub commit_seconds: Histogram,
    /// Cycles in one commit.
    pub commit_group_size: Histogram,
}

impl Metrics {
    /// Registers every metric. At most `most_machines` machines get a label.
    pub fn new(most_machines: usize) -> Result<Self, prometheus::Error> {
        let new = Registrar::default();
        new.constant(
            "feedwright_build_info",
            "1, labelled with the version of the build",
            &[("version", env!("CARGO_PKG_VERSION"))],
        )?;
        new.process()?;
        let metrics = Self {
            machines: MachineMetrics::new(&new, most_machines)?,
            cycles: new.counters("feedwright_cycles_total", "Cycles taken in, by outcome", &["outcome"])?,
            cycles_rejected: new.counters(
                "feedwright_cycles_rejected_total",
                "Cycles that were refused and not kept, by problem code; a body that is refused before it is read counts once",
                &["reason"],
            )?,
            cycles_quarantined: new.counters(
                "feedwright_cycles_quarantined_total",
                "Cycles that went to quarantine, by problem code",
                &["reason"],
            )?,
            cycle_energy: new.histograms(
                "feedwright_cycle_energy_joules",
                "Energy of accepted cycles",
                &["process"],
                &ENERGIES,
            )?,
            recommendations: new.counters(
                "feedwright_recommendations_total",
                "Recommendations handed out, by action",
                &["action"],
            )?,
            samples_dropping: new.counters(
                "feedwright_sample_drop_decisions_total",
                "Decisions of retention to drop samples of a machine, by reason",
                &["reason"],
            )?,
            samples_dropped_cycles: new.counter(
                "feedwright_sample_drop_cycles_total",
                "Cycles whose samples retention has dropped",
            )?,
            samples_dropped_bytes: new.counter(
                "feedwright_sample_drop_bytes_total",
                "Bytes of sample blocks that retention has dropped",
            )?,
            http_requests: new.counters(
                "feedwright_http_requests_total",
                "Answered requests",
                &["route", "method", "status"],
            )?,
            http_seconds: new.histograms(
                "feedwright_http_request_duration_seconds",
                "Time from the request's head to the answer's head",
                &["route", "method"],
                &ANSWER_SECONDS,
            )?,
            streams_open: new.int_gauge("feedwright_streams_open", "Open streams of machines")?,
            stream_samples: new
                .counter("feedwright_stream_samples_total", "Samples answered over streams")?,
            stream_refusals: new.counters(
                "feedwright_stream_refusals_total",
                "Messages of streams that were refused or could not be read, by code",
                &["code"],
            )?,
            refused_tokens: new.counters(
                "feedwright_authentication_failures_total",
                "Requests without a valid token, by problem code",
                &["reason"],
            )?,
            alarms_open: new.int_gauges("feedwright_alarms_open", "Open alarms", &["kind"])?,
            connections: new.int_gauge("feedwright_http_connections", "Open connections")?,
            ready: new.int_gauge(
                "feedwright_ready",
                "1 while the database takes writes, proven by one when this was asked for",
            )?,
            last_round: new.gauge(
                "feedwright_watch_last_round_timestamp_seconds",
                "When the watch last looked at machines, quarantine and alarms",
            )?,
            last_backup: new.gauge(
                "feedwright_last_backup_timestamp_seconds",
                "The database's state of when is backed up, as `feedwright backup` noted; 0 where it never did",
            )?,
            damaged_rows: new.int_gauge(
                "feedwright_registry_damaged_rows",
                "Machines, calibrations, tools, operations and library entries that are not what was written, when they were last looked through",
            )?,
            registered_machines: new.int_gauge(
                "feedwright_machines",
                "Registered machines; those beyond limits.metric_machines have no series of their own",
            )?,
            quarantine_entries: new.int_gauge("feedwright_quarantine_entries", "Unsettled entries")?,
            quarantine_max_entries: new
                .int_gauge("feedwright_quarantine_max_entries", "Most unsettled entries")?,
            quarantine_bytes: new
                .int_gauge("feedwright_quarantine_size_bytes", "Unsettled bodies as they are kept")?,
            quarantine_max_bytes: new
                .int_gauge("feedwright_quarantine_max_size_bytes", "Most bytes of unsettled bodies")?,
            database_bytes: new
                .int_gauge("feedwright_database_size_bytes", "Size of the database, without SQLite's log")?,
            database_wal_bytes: new.int_gauges(
                "feedwright_database_wal_size_bytes",
                "Write-ahead log at the last checkpoint; SQLite only",
                &["engine"],
            )?,
            database_connections: new.int_gauges(
                "feedwright_database_connections",
                "Open connections of this process to the database that read, and on PostgreSQL write",
                &["state"],
            )?,
            database_max_connections: new
                .int_gauge("feedwright_database_max_connections", "Most of these connections")?,
            certificate_not_after: new.gauges(
                "feedwright_tls_certificate_not_after_timestamp_seconds",
                "When the certificate in force ends; absent without TLS",
                &["listener"],
            )?,
            certificate_reloads: new.counters(
                "feedwright_tls_reloads_total",
                "Certificates that were read again, by whether they were taken over",
                &["outcome"],
            )?,
            handshakes_failed: new.counter(
                "feedwright_tls_handshake_failures_total",
                "Connections that ended before or in the TLS handshake",
            )?,
            disk_size: new.gauges(
                "feedwright_disk_size_bytes",
                "File system that holds the data directory; absent where there is none",
                &["directory"],
            )?,
            disk_available: new.gauges(
                "feedwright_disk_available_bytes",
                "What of it this process may still use",
                &["directory"],
            )?,
            ingest_queue_depth: new
                .int_gauge("feedwright_ingest_queue_depth", "Cycles that wait for the writer")?,
            ingest_queue_capacity: new
                .int_gauge("feedwright_ingest_queue_capacity", "Most cycles that may wait for the writer")?,
            commit_seconds: new.histogram(
                "feedwright_commit_seconds",
                "Time of a durable commit",
                &COMMIT_SECONDS,
            )?,
            commit_group_size: new.histogram(
                "feedwright_commit_group_size",
                "Cycles in one commit",
                &GROUP_SIZES,
            )?,
            registry: new.into_registry(),
        };
        // A series that exists from the start can be alerted on; one that appears with the first event cannot.
        for outcome in CycleOutcome::ALL {
            metrics.cycles.with_label_values(&[outcome.as_str()]);
        }
        for reason in DropReason::ALL {
            metrics.samples_dropping.with_label_values(&[reason.as_str()]);
        }
        for kind in AlarmKind::ALL {
            metrics.alarms_open.with_label_values(&[kind.as_str()]);
        }
        for reason in REJECTIONS {
            metrics.cycles_rejected.with_label_values(&[reason]);
        }
        for reason in ["cycle_conflict", "invalid_content", "out_of_range"] {
            metrics.cycles_quarantined.with_label_values(&[reason]);
        }
        for outcome in ["taken_over", "failed"] {
            metrics.certificate_reloads.with_label_values(&[outcome]);
        }
        for reason in REFUSALS {
            metrics.refused_tokens.with_label_values(&[reason]);
        }
        Ok(metrics)
    }

    /// Counts a cycle of a registered machine.
    pub fn cycle(&self, machine: &MachineId, outcome: CycleOutcome) {
        self.cycles.with_label_values(&[outcome.as_str()]).inc();
        self.machines.cycle(machine, outcome);
    }

    /// Counts a cycle that went to quarantine; `code` is the problem's.
    pub fn cycle_quarantined(&self, machine: &MachineId, code: &'static str) {
        self.cycle(machine, CycleOutcome::Quarantined);
        self.cycles_quarantined.with_label_values(&[code]).inc();
    }

    /// Counts a cycle that was refused and not kept; `code` is the problem's. Its machine is what a client said and
    /// gets no label for it.
    pub fn cycle_rejected(&self, code: &'static str) {
        self.cycles_rejected.with_label_values(&[code]).inc();
    }

    /// Takes the energy of an accepted cycle.
    pub fn cycle_energy(&self, process: Option<Process>, joules: f64) {
        let process = process.map_or("unknown", Process::as_str);
        self.cycle_energy.with_label_values(&[process]).observe(joules);
    }

    /// Takes the verdict on the tool that ran last on a registered machine.
    pub fn verdict(&self, machine: &MachineId, cycle: (&ToolId, Timestamp), verdict: &Verdict) {
        self.machines.verdict(machine, cycle, verdict);
    }

    /// Shows what the database says of the wear of some machines.
    pub(crate) fn fleet(&self, rows: &[FleetRow]) {
        self.machines.fleet(rows);
    }

    /// Counts a recommendation that was handed out.
    pub fn recommendation(&self, recommendation: &Recommendation) {
        self.recommendations.with_label_values(&[recommendation.action.as_str()]).inc();
        self.machines.recommendation(recommendation);
    }

    /// Shows no longer what was told of recommendations that are not valid any more.
    pub(crate) fn run_out(&self, now: Timestamp) {
        self.machines.run_out(now);
    }

    /// Counts a request without a valid token; `code` is the problem's.
    pub(crate) fn refused_token(&self, code: &'static str) {
        self.refused_tokens.with_label_values(&[code]).inc();
    }

    /// Sets whether the database takes writes.
    pub(crate) fn ready(&self, ready: bool) {
        self.ready.set(i64::from(ready));
    }

    /// Takes what a round of the watch found.
    pub(crate) fn damaged_rows(&self, rows: usize) {
        self.damaged_rows.set(i64::try_from(rows).unwrap_or(i64::MAX));
    }

    pub(crate) fn round(&self, found: &Round, now: Timestamp) {
        for kind in AlarmKind::ALL {
            let of_kind = found.alarms.iter().filter(|alarms| alarms.kind == kind);
            self.alarms_open.with_label_values(&[kind.as_str()]).set(whole(of_kind.map(|of| of.open).sum()));
        }
        let quarantine = &found.quarantine;
        self.quarantine_entries.set(whole(quarantine.entries));
        self.quarantine_bytes.set(whole(quarantine.bytes));
        self.quarantine_max_entries.set(whole(quarantine.bounds.entries));
        self.quarantine_max_bytes.set(whole(quarantine.bounds.bytes));
        self.registered_machines.set(whole(found.machines.len() as u64));
        self.machines.round(found);
        self.last_backup.set(found.last_backup_at.map_or(0.0, seconds));
        self.last_round.set(seconds(now));
    }

    /// Sets what the database occupies.
    pub(crate) fn database(&self, usage: &DatabaseUsage) {
        self.database_bytes.set(whole(usage.bytes));
        if let Some(bytes) = usage.wal_bytes {
            self.database_wal_bytes.with_label_values(&["sqlite"]).set(whole(bytes));
        }
        let connections = |state, of: u32| {
            self.database_connections.with_label_values(&[state]).set(i64::from(of));
        };
        connections("in_use", usage.connections_in_use);
        connections("idle", usage.connections_idle);
        self.database_max_connections.set(i64::from(usage.connections_max));
    }

    /// Sets the file system of the data directory, bytes.
    pub(crate) fn disk(&self, size: u64, available: u64) {
        self.disk_size.with_label_values(&["data"]).set(float(size));
        self.disk_available.with_label_values(&["data"]).set(float(available));
    }

    /// Open streams.
    pub(crate) const fn streams_open(&self) -> &IntGauge {
        &self.streams_open
    }

    /// Counts samples that were answered.
    pub(crate) fn stream_samples(&self, count: usize) {
        self.stream_samples.inc_by(count as u64);
    }

    /// Counts a message that was refused; `code` is one of ours.
    pub(crate) fn stream_refusal(&self, code: &'static str) {
        self.stream_refusals.with_label_values(&[code]).inc();
    }

    /// Sets when the certificate in force ends, since 1970.
    pub(crate) fn certificate(&self, not_after: Option<Duration>) {
        match not_after {
            Some(end) => self.certificate_not_after.with_label_values(&["api"]).set(end.as_secs_f64()),
            None => drop(self.certificate_not_after.remove_label_values(&["api"])),
        }
    }

    /// Counts a certificate that was read again.
    pub(crate) fn certificate_reloaded(&self, taken_over: bool) {
        let outcome = if taken_over { "taken_over" } else { "failed" };
        self.certificate_reloads.with_label_values(&[outcome]).inc();
    }

    /// Counts a connection that ended before its TLS handshake did.
    pub(crate) fn handshake_failed(&self) {
        self.handshakes_failed.inc();
    }

    /// Open connections.
    pub(crate) const fn connections(&self) -> &IntGauge {
        &self.connections
    }

    /// Counts a decision to drop samples.
    pub fn samples_dropping(&self, reason: DropReason) {
        self.samples_dropping.with_label_values(&[reason.as_str()]).inc();
    }

    /// Counts samples that have gone.
    pub fn samples_dropped(&self, dropped: Dropped) {
        self.samples_dropped_cycles.inc_by(dropped.cycles);
        self.samples_dropped_bytes.inc_by(dropped.bytes);
    }

    /// Counts an answered request; `route` is the matched template.
    pub(crate) fn http(&self, route: &str, method: &Method, status: StatusCode, elapsed: Duration) {
        let method = match *method {
            Method::GET => "GET",
            Method::HEAD => "HEAD",
            Method::POST => "POST",
            Method::PUT => "PUT",
            Method::DELETE => "DELETE",
            _ => "other",
        };
        let class = match status.as_u16() / 100 {
            1 => "1xx",
            2 => "2xx",
            3 => "3xx",
            4 => "4xx",
            _ => "5xx",
        };
        self.http_requests.with_label_values(&[route, method, class]).inc();
        self.http_seconds.with_label_values(&[route, method]).observe(elapsed.as_secs_f64());
    }

    /// The text that Prometheus scrapes.
    pub(crate) fn text(&self) -> Result<String, prometheus::Error> {
        TextEncoder::new().encode_to_string(&self.registry.gather())
    }
}

fn whole(count: u64) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

#[expect(clippy::cast_precision_loss, reason = "a size in a chart")]
fn float(bytes: u64) -> f64 {
    bytes as f64
}

#[expect(clippy::cast_precision_loss, reason = "microseconds of this century fit")]
fn seconds(at: Timestamp) -> f64 {
    at.micros() as f64 / 1e6
}

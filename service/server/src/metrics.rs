//! Metrics as Prometheus scrapes them: base units, ratios, and labels that are constants, matched routes or
//! registered machines; never a cycle, a tool or anything a client typed.
//!
//! A new metric is a field of [`Metrics`] and a line in [`Metrics::new`].

use feedwright_core::ids::MachineId;
use feedwright_core::recommend::Action;
use feedwright_core::units::Process;
use feedwright_store::AlarmKind;
use http::{Method, StatusCode};
use prometheus::{
    Gauge, GaugeVec, Histogram, HistogramOpts, HistogramVec, IntCounter, IntCounterVec, IntGauge,
    IntGaugeVec, Opts, Registry, TextEncoder,
};
use std::collections::HashSet;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Bounds of commit times: an fsync takes about a millisecond on a good disk, and seconds on a bad day.
const COMMIT_SECONDS: [f64; 12] = [0.0005, 0.001, 0.002, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 5.0];
/// Bounds of group sizes.
const GROUP_SIZES: [f64; 10] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, 512.0];
/// Bounds of cycle energies: from a small drill to a long rough cut.
const ENERGIES: [f64; 12] = [10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4, 3e4, 1e5, 3e5, 1e6, 1e7];
/// Bounds of answer times.
const ANSWER_SECONDS: [f64; 12] = [0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 5.0];

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
    cycles: IntCounterVec,
    cycles_rejected: IntCounterVec,
    cycle_energy: HistogramVec,
    tool_wear_level: GaugeVec,
    machines: Mutex<HashSet<MachineId>>,
    most_machines: usize,
    recommendations: IntCounterVec,
    http_requests: IntCounterVec,
    http_seconds: HistogramVec,
    alarms_open: IntGaugeVec,
    connections: IntGauge,
    streams_open: IntGauge,
    stream_samples: IntCounter,
    stream_refusals: IntCounterVec,
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
        let registry = Registry::new();
        let counters = |name: &str, help: &str, labels: &[&str]| {
            let counters = IntCounterVec::new(Opts::new(name, help), labels)?;
            registry.register(Box::new(counters.clone()))?;
            Ok::<_, prometheus::Error>(counters)
        };
        let histograms = |name: &str, help: &str, labels: &[&str], bounds: &[f64]| {
            let histograms =
                HistogramVec::new(HistogramOpts::new(name, help).buckets(bounds.to_vec()), labels)?;
            registry.register(Box::new(histograms.clone()))?;
            Ok::<_, prometheus::Error>(histograms)
        };
        let histogram = |name: &str, help: &str, bounds: &[f64]| {
            let histogram = Histogram::with_opts(HistogramOpts::new(name, help).buckets(bounds.to_vec()))?;
            registry.register(Box::new(histogram.clone()))?;
            Ok::<_, prometheus::Error>(histogram)
        };
        let gauge = |name: &str, help: &str| {
            let gauge = IntGauge::new(name, help)?;
            registry.register(Box::new(gauge.clone()))?;
            Ok::<_, prometheus::Error>(gauge)
        };
        let build = Gauge::with_opts(
            Opts::new("feedwright_build_info", "1, labelled with the version of the build")
                .const_label("version", env!("CARGO_PKG_VERSION")),
        )?;
        build.set(1.0);
        registry.register(Box::new(build))?;
        let tool_wear_level = GaugeVec::new(
            Opts::new(
                "feedwright_tool_wear_level_ratio",
                "Energy of the tool that ran last on the machine over its energy when new; worn at 1.10",
            ),
            &["machine"],
        )?;
        registry.register(Box::new(tool_wear_level.clone()))?;
        let alarms_open = IntGaugeVec::new(Opts::new("feedwright_alarms_open", "Open alarms"), &["kind"])?;
        registry.register(Box::new(alarms_open.clone()))?;
        let metrics = Self {
            cycles: counters("feedwright_cycles_total", "Cycles taken in, by outcome", &["outcome"])?,
            cycles_rejected: counters(
                "feedwright_cycles_rejected_total",
                "Cycles that were refused and not kept, by problem code",
                &["reason"],
            )?,
            cycle_energy: histograms(
                "feedwright_cycle_energy_joules",
                "Energy of accepted cycles",
                &["process"],
                &ENERGIES,
            )?,
            tool_wear_level,
            machines: Mutex::default(),
            most_machines,
            recommendations: counters(
                "feedwright_recommendations_total",
                "Recommendations handed out, by action",
                &["action"],
            )?,
            http_requests: counters(
                "feedwright_http_requests_total",
                "Answered requests",
                &["route", "method", "status"],
            )?,
            http_seconds: histograms(
                "feedwright_http_request_duration_seconds",
                "Time from the request's head to the answer's head",
                &["route", "method"],
                &ANSWER_SECONDS,
            )?,
            alarms_open,
            connections: gauge("feedwright_http_connections", "Open connections")?,
            streams_open: gauge("feedwright_streams_open", "Open streams of machines")?,
            stream_samples: {
                let counter =
                    IntCounter::new("feedwright_stream_samples_total", "Samples answered over streams")?;
                registry.register(Box::new(counter.clone()))?;
                counter
            },
            stream_refusals: counters(
                "feedwright_stream_refusals_total",
                "Messages of streams that were refused or could not be read, by code",
                &["code"],
            )?,
            ingest_queue_depth: gauge("feedwright_ingest_queue_depth", "Cycles that wait for the writer")?,
            ingest_queue_capacity: gauge(
                "feedwright_ingest_queue_capacity",
                "Most cycles that may wait for the writer",
            )?,
            commit_seconds: histogram(
                "feedwright_commit_seconds",
                "Time of a durable commit",
                &COMMIT_SECONDS,
            )?,
            commit_group_size: histogram(
                "feedwright_commit_group_size",
                "Cycles in one commit",
                &GROUP_SIZES,
            )?,
            registry,
        };
        // A series that exists from the start can be alerted on; one that appears with the first event cannot.
        for outcome in CycleOutcome::ALL {
            metrics.cycles.with_label_values(&[outcome.as_str()]);
        }
        for kind in AlarmKind::ALL {
            metrics.alarms_open.with_label_values(&[kind.as_str()]);
        }
        Ok(metrics)
    }

    /// Counts a cycle.
    pub fn cycle(&self, outcome: CycleOutcome) {
        self.cycles.with_label_values(&[outcome.as_str()]).inc();
    }

    /// Counts a cycle that was refused and not kept; `code` is the problem's.
    pub fn cycle_rejected(&self, code: &'static str) {
        self.cycles_rejected.with_label_values(&[code]).inc();
    }

    /// Takes the energy of an accepted cycle.
    pub fn cycle_energy(&self, process: Option<Process>, joules: f64) {
        let process = process.map_or("unknown", Process::as_str);
        self.cycle_energy.with_label_values(&[process]).observe(joules);
    }

    /// Sets the level of the tool that ran last on a registered machine.
    pub fn tool_wear_level(&self, machine: &MachineId, ratio: f64) {
        let mut known = self.machines.lock().unwrap_or_else(PoisonError::into_inner);
        if known.contains(machine) || known.len() < self.most_machines {
            known.insert(machine.clone());
            self.tool_wear_level.with_label_values(&[machine.as_str()]).set(ratio);
        }
    }

    /// Counts a recommendation that was handed out.
    pub fn recommendation(&self, action: Action) {
        self.recommendations.with_label_values(&[action.as_str()]).inc();
    }

    /// Sets how many alarms of a kind are open.
    pub fn alarms_open(&self, kind: AlarmKind, open: i64) {
        self.alarms_open.with_label_values(&[kind.as_str()]).set(open);
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

    /// Open connections.
    pub(crate) const fn connections(&self) -> &IntGauge {
        &self.connections
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

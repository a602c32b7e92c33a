//! Makes metrics and registers them in one go.

use prometheus::core::Collector;
use prometheus::{
    Gauge, GaugeVec, Histogram, HistogramOpts, HistogramVec, IntCounter, IntCounterVec, IntGauge,
    IntGaugeVec, Opts, Registry,
};

/// A registry that is being filled.
#[derive(Default)]
pub(super) struct Registrar(Registry);

type Made<T> = Result<T, prometheus::Error>;

impl Registrar {
    fn add<T: Collector + Clone + 'static>(&self, metric: T) -> Made<T> {
        self.0.register(Box::new(metric.clone()))?;
        Ok(metric)
    }

    pub(super) fn counter(&self, name: &str, help: &str) -> Made<IntCounter> {
        self.add(IntCounter::new(name, help)?)
    }

    pub(super) fn counters(&self, name: &str, help: &str, labels: &[&str]) -> Made<IntCounterVec> {
        self.add(IntCounterVec::new(Opts::new(name, help), labels)?)
    }

    pub(super) fn gauge(&self, name: &str, help: &str) -> Made<Gauge> {
        self.add(Gauge::new(name, help)?)
    }

    pub(super) fn gauges(&self, name: &str, help: &str, labels: &[&str]) -> Made<GaugeVec> {
        self.add(GaugeVec::new(Opts::new(name, help), labels)?)
    }

    pub(super) fn int_gauge(&self, name: &str, help: &str) -> Made<IntGauge> {
        self.add(IntGauge::new(name, help)?)
    }

    pub(super) fn int_gauges(&self, name: &str, help: &str, labels: &[&str]) -> Made<IntGaugeVec> {
        self.add(IntGaugeVec::new(Opts::new(name, help), labels)?)
    }

    pub(super) fn histogram(&self, name: &str, help: &str, bounds: &[f64]) -> Made<Histogram> {
        self.add(Histogram::with_opts(HistogramOpts::new(name, help).buckets(bounds.to_vec()))?)
    }

    pub(super) fn histograms(
        &self,
        name: &str,
        help: &str,
        labels: &[&str],
        bounds: &[f64],
    ) -> Made<HistogramVec> {
        self.add(HistogramVec::new(HistogramOpts::new(name, help).buckets(bounds.to_vec()), labels)?)
    }

    /// A gauge that is 1 and says something by its labels.
    pub(super) fn constant(&self, name: &str, help: &str, labels: &[(&str, &str)]) -> Made<()> {
        let opts = labels
            .iter()
            .fold(Opts::new(name, help), |opts, (label, value)| opts.const_label(*label, *value));
        self.add(Gauge::with_opts(opts)?)?.set(1.0);
        Ok(())
    }

    /// Processor time, memory, file descriptors and start of the process, under the names that everyone knows.
    pub(super) fn process(&self) -> Made<()> {
        self.0.register(Box::new(prometheus::process_collector::ProcessCollector::for_self()))
    }

    pub(super) fn into_registry(self) -> Registry {
        self.0
    }
}

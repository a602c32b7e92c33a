//! Log lines and traces: where `tracing`'s events and spans go.
//!
//! Lines always go to standard error. Spans go to an OpenTelemetry collector where one is configured: a request is a
//! span with its route, its status and its request id, in the trace that its `traceparent` names; the commits beneath
//! have spans of their own. The log line of a request then carries the trace's id.

use crate::config::{LogConfig, LogFormat, TracesConfig};
use crate::http::once::{Repeated, once};
use crate::tls;
use async_trait::async_trait;
use bytes::Bytes;
use http::{HeaderMap, Request, Response};
use opentelemetry::propagation::TextMapPropagator;
use opentelemetry::trace::{TraceContextExt, TracerProvider};
use opentelemetry::{Context, KeyValue};
use opentelemetry_http::{HeaderExtractor, HttpClient, HttpError};
use opentelemetry_otlp::{Protocol, SpanExporter, WithExportConfig, WithHttpConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::propagation::TraceContextPropagator;
use opentelemetry_sdk::trace::{Sampler, SdkTracerProvider};
use secrecy::ExposeSecret;
use std::collections::HashMap;
use std::time::Duration;
use tokio::runtime::Handle;
use tracing::{Span, field};
use tracing_opentelemetry::OpenTelemetrySpanExt;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer};

/// A collector that does not take spans within this time is given up on; they are lost, and nothing else is.
const COLLECTOR_PATIENCE: Duration = Duration::from_secs(5);

/// Lines and traces, begun; ended at the end of the process so that the last spans leave.
#[derive(Debug, Default)]
#[must_use = "the last spans leave when it is ended"]
pub struct Telemetry {
    provider: Option<SdkTracerProvider>,
}

impl Telemetry {
    /// Begins to write lines to standard error, so that standard output holds only what was asked for, and to send
    /// traces where that is configured.
    pub fn begin(log: &LogConfig, traces: Option<&TracesConfig>) -> anyhow::Result<Self> {
        let provider = traces.filter(|traces| traces.is_on()).map(provider).transpose()?;
        let lines = tracing_subscriber::fmt::layer()
            .with_writer(std::io::stderr)
            .with_ansi(std::io::IsTerminal::is_terminal(&std::io::stderr()));
        let lines = match log.format {
            LogFormat::Text => lines.boxed(),
            LogFormat::Json => lines.json().flatten_event(true).boxed(),
        };
        let spans = provider.as_ref().map(|provider| {
            tracing_opentelemetry::layer().with_tracer(provider.tracer("feedwright")).with_location(false)
        });
        tracing_subscriber::registry()
            .with(lines)
            .with(spans)
            .with(EnvFilter::try_new(&log.level)?)
            .try_init()
            .map_err(|error| anyhow::anyhow!("cannot begin to log: {error}"))?;
        Ok(Self { provider })
    }

    /// Sends what is left.
    pub async fn end(self) {
        let Some(provider) = self.provider else { return };
        // It waits for its own thread, which needs this runtime to send.
        let ended =
            tokio::task::spawn_blocking(move || provider.shutdown_with_timeout(COLLECTOR_PATIENCE)).await;
        match ended {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!(%error, "the last traces were not sent"),
            Err(error) => tracing::warn!(%error, "the last traces were not sent"),
        }
    }
}

fn provider(traces: &TracesConfig) -> anyhow::Result<SdkTracerProvider> {
    let client = tls::client(&traces.endpoint).timeout(COLLECTOR_PATIENCE).build()?;
    let headers: HashMap<String, String> = traces
        .headers
        .expose_secret()
        .split(',')
        .filter_map(|header| header.split_once('='))
        .map(|(name, value)| (name.trim().to_owned(), value.trim().to_owned()))
        .collect();
    let exporter = SpanExporter::builder()
        .with_http()
        .with_http_client(Sender { client, runtime: Handle::current() })
        .with_protocol(Protocol::HttpBinary)
        .with_endpoint(format!("{}/v1/traces", traces.endpoint.trim_end_matches('/')))
        .with_headers(headers)
        .with_timeout(COLLECTOR_PATIENCE)
        .build()?;
    let resource = Resource::builder()
        .with_service_name("feedwright")
        .with_attribute(KeyValue::new("service.version", env!("CARGO_PKG_VERSION")))
        .build();
    let share = Sampler::TraceIdRatioBased(f64::from(traces.sample_percent) / 100.0);
    Ok(SdkTracerProvider::builder()
        .with_batch_exporter(exporter)
        .with_sampler(Sampler::ParentBased(Box::new(share)))
        .with_resource(resource)
        .build())
}

/// Sends with the client that the rest of the crate uses, on the process's runtime: the exporter has a thread of its own.
#[derive(Debug)]
struct Sender {
    client: reqwest::Client,
    runtime: Handle,
}

#[async_trait]
impl HttpClient for Sender {
    async fn send_bytes(&self, request: Request<Bytes>) -> Result<Response<Bytes>, HttpError> {
        let request = reqwest::Request::try_from(request)?;
        let client = self.client.clone();
        let sent = self.runtime.spawn(async move {
            let mut answer = client.execute(request).await?;
            let mut response = Response::new(());
            *response.status_mut() = answer.status();
            *response.headers_mut() = std::mem::take(answer.headers_mut());
            // What a collector answers beside its status is of no use.
            Ok::<_, reqwest::Error>(response.map(|()| Bytes::new()))
        });
        Ok(sent.await??)
    }
}

/// Makes the span of a request a server's span of the trace that its headers name. The log line learns the trace's id.
pub(crate) fn adopt(span: &Span, method: &str, route: &str, headers: &HeaderMap) {
    // Of several parents none is taken (W3C Trace Context, section 3.2): a trace of its own.
    let remote = match once(headers, "traceparent") {
        Ok(_) => {
            TraceContextPropagator::new().extract_with_context(&Context::new(), &HeaderExtractor(headers))
        }
        Err(Repeated) => Context::new(),
    };
    if remote.span().span_context().is_valid() {
        // Fails where no traces are sent; then there is nothing to adopt.
        let _ = span.set_parent(remote);
    }
    span.record("otel.name", format!("{method} {route}"));
    span.record("otel.kind", "server");
    let context = span.context();
    let trace = context.span().span_context().trace_id();
    span.record("trace_id", field::display(trace));
}

//! The service under test: a store in a directory of its own, a clock that stands still, a token of every role.

use crate::described::{Content, holds};
use axum::Router;
use axum::body::Body;
use feedwright_core::ids::MachineId;
use feedwright_core::units::Timestamp;
use feedwright_server::auth::Issued;
use feedwright_server::clock::Clock;
use feedwright_server::config::{Config, Sources};
use feedwright_server::database::{self, Database};
use feedwright_server::http::router;
use feedwright_server::ingest::intake::CycleIntake;
use feedwright_server::lifecycle::Lifecycle;
use feedwright_server::metrics::Metrics;
use feedwright_server::state::AppState;
use feedwright_store::{Actor, Role};
use http::{HeaderMap, Method, Request, StatusCode};
use secrecy::ExposeSecret;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::io::Read;
use std::sync::Arc;
use tempfile::TempDir;
use tower::ServiceExt;

/// 2026-05-04T06:00:00Z.
pub(super) const NOW: Timestamp = Timestamp::from_micros(1_777_874_400_000_000);

pub(super) struct App {
    pub(super) state: AppState,
    pub(super) router: Router,
    tokens: HashMap<Role, String>,
    _database: Database,
    _dir: TempDir,
}

/// An answer, read completely.
#[derive(Debug)]
pub(super) struct Answer {
    pub(super) status: StatusCode,
    pub(super) headers: HeaderMap,
    pub(super) body: Vec<u8>,
}

impl Answer {
    #[track_caller]
    pub(super) fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap()
    }

    /// The problem's code, after checking that it is a problem document that says its status and request.
    #[track_caller]
    pub(super) fn code(&self) -> String {
        assert_eq!(self.headers["content-type"], "application/problem+json", "{self:?}");
        let document = self.json();
        assert_eq!(document["status"], self.status.as_u16());
        let code = document["code"].as_str().unwrap().to_owned();
        assert_eq!(document["type"], format!("urn:feedwright:problem:{code}"));
        assert_eq!(document["request_id"].as_str().unwrap(), self.headers["x-request-id"].to_str().unwrap());
        assert!(!document["title"].as_str().unwrap().is_empty());
        assert!(!document["detail"].as_str().unwrap().is_empty());
        code
    }

    /// `(path, code)` of each violation.
    #[track_caller]
    pub(super) fn errors(&self) -> Vec<(String, String)> {
        let text = |error: &Value, name: &str| error[name].as_str().unwrap().to_owned();
        let document = self.json();
        let errors = document["errors"].as_array().expect("a list of errors");
        errors.iter().map(|error| (text(error, "path"), text(error, "code"))).collect()
    }

    pub(super) fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().unwrap())
    }
}

/// Settings of a service under test on top of the defaults.
pub(super) fn config(dir: &TempDir, settings: &[(&str, &str)]) -> Config {
    let path = dir.path().join("data").to_string_lossy().into_owned();
    let mut flags =
        vec![("data_dir".to_owned(), path), ("server.listen".to_owned(), "127.0.0.1:0".to_owned())];
    flags.extend(settings.iter().map(|&(name, value)| (name.to_owned(), value.to_owned())));
    Config::load(&Sources { flags, ..Sources::default() }).unwrap()
}

impl App {
    pub(super) async fn new() -> Self {
        Self::with(&[]).await
    }

    pub(super) async fn with(settings: &[(&str, &str)]) -> Self {
        Self::by(Clock::fixed(NOW), settings).await
    }

    /// The same by another clock.
    pub(super) async fn by(clock: Clock, settings: &[(&str, &str)]) -> Self {
        let dir = TempDir::new().unwrap();
        let address = crate::engines::next_database().await;
        let mut settings = settings.to_vec();
        settings.extend(address.as_deref().map(|address| ("database.url", address)));
        let config = config(&dir, &settings);
        let database = database::open(&config).await.unwrap();
        let metrics = Arc::new(Metrics::new(config.limits.metric_machines).unwrap());
        let store = database.store.clone();
        let lifecycle = Lifecycle::default();
        let intake = CycleIntake::start(&config, &store, &clock, &lifecycle, &metrics);
        let state = AppState::new(config, store, clock, metrics, Arc::new(intake), lifecycle);
        let mut app = Self {
            router: router(state.clone()),
            state,
            tokens: HashMap::new(),
            _database: database,
            _dir: dir,
        };
        for role in Role::ALL {
            let machine = (role == Role::Machine).then(|| MachineId::try_from("M1").unwrap());
            let token = app.issue(role, machine).await;
            app.tokens.insert(role, token);
        }
        app
    }

    /// Makes a token, past the API.
    pub(super) async fn issue(&self, role: Role, machine: Option<MachineId>) -> String {
        let issued = Issued::new(role.as_str(), role, machine, &self.state.clock).unwrap();
        let actor = Actor { token: "test".to_owned(), role: Role::Admin };
        self.state.store.create_token(issued.record, &actor).await.unwrap();
        issued.text.expose_secret().to_owned()
    }

    pub(super) fn token(&self, role: Role) -> &str {
        &self.tokens[&role]
    }

    pub(super) async fn send(&self, request: Request<Body>) -> Answer {
        let (method, path) = (request.method().clone(), request.uri().path().to_owned());
        let response = self.router.clone().oneshot(request).await.unwrap();
        let (parts, body) = response.into_parts();
        // A live view never ends: its story is told over a real socket.
        if parts.headers.get("content-type").is_some_and(|kind| kind == "text/event-stream") {
            return Answer { status: parts.status, headers: parts.headers, body: Vec::new() };
        }
        let body = axum::body::to_bytes(body, usize::MAX).await.unwrap().to_vec();
        let kind = parts.headers.get("content-type").map_or("", |kind| kind.to_str().unwrap());
        let mut bytes = Vec::new();
        match parts.headers.get("content-encoding") {
            Some(_) => drop(flate2::read::GzDecoder::new(&*body).read_to_end(&mut bytes).unwrap()),
            None => bytes.clone_from(&body),
        }
        holds(method.as_str(), &path, None, parts.status.as_u16(), &Content { kind, bytes: &bytes });
        Answer { status: parts.status, headers: parts.headers, body }
    }

    /// Sends a request in a role, with further headers and perhaps JSON.
    pub(super) async fn call(
        &self,
        role: Role,
        method: &str,
        path: &str,
        headers: &[(&str, &str)],
        body: Option<Value>,
    ) -> Answer {
        let mut request = Request::builder()
            .method(Method::from_bytes(method.as_bytes()).unwrap())
            .uri(path)
            .header("authorization", format!("Bearer {}", self.token(role)));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let body = match body {
            Some(json) => {
                request = request.header("content-type", "application/json");
                Body::from(json.to_string())
            }
            None => Body::empty(),
        };
        self.send(request.body(body).unwrap()).await
    }

    pub(super) async fn get(&self, path: &str) -> Answer {
        self.call(Role::Viewer, "GET", path, &[], None).await
    }

    pub(super) async fn put(&self, path: &str, body: Value) -> Answer {
        self.call(Role::Engineer, "PUT", path, &[], Some(body)).await
    }

    pub(super) async fn post(&self, path: &str, body: Value) -> Answer {
        self.call(Role::Engineer, "POST", path, &[], Some(body)).await
    }

    /// Registers machine `M1` and tool `T1`.
    pub(super) async fn registered() -> Self {
        let app = Self::new().await;
        assert_eq!(app.put("/v1/machines/M1", machine()).await.status, StatusCode::CREATED);
        assert_eq!(app.put("/v1/tools/T1", tool()).await.status, StatusCode::CREATED);
        app
    }
}

pub(super) fn machine() -> Value {
    json!({
        "name": "Friction drill 1", "control": "sinumerik-840d", "ipo_period_ms": 8.0,
        "spindle": {"reference": "rated_power", "rated_power_watts": 11000.0, "base_speed_rpm": 1500.0},
        "feed_drive": {"reference": "rated_torque", "rated_thrust_newtons": 8000.0},
        "limits": {"feed_min_mm_min": 10.0, "feed_max_mm_min": 2000.0,
                   "override_min_percent": 20.0, "override_max_percent": 150.0}
    })
}

pub(super) fn tool() -> Value {
    json!({"name": "FD M8 no. 17", "tool_type": "friction-drill-7.3", "diameter_mm": 7.3})
}

pub(super) fn operation() -> Value {
    json!({"name": "Bushing M8", "process": "friction", "programmed_feed_mm_min": 150.0})
}

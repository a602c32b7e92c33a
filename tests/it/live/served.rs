//! A server with a machine, a tool and an operation, and what is asked of it over HTTP.

use feedwright_server::clock::Clock;
use feedwright_server::config::{Config, Sources};
use feedwright_server::database::{self, Database};
use feedwright_server::server::{RunningServer, Server};
use secrecy::ExposeSecret;
use serde_json::{Value, json};
use std::path::Path;
use tempfile::TempDir;

/// A server that serves, on the system's clock where no other one is given.
pub(crate) struct Served {
    pub(crate) server: RunningServer,
    pub(crate) token: String,
    pub(crate) client: reqwest::Client,
    _database: Database,
    _dir: Option<TempDir>,
}

impl Served {
    pub(crate) async fn start(settings: &[(&str, &str)]) -> Self {
        let dir = TempDir::new().unwrap();
        let served = Self::start_in(dir.path(), None, settings).await;
        Self { _dir: Some(dir), ..served }
    }

    /// Starts on a data directory, with the admin's token that is known from an earlier start on the same database.
    pub(crate) async fn start_in(dir: &Path, token: Option<&str>, settings: &[(&str, &str)]) -> Self {
        Self::start_by(Clock::system(), dir, token, settings).await
    }

    /// The same by a clock of its own.
    pub(crate) async fn start_by(
        clock: Clock,
        dir: &Path,
        token: Option<&str>,
        settings: &[(&str, &str)],
    ) -> Self {
        let path = dir.join("data").to_string_lossy().into_owned();
        let mut flags =
            vec![("data_dir".to_owned(), path), ("server.listen".to_owned(), "127.0.0.1:0".to_owned())];
        flags.extend(settings.iter().map(|&(name, value)| (name.to_owned(), value.to_owned())));
        let config = Config::load(&Sources { flags, ..Sources::default() }).unwrap();
        let database = database::open(&config).await.unwrap();
        let server = Server::start(config, database.store.clone(), clock).await.unwrap();
        let first = server.first_admin_token.as_ref().map(|token| token.expose_secret().to_owned());
        let token = token.map(str::to_owned).or(first).unwrap();
        let client = reqwest::Client::builder().no_proxy().build().unwrap();
        Self { server, token, client, _database: database, _dir: None }
    }

    /// Shuts the server down and gives its database back, so that another can be started on it.
    pub(crate) async fn stop(self) {
        self.server.shutdown().await.unwrap();
    }

    pub(crate) fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.server.local_addr)
    }

    /// Sends JSON as the admin; status and JSON of the answer.
    pub(crate) async fn send(&self, method: &str, path: &str, body: Option<Value>) -> (u16, Value) {
        let method = reqwest::Method::from_bytes(method.as_bytes()).unwrap();
        let mut request = self.client.request(method, self.url(path)).bearer_auth(&self.token);
        if let Some(body) = body {
            request = request.json(&body);
        }
        let response = request.send().await.unwrap();
        let status = response.status().as_u16();
        (status, response.json().await.unwrap_or(Value::Null))
    }

    pub(crate) async fn get(&self, path: &str) -> Value {
        let (status, body) = self.send("GET", path, None).await;
        assert_eq!(status, 200, "{path}: {body}");
        body
    }

    pub(crate) async fn put(&self, path: &str, body: Value) {
        let (status, answer) = self.send("PUT", path, Some(body)).await;
        assert!(status == 200 || status == 201, "{path}: {answer}");
    }

    /// Machine `M1` whose ratings are declared, tool `T1`, friction operation `O1` with set loads of 30 and 40 %.
    pub(crate) async fn with_a_shop(&self) {
        self.with_a_machine("M1").await;
        self.put("/v1/tools/T1", json!({"name": "FD M8", "tool_type": "friction-drill-7.3"})).await;
        self.put(
            "/v1/operations/O1",
            json!({"name": "Bushing M8", "process": "friction", "programmed_feed_mm_min": 150.0,
                   "feed_drive_load_set_percent": 30.0, "spindle_load_set_percent": 40.0}),
        )
        .await;
    }

    /// A machine whose ratings are declared.
    pub(crate) async fn with_a_machine(&self, id: &str) {
        let body = json!({
            "name": "Friction drill", "control": "linuxcnc", "ipo_period_ms": 10.0,
            "spindle": {"reference": "rated_power", "rated_power_watts": 7000.0},
            "feed_drive": {"reference": "rated_torque", "rated_thrust_newtons": 8000.0},
            "limits": {"feed_min_mm_min": 1.0, "feed_max_mm_min": 3000.0,
                       "override_min_percent": 20.0, "override_max_percent": 150.0}
        });
        self.put(&format!("/v1/machines/{id}"), body).await;
    }

    /// A token of a machine.
    pub(crate) async fn machine_token(&self, machine: &str) -> String {
        let body = json!({"name": machine, "role": "machine", "machine": machine});
        let (status, answer) = self.send("POST", "/v1/tokens", Some(body)).await;
        assert_eq!(status, 201, "{answer}");
        answer["token"].as_str().unwrap().to_owned()
    }

    /// Posts a short cycle; the answer.
    pub(crate) async fn post_cycle(&self, id: &str, load: f64) -> Value {
        let body = json!({
            "cycle_id": id, "tool": "T1", "operation": "O1", "started_at": "2026-05-04T06:00:00Z",
            "samples": {"period_ms": 10.0, "depth_mm": [0.0, 0.1, 0.2], "spindle_load_percent": [load, 20.0, 21.5],
                        "feed_drive_load_percent": [2.0, 9.5, 14.2]}
        });
        let (status, answer) = self.send("POST", "/v1/machines/M1/cycles", Some(body)).await;
        assert_eq!(status, 201, "{answer}");
        answer
    }
}

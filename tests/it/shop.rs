//! A shop: a real server on a port of its own, with a machine, a tool and an operation, and whoever calls it.

mod answers;
mod bad_input;
mod binary;
mod lives;
mod long_fold;
mod restart;
mod weekend;

use crate::described::{Content, holds};
use feedwright_core::units::Timestamp;
use feedwright_server::clock::Clock;
use feedwright_server::config::Config;
use feedwright_server::server::{RunningServer, Server};
use feedwright_store::{PostgresOptions, PostgresStore, SqliteOptions, SqliteStore, Store};
use secrecy::ExposeSecret;
use serde_json::{Value, json};
use sqlx::{ConnectOptions, Connection};
use std::path::PathBuf;
use std::sync::Arc;

/// 2026-05-04T06:00:00Z, when the shift begins.
pub(crate) const MORNING_US: i64 = 1_777_874_400_000_000;

/// A running server with what a shop registers first.
pub(crate) struct Shop {
    server: Option<RunningServer>,
    dir: Option<tempfile::TempDir>,
    /// Address of its database, where that is PostgreSQL's.
    database: Option<String>,
    pub(crate) client: reqwest::Client,
    pub(crate) address: String,
    pub(crate) admin: String,
}

pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) body: Value,
    pub(crate) text: String,
    pub(crate) headers: reqwest::header::HeaderMap,
}

impl Shop {
    /// Opens a shop at half past six, on SQLite unless its story is told on PostgreSQL.
    pub(crate) async fn open() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let database = crate::engines::next_database().await;
        let mut shop = Self::start(dir, database, "").await;
        shop.register().await;
        shop
    }

    async fn start(dir: tempfile::TempDir, database: Option<String>, admin: &str) -> Self {
        let (server, address) = serve(dir.path().to_owned(), database.as_deref()).await;
        let made = server.first_admin_token.as_ref().map(|token| token.expose_secret().to_owned());
        Self {
            server: Some(server),
            dir: Some(dir),
            database,
            client: reqwest::Client::new(),
            address,
            admin: made.unwrap_or_else(|| admin.to_owned()),
        }
    }

    /// Shuts the server down and starts another one on the same data.
    pub(crate) async fn restart(mut self) -> Self {
        if self.server.is_some() {
            self.stop().await;
        }
        Self::start(self.dir.take().unwrap(), self.database.take(), &self.admin).await
    }

    async fn register(&mut self) {
        for (path, body) in [
            ("/v1/machines/M1", machine()),
            ("/v1/machines/M2", machine()),
            ("/v1/tools/T1", json!({"name": "FD M8 no. 1", "tool_type": "fd-7.3"})),
            ("/v1/operations/O1", operation()),
        ] {
            let answer = self.put(path, &body).await;
            assert_eq!(answer.status, 201, "{path}: {}", answer.text);
        }
    }

    pub(crate) async fn put(&self, path: &str, body: &Value) -> Answer {
        self.send(self.client.put(self.url(path)).json(body)).await
    }

    pub(crate) async fn get(&self, path: &str) -> Answer {
        self.send(self.client.get(self.url(path))).await
    }

    pub(crate) async fn post(&self, path: &str, body: &Value) -> Answer {
        self.send(self.client.post(self.url(path)).json(body)).await
    }

    /// Posts a body as it stands.
    pub(crate) async fn post_raw(&self, path: &str, kind: &str, body: impl Into<reqwest::Body>) -> Answer {
        self.send(self.client.post(self.url(path)).header("content-type", kind).body(body)).await
    }

    pub(crate) async fn cycle(&self, machine: &str, body: &Value) -> Answer {
        self.post(&format!("/v1/machines/{machine}/cycles"), body).await
    }

    /// Flags a stored cycle as one of which the server kept a part, as a stream's is that is too long.
    pub(crate) async fn cut_short(&self, cycle: &str) {
        use feedwright_core::cycle::Flag;
        let flags = Flag::CutShort as u32 | Flag::Incomplete as u32;
        let sql = format!("UPDATE cycles SET flags = flags | {flags} WHERE cycle_id = '{cycle}'");
        assert_eq!(self.tables(&sql).await, 1);
    }

    /// Damages all samples that are stored.
    pub(crate) async fn damage_samples(&self) {
        let sql = match &self.database {
            None => "UPDATE sample_packs SET blocks = zeroblob(length(blocks))",
            Some(_) => "UPDATE cycle_samples SET block = decode(repeat('00', length(block)), 'hex')",
        };
        assert!(self.tables(sql).await > 0);
    }

    /// Runs a statement on the tables themselves; says how many rows it changed.
    pub(crate) async fn tables(&self, sql: &str) -> u64 {
        let query = sqlx::AssertSqlSafe(sql.to_owned());
        match &self.database {
            None => sqlx::query(query).execute(&mut self.file().await).await.unwrap().rows_affected(),
            Some(address) => {
                let mut conn = sqlx::PgConnection::connect(address).await.unwrap();
                sqlx::query(query).execute(&mut conn).await.unwrap().rows_affected()
            }
        }
    }

    /// Rows of a table of which something holds.
    pub(crate) async fn count(&self, table: &str, holds: &str) -> i64 {
        let query = sqlx::AssertSqlSafe(format!("SELECT COUNT(*) FROM {table} WHERE {holds}"));
        match &self.database {
            None => sqlx::query_scalar(query).fetch_one(&mut self.file().await).await.unwrap(),
            Some(address) => {
                let mut conn = sqlx::PgConnection::connect(address).await.unwrap();
                sqlx::query_scalar(query).fetch_one(&mut conn).await.unwrap()
            }
        }
    }

    async fn file(&self) -> sqlx::SqliteConnection {
        let file = self.dir.as_ref().unwrap().path().join("feedwright.sqlite3");
        sqlx::sqlite::SqliteConnectOptions::new().filename(file).connect().await.unwrap()
    }

    /// Shuts the server down.
    async fn stop(&mut self) {
        self.server.take().unwrap().shutdown().await.unwrap();
    }

    pub(crate) fn url(&self, path: &str) -> String {
        format!("{}{path}", self.address)
    }

    pub(crate) async fn send(&self, request: reqwest::RequestBuilder) -> Answer {
        self.send_as(request, &self.admin).await
    }

    pub(crate) async fn send_as(&self, request: reqwest::RequestBuilder, token: &str) -> Answer {
        let request = request.bearer_auth(token).build().unwrap();
        let (method, path) = (request.method().clone(), request.url().path().to_owned());
        let kind = |headers: &reqwest::header::HeaderMap| {
            headers.get("content-type").map_or(String::new(), |kind| kind.to_str().unwrap().to_owned())
        };
        let sent_kind = kind(request.headers());
        // What is packed is held where the same is sent as it is.
        let packed = request.headers().contains_key("content-encoding");
        let sent = request.body().and_then(|body| body.as_bytes()).filter(|_| !packed).map(<[u8]>::to_vec);
        let response = self.client.execute(request).await.unwrap();
        let (status, headers) = (response.status().as_u16(), response.headers().clone());
        let text = response.text().await.unwrap();
        let sent = sent.as_deref().map(|bytes| Content { kind: &sent_kind, bytes });
        holds(
            method.as_str(),
            &path,
            sent,
            status,
            &Content { kind: &kind(&headers), bytes: text.as_bytes() },
        );
        Answer { status, body: serde_json::from_str(&text).unwrap_or(Value::Null), text, headers }
    }

    /// A token of that role.
    pub(crate) async fn token(&self, role: &str, machine: Option<&str>) -> String {
        let mut body = json!({"name": format!("{role} of the test"), "role": role});
        if let Some(machine) = machine {
            body["machine"] = machine.into();
        }
        let answer = self.post("/v1/tokens", &body).await;
        assert_eq!(answer.status, 201, "{}", answer.text);
        answer.body["token"].as_str().unwrap().to_owned()
    }
}

async fn serve(dir: PathBuf, database: Option<&str>) -> (RunningServer, String) {
    let config = Config::for_tests(&dir).unwrap();
    let store: Arc<dyn Store> = match database {
        None => {
            let path = dir.join("feedwright.sqlite3");
            Arc::new(SqliteStore::open(path, SqliteOptions::default()).await.unwrap())
        }
        Some(address) => Arc::new(PostgresStore::open(address, PostgresOptions::default()).await.unwrap()),
    };
    let clock = Clock::fixed(Timestamp::from_micros(MORNING_US + 1_800_000_000));
    let server = Server::start(config, store, clock).await.unwrap();
    let address = format!("http://{}", server.local_addr);
    (server, address)
}

pub(crate) fn machine() -> Value {
    json!({
        "name": "Mill 1", "control": "sinumerik-840d", "ipo_period_ms": 10,
        "spindle": {"reference": "rated_power", "rated_power_watts": 7000},
        "feed_drive": {"reference": "unknown"},
        "limits": {"feed_min_mm_min": 1, "feed_max_mm_min": 5000,
                   "override_min_percent": 5, "override_max_percent": 200},
    })
}

pub(crate) fn operation() -> Value {
    json!({
        "name": "Bush M8", "process": "friction", "program": "O0815", "spindle_speed_rpm": 2500,
        "programmed_feed_mm_min": 140, "spindle_load_set_percent": 40, "feed_drive_load_set_percent": 30,
    })
}

/// The cycle of that number with that energy, ten seconds after the one before.
pub(crate) fn reported(number: i64, joules: f64) -> Value {
    json!({
        "cycle_id": format!("c{number}"), "tool": "T1", "operation": "O1", "started_at": at(number),
        "reported": {"energy_joules": joules, "duration_ms": 4280},
    })
}

/// When the cycle of that number begins.
pub(crate) fn at(number: i64) -> String {
    let seconds = number * 10;
    format!("2026-05-04T06:{:02}:{:02}Z", seconds / 60, seconds % 60)
}

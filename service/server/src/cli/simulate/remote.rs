//! The server as a machine sees it.

use anyhow::{Context, bail};
use reqwest::{Method, StatusCode};
use secrecy::{ExposeSecret, SecretString};
use serde_json::Value;
use std::time::Duration;

/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(30);
/// Times that a post is tried while the server asks to come again.
const MOST_TRIES: u32 = 20;
/// Longest wait between tries.
const LONGEST_PAUSE_S: u64 = 5;

/// A server and the token to talk to it with.
pub(super) struct Remote {
    client: reqwest::Client,
    url: String,
    token: SecretString,
}

/// A status with its text.
pub(super) struct Answer {
    pub(super) status: StatusCode,
    pub(super) text: String,
}

impl Answer {
    /// The body, where it is JSON.
    pub(super) fn json(&self) -> Value {
        serde_json::from_str(&self.text).unwrap_or(Value::Null)
    }
}

impl Remote {
    pub(super) fn new(url: &str, token: SecretString) -> anyhow::Result<Self> {
        let client = reqwest::Client::builder().timeout(PATIENCE).no_proxy().build()?;
        Ok(Self { client, url: url.trim_end_matches('/').to_owned(), token })
    }

    /// Sends a body, and again while the server has no room.
    pub(super) async fn send(
        &self,
        method: Method,
        path: &str,
        kind: &str,
        body: String,
    ) -> anyhow::Result<Answer> {
        for _ in 0..MOST_TRIES {
            let request = self.client.request(method.clone(), format!("{}{path}", self.url));
            let request = request.bearer_auth(self.token.expose_secret()).header("content-type", kind);
            let response =
                request.body(body.clone()).send().await.with_context(|| format!("cannot reach {path}"))?;
            let status = response.status();
            if status != StatusCode::SERVICE_UNAVAILABLE {
                return Ok(Answer { status, text: response.text().await? });
            }
            let wait =
                response.headers().get("retry-after").and_then(|text| text.to_str().ok()?.parse().ok());
            let wait: u64 = wait.unwrap_or(1);
            tokio::time::sleep(Duration::from_secs(wait.min(LONGEST_PAUSE_S))).await;
        }
        bail!("the server had no room {MOST_TRIES} times")
    }

    /// Puts or posts JSON that has to be taken.
    pub(super) async fn must(&self, method: Method, path: &str, body: &Value) -> anyhow::Result<Value> {
        let answer = self.send(method, path, "application/json", body.to_string()).await?;
        if answer.status.is_success() {
            return Ok(answer.json());
        }
        bail!("{path} answers {}: {}", answer.status, answer.text)
    }
}

//! The machine's side of HTTP: asks until it is answered, and waits as long as the service says.
//!
//! Every request that it sends may be sent again: puts and posts of cycles by their nature, events because the
//! caller looks first. Which answers are good is the caller's business.

use super::ReplayError;
use reqwest::header::{AUTHORIZATION, CONTENT_TYPE, RETRY_AFTER};
use reqwest::{Method, Response, StatusCode};
use secrecy::{ExposeSecret, SecretString};
use serde_json::Value;
use std::pin::pin;
use std::time::{Duration, Instant};

/// First wait before a request is repeated; doubled each time.
const FIRST_WAIT: Duration = Duration::from_millis(200);
/// Longest wait that is chosen without being told.
const LONGEST_WAIT: Duration = Duration::from_secs(15);
/// Longest wait that is accepted when told: a longer one is asked about again.
const LONGEST_TOLD_WAIT: Duration = Duration::from_secs(120);
/// Who waits is told why when so long was waited, and again each time that so much more was.
const TOLD_AFTER: Duration = Duration::from_secs(2);
const TOLD_EVERY: Duration = Duration::from_secs(30);
/// A place that takes no connection for so long is one that does not answer.
const CONNECT_TIME: Duration = Duration::from_secs(10);
/// One request may take so long: a batch of a weekend is committed within it.
const REQUEST_TIME: Duration = Duration::from_secs(60);

/// A client of one service with one token.
#[derive(Debug, Clone)]
pub struct Client {
    http: reqwest::Client,
    base: String,
    token: Option<SecretString>,
    patience: Duration,
    /// Takes a line on what is waited for.
    told: fn(&str),
    /// When it is told first.
    told_after: Duration,
}

/// Why a request was not answered.
struct Unanswered {
    detail: String,
    /// Whether it may be answered later.
    may_pass: bool,
}

/// What the service answered.
#[derive(Debug)]
pub struct Answer {
    /// The status.
    pub status: StatusCode,
    /// The body as text.
    pub text: String,
}

impl Answer {
    /// The body as JSON; `Null` where it is none.
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.text).unwrap_or(Value::Null)
    }

    /// What a problem document says, for a person.
    pub fn problem(&self) -> String {
        describe(&self.json()).unwrap_or_else(|| self.text.chars().take(300).collect())
    }
}

/// A problem document in a line: its code or title, its detail, and the first bad field.
pub fn describe(problem: &Value) -> Option<String> {
    let text = |key: &str| problem.get(key).and_then(Value::as_str);
    let mut said = text("code").or_else(|| text("title"))?.to_owned();
    if let Some(detail) = text("detail") {
        said = format!("{said}: {detail}");
    }
    if let Some(first) = problem.get("errors").and_then(Value::as_array).and_then(|errors| errors.first()) {
        let part = |key: &str| first.get(key).and_then(Value::as_str).unwrap_or_default();
        said = format!("{said} [{} {}]", part("path"), part("message"));
    }
    Some(said)
}

impl Client {
    /// A client of the service at `base`; gives up when nothing was answered for `patience`.
    pub fn new(base: &str, token: Option<SecretString>, patience: Duration) -> Result<Self, ReplayError> {
        let base = base.trim_end_matches('/').to_owned();
        let http =
            crate::tls::client(&base).timeout(REQUEST_TIME).connect_timeout(CONNECT_TIME).build().map_err(
                |error| ReplayError::GivenUp { url: base.clone(), seconds: 0, detail: error.to_string() },
            )?;
        Ok(Self { http, base, token, patience, told: |_| (), told_after: TOLD_AFTER })
    }

    /// The same, that tells what it waits for.
    #[must_use]
    pub fn telling(self, told: fn(&str)) -> Self {
        Self { told, ..self }
    }

    /// The same client with another token.
    pub fn with_token(&self, token: SecretString) -> Self {
        Self { token: Some(token), ..self.clone() }
    }

    /// The service's address.
    pub fn base(&self) -> &str {
        &self.base
    }

    /// Gets `path`.
    pub async fn get(&self, path: &str) -> Result<Answer, ReplayError> {
        self.send(Method::GET, path, None).await
    }

    /// Deletes what is at `path`.
    pub async fn delete(&self, path: &str) -> Result<Answer, ReplayError> {
        self.send(Method::DELETE, path, None).await
    }

    /// Sends `body` as JSON.
    pub async fn json(&self, method: Method, path: &str, body: &Value) -> Result<Answer, ReplayError> {
        self.send(method, path, Some(("application/json", body.to_string()))).await
    }

    /// Posts text as JSON, whether it is any or not: a broken control sends what it likes.
    pub async fn text(&self, path: &str, body: String) -> Result<Answer, ReplayError> {
        self.send(Method::POST, path, Some(("application/json", body))).await
    }

    /// Sends lines of JSON.
    pub async fn lines(&self, path: &str, lines: String) -> Result<Answer, ReplayError> {
        self.send(Method::POST, path, Some(("application/x-ndjson", lines))).await
    }

    async fn send(
        &self,
        method: Method,
        path: &str,
        body: Option<(&str, String)>,
    ) -> Result<Answer, ReplayError> {
        let since = Instant::now();
        let (mut wait, mut telling) = (FIRST_WAIT, since + self.told_after);
        let url = format!("{}{path}", without_password(&self.base));
        let given_up = |detail| {
            Err(ReplayError::GivenUp { url: url.clone(), seconds: since.elapsed().as_secs(), detail })
        };
        let tell = |why: &str| {
            let left = self.patience.saturating_sub(since.elapsed()).as_secs();
            (self.told)(&format!("{url}: {why}; waiting for another {left} s at the most"));
            Instant::now() + TOLD_EVERY
        };
        loop {
            let mut asked = pin!(self.once(&method, path, body.as_ref()));
            let answer = loop {
                match tokio::time::timeout_at(telling.into(), &mut asked).await {
                    Ok(answer) => break answer,
                    Err(_) => telling = tell("no answer yet"),
                }
            };
            let (told, detail) = match answer {
                Ok(response) if !may_pass(response.status()) => match read(response).await {
                    Ok(answer) => return Ok(answer),
                    // The answer broke off: what was sent may be stored, and asking again tells.
                    Err(error) => (None, error),
                },
                Ok(response) => (told_wait(&response), response.status().to_string()),
                Err(Unanswered { detail, may_pass: false }) => return given_up(detail),
                Err(Unanswered { detail, .. }) => (None, detail),
            };
            let pause = told.unwrap_or(wait).min(LONGEST_TOLD_WAIT);
            if since.elapsed() + pause > self.patience {
                return given_up(detail);
            }
            if Instant::now() + pause >= telling {
                telling = tell(&detail) + pause;
            }
            tokio::time::sleep(pause).await;
            wait = (wait * 2).min(LONGEST_WAIT);
        }
    }

    async fn once(
        &self,
        method: &Method,
        path: &str,
        body: Option<&(&str, String)>,
    ) -> Result<Response, Unanswered> {
        let mut request = self.http.request(method.clone(), format!("{}{path}", self.base));
        if let Some(token) = &self.token {
            request = request.header(AUTHORIZATION, format!("Bearer {}", token.expose_secret()));
        }
        if let Some((kind, body)) = body {
            request = request.header(CONTENT_TYPE, *kind).body(body.clone());
        }
        // What is no address, or none that is asked by HTTP, will not be one later.
        request
            .send()
            .await
            .map_err(|error| Unanswered { detail: causes(&error), may_pass: !error.is_builder() })
    }
}

async fn read(response: Response) -> Result<Answer, String> {
    let status = response.status();
    response.text().await.map(|text| Answer { status, text }).map_err(|error| causes(&error))
}

/// An address as it may be shown: a password in it is nobody's who reads over a shoulder.
fn without_password(address: &str) -> String {
    if let Ok(mut url) = reqwest::Url::parse(address)
        && url.password().is_some()
        && url.set_password(None).is_ok()
    {
        return url.as_str().trim_end_matches('/').to_owned();
    }
    address.to_owned()
}

/// The error with what caused it: "error sending request" alone tells nobody that the port is closed.
fn causes(error: &dyn std::error::Error) -> String {
    let mut said = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        said = format!("{said}: {error}");
        cause = error.source();
    }
    said
}

/// Whether asking again may be answered otherwise: too many requests, or not able to at the moment.
fn may_pass(status: StatusCode) -> bool {
    matches!(status, StatusCode::TOO_MANY_REQUESTS | StatusCode::REQUEST_TIMEOUT) || status.is_server_error()
}

fn told_wait(response: &Response) -> Option<Duration> {
    let seconds: u64 = response.headers().get(RETRY_AFTER)?.to_str().ok()?.trim().parse().ok()?;
    Some(Duration::from_secs(seconds))
}

#[cfg(test)]
pub(super) mod tests;

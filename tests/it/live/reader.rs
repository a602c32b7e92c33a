//! Server-Sent Events as a reader gets them.

use super::Served;
use serde_json::Value;
use std::time::Duration;

/// Longer than anything here takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(20);

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Told {
    pub(crate) name: String,
    pub(crate) id: Option<String>,
    pub(crate) data: Value,
}

pub(crate) struct Reader {
    response: reqwest::Response,
    text: String,
    pub(crate) beats: usize,
}

impl Reader {
    pub(crate) async fn open(served: &Served, query: &str, last: Option<&str>) -> Self {
        let mut request =
            served.client.get(served.url(&format!("/v1/live{query}"))).bearer_auth(&served.token);
        if let Some(last) = last {
            request = request.header("last-event-id", last);
        }
        Self::of(request).await
    }

    /// As a request says that is ready but for being sent.
    pub(crate) async fn of(request: reqwest::RequestBuilder) -> Self {
        let response = request.send().await.unwrap();
        assert_eq!(response.status(), 200);
        assert_eq!(response.headers()["content-type"], "text/event-stream");
        Self { response, text: String::new(), beats: 0 }
    }

    /// As a page's reader comes: with its session's cookie.
    pub(crate) async fn with_cookie(served: &Served, cookie: &str) -> Self {
        let request = served.client.get(served.url("/v1/live")).header("cookie", cookie);
        let response = request.send().await.unwrap();
        assert_eq!(response.status(), 200);
        Self { response, text: String::new(), beats: 0 }
    }

    /// As a program comes: with that token.
    pub(crate) async fn with_token(served: &Served, token: &str) -> Self {
        let response = served.client.get(served.url("/v1/live")).bearer_auth(token).send().await.unwrap();
        assert_eq!(response.status(), 200);
        Self { response, text: String::new(), beats: 0 }
    }

    /// The next event; `None` where the server ended the view.
    pub(crate) async fn next(&mut self) -> Option<Told> {
        loop {
            if let Some((block, rest)) = self.text.split_once("\n\n") {
                let (block, rest) = (block.to_owned(), rest.to_owned());
                self.text = rest;
                let told = read(&block);
                if told.name == "heartbeat" {
                    self.beats += 1;
                    continue;
                }
                return Some(told);
            }
            let chunk = tokio::time::timeout(PATIENCE, self.response.chunk()).await.expect("something comes");
            match chunk {
                Ok(Some(bytes)) => self.text.push_str(std::str::from_utf8(&bytes).unwrap()),
                _ => return None,
            }
        }
    }

    /// The next event of that name, skipping others.
    pub(crate) async fn next_of(&mut self, name: &str) -> Told {
        let mut skipped = Vec::new();
        // Heartbeats must not make a wait for what never comes endless.
        let wanted = async {
            loop {
                let told = self.next().await.expect("the view goes on");
                if told.name == name {
                    return told;
                }
                skipped.push(told);
            }
        };
        match tokio::time::timeout(PATIENCE, wanted).await {
            Ok(told) => told,
            Err(_) => panic!("no {name} came, only {skipped:?}"),
        }
    }
}

fn read(block: &str) -> Told {
    let field = |name: &str| {
        block.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": ").map(str::to_owned))
    };
    Told {
        name: field("event").unwrap(),
        id: field("id"),
        data: serde_json::from_str(&field("data").unwrap()).unwrap(),
    }
}

//! Machines that post to a server of its own process, until something ends it.

use super::commands::Served;
use crate::shop;
use reqwest::{Client, Method, RequestBuilder};
use serde_json::{Value, json};

/// A client of one server.
#[derive(Clone)]
pub(super) struct Caller {
    client: Client,
    address: String,
    token: String,
}

impl Caller {
    pub(super) fn of(served: &Served, token: &str) -> Self {
        let client = Client::builder().no_proxy().build().unwrap();
        Self { client, address: format!("http://{}", served.address()), token: token.to_owned() }
    }

    fn call(&self, method: Method, path: &str) -> RequestBuilder {
        self.client.request(method, format!("{}{path}", self.address)).bearer_auth(&self.token)
    }

    async fn put(&self, path: &str, body: &Value) {
        let answer = self.call(Method::PUT, path).json(body).send().await.unwrap();
        assert_eq!(answer.status(), 201, "{path}");
    }

    /// Registers so many machines, each with a tool of its own, and an operation.
    pub(super) async fn set_up(&self, machines: usize) {
        for machine in 0..machines {
            self.put(&format!("/v1/machines/M{machine}"), &shop::machine()).await;
            self.put(&format!("/v1/tools/T{machine}"), &json!({"name": "drill", "tool_type": "fd"})).await;
        }
        self.put("/v1/operations/O1", &shop::operation()).await;
    }

    /// Posts a cycle of a machine: the status, where there was an answer.
    pub(super) async fn post(&self, machine: usize, number: i64) -> Option<u16> {
        let energy = 1000.0 + f64::from(i32::try_from(number % 7).unwrap());
        let post = self.call(Method::POST, &format!("/v1/machines/M{machine}/cycles"));
        let mut cycle = shop::reported(number, energy);
        cycle["tool"] = json!(format!("T{machine}"));
        let answer = post.json(&cycle).send().await;
        answer.ok().map(|answer| answer.status().as_u16())
    }
}

//! Machines' own tokens: only a machine may write cycles, and only its own.

use super::client::Client;
use super::run::expect_success;
use super::{Plan, ReplayError};
use feedwright_core::ids::MachineId;
use reqwest::Method;
use secrecy::SecretString;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};

/// Where the machines' tokens come from.
#[derive(Debug)]
pub enum MachineTokens {
    /// This one, for a recording of one machine.
    Given(SecretString),
    /// An admin has one made for each machine, and revoked at the end.
    Make,
}

/// A client for each machine of a recording.
#[derive(Debug)]
pub(super) struct Fleet {
    clients: BTreeMap<MachineId, Client>,
    anyone: Client,
    made: Vec<String>,
}

impl Fleet {
    pub(super) async fn gather(
        plan: &Plan,
        office: &Client,
        tokens: MachineTokens,
    ) -> Result<Self, ReplayError> {
        let mut fleet = match tokens {
            MachineTokens::Given(token) => {
                let anyone = office.with_token(token);
                return Ok(Self { clients: BTreeMap::new(), anyone, made: Vec::new() });
            }
            MachineTokens::Make => {
                let anyone = office.clone();
                Self { clients: BTreeMap::new(), anyone, made: Vec::new() }
            }
        };
        dismiss_left_over(plan, office).await?;
        let machines: BTreeSet<&MachineId> = plan.cycles.iter().map(|cycle| &cycle.machine).collect();
        for machine in machines {
            if let Err(error) = fleet.enlist(plan, office, machine).await {
                fleet.dismiss(office).await?;
                return Err(error);
            }
        }
        Ok(fleet)
    }

    async fn enlist(&mut self, plan: &Plan, office: &Client, machine: &MachineId) -> Result<(), ReplayError> {
        let path = "/v1/tokens";
        let body = json!({
            "name": name_of(plan),
            "role": "machine",
            "machine": machine.as_str(),
        });
        let answer = office.json(Method::POST, path, &body).await?;
        expect_success("POST", path, &answer)?;
        let issued = answer.json();
        let text = |key: &str| {
            issued[key]
                .as_str()
                .map(str::to_owned)
                .ok_or_else(|| ReplayError::Answer { path: path.to_owned(), detail: format!("has no {key}") })
        };
        self.made.push(text("id")?);
        self.clients.insert(machine.clone(), office.with_token(SecretString::from(text("token")?)));
        Ok(())
    }

    /// Revokes what was made.
    pub(super) async fn dismiss(&self, office: &Client) -> Result<(), ReplayError> {
        for id in &self.made {
            revoke(office, id).await?;
        }
        Ok(())
    }

    pub(super) fn client(&self, machine: &MachineId) -> &Client {
        self.clients.get(machine).unwrap_or(&self.anyone)
    }
}

/// What the tokens of a replay are called.
fn name_of(plan: &Plan) -> String {
    format!("replay of {}", plan.name)
}

async fn revoke(office: &Client, id: &str) -> Result<(), ReplayError> {
    let path = format!("/v1/tokens/{id}");
    expect_success("DELETE", &path, &office.delete(&path).await?)
}

/// Revokes the tokens of a replay that was killed: their secrets died with it.
async fn dismiss_left_over(plan: &Plan, office: &Client) -> Result<(), ReplayError> {
    let name = name_of(plan);
    let mut path = "/v1/tokens?limit=500".to_owned();
    loop {
        let page = office.get(&path).await?;
        expect_success("GET", &path, &page)?;
        let page = page.json();
        for token in page["items"].as_array().into_iter().flatten() {
            let valid = token["revoked_at"].is_null() && token["role"] == "machine";
            if let Some(id) = token["id"].as_str().filter(|_| valid && token["name"] == name.as_str()) {
                revoke(office, id).await?;
            }
        }
        match page["next_cursor"].as_str() {
            Some(cursor) => path = format!("/v1/tokens?limit=500&cursor={cursor}"),
            None => return Ok(()),
        }
    }
}

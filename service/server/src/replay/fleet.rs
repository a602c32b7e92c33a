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
            "name": format!("replay of {}", plan.name),
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
            let path = format!("/v1/tokens/{id}");
            expect_success("DELETE", &path, &office.delete(&path).await?)?;
        }
        Ok(())
    }

    pub(super) fn client(&self, machine: &MachineId) -> &Client {
        self.clients.get(machine).unwrap_or(&self.anyone)
    }
}

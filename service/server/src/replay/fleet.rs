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
    /// Tokens of other runs of this recording that were there when this one last had its own made.
    others: BTreeSet<String>,
}

impl Fleet {
    /// Has a token made for each machine, where none is given; those that a run before left behind are revoked.
    ///
    /// Nobody can tell whether that run was killed or goes on somewhere else. So own tokens are made first: a run that finds
    /// its own revoked sees by them that another has begun, and has others made ([`Self::replace`]).
    pub(super) async fn gather(
        plan: &Plan,
        office: &Client,
        tokens: MachineTokens,
    ) -> Result<Self, ReplayError> {
        let mut fleet = Self {
            clients: BTreeMap::new(),
            anyone: office.clone(),
            made: Vec::new(),
            others: BTreeSet::new(),
        };
        if let MachineTokens::Given(token) = tokens {
            fleet.anyone = office.with_token(token);
            return Ok(fleet);
        }
        let there = namesakes(plan, office).await?;
        fleet.others = there.iter().map(|token| token.id.clone()).collect();
        if let Err(error) = fleet.take_over(plan, office, &there).await {
            fleet.dismiss(office).await?;
            return Err(error);
        }
        Ok(fleet)
    }

    async fn take_over(
        &mut self,
        plan: &Plan,
        office: &Client,
        there: &[Namesake],
    ) -> Result<(), ReplayError> {
        let machines: BTreeSet<&MachineId> = plan.cycles.iter().map(|cycle| &cycle.machine).collect();
        for machine in machines {
            self.enlist(plan, office, machine).await?;
        }
        for token in there.iter().filter(|token| token.is_valid) {
            revoke(office, &token.id).await?;
        }
        Ok(())
    }

    /// Has another token made for a machine whose own is refused, where another run of the recording has begun since: that
    /// one took it for left behind. Otherwise somebody revoked it, and that stands: it says that there is none.
    pub(super) async fn replace(
        &mut self,
        plan: &Plan,
        office: &Client,
        machine: &MachineId,
    ) -> Result<bool, ReplayError> {
        if !self.clients.contains_key(machine) {
            return Ok(false);
        }
        let there = namesakes(plan, office).await?;
        let is_new = |token: &Namesake| {
            token.machine == machine.as_str()
                && !self.made.contains(&token.id)
                && !self.others.contains(&token.id)
        };
        if !there.iter().any(is_new) {
            return Ok(false);
        }
        // Of this machine only: those of the others are still to tell what became of theirs.
        self.others.extend(
            there.into_iter().filter(|token| token.machine == machine.as_str()).map(|token| token.id),
        );
        self.enlist(plan, office, machine).await?;
        Ok(true)
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

/// A machine's token that is called as those of this recording's replays are.
struct Namesake {
    id: String,
    machine: String,
    is_valid: bool,
}

/// The tokens of every replay of this recording.
async fn namesakes(plan: &Plan, office: &Client) -> Result<Vec<Namesake>, ReplayError> {
    let name = name_of(plan);
    let mut found = Vec::new();
    let mut path = "/v1/tokens?limit=500".to_owned();
    loop {
        let page = office.get(&path).await?;
        expect_success("GET", &path, &page)?;
        let page = page.json();
        for token in page["items"].as_array().into_iter().flatten() {
            let (Some(id), Some(machine)) = (token["id"].as_str(), token["machine"].as_str()) else {
                continue;
            };
            if token["name"] == name.as_str() && token["role"] == "machine" {
                found.push(Namesake {
                    id: id.to_owned(),
                    machine: machine.to_owned(),
                    is_valid: token["revoked_at"].is_null(),
                });
            }
        }
        match page["next_cursor"].as_str() {
            Some(cursor) => path = format!("/v1/tokens?limit=500&cursor={cursor}"),
            None => return Ok(found),
        }
    }
}

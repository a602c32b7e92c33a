//! Tokens in JSON; the secret only once.

use super::text::{MAX_NAME, required};
use super::time;
use super::word::RoleWord;
use feedwright_core::ids::MachineId;
use feedwright_core::invalid::Violation;
use feedwright_store::{Role, TokenRecord};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A token that is to be made.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TokenBody {
    /// What people call it.
    #[schema(example = "MES")]
    pub name: String,
    /// What it may do.
    pub role: RoleWord,
    /// The one machine that it is bound to; required for the role `machine`, and only there.
    #[serde(default)]
    pub machine: Option<String>,
}

/// A token that is to be made, checked.
#[derive(Debug, Clone)]
pub struct TokenRequest {
    /// What people call it.
    pub name: String,
    /// What it may do.
    pub role: Role,
    /// The one machine that it is bound to.
    pub machine: Option<MachineId>,
}

impl TryFrom<TokenBody> for TokenRequest {
    type Error = Vec<Violation>;

    fn try_from(body: TokenBody) -> Result<Self, Vec<Violation>> {
        let mut wrong = Vec::new();
        let name = required("name", &body.name, MAX_NAME, &mut wrong);
        let role = body.role.0;
        if (role == Role::Machine) != body.machine.is_some() {
            let message = "is required for the role machine, and has no meaning for another";
            wrong.push(Violation::new("machine", "machine_binding", message));
        }
        let machine = body.machine.as_deref().map(|machine| MachineId::parse("machine", machine)).transpose();
        match machine {
            Ok(machine) if wrong.is_empty() => Ok(Self { name, role, machine }),
            machine => {
                wrong.extend(machine.err());
                Err(wrong)
            }
        }
    }
}

/// A token as it is listed.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub struct TokenView {
    /// Its public id: the part after `fwt_`.
    pub id: String,
    /// What people call it.
    pub name: String,
    /// What it may do.
    pub role: RoleWord,
    /// The one machine that it is bound to.
    pub machine: Option<String>,
    /// When it was made, RFC 3339.
    pub created_at: String,
    /// When it was revoked.
    pub revoked_at: Option<String>,
}

impl From<TokenRecord> for TokenView {
    fn from(record: TokenRecord) -> Self {
        Self {
            id: record.id,
            name: record.name,
            role: RoleWord(record.role),
            machine: record.machine.map(|machine| machine.as_str().to_owned()),
            created_at: time::show(record.created_at),
            revoked_at: record.revoked_at.map(time::show),
        }
    }
}

/// A token that was just made.
#[derive(Serialize, Deserialize, ToSchema)]
pub struct NewToken {
    /// The token: shown now and never again.
    #[schema(example = "fwt_…")]
    pub token: String,
    /// What is kept of it.
    #[serde(flatten)]
    pub kept: TokenView,
}

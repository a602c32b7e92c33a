//! Sessions in JSON.

use super::time;
use super::word::RoleWord;
use feedwright_core::units::Timestamp;
use feedwright_store::Role;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a session is begun with.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SessionBody {
    /// The token.
    pub token: String,
    /// Whether it is for a screen that nobody signs in at: it lasts 90 days instead of 12 hours.
    #[serde(default)]
    pub lasting: bool,
}

/// Who asks, and what it may do.
#[derive(Debug, Serialize, ToSchema)]
pub struct SessionView {
    /// Public id of the token.
    pub token: String,
    /// What people call it.
    pub name: String,
    /// The role it acts in.
    pub role: RoleWord,
    /// When the session ends, RFC 3339; null for a request with a token.
    pub expires_at: Option<String>,
    /// The routes it may use, as in `PUT /v1/tools/{tool}`.
    pub may: &'static [String],
}

impl SessionView {
    /// Of a token in that role.
    pub fn new(
        token: &str,
        name: &str,
        role: Role,
        expires_at: Option<Timestamp>,
        may: &'static [String],
    ) -> Self {
        let expires_at = expires_at.map(time::show);
        Self { token: token.to_owned(), name: name.to_owned(), role: RoleWord(role), expires_at, may }
    }
}

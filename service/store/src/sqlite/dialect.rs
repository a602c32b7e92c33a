//! What SQLite says differently.

use super::Conn;
use crate::error::StoreResult;
use crate::locks::Locks;

/// The one writer holds the database: there is nobody to be locked out.
#[expect(clippy::unused_async, reason = "the other engine asks its server")]
pub(super) async fn lock(_conn: &mut Conn, _locks: &Locks) -> StoreResult<()> {
    Ok(())
}

/// A tool's caches, inside a transaction that nobody else writes beside.
pub(super) const WEAR_OF_TOOL_LOCKED: &str =
    "SELECT machine_id, folded, fold_version, state FROM tool_wear WHERE tool_id = $1 ORDER BY machine_id";

/// A failed commit is never tried again: after a failed fsync the pages may be gone.
pub(super) const COMMIT_ATTEMPTS: u32 = 1;

/// Notes when machines were last heard of, out of `[[machine, microseconds], …]`.
pub(super) const NOTE_CONTACTS: &str = "INSERT INTO machine_contacts (machine_id, last_cycle_at_us)
     SELECT json_extract(value, '$[0]'), json_extract(value, '$[1]') FROM json_each($1) WHERE TRUE
     ON CONFLICT (machine_id) DO UPDATE
     SET last_cycle_at_us = MAX(machine_contacts.last_cycle_at_us, excluded.last_cycle_at_us)";

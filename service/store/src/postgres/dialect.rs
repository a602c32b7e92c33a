//! What PostgreSQL says differently.

mod many;

pub(super) use many::{insert_blocks, insert_cycles, insert_recommendations, save_wear};

use super::Conn;
use crate::error::StoreResult;
use crate::locks::Locks;

/// Locks names until the end of the transaction: shared ones first, each in ascending order.
pub(super) async fn lock(conn: &mut Conn, locks: &Locks) -> StoreResult<()> {
    if !locks.shared.is_empty() {
        sqlx::query(
            "SELECT count(pg_advisory_xact_lock_shared(k))
             FROM (SELECT k FROM unnest($1::BIGINT[]) AS keys (k) ORDER BY k OFFSET 0) AS sorted",
        )
        .bind(&locks.shared)
        .execute(&mut *conn)
        .await?;
    }
    if !locks.exclusive.is_empty() {
        sqlx::query(
            "SELECT count(pg_advisory_xact_lock(k))
             FROM (SELECT k FROM unnest($1::BIGINT[]) AS keys (k) ORDER BY k OFFSET 0) AS sorted",
        )
        .bind(&locks.exclusive)
        .execute(&mut *conn)
        .await?;
    }
    Ok(())
}

/// A tool's caches, locked in the order of their keys.
pub(super) const WEAR_OF_TOOL_LOCKED: &str =
    "SELECT machine_id, folded, fold_version, state, version FROM tool_wear
     WHERE tool_id = $1 ORDER BY machine_id FOR UPDATE";

/// The generation of the registry, under an empty name, and the versions of the folds of a list of tools. The tools'
/// names are locked by then.
pub(super) const HEADS: &str =
    "SELECT '' AS tool_id, '' AS machine_id, CAST(SUM(changes) AS BIGINT) AS version
     FROM registry_generation
     UNION ALL SELECT tool_id, machine_id, version FROM tool_wear WHERE tool_id = ANY($1)";

/// A list of ids as one parameter.
pub(super) fn list<'a>(ids: impl Iterator<Item = &'a str>) -> Vec<String> {
    ids.map(str::to_owned).collect()
}

/// A lost connection, a restart or a deadlock's victim: the second attempt finds by key what the first one kept.
pub(super) const COMMIT_ATTEMPTS: u32 = 3;

/// Notes when machines were last heard of, out of `[[machine, microseconds], …]`, in the order of their keys.
pub(super) const NOTE_CONTACTS: &str = "INSERT INTO machine_contacts (machine_id, last_cycle_at_us)
     SELECT heard.value->>0, (heard.value->>1)::BIGINT FROM jsonb_array_elements($1::JSONB) AS heard (value)
     ORDER BY 1
     ON CONFLICT (machine_id) DO UPDATE
     SET last_cycle_at_us = GREATEST(machine_contacts.last_cycle_at_us, excluded.last_cycle_at_us)";

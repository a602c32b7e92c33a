//! The quarantine: bounded, bodies compressed as they came, the same body once.

use super::{Conn, Db, alarms, audit, dialect};
use crate::error::{StoreError, StoreResult};
use crate::locks::Locks;
use crate::record::{Actor, AlarmKind, Page, QuarantineBounds, QuarantineEntry, Through};
use crate::rows::{QuarantineRow, count, number};
use crate::stored_text::StoredText;
use feedwright_core::ids::MachineId;
use feedwright_core::units::Timestamp;
use serde_json::json;
use sqlx::Row;
use std::time::Duration;

/// Bodies are written once and read by people.
const LEVEL: i32 = 3;

macro_rules! select {
    ($more:literal, $tail:expr) => {
        concat!(
            "SELECT quarantine_id, machine_id, cycle_id, received_at_us, code, problem, content_type, size,
                    settled_at_us, settled_how",
            $more,
            " FROM quarantine ",
            $tail
        )
    };
}

macro_rules! page {
    ($which:literal) => {
        select!("", concat!("WHERE ", $which, "quarantine_id > $1 ORDER BY quarantine_id LIMIT $2"))
    };
}

const ALL: &str = page!("");
const OPEN: &str = page!("settled_at_us IS NULL AND ");
const OF_MACHINE: &str = page!("machine_id = $3 AND ");
const OPEN_OF_MACHINE: &str = page!("settled_at_us IS NULL AND machine_id = $3 AND ");

const FILLED: &str = "SELECT entries, bytes FROM quarantine_fill";

/// A body ready to be kept.
pub(super) struct Packed {
    body: Vec<u8>,
    hash: [u8; 32],
    size: u64,
}

impl Packed {
    /// Compresses a body; done before the writer is taken.
    pub(super) fn of(body: &[u8]) -> StoreResult<Self> {
        let packed =
            zstd::bulk::compress(body, LEVEL).map_err(|error| StoreError::Unavailable(Box::new(error)))?;
        Ok(Self { body: packed, hash: *blake3::hash(body).as_bytes(), size: body.len() as u64 })
    }
}

pub(super) async fn add(
    conn: &mut Conn,
    entry: &QuarantineEntry,
    packed: &Packed,
    bounds: QuarantineBounds,
) -> StoreResult<String> {
    dialect::lock(conn, &Locks::subject("quarantine", "")).await?;
    let standing: Option<WithBody> = sqlx::query_as::<Db, _>(select!(
        ", body, body_hash",
        "WHERE machine_id = $1 AND COALESCE(cycle_id, '') = $2 AND body_hash = $3"
    ))
    .bind(entry.machine.as_str())
    .bind(entry.cycle.as_deref().unwrap_or(""))
    .bind(packed.hash.as_slice())
    .fetch_optional(&mut *conn)
    .await?;
    if let Some(standing) = standing {
        let id = standing.entry.quarantine_id.clone();
        // Whoever sends it may forget it afterwards: what is kept has to be what came.
        if standing.body().is_none() {
            sqlx::query::<Db>(
                "UPDATE quarantine SET body = $2, size = $3, stored_bytes = $4 WHERE quarantine_id = $1",
            )
            .bind(&id)
            .bind(&packed.body)
            .bind(count("size", packed.size)?)
            .bind(count("stored_bytes", packed.body.len() as u64)?)
            .execute(&mut *conn)
            .await?;
        }
        return Ok(id);
    }
    let (entries, bytes) = filled(conn).await?;
    let entries: u64 = number("entries", entries)?;
    let bytes: u64 = number("bytes", bytes)?;
    if entries >= bounds.entries || bytes.saturating_add(packed.body.len() as u64) > bounds.bytes {
        return Err(StoreError::Full { what: "the quarantine" });
    }
    let id = behind_all(conn, &entry.id).await?;
    sqlx::query::<Db>(
        "INSERT INTO quarantine (quarantine_id, machine_id, cycle_id, received_at_us, code, problem, content_type,
             size, stored_bytes, body, body_hash)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11)",
    )
    .bind(&id)
    .bind(entry.machine.as_str())
    .bind(&entry.cycle)
    .bind(entry.received_at.micros())
    .bind(&entry.code)
    .bind(&entry.problem)
    .bind(&entry.content_type)
    .bind(count("size", packed.size)?)
    .bind(count("stored_bytes", packed.body.len() as u64)?)
    .bind(&packed.body)
    .bind(packed.hash.as_slice())
    .execute(&mut *conn)
    .await?;
    let message = format!("machine {}: data that could not be accepted waits in quarantine", entry.machine);
    alarms::raise(conn, AlarmKind::Quarantine, Some(&entry.machine), None, &message, entry.received_at)
        .await?;
    Ok(id)
}

/// How many entries are not settled, and how many bytes they take: kept with every change of the table, and not counted by each line that
/// cannot be accepted. Under the lock of the quarantine.
async fn filled(conn: &mut Conn) -> StoreResult<(i64, i64)> {
    if let Some(filled) = sqlx::query_as::<Db, _>(FILLED).fetch_optional(&mut *conn).await? {
        return Ok(filled);
    }
    count_anew(conn).await?;
    Ok(sqlx::query_as::<Db, _>(FILLED).fetch_one(&mut *conn).await?)
}

/// Counts entries that are not settled, and sets right what is kept of that where somebody has changed it by other means.
pub(super) async fn count_filled(conn: &mut Conn) -> StoreResult<(i64, i64)> {
    // One statement sees one moment: what is kept is changed in the transactions in which entries are.
    let (entries, bytes, kept): (i64, i64, i64) = sqlx::query_as::<Db, _>(
        "SELECT counted.entries, counted.bytes, CAST(COUNT(f.only_row) AS BIGINT)
         FROM (SELECT COUNT(*) AS entries, CAST(COALESCE(SUM(stored_bytes), 0) AS BIGINT) AS bytes
               FROM quarantine WHERE settled_at_us IS NULL) AS counted
         LEFT JOIN quarantine_fill f ON f.entries = counted.entries AND f.bytes = counted.bytes
         GROUP BY counted.entries, counted.bytes",
    )
    .fetch_one(&mut *conn)
    .await?;
    if kept == 0 {
        tracing::warn!(
            entries,
            bytes,
            "what was kept of how far the quarantine is filled was not so; it is counted anew"
        );
        dialect::lock(conn, &Locks::subject("quarantine", "")).await?;
        count_anew(conn).await?;
    }
    Ok((entries, bytes))
}

async fn count_anew(conn: &mut Conn) -> StoreResult<()> {
    sqlx::query::<Db>(
        "INSERT INTO quarantine_fill (only_row, entries, bytes)
         SELECT 1, COUNT(*), CAST(COALESCE(SUM(stored_bytes), 0) AS BIGINT) FROM quarantine
         WHERE settled_at_us IS NULL
         ON CONFLICT (only_row) DO UPDATE SET entries = excluded.entries, bytes = excluded.bytes",
    )
    .execute(&mut *conn)
    .await?;
    Ok(())
}

/// The id under which an entry is kept: the one that it came with, or the next behind all that are kept. Ids are made when bodies come,
/// and whoever lists goes on behind the last one that was shown: what was committed later under an id before it would never be.
async fn behind_all(conn: &mut Conn, id: &str) -> StoreResult<String> {
    let newest: Option<StoredText> = sqlx::query_scalar::<Db, _>("SELECT MAX(quarantine_id) FROM quarantine")
        .fetch_one(&mut *conn)
        .await?;
    let Some(newest) = newest.as_ref().and_then(StoredText::as_str).filter(|newest| *newest >= id) else {
        return Ok(id.to_owned());
    };
    // Of what is no such id, as of a damaged one, nothing comes next.
    let next = uuid::Uuid::parse_str(newest).ok().and_then(|newest| newest.as_u128().checked_add(1));
    Ok(next.map_or_else(|| id.to_owned(), |next| uuid::Uuid::from_u128(next).to_string()))
}

/// A page of a machine's entries, or of all, by statements that have an index each.
pub(super) async fn list(
    conn: &mut Conn,
    machine: Option<&MachineId>,
    open: bool,
    page: &Page<String>,
) -> StoreResult<Vec<QuarantineEntry>> {
    let (after, limit) = (page.after.as_deref().unwrap_or(""), i64::from(page.limit));
    let sql = match (machine, open) {
        (None, false) => ALL,
        (None, true) => OPEN,
        (Some(_), false) => OF_MACHINE,
        (Some(_), true) => OPEN_OF_MACHINE,
    };
    let mut query = sqlx::query_as::<Db, QuarantineRow>(sql).bind(after).bind(limit);
    if let Some(machine) = machine {
        query = query.bind(machine.as_str());
    }
    query.fetch_all(&mut *conn).await?.iter().map(QuarantineRow::entry).collect()
}

#[derive(sqlx::FromRow)]
struct WithBody {
    #[sqlx(flatten)]
    entry: QuarantineRow,
    body: Vec<u8>,
    body_hash: Vec<u8>,
}

impl WithBody {
    /// The body as it came; `None` where what is kept is not that any more.
    fn body(&self) -> Option<Vec<u8>> {
        unpacked(&self.body, self.entry.size, &self.body_hash)
    }
}

fn unpacked(body: &[u8], size: i64, hash: &[u8]) -> Option<Vec<u8>> {
    let size = u64::try_from(size).ok()?;
    // The frame's own size has to be the one that was written beside it: a damaged one would have anything reserved.
    let framed = zstd::zstd_safe::get_frame_content_size(body).ok()?;
    let body =
        zstd::bulk::decompress(body, usize::try_from(size).ok().filter(|_| framed == Some(size))?).ok()?;
    (blake3::hash(&body).as_bytes() == hash).then_some(body)
}

pub(super) async fn get(
    conn: &mut Conn,
    id: &str,
) -> StoreResult<Option<(QuarantineEntry, Option<Vec<u8>>)>> {
    let row: Option<WithBody> =
        sqlx::query_as::<Db, _>(select!(", body, body_hash", "WHERE quarantine_id = $1"))
            .bind(id)
            .fetch_optional(&mut *conn)
            .await?;
    let Some(row) = row else {
        return Ok(None);
    };
    Ok(Some((row.entry.entry()?, row.body())))
}

/// Entries whose bodies are not what came: whoever took one of them in again would store what no machine has measured. And
/// whether all could be gone through.
pub(super) async fn damaged(conn: &mut Conn, most: usize) -> StoreResult<(Vec<String>, bool)> {
    let mut damaged = Vec::new();
    let mut after = Through::<StoredText>::default();
    while damaged.len() < most {
        // One at a time: a body may be as long as a batch. Nothing of its other texts, which may be damaged.
        let row = sqlx::query::<Db>(
            "SELECT quarantine_id, size, body, body_hash FROM quarantine
             WHERE quarantine_id > CAST($1 AS TEXT) ORDER BY quarantine_id LIMIT 1 OFFSET $2",
        )
        .bind(after.key.clone())
        .bind(after.past())
        .fetch_optional(&mut *conn)
        .await?;
        let Some(row) = row else { break };
        let id: StoredText = row.try_get(0)?;
        let before = after.clone();
        after.pass(id.clone(), id.is_sound());
        if after <= before {
            return Ok((damaged, false));
        }
        let (body, hash) = (row.try_get::<Vec<u8>, _>(2), row.try_get::<Vec<u8>, _>(3));
        let kept = body.ok().zip(row.try_get(1).ok()).zip(hash.ok());
        if kept.and_then(|((body, size), hash)| unpacked(&body, size, &hash)).is_none() {
            damaged.push(id.to_string());
        }
    }
    Ok((damaged, true))
}

/// Claims an entry, where it is not settled and nobody else has claimed it; what would end later than `lease` was written by a clock that
/// was ahead.
pub(super) async fn claim(
    conn: &mut Conn,
    id: &str,
    holder: &str,
    (now, lease): (Timestamp, Duration),
) -> StoreResult<bool> {
    // Whoever settles it holds this until that is committed.
    dialect::lock(conn, &Locks::subject("quarantine", "")).await?;
    let lease_us = i64::try_from(lease.as_micros()).unwrap_or(i64::MAX);
    let claimed = sqlx::query::<Db>(
        "INSERT INTO quarantine_claims (quarantine_id, holder, expires_at_us)
         SELECT quarantine_id, $2, $3 FROM quarantine WHERE quarantine_id = $1 AND settled_at_us IS NULL
         ON CONFLICT (quarantine_id) DO UPDATE SET holder = excluded.holder, expires_at_us = excluded.expires_at_us
         WHERE quarantine_claims.holder = $2 OR quarantine_claims.expires_at_us <= $4
             OR quarantine_claims.expires_at_us > $3",
    )
    .bind(id)
    .bind(holder)
    .bind(now.micros().saturating_add(lease_us))
    .bind(now.micros())
    .execute(&mut *conn)
    .await?;
    Ok(claimed.rows_affected() == 1)
}

/// Gives up a claim of this holder's; whether it had one.
pub(super) async fn release(conn: &mut Conn, id: &str, holder: &str) -> StoreResult<bool> {
    let released =
        sqlx::query::<Db>("DELETE FROM quarantine_claims WHERE quarantine_id = $1 AND holder = $2")
            .bind(id)
            .bind(holder)
            .execute(&mut *conn)
            .await?;
    Ok(released.rows_affected() == 1)
}

pub(super) async fn settle(
    conn: &mut Conn,
    (id, holder): (&str, &str),
    how: &str,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<bool> {
    dialect::lock(conn, &Locks::subject("quarantine", "")).await?;
    if !release(conn, id, holder).await? {
        return Ok(false);
    }
    let machine: Option<String> = sqlx::query_scalar::<Db, _>(
        "UPDATE quarantine SET settled_at_us = $2, settled_how = $3
         WHERE quarantine_id = $1 AND settled_at_us IS NULL RETURNING machine_id",
    )
    .bind(id)
    .bind(now.micros())
    .bind(how)
    .fetch_optional(&mut *conn)
    .await?;
    let Some(machine) = machine else {
        return Ok(false);
    };
    let machine: MachineId = crate::rows::id("machine_id", &machine)?;
    audit::add(conn, actor, now, "quarantine.settle", format!("quarantine/{id}"), &json!({ "how": how }))
        .await?;
    if list(conn, Some(&machine), true, &Page { after: None, limit: 1 }).await?.is_empty() {
        alarms::clear_of_machine(conn, AlarmKind::Quarantine, &machine, now).await?;
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sqlite::plans::plan;

    #[test]
    fn each_list_has_an_index_of_its_own_and_no_line_counts_the_others() {
        let by = [
            (ALL, "INDEX sqlite_autoindex_quarantine_1 (quarantine_id>?)"),
            (OPEN, "INDEX quarantine_unsettled (quarantine_id>?)"),
            (OF_MACHINE, "INDEX quarantine_by_machine (machine_id=? AND quarantine_id>?)"),
            (OPEN_OF_MACHINE, "INDEX quarantine_unsettled_by_machine (machine_id=? AND quarantine_id>?)"),
        ];
        for (sql, by) in by {
            assert_eq!(plan(sql), [format!("SEARCH quarantine USING {by}")], "{sql}");
        }
        // Of one row.
        assert_eq!(plan(FILLED), ["SCAN quarantine_fill"]);
    }
}

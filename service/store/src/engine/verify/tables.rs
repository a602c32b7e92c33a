//! What is wrong with the tables as a whole: rows without their other half, and what is stored beside cycles.

use super::super::{Conn, Db, dialect, quarantine};
use crate::codec;
use crate::error::{StoreError, StoreResult};
use crate::record::{StoreFault, Through};
use crate::rows::{AdviceBody, is_content_of};
use crate::stored_text::StoredText;
use crate::transfer::TransferError;
use sqlx::Row;

/// Rows of a kind that are named.
const MOST_NAMED: usize = 1_000;
/// Rows that are read at a time.
const ROWS: i64 = 200;

/// Reads all of them, and changes nothing.
pub(in super::super) async fn tables(conn: &mut Conn) -> StoreResult<Vec<StoreFault>> {
    dialect::read_as_stored(conn).await?;
    let mut faults = dialect::integrity(conn).await?;
    match look_through(conn, &mut faults).await {
        Ok(()) => {}
        // A page that cannot be read: what was found before is told all the same.
        Err(StoreError::NotWritable(error) | StoreError::NotReadable(error)) => faults.push(unread(&*error)),
        Err(error @ StoreError::Damaged { .. }) => faults.push(unread(&error)),
        Err(error) => return Err(error),
    }
    Ok(faults)
}

fn unread(error: &dyn std::fmt::Display) -> StoreFault {
    fault("file", "database".to_owned(), &format!("its tables cannot be read any further: {error}"))
}

async fn look_through(conn: &mut Conn, faults: &mut Vec<StoreFault>) -> StoreResult<()> {
    match dialect::damaged_rows(conn, MOST_NAMED).await {
        Ok(damaged) => faults.extend(damaged),
        Err(TransferError::Store(error)) => return Err(error),
        Err(TransferError::Schema(what)) => faults.push(fault("schema", "tables".to_owned(), &what)),
        Err(error) => faults.push(fault("schema", "tables".to_owned(), &error.to_string())),
    }
    let most = i64::try_from(MOST_NAMED).unwrap_or(i64::MAX);
    let (damaged, is_whole) = quarantine::damaged(conn, MOST_NAMED).await?;
    faults.extend(damaged.into_iter().map(|key| fault("quarantine", key, "its body is not what came")));
    if !is_whole {
        unreadable("quarantine", faults)?;
    }
    let silent: Vec<(dialect::StoredRecommendation,)> = sqlx::query_as::<Db, _>(
        "SELECT r.recommendation_id FROM recommendations r WHERE NOT EXISTS (
             SELECT 1 FROM advices a WHERE a.advice_hash = r.advice_hash)
         ORDER BY r.recommendation_id LIMIT $1",
    )
    .bind(most)
    .fetch_all(&mut *conn)
    .await?;
    let silent = silent.into_iter().map(|(key,)| dialect::recommendation_of(&key));
    faults.extend(silent.map(|id| fault("recommendation", id, "what it advised is not there")));
    let strays: Vec<(StoredText, StoredText)> = sqlx::query_as::<Db, _>(
        "SELECT s.machine_id, s.cycle_id FROM cycle_samples s WHERE NOT EXISTS (
             SELECT 1 FROM cycles c WHERE c.machine_id = s.machine_id AND c.cycle_id = s.cycle_id
                 AND c.received_at_us = s.received_at_us)
         ORDER BY s.machine_id, s.cycle_id LIMIT $1",
    )
    .bind(most)
    .fetch_all(&mut *conn)
    .await?;
    let of_none = |(machine, cycle)| format!("{machine}/{cycle}");
    let strays = strays.into_iter().map(of_none);
    faults.extend(strays.map(|key| fault("samples", key, "they belong to no cycle")));
    faults.extend(dialect::stray_packs(conn, most).await?);
    // Overrides of a stream do not: they are there before their cycle, which may have gone to quarantine.
    let cuts: Vec<(StoredText, StoredText)> = sqlx::query_as::<Db, _>(
        "SELECT k.machine_id, k.cycle_id FROM cycle_cuts k WHERE NOT EXISTS (
             SELECT 1 FROM cycles c WHERE c.machine_id = k.machine_id AND c.cycle_id = k.cycle_id)
         ORDER BY k.machine_id, k.cycle_id LIMIT $1",
    )
    .bind(most)
    .fetch_all(&mut *conn)
    .await?;
    faults.extend(cuts.into_iter().map(of_none).map(|key| fault("cut", key, "it belongs to no cycle")));
    // Nothing takes a tool away, and of one that was never registered nothing is counted or told.
    let gone: Vec<(StoredText,)> = sqlx::query_as::<Db, _>(
        "SELECT tool_id FROM (SELECT tool_id FROM tool_wear UNION SELECT tool_id FROM tool_events) AS known
         WHERE NOT EXISTS (SELECT 1 FROM tools t WHERE t.tool_id = known.tool_id) ORDER BY tool_id LIMIT $1",
    )
    .bind(most)
    .fetch_all(&mut *conn)
    .await?;
    let gone = gone.into_iter().map(|(tool,)| format!("tools {tool}"));
    faults.extend(gone.map(|key| {
        fault("row", key, "it is not there, and its cycles were counted or events of it were told")
    }));
    advices(conn, faults).await?;
    overrides(conn, faults).await?;
    feed_profiles(conn, faults).await
}

fn fault(kind: &'static str, key: String, detail: &str) -> StoreFault {
    StoreFault { kind, key, detail: detail.to_owned(), column: None }
}

/// Whether what was advised can be read, and is what its hash says.
async fn advices(conn: &mut Conn, faults: &mut Vec<StoreFault>) -> StoreResult<()> {
    let mut after = Vec::new();
    let most = faults.len() + MOST_NAMED;
    loop {
        let rows = sqlx::query::<Db>(
            "SELECT advice_hash, body FROM advices WHERE advice_hash > $1 ORDER BY advice_hash LIMIT $2",
        )
        .bind(after.as_slice())
        .bind(ROWS)
        .fetch_all(&mut *conn)
        .await?;
        let before = after.clone();
        for row in &rows {
            let Ok(hash) = row.try_get::<Vec<u8>, _>(0) else { return unreadable("advices", faults) };
            let wrong = match row.try_get::<String, _>(1) {
                Ok(body) => AdviceBody::read(&hash, &body).err().map(|error| error.to_string()),
                Err(_) => Some("it cannot be read".to_owned()),
            };
            if let Some(wrong) = wrong {
                let key = hash.iter().map(|byte| format!("{byte:02x}")).collect();
                faults.push(fault("advice", key, &wrong));
            }
            after = hash;
        }
        if rows.is_empty() || faults.len() >= most {
            return Ok(());
        }
        if after <= before {
            return unreadable("advices", faults);
        }
    }
}

/// Without their keys rows cannot be gone through: what is said of the table is all that is said.
fn unreadable(table: &'static str, faults: &mut Vec<StoreFault>) -> StoreResult<()> {
    faults.push(fault("table", table.to_owned(), "its rows cannot be gone through by their key"));
    Ok(())
}

async fn overrides(conn: &mut Conn, faults: &mut Vec<StoreFault>) -> StoreResult<()> {
    let mut after = Through::<(StoredText, StoredText)>::default();
    let most = faults.len() + MOST_NAMED;
    loop {
        let rows = sqlx::query::<Db>(
            "SELECT machine_id, cycle_id, block FROM cycle_overrides
             WHERE (machine_id, cycle_id) > (CAST($1 AS TEXT), CAST($2 AS TEXT))
             ORDER BY machine_id, cycle_id LIMIT $3 OFFSET $4",
        )
        .bind(after.key.0.clone())
        .bind(after.key.1.clone())
        .bind(ROWS)
        .bind(after.past())
        .fetch_all(&mut *conn)
        .await?;
        let before = after.clone();
        for row in &rows {
            let (Ok(machine), Ok(cycle)) = (row.try_get::<StoredText, _>(0), row.try_get::<StoredText, _>(1))
            else {
                return unreadable("cycle_overrides", faults);
            };
            let block = row.try_get::<Vec<u8>, _>(2).ok();
            if block.is_none_or(|block| codec::decode_overrides(&block).is_err()) {
                faults.push(fault("overrides", format!("{machine}/{cycle}"), "they cannot be read"));
            }
            let is_sound = machine.is_sound() && cycle.is_sound();
            after.pass((machine, cycle), is_sound);
        }
        if rows.is_empty() || faults.len() >= most {
            return Ok(());
        }
        if after <= before {
            return unreadable("cycle_overrides", faults);
        }
    }
}

async fn feed_profiles(conn: &mut Conn, faults: &mut Vec<StoreFault>) -> StoreResult<()> {
    let mut after = Through::<(StoredText, i64)>::default();
    let most = faults.len() + MOST_NAMED;
    loop {
        let rows = sqlx::query::<Db>(
            "SELECT profile_id, version, content, content_hash FROM feed_profile_versions
             WHERE (profile_id, version) > (CAST($1 AS TEXT), $2) ORDER BY profile_id, version LIMIT $3 OFFSET $4",
        )
        .bind(after.key.0.clone())
        .bind(after.key.1)
        .bind(ROWS)
        .bind(after.past())
        .fetch_all(&mut *conn)
        .await?;
        let before = after.clone();
        for row in &rows {
            let (Ok(profile), Ok(version)) = (row.try_get::<StoredText, _>(0), row.try_get::<i64, _>(1))
            else {
                return unreadable("feed_profile_versions", faults);
            };
            let content = row.try_get::<String, _>(2).ok().zip(row.try_get::<Vec<u8>, _>(3).ok());
            if content.is_none_or(|(content, hash)| !is_content_of(&content, &hash)) {
                let key = format!("{profile}/{version}");
                faults.push(fault("feed profile", key, "its content is not what was drafted"));
            }
            let is_sound = profile.is_sound();
            after.pass((profile, version), is_sound);
        }
        if rows.is_empty() || faults.len() >= most {
            return Ok(());
        }
        if after <= before {
            return unreadable("feed_profile_versions", faults);
        }
    }
}

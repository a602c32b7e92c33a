//! What is wrong with the tables as a whole: rows without their other half, and what is stored beside cycles.

use super::super::{Conn, Db, dialect, quarantine};
use crate::codec;
use crate::error::StoreResult;
use crate::record::StoreFault;
use crate::rows::{AdviceBody, is_content_of};

/// Rows of a kind that are named.
const MOST_NAMED: usize = 1_000;
/// Rows that are read at a time.
const ROWS: i64 = 200;

/// Reads all of them, and changes nothing.
pub(in super::super) async fn tables(conn: &mut Conn) -> StoreResult<Vec<StoreFault>> {
    let mut faults = dialect::integrity(conn).await?;
    let most = i64::try_from(MOST_NAMED).unwrap_or(i64::MAX);
    let damaged = quarantine::damaged(conn, most).await?.into_iter();
    faults.extend(damaged.map(|key| fault("quarantine", key, "its body is not what came")));
    let silent: Vec<(String,)> = sqlx::query_as::<Db, _>(
        "SELECT r.recommendation_id FROM recommendations r WHERE NOT EXISTS (
             SELECT 1 FROM advices a WHERE a.advice_hash = r.advice_hash)
         ORDER BY r.recommendation_id LIMIT $1",
    )
    .bind(most)
    .fetch_all(&mut *conn)
    .await?;
    let silent = silent.into_iter();
    faults.extend(silent.map(|(key,)| fault("recommendation", key, "what it advised is not there")));
    let strays: Vec<(String, String)> = sqlx::query_as::<Db, _>(
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
    // Overrides of a stream do not: they are there before their cycle, which may have gone to quarantine.
    let cuts: Vec<(String, String)> = sqlx::query_as::<Db, _>(
        "SELECT k.machine_id, k.cycle_id FROM cycle_cuts k WHERE NOT EXISTS (
             SELECT 1 FROM cycles c WHERE c.machine_id = k.machine_id AND c.cycle_id = k.cycle_id)
         ORDER BY k.machine_id, k.cycle_id LIMIT $1",
    )
    .bind(most)
    .fetch_all(&mut *conn)
    .await?;
    faults.extend(cuts.into_iter().map(of_none).map(|key| fault("cut", key, "it belongs to no cycle")));
    advices(conn, &mut faults).await?;
    overrides(conn, &mut faults).await?;
    feed_profiles(conn, &mut faults).await?;
    Ok(faults)
}

fn fault(kind: &'static str, key: String, detail: &str) -> StoreFault {
    StoreFault { kind, key, detail: detail.to_owned() }
}

/// Whether what was advised can be read. What earlier versions kept is not all under the hash of its text.
async fn advices(conn: &mut Conn, faults: &mut Vec<StoreFault>) -> StoreResult<()> {
    let (mut after, most) = (Vec::new(), faults.len() + MOST_NAMED);
    loop {
        let rows: Vec<(Vec<u8>, String)> = sqlx::query_as::<Db, _>(
            "SELECT advice_hash, body FROM advices WHERE advice_hash > $1 ORDER BY advice_hash LIMIT $2",
        )
        .bind(after.as_slice())
        .bind(ROWS)
        .fetch_all(&mut *conn)
        .await?;
        for (hash, body) in &rows {
            if serde_json::from_str::<AdviceBody<'_>>(body).is_err() {
                let key = hash.iter().map(|byte| format!("{byte:02x}")).collect();
                faults.push(fault("advice", key, "it cannot be read"));
            }
        }
        match rows.into_iter().last() {
            Some((last, _)) if faults.len() < most => after = last,
            _ => return Ok(()),
        }
    }
}

async fn overrides(conn: &mut Conn, faults: &mut Vec<StoreFault>) -> StoreResult<()> {
    let (mut machine, mut cycle, most) = (String::new(), String::new(), faults.len() + MOST_NAMED);
    loop {
        let rows: Vec<(String, String, Vec<u8>)> = sqlx::query_as::<Db, _>(
            "SELECT machine_id, cycle_id, block FROM cycle_overrides WHERE (machine_id, cycle_id) > ($1, $2)
             ORDER BY machine_id, cycle_id LIMIT $3",
        )
        .bind(&machine)
        .bind(&cycle)
        .bind(ROWS)
        .fetch_all(&mut *conn)
        .await?;
        for (machine, cycle, block) in &rows {
            if let Err(error) = codec::decode_overrides(block) {
                faults.push(fault("overrides", format!("{machine}/{cycle}"), &error.to_string()));
            }
        }
        match rows.into_iter().last() {
            Some(last) if faults.len() < most => (machine, cycle, _) = last,
            _ => return Ok(()),
        }
    }
}

async fn feed_profiles(conn: &mut Conn, faults: &mut Vec<StoreFault>) -> StoreResult<()> {
    let (mut profile, mut version, most) = (String::new(), 0, faults.len() + MOST_NAMED);
    loop {
        let rows: Vec<(String, i64, String, Vec<u8>)> = sqlx::query_as::<Db, _>(
            "SELECT profile_id, version, content, content_hash FROM feed_profile_versions
             WHERE (profile_id, version) > ($1, $2) ORDER BY profile_id, version LIMIT $3",
        )
        .bind(&profile)
        .bind(version)
        .bind(ROWS)
        .fetch_all(&mut *conn)
        .await?;
        for (profile, version, content, hash) in &rows {
            if !is_content_of(content, hash) {
                let key = format!("{profile}/{version}");
                faults.push(fault("feed profile", key, "its content is not what was drafted"));
            }
        }
        match rows.into_iter().last() {
            Some(last) if faults.len() < most => (profile, version, ..) = last,
            _ => return Ok(()),
        }
    }
}

//! Samples in packs: see [`crate::codec::pack`].

use crate::codec::pack;
use crate::error::{StoreError, StoreResult};
use crate::record::StoreFault;
use crate::rows::BlockRow;
use crate::sqlite::Conn;
use feedwright_core::ids::{CycleId, MachineId};
use std::collections::BTreeMap;

/// The pack of a cycle's samples, their place in it, and how many bytes they are told to take.
pub(in crate::sqlite) const BLOCK: &str =
    "SELECT p.blocks, s.place, s.bytes FROM cycle_samples s LEFT JOIN sample_packs p ON p.pack = s.pack
     WHERE s.machine_id = $1 AND s.cycle_id = $2
       AND s.received_at_us = (SELECT received_at_us FROM cycles WHERE machine_id = $1 AND cycle_id = $2)";

/// Adds a pack; what is added to `cycle_samples` next, up to the next pack, is in it.
pub(in crate::sqlite) const PACK: &str = "INSERT OR FAIL INTO sample_packs (blocks) VALUES (?)";

/// Packs whose drops are done in one transaction.
const PACKS_AT_ONCE: i64 = 64;

/// Cuts blocks into packs.
pub(in crate::sqlite) fn packs<'r, 'a>(
    mut rows: &'r [BlockRow<'a>],
) -> impl Iterator<Item = &'r [BlockRow<'a>]> {
    std::iter::from_fn(move || {
        let together = pack::together(rows.iter().map(|row| row.block.len()));
        let (now, later) = rows.split_at(together);
        rows = later;
        (!now.is_empty()).then_some(now)
    })
}

/// The block of a cycle's samples.
pub(in crate::sqlite) async fn block(
    conn: &mut Conn,
    machine: &MachineId,
    id: &CycleId,
) -> StoreResult<Option<Vec<u8>>> {
    Ok(block_as_told(conn, machine, id).await?.map(|(block, _)| block))
}

/// The same with how many bytes it is told to take, which retention counts by.
pub(in crate::sqlite) async fn block_as_told(
    conn: &mut Conn,
    machine: &MachineId,
    id: &CycleId,
) -> StoreResult<Option<(Vec<u8>, Option<i64>)>> {
    let found: Option<(Option<Vec<u8>>, i64, i64)> =
        sqlx::query_as(BLOCK).bind(machine.as_str()).bind(id.as_str()).fetch_optional(&mut *conn).await?;
    found.map(|(blocks, at, told)| Ok((block_of(blocks.as_deref(), at)?, Some(told)))).transpose()
}

/// The block of what [`BLOCK`] has found.
pub(in crate::sqlite) fn block_of(blocks: Option<&[u8]>, at: i64) -> StoreResult<Vec<u8>> {
    let damaged = || StoreError::Damaged { what: "a pack of samples: it is not there".to_owned() };
    Ok(pack::block(blocks.ok_or_else(damaged)?, place(at)?)?.to_vec())
}

/// A place out of its column.
fn place(at: i64) -> StoreResult<usize> {
    crate::rows::number("place", at)
}

/// Takes blocks out of packs whose cycles have them no longer, a few packs at a time; says whether there are more. Those of a
/// pack go at once, whichever machines they are of.
pub(in crate::sqlite) async fn tidy(conn: &mut Conn) -> StoreResult<bool> {
    let dropped: Vec<(i64, i64)> = sqlx::query_as(
        "SELECT pack, place FROM sample_pack_drops
         WHERE pack IN (SELECT DISTINCT pack FROM sample_pack_drops ORDER BY pack LIMIT $1)",
    )
    .bind(PACKS_AT_ONCE)
    .fetch_all(&mut *conn)
    .await?;
    let mut places: BTreeMap<i64, Vec<usize>> = BTreeMap::new();
    for (pack, at) in dropped {
        places.entry(pack).or_default().push(place(at)?);
    }
    for (number, places) in &places {
        let found: Option<Vec<u8>> = sqlx::query_scalar("SELECT blocks FROM sample_packs WHERE pack = $1")
            .bind(number)
            .fetch_optional(&mut *conn)
            .await?;
        match found.as_deref().map(|blocks| pack::without(blocks, places)) {
            None => {}
            Some(Ok(None)) => {
                sqlx::query("DELETE FROM sample_packs WHERE pack = $1")
                    .bind(number)
                    .execute(&mut *conn)
                    .await?;
            }
            Some(Ok(Some(left))) => {
                sqlx::query("UPDATE sample_packs SET blocks = $2 WHERE pack = $1")
                    .bind(number)
                    .bind(left)
                    .execute(&mut *conn)
                    .await?;
            }
            // The check names it, and each cycle in it.
            Some(Err(what)) => tracing::error!(pack = number, what, "a pack of samples is damaged"),
        }
        sqlx::query("DELETE FROM sample_pack_drops WHERE pack = $1").bind(number).execute(&mut *conn).await?;
    }
    Ok(!places.is_empty())
}

/// Packs that no cycle is in, nor was before what stood there was dropped. One that cannot be read is told of each cycle in it.
pub(in crate::sqlite) async fn stray_packs(conn: &mut Conn, most: i64) -> StoreResult<Vec<StoreFault>> {
    let strays: Vec<i64> = sqlx::query_scalar(
        "SELECT pack FROM sample_packs
         WHERE pack NOT IN (SELECT pack FROM cycle_samples UNION SELECT pack FROM sample_pack_drops)
         ORDER BY pack LIMIT $1",
    )
    .bind(most)
    .fetch_all(&mut *conn)
    .await?;
    let fault = |pack: i64| StoreFault {
        kind: "samples",
        key: format!("pack {pack}"),
        detail: "they belong to no cycle".to_owned(),
        column: None,
    };
    Ok(strays.into_iter().map(fault).collect())
}

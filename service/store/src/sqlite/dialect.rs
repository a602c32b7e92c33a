//! What SQLite says differently.

mod assumed;
mod integrity;
mod many;
mod samples;

pub(super) use super::group_writer::Assumption;
pub(super) use assumed::{MAY_ASSUME, assume, begin_assumed, undo, write_assumed};
pub(super) use integrity::{integrity, of_file};
pub(crate) use many::insert_blocks;
pub(super) use many::{
    CYCLES, PLACES, RECOMMENDATIONS, insert_cycles, insert_recommendations, kept_cell, save_wear, write_rest,
};
pub(super) use samples::{BLOCK, PACK, block, block_as_told, block_of, packs, stray_packs, tidy};

pub(super) use crate::transfer::damaged_rows::of_sqlite as damaged_rows;

use super::{Conn, Writer};
use crate::error::StoreResult;
use crate::locks::Locks;
use crate::record::RowNumber;
use crate::row_sum::Writers;
use crate::rows::AlarmChange;
use crate::sqlite::recommendation_id;
use feedwright_core::units::Timestamp;

/// A program of before refuses a file of this one.
pub(super) const WRITERS: Writers = Writers::Alone;

/// The connection that a group asks with, and that writes what is not written as a whole.
pub(super) fn asked(writer: &mut Writer) -> StoreResult<&mut Conn> {
    writer.asked_for_group()
}

/// Rows go one by one, so by age they go to the microsecond.
#[expect(clippy::unused_async, reason = "the other engine asks its server")]
pub(super) async fn age_horizon(_conn: &mut Conn, at_us: i64) -> StoreResult<i64> {
    Ok(at_us)
}

/// There are no partitions.
#[expect(clippy::unused_async, reason = "the other engine has partitions")]
pub(super) async fn drop_partition(
    _conn: &mut Conn,
    _ended: Timestamp,
) -> StoreResult<Option<Vec<(String, i64, i64)>>> {
    Ok(None)
}

/// The first machine from one on of which samples are left that its newest decision names, and with it all that the others do. Two looks
/// into keys for each machine, however many decisions and cycles it has.
pub(super) const NEXT_TO_DROP: &str = "SELECT m.machine_id FROM machines m
     WHERE m.machine_id >= $1
       AND EXISTS (SELECT 1 FROM cycle_samples s WHERE s.machine_id = m.machine_id AND s.received_at_us <
                       (SELECT MAX(before_us) FROM sample_drops d WHERE d.machine_id = m.machine_id))
     ORDER BY m.machine_id LIMIT 1";

/// The first machine from one on of which samples are to go. All are gone through, so that none is left to go on behind.
pub(super) async fn next_to_drop(
    conn: &mut Conn,
    from: &str,
    _most: i64,
) -> StoreResult<(Option<String>, Option<String>)> {
    Ok((sqlx::query_scalar(NEXT_TO_DROP).bind(from).fetch_optional(&mut *conn).await?, None))
}

/// There are no rights of tables.
#[expect(clippy::unused_async, reason = "the other engine asks for its rights")]
pub(super) async fn may_write(_conn: &mut Conn) -> StoreResult<()> {
    Ok(())
}

/// There are no partitions.
#[expect(clippy::unused_async, reason = "the other engine has partitions")]
pub(super) async fn make_room(_conn: &mut Conn, _now: Timestamp) -> StoreResult<()> {
    Ok(())
}

/// Whoever reads has a snapshot of all of the file.
#[expect(clippy::unused_async, reason = "the other engine asks its server")]
pub(super) async fn keep_partitions(_conn: &mut Conn) -> Result<(), sqlx::Error> {
    Ok(())
}

/// The one writer holds the database: there is nobody to be locked out.
#[expect(clippy::unused_async, reason = "the other engine asks its server")]
pub(super) async fn lock(_conn: &mut Conn, _locks: &Locks) -> StoreResult<()> {
    Ok(())
}

/// Texts are given as they are stored.
#[expect(clippy::unused_async, reason = "the other engine asks its server")]
pub(super) async fn read_as_stored(_conn: &mut Conn) -> StoreResult<()> {
    Ok(())
}

/// One writer commits one line behind the other.
#[expect(clippy::unused_async, reason = "the other engine asks its server")]
pub(super) async fn begin_audit_line(_conn: &mut Conn) -> StoreResult<()> {
    Ok(())
}

/// As [`begin_audit_line`].
#[expect(clippy::unused_async, reason = "the other engine asks its server")]
pub(super) async fn last_audit_line(_conn: &mut Conn) -> StoreResult<RowNumber> {
    Ok(RowNumber::MAX)
}

/// The first alarm that a transaction raises is one as any other, as with lines of the audit.
pub(super) const RAISE_FIRST: &str = AlarmChange::RAISE;

/// As [`begin_audit_line`].
#[expect(clippy::unused_async, reason = "the other engine asks its server")]
pub(super) async fn last_alarm(_conn: &mut Conn) -> StoreResult<RowNumber> {
    Ok(RowNumber::MAX)
}

/// A tool's caches, inside a transaction that nobody else writes beside.
pub(super) const WEAR_OF_TOOL_LOCKED: &str = "SELECT machine_id, folded, fold_version, state, version, judging_change, ran FROM tool_wear WHERE tool_id = $1 ORDER BY machine_id";

/// The rows of one value of a column with which an index begins, which come in the order of that index.
macro_rules! of_one {
    ($column:literal, $value:literal) => {
        concat!($column, " = ", $value)
    };
}
pub(super) use of_one;

/// A column that rows are held against, and that no index is chosen for: without figures of its tables the planner takes a machine's
/// whole history for as short as a tool's.
macro_rules! checked {
    ($column:literal) => {
        concat!("+", $column)
    };
}
pub(super) use checked;

/// Whoever reads, reads one moment.
macro_rules! at_one_moment {
    () => {
        "TRUE"
    };
}
pub(super) use at_one_moment;

/// The file is nobody else's.
macro_rules! incarnation {
    () => {
        "0"
    };
}
pub(super) use incarnation;

/// Begins a group's transaction. The generation of the registry and whether any feed profile is active, under empty names
/// of a tool, and the versions of the folds of a list of tools.
pub(super) const HEADS: &str = "BEGIN IMMEDIATE;
     SELECT '' AS tool_id, '' AS machine_id, CAST(SUM(changes) AS BIGINT) AS version
     FROM registry_generation
     UNION ALL SELECT '', 'profiles', CAST(COUNT(*) AS BIGINT)
     FROM (SELECT 1 FROM feed_profiles WHERE active_version IS NOT NULL LIMIT 1) AS active
     UNION ALL SELECT tool_id, machine_id, version FROM tool_wear
     WHERE tool_id IN (SELECT value FROM json_each($1))";

/// Those of a list of a machine's cycles whose samples were dropped by name.
pub(super) const NAMED_DROPS: &str = "SELECT cycle_id, dropped_at_us, reason FROM cycle_sample_drops
     WHERE machine_id = $1 AND cycle_id IN (SELECT value FROM json_each($2))";

/// Whether a number is one of a list, which is one parameter.
macro_rules! of_numbers {
    ($parameter:literal) => {
        concat!("IN (SELECT value FROM json_each(", $parameter, "))")
    };
}
pub(super) use of_numbers;

/// A list of numbers as one parameter.
pub(super) fn numbers(numbers: &[RowNumber]) -> String {
    // As it is written for people it is JSON.
    format!("{numbers:?}")
}

/// A list of ids as one parameter. Ids hold nothing that JSON would have to escape.
pub(super) fn list<'a>(ids: impl Iterator<Item = &'a str>) -> String {
    let mut out = String::from("[");
    for (index, id) in ids.enumerate() {
        out.push_str(if index == 0 { "\"" } else { ",\"" });
        out.push_str(id);
        out.push('"');
    }
    out.push(']');
    out
}

/// What stands for the id of a recommendation.
pub(super) type RecommendationKey = Vec<u8>;
/// The same as it is read where it may be damaged.
pub(super) type StoredRecommendation = RecommendationKey;

/// What an id of a recommendation is looked for by.
pub(super) fn recommendation_key(id: &str) -> RecommendationKey {
    recommendation_id::to_column(id)
}

/// The id, as it is told where something is wrong.
pub(super) fn recommendation_of(key: &RecommendationKey) -> String {
    match recommendation_id::from_column(key) {
        Ok(id) => id.as_str().to_owned(),
        Err(_) => format!("{key:02x?}"),
    }
}

/// How long the block of a row of `cycle_samples` is.
macro_rules! block_bytes {
    () => {
        "bytes"
    };
}
pub(super) use block_bytes;

/// A failed commit is never tried again: after a failed fsync the pages may be gone.
pub(super) const COMMIT_ATTEMPTS: u32 = 1;

/// Prolongs those of a holder's leases that it has not given back, on a list of machines; also one that has ended, where nobody has taken it
/// since.
pub(super) const RENEW_LEASES: &str = "UPDATE stream_leases SET expires_at_us = $2
     WHERE holder = $1 AND expires_at_us > 0 AND machine_id IN (SELECT value FROM json_each($3))
     RETURNING machine_id, generation";

/// Those of a list of machines whose lease ends after the one time, and not after the other.
pub(super) const LEASED: &str = "SELECT machine_id FROM stream_leases
     WHERE expires_at_us > $1 AND expires_at_us <= $2 AND machine_id IN (SELECT value FROM json_each($3))";

/// Notes when machines were last heard of, out of `[[machine, microseconds], …]`.
pub(super) const NOTE_CONTACTS: &str = "INSERT INTO machine_contacts (machine_id, last_cycle_at_us)
     SELECT json_extract(value, '$[0]'), json_extract(value, '$[1]') FROM json_each($1) WHERE TRUE
     ON CONFLICT (machine_id) DO UPDATE
     SET last_cycle_at_us = MAX(machine_contacts.last_cycle_at_us, excluded.last_cycle_at_us)";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sqlite::plans::plan;

    #[test]
    fn the_next_machine_of_which_samples_are_to_go_is_found_by_keys_alone() {
        assert_eq!(
            plan(NEXT_TO_DROP),
            [
                "SEARCH m USING PRIMARY KEY (machine_id>?)",
                "SEARCH s USING PRIMARY KEY (machine_id=? AND received_at_us<?)",
                "SEARCH d USING PRIMARY KEY (machine_id=?)",
            ]
        );
    }
}

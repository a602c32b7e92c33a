//! What PostgreSQL says differently.

mod assumed;
mod many;
mod schema;

pub(super) use assumed::{Assumption, MAY_ASSUME, assume, begin_assumed, undo, write_assumed};
pub(super) use many::{insert_cycles, insert_recommendations, save_wear, write_rest};
pub(crate) use schema::is_ours;

pub(super) use crate::transfer::damaged_rows::of_postgres as damaged_rows;

use super::{Conn, Writer};
use crate::error::{StoreError, StoreResult};
use crate::locks::Locks;
use crate::record::{RowNumber, StoreFault};
use crate::row_sum::Writers;
use crate::stored_text::StoredText;
use feedwright_core::ids::{CycleId, MachineId};
use feedwright_core::units::Timestamp;
use std::fmt::Write;

/// While several servers are upgraded one by one, those of before register too.
pub(super) const WRITERS: Writers = Writers::BesideOlder;

/// Months for which partitions of samples are kept ready, the present one included.
const MONTHS_AHEAD: i32 = 13;

/// A group asks and writes with one connection.
#[expect(clippy::unnecessary_wraps, reason = "the other engine may have to commit first")]
pub(super) const fn asked(writer: &mut Writer) -> StoreResult<&mut Conn> {
    Ok(writer)
}

/// The beginning of the month (UTC) of a time: by age, samples go with the partition of their month.
pub(super) async fn age_horizon(conn: &mut Conn, at_us: i64) -> StoreResult<i64> {
    Ok(sqlx::query_scalar(
        "SELECT (extract(epoch FROM date_trunc('month', TIMESTAMP 'epoch' + $1 * INTERVAL '1 microsecond'))
                 * 1000000)::BIGINT",
    )
    .bind(at_us)
    .fetch_one(&mut *conn)
    .await?)
}

/// The block of a cycle's samples. Each row by its whole key: the server has the time of receipt before it looks into any
/// partition, and so looks into one; of a join it would have to try all of them.
pub(super) async fn block(
    conn: &mut Conn,
    machine: &MachineId,
    id: &CycleId,
) -> StoreResult<Option<Vec<u8>>> {
    let block = sqlx::query_scalar(
        "SELECT block FROM cycle_samples WHERE machine_id = $1 AND cycle_id = $2
         AND received_at_us = (SELECT received_at_us FROM cycles WHERE machine_id = $1 AND cycle_id = $2)",
    );
    Ok(block.bind(machine.as_str()).bind(id.as_str()).fetch_optional(&mut *conn).await?)
}

/// The same; how long it is no column tells.
pub(super) async fn block_as_told(
    conn: &mut Conn,
    machine: &MachineId,
    id: &CycleId,
) -> StoreResult<Option<(Vec<u8>, Option<i64>)>> {
    Ok(block(conn, machine, id).await?.map(|block| (block, None)))
}

/// How long the block of a row of `cycle_samples` is.
macro_rules! block_bytes {
    () => {
        "CAST(length(block) AS BIGINT)"
    };
}
pub(super) use block_bytes;

/// The rows of one value of a column with which an index begins, which come in the order of that index where they are ordered by the
/// column first. The value stands there twice: of a column that equals one the planner knows that it orders nothing, and that the
/// index of all by their time has them in the same order. It would go through all that others did since a machine stands still.
macro_rules! of_one {
    ($column:literal, $value:literal) => {
        concat!($column, " IN (", $value, ", ", $value, ")")
    };
}
pub(super) use of_one;

/// What stands for the id of a recommendation.
pub(super) type RecommendationKey = String;
/// The same as it is read where it may be damaged.
pub(super) type StoredRecommendation = StoredText;

/// What an id of a recommendation is looked for by.
pub(super) fn recommendation_key(id: &str) -> RecommendationKey {
    id.to_owned()
}

/// The id, as it is told where something is wrong.
pub(super) fn recommendation_of(key: &StoredText) -> String {
    key.to_string()
}

/// A row has its block to itself, and goes with it.
#[expect(clippy::unused_async, reason = "the other engine has packs")]
pub(super) async fn tidy(_conn: &mut Conn) -> StoreResult<bool> {
    Ok(false)
}

/// There are no packs.
#[expect(clippy::unused_async, reason = "the other engine has packs")]
pub(super) async fn stray_packs(_conn: &mut Conn, _most: i64) -> StoreResult<Vec<StoreFault>> {
    Ok(Vec::new())
}

/// Drops the oldest partition that had ended by then and of which nothing is kept; says what it held by machine: cycles and bytes. It waits for no
/// more than a second for whoever uses one, as posts wait behind it, and tries two.
pub(super) async fn drop_partition(
    conn: &mut Conn,
    ended: Timestamp,
) -> StoreResult<Option<Vec<(String, i64, i64)>>> {
    // A month of a plant is looked through; nobody waits for that.
    sqlx::raw_sql("SET LOCAL lock_timeout = '1s'; SET LOCAL statement_timeout = '10min'")
        .execute(&mut *conn)
        .await?;
    lock(conn, &Locks::subject("partitions", "")).await?;
    let held: Vec<(Option<String>, i64, i64)> =
        sqlx::query_as("SELECT machine_id, cycles, bytes FROM cycle_samples_drop_partition($1)")
            .bind(ended.micros())
            .fetch_all(&mut *conn)
            .await?;
    // The row without a machine says that a partition went, which may have been empty.
    let done = !held.is_empty();
    let held = held.into_iter().filter_map(|(machine, cycles, bytes)| Some((machine?, cycles, bytes)));
    Ok(done.then(|| held.collect()))
}

/// The first of so many machines from one on of which samples are left that its newest decision names, and with it all that the others do; and
/// the last that was looked at. One machine at a time: each is one worker's work where Citus distributes the database, which refuses it
/// for a list of them, and elsewhere the server knows by then which partitions it need not look into.
pub(super) async fn next_to_drop(
    conn: &mut Conn,
    from: &str,
    most: i64,
) -> StoreResult<(Option<String>, Option<String>)> {
    let machines: Vec<String> = sqlx::query_scalar(
        "SELECT machine_id FROM machines WHERE machine_id >= $1 ORDER BY machine_id LIMIT $2",
    )
    .bind(from)
    .bind(most)
    .fetch_all(&mut *conn)
    .await?;
    for machine in &machines {
        let is_any: bool = sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM cycle_samples WHERE machine_id = $1 AND received_at_us <
                 (SELECT MAX(before_us) FROM sample_drops WHERE machine_id = $1))",
        )
        .bind(machine)
        .fetch_one(&mut *conn)
        .await?;
        if is_any {
            return Ok((Some(machine.clone()), None));
        }
    }
    Ok((None, machines.last().cloned()))
}

/// What a probe of one row does not see: whether the role may still write what cycles write.
pub(super) async fn may_write(conn: &mut Conn) -> StoreResult<()> {
    let not: Vec<String> = sqlx::query_scalar(
        "SELECT DISTINCT name FROM (VALUES
             ('cycles', 'SELECT'), ('cycles', 'INSERT'), ('cycle_samples', 'SELECT'), ('cycle_samples', 'INSERT'),
             ('cycle_cuts', 'SELECT'), ('cycle_cuts', 'INSERT'), ('cycle_overrides', 'SELECT'), ('cycle_overrides', 'INSERT'), ('cycle_overrides', 'UPDATE'),
             ('tool_wear', 'SELECT'), ('tool_wear', 'INSERT'), ('tool_wear', 'UPDATE'),
             ('tool_wear_checkpoints', 'SELECT'), ('tool_wear_checkpoints', 'INSERT'),
             ('tool_wear_checkpoints', 'UPDATE'), ('tool_wear_checkpoints', 'DELETE'),
             ('tool_checkpoints', 'SELECT'), ('tool_checkpoints', 'INSERT'), ('tool_checkpoints', 'UPDATE'), ('tool_checkpoints', 'DELETE'),
             ('advices', 'SELECT'), ('advices', 'INSERT'), ('recommendations', 'SELECT'), ('recommendations', 'INSERT'),
             ('machine_contacts', 'SELECT'), ('machine_contacts', 'INSERT'), ('machine_contacts', 'UPDATE'), ('alarms', 'SELECT'), ('alarms', 'INSERT'),
             ('alarms', 'UPDATE'), ('quarantine', 'SELECT'), ('quarantine', 'INSERT'), ('quarantine', 'UPDATE'),
             ('quarantine_fill', 'SELECT'), ('quarantine_fill', 'INSERT'), ('quarantine_fill', 'UPDATE')) AS t (name, needed)
         WHERE NOT has_table_privilege(name, needed) OR row_security_active(name)",
    )
    .fetch_all(&mut *conn)
    .await?;
    if not.is_empty() {
        return Ok(());
    }
    Err(StoreError::Unavailable(
        format!("the role may no longer read and write all rows of {}", not.join(", ")).into(),
    ))
}

/// Makes the partitions of the months ahead. Whoever reads samples, as a backup does for as long as it takes, is in the way of that, and
/// every post would wait behind it: it gives up soon, as there are partitions for a year, and is tried again.
pub(super) async fn make_room(conn: &mut Conn, now: Timestamp) -> StoreResult<()> {
    // Behind other servers that make room, which holds up nobody; only then for the table, which everybody who stores waits behind.
    lock(conn, &Locks::subject("partitions", "")).await?;
    sqlx::query("SET LOCAL lock_timeout = '300ms'").execute(&mut *conn).await?;
    sqlx::query("SELECT cycle_samples_make_partitions($1, $2)")
        .bind(now.micros())
        .bind(MONTHS_AHEAD)
        .execute(&mut *conn)
        .await?;
    Ok(())
}

/// Keeps every partition of the samples until the end of the transaction, of which this has to be the first statement: a partition is dropped
/// whatever snapshots others have, whose cycles would be without the samples that it held, and without the decision that they go.
pub(crate) async fn keep_partitions(conn: &mut Conn) -> Result<(), sqlx::Error> {
    sqlx::raw_sql("LOCK TABLE cycle_samples IN ACCESS SHARE MODE").execute(conn).await?;
    Ok(())
}

/// Whether the tables are those that the migrations make; the server checks its own files (`data_checksums`, `amcheck`).
/// What follows reads whole tables, which takes longer than an answer may.
pub(super) async fn integrity(conn: &mut Conn) -> StoreResult<Vec<StoreFault>> {
    sqlx::query("SET LOCAL statement_timeout = 0").execute(&mut *conn).await?;
    schema::faults(conn).await
}

/// Locks names until the end of the transaction: shared ones first, each in ascending order. By one statement, as every group
/// waits for its answer.
pub(super) async fn lock(conn: &mut Conn, locks: &Locks) -> StoreResult<()> {
    sqlx::query(
        "SELECT (SELECT count(pg_advisory_xact_lock_shared(k))
                 FROM (SELECT k FROM unnest($1::BIGINT[]) AS keys (k) ORDER BY k OFFSET 0) AS sorted),
                (SELECT count(pg_advisory_xact_lock(k))
                 FROM (SELECT k FROM unnest($2::BIGINT[]) AS keys (k) ORDER BY k OFFSET 0) AS sorted)",
    )
    .bind(&locks.shared)
    .bind(&locks.exclusive)
    .execute(&mut *conn)
    .await?;
    Ok(())
}

/// The statements that do the same behind those that begin a transaction, in one message with them: shared locks first, each in the order in
/// which they stand there.
pub(super) fn locking(locks: &Locks) -> String {
    let mut sql = String::new();
    for (function, keys) in
        [("pg_advisory_xact_lock_shared", &locks.shared), ("pg_advisory_xact_lock", &locks.exclusive)]
    {
        for (index, key) in keys.iter().enumerate() {
            let before = if index == 0 {
                format!("; SELECT count({function}(k)) FROM (VALUES ")
            } else {
                ", ".to_owned()
            };
            // Infallible: into memory.
            let _ = write!(sql, "{before}({key})");
        }
        if !keys.is_empty() {
            sql.push_str(") AS keys (k)");
        }
    }
    sql
}

/// Says, until the transaction ends, that it adds a row to a table whose number is above all that are seen now. It keeps nobody out:
/// rows are numbered in the order in which their numbers are drawn, and seen in that in which they are committed.
macro_rules! says_it_adds {
    ($table:literal, $number:literal) => {
        concat!(
            "SELECT pg_advisory_xact_lock_shared('",
            $table,
            "'::REGCLASS::OID::INTEGER,
                 LEAST((SELECT COALESCE(MAX(",
            $number,
            "), 0) FROM ",
            $table,
            "), 2147483647)::INTEGER)"
        )
    };
}

/// The last number of a table before which no row is open: what is committed up to it is all that there will be. Two statements in this
/// order: whatever has a number up to the one that is seen has drawn it, and says so or is committed when it is asked next.
macro_rules! last_settled {
    ($conn:expr, $table:literal, $number:literal) => {{
        let seen: i64 = sqlx::query_scalar(concat!("SELECT COALESCE(MAX(", $number, "), 0) FROM ", $table))
            .fetch_one(&mut *$conn)
            .await?;
        let open: Option<i64> = sqlx::query_scalar(concat!(
            "SELECT MIN(objid::BIGINT) FROM pg_locks WHERE locktype = 'advisory' AND objsubid = 2
                 AND classid = '",
            $table,
            "'::REGCLASS::OID
                 AND database = (SELECT oid FROM pg_database WHERE datname = current_database())"
        ))
        .fetch_one(&mut *$conn)
        .await?;
        Ok(open.map_or(seen, |before| before.min(seen)))
    }};
}

/// Says that the transaction adds a line to the audit.
pub(super) async fn begin_audit_line(conn: &mut Conn) -> StoreResult<()> {
    sqlx::query(says_it_adds!("audit", "audit_id")).execute(&mut *conn).await?;
    Ok(())
}

/// The last line of the audit before which none is open.
pub(super) async fn last_audit_line(conn: &mut Conn) -> StoreResult<RowNumber> {
    last_settled!(conn, "audit", "audit_id")
}

/// The first alarm that a transaction raises, as `AlarmChange::RAISE`: it says before it draws its number, by the same statement, as
/// groups raise some, that the transaction adds alarms. Those that follow in the transaction have higher numbers.
pub(super) const RAISE_FIRST: &str = concat!(
    "INSERT INTO alarms (kind, machine_id, tool_id, message, raised_at_us)
     SELECT CAST($1 AS TEXT), CAST($2 AS TEXT), CAST($3 AS TEXT), CAST($4 AS TEXT), CAST($5 AS BIGINT)
     FROM (",
    says_it_adds!("alarms", "alarm_id"),
    " OFFSET 0) AS said
     ON CONFLICT (kind, COALESCE(tool_id, ''), COALESCE(machine_id, '')) WHERE cleared_at_us IS NULL DO NOTHING"
);

/// The last alarm before which none is open.
pub(super) async fn last_alarm(conn: &mut Conn) -> StoreResult<RowNumber> {
    last_settled!(conn, "alarms", "alarm_id")
}

/// Has texts come as they are stored until the transaction ends: of a database in SQL_ASCII the server else gives none that does not decode,
/// nor what stands beside it. One in UTF8 asks what it is given, and not what it gives.
pub(super) async fn read_as_stored(conn: &mut Conn) -> StoreResult<()> {
    sqlx::query("SET LOCAL client_encoding = 'SQL_ASCII'").execute(&mut *conn).await?;
    Ok(())
}

/// A tool's caches. The tool's name is locked by then: rows of several machines stand on several nodes where the
/// database is distributed, and cannot be locked together there.
pub(super) const WEAR_OF_TOOL_LOCKED: &str =
    "SELECT machine_id, folded, fold_version, state, version, judging_change, ran FROM tool_wear
     WHERE tool_id = $1 ORDER BY machine_id";

/// A column that rows are held against. The planner knows how long histories are, and Citus asks the machine's node alone.
macro_rules! checked {
    ($column:literal) => {
        $column
    };
}
pub(super) use checked;

/// Whether what is read of several machines is of one moment. Where Citus distributes the database, a worker may show a commit later
/// than it was told: a state over all machines would have left out what then comes before it.
macro_rules! at_one_moment {
    () => {
        "to_regclass('pg_dist_partition') IS NULL"
    };
}
pub(super) use at_one_moment;

/// Which server answers: one that has taken over was started at another time, as is one that was started again. Anybody may ask that,
/// of any server, also of one that only reads.
macro_rules! server {
    () => {
        "CAST(EXTRACT(EPOCH FROM pg_postmaster_start_time()) * 1000000 AS BIGINT)"
    };
}
pub(super) use server;

/// Which database of which server answers, and which life of it: one that was dropped and made again from a dump, or whose tables were
/// emptied, may come to generations and versions that it had before, of other rows.
macro_rules! incarnation {
    () => {
        "hashtextextended(concat_ws(' ', pg_postmaster_start_time(),
             (SELECT oid FROM pg_database WHERE datname = current_database()),
             'registry_generation'::regclass::oid, pg_relation_filenode('registry_generation'::regclass)), 0)"
    };
}
pub(super) use incarnation;

/// The generation of the registry, which database answers, whether the database is one that Citus distributes, and whether any feed
/// profile is active, under empty names of a tool, and the versions of the folds of a list of tools. The tools' names are locked by then.
pub(super) const HEADS: &str = concat!(
    "SELECT '' AS tool_id, '' AS machine_id, CAST(SUM(changes) AS BIGINT) AS version
     FROM registry_generation
     UNION ALL SELECT '', 'server', ",
    incarnation!(),
    " UNION ALL SELECT '', 'distributed', CASE WHEN to_regclass('pg_dist_partition') IS NULL THEN 0::BIGINT ELSE 1::BIGINT END
     UNION ALL SELECT '', 'profiles', CAST(COUNT(*) AS BIGINT)
     FROM (SELECT 1 FROM feed_profiles WHERE active_version IS NOT NULL LIMIT 1) AS active
     UNION ALL SELECT tool_id, machine_id, version FROM tool_wear WHERE tool_id = ANY($1)"
);

/// Those of a list of a machine's cycles whose samples were dropped by name.
pub(super) const NAMED_DROPS: &str = "SELECT cycle_id, dropped_at_us, reason FROM cycle_sample_drops
     WHERE machine_id = $1 AND cycle_id = ANY($2)";

/// Whether a number is one of a list, which is one parameter.
macro_rules! of_numbers {
    ($parameter:literal) => {
        concat!("= ANY(", $parameter, ")")
    };
}
pub(super) use of_numbers;

/// A list of numbers as one parameter.
pub(super) const fn numbers(numbers: &[RowNumber]) -> &[RowNumber] {
    numbers
}

/// A list of ids as one parameter.
pub(super) fn list<'a>(ids: impl Iterator<Item = &'a str>) -> Vec<String> {
    ids.map(str::to_owned).collect()
}

/// A lost connection, a restart or a deadlock's victim: the second attempt finds by key what the first one kept.
pub(super) const COMMIT_ATTEMPTS: u32 = 3;

/// Prolongs those of a holder's leases that it has not given back, on a list of machines; also one that has ended, as while the database was
/// away, where nobody has taken it since. By one statement over several rows, which wait
/// for no more than a stream that is opened or ends.
pub(super) const RENEW_LEASES: &str = "UPDATE stream_leases SET expires_at_us = $2
     WHERE holder = $1 AND expires_at_us > 0 AND machine_id = ANY($3)
     RETURNING machine_id, generation";

/// Those of a list of machines whose lease ends after the one time, and not after the other.
pub(super) const LEASED: &str = "SELECT machine_id FROM stream_leases
     WHERE expires_at_us > $1 AND expires_at_us <= $2 AND machine_id = ANY($3)";

/// The server's clock as it is at this moment, µs, and not as it was when the transaction began.
pub(super) async fn clock(conn: &mut Conn) -> StoreResult<Timestamp> {
    let now_us = sqlx::query_scalar("SELECT CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000000 AS BIGINT)");
    Ok(Timestamp::from_micros(now_us.fetch_one(&mut *conn).await?))
}

/// Notes when machines were last heard of, out of `[[machine, microseconds], …]`, in the order of their keys.
pub(super) const NOTE_CONTACTS: &str = "INSERT INTO machine_contacts (machine_id, last_cycle_at_us)
     SELECT heard.value->>0, (heard.value->>1)::BIGINT FROM jsonb_array_elements($1::JSONB) AS heard (value)
     ORDER BY 1
     ON CONFLICT (machine_id) DO UPDATE
     SET last_cycle_at_us = GREATEST(machine_contacts.last_cycle_at_us, excluded.last_cycle_at_us)";

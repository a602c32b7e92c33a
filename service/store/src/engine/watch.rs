//! What a watchman finds on his round: who was heard of, who is silent, how full the quarantine is, what alarms.
//!
//! A round is one transaction. Silence and a quarantine that fills up are the two alarms that no event raises, so the
//! round raises and clears them. `now` is one clock's for all servers on the database, and never earlier than it was for the
//! round before: who is silent does not depend on who asks.

use super::{CLOCK_AHEAD_US, Conn, Db, alarms, dialect, quarantine};
use crate::error::StoreResult;
use crate::past;
use crate::record::{
    AlarmKind, MachineContact, OpenAlarms, QuarantineBounds, QuarantineFill, Round, WatchSettings,
};
use crate::rows::{AlarmChange, id, number, word};
use feedwright_core::ids::MachineId;
use feedwright_core::units::Timestamp;
use serde_json::json;
use std::time::Duration;

/// Machines that are read at a time: a round looks at all of them.
const MACHINES_PAGE: i64 = 1_000;
/// The quarantine's alarm is cleared when it has emptied to this share of the share that raised it.
const CLEARED_AT: f64 = 0.8;

#[derive(sqlx::FromRow)]
struct ContactRow {
    machine_id: String,
    last_cycle_at_us: Option<i64>,
    silent_since_us: Option<i64>,
}

pub(super) async fn round(
    conn: &mut Conn,
    heard: &[(MachineId, Duration)],
    settings: &WatchSettings,
    now: Timestamp,
) -> StoreResult<Round> {
    if past::may_be_right(now) {
        bring_back(conn, now).await?;
    }
    note(conn, heard, now).await?;
    let machines = silence(conn, settings, now).await?;
    let quarantine = filled(conn, settings, now).await?;
    let alarms = open_alarms(conn).await?;
    Ok(Round { machines, quarantine, alarms, last_backup_at: last_backup(conn).await? })
}

async fn last_backup(conn: &mut Conn) -> StoreResult<Option<Timestamp>> {
    let made_at: Option<i64> =
        sqlx::query_scalar::<Db, _>("SELECT made_at_us FROM last_backup").fetch_optional(&mut *conn).await?;
    Ok(made_at.map(Timestamp::from_micros))
}

/// Brings back what a clock that was ahead has noted: the machine would not be silent until that time has come. When it was
/// last heard of is not known any more, but not later than now.
async fn bring_back(conn: &mut Conn, now: Timestamp) -> StoreResult<()> {
    sqlx::query::<Db>("UPDATE machine_contacts SET last_cycle_at_us = $1 WHERE last_cycle_at_us > $2")
        .bind(now.micros())
        .bind(now.micros().saturating_add(CLOCK_AHEAD_US))
        .execute(&mut *conn)
        .await?;
    Ok(())
}

/// Notes how long before now this server heard of machines: when that was by its own clock tells others nothing.
async fn note(conn: &mut Conn, heard: &[(MachineId, Duration)], now: Timestamp) -> StoreResult<()> {
    if heard.is_empty() {
        return Ok(());
    }
    let at = |ago: &Duration| now.micros().saturating_sub(i64::try_from(ago.as_micros()).unwrap_or(i64::MAX));
    let heard: Vec<_> = heard.iter().map(|(machine, ago)| (machine.as_str(), at(ago))).collect();
    sqlx::query::<Db>(dialect::NOTE_CONTACTS).bind(json!(heard).to_string()).execute(&mut *conn).await?;
    Ok(())
}

const CONTACTS: &str = "SELECT m.machine_id, c.last_cycle_at_us, a.raised_at_us AS silent_since_us
     FROM machines m
     LEFT JOIN machine_contacts c ON c.machine_id = m.machine_id
     LEFT JOIN alarms a ON a.machine_id = m.machine_id AND a.kind = 'machine_silent' AND a.tool_id IS NULL
         AND a.cleared_at_us IS NULL
     WHERE m.machine_id > $1
     ORDER BY m.machine_id LIMIT $2";

/// Every machine with when it was last heard of; a machine that never sent a cycle is not silent.
async fn silence(
    conn: &mut Conn,
    settings: &WatchSettings,
    now: Timestamp,
) -> StoreResult<Vec<MachineContact>> {
    let (mut machines, mut raised, mut after) = (Vec::new(), Vec::new(), String::new());
    loop {
        let rows: Vec<ContactRow> =
            sqlx::query_as::<Db, _>(CONTACTS).bind(&after).bind(MACHINES_PAGE).fetch_all(&mut *conn).await?;
        let Some(last) = rows.last() else { break };
        after.clone_from(&last.machine_id);
        for row in rows {
            let machine: MachineId = id("machine_id", &row.machine_id)?;
            let last_cycle_at = row.last_cycle_at_us.map(Timestamp::from_micros);
            let limit = settings.silent_after_ms(&machine);
            let is_silent =
                last_cycle_at.zip(limit).is_some_and(|(last, limit)| now.millis_since(last) > limit);
            match (is_silent, row.silent_since_us, limit) {
                (true, None, Some(limit)) => {
                    let message = format!("machine {machine}: no cycle for more than {}", minutes(limit));
                    raised.push(AlarmChange::raise(AlarmKind::MachineSilent, Some(&machine), None, message));
                }
                (false, Some(_), _) => {
                    alarms::clear_of_machine(conn, AlarmKind::MachineSilent, &machine, now).await?;
                }
                _ => {}
            }
            machines.push(MachineContact { machine, last_cycle_at, silent_after_ms: limit, is_silent });
        }
    }
    alarms::apply(conn, &raised, now).await?;
    Ok(machines)
}

fn minutes(ms: i64) -> String {
    if ms % 60_000 == 0 { format!("{} min", ms / 60_000) } else { format!("{} s", ms / 1000) }
}

async fn filled(conn: &mut Conn, settings: &WatchSettings, now: Timestamp) -> StoreResult<QuarantineFill> {
    let (entries, bytes) = quarantine::count_filled(conn).await?;
    let fill = QuarantineFill {
        entries: number("entries", entries)?,
        bytes: number("bytes", bytes)?,
        bounds: settings.quarantine,
    };
    let ratio = fill.ratio();
    if ratio >= settings.quarantine_warning_ratio {
        let QuarantineBounds { entries, bytes } = settings.quarantine;
        let message = format!(
            "the quarantine is filled to {:.0} % ({} of {entries} entries, {} of {bytes} bytes): settle entries \
             before it is full and machines have to keep their cycles",
            ratio * 100.0,
            fill.entries,
            fill.bytes
        );
        alarms::raise(conn, AlarmKind::Quarantine, None, None, &message, now).await?;
    } else if ratio < CLEARED_AT * settings.quarantine_warning_ratio {
        alarms::clear_of_shop(conn, AlarmKind::Quarantine, now).await?;
    }
    Ok(fill)
}

async fn open_alarms(conn: &mut Conn) -> StoreResult<Vec<OpenAlarms>> {
    let rows: Vec<(String, Option<String>, i64)> = sqlx::query_as::<Db, _>(
        "SELECT kind, machine_id, COUNT(*) FROM alarms WHERE cleared_at_us IS NULL
         GROUP BY kind, machine_id ORDER BY kind, machine_id",
    )
    .fetch_all(&mut *conn)
    .await?;
    let alarms = rows.iter().map(|(kind, machine, open)| {
        Ok(OpenAlarms {
            kind: word("kind", kind, AlarmKind::parse)?,
            machine: machine.as_deref().map(|machine| id("machine_id", machine)).transpose()?,
            open: number("count", *open)?,
        })
    });
    alarms.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sqlite::plans::plan;

    #[test]
    fn a_round_finds_what_stands_of_each_machine_by_keys() {
        let steps = [
            "SEARCH m USING PRIMARY KEY (machine_id>?)",
            "SEARCH c USING PRIMARY KEY (machine_id=?) LEFT-JOIN",
            "SEARCH a USING INDEX alarms_open_by_machine (machine_id=?) LEFT-JOIN",
        ];
        assert_eq!(plan(CONTACTS), steps);
    }
}

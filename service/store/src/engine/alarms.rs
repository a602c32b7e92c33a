//! Alarms: raised and cleared in the transaction of what they tell of.
//!
//! Worn, broken suspected and conditions changed follow the verdict on the tool: raised with it and cleared with it. They are
//! raised on the machine that ran the tool last, by the beginnings of its cycles; as it moves, on one after the other.
//! An overload stays open until someone acknowledges it, whatever runs later: a crash is looked at, not outrun.
//! A machine's quarantine alarm is open as long as an entry of it is unsettled. Silence, and a quarantine that fills up
//! (an alarm of no machine), are raised and cleared by the round in `watch`.

use super::{Conn, Db, audit, dialect};
use crate::error::StoreResult;
use crate::record::{Actor, Alarm, AlarmFilter, AlarmKind, OpenSums, Page, RowNumber};
use crate::rows::{AlarmChange, AlarmRow, id, word};
use feedwright_core::ids::{MachineId, ToolId};
use feedwright_core::units::Timestamp;
use feedwright_core::wear::{ToolState, Verdict};
use serde_json::json;

macro_rules! select {
    ($tail:expr) => {
        concat!(
            "SELECT alarm_id, kind, machine_id, tool_id, message, raised_at_us, cleared_at_us, acknowledged_by,
                    acknowledged_at_us
             FROM alarms ",
            $tail
        )
    };
}

macro_rules! page {
    ($which:expr, $number:literal) => {
        select!(concat!(
            "WHERE ",
            $which,
            $number,
            " > $1 AND ",
            $number,
            " <= $2 ORDER BY ",
            $number,
            " LIMIT $3"
        ))
    };
}

/// Statements with an index each: of all alarms, of those that are open, and of those that are cleared.
type Pages = [&'static str; 3];

macro_rules! pages {
    ($whose:literal) => {
        [
            page!($whose, "alarm_id"),
            page!(concat!($whose, "cleared_at_us IS NULL AND "), "alarm_id"),
            page!(concat!($whose, "cleared_at_us IS NOT NULL AND "), "alarm_id"),
        ]
    };
}

const OF_ANY: Pages = [
    page!("", "alarm_id"),
    // By the plain number an engine may go through all that ever were, as they are in order.
    page!("cleared_at_us IS NULL AND ", "alarm_id + 0"),
    page!("cleared_at_us IS NOT NULL AND ", "alarm_id"),
];
const OF_MACHINE: Pages = pages!("machine_id = $4 AND ");
const OF_TOOL: Pages = pages!("tool_id = $4 AND ");
const OF_BOTH: Pages = pages!("machine_id = $4 AND tool_id = $5 AND ");

/// By the index that allows one open alarm of a kind for one subject: neither what else is open of the machine nor what ever was is
/// gone through. A planner that has figures may take the machine's open ones where these are fewer. Without an order, for whose sake an
/// engine might take another index.
const OPEN_OVERLOADS: &str = concat!(
    "SELECT alarm_id FROM alarms
     WHERE kind = 'overload' AND COALESCE(machine_id, '') = $1 AND ",
    dialect::checked!("machine_id"),
    " = $1 AND cleared_at_us IS NULL AND acknowledged_by IS NULL"
);

/// All open ones as sums, which their one index tells, and the newest of all. The remainder keeps the sum of millions in its range.
const OPEN_SUMS: &str = "SELECT (SELECT COALESCE(MAX(alarm_id), 0) FROM alarms), COUNT(*), CAST(COALESCE(SUM(alarm_id), 0) AS BIGINT),
            CAST(COALESCE(SUM((alarm_id % 1000003) * (alarm_id % 1000003)), 0) AS BIGINT), COUNT(acknowledged_by)
     FROM alarms WHERE cleared_at_us IS NULL AND alarm_id + 0 > $1";

const OPEN_NUMBERS: &str = "SELECT alarm_id, acknowledged_by IS NOT NULL FROM alarms
     WHERE cleared_at_us IS NULL AND alarm_id + 0 > $1 ORDER BY alarm_id + 0 LIMIT $2";

const NUMBERED: &str = select!(concat!("WHERE alarm_id ", dialect::of_numbers!("$1"), " ORDER BY alarm_id"));

const OPEN_OF_TOOL: &str = "SELECT kind, machine_id FROM alarms
     WHERE tool_id = $1 AND cleared_at_us IS NULL AND kind IN ('worn', 'broken_suspected', 'conditions_changed')";

const fn kind_of(state: ToolState) -> Option<AlarmKind> {
    match state {
        ToolState::Worn => Some(AlarmKind::Worn),
        ToolState::BrokenSuspected => Some(AlarmKind::BrokenSuspected),
        ToolState::Changed => Some(AlarmKind::ConditionsChanged),
        ToolState::Unknown | ToolState::Learning | ToolState::Good | ToolState::Warning => None,
    }
}

/// An open alarm of a tool: its kind, and the machine that ran the tool.
pub(super) type Open = (AlarmKind, Option<MachineId>);

/// What a verdict changes of its tool's open alarms: what it calls for is raised where the tool ran last, what it no longer does is
/// cleared. `open` are those that are open, and are to be when that is written.
pub(super) fn changes(tool: &ToolId, verdict: &Verdict, open: &mut Vec<Open>) -> Vec<AlarmChange> {
    let wanted = kind_of(verdict.state);
    let mut changes = Vec::new();
    let before = open.len();
    open.retain(|(kind, _)| Some(*kind) == wanted);
    if open.len() < before {
        let but = wanted.map(AlarmKind::as_str);
        changes.push(AlarmChange::ClearVerdicts { tool_id: tool.as_str().to_owned(), but });
    }
    let machine = verdict.last.as_ref().map(|last| &last.machine);
    if let Some(kind) = wanted
        && !open.iter().any(|(_, there)| there.as_ref() == machine)
    {
        // What decides is said last.
        let message = match verdict.reasons.last() {
            Some((_, why)) => format!("tool {tool}: {why}"),
            None => format!("tool {tool}: {}", kind.as_str()),
        };
        changes.push(AlarmChange::raise(kind, machine, Some(tool), message));
        open.push((kind, machine.cloned()));
    }
    changes
}

/// Raises what the verdict on a tool calls for and clears what it no longer does.
pub(super) async fn follow_verdict(
    conn: &mut Conn,
    tool: &ToolId,
    verdict: &Verdict,
    now: Timestamp,
) -> StoreResult<()> {
    // What it comes to is not known yet: who folds its cycles again comes here with it.
    if verdict.is_being_counted() {
        return Ok(());
    }
    let mut open = open_of(conn, tool).await?;
    apply(conn, &changes(tool, verdict, &mut open), now).await
}

/// A tool's open alarms that follow its verdict.
pub(super) async fn open_of(conn: &mut Conn, tool: &ToolId) -> StoreResult<Vec<Open>> {
    let open: Vec<(String, Option<String>)> =
        sqlx::query_as::<Db, _>(OPEN_OF_TOOL).bind(tool.as_str()).fetch_all(&mut *conn).await?;
    let open = open.into_iter().map(|(kind, machine)| {
        let machine = machine.map(|machine| id("machine_id", &machine)).transpose()?;
        Ok((word("kind", &kind, AlarmKind::parse)?, machine))
    });
    open.collect()
}

/// Makes changes. Those of one transaction are best made at once: the first alarm of them says that there are some.
pub(super) async fn apply(conn: &mut Conn, changes: &[AlarmChange], now: Timestamp) -> StoreResult<()> {
    let mut raise = dialect::RAISE_FIRST;
    for change in changes {
        let query = match change {
            AlarmChange::ClearVerdicts { tool_id, but } => {
                sqlx::query::<Db>(AlarmChange::CLEAR_VERDICTS).bind(now.micros()).bind(tool_id).bind(*but)
            }
            AlarmChange::Raise { kind, machine_id, tool_id, message } => {
                sqlx::query::<Db>(std::mem::replace(&mut raise, AlarmChange::RAISE))
                    .bind(*kind)
                    .bind(machine_id)
                    .bind(tool_id)
                    .bind(message)
                    .bind(now.micros())
            }
        };
        query.execute(&mut *conn).await?;
    }
    Ok(())
}

/// Raises an alarm unless one of its kind is open for the same subject.
pub(super) async fn raise(
    conn: &mut Conn,
    kind: AlarmKind,
    machine: Option<&MachineId>,
    tool: Option<&ToolId>,
    message: &str,
    now: Timestamp,
) -> StoreResult<()> {
    apply(conn, &[AlarmChange::raise(kind, machine, tool, message.to_owned())], now).await
}

/// Clears a machine's open alarm of a kind that concerns no tool.
pub(super) async fn clear_of_machine(
    conn: &mut Conn,
    kind: AlarmKind,
    machine: &MachineId,
    now: Timestamp,
) -> StoreResult<()> {
    sqlx::query::<Db>(
        "UPDATE alarms SET cleared_at_us = $3
         WHERE kind = $1 AND machine_id = $2 AND tool_id IS NULL AND cleared_at_us IS NULL",
    )
    .bind(kind.as_str())
    .bind(machine.as_str())
    .bind(now.micros())
    .execute(&mut *conn)
    .await?;
    Ok(())
}

/// Clears the open alarm of a kind that concerns neither a machine nor a tool.
pub(super) async fn clear_of_shop(conn: &mut Conn, kind: AlarmKind, now: Timestamp) -> StoreResult<()> {
    sqlx::query::<Db>(
        "UPDATE alarms SET cleared_at_us = $2
         WHERE kind = $1 AND machine_id IS NULL AND tool_id IS NULL AND cleared_at_us IS NULL",
    )
    .bind(kind.as_str())
    .bind(now.micros())
    .execute(&mut *conn)
    .await?;
    Ok(())
}

async fn get(conn: &mut Conn, id: RowNumber) -> StoreResult<Option<Alarm>> {
    let row: Option<AlarmRow> =
        sqlx::query_as::<Db, _>(select!("WHERE alarm_id = $1")).bind(id).fetch_optional(&mut *conn).await?;
    row.map(|row| row.alarm()).transpose()
}

/// Acknowledges an alarm once: a second time leaves the first name. An overload is cleared with it.
pub(super) async fn acknowledge(
    conn: &mut Conn,
    id: RowNumber,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<Option<Alarm>> {
    let done = sqlx::query::<Db>(
        "UPDATE alarms SET acknowledged_by = $2, acknowledged_at_us = $3,
             cleared_at_us = CASE WHEN kind = 'overload' THEN COALESCE(cleared_at_us, $3) ELSE cleared_at_us END
         WHERE alarm_id = $1 AND acknowledged_by IS NULL",
    )
    .bind(id)
    .bind(&actor.token)
    .bind(now.micros())
    .execute(&mut *conn)
    .await?;
    let alarm = get(conn, id).await?;
    if let Some(alarm) = &alarm
        && done.rows_affected() == 1
    {
        let detail = json!({ "kind": alarm.kind.as_str() });
        audit::add(conn, actor, now, "alarm.acknowledge", format!("alarm/{id}"), &detail).await?;
    }
    Ok(alarm)
}

/// In the order of their numbers, up to `last`.
pub(super) async fn list(
    conn: &mut Conn,
    filter: &AlarmFilter,
    page: &Page<RowNumber>,
    last: RowNumber,
) -> StoreResult<Vec<Alarm>> {
    let (machine, tool) = (filter.machine.as_ref(), filter.tool.as_ref());
    let [all, open, cleared] = match (machine, tool) {
        (None, None) => OF_ANY,
        (Some(_), None) => OF_MACHINE,
        (None, Some(_)) => OF_TOOL,
        (Some(_), Some(_)) => OF_BOTH,
    };
    let sql = match filter.open {
        None => all,
        Some(true) => open,
        Some(false) => cleared,
    };
    let mut query = sqlx::query_as::<Db, AlarmRow>(sql)
        .bind(page.after.unwrap_or(i64::MIN))
        .bind(last)
        .bind(i64::from(page.limit));
    if let Some(machine) = machine {
        query = query.bind(machine.as_str());
    }
    if let Some(tool) = tool {
        query = query.bind(tool.as_str());
    }
    let rows = query.fetch_all(&mut *conn).await?;
    rows.iter().map(AlarmRow::alarm).collect()
}

/// The overloads of a machine that are open and that nobody has acknowledged, in the order of their numbers.
pub(super) async fn open_overloads(conn: &mut Conn, machine: &MachineId) -> StoreResult<Vec<RowNumber>> {
    let mut found: Vec<RowNumber> =
        sqlx::query_scalar::<Db, _>(OPEN_OVERLOADS).bind(machine.as_str()).fetch_all(&mut *conn).await?;
    found.sort_unstable();
    Ok(found)
}

/// The newest alarm's number, 0 where there is none, and the sums of those that are open.
pub(super) async fn open_sums(conn: &mut Conn) -> StoreResult<(RowNumber, OpenSums)> {
    let (newest, open, numbers, squares, acknowledged) =
        sqlx::query_as::<Db, (i64, i64, i64, i64, i64)>(OPEN_SUMS)
            .bind(i64::MIN)
            .fetch_one(&mut *conn)
            .await?;
    Ok((newest, OpenSums { open, numbers, squares, acknowledged }))
}

/// The numbers of those that are open, in their order, each with whether it was acknowledged.
pub(super) async fn open_numbers(
    conn: &mut Conn,
    page: &Page<RowNumber>,
) -> StoreResult<Vec<(RowNumber, bool)>> {
    let query = sqlx::query_as::<Db, (RowNumber, bool)>(OPEN_NUMBERS);
    let query = query.bind(page.after.unwrap_or(i64::MIN)).bind(i64::from(page.limit));
    Ok(query.fetch_all(&mut *conn).await?)
}

/// Those of a list of numbers that there are, in the order of their numbers.
pub(super) async fn numbered(conn: &mut Conn, numbers: &[RowNumber]) -> StoreResult<Vec<Alarm>> {
    let query = sqlx::query_as::<Db, AlarmRow>(NUMBERED).bind(dialect::numbers(numbers));
    let rows = query.fetch_all(&mut *conn).await?;
    rows.iter().map(AlarmRow::alarm).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sqlite::plans::plan;
    use feedwright_core::wear::OrderKey;

    #[test]
    fn each_filter_has_an_index_of_its_own() {
        let by = [
            (
                OF_ANY,
                [
                    "INTEGER PRIMARY KEY (rowid>? AND rowid<?)",
                    "INDEX alarms_open_by_number (<expr>>? AND <expr><?)",
                ],
            ),
            (
                OF_MACHINE,
                [
                    "INDEX alarms_by_machine (machine_id=? AND alarm_id>? AND alarm_id<?)",
                    "INDEX alarms_open_by_machine (machine_id=? AND alarm_id>? AND alarm_id<?)",
                ],
            ),
            (
                OF_TOOL,
                [
                    "INDEX alarms_by_tool (tool_id=? AND alarm_id>? AND alarm_id<?)",
                    "INDEX alarms_open_by_tool (tool_id=? AND alarm_id>? AND alarm_id<?)",
                ],
            ),
            (
                OF_BOTH,
                [
                    "INDEX alarms_by_tool (tool_id=? AND alarm_id>? AND alarm_id<?)",
                    "INDEX alarms_open_by_tool (tool_id=? AND alarm_id>? AND alarm_id<?)",
                ],
            ),
        ];
        for ([all, open, cleared], [of_all, of_open]) in by {
            for (sql, by) in [(all, of_all), (open, of_open), (cleared, of_all)] {
                assert_eq!(plan(sql), [format!("SEARCH alarms USING {by}")], "{sql}");
            }
        }
        let open_of = "SEARCH alarms USING INDEX alarms_open_by_tool (tool_id=?)";
        for sql in [OPEN_OF_TOOL, AlarmChange::CLEAR_VERDICTS] {
            assert_eq!(plan(sql), [open_of], "{sql}");
        }
    }

    /// Whatever else is open, or was.
    #[test]
    fn open_overloads_and_all_open_ones_are_found_among_open_ones_alone() {
        // As the engine asks that keeps no figures.
        let overloads = OPEN_OVERLOADS.replace("AND machine_id", "AND +machine_id");
        assert_eq!(plan(&overloads), ["SEARCH alarms USING INDEX alarms_open (kind=?)"]);
        let by_number = "SEARCH alarms USING INDEX alarms_open_by_number (<expr>>?)";
        assert_eq!(plan(OPEN_NUMBERS), [by_number]);
        assert!(OPEN_SUMS.contains(&format!("(alarm_id % {0}) * (alarm_id % {0})", OpenSums::MODULUS)));
        let sums = plan(OPEN_SUMS);
        assert_eq!(sums[0], by_number, "{sums:?}");
        // Its end is looked up, and not looked for.
        assert_eq!(sums[1], "SEARCH alarms", "{sums:?}");
    }

    fn verdict(state: ToolState) -> Verdict {
        let mut verdict = Verdict::unknown("masked_by_feed", "said first");
        verdict.state = state;
        verdict.reasons.push(("decides", "said last".to_owned()));
        verdict
    }

    #[test]
    fn a_verdict_clears_what_it_does_not_call_for_and_tells_what_decides() {
        let tool = ToolId::try_from("T1").unwrap();
        let mut open = Vec::new();
        let nowhere = |kind| vec![(kind, None)];
        let raised = changes(&tool, &verdict(ToolState::Worn), &mut open);
        let [AlarmChange::Raise { kind: "worn", message, .. }] = &raised[..] else { panic!("{raised:?}") };
        assert_eq!(message, "tool T1: said last");
        assert_eq!(open, nowhere(AlarmKind::Worn));
        assert!(changes(&tool, &verdict(ToolState::Worn), &mut open).is_empty());

        let changed = changes(&tool, &verdict(ToolState::Changed), &mut open);
        let [AlarmChange::ClearVerdicts { but: Some("conditions_changed"), .. }, AlarmChange::Raise { .. }] =
            &changed[..]
        else {
            panic!("{changed:?}")
        };
        assert_eq!(open, nowhere(AlarmKind::ConditionsChanged));

        let good = changes(&tool, &verdict(ToolState::Good), &mut open);
        assert!(matches!(&good[..], [AlarmChange::ClearVerdicts { but: None, .. }]), "{good:?}");
        assert!(open.is_empty());
        assert!(changes(&tool, &verdict(ToolState::Good), &mut open).is_empty());

        // Two stand of which one is called for: it is not raised again.
        let mut both = [AlarmKind::Worn, AlarmKind::BrokenSuspected].map(|kind| (kind, None)).to_vec();
        let cleared = changes(&tool, &verdict(ToolState::BrokenSuspected), &mut both);
        assert!(matches!(&cleared[..], [AlarmChange::ClearVerdicts { but: Some("broken_suspected"), .. }]));
        assert_eq!(both, nowhere(AlarmKind::BrokenSuspected));

        // The tool has come to a machine, and then to another one.
        for (machine, raised) in [("M1", true), ("M1", false), ("M2", true), ("M1", false)] {
            let mut worn = verdict(ToolState::BrokenSuspected);
            let (machine, cycle) = (MachineId::try_from(machine).unwrap(), "c1".try_into().unwrap());
            worn.last = Some(OrderKey { started_at: Timestamp::from_micros(0), machine, seq: None, cycle });
            assert_eq!(changes(&tool, &worn, &mut both).len(), usize::from(raised), "{both:?}");
        }
        assert_eq!(both.len(), 3);
        let good = changes(&tool, &verdict(ToolState::Good), &mut both);
        assert!(matches!(&good[..], [AlarmChange::ClearVerdicts { but: None, .. }]), "{good:?}");
    }
}

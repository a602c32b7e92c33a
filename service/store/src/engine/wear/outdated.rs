//! Which folds are behind a change of an operation, or of the rules, and which operations their cycles ran.

use super::{BEGINNING, BEHIND, Budget, Conn, Db, END, ToolWear, dialect, operations};
use crate::codec::ran::Ran;
use crate::error::StoreResult;
use crate::record::{FoldKey, Renewed};
use crate::rows::{FactsRow, Place, id, number};
use feedwright_core::ids::{MachineId, ToolId};
use feedwright_core::units::Timestamp;
use feedwright_core::wear::{FOLD_VERSION, Verdict};
use std::collections::BTreeMap;

/// What is noted of the operations that a fold's cycles ran, where it is of as many cycles as the fold: a server of before counts
/// cycles and notes nothing.
pub(super) fn ran_of(noted: Option<&[u8]>, folded: u64) -> Option<Ran> {
    Ran::from_bytes(noted?, folded)
}

/// Notes the operation of a cycle that is counted.
pub(super) fn note_ran(ran: &mut Option<Ran>, row: &FactsRow) {
    if let Some(ran) = ran {
        ran.note(&row.operation_id, row.started_at_us);
    }
}

/// When the first cycle began that ran an operation which changed after a number, of those that are noted.
pub(super) fn first_changed(
    ran: &BTreeMap<String, i64>,
    changes: &BTreeMap<String, i64>,
    since: i64,
) -> Option<i64> {
    let changed = |operation: &String| changes.get(operation).is_some_and(|change| *change > since);
    ran.iter().filter(|(operation, _)| changed(operation)).map(|(_, first)| *first).min()
}

/// Which operations a tool's cycles on a machine ran, each with when the first of them began.
pub(in super::super::super) const RAN_OF_TOOL_ON_MACHINE: &str = concat!(
    "SELECT operation_id, MIN(started_at_us) FROM cycles WHERE tool_id = $1 AND ",
    dialect::checked!("machine_id"),
    " = $2 GROUP BY ",
    dialect::checked!("operation_id"),
);

/// From when on a tool's cycles ran what changed after a number, by machine.
pub(in super::super::super) const JUDGED_OTHERWISE: &str = concat!(
    "SELECT machine_id, MIN(started_at_us) FROM cycles WHERE tool_id = $1 AND ",
    dialect::checked!("operation_id"),
    " IN (SELECT operation_id FROM operations WHERE judging_change > $2) GROUP BY ",
    dialect::checked!("machine_id"),
);

/// From where on a tool's cycles are judged otherwise than before the changes of operations after one of a number, by machine: where
/// it is not noted which operations they ran, all of them are gone through.
pub(super) async fn judged_otherwise_since(
    conn: &mut Conn,
    tool: &ToolId,
    judging_change: i64,
) -> StoreResult<BTreeMap<MachineId, Place>> {
    let rows: Vec<(String, i64)> = sqlx::query_as::<Db, _>(JUDGED_OTHERWISE)
        .bind(tool.as_str())
        .bind(judging_change)
        .fetch_all(&mut *conn)
        .await?;
    let places = rows
        .iter()
        .map(|(machine, first)| Ok((id("machine_id", machine)?, Place::at(Timestamp::from_micros(*first)))));
    places.collect()
}

/// Folds that are looked at in one statement, and written in one transaction.
const LOOKED_AT: i64 = 100;

/// Behind every machine of a tool, as identifiers are of ASCII.
const BEHIND_MACHINES: &str = "~";

/// The next folds with what they have gone along with: rows of folds alone, never of cycles. Where tools begin stands twice, as PostgreSQL
/// else goes through all of those before.
pub(in super::super::super) const LOOK: &str =
    "SELECT w.tool_id, w.machine_id, w.fold_version, w.folded, w.judging_change, w.ran,
         CAST(CASE WHEN t.tool_id IS NULL THEN 0 ELSE 1 END AS BIGINT) AS registered
     FROM tool_wear w LEFT JOIN tools t ON t.tool_id = w.tool_id AND t.tool_id >= $1
     WHERE (w.tool_id, w.machine_id) > ($1, $2) ORDER BY w.tool_id, w.machine_id LIMIT $3";

#[derive(sqlx::FromRow)]
struct LookRow {
    tool_id: String,
    machine_id: String,
    fold_version: i64,
    folded: i64,
    judging_change: i64,
    ran: Option<Vec<u8>>,
    registered: i64,
}

/// Where a fold stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Standing {
    /// Nothing is to be done; or a newer server wrote it, which judges by it.
    UpToDate,
    /// It is behind changes of operations that its cycles never ran: whatever is counted in it later is judged by what is in force then.
    Unchanged,
    /// Earlier rules made it, or it is behind a change of an operation that its cycles ran.
    Outdated,
    /// It is not noted which operations its cycles ran.
    Unnoted,
}

/// Some folds in the order of tools and machines, and where they stand.
struct Look {
    rows: Vec<(LookRow, Standing)>,
    judging_change: i64,
}

impl Look {
    async fn after(conn: &mut Conn, after: (&str, &str)) -> StoreResult<Self> {
        let judging_change = operations::last_judging_change(conn).await?;
        let rows: Vec<LookRow> = sqlx::query_as::<Db, _>(LOOK)
            .bind(after.0)
            .bind(after.1)
            .bind(LOOKED_AT)
            .fetch_all(&mut *conn)
            .await?;
        let since = rows.iter().map(|row| row.judging_change).min().unwrap_or(judging_change);
        let changes = operations::changed_since(conn, since, judging_change).await?;
        let rows = rows.into_iter().map(|row| {
            let ran = ran_of(row.ran.as_deref(), number("folded", row.folded)?);
            let standing = match (row.fold_version - i64::from(FOLD_VERSION), ran) {
                (..0, _) => Standing::Outdated,
                (1.., _) => Standing::UpToDate,
                (0, None) => Standing::Unnoted,
                (0, _) if row.judging_change >= judging_change => Standing::UpToDate,
                (0, Some(Ran::These(ran))) if first_changed(&ran, &changes, row.judging_change).is_none() => {
                    Standing::Unchanged
                }
                (0, Some(_)) => Standing::Outdated,
            };
            Ok((row, standing))
        });
        Ok(Self { rows: rows.collect::<StoreResult<_>>()?, judging_change })
    }

    fn last(&self) -> StoreResult<Option<FoldKey>> {
        let Some((row, _)) = self.rows.last() else { return Ok(None) };
        Ok(Some((id("tool_id", &row.tool_id)?, id("machine_id", &row.machine_id)?)))
    }
}

/// Behind which folds a look begins.
#[derive(Debug, Clone)]
pub(in super::super) enum After {
    Nothing,
    Tool(ToolId),
    Fold(FoldKey),
}

impl After {
    fn key(&self) -> (&str, &str) {
        match self {
            Self::Nothing => ("", ""),
            Self::Tool(tool) => (tool.as_str(), BEHIND_MACHINES),
            Self::Fold((tool, machine)) => (tool.as_str(), machine.as_str()),
        }
    }
}

/// Cycles of a fold that is made anew while somebody waits for an answer, at most: it is made in one transaction, which nobody breaks off.
const FOLLOWED_AT_ONCE: i64 = 10_000;

/// Who looks for outdated folds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) enum Looks {
    /// An answer that waits: longer folds, and those of which it is not noted what they ran, are left to who makes folds anew in the background.
    AtOnce,
    InBackground,
}

/// What a look for outdated folds came to.
pub(in super::super) enum Looked {
    /// The next tool that has one.
    Found(ToolId),
    /// There is none up to this fold.
    NoneUpTo(FoldKey),
    /// There is none any more.
    End,
}

/// Looks at the next folds for one of a registered tool that an earlier version of the rules made, that is behind a change of an operation
/// which its cycles ran, or of which nobody has noted what they ran.
pub(in super::super) async fn next_outdated(
    conn: &mut Conn,
    after: &After,
    looks: Looks,
) -> StoreResult<Looked> {
    let look = Look::after(conn, after.key()).await?;
    let wanted = |(row, standing): &&(LookRow, Standing)| {
        let is_due = match looks {
            Looks::AtOnce => *standing == Standing::Outdated && row.folded <= FOLLOWED_AT_ONCE,
            Looks::InBackground => matches!(standing, Standing::Outdated | Standing::Unnoted),
        };
        row.registered == 1 && is_due
    };
    if let Some((row, _)) = look.rows.iter().find(wanted) {
        return Ok(Looked::Found(id("tool_id", &row.tool_id)?));
    }
    Ok(look.last()?.map_or(Looked::End, Looked::NoneUpTo))
}

/// Some folds that need not follow a change.
pub(in super::super) struct Unchanged {
    /// The last fold that was looked at.
    pub(in super::super) last: FoldKey,
    /// Machine and tool of those that need not.
    pub(in super::super) folds: Vec<(String, String)>,
    /// The number of the change.
    pub(in super::super) judging_change: i64,
}

/// Looks at the next folds for those that are behind a change of an operation which their cycles never ran. `None` behind the last.
pub(in super::super) async fn next_unchanged(
    conn: &mut Conn,
    after: &After,
) -> StoreResult<Option<Unchanged>> {
    let look = Look::after(conn, after.key()).await?;
    let Some(last) = look.last()? else { return Ok(None) };
    let unchanged = look.rows.into_iter().filter(|(_, standing)| *standing == Standing::Unchanged);
    let folds = unchanged.map(|(row, _)| (row.machine_id, row.tool_id)).collect();
    Ok(Some(Unchanged { last, folds, judging_change: look.judging_change }))
}

/// Writes to folds that they have gone along with a change; their versions stay, as nothing else is otherwise.
pub(in super::super) async fn note_unchanged(
    conn: &mut Conn,
    judging_change: i64,
    rows: &[(String, String)],
) -> StoreResult<()> {
    for (machine, tool) in rows {
        sqlx::query::<Db>(
            "UPDATE tool_wear SET judging_change = $3 WHERE machine_id = $1 AND tool_id = $2 AND judging_change < $3",
        )
        .bind(machine)
        .bind(tool)
        .bind(judging_change)
        .execute(&mut *conn)
        .await?;
    }
    Ok(())
}

/// Makes a tool's folds of earlier versions anew, those that are behind a change of an operation, and those that are postponed, as far as the
/// budget reaches, and notes which operations their cycles ran where nobody did; the tool's name is locked by then. With the verdict after it; `None` where no fold
/// of the tool is this version's to make.
pub(in super::super) async fn renew(
    conn: &mut Conn,
    tool: &ToolId,
    now: Timestamp,
    budget: &mut Budget,
) -> StoreResult<Option<(Renewed, Verdict)>> {
    let ours: Vec<(String, i64)> = sqlx::query_as::<Db, _>(
        "SELECT machine_id, fold_version FROM tool_wear WHERE tool_id = $1 AND fold_version <= $2
         ORDER BY machine_id",
    )
    .bind(tool.as_str())
    .bind(i64::from(FOLD_VERSION))
    .fetch_all(&mut *conn)
    .await?;
    if ours.is_empty() {
        return Ok(None);
    }
    let mut wear = ToolWear::load_locked(conn, tool, budget).await?;
    for (machine, version) in &ours {
        let machine = id("machine_id", machine)?;
        // Of this version's a damaged one would be found in every round, and read by all of its cycles meanwhile.
        if *version == i64::from(FOLD_VERSION) && !wear.lacks_fold_of(&machine) {
            continue;
        }
        // Checkpoints are as good as they were before one that is only behind, or was postponed when it was loaded.
        let is_behind = *version == BEHIND || wear.is_postponed_on(&machine);
        let from = if is_behind { END } else { BEGINNING };
        wear.refold(conn, &machine, (&from, 0), budget).await?;
    }
    wear.find_ran(conn).await?;
    // A verdict may have folds postponed once more.
    let verdict = wear.verdict(conn, budget).await?;
    let changed = wear.take_changed()?;
    dialect::save_wear(conn, &changed, now).await?;
    let renewed = match () {
        () if wear.is_postponed() => Renewed::Part,
        () if changed.is_empty() => Renewed::Nothing,
        () => Renewed::Whole,
    };
    Ok(Some((renewed, verdict)))
}

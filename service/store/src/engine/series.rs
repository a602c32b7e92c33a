//! What cycles amounted to, as points of series: few columns of many rows.

use super::wear::{self, ToolWear};
use super::{Conn, Db, cycles, dialect};
use crate::error::StoreResult;
use crate::history::Walk;
use crate::point::{CyclePoint, PointColumns, PointEnergy, PointPeaks};
use crate::record::{CycleFilter, CycleKey, LevelPoint, Page};
use crate::rows::{Place, id};
use feedwright_core::ids::{CycleId, MachineId, OperationId, ToolId};
use feedwright_core::invalid::Violation;
use feedwright_core::summary::{EnergyBasis, IdlePower};
use feedwright_core::units::Timestamp;
use sqlx::Row;

/// Columns of a point that tells of energy alone: what comes after them costs as much again.
const ENERGY_COLUMNS: usize = 11;

macro_rules! energies {
    (@columns) => {
        "SELECT c.started_at_us, c.machine_id, c.cycle_id, c.tool_id, c.operation_id, c.dynamometer_joules,
                c.calibrated_joules, c.measured_power_joules, c.measured_power_idle_watts, c.rated_power_joules,
                c.reported_energy_joules"
    };
    ($($tail:expr),+) => { concat!(energies!(@columns), " FROM cycles c WHERE ", $($tail),+) };
}

macro_rules! points {
    ($($tail:expr),+) => {
        concat!(
            energies!(@columns), ", c.duration_ms, c.max_depth_mm, c.max_spindle_load_percent,
                 c.max_feed_drive_load_percent, c.max_spindle_power_watts, c.max_thrust_newtons,
                 c.max_torque_newton_metres FROM cycles c WHERE ", $($tail),+
        )
    };
}

// As in the list of cycles: the first condition drives an index, in whose order the rows come.
macro_rules! forwards {
    ($(of $column:literal = $value:literal,)? $driver:literal) => {
        points!(
            $(dialect::of_one!($column, $value), " AND ",)?
            $driver,
            " AND c.started_at_us >= $4 AND c.started_at_us < $5
              AND (c.started_at_us, c.machine_id, COALESCE(c.seq, -1), c.cycle_id) > ($6, $7, COALESCE(
                  (SELECT k.seq FROM cycles k WHERE k.machine_id = $7 AND k.cycle_id = $8), -1), $8)
              ORDER BY ", $($column, ", ",)?
            "c.started_at_us, c.machine_id, COALESCE(c.seq, -1), c.cycle_id LIMIT $9"
        )
    };
}

macro_rules! of_subject {
    ($page:ident, $filter:expr) => {{
        const OF_TOOL: &str = $page!(
            of "c.tool_id" = "$1",
            "(CAST($2 AS TEXT) IS NULL OR c.machine_id = $2) AND (CAST($3 AS TEXT) IS NULL OR c.operation_id = $3)"
        );
        const OF_MACHINE: &str = $page!(
            of "c.machine_id" = "$2",
            "(CAST($1 AS TEXT) IS NULL OR c.tool_id = $1) AND (CAST($3 AS TEXT) IS NULL OR c.operation_id = $3)"
        );
        const OF_OPERATION: &str = $page!(
            of "c.operation_id" = "$3",
            "(CAST($1 AS TEXT) IS NULL OR c.tool_id = $1) AND (CAST($2 AS TEXT) IS NULL OR c.machine_id = $2)"
        );
        const OF_ALL: &str = $page!(
            "(CAST($1 AS TEXT) IS NULL OR c.tool_id = $1) AND (CAST($2 AS TEXT) IS NULL OR c.machine_id = $2)
             AND (CAST($3 AS TEXT) IS NULL OR c.operation_id = $3)"
        );
        match $filter {
            CycleFilter { tool: Some(_), .. } => OF_TOOL,
            CycleFilter { machine: Some(_), .. } => OF_MACHINE,
            CycleFilter { operation: Some(_), .. } => OF_OPERATION,
            _ => OF_ALL,
        }
    }};
}

type DbRow = <Db as sqlx::Database>::Row;

/// An id that is that of the row before, or one of its own: most rows of a series share them.
fn shared<'r, T>(column: &str, text: &'r str, before: Option<&T>) -> StoreResult<T>
where
    T: TryFrom<&'r str, Error = Violation> + Clone + PartialEq<str>,
{
    match before {
        Some(before) if *before == *text => Ok(before.clone()),
        _ => id(column, text),
    }
}

fn peaks(row: &DbRow) -> StoreResult<PointPeaks> {
    let number = |at: usize| row.try_get::<Option<f64>, _>(ENERGY_COLUMNS + at);
    Ok(PointPeaks {
        duration_ms: number(0)?,
        max_depth_mm: number(1)?,
        max_spindle_load_percent: number(2)?,
        max_feed_drive_load_percent: number(3)?,
        max_spindle_power_watts: number(4)?,
        max_thrust_newtons: number(5)?,
        max_torque_newton_metres: number(6)?,
    })
}

/// A row's point; `before` is that of the row before.
fn point(row: &DbRow, before: Option<&CyclePoint>) -> StoreResult<CyclePoint> {
    let number = |at: usize| row.try_get::<Option<f64>, _>(at);
    let mut energy = Vec::with_capacity(2);
    for (basis, at) in [
        (EnergyBasis::Dynamometer, 5),
        (EnergyBasis::Calibrated, 6),
        (EnergyBasis::MeasuredPower, 7),
        (EnergyBasis::RatedPower, 9),
        (EnergyBasis::Reported, 10),
    ] {
        if let Some(total_joules) = number(at)? {
            let idle = match (basis, number(8)?) {
                (EnergyBasis::Dynamometer | EnergyBasis::Calibrated, _) => IdlePower::NotApplicable,
                (EnergyBasis::MeasuredPower, Some(watts)) => IdlePower::Subtracted { watts },
                _ => IdlePower::Included,
            };
            energy.push(PointEnergy { basis, total_joules, idle });
        }
    }
    let machine: MachineId = shared("machine_id", row.try_get(1)?, before.map(|point| &point.key.1))?;
    let cycle: CycleId = id("cycle_id", row.try_get(2)?)?;
    Ok(CyclePoint {
        key: (Timestamp::from_micros(row.try_get(0)?), machine, cycle),
        tool: shared("tool_id", row.try_get(3)?, before.map(|point| &point.tool))?,
        operation: shared("operation_id", row.try_get(4)?, before.map(|point| &point.operation))?,
        energy,
        peaks: (row.len() > ENERGY_COLUMNS).then(|| peaks(row).map(Box::new)).transpose()?,
    })
}

fn points_of<'r>(rows: impl ExactSizeIterator<Item = &'r DbRow>) -> StoreResult<Vec<CyclePoint>> {
    let mut points = Vec::with_capacity(rows.len());
    for row in rows {
        let next = point(row, points.last())?;
        points.push(next);
    }
    Ok(points)
}

pub(super) async fn points(
    conn: &mut Conn,
    filter: &CycleFilter,
    page: &Page<CycleKey>,
) -> StoreResult<Vec<CyclePoint>> {
    let (after_at, after_machine, after_cycle) = cycles::behind(filter, page);
    let rows: Vec<DbRow> = sqlx::query::<Db>(of_subject!(forwards, filter))
        .bind(filter.tool.as_ref().map(ToolId::as_str))
        .bind(filter.machine.as_ref().map(MachineId::as_str))
        .bind(filter.operation.as_ref().map(OperationId::as_str))
        .bind(after_at)
        .bind(filter.to.map_or(i64::MAX, |to| to.micros()))
        .bind(after_at)
        .bind(after_machine)
        .bind(after_cycle)
        .bind(i64::from(page.limit))
        .fetch_all(&mut *conn)
        .await?;
    points_of(rows.iter())
}

// Every engine begins at the newest entry of the index and stops after the last one wanted.
macro_rules! backwards {
    (@tail $($column:literal)?) => {
        concat!(
            " AND c.started_at_us >= $4 AND c.started_at_us < $5 ORDER BY ", $($column, " DESC, ",)?
            "c.started_at_us DESC, c.machine_id DESC, COALESCE(c.seq, -1) DESC, c.cycle_id DESC LIMIT $6"
        )
    };
    ($(of $column:literal = $value:literal,)? $driver:literal) => {
        points!(
            $(dialect::of_one!($column, $value), " AND ",)?
            $driver,
            backwards!(@tail $($column)?)
        )
    };
}

const LAST_ENERGIES_OF_TOOL: &str = energies!(
    dialect::of_one!("c.tool_id", "$1"),
    " AND (CAST($2 AS TEXT) IS NULL OR c.machine_id = $2) AND (CAST($3 AS TEXT) IS NULL OR c.operation_id = $3)",
    backwards!(@tail "c.tool_id")
);

/// The newest points, oldest of them first; of a tool's energies nothing else is read.
pub(super) async fn last_points(
    conn: &mut Conn,
    filter: &CycleFilter,
    told: PointColumns,
    limit: u32,
) -> StoreResult<Vec<CyclePoint>> {
    let sql = match (&filter.tool, told) {
        (Some(_), PointColumns::Energy) => LAST_ENERGIES_OF_TOOL,
        _ => of_subject!(backwards, filter),
    };
    let rows: Vec<DbRow> = sqlx::query::<Db>(sql)
        .bind(filter.tool.as_ref().map(ToolId::as_str))
        .bind(filter.machine.as_ref().map(MachineId::as_str))
        .bind(filter.operation.as_ref().map(OperationId::as_str))
        .bind(filter.from.map_or(i64::MIN, |from| from.micros()))
        .bind(filter.to.map_or(i64::MAX, |to| to.micros()))
        .bind(i64::from(limit))
        .fetch_all(&mut *conn)
        .await?;
    points_of(rows.iter().rev())
}

/// How many cycles of a tool are stored, where it is registered: each of them is counted in a fold, in the transaction
/// that stores it.
pub(super) async fn cycles_of_tool(conn: &mut Conn, tool: &ToolId) -> StoreResult<Option<i64>> {
    Ok(sqlx::query_scalar::<Db, _>(
        "SELECT CAST(SUM(w.folded) AS BIGINT) FROM tool_wear w
         WHERE w.tool_id = $1 AND EXISTS (SELECT 1 FROM tools t WHERE t.tool_id = $1)",
    )
    .bind(tool.as_str())
    .fetch_one(&mut *conn)
    .await?)
}

/// The level that is judged after each cycle of a tool that began within the range, as the fold over all its machines has it.
pub(super) async fn levels(
    conn: &mut Conn,
    tool: &ToolId,
    from: Timestamp,
    to: Timestamp,
    limit: u32,
) -> StoreResult<Vec<LevelPoint>> {
    let known = ToolWear::load(conn, tool).await?;
    let events = &known.events;
    let mut walk = match known.state_before(conn, &Place::at(from)).await? {
        Some((fold, folded)) => Walk::resume(fold, folded, events),
        None => Walk::new(events),
    };
    let mut levels = Vec::new();
    if !wear::is_registered(conn, tool).await? {
        return Ok(levels);
    }
    loop {
        let page = wear::facts_after(conn, tool, None, walk.fold().last()).await?;
        if page.is_empty() {
            return Ok(levels);
        }
        for row in &page {
            let order = row.order()?;
            if order.started_at >= to || levels.len() >= limit as usize {
                return Ok(levels);
            }
            walk.step(row)?;
            if order.started_at >= from {
                levels.push(LevelPoint {
                    key: (order.started_at, order.machine, order.cycle),
                    operation: id("operation_id", &row.operation_id)?,
                    level: walk.fold().judged_level().map(|level| level.value),
                });
            }
        }
    }
}

//! Machines and their fitted lines.

use super::{Conn, Db, audit, dialect, operations, registry, tools};
use crate::error::{StoreError, StoreResult};
use crate::locks::Locks;
use crate::precondition;
use crate::record::{Actor, Page, Precondition, PutOutcome, StoredCalibration, Surroundings, Versioned};
use crate::rows::{CalibrationRow, MachineRow, calibration_json, machine_json};
use feedwright_core::ids::{MachineId, OperationId, ToolId};
use feedwright_core::machine::{Calibration, Machine};
use feedwright_core::units::Timestamp;

macro_rules! select {
    ($tail:literal) => {
        concat!(
            "SELECT machine_id, name, control, ipo_period_ms, spindle_reference, spindle_rated_power_watts,
                    spindle_base_speed_rpm, feed_drive_reference, feed_drive_rated_thrust_newtons, feed_min_mm_min,
                    feed_max_mm_min, override_min_percent, override_max_percent, version, updated_at_us,
                    row_sum, summed_version
             FROM machines ",
            $tail
        )
    };
}

pub(super) async fn get(conn: &mut Conn, id: &MachineId) -> StoreResult<Option<Versioned<Machine>>> {
    let row: Option<MachineRow> = sqlx::query_as::<Db, _>(select!("WHERE machine_id = $1"))
        .bind(id.as_str())
        .fetch_optional(&mut *conn)
        .await?;
    row.map(|row| row.versioned(dialect::WRITERS)).transpose()
}

pub(super) async fn list(conn: &mut Conn, page: &Page<MachineId>) -> StoreResult<Vec<Versioned<Machine>>> {
    let rows: Vec<MachineRow> =
        sqlx::query_as::<Db, _>(select!("WHERE machine_id > $1 ORDER BY machine_id LIMIT $2"))
            .bind(page.after.as_ref().map_or("", MachineId::as_str))
            .bind(i64::from(page.limit))
            .fetch_all(&mut *conn)
            .await?;
    rows.iter().map(|row| row.versioned(dialect::WRITERS)).collect()
}

pub(super) async fn put(
    conn: &mut Conn,
    machine: &Machine,
    expects: Precondition,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<PutOutcome> {
    dialect::lock(conn, &Locks::subject("machine", machine.id.as_str())).await?;
    let found = get(conn, &machine.id).await;
    let existing = registry::existing(conn, found, ("machines", machine.id.as_str())).await?;
    let outcome = precondition::decide(existing.as_ref().map(|existing| existing.held(machine)), expects)?;
    if let PutOutcome::Unchanged(_) = outcome {
        return Ok(outcome);
    }
    let row = MachineRow::of(machine, outcome.version(), now)?;
    sqlx::query::<Db>(
        "INSERT INTO machines (machine_id, name, control, ipo_period_ms, spindle_reference,
             spindle_rated_power_watts, spindle_base_speed_rpm, feed_drive_reference,
             feed_drive_rated_thrust_newtons, feed_min_mm_min, feed_max_mm_min, override_min_percent,
             override_max_percent, version, updated_at_us, row_sum, summed_version)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16, $17)
         ON CONFLICT (machine_id) DO UPDATE SET name = excluded.name, control = excluded.control,
             ipo_period_ms = excluded.ipo_period_ms, spindle_reference = excluded.spindle_reference,
             spindle_rated_power_watts = excluded.spindle_rated_power_watts,
             spindle_base_speed_rpm = excluded.spindle_base_speed_rpm,
             feed_drive_reference = excluded.feed_drive_reference,
             feed_drive_rated_thrust_newtons = excluded.feed_drive_rated_thrust_newtons,
             feed_min_mm_min = excluded.feed_min_mm_min, feed_max_mm_min = excluded.feed_max_mm_min,
             override_min_percent = excluded.override_min_percent,
             override_max_percent = excluded.override_max_percent,
             version = excluded.version, updated_at_us = excluded.updated_at_us,
             row_sum = excluded.row_sum, summed_version = excluded.summed_version",
    )
    .bind(&row.machine_id)
    .bind(&machine.name)
    .bind(&machine.control)
    .bind(row.ipo_period_ms)
    .bind(&row.spindle_reference)
    .bind(row.spindle_rated_power_watts)
    .bind(row.spindle_base_speed_rpm)
    .bind(&row.feed_drive_reference)
    .bind(row.feed_drive_rated_thrust_newtons)
    .bind(row.feed_min_mm_min)
    .bind(row.feed_max_mm_min)
    .bind(row.override_min_percent)
    .bind(row.override_max_percent)
    .bind(row.version)
    .bind(row.updated_at_us)
    .bind(row.row_sum)
    .bind(row.summed_version)
    .execute(&mut *conn)
    .await?;
    let before = existing.and_then(|existing| existing.value).map(|before| machine_json(&before));
    let detail = audit::change(before.as_ref(), &machine_json(machine), outcome);
    audit::add(conn, actor, now, "machine.put", format!("machine/{}", machine.id), &detail).await?;
    Ok(outcome)
}

/// Adds the next version of a machine's fitted lines.
pub(super) async fn calibrate(
    conn: &mut Conn,
    machine: &MachineId,
    mut calibration: Calibration,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<Option<Calibration>> {
    dialect::lock(conn, &Locks::subject("machine", machine.as_str())).await?;
    if get(conn, machine).await?.is_none() {
        return Ok(None);
    }
    let newest: Option<i64> =
        sqlx::query_scalar::<Db, _>("SELECT MAX(version) FROM calibrations WHERE machine_id = $1")
            .bind(machine.as_str())
            .fetch_one(&mut *conn)
            .await?;
    calibration.version = u32::try_from(newest.unwrap_or(0) + 1)
        .map_err(|_| StoreError::Full { what: "the list of calibrations" })?;
    let row = CalibrationRow::of(machine, &calibration, now)?;
    sqlx::query::<Db>(
        "INSERT INTO calibrations (machine_id, version, fitted_at_us, thrust_slope, thrust_intercept,
             thrust_min_percent, thrust_max_percent, thrust_r_squared, thrust_residual_spread, torque_slope,
             torque_intercept, torque_min_percent, torque_max_percent, torque_r_squared, torque_residual_spread,
             row_sum, summed_version)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16, $17)",
    )
    .bind(&row.machine_id)
    .bind(row.version)
    .bind(row.fitted_at_us)
    .bind(row.thrust_slope)
    .bind(row.thrust_intercept)
    .bind(row.thrust_min_percent)
    .bind(row.thrust_max_percent)
    .bind(row.thrust_r_squared)
    .bind(row.thrust_residual_spread)
    .bind(row.torque_slope)
    .bind(row.torque_intercept)
    .bind(row.torque_min_percent)
    .bind(row.torque_max_percent)
    .bind(row.torque_r_squared)
    .bind(row.torque_residual_spread)
    .bind(row.row_sum)
    .bind(row.summed_version)
    .execute(&mut *conn)
    .await?;
    let subject = format!("machine/{machine}/calibrations/{}", calibration.version);
    audit::add(conn, actor, now, "calibration.add", subject, &calibration_json(&calibration)).await?;
    Ok(Some(calibration))
}

macro_rules! select_calibrations {
    ($tail:literal) => {
        concat!(
            "SELECT machine_id, version, fitted_at_us, thrust_slope, thrust_intercept, thrust_min_percent, thrust_max_percent,
                    thrust_r_squared, thrust_residual_spread, torque_slope, torque_intercept, torque_min_percent,
                    torque_max_percent, torque_r_squared, torque_residual_spread, row_sum, summed_version
             FROM calibrations ",
            $tail
        )
    };
}

pub(super) async fn calibrations(
    conn: &mut Conn,
    machine: &MachineId,
    page: &Page<u32>,
) -> StoreResult<Vec<StoredCalibration>> {
    let rows: Vec<CalibrationRow> = sqlx::query_as::<Db, _>(select_calibrations!(
        "WHERE machine_id = $1 AND version > $2 ORDER BY version LIMIT $3"
    ))
    .bind(machine.as_str())
    .bind(page.after.map_or(0, i64::from))
    .bind(i64::from(page.limit))
    .fetch_all(&mut *conn)
    .await?;
    rows.iter().map(|row| row.calibration(dialect::WRITERS)).collect()
}

pub(super) async fn newest_calibration(
    conn: &mut Conn,
    machine: &MachineId,
) -> StoreResult<Option<StoredCalibration>> {
    let row: Option<CalibrationRow> =
        sqlx::query_as::<Db, _>(select_calibrations!("WHERE machine_id = $1 ORDER BY version DESC LIMIT 1"))
            .bind(machine.as_str())
            .fetch_optional(&mut *conn)
            .await?;
    row.map(|row| row.calibration(dialect::WRITERS)).transpose()
}

pub(super) async fn surroundings(
    conn: &mut Conn,
    machine: &MachineId,
    operation: &OperationId,
    tool: &ToolId,
) -> StoreResult<Option<Surroundings>> {
    let Some(known) = registry::machine_to_decide_by(conn, machine).await? else {
        return Ok(None);
    };
    let operation = registry::to_decide_by(operations::get(conn, operation).await)?;
    let tool = registry::to_decide_by(tools::get(conn, tool).await)?;
    let (operation, tool) = (operation.map(|found| found.value), tool.map(|found| found.value));
    Ok(Some(crate::registry::surroundings(&known, operation, tool)))
}

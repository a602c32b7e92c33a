//! Machines and their fitted lines.

use super::{Conn, Db, audit, dialect, operations, tools};
use crate::error::{StoreError, StoreResult};
use crate::locks::Locks;
use crate::precondition;
use crate::record::{Actor, Page, Precondition, PutOutcome, Surroundings, Versioned};
use crate::rows::{CalibrationRow, MachineRow, calibration_json, count, float, machine_json, optional_float};
use feedwright_core::ids::{MachineId, OperationId, ToolId};
use feedwright_core::machine::{Calibration, FittedLine, Machine};
use feedwright_core::units::Timestamp;

macro_rules! select {
    ($tail:literal) => {
        concat!(
            "SELECT machine_id, name, control, ipo_period_ms, spindle_reference, spindle_rated_power_watts,
                    spindle_base_speed_rpm, feed_drive_reference, feed_drive_rated_thrust_newtons, feed_min_mm_min,
                    feed_max_mm_min, override_min_percent, override_max_percent, version, updated_at_us
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
    row.map(|row| row.versioned()).transpose()
}

pub(super) async fn list(conn: &mut Conn, page: &Page<MachineId>) -> StoreResult<Vec<Versioned<Machine>>> {
    let rows: Vec<MachineRow> =
        sqlx::query_as::<Db, _>(select!("WHERE machine_id > $1 ORDER BY machine_id LIMIT $2"))
            .bind(page.after.as_ref().map_or("", MachineId::as_str))
            .bind(i64::from(page.limit))
            .fetch_all(&mut *conn)
            .await?;
    rows.iter().map(MachineRow::versioned).collect()
}

pub(super) async fn put(
    conn: &mut Conn,
    machine: &Machine,
    expects: Precondition,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<PutOutcome> {
    dialect::lock(conn, &Locks::subject("machine", machine.id.as_str())).await?;
    let existing = get(conn, &machine.id).await?;
    let known = existing.as_ref().map(|existing| (existing.version, existing.value == *machine));
    let outcome = precondition::decide(known, expects)?;
    if let PutOutcome::Unchanged(_) = outcome {
        return Ok(outcome);
    }
    let spindle = &machine.spindle;
    let feed_drive = &machine.feed_drive;
    let limits = &machine.limits;
    sqlx::query::<Db>(
        "INSERT INTO machines (machine_id, name, control, ipo_period_ms, spindle_reference,
             spindle_rated_power_watts, spindle_base_speed_rpm, feed_drive_reference,
             feed_drive_rated_thrust_newtons, feed_min_mm_min, feed_max_mm_min, override_min_percent,
             override_max_percent, version, updated_at_us)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15)
         ON CONFLICT (machine_id) DO UPDATE SET name = excluded.name, control = excluded.control,
             ipo_period_ms = excluded.ipo_period_ms, spindle_reference = excluded.spindle_reference,
             spindle_rated_power_watts = excluded.spindle_rated_power_watts,
             spindle_base_speed_rpm = excluded.spindle_base_speed_rpm,
             feed_drive_reference = excluded.feed_drive_reference,
             feed_drive_rated_thrust_newtons = excluded.feed_drive_rated_thrust_newtons,
             feed_min_mm_min = excluded.feed_min_mm_min, feed_max_mm_min = excluded.feed_max_mm_min,
             override_min_percent = excluded.override_min_percent,
             override_max_percent = excluded.override_max_percent,
             version = excluded.version, updated_at_us = excluded.updated_at_us",
    )
    .bind(machine.id.as_str())
    .bind(&machine.name)
    .bind(&machine.control)
    .bind(float("ipo_period_ms", machine.ipo_period_ms)?)
    .bind(spindle.reference.as_str())
    .bind(optional_float("spindle_rated_power_watts", spindle.rated_power_watts)?)
    .bind(optional_float("spindle_base_speed_rpm", spindle.base_speed_rpm)?)
    .bind(feed_drive.reference.as_str())
    .bind(optional_float("feed_drive_rated_thrust_newtons", feed_drive.rated_thrust_newtons)?)
    .bind(float("feed_min_mm_min", limits.min_mm_min())?)
    .bind(float("feed_max_mm_min", limits.max_mm_min())?)
    .bind(float("override_min_percent", limits.override_min_percent())?)
    .bind(float("override_max_percent", limits.override_max_percent())?)
    .bind(count("version", outcome.version())?)
    .bind(now.micros())
    .execute(&mut *conn)
    .await?;
    let before = existing.map(|existing| machine_json(&existing.value));
    let detail = audit::change(before.as_ref(), &machine_json(machine), outcome);
    audit::add(conn, actor, now, "machine.put", format!("machine/{}", machine.id), &detail).await?;
    Ok(outcome)
}

fn parts(name: &str, line: Option<FittedLine>) -> StoreResult<[Option<f64>; 6]> {
    let Some(line) = line else {
        return Ok([None; 6]);
    };
    let part = |value| float(name, value).map(Some);
    Ok([
        part(line.slope)?,
        part(line.intercept)?,
        part(line.min_percent)?,
        part(line.max_percent)?,
        part(line.r_squared)?,
        part(line.residual_spread)?,
    ])
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
    let mut query = sqlx::query::<Db>(
        "INSERT INTO calibrations (machine_id, version, fitted_at_us, thrust_slope, thrust_intercept,
             thrust_min_percent, thrust_max_percent, thrust_r_squared, thrust_residual_spread, torque_slope,
             torque_intercept, torque_min_percent, torque_max_percent, torque_r_squared, torque_residual_spread)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15)",
    )
    .bind(machine.as_str())
    .bind(i64::from(calibration.version))
    .bind(now.micros());
    for line in [parts("thrust", calibration.thrust)?, parts("torque", calibration.torque)?] {
        for part in line {
            query = query.bind(part);
        }
    }
    query.execute(&mut *conn).await?;
    let subject = format!("machine/{machine}/calibrations/{}", calibration.version);
    audit::add(conn, actor, now, "calibration.add", subject, &calibration_json(&calibration)).await?;
    Ok(Some(calibration))
}

macro_rules! select_calibrations {
    ($tail:literal) => {
        concat!(
            "SELECT version, fitted_at_us, thrust_slope, thrust_intercept, thrust_min_percent, thrust_max_percent,
                    thrust_r_squared, thrust_residual_spread, torque_slope, torque_intercept, torque_min_percent,
                    torque_max_percent, torque_r_squared, torque_residual_spread
             FROM calibrations ",
            $tail
        )
    };
}

pub(super) async fn calibrations(
    conn: &mut Conn,
    machine: &MachineId,
    page: &Page<u32>,
) -> StoreResult<Vec<(Calibration, Timestamp)>> {
    let rows: Vec<CalibrationRow> = sqlx::query_as::<Db, _>(select_calibrations!(
        "WHERE machine_id = $1 AND version > $2 ORDER BY version LIMIT $3"
    ))
    .bind(machine.as_str())
    .bind(page.after.map_or(0, i64::from))
    .bind(i64::from(page.limit))
    .fetch_all(&mut *conn)
    .await?;
    rows.iter().map(CalibrationRow::calibration).collect()
}

pub(super) async fn newest_calibration(
    conn: &mut Conn,
    machine: &MachineId,
) -> StoreResult<Option<Calibration>> {
    let row: Option<CalibrationRow> =
        sqlx::query_as::<Db, _>(select_calibrations!("WHERE machine_id = $1 ORDER BY version DESC LIMIT 1"))
            .bind(machine.as_str())
            .fetch_optional(&mut *conn)
            .await?;
    row.map(|row| Ok(row.calibration()?.0)).transpose()
}

pub(super) async fn surroundings(
    conn: &mut Conn,
    machine: &MachineId,
    operation: &OperationId,
    tool: &ToolId,
) -> StoreResult<Option<Surroundings>> {
    let Some(found) = get(conn, machine).await? else {
        return Ok(None);
    };
    Ok(Some(Surroundings {
        machine: found.value,
        calibration: newest_calibration(conn, machine).await?,
        operation: operations::get(conn, operation).await?.map(|found| found.value),
        tool: tools::get(conn, tool).await?.map(|found| found.value),
    }))
}

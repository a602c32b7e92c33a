//! Rows of what people register, and the same as JSON for the audit.

use super::library::{setup_json, setup_of};
use super::{count, float, id, number, optional_float, word};
use crate::error::StoreResult;
use crate::record::{StoredCalibration, Versioned};
use crate::row_sum::{Writers, summed};
use crate::stored_text::StoredText;
use feedwright_core::ids::MachineId;
use feedwright_core::machine::{
    Calibration, FeedDriveRating, FeedLimits, FittedLine, LoadReference, Machine, SpindleRating,
};
use feedwright_core::operation::{Operation, WearSettings};
use feedwright_core::tool::Tool;
use feedwright_core::units::{Process, Timestamp};
use serde_json::{Value, json};

/// A row of `machines`.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct MachineRow {
    pub(crate) machine_id: String,
    pub(crate) name: StoredText,
    pub(crate) control: StoredText,
    pub(crate) ipo_period_ms: f64,
    pub(crate) spindle_reference: String,
    pub(crate) spindle_rated_power_watts: Option<f64>,
    pub(crate) spindle_base_speed_rpm: Option<f64>,
    pub(crate) feed_drive_reference: String,
    pub(crate) feed_drive_rated_thrust_newtons: Option<f64>,
    pub(crate) feed_min_mm_min: f64,
    pub(crate) feed_max_mm_min: f64,
    pub(crate) override_min_percent: f64,
    pub(crate) override_max_percent: f64,
    pub(crate) version: i64,
    pub(crate) updated_at_us: i64,
    pub(crate) row_sum: Option<i64>,
    pub(crate) summed_version: Option<i64>,
}

summed!(MachineRow of "machines":
    machine_id, name, control, ipo_period_ms, spindle_reference, spindle_rated_power_watts, spindle_base_speed_rpm,
    feed_drive_reference, feed_drive_rated_thrust_newtons, feed_min_mm_min, feed_max_mm_min, override_min_percent,
    override_max_percent, version, updated_at_us,
);

impl MachineRow {
    /// As it is to be written.
    pub(crate) fn of(machine: &Machine, version: u64, now: Timestamp) -> StoreResult<Self> {
        let Machine { spindle, feed_drive, limits, .. } = machine;
        let row = Self {
            machine_id: machine.id.as_str().to_owned(),
            name: machine.name.as_str().into(),
            control: machine.control.as_str().into(),
            ipo_period_ms: float("ipo_period_ms", machine.ipo_period_ms)?,
            spindle_reference: spindle.reference.as_str().to_owned(),
            spindle_rated_power_watts: optional_float(
                "spindle_rated_power_watts",
                spindle.rated_power_watts,
            )?,
            spindle_base_speed_rpm: optional_float("spindle_base_speed_rpm", spindle.base_speed_rpm)?,
            feed_drive_reference: feed_drive.reference.as_str().to_owned(),
            feed_drive_rated_thrust_newtons: optional_float(
                "feed_drive_rated_thrust_newtons",
                feed_drive.rated_thrust_newtons,
            )?,
            feed_min_mm_min: float("feed_min_mm_min", limits.min_mm_min())?,
            feed_max_mm_min: float("feed_max_mm_min", limits.max_mm_min())?,
            override_min_percent: float("override_min_percent", limits.override_min_percent())?,
            override_max_percent: float("override_max_percent", limits.override_max_percent())?,
            version: count("version", version)?,
            updated_at_us: now.micros(),
            row_sum: None,
            summed_version: None,
        };
        Ok(row.with_sum())
    }

    pub(crate) fn versioned(&self, writers: Writers) -> StoreResult<Versioned<Machine>> {
        let limits = FeedLimits::new(
            self.feed_min_mm_min,
            self.feed_max_mm_min,
            self.override_min_percent,
            self.override_max_percent,
        )
        .map_err(|_| super::damaged("machines.limits"))?;
        Ok(Versioned {
            value: Machine {
                id: id("machine_id", &self.machine_id)?,
                name: self.name.shown(),
                control: self.control.shown(),
                ipo_period_ms: self.ipo_period_ms,
                spindle: SpindleRating {
                    reference: word("spindle_reference", &self.spindle_reference, LoadReference::parse)?,
                    rated_power_watts: self.spindle_rated_power_watts,
                    base_speed_rpm: self.spindle_base_speed_rpm,
                },
                feed_drive: FeedDriveRating {
                    reference: word(
                        "feed_drive_reference",
                        &self.feed_drive_reference,
                        LoadReference::parse,
                    )?,
                    rated_thrust_newtons: self.feed_drive_rated_thrust_newtons,
                },
                limits,
            },
            version: number("version", self.version)?,
            updated_at: Timestamp::from_micros(self.updated_at_us),
            is_damaged: self.is_damaged(writers),
        })
    }
}

/// A machine as the audit shows it.
pub(crate) fn machine_json(machine: &Machine) -> Value {
    json!({
        "name": machine.name,
        "control": machine.control,
        "ipo_period_ms": machine.ipo_period_ms,
        "spindle_reference": machine.spindle.reference.as_str(),
        "spindle_rated_power_watts": machine.spindle.rated_power_watts,
        "spindle_base_speed_rpm": machine.spindle.base_speed_rpm,
        "feed_drive_reference": machine.feed_drive.reference.as_str(),
        "feed_drive_rated_thrust_newtons": machine.feed_drive.rated_thrust_newtons,
        "feed_min_mm_min": machine.limits.min_mm_min(),
        "feed_max_mm_min": machine.limits.max_mm_min(),
        "override_min_percent": machine.limits.override_min_percent(),
        "override_max_percent": machine.limits.override_max_percent(),
    })
}

/// A row of `calibrations`.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct CalibrationRow {
    pub(crate) machine_id: String,
    pub(crate) version: i64,
    pub(crate) fitted_at_us: i64,
    pub(crate) thrust_slope: Option<f64>,
    pub(crate) thrust_intercept: Option<f64>,
    pub(crate) thrust_min_percent: Option<f64>,
    pub(crate) thrust_max_percent: Option<f64>,
    pub(crate) thrust_r_squared: Option<f64>,
    pub(crate) thrust_residual_spread: Option<f64>,
    pub(crate) torque_slope: Option<f64>,
    pub(crate) torque_intercept: Option<f64>,
    pub(crate) torque_min_percent: Option<f64>,
    pub(crate) torque_max_percent: Option<f64>,
    pub(crate) torque_r_squared: Option<f64>,
    pub(crate) torque_residual_spread: Option<f64>,
    pub(crate) row_sum: Option<i64>,
    pub(crate) summed_version: Option<i64>,
}

summed!(CalibrationRow of "calibrations":
    machine_id, version, fitted_at_us, thrust_slope, thrust_intercept, thrust_min_percent, thrust_max_percent,
    thrust_r_squared, thrust_residual_spread, torque_slope, torque_intercept, torque_min_percent, torque_max_percent,
    torque_r_squared, torque_residual_spread,
);

fn line(parts: [Option<f64>; 6]) -> Option<FittedLine> {
    let [slope, intercept, min_percent, max_percent, r_squared, residual_spread] = parts;
    Some(FittedLine {
        slope: slope?,
        intercept: intercept?,
        min_percent: min_percent?,
        max_percent: max_percent?,
        r_squared: r_squared?,
        residual_spread: residual_spread?,
    })
}

/// The columns of a line.
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

impl CalibrationRow {
    /// As it is to be written.
    pub(crate) fn of(machine: &MachineId, calibration: &Calibration, now: Timestamp) -> StoreResult<Self> {
        let [
            thrust_slope,
            thrust_intercept,
            thrust_min_percent,
            thrust_max_percent,
            thrust_r_squared,
            thrust_residual_spread,
        ] = parts("thrust", calibration.thrust)?;
        let [
            torque_slope,
            torque_intercept,
            torque_min_percent,
            torque_max_percent,
            torque_r_squared,
            torque_residual_spread,
        ] = parts("torque", calibration.torque)?;
        let row = Self {
            machine_id: machine.as_str().to_owned(),
            version: i64::from(calibration.version),
            fitted_at_us: now.micros(),
            thrust_slope,
            thrust_intercept,
            thrust_min_percent,
            thrust_max_percent,
            thrust_r_squared,
            thrust_residual_spread,
            torque_slope,
            torque_intercept,
            torque_min_percent,
            torque_max_percent,
            torque_r_squared,
            torque_residual_spread,
            row_sum: None,
            summed_version: None,
        };
        Ok(row.with_sum())
    }

    pub(crate) fn calibration(&self, writers: Writers) -> StoreResult<StoredCalibration> {
        let calibration = Calibration {
            version: number("version", self.version)?,
            thrust: line([
                self.thrust_slope,
                self.thrust_intercept,
                self.thrust_min_percent,
                self.thrust_max_percent,
                self.thrust_r_squared,
                self.thrust_residual_spread,
            ]),
            torque: line([
                self.torque_slope,
                self.torque_intercept,
                self.torque_min_percent,
                self.torque_max_percent,
                self.torque_r_squared,
                self.torque_residual_spread,
            ]),
        };
        let fitted_at = Timestamp::from_micros(self.fitted_at_us);
        Ok(StoredCalibration { calibration, fitted_at, is_damaged: self.is_damaged(writers) })
    }
}

/// Fitted lines as the audit shows them.
pub(crate) fn calibration_json(calibration: &Calibration) -> Value {
    let line = |line: Option<FittedLine>| {
        line.map(|line| {
            json!({
                "slope": line.slope,
                "intercept": line.intercept,
                "min_percent": line.min_percent,
                "max_percent": line.max_percent,
                "r_squared": line.r_squared,
                "residual_spread": line.residual_spread,
            })
        })
    };
    json!({
        "version": calibration.version,
        "thrust": line(calibration.thrust),
        "torque": line(calibration.torque),
    })
}

/// A row of `tools`.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct ToolRow {
    pub(crate) tool_id: String,
    pub(crate) name: StoredText,
    pub(crate) serial: Option<String>,
    pub(crate) tool_type: String,
    pub(crate) diameter_mm: Option<f64>,
    pub(crate) version: i64,
    pub(crate) updated_at_us: i64,
    pub(crate) row_sum: Option<i64>,
    pub(crate) summed_version: Option<i64>,
}

summed!(ToolRow of "tools": tool_id, name, serial, tool_type, diameter_mm, version, updated_at_us);

impl ToolRow {
    /// As it is to be written.
    pub(crate) fn of(tool: &Tool, version: u64, now: Timestamp) -> StoreResult<Self> {
        let row = Self {
            tool_id: tool.id.as_str().to_owned(),
            name: tool.name.as_str().into(),
            serial: tool.serial.clone(),
            tool_type: tool.tool_type.clone(),
            diameter_mm: optional_float("diameter_mm", tool.diameter_mm)?,
            version: count("version", version)?,
            updated_at_us: now.micros(),
            row_sum: None,
            summed_version: None,
        };
        Ok(row.with_sum())
    }

    pub(crate) fn versioned(&self, writers: Writers) -> StoreResult<Versioned<Tool>> {
        Ok(Versioned {
            value: Tool {
                id: id("tool_id", &self.tool_id)?,
                name: self.name.shown(),
                serial: self.serial.clone(),
                tool_type: self.tool_type.clone(),
                diameter_mm: self.diameter_mm,
            },
            version: number("version", self.version)?,
            updated_at: Timestamp::from_micros(self.updated_at_us),
            is_damaged: self.is_damaged(writers),
        })
    }
}

/// A tool as the audit shows it.
pub(crate) fn tool_json(tool: &Tool) -> Value {
    json!({
        "name": tool.name,
        "serial": tool.serial,
        "tool_type": tool.tool_type,
        "diameter_mm": tool.diameter_mm,
    })
}

/// A row of `operations`.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct OperationRow {
    pub(crate) operation_id: String,
    pub(crate) name: StoredText,
    pub(crate) process: String,
    pub(crate) program: Option<String>,
    pub(crate) feature: Option<String>,
    pub(crate) work_material: Option<String>,
    pub(crate) thickness_mm: Option<f64>,
    pub(crate) depth_mm: Option<f64>,
    pub(crate) spindle_speed_rpm: Option<f64>,
    pub(crate) programmed_feed_mm_min: Option<f64>,
    pub(crate) spindle_load_set_percent: Option<f64>,
    pub(crate) feed_drive_load_set_percent: Option<f64>,
    pub(crate) baseline_cycles: i64,
    pub(crate) window_cycles: i64,
    pub(crate) reference_every_cycles: Option<i64>,
    pub(crate) reference_feed_mm_min: Option<f64>,
    pub(crate) setup: Option<String>,
    pub(crate) version: i64,
    pub(crate) updated_at_us: i64,
    pub(crate) row_sum: Option<i64>,
    pub(crate) summed_version: Option<i64>,
}

// Not the number of its last change after which cycles are judged otherwise, which is written behind it.
summed!(OperationRow of "operations":
    operation_id, name, process, program, feature, work_material, thickness_mm, depth_mm, spindle_speed_rpm, programmed_feed_mm_min, spindle_load_set_percent, feed_drive_load_set_percent, baseline_cycles, window_cycles, reference_every_cycles, reference_feed_mm_min, setup, version, updated_at_us,
);

impl OperationRow {
    /// As it is to be written.
    pub(crate) fn of(operation: &Operation, version: u64, now: Timestamp) -> StoreResult<Self> {
        let setup = setup_json(operation.turning.as_ref(), operation.plunge.as_ref())?;
        let wear = &operation.wear;
        let row = Self {
            operation_id: operation.id.as_str().to_owned(),
            name: operation.name.as_str().into(),
            process: operation.process.as_str().to_owned(),
            program: operation.program.clone(),
            feature: operation.feature.clone(),
            work_material: operation.work_material.clone(),
            thickness_mm: optional_float("thickness_mm", operation.thickness_mm)?,
            depth_mm: optional_float("depth_mm", operation.depth_mm)?,
            spindle_speed_rpm: optional_float("spindle_speed_rpm", operation.spindle_speed_rpm)?,
            programmed_feed_mm_min: optional_float(
                "programmed_feed_mm_min",
                operation.programmed_feed_mm_min,
            )?,
            spindle_load_set_percent: optional_float(
                "spindle_load_set_percent",
                operation.spindle_load_set_percent,
            )?,
            feed_drive_load_set_percent: optional_float(
                "feed_drive_load_set_percent",
                operation.feed_drive_load_set_percent,
            )?,
            baseline_cycles: i64::from(wear.baseline_cycles),
            window_cycles: i64::from(wear.window_cycles),
            reference_every_cycles: wear.reference_every_cycles.map(i64::from),
            reference_feed_mm_min: optional_float("reference_feed_mm_min", wear.reference_feed_mm_min)?,
            setup: setup.map(|setup| setup.to_string()),
            version: count("version", version)?,
            updated_at_us: now.micros(),
            row_sum: None,
            summed_version: None,
        };
        Ok(row.with_sum())
    }

    pub(crate) fn versioned(&self, writers: Writers) -> StoreResult<Versioned<Operation>> {
        let (turning, plunge) = setup_of(self.setup.as_deref())?;
        Ok(Versioned {
            value: Operation {
                id: id("operation_id", &self.operation_id)?,
                name: self.name.shown(),
                process: word("process", &self.process, Process::parse)?,
                program: self.program.clone(),
                feature: self.feature.clone(),
                work_material: self.work_material.clone(),
                thickness_mm: self.thickness_mm,
                depth_mm: self.depth_mm,
                spindle_speed_rpm: self.spindle_speed_rpm,
                programmed_feed_mm_min: self.programmed_feed_mm_min,
                spindle_load_set_percent: self.spindle_load_set_percent,
                feed_drive_load_set_percent: self.feed_drive_load_set_percent,
                wear: WearSettings {
                    baseline_cycles: number("baseline_cycles", self.baseline_cycles)?,
                    window_cycles: number("window_cycles", self.window_cycles)?,
                    reference_every_cycles: self
                        .reference_every_cycles
                        .map(|every| number("reference_every_cycles", every))
                        .transpose()?,
                    reference_feed_mm_min: self.reference_feed_mm_min,
                },
                turning,
                plunge,
            },
            version: number("version", self.version)?,
            updated_at: Timestamp::from_micros(self.updated_at_us),
            is_damaged: self.is_damaged(writers),
        })
    }
}

/// An operation as the audit shows it.
pub(crate) fn operation_json(operation: &Operation, setup: Option<&Value>) -> Value {
    json!({
        "name": operation.name,
        "process": operation.process.as_str(),
        "program": operation.program,
        "feature": operation.feature,
        "work_material": operation.work_material,
        "thickness_mm": operation.thickness_mm,
        "depth_mm": operation.depth_mm,
        "spindle_speed_rpm": operation.spindle_speed_rpm,
        "programmed_feed_mm_min": operation.programmed_feed_mm_min,
        "spindle_load_set_percent": operation.spindle_load_set_percent,
        "feed_drive_load_set_percent": operation.feed_drive_load_set_percent,
        "baseline_cycles": operation.wear.baseline_cycles,
        "window_cycles": operation.wear.window_cycles,
        "reference_every_cycles": operation.wear.reference_every_cycles,
        "reference_feed_mm_min": operation.wear.reference_feed_mm_min,
        "setup": setup,
    })
}

//! Rows of what people register, and the same as JSON for the audit.

use super::library::setup_of;
use super::{id, number, word};
use crate::error::StoreResult;
use crate::record::Versioned;
use crate::stored_text::StoredText;
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
    machine_id: String,
    name: StoredText,
    control: StoredText,
    ipo_period_ms: f64,
    spindle_reference: String,
    spindle_rated_power_watts: Option<f64>,
    spindle_base_speed_rpm: Option<f64>,
    feed_drive_reference: String,
    feed_drive_rated_thrust_newtons: Option<f64>,
    feed_min_mm_min: f64,
    feed_max_mm_min: f64,
    override_min_percent: f64,
    override_max_percent: f64,
    version: i64,
    updated_at_us: i64,
}

impl MachineRow {
    pub(crate) fn versioned(&self) -> StoreResult<Versioned<Machine>> {
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
    version: i64,
    fitted_at_us: i64,
    thrust_slope: Option<f64>,
    thrust_intercept: Option<f64>,
    thrust_min_percent: Option<f64>,
    thrust_max_percent: Option<f64>,
    thrust_r_squared: Option<f64>,
    thrust_residual_spread: Option<f64>,
    torque_slope: Option<f64>,
    torque_intercept: Option<f64>,
    torque_min_percent: Option<f64>,
    torque_max_percent: Option<f64>,
    torque_r_squared: Option<f64>,
    torque_residual_spread: Option<f64>,
}

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

impl CalibrationRow {
    pub(crate) fn calibration(&self) -> StoreResult<(Calibration, Timestamp)> {
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
        Ok((calibration, Timestamp::from_micros(self.fitted_at_us)))
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
    tool_id: String,
    name: StoredText,
    serial: Option<String>,
    tool_type: String,
    diameter_mm: Option<f64>,
    version: i64,
    updated_at_us: i64,
}

impl ToolRow {
    pub(crate) fn versioned(&self) -> StoreResult<Versioned<Tool>> {
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
    operation_id: String,
    name: StoredText,
    process: String,
    program: Option<String>,
    feature: Option<String>,
    work_material: Option<String>,
    thickness_mm: Option<f64>,
    depth_mm: Option<f64>,
    spindle_speed_rpm: Option<f64>,
    programmed_feed_mm_min: Option<f64>,
    spindle_load_set_percent: Option<f64>,
    feed_drive_load_set_percent: Option<f64>,
    baseline_cycles: i64,
    window_cycles: i64,
    reference_every_cycles: Option<i64>,
    reference_feed_mm_min: Option<f64>,
    setup: Option<String>,
    version: i64,
    updated_at_us: i64,
}

impl OperationRow {
    pub(crate) fn versioned(&self) -> StoreResult<Versioned<Operation>> {
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

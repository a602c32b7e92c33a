//! Rows of the fleet's last cycles.

use super::{id, word};
use crate::error::StoreResult;
use crate::record::FleetCycle;
use feedwright_core::cycle::Outcome;
use feedwright_core::summary::EnergyBasis;
use feedwright_core::units::{Strategy, Timestamp};

/// A cycle with what a glance needs of it.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct FleetCycleRow {
    machine_id: String,
    cycle_id: String,
    tool_id: String,
    operation_id: String,
    started_at_us: i64,
    received_at_us: i64,
    outcome: String,
    strategy: Option<String>,
    duration_ms: Option<f64>,
    dynamometer_joules: Option<f64>,
    calibrated_joules: Option<f64>,
    measured_power_joules: Option<f64>,
    rated_power_joules: Option<f64>,
    reported_energy_joules: Option<f64>,
    energy_scale: i64,
    depth_digest: Option<Vec<u8>>,
}

impl FleetCycleRow {
    pub(crate) fn cycle(&self) -> StoreResult<FleetCycle> {
        // The order in which wear prefers them.
        let energies = [
            (EnergyBasis::Dynamometer, self.dynamometer_joules),
            (EnergyBasis::Calibrated, self.calibrated_joules),
            (EnergyBasis::MeasuredPower, self.measured_power_joules),
            (EnergyBasis::RatedPower, self.rated_power_joules),
            (EnergyBasis::Reported, self.reported_energy_joules),
        ];
        Ok(FleetCycle {
            machine: id("machine_id", &self.machine_id)?,
            id: id("cycle_id", &self.cycle_id)?,
            tool: id("tool_id", &self.tool_id)?,
            operation: id("operation_id", &self.operation_id)?,
            started_at: Timestamp::from_micros(self.started_at_us),
            received_at: Timestamp::from_micros(self.received_at_us),
            outcome: word("outcome", &self.outcome, Outcome::parse)?,
            strategy: self
                .strategy
                .as_deref()
                .map(|text| word("strategy", text, Strategy::parse))
                .transpose()?,
            duration_ms: self.duration_ms,
            energy: energies.into_iter().find_map(|(basis, joules)| Some((basis, joules?))),
            contact_joules: self
                .depth_digest
                .as_deref()
                .and_then(|bytes| super::facts::legible_digest(bytes, &self.machine_id, &self.cycle_id))
                .map(|digest| digest.joules()),
            energy_scale: self.energy_scale,
        })
    }
}

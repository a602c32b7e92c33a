//! The fleet at a glance in JSON.

use super::alarm::AlarmView;
use super::time;
use super::wear::WearBody;
use feedwright_core::summary::EnergyBasis;
use feedwright_core::units::{Strategy, Timestamp};
use feedwright_store::{FleetCycle, FleetRow};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// Which part of the fleet.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct FleetQuery {
    /// Most machines wanted, up to `limits.max_page_size` of the configuration, which is 1000 unless set otherwise; 100
    /// (`limits.default_page_size`) where it is left out.
    #[param(minimum = 1, maximum = 10_000)]
    pub limit: Option<u32>,
    /// `next_cursor` of the page before.
    pub cursor: Option<String>,
    /// Newest cycles looked at for each machine, 1 to 200; 60 where it is left out.
    #[param(minimum = 1, maximum = 200)]
    pub recent: Option<u32>,
}

/// A page of the fleet.
#[derive(Debug, Serialize, ToSchema)]
pub struct FleetBody {
    /// The server's time, RFC 3339: ages are counted from it.
    pub now: String,
    /// Data older than this is stale, ms.
    pub stale_after_ms: i64,
    /// The machines.
    pub items: Vec<FleetMachineBody>,
    /// Goes on after the last machine, as `cursor`; absent on the last page.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next_cursor: Option<String>,
}

/// How far to look back.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct RecentQuery {
    /// Newest cycles wanted, 1 to 200; 60 where it is left out.
    #[param(minimum = 1, maximum = 200)]
    pub recent: Option<u32>,
}

/// One machine at a glance, with its newest cycles.
#[derive(Debug, Serialize, ToSchema)]
pub struct FleetOneBody {
    /// The server's time, RFC 3339: ages are counted from it.
    pub now: String,
    /// Data older than this is stale, ms.
    pub stale_after_ms: i64,
    /// The machine.
    #[serde(flatten)]
    pub machine: FleetMachineBody,
    /// Its newest cycles, newest first.
    pub recent: Vec<FleetCycleBody>,
}

/// A machine at a glance.
#[derive(Debug, Serialize, ToSchema)]
pub struct FleetMachineBody {
    /// Its id.
    pub machine: String,
    /// What people call it.
    pub name: String,
    /// Kind of control.
    pub control: String,
    /// Its newest cycle; null before the first.
    pub last_cycle: Option<FleetCycleBody>,
    /// Median time from the beginning of one of its newest cycles to the next, ms; null before the second.
    pub cadence_ms: Option<i64>,
    /// How worn the tool of the newest cycle is.
    pub wear: Option<WearBody<'static>>,
    /// Energies of those of the newest cycles that this tool ran in its current life, each over the baseline that it was compared
    /// with, oldest first: 1 is the new tool, and of one that was mounted used what it needed in its own first cycles. Cycles
    /// without energy, or whose baseline does not stand yet, are left out.
    pub energy_ratios: Vec<f64>,
    /// Its open alarms, oldest first.
    pub alarms: Vec<AlarmView>,
}

/// A cycle at a glance.
#[derive(Debug, Serialize, ToSchema)]
pub struct FleetCycleBody {
    /// Its id.
    pub cycle_id: String,
    /// Its tool.
    pub tool: String,
    /// What people call the tool, where it is registered.
    pub tool_name: Option<String>,
    /// Its operation.
    pub operation: String,
    /// What people call the operation, where it is registered.
    pub operation_name: Option<String>,
    /// When it began, by the machine's clock.
    pub started_at: String,
    /// When the server received it.
    pub received_at: String,
    /// How it ended.
    pub outcome: &'static str,
    /// Strategy of the feed.
    pub strategy: Option<&'static str>,
    /// Cycle time, ms.
    pub duration_ms: Option<f64>,
    /// Energy on the best basis there is, J.
    pub energy_joules: Option<f64>,
    /// Which basis that is.
    pub energy_basis: Option<&'static str>,
}

impl FleetCycleBody {
    /// Of a cycle, with what people call its tool and its operation.
    pub fn new(cycle: &FleetCycle, (tool_name, operation_name): (Option<String>, Option<String>)) -> Self {
        let facts = &cycle.facts;
        let (basis, joules) = facts.energy.map(|(basis, _, joules)| (basis, joules)).unzip();
        Self {
            cycle_id: facts.order.cycle.to_string(),
            tool: cycle.tool.to_string(),
            tool_name,
            operation: facts.operation.to_string(),
            operation_name,
            started_at: time::show(facts.order.started_at),
            received_at: time::show(cycle.received_at),
            outcome: cycle.outcome.as_str(),
            strategy: facts.strategy.map(Strategy::as_str),
            duration_ms: facts.duration_ms,
            energy_joules: joules,
            energy_basis: basis.map(EnergyBasis::as_str),
        }
    }
}

impl From<&FleetRow> for FleetMachineBody {
    fn from(row: &FleetRow) -> Self {
        let last = row.recent.first();
        let began: Vec<_> = row.recent.iter().map(|cycle| cycle.facts.order.started_at).collect();
        Self {
            machine: row.machine.value.id.to_string(),
            name: row.machine.value.name.clone(),
            control: row.machine.value.control.clone(),
            last_cycle: last.map(|last| FleetCycleBody::new(last, row.names.clone())),
            cadence_ms: cadence_ms(&began),
            wear: row.verdict.as_ref().map(|verdict| WearBody::from(verdict).owned()),
            energy_ratios: row.energy_ratios.clone(),
            alarms: row.alarms.iter().cloned().map(Into::into).collect(),
        }
    }
}

/// Median distance of what began at these times, newest first, ms.
fn cadence_ms(began: &[Timestamp]) -> Option<i64> {
    let mut gaps: Vec<i64> = began.windows(2).map(|pair| pair[0].millis_since(pair[1])).collect();
    gaps.sort_unstable();
    let upper = *gaps.get(gaps.len() / 2)?;
    Some(if gaps.len().is_multiple_of(2) { gaps[gaps.len() / 2 - 1].midpoint(upper) } else { upper })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cadence_is_the_median_of_the_gaps() {
        let began = |seconds: &[i64]| {
            let began: Vec<_> = seconds.iter().map(|at| Timestamp::from_micros(at * 1_000_000)).collect();
            cadence_ms(&began)
        };
        assert_eq!(began(&[]), None);
        assert_eq!(began(&[7]), None);
        assert_eq!(began(&[17, 7]), Some(10_000));
        assert_eq!(began(&[110, 100, 0]), Some(55_000));
        assert_eq!(began(&[315, 115, 110, 10, 0]), Some(55_000));
        assert_eq!(began(&[1110, 110, 100, 0]), Some(100_000));
    }
}

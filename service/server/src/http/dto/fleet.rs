//! The fleet at a glance in JSON.

use super::alarm::AlarmView;
use super::time;
use super::wear::WearBody;
use feedwright_core::summary::EnergyBasis;
use feedwright_core::units::Strategy;
use feedwright_store::{FleetCycle, FleetRow};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// Which part of the fleet.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct FleetQuery {
    /// Most machines wanted.
    pub limit: Option<u32>,
    /// `next_cursor` of the page before.
    pub cursor: Option<String>,
    /// Newest cycles looked at for each machine, 1 to 200; 60 where it is left out.
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
    /// Energies of the newest cycles of that tool on this machine over its baseline, oldest first: 1 is the new tool.
    /// Only cycles of this life that compare: same operation, strategy, energy basis and scale. Empty before the baseline stands.
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
        let (basis, joules) = cycle.energy.unzip();
        Self {
            cycle_id: cycle.id.to_string(),
            tool: cycle.tool.to_string(),
            tool_name,
            operation: cycle.operation.to_string(),
            operation_name,
            started_at: time::show(cycle.started_at),
            received_at: time::show(cycle.received_at),
            outcome: cycle.outcome.as_str(),
            strategy: cycle.strategy.map(Strategy::as_str),
            duration_ms: cycle.duration_ms,
            energy_joules: joules,
            energy_basis: basis.map(EnergyBasis::as_str),
        }
    }
}

impl From<&FleetRow> for FleetMachineBody {
    fn from(row: &FleetRow) -> Self {
        let last = row.recent.first();
        Self {
            machine: row.machine.value.id.to_string(),
            name: row.machine.value.name.clone(),
            control: row.machine.value.control.clone(),
            last_cycle: last.map(|last| FleetCycleBody::new(last, row.names.clone())),
            cadence_ms: cadence_ms(&row.recent),
            wear: row.verdict.as_ref().map(|verdict| WearBody::from(verdict).owned()),
            energy_ratios: energy_ratios(row),
            alarms: row.alarms.iter().cloned().map(Into::into).collect(),
        }
    }
}

/// Median distance of the cycles, which stand newest first.
fn cadence_ms(recent: &[FleetCycle]) -> Option<i64> {
    let mut gaps: Vec<i64> =
        recent.windows(2).map(|pair| pair[0].started_at.millis_since(pair[1].started_at)).collect();
    gaps.sort_unstable();
    gaps.get(gaps.len() / 2).copied()
}

fn energy_ratios(row: &FleetRow) -> Vec<f64> {
    let (Some(last), Some(verdict)) = (row.recent.first(), &row.verdict) else {
        return Vec::new();
    };
    let Some((basis, _)) = last.energy else {
        return Vec::new();
    };
    // Baselines stand with the one that ran last first.
    let current = verdict.baselines.iter().find(|baseline| {
        let key = &baseline.key;
        key.machine == last.machine
            && key.operation == last.operation
            && key.basis == basis
            && key.strategy == last.strategy
            && key.energy_scale == last.energy_scale
    });
    let Some((baseline, in_contact)) = current
        .and_then(|baseline| Some((baseline.baseline_joules?, baseline.key.in_contact)))
        .filter(|(joules, _)| *joules > 0.0)
    else {
        return Vec::new();
    };
    // Of this life of the tool only: the one before had a baseline of its own.
    let life = usize::try_from(verdict.cycles).unwrap_or(usize::MAX);
    let alike = row.recent.iter().filter(|cycle| cycle.tool == last.tool).take(life).filter(|cycle| {
        cycle.operation == last.operation
            && cycle.strategy == last.strategy
            && cycle.energy_scale == last.energy_scale
    });
    let joules = |cycle: &FleetCycle| {
        let (of, whole) = cycle.energy?;
        let joules = if in_contact { cycle.contact_joules? } else { whole };
        (of == basis).then_some(joules)
    };
    let mut ratios: Vec<f64> = alike.filter_map(joules).map(|joules| joules / baseline).collect();
    ratios.reverse();
    ratios
}

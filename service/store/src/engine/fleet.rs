//! The fleet at a glance: a row a machine, with what its last cycles and its tool say.

use super::{Conn, Db, alarms, machines, operations, tools, wear};
use crate::error::StoreResult;
use crate::record::{Alarm, AlarmFilter, FleetCycle, FleetRow, Page, Versioned};
use crate::rows::FleetCycleRow;
use feedwright_core::ids::{MachineId, OperationId, ToolId};
use feedwright_core::machine::Machine;
use feedwright_core::wear::Verdict;
use std::collections::BTreeMap;

/// Open alarms that are told of; a fleet with more has other troubles than a longer list.
const MOST_ALARMS: u32 = 2000;

// Newest first along an index: as many rows are read as are wanted, whatever the history holds.
const LAST_CYCLES: &str = "SELECT machine_id, cycle_id, tool_id, operation_id, started_at_us, received_at_us, outcome,
        strategy, duration_ms, dynamometer_joules, calibrated_joules, measured_power_joules, rated_power_joules,
        reported_energy_joules, energy_scale, depth_digest
    FROM cycles WHERE machine_id = $1 ORDER BY started_at_us DESC, COALESCE(seq, -1) DESC, cycle_id DESC LIMIT $2";

/// Machines by id, each with its newest `recent` cycles (newest first), the verdict on the tool of the newest one and
/// its open alarms.
pub(super) async fn list(conn: &mut Conn, page: &Page<MachineId>, recent: u32) -> StoreResult<Vec<FleetRow>> {
    let machines = machines::list(conn, page).await?;
    rows(conn, machines, None, recent).await
}

/// One machine likewise; `None` where it is not registered.
pub(super) async fn one(conn: &mut Conn, machine: &MachineId, recent: u32) -> StoreResult<Option<FleetRow>> {
    let Some(known) = machines::get(conn, machine).await? else {
        return Ok(None);
    };
    Ok(rows(conn, vec![known], Some(machine), recent).await?.pop())
}

async fn rows(
    conn: &mut Conn,
    machines: Vec<Versioned<Machine>>,
    only: Option<&MachineId>,
    recent: u32,
) -> StoreResult<Vec<FleetRow>> {
    let mut alarms = open_alarms(conn, only).await?;
    let mut known_tools: BTreeMap<ToolId, (Option<String>, Verdict)> = BTreeMap::new();
    let mut known_operations: BTreeMap<OperationId, Option<String>> = BTreeMap::new();
    let mut rows = Vec::with_capacity(machines.len());
    for machine in machines {
        let recent = last_cycles(conn, &machine.value.id, recent).await?;
        let alarms = alarms.remove(machine.value.id.as_str()).unwrap_or_default();
        let Some(FleetCycle { tool, operation, .. }) = recent.first() else {
            rows.push(FleetRow { machine, recent, names: (None, None), verdict: None, alarms });
            continue;
        };
        if !known_tools.contains_key(tool) {
            let name = tools::get(conn, tool).await?.map(|tool| tool.value.name);
            known_tools.insert(tool.clone(), (name, wear::verdict(conn, tool).await?));
        }
        if !known_operations.contains_key(operation) {
            let name = operations::get(conn, operation).await?.map(|operation| operation.value.name);
            known_operations.insert(operation.clone(), name);
        }
        let (tool_name, verdict) = known_tools.get(tool).cloned().unzip();
        let names = (tool_name.flatten(), known_operations.get(operation).cloned().flatten());
        rows.push(FleetRow { machine, recent, names, verdict, alarms });
    }
    Ok(rows)
}

async fn open_alarms(conn: &mut Conn, only: Option<&MachineId>) -> StoreResult<BTreeMap<String, Vec<Alarm>>> {
    let filter = AlarmFilter { open: Some(true), machine: only.cloned(), tool: None };
    let open = alarms::list(conn, &filter, &Page { after: None, limit: MOST_ALARMS }).await?;
    let mut by_machine: BTreeMap<String, Vec<Alarm>> = BTreeMap::new();
    for alarm in open {
        if let Some(machine) = &alarm.machine {
            by_machine.entry(machine.as_str().to_owned()).or_default().push(alarm);
        }
    }
    Ok(by_machine)
}

async fn last_cycles(conn: &mut Conn, machine: &MachineId, most: u32) -> StoreResult<Vec<FleetCycle>> {
    let rows: Vec<FleetCycleRow> = sqlx::query_as::<Db, _>(LAST_CYCLES)
        .bind(machine.as_str())
        .bind(i64::from(most))
        .fetch_all(&mut *conn)
        .await?;
    rows.iter().map(FleetCycleRow::cycle).collect()
}

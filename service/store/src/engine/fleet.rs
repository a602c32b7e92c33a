//! The fleet at a glance: a row a machine, with what its last cycles and its tool say.

use super::{Conn, Db, alarms, dialect, machines, operations, tools, wear};
use crate::error::StoreResult;
use crate::record::{Alarm, AlarmFilter, FleetCycle, FleetRow, Page, RowNumber, Versioned};
use crate::rows::{FleetCycleRow, Place};
use feedwright_core::ids::{MachineId, OperationId, ToolId};
use feedwright_core::machine::Machine;
use feedwright_core::operation::Ask;
use feedwright_core::wear::Verdict;
use std::collections::BTreeMap;

/// Open alarms that are read for all machines at once; where there are more, each machine's are asked for.
const FEW_ALARMS: u32 = 500;
/// Open alarms of a machine that are told of, beside overloads that nobody has acknowledged; one with more has other troubles than a
/// longer list.
const MOST_ALARMS: u32 = 2000;

// Newest first along an index: as many rows are read as are wanted, whatever the history holds.
const LAST_CYCLES: &str = concat!(
    "SELECT ",
    wear::facts_columns!(),
    ", c.tool_id, c.outcome
     FROM cycles c LEFT JOIN operations o ON o.operation_id = c.operation_id
     WHERE ",
    dialect::of_one!("c.machine_id", "$1"),
    " ORDER BY c.machine_id DESC, c.started_at_us DESC, COALESCE(c.seq, -1) DESC, c.cycle_id DESC LIMIT $2"
);

/// Machines by id, each with its newest `recent` cycles (newest first), the verdict on the tool of the newest one and
/// its open alarms. `None` where more cycles than `bound` had to be folded for a verdict.
pub(super) async fn list(
    conn: &mut Conn,
    page: &Page<MachineId>,
    recent: u32,
    bound: u64,
) -> StoreResult<Option<Vec<FleetRow>>> {
    let machines = machines::list(conn, page).await?;
    rows(conn, machines, recent, bound).await
}

/// One machine likewise; no row where it is not registered.
pub(super) async fn one(
    conn: &mut Conn,
    machine: &MachineId,
    recent: u32,
    bound: u64,
) -> StoreResult<Option<Vec<FleetRow>>> {
    let machines = machines::get(conn, machine).await?.into_iter().collect();
    rows(conn, machines, recent, bound).await
}

async fn rows(
    conn: &mut Conn,
    machines: Vec<Versioned<Machine>>,
    recent: u32,
    bound: u64,
) -> StoreResult<Option<Vec<FleetRow>>> {
    let mut few_alarms = if machines.len() > 1 { few_open_alarms(conn).await? } else { None };
    let mut known_tools: BTreeMap<ToolId, (Option<String>, (Verdict, Place))> = BTreeMap::new();
    let mut known_operations: BTreeMap<OperationId, Option<String>> = BTreeMap::new();
    let mut asks = BTreeMap::new();
    let mut rows = Vec::with_capacity(machines.len());
    for machine in machines {
        let recent = last_cycles(conn, &machine.value.id, recent, &mut asks).await?;
        let alarms = match &mut few_alarms {
            Some(few) => few.remove(machine.value.id.as_str()).unwrap_or_default(),
            None => open_alarms_of(conn, &machine.value.id).await?,
        };
        let Some(FleetCycle { tool, facts, .. }) = recent.first() else {
            let (names, energy_ratios) = ((None, None), Vec::new());
            rows.push(FleetRow { machine, recent, names, verdict: None, energy_ratios, alarms });
            continue;
        };
        let operation = &facts.operation;
        if !known_tools.contains_key(tool) {
            let name = tools::get(conn, tool).await?.map(|tool| tool.value.name);
            let Some(of_life) = wear::verdict_of_life(conn, tool, bound).await? else { return Ok(None) };
            known_tools.insert(tool.clone(), (name, of_life));
        }
        if !known_operations.contains_key(operation) {
            let name = operations::get(conn, operation).await?.map(|operation| operation.value.name);
            known_operations.insert(operation.clone(), name);
        }
        let (tool_name, of_life) = known_tools.get(tool).cloned().unzip();
        let names = (tool_name.flatten(), known_operations.get(operation).cloned().flatten());
        let energy_ratios =
            of_life.as_ref().map(|of_life| energy_ratios(&recent, tool, of_life)).unwrap_or_default();
        let verdict = of_life.map(|(verdict, _)| verdict);
        rows.push(FleetRow { machine, recent, names, verdict, energy_ratios, alarms });
    }
    Ok(Some(rows))
}

/// Energies of a tool's cycles over its baselines, oldest first. Of its current life only: the one before had baselines of its own.
fn energy_ratios(recent: &[FleetCycle], tool: &ToolId, (verdict, life): &(Verdict, Place)) -> Vec<f64> {
    let of_life =
        recent.iter().rev().filter(|cycle| cycle.tool == *tool && Place::of(&cycle.facts.order) >= *life);
    of_life.filter_map(|cycle| verdict.ratio_of(&cycle.facts, cycle.settings.as_ref()?)).collect()
}

/// All open alarms by their machines, where they are few.
async fn few_open_alarms(conn: &mut Conn) -> StoreResult<Option<BTreeMap<String, Vec<Alarm>>>> {
    let open = open_alarms(conn, None, FEW_ALARMS).await?;
    if open.len() >= FEW_ALARMS as usize {
        return Ok(None);
    }
    let mut by_machine: BTreeMap<String, Vec<Alarm>> = BTreeMap::new();
    for alarm in open {
        if let Some(machine) = &alarm.machine {
            by_machine.entry(machine.as_str().to_owned()).or_default().push(alarm);
        }
    }
    Ok(Some(by_machine))
}

async fn open_alarms(conn: &mut Conn, of: Option<&MachineId>, most: u32) -> StoreResult<Vec<Alarm>> {
    let filter = AlarmFilter { open: Some(true), machine: of.cloned(), tool: None };
    alarms::list(conn, &filter, &Page { after: None, limit: most }, RowNumber::MAX).await
}

/// A machine's open alarms, oldest first. An overload holds the machine until a person acknowledges it: it is among them however many
/// are older.
async fn open_alarms_of(conn: &mut Conn, machine: &MachineId) -> StoreResult<Vec<Alarm>> {
    let mut open = open_alarms(conn, Some(machine), MOST_ALARMS).await?;
    if let Some(last) = open.last().map(|alarm| alarm.id)
        && open.len() >= MOST_ALARMS as usize
    {
        let mut behind = alarms::open_overloads(conn, machine).await?;
        behind.retain(|overload| *overload > last);
        behind.truncate(MOST_ALARMS as usize);
        open.extend(alarms::numbered(conn, &behind).await?);
    }
    Ok(open)
}

async fn last_cycles(
    conn: &mut Conn,
    machine: &MachineId,
    most: u32,
    asks: &mut BTreeMap<String, Vec<Ask>>,
) -> StoreResult<Vec<FleetCycle>> {
    let mut rows: Vec<FleetCycleRow> = sqlx::query_as::<Db, _>(LAST_CYCLES)
        .bind(machine.as_str())
        .bind(i64::from(most))
        .fetch_all(&mut *conn)
        .await?;
    wear::ask_operations(conn, rows.iter_mut().map(|row| &mut row.facts), asks).await?;
    rows.iter().map(FleetCycleRow::cycle).collect()
}
